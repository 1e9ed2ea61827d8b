// Second half, and the only one of a traced sensor: every output texel adds up the blocks of one sensor and is its
// result.
uniform sampler2D block_sums, block_hits;
uniform ivec2 blocks;  // of one sheet
uniform int columns;   // sheets across the atlas
uniform int slots;     // sheets in the atlas
uniform int width;     // of the results' texture
uniform int first, last;
uniform sampler2D lights;  // parts texels a sensor, one below the other, whose mean comes on top: light; its
                           // variance
uniform int parts;         // 0: there are none
layout(location = 0) out vec4 out_sum;
layout(location = 1) out vec4 out_hits;  // w: the variance of its luminance, where rays sampled it
#ifdef SBL_DIRECTIONAL
uniform sampler2D block_red, block_green, block_blue, lights_red, lights_green, lights_blue;  // harmonics
uniform sampler2D block_even;            // what a sensor's rays miss of those of even light, and so, about, of any
uniform bool even;                       // there is that
layout(location = 2) out vec4 out_red;
layout(location = 3) out vec4 out_green;
layout(location = 4) out vec4 out_blue;

// A sensor's sum of one of them.
vec4 sbl_sum(sampler2D block_harmonics, ivec2 corner, sampler2D light_harmonics, ivec2 light_corner) {
    vec4 sum = vec4(0);
    for (int i = 0; i < blocks.x * blocks.y; i++)
        sum += texelFetch(block_harmonics, corner + ivec2(i % blocks.x, i / blocks.x), 0);
    for (int i = 0; i < parts; i++)
        sum += texelFetch(light_harmonics, light_corner + ivec2(0, i), 0) / float(parts);
    return sum;
}
#endif

void main() {
    int sensor = int(gl_FragCoord.y) * width + int(gl_FragCoord.x);
    if (sensor < first || sensor > last) discard;
    int slot = sensor % slots;
    ivec2 corner = ivec2(slot % columns, slot / columns) * blocks;
    vec4 sum = vec4(0), hits = vec4(0, 0, SBL_UNBOUNDED, 0), missed = vec4(0);
    for (int y = 0; y < blocks.y; y++) {
        vec4 row = vec4(0), row_hits = vec4(0);
        for (int x = 0; x < blocks.x; x++) {
            row += texelFetch(block_sums, corner + ivec2(x, y), 0);
            vec4 h = texelFetch(block_hits, corner + ivec2(x, y), 0);
            row_hits += h;
            hits.z = min(hits.z, h.z);
        }
#ifdef SBL_DIRECTIONAL
        for (int x = 0; x < blocks.x && even; x++) missed += texelFetch(block_even, corner + ivec2(x, y), 0);
#endif
        sum += row;
        hits.xyw += row_hits.xyw;
    }
    vec3 rays_light = sum.rgb;
    for (int i = 0; i < parts; i++) {
        ivec2 at = ivec2(slot % columns, slot / columns * parts + i);
        vec4 light = texelFetch(lights, at, 0) / float(parts);
        sum.rgb += light.rgb;
        hits.w += light.a / float(parts);
    }
    out_sum = sum;
    out_hits = hits;
#ifdef SBL_DIRECTIONAL
    ivec2 light_corner = ivec2(slot % columns, slot / columns * parts);
    out_red = sbl_sum(block_red, corner, lights_red, light_corner) + rays_light.r * missed;
    out_green = sbl_sum(block_green, corner, lights_green, light_corner) + rays_light.g * missed;
    out_blue = sbl_sum(block_blue, corner, lights_blue, light_corner) + rays_light.b * missed;
#endif
}
