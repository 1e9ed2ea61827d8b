// A part of one sensor's rays: cosine-distributed directions, so that all weigh the same. The outputs are those of
// reduce_blocks.glsl.
uniform usamplerBuffer sbl_sequence;  // points of the Sobol sequence, two 32-bit fractions each, along a Morton
                                      // curve
uniform int rays;                     // of a sensor
uniform float spread;                 // 1: the cosine's whole hemisphere; 0: all rays go along the normal
uniform vec3 sky;
SBL_OUT(0, out_sum);
SBL_OUT(1, out_hits);

vec3 sbl_radiance(sbl_Hit hit, vec3 position) {
    int object = int(sbl_triangle_object(hit.triangle));
    sbl_Attributes at = sbl_Attributes(vec2(0), vec4(1));
#ifdef SBL_TEXTURED
    sbl_when (!sbl_outgoing_is_plain(object, hit.back)) at = sbl_attributes_at(hit.triangle, hit.b1, hit.b2);
#endif
    vec3 radiance = sbl_outgoing(object, hit.back, at);
#ifdef SBL_BOUNCED
    radiance += sbl_reflected(object, hit.number, hit.back, position, hit.distance, at);
#endif
    return radiance;
}

void main() {
    ivec2 texel = sbl_texel_of_invocation(), sheet = texel / blocks, within = texel % blocks;
    int sensor = sheet.y * columns + sheet.x - first_slot;
    if (sensor < 0 || sensor >= count) sbl_leave;
    vec3 position = sbl_look_position(sensor);
    mat3 frame = sbl_frame(sbl_look_normal(sensor));
    uvec2 scramble = sbl_look_scramble(sensor);
    int skip = int(sbl_look_number(sensor)) * rays;

    vec4 sum = vec4(0), hits = vec4(0, 0, 1e30, 0);
    for (int i = within.y * blocks.x + within.x; i < rays; i += blocks.x * blocks.y) {
        uvec2 fraction = texelFetch(sbl_sequence, skip + i).xy ^ scramble;
        vec2 u = (vec2(fraction >> 8) + 0.5) / 16777216.0 * vec2(spread, 1.0);
        float radius = sqrt(u.x), angle = 6.283185307 * u.y;
        vec3 direction = frame * vec3(radius * cos(angle), radius * sin(angle), sqrt(1.0 - u.x));
        sbl_Hit hit = sbl_trace(position, direction, 1e30);
        if (hit.triangle < 0) sum.rgb += sky + sbl_sky(direction);
        else {
            sum += vec4(sbl_radiance(hit, position + direction * hit.distance), hit.back ? 1.0 : 0.0);
            hits.xy += vec2(1.0, hit.distance);
            hits.z = min(hits.z, hit.distance);
        }
    }
    sum /= float(rays);
    float light = dot(sum.rgb, vec3(1.0 / 3.0));
    sbl_write(out_sum, sum);
    sbl_write(out_hits, vec4(hits.xy / float(rays), hits.z, light * light));
}
