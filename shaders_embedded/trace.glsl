// A part of one sensor's rays: cosine-distributed directions, so that all weigh the same. The outputs are those of reduce_blocks.glsl.
uniform usamplerBuffer sbl_points;    // a sensor, three texels: position, hash; normal, hash; first ray
uniform usamplerBuffer sbl_sequence;  // points of the Sobol sequence, two 32-bit fractions each, along a Morton curve
uniform int rays;                     // of a sensor
uniform float epsilon;
uniform float spread;                 // 1: the cosine's whole hemisphere; 0: all rays go along the normal
uniform vec3 sky;
uniform bool lamps_apart;             // light from emitting triangles comes from lamps.glsl
SBL_OUT(0, out_sum);
SBL_OUT(1, out_hits);

vec3 sbl_radiance(sbl_Hit hit) {
    uint object = sbl_fetch(sbl_triangles, 3 * hit.triangle).w;
    uvec4 material = sbl_object(object, 0), light = sbl_object(object, 1);
    vec3 emission = uintBitsToFloat(light.rgb);
    bool emits = max(max(emission.r, emission.g), emission.b) > 0.0 && !(hit.back && (light.w & SBL_ONE_SIDED_EMISSION) != 0u);
    if (emits && lamps_apart) return vec3(0);
    vec3 ambient = epsilon * uintBitsToFloat(material.rgb);
#ifdef SBL_TEXTURED
    sbl_when (emits || epsilon > 0.0) {
        sbl_Attributes at = sbl_attributes_at(hit.triangle, hit.b1, hit.b2);
        ambient *= (at.color * sbl_texture(sbl_object(object, 2), at.uv)).rgb;
        emission *= sbl_texture(sbl_object(object, 3), at.uv).rgb;
    }
#endif
    return emits ? emission : ambient;
}

void main() {
    ivec2 at = sbl_texel_of_invocation(), sheet = at / blocks, within = at % blocks;
    int sensor = sheet.y * columns + sheet.x - first_slot;
    if (sensor < 0 || sensor >= count) sbl_leave;
    uvec4 a = texelFetch(sbl_points, 3 * sensor), b = texelFetch(sbl_points, 3 * sensor + 1);
    int skip = int(texelFetch(sbl_points, 3 * sensor + 2).x);
    vec3 position = uintBitsToFloat(a.xyz), n = uintBitsToFloat(b.xyz);
    mat3 frame = sbl_frame(n);

    vec4 sum = vec4(0), hits = vec4(0, 0, 1e30, 0);
    for (int i = within.y * blocks.x + within.x; i < rays; i += blocks.x * blocks.y) {
        uvec2 fraction = texelFetch(sbl_sequence, skip + i).xy ^ uvec2(a.w, b.w);
        vec2 u = (vec2(fraction >> 8) + 0.5) / 16777216.0 * vec2(spread, 1.0);
        float radius = sqrt(u.x), angle = 6.283185307 * u.y;
        vec3 direction = frame * vec3(radius * cos(angle), radius * sin(angle), sqrt(1.0 - u.x));
        sbl_Hit hit = sbl_trace(position, direction, 1e30);
        if (hit.triangle < 0) sum.rgb += sky + sbl_sky(direction);
        else {
            sum += vec4(sbl_radiance(hit), hit.back ? 1.0 : 0.0);
            hits.xy += vec2(1.0, hit.distance);
            hits.z = min(hits.z, hit.distance);
        }
    }
    sum /= float(rays);
    float light = dot(sum.rgb, vec3(1.0 / 3.0));
    sbl_write(out_sum, sum);
    sbl_write(out_hits, vec4(hits.xy / float(rays), hits.z, light * light));
}
