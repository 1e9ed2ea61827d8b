/* Measures how long each call of sbl_step makes the window of sbl_view wait, and why. Include after tool_scene.h.

   Each step has three times: wall time, which the user perceives; processor time of the drawing thread, which sbl.h and
   the driver use there; and processor time of the process. If the system gives the processor to another program
   meanwhile, the wall time grows. The kernel counts these interruptions; a step with one is called disturbed. With
   LP_NUM_THREADS=0, the software renderer of Mesa works in the drawing thread alone, so that wall time and processor
   time of an undisturbed step agree. */
#ifndef VIEW_STEPS_H
#define VIEW_STEPS_H

#include <time.h>

enum { STEPS_MAX = 1 << 20, STEPS_SLOWEST = 16, STEPS_EDGES = 9 };

static const char *const steps_phases[] = { "surface", "bounce", "gather", "refine", "filter", "resolve" };

/* The clocks and counters at one moment. */
typedef struct steps_state {
    double wall, own, all;      /* seconds: wall clock; processor time of thread and of process */
    long interruptions;
    int programs;
    double phases[6];           /* the times of sbl_stats.seconds */
} steps_state;

typedef struct steps_step {
    float wall, own, all;       /* in seconds, as above */
    short disturbed, programs;  /* number of interruptions; number of GL programs compiled */
    short phase, preview;       /* index in steps_phases of the slowest phase; 1: a step of a preview */
} steps_step;

static struct steps {
    steps_step *list;
    int count;
    steps_state before;
    double longest_begin, longest_lights, longest_draw;  /* longest times of other calls in seconds */
} steps;

static double steps__clock(clockid_t clock) {
    struct timespec t;
    clock_gettime(clock, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static void steps__look(const sbl_context *context, steps_state *s) {
    const sbl_stats stats = sbl_query_stats(context);
    const double phases[6] = { stats.seconds.surface, stats.seconds.bounce, stats.seconds.gather, stats.seconds.refine,
                               stats.seconds.filter, stats.seconds.resolve };
    struct rusage use;
    getrusage(RUSAGE_THREAD, &use);
    memcpy(s->phases, phases, sizeof phases);
    s->interruptions = use.ru_nivcsw;
    s->programs = sbl_query_programs(context).compiled;
    s->wall = steps__clock(CLOCK_MONOTONIC);
    s->own = steps__clock(CLOCK_THREAD_CPUTIME_ID);
    s->all = steps__clock(CLOCK_PROCESS_CPUTIME_ID);
}

/* Call steps_enter before and steps_leave after a call of sbl_step. */
static void steps_enter(const sbl_context *context) {
    if (!steps.list) steps.list = (steps_step *)malloc(STEPS_MAX * sizeof *steps.list);
    steps__look(context, &steps.before);
}

static void steps_leave(const sbl_context *context, int preview) {
    const steps_state *b = &steps.before;
    steps_state after;
    steps_step *s = steps.list && steps.count < STEPS_MAX ? &steps.list[steps.count] : NULL;
    int i;
    steps__look(context, &after);
    if (!s) return;
    s->wall = (float)(after.wall - b->wall);
    s->own = (float)(after.own - b->own);
    s->all = (float)(after.all - b->all);
    s->disturbed = (short)(after.interruptions - b->interruptions);
    s->programs = (short)(after.programs - b->programs);
    s->preview = (short)preview;
    s->phase = 0;
    for (i = 1; i < 6; i++)
        if (after.phases[i] - b->phases[i] > after.phases[s->phase] - b->phases[s->phase]) s->phase = (short)i;
    steps.count++;
}

/* Raises *longest to the seconds since `start`, when a call began, if they are more. */
static void steps_note(double *longest, double start) {
    const double seconds = steps__clock(CLOCK_MONOTONIC) - start;
    if (seconds > *longest) *longest = seconds;
}

static int steps__ascending(const void *a, const void *b) {
    const float x = *(const float *)a, y = *(const float *)b;
    return x < y ? -1 : x > y;
}

static int steps__slower(const void *a, const void *b) {
    const float x = ((const steps_step *)a)->wall, y = ((const steps_step *)b)->wall;
    return x < y ? 1 : x > y ? -1 : 0;
}

/* Writes percentiles and a histogram of n sorted times. */
static void steps__write_times(FILE *out, const char *name, float *times, int n) {
    static const double edges[STEPS_EDGES] = { 1, 2, 5, 10, 15, 20, 50, 100, 1e30 };
    int i, k, below = 0;
    qsort(times, (size_t)n, sizeof *times, steps__ascending);
    fprintf(out, "  \"%s\": {\"steps\": %d", name, n);
    if (n)
        fprintf(out, ", \"median_ms\": %.3f, \"p99_ms\": %.3f, \"longest_ms\": %.3f", 1e3 * (double)times[n / 2],
                1e3 * (double)times[(int)(0.99 * (n - 1) + 0.5)], 1e3 * (double)times[n - 1]);
    fprintf(out, ",\n    \"histogram\": [");
    for (k = 0; k < STEPS_EDGES; k++) {
        const int from = below;
        for (i = from; i < n && 1e3 * (double)times[i] < edges[k]; i++) below++;
        if (k < STEPS_EDGES - 1) fprintf(out, "{\"below_ms\": %g, \"steps\": %d}, ", edges[k], below - from);
        else fprintf(out, "{\"steps\": %d}]},\n", below - from);
    }
}

/* Writes the file of --step-histogram. It sorts the recorded steps. */
static int steps_write(FILE *out, const void *what) {
    float *times = (float *)malloc(((size_t)steps.count + 1) * sizeof *times);
    int i, n;
    (void)what;
    if (!times) return 0;
    fprintf(out, "{\n");
    for (i = 0; i < steps.count; i++) times[i] = steps.list[i].wall;
    steps__write_times(out, "wall", times, steps.count);
    for (i = n = 0; i < steps.count; i++) if (!steps.list[i].disturbed) times[n++] = steps.list[i].wall;
    steps__write_times(out, "wall_undisturbed", times, n);
    for (i = 0; i < steps.count; i++) times[i] = steps.list[i].own;
    steps__write_times(out, "processor_thread", times, steps.count);
    for (i = 0; i < steps.count; i++) times[i] = steps.list[i].all;
    steps__write_times(out, "processor_process", times, steps.count);
    free(times);
    fprintf(out, "  \"longest_ms\": {\"begin\": %.3f, \"lights\": %.3f, \"draw\": %.3f},\n  \"slowest\": [",
            1e3 * steps.longest_begin, 1e3 * steps.longest_lights, 1e3 * steps.longest_draw);
    if (steps.list) qsort(steps.list, (size_t)steps.count, sizeof *steps.list, steps__slower);
    for (i = 0; i < steps.count && i < STEPS_SLOWEST; i++) {
        const steps_step *s = &steps.list[i];
        fprintf(out, "%s\n    {\"wall_ms\": %.3f, \"thread_ms\": %.3f, \"process_ms\": %.3f, \"interruptions\": %d, "
                "\"programs\": %d, \"phase\": \"%s\", \"preview\": %s}", i ? "," : "", 1e3 * (double)s->wall,
                1e3 * (double)s->own, 1e3 * (double)s->all, s->disturbed, s->programs, steps_phases[s->phase],
                s->preview ? "true" : "false");
    }
    fprintf(out, "\n  ]\n}\n");
    return 1;
}

static void steps_free(void) { free(steps.list); }

#endif
