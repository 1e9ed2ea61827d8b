/* bench_steps [--slice SECONDS] [NAME...]: measures how long sbl_step takes for a requested slice, and the cost of
   slices. For each picture it prints the seconds of sbl_begin_picture, a histogram of the seconds of all calls of
   sbl_step including those that build the hierarchy (shaders are compiled before), the sum of the seconds of all steps
   compared with those of one sbl_render_picture, and the longest submission. A submission is the work that GL gets from
   one flush, wait or readback to the next; it is measured in a picture whose calls wait for GL at these points.
   Pictures: the Cornell box, and two rooms if ../shared exists. A slow result is never a failure. */
#define _DEFAULT_SOURCE
#define SBL_IMPLEMENTATION
#include "../../sbl.h"
#include "../../examples/host_gl.h"
#include "../../examples/scene_file.h"
#include "bench_rooms.h"
#include <stdlib.h>

enum { STEPS_MOST = 1 << 20 };

static double now(void) { return bench_clock(CLOCK_MONOTONIC); }

/* ---- submissions: the GL functions for sbl.h note when work starts, and wait where sbl.h flushes */

static struct { int on, open; double start, longest; int count; } submission;

typedef void(APIENTRY *draw_arrays_function)(GLenum, GLint, GLsizei);
typedef void(APIENTRY *draw_elements_function)(GLenum, GLsizei, GLenum, const void *);
typedef void(APIENTRY *draw_arrays_instanced_function)(GLenum, GLint, GLsizei, GLsizei);
typedef void(APIENTRY *draw_elements_instanced_function)(GLenum, GLsizei, GLenum, const void *, GLsizei);
typedef void(APIENTRY *dispatch_function)(GLuint, GLuint, GLuint);
typedef void(APIENTRY *read_pixels_function)(GLint, GLint, GLsizei, GLsizei, GLenum, GLenum, void *);

static void work_starts(void) {
    if (!submission.on || submission.open) return;
    submission.open = 1;
    submission.start = now();
}

static void work_ends(void) {
    double seconds;
    if (!submission.on || !submission.open) return;
    gl.Finish();
    seconds = now() - submission.start;
    submission.open = 0;
    submission.count++;
    if (seconds > submission.longest) submission.longest = seconds;
}

static void APIENTRY draw_arrays(GLenum mode, GLint first, GLsizei count) {
    work_starts();
    ((draw_arrays_function)eglGetProcAddress("glDrawArrays"))(mode, first, count);
}
static void APIENTRY draw_elements(GLenum mode, GLsizei count, GLenum type, const void *indices) {
    work_starts();
    ((draw_elements_function)eglGetProcAddress("glDrawElements"))(mode, count, type, indices);
}
static void APIENTRY draw_arrays_instanced(GLenum mode, GLint first, GLsizei count, GLsizei instances) {
    work_starts();
    ((draw_arrays_instanced_function)eglGetProcAddress("glDrawArraysInstanced"))(mode, first, count, instances);
}
static void APIENTRY draw_elements_instanced(GLenum mode, GLsizei count, GLenum type, const void *indices,
                                             GLsizei instances) {
    work_starts();
    ((draw_elements_instanced_function)eglGetProcAddress("glDrawElementsInstanced"))(mode, count, type, indices,
                                                                      instances);
}
static void APIENTRY dispatch(GLuint x, GLuint y, GLuint z) {
    work_starts();
    ((dispatch_function)eglGetProcAddress("glDispatchCompute"))(x, y, z);
}
static void APIENTRY read_pixels(GLint x, GLint y, GLsizei width, GLsizei height, GLenum format, GLenum type,
                                 void *pixels) {
    work_ends();
    ((read_pixels_function)eglGetProcAddress("glReadPixels"))(x, y, width, height, format, type, pixels);
}
static void APIENTRY finish(void) { work_ends(); gl.Finish(); }
static void APIENTRY flush(void) { work_ends(); }

static sbl_gl_function gl_function(const char *name, void *user) {
    static const struct { const char *name; sbl_gl_function function; } watched[] = {
        { "glDrawArrays", (sbl_gl_function)draw_arrays }, { "glDrawElements", (sbl_gl_function)draw_elements },
        { "glDrawArraysInstanced", (sbl_gl_function)draw_arrays_instanced },
        { "glDrawElementsInstanced", (sbl_gl_function)draw_elements_instanced },
        { "glDispatchCompute", (sbl_gl_function)dispatch }, { "glReadPixels", (sbl_gl_function)read_pixels },
        { "glFinish", (sbl_gl_function)finish }, { "glFlush", (sbl_gl_function)flush } };
    size_t i;
    (void)user;
    for (i = 0; i < sizeof watched / sizeof *watched; i++)
        if (strcmp(name, watched[i].name) == 0) return watched[i].function;
    return eglGetProcAddress(name);
}

/* ---- the pictures */

static const struct picture {
    int room;  /* index in bench_rooms */
    int width, height;
    sbl_preset preset;
    sbl_mode mode;
} pictures[] = {
    { 0, 512, 512, SBL_PRESET_DEFAULT, SBL_MODE_AMBIENT },
    { 2, 1280, 720, SBL_PRESET_DEFAULT, SBL_MODE_DIRECT },
    { 1, 256, 256, SBL_PRESET_HIGH, SBL_MODE_DIRECT }
};

static int ascending(const void *a, const void *b) {
    const double x = *(const double *)a, y = *(const double *)b;
    return x < y ? -1 : x > y;
}

/* Measures a picture. Returns 0 if something does not work. */
static int measure(const struct picture *p, double slice) {
    static const double edges[] = { 0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1e30 };
    static double steps[STEPS_MOST];
    const char *name = bench_rooms[p->room].name;
    sbl_context_desc desc = { 0 };
    sbl_picture_desc view = { 0 };
    sbl_scene_desc scene;
    scene_file *file = bench_room_load(&bench_rooms[p->room], p->width, p->height, &scene, &view);
    sbl_context *context = NULL;
    sbl_result result = SBL_SUCCESS;
    double start, begin, easy, all;
    int count = 0, i, n, slowest = 0, ok;
    if (!file) return 0;
    view.options.preset = p->preset;
    view.options.mode = p->mode;
    view.facet_limit = 2;
    desc.get_gl_function = gl_function;
    ok = sbl_create(&desc, &context) == SBL_SUCCESS && sbl_set_scene(context, &scene) == SBL_SUCCESS &&
         sbl_render_picture(context, &view) == SBL_SUCCESS; /* compiles shaders */
    start = now();
    ok = ok && sbl_set_scene(context, &scene) == SBL_SUCCESS && sbl_render_picture(context, &view) == SBL_SUCCESS;
    easy = now() - start;
    start = now();
    ok = ok && sbl_set_scene(context, &scene) == SBL_SUCCESS;
    easy -= now() - start;
    start = now();
    ok = ok && sbl_begin_picture(context, &view) == SBL_SUCCESS;
    all = begin = now() - start;
    do {
        start = now();
        if (ok) result = sbl_step(context, slice);
        steps[count] = now() - start;
        all += steps[count];
        if (steps[count] > steps[slowest]) slowest = count;
        count++;
    } while (ok && result == SBL_UNFINISHED && count < STEPS_MOST);
    ok = ok && result == SBL_SUCCESS;
    submission.on = 1;
    ok = ok && sbl_set_scene(context, &scene) == SBL_SUCCESS && sbl_render_picture(context, &view) == SBL_SUCCESS;
    submission.on = submission.open = 0;
    sbl_destroy(context);
    scene_file_free(file);
    if (!ok) return fprintf(stderr, "bench_steps: %s failed\n", name), 0;
    printf("%s %d x %d, preset %d: slices of %g ms\n", name, p->width, p->height, (int)p->preset, 1e3 * slice);
    printf("  in one call %.2f s, in steps %.2f s (%+.1f %%); begin %.1f ms\n", easy, all, 100 * (all / easy - 1),
           1e3 * begin);
    printf("  longest submission %.0f ms of %d\n", 1e3 * submission.longest, submission.count);
    printf("  the slowest step is number %d of %d\n", slowest + 1, count);
    submission.longest = 0;
    submission.count = 0;
    qsort(steps, (size_t)count, sizeof *steps, ascending);
    printf("  median %.2f ms, 99 %% %.2f ms, 99.9 %% %.2f ms, longest %.2f ms\n", 1e3 * steps[count / 2],
           1e3 * steps[(count - 1) * 99 / 100],
           1e3 * steps[(int)((count - 1) * 0.999)], 1e3 * steps[count - 1]);
    for (i = n = 0; i < (int)(sizeof edges / sizeof *edges); i++) {
        int from = n;
        while (n < count && steps[n] < edges[i]) n++;
        if (n > from)
            printf("    %s%g ms: %d\n", i + 1 < (int)(sizeof edges / sizeof *edges) ? "below " : "above ",
                   1e3 * edges[i < 9 ? i : 8], n - from);
    }
    return 1;
}

int main(int argc, char **argv) {
    double slice = 0.005;
    int i, k, named = 0, ok = 1;
    for (i = 1; i < argc; i++) {
        if (strcmp(argv[i], "--slice") == 0 && i + 1 < argc) slice = atof(argv[++i]);
        else if (argv[i][0] == '-') return fprintf(stderr, "usage: bench_steps [--slice SECONDS] [NAME...]\n"), 2;
        else named = 1;
    }
    if (!host_gl_open("bench_steps")) return 1;
    printf("%s\n", (const char *)gl.GetString(GL_RENDERER));
    for (k = 0; k < (int)(sizeof pictures / sizeof *pictures); k++) {
        const bench_room *room = &bench_rooms[pictures[k].room];
        int wanted = !named;
        for (i = 1; i < argc; i++) wanted = wanted || strcmp(argv[i], room->name) == 0;
        if (wanted && bench_room_exists(room)) ok = measure(&pictures[k], slice) && ok;
    }
    host_gl_close();
    return !ok;
}
