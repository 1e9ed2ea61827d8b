// The triangles and textures of the scene
uniform sbl_Texels sbl_indices;      // three vertex indices per triangle
uniform sampler2D sbl_texels_srgb;   // texels of all 8-bit sRGB textures, one after the other. Texel n of a
                                     // texture is in column n % width of the table, n / width rows below the
                                     // texture's first row
uniform sampler2D sbl_texels_float;  // texels of all other textures, as 16-bit floats

// Returns the vertex indices of a triangle of the scene.
ivec3 sbl_corners(int triangle) {
    return ivec3(int(sbl_fetch(sbl_indices, 3 * triangle).x), int(sbl_fetch(sbl_indices, 3 * triangle + 1).x),
                 int(sbl_fetch(sbl_indices, 3 * triangle + 2).x));
}

struct sbl_Attributes { vec2 uv; vec4 color; };

const sbl_Attributes SBL_PLAIN = sbl_Attributes(vec2(0), vec4(1));  // attributes without any effect

vec4 sbl_unpack_color(uint rg, uint ba) { return vec4(rg & 65535u, rg >> 16, ba & 65535u, ba >> 16); }

vec4 sbl_texel(uvec4 entry, ivec2 at) {
    ivec2 size = ivec2(entry.yz);
    if ((entry.w & SBL_TEXTURE_CLAMPS) == 0u) at -= size * ivec2(floor(vec2(at) / vec2(size)));
    at = clamp(at, ivec2(0), size - 1);  // needed for textures that repeat, too: the quotient above may be rounded
                                         // up
    bool srgb = (entry.w & SBL_TEXTURE_KIND) == SBL_TEXTURE_SRGB;
    int index = at.y * size.x + at.x;
    int width = srgb ? textureSize(sbl_texels_srgb, 0).x : textureSize(sbl_texels_float, 0).x;
    ivec2 texel = ivec2(uint(index) % uint(width), entry.x + uint(index) / uint(width));
    return srgb ? texelFetch(sbl_texels_srgb, texel, 0) : texelFetch(sbl_texels_float, texel, 0);
}

// Samples a texture bilinearly, in linear colour space. entry: first row in the table of texels, width, height,
// SBL_TEXTURE flags; all 0: no texture, returns 1. uv: (0, 0) is the outer corner of the first texel. With
// SBL_SPECULAR, panes count as cutouts but need no textures: only SBL_TEXTURED tells whether there are textures
vec4 sbl_texture(uvec4 entry, vec2 uv) {
#if defined(SBL_TEXTURED) || (defined(SBL_CUTOUTS) && !defined(SBL_SPECULAR))
    if ((entry.w & SBL_TEXTURE_CLAMPS) == 0u) uv -= floor(uv);
    vec2 at = uv * vec2(entry.yz) - 0.5, corner = floor(at), f = at - corner;
    ivec2 c = ivec2(clamp(corner, vec2(-1e9), vec2(1e9)));
    vec4 sum = vec4(entry.w == 0u ? 1 : 0);
    for (int i = 0; i < (entry.w == 0u ? 0 : 4); i++) {
        ivec2 step = ivec2(i & 1, i >> 1);
        vec2 weight = mix(1.0 - f, f, vec2(step));
        sum += weight.x * weight.y * sbl_texel(entry, c + step);
    }
    return sum;
#else
    return vec4(1);
#endif
}
