/* Compares directional lightmaps with closed forms, and tests supersampled lightmaps with light that varies within a
   texel. */
#include "../sbl.h"
#include "support/test.h"
#include "support/scenes.h"
#include "support/reference.h"
#include "support/gl_watch.h"
#include "support/lightmap.h"

/* >>directional light */

/* Computes the four harmonics of a triangle of radiance 1 above the horizon. They follow from its solid angle (Van
   Oosterom and Strackee 1983), and from the integral of the direction over it, which is half the sum over its edges of
   the angle that the edge subtends times the normal of the plane of the edge (Lambert 1760). */
static void triangle_harmonics(v3 p, const v3 corners[3], double out[4]) {
    v3 c[3], sum = v3_of(0, 0, 0);
    double length[3], solid_angle;
    int k;
    for (k = 0; k < 3; k++) {
        c[k] = v3_sub(corners[k], p);
        length[k] = v3_length(c[k]);
    }
    solid_angle = 2 * atan2(v3_dot(c[0], v3_cross(c[1], c[2])),
                            length[0] * length[1] * length[2] + v3_dot(c[0], c[1]) * length[2] +
                            v3_dot(c[1], c[2]) * length[0] + v3_dot(c[2], c[0]) * length[1]);
    for (k = 0; k < 3; k++) {
        const v3 across = v3_cross(c[k], c[(k + 1) % 3]);
        sum = v3_mad(sum, across, 0.5 * atan2(v3_length(across), v3_dot(c[k], c[(k + 1) % 3])) / v3_length(across));
    }
    if (solid_angle < 0) sum = v3_scale(sum, -1);
    out[0] = sqrt(0.25 / REF_PI) * fabs(solid_angle);
    out[1] = sqrt(0.75 / REF_PI) * sum.y;
    out[2] = sqrt(0.75 / REF_PI) * sum.z;
    out[3] = sqrt(0.75 / REF_PI) * sum.x;
}

static void quad_harmonics(v3 p, const v3 corners[4], double out[4]) {
    const v3 halves[2][3] = { { corners[0], corners[1], corners[2] }, { corners[0], corners[2], corners[3] } };
    double one[4], other[4];
    int i;
    triangle_harmonics(p, halves[0], one);
    triangle_harmonics(p, halves[1], other);
    for (i = 0; i < 4; i++) out[i] = one[i] + other[i];
}

/* Reads all four channels, which the caller frees. */
static void harmonics_of(const sbl_lightmap_desc *desc, float *sh[4]) {
    int i;
    for (i = 0; i < 4; i++) sh[i] = channel_of(desc, (sbl_channel)(SBL_CHANNEL_SH_0 + i));
}

/* Returns R of a surface that faces m, from R and the harmonics of a texel that faces n, by the formula in ON
   LIGHTMAPS. */
static double reconstructed(double R, const double sh[4], v3 n, v3 m) {
    const v3 lobe = v3_of(0.16286750 * sh[3], 0.16286750 * sh[1], 0.16286750 * sh[2]);
    const double mean = 0.28209479 * sh[0], length = v3_length(lobe), r = fmin(length / mean, 1);
    const double a = (1 - r) / (1 + r), p = 1 + 2 * r, q_n = 0.5 * (1 + v3_dot(n, lobe) / length),
        q_m = 0.5 * (1 + v3_dot(m, lobe) / length);
    return R * (a + (1 - a) * (p + 1) * pow(q_m, p)) / (a + (1 - a) * (p + 1) * pow(q_n, p));
}

/* A floor is under two lamps of different colours, the second one to the side. The harmonics of every texel agree with
   closed forms for both back ends, and so does R reconstructed for normals tilted by up to 30 degrees. */
TEST(harmonics_of_two_lamps) {
    static const float lamps[2][12] = { { -0.5f, 2, -0.5f, 0.5f, 2, -0.5f, 0.5f, 2, 0.5f, -0.5f, 2, 0.5f },
                                        { 3, 0.6f, -1, 3, 0.6f, 0.5f, 3, 2, 0.5f, 3, 2, -1 } };
    static const float light[2][3] = { { 2, 1, 0 }, { 0.5f, 1, 4 } };
    static const sbl_backend backends[2] = { SBL_BACKEND_TRACE, SBL_BACKEND_RASTER };
    const v3 up = v3_of(0, 1, 0);
    int run, lamp, i, k, n;
    for (run = 0; run < 2; run++) {
        static test_scene s;
        sbl_lightmap_desc desc = map_of(40, 32, SBL_MODE_DIRECT);
        v3 corners[2][4];
        float *R, *position, *id, *sh[4];
        double off[4] = { 0, 0, 0, 0 }, leaning = 0, mean = 0, mean_R = 0;
        int count = 0, leans = 0;
        memset(&s, 0, sizeof s);
        for (lamp = 0; lamp < 2; lamp++) {
            scene_polygon(&s, scene_lamp(&s, light[lamp][0], light[lamp][1], light[lamp][2]), lamps[lamp], 4);
            for (k = 0; k < 4; k++) corners[lamp][k] = v3_from(lamps[lamp] + 3 * k);
        }
        uv_rectangle(&s, scene_floor(&s, scene_material(&s, 0.5f, 0.5f, 0.5f), 0, 2), 0.1f, 0.05f, 0.9f, 0.95f);
        desc.directional = 1;
        desc.options.backend = backends[run];
        R = bake(&s, &desc);
        position = channel_of(&desc, SBL_CHANNEL_POSITION);
        id = channel_of(&desc, SBL_CHANNEL_ID);
        harmonics_of(&desc, sh);
        REQUIRE(R && position && id && sh[0] && sh[3], "no lightmap");
        for (i = 0; i < 40 * 32; i++) {
            const v3 p = v3_from(position + 3 * i);
            double each[2][4], found[4], truth[4];
            if (!(id[i] > 0)) continue;
            for (lamp = 0; lamp < 2; lamp++) quad_harmonics(p, (const v3 *)corners[lamp], each[lamp]);
            for (n = 0; n < 3; n++) {
                for (k = 0; k < 4; k++) {
                    truth[k] = (double)light[0][n] * each[0][k] + (double)light[1][n] * each[1][k];
                    found[k] = (double)sh[k][3 * i + n];
                    off[k] += pow(found[k] - truth[k], 2);
                }
                mean += truth[0];
                mean_R += (double)R[3 * i + n];
                count++;
                for (k = 0; k < 6; k++) {
                    const double angle = 60 * k * REF_PI / 180;
                    const v3 m = v3_of(0.5 * cos(angle), sqrt(0.75), 0.5 * sin(angle));
                    double told = 0;
                    for (lamp = 0; lamp < 2; lamp++)
                        told += (double)light[lamp][n] * ref_polygon(p, m, corners[lamp], 4);
                    leaning += pow(reconstructed((double)R[3 * i + n], found, up, m) - told, 2);
                    leans++;
                }
            }
        }
        mean /= count;
        mean_R /= count;
        for (k = 0; k < 4; k++) off[k] = sqrt(off[k] / count) / mean;
        leaning = sqrt(leaning / leans) / mean_R;
        printf("  %s: off by %.2f %.2f %.2f %.2f %% rms; R of tilted normals by %.1f %%\n", run ? "views" : "rays",
               100 * off[0], 100 * off[1], 100 * off[2],
               100 * off[3], 100 * leaning);
        for (k = 0; k < 4; k++) CHECK(off[k] < 0.008, "run %d: harmonic %d is off by %.2f %%", run, k, 100 * off[k]);
        CHECK(leaning < 0.12, "run %d: R of tilted normals is off by %.1f %%", run, 100 * leaning);
        free(R);
        free(position);
        free(id);
        for (k = 0; k < 4; k++) free(sh[k]);
        scene_free(&s);
    }
}

/* Harmonics of point lights above the horizon agree with closed forms: 5 points, which get a ray each; 40 points and
   balls; and 400 points, which several looks sample in clusters. A point has its irradiance e from one direction;
   harmonic 0 of a ball is its radiance times its solid angle, slightly more than e. */
TEST(harmonics_of_lights) {
    static const int counts[3] = { 5, 40, 400 };
    static const double limits[3] = { 0.001, 0.001, 0.03 };
    int run, i, k, n;
    for (run = 0; run < 3; run++) {
        static test_scene s;
        static sbl_light lights[400];
        sbl_lightmap_desc desc = map_of(20, 20, SBL_MODE_DIRECT);
        sbl_scene_desc scene;
        uint64_t seed = 3;
        float *position, *id, *sh[4];
        double off[4] = { 0, 0, 0, 0 }, mean = 0;
        int count = 0;
        memset(&s, 0, sizeof s);
        memset(lights, 0, sizeof lights);
        uv_rectangle(&s, scene_floor(&s, scene_material(&s, 0.5f, 0.5f, 0.5f), 0, 1), 0.05f, 0.05f, 0.95f, 0.95f);
        for (i = 0; i < counts[run]; i++) {
            for (k = 0; k < 3; k++) lights[i].intensity[k] = (float)(0.5 + ref_random(&seed));
            lights[i].position[0] = (float)(8 * ref_random(&seed) - 4);
            lights[i].position[1] = (float)(1 + ref_random(&seed));
            lights[i].position[2] = (float)(8 * ref_random(&seed) - 4);
            if (run == 1) lights[i].radius = i % 2 ? 0.4f : 0;
        }
        REQUIRE(use_scene(&s), "no context");
        scene = scene_desc(&s);
        scene.lights = lights;
        scene.light_count = counts[run];
        desc.directional = 1;
        desc.tile = run == 2 ? 4 : 1;
        CHECK(sbl_set_scene(context, &scene) == SBL_SUCCESS && sbl_bake_lightmap(context, &desc) == SBL_SUCCESS, "%s",
              watch_last(&seen));
        position = channel_of(&desc, SBL_CHANNEL_POSITION);
        id = channel_of(&desc, SBL_CHANNEL_ID);
        harmonics_of(&desc, sh);
        REQUIRE(position && id && sh[0] && sh[3], "no lightmap");
        for (i = 0; i < 20 * 20; i++) {
            double truth[4] = { 0, 0, 0, 0 };
            if (!(id[i] > 0)) continue;
            for (n = 0; n < counts[run]; n++) {
                const v3 to = v3_sub(v3_from(lights[n].position), v3_from(position + 3 * i)), way = v3_unit(to);
                const double away2 = v3_dot(to, to), radius = (double)lights[n].radius,
                    e = (double)lights[n].intensity[1] / away2;
                truth[0] += sqrt(0.25 / REF_PI) * e * 2 / (1 + sqrt(1 - radius * radius / away2));
                truth[1] += sqrt(0.75 / REF_PI) * e * way.y;
                truth[2] += sqrt(0.75 / REF_PI) * e * way.z;
                truth[3] += sqrt(0.75 / REF_PI) * e * way.x;
            }
            for (k = 0; k < 4; k++) off[k] += pow((double)sh[k][3 * i + 1] - truth[k], 2);
            mean += truth[0];
            count++;
        }
        mean /= count;
        for (k = 0; k < 4; k++) off[k] = sqrt(off[k] / count) / mean;
        printf("  %d lights: off by %.3f %.3f %.3f %.3f %% rms\n", counts[run], 100 * off[0], 100 * off[1],
               100 * off[2], 100 * off[3]);
        for (k = 0; k < 4; k++)
            CHECK(off[k] < limits[run], "%d lights: harmonic %d is off by %.3f %%", counts[run], k, 100 * off[k]);
        free(position);
        free(id);
        for (k = 0; k < 4; k++) free(sh[k]);
        scene_free(&s);
    }
}

/* Light that is equal from all directions gives a tilted surface the closed form of the harmonics without noise: with
   rays, with views, in a closed box that emits and reflects, and there also on a surface without sensors. */
TEST(even_light_has_no_direction) {
    int run, i, k;
    for (run = 0; run < 4; run++) {
        static test_scene s;
        sbl_lightmap_desc desc = map_of(24, 24, run >= 2 ? SBL_MODE_GI : SBL_MODE_DIRECT);
        float *R, *id, *normal, *sh[4];
        double worst[4] = { 0, 0, 0, 0 }, of_R = 0;
        const double limit = run >= 2 ? 0.1 : run ? 0.002 : 1e-4;
        int count = 0;
        memset(&s, 0, sizeof s);
        k = scene_material(&s, 0.5f, 0.5f, 0.5f);
        if (run >= 2) {
            for (i = 0; i < 3; i++) s.materials[k].emission[i] = 0.5f;
            scene_box(&s, k, -2, -2, -2, 2, 2, 2);
        } else scene_sky(&s, 1, 1, 1);
        uv_rectangle(&s, scene_quad(&s, scene_material(&s, 0, 0, 0), 0, 0, 0, 0, 0, 1, 1, 0.7f, 1.2f, 1, 0.7f, 0.2f),
                     0.1f, 0.1f, 0.9f, 0.9f);
        if (run == 3) s.materials[s.material_count - 1].flags = SBL_MATERIAL_NO_SENSORS;
        desc.directional = 1;
        desc.options.backend = run == 1 ? SBL_BACKEND_RASTER : SBL_BACKEND_TRACE;
        R = bake_stored(&s, &desc, 0);
        id = channel_of(&desc, SBL_CHANNEL_ID);
        normal = channel_of(&desc, SBL_CHANNEL_NORMAL);
        harmonics_of(&desc, sh);
        REQUIRE(R && id && normal && sh[0] && sh[3], "no lightmap");
        for (i = 0; i < 24 * 24; i++) {
            const double y = sqrt(0.75 / REF_PI) * REF_PI;
            double truth[4];
            if (!(id[i] > 0)) continue;
            count++;
            truth[0] = sqrt(0.25 / REF_PI) * 2 * REF_PI;
            for (k = 1; k < 4; k++) truth[k] = y * (double)normal[3 * i + k % 3];
            /* on the surface without sensors, R has an error, which scales all harmonics */
            for (k = 0; k < 4; k++)
                worst[k] = fmax(worst[k], fabs((double)sh[k][3 * i + 1] - truth[k] *
                                               (run == 3 ? (double)R[3 * i + 1] : 1)));
            of_R = fmax(of_R, fabs((double)R[3 * i] - 1));
        }
        CHECK(count > 300, "%d texels", count);
        for (k = 0; k < 4; k++)
            CHECK(worst[k] < limit, "run %d: harmonic %d is off by %g; R by %g", run, k, worst[k], of_R);
        free(R);
        free(id);
        free(normal);
        for (k = 0; k < 4; k++) free(sh[k]);
        scene_free(&s);
    }
}

/* An infinite black wall hides half of a white sky. The harmonics of the other half agree with closed forms, with rays
   and with rotated views. */
TEST(half_a_sky) {
    int run, i, k;
    for (run = 0; run < 2; run++) {
        static test_scene s;
        sbl_lightmap_desc desc = map_of(16, 16, SBL_MODE_DIRECT);
        const double a = sqrt(0.25 / REF_PI), b = sqrt(0.75 / REF_PI),
            truth[4] = { a * REF_PI, b * REF_PI / 2, 0, b * REF_PI / 2 };
        double sum[4] = { 0, 0, 0, 0 }, squares[4] = { 0, 0, 0, 0 };
        float *R, *id, *sh[4];
        int count = 0;
        memset(&s, 0, sizeof s);
        k = scene_material(&s, 0, 0, 0);
        scene_quad(&s, k, 0, -1, -1e4f, 0, -1, 1e4f, 0, 1e4f, 1e4f, 0, 1e4f, -1e4f);
        uv_rectangle(&s, scene_quad(&s, k, 0.1f, 0, 0.1f, 0.1f, 0, 1, 1, 0, 1, 1, 0, 0.1f), 0.1f, 0.1f, 0.9f, 0.9f);
        scene_sky(&s, 1, 1, 1);
        desc.directional = 1;
        desc.tile = 1;
        desc.options.backend = run ? SBL_BACKEND_RASTER : SBL_BACKEND_TRACE;
        R = bake(&s, &desc);
        id = channel_of(&desc, SBL_CHANNEL_ID);
        harmonics_of(&desc, sh);
        REQUIRE(R && id && sh[0] && sh[3], "no lightmap");
        for (i = 0; i < 16 * 16; i++) {
            if (!(id[i] > 0)) continue;
            count++;
            for (k = 0; k < 4; k++) {
                sum[k] += (double)sh[k][3 * i] - truth[k];
                squares[k] += pow((double)sh[k][3 * i] - truth[k], 2);
            }
        }
        for (k = 0; k < 4; k++) {
            const double mean = sum[k] / count / truth[0], rms = sqrt(squares[k] / count) / truth[0];
            printf("  harmonic %d: %.2f %%, %.2f %% rms\n", k, 100 * mean, 100 * rms);
            CHECK(fabs(mean) < 0.02 && rms < 0.08, "run %d: harmonic %d is off by %.2f %%, %.2f %% rms", run, k,
                  100 * mean, 100 * rms);
        }
        free(R);
        free(id);
        for (k = 0; k < 4; k++) free(sh[k]);
        scene_free(&s);
    }
}

/* Without desc.directional, the harmonics are 0, also in pictures. R is the same to the bit with and without them. */
TEST(harmonics_are_asked_for) {
    static test_scene s;
    sbl_lightmap_desc desc = map_of(24, 24, SBL_MODE_DIRECT);
    const sbl_picture_desc view = scene_plain(scene_view(24, 24, 60, 0, 1, 3, 0, 0, 0), SBL_MODE_DIRECT, 8);
    float *plain, *directional, *sh, *final;
    int i, lit = 0, reached = 0, beyond = 0;
    memset(&s, 0, sizeof s);
    uv_rectangle(&s, scene_floor(&s, scene_material(&s, 0.5f, 0.5f, 0.5f), 0, 1), 0.2f, 0.2f, 0.8f, 0.8f);
    scene_box(&s, 0, -0.3f, 0, -0.3f, 0.3f, 0.6f, 0.3f);
    scene_sky(&s, 1, 1, 1);
    desc.gutter = 2;
    plain = bake(&s, &desc);
    sh = channel_of(&desc, SBL_CHANNEL_SH_2);
    for (i = 0; sh && i < 3 * 24 * 24; i++) lit += sh[i] != 0;
    free(sh);
    CHECK(sbl_render_picture(context, &view) == SBL_SUCCESS, "%s", watch_last(&seen));
    sh = channel_of(&desc, SBL_CHANNEL_SH_0);
    for (i = 0; sh && i < 3 * 24 * 24; i++) lit += sh[i] != 0;
    free(sh);
    CHECK(lit == 0, "%d harmonics are not 0 without desc.directional", lit);
    desc.directional = 1;
    directional = bake(&s, &desc);
    sh = channel_of(&desc, SBL_CHANNEL_SH_0);
    final = channel_of(&desc, SBL_CHANNEL_FINAL);
    REQUIRE(plain && directional && sh && final, "no lightmap");
    CHECK(memcmp(plain, directional, 24 * 24 * 3 * sizeof *plain) == 0, "R differs");
    CHECK(sbl_channel_texture(context, SBL_CHANNEL_SH_3) != 0, "no texture");
    for (i = 0; i < 24 * 24; i++) {
        reached += final[3 * i] > 0;
        beyond += (final[3 * i] > 0) != (sh[3 * i] > 0);
    }
    CHECK(reached > 15 * 15 && beyond == 0, "R is lit at %d texels, the harmonics differ from that at %d", reached,
          beyond);
    free(plain);
    free(directional);
    free(sh);
    free(final);
    scene_free(&s);
}

/* >>light that varies within a texel */

/* Returns the area of the part of the unit square where a x + b y < c. */
static double below(double a, double b, double c) {
    double sum = 0;
    int i;
    for (i = 0; i < 1000; i++) {
        const double x = (i + 0.5) / 1000;
        sum += fmin(fmax((c - a * x) / b, 0), 1);
    }
    return sum / 1000;
}

/* A vertical sun casts the straight shadow edge of a roof across the floor at an angle. The light of a texel on the
   edge is its lit area; the error falls with the number of places per texel. */
TEST(a_shadow_crosses_texels) {
    enum { N = 16 };
    static const int places[3] = { 1, 3, 8 };
    double error[3];
    int run, x, y;
    for (run = 0; run < 3; run++) {
        static test_scene s;
        sbl_lightmap_desc desc = map_of(N, N, SBL_MODE_DIRECT);
        sbl_light *sun;
        float *R, *final, *position, *id;
        double squares = 0, far_off = 0;
        int crossed = 0, wrong = 0;
        memset(&s, 0, sizeof s);
        /* coordinates from 0 to N on the floor equal those on the map */
        uv_rectangle(&s, scene_quad(&s, scene_material(&s, 0.5f, 0.5f, 0.5f), 0, 0, 0, 0, 0, N, N, 0, N, N, 0, 0), 0, 0,
                     1, 1);
        { const float turned[8] = { 0, 0, 0, 1, 1, 1, 1, 0 }; uv_set(&s, &s.meshes[0], turned); }
        /* its edge is z = 9.2667 - 0.25833 x */
        scene_quad(&s, 0, -4, 1, -4, -4, 1, 10.3f, N + 4, 1, 4.1f, N + 4, 1, -4);
        sun = scene_light(&s, SBL_LIGHT_DIRECTIONAL, (float)REF_PI, (float)REF_PI, (float)REF_PI);
        sun->direction[1] = -1;
        desc.supersample = places[run];
        desc.tile = 4;
        R = bake(&s, &desc);
        final = channel_of(&desc, SBL_CHANNEL_FINAL);
        position = channel_of(&desc, SBL_CHANNEL_POSITION);
        id = channel_of(&desc, SBL_CHANNEL_ID);
        REQUIRE(R && final && position && id, "no lightmap");
        for (y = 0; y < N; y++)
            for (x = 0; x < N; x++) {
                const int i = y * N + x;
                const double slope = (10.3 - 4.1) / (N + 8),
                    truth = 1 - below(slope, 1, 10.3 - 4 * slope - slope * x - y);
                const double dx = (double)position[3 * i] - x - 0.5, dz = (double)position[3 * i + 2] - y - 0.5;
                far_off = fmax(far_off, sqrt(dx * dx + dz * dz));
                wrong += !(id[i] > 0) || memcmp(R + 3 * i, final + 3 * i, 3 * sizeof *R) != 0;
                if (truth > 0.02 && truth < 0.98) { squares += pow((double)R[3 * i] - truth, 2); crossed++; }
                else wrong += fabs((double)R[3 * i] - truth) > 0.1;
            }
        error[run] = sqrt(squares / crossed);
        CHECK(crossed >= N && wrong == 0, "%d places: %d texels are crossed, %d wrong", places[run], crossed, wrong);
        CHECK(far_off < (places[run] == 8 ? 0.092 : 0.021), "%d places: positions are up to %g texels from the centres",
              places[run], far_off);
        CHECK(sbl_query_stats(context).picture.width == N && sbl_query_stats(context).picture.visible_pixels == N * N,
              "%d texels across, %d visible", sbl_query_stats(context).picture.width,
              sbl_query_stats(context).picture.visible_pixels);
        free(R);
        free(final);
        free(position);
        free(id);
        scene_free(&s);
    }
    printf("  texels that the edge crosses are off by %.3f, %.3f, %.3f\n", error[0], error[1], error[2]);
    CHECK(error[0] > 0.2 && error[1] < 0.08 && error[2] < 0.02, "%g, %g, %g", error[0], error[1], error[2]);
}

/* A bright and a dark chart meet within a column of texels. Each texel has the light of the chart that covers more of
   it, and no light of the other. */
TEST(texels_are_of_one_chart) {
    static const float roof[12] = { -9, 0.3f, -9, 9, 0.3f, -9, 9, 0.3f, 9, -9, 0.3f, 9 };
    int run, y;
    for (run = 0; run < 2; run++) {
        static test_scene s;
        sbl_lightmap_desc desc = map_of(16, 8, SBL_MODE_DIRECT);
        const float where = run ? 8.3f / 16 : 8.7f / 16;
        const int last = run ? 7 : 8;  /* last column of the bright chart */
        sbl_sensor sensor;
        float *R, *id, *position;
        int wrong = 0;
        memset(&s, 0, sizeof s);
        scene_material(&s, 0.5f, 0.5f, 0.5f);
        uv_rectangle(&s, scene_floor(&s, 0, 0.31f, 1), 0.1f, 0.1f, where, 0.9f);
        uv_rectangle(&s, scene_floor(&s, 0, 0.29f, 0.5f), where, 0.1f, 0.9f, 0.9f);
        scene_polygon(&s, 0, roof, 4);
        scene_box(&s, 0, -9, -1, -9, 9, 0.299f, 9);
        scene_sky(&s, 1, 1, 1);
        desc.supersample = 8;
        desc.directional = 1;
        R = bake(&s, &desc);
        id = channel_of(&desc, SBL_CHANNEL_ID);
        position = channel_of(&desc, SBL_CHANNEL_POSITION);
        REQUIRE(R && id && position, "no lightmap");
        for (y = 1; y < 7; y++) {
            const int bright = 16 * y + last, dark = bright + 1;
            wrong += id[bright] != 1.0f || fabs((double)R[3 * bright] - 1) > 0.01 || !(position[3 * bright + 1] > 0.3f);
            wrong += id[dark] != 2.0f || R[3 * dark] > 1e-3f;
        }
        CHECK(wrong == 0, "run %d: %d texels are wrong", run, wrong);
        CHECK(sbl_inspect_sensor(context, last, 3, &sensor, NULL, NULL, 0) == SBL_SUCCESS &&
              fabs((double)sensor.position[1] - 0.31) < 1e-3, "%s", watch_last(&seen));
        CHECK(sbl_inspect_sensor(context, 16, 3, &sensor, NULL, NULL, 0) == SBL_ERROR_INVALID_ARGUMENT,
              "a texel outside of the map can be inspected");
        CHECK(sbl_channel_texture(context, SBL_CHANNEL_ID) && sbl_channel_texture(context, SBL_CHANNEL_RADIANCE) &&
              sbl_channel_texture(context, SBL_CHANNEL_ALBEDO), "a texture is missing: %s", watch_last(&seen));
        free(R);
        free(id);
        free(position);
        scene_free(&s);
    }
}

/* Each texel sees a hundredth of a lamp through a hole. Most of its first passes of rays to the lamp find it blocked
   (see sbl_combine_after in lamps.glsl). The mean of all texels has the harmonics of the visible part. */
TEST(few_rays_that_differ_have_harmonics) {
    static test_scene s;
    const v3 part[4] = { v3_of(0.4, 2, 0.2), v3_of(0.6, 2, 0.2), v3_of(0.6, 2, 0.4), v3_of(0.4, 2, 0.4) };
    sbl_lightmap_desc desc = map_of(96, 96, SBL_MODE_DIRECT);
    float *R, *id, *sh[4];
    double mean[4] = { 0, 0, 0, 0 }, expected[4];
    int i, k, count = 0;
    memset(&s, 0, sizeof s);
    scene_plate_with_hole(&s);
    scene_quad(&s, scene_lamp(&s, 1, 1, 1), -1, 2, -1, 1, 2, -1, 1, 2, 1, -1, 2, 1);
    uv_rectangle(&s, scene_floor(&s, scene_material(&s, 0, 0, 0), 0, 0.005f), 0.02f, 0.02f, 0.98f, 0.98f);
    desc.directional = desc.tile = 1;
    desc.options.rays = 256;
    R = bake(&s, &desc);
    id = channel_of(&desc, SBL_CHANNEL_ID);
    harmonics_of(&desc, sh);
    REQUIRE(R && id && sh[0] && sh[3], "no lightmap");
    for (i = 0; i < 96 * 96; i++) {
        for (k = 0; k < 4 && id[i] > 0; k++) mean[k] += (double)sh[k][3 * i + 1];
        count += id[i] > 0;
    }
    quad_harmonics(v3_of(0, 0, 0), part, expected);
    for (k = 0; k < 4; k++)
        CHECK(fabs(mean[k] / count - expected[k]) < 0.1 * expected[0], "harmonic %d is %.5f, not %.5f", k,
              mean[k] / count, expected[k]);
    free(R);
    free(id);
    for (k = 0; k < 4; k++) free(sh[k]);
    scene_free(&s);
}

int main(void) {
    RUN_UNSANITIZED(harmonics_of_two_lamps);
    RUN_UNSANITIZED(harmonics_of_lights);
    RUN_PLAIN(few_rays_that_differ_have_harmonics);
    RUN_UNSANITIZED(even_light_has_no_direction);
    RUN(half_a_sky);
    RUN(harmonics_are_asked_for);
    RUN(a_shadow_crosses_texels);
    RUN(texels_are_of_one_chart);
    sbl_destroy(context);
    CHECK(seen.blocks == 0 && seen.strangers == 0, "%d blocks are not freed, %d were freed twice or never allocated",
          seen.blocks, seen.strangers);
    return test_report() || test_errors;
}
