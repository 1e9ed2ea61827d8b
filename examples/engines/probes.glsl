// Light from a grid of probes, which sbl_bake --probes AxBxC has written as .json. For GLSL 3.30, GLSL ES 3.00 and
// later. The host loads the file like this:
//
//     sbl_probe_grid, sbl_probe_origin, sbl_probe_spacing: "grid", "origin" and "spacing" of the file
//     sbl_probe_texels: a texture of RGBA32F or RGBA16F that is not filtered, 9 * grid.x texels wide and
//         grid.y * grid.z high. Probes are in the order of the file: x runs fastest, then y. Probe (x, y, z) has its
//         coefficient sh[i] in texel (9 * x + i, y + grid.y * z); the alpha there is 1 if the probe is valid, else 0
//
// sbl_probe_light(position, normal) is irradiance / pi, so that a matte surface sends out albedo * sbl_probe_light. The
// position is in the world of the scene file. It is the mean of the valid ones among the eight probes around the
// position, with trilinear weights, and 0 if none of them is valid.

uniform sampler2D sbl_probe_texels;
uniform ivec3 sbl_probe_grid;
uniform vec3 sbl_probe_origin, sbl_probe_spacing;

// Returns irradiance / pi at a probe, and whether the probe is valid.
vec4 sbl_probe_at(ivec3 probe, vec3 n) {
    ivec2 at = ivec2(9 * probe.x, probe.y + sbl_probe_grid.y * probe.z);
    vec4 first = texelFetch(sbl_probe_texels, at, 0);
    vec3 light = 0.282094792 * first.rgb;
    // "constants" of the file times its "irradiance_over_pi_weights"
    light += 0.325735008 * n.y * texelFetch(sbl_probe_texels, at + ivec2(1, 0), 0).rgb;
    light += 0.325735008 * n.z * texelFetch(sbl_probe_texels, at + ivec2(2, 0), 0).rgb;
    light += 0.325735008 * n.x * texelFetch(sbl_probe_texels, at + ivec2(3, 0), 0).rgb;
    light += 0.273137108 * n.x * n.y * texelFetch(sbl_probe_texels, at + ivec2(4, 0), 0).rgb;
    light += 0.273137108 * n.y * n.z * texelFetch(sbl_probe_texels, at + ivec2(5, 0), 0).rgb;
    light += 0.078847891 * (3.0 * n.z * n.z - 1.0) * texelFetch(sbl_probe_texels, at + ivec2(6, 0), 0).rgb;
    light += 0.273137108 * n.x * n.z * texelFetch(sbl_probe_texels, at + ivec2(7, 0), 0).rgb;
    light += 0.136568554 * (n.x * n.x - n.y * n.y) * texelFetch(sbl_probe_texels, at + ivec2(8, 0), 0).rgb;
    return vec4(light, first.a);
}

vec3 sbl_probe_light(vec3 position, vec3 normal) {
    vec3 last = vec3(sbl_probe_grid - 1);
    vec3 spacing = max(sbl_probe_spacing, vec3(1e-30));  // 0: the scene is flat in this direction
    vec3 at = clamp((position - sbl_probe_origin) / spacing, vec3(0.0), last);
    ivec3 cell = min(ivec3(at), max(sbl_probe_grid - 2, ivec3(0)));
    vec3 share = at - vec3(cell), n = normalize(normal), light = vec3(0.0);
    float all = 0.0;
    for (int corner = 0; corner < 8; corner++) {
        ivec3 side = ivec3(corner & 1, corner >> 1 & 1, corner >> 2);
        vec3 weights = mix(1.0 - share, share, vec3(side));
        float weight = weights.x * weights.y * weights.z;
        if (weight <= 0.0) continue;
        vec4 probe = sbl_probe_at(cell + side, n);
        if (probe.a < 0.5) continue;
        light += weight * probe.rgb;
        all += weight;
    }
    // Harmonics of the degree 2 can become slightly negative on the far side of a small lamp.
    return all > 0.0 ? max(light / all, vec3(0.0)) : vec3(0.0);
}
