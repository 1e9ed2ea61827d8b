// Light from lamps: emitting triangles, punctual lights, bright spots of the sky. What each gives where nothing
// stands between is known in closed form; rays only measure which share of it arrives: the ratio estimator of
// Heitz, Hill and McGuire 2018, "Combining analytic direct illumination and stochastic shadows". Where lamps are
// many, those far off stand together in clusters, of which only single lamps, picked in proportion to what they
// give, are ever looked at.
//
//     choose   which lamps and clusters count here, and what each gives
//     pick     one of them for a ray, and how often it is picked
//     shoot    the ray: what it would bring, and whether something stands between
//     combine  what the rays found with what is known
//
// One invocation is one sensor, or a part of its rays where they are many: neighbours trace neighbouring rays, and
// each stops as soon as it knows enough. With SBL_INSPECT it is one ray of one sensor, or one of the entries it
// chose: what these gave is written.
uniform usamplerBuffer sbl_sequence;  // see trace.glsl
uniform int lamp_nodes, lamp_leaves;  // how many
uniform int rays;                     // at most so many a sensor
uniform float unit, scale;            // radiance that calculations are in, so that none overflows; of what is
                                      // written
#ifdef SBL_INSPECT
uniform int parts;                    // that the sensor's rays were traced in
uniform int sheet_slot;               // where its views stand
SBL_OUT(0, out_light);                // a ray: what it brought; 1: open, 2: hidden, 0: was not sent. An entry: R
                                      // from it unhindered; 1: a lamp, 2: a point of light that is open, 3: one
                                      // that is hidden
SBL_OUT(1, out_way);                  // a ray: its direction, its lamp's leaf. An entry: 0 0 0, its leaf
#else
SBL_OUT(0, out_light);                // R, each part's own; the variance of its luminance
#ifdef SBL_DIRECTIONAL
SBL_OUT(1, out_red);                  // and its harmonics
SBL_OUT(2, out_green);
SBL_OUT(3, out_blue);
#endif
#endif

const int SBL_CERTAIN = 32;         // so many points of light get a ray each
const float SBL_STRATA = 1.5;       // variance of n stratified points, as a share of independent ones', times the
                                    // root of n: what edges across a lamp leave, measured;
const float SBL_STRATA_LOST = 0.6;  // and where as many lamps share the points
const float SBL_OPENING = 0.3;      // a cluster whose radius is a smaller share of its distance is not opened ...
const int SBL_OPENINGS = 12;        // ... or of twice as much, and so on, until all entries have room
const float SBL_SPARSE = 16.0;      // rays that a group must get on average, to be known by a ratio
const int SBL_PASS_RAYS = 32;       // rays are traced in passes, SBL_LAMP_PASSES at most; after each it is seen
                                    // whether
const float SBL_PASS_CROWD = 16.0;  // they were enough. Of so many rays at least, and the fewer the more lamps
                                    // share the light
const int SBL_RIM_LAMPS = 8;        // of so few entries, corners and rims are looked at besides
const int SBL_CORNERS = 3;          // of a triangle, each so far from the others:
const float SBL_CORNER = 0.996, SBL_OTHER_CORNER = 0.002;
const int SBL_RIM = 12;             // points along the rim of a round lamp, at this share of its disc:
const float SBL_RIM_AT = 0.99;
const float SBL_KNOWN = 1e-6;       // relative variance from which on clusters are known well enough
const float SBL_SMALL = 16.0;       // squared distance over squared size from which on a triangle is
const float SBL_POINT[2] = float[2](-0.337845472747895, 0.725271359470687);
const float SBL_POINT_WEIGHT[2] = float[2](0.223381589678011, 0.109951743655322);
const float SBL_BEFORE_LAMP = 0.99999;  // share of the way to a lamp that must be free

struct sbl_Lamp {
    uint kind;
    vec3 brightness;           // a triangle's radiance; a light's irradiance of a surface here that faces it; a
                               // texel's light, radiance times solid angle
    vec3 corner;               // of the triangle, from the sensor; else the unit direction to the light's, or the
                               // texel's, middle
    vec3 side_1, side_2;       // of the triangle
    float away, radius, sine2; // of a light: distance, radius, sine squared of the angle that it spans each way
    ivec2 texel;
    int triangle, number;      // as traced; in the scene
    vec2 group;                // 0 1 for a triangle that turns its back to the sensor, else 1 0
};

bool sbl_is_light(sbl_Lamp l) { return l.kind == SBL_LAMP_NEAR_LIGHT || l.kind == SBL_LAMP_FAR_LIGHT; }

// The sensor, and what is known of it.
int look;                    // its number among those sent
vec3 stand, position, n;     // where its rays start; on the surface: a lamp close by is seen from there; normal
mat3 to_frame;
uvec2 scramble;

sbl_Lamp sbl_lamp(int leaf) {
    uint code = sbl_lamp_leaf_code(leaf), at = code & ((1u << SBL_LAMP_KIND_SHIFT) - 1u);
    sbl_Lamp l = sbl_Lamp(code >> SBL_LAMP_KIND_SHIFT, vec3(0), vec3(0), vec3(0), vec3(0), SBL_UNBOUNDED, 0.0, 0.0,
                          ivec2(0), int(at), -1, vec2(1, 0));
    if (l.kind == SBL_LAMP_TRIANGLE) {
        int object = int(sbl_triangle_object(l.triangle));
        l.corner = sbl_triangle_corner_0(l.triangle);
        l.side_1 = sbl_triangle_corner_1(l.triangle) - l.corner;
        l.side_2 = sbl_triangle_corner_2(l.triangle) - l.corner;
        l.corner -= position;
        l.number = int(sbl_triangle_number(l.triangle));
        vec3 normal = cross(l.side_1, l.side_2);
        float off = dot(normal, l.corner);
        l.group = off > 0.0 ? vec2(0, 1) : vec2(1, 0);
        l.brightness = sbl_emission(object, l.group.y == 1.0) / unit;
        // seen edge-on; above all its own, which rounding may put above the horizon, all over it
        if (abs(off) < 0.5 * sbl_look_offset(look) * length(normal)) l.brightness = vec3(0);
    }
#ifdef SBL_MIXED
    if (l.kind == SBL_LAMP_SKY_TEXEL) {
        uint width = uint(textureSize(sky_picture, 0).x);
        l.texel = ivec2(at % width, at / width);
        vec2 size = vec2(textureSize(sky_picture, 0)), middle = (vec2(l.texel) + 0.5) / size;
        vec3 radiance = texelFetch(sky_picture, l.texel, 0).rgb;
        l.corner = sbl_sky_direction(middle.x, cos(SBL_PI * middle.y));
        l.brightness = radiance * (sbl_sky_excess(radiance) / unit * (2.0 * SBL_PI / size.x) * 2.0 *
                                   sin(SBL_PI * middle.y) * sin(0.5 * SBL_PI / size.y));
    }
    if (sbl_is_light(l)) {
        l.corner = sbl_light_position(int(at));
        l.brightness = sbl_light_intensity(int(at)) / unit;
        l.sine2 = sbl_light_radius(int(at));
        if (l.kind == SBL_LAMP_NEAR_LIGHT) {
            l.corner -= position;
            l.radius = l.sine2;
            l.away = length(l.corner);
            l.corner /= max(l.away, 1e-30);
            float spot = clamp(dot(sbl_light_axis(int(at)), -l.corner) * sbl_light_spot_scale(int(at)) +
                               sbl_light_spot_offset(int(at)), 0.0, 1.0);  // KHR_lights_punctual
            if (l.away < l.radius) { l.corner = n; l.away = l.radius; spot = 1.0; }  // the sensor stands in it
            l.brightness *= spot * spot / (l.away * l.away);
            l.sine2 = min(l.radius * l.radius / (l.away * l.away), 1.0);
        }
    }
#endif
    return l;
}

// >>closed forms

// An edge's part of Lambert's sum: the angle it spans, times the cosine of its plane's normal to z.
float sbl_edge(vec3 p, vec3 q) {
    vec3 normal = cross(p, q);
    float size = length(normal);
    return size > 0.0 ? atan(size, dot(p, q)) * normal.z / size : 0.0;
}

// Share of a hemisphere around z that a triangle fills, weighted by the cosine. Corners relative to the sensor, in
// its frame. Lambert 1760: the sum over the edges of what is above the horizon; where the triangle is small for
// its distance that would lose itself in rounding, and six points (Dunavant 1985, degree 4) know it to 4e-6.
float sbl_form_factor(vec3 a, vec3 b, vec3 c) {
    vec3 corners[3] = vec3[3](a, b, c), entry = vec3(0), leave = vec3(0);
    vec3 middle = (a + b + c) / 3.0, normal = cross(b - a, c - a);
    float distance2 = dot(middle, middle), points = 0.0, sum = 0.0;
    float size2 = max(dot(b - a, b - a), max(dot(c - a, c - a), dot(c - b, c - b)));
    bool small = min(a.z, min(b.z, c.z)) > 0.0 && distance2 > SBL_SMALL * size2, cut = false;
    for (int k = 0; k < 6; k++) {  // on the ways from the corners to the middle, and beyond it
        vec3 p = middle + SBL_POINT[k / 3] * (corners[k % 3] - middle);
        float length2 = dot(p, p) / distance2;
        points += SBL_POINT_WEIGHT[k / 3] * p.z / (length2 * length2);
    }
    int edges = small || max(a.z, max(b.z, c.z)) <= 0.0 ? 0 : 4;
    for (int k = 0; k < edges; k++) {
        vec3 p = k == 3 ? leave : corners[k], q = k == 3 ? entry : corners[k == 2 ? 0 : k + 1];
        if (k == 3 ? !cut : max(p.z, q.z) <= 0.0) continue;
        if (k < 3 && min(p.z, q.z) <= 0.0) {
            vec3 x = vec3(mix(p.xy, q.xy, p.z / (p.z - q.z)), 0);
            cut = true;
            if (p.z <= 0.0) entry = p = x;
            else leave = q = x;
        }
        sum += sbl_edge(p, q);
    }
    return small ? points * 0.5 * abs(dot(normal, middle)) / (SBL_PI * distance2 * distance2)
                 : abs(sum) / (2.0 * SBL_PI);
}

// The same for a round lamp whose middle has the cosine z to the normal, over the sine squared of the angle that
// it spans to each side: Snyder 1996, "Area Light Sources for Real-Time Graphics"; small ones as flat discs.
float sbl_round(float z, float sine2) {
    float sine = sqrt(sine2), s = sqrt(max(1.0 - z * z, 0.0));
    if (z >= sine || z <= -sine) return max(z, 0.0);
    float q = z / sine, x = sqrt(1.0 / sine2 - 1.0), y = clamp(-x * z / s, -1.0, 1.0), w = s * sqrt(1.0 - y * y);
    if (sine2 < 1e-4) return sine / SBL_PI * (q * acos(-q) + sqrt(1.0 - q * q) * (2.0 + q * q) / 3.0);
    return (z * acos(y) - x * w + atan(w, x) / sine2) / SBL_PI;
}

// R from a lamp that nothing hides.
vec3 sbl_unhindered(sbl_Lamp l) {
    float factor = 0.0;
    if (l.kind == SBL_LAMP_TRIANGLE) {
        vec3 corner = to_frame * l.corner;
        factor = sbl_form_factor(corner, corner + to_frame * l.side_1, corner + to_frame * l.side_2);
    }
#ifdef SBL_MIXED
    if (sbl_is_light(l)) factor = sbl_round(dot(n, l.corner), l.sine2) / SBL_PI;
    // about: above 0 where some of it is above the horizon
    if (l.kind == SBL_LAMP_SKY_TEXEL)
        factor = max(dot(n, l.corner) + SBL_PI / float(textureSize(sky_picture, 0).y), 0.0) / SBL_PI;
#endif
    return l.brightness * factor;
}

#ifdef SBL_DIRECTIONAL
// What a lamp that nothing hides gives of the first four harmonics: of its solid angle, and of the integral of
// directions over it, whose part along the normal is R's. Of round lamps on the horizon the rest is a guess.
mat3x4 sbl_unhindered_harmonics(sbl_Lamp l) {
    float solid_angle = 0.0;
    vec3 way = vec3(0);
    if (l.kind == SBL_LAMP_TRIANGLE) {
        vec3 a = to_frame * l.corner, sides[2] = vec3[2](to_frame * l.side_1, to_frame * l.side_2);
        vec3 corners[3] = vec3[3](a, a + sides[0], a + sides[1]), kept[4];
        int count = 0;
        for (int k = 0; k < 3; k++) {
            vec3 p = corners[k], q = corners[(k + 1) % 3];
            if (p.z > 0.0) kept[count++] = p;
            if ((p.z > 0.0) != (q.z > 0.0)) kept[count++] = vec3(mix(p.xy, q.xy, p.z / (p.z - q.z)), 0);
        }
        for (int k = 0; k < count; k++) {  // Lambert 1760
            vec3 p = kept[k], q = kept[k + 1 < count ? k + 1 : 0], across = cross(p, q);
            float size = length(across);
            way += size > 0.0 ? 0.5 * atan(size, dot(p, q)) / size * across : vec3(0);
        }
        for (int k = 1; k + 1 < count; k++) {  // Van Oosterom and Strackee 1983
            vec3 p = kept[0], q = kept[k], r = kept[k + 1], lengths = vec3(length(p), length(q), length(r));
            float cosines = lengths.x * lengths.y * lengths.z + dot(p, q) * lengths.z + dot(q, r) * lengths.x +
                            dot(r, p) * lengths.y;
            solid_angle += 2.0 * atan(dot(p, cross(q, r)), cosines);
        }
        way = transpose(to_frame) * way * sign(solid_angle);
        solid_angle = abs(solid_angle);
    }
#ifdef SBL_MIXED
    if (sbl_is_light(l)) {  // all of it has the intensity pi times sine squared, see sbl_round
        float z = dot(n, l.corner), shown = clamp(0.5 + 0.5 * z / max(sqrt(l.sine2), 1e-30), 0.0, 1.0);
        solid_angle = shown * 2.0 / (1.0 + sqrt(1.0 - l.sine2));
        way = shown * (l.corner - z * n) + sbl_round(z, l.sine2) * n;
    }
#endif
    return outerProduct(vec4(SBL_HARMONIC_0 * solid_angle, SBL_HARMONIC_1 * way.yzx), l.brightness);
}
#endif

// >>clusters

struct sbl_Cluster {
    vec3 to;       // its middle, from the sensor
    float radius;
    bool far;      // directions
    int beyond;    // the node after it
};

sbl_Cluster sbl_cluster(int node) {
    uint beyond = sbl_lamp_node_beyond(node);
    bool far = (beyond & SBL_FAR_NODE) != 0u;
    return sbl_Cluster(sbl_lamp_node_middle(node) - (far ? vec3(0) : position), sbl_lamp_node_radius(node), far,
                       int(beyond & ~SBL_FAR_NODE));
}

// What it gives about: zero only where none of its lamps gives anything.
float sbl_strength(int node, sbl_Cluster c) {
    vec3 square = sbl_lamp_node_square(node), mixed = sbl_lamp_node_mixed(node), front = sbl_lamp_node_front(node);
    float distance2 = max(dot(c.to, c.to), 1e-37), spread = min(c.radius * inversesqrt(distance2), 1.0);
    float height = dot(n, c.to);
    // far lamps turn no sides to the sensor, but are seen under the cosine to its normal
    vec3 w = c.far ? -n : c.to * inversesqrt(distance2);
    float shown = sqrt(max(dot(square, w * w) + 2.0 * dot(mixed, w.xyz * w.yzx), 0.0)) - dot(front, w) +
                  0.1 * sbl_lamp_node_power(node) * spread;
    if (height + c.radius <= 0.0) return 0.0;
    float near = max(height, 0.5 * (height + c.radius)) * inversesqrt(distance2) /
                 max(distance2, c.radius * c.radius);
    return max(shown, 0.0) * (c.far ? 1.0 : near) / unit;
}

// >>points of lamps

// A direction to the spherical triangle of unit vectors a, b, c, evenly distributed: Arvo 1995, "Stratified
// Sampling of Spherical Triangles". w: its solid angle; 0 where it is too small for that.
vec4 sbl_spherical(vec3 a, vec3 b, vec3 c, vec2 u) {
    vec3 ab = cross(a, b), bc = cross(b, c), ca = cross(c, a);
    float alpha = atan(length(cross(ab, ca)), -dot(ab, ca)), beta = atan(length(cross(bc, ab)), -dot(bc, ab));
    float gamma = atan(length(cross(ca, bc)), -dot(ca, bc)), solid_angle = alpha + beta + gamma - SBL_PI;
    if (!(solid_angle > 0.01)) return vec4(0);
    float s = sin(u.x * solid_angle - alpha), t = cos(u.x * solid_angle - alpha);
    float sin_alpha = sin(alpha), cos_alpha = cos(alpha);
    float p = t - cos_alpha, v = s + sin_alpha * dot(a, b);
    float q = clamp(((v * t - p * s) * cos_alpha - v) / ((v * s + p * t) * sin_alpha), -1.0, 1.0);
    vec3 cut = q * a + sqrt(1.0 - q * q) * normalize(c - dot(c, a) * a);
    float z = 1.0 - u.y * (1.0 - dot(cut, b));
    return vec4(z * b + sqrt(max(1.0 - z * z, 0.0)) * normalize(cut - dot(cut, b) * b), solid_angle);
}

struct sbl_Sample {
    vec3 direction;
    float far;    // how far it is
    vec3 light;   // R from the lamp, were it all like this point
    vec2 b;       // barycentrics on a triangle
};

// Weights of a triangle's second and third corner at a point of its plane. from_corner: from the first corner.
vec2 sbl_barycentrics(sbl_Lamp l, vec3 normal, vec3 from_corner) {
    vec2 areas = vec2(dot(cross(from_corner, l.side_2), normal), dot(cross(l.side_1, from_corner), normal));
    return areas / dot(normal, normal);
}

sbl_Sample sbl_sample(sbl_Lamp l, vec2 u) {
    sbl_Sample s = sbl_Sample(l.corner, SBL_UNBOUNDED, l.brightness / SBL_PI, u);
    // by solid angle where it is large, else by area (Heitz 2019, "A Low-Distortion Map Between Triangle and
    // Square")
    if (l.kind == SBL_LAMP_TRIANGLE) {
        vec3 normal = cross(l.side_1, l.side_2), corner_1 = l.corner + l.side_1, corner_2 = l.corner + l.side_2;
        vec4 ray = sbl_spherical(normalize(l.corner), normalize(corner_1), normalize(corner_2), u);
        s.b = u.y > u.x ? vec2(0.5 * u.x, u.y - 0.5 * u.x) : vec2(u.x - 0.5 * u.y, 0.5 * u.y);
        // not so near to an edge that rounding may carry the ray past it
        float reach2 = dot(l.corner, l.corner), longest2 = max(dot(l.side_1, l.side_1), dot(l.side_2, l.side_2));
        float keep = 3e-6 * sqrt(longest2) * reach2 / max(abs(dot(normal, l.corner)), 1e-37);
        s.b = mix(s.b, vec2(1.0 / 3.0), min(keep, 0.5));
        vec3 to = l.corner + s.b.x * l.side_1 + s.b.y * l.side_2;
        if (ray.w > 0.0) {
            to = ray.xyz * dot(l.corner, normal) / dot(ray.xyz, normal);
            s.b = sbl_barycentrics(l, normal, to - l.corner);
        }
        s.far = length(to);
        s.direction = to / s.far;
        s.light *= ray.w > 0.0 ? ray.w : 0.5 * abs(dot(normal, s.direction)) / (s.far * s.far);
    }
#ifdef SBL_MIXED
    if (l.kind == SBL_LAMP_SKY_TEXEL) {
        vec2 size = vec2(textureSize(sky_picture, 0));
        float row = float(l.texel.y);
        s.direction = sbl_sky_direction((float(l.texel.x) + u.x) / size.x,
                                        mix(cos(SBL_PI * row / size.y), cos(SBL_PI * (row + 1.0) / size.y), u.y));
    }
    if (sbl_is_light(l)) {
        // off: what the ray's cosine to the middle lacks to 1
        float cosine = sqrt(1.0 - l.sine2), off = u.x * l.sine2 / (1.0 + cosine);
        float r = sqrt(max(off * (2.0 - off), 0.0));
        float angle = 2.0 * SBL_PI * u.y;
        s.direction = sbl_frame(l.corner) * vec3(r * cos(angle), r * sin(angle), 1.0 - off);
        s.light *= 2.0 / (1.0 + cosine);
        if (l.kind == SBL_LAMP_NEAR_LIGHT)
            s.far = l.away * (1.0 - off) - sqrt(max(l.radius * l.radius - l.away * l.away * r * r, 0.0));
    }
#endif
    s.light *= max(dot(n, s.direction), 0.0);
    return s;
}

#ifdef SBL_VIEWS  // what the host draws stands in the sensor's own views only
uniform sampler2D atlas;        // Ck r g b, signed distance along the view's axis
uniform vec4 view_rects[5];     // x, y, width, height in the sheet
uniform ivec2 sheet;            // a sensor's, in texels
uniform int view_count;
uniform float tangent, extent;  // of half a view's width; world units of a distance

const float SBL_AT_LAMP = 0.002;  // share of a distance that texels' 16-bit floats leave open
const int SBL_LOOKS_AGAIN = 4;

// A texel shows what stands in its middle, where a lamp's triangle may have ended: such points ask again, nearer
// to the triangle's middle.
bool sbl_hidden(int slot, sbl_Lamp l, sbl_Sample s) {
    float turn = sbl_look_rotation(look);
    mat3 frame = sbl_frame(n);
    vec3 axes[2] = vec3[2](cos(turn) * frame[0] - sin(turn) * frame[1],
                           -cos(turn) * frame[1] - sin(turn) * frame[0]);  // right and up, see sbl__frame
    vec3 normal = cross(l.side_1, l.side_2), point = s.far * s.direction;
    vec3 middle = l.corner + (l.side_1 + l.side_2) / 3.0;
    if (l.kind != SBL_LAMP_TRIANGLE) point = s.direction;
    for (int attempt = 0; attempt < SBL_LOOKS_AGAIN; attempt++, point = mix(point, middle, 0.4)) {
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
        vec2 lowest = vec2(-1, top ? -1 : 0), size = vec2(1) - lowest;
        vec2 at = (vec2(dot(point, right), dot(point, up)) / (dot(point, forward) * tangent) - lowest) / size;
        vec2 texel = clamp(floor(at * rect.zw), vec2(0), rect.zw - 1.0);
        vec2 centre = lowest + (texel + 0.5) / rect.zw * size;
        ivec2 place = ivec2(slot % columns, slot / columns) * sheet + ivec2(rect.xy + texel);
        float shown = texelFetch(atlas, place, 0).a, seen = abs(shown) * extent;
        if (seen == 0.0) return false;
        if (l.kind != SBL_LAMP_TRIANGLE) return seen < (1.0 - SBL_AT_LAMP) * s.far * dot(point, forward);
        vec3 ray = forward + tangent * (centre.x * right + centre.y * up);
        float there = dot(l.corner, normal) / dot(ray, normal);  // where it meets the lamp's plane
        bool other_side = (shown < 0.0) != (l.group.y == 1.0);   // of a thin body
        bool beyond = seen > (1.0 + SBL_AT_LAMP) * there;
        if (there > 0.0 && (beyond || (seen >= (1.0 - SBL_AT_LAMP) * there && !other_side))) return false;
        vec2 b = sbl_barycentrics(l, normal, there * ray - l.corner);
        if (attempt == SBL_LOOKS_AGAIN - 1 || (there > 0.0 && min(b.x, b.y) >= 0.0 && b.x + b.y <= 1.0))
            return seen < (other_side ? 1.0 + SBL_AT_LAMP : 1.0 - SBL_AT_LAMP) * dot(point, forward);
    }
    return true;
}
#endif

// >>choose: single lamps and, where there are many, clusters that are small for their distance

int entries[SBL_LAMPS];      // a leaf, or -1 - a node; from the end on: points of light, which get a ray each
float strengths[SBL_LAMPS];  // what each gives about, summed up
int used, certain;           // how many of either
float total, crowd;          // sum of the strengths, and of their squares,
float crowd_within;          // with those of the lamps in clusters
mat2x3 whole;                // light of single lamps, unhindered; two groups, since of a closed mesh one is all
                             // hidden, the other all open
bool rounded;                // there are round lamps
#ifdef SBL_DIRECTIONAL
mat3x4 whole_harmonics[2];
#endif

// Takes node or leaf number i into account; returns the one that is next, or `limit` where entries have run out.
int sbl_consider(int i, int limit, float opening, bool last, out bool full) {
    int leaf = i, next = i + 1, lamps = 1;
    float strength = 0.0;
    bool single = lamp_leaves <= SBL_LAMPS, point = false;
    full = false;
#ifdef SBL_MIXED
    if (!single) {
        sbl_Cluster c = sbl_cluster(i);
        if (dot(n, c.to) + c.radius <= 0.0) next = c.beyond;
        else if (c.beyond == i + 1) {
            single = true;
            leaf = int(sbl_lamp_node_first_leaf(i));
        } else if (last || c.radius * c.radius < opening * opening * dot(c.to, c.to)) {
            next = c.beyond;
            lamps = (c.beyond - i + 1) / 2;
            strength = sbl_strength(i, c);
        }
    }
#endif
    if (single) {
        sbl_Lamp l = sbl_lamp(leaf);
        vec3 light = sbl_unhindered(l);
        strength = light.r + light.g + light.b;
        rounded = rounded || l.kind != SBL_LAMP_TRIANGLE;
        point = l.sine2 == 0.0 && sbl_is_light(l) && certain < SBL_CERTAIN;
        if (!point && l.kind != SBL_LAMP_SKY_TEXEL) {
            whole += outerProduct(light, l.group);
#ifdef SBL_DIRECTIONAL
            whole_harmonics[l.group.y > 0.0 ? 1 : 0] += sbl_unhindered_harmonics(l);
#endif
        }
    }
    if (strength > 0.0) {
        full = used + certain == SBL_LAMPS;
        if (full) next = limit;
        else if (point) entries[SBL_LAMPS - ++certain] = leaf;
        else {
            total += strength;
            crowd += strength * strength;
            crowd_within += strength * strength / float(lamps);
            strengths[used] = total;
            entries[used++] = single ? leaf : -1 - i;
        }
    }
    return next;
}

void sbl_choose() {
    int limit = lamp_leaves <= SBL_LAMPS ? lamp_leaves : lamp_nodes;
    float opening = SBL_OPENING;
    bool full = true;
    rounded = false;
    for (int attempt = 0; attempt < SBL_OPENINGS && full; attempt++, opening *= 2.0) {
        used = certain = 0;
        total = crowd = crowd_within = 0.0;
        whole = mat2x3(0);
#ifdef SBL_DIRECTIONAL
        whole_harmonics[0] = whole_harmonics[1] = mat3x4(0);
#endif
        full = false;
        for (int i = 0; i < limit; ) i = sbl_consider(i, limit, opening, attempt == SBL_OPENINGS - 1, full);
    }
}

// >>pick

struct sbl_Pick {
    int leaf;
    float share;   // how often it is picked
    vec2 u;        // what is left of the point of the sequence
    bool cluster;  // it was picked out of one
};

// Down to one lamp of a cluster, at every fork in proportion to what the branches give.
void sbl_descend(inout sbl_Pick p, int node, uint fraction) {
    // digits below those of a float that are left
    p.u.x = clamp(p.u.x + (float(fraction & 255u) - 127.5) / 4294967296.0 / p.share, 0.0, 1.0);
    for (sbl_Cluster c = sbl_cluster(node); c.beyond != node + 1; c = sbl_cluster(node)) {
        sbl_Cluster left = sbl_cluster(node + 1), right = sbl_cluster(left.beyond);
        float weight = sbl_strength(node + 1, left);
        float share = weight / max(weight + sbl_strength(left.beyond, right), 1e-37);
        bool first = p.u.x < share;
        node = first ? node + 1 : left.beyond;
        p.share *= first ? share : 1.0 - share;
        p.u.x = first ? p.u.x / share : (p.u.x - share) / (1.0 - share);
    }
    p.leaf = int(sbl_lamp_node_first_leaf(node));
}

// One of the entries in proportion to its strength.
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
    p.share = width / total;
    return entries[low];
}

// >>shoot

mat2x3 open, seen;       // what rays to single lamps bring without, and with, what stands between
vec3 sure, sampled;      // from points of light; from clusters, summed over the rays
vec2 samples, lit;       // rays of a group that would bring light, and that do
float taken, squares;    // rays; sum of the squares of what clusters gave
vec2 sparse;             // 1: a group that rays hardly meet is no ground for a ratio: it is sampled as clusters
                         // are
vec2 bright, dark;       // whether any of a group was seen, or hidden
#ifdef SBL_DIRECTIONAL
mat3x4 open_harmonics[2], seen_harmonics[2], sure_harmonics, sampled_harmonics;  // as the above
#endif
#ifdef SBL_INSPECT
vec4 report, report_way; // what is written
bool reporting;          // the ray that is shot is the one
#endif

// The ray of a sample. rim: of a at_rim, the number of its point along the lamp's rim; negative: it is none. A
// at_rim brings no light.
void sbl_shoot(int slot, sbl_Pick p, sbl_Lamp l, sbl_Sample s, int rim, bool point) {
    bool at_rim = rim >= 0, cluster = p.cluster || l.kind == SBL_LAMP_SKY_TEXEL || dot(sparse, l.group) > 0.0;
    vec3 light = s.light / p.share, to = s.direction;
    taken += point || at_rim ? 0.0 : 1.0;
    if (!(light.r + light.g + light.b > 0.0)) return;
#ifdef SBL_DIRECTIONAL
    vec4 counts = sbl_harmonics(s.direction, n, 1.0 / max(dot(s.direction, n), SBL_COSINE_LEAST));
    if (!cluster && !point && !at_rim) open_harmonics[l.group.y > 0.0 ? 1 : 0] += outerProduct(counts, light);
#endif
    if (!cluster && !point && !at_rim) {
        open += outerProduct(light, l.group);
        samples += l.group;
    }
    if (s.far < SBL_UNBOUNDED) to = s.far * s.direction + (position - stand);
    float away = s.far < SBL_UNBOUNDED ? length(to) : 1.0;
    sbl_Hit hit = sbl_trace(stand, to / away, s.far < SBL_UNBOUNDED ? away * SBL_BEFORE_LAMP : SBL_UNBOUNDED);
    bool hidden = hit.triangle >= 0 && hit.number != l.number;
#ifdef SBL_VIEWS
    hidden = hidden || sbl_hidden(slot, l, s);
#endif
#ifdef SBL_INSPECT
    if (reporting) {
        report = vec4(point ? s.light : vec3(0), (hidden ? 2.0 : 1.0) + (point ? 1.0 : 0.0));
        report_way = vec4(point ? vec3(0) : to / away, p.leaf);
    }
#endif
    if (!point && (at_rim || !cluster)) {
        if (hidden) dark += l.group;
        else bright += l.group;
    }
    if (hidden || at_rim) return;
#ifdef SBL_TEXTURED
    if (l.kind == SBL_LAMP_TRIANGLE) {
        sbl_Attributes at = sbl_attributes_at(l.triangle, s.b.x, s.b.y);
        light *= sbl_emission_pattern(int(sbl_triangle_object(l.triangle)), at);
    }
#endif
#ifdef SBL_INSPECT
    if (reporting && !point) report.rgb = light;
#endif
#ifdef SBL_DIRECTIONAL
    mat3x4 harmonics = outerProduct(counts, light);
    if (point) sure_harmonics += harmonics;
    else if (cluster) sampled_harmonics += harmonics;
    else seen_harmonics[l.group.y > 0.0 ? 1 : 0] += harmonics;
#endif
    if (point) sure += light;
    else if (cluster) {
        sampled += light;
        float mean = dot(light, SBL_LUMINANCE);
        squares += mean * mean;
    } else {
        seen += outerProduct(light, l.group);
        lit += l.group;
    }
}

// >>combine

// Variance of the mean of n points over the lamps, as a share of one's: strata of a lamp's own are the smaller the
// more points it gets.
float sbl_strata(float n) {
    float lamps = total * total / max(crowd_within, 1e-37), points = max(n, 1.0);
    return min(SBL_STRATA * sqrt(max(lamps - 1.0, 1.0) / points), SBL_STRATA_LOST) / points;
}

// All is open, or nothing: the first rays tell; so do clusters that are alike.
bool sbl_undecided() {
    float mean = dot(sampled, SBL_LUMINANCE) / max(taken, 1.0);
    float error = squares / max(taken, 1.0) - mean * mean;
    bool mixed = dot(bright, dark) > 0.0 || (seen[0] != vec3(0) && seen[0] != open[0]) ||
                 (seen[1] != vec3(0) && seen[1] != open[1]);
    return mixed || sbl_strata(taken) * error > SBL_KNOWN * mean * mean;
}

// R, and the variance of its luminance.
vec4 sbl_combine() {
    float clusters = dot(sampled, SBL_LUMINANCE) / max(taken, 1.0);
    float variance = max(squares / max(taken, 1.0) - clusters * clusters, 0.0) * sbl_strata(taken);
    vec3 light = sure + sampled / max(taken, 1.0);
#ifdef SBL_DIRECTIONAL
    sure_harmonics += sampled_harmonics / max(taken, 1.0);
#endif
    for (int g = 0; g < 2; g++) {
        vec3 share = vec3(open[g].r > 0.0 ? seen[g].r / open[g].r : 0.0,
                          open[g].g > 0.0 ? seen[g].g / open[g].g : 0.0,
                          open[g].b > 0.0 ? seen[g].b / open[g].b : 0.0);
        float mean = dot(whole[g], SBL_LUMINANCE), lit_share = lit[g] / max(samples[g], 1.0);
        if (sparse[g] > 0.0) continue;
        light += whole[g] * share;
#ifdef SBL_DIRECTIONAL
        // all that is known, as far as it is seen; and by what the seen part differs from that, as rays tell
        for (int k = 0; k < 3; k++)
            if (open[g][k] > 0.0)
                sure_harmonics[k] += share[k] * whole_harmonics[g][k] + whole[g][k] / open[g][k] *
                                     (seen_harmonics[g][k] - share[k] * open_harmonics[g][k]);
#endif
        variance += mean * mean * lit_share * (1.0 - lit_share) * sbl_strata(samples[g]);
    }
    return vec4(light, variance * unit * scale) * unit * scale;
}

// How many passes the rays are traced in: after the first, an eighth of them or half of few, it is known whether
// there is more to learn: what it overlooks is less than a ray's share. The more lamps there are, the more of the
// rays it takes to know each.
int sbl_pass_count() {
    float crowded = SBL_PASS_CROWD * crowd / max(total * total, 1e-37);
    int passes = clamp(min(rays / SBL_PASS_RAYS, int(crowded)), 1, SBL_LAMP_PASSES), power = 1;
    while (2 * power <= passes) power *= 2;
    return power;
}

void main() {
    ivec2 at = sbl_texel_of_invocation();
#ifdef SBL_INSPECT
    int wanted = at.y * blocks.x + at.x, certain_ray = rays + SBL_LAMPS - 1 - wanted, part = 0, slot = sheet_slot;
    if (wanted >= rays + SBL_LAMPS) sbl_leave;
    while (wanted < rays && part + 1 < parts && (part + 1) * rays / parts <= wanted) part++;
    if (wanted >= rays) part = certain_ray % parts;
    look = 0;
    report = report_way = vec4(0);
#else
    int parts = blocks.y, part = at.y % parts, slot = at.y / parts * columns + at.x;
    look = slot - first_slot;
    if (look < 0 || look >= count) sbl_leave;
#endif
    n = sbl_look_normal(look);
    stand = sbl_look_position(look);
    position = stand - sbl_look_offset(look) * n;
    to_frame = transpose(sbl_frame(n));
    uint hash = sbl_look_lamp_scramble(look);
    scramble = uvec2(hash, (hash ^ hash >> 15) * 747796405u);
    scramble.y ^= scramble.y >> 13;
    sbl_choose();
#ifdef SBL_INSPECT
    if (wanted >= rays && wanted - rays < used && entries[wanted - rays] >= 0) {
        report = vec4(sbl_unhindered(sbl_lamp(entries[wanted - rays])), 1);
        report_way.w = float(entries[wanted - rays]);
    }
#endif

    open = seen = mat2x3(0);
    sure = sampled = vec3(0);
    samples = lit = bright = dark = vec2(0);
    taken = squares = 0.0;
#ifdef SBL_DIRECTIONAL
    sure_harmonics = sampled_harmonics = mat3x4(0);
    open_harmonics[0] = open_harmonics[1] = seen_harmonics[0] = seen_harmonics[1] = mat3x4(0);
#endif
    float enough = SBL_SPARSE * float(parts) / float(rays) * total;
    sparse = vec2(lessThan(vec3(1) * whole, vec2(enough)));
    // So that the first pass does not overlook an edge that hides little, corners and rims of few lamps are looked
    // at.
    int passes = sbl_pass_count(), rims = rounded ? SBL_RIM : SBL_CORNERS;
    int rim_samples = passes > 1 && used <= SBL_RIM_LAMPS ? rims * used : 0;
    int skip = int(sbl_look_which(look) & SBL_LOOK_NUMBER) * rays;
    bool undecided = total > 0.0;
    for (int pass = -1; pass < passes && (pass < 0 || undecided); pass++) {  // the points of light come first
        // each part has a stretch of the sequence, and each eighth of it covers a lamp, and the lamps, evenly
        int eighth = SBL_LAMP_PASSES * part, eighths = SBL_LAMP_PASSES * parts;
        // (unsigned: on some software renderers idle lanes divide what they hold, and INT_MIN / -1 traps)
        int stretch = int(uint(SBL_LAMP_PASSES) / uint(passes));
        int from = int(uint((eighth + pass * stretch) * rays) / uint(eighths));
        int to = total > 0.0 ? int(uint((eighth + (pass + 1) * stretch) * rays) / uint(eighths)) : from;
        bool point = pass < 0;
        int start = point ? part : pass == 0 ? from - rim_samples : from, end = point ? certain : to;
        for (int k = start; k < end; k += point ? parts : 1) {
            bool at_rim = pass == 0 && k < from;
            uint rim_index = uint(from - 1 - k);
            int rim = at_rim ? int(rim_index % uint(rims)) : -1, entry = entries[point ? SBL_LAMPS - 1 - k : 0];
            uvec2 fraction = texelFetch(sbl_sequence, skip + max(k, 0)).xy ^ scramble;
            vec2 u = sbl_unit_square(fraction);
            sbl_Pick p = sbl_Pick(0, point ? 1.0 / float(parts) : 1.0, u, false);
            if (at_rim) entry = entries[rim_index / uint(rims)];
            else if (!point) entry = sbl_pick_entry(p);
            if (at_rim && entry < 0) continue;
            p.leaf = entry;
            p.cluster = entry < 0;
#ifdef SBL_MIXED
            if (p.cluster) sbl_descend(p, -1 - entry, fraction.x);
#endif
            sbl_Lamp l = sbl_lamp(p.leaf);
            bool corner = at_rim && l.kind == SBL_LAMP_TRIANGLE;
            if (at_rim && (l.kind == SBL_LAMP_SKY_TEXEL || (corner && rim >= SBL_CORNERS))) continue;
            float turned = float(rim) + float(scramble.y >> 8) / SBL_FRACTIONS;
            if (at_rim) p.u = vec2(SBL_RIM_AT, turned / float(SBL_RIM));
            sbl_Sample s = sbl_sample(l, p.u);
            if (corner) {
                vec3 way = l.corner + (rim == 1 ? SBL_CORNER : SBL_OTHER_CORNER) * l.side_1 +
                           (rim == 2 ? SBL_CORNER : SBL_OTHER_CORNER) * l.side_2;
                s.far = length(way);
                s.direction = way / s.far;
                s.light = vec3(dot(way, n));
            }
#ifdef SBL_INSPECT
            reporting = point ? k == certain_ray : !at_rim && k == wanted;
#endif
            sbl_shoot(slot, p, l, s, rim, point);
        }
        if (!point) undecided = sbl_undecided();
    }
#ifdef SBL_INSPECT
    sbl_write(out_light, vec4(report.rgb * unit, report.a));
    sbl_write(out_way, report_way);
#else
    sbl_write(out_light, sbl_combine());
#ifdef SBL_DIRECTIONAL
    sure_harmonics *= unit * scale;
    sbl_write(out_red, sure_harmonics[0]);
    sbl_write(out_green, sure_harmonics[1]);
    sbl_write(out_blue, sure_harmonics[2]);
#endif
#endif
}
