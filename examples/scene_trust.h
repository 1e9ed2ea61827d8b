/* Part of scene_file.h: the parent checks the pages that its child wrote.

   An attacker who controls the child can write anything into these pages, such as pointers into the memory of the
   parent, or functions for the parent to call. Therefore the parent uses only the fields that the converter sets, and
   only arrays that are completely inside the pages. sbl.h checks the values in the arrays, as for any host. */
#ifndef SCENE_TRUST_H
#define SCENE_TRUST_H

/* Returns 1 if an array is completely inside the pages. NULL is valid for an array without elements. */
static int scene__holds(const scene_file *file, const void *array, double count, size_t bytes) {
    const uintptr_t start = (uintptr_t)file, at = (uintptr_t)array;
    if (!array) return count == 0;
    return count >= 0 && at >= start + sizeof *file && at % 4 == 0 && at <= start + file->used &&
           count * (double)bytes <= (double)(start + file->used - at);
}

/* Checks a stream of `components` floats per vertex, or of indices, and resets its other fields. Returns 0 if it is not
   valid. */
static int scene__trust_stream(const scene_file *file, sbl_stream *s, int count, size_t components, sbl_type type) {
    const void *data = s->data;
    memset(s, 0, sizeof *s);
    s->data = data;
    s->type = type;
    return scene__holds(file, data, data ? count : 0, 4 * components);
}

static int scene__trust_mesh(const scene_file *file, sbl_mesh *m) {
    return scene__trust_stream(file, &m->positions, m->vertex_count, 3, SBL_FLOAT32) &&
           scene__trust_stream(file, &m->normals, m->vertex_count, 3, SBL_FLOAT32) &&
           scene__trust_stream(file, &m->texcoords, m->vertex_count, 2, SBL_FLOAT32) &&
           scene__trust_stream(file, &m->lightmap_texcoords, m->vertex_count, 2, SBL_FLOAT32) &&
           scene__trust_stream(file, &m->colors, m->vertex_count, 4, SBL_FLOAT32) &&
           scene__trust_stream(file, &m->indices, m->index_count, 1, SBL_UINT32);
}

static int scene__trust_texture(const scene_file *file, sbl_texture *t) {
    const int is_float = t->format == SBL_PIXELS_FLOAT;
    t->gl_texture = 0;
    t->stride = 0;
    if (!is_float && t->format != SBL_PIXELS_LINEAR8) t->format = SBL_PIXELS_SRGB8;
    return t->width > 0 && t->height > 0 && t->channels > 0 && t->channels <= 4 &&
           scene__holds(file, t->pixels, (double)t->width * t->height, (size_t)t->channels * (is_float ? 4 : 1));
}

static int scene__trust_name(const scene_file *file, const char *name) {
    const uintptr_t start = (uintptr_t)file, end = start + file->used, at = (uintptr_t)name;
    return at >= start && at < end && memchr(name, 0, end - at) != NULL;
}

static int scene__trust_map(const scene_file *file, int mesh) {
    const scene_file_place *p = &file->places[mesh];
    const int map = file->maps[mesh], is_mapped = file->scene.meshes[mesh].lightmap_texcoords.data != NULL;
    return (is_mapped ? map >= 0 && map < file->map_count : map == -1) &&
           isfinite(p->scale[0] + p->scale[1] + p->offset[0] + p->offset[1]);
}

/* Returns 1 if the arrays and the names are inside the pages, and counts and units are in their ranges. Fields that the
   converter never sets become 0. capacity: the size of the pages, as the parent knows it */
static int scene__trust(scene_file *file, size_t capacity) {
    const sbl_scene_desc in = file->scene;
    sbl_scene_desc *out = &file->scene;
    int i;
    file->capacity = capacity;
    for (i = 0; i < SCENE_FILE_KIND_COUNT; i++) if (file->simplified[i] < 0) return 0;
    if (file->map_count < 0 || file->map_size < 0 || file->map_size > SCENE__MOST_SIZE) return 0;
    if (!(file->unit >= 0 && file->unit < 1e9)) return 0;
    if (file->units < 0 || file->units >= SCENE_UNITS_COUNT) return 0;
    for (i = 0; i < SCENE_FILE_WARNINGS; i++) file->warnings[i][sizeof file->warnings[i] - 1] = 0;
    if (file->used < sizeof *file || file->used > capacity || file->warning_count < 0 ||
        file->read_count < 0 || file->read_count > SCENE_FILE_READ) return 0;
    memset(out, 0, sizeof *out);
    out->meshes = in.meshes;
    out->materials = in.materials;
    out->textures = in.textures;
    out->lights = in.lights;
    out->environment.picture = in.environment.picture;
    if (!scene__holds(file, in.meshes, in.mesh_count, sizeof *in.meshes) ||
        !scene__holds(file, in.materials, in.material_count, sizeof *in.materials) ||
        !scene__holds(file, in.textures, in.texture_count, sizeof *in.textures) ||
        !scene__holds(file, in.lights, in.light_count, sizeof *in.lights) ||
        !scene__holds(file, file->light_names, in.light_count, sizeof *file->light_names) ||
        !scene__holds(file, file->frames, file->frame_count, sizeof *file->frames) ||
        !scene__holds(file, file->maps, in.mesh_count, sizeof *file->maps) ||
        !scene__holds(file, file->places, in.mesh_count, sizeof *file->places) ||
        !scene__holds(file, file->names, in.mesh_count, sizeof *file->names)) return 0;
    out->mesh_count = in.mesh_count;
    out->material_count = in.material_count;
    out->texture_count = in.texture_count;
    out->light_count = in.light_count;
    for (i = 0; i < in.mesh_count; i++)
        if (!scene__trust_mesh(file, (sbl_mesh *)(uintptr_t)&in.meshes[i]) ||
            !scene__trust_name(file, file->names[i]) || !scene__trust_map(file, i)) return 0;
    for (i = 0; i < in.light_count; i++) if (!scene__trust_name(file, file->light_names[i])) return 0;
    for (i = 0; i < in.texture_count; i++)
        if (!scene__trust_texture(file, (sbl_texture *)(uintptr_t)&in.textures[i])) return 0;
    return !in.environment.picture.pixels || scene__trust_texture(file, &out->environment.picture);
}

#endif
