/* Tests of windows of lightmaps: a window shows the same as the complete map, and joined windows equal the complete
   map, with its gutters and seams. */
#include "../sbl.h"
#include "support/test.h"
#include "support/scenes.h"
#include "support/reference.h"
#include "support/gl_watch.h"
#include "support/lightmap.h"
#include "support/patches.h"

enum { WIDTH = 96, HEIGHT = 80, TEXELS = WIDTH * HEIGHT, LAYERS = 5, WINDOWS = 5 };

/* x, y, width and height. Together these windows cover the map. With 3 x 3 subsamples per texel, the second window is
   so large that its surfaces are read back in two pieces. */
static const int windows[WINDOWS][4] = { { 0, 0, 96, 7 }, { 0, 7, 95, 61 }, { 95, 7, 1, 61 }, { 0, 68, 40, 12 },
                                         { 40, 68, 56, 12 } };
static const sbl_channel channels[LAYERS] = { SBL_CHANNEL_RADIANCE, SBL_CHANNEL_SH_0, SBL_CHANNEL_SH_1,
                                              SBL_CHANNEL_SH_2, SBL_CHANNEL_SH_3 };
static float light[LAYERS][3 * TEXELS], whole[LAYERS][3 * TEXELS], ids[TEXELS], part[3 * TEXELS];

/* Makes a ball of 32 charts under a lamp, with a disc around it that hides a part of each chart from the lamp. */
static void ball_scene(test_scene *s) {
    memset(s, 0, sizeof *s);
    ball_of_patches(s, scene_material(s, 0.5f, 0.5f, 0.5f));
    scene_quad(s, 0, -2, 0.1f, -2, 2, 0.1f, -2, 2, 0.1f, 2, -2, 0.1f, 2);
    scene_quad(s, scene_lamp(s, 9, 7, 5), -1, 3, -1, 1, 3, -1, 1, 3, 1, -1, 3, 1);
    scene_sky(s, 0.3f, 0.4f, 0.5f);
}

static sbl_lightmap_desc ball_map(int supersample) {
    sbl_lightmap_desc desc = map_of(WIDTH, HEIGHT, SBL_MODE_DIRECT);
    desc.options.rays = 64;
    desc.supersample = supersample;
    desc.directional = 1;
    return desc;
}

static int set_scene(const test_scene *s) {
    const sbl_scene_desc scene = scene_desc(s);
    return use_scene(s) && sbl_set_scene(context, &scene) == SBL_SUCCESS;
}

/* Copies a channel of the baked window to its place in an array of the complete map. */
static void put_window(sbl_channel channel, const int w[4], float *out) {
    const int n = sbl_channel_components(channel);
    int y;
    CHECK(sbl_read_channel(context, channel, part, sizeof part / sizeof *part) == SBL_SUCCESS, "%s", watch_last(&seen));
    for (y = 0; y < w[3]; y++)
        memcpy(out + n * ((w[1] + y) * WIDTH + w[0]), part + n * y * w[2], (size_t)(n * w[2]) * sizeof *out);
}

/* Bakes the map window by window into light and ids. Returns 0 on failure. */
static int bake_windows(sbl_lightmap_desc desc, const int (*list)[4], int count) {
    int i, k;
    for (i = 0; i < count; i++) {
        memcpy(desc.window, list[i], sizeof desc.window);
        if (sbl_bake_lightmap(context, &desc) != SBL_SUCCESS) { CHECK(0, "%s", watch_last(&seen)); return 0; }
        put_window(SBL_CHANNEL_ID, list[i], ids);
        for (k = 0; k < (desc.directional ? LAYERS : 1); k++) put_window(channels[k], list[i], light[k]);
    }
    return 1;
}

static sbl_windows_desc joining_of(const sbl_lightmap_desc *desc) {
    sbl_windows_desc joining;
    int k;
    memset(&joining, 0, sizeof joining);
    joining.lightmap = *desc;
    joining.ids = ids;
    for (k = 0; k < LAYERS; k++) joining.light[k] = light[k];
    joining.texel_count = TEXELS;
    return joining;
}

/* Bakes the map at once and stores the light that a host reads in `whole`. Returns 0 on failure. */
static int bake_whole(const sbl_lightmap_desc *desc) {
    int k, ok = sbl_bake_lightmap(context, desc) == SBL_SUCCESS;
    for (k = 0; k < LAYERS && ok; k++)
        ok = sbl_read_channel(context, k ? channels[k] : SBL_CHANNEL_FINAL, whole[k], 3 * TEXELS) == SBL_SUCCESS;
    CHECK(ok, "%s", watch_last(&seen));
    return ok;
}

/* A single window that covers the map is joined. The result equals the map that is baked at once, to the bit: R,
   harmonics, gutters and the statistics of seams. Facets that facet_limit affects have no seams. At one place across a
   texel there are none, because by default facet_limit affects no ball. */
TEST(one_window_joins_to_the_map) {
    static const int all[1][4] = { { 0, 0, WIDTH, HEIGHT } };
    static test_scene s;
    int across, k, seams[3] = { 0, 0, 0 };
    ball_scene(&s);
    REQUIRE(set_scene(&s), "no context");
    for (across = 1; across <= 2; across++) {
        sbl_lightmap_desc desc = ball_map(across);
        sbl_windows_desc joining;
        sbl_stats at_once, joined;
        if (across > 1) desc.facet_limit = 1.5f;
        joining = joining_of(&desc);
        if (!bake_whole(&desc)) break;
        at_once = sbl_query_stats(context);
        if (!bake_windows(desc, all, 1)) break;
        CHECK(sbl_query_stats(context).lightmap.seams == 0, "seams of a window are changed");
        CHECK(memcmp(light[0], whole[0], sizeof light[0]) != 0, "a window has gutters");
        CHECK(sbl_join_windows(context, &joining) == SBL_SUCCESS, "%s", watch_last(&seen));
        joined = sbl_query_stats(context);
        for (k = 0; k < LAYERS; k++)
            CHECK(memcmp(light[k], whole[k], sizeof light[k]) == 0, "layer %d, %d places across a texel", k, across);
        CHECK(joined.lightmap.seams == at_once.lightmap.seams && joined.lightmap.seams > 0 &&
                  fabs((double)joined.lightmap.seam_before / (double)at_once.lightmap.seam_before - 1) < 0.1,
              "%d seams, before %g and %g", joined.lightmap.seams, (double)joined.lightmap.seam_before,
              (double)at_once.lightmap.seam_before);
        CHECK(sbl_read_channel(context, SBL_CHANNEL_ID, part, TEXELS) == SBL_SUCCESS &&
                  memcmp(part, ids, sizeof ids) == 0, "joining drops the finished lightmap");
        seams[across] = joined.lightmap.seams;
    }
    CHECK(seams[2] < seams[1], "%d seams between facets, %d on the smooth ball", seams[2], seams[1]);
    scene_free(&s);
}

/* Seams stay if the descriptor says so, or if it has no gutter: the joined map is to the bit the map baked at once. */
TEST(joined_seams_can_stay) {
    static const int all[1][4] = { { 0, 0, WIDTH, HEIGHT } };
    static test_scene s;
    int i, k;
    ball_scene(&s);
    REQUIRE(set_scene(&s), "no context");
    for (i = 0; i < 2; i++) {
        sbl_lightmap_desc desc = ball_map(1);
        sbl_windows_desc joining;
        if (i) desc.seams = -1;
        else desc.gutter = -1;
        joining = joining_of(&desc);
        if (!bake_whole(&desc) || !bake_windows(desc, all, 1)) break;
        CHECK(sbl_join_windows(context, &joining) == SBL_SUCCESS, "%s", watch_last(&seen));
        CHECK(sbl_query_stats(context).lightmap.seams == 0, "%d seams", sbl_query_stats(context).lightmap.seams);
        for (k = 0; k < LAYERS; k++)
            CHECK(memcmp(light[k], whole[k], sizeof light[k]) == 0, "layer %d, %s", k, i ? "seams -1" : "no gutter");
    }
    scene_free(&s);
}

/* If only some meshes are baked, only seams between these meshes are joined. */
TEST(chosen_meshes_are_joined) {
    static const int all[1][4] = { { 0, 0, WIDTH, HEIGHT } }, meshes[4] = { 0, 1, 8, 20 };
    static test_scene s;
    sbl_lightmap_desc desc = ball_map(1);
    sbl_windows_desc joining;
    int seams;
    desc.directional = 0;
    desc.meshes = meshes;
    desc.mesh_count = 4;
    joining = joining_of(&desc);
    ball_scene(&s);
    REQUIRE(set_scene(&s) && sbl_bake_lightmap(context, &desc) == SBL_SUCCESS &&
                sbl_read_channel(context, SBL_CHANNEL_FINAL, whole[0], 3 * TEXELS) == SBL_SUCCESS, "%s",
            watch_last(&seen));
    seams = sbl_query_stats(context).lightmap.seams;
    if (!bake_windows(desc, all, 1)) return;
    CHECK(sbl_join_windows(context, &joining) == SBL_SUCCESS, "%s", watch_last(&seen));
    CHECK(sbl_query_stats(context).lightmap.seams == seams && seams > 0, "%d seams, %d at once",
          sbl_query_stats(context).lightmap.seams, seams);
    CHECK(memcmp(light[0], whole[0], sizeof light[0]) == 0, "the joined map differs");
    scene_free(&s);
}

/* Windows show the same surfaces as the complete map, also if a window begins at a subsample that is not on the border
   of a first-level tile. */
TEST(windows_show_the_map) {
    static const sbl_channel shown[3] = { SBL_CHANNEL_ID, SBL_CHANNEL_POSITION, SBL_CHANNEL_NORMAL };
    static test_scene s;
    int across, i, k;
    ball_scene(&s);
    REQUIRE(set_scene(&s), "no context");
    for (across = 1; across <= 3; across += 2) {
        sbl_lightmap_desc desc = ball_map(across);
        int visible = 0;
        desc.directional = 0;
        desc.options.rays = 1;
        REQUIRE(sbl_bake_lightmap(context, &desc) == SBL_SUCCESS, "%s", watch_last(&seen));
        for (k = 0; k < 3; k++)
            CHECK(sbl_read_channel(context, shown[k], whole[k], 3 * TEXELS) == SBL_SUCCESS, "%s", watch_last(&seen));
        visible = sbl_query_stats(context).picture.visible_pixels;
        for (i = 0; i < WINDOWS; i++) {
            memcpy(desc.window, windows[i], sizeof desc.window);
            REQUIRE(sbl_bake_lightmap(context, &desc) == SBL_SUCCESS, "%s", watch_last(&seen));
            for (k = 0; k < 3; k++) put_window(shown[k], windows[i], light[k]);
            visible -= sbl_query_stats(context).picture.visible_pixels;
            CHECK(sbl_query_stats(context).picture.width == windows[i][2], "width %d",
                  sbl_query_stats(context).picture.width);
        }
        CHECK(memcmp(light[0], whole[0], TEXELS * sizeof(float)) == 0, "ids differ, %d across", across);
        CHECK(visible == 0, "windows show %d texels less", visible);
        for (k = 1; k < 3; k++)
            CHECK(memcmp(light[k], whole[k], sizeof light[k]) == 0, "channel %d differs, %d across", shown[k], across);
    }
    scene_free(&s);
}

/* Returns the RMS difference of R on charts, divided by the mean. */
static double difference(void) {
    double sum = 0, off = 0;
    int i, count = 0;
    for (i = 0; i < TEXELS; i++) {
        if (!(ids[i] > 0)) continue;
        count++;
        sum += (double)whole[0][3 * i];
        off += pow((double)light[0][3 * i] - (double)whole[0][3 * i], 2);
    }
    return sqrt(off / count) / (sum / count);
}

/* Joined windows have the light of the map that is baked at once. The light of a window does not depend on earlier
   bakes. With 2 x 2 subsamples, window borders lie inside tiles. */
TEST(windows_join_to_the_map) {
    static test_scene s;
    int across;
    ball_scene(&s);
    REQUIRE(set_scene(&s), "no context");
    for (across = 1; across <= 2; across++) {
        sbl_lightmap_desc desc = ball_map(across);
        sbl_windows_desc joining = joining_of(&desc);
        if (!bake_whole(&desc)) break;
        memcpy(desc.mean_radiance, sbl_query_stats(context).picture.mean_radiance, sizeof desc.mean_radiance);
        if (!bake_windows(desc, windows, WINDOWS)) break;
        CHECK(memcmp(sbl_query_stats(context).picture.mean_radiance, desc.mean_radiance, sizeof desc.mean_radiance) ==
                  0, "a window has another mean");
        memcpy(desc.window, windows[1], sizeof desc.window);
        CHECK(sbl_bake_lightmap(context, &desc) == SBL_SUCCESS, "%s", watch_last(&seen));
        CHECK(sbl_read_channel(context, SBL_CHANNEL_RADIANCE, part, 3 * TEXELS) == SBL_SUCCESS &&
                  memcmp(part + 3 * 95 * 20, light[0] + 3 * 27 * WIDTH, 95 * 12) == 0,
              "row 20 of a window depends on windows before it");
        CHECK(sbl_join_windows(context, &joining) == SBL_SUCCESS, "%s", watch_last(&seen));
        printf("  joined windows differ from the map by %.2f %%, %d across\n", 100 * difference(), across);
        CHECK(difference() < 0.01, "light differs by %g", difference());
        CHECK(sbl_query_stats(context).lightmap.seam_after < 0.02f, "seams differ by %g",
              (double)sbl_query_stats(context).lightmap.seam_after);
    }
    scene_free(&s);
}

/* Texels under a box that is close to a floor are hidden. Their sensors move to other places in the texel; a window
   must find the same places. */
TEST(hidden_texels_of_windows) {
    static const int halves[2][4] = { { 0, 0, 61, HEIGHT }, { 61, 0, WIDTH - 61, HEIGHT } };
    static test_scene s;
    sbl_lightmap_desc desc = map_of(WIDTH, HEIGHT, SBL_MODE_DIRECT);
    double off = 0;
    int i;
    memset(&s, 0, sizeof s);
    scene_material(&s, 0.5f, 0.5f, 0.5f);
    uv_rectangle(&s, scene_floor(&s, 0, 0, 2), 0, 0, 1, 1);
    scene_box(&s, 0, -0.613f, 0.002f, -0.613f, 0.613f, 1, 0.613f);
    scene_sky(&s, 1, 1, 1);
    desc.gutter = -1;
    desc.options.rays = 256;
    REQUIRE(set_scene(&s), "no context");
    if (!bake_whole(&desc) || !bake_windows(desc, halves, 2)) return;
    for (i = 0; i < TEXELS; i++) off = test_max(off, fabs((double)light[0][3 * i] - (double)whole[0][3 * i]));
    printf("  the largest difference is %.2g\n", off);
    CHECK(off < 0.1, "a texel differs by %g", off);
    scene_free(&s);
}

/* A price ends the work on a window as it ends that on a picture: a higher price takes fewer looks. */
TEST(windows_have_a_price) {
    static test_scene s;
    sbl_lightmap_desc desc = map_of(WIDTH, HEIGHT, SBL_MODE_DIRECT);
    int64_t rays[2];
    int i;
    ball_scene(&s);
    REQUIRE(set_scene(&s), "no context");
    memcpy(desc.window, windows[1], sizeof desc.window);
    for (i = 0; i < 2; i++) {
        desc.price = i ? 1e-3f : 1e-6f;
        CHECK(sbl_bake_lightmap(context, &desc) == SBL_SUCCESS, "%s", watch_last(&seen));
        rays[i] = sbl_query_stats(context).sensors.rays;
    }
    CHECK(rays[0] > 2 * rays[1] && rays[1] > 0, "%.0f and %.0f rays", (double)rays[0], (double)rays[1]);
    scene_free(&s);
}

/* An overlap is reported with its position in the complete map, and only by the window that shows it. */
TEST(overlaps_are_named_in_their_window) {
    static test_scene s;
    sbl_lightmap_desc desc = map_of(WIDTH, HEIGHT, SBL_MODE_DIRECT);
    int i;
    memset(&s, 0, sizeof s);
    scene_material(&s, 0.5f, 0.5f, 0.5f);
    uv_rectangle(&s, scene_floor(&s, 0, 0, 1), 0, 0, 0.5f, 0.5f);
    uv_rectangle(&s, scene_floor(&s, 0, 3, 1), 47.1f / WIDTH, 0.1f, 1, 11 / (float)HEIGHT);
    desc.options.rays = 1;
    REQUIRE(set_scene(&s), "no context");
    for (i = 0; i < WINDOWS; i++) {
        watch_forget(&seen);
        memcpy(desc.window, windows[i], sizeof desc.window);
        CHECK(sbl_bake_lightmap(context, &desc) == SBL_SUCCESS, "%s", watch_last(&seen));
        CHECK(watch_said(&seen, SBL_LOG_WARNING, SBL_LOG_ITEM_OVERLAP, "share texel 47 ", NULL, NULL) == (i == 1),
              "window %d: %s", i, watch_last(&seen));
        CHECK(!watch_said(&seen, SBL_LOG_WARNING, SBL_LOG_ITEM_NOTHING_VISIBLE, NULL, NULL, NULL), "window %d", i);
    }
    scene_free(&s);
}

static void refused(sbl_windows_desc desc, const char *word) {
    watch_forget(&seen);
    CHECK(sbl_join_windows(context, &desc) == SBL_ERROR_INVALID_ARGUMENT &&
              watch_said(&seen, SBL_LOG_ERROR, SBL_LOG_ITEM_INVALID_LIGHTMAP_DESC, word, NULL, NULL), "%s: %s", word,
          watch_last(&seen));
}

TEST(every_field_is_checked) {
    static test_scene s;
    sbl_lightmap_desc map = ball_map(1);
    const sbl_windows_desc good = joining_of(&map);
    sbl_windows_desc d;
    ball_scene(&s);
    REQUIRE(set_scene(&s), "no context");
    d = good; d.ids = NULL; refused(d, "ids");
    d = good; d.light[0] = NULL; refused(d, "light[0]");
    d = good; d.light[4] = NULL; refused(d, "light[4]");
    d = good; d.texel_count = TEXELS - 1; refused(d, "texel_count");
    d = good; d.lightmap.width = 20000; refused(d, "width");
    d = good; d.lightmap.end_canary = 1; refused(d, "end_canary");
    d = good; d.start_canary = 1; refused(d, "start_canary");
    d = good; d.end_canary = 1; refused(d, "end_canary");
    CHECK(sbl_join_windows(context, NULL) == SBL_ERROR_INVALID_ARGUMENT, "NULL is accepted");
    map.window[2] = WIDTH + 1;
    map.window[3] = 1;
    CHECK(sbl_begin_lightmap(context, &map) == SBL_ERROR_INVALID_ARGUMENT && strstr(watch_last(&seen), "inside the"),
          "%s", watch_last(&seen));
    map.window[2] = map.window[0] = 2000000000;
    CHECK(sbl_begin_lightmap(context, &map) == SBL_ERROR_INVALID_ARGUMENT && strstr(watch_last(&seen), "inside the"),
          "%s", watch_last(&seen));
    map = ball_map(1);
    map.price = -1;
    CHECK(sbl_begin_lightmap(context, &map) == SBL_ERROR_INVALID_ARGUMENT && strstr(watch_last(&seen), "price"), "%s",
          watch_last(&seen));
    map.directional = 0;
    d = joining_of(&map);
    d.lightmap.price = 0;
    d.light[1] = NULL;
    memset(d.lightmap.window, 0xff, sizeof d.lightmap.window);  /* must be ignored */
    CHECK(sbl_begin_windows(context, &d) == SBL_SUCCESS, "%s", watch_last(&seen));
    sbl_end(context);
    scene_free(&s);
}

/* A scene without lightmap coordinates, and arrays with a NaN or an infinity, are refused. The arrays stay as they
   were. */
TEST(wrong_windows_are_refused) {
    static const struct { int layer, at; const char *words; } wrong[] = {
        { -1, TEXELS - 1, "ids is nan at texel 95 79; it must be finite" },
        { 0, 3 * (WIDTH * 2 + 5) + 1, "light[0] is nan at texel 5 2; it must be finite" },
        { 4, 3 * TEXELS - 1, "light[4] is inf at texel 95 79; it must be finite" } };
    static test_scene s;
    const sbl_lightmap_desc map = ball_map(1);
    const sbl_windows_desc joining = joining_of(&map);
    int i;
    memset(&s, 0, sizeof s);
    scene_quad(&s, scene_lamp(&s, 9, 7, 5), -1, 3, -1, 1, 3, -1, 1, 3, 1, -1, 3, 1);
    REQUIRE(set_scene(&s), "no context");
    refused(joining, "no mesh of the scene has lightmap_texcoords");
    scene_free(&s);
    ball_scene(&s);
    REQUIRE(set_scene(&s), "no context");
    memset(light, 0, sizeof light);
    memset(ids, 0, sizeof ids);
    for (i = 0; i < 3; i++) {
        float *v = wrong[i].layer < 0 ? &ids[wrong[i].at] : &light[wrong[i].layer][wrong[i].at];
        *v = i < 2 ? (float)NAN : (float)INFINITY;
        memcpy(whole, light, sizeof whole);
        refused(joining, wrong[i].words);
        CHECK(memcmp(whole, light, sizeof whole) == 0, "%s: the light is changed", wrong[i].words);
        *v = 0;
    }
    CHECK(sbl_join_windows(context, &joining) == SBL_SUCCESS, "%s", watch_last(&seen));
    scene_free(&s);
}

static float most;
static int remember(float done, void *user) {
    (void)user;
    CHECK(done >= most && done <= 1, "progress goes from %g to %g", (double)most, (double)done);
    most = done;
    return 0;
}
static int cancel(float done, void *user) { (void)user; return done > 0.3f; }

/* Short time slices change nothing, progress grows, and the callback can cancel. */
TEST(joining_comes_in_pieces) {
    static test_scene s;
    sbl_lightmap_desc desc = ball_map(1);
    sbl_windows_desc joining;
    sbl_result result;
    int k, steps = 0;
    ball_scene(&s);
    REQUIRE(set_scene(&s), "no context");
    if (!bake_whole(&desc) || !bake_windows(desc, windows, WINDOWS)) return;
    memcpy(whole, light, sizeof whole);
    joining = joining_of(&desc);
    CHECK(sbl_join_windows(context, &joining) == SBL_SUCCESS, "%s", watch_last(&seen));
    for (k = 0; k < LAYERS; k++) joining.light[k] = whole[k];
    joining.lightmap.options.progress = remember;
    most = 0;
    CHECK(sbl_begin_windows(context, &joining) == SBL_SUCCESS, "%s", watch_last(&seen));
    do { result = sbl_step(context, 1e-9); steps++; } while (result == SBL_UNFINISHED);
    CHECK(result == SBL_SUCCESS && steps > 20 && most >= 1, "%d steps, progress %g", steps, (double)most);
    CHECK(memcmp(light, whole, sizeof light) == 0, "steps change the light");
    joining.lightmap.options.progress = cancel;
    CHECK(sbl_join_windows(context, &joining) == SBL_CANCELLED, "it is not cancelled");
    scene_free(&s);
}

static sbl_result join_call(const void *desc) { return sbl_join_windows(context, (const sbl_windows_desc *)desc); }

/* Each allocation fails once; afterwards joining works again. The light is not compared, because joining changes it. */
TEST(memory_runs_out) {
    static char nothing;
    static test_scene s;
    const sbl_lightmap_desc desc = ball_map(1);
    const sbl_windows_desc joining = joining_of(&desc);
    ball_scene(&s);
    REQUIRE(set_scene(&s), "no context");
    if (!bake_windows(desc, windows, WINDOWS)) return;
    CHECK(sbl_join_windows(context, &joining) == SBL_SUCCESS, "%s", watch_last(&seen));
    CHECK(each_allocation_fails(join_call, &joining, NULL, &nothing, 1) > 5, "few allocations failed");
    scene_free(&s);
}

int main(void) {
    RUN(one_window_joins_to_the_map);
    RUN(joined_seams_can_stay);
    RUN(chosen_meshes_are_joined);
    RUN(windows_show_the_map);
    RUN(windows_join_to_the_map);
    RUN(hidden_texels_of_windows);
    RUN(windows_have_a_price);
    RUN(overlaps_are_named_in_their_window);
    RUN(every_field_is_checked);
    RUN(wrong_windows_are_refused);
    RUN(joining_comes_in_pieces);
    RUN(memory_runs_out);
    sbl_destroy(context);
    CHECK(seen.blocks == 0 && seen.strangers == 0, "%d blocks are not freed, %d were freed twice or never allocated",
          seen.blocks, seen.strangers);
    return test_report() || test_errors;
}
