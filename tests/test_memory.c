/* Tests of the memory that a context holds: its budget, and the estimates of sbl_picture_bytes and sbl_lightmap_bytes.
   A further test checks the fingerprint that identifies a scene. */
#include "../sbl.h"
#include "support/test.h"
#include "support/scenes.h"
#include "support/gl_watch.h"
#include "support/inside.h"

static watch seen;
static test_scene cornell;

/* Makes a context with a memory budget and the Cornell box as its scene. Returns NULL on failure. */
static sbl_context *make_context(size_t budget, int cells) {
    sbl_context_desc desc = watch_desc(&seen);
    sbl_scene_desc scene = scene_desc(&cornell);
    sbl_context *context = NULL;
    desc.memory_budget = budget;
    scene.max_bounce_cells = cells;
    if (sbl_create(&desc, &context) == SBL_SUCCESS && sbl_set_scene(context, &scene) == SBL_SUCCESS) return context;
    sbl_destroy(context);
    return NULL;
}

static double held(const sbl_context *context) {
    const sbl_memory m = sbl_query_memory(context);
    return (double)m.host_bytes + (double)m.gpu_bytes;
}

/* Continues the work in short steps until it is complete. Returns the greatest memory that the context held after a
   step. */
static double most_held(sbl_context *context) {
    double most = 0;
    sbl_result result = SBL_UNFINISHED;
    while (result == SBL_UNFINISHED) {
        result = sbl_step(context, 1e-3);
        if (held(context) > most) most = held(context);
    }
    return result == SBL_SUCCESS ? most : 0;
}

/* The estimate for a picture is never too small. If the pixels need most of the memory, the estimate is not much too
   large. */
TEST(memory_of_pictures_is_predicted) {
    static const struct { int side, window, tile; sbl_mode mode; sbl_preset preset; double least; } cases[] = {
        { 640, 0, 0, SBL_MODE_DIRECT, SBL_PRESET_DRAFT, 0.6 },
        { 640, 0, 0, SBL_MODE_DIRECT, SBL_PRESET_DEFAULT, 0.7 },
        { 300, 0, 1, SBL_MODE_DIRECT, SBL_PRESET_DRAFT, 0.5 }, { 64, 0, 0, SBL_MODE_GI, SBL_PRESET_DRAFT, 0.5 },
        { 200, 0, 0, SBL_MODE_PAPER, SBL_PRESET_DRAFT, 0.4 },
        { 4000, 500, 0, SBL_MODE_DIRECT, SBL_PRESET_DRAFT, 0.5 } };
    size_t i;
    for (i = 0; i < sizeof cases / sizeof *cases; i++) {
        sbl_context *context = make_context(0, 0);
        sbl_picture_desc view = scene_cornell_view(cases[i].side, cases[i].side);
        double need, before, seen_bytes = 0;
        REQUIRE(context, "%s", watch_last(&seen));
        view.options.mode = cases[i].mode;
        view.options.preset = cases[i].preset;
        view.tile = cases[i].tile;
        view.window[2] = view.window[3] = cases[i].window;
        before = held(context);
        need = (double)sbl_picture_bytes(context, &view);
        if (sbl_begin_picture(context, &view) == SBL_SUCCESS) seen_bytes = most_held(context) - before;
        CHECK(seen_bytes > cases[i].least * need && seen_bytes < need, "case %d: %.0f bytes, %.0f foretold (%.2f)",
              (int)i, seen_bytes, need, seen_bytes / need);
        sbl_destroy(context);
    }
}

/* Large pictures need most memory after R is known. If surfaces have lobes, the estimate includes their jobs then:
   40 MB for pictures of any size. */
TEST(reflections_have_jobs) {
    int gloss;
    for (gloss = 0; gloss < 2; gloss++) {
        double bytes[2], jobs;
        sbl_context *context;
        int i;
        cornell.materials[0].ior = gloss ? 1.5f : 0;
        context = make_context(0, 0);
        cornell.materials[0].ior = 0;
        REQUIRE(context, "%s", watch_last(&seen));
        for (i = 0; i < 2; i++) {
            sbl_picture_desc view = scene_cornell_view(2048, i ? 4096 : 2048);
            view.options.mode = SBL_MODE_DIRECT;
            bytes[i] = (double)sbl_picture_bytes(context, &view);
        }
        jobs = 2 * bytes[0] - bytes[1];
        CHECK(fabs(jobs - 4e7 * gloss) < 1e6, "gloss %d: %.0f bytes of jobs", gloss, jobs);
        sbl_destroy(context);
    }
}

/* A picture with default settings needs at most 250 bytes per pixel at its peak, in host and GPU memory together, in
   addition to the memory that the context held before. */
TEST(pictures_need_250_bytes_per_pixel) {
    static const sbl_mode modes[2] = { SBL_MODE_DIRECT, SBL_MODE_GI };
    const int side = 768;
    int i;
    for (i = 0; i < 2; i++) {
        sbl_context *context = make_context(0, 1024);
        sbl_picture_desc view = scene_cornell_view(64, 64);
        double before, bytes;
        sbl_memory m;
        REQUIRE(context, "%s", watch_last(&seen));
        view.options.mode = modes[i];
        CHECK(sbl_render_picture(context, &view) == SBL_SUCCESS, "%s", watch_last(&seen));  /* fills the store */
        sbl_end(context);
        before = held(context);
        view = scene_cornell_view(side, side);
        view.options.mode = modes[i];
        view.options.rays = 16;  /* rays take time, not memory */
        CHECK(sbl_render_picture(context, &view) == SBL_SUCCESS, "%s", watch_last(&seen));
        m = sbl_query_memory(context);
        bytes = ((double)m.host_peak_bytes + (double)m.gpu_peak_bytes - before) / ((double)side * side);
        CHECK(bytes > 200 && bytes <= 250, "mode %d: %.1f bytes per pixel", (int)modes[i], bytes);
        sbl_destroy(context);
    }
}

/* The estimate for a lightmap is not too small and not much too large. */
TEST(memory_of_lightmaps_is_predicted) {
    static const float corners[8] = { 0, 0, 1, 0, 1, 1, 0, 1 };
    int directional;
    for (directional = 0; directional < 2; directional++) {
        sbl_context_desc desc = watch_desc(&seen);
        test_scene room = { 0 };
        sbl_scene_desc scene;
        sbl_context *context = NULL;
        sbl_lightmap_desc bake;
        double need, before, seen_bytes = 0;
        memset(&bake, 0, sizeof bake);
        scene_sky(&room, 1, 1, 1);
        scene_floor(&room, scene_material(&room, 0.5f, 0.5f, 0.5f), 0, 1)->lightmap_texcoords.data =
            scene_copy(&room, corners, 8);
        scene = scene_desc(&room);
        REQUIRE(sbl_create(&desc, &context) == SBL_SUCCESS && sbl_set_scene(context, &scene) == SBL_SUCCESS, "%s",
                watch_last(&seen));
        bake.width = bake.height = directional ? 288 : 512;
        bake.options.mode = SBL_MODE_DIRECT;
        bake.options.preset = SBL_PRESET_DRAFT;
        bake.directional = directional;
        before = held(context);
        need = (double)sbl_lightmap_bytes(context, &bake);
        if (sbl_begin_lightmap(context, &bake) == SBL_SUCCESS) seen_bytes = most_held(context) - before;
        CHECK(seen_bytes > 0.4 * need && seen_bytes < need, "directional %d: %.0f bytes, %.0f foretold (%.2f)",
              directional, seen_bytes, need, seen_bytes / need);
        sbl_destroy(context);
        scene_free(&room);
    }
}

/* The predicted memory of a picture includes the store only if the store must be made. It then grows with the number of
   cells that the picture sets. */
TEST(stores_count_if_they_are_made) {
    enum { FEW = 1024, MANY = 4096, PER_CELL = 2600 };
    sbl_context *context = make_context(0, FEW);
    sbl_picture_desc view = scene_cornell_view(24, 24);
    size_t before, after;
    REQUIRE(context, "%s", watch_last(&seen));
    view.options.mode = SBL_MODE_GI;
    before = sbl_picture_bytes(context, &view);
    view.max_bounce_cells = MANY;
    CHECK(sbl_picture_bytes(context, &view) == before + (MANY - FEW) * PER_CELL, "%.0f bytes, then %.0f",
          (double)before, (double)sbl_picture_bytes(context, &view));
    view.max_bounce_cells = 0;
    REQUIRE(sbl_render_picture(context, &view) == SBL_SUCCESS, "%s", watch_last(&seen));
    after = sbl_picture_bytes(context, &view);
    CHECK(after == before - FEW * PER_CELL, "%.0f bytes, then %.0f", (double)before, (double)after);
    view.max_bounce_cells = FEW;
    CHECK(sbl_picture_bytes(context, &view) == after, "a store that is kept counts");
    view.max_bounce_cells = MANY;
    CHECK(sbl_picture_bytes(context, &view) == after + MANY * PER_CELL, "%.0f bytes, then %.0f", (double)after,
          (double)sbl_picture_bytes(context, &view));
    sbl_destroy(context);
}

/* A store that is too coarse for the target error is made again only if the budget has room for 2600 bytes per
   additional cell, besides the predicted need of the picture. */
TEST(stores_grow_within_the_budget) {
    enum { FEW = 1024, MANY = 4096, PER_CELL = 2600 };
    int i;
    for (i = 0; i < 2; i++) {
        sbl_context *context = make_context(0, FEW);
        sbl_picture_desc view = scene_cornell_view(24, 24);
        size_t budget;
        REQUIRE(context, "%s", watch_last(&seen));
        view.options.mode = SBL_MODE_GI;
        view.target_error = 0.004f;
        budget = (size_t)held(context) + sbl_picture_bytes(context, &view) + (MANY - FEW) * PER_CELL - 100000;
        sbl_destroy(context);
        context = make_context(i ? budget + 200000 : budget, FEW);
        REQUIRE(context, "%s", watch_last(&seen));
        inside_limit_cells(context, FEW, MANY);
        CHECK(sbl_render_picture(context, &view) == SBL_SUCCESS, "%s", watch_last(&seen));
        CHECK(sbl_query_stats(context).store.max_cells == (i ? MANY : FEW), "budget %d: %d cells at most", i,
              sbl_query_stats(context).store.max_cells);
        sbl_destroy(context);
    }
}

/* A picture that exceeds the budget is refused before the work, with a message that names the greatest possible size.
   This size is then accepted. The context never holds more memory than the budget. */
TEST(the_budget_is_kept) {
    const size_t budget = 90000000;
    sbl_context *context = make_context(budget, 1024);
    sbl_picture_desc view = scene_cornell_view(1200, 1200);
    const char *words;
    int side[2] = { 0, 0 };
    sbl_memory m;
    REQUIRE(context, "%s", watch_last(&seen));
    view.options.mode = SBL_MODE_DIRECT;
    view.options.preset = SBL_PRESET_DRAFT;
    CHECK(sbl_begin_picture(context, &view) == SBL_ERROR_OUT_OF_MEMORY, "1200 x 1200 pixels are accepted");
    words = strstr(watch_last(&seen), "enough for ");
    REQUIRE(words && sscanf(words, "enough for %d x %d", &side[0], &side[1]) == 2, "%s", watch_last(&seen));
    CHECK(side[0] > 200 && side[0] < 600 && side[0] == side[1], "%d x %d pixels would do", side[0], side[1]);
    view.window[0] = view.window[1] = 300;
    view.window[2] = view.window[3] = side[0] - 48;  /* the margin is subtracted */
    CHECK(sbl_render_picture(context, &view) == SBL_SUCCESS, "%s", watch_last(&seen));
    m = sbl_query_memory(context);
    CHECK(m.host_peak_bytes + m.gpu_peak_bytes <= budget + budget / 5, "the peaks are %.0f and %.0f",
          (double)m.host_peak_bytes, (double)m.gpu_peak_bytes);
    sbl_destroy(context);
}

/* Memory that the estimate does not contain may use up the budget: host memory, a buffer or a texture. Then the
   allocation fails, the context holds no more than its budget, and the error message names the cause. */
TEST(a_used_up_budget_is_an_error) {
    test_scene room = { 0 };
    sbl_context_desc desc = watch_desc(&seen);
    sbl_context *context = NULL;
    const sbl_site site = { { 0, 3, 0 }, { 0, 1, 0 }, { 0, 0, 0 }, 0 };
    sbl_reading reading;
    sbl_readings_desc readings;
    sbl_scene_desc scene;
    double step;
    int refused[3] = { 0, 0, 0 };
    scene_sphere(&room, scene_material(&room, 0.5f, 0.5f, 0.5f), 0, 0, 0, 1, 200, 100, 1);
    scene_sky(&room, 1, 1, 1);
    scene = scene_desc(&room);
    readings = scene_readings(&site, &reading, 1, SBL_MODE_DIRECT);
    readings.options.backend = SBL_BACKEND_RASTER;
    for (step = 3e5; step < 2e8 && !context; step *= 1.2) {
        sbl_result result;
        sbl_memory m;
        int what = 0;
        desc.memory_budget = (size_t)step;
        result = sbl_create(&desc, &context);
        if (result == SBL_SUCCESS && ++what) result = sbl_set_scene(context, &scene);
        CHECK(!context || held(context) <= step, "a scene holds %.0f bytes, %.0f allowed", held(context), step);
        if (result == SBL_SUCCESS && ++what) result = sbl_gather_readings(context, &readings);
        m = sbl_query_memory(context);
        CHECK((double)m.gpu_peak_bytes <= step && (double)m.host_peak_bytes <= step,
              "the peaks are %.0f and %.0f, %.0f allowed", (double)m.host_peak_bytes, (double)m.gpu_peak_bytes, step);
        if (result == SBL_SUCCESS) break;
        CHECK(result == SBL_ERROR_OUT_OF_MEMORY && strstr(watch_last(&seen), "memory_budget"), "step %d: %s", what,
              watch_last(&seen));
        refused[what]++;
        sbl_destroy(context);
        context = NULL;
    }
    CHECK(refused[1] > 3 && refused[2] > 3 && context, "%d %d %d budgets were refused", refused[0], refused[1],
          refused[2]);
    sbl_destroy(context);
    scene_free(&room);
}

/* Equal scenes have equal fingerprints, also in different contexts. A change of anything that affects the light changes
   the fingerprint, and so does a change of a normal map. */
TEST(fingerprints_tell_scenes_apart) {
    test_scene room = { 0 };
    sbl_context *context = make_context(0, 1024), *other = make_context(0, 2048);
    sbl_scene_desc scene;
    sbl_light lamp;
    static const unsigned char texels[2][3] = { { 189, 209, 204 }, { 128, 128, 255 } };
    sbl_texture textures[2];
    uint64_t prints[12];
    float *position;
    int i, k;
    REQUIRE(context && other, "%s", watch_last(&seen));
    scene_cornell_box(&room);
    scene = scene_desc(&room);
    memset(&lamp, 0, sizeof lamp);
    lamp.kind = SBL_LIGHT_POINT;
    lamp.intensity[0] = 1;
    prints[0] = sbl_scene_fingerprint(context);
    CHECK(prints[0] && prints[0] == sbl_scene_fingerprint(other), "equal scenes differ");
    memset(textures, 0, sizeof textures);
    for (i = 0; i < 2; i++) {
        textures[i].pixels = texels[i];
        textures[i].width = textures[i].height = 1;
        textures[i].channels = 3;
        textures[i].format = SBL_PIXELS_LINEAR8;
    }
    for (i = 1; i < 12; i++) {
        sbl_material *m = (sbl_material *)(uintptr_t)scene.materials;
        if (i == 1) scene.sky[2] = 0.5f;
        if (i == 2) { scene.lights = &lamp; scene.light_count = 1; }
        if (i == 3) lamp.position[1] = 1;
        if (i == 4) m[0].albedo[0] *= 0.99f;
        if (i == 5) {
            position = (float *)(uintptr_t)scene.meshes[0].positions.data;
            position[0] += 1;
        }
        if (i == 6) { scene.textures = textures; scene.texture_count = 2; }
        if (i == 7) m[0].normal_texture = 1;
        if (i == 8) m[0].normal_scale = 0.5f;
        if (i == 9) m[0].normal_texture = 2;
        if (i == 10) m[0].ior = 1.5f;
        if (i == 11) m[0].roughness = 0.5f;
        CHECK(sbl_set_scene(context, &scene) == SBL_SUCCESS, "%s", watch_last(&seen));
        prints[i] = sbl_scene_fingerprint(context);
        for (k = 0; k < i; k++) CHECK(prints[i] != prints[k], "scenes %d and %d have equal fingerprints", k, i);
    }
    CHECK(!sbl_scene_fingerprint(NULL) && !sbl_picture_bytes(NULL, NULL) && !sbl_lightmap_bytes(NULL, NULL),
          "without a context, something is foretold");
    sbl_destroy(context);
    sbl_destroy(other);
    CHECK(sbl_create(NULL, &context) == SBL_SUCCESS, "no context");
    CHECK(!sbl_scene_fingerprint(context) && !sbl_picture_bytes(context, NULL),
          "without a scene, something is foretold");
    sbl_destroy(context);
    scene_free(&room);
}

int main(void) {
    scene_cornell_box(&cornell);
    RUN_PLAIN(memory_of_pictures_is_predicted);
    RUN(reflections_have_jobs);
    RUN_PLAIN(pictures_need_250_bytes_per_pixel);
    RUN(memory_of_lightmaps_is_predicted);
    RUN(stores_count_if_they_are_made);
    RUN(stores_grow_within_the_budget);
    RUN(the_budget_is_kept);
    RUN(a_used_up_budget_is_an_error);
    RUN(fingerprints_tell_scenes_apart);
    scene_free(&cornell);
    return test_report();
}
