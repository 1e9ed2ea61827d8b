// Where a ray hits a surface, two rays continue the path: a ray to a lamp, and the next segment. trace.glsl traces
// them at hits of short rays and where hit_continues is true (at metal and panes, and for some rays at gloss).
// cast.glsl traces them only where sbl_is_strong is true, for example on metal.

#ifdef SBL_SPECULAR
// A surface that reflects a ray in its lobe gets at least the roughness SBL_BLURRED, or SBL_BLURRED_GLOSS if it is
// gloss. This blurs the light of lamps that arrives by way of mirrors; otherwise, single rays would show it as
// specks (Kaplanyan and Dachsbacher 2013, "Path Space Regularization for Holistic and Robust Light Transport").
// SBL_BLURRED_GLOSS is smaller, because gloss reflects less light than metal, so that its specks are fainter.
// Rays of a look's lobe (SBL_LOBE) have another minimum for all surfaces: SBL_BLURRED_LOBE times the roughness of
// that lobe.
const float SBL_BLURRED_LOBE = 0.5;
bool hit_continues = false;     // true: the ray continues in the lobe of the surface that it has hit
float ray_density = 0.0;     // pdf, per solid angle, with which the ray's direction was sampled, for MIS
                             // (sbl_lobe_mis); 0: ignore lamps that the ray hits

// Sets hit_continues for a hit. Gloss that reflects less than SBL_STRONG for the angle between ray and surface
// continues only some of the rays, with the probability reflectance / SBL_STRONG, but at least chance_least.
// m.opacity, a factor of the lobe, is divided by this probability. A pane continues every ray, because sbl_passes
// has chosen the rays that the pane reflects. The albedo of gloss becomes the albedo of its diffuse component for
// this angle. direction: direction of the ray. last: true if the ray ends here; no ray continues then, and the
// albedo includes the lobe
void sbl_face_ray(inout sbl_Material m, sbl_Hit hit, vec3 direction, bool last) {
    hit_continues = sbl_is_strong(m, m.reflectance);
    for (int once = 0; once < (sbl_hit_as_gloss(m) ? 1 : 0); once++) {
        vec3 p0 = sbl_triangle_corner_0(hit.triangle);
        vec3 side_1 = sbl_triangle_corner_1(hit.triangle) - p0, side_2 = sbl_triangle_corner_2(hit.triangle) - p0;
        vec3 cross_product = cross(side_1, side_2);
        float sizes = length(cross_product) * length(direction);
        float cosine = sizes > 0.0 ? abs(dot(cross_product, direction)) / sizes : 1.0;
        vec3 reflectance = sbl_fresnel(m.reflectance, cosine), reflected = sbl_lobe_reflected(m, cosine, vec3(1));
        float chance = min(max(reflectance.r, max(reflectance.g, reflectance.b)) / SBL_STRONG, 1.0);
        chance = max(chance, chance_least);
        if (max(m.clear.r, max(m.clear.g, m.clear.b)) > 0.0) chance = 1.0;
        hit_continues = sbl_random_of(hit, 1u) < chance;
        m.albedo = sbl_diffuse_albedo(m, cosine) + (last ? reflected : vec3(0));
        m.opacity /= max(chance, SBL_DIVISOR_LEAST);
    }
    hit_continues = hit_continues && !last;
}

// Returns the pdf, per solid angle, of the point that a ray hits, if it were sampled by area on the mesh.
float sbl_hit_density(sbl_Hit hit, vec3 direction) {
    vec3 p0 = sbl_triangle_corner_0(hit.triangle);
    return sbl_area_density(int(sbl_triangle_object(hit.triangle)), sbl_triangle_corner_1(hit.triangle) - p0,
                            sbl_triangle_corner_2(hit.triangle) - p0, hit.distance * direction);
}
#else
const float ray_density = 0.0;  // no lobe samples the direction of a ray
#endif

#ifdef SBL_BOUNCED
// The two rays that continue a path, see above. Both start at `from`.
struct sbl_Reflection {
    vec3 from;
    vec3 to_lamp;           // unit direction of the ray to a lamp
    float away;             // length of the ray to the lamp; 0: no lamp gives light
    int number;             // index of the lamp's triangle in the scene, or -1
    vec3 light;             // light that arrives from the lamp if the ray is unblocked
    bool glow;              // true: the lamp is a glow
    int layer;              // sbl_Lamp.layer of the lamp, see SBL_GROUPS
    vec3 direction;         // direction of the next segment
    vec3 throughput;        // factor by which the next segment changes the throughput of the path
    float density;          // becomes ray_density with the next segment. It is the pdf of the direction divided
                            // by SBL_LAMP_TRIES, because MIS weighs one direction against that many lamp points
};

#ifdef SBL_SPECULAR
// A narrow lobe reflects a small part of a lamp. Where hit_continues is true, this many points of the lamp are
// therefore tried, and one of them is taken with a chance in proportion to the light that would come from it
// unblocked (Talbot, Cline and Egbert 2005, "Importance Resampling for Global Illumination").
#ifdef SBL_LOBE
const int SBL_LAMP_TRIES = 1;  // more points make sensors of lobes slower, but not better
#else
const int SBL_LAMP_TRIES = 8;
#endif
// Step from point to point in the unit square (Roberts 2018, "The Unreasonable Effectiveness of Quasirandom
// Sequences")
const vec2 SBL_LAMP_STEP = vec2(0.7548776662, 0.5698402910);

// Replaces s, the point of lamp l at u, by the point that is taken. hit_lobe: lobe of the hit; pick: random
// number, 0 to 1. Returns the light / unit that the lobe would reflect from the point if nothing blocked it,
// divided by the chance of the point among those that were tried, times its MIS weight.
vec3 sbl_take_point(sbl_Lobe hit_lobe, sbl_Lamp l, vec2 u, float pick, inout sbl_Sample s) {
    sbl_Sample tried = s;
    vec3 light = vec3(0);
    float all = 0.0;
    for (int k = 1; k <= SBL_LAMP_TRIES; k++) {
        float mis = sbl_mis_of_lobe(l, tried, sbl_lobe_density(hit_lobe, tried.direction) / float(SBL_LAMP_TRIES));
        vec3 found = (1.0 - mis) * sbl_lobe_factor(hit_lobe, tried.direction) * tried.light;
        float weight = found.r + found.g + found.b;
        if (!(weight > 0.0)) weight = 0.0;  // also replaces NaN, see sbl_reflect
        all += weight;
        float chance = weight / max(all, 1e-30);
        bool takes = pick < chance;
        pick = min((takes ? pick : pick - chance) / max(takes ? chance : 1.0 - chance, 1e-7), 0.9999999);
        if (takes) {
            s = tried;
            light = found / weight;
        }
        if (k < SBL_LAMP_TRIES) tried = sbl_sample(l, fract(u + float(k) * SBL_LAMP_STEP));
    }
    return light * (all / float(SBL_LAMP_TRIES));
}
#endif

// In scenes with glows, this many points of lamps are tried where a diffuse surface reflects a ray, and one of
// them is taken as in sbl_take_point. With a single point, rays would often go to glows whose light has a small
// MIS weight.
const int SBL_DIFFUSE_TRIES = 4;

// Picks a lamp and a point on it. Returns an estimate of the light that a diffuse surface would reflect from all
// lamps if nothing blocked it: the light from this point, divided by the probability of picking it. tries: number
// of points that are tried. p, l and s receive the pick, the lamp and the point. p.chance is the probability of
// picking the lamp, and is valid only if tries is 1. random: two random numbers
vec3 sbl_pick_lamp(sbl_Material material, int tries, uvec2 random, out sbl_Pick p, out sbl_Lamp l,
                   out sbl_Sample s) {
    vec3 light = vec3(0);
    float all = 0.0, taken = 1.0;
    for (int k = 0; k < tries; k++) {
        sbl_Pick tried = sbl_Pick(0, 1.0, sbl_unit_square(random), false);
        sbl_descend(tried, sbl_cluster(0).beyond < lamp_nodes ? -1 : 0, random.x);
        sbl_Lamp lamp = sbl_lamp(tried.leaf);
        sbl_Sample point = sbl_sample(lamp, tried.u);
        vec3 found = sbl_reflected(material, point.light) * (unit / tried.chance);
        if (lamp.glow) found *= 1.0 - sbl_glow_mis(point.distance);
        float weight = found.r + found.g + found.b;
        if (!(weight > 0.0)) weight = 0.0;  // also replaces NaN, see sbl_reflect
        all += weight;
        uint pick = sbl_hash_step(random.y, 4u);
        random = uvec2(sbl_hash_step(pick, 5u), sbl_hash_step(pick, 6u));
        if (k == 0 || sbl_unit_square(uvec2(pick)).x * all < weight) {
            p = tried;
            l = lamp;
            s = point;
            light = found;
            taken = weight;
        }
    }
    return tries == 1 ? light : light * (all / (float(tries) * max(taken, 1e-30)));
}

// Samples the two rays that start at a hit: the ray to a lamp and the next segment. Called for hits of short rays
// (see SBL_SEGMENTS) and if hit_continues is true. direction: direction of the ray that arrives at the hit. hash:
// source of the random numbers
sbl_Reflection sbl_reflect(sbl_Hit hit, sbl_Material material, vec3 direction, uint hash) {
    vec3 p0 = sbl_triangle_corner_0(hit.triangle), e1 = sbl_triangle_corner_1(hit.triangle) - p0,
         e2 = sbl_triangle_corner_2(hit.triangle) - p0, e3 = e2 - e1;
    float longest = sqrt(max(dot(e1, e1), max(dot(e2, e2), dot(e3, e3))));
    vec3 cross_product = cross(e1 / longest, e2 / longest) * (hit.back ? -1.0 : 1.0);
    uvec4 random = uvec4(hash, 0, 0, 0);
    for (int k = 1; k < 4; k++) random[k] = sbl_hash_step(random[k - 1], uint(k));
    sbl_Bounce bounce = sbl_bounce(material, cross_product, -direction, sbl_unit_square(random.xy));
    sensor_normal = bounce.normal;
    above = SBL_OFFSET * (length(p0) + 2.0 * longest);
    position = p0 + hit.b1 * e1 + hit.b2 * e2;
    ray_origin = position + above * sensor_normal;
    sbl_Reflection r = sbl_Reflection(ray_origin, sensor_normal, 0.0, -1, vec3(0), false, 0, bounce.direction,
                                      bounce.weight, 0.0);
#ifdef SBL_SPECULAR
    sbl_Lobe hit_lobe;
    for (int once = 0; once < (hit_continues ? 1 : 0); once++) {
        ivec3 v = sbl_corners(hit.number);
        vec3 b = vec3(1.0 - hit.b1 - hit.b2, hit.b1, hit.b2);
        vec3 normal = b.x * sbl_attributes_normal(v.x) + b.y * sbl_attributes_normal(v.y) +
                      b.z * sbl_attributes_normal(v.z);
        normal = sbl_shading_normal(normal, sensor_normal, sensor_normal, direction);
#ifdef SBL_LOBE
        float least = SBL_BLURRED_LOBE * sqrt(lobe.alpha);
#else
        float least = sbl_hit_as_gloss(material) ? SBL_BLURRED_GLOSS : SBL_BLURRED;
#endif
        hit_lobe = sbl_lobe_of(normal, -direction, material.reflectance, max(material.roughness, least));
        r.direction = sbl_lobe_sample(hit_lobe, sbl_unit_square(random.xy), r.throughput);
        r.throughput *= material.opacity;
        r.density = sbl_lobe_density(hit_lobe, r.direction) / float(SBL_LAMP_TRIES);
        if (dot(r.direction, sensor_normal) <= 0.0) r.throughput = vec3(0);
    }
#endif
    if (lamp_leaves == 0) return r;
    int tries = bright_cells > 0 ? SBL_DIFFUSE_TRIES : 1;
#ifdef SBL_SPECULAR
    tries = hit_continues ? 1 : tries;
#endif
    sbl_Pick p;
    sbl_Lamp l;
    sbl_Sample s;
    r.light = sbl_pick_lamp(material, tries, random.zw, p, l, s);
    r.number = l.number;
    r.glow = l.glow;
    r.layer = l.layer;
#ifdef SBL_SPECULAR
    for (int once = 0; once < (hit_continues ? 1 : 0); once++) {
        float pick = sbl_unit_square(uvec2(sbl_hash_step(random.w, 4u))).x;
        r.light = sbl_take_point(hit_lobe, l, p.u, pick, s) * (material.opacity * unit / p.chance);
    }
#endif
#ifdef SBL_TEXTURED
    if (l.kind == SBL_LAMP_TRIANGLE) r.light *= sbl_lamp_pattern(l, s.b);
#endif
    bool bounded = s.distance < SBL_UNBOUNDED;
    vec3 to = bounded ? s.distance * s.direction - above * sensor_normal : s.direction;
    r.to_lamp = normalize(to);
    float away = bounded ? SBL_BEFORE_LAMP * length(to) : SBL_UNBOUNDED;
    bool lit = max(r.light.r, max(r.light.g, r.light.b)) > 0.0;  // false also for NaN, which occurs if the hit is
                                                                 // on the lamp itself
    r.away = lit ? away : 0.0;
    r.light = lit ? r.light : vec3(0);
    return r;
}
#endif
