// What a sensor's texel holds: Ck, and the distance along the view axis, negative where a back face is seen.
layout(location = 0) out vec4 out_radiance;
#ifdef SBL_TEXTURED
uniform float radiance_scale;
flat in int fragment_object;
in vec2 fragment_uv;
in vec4 fragment_color;
#else
flat in vec3 radiance_front, radiance_back;
#endif
#ifdef SBL_WRITE_DEPTH
uniform float depth_scale;
#endif

void main() {
#ifdef SBL_TEXTURED
    sbl_Attributes at = sbl_Attributes(fragment_uv, fragment_color);
    if (sbl_object_alpha_cutoff(fragment_object) > 0.0 && !sbl_solid(fragment_object, at)) discard;
    vec3 radiance = sbl_outgoing(fragment_object, !gl_FrontFacing, at) * radiance_scale;
#else
    vec3 radiance = gl_FrontFacing ? radiance_front : radiance_back;
#endif
    out_radiance = vec4(radiance, gl_FrontFacing ? 1.0 / gl_FragCoord.w : -1.0 / gl_FragCoord.w);
#ifdef SBL_WRITE_DEPTH
    gl_FragDepth = depth_scale * gl_FragCoord.w;
#endif
}
