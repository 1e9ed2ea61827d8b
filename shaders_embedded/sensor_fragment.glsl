// What a sensor's texel holds: Ck, and the distance along the view axis, negative where a back face is seen.
layout(location = 0) out vec4 out_radiance;
#ifdef SBL_TEXTURED
uniform float epsilon, radiance_scale;
uniform bool lamps_apart;  // light from emitting triangles comes from lamps.glsl
flat in uint fragment_object;
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
    uvec4 material = sbl_object(fragment_object, 0), light = sbl_object(fragment_object, 1);
    vec3 emission = uintBitsToFloat(light.rgb);
    bool emits = max(max(emission.r, emission.g), emission.b) > 0.0;
    if (emits && !gl_FrontFacing && (light.w & SBL_ONE_SIDED_EMISSION) != 0u) emits = false;
    vec3 radiance = vec3(0);
    float cutoff = uintBitsToFloat(material.w);
    if (cutoff > 0.0 || (!emits && epsilon > 0.0)) {
        vec4 albedo = fragment_color * sbl_texture(sbl_object(fragment_object, 2), fragment_uv);
        if (albedo.a < cutoff) discard;
        radiance = epsilon * uintBitsToFloat(material.rgb) * albedo.rgb;
    }
    if (emits && lamps_apart) radiance = vec3(0);
    else if (emits) radiance = emission * sbl_texture(sbl_object(fragment_object, 3), fragment_uv).rgb;
    radiance *= radiance_scale;
#else
    vec3 radiance = gl_FrontFacing ? radiance_front : radiance_back;
#endif
    out_radiance = vec4(radiance, gl_FrontFacing ? 1.0 / gl_FragCoord.w : -1.0 / gl_FragCoord.w);
#ifdef SBL_WRITE_DEPTH
    gl_FragDepth = depth_scale * gl_FragCoord.w;
#endif
}
