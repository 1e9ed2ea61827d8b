// A ray through the bounding volume hierarchy (see >>bvh in sbl.h). Two texels a node, one a child:
//   lowest x | highest x << 16, lowest y | highest y << 16, lowest z | highest z << 16, child
// in steps of a grid. A child is a node's number, or 8 + triangles - 1 << 28 | first triangle, or SBL_ENTER << 28 | number of a finer grid in a node's place:
//   origin, its root; steps per length, the grid around it
// A triangle is three texels: corner, object; corner, number in the scene; corner, 1 where a cutout may leave nothing.
uniform sbl_Texels sbl_nodes, sbl_triangles;
uniform vec3 grid_origin, grid_per_length;  // of the grid over all, which comes first
uniform int node_count;                     // 0: an empty scene

// What sensors' programs have in common. A sensor has a block of texels, one an invocation. There are two carriers: fragment shaders drawn over the blocks,
// and compute shaders, in which the invocations of a sensor follow each other.
// Software renderers run both sides of every if, but leave loops that no lane enters: an if for what is long and rare.
#define sbl_when(condition) for (int sbl_once = 0; sbl_once < ((condition) ? 1 : 0); sbl_once++)
uniform ivec2 blocks;                 // invocations of a sensor: four by some, so that those that run side by side trace neighbouring rays
uniform int columns;                  // sensors across the target
uniform int first_slot, count;        // this many sensors stand from first_slot on
#ifdef SBL_COMPUTE
layout(local_size_x = 64) in;
#define SBL_OUT(place, name) layout(rgba32f, binding = place) writeonly uniform image2D name
#define sbl_write(name, value) imageStore(name, sbl_texel_of_invocation(), value)
#define sbl_leave return

ivec2 sbl_texel_of_invocation() {
    int i = int(gl_GlobalInvocationID.x), size = blocks.x * blocks.y, slot = first_slot + i / size, part = i % size;
    return ivec2(slot % columns, slot / columns) * blocks + ivec2(part % blocks.x, part / blocks.x);
}
#else
#define SBL_OUT(place, name) layout(location = place) out vec4 name
#define sbl_write(name, value) name = value
#define sbl_leave discard

ivec2 sbl_texel_of_invocation() { return ivec2(gl_FragCoord.xy); }
#endif

#ifdef SBL_TEXTURED
struct sbl_Attributes { vec2 uv; vec4 color; };

sbl_Attributes sbl_attributes_at(int triangle, float b1, float b2) {
    int number = int(sbl_fetch(sbl_triangles, 3 * triangle + 1).w);
    vec3 b = vec3(1.0 - b1 - b2, b1, b2);
    sbl_Attributes at = sbl_Attributes(vec2(0), vec4(0));
    for (int k = 0; k < 3; k++) {
        int v = int(sbl_fetch(sbl_indices, 3 * number + k).x);
        uint u = sbl_fetch(sbl_attributes, 2 * v).w;
        uvec4 c = sbl_fetch(sbl_attributes, 2 * v + 1);
        at.uv += b[k] * uintBitsToFloat(uvec2(u, c.x));
        at.color += b[k] / 65535.0 * vec4(c.y & 65535u, c.y >> 16, c.z & 65535u, c.z >> 16);
    }
    return at;
}

// Is the cutout solid here?
bool sbl_solid(int triangle, float b1, float b2) {
    uint object = sbl_fetch(sbl_triangles, 3 * triangle).w;
    float cutoff = uintBitsToFloat(sbl_object(object, 0).w);
    sbl_Attributes at = sbl_attributes_at(triangle, b1, b2);
    return at.color.a * sbl_texture(sbl_object(object, 2), at.uv).a >= cutoff;
}
#endif

const uint SBL_LEAF = 0x80000000u, SBL_ENTER = 12u, SBL_LEAVE = 13u, SBL_END = 0xffffffffu;

struct sbl_Hit {
    float distance;   // in lengths of the direction
    int triangle;     // as sbl_triangles counts; negative: nothing was hit
    int number;       // of the triangle in the scene
    float b1, b2;     // barycentrics of the second and third corner
    bool back;
};

// Does the ray's stretch up to `nearest` cross the box? Its entry distance, or 0x7fffffff; distances are the bits of floats, since they order as integers
// where none is negative, and a negative one is below all others. `per` is the length of a grid step along the ray, `offset` brings the origin to 0.
int sbl_box(uvec4 box, vec3 per, vec3 offset, bvec3 flip, int nearest) {
    vec3 low = vec3(box.xyz & 65535u), high = vec3(box.xyz >> 16);
    ivec3 entry = floatBitsToInt(mix(low, high, flip) * per + offset), leave = floatBitsToInt(mix(high, low, flip) * per + offset);
    int from = max(max(entry.x, entry.y), max(entry.z, 0)), to = min(min(leave.x, leave.y), min(leave.z, nearest));
    return from <= to + 8 ? from : 0x7fffffff;  // units in the last place, see Ize 2013, "Robust BVH Ray Traversal"
}

// The nearest hit nearer than `limit` and farther than `after`, or as far and of a triangle numbered above `past`: hits are ordered by distance, then number.
sbl_Hit sbl_nearest(vec3 origin, vec3 direction, float after, int past, float limit) {
    sbl_Hit hit = sbl_Hit(limit, -1, -1, 0.0, 0.0, false);

    // Watertight against shared edges: Woop, Benthin and Wald 2013. The axis along which the direction is longest becomes z, the ray is sheared onto it.
    vec3 size = abs(direction);
    int axis = size.x > size.y ? (size.x > size.z ? 0 : 2) : (size.y > size.z ? 1 : 2);
    vec3 d = axis == 0 ? direction.yzx : axis == 1 ? direction.zxy : direction;
    float shear_x = d.x / d.z, shear_y = d.y / d.z, per_z = 1.0 / d.z;

    bvec3 flip = lessThan(direction, vec3(0));
    vec3 inverse = 1.0 / mix(max(direction, vec3(1e-12)), min(direction, vec3(-1e-12)), flip);
    vec3 per = inverse / grid_per_length, offset = (grid_origin - origin) * inverse;
    uint stack[SBL_STACK];
    stack[0] = SBL_END;
    int top = 0;
    uint node = node_count == 0 ? SBL_END : 1u;
    while (true) {
        while (node < SBL_LEAF) {  // down to a leaf, the nearer child first
            uvec4 first = sbl_fetch(sbl_nodes, int(node) * 2), second = sbl_fetch(sbl_nodes, int(node) * 2 + 1);
            int nearest = floatBitsToInt(hit.distance), a = sbl_box(first, per, offset, flip, nearest), b = sbl_box(second, per, offset, flip, nearest);
            node = a <= b ? first.w : second.w;
            if (max(a, b) < 0x7fffffff) stack[++top] = a <= b ? second.w : first.w;
            if (min(a, b) == 0x7fffffff) node = stack[top--];
        }
        bool leaf = true;
        while ((node & 0xe0000000u) == SBL_ENTER << 28 && leaf) {  // into a grid, or back to the one around it; a loop, see sbl_trace
            uvec4 first = sbl_fetch(sbl_nodes, int(node & 0x0fffffffu) * 2), second = sbl_fetch(sbl_nodes, int(node & 0x0fffffffu) * 2 + 1);
            per = inverse / uintBitsToFloat(second.xyz);
            offset = (uintBitsToFloat(first.xyz) - origin) * inverse;
            if (node >> 28 == SBL_ENTER) {
                stack[++top] = SBL_LEAVE << 28 | second.w;
                node = first.w;
            } else node = stack[top--];
            leaf = false;
        }
        if (!leaf) continue;
        if (node == SBL_END) break;
        int from = int(node & 0x0fffffffu), to = from + int(node >> 28 & 7u);
        for (int t = from; t <= to; t++) {
            uvec4 second = sbl_fetch(sbl_triangles, 3 * t + 1);
            vec3 p = uintBitsToFloat(sbl_fetch(sbl_triangles, 3 * t).xyz) - origin;
            vec3 q = uintBitsToFloat(second.xyz) - origin;
            vec3 r = uintBitsToFloat(sbl_fetch(sbl_triangles, 3 * t + 2).xyz) - origin;
            p = axis == 0 ? p.yzx : axis == 1 ? p.zxy : p;
            q = axis == 0 ? q.yzx : axis == 1 ? q.zxy : q;
            r = axis == 0 ? r.yzx : axis == 1 ? r.zxy : r;
            p.xy -= vec2(shear_x, shear_y) * p.z;
            q.xy -= vec2(shear_x, shear_y) * q.z;
            r.xy -= vec2(shear_x, shear_y) * r.z;
            float u = r.x * q.y - r.y * q.x, v = p.x * r.y - p.y * r.x, w = q.x * p.y - q.y * p.x, determinant = u + v + w;
            bool inside = ((u >= 0.0 && v >= 0.0 && w >= 0.0) || (u <= 0.0 && v <= 0.0 && w <= 0.0)) && determinant != 0.0;
            float l = (u * p.z + v * q.z + w * r.z) * per_z / determinant;
            // A triangle that the ray starts beside, its own above all, must not be hit by rounding: it grows with how thin the triangle is.
            float deep = max(abs(p.z), max(abs(q.z), abs(r.z))), wide = max(dot(p.xy, p.xy), max(dot(q.xy, q.xy), dot(r.xy, r.xy)));
            inside = inside && l > 1e-4 * deep || inside && l * abs(determinant) > 1.2e-7 * deep * wide;
            int number = int(second.w);
            bool behind = l > after || (l == after && number > past);
            if (inside && behind && (l < hit.distance || (l == hit.distance && number < hit.number)))
                hit = sbl_Hit(l, t, number, v / determinant, w / determinant, (determinant < 0.0) == (d.z > 0.0));
        }
        node = stack[top--];
    }
    return hit;
}

// The nearest hit nearer than `limit`.
sbl_Hit sbl_trace(vec3 origin, vec3 direction, float limit) {
    sbl_Hit hit = sbl_Hit(0.0, -1, 0x7fffffff, 0.0, 0.0, false);
#ifdef SBL_TEXTURED
    // Cutouts: the nearest hit is looked at, and where nothing is there the ray goes on behind it.
    // All ifs are loops, since software renderers run both sides of every if, but leave loops that no lane enters.
    for (int layer = 0; layer < 64; layer++) {
        bool solid = true;
        hit = sbl_nearest(origin, direction, hit.distance, hit.number, limit);
        for (uint cut = hit.triangle < 0 ? 0u : sbl_fetch(sbl_triangles, 3 * hit.triangle + 2).w; cut != 0u; cut = 0u) solid = sbl_solid(hit.triangle, hit.b1, hit.b2);
        if (solid) break;
    }
#else
    hit = sbl_nearest(origin, direction, hit.distance, hit.number, limit);
#endif
    return hit;
}

// Right, up and forward of a sensor that looks along n: Duff et al. 2017, "Building an Orthonormal Basis, Revisited".
mat3 sbl_frame(vec3 n) {
    float s = n.z < 0.0 ? -1.0 : 1.0, f = -1.0 / (s + n.z), g = n.x * n.y * f;
    return mat3(1.0 + s * n.x * n.x * f, s * g, -s * n.x, g, s + n.y * n.y * f, -n.y, n);
}
