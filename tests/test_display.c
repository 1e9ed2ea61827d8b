/* Tests SBL_CHANNEL_DISPLAY, the picture for a screen. View transforms are compared with independent formulas; the
   exposure and the edges of lamps are compared with the expectations of a viewer. */
#include "../sbl.h"
#include "support/test.h"
#include "support/scenes.h"

enum { WIDTH = 48, HEIGHT = 36, PIXELS = WIDTH * HEIGHT };

static sbl_context *context;

static sbl_picture_desc shown(sbl_picture_desc view, sbl_tone tone) {
    view.options.mode = SBL_MODE_DIRECT;
    view.options.rays = 64;
    view.tile = 4;
    view.samples = 1;
    view.tone = tone;
    return view;
}

/* Applies PBR Neutral as Khronos publishes it: subtracts F90 = 0.04, then compresses values above 0.8 - 0.04. */
static void neutral(double c[3]) {
    const double low = fmin(c[0], fmin(c[1], c[2])), offset = low < 0.08 ? low - 6.25 * low * low : 0.04;
    const double start = 0.8 - 0.04, d = 1 - start;
    double peak, compressed, g;
    int k;
    for (k = 0; k < 3; k++) c[k] -= offset;
    peak = fmax(c[0], fmax(c[1], c[2]));
    if (peak < start) return;
    compressed = 1 - d * d / (peak + d - start);
    g = 1 - 1 / (0.15 * (peak - compressed) + 1);
    for (k = 0; k < 3; k++) c[k] = c[k] * compressed / peak * (1 - g) + compressed * g;
}

/* Applies AgX with the polynomial that Wrensch (2023) fitted to its curve, with matrices of the same source. */
static void agx(double c[3]) {
    static const double in[9] = { 0.842479062253094, 0.0784335999999992, 0.0792237451477643, 0.0423282422610123,
        0.878468636469772, 0.0791661274605434, 0.0423756549057051, 0.0784336, 0.879142973793104 };
    static const double back[9] = { 1.19687900512017, -0.0980208811401368, -0.0990297440797205, -0.0528968517574562,
        1.15190312990417, -0.0989611768448433, -0.0529716355144438, -0.0980434501171241, 1.15107367264116 };
    double v[3];
    int k;
    for (k = 0; k < 3; k++) {
        const double x = log2(fmax(in[3 * k] * c[0] + in[3 * k + 1] * c[1] + in[3 * k + 2] * c[2], 1e-10));
        const double t = fmin(fmax((x + 12.47393) / (4.026069 + 12.47393), 0), 1);
        v[k] = ((((((15.5 * t - 40.14) * t + 31.96) * t - 6.868) * t + 0.4298) * t + 0.1191) * t) - 0.00232;
    }
    for (k = 0; k < 3; k++)
        c[k] = pow(fmax(back[3 * k] * v[0] + back[3 * k + 1] * v[1] + back[3 * k + 2] * v[2], 0), 2.2);
}

/* Every tone equals its formula at radiances from 2^-12 to 2^8 in many colours. AgX is compared with a fit, which
   itself is off by up to 0.02. */
TEST(tones_are_their_formulas) {
    static const double allowed[SBL_TONE_COUNT] = { 0, 1e-5, 1e-4, 0.02 };
    test_scene s = { 0 };
    sbl_picture_desc view = scene_view(WIDTH, HEIGHT, 40, 0, 0, 10, 0, 0, 0);
    float *final, *display;
    int tone, i, k;
    for (i = 0; i < 12 * 7; i++) {  /* a wall of lamps */
        const double level = pow(2, -12 + 20.0 * (i / 7) / 11);
        const float x = -4.8f + 0.8f * (float)(i / 7), y = -2.8f + 0.8f * (float)(i % 7);
        const int lamp = scene_lamp(&s, (float)(level * (1 + i % 3)), (float)(level * (0.05 + i % 4)),
                                    (float)(level * (0.1 + i % 5 / 2.0)));
        scene_quad(&s, lamp, x, y, 0, x + 0.8f, y, 0, x + 0.8f, y + 0.8f, 0, x, y + 0.8f, 0);
    }
    for (tone = SBL_TONE_CLIP; tone < SBL_TONE_COUNT; tone++) {
        double worst = 0, widest = 0;
        view = shown(view, (sbl_tone)tone);
        view.exposure = 1;
        if (!scene_render(context, &s, &view)) break;
        final = scene_channel(context, &view, SBL_CHANNEL_FINAL);
        display = scene_channel(context, &view, SBL_CHANNEL_DISPLAY);
        for (i = 0; i < PIXELS; i++) {
            double c[3];
            for (k = 0; k < 3; k++) c[k] = 2 * (double)final[3 * i + k];  /* brighter by one stop */
            if (tone == SBL_TONE_NEUTRAL) neutral(c);
            if (tone == SBL_TONE_AGX) agx(c);
            for (k = 0; k < 3; k++) {
                const double expected = fmin(fmax(c[k], 0), 1);
                worst = test_max(worst, fabs((double)display[3 * i + k] - expected));
                widest = test_max(widest, (double)display[3 * i + k]);
            }
        }
        printf("  tone %d: off by at most %.5f\n", tone, worst);
        CHECK(worst <= allowed[tone], "tone %d is off by %g", tone, worst);
        CHECK(widest > 0.97 && widest <= 1, "tone %d reaches %g", tone, widest);
        CHECK(sbl_query_stats(context).picture.exposure == 1.0f, "exposure: %g stops",
              (double)sbl_query_stats(context).picture.exposure);
        free(final);
        free(display);
    }
    scene_free(&s);
}

/* Returns one half of the sigmoid of AgX (Sobotka): the rise above the pivot at the distance x from it. The slope at
   the pivot is 2, and the rise at x = length is `height`. power: sharpness of the shoulder or toe */
static double agx_side(double x, double length, double height, double power) {
    const double whole = 2 * length;
    const double scale = pow(pow(whole, -power) * (pow(whole / height, power) - 1), -1 / power), term = 2 * x / scale;
    return scale * term / pow(1 + pow(term, power), 1 / power);
}

/* The curve of AgX, which grey pixels show alone, is exact from the darkest to the brightest. */
TEST(agx_of_grey) {
    enum { STEPS = 12 };
    test_scene s = { 0 };
    sbl_picture_desc view = shown(scene_view(STEPS, 1, 1, 0, 0, 10, 0, 0, 0), SBL_TONE_AGX);
    float *display;
    int i;
    for (i = 0; i < STEPS; i++) {
        const double side = 20 * tan(0.5 * TEST_PI / 180), left = (i - STEPS / 2) * side;
        const float level = (float)(0.18 * pow(2, -8 + 13.0 * i / (STEPS - 1))), x = (float)left;
        scene_quad(&s, scene_lamp(&s, level, level, level), x, -1, 0, x + (float)side, -1, 0, x + (float)side, 1, 0, x,
                   1, 0);
    }
    REQUIRE(scene_render(context, &s, &view), "no picture");
    display = scene_channel(context, &view, SBL_CHANNEL_DISPLAY);
    for (i = 0; i < STEPS; i++) {
        const double x = (-8 + 13.0 * i / (STEPS - 1)) / 16.5, grey = 10 / 16.5;
        const double curve = x < 0 ? 0.5 - agx_side(-x, grey, 0.5, 3) : 0.5 + agx_side(x, 1 - grey, 0.5, 3.25);
        CHECK(fabs((double)display[3 * i] - pow(curve, 2.2)) < 2e-4, "step %d: %.5f, expected %.5f", i,
              (double)display[3 * i], pow(curve, 2.2));
    }
    free(display);
    scene_free(&s);
}

/* FINAL and R have the same bits with and without a tone. Without a tone, DISPLAY is 0. */
TEST(other_channels_stay_as_they_are) {
    test_scene s = { 0 };
    sbl_picture_desc view = shown(scene_cornell_view(WIDTH, HEIGHT), SBL_TONE_NONE);
    float *now[3], *before[3];
    int i, k, none = 1;
    view.samples = 4;
    scene_cornell_box(&s);
    REQUIRE(scene_render(context, &s, &view), "no picture");
    for (k = 0; k < 3; k++)
        before[k] = scene_channel(context, &view, k == 0 ? SBL_CHANNEL_FINAL : k == 1 ? SBL_CHANNEL_RADIANCE
                                  : SBL_CHANNEL_DISPLAY);
    view.tone = SBL_TONE_AGX;
    view.auto_exposure = 1;
    REQUIRE(scene_render(context, &s, &view), "no picture");
    for (k = 0; k < 3; k++)
        now[k] = scene_channel(context, &view, k == 0 ? SBL_CHANNEL_FINAL : k == 1 ? SBL_CHANNEL_RADIANCE
                               : SBL_CHANNEL_DISPLAY);
    CHECK(memcmp(now[0], before[0], 12 * PIXELS) == 0, "a tone changes FINAL");
    CHECK(memcmp(now[1], before[1], 12 * PIXELS) == 0, "a tone changes R");
    for (i = 0; i < 3 * PIXELS; i++) none = none && before[2][i] == 0.0f;
    CHECK(none, "without a tone, DISPLAY is not 0");
    CHECK(memcmp(now[2], before[2], 12 * PIXELS) != 0, "with a tone, DISPLAY is 0");
    for (k = 0; k < 3; k++) { free(now[k]); free(before[k]); }
    scene_free(&s);
}

/* A pixel that a very bright lamp partly covers shows the covered share, for every tone. The exposure makes the light
   infinite. */
TEST(edges_of_lamps_are_smooth) {
    int tone;
    for (tone = SBL_TONE_CLIP; tone < SBL_TONE_COUNT; tone++) {
        test_scene s = { 0 };
        sbl_picture_desc view = shown(scene_view(WIDTH, HEIGHT, 40, 0, 0, 10, 0, 0, 0), (sbl_tone)tone);
        float *display;
        double part, seen;
        int x, partly = 0;
        view.samples = 64;
        view.exposure = 100;
        scene_quad(&s, scene_lamp(&s, 1e10f, 1e10f, 1e10f), -1.12f, -9, 0, 1.08f, -9, 0, 1.08f, 9, 0, -1.12f, 9, 0);
        REQUIRE(scene_render(context, &s, &view), "no picture");
        display = scene_channel(context, &view, SBL_CHANNEL_DISPLAY);
        for (x = 0; x < WIDTH; x++) {
            const double pixel = 20 * tan(20 * TEST_PI / 180) / HEIGHT, left = (x - WIDTH / 2) * pixel;
            part = fmin(fmax((fmin(left + pixel, 1.08) - fmax(left, -1.12)) / pixel, 0), 1);
            seen = (double)display[3 * (PIXELS / 2 + x)];
            partly += part > 0.1 && part < 0.9;
            CHECK(fabs(seen - part) < 0.03, "tone %d, pixel %d: %.3f of it is lit, the screen shows %.3f", tone, x,
                  part, seen);
        }
        CHECK(partly > 0, "no pixel is lit in part");
        free(display);
        scene_free(&s);
    }
}

/* A wall's edges cut pixels into parts. There, FINAL shows R at the samples on the wall, which differs from R at the
   centre of the pixel, by up to 7 % below a point light near the wall. A directional light shows which part of a pixel
   the wall covers. */
TEST(edges_show_the_light_at_samples) {
    static const double edges[4] = { -1.324, 1.527, -1.729, 1.325 };  /* least and largest x, least and largest y */
    const double pixel = 20 * tan(20 * TEST_PI / 180) / HEIGHT, high = 1.2;
    float *final[2];
    int light, e, i, steps = 1000;
    for (light = 0; light < 2; light++) {
        test_scene s = { 0 };
        sbl_picture_desc view = shown(scene_view(WIDTH, HEIGHT, 40, 0, 0, 10, 0, 0, 0), SBL_TONE_CLIP);
        sbl_light *l = scene_light(&s, light ? SBL_LIGHT_DIRECTIONAL : SBL_LIGHT_POINT, 1, 1, 1);
        const float x0 = (float)edges[0], x1 = (float)edges[1], y0 = (float)edges[2], y1 = (float)edges[3];
        if (light) l->direction[2] = -1;
        else l->position[2] = (float)high;
        view.samples = 64;
        view.tile = 1;
        scene_quad(&s, scene_material(&s, 0.5f, 0.5f, 0.5f), x0, y0, 0, x1, y0, 0, x1, y1, 0, x0, y1, 0);
        REQUIRE(scene_render(context, &s, &view), "no picture");
        final[light] = scene_channel(context, &view, SBL_CHANNEL_FINAL);
        scene_free(&s);
    }
    for (e = 0; e < 4; e++) {
        /* at: the column or row of pixels that the edge cuts. Column 0 begins at the picture's centre and lies to its
           right; row 0 begins there and lies above it. */
        const int axis = e / 2, at = (int)floor(edges[e] / pixel);
        const int cut = axis ? (HEIGHT / 2 - 1 - at) * WIDTH + WIDTH / 2 : HEIGHT / 2 * WIDTH + WIDTH / 2 + at;
        const double other = edges[e] < 0 ? at + 1 : at, length = fabs(other * pixel - edges[e]);
        double expected = 0, seen;
        for (i = 0; i < steps; i++) {
            const double d = edges[e] + (edges[e] < 0 ? 1 : -1) * (i + 0.5) / steps * length;
            expected += high / pow(d * d + pixel * pixel / 4 + high * high, 1.5) / steps;
        }
        seen = (double)final[0][3 * cut] / (double)final[1][3 * cut];
        CHECK(length / pixel > 0.5 && length / pixel < 0.6, "edge %d covers %.2f of a pixel", e, length / pixel);
        CHECK(fabs(seen / expected - 1) < 0.005, "edge %d: light %.5f, expected %.5f (%+.2f %%)", e, seen, expected,
              100 * (seen / expected - 1));
    }
    free(final[0]);
    free(final[1]);
}

/* A backdrop is shown where there is no surface, and fades to 0.3 at the upper edge. Everything else has the same bits.
   A brighter sky hides the backdrop. */
TEST(a_backdrop_is_behind_objects) {
    static const sbl_channel channels[3] = { SBL_CHANNEL_DISPLAY, SBL_CHANNEL_FINAL, SBL_CHANNEL_RADIANCE };
    test_scene s = { 0 };
    sbl_picture_desc view = shown(scene_view(WIDTH, HEIGHT, 40, 0, 0, 10, 0, 0, 0), SBL_TONE_NEUTRAL);
    float *before[3], *now[3], *id, *bright;
    double worst = 0, most = 0;
    int i, k, changed = 0, behind = 0;
    scene_quad(&s, scene_lamp(&s, 0.01f, 0.02f, 0.03f), -1.12f, -9, 0, 1.08f, -9, 0, 1.08f, 9, 0, -1.12f, 9, 0);
    REQUIRE(scene_render(context, &s, &view), "no picture");
    for (k = 0; k < 3; k++) before[k] = scene_channel(context, &view, channels[k]);
    view.backdrop[0] = 0.2f;
    view.backdrop[1] = view.backdrop[2] = 0.1f;
    REQUIRE(scene_render(context, &s, &view), "no picture");
    for (k = 0; k < 3; k++) now[k] = scene_channel(context, &view, channels[k]);
    id = scene_channel(context, &view, SBL_CHANNEL_ID);
    for (i = 0; i < 3 * PIXELS; i++) {
        const double fade = 0.3 + 0.7 * (i / 3 / WIDTH + 0.5) / HEIGHT;
        if (id[i / 3] > 0) changed += memcmp(&now[0][i], &before[0][i], 4) != 0;
        else worst = test_max(worst, fabs((double)now[0][i] - fade * (double)view.backdrop[i % 3]));
        behind += !(id[i / 3] > 0);
    }
    CHECK(behind > PIXELS && worst < 1e-6, "it is off by %g at %d values", worst, behind);
    CHECK(!changed && !memcmp(now[1], before[1], 12 * PIXELS) && !memcmp(now[2], before[2], 12 * PIXELS),
          "it changes surfaces: %d values, FINAL or R", changed);
    for (k = 0; k < 3; k++) s.sky[k] = 1;
    REQUIRE(scene_render(context, &s, &view), "no picture");
    bright = scene_channel(context, &view, SBL_CHANNEL_DISPLAY);
    for (i = 0; i < 3; i++) most = test_max(most, fabs((double)bright[i] - (double)bright[3 * (PIXELS - 1) + i]));
    CHECK(most < 1e-6 && bright[0] > 0.5f, "before a sky, the corners differ by %g", most);
    for (k = 0; k < 3; k++) { free(now[k]); free(before[k]); }
    free(id);
    free(bright);
    scene_free(&s);
}

static int compare(const void *a, const void *b) {
    const double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

/* Returns the mean log2 of the luminances that are not 0, between two quantiles `from` and `to`. */
static double mean_log(const float *rgb, double from, double to) {
    static double logs[PIXELS];
    double sum = 0, weights = 0;
    int i, count = 0;
    for (i = 0; i < PIXELS; i++) {
        const float *c = rgb + 3 * i;
        const double y = 0.2126 * (double)c[0] + 0.7152 * (double)c[1] + 0.0722 * (double)c[2];
        if (y > 0) logs[count++] = log2(y);
    }
    qsort(logs, (size_t)count, sizeof *logs, compare);
    for (i = 0; i < count; i++) {
        const double weight = fmax(fmin(i + 1, to * count) - fmax(i, from * count), 0);
        sum += weight * logs[i];
        weights += weight;
    }
    return sum / weights;
}

/* Returns the exposure of a finished picture according to ON PICTURES in sbl.h. */
static double chosen(const sbl_picture_desc *view) {
    float *R = scene_channel(context, view, SBL_CHANNEL_RADIANCE);
    float *final = scene_channel(context, view, SBL_CHANNEL_FINAL);
    const double stops = log2(0.71) - mean_log(R, 0.05, 0.95), limit = log2(2.8) - mean_log(final, 0.95, 1);
    free(R);
    free(final);
    return fmax(fmin(stops, limit), stops - 1.5);
}

/* Returns the automatic exposure for a room whose walls have this albedo. mean: receives the mean of the displayed
   picture. power: radiance of the lamp, which is hidden from the camera. window: radiance of a bright quad in a tenth
   of the picture; if negative, the quad is also hidden, and gives the same light */
static double metered(float albedo, float power, float window, double *mean) {
    test_scene s = { 0 };
    sbl_picture_desc view = shown(scene_view(WIDTH, HEIGHT, 60, 0, 0, 0.9f, 0, 0, -1), SBL_TONE_NEUTRAL);
    int i, lamp = scene_lamp(&s, power, power, power);
    float *display;
    double off;
    view.auto_exposure = 1;
    scene_box(&s, scene_material(&s, albedo, albedo, albedo), -1, -1, -1, 1, 1, 1);
    s.materials[lamp].flags |= SBL_MATERIAL_HIDDEN_FROM_CAMERA;
    scene_quad(&s, lamp, -0.5f, 0.98f, -0.5f, 0.5f, 0.98f, -0.5f, 0.5f, 0.98f, 0.5f, -0.5f, 0.98f, 0.5f);
    if (window != 0) {
        const float bright = fabsf(window);
        lamp = scene_lamp(&s, bright, bright, bright);
        s.materials[lamp].flags |= SBL_MATERIAL_ONE_SIDED_EMISSION;
        if (window < 0) s.materials[lamp].flags |= SBL_MATERIAL_HIDDEN_FROM_CAMERA;
        scene_quad(&s, lamp, -0.4f, -0.2f, -0.99f, 0.1f, -0.2f, -0.99f, 0.1f, 0.2f, -0.99f, -0.4f, 0.2f, -0.99f);
    }
    *mean = 0;
    if (!scene_render(context, &s, &view)) return NAN;
    off = fabs(chosen(&view) - (double)sbl_query_stats(context).picture.exposure);
    CHECK(off < 0.03, "the exposure is off by %.3f stops", off);
    display = scene_channel(context, &view, SBL_CHANNEL_DISPLAY);
    for (i = 0; i < 3 * PIXELS; i++) *mean += (double)display[i] / (3 * PIXELS);
    free(display);
    scene_free(&s);
    return (double)sbl_query_stats(context).picture.exposure;
}

/* The exposure follows the total light, and does not follow the albedo. */
TEST(exposure_follows_the_light) {
    double mean[4];
    const double one = metered(0.8f, 1, 0, &mean[0]), bright = metered(0.8f, 1024, 0, &mean[1]),
        dim = metered(0.8f, 1.0f / 4096, 0, &mean[2]), dark = metered(0.1f, 1, 0, &mean[3]);
    printf("  %.2f stops, %.2f in bright light, %.2f in dim light, %.2f with dark walls; means %.3f %.3f %.3f %.3f\n",
           one, bright, dim, dark, mean[0], mean[1], mean[2], mean[3]);
    CHECK(fabs(one - bright - 10) < 0.02 && fabs(dim - one - 12) < 0.02, "the exposure does not follow the light");
    CHECK(fabs(mean[1] - mean[0]) < 0.01 && fabs(mean[2] - mean[0]) < 0.01, "the screen shows the same room otherwise");
    CHECK(fabs(one - dark) < 0.02, "the exposure follows the albedo");
    CHECK(mean[0] > 0.35 && mean[0] < 0.75, "a white room has a mean of %.3f", mean[0]);
    CHECK(mean[3] < 0.15, "a dark room has a mean of %.3f", mean[3]);
}

/* Highlights lower the exposure by at most 1.5 stops. The field `exposure` is added to the automatic exposure. */
TEST(highlights_limit_the_exposure) {
    double mean, hidden = metered(0.8f, 1, -3, &mean), seen = metered(0.8f, 1, 3, &mean),
        glaring = metered(0.8f, 1, 1e6f, &mean);
    printf("  %.2f stops, %.2f if the window is seen, %.2f if it glares\n", hidden, seen, glaring);
    CHECK(seen < hidden - 0.5 && seen > hidden - 1.55 && seen > glaring - 5, "a window changes %.2f stops to %.2f",
          hidden, seen);
    CHECK(fabs(glaring) < 100 && mean > 0, "%g stops", glaring);
}

int main(void) {
    if (sbl_create(NULL, &context) != SBL_SUCCESS) { printf("no context\n0 passed, 1 failed, 0 skipped\n"); return 1; }
    RUN(tones_are_their_formulas);
    RUN(agx_of_grey);
    RUN(other_channels_stay_as_they_are);
    RUN(edges_of_lamps_are_smooth);
    RUN(edges_show_the_light_at_samples);
    RUN(a_backdrop_is_behind_objects);
    RUN(exposure_follows_the_light);
    RUN(highlights_limit_the_exposure);
    sbl_destroy(context);
    return test_report();
}
