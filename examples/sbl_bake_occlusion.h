/* The maps of ambient occlusion and sky visibility of sbl_bake --ao. sbl_bake_lightmap.h includes this file after its
   functions that bake. */
#ifndef SBL_BAKE_OCCLUSION_H
#define SBL_BAKE_OCCLUSION_H

/* Errors are relative to this value. A target error of 0.5 % thus means an error of 0.005, about one step of the 8-bit
   values in the .png. */
#define OCCLUSION_MEAN 1.0f

enum { OCCLUSION_MAPS = 2 };

static int write_occlusion_exr(FILE *out, const void *what) {
    return picture_write(out, ".exr", (const image *)what, SBL_CHANNEL_FINAL, 0);
}

/* Writes visibilities as linear bytes, as glTF and engines expect for occlusion. */
static int write_occlusion_png(FILE *out, const void *what) {
    return map_write_bytes(out, (const image *)what, 1, map_row_of_fractions, what, NULL, 0);
}

/* Sets the scene without emission, environment map and light groups, under a sky of constant radiance. lights: the
   `count` lights that the scene keeps. flags: SBL_MATERIAL_ flags that all materials get in addition */
static sbl_result set_dark_scene(const tool_task *task, float sky, const sbl_light *lights, int count, uint32_t flags) {
    sbl_scene_desc scene = *task->scene;
    sbl_material *dark = (sbl_material *)malloc(sizeof *dark * ((size_t)scene.material_count + 1));
    sbl_light *own = (sbl_light *)malloc(sizeof *own * ((size_t)count + 1));
    sbl_result result = SBL_ERROR_OUT_OF_MEMORY;
    int i, k;
    for (i = 0; dark && i < scene.material_count; i++) {
        dark[i] = scene.materials[i];
        dark[i].light_group = 0;
        dark[i].flags |= flags;
        for (k = 0; k < 3; k++) dark[i].emission[k] = 0;
    }
    for (i = 0; own && i < count; i++) {
        own[i] = lights[i];
        own[i].light_group = 0;
    }
    scene.materials = dark;
    scene.lights = own;
    scene.light_count = count;
    scene.light_groups = scene.sky_group = 0;
    memset(&scene.environment, 0, sizeof scene.environment);
    for (k = 0; k < 3; k++) scene.sky[k] = sky;
    if (dark && own) result = sbl_set_scene(task->context, &scene);
    free(dark);
    free(own);
    return result;
}

/* Bakes a map of the dark scene and keeps its red channel, limited to 1. */
static sbl_result bake_occlusion_map(tool_task *task, const sbl_lightmap_desc *desc, image *map) {
    const size_t texels = (size_t)desc->width * (size_t)desc->height;
    sbl_result result = sbl_begin_lightmap(task->context, desc);
    size_t i;
    if (result == SBL_SUCCESS) result = work(task->context);
    if (result == SBL_SUCCESS) result = picture_read(task->context, desc->width, desc->height, SBL_CHANNEL_FINAL, map);
    for (i = 0; i < texels && result == SBL_SUCCESS; i++) {
        const float fraction = map->values[3 * i];
        map->values[i] = fraction < 1 ? fraction : 1;
    }
    map->components = 1;
    return result;
}

/* Writes a map of occlusion as .png, which host programs multiply with ambient light, and as .exr. Returns the exit
   status. */
static int keep_occlusion(const image *values, int png, int exr) {
    const int status = keep_file(values, png, write_occlusion_png);
    return status == DONE && targets[exr].name ? keep_file(values, exr, write_occlusion_exr) : status;
}

/* Bakes and writes the maps of ambient occlusion and of sky visibility, with the quality settings of the lightmap.
   Returns the exit status. */
static int bake_occlusion(map_bake *b) {
    tool_task *task = b->task;
    sbl_lightmap_desc black = b->desc;
    sbl_result result;
    int i, map, status = DONE;
    for (i = 0; i < 3; i++) black.mean_radiance[i] = OCCLUSION_MEAN;
    black.directional = black.grouped = 0;
    black.options.mode = SBL_MODE_DIRECT;
    result = set_dark_scene(task, 1, NULL, 0, 0);
    for (map = 0; map < OCCLUSION_MAPS && status == DONE; map++) {
        image values = { 0 };
        black.options.ray_length = map == 0 ? (float)options.ao : 0;
        const int png = map_target(b->map.index, map ? SKY_PNG : AO_PNG);
        bar_step(&b->bar, 0.6, 0.8, OCCLUSION_MAPS * b->map.index + map, OCCLUSION_MAPS * map_count);
        if (result == SBL_SUCCESS) result = bake_occlusion_map(task, &black, &values);
        if (result == SBL_UNFINISHED) status = stop("%s was not written", targets[png].name);
        else if (result != SBL_SUCCESS) status = fail_with(task->said, common.scene, result);
        if (status == DONE)
            status = keep_occlusion(&values, png, map_target(b->map.index, map ? SKY_EXR : AO_EXR));
        free(values.values);
    }
    clear_progress(&b->bar);
    return status;
}

#endif
