/* Compares sbl.h with the true light in furnished rooms that are made from seeds, and its predicted error with the true
   one. The true R comes from a light tracer where a pixel shows a single plane, otherwise from a path tracer. Rooms
   with even seeds are for tuning; rooms with odd seeds are held out for judging.
       build/bench_error                       rooms 0 to 11 at target errors of 0.8, 1.5 and 3 %
       build/bench_error --rooms 3-9,24 --error 0.015
       build/bench_error --rooms 1000-1003     storeys of twelve rooms, of which the picture shows one
       build/bench_error --error 0             1024 rays at every pixel and no filter, so that only the error of stored
                                               light remains; `predicted` is then that of stored light
       build/bench_error --cells 40000 --cells 80000
                                               each room once per value of max_bounce_cells (0: the default). The error
                                               of one number of cells depends on chance: compare versions by several
       build/bench_error --pictures FOLDER     also writes R and the predicted error of each room to FOLDER
       build/bench_error --gloss --error 0.015 rooms with mirrors, metal, gloss and panes (seeds as above): compares
                                               FINAL with the radiance that a path tracer finds at the pixels' centres
       build/bench_error --gloss-check         only compares that path tracer with closed forms
   True pictures are kept in build/truth; increase VERSION when rooms change. A true picture takes minutes of processor
   time, and that of a storey takes 40.
   All errors are relative to the mean of the true picture, and its noise is subtracted. A negative error is too small
   to be measured against that noise. */
#define _POSIX_C_SOURCE 200809L  /* for clock_gettime */
#include <ctype.h>
#include <errno.h>
#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <time.h>
#include "../../sbl.h"
#include "../../examples/host_gl.h"
#include "../support/reference.h"
#include "bench_furnished.h"
#include "bench_truth.h"
#include "bench_gloss_rooms.h"
#include "bench_gloss_truth.h"
#include "bench_gloss_check.h"

enum { VERSION = 2, GLOSS_VERSION = 2, WIDTH = 128, HEIGHT = 96, PIXELS = WIDTH * HEIGHT, SAMPLES = 1536,
       PATHS = 20000000, GLOSS_SAMPLES = 512, ROOMS_MOST = 256,
       NOISE_MOST = 4 };  /* largest allowed ratio of the noise of a true picture to the true error of R */

typedef struct picture { float rgb[3 * PIXELS]; } picture;

/* A room, and the true R or FINAL at its pixels. Values of `kind`: SMOOTH, EDGE, or 0 for a pixel that is
   ignored. */
enum { SMOOTH = 1, EDGE = 2 };
typedef struct room {
    gloss_room gloss;
    furnished *made;   /* gloss.made */
    int shines;        /* 1: a room with reflections, where FINAL takes the place of R */
    ref_point points[PIXELS];
    double light[PIXELS], noise[PIXELS];  /* luminance of the true R; that of one half of the samples, minus light */
    unsigned char kind[PIXELS];
    double mean;
} room;

static double luminance(const float *rgb) {
    return 0.2126 * (double)rgb[0] + 0.7152 * (double)rgb[1] + 0.0722 * (double)rgb[2];
}

static double cpu_seconds(void) {
    struct timespec t;
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

/* >>files */

static void write_pfm(const char *name, const float *values, int components) {
    FILE *file = fopen(name, "wb");
    int y;
    if (!file) { fprintf(stderr, "bench_error: cannot write %s: %s\n", name, strerror(errno)); exit(1); }
    fprintf(file, "P%c\n%d %d\n-1\n", components == 3 ? 'F' : 'f', WIDTH, HEIGHT);
    for (y = HEIGHT - 1; y >= 0; y--) fwrite(values + y * WIDTH * components, 4, (size_t)(WIDTH * components), file);
    fclose(file);
}

/* Reads a picture of three components that write_pfm has written. Returns 0 if the file does not exist. */
static int read_pfm(const char *name, picture *out) {
    FILE *file = fopen(name, "rb");
    int width = 0, height = 0, y, ok;
    if (!file) return 0;
    ok = fscanf(file, "PF\n%d %d\n-1", &width, &height) == 2 && fgetc(file) == '\n' && width == WIDTH &&
         height == HEIGHT;
    for (y = HEIGHT - 1; ok && y >= 0; y--) ok = fread(out->rgb + 3 * y * WIDTH, 12, WIDTH, file) == WIDTH;
    fclose(file);
    return ok;
}

/* >>rooms and their true pictures */

/* Computes two independent true pictures of a room. spread: 1: by the light tracer */
static void room_compute(const room *r, unsigned seed, int spread, float *halves[2]) {
    const int storey = seed >= FURNISHED_STOREY;
    furnished *fine;
    truth *t;
    if (r->shines) {
        gloss_truth_render(&r->gloss, GLOSS_SAMPLES, halves);
        return;
    }
    fine = (furnished *)calloc(1, sizeof *fine);
    if (!fine) abort();
    fine->piece = 0.2;  /* the path tracer needs small triangles to guide its rays */
    furnished_make(fine, seed, WIDTH, HEIGHT);
    t = truth_create(&fine->scene, fine->windows, fine->window_count);
    if (spread) truth_spread(t, &r->made->view, storey ? 8 * PATHS : PATHS, halves);
    else truth_render(t, r->points, PIXELS, storey ? 8 * SAMPLES : SAMPLES, halves);
    truth_destroy(t);
    furnished_free(fine);
    free(fine);
}

/* Reads a true picture from build/truth, or computes it. half: receives the picture from the first half of the
   samples */
static void room_truth(const room *r, unsigned seed, int spread, picture *full, picture *half) {
    char name[2][96];
    picture *other = (picture *)malloc(sizeof *other);
    float *halves[2];
    int i;
    if (!other) abort();
    for (i = 0; i < 2; i++)
        snprintf(name[i], sizeof name[i], "build/truth/%s%u_%dx%d_v%d%s%s.pfm", r->shines ? "gloss" : "", seed, WIDTH,
                 HEIGHT, (int)(r->shines ? GLOSS_VERSION : VERSION), spread ? ".spread" : "", i ? ".half" : "");
    if (!read_pfm(name[0], full) || !read_pfm(name[1], half)) {
        fprintf(stderr, "making the true picture of room %u\n", seed);
        halves[0] = half->rgb;
        halves[1] = other->rgb;
        room_compute(r, seed, spread, halves);
        for (i = 0; i < 3 * PIXELS; i++) full->rgb[i] = 0.5f * (half->rgb[i] + other->rgb[i]);
        mkdir("build", 0777);
        mkdir("build/truth", 0777);
        write_pfm(name[0], full->rgb, 3);
        write_pfm(name[1], half->rgb, 3);
    }
    free(other);
}

/* Returns 1 if two neighbours show different surfaces. */
static int room_corner_between(const room *r, int a, int b) {
    const ref_point *p = &r->points[a], *q = &r->points[b];
    return p->mesh != q->mesh || v3_dot(p->face, q->face) < 0.9 ||
           fabs(v3_dot(p->face, v3_sub(q->position, p->position))) > 1e-3;
}

/* Returns 1 if two neighbours show different surfaces, or if their light differs by more than noise explains. */
static int room_edge_between(const room *r, int a, int b, double noise) {
    const double jump = fabs(r->light[a] - r->light[b]), most = fmax(r->light[a], r->light[b]);
    return room_corner_between(r, a, b) || (jump > 0.2 * most && jump > 5 * noise * most);
}

/* Returns 1 if the eight pixels around a pixel show the same surface. */
static int room_is_flat(const room *r, int at) {
    int i;
    for (i = 0; i < 9; i++) {
        const int x = at % WIDTH + i % 3 - 1, y = at / WIDTH + i / 3 - 1;
        if (x < 0 || y < 0 || x >= WIDTH || y >= HEIGHT || !r->points[y * WIDTH + x].hit ||
            room_corner_between(r, at, y * WIDTH + x)) return 0;
    }
    return 1;
}

/* Gets the true picture of a room. */
static void room_light(const room *r, unsigned seed, picture *full, picture *half) {
    picture *spread[2];
    int i, k;
    room_truth(r, seed, 0, full, half);
    if (r->shines) return;
    for (i = 0; i < 2; i++) {
        spread[i] = (picture *)malloc(sizeof *spread[i]);
        if (!spread[i]) abort();
    }
    room_truth(r, seed, 1, spread[0], spread[1]);
    for (i = 0; i < PIXELS; i++)
        for (k = 3 * i; k < 3 * i + 3 && r->kind[i] && room_is_flat(r, i); k++) {
            full->rgb[k] = spread[0]->rgb[k];
            half->rgb[k] = spread[1]->rgb[k];
        }
    for (i = 0; i < 2; i++) free(spread[i]);
}

static void room_classify(room *r) {
    double noise2 = 0, light2 = 0;
    int i, x, y;
    for (i = 0; i < PIXELS; i++) { noise2 += r->noise[i] * r->noise[i]; light2 += r->light[i] * r->light[i]; }
    for (i = 0; i < PIXELS; i++) r->kind[i] = r->kind[i] ? SMOOTH : 0;
    for (y = 0; y < HEIGHT; y++)
        for (x = 0; x < WIDTH; x++)
            for (i = 0; i < 4; i++) {
                static const int steps[4][2] = { { 1, 0 }, { 0, 1 }, { 1, 1 }, { -1, 1 } };
                const int a = y * WIDTH + x, b = a + steps[i][1] * WIDTH + steps[i][0];
                if (x + steps[i][0] < 0 || x + steps[i][0] == WIDTH || y + steps[i][1] == HEIGHT) continue;
                if (r->kind[a] && r->kind[b] && !room_edge_between(r, a, b, sqrt(2 * noise2 / light2))) continue;
                if (r->kind[a]) r->kind[a] = EDGE;
                if (r->kind[b]) r->kind[b] = EDGE;
            }
}

static room *room_make(unsigned seed, int shines) {
    room *r = (room *)calloc(1, sizeof *r);
    picture *full = (picture *)malloc(sizeof *full), *half = (picture *)malloc(sizeof *half);
    ref_scene *scene;
    double count = 0;
    int i;
    if (!r || !full || !half) abort();
    r->made = &r->gloss.made;
    r->shines = shines;
    if (shines) gloss_room_make(&r->gloss, seed, WIDTH, HEIGHT);
    else furnished_make(r->made, seed, WIDTH, HEIGHT);
    scene = ref_create(&r->made->scene);
    for (i = 0; i < PIXELS; i++) {
        const ref_point *p = &r->points[i];
        r->points[i] = ref_pixel(scene, &r->made->view, i % WIDTH, i / WIDTH);
        r->kind[i] = p->hit && !(p->emission[0] > 0);
    }
    if (shines) gloss_leave_out(scene, &r->made->view, r->kind);
    ref_destroy(scene);
    room_light(r, seed, full, half);
    for (i = 0; i < PIXELS; i++) {
        r->light[i] = luminance(full->rgb + 3 * i);
        r->noise[i] = luminance(half->rgb + 3 * i) - r->light[i];
        if (r->kind[i]) { r->mean += r->light[i]; count++; }
    }
    r->mean /= count;
    room_classify(r);
    free(full);
    free(half);
    return r;
}

static void room_free(room *r) {
    gloss_room_free(&r->gloss);
    free(r);
}

/* >>measuring */

static double root(double x) { return x < 0 ? -sqrt(-x) : sqrt(x); }

/* Returns the relative error of means over blocks of pixels; negative if it is smaller than its own uncertainty. */
static double block_error(const room *r, const double *error, int side, int kinds) {
    double squares = 0, count = 0;
    int x, y, i;
    for (y = 0; y < HEIGHT; y += side)
        for (x = 0; x < WIDTH; x += side) {
            double sum = 0, noise = 0, n = 0;
            for (i = 0; i < side * side; i++) {
                const int at = (y + i / side) * WIDTH + x + i % side;
                if (!(r->kind[at] & kinds)) continue;
                sum += error[at]; noise += r->noise[at]; n++;
            }
            if (n > 0) squares += (sum * sum - noise * noise) / n;
            count += n;
        }
    return count > 0 ? root(squares / count) / r->mean : 0;
}

/* Returns the root mean square of the predicted errors of pixels of these kinds. */
static double predicted_error(const room *r, const float *predicted, int kinds) {
    double squares = 0, count = 0;
    int i;
    for (i = 0; i < PIXELS; i++)
        if (r->kind[i] & kinds) { squares += (double)predicted[i] * (double)predicted[i]; count++; }
    return count > 0 ? sqrt(squares / count) / r->mean : 0;
}

static int ascending(const void *a, const void *b) {
    const double x = *(const double *)a, y = *(const double *)b;
    return x < y ? -1 : x > y;
}

/* Returns the 99.9th percentile of |error| / R. */
static double worst_error(const room *r, const double *error) {
    static double all[PIXELS];
    int i, count = 0;
    for (i = 0; i < PIXELS; i++)
        if (r->kind[i]) all[count++] = fabs(error[i]) / fmax(r->light[i], 0.01 * r->mean);
    qsort(all, (size_t)count, sizeof *all, ascending);
    return count ? all[(int)(0.999 * count)] : 0;
}

/* Returns the mean square of values of the pixels that count, without the 0.1 % that are largest. */
static double trimmed_square(const room *r, const double *values) {
    static double all[PIXELS];
    double sum = 0;
    int i, count = 0, kept;
    for (i = 0; i < PIXELS; i++) if (r->kind[i]) all[count++] = values[i] * values[i];
    qsort(all, (size_t)count, sizeof *all, ascending);
    kept = count - (count + 999) / 1000;
    for (i = 0; i < kept; i++) sum += all[i];
    return kept > 0 ? sum / kept : 0;
}

/* Solves a symmetric system of three equations by Cramer's rule. Returns 0 if it is singular. m: xx xy xz yy yz zz */
static int solve3(const double m[6], const double b[3], double out[3]) {
    const double c0 = m[3] * m[5] - m[4] * m[4], c1 = m[2] * m[4] - m[1] * m[5], c2 = m[1] * m[4] - m[2] * m[3];
    const double det = m[0] * c0 + m[1] * c1 + m[2] * c2;
    if (!(fabs(det) > 1e-6 * m[0] * m[0] * m[0])) return 0;
    out[0] = (c0 * b[0] + c1 * b[1] + c2 * b[2]) / det;
    out[1] = (c1 * b[0] + (m[0] * m[5] - m[2] * m[2]) * b[1] + (m[1] * m[2] - m[0] * m[4]) * b[2]) / det;
    out[2] = (c2 * b[0] + (m[1] * m[2] - m[0] * m[4]) * b[1] + (m[0] * m[3] - m[1] * m[1]) * b[2]) / det;
    return 1;
}

/* Returns how far a pixel stands out: its distance from the plane fitted to the light of smooth pixels of the same
   surface in the 15 x 15 pixels around it, divided by their standard deviation from that plane, or by 0.2 % of the
   light if that is more. Returns 0 if it has too few neighbours. */
static double speck(const room *r, const double *light, int at) {
    double m[6] = { 0 }, b[3] = { 0 }, plane[3], squares = 0, variance;
    int i, n = 0;
    for (i = 0; i < 225; i++) {
        const int dx = i % 15 - 7, dy = i / 15 - 7, x = at % WIDTH + dx, y = at / WIDTH + dy, k = y * WIDTH + x;
        if (i == 112 || x < 0 || y < 0 || x >= WIDTH || y >= HEIGHT || r->kind[k] != SMOOTH) continue;
        if (r->points[k].mesh != r->points[at].mesh || v3_dot(r->points[k].face, r->points[at].face) < 0.98) continue;
        m[0]++; m[1] += dx; m[2] += dy; m[3] += dx * dx; m[4] += dx * dy; m[5] += dy * dy;
        b[0] += light[k]; b[1] += dx * light[k]; b[2] += dy * light[k];
        squares += light[k] * light[k];
        n++;
    }
    if (n < 60 || !solve3(m, b, plane)) return 0;
    variance = fmax(squares - plane[0] * b[0] - plane[1] * b[1] - plane[2] * b[2], 0) / (n - 3);
    return fabs(light[at] - plane[0]) / fmax(sqrt(variance), 0.002 * fabs(plane[0]) + 1e-30);
}

static double worst_speck(const room *r, const double *light) {
    double most = 0;
    int i;
    for (i = 0; i < PIXELS; i++) if (r->kind[i] == SMOOTH) most = fmax(most, speck(r, light, i));
    return most;
}

/* >>rows of the result */

typedef struct row { double target, predicted, pixel, noise; unsigned seed; int cells; } row;

/* Renders a room, with at most `cells` cells in the store. Returns the seconds, or a negative number if that fails. */
static double render(sbl_context *context, const room *r, const sbl_picture_desc *view, int cells, int matte) {
    static sbl_material materials[FURNISHED_MESHES];
    const double start = cpu_seconds();
    sbl_scene_desc scene = r->made->scene;
    int i;
    scene.max_bounce_cells = cells;
    for (i = 0; i < scene.material_count && matte; i++) {
        materials[i] = scene.materials[i];
        materials[i].ior = materials[i].metallic = materials[i].transmission = 0;
        materials[i].flags = 0;
    }
    if (matte) scene.materials = materials;
    if (sbl_set_scene(context, &scene) != SBL_SUCCESS || sbl_render_picture(context, view) != SBL_SUCCESS) return -1;
    return cpu_seconds() - start;
}

/* Sums over the pixels that count. */
typedef struct sums { double bias, count, noise, all, edges; } sums;

static sums sum_errors(const room *r, const double *error) {
    sums s = { 0, 0, 0, 0, 0 };
    int i;
    for (i = 0; i < PIXELS; i++) {
        const double square = error[i] * error[i] - r->noise[i] * r->noise[i];
        if (!r->kind[i]) continue;
        s.bias += error[i]; s.count++;
        s.noise += r->noise[i] * r->noise[i];
        s.all += square;
        if (r->kind[i] == EDGE) s.edges += square;
    }
    return s;
}

static void write_pictures(const char *folder, const char *kind, const row *of, const float *R,
                           const float *predicted) {
    char name[512], cells[16] = "";
    if (of->cells) snprintf(cells, sizeof cells, "_%d", of->cells);
    snprintf(name, sizeof name, "%s/%s%u_%g%s.R.pfm", folder, kind, of->seed, 100 * of->target, cells);
    write_pfm(name, R, 3);
    snprintf(name, sizeof name, "%s/%s%u_%g%s.predicted.pfm", folder, kind, of->seed, 100 * of->target, cells);
    write_pfm(name, predicted, 1);
}

/* Renders a room and prints a row. out->target is the target error; if it is 0, only the error of stored light is
   measured. out->cells is max_bounce_cells; 0 is its default. */
static int measure(sbl_context *context, const room *r, const char *folder, row *out) {
    static float R[3 * PIXELS], predicted[PIXELS];
    static double light[PIXELS], error[PIXELS];
    sbl_picture_desc view = r->made->view;
    double seconds, matte = r->shines ? render(context, r, &view, out->cells, 1) : 0;
    sums s;
    int i;
    view.facet_limit = r->shines ? 0.0f : -1.0f;
    view.samples = r->shines;
    view.target_error = (float)out->target;
    if (!(out->target > 0)) { view.tile = 1; view.options.rays = 1024; view.filter_radius = -1; }
    seconds = render(context, r, &view, out->cells, 0);
    if (seconds < 0 || matte < 0 || sbl_read_channel(context, r->shines ? SBL_CHANNEL_FINAL : SBL_CHANNEL_RADIANCE, R,
                                                     3 * PIXELS) != SBL_SUCCESS ||
        sbl_read_channel(context, SBL_CHANNEL_ERROR, predicted, PIXELS) != SBL_SUCCESS) return 0;
    for (i = 0; i < PIXELS; i++) {
        light[i] = luminance(R + 3 * i);
        error[i] = light[i] - r->light[i];
    }
    s = sum_errors(r, error);
    out->pixel = block_error(r, error, 1, SMOOTH | EDGE);
    out->noise = root(s.noise / s.count) / r->mean;
    out->predicted = out->target > 0 ? predicted_error(r, predicted, SMOOTH | EDGE)
                                     : (double)sbl_query_stats(context).picture.stored_error;
    printf("%4u %4.1f | %5.2f %5.2f %5.2f %5.2f | %5.2f %5.2f %+5.2f | %5.2f %5.2f %3.0f | %5.2f %5.2f | %5.0f %4.1f | "
           "%5.1f | %4.1f",
           out->seed, 100 * out->target, 100 * out->predicted, 100 * out->pixel, out->predicted / out->pixel,
           100 * root(trimmed_square(r, error) - trimmed_square(r, r->noise)) / r->mean,
           100 * block_error(r, error, 4, SMOOTH | EDGE), 100 * block_error(r, error, 8, SMOOTH | EDGE),
           100 * s.bias / s.count / r->mean, 100 * predicted_error(r, predicted, EDGE),
           100 * block_error(r, error, 1, EDGE), 100 * s.edges / s.all, 100 * predicted_error(r, predicted, SMOOTH),
           100 * block_error(r, error, 1, SMOOTH), 100 * worst_error(r, error), worst_speck(r, light), seconds,
           100 * out->noise);
    if (r->shines) printf(" matte %.1f s,", matte);
    if (out->cells) printf(" %d cells,", out->cells);
    for (i = 0; i < 3; i++) if (r->made->labels[i]) printf("%s %s", i ? "," : "", r->made->labels[i]);
    printf("\n");
    fflush(stdout);
    if (folder) write_pictures(folder, r->shines ? "gloss" : "", out, R, predicted);
    return 1;
}

/* Prints how predictions agree with the truth over all rooms with even (0) or odd (1) seeds. Rooms whose true picture
   is too noisy are omitted. */
static void summarise(const row *rows, int count, int odd) {
    double sum = 0, squares = 0, least = HUGE_VAL, most = 0;
    int i, n = 0, within = 0;
    for (i = 0; i < count; i++) {
        const double ratio = rows[i].predicted / fmax(rows[i].pixel, 1e-6);
        if ((int)(rows[i].seed & 1) != odd || rows[i].noise > NOISE_MOST * rows[i].pixel) continue;
        sum += log(ratio); squares += log(ratio) * log(ratio); n++;
        least = fmin(least, ratio); most = fmax(most, ratio);
        within += ratio > 1 / 1.3 && ratio < 1.3;
    }
    if (!n) return;
    printf("%s: predicted / true %.2f (geometric mean), a factor of %.2f about it; %.2f to %.2f; %d of %d within 1.3\n",
           odd ? "held out" : "tuning", exp(sum / n), exp(sqrt(fmax(squares / n - sum * sum / n / n, 0))), least, most,
           within, n);
}

/* >>checks of both tracers against closed forms */

static int check(const char *name, const truth *t, v3 p, v3 n, double expected) {
    ref_point point;
    float first[3], second[3], *halves[2];
    double found;
    memset(&point, 0, sizeof point);
    point.hit = 1;
    point.position = p;
    point.face = n;
    halves[0] = first;
    halves[1] = second;
    truth_render(t, &point, 1, 40000, halves);
    found = 0.5 * ((double)first[1] + (double)second[1]);
    if (fabs(found / expected - 1) < 0.01) return 1;
    fprintf(stderr, "bench_error: the path tracer is wrong: %s: %g instead of %g\n", name, found, expected);
    return 0;
}

/* Checks the light tracer with a picture that shows the floor from above: compares the mean R of the picture and of its
   quarters. corners: the corners of the only lamp, in a black room; NULL: R is `expected` everywhere */
static int check_spread(const char *name, const truth *t, const v3 *corners, double expected) {
    enum { SIDE = 16, PATHS_CHECKED = 500000 };
    static float first[3 * SIDE * SIDE], second[3 * SIDE * SIDE];
    float *halves[2] = { first, second };
    sbl_picture_desc view;
    double found[5] = { 0, 0, 0, 0, 0 }, wanted[5] = { 0, 0, 0, 0, 0 };  /* the last number is that of the whole */
    int i, ok = 1;
    memset(&view, 0, sizeof view);
    view.width = view.height = SIDE;
    sbl_look_at(view.world_to_view, 1.2f, 1, 0.9f, 1.2f, 0, 0.9f, 0, 0, 1);
    sbl_perspective(view.view_to_clip, 60, 1);
    truth_spread(t, &view, PATHS_CHECKED, halves);
    for (i = 0; i < SIDE * SIDE; i++) {
        const ref_point p = ref_pixel(t->scene, &view, i % SIDE, i / SIDE);
        const int quarter = i % SIDE / (SIDE / 2) + i / SIDE / (SIDE / 2) * 2;
        const double R = 0.5 * ((double)first[3 * i + 1] + (double)second[3 * i + 1]);
        const double true_R = corners ? 2 * ref_polygon(p.position, p.face, corners, 4) : expected;
        found[quarter] += R;
        found[4] += R;
        wanted[quarter] += true_R;
        wanted[4] += true_R;
    }
    for (i = 0; i < 5; i++) ok &= fabs(found[i] / wanted[i] - 1) < (i < 4 ? 0.06 : 0.015);
    if (!ok)
        fprintf(stderr, "bench_error: the light tracer is wrong: %s: %g instead of %g; quarters %g %g %g %g instead of "
                "%g %g %g %g\n", name, found[4], wanted[4], found[0], found[1], found[2], found[3], wanted[0],
                wanted[1], wanted[2], wanted[3]);
    return ok;
}

/* Checks a room of 2 x 2 x 2 m with an opening in the wall x = 0, with a lamp 30 cm in front of it, or without
   either. */
static int check_room(int opening, int lamp, double albedo, double glow, double expected) {
    furnished *f = (furnished *)calloc(1, sizeof *f);
    const furnished_hole hole = { 0.5, 1.3, 0.6, 1.5 };
    const double rgb[3] = { albedo, albedo, albedo }, low[2] = { 0.6, 0.7 }, high[2] = { 1.5, 1.5 };
    const double corner[2] = { 0, 0 }, opposite[2] = { 2, 2 };
    const v3 p = v3_of(1.2, 0, 0.9), n = v3_of(0, 1, 0);
    const char *const name = lamp ? "lamp" : opening ? "window" : "furnace";
    v3 corners[4];
    truth *t;
    int k, ok;
    if (!f) abort();
    f->size[0] = f->size[1] = f->size[2] = 2;
    furnished_begin(f, rgb, 0, 2, REF_PI / 2);
    furnished_wall(f, 2, &hole, opening, 0, 0);
    furnished_begin(f, rgb, 0, 0, 0);
    for (k = 1; k < 6; k++) furnished_rectangle(f, k / 2, k & 1 ? 2 : 0, corner, opposite);
    if (glow > 0) furnished_box(f, 0.4, 0, 0.4, 0.8, 1.2, 1.5);
    for (k = 0; k < f->scene.mesh_count && glow > 0; k++)
        f->materials[k].emission[0] = f->materials[k].emission[1] = f->materials[k].emission[2] = (float)glow;
    if (opening) {
        furnished_window *w = &f->windows[f->window_count++];
        w->corner = v3_of(0, 0.6, 1.5); w->across = v3_of(0, 0, -0.8); w->up = v3_of(0, 0.9, 0);
        corners[0] = w->corner; corners[1] = v3_add(w->corner, w->across);
        corners[2] = v3_add(corners[1], w->up); corners[3] = v3_add(w->corner, w->up);
        for (k = 0; k < 3; k++) f->scene.sky[k] = 2;
    }
    if (lamp) {
        furnished_begin(f, rgb, 0, 0, 0);
        furnished_rectangle(f, 0, 0.3, low, high);
        furnished_glow(f, 2 / 0.85 * 0.72, 0.72);
        for (k = 0; k < 4; k++) corners[k] = v3_of(0.3, k > 1 ? 1.5 : 0.6, k == 1 || k == 2 ? 1.5 : 0.7);
    }
    if (lamp || opening) expected = 2 * ref_polygon(p, n, corners, 4);
    furnished_finish(f);
    t = truth_create(&f->scene, f->windows, f->window_count);
    ok = check(name, t, p, n, expected) & check_spread(name, t, lamp || opening ? corners : NULL, expected);
    truth_destroy(t);
    furnished_free(f);
    free(f);
    return ok;
}

static int check_truth(void) {
    return check_room(0, 0, 0.7, 0.3, 1) & check_room(0, 1, 0, 0, 0) & check_room(1, 0, 0, 0, 0);
}

/* >>main */

/* Reads a list such as 0-5,12. Returns the number of seeds, or 0 if the list is not valid. */
static int read_seeds(const char *text, unsigned seeds[ROOMS_MOST]) {
    int count = 0;
    while (isdigit((unsigned char)*text)) {
        char *end;
        unsigned long from = strtoul(text, &end, 10), to = from;
        if (*end == '-') to = strtoul(end + 1, &end, 10);
        for (; from <= to && count < ROOMS_MOST; from++) seeds[count++] = (unsigned)from;
        text = *end == ',' ? end + 1 : end;
    }
    return *text ? 0 : count;
}

static int usage(void) {
    fprintf(stderr, "usage: bench_error [--rooms 0-11] [--error 0.008]... [--cells 80000]... [--pictures FOLDER] "
                    "[--gloss | --gloss-check]\n");
    return 2;
}

/* Renders a room once, which compiles shaders. Returns 0 if that fails. */
static int warm_up(sbl_context *context, const room *r) {
    sbl_picture_desc view = r->made->view;
    view.target_error = 0.5f;
    return render(context, r, &view, 0, 0) >= 0;
}

int main(int argc, char **argv) {
    static unsigned seeds[ROOMS_MOST];
    static row rows[256 * ROOMS_MOST];
    sbl_context_desc desc = { 0 };
    sbl_context *context = NULL;
    const char *folder = NULL;
    double targets[16];
    int i, k, count = read_seeds("0-11", seeds), target_count = 0, row_count = 0, ok = 1, shines = 0, cell_count = 0;
    int cells[16] = { 0 };
    for (i = 1; i < argc; i++) {
        if (strcmp(argv[i], "--gloss-check") == 0) return !gloss_check();
        if (strcmp(argv[i], "--gloss") == 0) { shines = 1; continue; }
        if (i + 1 == argc) return usage();
        if (strcmp(argv[i], "--rooms") == 0) { if (!(count = read_seeds(argv[++i], seeds))) return usage(); }
        else if (strcmp(argv[i], "--error") == 0 && target_count < 16) targets[target_count++] = atof(argv[++i]);
        else if (strcmp(argv[i], "--cells") == 0 && cell_count < 16) cells[cell_count++] = atoi(argv[++i]);
        else if (strcmp(argv[i], "--pictures") == 0) folder = argv[++i];
        else return usage();
    }
    if (!target_count) { targets[0] = 0.008; targets[1] = 0.015; targets[2] = 0.03; target_count = 3; }
    if (!check_truth() || (shines && !gloss_check()) || !host_gl_open("bench_error")) return 1;
    if (sbl_create(&desc, &context) != SBL_SUCCESS) return 1;
    printf("room, target | predicted, true, predicted/true, true without the worst 0.1 %% | 4x4, 8x8, bias |\n"
           "    edge pixels: predicted, true, share of squared error | smooth pixels: predicted, true |\n"
           "    99.9th percentile of |error|/R, speck | seconds of CPU | noise of the true picture, kinds of light; "
           "errors in %%\n");
    for (i = 0; i < count; i++) {
        room *r = room_make(seeds[i], shines);
        if (i == 0) ok = warm_up(context, r);
        for (k = 0; k < target_count * (cell_count ? cell_count : 1) && ok; k++) {
            rows[row_count].seed = seeds[i];
            rows[row_count].target = targets[k % target_count];
            rows[row_count].cells = cells[k / target_count];
            ok = measure(context, r, folder, &rows[row_count++]);
        }
        room_free(r);
        if (!ok) return fprintf(stderr, "bench_error: room %u failed\n", seeds[i]), 1;
    }
    summarise(rows, row_count, 0);
    summarise(rows, row_count, 1);
    sbl_destroy(context);
    host_gl_close();
    return 0;
}
