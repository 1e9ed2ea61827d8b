/* Implements --light-groups of sbl_bake: reads its list, and assigns a light group to each light, each emitting mesh
   and the sky of a scene file. Include after sbl.h, tool.h, scene_file.h and bake_parts.h. */
#ifndef LIGHT_GROUPS_H
#define LIGHT_GROUPS_H

#include <fnmatch.h>

/* The items of the list, in their order. If no item is named "rest" and some sources match no pattern, a further group
   "rest" holds them. */
typedef struct light_groups {
    bake_groups list;
    struct { char pattern[128]; int used; } items[SBL_MAX_LIGHT_GROUPS + 1];
    char error[256];
} light_groups;

/* Adds an item. Returns 0 and sets g->error if the name is not valid or there are too many groups. */
static int groups__add(light_groups *g, const char *name, size_t length, const char *pattern, size_t pattern_length) {
    int i;
    const int fits = length > 0 && length < BAKE_GROUP_NAME && strspn(name, bake_letters) >= length;
    if (!fits || pattern_length < 1 || pattern_length >= sizeof g->items[0].pattern) {
        snprintf(g->error, sizeof g->error, "\"%.*s\": a name has 1 to %d letters, digits, - and _, and a pattern has "
                 "1 to %d characters", (int)(length + 1 + pattern_length), name, BAKE_GROUP_NAME - 1,
                 (int)sizeof g->items[0].pattern - 1);
        return 0;
    }
    for (i = 0; i < g->list.count; i++)
        if (strlen(g->list.names[i]) == length && strncmp(g->list.names[i], name, length) == 0) {
            snprintf(g->error, sizeof g->error, "two groups have the name %s", g->list.names[i]);
            return 0;
        }
    if (g->list.count >= SBL_MAX_LIGHT_GROUPS) {
        snprintf(g->error, sizeof g->error, "there are more than %d groups", SBL_MAX_LIGHT_GROUPS);
        return 0;
    }
    memcpy(g->list.names[g->list.count], name, length);
    memcpy(g->items[g->list.count].pattern, pattern, pattern_length);
    g->list.count++;
    return 1;
}

/* Reads NAME=PATTERN,NAME,...; a NAME alone is also its pattern. Returns 0 and sets g->error if the list is wrong. */
static int groups_read(light_groups *g, const char *list) {
    memset(g, 0, sizeof *g);
    for (;;) {
        const size_t item = strcspn(list, ","), length = strcspn(list, ",=");
        const char *pattern = length < item ? list + length + 1 : list;
        if (!groups__add(g, list, length, pattern, length < item ? item - length - 1 : length)) return 0;
        if (!list[item]) return 1;
        list += item + 1;
    }
}

/* Returns the index of the group of a source: the first group whose pattern matches its name, or "rest". */
static int groups__find(light_groups *g, const char *name) {
    int i;
    for (i = 0; i < g->list.count; i++)
        if (fnmatch(g->items[i].pattern, name, 0) == 0) break;
    if (i == g->list.count)
        for (i = 0; i < g->list.count && strcmp(g->list.names[i], "rest") != 0; i++) {}
    if (i == g->list.count && g->list.count <= SBL_MAX_LIGHT_GROUPS) {  /* otherwise groups_assign reports the error */
        snprintf(g->list.names[i], sizeof g->list.names[i], "rest");
        snprintf(g->items[i].pattern, sizeof g->items[i].pattern, "rest");
        g->list.count++;
    }
    g->items[i].used++;
    return i;
}

/* Assigns groups to the sources of the scene. An emitting material that is used by meshes of several groups is copied
   for each of them. Returns 0 and sets g->error on failure. materials: receives the new list of materials, which the
   caller frees */
static int groups_assign(light_groups *g, scene_file *file, sbl_material **materials) {
    sbl_scene_desc *scene = &file->scene;
    sbl_mesh *meshes = (sbl_mesh *)scene->meshes;
    sbl_light *lights = (sbl_light *)scene->lights;
    const int most = scene->material_count * (SBL_MAX_LIGHT_GROUPS + 1);
    int *known = (int *)calloc((size_t)most, sizeof *known), i, k, count = scene->material_count;
    *materials = (sbl_material *)malloc((size_t)most * sizeof **materials);
    if (!known || !*materials) {
        free(known);
        snprintf(g->error, sizeof g->error, "out of memory");
        return 0;
    }
    memcpy(*materials, scene->materials, (size_t)count * sizeof **materials);
    for (i = 0; i < scene->mesh_count; i++) {
        const sbl_material *m = &scene->materials[meshes[i].material];
        int *at;
        if (!(m->emission[0] > 0) && !(m->emission[1] > 0) && !(m->emission[2] > 0)) continue;
        k = groups__find(g, file->names[i]);
        at = &known[meshes[i].material * (SBL_MAX_LIGHT_GROUPS + 1) + k];
        if (!*at) {
            (*materials)[count] = *m;
            (*materials)[count].light_group = k;
            *at = count++;
        }
        meshes[i].material = *at;
    }
    for (i = 0; i < scene->light_count; i++) lights[i].light_group = groups__find(g, file->light_names[i]);
    scene->sky_group = groups__find(g, "sky");
    free(known);
    if (g->list.count > SBL_MAX_LIGHT_GROUPS) {
        snprintf(g->error, sizeof g->error, "with the group \"rest\" there are more than %d groups",
                 SBL_MAX_LIGHT_GROUPS);
        return 0;
    }
    for (i = 0; i < g->list.count; i++)
        if (!g->items[i].used && strcmp(g->list.names[i], "rest") != 0) {
            snprintf(g->error, sizeof g->error, "no light, emitting mesh or sky has a name like \"%s\"",
                     g->items[i].pattern);
            return 0;
        }
    scene->materials = *materials;
    scene->material_count = count;
    scene->light_groups = g->list.count;
    return 1;
}

#endif
