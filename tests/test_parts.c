/* Tests of windows of a picture: a window shows the same as the complete picture, and the light of adjacent windows has
   no visible steps. */
#include "../sbl.h"
#include "support/test.h"
#include "support/scenes.h"
#include "support/gl_watch.h"

enum { WIDTH = 150, HEIGHT = 101, PIXELS = WIDTH * HEIGHT, WINDOWS = 7 };

/* x, y, width and height: corners, one pixel, odd positions, a complete row and the complete picture */
static const int windows[WINDOWS][4] = { { 0, 0, 40, 30 }, { 109, 70, 41, 31 }, { 75, 50, 1, 1 }, { 17, 13, 61, 37 },
                                         { 0, 57, WIDTH, 2 }, { 149, 0, 1, HEIGHT }, { 0, 0, WIDTH, HEIGHT } };
static watch seen;
static sbl_context *context;
static test_scene cornell;
static float whole[3 * PIXELS], part[3 * PIXELS], again[3 * PIXELS];

static sbl_picture_desc cornell_view(sbl_mode mode) {
    sbl_picture_desc view = scene_cornell_view(WIDTH, HEIGHT);
    sbl_perspective(view.view_to_clip, 50, (float)WIDTH / HEIGHT);
    view.options.mode = mode;
    return view;
}

static void set_window(sbl_picture_desc *view, const int window[4]) {
    memcpy(view->window, window, sizeof view->window);
}

/* Selects quarter k of the picture. w: receives the window */
static void set_quarter(sbl_picture_desc *view, int k, int w[4]) {
    w[0] = k % 2 * 80;
    w[1] = k / 2 * 48;
    w[2] = k % 2 ? WIDTH - 80 : 80;
    w[3] = k / 2 ? HEIGHT - 48 : 48;
    set_window(view, w);
}

/* Renders a picture, and reads a channel of `pixels` pixels. Returns 0 and reports a test failure if this is not
   possible. */
static int make(const sbl_picture_desc *view, sbl_channel channel, float *out, int pixels) {
    const size_t floats = (size_t)(pixels * sbl_channel_components(channel));
    const int made = sbl_render_picture(context, view) == SBL_SUCCESS &&
                     sbl_read_channel(context, channel, out, floats) == SBL_SUCCESS;
    CHECK(made, "%s", watch_last(&seen));
    return made;
}

/* Returns the number of pixels of a window whose floats differ from those of the complete picture by more than
   `most`. */
static int differing(const int w[4], int components, double most) {
    int x, y, c, count = 0;
    for (y = 0; y < w[3]; y++)
        for (x = 0; x < w[2]; x++) {
            int off = 0;
            for (c = 0; c < components; c++) {
                const double a = (double)part[components * (y * w[2] + x) + c];
                const double b = (double)whole[components * ((w[1] + y) * WIDTH + w[0] + x) + c];
                off |= !(fabs(a - b) <= most);
            }
            count += off;
        }
    return count;
}

/* A window with the size of the picture has the same bits as the picture. */
TEST(the_whole_is_a_window) {
    static const sbl_channel channels[3] = { SBL_CHANNEL_FINAL, SBL_CHANNEL_RADIANCE, SBL_CHANNEL_POSITION };
    int i;
    for (i = 0; i < 3; i++) {
        sbl_picture_desc view = cornell_view(SBL_MODE_DIRECT);
        if (!make(&view, channels[i], whole, PIXELS)) return;
        set_window(&view, windows[WINDOWS - 1]);
        if (!make(&view, channels[i], part, PIXELS)) return;
        CHECK(!memcmp(whole, part, sizeof whole), "channel %d differs", (int)channels[i]);
    }
}

/* Channels of surfaces are the same in a window and in the complete picture: for a perspective projection, for one with
   a shifted centre, and for an orthographic projection. */
TEST(windows_show_the_same_surfaces) {
    static const struct { sbl_channel channel; double most; } cases[5] = {
        { SBL_CHANNEL_POSITION, 0.05 }, { SBL_CHANNEL_NORMAL, 1e-4 }, { SBL_CHANNEL_ALBEDO, 1e-3 },
        { SBL_CHANNEL_DEPTH, 0.05 }, { SBL_CHANNEL_ID, 0 } };
    int i, k, n;
    for (n = 0; n < 3; n++)
        for (i = 0; i < 5; i++) {
            const int components = sbl_channel_components(cases[i].channel);
            sbl_picture_desc view = cornell_view(SBL_MODE_DIRECT);
            view.target_error = 1;
            view.options.preset = SBL_PRESET_DRAFT;
            if (n == 1) { view.view_to_clip[8] = 0.3f; view.view_to_clip[9] = -0.2f; }
            if (n == 2) {
                memset(view.view_to_clip, 0, sizeof view.view_to_clip);
                view.view_to_clip[0] = 1 / 500.0f;
                view.view_to_clip[5] = 1 / 330.0f;
                view.view_to_clip[10] = -1e-4f;
                view.view_to_clip[12] = 0.1f;
                view.view_to_clip[15] = 1;
            }
            if (!make(&view, cases[i].channel, whole, PIXELS)) return;
            for (k = 0; k < WINDOWS; k++) {
                const int pixels = windows[k][2] * windows[k][3];
                int count;
                set_window(&view, windows[k]);
                if (!make(&view, cases[i].channel, part, pixels)) return;
                count = differing(windows[k], components, cases[i].most);
                CHECK(count <= pixels / 100, "projection %d, channel %d, window %d: %d of %d pixels differ", n,
                      (int)cases[i].channel, k, count, pixels);
            }
        }
}

/* A sensor has the same ray directions in a window and in the complete picture; therefore both have the same noise. */
TEST(sensors_look_the_same_way) {
    int k;
    sbl_picture_desc view = scene_plain(cornell_view(SBL_MODE_DIRECT), SBL_MODE_AMBIENT, 0);
    view.options.rays = 16;
    view.options.epsilon = 1;
    if (!make(&view, SBL_CHANNEL_RADIANCE, whole, PIXELS)) return;
    for (k = 0; k < WINDOWS; k++) {
        const int pixels = windows[k][2] * windows[k][3];
        int count;
        set_window(&view, windows[k]);
        if (!make(&view, SBL_CHANNEL_RADIANCE, part, pixels)) return;
        count = differing(windows[k], 3, 1e-3);
        CHECK(count <= pixels / 20, "window %d: %d of %d pixels differ", k, count, pixels);
    }
}

/* Sensors of the first level are at the same pixels in a window and in the complete picture. */
TEST(first_sensors_stand_at_the_same_pixels) {
    sbl_picture_desc view = cornell_view(SBL_MODE_DIRECT);
    int k;
    view.threshold = 1e6f;  /* no difference is large enough to refine */
    if (!make(&view, SBL_CHANNEL_SENSORS, whole, PIXELS)) return;
    for (k = 0; k < WINDOWS; k++) {
        const int *w = windows[k];
        int x, y, wrong = 0, first = 0;
        set_window(&view, w);
        if (!make(&view, SBL_CHANNEL_SENSORS, part, w[2] * w[3])) return;
        for (y = 0; y < w[3]; y++)
            for (x = 0; x < w[2]; x++) {
                const int here = part[y * w[2] + x] > 0 && part[y * w[2] + x] < 2;
                const int there = whole[(w[1] + y) * WIDTH + w[0] + x] > 0 && whole[(w[1] + y) * WIDTH + w[0] + x] < 2;
                wrong += here != there;
                first += there;
            }
        CHECK(wrong == 0, "window %d: %d of %d pixels have a first sensor here only or there only", k, wrong, first);
    }
}

/* border_step returns the mean absolute difference of R between pixels on both sides of the borders of a grid of
   windows, in pictures of SIDE x SIDE. */
enum { SIDE = 128, ACROSS = 4, PART = SIDE / ACROSS };
static double border_step(const float *rgb) {
    double sum = 0;
    int i, k;
    for (i = PART; i < SIDE; i += PART)
        for (k = 0; k < SIDE; k++) {
            sum += fabs((double)rgb[3 * (k * SIDE + i) + 1] - (double)rgb[3 * (k * SIDE + i - 1) + 1]);
            sum += fabs((double)rgb[3 * (i * SIDE + k) + 1] - (double)rgb[3 * ((i - 1) * SIDE + k) + 1]);
        }
    return sum / (2 * SIDE * (ACROSS - 1));
}

/* Sixteen windows that use the mean radiance of a preview form the complete picture. Its error is the requested one,
   and the steps across window borders are no larger than in the complete picture at the same places. */
static void assembled(sbl_mode mode, double target, double most) {
    static float picture[3 * SIDE * SIDE], window[3 * PART * PART], one[3 * SIDE * SIDE];
    static float ids[SIDE * SIDE], part_ids[SIDE * SIDE];
    sbl_picture_desc view = scene_cornell_view(SIDE, SIDE), small = scene_cornell_view(SIDE / 2, SIDE / 2);
    double squares = 0, mean = 0, step, expected2 = 0;
    sbl_stats stats;
    int i, y, count = 0;
    view.options.mode = small.options.mode = mode;
    view.target_error = (float)target;
    view.options.preset = small.options.preset = SBL_PRESET_DRAFT;
    if (!make(&small, SBL_CHANNEL_RADIANCE, one, SIDE * SIDE / 4)) return;
    memcpy(view.mean_radiance, sbl_query_stats(context).picture.mean_radiance, sizeof view.mean_radiance);
    if (!make(&view, SBL_CHANNEL_RADIANCE, one, SIDE * SIDE)) return;
    CHECK(sbl_read_channel(context, SBL_CHANNEL_ID, ids, SIDE * SIDE) == SBL_SUCCESS, "%s", watch_last(&seen));
    for (i = 0; i < ACROSS * ACROSS; i++) {
        const int at[4] = { i % ACROSS * PART, i / ACROSS * PART, PART, PART };
        set_window(&view, at);
        if (!make(&view, SBL_CHANNEL_RADIANCE, window, PART * PART)) return;
        for (y = 0; y < PART; y++)
            memcpy(picture + 3 * ((at[1] + y) * SIDE + at[0]), window + 3 * PART * y, sizeof(float) * 3 * PART);
        CHECK(sbl_read_channel(context, SBL_CHANNEL_ID, window, PART * PART) == SBL_SUCCESS, "%s", watch_last(&seen));
        for (y = 0; y < PART; y++)
            memcpy(part_ids + (at[1] + y) * SIDE + at[0], window + PART * y, sizeof(float) * PART);
        stats = sbl_query_stats(context);
        CHECK(stats.picture.width == PART && stats.picture.height == PART &&
              stats.picture.visible_pixels <= PART * PART, "window %d: %d x %d, %d visible", i, stats.picture.width,
              stats.picture.height, stats.picture.visible_pixels);
        CHECK((double)stats.picture.expected_error <= 1.05 * target || mode == SBL_MODE_GI, "window %d: expected %.4f",
              i, (double)stats.picture.expected_error);
        expected2 += pow((double)stats.picture.expected_error, 2) / (ACROSS * ACROSS);
    }
    for (i = 0; i < SIDE * SIDE; i++) {
        if (!(ids[i] > 0) || ids[i] < part_ids[i] || ids[i] > part_ids[i]) continue;  /* rounding moves edges */
        squares += pow((double)picture[3 * i + 1] - (double)one[3 * i + 1], 2);
        mean += (double)one[3 * i + 1];
        count++;
    }
    mean /= count;
    CHECK(sqrt(squares / count) <= 1.5 * target * mean, "rms difference %.4f of the mean, target %.4f",
          sqrt(squares / count) / mean, target);
    step = border_step(picture) / border_step(one);
    CHECK(step <= most, "steps across borders are %.3f times those of the whole picture", step);
    printf("  difference %.4f, target %.4f, expected %.4f, step %.3f\n", sqrt(squares / count) / mean, target,
           sqrt(expected2), step);
}

TEST(windows_make_the_picture) { assembled(SBL_MODE_DIRECT, 0.02, 1.05); }
TEST(windows_make_the_picture_with_bounces) { assembled(SBL_MODE_GI, 0.03, 1.1); }

/* target_error is relative to mean_radiance, which sbl_stats reports. If mean_radiance is not given, it is measured. */
TEST(errors_are_shares_of_the_given_mean) {
    sbl_picture_desc view = cornell_view(SBL_MODE_DIRECT);
    double mean[3] = { 0, 0, 0 };
    sbl_stats own, given;
    int i, c, lit = 0;
    view.target_error = 0.005f;
    if (!make(&view, SBL_CHANNEL_RADIANCE, whole, PIXELS)) return;
    own = sbl_query_stats(context);
    if (!make(&view, SBL_CHANNEL_ID, part, PIXELS)) return;
    for (i = 0; i < PIXELS; i++) {
        lit += part[i] > 0;
        for (c = 0; c < 3; c++) mean[c] += (double)whole[3 * i + c];
    }
    for (c = 0; c < 3; c++) {
        const double measured = (double)own.picture.mean_radiance[c];
        CHECK(fabs(measured / (mean[c] / lit) - 1) < 0.02, "channel %d: mean %g, but %g in R", c, measured,
              mean[c] / lit);
        view.mean_radiance[c] = 8 * own.picture.mean_radiance[c];
    }
    if (!make(&view, SBL_CHANNEL_RADIANCE, part, PIXELS)) return;
    given = sbl_query_stats(context);
    CHECK(!memcmp(given.picture.mean_radiance, view.mean_radiance, sizeof view.mean_radiance), "the mean is %g, not %g",
          (double)given.picture.mean_radiance[0], (double)view.mean_radiance[0]);
    CHECK(given.sensors.sites < own.sensors.sites && 8 * given.picture.expected_error > 3 * own.picture.expected_error,
          "%.0f sensors and an error of 8 * %.5f for a target 8 times as large, %.0f and %.5f without",
          (double)given.sensors.sites, (double)given.picture.expected_error, (double)own.sensors.sites,
          (double)own.picture.expected_error);
    CHECK(given.picture.expected_error < view.target_error && own.picture.expected_error < view.target_error,
          "expected errors %.4f and %.4f", (double)given.picture.expected_error, (double)own.picture.expected_error);
}

/* The margin of a window is not refined: small windows with wide margins have few sensors. The margins on all sides of
   one of these windows show edges of the boxes. */
TEST(margins_are_not_refined) {
    static const int places[4][4] = { { 108, 44, 12, 12 }, { 36, 44, 12, 12 }, { 70, 76, 12, 12 }, { 70, 26, 12, 12 } };
    int i;
    for (i = 0; i < 4; i++) {
        sbl_picture_desc view = cornell_view(SBL_MODE_DIRECT);
        sbl_stats stats;
        view.filter_radius = -1;
        view.tile = 64;
        set_window(&view, places[i]);
        if (!make(&view, SBL_CHANNEL_SENSORS, part, 12 * 12)) return;
        stats = sbl_query_stats(context);
        CHECK(stats.sensors.sites <= 200, "window %d: %.0f sensors for 16 x 16 pixels", i,
              (double)stats.sensors.sites);
    }
}

/* A window has the same bits if it is made again after another window, in short time slices, or in a new context. */
TEST(windows_do_not_depend_on_each_other) {
    const int *w = windows[3];
    const int pixels = w[2] * w[3];
    sbl_picture_desc view = cornell_view(SBL_MODE_GI);
    const sbl_context_desc desc = watch_desc(&seen);
    const sbl_scene_desc scene = scene_desc(&cornell);
    sbl_context *fresh;
    sbl_result result;
    view.options.preset = SBL_PRESET_DRAFT;
    set_window(&view, w);
    if (!make(&view, SBL_CHANNEL_FINAL, part, pixels)) return;
    set_window(&view, windows[0]);
    if (!make(&view, SBL_CHANNEL_FINAL, again, windows[0][2] * windows[0][3])) return;
    set_window(&view, w);
    REQUIRE(sbl_begin_picture(context, &view) == SBL_SUCCESS, "%s", watch_last(&seen));
    do result = sbl_step(context, 1e-4);
    while (result == SBL_UNFINISHED);
    CHECK(result == SBL_SUCCESS && sbl_read_channel(context, SBL_CHANNEL_FINAL, again, (size_t)(3 * pixels)) ==
          SBL_SUCCESS, "%s", watch_last(&seen));
    CHECK(!memcmp(part, again, sizeof(float) * 3 * (size_t)pixels), "the window has changed");
    memset(again, 0, sizeof again);
    REQUIRE(sbl_create(&desc, &fresh) == SBL_SUCCESS, "no second context");
    CHECK(sbl_set_scene(fresh, &scene) == SBL_SUCCESS && sbl_render_picture(fresh, &view) == SBL_SUCCESS &&
          sbl_read_channel(fresh, SBL_CHANNEL_FINAL, again, (size_t)(3 * pixels)) == SBL_SUCCESS, "%s",
          watch_last(&seen));
    CHECK(!memcmp(part, again, sizeof(float) * 3 * (size_t)pixels), "the window differs in a new context");
    sbl_destroy(fresh);
}

/* The sensor of a pixel that is inspected in a window equals the one in the complete picture. */
TEST(sensors_of_windows_are_inspected) {
    sbl_picture_desc view = scene_plain(cornell_view(SBL_MODE_DIRECT), SBL_MODE_DIRECT, 0);
    static sbl_sensor sensor, expected;
    int k;
    REQUIRE(sbl_render_picture(context, &view) == SBL_SUCCESS &&
            sbl_inspect_sensor(context, 60, 40, &expected, NULL, NULL, 0) == SBL_SUCCESS, "%s", watch_last(&seen));
    set_window(&view, windows[3]);
    REQUIRE(sbl_render_picture(context, &view) == SBL_SUCCESS &&
            sbl_inspect_sensor(context, 43, 27, &sensor, NULL, NULL, 0) == SBL_SUCCESS, "%s", watch_last(&seen));
    for (k = 0; k < 3; k++)
        CHECK(fabs((double)sensor.site.position[k] - (double)expected.site.position[k]) < 0.01 &&
              fabs((double)sensor.radiance[k] - (double)expected.radiance[k]) < 1e-3, "axis %d: %g %g, R %g %g", k,
              (double)sensor.site.position[k], (double)expected.site.position[k], (double)sensor.radiance[k],
              (double)expected.radiance[k]);
    CHECK(sbl_inspect_sensor(context, 61, 0, &sensor, NULL, NULL, 0) == SBL_ERROR_INVALID_ARGUMENT,
          "a pixel outside of the window is inspected");
}

/* In a window of the channel display, the backdrop is the part of that of the complete picture, and the given exposure
   is used. */
TEST(backdrops_of_windows_fit) {
    sbl_picture_desc view = cornell_view(SBL_MODE_DIRECT);
    int k;
    sbl_look_at(view.world_to_view, 278, 273, -3000, 278, 273, 0, 0, 1, 0);  /* nothing is around the box */
    for (k = 0; k < 3; k++) view.backdrop[k] = 0.5f;
    view.tone = SBL_TONE_NEUTRAL;
    view.target_error = 0.2f;
    view.samples = 1;
    if (!make(&view, SBL_CHANNEL_DISPLAY, whole, PIXELS)) return;
    for (k = 0; k < 2; k++) {
        set_window(&view, windows[k]);
        if (!make(&view, SBL_CHANNEL_DISPLAY, part, windows[k][2] * windows[k][3])) return;
        CHECK(part[0] > 0.1f && differing(windows[k], 3, 1e-3) <= 2, "window %d: %d pixels differ", k,
              differing(windows[k], 3, 1e-3));
    }
}

/* A window measures the exposure from its own pixels, which show a wall. The lamp outside the window does not count. */
TEST(windows_measure_their_own_exposure) {
    static const int below[4] = { 64, 33, 24, 8 };
    sbl_picture_desc view = cornell_view(SBL_MODE_DIRECT);
    double light = 0, stops;
    int i, pixels = below[2] * below[3];
    view.tone = SBL_TONE_NEUTRAL;
    view.auto_exposure = 1;
    set_window(&view, below);
    if (!make(&view, SBL_CHANNEL_RADIANCE, part, pixels)) return;
    stops = (double)sbl_query_stats(context).picture.exposure;
    for (i = 0; i < pixels; i++) {
        const double r = (double)part[3 * i], g = (double)part[3 * i + 1], b = (double)part[3 * i + 2];
        light += log2(0.2126 * r + 0.7152 * g + 0.0722 * b) / pixels;
    }
    CHECK(fabs(stops - (-0.5 - light)) < 0.25, "%.3f stops, log2 of the mean R %.3f", stops, light);
}

TEST(wrong_windows_are_refused) {
    static const int wrong[9][4] = { { 0, 0, 0, 5 }, { 0, 0, 5, 0 }, { -1, 0, 5, 5 }, { 0, -1, 5, 5 }, { 1, 0, 0, 0 },
        { 146, 0, 5, 5 }, { 0, 97, 5, 5 }, { 0, 0, -5, 5 }, { 2147483647, 1, 2147483647, 1 } };
    sbl_picture_desc view = cornell_view(SBL_MODE_DIRECT);
    int i;
    for (i = 0; i < 9; i++) {
        set_window(&view, wrong[i]);
        watch_forget(&seen);
        CHECK(sbl_begin_picture(context, &view) == SBL_ERROR_INVALID_ARGUMENT &&
              watch_said(&seen, SBL_LOG_ERROR, SBL_LOG_ITEM_INVALID_PICTURE_DESC, "window", "150 x 101", ""),
              "window %d: %s", i, watch_last(&seen));
    }
    memset(view.window, 0, sizeof view.window);
    view.mean_radiance[1] = -1;
    CHECK(sbl_begin_picture(context, &view) == SBL_ERROR_INVALID_ARGUMENT, "a negative mean is accepted");
    view.mean_radiance[1] = (float)NAN;
    CHECK(sbl_begin_picture(context, &view) == SBL_ERROR_INVALID_ARGUMENT, "a mean that is no number is accepted");
    for (i = 0; i < 4; i++) {
        static const int rays[4] = { 8, 48, -256, -2147483647 - 1 };
        view = cornell_view(SBL_MODE_DIRECT);
        view.look_rays = rays[i];
        CHECK(sbl_begin_picture(context, &view) == SBL_ERROR_INVALID_ARGUMENT && strstr(watch_last(&seen), "look_rays"),
              "%d rays per look: %s", rays[i], watch_last(&seen));
    }
}

/* Makes the four quarters of the picture. looks: receives the total number of their looks. Returns the RMS of their
   predicted errors. */
static double make_quarters(sbl_picture_desc view, double *looks) {
    double sum = 0, pixels = 0;
    int i, k;
    *looks = 0;
    for (k = 0; k < 4; k++) {
        sbl_stats s;
        int w[4];
        set_quarter(&view, k, w);
        if (!make(&view, SBL_CHANNEL_LOOKS, part, w[2] * w[3])) return 0;
        for (i = 0; i < w[2] * w[3]; i++) *looks += (double)part[i];
        s = sbl_query_stats(context);
        sum += pow((double)s.picture.expected_error, 2) * s.picture.visible_pixels;
        pixels += s.picture.visible_pixels;
    }
    return sqrt(sum / pixels);
}

/* Windows with the price of the complete picture take about as many looks in total as the complete picture, and have
   its error. A lower price takes more looks and a higher price fewer, whatever the target error is. Windows without a
   price reach the target error each. */
TEST(windows_share_a_price) {
    sbl_picture_desc view = cornell_view(SBL_MODE_DIRECT);
    double all = 0, looks[4], error[4];
    sbl_stats s;
    int i;
    view.target_error = 0.01f;
    if (!make(&view, SBL_CHANNEL_LOOKS, whole, PIXELS)) return;
    for (i = 0; i < PIXELS; i++) all += (double)whole[i];
    s = sbl_query_stats(context);
    CHECK(s.picture.price > 0, "there is no price");
    memcpy(view.mean_radiance, s.picture.mean_radiance, sizeof view.mean_radiance);
    for (i = 0; i < 4; i++) {
        view.price = i < 3 ? s.picture.price * (float)pow(16, i - 1) : 0;
        error[i] = make_quarters(view, &looks[i]);
    }
    CHECK(looks[1] > 0.85 * all && looks[1] < 1.2 * all, "%g looks in windows, %g in the whole", looks[1], all);
    CHECK(error[1] < 0.012 && error[1] > 0.007, "predicted error %g", error[1]);
    CHECK(looks[0] > 1.3 * looks[1] && looks[2] < 0.8 * looks[1] && error[0] < error[1] && error[1] < error[2],
          "looks %g %g %g, errors %g %g %g", looks[0], looks[1], looks[2], error[0], error[1], error[2]);
    CHECK(error[3] < 0.0105, "predicted error %g without a price", error[3]);
    view.target_error = 0.1f;
    view.price = s.picture.price;
    error[2] = make_quarters(view, &looks[2]);
    CHECK(looks[2] > 0.7 * looks[1], "with a larger target error %g looks, before %g", looks[2], looks[1]);
    view.price = -1;
    CHECK(sbl_begin_picture(context, &view) == SBL_ERROR_INVALID_ARGUMENT, "a negative price is accepted");
    view.price = (float)NAN;
    CHECK(sbl_begin_picture(context, &view) == SBL_ERROR_INVALID_ARGUMENT, "a price that is no number is accepted");
}

/* Returns the share of the sensors that are in a window alone, in the complete picture alone, or that have a different
   number of looks there, over pixels that are less than `within` pixels from a border between the quarters of
   make_quarters. part, whole: SBL_CHANNEL_LOOKS */
static double changed_sensors(const int w[4], int within, int *changed, int *all) {
    int x, y;
    for (y = 0; y < w[3]; y++)
        for (x = 0; x < w[2]; x++) {
            const float here = part[y * w[2] + x], there = whole[(w[1] + y) * WIDTH + w[0] + x];
            const int right = w[0] + x - 80, below = w[1] + y - 48;
            if ((right < -within || right >= within) && (below < -within || below >= within)) continue;
            *all += here > 0 || there > 0;
            *changed += here < there || here > there;
        }
    return (double)*changed / *all;
}

/* Renders the complete picture into `whole` with the mean, price and rays that it has without a price. view: receives
   these three. Returns 0 like make. */
static int make_with_own_price(sbl_picture_desc *view, sbl_channel channel) {
    sbl_stats s;
    if (!make(view, channel, whole, PIXELS)) return 0;
    s = sbl_query_stats(context);
    memcpy(view->mean_radiance, s.picture.mean_radiance, sizeof view->mean_radiance);
    view->look_rays = s.picture.look_rays;
    view->price = s.picture.price;
    return make(view, channel, whole, PIXELS);
}

/* Windows with one price take the sensors and looks of the complete picture with this price, also at their borders. The
   light of few rays is noisy in the second case. */
TEST(windows_take_the_sensors_of_the_whole) {
    static const struct { sbl_mode mode; float error; int within; double most; } cases[2] = {
        { SBL_MODE_DIRECT, 0.01f, 6, 0.0015 }, { SBL_MODE_GI, 0.03f, 1000, 0.01 } };
    int i, k;
    for (i = 0; i < 2; i++) {
        sbl_picture_desc view = cornell_view(cases[i].mode);
        int changed = 0, all = 0;
        double share = 1;
        view.target_error = cases[i].error;
        view.options.preset = SBL_PRESET_DRAFT;
        if (!make_with_own_price(&view, SBL_CHANNEL_LOOKS)) return;
        for (k = 0; k < 4; k++) {
            int w[4];
            set_quarter(&view, k, w);
            if (!make(&view, SBL_CHANNEL_LOOKS, part, w[2] * w[3])) return;
            share = changed_sensors(w, cases[i].within, &changed, &all);
        }
        CHECK(share <= cases[i].most, "%.2f %% of %d sensors differ", 100 * share, all);
        printf("  %.2f %% of %d sensors differ\n", 100 * share, all);
    }
}

/* The light of windows with one price has the bits of the light of the complete picture with this price, at nearly all
   pixels: the surface points are the same, and so are the sensors around the windows. */
TEST(windows_have_the_light_of_the_whole) {
    sbl_picture_desc view = cornell_view(SBL_MODE_DIRECT);
    int k, count = 0;
    view.target_error = 0.003f;
    if (!make_with_own_price(&view, SBL_CHANNEL_RADIANCE)) return;
    for (k = 0; k < 4; k++) {
        int w[4];
        set_quarter(&view, k, w);
        if (!make(&view, SBL_CHANNEL_RADIANCE, part, w[2] * w[3])) return;
        count += differing(w, 3, 0);
    }
    printf("  %.2f %% of the pixels differ\n", 100.0 * count / PIXELS);
    CHECK(count <= PIXELS / 5000, "%d of %d pixels differ", count, PIXELS);
}

/* SBL_CHANNEL_WORK counts looks and, if the host asks for it, the steps that rays take, here those to the lamp: more
   where the room is crowded. It is the same again, and measuring it does not change the light visibly. */
TEST(work_is_measured) {
    sbl_picture_desc view = cornell_view(SBL_MODE_DIRECT);
    static float looks[PIXELS];
    double off = 0, mean = 0, least = 1e30, most = 0, later = 0;
    int i, many = 0;
    view.target_error = 0.01f;
    if (!make(&view, SBL_CHANNEL_LOOKS, looks, PIXELS) || !make(&view, SBL_CHANNEL_WORK, part, PIXELS)) return;
    CHECK(memcmp(looks, part, sizeof looks) == 0, "without measure_work, the work is not the number of looks");
    if (!make(&view, SBL_CHANNEL_RADIANCE, whole, PIXELS)) return;
    view.measure_work = 1;
    if (!make(&view, SBL_CHANNEL_RADIANCE, part, PIXELS)) return;
    for (i = 0; i < 3 * PIXELS; i++) {
        off += fabs((double)part[i] - (double)whole[i]);
        mean += (double)whole[i];
    }
    CHECK(off < 0.005 * mean, "R changes by %g of its mean", off / mean);
    if (!make(&view, SBL_CHANNEL_LOOKS, looks, PIXELS) || !make(&view, SBL_CHANNEL_WORK, part, PIXELS) ||
        !make(&view, SBL_CHANNEL_WORK, again, PIXELS)) return;
    CHECK(memcmp(part, again, PIXELS * sizeof *part) == 0, "the work differs from time to time");
    for (i = 0; i < PIXELS; i++) {
        const double steps = looks[i] > 0 ? (double)part[i] / (double)looks[i] - 1 : 0;
        CHECK(looks[i] > 0 ? steps >= 0 : part[i] == 0.0f, "pixel %d: %g looks, work %g", i, (double)looks[i],
              (double)part[i]);
        if (looks[i] > 0) least = fmin(least, steps);
        most = fmax(most, steps);
        if (looks[i] >= 4) later += steps, many++;
    }
    CHECK(most > 2 && most > 2 * least, "steps per look from %g to %g", least, most);
    /* without a sky, later looks only trace rays to lamps */
    CHECK(many > 0 && later > 5 * many, "%d sensors with many looks take %g steps per look", many, later / many);
}

int main(void) {
    const sbl_context_desc desc = watch_desc(&seen);
    sbl_scene_desc scene;
    if (sbl_create(&desc, &context) != SBL_SUCCESS) return 1;
    scene_cornell_box(&cornell);
    scene = scene_desc(&cornell);
    if (sbl_set_scene(context, &scene) != SBL_SUCCESS) return 1;
    RUN(the_whole_is_a_window);
    RUN(windows_show_the_same_surfaces);
    RUN(sensors_look_the_same_way);
    RUN(first_sensors_stand_at_the_same_pixels);
    RUN(windows_make_the_picture);
    RUN(windows_make_the_picture_with_bounces);
    RUN(errors_are_shares_of_the_given_mean);
    RUN(margins_are_not_refined);
    RUN(windows_do_not_depend_on_each_other);
    RUN(sensors_of_windows_are_inspected);
    RUN(backdrops_of_windows_fit);
    RUN(windows_measure_their_own_exposure);
    RUN(wrong_windows_are_refused);
    RUN(windows_share_a_price);
    RUN(windows_take_the_sensors_of_the_whole);
    RUN(windows_have_the_light_of_the_whole);
    RUN(work_is_measured);
    sbl_destroy(context);
    scene_free(&cornell);
    return test_report();
}
