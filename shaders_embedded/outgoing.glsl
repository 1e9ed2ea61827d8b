// What a surface sends towards a sensor: Ck of equations 1 and 2, an emitter's radiance, or the ambient factor
// times the colour; or the light that bounces there, which the store knows. All that sensors see comes through
// here.
uniform float epsilon;     // the ambient factor
uniform bool lamps_apart;  // light from emitters comes from lamps.glsl

bool sbl_emits(int object, bool back) {
    vec3 emission = sbl_object_emission(object);
    bool turned = back && (sbl_object_flags(object) & SBL_ONE_SIDED_EMISSION) != 0u;
    return max(max(emission.r, emission.g), emission.b) > 0.0 && !turned;
}

// Is what it sends known without its attributes? `back`: of its back side.
bool sbl_outgoing_is_plain(int object, bool back) {
#ifdef SBL_TEXTURED
#ifdef SBL_BOUNCED
    return false;
#else
    return sbl_emits(object, back) ? lamps_apart : epsilon <= 0.0;
#endif
#else
    return true;
#endif
}

// at: at the point, where it is not plain.
vec3 sbl_outgoing(int object, bool back, sbl_Attributes at) {
    bool emits = sbl_emits(object, back);
    vec3 radiance = emits ? sbl_object_emission(object) : epsilon * sbl_object_albedo(object);
    if (emits && lamps_apart) radiance = vec3(0);
#ifdef SBL_TEXTURED
    if (!sbl_outgoing_is_plain(object, back)) {
        uvec4 place = emits ? sbl_object_emission_texture(object) : sbl_object_albedo_texture(object);
        radiance *= ((emits ? vec4(1) : at.color) * sbl_texture(place, at.uv)).rgb;
    }
#endif
    return radiance;
}

#ifdef SBL_BOUNCED
// The light that a point reflects. number: of its triangle in the scene; distance: to whom.
vec3 sbl_reflected(int object, int number, bool back, vec3 position, float distance, sbl_Attributes at) {
    return sbl_albedo(object, at) * sbl_stored(number, back, position, distance);
}
#endif
