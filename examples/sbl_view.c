/* Demonstrates a viewer on top of sbl.h, in the GL context of a window: the picture improves while the user may move
   the camera and the lights. `sbl_view --help` explains its options, and the key H prints the keys. */
#define _GNU_SOURCE
#define SBL_IMPLEMENTATION
#include "../sbl.h"
#include "host_gl.h"
#include <GLFW/glfw3.h>
#include "output_file.h"
#include "picture_file.h"
#include "scene_file.h"
#include "sensor_disc.h"
#include "sensor_words.h"
#define TOOL_NAME "sbl_view"
#define TOOL_MAKES "picture"
#define TOOL_DRAWS
#include "tool.h"
#include "tool_options.h"
#include "tool_scene.h"
#include "tool_survey.h"
#include "tool_camera.h"
#include "tool_studio.h"
#include "view_steps.h"
#include "view_draw.h"
#include "view_camera.h"
#include "view_overlay.h"

/* ---- the command line ---- */

static struct options {
    int channel, samples, tone;
    double target_error, exposure;  /* exposure: NaN means automatic */
    const char *histogram;
} options = { .tone = 1, .exposure = NAN };

static const char *const channel_words[] = { "final", "radiance", "albedo", "normal", "position", "depth", "id",
    "sensors", "store", "error", "specular", "specular_albedo", NULL };
static const sbl_channel channels[] = { SBL_CHANNEL_FINAL, SBL_CHANNEL_RADIANCE, SBL_CHANNEL_ALBEDO,
    SBL_CHANNEL_NORMAL, SBL_CHANNEL_POSITION, SBL_CHANNEL_DEPTH, SBL_CHANNEL_ID, SBL_CHANNEL_SENSORS,
    SBL_CHANNEL_STORE, SBL_CHANNEL_ERROR, SBL_CHANNEL_SPECULAR, SBL_CHANNEL_SPECULAR_ALBEDO };
enum { CHANNELS = sizeof channels / sizeof *channels, TONES = 3 };
static const sbl_tone tones[TONES] = { SBL_TONE_CLIP, SBL_TONE_NEUTRAL, SBL_TONE_AGX };

enum { OUTPUT = CAMERA_END, CHANNEL, TARGET_ERROR, SAMPLES, EXPOSURE, TONE, STUDIO, ONCE, HISTOGRAM, OPTION_COUNT };

static const tool_option table[OPTION_COUNT] = {
    COMMON_ROWS,
    CAMERA_ROWS,
    [OUTPUT] = { "--output", "FILE", TEXT, &common.output, 0, 0, 0,
                 "also -o; the file that the key S writes: .png (8-bit sRGB, as the window shows it), .pfm or .exr "
                 "(linear 32-bit floats); default: the first of sbl_view_1.png, sbl_view_2.png, ... that does not "
                 "exist" },
    [CHANNEL] = { "--channel", "NAME", CHOICE, &options.channel, 0, 0, 0,
                  "what the window shows first: final (default) | radiance | albedo | normal | position | depth | id "
                  "| sensors | store | error | specular | specular_albedo; see sbl_render --help all", channel_words },
    [TARGET_ERROR] = { "--target-error", "E", FRACTIONS, &options.target_error, 1, 0.0001, 1,
                       "target error, such as 2% or 0.02, as in sbl_render; default 5%, 1.5%, 0.75% by preset",
                       .synonym = "--error" },
    [SAMPLES] = { "--samples", "N", INTEGERS, &options.samples, 1, 1, 64,
                  "anti-aliasing samples per pixel; default 1, 4, 16 by preset" },
    [EXPOSURE] = { "--exposure", "STOPS", NUMBERS, &options.exposure, 1, -100, 100,
                   "each stop doubles the brightness; default auto, as in sbl_render", exposure_words },
    [TONE] = { "--tone", "NAME", CHOICE, &options.tone, 0, 0, 0,
               "how light is shown that is too bright for a screen: neutral (default) | agx | none", tone_words },
    [STUDIO] = { "--studio", NULL, FLAG, NULL, 0, 0, 0,
                 "replaces the lights of the file by a studio, as in sbl_render" },
    [ONCE] = { "--once", NULL, FLAG, NULL, 0, 0, 0,
               "saves the finished picture, then exits" },
    [HISTOGRAM] = { "--step-histogram", "FILE", TEXT, &options.histogram, 0, 0, 0,
                    "writes as JSON how long the calls of sbl_step took: percentiles and histograms of the wall time, "
                    "of the wall time of steps during which the machine did not take the processor away, and of the "
                    "processor time of this thread and of the process; and the slowest steps, with the number of GL "
                    "programs that they compiled" },
};
static int given[OPTION_COUNT];

static const tool_line lines[] = {
    { TOOL_HEADING, "Task:" },
    { CHANNEL, "final (default), radiance, albedo, normal, depth, ..." },
    { MODE, "gi (default, with bounces), direct, ambient or paper" },
    { TOOL_HEADING, "Camera:" },
    CAMERA_LINES,
    { TOOL_HEADING, "Light:" },
    LIGHT_LINES, { STUDIO, "replaces the lights of the file by a studio's light" },
    { TOOL_HEADING, "Quality:" },
    { TARGET_ERROR, "accepted error, such as 2%; a smaller one takes longer" },
    { SAMPLES, "anti-aliasing samples per pixel" },
    QUALITY_LINES,
    { TOOL_HEADING, "Output:" },
    { OUTPUT, "also -o; the file that the key S writes" },
    { EXPOSURE, "+1 makes the picture twice as bright; default auto" },
    { TONE, "tone curve: neutral (default), agx or none" },
    { ONCE, "saves the finished picture, then exits" },
    { HISTOGRAM, "writes the durations of sbl_step calls as JSON" },
    OUTPUT_LINES,
    { TOOL_HEADING, "Safety:" },
    SAFETY_LINES
};

static const char keys[] =
    "  drag left              turns the camera about the point below the mouse\n"
    "  drag right             looks around; with W A S D Q E: flies (Shift: four times as fast)\n"
    "  drag middle, wheel     moves the camera sideways, forward and back\n"
    "  arrows, Page Up/Down   fly, too; Home returns to the first camera\n"
    "  click                  shows the rays, lamps and sums of the sensor of a pixel; Backspace removes them\n"
    "  1 to 9, 0, [ and ]     channels: final, radiance, albedo, normal, position, depth, id, sensors, store, error\n"
    "  + and -, X             exposure: brighter, darker, auto\n"
    "  T                      tone: none, neutral, agx\n"
    "  M                      mode: all light, or direct light only\n"
    "  L                      selects the next light; then drag it, or move it by arrows and Page Up/Down; comma "
    "halves its brightness, period doubles it\n"
    "  R                      makes the picture again\n"
    "  C                      prints the camera as options of sbl_render\n"
    "  S                      saves the picture, and prints the name of the file\n"
    "  H or ?                 prints these keys\n"
    "  Esc                    ends\n";

static void print_help(void) {
    printf("usage: sbl_view SCENE [options]\n\n"
           "Shows a scene (.obj .gltf .glb .fbx ...) in a window. The key H prints the keys.\n");
    tool_print_help(table, OPTION_COUNT, lines, (int)(sizeof lines / sizeof *lines), common.help_all);
    if (!common.help_all) return;
    tool_print_text("\n"
                    "While the camera or a light moves, the window shows small pictures of direct light, or of all "
                    "light once the bounced light is known. When it rests, the picture is made with the options "
                    "above. Two bars at the lower edge show the progress (yellow) and the target error divided by the "
                    "predicted error (blue).\n"
                    "\n"
                    "Keys and mouse:\n");
    tool_print_text(keys);
    tool_print_text("\n"
                    "Scenes, materials, lights and units: see sbl_render --help all. A saved .png is what the window "
                    "shows, without lines and bars. Unless you change exposure or tone with keys, it equals the .png "
                    "of sbl_render.\n"
                    "\n"
                    "Exit status: 0 success; 1 failure (also: no display), with one line on stderr; 2 wrong usage; "
                    "after a signal: 130 (Ctrl-C), 143 (SIGTERM), 129 (SIGHUP).\n");
}

static int parse(int argc, char **argv) {
    const tool_command command = { argc, argv, table, OPTION_COUNT, given, &common.scene, 1 };
    int status = tool_parse(&command);
    if (status != DONE || given[HELP] || given[VERSION]) return status;
    status = common_check(given);
    if (status != DONE) return status;
    if (given[OUTPUT] && !scene__ends_with(common.output, ".png") && !scene__ends_with(common.output, ".pfm") &&
        !scene__ends_with(common.output, ".exr"))
        return misuse("--output %s: the name must end in .png, .pfm or .exr", common.output);
#ifndef SBL_RENDER_OPENEXR
    if (given[OUTPUT] && scene__ends_with(common.output, ".exr"))
        return fail("--output %s: this program was built without OpenEXR; use .pfm", common.output);
#endif
    if (given[STUDIO] && given[SKY])
        return misuse("--studio has a sky of its own; give only one of --studio and --sky");
    if (given[STUDIO] && common_mode(given) == SBL_MODE_PAPER)
        return misuse("--studio: --mode paper allows no sun and no sky picture; choose another --mode");
    common_note(given, table);
    return DONE;
}

/* ---- the state of the viewer ---- */

enum { NOTHING, PREVIEW, PICTURE };  /* the kind of picture that was begun last */

#define VIEW_SLICE 0.008    /* seconds that sbl.h may work before the viewer reads the mouse again */
#define VIEW_REST 0.25      /* seconds without movement until the final picture is begun */
#define VIEW_REDRAW 0.033   /* seconds between two drawings of the window while sbl.h works */
#define VIEW_COLORS 0.25    /* the same for channels in false colours, which take longer to draw */
enum { VIEW_SHRINK = 4, VIEW_SMALLEST = 48, VIEW_CLICK = 4, VIEW_MARK = 12, TITLE_SIZE = 512 };

static struct view {
    GLFWwindow *window;
    tool_task *task;
    sbl_context *context;
    survey seen;
    camera_view chosen, camera;     /* the camera at the start, and the current camera */
    int size[2];                    /* size of the window's framebuffer */
    int stage, work_size[2];        /* the kind of picture that was begun last, and its size */
    sbl_result result;              /* result of the last step */
    int has_picture;                /* 1: the picture that was begun last has been shown at least once */
    int dirty;                      /* 1: the camera, a light, the size or the mode has changed since then */
    int redraw;                     /* 1: the window must be drawn again */
    double moved, drawn, titled;    /* times of the last change, the last drawing, and the last title */
    sbl_mode mode;
    int channel, tone;
    double exposure;                /* in stops; NaN: automatic */
    double metered;                 /* the last automatic exposure in stops; NaN: none yet */
    int work_tone, work_metered;    /* tone of the picture that was begun last; 1: its exposure is automatic */
    double work_exposure;           /* exposure of that picture if it is not automatic */
    int stored;                     /* 1: the store holds the bounced light of the scene */
    sbl_light *lights;              /* copies of the lights of the scene, which the user may move */
    int light_count, light;         /* light: index of the selected light, or -1 */
    int lights_moved, lights_ever;  /* 1: they differ from those of the context; 1: from those of the file */
    int button, dragged, on_light;  /* mouse: held button or -1; 1: it was dragged; 1: it drags the light */
    double mouse[2], pressed[2], pivot[3];
    int click[2], clicked;          /* the pixel whose sensor the user asked for; 1: it has not been shown yet */
    int status, saves;              /* exit status; 1: save the picture when it is finished */
} view = { .exposure = NAN, .metered = NAN, .light = -1, .button = -1 };

static const sbl_scene_desc *view_scene(void) { return view.task->scene; }

static int unfinished(void) { return view.stage != NOTHING && view.result == SBL_UNFINISHED; }
static int finished(void) { return view.stage == PICTURE && view.result == SBL_SUCCESS; }

/* Marks the picture as outdated after a change. */
static void change(void) {
    view.dirty = 1;
    view.moved = now();
    overlay.has_sensor = view.clicked = 0;
}

/* Returns the exposure of the shown picture in stops. */
static double shown_exposure(void) {
    if (!isnan(view.exposure)) return view.exposure;
    return isnan(view.metered) ? 0 : view.metered;
}

/* ---- rendering ---- */

/* Returns 1 if a grey backdrop replaces the black behind the scene, as in a .png of sbl_render. */
static int wants_backdrop(void) { return !given[SKY] && !given[STUDIO] && is_lit(&view.task->file->scene); }

static void fill_desc(sbl_picture_desc *desc, int stage) {
    const int preview = stage == PREVIEW;
    int k;
    memset(desc, 0, sizeof *desc);
    for (k = 0; k < 2; k++) view.work_size[k] = view.size[k];
    for (k = 0; k < 2 && preview; k++)
        if (view.size[k] > VIEW_SMALLEST)
            view.work_size[k] = view.size[k] / VIEW_SHRINK > VIEW_SMALLEST ? view.size[k] / VIEW_SHRINK
                                                                          : VIEW_SMALLEST;
    desc->width = view.work_size[0];
    desc->height = view.work_size[1];
    desc->options = common_options(given, NULL);
    desc->options.progress = NULL;
    desc->options.mode = view.mode;
    desc->target_error = (float)options.target_error;
    desc->tile = common.tile;
    if (given[THRESHOLD]) desc->threshold = zero_or(common.threshold);
    if (given[FILTER_RADIUS]) desc->filter_radius = (int)zero_or(common.filter_radius);
    desc->samples = options.samples;
    desc->tone = tones[view.tone];
    view.work_metered = isnan(view.exposure) && (!preview || isnan(view.metered));
    view.work_exposure = view.work_metered ? 0 : shown_exposure();
    view.work_tone = view.tone;
    desc->auto_exposure = view.work_metered;
    desc->exposure = (float)view.work_exposure;
    if (wants_backdrop())
        memcpy(desc->backdrop, studio_backdrop, sizeof desc->backdrop);
    if (!preview) return;
    desc->options.preset = SBL_PRESET_DRAFT;
    desc->options.rays = 0;
    desc->target_error = 0;
    desc->samples = 1;
    desc->tile = 0;
    if (view.mode == SBL_MODE_GI && !view.stored) desc->options.mode = SBL_MODE_DIRECT;
}

static int give_up(const char *what, sbl_result result) {
    view.status = fail_with(view.task->said, what, result);
    glfwSetWindowShouldClose(view.window, 1);
    return 0;
}

/* Begins a preview or the final picture. Returns 0 on failure. */
static int begin(int stage) {
    const double start = steps__clock(CLOCK_MONOTONIC);
    sbl_picture_desc desc;
    sbl_result result = SBL_SUCCESS;
    if (view.lights_moved) {
        result = sbl_set_lights(view.context, view.lights, view.light_count);
        if (result != SBL_SUCCESS) return give_up("light", result);
        view.lights_moved = 0;
        view.lights_ever = 1;
        view.stored = 0;
        steps_note(&steps.longest_lights, start);
    }
    camera.size[0] = view.size[0];
    camera.size[1] = view.size[1];
    fill_desc(&desc, stage);
    /* a camera without matrices shows nothing until it moves */
    if (!camera_matrices(desc.world_to_view, desc.view_to_clip, &view.camera)) return 1;
    result = sbl_begin_picture(view.context, &desc);
    if (result != SBL_SUCCESS) return give_up(common.scene, result);
    memcpy(overlay.world_to_view, desc.world_to_view, sizeof desc.world_to_view);
    memcpy(overlay.view_to_clip, desc.view_to_clip, sizeof desc.view_to_clip);
    view.stage = stage;
    view.result = SBL_UNFINISHED;
    view.has_picture = view.dirty = 0;
    overlay.has_sensor = 0;
    steps_note(&steps.longest_begin, start);
    return 1;
}

/* Returns the channel to read for the window. The channel display fits only if tone and exposure have not changed since
   the picture was begun. */
static sbl_channel channel_to_show(void) {
    const int same = view.tone == view.work_tone && !view.dirty &&
        (view.work_metered ? isnan(view.exposure) : fabs(shown_exposure() - view.work_exposure) < 1e-9);
    if (view.channel) return channels[view.channel];
    return same ? SBL_CHANNEL_DISPLAY : SBL_CHANNEL_FINAL;
}

/* Draws a channel in false colours into the window. */
static void show_colors(sbl_channel channel) {
    image picture = { 0, 0, 0, NULL, NULL, { 0, 0 }, { 0, 0 }, NULL, 0 };
    picture_range range = picture_no_range;
    const size_t pixels = (size_t)view.work_size[0] * (size_t)view.work_size[1];
    const double stops = shown_exposure() + (picture_is_error(channel) ? PICTURE_ERROR_STOPS : 0);
    unsigned char *rgb = (unsigned char *)malloc(3 * pixels);
    if (rgb && picture_read(view.context, view.work_size[0], view.work_size[1], channel, &picture) == SBL_SUCCESS) {
        picture_extend(&range, picture.values, pixels, picture.components);
        picture__make_visible(rgb, picture.values, pixels, picture.components, channel, &range,
                              (float)pow(2, stops));
        view_set_colors(rgb, view.work_size[0], view.work_size[1]);
        view.has_picture = 1;
    }
    free(picture.values);
    free(rgb);
}

/* Copies the current state of the picture into the frame. */
static void take_picture(void) {
    const sbl_channel channel = channel_to_show();
    view_source source = { 0, 0, 0, 0, { 0, 0, 0 } };
    if (view.stage == NOTHING) return;
    if (view.channel) { show_colors(channel); return; }
    source.picture = sbl_channel_texture(view.context, channel);
    if (!source.picture) return;
    if (view.work_metered) view.metered = (double)sbl_query_stats(view.context).picture.exposure;
    if (channel == SBL_CHANNEL_FINAL) {
        source.tone = (int)tones[view.tone];
        source.factor = (float)pow(2, shown_exposure());
        source.depths = sbl_channel_texture(view.context, SBL_CHANNEL_DEPTH);
        if (wants_backdrop()) memcpy(source.backdrop, studio_backdrop, sizeof source.backdrop);
    }
    view_make_frame(&source, view.work_size);
    view.has_picture = 1;
}

/* Lets sbl.h work for one slice of time. Returns 0 on failure. */
static int work_on(void) {
    steps_enter(view.context);
    view.result = sbl_step(view.context, VIEW_SLICE);
    steps_leave(view.context, view.stage == PREVIEW);
    if (view.result != SBL_SUCCESS && view.result != SBL_UNFINISHED) return give_up(common.scene, view.result);
    if (view.mode == SBL_MODE_GI && !view.stored && view.stage == PICTURE)
        view.stored = view.result == SBL_SUCCESS || sbl_query_stats(view.context).picture.level_count > 0;
    if (view.result == SBL_SUCCESS) {
        view.redraw = 1;
        view.titled = 0;
        if (view.stage == PICTURE) detail("the picture is finished");
    }
    if (finished() && view.mode == SBL_MODE_GI && !view.lights_ever) {
        const int status = keep_store(view.task, given);
        if (status != DONE) { view.status = status; return 0; }
    }
    return 1;
}

/* Begins a preview or the final picture if that is due, and lets sbl.h work. Returns 0 on failure. */
static int advance(void) {
    const int seen = view.has_picture || !unfinished();
    if (view.dirty && (view.stage != PREVIEW || seen) && !begin(PREVIEW)) return 0;
    if (!view.dirty && view.stage == PREVIEW && seen && now() - view.moved > VIEW_REST && !begin(PICTURE)) return 0;
    return !unfinished() || work_on();
}

/* ---- inspecting the sensor of a pixel ---- */

static void look_into_sensor(void) {
    const float factor = (float)pow(2, shown_exposure());
    sbl_result result;
    view.clicked = 0;
    view.task->said->errors = 0;
    result = sbl_inspect_sensor(view.context, view.click[0], view.click[1], &overlay.sensor, NULL, NULL, 0);
    view.redraw = 1;
    if (result != SBL_SUCCESS) {
        overlay.has_sensor = 0;
        printf("pixel %d,%d: nothing to inspect: no surface is there\n", view.click[0], view.click[1]);
        fflush(stdout);
    } else if (!overlay_take(view.context, view.click, factor)) tell("there is no memory to inspect a pixel");
    view.task->said->errors = 0;
}

/* ---- drawing ---- */

/* Computes the world position of the mark of a light. A directional light has its mark beside the scene. */
static void light_place(const sbl_light *light, double out[3]) {
    const double reach = survey__radius(&view.seen) > 0 ? 0.5 * survey__radius(&view.seen) : 1;
    double way[3];
    int k;
    for (k = 0; k < 3; k++) way[k] = (double)light->direction[k];
    view_unit(way);
    for (k = 0; k < 3; k++)
        out[k] = light->kind == SBL_LIGHT_DIRECTIONAL ? survey__center(&view.seen, k) - reach * way[k]
                                                      : (double)light->position[k];
}

static void add_lights(void) {
    static const float plain[4] = { 0.7f, 0.7f, 0.7f, 0.8f }, selected[4] = { 1, 0.9f, 0.2f, 1 };
    double at[3], center[3];
    int i, k;
    for (i = 0; i < view.light_count && view.light >= 0; i++) {
        light_place(&view.lights[i], at);
        overlay_mark(at, VIEW_MARK * fabs(view_pixel(&view.camera, view_depth(&view.camera, at))),
                     i == view.light ? selected : plain);
        for (k = 0; k < 3; k++) center[k] = survey__center(&view.seen, k);
        if (view.lights[i].kind == SBL_LIGHT_DIRECTIONAL)
            overlay__line(at, center, i == view.light ? selected : plain);
    }
}

static void draw_bars(void) {
    static const float back[4] = { 0.05f, 0.05f, 0.05f, 1 }, yellow[4] = { 0.9f, 0.7f, 0.3f, 1 };
    static const float blue[4] = { 0.3f, 0.55f, 0.9f, 1 };
    const sbl_stats stats = sbl_query_stats(view.context);
    const double expected = (double)stats.picture.expected_error, target = (double)stats.picture.target_error;
    const double reached = expected > 0 ? fmin(1, target / expected) : 0;
    if (!unfinished() || view.stage != PICTURE) return;
    view_draw_rect(0, 0, view.size[0], 6, back);
    view_draw_rect(0, 3, (int)(view.size[0] * (double)sbl_progress(view.context)), 3, yellow);
    view_draw_rect(0, 0, (int)(view.size[0] * reached), 3, blue);
}

static void draw(void) {
    const double start = steps__clock(CLOCK_MONOTONIC);
    const double far_away = survey__radius(&view.seen) > 0 ? 2 * survey__radius(&view.seen) : 1e3;
    sbl_scene_desc scene = *view_scene();
    scene.lights = view.lights;
    view_draw_picture(view.size);
    overlay.count = 0;
    if (overlay.has_sensor) {
        static const float white[4] = { 1, 1, 1, 1 };
        double at[3];
        int k;
        for (k = 0; k < 3; k++) at[k] = (double)overlay.sensor.position[k];
        overlay_rays(&scene, far_away, (float)pow(2, shown_exposure()));
        overlay_lights(&scene, far_away);
        overlay_mark(at, 8 * fabs(view_pixel(&view.camera, view_depth(&view.camera, at))), white);
    }
    add_lights();
    if (overlay.count) view_draw_lines(overlay.corners, overlay.count, view.size);
    if (overlay.has_sensor) overlay_draw_sums(view.size[1]);
    draw_bars();
    glfwSwapBuffers(view.window);
    view.drawn = now();
    view.redraw = 0;
    steps_note(&steps.longest_draw, start);
}

static void set_title(void) {
    const sbl_stats stats = sbl_query_stats(view.context);
    const char *name = strrchr(common.scene, '/') ? strrchr(common.scene, '/') + 1 : common.scene;
    char title[TITLE_SIZE], error[96] = "", light[48] = "";
    const double expected = (double)stats.picture.expected_error;
    if (view.stage == PICTURE && expected > 0)
        snprintf(error, sizeof error, ", error %.2g %% (target %.2g %%)", 100 * expected,
                 100 * (double)stats.picture.target_error);
    if (view.light >= 0) snprintf(light, sizeof light, ", light %d of %d", view.light + 1, view.light_count);
    snprintf(title, sizeof title, "%.100s - %s%d %%%s, exposure %+.2f%s, %s, %s%s", name,
             view.stage == PREVIEW ? "preview " : "", (int)(100 * (double)sbl_progress(view.context)), error,
             shown_exposure(), isnan(view.exposure) ? " (auto)" : "", tone_words[view.tone],
             channel_words[view.channel], light);
    glfwSetWindowTitle(view.window, title);
    view.titled = now();
}

/* ---- saving ---- */

typedef struct saved { const char *name; const image *picture; sbl_channel channel; double stops; } saved;

static int write_saved(FILE *out, const void *what) {
    const saved *s = (const saved *)what;
    return picture_write(out, s->name, s->picture, s->channel, s->stops);
}

/* Returns the file name to save to: the name of --output, or the first numbered name that does not exist yet. */
static const char *name_to_save(void) {
    static char name[64];
    int i;
    if (given[OUTPUT]) return common.output;
    for (i = 1; i < 100000; i++) {
        snprintf(name, sizeof name, "sbl_view_%d.png", i);
        if (access(name, F_OK) != 0) break;
    }
    return name;
}

/* Reads the picture to save. For a .png without a selected channel, this is the frame as it is shown. Otherwise it is
   the values of the channel, which picture_write turns into colours for a .png. Returns 0 on failure. */
static int read_to_save(saved *s, image *picture) {
    if (view.channel || !scene__ends_with(s->name, ".png")) {
        s->channel = channels[view.channel];
        s->stops = shown_exposure() + (picture_is_error(s->channel) ? PICTURE_ERROR_STOPS : 0);
        return picture_read(view.context, view.work_size[0], view.work_size[1], s->channel, picture) == SBL_SUCCESS;
    }
    take_picture();
    s->channel = SBL_CHANNEL_FINAL;  /* the values are already exposed and tone-mapped */
    s->stops = 0;
    picture->width = view_gl.size[0];
    picture->height = view_gl.size[1];
    picture->components = 3;
    picture->values = (float *)malloc((size_t)view_gl.size[0] * (size_t)view_gl.size[1] * 3 * sizeof(float));
    if (!picture->values || !view_gl.size[0]) return 0;
    view_read_frame(picture->values);
    return 1;
}

static void save(void) {
    image picture = { 0, 0, 0, NULL, NULL, { 0, 0 }, { 0, 0 }, NULL, 0 };
    saved s = { name_to_save(), &picture, SBL_CHANNEL_FINAL, 0 };
    output_file target, *checked = &targets[OWN_TARGETS];
    view.saves = 0;
    if (!read_to_save(&s, &picture)) tell("there is nothing to save yet");
    else if (given[OUTPUT]) {
        if (target_write(checked, write_saved, &s, 0)) printf("saved %s\n", s.name);
        else view.status = fail_to_write(s.name);
    } else if (!output_find(&target, s.name)) tell("%s: cannot be written: %s", s.name, strerror(errno));
    else {
        if (target_write(&target, write_saved, &s, 0)) printf("saved %s\n", s.name);
        else tell("%s: cannot be written: %s", s.name, why_not_written());
        output_free(&target);
    }
    fflush(stdout);
    free(picture.values);
}

#include "view_input.h"

/* ---- the window ---- */

static char window_error[256];

static void on_window_error(int code, const char *text) {
    (void)code;
    snprintf(window_error, sizeof window_error, "%.250s", text);
}

/* Opens the window, once the scene has been read. Returns the exit status. */
static int open_window(scene_file *file) {
    int k, actual[2];
    (void)file;
    glfwSetErrorCallback(on_window_error);
    if (!glfwInit()) return fail("no window can be opened: %s; sbl_render needs no display", window_error);
    glfwWindowHint(GLFW_CONTEXT_VERSION_MAJOR, 3);
    glfwWindowHint(GLFW_CONTEXT_VERSION_MINOR, 3);
    glfwWindowHint(GLFW_OPENGL_PROFILE, GLFW_OPENGL_CORE_PROFILE);
    glfwWindowHint(GLFW_OPENGL_FORWARD_COMPAT, GLFW_TRUE);
    view.window = glfwCreateWindow(camera.size[0], camera.size[1], TOOL_NAME, NULL, NULL);
    if (!view.window) return fail("no window with OpenGL 3.3 can be opened: %s", window_error);
    glfwMakeContextCurrent(view.window);
    glfwSwapInterval(0);
    if (!host_gl_load(TOOL_NAME, glfwGetProcAddress) || !view_gl_start()) return FAILED;
    glfwGetFramebufferSize(view.window, &actual[0], &actual[1]);
    if (actual[0] > 0 && actual[1] > 0 && (actual[0] != camera.size[0] || actual[1] != camera.size[1]))
        /* the screen has several pixels per unit of window size, but --size counts pixels */
        glfwSetWindowSize(view.window, (int)((double)camera.size[0] * camera.size[0] / actual[0] + 0.5),
                          (int)((double)camera.size[1] * camera.size[1] / actual[1] + 0.5));
    for (k = 0; k < 2; k++) view.size[k] = camera.size[k];
    glfwSetKeyCallback(view.window, on_key);
    glfwSetCharCallback(view.window, on_character);
    glfwSetMouseButtonCallback(view.window, on_button);
    glfwSetCursorPosCallback(view.window, on_mouse);
    glfwSetScrollCallback(view.window, on_wheel);
    glfwSetFramebufferSizeCallback(view.window, on_size);
    glfwSetWindowRefreshCallback(view.window, on_refresh);
    glfwGetCursorPos(view.window, &view.mouse[0], &view.mouse[1]);
    view_draw_picture(view.size);
    glfwSwapBuffers(view.window);
    return DONE;
}

static sbl_gl_function find_gl(const char *name, void *user) {
    (void)user;
    return (sbl_gl_function)glfwGetProcAddress(name);
}

/* Chooses the camera, and the light of a file without light, as sbl_render does. Returns the exit status. */
static int arrange(tool_task *task, sbl_scene_desc *scene) {
    const int relight = given[STUDIO] ||
        (lit_by_us(&task->file->scene, given) && common_mode(given) != SBL_MODE_PAPER);
    survey *s = &view.seen;
    sbl_result result = SBL_SUCCESS;
    float world_to_view[16], view_to_clip[16];
    char words[256];
    view.task = task;
    view.mode = common_mode(given);
    survey_begin(s, task->context);
    if (!given[EYE]) camera_check(task->file);
    if (relight || (!given[EYE] && !camera_of_file(task->file, &view.camera, s)))
        result = survey_take(s, task->context);
    if (result == SBL_UNFINISHED) return stop("no picture was started");
    if (result != SBL_SUCCESS) return fail_with(task->said, common.scene, result);
    camera_choose(&view.chosen, task->file, given, s);
    view.camera = view.chosen;
    if (!camera_place(world_to_view, view_to_clip, &view.camera, given, s)) return camera_misuse();
    camera_words(words, sizeof words, &view.camera, s);
    detail("camera: %s: %s", view.camera.where, words);
    task->unplaced = !given[EYE] && camera_is_unplaced(task->file, s);
    return relight ? studio_set(task, scene, s, &view.chosen, view.camera.eye, given[STUDIO]) : DONE;
}

/* Runs one pass of the main loop. Returns 0 on failure. */
static int turn(void) {
    const double wait = view.channel ? VIEW_COLORS : VIEW_REDRAW;
    const int idle = !unfinished() && !view.dirty && view.stage == PICTURE && !view.redraw && !view.clicked;
    if (idle) glfwWaitEventsTimeout(0.1);
    else glfwPollEvents();
    fly();
    if (!advance()) return 0;
    if (view.clicked && finished()) look_into_sensor();
    if (view.redraw || (unfinished() && now() - view.drawn > wait)) {
        take_picture();
        draw();
    }
    if (now() - view.titled > 0.25 && (!idle || view.titled < view.moved)) set_title();
    if (!finished()) return 1;
    if (view.saves) save();
    if (given[ONCE]) { save(); glfwSetWindowShouldClose(view.window, 1); }
    return 1;
}

/* Shows the window until the user closes it. Returns the exit status. */
static int show(tool_task *task, double *seconds) {
    view.task = task;
    view.context = task->context;
    view.mode = common_mode(given);
    view.channel = options.channel;
    view.tone = options.tone;
    view.exposure = options.exposure;
    view.light_count = task->scene->light_count;
    view.lights = (sbl_light *)calloc((size_t)view.light_count + 1, sizeof *view.lights);
    if (!view.lights) return fail("there is not enough memory");
    memcpy(view.lights, task->scene->lights, (size_t)view.light_count * sizeof *view.lights);
    first_camera = view.camera;
    if (!given[QUIET]) tool__warn(task->file, task, given);
    given[QUIET] = 1;  /* the warnings were just printed; this prevents repeating them */
    view.redraw = view.dirty = 1;
    while (!glfwWindowShouldClose(view.window) && !interrupted && view.status == DONE && turn()) continue;
    alarm(0);
    if (view.lights_ever || !view.stored) task->makes_store = 0;
    *seconds = now() - task->start;
    if (view.status == DONE && interrupted) view.status = stop("the window is closed");
    return view.status;
}

/* Lists the files that this run may write, and checks them. Returns the exit status. */
static int find_targets(void) {
    targets_begin();
    if (given[OUTPUT]) output_find(&targets[OWN_TARGETS], common.output);
    if (options.histogram) output_find(&targets[OWN_TARGETS + 1], options.histogram);
    target_count = OWN_TARGETS + 2;
    return targets_check(target_count, given);
}

static int write_histogram(void) {
    if (!options.histogram) return DONE;
    return target_write(&targets[OWN_TARGETS + 1], steps_write, NULL, 1) ? DONE : fail_to_write(options.histogram);
}

int main(int argc, char **argv) {
    const double start = now();
    int status = parse(argc, argv);
    if (status != DONE) return status;
    if (given[HELP]) { print_help(); return fflush(stdout) == 0 ? DONE : FAILED; }
    if (given[VERSION]) { printf("sbl_view %s\n", sbl_version()); return fflush(stdout) == 0 ? DONE : FAILED; }
    catch_signals();
    tool_context_desc.get_gl_function = find_gl;
    tool_context_desc.longest_submission = 0.01f;
    tool_context_desc.compile_ahead = 1;
    status = find_targets();
    if (status == DONE) status = tool_run(start, given, show, open_window, arrange);
    if (status == DONE) status = write_histogram();
    if (view.window) view_gl_stop();
    glfwTerminate();
    studio_free(&studio_of_tool);
    steps_free();
    free(view.lights);
    targets_free();
    return status;
}
