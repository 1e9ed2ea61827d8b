/* Compares pictures with R in closed form: furnaces, skies, Lambert's formula for polygons, occlusion by half spaces,
   and the weights of sensors. */
#include "../sbl.h"
#include "support/test.h"
#include "support/scenes.h"
#include "support/inside.h"
#include "support/reference.h"

static sbl_context *context;

/* Returns the largest |R - expected| over the pixels that show a surface, or 1e30 if none does. Unless `holes` is 1,
   all pixels must show one. */
static double worst_radiance(const test_scene *s, const sbl_picture_desc *view, double r, double g, double b,
                             int holes) {
    double expected[3], worst = 0;
    int i, k, seen = 0, pixels = view->width * view->height;
    float *radiance, *id;
    expected[0] = r; expected[1] = g; expected[2] = b;
    if (!scene_render(context, s, view)) return 1e30;
    radiance = scene_channel(context, view, SBL_CHANNEL_RADIANCE);
    id = scene_channel(context, view, SBL_CHANNEL_ID);
    for (i = 0; i < pixels; i++) {
        if (id[i] == 0) continue;
        seen++;
        for (k = 0; k < 3; k++) {
            double off = fabs((double)radiance[3 * i + k] - expected[k]);
            if (!(off <= worst)) worst = off == off ? off : 1e30;
        }
    }
    CHECK(holes ? seen > 0 : seen == pixels, "%d of %d pixels show a surface", seen, pixels);
    free(radiance);
    free(id);
    return seen ? worst : 1e30;
}

/* >>skies and furnaces */

static const int sizes[] = { 4, 5, 7, 31, 32, 64, 512 };
enum { SIZES = sizeof sizes / sizeof *sizes };

/* An unoccluded plane under a sky of 1 has R = 1, at all sensor sizes. */
TEST(open_plane_under_sky) {
    test_scene s = { 0 };
    int i;
    scene_floor(&s, scene_material(&s, 0.5f, 0.5f, 0.5f), 0, 1000);
    scene_sky(&s, 1, 0.5f, 0.25f);
    for (i = 0; i < SIZES; i++) {
        int width = sizes[i] > 64 ? 1 : 16;
        sbl_picture_desc view = scene_plain(scene_view(width, width > 1 ? 12 : 1, 40, 1, 3, 4, 0, 0, 0),
                                            SBL_MODE_DIRECT, sizes[i]);
        double worst = worst_radiance(&s, &view, 1, 0.5, 0.25, 0);
        CHECK(worst < 0.0005, "sensor size %d: R is off by %.5f under a sky of 1", sizes[i], worst);
    }
    scene_free(&s);
}

/* In a closed box that emits and does not reflect, R equals the emission, at all sensor sizes. */
TEST(furnace) {
    test_scene s = { 0 };
    int i;
    scene_box(&s, scene_material(&s, 0.25f, 0.5f, 1), -1, -1, -1, 1, 1, 1);
    scene_sky(&s, 50, 50, 50);  /* must not be visible */
    for (i = 0; i < SIZES; i++) {
        int width = sizes[i] > 64 ? 1 : 16;
        sbl_picture_desc view = scene_plain(scene_view(width, width > 1 ? 12 : 1, 90, 0.2f, -0.3f, 0.8f, -0.1f, 0, -1),
                                            SBL_MODE_AMBIENT, sizes[i]);
        double worst;
        view.options.epsilon = 2;
        worst = worst_radiance(&s, &view, 0.5, 1, 2, 0);
        CHECK(worst < 0.0025, "sensor size %d: R is off by %.5f in a furnace of 0.5 1 2", sizes[i], worst);
    }
    scene_free(&s);
}

/* Tiles, interpolation and filtering do not change a constant R. */
TEST(furnace_default_settings) {
    test_scene s = { 0 };
    sbl_picture_desc view = scene_view(50, 37, 90, 0.2f, -0.3f, 0.8f, -0.1f, 0, -1);
    double worst;
    scene_box(&s, scene_lamp(&s, 1, 1, 1), -1, -1, -1, 1, 1, 1);
    worst = worst_radiance(&s, &view, 1, 1, 1, 0);
    CHECK(worst < 0.005, "R is off by %.5f", worst);
    scene_free(&s);
}

/* No part of a convex body is above the plane of one of its facets, so with flat shading R = 1. With smooth normals,
   the hemisphere is tilted by the angle d between normal and facet; the share that sees the sky is the cosine-weighted
   share above the plane of the facet, (1 + cos d) / 2. */
TEST(sphere_under_sky) {
    int smooth, x, y;
    for (smooth = 0; smooth < 2; smooth++) {
        test_scene s = { 0 };
        sbl_scene_desc desc;
        ref_scene *reference;
        sbl_picture_desc view = scene_plain(scene_view(24, 24, 40, 0.3f, 0.4f, 3.2f, 0, 0, 0), SBL_MODE_DIRECT, 64);
        double worst = 0, least = 1;
        int seen = 0;
        scene_sphere(&s, scene_material(&s, 0.5f, 0.5f, 0.5f), 0, 0, 0, 1, 12, 8, smooth);
        scene_sky(&s, 1, 1, 1);
        desc = scene_desc(&s);
        reference = ref_create(&desc);
        if (scene_render(context, &s, &view)) {
            float *radiance = scene_channel(context, &view, SBL_CHANNEL_RADIANCE);
            for (y = 0; y < view.height; y++)
                for (x = 0; x < view.width; x++) {
                    ref_point p = ref_pixel(reference, &view, x, y);
                    double expected = 0.5 + 0.5 * v3_dot(p.normal, p.face),
                        off = fabs((double)radiance[3 * (y * view.width + x)] - expected);
                    int corner, seam = 0;
                    /* skips pixels at the edge of a facet, where the sensor sees past it */
                    for (corner = 0; corner < 4; corner++)
                        seam |= v3_dot(p.face, ref_camera_point(reference, &view, x + 0.4 + 0.2 * (corner & 1),
                                                                y + 0.4 + 0.2 * (corner >> 1)).face) < 0.9999;
                    if (!p.hit || seam) continue;
                    /* skips normals that face away from the camera, because sbl.h may bend them */
                    if (smooth && v3_dot(p.normal, v3_unit(v3_sub(v3_of(0.3, 0.4, 3.2), p.position))) < 0.05) continue;
                    seen++;
                    if (expected < least) least = expected;
                    if (!(off <= worst)) worst = off;
                }
            free(radiance);
        }
        CHECK(seen > 100, "only %d pixels show the sphere", seen);
        CHECK(!smooth || least < 0.995, "the normals are tilted too little for the test: %.4f", least);
        CHECK(worst < 0.005, "%s sphere: R is off by %.5f", smooth ? "smooth" : "flat", worst);
        ref_destroy(reference);
        scene_free(&s);
    }
}

/* The view of the paper covers the directions (x, y, 1) with |x|, |y| <= S = tan(135 / 2 degrees), a square at
   distance 1. The form factor from a small patch to a parallel rectangle with one corner above it and edges a and b, in
   units of the distance, is
       1 / (2 pi) * (a / sqrt(1 + a^2) * atan(b / sqrt(1 + a^2)) + b / sqrt(1 + b^2) * atan(a / sqrt(1 + b^2)))
   Four such quarters with a = b = S, where S / sqrt(1 + S^2) = sin(67.5 degrees) =: s, give 4 / pi * s * atan(s) =
   0.8773. */
static double single_view_share(double fov) {
    double s = sin(fov * REF_PI / 360);
    return 4 / REF_PI * s * atan(s);
}

/* A single view of 135 or 90 degrees sees the share of the sky given by the closed form, and so does the estimator of
   the paper. */
TEST(single_view_under_sky) {
    test_scene s = { 0 };
    sbl_picture_desc view = scene_plain(scene_view(4, 3, 30, 1, 3, 4, 0, 0, 0), SBL_MODE_DIRECT, 64);
    double share = single_view_share(135), worst;
    scene_floor(&s, scene_material(&s, 0.5f, 0.5f, 0.5f), 0, 1000);
    scene_sky(&s, 1, 1, 1);
    CHECK(fabs(share - 0.8773) < 1e-4, "the closed form itself gives %.5f", share);
    view.sensor_kind = SBL_SENSOR_SINGLE;  /* the weights are exact at any size */
    worst = worst_radiance(&s, &view, share, share, share, 0);
    CHECK(worst < 1e-4, "one view of 135 degrees is off by %.6f from %.4f", worst, share);
    view.sensor_fov = 90;
    worst = worst_radiance(&s, &view, single_view_share(90), single_view_share(90), single_view_share(90), 0);
    CHECK(worst < 1e-4, "one view of 90 degrees is off by %.6f", worst);
    /* equation 4 converges to the exact share */
    view = scene_plain(scene_view(2, 1, 30, 1, 3, 4, 0, 0, 0), SBL_MODE_PAPER, 512);
    worst = worst_radiance(&s, &view, share, share, share, 0);
    CHECK(worst < 1e-4, "the paper's view is off by %.6f from %.4f", worst, share);
    scene_free(&s);
}

/* >>weights */

/* Returns the projected solid angle / pi of the directions forward + right * x + up * y with x in [x0, x1] and y in
   [y0, y1], without the part below the horizon. It integrates cos(theta) / |d|^3 by Gauss quadrature with five points,
   on 4 x 4 pieces. */
static double weight_by_quadrature(const sbl_sensor_view *view, v3 n, double x0, double x1, double y0, double y1) {
    static const double at[5] = { -0.906179845938664, -0.538469310105683, 0, 0.538469310105683, 0.906179845938664 };
    static const double weight[5] = { 0.236926885056189, 0.478628670499366, 0.568888888888889, 0.478628670499366,
        0.236926885056189 };
    double f = v3_dot(v3_from(view->forward), n), r = v3_dot(v3_from(view->right), n), u = v3_dot(v3_from(view->up), n),
        sum = 0;
    int piece, i, j;
    if (y0 > y1) { double swap = y0; y0 = y1; y1 = swap; }
    if (x0 > x1) { double swap = x0; x0 = x1; x1 = swap; }
    for (piece = 0; piece < 16; piece++) {
        double hx = (x1 - x0) / 8, cx = x0 + (2 * (piece & 3) + 1) * hx;
        for (i = 0; i < 5; i++) {
            double x = cx + hx * at[i], low = y0, high = y1, horizon, hy, cy;
            if (fabs(u) > 1e-3) {  /* horizon in this column: f + r x + u y = 0 */
                horizon = -(f + r * x) / u;
                if (u > 0 && horizon > low) low = horizon;
                if (u < 0 && horizon < high) high = horizon;
            }
            if (high <= low) continue;
            hy = (high - low) / 8;
            cy = low + (2 * (piece >> 2) + 1) * hy;
            for (j = 0; j < 5; j++) {
                double y = cy + hy * at[j], cosine = f + r * x + u * y, q = 1 + x * x + y * y;
                if (cosine > 0) sum += weight[i] * weight[j] * hx * hy * cosine / (q * q);
            }
        }
    }
    return sum / REF_PI;
}

static void check_weights(sbl_sensor_kind kind, int size, double expected_sum) {
    test_scene s = { 0 };
    sbl_picture_desc view = scene_plain(scene_view(2, 2, 30, 1, 3, 4, 0, 0, 0), SBL_MODE_DIRECT, size);
    sbl_sensor sensor;
    float *weights, *radiance;
    double sum = 0, exact_sum = 0, light = 0, worst = 0, frame = 0;
    size_t count;
    int v, i, j, outside = 0;
    uint64_t seed = 1;
    view.sensor_kind = kind;
    /* the ground is tilted, so that no axis is special */
    scene_quad(&s, scene_material(&s, 0.5f, 0.5f, 0.5f), -30, -12, -30, -30, -3, 30, 30, 12, 30, 30, 3, -30);
    scene_quad(&s, scene_lamp(&s, 1, 2, 3), -1, 5, -1, -1, 5, 1, 1, 5, 1, 1, 5, -1)->id = 9;
    scene_sky(&s, 0.5f, 0.5f, 0.5f);
    if (!scene_render(context, &s, &view)) { scene_free(&s); return; }
    memset(&sensor, 0, sizeof sensor);
    CHECK(sbl_inspect_sensor(context, 1, 1, &sensor, NULL, NULL, 0) == SBL_SUCCESS, "the sensor cannot be inspected");
    count = (size_t)sensor.sheet_width * (size_t)sensor.sheet_height;
    weights = (float *)calloc(count + 1, sizeof *weights);
    radiance = (float *)calloc(4 * count + 1, sizeof *radiance);
    if (!weights || !radiance) abort();
    CHECK(sbl_inspect_sensor(context, 1, 1, &sensor, radiance, weights, count) == SBL_SUCCESS,
          "the sensor cannot be looked at");
    CHECK(sensor.view_count == (kind == SBL_SENSOR_SINGLE ? 1 : 5), "%d views", sensor.view_count);
    CHECK(count > 0, "the sheet is empty");
    for (v = 0; v < sensor.view_count; v++) {
        const sbl_sensor_view *w = &sensor.views[v];
        v3 r = v3_from(w->right), u = v3_from(w->up), f = v3_from(w->forward);
        double skew = fabs(v3_dot(r, u)) + fabs(v3_dot(u, f)) + fabs(v3_dot(f, r)) + fabs(v3_length(r) - 1) +
            fabs(v3_length(u) - 1) + fabs(v3_length(f) - 1);
        if (!(skew <= frame)) frame = skew;
        for (j = 0; j < w->rect[3]; j++)
            for (i = 0; i < w->rect[2]; i++) {
                double dx = (double)(w->x1 - w->x0) / w->rect[2], dy = (double)(w->y1 - w->y0) / w->rect[3];
                double x = (double)w->x0 + i * dx, y = (double)w->y0 + j * dy;
                double exact = weight_by_quadrature(w, v3_from(sensor.normal), x, x + dx, y, y + dy), off;
                size_t at = (size_t)(w->rect[1] + j) * (size_t)sensor.sheet_width + (size_t)(w->rect[0] + i);
                if (at >= count) { CHECK(0, "view %d leaves the sheet", v); continue; }
                exact_sum += exact;
                off = fabs((double)weights[at] - exact);
                if (!(off <= worst)) worst = off;
            }
    }
    for (i = 0; i < (int)count; i++) {
        sum += (double)weights[i];
        light += (double)weights[i] * (double)radiance[4 * i + 1];
    }
    CHECK(frame < 1e-5, "size %d: the views' axes deviate from orthonormal by %.7f", size, frame);
    CHECK(fabs(sum - expected_sum) < 1e-5, "size %d: the weights' sum is %.7f, expected %.7f", size, sum, expected_sum);
    CHECK(fabs((double)sensor.weight_sum - sum) < 1e-5, "size %d: weight_sum is %.7f, the sum of the weights %.7f",
          size,
          (double)sensor.weight_sum, sum);
    CHECK(fabs(exact_sum - expected_sum) < 1e-5, "size %d: the views cover %.7f of the hemisphere, expected %.7f", size,
          exact_sum, expected_sum);
    /* float rounding of the weight of a texel, which is about 1 / texels */
    CHECK(worst < 1e-7 + 2e-5 / (size * size), "size %d: a texel's weight is off by %.3g (a mean weight is %.3g)", size,
          worst, 1.0 / (3 * size * size));
    CHECK(fabs(light - (double)sensor.from_surroundings[1]) < 2e-3 * light,
          "size %d: the texels sum to %.6f, from_surroundings is %.6f", size,
          light, (double)sensor.from_surroundings[1]);
    CHECK(light > 0.3, "size %d: the sensor is dark: %g", size, light);
    CHECK(sensor.looks == 1 && sensor.from_lamps[1] > 0.05f &&
          fabsf(sensor.from_surroundings[1] + sensor.from_lamps[1] - sensor.radiance[1]) < 1e-5f,
          "size %d: %d looks; %g from the surroundings, %g from the lamp, R is %g", size, sensor.looks, (double)
          sensor.from_surroundings[1],
          (double)sensor.from_lamps[1], (double)sensor.radiance[1]);
    /* every direction above the horizon is in exactly one view */
    for (i = 0; i < 2000 && kind != SBL_SENSOR_SINGLE; i++) {
        v3 d = v3_of(ref_random(&seed) - 0.5, ref_random(&seed) - 0.5, ref_random(&seed) - 0.5);
        int views = 0;
        if (v3_dot(d, v3_from(sensor.normal)) < 1e-3) continue;
        for (v = 0; v < sensor.view_count; v++) {
            const sbl_sensor_view *w = &sensor.views[v];
            double z = v3_dot(d, v3_from(w->forward)), x = v3_dot(d, v3_from(w->right)) / z,
                y = v3_dot(d, v3_from(w->up)) / z;
            double low_x = (double)fminf(w->x0, w->x1), high_x = (double)fmaxf(w->x0, w->x1);
            double low_y = (double)fminf(w->y0, w->y1), high_y = (double)fmaxf(w->y0, w->y1);
            views += z > 0 && x > low_x && x < high_x && y > low_y && y < high_y;
        }
        outside += views != 1;
    }
    CHECK(outside <= 2, "size %d: %d directions of 2000 are not in exactly one view", size, outside);
    free(weights);
    free(radiance);
    scene_free(&s);
}

/* The weights of a hemicube are exact at all sizes and add up to 1, and its views cover the hemisphere exactly once. */
TEST(weights_of_hemicube) {
    int i;
    for (i = 0; i < SIZES; i++) if (sizes[i] < 512) check_weights(SBL_SENSOR_HEMICUBE, sizes[i], 1);
}

/* The weights of a single view are exact and add up to the closed form. */
TEST(weights_of_single_view) {
    check_weights(SBL_SENSOR_SINGLE, 32, single_view_share(135));
    check_weights(SBL_SENSOR_SINGLE, 5, single_view_share(135));
}

/* The rotation of a sensor about its normal depends on pixel and seed. */
TEST(sensors_are_turned_by_pixel_and_seed) {
    test_scene s = { 0 };
    sbl_picture_desc view = scene_plain(scene_view(8, 8, 30, 1, 3, 4, 0, 0, 0), SBL_MODE_DIRECT, 8);
    sbl_sensor a[3];
    int i;
    scene_floor(&s, scene_material(&s, 0.5f, 0.5f, 0.5f), 0, 100);
    memset(a, 0, sizeof a);
    for (i = 0; i < 3; i++) {
        view.options.seed = i == 2 ? 77 : 5;
        if (i != 1 && !scene_render(context, &s, &view)) break;
        CHECK(sbl_inspect_sensor(context, 3 + (i == 1), 4, &a[i], NULL, NULL, 0) == SBL_SUCCESS,
              "the sensor cannot be looked at");
    }
    CHECK(v3_dot(v3_from(a[0].views[0].right), v3_from(a[1].views[0].right)) < 0.9999,
          "neighbouring pixels have the same frame");
    CHECK(v3_dot(v3_from(a[0].views[0].right), v3_from(a[2].views[0].right)) < 0.9999,
          "another seed gives the same frame");
    for (i = 0; i < 3; i++) CHECK(a[i].views[0].forward[1] > 0.99999f, "the first view does not look along the normal");
    scene_free(&s);
}

/* >>polygons */

/* R of a floor under polygonal lamps agrees with Lambert's formula. The lamps are hidden from the camera, so that they
   do not block its view of the floor. */
TEST(lambert_polygons) {
    static const struct { const char *name; int count; float corners[5][3]; } lamps[] = {
        { "square overhead", 4, { { -1, 1, -1 }, { 1, 1, -1 }, { 1, 1, 1 }, { -1, 1, 1 } } },
        { "triangle, low", 3, { { -0.6f, 0.5f, -0.7f }, { 0.9f, 0.5f, -0.4f }, { 0.2f, 0.5f, 0.9f } } },
        { "square, tilted and aside", 4, { { 1, 2.4f, -1 }, { 1, 2.4f, 1 }, { 2.4f, 1, 1 }, { 2.4f, 1, -1 } } },
        { "panel through the horizon", 4, { { 1.5f, -1, -2 }, { 1.5f, -1, 2 }, { 1.5f, 2, 2 }, { 1.5f, 2, -2 } } },
        { "leaning triangle through the horizon", 3, { { -1.2f, -1, -2 }, { -1.5f, -0.5f, 2 }, { -2.5f, 3, 0.5f } } },
        { "pentagon, 60 degrees", 5, { { -1, 1.5f, -1.5f }, { 1, 1.5f, -1.5f }, { 1.5f, 2.4f, -0.9804f },
            { 0, 3.3f, -0.4608f }, { -1.5f, 2.4f, -0.9804f } } },
        { "large and far", 4, { { -10, 20, -20 }, { 30, 20, -20 }, { 30, 20, 20 }, { -10, 20, 20 } } } };
    int lamp, i, x, y;
    for (lamp = 0; lamp < (int)(sizeof lamps / sizeof *lamps); lamp++) {
        test_scene s = { 0 };
        sbl_scene_desc desc;
        ref_scene *reference;
        sbl_picture_desc view = scene_plain(scene_view(10, 10, 20, 0.1f, 4, 0.2f, 0.1f, 0, 0.1f), SBL_MODE_DIRECT, 128);
        double sum = 0, expected_sum = 0, squares = 0, worst = 0;
        int light = scene_lamp(&s, 2, 1, 0.5f);
        v3 corners[5];
        s.materials[light].flags = SBL_MATERIAL_HIDDEN_FROM_CAMERA;
        scene_floor(&s, scene_material(&s, 0.5f, 0.5f, 0.5f), 0, 100);
        scene_polygon(&s, light, lamps[lamp].corners[0], lamps[lamp].count);
        for (i = 0; i < lamps[lamp].count; i++) corners[i] = v3_from(lamps[lamp].corners[i]);
        desc = scene_desc(&s);
        reference = ref_create(&desc);
        if (scene_render(context, &s, &view)) {
            float *radiance = scene_channel(context, &view, SBL_CHANNEL_RADIANCE);
            for (y = 0; y < view.height; y++)
                for (x = 0; x < view.width; x++) {
                    ref_point p = ref_pixel(reference, &view, x, y);
                    double expected = 2 * ref_polygon(p.position, v3_of(0, 1, 0), corners, lamps[lamp].count);
                    const float *r = radiance + 3 * (y * view.width + x);
                    double off = fabs((double)r[0] / expected - 1);
                    CHECK(fabsf(r[1] / r[0] - 0.5f) < 1e-3f && fabsf(r[2] / r[0] - 0.25f) < 1e-3f,
                          "%s: the light has another colour", lamps[lamp].name);
                    sum += (double)r[0];
                    expected_sum += expected;
                    squares += off * off;
                    if (!(off <= worst)) worst = off;
                }
            free(radiance);
        }
        /* Texels blur the rim of the lamp, differently at each pixel. The mean therefore shows the bias, and the RMS
           error the noise. */
        CHECK(fabs(sum / expected_sum - 1) < 0.003, "%s: mean R is off by %+.3f %%", lamps[lamp].name,
              100 * (sum / expected_sum - 1));
        CHECK(sqrt(squares / 100) < 0.01 && worst < 0.03, "%s: R is off by %.3f %% rms, %.3f %% at worst",
              lamps[lamp].name, 100 * sqrt(squares / 100), 100 * worst);
        ref_destroy(reference);
        scene_free(&s);
    }
}

/* Lambert's formula agrees with a sum over directions. The test above relies on it. */
TEST(lambert_formula_against_quadrature) {
    v3 corners[4], n = v3_unit(v3_of(0.3, 1, -0.2)), p = v3_of(0.1, 0, 0.2);
    double sum = 0, formula;
    int i, j, steps = 400;
    corners[0] = v3_of(1, -1, -1); corners[1] = v3_of(1.5, -1, 1); corners[2] = v3_of(1.5, 2, 1); corners[3] =
        v3_of(1, 2, -1);
    formula = ref_polygon(p, n, corners, 4);
    for (i = 0; i < steps; i++)
        for (j = 0; j < steps; j++) {
            v3 u = v3_sub(corners[1], corners[0]), v = v3_sub(corners[3], corners[0]);
            v3 d = v3_sub(v3_mad(v3_mad(corners[0], u, (i + 0.5) / steps), v, (j + 0.5) / steps), p);
            double cosine = v3_dot(d, n);
            if (cosine > 0)
                sum += cosine * fabs(v3_dot(d, v3_cross(u, v))) / pow(v3_dot(d, d), 2) / REF_PI / steps / steps;
        }
    CHECK(fabs(formula / sum - 1) < 1e-4, "formula %.7f, quadrature %.7f", formula, sum);
}

/* >>occlusion */

/* A very long wall whose top is at elevation a hides the directions below a on one side, which are (1 - cos a) / 2 of
   the cosine-weighted hemisphere. R under a sky of 1 is (1 + cos a) / 2. */
TEST(wall) {
    static const float heights[] = { 0.25f, 1, 4, 200 };
    int i, x, y;
    for (i = 0; i < 4; i++) {
        test_scene s = { 0 };
        sbl_picture_desc view = scene_plain(scene_view(8, 6, 30, 0.5f, 3, 0.5f, 0.5f, 0, 0), SBL_MODE_DIRECT, 128);
        sbl_scene_desc desc;
        ref_scene *reference;
        double sum = 0, expected_sum = 0, worst = 0;
        int black = scene_material(&s, 0, 0, 0);
        scene_floor(&s, black, 0, 100);
        scene_quad(&s, black, -1, 0, -200, -1, 0, 200, -1, heights[i], 200, -1, heights[i], -200);
        scene_sky(&s, 1, 1, 1);
        desc = scene_desc(&s);
        reference = ref_create(&desc);
        if (scene_render(context, &s, &view)) {
            float *radiance = scene_channel(context, &view, SBL_CHANNEL_RADIANCE);
            for (y = 0; y < view.height; y++)
                for (x = 0; x < view.width; x++) {
                    ref_point p = ref_pixel(reference, &view, x, y);
                    double away = p.position.x + 1, expected = 0.5 *
                        (1 + away / sqrt(away * away + (double)heights[i] * (double)heights[i]));
                    double off = fabs((double)radiance[3 * (y * view.width + x)] - expected);
                    sum += (double)radiance[3 * (y * view.width + x)];
                    expected_sum += expected;
                    if (!(off <= worst)) worst = off;
                }
            free(radiance);
        }
        CHECK(fabs(sum / expected_sum - 1) < 0.003, "wall of %g: mean R is off by %+.3f %%", (double)heights[i],
              100 * (sum / expected_sum - 1));
        CHECK(worst < 0.01, "wall of %g: R is off by %.4f", (double)heights[i], worst);
        ref_destroy(reference);
        scene_free(&s);
    }
}

/* A slope over an infinite black ground sees (1 + cos tilt) / 2 of the sky, and so does an overhang, with a tilt beyond
   90 degrees. */
TEST(slope) {
    static const int tilts[] = { 15, 45, 90, 135 };
    int i;
    for (i = 0; i < 4; i++) {
        test_scene s = { 0 };
        double t = tilts[i] * REF_PI / 180, expected = 0.5 * (1 + cos(t)), worst;
        /* the normal of the slope is (0, c, n), its upward direction (0, n, -c) */
        float c = (float)cos(t), n = (float)sin(t);
        sbl_picture_desc view = scene_plain(scene_view(8, 6, 10, 0.3f, 3 * c, 3 * n, 0, 0, 0), SBL_MODE_DIRECT, 128);
        int black = scene_material(&s, 0, 0, 0);
        scene_quad(&s, black, -2, -2 * n, 2 * c, 2, -2 * n, 2 * c, 2, 2 * n, -2 * c, -2, 2 * n, -2 * c);
        scene_floor(&s, black, -2.5f, 1000);
        scene_sky(&s, 1, 1, 1);
        worst = worst_radiance(&s, &view, expected, expected, expected, 0);
        CHECK(worst < 0.005, "tilt %d: R is off by %.4f from %.4f", tilts[i], worst, expected);
        scene_free(&s);
    }
}

/* >>scale */

/* Checks scenes with the same R everywhere, at all scales and far from the origin. A sensor that saw its own surface,
   or past an edge, would have another R. Vertices are binary fractions, so that translation does not change the
   shapes. */
static void check_scale(float scale, float away, int holes) {
    static const char *const names[] = { "inside a box that glows", "a box on the floor of one",
        "a sphere under the sky", "a closed dark room in bright light" };
    int kind;
    for (kind = 0; kind < 4; kind++) {
        test_scene s = { 0 };
        float ox = away * scale, oy = -0.5f * away * scale, oz = 0.75f * away * scale, expected = kind == 3 ? 0 : 1;
        double worst;
        int surface = kind < 2 ? scene_material(&s, 1, 1, 1) : scene_material(&s, 0.5f, 0.5f, 0.5f);
        sbl_picture_desc view = scene_view(24, 18, 75, 0, 0.5f * scale + 0, 1.75f * scale, 0, -1 * scale,
                                           -0.5f * scale);
        if (away != 0)
            view = scene_view(24, 18, 75, ox, oy + 0.5f * scale, oz + 1.75f * scale, ox, oy - scale, oz - 0.5f * scale);
        view = scene_plain(view, kind < 2 ? SBL_MODE_AMBIENT : SBL_MODE_DIRECT, 32);
        view.options.epsilon = 1;
        if (kind == 2) scene_sphere(&s, surface, 0, -0.5f, 0, 1, 48, 32, 0);
        else scene_box(&s, surface, -2, -1, -2, 2, 2, 2);
        if (kind == 1 || kind == 3) scene_box(&s, surface, -0.5f, -1, -0.5f, 0.25f, -0.25f, 0.5f);
        if (kind == 2) scene_sky(&s, 1, 1, 1);
        if (kind == 3) scene_sky(&s, 1000, 1000, 1000);
        scene_scale_and_move(&s, scale, ox, oy, oz);
        worst = worst_radiance(&s, &view, (double)expected, (double)expected, (double)expected, kind == 2 || holes);
        CHECK(worst < (kind == 3 ? 1e-3 : 0.005), "scale %g, %g scales from the origin: %s: R is off by %.4f",
              (double)scale, (double)away, names[kind], worst);
        scene_free(&s);
    }
}

/* R does not depend on the scale of the scene, from 0.01 to 10,000. */
TEST(scales) {
    check_scale(0.01f, 0, 0);
    check_scale(1, 0, 0);
    check_scale(100, 0, 0);
    check_scale(10000, 0, 0);
}

/* R does not depend on the distance from the origin, up to 1,024 times the size of the scene. */
TEST(far_from_the_origin) {
    check_scale(0.0078125f, 128, 0);
    check_scale(1, 128, 0);
    check_scale(1, 1024, 0);
    check_scale(8192, 128, 0);
}

/* A lamp is half a millimetre below the ceiling of a large room, and neither hides the other. */
TEST(thin_gaps) {
    test_scene s = { 0 };
    sbl_picture_desc view = scene_plain(scene_view(12, 9, 50, 0, 200, 0, 0, 0, 0), SBL_MODE_DIRECT, 64);
    double squares = 0, sum = 0, expected_sum = 0;
    v3 corners[4];
    int i, lamp, white = scene_material(&s, 0.7f, 0.7f, 0.7f);
    scene_box(&s, white, -300, 0, -300, 300, 600, 300);
    lamp = scene_lamp(&s, 1, 1, 1);
    scene_quad(&s, lamp, -150, 599.95f, -150, 150, 599.95f, -150, 150, 599.95f, 150, -150, 599.95f, 150);
    for (i = 0; i < 4; i++) corners[i] = v3_of(i == 1 || i == 2 ? 150 : -150, (double)599.95f, i >= 2 ? 150 : -150);
    if (scene_render(context, &s, &view)) {
        float *radiance = scene_channel(context, &view, SBL_CHANNEL_RADIANCE),
            *position = scene_channel(context, &view, SBL_CHANNEL_POSITION);
        for (i = 0; i < view.width * view.height; i++) {
            double expected = ref_polygon(v3_from(position + 3 * i), v3_of(0, 1, 0), corners, 4),
                off = (double)radiance[3 * i] / expected - 1;
            squares += off * off;
            sum += (double)radiance[3 * i];
            expected_sum += expected;
        }
        free(radiance);
        free(position);
    }
    CHECK(fabs(sum / expected_sum - 1) < 0.005, "mean R is off by %+.3f %%", 100 * (sum / expected_sum - 1));
    CHECK(sqrt(squares / (12 * 9)) < 0.03, "R is off by %.3f %% rms", 100 * sqrt(squares / (12 * 9)));
    scene_free(&s);
}

/* >>materials */

/* In a closed room without lamps, SBL_MODE_AMBIENT gives R = epsilon * albedo everywhere. */
TEST(ambient_room) {
    test_scene s = { 0 };
    sbl_picture_desc view = scene_plain(scene_view(12, 9, 90, 0.2f, -0.3f, 0.8f, -0.1f, 0, -1), SBL_MODE_AMBIENT, 16);
    double worst;
    scene_box(&s, scene_material(&s, 0.8f, 0.4f, 0.2f), -1, -1, -1, 1, 1, 1);
    scene_sky(&s, 9, 9, 9);
    view.options.epsilon = 0.5f;
    worst = worst_radiance(&s, &view, 0.4, 0.2, 0.1, 0);
    CHECK(worst < 0.001, "epsilon 0.5: R is off by %.5f", worst);
    view.options.epsilon = 0;  /* the default, 0.02 */
    worst = worst_radiance(&s, &view, 0.016, 0.008, 0.004, 0);
    CHECK(worst < 0.00005, "epsilon by default: R is off by %.6f", worst);
    view.options.epsilon = 0.5f;
    view.options.mode = SBL_MODE_DIRECT;
    worst = worst_radiance(&s, &view, 0, 0, 0, 0);
    CHECK(worst == 0, "direct mode has ambient light: %.5f", worst);
    scene_free(&s);
}

/* Vertex colours multiply the albedo, in R and in SBL_CHANNEL_ALBEDO. */
TEST(vertex_colours) {
    test_scene s = { 0 };
    sbl_picture_desc view = scene_plain(scene_view(12, 9, 90, 0.2f, -0.3f, 0.8f, -0.1f, 0, -1), SBL_MODE_AMBIENT, 16);
    float colors[4][4];
    double worst, off = 0;
    float *albedo;
    int i;
    for (i = 0; i < 4; i++) { colors[i][0] = 0.5f; colors[i][1] = 0.25f; colors[i][2] = 1; colors[i][3] = 1; }
    scene_box(&s, scene_material(&s, 0.8f, 0.4f, 0.2f), -1, -1, -1, 1, 1, 1);
    for (i = 0; i < s.mesh_count; i++) s.meshes[i].colors.data = colors;
    view.options.epsilon = 0.5f;
    worst = worst_radiance(&s, &view, 0.2, 0.05, 0.1, 0);
    CHECK(worst < 0.001, "R is off by %.5f", worst);
    albedo = scene_channel(context, &view, SBL_CHANNEL_ALBEDO);
    for (i = 0; i < 12 * 9; i++)
        off = test_max(off, fabs((double)albedo[3 * i] - 0.4) + fabs((double)albedo[3 * i + 1] - 0.1) +
                       fabs((double)albedo[3 * i + 2] - 0.2));
    CHECK(off < 0.001, "albedo is off by %.5f", off);
    free(albedo);
    scene_free(&s);
}

static double overlap(double a, double b, double low, double high) { return fmax(0, fmin(b, high) - fmax(a, low)); }

/* Anti-aliasing of an emitting rectangle on black: the value of each pixel is the share of its samples that the
   rectangle covers, which is about the covered share of its area. A pixel is one unit wide. */
TEST(samples_cover_pixels) {
    const double left = -2.3, right = 1.4, low = -1.2, high = 2.75;
    test_scene s = { 0 };
    sbl_picture_desc view = scene_view(8, 8, 90, 0, 0, 4, 0, 0, 0);
    float *final;
    double worst = 0, worst_sum = 0;
    int x, y, i;
    scene_quad(&s, scene_lamp(&s, 1, 1, 1), (float)left, (float)low, 0, (float)right, (float)low, 0, (float)right,
               (float)high, 0, (float)left, (float)high, 0);
    view.options.mode = SBL_MODE_DIRECT;
    view.samples = 64;
    if (!scene_render(context, &s, &view)) return;
    final = scene_channel(context, &view, SBL_CHANNEL_FINAL);
    for (y = 0; y < 8; y++)
        for (x = 0; x < 8; x++) {
            const double seen = (double)final[3 * (8 * y + x)];
            double sum = 0;
            for (i = 0; i < view.samples; i++) {
                float offset[2];  /* to the right; downwards */
                inside_sample_offset(i, view.samples, offset);
                sum += x - 3.5 + offset[0] > left && x - 3.5 + offset[0] < right && 3.5 - y - offset[1] > low && 3.5 -
                    y - offset[1] < high;
            }
            worst = test_max(worst, fabs(seen - overlap(x - 4, x - 3, left, right) * overlap(3 - y, 4 - y, low, high)));
            worst_sum = test_max(worst_sum, fabs(seen - sum / view.samples));
        }
    CHECK(worst < 0.05 && worst_sum < 1e-5, "a pixel differs by %.3f from its covered area, by %.5f from its covered "
          "samples",
          worst, worst_sum);
    free(final);
    scene_free(&s);
}

/* Pixels without a surface show the sky or the environment, here at the centres of its texels. */
TEST(environment_behind) {
    static float pixels[8 * 4 * 3];
    test_scene s = { 0 };
    sbl_scene_desc desc;
    double worst = 0;
    int i, k;
    for (i = 0; i < 8 * 4 * 3; i++) pixels[i] = 0.1f + 0.01f * (float)i;
    s.environment.picture.pixels = pixels;
    s.environment.picture.format = SBL_PIXELS_FLOAT;
    s.environment.picture.width = 8;
    s.environment.picture.height = 4;
    s.environment.picture.channels = 3;
    scene_sky(&s, 1, 2, 3);
    desc = scene_desc(&s);
    REQUIRE(sbl_set_scene(context, &desc) == SBL_SUCCESS, "no scene");
    for (i = 0; i < 64; i++) {  /* centres of texels, then borders with the next texel to the right */
        const int texel = i % 32, beside = i < 32 ? texel : texel / 8 * 8 + (texel + 1) % 8;
        const double down = REF_PI * (texel / 8 + 0.5) / 4;
        const double around = 2 * REF_PI * ((i % 8 + (i < 32 ? 0.5 : 1)) / 8 - 0.5);
        sbl_picture_desc view = scene_view(1, 1, 1, 0, 0, 0, (float)(sin(down) * cos(around)), (float)cos(down),
                                           (float)(sin(down) * sin(around)));
        float final[3] = { (float)NAN, 0, 0 };
        view.samples = 1;
        CHECK(sbl_render_picture(context, &view) == SBL_SUCCESS &&
                  sbl_read_channel(context, SBL_CHANNEL_FINAL, final, 3) == SBL_SUCCESS,
              "no picture");
        for (k = 0; k < 3; k++)
            worst = test_max(worst, fabs((double)final[k] - 1 - k - 0.5 * (double)pixels[3 * texel + k] -
                                         0.5 * (double)pixels[3 * beside + k]));
    }
    CHECK(worst < 1e-3, "the sky is off by %g", worst);
    scene_free(&s);
}

/* In a scene of a million units, a surface one unit from the camera is visible, although it is nearer than the depth
   buffer can resolve. */
TEST(near_things_in_large_scenes) {
    test_scene s = { 0 };
    sbl_picture_desc view = scene_plain(scene_view(8, 8, 60, 0, 1, 0, 0.1f, 0, 0.05f), SBL_MODE_DIRECT, 16);
    float *id;
    int i, seen = 0;
    scene_floor(&s, scene_material(&s, 0.5f, 0.5f, 0.5f), 0, 1e6f);
    scene_floor(&s, scene_material(&s, 0.5f, 0.5f, 0.5f), -1e6f, 1e6f);
    scene_sky(&s, 1, 1, 1);
    if (!scene_render(context, &s, &view)) return;
    id = scene_channel(context, &view, SBL_CHANNEL_ID);
    for (i = 0; i < 64; i++) seen += id[i] == 1;
    CHECK(seen == 64, "%d of 64 pixels show the floor", seen);
    free(id);
    scene_free(&s);
}

/* Conversion to 16-bit floats keeps exact values, and rounds values in between to nearest, ties to even. */
TEST(half_floats) {
    int i, wrong = 0;
    for (i = 0; i < 0x7bff; i++) {
        const float low = inside_from_half((uint16_t)i), high = inside_from_half((uint16_t)(i + 1)),
            middle = 0.5f * (low + high);
        const float below = low + 0.49f * (high - low), above = low + 0.51f * (high - low);
        wrong += inside_to_half(low) != i || inside_to_half(-high) != (0x8000 | (i + 1)) || !(high > low);
        wrong += inside_to_half(below) != i || inside_to_half(above) != i + 1 || inside_to_half(middle) != i + (i & 1);
    }
    CHECK(wrong == 0, "%d values are rounded wrongly", wrong);
    CHECK(inside_to_half(1) == 0x3c00 && inside_to_half(1e9f) == 0x7bff && inside_to_half(0) == 0,
          "1, 0 or a value that is too large is converted wrongly");
}

/* Adds a floor and an emitting lid of 2 x 2 at height 1. Returns the largest error of R on the floor. */
static double floor_under_lid(test_scene *s, sbl_picture_desc *view, const float corners[12], uint32_t flags,
                              double sky) {
    v3 lid[4];
    double worst = 0, share;
    int i, k, lamp = scene_lamp(s, 2, 2, 2);
    *view = scene_plain(scene_view(6, 6, 20, 0, 4, 0.1f, 0, 0, 0), SBL_MODE_DIRECT, 128);
    s->materials[lamp].flags = flags;
    scene_floor(s, scene_material(s, 0.5f, 0.5f, 0.5f), 0, 100);
    scene_quad_uv(s, lamp, corners, 1, 1);
    scene_sky(s, (float)sky, (float)sky, (float)sky);
    for (i = 0; i < 4; i++) lid[i] = v3_from(corners + 3 * i);
    if (!scene_render(context, s, view)) return 1e30;
    {
        float *radiance = scene_channel(context, view, SBL_CHANNEL_RADIANCE),
            *position = scene_channel(context, view, SBL_CHANNEL_POSITION);
        for (i = 0; i < view->width * view->height; i++) {
            share = ref_polygon(v3_from(position + 3 * i), v3_of(0, 1, 0), lid, 4);
            for (k = 0; k < 3; k++)
                worst = test_max(worst, fabs((double)radiance[3 * i + k] - share * 2 - (1 - share) * sky));
        }
        free(radiance);
        free(position);
    }
    return worst;
}

static const float lid_up[12] = { -1, 1, -1, -1, 1, 1, 1, 1, 1, 1, 1, -1 };    /* counter-clockwise from above */
static const float lid_down[12] = { -1, 1, -1, 1, 1, -1, 1, 1, 1, -1, 1, 1 };  /* counter-clockwise from below */

/* R of the floor under a lid is the sum of the closed forms of the lid and the sky. */
TEST(lid_and_sky) {
    test_scene s = { 0 };
    sbl_picture_desc view;
    double worst = floor_under_lid(&s, &view, lid_up, SBL_MATERIAL_HIDDEN_FROM_CAMERA, 0.75);
    CHECK(worst < 0.02, "R is off by %.4f", worst);
    scene_free(&s);
}

/* One-sided lamps light only the side that they face, also if they are mirrored. */
TEST(one_sided_emission) {
    test_scene s = { 0 };
    sbl_picture_desc view;
    double worst = floor_under_lid(&s, &view, lid_down,
                                   SBL_MATERIAL_HIDDEN_FROM_CAMERA | SBL_MATERIAL_ONE_SIDED_EMISSION, 0);
    static const float mirror[16] = { -1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1 };
    float *picture;
    int i;
    CHECK(worst < 0.02, "facing the floor: R is off by %.4f", worst);
    scene_free(&s);
    worst = floor_under_lid(&s, &view, lid_up, SBL_MATERIAL_HIDDEN_FROM_CAMERA | SBL_MATERIAL_ONE_SIDED_EMISSION, 0);
    CHECK(worst > 0.5, "facing away, the lid still lights the floor");
    worst = worst_radiance(&s, &view, 0, 0, 0, 0);
    CHECK(worst == 0, "facing away: R is %.4f", worst);
    scene_free(&s);
    /* mirroring does not exchange front and back, neither in the scene nor by sbl_set_mesh_transform */
    for (i = 0; i < 2; i++) {
        floor_under_lid(&s, &view, lid_down, SBL_MATERIAL_HIDDEN_FROM_CAMERA | SBL_MATERIAL_ONE_SIDED_EMISSION, 0);
        if (i == 0) {
            memcpy(s.meshes[1].transform, mirror, sizeof mirror);
            if (!scene_render(context, &s, &view)) break;
        } else
            CHECK(sbl_set_mesh_transform(context, 1, mirror) == SBL_SUCCESS &&
                      sbl_render_picture(context, &view) == SBL_SUCCESS,
                  "the mesh cannot be moved");
        picture = scene_channel(context, &view, SBL_CHANNEL_RADIANCE);
        CHECK(picture[0] > 0.5f, "mirrored%s, the lid faces away: R is %g", i ? " later" : "", (double)picture[0]);
        free(picture);
        scene_free(&s);
    }
    /* the same for a camera that sees the lid from above */
    floor_under_lid(&s, &view, lid_down, SBL_MATERIAL_ONE_SIDED_EMISSION, 0);
    picture = scene_channel(context, &view, SBL_CHANNEL_FINAL);
    CHECK(picture[0] < 1e-3f, "the back side emits: %g", (double)picture[0]);
    free(picture);
    scene_free(&s);
    floor_under_lid(&s, &view, lid_up, SBL_MATERIAL_ONE_SIDED_EMISSION, 0);
    picture = scene_channel(context, &view, SBL_CHANNEL_FINAL);
    CHECK(fabsf(picture[0] - 2) < 2e-3f, "the front side does not emit: %g", (double)picture[0]);
    free(picture);
    scene_free(&s);
}

/* A mesh that is hidden from the camera is invisible, but lights the floor. */
TEST(hidden_from_camera) {
    test_scene s = { 0 };
    sbl_picture_desc view;
    double worst = floor_under_lid(&s, &view, lid_up, SBL_MATERIAL_HIDDEN_FROM_CAMERA, 0);
    float *id = scene_channel(context, &view, SBL_CHANNEL_ID);
    CHECK(id[0] == 1 && id[35] == 1, "the camera sees mesh %g instead of the floor", (double)id[0]);
    CHECK(worst < 0.02, "the lamp does not light the floor: R is off by %.4f", worst);
    free(id);
    scene_free(&s);
}

/* A mesh that is hidden from sensors is visible, but neither lights nor shadows the floor. */
TEST(hidden_from_sensors) {
    test_scene s = { 0 };
    sbl_picture_desc view;
    float *id;
    double worst;
    floor_under_lid(&s, &view, lid_up, SBL_MATERIAL_HIDDEN_FROM_SENSORS, 1);
    id = scene_channel(context, &view, SBL_CHANNEL_ID);
    CHECK(id[0] == 2, "the camera does not see the lid");
    free(id);
    /* the floor, seen from below the lid */
    view = scene_plain(scene_view(6, 6, 20, 0, 0.5f, 3, 0, 0, 0), SBL_MODE_DIRECT, 32);
    worst = worst_radiance(&s, &view, 1, 1, 1, 0);
    CHECK(worst < 0.005, "the lid lights or shadows the floor: R is off by %.4f", worst);
    scene_free(&s);
}

/* SBL_CHANNEL_FINAL equals emission + albedo * R of the other channels. */
TEST(final_is_emission_plus_albedo_times_radiance) {
    test_scene s = { 0 };
    sbl_picture_desc view = scene_plain(scene_view(24, 18, 60, 0, 1, 4, 0, 0.5f, 0), SBL_MODE_DIRECT, 16);
    double worst = 0;
    int i, k, glowing = 0, empty = 0;
    scene_floor(&s, scene_material(&s, 0.2f, 0.5f, 0.9f), 0, 2);
    scene_quad(&s, scene_lamp(&s, 3, 2, 1), -0.5f, 1, -1, 0.5f, 1, -1, 0.5f, 2, -1, -0.5f, 2, -1);
    scene_sky(&s, 0.25f, 0.5f, 0.125f);
    if (scene_render(context, &s, &view)) {
        float *final = scene_channel(context, &view, SBL_CHANNEL_FINAL),
            *radiance = scene_channel(context, &view, SBL_CHANNEL_RADIANCE);
        float *albedo = scene_channel(context, &view, SBL_CHANNEL_ALBEDO),
            *id = scene_channel(context, &view, SBL_CHANNEL_ID);
        for (i = 0; i < 24 * 18; i++) {
            glowing += id[i] == 2;
            empty += id[i] == 0;
            for (k = 0; k < 3; k++) {
                double expected = id[i] == 0 ? (double)s.sky[k] : (id[i] == 2 ? 3.0 - k : 0) +
                    (double)albedo[3 * i + k] * (double)radiance[3 * i + k];
                worst = test_max(worst, fabs((double)final[3 * i + k] - expected));
                if (id[i] == 0)
                    CHECK(radiance[3 * i + k] == 0 && albedo[3 * i + k] == 0,
                          "channels are not 0 where nothing is seen");
            }
        }
        free(final); free(radiance); free(albedo); free(id);
    }
    CHECK(glowing > 10 && empty > 10, "%d pixels of lamp, %d of sky", glowing, empty);
    CHECK(worst < 0.004, "final is off by %.5f", worst);
    scene_free(&s);
}

/* >>transforms */

/* A matrix that rotates, scales and translates moves a lid from other coordinates to its place. */
TEST(transforms) {
    test_scene s = { 0 };
    sbl_picture_desc view = scene_plain(scene_view(6, 6, 20, 0, 4, 0.1f, 0, 0, 0), SBL_MODE_DIRECT, 128);
    /* x' = 1 - 2 z, y' = 1 + 0.5 x, z' = -1 + 4 y */
    static const float place[16] = { 0, 0.5f, 0, 0, 0, 0, 4, 0, -2, 0, 0, 0, 1, 1, -1, 1 };
    v3 corners[4];
    int step, i, lamp = scene_lamp(&s, 1, 1, 1);
    s.materials[lamp].flags = SBL_MATERIAL_HIDDEN_FROM_CAMERA;
    scene_floor(&s, scene_material(&s, 0.5f, 0.5f, 0.5f), 0, 100);
    memcpy(scene_quad(&s, lamp, 0, 0, 0, 0, 0, 1, 1, 0.5f, 1, 1, 0.5f, 0)->transform, place, sizeof place);
    for (step = 0; step < 2; step++) {  /* first as set with the scene, then moved up by half a unit */
        double squares = 0, worst = 0;
        double up = 1 + 0.5 * step;
        corners[0] = v3_of(1, up, -1); corners[1] = v3_of(-1, up, -1); corners[2] = v3_of(-1, up + 0.5, 1); corners[3] =
            v3_of(1, up + 0.5, 1);
        if (step == 0) scene_render(context, &s, &view);
        else {
            float moved[16];
            memcpy(moved, place, sizeof moved);
            moved[13] += 0.5f;
            CHECK(sbl_set_mesh_transform(context, 1, moved) == SBL_SUCCESS, "the mesh cannot be moved");
            CHECK(sbl_render_picture(context, &view) == SBL_SUCCESS, "the picture failed");
        }
        {
            float *radiance = scene_channel(context, &view, SBL_CHANNEL_RADIANCE),
                *position = scene_channel(context, &view, SBL_CHANNEL_POSITION);
            float low[3], high[3];
            for (i = 0; i < 36; i++) {
                double off = fabs((double)radiance[3 * i] /
                                  ref_polygon(v3_from(position + 3 * i), v3_of(0, 1, 0), corners, 4) - 1);
                squares += off * off;
                if (!(off <= worst)) worst = off;
            }
            CHECK(sqrt(squares / 36) < 0.01 && worst < 0.03, "step %d: R is off by %.3f %% rms, %.3f %% at worst", step,
                  100 * sqrt(squares / 36), 100 * worst);
            CHECK(scene_bounds(context, low, high) && fabs((double)high[1] - up - 0.5) < 1e-6 && low[1] == 0 &&
                      high[0] == 100,
                  "the bounds are not updated: %g", (double)high[1]);
            free(radiance);
            free(position);
        }
    }
    scene_free(&s);
}

/* >>functions of the interface */

/* Looking and projecting move points to where the eye sees them: the axes of the view, the edges of the picture, and
   the near plane at 0.1. */
TEST(matrices_place_points) {
    const double t = tan(0.5 * 50 * TEST_PI / 180);
    float view[16], clip[16], unchanged[16] = { 3 };
    int k;
    REQUIRE(sbl_look_at(view, 1, 2, 3, 1, 2, -4, 0, 5, 1) && sbl_perspective(clip, 50, 1.5f), "no matrices");
    for (k = 0; k < 3; k++) {  /* the eye looks along -z, so the axes of view and world are the same */
        CHECK(fabs((double)view[4 * k + k] - 1) < 1e-6 && fabs((double)view[12 + k] + k + 1) < 1e-6,
              "axis %d: %g, the eye is moved by %g", k, (double)view[4 * k + k], (double)view[12 + k]);
        CHECK(view[4 * k + 3] == 0 && clip[4 * k + 3] == (k == 2 ? -1 : 0), "the last row is wrong in column %d", k);
    }
    REQUIRE(sbl_look_at(view, 0, 0, 0, 2, 0, 0, 0, 0, 3), "no view along x");  /* right: -y; up: z; back: -x */
    CHECK(view[4] == -1 && view[9] == 1 && view[2] == -1, "along x: %g %g %g", (double)view[4], (double)view[9],
          (double)view[2]);
    CHECK(fabs((double)clip[0] * 1.5 * t - 1) < 1e-6 && fabs((double)clip[5] * t - 1) < 1e-6, "edges at %g, %g",
          1 / (double)clip[0], 1 / (double)clip[5]);
    CHECK(fabs(-0.1 * (double)clip[10] + (double)clip[14] + 0.1) < 1e-6, "the near plane is at depth %g",
          (-0.1 * (double)clip[10] + (double)clip[14]) / 0.1);
    CHECK(!sbl_look_at(unchanged, 1, 2, 3, 1, 2, 3, 0, 1, 0) && !sbl_look_at(unchanged, 0, 0, 0, 0, 4, 0, 0, 1, 0) &&
          !sbl_perspective(unchanged, 180, 1) && !sbl_perspective(unchanged, 50, 0) && unchanged[0] == 3,
          "a direction of length 0, one along up, or an impossible angle gives a matrix");
}

/* sbl_encode_srgb8 converts the linear value of each byte (IEC 61966-2-1) to this byte, and rounds to the nearest byte.
   It converts NaN and negative infinity to 0, and positive infinity to 255. */
TEST(bytes_are_srgb) {
    static const float odd[8] = { -1, 0, 1, 7, 0, 0, 0, 0.5f };
    static const unsigned char expected[8] = { 0, 0, 255, 255, 255, 0, 0, 188 };
    unsigned char bytes[8], byte;
    float values[8];
    int i;
    for (i = 0; i < 256; i++) {
        const double x = i / 255.0, half = (i + 0.5) / 255;
        const double y = x <= 0.04045 ? x / 12.92 : pow((x + 0.055) / 1.055, 2.4);
        const double z = half <= 0.04045 ? half / 12.92 : pow((half + 0.055) / 1.055, 2.4);
        const float exact = (float)(y / 3), below = (float)(z * (1 - 1e-4)), above = (float)(z * (1 + 1e-4));
        sbl_encode_srgb8(&byte, &exact, 1, 3);
        CHECK(byte == i, "%d comes back as %d", i, byte);
        sbl_encode_srgb8(&byte, &below, 1, 1);
        CHECK(byte == i, "below %d.5: %d", i, byte);
        sbl_encode_srgb8(&byte, &above, 1, 1);
        CHECK(byte == (i < 255 ? i + 1 : 255), "above %d.5: %d", i, byte);
    }
    memcpy(values, odd, sizeof values);
    values[4] = (float)HUGE_VAL;
    values[5] = -values[4];
    values[6] = values[4] - values[4];
    sbl_encode_srgb8(bytes, values, 8, 1);
    for (i = 0; i < 8; i++) CHECK(bytes[i] == expected[i], "%g becomes %d", (double)values[i], bytes[i]);
    for (i = 0; i < 8; i++) {  /* products with a factor that is negative, 0 or no number */
        static const unsigned char products[4][8] = { { 255, 0, 0, 0, 0, 255, 0, 0 }, { 0 },
                                                      { 0, 0, 255, 255, 255, 0, 0, 255 }, { 0 } };
        const float factors[4] = { -1, 0, values[4], values[6] };
        int k;
        for (k = 0; k < 4; k++) {
            sbl_encode_srgb8(&byte, &values[i], 1, factors[k]);
            CHECK(byte == products[k][i], "%g times %g becomes %d", (double)values[i], (double)factors[k], byte);
        }
    }
}

int main(void) {
    if (sbl_create(NULL, &context) != SBL_SUCCESS) { printf("no context\n0 passed, 1 failed, 0 skipped\n"); return 1; }
    RUN(open_plane_under_sky);
    RUN(furnace);
    RUN(furnace_default_settings);
    RUN(sphere_under_sky);
    RUN(single_view_under_sky);
    RUN(weights_of_hemicube);
    RUN(weights_of_single_view);
    RUN(sensors_are_turned_by_pixel_and_seed);
    RUN(lambert_formula_against_quadrature);
    RUN(lambert_polygons);
    RUN(wall);
    RUN(slope);
    RUN(scales);
    RUN(far_from_the_origin);
    RUN(thin_gaps);
    RUN(ambient_room);
    RUN(vertex_colours);
    RUN(samples_cover_pixels);
    RUN(environment_behind);
    RUN(near_things_in_large_scenes);
    RUN(half_floats);
    RUN(lid_and_sky);
    RUN(one_sided_emission);
    RUN(hidden_from_camera);
    RUN(hidden_from_sensors);
    RUN(final_is_emission_plus_albedo_times_radiance);
    RUN(transforms);
    RUN(matrices_place_points);
    RUN(bytes_are_srgb);
    sbl_destroy(context);
    return test_report();
}
