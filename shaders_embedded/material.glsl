// This file computes the emission, reflection and transmission of surfaces, and where they have holes. Other
// shaders read only the flags of a material. >>material in sbl.h computes the same on the CPU.
uniform float epsilon;     // ambient factor: a surface that does not emit has the radiance epsilon * albedo
uniform bool lamps_apart;  // true: lamps.glsl measures emitters, and sbl_outgoing adds them times lamp_mis
#ifdef SBL_SPECULAR
float lamp_mis = 0.0;      // if lamps_apart: MIS weight of the emission that a ray hits, see sbl_lobe_mis
#endif

// Returns the factor with which sbl_outgoing adds emission.
float sbl_emission_weight() {
#ifdef SBL_SPECULAR
    return lamps_apart ? lamp_mis : 1.0;
#else
    return lamps_apart ? 0.0 : 1.0;
#endif
}

// A material at a point, with its textures applied
struct sbl_Material {
    vec3 albedo;       // albedo; if the surface also has a lobe, the mean over all directions
    bool cut_out;      // true: the point lies in a hole
#ifdef SBL_SPECULAR
    vec3 diffuse;      // albedo of the diffuse component, seen along the normal
    vec3 reflectance;  // reflectance of the specular lobe, seen along the normal
    float roughness;   // 0 to 1; negative: the surface is matte
    float opacity;     // coverage of the surface at this point, 0 to 1
    vec3 clear;        // fraction of light that the covered part (see opacity) would let straight
                       // through if it reflected nothing
#endif
};

// Returns the opacity (coverage) of a surface at a point.
float sbl_opacity(int object, sbl_Attributes at) {
    float opacity = 1.0;
#ifdef SBL_SPECULAR
    for (int i = 0; i < ((sbl_object_flags(object) & SBL_BLEND) == 0u ? 0 : 1); i++)
        opacity = clamp(at.color.a * sbl_texture(sbl_object_albedo_texture(object), at.uv).a, 0.0, 1.0);
#endif
    return opacity;
}

sbl_Material sbl_material(int object, sbl_Attributes at) {
    vec4 texel = sbl_texture(sbl_object_albedo_texture(object), at.uv);
    vec4 color = at.color * texel * vec4(sbl_object_albedo(object), 1);
    bool cut_out = color.a < sbl_object_alpha_cutoff(object);
#ifdef SBL_SPECULAR
    sbl_Material m = sbl_Material(color.rgb, cut_out, color.rgb, vec3(0), -1.0, 1.0, vec3(0));
    float reflectance = sbl_object_reflectance(object);
    for (int i = 0; i < (reflectance < 0.0 ? 0 : 1); i++) {
        vec2 factors = sbl_texture(sbl_object_specular_texture(object), at.uv).gb;
        float metallic = clamp(factors.y * sbl_object_metallic(object), 0.0, 1.0);
        m.roughness = clamp(factors.x * sbl_object_roughness(object), 0.0, 1.0);
        m.diffuse = (1.0 - metallic) * (1.0 - reflectance) * color.rgb;
        m.reflectance = mix(vec3(reflectance), min(color.rgb, vec3(1)), metallic);
        m.clear = (1.0 - metallic) * min(color.rgb, vec3(1));
    }
    if (reflectance < 0.0) m.clear = min(color.rgb, vec3(1));
    float transmission = sbl_object_transmission(object);
    if (transmission > 0.0) transmission *= sbl_texture(sbl_object_transmission_texture(object), at.uv).r;
    m.opacity = sbl_opacity(object, at);
    m.clear *= m.opacity * transmission;
    m.diffuse *= m.opacity * (1.0 - transmission);
    m.albedo = m.diffuse;
    if (m.roughness >= 0.0) m.albedo = sbl_albedo_mean(m.diffuse, m.reflectance, m.roughness, m.opacity);
    return m;
#else
    return sbl_Material(color.rgb, cut_out);
#endif
}

// Increases the roughness of a surface if a pixel covers many normals. mean: length of the mean of these unit
// vectors, from which their variance follows if they have a von Mises-Fisher distribution (Banerjee et al. 2005,
// "Clustering on the Unit Hypersphere"). alpha^2 is twice the variance of slopes (Olano and Baker 2010, "LEAN
// Mapping").
void sbl_blur_by_normals(inout sbl_Material m, float mean) {
#ifdef SBL_SPECULAR
    float alpha = m.roughness * m.roughness, m2 = mean * mean;
    float variance = (1.0 - m2) / max(mean * (3.0 - m2), SBL_DIVISOR_LEAST);
    if (m.roughness >= 0.0 && m2 < 1.0) m.roughness = min(sqrt(sqrt(alpha * alpha + 2.0 * variance)), 1.0);
#endif
}

#ifdef SBL_SPECULAR
// Returns true if the surface has a lobe and this reflectance exceeds SBL_STRONG.
bool sbl_is_strong(sbl_Material m, vec3 reflectance) {
    return m.roughness >= 0.0 && max(reflectance.r, max(reflectance.g, reflectance.b)) > SBL_STRONG;
}

// Returns true if the surface is gloss of a roughness below SBL_GLOSS_ROUGH. Some of the rays that hit it continue
// in its lobe; the others find only its diffuse component (see sbl_face_ray).
bool sbl_hit_as_gloss(sbl_Material m) {
    return m.roughness >= 0.0 && m.roughness < SBL_GLOSS_ROUGH && !sbl_is_strong(m, m.reflectance);
}

// Returns the fraction of light that passes straight through a surface. cosine: between its normal and the light
vec3 sbl_passing(int object, sbl_Material m, float cosine) {
    float reflectance = sbl_object_reflectance(object);
    vec3 fresnel = reflectance < 0.0 ? vec3(0) : sbl_fresnel(vec3(reflectance), abs(cosine));
    return vec3(1.0 - m.opacity) + (1.0 - fresnel) * m.clear;
}
#endif

// Returns false if no point of the object lies in a hole, so that callers need not call sbl_material to find out.
bool sbl_has_holes(int object) { return sbl_object_alpha_cutoff(object) > 0.0; }

// Returns true for the back of a surface that emits only from its front.
bool sbl_dark_side(int object, bool back) {
    return back && (sbl_object_flags(object) & SBL_ONE_SIDED_EMISSION) != 0u;
}

// Returns the radiance that one side of a surface emits, before the texture is applied.
vec3 sbl_emission(int object, bool back) {
    return sbl_dark_side(object, back) ? vec3(0) : sbl_object_emission(object);
}

// Returns true if one side of a surface emits light. Does not call sbl_emission: softpipe would confuse the sides.
bool sbl_emits(int object, bool back) {
    vec3 emission = sbl_object_emission(object);
    return max(max(emission.r, emission.g), emission.b) > 0.0 && !sbl_dark_side(object, back);
}

// Returns the factor of sbl_emission at a point: emission texture times opacity.
vec3 sbl_emission_pattern(int object, sbl_Attributes at) {
    return sbl_opacity(object, at) * sbl_texture(sbl_object_emission_texture(object), at.uv).rgb;
}

// Returns sbl_emission_pattern, or 0 if the point lies in a hole of the surface. Rays towards a lamp aim at all
// points of its triangles, including those in holes.
vec3 sbl_solid_emission_pattern(int object, sbl_Attributes at) {
    vec3 pattern = sbl_emission_pattern(object, at);
    for (int once = 0; once < (sbl_has_holes(object) ? 1 : 0); once++)
        if (sbl_material(object, at).cut_out) pattern = vec3(0);
    return pattern;
}

// Returns true if sbl_outgoing does not read `at`.
bool sbl_outgoing_is_plain(int object, bool back) {
#if !defined(SBL_TEXTURED)
    return true;
#elif defined(SBL_BOUNCED)
    return false;
#else
    return sbl_emits(object, back) ? sbl_emission_weight() == 0.0 : epsilon <= 0.0;
#endif
}

// Returns the radiance that a surface sends towards a sensor, without reflected stored light: Ck of the paper's
// equations 1 and 2. This is the emission of an emitter times sbl_emission_weight(), or epsilon * albedo for other
// surfaces.
vec3 sbl_outgoing(int object, bool back, sbl_Attributes at) {
    bool emits = sbl_emits(object, back);
    vec3 radiance = emits ? sbl_object_emission(object) : epsilon * sbl_object_albedo(object);
    if (emits) radiance *= sbl_emission_weight();
    if (!sbl_outgoing_is_plain(object, back)) {
        uvec4 entry = emits ? sbl_object_emission_texture(object) : sbl_object_albedo_texture(object);
        radiance *= ((emits ? vec4(1) : at.color) * sbl_texture(entry, at.uv)).rgb;
        if (emits) radiance *= sbl_opacity(object, at);
    }
    return radiance;
}

// Returns the radiance that a surface reflects. light: R at the surface
vec3 sbl_reflected(sbl_Material m, vec3 light) { return m.albedo * light; }

// Returns the part of the albedo with which lamps.glsl measures the light of a glow (see >>glow in sbl.h). For
// gloss, this is only the diffuse component, because rays that hit gloss find the light of its lobe.
vec3 sbl_glow_albedo(sbl_Material m) {
#ifdef SBL_SPECULAR
    if (sbl_hit_as_gloss(m)) return (1.0 - SBL_DIFFUSE_LOST) * m.diffuse;
#endif
    return m.albedo;
}

// Returns the radiance that a surface reflects, without the part that rays to glows measure. glow: R from the glow
vec3 sbl_reflected_beside(sbl_Material m, vec3 light, vec3 glow) {
    return m.albedo * light - sbl_glow_albedo(m) * glow;
}

// Returns the factor of a glow's radiance at a point: sbl_glow_albedo at the point, divided by the albedo with
// which sbl__reflect computed the radiance.
vec3 sbl_glow_pattern(int object, sbl_Attributes at) {
#ifdef SBL_SPECULAR
    sbl_Material m = sbl_material(object, at);
    float least = sbl_object_reflectance(object) < 0.0 ? SBL_DIVISOR_LEAST : SBL_GLOW_ALBEDO;
    return m.cut_out ? vec3(0) : sbl_glow_albedo(m) / max(sbl_object_albedo(object), vec3(least));
#else
    vec4 pattern = at.color * sbl_texture(sbl_object_albedo_texture(object), at.uv);
    return pattern.a < sbl_object_alpha_cutoff(object) ? vec3(0) : pattern.rgb;
#endif
}

#ifdef SBL_SPECULAR
// Returns the radiance that the diffuse component of a surface reflects. light: R at the surface
vec3 sbl_reflected_diffuse(sbl_Material m, vec3 light) { return m.diffuse * light; }

// Returns the radiance that the lobe of a surface reflects to a viewer at this cosine. light: mean radiance in the
// lobe
vec3 sbl_lobe_reflected(sbl_Material m, float cosine, vec3 light) {
    return m.opacity * sbl_specular_albedo(m.reflectance, m.roughness, cosine) * light;
}

// Returns the albedo of the lobe for a viewer at this cosine, but at least SBL_LOBE_LEAST, since it is a divisor.
vec3 sbl_lobe_shown(sbl_Material m, float cosine) {
    return m.opacity * max(sbl_specular_albedo(m.reflectance, m.roughness, cosine), vec3(SBL_LOBE_LEAST));
}

// Returns the fraction of light that a perfect mirror reflects at this cosine.
vec3 sbl_mirror_reflectance(sbl_Material m, float cosine) {
    return m.opacity * sbl_fresnel(m.reflectance, cosine);
}

// Returns the albedo of the diffuse component of a surface for a viewer at this cosine.
vec3 sbl_diffuse_albedo(sbl_Material m, float cosine) { return m.diffuse * (1.0 - sbl_diffuse_lost(cosine)); }
#endif

// Returns the albedo for bounces in the store: limited below 1, so that light fades even in closed white rooms.
// tint: factor of the light, see sbl_trace
vec3 sbl_bounced(sbl_Material m, vec3 tint) {
    return min(tint * clamp(m.albedo, 0.0, SBL_BOUNCE_ALBEDO), vec3(1));
}

// A reflected ray.
struct sbl_Bounce {
    vec3 direction;
    vec3 normal;  // unit normal, on the side where the ray starts
    vec3 weight;  // factor of the radiance that the ray returns
};

// Samples the direction of light that a surface reflects, with a cosine distribution. geometric_normal: of any
// length; if it is 0 (a triangle without area), to_receiver replaces it. u: uniform point in the unit square
sbl_Bounce sbl_bounce(sbl_Material m, vec3 geometric_normal, vec3 to_receiver, vec2 u) {
    vec3 normal = dot(geometric_normal, geometric_normal) > 0.0 ? normalize(geometric_normal) : to_receiver;
    return sbl_Bounce(sbl_by_cosine(sbl_frame(normal), u), normal, m.albedo);
}
