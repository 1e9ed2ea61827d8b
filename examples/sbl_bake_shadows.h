/* The shadow mask of sbl_bake --shadow-mask stores the visibility of lights in the layout of the lightmap.
   sbl_bake_lightmap.h includes this file after sbl_bake_occlusion.h.

   The visibility of a light is R from this light alone, divided by the same R without shadows. Two bakes measure both
   at the same positions in each texel, so that the quotient is also right for spot cones, at horizons and with
   supersampling. Gutters and seams are computed after the division, from the visibility. If they were computed from R,
   a gutter would weight the visibilities of its neighbours by their brightness, and the seams of only one R would be
   corrected. */
#ifndef SBL_BAKE_SHADOWS_H
#define SBL_BAKE_SHADOWS_H

enum { SHADOW_LIGHTS = 4 };
static const char *const shadow_channels[SHADOW_LIGHTS] = { "R", "G", "B", "A" };

/* The mask that is being baked. */
typedef struct shadow_mask {
    tool_task *task;
    map_bake *bake;                /* the bake of the lightmap */
    const sbl_lightmap_desc *map;  /* description of the lightmap, whose layout the mask shares */
    sbl_lightmap_desc desc;        /* description of the bakes for the mask */
    sbl_light lights[SHADOW_LIGHTS];
    int count, bakes;              /* number of lights in the mask; number of bakes begun so far */
    image mask;                    /* four components; a component without a light is 1 */
    float *light, *ids;            /* for one light: R, 3 floats per texel; ids of charts, 0: no surface */
    size_t texels;
} shadow_mask;

static int write_shadow_exr(FILE *out, const void *what) {
    image mask = ((const shadow_mask *)what)->mask;
    mask.channels = shadow_channels;
    mask.is_half = 1;
    return picture_write(out, ".exr", &mask, SBL_CHANNEL_FINAL, 0);
}

static int write_shadow_png(FILE *out, const void *what) {
    const image *mask = &((const shadow_mask *)what)->mask;
    return map_write_bytes(out, mask, SHADOW_LIGHTS, map_row_of_fractions, mask, NULL, 0);
}

/* Makes the light with the index i white and switches the others off. */
static sbl_result choose_light(shadow_mask *m, int i) {
    const sbl_light *lights = m->task->scene->lights;
    int at, k;
    for (at = 0; at < m->count; at++) {
        const float *rgb = lights[at].intensity, mean = (rgb[0] + rgb[1] + rgb[2]) / 3;
        m->lights[at] = lights[at];
        m->lights[at].light_group = 0;
        for (k = 0; k < 3; k++) m->lights[at].intensity[k] = at != i ? 0 : mean > 0 ? mean : 1;
    }
    return sbl_set_lights(m->task->context, m->lights, m->count);
}

/* Bakes R from the light with the index i alone. */
static sbl_result bake_light(shadow_mask *m, int i) {
    sbl_context *context = m->task->context;
    sbl_result result = choose_light(m, i);
    bar_step(&m->bake->bar, 0.8, 1, 2 * m->count * m->bake->map.index + m->bakes++, 2 * m->count * map_count);
    if (result == SBL_SUCCESS) result = sbl_begin_lightmap(context, &m->desc);
    if (result == SBL_SUCCESS) result = work(context);
    if (result == SBL_SUCCESS) result = sbl_read_channel(context, SBL_CHANNEL_RADIANCE, m->light, 3 * m->texels);
    return result == SBL_SUCCESS ? sbl_read_channel(context, SBL_CHANNEL_ID, m->ids, m->texels) : result;
}

/* Bakes R of all lights. is_open: 0: with shadows; 1: no surface casts a shadow, and the visibility, the quotient of
   both R, is stored in the mask */
static sbl_result bake_lights(shadow_mask *m, int is_open) {
    const uint32_t flags = is_open ? SBL_MATERIAL_HIDDEN_FROM_SENSORS : 0;
    sbl_result result = set_dark_scene(m->task, 0, m->task->scene->lights, m->count, flags);
    size_t t;
    int i;
    for (i = 0; i < m->count && result == SBL_SUCCESS; i++) {
        result = bake_light(m, i);
        for (t = 0; t < m->texels && result == SBL_SUCCESS; t++) {
            const float *rgb = m->light + 3 * t, sum = rgb[0] + rgb[1] + rgb[2];
            float *visibility = m->mask.values + SHADOW_LIGHTS * t + i;
            if (!is_open) *visibility = sum;
            else *visibility = sum > 0 ? *visibility < sum ? *visibility / sum : 1 : 0;
        }
    }
    return result;
}

/* Adds gutters and seams to the visibility of the light with the index i. */
static sbl_result continue_light(shadow_mask *m, int i) {
    sbl_windows_desc desc;
    sbl_result result;
    size_t t;
    int k;
    for (t = 0; t < m->texels; t++)
        for (k = 0; k < 3; k++) m->light[3 * t + (size_t)k] = m->mask.values[SHADOW_LIGHTS * t + (size_t)i];
    memset(&desc, 0, sizeof desc);
    desc.lightmap = m->desc;
    desc.lightmap.gutter = m->map->gutter;
    desc.lightmap.seams = m->map->seams;
    desc.ids = m->ids;
    desc.light[0] = m->light;
    desc.texel_count = m->texels;
    result = sbl_begin_windows(m->task->context, &desc);
    if (result == SBL_SUCCESS) result = work(m->task->context);
    for (t = 0; t < m->texels && result == SBL_SUCCESS; t++) {
        const float visibility = m->light[3 * t];
        m->mask.values[SHADOW_LIGHTS * t + (size_t)i] = visibility > 0 ? visibility < 1 ? visibility : 1 : 0;
    }
    return result;
}

/* Describes the bakes for the mask. Each texel has its own sensors, with enough rays for soft shadows that are smooth
   in 8 bits. Interpolation and filter are off, because they would mix texels with much and little light; without them,
   the visibility is as exact where a light is dim as elsewhere. */
static void describe_shadows(shadow_mask *m) {
    static const int rays[3] = { 64, 256, 1024 };
    m->desc = *m->map;
    m->desc.options.mode = SBL_MODE_DIRECT;
    m->desc.options.backend = SBL_BACKEND_TRACE;
    m->desc.directional = m->desc.grouped = 0;
    m->desc.gutter = -1;
    m->desc.target_error = 0;
    m->desc.tile = 1;
    m->desc.filter_radius = -1;
    if (!given[RAYS]) m->desc.options.rays = rays[given[PRESET] ? common.preset : 1];
}

/* Prints which channel of the mask belongs to which light. */
static void tell_lights(const scene_file *file) {
    const int more = file->scene.light_count - SHADOW_LIGHTS;
    int i;
    for (i = 0; i < SHADOW_LIGHTS && i < file->scene.light_count && !given[QUIET]; i++)
        tell("shadow.png, channel %s: the light \"%s\"", shadow_channels[i], file->light_names[i]);
    if (more > 0 && !given[QUIET]) tell("shadow.png: %d more light%s no channel", more, more > 1 ? "s have" : " has");
}

/* Bakes the mask into m->mask. */
static sbl_result make_shadows(shadow_mask *m) {
    sbl_result result;
    size_t i;
    m->mask.width = m->mask.height = m->map->width;
    m->mask.components = SHADOW_LIGHTS;
    m->texels = (size_t)m->map->width * (size_t)m->map->height;
    m->mask.values = (float *)malloc(SHADOW_LIGHTS * m->texels * sizeof(float));
    m->light = (float *)malloc(3 * m->texels * sizeof(float));
    m->ids = (float *)malloc(m->texels * sizeof(float));
    if (!m->mask.values || !m->light || !m->ids) return SBL_ERROR_OUT_OF_MEMORY;
    for (i = 0; i < SHADOW_LIGHTS * m->texels; i++) m->mask.values[i] = 1;
    result = bake_lights(m, 0);
    if (result == SBL_SUCCESS) result = bake_lights(m, 1);
    for (i = 0; i < (size_t)m->count && result == SBL_SUCCESS; i++) result = continue_light(m, (int)i);
    return result;
}

/* Bakes and writes the mask in the layout of the map. Returns the exit status. */
static int bake_shadows(map_bake *b) {
    const int lights = b->task->file->scene.light_count, png = map_target(b->map.index, SHADOW_PNG);
    const int exr = map_target(b->map.index, SHADOW_EXR);
    shadow_mask m;
    int status = DONE;
    sbl_result result;
    memset(&m, 0, sizeof m);
    m.task = b->task;
    m.bake = b;
    m.map = &b->desc;
    m.count = lights < SHADOW_LIGHTS ? lights : SHADOW_LIGHTS;
    describe_shadows(&m);
    result = make_shadows(&m);
    clear_progress(&b->bar);
    if (result == SBL_UNFINISHED) status = stop("%s was not written", targets[png].name);
    else if (result != SBL_SUCCESS) status = fail_with(b->task->said, common.scene, result);
    if (status == DONE) status = keep_file(&m, png, write_shadow_png);
    if (status == DONE && targets[exr].name) status = keep_file(&m, exr, write_shadow_exr);
    free(m.mask.values);
    free(m.light);
    free(m.ids);
    return status;
}

#endif
