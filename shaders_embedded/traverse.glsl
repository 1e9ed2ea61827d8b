// A ray through the bounding volume hierarchy (see >>bvh in sbl.h). Two texels a node, one a child:
//   lowest x | y << 16, lowest z | highest x << 16, highest y | highest z << 16, child
// in steps of a grid over the scene; a child is a node's number, or 1 << 31 | (triangles - 1) << 28 | first triangle.
// A triangle is three texels: corner, object; corner, number in the scene; corner, 1 where a cutout may leave nothing.
uniform usamplerBuffer sbl_nodes, sbl_triangles;
uniform vec3 grid_origin, grid_per_length;  // grid coordinates are (p - grid_origin) * grid_per_length
uniform int node_count;                     // 0: an empty scene

#ifdef SBL_TEXTURED
struct sbl_Attributes { vec2 uv; vec4 color; };

sbl_Attributes sbl_attributes_at(int triangle, float b1, float b2) {
    int number = int(texelFetch(sbl_triangles, 3 * triangle + 1).w);
    vec3 b = vec3(1.0 - b1 - b2, b1, b2);
    sbl_Attributes at = sbl_Attributes(vec2(0), vec4(0));
    for (int k = 0; k < 3; k++) {
        int v = int(texelFetch(sbl_indices, 3 * number + k).x);
        uint u = texelFetch(sbl_attributes, 2 * v).w;
        uvec4 c = texelFetch(sbl_attributes, 2 * v + 1);
        at.uv += b[k] * uintBitsToFloat(uvec2(u, c.x));
        at.color += b[k] / 65535.0 * vec4(c.y & 65535u, c.y >> 16, c.z & 65535u, c.z >> 16);
    }
    return at;
}

// Is the cutout solid here?
bool sbl_solid(int triangle, float b1, float b2) {
    uint object = texelFetch(sbl_triangles, 3 * triangle).w;
    float cutoff = uintBitsToFloat(sbl_object(object, 0).w);
    sbl_Attributes at = sbl_attributes_at(triangle, b1, b2);
    return at.color.a * sbl_texture(sbl_object(object, 2), at.uv).a >= cutoff;
}
#endif

const uint SBL_LEAF = 0x80000000u;

struct sbl_Hit {
    float distance;   // in lengths of the direction; negative: nothing was hit
    int triangle;     // as sbl_triangles counts
    float b1, b2;     // barycentrics of the second and third corner
    bool back;
};

// Does the ray's stretch up to `nearest` cross the box? Its entry distance, or 1e30.
float sbl_box(uvec4 box, vec3 start, vec3 inverse, float nearest) {
    vec3 low = vec3(box.x & 65535u, box.x >> 16, box.y & 65535u), high = vec3(box.y >> 16, box.z & 65535u, box.z >> 16);
    vec3 a = (low - start) * inverse, b = (high - start) * inverse;
    vec3 entry = min(a, b), leave = max(a, b);
    float from = max(max(entry.x, entry.y), max(entry.z, 0.0)), to = min(min(leave.x, leave.y), min(leave.z, nearest));
    return from <= to * 1.0000004 ? from : 1e30;  // Ize 2013, "Robust BVH Ray Traversal"
}

sbl_Hit sbl_trace(vec3 origin, vec3 direction) {
    sbl_Hit hit = sbl_Hit(-1.0, -1, 0.0, 0.0, false);
    if (node_count == 0) return hit;

    // Watertight against shared edges: Woop, Benthin and Wald 2013. The axis along which the direction is longest becomes z, the ray is sheared onto it.
    vec3 size = abs(direction);
    int axis = size.x > size.y ? (size.x > size.z ? 0 : 2) : (size.y > size.z ? 1 : 2);
    vec3 d = axis == 0 ? direction.yzx : axis == 1 ? direction.zxy : direction;
    float shear_x = d.x / d.z, shear_y = d.y / d.z, per_z = 1.0 / d.z;

    vec3 start = (origin - grid_origin) * grid_per_length, along = direction * grid_per_length;
    vec3 inverse = 1.0 / vec3(abs(along.x) > 1e-20 ? along.x : 1e-20, abs(along.y) > 1e-20 ? along.y : 1e-20, abs(along.z) > 1e-20 ? along.z : 1e-20);
    float nearest = 1e30;
    uint stack[SBL_STACK];
    int top = 0;
    uint node = 0u;
    bool running = true;
    while (running) {
        while (node < SBL_LEAF) {  // down to a leaf, the nearer child first
            uvec4 first = texelFetch(sbl_nodes, int(node) * 2), second = texelFetch(sbl_nodes, int(node) * 2 + 1);
            float a = sbl_box(first, start, inverse, nearest), b = sbl_box(second, start, inverse, nearest);
            if (a == 1e30 && b == 1e30) {
                if (top == 0) { running = false; break; }
                node = stack[--top];
            } else if (b == 1e30) node = first.w;
            else if (a == 1e30) node = second.w;
            else {
                stack[top++] = a <= b ? second.w : first.w;
                node = a <= b ? first.w : second.w;
            }
        }
        if (!running) break;
        int from = int(node & 0x0fffffffu), to = from + int((node >> 28) & 7u);
        for (int t = from; t <= to; t++) {
            vec3 p = uintBitsToFloat(texelFetch(sbl_triangles, 3 * t).xyz) - origin;
            vec3 q = uintBitsToFloat(texelFetch(sbl_triangles, 3 * t + 1).xyz) - origin;
            uvec4 last = texelFetch(sbl_triangles, 3 * t + 2);
            vec3 r = uintBitsToFloat(last.xyz) - origin;
            p = axis == 0 ? p.yzx : axis == 1 ? p.zxy : p;
            q = axis == 0 ? q.yzx : axis == 1 ? q.zxy : q;
            r = axis == 0 ? r.yzx : axis == 1 ? r.zxy : r;
            p.xy -= vec2(shear_x, shear_y) * p.z;
            q.xy -= vec2(shear_x, shear_y) * q.z;
            r.xy -= vec2(shear_x, shear_y) * r.z;
            float u = r.x * q.y - r.y * q.x, v = p.x * r.y - p.y * r.x, w = q.x * p.y - q.y * p.x;
            float determinant = u + v + w;
            if ((min(u, min(v, w)) >= 0.0 || max(u, max(v, w)) <= 0.0) && determinant != 0.0) {
                float distance_to = (u * p.z + v * q.z + w * r.z) * per_z / determinant;
                if (distance_to > 0.0 && distance_to < nearest) {
#ifdef SBL_TEXTURED
                    bool solid = true;  // a loop, since software renderers run both sides of every if, but leave loops that no lane enters
                    for (uint cut = last.w; cut != 0u; cut = 0u) solid = sbl_solid(t, v / determinant, w / determinant);
                    if (!solid) continue;
#endif
                    nearest = distance_to;
                    hit = sbl_Hit(distance_to, t, v / determinant, w / determinant, (determinant < 0.0) == (d.z > 0.0));
                }
            }
        }
        if (top == 0) break;
        node = stack[--top];
    }
    return hit;
}
