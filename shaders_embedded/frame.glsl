// Returns a right-handed orthonormal basis whose third column is the unit vector n (Duff et al. 2017, "Building
// an Orthonormal Basis, Revisited").
mat3 sbl_frame(vec3 n) {
    float s = n.z < 0.0 ? -1.0 : 1.0, f = -1.0 / (s + n.z), g = n.x * n.y * f;
    return mat3(1.0 + s * n.x * n.x * f, s * g, -s * n.x, g, s + n.y * n.y * f, -n.y, n);
}

// Maps a point u, uniformly distributed in the unit square, to a cosine-distributed direction in the hemisphere
// about the frame's third column.
vec3 sbl_by_cosine(mat3 frame, vec2 u) {
    float radius = sqrt(u.x), angle = 2.0 * SBL_PI * u.y;
    return frame * vec3(radius * cos(angle), radius * sin(angle), sqrt(1.0 - u.x));
}

// Returns the u for which sbl_by_cosine returns a direction. local: unit direction in the frame; below the
// horizon, the result is that of its mirror image.
vec2 sbl_by_cosine_inverse(vec3 local) {
    return vec2(clamp(1.0 - local.z * local.z, 0.0, 0.9999999), fract(atan(local.y, local.x) / (2.0 * SBL_PI)));
}

// Returns the normalised interpolated normal or, if it is too short, `face`.
vec3 sbl_unit_normal(vec3 normal, vec3 face) {
    float length2 = dot(normal, normal);
    return length2 > SBL_NORMAL_LEAST ? normal * inversesqrt(length2) : face;
}

// Returns the result of sbl_unit_normal, on the side of geometric_normal. A normal that points away from the
// viewer would aim the sensor at its own surface, so its cosine is kept above SBL_GRAZING. direction: viewer to
// surface
vec3 sbl_shading_normal(vec3 normal, vec3 face, vec3 geometric_normal, vec3 direction) {
    normal = sbl_unit_normal(normal, face);
    normal = dot(normal, geometric_normal) < 0.0 ? -normal : normal;
    float grazing = dot(normal, normalize(direction));
    if (grazing > -SBL_GRAZING) normal = normalize(normal - (grazing + SBL_GRAZING) * normalize(direction));
    return normal;
}
