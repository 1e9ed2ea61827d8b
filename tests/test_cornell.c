/* Refinement earns its keep: on the Cornell box at 512 x 512 the default settings use at most a quarter of the pixels as sensors, and cost
   at most one percentage point of relative error over a sensor at every pixel.

   The reference is the lamp's closed form times its visibility, by the ray caster. A sensor at all 262,144 pixels would take minutes on
   a software renderer, so windows spread over the picture stand for it: crops of the same camera, pixel for pixel. */
#define SBL_IMPLEMENTATION
#define SBL_EGL
#include "../sbl.h"
#include "test.h"
#include "scenes.h"
#include "reference.h"

static sbl_context *context;

enum { SIZE = 512, WINDOW = 40, WINDOWS = 4, BORDER = 2 };  /* WINDOWS x WINDOWS of them; their border lacks the filter's neighbours */

/* The part of the picture that starts at pixel (x, y). */
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

TEST(refinement_on_the_cornell_box) {
    test_scene s = { 0 };
    sbl_scene_desc desc;
    ref_scene *reference;
    sbl_picture_desc view = scene_cornell_view(SIZE, SIZE);
    tally tiled = { 0, 0, 0, 0 }, everywhere = { 0, 0, 0, 0 }, noise = { 0, 0, 0, 0 };
    float *radiance = NULL, *position = NULL;
    sbl_stats stats;
    v3 lamp[4];
    uint64_t seed = 1;
    double share;
    int n, i, x, y;
    scene_cornell_box(&s);
    desc = scene_desc(&s);
    reference = ref_create(&desc);
    for (i = 0; i < 4; i++) lamp[i] = v3_from((const float *)s.meshes[1].positions.data + 3 * i);
    view.mode = SBL_MODE_DIRECT;
    if (!scene_render(context, &s, &view)) goto done;
    stats = sbl_query_stats(context);
    radiance = scene_channel(context, &view, SBL_CHANNEL_RADIANCE);
    share = (double)stats.sensors / stats.visible_pixels;
    for (n = 0; n < WINDOWS * WINDOWS; n++) {
        int x0 = 10 + n % WINDOWS * (SIZE - WINDOW - 20) / (WINDOWS - 1), y0 = 10 + n / WINDOWS * (SIZE - WINDOW - 20) / (WINDOWS - 1);
        sbl_picture_desc window = window_of(view, x0, y0, WINDOW);
        float *part;
        window.tile = 1;
        if (!scene_render(context, &s, &window)) break;
        part = scene_channel(context, &window, SBL_CHANNEL_RADIANCE);
        position = scene_channel(context, &window, SBL_CHANNEL_POSITION);
        for (y = BORDER; y < WINDOW - BORDER; y++)
            for (x = BORDER; x < WINDOW - BORDER; x++) {
                ref_point p = ref_pixel(reference, &view, x0 + x, y0 + y);
                double first, second, expected;
                if (!p.hit || p.mesh == 1 || ref_is_edge(reference, &view, x0 + x, y0 + y)) continue;
                CHECK(v3_length(v3_sub(v3_from(position + 3 * (y * WINDOW + x)), p.position)) < 0.05, "the window shows something else than the picture there");
                first = (double)s.materials[3].emission[0] * ref_quad_light(reference, p.position, p.normal, lamp, 1, 7, &seed);
                second = (double)s.materials[3].emission[0] * ref_quad_light(reference, p.position, p.normal, lamp, 1, 7, &seed);
                expected = (first + second) / 2;
                tally_add(&noise, first, expected);
                tally_add(&tiled, (double)radiance[3 * ((y0 + y) * SIZE + x0 + x)], expected);
                tally_add(&everywhere, (double)part[3 * (y * WINDOW + x)], expected);
            }
        free(part);
        free(position);
    }
    printf("  %.1f %% of the pixels sensed; relative RMSE %.2f %% with tiles, %.2f %% without, reference %.2f %%; bias %+.2f %% and %+.2f %%; %d pixels compared\n",
           100 * share, 100 * tally_error(&tiled), 100 * tally_error(&everywhere), 100 * tally_error(&noise),
           100 * (tiled.sum / tiled.expected_sum - 1), 100 * (everywhere.sum / everywhere.expected_sum - 1), tiled.count);
    CHECK(tiled.count > 12000, "only %d pixels are compared", tiled.count);
    CHECK(tally_error(&noise) < 0.006, "the reference is too noisy: %.2f %%", 100 * tally_error(&noise));
    CHECK(share <= 0.25, "%.1f %% of the pixels are sensed", 100 * share);
    CHECK(tally_error(&tiled) <= tally_error(&everywhere) + 0.01, "tiles cost %.2f percentage points", 100 * (tally_error(&tiled) - tally_error(&everywhere)));
    CHECK(tally_error(&everywhere) < 0.05, "without tiles R is off by %.2f %%", 100 * tally_error(&everywhere));
    CHECK(fabs(everywhere.sum / everywhere.expected_sum - 1) < 0.003, "without tiles R has a bias of %+.2f %%", 100 * (everywhere.sum / everywhere.expected_sum - 1));
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
