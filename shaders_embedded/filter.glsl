// Smooths R, or another layer of light, with the normalised Gaussian of section III-H over pixels with the same
// id. If geometry_aware is 1, a pixel has less weight if its normal or its plane differs (sbl_belongs), or if its
// R differs by more than noise explains. A difference of harmonics beyond their noise always reduces the weight.
// Light groups get the weights of R, so that they add up to R.
uniform sampler2D radiance;  // rgb: R (irradiance / pi); a: its noise, above 0 where the pixel shows a surface
uniform sampler2D layer;     // SBL_DIRECTIONAL: harmonics or a light group, to smooth instead of R
uniform bool is_group;       // true: `layer` is a light group
uniform sampler2D positions, normals;
uniform usampler2D ids;
uniform int radius;
uniform float falloff;       // 1 / (2 sigma^2), sigma in pixels
uniform int geometry_aware;
layout(location = 0) out vec4 out_radiance;

uniform float layer_noise;   // standard error of a harmonic as a fraction of R where R has no noise, see
                             // sbl__spec_layer_noise
const float SBL_HARMONIC = 2.0;  // noise of a harmonic divided by the noise of R, approximately

// Returns the approximate noise of a harmonic. r: R and its noise
float sbl_harmonic_noise(vec4 r) { return SBL_HARMONIC * r.a + layer_noise * max(r.r, max(r.g, r.b)); }

// Returns about 1 if noise explains the difference of two pixels, and about 0 if the difference is several times
// the noise.
float sbl_alike(vec4 a, vec4 b) {
    vec3 apart = abs(a.rgb - b.rgb), c = abs(a.rgb), d = abs(b.rgb);
    float noise = a.a + b.a + SBL_FILTER_VISIBLE * (max(c.r, max(c.g, c.b)) + max(d.r, max(d.g, d.b)));
    float difference = max(apart.r, max(apart.g, apart.b)) / max(noise, SBL_DIVISOR_LEAST);
    return exp(-SBL_FILTER_FALL * difference * difference);
}

void main() {
    ivec2 at = ivec2(gl_FragCoord.xy), size = textureSize(radiance, 0);
    uint id = texelFetch(ids, at, 0).x;
    out_radiance = vec4(0);
    if (id == 0u) return;
    vec3 p = texelFetch(positions, at, 0).xyz, n = texelFetch(normals, at, 0).xyz;
    vec4 sum = vec4(0), own = texelFetch(radiance, at, 0);
#ifdef SBL_DIRECTIONAL
    vec4 own_layer = vec4(texelFetch(layer, at, 0).rgb, sbl_harmonic_noise(own));
#endif
    for (int y = max(-radius, -at.y); y <= min(radius, size.y - 1 - at.y); y++)
        for (int x = max(-radius, -at.x); x <= min(radius, size.x - 1 - at.x); x++) {
            ivec2 there = at + ivec2(x, y);
            if (texelFetch(ids, there, 0).x != id) continue;
            vec4 light = texelFetch(radiance, there, 0);
            float weight = exp(-falloff * float(x * x + y * y));
            if (geometry_aware != 0 && (x != 0 || y != 0))
                weight *= sbl_belongs(p, n, texelFetch(positions, there, 0).xyz,
                                      texelFetch(normals, there, 0).xyz) *
                          sbl_alike(own, light);
#ifdef SBL_DIRECTIONAL
            light = vec4(texelFetch(layer, there, 0).rgb, sbl_harmonic_noise(light));
            weight *= is_group ? 1.0 : sbl_alike(own_layer, light);
#endif
            sum += weight * vec4(light.rgb, 1);
        }
    out_radiance = vec4(sum.rgb / sum.a, 1);
}
