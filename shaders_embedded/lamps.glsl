// Light from lamps: emitting triangles, punctual lights, bright spots of the sky. What each gives where nothing stands between is known in closed form;
// rays only measure which share of it arrives: the ratio estimator of Heitz, Hill and McGuire 2018, "Combining analytic direct illumination and stochastic
// shadows". Where lamps are many, those far off stand together in clusters, of which only single lamps,
// picked in proportion to what they give, are ever looked at.
// One invocation is one sensor, or a part of its rays where they are many: neighbours trace neighbouring rays, and each stops as soon as it knows enough.
uniform usamplerBuffer sbl_points;    // a sensor, three texels: position, turn; normal; first of its directions, of its lamp points, a hash for these, how far it is off its surface
uniform usamplerBuffer sbl_sequence;  // see trace.glsl
uniform sbl_Texels sbl_lamps;         // see >>lamps in sbl.h: nodes, leaves, lights
uniform int lamp_nodes, lamp_leaves;  // how many
uniform int rays;                     // at most so many a sensor
uniform float unit, scale;            // radiance that calculations are in, so that none overflows; of what is written
SBL_OUT(0, out_light);                // R, each part's own; the variance of its channels' mean

const float PI = 3.14159265;
const uint SBL_TRIANGLE = 0u, SBL_NEAR_LIGHT = 1u, SBL_FAR_LIGHT = 2u, SBL_SKY_TEXEL = 3u;  // a leaf's kind, in its upper two bits
const uint SBL_FAR_NODE = 0x80000000u;
const int SBL_CERTAIN = 32;      // so many points of light get a ray each
const int SBL_PROBES = 12;       // along the rim of a round lamp; of a triangle's, three
const float SBL_STRATA = 0.1;    // stratified points have far less variance than independent ones: a tenth is what edges across a lamp leave

struct sbl_Lamp {
    uint kind;
    vec3 emission;             // a triangle's radiance; a light's irradiance of a surface here that faces it; a texel's light, radiance times solid angle
    vec3 corner;               // of the triangle, from the sensor; else the unit direction to the light's middle, or to the texel's middle
    vec3 side_1, side_2;       // of the triangle
    float away, radius, sine2; // of a light: distance, radius, sine squared of the angle that it spans to each side
    ivec2 texel;
    int triangle, number;      // as traced; in the scene
    vec2 group;                // 0 1 for a triangle that turns its back to the sensor, else 1 0
};

sbl_Lamp sbl_lamp(int leaf, vec3 p, vec3 n) {
    uint code = sbl_fetch(sbl_lamps, 4 * lamp_nodes + leaf).x, at = code & 0x3fffffffu;
    sbl_Lamp l = sbl_Lamp(code >> 30, vec3(0), vec3(0), vec3(0), vec3(0), 1e30, 0.0, 0.0, ivec2(at & 32767u, at >> 15), int(at), -1, vec2(1, 0));
    sbl_when (l.kind == SBL_TRIANGLE) {
        uvec4 a = sbl_fetch(sbl_triangles, 3 * l.triangle), b = sbl_fetch(sbl_triangles, 3 * l.triangle + 1), c = sbl_fetch(sbl_triangles, 3 * l.triangle + 2), light = sbl_object(a.w, 1);
        l.corner = uintBitsToFloat(a.xyz);
        l.side_1 = uintBitsToFloat(b.xyz) - l.corner;
        l.side_2 = uintBitsToFloat(c.xyz) - l.corner;
        l.corner -= p;
        l.emission = uintBitsToFloat(light.rgb) / unit;
        l.number = int(b.w);
        l.group = dot(cross(l.side_1, l.side_2), l.corner) > 0.0 ? vec2(0, 1) : vec2(1, 0);
        if (l.group.y == 1.0 && (light.w & SBL_ONE_SIDED_EMISSION) != 0u) l.emission = vec3(0);
    }
    sbl_when (l.kind == SBL_SKY_TEXEL) {
        vec2 size = vec2(textureSize(sky_picture, 0)), middle = (vec2(l.texel) + 0.5) / size;
        vec3 radiance = texelFetch(sky_picture, l.texel, 0).rgb;
        l.corner = sbl_sky_direction(middle.x, cos(PI * middle.y));
        l.emission = radiance * (sbl_sky_excess(radiance) / unit * (2.0 * PI / size.x) * 2.0 * sin(PI * middle.y) * sin(0.5 * PI / size.y));
    }
    sbl_when (l.kind == SBL_NEAR_LIGHT || l.kind == SBL_FAR_LIGHT) {
        int first = 4 * lamp_nodes + lamp_leaves + 3 * int(at);
        vec4 a = uintBitsToFloat(sbl_fetch(sbl_lamps, first)), b = uintBitsToFloat(sbl_fetch(sbl_lamps, first + 1)), c = uintBitsToFloat(sbl_fetch(sbl_lamps, first + 2));
        l.corner = a.xyz;
        l.emission = b.rgb / unit;
        l.sine2 = a.w;
        if (l.kind == SBL_NEAR_LIGHT) {
            l.corner -= p;
            l.radius = a.w;
            l.away = length(l.corner);
            l.corner /= max(l.away, 1e-30);
            float spot = clamp(dot(c.xyz, -l.corner) * b.w + c.w, 0.0, 1.0);  // KHR_lights_punctual
            if (l.away < l.radius) { l.corner = n; l.away = l.radius; spot = 1.0; }  // the sensor stands in it
            l.emission *= spot * spot / (l.away * l.away);
            l.sine2 = min(l.radius * l.radius / (l.away * l.away), 1.0);
        }
    }
    return l;
}

// An edge's part of Lambert's sum: the angle it spans, times the cosine of its plane's normal to z.
float sbl_edge(vec3 p, vec3 q) {
    vec3 normal = cross(p, q);
    float size = length(normal);
    return size > 0.0 ? atan(size, dot(p, q)) * normal.z / size : 0.0;
}

// Share of a hemisphere around z that a triangle fills, weighted by the cosine: Lambert 1760. Corners relative to the sensor, in its frame.
float sbl_form_factor(vec3 a, vec3 b, vec3 c) {
    vec3 middle = (a + b + c) / 3.0, normal = cross(b - a, c - a);
    float distance2 = dot(middle, middle), size2 = max(dot(b - a, b - a), max(dot(c - a, c - a), dot(c - b, c - b)));
    if (min(a.z, min(b.z, c.z)) > 0.0 && distance2 > 1e5 * size2)  // too small for the sum's rounding, small enough for a point
        return 0.5 * abs(dot(normal, middle)) * middle.z / (PI * distance2 * distance2);
    vec3 corners[3] = vec3[3](a, b, c), entry = vec3(0), leave = vec3(0);
    float sum = 0.0;
    bool cut = false;
    for (int k = 0; k < 3; k++) {  // what is below the horizon does not count
        vec3 p = corners[k], q = corners[k == 2 ? 0 : k + 1];
        if (max(p.z, q.z) <= 0.0) continue;
        if (min(p.z, q.z) <= 0.0) {
            vec3 x = vec3(mix(p.xy, q.xy, p.z / (p.z - q.z)), 0);
            cut = true;
            if (p.z <= 0.0) entry = p = x;
            else leave = q = x;
        }
        sum += sbl_edge(p, q);
    }
    if (cut) sum += sbl_edge(leave, entry);
    return abs(sum) / (2.0 * PI);
}

// The same for a round lamp whose middle has the cosine z to the normal, over the sine squared of the angle that it spans to each side: Snyder 1996,
// "Area Light Sources for Real-Time Graphics"; small ones as flat discs.
float sbl_round(float z, float sine2) {
    float sine = sqrt(sine2), s = sqrt(max(1.0 - z * z, 0.0));
    if (z >= sine || z <= -sine) return max(z, 0.0);
    float q = z / sine, x = sqrt(1.0 / sine2 - 1.0), y = clamp(-x * z / s, -1.0, 1.0), w = s * sqrt(1.0 - y * y);
    if (sine2 < 1e-4) return sine / PI * (q * acos(-q) + sqrt(1.0 - q * q) * (2.0 + q * q) / 3.0);
    return (z * acos(y) - x * w + atan(w, x) / sine2) / PI;
}

// R from a lamp that nothing hides.
vec3 sbl_unhindered(sbl_Lamp l, vec3 n, mat3 to_frame) {
    float factor = 0.0;
    sbl_when (l.kind == SBL_TRIANGLE) {
        vec3 corner = to_frame * l.corner;
        factor = sbl_form_factor(corner, corner + to_frame * l.side_1, corner + to_frame * l.side_2);
    }
    sbl_when (l.kind == SBL_NEAR_LIGHT || l.kind == SBL_FAR_LIGHT) factor = sbl_round(dot(n, l.corner), l.sine2) / PI;
    sbl_when (l.kind == SBL_SKY_TEXEL) factor = max(dot(n, l.corner) + PI / float(textureSize(sky_picture, 0).y), 0.0) / PI;  // about: above 0 where some of it is above the horizon
    return l.emission * factor;
}

// A subtree: a cluster of lamps.
struct sbl_Cluster {
    vec3 to;       // its middle, from the sensor
    float radius;
    bool far;      // directions
    int beyond;    // the node after it
};

sbl_Cluster sbl_cluster(int node, vec3 p) {
    vec4 ball = uintBitsToFloat(sbl_fetch(sbl_lamps, 4 * node));
    uint skip = sbl_fetch(sbl_lamps, 4 * node + 2).w;
    bool far = (skip & SBL_FAR_NODE) != 0u;
    return sbl_Cluster(ball.xyz - (far ? vec3(0) : p), ball.w, far, int(skip & ~SBL_FAR_NODE));
}

// What it gives about: zero only where none of its lamps gives anything.
float sbl_strength(int node, sbl_Cluster c, vec3 n) {
    vec4 square = uintBitsToFloat(sbl_fetch(sbl_lamps, 4 * node + 1)), cross_terms = uintBitsToFloat(sbl_fetch(sbl_lamps, 4 * node + 2));
    vec3 front = uintBitsToFloat(sbl_fetch(sbl_lamps, 4 * node + 3).xyz);
    float distance2 = max(dot(c.to, c.to), 1e-37), spread = min(c.radius * inversesqrt(distance2), 1.0), height = dot(n, c.to);
    vec3 w = c.far ? -n : c.to * inversesqrt(distance2);  // far lamps turn no sides to the sensor, but are seen under the cosine to its normal
    float shown = sqrt(max(dot(square.xyz, w * w) + 2.0 * dot(cross_terms.xyz, w.xyz * w.yzx), 0.0)) - dot(front, w) + 0.1 * square.w * spread;
    if (height + c.radius <= 0.0) return 0.0;
    return max(shown, 0.0) * (c.far ? 1.0 : max(height, 0.5 * (height + c.radius)) * inversesqrt(distance2) / max(distance2, c.radius * c.radius)) / unit;
}

// A direction to the spherical triangle of unit vectors a, b, c, evenly distributed: Arvo 1995, "Stratified Sampling of Spherical Triangles".
// w: its solid angle; 0 where it is too small for that.
vec4 sbl_spherical(vec3 a, vec3 b, vec3 c, vec2 u) {
    vec3 ab = cross(a, b), bc = cross(b, c), ca = cross(c, a);
    float alpha = atan(length(cross(ab, ca)), -dot(ab, ca)), beta = atan(length(cross(bc, ab)), -dot(bc, ab)), gamma = atan(length(cross(ca, bc)), -dot(ca, bc));
    float solid_angle = alpha + beta + gamma - PI;
    if (!(solid_angle > 0.01)) return vec4(0);
    float s = sin(u.x * solid_angle - alpha), t = cos(u.x * solid_angle - alpha), sin_alpha = sin(alpha), cos_alpha = cos(alpha);
    float p = t - cos_alpha, v = s + sin_alpha * dot(a, b);
    float q = clamp(((v * t - p * s) * cos_alpha - v) / ((v * s + p * t) * sin_alpha), -1.0, 1.0);
    vec3 cut = q * a + sqrt(1.0 - q * q) * normalize(c - dot(c, a) * a);
    float z = 1.0 - u.y * (1.0 - dot(cut, b));
    return vec4(z * b + sqrt(max(1.0 - z * z, 0.0)) * normalize(cut - dot(cut, b) * b), solid_angle);
}

// A point of a lamp.
struct sbl_Sample {
    vec3 direction;
    float far;    // how far it is
    vec3 light;   // R from the lamp, were it all like this point
    vec2 b;       // barycentrics on a triangle
};

sbl_Sample sbl_sample(sbl_Lamp l, vec3 n, vec2 u) {
    sbl_Sample s = sbl_Sample(l.corner, 1e30, l.emission / PI, u);
    sbl_when (l.kind == SBL_TRIANGLE) {  // by solid angle where it is large, else by area (Heitz 2019, "A Low-Distortion Map Between Triangle and Square")
        vec3 normal = cross(l.side_1, l.side_2);
        vec4 ray = sbl_spherical(normalize(l.corner), normalize(l.corner + l.side_1), normalize(l.corner + l.side_2), u);
        s.b = u.y > u.x ? vec2(0.5 * u.x, u.y - 0.5 * u.x) : vec2(u.x - 0.5 * u.y, 0.5 * u.y);
        // not so near to an edge that rounding may carry the ray past it
        float reach2 = dot(l.corner, l.corner), longest2 = max(dot(l.side_1, l.side_1), dot(l.side_2, l.side_2));
        s.b = mix(s.b, vec2(1.0 / 3.0), min(3e-6 * sqrt(longest2) * reach2 / max(abs(dot(normal, l.corner)), 1e-37), 0.5));
        vec3 to = l.corner + s.b.x * l.side_1 + s.b.y * l.side_2;
        if (ray.w > 0.0) {
            to = ray.xyz * dot(l.corner, normal) / dot(ray.xyz, normal);
            s.b = vec2(dot(cross(to - l.corner, l.side_2), normal), dot(cross(l.side_1, to - l.corner), normal)) / dot(normal, normal);
        }
        s.far = length(to);
        s.direction = to / s.far;
        s.light *= ray.w > 0.0 ? ray.w : 0.5 * abs(dot(normal, s.direction)) / (s.far * s.far);
    }
    sbl_when (l.kind == SBL_SKY_TEXEL) {
        vec2 size = vec2(textureSize(sky_picture, 0));
        float row = float(l.texel.y);
        s.direction = sbl_sky_direction((float(l.texel.x) + u.x) / size.x, mix(cos(PI * row / size.y), cos(PI * (row + 1.0) / size.y), u.y));
    }
    sbl_when (l.kind == SBL_NEAR_LIGHT || l.kind == SBL_FAR_LIGHT) {
        float cosine = sqrt(1.0 - l.sine2), off = u.x * l.sine2 / (1.0 + cosine), r = sqrt(max(off * (2.0 - off), 0.0));  // off: what the ray's cosine to the middle lacks to 1
        s.direction = sbl_frame(l.corner) * vec3(r * cos(2.0 * PI * u.y), r * sin(2.0 * PI * u.y), 1.0 - off);
        s.light *= 2.0 / (1.0 + cosine);
        if (l.kind == SBL_NEAR_LIGHT) s.far = l.away * (1.0 - off) - sqrt(max(l.radius * l.radius - l.away * l.away * r * r, 0.0));
    }
    s.light *= max(dot(n, s.direction), 0.0);
    return s;
}

#ifdef SBL_VIEWS  // what the host draws stands in the sensor's own views only
uniform sampler2D atlas;        // Ck r g b, signed distance along the view's axis
uniform vec4 view_rects[5];     // x, y, width, height in the sheet
uniform ivec2 sheet;            // a sensor's, in texels
uniform int view_count;
uniform float tangent, extent;  // of half a view's width; world units of a distance

// A texel shows what stands in its middle, where a lamp's triangle may have ended: such points ask again, nearer to the triangle's middle.
bool sbl_hidden(int slot, vec3 n, float turn, sbl_Lamp l, sbl_Sample s) {
    mat3 frame = sbl_frame(n);
    vec3 axes[2] = vec3[2](cos(turn) * frame[0] - sin(turn) * frame[1], -cos(turn) * frame[1] - sin(turn) * frame[0]);  // right and up, see sbl__frame
    vec3 normal = cross(l.side_1, l.side_2), point = s.far * s.direction, middle = l.corner + (l.side_1 + l.side_2) / 3.0;
    if (l.kind != SBL_TRIANGLE) point = s.direction;
    for (int attempt = 0; attempt < 4; attempt++, point = mix(point, middle, 0.4)) {
        vec3 right = axes[0], up = axes[1], forward = n;
        vec2 side = vec2(dot(point, right), dot(point, up));
        bool top = max(abs(side.x), abs(side.y)) <= dot(point, n) * tangent;
        int face = top ? 0 : abs(side.x) > abs(side.y) ? (side.x > 0.0 ? 1 : 3) : (side.y > 0.0 ? 2 : 4);
        if (!top && view_count == 1) return true;
        if (!top) {
            forward = face == 1 ? axes[0] : face == 2 ? axes[1] : face == 3 ? -axes[0] : -axes[1];
            right = face == 1 ? axes[1] : face == 2 ? -axes[0] : face == 3 ? -axes[1] : axes[0];
            up = n;
        }
        vec4 rect = view_rects[face];
        vec2 lowest = vec2(-1, top ? -1 : 0), size = vec2(1) - lowest, at = (vec2(dot(point, right), dot(point, up)) / (dot(point, forward) * tangent) - lowest) / size;
        vec2 texel = clamp(floor(at * rect.zw), vec2(0), rect.zw - 1.0), centre = lowest + (texel + 0.5) / rect.zw * size;
        float shown = texelFetch(atlas, ivec2(slot % columns, slot / columns) * sheet + ivec2(rect.xy + texel), 0).a, seen = abs(shown) * extent;
        if (seen == 0.0) return false;
        if (l.kind != SBL_TRIANGLE) return seen < 0.998 * s.far * dot(point, forward);
        vec3 ray = forward + tangent * (centre.x * right + centre.y * up);
        float there = dot(l.corner, normal) / dot(ray, normal);  // where it meets the lamp's plane
        bool other_side = (shown < 0.0) != (l.group.y == 1.0);  // of a thin body
        if (there > 0.0 && (seen > 1.002 * there || (seen >= 0.998 * there && !other_side))) return false;
        vec3 hit = there * ray - l.corner;
        vec2 b = vec2(dot(cross(hit, l.side_2), normal), dot(cross(l.side_1, hit), normal)) / dot(normal, normal);
        if (attempt == 3 || (there > 0.0 && min(b.x, b.y) >= 0.0 && b.x + b.y <= 1.0)) return seen < (other_side ? 1.002 : 0.998) * dot(point, forward);
    }
    return true;
}
#endif

void main() {
    ivec2 at = sbl_texel_of_invocation();
    int parts = blocks.y, part = at.y % parts, slot = at.y / parts * columns + at.x, sensor = slot - first_slot;
    if (sensor < 0 || sensor >= count) sbl_leave;
    uvec4 place = texelFetch(sbl_points, 3 * sensor), words = texelFetch(sbl_points, 3 * sensor + 2);
    vec3 stand = uintBitsToFloat(place.xyz), n = uintBitsToFloat(texelFetch(sbl_points, 3 * sensor + 1).xyz);
    vec3 position = stand - uintBitsToFloat(words.w) * n;  // on the surface: a lamp close by is seen from there
    uvec2 scramble = uvec2(words.z, (words.z ^ words.z >> 15) * 747796405u);
    scramble.y ^= scramble.y >> 13;
    mat3 to_frame = transpose(sbl_frame(n));

    // Which lamps count here: single ones and, where there are many, clusters that are small for their distance.
    int entries[SBL_LAMPS];      // a leaf, or -1 - a node; from the end on: points of light, which get a ray each
    float strengths[SBL_LAMPS];  // what each gives about, summed up
    float total = 0.0, crowd = 0.0, opening = 0.3;  // crowd: the sum of their squares
    mat2x3 all = mat2x3(0);      // single lamps, unhindered; two groups, since of a closed mesh one is all hidden, the other all open
    int used = 0, certain = 0, limit = lamp_leaves <= SBL_LAMPS ? lamp_leaves : lamp_nodes;
    bool full = true, rounded = false;
    for (int attempt = 0; attempt < 12 && full; attempt++, opening *= 2.0) {
        used = certain = 0;
        total = crowd = 0.0;
        all = mat2x3(0);
        full = false;
        for (int i = 0, next; i < limit; i = next) {
            int leaf = i;
            float strength = 0.0;
            bool single = lamp_leaves <= SBL_LAMPS, point = false;
            next = i + 1;
            sbl_when (!single) {
                sbl_Cluster c = sbl_cluster(i, position);
                if (dot(n, c.to) + c.radius <= 0.0) next = c.beyond;
                else if (c.beyond == i + 1) {
                    single = true;
                    leaf = int(sbl_fetch(sbl_lamps, 4 * i + 3).w);
                } else if (attempt == 11 || c.radius * c.radius < opening * opening * dot(c.to, c.to)) {
                    next = c.beyond;
                    strength = sbl_strength(i, c, n);
                }
            }
            sbl_when (single) {
                sbl_Lamp l = sbl_lamp(leaf, position, n);
                vec3 light = sbl_unhindered(l, n, to_frame);
                strength = light.r + light.g + light.b;
                rounded = rounded || l.kind != SBL_TRIANGLE;
                point = l.sine2 == 0.0 && (l.kind == SBL_NEAR_LIGHT || l.kind == SBL_FAR_LIGHT) && certain < SBL_CERTAIN;
                if (!point && l.kind != SBL_SKY_TEXEL) all += outerProduct(light, l.group);
            }
            if (strength > 0.0) {
                full = used + certain == SBL_LAMPS;
                if (full) next = limit;
                else if (point) entries[SBL_LAMPS - ++certain] = leaf;
                else {
                    total += strength;
                    crowd += strength * strength;
                    strengths[used] = total;
                    entries[used++] = single ? leaf : -1 - i;
                }
            }
        }
    }

    mat2x3 open = mat2x3(0), seen = open;  // what the samples of single lamps give without and with what stands between
    vec3 sure = vec3(0), sampled = vec3(0);  // from points of light; from clusters, summed over the samples
    vec2 samples = vec2(0), lit = samples;
    float taken = 0.0, squares = 0.0;
    // A group that samples hardly meet is no ground for a ratio: it is sampled as clusters are.
    float enough = 16.0 * float(parts) / float(rays) * total;
    vec2 sparse = vec2(lessThan(vec3(1) * all, vec2(enough)));
    // The first eighth, or half of few, tells whether there is more to know: what it overlooks is less than a sample's share. The more lamps there are,
    // the more of the samples it takes to know each.
    int passes = clamp(min(rays / 32, int(16.0 * crowd / max(total * total, 1e-37))), 1, 8);
    passes = passes >= 8 ? 8 : passes >= 4 ? 4 : passes >= 2 ? 2 : 1;
    // So that they do not overlook an edge that hides little, corners and rims of few lamps are looked at besides.
    int rims = rounded ? SBL_PROBES : 3, probes = passes > 1 && used <= 8 ? rims * used : 0;
    vec2 bright = vec2(0), dark = bright;  // whether any of a group was seen, or hidden
    bool undecided = total > 0.0;
    for (int pass = -1; pass < passes && (pass < 0 || undecided); pass++) {
        // each part has a stretch of the sequence, and each eighth of it covers a lamp, and the lamps, evenly
        int from = (8 * part + pass * 8 / passes) * rays / (8 * parts), to = total > 0.0 ? (8 * part + (pass + 1) * 8 / passes) * rays / (8 * parts) : from;
        for (int k = pass < 0 ? part : pass == 0 ? from - probes : from; k < (pass < 0 ? certain : to); k += pass < 0 ? parts : 1) {
            bool probe = pass == 0 && k < from;
            uvec2 fraction = texelFetch(sbl_sequence, int(words.y) + max(k, 0)).xy ^ scramble;
            vec2 u = (vec2(fraction >> 8) + 0.5) / 16777216.0;
            int entry = entries[pass < 0 ? SBL_LAMPS - 1 - k : 0];
            float picked = pass < 0 ? 1.0 / float(parts) : 1.0;  // how often the lamp is
            if (probe) entry = entries[(from - 1 - k) / rims];
            else if (pass >= 0) {  // one in proportion to its strength
                float wanted = u.x * total, before = 0.0;
                int low = 0, high = used - 1;
                while (low < high) {
                    int middle = (low + high) / 2;
                    if (strengths[middle] < wanted) { low = middle + 1; before = strengths[middle]; }
                    else high = middle;
                }
                float width = strengths[low] - before;
                u.x = clamp((wanted - before) / width, 0.0, 1.0);
                picked = width / total;
                entry = entries[low];
            }
            if (probe && entry < 0) continue;
            bool cluster = entry < 0;
            sbl_when (cluster) {  // down to one of its lamps, at every fork in proportion to what the branches give
                int node = -1 - entry;
                u.x = clamp(u.x + (float(fraction.x & 255u) - 127.5) / 4294967296.0 / picked, 0.0, 1.0);  // digits below those of a float that are left
                for (sbl_Cluster c = sbl_cluster(node, position); c.beyond != node + 1; c = sbl_cluster(node, position)) {
                    sbl_Cluster left = sbl_cluster(node + 1, position), right = sbl_cluster(left.beyond, position);
                    float weight = sbl_strength(node + 1, left, n), share = weight / max(weight + sbl_strength(left.beyond, right, n), 1e-37);
                    bool first = u.x < share;
                    node = first ? node + 1 : left.beyond;
                    picked *= first ? share : 1.0 - share;
                    u.x = first ? u.x / share : (u.x - share) / (1.0 - share);
                }
                entry = int(sbl_fetch(sbl_lamps, 4 * node + 3).w);
            }
            sbl_Lamp l = sbl_lamp(entry, position, n);
            int rim = (from - 1 - k) % rims;
            if (probe && (l.kind == SBL_SKY_TEXEL || (l.kind == SBL_TRIANGLE && rim > 2))) continue;
            sbl_Sample s = sbl_sample(l, n, probe ? vec2(0.99, (float(rim) + float(scramble.y >> 8) / 16777216.0) / float(SBL_PROBES)) : u);
            sbl_when (probe && l.kind == SBL_TRIANGLE) {
                vec3 to = l.corner + (rim == 1 ? 0.996 : 0.002) * l.side_1 + (rim == 2 ? 0.996 : 0.002) * l.side_2;
                s.far = length(to);
                s.direction = to / s.far;
                s.light = vec3(dot(to, n));
            }
            if (l.kind == SBL_SKY_TEXEL || dot(sparse, l.group) > 0.0) cluster = true;
            vec3 light = s.light / picked;
            taken += pass < 0 || probe ? 0.0 : 1.0;
            if (!(light.r + light.g + light.b > 0.0)) continue;
            if (!cluster && pass >= 0 && !probe) {
                open += outerProduct(light, l.group);
                samples += l.group;
            }
            vec3 to = s.direction;
            if (s.far < 1e30) to = s.far * s.direction + (position - stand);
            float away = s.far < 1e30 ? length(to) : 1.0;
            sbl_Hit hit = sbl_trace(stand, to / away, s.far < 1e30 ? away * 0.99999 : 1e30);
            bool hidden = hit.triangle >= 0 && hit.number != l.number;
#ifdef SBL_VIEWS
            hidden = hidden || sbl_hidden(slot, n, uintBitsToFloat(place.w), l, s);
#endif
            if (pass >= 0 && (probe || !cluster)) {
                if (hidden) dark += l.group;
                else bright += l.group;
            }
            if (hidden || probe) continue;
#ifdef SBL_TEXTURED
            sbl_when (l.kind == SBL_TRIANGLE) {
                sbl_Attributes at = sbl_attributes_at(l.triangle, s.b.x, s.b.y);
                light *= sbl_texture(sbl_object(sbl_fetch(sbl_triangles, 3 * l.triangle).w, 3), at.uv).rgb;
            }
#endif
            if (pass < 0) sure += light;
            else if (cluster) {
                sampled += light;
                float mean = dot(light, vec3(1.0 / 3.0));
                squares += mean * mean;
            } else {
                seen += outerProduct(light, l.group);
                lit += l.group;
            }
        }
        // all is open, or nothing: the first samples tell; so do clusters that are alike
        float mean = dot(sampled, vec3(1.0 / 3.0)) / max(taken, 1.0), error = (squares / max(taken, 1.0) - mean * mean) / max(taken, 1.0);
        bool mixed = dot(bright, dark) > 0.0 || (seen[0] != vec3(0) && seen[0] != open[0]) || (seen[1] != vec3(0) && seen[1] != open[1]);
        if (pass >= 0) undecided = mixed || SBL_STRATA * error > 1e-6 * mean * mean;
    }
    float clusters = dot(sampled, vec3(1.0 / 3.0)) / max(taken, 1.0), variance = max(squares / max(taken, 1.0) - clusters * clusters, 0.0) / max(taken, 1.0);
    vec3 light = sure + sampled / max(taken, 1.0);
    for (int g = 0; g < 2; g++) {
        vec3 share = vec3(open[g].r > 0.0 ? seen[g].r / open[g].r : 0.0, open[g].g > 0.0 ? seen[g].g / open[g].g : 0.0, open[g].b > 0.0 ? seen[g].b / open[g].b : 0.0);
        float mean = dot(all[g], vec3(1.0 / 3.0)), lit_share = lit[g] / max(samples[g], 1.0);
        if (sparse[g] > 0.0) continue;
        light += all[g] * share;
        variance += mean * mean * lit_share * (1.0 - lit_share) / max(samples[g], 1.0);
    }
    sbl_write(out_light, vec4(light, SBL_STRATA * variance * unit * scale) * unit * scale);
}
