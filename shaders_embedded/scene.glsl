// The scene's triangles and textures.
uniform sbl_Texels sbl_indices;      // three vertex numbers per triangle
uniform sampler2D sbl_texels_srgb;   // texel table of all 8-bit sRGB textures. Texel n of a texture is in column
                                     // n % width of the table, n / width rows below the texture's first row.
uniform sampler2D sbl_texels_float;  // texel table, 16-bit floats, of all textures that are not 8-bit sRGB

// Vertex numbers of a triangle of the scene.
ivec3 sbl_corners(int triangle) {
    return ivec3(int(sbl_fetch(sbl_indices, 3 * triangle).x), int(sbl_fetch(sbl_indices, 3 * triangle + 1).x),
                 int(sbl_fetch(sbl_indices, 3 * triangle + 2).x));
}

struct sbl_Attributes { vec2 uv; vec4 color; };

const sbl_Attributes SBL_PLAIN = sbl_Attributes(vec2(0), vec4(1));  // attributes without any effect

vec4 sbl_unpack_color(uint rg, uint ba) { return vec4(rg & 65535u, rg >> 16, ba & 65535u, ba >> 16); }

vec4 sbl_texel(uvec4 place, ivec2 at) {
    ivec2 size = ivec2(place.yz);
    if ((place.w & SBL_TEXTURE_CLAMPS) == 0u) at -= size * ivec2(floor(vec2(at) / vec2(size)));
    at = clamp(at, ivec2(0), size - 1);  // also for far repeats: the quotient above may be rounded up
    bool srgb = (place.w & SBL_TEXTURE_KIND) == SBL_TEXTURE_SRGB;
    int index = at.y * size.x + at.x;
    int width = srgb ? textureSize(sbl_texels_srgb, 0).x : textureSize(sbl_texels_float, 0).x;
    ivec2 texel = ivec2(uint(index) % uint(width), place.x + uint(index) / uint(width));
    return srgb ? texelFetch(sbl_texels_srgb, texel, 0) : texelFetch(sbl_texels_float, texel, 0);
}

// Reads a texture with bilinear filtering of linear values. place: first row in the texel table, width, height,
// SBL_TEXTURE flags; all 0: no texture. uv: (0, 0) is the outer corner of the first texel. With
// SBL_SPECULAR, panes are cutouts, too, and need no textures; SBL_TEXTURED then tells whether there are textures.
vec4 sbl_texture(uvec4 place, vec2 uv) {
#if defined(SBL_TEXTURED) || (defined(SBL_CUTOUTS) && !defined(SBL_SPECULAR))
    if ((place.w & SBL_TEXTURE_CLAMPS) == 0u) uv -= floor(uv);
    vec2 at = uv * vec2(place.yz) - 0.5, corner = floor(at), f = at - corner;
    ivec2 c = ivec2(clamp(corner, vec2(-1e9), vec2(1e9)));
    vec4 sum = vec4(place.w == 0u ? 1 : 0);
    for (int i = 0; i < (place.w == 0u ? 0 : 4); i++) {
        ivec2 step = ivec2(i & 1, i >> 1);
        vec2 weight = mix(1.0 - f, f, vec2(step));
        sum += weight.x * weight.y * sbl_texel(place, c + step);
    }
    return sum;
#else
    return vec4(1);
#endif
}
