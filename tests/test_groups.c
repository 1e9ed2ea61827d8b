/* Tests of light groups: they add up to the whole light, and each is the light of a scene that has only the lights of
   this group. */
#include "../sbl.h"
#include "support/test.h"
#include "support/scenes.h"
#include "support/reference.h"
#include "support/gl_watch.h"
#include "support/lightmap.h"

enum { GROUPS = 4, SITES = 24, NONE = -1 };
enum { EMITTERS, POINTS, SUNS, SKIES };  /* the groups of `room` */

/* Makes a room with a window in the ceiling, a box on the floor, and lights of all kinds, each with its own group.
   only: a group whose lights are on, while those of other groups are off; NONE: all are on */
static void room(test_scene *s, int only) {
    const int white = scene_material(s, 0.7f, 0.7f, 0.7f), red = scene_material(s, 0.7f, 0.3f, 0.2f);
    const int lamp = scene_lamp(s, only == NONE || only == EMITTERS ? 6 : 0, only == NONE || only == EMITTERS ? 4 : 0, 0);
    sbl_light *light;
    s->materials[lamp].light_group = EMITTERS;
    uv_rectangle(s, scene_quad(s, white, -1, 0, -1, -1, 0, 1, 1, 0, 1, 1, 0, -1), 0.02f, 0.02f, 0.48f, 0.98f);
    uv_rectangle(s, scene_quad(s, red, -1, 0, -1, -1, 2, -1, -1, 2, 1, -1, 0, 1), 0.52f, 0.02f, 0.98f, 0.98f);
    scene_quad(s, white, 1, 0, -1, 1, 0, 1, 1, 2, 1, 1, 2, -1);
    scene_quad(s, white, -1, 0, -1, 1, 0, -1, 1, 2, -1, -1, 2, -1);
    scene_quad(s, white, -1, 2, -1, 0, 2, -1, 0, 2, 1, -1, 2, 1);
    scene_box(s, white, -0.6f, 0, -0.5f, -0.1f, 0.7f, 0.1f);
    scene_quad(s, lamp, -0.9f, 1.9f, -0.4f, -0.5f, 1.9f, -0.4f, -0.5f, 1.9f, 0.2f, -0.9f, 1.9f, 0.2f);
    light = scene_light(s, SBL_LIGHT_POINT, 0.4f, 0.6f, 1);
    light->position[0] = 0.6f; light->position[1] = 0.8f; light->position[2] = -0.5f;
    light->radius = 0.05f;
    light->light_group = POINTS;
    if (only != NONE && only != POINTS) memset(light->intensity, 0, sizeof light->intensity);
    light = scene_light(s, SBL_LIGHT_DIRECTIONAL, 3, 2.5f, 2);
    light->direction[0] = -0.3f; light->direction[1] = -1; light->direction[2] = 0.2f;
    light->light_group = SUNS;
    if (only != NONE && only != SUNS) memset(light->intensity, 0, sizeof light->intensity);
    if (only == NONE || only == SKIES) scene_sky(s, 0.5f, 0.7f, 1);
}

static sbl_scene_desc grouped(const test_scene *s, int groups) {
    sbl_scene_desc desc = scene_desc(s);
    desc.light_groups = groups;
    desc.sky_group = groups ? SKIES : 0;
    return desc;
}

/* Makes the context if there is none. */
static int use_context(void) {
    static test_scene empty;
    return context || use_scene(&empty);
}

/* Sites on floor and walls. */
static void sites_of(sbl_site sites[SITES]) {
    int i;
    memset(sites, 0, SITES * sizeof *sites);
    for (i = 0; i < SITES; i++) {
        const float a = (float)(i % 6) / 3 - 0.8f, b = (float)(i / 6) / 2 - 0.7f;
        sites[i].position[0] = i % 2 ? a : -0.999f;
        sites[i].position[1] = i % 2 ? 0.001f : a + 1;
        sites[i].position[2] = b;
        sites[i].normal[i % 2] = 1;
    }
}

/* Light groups of readings add up to R, which has the bits of readings without groups, and each is the light of a
   scene with only its lights. */
TEST(readings_have_groups) {
    static const sbl_mode modes[2] = { SBL_MODE_DIRECT, SBL_MODE_GI };
    int run, i, k, g;
    for (run = 0; run < 2; run++) {
        static test_scene s;
        sbl_site sites[SITES];
        sbl_reading whole[SITES], plain[SITES], alone[SITES];
        static float groups[SITES * GROUPS * 3];
        sbl_readings_desc desc;
        sbl_scene_desc scene;
        double sum_off = 0, mean = 0;
        memset(&s, 0, sizeof s);
        memset(&desc, 0, sizeof desc);
        sites_of(sites);
        room(&s, NONE);
        REQUIRE(use_context(), "no context: %s", watch_last(&seen));
        desc.sites = sites;
        desc.site_count = SITES;
        desc.options.mode = modes[run];
        desc.options.preset = SBL_PRESET_HIGH;
        desc.readings = plain;
        scene = grouped(&s, 0);
        for (i = 0; i < s.light_count; i++) s.lights[i].light_group = 0;
        REQUIRE(sbl_set_scene(context, &scene) == SBL_SUCCESS, "%s", watch_last(&seen));
        REQUIRE(sbl_gather_readings(context, &desc) == SBL_SUCCESS, "%s", watch_last(&seen));
        scene_free(&s);
        room(&s, NONE);
        scene = grouped(&s, GROUPS);
        desc.readings = whole;
        desc.groups = groups;
        REQUIRE(sbl_set_scene(context, &scene) == SBL_SUCCESS, "%s", watch_last(&seen));
        REQUIRE(sbl_gather_readings(context, &desc) == SBL_SUCCESS, "%s", watch_last(&seen));
        scene_free(&s);
        for (i = 0; i < SITES; i++)
            for (k = 0; k < 3; k++) {
                double sum = 0;
                for (g = 0; g < GROUPS; g++) sum += (double)groups[3 * (GROUPS * i + g) + k];
                sum_off = test_max(sum_off, fabs(sum - (double)whole[i].radiance[k]));
                mean += (double)whole[i].radiance[k] / (3 * SITES);
                CHECK(whole[i].radiance[k] == plain[i].radiance[k], "site %d: %g instead of %g", i,
                      (double)whole[i].radiance[k], (double)plain[i].radiance[k]);
            }
        printf("  %s: sum off by %.1e of the mean\n", run ? "all light" : "direct", sum_off / mean);
        CHECK(sum_off < 2e-6 * mean, "sum is off by %g, mean %g", sum_off, mean);
        desc.groups = NULL;
        desc.readings = alone;
        for (g = 0; g < GROUPS; g++) {
            double off = 0, noise = 0, light = 0;
            room(&s, g);
            scene = grouped(&s, 0);
            for (i = 0; i < s.light_count; i++) s.lights[i].light_group = 0;
            REQUIRE(sbl_set_scene(context, &scene) == SBL_SUCCESS, "%s", watch_last(&seen));
            REQUIRE(sbl_gather_readings(context, &desc) == SBL_SUCCESS, "%s", watch_last(&seen));
            scene_free(&s);
            for (i = 0; i < SITES; i++) {
                for (k = 0; k < 3; k++) off += pow((double)(groups[3 * (GROUPS * i + g) + k] - alone[i].radiance[k]), 2);
                for (k = 0; k < 3; k++) light += (double)alone[i].radiance[k];
                noise += 3 * pow((double)whole[i].noise, 2) + 3 * pow((double)alone[i].noise, 2);
            }
            off = sqrt(off / (3 * SITES));
            noise = sqrt(noise / (3 * SITES));
            light /= 3 * SITES;
            printf("    group %d: off by %.4f, noise %.4f, mean %.4f\n", g, off, noise, light);
            CHECK(off < 1.5 * noise + 0.015 * light, "group %d is off by %g; noise %g, mean %g", g, off, noise, light);
        }
    }
}

/* Bakes a lightmap of the room and returns its FINAL, which the caller frees; NULL on failure. */
static float *bake_room(int only, int groups, const sbl_lightmap_desc *desc) {
    static test_scene s;
    sbl_scene_desc scene;
    float *out = NULL;
    int i;
    memset(&s, 0, sizeof s);
    room(&s, only);
    for (i = 0; i < s.light_count && !groups; i++) s.lights[i].light_group = 0;
    scene = grouped(&s, groups);
    if (!use_context()) { CHECK(0, "no context: %s", watch_last(&seen)); return NULL; }
    CHECK(sbl_set_scene(context, &scene) == SBL_SUCCESS, "%s", watch_last(&seen));
    if (sbl_bake_lightmap(context, desc) == SBL_SUCCESS) out = channel_of(desc, SBL_CHANNEL_FINAL);
    CHECK(out != NULL, "%s", watch_last(&seen));
    scene_free(&s);
    return out;
}

/* Light groups of a lightmap add up to FINAL, which has the bits of a lightmap without groups, and each is the lightmap
   of a scene with only its lights. */
TEST(lightmaps_have_groups) {
    enum { SIZE = 32, TEXELS = SIZE * SIZE / 2 };
    sbl_lightmap_desc desc = map_of(SIZE, SIZE / 2, SBL_MODE_GI);
    float *plain, *whole, *group[GROUPS], *alone;
    double sum_off = 0, mean = 0;
    int i, g;
    desc.target_error = 0.02f;
    plain = bake_room(NONE, 0, &desc);
    desc.grouped = 1;
    whole = bake_room(NONE, GROUPS, &desc);
    for (g = 0; g < GROUPS; g++) group[g] = channel_of(&desc, (sbl_channel)(SBL_CHANNEL_GROUP_0 + g));
    REQUIRE(plain && whole && group[GROUPS - 1], "no lightmap");
    CHECK(!memcmp(plain, whole, 3 * TEXELS * sizeof *plain), "groups change the whole");
    for (i = 0; i < 3 * TEXELS; i++) {
        double sum = 0;
        for (g = 0; g < GROUPS; g++) {
            sum += (double)group[g][i];
            CHECK(group[g][i] >= 0, "group %d is negative", g);
        }
        sum_off = test_max(sum_off, fabs(sum - (double)whole[i]));
        mean += (double)whole[i] / (3 * TEXELS);
    }
    printf("  sum off by %.1e of the mean\n", sum_off / mean);
    CHECK(sum_off < 2e-6 * mean, "sum is off by %g, mean %g", sum_off, mean);
    desc.grouped = 0;
    for (g = 0; g < GROUPS; g++) {
        double off = 0, light = 0;
        alone = bake_room(g, 0, &desc);
        REQUIRE(alone, "no lightmap");
        for (i = 0; i < 3 * TEXELS; i++) {
            off += pow((double)(group[g][i] - alone[i]), 2);
            light += (double)alone[i];
        }
        off = sqrt(off / (3 * TEXELS));
        light /= 3 * TEXELS;
        printf("    group %d: off by %.4f, mean %.4f of %.4f\n", g, off, light, mean);
        CHECK(off < 0.02 * mean + 0.02 * light, "group %d is off by %g, mean %g", g, off, light);
        free(alone);
        free(group[g]);
    }
    free(plain);
    free(whole);
}

int main(void) {
    RUN(lightmaps_have_groups);
    RUN(readings_have_groups);
    return test_report();
}
