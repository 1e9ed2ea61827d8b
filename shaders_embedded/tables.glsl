// What stands above every shader: how tables are read. Those that grow with the scene are buffer textures or, past
// the driver's limit for these, 2D textures (see sbl__table_attach in sbl.h). Above this stand the program's
// features and the constants that C shares, below it the functions that read its records (see >>records).
#ifdef SBL_WIDE
#define sbl_Texels usampler2D
#define sbl_fetch(texels, i) texelFetch(texels, ivec2((i) & (SBL_TEXELS_ACROSS - 1), (i) >> SBL_TEXELS_SHIFT), 0)
#else
#define sbl_Texels usamplerBuffer
#define sbl_fetch(texels, i) texelFetch(texels, i)
#endif

// Software renderers run both sides of every if, and loops at least once, but leave loops that no lane is in: what
// is long and seldom wanted is a loop whose count may be 0, or a feature.
