// From a triangle's number and a ray to the surface point. Exact where rasterised attributes are not: a point interpolated across a
// large clipped triangle strays off its plane, and a sensor standing there would see its own surface.
uniform sbl_Texels sbl_positions;   // a vertex: x y z as float bits, object
uniform sbl_Texels sbl_attributes;  // a vertex, two texels: normal x y z, u | v, colour r g (16 bits each), colour b a, 0
uniform sbl_Texels sbl_indices;     // three a triangle

struct sbl_Surface {
    vec3 position, normal, geometric_normal;  // normals point against the ray
    vec4 albedo;                              // a: 0 where the cutout leaves nothing
    vec3 emission;
    float facet;                              // the triangle's least height
    float reach;                              // of its corners from the origin, plus its longest side: what rounding is relative to
    uint id, flags;
};

sbl_Surface sbl_surface(int triangle, vec3 origin, vec3 direction) {
    ivec3 v = ivec3(int(sbl_fetch(sbl_indices, 3 * triangle).x), int(sbl_fetch(sbl_indices, 3 * triangle + 1).x),
                    int(sbl_fetch(sbl_indices, 3 * triangle + 2).x));
    uvec4 record = sbl_fetch(sbl_positions, v.x);
    vec3 p0 = uintBitsToFloat(record.xyz);
    vec3 e1 = uintBitsToFloat(sbl_fetch(sbl_positions, v.y).xyz) - p0;
    vec3 e2 = uintBitsToFloat(sbl_fetch(sbl_positions, v.z).xyz) - p0;

    // Barycentrics of the ray's hit by Cramer's rule (Moeller and Trumbore 1997), kept inside the triangle.
    // The cross product is scaled to the edges' size first, so that small triangles do not underflow.
    float size = max(max(max(abs(e1.x), abs(e1.y)), abs(e1.z)), max(max(abs(e2.x), abs(e2.y)), abs(e2.z)));
    vec3 s1 = e1 / size, s2 = e2 / size;
    vec3 t = (origin - p0) / size, q = cross(t, s1), h = cross(direction, s2);
    float determinant = dot(s1, h);
    float b1 = clamp(dot(t, h) / determinant, 0.0, 1.0);
    float b2 = clamp(dot(direction, q) / determinant, 0.0, 1.0 - b1);
    if (!(abs(determinant) > 0.0)) { b1 = 1.0 / 3.0; b2 = 1.0 / 3.0; }
    float b0 = 1.0 - b1 - b2;

    sbl_Surface s;
    s.position = p0 + (b1 * e1 + b2 * e2);
    vec3 across = cross(s1, s2), face = normalize(across), s3 = s2 - s1;
    float longest = sqrt(max(dot(s1, s1), max(dot(s2, s2), dot(s3, s3))));
    s.facet = size * length(across) / longest;
    s.reach = length(p0) + 2.0 * size * longest;
    bool back = dot(face, direction) > 0.0;
    s.geometric_normal = back ? -face : face;

    uvec4 n0 = sbl_fetch(sbl_attributes, 2 * v.x), n1 = sbl_fetch(sbl_attributes, 2 * v.y), n2 = sbl_fetch(sbl_attributes, 2 * v.z);
    uvec4 c0 = sbl_fetch(sbl_attributes, 2 * v.x + 1), c1 = sbl_fetch(sbl_attributes, 2 * v.y + 1), c2 = sbl_fetch(sbl_attributes, 2 * v.z + 1);
    vec3 normal = b0 * uintBitsToFloat(n0.xyz) + b1 * uintBitsToFloat(n1.xyz) + b2 * uintBitsToFloat(n2.xyz);
    float length2 = dot(normal, normal);
    normal = length2 > 1e-12 ? normal * inversesqrt(length2) : face;
    normal = dot(normal, s.geometric_normal) < 0.0 ? -normal : normal;
    // A shading normal that turns away from the viewer would aim the sensor at the surface itself: bend it back to grazing.
    float grazing = dot(normal, normalize(direction));
    if (grazing > -0.01) normal = normalize(normal - (grazing + 0.01) * normalize(direction));
    s.normal = normal;

    vec2 uv = b0 * uintBitsToFloat(uvec2(n0.w, c0.x)) + b1 * uintBitsToFloat(uvec2(n1.w, c1.x)) + b2 * uintBitsToFloat(uvec2(n2.w, c2.x));
    vec4 color = b0 * vec4(c0.y & 65535u, c0.y >> 16, c0.z & 65535u, c0.z >> 16) +
                 b1 * vec4(c1.y & 65535u, c1.y >> 16, c1.z & 65535u, c1.z >> 16) +
                 b2 * vec4(c2.y & 65535u, c2.y >> 16, c2.z & 65535u, c2.z >> 16);

    uvec4 material = sbl_object(record.w, 0), light = sbl_object(record.w, 1);
    s.albedo = color / 65535.0 * sbl_texture(sbl_object(record.w, 2), uv);
    s.albedo = vec4(s.albedo.rgb * uintBitsToFloat(material.rgb), s.albedo.a < uintBitsToFloat(material.w) ? 0.0 : 1.0);
    s.emission = uintBitsToFloat(light.rgb) * sbl_texture(sbl_object(record.w, 3), uv).rgb;
    if (back && (light.w & SBL_ONE_SIDED_EMISSION) != 0u) s.emission = vec3(0);
    s.id = sbl_object(record.w, 4).x;
    s.flags = light.w;
    return s;
}
