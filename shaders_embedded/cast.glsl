// Rays in, hits out: what each of some rays meets first. A ray of negative limit goes off a surface somewhere, by
// the cosine; its direction is the surface's normal.
SBL_OUT(0, out_place);   // where; 1 + the triangle's number, its low bits, negative: of its back side; 0: nothing
SBL_OUT(1, out_share);   // the share of light that bounces there; the number's high bits

void main() {
    ivec2 texel = sbl_texel_of_invocation();
    int ray = texel.y * columns + texel.x;
    if (ray >= count) sbl_leave;
    vec3 origin = sbl_cast_origin(ray), direction = sbl_cast_direction(ray), share = vec3(0);
    float limit = sbl_cast_limit(ray);
    uint fractions = sbl_cast_fractions(ray);
    vec2 u = (vec2(fractions & 65535u, fractions >> 16) + 0.5) / 65536.0;
    if (limit < 0.0) direction = sbl_by_cosine(sbl_frame(direction), u);
    sbl_Hit hit = sbl_trace(origin, direction, abs(limit));
    float low = 0.0, high = 0.0;
    if (hit.triangle >= 0) {
        int object = int(sbl_triangle_object(hit.triangle));
        share = sbl_bounced(sbl_material(object, sbl_attributes_of(hit)));
        low = (float(hit.number % SBL_CAST_NUMBERS) + 1.0) * (hit.back ? -1.0 : 1.0);
        high = float(hit.number / SBL_CAST_NUMBERS);
    }
    sbl_write(out_place, vec4(origin + direction * hit.distance, low));
    sbl_write(out_share, vec4(share, high));
}
