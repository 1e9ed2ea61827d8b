// What surfaces do with light: what they emit, what they reflect, where a reflected ray goes on, and where they
// have holes. No other shader reads a material; >>material in sbl.h is the same for the CPU.
uniform float epsilon;     // the ambient factor
uniform bool lamps_apart;  // light from emitters comes from lamps.glsl

// A material at a point, after its textures have been read.
struct sbl_Material {
    vec3 albedo;   // share of the light that is reflected, the same towards all directions
    bool cut_out;  // there is a hole here
};

sbl_Material sbl_material(int object, sbl_Attributes at) {
    vec4 texel = sbl_texture(sbl_object_albedo_texture(object), at.uv);
    vec4 color = at.color * texel * vec4(sbl_object_albedo(object), 1);
    return sbl_Material(color.rgb, color.a < sbl_object_alpha_cutoff(object));
}

// False: sbl_material finds no hole anywhere, and need not be asked.
bool sbl_has_holes(int object) { return sbl_object_alpha_cutoff(object) > 0.0; }

// True: this side of the surface does not emit, whatever the material's emission is.
bool sbl_dark_side(int object, bool back) {
    return back && (sbl_object_flags(object) & SBL_ONE_SIDED_EMISSION) != 0u;
}

// Radiance that one side of a surface emits, before its texture is applied.
vec3 sbl_emission(int object, bool back) {
    return sbl_dark_side(object, back) ? vec3(0) : sbl_object_emission(object);
}

// It does not ask sbl_emission, since softpipe then shows wrong sides.
bool sbl_emits(int object, bool back) {
    vec3 emission = sbl_object_emission(object);
    return max(max(emission.r, emission.g), emission.b) > 0.0 && !sbl_dark_side(object, back);
}

// The factor by which the texture changes the emission at a point.
vec3 sbl_emission_pattern(int object, sbl_Attributes at) {
    return sbl_texture(sbl_object_emission_texture(object), at.uv).rgb;
}

// True: sbl_outgoing does not read the attributes.
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

// Radiance that a surface sends towards a sensor besides the stored light that it reflects: Ck of equations 1 and
// 2, which is the radiance of an emitter, or the ambient factor times the colour.
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

// Radiance that a surface sends towards its receiver. light: R, which falls on it.
vec3 sbl_reflected(sbl_Material m, vec3 light) { return m.albedo * light; }

// The share of R that bounces in the store. It is below 1, since closed rooms would otherwise never grow dark.
vec3 sbl_bounced(sbl_Material m) { return clamp(m.albedo, 0.0, SBL_BOUNCE_ALBEDO); }

// A ray that goes on from a surface.
struct sbl_Bounce {
    vec3 direction;
    vec3 off;     // unit vector off the surface, on the side where the ray starts
    vec3 weight;  // what the radiance that the ray finds counts towards the receiver
};

// A direction from which light is reflected towards the receiver, drawn by the cosine. across: the surface's
// normal of any length, 0 where the triangle has no area. u: 0 to 1.
sbl_Bounce sbl_bounce(sbl_Material m, vec3 across, vec3 to_receiver, vec2 u) {
    vec3 normal = dot(across, across) > 0.0 ? normalize(across) : to_receiver;
    return sbl_Bounce(sbl_by_cosine(sbl_frame(normal), u), normal, m.albedo);
}
