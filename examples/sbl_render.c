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
#define TOOL_DRAWS
#include "tool.h"
#include "tool_options.h"
#include "tool_scene.h"
#include "tool_survey.h"
#include "tool_camera.h"
#include "tool_studio.h"

/* ---- the command line ---- */

enum { NO_TONE, NEUTRAL, AGX, ERROR_STOPS = 5 };

static struct options {
    int channel, inspect[2], samples, tone, window[4];
    double sensor_fov, target_error, facet_limit, exposure;  /* exposure: NaN is auto */
} options = { .tone = NEUTRAL, .exposure = NAN };

static const char *const channel_words[] = { "final", "radiance", "albedo", "normal", "position", "id", "depth",
    "sensors", "store", "error", NULL };  /* in the order of sbl_channel */

static const char *const tone_words[] = { "none", "neutral", "agx", NULL };
static const char *const exposure_words[] = { "auto", NULL };

enum {
    OUTPUT = CAMERA_END, CHANNEL, TARGET_ERROR, SENSOR_FOV, FACET_LIMIT, SAMPLES, EXPOSURE, TONE, INSPECT, STUDIO,
    WINDOW,
    OPTION_COUNT
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
                  "R; in a\n"
                  ".png 5 stops brighter than radiance)",
                  channel_words },
    [TARGET_ERROR] = { "--target-error", "E", SHARES, &options.target_error, 1, 0.0001, 1,
                       "target error, such as 2% or 0.02: the root mean square error of R over the picture, divided by "
                       "the\n"
                       "mean of R; default by preset: 5%, 1.5%, 0.75%, with at most 1024, 1024, 2048 rays per sensor. "
                       "If E is\n"
                       "given, a sensor may use up to 16 times as many rays, and a small E takes long",
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
                   "auto:\n"
                   "the mean light is shown like a white surface of radiance 0.7, if highlights permit",
                   exposure_words },
    [TONE] = { "--tone", "NAME", CHOICE, &options.tone, 0, 0, 0,
               "how channel final in a .png shows light that is too bright for a screen: neutral (default; keeps "
               "colours,\n"
               "compresses highlights) | agx (a soft filmic curve) | none (everything above 1 is white)",
               tone_words },
    [INSPECT] = { "--inspect", "X,Y", INTEGERS, options.inspect, 2, 0, 16383,
                  "instead of the scene, draws what the sensor at this pixel sees (a disc, 512 x 512), and prints\n"
                  "its sums; 0,0 is the upper left pixel (of the --window)" },
    [WINDOW] = { "--window", "X,Y,W,H", INTEGERS, options.window, 4, 0, 16384,
                 "makes only a part of the picture: W x H pixels, the first at X,Y; 0,0 is at the upper left. Parts "
                 "fit\n"
                 "together; in mode gi, give all the same --store. A small picture of the whole is made first, for "
                 "the\n"
                 "exposure and for the mean of --target-error. A .exr file stores where the part lies (data window) "
                 "and the\n"
                 "size of the whole" },
    [STUDIO] = { "--studio", NULL, FLAG, NULL, 0, 0, 0,
                 "replaces the lights of the file (surfaces that emit stay) by a sky that fades to the horizon and a "
                 "soft sun\n"
                 "from the upper left, with a grey ground under an object. A room that is looked at from inside gets a "
                 "lamp\n"
                 "inside instead. Files without any light get this by themselves, unless --sky or --mode paper is "
                 "given" },
};
static int given[OPTION_COUNT];

static const tool_line lines[] = {
    { TOOL_HEADING, "What:" },
    { CHANNEL, "final (default), radiance, albedo, normal, depth, ..." },
    { MODE, "gi (default: all light), direct, ambient or paper" },
    { INSPECT, "shows what the sensor at this pixel measures" },
    { WINDOW, "makes only a part of the picture" },
    { TOOL_HEADING, "Camera:" },
    CAMERA_LINES,
    { TOOL_HEADING, "Light:" },
    LIGHT_LINES, { STUDIO, "lights the scene as a photographer's studio does" },
    { TOOL_HEADING, "Quality:" },
    { TARGET_ERROR, "accepted error, such as 2%; a small one takes long" },
    { SAMPLES, "anti-aliasing samples per pixel" },
    QUALITY_LINES, { FACET_LIMIT, NULL }, { SENSOR_FOV, NULL },
    { TOOL_HEADING, "Output:" },
    { OUTPUT, "also -o; .png, .pfm or .exr; default sbl.png" },
    { EXPOSURE, "each stop makes a .png twice as bright; or auto" },
    { TONE, "curve of a .png: neutral (default), agx or none" },
    OUTPUT_LINES,
    { TOOL_HEADING, "Safety:" },
    SAFETY_LINES
};

static void print_help(void) {
    printf("usage: sbl_render SCENE [options]\n\n"
           "Renders a scene file: .obj .gltf .glb, and others that assimp reads (.fbx, ...).\n");
    tool_print_help(table, OPTION_COUNT, lines, (int)(sizeof lines / sizeof *lines), common.help_all);
    if (!common.help_all) return;
    printf(
        "\nMaterials: OBJ Kd map_Kd Ke map_Ke d map_d (opacity below 0.5 is cut out); glTF base colour, emission with\n"
        "KHR_materials_emissive_strength, alphaMode MASK (BLEND is treated as MASK with cutoff 0.5). Metal and glossy\n"
        "surfaces are treated as diffuse surfaces of their base colour. Surfaces emit on both sides.\n"
        "Lights: glTF KHR_lights_punctual (candela are radiance times area, lux are irradiance; ranges are ignored), "
        "and\n"
        "the point, spot and directional lights of other formats. Lights that Blender exported as glTF are divided by "
        "683,\n"
        "because emission is not multiplied by that; see --light-scale.\n"
        "Colours in a .png: a normal n is shown as 0.5 + 0.5 n, a position relative to the visible bounds, a small "
        "depth as\n"
        "bright, an id as an arbitrary colour, sensors from blue (first level) through green and yellow to red (last\n"
        "level). A .pfm or .exr contains the values unchanged.\n"
        "\nA file is written completely or not at all: at the end, a temporary file replaces the old file and takes "
        "its\n"
        "permissions. If FILE is a symbolic link, the file that it refers to is replaced. Other hard links of the old "
        "file\n"
        "keep the old contents. Input files are never overwritten.\n"
        "\nIf you press Ctrl-C, the unfinished picture is saved beside the output, as NAME.partial.png (.pfm, .exr), "
        "and the\n"
        "program ends. If nothing can be shown yet, nothing is saved. A second Ctrl-C ends the program at once, and\n"
        "so does the first one after 6 seconds in which the graphics driver does not return. The signals SIGTERM\n"
        "and SIGHUP do the same.\n"
        "\nExit status: 0 success; 1 failure, with one line on stderr; 2 wrong usage; after a signal: 130 (Ctrl-C), "
        "143\n"
        "(SIGTERM), 129 (SIGHUP).\n");
}

static int ends_with(const char *path, const char *ending) { return scene__ends_with(path, ending); }

/* Returns whether no light need be measured: the channel shows only surfaces, without --inspect and --store. */
static int needs_no_light(sbl_channel channel) {
    return channel >= SBL_CHANNEL_ALBEDO && channel <= SBL_CHANNEL_DEPTH && !given[INSPECT] && !given[STORE];
}

/* Notes options that have no effect on the picture. */
static void note_effects(void) {
    const sbl_channel channel = (sbl_channel)options.channel;
    const int is_light = channel == SBL_CHANNEL_FINAL || channel == SBL_CHANNEL_RADIANCE ||
        channel == SBL_CHANNEL_STORE || channel == SBL_CHANNEL_ERROR;
    const int paper = common_mode(given) == SBL_MODE_PAPER;
    common_note(given, table);
    note_if(paper, given, table, TARGET_ERROR, "in --mode paper, --threshold decides");
    note_if(needs_no_light(channel), given, table, TARGET_ERROR, "the channel shows no light");
    if (!paper && !needs_no_light(channel)) common_note_refinement(given, table, TARGET_ERROR);
    note_if(options.samples > 1 && (channel != SBL_CHANNEL_FINAL || given[INSPECT]), given, table, SAMPLES,
            "only channel final is anti-aliased");
    note_if(!ends_with(common.output, ".png"), given, table, EXPOSURE, "only a .png is exposed");
    note_if(ends_with(common.output, ".png") && !is_light, given, table, EXPOSURE,
            "only final, radiance, store and error are exposed");
    note_if(!ends_with(common.output, ".png") || channel != SBL_CHANNEL_FINAL || given[INSPECT], given, table, TONE,
            "only channel final in a .png has a tone");
}

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
    if (given[WINDOW]) {
        const int *w = options.window;
        if (w[2] < 1 || w[3] < 1 || w[0] + w[2] > camera.size[0] || w[1] + w[3] > camera.size[1])
            return misuse("--window %d,%d,%d,%d: must be at least 1 x 1 and inside the picture of %d x %d", w[0], w[1],
                          w[2], w[3], camera.size[0], camera.size[1]);
    }
    if (given[STUDIO] && given[SKY])
        return misuse("--studio has a sky of its own; give only one of --studio and --sky");
    if (given[STUDIO] && common_mode(given) == SBL_MODE_PAPER)
        return misuse("--studio: --mode paper allows no sun and no sky picture; choose another --mode");
    note_effects();
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
    return targets_check(PARTIAL, given);
}

typedef struct view { const image *picture; sbl_channel channel; double stops; } view;

static int write_shown(FILE *out, const void *what) {
    const view *s = (const view *)what;
    return picture_write(out, common.output, s->picture, s->channel, s->stops);
}

/* Returns whether the output is what a screen shows: exposed and tone-mapped. */
static int is_display(sbl_channel channel) {
    return ends_with(common.output, ".png") && channel == SBL_CHANNEL_FINAL && options.tone != NO_TONE &&
           !given[INSPECT];
}

/* Says what would help if more than a tenth of a picture for a screen is white or black. stops: exposure that the
   values do not contain yet; chosen: the whole exposure */
static void warn_of_extremes(messages *said, const image *picture, double stops, double chosen) {
    const size_t pixels = (size_t)picture->width * (size_t)picture->height;
    const float scale = (float)pow(2, stops);
    size_t i, whites = 0, blacks = 0;
    for (i = 0; i < pixels; i++) {
        unsigned char rgb[3];
        sbl_encode_srgb8(rgb, picture->values + 3 * i, 3, scale);
        whites += rgb[0] == 255 && rgb[1] == 255 && rgb[2] == 255;
        blacks += rgb[0] == 0 && rgb[1] == 0 && rgb[2] == 0;
    }
    if (10 * whites > pixels)
        warn_later(said, "%.0f %% of the picture is white: a lower --exposure shows it darker (chosen: %.1f)",
                   100.0 * (double)whites / (double)pixels, chosen);
    if (10 * blacks > pixels)
        warn_later(said, "%.0f %% of the picture is black: no light gets there, or the camera sees nothing; try --sky "
                   "R,G,B, another camera, or a higher --exposure (chosen: %.1f)",
                   100.0 * (double)blacks / (double)pixels, chosen);
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
    if (s->hit_mean > 0)
        printf("back faces %.2f %%, nearest surface %g, mean distance %g\n", 100 * (double)s->back_share,
               (double)s->hit_min, (double)s->hit_mean);
    else printf("no surface was met\n");
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

/* ---- camera and light, where the file and the options leave them open ---- */

static struct { float world_to_view[16], view_to_clip[16]; } placed;  /* the camera */

static void describe_camera(const camera_view *c, const survey *s) {
    double at[3], length = 0, distance = 0;
    int k;
    for (k = 0; k < 3; k++) length += c->forward[k] * c->forward[k];
    for (k = 0; k < 3; k++) distance += (survey__center(s, k) - c->eye[k]) * c->forward[k] / length;
    for (k = 0; k < 3; k++) at[k] = c->eye[k] + c->forward[k] * (distance > 0 ? distance : 1);
    detail("camera: %s: --eye %.6g,%.6g,%.6g --look-at %.6g,%.6g,%.6g --up %.6g,%.6g,%.6g --fov %.4g", c->where,
           c->eye[0], c->eye[1], c->eye[2], at[0], at[1], at[2], c->up[0], c->up[1], c->up[2], c->fov);
}

/* Returns whether black behind the scene is shown as a grey backdrop: for screens, if the file has light of its own and
   no option chooses a sky. */
static int wants_backdrop(const scene_file *file) {
    return is_display((sbl_channel)options.channel) && !given[SKY] && !given[STUDIO] && is_lit(&file->scene);
}

static studio light_of_studio;  /* the scene refers to it until the end */

/* Sets the scene again, with the light of a studio. chosen: the camera without the options. Returns the exit status. */
static int light_studio(tool_task *task, sbl_scene_desc *scene, const survey *s, const camera_view *chosen,
                        const double eye[3]) {
    const char *words = NULL;
    double enclosed = 0;
    sbl_result result = SBL_SUCCESS;
    if (s->kind == SURVEY_OBJECT) result = survey_enclosed(task->context, eye, &enclosed);
    if (result == SBL_SUCCESS) {
        words = studio_light(&light_of_studio, scene, s, chosen, eye, enclosed);
        task->said->warnings_kept = 0;  /* they are repeated when the scene is set again */
        result = words ? sbl_set_scene(task->context, scene) : SBL_ERROR_OUT_OF_MEMORY;
    }
    if (words) detail("light: %s", words);
    if (!given[STUDIO]) task->light = words;
    return result == SBL_SUCCESS ? DONE
         : result == SBL_UNFINISHED ? stop("no picture was started") : fail_with(task->said, common.scene, result);
}

/* Chooses the camera, and the light of a file without light. */
static int arrange(tool_task *task, sbl_scene_desc *scene) {
    const int relight = given[STUDIO] ||
        (lit_by_us(&task->file->scene, given) && common_mode(given) != SBL_MODE_PAPER);
    camera_view chosen, shot;
    survey s;
    sbl_result result = SBL_SUCCESS;
    survey_begin(&s, task->context);
    if (relight || (!given[EYE] && !camera_of_file(task->file, &shot, &s))) result = survey_take(&s, task->context);
    if (result == SBL_UNFINISHED) return stop("no picture was started");
    if (result != SBL_SUCCESS) return fail_with(task->said, common.scene, result);
    camera_choose(&chosen, task->file, given, &s);
    shot = chosen;
    if (!camera_place(placed.world_to_view, placed.view_to_clip, &shot, given, &s)) return camera_misuse();
    describe_camera(&shot, &s);
    task->unplaced = !given[EYE] && camera_is_unplaced(task->file, &s);
    return relight ? light_studio(task, scene, &s, &chosen, shot.eye) : DONE;
}

/* ---- a target error that was not reached ---- */

/* Writes why the target was missed, and what would help. Stored light causes a part of the error that sensors cannot
   reduce. They reduce their own part only to 0.84 of the target, or to half of the part of stored light if that is
   more. A smaller target can make up for stored light. */
static void advise(const sbl_stats *s, char *out, size_t size) {
    enum { CELLS_MOST = 1 << 20 };
    const double target = (double)s->picture.target_error, expected = (double)s->picture.expected_error;
    const double stored = (double)s->picture.stored_error, left2 = target * target - stored * stored;
    const int cells = s->store.max_cells;
    char smaller[64] = "", more[64] = "";
    if (expected * expected - stored * stored <= fmax(target * target, stored * stored)) {
        if (left2 > 0.04 * target * target)
            snprintf(smaller, sizeof smaller, "; --target-error %.2g%% would help", 100 * sqrt(left2) / 0.84);
        if (cells < CELLS_MOST)  /* more cells are smaller, but the light of each is measured with fewer rays */
            snprintf(more, sizeof more, "; --max-bounce-cells %d may help", cells < CELLS_MOST / 4 ? 4 * cells
                                                                                                : CELLS_MOST);
        snprintf(out, size, "stored light limits it%s%s", smaller, more);
    } else if (!given[TARGET_ERROR])
        snprintf(out, size, "by default, a sensor may measure only so often; --target-error %g%% allows more",
                 100 * target);
    else snprintf(out, size, "sensors measured as often as they may; a larger --filter-radius would help");
}

static void warn_of_missed_target(messages *said, const sbl_stats *s) {
    const double target = (double)s->picture.target_error, expected = (double)s->picture.expected_error;
    char help[256];
    if (!(target > 0) || !(expected > 1.1 * target) || given[RAYS] || given[THRESHOLD]) return;
    if (expected > 1) return;  /* errors are relative to the mean, which is almost 0: the picture is black */
    advise(s, help, sizeof help);
    warn_later(said, "the predicted error is %.2g %%, %.2g %% was asked: %s", 100 * expected, 100 * target, help);
}

/* Notes that a backdrop fills more than a tenth of the picture. */
static void note_backdrop(const sbl_stats *s) {
    const double pixels = (double)s->picture.width * s->picture.height;
    if (10 * (pixels - s->picture.visible_pixels) > pixels)
        tell("%s: the file has lights but no sky: a grey backdrop, which lights nothing, is shown behind it; --sky "
             "0,0,0 turns it off", common.scene);
}

/* ---- the whole tool ---- */

static void fill_desc(sbl_picture_desc *desc, const scene_file *file, progress *bar) {
    memset(desc, 0, sizeof *desc);
    desc->width = camera.size[0];
    desc->height = camera.size[1];
    memcpy(desc->window, options.window, sizeof desc->window);
    desc->options = common_options(given, bar);
    if (needs_no_light((sbl_channel)options.channel) && common_mode(given) != SBL_MODE_PAPER)
        desc->options.mode = SBL_MODE_DIRECT;  /* does the least work before it draws surfaces */
    desc->target_error = (float)options.target_error;
    desc->sensor_fov = (float)options.sensor_fov;
    desc->tile = common.tile;
    if (given[THRESHOLD]) desc->threshold = zero_or(common.threshold);
    if (given[FACET_LIMIT]) desc->facet_limit = zero_or(options.facet_limit);
    if (given[FILTER_RADIUS]) desc->filter_radius = (int)zero_or(common.filter_radius);
    if (ends_with(common.output, ".png")) {
        static const sbl_tone tones[] = { SBL_TONE_NONE, SBL_TONE_NEUTRAL, SBL_TONE_AGX };
        desc->auto_exposure = isnan(options.exposure);
        desc->exposure = desc->auto_exposure ? 0 : (float)options.exposure;
        desc->tone = is_display((sbl_channel)options.channel) ? tones[options.tone] : SBL_TONE_NONE;
        if (wants_backdrop(file)) memcpy(desc->backdrop, studio_backdrop, sizeof desc->backdrop);
    }
    desc->samples = (sbl_channel)options.channel == SBL_CHANNEL_FINAL ? options.samples
                                                                      : 1; /* other channels show pixel centres */
}

/* Makes a small picture of the whole, and gives its mean and exposure to the window in desc. Returns SBL_UNFINISHED
   after a signal. */
static sbl_result look_at_whole(sbl_context *context, sbl_picture_desc *desc) {
    enum { ACROSS = 256 };  /* the small picture is at most this many pixels wide and high */
    const double shrink = fmax(1, (double)(desc->width > desc->height ? desc->width : desc->height) / ACROSS);
    sbl_picture_desc small = *desc;
    sbl_stats stats;
    sbl_result result;
    small.width = (int)ceil(desc->width / shrink);
    small.height = (int)ceil(desc->height / shrink);
    memset(small.window, 0, sizeof small.window);
    small.options.preset = SBL_PRESET_DRAFT;
    small.target_error = 0;
    small.samples = 1;
    result = sbl_begin_picture(context, &small);
    if (result == SBL_SUCCESS) result = work(context);
    stats = sbl_query_stats(context);
    memcpy(desc->mean_radiance, stats.picture.mean_radiance, sizeof desc->mean_radiance);
    if (desc->auto_exposure) desc->exposure = stats.picture.exposure;
    desc->auto_exposure = 0;
    return result;
}

static int render(const tool_task *task, double *seconds) {
    const sbl_channel channel = given[INSPECT] ? SBL_CHANNEL_FINAL : (sbl_channel)options.channel;
    const int display = is_display(channel);
    progress bar = { !given[QUIET] && isatty(STDERR_FILENO), now(), 0 };
    sbl_context *context = task->context;
    sbl_picture_desc desc;
    image picture = { 0 };
    view all = { &picture, channel, 0 };
    sbl_stats stats;
    sbl_result result;
    int status = DONE;
    if (given[WINDOW] && !given[INSPECT]) {
        memcpy(picture.at, options.window, sizeof picture.at);
        memcpy(picture.whole, camera.size, sizeof picture.whole);
    }
    fill_desc(&desc, task->file, &bar);
    memcpy(desc.world_to_view, placed.world_to_view, sizeof desc.world_to_view);
    memcpy(desc.view_to_clip, placed.view_to_clip, sizeof desc.view_to_clip);
    result = given[WINDOW] && !needs_no_light(channel) ? look_at_whole(context, &desc) : SBL_SUCCESS;
    if (result == SBL_UNFINISHED) return stop("there is no picture yet");
    if (result == SBL_SUCCESS) result = sbl_begin_picture(context, &desc);
    if (result == SBL_SUCCESS && needs_no_light(channel)) result = work_until(context, channel);
    else if (result == SBL_SUCCESS) result = given[INSPECT] ? work(context) : work_to_save(context);
    if (bar.shown) fprintf(stderr, "\r%70s\r", "");
    stats = sbl_query_stats(context);
    if (!given[INSPECT] && (result == SBL_SUCCESS || result == SBL_UNFINISHED))
        result = picture_read(context, stats.picture.width, stats.picture.height,
                              display ? SBL_CHANNEL_DISPLAY : channel, &picture);
    else if (result == SBL_SUCCESS) result = inspect(context, &picture);
    *seconds = now() - task->start;
    if (!display) all.stops = (double)sbl_query_stats(context).picture.exposure;  /* is part of a display's values */
    if (channel == SBL_CHANNEL_ERROR && isnan(options.exposure)) all.stops += ERROR_STOPS;
    if (result == SBL_SUCCESS) status = keep_picture(&all, sbl_progress(context));
    else if (result == SBL_UNFINISHED) status = stop("there is no picture yet");
    else status = fail_with(task->said, common.scene, result);
    if (status == DONE && channel == SBL_CHANNEL_FINAL && !given[INSPECT] &&
        ends_with(common.output, ".png"))
        warn_of_extremes(task->said, &picture, all.stops, (double)sbl_query_stats(context).picture.exposure);
    free(picture.values);
    stats = sbl_query_stats(context);
    if (status == DONE && bar.shown)
        fprintf(stderr, "%s: %d x %d, %.0f sensors, %.1f s\n", common.output, picture.width, picture.height,
                (double)stats.sensors.count, *seconds);
    if (status == DONE && !given[INSPECT]) warn_of_missed_target(task->said, &stats);
    if (status == DONE && desc.backdrop[0] > 0 && !given[QUIET]) note_backdrop(&stats);
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
    if (status == DONE) status = tool_run(start, given, render, NULL, arrange);
    studio_free(&light_of_studio);
    targets_free();
    return status;
}
