// Traces a part of a look's rays over the hemisphere, whose directions have a cosine distribution, and sums them.
// The outputs are those of reduce_blocks.glsl; out_hits.w is the variance of the luminance.
uniform usamplerBuffer sbl_sequence;  // Sobol points along a Morton curve, two 32-bit fractions each
uniform int rays;                     // number of rays per look
uniform int paired;                   // 1: an invocation traces pairs of rays; 0: single ones
uniform bool no_light;                // true: only distances are wanted: only a site's first look traces rays
uniform float spread;                 // 1: over the whole hemisphere; 0: all rays along the normal
uniform float distance_limit;         // larger distances of hits count as this distance in the mean
SBL_OUT(0, out_sum);
SBL_OUT(1, out_hits);
SBL_OUT_HARMONICS(2, 3, 4)
#ifdef SBL_DIRECTIONAL
SBL_OUT(5, out_even);                 // control variate for radiance 1 from everywhere: the exact harmonics minus
                                      // those that these rays measure; reduce_sum.glsl adds it, times the mean
                                      // radiance, to the measured harmonics
#endif

const float SBL_NEIGHBOURS = 0.62;  // measured variance / its estimate from pairs, at 16 to 256 rays

// Radiance that leaves a hit towards the ray's origin. goes_on: set to true if the ray needs a second segment,
// which finds the light that the returned radiance lacks
vec3 sbl_radiance(sbl_Hit hit, vec3 position, bool last, out bool goes_on, out sbl_Material material) {
    int object = int(sbl_triangle_object(hit.triangle));
    sbl_Attributes at = SBL_PLAIN;
    if (!sbl_outgoing_is_plain(object, hit.back)) at = sbl_attributes_of(hit);
    vec3 radiance = sbl_outgoing(object, hit.back, at);
    goes_on = false;
#ifdef SBL_BOUNCED
    material = sbl_material(object, at);
    goes_on = !last && hit.distance * per_cell < 1.0;
    int leaf = sbl_leaf_at(hit.number, hit.back, position, hit.distance);
    radiance += sbl_reflected(material, goes_on ? sbl_lamps_of(leaf) : sbl_light_of(leaf));
    radiance -= sbl_reflected(material, sbl_glowing(leaf, hit.number, hit.back, position, hit.distance));
#endif
    return radiance;
}

// Mean of 1 / cosine (to the normal) over the rays in u's stratum; each of the look's rays has its own stratum.
// The value of a single ray near the horizon is far too noisy.
float sbl_stratum_reciprocal(float u) {
    float n = float(rays), k = n - floor(u * n);
    return 2.0 * sqrt(n) / (sqrt(k) + sqrt(k - 1.0));
}

#ifdef SBL_BOUNCED
// Maximum number of segments of a ray. The mean light of a cell may differ much from the light at a hit that is
// nearer than the cell's width. At such a hit the ray takes only the lamps' part of the light in the store, and a
// second segment finds the bounced part.
const int SBL_LEGS = 2;

// Sets the origin and the direction of a ray's second segment. Returns the factor for the light that it finds.
vec3 sbl_go_on(sbl_Hit hit, sbl_Material material, uint hash, inout vec3 position, inout vec3 direction) {
    vec3 p0 = sbl_triangle_corner_0(hit.triangle), e1 = sbl_triangle_corner_1(hit.triangle) - p0,
         e2 = sbl_triangle_corner_2(hit.triangle) - p0, e3 = e2 - e1;
    float longest = sqrt(max(dot(e1, e1), max(dot(e2, e2), dot(e3, e3))));
    vec3 across = cross(e1 / longest, e2 / longest) * (hit.back ? -1.0 : 1.0);
    vec2 u = sbl_unit_square(uvec2(hash, sbl_hash_step(hash, 1u)));
    sbl_Bounce bounce = sbl_bounce(material, across, -direction, u);
    position = p0 + hit.b1 * e1 + hit.b2 * e2 + SBL_OFFSET * (length(p0) + 2.0 * longest) * bounce.off;
    direction = bounce.direction;
    return bounce.weight;
}
#else
const int SBL_LEGS = 1;
#endif

void main() {
    ivec2 texel = sbl_texel_of_invocation(), sheet = texel / blocks, within = texel % blocks;
    int sensor = sheet.y * columns + sheet.x - first_slot;
    if (sensor < 0 || sensor >= count) sbl_leave;
    vec3 position = sbl_look_position(sensor);
    mat3 frame = sbl_frame(sbl_look_normal(sensor));
    uvec2 scramble = sbl_look_scramble(sensor);
    uint which = sbl_look_which(sensor);
    int number = int(which & SBL_LOOK_NUMBER), skip = number * rays, end = no_light && number > 0 ? 0 : rays;

    vec4 sum = vec4(0), hits = vec4(0, 0, SBL_UNBOUNDED, 0);
    float squares = 0.0, other = 0.0;
    mat3x4 harmonics = mat3x4(0);  // stays 0 without SBL_DIRECTIONAL; so does the variable `even`
    vec4 even = vec4(0);
    int part = within.y * blocks.x + within.x, parts = blocks.x * blocks.y;
    // The variance is estimated from the differences between pairs of neighbours on the Morton curve.
    for (int k = 0, i = part << paired; i < end;
         k++, i = (part + (k >> paired) * parts << paired) + (k & paired)) {
        vec3 before = sum.rgb;
        uvec2 fraction = texelFetch(sbl_sequence, skip + i).xy ^ scramble;
        vec2 u = sbl_unit_square(fraction);
        float weight = 1.0;
#ifdef SBL_GUIDED
        weight = sbl_guide(int(which >> SBL_LOOK_GUIDE_SHIFT), u);
#endif
        vec3 direction = sbl_by_cosine(frame, u * vec2(spread, 1.0)), from = position, share = vec3(weight);
        vec3 way = direction;
        for (int leg = 0; leg < SBL_LEGS; leg++) {
            sbl_Hit hit = sbl_trace(from, direction, SBL_UNBOUNDED);
            if (hit.triangle < 0) {
                sum.rgb += share * sbl_sky(direction);
                break;
            }
            bool goes_on;
            sbl_Material material;
            vec3 place = from + direction * hit.distance;
            sum.rgb += share * sbl_radiance(hit, place, leg == SBL_LEGS - 1, goes_on, material);
            if (leg == 0) {
                sum.a += hit.back ? weight : 0.0;
                hits.xy += weight * vec2(1.0, min(hit.distance, distance_limit));
                hits.z = min(hits.z, hit.distance);
            }
            if (!goes_on) break;
#ifdef SBL_BOUNCED
            uint hash = sbl_hash_step(sbl_hash_step(scramble.x, uint(skip + i)), scramble.y);
            share *= sbl_go_on(hit, material, hash, from, direction);
            if (max(share.r, max(share.g, share.b)) <= 0.0) break;
#endif
        }
        vec4 counts = sbl_harmonics(way, frame[2], sbl_stratum_reciprocal(u.x));
        harmonics += outerProduct(counts, sum.rgb - before);
        even -= weight * counts;
        float light = dot(sum.rgb - before, SBL_LUMINANCE);
        if ((k & 1) == 1) squares += (light - other) * (light - other);
        other = light;
    }
    sbl_write(out_sum, sum / float(rays));
    if (sbl_cut_short()) hits.z = SBL_LOST;
    sbl_write(out_hits, vec4(hits.xy / float(rays), hits.z, SBL_NEIGHBOURS * squares / float(rays * rays)));
    harmonics /= float(rays);
    sbl_write_harmonics(harmonics);
#ifdef SBL_DIRECTIONAL
    sbl_write(out_even, sbl_harmonics(frame[2], frame[2], 2.0) / float(parts) + even / float(rays));
#endif
}
