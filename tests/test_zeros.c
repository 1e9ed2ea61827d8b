/* Tests of the rule of zeros: zero in a field of a descriptor means its default, and a negative number means zero. The
   functions that fill in defaults keep this rule when they are applied again, and queries without a context return
   zeros. */
#include "../sbl.h"
#include "support/test.h"
#include "support/scenes.h"
#include "support/gl_watch.h"
#include "support/gl_scene.h"

static watch seen;
static sbl_context *context;

static sbl_options options_of(int mode, int preset, float epsilon) {
    sbl_options o;
    memset(&o, 0, sizeof o);
    o.mode = (sbl_mode)mode;
    o.preset = (sbl_preset)preset;
    o.epsilon = epsilon;
    return o;
}

/* Checks that filling in defaults twice gives the same as once. given: a descriptor; kept: a condition on d, the
   descriptor with its defaults */
#define TWICE(front_end, given, kept) do {                                                                      \
        const sbl_##front_end##_desc d = sbl_##front_end##_desc_defaults(&given);                               \
        const sbl_##front_end##_desc again = sbl_##front_end##_desc_defaults(&d);                               \
        CHECK(memcmp(&d, &again, sizeof d) == 0, #front_end ", mode %d, preset %d, sign %g: filling in twice "  \
              "changes it", mode, preset, (double)sign);                                                   \
        CHECK(kept, #front_end ", mode %d, preset %d: a negative number is replaced", mode, preset);          \
    } while (0)

/* Applies TWICE to all descriptors. sign: 0, or -1 for all fields in which a negative number means zero */
static void fill_twice(int mode, int preset, float sign) {
    const sbl_options options = options_of(mode, preset, sign);
    const int ambient = mode == SBL_MODE_AMBIENT || mode == SBL_MODE_PAPER, negative = sign < 0;
    sbl_picture_desc picture;
    sbl_readings_desc readings;
    sbl_lightmap_desc lightmap;
    sbl_vertices_desc vertices;
    sbl_probes_desc probes;
    memset(&picture, 0, sizeof picture);
    memset(&readings, 0, sizeof readings);
    memset(&lightmap, 0, sizeof lightmap);
    memset(&vertices, 0, sizeof vertices);
    memset(&probes, 0, sizeof probes);
    picture.options = readings.options = lightmap.options = vertices.options = probes.options = options;
    picture.threshold = picture.facet_limit = lightmap.threshold = lightmap.facet_limit = vertices.smoothing = sign;
    picture.filter_radius = lightmap.filter_radius = lightmap.gutter = lightmap.seams = (int)sign;
    probes.grid[0] = probes.grid[1] = probes.grid[2] = 3;
    TWICE(picture, picture, !negative || (d.threshold < 0 && d.facet_limit < 0 && d.filter_radius < 0 &&
                                          (!ambient || d.options.epsilon < 0)));
    TWICE(readings, readings, !negative || !ambient || d.options.epsilon < 0);
    TWICE(lightmap, lightmap, !negative || (d.threshold < 0 && d.facet_limit < 0 && d.filter_radius < 0 &&
                                            d.gutter < 0 && d.seams < 0 && (!ambient || d.options.epsilon < 0)));
    TWICE(vertices, vertices, !negative || (d.smoothing < 0 && (!ambient || d.options.epsilon < 0)));
    TWICE(probes, probes, d.probe_count == 27 && (!negative || !ambient || d.options.epsilon < 0));
}

/* Filling in defaults twice gives the same as once, for all kinds of work, modes and presets. */
TEST(defaults_are_idempotent) {
    sbl_context_desc once = sbl_context_desc_defaults(NULL), again = sbl_context_desc_defaults(&once);
    int mode, preset;
    CHECK(memcmp(&once, &again, sizeof once) == 0, "context: filling in defaults twice changes it");
    for (mode = 0; mode < SBL_MODE_COUNT; mode++)
        for (preset = 0; preset < SBL_PRESET_COUNT; preset++) {
            fill_twice(mode, preset, 0);
            fill_twice(mode, preset, -1);
        }
}

#define IS_ZERO(type, value) do {                                                \
        static const type none;                                                  \
        const type is = value;                                                   \
        CHECK(memcmp(&is, &none, sizeof is) == 0, #value " is not all zeroes");  \
    } while (0)

/* Queries of a NULL context return zeros. */
TEST(queries_without_a_context_are_zeroes) {
    IS_ZERO(sbl_context_desc, sbl_query_desc(NULL));
    IS_ZERO(sbl_capabilities, sbl_query_capabilities(NULL));
    IS_ZERO(sbl_stats, sbl_query_stats(NULL));
    /* not by memcmp, because the padding between its members may hold anything */
    CHECK(sbl_query_programs(NULL).compiled == 0 && sbl_query_programs(NULL).compile_seconds <= 0,
          "sbl_query_programs(NULL) is not all zeroes");
    IS_ZERO(sbl_memory, sbl_query_memory(NULL));
    IS_ZERO(sbl_bounds, sbl_query_bounds(NULL));
    CHECK(sbl_query_desc(context).sensor_texture_size == 2048, "sbl_query_desc of a context lacks its defaults");
}

/* A new context has neither a scene nor statistics, although it has tested the driver with a scene of its own. */
TEST(new_contexts_have_done_nothing) {
    sbl_context *own = NULL;
    REQUIRE(sbl_create(NULL, &own) == SBL_SUCCESS, "no context");
    IS_ZERO(sbl_stats, sbl_query_stats(own));
    IS_ZERO(sbl_bounds, sbl_query_bounds(own));
    sbl_destroy(own);
}

/* With a negative epsilon, SBL_MODE_AMBIENT equals SBL_MODE_DIRECT, to the bit. */
TEST(negative_epsilon_is_no_ambient_light) {
    static small_picture direct, none, usual;
    test_scene s;
    int way;
    small_scene(&s);
    for (way = 0; way < 2; way++) {
        const char *name = way ? "traced" : "drawn";
        sbl_scene_desc scene = scene_desc(&s);
        sbl_picture_desc view = small_view();
        view.options.backend = way ? SBL_BACKEND_TRACE : SBL_BACKEND_RASTER;
        view.options.seed = 7;
        REQUIRE(sbl_set_scene(context, &scene) == SBL_SUCCESS, "%s", watch_last(&seen));
        view.options.mode = SBL_MODE_DIRECT;
        REQUIRE(small_render(context, &view, &direct) == SBL_SUCCESS, "%s", watch_last(&seen));
        view.options.mode = SBL_MODE_AMBIENT;
        REQUIRE(small_render(context, &view, &usual) == SBL_SUCCESS, "%s", watch_last(&seen));
        view.options.epsilon = -0.5f;
        REQUIRE(small_render(context, &view, &none) == SBL_SUCCESS, "%s", watch_last(&seen));
        CHECK(small_same(&none, &direct), "%s: a negative epsilon differs from direct light", name);
        CHECK(!small_same(&usual, &direct), "%s: the default of epsilon gives no ambient light", name);
    }
    scene_free(&s);
}

/* Under a point light over a floor, R differs from pixel to pixel without noise. Therefore a negative threshold must
   place a sensor at almost every pixel. */
TEST(negative_threshold_refines_every_difference) {
    static const float thresholds[3] = { -1, 0, 1e6f };
    double share[3];
    int i;
    for (i = 0; i < 3; i++) {
        test_scene s = { 0 };
        sbl_picture_desc view = scene_view(48, 48, 40, 0, 2, 0.001f, 0, 0, 0);
        scene_floor(&s, scene_material(&s, 0.5f, 0.5f, 0.5f), 0, 9);
        scene_light(&s, SBL_LIGHT_POINT, 1, 1, 1)->position[1] = 1;
        view.options.mode = SBL_MODE_DIRECT;
        view.tile = 16;
        view.threshold = thresholds[i];
        REQUIRE(scene_render(context, &s, &view), "no picture: %s", watch_last(&seen));
        share[i] = (double)sbl_query_stats(context).sensors.sites / sbl_query_stats(context).picture.visible_pixels;
        scene_free(&s);
    }
    printf("  sensors at %.1f %% of all pixels, with the target error at %.1f %%, with a high threshold at %.1f %%\n",
              100 * share[0], 100 * share[1], 100 * share[2]);
    CHECK(share[0] > 0.95, "a negative threshold does not refine all tiles whose corners differ");
    CHECK(share[1] < 0.5, "without a threshold the target error has no effect");
    CHECK(share[2] < 0.03, "a high threshold refines");
}

/* Returns the mean distance between the normals of a picture and those of the ball that it shows, or -1 on failure.
   facets: 1 if the ball has no normals */
static double off_the_ball(int facets, float facet_limit, float **normals) {
    test_scene s = { 0 };
    sbl_picture_desc view = scene_view(64, 64, 40, 0, 0, 3, 0, 0, 0);
    const float *positions;
    float *shown, *points;
    double off = 0;
    int i, k, count = 0;
    /* facets of this ball are 1.4 pixels high */
    scene_sphere(&s, scene_material(&s, 0.5f, 0.5f, 0.5f), 0, 0, 0, 0.9f, 128, 64, !facets);
    view.options.mode = SBL_MODE_DIRECT;
    view.tile = 64;
    view.facet_limit = facet_limit;
    if (!scene_render(context, &s, &view)) { scene_free(&s); return -1; }
    shown = scene_channel(context, &view, SBL_CHANNEL_NORMAL);
    positions = points = scene_channel(context, &view, SBL_CHANNEL_POSITION);
    for (i = 0; i < 64 * 64; i++) {
        const double length = sqrt((double)positions[3 * i] * positions[3 * i] + (double)positions[3 * i + 1] *
                                   positions[3 * i + 1] + (double)positions[3 * i + 2] * positions[3 * i + 2]);
        if (!(length > 0)) continue;
        for (k = 0; k < 3; k++) off += fabs((double)shown[3 * i + k] - positions[3 * i + k] / length);
        count++;
    }
    free(points);
    *normals = shown;
    scene_free(&s);
    return count ? off / count : -1;
}

/* The default of facet_limit is 2 pixels. A negative limit keeps all shading normals. */
TEST(negative_facet_limit_is_shading_normals_everywhere) {
    static const float limits[4] = { 0, 2, -1, 1 };
    float *normals[4];
    double off[4];
    int i;
    for (i = 0; i < 4; i++) REQUIRE((off[i] = off_the_ball(0, limits[i], &normals[i])) >= 0, "%s", watch_last(&seen));
    printf("  normals differ from the ball's by %.5f, with a limit of 2 by %.5f, -1 %.5f, 1 %.5f\n", off[0], off[1],
           off[2], off[3]);
    CHECK(memcmp(normals[0], normals[1], 64 * 64 * 3 * sizeof(float)) == 0, "the default is not 2 pixels");
    CHECK(memcmp(normals[0], normals[3], 64 * 64 * 3 * sizeof(float)) != 0,
          "limits of 1 and 2 pixels give the same normals");
    CHECK(off[2] < 0.001, "with a negative limit normals differ from the shading normals");
    CHECK(off[0] > 3 * off[2], "by default small facets have shading normals");
    for (i = 0; i < 4; i++) free(normals[i]);
}

/* With a negative scale of the environment, the picture equals the one without an environment, to the bit. */
TEST(negative_scale_is_no_light_of_the_environment) {
    static const float white[4] = { 1, 1, 1, 1 };
    static small_picture without, none, usual;
    sbl_picture_desc view = small_view();
    sbl_scene_desc scene;
    test_scene s;
    small_scene(&s);
    scene = scene_desc(&s);
    REQUIRE(sbl_set_scene(context, &scene) == SBL_SUCCESS && small_render(context, &view, &without) == SBL_SUCCESS,
            "%s", watch_last(&seen));
    scene.environment.picture.pixels = white;
    scene.environment.picture.format = SBL_PIXELS_FLOAT;
    scene.environment.picture.width = scene.environment.picture.height = 1;
    REQUIRE(sbl_set_scene(context, &scene) == SBL_SUCCESS && small_render(context, &view, &usual) == SBL_SUCCESS,
            "%s", watch_last(&seen));
    scene.environment.scale = -3;
    REQUIRE(sbl_set_scene(context, &scene) == SBL_SUCCESS && small_render(context, &view, &none) == SBL_SUCCESS,
            "%s", watch_last(&seen));
    CHECK(!small_same(&usual, &without), "an environment gives no light by default");
    CHECK(small_same(&none, &without), "a negative scale leaves light of the environment");
    scene_free(&s);
}

/* The default camera sees the complete scene, in pictures of any shape: no pixel at the border shows a surface, and the
   scene fills a large part of the shorter side of the picture. */
TEST(the_default_camera_shows_all) {
    static const int sizes[3][2] = { { 48, 48 }, { 96, 24 }, { 24, 96 } };
    test_scene s = { 0 };
    sbl_scene_desc scene;
    int i;
    scene_box(&s, scene_material(&s, 0.5f, 0.5f, 0.5f), -3, -1, -2, 1, 4, 1);
    scene = scene_desc(&s);
    REQUIRE(sbl_set_scene(context, &scene) == SBL_SUCCESS, "%s", watch_last(&seen));
    for (i = 0; i < 3; i++) {
        const int width = sizes[i][0], height = sizes[i][1];
        int x, y, border = 0, covered = 0;
        sbl_picture_desc view;
        float *albedo;
        memset(&view, 0, sizeof view);
        view.width = width;
        view.height = height;
        view.options.mode = SBL_MODE_DIRECT;
        view.options.rays = 4;
        REQUIRE(sbl_render_picture(context, &view) == SBL_SUCCESS, "no picture: %s", watch_last(&seen));
        albedo = scene_channel(context, &view, SBL_CHANNEL_ALBEDO);
        for (y = 0; y < height; y++)
            for (x = 0; x < width; x++) {
                const int shown = albedo[3 * (y * width + x)] > 0;
                border += shown && (x == 0 || y == 0 || x == width - 1 || y == height - 1);
                covered += shown;
            }
        printf("  %d x %d: %d pixels show the box, %d of them at the border\n", width, height, covered, border);
        CHECK(border == 0 && covered * 8 > test_min(width, height) * test_min(width, height),
              "%d x %d: %d pixels show the box, %d of them at the border", width, height, covered, border);
        free(albedo);
    }
    scene_free(&s);
}

int main(void) {
    sbl_context_desc desc = watch_desc(&seen);
    if (sbl_create(&desc, &context) != SBL_SUCCESS) { printf("no context: %s\n", watch_last(&seen)); return 1; }
    RUN(defaults_are_idempotent);
    RUN(queries_without_a_context_are_zeroes);
    RUN(new_contexts_have_done_nothing);
    RUN(negative_epsilon_is_no_ambient_light);
    RUN(negative_threshold_refines_every_difference);
    RUN(negative_facet_limit_is_shading_normals_everywhere);
    RUN(negative_scale_is_no_light_of_the_environment);
    RUN(the_default_camera_shows_all);
    sbl_destroy(context);
    return test_report();
}
