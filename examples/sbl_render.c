/* Demonstrates a complete tool on top of sbl.h: it reads a scene file, renders it, and writes a picture and statistics.
   `sbl_render --help` explains its options. */
#define _DEFAULT_SOURCE
#define SBL_IMPLEMENTATION
#define SBL_EGL
#include "../sbl.h"
#include "output_file.h"
#include "picture_file.h"
#include "part_list.h"
#include "picture_parts.h"
#include "scene_file.h"
#include "sensor_disc.h"
#include "sensor_words.h"
#define TOOL_NAME "sbl_render"
#define TOOL_MAKES "picture"
#define TOOL_DRAWS
#include "tool.h"
#include "tool_options.h"
#include "tool_scene.h"
#include "tool_survey.h"
#include "tool_camera.h"
#include "tool_studio.h"
#include "tool_part.h"
#include "tool_plan.h"
#include "tool_windows.h"
#include "tool_frames.h"

/* ---- the command line ---- */

enum { NO_TONE, NEUTRAL, AGX };

static struct options {
    int channel, inspect[2], samples, tone, window[4];
    part_choice part;
    double sensor_fov, target_error, facet_limit, exposure;  /* exposure: NaN means automatic */
} options = { .tone = NEUTRAL, .exposure = NAN };

static const char *const channel_words[] = { "final", "radiance", "albedo", "normal", "position", "id", "depth",
    "sensors", "store", "error", "display", "looks", "specular", "specular_albedo", "radiance_error", NULL };
static const sbl_channel channels[] = { SBL_CHANNEL_FINAL, SBL_CHANNEL_RADIANCE, SBL_CHANNEL_ALBEDO,
    SBL_CHANNEL_NORMAL, SBL_CHANNEL_POSITION, SBL_CHANNEL_ID, SBL_CHANNEL_DEPTH, SBL_CHANNEL_SENSORS,
    SBL_CHANNEL_STORE, SBL_CHANNEL_ERROR, SBL_CHANNEL_DISPLAY, SBL_CHANNEL_LOOKS, SBL_CHANNEL_SPECULAR,
    SBL_CHANNEL_SPECULAR_ALBEDO, SBL_CHANNEL_RADIANCE_ERROR };


enum {
    OUTPUT = FRAMES_END, CHANNEL, TARGET_ERROR, SENSOR_FOV, FACET_LIMIT, SAMPLES, EXPOSURE, TONE, INSPECT, STUDIO,
    WINDOW, PART, PLAN, RESUME,
    OPTION_COUNT
};

static const tool_option table[OPTION_COUNT] = {
    COMMON_ROWS,
    CAMERA_ROWS,
    FRAMES_ROWS,
    [OUTPUT] = { "--output", "FILE", TEXT, &common.output, 0, 0, 0,
                 "also -o; .png (8-bit sRGB), .pfm or .exr (linear 32-bit floats); default sbl.png" },
    [CHANNEL] = { "--channel", "NAME", CHOICE, &options.channel, 0, 0, 0,
                  "final             the default: the finished picture\n"
                  "radiance          R: irradiance / pi, light without surface colour\n"
                  "albedo            surface colour; where there are reflections, that of the diffuse component\n"
                  "normal            in world space\n"
                  "position          in world space\n"
                  "id                a number for each mesh\n"
                  "depth             distance along the view axis\n"
                  "sensors           which pixels had a sensor, and at which level\n"
                  "looks             how often each sensor measured\n"
                  "store             bounced light in the cells of the store\n"
                  "error             predicted standard error of the luminance of final where there are reflections, "
                  "otherwise of R; a .png shows it 5 stops brighter\n"
                  "radiance_error    the same, always of R\n"
                  "display           final with exposure and --tone, as in a .png of final\n"
                  "specular          mean radiance in the lobe of a reflection\n"
                  "specular_albedo   albedo of this lobe: specular times specular_albedo is a part of final",
                  channel_words },
    [TARGET_ERROR] = { "--target-error", "E", FRACTIONS, &options.target_error, 1, 0.0001, 1,
                       "target error, such as 2% or 0.02: the root mean square error of R over the picture, divided "
                       "by the mean of R. Where surfaces reflect, the error is that of final without emission. "
                       "Default by preset: 5%, 1.5%, 0.75%, with at most 1024, 1024, 2048 rays per sensor. If E is "
                       "given, a sensor may use up to 16 times as many rays, and a small E takes long",
                       .synonym = "--error" },
    [SENSOR_FOV] = { "--sensor-fov", "DEGREES", NUMBERS, &options.sensor_fov, 1, 1, 179,
                     "field of view of a sensor, mode paper only; default 135" },
    [FACET_LIMIT] = { "--facet-limit", "PIXELS", NUMBERS, &options.facet_limit, 1, 0, 1e30,
                      "triangles of at most this height on the screen use geometric normals; those of at least twice "
                      "this height use the normals of the file; triangles in between use a mixture. Default 2" },
    [SAMPLES] = { "--samples", "N", INTEGERS, &options.samples, 1, 1, 64,
                  "anti-aliasing samples per pixel of channel final; default 1, 4, 16 by preset" },
    [EXPOSURE] = { "--exposure", "STOPS", NUMBERS, &options.exposure, 1, -100, 100,
                   "brightness of channels final, radiance, store and error in a .png: each stop doubles it. Default "
                   "auto: the mean light is shown like a white surface of radiance 0.7, if highlights permit",
                   exposure_words },
    [TONE] = { "--tone", "NAME", CHOICE, &options.tone, 0, 0, 0,
               "how channel final in a .png shows light that is too bright for a screen: neutral (default; keeps "
               "colours, compresses highlights) | agx (a soft filmic curve) | none (everything above 1 is white)",
               tone_words },
    [INSPECT] = { "--inspect", "X,Y", INTEGERS, options.inspect, 2, 0, 16383,
                  "instead of the scene, draws what the sensor at this pixel sees (a disc, 512 x 512), and prints its "
                  "sums; 0,0 is the upper left pixel (of the --window)" },
    [WINDOW] = { "--window", "X,Y,W,H", INTEGERS, options.window, 4, 0, 16384,
                 "makes only a part of the picture: W x H pixels, the first at X,Y; 0,0 is at the upper left. Windows "
                 "of one picture fit together. In mode gi, give the same --store FILE for all windows. A small "
                 "preview of the complete picture is made first, for the exposure and for the mean of --target-error. "
                 "A .exr file stores the position of the part (data window) and the size of the complete picture" },
    [PART] = { "--part", "K/N", TEXT, &options.part.text, 0, 0, 0,
               "makes only the K-th of N parts, which take about the same time; N is at most 10000. The output is an "
               ".exr file; sbl_merge joins the parts. Unless the file of --plan exists, a small preview of the "
               "complete picture is made first. With --cameras or --frames, see --frames.\n"
               PLAN_AUTO_WORDS },
    [PLAN] = { "--plan", "FILE", TEXT, &options.part.plan, 0, 0, 0,
               "FILE holds the windows of all parts, and the mean, the exposure, the price (the least benefit that a "
               "measurement must have) and the number of cells of the complete picture, see ON PARTS in sbl.h. If "
               "FILE exists, it is loaded; otherwise it is made. Needs --part. Parts that are made with different "
               "graphics drivers must share one FILE" },
    [RESUME] = { "--resume", NULL, FLAG, NULL, 0, 0, 0,
                 "continues an interrupted picture that is made window by window. A picture is made window by window "
                 "if it has more than 4096 x 4096 pixels or needs more than --memory. Finished windows are in the "
                 "folder OUTPUT.parts, which is removed at the end; while it exists, a run without --resume is "
                 "refused" },
    [STUDIO] = { "--studio", NULL, FLAG, NULL, 0, 0, 0,
                 "replaces the lights of the file (surfaces that emit stay) by a sky that fades to the horizon and a "
                 "soft sun from the upper left, with a grey ground under an object. A room that is looked at from "
                 "inside gets a lamp inside instead. Files without any light get this by default, unless --sky or "
                 "--mode paper is given" },
};
static int given[OPTION_COUNT];

static const tool_line lines[] = {
    { TOOL_HEADING, "Task:" },
    { CHANNEL, "final (default), radiance, albedo, normal, depth, ..." },
    { MODE, "gi (default, with bounces), direct, ambient or paper" },
    { INSPECT, NULL }, { WINDOW, NULL },
    { PART, "makes only the K-th of N parts of equal cost" },
    { PLAN, NULL },
    { TOOL_HEADING, "Camera:" },
    CAMERA_LINES,
    FRAMES_LINES,
    { TOOL_HEADING, "Light:" },
    LIGHT_LINES, { STUDIO, "replaces the lights of the file by a studio's light" },
    { TOOL_HEADING, "Quality:" },
    { TARGET_ERROR, "accepted error, such as 2%; a smaller one takes longer" },
    { SAMPLES, "anti-aliasing samples per pixel" },
    QUALITY_LINES, { FACET_LIMIT, NULL }, { SENSOR_FOV, NULL },
    { TOOL_HEADING, "Output:" },
    { OUTPUT, "also -o; .png, .pfm or .exr; default sbl.png" },
    { EXPOSURE, "+1 makes a .png twice as bright; default auto" },
    { TONE, "tone curve of a .png: neutral (default), agx or none" },
    OUTPUT_LINES,
    { RESUME, NULL },
    { TOOL_HEADING, "Safety:" },
    SAFETY_LINES
};

static void print_help(void) {
    printf("usage: sbl_render SCENE [options]\n\n"
           "Renders a scene file: .obj .gltf .glb, and others that assimp reads (.fbx, ...).\n");
    tool_print_help(table, OPTION_COUNT, lines, (int)(sizeof lines / sizeof *lines), common.help_all);
    if (!common.help_all) return;
    tool_print_text(
        "\n"
        "Materials: OBJ Kd map_Kd Ke map_Ke d map_d; glTF base colour, emission with KHR_materials_emissive_strength, "
        "alphaMode MASK and BLEND (if all materials are matte, opacity below 0.5 is cut out, also in OBJ). Metal, "
        "gloss and panes: glTF metallicFactor, roughnessFactor, metallicRoughnessTexture, KHR_materials_ior, "
        "KHR_materials_transmission; OBJ Ns, Ks, Ni, illum, d, Tf; see --materials. Normal maps: glTF normalTexture "
        "with its scale; OBJ norm. Surfaces emit on both sides.\n"
        "\n"
        "Lights: glTF KHR_lights_punctual (candela are radiance times area, lux are irradiance; ranges are ignored), "
        "and the point, spot and directional lights of other formats. Blender's glTF exporter multiplies lights by "
        "683, but not emission; such lights are divided by 683; see --light-scale.\n"
        "\n"
        "Colours in a .png: a normal n is shown as 0.5 + 0.5 n, a position relative to the visible bounds, a small "
        "depth as bright, an id as an arbitrary colour, sensors from blue (first level) through green and yellow to "
        "red (last level). A .pfm or .exr contains the values unchanged.\n"
        "\n"
        "A file is written completely or not at all: at the end, a temporary file replaces the old file and takes its "
        "permissions. If FILE is a symbolic link, the file that it refers to is replaced. Other hard links of the old "
        "file keep the old contents. Input files are never overwritten.\n"
        "\n"
        "If you press Ctrl-C, the unfinished picture is saved beside the output, as NAME.partial.png (.pfm, .exr), "
        "and the program ends. If nothing can be shown yet, or with --cameras or --frames, it is not saved. "
        TOOL_SIGNALS_WORDS "\n"
        TOOL_STATUS_WORDS);
}

static int ends_with(const char *path, const char *ending) { return scene__ends_with(path, ending); }

/* Returns 1 if the channel shows only surfaces and neither --inspect nor --store needs light, so that no light is
   measured. */
static int needs_no_light(sbl_channel channel) {
    return channel >= SBL_CHANNEL_ALBEDO && channel <= SBL_CHANNEL_DEPTH && !given[INSPECT] && !given[STORE];
}

/* Collects the given options that have no effect on this picture; tool_scene.h warns of them later. */
static void note_effects(void) {
    const sbl_channel channel = channels[options.channel];
    const int is_light = channel == SBL_CHANNEL_FINAL || channel == SBL_CHANNEL_DISPLAY ||
        channel == SBL_CHANNEL_RADIANCE || channel == SBL_CHANNEL_STORE || picture_is_error(channel);
    const int paper = common_mode(given) == SBL_MODE_PAPER;
    static const int of_light[] = { TARGET_ERROR, RAYS, MAX_BOUNCE_CELLS, SENSOR_SIZE, TILE, THRESHOLD, FILTER_RADIUS,
        SEED };
    size_t i;
    for (i = 0; i < sizeof of_light / sizeof *of_light; i++)
        note_if(needs_no_light(channel), given, table, of_light[i], "the channel shows no light");
    if (!needs_no_light(channel)) {
        common_note(given, table);
        note_if(paper, given, table, TARGET_ERROR, "in --mode paper, --threshold sets the quality");
        if (!paper) common_note_refinement(given, table, TARGET_ERROR);
    }
    note_if(given[STUDIO], given, table, LIGHT_SCALE, "--studio replaces the lights of the file");
    note_if(options.samples > 1 && ((channel != SBL_CHANNEL_FINAL && channel != SBL_CHANNEL_DISPLAY) || given[INSPECT]),
            given, table, SAMPLES, "only channels final and display are anti-aliased");
    note_if(!ends_with(common.output, ".png") && channel != SBL_CHANNEL_DISPLAY && !given[PART], given, table, EXPOSURE,
            "only a .png is exposed");
    note_if(ends_with(common.output, ".png") && !is_light, given, table, EXPOSURE,
            "only final, display, radiance, store and error are exposed");
    note_if(channel != SBL_CHANNEL_DISPLAY && (!ends_with(common.output, ".png") || channel != SBL_CHANNEL_FINAL ||
                                               given[INSPECT]), given, table, TONE,
            "only channel final in a .png, and channel display, have a tone");
}

/* Reads the value of --part and checks the options that go with it. Returns the exit status. */
static int parse_part(void) {
    int status;
    if (given[PLAN] && !given[PART]) return misuse("--plan needs --part K/N: a plan describes the parts");
    if (!given[PART]) return DONE;
    if (given[WINDOW]) return misuse("--part and --window both choose a part of the picture; give only one of them");
    if (given[INSPECT]) return misuse("--inspect draws a sensor, which has no parts; leave out --part");
    if (!ends_with(common.output, ".exr"))
        return misuse("--output %s: a part is an .exr file, and sbl_merge joins them to a .png, .pfm or .exr; a .png "
                      "needs --channel display", common.output);
    if (given[PLAN]) common.input = options.part.plan;
    status = plan_part_and_output(&options.part);
    if (status == DONE && (double)camera.size[0] * camera.size[1] < options.part.count)
        return misuse("--part %s: %d parts are too many for a picture of %d x %d pixels", options.part.text,
                      options.part.count, camera.size[0], camera.size[1]);
    return status;
}

/* Reads the options that choose frames. With frames, --part gives each machine a part. Returns the exit status. */
static int parse_frames(void) {
    int status = frames_parse(given, &options.part);
    if (status != DONE || !frames.first) return status;
    if (given[INSPECT]) return misuse("--inspect draws one sensor; leave out --cameras and --frames");
    if (given[PLAN]) return misuse("--plan is for parts of one picture; with frames, a part consists of complete "
                                   "frames: omit --plan");
    given[PART] = 0;
    return DONE;
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
    if (channels[options.channel] == SBL_CHANNEL_DISPLAY && options.tone == NO_TONE)
        return misuse("--channel display needs a tone; without one it would be --channel final");
    status = parse_frames();
    if (status == DONE) status = parse_part();
    if (status != DONE) return status;
    if (given[STUDIO] && given[SKY])
        return misuse("--studio has a sky of its own; give only one of --studio and --sky");
    if (given[STUDIO] && common_mode(given) == SBL_MODE_PAPER)
        return misuse("--studio: --mode paper allows no sun and no sky picture; choose another --mode");
    note_effects();
    return DONE;
}

/* ---- output files ---- */

enum { PICTURE = OWN_TARGETS, PARTIAL };  /* PARTIAL: an unfinished picture, such as room.partial.png */

/* Lists the files that this run may write, and checks the first `checked` of them (see targets_check). Returns the exit
   status. */
static int find_targets(int checked) {
    static char partial[PATH_MAX];
    const char *ending = strrchr(common.output, '.');
    snprintf(partial, sizeof partial, "%.*s.partial%s", (int)(ending - common.output), common.output, ending);
    targets_free();
    targets_begin();
    output_find(&targets[PICTURE], common.output);
    output_find(&targets[PARTIAL], partial);
    target_count = PARTIAL + 1;
    return targets_check(checked, given);
}

/* Checks the files of all frames and lists those of the first frame. If the scene has not been read yet, also checks
   that they can be written. file: the scene, or NULL if it has not been read yet. Returns the exit status. */
static int check_frames(scene_file *file) {
    char folder[PATH_MAX + 16];
    int n, status = DONE;
    for (n = frames.last; n >= frames.first && status == DONE; n--) {
        frames_go(n);
        status = find_targets(file ? 0 : PARTIAL);
        if (status == DONE && file) status = targets_check_read(file);
        snprintf(folder, sizeof folder, "%s.parts", common.output);
        if (status == DONE && given[RESUME] && access(common.output, F_OK) == 0 && access(folder, F_OK) != 0)
            status = misuse("--resume: %s exists, and may belong to another picture; --frames A-B can leave it out, or "
                            "remove it", common.output);
    }
    return status;
}

/* A picture and the way a file shows it. name: only its ending is used, which selects the format */
typedef struct view { const char *name; const image *picture; sbl_channel channel; double stops; } view;

static int write_shown(FILE *out, const void *what) {
    const view *s = (const view *)what;
    return picture_write(out, s->name, s->picture, s->channel, s->stops);
}

/* Returns 1 if the output is exposed and tone-mapped for a screen. */
static int is_display(sbl_channel channel) {
    if (channel == SBL_CHANNEL_DISPLAY) return !given[INSPECT];
    return ends_with(common.output, ".png") && channel == SBL_CHANNEL_FINAL && options.tone != NO_TONE &&
           !given[INSPECT];
}

/* Warns if more than a tenth of a picture for a screen is white or black, and says what would help. stops: the exposure
   that the values do not contain yet; chosen: the total exposure */
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

/* Writes the picture, or after a signal the unfinished picture. Returns the exit status. done: progress from 0 to 1 */
static int keep_picture(const view *s, float done) {
    if (!interrupted && target_write(&targets[PICTURE], write_shown, s, 0)) return DONE;
    if (!interrupted) return fail_to_write(common.output);
    if (frames.now) return INTERRUPTED + interrupted;  /* render_frames reports which frames are finished */
    if (!target_write(&targets[PARTIAL], write_shown, s, 1))
        return stop("the unfinished picture cannot be written to %s: %s", targets[PARTIAL].name, why_not_written());
    return stop("the unfinished picture (%.0f %%) is in %s", floor(100 * (double)done), targets[PARTIAL].name);
}

/* ---- --inspect: one sensor ---- */

enum { DISC = 512 };

/* Draws the views or rays of a sensor into shown, and prints its sums. */
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
        sensor_print(&s, options.inspect, sum);
    }
    free(radiance);
    free(weights);
    return result;
}

/* ---- the choice of the camera and of the light, as far as file and options leave them open ---- */

static struct { float world_to_view[16], view_to_clip[16]; survey seen; } placed;  /* the current camera */

static void describe_camera(const camera_view *c, const survey *s) {
    char words[256];
    camera_words(words, sizeof words, c, s);
    detail("camera: %s: %s", c->where, words);
}

/* Returns 1 if a grey backdrop replaces the black behind the scene. This is so for screens, if the file has its own
   light and no option chooses a sky. */
static int wants_backdrop(const scene_file *file) {
    return is_display(channels[options.channel]) && !given[SKY] && !given[STUDIO] && is_lit(&file->scene);
}

/* Places the camera of the picture or frame. Returns the exit status. chosen: receives the camera without the options;
   shot: with them */
static int place_camera(const tool_task *task, camera_view *chosen, camera_view *shot) {
    const int *set = frames_options(given);
    if (!frames_choose(chosen, task->file, set, &placed.seen)) return frames_misuse();
    *shot = *chosen;
    return camera_place(placed.world_to_view, placed.view_to_clip, shot, set, &placed.seen) ? DONE : frames_misuse();
}

/* Chooses the camera, and the light of a file without light. With frames, first checks all cameras, then places the
   camera of frame 1. Returns the exit status. */
static int arrange(tool_task *task, sbl_scene_desc *scene) {
    const int relight = given[STUDIO] ||
        (lit_by_us(&task->file->scene, given) && common_mode(given) != SBL_MODE_PAPER);
    const int chooses = !given[EYE] && !frames.first;
    camera_view chosen, shot;
    survey *s = &placed.seen;
    sbl_result result = SBL_SUCCESS;
    int n, status = DONE;
    survey_begin(s, task->context);
    if (chooses) camera_check(task->file);
    if (relight || (chooses && !camera_of_file(task->file, &shot, s))) result = survey_take(s, task->context);
    if (result == SBL_UNFINISHED) return stop("no picture was started");
    if (result != SBL_SUCCESS) return fail_with(task->said, common.scene, result);
    for (n = frames.last; n >= frames.first && n > 0 && status == DONE; n--) {
        frames_go(n);
        status = place_camera(task, &chosen, &shot);
    }
    if (frames.first) frames_go(1);
    if (status == DONE) status = place_camera(task, &chosen, &shot);
    if (status != DONE) return status;
    describe_camera(&shot, s);
    task->unplaced = chooses && camera_is_unplaced(task->file, s);
    return relight ? studio_set(task, scene, s, &chosen, shot.eye, given[STUDIO]) : DONE;
}

/* ---- a missed target error ---- */

/* Writes why the target was missed and what would help. Stored light causes a part of the error that sensors cannot
   reduce. Sensors reduce the rest only to 0.84 of the target, or to half of the part of stored light if that is more.
   Therefore a smaller target can compensate for stored light. */
static void advise(const sbl_stats *s, char *out, size_t size) {
    enum { CELLS_MAX = 1 << 20 };
    const double target = (double)s->picture.target_error, expected = (double)s->picture.radiance_error;
    const double specular = (double)s->picture.specular_error;
    const double stored = (double)s->picture.stored_error, left2 = target * target - stored * stored;
    const int cells = s->store.max_cells;
    char smaller[64] = "", more[64] = "";
    if (expected * expected - stored * stored <= fmax(target * target, stored * stored) && specular <= target) {
        if (left2 > 0.04 * target * target)
            snprintf(smaller, sizeof smaller, "; --target-error %.2g%% would help", 100 * sqrt(left2) / 0.84);
        if (cells < CELLS_MAX)  /* more cells are smaller, but each is measured with fewer rays */
            snprintf(more, sizeof more, "; --max-bounce-cells %d may help", cells < CELLS_MAX / 4 ? 4 * cells
                                                                                                : CELLS_MAX);
        snprintf(out, size, "stored light limits it%s%s", smaller, more);
    } else if (!given[TARGET_ERROR])
        snprintf(out, size, "the default limit of rays per sensor was reached; --target-error %g%% allows more",
                 100 * target);
    else snprintf(out, size, "the maximum number of rays per sensor was reached; a larger --filter-radius would help");
}

/* Warns if the target was missed. The error of the light and the error of the reflections are each held to the target;
   both together may exceed it. */
static void warn_of_missed_target(messages *said, const sbl_stats *s) {
    const double target = (double)s->picture.target_error, expected = (double)s->picture.expected_error;
    const double larger = fmax((double)s->picture.radiance_error, (double)s->picture.specular_error);
    char help[256];
    if (frames.now) return;  /* render_frames warns once for all frames */
    if (needs_no_light(channels[options.channel])) return;
    if (!(target > 0) || !(larger > 1.1 * target) || given[RAYS] || given[THRESHOLD]) return;
    if (expected > 1) return;  /* the picture is black: errors are relative to its mean, which is almost 0 */
    advise(s, help, sizeof help);
    warn_later(said, "the predicted error is %.2g %%, %.2g %% was asked for: %s", 100 * expected, 100 * target, help);
}

/* Prints a note if a backdrop fills more than a tenth of the picture. */
static void note_backdrop(const sbl_stats *s) {
    const double pixels = (double)s->picture.width * s->picture.height;
    if (10 * (pixels - s->picture.visible_pixels) > pixels)
        tell("%s: the file has lights but no sky: a grey backdrop, which lights nothing, is shown behind it; --sky "
             "0,0,0 turns it off", common.scene);
}

static void fill_desc(sbl_picture_desc *desc, const scene_file *file, progress *bar) {
    memset(desc, 0, sizeof *desc);
    desc->width = camera.size[0];
    desc->height = camera.size[1];
    desc->options = common_options(given, bar);
    if (needs_no_light(channels[options.channel]) && common_mode(given) != SBL_MODE_PAPER)
        desc->options.mode = SBL_MODE_DIRECT;  /* this mode does the least work before it draws surfaces */
    desc->target_error = (float)options.target_error;
    desc->sensor_fov = (float)options.sensor_fov;
    desc->tile = common.tile;
    if (given[THRESHOLD]) desc->threshold = zero_or(common.threshold);
    if (given[FACET_LIMIT]) desc->facet_limit = zero_or(options.facet_limit);
    if (given[FILTER_RADIUS]) desc->filter_radius = (int)zero_or(common.filter_radius);
    if (ends_with(common.output, ".png") || is_display(channels[options.channel])) {
        static const sbl_tone tones[] = { SBL_TONE_NONE, SBL_TONE_NEUTRAL, SBL_TONE_AGX };
        desc->auto_exposure = isnan(options.exposure);
        desc->exposure = desc->auto_exposure ? 0 : (float)options.exposure;
        desc->tone = is_display(channels[options.channel]) ? tones[options.tone] : SBL_TONE_NONE;
        if (wants_backdrop(file)) memcpy(desc->backdrop, studio_backdrop, sizeof desc->backdrop);
    }
    desc->samples = channels[options.channel] == SBL_CHANNEL_FINAL || is_display(channels[options.channel])
                        ? options.samples : 1;  /* all other channels show the pixel centres */
}

/* ---- one picture, or one of its windows ---- */

/* A picture that is being rendered, with its description and its windows. */
typedef struct shot {
    tool_task *task;
    progress bar;
    sbl_picture_desc desc;
    sbl_channel channel;
    windows windows;      /* the region of the output and its windows */
    image picture;        /* the window that was rendered last */
    double exposure;      /* common exposure of all frames in stops; NaN: each picture is exposed by itself */
    int cells;            /* max_bounce_cells of all frames; 0: no frame sets it */
} shot;

/* Returns the exit status for a signal that came before any picture existed. */
static int stop_early(void) {
    return frames.now ? INTERRUPTED + interrupted : stop("there is no picture yet");
}

/* Renders the picture of s->desc and reads its channel into s->picture. late: 1: after a signal, reads the unfinished
   picture */
static sbl_result make_picture(shot *s, int late) {
    sbl_context *context = s->task->context;
    const int *w = s->desc.window;
    sbl_stats stats;
    sbl_result result = sbl_begin_picture(context, &s->desc);
    if (result == SBL_SUCCESS && needs_no_light(s->channel)) result = work_until(context, s->channel);
    else if (result == SBL_SUCCESS) result = late ? work_to_save(context) : work(context);
    if (result == SBL_UNFINISHED && !interrupted) result = SBL_SUCCESS;  /* the channel is already complete */
    clear_progress(&s->bar);
    stats = sbl_query_stats(context);
    free(s->picture.values);
    s->picture.values = NULL;
    if (result != SBL_SUCCESS && (result != SBL_UNFINISHED || !late)) return result;
    result = picture_read(context, stats.picture.width, stats.picture.height,
                          is_display(s->channel) ? SBL_CHANNEL_DISPLAY : s->channel, &s->picture);
    if (w[2]) {
        memcpy(s->picture.at, w, sizeof s->picture.at);
        memcpy(s->picture.full, camera.size, sizeof s->picture.full);
    }
    s->picture.facts = s->windows.has_facts ? s->windows.work.facts : NULL;
    return result;
}

/* Returns the exposure of a .png in stops, as far as the values of the channel do not contain it. exposure: of the
   picture */
static double stops_of(const shot *s, float exposure) {
    const double stops = is_display(s->channel) ? 0 : (double)exposure;
    return picture_is_error(s->channel) && isnan(options.exposure) ? stops + PICTURE_ERROR_STOPS : stops;
}

/* Renders the output at once and writes it. Returns the exit status. */
static int render_whole(shot *s, double *seconds) {
    sbl_context *context = s->task->context;
    const sbl_result result = make_picture(s, !frames.now);
    view all = { common.output, &s->picture, s->channel, 0 };
    sbl_stats stats;
    int status;
    *seconds = now() - s->task->start;
    stats = sbl_query_stats(context);
    all.stops = stops_of(s, stats.picture.exposure);
    if (result == SBL_SUCCESS) status = keep_picture(&all, sbl_progress(context));
    else if (result == SBL_UNFINISHED) status = stop_early();
    else status = fail_with(s->task->said, common.scene, result);
    if (status != DONE) return status;
    if (s->channel == SBL_CHANNEL_FINAL && ends_with(common.output, ".png") && frames.now <= frames.first)
        warn_of_extremes(s->task->said, &s->picture, all.stops, (double)stats.picture.exposure);
    warn_of_missed_target(s->task->said, &stats);
    if (s->desc.backdrop[0] > 0 && frames.now <= frames.first && !given[QUIET])
        note_backdrop(&stats);
    return DONE;
}

/* ---- large pictures, rendered in windows ---- */

/* Sets the facts that all parts of this picture share, except those that look_at_whole finds. */
static void find_facts(shot *s) {
    static const int without[] = { OUTPUT, STATS, STORE, STORE_REPLACE, QUIET, VERBOSE, ALLOW_PATH, MEMORY, READ_TIME,
                                   SIZE, EYE, LOOK_AT, UP, FOV, CAMERAS, FRAMES, FPS, CHANNEL, WINDOW, PART, PLAN,
                                   RESUME, -1 };
    const sbl_context *context = s->task->context;
    unsigned long long matrices = plan_hash(PLAN_HASH_START, placed.world_to_view, sizeof placed.world_to_view);
    plan *p = &s->windows.work;
    matrices = plan_hash(matrices, placed.view_to_clip, sizeof placed.view_to_clip);
    plan_fact(p, FACT_VERSION, "%s", sbl_version());
    plan_fact(p, FACT_SCENE, "%016llx", (unsigned long long)sbl_scene_fingerprint(context));
    plan_fact(p, FACT_CAMERA, "%016llx", matrices);
    plan_options_fact(p, table, OPTION_COUNT, given, without);
    plan_fact(p, FACT_CHANNEL, "%s", is_display(s->channel) ? "display" : channel_words[options.channel]);
    plan_fact(p, FACT_SIZE, "%dx%d", camera.size[0], camera.size[1]);
    plan_fact(p, FACT_RENDERER, "%s", sbl_query_capabilities(context).renderer);
    plan_fact(p, FACT_PART, "%s", "");
}

/* Sets mean, price, cells and exposure from the facts. */
static void use_facts(void *user) {
    shot *s = (shot *)user;
    double exposure = 0;
    plan_use(&s->windows.work, &s->desc);
    sscanf(s->windows.work.facts[FACT_EXPOSURE].text, "%lf", &exposure);
    s->desc.exposure = (float)exposure;
    s->desc.auto_exposure = 0;
}

/* Renders a small version of the full picture to find the mean, the price, the cells, the exposure and, if cost is not
   NULL, the cost. Returns the exit status. */
static int look_at_whole(void *user, plan_cost *cost) {
    shot *s = (shot *)user;
    const double shrink = plan_small(s->desc.width > s->desc.height ? s->desc.width : s->desc.height);
    sbl_picture_desc small = s->desc;
    sbl_stats stats;
    sbl_result result = SBL_SUCCESS;
    small.width = (int)ceil(s->desc.width / shrink);
    small.height = (int)ceil(s->desc.height / shrink);
    memset(small.window, 0, sizeof small.window);
    small.samples = 1;
    small.measure_work = 1;
    small.auto_exposure = isnan(options.exposure);
    small.exposure = small.auto_exposure ? 0 : (float)options.exposure;
    memset(&stats, 0, sizeof stats);
    if (needs_no_light(s->channel)) plan_set(&s->windows.work, &stats, shrink);
    else {
        result = sbl_begin_picture(s->task->context, &small);
        if (result == SBL_SUCCESS) result = windows_look(&s->windows, shrink, cost);
        stats = sbl_query_stats(s->task->context);
    }
    if (result == SBL_UNFINISHED) return stop_early();
    if (result != SBL_SUCCESS) return fail_with(s->task->said, common.scene, result);
    plan_fact(&s->windows.work, FACT_EXPOSURE, "%.9g",
              isnan(s->exposure) ? (double)stats.picture.exposure : s->exposure);
    return DONE;
}

static double window_bytes(const void *user, const int window[4]) {
    const shot *s = (const shot *)user;
    sbl_picture_desc desc = s->desc;
    memcpy(desc.window, window, sizeof desc.window);
    return (double)sbl_picture_bytes(s->task->context, &desc) + 16.0 * window[2] * window[3];
}

static sbl_result make_window(void *user, const int window[4]) {
    shot *s = (shot *)user;
    memcpy(s->desc.window, window, sizeof s->desc.window);
    return make_picture(s, 0);
}

static int write_window(FILE *out, const void *what) {
    const shot *s = (const shot *)what;
    return picture_write(out, ".exr", &s->picture, s->channel, 0);
}

/* Joins the finished windows and writes the output. Returns the exit status. */
static int join_windows(const shot *s) {
    const picture_fact *facts = given[PART] || given[WINDOW] ? s->windows.work.facts : NULL;
    return windows_join(&s->windows, facts, s->channel, stops_of(s, s->desc.exposure));
}

/* Renders the output in windows, which are stored in a folder, and joins them. Returns the exit status. */
static int render_windows(shot *s, double *seconds) {
    int status = windows_make(&s->windows);
    if (status == DONE) status = join_windows(s);
    *seconds = now() - s->task->start;
    if (status != DONE) return status;
    windows_end(&s->windows);
    warn_of_missed_target(s->task->said, &s->task->stats);
    return DONE;
}

/* Decides which region is rendered, divides it into windows, and finds the mean, the price, the cells and the exposure
   of the full picture. Returns the exit status. */
static int divide(shot *s) {
    windows *w = &s->windows;
    w->noun = "picture";
    w->part = given[PART] ? &options.part : NULL;
    w->by_hand = given[WINDOW];
    w->resume = given[RESUME];
    w->keeps_light = common_mode(given) == SBL_MODE_GI && !given[STORE] && !needs_no_light(s->channel);
    w->given = given;
    w->target = &targets[PICTURE];
    memcpy(w->size, camera.size, sizeof w->size);
    memcpy(w->region + 2, camera.size, sizeof w->size);
    if (given[WINDOW]) memcpy(w->region, options.window, sizeof w->region);
    w->user = s;
    w->bytes = window_bytes;
    w->look = look_at_whole;
    w->use = use_facts;
    w->make = make_window;
    w->write = write_window;
    w->plan_base = PLAN_BASE_PICTURE;
    find_facts(s);
    return windows_choose(w);
}

/* ---- the main program ---- */

/* Draws what the sensor at a pixel sees, for --inspect. Returns the exit status. */
static int render_sensor(shot *s, double *seconds) {
    sbl_context *context = s->task->context;
    view all = { common.output, &s->picture, SBL_CHANNEL_FINAL, 0 };
    sbl_result result;
    int status = DONE;
    memcpy(s->desc.window, options.window, sizeof s->desc.window);
    if (given[WINDOW]) {
        status = look_at_whole(s, NULL);
        if (status == DONE) use_facts(s);
        s->windows.has_facts = 1;
    }
    if (status != DONE) return status;
    result = sbl_begin_picture(context, &s->desc);
    if (result == SBL_SUCCESS) result = work(context);
    clear_progress(&s->bar);
    if (result == SBL_SUCCESS) result = inspect(context, &s->picture);
    *seconds = now() - s->task->start;
    all.stops = (double)sbl_query_stats(context).picture.exposure;
    if (result == SBL_UNFINISHED) return stop("there is no picture yet");
    return result == SBL_SUCCESS ? keep_picture(&all, 1) : fail_with(s->task->said, common.scene, result);
}

/* Initialises s for the camera that is placed now. */
static void begin_shot(shot *s) {
    s->bar.from = s->bar.to = s->bar.last = 0;
    s->bar.start = now();
    memset(&s->windows, 0, sizeof s->windows);
    s->windows.task = s->task;
    s->windows.bar = &s->bar;
    fill_desc(&s->desc, s->task->file, &s->bar);
    memcpy(s->desc.world_to_view, placed.world_to_view, sizeof s->desc.world_to_view);
    memcpy(s->desc.view_to_clip, placed.view_to_clip, sizeof s->desc.view_to_clip);
    s->desc.max_bounce_cells = s->cells;
    if (!s->desc.auto_exposure || isnan(s->exposure)) return;
    s->desc.auto_exposure = 0;
    s->desc.exposure = (float)s->exposure;
}

/* Renders and writes a picture. Returns the exit status. */
static int render_shot(shot *s, double *seconds) {
    int status;
    begin_shot(s);
    status = given[INSPECT] ? DONE : divide(s);
    if (status == DONE && !given[INSPECT]) memcpy(s->desc.window, s->windows.region, sizeof s->desc.window);
    if (status == DONE && !s->windows.has_facts) memset(s->desc.window, 0, sizeof s->desc.window);
    if (status == DONE)
        status = given[INSPECT] ? render_sensor(s, seconds)
               : s->windows.work.count > 1 ? render_windows(s, seconds) : render_whole(s, seconds);
    if (status == DONE && s->bar.shown)
        fprintf(stderr, "%s: %d x %d, %.1f s\n", common.output,
                given[INSPECT] ? s->picture.width : s->windows.region[2],
                given[INSPECT] ? s->picture.height : s->windows.region[3],
                frames.now ? now() - s->bar.start : *seconds);
    plan_free(&s->windows.work);
    return status;
}

/* Finds the exposure and the number of cells that all frames share, with a small picture of frame 1 if needed. The
   caller has placed the camera of frame 1. Returns the exit status. */
static int look_at_frames(shot *s) {
    const int has_cells = given[MAX_BOUNCE_CELLS] || given[RAYS] || given[THRESHOLD] ||
        (given[STORE] && !s->task->makes_store);  /* no picture raises the number of cells */
    const int finds_cells = common_mode(given) == SBL_MODE_GI && !needs_no_light(s->channel) && !has_cells;
    const int warnings = s->task->said->warnings_kept;
    int exposes, status;
    begin_shot(s);
    exposes = isnan(options.exposure) && (s->desc.auto_exposure || given[WINDOW]);
    if (!exposes && !finds_cells) return DONE;
    status = look_at_whole(s, NULL);
    s->task->said->warnings_kept = warnings;  /* drops the warnings about the small picture */
    if (status != DONE) return status;
    if (exposes) sscanf(s->windows.work.facts[FACT_EXPOSURE].text, "%lf", &s->exposure);
    sscanf(s->windows.work.facts[FACT_CELLS].text, "%d", &s->cells);
    return DONE;
}

/* Renders frame n and adds its statistics to sum. Returns the exit status. */
static int render_frame(shot *s, int n, sbl_stats *sum, double *seconds) {
    camera_view chosen, shown;
    const double before = sum->picture.visible_pixels;
    const sbl_stats old = *sum;
    sbl_stats *own = &s->task->stats;
    int k, status;
    frames_go(n);
    memset(own, 0, sizeof *own);
    s->task->has_stats = 0;
    status = find_targets(0);
    if (status == DONE) status = place_camera(s->task, &chosen, &shown);
    if (status == DONE) status = render_shot(s, seconds);
    if (status != DONE) return status;
    if (!s->task->has_stats) *own = sbl_query_stats(s->task->context);
    add_stats(sum, own);
    for (k = 0; k < 3 && sum->picture.visible_pixels > 0; k++)
        sum->picture.mean_radiance[k] = (float)((before * (double)old.picture.mean_radiance[k] +
            own->picture.visible_pixels * (double)own->picture.mean_radiance[k]) / sum->picture.visible_pixels);
    return needs_no_light(s->channel) ? DONE : keep_store(s->task, given);
}

/* Renders and writes the frames one after the other. Returns the exit status. */
static int render_frames(shot *s, double *seconds) {
    sbl_stats sum;
    int n = frames.first, status = look_at_frames(s);
    memset(&sum, 0, sizeof sum);
    while (status == DONE && n <= frames.last && !interrupted) {
        status = render_frame(s, n, &sum, seconds);
        n += status == DONE;
    }
    if (interrupted && n <= frames.last)
        return stop("%d of %d frames are finished; --frames %d-%d%s makes the rest", n - frames.first,
                    frames.last - frames.first + 1, n, frames.last, options.part.text ? " without --part" : "");
    s->task->stats = sum;
    s->task->has_stats = 1;
    frames.now = 0;
    if (status == DONE) warn_of_missed_target(s->task->said, &sum);
    return status;
}

static int render(tool_task *task, double *seconds) {
    static shot s;
    int status;
    s.task = task;
    s.bar.shown = !given[QUIET] && isatty(STDERR_FILENO);
    s.channel = given[INSPECT] ? SBL_CHANNEL_FINAL : channels[options.channel];
    s.exposure = NAN;
    status = frames.now ? render_frames(&s, seconds) : render_shot(&s, seconds);
    free(s.picture.values);
    return status;
}

int main(int argc, char **argv) {
    const double start = now();
    int status = parse(argc, argv);
    if (status != DONE) return status;
    if (given[HELP]) { print_help(); return fflush(stdout) == 0 ? DONE : FAILED; }
    if (given[VERSION]) { printf("sbl_render %s\n", sbl_version()); return fflush(stdout) == 0 ? DONE : FAILED; }
    catch_signals();
    status = frames.now ? check_frames(NULL) : find_targets(PARTIAL);
    if (status == DONE) status = plan_check(&options.part);
    if (status == DONE) status = tool_run(start, given, render, frames.now ? check_frames : NULL, arrange);
    studio_free(&studio_of_tool);
    frames_free();
    targets_free();
    return status;
}
