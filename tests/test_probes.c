/* Tests of probes. They compare the light at points in the air with closed forms, and with sums over directions, areas
   of lamps and faces of boxes that are computed here. Further tests check how probes are placed, moved and baked in
   time slices. */
#include "../sbl.h"
#include "support/test.h"
#include "support/scenes.h"
#include "support/reference.h"
#include "support/gl_watch.h"
#include "support/one_context.h"
#include <limits.h>

static const double pi = REF_PI;

static sbl_probes_desc probes_of(const float *positions, sbl_probe *probes, int count) {
    sbl_probes_desc desc;
    memset(&desc, 0, sizeof desc);
    desc.positions = positions;
    desc.probes = probes;
    desc.probe_count = count;
    desc.options.mode = SBL_MODE_DIRECT;
    return desc;
}

static void bake(const sbl_probes_desc *desc) {
    sbl_result result;
    memset(desc->probes, 0xff, sizeof *desc->probes * (size_t)desc->probe_count);
    result = sbl_bake_probes(context, desc);
    CHECK(result == SBL_SUCCESS, "%s: %s", sbl_result_string(result), watch_last(&seen));
}

static sbl_probe probe_at(float x, float y, float z, sbl_mode mode) {
    const float at[3] = { x, y, z };
    sbl_probe probe;
    sbl_probes_desc desc = probes_of(at, &probe, 1);
    desc.options.mode = mode;
    bake(&desc);
    return probe;
}

/* >>references: sums over directions give the expected light */

typedef struct field { double sh[9], cube[6]; } field;

/* Computes the nine real spherical harmonics of degrees 0 to 2, as textbooks define them. */
static void basis(double x, double y, double z, double out[9]) {
    out[0] = sqrt(1 / (4 * pi));
    out[1] = sqrt(3 / (4 * pi)) * y;
    out[2] = sqrt(3 / (4 * pi)) * z;
    out[3] = sqrt(3 / (4 * pi)) * x;
    out[4] = sqrt(15 / (4 * pi)) * x * y;
    out[5] = sqrt(15 / (4 * pi)) * y * z;
    out[6] = sqrt(5 / (16 * pi)) * (2 * z * z - x * x - y * y);
    out[7] = sqrt(15 / (4 * pi)) * x * z;
    out[8] = sqrt(15 / (16 * pi)) * (x + y) * (x - y);
}

/* Adds light from a direction to the field. light: radiance times solid angle */
static void shine(field *f, double light, double x, double y, double z) {
    const double way[3] = { x, y, z };
    double y9[9];
    int i;
    basis(x, y, z, y9);
    for (i = 0; i < 9; i++) f->sh[i] += light * y9[i];
    for (i = 0; i < 6; i++) f->cube[i] += light * fmax(0, i & 1 ? -way[i / 2] : way[i / 2]) / pi;
}

static double norm_of(const field *f) {
    return sqrt(f->sh[0] * f->sh[0] + f->sh[1] * f->sh[1] + f->sh[2] * f->sh[2] + f->sh[3] * f->sh[3]);
}

/* Returns the largest error of the coefficients of a channel, relative to the norm of the first four coefficients. */
static double off(const sbl_probe *p, int channel, const field *f) {
    double worst = 0;
    int i;
    for (i = 0; i < 9; i++) worst = test_max(worst, fabs((double)p->sh[i][channel] - f->sh[i]) / norm_of(f));
    return worst;
}

/* Returns the largest error of the six cube faces, relative to the brightest face. */
static double cube_off(const sbl_probe *p, int channel, const field *f) {
    double worst = 0, most = 0;
    int i;
    for (i = 0; i < 6; i++) most = fmax(most, f->cube[i]);
    for (i = 0; i < 6; i++) worst = test_max(worst, fabs((double)p->cube[i][channel] - f->cube[i]) / most);
    return worst;
}

/* Integrates a function of the direction over the sphere, at the centres of 400 x 800 cells. */
static void around(field *f, double (*radiance)(const double d[3])) {
    int i, j;
    memset(f, 0, sizeof *f);
    for (i = 0; i < 400; i++)
        for (j = 0; j < 800; j++) {
            const double z = -1 + (i + 0.5) / 200, phi = 2 * pi * (j + 0.5) / 800, r = sqrt(1 - z * z);
            const double d[3] = { r * cos(phi), r * sin(phi), z };
            shine(f, radiance(d) * 4 * pi / (400 * 800), d[0], d[1], d[2]);
        }
}

/* Integrates a lamp that emits to both sides, as seen from the origin, at the centres of 500 x 500 cells. a: a corner;
   u, v: its edges. Only cells with x < keep count. */
static void rectangle(field *f, const double a[3], const double u[3], const double v[3], double radiance, double keep) {
    const double n[3] = { u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0] };
    int i, j, k;
    memset(f, 0, sizeof *f);
    for (i = 0; i < 500; i++)
        for (j = 0; j < 500; j++) {
            double p[3], r2 = 0, cosine = 0, r;
            for (k = 0; k < 3; k++) {
                p[k] = a[k] + (i + 0.5) / 500 * u[k] + (j + 0.5) / 500 * v[k];
                r2 += p[k] * p[k];
                cosine += p[k] * n[k];
            }
            r = sqrt(r2);
            if (p[0] < keep) shine(f, radiance * fabs(cosine) / r / r2 / 250000, p[0] / r, p[1] / r, p[2] / r);
        }
}

/* >>light of probes */

/* Under a constant sky, harmonics and cube have their closed forms with both back ends. */
TEST(a_uniform_sky) {
    static test_scene s;
    int backend, i, k;
    memset(&s, 0, sizeof s);
    scene_sky(&s, 1, 0.5f, 0.25f);
    REQUIRE(use_scene(&s), "no scene");
    for (backend = SBL_BACKEND_RASTER; backend <= SBL_BACKEND_TRACE; backend++) {
        const float at[3] = { 3, 4, 5 };
        sbl_probe p;
        sbl_probes_desc desc = probes_of(at, &p, 1);
        double worst = 0;
        desc.options.backend = (sbl_backend)backend;
        desc.options.mode = backend == SBL_BACKEND_TRACE ? SBL_MODE_GI : SBL_MODE_DIRECT;
        bake(&desc);
        for (i = 0; i < 9; i++)
            for (k = 0; k < 3; k++)
                worst = test_max(worst, fabs((double)p.sh[i][k] / s.sky[k] - (i ? 0 : sqrt(4 * pi))) / sqrt(4 * pi));
        CHECK(worst < 1e-3, "back end %d: coefficients are off by %g", backend, worst);
        for (worst = 0, i = 0; i < 6; i++)
            for (k = 0; k < 3; k++) worst = test_max(worst, fabs((double)p.cube[i][k] / s.sky[k] - 1));
        CHECK(worst < 1e-3, "back end %d: the cube is off by %g", backend, worst);
        CHECK(p.sky == 1 && p.back_share == 0 && p.valid == 1 && p.distance[3] == 0 && p.distance_squared[3] == 0,
              "sky %g, back %g, valid %d, distance %g",
              (double)p.sky, (double)p.back_share, p.valid, (double)p.distance[3]);
        CHECK(p.position[0] == 3 && p.position[1] == 4 && p.position[2] == 5, "the probe is at another position");
    }
    scene_free(&s);
}

static double gradient(const double d[3]) {
    return 1 + 0.5 * d[1] - 0.3 * d[0] + 0.2 * d[0] * d[2] + 0.4 * d[1] * d[1] - 0.3 * d[0] * d[1] + 0.1 * d[2] * d[2] *
        d[2];
}
static double with_a_sun(const double d[3]) {
    return gradient(d) + 12 * exp(20 * (0.6 * d[0] + 0.64 * d[1] + 0.48 * d[2] - 1));
}

static void sky_of(const float direction[3], float radiance[3], void *user) {
    const double d[3] = { (double)direction[0], (double)direction[1], (double)direction[2] };
    (void)user;
    radiance[0] = (float)gradient(d);
    radiance[1] = (float)with_a_sun(d);
    radiance[2] = 0.5f;
}

/* Sky callbacks with a gradient and with a sun agree with a sum over directions. */
TEST(skies_with_pictures) {
    static test_scene s;
    static double (*const functions[2])(const double d[3]) = { gradient, with_a_sun };
    static const char *const names[2] = { "gradient", "sun" };
    sbl_probe p;
    field f;
    int k;
    memset(&s, 0, sizeof s);
    s.environment.radiance = sky_of;
    REQUIRE(use_scene(&s), "no scene");
    p = probe_at(0, 0, 0, SBL_MODE_DIRECT);
    for (k = 0; k < 2; k++) {
        around(&f, functions[k]);
        CHECK(off(&p, k, &f) < (k ? 0.01 : 0.005), "%s: off by %g", names[k], off(&p, k, &f));
        CHECK(cube_off(&p, k, &f) < (k ? 0.015 : 0.005), "%s: the cube is off by %g", names[k], cube_off(&p, k, &f));
        printf("  %s: %.3f %%, cube %.3f %%\n", names[k], 100 * off(&p, k, &f), 100 * cube_off(&p, k, &f));
    }
    scene_free(&s);
}

/* The light of a rectangular lamp agrees with an integral over its area, both unoccluded and partly hidden by a
   wall. */
TEST(a_rectangular_lamp) {
    static const double a[3] = { -0.4, 1.1, 0.3 }, u[3] = { 1.2, 0.2, 0 }, v[3] = { -0.1, 0.3, 0.8 };
    int backend, hidden;
    for (hidden = 0; hidden < 2; hidden++)
        for (backend = SBL_BACKEND_RASTER; backend <= SBL_BACKEND_TRACE; backend++) {
            static test_scene s;
            const float at[3] = { 7, 8, 9 };
            const double most = hidden ? 0.012 : backend == SBL_BACKEND_RASTER ? 0.01 : 0.005;
            sbl_probe p;
            sbl_probes_desc desc = probes_of(at, &p, 1);
            field f;
            float c[12];
            int i, k;
            memset(&s, 0, sizeof s);
            for (i = 0; i < 4; i++)
                for (k = 0; k < 3; k++)
                    c[3 * i + k] = (float)((double)at[k] + a[k] + (i == 1 || i == 2) * u[k] + (i > 1) * v[k]);
            scene_quad_uv(&s, scene_lamp(&s, 1, 5, 25), c, 1, 1);
            /* The wall is close to the lamp, ends above the probe, and hides the part of the lamp with x > 0. The edge
               of the wall needs many rays. */
            if (hidden)
                scene_quad(&s, scene_material(&s, 0, 0, 0), 7, 8.01f, 8, 7, 8.01f, 10.5f, 9, 8.01f, 10.5f, 9, 8.01f, 8);
            REQUIRE(use_scene(&s), "no scene");
            desc.options.backend = (sbl_backend)backend;
            if (hidden) desc.options.rays = 16384;
            rectangle(&f, a, u, v, 5, hidden ? 0 : 10);
            bake(&desc);
            CHECK(off(&p, 1, &f) < most, "back end %d, hidden %d: off by %g", backend, hidden, off(&p, 1, &f));
            CHECK(cube_off(&p, 1, &f) < (hidden ? 0.02 : 1e-3), "back end %d, hidden %d: the cube is off by %g",
                  backend, hidden, cube_off(&p, 1, &f));
            CHECK(fabsf(p.sh[0][2] / p.sh[0][0] - 25) < 1e-2f, "the blue coefficient is %g, the red one %g",
                  (double)p.sh[0][2],
                  (double)p.sh[0][0]);
            printf("  %s, %s: %.3f %%, cube %.3f %%\n", backend == SBL_BACKEND_RASTER ? "views" : "rays",
                   hidden ? "half hidden" : "open", 100 * off(&p, 1, &f),
                   100 * cube_off(&p, 1, &f));
            scene_free(&s);
        }
}

/* Tests a point light, a sphere, a sun and a spot in random directions. The harmonics of a cone of light are those of
   its axis, multiplied by 2 pi and the integral of the Legendre polynomial over the cone. */
TEST(points_spheres_and_suns) {
    static const sbl_light_kind kinds[4] = { SBL_LIGHT_POINT, SBL_LIGHT_POINT, SBL_LIGHT_DIRECTIONAL, SBL_LIGHT_SPOT };
    static const char *const names[4] = { "point", "sphere", "sun", "spot" };
    uint64_t seed = 3;
    int kind, run, i;
    for (kind = 0; kind < 4; kind++) {
        double worst = 0, worst_cube = 0;
        for (run = 0; run < 24; run++) {
            static test_scene s;
            const double z = run == 0 ? 1 : run == 1 ? 0 : 2 * ref_random(&seed) - 1, phi = run ==
                1 ? 0 : 2 * pi * ref_random(&seed), r = sqrt(1 - z * z);
            const double d[3] = { r * cos(phi), r * sin(phi), z }, distance = 2, radius = 1,
                c = sqrt(1 - radius * radius / distance / distance);
            const double bands[3] = { 1 - c, (1 - c * c) / 2, (c - c * c * c) / 2 };
            sbl_light *light;
            sbl_probe p;
            field f;
            memset(&s, 0, sizeof s);
            memset(&f, 0, sizeof f);
            light = scene_light(&s, kinds[kind], 3, 3, 3);
            for (i = 0; i < 3; i++) light->position[i] = (float)(distance * d[i]);
            for (i = 0; i < 3; i++) light->direction[i] = (float)-d[i];
            if (kind == 1) light->radius = (float)radius;
            REQUIRE(use_scene(&s), "no scene");
            p = probe_at(0, 0, 0, SBL_MODE_DIRECT);
            shine(&f, kind == 2 ? 3 : 3 / distance / distance, d[0], d[1], d[2]);
            if (kind == 1) {
                double y9[9];
                basis(d[0], d[1], d[2], y9);
                for (i = 0; i < 9; i++)
                    f.sh[i] = y9[i] * 3 / (pi * radius * radius) * 2 * pi * bands[i == 0 ? 0 : i < 4 ? 1 : 2];
            } else worst_cube = test_max(worst_cube, cube_off(&p, 0, &f));
            worst = test_max(worst, off(&p, 0, &f));
            scene_free(&s);
        }
        CHECK(worst < 0.005, "%s: off by %g", names[kind], worst);
        CHECK(worst_cube < 1e-3, "%s: the cube is off by %g", names[kind], worst_cube);
        printf("  %s: %.3f %% at most\n", names[kind], 100 * worst);
    }
}

/* In a closed box with uniform emission and albedo, the radiance in all directions is emission / (1 - albedo). */
TEST(a_furnace) {
    int backend;
    for (backend = SBL_BACKEND_RASTER; backend <= SBL_BACKEND_TRACE; backend++) {
        static test_scene s;
        const float at[3] = { 0.2f, -0.3f, 0.4f };
        sbl_probe p;
        sbl_probes_desc desc = probes_of(at, &p, 1);
        double worst = 0, worst_cube = 0;
        int m, i;
        memset(&s, 0, sizeof s);
        m = scene_material(&s, 0.5f, 0.5f, 0.5f);
        for (i = 0; i < 3; i++) s.materials[m].emission[i] = 1;
        scene_box(&s, m, -1, -1, -1, 1, 1, 1);
        REQUIRE(use_scene(&s), "no scene");
        desc.options.mode = SBL_MODE_GI;
        desc.options.backend = (sbl_backend)backend;
        bake(&desc);
        for (i = 0; i < 9; i++)
            worst = test_max(worst, fabs((double)p.sh[i][0] / 2 - (i ? 0 : sqrt(4 * pi))) / sqrt(4 * pi));
        for (i = 0; i < 6; i++) worst_cube = test_max(worst_cube, fabs((double)p.cube[i][1] / 2 - 1));
        CHECK(worst < 0.005, "back end %d: off by %g", backend, worst);
        CHECK(worst_cube < 0.005, "back end %d: the cube is off by %g", backend, worst_cube);
        CHECK(p.sky == 0 && p.back_share == 1 && !p.valid, "seen from behind, the walls give sky %g, back_share %g",
              (double)p.sky,
              (double)p.back_share);
        printf("  %s: %.3f %%, cube %.3f %%\n", backend == SBL_BACKEND_RASTER ? "views" : "rays", 100 * worst,
               100 * worst_cube);
        scene_free(&s);
    }
}

static double half_below(const double d[3]) { return d[1] < 0 ? 0.5 : 0; }

/* A large floor under a vertical sun reflects a radiance of 0.5 in all directions. In SBL_MODE_DIRECT only lamps give
   light to a probe, and the floor gives none. */
TEST(what_a_floor_reflects) {
    static test_scene s;
    static const sbl_mode modes[3] = { SBL_MODE_GI, SBL_MODE_DIRECT, SBL_MODE_AMBIENT };
    sbl_light *sun;
    sbl_probe p;
    field f;
    int i;
    memset(&s, 0, sizeof s);
    scene_floor(&s, scene_material(&s, 0.5f, 0.5f, 0.5f), 0, 2000);
    sun = scene_light(&s, SBL_LIGHT_DIRECTIONAL, (float)pi, (float)pi, (float)pi);
    sun->direction[1] = -1;
    REQUIRE(use_scene(&s), "no scene");
    for (i = 0; i < 3; i++) {
        const double share = i == 0 ? 1 : i == 1 ? 0 : 0.02;
        field below;
        int k;
        p = probe_at(1, 1, 1, modes[i]);
        memset(&f, 0, sizeof f);
        shine(&f, pi, 0, 1, 0);
        around(&below, half_below);
        for (k = 0; k < 9; k++) f.sh[k] += share * below.sh[k];
        for (k = 0; k < 6; k++) f.cube[k] += share * below.cube[k];
        CHECK(off(&p, 2, &f) < 0.005, "mode %d: off by %g", (int)modes[i], off(&p, 2, &f));
        CHECK(cube_off(&p, 2, &f) < 0.005, "mode %d: the cube is off by %g", (int)modes[i], cube_off(&p, 2, &f));
        CHECK(fabs((double)p.sky - 0.5) < 2e-3 && p.back_share == 0 && p.valid, "sky %g, back %g", (double)p.sky,
              (double)p.back_share);
    }
    scene_free(&s);
}

/* >>distances and sky visibility */

/* Returns the distance from a point in a box to the face that direction d meets. side: receives the index of the face,
   as in sbl_probe.cube. */
static double box_distance(const double at[3], const double low[3], const double high[3], const double d[3],
                           int *side) {
    double least = HUGE_VAL;
    int k;
    for (k = 0; k < 3; k++) {
        const double t = d[k] > 0 ? (high[k] - at[k]) / d[k] : d[k] < 0 ? (low[k] - at[k]) / d[k] : HUGE_VAL;
        if (t < least) { least = t; *side = 2 * k + (d[k] < 0); }
    }
    return least;
}

/* Distances and sky visibility in a box with three different edge lengths agree with sums over directions, both closed
   and without its upper face. */
TEST(distances_in_a_box) {
    static const double low[3] = { -1, -2, -0.5 }, high[3] = { 3, 1, 2 }, at[3] = { 0.3, 0.2, 0.4 };
    int open, i, j, o;
    for (open = 0; open < 2; open++) {
        static test_scene s;
        sbl_probe p;
        double mean[8], square[8], weight[8], worst = 0, sky = 0;
        memset(&s, 0, sizeof s);
        memset(mean, 0, sizeof mean);
        memset(square, 0, sizeof square);
        memset(weight, 0, sizeof weight);
        scene_box(&s, scene_material(&s, 0, 0, 0), -1, -2, -0.5f, 3, 1, 2);
        if (open) s.meshes[3] = s.meshes[2];  /* removes the face y = 1 */
        REQUIRE(use_scene(&s), "no scene");
        p = probe_at((float)at[0], (float)at[1], (float)at[2], SBL_MODE_DIRECT);
        for (i = 0; i < 400; i++)
            for (j = 0; j < 800; j++) {
                const double z = -1 + (i + 0.5) / 200, phi = 2 * pi * (j + 0.5) / 800, r = sqrt(1 - z * z);
                const double d[3] = { r * cos(phi), r * sin(phi), z };
                int side = 0;
                const double t = box_distance(at, low, high, d, &side);
                if (open && side == 2) { sky += 1 / 320000.0; continue; }
                for (o = 0; o < 8; o++) {
                    const double w = fmax(0, (d[0] * (o & 1 ? 1 : -1) + d[1] * (o & 2 ? 1 : -1) + d[2] *
                                              (o & 4 ? 1 : -1)));
                    weight[o] += w;
                    mean[o] += w * t;
                    square[o] += w * t * t;
                }
            }
        for (o = 0; o < 8; o++) {
            worst = test_max(worst, fabs((double)p.distance[o] * weight[o] / mean[o] - 1));
            worst = test_max(worst, fabs((double)p.distance_squared[o] * weight[o] / square[o] - 1));
        }
        CHECK(worst < 0.005, "open %d: off by %g", open, worst);
        CHECK(fabs((double)p.sky - sky) < 2e-3 && p.back_share == 1, "open %d: sky %g, expected %g; back %g", open,
              (double)p.sky, sky, (double)p.back_share);
        printf("  %s: %.3f %%\n", open ? "without a side" : "closed", 100 * worst);
        scene_free(&s);
    }
}

/* At the centre of a sphere, all distances equal the radius. */
TEST(distances_in_a_sphere) {
    static test_scene s;
    sbl_probe p;
    int o;
    memset(&s, 0, sizeof s);
    scene_sphere(&s, scene_material(&s, 0, 0, 0), 1, 1, 1, 2, 64, 32, 0);
    REQUIRE(use_scene(&s), "no scene");
    p = probe_at(1, 1, 1, SBL_MODE_DIRECT);
    for (o = 0; o < 8; o++)
        CHECK(fabs((double)p.distance[o] - 2) < 0.012 && fabs((double)p.distance_squared[o] - 4) < 0.05,
              "octant %d: %g, %g", o, (double)p.distance[o],
              (double)p.distance_squared[o]);
    scene_free(&s);
}

/* >>probes inside of geometry */

/* A probe inside a closed or open cube is invalid. A probe outside, or in front of a single square, is valid. */
TEST(inside_and_outside) {
    static const float heights[2] = { 0.6f, 0.7f };
    static test_scene s;
    sbl_probe p;
    int i, m;
    memset(&s, 0, sizeof s);
    scene_box(&s, scene_material(&s, 0.5f, 0.5f, 0.5f), 0, 0, 0, 1, 1, 1);
    REQUIRE(use_scene(&s), "no scene");
    p = probe_at(0.5f, 0.3f, 0.6f, SBL_MODE_DIRECT);
    CHECK(!p.valid && p.back_share == 1 && p.sky == 0, "in a cube: valid %d, back %g", p.valid, (double)p.back_share);
    p = probe_at(0.5f, 0.3f, 1.01f, SBL_MODE_DIRECT);
    CHECK(p.valid && p.back_share == 0 && p.sky > 0.5f, "in front of a cube: valid %d, back %g", p.valid,
          (double)p.back_share);
    scene_free(&s);
    /* a cube with five faces: from its centre, a sixth of the sphere is sky */
    memset(&s, 0, sizeof s);
    scene_box(&s, scene_material(&s, 0.5f, 0.5f, 0.5f), 0, 0, 0, 1, 1, 1);
    s.meshes[3] = s.meshes[2];
    REQUIRE(use_scene(&s), "no scene");
    p = probe_at(0.5f, 0.5f, 0.5f, SBL_MODE_DIRECT);
    CHECK(!p.valid && p.back_share == 1 && fabs((double)p.sky - 1 / 6.0) < 2e-3, "in an open cube: valid %d, sky %g",
          p.valid, (double)p.sky);
    scene_free(&s);
    /* This is a one-sided square, seen from the front and from behind. It covers asin(1 / (1 + h^2)) / pi of the
       sphere, which is a quarter at h = 0.6436. A probe behind it is valid if it covers less than a quarter. */
    memset(&s, 0, sizeof s);
    m = scene_material(&s, 0.5f, 0.5f, 0.5f);
    scene_floor(&s, m, 0, 1);
    REQUIRE(use_scene(&s), "no scene");
    for (i = 0; i < 2; i++) {
        const double share = asin(1 / (1 + (double)heights[i] * (double)heights[i])) / pi;
        p = probe_at(0, heights[i], 0, SBL_MODE_DIRECT);
        CHECK(p.valid && p.back_share == 0 && fabs((double)p.sky - 1 + share) < 3e-3,
              "in front: valid %d, sky %g, share %g", p.valid, (double)p.sky, share);
        p = probe_at(0, -heights[i], 0, SBL_MODE_DIRECT);
        CHECK(p.valid == i && p.back_share == 1 && fabs((double)p.sky - 1 + share) < 3e-3,
              "%g behind: valid %d, sky %g, share %g", (double)heights[i], p.valid,
              (double)p.sky, share);
    }
    scene_free(&s);
}

static int inside_unit(const float p[3]) {
    return p[0] > 0 && p[0] < 1 && p[1] > 0 && p[1] < 1 && p[2] > 0 && p[2] < 1;
}
static double apart(const float a[3], const float b[3]) {
    const double x = (double)a[0] - (double)b[0], y = (double)a[1] - (double)b[1], z = (double)a[2] - (double)b[2];
    return sqrt(x * x + y * y + z * z);
}

/* Probes inside a cube are moved out of it, by at most `move`, and not into the adjacent cube. Their light must equal
   that of probes placed at their new positions. */
TEST(moving_out) {
    static const float at[9] = { 0.8f, 0.5f, 0.55f, 3, 3, 3, 0.5f, 0.5f, 0.7f };
    float there[9];
    static test_scene s;
    sbl_probe still[3], moved[3], again[3], parts[3];
    sbl_probes_desc desc = probes_of(at, still, 3);
    sbl_scene_desc grouped;
    int blocked, i;
    for (blocked = 0; blocked < 2; blocked++) {
        memset(&s, 0, sizeof s);
        scene_box(&s, scene_material(&s, 0.5f, 0.5f, 0.5f), 0, 0, 0, 1, 1, 1);
        if (blocked) scene_box(&s, 0, 1.001f, -1, -1, 3, 2, 2);
        scene_sky(&s, 1, 2, 3);
        REQUIRE(use_scene(&s), "no scene");
        desc = probes_of(at, still, 3);
        bake(&desc);
        CHECK(!still[0].valid && still[1].valid && !still[2].valid && sbl_query_stats(context).sensors.invalid == 2,
              "probes moved although move is 0");
        desc.probes = moved;
        desc.move = blocked ? 0.7f : 0.4f;
        bake(&desc);
        CHECK(sbl_query_stats(context).sensors.invalid == 0, "%d probes are still inside",
              (int)sbl_query_stats(context).sensors.invalid);
        CHECK(sbl_query_stats(context).sensors.sites >= 5 + blocked, "sensors.sites is %d",
              (int)sbl_query_stats(context).sensors.sites);
        CHECK(memcmp(&moved[1], &still[1], sizeof *moved) == 0, "a valid probe was moved");
        for (i = 0; i < 3; i += 2) {
            const float *p = moved[i].position;
            CHECK(moved[i].valid && !inside_unit(p) && apart(p, at + 3 * i) <= (double)desc.move * 1.00001,
                  "the probe is at %g %g %g, %g from its place", (double)p[0],
                  (double)p[1], (double)p[2], apart(p, at + 3 * i));
            CHECK(blocked ? p[0] < 1 : i == 0 ? p[0] > 1 : p[2] > 1,
                  "blocked %d: the probe moved in a wrong direction: %g %g %g",
                  blocked, (double)p[0], (double)p[1], (double)p[2]);
        }
        if (!blocked)
            CHECK(apart(moved[0].position, at) < 0.2 * 1.1 + 0.4 / 8, "the probe was moved by %g",
                  apart(moved[0].position, at));
        for (i = 0; i < 3; i++) memcpy(there + 3 * i, moved[i].position, 3 * sizeof(float));
        desc.positions = there;
        desc.probes = again;
        bake(&desc);
        CHECK(memcmp(again, moved, sizeof again) == 0, "the light differs from that of a probe at the new position");
        desc = probes_of(at, moved, 3);
        desc.move = 0.15f;
        bake(&desc);
        CHECK(memcmp(moved, still, sizeof moved) == 0, "a probe that cannot get out was changed");
        desc.move = 0.22f;  /* the first probe is 0.2 from a side; an eighth of 0.22 beyond it would be too far */
        bake(&desc);
        CHECK((blocked || moved[0].valid) && apart(moved[0].position, at) <= 0.22001 && !moved[2].valid,
              "probe 0: valid %d, moved by %g; probe 2: valid %d", moved[0].valid, apart(moved[0].position, at),
              moved[2].valid);
        grouped = scene_desc(&s);
        grouped.light_groups = 1;
        REQUIRE(sbl_set_scene(context, &grouped) == SBL_SUCCESS, "%s", watch_last(&seen));
        memset(parts, 0, sizeof parts);
        desc.move = 0.7f;
        desc.groups = parts;
        bake(&desc);
        for (i = 0; i < 3; i++)
            CHECK(moved[i].valid && !memcmp(parts[i].position, moved[i].position, sizeof parts[i].position) &&
                      fabs((double)parts[i].sh[0][1] / (double)moved[i].sh[0][1] - 1) < 1e-5,
                  "probe %d: %g, its light group %g", i, (double)moved[i].sh[0][1], (double)parts[i].sh[0][1]);
        scene_free(&s);
    }
}

/* >>checks of the descriptor */

/* The probes of a grid are in order, with x varying fastest, and have the same light as a list of the same
   positions. */
TEST(grids_in_order) {
    static test_scene s;
    static const float low[3] = { -1, 0, 2 }, high[3] = { 5, 1, 10 };
    static const int sizes[3] = { 3, 2, 4 };
    sbl_probe probes[24], listed[24];
    float at[72];
    sbl_probes_desc desc;
    int bounds, i;
    memset(&s, 0, sizeof s);
    scene_box(&s, scene_material(&s, 0.5f, 0.5f, 0.5f), -1, 0, 2, 5, 1, 10);
    scene_sky(&s, 1, 1, 1);
    REQUIRE(use_scene(&s), "no scene");
    for (bounds = 0; bounds < 2; bounds++) {
        double worst = 0;
        desc = probes_of(NULL, probes, 24);
        memcpy(desc.grid, sizes, sizeof desc.grid);
        for (i = 0; i < 3 && !bounds; i++) { desc.lowest[i] = 2 * low[i]; desc.highest[i] = 2 * high[i]; }
        bake(&desc);
        for (i = 0; i < 24; i++) {
            const int n[3] = { i % 3, i / 3 % 2, i / 6 };
            int k;
            for (k = 0; k < 3; k++) {
                const double is = ((double)low[k] + (n[k] + 0.5) / sizes[k] * ((double)high[k] - (double)low[k])) *
                    (bounds ? 1 : 2);
                worst = test_max(worst, fabs((double)probes[i].position[k] - is));
                at[3 * i + k] = probes[i].position[k];
            }
        }
        CHECK(worst < 1e-5, "bounds %d: off by %g", bounds, worst);
        desc = probes_of(at, listed, 24);
        bake(&desc);
        CHECK(memcmp(probes, listed, sizeof probes) == 0, "bounds %d: a list of the same positions has other light",
              bounds);
        desc = probes_of(NULL, listed, 24);
        memcpy(desc.grid, sizes, sizeof desc.grid);
        for (i = 0; i < 3 && !bounds; i++) { desc.lowest[i] = 2 * low[i]; desc.highest[i] = 2 * high[i]; }
        memset(listed, 0, sizeof listed);
        desc.probe_count = 0;
        CHECK(sbl_bake_probes(context, &desc) == SBL_SUCCESS && memcmp(probes, listed, sizeof probes) == 0,
              "the default of probe_count is not the size of the grid");
    }
    desc = probes_of(NULL, probes, 1);  /* a box that begins at the origin */
    for (i = 0; i < 3; i++) { desc.grid[i] = 1; desc.highest[i] = 2; }
    bake(&desc);
    for (i = 0; i < 3; i++)
        CHECK(fabs((double)probes[0].position[i] - 1) < 1e-6, "position[%d] is %g", i, (double)probes[0].position[i]);
    scene_free(&s);
}

static void refused(sbl_probes_desc desc, const char *word) {
    const sbl_result result = sbl_begin_probes(context, &desc);
    CHECK(result == SBL_ERROR_INVALID_ARGUMENT, "%s: %s", word, sbl_result_string(result));
    CHECK(watch_said(&seen, SBL_LOG_ERROR, SBL_LOG_ITEM_INVALID_PROBES_DESC, "sbl_probes_desc", word, NULL) ||
          watch_said(&seen, SBL_LOG_ERROR, SBL_LOG_ITEM_INVALID_PROBES_DESC, word, NULL, NULL), "%s: %s", word,
              watch_last(&seen));
    watch_forget(&seen);
}

/* Invalid values of every field of sbl_probes_desc are refused. The message names the field and the value. */
TEST(every_field_is_checked) {
    static test_scene s;
    float at[60] = { 0 };
    sbl_probe probes[20];
    const sbl_context_desc watched = watch_desc(&seen);
    const sbl_probes_desc good = probes_of(at, probes, 20);
    sbl_probes_desc d, grid = probes_of(NULL, probes, 8);
    sbl_context *empty = NULL;
    int i;
    memset(&s, 0, sizeof s);
    memset(probes, 0x5a, sizeof probes);
    scene_floor(&s, scene_material(&s, 0.5f, 0.5f, 0.5f), 0, 1);
    REQUIRE(use_scene(&s), "no context");
    for (i = 0; i < 3; i++) grid.grid[i] = 2;
    d = good; d.start_canary = 1; refused(d, "start_canary");
    d = good; d.end_canary = 1; refused(d, "end_canary");
    d = good; d.probes = NULL; refused(d, "probes is NULL");
    d = good; d.probe_count = -1; refused(d, "probe_count is -1");
    d = good; d.positions = NULL; refused(d, "no grid");
    d.probe_count = 0; refused(d, "positions is NULL, and there is no grid");
    d.probes = NULL; refused(d, "no grid");
    d.positions = at; CHECK(sbl_bake_probes(context, &d) == SBL_SUCCESS, "an empty list: %s", watch_last(&seen));
    d = good; d.options.mode = SBL_MODE_PAPER; refused(d, "SBL_MODE_PAPER");
    d = good; d.options.mode = (sbl_mode)99; refused(d, "options.mode");
    d = good; d.options.preset = (sbl_preset)-1; refused(d, "options.preset");
    d = good; d.options.backend = (sbl_backend)77; refused(d, "options.backend");
    d = good; d.options.rays = 63; refused(d, "options.rays is 63");
    d = good; d.options.rays = 65537; refused(d, "options.rays is 65537");
    d = good; d.options.rays = -5; refused(d, "options.rays is -5");
    d = good; d.options.sensor_size = 3; refused(d, "options.sensor_size");
    d = good; d.options.epsilon = (float)NAN; d.options.mode = SBL_MODE_AMBIENT; refused(d, "options.epsilon");
    d = good; d.move = -1; refused(d, "move is -1");
    d = good; d.move = (float)NAN; refused(d, "move");
    d = good; d.move = (float)INFINITY; refused(d, "move");
    d = grid; d.probe_count = 9; refused(d, "the grid has 8");
    d = grid; d.first_probe = 1; refused(d, "probe_count is 8; the grid has 7 points from first_probe on");
    d = grid; d.first_probe = 8; d.probe_count = 0; refused(d, "first_probe is 8; the grid has 8");
    d = grid; d.first_probe = INT_MAX; refused(d, "the grid has 8");
    d = grid; d.first_probe = -1; refused(d, "first_probe is -1");
    d = grid; d.first_probe = INT_MIN; d.probe_count = 0; refused(d, "cannot be negative");
    d = good; d.first_probe = -1; refused(d, "first_probe is -1");
    d = good; d.first_probe = INT_MAX - 19; refused(d, "the numbers of probes exceed 2147483647");
    d = grid; d.grid[1] = 0; refused(d, "grid[1] is 0");
    d = grid; d.grid[2] = -2; refused(d, "grid[2] is -2");
    d = grid; d.grid[0] = 16385; refused(d, "grid[0] is 16385");
    d = grid; d.grid[0] = d.grid[1] = d.grid[2] = 16384; d.probe_count = 0; refused(d, "more points");
    d = grid; d.lowest[1] = (float)NAN; refused(d, "lowest[1]");
    d = grid; d.highest[2] = (float)INFINITY; refused(d, "highest[2]");
    d = grid; d.lowest[1] = 1; refused(d, "lowest[1] is 1");
    d = grid; d.probes = NULL; refused(d, "probes is NULL");
    at[4] = (float)NAN; refused(good, "probe 1: position[1]");
    scene_free(&s);
    for (i = 0; i < 60; i++) at[i] = (float)INFINITY;
    d = good;
    CHECK(sbl_begin_probes(context, &d) == SBL_ERROR_INVALID_ARGUMENT &&
          watch_said(&seen, SBL_LOG_ERROR, SBL_LOG_ITEM_INVALID_PROBES_DESC, "4 more probes", NULL, NULL),
          "%s", watch_last(&seen));
    memset(at, 0, sizeof at);
    for (i = 0; i < (int)sizeof probes; i++) if (((unsigned char *)probes)[i] != 0x5a) break;
    CHECK(i == (int)sizeof probes, "a refused call wrote to the probes");
    CHECK(sbl_begin_probes(NULL, &good) == SBL_ERROR_INVALID_ARGUMENT && sbl_bake_probes(NULL, NULL) ==
          SBL_ERROR_INVALID_ARGUMENT, "NULL is accepted");
    CHECK(sbl_bake_probes(context, NULL) == SBL_ERROR_INVALID_ARGUMENT, "a NULL descriptor, without a grid, succeeds");
    CHECK(sbl_create(&watched, &empty) == SBL_SUCCESS && sbl_bake_probes(empty, &good) == SBL_ERROR_STATE,
          "probes are begun without a scene");
    sbl_destroy(empty);
    d = sbl_probes_desc_defaults(NULL);
    CHECK(d.options.rays == 4096 && d.options.sensor_size == 16 && d.options.mode == SBL_MODE_GI &&
              d.probe_count == 0 && d.move == 0 && d.options.epsilon == 0,
          "rays %d, size %d", d.options.rays, d.options.sensor_size);
    d = sbl_probes_desc_defaults(&grid);
    CHECK(d.probe_count == 8, "probe_count %d", d.probe_count);
    grid.first_probe = 3;
    grid.probe_count = 0;
    d = sbl_probes_desc_defaults(&grid);
    CHECK(d.probe_count == 5, "probe_count %d", d.probe_count);
}

/* >>parts of grids and lists */

/* Bakes all probes of desc.grid or desc.positions, then parts of these sizes, and checks that both have the same
   bits. */
static void bake_parts(sbl_probes_desc desc, sbl_probe *whole, int count, const int *sizes) {
    sbl_probe *parts = (sbl_probe *)malloc((size_t)count * sizeof *parts);
    const float *positions = desc.positions;
    int first = 0, i, different = 0, failed = 0;
    if (!parts) abort();
    desc.probes = whole;
    desc.probe_count = count;
    bake(&desc);
    memset(parts, 0xff, (size_t)count * sizeof *parts);
    for (i = 0; first < count; first += sizes[i++]) {
        desc.first_probe = first;
        desc.probe_count = positions || sizes[i] < count - first ? sizes[i] : 0;  /* 0: all remaining probes */
        desc.probes = parts + first;
        if (positions) desc.positions = positions + 3 * first;
        failed += sbl_bake_probes(context, &desc) != SBL_SUCCESS;
    }
    for (i = 0; i < count; i++) different += memcmp(&parts[i], &whole[i], sizeof *parts) != 0;
    CHECK(!failed && !different, "%s: %d of %d probes differ, %d parts failed: %s", positions ? "positions" : "grid",
          different, count, failed, watch_last(&seen));
    free(parts);
}

/* Parts of a grid and of a list have the same bits as the complete bake, also if probes are moved. */
TEST(parts_are_the_whole) {
    enum { WHOLE = 6 * 5 * 5 };
    static const int grid[3] = { 6, 5, 5 }, sizes[5] = { 1, 130, 4, 14, 1 };
    static float at[3 * WHOLE];
    static sbl_probe whole[WHOLE];
    static test_scene s;
    sbl_probes_desc desc = probes_of(NULL, NULL, 0);
    int i, moved = 0;
    memset(&s, 0, sizeof s);
    scene_cornell_box(&s);
    REQUIRE(use_scene(&s), "no scene");
    desc.options.mode = SBL_MODE_GI;
    desc.options.rays = 128;
    memcpy(desc.grid, grid, sizeof desc.grid);
    bake_parts(desc, whole, WHOLE, sizes);
    for (i = 0; i < WHOLE; i++) memcpy(at + 3 * i, whole[i].position, sizeof whole[i].position);
    desc.move = 150;
    bake_parts(desc, whole, WHOLE, sizes);
    for (i = 0; i < WHOLE; i++) moved += apart(whole[i].position, at + 3 * i) > 0;
    CHECK(moved > 5, "%d probes were moved", moved);
    desc.positions = at;
    bake_parts(desc, whole, WHOLE, sizes);
    desc.probes = whole;
    desc.probe_count = 2;
    desc.first_probe = INT_MAX - 2;
    bake(&desc);
    CHECK(whole[1].sh[0][0] > 0, "the last numbers have no light");
    scene_free(&s);
}

/* >>time slices and cancelling */

enum { MANY = 150 };

/* Chooses positions in and around the Cornell box, some of them inside its blocks. */
static void many_places(float *at) {
    int i;
    for (i = 0; i < MANY; i++) {
        at[3 * i] = (float)(-50 + 660 * fmod(0.5 + i * 0.8191725133961645, 1));
        at[3 * i + 1] = (float)(5 + 540 * fmod(0.5 + i * 0.6710436067037893, 1));
        at[3 * i + 2] = (float)(5 + 550 * fmod(0.5 + i * 0.5497004779019703, 1));
    }
}

static int stops_at(float done, void *user) { return done >= *(float *)user; }

/* A bake in time slices, with other batch sizes, while a picture is made, and after abandoned bakes gives the same
   probes, to the bit. */
TEST(slices_cancel_and_end) {
    static float at[3 * MANY];
    static sbl_probe whole[MANY], now[MANY];
    static const double slices[2] = { 1e-9, 1e-3 };
    static test_scene s;
    sbl_context_desc watched = watch_desc(&seen);
    sbl_picture_desc view = scene_cornell_view(8, 8);
    sbl_probes_desc desc;
    sbl_scene_desc scene;
    sbl_sensor sensor;
    sbl_result result;
    float before, limit = 0.3f, pixels[8 * 8 * 3];
    int i, steps, moved = 0, looks = 0;
    memset(&s, 0, sizeof s);
    scene_cornell_box(&s);
    many_places(at);
    scene = scene_desc(&s);
    REQUIRE(use_scene(&s), "no scene");
    desc = probes_of(at, whole, MANY);
    desc.options.mode = SBL_MODE_GI;
    desc.options.rays = 120;
    desc.move = 100;
    bake(&desc);
    for (i = 0; i < MANY; i++) moved += apart(whole[i].position, at + 3 * i) > 0;
    CHECK(moved > 5 && moved < MANY / 2, "%d were moved", moved);
    CHECK(sbl_query_stats(context).sensors.sites >= MANY + moved &&
              sbl_query_stats(context).sensors.rays >= (int64_t)120 * MANY &&
              sbl_query_stats(context).backend == SBL_BACKEND_TRACE,
          "%d sensors, %d rays", (int)sbl_query_stats(context).sensors.sites,
          (int)sbl_query_stats(context).sensors.rays);
    CHECK(sbl_step(context, 0) == SBL_SUCCESS && sbl_progress(context) == 1,
          "sbl_step after the end fails, or progress is not 1");
    desc.probes = now;
    for (i = 0; i < 2; i++) {
        memset(now, 0, sizeof now);
        watched.batch = i ? 0 : 38;
        sbl_destroy(context);
        context = watch_context(&seen, &watched, &s);
        REQUIRE(context && sbl_begin_probes(context, &desc) == SBL_SUCCESS, "cannot begin");
        for (steps = 0, before = 0; (result = sbl_step(context, slices[i])) == SBL_UNFINISHED; steps++) {
            CHECK(sbl_progress(context) >= before && sbl_progress(context) <= 1, "progress decreases from %g to %g",
                  (double)before, (double)sbl_progress(context));
            before = sbl_progress(context);
        }
        CHECK(result == SBL_SUCCESS && memcmp(now, whole, sizeof now) == 0, "slices of %g s change probes: %s",
              slices[i], sbl_result_string(result));
        CHECK(steps > (i ? 20 : 100) && before > 0.5f, "slices of %g s: %d steps, progress before the last %g",
              slices[i], steps,
              (double)before);
    }
    desc.probe_count = 100;  /* the first probes do not depend on the total number */
    memset(now, 0, sizeof now);
    bake(&desc);
    CHECK(memcmp(now, whole, 100 * sizeof *now) == 0 && now[100].valid == 0 && now[100].sh[0][0] == 0,
          "the first probes change if there are fewer");
    desc.options.seed = 5;
    bake(&desc);
    CHECK(memcmp(now[0].sh, whole[0].sh, sizeof now[0].sh) != 0, "another seed changes nothing");
    desc.options.seed = 0;
    desc.probe_count = MANY;
    REQUIRE(sbl_render_picture(context, &view) == SBL_SUCCESS && sbl_begin_probes(context, &desc) == SBL_SUCCESS,
            "cannot begin");
    memset(now, 0, sizeof now);
    while ((result = sbl_step(context, 1e-9)) == SBL_UNFINISHED)
        if (looks < 20 && ++looks)
            CHECK(sbl_inspect_sensor(context, 4, 4, &sensor, NULL, NULL, 0) == SBL_SUCCESS, "%s", watch_last(&seen));
    CHECK(result == SBL_SUCCESS && memcmp(now, whole, sizeof now) == 0, "inspecting a sensor changes probes: %s",
          sbl_result_string(result));
    CHECK(sbl_read_channel(context, SBL_CHANNEL_FINAL, pixels, 8 * 8 * 3) == SBL_SUCCESS, "the picture is gone");
    desc.options.progress = stops_at;
    desc.options.progress_user = &limit;
    CHECK(sbl_begin_probes(context, &desc) == SBL_SUCCESS, "cannot begin");
    while ((result = sbl_step(context, 1e-4)) == SBL_UNFINISHED) {}
    CHECK(result == SBL_CANCELLED && sbl_step(context, 0) == SBL_ERROR_STATE, "not cancelled: %s",
          sbl_result_string(result));
    CHECK(sbl_read_channel(context, SBL_CHANNEL_FINAL, pixels, 8 * 8 * 3) == SBL_SUCCESS, "the picture is gone");
    desc.options.progress = NULL;
    CHECK(sbl_begin_probes(context, &desc) == SBL_SUCCESS && sbl_step(context, 1e-9) == SBL_UNFINISHED, "cannot begin");
    sbl_end(context);
    CHECK(sbl_step(context, 0) == SBL_ERROR_STATE && sbl_progress(context) == 0, "the ended bake continues");
    CHECK(sbl_begin_probes(context, &desc) == SBL_SUCCESS && sbl_step(context, 0.01) == SBL_UNFINISHED, "cannot begin");
    CHECK(sbl_set_scene(context, &scene) == SBL_SUCCESS && sbl_step(context, 0) == SBL_ERROR_STATE,
          "the bake continues after sbl_set_scene");
    CHECK(sbl_begin_probes(context, &desc) == SBL_SUCCESS && sbl_step(context, 1e-9) == SBL_UNFINISHED &&
              sbl_begin_picture(context, &view) == SBL_SUCCESS && sbl_step(context, 0) == SBL_SUCCESS,
          "a picture cannot replace the bake");
    memset(now, 0, sizeof now);
    bake(&desc);
    CHECK(memcmp(now, whole, sizeof now) == 0, "abandoned bakes change later probes");
    scene_free(&s);
}

/* The memory in use is that of one batch, however many probes are baked. All 4,000 probes have the expected light. */
TEST(many_probes) {
    enum { FEW = 256, HEAPS = 4000 };
    static test_scene s;
    static float at[3 * HEAPS];
    static sbl_probe probes[HEAPS];
    sbl_probes_desc desc = probes_of(at, probes, FEW);
    sbl_memory few, heaps;
    int i, wrong = 0;
    memset(&s, 0, sizeof s);
    scene_sky(&s, 1, 1, 1);
    scene_floor(&s, scene_material(&s, 0.5f, 0.5f, 0.5f), 0, 10);
    REQUIRE(use_scene(&s), "no scene");
    for (i = 0; i < 3 * HEAPS; i++) at[i] = 1 + 0.001f * (float)i;
    desc.options.rays = 64;
    bake(&desc);
    few = sbl_query_memory(context);
    desc.probe_count = HEAPS;
    bake(&desc);
    heaps = sbl_query_memory(context);
    CHECK(heaps.host_peak_bytes == few.host_peak_bytes && heaps.gpu_peak_bytes == few.gpu_peak_bytes,
          "memory grows: host from %.2f to %.2f MB, GPU from %.2f to %.2f MB",
          (double)few.host_peak_bytes / 1e6, (double)heaps.host_peak_bytes / 1e6, (double)few.gpu_peak_bytes / 1e6,
              (double)heaps.gpu_peak_bytes / 1e6);
    for (i = 0; i < HEAPS; i++)
        wrong += !(probes[i].valid && probes[i].sh[0][0] > 1 && probes[i].position[2] == at[3 * i + 2]);
    CHECK(wrong == 0, "%d probes are wrong", wrong);
    scene_free(&s);
}

static sbl_result probes_call(const void *desc) { return sbl_bake_probes(context, (const sbl_probes_desc *)desc); }

/* Each allocation fails once, in turn. The bake must fail with a message and without a leak, and the next bake must
   succeed. */
TEST(memory_runs_out) {
    enum { COUNT = 20 };
    static float at[3 * MANY];
    static sbl_probe whole[COUNT];
    static test_scene s;
    sbl_probes_desc desc;
    int refused;
    memset(&s, 0, sizeof s);
    scene_cornell_box(&s);
    many_places(at);
    REQUIRE(use_scene(&s), "no scene");
    desc = probes_of(at, whole, COUNT);
    desc.options.rays = 64;
    desc.move = 100;
    refused = each_allocation_fails(probes_call, &desc, &s, whole, sizeof whole);
    CHECK(refused > 10, "%d allocations were refused", refused);
    sbl_destroy(context);
    context = NULL;
    CHECK(seen.blocks == 0 && seen.strangers == 0, "%d blocks are not freed, %d were freed twice or never allocated",
          seen.blocks, seen.strangers);
    scene_free(&s);
}

/* Both back ends give the same light in the Cornell box, within 5 %. */
TEST(views_and_rays_agree) {
    static const float at[9] = { 278, 274, 280, 100, 400, 200, 450, 80, 80 };
    static test_scene s;
    sbl_probe probes[2][3];
    double worst = 0;
    int backend, i, k;
    memset(&s, 0, sizeof s);
    scene_cornell_box(&s);
    REQUIRE(use_scene(&s), "no scene");
    for (backend = 0; backend < 2; backend++) {
        sbl_probes_desc desc = probes_of(at, probes[backend], 3);
        desc.options.mode = SBL_MODE_GI;
        desc.options.backend = backend ? SBL_BACKEND_TRACE : SBL_BACKEND_RASTER;
        bake(&desc);
    }
    for (i = 0; i < 3; i++) {
        for (k = 0; k < 9; k++)
            worst = test_max(worst, fabs((double)probes[0][i].sh[k][0] - (double)probes[1][i].sh[k][0]) /
                             (double)probes[1][i].sh[0][0]);
        CHECK(memcmp(probes[0][i].distance, probes[1][i].distance, sizeof probes[0][i].distance) == 0 &&
              probes[0][i].sky == probes[1][i].sky, "back_share or sky differs");
    }
    CHECK(worst < 0.05, "the back ends differ by %g", worst);
    printf("  differ by %.2f %% of the mean at most\n", 100 * worst);
    scene_free(&s);
}

/* A probe whose light overflows is invalid and holds neither infinities nor NaN. Farther from the light, a probe is
   valid. */
TEST(light_that_overflows) {
    static test_scene s;
    static const float bare[27];
    sbl_probe p;
    memset(&s, 0, sizeof s);
    scene_light(&s, SBL_LIGHT_POINT, 3e38f, 1, 1)->position[0] = 1e-3f;
    REQUIRE(use_scene(&s), "no scene");
    p = probe_at(0, 0, 0, SBL_MODE_DIRECT);
    CHECK(!p.valid && p.sky == 1, "valid %d, sky %g", p.valid, (double)p.sky);
    CHECK(memcmp(p.sh, bare, sizeof p.sh) == 0 || p.sh[0][0] - p.sh[0][0] == 0, "%g", (double)p.sh[0][0]);
    p = probe_at(1e3f, 0, 0, SBL_MODE_DIRECT);
    CHECK(p.valid && p.sh[0][0] > 1e31f && p.sh[0][0] - p.sh[0][0] == 0, "far off: valid %d, %g", p.valid,
          (double)p.sh[0][0]);
    scene_free(&s);
}

static int calls_back(float done, void *user) {
    sbl_probe probe;
    const float at[3] = { 0, 0, 0 };
    const sbl_probes_desc desc = probes_of(at, &probe, 1);
    (void)done;
    *(int *)user += sbl_begin_probes(context, &desc) == SBL_ERROR_STATE && sbl_bake_probes(context, &desc) ==
        SBL_ERROR_STATE ? 1 : 1000;
    return 0;
}

/* Calls from the progress callback are refused, and the bake succeeds. */
TEST(callbacks_may_not_begin) {
    static test_scene s;
    static const float at[3] = { 0, 1, 0 };
    sbl_probe p;
    sbl_probes_desc desc = probes_of(at, &p, 1);
    int refusals = 0;
    memset(&s, 0, sizeof s);
    scene_sky(&s, 1, 1, 1);
    REQUIRE(use_scene(&s), "no scene");
    desc.options.progress = calls_back;
    desc.options.progress_user = &refusals;
    bake(&desc);
    CHECK(refusals > 3 && refusals < 1000 && p.valid, "%d", refusals);
    scene_free(&s);
}

static void nothing(const sbl_draw_view *view, void *user) { *(int *)user += view->kind == SBL_VIEW_SENSOR; }

/* If the host draws, probes use rasterised views: 132 normals, and four looks at each cube face with five views each.
   The result must equal the one without a draw callback. */
TEST(a_host_that_draws) {
    static const float at[3] = { 0, 1, 0 };
    static test_scene s;
    sbl_probe plain, drawn;
    sbl_probes_desc desc = probes_of(at, &plain, 1);
    sbl_scene_desc scene;
    double worst = 0;
    int views = 0, i;
    memset(&s, 0, sizeof s);
    scene_floor(&s, scene_lamp(&s, 1, 1, 1), 0, 3);
    scene_sky(&s, 2, 2, 2);
    REQUIRE(use_scene(&s), "no scene");
    desc.options.backend = SBL_BACKEND_RASTER;
    bake(&desc);
    scene = scene_desc(&s);
    scene.draw = nothing;
    scene.draw_user = &views;
    scene.draw_bounds[1][1] = 1;
    REQUIRE(sbl_set_scene(context, &scene) == SBL_SUCCESS, "%s", watch_last(&seen));
    desc.options.backend = SBL_BACKEND_TRACE;
    refused(desc, "SBL_BACKEND_TRACE");
    desc.options.backend = SBL_BACKEND_AUTO;
    desc.probes = &drawn;
    bake(&desc);
    CHECK(views == (132 + 24) * 5, "%d views", views);
    for (i = 0; i < 9; i++)
        worst = test_max(worst, fabs((double)plain.sh[i][0] - (double)drawn.sh[i][0]) / (double)plain.sh[0][0]);
    CHECK(worst < 1e-3 && sbl_query_stats(context).backend == SBL_BACKEND_RASTER, "off by %g", worst);
    scene_free(&s);
}

int main(void) {
    RUN(a_uniform_sky);
    RUN(skies_with_pictures);
    RUN(a_rectangular_lamp);
    RUN_UNSANITIZED(points_spheres_and_suns);
    RUN(a_furnace);
    RUN(what_a_floor_reflects);
    RUN(distances_in_a_box);
    RUN(distances_in_a_sphere);
    RUN(inside_and_outside);
    RUN(moving_out);
    RUN(grids_in_order);
    RUN(every_field_is_checked);
    RUN(parts_are_the_whole);
    RUN(slices_cancel_and_end);
    RUN(many_probes);
    RUN(memory_runs_out);
    RUN(views_and_rays_agree);
    RUN(light_that_overflows);
    RUN(callbacks_may_not_begin);
    RUN(a_host_that_draws);
    sbl_destroy(context);
    return test_report();
}
