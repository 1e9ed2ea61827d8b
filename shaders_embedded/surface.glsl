// Computes surface points from a triangle's number and a ray. Positions that the rasteriser interpolates over a
// large clipped triangle lie off its plane, so that a sensor there would see its own surface.
struct sbl_Surface {
    vec3 position, normal, geometric_normal;  // normals point against the ray
    sbl_Material material;
    vec3 emission;
    float facet;                              // smallest of the triangle's three heights, world units
    float reach;                              // world distance of the first corner from 0 0 0, plus twice the
                                              // longest side; rounding errors are in proportion to it
    uint id;
    int object;
    bool back;                                // true: the ray sees the back of the triangle
};

const float SBL_INSET = 6e-6;  // least distance of points from the sides of their triangle, divided by reach.
                               // Views need four times SBL_OFFSET, the distance of sensors from their surface

sbl_Attributes sbl_mix_attributes(ivec3 v, vec3 b) {
    sbl_Attributes at = sbl_Attributes(vec2(0), vec4(0));
    for (int k = 0; k < 3; k++) {
        at.uv += b[k] * vec2(sbl_attributes_u(v[k]), sbl_attributes_v(v[k]));
        at.color += b[k] * sbl_unpack_color(sbl_attributes_color_rg(v[k]), sbl_attributes_color_ba(v[k]));
    }
    return sbl_Attributes(at.uv, at.color / SBL_COLOR_MOST);
}

// A triangle: vertex numbers, first corner, and the edges from there. size: largest absolute value of the edges'
// components. s1, s2: edges divided by size, so that their cross product does not underflow
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

// The surface point at barycentrics b1, b2 (of the second and third corner), seen along `direction`.
sbl_Surface sbl_surface_at(sbl_Facet f, float b1, float b2, vec3 direction) {
    int object = int(sbl_vertex_object(f.v.x));
    float b0 = 1.0 - b1 - b2;

    sbl_Surface s;
    s.position = f.p0 + (b1 * f.e1 + b2 * f.e2);
    vec3 across = cross(f.s1, f.s2), s3 = f.s2 - f.s1;
    float widest = max(max(abs(across.x), abs(across.y)), abs(across.z));
    // shorter vectors are scaled first, because their squared length may underflow in normalize
    vec3 face = normalize(widest > 1e-15 ? across : widest > 0.0 ? across / widest : -direction);
    float longest = sqrt(max(dot(f.s1, f.s1), max(dot(f.s2, f.s2), dot(s3, s3))));
    s.facet = f.size * length(across) / longest;
    s.reach = length(f.p0) + 2.0 * f.size * longest;
    // Points are kept away from the triangle's sides. Otherwise a sensor at a crease would stand in the plane of
    // the other surface, and see past it.
    vec3 sides[3] = vec3[3](s3, -f.s2, f.s1), b = vec3(b0, b1, b2);
    for (int k = 0; k < 3; k++) {
        float side = max(length(sides[k]), SBL_DIVISOR_LEAST), height = f.size * length(across) / side;
        float lacks = min(SBL_INSET * s.reach, height / 3.0) - b[k] * height;
        s.position += max(lacks, 0.0) / side * cross(face, sides[k]);
    }
    s.back = dot(face, direction) > 0.0;
    s.geometric_normal = s.back ? -face : face;
    vec3 normal = b.x * sbl_attributes_normal(f.v.x) + b.y * sbl_attributes_normal(f.v.y) +
                  b.z * sbl_attributes_normal(f.v.z);
    s.normal = sbl_shading_normal(normal, face, s.geometric_normal, direction);

    sbl_Attributes at = sbl_mix_attributes(f.v, b);
    s.material = sbl_material(object, at);
    s.emission = sbl_emission(object, s.back) * sbl_emission_pattern(object, at);
    s.id = sbl_object_id(object);
    s.object = object;
    return s;
}

// The surface point where a ray meets a triangle.
sbl_Surface sbl_surface(int triangle, vec3 origin, vec3 direction) {
    sbl_Facet f = sbl_facet(triangle);
    // Barycentrics by Cramer's rule (Moeller and Trumbore 1997), clamped to the triangle.
    vec3 t = (origin - f.p0) / f.size, q = cross(t, f.s1), h = cross(direction, f.s2);
    float determinant = dot(f.s1, h);
    float b1 = clamp(dot(t, h) / determinant, 0.0, 1.0);
    float b2 = clamp(dot(direction, q) / determinant, 0.0, 1.0 - b1);
    if (!(abs(determinant) > 0.0)) { b1 = 1.0 / 3.0; b2 = 1.0 / 3.0; }
    return sbl_surface_at(f, b1, b2, direction);
}

#ifdef SBL_LIGHTMAP
// The surface point seen from the front, which is the side of the vertex normals (see sbl_lightmap_desc).
sbl_Surface sbl_surface_front(int triangle, float b1, float b2) {
    sbl_Facet f = sbl_facet(triangle);
    vec3 face = normalize(cross(f.s1, f.s2));
    vec3 normal = (1.0 - b1 - b2) * sbl_attributes_normal(f.v.x) + b1 * sbl_attributes_normal(f.v.y) +
                  b2 * sbl_attributes_normal(f.v.z);
    return sbl_surface_at(f, b1, b2, dot(normal, face) < 0.0 ? face : -face);
}
#endif
