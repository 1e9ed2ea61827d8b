/* bench_watch [--size N] [--slice SECONDS] [--runs N] [--twice] [--trace FILE] [--random N] [NAME...]: measures what
   the user of a host sees while a picture is rendered in SBL_MODE_GI with default settings. It calls sbl_step and asks
   for the texture of SBL_CHANNEL_FINAL after each step, as examples/host_context.c does. For each room it prints the
   seconds of the complete picture; the shares of that time after which the first picture, the full store and the first
   picture with bounces were available; and the largest difference between sbl_progress and the true share of time, from
   20 % of the time on, and where it occurs. Shares are shares of the processor time of the process, which other
   programs on the machine disturb less than the time of a clock; with LP_NUM_THREADS=0, the processor time of llvmpipe
   is the time of a machine with one core. --twice: measures a second picture, for which the store already exists.
   --trace: writes all steps to a file. The scenes come from ../shared; missing ones are omitted. --random: measures N
   random rooms instead. */
#define _DEFAULT_SOURCE
#include "../support/private.h"
#include <sys/time.h>
#include "../../examples/host_gl.h"
#include "../../examples/scene_file.h"
#include "bench_rooms.h"
#include <stdlib.h>

enum { STEPS_MOST = 1 << 20 };

static struct settings {
    int size, runs, twice, random;
    double slice;
    FILE *trace;
} settings = { 512, 1, 0, 0, 0.02, NULL };

/* The clock from which sbl.h predicts times, which the linker calls instead of gettimeofday; see scripts/Makefile. It
   returns the processor time of the process, as in the measurements. */
int __wrap_gettimeofday(struct timeval *out, void *zone);
int __wrap_gettimeofday(struct timeval *out, void *zone) {
    const double t = bench_clock(CLOCK_PROCESS_CPUTIME_ID);
    (void)zone;
    out->tv_sec = (time_t)t;
    out->tv_usec = (suseconds_t)(1e6 * (t - floor(t)));
    return 0;
}

static sbl_gl_function gl_function(const char *name, void *user) {
    (void)user;
    return eglGetProcAddress(name);
}

/* The state that the host sees after a step. */
typedef struct step { double wall, cpu; float progress; int shown, store, bounced; } step;

static step steps[STEPS_MOST];

/* Renders the picture in steps. Returns the number of steps, or 0 on failure. */
static int watch(sbl_context *context, const sbl_picture_desc *view) {
    const double wall = bench_clock(CLOCK_MONOTONIC), cpu = bench_clock(CLOCK_PROCESS_CPUTIME_ID);
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
        s->wall = bench_clock(CLOCK_MONOTONIC) - wall;
        s->cpu = bench_clock(CLOCK_PROCESS_CPUTIME_ID) - cpu;
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

/* Measures a room of the table, or a random one. Returns 0 if something does not work. r: name and file; NULL: the
   random room of the seed */
static int measure(const bench_room *r, unsigned seed) {
    sbl_context_desc desc = { 0 };
    sbl_picture_desc view = { 0 };
    sbl_scene_desc scene;
    const int size = settings.size;
    scene_file *file = r ? bench_room_load(r, size, size, &scene, &view) : NULL;
    bench_random *random = r ? NULL : bench_room_random(seed, size, size, &scene, &view);
    char name[32] = "";
    sbl_context *context = NULL;
    int i, run, ok;
    if (!file && !random) return 0;
    if (r) snprintf(name, sizeof name, "%s", r->name);
    else snprintf(name, sizeof name, "random %u", seed);
    view.options.mode = SBL_MODE_GI;
    desc.get_gl_function = gl_function;
    ok = sbl_create(&desc, &context) == SBL_SUCCESS;
    for (run = 0; run <= settings.runs && ok; run++) {  /* run 0 compiles shaders */
        int count, shown = -1, bounced = -1, store = -1;
        double all, worst = 0, worst_at = 0, back = 0;
        ok = sbl_set_scene(context, &scene) == SBL_SUCCESS;
        if (settings.twice) ok = ok && sbl_render_picture(context, &view) == SBL_SUCCESS;
        if (!ok || (run == 0 && settings.twice)) continue;
        if (settings.trace) fprintf(settings.trace, "# %s run %d\n", name, run);
        ok = (count = watch(context, &view)) > 0;
        if (!ok || run == 0) continue;
        all = steps[count - 1].cpu;
        for (i = 0; i < count; i++) {
            const step *s = &steps[i];
            const double share = s->cpu / all, off = (double)s->progress - share;
            if (s->shown && shown < 0) shown = i;
            if (s->store && store < 0) store = i;
            if ((s->bounced || i == count - 1) && bounced < 0) bounced = i;
            if (i && s->progress < steps[i - 1].progress) back = 1;
            if (share >= 0.2 && fabs(off) > fabs(worst)) { worst = off; worst_at = share; }
        }
        printf("%-12s %d: %6.2f s of CPU, %6.2f s; first picture %.3f, store %.3f, with bounces %.3f; progress off by "
               "%+.3f at %.2f%s\n", name, settings.size, all, steps[count - 1].wall, steps[shown].cpu / all,
               steps[store].cpu / all, steps[bounced].cpu / all, worst, worst_at, back > 0 ? "; IT DECREASES" : "");
        fflush(stdout);
    }
    sbl_destroy(context);
    scene_file_free(file);
    free(random);
    if (!ok) fprintf(stderr, "bench_watch: %s failed\n", name);
    return ok;
}

int main(int argc, char **argv) {
    int i, k, named = 0, ok = 1;
    for (i = 1; i < argc; i++) {
        const char *value = i + 1 < argc ? argv[i + 1] : "";
        if (strcmp(argv[i], "--twice") == 0) settings.twice = 1;
        else if (strcmp(argv[i], "--size") == 0 && atoi(value) > 0) { settings.size = atoi(value); i++; }
        else if (strcmp(argv[i], "--random") == 0 && atoi(value) > 0) { settings.random = atoi(value); i++; }
        else if (strcmp(argv[i], "--runs") == 0 && atoi(value) > 0) { settings.runs = atoi(value); i++; }
        else if (strcmp(argv[i], "--slice") == 0 && atof(value) > 0) { settings.slice = atof(value); i++; }
        else if (strcmp(argv[i], "--trace") == 0 && (settings.trace = fopen(value, "w")) != NULL) i++;
        else if (argv[i][0] == '-')
            return fprintf(stderr, "usage: bench_watch [--size N] [--slice SECONDS] [--runs N] [--twice] "
                                   "[--trace FILE] [--random N] [NAME...]\n"), 2;
        else named = 1;
    }
    if (!host_gl_open("bench_watch")) return 1;
    for (k = 0; k < BENCH_ROOMS; k++) {
        int wanted = !named && !settings.random;
        for (i = 1; i < argc; i++) wanted = wanted || strcmp(argv[i], bench_rooms[k].name) == 0;
        if (wanted && bench_room_exists(&bench_rooms[k])) ok = measure(&bench_rooms[k], 0) && ok;
    }
    for (k = 1; k <= settings.random; k++) ok = measure(NULL, (unsigned)k) && ok;
    if (settings.trace) fclose(settings.trace);
    host_gl_close();
    return !ok;
}
