/* Compares predicted errors with true errors, in scenes whose R is known at every pixel, in closed form or from an
   independent ray caster, for target errors from 1 to 8 %. */
#include "../sbl.h"
#include "support/test.h"
#include "support/scenes.h"
#include "support/inside.h"
#include "support/reference.h"

static sbl_context *context;

enum { WIDTH = 128, HEIGHT = 96, POLYGONS = 40, LEVELS = 4 };

/* The light of a scene: polygons of one grey radiance, which a rectangle or other polygons may occlude, or the light of
   the ray caster. */
typedef struct known {
    test_scene scene;
    sbl_picture_desc view;
    v3 corners[POLYGONS][4];
    double radiance[POLYGONS];    /* negative: the polygon hides a part of a sky of radiance 1 */
    int count;
    double sky;
    double blocker[4], height, lamp_height;  /* occluding rectangle above the floor: x0, z0, x1, z1 */
    double view_below;            /* surfaces above this height are ignored; 0: none are */
    int lamp;                     /* index of the mesh of a lamp whose light the ray caster computes; 0: closed forms */
    int levels;                   /* number of target errors to test */
    double within;                /* least share of pixels that are within twice their predicted error */
    /* largest error of dark pixels, relative to their own light, with the smallest target error; 0: any */
    double dark;
} known;

static void known_polygon(known *k, double radiance, const float *corners) {
    int i;
    for (i = 0; i < 4; i++) k->corners[k->count][i] = v3_from(corners + 3 * i);
    k->radiance[k->count++] = radiance;
}

/* Adds a rectangular lamp that faces down. */
static void known_lamp(known *k, double radiance, float x0, float z0, float x1, float z1, float y) {
    const float corners[12] = { x0, y, z0, x1, y, z0, x1, y, z1, x0, y, z1 };
    scene_polygon(&k->scene, scene_lamp(&k->scene, (float)radiance, (float)radiance, (float)radiance), corners, 4);
    known_polygon(k, radiance, corners);
}

/* Adds a rectangle of ceiling that is black from below and hides part of the sky. */
static void known_lid(known *k, float x0, float z0, float x1, float z1, float y) {
    const float corners[12] = { x0, y, z0, x1, y, z0, x1, y, z1, x0, y, z1 };
    scene_polygon(&k->scene, scene_material(&k->scene, 0.5f, 0.5f, 0.5f), corners, 4);
    known_polygon(k, -1, corners);
}

static void known_floor(known *k, float half) {
    scene_floor(&k->scene, scene_material(&k->scene, 0.5f, 0.5f, 0.5f), 0, half);
}

/* A rectangle between a square lamp and the floor, with penumbrae of all widths in closed form. */
static void penumbra(known *k) {
    const float blocker[12] = { -0.7f, 1, -0.2f, 0.4f, 1, -0.2f, 0.4f, 1, 0.5f, -0.7f, 1, 0.5f };
    known_floor(k, 4);
    known_lamp(k, 3, -0.4f, -0.4f, 0.4f, 0.4f, 2);
    scene_polygon(&k->scene, scene_material(&k->scene, 0.5f, 0.5f, 0.5f), blocker, 4);
    k->blocker[0] = -0.7f; k->blocker[1] = -0.2f; k->blocker[2] = 0.4f; k->blocker[3] = 0.5f;
    k->height = 1;
    k->lamp_height = 2;
    k->view = scene_view(WIDTH, HEIGHT, 60, 0, 0.9f, 2.4f, 0, 0, 0);
}

/* Sky through a hole in the ceiling. bars: 1 if the hole has bars */
static void window_of(known *k, int bars) {
    int i;
    known_floor(k, 60);
    known_lid(k, -60, -60, 60, -0.5f, 1.5f);
    known_lid(k, -60, 0.5f, 60, 60, 1.5f);
    known_lid(k, -60, -0.5f, -0.8f, 0.5f, 1.5f);
    known_lid(k, 0.8f, -0.5f, 60, 0.5f, 1.5f);
    for (i = 0; i < bars; i++) {
        const float x = -0.8f + 1.6f * ((float)i + 0.6f) / (float)bars;
        known_lid(k, x, -0.5f, x + 0.6f / (float)bars, 0.5f, 1.5f);
    }
    k->dark = bars ? 0.35 : 0.42;
    k->within = 0.9;
    k->sky = 1;
    k->view_below = 1;
    scene_sky(&k->scene, 1, 1, 1);
    k->view = scene_view(WIDTH, HEIGHT, 60, 0, 1.2f, 2.5f, 0, 0, 0);
}

static void hole(known *k) { window_of(k, 0); }
static void bars(known *k) { window_of(k, 6); k->levels = LEVELS - 1; }

/* Two walls and a floor under the sky. */
static void corner(known *k) {
    const float left[12] = { -1, 0, -1, -1, 0, 3, -1, 1.5f, 3, -1, 1.5f, -1 },
        back[12] = { -1, 0, -1, 3, 0, -1, 3, 1.5f, -1, -1, 1.5f, -1 };
    const float ground[12] = { -1, 0, -1, 3, 0, -1, 3, 0, 3, -1, 0, 3 };
    const int grey = scene_material(&k->scene, 0.5f, 0.5f, 0.5f);
    scene_polygon(&k->scene, grey, left, 4);
    scene_polygon(&k->scene, grey, back, 4);
    scene_polygon(&k->scene, grey, ground, 4);
    known_polygon(k, -1, left);
    known_polygon(k, -1, back);
    known_polygon(k, -1, ground);
    k->sky = 1;
    scene_sky(&k->scene, 1, 1, 1);
    k->view = scene_view(WIDTH, HEIGHT, 60, 1.6f, 1.6f, 2.2f, -0.4f, 0.3f, -0.4f);
}

/* 36 lamps of different brightness over a floor. */
static void many_lamps(known *k) {
    int i;
    known_floor(k, 6);
    for (i = 0; i < 36; i++) {
        const float x = (float)(i % 6) - 2.5f, z = (float)(i / 6) - 2.5f, size = 0.02f + 0.02f * (float)(i % 5);
        known_lamp(k, 1 + 7 * (i * 7 % 36) / 36.0, x - size, z - size, x + size, z + size,
                   0.5f + 0.1f * (float)(i % 4));
    }
    k->dark = 0.04;
    k->view = scene_view(WIDTH, HEIGHT, 60, 0, 3, 4, 0, 0, 0);
}

/* Boards in the light of a lamp, with shadows of every kind. The ray caster finds the truth. */
static void boards(known *k) {
    const float corners[12] = { -0.3f, 2, -0.3f, 0.3f, 2, -0.3f, 0.3f, 2, 0.3f, -0.3f, 2, 0.3f };
    const int grey = scene_material(&k->scene, 0.5f, 0.5f, 0.5f);
    int i;
    known_floor(k, 3);
    k->lamp = k->scene.mesh_count;
    scene_polygon(&k->scene, scene_lamp(&k->scene, 5, 5, 5), corners, 4);
    known_polygon(k, 5, corners);
    for (i = 0; i < 8; i++) {
        const float x = 0.45f * (float)(i % 4) - 0.8f, z = 0.9f * (float)(i / 4) - 0.6f;
        scene_box(&k->scene, grey, x, 0.001f, z, x + 0.03f + 0.02f * (float)i, 0.1f + 0.08f * (float)i, z + 0.1f);
    }
    k->dark = 0.37;
    k->view = scene_view(WIDTH, HEIGHT, 50, 0.5f, 1.7f, 2.2f, 0, 0.1f, 0);
}

/* Returns R at p with the normal n. */
static double known_light(const known *k, const ref_scene *caster, v3 p, v3 n, uint64_t *seed) {
    double light = k->sky;
    int i;
    if (k->lamp) return k->radiance[0] * ref_quad_light(caster, p, n, k->corners[0], k->lamp, 20, seed);
    for (i = 0; i < k->count; i++) light += k->radiance[i] * ref_polygon(p, n, k->corners[i], 4);
    if (k->height > 0) {  /* the hidden light is the projection of the rectangle onto the plane of the lamp */
        const double t = k->lamp_height / k->height;
        const double x0 = fmax(k->corners[0][0].x, p.x + t * (k->blocker[0] - p.x)),
            x1 = fmin(k->corners[0][2].x, p.x + t * (k->blocker[2] - p.x));
        const double z0 = fmax(k->corners[0][0].z, p.z + t * (k->blocker[1] - p.z)),
            z1 = fmin(k->corners[0][2].z, p.z + t * (k->blocker[3] - p.z));
        const v3 covered[4] = { { x0, k->lamp_height, z0 }, { x1, k->lamp_height, z0 }, { x1, k->lamp_height, z1 },
            { x0, k->lamp_height, z1 } };
        if (x1 > x0 && z1 > z0) light -= k->radiance[0] * ref_polygon(p, n, covered, 4);
    }
    return light;
}

/* dark: error of pixels below a tenth of the mean, relative to their own light */
typedef struct figures { double truth, predicted, by_pixels, within, dark; } figures;

static figures compare(const known *k, const double *truth) {
    float *light = scene_channel(context, &k->view, SBL_CHANNEL_RADIANCE),
        *error = scene_channel(context, &k->view, SBL_CHANNEL_ERROR);
    figures f = { 0, 0, 0, 0, 0 };
    double squares = 0, predicted = 0, mean = 0, dark_squares = 0, dark_light = 0;
    int i, count = 0, within = 0;
    for (i = 0; i < WIDTH * HEIGHT; i++) {
        const double off = (double)light[3 * i + 1] - truth[i];
        if (truth[i] < 0) continue;
        squares += off * off;
        predicted += (double)error[i] * (double)error[i];
        mean += truth[i];
        count++;
    }
    for (i = 0; i < WIDTH * HEIGHT; i++) {
        const double off = fabs((double)light[3 * i + 1] - truth[i]);
        within += truth[i] >= 0 && off <= 2 * (double)error[i] + 1e-4 * mean / count;
        if (!(truth[i] > 0) || truth[i] > 0.1 * mean / count) continue;
        dark_squares += off * off;
        dark_light += truth[i] * truth[i];
    }
    f.dark = dark_light > 0 ? sqrt(dark_squares / dark_light) : 0;
    free(light);
    free(error);
    f.truth = sqrt(squares / count) / (mean / count);
    f.by_pixels = sqrt(predicted / count) / (mean / count);
    f.predicted = (double)sbl_query_stats(context).picture.expected_error;
    f.within = (double)within / count;
    return f;
}

static void predicted_well(void (*make)(known *)) {
    static const float asked[LEVELS] = { 0.08f, 0.04f, 0.02f, 0.01f };
    static known k;
    static double truth[WIDTH * HEIGHT];
    sbl_scene_desc desc;
    ref_scene *caster;
    uint64_t seed = 1;
    int i, level;
    memset(&k, 0, sizeof k);
    k.levels = LEVELS;
    k.within = 0.9;
    make(&k);
    k.view.options.mode = SBL_MODE_DIRECT;
    desc = scene_desc(&k.scene);
    caster = ref_create(&desc);
    for (i = 0; i < WIDTH * HEIGHT; i++) {
        const ref_point p = ref_pixel(caster, &k.view, i % WIDTH, i / WIDTH);
        truth[i] = p.hit && !ref_glows(caster, &p) && !(k.view_below > 0 && p.position.y > k.view_below)
            ? known_light(&k, caster, p.position, p.normal, &seed) : -1;
    }
    for (level = 0; level < k.levels; level++) {
        figures f;
        k.view.target_error = asked[level];
        if (!scene_render(context, &k.scene, &k.view)) break;
        f = compare(&k, truth);
        printf("  target error %.1f %%: %.2f %% predicted, %.2f %% by pixels, %.2f %% true; %.1f %% of the pixels "
               "within twice their prediction; %lld sensors, %lld rays\n",
               100 * (double)asked[level], 100 * f.predicted, 100 * f.by_pixels, 100 * f.truth, 100 * f.within,
               (long long)sbl_query_stats(context).sensors.sites, (long long)sbl_query_stats(context).sensors.rays);
        CHECK(f.predicted <= (double)asked[level] && f.predicted > 0.5 * (double)asked[level],
              "target %g: the predicted error is %g", (double)asked[level], f.predicted);
        CHECK(f.truth < 1.35 * f.predicted && f.truth > 0.5 * f.predicted,
              "target %g: the predicted error is %.2f %%, the true one %.2f %%", (double)asked[level],
              100 * f.predicted,
              100 * f.truth);
        CHECK(f.by_pixels < 1.2 * f.predicted && f.by_pixels > 0.8 * f.predicted,
              "target %g: the predicted error is %.2f %%, that of SBL_CHANNEL_ERROR %.2f %%", (double)asked[level],
              100 * f.predicted, 100 * f.by_pixels);
        CHECK(level < k.levels - 1 || k.dark == 0 || f.dark < k.dark,
              "R of dark pixels is off by %.1f %% of their light",
              100 * f.dark);
        CHECK(f.within > k.within, "target %g: %.1f %% of the pixels are within twice their predicted error",
              (double)asked[level], 100 * f.within);
    }
    ref_destroy(caster);
    scene_free(&k.scene);
}

/* The shadow of a red lamp under a blue sky of 5. Errors are relative to the mean of their own channel, and red has
   only an eighth of the light. If sbl.h used the luminance, red would be off by 29 %. */
TEST(of_a_red_shadow_in_blue_light) {
    static known k;
    float *light;
    double squares = 0, mean = 0, off;
    int i, count = 0;
    memset(&k, 0, sizeof k);
    penumbra(&k);
    for (i = 0; i < k.scene.material_count; i++)
        k.scene.materials[i].emission[1] = k.scene.materials[i].emission[2] = 0;
    scene_sky(&k.scene, 0, 0, 5);
    k.view.options.mode = SBL_MODE_DIRECT;
    k.view.target_error = 0.02f;
    if (scene_render(context, &k.scene, &k.view)) {
        const sbl_scene_desc desc = scene_desc(&k.scene);
        ref_scene *caster = ref_create(&desc);
        light = scene_channel(context, &k.view, SBL_CHANNEL_RADIANCE);
        for (i = 0; i < WIDTH * HEIGHT; i++) {
            const ref_point p = ref_pixel(caster, &k.view, i % WIDTH, i / WIDTH);
            double truth;
            if (!p.hit || p.position.y > 0.5) continue;
            truth = known_light(&k, caster, p.position, p.normal, NULL);
            squares += ((double)light[3 * i] - truth) * ((double)light[3 * i] - truth);
            mean += truth;
            count++;
        }
        off = sqrt(squares / count) / (mean / count);
        printf("  red is off by %.2f %%\n", 100 * off);
        CHECK(off < 0.09, "red is off by %.2f %%", 100 * off);
        free(light);
        ref_destroy(caster);
    }
    scene_free(&k.scene);
}

/* Parallel plates under the sky, with light that bounces between them. */
static void plates(known *k) {
    const int grey = scene_material(&k->scene, 0.7f, 0.7f, 0.7f);
    int i;
    for (i = 0; i < 8; i++) scene_box(&k->scene, grey, 0.1f * (float)i - 0.4f, 0, -1, 0.1f * (float)i - 0.37f, 0.5f, 1);
    known_floor(k, 3);
    scene_sky(&k->scene, 1, 1, 1);
    k->view = scene_view(64, 48, 60, 0.3f, 1.6f, 1.6f, 0, 0.1f, 0);
    k->view.options.mode = SBL_MODE_GI;
    k->view.tile = 1;
    k->view.filter_radius = -1;
}

/* Most rays hit plates so near that they are reflected there and traced further, instead of reading the store. If all
   looks of a sensor reflected rays in the same directions, more looks would not reduce the error. The reference is a
   picture with a single look of 4096 rays per sensor. */
TEST(of_looks_between_near_plates) {
    static known k;
    int i;
    memset(&k, 0, sizeof k);
    plates(&k);
    k.view.options.rays = 2048;
    if (scene_render(context, &k.scene, &k.view)) {
        float *truth = scene_channel(context, &k.view, SBL_CHANNEL_RADIANCE), *light;
        double squares = 0, mean = 0, off, predicted, stored;
        k.view.options.rays = 0;
        k.view.target_error = 0.01f;
        if (scene_render(context, &k.scene, &k.view)) {
            light = scene_channel(context, &k.view, SBL_CHANNEL_RADIANCE);
            for (i = 0; i < 64 * 48; i++) {
                squares += ((double)light[3 * i] - (double)truth[3 * i]) *
                    ((double)light[3 * i] - (double)truth[3 * i]);
                mean += (double)truth[3 * i];
            }
            predicted = (double)sbl_query_stats(context).picture.expected_error;
            stored = (double)sbl_query_stats(context).picture.stored_error;
            /* the error of the store is subtracted, because both pictures read the same store */
            predicted = sqrt(predicted * predicted - stored * stored);
            off = sqrt(squares * 64 * 48) / mean;
            printf("  %.2f %% predicted, %.2f %% true\n", 100 * predicted, 100 * off);
            CHECK(off < 1.1 * predicted, "the predicted error of sensors is %.2f %%, the true one %.2f %%",
                  100 * predicted, 100 * off);
            free(light);
        }
        free(truth);
    }
    scene_free(&k.scene);
}

/* A cell has corners on two surfaces, and between them a strip of a third surface without a sensor. Light that may be
   hidden there counts as bias, not as noise. With a single surface there is no such bias. */
TEST(of_what_silhouettes_hide) {
    float hidden[2] = { 0, 0 };
    int run;
    for (run = 0; run < 3; run++) {  /* dim; four times as bright; a single surface */
        const float light = run == 1 ? 4 : 1;
        const inside_weight w = inside_weigh_corners(run < 2, light);
        CHECK(w.noise2 > 1 && w.light > 0.9f * light, "noise %g, light %g", (double)w.noise2, (double)w.light);
        if (run < 2) hidden[run] = w.bias2;
        else CHECK(w.bias2 == 0 && w.split_gain == 0, "on a single surface the bias is %g, the gain of a split %g",
                   (double)w.bias2,
                   (double)w.split_gain);
        CHECK(run == 2 || w.split_gain > 0, "the gain of a split is %g", (double)w.split_gain);
    }
    CHECK(hidden[0] > 0.25f * 0.04f * 0.04f && hidden[0] < 0.25f * 3 * 0.15f * 0.15f, "the bias is %g",
          (double)hidden[0]);
    CHECK(hidden[1] > 15.9f * hidden[0] && hidden[1] < 16.1f * hidden[0],
          "with four times the light the bias is %g times as large",
          (double)(hidden[1] / hidden[0]));
}

/* The predicted error of a store with few cells agrees with its difference from a store with many. */
TEST(of_few_bounce_samples) {
    static known k;
    float *light[2] = { NULL, NULL };
    double squares = 0, mean = 0, off, predicted[2] = { 0, 0 }, stored[2] = { 0, 0 };
    int i;
    memset(&k, 0, sizeof k);
    plates(&k);
    k.view.options.rays = 1024;
    for (i = 0; i < 2; i++) {
        sbl_scene_desc desc = scene_desc(&k.scene);
        desc.max_bounce_cells = i ? 300000 : 4096;
        if (sbl_set_scene(context, &desc) != SBL_SUCCESS || sbl_render_picture(context, &k.view) != SBL_SUCCESS) break;
        light[i] = scene_channel(context, &k.view, SBL_CHANNEL_RADIANCE);
        predicted[i] = (double)sbl_query_stats(context).picture.expected_error;
        stored[i] = (double)sbl_query_stats(context).picture.stored_error;
    }
    for (i = 0; i < 64 * 48 && light[0] && light[1]; i++) {
        squares += ((double)light[0][3 * i] - (double)light[1][3 * i]) *
            ((double)light[0][3 * i] - (double)light[1][3 * i]);
        mean += (double)light[1][3 * i];
    }
    off = mean > 0 ? sqrt(squares * 64 * 48) / mean : HUGE_VAL;
    printf("  %.2f and %.2f %% predicted, %.3f and %.3f %% of it by the store, difference %.2f %%\n",
           100 * predicted[0], 100 * predicted[1], 100 * stored[0], 100 * stored[1], 100 * off);
    CHECK(stored[0] > 0.6 * off && stored[0] < 1.7 * off && stored[1] < 0.4 * stored[0],
          "the store is said to cause %.3f %%, with many cells %.3f %%", 100 * stored[0], 100 * stored[1]);
    CHECK(off < 2.3 * predicted[0] && off > 0.5 * predicted[0], "the predicted error is %.2f %%, the true one %.2f %%",
          100 * predicted[0], 100 * off);
    free(light[0]);
    free(light[1]);
    scene_free(&k.scene);
}

/* Makes a room whose lamp lights only part of the ceiling. */
static void lit_ceiling(test_scene *s) {
    static const float lamp[12] = { -0.2f, 0.8f, -0.2f, -0.2f, 0.8f, 0.2f, 0.2f, 0.8f, 0.2f, 0.2f, 0.8f, -0.2f };
    scene_box(s, scene_material(s, 0.7f, 0.7f, 0.7f), -1, -1, -1, 1, 1, 1);
    scene_polygon(s, scene_lamp(s, 100, 100, 100), lamp, 4);
}

/* A lamp lights only part of a ceiling, so that few rays of the store find the light that reaches the room. Stores with
   different numbers of cells then differ by noise, which the predicted error of stored light includes. Nearby cells
   have no part in it, because there are none near the middle of the floor. */
TEST(of_noise_in_the_store) {
    enum { STORES = 12 };
    test_scene s = { 0 };
    sbl_picture_desc view = scene_view(16, 12, 15, 0.3f, 0.5f, 0.3f, 0, -1, 0);
    double mean = 0, squares = 0, predicted = 0, off;
    int i, k;
    lit_ceiling(&s);
    view.options.mode = SBL_MODE_GI;
    view.options.rays = 1024;
    for (i = 0; i < STORES; i++) {
        sbl_scene_desc desc = scene_desc(&s);
        double sum = 0;
        float *light;
        desc.max_bounce_cells = 2000 + 200 * i;
        REQUIRE(sbl_set_scene(context, &desc) == SBL_SUCCESS && sbl_render_picture(context, &view) == SBL_SUCCESS,
                "no picture");
        light = scene_channel(context, &view, SBL_CHANNEL_RADIANCE);
        for (k = 0; k < 16 * 12; k++) sum += (double)light[3 * k] / (16 * 12);
        free(light);
        mean += sum / STORES;
        squares += sum * sum / STORES;
        predicted += (double)sbl_query_stats(context).picture.stored_error / STORES;
    }
    off = sqrt(squares - mean * mean) / mean;
    printf("  %.2f %% predicted, pictures differ by %.2f %%\n", 100 * predicted, 100 * off);
    CHECK(predicted > 0.35 * off && predicted < 1.5 * off, "the store is said to cause %.2f %%, pictures differ by "
          "%.2f %%", 100 * predicted, 100 * off);
    scene_free(&s);
}

/* Renders a picture, and returns R, or NULL on failure. usual, most: see inside_limit_cells; most: 0: the host sets the
   number `usual`. slice: seconds of a step; if it is not 0, R of the unfinished picture is read after each step */
static float *coarse_picture(const test_scene *s, const sbl_picture_desc *view, int usual, int most, double slice) {
    sbl_scene_desc desc = scene_desc(s);
    sbl_picture_desc shown = *view;
    sbl_result result;
    desc.max_bounce_cells = most ? 1024 : usual;
    if (sbl_set_scene(context, &desc) != SBL_SUCCESS) return NULL;
    if (most) inside_limit_cells(context, usual, most);
    result = sbl_begin_picture(context, view);
    if (result == SBL_SUCCESS)
        do {
            static float early[3 * 31 * 33];
            result = sbl_step(context, slice);
            if (slice > 0)
                sbl_read_channel(context, SBL_CHANNEL_RADIANCE, early, (size_t)(3 * view->width * view->height));
        } while (result == SBL_UNFINISHED);
    if (view->window[2]) shown.width = view->window[2];
    return result == SBL_SUCCESS ? scene_channel(context, &shown, SBL_CHANNEL_RADIANCE) : NULL;
}

/* If the error of stored light alone exceeds 1.5 times the target error, the first picture makes the store again with
   more cells, and is then the same, with the same statistics, as with these cells from the start. Pictures with another
   target, and those to which other rules apply, use the store as it is. A picture that can decide does so only once. */
TEST(of_coarse_stores) {
    enum { FEW = 2000, MANY = 6000 };
    static const char *const names[] = { "whole", "in slices", "error allowed", "number set", "window", "price",
        "threshold", "threshold 0", "rays", "cells kept" };
    enum { WHOLE, SLICES, ALLOWED, SET, WINDOW, PRICE, THRESHOLD, THRESHOLD_0, RAYS, KEPT, CASES };
    test_scene s = { 0 };
    sbl_picture_desc view = scene_view(32, 24, 40, 0.3f, 0.5f, 0.3f, 0, -1, 0);
    double stored;
    sbl_stats whole;
    float *expected;
    int i;
    lit_ceiling(&s);
    view.options.mode = SBL_MODE_GI;
    free(coarse_picture(&s, &view, FEW, 0, 0));
    stored = (double)sbl_query_stats(context).picture.stored_error;
    view.target_error = (float)(stored / 1.7);
    expected = coarse_picture(&s, &view, MANY, 0, 0);
    whole = sbl_query_stats(context);
    REQUIRE(expected && stored > 0.004, "the error of stored light is %g", stored);
    for (i = 0; i < CASES; i++) {
        const int grows = i == WHOLE || i == SLICES;
        sbl_picture_desc d = view;
        sbl_stats stats;
        float *light;
        if (i == ALLOWED) d.target_error = (float)(stored / 1.3);
        if (i == WINDOW) d.window[2] = 16;
        if (i == WINDOW) d.window[3] = 24;
        if (i == PRICE) d.price = 1e-3f;
        if (i == THRESHOLD) d.threshold = 0.05f;
        if (i == THRESHOLD_0) d.threshold = -1;
        if (i == RAYS) d.options.rays = 64;
        if (i == KEPT) d.max_bounce_cells = -1;
        light = coarse_picture(&s, &d, FEW, i == SET ? FEW : MANY, i == SLICES ? 1e-4 : 0);
        stats = sbl_query_stats(context);
        CHECK(light && stats.store.max_cells == (grows ? MANY : FEW), "%s: %d cells at most", names[i],
              stats.store.max_cells);
        CHECK(!grows || (light && memcmp(light, expected, 3 * sizeof *light * 32 * 24) == 0), "%s: other light",
              names[i]);
        CHECK(!grows || (stats.sensors.sites == whole.sensors.sites && stats.sensors.rays == whole.sensors.rays &&
                         stats.picture.visible_pixels == whole.picture.visible_pixels),
              "%s: %.0f sensors and %.0f rays, expected %.0f and %.0f", names[i], (double)stats.sensors.sites,
              (double)stats.sensors.rays, (double)whole.sensors.sites, (double)whole.sensors.rays);
        free(light);
        if (i != ALLOWED && i != RAYS) continue;
        CHECK(sbl_render_picture(context, &view) == SBL_SUCCESS &&
                  sbl_query_stats(context).store.max_cells == (i == ALLOWED ? FEW : MANY),
              "after \"%s\": %d cells at most", names[i], sbl_query_stats(context).store.max_cells);
    }
    free(expected);
    scene_free(&s);
}

/* Changes the light of the scene a little. Returns 0 on failure. */
static int light_changes(const test_scene *s) {
    static sbl_material materials[sizeof s->materials / sizeof s->materials[0]];
    static float times = 1;
    int i, k;
    memcpy(materials, s->materials, sizeof materials);
    times *= 1.01f;
    for (i = 0; i < s->material_count; i++) for (k = 0; k < 3; k++) materials[i].emission[k] *= times;
    return sbl_set_materials(context, materials, s->material_count) == SBL_SUCCESS;
}

/* If a picture sets max_bounce_cells, its light is the same, to the bit, as if the scene had set this number. The store
   is made again only if it was made with another number. The picture does not raise its number, and later pictures have
   the number of the scene again when the store must be made. */
TEST(of_stores_for_windows) {
    enum { FEW = 1500, MANY = 3000, SIDE = 16, FLOATS = 3 * SIDE * SIDE };
    static const int numbers[] = { MANY, MANY, 0, -1, FEW, MANY };  /* of pictures, one after the other */
    static const int expected[] = { MANY, MANY, MANY, MANY, FEW, MANY };
    test_scene s = { 0 };
    sbl_picture_desc view = scene_view(SIDE, SIDE, 40, 0.3f, 0.5f, 0.3f, 0, -1, 0);
    float *few, *many;
    int i;
    lit_ceiling(&s);
    view.options.mode = SBL_MODE_GI;
    view.options.preset = SBL_PRESET_DRAFT;
    many = coarse_picture(&s, &view, MANY, 0, 0);
    few = coarse_picture(&s, &view, FEW, 0, 0);
    REQUIRE(few && many && memcmp(few, many, FLOATS * sizeof *few) != 0, "both numbers give the same light");
    for (i = 0; i < (int)(sizeof numbers / sizeof numbers[0]); i++) {
        float *light;
        sbl_stats stats;
        view.max_bounce_cells = numbers[i];
        REQUIRE(sbl_render_picture(context, &view) == SBL_SUCCESS, "picture %d", i);
        light = scene_channel(context, &view, SBL_CHANNEL_RADIANCE);
        stats = sbl_query_stats(context);
        CHECK(stats.store.max_cells == expected[i] && memcmp(light, expected[i] == FEW ? few : many,
                                                             FLOATS * sizeof *light) == 0,
              "picture %d: %d cells at most, or other light", i, stats.store.max_cells);
        CHECK((stats.store.rays > 0) == (i == 0 || expected[i] != expected[i - 1]), "picture %d: %.0f rays", i,
              (double)stats.store.rays);
        free(light);
    }
    REQUIRE(light_changes(&s), "the light cannot be changed");
    view.max_bounce_cells = 0;
    CHECK(sbl_render_picture(context, &view) == SBL_SUCCESS && sbl_query_stats(context).store.max_cells == FEW,
          "after other lights: %d cells at most", sbl_query_stats(context).store.max_cells);
    view.max_bounce_cells = MANY;
    REQUIRE(sbl_begin_picture(context, &view) == SBL_SUCCESS, "the picture cannot begin");
    for (i = 0; i < 12; i++) sbl_step(context, 1e-9);
    view.max_bounce_cells = 0;
    CHECK(sbl_render_picture(context, &view) == SBL_SUCCESS && sbl_query_stats(context).store.max_cells == FEW,
          "after an unfinished picture: %d cells at most", sbl_query_stats(context).store.max_cells);
    view.target_error = 0.001f;
    view.max_bounce_cells = FEW;
    free(coarse_picture(&s, &view, FEW, MANY, 0));
    CHECK(sbl_query_stats(context).store.max_cells == FEW, "%d cells at most",
          sbl_query_stats(context).store.max_cells);
    free(few);
    free(many);
    scene_free(&s);
}

/* A picture is also made again if its looks are guided, if it has a sensor at each pixel, and if the host has read a
   preview of it. */
TEST(of_coarse_stores_with_guides) {
    test_scene s = { 0 };
    sbl_picture_desc view = scene_view(31, 33, 40, 0.3f, 0.5f, 0.3f, 0, -1, 0);
    float *light[2];
    int i;
    lit_ceiling(&s);
    view.options.mode = SBL_MODE_GI;
    view.target_error = 0.003f;
    view.look_rays = -64;
    view.tile = 1;
    for (i = 0; i < 2; i++) light[i] = coarse_picture(&s, &view, i ? 6000 : 2000, i ? 0 : 6000, i ? 0 : 1e-4);
    CHECK(light[0] && light[1] && memcmp(light[0], light[1], 3 * sizeof *light[0] * 31 * 33) == 0, "other light");
    CHECK(sbl_query_stats(context).store.max_cells == 6000, "%d cells at most",
          sbl_query_stats(context).store.max_cells);
    free(light[0]);
    free(light[1]);
    scene_free(&s);
}

/* Sensors take looks until the total error equals the target. They always keep 0.84 of the target, or half of the error
   of the store if that is more, because a smaller error of sensors would hardly reduce the total, up to twice the
   target. */
TEST(of_sensors_beside_the_store) {
    static const double stores[] = { 0, 0.005, 0.01, 0.02, 0.05, 0.2 };
    int i;
    for (i = 0; i < 6; i++) {
        const double store = stores[i], rest = store < 0.01 ? sqrt(1e-4 - store * store) : 0;
        const double least = fmax(fmax(rest, sqrt(0.7) * 0.01), fmin(0.5 * store, 0.02));
        CHECK(inside_is_exact(0.01f, 0.99 * least, store), "target 1 %%, store %g: %.2f %% of the sensors are too much",
              store, 99 * least);
        CHECK(!inside_is_exact(0.01f, 1.01 * least, store), "target 1 %%, store %g: %.2f %% of the sensors suffice",
              store, 101 * least);
    }
}

/* If the target cannot be reached, a round does not make purchases that hardly help: the remaining squared error is at
   most a tenth above the squared error after all purchases. If the target can be reached, a round aims at three fifths
   of the current squared error. */
TEST(of_pixels_that_cannot_improve) {
    static const double hopeless[3] = { 0.3, 0.05, 0.02 }, hopeful[3] = { 0.3, 0.2, 0.45 };
    CHECK(fabs(inside_bought(0.01f, 1, hopeless) - 0.35) < 1e-9, "%g is bought of 0.37",
          inside_bought(0.01f, 1, hopeless));
    CHECK(fabs(inside_bought(0.01f, 1, hopeful) - 0.5) < 1e-9, "%g is bought of 0.95",
          inside_bought(0.01f, 1, hopeful));
    CHECK(inside_bought(0.2f, 1, hopeful) <= 0, "something is bought although the target is reached");
}

/* The price of a picture is the lowest price of any round, although a last round may only make a few dear purchases. */
TEST(of_the_last_round) {
    CHECK(inside_price(1, 0.25f) <= 0.25 && inside_price(1, 0.25f) > 0.2, "%g", inside_price(1, 0.25f));
    CHECK(inside_price(0.25f, 1) <= 0.25 && inside_price(0.25f, 1) > 0.2, "%g", inside_price(0.25f, 1));
}

/* In each scene, the predicted error is at most the target, and agrees with the true error as predicted_well
   requires. */
TEST(of_penumbrae) { predicted_well(penumbra); }
TEST(of_sky_through_a_hole) { predicted_well(hole); }
TEST(of_sky_through_bars) { predicted_well(bars); }
TEST(of_a_corner_under_the_sky) { predicted_well(corner); }
TEST(of_many_lamps) { predicted_well(many_lamps); }
TEST(of_boards_in_the_light) { predicted_well(boards); }

/* A small object between all sensors of the first level: errors are relative to the mean that later sensors find. */
TEST(of_what_the_first_level_misses) {
    int size;
    for (size = 12; size <= 18; size += 2) {
        test_scene s = { 0 };
        sbl_picture_desc view = scene_view(size, size, 40, 0, 3, 8, 0, 0, 0);
        double predicted;
        scene_sky(&s, 1, 1, 1);
        scene_floor(&s, scene_material(&s, 0.8f, 0.8f, 0.8f), 0, 1.5f);
        scene_quad(&s, 0, -0.5f, 0, 0, 0.5f, 0, 0, 0.5f, 1, 0, -0.5f, 1, 0);
        view.options.mode = SBL_MODE_DIRECT;
        view.target_error = 0.05f;
        if (!scene_render(context, &s, &view)) return;
        predicted = (double)sbl_query_stats(context).picture.expected_error;
        CHECK(predicted > 0.001 && predicted < 0.06, "%d pixels: the predicted error is %g", size, predicted);
        scene_free(&s);
    }
}

/* SBL_CHANNEL_LOOKS holds the number of looks of each sensor: one if the number of rays is fixed, and different numbers
   for a target error. Pixels without a sensor have 0. */
TEST(looks_are_counted) {
    test_scene s = { 0 };
    int way;
    scene_cornell_box(&s);
    scene_sky(&s, 1, 1, 1);  /* makes all looks trace rays over the hemisphere */
    for (way = 0; way < 2; way++) {
        sbl_picture_desc view = scene_cornell_view(WIDTH, HEIGHT);
        float *looks, *sensors;
        double sum = 0, least = 1e9, most = 0;
        int i, wrong = 0;
        view.options.mode = SBL_MODE_DIRECT;
        view.options.rays = way ? 0 : 16;
        REQUIRE(scene_render(context, &s, &view), "no picture");
        looks = scene_channel(context, &view, SBL_CHANNEL_LOOKS);
        sensors = scene_channel(context, &view, SBL_CHANNEL_SENSORS);
        for (i = 0; i < WIDTH * HEIGHT && looks && sensors; i++) {
            sum += (double)looks[i];
            wrong += (looks[i] > 0) != (sensors[i] > 0);
            if (looks[i] > 0 && (double)looks[i] < least) least = (double)looks[i];
            if ((double)looks[i] > most) most = (double)looks[i];
        }
        CHECK(!wrong, "%d pixels have looks and no sensor, or a sensor and no looks", wrong);
        if (way) CHECK(least >= 1 && most > 2 * least, "from %g to %g looks", least, most);
        else CHECK((int64_t)(16 * sum) == sbl_query_stats(context).sensors.rays && most < 1.5, "%g looks, %g rays", sum,
                   (double)sbl_query_stats(context).sensors.rays);
        free(looks);
        free(sensors);
    }
    scene_free(&s);
}

int main(void) {
    if (sbl_create(NULL, &context) != SBL_SUCCESS) { printf("no context\n0 passed, 1 failed, 0 skipped\n"); return 1; }
    RUN(of_penumbrae);
    RUN(of_sky_through_a_hole);
    RUN(of_sky_through_bars);
    RUN(of_a_corner_under_the_sky);
    RUN(of_many_lamps);
    RUN(of_boards_in_the_light);
    RUN(of_a_red_shadow_in_blue_light);
    RUN(of_looks_between_near_plates);
    RUN(of_what_silhouettes_hide);
    RUN(of_few_bounce_samples);
    RUN(of_noise_in_the_store);
    RUN(of_coarse_stores);
    RUN(of_stores_for_windows);
    RUN(of_coarse_stores_with_guides);
    RUN(of_sensors_beside_the_store);
    RUN(of_pixels_that_cannot_improve);
    RUN(of_the_last_round);
    RUN(of_what_the_first_level_misses);
    RUN(looks_are_counted);
    sbl_destroy(context);
    return test_report();
}
