/* The lightmaps of sbl_bake: baked at once, in windows or in parts, joined, and written into a folder. sbl_bake.c
   includes this file after its options. */
#ifndef SBL_BAKE_LIGHTMAP_H
#define SBL_BAKE_LIGHTMAP_H

/* ---- the files of a folder ---- */

/* The pictures of a map: two, the harmonics, and those of light groups. */
enum {
    MAP_LIGHT, MAP_ATLAS, MAP_SH, MAP_GROUPS = MAP_SH + 4, MAP_PICTURES = MAP_GROUPS + SBL_MAX_LIGHT_GROUPS
};

/* The picture p in format f is target MAPS + f * MAP_PICTURES + p. */
enum {
    MAPS = OWN_TARGETS, ATLAS_PNG = MAPS + MAP_FORMATS * MAP_PICTURES, GLTF, BIN, LIT_GLB, OVERLAP, PARTIAL, TEXTURES
};

static const char *const picture_names[MAP_GROUPS] = { "lightmap", "atlas", "sh_0", "sh_1", "sh_2", "sh_3" };
static const char *const names[TEXTURES] = {
    [ATLAS_PNG] = "atlas.png", [GLTF] = "scene.gltf", [BIN] = "scene.bin", [LIT_GLB] = "scene_lit.glb",
    [OVERLAP] = "overlap.png", [PARTIAL] = "lightmap.partial.pfm"
};
static char *paths[TARGETS_MOST];

/* Adds a target with this number. folder: length of the part of common.output that names the folder. Returns the exit
   status. */
static int target_add(int number, size_t folder, const char *name) {
    paths[number] = output__join(common.output, folder, name);
    if (!paths[number]) return fail("out of memory");
    output_find(&targets[number], paths[number]);
    if (target_count <= number) target_count = number + 1;
    return DONE;
}

static int folder_is_new;  /* 1: this run has created the folder */

/* Returns whether a picture of the map is written in a format. */
static int map_is_written(int format, int picture) {
    if (!options.formats.wanted[format]) return 0;
    if (picture >= MAP_GROUPS) return picture - MAP_GROUPS < groups.list.count;
    return picture < MAP_SH || (given[DIRECTIONAL] && map_holds_negative((map_format)format));
}

/* Lists the files that do not depend on the scene. Returns the exit status. */
static int list_files(void) {
    const size_t folder = strlen(common.output);
    char name[64];
    int i, status = DONE;
    for (i = 0; i < MAP_FORMATS * MAP_PICTURES && status == DONE; i++) {
        if (i % MAP_PICTURES >= MAP_GROUPS || !map_is_written(i / MAP_PICTURES, i % MAP_PICTURES)) continue;
        snprintf(name, sizeof name, "%s%s", picture_names[i % MAP_PICTURES], map_endings[i / MAP_PICTURES]);
        status = target_add(MAPS + i, folder, name);
    }
    for (i = ATLAS_PNG; i < TEXTURES && status == DONE; i++)
        if (i != LIT_GLB || writes_lit()) status = target_add(i, folder, names[i]);
    return status;
}

/* Creates the folder and lists the files in it. Returns the exit status. */
static int find_files(void) {
    struct stat info, parts;
    int status;
    if (stat(common.output, &info) == 0 && !S_ISDIR(info.st_mode))
        return misuse("--output %s: this is not a folder; give another name", common.output);
    folder_is_new = stat(common.output, &info) != 0;
    if (given[JOIN] && !folder_is_new && stat(options.join, &parts) == 0 && parts.st_dev == info.st_dev &&
        parts.st_ino == info.st_ino)
        return misuse("--join %s: the map would be written among its parts; give another --output", options.join);
    if (folder_is_new && mkdir(common.output, 0777) != 0)
        return fail("%s: the folder cannot be created: %s; give another one", common.output, strerror(errno));
    targets_begin();
    status = list_files();
    return status == DONE ? targets_check(OVERLAP, given) : status;
}

/* Lists the files for the textures of the scene, from target number `first` on. Returns the exit status. */
static int find_textures(const scene_file *file, int first, size_t folder) {
    int i, status = DONE;
    if (file->scene.texture_count > TARGETS_MOST - first)
        return fail("%s: the scene has %d textures; this tool writes at most %d", common.scene,
                    file->scene.texture_count, TARGETS_MOST - first);
    for (i = 0; i < file->scene.texture_count && status == DONE; i++) {
        char name[GLTF_NAME];
        gltf_texture_name(name, i);
        status = target_add(first + i, folder, name);
    }
    return status;
}

/* Adds a target that depends on the scene, and checks it. Returns the exit status. */
static int target_add_more(int number, const char *name) {
    int status;
    if (number >= TARGETS_MOST) return fail("%s: it has too many textures for %s", common.scene, name);
    status = target_add(number, strlen(common.output), name);
    if (status != DONE || output_check(&targets[number])) return status;
    return fail("%s: cannot be written: %s; give another folder", targets[number].name, strerror(errno));
}

/* Gives sources their light groups, and lists the files of each group. Returns the exit status. */
static int find_groups(const scene_file *file) {
    char name[BAKE_GROUP_NAME + 32];
    int format, i, status = assign_groups(file);
    for (format = 0; format < MAP_FORMATS && !given[PART]; format++)
        for (i = 0; i < groups.list.count && status == DONE; i++) {
            if (!map_is_written(format, MAP_GROUPS + i)) continue;
            snprintf(name, sizeof name, "atlas_%s%s", groups.list.names[i], map_endings[format]);
            status = target_add_more(MAPS + format * MAP_PICTURES + MAP_GROUPS + i, name);
        }
    return status;
}
#include "sbl_bake_occlusion.h"
#include "sbl_bake_shadows.h"

/* Lists the files that depend on the scene, after it was read. Returns the exit status. */
static int find_more_files(const scene_file *file) {
    int i, mapped = 0, status;
    for (i = 0; i < file->scene.mesh_count; i++) mapped += file->scene.meshes[i].lightmap_texcoords.data != NULL;
    if (file->map_count > 1 && !given[MAP])
        return fail("%s: it has %d lightmaps; choose one of them: --map 0 to --map %d", common.scene, file->map_count,
                    file->map_count - 1);
    if (!mapped && file->map_count)
        return fail("%s: no mesh is in --map %d; the scene has %d", common.scene, common.reading.map, file->map_count);
    if (!mapped)
        return fail("%s: no mesh has second texture coordinates (TEXCOORD_1); sbl_unwrap makes them", common.scene);
    status = given[PART] ? DONE : find_textures(file, TEXTURES, strlen(common.output));
    if (status == DONE) status = find_groups(file);
    if (status == DONE && given[AO]) status = find_occlusion_files();
    return status == DONE && given[SHADOW_MASK] ? find_shadow_files(file) : status;
}

typedef struct lightmap {
    image light, atlas;      /* R. light: 0 where there is no surface; atlas: continued into gutters. Their values may
                                be the same array, which is light before the windows are joined, and then atlas */
    image overlap;           /* has no values if charts do not overlap */
    image harmonics[4];      /* have no values without --directional */
    image groups[SBL_MAX_LIGHT_GROUPS];  /* have no values without --light-groups */
    map_source source;       /* the picture that is written next */
    lit_scene lit;
    double intensity;        /* irradiance divided by the linear value of atlas.png */
    gltf_file gltf;
    char extras[64];         /* of gltf */
    double memory;           /* bytes that --memory allows */
    int texture;             /* number of the texture that is written next */
} lightmap;

static int write_map(FILE *out, const void *what) { return map_write(out, &((const lightmap *)what)->source); }
static int write_partial(FILE *out, const void *what) {
    const map_source s = { &((const lightmap *)what)->light, MAP_PFM, 0, 0 };
    return map_write(out, &s);
}
static int write_lit(FILE *out, const void *what) { return lit_write(out, &((const lightmap *)what)->lit); }
static int write_atlas_png(FILE *out, const void *what) {
    const lightmap *l = (const lightmap *)what;
    return picture_write(out, ".png", &l->atlas, SBL_CHANNEL_FINAL, log(atan(1.0) * 4 / l->intensity) / log(2.0));
}
static int write_overlap(FILE *out, const void *what) {
    return picture_write(out, ".png", &((const lightmap *)what)->overlap, SBL_CHANNEL_ALBEDO, 0);
}
static int write_scene(FILE *out, const void *what) { return gltf_write_json(out, &((const lightmap *)what)->gltf); }
static int write_scene_bin(FILE *out, const void *what) { return gltf_write_bin(out, &((const lightmap *)what)->gltf); }
static int write_texture(FILE *out, const void *what) {
    const lightmap *l = (const lightmap *)what;
    return gltf_write_texture(out, &l->gltf, l->texture);
}

static int compare_floats(const void *a, const void *b) {
    const float x = *(const float *)a, y = *(const float *)b;
    return (x > y) - (x < y);
}

/* Returns the value of R that becomes white in 8 bits: a thousandth of the lit texels exceeds it; it is at most eight
   times the mean of the lit texels. Returns 0 if memory runs out. */
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

/* Reads R, and sets it to 0 where there is no surface. */
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

/* If triangles share texels, makes a picture of this: shared texels are red, other used texels grey. */
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

/* Writes a file. Returns the exit status. */
static int keep_file(lightmap *l, int target, output_writer write) {
    if (interrupted) return stop("%s was not written", targets[target].name);
    if (target_write(&targets[target], write, l, 0)) return DONE;
    return interrupted ? stop("%s was not written", targets[target].name) : fail_to_write(targets[target].name);
}

/* Writes the pictures of a map from number `first` to number `last`, in all formats. Returns the exit status. */
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
            status = keep_file(l, MAPS + format * MAP_PICTURES + k, write_map);
        }
    return status;
}

/* Makes and writes the scene that any viewer shows. Returns the exit status. */
static int keep_lit(lightmap *l) {
    int status;
    if (!writes_lit()) return DONE;
    l->lit.scene = l->gltf.scene;
    l->lit.names = l->gltf.names;
    l->lit.atlas = &l->atlas;
    l->lit.cancel = &interrupted;
    l->lit.size = given[LIT] ? options.lit : lit_size(l->gltf.scene, l->atlas.width, l->memory / 4);
    if ((isnan(options.stops) && !lit_spare(&l->lit)) || !lit_make(&l->lit))
        status = fail("out of memory: %s needs %.0f MB; --lit 0 leaves it out", names[LIT_GLB],
                      1e-6 * LIT_BYTES * l->lit.size * l->lit.size);
    else status = keep_file(l, LIT_GLB, write_lit);
    lit_free(&l->lit);
    return status;
}

/* Finds what the formats need to know of R. */
static void survey_light(lightmap *l) {
    map_survey s = { 0, 0, 0 };
    map_survey_of(&s, &l->light);
    l->source.range = map_rgbm_range(s.most);
    snprintf(l->extras, sizeof l->extras, "{\"rgbm_range\": %.9g}", l->source.range);
    if (options.formats.wanted[MAP_RGBM]) l->gltf.extras = l->extras;
    l->lit.stops = lit_meter(&l->lit, &l->light);
    if (!isnan(options.stops)) l->lit.stops = options.stops;
}

/* Says what the formats do not hold, and how to read rgbm. */
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
    if (halves && s.most > 0 && s.most < 64 * MAP_HALF_LEAST)
        warn("the map is too dark for 16-bit floats: its largest value is %.3g; --formats exr32 keeps all digits",
             (double)s.most);
    if (options.formats.wanted[MAP_RGBM])
        fprintf(stderr, TOOL_NAME ": range of rgbm: %.9g; R = (%.9g * alpha * rgb)^2 with linear bytes\n",
                l->source.range, l->source.range);
}

/* Writes the files that show l->light (group 0) or all others (group 1). Returns the exit status. */
static int keep_files(lightmap *l, int group) {
    int i, status;
    if (!group) {
        survey_light(l);
        return keep_maps(l, MAP_LIGHT, MAP_LIGHT);
    }
    tell_formats(l);
    status = keep_maps(l, MAP_ATLAS, MAP_PICTURES - 1);
    for (i = 0; i < l->gltf.scene->texture_count && status == DONE; i++) {
        l->texture = i;
        status = keep_file(l, TEXTURES + i, write_texture);
    }
    if (status == DONE) status = keep_file(l, ATLAS_PNG, write_atlas_png);
    if (status == DONE && l->overlap.values) status = keep_file(l, OVERLAP, write_overlap);
    if (status == DONE) status = keep_lit(l);
    if (status == DONE) status = keep_file(l, BIN, write_scene_bin);
    return status == DONE ? keep_file(l, GLTF, write_scene) : status;
}

/* ---- baking ---- */

/* A lightmap that is being baked: what is baked, and in which windows. */
typedef struct map_bake {
    tool_task *task;
    progress bar;
    sbl_lightmap_desc desc;
    windows windows;
    image window;            /* the window that was baked last, in the components of map_channels */
    lightmap map;
} map_bake;

static void describe_lightmap(sbl_lightmap_desc *desc, progress *bar) {
    memset(desc, 0, sizeof *desc);
    desc->width = desc->height = options.lightmap;
    if (given[GUTTER]) desc->gutter = (int)zero_or(options.gutter);
    desc->options = common_options(given, bar);
    desc->target_error = (float)options.target_error;
    desc->directional = given[DIRECTIONAL];
    desc->grouped = given[LIGHT_GROUPS];
    desc->supersample = options.supersample;
    desc->tile = common.tile;
    if (given[THRESHOLD]) desc->threshold = zero_or(common.threshold);
    if (given[FILTER_RADIUS]) desc->filter_radius = (int)zero_or(common.filter_radius);
}

/* Sets what the scene of a lightmap refers to, after R is known. Returns 0 if memory runs out. */
static int describe_scene(map_bake *b) {
    lightmap *l = &b->map;
    l->intensity = atan(1.0) * 4 * bright(&l->light);
    l->memory = (double)b->task->file->memory;
    l->gltf.scene = &b->task->file->scene;
    l->gltf.names = b->task->file->names;
    l->gltf.bin = names[BIN];
    l->gltf.lightmap = names[ATLAS_PNG];
    l->gltf.intensity = l->intensity;
    return l->intensity > 0;
}

/* Saves R of an unfinished lightmap after a signal. Returns the exit status. */
static int save_partial(map_bake *b) {
    const sbl_result result = read_light(b->task->context, &b->map, b->desc.width);
    if (result == SBL_UNFINISHED) return stop("there is no light yet");
    if (result == SBL_SUCCESS && target_write(&targets[PARTIAL], write_partial, &b->map, 1))
        return stop("the unfinished lightmap (%.0f %%) is in %s",
                    floor(100 * (double)sbl_progress(b->task->context)), targets[PARTIAL].name);
    return stop("the unfinished lightmap cannot be written to %s: %s", targets[PARTIAL].name, why_not_written());
}

/* Bakes the map at once. Returns the exit status. */
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
    if (result == SBL_SUCCESS && !describe_scene(b)) result = SBL_ERROR_OUT_OF_MEMORY;
    if (result != SBL_SUCCESS) return fail_with(b->task->said, common.scene, result);
    status = keep_files(l, 0);
    return status == DONE ? keep_files(l, 1) : status;
}

/* ---- baking in windows ---- */

/* The components of the .exr file of a window: R; 1 where there is a surface, otherwise 0; the number of triangles that
   overlap the one that the texel shows; then three for each layer of light: the harmonics of --directional, or the
   groups of --light-groups. */
enum { MAP_ALPHA = 3, MAP_OVERLAP, MAP_PLAIN };
#define MAP_COLORS(name) name ".R", name ".G", name ".B"
static const char *const map_channels[2][MAP_PLAIN + 3 * SBL_MAX_LIGHT_GROUPS] = {
    { "R", "G", "B", "A", "overlap", MAP_COLORS("sh_0"), MAP_COLORS("sh_1"), MAP_COLORS("sh_2"), MAP_COLORS("sh_3") },
    { "R", "G", "B", "A", "overlap", MAP_COLORS("group_0"), MAP_COLORS("group_1"), MAP_COLORS("group_2"),
      MAP_COLORS("group_3"), MAP_COLORS("group_4"), MAP_COLORS("group_5"), MAP_COLORS("group_6"),
      MAP_COLORS("group_7") }
};

/* Returns the number of layers besides R. */
static int map_layers(void) { return given[DIRECTIONAL] ? 4 : groups.list.count; }

static int map_components(void) { return MAP_PLAIN + 3 * map_layers(); }

/* Returns a hash of the scene and of all lightmap_texcoords, which the fingerprint of the scene leaves out. */
static unsigned long long map_hash(const map_bake *b) {
    const sbl_scene_desc *scene = &b->task->file->scene;
    const uint64_t fingerprint = sbl_scene_fingerprint(b->task->context);
    unsigned long long hash = plan_hash(PLAN_HASH_START, &fingerprint, sizeof fingerprint);
    int i;
    for (i = 0; i < scene->mesh_count; i++) {
        const sbl_mesh *m = &scene->meshes[i];
        if (m->lightmap_texcoords.data)
            hash = plan_hash(hash, m->lightmap_texcoords.data, 2 * sizeof(float) * (size_t)m->vertex_count);
    }
    return hash;
}

/* Sets the facts that windows of this map have in common, except mean and price. */
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

/* Bakes a small map, which gives the mean, the price and, if cost is not NULL, the cost. Returns the exit status. */
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
    plan_use(&b->windows.work, b->desc.mean_radiance, &b->desc.price);
}

static double map_window_bytes(const void *user, const int window[4]) {
    const map_bake *b = (const map_bake *)user;
    sbl_lightmap_desc desc = b->desc;
    memcpy(desc.window, window, sizeof desc.window);
    return (double)sbl_lightmap_bytes(b->task->context, &desc) + 4.0 * (map_components() + 3) * window[2] * window[3];
}

/* Copies a channel of the baked window to the components of b->window from number `at` on. */
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
    out->whole[0] = out->whole[1] = options.lightmap;
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

/* The whole map that the windows are joined to. */
typedef struct joined_map {
    float *light[1 + SBL_MAX_LIGHT_GROUPS];  /* R and the layers, 3 floats per texel */
    float *alpha;                 /* 1 where there is a surface */
    unsigned char *overlap;       /* per texel: 1 if triangles overlap there */
    int any_overlap, shown;       /* shown: number of texels that show a surface */
} joined_map;

/* Spreads a band of rows, which begins at texel `first`, over the arrays of the map. */
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

/* Returns DONE if --memory allows the whole map to be joined; otherwise the exit status. */
static int check_memory(const map_bake *b) {
    const double size = options.lightmap, most = (double)b->task->file->memory;
    const double bytes = (42.0 + 12 * map_layers()) * size * size;  /* of joined_map and its gutters */
    if (bytes <= most) return DONE;
    return fail("the map of %.0f x %.0f texels needs about %.0f MB to be joined, and --memory allows %.0f MB; give "
                "more --memory, or make parts (--part) and join them on a larger machine", size, size, bytes / 1e6,
                most / 1e6);
}

/* Allocates the arrays of the map, and reads the windows into them. Returns the exit status. */
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
        return fail("out of memory: the whole map of %d x %d texels must fit into it to be joined", size, size);
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

/* Makes the picture of overlaps, if there are any. Returns 0 if memory runs out. */
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

/* Makes the gutters and seams of the map. */
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

/* Adds what is known after joining to the statistics of the windows. */
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

/* Joins the windows and writes all files. Returns the exit status. */
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
    if (status == DONE && (!describe_scene(b) || !show_overlap(&j, &l->overlap))) status = fail("out of memory");
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

/* ---- the three ways ---- */

/* Checks that the first part fits this run. Returns the exit status. */
static int check_joined(const map_bake *b, const part_list *list) {
    int i;
    for (i = 0; i < FACT_MEAN; i++)
        if (strcmp(list->facts[i].text, b->windows.work.facts[i].text) != 0)
            return fail("%s does not fit: it was made %s: it has %s, this run has %s", list->files[0].name,
                        fact_words[i], fact_shown(list->facts[i].text), fact_shown(b->windows.work.facts[i].text));
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

/* Bakes the windows that OUTPUT.parts does not hold yet, and joins all windows. Returns the exit status. */
static int bake_windows(map_bake *b, double *seconds) {
    static picture_parts parts;
    int status = windows_make(&b->windows);
    if (status == DONE && given[PART])
        status = windows_join(&b->windows, b->windows.work.facts, SBL_CHANNEL_FINAL, 0);
    else if (status == DONE) {
        status = windows_open_parts(&b->windows, &parts) ? join_parts(b, &parts, seconds)
                                                         : fail("%s", parts.list.error);
        parts_free(&parts);
    }
    *seconds = now() - b->task->start;
    if (status == DONE) windows_end(&b->windows);
    return status;
}

/* Bakes the window of --part. Returns the exit status. */
static int bake_map_part(map_bake *b, double *seconds) {
    const sbl_result result = bake_window(b, b->windows.region);
    *seconds = now() - b->task->start;
    if (result == SBL_UNFINISHED) return stop("nothing was written");
    if (result != SBL_SUCCESS) return fail_with(b->task->said, common.scene, result);
    return target_write(&targets[ONE_FILE], write_window, b, 0) ? DONE
         : interrupted ? stop("nothing was written") : fail_to_write(common.output);
}

/* Decides whether the map is baked at once, in part, or in windows. Returns the exit status. */
static int divide_map(map_bake *b) {
    static output_file folder;  /* the windows are beside it */
    static char path[PATH_MAX];
    const int status = given[PART] ? DONE : check_memory(b);  /* a map that is baked at once needs more */
    windows *w = &b->windows;
    w->task = b->task;
    w->bar = &b->bar;
    w->noun = "lightmap";
    w->part = given[PART] ? &options.part : NULL;
    w->resume = given[RESUME];
    w->keeps_light = common_mode(given) == SBL_MODE_GI && !given[STORE];
    w->given = given;
    snprintf(path, sizeof path, "%s", common.output);
    while (strlen(path) > 1 && path[strlen(path) - 1] == '/') path[strlen(path) - 1] = 0;
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
    find_map_facts(b);
    return status != DONE || given[JOIN] ? status : windows_choose(w);
}

static int bake_lightmap(tool_task *task, double *seconds) {
    static map_bake b;
    int i, status;
    b.task = task;
    b.bar.shown = !given[QUIET] && isatty(STDERR_FILENO);
    b.bar.start = now();
    describe_lightmap(&b.desc, &b.bar);
    status = divide_map(&b);
    if (given[AO] || given[SHADOW_MASK]) b.bar.to = 0.6;
    if (status == DONE && (given[AO] || given[SHADOW_MASK]) && b.windows.work.count > 1)
        status = fail("%s: the map is baked in windows, which have neither occlusion nor shadows; raise --memory, or "
                      "leave out %s",
                      table[given[AO] ? AO : SHADOW_MASK].name, table[given[AO] ? AO : SHADOW_MASK].name);
    if (status == DONE)
        status = given[JOIN] ? join_folder(&b, seconds) : b.windows.work.count > 1 ? bake_windows(&b, seconds)
               : given[PART] ? bake_map_part(&b, seconds) : bake_whole(&b, seconds);
    if (status == DONE && given[AO]) status = bake_occlusion(task, &b.desc, &b.bar);
    if (status == DONE && given[SHADOW_MASK]) status = bake_shadows(task, &b.desc, &b.bar);
    plan_free(&b.windows.work);
    free(b.window.values);
    free(b.map.light.values);
    if (b.map.atlas.values != b.map.light.values) free(b.map.atlas.values);
    free(b.map.overlap.values);
    for (i = 0; i < 4; i++) free(b.map.harmonics[i].values);
    for (i = 0; i < SBL_MAX_LIGHT_GROUPS; i++) free(b.map.groups[i].values);
    if (status == DONE && b.bar.shown)
        fprintf(stderr, "%s: %d x %d texels, %.0f sensors, %.1f s%s\n", common.output, options.lightmap,
                options.lightmap, (double)sbl_query_stats(task->context).sensors.count, *seconds,
                given[PART] || !writes_lit() ? "" : "; any viewer of glTF shows scene_lit.glb in it");
    return status;
}

#endif
