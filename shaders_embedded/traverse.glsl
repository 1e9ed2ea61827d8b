// Traces rays through the bounding volume hierarchy (see >>bvh in sbl.h).
uniform vec3 grid_origin;      // origin of the grid over the scene, as in grid record 0
uniform vec3 grid_per_length;  // steps of that grid per unit of length
uniform int node_count;        // 0: the scene is empty

const int SBL_HOLES = 64;            // a ray passes fewer holes and panes than this; it hits the next one
const float SBL_PASSED = 0.9999;     // a box is skipped if the ray leaves it before this * sbl_Ray.after
const int SBL_BOX_SLACK = 8;         // added to the distance at which a ray leaves a box, in units in the last
                                     // place (Ize 2013, "Robust BVH Ray Traversal")
const float SBL_SELF_DEEP = 1e-4;    // a hit closer than this * deep must be farther away than the rounding error
const float SBL_SELF_WIDE = 2.4e-7;  // the rounding error is this * deep * wide / abs(determinant), see sbl_test

// Returns the attributes at barycentrics b1, b2 of a triangle. triangle: its index in sbl_triangles, which is not
// its index in the scene (see sbl_Hit)
sbl_Attributes sbl_attributes_at(int triangle, float b1, float b2) {
#ifdef SBL_TEXTURED
    ivec3 corners = sbl_corners(int(sbl_triangle_number(triangle)));
    vec3 b = vec3(1.0 - b1 - b2, b1, b2);
    sbl_Attributes at = sbl_Attributes(vec2(0), vec4(0));
    for (int k = 0; k < 3; k++) {
        int v = corners[k];
        at.uv += b[k] * vec2(sbl_attributes_u(v), sbl_attributes_v(v));
        vec4 color = sbl_unpack_color(sbl_attributes_color_rg(v), sbl_attributes_color_ba(v));
        at.color += b[k] / SBL_COLOR_MOST * color;
    }
    return at;
#else
    return SBL_PLAIN;
#endif
}

struct sbl_Hit {
    float distance;   // in units of the direction's length
    int triangle;     // index in sbl_triangles; negative: the ray hit nothing
    int number;       // index of the triangle in the scene
    float b1, b2;     // barycentrics of the second and third corner
    bool back;
};

sbl_Attributes sbl_attributes_of(sbl_Hit hit) { return sbl_attributes_at(hit.triangle, hit.b1, hit.b2); }

// Returns the distance at which the ray enters the box, or `passed` if that is larger. Returns 0x7fffffff if the
// ray misses the box, if it leaves the box before `passed`, or if it enters the box beyond `nearest`. The ray may
// enter exactly at `nearest`: of two triangles at the same distance, the ray hits the one with the lower index in
// the scene. All distances are the bits of floats: as integers, the bits of positive floats have the same order
// as the floats, and the bits of negative floats are negative. per: distance along the ray per grid step. offset:
// distance along the ray of the grid's origin. flip: for each axis, true if the ray's direction is negative
int sbl_box(uvec4 box, vec3 per, vec3 offset, bvec3 flip, int passed, int nearest) {
    vec3 low = vec3(box.xyz & 65535u), high = vec3(box.xyz >> 16);
    ivec3 entry = floatBitsToInt(mix(low, high, flip) * per + offset);
    ivec3 leave = floatBitsToInt(mix(high, low, flip) * per + offset);
    int from = max(max(entry.x, entry.y), max(entry.z, passed));
    int to = min(min(leave.x, leave.y), min(leave.z, nearest));
    return from <= to + SBL_BOX_SLACK ? from : 0x7fffffff;
}

// A ray, prepared for triangle tests that are watertight at shared edges (Woop, Benthin and Wald 2013). The axis
// of the direction's largest component becomes z, and space is sheared so that the ray is parallel to z.
struct sbl_Ray {
    vec3 origin;
    int axis;
    vec2 shear;
    float z, per_z;  // component of the direction along the axis, and its reciprocal
    float after;     // hits at a smaller distance are ignored
    int past;        // hits at exactly the distance `after` are ignored if the triangle's index in the scene
                     // (sbl_Hit.number) is at most this
};

vec3 sbl_permute(vec3 v, int axis) { return axis == 0 ? v.yzx : axis == 1 ? v.zxy : v; }

// Returns four times the signed area of the triangle that an edge and the ray form. The two equal terms make the
// result for (b, a) the exact opposite, even if the driver rounds only one product of each a * b - c * d.
float sbl_side(vec2 a, vec2 b) { return (a.x * b.y - a.y * b.x) - (b.x * a.y - b.y * a.x); }

void sbl_test(int triangle, sbl_Ray ray, inout sbl_Hit hit) {
    vec3 p = sbl_permute(sbl_triangle_corner_0(triangle) - ray.origin, ray.axis);
    vec3 q = sbl_permute(sbl_triangle_corner_1(triangle) - ray.origin, ray.axis);
    vec3 r = sbl_permute(sbl_triangle_corner_2(triangle) - ray.origin, ray.axis);
    int number = int(sbl_triangle_number(triangle));
    p.xy -= ray.shear * p.z;
    q.xy -= ray.shear * q.z;
    r.xy -= ray.shear * r.z;
    float u = sbl_side(r.xy, q.xy), v = sbl_side(p.xy, r.xy), w = sbl_side(q.xy, p.xy), determinant = u + v + w;
    bool front = u >= 0.0 && v >= 0.0 && w >= 0.0, back = u <= 0.0 && v <= 0.0 && w <= 0.0;
    bool inside = (front || back) && determinant != 0.0;
    float l = (u * p.z + v * q.z + w * r.z) * ray.per_z / determinant;
    // Rounding must not cause a hit of a triangle close to the ray's origin, such as the triangle where the ray
    // starts. A hit closer than SBL_SELF_DEEP * deep counts only if its distance exceeds the rounding error, which
    // is larger for thin triangles.
    float deep = max(abs(p.z), max(abs(q.z), abs(r.z)));
    float wide = max(dot(p.xy, p.xy), max(dot(q.xy, q.xy), dot(r.xy, r.xy)));
    inside = inside && l > SBL_SELF_DEEP * deep || inside && l * abs(determinant) > SBL_SELF_WIDE * deep * wide;
    bool behind = l > ray.after || (l == ray.after && number > ray.past);
    if (inside && behind && (l < hit.distance || (l == hit.distance && number < hit.number)))
        hit = sbl_Hit(l, triangle, number, v / determinant, w / determinant, (determinant < 0.0) == (ray.z > 0.0));
}

int sbl_steps = 0;  // iterations of the loops of sbl_nearest, over all rays of the invocation

// Returns the first hit after (after, past) at a distance below `limit`, or triangle -1 if the ray hits nothing.
// Hits are ordered by distance and, at the same distance, by the index of their triangle in the scene.
sbl_Hit sbl_nearest(vec3 origin, vec3 direction, float after, int past, float limit) {
    sbl_Hit hit = sbl_Hit(limit, -1, -1, 0.0, 0.0, false);
    vec3 size = abs(direction);
    int axis = size.x > size.y ? (size.x > size.z ? 0 : 2) : (size.y > size.z ? 1 : 2);
    vec3 d = sbl_permute(direction, axis);
    sbl_Ray ray = sbl_Ray(origin, axis, d.xy / d.z, d.z, 1.0 / d.z, after, past);

    bvec3 flip = lessThan(direction, vec3(0));
    vec3 inverse = 1.0 / mix(max(direction, vec3(1e-12)), min(direction, vec3(-1e-12)), flip);
    vec3 per = inverse / grid_per_length, offset = (grid_origin - origin) * inverse;
    int passed = floatBitsToInt(SBL_PASSED * after);
    uint stack[SBL_STACK];
    stack[0] = SBL_END;
    int top = 0;
    uint node = node_count == 0 ? SBL_END : 1u;
    // Each outer iteration tests one leaf, or enters or leaves a nested grid. Inner iterations visit nodes, and
    // share the counter. On softpipe, these loops do not terminate without a limit.
    int iterations = 4 * node_count + 4;
    sbl_steps += iterations;
    for (; iterations > 0; iterations--) {
        for (; node < SBL_LEAF && iterations > 0; iterations--) {  // descends, nearer child first
            uvec4 first = sbl_node_child_0(int(node)), second = sbl_node_child_1(int(node));
            int nearest = floatBitsToInt(hit.distance);
            int a = sbl_box(first, per, offset, flip, passed, nearest);
            int b = sbl_box(second, per, offset, flip, passed, nearest);
            node = a <= b ? first.w : second.w;
            if (max(a, b) < 0x7fffffff) stack[++top] = a <= b ? second.w : first.w;
            if (min(a, b) == 0x7fffffff) node = stack[top--];
        }
        bool leaf = true;
        while ((node & 0xe0000000u) == SBL_ENTER && leaf) {  // SBL_ENTER or SBL_LEAVE: changes to another grid
            int grid = int(node & SBL_CHILD_NUMBER);
            per = inverse / sbl_grid_per_length(grid);
            offset = (sbl_grid_origin(grid) - origin) * inverse;
            if ((node & 0xf0000000u) == SBL_ENTER) {
                stack[++top] = SBL_LEAVE | sbl_grid_outer(grid);
                node = sbl_grid_root(grid);
            } else node = stack[top--];
            leaf = false;
        }
        if (!leaf) continue;
        if (node == SBL_END) break;
        int from = int(node & SBL_CHILD_NUMBER), to = from + int(node >> 28 & 7u);
        for (int t = from; t <= to; t++) sbl_test(t, ray, hit);
        node = stack[top--];
    }
    sbl_steps -= iterations;
    return hit;
}

// How a ray interacts with surfaces that transmit light
const int SBL_RAY_PATH = 0;    // Russian roulette: the ray passes or stops; sbl_tint is the transmitted fraction
                               // divided by the probability
const int SBL_RAY_SHADOW = 1;  // the ray passes; sbl_tint is the transmitted fraction
const int SBL_RAY_SOLID = 2;   // the ray stops
vec3 sbl_tint = vec3(1);       // factor of the light that the last ray of sbl_trace finds

#ifdef SBL_SPECULAR
// Returns a random number in [0, 1) that depends on the point of the hit. which: selects one of several
// independent numbers
float sbl_random_of(sbl_Hit hit, uint which) {
    uint hash = floatBitsToUint(hit.b1) * 2654435769u ^ floatBitsToUint(hit.b2) * 2246822519u ^ uint(hit.number);
    hash += which * 3266489917u;
    hash = (hash ^ hash >> 15) * 747796405u;
    hash = (hash ^ hash >> 13) * 2246822519u;
    return float(hash >> 8) / SBL_FRACTIONS;
}
#endif

#ifdef SBL_SPECULAR
// Probability that the ray was sent to a lamp in a mirror. The mirror should then reflect the ray: gloss does so
// with at least this probability (see sbl_face_ray), and panes with at least half of it (see sbl_passes).
float chance_least = 0.0;
#endif

#if defined(SBL_CUTOUTS) && defined(SBL_SPECULAR)
// Returns true if the ray passes through the surface that it hits. For SBL_RAY_SHADOW, multiplies sbl_tint by the
// transmitted fraction. For SBL_RAY_PATH, decides by Russian roulette, and multiplies sbl_tint by 1 / (probability
// of the result), and by the transmitted fraction if the ray passes. A ray that may have been sent to a lamp in a
// mirror (see chance_least) passes less often.
bool sbl_passes(sbl_Hit hit, sbl_Material material, vec3 direction, int kind) {
    vec3 p0 = sbl_triangle_corner_0(hit.triangle);
    vec3 normal = cross(sbl_triangle_corner_1(hit.triangle) - p0, sbl_triangle_corner_2(hit.triangle) - p0);
    float sizes = length(normal) * length(direction);
    float cosine = sizes > 0.0 ? dot(normal, direction) / sizes : 1.0;
    vec3 passing = sbl_passing(int(sbl_triangle_object(hit.triangle)), material, cosine);
    float most = max(passing.r, max(passing.g, passing.b));
    if (most <= 0.0 || kind == SBL_RAY_SOLID) return false;
    float chance = most * (1.0 - 0.5 * chance_least);
    bool passes = kind == SBL_RAY_SHADOW || sbl_random_of(hit, 0u) < chance;
    sbl_tint *= kind == SBL_RAY_SHADOW ? passing : passes ? passing / chance : vec3(1.0 / (1.0 - chance));
    return passes;
}
#endif

// Returns the nearest hit below `limit` that is not in a hole and that the ray does not pass (but see SBL_HOLES),
// or triangle -1. kind: SBL_RAY_PATH and so on
sbl_Hit sbl_trace(vec3 origin, vec3 direction, float limit, int kind) {
    sbl_Hit hit = sbl_Hit(0.0, -1, 0x7fffffff, 0.0, 0.0, false);
    bool solid = false;
    sbl_tint = vec3(1);
    for (int hole = 0; hole < SBL_HOLES && !solid; hole++) {
        hit = sbl_nearest(origin, direction, hit.distance, hit.number, limit);
        solid = true;
#ifdef SBL_CUTOUTS
        if (hit.triangle >= 0 && sbl_triangle_cutout(hit.triangle) != 0u) {
            sbl_Material material = sbl_material(int(sbl_triangle_object(hit.triangle)), sbl_attributes_of(hit));
            solid = !material.cut_out;
#ifdef SBL_SPECULAR
            if (solid) solid = !sbl_passes(hit, material, direction, kind);
#endif
        }
#endif
    }
    return hit;
}
