/* Demonstrates four measurements of the paper with the Cornell box in SBL_MODE_PAPER:

       table_1    time per sensor at several resolutions, with one sensor size
       figure_10  time per sensor for several sensor sizes, at three resolutions
       figure_11  number of sensors for several sensor sizes, at the same three resolutions
       figure_12  noise: a picture with small sensors beside a picture with large sensors

   Each result is written as .csv to the folder in the first argument, and figure 12 also as .png. scripts/plot_metrics
   draws the other figures. Measurements that would exceed five minutes in total are skipped with a message. --quick
   measures only small pictures, and skips none. */
#define SBL_IMPLEMENTATION
#include "headless.h"
#include "cornell_box.h"
#define STB_IMAGE_WRITE_IMPLEMENTATION
#include <stb/stb_image_write.h>
#include <time.h>

enum { RESOLUTIONS = 3, MOST = 16 };

typedef struct plan {
    double seconds;                           /* time limit for all measurements together; 0: no limit */
    int table_size, table_count, table[MOST][2];  /* table 1: sensor size, number of resolutions, and the resolutions */
    int sizes_count, sizes[MOST];             /* figures 10 and 11 */
    int resolutions[RESOLUTIONS][2];
    int noise_size, noise_resolution, large_size;
} plan;

static const plan full_plan = {
    280, 64, 12, { { 200, 200 }, { 300, 200 }, { 400, 300 }, { 500, 300 }, { 500, 400 }, { 600, 400 }, { 600, 500 },
        { 700, 500 }, { 700, 600 },
                   { 800, 600 }, { 900, 700 }, { 1024, 768 } },
    6, { 8, 16, 32, 64, 128, 256 }, { { 120, 90 }, { 160, 120 }, { 200, 200 } }, 32, 200, 256 };
static const plan quick_plan = {
    0, 16, 4, { { 24, 18 }, { 32, 24 }, { 48, 36 }, { 64, 48 } },
    4, { 8, 16, 32, 64 }, { { 20, 15 }, { 24, 18 }, { 32, 24 } }, 32, 48, 256 };

typedef struct metrics {
    sbl_context *context;
    const char *folder;
    const plan *plan;
    time_t start;
} metrics;

static int out_of_time(float done, void *user) {
    const metrics *m = (const metrics *)user;
    (void)done;
    return m->plan->seconds > 0 && difftime(time(NULL), m->start) > m->plan->seconds;
}

enum { FAILED, GIVEN_UP, MEASURED };

/* Renders a picture with the method of the paper. If that takes less than a second and time matters, renders it up to
   three times and reports the fastest. */
static int measure(metrics *m, int width, int height, int sensor_size, sbl_stats *stats) {
    sbl_picture_desc view = { 0 };
    const int runs = m->plan->seconds > 0 ? 3 : 1;
    int run;
    cornell_box_view(&view, width, height);
    view.options.mode = SBL_MODE_PAPER;
    view.options.sensor_size = sensor_size;
    view.samples = 1;
    view.options.progress = out_of_time;
    view.options.progress_user = m;
    memset(stats, 0, sizeof *stats);
    for (run = 0; run < runs && (run == 0 || stats->seconds.total < 1); run++) {
        sbl_result result = sbl_render_picture(m->context, &view);
        sbl_stats latest = sbl_query_stats(m->context);
        if (result == SBL_CANCELLED && run == 0) {
            printf("  %dx%d, sensors of %d: skipped, out of time\n", width, height, sensor_size);
            return GIVEN_UP;
        }
        if (result == SBL_CANCELLED) break;
        if (result != SBL_SUCCESS) return FAILED;  /* sbl.h prints error messages to stderr */
        if (run == 0 || latest.seconds.total < stats->seconds.total) *stats = latest;
    }
    printf("  %dx%d, sensors of %d: %lld sensors, %.1f us each\n", width, height, sensor_size,
           (long long)stats->sensors.sites, stats->sensors.microseconds);
    fflush(stdout);
    return MEASURED;
}

/* ---- output files ---- */

static void path_make(const metrics *m, char path[1024], const char *name) {
    snprintf(path, 1024, "%s/%s", m->folder, name);
}

static FILE *csv_open(const metrics *m, const char *name, const char *columns) {
    char path[1024];
    FILE *file;
    path_make(m, path, name);
    file = fopen(path, "wb");
    if (file) fprintf(file, "%s\n", columns);
    else fprintf(stderr, "paper_metrics: cannot write %s\n", path);
    return file;
}

static int csv_close(FILE *file, const char *name) {
    int bad = ferror(file);
    if (fclose(file) || bad) return fprintf(stderr, "paper_metrics: %s is not complete; is the disk full?\n", name), 0;
    return 1;
}

static int png_write(const metrics *m, const char *name, int width, int height, const unsigned char *pixels) {
    char path[1024];
    path_make(m, path, name);
    if (pixels && stbi_write_png(path, width, height, 3, pixels, 0)) return 1;
    return fprintf(stderr, "paper_metrics: cannot write %s\n", path), 0;
}

/* ---- the measurements ---- */

static int table_1(metrics *m) {
    FILE *csv = csv_open(m, "table_1.csv", "width,height,sensor_size,sensors,microseconds_per_sensor");
    int i, size = m->plan->table_size, outcome = MEASURED;
    sbl_stats stats;
    if (!csv) return 0;
    printf("table 1\n");
    for (i = 0; i < m->plan->table_count && outcome == MEASURED; i++) {
        int width = m->plan->table[i][0], height = m->plan->table[i][1];
        outcome = measure(m, width, height, size, &stats);
        if (outcome != MEASURED) break;
        fprintf(csv, "%d,%d,%d,%lld,%.3f\n", width, height, size, (long long)stats.sensors.sites,
                stats.sensors.microseconds);
    }
    return csv_close(csv, "table_1.csv") && outcome != FAILED;
}

static int figures_10_and_11(metrics *m) {
    FILE *times_csv = csv_open(m, "figure_10.csv", "width,height,sensor_size,microseconds_per_sensor");
    FILE *counts_csv = csv_open(m, "figure_11.csv", "width,height,sensor_size,sensors");
    int i, k, ok, outcome = MEASURED;
    sbl_stats stats;
    printf("figures 10 and 11\n");
    for (i = 0; i < m->plan->sizes_count && times_csv && counts_csv; i++)
        for (k = 0; k < RESOLUTIONS && outcome == MEASURED; k++) {
            int width = m->plan->resolutions[k][0], height = m->plan->resolutions[k][1], size = m->plan->sizes[i];
            outcome = measure(m, width, height, size, &stats);
            if (outcome != MEASURED) break;
            fprintf(times_csv, "%d,%d,%d,%.3f\n", width, height, size, stats.sensors.microseconds);
            fprintf(counts_csv, "%d,%d,%d,%lld\n", width, height, size, (long long)stats.sensors.sites);
        }
    ok = times_csv && csv_close(times_csv, "figure_10.csv");
    ok = counts_csv && csv_close(counts_csv, "figure_11.csv") && ok;
    return ok && outcome != FAILED;
}

/* Returns the mean difference of R between neighbouring pixels of one surface, divided by the mean of R. Shadow edges
   add to it, but equally for all sensor sizes. */
static double roughness(const float *radiance, const float *id, int size) {
    double jumps = 0, sum = 0;
    int pairs = 0, x, y;
    for (y = 0; y < size; y++)
        for (x = 0; x + 1 < size; x++) {
            int at = y * size + x;
            if (id[at] < 0.5f || fabs((double)(id[at] - id[at + 1])) > 0.5) continue;
            jumps += fabs((double)(radiance[3 * at + 1] - radiance[3 * at + 4]));
            sum += (double)radiance[3 * at + 1];
            pairs++;
        }
    return pairs && sum > 0 ? jumps / sum : 0;
}

static int figure_12(metrics *m) {
    int side = m->plan->noise_resolution, gap = 4, width = 2 * side + gap, i, y, ok = 1, outcome = MEASURED;
    size_t pixels = (size_t)side * (size_t)side;
    unsigned char *sheet = (unsigned char *)calloc((size_t)width * (size_t)side, 3);
    float *values = (float *)malloc(pixels * 7 * sizeof(float)), *picture = values, *radiance = values + 3 * pixels,
        *id = values + 6 * pixels;
    FILE *csv = csv_open(m, "figure_12.csv", "sensor_size,sensors,roughness");
    sbl_stats stats;
    if (!sheet || !values) fprintf(stderr, "paper_metrics: out of memory\n");
    printf("figure 12\n");
    for (i = 0; i < 2 && sheet && values && csv && outcome == MEASURED; i++) {
        int size = i ? m->plan->large_size : m->plan->noise_size;
        outcome = measure(m, side, side, size, &stats);
        if (outcome != MEASURED) break;
        ok = ok && sbl_read_channel(m->context, SBL_CHANNEL_FINAL, picture, 3 * pixels) == SBL_SUCCESS &&
             sbl_read_channel(m->context, SBL_CHANNEL_RADIANCE, radiance, 3 * pixels) == SBL_SUCCESS &&
             sbl_read_channel(m->context, SBL_CHANNEL_ID, id, pixels) == SBL_SUCCESS;
        if (!ok) break;
        fprintf(csv, "%d,%lld,%.5f\n", size, (long long)stats.sensors.sites, roughness(radiance, id, side));
        for (y = 0; y < side; y++)
            sbl_encode_srgb8(sheet + 3 * (y * width + i * (side + gap)), picture + 3 * y * side, (size_t)(3 * side), 1);
    }
    ok = csv && csv_close(csv, "figure_12.csv") && ok && sheet && values && outcome != FAILED &&
        png_write(m, "figure_12.png", width, side, sheet);
    free(sheet);
    free(values);
    return ok;
}

int main(int argc, char **argv) {
    metrics m = { NULL, ".", &full_plan, 0 };
    cornell_box box;
    sbl_stats stats;
    int i, ok;
    for (i = 1; i < argc; i++) {
        if (strcmp(argv[i], "--quick") == 0) m.plan = &quick_plan;
        else m.folder = argv[i];
    }
    if (sbl_create(headless("paper_metrics"), &m.context) != SBL_SUCCESS) return 1;
    m.start = time(NULL);
    printf("on %s\nwarming up\n", sbl_query_capabilities(m.context).renderer);
    ok = sbl_set_scene(m.context, cornell_box_make(&box)) == SBL_SUCCESS && measure(&m, 64, 64, 16, &stats) ==
        MEASURED &&
         table_1(&m) && figure_12(&m) && figures_10_and_11(&m);
    sbl_destroy(m.context);
    return !ok;
}
