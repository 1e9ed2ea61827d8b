/* Tests traced sensors in real rooms from ../shared/scenes: rays hit the same triangles as with an independent ray
   caster, and smooth light equals that of large rasterised sensors. extra_references.sh runs: extra_trace SCENE EYE
   LOOK_AT UP FOV. */
#define _DEFAULT_SOURCE
#include "../sbl.h"
#include "../examples/scene_file.h"
#include "support/test.h"
#include "support/inside.h"
#include "support/reference.h"
#include "support/trace_hits.h"

static scene_file *file;
static sbl_context *context;
static float camera[10];  /* eye, look-at point, up, fov */

static sbl_picture_desc camera_view(int width, int height) {
    sbl_picture_desc view;
    memset(&view, 0, sizeof view);
    view.width = width;
    view.height = height;
    view.options.mode = SBL_MODE_AMBIENT;
    view.options.epsilon = 1;
    view.tile = 1;
    view.filter_radius = -1;
    view.samples = 1;
    view.facet_limit = 1e9f;  /* shading normals equal the geometric ones, so that no ray starts into its own surface */
    view.options.backend = SBL_BACKEND_TRACE;
    sbl_look_at(view.world_to_view, camera[0], camera[1], camera[2], camera[3], camera[4], camera[5], camera[6],
                camera[7], camera[8]);
    sbl_perspective(view.view_to_clip, camera[9], (float)width / (float)height);
    return view;
}

/* Rays from 200 visible points hit the same triangles as with the ray caster. */
TEST(many_points_see_the_same_triangles) {
    enum { POINTS = 200, EACH = 1024 };
    sbl_picture_desc view = camera_view(160, 90);
    ref_scene *truth = ref_create(&file->scene);
    float *rays = (float *)malloc(32 * (size_t)POINTS * EACH);
    hits_compared seen;
    view.options.rays = 1;
    REQUIRE(rays && sbl_render_picture(context, &view) == SBL_SUCCESS, "no picture");
    seen = trace_hits_compare(context, truth, rays, trace_hits_rays(context, &view, POINTS, EACH, 7, rays));
    printf("  %d rays, %d hits, %d ties, %d differ, %d of them away from all edges\n", seen.rays, seen.hits, seen.ties,
           seen.differ, seen.unexplained);
    CHECK(seen.rays == POINTS * EACH, "only %d rays", seen.rays);
    CHECK(seen.differ + seen.ties < seen.rays / 10000 && seen.unexplained < seen.rays / 100000,
          "%d rays hit another triangle, %d another one at the same distance", seen.differ, seen.ties);
    free(rays);
    ref_destroy(truth);
}

/* R of traced and rasterised sensors differs by less than 1 % RMS if every surface emits its albedo. */
TEST(smooth_light_is_what_rasterised_sensors_find) {
    enum { WIDTH = 6, HEIGHT = 3 };
    sbl_picture_desc view = camera_view(WIDTH, HEIGHT);
    float traced[3 * WIDTH * HEIGHT], drawn[3 * WIDTH * HEIGHT];
    double squares = 0, sum = 0, error;
    int i;
    view.options.rays = 4096;
    REQUIRE(sbl_render_picture(context, &view) == SBL_SUCCESS &&
                sbl_read_channel(context, SBL_CHANNEL_RADIANCE, traced, 3 * WIDTH * HEIGHT) == SBL_SUCCESS,
            "no picture");
    view.options.backend = SBL_BACKEND_RASTER;
    view.options.sensor_size = 256;
    REQUIRE(sbl_render_picture(context, &view) == SBL_SUCCESS &&
                sbl_read_channel(context, SBL_CHANNEL_RADIANCE, drawn, 3 * WIDTH * HEIGHT) == SBL_SUCCESS,
            "no picture");
    for (i = 0; i < 3 * WIDTH * HEIGHT; i++) {
        squares += ((double)traced[i] - drawn[i]) * ((double)traced[i] - drawn[i]);
        sum += drawn[i];
    }
    error = sqrt(squares / (3 * WIDTH * HEIGHT)) / (sum / (3 * WIDTH * HEIGHT));
    printf("  %.2f %% rms\n", 100 * error);
    CHECK(error < 0.01, "traced and rasterised differ by %.2f %% rms", 100 * error);
}

int main(int argc, char **argv) {
    sbl_material *materials;
    char error[512];
    int i;
    if (argc != 6) return fprintf(stderr, "usage: extra_trace SCENE EYE LOOK_AT UP FOV\n"), 2;
    for (i = 0; i < 10; i++) {
        const char *text = argv[2 + i / 3];
        int skip;
        for (skip = i % 3; skip; skip--) text = strchr(text, ',') ? strchr(text, ',') + 1 : text;
        camera[i] = strtof(text, NULL);
    }
    file = scene_file_load(argv[1], NULL, error, sizeof error);
    if (!file) return fprintf(stderr, "%s\n", error), 1;
    /* the light is smooth: a sky, every surface emits its albedo, and no lamps */
    materials = (sbl_material *)malloc(sizeof *materials * (size_t)(file->scene.material_count + 1));
    if (!materials) abort();
    for (i = 0; i < file->scene.material_count; i++) {
        materials[i] = file->scene.materials[i];
        memset(materials[i].emission, 0, sizeof materials[i].emission);
    }
    file->scene.materials = materials;
    for (i = 0; i < 3; i++) file->scene.sky[i] = 0.5f;
    if (sbl_create(NULL, &context) != SBL_SUCCESS || sbl_set_scene(context, &file->scene) != SBL_SUCCESS) return 1;
    RUN(many_points_see_the_same_triangles);
    RUN(smooth_light_is_what_rasterised_sensors_find);
    sbl_destroy(context);
    scene_file_free(file);
    free(materials);
    return test_report();
}
