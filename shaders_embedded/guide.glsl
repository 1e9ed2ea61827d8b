// Distributes a sensor's rays by a guide (see >>guide in sbl.h). A guide divides 0 .. 65536 into SBL_GUIDE_BANDS
// intervals, one per band of the hemisphere, and again for each band into SBL_GUIDE_SECTORS intervals, one per
// sector. It stores the start of each interval as a 16-bit number, eight of them per texel.
#ifdef SBL_GUIDED
uniform usampler2D sbl_guides;

// Finds the interval that contains x among the 8 * texels intervals stored from texel `from` on. Returns the
// interval's start, end and index.
vec3 sbl_guide_interval(ivec2 from, int texels, float x) {
    vec3 interval = vec3(0, SBL_GUIDE_STEPS, -1);
    for (int i = 0; i < texels; i++) {
        uvec4 eight = texelFetch(sbl_guides, from + ivec2(i, 0), 0);
        vec4 a = vec4(eight & 0xffffu), b = vec4(eight >> 16);
        vec4 begun_a = step(a, vec4(x)), begun_b = step(b, vec4(x));
        vec4 last = max(a * begun_a, b * begun_b);
        vec4 end = vec4(SBL_GUIDE_STEPS), next = min(mix(end, a, 1.0 - begun_a), mix(end, b, 1.0 - begun_b));
        interval.x = max(interval.x, max(max(last.x, last.y), max(last.z, last.w)));
        interval.y = min(interval.y, min(min(next.x, next.y), min(next.z, next.w)));
        interval.z += dot(begun_a + begun_b, vec4(1));
    }
    return interval;
}

// Returns the first texel of a guide.
ivec2 sbl_guide_texel(int guide) {
    return ivec2(guide % SBL_GUIDES_ACROSS * SBL_GUIDE_TEXELS, guide / SBL_GUIDES_ACROSS);
}

// Maps a uniform point u in the unit square to a point distributed by the guide. Returns the weight of its ray,
// the inverse of the point's pdf, which keeps the expected value of the ray's light.
float sbl_guide(int guide, inout vec2 u) {
    const int band_texels = SBL_GUIDE_BANDS / 8, sector_texels = SBL_GUIDE_SECTORS / 8;
    const vec2 counts = vec2(SBL_GUIDE_BANDS, SBL_GUIDE_SECTORS);
    ivec2 from = sbl_guide_texel(guide);
    vec2 x = u * SBL_GUIDE_STEPS;
    vec3 band = sbl_guide_interval(from, band_texels, x.x);
    from.x += band_texels + int(band.z) * sector_texels;
    vec3 sector = sbl_guide_interval(from, sector_texels, x.y);
    vec2 begins = vec2(band.x, sector.x), widths = vec2(band.y, sector.y) - begins;
    u = (vec2(band.z, sector.z) + (x - begins) / widths) / counts;
    return SBL_GUIDE_STEPS / (widths.x * counts.x) * (SBL_GUIDE_STEPS / (widths.y * counts.y));
}

// Returns the pdf of the points that sbl_guide returns, at the point u of the unit square.
float sbl_guide_density(int guide, vec2 u) {
    const ivec2 counts = ivec2(SBL_GUIDE_BANDS, SBL_GUIDE_SECTORS);
    ivec2 bin = min(ivec2(u * vec2(counts)), counts - 1);
    ivec2 from = sbl_guide_texel(guide);
    float density = 1.0;
    for (int axis = 0; axis < 2; axis++) {
        float begins[2];  // where the interval of the bin and the next interval begin
        for (int k = 0; k < 2; k++) {
            int i = min(bin[axis] + k, counts[axis] - 1);
            uint two = texelFetch(sbl_guides, from + ivec2(i / 8, 0), 0)[i % 8 / 2];
            begins[k] = float(two >> (16 * (i & 1)) & 0xffffu);
        }
        if (bin[axis] == counts[axis] - 1) begins[1] = SBL_GUIDE_STEPS;
        density *= (begins[1] - begins[0]) * float(counts[axis]) / SBL_GUIDE_STEPS;
        from.x += (SBL_GUIDE_BANDS + bin.x * SBL_GUIDE_SECTORS) / 8;
    }
    return density;
}
#endif
