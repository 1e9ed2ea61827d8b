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

void main() {
    int sensor = int(gl_FragCoord.y) * width + int(gl_FragCoord.x);
    if (sensor < first || sensor > last) discard;
    int slot = sensor % slots;
    ivec2 corner = ivec2(slot % columns, slot / columns) * blocks;
    vec4 sum = vec4(0), hits = vec4(0, 0, 1e30, 0);
    for (int y = 0; y < blocks.y; y++) {
        vec4 row = vec4(0), row_hits = vec4(0);
        for (int x = 0; x < blocks.x; x++) {
            row += texelFetch(block_sums, corner + ivec2(x, y), 0);
            vec4 h = texelFetch(block_hits, corner + ivec2(x, y), 0);
            row_hits += h;
            hits.z = min(hits.z, h.z);
        }
        sum += row;
        hits.xyw += row_hits.xyw;
    }
    for (int i = 0; i < parts; i++) {
        ivec2 at = ivec2(slot % columns, slot / columns * parts + i);
        vec4 light = texelFetch(lights, at, 0) / float(parts);
        sum.rgb += light.rgb;
        hits.w += light.a / float(parts);
    }
    out_sum = sum;
    out_hits = hits;
}
