/* bench_watch [--size N] [--slice SECONDS] [--runs N] [--twice] [--trace FILE] [NAME...]: measures what a host sees
   who shows a picture while it is made, in SBL_MODE_GI with default settings. It calls sbl_step and asks for the
   texture of SBL_CHANNEL_FINAL after each step, as examples/host_context.c does. For each room it prints the seconds of
   the whole picture; the shares of that time after which the first picture, the full store and the first picture with
   bounces came; the largest difference between sbl_progress and the true share of time, from 20 % of the time on, and
   where it occurs. Shares are shares of the CPU time of the process, which other programs on the machine disturb less
   than the time of a clock; LP_NUM_THREADS=0 makes the CPU time of llvmpipe the time of a machine with one core.
   --twice: a second picture is measured, for which the store exists already. --trace: writes all steps to a file. The
   scenes come from ../shared; those that do not exist are left out. */
#define _DEFAULT_SOURCE
#define SBL_IMPLEMENTATION
#include "../../sbl.h"
#include "../../examples/host_gl.h"
#include "../../examples/scene_file.h"
#include <stdlib.h>
#include <time.h>

enum { STEPS_MOST = 1 << 20 };

static const struct room {
    const char *name, *file;
    float eye[3], at[3], up[3], fov, sky;
} rooms[] = {
    { "cornell_box", "examples/scenes/cornell_box.obj", { 278, 273, -800 }, { 278, 273, 0 }, { 0, 1, 0 }, 39.3077f, 0 },
    { "staircase2", "../shared/scenes/staircase2/staircase2.glb", { 6.91182f, 1.65163f, 2.55414f },
      { 6.011643f, 1.65163f, 2.118617f }, { 0, 1, 0 }, 70, 0 },
    { "living-room", "../shared/scenes/living-room/living-room.glb", { 5.10518f, 0.731065f, -2.31789f },
      { 4.143388f, 0.805472f, -2.054414f }, { 0.071763f, 0.997228f, -0.019659f }, 58.7155f, 1 },
    { "veach-ajar", "../shared/scenes/veach-ajar/veach-ajar.glb", { 4.05402f, 1.61647f, -2.30652f },
      { 3.064005f, 1.584172f, -2.443733f }, { -0.0319925f, 0.999478f, -0.00443408f }, 35.9834f, 0 }
};

static struct settings { int size, runs, twice; double slice; FILE *trace; } settings = { 512, 1, 0, 0.02, NULL };

static double clock_of(clockid_t id) {
    struct timespec t;
    clock_gettime(id, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static sbl_gl_function gl_function(const char *name, void *user) {
    (void)user;
    return eglGetProcAddress(name);
}

/* What the host sees after a step. */
typedef struct step { double wall, cpu; float progress; int shown, store, bounced; } step;

static step steps[STEPS_MOST];

/* Makes the picture in steps. Returns the number of steps, or 0 on failure. */
static int watch(sbl_context *context, const sbl_picture_desc *view) {
    const double wall = clock_of(CLOCK_MONOTONIC), cpu = clock_of(CLOCK_PROCESS_CPUTIME_ID);
    sbl_result result = sbl_begin_picture(context, view);
    int count = 0;
    if (result == SBL_SUCCESS) result = SBL_UNFINISHED;
    while (result == SBL_UNFINISHED && count < STEPS_MOST) {
        const sbl__map *map = &context->picture.map;
        const int stage = map->work.stages.stage, refine = map->refine.stages.stage;
        const int bounce = context->core.bounce ? context->core.bounce->stages.stage : -1;
        step *s = &steps[count++];
        result = sbl_step(context, settings.slice);
        s->shown = sbl_channel_texture(context, SBL_CHANNEL_FINAL) != 0;
        s->wall = clock_of(CLOCK_MONOTONIC) - wall;
        s->cpu = clock_of(CLOCK_PROCESS_CPUTIME_ID) - cpu;
        s->progress = sbl_progress(context);
        s->store = context->core.scene.store.ready;
        s->bounced = s->shown && s->store && context->picture.map.previewed > 0;
        if (settings.trace)
            fprintf(settings.trace, "%.4f %.4f %.4f map %d bounce %d refine %d shown %d looks %.0f error %.4f\n",
                    s->wall, s->cpu, (double)s->progress, stage, bounce, refine, s->shown,
                    (double)sbl__refine_looks(&map->refine), sbl__refine_error(&map->refine));
    }
    return result == SBL_SUCCESS ? count : 0;
}

/* Returns 0 if something does not work. */
static int measure(const struct room *r) {
    char error[512];
    scene_file *file = scene_file_load(r->file, NULL, error, sizeof error);
    sbl_context_desc desc = { 0 };
    sbl_picture_desc view = { 0 };
    sbl_scene_desc scene;
    sbl_context *context = NULL;
    int i, run, ok;
    if (!file) return fprintf(stderr, "bench_watch: %s\n", error), 0;
    scene = file->scene;
    for (i = 0; i < 3; i++) scene.sky[i] = r->sky;
    view.width = view.height = settings.size;
    view.options.mode = SBL_MODE_GI;
    sbl_look_at(view.world_to_view, r->eye[0], r->eye[1], r->eye[2], r->at[0], r->at[1], r->at[2], r->up[0], r->up[1],
                r->up[2]);
    sbl_perspective(view.view_to_clip, r->fov, 1);
    desc.get_gl_function = gl_function;
    ok = sbl_create(&desc, &context) == SBL_SUCCESS;
    for (run = 0; run <= settings.runs && ok; run++) {  /* run 0 compiles shaders */
        int count, shown = -1, bounced = -1, store = -1;
        double all, worst = 0, worst_at = 0, back = 0;
        ok = sbl_set_scene(context, &scene) == SBL_SUCCESS;
        if (settings.twice) ok = ok && sbl_render_picture(context, &view) == SBL_SUCCESS;
        if (!ok || (run == 0 && settings.twice)) continue;
        if (settings.trace) fprintf(settings.trace, "# %s run %d\n", r->name, run);
        ok = (count = watch(context, &view)) > 0;
        if (!ok || run == 0) continue;
        all = steps[count - 1].cpu;
        for (i = 0; i < count; i++) {
            const step *s = &steps[i];
            const double share = s->cpu / all, off = (double)s->progress - share;
            if (s->shown && shown < 0) shown = i;
            if (s->store && store < 0) store = i;
            if (s->bounced && bounced < 0) bounced = i;
            if (i && s->progress < steps[i - 1].progress) back = 1;
            if (share >= 0.2 && fabs(off) > fabs(worst)) { worst = off; worst_at = share; }
        }
        printf("%-12s %d: %6.2f s of CPU, %6.2f s; first picture %.3f, store %.3f, with bounces %.3f; progress off by "
               "%+.3f at %.2f%s\n", r->name, settings.size, all, steps[count - 1].wall, steps[shown].cpu / all,
               steps[store].cpu / all, steps[bounced].cpu / all, worst, worst_at, back > 0 ? "; IT DECREASES" : "");
        fflush(stdout);
    }
    sbl_destroy(context);
    scene_file_free(file);
    if (!ok) fprintf(stderr, "bench_watch: %s failed\n", r->name);
    return ok;
}

int main(int argc, char **argv) {
    int i, k, named = 0, ok = 1;
    for (i = 1; i < argc; i++) {
        const char *value = i + 1 < argc ? argv[i + 1] : "";
        if (strcmp(argv[i], "--twice") == 0) settings.twice = 1;
        else if (strcmp(argv[i], "--size") == 0 && atoi(value) > 0) { settings.size = atoi(value); i++; }
        else if (strcmp(argv[i], "--runs") == 0 && atoi(value) > 0) { settings.runs = atoi(value); i++; }
        else if (strcmp(argv[i], "--slice") == 0 && atof(value) > 0) { settings.slice = atof(value); i++; }
        else if (strcmp(argv[i], "--trace") == 0 && (settings.trace = fopen(value, "w")) != NULL) i++;
        else if (argv[i][0] == '-')
            return fprintf(stderr, "usage: bench_watch [--size N] [--slice SECONDS] [--runs N] [--twice] "
                                   "[--trace FILE] [NAME...]\n"), 2;
        else named = 1;
    }
    if (!host_gl_open("bench_watch")) return 1;
    for (k = 0; k < (int)(sizeof rooms / sizeof *rooms); k++) {
        FILE *there = fopen(rooms[k].file, "rb");
        int wanted = !named;
        for (i = 1; i < argc; i++) wanted = wanted || strcmp(argv[i], rooms[k].name) == 0;
        if (there) fclose(there);
        if (there && wanted) ok = measure(&rooms[k]) && ok;
    }
    if (settings.trace) fclose(settings.trace);
    host_gl_close();
    return !ok;
}
