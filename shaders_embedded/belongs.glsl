// Returns how well two surface points with the same id belong to one smooth surface, 0 to 1, from their normals n
// and m and from the distance of each point from the other's plane. sbl__belongs in sbl.h adds the test for equal
// ids.
float sbl_belongs(vec3 p, vec3 n, vec3 q, vec3 m) {
    float parallel = clamp((dot(n, m) - SBL_BELONGS_COSINE) / SBL_BELONGS_RANGE, 0.0, 1.0);
    vec3 d = q - p;
    float from_plane = max(abs(dot(d, n)), abs(dot(d, m))), apart = length(d);
    float plane = 2.0 - SBL_BELONGS_PLANE * from_plane / max(apart, SBL_DIVISOR_LEAST);
    return parallel * parallel * clamp(plane, 0.0, 1.0);
}
