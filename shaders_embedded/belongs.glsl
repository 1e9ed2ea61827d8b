// How far two surface points of one id belong together, 0 to 1: by their normals and by how far each lies off the
// other's plane.
// sbl__belongs in sbl.h is the same for the CPU.
float sbl_belongs(vec3 p, vec3 n, vec3 q, vec3 m) {
    float turn = clamp((dot(n, m) - 0.8) / 0.2, 0.0, 1.0);
    vec3 d = q - p;
    float off = max(abs(dot(d, n)), abs(dot(d, m))), apart = length(d);
    return turn * turn * clamp(2.0 - 8.0 * off / max(apart, 1e-30), 0.0, 1.0);
}
