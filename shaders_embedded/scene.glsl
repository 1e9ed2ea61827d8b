// The scene as a shader sees it: triangles, objects and texels, all read by number.
// One object record per mesh (see sbl__object_record in sbl.h):
//   0  albedo r g b, alpha cutoff      floats as bits
//   1  emission r g b                  floats as bits;  flags
//   2  albedo texture:   first row in the texel store, width, height, kind (0 none, 1 8-bit sRGB, 2 16-bit float, +4 clamps)
//   3  emission texture: likewise
//   4  id, 0, 0, 0
#ifdef SBL_WIDE  // what grows with the scene is past the driver's limit for buffer textures, and stands in 2D ones (see sbl__texels_make)
#define sbl_Texels usampler2D
#define sbl_fetch(texels, i) texelFetch(texels, ivec2((i) & 4095, (i) >> 12), 0)
#else
#define sbl_Texels usamplerBuffer
#define sbl_fetch(texels, i) texelFetch(texels, i)
#endif

uniform sbl_Texels sbl_objects;
uniform sampler2D sbl_texels_srgb;   // all 8-bit sRGB textures, each starting on a row of its own, texel n of a texture at n % width, n / width
uniform sampler2D sbl_texels_float;  // all others

const int SBL_OBJECT_TEXELS = 5;
const uint SBL_ONE_SIDED_EMISSION = 1u;
const uint SBL_HIDDEN_FROM_CAMERA = 2u;
const uint SBL_HIDDEN_FROM_SENSORS = 4u;

uvec4 sbl_object(uint object, int field) { return sbl_fetch(sbl_objects, int(object) * SBL_OBJECT_TEXELS + field); }

vec4 sbl_texel(uvec4 texture_record, ivec2 at) {
    ivec2 size = ivec2(texture_record.yz);
    at = (texture_record.w & 4u) != 0u ? clamp(at, ivec2(0), size - 1) : at - size * ivec2(floor(vec2(at) / vec2(size)));
    at = clamp(at, ivec2(0), size - 1);  // the division above may round up for far repeats
    int index = at.y * size.x + at.x;
    if ((texture_record.w & 3u) == 1u) {
        int width = textureSize(sbl_texels_srgb, 0).x;
        return texelFetch(sbl_texels_srgb, ivec2(index % width, int(texture_record.x) + index / width), 0);
    }
    int width = textureSize(sbl_texels_float, 0).x;
    return texelFetch(sbl_texels_float, ivec2(index % width, int(texture_record.x) + index / width), 0);
}

// Bilinear, decoded before it is filtered; (0, 0) is the first texel's outer corner.
vec4 sbl_texture(uvec4 texture_record, vec2 uv) {
    if (texture_record.w == 0u) return vec4(1);
    if ((texture_record.w & 4u) == 0u) uv -= floor(uv);
    vec2 at = uv * vec2(texture_record.yz) - 0.5, corner = floor(at), f = at - corner;
    ivec2 c = ivec2(clamp(corner, vec2(-1e9), vec2(1e9)));
    return mix(mix(sbl_texel(texture_record, c), sbl_texel(texture_record, c + ivec2(1, 0)), f.x),
               mix(sbl_texel(texture_record, c + ivec2(0, 1)), sbl_texel(texture_record, c + ivec2(1, 1)), f.x), f.y);
}
