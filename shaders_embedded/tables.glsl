// This text precedes the files of every shader. The #defines of the program's features and shared constants
// precede this text; the functions that read records follow it (see >>records in sbl.h). Tables that grow with the
// scene are buffer textures or, if they exceed the driver's limit, 2D textures (see sbl__table_attach).
#ifdef SBL_WIDE
#define sbl_Texels usampler2D
#define sbl_fetch(texels, i) texelFetch(texels, ivec2((i) & (SBL_TEXELS_ACROSS - 1), (i) >> SBL_TEXELS_SHIFT), 0)
#else
#define sbl_Texels usamplerBuffer
#define sbl_fetch(texels, i) texelFetch(texels, i)
#endif

// Software renderers run many invocations in lockstep. They execute both branches of an if, and the body of a loop
// at least once, but they leave a loop when no invocation is in it. Expensive code that is rarely needed is
// therefore written as a loop of 0 or 1 iterations, or is compiled only for a feature.
