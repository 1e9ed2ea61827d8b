// First half of a rasterised sensor's sum: every output texel adds up one block of the atlas.
uniform sampler2D atlas;    // Ck r g b, signed distance
uniform sampler2D weights;  // of one sheet: the texel's projected solid angle over pi, its ray's length at unit
                            // depth
uniform int block;          // texels across a block
uniform ivec2 blocks;       // of one sheet
layout(location = 0) out vec4 out_sum;   // sum of weight * Ck; weight that sees back faces
layout(location = 1) out vec4 out_hits;  // weight that sees surfaces; weight * distance; nearest distance; 0

void main() {
    ivec2 at = ivec2(gl_FragCoord.xy), corner = at * block, sheet_corner = (at % blocks) * block;
    vec4 sum = vec4(0), hits = vec4(0, 0, 1e30, 0);
    for (int y = 0; y < block; y++) {
        vec3 row = vec3(0);
        float back = 0.0;
        for (int x = 0; x < block; x++) {
            vec4 texel = texelFetch(atlas, corner + ivec2(x, y), 0);
            vec2 weight = texelFetch(weights, sheet_corner + ivec2(x, y), 0).xy;
            row += weight.x * texel.rgb;
            float seen = weight.x > 0.0 && texel.a != 0.0 ? weight.x : 0.0;
            float length_to_hit = abs(texel.a) * weight.y;
            back += texel.a < 0.0 ? seen : 0.0;
            hits.x += seen;
            hits.y += seen * min(length_to_hit, 1e30);
            hits.z = seen > 0.0 ? min(hits.z, length_to_hit) : hits.z;
        }
        sum += vec4(row, back);
    }
    out_sum = sum;
    out_hits = hits;
}
