// What a sensor's texel holds: Ck, and the distance along the view axis, negative where a back face is seen.
layout(location = 0) out vec4 out_radiance;
in vec3 place;              // where in the atlas it was put
uniform vec2 view_texture_size;    // texels
#if defined(SBL_TEXTURED) || defined(SBL_BOUNCED)
uniform float radiance_scale;
flat in int fragment_object;
#else
flat in vec3 radiance_front, radiance_back;
#endif
#ifdef SBL_TEXTURED
in vec2 fragment_uv;
in vec4 fragment_color;
#endif
#ifdef SBL_BOUNCED
flat in int fragment_triangle;
in vec3 fragment_way, fragment_place;
#endif
#ifdef SBL_WRITE_DEPTH
uniform float depth_scale;
#endif

const float SBL_NEAREST = 3e-8;  // that anything is seen, in extents of the scene
const float SBL_BESIDE = 0.4;    // texels that a fragment may lie beside its place,
const float SBL_BESIDE_ROUNDING = 3e-7;  // and what rounding adds to that at unit distance

// A triangle whose plane holds the sensor is a line. Rounding makes it a triangle that may lie anywhere, in the
// views of other sensors too: what is drawn there is not what is seen in that direction.
bool sbl_seen_here() {
    vec2 at = gl_FragCoord.xy / view_texture_size * 2.0 - 1.0;
    vec2 beside = abs(place.xy - at * place.z) * 0.5 * view_texture_size;
    return place.z > SBL_NEAREST && max(beside.x, beside.y) <= SBL_BESIDE * place.z + SBL_BESIDE_ROUNDING;
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
    vec3 light = sbl_stored(fragment_triangle, !gl_FrontFacing, fragment_place, length(fragment_way));
    radiance += radiance_scale * sbl_reflected(sbl_material(fragment_object, at), light);
#endif
    out_radiance = vec4(radiance, gl_FrontFacing ? 1.0 / gl_FragCoord.w : -1.0 / gl_FragCoord.w);
#ifdef SBL_WRITE_DEPTH
    gl_FragDepth = depth_scale * gl_FragCoord.w;
#endif
}
