// An invocation traces some of a look's rays over the hemisphere, with a cosine distribution of directions, and
// sums their light. The outputs have the same meaning as in reduce_blocks.glsl, but out_hits.w is the variance of
// the luminance of these rays, and out_hits.z is SBL_LOST if rays were lost. If counts_steps is true, out_hits.y
// is not a mean distance but the number of steps of these rays through the hierarchy, divided by `rays`. If
// `paired` is 0, the invocation traces one ray for an inspection: out_sum.a is its weight divided by `rays`,
// out_hits.xyz its direction, and out_hits.w its distance, which is negative for a back face, or 0 if the ray hits
// nothing.
uniform usamplerBuffer sbl_sequence;  // Sobol points along a Morton curve, two 32-bit fractions each
uniform int rays;                     // number of rays per look
uniform int paired;                   // log2 of the size of groups of consecutive rays: 1: pairs; 0: single rays.
                                      // The invocations of a look take these groups in turn
uniform bool no_light;                // true: rays cannot find light, so only a site's first look traces them
uniform float hemisphere;             // 1: rays over the whole hemisphere; 0: all rays along the normal
uniform float ray_length;             // a ray ends at this length, and then sees the sky
uniform float distance_limit;         // larger distances count as this one in the mean distance
// SBL_POOLED: if it is defined, a workgroup traces the first segments of all its rays. Its invocations then share
// the rays that continue
SBL_OUT(0, out_sum);
SBL_OUT(1, out_hits);
SBL_OUT_HARMONICS(2, 3, 4)
SBL_OUT_LAYERS(2, 3, 4, 5, 6, 7)
#ifdef SBL_DIRECTIONAL
SBL_OUT(5, out_control);  // control variate, for radiance 1 from everywhere: the exact harmonics minus those that
                          // these rays measure. reduce_sum.glsl adds it, times the mean radiance, to the measured
                          // harmonics
#endif

const int SBL_MIRROR_RAYS = 8;      // number of rays of a look at a perfect mirror
const float SBL_NEIGHBOURS = 0.62;  // measured variance / its estimate from pairs, at 16 to 256 rays
// sbl_is_short gets the length of the first segment times this factor, so that hits up to 0.5 / 0.7 lengths of a
// cell are near. A smaller factor reduces errors at window frames, but adds noise and time.
const float SBL_FIRST_SCALE = 0.7;

// For rays of a lobe, SBL_FIRST_SCALE is lowered to this times the lobe's alpha, if that is less, because a
// narrow lobe does not average over cells.
const float SBL_LOBE_SCALE = 0.5;

vec3 arriving = vec3(0);              // direction of the ray that found the last hit
float glow_mis = 0.0;                 // MIS weight, like lamp_mis, for glows

#ifdef SBL_GROUPS
uniform int sky_layer;          // layer of the sky
vec3 layers[SBL_GROUPS];        // sum of the rays' light, by layer
vec3 carried;                   // throughput of the ray up to the current hit

void sbl_add_layer(int layer, vec3 light) {
    for (int g = 0; g < SBL_GROUPS; g++) layers[g] += g == layer ? light : vec3(0);
}

// Adds the light of a lamp. glow, layer: fields of sbl_Lamp
void sbl_add_lamp(bool glow, int layer, vec3 light) {
    for (int g = 0; g < SBL_GROUPS; g++) layers[g] += sbl_layer_fraction(glow, layer, g) * light;
}

#ifdef SBL_BOUNCED
// Adds `factor` times the layers of a leaf. leaf: result of sbl_leaf_at
void sbl_add_stored(int leaf, vec3 factor) {
    for (int g = 0; g < SBL_GROUPS; g++) layers[g] += factor * sbl_layer_of(leaf, g);
}
#endif
#else
const int sky_layer = 0;
#define sbl_add_layer(layer, light)
#define sbl_add_lamp(glow, layer, light)
#define sbl_add_stored(leaf, factor)
#endif

// Returns the radiance that leaves a hit towards the ray's origin. With SBL_GROUPS, also adds `carried` times this
// radiance to `layers`. first, last: true for the first and the last segment of a ray. continues: receives true if
// the hit is near or hit_continues is true, otherwise false. If true, the result does not contain reflected light,
// which further rays find; but if hit_continues is true, it contains the stored light that the diffuse component
// reflects. material: set only with SBL_BOUNCED. The result contains only the fraction glow_mis of the light of
// glows, because rays to lamps find it: those of lamps.glsl and, where a ray continues, that of sbl_continue_ray.
vec3 sbl_radiance(sbl_Hit hit, vec3 position, bool first, bool last, out bool continues,
                  out sbl_Material material) {
    int object = int(sbl_triangle_object(hit.triangle));
    sbl_Attributes at = SBL_PLAIN;
    if (!sbl_outgoing_is_plain(object, hit.back)) at = sbl_attributes_of(hit);
    vec3 radiance = sbl_outgoing(object, hit.back, at);
    sbl_add_layer(int(sbl_object_layer(object)), carried * radiance);
    continues = false;
#ifdef SBL_BOUNCED
    material = sbl_material(object, at);
#ifdef SBL_LOBE
    float first_scale = min(SBL_FIRST_SCALE, SBL_LOBE_SCALE * lobe.alpha);
#else
    const float first_scale = SBL_FIRST_SCALE;
#endif
    continues = !last && sbl_is_short(first ? first_scale * hit.distance : hit.distance);
#ifdef SBL_SPECULAR
    sbl_face_ray(material, hit, arriving, last);
    continues = continues || hit_continues;
    bool reads_store = !continues || hit_continues || bright_cells > 0;
#else
    bool reads_store = !continues || bright_cells > 0;
#endif
    if (reads_store) {
        int leaf = sbl_leaf_at(hit.number, hit.back, position, hit.distance);
        vec3 light = continues ? vec3(0) : sbl_light_of(leaf);
        sbl_add_stored(leaf, continues ? vec3(0) : carried * sbl_reflected(material, vec3(1)));
#ifdef SBL_SPECULAR
        // The lobe of the hit continues the ray; the diffuse component reflects stored light.
        if (hit_continues) radiance += sbl_reflected_diffuse(material, sbl_light_of(leaf));
        sbl_add_stored(leaf, hit_continues ? carried * sbl_reflected_diffuse(material, vec3(1)) : vec3(0));
#endif
        vec3 glow = (1.0 - glow_mis) * sbl_glowing(leaf, hit.number, hit.back, position, hit.distance);
        sbl_add_stored(bright_cells > 0 ? leaf : 0,
                       carried * sbl_reflected_beside(material, vec3(0), vec3(1.0 - glow_mis)));
        radiance += sbl_reflected_beside(material, light, glow);
    }
#endif
    return radiance;
}

// Returns the mean of 1 / cosine (to the normal) over the stratum of u; each of the look's rays has its own
// stratum. The value of a single ray near the horizon would be far too noisy.
float sbl_stratum_reciprocal(float u) {
    float n = float(rays), k = n - floor(u * n);
    return 2.0 * sqrt(n) / (sqrt(k) + sqrt(k - 1.0));
}

#ifdef SBL_BOUNCED
// Maximum number of segments of a ray. At hits of short rays (see sbl_is_short and SBL_FIRST_SCALE), the mean
// light of the cell may differ much from the light at the hit. Therefore the store is not read there, except to
// subtract the light of glows: instead, a ray to a lamp or glow finds the light of lamps and glows, and the next
// segment finds the rest of the bounced light. The last segment reads the store at any distance.
const int SBL_SEGMENTS = 3;
#else
const int SBL_SEGMENTS = 1;
#endif

// The ray that is traced, and sums over the rays of the invocation
vec3 from, direction, throughput;     // origin, direction and throughput of the segment that is traced
float limit;                          // the segment ends at this length
vec3 first_direction = vec3(0);       // direction of the first segment
vec2 u;                               // point of the unit square that gives first_direction
float weight = 0.0;                   // weight of the ray
vec4 sum = vec4(0), hits = vec4(0, 0, SBL_UNBOUNDED, 0);

// Begins the ray of a look at point u of the unit square. ray_weight: factor of the ray's light. Returns false if
// the ray starts below the horizon, where it finds no light.
bool sbl_begin(int look, float ray_weight) {
    mat3 frame = sbl_frame(sbl_look_normal(look));
    from = sbl_look_position(look);
    weight = ray_weight;
#ifdef SBL_SPECULAR
    ray_density = 0.0;
#endif
#ifdef SBL_SEES_MIRRORED
    bool to_mirrored = !scouts && u.x < mirrored_rays;
    float others = scouts ? 0.0 : mirrored_rays;
    u.x = to_mirrored ? u.x / mirrored_rays : (u.x - others) / (1.0 - others);
    vec2 u_mirrored = u;
#endif
#ifdef SBL_GUIDED
    int guide = int(sbl_look_which(look) >> SBL_LOOK_GUIDE_SHIFT);
    weight = sbl_guide(guide, u);
#endif
    direction = sbl_by_cosine(frame, u * vec2(hemisphere, 1.0));
#ifdef SBL_SEES_MIRRORED
    for (int once = 0; once < (to_mirrored ? 1 : 0); once++) {
        direction = sbl_mirrored_sample(u_mirrored);
        u = sbl_by_cosine_inverse(direction * frame);
#ifdef SBL_GUIDED
        weight = 1.0 / max(sbl_guide_density(guide, u), SBL_DIVISOR_LEAST);
#endif
    }
    for (int once = 0; once < (mirrored_rays > 0.0 ? 1 : 0); once++) {
        float cosine = max(dot(direction, frame[2]), 0.0);
        float mirrored = mirrored_rays * sbl_mirrored_density(direction);
        float density = mirrored + (1.0 - mirrored_rays) * cosine / (SBL_PI * weight);
        weight = cosine / (SBL_PI * max(density, SBL_DIVISOR_LEAST));
        chance_least = mirrored / max(density, SBL_DIVISOR_LEAST);
    }
#endif
    throughput = vec3(weight);
#ifdef SBL_LOBE
    for (int once = 0; once < (hemisphere > 0.0 ? 1 : 0); once++) direction = sbl_lobe_sample(lobe, u, throughput);
    throughput *= hemisphere > 0.0 ? ray_weight * lobe_scale : vec3(1);
    ray_density = lobe_rough ? 0.0 : sbl_lobe_density(lobe, direction);
#endif
    first_direction = direction;
    limit = ray_length;
#ifdef SBL_LOBE
    return max(throughput.r, max(throughput.g, throughput.b)) > 0.0;
#elif defined(SBL_SEES_MIRRORED)
    return weight > 0.0;
#else
    return true;
#endif
}

// Traces the current segment, whose index is `segment`, and adds the light that it finds to `sum`. hit and
// material receive what it hits. Returns true if the ray continues from there.
bool sbl_follow(int segment, out sbl_Hit hit, out sbl_Material material) {
    hit = sbl_trace(from, direction, limit, SBL_RAY_PATH);
    throughput *= sbl_tint;
    if (hit.triangle < 0) {
        vec3 seen_sky = throughput * sbl_sky(direction, ray_density);
        sum.rgb += seen_sky;
        sbl_add_layer(sky_layer, seen_sky);
        return false;
    }
#ifdef SBL_SPECULAR
    lamp_mis = 0.0;
    if (ray_density > 0.0) lamp_mis = sbl_lobe_mis(ray_density, sbl_hit_density(hit, direction));
#endif
#ifdef SBL_BOUNCED
    glow_mis = segment == 0 ? 0.0 : sbl_glow_mis(hit.distance);
#ifdef SBL_SPECULAR
    if (ray_density > 0.0) glow_mis = sbl_lobe_mis(ray_density, SBL_GLOW_DENSITY);
#endif
#endif
    vec3 position = from + direction * hit.distance;
#ifdef SBL_GROUPS
    carried = throughput;
#endif
#ifdef SBL_SPECULAR
    arriving = direction;
#endif
    bool continues;
    sum.rgb += throughput * sbl_radiance(hit, position, segment == 0, segment == SBL_SEGMENTS - 1, continues,
                                         material);
    if (segment == 0) {
        sum.a += hit.back ? weight : 0.0;
        hits.xy += weight * vec2(1.0, min(hit.distance, distance_limit));
        hits.z = min(hits.z, hit.distance);
    }
    return continues;
}

#ifdef SBL_BOUNCED
// Returns the source of a ray's random numbers. number: the ray's index in the sequence
uint sbl_ray_hash(uvec2 scramble, int number) {
    return sbl_hash_step(sbl_hash_step(scramble.x, uint(number)), scramble.y);
}

// Traces a shadow ray from a hit to a lamp or glow, adds its light to `sum`, and begins the next segment.
// hash: source of the random numbers. Returns false if the next segment would carry no light.
bool sbl_continue_ray(sbl_Hit hit, sbl_Material material, uint hash) {
    sbl_Reflection next = sbl_reflect(hit, material, direction, hash);
    from = next.from;
    sbl_Hit between = sbl_trace(from, next.to_lamp, next.away, SBL_RAY_SHADOW);
    if (between.triangle < 0 || between.number == next.number) {
        sum.rgb += throughput * sbl_tint * next.light;
        sbl_add_lamp(next.glow, next.layer, throughput * sbl_tint * next.light);
    }
    throughput *= next.throughput;
    direction = next.direction;
#ifdef SBL_SPECULAR
    ray_density = next.density;
#endif
    limit = SBL_UNBOUNDED;
    return max(throughput.r, max(throughput.g, throughput.b)) > 0.0;
}
#endif

#ifdef SBL_POOLED
// On a software renderer, a workgroup is a vector of invocations that run in lockstep. All of them execute the
// long code of sbl_continue_ray if one ray continues, and even if none does. The rays that continue are therefore
// collected in a pool. The invocations take rays from it, so that each execution of the code serves a full vector.
// One pool holds rays at their first hit, another holds rays at their second. The terms of the light of each ray
// are kept: the invocation that owns the ray adds them in the same order as without pools, so that sums have the
// same bits.
const int SBL_POOL = SBL_POOL_RAYS * SBL_LOCKSTEP;  // number of rays of a workgroup
// The light of a ray is a sum of this many terms. The first segment finds one. Each hit where the ray continues
// adds two: one is the light of a lamp, and the next segment finds the other.
const int SBL_TERMS = 2 * SBL_SEGMENTS - 1;
shared int pool_counts[SBL_SEGMENTS];        // number of rays in each pool
shared vec4 pool_directions[2 * SBL_POOL];   // xyz: direction of the segment that ends at the hit; w: sbl_Hit.b1
shared vec4 pool_throughputs[2 * SBL_POOL];  // rgb: throughput; a: sbl_Hit.b2
shared ivec2 pool_hits[2 * SBL_POOL];        // x: 2 * sbl_Hit.triangle + (1 for its back); y: index of the ray
shared uint pool_hashes[2 * SBL_POOL];
shared vec2 pool_chances[2 * SBL_POOL];      // x: chance_least; y: alpha of the look's lobe
shared vec3 pool_terms[SBL_TERMS * SBL_POOL];
shared int pool_steps[SBL_LOCKSTEP];         // per invocation: number of steps of its rays after their first hits
shared int pool_lost;                        // 1: an invocation has lost rays

// Adds the ray that is traced to the pool of this segment. ray: its index in the workgroup
void sbl_pool(int segment, sbl_Hit hit, int ray, uint hash) {
    int entry = segment * SBL_POOL + atomicAdd(pool_counts[segment], 1);
    pool_directions[entry] = vec4(direction, hit.b1);
    pool_throughputs[entry] = vec4(throughput, hit.b2);
    pool_hits[entry] = ivec2(2 * hit.triangle + (hit.back ? 1 : 0), ray);
    pool_hashes[entry] = hash;
    pool_chances[entry] = vec2(chance_least, 0);
#ifdef SBL_LOBE
    pool_chances[entry].y = lobe.alpha;
#endif
}

// Continues a ray of the pool by this segment. entry: index of the ray in the arrays of the pools
void sbl_take(int entry, int segment) {
    int triangle = pool_hits[entry].x >> 1, ray = pool_hits[entry].y, steps = sbl_steps;
    sbl_Hit hit = sbl_Hit(0.0, triangle, int(sbl_triangle_number(triangle)), pool_directions[entry].w,
                          pool_throughputs[entry].w, (pool_hits[entry].x & 1) != 0);
    direction = pool_directions[entry].xyz;
    throughput = pool_throughputs[entry].rgb;
    chance_least = pool_chances[entry].x;
#ifdef SBL_LOBE
    lobe.alpha = pool_chances[entry].y;
#endif
    sbl_Material material = sbl_material(int(sbl_triangle_object(triangle)), sbl_attributes_of(hit));
    sbl_face_ray(material, hit, direction, false);
    chance_least = 0.0;
    uint hash = pool_hashes[entry];
    int term = SBL_TERMS * ray + 2 * segment;
    sum.rgb = vec3(0);
    bool continues = sbl_continue_ray(hit, material, sbl_hash_step(hash, uint(2 * segment - 2)));
    pool_terms[term - 1] = sum.rgb;
    sum.rgb = vec3(0);
    if (continues) continues = sbl_follow(segment, hit, material);
    pool_terms[term] = sum.rgb;
    if (continues) sbl_pool(segment, hit, ray, hash);
    atomicAdd(pool_steps[ray / SBL_POOL_RAYS], sbl_steps - steps);
    sbl_steps = steps;  // the steps count for the invocation that owns the ray
}
#endif

void main() {
    ivec2 texel = sbl_texel_of_invocation(), sheet = texel / blocks, within = texel % blocks;
    int look = sheet.y * columns + sheet.x - first_slot;
#ifdef SBL_POOLED
    bool outside = look < 0 || look >= count;
    look = outside ? 0 : look;  // such an invocation has no rays of its own, but takes rays from the pools
#else
    const bool outside = false;
    if (look < 0 || look >= count) sbl_leave;
#endif
    vec3 normal = sbl_look_normal(look);
    uvec2 scramble = sbl_look_scramble(look);
#ifdef SBL_SEES_MIRRORED
    if (hemisphere > 0.0) sbl_mirrored_begin(sbl_look_position(look), normal);
#endif
    int number = int(sbl_look_which(look) & SBL_LOOK_NUMBER), skip = number * rays;
    int end = no_light && number > 0 || outside ? 0 : rays;
    float ray_weight = 1.0;  // factor of each ray's light
#ifdef SBL_LOBE
    sbl_lobe_begin(look, normal);
    if (lobe.alpha == 0.0 && hemisphere > 0.0 && rays > SBL_MIRROR_RAYS) {  // all rays of a mirror are alike
        end = min(end, SBL_MIRROR_RAYS);
        ray_weight = float(rays) / float(SBL_MIRROR_RAYS);
    }
#endif

    // The variance is estimated from the differences between pairs of neighbours on the Morton curve. squares:
    // sum of the squared differences; other: luminance of the previous ray
    float squares = 0.0, other = 0.0;
#ifdef SBL_GROUPS
    for (int g = 0; g < SBL_GROUPS; g++) layers[g] = vec3(0);
#endif
    mat3x4 harmonics = mat3x4(0);  // stays 0 without SBL_DIRECTIONAL, as `control` does
    vec4 control = vec4(0);
    int block = within.y * blocks.x + within.x, block_count = blocks.x * blocks.y;
#ifdef SBL_POOLED
    // mine: index of the invocation; first: index of its first ray; all: number of its rays so far
    int mine = int(gl_LocalInvocationIndex), first = mine * SBL_POOL_RAYS, all = 0;
    if (mine < SBL_SEGMENTS) pool_counts[mine] = 0;
    if (mine == 0) pool_lost = 0;
    pool_steps[mine] = 0;
    memoryBarrierShared();
    barrier();
    for (int i = block << paired; i < end;
         i = (block + (all >> paired) * block_count << paired) + (all & paired)) {
        int ray = first + all++;
        u = sbl_unit_square(texelFetch(sbl_sequence, skip + i).xy ^ scramble);
        for (int term = 0; term < SBL_TERMS; term++) pool_terms[SBL_TERMS * ray + term] = vec3(0);
        sbl_Hit hit;
        sbl_Material material;
        bool continues = sbl_begin(look, ray_weight);
        sum.rgb = vec3(0);
        if (continues) continues = sbl_follow(0, hit, material);
        pool_terms[SBL_TERMS * ray] = sum.rgb;
        if (continues) sbl_pool(0, hit, ray, sbl_ray_hash(scramble, skip + i));
    }
    for (int segment = 1; segment < SBL_SEGMENTS; segment++) {
        memoryBarrierShared();
        barrier();
        int filled = pool_counts[segment - 1];
        for (int j = mine; j < filled; j += SBL_LOCKSTEP) sbl_take((segment - 1) * SBL_POOL + j, segment);
    }
    if (sbl_cut_short()) pool_lost = 1;
    memoryBarrierShared();
    barrier();
    sum.rgb = vec3(0);
    for (int k = 0; k < all; k++) {
        vec3 before = sum.rgb;
        for (int term = 0; term < SBL_TERMS; term++) sum.rgb += pool_terms[SBL_TERMS * (first + k) + term];
        float light = dot(sum.rgb - before, SBL_LUMINANCE);
        if ((k & 1) == 1) squares += (light - other) * (light - other);
        other = light;
    }
    sbl_steps += pool_steps[mine];
    if (outside) return;
#else
    for (int k = 0, i = block << paired; i < end;
         k++, i = (block + (k >> paired) * block_count << paired) + (k & paired)) {
        vec3 before = sum.rgb;
        u = sbl_unit_square(texelFetch(sbl_sequence, skip + i).xy ^ scramble);
        // Each iteration traces a segment of the ray and, if the ray continues, a shadow ray from the hit to a
        // lamp. A separate iteration for the shadow ray would be slower: software renderers execute the whole body
        // in each iteration.
        int segments = sbl_begin(look, ray_weight) ? SBL_SEGMENTS : 0;
        for (int segment = 0; segment < segments; segment++) {
            sbl_Hit hit;
            sbl_Material material;
            bool continues = sbl_follow(segment, hit, material);
#ifdef SBL_SPECULAR
            chance_least = 0.0;
#endif
            if (!continues) break;
#ifdef SBL_BOUNCED
            uint hash = sbl_ray_hash(scramble, skip + i);
            if (!sbl_continue_ray(hit, material, sbl_hash_step(hash, uint(2 * segment)))) break;
#endif
        }
        vec4 to_harmonics = sbl_harmonics(first_direction, normal, sbl_stratum_reciprocal(u.x));
        harmonics += outerProduct(to_harmonics, sum.rgb - before);
        control -= weight * to_harmonics;
        float light = dot(sum.rgb - before, SBL_LUMINANCE);
        if ((k & 1) == 1) squares += (light - other) * (light - other);
        other = light;
    }
#endif
    if (counts_steps) hits.y = float(sbl_steps);
    vec4 inspected = vec4(first_direction, hits.x == 0.0 ? 0.0 : sum.a > 0.0 ? -hits.z : hits.z);
    if (paired == 0) sum.a = weight;
    sbl_write(out_sum, sum / float(rays));
    bool lost = sbl_cut_short();
#ifdef SBL_POOLED
    lost = lost || pool_lost > 0;
#endif
    if (lost) hits.z = SBL_LOST;
    hits = vec4(hits.xy / float(rays), hits.z, SBL_NEIGHBOURS * squares / float(rays * rays));
    sbl_write(out_hits, paired == 0 ? inspected : hits);
    harmonics /= float(rays);
    sbl_write_harmonics(harmonics);
#ifdef SBL_GROUPS
    for (int g = 0; g < SBL_GROUPS; g++) layers[g] /= float(rays);
    sbl_write_layers(layers);
#endif
#ifdef SBL_DIRECTIONAL
    sbl_write(out_control, sbl_harmonics(normal, normal, 2.0) / float(block_count) + control / float(rays));
#endif
}
