/* Demonstrates a whole tool on top of sbl.h: reads a scene file, renders it and writes a picture and statistics.
   `sbl_render --help` explains its options. */
#define _DEFAULT_SOURCE
#define SBL_IMPLEMENTATION
#define SBL_EGL
#include "../sbl.h"
#include "output_file.h"
#include "picture_file.h"
#include "scene_file.h"
#include "sensor_disc.h"
#define TOOL_NAME "sbl_render"
#define TOOL_MAKES "picture"
#include "tool.h"
#include "tool_options.h"
#include "tool_scene.h"
#include "tool_camera.h"

/* ---- the command line ---- */

static struct options {
    int channel, inspect[2], samples;
    double sensor_fov, target_error, facet_limit, exposure;
} options;

static const char *const channel_words[] = { "final", "radiance", "albedo", "normal", "position", "id", "depth",
    "sensors", "store", "error", NULL };  /* in the order of sbl_channel */

enum {
    OUTPUT = CAMERA_END, CHANNEL, TARGET_ERROR, SENSOR_FOV, FACET_LIMIT, SAMPLES, EXPOSURE, INSPECT, OPTION_COUNT
};

static const tool_option table[OPTION_COUNT] = {
    COMMON_ROWS,
    CAMERA_ROWS,
    [OUTPUT] = { "--output", "FILE", TEXT, &common.output, 0, 0, 0,
                 "also -o; .png (8-bit sRGB), .pfm or .exr (linear 32-bit floats); default sbl.png" },
    [CHANNEL] = { "--channel", "NAME", CHOICE, &options.channel, 0, 0, 0,
                  "final (default) | radiance (R: irradiance / pi, light without surface colour) | albedo | normal |\n"
                  "position | id | depth | sensors (which pixels had a sensor, and at which level) | store (bounced "
                  "light in\n"
                  "the cells of the store) | error (predicted standard error of the luminance of R, in the unit of "
                  "R; dark in\n"
                  "a .png without --exposure)",
                  channel_words },
    [TARGET_ERROR] = { "--target-error", "E", SHARES, &options.target_error, 1, 0.0001, 1,
                       "target error, such as 2% or 0.02: the root mean square error of R over the picture, divided by "
                       "the\n"
                       "mean of R; default by preset: 5%, 1.5%, 0.75%, with at most 512, 512, 1024 rays per sensor. "
                       "If E is\n"
                       "given, a sensor may use up to 32 times as many rays, and a small E takes long",
                       .synonym = "--error" },
    [SENSOR_FOV] = { "--sensor-fov", "DEGREES", NUMBERS, &options.sensor_fov, 1, 1, 179,
                     "field of view of a sensor, mode paper only; default 135" },
    [FACET_LIMIT] = { "--facet-limit", "PIXELS", NUMBERS, &options.facet_limit, 1, 0, 1e30,
                      "triangles of at most this height on the screen are lit with their geometric normals, larger "
                      "triangles with\n"
                      "the normals of the file; default 2" },
    [SAMPLES] = { "--samples", "N", INTEGERS, &options.samples, 1, 1, 64,
                  "anti-aliasing samples per pixel of channel final; default 1, 4, 16 by preset" },
    [EXPOSURE] = { "--exposure", "STOPS", NUMBERS, &options.exposure, 1, -100, 100,
                   "brightness of channels final, radiance, store and error in a .png: each stop doubles it; default "
                   "0" },
    [INSPECT] = { "--inspect", "X,Y", INTEGERS, options.inspect, 2, 0, 16383,
                  "instead of the scene, draws what the sensor at this pixel sees (a disc, 512 x 512), and prints\n"
                  "its sums; pixel 0,0 is at the upper left" },
};
static int given[OPTION_COUNT];

static void print_help(void) {
    printf("usage: sbl_render SCENE [options]\n\n"
           "Renders a scene file by sensor based lighting.\n"
           "SCENE: .obj .gltf .glb, and other formats that assimp reads (.fbx, .ply, ...)\n\n");
    tool_print_options(table + CAMERA_END, OPTION_COUNT - CAMERA_END);
    tool_print_options(table + COMMON_OPTIONS, CAMERA_END - COMMON_OPTIONS);
    tool_print_options(table, COMMON_OPTIONS);
    printf(
        "\nMaterials: OBJ Kd map_Kd Ke map_Ke d map_d (opacity below 0.5 is cut out); glTF base colour, emission with\n"
        "KHR_materials_emissive_strength, alphaMode MASK (BLEND is treated as MASK with cutoff 0.5). Metal and glossy\n"
        "surfaces are treated as diffuse surfaces of their base colour. Surfaces emit on both sides.\n"
        "Lights: glTF KHR_lights_punctual (candela are radiance times area, lux are irradiance; ranges are ignored), "
        "and\n"
        "the point, spot and directional lights of other formats.\n"
        "Colours in a .png: a normal n is shown as 0.5 + 0.5 n, a position relative to the visible bounds, a small "
        "depth as\n"
        "bright, an id as an arbitrary colour, sensors from blue (first level) through green and yellow to red (last\n"
        "level). A .pfm or .exr contains the values unchanged.\n"
        "\nA file is written completely or not at all: at the end, a temporary file replaces the old file and takes "
        "its\n"
        "permissions. If FILE is a symbolic link, the file that it refers to is replaced. Other hard links of the old "
        "file\n"
        "keep the old contents. Input files are never overwritten. Ctrl-C, SIGTERM and SIGHUP save the unfinished\n"
        "picture, if there is one, as NAME.partial.png (.pfm, .exr); a second signal ends the program at once.\n"
        "\nExit status: 0 success; 1 failure, with one line on stderr; 2 wrong usage; after a signal: 130 (SIGINT), "
        "143\n"
        "(SIGTERM), 129 (SIGHUP).\n");
}

static int ends_with(const char *path, const char *ending) { return scene__ends_with(path, ending); }

static int parse(int argc, char **argv) {
    const tool_command command = { argc, argv, table, OPTION_COUNT, given, &common.scene, 1 };
    int status = tool_parse(&command);
    if (status != DONE || given[HELP] || given[VERSION]) return status;
    if (!common.output) common.output = "sbl.png";
    status = common_check(given);
    if (status != DONE) return status;
    if (!ends_with(common.output, ".png") && !ends_with(common.output, ".pfm") && !ends_with(common.output, ".exr"))
        return misuse("--output %s: the name must end in .png, .pfm or .exr", common.output);
#ifndef SBL_RENDER_OPENEXR
    if (ends_with(common.output, ".exr"))
        return fail("--output %s: this program was built without OpenEXR; use .pfm", common.output);
#endif
    if (given[SENSOR_FOV] && common_mode(given) != SBL_MODE_PAPER)
        return misuse("--sensor-fov needs --mode paper: other sensors see the whole hemisphere");
    if (given[INSPECT] && given[CHANNEL])
        return misuse("--inspect draws a sensor, --channel chooses a picture of the scene; give only one of them");
    return DONE;
}

/* ---- output files ---- */

enum { PICTURE = OWN_TARGETS, PARTIAL };  /* PARTIAL: an unfinished picture, room.partial.png */

/* Lists the files that may be written. Returns the exit status. */
static int find_targets(void) {
    static char partial[PATH_MAX];
    const char *ending = strrchr(common.output, '.');
    snprintf(partial, sizeof partial, "%.*s.partial%s", (int)(ending - common.output), common.output, ending);
    targets_begin();
    output_find(&targets[PICTURE], common.output);
    output_find(&targets[PARTIAL], partial);
    target_count = PARTIAL + 1;
    return targets_check(PARTIAL);
}

typedef struct view { const image *picture; sbl_channel channel; } view;

static int write_shown(FILE *out, const void *what) {
    const view *s = (const view *)what;
    return picture_write(out, common.output, s->picture, s->channel, options.exposure);
}

/* Writes the picture; after a signal, the unfinished picture. done: progress, 0 to 1. Returns the exit status. */
static int keep_picture(const view *s, float done) {
    if (!interrupted && target_write(&targets[PICTURE], write_shown, s, 0)) return DONE;
    if (!interrupted) return fail_to_write(common.output);
    if (!target_write(&targets[PARTIAL], write_shown, s, 1))
        return stop("the unfinished picture cannot be written to %s: %s", targets[PARTIAL].name, why_not_written());
    return stop("the unfinished picture (%.0f %%) is in %s", floor(100 * (double)done), targets[PARTIAL].name);
}

/* ---- --inspect: one sensor ---- */

enum { DISC = 512, LAMPS_SHOWN = 20 };

static double sum_of(const float v[3]) { return (double)v[0] + (double)v[1] + (double)v[2]; }

static void describe_lamp(const sbl_sensor *s, int number) {
    const sbl_sensor_lamp *l = &s->lamps[number];
    if (l->kind == SBL_LAMP_TRIANGLE) printf("  triangle %d of mesh %d:", l->number, l->mesh);
    else printf("  %s %d:", l->kind == SBL_LAMP_LIGHT ? "light" : "texel of the sky", l->number);
    if (sum_of(l->unhindered) > 0)
        printf(" unhindered %g %g %g,", (double)l->unhindered[0], (double)l->unhindered[1], (double)l->unhindered[2]);
    printf(" %d of %d rays arrive\n", l->open, l->rays);
}

/* Prints the lamps that contribute most, or would contribute most if nothing blocked them. */
static void describe_lamps(const sbl_sensor *s) {
    double *worth = (double *)calloc((size_t)s->lamp_count + 1, sizeof *worth);
    int i, k, best;
    if (!worth) return;
    for (i = 0; i < s->lamp_count; i++) worth[i] = sum_of(s->lamps[i].unhindered);
    for (i = 0; i < s->ray_count; i++)
        if (s->rays[i].lamp >= 0) worth[s->rays[i].lamp] += sum_of(s->rays[i].radiance);
    for (i = 0; i < s->lamp_count && i < LAMPS_SHOWN; i++) {
        for (k = best = 0; k < s->lamp_count; k++)
            if (worth[k] > worth[best]) best = k;
        describe_lamp(s, best);
        worth[best] = -1;
    }
    if (s->lamp_count > LAMPS_SHOWN) printf("  and %d more lamps\n", s->lamp_count - LAMPS_SHOWN);
    free(worth);
}

/* Prints what the sensor measured. sheet_sum: sum of weight times radiance over the sheet. */
static void describe(const sbl_sensor *s, const double sheet_sum[3]) {
    int i, aimed = 0;
    for (i = 0; i < s->ray_count; i++) aimed += s->rays[i].lamp >= 0;
    printf("pixel %d,%d: %s, level %d%s\n", options.inspect[0], options.inspect[1],
           s->sensed ? "had a sensor" : "was interpolated; this is what a sensor measures there", s->level,
           s->valid ? "" : ", stuck inside geometry");
    printf("position %g %g %g\nnormal %g %g %g\n", (double)s->position[0], (double)s->position[1],
           (double)s->position[2],
           (double)s->normal[0], (double)s->normal[1], (double)s->normal[2]);
    printf("R %g %g %g\n", (double)s->radiance[0], (double)s->radiance[1], (double)s->radiance[2]);
    if (s->noise > 0) printf("standard error %g\n", (double)s->noise);
    if (s->looks > 1) printf("mean of %d looks; the values below are those of the first look\n", s->looks);
    printf("sum of weight * radiance over the sheet %g %g %g\nsum of weights %.6f, ", sheet_sum[0], sheet_sum[1],
           sheet_sum[2],
           (double)s->weight_sum);
    if (s->view_count) printf("%d views, %d x %d texels\n", s->view_count, s->sheet_width, s->sheet_height);
    else printf("%d rays\n", s->ray_count - aimed);
    printf("back faces %.2f %%, nearest surface %g, mean distance %g\n", 100 * (double)s->back_share,
           (double)s->hit_min,
           (double)s->hit_mean);
    printf("from lamps %g %g %g: %d lamps, %d rays towards them\n", (double)s->from_lamps[0], (double)s->from_lamps[1],
           (double)s->from_lamps[2], s->lamp_count, aimed);
    describe_lamps(s);
}

/* Draws the sensor's views or rays into shown, and prints its sums. */
static sbl_result inspect(sbl_context *context, image *shown) {
    sbl_sensor s;
    const int x = options.inspect[0], y = options.inspect[1];
    sbl_result result = sbl_inspect_sensor(context, x, y, &s, NULL, NULL, 0);
    float *radiance, *weights;
    double sum[3] = { 0, 0, 0 };
    size_t texels, i;
    if (result != SBL_SUCCESS) return result;
    texels = (size_t)s.sheet_width * (size_t)s.sheet_height;
    shown->width = s.view_count ? s.sheet_width : DISC;
    shown->height = s.view_count ? s.sheet_height : DISC;
    shown->components = 3;
    shown->values = (float *)malloc((size_t)shown->width * (size_t)shown->height * 3 * sizeof *shown->values);
    radiance = (float *)malloc(texels * 4 * sizeof *radiance);
    weights = (float *)malloc(texels * sizeof *weights);
    result = SBL_ERROR_OUT_OF_MEMORY;
    if (radiance && weights && shown->values) result = sbl_inspect_sensor(context, x, y, &s, radiance, weights, texels);
    for (i = 0; i < 3 * texels && result == SBL_SUCCESS; i++) {
        sum[i % 3] += (double)weights[i / 3] * (double)radiance[i / 3 * 4 + i % 3];
        if (s.view_count) shown->values[i] = radiance[i / 3 * 4 + i % 3];
    }
    if (result == SBL_SUCCESS) {
        if (!s.view_count) sensor_disc(&s, DISC, shown->values);
        describe(&s, sum);
    }
    free(radiance);
    free(weights);
    return result;
}

/* ---- the whole tool ---- */

static void fill_desc(sbl_picture_desc *desc, progress *bar) {
    memset(desc, 0, sizeof *desc);
    desc->width = camera.size[0];
    desc->height = camera.size[1];
    desc->options = common_options(given, bar);
    desc->target_error = (float)options.target_error;
    desc->sensor_fov = (float)options.sensor_fov;
    desc->tile = common.tile;
    if (given[THRESHOLD]) desc->threshold = zero_or(common.threshold);
    if (given[FACET_LIMIT]) desc->facet_limit = zero_or(options.facet_limit);
    if (given[FILTER_RADIUS]) desc->filter_radius = (int)zero_or(common.filter_radius);
    desc->samples = (sbl_channel)options.channel == SBL_CHANNEL_FINAL ? options.samples
                                                                      : 1; /* other channels show pixel centres */
}

static int render(const tool_task *task, double *seconds) {
    const sbl_channel channel = given[INSPECT] ? SBL_CHANNEL_FINAL : (sbl_channel)options.channel;
    progress bar = { !given[QUIET] && isatty(STDERR_FILENO), now(), 0 };
    sbl_context *context = task->context;
    sbl_bounds bounds;
    sbl_picture_desc desc;
    image picture = { 0, 0, 0, NULL };
    const view all = { &picture, channel };
    sbl_result result;
    int status = DONE;
    fill_desc(&desc, &bar);
    bounds = sbl_query_bounds(context);
    if (!camera_place(desc.world_to_view, desc.view_to_clip, task->file, given, bounds.lowest, bounds.highest))
        return camera_misuse();
    result = sbl_begin_picture(context, &desc);
    if (result == SBL_SUCCESS) result = given[INSPECT] ? work(context) : work_to_save(context);
    if (bar.shown) fprintf(stderr, "\r%70s\r", "");
    if (!given[INSPECT] && (result == SBL_SUCCESS || result == SBL_UNFINISHED))
        result = picture_read(context, desc.width, desc.height, channel, &picture);
    else if (result == SBL_SUCCESS) result = inspect(context, &picture);
    *seconds = now() - task->start;
    if (result == SBL_SUCCESS) status = keep_picture(&all, sbl_progress(context));
    else if (result == SBL_UNFINISHED) status = stop("there is no picture yet");
    else status = fail_with(task->said, common.scene, result);
    free(picture.values);
    if (status == DONE && bar.shown)
        fprintf(stderr, "%s: %d x %d, %.0f sensors, %.1f s\n", common.output, picture.width, picture.height,
                (double)sbl_query_stats(context).sensors.count, *seconds);
    return status;
}

int main(int argc, char **argv) {
    const double start = now();
    int status = parse(argc, argv);
    if (status != DONE) return status;
    if (given[HELP]) { print_help(); return fflush(stdout) == 0 ? DONE : FAILED; }
    if (given[VERSION]) { printf("sbl_render %s\n", sbl_version()); return fflush(stdout) == 0 ? DONE : FAILED; }
    catch_signals();
    status = find_targets();
    if (status == DONE) status = tool_run(start, given, render, NULL);
    targets_free();
    return status;
}
