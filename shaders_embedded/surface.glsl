// Computes surface points from a triangle's index in the scene and a ray. The rasteriser would interpolate
// positions that lie off the plane of a large clipped triangle, and a sensor there would see its own surface.
struct sbl_Surface {
    vec3 position, normal, geometric_normal;  // normals point against the ray
    sbl_Material material;
    vec3 emission;
    float least_height;                       // smallest of the triangle's three heights, in world units
    float reach;                              // world distance of the first corner from 0 0 0, plus twice the
                                              // longest side; rounding errors are proportional to it
    uint id;
    int object;
    bool back;                                // true: the ray sees the back of the triangle
};

// Smallest distance of points from the sides of their triangle, divided by reach. It is 4 * SBL_OFFSET, because
// sensors that draw views need this distance. SBL_OFFSET is the distance of sensors from their surface, divided by
// reach or by the extent.
const float SBL_INSET = 6e-6;

sbl_Attributes sbl_mix_attributes(ivec3 v, vec3 b) {
    sbl_Attributes at = sbl_Attributes(vec2(0), vec4(0));
    for (int k = 0; k < 3; k++) {
        at.uv += b[k] * vec2(sbl_attributes_u(v[k]), sbl_attributes_v(v[k]));
        at.color += b[k] * sbl_unpack_color(sbl_attributes_color_rg(v[k]), sbl_attributes_color_ba(v[k]));
    }
    return sbl_Attributes(at.uv, at.color / SBL_COLOR_MOST);
}

// A triangle: vertex indices, first corner, and the two edges from there. size: largest absolute value of the
// edges' components. s1, s2: edges divided by size, so that their cross product does not underflow
struct sbl_Facet {
    ivec3 v;
    vec3 p0, e1, e2, s1, s2;
    float size;
};

sbl_Facet sbl_facet(int triangle) {
    ivec3 v = sbl_corners(triangle);
    vec3 p0 = sbl_vertex_position(v.x), e1 = sbl_vertex_position(v.y) - p0, e2 = sbl_vertex_position(v.z) - p0;
    float size = max(max(max(abs(e1.x), abs(e1.y)), abs(e1.z)), max(max(abs(e2.x), abs(e2.y)), abs(e2.z)));
    return sbl_Facet(v, p0, e1, e2, e1 / size, e2 / size, size);
}

#if defined(SBL_NORMAL_MAPS) && !defined(SBL_LIGHTMAP)
const float SBL_TANGENT_LEAST = 1e-6;  // smallest length of the x axis of tangent space that can be normalised
const int SBL_NORMAL_POINTS = 8;  // maximum number of points per side of a pixel at which the normal map is
                                  // sampled
vec2 pixel_x = vec2(0), pixel_y = vec2(0);  // differences of texture coordinates between adjacent pixels along x
                                            // and y; 0: the normal map is sampled at one point

// Returns the mean of the unit normals that a normal map shows in the pixel around uv. The mean is shorter than 1
// if the normals differ.
vec3 sbl_normal_texel(int object, vec2 uv) {
    uvec4 entry = sbl_object_normal_texture(object);
    vec2 size = vec2(entry.yz);
    ivec2 points = ivec2(clamp(ceil(vec2(length(pixel_x * size), length(pixel_y * size))), vec2(1),
                               vec2(SBL_NORMAL_POINTS)));
    vec3 sum = vec3(0);
    for (int i = 0; i < points.x * points.y; i++) {
        vec2 at = (vec2(i % points.x, i / points.x) + 0.5) / vec2(points) - 0.5;
        vec3 texel = 2.0 * sbl_texture(entry, uv + at.x * pixel_x + at.y * pixel_y).rgb - 1.0;
        texel.xy *= sbl_object_normal_scale(object);
        sum += texel / max(length(texel), SBL_DIVISOR_LEAST);
    }
    return sum / float(points.x * points.y);
}

// Transforms v from tangent space to world space. normal: z axis of tangent space. The x axis points where the
// first texture coordinate increases, y where the second decreases. Returns the normal if the x axis is not
// defined.
vec3 sbl_from_tangent_space(sbl_Facet f, vec3 normal, vec3 v) {
    vec2 uv[3];
    for (int k = 0; k < 3; k++) uv[k] = vec2(sbl_attributes_u(f.v[k]), sbl_attributes_v(f.v[k]));
    vec2 a = uv[1] - uv[0], b = uv[2] - uv[0];
    float size = max(max(abs(a.x), abs(a.y)), max(abs(b.x), abs(b.y)));
    a /= max(size, SBL_DIVISOR_LEAST);
    b /= max(size, SBL_DIVISOR_LEAST);
    float handedness = a.x * b.y - a.y * b.x < 0.0 ? -1.0 : 1.0;
    vec3 x = handedness * (b.y * f.s1 - a.y * f.s2), y = handedness * (b.x * f.s1 - a.x * f.s2);
    x -= dot(x, normal) * normal;
    float along = length(x);
    if (along < SBL_TANGENT_LEAST) return normal;
    x /= along;
    vec3 bitangent = cross(normal, x);
    return v.x * x + v.y * (dot(bitangent, y) < 0.0 ? -bitangent : bitangent) + v.z * normal;
}

// Returns the normal-mapped shading normal, not normalised, at least SBL_GRAZING above the triangle's plane, on
// the side that the interpolated normal points to. normal: interpolated normal, of any length; face: unit
// geometric normal; mean: result of sbl_normal_texel
vec3 sbl_tilted_normal(sbl_Facet f, vec3 normal, vec3 face, vec3 mean) {
    normal = sbl_unit_normal(normal, face);
    vec3 tilted = normalize(sbl_from_tangent_space(f, normal, mean));
    vec3 side = dot(normal, face) < 0.0 ? -face : face;
    float below = SBL_GRAZING - dot(tilted, side);  // positive: the normal points below the surface
    return tilted + max(below, 0.0) * side;
}
#endif

// Returns the surface point at barycentrics b1, b2 (of the second and third corner), seen along `direction`.
sbl_Surface sbl_surface_at(sbl_Facet f, float b1, float b2, vec3 direction) {
    int object = int(sbl_vertex_object(f.v.x));
    float b0 = 1.0 - b1 - b2;

    sbl_Surface s;
    s.position = f.p0 + (b1 * f.e1 + b2 * f.e2);
    vec3 edges_cross = cross(f.s1, f.s2), s3 = f.s2 - f.s1;
    float widest = max(max(abs(edges_cross.x), abs(edges_cross.y)), abs(edges_cross.z));
    // short vectors are scaled first, because their squared length may underflow in normalize
    vec3 face = normalize(widest > 1e-15 ? edges_cross : widest > 0.0 ? edges_cross / widest : -direction);
    float longest = sqrt(max(dot(f.s1, f.s1), max(dot(f.s2, f.s2), dot(s3, s3))));
    s.least_height = f.size * length(edges_cross) / longest;
    s.reach = length(f.p0) + 2.0 * f.size * longest;
    // Keeps points away from the triangle's sides. Otherwise a sensor in a crease would stand in the plane of the
    // other surface, and see past it.
    vec3 sides[3] = vec3[3](s3, -f.s2, f.s1), b = vec3(b0, b1, b2);
    for (int k = 0; k < 3; k++) {
        float side = max(length(sides[k]), SBL_DIVISOR_LEAST), height = f.size * length(edges_cross) / side;
        float lacks = min(SBL_INSET * s.reach, height / 3.0) - b[k] * height;
        s.position += max(lacks, 0.0) / side * cross(face, sides[k]);
    }
    s.back = dot(face, direction) > 0.0;
    s.geometric_normal = s.back ? -face : face;
    vec3 normal = b.x * sbl_attributes_normal(f.v.x) + b.y * sbl_attributes_normal(f.v.y) +
                  b.z * sbl_attributes_normal(f.v.z);
    sbl_Attributes at = sbl_mix_attributes(f.v, b);
    s.material = sbl_material(object, at);
#if defined(SBL_NORMAL_MAPS) && !defined(SBL_LIGHTMAP)
    for (int once = 0; once < (sbl_object_normal_texture(object).w == 0u ? 0 : 1); once++) {
        vec3 mean = sbl_normal_texel(object, at.uv);
        normal = sbl_tilted_normal(f, normal, face, mean);
        sbl_blur_by_normals(s.material, length(mean));
    }
#endif
    s.normal = sbl_shading_normal(normal, face, s.geometric_normal, direction);
    s.emission = sbl_emission(object, s.back) * sbl_emission_pattern(object, at);
    s.id = sbl_object_id(object);
    s.object = object;
    return s;
}

// Returns barycentrics of the second and third corner where a ray meets a triangle's plane, by Cramer's rule
// (Moeller and Trumbore 1997). z: 0 if the ray is parallel to the plane, otherwise 1, also if the plane is behind
vec3 sbl_on_plane(sbl_Facet f, vec3 origin, vec3 direction) {
    vec3 t = (origin - f.p0) / f.size, q = cross(t, f.s1), h = cross(direction, f.s2);
    float determinant = dot(f.s1, h);
    return vec3(dot(t, h) / determinant, dot(direction, q) / determinant, abs(determinant) > 0.0 ? 1 : 0);
}

// Returns the surface point where a ray meets a triangle.
sbl_Surface sbl_surface(int triangle, vec3 origin, vec3 direction) {
    sbl_Facet f = sbl_facet(triangle);
    vec3 on_plane = sbl_on_plane(f, origin, direction);
    float b1 = clamp(on_plane.x, 0.0, 1.0), b2 = clamp(on_plane.y, 0.0, 1.0 - b1);
    if (on_plane.z == 0.0) { b1 = 1.0 / 3.0; b2 = 1.0 / 3.0; }
    return sbl_surface_at(f, b1, b2, direction);
}

#if defined(SBL_NORMAL_MAPS) && !defined(SBL_LIGHTMAP)
// Returns the texture coordinates where a ray meets a triangle's plane.
vec2 sbl_uv_on_plane(sbl_Facet f, vec3 origin, vec3 direction) {
    vec3 b = sbl_on_plane(f, origin, direction);
    return b.z == 0.0 ? vec2(0) : sbl_mix_attributes(f.v, vec3(1.0 - b.x - b.y, b.xy)).uv;
}
#endif

#ifdef SBL_LIGHTMAP
// Returns the surface point seen from the front: the side to which the vertex normals point (see
// sbl_lightmap_desc).
sbl_Surface sbl_surface_front(int triangle, float b1, float b2) {
    sbl_Facet f = sbl_facet(triangle);
    vec3 face = normalize(cross(f.s1, f.s2));
    vec3 normal = (1.0 - b1 - b2) * sbl_attributes_normal(f.v.x) + b1 * sbl_attributes_normal(f.v.y) +
                  b2 * sbl_attributes_normal(f.v.z);
    return sbl_surface_at(f, b1, b2, dot(normal, face) < 0.0 ? face : -face);
}
#endif
