// Measures the light of lamps: emitting triangles, lights, bright texels of the sky, and glows, which are parts of
// surfaces that reflect much light. The light of an unobstructed lamp is known in closed form, and rays measure
// the fraction that arrives: the ratio estimator of Heitz, Hill and McGuire 2018, "Combining analytic direct
// illumination and stochastic shadows". If there are many lamps, lamps far from the sensor form clusters. A ray
// towards a cluster picks one of its lamps, with a probability proportional to the lamp's light.
//
//     choose   makes the list of entries: the lamps and clusters that give this sensor light, with their strengths
//     pick     picks one of the entries for a ray
//     shoot    traces the ray
//     combine  computes R from the results of all rays and from the closed forms
//
// The rays of a look are divided among `blocks.y` invocations. An invocation usually stops when its rays agree
// (see SBL_PASS_CHANCE). With SBL_INSPECT, an invocation reports one ray or one entry of the look.
uniform usamplerBuffer sbl_sequence;  // points in the unit square for the rays, as in trace.glsl
uniform int rays;                     // maximum number of rays per look, except rim samples and rays to points
uniform float scale;                  // factor from R to the output
#ifdef SBL_INSPECT
const bool inspected = true, directional = false;
uniform int invocations;              // number of invocations that measured the look, see sbl__aim
uniform int sheet_slot;               // slot of the look's views in the view texture
SBL_OUT(0, out_light);                // a ray: rgb: its light; a: 0: not traced, 1: reached the lamp, 2: blocked.
                                      // An entry: rgb: its unobstructed R; a: 1: lamp, 2: visible point light,
                                      // 3: hidden point light
SBL_OUT(1, out_direction);            // xyz: a ray's direction, or 0 for an entry; w: index of the lamp's leaf
#else
const bool inspected = false;
SBL_OUT(0, out_light);                // rgb: R that the invocation's rays measure * scale; a: variance of its
                                      // luminance
SBL_OUT_HARMONICS(1, 2, 3)            // spherical harmonics of the invocation's light * scale
SBL_OUT_LAYERS(1, 2, 3, 4, 5, 6)      // layers of the invocation's light * scale
#ifdef SBL_DIRECTIONAL
const bool directional = true;
#else
const bool directional = false;
#endif
#endif
const int SBL_CERTAIN = 32;         // maximum number of point lights that get one ray each
const float SBL_STRATA = 1.5;       // n stratified points give SBL_STRATA / sqrt(n) times the variance of n
                                    // independent points (measured with shadow edges on a lamp)
const float SBL_STRATA_LOST = 0.6;  // upper limit of SBL_STRATA / sqrt(n), for few points per lamp
const float SBL_OPENING = 0.3;      // a cluster is one entry if its radius is below this * its distance
const float SBL_GLOW_RAYS = 0.25;   // least fraction of the rays that glows get, because stronger lamps may be
                                    // hidden
const float SBL_FAVOUR_MOST = 1e6;  // upper limit of the factor by which the strengths of glows are increased
const int SBL_OPENINGS = 12;        // maximum number of attempts to fit all entries into their array; each attempt
                                    // doubles the opening
#ifdef SBL_LOBE
const float SBL_SPARSE = 4.0;       // an invocation that is expected to send fewer rays than this to the lamps
                                    // of one facing does not use the ratio seen / open for these lamps,
                                    // because the ratio of few rays is biased
#else
const float SBL_SPARSE = 16.0;
#endif
const int SBL_PASS_RAYS = 32;       // minimum number of rays per pass
const float SBL_PASS_CHANCE = 0.25; // probability that all passes are made although rays agree earlier
const float SBL_PASS_LAMPS = 16.0;  // maximum of (number of passes) * (effective number of lamps)
const int SBL_RIM_LAMPS = 8;        // with more entries than this, no lamp gets rim samples (rays to its edge)
const int SBL_CORNERS = 3;          // number of rim samples of a triangle, one close to each corner
const float SBL_CORNER = 0.996, SBL_OTHER_CORNER = 0.002;  // barycentrics of a rim sample: for the close corner,
                                                           // for others
const int SBL_RIM = 12;             // number of rim samples of a round lamp
const float SBL_RIM_AT = 0.99;      // fraction of a round lamp's area inside the circle of its rim samples
#ifdef SBL_LOBE
const float SBL_LOBE_STRENGTH = 0.05;  // added to the lobe's factor for picking lamps without a closed form
#endif
const float SBL_KNOWN = 1e-6;       // clusters need no more rays if (variance of their light) / (squared light)
                                    // is at most this

int look;                    // the look that is measured: its index in the batch
uvec2 scramble;

#ifdef SBL_VIEWS  // for geometry that only the host can draw: the sensor's views show if it hides the lamp
uniform sampler2D view_texture; // rgb: radiance towards the sensor; a: distance along the view's axis, < 0: back
                                // face
uniform vec4 view_rects[5];     // per view: x, y, width, height in the sheet, in texels
uniform ivec2 sheet;            // size of a sheet (the views of one look), in texels
uniform int view_count;
uniform float tangent;          // tangent of half the field of view
uniform float extent;           // scene extent in world units: unit of the view texture's distances

const float SBL_AT_LAMP = 0.002;  // relative tolerance for distances in views, which are 16-bit floats
const int SBL_TEXELS_COMPARED = 4;  // maximum number of texels that sbl_hidden compares for one ray

// Returns true if the views show a surface in front of the sample, or do not cover the sample's direction.
// Compares depths at a texel's centre. If the direction of that centre misses the lamp's triangle, compares again
// at a point closer to the middle of the triangle.
bool sbl_hidden(int slot, sbl_Lamp l, sbl_Sample s) {
    float rotation = sbl_look_rotation(look);
    mat3 frame = sbl_frame(sensor_normal);
    vec3 side_x = cos(rotation) * frame[0] - sin(rotation) * frame[1];
    vec3 side_y = -cos(rotation) * frame[1] - sin(rotation) * frame[0];
    vec3 sides[4] = vec3[4](side_x, side_y, -side_x, -side_y);  // axes of the side views, see sbl__view_axes
    vec3 normal = cross(l.side_1, l.side_2), point = s.distance * s.direction;
    vec3 middle = l.corner + (l.side_1 + l.side_2) / 3.0;
    if (l.kind != SBL_LAMP_TRIANGLE) point = s.direction;
    for (int attempt = 0; attempt < SBL_TEXELS_COMPARED; attempt++, point = mix(point, middle, 0.4)) {
        vec2 side = vec2(dot(point, side_x), dot(point, side_y));
        bool top = max(abs(side.x), abs(side.y)) <= dot(point, sensor_normal) * tangent;
        int face = top ? 0 : abs(side.x) > abs(side.y) ? (side.x > 0.0 ? 1 : 3) : (side.y > 0.0 ? 2 : 4);
        if (!top && view_count == 1) return true;
        vec3 forward = top ? sensor_normal : sides[max(face, 1) - 1], right = top ? side_x : sides[face % 4];
        vec3 up = top ? side_y : sensor_normal;
        vec4 rect = view_rects[face];
        vec2 lowest = vec2(-1, top ? -1 : 0), size = vec2(1) - lowest;
        vec2 at = (vec2(dot(point, right), dot(point, up)) / (dot(point, forward) * tangent) - lowest) / size;
        vec2 texel = clamp(floor(at * rect.zw), vec2(0), rect.zw - 1.0);
        vec2 centre = lowest + (texel + 0.5) / rect.zw * size;
        ivec2 sheet_texel = ivec2(slot % columns, slot / columns) * sheet + ivec2(rect.xy + texel);
        float shown = texelFetch(view_texture, sheet_texel, 0).a, seen = abs(shown) * extent;
        if (seen == 0.0) return false;
        if (l.kind != SBL_LAMP_TRIANGLE) return seen < (1.0 - SBL_AT_LAMP) * s.distance * dot(point, forward);
        vec3 ray = forward + tangent * (centre.x * right + centre.y * up);
        float there = dot(l.corner, normal) / dot(ray, normal);  // depth along `forward` of the lamp's plane at
                                                                 // this texel
        bool other_side = (shown < 0.0) != (l.facing.y == 1.0);  // true: the shown surface and the lamp differ in
                                                                 // facing
        bool beyond = seen > (1.0 + SBL_AT_LAMP) * there;
        if (there > 0.0 && (beyond || (seen >= (1.0 - SBL_AT_LAMP) * there && !other_side))) return false;
        vec2 b = sbl_barycentrics(l, normal, there * ray - l.corner);
        if (attempt == SBL_TEXELS_COMPARED - 1 || (there > 0.0 && min(b.x, b.y) >= 0.0 && b.x + b.y <= 1.0))
            return seen < (other_side ? 1.0 + SBL_AT_LAMP : 1.0 - SBL_AT_LAMP) * dot(point, forward);
    }
    return true;
}
#endif

// >>choose

int entries[SBL_LAMPS];      // n >= 0: lamp n; n < 0: the cluster of node -1 - n. The first SBL_CERTAIN point
                             // lights are stored backwards from the array's end
float strengths[SBL_LAMPS];  // [i]: sum of the strengths (approximate light) of entries 0 to i
int used, certain;           // number of entries at the array's start; number of point lights at its end
float total, strengths2;     // sums of the strengths of the `used` entries, and of their squares
float lamp_strengths2;       // estimate of strengths2 if all lamps of clusters were entries
ivec2 glow_entries;          // index of the first entry that consists of glows, and the index after the last
vec2 glow_strengths2;        // glows' parts of strengths2 and lamp_strengths2
mat2x3 whole;                // by facing (see sbl_Lamp): unobstructed light of all lamps outside clusters that
                             // have a closed form (see sbl_has_closed_form), except the `certain` point lights.
                             // Each facing has its own ratio seen / open, because one side of a closed mesh hides
                             // the other
bool any_round = false;      // true: some of the considered lamps are not triangles
mat3x4 whole_harmonics[2];   // by facing, like `whole`: the harmonics of that light
#ifdef SBL_GROUPS
vec3 whole_layers[2 * SBL_GROUPS];  // by facing, like `whole`: the layers for facing 0, then those for facing 1

// Adds the light of a lamp to sums ordered like whole_layers.
void sbl_add_layers(inout vec3 sums[2 * SBL_GROUPS], sbl_Lamp l, vec3 light) {
    for (int g = 0; g < SBL_GROUPS; g++) {
        vec3 group_light = light * sbl_layer_fraction(l.glow, l.layer, g);
        sums[g] += l.facing.x * group_light;
        sums[SBL_GROUPS + g] += l.facing.y * group_light;
    }
}
#else
#define sbl_add_layers(sums, l, light)
#endif

// Returns the R (divided by `unit`) that an unobstructed lamp causes at the sensor. With SBL_LOBE, returns the
// mean radiance (divided by `unit`) that the lobe receives from the lamp: for a triangle, the closed form for the
// transformed cosine (see sbl_cosine_factor); otherwise a rough estimate, above 0. For a perfect mirror, returns
// 0, because the mirror's rays find the lamps.
vec3 sbl_expected(sbl_Lamp l) {
    vec3 light = sbl_unobstructed(l);
#ifdef SBL_LOBE
    if (l.kind != SBL_LAMP_TRIANGLE) light *= lobe_scale * sbl_lobe_factor(lobe, l.corner) + SBL_LOBE_STRENGTH;
    if (lobe.alpha == 0.0) light = vec3(0);
#endif
    return light;
}

#ifdef SBL_LOBE
// A linearly transformed cosine approximates the lobe, and the closed form of a lamp is its light in this cosine.
// Returns the factor of the cosine for light from a direction, as sbl_lobe_factor / albedo is for the lobe. Rays
// measure the fraction of the light that arrives; `sampled` adds the difference between the lobe and the cosine.
float sbl_cosine_factor(vec3 direction) {
    vec3 w = to_frame * direction;
    float length2 = dot(w, w), cosine = dot(direction, sensor_normal);
    return cosine > 0.0 ? max(w.z, 0.0) * abs(determinant(to_frame)) / (length2 * length2 * cosine) : 0.0;
}
#endif

// Returns true if sbl_unobstructed(l) is a closed-form result. With SBL_LOBE: only for triangles in a rough lobe.
bool sbl_has_closed_form(sbl_Lamp l) {
#ifdef SBL_LOBE
    return l.kind == SBL_LAMP_TRIANGLE && lobe_rough;
#else
    return !sbl_is_texel(l);
#endif
}

// Adds node i to the entries, skips it, or descends into it. Returns the next node, or `limit`, the number of all
// nodes, if the entries are full. If all lamps fit, i and limit count leaves instead. opening: a node is one entry
// if its radius is below this * its distance. last: true: a node of any size is one entry
int sbl_consider(int i, int limit, float opening, bool last, out bool full) {
    int leaf = i, next = i + 1, lamps = 1;
    float strength = 0.0;
    bool single = !mixed || lamp_leaves <= SBL_LAMPS, point = false;
    full = false;
    if (!single) {
        sbl_Cluster c = sbl_cluster(i);
        if (dot(sensor_normal, c.to) + c.radius <= 0.0) next = c.beyond;
        else if (c.beyond == i + 1) {
            single = true;
            leaf = int(sbl_lamp_node_first_leaf(i));
        } else if (last || c.radius * c.radius < opening * opening * dot(c.to, c.to)) {
            next = c.beyond;
            lamps = (c.beyond - i + 1) / 2;
            strength = sbl_strength(i, c);
        }
    }
    if (single) {
        sbl_Lamp l = sbl_lamp(leaf);
        vec3 light = sbl_expected(l);
        strength = light.r + light.g + light.b;
        any_round = any_round || l.kind != SBL_LAMP_TRIANGLE;
        point = l.sine2 == 0.0 && sbl_is_light(l) && certain < SBL_CERTAIN;
        if (!point && sbl_has_closed_form(l)) {
            whole += outerProduct(light, l.facing);
            sbl_add_layers(whole_layers, l, light);
            if (directional) whole_harmonics[l.facing.y > 0.0 ? 1 : 0] += sbl_unobstructed_harmonics(l);
        }
    }
    if (strength > 0.0) {
        full = used + certain == SBL_LAMPS;
        if (full) next = limit;
        else if (point) entries[SBL_LAMPS - ++certain] = leaf;
        else {
            total += strength;
            strengths2 += strength * strength;
            lamp_strengths2 += strength * strength / float(lamps);
            strengths[used] = total;
            entries[used++] = single ? leaf : -1 - i;
            int first_leaf = single ? leaf : int(sbl_lamp_node_first_leaf(i));  // glows are the last near lamps
            bool glows = mixed && sbl_lamp_leaf_code(first_leaf) >> SBL_LAMP_KIND_SHIFT == SBL_LAMP_GLOW;
            for (int once = 0; once < (glows ? 1 : 0); once++) {
                glow_entries = ivec2(glow_entries.y == 0 ? used - 1 : glow_entries.x, used);
                glow_strengths2 += strength * strength * vec2(1, 1.0 / float(lamps));
            }
        }
    }
    return next;
}

// Increases the strengths of glows if they would get less than the fraction SBL_GLOW_RAYS of the rays.
void sbl_favour_glows() {
    float before = glow_entries.x > 0 ? strengths[glow_entries.x - 1] : 0.0;
    float glows = glow_entries.y > 0 ? strengths[glow_entries.y - 1] - before : 0.0;
    float wanted = SBL_GLOW_RAYS / (1.0 - SBL_GLOW_RAYS) * (total - glows);
    float factor = glows > 0.0 ? clamp(wanted / glows, 1.0, SBL_FAVOUR_MOST) : 1.0;
    for (int i = glow_entries.x; i < (factor > 1.0 ? used : 0); i++)
        strengths[i] += (factor - 1.0) * (min(strengths[i], before + glows) - before);
    total += (factor - 1.0) * glows;
    strengths2 += (factor * factor - 1.0) * glow_strengths2.x;
    lamp_strengths2 += (factor * factor - 1.0) * glow_strengths2.y;
}

void sbl_choose() {
    int limit = lamp_leaves <= SBL_LAMPS ? lamp_leaves : lamp_nodes;
    float opening = SBL_OPENING;
    bool full = true;
    for (int attempt = 0; attempt < SBL_OPENINGS && full; attempt++, opening *= 2.0) {
        used = certain = 0;
        glow_entries = ivec2(0);
        glow_strengths2 = vec2(0);
        total = strengths2 = lamp_strengths2 = 0.0;
        whole = mat2x3(0);
        if (directional) whole_harmonics[0] = whole_harmonics[1] = mat3x4(0);
#ifdef SBL_GROUPS
        for (int g = 0; g < 2 * SBL_GROUPS; g++) whole_layers[g] = vec3(0);
#endif
        full = false;
        for (int i = 0; i < limit; ) i = sbl_consider(i, limit, opening, attempt == SBL_OPENINGS - 1, full);
    }
    sbl_favour_glows();
}

// >>pick

// Picks one of the entries with a probability proportional to its strength.
int sbl_pick_entry(inout sbl_Pick p) {
    float wanted = p.u.x * total, before = 0.0;
    int low = 0, high = used - 1;
    while (low < high) {
        int middle = (low + high) / 2;
        if (strengths[middle] < wanted) { low = middle + 1; before = strengths[middle]; }
        else high = middle;
    }
    float width = strengths[low] - before;
    p.u.x = clamp((wanted - before) / width, 0.0, 1.0);
    p.chance = width / total;
    return entries[low];
}

// >>shoot

// Sums over the rays. A lamp outside clusters that has a closed form (see sbl_has_closed_form) gives this closed
// form times the ratio seen / open, unless its facing is sparse. All other lamps give the mean of the rays' light,
// which `sampled` sums, except that `sure` sums the exact light of the `certain` point lights. With SBL_LOBE,
// `sampled` also sums the difference between the lobe and the cosine of the closed form (see sbl_cosine_factor).
mat2x3 open = mat2x3(0);                      // by facing: light of the rays, if none of them were obstructed
mat2x3 seen = mat2x3(0);                      // by facing: light of the rays that arrives at the sensor
vec3 sure = vec3(0), sampled = vec3(0);       // light of point lights; light that the other rays have sampled
vec2 samples = vec2(0), lit = vec2(0);        // by facing: number of rays in `open`; how many of them reached
                                              // lamps
// Textures and panes multiply the luminance of each ray in `lit` by a factor. By facing: the sum of these factors,
// and the sum of their squares.
vec2 factors = vec2(0), factor_squares = vec2(0);
float taken = 0.0;                            // number of rays, without rim samples and rays to point lights
float squares = 0.0;                          // sum of the squared luminances of the terms added to `sampled`
#ifdef SBL_LOBE
vec2 lobe_squares = vec2(0);                  // by facing: sum of squared luminances of the rays' light in `open`
#endif
vec2 sparse;                                  // by facing: 1: too few rays for the ratio seen / open; 0: enough
vec2 unblocked = vec2(0), blocked = vec2(0);  // by facing: number of rays and rim samples that arrive; number of
                                              // those that do not
mat3x4 sure_harmonics = mat3x4(0), sampled_harmonics = mat3x4(0);  // harmonics of `sure` and of `sampled`
mat3x4 open_harmonics[2], seen_harmonics[2];  // harmonics of `open` and of `seen`
#ifdef SBL_GROUPS
vec3 open_layers[2 * SBL_GROUPS], seen_layers[2 * SBL_GROUPS];  // layers of `open` and of `seen`, see whole_layers
vec3 sure_layers[2 * SBL_GROUPS], sampled_layers[2 * SBL_GROUPS];  // layers of `sure` and of `sampled`
#endif
vec4 report = vec4(0), report_direction = vec4(0);  // inspections: out_light / unit, and out_direction
bool reporting;                                     // true: sbl_shoot reports its ray

// Traces the ray of a sample. at_rim: the sample only tests for obstruction; point: the lamp is a point light
void sbl_shoot(int slot, sbl_Pick p, sbl_Lamp l, sbl_Sample s, bool at_rim, bool point) {
    bool cluster = p.cluster || !sbl_has_closed_form(l) || dot(sparse, l.facing) > 0.0;
    vec3 light = s.light / p.chance, to = s.direction, unobstructed = light;
#ifdef SBL_LOBE
    unobstructed *= sbl_cosine_factor(s.direction);
    float mis = lobe_rough ? 0.0 : sbl_mis_of_lobe(l, s, sbl_lobe_density(lobe, s.direction));
    if (!at_rim) light *= (1.0 - mis) * lobe_scale * sbl_lobe_factor(lobe, s.direction);
    s.light = light * p.chance;
#endif
    vec4 to_harmonics = vec4(0);
    taken += point || at_rim ? 0.0 : 1.0;
    vec3 either = light + unobstructed;
    if (!(either.r + either.g + either.b > 0.0)) return;
    if (directional)
        to_harmonics = sbl_harmonics(s.direction, sensor_normal,
                                     1.0 / max(dot(s.direction, sensor_normal), SBL_COSINE_LEAST));
    if (!cluster && !point && !at_rim) {
        if (directional) open_harmonics[l.facing.y > 0.0 ? 1 : 0] += outerProduct(to_harmonics, light);
        open += outerProduct(unobstructed, l.facing);
        sbl_add_layers(open_layers, l, unobstructed);
        samples += l.facing;
#ifdef SBL_LOBE
        float weight = dot(unobstructed, SBL_LUMINANCE);
        lobe_squares += weight * weight * l.facing;
#endif
    }
    if (s.distance < SBL_UNBOUNDED) to = s.distance * s.direction + (position - ray_origin);
    float to_length = s.distance < SBL_UNBOUNDED ? length(to) : 1.0;
    float limit = s.distance < SBL_UNBOUNDED ? to_length * SBL_BEFORE_LAMP : SBL_UNBOUNDED;
    sbl_Hit hit = sbl_trace(ray_origin, to / to_length, limit, SBL_RAY_SHADOW);
    vec3 filtered = sbl_tint;
    bool hidden = hit.triangle >= 0 && hit.number != l.number;
#ifdef SBL_VIEWS
    hidden = hidden || sbl_hidden(slot, l, s);
#endif
    if (reporting) {
        report = vec4(point ? s.light : vec3(0), (hidden ? 2.0 : 1.0) + (point ? 1.0 : 0.0));
        report_direction = vec4(point ? vec3(0) : to / to_length, p.leaf);
    }
    if (!point && (at_rim || !cluster)) {
        if (hidden) blocked += l.facing;
        else unblocked += l.facing;
    }
    if (hidden || at_rim) return;
#if defined(SBL_TEXTURED) || defined(SBL_SPECULAR)
    if (l.kind == SBL_LAMP_TRIANGLE) filtered *= sbl_lamp_pattern(l, s.b);
#endif
    float unfiltered = max(dot(unobstructed, SBL_LUMINANCE), SBL_DIVISOR_LEAST);
    light *= filtered;
    unobstructed *= filtered;
    if (reporting && !point) report.rgb = light;
    mat3x4 harmonics = outerProduct(to_harmonics, light);
    if (directional && point) sure_harmonics += harmonics;
    else if (directional && cluster) sampled_harmonics += harmonics;
    else if (directional) seen_harmonics[l.facing.y > 0.0 ? 1 : 0] += harmonics;
    if (point) {
        sure += light;
        sbl_add_layers(sure_layers, l, light);
    } else if (cluster) {
        sampled += light;
        sbl_add_layers(sampled_layers, l, light);
        float mean = dot(light, SBL_LUMINANCE);
        squares += mean * mean;
    } else {
        seen += outerProduct(unobstructed, l.facing);
        sbl_add_layers(seen_layers, l, unobstructed);
        lit += l.facing;
        float factor = filtered == vec3(1) ? 1.0 : dot(unobstructed, SBL_LUMINANCE) / unfiltered;
        factors += factor * l.facing;
        factor_squares += factor * factor * l.facing;
#ifdef SBL_LOBE
        vec3 rest = light - unobstructed;
        float mean = dot(rest, SBL_LUMINANCE);
        sampled += rest;
        squares += mean * mean;
#endif
    }
}

// >>combine

// Returns the variance of the mean of n rays, divided by the variance of one ray. A lamp with more rays has
// smaller strata. The variable `lamps` is the effective number of lamps, including those in clusters.
float sbl_strata(float n) {
    float lamps = total * total / max(lamp_strengths2, 1e-37), points = max(n, 1.0);
    return min(SBL_STRATA * sqrt(max(lamps - 1.0, 1.0) / points), SBL_STRATA_LOST) / points;
}

// Returns true if more rays are needed: for lamps of one facing, only some of the rays are blocked or attenuated,
// or the light sampled from clusters is too noisy.
bool sbl_undecided() {
    float mean = dot(sampled, SBL_LUMINANCE) / max(taken, 1.0);
    float error = squares / max(taken, 1.0) - mean * mean;
    bool disagree = dot(unblocked, blocked) > 0.0 || (seen[0] != vec3(0) && seen[0] != open[0]) ||
                    (seen[1] != vec3(0) && seen[1] != open[1]);
#ifdef SBL_LOBE
    mean += dot(whole[0] + whole[1], SBL_LUMINANCE);  // `sampled` corrects the closed forms
#endif
    return disagree || sbl_strata(taken) * error > SBL_KNOWN * mean * mean;
}

// The result of the rays traced so far. light: R / unit, and the variance of its luminance; harmonics, layers:
// harmonics and layers of this light
struct sbl_Result {
    vec4 light;
    mat3x4 harmonics;
#ifdef SBL_GROUPS
    vec3 layers[SBL_GROUPS];
#endif
};

sbl_Result sbl_combine() {
    sbl_Result r;
    r.light = vec4(sure + sampled / max(taken, 1.0), 0);
    r.harmonics = sure_harmonics;
#ifdef SBL_GROUPS
    for (int i = 0; i < SBL_GROUPS; i++)
        r.layers[i] = sure_layers[i] + sure_layers[SBL_GROUPS + i] +
                      (sampled_layers[i] + sampled_layers[SBL_GROUPS + i]) / max(taken, 1.0);
#endif
    float clusters = dot(sampled, SBL_LUMINANCE) / max(taken, 1.0);
    r.light.a = max(squares / max(taken, 1.0) - clusters * clusters, 0.0) * sbl_strata(taken);
    if (directional) r.harmonics += sampled_harmonics / max(taken, 1.0);
    for (int g = 0; g < 2; g++) {
        vec3 visible = mix(vec3(0), seen[g] / open[g], greaterThan(open[g], vec3(0)));
        // n / n can exceed 1 on NVIDIA. Without min, the variance could be negative, which is read as SBL_LOST
        float mean = dot(whole[g], SBL_LUMINANCE), lit_fraction = min(lit[g] / max(samples[g], 1.0), 1.0);
        float rays_counted = samples[g];
#ifdef SBL_LOBE
        float all = max(dot(open[g], SBL_LUMINANCE), 1e-30);
        lit_fraction = min(dot(seen[g], SBL_LUMINANCE) / all, 1.0);
        rays_counted = all * all / max(lobe_squares[g], 1e-30);
#endif
        if (sparse[g] > 0.0) continue;
        r.light.rgb += whole[g] * visible;
        // Harmonics: the closed form times `visible`, plus the deviation from it that the rays measured.
        for (int k = 0; k < 3 && directional; k++)
            if (open[g][k] > 0.0)
                r.harmonics[k] += visible[k] * whole_harmonics[g][k] + whole[g][k] / open[g][k] *
                                  (seen_harmonics[g][k] - visible[k] * open_harmonics[g][k]);
#ifdef SBL_GROUPS
        // Layers: like harmonics. The deviations of all layers add up to 0, because `visible` is seen / open.
        vec3 per_ray = mix(vec3(0), whole[g] / open[g], greaterThan(open[g], vec3(0)));
        for (int i = 0; i < SBL_GROUPS; i++)
            r.layers[i] += visible * whole_layers[g * SBL_GROUPS + i] + per_ray *
                           (seen_layers[g * SBL_GROUPS + i] - visible * open_layers[g * SBL_GROUPS + i]);
#endif
#if (defined(SBL_TEXTURED) || defined(SBL_SPECULAR)) && !defined(SBL_LOBE)
        // The factors of rays that reach lamps vary. Strata are assumed not to help, because textures are fine.
        float factor = factors[g] / max(lit[g], 1.0);
        float varies = max(factor_squares[g] / max(lit[g], 1.0) - factor * factor, 0.0);
        r.light.a += mean * mean * lit_fraction * varies / max(samples[g], 1.0);
        mean *= factor;
#endif
        r.light.a += mean * mean * lit_fraction * (1.0 - lit_fraction) * sbl_strata(rays_counted);
    }
    return r;
}

// Russian roulette over passes: if the rays agree early, an invocation stops, except with probability
// SBL_PASS_CHANCE. For an invocation that continued, returns early + (final - early) / SBL_PASS_CHANCE, so that
// the expected value is the same as if all passes were made. early: result when the rays first agreed
sbl_Result sbl_combine_after(sbl_Result early) {
    sbl_Result r = sbl_combine();
    float boost = 1.0 / SBL_PASS_CHANCE, change = dot(r.light.rgb - early.light.rgb, SBL_LUMINANCE);
    r.light.rgb = early.light.rgb + boost * (r.light.rgb - early.light.rgb);
    r.light.a = boost * boost * (r.light.a + (1.0 - SBL_PASS_CHANCE) * change * change);
    r.harmonics = early.harmonics + boost * (r.harmonics - early.harmonics);
#ifdef SBL_GROUPS
    for (int i = 0; i < SBL_GROUPS; i++) r.layers[i] = early.layers[i] + boost * (r.layers[i] - early.layers[i]);
#endif
    return r;
}

// Returns the number of passes into which the rays are divided, a power of two. After each pass, sbl_undecided
// decides whether to trace more. More lamps, also within clusters, mean fewer passes: a pass with rays to few of
// them would often find all of these hidden, and miss the others.
int sbl_pass_count() {
    float passes_most = SBL_PASS_LAMPS * lamp_strengths2 / max(total * total, 1e-37);
    int passes = clamp(min(rays / SBL_PASS_RAYS, int(passes_most)), 1, SBL_LAMP_PASSES), power = 1;
    while (2 * power <= passes) power *= 2;
    return power;
}

// Returns true with the probability SBL_PASS_CHANCE.
bool sbl_makes_all_passes(int invocation) {
    uint hash = (scramble.x ^ uint(invocation) * 2654435769u) * 747796405u;
    hash = (hash ^ hash >> 16) * 2246822519u;
    return float(hash >> 8) < SBL_PASS_CHANCE * SBL_FRACTIONS;
}

void main() {
    ivec2 at = sbl_texel_of_invocation();
    int wanted = at.y * blocks.x + at.x;  // index of the ray or, from `rays` on, of the entry to report
    int certain_ray = rays + SBL_LAMPS - 1 - wanted;  // point light to report: its index from the end of `entries`
#ifdef SBL_INSPECT
    int invocation = 0, slot = sheet_slot;
    if (wanted >= rays + SBL_LAMPS) sbl_leave;
    while (wanted < rays && invocation + 1 < invocations && (invocation + 1) * rays / invocations <= wanted)
        invocation++;
    if (wanted >= rays) invocation = certain_ray % invocations;
    look = 0;
#else
    int invocations = blocks.y, invocation = at.y % invocations, slot = at.y / invocations * columns + at.x;
    look = slot - first_slot;
    if (look < 0 || look >= count) sbl_leave;
#endif
    sensor_normal = sbl_look_normal(look);
    ray_origin = sbl_look_position(look);
    above = sbl_look_offset(look);
    position = ray_origin - above * sensor_normal;
    to_frame = transpose(sbl_frame(sensor_normal));
#ifdef SBL_LOBE
    sbl_lobe_begin(look, sensor_normal);
    to_frame = sbl_lobe_to_cosine(look);
#endif
    uint hash = sbl_look_lamp_scramble(look);
    scramble = uvec2(hash, (hash ^ hash >> 15) * 747796405u);
    scramble.y ^= scramble.y >> 13;
    sbl_choose();
    if (inspected && wanted >= rays && wanted - rays < used && entries[wanted - rays] >= 0) {
        report = vec4(sbl_expected(sbl_lamp(entries[wanted - rays])), 1);
        report_direction.w = float(entries[wanted - rays]);
    }
#ifdef SBL_GROUPS
    for (int g = 0; g < 2 * SBL_GROUPS; g++)
        open_layers[g] = seen_layers[g] = sure_layers[g] = sampled_layers[g] = vec3(0);
#endif
    if (directional) open_harmonics[0] = open_harmonics[1] = seen_harmonics[0] = seen_harmonics[1] = mat3x4(0);
    float enough = SBL_SPARSE * float(invocations) / float(rays) * total;
    sparse = vec2(lessThan(vec3(1) * whole, vec2(enough)));
    // Rim samples find shadow edges that hide only a small part of a lamp; more passes are then made.
    int passes = sbl_pass_count(), rims = any_round ? SBL_RIM : SBL_CORNERS;
    int rim_samples = passes > 1 && used <= SBL_RIM_LAMPS ? rims * used : 0;
    int skip = int(sbl_look_which(look) & SBL_LOOK_NUMBER) * rays;
    bool undecided = total > 0.0, stopped = false, all_passes = sbl_makes_all_passes(invocation);
    sbl_Result early;
    for (int pass = -1; pass < passes && (pass < 0 || undecided); pass++) {  // pass -1: rays to point lights
        // Each invocation has SBL_LAMP_PASSES sections of the sequence. Each section covers the unit square
        // evenly.
        int section = SBL_LAMP_PASSES * invocation, sections = SBL_LAMP_PASSES * invocations;
        // The divisions are unsigned, because idle lanes of some software renderers trap on INT_MIN / -1.
        int stretch = int(uint(SBL_LAMP_PASSES) / uint(passes));
        int from = int(uint((section + pass * stretch) * rays) / uint(sections));
        int to = total > 0.0 ? int(uint((section + (pass + 1) * stretch) * rays) / uint(sections)) : from;
        bool point = pass < 0;
        int start = point ? invocation : pass == 0 ? from - rim_samples : from, end = point ? certain : to;
        for (int k = start; k < end; k += point ? invocations : 1) {
            bool at_rim = pass == 0 && k < from;
            uint rim_index = uint(from - 1 - k);
            int rim = at_rim ? int(rim_index % uint(rims)) : -1, entry = entries[point ? SBL_LAMPS - 1 - k : 0];
            uvec2 fraction = texelFetch(sbl_sequence, skip + max(k, 0)).xy ^ scramble;
            vec2 u = sbl_unit_square(fraction);
            sbl_Pick p = sbl_Pick(0, point ? 1.0 / float(invocations) : 1.0, u, false);
            if (at_rim) entry = entries[rim_index / uint(rims)];
            else if (!point) entry = sbl_pick_entry(p);
            if (at_rim && entry < 0) continue;
            p.leaf = entry;
            p.cluster = entry < 0;
            if (mixed && p.cluster) sbl_descend(p, -1 - entry, fraction.x);
            sbl_Lamp l = sbl_lamp(p.leaf);
            bool corner = at_rim && l.kind == SBL_LAMP_TRIANGLE;
            if (at_rim && (sbl_is_texel(l) || (corner && rim >= SBL_CORNERS))) continue;
            float turned = float(rim) + float(scramble.y >> 8) / SBL_FRACTIONS;
            if (at_rim) p.u = vec2(SBL_RIM_AT, turned / float(SBL_RIM));
            sbl_Sample s = sbl_sample(l, p.u);
            if (corner) {
                vec3 to_sample = l.corner + (rim == 1 ? SBL_CORNER : SBL_OTHER_CORNER) * l.side_1 +
                           (rim == 2 ? SBL_CORNER : SBL_OTHER_CORNER) * l.side_2;
                s.distance = length(to_sample);
                s.direction = to_sample / s.distance;
                s.light = vec3(dot(to_sample, sensor_normal));
            }
            reporting = inspected && (point ? k == certain_ray : !at_rim && k == wanted);
            sbl_shoot(slot, p, l, s, at_rim, point);
        }
        if (point || stopped) continue;
        undecided = sbl_undecided();
        if (undecided || !all_passes || pass + 1 == passes) continue;
        early = sbl_combine();
        undecided = stopped = true;
    }
#ifdef SBL_INSPECT
    sbl_write(out_light, vec4(report.rgb * unit, report.a));
    sbl_write(out_direction, report_direction);
#else
    sbl_Result r;
    if (stopped) r = sbl_combine_after(early);
    else r = sbl_combine();
    vec4 light = vec4(r.light.rgb, r.light.a * unit * scale) * unit * scale;
    if (counts_steps) {  // the low bits of the variance hold the number of steps, see reduce_sum.glsl
        uint steps = min(uint(sbl_steps) / uint(SBL_STEPS_UNIT), uint(SBL_STEPS_MASK));
        light.a = uintBitsToFloat(floatBitsToUint(max(light.a, 1e-30)) & ~uint(SBL_STEPS_MASK) | steps);
    }
    if (sbl_cut_short()) light.a = SBL_LOST;
    sbl_write(out_light, light);
    r.harmonics *= unit * scale;
    sbl_write_harmonics(r.harmonics);
#ifdef SBL_GROUPS
    for (int i = 0; i < SBL_GROUPS; i++) r.layers[i] *= unit * scale;
    sbl_write_layers(r.layers);
#endif
#endif
}
