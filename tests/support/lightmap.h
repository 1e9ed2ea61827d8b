/* Helpers for tests of lightmaps: they make charts, bake, and read channels. Include after sbl.h, test.h, scenes.h and
   gl_watch.h. */
#ifndef LIGHTMAP_H
#define LIGHTMAP_H

#include "one_context.h"

static sbl_lightmap_desc map_of(int width, int height, sbl_mode mode) {
    sbl_lightmap_desc desc;
    memset(&desc, 0, sizeof desc);
    desc.width = width;
    desc.height = height;
    desc.options.mode = mode;
    return desc;
}

/* Returns a channel of the finished lightmap; the caller frees it. */
static float *channel_of(const sbl_lightmap_desc *desc, sbl_channel channel) {
    sbl_picture_desc view;
    memset(&view, 0, sizeof view);
    view.width = desc->width;
    view.height = desc->height;
    return scene_channel(context, &view, channel);
}

/* Bakes a lightmap and returns R, or NULL on failure. The caller frees it. */
static float *bake_stored(const test_scene *s, const sbl_lightmap_desc *desc, int bounce_samples) {
    sbl_scene_desc scene = scene_desc(s);
    sbl_result result;
    if (!use_scene(s)) { CHECK(0, "no context: %s", watch_last(&seen)); return NULL; }
    scene.max_bounce_cells = bounce_samples;
    CHECK(sbl_set_scene(context, &scene) == SBL_SUCCESS, "%s", watch_last(&seen));
    result = sbl_bake_lightmap(context, desc);
    CHECK(result == SBL_SUCCESS, "%s: %s", sbl_result_string(result), watch_last(&seen));
    return result == SBL_SUCCESS ? channel_of(desc, SBL_CHANNEL_RADIANCE) : NULL;
}

static inline float *bake(const test_scene *s, const sbl_lightmap_desc *desc) { return bake_stored(s, desc, 1024); }

static void uv_set(test_scene *s, sbl_mesh *mesh, const float *uv) {
    mesh->lightmap_texcoords.data = scene_copy(s, uv, 2 * mesh->vertex_count);
}

/* Maps the corners of a quad (texture coordinates 0 0, u 0, u v, 0 v) to a rectangle of the map: x0, y0, x1, y1. */
static void uv_rectangle(test_scene *s, sbl_mesh *quad, float x0, float y0, float x1, float y1) {
    const float uv[8] = { x0, y0, x1, y0, x1, y1, x0, y1 };
    uv_set(s, quad, uv);
}

#endif
