// What sensors' programs have in common. A sensor has a block of texels, one an invocation. There are two
// carriers: fragment shaders drawn over the blocks, and compute shaders, in which the invocations of a sensor
// follow each other.
uniform ivec2 blocks;            // invocations of a sensor: four by some, so that those that run side by side
                                 // trace neighbouring rays
uniform int columns;             // sensors across the target
uniform int first_slot, count;   // this many sensors stand from first_slot on

const vec3 SBL_LUMINANCE = vec3(SBL_LUMINANCE_WEIGHTS);
const float SBL_COSINE_LEAST = 1e-6;  // for reciprocals of cosines

// 32-bit fractions as a point between 0 and 1.
vec2 sbl_unit_square(uvec2 fractions) { return (vec2(fractions >> 8) + 0.5) / SBL_FRACTIONS; }

// What R that comes from a unit direction w counts in the radiance's first two bands of real spherical harmonics:
// 1, y, z, x. reciprocal: of the cosine between w and the normal n.
vec4 sbl_harmonics(vec3 w, vec3 n, float reciprocal) {
    vec3 way = n + reciprocal * (w - dot(w, n) * n);  // w over the cosine
    return SBL_PI * vec4(SBL_HARMONIC_0 * reciprocal, SBL_HARMONIC_1 * way.yzx);
}

#ifdef SBL_COMPUTE
layout(local_size_x = SBL_WORKGROUP) in;
#define SBL_OUT(place, name) layout(rgba32f, binding = place) writeonly uniform image2D name
#define sbl_write(name, value) imageStore(name, sbl_texel_of_invocation(), value)
#define sbl_leave return

ivec2 sbl_texel_of_invocation() {
    int i = int(gl_GlobalInvocationID.x), size = blocks.x * blocks.y;
    int slot = first_slot + i / size, part = i % size;
    return ivec2(slot % columns, slot / columns) * blocks + ivec2(part % blocks.x, part / blocks.x);
}
#else
#define SBL_OUT(place, name) layout(location = place) out vec4 name
#define sbl_write(name, value) name = value
#define sbl_leave discard

ivec2 sbl_texel_of_invocation() { return ivec2(gl_FragCoord.xy); }
#endif
