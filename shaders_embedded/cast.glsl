// Finds the first hit of each ray. A ray with a negative limit leaves a surface, whose normal is `direction`, in a
// random direction with cosine distribution; -limit is its maximum length.
// out_place: xyz: position of the hit, far away if nothing was hit; w: 1 + triangle's number % SBL_CAST_NUMBERS,
// negative for its back side; 0 if nothing was hit or the driver ended a loop early
SBL_OUT(0, out_place);
// rgb: albedo for bounced light; a: triangle's number / SBL_CAST_NUMBERS; SBL_LOST: loop ended early
SBL_OUT(1, out_albedo);

void main() {
    ivec2 texel = sbl_texel_of_invocation();
    int ray = texel.y * columns + texel.x;
    if (ray >= count) sbl_leave;
    vec3 origin = sbl_cast_origin(ray), direction = sbl_cast_direction(ray), albedo = vec3(0);
    float limit = sbl_cast_limit(ray);
    uint fractions = sbl_cast_fractions(ray);
    vec2 u = (vec2(fractions & 65535u, fractions >> 16) + 0.5) / 65536.0;
    if (limit < 0.0) direction = sbl_by_cosine(sbl_frame(direction), u);
    sbl_Hit hit = sbl_trace(origin, direction, abs(limit), SBL_RAY_PATH);
    float low = 0.0, high = 0.0;
    if (hit.triangle >= 0) {
        int object = int(sbl_triangle_object(hit.triangle));
        albedo = sbl_bounced(sbl_material(object, sbl_attributes_of(hit)), sbl_tint);
        low = (float(hit.number % SBL_CAST_NUMBERS) + 1.0) * (hit.back ? -1.0 : 1.0);
        high = float(hit.number / SBL_CAST_NUMBERS);
    }
    if (sbl_cut_short()) { low = 0.0; high = SBL_LOST; }
    sbl_write(out_place, vec4(origin + direction * hit.distance, low));
    sbl_write(out_albedo, vec4(albedo, high));
}
