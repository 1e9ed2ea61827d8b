/* Tests of sensors inside geometry. A sensor is slightly above its surface. If a closed box floats above a floor by
   less than this offset, the sensors of the floor that the camera sees through the gap are inside the box. They must be
   detected, and must not bring light from the inside of the box to the floor. In a room that is modelled inside out,
   all surfaces show their back sides; its sensors must be valid nevertheless. */
#include "../sbl.h"
#include "support/test.h"
#include "support/scenes.h"
#include "support/inside.h"

static sbl_context *context;
static sbl_backend backend;

static sbl_picture_desc plain(sbl_picture_desc view, int sensor_size) {
    view = scene_plain(view, SBL_MODE_DIRECT, sensor_size);
    view.options.backend = backend;
    view.options.rays = 256;
    return view;
}

/* Describes an orthographic camera that sees the floor at a grazing angle, from x = -2.2 to -0.2. On the floor, the
   rows of the picture are 2 / height apart. */
static sbl_picture_desc grazing_view(int width, int height) {
    sbl_picture_desc view;
    const float slope = 3e-5f;
    memset(&view, 0, sizeof view);
    view.width = width;
    view.height = height;
    sbl_look_at(view.world_to_view, -1.2f - 3, 3 * slope, 0, -1.2f, 0, 0, 0, 1, 0);
    view.view_to_clip[0] = 2;
    view.view_to_clip[5] = 1 / slope;
    view.view_to_clip[10] = -1;
    view.view_to_clip[15] = 1;
    return plain(view, 32);
}

/* Makes a floor under the sky, and a box with a red lamp inside that floats above the floor at height `gap`. */
static void gap_scene(test_scene *s, float gap) {
    int grey = scene_material(s, 0.5f, 0.5f, 0.5f), red = scene_lamp(s, 5, 0, 0);
    scene_sky(s, 0, 1, 0);
    scene_floor(s, grey, 0, 10);
    scene_box(s, grey, -1, gap, -1, 1, 1, 1);
    scene_box(s, red, -0.9f, 0.5f, -0.9f, 0.9f, 0.6f, 0.9f);
}

/* Sensors of the floor in the gap are invalid. Their pixels get light from adjacent pixels and not from the inside of
   the box. */
TEST(stuck_sensors_bring_no_light_from_inside) {
    test_scene s = { 0 };
    sbl_picture_desc view = grazing_view(16, 64);
    sbl_stats stats;
    sbl_sensor sensor;
    float *radiance, *position, red = 0, lowest_green = 1;
    float offset;
    int i, gap_row = -1, open_row = -1;
    gap_scene(&s, 0);  /* a box without a gap shows the offset of the sensors */
    REQUIRE(scene_render(context, &s, &view), "no picture");
    offset = inside_farthest_offset(context);
    scene_free(&s);
    gap_scene(&s, 0.4f * offset);
    REQUIRE(scene_render(context, &s, &view), "no picture");
    stats = sbl_query_stats(context);
    radiance = scene_channel(context, &view, SBL_CHANNEL_RADIANCE);
    position = scene_channel(context, &view, SBL_CHANNEL_POSITION);
    REQUIRE(radiance && position, "no channels");
    for (i = 0; i < view.width * view.height; i++) {
        const float *p = position + 3 * i;
        if (p[1] != 0 || p[0] == 0) continue;  /* skips pixels that do not show the floor */
        if (p[0] > -0.9f && gap_row < 0) gap_row = i;
        if (p[0] < -1.5f) open_row = i;
        red = radiance[3 * i] > red ? radiance[3 * i] : red;
        lowest_green = radiance[3 * i + 1] < lowest_green ? radiance[3 * i + 1] : lowest_green;
    }
    CHECK(gap_row >= 0 && open_row >= 0, "the camera does not see the floor in the gap and in front of it");
    CHECK(stats.sensors.invalid > 100, "only %d sensors are invalid", (int)stats.sensors.invalid);
    CHECK(red < 0.01f, "red light of %g came out of the box", (double)red);
    CHECK(lowest_green > 0.2f, "a pixel has R = %g of the sky: it got no light from its neighbours",
          (double)lowest_green);
    if (gap_row >= 0 && open_row >= 0) {
        REQUIRE(sbl_inspect_sensor(context, gap_row % view.width, gap_row / view.width, &sensor, NULL, NULL, 0) ==
                SBL_SUCCESS, "no sensor");
        CHECK(!sensor.valid && sensor.radiance[0] > 0.5f && sensor.back_share > 0.1f,
              "in the gap: valid %d, red %g, back %g", sensor.valid, (double)sensor.radiance[0],
              (double)sensor.back_share);
        REQUIRE(sbl_inspect_sensor(context, open_row % view.width, open_row / view.width, &sensor, NULL, NULL, 0) ==
                SBL_SUCCESS, "no sensor");
        CHECK(sensor.valid, "in front of the gap: valid %d", sensor.valid);
    }
    free(radiance);
    free(position);
    scene_free(&s);
}

/* A room that is modelled inside out has the same R as a normal room, and no invalid sensors. */
TEST(a_room_inside_out_is_valid) {
    test_scene s = { 0 };
    sbl_picture_desc view = plain(scene_view(48, 48, 80, 0.05f, 0.02f, 0.9f, 0.1f, 0.03f, -1), 16);
    float *pictures[2] = { NULL, NULL };
    int i, turned;
    /* A camera inside the box sees its back sides. If the order of corners is reversed, it sees front sides. */
    for (turned = 0; turned < 2; turned++) {
        sbl_stats stats;
        int grey = scene_material(&s, 0.5f, 0.5f, 0.5f), lamp = scene_lamp(&s, 3, 2, 1);
        scene_box(&s, grey, turned ? 1 : -1, -1, -1, turned ? -1 : 1, 1, 1);
        scene_box(&s, lamp, -0.3f, 0.7f, -0.3f, 0.3f, 0.8f, 0.3f);
        REQUIRE(scene_render(context, &s, &view), "no picture");
        stats = sbl_query_stats(context);
        CHECK(stats.sensors.invalid == 0, "%d sensors are invalid", (int)stats.sensors.invalid);
        pictures[turned] = scene_channel(context, &view, SBL_CHANNEL_RADIANCE);
        scene_free(&s);
    }
    REQUIRE(pictures[0] && pictures[1], "no channels");
    for (i = 0; i < 48 * 48 * 3; i++)
        if (fabs((double)pictures[0][i] - (double)pictures[1][i]) > 0.02 * (double)pictures[1][i] + 1e-3) break;
    CHECK(i == 48 * 48 * 3, "inside out, R of pixel %d is %g instead of %g", i / 3,
          (double)pictures[0][i % (48 * 48 * 3)],
          (double)pictures[1][i % (48 * 48 * 3)]);
    CHECK(pictures[0][3 * (24 * 48 + 24)] > 0.01f, "the wall is dark");
    free(pictures[0]);
    free(pictures[1]);
}

int main(void) {
    if (sbl_create(NULL, &context) != SBL_SUCCESS) return 1;
    backend = SBL_BACKEND_RASTER;
    RUN(stuck_sensors_bring_no_light_from_inside);
    RUN(a_room_inside_out_is_valid);
    printf("traced:\n");
    backend = SBL_BACKEND_TRACE;
    RUN(stuck_sensors_bring_no_light_from_inside);
    RUN(a_room_inside_out_is_valid);
    sbl_destroy(context);
    return test_report();
}
