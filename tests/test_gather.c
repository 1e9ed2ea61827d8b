/* Tests sbl_gather_readings. At the site of a pixel, the reading equals the light of the pixel to the bit, because
   pictures use the same measurement. At other sites, readings are compared with closed forms. Also tests what tools
   conclude from readings (tool_survey.h). */
#include "../sbl.h"
#include "support/test.h"
#include "support/scenes.h"
#include "support/gl_watch.h"

static sbl_result work(sbl_context *c) {
    sbl_result result = SBL_UNFINISHED;
    while (result == SBL_UNFINISHED) result = sbl_step(c, 0);
    return result;
}

#include "../examples/tool_survey.h"
#include "support/one_context.h"

static sbl_site site_of(float x, float y, float z, float nx, float ny, float nz) {
    sbl_site s;
    memset(&s, 0, sizeof s);
    s.position[0] = x; s.position[1] = y; s.position[2] = z;
    s.normal[0] = nx; s.normal[1] = ny; s.normal[2] = nz;
    return s;
}

/* Returns the reading at one site of the current scene. */
static sbl_reading reading_at(sbl_site site, int rays) {
    sbl_reading r;
    sbl_readings_desc desc = scene_readings(&site, &r, 1, SBL_MODE_DIRECT);
    desc.options.rays = rays;
    memset(&r, 0xff, sizeof r);
    CHECK(sbl_gather_readings(context, &desc) == SBL_SUCCESS, "no reading: %s", watch_last(&seen));
    return r;
}

/* >>comparison with pictures */

enum { WIDTH = 20, HEIGHT = 15, PIXELS = WIDTH * HEIGHT };

static sbl_picture_desc every_pixel(sbl_mode mode, sbl_backend backend) {
    sbl_picture_desc view = scene_plain(scene_cornell_view(WIDTH, HEIGHT), mode, 16);
    view.options.backend = backend;
    view.options.rays = 64;
    view.options.seed = 7;
    return view;
}

static sbl_readings_desc gather_as(const sbl_picture_desc *view, const sbl_site *sites, sbl_reading *readings) {
    sbl_readings_desc desc = scene_readings(sites, readings, PIXELS, view->options.mode);
    desc.options.backend = view->options.backend;
    desc.options.rays = view->options.rays;
    desc.options.sensor_size = view->options.sensor_size;
    desc.options.epsilon = view->options.epsilon;
    desc.options.seed = view->options.seed;
    return desc;
}

/* Readings at the sites of the sensors of a picture equal its R, in all modes and back ends. */
TEST(readings_equal_the_picture) {
    static const struct { sbl_mode mode; sbl_backend backend; } ways[] = {
        { SBL_MODE_DIRECT, SBL_BACKEND_TRACE }, { SBL_MODE_AMBIENT, SBL_BACKEND_TRACE },
        { SBL_MODE_AMBIENT, SBL_BACKEND_RASTER }, { SBL_MODE_PAPER, SBL_BACKEND_RASTER } };
    static sbl_site sites[PIXELS];
    static sbl_reading readings[PIXELS], again[PIXELS];
    test_scene s = { 0 };
    int i, w;
    scene_cornell_box(&s);
    for (w = 0; w < 4; w++) {
        const sbl_picture_desc view = every_pixel(ways[w].mode, ways[w].backend);
        sbl_readings_desc desc = gather_as(&view, sites, readings);
        float *radiance;
        int same = 0, lit = 0, noisy = 0, shown = 0, close = 0;
        REQUIRE(use_scene(&s) && sbl_render_picture(context, &view) == SBL_SUCCESS, "no picture: %s",
                watch_last(&seen));
        radiance = scene_channel(context, &view, SBL_CHANNEL_RADIANCE);
        REQUIRE(radiance, "no radiance");
        for (i = 0; i < PIXELS; i++) {
            sbl_sensor sensor;
            sites[i] = site_of(278, 100, 278, 0, 1, 0);  /* a placeholder for pixels that show no surface */
            if (sbl_inspect_sensor(context, i % WIDTH, i / WIDTH, &sensor, NULL, NULL, 0) == SBL_SUCCESS) {
                sites[i] = sensor.site;
                shown++;
            }
        }
        REQUIRE(sbl_gather_readings(context, &desc) == SBL_SUCCESS, "no gather: %s", watch_last(&seen));
        for (i = 0; i < PIXELS; i++) {
            if (sites[i].position[0] == 278 && sites[i].position[1] == 100) continue;
            same += memcmp(readings[i].radiance, radiance + 3 * i, sizeof readings[i].radiance) == 0;
            close += fabsf(readings[i].radiance[0] - radiance[3 * i]) < 1e-4f * radiance[3 * i] + 1e-6f;
            lit += readings[i].radiance[0] > 0.01f;
            noisy += readings[i].noise > 0;
        }
        CHECK(shown > PIXELS / 2 && close > shown * 98 / 100, "way %d: %d of %d readings are close to the picture's", w,
              close, shown);
        /* rasterised views have other places in the view texture, and round differently */
        if (view.options.backend == SBL_BACKEND_TRACE)
            CHECK(same == shown, "way %d: %d of %d readings equal the picture's R to the bit", w, same, shown);
        CHECK(lit > PIXELS / 4, "way %d: %d pixels are lit", w, lit);
        CHECK((noisy > 0) == (ways[w].mode != SBL_MODE_PAPER), "way %d: noise is not 0 at %d pixels", w, noisy);
        desc.readings = again;
        desc.options.seed = 8;
        CHECK(sbl_gather_readings(context, &desc) == SBL_SUCCESS, "no gather: %s", watch_last(&seen));
        CHECK((memcmp(again, readings, sizeof again) != 0) == (ways[w].mode != SBL_MODE_PAPER),
              "way %d: another seed changes nothing", w);
        free(radiance);
    }
    scene_free(&s);
}

/* >>comparison with closed forms */

/* R of an open sky and of point lights equals the closed form, and an empty scene has no hits. */
TEST(sky_and_lights) {
    test_scene s = { 0 };
    sbl_light *light;
    sbl_reading r;
    const float up[3][3] = { { 0, 1, 0 }, { 0.6f, 0.8f, 0 }, { 0, 0, -1 } };
    int i;
    scene_sky(&s, 1, 2, 3);
    REQUIRE(use_scene(&s), "no scene");
    for (i = 0; i < 3; i++) {
        r = reading_at(site_of(4, -5, 6, up[i][0], up[i][1], up[i][2]), 16);
        CHECK(r.radiance[0] == 1 && r.radiance[1] == 2 && r.radiance[2] == 3, "R under a sky of 1 2 3 is %g %g %g",
              (double)r.radiance[0], (double)r.radiance[1], (double)r.radiance[2]);
        CHECK(r.hit_share == 0 && r.hit_mean == 0 && r.hit_min == 0 && r.back_share == 0 && r.valid == 1,
              "a hit is reported in an empty scene");
    }
    scene_sky(&s, 0, 0, 0);
    light = scene_light(&s, SBL_LIGHT_POINT, 10, 20, 30);
    light->position[1] = 2;
    REQUIRE(use_scene(&s), "no scene");
    r = reading_at(site_of(0, 0, 0, 0, 1, 0), 16);
    CHECK(fabs(r.radiance[0] / (10 / 4.0 / SCENE_PI) - 1) < 1e-5, "a point light: R is %.7g, expected %.7g",
          (double)r.radiance[0], 10 / 4.0 / SCENE_PI);
    r = reading_at(site_of(2, 0, 0, 0, 1, 0), 16);
    CHECK(fabs(r.radiance[1] / (20 / 8.0 * sqrt(0.5) / SCENE_PI) - 1) < 1e-5, "from the side: R is %.7g, expected %.7g",
          (double)r.radiance[1],
          20 / 8.0 * sqrt(0.5) / SCENE_PI);
    CHECK(reading_at(site_of(0, 3, 0, 0, 1, 0), 16).radiance[0] == 0, "light from below the horizon");
    scene_free(&s);
}

/* 300 suns shine in all directions, most of them from below, on ground far above the origin. So many lamps are measured
   in clusters; the cluster of all suns has its middle below the ground. R is the sum of the cosines of those above. */
TEST(suns_in_clusters) {
    enum { SUNS = 300 };
    static sbl_light suns[SUNS];
    test_scene s = { 0 };
    sbl_scene_desc scene;
    double expected[3] = { 0, 0, 0 };
    sbl_reading r;
    int i, k;
    scene_floor(&s, scene_material(&s, 0.5f, 0.5f, 0.5f), 10, 1);
    REQUIRE(use_scene(&s), "no scene");
    scene = scene_desc(&s);
    for (i = 0; i < SUNS; i++) {
        const double up = -1 + 1.7 * (i + 0.5) / SUNS, across = sqrt(1 - up * up);
        suns[i].kind = SBL_LIGHT_DIRECTIONAL;
        suns[i].direction[0] = (float)(-across * cos(2.4 * i));
        suns[i].direction[1] = (float)-up;
        suns[i].direction[2] = (float)(-across * sin(2.4 * i));
        for (k = 0; k < 3; k++) {
            suns[i].intensity[k] = (float)(1 + (i + k) % 3);
            expected[k] += fmax(up, 0) * (double)suns[i].intensity[k] / TEST_PI;
        }
    }
    scene.lights = suns;
    scene.light_count = SUNS;
    REQUIRE(sbl_set_scene(context, &scene) == SBL_SUCCESS, "%s", watch_last(&seen));
    r = reading_at(site_of(0.1f, 10, 0.2f, 0, 1, 0), 1024);
    for (k = 0; k < 3; k++)
        CHECK(fabs((double)r.radiance[k] / expected[k] - 1) < 0.01, "R[%d] is %g, not %g", k, (double)r.radiance[k],
              expected[k]);
    scene_free(&s);
}

/* A site is above the centre of a disc of angular radius t, at the height h. The disc's cosine-weighted share of the
   hemisphere is sin^2 t, and the mean distance over it is 2 h / (1 + cos t). */
TEST(distances_to_a_disc) {
    static const double angles[] = { 20, 45, 70, 85 };
    test_scene s = { 0 };
    const float centre[3] = { 0, 0, 0 };
    int i;
    for (i = 0; i < 4; i++) {
        const double t = angles[i] * SCENE_PI / 180, h = 2;
        const float u[3] = { (float)(h * tan(t)), 0, 0 }, v[3] = { 0, 0, (float)(h * tan(t)) };
        sbl_reading r, back;
        scene_disc(&s, scene_material(&s, 0.5f, 0.5f, 0.5f), centre, u, v, 2048);
        REQUIRE(use_scene(&s), "no scene");
        r = reading_at(site_of(0, (float)h, 0, 0, -1, 0), 4096);
        back = reading_at(site_of(0, -(float)h, 0, 0, 1, 0), 4096);
        CHECK(fabs(r.hit_share / (sin(t) * sin(t)) - 1) < 0.005, "%g degrees: share %g, expected %g", angles[i],
              (double)r.hit_share, sin(t) * sin(t));
        CHECK(fabs(r.hit_mean / (2 * h / (1 + cos(t))) - 1) < 0.005, "%g degrees: mean distance %g, expected %g",
              angles[i], (double)r.hit_mean,
              2 * h / (1 + cos(t)));
        CHECK(r.hit_min >= h * 0.9999 && r.hit_min < 1.002 * h, "%g degrees: least distance %g, expected %g", angles[i],
              (double)r.hit_min, h);
        CHECK(r.back_share + back.back_share == 1, "back_share of the two sides is %g and %g, expected 0 and 1",
              (double)r.back_share,
              (double)back.back_share);
        scene_free(&s);
    }
}

/* R of a quad lamp above agrees with Lambert's formula, also if a wall hides half of the lamp. The noise is 0 without a
   shadow, and agrees with the error with one. */
TEST(lamps_and_noise) {
    test_scene s = { 0 };
    sbl_reading r;
    int grey = scene_material(&s, 0.5f, 0.5f, 0.5f), lamp = scene_lamp(&s, 3, 3, 3);
    /* four corners of a x a (Howell, B-4) */
    double a = 0.5, h = 2, form = 4 * a / sqrt(a * a + h * h) * atan(a / sqrt(a * a + h * h)) / SCENE_PI;
    scene_quad(&s, lamp, -0.5f, 2, -0.5f, 0.5f, 2, -0.5f, 0.5f, 2, 0.5f, -0.5f, 2, 0.5f);
    scene_floor(&s, grey, 0, 4);
    REQUIRE(use_scene(&s), "no scene");
    r = reading_at(site_of(0, 0, 0, 0, 1, 0), 256);
    CHECK(fabs(r.radiance[0] / (3 * form) - 1) < 1e-4, "R is %.7g, expected %.7g", (double)r.radiance[0], 3 * form);
    CHECK(r.noise < 1e-4f * r.radiance[0], "the lamp is not occluded, but the noise is %g", (double)r.noise);
    /* few rays, which find no light but measure the distance to the floor */
    r = reading_at(site_of(0, 0.25f, 0, 0, -1, 0), 0);
    CHECK(r.hit_share > 0.9f && fabs(r.hit_min - 0.25) < 0.1, "the share of the floor is %g, its distance %g",
          (double)r.hit_share, (double)r.hit_min);
    scene_quad(&s, grey, 0, 0.5f, -1, 0, 1.5f, -1, 0, 1.5f, 1, 0, 0.5f, 1);
    scene_quad(&s, grey, 0, 0.5f, -1, -2, 0.5f, -1, -2, 0.5f, 1, 0, 0.5f, 1);
    REQUIRE(use_scene(&s), "no scene");
    r = reading_at(site_of(0, 0, 0, 0, 1, 0), 256);
    CHECK(fabs(r.radiance[0] / (1.5 * form) - 1) < 0.03, "half of the lamp: R is %.7g, expected %.7g",
          (double)r.radiance[0], 1.5 * form);
    CHECK(r.noise > 1e-5f && fabs(r.radiance[0] - 1.5 * form) < 5 * r.noise, "off by %g, noise %g",
          fabs(r.radiance[0] - 1.5 * form), (double)r.noise);
    scene_free(&s);
}

/* A lamp shines through another lamp at the same place that is cut out everywhere, in whatever order they are given. */
TEST(lamps_shine_through_holes_in_others) {
    static const unsigned char clear[4] = { 255, 255, 255, 0 };
    const double form = 4 / sqrt(17.0) * atan(0.5 / sqrt(4.25)) / SCENE_PI;  /* as above */
    int way, i;
    for (way = 0; way < 2; way++) {
        test_scene s = { 0 };
        const int lamps[2] = { scene_lamp(&s, 3, 3, 3), scene_lamp(&s, 7, 7, 7) };
        sbl_scene_desc desc;
        sbl_reading r;
        s.materials[lamps[1]].albedo_texture = scene_texture(&s, clear, sizeof clear, SBL_PIXELS_SRGB8, 1, 1, 4);
        s.materials[lamps[1]].alpha_cutoff = 0.5f;
        for (i = 0; i < 2; i++)
            scene_quad(&s, lamps[i ^ way], -0.5f, 2, -0.5f, 0.5f, 2, -0.5f, 0.5f, 2, 0.5f, -0.5f, 2, 0.5f);
        desc = scene_desc(&s);
        REQUIRE((context || use_scene(&s)) && sbl_set_scene(context, &desc) == SBL_SUCCESS, "no scene");
        r = reading_at(site_of(0, 0, 0, 0, 1, 0), 2048);
        CHECK(fabs((double)r.radiance[0] / (3 * form) - 1) < 0.01, "the lamp comes %s: R is %.7g, expected %.7g",
              way ? "last" : "first", (double)r.radiance[0], 3 * form);
        scene_free(&s);
    }
}

/* >>sites */

/* The length of the normal of a site does not change the reading. */
TEST(normals_of_any_length) {
    test_scene s = { 0 };
    sbl_site site = site_of(300, 0, 200, 0, 1, 0);
    sbl_reading unit, other;
    scene_cornell_box(&s);
    REQUIRE(use_scene(&s), "no scene");
    unit = reading_at(site, 64);
    CHECK(unit.radiance[0] > 0.1f && unit.valid, "no light on the floor");
    site.normal[1] = 1e-20f;
    other = reading_at(site, 64);
    CHECK(memcmp(&unit, &other, sizeof unit) == 0, "a short normal changes the reading");
    site.normal[1] = 3e30f;
    site.geometric_normal[1] = 17;
    other = reading_at(site, 64);
    CHECK(memcmp(&unit, &other, sizeof unit) == 0, "a long normal changes the reading");
    scene_free(&s);
}

/* A closed box floats above the floor. A sensor whose offset is larger than the gap is inside the box. */
TEST(offsets_and_validity) {
    test_scene s = { 0 };
    sbl_site site = site_of(0, 0, 0, 0, 1, 0);
    int grey = scene_material(&s, 0.5f, 0.5f, 0.5f);
    scene_sky(&s, 1, 1, 1);
    scene_floor(&s, grey, 0, 10);
    scene_box(&s, grey, -1, 0.01f, -1, 1, 1, 1);
    REQUIRE(use_scene(&s), "no scene");
    site.offset = 0.002f;
    CHECK(reading_at(site, 64).valid == 1, "a sensor in the gap is reported as invalid");
    CHECK(fabs(reading_at(site, 64).hit_min - 0.008f) < 2e-3, "the box is %g away",
          (double)reading_at(site, 64).hit_min);
    site.offset = 0.02f;
    CHECK(reading_at(site, 64).valid == 0, "a sensor in the box is not reported as invalid");
    site.geometric_normal[1] = -1;
    CHECK(reading_at(site, 64).hit_min < 0.022f, "the other side of the floor is %g away",
          (double)reading_at(site, 64).hit_min);
    site.geometric_normal[1] = 0;
    site.position[1] = 0.005f;
    site.offset = -1;
    CHECK(fabs(reading_at(site, 64).hit_min - 0.005f) < 1e-3, "without an offset the box is %g away",
          (double)reading_at(site, 64).hit_min);
    site.position[1] = 0.01f - 3e-5f;  /* closer to the box than the default offset */
    CHECK(reading_at(site, 64).hit_min < 0.01f, "without an offset the sensor is moved, and the nearest surface is %g "
          "away",
          (double)reading_at(site, 64).hit_min);
    site.offset = 0;
    CHECK(reading_at(site, 64).hit_min > 0.5f, "by default the sensor is not moved");
    site.position[1] = 0;
    site.position[0] = 5;
    CHECK(reading_at(site, 256).radiance[0] > 0.7f && reading_at(site, 256).valid,
          "R of the open floor is too small, or invalid");
    scene_free(&s);
}

/* Two infinite black walls meet in a corner under a constant sky. Between them, R is a quarter. A wall whose plane
   contains the sensor hides nothing: R is three quarters in the plane of one wall, and 1 in the corner itself. Such a
   wall projects to a line and must not be drawn into the other views of the sensor. */
TEST(in_the_planes_of_walls) {
    enum { SITES = 600 };
    static sbl_site sites[SITES];
    static sbl_reading readings[SITES];
    int turned, i, backend;
    for (turned = 0; turned < 2; turned++) for (backend = SBL_BACKEND_RASTER; backend <= SBL_BACKEND_TRACE; backend++) {
        const float far_off = 1e4f, c = turned ? cosf(0.3f) : 1, d = turned ? sinf(0.3f) : 0;
        test_scene s = { 0 };
        const int black = scene_material(&s, 0, 0, 0);
        sbl_readings_desc desc = scene_readings(sites, readings, SITES, SBL_MODE_DIRECT);
        double worst[3] = { 0, 0, 0 };
        scene_sky(&s, 1, 1, 1);
        scene_quad(&s, black, 0, -1, 0, c * far_off, -1, d * far_off, c * far_off, far_off, d * far_off, 0, far_off, 0);
        scene_quad(&s, black, 0, -1, 0, -d * far_off, -1, c * far_off, -d * far_off, far_off, c * far_off, 0, far_off,
                   0);
        REQUIRE(use_scene(&s), "no scene");
        for (i = 0; i < SITES; i++) {
            const float x = i % 3 > 1 ? 0.01f * (float)i : 0, z = i % 3 > 0 ? 50 + 0.02f * (float)i : 0;
            sites[i] = site_of(c * x - d * z, 0.001f * (float)i, d * x + c * z, 0, 1, 0);
            sites[i].offset = -1;
        }
        desc.options.mode = SBL_MODE_AMBIENT;
        desc.options.backend = (sbl_backend)backend;
        desc.options.sensor_size = 32;
        desc.options.rays = 1024;
        REQUIRE(sbl_gather_readings(context, &desc) == SBL_SUCCESS, "no gather: %s", watch_last(&seen));
        for (i = 0; i < SITES; i++) {
            const double expected[3] = { 1, 0.75, 0.25 }, error = fabs(readings[i].radiance[0] / expected[i % 3] - 1);
            worst[i % 3] = error > worst[i % 3] ? error : worst[i % 3];
        }
        CHECK(worst[0] < 0.03 && worst[1] < 0.1 && worst[2] < 0.06, "%s of the sky: off by up to %g, %g, %g", backend ==
              SBL_BACKEND_RASTER ? "views" : "rays",
              worst[0], worst[1], worst[2]);
        scene_free(&s);
    }
}

/* >>slices, cancelling and memory */

/* Spreads sites over the floor of the Cornell box. */
static void floor_sites(sbl_site *sites, int count) {
    int i;
    for (i = 0; i < count; i++)
        sites[i] = site_of((float)(10 + 530 * fmod(0.5 + i * 0.7548776662466927, 1)), 0,
                           (float)(10 + 530 * fmod(0.5 + i * 0.5698402909980532, 1)), 0, 1, 0);
}

static int stops_at(float done, void *user) { return done >= *(float *)user; }

/* Slices do not change readings. Cancelled, ended and abandoned gathers leave no traces. */
TEST(slices_cancel_and_end) {
    enum { COUNT = 3000 };
    static sbl_site sites[COUNT];
    static sbl_reading whole[COUNT], now[COUNT];
    static const double slices[] = { 1e-9, 1e-3 };
    test_scene s = { 0 };
    sbl_readings_desc desc;
    sbl_scene_desc scene;
    sbl_result result;
    float before, limit = 0.3f;
    int i, steps;
    scene_cornell_box(&s);
    scene = scene_desc(&s);
    REQUIRE(use_scene(&s), "no scene");
    floor_sites(sites, COUNT);
    desc = scene_readings(sites, whole, COUNT, SBL_MODE_DIRECT);
    desc.options.rays = 24;
    REQUIRE(sbl_gather_readings(context, &desc) == SBL_SUCCESS, "no gather: %s", watch_last(&seen));
    CHECK(sbl_query_stats(context).sensors.sites == COUNT && sbl_query_stats(context).sensors.rays == 24 * COUNT,
          "sensors.sites is %d, sensors.rays is %d", (int)sbl_query_stats(context).sensors.sites,
          (int)sbl_query_stats(context).sensors.rays);
    CHECK(sbl_step(context, 0) == SBL_SUCCESS && sbl_progress(context) == 1,
          "sbl_step after the end fails, or progress is not 1");
    desc.readings = now;
    for (i = 0; i < 2; i++) {
        memset(now, 0, sizeof now);
        REQUIRE(use_scene(&s) && sbl_begin_readings(context, &desc) == SBL_SUCCESS, "cannot begin");
        for (steps = 0, before = 0; (result = sbl_step(context, slices[i])) == SBL_UNFINISHED; steps++) {
            CHECK(sbl_progress(context) >= before, "progress decreases from %g to %g", (double)before,
                  (double)sbl_progress(context));
            before = sbl_progress(context);
        }
        CHECK(result == SBL_SUCCESS && memcmp(now, whole, sizeof now) == 0, "slices of %g s change readings",
              slices[i]);
        CHECK(steps > (i ? 5 : 50), "slices of %g s: %d steps", slices[i], steps);
    }
    desc.options.progress = stops_at;
    desc.options.progress_user = &limit;
    CHECK(sbl_begin_readings(context, &desc) == SBL_SUCCESS, "cannot begin");
    while ((result = sbl_step(context, 1e-4)) == SBL_UNFINISHED) {}
    CHECK(result == SBL_CANCELLED && sbl_step(context, 0) == SBL_ERROR_STATE, "not cancelled: %s",
          sbl_result_string(result));
    desc.options.progress = NULL;
    CHECK(sbl_begin_readings(context, &desc) == SBL_SUCCESS && sbl_step(context, 1e-9) == SBL_UNFINISHED,
          "cannot begin");
    sbl_end(context);
    CHECK(sbl_step(context, 0) == SBL_ERROR_STATE && sbl_progress(context) == 0, "the ended gather continues");
    CHECK(sbl_begin_readings(context, &desc) == SBL_SUCCESS && sbl_step(context, 1e-9) == SBL_UNFINISHED,
          "cannot begin");
    CHECK(sbl_set_scene(context, &scene) == SBL_SUCCESS && sbl_step(context, 0) == SBL_ERROR_STATE,
          "the gather continues after sbl_set_scene");
    memset(now, 0, sizeof now);
    CHECK(sbl_gather_readings(context, &desc) == SBL_SUCCESS && memcmp(now, whole, sizeof now) == 0,
          "abandoned gathers change later readings");
    desc.site_count = 0;
    desc.sites = NULL;
    desc.readings = NULL;
    CHECK(sbl_gather_readings(context, &desc) == SBL_SUCCESS, "a gather of 0 sites fails");
    scene_free(&s);
}

/* Work that a change of the scene has dropped is not reported as finished because a finished picture remains. */
TEST(dropped_work_is_not_done) {
    static sbl_site sites[3000];
    static sbl_reading readings[3000];
    test_scene s = { 0 };
    sbl_picture_desc view = scene_cornell_view(16, 12);
    sbl_readings_desc desc;
    float pixels[16 * 12 * 3];
    scene_cornell_box(&s);
    REQUIRE(use_scene(&s), "no scene");
    view.options.mode = SBL_MODE_DIRECT;
    floor_sites(sites, 3000);
    desc = scene_readings(sites, readings, 3000, SBL_MODE_DIRECT);
    REQUIRE(sbl_render_picture(context, &view) == SBL_SUCCESS, "no picture: %s", watch_last(&seen));
    REQUIRE(sbl_begin_readings(context, &desc) == SBL_SUCCESS && sbl_step(context, 1e-9) == SBL_UNFINISHED,
            "cannot begin");
    REQUIRE(sbl_set_lights(context, NULL, 0) == SBL_SUCCESS, "the lights are not changed: %s", watch_last(&seen));
    CHECK(sbl_step(context, 0) == SBL_ERROR_STATE && sbl_progress(context) == 0, "dropped readings look finished");
    CHECK(sbl_read_channel(context, SBL_CHANNEL_FINAL, pixels, 16 * 12 * 3) == SBL_SUCCESS, "the picture is gone");
    sbl_end(context);
    CHECK(sbl_read_channel(context, SBL_CHANNEL_FINAL, pixels, 16 * 12 * 3) == SBL_ERROR_STATE, "sbl_end keeps it");
    scene_free(&s);
}

/* A gather continues after each inspection of a sensor, even if the inspection runs out of memory. The inspected sensor
   is the same as without the gather. */
TEST(inspection_in_between) {
    enum { COUNT = 40 };
    static sbl_site sites[COUNT];
    static sbl_reading whole[COUNT], now[COUNT];
    test_scene s = { 0 };
    sbl_picture_desc view = scene_cornell_view(8, 8);
    sbl_readings_desc desc = scene_readings(sites, whole, COUNT, SBL_MODE_DIRECT);
    sbl_sensor alone, between;
    sbl_result result, inspected;
    sbl_memory memory;
    int refused;
    scene_cornell_box(&s);
    view.options.rays = 20;
    desc.options.rays = 24;
    floor_sites(sites, COUNT);
    REQUIRE(use_scene(&s) && sbl_gather_readings(context, &desc) == SBL_SUCCESS &&
                sbl_render_picture(context, &view) == SBL_SUCCESS &&
                sbl_inspect_sensor(context, 4, 4, &alone, NULL, NULL, 0) == SBL_SUCCESS,
            "no picture");
    desc.readings = now;
    for (refused = 0; refused < 2; refused++) {
        int looks = 0;
        memset(now, 0, sizeof now);
        REQUIRE(sbl_begin_readings(context, &desc) == SBL_SUCCESS, "cannot begin");
        while ((result = sbl_step(context, 1e-9)) == SBL_UNFINISHED && looks < 500) {
            memory = sbl_query_memory(context);
            seen.refuse_at = refused ? seen.allocations + 3 : 0;
            inspected = sbl_inspect_sensor(context, 4, 4, &between, NULL, NULL, 0);
            seen.refuse_at = 0;
            looks++;
            CHECK(inspected == (refused ? SBL_ERROR_OUT_OF_MEMORY : SBL_SUCCESS), "%s", sbl_result_string(inspected));
            CHECK(refused || !memcmp(between.from_lamps, alone.from_lamps, sizeof alone.from_lamps),
                  "the sensor differs");
            CHECK(sbl_query_memory(context).gpu_bytes == memory.gpu_bytes, "the inspection keeps GPU memory");
        }
        CHECK(result == SBL_SUCCESS && looks > 3 && !memcmp(now, whole, sizeof now),
              "%s, %d inspections: the gather "
              "differs", sbl_result_string(result), looks);
    }
    scene_free(&s);
}

/* Memory in use does not grow from 131,072 to a million points. */
TEST(a_million_points) {
    enum { MANY = 1000000, FEW = 2 * 65536 };
    test_scene s = { 0 };
    sbl_site *sites = (sbl_site *)malloc(sizeof *sites * MANY);
    sbl_reading *readings = (sbl_reading *)malloc(sizeof *readings * MANY);
    sbl_readings_desc desc;
    sbl_memory few, many;
    int i, wrong = 0;
    scene_sky(&s, 1, 1, 1);
    scene_floor(&s, scene_material(&s, 0.5f, 0.5f, 0.5f), 0, 10);
    if (!sites || !readings || !use_scene(&s)) { CHECK(0, "no memory or scene"); goto done; }
    for (i = 0; i < MANY; i++)
        sites[i] = site_of((float)(i % 1000) * 0.01f - 5, 0, (float)(i / 1000) * 0.01f - 5, 0, i & 1 ? 1.0f : -1.0f, 0);
    desc = scene_readings(sites, readings, FEW, SBL_MODE_DIRECT);
    desc.options.rays = 4;
    CHECK(sbl_gather_readings(context, &desc) == SBL_SUCCESS, "few: %s", watch_last(&seen));
    few = sbl_query_memory(context);
    desc.site_count = MANY;
    memset(readings, 0xff, sizeof *readings * MANY);
    CHECK(sbl_gather_readings(context, &desc) == SBL_SUCCESS, "many: %s", watch_last(&seen));
    many = sbl_query_memory(context);
    for (i = 0; i < MANY; i++)
        wrong += !(readings[i].radiance[0] == 1 && readings[i].radiance[2] == 1 && readings[i].valid);
    CHECK(wrong == 0, "%d of a million readings are wrong", wrong);
    CHECK(many.host_peak_bytes == few.host_peak_bytes && many.gpu_peak_bytes == few.gpu_peak_bytes,
          "memory grows: host from %.1f to %.1f MB, GPU from %.1f to %.1f MB",
          (double)few.host_peak_bytes / 1e6, (double)many.host_peak_bytes / 1e6, (double)few.gpu_peak_bytes / 1e6,
              (double)many.gpu_peak_bytes / 1e6);
    CHECK(few.host_peak_bytes < 64u << 20 && few.gpu_peak_bytes < 256u << 20,
          "%.1f MB of host memory and %.1f MB of GPU memory are too much",
          (double)few.host_peak_bytes / 1e6,
          (double)few.gpu_peak_bytes / 1e6);
    printf("  host %.1f MB, GPU %.1f MB, %.2f s\n", (double)many.host_peak_bytes / 1e6,
           (double)many.gpu_peak_bytes / 1e6, sbl_query_stats(context).seconds.total);
done:
    free(sites);
    free(readings);
    scene_free(&s);
}

/* >>mistakes and lack of memory */

/* Invalid descriptors, NULL and calls without a scene are refused, and nothing is written. */
TEST(mistakes) {
    test_scene s = { 0 };
    sbl_site site = site_of(0, 0, 0, 0, 1, 0);
    sbl_reading reading, untouched;
    sbl_readings_desc good = scene_readings(&site, &reading, 1, SBL_MODE_DIRECT), d;
    sbl_context_desc desc = watch_desc(&seen);
    sbl_context *empty = NULL;
#define REFUSED(result, item, a, b) do { \
        watch_forget(&seen); \
        CHECK(sbl_gather_readings(context, &d) == result, "not refused: " a " " b); \
        CHECK(watch_said(&seen, SBL_LOG_ERROR, item, a, b, NULL), "said: %s", watch_last(&seen)); \
        CHECK(memcmp(&reading, &untouched, sizeof reading) == 0, "a refused gather wrote readings"); \
        d = good; \
        site = site_of(0, 0, 0, 0, 1, 0); \
    } while (0)
    scene_floor(&s, scene_material(&s, 0.5f, 0.5f, 0.5f), 0, 1);
    REQUIRE(use_scene(&s), "no scene");
    memset(&reading, 0x5a, sizeof reading);
    untouched = reading;
    d = good;
    d.start_canary = 1;
    REFUSED(SBL_ERROR_INVALID_ARGUMENT, SBL_LOG_ITEM_INVALID_READINGS_DESC, "sbl_readings_desc", "canary");
    d.sites = NULL; REFUSED(SBL_ERROR_INVALID_ARGUMENT, SBL_LOG_ITEM_INVALID_READINGS_DESC, "site_count is 1", "NULL");
    d.readings = NULL;
    REFUSED(SBL_ERROR_INVALID_ARGUMENT, SBL_LOG_ITEM_INVALID_READINGS_DESC, "sbl_readings_desc", "readings");
    d.site_count = -3; REFUSED(SBL_ERROR_INVALID_ARGUMENT, SBL_LOG_ITEM_INVALID_READINGS_DESC, "site_count", "-3");
    d.options.rays = 5000;
    REFUSED(SBL_ERROR_INVALID_ARGUMENT, SBL_LOG_ITEM_INVALID_READINGS_DESC, "options.rays", "5000");
    d.options.mode = (sbl_mode)99;
    REFUSED(SBL_ERROR_INVALID_ARGUMENT, SBL_LOG_ITEM_INVALID_READINGS_DESC, "options.mode", "99");
    d.options.epsilon = (float)NAN;
    d.options.mode = SBL_MODE_AMBIENT;
    REFUSED(SBL_ERROR_INVALID_ARGUMENT, SBL_LOG_ITEM_INVALID_READINGS_DESC, "options.epsilon", "nan");
    site.position[1] = (float)NAN;
    REFUSED(SBL_ERROR_INVALID_ARGUMENT, SBL_LOG_ITEM_INVALID_READINGS_DESC, "site", "position");
    site.normal[1] = 0; REFUSED(SBL_ERROR_INVALID_ARGUMENT, SBL_LOG_ITEM_INVALID_READINGS_DESC, "site", "normal");
    site.geometric_normal[0] = (float)INFINITY;
    REFUSED(SBL_ERROR_INVALID_ARGUMENT, SBL_LOG_ITEM_INVALID_READINGS_DESC, "site", "geometric_normal");
    site.offset = (float)INFINITY;
    REFUSED(SBL_ERROR_INVALID_ARGUMENT, SBL_LOG_ITEM_INVALID_READINGS_DESC, "site", "offset");
    CHECK(sbl_gather_readings(context, &good) == SBL_SUCCESS && memcmp(&reading, &untouched, sizeof reading) != 0,
          "a valid gather after invalid ones: %s", watch_last(&seen));
    CHECK(sbl_begin_readings(NULL, &good) == SBL_ERROR_INVALID_ARGUMENT &&
              sbl_gather_readings(NULL, NULL) == SBL_ERROR_INVALID_ARGUMENT,
          "a NULL context is accepted");
    CHECK(sbl_gather_readings(context, NULL) == SBL_SUCCESS, "a NULL descriptor does not mean no sites");
    CHECK(sbl_create(&desc, &empty) == SBL_SUCCESS && sbl_gather_readings(empty, &good) == SBL_ERROR_STATE,
          "a gather begins without a scene");
    sbl_destroy(empty);
    scene_free(&s);
}

static sbl_result gather_call(const void *desc) {
    return sbl_gather_readings(context, (const sbl_readings_desc *)desc);
}

/* Makes each allocation fail once, in turn. The gather fails with a message and leaks nothing, and the next gather is
   right. */
TEST(memory_runs_out) {
    enum { COUNT = 300 };
    static sbl_site sites[COUNT];
    static sbl_reading whole[COUNT];
    test_scene s = { 0 };
    sbl_readings_desc desc;
    int refused;
    scene_cornell_box(&s);
    floor_sites(sites, COUNT);
    desc = scene_readings(sites, whole, COUNT, SBL_MODE_DIRECT);
    desc.options.rays = 16;
    refused = each_allocation_fails(gather_call, &desc, &s, whole, sizeof whole);
    CHECK(refused > 10, "%d allocations were refused", refused);
    sbl_destroy(context);
    context = NULL;
    CHECK(seen.blocks == 0 && seen.strangers == 0, "%d blocks are not freed, %d were freed twice or never allocated",
          seen.blocks, seen.strangers);
    scene_free(&s);
}

/* A host measures at the sites of inspected sensors, although its positions far from the origin are rounded to the
   thousandth part of a unit: on a slope under the sky, all of these readings are valid and have R = 1. */
TEST(sites_far_away_can_be_measured) {
    enum { ACROSS = 6, DOWN = 4, COUNT = ACROSS * DOWN };
    static const float far_away = 20000;
    const sbl_picture_desc view = scene_plain(scene_view(ACROSS, DOWN, 30, far_away - 1.5f, 3, 0, far_away, 0, 0),
                                              SBL_MODE_DIRECT, 16);
    sbl_site sites[COUNT];
    sbl_reading readings[COUNT];
    const sbl_readings_desc desc = scene_readings(sites, readings, COUNT, SBL_MODE_DIRECT);
    test_scene s = { 0 };
    sbl_scene_desc scene;
    int i, good = 0;
    scene_quad(&s, scene_material(&s, 0.5f, 0.5f, 0.5f), far_away - 2, -1, -2, far_away - 2, -1.3f, 2, far_away + 2, 1,
               2, far_away + 2, 1.3f, -2);
    scene_sky(&s, 1, 1, 1);
    scene = scene_desc(&s);
    REQUIRE((context || use_scene(&s)) && sbl_set_scene(context, &scene) == SBL_SUCCESS &&
            sbl_render_picture(context, &view) == SBL_SUCCESS, "%s", watch_last(&seen));
    for (i = 0; i < COUNT; i++) {
        sbl_sensor sensor;
        REQUIRE(sbl_inspect_sensor(context, i % ACROSS, i / ACROSS, &sensor, NULL, NULL, 0) == SBL_SUCCESS, "%s",
                watch_last(&seen));
        sites[i] = sensor.site;
    }
    REQUIRE(sbl_gather_readings(context, &desc) == SBL_SUCCESS, "%s", watch_last(&seen));
    for (i = 0; i < COUNT; i++) good += readings[i].valid && fabs((double)readings[i].radiance[1] - 1) < 1e-3;
    CHECK(good == COUNT, "%d of %d readings are right", good, COUNT);
    scene_free(&s);
}

/* >>surveys */

/* Adds sides of a box around the origin that face inwards, or outwards if sign is -1. sides: bit i is side i, in the
   order of survey.side; half: half of the width, height and depth */
static void add_sides(test_scene *s, int material, int sides, const float half[3], int sign) {
    int side, i;
    for (side = 0; side < 6; side++) {
        const int a = side / 2, b = (a + 1) % 3, c = (a + 2) % 3, turned = (side % 2 ? -sign : sign) > 0;
        float corners[12];
        for (i = 0; i < 4; i++) {
            float *p = corners + 3 * (turned ? 3 - i : i);
            p[a] = side % 2 ? -half[a] : half[a];
            p[b] = i == 1 || i == 2 ? half[b] : -half[b];
            p[c] = i >= 2 ? half[c] : -half[c];
        }
        if (sides >> side & 1) scene_quad_uv(s, material, corners, 1, 1);
    }
}

/* Surveys a scene, and frees it. */
static survey surveyed(test_scene *s) {
    const sbl_scene_desc desc = scene_desc(s);
    survey found;
    memset(&found, 0, sizeof found);
    CHECK((context || use_scene(s)) && sbl_set_scene(context, &desc) == SBL_SUCCESS &&
          survey_take(&found, context) == SBL_SUCCESS, "no survey: %s", watch_last(&seen));
    scene_free(s);
    return found;
}

/* A room without one of its walls is open at that side. Without a ceiling, it is an object; without a floor, a room. */
TEST(surveys_find_the_open_side) {
    static const float half[3] = { 2, 1.5f, 3 };
    static const char *const kinds[] = { "an object", "an open room", "a room" };
    int side;
    for (side = 0; side < 7; side++) {
        const survey_kind wanted = side == 2 ? SURVEY_OBJECT : side == 3 || side == 6 ? SURVEY_ROOM : SURVEY_OPEN_ROOM;
        test_scene s = { 0 };
        survey found;
        add_sides(&s, scene_material(&s, 0.5f, 0.5f, 0.5f), 63 & ~(1 << side), half, 1);
        found = surveyed(&s);
        CHECK(found.kind == wanted, "without side %d: %s instead of %s", side, kinds[found.kind], kinds[wanted]);
        CHECK(wanted != SURVEY_OPEN_ROOM || found.side == side, "side %d is open, not %d", found.side, side);
    }
}

/* In a long room, the camera stands at one end and looks towards the other. The lamp is in the air in front of it. */
TEST(surveys_look_along_a_room) {
    static const float half[3] = { 2, 1.5f, 5 };
    test_scene s = { 0 };
    double nearest = 1e30, ahead = 0;
    survey found;
    int k;
    add_sides(&s, scene_material(&s, 0.5f, 0.5f, 0.5f), 63, half, 1);
    found = surveyed(&s);
    REQUIRE(found.kind == SURVEY_ROOM, "no room");
    CHECK(fabs(found.forward[2]) > 0.8 && fabs(found.forward[1]) < 1e-6, "it looks along %g %g %g", found.forward[0],
          found.forward[1], found.forward[2]);
    /* the centres of the last cells of the grid are 5 / 6 from the wall, and the camera steps back from there */
    CHECK(5 + found.eye[2] * (found.forward[2] > 0 ? 1 : -1) < 5.0 / 6 - 0.1, "its z is %g, and it looks along z %g",
          found.eye[2], found.forward[2]);
    for (k = 0; k < 3; k++) {
        CHECK(fabs(found.eye[k]) < (double)half[k], "the camera is outside");
        nearest = fmin(nearest, (double)half[k] - fabs(found.middle[k]));
        ahead += (found.middle[k] - found.eye[k]) * found.forward[k];
    }
    CHECK(found.free > 0.99 * nearest && found.free < 1.15 * nearest, "free is %g; the nearest wall is at %g",
          found.free, nearest);
    CHECK(ahead > 0.25 * found.far && ahead < 0.75 * found.far, "the lamp is %g ahead; surfaces are at %g", ahead,
          found.far);
    CHECK(found.middle[1] > 0 && found.middle[1] < 1.4, "the lamp is at height %g", found.middle[1]);
}

/* Thick walls, which face outwards and inwards, are a room if a lamp lights it and no light comes from outside. */
TEST(surveys_enter_what_is_lit_inside) {
    static const float inner[3] = { 2, 1.5f, 5 }, outer[3] = { 2.1f, 1.6f, 5.1f };
    int way;
    for (way = 0; way < 3; way++) {  /* dark; lit; a lit tunnel, which is open at both ends */
        const int sides = way == 2 ? 15 : 63;
        const survey_kind wanted = way == 1 ? SURVEY_ROOM : SURVEY_OBJECT;
        test_scene s = { 0 };
        const int grey = scene_material(&s, 0.5f, 0.5f, 0.5f);
        survey found;
        add_sides(&s, grey, sides, inner, 1);
        add_sides(&s, grey, sides, outer, -1);
        if (way) scene_quad(&s, scene_lamp(&s, 9, 9, 9), -1, 1.4f, -4, 1, 1.4f, -4, 1, 1.4f, 4, -1, 1.4f, 4);
        found = surveyed(&s);
        CHECK(found.kind == wanted, "%s: kind %d", way == 0 ? "dark" : way == 1 ? "lit" : "tunnel", (int)found.kind);
    }
}

/* An object is seen from the front, slightly from the right and above. Two walls that show their backs there are seen
   from behind, although other directions show as few backs. */
TEST(surveys_see_the_front_of_objects) {
    int way, k;
    for (way = 0; way < 2; way++) {
        const double turn = 0.375 + (way ? SCENE_PI : 0), flat = sqrt(1 - 0.3 * 0.3);
        const double wanted[3] = { flat * sin(turn), 0.3, flat * cos(turn) };
        test_scene s = { 0 };
        const int grey = scene_material(&s, 0.5f, 0.5f, 0.5f);
        survey found;
        if (way) {
            scene_quad(&s, grey, 1, -1, -1, -1, -1, -1, -1, 1, -1, 1, 1, -1);  /* faces -z */
            scene_quad(&s, grey, -1, -1, -1, -1, -1, 1, -1, 1, 1, -1, 1, -1);  /* faces -x */
        } else scene_sphere(&s, grey, 0, 0, 0, 1, 16, 8, 0);
        found = surveyed(&s);
        CHECK(found.kind == SURVEY_OBJECT, "%s: kind %d", way ? "walls" : "sphere", (int)found.kind);
        for (k = 0; k < 3; k++)
            CHECK(fabs(found.from[k] - wanted[k]) < 1e-6, "%s: from[%d] is %g, not %g", way ? "walls" : "sphere", k,
                  found.from[k], wanted[k]);
    }
}

int main(void) {
    RUN_UNSANITIZED(readings_equal_the_picture);
    RUN(sky_and_lights);
    RUN(suns_in_clusters);
    RUN(distances_to_a_disc);
    RUN(lamps_and_noise);
    RUN(lamps_shine_through_holes_in_others);
    RUN(normals_of_any_length);
    RUN(offsets_and_validity);
    RUN(in_the_planes_of_walls);
    RUN(slices_cancel_and_end);
    RUN(dropped_work_is_not_done);
    RUN(inspection_in_between);
    RUN_PLAIN(a_million_points);
    RUN(sites_far_away_can_be_measured);
    RUN(surveys_find_the_open_side);
    RUN(surveys_look_along_a_room);
    RUN(surveys_enter_what_is_lit_inside);
    RUN(surveys_see_the_front_of_objects);
    RUN(mistakes);
    RUN(memory_runs_out);
    sbl_destroy(context);
    return test_report();
}
