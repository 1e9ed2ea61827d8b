/* See version.h. It is compiled with -DVERSION=version_now and this header, and with -DVERSION=version_before and an
   older header, whose implementation is then static. The include path selects sbl.h and the folder examples. */
#define _DEFAULT_SOURCE
#include <sbl.h>
#include <examples/scene_file.h>
#include "version.h"

static scene_file *file;
static sbl_context *context;

static int version_load(const char *path) {
    char error[512];
    file = scene_file_load(path, NULL, error, sizeof error);
    return file != NULL || (fprintf(stderr, "%s\n", error), 0);
}

/* errors only, because a window may be empty, which gives a warning */
static void version_log(sbl_log_level level, sbl_log_item item, const char *message, void *user) {
    (void)item;
    (void)user;
    if (level == SBL_LOG_ERROR) fprintf(stderr, "%s\n", message);
}

static int version_start(void (*(*get)(const char *name, void *user))(void), float sky) {
    sbl_context_desc desc = { 0 };
    sbl_scene_desc scene = file->scene;
    desc.get_gl_function = get;
    desc.logger.log = version_log;
    scene.sky[0] = scene.sky[1] = scene.sky[2] = sky;
    return sbl_create(&desc, &context) == SBL_SUCCESS && sbl_set_scene(context, &scene) == SBL_SUCCESS;
}

/* Changes the projection so that it shows only a window of the picture. */
static void crop(float m[16], const version_view *view, const int window[4]) {
    const double x = (2.0 * window[0] + window[2]) / view->width - 1,
        y = 1 - (2.0 * window[1] + window[3]) / view->height;
    const double scale_x = (double)view->width / window[2], scale_y = (double)view->height / window[3];
    int i;
    for (i = 0; i < 16; i += 4) {
        m[i] = (float)(scale_x * (m[i] - x * m[i + 3]));
        m[i + 1] = (float)(scale_y * (m[i + 1] - y * m[i + 3]));
    }
}

/* Names that differ between the two interfaces. */
#ifdef VERSION_HAS_ERROR
#define VERSION_OPTION(name) options.name
#define VERSION_RENDER sbl_render_picture
#define VERSION_SENSORS sensors.count
#else
#define VERSION_OPTION(name) name
#define VERSION_RENDER sbl_render
#define VERSION_SENSORS sensors
#endif

static int version_render(const version_view *view, const version_settings *settings, float *radiance,
                          version_cost *cost) {
    static const sbl_preset presets[3] = { SBL_PRESET_DRAFT, SBL_PRESET_DEFAULT, SBL_PRESET_HIGH };
    const double *e = view->eye, *a = view->look_at, *u = view->up;
    sbl_picture_desc desc = { 0 };
    sbl_stats stats;
    desc.width = settings->window[2] ? settings->window[2] : view->width;
    desc.height = settings->window[2] ? settings->window[3] : view->height;
    desc.VERSION_OPTION(mode) = SBL_MODE_DIRECT;
    desc.VERSION_OPTION(preset) = presets[settings->preset];
    desc.VERSION_OPTION(seed) = (uint32_t)settings->seed;
#ifdef VERSION_HAS_ERROR
    desc.target_error = settings->error;
#endif
    if (settings->rays) {
        desc.VERSION_OPTION(rays) = settings->rays;
        desc.tile = desc.samples = 1;
        desc.filter_radius = -1;
    }
    sbl_look_at(desc.world_to_view, (float)e[0], (float)e[1], (float)e[2], (float)a[0], (float)a[1], (float)a[2],
                (float)u[0], (float)u[1],
                (float)u[2]);
    sbl_perspective(desc.view_to_clip, (float)view->fov, (float)view->width / (float)view->height);
    if (settings->window[2]) crop(desc.view_to_clip, view, settings->window);
    if (VERSION_RENDER(context, &desc) != SBL_SUCCESS) return 0;
    stats = sbl_query_stats(context);
    cost->seconds = stats.seconds.total - stats.seconds.scene;
    cost->sensors = (long long)stats.VERSION_SENSORS;
    return sbl_read_channel(context, SBL_CHANNEL_RADIANCE, radiance, (size_t)desc.width * (size_t)desc.height * 3) ==
           SBL_SUCCESS;
}

static void version_stop(void) {
    sbl_destroy(context);
    scene_file_free(file);
    context = NULL;
    file = NULL;
}

extern const version VERSION;
const version VERSION = { version_load, version_start, version_render, version_stop };
