/* bench versions: compares pictures of direct light by this header and by the last one before target errors existed,
   which the Makefile takes from git history. Both are measured alternately. It prints the error over the seconds, and
   how many times faster this version reaches the errors of the old presets. The reference: windows spread over the same
   picture, with 4,096 rays at every pixel. */
#ifndef BENCH_VERSIONS_H
#define BENCH_VERSIONS_H
#ifdef BENCH_BEFORE
#include "version.h"

enum { WINDOW = 4, WINDOWS = 32, BLOCK_SIDE = 4, ASKED = 6, OLD_RUNS = 3, VERSION_ROOMS = 4 };

static const struct version_room {
    const char *name, *path;
    int small;               /* whether --quick includes it */
    int presets;             /* presets of the older version, from draft upwards */
    float asked[ASKED];      /* target errors of this version; old presets are measured between */
    version_view view;
} version_rooms[VERSION_ROOMS] = {
    { "cornell_box", "examples/scenes/cornell_box.obj", 1, 3, { 0.05f, 0.015f, 0.01f, 0.0075f, 0.005f, 0.0025f },
      { { 278, 273, -800 }, { 278, 273, 0 }, { 0, 1, 0 }, 39.3077, 1024, 1024, 0 } },
    { "staircase2", "../shared/scenes/staircase2/staircase2.glb", 0, 2, { 0.05f, 0.03f, 0.02f, 0.015f, 0.01f, 0.0075f },
      { { 6.91182, 1.65163, 2.55414 }, { 6.011643, 1.65163, 2.118617 }, { 0, 1, 0 }, 70, 1024, 1024, 0 } },
    { "veach-ajar", "../shared/scenes/veach-ajar/veach-ajar.glb", 0, 2, { 0.05f, 0.03f, 0.02f, 0.015f, 0.01f, 0.0075f },
      { { 4.05402, 1.61647, -2.30652 }, { 3.064005, 1.584172, -2.443733 }, { -0.0319925, 0.999478, -0.00443408 },
        35.9834, 1024, 1024, 0 } },
    { "living-room", "../shared/scenes/living-room/living-room.glb", 0, 2, { 0.4f, 0.25f, 0.16f, 0.12f, 0.08f, 0.06f },
      { { 5.10518, 0.731065, -2.31789 }, { 4.143388, 0.805472, -2.054414 }, { 0.071763, 0.997228, -0.019659 }, 58.7155,
        1280, 720, 1 } } };
static const char *const preset_names[OLD_RUNS] = { "draft", "default", "high" };

/* errors of pixels and of blocks, relative to the mean */
typedef struct measured { double seconds, pixels, blocks; long long sensors; } measured;

typedef struct reference_windows {
    float *light[2];                /* for two seeds: WINDOWS * WINDOWS windows one after the other */
    int corner[WINDOWS * WINDOWS][2];
    double mean, noise_pixels, noise_blocks;  /* the noises are variances of the mean of the two seeds */
} reference_windows;

static double luminance(const float c[3]) {
    return 0.2126 * (double)c[0] + 0.7152 * (double)c[1] + 0.0722 * (double)c[2];
}

/* Adds the squared differences over pixels and over blocks of one window. */
static void window_compare(const float *a, int a_width, const float *b, const float *c, double *pixels,
                           double *blocks) {
    int bx, by, x, y;
    for (by = 0; by < WINDOW; by += BLOCK_SIDE)
        for (bx = 0; bx < WINDOW; bx += BLOCK_SIDE) {
            double sum = 0;
            for (y = by; y < by + BLOCK_SIDE; y++)
                for (x = bx; x < bx + BLOCK_SIDE; x++) {
                    const int i = 3 * (y * WINDOW + x);
                    double d = luminance(a + 3 * ((size_t)y * (size_t)a_width + (size_t)x)) - luminance(b + i);
                    if (c) d += 0.5 * (luminance(b + i) - luminance(c + i));
                    *pixels += d * d;
                    sum += d;
                }
            *blocks += sum * sum / (BLOCK_SIDE * BLOCK_SIDE) / (BLOCK_SIDE * BLOCK_SIDE);
        }
}

static int reference_make(reference_windows *r, const version_view *view) {
    const size_t window = WINDOW * WINDOW * 3;
    double pixels = 0, blocks = 0;
    int i, k, seed;
    r->mean = 0;
    for (seed = 0; seed < 2; seed++)
        for (i = 0; i < WINDOWS * WINDOWS; i++) {
            version_settings s = { 1, 0, 2048, 77 + seed, { 0 } };
            version_cost cost;
            uint32_t random = (uint32_t)i * 2654435761u;
            const int size[2] = { view->width, view->height }, cell[2] = { i % WINDOWS, i / WINDOWS };
            for (k = 0; k < 2; k++) {  /* a random position in each cell of a grid over the picture */
                const int wide = size[k] / WINDOWS;
                s.window[k] = r->corner[i][k] = cell[k] * wide + (int)(room_random(&random) * (wide - WINDOW));
                s.window[k + 2] = WINDOW;
            }
            if (!version_now.render(view, &s, r->light[seed] + window * (size_t)i, &cost)) return 0;
        }
    for (i = 0; i < WINDOWS * WINDOWS; i++) {
        window_compare(r->light[0] + window * (size_t)i, WINDOW, r->light[1] + window * (size_t)i, NULL, &pixels,
                       &blocks);
        for (k = 0; k < WINDOW * WINDOW; k++)
            r->mean += 0.5 * (luminance(r->light[0] + window * (size_t)i + 3 * k) +
                              luminance(r->light[1] + window * (size_t)i + 3 * k));
    }
    r->mean /= WINDOWS * WINDOWS * WINDOW * WINDOW;
    r->noise_pixels = pixels / 4;
    r->noise_blocks = blocks / 4;
    return 1;
}

static int version_measure(const version *v, const version_view *view, const version_settings *settings,
                           const reference_windows *r, float *picture,
                           measured *m) {
    version_settings warm = *settings;
    version_cost cost;
    const double count = WINDOWS * WINDOWS * WINDOW * WINDOW;
    double pixels = 0, blocks = 0;
    int i;
    warm.window[2] = warm.window[3] = 32;
    if (!v->render(view, &warm, picture, &cost) || !v->render(view, settings, picture, &cost)) return 0;
    for (i = 0; i < WINDOWS * WINDOWS; i++) {
        const size_t at = 3 * ((size_t)r->corner[i][1] * (size_t)view->width + (size_t)r->corner[i][0]),
            window = (size_t)i * WINDOW * WINDOW * 3;
        window_compare(picture + at, view->width, r->light[0] + window, r->light[1] + window, &pixels, &blocks);
    }
    m->seconds = cost.seconds;
    m->sensors = cost.sensors;
    m->pixels = r->mean > 0 ? sqrt(fmax(pixels - r->noise_pixels, 0) / count) / r->mean : 0;
    m->blocks = r->mean > 0 ? sqrt(fmax(blocks - r->noise_blocks, 0) / (count / (BLOCK_SIDE * BLOCK_SIDE))) / r->mean
        : 0;
    return 1;
}

/* Returns how many times faster this version reaches the error of an older picture. */
static double sooner(const measured *before, const measured *now, int by_blocks) {
    double seconds[ASKED], errors[ASKED];
    int i;
    for (i = 0; i < ASKED; i++) {
        seconds[i] = now[i].seconds;
        errors[i] = by_blocks ? now[i].blocks : now[i].pixels;
    }
    return before->seconds / seconds_at(seconds, errors, ASKED, by_blocks ? before->blocks : before->pixels);
}

static int version_room_run(const struct version_room *scene, const version_view *view, int json, int first) {
    reference_windows r = { { NULL, NULL }, { { 0 } }, 0, 0, 0 };
    measured before[OLD_RUNS], now[ASKED];
    float *picture = (float *)malloc((size_t)view->width * (size_t)view->height * 3 * sizeof(float));
    int i, ok;
    for (i = 0; i < 2; i++) r.light[i] = (float *)malloc(WINDOWS * WINDOWS * WINDOW * WINDOW * 3 * sizeof(float));
    ok = picture && r.light[0] && r.light[1] && reference_make(&r, view);
    for (i = 0; ok && i < ASKED; i++) {  /* old pictures are measured among the new ones */
        version_settings s = { 1, scene->asked[i], 0, 0, { 0 } };
        ok = version_measure(&version_now, view, &s, &r, picture, &now[i]);
        s.preset = i / 2;
        s.error = 0;
        if (ok && i % 2 == 0 && i / 2 < scene->presets)
            ok = version_measure(&version_before, view, &s, &r, picture, &before[i / 2]);
    }
    if (ok && json) {
        printf("%s\n  {\"scene\": \"%s\", \"width\": %d, \"height\": %d, \"before\": [", first ? "" : ",", scene->name,
               view->width, view->height);
        for (i = 0; i < scene->presets; i++)
            printf("%s{\"preset\": \"%s\", \"seconds\": %.4g, \"error\": %.4g, \"error_4x4\": %.4g, \"sensors\": %lld, "
                   "\"sooner\": %.3g, \"sooner_4x4\": %.3g}",
                   i ? ", " : "", preset_names[i], before[i].seconds, before[i].pixels, before[i].blocks,
                       before[i].sensors,
                   sooner(&before[i], now, 0), sooner(&before[i], now, 1));
        printf("], \"now\": [");
        for (i = 0; i < ASKED; i++)
            printf("%s{\"asked\": %g, \"seconds\": %.4g, \"error\": %.4g, \"error_4x4\": %.4g, \"sensors\": %lld}",
                   i ? ", " : "", (double)scene->asked[i],
                   now[i].seconds, now[i].pixels, now[i].blocks, now[i].sensors);
        printf("]}");
    } else if (ok) {
        printf("%s, %d x %d   seconds  error %%    4 x 4    sensors   speedup at equal error of pixels, of "
               "4 x 4\n", scene->name, view->width,
               view->height);
        for (i = 0; i < scene->presets; i++)
            printf("  before, %-10s %8.2f %8.2f %8.2f %10lld   %5.2f %5.2f\n", preset_names[i], before[i].seconds,
                   100 * before[i].pixels, 100 * before[i].blocks,
                   before[i].sensors, sooner(&before[i], now, 0),
                   sooner(&before[i], now, 1));
        for (i = 0; i < ASKED; i++)
            printf("  target %5.2f %%      %8.2f %8.2f %8.2f %10lld\n", 100 * (double)scene->asked[i], now[i].seconds,
                   100 * now[i].pixels, 100 * now[i].blocks,
                   now[i].sensors);
        fflush(stdout);
    }
    free(picture);
    for (i = 0; i < 2; i++) free(r.light[i]);
    return ok || fail("versions: a picture failed");
}

static sbl_gl_function versions_function(const char *name, void *user) { (void)user; return host_gl_function(name); }

static int versions_part(int json, int quick) {
    int i, ok = 1, first = 1;
    printf(json ? ", \"versions\": [" : "");
    for (i = 0; ok && i < VERSION_ROOMS; i++) {
        const struct version_room *scene = &version_rooms[i];
        version_view view = scene->view;
        if (quick && !scene->small) continue;
        if (quick) view.width = view.height = 256;
        if (access(scene->path, R_OK) != 0) {
            if (!json) printf("%s: skipped, there is no %s\n", scene->name, scene->path);
            continue;
        }
        ok = version_now.load(scene->path) && version_before.load(scene->path) &&
            version_now.start(versions_function, view.sky) &&
             version_before.start(versions_function, view.sky) && version_room_run(scene, &view, json, first);
        version_before.stop();
        version_now.stop();
        first = 0;
    }
    if (json) printf("]");
    return ok;
}
#else
static int versions_part(int json, int quick) {
    (void)quick;
    if (!json) printf("versions: skipped, because git history did not contain the older header when the bench was "
                      "built\n");
    return 1;
}
#endif

#endif
