// First step of the sum over a sensor's views: each output texel is the sum over one block of the view texture.
uniform sampler2D view_texture;  // written by sensor_fragment.glsl
uniform sampler2D weights;       // per texel of a sheet: form factor; ratio of distance to depth
uniform int block;               // width and height of a block, in texels
SBL_OUT(0, out_sum);             // sum of weight * radiance; sum of the weights of back faces
SBL_OUT(1, out_hits);            // of texels that show surfaces: sum of weights; sum of weight * distance; least
                                 // distance; 0
uniform sampler2D directions;    // with SBL_DIRECTIONAL: direction of each texel of a sheet, if the rotation is 0
SBL_OUT_HARMONICS(2, 3, 4)

void main() {
    ivec2 at = ivec2(gl_FragCoord.xy), corner = at * block, sheet_corner = (at % blocks) * block;
    vec4 sum = vec4(0), hits = vec4(0, 0, SBL_UNBOUNDED, 0);
    int slot = at.y / blocks.y * columns + at.x / blocks.x;
    float s = sin(sbl_look_rotation(slot)), c = cos(sbl_look_rotation(slot));
    mat3 frame = sbl_frame(sbl_look_normal(slot)) * mat3(c, -s, 0, s, c, 0, 0, 0, 1);
    mat3x4 harmonics = mat3x4(0);
    for (int y = 0; y < block; y++) {
        vec3 row = vec3(0);
        float back = 0.0;
        for (int x = 0; x < block; x++) {
            vec4 texel = texelFetch(view_texture, corner + ivec2(x, y), 0);
            vec2 weight = texelFetch(weights, sheet_corner + ivec2(x, y), 0).xy;
            row += weight.x * texel.rgb;
            vec3 d = texelFetch(directions, sheet_corner + ivec2(x, y), 0).xyz;
            vec4 to_harmonics = sbl_harmonics(frame * d, frame[2], 1.0 / max(d.z, SBL_COSINE_LEAST));
            harmonics += outerProduct(to_harmonics, weight.x * texel.rgb);
            float seen = weight.x > 0.0 && texel.a != 0.0 ? weight.x : 0.0;
            float length_to_hit = abs(texel.a) * weight.y;
            back += texel.a < 0.0 ? seen : 0.0;
            hits.x += seen;
            hits.y += seen * min(length_to_hit, SBL_UNBOUNDED);
            hits.z = seen > 0.0 ? min(hits.z, length_to_hit) : hits.z;
        }
        sum += vec4(row, back);
    }
    out_sum = sum;
    out_hits = hits;
    sbl_write_harmonics(harmonics);
}
