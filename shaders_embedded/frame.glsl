// Returns a right-handed orthonormal basis whose third column is the unit vector n (Duff et al. 2017, "Building
// an Orthonormal Basis, Revisited").
mat3 sbl_frame(vec3 n) {
    float s = n.z < 0.0 ? -1.0 : 1.0, f = -1.0 / (s + n.z), g = n.x * n.y * f;
    return mat3(1.0 + s * n.x * n.x * f, s * g, -s * n.x, g, s + n.y * n.y * f, -n.y, n);
}

// Maps a uniform point u of the unit square to a cosine-distributed direction over the hemisphere about the
// frame's third column.
vec3 sbl_by_cosine(mat3 frame, vec2 u) {
    float radius = sqrt(u.x), angle = 2.0 * SBL_PI * u.y;
    return frame * vec3(radius * cos(angle), radius * sin(angle), sqrt(1.0 - u.x));
}
