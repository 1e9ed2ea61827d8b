// Composes (section III-H) one anti-aliasing sample of every pixel: emission plus reflected light. The sample has
// its own G-buffer. Its light comes from the nearest pixel centres that show the same surface, so that light does
// not bleed over edges.
uniform sampler2D radiance;                 // R (irradiance / pi) at pixel centres
#ifdef SBL_SPECULAR
uniform sampler2D reflected;                // mean radiance in the specular lobe, at pixel centres
uniform sampler2D albedo;                   // at pixel centres; w: see gbuffer_fragment.glsl
uniform bool only_blurred;                  // true: only blurred pixels get this sample
uniform sampler2D sample_specular;          // albedo of the specular lobe
#endif
uniform sampler2D positions, normals;       // at pixel centres
uniform usampler2D ids;
uniform sampler2D sample_positions, sample_normals, sample_albedo, sample_emission;
uniform usampler2D sample_ids;
uniform vec2 offset;                        // position of the sample relative to the pixel's centre, in pixels
uniform sampler2D previous;                 // weighted sum of the previous samples
uniform float previous_weight;              // factor of `previous`; 0: this is the first sample
uniform float sample_weight;                // weight of this sample
layout(location = 0) out vec4 out_color;
#ifdef SBL_DISPLAY
uniform sampler2D previous_display;         // like `previous`, for the colour on a screen
uniform vec3 backdrop;                      // sbl_picture_desc.backdrop
uniform float first_row;                    // index in the whole picture of this part's first row
uniform float height;                       // number of rows of the whole picture
const float SBL_BACKDROP_TOP = 0.3;         // factor of the backdrop at the upper edge of the picture
layout(location = 1) out vec4 out_display;
#endif

const int SBL_REACH = 2;                // R is taken from pixels at most this far away in x and y
const float SBL_NEAR_ENOUGH = 0.05;     // smallest sum of weights at which the four nearest pixels suffice
const float SBL_SAME_ID = 1e-3;         // weight of a pixel that has the same id, but does not belong to the
                                        // surface
const float SBL_OTHER_ID = 0.01;        // if no pixel has the sample's id, the weight is this + cosine of normals

// Returns the light at the sample: a weighted mean over those of the four nearest pixels that belong to the
// sample's surface. If the sum of their weights is too small, takes the mean over the pixels within SBL_REACH
// that have the sample's id; if no pixel has this id, over all pixels within SBL_REACH that show a surface.
// Returns 0 if there are none. light: R or another light at pixel centres
vec3 sbl_light_at(sampler2D light, ivec2 at, uint id) {
    ivec2 size = textureSize(light, 0), least = at + ivec2(floor(offset));
    vec3 p = texelFetch(sample_positions, at, 0).xyz, n = texelFetch(sample_normals, at, 0).xyz;
    vec4 near = vec4(0);
    for (int i = 0; i < 4; i++) {
        ivec2 there = clamp(least + ivec2(i & 1, i >> 1), ivec2(0), size - 1);
        if (texelFetch(ids, there, 0).x != id) continue;
        vec2 tent = 1.0 - abs(vec2(least + ivec2(i & 1, i >> 1) - at) - offset);
        near += tent.x * tent.y * vec4(texelFetch(light, there, 0).rgb, 1) *
                sbl_belongs(p, n, texelFetch(positions, there, 0).xyz, texelFetch(normals, there, 0).xyz);
    }
    bool enough = near.a > SBL_NEAR_ENOUGH;
    int across = 2 * SBL_REACH + 1, count = enough ? 0 : across * across;
    vec4 far = vec4(0), rest = vec4(0);
    for (int i = 0; i < count; i++) {
        ivec2 step = ivec2(i % across, i / across) - SBL_REACH, there = clamp(at + step, ivec2(0), size - 1);
        uint there_id = texelFetch(ids, there, 0).x;
        if (there_id == 0u) continue;
        vec3 q = texelFetch(positions, there, 0).xyz, m = texelFetch(normals, there, 0).xyz;
        vec2 d = vec2(step) - offset;
        vec4 r = exp(-dot(d, d)) * vec4(texelFetch(light, there, 0).rgb, 1);
        if (there_id == id) far += r * (sbl_belongs(p, n, q, m) + SBL_SAME_ID);
        rest += r * (SBL_OTHER_ID + max(0.0, dot(n, m)));
    }
    vec4 sum = enough ? near : far.a > 0.0 ? far : rest;
    return sum.a > 0.0 ? sum.rgb / sum.a : vec3(0);
}

#ifdef SBL_SPECULAR
// Returns true if a pixel is blurred. It is, if a blurred mirror is seen at its centre or at the centre of one of
// its eight neighbours.
bool sbl_blurred(ivec2 at) {
    ivec2 last = textureSize(albedo, 0) - 1;
    float most = 0.0;
    for (int y = -1; y <= 1; y++)
        for (int x = -1; x <= 1; x++)
            most = max(most, texelFetch(albedo, clamp(at + ivec2(x, y), ivec2(0), last), 0).w);
    return most > 1.5;
}
#endif

void main() {
    ivec2 at = ivec2(gl_FragCoord.xy);
#ifdef SBL_SPECULAR
    if (only_blurred && !sbl_blurred(at)) discard;
#endif
    uint id = texelFetch(sample_ids, at, 0).x;
    bool first = previous_weight == 0.0;
    vec4 before = first ? vec4(0) : previous_weight * texelFetch(previous, at, 0);
    vec3 color;
    if (id == 0u) color = sky + sbl_sky_smooth(sbl_camera_direction());
    else {
        vec3 light = offset == vec2(0) ? texelFetch(radiance, at, 0).rgb : sbl_light_at(radiance, at, id);
        sbl_Material material;
        material.albedo = texelFetch(sample_albedo, at, 0).rgb;
        color = texelFetch(sample_emission, at, 0).rgb + sbl_reflected(material, light);
#ifdef SBL_SPECULAR
        light = offset == vec2(0) ? texelFetch(reflected, at, 0).rgb : sbl_light_at(reflected, at, id);
        color += texelFetch(sample_specular, at, 0).rgb * max(light, 0.0);  // noise can make light negative
#endif
    }
    out_color = before + sample_weight * vec4(color, 1);
#ifdef SBL_DISPLAY
    vec4 shown_before = first ? vec4(0) : previous_weight * texelFetch(previous_display, at, 0);
    float fade = mix(SBL_BACKDROP_TOP, 1.0, (gl_FragCoord.y + first_row) / height);
    vec3 least = id == 0u ? fade * backdrop : vec3(0);
    out_display = shown_before + sample_weight * vec4(max(sbl_shown(color), least), 1);
#endif
}
