// SBL_GROUPS is the number of light groups; it is undefined if light groups are not measured. Programs sum the
// light of each group in a layer. SBL_OUT_LAYERS declares as many outputs as the layers need, four floats each; a
// to f: their indices for SBL_OUT. sbl_write_layers writes the layers to the outputs, one after the other.
// SBL_IF_n(x) is x if output n is needed, otherwise nothing.
#ifdef SBL_GROUPS
#define SBL_IF_0(x) x
#if SBL_GROUPS >= 2
#define SBL_IF_1(x) x
#else
#define SBL_IF_1(x)
#endif
#if SBL_GROUPS >= 3
#define SBL_IF_2(x) x
#else
#define SBL_IF_2(x)
#endif
#if SBL_GROUPS >= 5
#define SBL_IF_3(x) x
#else
#define SBL_IF_3(x)
#endif
#if SBL_GROUPS >= 6
#define SBL_IF_4(x) x
#else
#define SBL_IF_4(x)
#endif
#if SBL_GROUPS >= 7
#define SBL_IF_5(x) x
#else
#define SBL_IF_5(x)
#endif
#define SBL_OUT_LAYERS(a, b, c, d, e, f) \
    SBL_IF_0(SBL_OUT(a, out_layers_0);) SBL_IF_1(SBL_OUT(b, out_layers_1);) \
    SBL_IF_2(SBL_OUT(c, out_layers_2);) SBL_IF_3(SBL_OUT(d, out_layers_3);) \
    SBL_IF_4(SBL_OUT(e, out_layers_4);) SBL_IF_5(SBL_OUT(f, out_layers_5);)
#define sbl_write_layers(l) \
    SBL_IF_0(sbl_write(out_layers_0, sbl_layers_texel(l, 0));) \
    SBL_IF_1(sbl_write(out_layers_1, sbl_layers_texel(l, 1));) \
    SBL_IF_2(sbl_write(out_layers_2, sbl_layers_texel(l, 2));) \
    SBL_IF_3(sbl_write(out_layers_3, sbl_layers_texel(l, 3));) \
    SBL_IF_4(sbl_write(out_layers_4, sbl_layers_texel(l, 4));) \
    SBL_IF_5(sbl_write(out_layers_5, sbl_layers_texel(l, 5));)

// Returns floats 4 * texel to 4 * texel + 3 of the layers, or 0 beyond their end.
vec4 sbl_layers_texel(vec3 layers[SBL_GROUPS], int texel) {
    vec4 floats = vec4(0);
    for (int k = 0; k < 4; k++)
        if (4 * texel + k < 3 * SBL_GROUPS) floats[k] = layers[(4 * texel + k) / 3][(4 * texel + k) % 3];
    return floats;
}
#else
#define SBL_OUT_LAYERS(a, b, c, d, e, f)
#define sbl_write_layers(l)
#endif
