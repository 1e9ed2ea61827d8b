// Code of reduce_blocks.glsl and of all programs that trace rays for sensors or for the store. Each look (see
// >>sensors in sbl.h) or each ray of cast.glsl has a slot of blocks.x * blocks.y texels in the outputs, and one
// invocation computes each texel. The programs run either as fragment shaders, drawn over the slots, or as compute
// shaders, in which the invocations of a slot have consecutive indices.
uniform ivec2 blocks;            // size of a slot in texels. The slots of trace.glsl are at most 4 wide, so that
                                 // invocations that run in parallel trace neighbouring rays
uniform int columns;             // number of slots in a row of the outputs
uniform bool counts_steps;       // true: the outputs also contain the number of steps that the rays take through
                                 // the hierarchy, see sbl__spec.counts_steps
uniform int first_slot, count;   // the looks of this draw use `count` slots, from slot first_slot on

const vec3 SBL_LUMINANCE = vec3(SBL_LUMINANCE_WEIGHTS);
const float SBL_COSINE_LEAST = 1e-6;  // lower limit of cosines before their reciprocal is taken

// Returns true if the driver has ended a loop of this invocation early, which makes the invocation's results
// wrong. Some software renderers limit the loop iterations of an invocation (llvmpipe to 65,535). Beyond the
// limit, every loop silently ends after its first iteration. The loop below has two iterations, and detects the
// limit by ending after one. As `count` is a uniform, no compiler unrolls the loop.
bool sbl_cut_short() {
    int iterations = 0, all = min(count, 1) + 1;
    for (int i = 0; i < all; i++) iterations++;
    return iterations < all;
}

// Converts 32-bit fractions to a point in the unit square.
vec2 sbl_unit_square(uvec2 fractions) { return (vec2(fractions >> 8) + 0.5) / SBL_FRACTIONS; }

// Light from the unit direction w adds a term to R. Returns the factors that convert this term to the terms that
// the light adds to the first four spherical-harmonic coefficients of radiance, in the order 1, y, z, x. R
// includes the cosine between w and the normal n, radiance does not. reciprocal: 1 / cosine
vec4 sbl_harmonics(vec3 w, vec3 n, float reciprocal) {
    vec3 scaled = n + reciprocal * (w - dot(w, n) * n);  // w / cosine; its component along n is 1
    return SBL_PI * vec4(SBL_HARMONIC_0 * reciprocal, SBL_HARMONIC_1 * scaled.yzx);
}

#ifdef SBL_COMPUTE
layout(local_size_x = SBL_WORKGROUP) in;
#define SBL_OUT(number, name) layout(rgba32f, binding = number) writeonly uniform image2D name
#define sbl_write(name, value) imageStore(name, sbl_texel_of_invocation(), value)
#define sbl_leave return

ivec2 sbl_texel_of_invocation() {
    int i = int(gl_GlobalInvocationID.x), size = blocks.x * blocks.y;
    int slot = first_slot + i / size, block = i % size;
    return ivec2(slot % columns, slot / columns) * blocks + ivec2(block % blocks.x, block / blocks.x);
}
#else
#define SBL_OUT(number, name) layout(location = number) out vec4 name
#define sbl_write(name, value) name = value
#define sbl_leave discard

ivec2 sbl_texel_of_invocation() { return ivec2(gl_FragCoord.xy); }
#endif

// SBL_OUT_HARMONICS declares three outputs, for the harmonics of red, green and blue light; a, b, c: their indices
// for SBL_OUT. sbl_write_harmonics writes them. Without SBL_DIRECTIONAL, both do nothing.
#ifdef SBL_DIRECTIONAL
#define SBL_OUT_HARMONICS(a, b, c) SBL_OUT(a, out_red); SBL_OUT(b, out_green); SBL_OUT(c, out_blue);
#define sbl_write_harmonics(h) sbl_write(out_red, h[0]); sbl_write(out_green, h[1]); sbl_write(out_blue, h[2])
#else
#define SBL_OUT_HARMONICS(a, b, c)
#define sbl_write_harmonics(h)
#endif
