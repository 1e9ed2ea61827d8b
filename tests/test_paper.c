/* Tests of the paper's mode, which is compared with the paper's sums on the CPU. Further tests check tiles, thresholds
   and the filter in all modes. */
#include "../sbl.h"
#include "support/test.h"
#include "support/scenes.h"
#include "support/reference.h"

static sbl_context *context;

/* >>the sensor of the paper */

/* Makes two axes perpendicular to n as in Duff et al. 2017, Building an Orthonormal Basis, Revisited. The second axis
   is negated, so that right x up = -n, as a view along n needs. */
static void frame(v3 n, v3 *right, v3 *up) {
    if (n.z < 0) {
        double a = 1 / (1 - n.z), b = n.x * n.y * a;
        *right = v3_of(1 - n.x * n.x * a, -b, n.x);
        *up = v3_of(-b, 1 - n.y * n.y * a, n.y);
    } else {
        double a = 1 / (1 + n.z), b = -n.x * n.y * a;
        *right = v3_of(1 - n.x * n.x * a, b, -n.x);
        *up = v3_of(-b, n.y * n.y * a - 1, n.y);
    }
}

/* Returns V'' of the paper: the point (x, y, 1) projected onto the unit sphere, then into the tangent plane. */
static v3 project(double x, double y) { return v3_scale(v3_of(x, y, 0), 1 / sqrt(x * x + y * y + 1)); }

/* Returns the weight of equation 4, divided by pi, for texel (j, i) of rd x rd texels. */
static double paper_weight(double fov, int rd, int j, int i) {
    double s = tan(fov / 2 * REF_PI / 180);
    double x0 = 2 * s * ((double)j / rd - 0.5), x1 = 2 * s * ((j + 1.0) / rd - 0.5);
    double y0 = 2 * s * ((double)i / rd - 0.5), y1 = 2 * s * ((i + 1.0) / rd - 0.5);
    v3 v0 = project(x0, y0), v1 = project(x1, y0), v2 = project(x0, y1);
    return v3_length(v3_cross(v3_sub(v1, v0), v3_sub(v2, v0))) / REF_PI;
}

/* Returns the sum of section III-E: the sum of Ck d / pi over the texels, where Ck is the radiance that a ray through
   the centre of the texel finds. slack, unless NULL, receives the uncertainty due to texels with a centre within 1/128
   texel of an edge: GL rounds corners to 1/256 texel, so the renderer may see either side. */
static void paper_sum(const ref_scene *scene, v3 p, v3 n, double epsilon, double fov, int rd, const double *weights,
                      double rgb[3], double *slack) {
    static const double aside[5][2] = { { 0, 0 }, { 1, 1 }, { 1, -1 }, { -1, 1 }, { -1, -1 } };
    double s = tan(fov / 2 * REF_PI / 180), light[5][3];
    v3 right, up;
    int i, j, k, q;
    frame(n, &right, &up);
    rgb[0] = rgb[1] = rgb[2] = 0;
    if (slack) *slack = 0;
    for (i = 0; i < rd; i++)
        for (j = 0; j < rd; j++) {
            double difference = 0;
            for (q = 0; q < (slack ? 5 : 1); q++) {
                double x = 2 * s * ((j + 0.5 + aside[q][0] / 128) / rd - 0.5),
                    y = 2 * s * ((i + 0.5 + aside[q][1] / 128) / rd - 0.5);
                v3 d = v3_mad(v3_mad(n, right, x), up, y);
                ref_point seen = ref_surface(scene, ref_trace(scene, p, d, 1e-6, HUGE_VAL,
                                                              SBL_MATERIAL_HIDDEN_FROM_SENSORS), d);
                ref_light(scene, &seen, epsilon, light[q]);
                for (k = 0; k < 3; k++) difference = test_max(difference, fabs(light[q][k] - light[0][k]));
            }
            for (k = 0; k < 3; k++) rgb[k] += light[0][k] * weights[i * rd + j];
            if (slack) *slack += difference * weights[i * rd + j];
        }
}

static void check_paper(const test_scene *s, sbl_picture_desc view, double fov, const char *name) {
    sbl_scene_desc desc = scene_desc(s);
    ref_scene *reference = ref_create(&desc);
    int rd = view.options.sensor_size, x, y, k, count = 0, doubtful = 0;
    double *weights = (double *)calloc((size_t)(rd * rd), sizeof *weights), worst = 0, sum = 0, expected_sum = 0;
    if (!weights) abort();
    for (k = 0; k < rd * rd; k++) weights[k] = paper_weight(fov, rd, k % rd, k / rd);
    if (scene_render(context, s, &view)) {
        float *radiance = scene_channel(context, &view, SBL_CHANNEL_RADIANCE);
        for (y = 0; y < view.height; y++)
            for (x = 0; x < view.width; x++) {
                ref_point p = ref_pixel(reference, &view, x, y);
                double expected[3], luminance, slack, off = 0;
                if (!p.hit || ref_is_edge(reference, &view, x, y)) continue;
                paper_sum(reference, p.position, p.normal, (double)view.options.epsilon, fov, rd, weights, expected,
                          NULL);
                luminance = (expected[0] + expected[1] + expected[2]) / 3;
                for (k = 0; k < 3; k++) {
                    double r = (double)radiance[3 * (y * view.width + x) + k];
                    off = test_max(off, fabs(r - expected[k]) / luminance);
                    if (r != r) off = 1e30;
                }
                count++;
                /* a lamp may cover few texels; then one texel at its edge is more than 1 % of the light */
                if (off > 0.01) {
                    paper_sum(reference, p.position, p.normal, (double)view.options.epsilon, fov, rd, weights, expected,
                              &slack);
                    off -= slack / luminance;
                    doubtful++;
                } else for (k = 0; k < 3; k++) {
                    sum += (double)radiance[3 * (y * view.width + x) + k];
                    expected_sum += expected[k];
                }
                if (off > worst) worst = off;
            }
        free(radiance);
    }
    printf("  %s: %d pixels, %d of them depend on texels at an edge; without these, errors are up to %.3f %%\n", name,
           count, doubtful, 100 * worst);
    CHECK(count > view.width * view.height * 8 / 10, "%s: only %d pixels can be compared", name, count);
    CHECK(doubtful < count / 8, "%s: %d pixels of %d depend on texels at an edge", name, doubtful, count);
    CHECK(worst < 0.007, "%s: a pixel is off by %.3f %%", name, 100 * worst);
    CHECK(fabs(sum / expected_sum - 1) < 0.001, "%s: the mean is off by %+.4f %%", name,
          100 * (sum / expected_sum - 1));
    free(weights);
    ref_destroy(reference);
}

/* Rotates the scene and the camera together about x and y. The sensor axes of a normal with z = 0 depend on the sign of
   this zero; therefore no normal may have z = 0. */
static void turn(test_scene *s, sbl_picture_desc *view, double yaw, double pitch) {
    double m[3][3], v[3][3];  /* the arrays hold columns */
    int i, j, k;
    m[0][0] = cos(yaw); m[0][1] = 0; m[0][2] = -sin(yaw);
    m[1][0] = sin(yaw) * sin(pitch); m[1][1] = cos(pitch); m[1][2] = cos(yaw) * sin(pitch);
    m[2][0] = sin(yaw) * cos(pitch); m[2][1] = -sin(pitch); m[2][2] = cos(yaw) * cos(pitch);
    for (i = 0; i < s->mesh_count; i++) {
        memset(s->meshes[i].transform, 0, sizeof s->meshes[i].transform);
        for (j = 0; j < 3; j++) for (k = 0; k < 3; k++) s->meshes[i].transform[4 * j + k] = (float)m[j][k];
        s->meshes[i].transform[15] = 1;
    }
    for (j = 0; j < 3; j++) for (k = 0; k < 3; k++) v[j][k] = (double)view->world_to_view[4 * j + k];
    for (j = 0; j < 3; j++)  /* multiplies by the transposed matrix, which rotates back first */
        for (k = 0; k < 3; k++)
            view->world_to_view[4 * j + k] = (float)(v[0][k] * m[0][j] + v[1][k] * m[1][j] + v[2][k] * m[2][j]);
}

/* R of the Cornell box in SBL_MODE_PAPER equals the sums on the CPU, for two sensor sizes and two fields of view. */
TEST(paper_sums) {
    test_scene s = { 0 };
    sbl_picture_desc view = scene_plain(scene_view(20, 20, 37, 278, 273, -800, 278, 273, 0), SBL_MODE_PAPER, 64);
    scene_cornell_box(&s);
    turn(&s, &view, 0.5, 0.3);
    view.options.epsilon = 0.02f;
    check_paper(&s, view, 135, "Cornell box");
    view.options.epsilon = 0.5f;
    view.options.sensor_size = 33;
    view.sensor_fov = 100;
    check_paper(&s, view, 100, "Cornell box, 33 texels, 100 degrees");
    scene_free(&s);
}

/* Normals in all directions test both cases in the definition of the sensor axes. */
TEST(paper_sums_on_sphere) {
    test_scene s = { 0 };
    sbl_picture_desc view = scene_plain(scene_view(16, 12, 60, 0.2f, 0.3f, 0.1f, 0.5f, -0.2f, -1), SBL_MODE_PAPER, 24);
    static const float eyes[3][3] = { { 2, 1, -1 }, { -1, -2, 0.5f }, { 0.3f, 0.2f, 2 } };
    int i;
    view.options.epsilon = 0.25f;
    scene_sphere(&s, scene_material(&s, 0.7f, 0.2f, 0.4f), 0, 0, 0, 3, 16, 11, 0);
    scene_box(&s, scene_lamp(&s, 2, 3, 1), 0.5f, 0.9f, -1.1f, 0.9f, 1.2f, -0.6f);
    scene_box(&s, scene_material(&s, 0.1f, 0.9f, 0.9f), -1.2f, -0.7f, -0.3f, -0.6f, 0.4f, 0.5f);
    for (i = 0; i < 3; i++) {
        sbl_look_at(view.world_to_view, 0.1f, 0.2f, 0.1f, eyes[i][0], eyes[i][1], eyes[i][2], 0, 1, 0);
        turn(&s, &view, 0.5, 0.3);
        check_paper(&s, view, 135, "inside a sphere");
    }
    scene_free(&s);
}

/* Inspected sensors have the axes, the field of view and the weights of the paper. */
TEST(paper_frame_and_weights) {
    test_scene s = { 0 };
    sbl_picture_desc view = scene_plain(scene_view(9, 9, 60, 0.1f, 0.2f, 0.1f, 2, 1, -1), SBL_MODE_PAPER, 16);
    int x, y, i, j;
    scene_sphere(&s, scene_material(&s, 0.7f, 0.2f, 0.4f), 0, 0, 0, 3, 9, 7, 0);
    if (!scene_render(context, &s, &view)) { scene_free(&s); return; }
    for (y = 0; y < 9; y += 4)
        for (x = 0; x < 9; x += 4) {
            sbl_sensor sensor;
            float weights[256], radiance[1024];
            double worst = 0, s_max = tan(67.5 * REF_PI / 180);
            v3 right, up;
            memset(&sensor, 0, sizeof sensor);
            memset(weights, 0, sizeof weights);
            CHECK(sbl_inspect_sensor(context, x, y, &sensor, radiance, weights, 256) == SBL_SUCCESS,
                  "the sensor cannot be inspected");
            CHECK(sensor.view_count == 1 && sensor.sheet_width == 16 && sensor.sheet_height == 16,
                  "%d views on %d x %d", sensor.view_count, sensor.sheet_width, sensor.sheet_height);
            frame(v3_from(sensor.normal), &right, &up);
            CHECK(v3_dot(v3_from(sensor.views[0].right), right) > 0.99999 && v3_dot(v3_from(sensor.views[0].up), up) >
                  0.99999 &&
                  v3_dot(v3_from(sensor.views[0].forward), v3_from(sensor.normal)) > 0.99999,
                      "pixel %d %d: the frame differs", x, y);
            CHECK(fabs((double)sensor.views[0].x0 + s_max) < 1e-5 && fabs((double)sensor.views[0].x1 - s_max) < 1e-5 &&
                  fabs((double)sensor.views[0].y0 + s_max) < 1e-5 && fabs((double)sensor.views[0].y1 - s_max) < 1e-5,
                      "the field of view differs: %g", (double)sensor.views[0].x1);
            for (i = 0; i < 16; i++)
                for (j = 0; j < 16; j++)
                    worst = test_max(worst, fabs((double)weights[16 * i + j] - paper_weight(135, 16, j, i)));
            CHECK(worst < 1e-7, "weights are off by %.3g", worst);
        }
    scene_free(&s);
}

/* >>the filter */

/* Makes a step: the top face sees the whole sky and has R = 1; black ground hides half of the sky from the front face,
   which has R = 0.5. The edge between them crosses the picture. */
static void step_scene(test_scene *s) {
    int black = scene_material(s, 0, 0, 0);
    scene_quad(s, black, -50, 0, -50, -50, 0, 0, 50, 0, 0, 50, 0, -50);
    scene_quad(s, black, -50, -1, 0, 50, -1, 0, 50, 0, 0, -50, 0, 0);
    scene_floor(s, black, -1, 1000);
    scene_sky(s, 1, 1, 1);
}

static sbl_picture_desc step_view(int width, int height) {
    return scene_view(width, height, 20, 0.3f, 2, 2, 0.3f, 0, 0);
}

/* Returns the largest error of R on the step. *between: number of pixels whose R is between the two values, at least
   0.1 from 0.5 and from the 0.88 that the paper's views see of the sky. */
static double step_error(const test_scene *s, const sbl_picture_desc *view, int *between) {
    double worst = 0;
    int i, tops = 0, fronts = 0;
    float *radiance, *normal;
    *between = 0;
    if (!scene_render(context, s, view)) return 1e30;
    radiance = scene_channel(context, view, SBL_CHANNEL_RADIANCE);
    normal = scene_channel(context, view, SBL_CHANNEL_NORMAL);
    for (i = 0; i < view->width * view->height; i++) {
        double expected = normal[3 * i + 1] > 0.5f ? 1 : 0.5, off = fabs((double)radiance[3 * i] - expected);
        tops += expected == 1;
        fronts += expected < 1;
        *between += radiance[3 * i] > 0.6f && radiance[3 * i] < 0.8f;
        if (!(off <= worst)) worst = off;
    }
    CHECK(tops > view->width * view->height / 5 && fronts > view->width * view->height / 5,
          "%d pixels of the top, %d of the front", tops, fronts);
    free(radiance);
    free(normal);
    return worst;
}

/* The filter does not mix surfaces with different ids or normals. The paper's filter compares only ids. */
TEST(filter_stays_on_its_surface) {
    test_scene s = { 0 };
    sbl_picture_desc view = step_view(24, 24);
    double worst;
    int between, unfiltered;
    step_scene(&s);
    view = scene_plain(view, SBL_MODE_DIRECT, 64);
    view.filter_radius = 6;
    worst = step_error(&s, &view, &between);
    CHECK(worst < 0.005 && between == 0, "two ids: R is off by %.4f, %d pixels are mixed", worst, between);
    s.meshes[0].id = s.meshes[1].id = 7;
    worst = step_error(&s, &view, &between);
    CHECK(worst < 0.005 && between == 0, "one id, two normals: R is off by %.4f, %d pixels are mixed", worst, between);
    view.options.mode = SBL_MODE_PAPER;
    view.options.sensor_size = 32;
    view.tile = 1;  /* nothing is interpolated */
    step_error(&s, &view, &between);
    view.filter_radius = -1;
    step_error(&s, &view, &unfiltered);
    printf("  %d pixels are mixed, %d without the filter\n", between, unfiltered);
    CHECK(between >= 24 && unfiltered == 0,
          "the paper's filter compares only ids, but mixes %d pixels, and %d without it", between, unfiltered);
    scene_free(&s);
}

/* The top and the front of a step have different ids, so the paper's filter must not mix their light. The view of a
   sensor on the top sees 0.877 of the sky. On the front, whose normal is +z, it sees the sky in the texels above the
   horizon. This is not exactly half of 0.877, because equation 4 uses the size of a texel at one of its corners. */
TEST(paper_filter_stays_on_its_id) {
    test_scene s = { 0 };
    sbl_picture_desc view = scene_plain(step_view(24, 24), SBL_MODE_PAPER, 64);
    double low[2] = { 9, 9 }, high[2] = { 0, 0 };
    double expected[2] = { 0, 0 };
    float *radiance, *id;
    v3 right, up;
    int i, j;
    step_scene(&s);
    frame(v3_of(0, 0, 1), &right, &up);
    for (i = 0; i < 64; i++)
        for (j = 0; j < 64; j++) {
            expected[0] += paper_weight(135, 64, j, i);
            if (right.y * (j - 31.5) + up.y * (i - 31.5) > 0) expected[1] += paper_weight(135, 64, j, i);
        }
    view.filter_radius = 8;
    view.options.epsilon = 0.02f;
    if (!scene_render(context, &s, &view)) { scene_free(&s); return; }
    radiance = scene_channel(context, &view, SBL_CHANNEL_RADIANCE);
    id = scene_channel(context, &view, SBL_CHANNEL_ID);
    for (i = 0; i < 24 * 24; i++) {
        int which = (int)id[i] - 1;
        if (which < 0 || which > 1) { CHECK(0, "id %g", (double)id[i]); continue; }
        low[which] = test_min(low[which], (double)radiance[3 * i]);
        high[which] = test_max(high[which], (double)radiance[3 * i]);
    }
    for (i = 0; i < 2; i++)
        CHECK(low[i] > expected[i] - 1e-3 && high[i] < expected[i] + 1e-3,
              "the %s's R runs from %.4f to %.4f, expected %.4f", i ? "front" : "top", low[i], high[i], expected[i]);
    free(radiance);
    free(id);
    scene_free(&s);
}

/* The filter keeps the mean of a noisy picture, except at borders, and removes most of the noise. */
TEST(filter_smooths) {
    static const sbl_mode modes[] = { SBL_MODE_PAPER, SBL_MODE_AMBIENT };
    int mode, filtered, i;
    for (mode = 0; mode < 2; mode++) {
        test_scene s = { 0 };
        double mean[2], variance[2];
        scene_floor(&s, scene_material(&s, 0.5f, 0.5f, 0.5f), 0, 1000);
        scene_sphere(&s, scene_material(&s, 1, 1, 1), 1, 30, 2, 16, 24, 16, 0);
        for (filtered = 0; filtered < 2; filtered++) {
            sbl_picture_desc view = scene_plain(scene_view(48, 48, 30, 0, 9, 1, 0, 0, 0), modes[mode], 8);
            double sum = 0, squares = 0;
            view.filter_radius = filtered ? 4 : -1;
            view.options.epsilon = 5;  /* with this epsilon, texels see emissive surfaces */
            if (scene_render(context, &s, &view)) {
                float *radiance = scene_channel(context, &view, SBL_CHANNEL_RADIANCE);
                for (i = 0; i < 48 * 48; i++) {
                    sum += (double)radiance[3 * i];
                    squares += (double)radiance[3 * i] * (double)radiance[3 * i];
                }
                free(radiance);
            }
            mean[filtered] = sum / (48 * 48);
            variance[filtered] = squares / (48 * 48) - mean[filtered] * mean[filtered];
        }
        CHECK(mean[0] > 0 && fabs(mean[1] / mean[0] - 1) < 0.02, "mode %d: the mean goes from %.4f to %.4f",
              (int)modes[mode], mean[0], mean[1]);
        /* in the paper's mode sensors are not rotated: all have the same error, and there is no noise */
        if (modes[mode] == SBL_MODE_AMBIENT) {
            CHECK(variance[0] > 1e-5 * mean[0] * mean[0], "there is no noise to smooth: %g", variance[0]);
            CHECK(variance[1] < 0.2 * variance[0], "the variance goes from %g to %g", variance[0], variance[1]);
        }
        scene_free(&s);
    }
}

/* >>refinement and interpolation */

static void glowing_box(test_scene *s) { scene_box(s, scene_lamp(s, 1, 1, 1), -1, -1, -1, 1, 1, 1); }

static sbl_picture_desc inside_view(int width, int height) {
    return scene_view(width, height, 80, 0.2f, -0.3f, 0.8f, -0.1f, 0.1f, -1);
}

/* All combinations of picture and tile sizes give R = 1 at every pixel, with and without interpolation. */
TEST(odd_sizes) {
    static const int pictures[][2] = { { 1, 1 }, { 1, 7 }, { 7, 1 }, { 3, 2 }, { 2, 2 }, { 16, 16 }, { 17, 16 },
        { 33, 15 }, { 31, 47 }, { 50, 3 } };
    static const int tiles[] = { 0, 1, 2, 3, 5, 16, 64, 1024 };
    static const sbl_mode modes[] = { SBL_MODE_DIRECT, SBL_MODE_PAPER };
    test_scene s = { 0 };
    int p, t, m, i;
    glowing_box(&s);
    for (m = 0; m < 2; m++)
        for (p = 0; p < (int)(sizeof pictures / sizeof *pictures); p++)
            for (t = 0; t < (int)(sizeof tiles / sizeof *tiles); t++) {
                sbl_picture_desc view = inside_view(pictures[p][0], pictures[p][1]);
                double worst = 0, expected = m ? 0.8773 : 1;
                float *radiance, *final, *sensed;
                int marked = 0, pixels = view.width * view.height;
                sbl_stats stats;
                view.options.mode = modes[m];
                view.tile = tiles[t];
                view.options.sensor_size = m ? 32 : 8;
                if (!scene_render(context, &s, &view)) continue;
                radiance = scene_channel(context, &view, SBL_CHANNEL_RADIANCE);
                final = scene_channel(context, &view, SBL_CHANNEL_FINAL);
                sensed = scene_channel(context, &view, SBL_CHANNEL_SENSORS);
                for (i = 0; i < 3 * pixels; i++)
                    worst = test_max(worst, test_max(fabs((double)radiance[i] - expected), fabs((double)final[i] - 1)));
                for (i = 0; i < 3 * pixels; i++)
                    if (!(radiance[i] == radiance[i]) || !(final[i] == final[i])) worst = 1e30;
                for (i = 0; i < pixels; i++) marked += sensed[i] > 0;
                stats = sbl_query_stats(context);
                CHECK(worst < 0.005, "mode %d, %d x %d, tile %d: R is off by %.4f", (int)modes[m], view.width,
                      view.height, tiles[t], worst);
                CHECK(stats.picture.visible_pixels == pixels, "%d x %d: %d pixels are visible", view.width, view.height,
                      stats.picture.visible_pixels);
                CHECK(marked == stats.sensors.sites && marked > 0,
                      "%d x %d, tile %d: %d pixels are marked, but sensors.sites is %d", view.width, view.height,
                      tiles[t], marked, (int)stats.sensors.sites);
                CHECK(tiles[t] != 1 || marked == pixels, "%d x %d: with tile 1, %d pixels have a sensor", view.width,
                      view.height,
                      marked);
                free(radiance); free(final); free(sensed);
            }
    scene_free(&s);
}

/* Constant light on a surface needs only sensors of the first, coarse level, and sensors at borders. */
TEST(constant_light_needs_few_sensors) {
    static const sbl_mode modes[] = { SBL_MODE_DIRECT, SBL_MODE_PAPER };
    int m, i;
    for (m = 0; m < 2; m++) {
        test_scene s = { 0 };
        sbl_picture_desc view = scene_view(96, 64, 30, 1, 3, 4, 0, 0, 0);
        double off[2] = { 0, 0 };
        int fine;
        scene_floor(&s, scene_material(&s, 0.5f, 0.5f, 0.5f), 0, 1000);
        scene_sky(&s, 1, 1, 1);
        view.options.mode = modes[m];
        view.options.sensor_size = 32;
        for (fine = 0; fine < 2; fine++) {
            float *radiance;
            sbl_stats stats;
            view.tile = fine ? 1 : 16;
            if (!scene_render(context, &s, &view)) continue;
            radiance = scene_channel(context, &view, SBL_CHANNEL_RADIANCE);
            stats = sbl_query_stats(context);
            for (i = 0; i < 96 * 64; i++)
                off[fine] = test_max(off[fine], fabs((double)radiance[3 * i] - (m ? 0.8773 : 1)));
            if (fine) CHECK(stats.sensors.sites == 96 * 64, "tile 1: sensors.sites is %d", (int)stats.sensors.sites);
            else
                CHECK(stats.sensors.sites >= 4 * 6 && stats.sensors.sites <= 5 * 7 * 2,
                      "tile 16: sensors.sites is %d for 24 tiles", (int)stats.sensors.sites);
            free(radiance);
        }
        CHECK(off[0] < 0.002 && off[1] < 0.002, "mode %d: R is off by %.5f with tiles, by %.5f without", (int)modes[m],
              off[0], off[1]);
        scene_free(&s);
    }
}

/* Interpolation never crosses the edge of the step, where R halves: each interpolated pixel has the value of its own
   surface. This is also true if the threshold is so large that no tile is refined. */
TEST(interpolation_stays_on_its_surface) {
    test_scene s = { 0 };
    int between, kind;
    step_scene(&s);
    for (kind = 0; kind < 4; kind++) {
        const char *name = kind % 2 ? "one id" : "two ids";
        sbl_picture_desc view = step_view(64, 64);
        sbl_stats stats;
        double worst;
        view.options.mode = SBL_MODE_DIRECT;
        view.options.sensor_size = 32;
        view.options.rays = 256;
        view.threshold = kind < 2 ? 0 : 1e6f;
        view.filter_radius = kind < 2 ? 0 : -1;
        s.meshes[0].id = kind % 2 ? 7 : 0;
        s.meshes[1].id = s.meshes[0].id;
        worst = step_error(&s, &view, &between);
        stats = sbl_query_stats(context);
        CHECK(worst < 0.02 && between == 0, "%s, threshold %g: R is off by %.4f, %d pixels are mixed", name,
              (double)view.threshold, worst, between);
        CHECK(stats.sensors.sites < 64 * 64 / 2, "%s: %d sensors", name, (int)stats.sensors.sites);
    }
    scene_free(&s);
}

/* Only pixels that show a surface get a sensor. With a tile of 1 all of these get one. */
TEST(tile_1_senses_what_is_visible) {
    test_scene s = { 0 };
    sbl_picture_desc view = scene_plain(scene_view(40, 30, 40, 0, 1, 6, 0, 0, 0), SBL_MODE_DIRECT, 8);
    float *id, *sensed;
    int i, visible = 0, wrong = 0;
    sbl_stats stats;
    scene_sphere(&s, scene_material(&s, 0.5f, 0.5f, 0.5f), 0, 0, 0, 1, 24, 16, 0);
    scene_sky(&s, 1, 1, 1);
    if (!scene_render(context, &s, &view)) { scene_free(&s); return; }
    id = scene_channel(context, &view, SBL_CHANNEL_ID);
    sensed = scene_channel(context, &view, SBL_CHANNEL_SENSORS);
    stats = sbl_query_stats(context);
    for (i = 0; i < 40 * 30; i++) {
        visible += id[i] != 0;
        wrong += (id[i] != 0) != (sensed[i] != 0);
    }
    CHECK(visible > 100 && visible < 1000, "%d pixels show the sphere", visible);
    CHECK(wrong == 0, "%d pixels wrongly have a sensor, or have none", wrong);
    CHECK(stats.sensors.sites == visible && stats.picture.visible_pixels == visible,
          "sensors.sites is %d, visible_pixels %d, expected %d", (int)stats.sensors.sites, stats.picture.visible_pixels,
          visible);
    CHECK(stats.sensors.views == 5 * stats.sensors.sites, "%d views", (int)stats.sensors.views);
    free(id);
    free(sensed);
    scene_free(&s);
}

/* Checks that each level halves the tile, and that a lower threshold gives more sensors and a smaller error of
   interpolation. thresholds: in ascending order. */
static void check_threshold(sbl_mode mode, const float thresholds[3]) {
    test_scene s = { 0 };
    sbl_picture_desc view = scene_cornell_view(64, 64);
    int64_t sensors[3] = { 0, 0, 0 };
    double off[3] = { 0, 0, 0 };
    float *exact = NULL;
    int i, k;
    scene_cornell_box(&s);
    view.options.mode = mode;
    view.options.sensor_size = 32;
    view.filter_radius = -1;
    view.tile = 1;
    if (scene_render(context, &s, &view)) exact = scene_channel(context, &view, SBL_CHANNEL_RADIANCE);
    view.tile = 16;
    for (k = 0; k < 3 && exact; k++) {
        float *radiance;
        sbl_stats stats;
        int64_t sum = 0;
        double mean = 0;
        view.threshold = thresholds[k];
        if (!scene_render(context, &s, &view)) continue;
        radiance = scene_channel(context, &view, SBL_CHANNEL_RADIANCE);
        stats = sbl_query_stats(context);
        sensors[k] = stats.sensors.sites;
        for (i = 0; i < 64 * 64; i++) {
            mean += (double)exact[3 * i] / (64 * 64);
            off[k] += fabs((double)radiance[3 * i] - (double)exact[3 * i]) / (64 * 64);
        }
        off[k] /= mean;
        CHECK(stats.picture.level_count == 5, "%d levels", stats.picture.level_count);
        for (i = 0; i < stats.picture.level_count && i < SBL_MAX_LEVELS; i++) {
            sum += stats.picture.levels[i].sensors;
            CHECK(stats.picture.levels[i].tile == 16 >> i, "level %d has tile %d", i, stats.picture.levels[i].tile);
        }
        CHECK(sum == stats.sensors.sites, "the levels sum to %d sensors, expected %d", (int)sum,
              (int)stats.sensors.sites);
        free(radiance);
    }
    printf("  thresholds %g %g %g: %d %d %d sensors of %d, mean error %.2f %.2f %.2f %%\n", (double)thresholds[0],
           (double)thresholds[1], (double)thresholds[2],
           (int)sensors[0], (int)sensors[1], (int)sensors[2], 64 * 64, 100 * off[0], 100 * off[1], 100 * off[2]);
    CHECK(sensors[0] > sensors[1] && sensors[1] > sensors[2] && sensors[2] > 0, "sensors %d %d %d", (int)sensors[0],
          (int)sensors[1], (int)sensors[2]);
    CHECK(off[0] < off[1] + 1e-9 && off[1] < off[2], "errors %.4f %.4f %.4f", off[0], off[1], off[2]);
    CHECK(off[0] < 0.01, "the error with the finest threshold is %.2f %%", 100 * off[0]);
    free(exact);
    scene_free(&s);
}

/* In SBL_MODE_DIRECT the threshold is relative to the light: larger thresholds give fewer sensors. */
TEST(relative_threshold) {
    static const float thresholds[] = { 0.001f, 0.1f, 100 };
    check_threshold(SBL_MODE_DIRECT, thresholds);
}

/* In SBL_MODE_PAPER the threshold is an absolute radiance: larger thresholds give fewer sensors. */
TEST(absolute_threshold) {
    static const float thresholds[] = { 0.0001f, 0.05f, 100 };
    check_threshold(SBL_MODE_PAPER, thresholds);
}

/* In SBL_MODE_PAPER the threshold is a radiance: with eight times the light, eight times the threshold gives the same
   sensors. In other modes the same threshold gives the same sensors. */
TEST(threshold_units) {
    static const sbl_mode modes[] = { SBL_MODE_PAPER, SBL_MODE_DIRECT };
    int m, k;
    for (m = 0; m < 2; m++) {
        int64_t sensors[3] = { 0, 0, 0 };
        for (k = 0; k < 3; k++) {  /* unchanged; eight times the light; eight times the light and threshold */
            test_scene s = { 0 };
            sbl_picture_desc view = scene_cornell_view(48, 48);
            int i;
            scene_cornell_box(&s);
            for (i = 0; i < 3; i++) s.materials[3].emission[i] *= k ? 8 : 1;
            view.options.mode = modes[m];
            view.options.sensor_size = 16;
            view.threshold = k == 2 ? 0.4f : 0.05f;
            view.options.epsilon = 1e-9f;
            if (scene_render(context, &s, &view)) sensors[k] = sbl_query_stats(context).sensors.sites;
            scene_free(&s);
        }
        if (m == 0)
            CHECK(sensors[1] > sensors[0] && sensors[2] == sensors[0], "paper: %d, %d, %d sensors", (int)sensors[0],
                  (int)sensors[1], (int)sensors[2]);
        else CHECK(sensors[1] == sensors[0] && sensors[2] < sensors[0], "relative: %d, %d, %d sensors", (int)sensors[0],
                   (int)sensors[1], (int)sensors[2]);
    }
}

int main(void) {
    if (sbl_create(NULL, &context) != SBL_SUCCESS) { printf("no context\n0 passed, 1 failed, 0 skipped\n"); return 1; }
    RUN(paper_sums);
    RUN(paper_sums_on_sphere);
    RUN(paper_frame_and_weights);
    RUN(filter_stays_on_its_surface);
    RUN(paper_filter_stays_on_its_id);
    RUN(filter_smooths);
    RUN(odd_sizes);
    RUN(constant_light_needs_few_sensors);
    RUN(interpolation_stays_on_its_surface);
    RUN(tile_1_senses_what_is_visible);
    RUN(relative_threshold);
    RUN(absolute_threshold);
    RUN(threshold_units);
    sbl_destroy(context);
    return test_report();
}
