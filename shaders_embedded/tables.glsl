// Precedes the files of every shader. Before it come the #defines of the program's features and of the constants
// that C shares; after it come the functions that read records (see >>records in sbl.h). Tables that grow with the
// scene are buffer textures or, if they exceed the driver's limit, 2D textures (see sbl__table_attach).
#ifdef SBL_WIDE
#define sbl_Texels usampler2D
#define sbl_fetch(texels, i) texelFetch(texels, ivec2((i) & (SBL_TEXELS_ACROSS - 1), (i) >> SBL_TEXELS_SHIFT), 0)
#else
#define sbl_Texels usamplerBuffer
#define sbl_fetch(texels, i) texelFetch(texels, i)
#endif

// Software renderers execute both branches of an if, and the body of a loop at least once, but they leave a loop
// when no lane is in it. Expensive code that is rarely needed is therefore a loop that may have 0 turns, or it
// depends on a feature.
