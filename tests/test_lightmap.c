/* Tests lightmaps: which surface each texel shows, compared with the geometry; the light of texels, compared with
   closed forms; and invalid or unusual texture coordinates. */
#include "../sbl.h"
#include "support/test.h"
#include "support/scenes.h"
#include "support/reference.h"
#include "support/gl_watch.h"
#include "support/lightmap.h"
#include "support/patches.h"
#include <limits.h>

/* >>texels */

enum { SIDE = 48 };

/* Returns the area of the unit square at (x, y) that a triangle covers, by clipping the triangle at the four sides of
   the square (Sutherland and Hodgman 1974). margin: the square becomes smaller by this much on each side */
static double covered(double p[3][2], double x, double y, double margin) {
    double from[16][2], to[16][2], area = 0;
    int count = 3, cut, i;
    memcpy(from, p, 6 * sizeof(double));
    for (cut = 0; cut < 4; cut++) {
        const int axis = cut & 1;
        const double side = (axis ? y : x) + (cut >= 2 ? 1 - margin : margin), way = cut >= 2 ? -1 : 1;
        int kept = 0;
        for (i = 0; i < count; i++) {
            const double *a = from[i], *b = from[(i + 1) % count], ha = way * (a[axis] - side),
                hb = way * (b[axis] - side);
            if (ha >= 0) { to[kept][0] = a[0]; to[kept++][1] = a[1]; }
            if ((ha >= 0) != (hb >= 0)) {
                to[kept][0] = a[0] + ha / (ha - hb) * (b[0] - a[0]);
                to[kept++][1] = a[1] + ha / (ha - hb) * (b[1] - a[1]);
            }
        }
        count = kept;
        memcpy(from, to, sizeof from);
    }
    for (i = 0; i < count; i++) area += from[i][0] * from[(i + 1) % count][1] - from[(i + 1) % count][0] * from[i][1];
    return 0.5 * fabs(area);
}

/* Returns the smallest distance from (x, y) to a triangle, estimated from many of its points. */
static double distance_to(double p[3][2], double x, double y) {
    double least = HUGE_VAL;
    int i, j;
    for (i = 0; i <= 200; i++)
        for (j = 0; j <= 200 - i; j++) {
            const double b = i / 200.0, c = j / 200.0, a = 1 - b - c;
            const double dx = a * p[0][0] + b * p[1][0] + c * p[2][0] - x,
                dy = a * p[0][1] + b * p[1][1] + c * p[2][1] - y;
            least = fmin(least, sqrt(dx * dx + dy * dy));
        }
    return least;
}

/* Each of twenty triangles is alone on a floor whose world coordinates equal its map coordinates. A texel shows the
   triangle if the triangle covers part of its square, except for a rim of 0.01 texels, and does not show it if the
   triangle covers no part of the whole square. It shows the point nearest to its centre, moved inward
   from an edge by at most 0.02 texels. */
TEST(texels_show_what_touches_them) {
    uint64_t seed = 5;
    int run, i, k;
    for (run = 0; run < 20; run++) {
        static test_scene s;
        const sbl_lightmap_desc desc = map_of(SIDE, SIDE, SBL_MODE_DIRECT);
        double p[3][2];
        float world[9], uv[6], *position, *id, *light;
        int x, y, shown = 0, wrong = 0;
        double worst = 0;
        memset(&s, 0, sizeof s);
        for (i = 0; i < 3; i++) {
            for (k = 0; k < 2; k++) {
                const double size = run % 4 == 0 ? 2 : run % 4 == 1 ? 8 : SIDE, low = run % 4 < 2 ? 20 : 0;
                uv[2 * i + k] = (float)((low + size * ref_random(&seed)) / SIDE);
                /* a thin triangle */
                if (run % 4 == 3 && i == 2) uv[4 + k] = 0.5f * (uv[k] + uv[2 + k]) + 1e-3f * (float)k;
                p[i][k] = (double)uv[2 * i + k] * SIDE;
            }
            world[3 * i] = (float)p[i][0];
            world[3 * i + 1] = 0;
            world[3 * i + 2] = (float)p[i][1];
        }
        uv_set(&s, scene_mesh(&s, scene_material(&s, 0.5f, 0.5f, 0.5f), world, NULL, NULL, 3, NULL, 0), uv);
        scene_sky(&s, 1, 1, 1);
        light = bake(&s, &desc);
        if (light) {
            position = channel_of(&desc, SBL_CHANNEL_POSITION);
            id = channel_of(&desc, SBL_CHANNEL_ID);
            for (y = 0; y < SIDE; y++)
                for (x = 0; x < SIDE; x++) {
                    const float *at = position + 3 * (y * SIDE + x);
                    const double part = covered(p, x, y, 0), core = covered(p, x, y, 0.0101);
                    const double dx = (double)at[0] - x - 0.5, dz = (double)at[2] - y - 0.5;
                    const int is_shown = id[y * SIDE + x] > 0;
                    shown += is_shown;
                    if ((is_shown && part == 0) || (!is_shown && core > 1e-9)) wrong++;
                    if (is_shown) worst = fmax(worst, sqrt(dx * dx + dz * dz) - distance_to(p, x + 0.5, y + 0.5));
                    if (is_shown && !(fabs((double)light[3 * (y * SIDE + x)] - 1) < 1e-3)) wrong++;
                }
            CHECK(shown > 0 && wrong == 0, "triangle %d: %d texels, %d wrong", run, shown, wrong);
            CHECK(worst < 0.021, "triangle %d: a point is %g texels farther from the centre than the nearest one", run,
                  worst);
            free(position);
            free(id);
        }
        free(light);
        scene_free(&s);
    }
}

/* Two charts end at the borders of texels, up to rounding, and the gap between them is two texels wide. One is lit by
   the sky, the other is in the dark. The gap shows no chart, and each half of it has the light of the chart beside it:
   nothing of it leaks into the other chart where samples mix texels. */
TEST(charts_share_a_narrow_gap) {
    static test_scene s;
    const sbl_lightmap_desc desc = map_of(32, 32, SBL_MODE_DIRECT);
    const float more = 1e-6f, roof[12] = { -9, 0.3f, -9, 9, 0.3f, -9, 9, 0.3f, 9, -9, 0.3f, 9 };
    float *light, *id, *final;
    int y, shown = 0, leaks = 0, k;
    memset(&s, 0, sizeof s);
    k = scene_material(&s, 0, 0, 0);
    uv_rectangle(&s, scene_floor(&s, k, 0.31f, 1), 4 / 32.0f - more, 4 / 32.0f - more, 12 / 32.0f + more,
                 28 / 32.0f + more);
    uv_rectangle(&s, scene_floor(&s, k, 0.29f, 0.5f), 14 / 32.0f - more, 4 / 32.0f - more, 22 / 32.0f + more,
                 28 / 32.0f + more);
    scene_polygon(&s, k, roof, 4);
    scene_box(&s, k, -9, -1, -9, 9, 0.299f, 9);
    scene_sky(&s, 1, 1, 1);
    light = bake(&s, &desc);
    id = channel_of(&desc, SBL_CHANNEL_ID);
    final = channel_of(&desc, SBL_CHANNEL_FINAL);
    REQUIRE(light && id && final, "no lightmap");
    for (y = 4; y < 28; y++) {
        const float *row = final + 3 * 32 * y;
        for (k = 4; k < 22; k++) shown += id[32 * y + k] > 0;
        leaks += !(row[3 * 12] > 0.99f) || !(row[3 * 13] < 1e-3f);
    }
    CHECK(shown == 24 * 16 && leaks == 0, "%d texels show charts; the gap is wrong in %d rows", shown, leaks);
    free(light);
    free(id);
    free(final);
    scene_free(&s);
}

/* Charts that are a point, a line, or a triangle inside one texel are shown by the texels that they touch. */
TEST(charts_without_area_are_shown) {
    static const float where[3][6] = { { 0.31f, 0.52f, 0.31f, 0.52f, 0.31f, 0.52f },
        { 0.1f, 0.2f, 0.5f, 0.2f, 0.9f, 0.2f },
                                       { 0.501f, 0.801f, 0.502f, 0.801f, 0.501f, 0.802f } };
    static test_scene s;
    static const float world[9] = { 0, 0, 0, 0, 0, 1, 1, 0, 0 };
    sbl_lightmap_desc desc = map_of(16, 16, SBL_MODE_DIRECT);
    float *light, *id;
    int i, shown = 0;
    memset(&s, 0, sizeof s);
    for (i = 0; i < 3; i++)
        uv_set(&s, scene_mesh(&s, scene_material(&s, 0.5f, 0.5f, 0.5f), world, NULL, NULL, 3, NULL, 0), where[i]);
    scene_sky(&s, 1, 1, 1);
    desc.gutter = -1;
    light = bake(&s, &desc);
    if (light) {
        float *final = channel_of(&desc, SBL_CHANNEL_FINAL);
        id = channel_of(&desc, SBL_CHANNEL_ID);
        for (i = 0; i < 256; i++) {
            shown += id[i] > 0;
            CHECK((light[3 * i] > 0) == (id[i] > 0) && (final[3 * i] > 0) == (id[i] > 0),
                  "texel %d: id %g, R %g, final %g", i, (double)id[i],
                  (double)light[3 * i], (double)final[3 * i]);
        }
        CHECK(id[8 * 16 + 4] > 0 && id[12 * 16 + 8] > 0 && id[3 * 16 + 8] > 0, "a chart is missing");
        CHECK(shown == 1 + 1 + 14, "%d texels are shown", shown);
        free(id);
        free(final);
    }
    free(light);
    scene_free(&s);
}

/* >>light */

/* A lamp is over a floor whose chart is slanted. R of every texel is compared with the closed form of the lamp. The
   other half of the map holds the same floor, mirrored. */
TEST(a_floor_under_a_lamp) {
    static const float lamp[12] = { -0.5f, 1, -0.5f, 0.5f, 1, -0.5f, 0.5f, 1, 0.5f, -0.5f, 1, 0.5f };
    static const float askew[8] = { 0.05f, 0.1f, 0.02f, 0.9f, 0.43f, 0.95f, 0.48f, 0.05f };
    static test_scene s;
    const sbl_lightmap_desc desc = map_of(192, 192, SBL_MODE_DIRECT);
    const v3 up = v3_of(0, 1, 0);
    float mirrored[8], *light;
    v3 corners[4];
    int i, k;
    memset(&s, 0, sizeof s);
    for (i = 0; i < 4; i++) {
        mirrored[2 * i] = 1 - askew[2 * i];
        mirrored[2 * i + 1] = askew[2 * i + 1];
        corners[i] = v3_from(lamp + 3 * i);
    }
    scene_polygon(&s, scene_lamp(&s, 2, 2, 2), lamp, 4);
    k = scene_material(&s, 0.5f, 0.5f, 0.5f);
    uv_set(&s, scene_floor(&s, k, 0, 1.5f), askew);
    uv_set(&s, scene_floor(&s, k, 0, 1.5f), mirrored);
    light = bake(&s, &desc);
    if (light) {
        float *position = channel_of(&desc, SBL_CHANNEL_POSITION), *id = channel_of(&desc, SBL_CHANNEL_ID);
        double squares = 0, worst = 0, mean = 0;
        int count = 0, charts[3] = { 0, 0, 0 };
        for (i = 0; i < 192 * 192; i++) {
            const double truth = 2 * ref_polygon(v3_from(position + 3 * i), up, corners, 4),
                off = (double)light[3 * i] - truth;
            if (!(id[i] > 0)) continue;
            charts[id[i] > 2 ? 0 : (int)id[i]]++;
            squares += off * off;
            mean += truth;
            worst = fmax(worst, fabs(off) / truth);
            count++;
        }
        mean /= count;
        printf("  %d texels: %.3f %% rms, %.2f %% at worst; %lld sensors\n", count, 100 * sqrt(squares / count) / mean,
               100 * worst, (long long)sbl_query_stats(context).sensors.sites);
        CHECK(sqrt(squares / count) < 0.005 * mean, "rms %.3f %%", 100 * sqrt(squares / count) / mean);
        CHECK(charts[0] == 0 && charts[1] > 10000 && charts[1] == charts[2],
              "charts of %d and %d texels, %d texels of other charts",
              charts[1], charts[2], charts[0]);
        CHECK(sbl_query_stats(context).picture.visible_pixels == count, "the statistics report %d texels",
              sbl_query_stats(context).picture.visible_pixels);
        free(position);
        free(id);
    }
    free(light);
    scene_free(&s);
}

/* In a closed box that emits and reflects, R is emission / (1 - albedo) in all charts, which are one texel apart, and
   in all texels of the gutter. */
TEST(a_furnace) {
    static test_scene s;
    sbl_lightmap_desc desc = map_of(128, 96, SBL_MODE_GI);
    float *light;
    int i, k, x, y;
    memset(&s, 0, sizeof s);
    i = scene_material(&s, 0.5f, 0.5f, 0.5f);
    for (k = 0; k < 3; k++) s.materials[i].emission[k] = 1;
    scene_box(&s, i, 0, 0, 0, 2, 1, 3);
    for (i = 0; i < 6; i++) {
        const float x0 = (float)(i % 3) / 4 + 0.1f, y0 = (float)(i / 3) / 4 + 0.1f;
        float turned[12];
        uv_rectangle(&s, &s.meshes[i], x0, y0, x0 + 0.24f, y0 + 0.235f);
        for (k = 0; k < 12; k++) turned[k] = ((const float *)s.meshes[i].positions.data)[3 * (3 - k / 3) + k % 3];
        s.meshes[i].positions.data = scene_copy(&s, turned, 12);  /* the walls face inwards */
    }
    desc.gutter = 5;
    desc.target_error = 0.001f;  /* with the default target, the noise of single texels would exceed the limit */
    light = bake_stored(&s, &desc, 0);
    if (light) {
        float *final = channel_of(&desc, SBL_CHANNEL_FINAL), *id = channel_of(&desc, SBL_CHANNEL_ID);
        double worst = 0, squares = 0;
        int shown = 0, wrong = 0;
        for (y = 0; y < 96; y++)
            for (x = 0; x < 128; x++) {
                const int texel = y * 128 + x;
                int near_one = 0, u, v;
                for (v = -5; v <= 5; v++)
                    for (u = -5; u <= 5; u++)
                        near_one |= x + u >= 0 && x + u < 128 && y + v >= 0 && y + v < 96 && id[texel + v * 128 + u] >
                            0;
                shown += id[texel] > 0;
                if (id[texel] > 0) squares += pow((double)light[3 * texel + 1] / 2 - 1, 2);
                else wrong += light[3 * texel] != 0;
                if (near_one) worst = fmax(worst, fabs((double)final[3 * texel + 2] / 2 - 1));
                else wrong += final[3 * texel] != 0;
            }
        CHECK(shown > 5 * 30 * 20 && wrong == 0, "%d texels are shown, %d wrong", shown, wrong);
        printf("  %.2f %% rms, including the gutter %.2f %% at worst\n", 100 * sqrt(squares / shown), 100 * worst);
        CHECK(sqrt(squares / shown) < 0.003 && worst < 0.025, "off by %.3f %% rms, %.2f %% at worst",
              100 * sqrt(squares / shown), 100 * worst);
        free(final);
        free(id);
    }
    free(light);
    scene_free(&s);
}

/* A host that reads the lightmap during the bake sees direct light before bounced light is stored, and finally gets the
   same lightmap, with supersampling and harmonics. */
TEST(reading_early_changes_nothing) {
    static const sbl_channel channels[] = { SBL_CHANNEL_FINAL, SBL_CHANNEL_SH_1, SBL_CHANNEL_SENSORS };
    static test_scene s;
    sbl_lightmap_desc desc = map_of(32, 32, SBL_MODE_GI);
    sbl_scene_desc scene;
    float *whole[3], *now = NULL, *light = (float *)malloc(3 * 32 * 32 * sizeof *light);
    sbl_result result = SBL_UNFINISHED;
    int k, i, early = 0, lit = 0;
    memset(&s, 0, sizeof s);
    scene_floor(&s, scene_material(&s, 0.6f, 0.5f, 0.4f), 0, 2);
    uv_rectangle(&s, &s.meshes[0], 0.05f, 0.05f, 0.95f, 0.95f);
    scene_box(&s, scene_material(&s, 0.5f, 0.6f, 0.7f), 0.3f, 0.2f, 0.3f, 0.8f, 0.7f, 0.8f);
    scene_box(&s, scene_lamp(&s, 5, 5, 5), -0.5f, 1.5f, -0.5f, -0.3f, 1.7f, -0.3f);
    desc.supersample = 2;
    desc.directional = 1;
    now = bake(&s, &desc);
    free(now);
    for (k = 0; k < 3; k++) whole[k] = channel_of(&desc, channels[k]);
    scene = scene_desc(&s);
    scene.max_bounce_cells = 1024;
    CHECK(sbl_set_scene(context, &scene) == SBL_SUCCESS && sbl_begin_lightmap(context, &desc) == SBL_SUCCESS, "%s",
          watch_last(&seen));
    while (result == SBL_UNFINISHED && light) {
        const sbl_result is = sbl_read_channel(context, SBL_CHANNEL_FINAL, light, 3 * 32 * 32);
        early += is == SBL_SUCCESS && sbl_progress(context) < 0.1f;
        for (i = 0; is == SBL_SUCCESS && early == 1 && i < 3 * 32 * 32; i++) lit += light[i] > 0;
        result = sbl_step(context, 1e-9);
    }
    CHECK(result == SBL_SUCCESS && early > 0 && lit > 1000, "%s: read early %d times, %d numbers are above 0",
          watch_last(&seen), early, lit);
    for (k = 0; k < 3; k++) {
        const size_t floats = (size_t)(32 * 32 * sbl_channel_components(channels[k]));
        now = channel_of(&desc, channels[k]);
        CHECK(now && whole[k] && memcmp(now, whole[k], floats * sizeof *now) == 0, "channel %d differs",
              (int)channels[k]);
        free(now);
        free(whole[k]);
    }
    free(light);
    scene_free(&s);
}

/* A bright and a dark floor are adjacent in the map, without a texel between them. Neither gets light of the other. */
TEST(charts_keep_their_light) {
    static test_scene s;
    sbl_lightmap_desc desc = map_of(64, 64, SBL_MODE_DIRECT);
    static const float roof[12] = { -9, 0.3f, -9, 9, 0.3f, -9, 9, 0.3f, 9, -9, 0.3f, 9 };
    float *light;
    int i, k;
    memset(&s, 0, sizeof s);
    k = scene_material(&s, 0.5f, 0.5f, 0.5f);
    uv_rectangle(&s, scene_floor(&s, k, 0.31f, 1), 0.1f, 0.1f, 0.5f, 0.9f);
    uv_rectangle(&s, scene_floor(&s, k, 0.29f, 0.5f), 0.5f, 0.1f, 0.9f, 0.9f);
    scene_polygon(&s, k, roof, 4);
    scene_box(&s, k, -9, -1, -9, 9, 0.299f, 9);
    scene_sky(&s, 1, 1, 1);
    light = bake(&s, &desc);
    if (light) {
        float *id = channel_of(&desc, SBL_CHANNEL_ID);
        int bright = 0, dark = 0, wrong = 0;
        for (i = 0; i < 64 * 64; i++) {
            if (id[i] == 1.0f) { bright++; wrong += !(fabs((double)light[3 * i] - 1) < 0.002); }
            if (id[i] == 2.0f) { dark++; wrong += !(light[3 * i] < 1e-3f); }
        }
        CHECK(bright > 1000 && dark > 1000 && wrong == 0, "%d bright texels, %d dark ones, %d wrong", bright, dark,
              wrong);
        free(id);
    }
    free(light);
    scene_free(&s);
}

/* >>hidden texels */

/* A plate that emits on both sides lies on a floor, 0.03 texels above it. Its light on the covered texels, which is 20,
   must not appear around it. The plate does light the floor beside its edge: by 0.5 on average over half a texel. */
TEST(what_lies_on_a_floor_does_not_shine_out) {
    static test_scene s;
    sbl_lightmap_desc desc = map_of(64, 64, SBL_MODE_DIRECT);
    float *light, *final;
    int x, y, k, bright = 0, dark = 0, under = 0;
    memset(&s, 0, sizeof s);
    uv_rectangle(&s, scene_floor(&s, scene_material(&s, 0, 0, 0), 0, 1), 0.03f, 0.03f, 0.97f, 0.97f);
    k = scene_lamp(&s, 20, 20, 20);
    /* the edges of the plate are a twentieth of a texel inwards from the centres of texels */
    scene_quad(&s, k, -0.3141f, 1e-3f, -0.2144f, -0.3141f, 1e-3f, 0.4139f, 0.2809f, 1e-3f, 0.4139f, 0.2809f, 1e-3f,
               -0.2144f);
    scene_sky(&s, 0.1f, 0.1f, 0.1f);
    desc.options.rays = 1024;  /* fewer rays could miss the edge of the plate */
    light = bake(&s, &desc);
    final = channel_of(&desc, SBL_CHANNEL_FINAL);
    REQUIRE(light && final, "no lightmap");
    for (y = 2; y < 62; y++)
        for (x = 2; x < 62; x++) {
            const float R = final[3 * (y * 64 + x)];
            const double u = ((x + 0.5) / 64 - 0.5) / 0.47, v = ((y + 0.5) / 64 - 0.5) / 0.47;
            under += fabs(u) < 0.2 && fabs(v) < 0.2;
            bright += R > 0.8f;
            dark += R < 0.05f;
        }
    CHECK(bright == 0 && dark == 0 && under > 100, "%d texels are too bright, %d too dark; %d are covered", bright,
          dark, under);
    CHECK(sbl_query_stats(context).sensors.invalid > 100, "%d sensors are invalid",
          (int)sbl_query_stats(context).sensors.invalid);
    free(light);
    free(final);
    scene_free(&s);
}

/* A panel stands in a dark room and pierces the floor, which faces up; a panel beside it does not. Below the floor, the
   panel sees the sky and the floor's back: R is 0.5 there. The row of texels that the floor cuts, with centres below
   it, shows the dark light of the room, because samples mix it with the row above. Far below the floor, R stays as it
   is. */
TEST(what_is_under_a_floor_does_not_shine_up) {
    enum { ROWS = 32, COLUMNS = 8, ABOVE = 25, WIDTH = 32 };
    static test_scene s;
    const sbl_lightmap_desc desc = map_of(WIDTH, ROWS, SBL_MODE_DIRECT);
    const float texel = 0.02f, low = -(ROWS - ABOVE - 0.3f) * texel, high = (ABOVE + 0.3f) * texel;
    float *light;
    float room = 0, beside = 0, deep = 1;
    int x, y, material;
    memset(&s, 0, sizeof s);
    material = scene_material(&s, 0, 0, 0);
    uv_rectangle(&s, scene_quad(&s, material, -0.08f, low, 0, 0.08f, low, 0, 0.08f, high, 0, -0.08f, high, 0), 0, 1,
                 (float)COLUMNS / WIDTH, 0);
    uv_rectangle(&s, scene_quad(&s, material, 0.2f, 0.1f, 0, 0.64f, 0.1f, 0, 0.64f, 0.74f, 0, 0.2f, 0.74f, 0),
                 (COLUMNS + 2.0f) / WIDTH, 1, 1, 0);
    scene_floor(&s, material, 0, 2);
    scene_box(&s, material, -2, 0, -2.2f, 2, 2, -2);
    scene_box(&s, material, -2, 0, 2, 2, 2, 2.2f);
    scene_box(&s, material, -2.2f, 0, -2.2f, -2, 2, 2.2f);
    scene_box(&s, material, 2, 0, -2.2f, 2.2f, 2, 2.2f);
    scene_box(&s, material, -2.2f, 2, -2.2f, 2.2f, 2.2f, 2.2f);
    scene_quad(&s, scene_lamp(&s, 0.1f, 0.1f, 0.1f), -0.5f, 1.9f, 0.2f, 0.5f, 1.9f, 0.2f, 0.5f, 1.9f, 1.2f, -0.5f, 1.9f,
               1.2f);
    scene_sky(&s, 1, 1, 1);
    light = bake(&s, &desc);
    REQUIRE(light, "no lightmap");
    for (x = 0; x < COLUMNS; x++)
        for (y = 0; y < ROWS; y++) {
            const float R = light[3 * (y * WIDTH + x)];
            if (y < ABOVE) room = R > room ? R : room;
            else if (y == ABOVE) beside = R > beside ? R : beside;
            else if (y >= ABOVE + 4) deep = R < deep ? R : deep;
        }
    CHECK(room > 0 && room < 0.05f, "in the room R is up to %g", room);
    CHECK(beside <= room && deep > 0.45f, "just below the floor R is up to %g; far below it, at least %g", beside,
          deep);
    free(light);
    scene_free(&s);
}

/* A black box is on a floor under a constant sky. The texels below it are hidden and get the light of its rim, so that
   no dark rim appears where samples mix texels. A dim lamp in the box imitates light that leaks through joints: R is
   about 0.0001 there. Near a wall, R is at least half of that of the sky. */
TEST(boxes_leave_no_dark_rims) {
    static test_scene s;
    const sbl_lightmap_desc desc = map_of(64, 64, SBL_MODE_GI);
    float *light;
    int x, y, wrong = 0, beneath = 0;
    memset(&s, 0, sizeof s);
    uv_rectangle(&s, scene_floor(&s, scene_material(&s, 0, 0, 0), 0, 1), 0.03f, 0.03f, 0.97f, 0.97f);
    scene_box(&s, 0, -0.4f, 0, -0.3f, 0.35f, 0.8f, 0.45f);
    scene_quad(&s, scene_lamp(&s, 0.001f, 0.001f, 0.001f), -0.2f, 0.7f, -0.1f, 0.1f, 0.7f, -0.1f, 0.1f, 0.7f, 0.2f,
               -0.2f, 0.7f, 0.2f);
    scene_sky(&s, 1, 1, 1);
    light = bake(&s, &desc);
    REQUIRE(light, "no lightmap");
    for (y = 2; y < 62; y++)
        for (x = 2; x < 62; x++) {
            const float R = light[3 * (y * 64 + x)];
            beneath += x > 26 && x < 38 && y > 26 && y < 38 && R > 0.4f && R < 0.7f;
            wrong += R < 0.45f;
        }
    CHECK(wrong == 0 && beneath == 11 * 11, "%d texels are dark; %d texels beneath the box have the light of its rim",
          wrong, beneath);
    free(light);
    scene_free(&s);
}

/* Two white walls face each other across a gap of 2 mm under a sky of radiance 1. Rows of texels 15 mm wide run along
   them; the centres of texels below the first row see no sky. R at depth x is (1 - x / sqrt(x^2 + g^2)) / 2, which is
   also the share of directions in which light leaves. Over the first row, weighted by this share, the mean of R is 0.23
   and the median 0.22; at the centre of the row, R is 0.0044. The search skips texels where few rays leave, so that the
   other texels are slightly brighter. */
TEST(gaps_show_their_openings) {
    enum { ROWS = 4, COLUMNS = 32 };
    static test_scene s;
    sbl_lightmap_desc desc = map_of(COLUMNS + 4, ROWS + 4, SBL_MODE_DIRECT);
    const float texel = 0.015f, gap = -0.002f, deep = -ROWS * texel, wide = COLUMNS * texel / 2;
    float *light;
    double sum = 0, least = 1, below = 1;
    int x, material, inspected = 0, open = 0;
    memset(&s, 0, sizeof s);
    material = scene_material(&s, 0, 0, 0);
    uv_rectangle(&s, scene_quad(&s, material, -wide, 0, 0, wide, 0, 0, wide, deep, 0, -wide, deep, 0),
                 2.0f / (COLUMNS + 4), 2.0f / (ROWS + 4), (COLUMNS + 2.0f) / (COLUMNS + 4),
                 (ROWS + 2.0f) / (ROWS + 4));
    scene_quad(&s, material, -4, 0, gap, -4, deep, gap, 4, deep, gap, 4, 0, gap);
    scene_quad(&s, material, -4, 0, 0, 4, 0, 0, 4, deep, 0, -4, deep, 0);  /* the same wall continues to the sides */
    scene_quad(&s, material, -4, deep, 0, 4, deep, 0, 4, deep, gap, -4, deep, gap);
    scene_sky(&s, 1, 1, 1);
    light = bake(&s, &desc);
    REQUIRE(light, "no lightmap");
    for (x = 2; x < COLUMNS + 2; x++) {
        const double R = (double)light[3 * (2 * (COLUMNS + 4) + x)];
        sum += R / COLUMNS;
        least = test_min(least, R);
        below = test_min(below, (double)light[3 * (4 * (COLUMNS + 4) + x)]);
    }
    printf("  R is %.4f on average, %.4f at least; %.4f at least two rows below\n", sum, least, below);
    CHECK(fabs(sum - 0.23) < 0.03 && least > 0.15 && below > 0.15, "R is %g on average, %g at least, below it %g", sum,
          least, below);
    for (x = 2; x < COLUMNS + 2; x++) {
        sbl_sensor sensor;
        if (sbl_inspect_sensor(context, x, 2, &sensor, NULL, NULL, 0) != SBL_SUCCESS || !sensor.sensed) continue;
        inspected++;
        open += (double)sensor.site.position[1] > -0.45 * (double)texel && sensor.hit_mean > 0;
    }
    CHECK(inspected > 0 && open > 0.6 * inspected, "%d of %d inspected sensors look from the opening", open, inspected);
    free(light);
    scene_free(&s);
}

/* >>narrow charts */

/* A floor of 28 x 2 texels lies along a lamp that stands on its edge: a wall as high as a texel is wide. R at distance
   d is (1 - d / sqrt(d^2 + 1)) / 2, three times as much in the first row as in the second. Both rows are measured,
   wherever the chart lies on the grid of tiles. */
TEST(narrow_charts_are_measured_across) {
    enum { LONG = 28, SIZE = 48 };
    int run, i;
    for (run = 0; run < 4; run++) {
        static test_scene s;
        sbl_lightmap_desc desc = map_of(SIZE, SIZE, SBL_MODE_DIRECT);
        const int first = run < 2 ? 16 : 25, down = run & 1;  /* row or column; at 16, a tile begins */
        const float low = (float)first / SIZE, high = (float)(first + 2) / SIZE, end = (8.0f + LONG) / SIZE;
        float uv[8], *light;
        double off = 0;
        sbl_mesh *strip;
        memset(&s, 0, sizeof s);
        strip = scene_quad(&s, scene_material(&s, 0, 0, 0), 0, 0, 0, 0, 0, 2, LONG, 0, 2, LONG, 0, 0);
        for (i = 0; i < 4; i++) {
            const float across = i == 1 || i == 2 ? high : low, along = i < 2 ? 8.0f / SIZE : end;
            uv[2 * i] = down ? across : along;
            uv[2 * i + 1] = down ? along : across;
        }
        uv_set(&s, strip, uv);
        scene_quad(&s, scene_lamp(&s, 1, 1, 1), -999, 0, 0, 999, 0, 0, 999, 1, 0, -999, 1, 0);
        desc.target_error = 0.05f;
        light = bake(&s, &desc);
        REQUIRE(light, "no lightmap");
        for (i = 0; i < 2 * LONG; i++) {
            const int across = first + i % 2, along = 8 + i / 2;
            const double d = 0.5 + i % 2, R = 0.5 * (1 - d / sqrt(d * d + 1));
            const double found = (double)light[3 * (down ? along * SIZE + across : across * SIZE + along)];
            off = fmax(off, fabs(found / R - 1));
        }
        printf("  run %d: off by %.1f %%; %d sensors\n", run, 100 * off, (int)sbl_query_stats(context).sensors.sites);
        CHECK(off < 0.25, "run %d: R is off by %g", run, off);
        free(light);
        scene_free(&s);
    }
}

/* Closed compartments before a wall leave a strip of it open. All sensors that stand 16 texels apart are in the dark
   compartments, but the strip is lit, and no edge of the chart shows it. */
TEST(strips_between_first_sensors_are_lit) {
    enum { SIZE = 48, LOW = 20, HIGH = 27, TOP = 40, F = 9999 };  /* rows of the strip; above TOP is no board */
    static test_scene s;
    sbl_lightmap_desc desc = map_of(SIZE, SIZE, SBL_MODE_DIRECT);
    const float at = 4;  /* distance between the fronts of the compartments and the wall */
    float *light, least = 1;
    sbl_mesh *wall;
    int black, y;
    memset(&s, 0, sizeof s);
    black = scene_material(&s, 0, 0, 0);
    wall = scene_quad(&s, black, 0, 0, 0, SIZE, 0, 0, SIZE, SIZE, 0, 0, SIZE, 0);
    uv_rectangle(&s, wall, 0, 0, 1, 1);
    scene_quad(&s, black, -F, -F, at, F, -F, at, F, LOW - 1, at, -F, LOW - 1, at);
    scene_quad(&s, black, -F, HIGH + 2, at, F, HIGH + 2, at, F, TOP, at, -F, TOP, at);
    for (y = 0; y < 3; y++) {
        const float ledge = y == 0 ? LOW - 1 : y == 1 ? HIGH + 2 : TOP;
        scene_quad(&s, black, -F, ledge, 0, F, ledge, 0, F, ledge, at, -F, ledge, at);
    }
    scene_sky(&s, 1, 1, 1);
    desc.target_error = 0.02f;
    light = bake(&s, &desc);
    REQUIRE(light, "no lightmap");
    for (y = LOW; y <= HIGH; y++) least = fminf(least, light[3 * (y * SIZE + SIZE / 2)]);
    printf("  the darkest texel of the strip has %.3f\n", (double)least);
    CHECK(least > 0.3f, "the darkest texel of the strip has %g", (double)least);
    free(light);
    scene_free(&s);
}

/* >>seams */

/* Returns a bilinear sample of the red channel. */
static double sample_of(const float *map, int width, int height, const double place[2]) {
    const double x = place[0] * width - 0.5, y = place[1] * height - 0.5, fx = x - floor(x), fy = y - floor(y);
    const float *p = map + 3 * ((int)floor(y) * width + (int)floor(x));
    return (1 - fy) * ((1 - fx) * (double)p[0] + fx * (double)p[3]) + fy *
        ((1 - fx) * (double)p[3 * width] + fx * (double)p[3 * width + 3]);
}

/* Returns the largest difference of light across all edges between patches. */
static double largest_jump(const float *map, int width, int height) {
    double worst = 0;
    int i, j, step;
    for (i = 0; i < BALL_X; i++)
        for (j = 0; j <= BALL_Y; j++)
            for (step = 0; step < 8; step++) {
                double a[2][2], b[2][2], p[2], q[2];
                int k, x = i / PATCH, y = j / PATCH, before = (x + PATCHES_X - 1) % PATCHES_X;
                if (i % PATCH == 0 && j < BALL_Y) {  /* an edge along a meridian, from j to j + 1 */
                    ball_place(x, y, i, j, a[0]);
                    ball_place(x, y, i, j + 1, a[1]);
                    ball_place(before, y, before * PATCH + PATCH, j, b[0]);
                    ball_place(before, y, before * PATCH + PATCH, j + 1, b[1]);
                    for (k = 0; k < 2; k++) {
                        p[k] = a[0][k] + (a[1][k] - a[0][k]) * step / 8;
                        q[k] = b[0][k] + (b[1][k] - b[0][k]) * step / 8;
                    }
                    worst = test_max(worst, fabs(sample_of(map, width, height, p) - sample_of(map, width, height, q)));
                }
                if (j % PATCH == 0 && j > 0 && j < BALL_Y) {  /* an edge along a parallel, from i to i + 1 */
                    ball_place(x, y, i, j, a[0]);
                    ball_place(x, y, i + 1, j, a[1]);
                    ball_place(x, y - 1, i, j, b[0]);
                    ball_place(x, y - 1, i + 1, j, b[1]);
                    for (k = 0; k < 2; k++) {
                        p[k] = a[0][k] + (a[1][k] - a[0][k]) * step / 8;
                        q[k] = b[0][k] + (b[1][k] - b[0][k]) * step / 8;
                    }
                    worst = test_max(worst, fabs(sample_of(map, width, height, p) - sample_of(map, width, height, q)));
                }
            }
    return worst;
}

/* On a ball of 32 charts, correcting the seams reduces the largest jump to less than 1 %, and changes texels by less
   than 2 % RMS. */
TEST(seams_of_a_ball) {
    static test_scene s;
    sbl_lightmap_desc desc = map_of(256, 128, SBL_MODE_DIRECT);
    float *light, *left, *sewn, *again, *id, *sh[2];
    double mean = 0, moved = 0, before, after, before_sh, after_sh;
    int i, texels = 0, count;
    sbl_stats stats;
    memset(&s, 0, sizeof s);
    ball_of_patches(&s, scene_material(&s, 0.5f, 0.5f, 0.5f));
    scene_quad(&s, scene_lamp(&s, 9, 7, 5), -1, 3, -1, 1, 3, -1, 1, 3, 1, -1, 3, 1);
    scene_sky(&s, 0.3f, 0.4f, 0.5f);
    desc.options.rays = 64;
    desc.directional = 1;
    desc.seams = -1;
    light = bake(&s, &desc);
    sh[0] = channel_of(&desc, SBL_CHANNEL_SH_2);
    left = channel_of(&desc, SBL_CHANNEL_FINAL);
    id = channel_of(&desc, SBL_CHANNEL_ID);
    CHECK(sbl_query_stats(context).lightmap.seams == 0, "seams are counted although seams are disabled");
    desc.seams = 0;
    again = bake(&s, &desc);
    sewn = channel_of(&desc, SBL_CHANNEL_FINAL);
    sh[1] = channel_of(&desc, SBL_CHANNEL_SH_2);
    stats = sbl_query_stats(context);
    REQUIRE(light && left && id && again && sewn && sh[0] && sh[1], "no lightmap");
    CHECK(memcmp(light, again, 256 * 128 * 3 * sizeof *light) == 0, "R differs");
    for (i = 0; i < 256 * 128; i++) {
        if (!(id[i] > 0)) continue;
        texels++;
        mean += (double)light[3 * i];
        moved += pow((double)sewn[3 * i] - (double)light[3 * i], 2);
    }
    mean /= texels;
    moved = sqrt(moved / texels) / mean;
    before = largest_jump(left, 256, 128) / mean;
    after = largest_jump(sewn, 256, 128) / mean;
    printf("  largest jump %.2f %% before, %.2f %% after (statistics: %.2f, %.2f); texels changed by %.2f %% rms\n",
           100 * before, 100 * after, 100 * (double)stats.lightmap.seam_before, 100 * (double)stats.lightmap.seam_after,
           100 * moved);
    CHECK(before > 0.03 && after < 0.01 && moved < 0.02, "largest jump %g before, %g after; texels changed by %g",
          before, after, moved);
    CHECK((double)stats.lightmap.seam_before > 0.5 * before && (double)stats.lightmap.seam_before < 2 * before &&
              stats.lightmap.seam_after < 0.01f,
          "told %g, %g", (double)stats.lightmap.seam_before, (double)stats.lightmap.seam_after);
    before_sh = largest_jump(sh[0], 256, 128) / mean;
    after_sh = largest_jump(sh[1], 256, 128) / mean;
    printf("  largest jump of a harmonic: %.2f %% before, %.2f %% after\n", 100 * before_sh, 100 * after_sh);
    CHECK(before_sh > 0.03 && after_sh < 0.02, "largest jump of a harmonic: %g before, %g after", before_sh, after_sh);
    count = BALL_X * (PATCHES_Y - 1) + BALL_Y * PATCHES_X;
    CHECK(stats.lightmap.seams == count, "%d seams, expected %d", stats.lightmap.seams, count);
    free(light);
    free(left);
    free(id);
    free(again);
    free(sewn);
    free(sh[0]);
    free(sh[1]);
    scene_free(&s);
}

/* A floor is cut along a wall, with one side lit and the other dark. The seam does not carry light to the dark side. */
TEST(seams_do_not_leak) {
    static test_scene s;
    const sbl_lightmap_desc desc = map_of(64, 32, SBL_MODE_DIRECT);
    float *light, *final;
    double dark = 0, bright = 0;
    int x, y, material;
    memset(&s, 0, sizeof s);
    material = scene_material(&s, 0.5f, 0.5f, 0.5f);
    uv_rectangle(&s, scene_quad(&s, material, -1, 0, -1, -1, 0, 1, 0, 0, 1, 0, 0, -1), 0.05f, 0.1f, 0.45f, 0.9f);
    uv_rectangle(&s, scene_quad(&s, material, 0, 0, -1, 0, 0, 1, 1, 0, 1, 1, 0, -1), 0.55f, 0.1f, 0.95f, 0.9f);
    scene_quad(&s, material, 0, 0, -5, 0, 0, 5, 0, 9, 5, 0, 9, -5);
    scene_quad(&s, scene_lamp(&s, 5, 5, 5), 0.2f, 2, -0.5f, 0.8f, 2, -0.5f, 0.8f, 2, 0.5f, 0.2f, 2, 0.5f);
    light = bake(&s, &desc);
    final = channel_of(&desc, SBL_CHANNEL_FINAL);
    REQUIRE(light && final, "no lightmap");
    for (y = 0; y < 32; y++)
        for (x = 0; x < 64; x++) {
            double *most = x < 30 ? &dark : &bright;
            *most = test_max(*most, test_max((double)final[3 * (y * 64 + x)], (double)light[3 * (y * 64 + x)]));
        }
    CHECK(bright > 0.1 && dark < 1e-3 * bright, "%g on the dark side, %g on the lit side", dark, bright);
    CHECK(sbl_query_stats(context).lightmap.seams == 1, "%d seams", sbl_query_stats(context).lightmap.seams);
    free(light);
    free(final);
    scene_free(&s);
}

/* Makes two squares of one mesh that share an edge in the world but not in the map, so that they are two charts. flat:
   1: they are coplanar, and their seam may be corrected; 0: they are at a right angle, and it must not be */
static void two_squares(test_scene *s, int flat) {
    const float far_side[2][3] = { { 1, flat ? 0 : 1.0f, -1 }, { 1, flat ? 0 : 1.0f, 1 } };
    const float a[3] = { -1, 0, -1 }, b[3] = { -1, 0, 1 }, c[3] = { flat ? 0 : 1.0f, 0, 1 },
        d[3] = { flat ? 0 : 1.0f, 0, -1 };
    const float *corners[12] = { a, b, c, a, c, d, d, c, far_side[1], d, far_side[1], far_side[0] };
    const float place[12][2] = { { 0, 0 }, { 0, 1 }, { 1, 1 }, { 0, 0 }, { 1, 1 }, { 1, 0 }, { 0, 0 }, { 0, 1 },
        { 1, 1 }, { 0, 0 }, { 1, 1 }, { 1, 0 } };
    float positions[36], uv[24];
    int i, k;
    for (i = 0; i < 12; i++) {
        for (k = 0; k < 3; k++) positions[3 * i + k] = corners[i][k];
        uv[2 * i] = (i < 6 ? 0.05f : 0.55f) + 0.4f * place[i][0];
        uv[2 * i + 1] = 0.1f + 0.8f * place[i][1];
    }
    uv_set(s, scene_mesh(s, scene_material(s, 0.5f, 0.5f, 0.5f), positions, NULL, NULL, 12, NULL, 0), uv);
}

/* Charts are separate if the map separates them, and only coplanar neighbours get a seam. */
TEST(charts_are_parted_by_the_map) {
    static test_scene s;
    sbl_lightmap_desc desc = map_of(64, 32, SBL_MODE_DIRECT);
    int flat, i;
    desc.options.rays = 16;
    for (flat = 0; flat < 2; flat++) {
        float *light, *id;
        int left = 0, right = 0, wrong = 0;
        memset(&s, 0, sizeof s);
        two_squares(&s, flat);
        scene_sky(&s, 1, 1, 1);
        light = bake(&s, &desc);
        id = channel_of(&desc, SBL_CHANNEL_ID);
        for (i = 0; id && i < 64 * 32; i++) {
            left += id[i] == 1.0f && i % 64 < 32;
            right += id[i] == 2.0f && i % 64 >= 32;
            wrong += id[i] > 0 && (id[i] > 1.5f) != (i % 64 >= 32);
        }
        CHECK(left > 500 && right > 500 && wrong == 0, "flat %d: %d and %d texels, %d wrong", flat, left, right, wrong);
        CHECK(sbl_query_stats(context).lightmap.seams == flat, "flat %d: %d seams", flat,
              sbl_query_stats(context).lightmap.seams);
        free(light);
        free(id);
        scene_free(&s);
    }
}

/* Makes a ridge of two sides, which are 24 long and `height` wide, and whose normals differ by an angle in degrees. The
   vertex normals point up at the edge where they meet. A texel of a map of 64 x 32 is as wide as one unit. */
static void ridge_of(test_scene *s, double angle, float height) {
    static const uint32_t indices[12] = { 0, 1, 2, 0, 2, 3, 4, 5, 6, 4, 6, 7 };
    const float out = height * (float)cos(angle * REF_PI / 360), down = height * (float)sin(angle * REF_PI / 360);
    float positions[24], normals[24], uv[16];
    int i;
    memset(s, 0, sizeof *s);
    for (i = 0; i < 8; i++) {  /* corners of a side: the edge from end to end, then the lower edge back */
        const int right = i / 4, low = i % 4 / 2, end = (i % 4 == 1 || i % 4 == 2) != right;
        positions[3 * i] = !low ? 0 : right ? out : -out;
        positions[3 * i + 1] = low ? -down : 0;
        positions[3 * i + 2] = end ? 0.0f : 24.0f;
        normals[3 * i] = !low ? 0 : right ? down : -down;
        normals[3 * i + 1] = low ? out : 1;
        normals[3 * i + 2] = 0;
        uv[2 * i] = (float)(4 + 30 * right + (end ? 0 : 24)) / 64;
        uv[2 * i + 1] = (4 + (low ? height : 0)) / 32;
    }
    scene_mesh(s, scene_material(s, 0.5f, 0.5f, 0.5f), positions, normals, NULL, 8, indices, 12)
        ->lightmap_texcoords.data = scene_copy(s, uv, 16);
    scene_sky(s, 1, 1, 1);
}

/* Seams join light that was measured with the same normals. If the sides of a ridge are narrow, facet_limit lights them
   by their geometric normals, which differ at the edge: there is no seam. By default, this is so only at edges of more
   than 60 degrees. */
TEST(seams_need_the_normals_of_the_light) {
    static const struct { double angle; float height, limit; int seams; } runs[] = {
        { 40, 2, 2, 0 }, { 40, 2, -1, 1 }, { 40, 2, 0, 1 }, { 90, 2, 0, 0 }, { 90, 16, 2, 1 }, { 40, 3, 2, 0 } };
    int run;
    for (run = 0; run < (int)(sizeof runs / sizeof *runs); run++) {
        static test_scene s;
        sbl_lightmap_desc desc = map_of(64, 32, SBL_MODE_DIRECT);
        float *light;
        ridge_of(&s, runs[run].angle, runs[run].height);
        desc.options.rays = 1;
        desc.facet_limit = runs[run].limit;
        light = bake(&s, &desc);
        CHECK(light && sbl_query_stats(context).lightmap.seams == runs[run].seams, "run %d: %d seams", run,
              sbl_query_stats(context).lightmap.seams);
        free(light);
        scene_free(&s);
    }
}

/* The test computes the gutter by its rule: each texel of a ring is the mean of its neighbours in the rings before. */
TEST(gutters_are_means_of_the_rings_before) {
    enum { W = 48, H = 32, RINGS = 5 };
    static test_scene s;
    sbl_lightmap_desc desc = map_of(W, H, SBL_MODE_DIRECT);
    static float expected[W * H];
    static int ring[W * H];
    float *light, *id, *final;
    int i, j, k, n, wrong = 0, beyond = 0;
    memset(&s, 0, sizeof s);
    uv_rectangle(&s, scene_floor(&s, scene_material(&s, 0.5f, 0.5f, 0.5f), 0, 1), 0.31f, 0.29f, 0.52f, 0.63f);
    scene_quad(&s, scene_lamp(&s, 5, 5, 5), -0.9f, 0.5f, -0.6f, -0.2f, 0.5f, -0.6f, -0.2f, 0.5f, 0.6f, -0.9f, 0.5f,
               0.6f);
    desc.gutter = RINGS;
    light = bake(&s, &desc);
    id = channel_of(&desc, SBL_CHANNEL_ID);
    final = channel_of(&desc, SBL_CHANNEL_FINAL);
    REQUIRE(light && id && final, "no lightmap");
    for (i = 0; i < W * H; i++) {
        ring[i] = id[i] > 0 ? 0 : 99;
        expected[i] = id[i] > 0 ? light[3 * i] : 0;
    }
    for (n = 1; n <= RINGS; n++)
        for (j = 0; j < H; j++)
            for (i = 0; i < W; i++) {
                double sum = 0;
                int count = 0;
                if (ring[j * W + i] < n) continue;
                for (k = 0; k < 9; k++) {
                    const int x = i + k % 3 - 1, y = j + k / 3 - 1;
                    if (x < 0 || y < 0 || x >= W || y >= H || ring[y * W + x] >= n) continue;
                    sum += (double)expected[y * W + x];
                    count++;
                }
                if (!count) continue;
                ring[j * W + i] = n;
                expected[j * W + i] = (float)(sum / count);
            }
    for (i = 0; i < W * H; i++) {
        wrong += fabs((double)final[3 * i] - (double)expected[i]) > 1e-3 * (double)expected[i];
        beyond += ring[i] == RINGS;
    }
    CHECK(wrong == 0 && beyond > 20, "%d texels are wrong; %d texels in the last ring", wrong, beyond);
    free(light);
    free(id);
    free(final);
    scene_free(&s);
}

/* A bright and a dark chart are 32 texels apart. In mip levels 0 to 3, made as means of four texels, bilinear samples
   anywhere on a chart, up to its edges, contain only the light of that chart. */
TEST(mip_levels_do_not_bleed) {
    enum { N = 128 };
    static const float roof[12] = { -9, 0.3f, -9, 9, 0.3f, -9, 9, 0.3f, 9, -9, 0.3f, 9 };
    static test_scene s;
    const sbl_lightmap_desc desc = map_of(N, N, SBL_MODE_DIRECT);
    static float level[3 * N * N];
    float *light, *final;
    int lod, size = N, x, y, k;
    memset(&s, 0, sizeof s);
    k = scene_material(&s, 0.5f, 0.5f, 0.5f);
    uv_rectangle(&s, scene_floor(&s, k, 0.31f, 1), 17.3f / N, 17.3f / N, 47.6f / N, 110.2f / N);
    uv_rectangle(&s, scene_floor(&s, k, 0.29f, 0.5f), 79.6f / N, 17.3f / N, 110.2f / N, 110.2f / N);
    scene_polygon(&s, k, roof, 4);
    scene_box(&s, k, -9, -1, -9, 9, 0.299f, 9);
    scene_sky(&s, 1, 1, 1);
    light = bake(&s, &desc);
    final = channel_of(&desc, SBL_CHANNEL_FINAL);
    REQUIRE(light && final, "no lightmap");
    memcpy(level, final, sizeof level);
    for (lod = 0; lod < 4; lod++, size /= 2) {
        double least = HUGE_VAL, most = 0;
        for (y = 0; y <= 100; y++)
            for (x = 0; x <= 100; x++) {
                double bright[2], dark[2];
                bright[0] = (17.3 + 30.3 * x / 100) / N;
                dark[0] = (79.6 + 30.6 * x / 100) / N;
                bright[1] = dark[1] = (17.3 + 92.9 * y / 100) / N;
                least = test_min(least, sample_of(level, size, size, bright));
                most = test_max(most, sample_of(level, size, size, dark));
            }
        CHECK(least > 0.99 && most < 1e-3, "level %d: the bright chart has at least %g, the dark one at most %g", lod,
              least, most);
        for (y = 0; y < size / 2; y++)
            for (x = 0; x < size / 2; x++)
                for (k = 0; k < 3; k++) {
                    const float *from = level + 3 * (2 * y * size + 2 * x) + k;
                    level[3 * (y * size / 2 + x) + k] = 0.25f *
                        (from[0] + from[3] + from[3 * size] + from[3 * size + 3]);
                }
    }
    free(light);
    free(final);
    scene_free(&s);
}

/* Normals point to the front side. Without normals, the front is the side from which the corners are
   counter-clockwise. */
TEST(light_falls_on_the_front) {
    int turned, normals;
    for (turned = 0; turned < 2; turned++)
        for (normals = 0; normals < 3; normals++) {
            static test_scene s;
            static const uint32_t orders[2][6] = { { 0, 1, 2, 0, 2, 3 }, { 0, 2, 1, 0, 3, 2 } };
            static const float corners[12] = { -1, 0, -1, -1, 0, 1, 1, 0, 1, 1, 0, -1 },
                lamp[12] = { -1, 1, -1, 1, 1, -1, 1, 1, 1, -1, 1, 1 };
            static const float up[12] = { 0, 1, 0, 0, 1, 0, 0, 1, 0, 0, 1, 0 },
                down[12] = { 0, -1, 0, 0, -1, 0, 0, -1, 0, 0, -1, 0 };
            const sbl_lightmap_desc desc = map_of(16, 16, SBL_MODE_DIRECT);
            const int lit = normals == 0 ? !turned : normals == 1;
            float *light;
            memset(&s, 0, sizeof s);
            uv_rectangle(&s, scene_mesh(&s, scene_material(&s, 0.5f, 0.5f, 0.5f), corners, normals ==
                                        0 ? NULL : normals == 1 ? up : down, NULL, 4,
                                        orders[turned], 6), 0, 0, 1, 1);
            scene_polygon(&s, scene_lamp(&s, 1, 1, 1), lamp, 4);
            light = bake(&s, &desc);
            if (light)
                CHECK((light[3 * 136] > 0.2f) == lit && (light[3 * 136] > 0) == lit, "corners %s, normals %s: R is %g",
                      turned ? "reversed" : "in order",
                             normals == 0 ? "absent" : normals == 1 ? "up" : "down", (double)light[3 * 136]);
            free(light);
            scene_free(&s);
        }
}

/* >>invalid or unusual coordinates */

static void strange(const float *first, const float *second, sbl_log_item item, const char *word) {
    static test_scene s;
    sbl_lightmap_desc desc = map_of(32, 32, SBL_MODE_DIRECT);
    float *light;
    int k;
    memset(&s, 0, sizeof s);
    k = scene_material(&s, 0.5f, 0.5f, 0.5f);
    uv_set(&s, scene_floor(&s, k, 0, 1), first);
    uv_set(&s, scene_floor(&s, k, 1, 1), second);
    scene_sky(&s, 1, 1, 1);
    light = bake(&s, &desc);
    CHECK(watch_said(&seen, SBL_LOG_WARNING, item, word, "mesh 1", NULL), "%s", watch_last(&seen));
    free(light);
    scene_free(&s);
}

/* Overlapping charts cause a warning with texel and mesh, and SBL_CHANNEL_OVERLAP marks exactly the shared texels. */
TEST(overlaps_are_named_and_shown) {
    static const float here[8] = { 0.1f, 0.1f, 0.6f, 0.1f, 0.6f, 0.6f, 0.1f, 0.6f },
        there[8] = { 0.5f, 0.5f, 0.9f, 0.5f, 0.9f, 0.9f, 0.5f, 0.9f };
    static const sbl_channel overlap = SBL_CHANNEL_OVERLAP;
    const sbl_lightmap_desc desc = map_of(32, 32, SBL_MODE_DIRECT);
    float *shared;
    int i, count = 0;
    strange(here, there, SBL_LOG_ITEM_OVERLAP, "texel 16 16");
    shared = channel_of(&desc, overlap);
    for (i = 0; i < 32 * 32; i++) {
        const int inside = i % 32 >= 16 && i % 32 <= 18 && i / 32 >= 16 && i / 32 <= 18;
        CHECK((shared[i] > 0) == inside, "texel %d %d: SBL_CHANNEL_OVERLAP is %g", i % 32, i / 32, (double)shared[i]);
        count += shared[i] > 0;
    }
    CHECK(count == 9 && watch_said(&seen, SBL_LOG_WARNING, SBL_LOG_ITEM_OVERLAP, "9 texels", NULL, NULL),
          "%d texels overlap: %s", count, watch_last(&seen));
    free(shared);
}

/* The triangles of a folded chart overlap, although they share an edge in the map. Each of the 120 texels whose centres
   are inside both counts; the centres on the fold do not. */
TEST(folded_charts_overlap_themselves) {
    static const float folded[8] = { 0.1f, 0.1f, 0.6f, 0.1f, 0.6f, 0.6f, 0.6f, 0.1f };
    static const float apart_from_it[8] = { 0.7f, 0.7f, 0.9f, 0.7f, 0.9f, 0.9f, 0.7f, 0.9f };
    strange(apart_from_it, folded, SBL_LOG_ITEM_OVERLAP, "texel 4 3");
    CHECK(watch_said(&seen, SBL_LOG_WARNING, SBL_LOG_ITEM_OVERLAP, "overlap in 120 texels", NULL, NULL), "%s",
          watch_last(&seen));
}

/* Charts that leave the map cause a warning with mesh and coordinates. */
TEST(charts_outside_are_named) {
    static const float here[8] = { 0.1f, 0.1f, 0.4f, 0.1f, 0.4f, 0.4f, 0.1f, 0.4f },
        there[8] = { 0.5f, 0.5f, 1.5f, 0.5f, 1.5f, 0.9f, 0.5f, 0.9f };
    static const float left[8] = { -0.3f, 0.5f, 0.3f, 0.5f, 0.3f, 0.9f, -0.3f, 0.9f };
    static const float far_off[8] = { 1e30f, -1e30f, 3e38f, 1, -3e38f, 3e38f, 7, 7 };
    strange(here, there, SBL_LOG_ITEM_OUTSIDE, "1.5 0.");
    CHECK(watch_said(&seen, SBL_LOG_WARNING, SBL_LOG_ITEM_OUTSIDE, "2 triangles lie partly outside", NULL, NULL), "%s",
          watch_last(&seen));
    strange(here, left, SBL_LOG_ITEM_OUTSIDE, "-0.3 0.");
    strange(here, far_off, SBL_LOG_ITEM_OUTSIDE, "lightmap");
}

/* NaN in map coordinates and coordinates of an integer type are mistakes of the scene. If no mesh has coordinates, the
   bake is refused, and a former map stays. If all lie outside of the map, it is empty, with a warning. */
TEST(bad_coordinates_are_mistakes) {
    static test_scene s;
    sbl_lightmap_desc desc = map_of(32, 32, SBL_MODE_DIRECT);
    static float uv[8] = { 0, 0, 1, 0, 1, 1, 0, 1 };
    sbl_scene_desc scene;
    float *light;
    int i, lit = 0;
    memset(&s, 0, sizeof s);
    scene_floor(&s, scene_material(&s, 0.5f, 0.5f, 0.5f), 0, 1);
    scene_sky(&s, 1, 1, 1);
    REQUIRE(use_scene(&s) && sbl_render_picture(context, NULL) == SBL_SUCCESS, "%s", watch_last(&seen));
    CHECK(sbl_bake_lightmap(context, &desc) == SBL_ERROR_INVALID_ARGUMENT &&
          watch_said(&seen, SBL_LOG_ERROR, SBL_LOG_ITEM_INVALID_LIGHTMAP_DESC, "sbl_lightmap_desc",
                     "no mesh of the scene has lightmap_texcoords", NULL), "%s", watch_last(&seen));
    CHECK(!sbl_lightmap_bytes(context, &desc) && sbl_channel_texture(context, SBL_CHANNEL_FINAL),
          "the picture is gone");
    for (i = 0; i < 8; i++) uv[i] += 2;
    uv_set(&s, &s.meshes[0], uv);
    light = bake(&s, &desc);
    for (i = 0; light && i < 32 * 32 * 3; i++) lit += light[i] != 0;
    CHECK(light && lit == 0 && watch_said(&seen, SBL_LOG_WARNING, SBL_LOG_ITEM_NOTHING_VISIBLE, "lightmap_texcoords",
                                          NULL, NULL), "%s", watch_last(&seen));
    free(light);
    for (i = 0; i < 8; i++) uv[i] -= 2;
    uv[5] = (float)NAN;
    uv_set(&s, &s.meshes[0], uv);
    scene = scene_desc(&s);
    CHECK(sbl_set_scene(context, &scene) == SBL_ERROR_INVALID_ARGUMENT, "NaN in a coordinate is accepted");
    CHECK(watch_said(&seen, SBL_LOG_ERROR, SBL_LOG_ITEM_INVALID_MESH, "mesh 0", "lightmap_texcoords", "vertex 2"), "%s",
          watch_last(&seen));
    uv[5] = 1;
    s.meshes[0].lightmap_texcoords.type = SBL_UINT8;
    scene = scene_desc(&s);
    CHECK(sbl_set_scene(context, &scene) == SBL_ERROR_INVALID_ARGUMENT, "an integer type is accepted");
    CHECK(watch_said(&seen, SBL_LOG_ERROR, SBL_LOG_ITEM_INVALID_MESH, "mesh 0", "lightmap_texcoords.type", NULL), "%s",
          watch_last(&seen));
    scene_free(&s);
}

/* A warning counts triangles without area in the map; if there are no others, the bake fails. */
TEST(triangles_without_area_are_counted) {
    static const float point[8] = { 0.3f, 0.3f, 0.3f, 0.3f, 0.3f, 0.3f, 0.3f, 0.3f };
    static const float line[8] = { 0.7f, 0.1f, 0.73f, 0.17f, 0.79f, 0.31f, 0.82f, 0.38f };
    static test_scene s;
    const sbl_lightmap_desc desc = map_of(32, 32, SBL_MODE_DIRECT);
    int i;
    for (i = 0; i < 2; i++) {
        sbl_scene_desc scene;
        sbl_result result;
        memset(&s, 0, sizeof s);
        uv_set(&s, scene_floor(&s, scene_material(&s, 0.5f, 0.5f, 0.5f), 0, 1), point);
        uv_set(&s, scene_floor(&s, 0, -1, 1), line);
        if (i) uv_rectangle(&s, scene_floor(&s, 0, -2, 1), 0.1f, 0.5f, 0.9f, 0.9f);
        scene_sky(&s, 1, 1, 1);
        scene = scene_desc(&s);
        CHECK(sbl_set_scene(context, &scene) == SBL_SUCCESS, "%s", watch_last(&seen));
        result = sbl_bake_lightmap(context, &desc);
        CHECK(result == (i ? SBL_SUCCESS : SBL_ERROR_INVALID_ARGUMENT), "%s", sbl_result_string(result));
        CHECK(watch_said(&seen, i ? SBL_LOG_WARNING : SBL_LOG_ERROR, SBL_LOG_ITEM_DEGENERATE_TRIANGLES,
                         i ? "4 of 6" : "4 of 4", "no area in the map", NULL), "%s", watch_last(&seen));
        watch_forget(&seen);
        scene_free(&s);
    }
}

static void refused(sbl_lightmap_desc desc, const char *word) {
    const sbl_result result = sbl_begin_lightmap(context, &desc);
    CHECK(result == SBL_ERROR_INVALID_ARGUMENT, "%s: %s", word, sbl_result_string(result));
    CHECK(watch_said(&seen, SBL_LOG_ERROR, SBL_LOG_ITEM_INVALID_LIGHTMAP_DESC, "sbl_lightmap_desc", word, NULL),
          "%s: %s", word, watch_last(&seen));
    watch_forget(&seen);
}

/* Every field of sbl_lightmap_desc is checked, and the message names it. */
TEST(every_field_is_checked) {
    static test_scene s;
    static const int meshes[3] = { 0, 1, 7 };
    const sbl_lightmap_desc good = map_of(16, 16, SBL_MODE_DIRECT);
    sbl_lightmap_desc d;
    memset(&s, 0, sizeof s);
    uv_rectangle(&s, scene_floor(&s, scene_material(&s, 0.5f, 0.5f, 0.5f), 0, 1), 0, 0, 1, 1);
    scene_floor(&s, 0, 2, 1);
    REQUIRE(use_scene(&s), "no context");
    d = good; d.width = -3; refused(d, "width");
    d = good; d.width = 16385; refused(d, "width");
    d = good; d.height = 0; refused(d, "height");
    d = good; d.gutter = 16385; refused(d, "gutter");
    d = good; d.supersample = -1; refused(d, "supersample");
    d = good; d.supersample = 9; refused(d, "supersample");
    d = good; d.supersample = INT_MAX; d.width = INT_MAX; refused(d, "supersample");
    d = good; d.supersample = 2; d.height = 8193; refused(d, "supersample");
    d = good; d.directional = 2; refused(d, "directional");
    d = good; d.options.mode = SBL_MODE_PAPER; refused(d, "SBL_MODE_PAPER");
    d = good; d.options.mode = (sbl_mode)99; refused(d, "options.mode");
    d = good; d.options.preset = (sbl_preset)-1; refused(d, "options.preset");
    d = good; d.options.backend = (sbl_backend)77; refused(d, "options.backend");
    d = good; d.target_error = -1; refused(d, "target_error");
    d = good; d.max_bounce_cells = 1023; refused(d, "max_bounce_cells");
    d = good; d.options.rays = 5000; refused(d, "options.rays");
    d = good; d.options.sensor_size = 1; refused(d, "options.sensor_size");
    d = good; d.tile = 2000; refused(d, "tile");
    d = good; d.threshold = (float)NAN; refused(d, "threshold");
    d = good; d.options.epsilon = (float)NAN; d.options.mode = SBL_MODE_AMBIENT; refused(d, "options.epsilon");
    d = good; d.facet_limit = (float)NAN; refused(d, "facet_limit");
    d = good; d.filter_radius = 33; refused(d, "filter_radius");
    d = good; d.start_canary = 1; refused(d, "start_canary");
    d = good; d.end_canary = 1; refused(d, "end_canary");
    d = good; d.mesh_count = 1; refused(d, "mesh_count");
    d = good; d.meshes = meshes; d.mesh_count = -1; refused(d, "mesh_count");
    d = good; d.meshes = meshes; d.mesh_count = 2; refused(d, "meshes[1]");
    d = good; d.meshes = meshes; d.mesh_count = 3; refused(d, "meshes[2]");
    CHECK(sbl_begin_lightmap(NULL, &good) == SBL_ERROR_INVALID_ARGUMENT && sbl_bake_lightmap(NULL, NULL) ==
          SBL_ERROR_INVALID_ARGUMENT, "NULL is accepted");
    d = sbl_lightmap_desc_defaults(NULL);
    CHECK(d.width == 512 && d.height == 512 && d.gutter == 16 && d.options.mode == SBL_MODE_GI && d.tile == 8 &&
              d.filter_radius == 2 && d.facet_limit == 0 && d.target_error == 0.005f,
          "%d x %d, gutter %d", d.width, d.height, d.gutter);
    scene_free(&s);
}

/* Only the selected one of two meshes is baked. */
TEST(meshes_are_chosen) {
    static test_scene s;
    static const int second = 1;
    sbl_lightmap_desc desc = map_of(16, 16, SBL_MODE_DIRECT);
    float *light;
    memset(&s, 0, sizeof s);
    scene_material(&s, 0.5f, 0.5f, 0.5f);
    uv_rectangle(&s, scene_floor(&s, 0, 0, 1), 0, 0, 0.5f, 1);
    uv_rectangle(&s, scene_floor(&s, 0, 2, 1), 0.5f, 0, 1, 1);
    scene_sky(&s, 1, 1, 1);
    desc.gutter = -1;
    desc.meshes = &second;
    desc.mesh_count = 1;
    light = bake(&s, &desc);
    if (light)
        CHECK(light[3 * (8 * 16 + 4)] == 0 && fabs((double)light[3 * (8 * 16 + 12)] - 1) < 1e-3, "left %g, right %g",
              (double)light[3 * (8 * 16 + 4)],
                     (double)light[3 * (8 * 16 + 12)]);
    free(light);
    scene_free(&s);
}

/* >>behaviour shared by all front ends */

static int cancel(float done, void *user) { (void)user; return done > 0.3f; }

/* A lightmap in many short steps equals one in a single call, to the bit. Its channels can be read before it is
   finished. It can be cancelled, and setting another scene ends it. */
TEST(it_comes_in_pieces) {
    static test_scene s;
    sbl_lightmap_desc desc = map_of(100, 60, SBL_MODE_GI);
    sbl_sensor sensor;
    sbl_scene_desc scene;
    float *whole, *pieces, *early, last = 0;
    sbl_result result;
    int i, steps = 0, looked = 0, lit = 0;
    memset(&s, 0, sizeof s);
    scene_material(&s, 0.5f, 0.5f, 0.5f);
    scene_box(&s, 0, -0.3f, 0, -0.3f, 0.3f, 0.6f, 0.3f);
    for (i = 0; i < 6; i++)
        uv_rectangle(&s, &s.meshes[i], 0.1f * (float)i + 0.01f, 0.5f, 0.1f * (float)i + 0.09f, 0.9f);
    uv_rectangle(&s, scene_floor(&s, 0, 0, 1), 0.02f, 0.02f, 0.4f, 0.47f);
    scene_sky(&s, 1, 0.5f, 0.2f);
    desc.gutter = 4;
    desc.directional = 1;
    desc.supersample = 2;
    whole = bake(&s, &desc);
    if (whole) {
        const size_t floats = 100 * 60 * 3;
        float *final = channel_of(&desc, SBL_CHANNEL_FINAL), *harmonics = channel_of(&desc, SBL_CHANNEL_SH_3);
        CHECK(sbl_inspect_sensor(context, 20, 12, &sensor, NULL, NULL, 0) == SBL_SUCCESS && sensor.normal[1] > 0.99f,
              "%s", watch_last(&seen));
        CHECK(sbl_channel_texture(context, SBL_CHANNEL_FINAL) && sbl_channel_texture(context, SBL_CHANNEL_OVERLAP),
              "no texture");
        early = (float *)calloc(floats, sizeof *early);
        CHECK(sbl_begin_lightmap(context, &desc) == SBL_SUCCESS, "%s", watch_last(&seen));
        do {
            result = sbl_step(context, 1e-9);  /* one item per step */
            steps++;
            CHECK(sbl_progress(context) >= last, "progress falls from %g", (double)last);
            last = sbl_progress(context);
            if (!looked && result == SBL_UNFINISHED && sbl_read_channel(context, SBL_CHANNEL_FINAL, early, floats) ==
                SBL_SUCCESS) looked = steps;
        } while (result == SBL_UNFINISHED);
        CHECK(result == SBL_SUCCESS && steps > 20 && looked > 0, "%s, %d steps, first read at step %d",
              sbl_result_string(result), steps, looked);
        for (i = 0; i < (int)floats; i++) lit += early[i] > 0;
        CHECK(lit > 4000, "the unfinished lightmap has %d lit values", lit);
        pieces = channel_of(&desc, SBL_CHANNEL_RADIANCE);
        CHECK(memcmp(whole, pieces, floats * sizeof *whole) == 0, "R differs");
        free(pieces);
        pieces = channel_of(&desc, SBL_CHANNEL_FINAL);
        CHECK(memcmp(final, pieces, floats * sizeof *whole) == 0, "the gutter differs");
        free(pieces);
        pieces = channel_of(&desc, SBL_CHANNEL_SH_3);
        CHECK(memcmp(harmonics, pieces, floats * sizeof *whole) == 0, "a harmonic differs");
        free(pieces);
        free(harmonics);
        free(early);
        free(final);
        desc.options.progress = cancel;
        CHECK(sbl_bake_lightmap(context, &desc) == SBL_CANCELLED, "the bake is not cancelled");
        desc.options.progress = NULL;
        CHECK(sbl_begin_lightmap(context, &desc) == SBL_SUCCESS && sbl_step(context, 1e-5) == SBL_UNFINISHED, "%s",
              watch_last(&seen));
        scene = scene_desc(&s);
        scene.mesh_count = 1;
        CHECK(sbl_set_scene(context, &scene) == SBL_SUCCESS && sbl_step(context, 0) == SBL_ERROR_STATE,
              "the bake continues after sbl_set_scene");
        CHECK(sbl_bake_lightmap(context, &desc) == SBL_SUCCESS, "%s", watch_last(&seen));
    }
    free(whole);
    scene_free(&s);
}

/* >>small facets */

enum { LEANING_FLOOR, PIPE, CAPPED_PIPE, BEVEL, BALL };

/* Writes the position and the normal of vertex i of a sheet of n x n squares, see sheet_of. */
static void sheet_vertex(int shape, int n, int i, float *position, float *normal) {
    const int column = i % (n + 1), line = i / (n + 1);
    const double around = shape == BEVEL ? column / 4 / 2.0 + column % 4 / 24.0 : column / (double)n;
    const double turn = REF_PI * (1 - 2 * around), up = shape == BALL ? (1 - 2.0 * line / n) * REF_PI / 3 : 0;
    if (shape == LEANING_FLOOR) {
        position[0] = (float)column;
        position[1] = 0;
        position[2] = (float)line;
        normal[0] = (float)sqrt(0.75);
        normal[1] = 0.5f;
        normal[2] = 0;
        return;
    }
    normal[0] = (float)(cos(up) * cos(turn));
    normal[1] = (float)sin(up);
    normal[2] = (float)(cos(up) * sin(turn));
    memcpy(position, normal, 3 * sizeof *position);
    if (shape == BALL) return;
    position[1] = 6 * (0.5f - (float)line / (float)n);
    if (shape == CAPPED_PIPE) position[1] = line < n - 1 ? 3 - 0.01f * (float)line : -3;
    if (shape == CAPPED_PIPE && line == n) position[0] = position[2] = 0;
}

/* Makes a sheet of n x n squares under a vertical sun, with a chart that fills the map: a square floor from 0 to n,
   whose normals lean by 60 degrees, so that R is 1 where a texel shows the geometric normal, and 0.5 where it shows the
   leaning one; a pipe; a pipe with a cap, next to which its squares are long; a bar of 8 sides, which
   turn by 15, 15, 15, and 135 degrees, twice; or a ball from 60 degrees south to 60 degrees north. */
static void sheet_of(test_scene *s, int shape, int n) {
    const int row = n + 1;
    float *positions, *normals, *uv;
    uint32_t *indices;
    sbl_light *sun;
    int i, count = 0;
    memset(s, 0, sizeof *s);
    positions = (float *)scene_alloc(s, sizeof(float) * 3 * (size_t)(row * row));
    normals = (float *)scene_alloc(s, sizeof(float) * 3 * (size_t)(row * row));
    uv = (float *)scene_alloc(s, sizeof(float) * 2 * (size_t)(row * row));
    indices = (uint32_t *)scene_alloc(s, sizeof *indices * 6 * (size_t)(n * n));
    for (i = 0; i < row * row; i++) {
        sheet_vertex(shape, n, i, positions + 3 * i, normals + 3 * i);
        uv[2 * i] = (float)(i % row) / (float)n;
        uv[2 * i + 1] = (float)(i / row) / (float)n;
    }
    for (i = 0; i < n * n; i++) {
        const uint32_t a = (uint32_t)(i / n * row + i % n), b = a + (uint32_t)row;
        const uint32_t corners[6] = { a, b, a + 1, a + 1, b, b + 1 };
        memcpy(indices + count, corners, sizeof corners);
        count += 6;
    }
    scene_mesh(s, scene_material(s, 0.5f, 0.5f, 0.5f), positions, normals, NULL, row * row, indices, count)
        ->lightmap_texcoords.data = uv;
    sun = scene_light(s, SBL_LIGHT_DIRECTIONAL, (float)REF_PI, (float)REF_PI, (float)REF_PI);
    sun->direction[1] = -1;
}

/* Triangles that are lower than facet_limit in the map show their geometric normals; from twice the limit on they show
   the normals of the file; in between, a mixture. Heights count in texels, also if these are supersampled. */
TEST(small_facets_show_geometric_normals) {
    /* width of the map over that of the floor's squares; a triangle's height is this / sqrt(2) */
    static const struct { int squares, texels, supersample; float limit; double light; } runs[] = {
        { 8, 16, 0, 2, 1 },                          /* 1.41 texels */
        { 8, 16, 2, 2, 1 },                          /* 2.83 places of a texel */
        { 4, 32, 0, 2, 0.5 },                        /* 5.7 texels: above twice the limit */
        { 8, 16, 0, 0, 0.5 },                        /* the default: only near sharp edges */
        { 8, 16, 0, -1, 0.5 },
        { 8, 16, 0, 0.942809f, 0.8660254 },          /* 1.5 times the limit: the mean of both normals, 30 degrees */
    };
    int run, i;
    for (run = 0; run < (int)(sizeof runs / sizeof *runs); run++) {
        static test_scene s;
        sbl_lightmap_desc desc = map_of(runs[run].texels, runs[run].texels, SBL_MODE_DIRECT);
        float *R, *normal;
        double off = 0;
        sheet_of(&s, LEANING_FLOOR, runs[run].squares);
        desc.supersample = runs[run].supersample;
        desc.facet_limit = runs[run].limit;
        R = bake(&s, &desc);
        normal = R ? channel_of(&desc, SBL_CHANNEL_NORMAL) : NULL;
        REQUIRE(R && normal, "no lightmap");
        for (i = 0; i < desc.width * desc.height; i++) {
            off = fmax(off, fabs((double)R[3 * i] - runs[run].light));
            off = fmax(off, fabs((double)normal[3 * i + 1] - runs[run].light));
        }
        CHECK(off < 1e-3, "run %d: R is off by %g", run, off);
        free(R);
        free(normal);
        scene_free(&s);
    }
}

/* Returns the largest angle, in degrees, between the normals of a sheet's texels and those that the file has there. The
   texels on the border of the chart are left out, and all outside of the given columns, unless the last is 0. */
static double sheet_off(int shape, int squares, int texels, const int columns[2]) {
    static test_scene s;
    sbl_lightmap_desc desc = map_of(texels, texels, SBL_MODE_DIRECT);
    float *found[2];
    double least = 1;
    int run, i, k;
    for (run = 0; run < 2; run++) {
        float *R;
        sheet_of(&s, shape, squares);
        desc.facet_limit = run ? 0.0f : -1.0f;
        R = bake(&s, &desc);
        found[run] = R ? channel_of(&desc, SBL_CHANNEL_NORMAL) : NULL;
        free(R);
        scene_free(&s);
    }
    for (i = 0; found[0] && found[1] && i < texels * texels; i++) {
        const int x = i % texels, y = i / texels;
        double cosine = 0;
        if (x == 0 || y == 0 || x == texels - 1 || y == texels - 1) continue;
        if (columns[1] && (x < columns[0] || x > columns[1])) continue;
        for (k = 0; k < 3; k++) cosine += (double)found[0][3 * i + k] * (double)found[1][3 * i + k];
        least = fmin(least, cosine);
    }
    least = found[0] && found[1] ? least : -1;
    free(found[0]);
    free(found[1]);
    return acos(least) * 180 / REF_PI;
}

/* By default, narrow facets show geometric normals near sharp edges. The sides of a square bar meet at 90 degrees. On a
   bar of 8 sides, the middle one of three narrow sides has no sharp edge, but its neighbours have. Balls and pipes stay
   smooth, even long facets at the end of a pipe. */
TEST(facets_at_sharp_edges_show_geometric_normals) {
    static const struct {
        int shape, squares, texels, columns[2];
        const char *name;
        double least, most;  /* limits of the angle */
    } runs[] = {
        { PIPE, 4, 8, { 0, 0 }, "square bar, sides of 2 texels", 20, 30 },
        { PIPE, 4, 64, { 0, 0 }, "square bar, sides of 16 texels", 0, 0.1 },
        { BEVEL, 8, 16, { 2, 3 }, "between two narrow sides", 3, 5 },
        { BEVEL, 8, 16, { 6, 7 }, "a wide side", 0, 0.1 },
        { PIPE, 20, 30, { 0, 0 }, "pipe, facets of 1.5 texels", 0, 0.1 },
        { PIPE, 6, 12, { 0, 0 }, "pipe of six sides", 0, 0.1 },
        { CAPPED_PIPE, 20, 30, { 0, 0 }, "end of a pipe", 0, 0.1 },
        { BALL, 20, 30, { 0, 0 }, "ball, facets of 1.5 texels", 0, 0.1 }
    };
    int i;
    for (i = 0; i < (int)(sizeof runs / sizeof *runs); i++) {
        const double off = sheet_off(runs[i].shape, runs[i].squares, runs[i].texels, runs[i].columns);
        printf("  %s: normals differ from the file's by %.2f degrees\n", runs[i].name, off);
        CHECK(off >= runs[i].least && off <= runs[i].most, "%s: normals differ by %g degrees", runs[i].name, off);
    }
}

/* A box covers the centres of a column of texels, but not all of them. They show what is beside the box: there, small
   facets have their geometric normals, too, and large ones the normals of the file. In the last run, facet_limit
   affects only facets near sharp edges, and there are none. */
TEST(covered_texels_show_geometric_normals) {
    int run, i;
    for (run = 0; run < 3; run++) {
        static test_scene s;
        const int texels = run == 1 ? 64 : 8, column = run == 1 ? 36 : 4;  /* the side of the box crosses it */
        const double light = run ? 0.5 : 1;
        sbl_lightmap_desc desc = map_of(texels, texels, SBL_MODE_DIRECT);
        float *R;
        double off = 0;
        desc.facet_limit = run < 2 ? 2.0f : 0.0f;
        sheet_of(&s, LEANING_FLOOR, 8);
        scene_box(&s, 0, -1, -1, -1, run == 1 ? 4.575f : 4.6f, run == 1 ? 0.025f : 0.2f, 9);
        R = bake(&s, &desc);
        REQUIRE(R, "no lightmap");
        for (i = 0; i < texels; i++) off = fmax(off, fabs((double)R[3 * (texels * i + column)] - light));
        CHECK(off < 0.01, "run %d: texels at the box are off by %g", run, off);
        free(R);
        scene_free(&s);
    }
}

/* >>lack of memory and unusual sizes */

/* Makes a floor of two charts with a lamp. Baking it uses all parts of a lightmap, including seams. */
static void small_room(test_scene *s) {
    int material;
    memset(s, 0, sizeof *s);
    material = scene_material(s, 0.5f, 0.5f, 0.5f);
    uv_rectangle(s, scene_quad(s, material, -1, 0, -1, -1, 0, 1, 0, 0, 1, 0, 0, -1), 0.05f, 0.1f, 0.45f, 0.9f);
    uv_rectangle(s, scene_quad(s, material, 0, 0, -1, 0, 0, 1, 1, 0, 1, 1, 0, -1), 0.55f, 0.1f, 0.95f, 0.9f);
    scene_quad(s, scene_lamp(s, 5, 5, 5), -0.3f, 1, -0.3f, 0.3f, 1, -0.3f, 0.3f, 1, 0.3f, -0.3f, 1, 0.3f);
}

static float small_map[3 * 24 * 12];

static sbl_result lightmap_call(const void *desc) {
    const sbl_result result = sbl_bake_lightmap(context, (const sbl_lightmap_desc *)desc);
    if (result != SBL_SUCCESS) return result;
    seen.refuse_at = 0;  /* only the bake is tested */
    return sbl_read_channel(context, SBL_CHANNEL_RADIANCE, small_map, sizeof small_map / sizeof *small_map);
}

/* Makes each allocation fail once, in turn. The bake fails with a message and leaks nothing, and the next bake
   succeeds. */
TEST(memory_runs_out) {
    static test_scene s;
    sbl_lightmap_desc desc = map_of(24, 12, SBL_MODE_DIRECT);
    int failed;
    small_room(&s);
    REQUIRE(use_scene(&s), "no context");
    desc.options.rays = 16;
    desc.gutter = 2;
    desc.directional = 1;
    desc.supersample = 2;
    CHECK(sbl_bake_lightmap(context, &desc) == SBL_SUCCESS && sbl_query_stats(context).lightmap.seams == 1, "%s",
          watch_last(&seen));
    failed = each_allocation_fails(lightmap_call, &desc, NULL, small_map, sizeof small_map);
    CHECK(failed > 20, "%d allocations failed", failed);
    scene_free(&s);
}

/* Maps of one texel, of one row, and larger than the GL limit are baked or refused. */
TEST(sizes_of_all_kinds) {
    static const int sizes[][2] = { { 1, 1 }, { 1, 7 }, { 300, 1 }, { 3, 3 }, { 2, 2 } };
    static test_scene s;
    sbl_lightmap_desc desc;
    int i;
    small_room(&s);
    for (i = 0; i < (int)(sizeof sizes / sizeof *sizes); i++) {
        float *light, most = 0;
        int k;
        desc = map_of(sizes[i][0], sizes[i][1], SBL_MODE_DIRECT);
        desc.options.rays = 16;
        light = bake(&s, &desc);
        for (k = 0; light && k < 3 * desc.width * desc.height; k++) if (light[k] > most) most = light[k];
        CHECK(light && most > 0.1f && most < 2, "%d x %d: %g at most", desc.width, desc.height, (double)most);
        free(light);
    }
    desc = map_of(16384, 2, SBL_MODE_DIRECT);
    watch_forget(&seen);
    if (sbl_query_capabilities(context).max_texture_size < 16384)
        CHECK(sbl_begin_lightmap(context, &desc) == SBL_ERROR_UNSUPPORTED,
              "a map larger than textures can be is accepted");
    else CHECK(sbl_begin_lightmap(context, &desc) == SBL_SUCCESS, "%s", watch_last(&seen));
    sbl_end(context);
    scene_free(&s);
}

/* Makes two rooms side by side that share the chart of the floor; the lamp is in one of them. The walls have no
   thickness. outward: 1 if their triangles face outwards */
static void two_rooms(test_scene *s, int outward) {
    static const float walls[7][12] = {
        { -2, 0, -1, -2, 0, 1, -2, 1, 1, -2, 1, -1 }, { 2, 0, -1, 2, 1, -1, 2, 1, 1, 2, 0, 1 },
        { -2, 0, -1, -2, 1, -1, 2, 1, -1, 2, 0, -1 },
        { -2, 0, 1, 2, 0, 1, 2, 1, 1, -2, 1, 1 }, { -2, 1, -1, -2, 1, 1, 2, 1, 1, 2, 1, -1 },
        { 0, 0, -1, 0, 0, 1, 0, 1, 1, 0, 1, -1 },
        { -2, 0, -1, -2, 0, 1, 2, 0, 1, 2, 0, -1 } };
    const int white = scene_material(s, 0.7f, 0.7f, 0.7f);
    int i, k;
    for (i = 0; i < 7; i++) {
        float c[12];
        for (k = 0; k < 12; k++) c[k] = walls[i][outward ? 3 * ((4 - k / 3) % 4) + k % 3 : k];
        if (i < 6) scene_polygon(s, white, c, 4);
        else {  /* the floor always faces up */
            sbl_mesh *floor = scene_polygon(s, white, walls[i], 4);
            float uv[8];
            for (k = 0; k < 4; k++) {
                const float *p = (const float *)floor->positions.data + 3 * k;
                uv[2 * k] = 0.05f + 0.9f * (p[0] + 2) / 4;
                uv[2 * k + 1] = 0.1f + 0.8f * (p[2] + 1) / 2;
            }
            uv_set(s, floor, uv);
        }
    }
    scene_quad(s, scene_lamp(s, 5, 5, 5), 0.7f, 0.9f, -0.3f, 1.3f, 0.9f, -0.3f, 1.3f, 0.9f, 0.3f, 0.7f, 0.9f, 0.3f);
}

/* Walls without thickness keep light out of the dark room, also in texels beside the wall. */
TEST(thin_walls_hold_light_back) {
    static test_scene s;
    int run;
    for (run = 0; run < 4; run++) {  /* both modes with both orientations */
        sbl_lightmap_desc desc = map_of(64, 32, run & 1 ? SBL_MODE_GI : SBL_MODE_DIRECT);
        float *light, *final;
        double dark = 0, bright = 0, least = HUGE_VAL;
        int x, y;
        memset(&s, 0, sizeof s);
        two_rooms(&s, run / 2);
        light = bake(&s, &desc);
        final = channel_of(&desc, SBL_CHANNEL_FINAL);
        for (y = 4; light && final && y < 28; y++)
            for (x = 4; x < 60; x++) {
                const double R = test_max((double)light[3 * (y * 64 + x)], (double)final[3 * (y * 64 + x)]);
                if (x < 31) dark = test_max(dark, R);
                if (x > 33) { bright = test_max(bright, R); least = test_min(least, (double)final[3 * (y * 64 + x)]); }
            }
        CHECK(light && final && bright > 0.3 && least > 0.05 && dark < 1e-3 * bright,
              "run %d: R is at most %g in the dark room, %g to %g in the lit one", run, dark, least, bright);
        CHECK(sbl_query_stats(context).sensors.invalid == 0, "run %d: %d sensors are invalid in open rooms", run,
              (int)sbl_query_stats(context).sensors.invalid);
        free(light);
        free(final);
        scene_free(&s);
    }
}

int main(void) {
    RUN(texels_show_what_touches_them);
    RUN(charts_share_a_narrow_gap);
    RUN(charts_without_area_are_shown);
    RUN(a_floor_under_a_lamp);
    RUN_UNSANITIZED(a_furnace);
    RUN(reading_early_changes_nothing);
    RUN(charts_keep_their_light);
    RUN(what_lies_on_a_floor_does_not_shine_out);
    RUN(what_is_under_a_floor_does_not_shine_up);
    RUN_UNSANITIZED(boxes_leave_no_dark_rims);
    RUN(gaps_show_their_openings);
    RUN(narrow_charts_are_measured_across);
    RUN(strips_between_first_sensors_are_lit);
    RUN(seams_of_a_ball);
    RUN(seams_do_not_leak);
    RUN(seams_need_the_normals_of_the_light);
    RUN(charts_are_parted_by_the_map);
    RUN(gutters_are_means_of_the_rings_before);
    RUN(mip_levels_do_not_bleed);
    RUN(light_falls_on_the_front);
    RUN(overlaps_are_named_and_shown);
    RUN(folded_charts_overlap_themselves);
    RUN(charts_outside_are_named);
    RUN(bad_coordinates_are_mistakes);
    RUN(triangles_without_area_are_counted);
    RUN(every_field_is_checked);
    RUN(meshes_are_chosen);
    RUN(it_comes_in_pieces);
    RUN(small_facets_show_geometric_normals);
    RUN(facets_at_sharp_edges_show_geometric_normals);
    RUN(covered_texels_show_geometric_normals);
    RUN(memory_runs_out);
    RUN_PLAIN(sizes_of_all_kinds);
    RUN_UNSANITIZED(thin_walls_hold_light_back);
    sbl_destroy(context);
    CHECK(seen.blocks == 0 && seen.strangers == 0, "%d blocks are not freed, %d were freed twice or never allocated",
          seen.blocks, seen.strangers);
    return test_report() || test_errors;
}
