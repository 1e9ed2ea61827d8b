/* The lightmaps of sbl_bake. It bakes them at once, in windows or in parts, joins them, and writes them into a folder.
   sbl_bake.c includes this file after its options. */
#ifndef SBL_BAKE_LIGHTMAP_H
#define SBL_BAKE_LIGHTMAP_H

/* ---- the files in the output folder ---- */

/* The pictures of a map: its light with and without gutters, the harmonics of --directional, and the light groups. */
enum {
    MAP_LIGHT, MAP_ATLAS, MAP_SH, MAP_GROUPS = MAP_SH + 4, MAP_PICTURES = MAP_GROUPS + SBL_MAX_LIGHT_GROUPS
};

/* The files of a map. The file of picture p in format f has the index f * MAP_PICTURES + p. */
enum {
    ATLAS_PNG = MAP_FORMATS * MAP_PICTURES, OVERLAP, PARTIAL, AO_PNG, SKY_PNG, AO_EXR, SKY_EXR, SHADOW_PNG, SHADOW_EXR,
    MAP_FILES
};

/* The targets: first the files of the scene, then the files of each map (see map_target), then the textures. */
enum { GLTF = OWN_TARGETS, BIN, LIT_GLB, TABLE, MAPS };

static const char *const names[MAPS] = {
    [GLTF] = "scene.gltf", [BIN] = "scene.bin", [LIT_GLB] = "scene_lit.glb", [TABLE] = "maps.json"
};
static const char *const picture_names[MAP_GROUPS] = { "lightmap", "atlas", "sh_0", "sh_1", "sh_2", "sh_3" };
static const struct { const char *base, *ending; } other_names[MAP_FILES - ATLAS_PNG] = {
    { "atlas", ".png" }, { "overlap", ".png" }, { "lightmap", ".partial.pfm" }, { "ao", ".png" }, { "sky", ".png" },
    { "ao", ".exr" }, { "sky", ".exr" }, { "shadow", ".png" }, { "shadow", ".exr" }
};
static char *paths[TARGETS_MAX];
static int folder_is_new;  /* 1: this run created the folder */
static int map_count;      /* number of maps that this run bakes */
static int has_maps;       /* 1: the scene has several maps, even if this run bakes only one */

/* Returns the index of the target for one file of a map. */
static int map_target(int map, int file) { return MAPS + map * MAP_FILES + file; }

/* Returns the file name of a target without its folder. */
static const char *target_base(int target) {
    const char *const slash = strrchr(targets[target].name, '/');
    return slash ? slash + 1 : targets[target].name;
}

/* Returns the name of a file of a map without its folder. */
static const char *map_file(int map, int file) { return target_base(map_target(map, file)); }

/* Sets the target with the given index. folder: number of characters of common.output that name the folder. Returns the
   exit status. */
static int target_add(int index, size_t folder, const char *name) {
    if (index >= TARGETS_MAX)
        return fail("%s: it has too many textures and lightmaps; --map bakes one lightmap", common.scene);
    paths[index] = output__join(common.output, folder, name);
    if (!paths[index]) return fail("out of memory");
    output_find(&targets[index], paths[index]);
    if (target_count <= index) target_count = index + 1;
    return DONE;
}

/* Returns 1 if this run writes a picture of a map in a format. */
static int map_is_written(int format, int picture) {
    if (!options.formats.wanted[format]) return 0;
    if (picture >= MAP_GROUPS) return picture - MAP_GROUPS < groups.list.count;
    return picture < MAP_SH || (given[DIRECTIONAL] && map_holds_negative((map_format)format));
}

/* Returns 1 if this run may write a file of a map. */
static int file_is_written(int file) {
#ifndef SBL_RENDER_OPENEXR
    if (file == AO_EXR || file == SKY_EXR || file == SHADOW_EXR) return 0;
#endif
    if (file < ATLAS_PNG) return map_is_written(file / MAP_PICTURES, file % MAP_PICTURES);
    return file < AO_PNG || given[file < SHADOW_PNG ? AO : SHADOW_MASK];
}

/* Adds the files of a map to the targets. If there are several maps, the names get the index of the map before their
   ending. Returns the exit status. */
static int list_map(int map) {
    char name[BAKE_GROUP_NAME + 64], number[16] = "";
    int i, status = DONE;
    if (map_count > 1) snprintf(number, sizeof number, "_%d", map);
    for (i = 0; i < MAP_FILES && status == DONE; i++) {
        const int picture = i % MAP_PICTURES, is_group = i < ATLAS_PNG && picture >= MAP_GROUPS;
        const char *const base = i >= ATLAS_PNG ? other_names[i - ATLAS_PNG].base
                               : is_group ? groups.list.names[picture - MAP_GROUPS] : picture_names[picture];
        if (!file_is_written(i)) continue;
        snprintf(name, sizeof name, "%s%s%s%s", is_group ? "atlas_" : "", base, number,
                 i < ATLAS_PNG ? map_endings[i / MAP_PICTURES] : other_names[i - ATLAS_PNG].ending);
        status = target_add(map_target(map, i), strlen(common.output), name);
    }
    return status;
}

/* Creates the output folder and adds the files of the scene to the targets. Returns the exit status. */
static int find_files(void) {
    struct stat info, parts;
    int i, status = DONE;
    if (stat(common.output, &info) == 0 && !S_ISDIR(info.st_mode))
        return misuse("--output %s: this is not a folder; give another name", common.output);
    folder_is_new = stat(common.output, &info) != 0;
    if (given[JOIN] && !folder_is_new && stat(options.join, &parts) == 0 && parts.st_dev == info.st_dev &&
        parts.st_ino == info.st_ino)
        return misuse("--join %s: the map would be written among its parts; give another --output", options.join);
    if (folder_is_new && mkdir(common.output, 0777) != 0)
        return fail("%s: the folder cannot be created: %s; give another one", common.output, strerror(errno));
    targets_begin();
    for (i = GLTF; i < TABLE && status == DONE; i++)
        if (i != LIT_GLB || writes_lit()) status = target_add(i, strlen(common.output), names[i]);
    return status == DONE ? targets_check(target_count, given) : status;
}

/* Adds the files of the textures of the scene to the targets, from the index `first` on. Returns the exit status. */
static int find_textures(const scene_file *file, int first, size_t folder) {
    int i, status = DONE;
    for (i = 0; i < file->scene.texture_count && status == DONE; i++) {
        char name[GLTF_NAME];
        gltf_texture_name(name, i);
        status = target_add(first + i, folder, name);
    }
    return status;
}

/* Chooses and checks the maps to bake: all, or the map of --map. Returns the exit status. */
static int find_maps(scene_file *file) {
    int i, map, mapped = 0, last = file->map_count - 1;
    for (i = 0; i < file->scene.mesh_count; i++) mapped += file->maps[i] >= 0;
    if (!mapped)
        return fail("%s: no mesh has second texture coordinates (TEXCOORD_1); sbl_unwrap makes them", common.scene);
    for (map = given[MAP] ? options.map : 0; map <= (given[MAP] ? options.map : last); map++) {
        for (i = 0, mapped = 0; i < file->scene.mesh_count; i++) mapped += file->maps[i] == map;
        if (!mapped)
            return fail("%s: no mesh is in map %d; the maps of the scene are 0 to %d, and --map chooses one",
                        common.scene, map, last);
    }
    if (last > 0 && !given[MAP] && (given[PART] || given[JOIN]))
        return fail("%s: it has %d lightmaps, and %s works with one; choose it: --map 0 to --map %d", common.scene,
                    last + 1, table[given[PART] ? PART : JOIN].name, last);
    has_maps = last > 0;
    if (!options.lightmap) options.lightmap = file->map_size;  /* --lightmap auto */
    if (!options.lightmap)
        return fail("%s: it does not say how large its map is; give --lightmap a number of texels", common.scene);
    if (given[MAP]) scene_file_keep_map(file, options.map);
    map_count = file->map_count;
    return DONE;
}

/* Adds the files that depend on the content of the scene to the targets. Returns the exit status. */
static int find_more_files(scene_file *file) {
    int i, status = find_maps(file);
    if (status == DONE) status = assign_groups(file);
    if (status != DONE || given[PART]) return status;
    if (given[SHADOW_MASK] && file->scene.light_count < 1)
        return fail("%s: --shadow-mask: the file has no lights; emitting surfaces and the sky have no channel",
                    common.scene);
    if (map_count > 1) status = target_add(TABLE, strlen(common.output), names[TABLE]);
    for (i = 0; i < map_count && status == DONE; i++) status = list_map(i);
    if (status == DONE) status = find_textures(file, map_target(map_count, 0), strlen(common.output));
    return status == DONE ? targets_check(target_count, given) : status;
}

/* The facts about a map that the files of the scene need. */
typedef struct baked_map {
    double range;            /* range of rgbm; see map_file.h */
    int window_count;        /* 0: the map was not baked in windows */
    plan_folder folder;      /* folder of its windows; kept until all maps are baked, for --resume */
} baked_map;

/* The files of the scene, which refer to all maps. */
typedef struct map_scene {
    baked_map *baked;        /* one per map */
    gltf_map *maps;
    image *atlases;          /* contain values only if scene_lit.glb is written */
    lit_scene lit;
    gltf_file gltf;
    char extras[64];         /* text of gltf.extras */
    const scene_file *file;
    int texture;             /* index of the texture that is written next */
} map_scene;

typedef struct lightmap {
    int index;               /* index of this map, from 0, in map_scene.baked and .maps */
    image light, atlas;      /* light: R, 0 where there is no surface; atlas: R with gutters. Both may share one array,
                                which holds `light` until the windows are merged and `atlas` afterwards */
    image overlap;           /* has values only if charts overlap */
    image harmonics[4];      /* have values only with --directional */
    image groups[SBL_MAX_LIGHT_GROUPS];  /* have values only with --light-groups */
    map_source source;       /* the picture that is written next */
    double intensity;        /* irradiance for a linear value of 1 in atlas.png */
    map_scene *scene;
} lightmap;

static int write_map(FILE *out, const void *what) { return map_write(out, &((const lightmap *)what)->source); }
static int write_partial(FILE *out, const void *what) {
    const map_source s = { &((const lightmap *)what)->light, MAP_PFM, 0, 0 };
    return map_write(out, &s);
}
static int write_atlas_png(FILE *out, const void *what) {
    const lightmap *l = (const lightmap *)what;
    return picture_write(out, ".png", &l->atlas, SBL_CHANNEL_FINAL, log(atan(1.0) * 4 / l->intensity) / log(2.0));
}
static int write_overlap(FILE *out, const void *what) {
    return picture_write(out, ".png", &((const lightmap *)what)->overlap, SBL_CHANNEL_ALBEDO, 0);
}
static int write_lit(FILE *out, const void *what) { return lit_write(out, &((const map_scene *)what)->lit); }
static int write_scene(FILE *out, const void *what) { return gltf_write_json(out, &((const map_scene *)what)->gltf); }
static int write_scene_bin(FILE *out, const void *what) {
    return gltf_write_bin(out, &((const map_scene *)what)->gltf);
}
static int write_texture(FILE *out, const void *what) {
    const map_scene *s = (const map_scene *)what;
    return gltf_write_texture(out, &s->gltf, s->texture);
}

static int compare_floats(const void *a, const void *b) {
    const float x = *(const float *)a, y = *(const float *)b;
    return (x > y) - (x < y);
}

/* Returns the value of R that becomes white in 8 bits. A thousandth of the lit texels exceeds it, but it is at most
   eight times the mean of the lit texels. Returns 0 if memory runs out. */
static double bright(const image *light) {
    const size_t texels = (size_t)light->width * (size_t)light->height;
    float *most = (float *)malloc(texels * sizeof *most);
    size_t i, lit = 0;
    double result = 1, sum = 0;
    if (!most) return 0;
    for (i = 0; i < texels; i++) {
        const float *v = light->values + 3 * i, larger = v[0] > v[1] ? v[0] : v[1];
        most[lit] = larger > v[2] ? larger : v[2];
        sum += (double)most[lit];
        lit += most[lit] > 0;
    }
    qsort(most, lit, sizeof *most, compare_floats);
    if (lit) result = (double)most[lit - 1 - lit / 1000];
    if (lit && result > 8 * sum / (double)lit) result = 8 * sum / (double)lit;
    free(most);
    return result;
}

/* Reads R of the baked map, and sets texels without a surface to 0. */
static sbl_result read_light(sbl_context *context, lightmap *l, int size) {
    image id = { 0 };
    const size_t texels = (size_t)size * (size_t)size;
    sbl_result result = picture_read(context, size, size, SBL_CHANNEL_RADIANCE, &l->light);
    size_t i;
    if (result == SBL_SUCCESS) result = picture_read(context, size, size, SBL_CHANNEL_ID, &id);
    for (i = 0; i < texels && result == SBL_SUCCESS; i++)
        if (!(id.values[i] > 0)) l->light.values[3 * i] = l->light.values[3 * i + 1] = l->light.values[3 * i + 2] = 0;
    free(id.values);
    return result;
}

/* If triangles share texels, makes l->overlap: shared texels are red, other used texels grey. */
static sbl_result read_overlap(sbl_context *context, lightmap *l, int size) {
    image others = { 0 }, *shown = &l->overlap;
    const size_t texels = (size_t)size * (size_t)size;
    sbl_result result = picture_read(context, size, size, SBL_CHANNEL_OVERLAP, &others);
    size_t i;
    int any = 0;
    for (i = 0; i < texels && result == SBL_SUCCESS; i++) any |= others.values[i] > 0;
    if (any) result = picture_read(context, size, size, SBL_CHANNEL_NORMAL, shown);
    for (i = 0; i < texels && any && result == SBL_SUCCESS; i++) {
        float *v = shown->values + 3 * i;
        const float there = v[0] * v[0] + v[1] * v[1] + v[2] * v[2] > 0 ? 0.3f : 0;
        const int shared = others.values[i] > 0;
        v[0] = shared ? 1 : there;
        v[1] = v[2] = shared ? 0 : there;
    }
    if (!any || result != SBL_SUCCESS) { free(shown->values); shown->values = NULL; }
    free(others.values);
    return result;
}

/* Writes one target. Returns the exit status. */
static int keep_file(const void *what, int target, output_writer write) {
    if (interrupted) return stop("%s was not written", targets[target].name);
    if (target_write(&targets[target], write, what, 0)) return DONE;
    return interrupted ? stop("%s was not written", targets[target].name) : fail_to_write(targets[target].name);
}

/* Writes the pictures of a map with the indices from `first` to `last` in all formats. Returns the exit status. */
static int keep_maps(lightmap *l, int first, int last) {
    int format, k, status = DONE;
    for (format = 0; format < MAP_FORMATS; format++)
        for (k = first; k <= last && status == DONE; k++) {
            if (!map_is_written(format, k)) continue;
            l->source.map = k == MAP_LIGHT  ? &l->light :
                            k == MAP_ATLAS  ? &l->atlas :
                            k >= MAP_GROUPS ? &l->groups[k - MAP_GROUPS] : &l->harmonics[k - MAP_SH];
            l->source.format = (map_format)format;
            l->source.exact = options.formats.exact;
            status = keep_file(l, map_target(l->index, format * MAP_PICTURES + k), write_map);
        }
    return status;
}

/* Computes the range of rgbm and the intensity of atlas.png, and meters R for scene_lit.glb. Returns 0 if memory runs
   out. */
static int survey_light(lightmap *l) {
    map_survey s = { 0, 0, 0 };
    map_survey_of(&s, &l->light);
    l->source.range = l->scene->baked[l->index].range = map_rgbm_range(s.most);
    l->intensity = l->scene->maps[l->index].intensity = atan(1.0) * 4 * bright(&l->light);
    return l->intensity > 0 && lit_meter(&l->scene->lit, &l->light);
}

/* Warns about values that the chosen formats cannot store, and prints how to decode rgbm. */
static void tell_formats(const lightmap *l) {
    const int halves = (options.formats.wanted[MAP_EXR] && !options.formats.exact) || options.formats.wanted[MAP_KTX2];
    map_survey s = { 0, 0, 0 };
    int k;
    if (given[QUIET]) return;
    map_survey_of(&s, &l->atlas);
    for (k = 0; k < 4 && l->harmonics[k].values; k++) map_survey_of(&s, &l->harmonics[k]);
    if (s.strange)
        warn("%.0f values of the map are not finite; the files hold 0 or the largest value of their format instead",
             (double)s.strange);
    if (halves && s.above_half)
        warn("%.0f values of the map are above 65504, the largest 16-bit float, up to %.3g, and are lowered to it; "
             "--formats exr32 keeps them", (double)s.above_half, (double)s.most);
    if (halves && s.most > 0 && s.most < 64 * MAP_HALF_MIN)
        warn("the map is too dark for 16-bit floats: its largest value is %.3g; --formats exr32 keeps all digits",
             (double)s.most);
    if (options.formats.wanted[MAP_RGBM])
        fprintf(stderr, TOOL_NAME ": range of rgbm: %.9g; R = (%.9g * alpha * rgb)^2 with linear bytes\n",
                l->source.range, l->source.range);
}

/* Removes a file of an earlier bake in the same folder that would be wrong about this one. */
static void remove_old(const char *name) {
    struct stat info;
    if (stat(name, &info) == 0 && S_ISREG(info.st_mode)) unlink(name);
}

/* Writes the files of a map. group: 0: those that show l->light; 1: all others. Returns the exit status. */
static int keep_files(lightmap *l, int group) {
    int status;
    if (!group) return survey_light(l) ? keep_maps(l, MAP_LIGHT, MAP_LIGHT) : fail("out of memory");
    tell_formats(l);
    status = keep_maps(l, MAP_ATLAS, MAP_PICTURES - 1);
    if (status == DONE) status = keep_file(l, map_target(l->index, ATLAS_PNG), write_atlas_png);
    if (status == DONE && l->overlap.values) status = keep_file(l, map_target(l->index, OVERLAP), write_overlap);
    else if (status == DONE) remove_old(targets[map_target(l->index, OVERLAP)].name);
    return status;
}

/* ---- the files of the scene ---- */

/* Sets the fields that do not depend on the baked maps. Returns 0 if memory runs out. */
static int scene_begin(map_scene *s, const scene_file *file) {
    const size_t count = (size_t)map_count + 1;
    int i;
    s->file = file;
    s->baked = (baked_map *)calloc(count, sizeof *s->baked);
    s->maps = (gltf_map *)calloc(count, sizeof *s->maps);
    s->atlases = (image *)calloc(count, sizeof *s->atlases);
    if (!s->baked || !s->maps || !s->atlases) return 0;
    for (i = 0; i < map_count && !given[PART]; i++) s->maps[i].name = target_base(map_target(i, ATLAS_PNG));
    s->gltf.scene = s->lit.scene = &file->scene;
    s->gltf.names = s->lit.names = file->names;
    s->gltf.map_of = s->lit.maps = file->maps;
    s->gltf.map_count = s->lit.map_count = map_count;
    s->gltf.bin = names[BIN];
    s->gltf.maps = s->maps;
    s->lit.atlases = s->atlases;
    s->lit.cancel = &interrupted;
    return 1;
}

static void scene_end(map_scene *s) {
    int i;
    lit_free(&s->lit);
    for (i = 0; i < map_count && s->atlases; i++) free(s->atlases[i].values);
    free(s->atlases);
    free(s->baked);
    free(s->maps);
}

/* Makes and writes scene_lit.glb. Returns the exit status. */
static int keep_lit(map_scene *s) {
    lit_scene *l = &s->lit;
    if (!writes_lit()) return DONE;
    l->size = given[LIT] ? options.lit : lit_size(l->scene, options.lightmap, (double)s->file->memory / 4);
    l->stops = lit_stops(l);
    if (!isnan(options.stops)) l->stops = options.stops;
    if ((!isnan(options.stops) || lit_spare(l)) && lit_make(l)) return keep_file(s, LIT_GLB, write_lit);
    return fail("out of memory: %s needs %.0f MB; --lit 0 leaves it out", names[LIT_GLB],
                1e-6 * LIT_BYTES * l->size * l->size);
}

/* Writes a JSON list of the files that hold a picture of a map, one per format. */
static void put_files(FILE *out, int map, int picture) {
    int format, count = 0;
    fputc('[', out);
    for (format = 0; format < MAP_FORMATS; format++)
        if (map_is_written(format, picture))
            fprintf(out, "%s\"%s\"", count++ ? ", " : "", map_file(map, format * MAP_PICTURES + picture));
    fputc(']', out);
}

/* Writes the members of a map in the table that name its files. */
static void put_map(FILE *out, int map) {
    static const int others[] = { AO_PNG, SKY_PNG, SHADOW_PNG };
    int i;
    fprintf(out, "\"atlas\": ");
    put_files(out, map, MAP_ATLAS);
    for (i = 0; i < 4 && given[DIRECTIONAL]; i++) {
        fprintf(out, "%s", i ? ", " : ", \"sh\": [");
        put_files(out, map, MAP_SH + i);
    }
    if (given[DIRECTIONAL]) fputc(']', out);
    for (i = 0; i < groups.list.count; i++) {
        fprintf(out, "%s", i ? ", " : ", \"groups\": {");
        gltf__put_name(out, groups.list.names[i]);
        fprintf(out, ": ");
        put_files(out, map, MAP_GROUPS + i);
    }
    if (groups.list.count) fputc('}', out);
    for (i = 0; i < (int)(sizeof others / sizeof *others); i++)
        if (file_is_written(others[i]))
            fprintf(out, ", \"%s\": \"%s\"", other_names[others[i] - ATLAS_PNG].base, map_file(map, others[i]));
}

/* Writes maps.json: the maps, and the nodes whose meshes are in them. */
static int write_table(FILE *out, const void *what) {
    const map_scene *s = (const map_scene *)what;
    const scene_file *f = s->file;
    int i, count = 0, last = -1;
    fprintf(out, "{\n  \"size\": %d,\n  \"maps\": [", options.lightmap);
    for (i = 0; i < map_count; i++) {
        fprintf(out, "%s\n    {", i ? "," : "");
        put_map(out, i);
        fprintf(out, ", \"png\": \"%s\", \"intensity\": %.7g", s->maps[i].name, s->maps[i].intensity);
        if (options.formats.wanted[MAP_RGBM]) fprintf(out, ", \"rgbm_range\": %.9g", s->baked[i].range);
        fputc('}', out);
    }
    fprintf(out, "\n  ],\n  \"nodes\": [");
    for (i = 0; i < f->scene.mesh_count; i++) {
        const scene_file_place *p = &f->places[i];
        if (f->maps[i] < 0 || (p->node >= 0 && p->node == last)) continue;  /* a node with several meshes */
        last = p->node;
        fprintf(out, "%s\n    {\"name\": ", count++ ? "," : "");
        gltf__put_name(out, f->names[i]);
        if (p->node >= 0) fprintf(out, ", \"node\": %d", p->node);
        fprintf(out, ", \"map\": %d, \"scale\": [%.9g, %.9g], \"offset\": [%.9g, %.9g]}", f->maps[i],
                (double)p->scale[0], (double)p->scale[1], (double)p->offset[0], (double)p->offset[1]);
    }
    fprintf(out, "\n  ]\n}\n");
    return 1;
}

/* Writes the files of the scene, after all maps. Returns the exit status. */
static int keep_scene(map_scene *s) {
    char old_table[PATH_MAX];
    int i, status = DONE;
    snprintf(s->extras, sizeof s->extras, "{\"rgbm_range\": %.9g}", s->baked[0].range);
    if (options.formats.wanted[MAP_RGBM] && map_count == 1) s->gltf.extras = s->extras;  /* else in maps.json */
    for (i = 0; i < s->file->scene.texture_count && status == DONE; i++) {
        s->texture = i;
        status = keep_file(s, map_target(map_count, i), write_texture);
    }
    if (status == DONE) status = keep_lit(s);
    if (status == DONE && map_count > 1) status = keep_file(s, TABLE, write_table);
    if (status == DONE && map_count == 1 && !given[MAP]) {
        snprintf(old_table, sizeof old_table, "%s/%s", common.output, names[TABLE]);
        remove_old(old_table);
    }
    if (status == DONE) status = keep_file(s, BIN, write_scene_bin);
    return status == DONE ? keep_file(s, GLTF, write_scene) : status;
}

/* ---- baking ---- */

/* A lightmap that is being baked, with its description and its windows. */
typedef struct map_bake {
    tool_task *task;
    progress bar;
    sbl_lightmap_desc desc;
    windows windows;
    image window;            /* the window that was baked last; its components are named in map_channels */
    lightmap map;
    int *meshes;             /* indices of the meshes in the map */
    map_scene scene;
} map_bake;

/* Sets the range of the progress bar to the step with the index `step`. The `steps` steps divide the range from `from`
   to `to` of the whole work. */
static void bar_step(progress *bar, double from, double to, int step, int steps) {
    bar->from = from + (to - from) * step / steps;
    bar->to = from + (to - from) * (step + 1) / steps;
}

/* Describes the map b->map.index for sbl_begin_lightmap. */
static void describe_lightmap(map_bake *b) {
    const scene_file *file = b->task->file;
    sbl_lightmap_desc *desc = &b->desc;
    int i;
    memset(desc, 0, sizeof *desc);
    for (i = 0; i < file->scene.mesh_count; i++)
        if (file->maps[i] == b->map.index) b->meshes[desc->mesh_count++] = i;
    desc->meshes = b->meshes;
    desc->width = desc->height = options.lightmap;
    if (given[GUTTER]) desc->gutter = (int)zero_or(options.gutter);
    desc->options = common_options(given, &b->bar);
    desc->target_error = (float)options.target_error;
    if (has_maps) desc->max_bounce_cells = -1;  /* runs with other maps of the scene must make the same store */
    desc->directional = given[DIRECTIONAL];
    desc->grouped = given[LIGHT_GROUPS];
    desc->supersample = options.supersample;
    desc->tile = common.tile;
    if (given[THRESHOLD]) desc->threshold = zero_or(common.threshold);
    if (given[FACET_LIMIT]) desc->facet_limit = zero_or(options.facet_limit);
    if (given[FILTER_RADIUS]) desc->filter_radius = (int)zero_or(common.filter_radius);
}

/* Saves R of an unfinished lightmap after a signal. Returns the exit status. */
static int save_partial(map_bake *b) {
    output_file *target = &targets[map_target(b->map.index, PARTIAL)];
    const sbl_result result = read_light(b->task->context, &b->map, b->desc.width);
    if (result == SBL_UNFINISHED) return stop("there is no light yet");
    if (result == SBL_SUCCESS && target_write(target, write_partial, &b->map, 1))
        return stop("the unfinished lightmap (%.0f %%) is in %s",
                    floor(100 * (double)sbl_progress(b->task->context)), target->name);
    return stop("the unfinished lightmap cannot be written to %s: %s", target->name, why_not_written());
}

/* Bakes the map at once and writes its files. Returns the exit status. */
static int bake_whole(map_bake *b, double *seconds) {
    sbl_context *context = b->task->context;
    lightmap *l = &b->map;
    const int size = b->desc.width;
    sbl_result result = sbl_begin_lightmap(context, &b->desc);
    int i, status;
    if (result == SBL_SUCCESS) result = work_to_save(context);
    clear_progress(&b->bar);
    *seconds = now() - b->task->start;
    if (result == SBL_UNFINISHED) return save_partial(b);
    if (result == SBL_SUCCESS) result = read_light(context, l, size);
    if (result == SBL_SUCCESS) result = picture_read(context, size, size, SBL_CHANNEL_FINAL, &l->atlas);
    for (i = 0; i < 4 && given[DIRECTIONAL] && result == SBL_SUCCESS; i++)
        result = picture_read(context, size, size, (sbl_channel)(SBL_CHANNEL_SH_0 + i), &l->harmonics[i]);
    for (i = 0; i < groups.list.count && result == SBL_SUCCESS; i++)
        result = picture_read(context, size, size, (sbl_channel)(SBL_CHANNEL_GROUP_0 + i), &l->groups[i]);
    if (result == SBL_SUCCESS) result = read_overlap(context, l, size);
    if (result != SBL_SUCCESS) return fail_with(b->task->said, common.scene, result);
    status = keep_files(l, 0);
    return status == DONE ? keep_files(l, 1) : status;
}

/* ---- baking in windows ---- */

/* The components of the .exr file of a window: R; 1 where there is a surface and 0 elsewhere; the number of further
   triangles that overlap the texel; then three components for each layer, that is each harmonic of --directional or
   each group of --light-groups. */
enum { MAP_ALPHA = 3, MAP_OVERLAP, MAP_PLAIN };
#define MAP_COLORS(name) name ".R", name ".G", name ".B"
static const char *const map_channels[2][MAP_PLAIN + 3 * SBL_MAX_LIGHT_GROUPS] = {
    { "R", "G", "B", "A", "overlap", MAP_COLORS("sh_0"), MAP_COLORS("sh_1"), MAP_COLORS("sh_2"), MAP_COLORS("sh_3") },
    { "R", "G", "B", "A", "overlap", MAP_COLORS("group_0"), MAP_COLORS("group_1"), MAP_COLORS("group_2"),
      MAP_COLORS("group_3"), MAP_COLORS("group_4"), MAP_COLORS("group_5"), MAP_COLORS("group_6"),
      MAP_COLORS("group_7") }
};

/* Returns the number of layers in addition to R. */
static int map_layers(void) { return given[DIRECTIONAL] ? 4 : groups.list.count; }

static int map_components(void) { return MAP_PLAIN + 3 * map_layers(); }

/* Returns a hash of the scene and of the lightmap_texcoords of the map, which sbl_scene_fingerprint does not
   include. */
static unsigned long long map_hash(const map_bake *b) {
    const sbl_scene_desc *scene = &b->task->file->scene;
    const uint64_t fingerprint = sbl_scene_fingerprint(b->task->context);
    unsigned long long hash = plan_hash(PLAN_HASH_START, &fingerprint, sizeof fingerprint);
    int i;
    for (i = 0; i < scene->mesh_count; i++) {
        const sbl_mesh *m = &scene->meshes[i];
        if (b->task->file->maps[i] == b->map.index)
            hash = plan_hash(hash, m->lightmap_texcoords.data, 2 * sizeof(float) * (size_t)m->vertex_count);
    }
    return hash;
}

/* Sets the facts that all windows of this map share, except those that look_at_map finds. */
static void find_map_facts(map_bake *b) {
    static const int without[] = { OUTPUT, STATS, STORE, STORE_REPLACE, QUIET, VERBOSE, ALLOW_PATH, MEMORY, READ_TIME,
                                   LIGHTMAP, GUTTER, PART, PLAN, JOIN, RESUME, FORMATS, LIT,
                                   LIT_EXPOSURE, -1 };
    const sbl_context *context = b->task->context;
    plan *p = &b->windows.work;
    plan_fact(p, FACT_VERSION, "%s", sbl_version());
    plan_fact(p, FACT_SCENE, "%016llx", map_hash(b));
    plan_fact(p, FACT_CAMERA, "%s", "");
    plan_options_fact(p, table, OPTION_COUNT, given, without);
    plan_fact(p, FACT_CHANNEL, "lightmap");
    plan_fact(p, FACT_SIZE, "%dx%d", options.lightmap, options.lightmap);
    plan_fact(p, FACT_EXPOSURE, "0");
    plan_fact(p, FACT_RENDERER, "%s", sbl_query_capabilities(context).renderer);
    plan_fact(p, FACT_PART, "%s", "");
}

/* Bakes a small map to find the mean, the price, the cells and, if cost is not NULL, the cost. Returns the exit
   status. */
static int look_at_map(void *user, plan_cost *cost) {
    map_bake *b = (map_bake *)user;
    const int across = options.lightmap * (options.supersample ? options.supersample : 1);
    const double shrink = plan_small(across);
    sbl_lightmap_desc small = b->desc;
    sbl_result result;
    small.width = small.height = (int)ceil(across / shrink);
    small.supersample = 1;
    small.directional = small.grouped = 0;
    small.gutter = -1;
    memset(small.window, 0, sizeof small.window);
    result = sbl_begin_lightmap(b->task->context, &small);
    if (result == SBL_SUCCESS) result = windows_look(&b->windows, shrink, cost);
    if (result == SBL_UNFINISHED) return stop("there is no light yet");
    return result == SBL_SUCCESS ? DONE : fail_with(b->task->said, common.scene, result);
}

static void use_map_facts(void *user) {
    map_bake *b = (map_bake *)user;
    sbl_picture_desc picture;
    memset(&picture, 0, sizeof picture);
    plan_use(&b->windows.work, &picture);
    memcpy(b->desc.mean_radiance, picture.mean_radiance, sizeof picture.mean_radiance);
    b->desc.price = picture.price;
    b->desc.look_rays = picture.look_rays;
    b->desc.max_bounce_cells = picture.max_bounce_cells;
}

static double map_window_bytes(const void *user, const int window[4]) {
    const map_bake *b = (const map_bake *)user;
    sbl_lightmap_desc desc = b->desc;
    memcpy(desc.window, window, sizeof desc.window);
    return (double)sbl_lightmap_bytes(b->task->context, &desc) + 4.0 * (map_components() + 3) * window[2] * window[3];
}

/* Copies a channel of the baked window to the components of b->window from the index `at` on. */
static sbl_result read_component(map_bake *b, sbl_channel channel, int at) {
    image one = { 0 }, *to = &b->window;
    const sbl_result result = picture_read(b->task->context, to->width, to->height, channel, &one);
    const size_t texels = (size_t)to->width * (size_t)to->height;
    size_t i;
    int k;
    for (i = 0; i < texels && result == SBL_SUCCESS; i++)
        for (k = 0; k < one.components; k++) {
            const float value = one.values[i * (size_t)one.components + (size_t)k];
            to->values[i * (size_t)to->components + (size_t)(at + k)] = channel == SBL_CHANNEL_ID ? value > 0 : value;
        }
    free(one.values);
    return result;
}

/* Bakes a window into b->window. */
static sbl_result bake_window(void *user, const int window[4]) {
    map_bake *b = (map_bake *)user;
    image *out = &b->window;
    sbl_result result;
    int k;
    memcpy(b->desc.window, window, sizeof b->desc.window);
    free(out->values);
    out->values = NULL;
    result = sbl_begin_lightmap(b->task->context, &b->desc);
    if (result == SBL_SUCCESS) result = work(b->task->context);
    clear_progress(&b->bar);
    if (result != SBL_SUCCESS) return result;
    memcpy(out->at, window, sizeof out->at);
    out->width = window[2];
    out->height = window[3];
    out->full[0] = out->full[1] = options.lightmap;
    out->components = map_components();
    out->channels = map_channels[given[LIGHT_GROUPS]];
    out->facts = b->windows.work.facts;
    out->values = (float *)malloc((size_t)out->width * (size_t)out->height * (size_t)out->components * sizeof(float));
    if (!out->values) return SBL_ERROR_OUT_OF_MEMORY;
    result = read_component(b, SBL_CHANNEL_RADIANCE, 0);
    if (result == SBL_SUCCESS) result = read_component(b, SBL_CHANNEL_ID, MAP_ALPHA);
    if (result == SBL_SUCCESS) result = read_component(b, SBL_CHANNEL_OVERLAP, MAP_OVERLAP);
    for (k = 0; k < map_layers() && result == SBL_SUCCESS; k++)
        result = read_component(b, (sbl_channel)((given[DIRECTIONAL] ? SBL_CHANNEL_SH_0 : SBL_CHANNEL_GROUP_0) + k),
                                MAP_PLAIN + 3 * k);
    return result;
}

static int write_window(FILE *out, const void *what) {
    return picture_write(out, ".exr", &((const map_bake *)what)->window, SBL_CHANNEL_FINAL, 0);
}

/* ---- joining windows ---- */

/* The complete map, into which the windows are joined. */
typedef struct joined_map {
    float *light[1 + SBL_MAX_LIGHT_GROUPS];  /* R and the layers, with 3 floats per texel */
    float *alpha;                 /* 1 where there is a surface */
    unsigned char *overlap;       /* per texel: 1 if several triangles cover it */
    int any_overlap, shown;       /* shown: number of texels with a surface */
} joined_map;

/* Copies a band of rows, starting at texel `first`, to the arrays of the map. */
static void spread_band(joined_map *j, const float *band, size_t first, size_t texels) {
    const size_t n = (size_t)map_components();
    size_t i;
    int k;
    for (i = first; i < first + texels; i++, band += n) {
        memcpy(j->light[0] + 3 * i, band, 12);
        j->alpha[i] = band[MAP_ALPHA];
        j->shown += band[MAP_ALPHA] > 0;
        j->overlap[i] = band[MAP_OVERLAP] > 0;
        j->any_overlap |= j->overlap[i];
        for (k = 1; k <= map_layers(); k++) memcpy(j->light[k] + 3 * i, band + MAP_PLAIN + 3 * (k - 1), 12);
    }
}

/* Returns DONE if --memory suffices to join the complete map; otherwise reports that it does not and returns the exit
   status. */
static int check_memory(const map_bake *b) {
    const double size = options.lightmap, most = (double)b->task->file->memory;
    const double own = 42.0 + 12 * map_layers();                   /* bytes per texel of joined_map and its gutters */
    const double others = writes_lit() ? 12.0 * (map_count - 1) : 0;  /* per texel: atlases for scene_lit.glb */
    const double bytes = (own + others) * size * size;
    if (bytes <= most) return DONE;
    return fail("the map of %.0f x %.0f texels needs about %.0f MB to be joined, and --memory allows %.0f MB; give "
                "more --memory, or make parts (--part) and join them on a larger machine", size, size, bytes / 1e6,
                most / 1e6);
}

/* Allocates the arrays of the map and reads the windows into them. Returns the exit status. */
static int read_windows(joined_map *j, picture_parts *parts) {
    const int size = options.lightmap, region[4] = { 0, 0, size, size };
    const size_t texels = (size_t)size * (size_t)size;
    float *band = (float *)malloc((size_t)size * PARTS_BAND * (size_t)map_components() * sizeof *band);
    int y, k, ok = band != NULL;
    j->alpha = (float *)malloc(texels * sizeof *j->alpha);
    j->overlap = (unsigned char *)malloc(texels);
    ok = ok && j->alpha && j->overlap;
    for (k = 0; k <= map_layers(); k++) ok = (j->light[k] = (float *)malloc(12 * texels)) != NULL && ok;
    if (!ok) {
        free(band);
        return fail("out of memory: joining needs the complete map of %d x %d texels in memory", size, size);
    }
    for (y = 0; y < size && ok && !interrupted; y += PARTS_BAND) {
        const int rows = size - y < PARTS_BAND ? size - y : PARTS_BAND;
        ok = parts_band(parts, region, y, rows, band);
        if (ok) spread_band(j, band, (size_t)y * (size_t)size, (size_t)rows * (size_t)size);
    }
    free(band);
    if (interrupted) return stop("nothing was written");
    return ok ? DONE : fail("%s", parts->list.error);
}

/* Makes the picture of overlapping triangles, if any overlap. Returns 0 if memory runs out. */
static int show_overlap(const joined_map *j, image *out) {
    const size_t texels = (size_t)options.lightmap * (size_t)options.lightmap;
    size_t i;
    if (!j->any_overlap) return 1;
    out->width = out->height = options.lightmap;
    out->components = 3;
    out->values = (float *)malloc(12 * texels);
    for (i = 0; i < texels && out->values; i++) {
        float *v = out->values + 3 * i;
        v[0] = j->overlap[i] ? 1 : j->alpha[i] > 0 ? 0.3f : 0;
        v[1] = v[2] = j->overlap[i] ? 0 : v[0];
    }
    return out->values != NULL;
}

/* Computes the gutters and seams of the joined map. */
static sbl_result join_map(map_bake *b, joined_map *j) {
    sbl_windows_desc desc;
    sbl_result result;
    memset(&desc, 0, sizeof desc);
    desc.lightmap = b->desc;
    desc.ids = j->alpha;
    memcpy(desc.light, j->light, given[LIGHT_GROUPS] ? sizeof *desc.light : sizeof desc.light);
    memcpy(desc.groups, j->light + 1, sizeof desc.groups);
    desc.texel_count = (size_t)options.lightmap * (size_t)options.lightmap;
    result = sbl_begin_windows(b->task->context, &desc);
    return result == SBL_SUCCESS ? work(b->task->context) : result;
}

/* Adds the statistics of the joined map to those of its windows. */
static void describe_join(map_bake *b, const joined_map *j) {
    sbl_stats *stats = &b->task->stats;
    const sbl_stats own = sbl_query_stats(b->task->context);
    stats->backend = own.backend;
    stats->lightmap = own.lightmap;
    stats->seconds.resolve += own.seconds.resolve;
    stats->picture.width = stats->picture.height = options.lightmap;
    stats->picture.visible_pixels = j->shown;
    b->task->has_stats = 1;
}

/* Joins the windows of a map and writes its files. Returns the exit status. */
static int join_parts(map_bake *b, picture_parts *parts, double *seconds) {
    lightmap *l = &b->map;
    joined_map j;
    int k, status;
    sbl_result result;
    memset(&j, 0, sizeof j);
    status = read_windows(&j, parts);
    l->light.values = j.light[0];
    l->light.width = l->light.height = options.lightmap;
    l->light.components = 3;
    l->atlas = l->light;
    for (k = 0; k < map_layers(); k++) {
        image *layer = given[DIRECTIONAL] ? &l->harmonics[k] : &l->groups[k];
        *layer = l->light;
        layer->values = j.light[k + 1];
    }
    if (status == DONE && !show_overlap(&j, &l->overlap)) status = fail("out of memory");
    if (status == DONE) status = keep_files(l, 0);
    if (status == DONE) {
        result = join_map(b, &j);
        clear_progress(&b->bar);
        if (result == SBL_UNFINISHED) status = stop("the map was not written");
        else if (result != SBL_SUCCESS) status = fail_with(b->task->said, common.scene, result);
    }
    *seconds = now() - b->task->start;
    describe_join(b, &j);
    if (status == DONE) status = keep_files(l, 1);
    free(j.alpha);
    free(j.overlap);
    return status;
}

/* ---- joining parts, baking windows, baking a part ---- */

/* Checks that the facts of the first part equal those of this run. Returns the exit status. */
static int check_joined(const map_bake *b, const part_list *list) {
    char why[FACTS_WORDS];
    if (facts_differ(&picture_kind, FACTS_OF_RUN, list->facts, b->windows.work.facts, "this run", why))
        return fail("%s does not fit: %s", list->files[0].name, why);
    if (list->drivers && !given[QUIET])
        warn("the parts were made by different graphics drivers, whose light differs by rounding and noise");
    return DONE;
}

/* Joins the parts in the folder of --join. Returns the exit status. */
static int join_folder(map_bake *b, double *seconds) {
    static picture_parts parts;
    const int region[4] = { 0, 0, options.lightmap, options.lightmap };
    sbl_stats *stats = &b->task->stats;
    char **files;
    int i, count = 0, status = DONE, ok;
    parts.frame.channels = map_channels[given[LIGHT_GROUPS]];
    parts.frame.components = map_components();
    files = parts_folder(&parts.list, options.join, ".exr", &count);
    ok = files != NULL;
    for (i = 0; i < count && ok; i++) ok = parts_add(&parts, files[i]);
    if (ok) status = check_joined(b, &parts.list);
    if (ok && status == DONE) ok = parts_check(&parts, region);
    if (!ok) status = fail("%s", parts.list.error);
    *stats = sbl_query_stats(b->task->context);
    stats->mode = common_mode(given);
    if (ok && plan__is_valid(FACT_MEAN, parts.list.facts[FACT_MEAN].text))
        sscanf(parts.list.facts[FACT_MEAN].text, "%f %f %f", &stats->picture.mean_radiance[0],
               &stats->picture.mean_radiance[1], &stats->picture.mean_radiance[2]);
    if (status == DONE) status = join_parts(b, &parts, seconds);
    parts_folder_free(files, count);
    parts_free(&parts);
    return status;
}

/* Bakes the windows that the folder OUTPUT.parts does not contain yet, and joins all windows. Returns the exit
   status. */
static int bake_windows(map_bake *b, double *seconds) {
    static picture_parts parts;
    baked_map *baked = &b->scene.baked[b->map.index];
    int status = windows_make(&b->windows);
    if (status == DONE && given[PART])
        status = windows_join(&b->windows, b->windows.work.facts, SBL_CHANNEL_FINAL, 0);
    else if (status == DONE) {
        status = windows_open_parts(&b->windows, &parts) ? join_parts(b, &parts, seconds)
                                                         : fail("%s", parts.list.error);
        parts_free(&parts);
    }
    *seconds = now() - b->task->start;
    if (status == DONE) {
        windows_total(&b->windows);
        baked->folder = b->windows.folder;
        baked->window_count = b->windows.work.count;
    }
    return status;
}

/* Bakes and writes the window of --part. Returns the exit status. */
static int bake_map_part(map_bake *b, double *seconds) {
    const sbl_result result = bake_window(b, b->windows.region);
    *seconds = now() - b->task->start;
    if (result == SBL_UNFINISHED) return stop("nothing was written");
    if (result != SBL_SUCCESS) return fail_with(b->task->said, common.scene, result);
    return target_write(&targets[ONE_FILE], write_window, b, 0) ? DONE
         : interrupted ? stop("nothing was written") : fail_to_write(common.output);
}

/* Decides whether the map is baked at once, in windows, or as one part. Returns the exit status. */
static int divide_map(map_bake *b) {
    static output_file folder;  /* the folder of the windows is created next to it */
    static char path[PATH_MAX];
    const int status = given[PART] ? DONE : check_memory(b);  /* baking at once needs even more memory */
    size_t length = strlen(common.output);
    windows *w = &b->windows;
    memset(w, 0, sizeof *w);
    w->task = b->task;
    w->bar = &b->bar;
    w->noun = "lightmap";
    w->part = given[PART] ? &options.part : NULL;
    w->resume = given[RESUME];
    w->keeps_light = common_mode(given) == SBL_MODE_GI && !given[STORE];
    w->given = given;
    while (length > 1 && common.output[length - 1] == '/') length--;
    snprintf(path, sizeof path, map_count > 1 ? "%.*s_%d" : "%.*s", (int)length, common.output, b->map.index);
    folder.path = path;
    w->target = given[PART] ? &targets[ONE_FILE] : &folder;
    w->size[0] = w->size[1] = w->region[2] = w->region[3] = options.lightmap;
    w->channels = map_channels[given[LIGHT_GROUPS]];
    w->components = map_components();
    w->user = b;
    w->bytes = map_window_bytes;
    w->look = look_at_map;
    w->use = use_map_facts;
    w->make = bake_window;
    w->write = write_window;
    w->plan_base = PLAN_BASE_LIGHTMAP;
    find_map_facts(b);
    return status != DONE || given[JOIN] ? status : windows_choose(w);
}

#include "sbl_bake_occlusion.h"
#include "sbl_bake_shadows.h"

/* ---- all maps of a run ---- */

/* Bakes a map and writes its files (with --join: joins its parts; with --part: bakes one part). Returns the exit
   status. */
static int bake_map(map_bake *b, double *seconds) {
    const int extra = given[AO] ? AO : SHADOW_MASK;
    int status;
    describe_lightmap(b);
    bar_step(&b->bar, 0, given[extra] ? 0.6 : 1, b->map.index, map_count);
    status = divide_map(b);
    if (status == DONE && given[extra] && b->windows.work.count > 1)
        status = fail("%s: the map is baked in windows, which have neither occlusion nor shadows; raise --memory, or "
                      "leave out %s", table[extra].name, table[extra].name);
    if (status != DONE) return status;
    return given[JOIN] ? join_folder(b, seconds) : b->windows.work.count > 1 ? bake_windows(b, seconds)
         : given[PART] ? bake_map_part(b, seconds) : bake_whole(b, seconds);
}

/* Frees a map, except for the data that the files of the scene need. */
static void free_map(map_bake *b) {
    lightmap *l = &b->map;
    int i;
    if (l->light.values == l->atlas.values) l->light.values = NULL;
    if (writes_lit()) b->scene.atlases[l->index] = l->atlas;
    else free(l->atlas.values);
    free(l->light.values);
    free(l->overlap.values);
    for (i = 0; i < 4; i++) free(l->harmonics[i].values);
    for (i = 0; i < SBL_MAX_LIGHT_GROUPS; i++) free(l->groups[i].values);
    free(b->window.values);
    b->window.values = NULL;
    plan_free(&b->windows.work);
}

/* Bakes all maps and adds up their statistics. The first map computes the bounced light, which all share. Returns the
   exit status. */
static int bake_maps(map_bake *b, double *seconds) {
    tool_task *task = b->task;
    sbl_stats sum = { 0 };
    int i, status = DONE;
    for (i = 0; i < map_count && status == DONE; i++) {
        memset(&b->map, 0, sizeof b->map);
        memset(&task->stats, 0, sizeof task->stats);
        task->has_stats = 0;
        b->map.index = i;
        b->map.scene = &b->scene;
        status = bake_map(b, seconds);
        if (status == DONE && !task->has_stats) task->stats = sbl_query_stats(task->context);
        if (i == 0) sum = task->stats;
        else add_stats(&sum, &task->stats);
        free_map(b);
    }
    task->stats = sum;
    task->has_stats = status == DONE;
    return status;
}

/* Bakes occlusion and shadow masks in the layouts of the maps. This comes last, because it removes the light from the
   scene. Returns the exit status. */
static int bake_extras(map_bake *b) {
    int i, status = DONE;
    if (given[AO] || given[SHADOW_MASK]) status = keep_store(b->task, given);
    for (i = 0; i < map_count && status == DONE; i++) {
        b->map.index = i;
        describe_lightmap(b);
        if (given[AO]) status = bake_occlusion(b);
        if (given[SHADOW_MASK] && status == DONE) status = bake_shadows(b);
    }
    if (given[SHADOW_MASK] && status == DONE) tell_lights(b->task->file);
    return status;
}

static int bake_lightmap(tool_task *task, double *seconds) {
    static map_bake b;
    int i, status;
    b.task = task;
    b.bar.shown = !given[QUIET] && isatty(STDERR_FILENO);
    b.bar.start = now();
    b.meshes = (int *)malloc(((size_t)task->file->scene.mesh_count + 1) * sizeof *b.meshes);
    status = b.meshes && scene_begin(&b.scene, task->file) ? bake_maps(&b, seconds) : fail("out of memory");
    if (status == DONE && !given[PART]) status = keep_scene(&b.scene);
    for (i = 0; i < map_count && status == DONE; i++)
        if (b.scene.baked[i].window_count)
            plan_folder_remove(&b.scene.baked[i].folder, b.scene.baked[i].window_count);
    if (status == DONE) status = bake_extras(&b);
    if (status == DONE && b.bar.shown)
        fprintf(stderr, "%s: %d x %d texels, %.0f sensors, %.1f s%s\n", common.output, options.lightmap,
                options.lightmap, (double)task->stats.sensors.sites, *seconds,
                given[PART] || !writes_lit() ? "" : "; any viewer of glTF shows scene_lit.glb in it");
    scene_end(&b.scene);
    free(b.meshes);
    return status;
}

#endif
