/* The reflection probes of sbl_bake. Around each probe it renders six pictures, filters them for rough surfaces, and
   writes them as .ktx2 and .exr into a folder with a .json that describes them. sbl_bake.c includes this file after its
   probes. */
#ifndef SBL_BAKE_CUBEMAPS_H
#define SBL_BAKE_CUBEMAPS_H

enum {
    CUBEMAP_SIZE = 128,      /* default width of a face in texels */
    CUBEMAP_LAST = 4,        /* width of a face of the last level in texels */
    CUBEMAP_MARGIN = 8,      /* pixels around each face, as neighbours for sensors and filter */
    CUBEMAP_BINS = 64,       /* number of distance intervals in the search for a wall */
    CUBEMAP_JSON = OWN_TARGETS, CUBEMAP_KTX2, CUBEMAP_EXR
};

/* Histograms of the surfaces on one side of a probe (+x -x +y -y +z -z) that are perpendicular to the axis of this
   side, by their distance from the probe as a fraction of the distance to the bounds. solid: their solid angle, 1 being
   a texel in the middle of a face; sum: the same times their coordinate on the axis. The wall of the room is where the
   surfaces fill the largest solid angle. */
typedef struct cube_wall { double solid[CUBEMAP_BINS + 1], sum[CUBEMAP_BINS + 1]; } cube_wall;

/* The facts about a probe in the .json. The walls are in the order of cube_names. */
typedef struct cube_facts {
    sbl_probe probe;
    float box[6];
    int is_wall[6];          /* 1: a wall was found; 0: this side of the box is on the bounds of the scene, or at the
                                probe if that is outside of them */
} cube_facts;

typedef struct cubemaps {
    tool_task *task;
    progress bar;
    sbl_bounds bounds;
    int size, levels, count, level;       /* level: index of the level that is written next */
    float *values[CUBE_DEPTHS];           /* the levels of one cube map */
    cube_facts *facts;
    double greatest;                      /* greatest value in level 0 of any cube map */
} cubemaps;

static int cubemap_side(const cubemaps *c, int level) { return c->size >> level; }
static double cubemap_roughness(const cubemaps *c, int level) { return (double)level / (c->levels - 1); }

/* ---- files ---- */

static int write_cubemap_ktx2(FILE *out, const void *what) {
    const cubemaps *c = (const cubemaps *)what;
    const ktx2_picture p = { c->size, c->size, CUBE_FACES, c->levels, 3, KTX2_HALF, (const float *const *)c->values,
                             "sbl_bake" };
    return ktx2_write(out, &p);
}

/* Writes one level of a cube map as a picture of its faces, one below the other. */
static int write_cubemap_exr(FILE *out, const void *what) {
    const cubemaps *c = (const cubemaps *)what;
    const int side = cubemap_side(c, c->level);
    const image column = { .width = side, .height = CUBE_FACES * side, .components = 3, .values = c->values[c->level] };
    return picture_write(out, ".exr", &column, SBL_CHANNEL_FINAL, 0);
}

static void put_cubemap(FILE *out, const cubemaps *c, int number) {
    const cube_facts *f = &c->facts[number];
    const float *at = f->probe.position, *b = f->box;
    int i;
    fprintf(out, "%s\n  {\"position\": [%.9g, %.9g, %.9g], \"valid\": %s", number ? "," : "", (double)at[0],
            (double)at[1], (double)at[2], f->probe.valid ? "true" : "false");
    if (f->probe.valid) {
        fprintf(out, ",\n   \"box\": {\"lowest\": [%.9g, %.9g, %.9g], \"highest\": [%.9g, %.9g, %.9g], \"from\": [",
                (double)b[1], (double)b[3], (double)b[5], (double)b[0], (double)b[2], (double)b[4]);
        for (i = 0; i < 6; i++) fprintf(out, "%s\"%s\"", i ? ", " : "", f->is_wall[i] ? "wall" : "bounds");
        fprintf(out, "]},\n   \"ktx2\": \"cubemap_%04d.ktx2\", \"exr\": [", number);
#ifdef SBL_RENDER_OPENEXR
        for (i = 0; i < c->levels; i++) fprintf(out, "%s\"cubemap_%04d_%d.exr\"", i ? ", " : "", number, i);
#endif
        fprintf(out, "]");
    }
    fprintf(out, "}");
}

static int write_cubemaps_json(FILE *out, const void *what) {
    const cubemaps *c = (const cubemaps *)what;
    int i;
    fprintf(out, "{\"units\": \"radiance, linear, primaries of BT.709\",\n \"faces\": [");
    for (i = 0; i < CUBE_FACES; i++) fprintf(out, "%s\"%s\"", i ? ", " : "", cube_names[i]);
    fprintf(out, "],\n \"orientation\": \"as in OpenGL and KTX: sampling in a direction of the world gives the light "
            "from there; in an .exr the faces stand one below the other\",\n \"filter\": \"GGX, alpha = roughness^2, "
            "normal = view = reflection (Karis 2013)\",\n \"box\": \"from: the sides +x -x +y -y +z -z\",\n "
            "\"levels\": [");
    for (i = 0; i < c->levels; i++)
        fprintf(out, "%s{\"size\": %d, \"roughness\": %.9g}", i ? ", " : "", cubemap_side(c, i),
                cubemap_roughness(c, i));
    fprintf(out, "],\n ");
    if (options.grid[0]) fprintf(out, "\"grid\": [%d, %d, %d],\n ", options.grid[0], options.grid[1], options.grid[2]);
    fprintf(out, "\"cubemaps\": [");
    for (i = 0; i < c->count; i++) put_cubemap(out, c, i);
    fprintf(out, "\n]}\n");
    return 1;
}

/* Lists the files of one cube map as targets after the .json, and checks that they can be written. Returns the exit
   status. */
static int find_cubemap_files(const cubemaps *c, int number) {
    const size_t folder = strlen(common.output);
    char name[64];
    int i, status, last = CUBEMAP_KTX2;
    for (i = CUBEMAP_KTX2; i < target_count; i++) {
        output_free(&targets[i]);
        free(paths[i]);
        paths[i] = NULL;
    }
    target_count = CUBEMAP_KTX2;
    snprintf(name, sizeof name, "cubemap_%04d.ktx2", number);
    status = target_add(CUBEMAP_KTX2, folder, name);
#ifdef SBL_RENDER_OPENEXR
    for (i = 0; i < c->levels && status == DONE; i++) {
        snprintf(name, sizeof name, "cubemap_%04d_%d.exr", number, i);
        status = target_add(last = CUBEMAP_EXR + i, folder, name);
    }
#endif
    (void)c;
    if (status == DONE) status = targets_check(last + 1, given);
    return status == DONE ? targets_check_read(c->task->file) : status;
}

/* Creates the folder and adds the .json to the targets. Returns the exit status. */
static int find_cubemaps(void) {
    struct stat info;
    int status;
    folder_is_new = stat(common.output, &info) != 0;
    if (!folder_is_new && !S_ISDIR(info.st_mode))
        return misuse("--output %s: this is not a folder; give another name", common.output);
    if (folder_is_new && mkdir(common.output, 0777) != 0)
        return fail("%s: the folder cannot be created: %s; give another one", common.output, strerror(errno));
    targets_begin();
    status = target_add(CUBEMAP_JSON, strlen(common.output), "cubemaps.json");
    return status == DONE ? targets_check(target_count, given) : status;
}

static int keep_cubemap(cubemaps *c, int number) {
    int i, status = find_cubemap_files(c, number);
    for (i = CUBEMAP_KTX2; i < target_count && status == DONE; i++) {
        c->level = i - CUBEMAP_EXR;
        if (!target_write(&targets[i], i == CUBEMAP_KTX2 ? write_cubemap_ktx2 : write_cubemap_exr, c, 0))
            status = interrupted ? stop("%s was not written", targets[i].name) : fail_to_write(targets[i].name);
    }
    return status;
}

/* ---- the box of a room around a probe ---- */

/* Returns the distance from the probe to one side (+x -x +y -y +z -z) of the bounds of the scene. It is negative if the
   probe is beyond this side. */
static double cube_reach(const cubemaps *c, const float at[3], int side) {
    const int k = side / 2;
    return side % 2 ? (double)at[k] - (double)c->bounds.lowest[k] : (double)c->bounds.highest[k] - (double)at[k];
}

/* Adds the surfaces that the picture of a face shows to the histograms of the walls. */
static sbl_result add_walls(const cubemaps *c, const float at[3], int pixels, cube_wall walls[6]) {
    image position = { 0 }, normal = { 0 };
    sbl_result result = picture_read(c->task->context, pixels, pixels, SBL_CHANNEL_POSITION, &position);
    int i, k, count = pixels * pixels;
    if (result == SBL_SUCCESS) result = picture_read(c->task->context, pixels, pixels, SBL_CHANNEL_NORMAL, &normal);
    for (i = 0; i < count && result == SBL_SUCCESS; i++) {
        const float *p = position.values + 3 * (size_t)i, *n = normal.values + 3 * (size_t)i;
        const double u = (2.0 * (i % pixels) + 1 - pixels) / c->size, v = (2.0 * (i / pixels) + 1 - pixels) / c->size;
        const double inside = fabs(u) < 1 && fabs(v) < 1 ? pow(1 + u * u + v * v, -1.5) : 0;
        for (k = 0; k < 3; k++) {
            const double away = (double)p[k] - (double)at[k];
            const int side = 2 * k + (away < 0);
            const double fraction = fabs(away) / cube_reach(c, at, side);
            if (!(fabs((double)n[k]) > 0.98) || !(fraction > 0 && fraction <= 1.001)) continue;
            walls[side].solid[(int)(fraction * (CUBEMAP_BINS - 1) + 0.5)] += inside;
            walls[side].sum[(int)(fraction * (CUBEMAP_BINS - 1) + 0.5)] += inside * (double)p[k];
        }
    }
    free(position.values);
    free(normal.values);
    return result;
}

/* Sets the box of a probe from the histograms of its walls. A wall fills at most two neighbouring bins, and must fill
   at least as much as 1 % of a face. Where none does, the box ends at the bounds of the scene, or at the probe if it is
   outside of them. */
static void find_box(const cubemaps *c, const cube_wall walls[6], cube_facts *f) {
    const double least = 0.01 * c->size * c->size;
    int side, i;
    for (side = 0; side < 6; side++) {
        const cube_wall *w = &walls[side];
        const float *ends = side % 2 ? c->bounds.lowest : c->bounds.highest;
        const float at = f->probe.position[side / 2];
        double best = least;
        f->box[side] = cube_reach(c, f->probe.position, side) > 0 ? ends[side / 2] : at;
        for (i = 0; i < CUBEMAP_BINS; i++) {
            const double solid = w->solid[i] + w->solid[i + 1];
            if (!(solid > best)) continue;
            best = solid;
            f->box[side] = (float)((w->sum[i] + w->sum[i + 1]) / solid);
            f->is_wall[side] = 1;
        }
    }
}

/* ---- baking ---- */

/* Describes the picture of a face for sbl_begin_picture. */
static void describe_face(cubemaps *c, const float at[3], int face, sbl_picture_desc *desc) {
    const float (*axes)[3] = cube_axes[face];
    const int pixels = c->size + 2 * CUBEMAP_MARGIN;
    /* A shorter distance to the point that the camera looks at would be lost by rounding where coordinates are large */
    const float away = 1 + fabsf(at[0]) + fabsf(at[1]) + fabsf(at[2]);
    memset(desc, 0, sizeof *desc);
    desc->width = desc->height = pixels;
    sbl_look_at(desc->world_to_view, at[0], at[1], at[2], at[0] + away * axes[2][0], at[1] + away * axes[2][1],
                at[2] + away * axes[2][2], -axes[1][0], -axes[1][1], -axes[1][2]);
    sbl_perspective(desc->view_to_clip, (float)(2 * atan((double)pixels / c->size) * 180 / (4 * atan(1.0))), 1);
    desc->options = common_options(given, &c->bar);
    desc->target_error = (float)options.target_error;
    desc->tile = common.tile;
    if (given[THRESHOLD]) desc->threshold = zero_or(common.threshold);
    if (given[FILTER_RADIUS]) desc->filter_radius = (int)zero_or(common.filter_radius);
}

/* Copies a picture without its margin to a face of level 0, mirrored, because the faces of cube maps are mirror
   images. */
static void copy_face(cubemaps *c, int face, const float *picture) {
    const int pixels = c->size + 2 * CUBEMAP_MARGIN;
    float *out = c->values[0] + 3 * (size_t)face * (size_t)c->size * (size_t)c->size;
    int x, y, k;
    for (y = 0; y < c->size; y++)
        for (x = 0; x < c->size; x++)
            for (k = 0; k < 3; k++) {
                *out = picture[3 * ((size_t)(y + CUBEMAP_MARGIN) * (size_t)pixels +
                                    (size_t)(pixels - 1 - CUBEMAP_MARGIN - x)) + (size_t)k];
                if ((double)*out > c->greatest) c->greatest = (double)*out;
                out++;
            }
}

/* Renders level 0 of a cube map and finds the box of its probe. */
static sbl_result draw_faces(cubemaps *c, int number) {
    const int pixels = c->size + 2 * CUBEMAP_MARGIN;
    static cube_wall walls[6];
    cube_facts *f = &c->facts[number];
    sbl_picture_desc desc;
    image picture = { 0 };
    sbl_result result = SBL_SUCCESS;
    const int warnings = c->task->said->warnings_kept;
    int face;
    memset(walls, 0, sizeof walls);
    for (face = 0; face < CUBE_FACES && result == SBL_SUCCESS; face++) {
        describe_face(c, f->probe.position, face, &desc);
        c->bar.from = 0.02 + 0.98 * (number + face / 6.0) / c->count;
        c->bar.to = c->bar.from + 0.98 / 6 / c->count;
        result = sbl_begin_picture(c->task->context, &desc);
        if (result == SBL_SUCCESS) result = work(c->task->context);
        if (!sbl_query_stats(c->task->context).picture.visible_pixels)
            c->task->said->warnings_kept = warnings;  /* no warning, because a face may show only the sky */
        if (result == SBL_SUCCESS)
            result = picture_read(c->task->context, pixels, pixels, SBL_CHANNEL_FINAL, &picture);
        if (result == SBL_SUCCESS) copy_face(c, face, picture.values);
        if (result == SBL_SUCCESS) result = add_walls(c, f->probe.position, pixels, walls);
        free(picture.values);
        picture.values = NULL;
    }
    if (result == SBL_SUCCESS) find_box(c, walls, f);
    return result;
}

/* Computes all further levels from level 0. */
static sbl_result filter_levels(cubemaps *c) {
    cube_tree tree;
    int i, ok = cube_tree_make(&tree, c->size, c->values[0]);
    for (i = 1; i < c->levels && ok && !interrupted; i++)
        cube_filter(&tree, cubemap_roughness(c, i), cubemap_side(c, i), c->values[i]);
    cube_tree_free(&tree);
    return !ok ? SBL_ERROR_OUT_OF_MEMORY : interrupted ? SBL_UNFINISHED : SBL_SUCCESS;
}

/* Finds which positions are valid, and moves invalid ones as far as --move allows. */
static sbl_result place_cubemaps(cubemaps *c) {
    sbl_probe *all = (sbl_probe *)calloc((size_t)c->count, sizeof *all);
    sbl_probes_desc desc;
    sbl_result result = SBL_ERROR_OUT_OF_MEMORY;
    int i;
    if (!all) return result;
    memset(&desc, 0, sizeof desc);
    desc.positions = listed.positions;
    memcpy(desc.grid, options.grid, sizeof desc.grid);
    desc.probes = all;
    desc.probe_count = c->count;
    desc.move = (float)options.move;
    desc.options = common_options(given, &c->bar);
    desc.options.mode = SBL_MODE_DIRECT;  /* the light is not needed */
    c->bar.to = 0.02;
    result = sbl_begin_probes(c->task->context, &desc);
    if (result == SBL_SUCCESS) result = work(c->task->context);
    for (i = 0; i < c->count; i++) c->facts[i].probe = all[i];
    free(all);
    return result;
}

static void free_cubemaps(cubemaps *c) {
    int i;
    for (i = 0; i < c->levels; i++) free(c->values[i]);
    free(c->facts);
}

/* Allocates the levels of a cube map and the list of all probes. Returns 0 if memory runs out. */
static int begin_cubemaps(cubemaps *c, tool_task *task) {
    const progress bar = { !given[QUIET] && isatty(STDERR_FILENO), now(), 0, 0, 0 };
    int i, ok;
    memset(c, 0, sizeof *c);
    c->task = task;
    c->bar = bar;
    c->bounds = sbl_query_bounds(task->context);
    c->size = given[CUBEMAP] ? options.cubemap_size : CUBEMAP_SIZE;
    while (cubemap_side(c, c->levels) >= CUBEMAP_LAST) c->levels++;
    c->count = facts.range[BAKE_COUNT];
    c->facts = (cube_facts *)calloc((size_t)c->count + 1, sizeof *c->facts);
    ok = c->facts != NULL;
    for (i = 0; i < c->levels; i++) {
        const size_t side = (size_t)cubemap_side(c, i);
        c->values[i] = (float *)malloc(3 * sizeof(float) * CUBE_FACES * side * side);
        ok = ok && c->values[i];
    }
    return ok;
}

static int bake_cubemaps(tool_task *task, double *seconds) {
    cubemaps c;
    sbl_result result = begin_cubemaps(&c, task) ? SBL_SUCCESS : SBL_ERROR_OUT_OF_MEMORY;
    int i, valid = 0, status = result == SBL_SUCCESS ? find_cubemap_files(&c, 0) : DONE;
    if (result == SBL_SUCCESS && status == DONE && c.count) result = place_cubemaps(&c);
    for (i = 0; i < c.count && result == SBL_SUCCESS && status == DONE; i++) {
        if (!c.facts[i].probe.valid) continue;
        valid++;
        result = draw_faces(&c, i);
        if (result == SBL_SUCCESS) result = filter_levels(&c);
        if (result == SBL_SUCCESS) status = keep_cubemap(&c, i);
    }
    clear_progress(&c.bar);
    *seconds = now() - task->start;
    if (status != DONE) valid = 0;
    else if (result == SBL_UNFINISHED) status = stop("cubemaps.json was not written");
    else if (result != SBL_SUCCESS) status = fail_with(task->said, common.scene, result);
    else if (!target_write(&targets[CUBEMAP_JSON], write_cubemaps_json, &c, 0))
        status = interrupted ? stop("cubemaps.json was not written") : fail_to_write(targets[CUBEMAP_JSON].name);
    if (status == DONE && valid < c.count && !given[QUIET])
        warn("%d of %d points are inside geometry and have no cube map; --move moves them out", c.count - valid,
             c.count);
    if (status == DONE && c.greatest > 65504 && !given[QUIET])
        warn("the brightest light is %.3g; half floats in .ktx2 end at 65504, .exr has all of it", c.greatest);
    if (status == DONE && c.bar.shown)
        fprintf(stderr, "%s: %d cube maps, %.1f s\n", common.output, valid, *seconds);
    free_cubemaps(&c);
    return status;
}

#endif
