// One lamp as seen from a point on a surface: its light in closed form, the approximate light of a cluster, the
// random choice of a lamp from a cluster, and a random point on a lamp.
uniform int lamp_nodes, lamp_leaves;  // number of nodes and of leaves in the table of lamps
uniform float unit;                   // radiance is divided by this unit in sums, to prevent overflow
#if defined(SBL_MIXED) || defined(SBL_BOUNCED)  // programs with SBL_BOUNCED have no variants for SBL_MIXED
const bool mixed = true;            // some lamps may not be triangles, and there may be more than SBL_LAMPS lamps
#else
const bool mixed = false;           // all lamps are triangles, at most SBL_LAMPS
#endif

const float SBL_SMALL = 16.0;       // a triangle is small if (squared distance) / (squared size) exceeds this
const float SBL_POINT[2] = float[2](-0.337845472747895, 0.725271359470687);  // see sbl_form_factor
const float SBL_POINT_WEIGHT[2] = float[2](0.223381589678011, 0.109951743655322);
const float SBL_BEFORE_LAMP = 0.99999;  // fraction of the distance to a lamp along which a ray is traced
const float SBL_LIGHT_LEAST = 16.0;  // lower limit of (distance to a point on a light) / above: shorter rays would
                                     // meet the sensor's own surface

// A lamp as the sensor sees it. "triangle:", "texel:" and "light:" name the kinds of lamp that use a field.
struct sbl_Lamp {
    uint kind;
    vec3 brightness;           // divided by `unit`. triangle: radiance; texel: (radiance above sky_limit) * solid
                               // angle; light: irradiance of a surface at the sensor that faces the light
    vec3 corner;               // triangle: first corner, relative to the sensor; others: unit direction to the
                               // centre
    vec3 side_1, side_2;       // triangle: vectors from the first corner to the other corners
    float distance, radius;    // light: distance of its centre from the sensor; radius
    float sine2;               // light: squared sine of half the angle that it subtends
    ivec2 texel;               // texel: column and row in the environment's picture
    int triangle, number;      // triangle: its index in the hierarchy's order and in the scene; otherwise number
                               // is -1
    vec2 facing;               // (0, 1) if the sensor sees the back of the lamp's triangle; otherwise (1, 0)
    bool glow;                 // true: a glow; its kind is SBL_LAMP_TRIANGLE, and it is a part of `triangle`
    int layer;                 // index of the lamp's light group; glow: index of its record, see
                               // sbl_layer_fraction
};

bool sbl_is_light(sbl_Lamp l) {
    return mixed && (l.kind == SBL_LAMP_LOCAL_LIGHT || l.kind == SBL_LAMP_DISTANT_LIGHT);
}
bool sbl_is_texel(sbl_Lamp l) { return mixed && l.kind == SBL_LAMP_SKY_TEXEL; }

// The sensor: origin of its rays; position on the surface, for closed forms; normal
vec3 ray_origin, position, sensor_normal;
float above;     // distance of `ray_origin` from the surface
mat3 to_frame;   // the sensor's frame, for closed forms

sbl_Lamp sbl_lamp(int leaf) {
    uint code = sbl_lamp_leaf_code(leaf), at = code & ((1u << SBL_LAMP_KIND_SHIFT) - 1u);
    sbl_Lamp l = sbl_Lamp(code >> SBL_LAMP_KIND_SHIFT, vec3(0), vec3(0), vec3(0), vec3(0), SBL_UNBOUNDED, 0.0, 0.0,
                          ivec2(0), int(at), -1, vec2(1, 0), false, int(sbl_lamp_leaf_layer(leaf)));
    l.glow = mixed && l.kind == SBL_LAMP_GLOW;
    if (l.glow) {
        l.kind = SBL_LAMP_TRIANGLE;
        l.triangle = int(sbl_glow_triangle(int(at)));
        l.layer = int(at);
    }
    if (l.kind == SBL_LAMP_TRIANGLE) {
        int object = int(sbl_triangle_object(l.triangle));
        l.corner = sbl_triangle_corner_0(l.triangle);
        l.side_1 = sbl_triangle_corner_1(l.triangle) - l.corner;
        l.side_2 = sbl_triangle_corner_2(l.triangle) - l.corner;
        for (int i = 0; i < (l.glow ? 1 : 0); i++) {
            l.corner = sbl_glow_corner_0(int(at));
            l.side_1 = sbl_glow_corner_1(int(at)) - l.corner;
            l.side_2 = sbl_glow_corner_2(int(at)) - l.corner;
        }
        l.corner -= position;
        l.number = int(sbl_triangle_number(l.triangle));
        vec3 normal = cross(l.side_1, l.side_2);
        float plane_distance = dot(normal, l.corner);  // distance of the triangle's plane * length(normal)
        l.facing = plane_distance > 0.0 ? vec2(0, 1) : vec2(1, 0);
        l.brightness = sbl_emission(object, l.facing.y == 1.0) / unit;
        for (int i = 0; i < (l.glow ? 1 : 0); i++)
            l.brightness = plane_distance > 0.0 ? vec3(0) : sbl_glow_radiance(int(at)) / unit;
        // Almost edge-on: no light. This excludes the sensor's own triangle, which rounding may lift above the
        // horizon.
        if (abs(plane_distance) < 0.5 * above * length(normal)) l.brightness = vec3(0);
    }
    if (sbl_is_texel(l)) {
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
        if (l.kind == SBL_LAMP_LOCAL_LIGHT) {
            l.corner -= position;
            l.radius = l.sine2;
            l.distance = length(l.corner);
            l.corner /= max(l.distance, 1e-30);
            vec3 chord = sbl_light_axis(int(at)) + l.corner;  // its square is 2 * (1 - the cosine to the axis)
            float spot = clamp(sbl_light_spot_offset(int(at)) -
                               0.5 * sbl_light_spot_scale(int(at)) * dot(chord, chord), 0.0, 1.0);
            // The sensor may be inside the light.
            if (l.distance < l.radius) { l.corner = sensor_normal; l.distance = l.radius; spot = 1.0; }
            l.brightness *= spot * spot / (l.distance * l.distance);
            l.sine2 = min(l.radius * l.radius / (l.distance * l.distance), 1.0);
        }
    }
    return l;
}

#ifdef SBL_GROUPS
uniform int first_glow_layer;  // texel of sbl_lamps at which the layers of glows begin; one texel per layer

// Returns the fraction of a lamp's light that belongs to a layer. glow, lamp_layer: fields of sbl_Lamp
vec3 sbl_layer_fraction(bool glow, int lamp_layer, int layer) {
    if (glow) return uintBitsToFloat(sbl_fetch(sbl_lamps, first_glow_layer + lamp_layer * SBL_GROUPS + layer).xyz);
    return vec3(lamp_layer == layer ? 1.0 : 0.0);
}
#endif

// >>closed forms

// Returns the form factor of a triangle. a, b, c: corners relative to the sensor, in its frame. Lambert's sum
// (1760) over the edges of the part above the horizon adds, for each edge, the angle that it subtends times z of
// the unit normal of the plane through the edge and the sensor. For a triangle that is small and far away,
// rounding would spoil this sum; a sum over Dunavant's six points is then used instead (1985, degree 4; relative
// error up to 4e-6).
float sbl_form_factor(vec3 a, vec3 b, vec3 c) {
    vec3 corners[3] = vec3[3](a, b, c), entry = vec3(0), leave = vec3(0);
    vec3 middle = (a + b + c) / 3.0, normal = cross(b - a, c - a);
    float distance2 = dot(middle, middle), points = 0.0, sum = 0.0;
    float size2 = max(dot(b - a, b - a), max(dot(c - a, c - a), dot(c - b, c - b)));
    bool small = min(a.z, min(b.z, c.z)) > 0.0 && distance2 > SBL_SMALL * size2, cut = false;
    for (int k = 0; k < 6; k++) {  // points on the lines from the corners through the middle
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
        vec3 across = cross(p, q);
        float size = length(across);
        sum += size > 0.0 ? atan(size, dot(p, q)) * across.z / size : 0.0;
    }
    return small ? points * 0.5 * abs(dot(normal, middle)) / (SBL_PI * distance2 * distance2)
                 : abs(sum) / (2.0 * SBL_PI);
}

// Returns the form factor of a round lamp, divided by sine2 (Snyder 1996, "Area Light Sources for Real-Time
// Graphics"). Treats small lamps as flat discs. z: cosine between the normal and the direction to the lamp's
// centre. sine2: squared sine of half the angle that the lamp subtends
float sbl_lamp_round(float z, float sine2) {
    float sine = sqrt(sine2), s = sqrt(max(1.0 - z * z, 0.0));
    if (z >= sine || z <= -sine) return max(z, 0.0);
    float q = clamp(z / sine, -1.0, 1.0), x = sqrt(1.0 / sine2 - 1.0);
    float y = clamp(-x * z / s, -1.0, 1.0), w = s * sqrt(1.0 - y * y);
    if (sine2 < 1e-4) return sine / SBL_PI * (q * acos(-q) + sqrt(1.0 - q * q) * (2.0 + q * q) / 3.0);
    return (z * acos(y) - x * w + atan(w, x) / sine2) / SBL_PI;
}

// Returns R of an unobstructed lamp, divided by `unit`. For a texel of the sky it is approximate, and above 0 if
// any part of the texel is above the horizon.
vec3 sbl_unobstructed(sbl_Lamp l) {
    float factor = 0.0;
    if (l.kind == SBL_LAMP_TRIANGLE) {
        vec3 corner = to_frame * l.corner;
        factor = sbl_form_factor(corner, corner + to_frame * l.side_1, corner + to_frame * l.side_2);
    }
    if (sbl_is_light(l)) factor = sbl_lamp_round(dot(sensor_normal, l.corner), l.sine2) / SBL_PI;
    if (sbl_is_texel(l))
        factor = max(dot(sensor_normal, l.corner) + SBL_PI / float(textureSize(sky_picture, 0).y), 0.0) / SBL_PI;
    return l.brightness * factor;
}

// Returns the first four spherical harmonics of the light of an unobstructed lamp, divided by `unit`, from its
// solid angle and the `integral` of directions over it. If the horizon cuts a round lamp, all but the part along
// the normal is approximate.
mat3x4 sbl_unobstructed_harmonics(sbl_Lamp l) {
    float solid_angle = 0.0;
    vec3 integral = vec3(0);
    if (l.kind == SBL_LAMP_TRIANGLE) {
        vec3 a = to_frame * l.corner, kept[4];
        vec3 corners[3] = vec3[3](a, a + to_frame * l.side_1, a + to_frame * l.side_2);
        int count = 0;
        for (int k = 0; k < 3; k++) {
            vec3 p = corners[k], q = corners[(k + 1) % 3];
            if (p.z > 0.0) kept[count++] = p;
            if ((p.z > 0.0) != (q.z > 0.0)) kept[count++] = vec3(mix(p.xy, q.xy, p.z / (p.z - q.z)), 0);
        }
        for (int k = 0; k < count; k++) {  // irradiance of a polygon as a sum over its edges (Lambert 1760)
            vec3 p = kept[k], q = kept[k + 1 < count ? k + 1 : 0], across = cross(p, q);
            float size = length(across);
            integral += size > 0.0 ? 0.5 * atan(size, dot(p, q)) / size * across : vec3(0);
        }
        for (int k = 1; k + 1 < count; k++) {  // Van Oosterom and Strackee 1983
            vec3 p = kept[0], q = kept[k], r = kept[k + 1], lengths = vec3(length(p), length(q), length(r));
            float cosines = lengths.x * lengths.y * lengths.z + dot(p, q) * lengths.z + dot(q, r) * lengths.x +
                            dot(r, p) * lengths.y;
            solid_angle += 2.0 * atan(dot(p, cross(q, r)), cosines);
        }
        integral = transpose(to_frame) * integral * sign(solid_angle);
        solid_angle = abs(solid_angle);
    }
    if (sbl_is_light(l)) {  // solid_angle and integral are divided by pi * sine2, to match l.brightness
        float z = dot(sensor_normal, l.corner), shown = clamp(0.5 + 0.5 * z / max(sqrt(l.sine2), 1e-30), 0.0, 1.0);
        solid_angle = shown * 2.0 / (1.0 + sqrt(1.0 - l.sine2));
        integral = shown * (l.corner - z * sensor_normal) + sbl_lamp_round(z, l.sine2) * sensor_normal;
    }
    return outerProduct(vec4(SBL_HARMONIC_0 * solid_angle, SBL_HARMONIC_1 * integral.yzx), l.brightness);
}

// >>clusters

struct sbl_Cluster {
    vec3 to;       // centre of its bounding sphere, relative to the sensor; if `distant`, a direction
    float radius;
    bool distant;  // true: the lamps are at infinity
    bool spots;    // true: the lamps are spotlights, and a cone contains their light
    int beyond;    // index of the first node after the cluster's subtree
};

sbl_Cluster sbl_cluster(int node) {
    uint beyond = sbl_lamp_node_beyond(node);
    bool distant = (beyond & SBL_DISTANT_NODE) != 0u, spots = (beyond & SBL_SPOT_NODE) != 0u;
    vec3 to = sbl_lamp_node_middle(node) - (distant ? vec3(0) : position);
    return sbl_Cluster(to, sbl_lamp_node_radius(node), distant, spots,
                       int(beyond & ~(SBL_DISTANT_NODE | SBL_SPOT_NODE)));
}

const float SBL_CONE_MARGIN = 1e-3;  // allows for rounding of angles, in radians

// Returns the approximate light / unit of an unobstructed cluster. A result of 0 means that no lamp of the cluster
// gives the sensor any light.
float sbl_strength(int node, sbl_Cluster c) {
    vec3 square = sbl_lamp_node_square(node), mixed = sbl_lamp_node_mixed(node), front = sbl_lamp_node_front(node);
    float distance2 = max(dot(c.to, c.to), 1e-37), sine = min(c.radius * inversesqrt(distance2), 1.0);
    float height = dot(sensor_normal, c.to);
    // The normal of a distant lamp is the direction towards it, so its product with -sensor_normal is the cosine
    // at the sensor.
    vec3 w = c.distant ? -sensor_normal : c.to * inversesqrt(distance2);
    float shown = sqrt(max(dot(square, w * w) + 2.0 * dot(mixed, w.xyz * w.yzx), 0.0)) - dot(front, w) +
                  0.1 * sbl_lamp_node_power(node) * sine;
    for (int i = 0; i < (c.spots ? 1 : 0); i++) {
        // the least angle between the axis of the cone and a direction from the cluster's ball to the sensor
        float angle = sine < 1.0 ? acos(clamp(-dot(front, w), -1.0, 1.0)) - asin(sine) : 0.0;
        shown = angle < square.x + SBL_CONE_MARGIN ? sbl_lamp_node_power(node) : 0.0;
    }
    if (height + c.radius <= 0.0) return 0.0;
    float near = max(height, 0.5 * (height + c.radius)) * inversesqrt(distance2) /
                 max(distance2, c.radius * c.radius);
    return max(shown, 0.0) * (c.distant ? 1.0 : near) / unit;
}

// >>points of lamps

// Maps u to a uniformly distributed direction in the spherical triangle of the unit vectors a, b, c (Arvo 1995,
// "Stratified Sampling of Spherical Triangles"). Returns the direction in xyz, and the solid angle in w; all 0
// if the solid angle is too small for this method.
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
    float distance;  // distance to the point, or SBL_UNBOUNDED
    vec3 light;      // R / unit of the whole lamp, estimated from this point alone
    vec2 b;          // triangle: barycentric weights of the second and third corner
};

// Returns the barycentric weights of a triangle's second and third corner at a point. from_corner: the point,
// relative to the first corner
vec2 sbl_barycentrics(sbl_Lamp l, vec3 normal, vec3 from_corner) {
    vec2 areas = vec2(dot(cross(from_corner, l.side_2), normal), dot(cross(l.side_1, from_corner), normal));
    return areas / dot(normal, normal);
}

// Maps a uniform point u in the unit square to a point on a lamp. Triangles are sampled by solid angle, or by area
// if the solid angle is small (Heitz 2019, "A Low-Distortion Map Between Triangle and Square").
sbl_Sample sbl_sample(sbl_Lamp l, vec2 u) {
    sbl_Sample s = sbl_Sample(l.corner, SBL_UNBOUNDED, l.brightness / SBL_PI, u);
    if (l.kind == SBL_LAMP_TRIANGLE) {
        vec3 normal = cross(l.side_1, l.side_2), corner_1 = l.corner + l.side_1, corner_2 = l.corner + l.side_2;
        vec4 ray = sbl_spherical(normalize(l.corner), normalize(corner_1), normalize(corner_2), u);
        s.b = u.y > u.x ? vec2(0.5 * u.x, u.y - 0.5 * u.x) : vec2(u.x - 0.5 * u.y, 0.5 * u.y);
        // Moves the point a little away from the edges, so that rounding does not make the ray miss the triangle.
        float reach2 = dot(l.corner, l.corner), longest2 = max(dot(l.side_1, l.side_1), dot(l.side_2, l.side_2));
        float keep = 3e-6 * sqrt(longest2) * reach2 / max(abs(dot(normal, l.corner)), 1e-37);
        s.b = mix(s.b, vec2(1.0 / 3.0), min(keep, 0.5));
        vec3 to = l.corner + s.b.x * l.side_1 + s.b.y * l.side_2;
        if (ray.w > 0.0) {
            to = ray.xyz * dot(l.corner, normal) / dot(ray.xyz, normal);
            s.b = sbl_barycentrics(l, normal, to - l.corner);
        }
        s.distance = length(to);
        s.direction = to / s.distance;
        s.light *= ray.w > 0.0 ? ray.w : 0.5 * abs(dot(normal, s.direction)) / (s.distance * s.distance);
    }
    if (sbl_is_texel(l)) {
        vec2 size = vec2(textureSize(sky_picture, 0));
        float row = float(l.texel.y);
        s.direction = sbl_sky_direction((float(l.texel.x) + u.x) / size.x,
                                        mix(cos(SBL_PI * row / size.y), cos(SBL_PI * (row + 1.0) / size.y), u.y));
    }
    if (sbl_is_light(l)) {
        // versine: 1 - cosine of the angle between the ray and the direction to the centre
        float cosine = sqrt(1.0 - l.sine2), versine = u.x * l.sine2 / (1.0 + cosine);
        float r = sqrt(max(versine * (2.0 - versine), 0.0)), angle = 2.0 * SBL_PI * u.y;
        s.direction = sbl_frame(l.corner) * vec3(r * cos(angle), r * sin(angle), 1.0 - versine);
        s.light *= 2.0 / (1.0 + cosine);
        if (l.kind == SBL_LAMP_LOCAL_LIGHT) {
            s.distance = l.distance * (1.0 - versine) -
                         sqrt(max(l.radius * l.radius - l.distance * l.distance * r * r, 0.0));
            s.distance = max(s.distance, max(SBL_LIGHT_LEAST * above, 1e-18));
        }
    }
    s.light *= max(dot(sensor_normal, s.direction), 0.0);
    return s;
}

#ifdef SBL_SPECULAR
// Returns the MIS weight of rays of a lobe for a lamp's light from a direction, see sbl_lobe_mis. Rays do not hit
// lights (point, spot and directional), whose weight is 0.
float sbl_mis_of_lobe(sbl_Lamp l, sbl_Sample s, float lobe_density) {
    float lamp_density = SBL_GLOW_DENSITY;
    if (sbl_is_texel(l)) lamp_density = sbl_sky_density(texelFetch(sky_picture, l.texel, 0).rgb);
    if (l.kind == SBL_LAMP_TRIANGLE && !l.glow)
        lamp_density = sbl_area_density(int(sbl_triangle_object(l.triangle)), l.side_1, l.side_2,
                                        s.distance * s.direction);
    return sbl_is_light(l) ? 0.0 : sbl_lobe_mis(lobe_density, lamp_density);
}
#endif

struct sbl_Pick {
    int leaf;      // index of the picked lamp
    float chance;  // probability of picking this lamp
    vec2 u;        // random point in the unit square, for sbl_sample; see sbl_descend
    bool cluster;  // true: the lamp was picked from a cluster
};

// Picks one lamp of a cluster: descends its subtree, and chooses a child of each node with a probability in
// proportion to its strength. Each choice maps the interval of the chosen child back to 0 .. 1, so that p.u.x
// stays uniform. node: -1: the cluster of all lamps, if the scene has near and distant lamps
void sbl_descend(inout sbl_Pick p, int node, uint fraction) {
    // adds the low bits of the fraction, which a float between 0 and 1 cannot hold
    p.u.x = clamp(p.u.x + (float(fraction & 255u) - 127.5) / 4294967296.0 / p.chance, 0.0, 1.0);
    int beyond = node < 0 ? lamp_nodes : sbl_cluster(node).beyond;
    for (; beyond != node + 1; beyond = sbl_cluster(node).beyond) {
        sbl_Cluster left = sbl_cluster(node + 1), right = sbl_cluster(left.beyond);
        float weight = sbl_strength(node + 1, left);
        float probability = weight / max(weight + sbl_strength(left.beyond, right), 1e-37);
        bool first = p.u.x < probability;
        node = first ? node + 1 : left.beyond;
        p.chance *= first ? probability : 1.0 - probability;
        p.u.x = first ? p.u.x / probability : (p.u.x - probability) / (1.0 - probability);
    }
    p.leaf = int(sbl_lamp_node_first_leaf(node));
}

#if defined(SBL_TEXTURED) || defined(SBL_SPECULAR)
// Returns the factor of a triangle's light at a point: the effect of textures, vertex colours and reflections. b:
// barycentric weights of the second and third corner
vec3 sbl_lamp_pattern(sbl_Lamp l, vec2 b) {
    int object = int(sbl_triangle_object(l.triangle));
    // A glow is a part of a triangle. This replaces b by the weights of the same point in the whole triangle.
    for (int i = 0; i < (l.glow ? 1 : 0); i++) {
        sbl_Lamp whole_triangle = l;
        vec3 first = sbl_triangle_corner_0(l.triangle), point = position + l.corner - first;
        point += b.x * l.side_1 + b.y * l.side_2;
        whole_triangle.side_1 = sbl_triangle_corner_1(l.triangle) - first;
        whole_triangle.side_2 = sbl_triangle_corner_2(l.triangle) - first;
        b = sbl_barycentrics(whole_triangle, cross(whole_triangle.side_1, whole_triangle.side_2), point);
    }
    sbl_Attributes at = sbl_attributes_at(l.triangle, b.x, b.y);
    return l.glow ? sbl_glow_pattern(object, at) : sbl_solid_emission_pattern(object, at);
}
#endif
