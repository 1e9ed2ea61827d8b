// Writes a texel of a sensor's view.
layout(location = 0) out vec4 out_radiance;  // rgb: radiance towards the sensor (Ck of the paper); a: distance
                                             // along the view's axis in scene extents, negative for a back face
in vec3 clip;                                // x, y and w of the position in clip space
uniform vec2 view_texture_size;              // in texels
uniform float radiance_scale;
uniform int first_triangle;                  // index in the scene of the draw call's first triangle
flat in int fragment_object;
flat in vec3 radiance_front, radiance_back;
in vec2 fragment_uv;
in vec4 fragment_color;
in vec3 fragment_from_sensor, fragment_position;

const float SBL_NEAREST = 3e-8;  // smallest visible distance along a view's axis, in scene extents
const float SBL_BESIDE = 0.4;    // maximum distance between gl_FragCoord and the interpolated `clip`, in texels
const float SBL_BESIDE_ROUNDING = 3e-7;  // added to SBL_BESIDE * clip.z, for rounding errors

// Returns false for fragments at wrong positions. A triangle whose plane contains the sensor projects to a line;
// rounding may turn the line into a triangle anywhere, even in the views of other sensors.
bool sbl_seen_here() {
    vec2 at = gl_FragCoord.xy / view_texture_size * 2.0 - 1.0;
    vec2 beside = abs(clip.xy - at * clip.z) * 0.5 * view_texture_size;
    return clip.z > SBL_NEAREST && max(beside.x, beside.y) <= SBL_BESIDE * clip.z + SBL_BESIDE_ROUNDING;
}

void main() {
    if (!sbl_seen_here()) discard;
#ifdef SBL_TEXTURED
    sbl_Attributes at = sbl_Attributes(fragment_uv, fragment_color);
    if (sbl_has_holes(fragment_object) && sbl_material(fragment_object, at).cut_out) discard;
#else
    sbl_Attributes at = SBL_PLAIN;
#endif
#if defined(SBL_TEXTURED) || defined(SBL_BOUNCED)
    vec3 radiance = sbl_outgoing(fragment_object, !gl_FrontFacing, at) * radiance_scale;
#else
    vec3 radiance = gl_FrontFacing ? radiance_front : radiance_back;
#endif
#ifdef SBL_BOUNCED
    int number = first_triangle + gl_PrimitiveID;
    int leaf = sbl_leaf_at(number, !gl_FrontFacing, fragment_position, length(fragment_from_sensor));
    vec3 light = sbl_light_of(leaf);
    vec3 glow = sbl_glowing(leaf, number, !gl_FrontFacing, fragment_position, length(fragment_from_sensor));
    sbl_Material material = sbl_material(fragment_object, at);
    radiance += radiance_scale * sbl_reflected_beside(material, light, glow);
#endif
    out_radiance = vec4(radiance, gl_FrontFacing ? 1.0 / gl_FragCoord.w : -1.0 / gl_FragCoord.w);
#ifdef SBL_WRITE_DEPTH
    gl_FragDepth = SBL_VIEW_DEPTH * gl_FragCoord.w;
#endif
}
