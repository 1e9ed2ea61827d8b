/* Tests of light at vertices. They compare it with closed forms, on grids that are finer or coarser than the light.
   Further tests cover joined vertices, buried vertices and invalid descriptors. */
#include "../sbl.h"
#include "support/test.h"
#include "support/scenes.h"
#include "support/reference.h"
#include "support/gl_watch.h"
#include "support/one_context.h"

static int vertices_of(const test_scene *s) {
    int i, count = 0;
    for (i = 0; i < s->mesh_count; i++) count += s->meshes[i].vertex_count;
    return count;
}

static sbl_vertices_desc desc_of(sbl_mode mode) {
    sbl_vertices_desc desc;
    memset(&desc, 0, sizeof desc);
    desc.options.mode = mode;
    return desc;
}

/* Bakes `count` vertices of the current scene into an array that is filled with NaN, and checks that the bake writes
   all of the array and nothing beyond. Returns the array, which the caller frees, or NULL on failure. */
static float *bake_again(const sbl_vertices_desc *from, int count) {
    float *light = (float *)malloc((3 * (size_t)count + 1) * sizeof *light);
    sbl_vertices_desc desc = *from;
    sbl_result result;
    int i;
    if (!light) abort();
    for (i = 0; i <= 3 * count; i++) light[i] = (float)NAN;
    desc.radiance = light;
    desc.float_count = 3 * (size_t)count;
    result = sbl_bake_vertices(context, &desc);
    CHECK(result == SBL_SUCCESS && sbl_progress(context) == 1, "%s: %s", sbl_result_string(result), watch_last(&seen));
    for (i = 0; i < 3 * count && result == SBL_SUCCESS; i++)
        if (!(light[i] >= 0)) { CHECK(0, "vertex %d has R = %g", i / 3, (double)light[i]); break; }
    CHECK(light[3 * count] != light[3 * count], "the bake wrote past the end");
    if (result == SBL_SUCCESS) return light;
    free(light);
    return NULL;
}

/* Sets the scene and bakes all its vertices. Returns the array, which the caller frees, or NULL on failure. */
static float *bake(const test_scene *s, const sbl_vertices_desc *desc) {
    if (!use_scene(s)) { CHECK(0, "no context"); return NULL; }
    return bake_again(desc, vertices_of(s));
}

/* >>light at vertices */

/* Adds a square with (side + 1)^2 vertices around the origin, with the orientation of scene_floor. The normals point
   up. */
static sbl_mesh *grid(test_scene *s, int material, int side, float half) {
    float *p = (float *)scene_alloc(s, sizeof(float) * 3 * (size_t)((side + 1) * (side + 1)));
    uint32_t *indices = (uint32_t *)scene_alloc(s, sizeof *indices * 6 * (size_t)(side * side));
    int x, y, n = 0;
    for (y = 0; y <= side; y++)
        for (x = 0; x <= side; x++) {
            p[3 * (y * (side + 1) + x)] = half * (2 * (float)x / (float)side - 1);
            p[3 * (y * (side + 1) + x) + 2] = half * (2 * (float)y / (float)side - 1);
        }
    for (y = 0; y < side; y++)
        for (x = 0; x < side; x++) {
            const uint32_t a = (uint32_t)(y * (side + 1) + x), b = a + (uint32_t)side + 1;
            const uint32_t six[6] = { a, b, b + 1, a, b + 1, a + 1 };
            memcpy(indices + n, six, sizeof six);
            n += 6;
        }
    return scene_mesh(s, material, p, NULL, NULL, (side + 1) * (side + 1), indices, n);
}

static const float lamp_corners[12] = { -0.5f, 0.5f, -0.5f, 0.5f, 0.5f, -0.5f, 0.5f, 0.5f, 0.5f, -0.5f, 0.5f, 0.5f };

/* Returns the RMS difference between the light that is interpolated from the vertices of a grid and the light of the
   lamp, relative to the mean. */
static double grid_error(const float *light, int side, double half) {
    v3 corners[4];
    double squares = 0, mean = 0;
    enum { FINE = 400 };
    int i, x, y;
    for (i = 0; i < 4; i++) corners[i] = v3_from(lamp_corners + 3 * i);
    for (y = 0; y < FINE; y++)
        for (x = 0; x < FINE; x++) {
            const double u = side * (x + 0.5) / FINE, v = side * (y + 0.5) / FINE, fu = u - floor(u), fv = v - floor(v);
            const int a = (int)v * (side + 1) + (int)u, b = a + side + 1;
            const v3 at = v3_of(half * (2 * u / side - 1), 0, half * (2 * v / side - 1));
            const double truth = ref_polygon(at, v3_of(0, 1, 0), corners, 4);
            const double drawn = fv > fu ? (1 - fv) * (double)light[3 * a] + (fv - fu) * (double)light[3 * b] + fu *
                (double)light[3 * (b + 1)]
                                         : (1 - fu) * (double)light[3 * a] + (fu - fv) * (double)light[3 * (a + 1)] +
                                             fv * (double)light[3 * (b + 1)];
            squares += (drawn - truth) * (drawn - truth);
            mean += truth;
        }
    return sqrt(squares / (FINE * FINE)) / (mean / (FINE * FINE));
}

static double grid_of_size(int side, sbl_vertices_desc desc, float scale) {
    static test_scene s;
    double error = 1;
    float *light;
    memset(&s, 0, sizeof s);
    grid(&s, scene_material(&s, 0.5f, 0.5f, 0.5f), side, 1.5f);
    scene_polygon(&s, scene_lamp(&s, 1, 1, 1), lamp_corners, 4);
    if (scale != 1) scene_scale_and_move(&s, scale, 0, 0, 0);
    light = bake(&s, &desc);
    if (light) error = grid_error(light, side, 1.5);
    free(light);
    scene_free(&s);
    return error;
}

static double grid_under_a_lamp(int side, sbl_vertices_desc desc) { return grid_of_size(side, desc, 1); }

/* Returns the least possible error of light that is linear between the vertices of a grid. The normal equations of many
   points are solved by elimination. */
static double grid_least_error(int side, double half) {
    enum { FINE = 160, MOST = 81 };
    static double m[MOST][MOST + 1];
    static float light[3 * MOST];
    const int count = (side + 1) * (side + 1);
    v3 corners[4];
    int i, k, x, y, row;
    memset(m, 0, sizeof m);
    for (i = 0; i < 4; i++) corners[i] = v3_from(lamp_corners + 3 * i);
    for (y = 0; y < FINE; y++)
        for (x = 0; x < FINE; x++) {
            const double u = side * (x + 0.5) / FINE, v = side * (y + 0.5) / FINE, fu = u - floor(u), fv = v - floor(v);
            const int a = (int)v * (side + 1) + (int)u, b = a + side + 1, at[3] = { a, fv > fu ? b : a + 1, b + 1 };
            const double h[3] = { 1 - fmax(fu, fv), fabs(fv - fu), fmin(fu, fv) };
            const double truth = ref_polygon(v3_of(half * (2 * u / side - 1), 0, half * (2 * v / side - 1)),
                                             v3_of(0, 1, 0), corners, 4);
            for (i = 0; i < 3; i++) {
                for (k = 0; k < 3; k++) m[at[i]][at[k]] += h[i] * h[k];
                m[at[i]][count] += h[i] * truth;
            }
        }
    for (k = 0; k < count; k++)  /* the matrix is positive definite and needs no pivoting */
        for (row = 0; row < count; row++) {
            const double factor = m[row][k] / m[k][k];
            for (i = k; i <= count && row != k; i++) m[row][i] -= factor * m[k][i];
        }
    for (k = 0; k < count; k++) light[3 * k] = (float)(m[k][count] / m[k][k]);
    return grid_error(light, side, half);
}

/* The light that is interpolated between the vertices of a grid is close to the closed form. Its error is close to the
   least possible error. */
TEST(a_floor_under_a_lamp) {
    sbl_vertices_desc desc = desc_of(SBL_MODE_DIRECT), average = desc, rough = desc;
    const double fine = grid_under_a_lamp(32, desc), coarse = grid_under_a_lamp(8, desc),
        least = grid_least_error(8, 1.5);
    double mean_fine, mean_coarse, raw;
    average.average = 1;
    mean_fine = grid_under_a_lamp(32, average);
    mean_coarse = grid_under_a_lamp(8, average);
    rough.smoothing = -1;
    raw = grid_under_a_lamp(8, rough);
    printf("  33^2 vertices: %.3f %% rms, averages %.2f %%; 9^2: %.2f %%, not smoothed %.2f %%, averages %.1f %%, "
           "optimum %.2f %%\n", 100 * fine,
           100 * mean_fine, 100 * coarse, 100 * raw, 100 * mean_coarse, 100 * least);
    CHECK(fine < 0.005, "fine grid: %.3f %%", 100 * fine);
    CHECK(mean_fine < 0.02 && mean_coarse < 0.3, "averages: %.3f %%, %.2f %%", 100 * mean_fine, 100 * mean_coarse);
    CHECK(coarse < 1.05 * least && raw < 1.05 * least && coarse < 0.4 * mean_coarse,
          "coarse grid: %.3f %%, not smoothed %.3f %%, optimum %.3f %%, averages %.3f %%",
          100 * coarse, 100 * raw, 100 * least, 100 * mean_coarse);
}

/* Scaling the scene does not change R. */
TEST(scenes_of_all_sizes) {
    const sbl_vertices_desc desc = desc_of(SBL_MODE_DIRECT);
    const double right = grid_under_a_lamp(16, desc), tiny = grid_of_size(16, desc, 3e-10f),
        huge = grid_of_size(16, desc, 1e9f);
    CHECK(right < 0.016 && fabs(tiny - right) < 0.02 * right && fabs(huge - right) < 0.02 * right,
          "off by %.3f %%, tiny %.3f %%, huge %.3f %%", 100 * right, 100 * tiny,
          100 * huge);
}

/* The light of a distant lamp is almost linear. Strong smoothing must not change it, on triangles of all shapes. */
TEST(smoothing_leaves_slopes_alone) {
    static const float lamp[12] = { 6, 3, -1, 6, 5, -1, 6, 5, 1, 6, 3, 1 };  /* the lamp faces -x */
    static test_scene s;
    sbl_vertices_desc desc = desc_of(SBL_MODE_DIRECT);
    double truth[81], mean = 0, spread = 0, squares = 0;
    float *light, *p;
    v3 corners[4];
    uint64_t seed = 3;
    int i, k;
    memset(&s, 0, sizeof s);
    grid(&s, scene_material(&s, 0.5f, 0.5f, 0.5f), 8, 0.5f);
    p = (float *)scene_copy(&s, (const float *)s.meshes[0].positions.data, 3 * 81);
    for (i = 0; i < 81; i++)
        for (k = 0; k < 3; k += 2)
            if (fabsf(p[3 * i + k]) < 0.49f) p[3 * i + k] += 0.05f * (float)(2 * ref_random(&seed) - 1);
    s.meshes[0].positions.data = p;
    scene_polygon(&s, scene_lamp(&s, 20, 20, 20), lamp, 4);
    for (i = 0; i < 4; i++) corners[i] = v3_from(lamp + 3 * (3 - i));
    for (i = 0; i < 81; i++)
        mean += (truth[i] = 20 * fabs(ref_polygon(v3_from(p + 3 * i), v3_of(0, 1, 0), corners, 4))) / 81;
    for (i = 0; i < 81; i++) spread += (truth[i] - mean) * (truth[i] - mean) / 81;
    desc.smoothing = 1000;
    light = bake(&s, &desc);
    if (light) {
        for (i = 0; i < 81; i++) squares += pow((double)light[3 * i] - truth[i], 2) / 81;
        printf("  R varies by %.1f %% and is off by %.2f %%\n", 100 * sqrt(spread) / mean,
               100 * sqrt(squares) / mean);
        CHECK(sqrt(spread) > 0.08 * mean && sqrt(squares) < 0.01 * mean, "R varies by %g and is off by %g",
              sqrt(spread) / mean,
              sqrt(squares) / mean);
    }
    free(light);
    scene_free(&s);
}

/* In a closed box that emits and reflects, R is emission / (1 - albedo), for both methods and both back ends. */
TEST(a_furnace) {
    static test_scene s;
    sbl_vertices_desc desc = desc_of(SBL_MODE_GI);
    sbl_scene_desc scene;
    int i, k, way;
    memset(&s, 0, sizeof s);
    i = scene_material(&s, 0.5f, 0.5f, 0.5f);
    for (k = 0; k < 3; k++) s.materials[i].emission[k] = 1;
    scene_box(&s, i, 0, 0, 0, 2, 1, 3);
    for (i = 0; i < 6; i++) {
        float turned[12];
        for (k = 0; k < 12; k++) turned[k] = ((const float *)s.meshes[i].positions.data)[3 * (3 - k / 3) + k % 3];
        s.meshes[i].positions.data = scene_copy(&s, turned, 12);  /* the walls face inwards */
    }
    REQUIRE(use_scene(&s), "no context");
    scene = scene_desc(&s);
    scene.max_bounce_cells = 0;
    CHECK(sbl_set_scene(context, &scene) == SBL_SUCCESS, "%s", watch_last(&seen));
    for (way = 0; way < 3; way++) {
        double worst = 0;
        float *light;
        desc.average = way == 1;
        desc.options.backend = way == 2 ? SBL_BACKEND_RASTER : SBL_BACKEND_AUTO;
        desc.samples = way == 2 ? 4 : 0;
        light = bake_again(&desc, 24);
        for (i = 0; light && i < 72; i++) worst = test_max(worst, fabs((double)light[i] / 2 - 1));
        printf("  %s%s: %.2f %% at worst\n", way == 1 ? "averages" : "least squares", way == 2 ? ", rasterised" : "",
               100 * worst);
        CHECK(light && worst < 0.03, "way %d: off by %.2f %% at worst", way, 100 * worst);
        CHECK(sbl_query_stats(context).backend == (way == 2 ? SBL_BACKEND_RASTER : SBL_BACKEND_TRACE),
              "the wrong back end was used");
        free(light);
    }
    scene_free(&s);
}

/* Adds a sun that shines from direction (x, y, z), and returns this direction. R of a surface that faces the sun is
   1. */
static v3 scene_sun(test_scene *s, double x, double y, double z) {
    sbl_light *sun = scene_light(s, SBL_LIGHT_DIRECTIONAL, (float)REF_PI, (float)REF_PI, (float)REF_PI);
    const v3 from = v3_unit(v3_of(x, y, z));
    sun->direction[0] = (float)-from.x; sun->direction[1] = (float)-from.y; sun->direction[2] = (float)-from.z;
    return from;
}

/* The front side is the side that the normals point to. Without normals, it is the side from which the corners are in
   counter-clockwise order. Mirroring does not exchange the sides. */
TEST(light_falls_on_the_front) {
    int turned, normals, mirrored, i;
    for (turned = 0; turned < 2; turned++)
        for (normals = 0; normals < 3; normals++)
            for (mirrored = 0; mirrored < 2; mirrored++) {
                static test_scene s;
                static const uint32_t orders[2][6] = { { 0, 1, 2, 0, 2, 3 }, { 0, 2, 1, 0, 3, 2 } };
                static const float corners[12] = { -1, 0, -1, -1, 0, 1, 1, 0, 1, 1, 0, -1 };
                static const float up[12] = { 0, 1, 0, 0, 1, 0, 0, 1, 0, 0, 1, 0 },
                    down[12] = { 0, -1, 0, 0, -1, 0, 0, -1, 0, 0, -1, 0 };
                const sbl_vertices_desc desc = desc_of(SBL_MODE_DIRECT);
                const int lit = normals == 0 ? !turned : normals == 1;
                sbl_mesh *mesh;
                float *light;
                memset(&s, 0, sizeof s);
                mesh = scene_mesh(&s, scene_material(&s, 0.5f, 0.5f, 0.5f), corners, normals == 0 ? NULL : normals ==
                                  1 ? up : down, NULL, 4, orders[turned], 6);
                if (mirrored) {
                    mesh->transform[0] = -2;
                    mesh->transform[5] = mesh->transform[10] = mesh->transform[15] = 1;
                }
                scene_sun(&s, 1, 1, 0);
                light = bake(&s, &desc);
                for (i = 0; light && i < 4; i++)
                    CHECK(fabs((double)light[3 * i] - (lit ? sqrt(0.5) : 0)) < 1e-4,
                          "corners %s, normals %s, %s: R is %g", turned ? "reversed" : "in order",
                          normals == 0 ? "absent" : normals == 1 ? "up" : "down",
                              mirrored ? "mirrored" : "not mirrored", (double)light[3 * i]);
                free(light);
                scene_free(&s);
            }
}

/* In a ball with normals under a sun, R shows neither the seam of duplicate vertices nor the facets. */
TEST(a_ball_in_the_sun) {
    enum { SLICES = 48, STACKS = 24 };
    static test_scene s;
    const sbl_vertices_desc desc = desc_of(SBL_MODE_DIRECT);
    double squares = 0;
    float *light;
    v3 sun;
    int i, k, count;
    memset(&s, 0, sizeof s);
    scene_sphere(&s, scene_material(&s, 0, 0, 0), 0, 0, 0, 1, SLICES, STACKS, 1);
    sun = scene_sun(&s, 1, 2, 3);
    light = bake(&s, &desc);
    if (light) {
        const float *normals = (const float *)s.meshes[0].normals.data;
        count = s.meshes[0].vertex_count;
        for (i = 0; i < count; i++) {
            const int used = i / (SLICES + 1) > 0 && i / (SLICES + 1) < STACKS;
            const double truth = fmax(0, v3_dot(v3_from(normals + 3 * i), sun)), off = (double)light[3 * i] - truth;
            if (used) squares += off * off / count;
        }
        for (i = 1; i < STACKS; i++)
            for (k = 0; k < 3; k++)
                CHECK(light[3 * (i * (SLICES + 1)) + k] == light[3 * (i * (SLICES + 1) + SLICES) + k],
                      "the seam shows at row %d", i);
        printf("  %.2f %% rms\n", 100 * sqrt(squares));
        CHECK(sqrt(squares) < 0.015, "off by %.2f %% rms", 100 * sqrt(squares));
    }
    free(light);
    scene_free(&s);
}

/* >>joining of vertices */

/* Returns the position and the normal of a corner of one of the six faces of a cube. */
static void cube_corner(int face, int corner, float position[3], float normal[3]) {
    const int axis = face / 2, u = (axis + 1) % 3, v = (axis + 2) % 3;
    const float side = face % 2 ? 1.0f : -1.0f;
    memset(normal, 0, 12);
    normal[axis] = position[axis] = side;
    position[u] = side * (corner == 1 || corner == 2 ? 1.0f : -1.0f);
    position[v] = corner >= 2 ? 1.0f : -1.0f;
}

/* Each of the 24 vertices of a cube has the light of its own face, also if only the planes of the triangles show the
   face. */
TEST(hard_edges_are_kept) {
    int way, i;
    for (way = 0; way < 3; way++) {  /* with normals; without normals; without normals and indices */
        static test_scene s;
        sbl_vertices_desc desc = desc_of(SBL_MODE_DIRECT);
        float positions[36 * 3], normals[36 * 3], *light;
        uint32_t indices[36];
        v3 sun;
        memset(&s, 0, sizeof s);
        for (i = 0; i < (way == 2 ? 36 : 24); i++) {
            static const int soup[6] = { 0, 1, 2, 0, 2, 3 };
            if (way == 2) cube_corner(i / 6, soup[i % 6], positions + 3 * i, normals + 3 * i);
            else cube_corner(i / 4, i % 4, positions + 3 * i, normals + 3 * i);
        }
        for (i = 0; i < 36; i++)
            indices[i] = (uint32_t)(4 * (i / 6) + (i % 6 < 3 ? i % 6 : i % 6 == 3 ? 0 : i % 6 - 2));
        scene_mesh(&s, scene_material(&s, 0, 0, 0), positions, way == 0 ? normals : NULL, NULL, way == 2 ? 36 : 24,
                   way == 2 ? NULL : indices, 36);
        sun = scene_sun(&s, 1, 2, 3);
        light = bake(&s, &desc);
        for (i = 0; light && i < (way == 2 ? 36 : 24); i++) {
            const double truth = fmax(0, v3_dot(sun, v3_from(normals + 3 * i)));
            CHECK(fabs((double)light[3 * i] - truth) < 1e-4, "way %d, vertex %d: R is %g, expected %g", way, i,
                  (double)light[3 * i], truth);
        }
        free(light);
        scene_free(&s);
    }
}

/* Bakes two halves of a floor under a lamp, in one mesh or two, whose normals at the common edge differ by an angle.
   Returns 1 if vertices at the edge get the same light, 0 if not, and -1 on failure. */
static int halves_are_one(double degrees, int of_one_mesh) {
    static const uint32_t indices[12] = { 0, 1, 2, 0, 2, 3, 4, 5, 6, 4, 6, 7 };
    static test_scene s;
    const sbl_vertices_desc desc = desc_of(SBL_MODE_DIRECT);
    const float c = (float)cos(degrees * REF_PI / 180), t = (float)sin(degrees * REF_PI / 180);
    const float positions[24] = { -1, 0, -1, -1, 0, 1, 0, 0, 1, 0, 0, -1, 0, 0, -1, -0.0f, 0, 1, 1, 0, 1, 1, 0, -1 };
    const float normals[24] = { 0, 1, 0, 0, 1, 0, 0, 1, 0, 0, 1, 0, t, c, 0, t, c, 0, t, c, 0, t, c, 0 };
    float *light;
    int one = -1;
    memset(&s, 0, sizeof s);
    scene_material(&s, 0.5f, 0.5f, 0.5f);
    if (of_one_mesh) scene_mesh(&s, 0, positions, normals, NULL, 8, indices, 12);
    else {
        scene_mesh(&s, 0, positions, normals, NULL, 4, indices, 6);
        scene_mesh(&s, 0, positions + 12, normals + 12, NULL, 4, indices, 6);
    }
    scene_quad(&s, scene_lamp(&s, 1, 1, 1), 0.5f, 0.5f, 0, 1, 0.5f, 0, 1, 0.5f, 0.7f, 0.5f, 0.5f, 0.7f);
    light = bake(&s, &desc);
    if (light) one = memcmp(light + 9, light + 12, 12) == 0 && memcmp(light + 6, light + 15, 12) == 0;
    free(light);
    scene_free(&s);
    return one;
}

/* Vertices of one mesh are joined if their positions are equal and their normals differ by at most 1 degree. */
TEST(seams_are_joined) {
    CHECK(halves_are_one(0, 1) == 1 && halves_are_one(0.5, 1) == 1 && halves_are_one(-0.9, 1) == 1,
          "vertices at a seam are not joined");
    CHECK(halves_are_one(1.2, 1) == 0 && halves_are_one(45, 1) == 0, "vertices at a hard edge are joined");
    CHECK(halves_are_one(0, 0) == 0, "vertices of two meshes are joined");
}

/* The same floor gets the same light with indices of each type and without indices. */
TEST(indices_of_all_types) {
    enum { SIDE = 6, VERTICES = 49, CORNERS = SIDE * SIDE * 6 };
    const sbl_vertices_desc desc = desc_of(SBL_MODE_DIRECT);
    float *first = NULL;
    int way, i, k;
    for (way = 0; way < 4; way++) {
        static test_scene s;
        sbl_mesh *mesh;
        const uint32_t *numbers;
        const float *p;
        float *light;
        memset(&s, 0, sizeof s);
        mesh = grid(&s, scene_material(&s, 0.5f, 0.5f, 0.5f), SIDE, 1.5f);
        numbers = (const uint32_t *)mesh->indices.data;
        p = (const float *)mesh->positions.data;
        if (way == 1 || way == 2) {
            uint8_t *bytes = (uint8_t *)scene_alloc(&s, 2 * CORNERS);
            for (i = 0; i < CORNERS; i++) {
                const uint16_t number = (uint16_t)numbers[i];
                if (way == 1) bytes[i] = (uint8_t)number;
                else memcpy(bytes + 2 * i, &number, 2);
            }
            mesh->indices.data = bytes;
            mesh->indices.type = way == 1 ? SBL_UINT8 : SBL_UINT16;
        }
        if (way == 3) {
            float *soup = (float *)scene_alloc(&s, CORNERS * 12);
            for (i = 0; i < CORNERS; i++) memcpy(soup + 3 * i, p + 3 * numbers[i], 12);
            mesh->indices.data = NULL;
            mesh->positions.data = soup;
            mesh->vertex_count = CORNERS;
        }
        scene_polygon(&s, scene_lamp(&s, 1, 1, 1), lamp_corners, 4);
        light = bake(&s, &desc);
        for (i = 0; light && first && i < CORNERS; i++) {
            const int at = way == 3 ? i : (int)numbers[i];
            for (k = 0; k < 3; k++)
                CHECK(fabs((double)light[3 * at + k] - (double)first[3 * numbers[i] + (uint32_t)k]) <=
                      (way == 3 ? 1e-4 : 0), "way %d, corner %d: R is %g, expected %g",
                      way, i, (double)light[3 * at + k], (double)first[3 * numbers[i] + (uint32_t)k]);
        }
        if (way == 0) first = light;
        else free(light);
        scene_free(&s);
    }
    free(first);
}

/* Vertices that no triangle uses, or only a degenerate one, have R = 0, even at the position of other vertices. */
TEST(vertices_without_triangles) {
    static const float p[27] = { 0, 0, 0, 0, 0, 1, 1, 0, 1, 0, 0, 0, 5, 5, 5, 2, 0, 0, 3, 0, 0, 4, 0, 0, 1, 0, 0 };
    static const uint32_t indices[12] = { 5, 6, 7, 0, 1, 2, 1, 1, 2, 0, 2, 8 };
    const sbl_vertices_desc desc = desc_of(SBL_MODE_DIRECT);
    int i, has_normals;
    for (has_normals = 0; has_normals < 2; has_normals++) {
        static test_scene s;
        float normals[27] = { 0 }, *light;
        memset(&s, 0, sizeof s);
        for (i = 0; i < 9; i++) normals[3 * i + 1] = 1;
        scene_mesh(&s, scene_material(&s, 0.5f, 0.5f, 0.5f), p, has_normals ? normals : NULL, NULL, 9, indices, 12);
        scene_sun(&s, 0, 1, 0);
        light = bake(&s, &desc);
        for (i = 0; light && i < 9; i++)
            CHECK(i < 3 || i == 8 ? fabs((double)light[3 * i] - 1) < 1e-4 : light[3 * i] == 0, "vertex %d: %g", i,
                  (double)light[3 * i]);
        free(light);
        scene_free(&s);
    }
}

/* Selected meshes are baked: all, two in reverse order, one twice, and one alone. The meshes are floors of different
   tilt, so that each has its own R. */
TEST(meshes_are_chosen) {
    static const int lists[4][4] = { { 0, 1, 2 }, { 2, 0 }, { 1, 0, 1, 2 }, { 1 } };
    static const int counts[4] = { 3, 2, 4, 1 }, corners[3] = { 4, 9, 16 };
    static test_scene s;
    sbl_vertices_desc desc = desc_of(SBL_MODE_DIRECT);
    int list, i, k;
    memset(&s, 0, sizeof s);
    scene_material(&s, 0.5f, 0.5f, 0.5f);
    for (i = 0; i < 3; i++) {
        sbl_mesh *mesh = grid(&s, 0, i + 1, 1);
        const float angle = 0.5f * (float)i;
        mesh->transform[0] = mesh->transform[5] = cosf(angle);
        mesh->transform[1] = sinf(angle);
        mesh->transform[4] = -sinf(angle);
        mesh->transform[10] = mesh->transform[15] = 1;
        mesh->transform[12] = 10 * (float)i;
    }
    scene_sun(&s, 0, 1, 0);
    REQUIRE(use_scene(&s), "no context");
    for (list = 0; list < 4; list++) {
        int vertices = 0, at = 0, meshes[4];
        float *light;
        for (i = 0; i < counts[list]; i++) vertices += corners[lists[list][i]];
        memcpy(meshes, lists[list], sizeof meshes);
        desc.meshes = meshes;
        desc.mesh_count = counts[list];
        light = bake_again(&desc, vertices);
        for (i = 0; i < counts[list]; i++)
            for (k = 0; k < corners[lists[list][i]] && light; k++, at++)
                CHECK(fabs((double)light[3 * at] - cos(0.5 * lists[list][i])) < 1e-4, "list %d, mesh %d: %g", list,
                      lists[list][i], (double)light[3 * at]);
        free(light);
    }
    scene_free(&s);
    REQUIRE(use_scene(&s), "no context");
    desc.meshes = NULL;
    desc.mesh_count = 0;
    CHECK(sbl_bake_vertices(context, &desc) == SBL_SUCCESS, "an empty scene is refused: %s", watch_last(&seen));
}

/* A mesh gets the same light, to the bit, in every list of meshes that contains it. The sky behind a roof makes noise,
   and the meshes need different numbers of iterations. */
TEST(meshes_do_not_depend_on_others) {
    enum { MESHES = 4 };
    static const int lists[4][5] = { { 0 }, { 3, 1 }, { 2, 0, 1, 2, 3 }, { 1, 3 } }, counts[4] = { 1, 2, 5, 2 };
    static const int sides[MESHES] = { 5, 12, 2, 7 };
    static test_scene s;
    sbl_vertices_desc desc = desc_of(SBL_MODE_DIRECT);
    int firsts[MESHES + 1] = { 0 }, list, i, way;
    memset(&s, 0, sizeof s);
    scene_material(&s, 0.5f, 0.5f, 0.5f);
    for (i = 0; i < MESHES; i++) {
        sbl_mesh *mesh = grid(&s, 0, sides[i], 0.3f + 0.5f * (float)i);
        mesh->transform[0] = mesh->transform[5] = mesh->transform[10] = mesh->transform[15] = 1;
        mesh->transform[13] = 0.25f * (float)i;
        firsts[i + 1] = firsts[i] + (sides[i] + 1) * (sides[i] + 1);
    }
    scene_sky(&s, 1, 0.5f, 0.25f);
    REQUIRE(use_scene(&s), "no context");
    for (way = 0; way < 3; way++) {
        float *all, *light;
        desc.meshes = NULL;
        desc.mesh_count = 0;
        desc.average = way == 1;
        desc.smoothing = way == 2 ? 10.0f : 0;
        all = bake_again(&desc, firsts[MESHES]);
        REQUIRE(all, "no light");
        CHECK(memcmp(all + 3 * firsts[0], all + 3 * firsts[2], 27 * sizeof *all) != 0, "two meshes have one light");
        for (list = 0; list < 4; list++) {
            int vertices = 0, at = 0;
            for (i = 0; i < counts[list]; i++)
                vertices += firsts[lists[list][i] + 1] - firsts[lists[list][i]];
            desc.meshes = lists[list];
            desc.mesh_count = counts[list];
            light = bake_again(&desc, vertices);
            for (i = 0; i < counts[list] && light; i++) {
                const int mesh = lists[list][i], count = firsts[mesh + 1] - firsts[mesh];
                CHECK(memcmp(light + 3 * at, all + 3 * firsts[mesh], 12 * (size_t)count) == 0,
                      "way %d, list %d: mesh %d has other light", way, list, mesh);
                at += count;
            }
            free(light);
        }
        free(all);
    }
    scene_free(&s);
}

/* >>measuring points */

/* The number of points of a triangle is proportional to its area. It is at least 4 (or `samples`, if this is less) and
   at most 8 * `samples`. Triangles that are large for the scene have more. Large bakes are gathered in batches of
   65,536 points. */
TEST(points_follow_area) {
    static const float p[18] = { 0, 0, 0, 0, 0, 1, 1, 0, 0, 5, 0, 0, 5, 0, 3, 6, 0, 0 };
    static const float away[9] = { 900, 0, 0, 900, 0, 1, 901, 0, 0 };
    static const struct { int samples, sensors[2]; } uses[4] = {
        { 8, { 4 + 12, 46 + 64 } }, { 1, { 1 + 2, 6 + 8 } }, { 100, { 50 + 150, 569 + 800 } }, { 3, { 3 + 5, 17 + 24 } }
    };
    static const int first = 0;
    static test_scene s;
    sbl_vertices_desc desc = desc_of(SBL_MODE_DIRECT);
    float *light;
    double worst;
    int i, alone;
    for (alone = 0; alone < 2; alone++) {
        memset(&s, 0, sizeof s);
        scene_mesh(&s, scene_material(&s, 0.5f, 0.5f, 0.5f), p, NULL, NULL, 6, NULL, 0);
        if (!alone) scene_mesh(&s, 0, away, NULL, NULL, 3, NULL, 0);
        scene_sun(&s, 0, 1, 0);
        desc.meshes = &first;
        desc.mesh_count = 1;
        for (i = 0; i < 4; i++) {
            desc.samples = uses[i].samples;
            light = use_scene(&s) ? bake_again(&desc, 6) : NULL;
            CHECK(light && sbl_query_stats(context).sensors.sites == uses[i].sensors[alone], "samples %d: %d points",
                  uses[i].samples, (int)sbl_query_stats(context).sensors.sites);
            free(light);
        }
        scene_free(&s);
    }
    desc = desc_of(SBL_MODE_DIRECT);
    /* one triangle is huge, and the others, more than a thousand, are small */
    scene_floor(&s, scene_material(&s, 0.5f, 0.5f, 0.5f), 0, 1);
    grid(&s, 0, 24, 0.01f);
    s.meshes[1].transform[0] = s.meshes[1].transform[5] = s.meshes[1].transform[10] = s.meshes[1].transform[15] = 1;
    s.meshes[1].transform[13] = 0.5f;
    {
        float *moved = (float *)scene_alloc(&s, 12 * 625);
        memcpy(moved, s.meshes[1].positions.data, 12 * 625);
        moved[0] = -100;
        s.meshes[1].positions.data = moved;
    }
    scene_sun(&s, 0, 1, 0);
    desc.samples = 8;
    light = bake(&s, &desc);
    CHECK(light && sbl_query_stats(context).sensors.sites == 16 + 64 + (24 * 24 * 2 - 1) * 4, "%d points",
          (int)sbl_query_stats(context).sensors.sites);
    free(light);
    scene_free(&s);
    desc.samples = 7;  /* several batches: the light of each point must reach its own vertices */
    worst = grid_under_a_lamp(100, desc);
    CHECK(sbl_query_stats(context).sensors.sites == 7 * 20000 + 2 * 56 && worst < 0.002, "%d points, off by %.3f %%",
          (int)sbl_query_stats(context).sensors.sites, 100 * worst);
}

/* >>buried vertices */

/* A black box on a floor under the sky extends slightly below the floor. The interpolated light around it is right.
   Vertices below the box get the light of adjacent vertices and do not darken it. */
TEST(buried_vertices_do_not_darken) {
    enum { SIDE = 20, FINE = 200 };
    int average;
    for (average = 0; average < 2; average++) {
        static test_scene s;
        static const double half = 0.625;
        sbl_vertices_desc desc = desc_of(SBL_MODE_DIRECT);
        const float low = (float)-half, high = (float)half;
        const double box[4][2] = { { -half, -half }, { half, -half }, { half, half }, { -half, half } };
        double squares = 0, mean = 0;
        float *light, darkest = 1;
        int x, y, side, count = 0;
        memset(&s, 0, sizeof s);
        grid(&s, scene_material(&s, 0, 0, 0), SIDE, 2);
        scene_box(&s, 0, low, -0.1f, low, high, 0.7f, high);
        scene_sky(&s, 1, 1, 1);
        desc.average = average;
        light = bake(&s, &desc);
        for (y = 0; y < FINE && light; y++)
            for (x = 0; x < FINE; x++) {
                const double px = 4 * (x + 0.5) / FINE - 2, pz = 4 * (y + 0.5) / FINE - 2, u = (px + 2) / 4 * SIDE,
                    v = (pz + 2) / 4 * SIDE;
                const double fu = u - floor(u), fv = v - floor(v);
                const int a = (int)v * (SIDE + 1) + (int)u, b = a + SIDE + 1;
                const double drawn = fv > fu ? (1 - fv) * (double)light[3 * a] + (fv - fu) * (double)light[3 * b] + fu *
                    (double)light[3 * (b + 1)]
                                             : (1 - fu) * (double)light[3 * a] + (fu - fv) *
                                                 (double)light[3 * (a + 1)] + fv * (double)light[3 * (b + 1)];
                double truth = 1;
                if (fabs(px) < half + 0.02 && fabs(pz) < half + 0.02) continue;
                for (side = 0; side < 4; side++) {
                    const double *p = box[side], *q = box[(side + 1) % 4];
                    const v3 wall[4] = { v3_of(p[0], 0, p[1]), v3_of(p[0], 0.7, p[1]), v3_of(q[0], 0.7, q[1]),
                        v3_of(q[0], 0, q[1]) };
                    if ((px - p[0]) * (q[1] - p[1]) - (pz - p[1]) * (q[0] - p[0]) > 0)
                        truth -= fabs(ref_polygon(v3_of(px, 0, pz), v3_of(0, 1, 0), wall, 4));
                }
                squares += (drawn - truth) * (drawn - truth);
                mean += truth;
                count++;
            }
        for (y = 0; y <= SIDE && light; y++)
            for (x = 0; x <= SIDE; x++) darkest = fminf(darkest, light[3 * (y * (SIDE + 1) + x)]);
        printf("  %s: %.2f %% rms around the box, the darkest vertex %.2f\n", average ? "averages" : "least squares",
               100 * sqrt(squares / count) / (mean / count),
               (double)darkest);
        CHECK(light && sqrt(squares / count) < (average ? 0.04 : 0.02) * (mean / count), "off by %.2f %% rms",
              100 * sqrt(squares / count) / (mean / count));
        CHECK(darkest > 0.3f, "a vertex is dark: %g", (double)darkest);
        free(light);
        scene_free(&s);
    }
}

/* A thin slab buries a part of a floor. A vertical sun lights all other points equally. Vertices whose triangles have
   only few valid points get the same light, with and without smoothing. */
TEST(few_points_are_enough) {
    int run, i;
    for (run = 0; run < 3; run++) {
        static test_scene s;
        sbl_vertices_desc desc = desc_of(SBL_MODE_DIRECT);
        float *light;
        memset(&s, 0, sizeof s);
        grid(&s, scene_material(&s, 0, 0, 0), 4, 1);
        scene_box(&s, 0, -1.1f, -0.1f, -1.1f, 0.1f, 0.001f, 0.15f);
        scene_sun(&s, 0, 1, 0);
        desc.average = run == 2;
        desc.smoothing = run ? 0 : -1;
        light = bake(&s, &desc);
        CHECK(light, "no light: %s", watch_last(&seen));
        for (i = 0; light && i < 25; i++)
            CHECK(fabs((double)light[3 * i] - 1) < 0.001, "run %d: R of vertex %d is %g", run, i, (double)light[3 * i]);
        free(light);
        scene_free(&s);
    }
}

/* A room that is modelled inside out has the same light as a normal room. A floor that is buried completely is dark. */
TEST(only_backs_are_seen) {
    enum { SIDE = 24 };
    static test_scene s;
    sbl_vertices_desc desc = desc_of(SBL_MODE_DIRECT);
    double error;
    float *light;
    int i, k;
    memset(&s, 0, sizeof s);
    k = scene_material(&s, 0, 0, 0);
    grid(&s, k, SIDE, 1.5f);
    scene_box(&s, k, -3, -0.1f, -3, 3, 0.5001f, 3);  /* the walls face outwards */
    scene_polygon(&s, scene_lamp(&s, 1, 1, 1), lamp_corners, 4);
    light = bake(&s, &desc);
    CHECK(sbl_query_stats(context).sensors.sites >= 2 * SIDE * SIDE && sbl_query_stats(context).sensors.invalid == 0,
          "%d of %d points are invalid", (int)sbl_query_stats(context).sensors.invalid,
          (int)sbl_query_stats(context).sensors.sites);
    error = light ? grid_error(light, SIDE, 1.5) : 1;
    CHECK(error < 0.01, "a room inside out is off by %.2f %%", 100 * error);
    free(light);
    s.mesh_count--;
    scene_sky(&s, 1, 1, 1);
    light = bake(&s, &desc);
    for (i = 0; light && i < 3 * (SIDE + 1) * (SIDE + 1); i++)
        CHECK(light[i] == 0, "vertex %d is buried, but R is %g", i / 3, (double)light[i]);
    free(light);
    scene_free(&s);
}

/* A point that sees a back face, but much of the sky beside it, is not inside anything: its light counts. A small roof
   above a corner of a floor makes the corner as dark if it faces up as if it faces down. */
TEST(points_beside_back_faces_count) {
    enum { SIDE = 16, VERTICES = (SIDE + 1) * (SIDE + 1) };
    static const float down[12] = { -4, 0.3f, -4, -3.5f, 0.3f, -4, -3.5f, 0.3f, -3.5f, -4, 0.3f, -3.5f };
    static const float up[12] = { -4, 0.3f, -3.5f, -3.5f, 0.3f, -3.5f, -3.5f, 0.3f, -4, -4, 0.3f, -4 };
    static test_scene s;
    sbl_vertices_desc desc = desc_of(SBL_MODE_DIRECT);
    float *light[2];
    double worst = 0;
    int i, k;
    for (k = 0; k < 2; k++) {
        memset(&s, 0, sizeof s);
        grid(&s, scene_material(&s, 0, 0, 0), SIDE, 4);
        scene_polygon(&s, 0, k ? up : down, 4);
        scene_sky(&s, 1, 1, 1);
        light[k] = bake(&s, &desc);
        scene_free(&s);
    }
    for (i = 0; light[0] && light[1] && i < 3 * VERTICES; i++)
        worst = fmax(worst, fabs((double)light[0][i] - (double)light[1][i]));
    CHECK(light[0] && light[1] && light[0][0] < 0.9f && worst < 0.02, "R differs by up to %g; in the corner it is %g",
          worst, light[0] ? (double)light[0][0] : 0);
    for (k = 0; k < 2; k++) free(light[k]);
}

/* >>invalid descriptors */

static void refused(sbl_vertices_desc desc, const char *word) {
    const sbl_result result = sbl_begin_vertices(context, &desc);
    CHECK(result == SBL_ERROR_INVALID_ARGUMENT, "%s: %s", word, sbl_result_string(result));
    CHECK(watch_said(&seen, SBL_LOG_ERROR, SBL_LOG_ITEM_INVALID_VERTICES_DESC, "sbl_vertices_desc", word, NULL),
          "%s: %s", word, watch_last(&seen));
    watch_forget(&seen);
}

/* Invalid values of every field of sbl_vertices_desc are refused. The message names the field and the value. */
TEST(every_field_is_checked) {
    static test_scene s;
    static const int meshes[3] = { 0, 1, 7 };
    static float light[24];
    sbl_vertices_desc good = desc_of(SBL_MODE_DIRECT), d;
    memset(&s, 0, sizeof s);
    scene_floor(&s, scene_material(&s, 0.5f, 0.5f, 0.5f), 0, 1);
    scene_floor(&s, 0, 2, 1);
    REQUIRE(use_scene(&s), "no context");
    good.radiance = light;
    good.float_count = 24;
    CHECK(sbl_begin_vertices(context, &good) == SBL_SUCCESS, "%s", watch_last(&seen));
    d = good; d.radiance = NULL; refused(d, "radiance");
    d = good; d.float_count = 23; refused(d, "float_count is 23");
    d = good; d.samples = -1; refused(d, "samples");
    d = good; d.samples = 1025; refused(d, "samples");
    d = good; d.average = 2; refused(d, "average");
    d = good; d.smoothing = (float)NAN; refused(d, "smoothing");
    d = good; d.smoothing = 2e6f; refused(d, "smoothing");
    d = good; d.options.mode = SBL_MODE_PAPER; refused(d, "SBL_MODE_PAPER");
    d = good; d.options.mode = (sbl_mode)99; refused(d, "options.mode");
    d = good; d.options.preset = (sbl_preset)-1; refused(d, "options.preset");
    d = good; d.options.backend = (sbl_backend)77; refused(d, "options.backend");
    d = good; d.options.rays = 5000; refused(d, "options.rays");
    d = good; d.options.sensor_size = 1; refused(d, "options.sensor_size");
    d = good; d.options.epsilon = (float)NAN; d.options.mode = SBL_MODE_AMBIENT; refused(d, "options.epsilon");
    d = good; d.start_canary = 1; refused(d, "start_canary");
    d = good; d.end_canary = 1; refused(d, "end_canary");
    d = good; d.mesh_count = 1; refused(d, "mesh_count");
    d = good; d.meshes = meshes; d.mesh_count = -1; refused(d, "mesh_count");
    d = good; d.meshes = meshes; d.mesh_count = 3; refused(d, "meshes[2]");
    d = good; d.meshes = meshes; d.mesh_count = 1; d.float_count = 11; refused(d, "count is 11");
    CHECK(sbl_progress(context) == 0 && sbl_step(context, 0) == SBL_SUCCESS && sbl_progress(context) == 1,
          "a refused descriptor ended the bake in progress");
    CHECK(sbl_begin_vertices(NULL, &good) == SBL_ERROR_INVALID_ARGUMENT &&
              sbl_bake_vertices(NULL, NULL) == SBL_ERROR_INVALID_ARGUMENT,
          "NULL is accepted");
    CHECK(sbl_bake_vertices(context, NULL) == SBL_ERROR_INVALID_ARGUMENT &&
              watch_said(&seen, SBL_LOG_ERROR, SBL_LOG_ITEM_INVALID_VERTICES_DESC, "radiance", NULL, NULL),
          "%s", watch_last(&seen));
    d = sbl_vertices_desc_defaults(NULL);
    CHECK(d.options.mode == SBL_MODE_GI && d.samples == 8 && d.options.rays == 64 && !d.average && d.smoothing == 0.02f,
          "samples %d, rays %d, smoothing %g", d.samples, d.options.rays, (double)d.smoothing);
    sbl_destroy(context);
    {
        const sbl_context_desc desc = watch_desc(&seen);
        REQUIRE(sbl_create(&desc, &context) == SBL_SUCCESS, "no context");
    }
    CHECK(sbl_begin_vertices(context, &good) == SBL_ERROR_STATE, "a bake begins without a scene");
    scene_free(&s);
}

/* >>time slices */

static void small_scene(test_scene *s) {
    memset(s, 0, sizeof *s);
    grid(s, scene_material(s, 0.6f, 0.5f, 0.4f), 10, 1);
    scene_sphere(s, 0, 0, 0.3f, 0, 0.35f, 16, 8, 1);
    scene_sky(s, 1, 0.5f, 0.2f);
}

static int calls;
static int cancel(float done, void *user) { calls++; return done >= *(const float *)user; }

/* A bake in short time slices equals one in a single call, to the bit. It can be cancelled, and setting another scene
   ends it. A finished picture stays readable during the bake, and its sensors can be inspected. */
TEST(short_steps_give_the_same_light) {
    static test_scene s;
    static float pieces[3 * 300], picture[2][20 * 20 * 3];
    sbl_vertices_desc desc = desc_of(SBL_MODE_GI);
    sbl_picture_desc view = scene_view(20, 20, 40, 0, 2, 3, 0, 0, 0);
    sbl_sensor sensor;
    sbl_scene_desc scene;
    sbl_result result = SBL_UNFINISHED;
    float *whole, last = 0, stop;
    int steps = 0, inspected = 0, blocks, place, count;
    small_scene(&s);
    count = vertices_of(&s);
    scene = scene_desc(&s);
    whole = bake(&s, &desc);
    REQUIRE(whole && count <= 300, "no light");
    desc.radiance = pieces;
    desc.float_count = 3 * (size_t)count;
    CHECK(sbl_render_picture(context, &view) == SBL_SUCCESS &&
              sbl_read_channel(context, SBL_CHANNEL_FINAL, picture[0], 1200) == SBL_SUCCESS,
          "%s", watch_last(&seen));
    CHECK(sbl_begin_vertices(context, &desc) == SBL_SUCCESS, "%s", watch_last(&seen));
    while (result == SBL_UNFINISHED) {
        result = sbl_step(context, 1e-6);
        if (++steps % 5 == 0 && result == SBL_UNFINISHED)
            inspected += sbl_inspect_sensor(context, 10, 10, &sensor, NULL, NULL, 0) == SBL_SUCCESS;
        CHECK(sbl_progress(context) >= last, "progress decreases from %g", (double)last);
        last = sbl_progress(context);
    }
    CHECK(result == SBL_SUCCESS && steps > 40 && inspected > 5 && last == 1, "%s, %d steps, %d inspected",
          sbl_result_string(result), steps, inspected);
    CHECK(memcmp(whole, pieces, sizeof *whole * 3 * (size_t)count) == 0, "the bake in slices differs");
    CHECK(sbl_step(context, 0) == SBL_SUCCESS, "the bake is not finished");
    CHECK(sbl_read_channel(context, SBL_CHANNEL_FINAL, picture[1], 1200) == SBL_SUCCESS &&
          !memcmp(picture[0], picture[1], sizeof picture[0]), "the picture differs");
    free(whole);

    sbl_end(context);
    CHECK(sbl_progress(context) == 0, "progress is not 0 after sbl_end");
    blocks = seen.blocks;
    desc.options.progress = cancel;
    desc.options.progress_user = &stop;
    for (stop = 0; stop <= 1; stop += 0.0625f) {
        memset(pieces, 0, sizeof pieces);
        result = sbl_bake_vertices(context, &desc);
        CHECK(result == SBL_CANCELLED, "cancelled at %g: %s", (double)stop, sbl_result_string(result));
        CHECK(stop == 1 || pieces[0] == 0, "cancelled at %g, but light was written", (double)stop);
        CHECK(seen.blocks <= blocks, "cancelled at %g: %d more blocks in use", (double)stop, seen.blocks - blocks);
        CHECK(sbl_step(context, 0) == SBL_ERROR_STATE, "the bake continues");
    }
    CHECK(calls > 30, "progress was called %d times", calls);
    desc.options.progress = NULL;
    for (place = 0; place < 60; place += 3) {  /* at every stage of the bake */
        const int way = place / 3 % 4;
        float m[16] = { 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0.1f, 0, 1 };
        CHECK(sbl_begin_vertices(context, &desc) == SBL_SUCCESS, "%s", watch_last(&seen));
        for (steps = 0; steps < place; steps++) result = sbl_step(context, 1e-6);
        if (result != SBL_UNFINISHED) break;
        if (way == 0) result = sbl_set_scene(context, &scene);
        else if (way == 1) result = sbl_set_mesh_transform(context, 1, m);
        else if (way == 2) result = sbl_set_materials(context, s.materials, s.material_count);
        else { result = SBL_SUCCESS; sbl_end(context); }
        CHECK(result == SBL_SUCCESS && sbl_step(context, 0) == SBL_ERROR_STATE,
              "way %d: the bake continues after sbl_set_scene",
              way);
    }
    CHECK(sbl_set_scene(context, &scene) == SBL_SUCCESS, "%s", watch_last(&seen));
    CHECK(sbl_begin_vertices(context, &desc) == SBL_SUCCESS && sbl_step(context, 1e-6) == SBL_UNFINISHED, "%s",
          watch_last(&seen));
    CHECK(sbl_render_picture(context, &view) == SBL_SUCCESS, "%s", watch_last(&seen));
    CHECK(sbl_begin_vertices(context, &desc) == SBL_SUCCESS && sbl_step(context, 1e-6) == SBL_UNFINISHED, "%s",
          watch_last(&seen));
    scene_free(&s);
}

static int meddled;
static int meddle(float done, void *user) {
    (void)done;
    meddled += sbl_bake_vertices(context, (const sbl_vertices_desc *)user) == SBL_ERROR_STATE;
    meddled += sbl_begin_vertices(context, NULL) == SBL_ERROR_STATE;
    calls++;
    return 0;
}

/* Calls from the progress callback are refused and change nothing. Another seed changes the light. */
TEST(callbacks_and_seeds) {
    static test_scene s;
    sbl_vertices_desc desc = desc_of(SBL_MODE_DIRECT);
    float *light[3];
    int count, i;
    small_scene(&s);
    count = vertices_of(&s);
    light[0] = bake(&s, &desc);
    calls = 0;
    desc.options.progress = meddle;
    desc.options.progress_user = &desc;
    light[1] = bake_again(&desc, count);
    CHECK(calls > 5 && meddled == 2 * calls, "refused %d times in %d calls", meddled, calls);
    desc.options.progress = NULL;
    desc.options.seed = 7;
    light[2] = bake_again(&desc, count);
    if (light[0] && light[1] && light[2]) {
        CHECK(memcmp(light[0], light[1], 12 * (size_t)count) == 0, "refused calls changed the light");
        CHECK(memcmp(light[0], light[2], 12 * (size_t)count) != 0, "the seed has no effect");
    }
    for (i = 0; i < 3; i++) free(light[i]);
    scene_free(&s);
}

static sbl_result vertices_call(const void *desc) {
    return sbl_bake_vertices(context, (const sbl_vertices_desc *)desc);
}

/* Each allocation fails once, in turn. The bake must fail with a message and without a leak, and the next bake must
   succeed. */
TEST(memory_runs_out) {
    static test_scene s;
    static float light[3 * 300];
    sbl_vertices_desc desc = desc_of(SBL_MODE_DIRECT);
    int failed = 0, average;
    for (average = 0; average < 2; average++) {
        small_scene(&s);
        REQUIRE(use_scene(&s), "no context");
        desc.radiance = light;
        desc.float_count = 900;
        desc.average = average;
        failed += each_allocation_fails(vertices_call, &desc, NULL, light, sizeof light);
        scene_free(&s);
    }
    CHECK(failed > 30, "%d allocations failed", failed);
}

int main(void) {
    RUN(a_floor_under_a_lamp);
    RUN(scenes_of_all_sizes);
    RUN(smoothing_leaves_slopes_alone);
    RUN(a_furnace);
    RUN(light_falls_on_the_front);
    RUN(a_ball_in_the_sun);
    RUN(hard_edges_are_kept);
    RUN(seams_are_joined);
    RUN(indices_of_all_types);
    RUN(vertices_without_triangles);
    RUN(meshes_are_chosen);
    RUN(meshes_do_not_depend_on_others);
    RUN(points_follow_area);
    RUN(buried_vertices_do_not_darken);
    RUN(few_points_are_enough);
    RUN(only_backs_are_seen);
    RUN(points_beside_back_faces_count);
    RUN(every_field_is_checked);
    RUN(short_steps_give_the_same_light);
    RUN(callbacks_and_seeds);
    RUN(memory_runs_out);
    sbl_destroy(context);
    CHECK(seen.blocks == 0 && seen.strangers == 0, "%d blocks are not freed, %d were freed twice or never allocated",
          seen.blocks, seen.strangers);
    return test_report() || test_errors;
}
