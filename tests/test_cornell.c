/* Measures the error in the Cornell box at 512 x 512, with sensors at every pixel and with default settings. It must
   agree with examples/MEASUREMENTS.md, and the default must put sensors at no more than a fifth of the pixels. The
   reference is the closed form of the lamp times its visibility, from the ray caster. Sensors at all 262,144 pixels
   would take minutes on a software renderer, so the test renders windows spread over the picture: crops of the same
   camera with the same pixels. */
#include "../sbl.h"
#include "support/test.h"
#include "support/scenes.h"
#include "support/reference.h"

static sbl_context *context;

/* WINDOWS x WINDOWS windows; pixels at their border are ignored, because they lack neighbours for the filter */
enum { SIZE = 512, WINDOW = 40, WINDOWS = 4, BORDER = 2 };
/* a sensor at every pixel; the same without a filter; the same rasterised, in every fifth window */
enum { FILTERED, PLAIN, RASTER, WAYS };

/* Returns the view of the part of the picture that starts at the pixel (x, y). */
static sbl_picture_desc window_of(sbl_picture_desc view, int x, int y, int size) {
    double scale_x = (double)view.width / size, scale_y = (double)view.height / size;
    double centre_x = (2.0 * x + size) / view.width - 1, centre_y = 1 - (2.0 * y + size) / view.height;
    float *m = view.view_to_clip;
    int k;
    for (k = 0; k < 4; k++) {
        m[4 * k] = (float)(scale_x * ((double)m[4 * k] - centre_x * (double)m[4 * k + 3]));
        m[4 * k + 1] = (float)(scale_y * ((double)m[4 * k + 1] - centre_y * (double)m[4 * k + 3]));
    }
    view.width = view.height = size;
    return view;
}

typedef struct tally { double squares, sum, expected_sum; int count; } tally;

static void tally_add(tally *t, double r, double expected) {
    t->squares += (r - expected) * (r - expected);
    t->sum += r;
    t->expected_sum += expected;
    t->count++;
}

static double tally_error(const tally *t) { return sqrt(t->squares / t->count) / (t->expected_sum / t->count); }
static double tally_bias(const tally *t) { return t->sum / t->expected_sum - 1; }

/* Checks that the predicted error is at most the target error, and agrees with the errors predicted for the pixels. */
static void check_prediction(const sbl_picture_desc *view, const sbl_stats *stats, const float *radiance) {
    float *error = scene_channel(context, view, SBL_CHANNEL_ERROR), *id = scene_channel(context, view, SBL_CHANNEL_ID);
    double squares = 0, sum = 0;
    int i, wrong = 0;
    for (i = 0; i < SIZE * SIZE; i++) {
        wrong += id[i] != 0 ? !(error[i] >= 0 && error[i] < 1) : error[i] != 0;
        squares += (double)error[i] * (double)error[i];
        sum += 0.2126 * (double)radiance[3 * i] + 0.7152 * (double)radiance[3 * i + 1] + 0.0722 *
            (double)radiance[3 * i + 2];
    }
    squares = sqrt(squares * stats->picture.visible_pixels) / sum;
    printf("  target error %.3f %%, predicted %.3f %%, by pixels %.3f %%\n", 100 * (double)stats->picture.target_error,
           100 * (double)stats->picture.expected_error, 100 * squares);
    CHECK(wrong == 0, "%d pixels have an invalid error", wrong);
    CHECK(stats->picture.target_error == view->target_error &&
              stats->picture.expected_error <= stats->picture.target_error &&
              stats->picture.expected_error > 0.5f * stats->picture.target_error,
          "target error %g, but %g is predicted", (double)stats->picture.target_error,
          (double)stats->picture.expected_error);
    CHECK(squares > 0.8 * (double)stats->picture.expected_error &&
              squares < 1.2 * (double)stats->picture.expected_error,
          "the errors of the pixels combine to %.3f %%", 100 * squares);
    free(error);
    free(id);
}

/* With default settings, few pixels have sensors, and R has the predicted error, which is at most the target. */
TEST(refinement_on_the_cornell_box) {
    test_scene s = { 0 };
    sbl_scene_desc desc;
    ref_scene *reference;
    sbl_picture_desc view = scene_cornell_view(SIZE, SIZE);
    static const double most_error[WAYS] = { 0.0048, 0.0048, 0.0055 }, most_bias[WAYS] = { 0.0002, 0.0002, 0.0005 };
    static const char *const names[WAYS] = { "a sensor everywhere", "no filter", "rasterised" };
    tally tiled = { 0, 0, 0, 0 }, everywhere[WAYS], noise = { 0, 0, 0, 0 };
    float *radiance = NULL, *position = NULL;
    sbl_stats stats;
    v3 lamp[4];
    uint64_t seed = 1;
    double share, off;
    int n, i, k, x, y;
    memset(everywhere, 0, sizeof everywhere);
    scene_cornell_box(&s);
    desc = scene_desc(&s);
    reference = ref_create(&desc);
    for (i = 0; i < 4; i++) lamp[i] = v3_from((const float *)s.meshes[1].positions.data + 3 * i);
    view.options.mode = SBL_MODE_DIRECT;
    view.target_error = 0.004f;
    if (!scene_render(context, &s, &view)) goto done;
    stats = sbl_query_stats(context);
    radiance = scene_channel(context, &view, SBL_CHANNEL_RADIANCE);
    share = (double)stats.sensors.sites / stats.picture.visible_pixels;
    check_prediction(&view, &stats, radiance);
    for (n = 0; n < WINDOWS * WINDOWS; n++) {
        int x0 = 10 + n % WINDOWS * (SIZE - WINDOW - 20) / (WINDOWS - 1),
            y0 = 10 + n / WINDOWS * (SIZE - WINDOW - 20) / (WINDOWS - 1);
        sbl_picture_desc window = window_of(view, x0, y0, WINDOW);
        const int ways = n % 5 ? RASTER : WAYS;
        float *parts[WAYS];
        window.tile = 1;
        window.options.rays = 256;
        for (k = 0; k < ways; k++) {
            if (k != FILTERED) window.filter_radius = -1;
            if (k == RASTER) { window.options.backend = SBL_BACKEND_RASTER; window.options.sensor_size = 128; }
            if (!scene_render(context, &s, &window)) goto done;
            parts[k] = scene_channel(context, &window, SBL_CHANNEL_RADIANCE);
        }
        position = scene_channel(context, &window, SBL_CHANNEL_POSITION);
        for (y = BORDER; y < WINDOW - BORDER; y++)
            for (x = BORDER; x < WINDOW - BORDER; x++) {
                ref_point p = ref_pixel(reference, &view, x0 + x, y0 + y);
                double first, second, expected;
                if (!p.hit || p.mesh == 1 || ref_is_edge(reference, &view, x0 + x, y0 + y)) continue;
                CHECK(v3_length(v3_sub(v3_from(position + 3 * (y * WINDOW + x)), p.position)) < 0.05,
                      "the window differs from that part of the picture");
                first = (double)s.materials[3].emission[0] *
                    ref_quad_light(reference, p.position, p.normal, lamp, 1, 7, &seed);
                second = (double)s.materials[3].emission[0] *
                    ref_quad_light(reference, p.position, p.normal, lamp, 1, 7, &seed);
                expected = (first + second) / 2;
                tally_add(&noise, first, expected);
                tally_add(&tiled, (double)radiance[3 * ((y0 + y) * SIZE + x0 + x)], expected);
                for (k = 0; k < ways; k++) tally_add(&everywhere[k], (double)parts[k][3 * (y * WINDOW + x)], expected);
            }
        for (k = 0; k < ways; k++) free(parts[k]);
        free(position);
    }
    printf("  %.1f %% of the pixels sensed, %d compared; relative RMSE %.3f %%, bias %+.3f %%; reference %.3f %%\n",
           100 * share, tiled.count,
           100 * tally_error(&tiled), 100 * tally_bias(&tiled), 100 * tally_error(&noise));
    CHECK(tiled.count > 12000, "only %d pixels are compared", tiled.count);
    CHECK(tally_error(&noise) < 0.0045, "the reference is too noisy: %.2f %%", 100 * tally_error(&noise));
    CHECK(share <= 0.2, "%.1f %% of the pixels are sensed", 100 * share);
    off = sqrt(fmax(tally_error(&tiled) * tally_error(&tiled) - tally_error(&noise) * tally_error(&noise), 0));
    CHECK(off < 1.5 * (double)stats.picture.expected_error && off > 0.4 * (double)stats.picture.expected_error,
          "R is off by %.3f %%, but %.3f %% was predicted", 100 * off, 100 * (double)stats.picture.expected_error);
    CHECK(tally_error(&tiled) < 0.0052 && fabs(tally_bias(&tiled)) < 0.0005,
          "with default settings R is off by %.2f %%, bias %+.3f %%", 100 * tally_error(&tiled),
          100 * tally_bias(&tiled));
    for (k = 0; k < WAYS; k++) {
        printf("  %s: %.3f %%, %+.3f %%\n", names[k], 100 * tally_error(&everywhere[k]),
               100 * tally_bias(&everywhere[k]));
        CHECK(tally_error(&everywhere[k]) < most_error[k] && fabs(tally_bias(&everywhere[k])) < most_bias[k],
              "%s: R is off by %.2f %%, bias %+.3f %%",
              names[k], 100 * tally_error(&everywhere[k]), 100 * tally_bias(&everywhere[k]));
    }
done:
    free(radiance);
    ref_destroy(reference);
    scene_free(&s);
}

int main(void) {
    if (sbl_create(NULL, &context) != SBL_SUCCESS) { printf("no context\n0 passed, 1 failed, 0 skipped\n"); return 1; }
    RUN(refinement_on_the_cornell_box);
    sbl_destroy(context);
    return test_report();
}
