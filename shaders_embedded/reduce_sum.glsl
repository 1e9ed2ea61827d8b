// Sums the partial sums of each look; each output texel is the result of one look. The partial sums come from
// reduce_blocks.glsl for views, and from trace.glsl for rays.
uniform sampler2D block_sums, block_hits;  // out_sum and out_hits of reduce_blocks.glsl or trace.glsl
uniform ivec2 blocks;          // width and height of a look's slot in the textures of partial sums, in texels
uniform int columns, slots;    // number of slots per row; number of slots in total
uniform int first, last;       // indices of the first and last look to compute
uniform sampler2D lights;      // R from lamps.glsl: `invocations` estimates per look; their mean is added
uniform float steps_scale;     // not 0: the low bits of the variances in `lights` hold numbers of steps; their sum
                               // times steps_scale is added to out_hits.y
uniform int invocations;       // number of texels per look in `lights`, in a column; 0: no lamps
layout(location = 0) out vec4 out_sum;   // texture 0 of sbl__job.results
layout(location = 1) out vec4 out_hits;  // texture 1 of sbl__job.results
uniform sampler2D block_red, block_green, block_blue, lights_red, lights_green, lights_blue;
uniform sampler2D block_control;  // out_control of trace.glsl, which corrects the harmonics
uniform bool has_control;         // true: the shader adds the correction in block_control
#ifdef SBL_DIRECTIONAL
layout(location = 2) out vec4 out_red;
layout(location = 3) out vec4 out_green;
layout(location = 4) out vec4 out_blue;
#endif
#ifdef SBL_GROUPS
SBL_IF_0(uniform sampler2D blocks_0; uniform sampler2D lights_0; layout(location = 2) out vec4 out_0;)
SBL_IF_1(uniform sampler2D blocks_1; uniform sampler2D lights_1; layout(location = 3) out vec4 out_1;)
SBL_IF_2(uniform sampler2D blocks_2; uniform sampler2D lights_2; layout(location = 4) out vec4 out_2;)
SBL_IF_3(uniform sampler2D blocks_3; uniform sampler2D lights_3; layout(location = 5) out vec4 out_3;)
SBL_IF_4(uniform sampler2D blocks_4; uniform sampler2D lights_4; layout(location = 6) out vec4 out_4;)
SBL_IF_5(uniform sampler2D blocks_5; uniform sampler2D lights_5; layout(location = 7) out vec4 out_5;)
#endif

// Returns the sum, from partial sums and from lamps, of a look's harmonics of one colour, or of some of its
// layers.
vec4 sbl_sum(sampler2D block_harmonics, ivec2 corner, sampler2D light_harmonics, ivec2 light_corner) {
    vec4 sum = vec4(0);
    for (int i = 0; i < blocks.x * blocks.y; i++)
        sum += texelFetch(block_harmonics, corner + ivec2(i % blocks.x, i / blocks.x), 0);
    for (int i = 0; i < invocations; i++)
        sum += texelFetch(light_harmonics, light_corner + ivec2(0, i), 0) / float(invocations);
    return sum;
}

void main() {
    int look = int(gl_FragCoord.y) * SBL_RESULTS_WIDTH + int(gl_FragCoord.x);
    if (look < first || look > last) discard;
    ivec2 slot = ivec2(look % slots % columns, look % slots / columns);
    ivec2 corner = slot * blocks, light_corner = slot * ivec2(1, invocations);
    vec4 sum = vec4(0), hits = vec4(0, 0, SBL_UNBOUNDED, 0), control = vec4(0);
    for (int y = 0; y < blocks.y; y++) {
        vec4 row = vec4(0), row_hits = vec4(0);
        for (int x = 0; x < blocks.x; x++) {
            row += texelFetch(block_sums, corner + ivec2(x, y), 0);
            vec4 h = texelFetch(block_hits, corner + ivec2(x, y), 0);
            row_hits += h;
            hits.z = min(hits.z, h.z);
            if (has_control) control += texelFetch(block_control, corner + ivec2(x, y), 0);
        }
        sum += row;
        hits.xyw += row_hits.xyw;
    }
    vec3 rays_light = sum.rgb;
    for (int i = 0; i < invocations; i++) {
        vec4 light = texelFetch(lights, light_corner + ivec2(0, i), 0);
        if (steps_scale > 0.0 && light.a >= 0.0) {
            uint bits = floatBitsToUint(light.a);
            hits.y += steps_scale * float(bits & uint(SBL_STEPS_MASK));
            light.a = uintBitsToFloat(bits & ~uint(SBL_STEPS_MASK));
        }
        light /= float(invocations);
        sum.rgb += light.rgb;
        hits.w += light.a / float(invocations);
        if (light.a < 0.0) hits.z = SBL_LOST;
    }
    out_sum = sum;
    out_hits = hits;
#ifdef SBL_GROUPS
    SBL_IF_0(out_0 = sbl_sum(blocks_0, corner, lights_0, light_corner);)
    SBL_IF_1(out_1 = sbl_sum(blocks_1, corner, lights_1, light_corner);)
    SBL_IF_2(out_2 = sbl_sum(blocks_2, corner, lights_2, light_corner);)
    SBL_IF_3(out_3 = sbl_sum(blocks_3, corner, lights_3, light_corner);)
    SBL_IF_4(out_4 = sbl_sum(blocks_4, corner, lights_4, light_corner);)
    SBL_IF_5(out_5 = sbl_sum(blocks_5, corner, lights_5, light_corner);)
#endif
#ifdef SBL_DIRECTIONAL
    out_red = sbl_sum(block_red, corner, lights_red, light_corner) + rays_light.r * control;
    out_green = sbl_sum(block_green, corner, lights_green, light_corner) + rays_light.g * control;
    out_blue = sbl_sum(block_blue, corner, lights_blue, light_corner) + rays_light.b * control;
#endif
}
