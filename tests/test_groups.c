/* Tests light groups. Their sum equals the total light, which they do not change, and each equals the light of a scene
   that has only the lights of this group. */
#include "../sbl.h"
#include "support/test.h"
#include "support/scenes.h"
#include "support/reference.h"
#include "support/gl_watch.h"
#include "support/lightmap.h"
#include "support/inside.h"

enum { GROUPS = 5, SITES = 24, VERTICES = 200, PROBES = 2, STREAM = 1 << 21, NONE = -1 };
enum { NOBODY, EMITTERS, POINTS, SUNS, SKIES };  /* the groups of `room`; the first has no sources */

static test_scene s;
static int cells = 1024;  /* sbl_scene_desc.max_bounce_cells */

static float on(int group, int only) { return only == NONE || only == group ? 1.0f : 0.0f; }

/* Makes a room with a window in the ceiling, a box on the floor, and lights of all kinds, each with its own group.
   only: a group whose lights are on, while all others are off; NONE: all are on */
static void room(int only) {
    int white, red, lamp, i;
    sbl_light *light;
    scene_free(&s);
    white = scene_material(&s, 0.7f, 0.7f, 0.7f);
    red = scene_material(&s, 0.7f, 0.3f, 0.2f);
    lamp = scene_lamp(&s, 6 * on(EMITTERS, only), 4 * on(EMITTERS, only), 0);
    s.materials[lamp].light_group = EMITTERS;
    uv_rectangle(&s, scene_quad(&s, white, -1, 0, -1, -1, 0, 1, 1, 0, 1, 1, 0, -1), 0.02f, 0.02f, 0.48f, 0.98f);
    uv_rectangle(&s, scene_quad(&s, red, -1, 0, -1, -1, 2, -1, -1, 2, 1, -1, 0, 1), 0.52f, 0.02f, 0.98f, 0.98f);
    scene_quad(&s, white, 1, 0, -1, 1, 0, 1, 1, 2, 1, 1, 2, -1);
    scene_quad(&s, white, -1, 0, -1, 1, 0, -1, 1, 2, -1, -1, 2, -1);
    scene_quad(&s, white, -1, 2, -1, 0, 2, -1, 0, 2, 1, -1, 2, 1);
    scene_box(&s, red, -0.6f, 0, -0.5f, -0.1f, 0.7f, 0.1f);
    scene_quad(&s, lamp, -0.9f, 1.9f, -0.4f, -0.5f, 1.9f, -0.4f, -0.5f, 1.9f, 0.2f, -0.9f, 1.9f, 0.2f);
    light = scene_light(&s, SBL_LIGHT_POINT, 0.4f, 0.6f, 1);
    light->position[0] = 0.6f; light->position[1] = 0.8f; light->position[2] = -0.5f;
    light->radius = 0.05f;
    light->light_group = POINTS;
    light = scene_light(&s, SBL_LIGHT_DIRECTIONAL, 3, 2.5f, 2);
    light->direction[0] = -0.3f; light->direction[1] = -1; light->direction[2] = 0.2f;
    light->light_group = SUNS;
    for (i = 0; i < 3; i++) s.lights[0].intensity[i] *= on(POINTS, only);
    for (i = 0; i < 3; i++) s.lights[1].intensity[i] *= on(SUNS, only);
    scene_sky(&s, 0.5f * on(SKIES, only), 0.7f * on(SKIES, only), on(SKIES, only));
}

/* Creates the context if there is none, and sets the scene. Returns 0 on failure. groups: number of light groups; 0:
   sources have no group */
static int set(int groups, int sky_group) {
    static test_scene empty;
    sbl_scene_desc desc;
    int i;
    for (i = 0; i < s.light_count && !groups; i++) s.lights[i].light_group = 0;
    for (i = 0; i < s.material_count && !groups; i++) s.materials[i].light_group = 0;
    desc = scene_desc(&s);
    desc.max_bounce_cells = cells;
    desc.light_groups = groups;
    desc.sky_group = groups ? sky_group : 0;
    if (!context && !use_scene(&empty)) return 0;
    watch_forget(&seen);
    return sbl_set_scene(context, &desc) == SBL_SUCCESS;
}

/* Compares the sum of `groups` arrays of floats with the array `whole`. stride: floats from one group to the next.
   Returns the largest difference, relative to the mean of `whole`. */
static double sum_off(const float *whole, const float *parts, int groups, size_t stride, size_t count, double *mean) {
    double off = 0;
    size_t i;
    int g;
    for (i = 0, *mean = 0; i < count; i++) {
        double sum = 0;
        for (g = 0; g < groups; g++) sum += (double)parts[(size_t)g * stride + i];
        off = test_max(off, fabs(sum - (double)whole[i]));
        *mean += fabs((double)whole[i]) / (double)count;
    }
    return off / *mean;
}

/* Returns the root mean square difference of two arrays. */
static double apart(const float *a, const float *b, size_t count) {
    double sum = 0;
    size_t i;
    for (i = 0; i < count; i++) sum += pow((double)a[i] - (double)b[i], 2);
    return sqrt(sum / (double)count);
}

static int is_black(const float *light, int count) {
    while (count > 0 && *light == 0) { count--; light++; }
    return count == 0;
}

/* >>readings */

/* Measures R and, if groups is not NULL, the groups at sites on floor and wall. R and each group have 3 * SITES
   floats. */
static sbl_result measure(sbl_mode mode, float *R, float *groups, int group_count) {
    static sbl_site sites[SITES];
    static sbl_reading readings[SITES];
    static float found[SITES * SBL_MAX_LIGHT_GROUPS * 3];
    sbl_readings_desc desc;
    sbl_result result;
    int i, g;
    memset(sites, 0, sizeof sites);
    for (i = 0; i < SITES; i++) {
        const float a = (float)(i % 6) / 3 - 0.8f, b = (float)(i / 6) / 2 - 0.7f;
        sites[i].position[0] = i % 2 ? a : -0.999f;
        sites[i].position[1] = i % 2 ? 0.001f : a + 1;
        sites[i].position[2] = b;
        sites[i].normal[i % 2] = 1;
    }
    for (i = SITES - 4; i < SITES; i++) {  /* close to the floor, facing it */
        sites[i].position[0] = 0.2f * (float)(i - SITES) + 0.6f;
        sites[i].position[1] = 0.03f;
        sites[i].normal[0] = 0;
        sites[i].normal[1] = -1;
    }
    desc = scene_readings(sites, readings, SITES, mode);
    desc.groups = groups ? found : NULL;
    result = sbl_gather_readings(context, &desc);
    for (i = 0; i < SITES; i++) {
        memcpy(R + 3 * i, readings[i].radiance, 12);
        for (g = 0; groups && g < group_count; g++)
            memcpy(groups + 3 * (SITES * g + i), found + 3 * (group_count * i + g), 12);
    }
    return result;
}

/* The sum of the light groups of readings equals R, which has the bits of readings without groups, and each group is
   the light of a scene with only its lights: with direct light, with bounces, and with a box of metal. */
TEST(readings_have_groups) {
    static const sbl_mode modes[3] = { SBL_MODE_DIRECT, SBL_MODE_GI, SBL_MODE_GI };
    int run, g;
    for (run = 0; run < 3; run++) {
        static float plain[3 * SITES], whole[3 * SITES], groups[3 * SITES * GROUPS], alone[3 * SITES];
        double off, mean;
        for (g = NONE; g < GROUPS; g += run == 2 && g == SUNS ? 2 : run == 2 && g == NONE ? 1 + SUNS : 1) {
            room(g);
            if (run == 2) s.materials[1].metallic = 0.5f;
            if (run == 2) s.materials[1].roughness = 0.3f;
            REQUIRE(set(0, 0) && measure(modes[run], g == NONE ? plain : alone, NULL, 0) == SBL_SUCCESS, "%s",
                    watch_last(&seen));
            if (g == NONE) {
                room(NONE);
                if (run == 2) s.materials[1].metallic = 0.5f;
                if (run == 2) s.materials[1].roughness = 0.3f;
                REQUIRE(set(GROUPS, SKIES) && measure(modes[run], whole, groups, GROUPS) == SBL_SUCCESS, "%s",
                        watch_last(&seen));
                CHECK(!memcmp(plain, whole, sizeof plain), "groups change the whole");
                off = sum_off(whole, groups, GROUPS, 3 * SITES, 3 * SITES, &mean);
                printf("  run %d: sum off by %.1e\n", run, off);
                CHECK(off < 3e-6, "the sum is off by %g of the mean", off);
                CHECK(is_black(groups, 3 * SITES), "a group without sources has light");
                continue;
            }
            off = apart(alone, groups + 3 * SITES * g, 3 * SITES);
            printf("    group %d: off by %.2f %% of the mean\n", g, 100 * off / mean);
            CHECK(off < (run == 0 ? 0.002 : run == 1 ? 0.012 : 0.025) * mean, "group %d is off by %g, mean %g", g, off,
                  mean);
        }
    }
}

/* If all sources belong to the last group, it has all light in all three channels, whatever the number of groups. */
TEST(the_last_group_has_all) {
    static float R[3 * SITES], groups[3 * SITES * SBL_MAX_LIGHT_GROUPS];
    double off, mean;
    int count, i;
    for (count = 6; count <= SBL_MAX_LIGHT_GROUPS; count++) {
        room(NONE);
        for (i = 0; i < s.light_count; i++) s.lights[i].light_group = count - 1;
        for (i = 0; i < s.material_count; i++) s.materials[i].light_group = count - 1;
        REQUIRE(set(count, count - 1) && measure(SBL_MODE_DIRECT, R, groups, count) == SBL_SUCCESS, "%s",
                watch_last(&seen));
        CHECK(is_black(groups, 3 * SITES * (count - 1)), "%d groups: another group has light", count);
        off = sum_off(R, groups + 3 * SITES * (count - 1), 1, 0, 3 * SITES, &mean);
        CHECK(off < 3e-6, "%d groups: the last one is off by %g", count, off);
    }
}

/* Readings whose light overflows are not valid, and their light is 0, in total and in groups. */
TEST(invalid_readings_have_no_groups) {
    static sbl_site site;
    static sbl_reading reading;
    static float groups[6];
    sbl_readings_desc desc;
    int i;
    scene_free(&s);
    for (i = 0; i < 2; i++) {
        scene_light(&s, SBL_LIGHT_POINT, 3e38f, 1, 1)->position[1] = 0.5f;
        s.lights[i].light_group = i;
    }
    scene_floor(&s, scene_material(&s, 0.5f, 0.5f, 0.5f), 0, 2);
    site.normal[1] = 1;
    desc = scene_readings(&site, &reading, 1, SBL_MODE_DIRECT);
    desc.groups = groups;
    REQUIRE(set(2, 0) && sbl_gather_readings(context, &desc) == SBL_SUCCESS, "%s", watch_last(&seen));
    printf("  valid %d, R %g, groups %g %g\n", reading.valid, (double)reading.radiance[0], (double)groups[0],
           (double)groups[3]);
    CHECK(!reading.valid && is_black(reading.radiance, 3) && is_black(groups, 6), "valid %d, R %g, groups %g %g",
          reading.valid, (double)reading.radiance[0], (double)groups[0], (double)groups[3]);
}

/* In a closed box whose walls all emit e and reflect a, R is e / (1 - a). If the walls across each axis are a group,
   they cause a third of it on average, by symmetry. */
TEST(groups_of_a_furnace) {
    enum { SIDES = 6 };
    static sbl_site sites[SIDES];
    static sbl_reading readings[SIDES];
    static float groups[SIDES][3][3];
    double thirds[3] = { 0, 0, 0 };
    sbl_readings_desc desc;
    int i, g;
    scene_free(&s);
    for (i = 0; i < 3; i++) {
        s.materials[scene_lamp(&s, 0.5f, 0.5f, 0.5f)].light_group = i;
        s.materials[i].albedo[0] = s.materials[i].albedo[1] = s.materials[i].albedo[2] = 0.5f;
    }
    scene_box(&s, 0, -1, -1, -1, 1, 1, 1);
    for (i = 0; i < 6; i++) s.meshes[i].material = i / 2;  /* the sides of scene_box: two each across x, y and z */
    memset(&desc, 0, sizeof desc);
    for (i = 0; i < SIDES; i++) sites[i].normal[i / 2] = i % 2 ? -1.0f : 1.0f;
    desc.sites = sites;
    desc.site_count = SIDES;
    desc.readings = readings;
    desc.groups = &groups[0][0][0];
    REQUIRE(set(3, 0) && sbl_gather_readings(context, &desc) == SBL_SUCCESS, "%s", watch_last(&seen));
    for (i = 0; i < SIDES; i++)
        for (g = 0; g < 3; g++) thirds[g] += (double)groups[i][g][1] / SIDES;
    for (i = 0; i < SIDES; i++)
        CHECK(fabs((double)readings[i].radiance[1] - 1) < 0.01, "R is %g", (double)readings[i].radiance[1]);
    for (g = 0; g < 3; g++) CHECK(fabs(3 * thirds[g] - 1) < 0.03, "group %d has %g of a third", g, 3 * thirds[g]);
}

/* The same box, whose walls emit by a texture. Sensors close to the edges have rays that hit nearby walls and also
   choose the same wall as a lamp. Their readings are valid. */
TEST(groups_of_textured_walls) {
    static const unsigned char white[4] = { 255, 255, 255, 255 };
    static float R[3 * SITES], groups[3 * SITES * 3];
    double off, mean;
    int i;
    scene_free(&s);
    scene_lamp(&s, 0.5f, 0.5f, 0.5f);
    s.materials[0].albedo[0] = s.materials[0].albedo[1] = s.materials[0].albedo[2] = 0.5f;
    s.materials[0].emission_texture = scene_texture(&s, white, sizeof white, SBL_PIXELS_LINEAR8, 1, 1, 4);
    s.materials[0].light_group = 2;
    scene_box(&s, 0, -1, 0, -1, 1, 2, 1);
    scene_box(&s, 0, -0.2f, 0, -0.3f, 0.1f, 0.7f, 0.3f);
    REQUIRE(set(3, 0) && measure(SBL_MODE_GI, R, groups, 3) == SBL_SUCCESS, "%s", watch_last(&seen));
    off = sum_off(R, groups, 3, 3 * SITES, 3 * SITES, &mean);
    CHECK(off < 3e-6, "the sum is off by %g of the mean", off);
    for (i = 0; i < SITES; i++)
        CHECK(fabs((double)R[3 * i] - 1) < 0.1 || i % 2, "R of site %d is %g", i, (double)R[3 * i]);
}

/* A small patch above dark ground, lit by two spot lights, becomes glows. Their light belongs to the groups of the spot
   lights, with other shares in the middle of the patch than at its edge. The same holds for light that sensors close to
   the ground receive by way of the ground. */
TEST(groups_of_glows) {
    static float whole[3 * SITES], groups[3 * SITES * 2], alone[3 * SITES];
    double off, mean = 0;
    int only, i;
    cells = 8192;
    for (only = NONE; only < 2; only++) {
        scene_free(&s);
        for (i = 0; i < 2; i++) {
            sbl_light *spot = scene_light(&s, SBL_LIGHT_SPOT, 50 * on(i, only), 30 * on(i, only), 50 * on(i, only));
            if (i) spot->intensity[0] = 0;
            spot->position[1] = spot->direction[1] = 1;
            spot->cone = i ? 12 : 60;
            spot->inner_cone = i ? 10 : 59;
            spot->light_group = i;
        }
        scene_quad(&s, scene_material(&s, 0.8f, 0.8f, 0.8f), -0.3f, 2, -0.3f, 0.3f, 2, -0.3f, 0.3f, 2, 0.3f, -0.3f, 2,
                   0.3f);
        scene_floor(&s, scene_material(&s, 0.2f, 0.2f, 0.2f), 0, 2);
        REQUIRE(set(2, 0) && measure(SBL_MODE_GI, only == NONE ? whole : alone, only == NONE ? groups : NULL, 2) ==
                    SBL_SUCCESS, "%s", watch_last(&seen));
        CHECK(inside_glow_count(context) > 0, "there are no glows");
        off = only == NONE ? sum_off(whole, groups, 2, 3 * SITES, 3 * SITES, &mean)
                           : apart(alone, groups + 3 * SITES * only, 3 * SITES) / mean;
        printf("  %d: off by %.1e of the mean; %d glows\n", only, off, inside_glow_count(context));
        CHECK(off < (only == NONE ? 3e-6 : 0.06), "%d: off by %g of the mean", only, off);
    }
    cells = 1024;
}

/* >>lightmaps */

/* A floor lit by two lamps, each a group of its own, agrees with closed forms. */
TEST(groups_of_two_lamps) {
    static const float lamps[2][12] = { { -0.5f, 2, -0.5f, 0.5f, 2, -0.5f, 0.5f, 2, 0.5f, -0.5f, 2, 0.5f },
                                        { 3, 0.6f, -1, 3, 0.6f, 0.5f, 3, 2, 0.5f, 3, 2, -1 } };
    sbl_lightmap_desc desc = map_of(20, 16, SBL_MODE_DIRECT);
    float *position, *id, *group[2];
    double off = 0, mean = 0;
    int lamp, i, k, count = 0;
    scene_free(&s);
    for (lamp = 0; lamp < 2; lamp++) {
        const int material = scene_lamp(&s, 1 - (float)lamp, 1, 2);
        s.materials[material].light_group = lamp;
        scene_polygon(&s, material, lamps[lamp], 4);
    }
    uv_rectangle(&s, scene_floor(&s, scene_material(&s, 0.5f, 0.5f, 0.5f), 0, 2), 0.1f, 0.05f, 0.9f, 0.95f);
    desc.grouped = 1;
    REQUIRE(set(2, 0) && sbl_bake_lightmap(context, &desc) == SBL_SUCCESS, "%s", watch_last(&seen));
    position = channel_of(&desc, SBL_CHANNEL_POSITION);
    id = channel_of(&desc, SBL_CHANNEL_ID);
    for (lamp = 0; lamp < 2; lamp++) group[lamp] = channel_of(&desc, (sbl_channel)(SBL_CHANNEL_GROUP_0 + lamp));
    REQUIRE(position && id && group[0] && group[1], "no lightmap");
    for (i = 0; i < 20 * 16; i++)
        for (lamp = 0; lamp < 2 && id[i] > 0; lamp++) {
            v3 corners[4];
            double truth;
            for (k = 0; k < 4; k++) corners[k] = v3_from(lamps[lamp] + 3 * k);
            truth = ref_polygon(v3_from(position + 3 * i), v3_of(0, 1, 0), corners, 4);
            off += pow((double)group[lamp][3 * i + 1] - truth, 2) + pow((double)group[lamp][3 * i + 2] - 2 * truth, 2);
            mean += 3 * truth;
            count += 2;
            CHECK(lamp == 0 || group[lamp][3 * i] == 0, "the second lamp emits red");
        }
    printf("  off by %.2f %%\n", 100 * sqrt(off / count) / (mean / count));
    CHECK(sqrt(off / count) < 0.01 * mean / count, "off by %g of %g", sqrt(off / count), mean / count);
    free(position); free(id); free(group[0]); free(group[1]);
}

/* The sum of the light groups of a lightmap equals FINAL, which has the bits of a lightmap without groups, and each
   group is the lightmap of a scene with only its lights. The same map in steps has the same bits. A window that covers
   the map, joined, equals the map. */
TEST(lightmaps_have_groups) {
    enum { SIZE = 24, TEXELS = SIZE * SIZE / 2 };
    static float group[3 * TEXELS * GROUPS], again[3 * TEXELS * GROUPS];
    sbl_lightmap_desc desc = map_of(SIZE, SIZE / 2, SBL_MODE_GI);
    sbl_windows_desc windows;
    float *plain, *whole, *alone, *ids;
    double off, mean;
    int i, g;
    desc.target_error = 0.03f;
    room(NONE);
    REQUIRE(set(0, 0) && sbl_bake_lightmap(context, &desc) == SBL_SUCCESS, "%s", watch_last(&seen));
    plain = channel_of(&desc, SBL_CHANNEL_FINAL);
    desc.grouped = 1;
    room(NONE);
    REQUIRE(set(GROUPS, SKIES) && sbl_bake_lightmap(context, &desc) == SBL_SUCCESS, "%s", watch_last(&seen));
    whole = channel_of(&desc, SBL_CHANNEL_FINAL);
    for (g = 0; g < GROUPS; g++)
        CHECK(sbl_read_channel(context, (sbl_channel)(SBL_CHANNEL_GROUP_0 + g), group + 3 * TEXELS * g, 3 * TEXELS) ==
                  SBL_SUCCESS, "%s", watch_last(&seen));
    CHECK(!memcmp(plain, whole, 3 * TEXELS * sizeof *plain), "groups change the whole");
    off = sum_off(whole, group, GROUPS, 3 * TEXELS, 3 * TEXELS, &mean);
    printf("  sum off by %.1e of the mean\n", off);
    CHECK(off < 1e-6, "the sum is off by %g of the mean", off);
    for (i = 0; i < 3 * TEXELS * GROUPS; i++) CHECK(group[i] >= 0, "a group is negative");
    CHECK(is_black(group, 3 * TEXELS), "a group without sources has light");
    REQUIRE(sbl_begin_lightmap(context, &desc) == SBL_SUCCESS, "%s", watch_last(&seen));
    while (sbl_step(context, 1e-4) == SBL_UNFINISHED) {}
    for (g = 0; g < GROUPS; g++)
        sbl_read_channel(context, (sbl_channel)(SBL_CHANNEL_GROUP_0 + g), again + 3 * TEXELS * g, 3 * TEXELS);
    CHECK(!memcmp(group, again, sizeof group), "in steps the groups differ");
    memset(&windows, 0, sizeof windows);
    windows.lightmap = desc;
    windows.texel_count = TEXELS;
    desc.window[2] = SIZE;
    desc.window[3] = SIZE / 2;
    REQUIRE(sbl_bake_lightmap(context, &desc) == SBL_SUCCESS, "%s", watch_last(&seen));
    windows.ids = ids = channel_of(&desc, SBL_CHANNEL_ID);
    windows.light[0] = alone = channel_of(&desc, SBL_CHANNEL_RADIANCE);
    for (g = 0; g < GROUPS; g++) {
        windows.groups[g] = again + 3 * TEXELS * g;
        sbl_read_channel(context, (sbl_channel)(SBL_CHANNEL_GROUP_0 + g), windows.groups[g], 3 * TEXELS);
    }
    off = sum_off(alone, again, GROUPS, 3 * TEXELS, 3 * TEXELS, &mean);
    printf("  sum of a window off by %.1e of the mean\n", off);
    CHECK(off < 0.02, "the sum of a window is off by %g of the mean", off);
    REQUIRE(sbl_join_windows(context, &windows) == SBL_SUCCESS, "%s", watch_last(&seen));
    CHECK(!memcmp(alone, whole, 3 * TEXELS * sizeof *alone), "the joined map differs");
    CHECK(!memcmp(again, group, sizeof again), "the groups of the joined map differ");
    free(alone);
    free(ids);
    memset(desc.window, 0, sizeof desc.window);
    desc.grouped = 0;
    for (g = EMITTERS; g < GROUPS; g += 3) {
        room(g);
        REQUIRE(set(0, 0) && sbl_bake_lightmap(context, &desc) == SBL_SUCCESS, "%s", watch_last(&seen));
        alone = channel_of(&desc, SBL_CHANNEL_FINAL);
        off = apart(alone, group + 3 * TEXELS * g, 3 * TEXELS);
        printf("    group %d: off by %.2f %% of the mean\n", g, 100 * off / mean);
        CHECK(off < 0.03 * mean, "group %d is off by %g, mean %g", g, off, mean);
        free(alone);
    }
    free(plain);
    free(whole);
}

/* Surfaces without sensors show the stored light of the groups. */
TEST(groups_of_stored_light) {
    enum { SIZE = 16, TEXELS = SIZE * SIZE / 2 };
    static float group[3 * TEXELS * GROUPS];
    sbl_lightmap_desc desc = map_of(SIZE, SIZE / 2, SBL_MODE_GI);
    double off, mean = 0;
    int only, i, g;
    desc.grouped = 1;
    for (only = NONE; only < GROUPS; only += 2) {
        float *whole;
        room(only);
        s.materials[0].flags = s.materials[1].flags = SBL_MATERIAL_NO_SENSORS;
        REQUIRE(set(GROUPS, SKIES) && sbl_bake_lightmap(context, &desc) == SBL_SUCCESS, "%s", watch_last(&seen));
        whole = channel_of(&desc, SBL_CHANNEL_FINAL);
        for (g = 0; g < GROUPS && only == NONE; g++)
            sbl_read_channel(context, (sbl_channel)(SBL_CHANNEL_GROUP_0 + g), group + 3 * TEXELS * g, 3 * TEXELS);
        off = 0;
        if (only == NONE) off = sum_off(whole, group, GROUPS, 3 * TEXELS, 3 * TEXELS, &mean);
        for (i = 0; i < 3 * TEXELS && only != NONE; i++)
            off += ((double)whole[i] - (double)group[3 * TEXELS * only + i]) / (3 * TEXELS * mean);
        printf("  %d: off by %.1e of the mean\n", only, off);
        CHECK(fabs(off) < (only == NONE ? 1e-6 : 0.02), "%d: off by %g of the mean", only, off);
        free(whole);
    }
}

/* Surfaces without sensors show the stored light of the groups beside glows: a spot light lights a patch above a floor,
   and a lamp of another group hangs between them. The floor shows the light from the patch and from the lamp. If the
   floor is of metal, the ceiling around the patch shows the light that the floor reflects. */
TEST(stored_groups_beside_glows) {
    enum { SIZE = 10, TEXELS = SIZE * SIZE };
    static float group[2][3 * TEXELS];
    sbl_lightmap_desc desc = map_of(SIZE, SIZE, SBL_MODE_GI);
    int metal, only, i, k, g;
    cells = 4096;
    desc.grouped = 1;
    for (metal = 0; metal < 2; metal++) {
        double mean = 0;
        for (only = NONE; only < 2; only++) {
            float *whole;
            double off = 0;
            sbl_light *light;
            scene_free(&s);
            for (i = 0; i < 2; i++) scene_material(&s, 0.7f, 0.7f, 0.7f);
            s.materials[1].metallic = (float)metal;
            s.materials[1].roughness = 0.3f;
            s.materials[!metal].flags = SBL_MATERIAL_NO_SENSORS;
            light = scene_light(&s, SBL_LIGHT_SPOT, 50 * on(0, only), 30 * on(0, only), 50 * on(0, only));
            light->position[1] = light->direction[1] = 1;
            light->cone = 30;
            light = scene_light(&s, SBL_LIGHT_POINT, 0.5f * on(1, only), 0.7f * on(1, only), 0.3f * on(1, only));
            light->position[0] = light->position[1] = 0.8f;
            light->light_group = 1;
            scene_quad(&s, scene_material(&s, 0.8f, 0.8f, 0.8f), -0.3f, 2, -0.3f, 0.3f, 2, -0.3f, 0.3f, 2, 0.3f, -0.3f,
                       2, 0.3f);
            uv_rectangle(&s, scene_floor(&s, 1, 0, 2), 0.05f, 0.05f, metal ? 0.1f : 0.95f, 0.95f);
            for (k = 0; k < 2 && metal; k++) {
                const float x = k ? 0.5f : -1.5f, u = k ? 0.6f : 0.2f, wall = k ? 2.0f : -2.0f;
                scene_quad(&s, 2, wall, 0, -2, wall, 0, 2, wall, 1.8f, 2, wall, 1.8f, -2);
                uv_rectangle(&s, scene_quad(&s, 0, x, 2, -1, x + 1, 2, -1, x + 1, 2, 1, x, 2, 1), u, 0.05f, u + 0.3f,
                             0.95f);
            }
            REQUIRE(set(2, 0) && sbl_bake_lightmap(context, &desc) == SBL_SUCCESS, "%s", watch_last(&seen));
            whole = channel_of(&desc, SBL_CHANNEL_FINAL);
            for (g = 0; g < 2 && only == NONE; g++)
                sbl_read_channel(context, (sbl_channel)(SBL_CHANNEL_GROUP_0 + g), group[g], 3 * TEXELS);
            CHECK(only != NONE || inside_glow_count(context) > 0, "there are no glows");
            if (only == NONE) off = sum_off(whole, group[0], 2, 3 * TEXELS, 3 * TEXELS, &mean);
            for (i = 0; i < 3 * TEXELS && only != NONE; i++)
                off += ((double)whole[i] - (double)group[only][i]) / (3 * TEXELS * mean);
            printf("  %s, %d: off by %.1e of the mean, %g\n", metal ? "metal" : "matte", only, off, mean);
            CHECK(fabs(off) < (only == NONE ? 1e-6 : !only ? 0.01 : metal ? 0.1 : 0.03),
                  "metal %d, %d: off by %g of the mean", metal, only, off);
            free(whole);
        }
    }
    cells = 1024;
}

/* >>vertices, probes */

/* The sum of light groups at vertices equals the total, and each equals that of a scene with only its lights. The same
   holds for probes. */
TEST(vertices_and_probes_have_groups) {
    static float whole[3 * VERTICES], alone[3 * VERTICES], group[3 * VERTICES * GROUPS];
    static sbl_probe probes[PROBES], parts[PROBES * GROUPS], single[PROBES];
    static const float positions[3 * PROBES] = { 0.4f, 1, 0.3f, 0.2f, 0.3f, -0.6f };
    sbl_vertices_desc bake;
    sbl_probes_desc air;
    double off, mean, probe_off = 0, probe_mean = 0;
    size_t floats = 0;
    int i, k, g;
    memset(&bake, 0, sizeof bake);
    memset(&air, 0, sizeof air);
    bake.options.rays = 256;
    bake.float_count = 3 * VERTICES;
    bake.group_float_count = sizeof group / sizeof *group;
    air.positions = positions;
    air.probe_count = PROBES;
    for (g = NONE; g < GROUPS; g += g == NONE ? 2 : 3) {
        room(g);
        for (i = 0; i < s.mesh_count && g == NONE; i++) floats += 3 * (size_t)s.meshes[i].vertex_count;
        bake.radiance = g == NONE ? whole : alone;
        air.probes = g == NONE ? probes : single;
        bake.groups = g == NONE ? group : NULL;
        air.groups = g == NONE ? parts : NULL;
        REQUIRE(set(g == NONE ? GROUPS : 0, SKIES) && sbl_bake_vertices(context, &bake) == SBL_SUCCESS &&
                    sbl_bake_probes(context, &air) == SBL_SUCCESS, "%s", watch_last(&seen));
        off = g == NONE ? sum_off(whole, group, GROUPS, floats, floats, &mean)
                        : apart(alone, group + floats * (size_t)g, floats) / mean;
        /* The groups are clamped at 0 one by one, the total only once, and they must add up, so they differ by more
           than noise. */
        printf("  vertices, %d: off by %.1e of the mean\n", g, off);
        CHECK(off < (g == NONE ? 1e-6 : 0.08), "vertices, %d: off by %g of the mean", g, off);
        for (i = 0, probe_off = 0; i < PROBES * 27; i++) {
            double sum = 0;
            for (k = 0; k < GROUPS; k++) sum += (double)(&parts[GROUPS * (i / 27) + k].sh[0][0])[i % 27];
            if (g != NONE) sum = (double)(&parts[GROUPS * (i / 27) + g].sh[0][0])[i % 27];
            probe_off = test_max(probe_off, fabs(sum - (double)(&air.probes[i / 27].sh[0][0])[i % 27]));
        }
        if (g == NONE) probe_mean = (double)probes[0].sh[0][1];
        for (i = 0; i < PROBES * 18 && g == NONE; i++) {
            double sum = 0;
            for (k = 0; k < GROUPS; k++) sum += (double)(&parts[GROUPS * (i / 18) + k].cube[0][0])[i % 18];
            CHECK(fabs(sum - (double)(&probes[i / 18].cube[0][0])[i % 18]) < 1e-5, "the cubes do not add up");
        }
        printf("  probes, %d: off by %.1e\n", g, probe_off / probe_mean);
        CHECK(probe_off < (g == NONE ? 1e-5 : 0.02) * probe_mean, "probes, %d: off by %g of %g", g, probe_off,
              probe_mean);
    }
    for (i = 0; i < PROBES * GROUPS; i++)
        CHECK(parts[i].valid == probes[i / GROUPS].valid && parts[i].sky == probes[i / GROUPS].sky, "probe %d", i);
}

/* >>stores, and changes of lights */

static struct { unsigned char bytes[STREAM]; size_t count, at; } stream;

static size_t put(const void *data, size_t bytes, void *user) {
    (void)user;
    if (bytes > STREAM - stream.count) return 0;
    memcpy(stream.bytes + stream.count, data, bytes);
    stream.count += bytes;
    return bytes;
}

static size_t get(void *data, size_t bytes, void *user) {
    (void)user;
    if (bytes > stream.count - stream.at) return 0;
    memcpy(data, stream.bytes + stream.at, bytes);
    stream.at += bytes;
    return bytes;
}

/* Saved stores contain the groups, and fit only scenes with the same groups. */
TEST(saved_stores_have_groups) {
    static float R[3 * SITES], before[3 * SITES * GROUPS], after[3 * SITES * GROUPS];
    uint64_t print, sum;
    int run;
    room(NONE);
    REQUIRE(set(GROUPS, SKIES) && measure(SBL_MODE_GI, R, before, GROUPS) == SBL_SUCCESS, "%s", watch_last(&seen));
    print = sbl_scene_fingerprint(context);
    stream.count = 0;
    REQUIRE(sbl_save_store(context, put, NULL) == SBL_SUCCESS, "%s", watch_last(&seen));
    for (run = 0; run < 4; run++) {  /* the same scene with another group of a light, of a material, or of the sky */
        stream.at = 0;
        if (run == 1) s.lights[0].light_group = SUNS;
        if (run == 2) s.lights[0].light_group = POINTS;
        if (run == 2) s.materials[2].light_group = SUNS;
        if (run == 3) s.materials[2].light_group = EMITTERS;
        REQUIRE(set(GROUPS, run == 3 ? POINTS : SKIES), "%s", watch_last(&seen));
        CHECK((sbl_load_store(context, get, NULL) == SBL_SUCCESS) == (run == 0), "run %d: %s", run, watch_last(&seen));
        CHECK((sbl_scene_fingerprint(context) == print) == (run == 0), "run %d: the fingerprint is the same", run);
        if (run == 0) {
            CHECK(measure(SBL_MODE_GI, R, after, GROUPS) == SBL_SUCCESS, "%s", watch_last(&seen));
            CHECK(!memcmp(before, after, sizeof before), "loaded groups differ");
        }
    }
    room(NONE);  /* the last group of the last leaf has negative light */
    REQUIRE(set(GROUPS, SKIES), "%s", watch_last(&seen));
    stream.at = 0;
    stream.bytes[stream.count - 9] |= 0x80;
    sum = inside_saved_sum(stream.bytes, stream.count - 8);
    memcpy(stream.bytes + stream.count - 8, &sum, 8);
    CHECK(sbl_load_store(context, get, NULL) == SBL_ERROR_INVALID_ARGUMENT &&
              watch_said(&seen, SBL_LOG_ERROR, SBL_LOG_ITEM_INVALID_STORE, "damaged", NULL, NULL),
          "negative groups are loaded: %s", watch_last(&seen));
    room(NONE);
    stream.at = 0;
    stream.bytes[stream.count - 9] &= 0x7f;
    sum = inside_saved_sum(stream.bytes, stream.count - 8);
    memcpy(stream.bytes + stream.count - 8, &sum, 8);
    REQUIRE(set(0, 0), "%s", watch_last(&seen));
    CHECK(sbl_load_store(context, get, NULL) == SBL_ERROR_INVALID_ARGUMENT &&
              watch_said(&seen, SBL_LOG_ERROR, SBL_LOG_ITEM_OTHER_STORE, "another sky", NULL, NULL),
          "groups are loaded into a scene without them: %s", watch_last(&seen));
}

/* After lights have moved to another group, the groups equal those of a new scene with these lights. */
TEST(lights_change_groups) {
    static float R[3 * SITES], changed[3 * SITES * GROUPS], fresh[3 * SITES * GROUPS];
    double off, mean;
    room(NONE);
    REQUIRE(set(GROUPS, SKIES) && measure(SBL_MODE_GI, R, changed, GROUPS) == SBL_SUCCESS, "%s", watch_last(&seen));
    s.lights[0].light_group = SUNS;
    s.lights[1].light_group = EMITTERS;
    s.materials[2].light_group = POINTS;
    REQUIRE(sbl_set_lights(context, s.lights, s.light_count) == SBL_SUCCESS &&
                sbl_set_materials(context, s.materials, s.material_count) == SBL_SUCCESS &&
                measure(SBL_MODE_GI, R, changed, GROUPS) == SBL_SUCCESS, "%s", watch_last(&seen));
    off = sum_off(R, changed, GROUPS, 3 * SITES, 3 * SITES, &mean);
    CHECK(off < 3e-6, "the sum is off by %g", off);
    REQUIRE(set(GROUPS, SKIES) && measure(SBL_MODE_GI, R, fresh, GROUPS) == SBL_SUCCESS, "%s", watch_last(&seen));
    off = apart(changed, fresh, 3 * SITES * GROUPS);
    printf("  off by %g of %g\n", off, mean);
    CHECK(off < 0.01 * mean, "off by %g, mean %g", off, mean);
}

/* >>mistakes and lack of memory */

static void refused(sbl_result result, sbl_log_item item, const char *words) {
    CHECK(result == SBL_ERROR_INVALID_ARGUMENT && watch_said(&seen, SBL_LOG_ERROR, item, words, NULL, NULL),
          "\"%s\" is not refused: %s", words, watch_last(&seen));
    watch_forget(&seen);
}

static sbl_result set_count(int groups, int sky) {
    sbl_scene_desc desc = scene_desc(&s);
    desc.light_groups = groups;
    desc.sky_group = sky;
    watch_forget(&seen);
    return sbl_set_scene(context, &desc);
}

/* Counts and numbers out of range, and bakes that cannot have groups, are refused with a message. */
TEST(mistakes_with_groups) {
    static float light[3 * VERTICES];
    sbl_lightmap_desc map = map_of(8, 8, SBL_MODE_GI);
    sbl_vertices_desc vertices;
    sbl_readings_desc readings;
    sbl_windows_desc windows;
    room(NONE);
    REQUIRE(set(GROUPS, SKIES), "%s", watch_last(&seen));
    refused(set_count(-1, 0), SBL_LOG_ITEM_INVALID_SCENE_DESC, "light_groups is -1");
    refused(set_count(9, 0), SBL_LOG_ITEM_INVALID_SCENE_DESC, "light_groups is 9");
    refused(set_count(4, 4), SBL_LOG_ITEM_INVALID_SCENE_DESC, "sky_group is 4");
    refused(set_count(4, -1), SBL_LOG_ITEM_INVALID_SCENE_DESC, "sky_group is -1");
    refused(set_count(2, 0), SBL_LOG_ITEM_INVALID_LIGHT, "light_group is 2");
    s.lights[1].light_group = -1;
    refused(set_count(4, 0), SBL_LOG_ITEM_INVALID_LIGHT, "light_group is -1");
    refused(sbl_set_lights(context, s.lights, s.light_count), SBL_LOG_ITEM_INVALID_LIGHT, "light_group is -1");
    s.materials[0].light_group = 5;
    refused(set_count(5, 0), SBL_LOG_ITEM_INVALID_MATERIAL, "light_group is 5");
    refused(sbl_set_materials(context, s.materials, s.material_count), SBL_LOG_ITEM_INVALID_MATERIAL,
            "light_group is 5");
    map.grouped = 2;
    refused(sbl_begin_lightmap(context, &map), SBL_LOG_ITEM_INVALID_LIGHTMAP_DESC, "grouped is 2");
    map.grouped = map.directional = 1;
    refused(sbl_begin_lightmap(context, &map), SBL_LOG_ITEM_INVALID_LIGHTMAP_DESC, "directional and grouped");
    map.directional = 0;
    map.options.backend = SBL_BACKEND_RASTER;
    refused(sbl_begin_lightmap(context, &map), SBL_LOG_ITEM_INVALID_LIGHTMAP_DESC, "only sensors that trace rays");
    map.options.backend = SBL_BACKEND_AUTO;
    memset(&windows, 0, sizeof windows);
    windows.lightmap = map;
    refused(sbl_begin_windows(context, &windows), SBL_LOG_ITEM_INVALID_LIGHTMAP_DESC, "groups[3] is NULL");
    refused(sbl_begin_windows(context, &windows), SBL_LOG_ITEM_INVALID_LIGHTMAP_DESC, "groups[0] is NULL");
    memset(&vertices, 0, sizeof vertices);
    vertices.radiance = vertices.groups = light;
    vertices.float_count = 3 * VERTICES;
    refused(sbl_begin_vertices(context, &vertices), SBL_LOG_ITEM_INVALID_VERTICES_DESC, "group_float_count is 0");
    vertices.group_float_count = 3 * VERTICES;  /* room for one group only */
    refused(sbl_begin_vertices(context, &vertices), SBL_LOG_ITEM_INVALID_VERTICES_DESC, "group_float_count is 600");
    REQUIRE(set_count(0, 0) != SBL_SUCCESS, "groups without a count are accepted");
    room(NONE);
    REQUIRE(set(0, 0), "%s", watch_last(&seen));
    refused(sbl_begin_lightmap(context, &map), SBL_LOG_ITEM_INVALID_LIGHTMAP_DESC, "the scene has no light groups");
    memset(&readings, 0, sizeof readings);
    readings.groups = light;
    refused(sbl_begin_readings(context, &readings), SBL_LOG_ITEM_INVALID_READINGS_DESC,
            "the scene has no light groups");
}

/* The estimate of the memory of a lightmap includes the amounts that ON LIGHT GROUPS states for texels and for the
   store. */
TEST(memory_of_groups_is_as_documented) {
    enum { TOLD = 44, CELL = 12 + 16 + 4 * 24, SMALL = 32, LARGE = 1024 };  /* a cell has up to 4 points at first */
    double need[2][2][3];
    int grouped, gi, size;
    room(NONE);
    REQUIRE(set(GROUPS, SKIES), "%s", watch_last(&seen));
    for (grouped = 0; grouped < 2; grouped++)
        for (gi = 0; gi < 2; gi++)
            for (size = 0; size < 3; size++) {
                sbl_lightmap_desc desc = map_of(size ? size * LARGE : SMALL, size ? LARGE : SMALL,
                                                gi ? SBL_MODE_GI : SBL_MODE_DIRECT);
                desc.grouped = grouped;
                need[grouped][gi][size] = (double)sbl_lightmap_bytes(context, &desc);
            }
    for (gi = 0; gi < 2; gi++) {
        const double more = need[1][gi][2] - need[1][gi][1] - (need[0][gi][2] - need[0][gi][1]);
        CHECK(more >= TOLD * GROUPS * (double)LARGE * LARGE, "%g bytes per texel", more / LARGE / LARGE);
    }
    for (gi = 0; gi < 2; gi++) {
        sbl_lightmap_desc desc = map_of(SMALL, SMALL, gi ? SBL_MODE_GI : SBL_MODE_DIRECT);
        double more;
        REQUIRE(set(0, 0), "%s", watch_last(&seen));
        more = need[0][gi][0] - (double)sbl_lightmap_bytes(context, &desc);
        CHECK(gi ? more >= (double)CELL * GROUPS * cells : more <= 0, "mode %d: groups of the store need %.0f", gi,
              more);
    }
}

/* The estimate of the memory of a lightmap is large enough if textures of sensors with many rays are the largest
   part. */
TEST(memory_is_foretold) {
    sbl_lightmap_desc desc = map_of(4, 4, SBL_MODE_DIRECT);
    double need, before, most = 0;
    sbl_result result = SBL_UNFINISHED;
    scene_free(&s);
    scene_light(&s, SBL_LIGHT_POINT, 1, 2, 3)->position[1] = 1;
    uv_rectangle(&s, scene_floor(&s, scene_material(&s, 0.5f, 0.5f, 0.5f), 0, 2), 0.1f, 0.05f, 0.9f, 0.95f);
    scene_sky(&s, 1, 1, 1);
    desc.grouped = 1;
    desc.options.rays = 4096;
    REQUIRE(set(8, 1), "%s", watch_last(&seen));
    sbl_end(context);
    before = (double)sbl_query_memory(context).gpu_bytes;
    need = (double)sbl_lightmap_bytes(context, &desc);
    REQUIRE(sbl_begin_lightmap(context, &desc) == SBL_SUCCESS, "%s", watch_last(&seen));
    while (result == SBL_UNFINISHED) {
        result = sbl_step(context, 1e-3);
        most = test_max(most, (double)sbl_query_memory(context).gpu_bytes - before);
    }
    CHECK(result == SBL_SUCCESS && most < need && most > 0.5 * need, "%.0f bytes, %.0f foretold", most, need);
}

static float kept[3 * 16 * 8 * 2];

static sbl_result bake_two(const void *desc) {
    sbl_result result = sbl_bake_lightmap(context, (const sbl_lightmap_desc *)desc);
    int g;
    for (g = 0; g < 2 && result == SBL_SUCCESS; g++)
        result = sbl_read_channel(context, (sbl_channel)(SBL_CHANNEL_GROUP_0 + g), kept + 3 * 16 * 8 * g, 3 * 16 * 8);
    if (result != SBL_SUCCESS) sbl_end(context);  /* reading a finished map has failed */
    return result;
}

/* Whichever allocation fails while a lightmap or a store with groups is made, the call reports it and leaks nothing,
   and the next one succeeds. */
TEST(memory_runs_out) {
    static float R[3 * SITES], groups[3 * SITES * 2];
    sbl_lightmap_desc desc = map_of(16, 8, SBL_MODE_DIRECT);
    int count, place;
    desc.grouped = 1;
    desc.tile = 8;
    desc.options.rays = 8;
    scene_free(&s);
    scene_light(&s, SBL_LIGHT_POINT, 1, 2, 3)->position[1] = 1;
    uv_rectangle(&s, scene_floor(&s, scene_material(&s, 0.5f, 0.5f, 0.5f), 0, 2), 0.1f, 0.05f, 0.9f, 0.95f);
    scene_sky(&s, 1, 1, 1);
    REQUIRE(set(2, 1), "%s", watch_last(&seen));
    count = each_allocation_fails(bake_two, &desc, NULL, kept, sizeof kept);
    CHECK(count > 10, "%d allocations failed", count);
    for (place = 1; place < 400; place += 3) {
        sbl_result result;
        REQUIRE(set(2, 1), "%s", watch_last(&seen));
        watch_refuse(&seen, place);
        result = measure(SBL_MODE_GI, R, groups, 2);
        if (!watch_refused(&seen, place, result)) break;
        CHECK(measure(SBL_MODE_GI, R, groups, 2) == SBL_SUCCESS, "allocation %d: %s", place, watch_last(&seen));
    }
    printf("  %d and %d allocations\n", count, place);
    CHECK(place > 20 && place < 400, "%d allocations of a store", place);
}

int main(void) {
    RUN_UNSANITIZED(readings_have_groups);  /* other tests read groups of readings with sanitizers */
    RUN_UNSANITIZED(the_last_group_has_all);
    RUN(invalid_readings_have_no_groups);
    RUN_UNSANITIZED(groups_of_a_furnace);
    RUN_UNSANITIZED(groups_of_textured_walls);
    RUN_UNSANITIZED(groups_of_glows);
    RUN(groups_of_two_lamps);
    RUN(lightmaps_have_groups);
    RUN(groups_of_stored_light);
    RUN_UNSANITIZED(stored_groups_beside_glows);
    RUN(vertices_and_probes_have_groups);
    RUN(saved_stores_have_groups);
    RUN(lights_change_groups);
    RUN(mistakes_with_groups);
    RUN(memory_of_groups_is_as_documented);
    RUN(memory_is_foretold);
    RUN(memory_runs_out);
    scene_free(&s);
    sbl_destroy(context);
    return test_report();
}
