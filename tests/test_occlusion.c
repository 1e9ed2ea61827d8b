/* Tests of ambient occlusion and sky visibility. options.ray_length of sbl.h and the maps of sbl_bake --ao are compared
   with closed forms. */
#define _XOPEN_SOURCE 700
#define _DEFAULT_SOURCE
#include "../sbl.h"
#include "support/test.h"
#include "support/scenes.h"
#include "support/gl_watch.h"
#include "support/one_context.h"

/* A black floor of 4 x 4 touches a black wall of 100 x 100 at its edge x = 0. The sky has a radiance of 1. */
enum { MAP = 32 };

static int set_floor_and_wall(void) {
    static const float floor_corners[] = { 0, 0, -2, 0, 0, 2, 4, 0, 2, 4, 0, -2 };
    static const float wall_corners[] = { 0, 0, -50, 0, 100, -50, 0, 100, 50, 0, 0, 50 };
    static const float map[] = { 0, 0, 0, 1, 1, 1, 1, 0 };
    static const unsigned short quad[] = { 0, 1, 2, 0, 2, 3 };
    sbl_material material;
    sbl_mesh meshes[2];
    sbl_scene_desc scene;
    int i;
    memset(&material, 0, sizeof material);
    memset(meshes, 0, sizeof meshes);
    memset(&scene, 0, sizeof scene);
    for (i = 0; i < 2; i++) {
        meshes[i].positions.data = i ? wall_corners : floor_corners;
        meshes[i].vertex_count = 4;
        meshes[i].indices.data = quad;
        meshes[i].indices.type = SBL_UINT16;
        meshes[i].index_count = 6;
    }
    meshes[0].lightmap_texcoords.data = map;
    scene.meshes = meshes;
    scene.mesh_count = 2;
    scene.materials = &material;
    scene.material_count = 1;
    for (i = 0; i < 3; i++) scene.sky[i] = 1;
    return sbl_set_scene(context, &scene) == SBL_SUCCESS;
}

/* Returns the share of cosine-weighted rays that meet the wall within a distance. Projected onto the floor, these
   directions fill a disc of radius 1 uniformly; the rays that meet the wall are beyond the chord at x / distance. */
static double occlusion_beside_wall(double x, double distance) {
    const double s = x / distance;
    return s < 1 ? 1 - (acos(s) - s * sqrt(1 - s * s)) / TEST_PI : 1;
}

/* Returns the sky visibility beside an infinitely long wall of this height. */
static double sky_beside_wall(double x, double height) { return 0.5 + 0.5 * x / sqrt(x * x + height * height); }

TEST(readings_beside_a_wall) {
    static const double lengths[4] = { 0.25, 0.5, 2, 0 };
    sbl_site site;
    sbl_reading reading;
    sbl_readings_desc desc;
    int i, k;
    REQUIRE(set_floor_and_wall(), "%s", watch_last(&seen));
    memset(&site, 0, sizeof site);
    site.normal[1] = 1;
    desc = scene_readings(&site, &reading, 1, SBL_MODE_DIRECT);
    desc.options.rays = 4096;
    for (i = 0; i < 12; i++) {
        const double x = 0.1 + 0.15 * (i / 4), length = lengths[i % 4];
        const double expected = length > 0 ? occlusion_beside_wall(x, length) : sky_beside_wall(x, 100);
        site.position[0] = (float)x;
        desc.options.ray_length = (float)length;
        REQUIRE(sbl_gather_readings(context, &desc) == SBL_SUCCESS, "%s", watch_last(&seen));
        CHECK(reading.valid, "the reading is not valid");
        for (k = 0; k < 3; k++)
            CHECK(fabs((double)reading.radiance[k] - expected) < 0.004, "distance %g, length %g: %g, expected %g", x,
                  length, (double)reading.radiance[k], expected);
        CHECK(fabs((double)reading.hit_share - 1 + expected) < 0.004, "hit_share is %g", (double)reading.hit_share);
    }
}

TEST(a_map_beside_a_wall) {
    static float map[3 * MAP * MAP];
    sbl_lightmap_desc desc;
    int i, round;
    REQUIRE(set_floor_and_wall(), "%s", watch_last(&seen));
    memset(&desc, 0, sizeof desc);
    desc.width = desc.height = MAP;
    desc.options.mode = SBL_MODE_DIRECT;
    desc.target_error = 0.01f;
    for (round = 0; round < 2; round++) {
        double squares = 0, sum = 0;
        desc.options.ray_length = round ? 1.0f : 0.0f;
        REQUIRE(sbl_bake_lightmap(context, &desc) == SBL_SUCCESS, "%s", watch_last(&seen));
        REQUIRE(sbl_read_channel(context, SBL_CHANNEL_FINAL, map, 3 * MAP * MAP) == SBL_SUCCESS, "no map");
        for (i = 0; i < MAP * MAP; i++) {
            const double x = 4 * (i % MAP + 0.5) / MAP;
            const double expected = round ? occlusion_beside_wall(x, 1) : sky_beside_wall(x, 100);
            squares += pow((double)map[3 * i] - expected, 2);
            sum += expected;
        }
        printf("  root mean square error %.2f %%\n", 100 * sqrt(squares * MAP * MAP) / sum);
        CHECK(sqrt(squares * MAP * MAP) / sum < 0.012, "round %d: error %g", round, sqrt(squares * MAP * MAP) / sum);
    }
}

/* Makes a black floor of 4 x 4 about the origin, which fills the map, under a sky with a radiance of 1. */
static void white_sky_over_floor(test_scene *s) {
    static const float uv[8] = { 0, 0, 0, 1, 1, 1, 1, 0 };
    scene_sky(s, 1, 1, 1);
    scene_floor(s, scene_material(s, 0, 0, 0), 0, 2)->lightmap_texcoords.data = uv;
}

/* Bakes the map of the floor at default settings, without bounces. Returns 0 on failure. */
static int bake_floor(const test_scene *s, float ray_length, float map[3 * MAP * MAP]) {
    const sbl_scene_desc scene = scene_desc(s);
    sbl_lightmap_desc desc;
    memset(&desc, 0, sizeof desc);
    desc.width = desc.height = MAP;
    desc.options.mode = SBL_MODE_DIRECT;
    desc.options.ray_length = ray_length;
    return sbl_set_scene(context, &scene) == SBL_SUCCESS && sbl_bake_lightmap(context, &desc) == SBL_SUCCESS &&
           sbl_read_channel(context, SBL_CHANNEL_FINAL, map, 3 * MAP * MAP) == SBL_SUCCESS;
}

/* The sensors of the first level find occlusion that reaches 4 texels, which is less than the default tile of other
   lightmaps, on both sides of a wall that stands on a floor. */
TEST(narrow_occlusion_is_found) {
    static float map[3 * MAP * MAP];
    test_scene s = { 0 };
    double squares = 0;
    int i;
    white_sky_over_floor(&s);
    scene_quad(&s, 0, -1, 0, -50, -1, 100, -50, -1, 100, 50, -1, 0, 50);
    REQUIRE(bake_floor(&s, 0.5f, map), "%s", watch_last(&seen));
    for (i = 0; i < MAP * MAP; i++) {
        const double x = 4 * (i % MAP + 0.5) / MAP - 2;
        squares += pow((double)map[3 * i] - occlusion_beside_wall(fabs(x + 1), 0.5), 2);
    }
    printf("  root mean square error %.4f\n", sqrt(squares) / MAP);
    CHECK(sqrt(squares) / MAP < 0.03, "error %g", sqrt(squares) / MAP);
    scene_free(&s);
}

/* Texels inside a closed box that stands on the floor get the light of the floor around it, so that filtering shows no
   dark line there. */
TEST(boxes_hide_texels) {
    static float map[3 * MAP * MAP];
    test_scene s = { 0 };
    float inside, outside;
    int i;
    white_sky_over_floor(&s);
    scene_box(&s, 0, -0.5f, -0.2f, -0.5f, 0.5f, 1, 0.5f);
    REQUIRE(bake_floor(&s, 0, map), "%s", watch_last(&seen));
    for (i = 12; i < 20; i++) {
        inside = map[3 * (i * MAP + 12)];
        outside = map[3 * (i * MAP + 11)];
        CHECK(outside > 0.5f && fabs((double)(inside - outside)) < 0.1, "row %d: %g inside, %g outside", i,
              (double)inside, (double)outside);
    }
    scene_free(&s);
}

/* options.ray_length does not limit rays of specular lobes: below a black ceiling they see the ceiling and not the
   sky. */
TEST(reflections_do_not_end) {
    test_scene s = { 0 };
    sbl_scene_desc scene;
    sbl_picture_desc view = scene_view(12, 12, 40, 0, 1, 0.1f, 0, 0, 0);
    float *lobe, *light;
    scene_sky(&s, 1, 1, 1);
    scene_floor(&s, scene_material(&s, 0, 0, 0), 0, 100);
    scene_floor(&s, scene_material(&s, 0, 0, 0), 2, 100);
    s.materials[0].ior = 1.5f;
    s.materials[0].roughness = 0.5f;
    scene = scene_desc(&s);
    view.options.mode = SBL_MODE_DIRECT;
    view.options.ray_length = 1;
    REQUIRE(sbl_set_scene(context, &scene) == SBL_SUCCESS && sbl_render_picture(context, &view) == SBL_SUCCESS, "%s",
            watch_last(&seen));
    lobe = scene_channel(context, &view, SBL_CHANNEL_SPECULAR);
    light = scene_channel(context, &view, SBL_CHANNEL_RADIANCE);
    REQUIRE(lobe && light, "no picture");
    CHECK(fabs((double)light[3 * 78] - 1) < 0.01, "R is %g", (double)light[3 * 78]);
    CHECK((double)lobe[3 * 78] < 0.1, "the light in the lobe is %g", (double)lobe[3 * 78]);
    free(lobe);
    free(light);
    scene_free(&s);
}

/* A sensor inside a body is detected although rays are short. The body is a box whose bottom lies between the floor and
   the sensor, and whose other sides are beyond the length of the rays. */
TEST(stuck_sensors_are_found) {
    test_scene s = { 0 };
    sbl_scene_desc scene;
    sbl_site site;
    sbl_reading reading;
    sbl_readings_desc desc;
    scene_sky(&s, 1, 1, 1);
    scene_floor(&s, scene_material(&s, 0.5f, 0.5f, 0.5f), 0, 5);
    scene_box(&s, 0, -3, 0.02f, -3, 3, 2, 3);
    scene = scene_desc(&s);
    memset(&site, 0, sizeof site);
    site.normal[1] = 1;
    site.offset = 0.05f;
    desc = scene_readings(&site, &reading, 1, SBL_MODE_DIRECT);
    desc.options.ray_length = 0.02f;
    REQUIRE(sbl_set_scene(context, &scene) == SBL_SUCCESS && sbl_gather_readings(context, &desc) == SBL_SUCCESS, "%s",
            watch_last(&seen));
    CHECK(!reading.valid, "a sensor in a box is valid: R is %g, back_share %g", (double)reading.radiance[0],
          (double)reading.back_share);
    scene_free(&s);
}

TEST(what_cannot_be_is_refused) {
    static const sbl_mode modes[] = { SBL_MODE_GI, SBL_MODE_AMBIENT };
    const float at[3] = { 1, 1, 0 };
    sbl_lightmap_desc map;
    sbl_readings_desc readings;
    sbl_probes_desc probes;
    sbl_probe probe;
    int i;
    REQUIRE(set_floor_and_wall(), "%s", watch_last(&seen));
    memset(&map, 0, sizeof map);
    map.width = map.height = 4;
    map.options.ray_length = 1;
    for (i = 0; i < 2; i++) {
        map.options.mode = modes[i];
        CHECK(sbl_bake_lightmap(context, &map) != SBL_SUCCESS && strstr(watch_last(&seen), "needs SBL_MODE_DIRECT"),
              "mode %d: %s", (int)modes[i], watch_last(&seen));
    }
    map.options.mode = SBL_MODE_DIRECT;
    map.options.backend = SBL_BACKEND_RASTER;
    CHECK(sbl_bake_lightmap(context, &map) != SBL_SUCCESS && strstr(watch_last(&seen), "that trace rays"), "views: %s",
          watch_last(&seen));
    map.options.backend = SBL_BACKEND_AUTO;
    map.options.ray_length = -1;
    CHECK(sbl_bake_lightmap(context, &map) != SBL_SUCCESS && strstr(watch_last(&seen), "ray_length is -1"), "-1: %s",
          watch_last(&seen));
    memset(&readings, 0, sizeof readings);
    readings.options.mode = SBL_MODE_DIRECT;
    readings.options.ray_length = 1;
    readings.sensor_kind = SBL_SENSOR_SINGLE;
    CHECK(sbl_gather_readings(context, &readings) != SBL_SUCCESS && strstr(watch_last(&seen), "SBL_SENSOR_SINGLE"),
          "single views: %s", watch_last(&seen));
    memset(&probes, 0, sizeof probes);
    probes.positions = at;
    probes.probes = &probe;
    probes.probe_count = 1;
    probes.options.mode = SBL_MODE_DIRECT;
    probes.options.ray_length = 1;
    CHECK(sbl_bake_probes(context, &probes) != SBL_SUCCESS && strstr(watch_last(&seen), "not for probes"), "probes: %s",
          watch_last(&seen));
}

int main(void) {
    const sbl_context_desc own = watch_desc(&seen);
    if (sbl_create(&own, &context) != SBL_SUCCESS) {
        printf("no OpenGL: %s\n0 passed, 1 failed, 0 skipped\n", watch_last(&seen));
        return 1;
    }
    RUN(readings_beside_a_wall);
    RUN(a_map_beside_a_wall);
    RUN(narrow_occlusion_is_found);
    RUN(boxes_hide_texels);
    RUN(reflections_do_not_end);
    RUN(stuck_sensors_are_found);
    RUN(what_cannot_be_is_refused);
    sbl_destroy(context);
    return test_report();
}
