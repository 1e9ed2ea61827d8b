// Composition (section III-H) of one anti-aliasing sample of every pixel: emission + albedo * R. The sample has its own G-buffer;
// R is looked up among the nearest pixel centres that show the same surface, so that light never bleeds over an edge.
uniform sampler2D radiance;                 // R at pixel centres
uniform sampler2D positions, normals;       // at pixel centres
uniform usampler2D ids;
uniform sampler2D sample_positions, sample_normals, sample_albedo, sample_emission;
uniform usampler2D sample_ids;
uniform vec2 offset;                        // of the sample from the pixel's centre, pixels
uniform vec3 sky;                         // constant
uniform vec3 direction_0, direction_x, direction_y;  // a pixel's ray, affine in its position
uniform sampler2D previous;                 // what the samples before this one gave
uniform float first, share;               // first: 0 for the first sample, else 1; share: 1 / samples
layout(location = 0) out vec4 out_color;

// As a camera sees the environment: bilinear.
vec3 sbl_sky_smooth(vec3 direction) {
    vec3 radiance = vec3(0);
    if (sky_limit == 0.0) return radiance;
    ivec2 size = textureSize(sky_picture, 0);
    vec2 at = sbl_sky_at(direction) * vec2(size) - 0.5, corner = floor(at), f = at - corner;
    for (int i = 0; i < 4; i++) {
        ivec2 step = ivec2(i & 1, i >> 1), texel = ivec2(corner) + step;
        vec2 weight = mix(1.0 - f, f, vec2(step));
        radiance += weight.x * weight.y * texelFetch(sky_picture, ivec2((texel.x + size.x) % size.x, clamp(texel.y, 0, size.y - 1)), 0).rgb;
    }
    return radiance;
}

void main() {
    ivec2 at = ivec2(gl_FragCoord.xy), size = textureSize(radiance, 0);
    uint id = texelFetch(sample_ids, at, 0).x;
    vec4 before = first == 0.0 ? vec4(0) : texelFetch(previous, at, 0);
    if (id == 0u) { out_color = before + share * vec4(sky + sbl_sky_smooth(direction_0 + gl_FragCoord.x * direction_x + gl_FragCoord.y * direction_y), 1); return; }
    vec3 p = texelFetch(sample_positions, at, 0).xyz, n = texelFetch(sample_normals, at, 0).xyz;
    vec3 light = vec3(0);
    if (offset == vec2(0)) light = texelFetch(radiance, at, 0).rgb;
    else {
        vec4 near = vec4(0), far = vec4(0), rest = vec4(0);
        for (int y = -2; y <= 2; y++)
            for (int x = -2; x <= 2; x++) {
                ivec2 there = clamp(at + ivec2(x, y), ivec2(0), size - 1);
                uint there_id = texelFetch(ids, there, 0).x;
                if (there_id == 0u) continue;
                vec3 q = texelFetch(positions, there, 0).xyz, m = texelFetch(normals, there, 0).xyz;
                vec4 r = vec4(texelFetch(radiance, there, 0).rgb, 1);
                vec2 d = abs(vec2(x, y) - offset);
                float tent = max(0.0, 1.0 - d.x) * max(0.0, 1.0 - d.y), reach = exp(-dot(d, d));
                float belongs = there_id == id ? sbl_belongs(p, n, q, m) : 0.0;
                near += r * tent * belongs;
                far += r * reach * (belongs + (there_id == id ? 1e-3 : 0.0));
                rest += r * reach * (0.01 + max(0.0, dot(n, m)));
            }
        if (near.a > 0.05) light = near.rgb / near.a;
        else if (far.a > 0.0) light = far.rgb / far.a;
        else if (rest.a > 0.0) light = rest.rgb / rest.a;
    }
    out_color = before + share * vec4(texelFetch(sample_emission, at, 0).rgb + texelFetch(sample_albedo, at, 0).rgb * light, 1);
}
