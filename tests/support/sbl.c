/* The implementation as one object, which all programs share that do not use private names; see scripts/Makefile. */
#define SBL_IMPLEMENTATION
#ifndef _WIN32
  #define SBL_EGL
#endif
#include "../../sbl.h"
#include "inside.h"

float inside_cell_length(const sbl_context *context) { return context->core.scene.store.length; }

int inside_glow_count(const sbl_context *context) { return context->core.scene.bright.glow_count; }

float inside_farthest_offset(const sbl_context *context) {
    const sbl__refine *r = &context->picture.map.refine;
    float most = 0;
    int i;
    for (i = 0; i < r->width * r->height; i++) if (r->pixels[i].offset > most) most = r->pixels[i].offset;
    return most;
}

void inside_sample_offset(int sample, int samples, float offset[2]) { sbl__sample_offset(sample, samples, offset); }

uint16_t inside_to_half(float value) { return sbl__to_half(value); }

float inside_from_half(uint16_t half) { return sbl__from_half(half); }

uint64_t inside_saved_sum(const void *bytes, size_t count) { return sbl__hash_bytes(SBL__SAVED_SEED, bytes, count); }

int inside_gl_is_optional(const char *function) {
#define X(type, name, parameters) || strcmp(function, "gl" #name) == 0
    return 0 SBL__GL_OPTIONAL_FUNCTIONS(X);
#undef X
}

inside_weight inside_weigh_corners(int strips, float light) {
    enum { SIDE = 17 };
    static sbl__pixel pixels[SIDE * SIDE];
    inside_weight weight;
    sbl__spec spec;
    sbl__refine r;
    sbl__tile c;
    int i, k;
    memset(&spec, 0, sizeof spec);
    spec.looks = 16;
    memset(&r, 0, sizeof r);
    memset(&c, 0, sizeof c);
    memset(pixels, 0, sizeof pixels);
    sbl__looks_calibrate(&r);
    r.width = r.height = SIDE;
    r.pixels = pixels;
    r.target_error = 0.1f;
    r.luminance = r.smoothing = 1;
    r.spec = &spec;
    for (k = 0; k < 3; k++) r.weights[k] = r.mean[k] = 1;
    c.area.x[1] = c.area.y[1] = SIDE - 1;
    c.parent = -1;
    c.looks = 1;
    c.pixels = SIDE * SIDE;
    c.uncovered = strips ? 0.25f : 0;
    for (i = 0; i < SIDE * SIDE; i++) {
        sbl__pixel *p = &pixels[i];
        const int x = i % SIDE, y = i / SIDE;
        p->id = !strips || x < 4 ? 1 : x < 8 ? 2 : 3;
        p->position[0] = (float)x;
        p->position[1] = (float)y;
        p->position[2] = p->id == 1 ? 0 : 5;
        p->normal[2] = p->geometric_normal[2] = 1;
        if (x % (SIDE - 1) || y % (SIDE - 1)) continue;
        p->sensed = 1;
        p->looks = 1;
        p->variance = 100 * (double)light * (double)light;
        for (k = 0; k < 3; k++) p->radiance[k] = light;
    }
    r.tiles = &c;
    sbl__refine_weigh(&r, 0);
    weight.noise2 = c.noise2;
    weight.bias2 = c.bias2;
    weight.light = c.light;
    weight.split_gain = c.split_worth;
    return weight;
}

int inside_guard_units(void) { return SBL__GUARD_UNITS; }
