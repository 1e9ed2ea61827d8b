// What sensors' programs have in common. A sensor has a block of texels, one an invocation. There are two
// carriers: fragment shaders drawn over the blocks, and compute shaders, in which the invocations of a sensor
// follow each other.
uniform ivec2 blocks;            // invocations of a sensor: four by some, so that those that run side by side
                                 // trace neighbouring rays
uniform int columns;             // sensors across the target
uniform int first_slot, count;   // this many sensors stand from first_slot on
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

// Right, up and forward of a sensor that looks along n: Duff et al. 2017, "Building an Orthonormal Basis,
// Revisited".
mat3 sbl_frame(vec3 n) {
    float s = n.z < 0.0 ? -1.0 : 1.0, f = -1.0 / (s + n.z), g = n.x * n.y * f;
    return mat3(1.0 + s * n.x * n.x * f, s * g, -s * n.x, g, s + n.y * n.y * f, -n.y, n);
}
