/* A small scene that uses every kind of input of sbl.h, and a struct that holds all channels of its picture. Include
   after scenes.h and gl_watch.h. */
#ifndef GL_SCENE_H
#define GL_SCENE_H

/* Of the channels, 21 have 3 floats per pixel, and 7 have 1. */
enum { SMALL_WIDTH = 11, SMALL_HEIGHT = 9, SMALL_PIXELS = SMALL_WIDTH * SMALL_HEIGHT,
    SMALL_FLOATS = 71 * SMALL_PIXELS };

typedef struct small_picture { float values[SMALL_FLOATS]; } small_picture;

/* Makes a textured floor, a box, a one-sided lamp above it, and a dim sky. Mesh SMALL_BOX is one side of the box. */
enum { SMALL_FLOOR = 0, SMALL_LAMP = 1, SMALL_BOX = 2 };

static inline void small_scene(test_scene *s) {
    static const unsigned char checks[2 * 2 * 3] = { 255, 200, 100, 30, 60, 90, 30, 90, 60, 200, 255, 100 };
    static const float glow[3] = { 1, 0.5f, 2 };
    int material, lamp;
    memset(s, 0, sizeof *s);
    material = scene_material(s, 0.8f, 0.7f, 0.6f);
    s->materials[material].albedo_texture = scene_texture(s, checks, sizeof checks, SBL_PIXELS_SRGB8, 2, 2, 3);
    lamp = scene_lamp(s, 6, 5, 4);
    s->materials[lamp].emission_texture = scene_texture(s, glow, sizeof glow, SBL_PIXELS_FLOAT, 1, 1, 3);
    s->materials[lamp].flags = SBL_MATERIAL_ONE_SIDED_EMISSION;
    scene_floor(s, material, 0, 2);
    scene_quad(s, lamp, -0.7f, 2, -0.7f, 0.7f, 2, -0.7f, 0.7f, 2, 0.7f, -0.7f, 2, 0.7f);
    scene_box(s, scene_material(s, 0.5f, 0.6f, 0.7f), -0.4f, 0.01f, -0.3f, 0.3f, 0.7f, 0.4f);
    scene_sky(s, 0.1f, 0.2f, 0.3f);
}

static sbl_backend small_backend = SBL_BACKEND_RASTER;
static sbl_mode small_mode = SBL_MODE_AMBIENT;

static inline sbl_picture_desc small_view(void) {
    sbl_picture_desc view = scene_view(SMALL_WIDTH, SMALL_HEIGHT, 50, 1.5f, 1.7f, 2.4f, 0, 0.3f, 0);
    view.tile = 4;
    view.options.sensor_size = 8;
    view.samples = 2;
    view.options.mode = small_mode;
    view.options.backend = small_backend;
    view.options.rays = 20;  /* more rays than one shader invocation traces */
    view.tone = SBL_TONE_AGX;
    view.auto_exposure = 1;
    return view;
}

/* Reads all channels of the finished picture, one after the other. Returns the result of the first channel that
   fails. */
static inline sbl_result small_read(sbl_context *context, small_picture *out) {
    int channel, at = 0;
    for (channel = 0; channel < SMALL_FLOATS; channel++) out->values[channel] = (float)NAN;
    for (channel = 0; channel < SBL_CHANNEL_COUNT; channel++) {
        int floats = SMALL_PIXELS * sbl_channel_components((sbl_channel)channel);
        sbl_result result;
        if (at + floats > SMALL_FLOATS) abort();
        result = sbl_read_channel(context, (sbl_channel)channel, out->values + at, (size_t)floats);
        if (result != SBL_SUCCESS) return result;
        at += floats;
    }
    for (; at < SMALL_FLOATS; at++) out->values[at] = 0;  /* the channels may use fewer floats */
    return SBL_SUCCESS;
}

static inline sbl_result small_render(sbl_context *context, const sbl_picture_desc *view, small_picture *out) {
    sbl_result result = sbl_render_picture(context, view);
    return result == SBL_SUCCESS ? small_read(context, out) : result;
}

static inline int small_same(const small_picture *a, const small_picture *b) { return memcmp(a, b, sizeof *a) == 0; }

/* Returns 0 if the picture contains NaN or infinity, or has a single colour. Such a picture is useless as a
   reference. */
static inline int small_plausible(const small_picture *p) {
    int i, differs = 0;
    for (i = 0; i < SMALL_FLOATS; i++) if (!(p->values[i] - p->values[i] == 0)) return 0;
    for (i = 3; i < 3 * SMALL_PIXELS; i++) differs |= p->values[i] != p->values[i % 3];
    return differs;
}

#endif
