/* Tests bounced light (SBL_MODE_GI). R is compared with closed forms, energy balances, radiosity and a path tracer. The
   tests also check that walls block light, and when the store is rebuilt. */
#include "../sbl.h"
#include "support/test.h"
#include "support/scenes.h"
#include "support/gl_watch.h"
#include "support/inside.h"
#include "../examples/host_gl.h"

enum { MOST_SITES = 2048 };

static watch seen;
static sbl_context *context;
static sbl_site sites[MOST_SITES];
static sbl_reading readings[MOST_SITES];
static double areas[MOST_SITES];  /* area that each site represents */
static int site_count;

/* Sets the scene in the context that all tests share. Returns 0 on failure. samples: max_bounce_cells; 0 is the
   default */
static int use_scene(const test_scene *s, int samples) {
    const sbl_context_desc desc = watch_desc(&seen);
    sbl_scene_desc scene = scene_desc(s);
    scene.max_bounce_cells = samples;
    if (!context && sbl_create(&desc, &context) != SBL_SUCCESS) context = NULL;
    if (context && sbl_set_scene(context, &scene) == SBL_SUCCESS) return 1;
    CHECK(0, "no context or scene: %s", watch_last(&seen));
    return 0;
}

static void add_site(double x, double y, double z, double nx, double ny, double nz, double area) {
    sbl_site *s = &sites[site_count];
    if (site_count == MOST_SITES) abort();
    memset(s, 0, sizeof *s);
    s->position[0] = (float)x; s->position[1] = (float)y; s->position[2] = (float)z;
    s->normal[0] = (float)nx; s->normal[1] = (float)ny; s->normal[2] = (float)nz;
    areas[site_count++] = area;
}

/* Adds n x n sites at the centres of the cells of a parallelogram. Their normal is along u x v. corner, u, v: a corner
   and two edges of the parallelogram */
static void add_sites(const double corner[3], const double u[3], const double v[3], int n) {
    double normal[3], area;
    int i, j, k;
    for (k = 0; k < 3; k++) normal[k] = u[(k + 1) % 3] * v[(k + 2) % 3] - u[(k + 2) % 3] * v[(k + 1) % 3];
    area = sqrt(normal[0] * normal[0] + normal[1] * normal[1] + normal[2] * normal[2]);
    for (i = 0; i < n; i++)
        for (j = 0; j < n; j++) {
            const double a = (i + 0.5) / n, b = (j + 0.5) / n;
            add_site(corner[0] + a * u[0] + b * v[0], corner[1] + a * u[1] + b * v[1], corner[2] + a * u[2] + b * v[2],
                     normal[0] / area, normal[1] / area, normal[2] / area, area / (n * n));
        }
}

/* Adds n x n sites on each face of a box, facing inwards. Each represents its share of the area of the face. */
static void add_sites_in_box(double x0, double y0, double z0, double x1, double y1, double z1, int n) {
    const double low[3] = { x0, y0, z0 }, high[3] = { x1, y1, z1 };
    int axis, side, k;
    for (axis = 0; axis < 3; axis++)
        for (side = 0; side < 2; side++) {
            double corner[3], u[3] = { 0, 0, 0 }, v[3] = { 0, 0, 0 };
            const int a = (axis + (side ? 2 : 1)) % 3, b = (axis + (side ? 1 : 2)) % 3;
            for (k = 0; k < 3; k++) corner[k] = low[k];
            if (side) corner[axis] = high[axis];
            u[a] = high[a] - low[a];
            v[b] = high[b] - low[b];
            add_sites(corner, u, v, n);
        }
}

static void scale_sites(float scale) {
    int i, k;
    for (i = 0; i < site_count; i++) {
        for (k = 0; k < 3; k++) sites[i].position[k] *= scale;
        areas[i] *= (double)scale * (double)scale;
    }
}

/* Returns a descriptor that measures R at all sites. */
static sbl_readings_desc readings_of(sbl_mode mode, sbl_backend backend) {
    sbl_readings_desc desc = scene_readings(sites, readings, site_count, mode);
    desc.options.backend = backend;
    return desc;
}

/* Measures R at the sites that add_site has made, and stores it in `readings`. Returns 0 on failure. */
static int gather(sbl_mode mode, sbl_backend backend, int rays) {
    sbl_readings_desc desc = readings_of(mode, backend);
    sbl_result result;
    memset(readings, 0xff, sizeof readings);
    desc.options.rays = rays;
    desc.options.sensor_size = 32;
    result = sbl_gather_readings(context, &desc);
    CHECK(result == SBL_SUCCESS, "no readings: %s", watch_last(&seen));
    return result == SBL_SUCCESS;
}

/* mean_of returns the area-weighted mean of R, and most_of its maximum, over the sites from `from` to to - 1. */
static double mean_of(int from, int to, int channel) {
    double sum = 0, area = 0;
    int i;
    for (i = from; i < to; i++) { sum += areas[i] * (double)readings[i].radiance[channel]; area += areas[i]; }
    return sum / area;
}

static double most_of(int from, int to) {
    double most = 0;
    int i, k;
    for (i = from; i < to; i++) for (k = 0; k < 3; k++) most = test_max(most, (double)readings[i].radiance[k]);
    return most;
}

/* >>skies */

/* A wall that only a sky picture lights, with a sun in one texel; behind the wall, the picture is black. The wall's R
   is a sum over the texels: radiance times solid angle times cosine. From afar, sites see it in stored light. */
TEST(a_wall_in_the_light_of_a_picture) {
    enum { ACROSS = 32, DOWN = 16, SUN = 5 * ACROSS + 22 };
    static float pixels[ACROSS * DOWN * 3];
    const double step = TEST_PI / DOWN, half = 4;  /* half the wall's side, in units of the sites' distance */
    const double corner = half / sqrt(1 + half * half), form = 4 / TEST_PI * corner * atan(corner);
    double expected[3] = { 0, 0, 0 };
    test_scene s = { 0 };
    int i, k;
    for (i = 0; i < ACROSS * DOWN; i++) {
        const double around = 2 * TEST_PI * ((i % ACROSS + 0.5) / ACROSS - 0.5), polar = step * (i / ACROSS + 0.5);
        /* the integral of the cosine over the texel's solid angle */
        const double cosine = sin(0.5 * 2 * TEST_PI / ACROSS) * sin(around) * (step - cos(2 * polar) * sin(step));
        for (k = 0; k < 3 && cosine > 0; k++) {
            pixels[3 * i + k] = i == SUN ? 400 : (float)(1 + 0.5 * cos(around - k));
            expected[k] += 0.5 * form * (double)pixels[3 * i + k] * cosine / TEST_PI;
        }
    }
    scene_quad(&s, scene_material(&s, 0.5f, 0.5f, 0.5f), -40, -40, 0, 40, -40, 0, 40, 40, 0, -40, 40, 0);
    s.environment.picture.pixels = pixels;
    s.environment.picture.format = SBL_PIXELS_FLOAT;
    s.environment.picture.width = ACROSS;
    s.environment.picture.height = DOWN;
    s.environment.picture.channels = 3;
    site_count = 0;
    for (i = 0; i < 16; i++) add_site(0, 0, 40 / half, 0, 0, -1, 1);
    if (use_scene(&s, 4096) && gather(SBL_MODE_GI, SBL_BACKEND_TRACE, 1024))
        for (k = 0; k < 3; k++) {
            printf("  R before the wall: %.4f, expected %.4f\n", mean_of(0, site_count, k), expected[k]);
            CHECK(fabs(mean_of(0, site_count, k) / expected[k] - 1) < 0.02, "channel %d: R is %g, expected %g", k,
                  mean_of(0, site_count, k), expected[k]);
        }
    scene_free(&s);
}

/* >>leaks */

static const float scales[] = { 1e-2f, 1, 1e3f };
static const int budgets[] = { 1024, 8192, 49152 };

/* Makes a room of 4 x 3 x 4 with a lamp below its ceiling. */
static void lit_room(test_scene *s) {
    scene_box(s, scene_material(s, 0.7f, 0.6f, 0.5f), 0, 0, 0, 4, 3, 4);
    scene_quad(s, scene_lamp(s, 5, 5, 5), 0.7f, 2.9f, 0.8f, 1.7f, 2.9f, 0.8f, 1.7f, 2.9f, 1.8f, 0.7f, 2.9f, 1.8f);
}

static void box_of_slabs(test_scene *s, int material, float x0, float y0, float z0, float x1, float y1, float z1,
                         float t) {
    scene_box(s, material, x0 - t, y0 - t, z0 - t, x1 + t, y0, z1 + t);
    scene_box(s, material, x0 - t, y1, z0 - t, x1 + t, y1 + t, z1 + t);
    scene_box(s, material, x0 - t, y0, z0, x0, y1, z1);
    scene_box(s, material, x1, y0, z0, x1 + t, y1, z1);
    scene_box(s, material, x0 - t, y0, z0 - t, x1 + t, y1, z0);
    scene_box(s, material, x0 - t, y0, z1, x1 + t, y1, z1 + t);
}

/* Adds a box without a bottom: four sides and a top. */
static void box_without_bottom(test_scene *s, int material, float x0, float y0, float z0, float x1, float y1,
                               float z1) {
    scene_box(s, material, x0, y0, z0, x1, y1, z1);
    s->meshes[s->mesh_count - 4] = s->meshes[s->mesh_count - 1];
    s->mesh_count--;
}

/* Rotates the vertices of a mesh about the y axis, then translates them. */
static void turn_mesh(test_scene *s, sbl_mesh *m, double angle, float x, float y, float z) {
    const float *from = (const float *)m->positions.data, c = (float)cos(angle), d = (float)sin(angle);
    float *to = (float *)scene_alloc(s, sizeof *to * 3 * (size_t)m->vertex_count);
    int i;
    for (i = 0; i < 3 * m->vertex_count; i += 3) {
        to[i] = c * from[i] + d * from[i + 2] + x;
        to[i + 1] = from[i + 1] + y;
        to[i + 2] = c * from[i + 2] - d * from[i] + z;
    }
    m->positions.data = to;
}

/* Divides each triangle of a mesh into four, `times` times. Afterwards the mesh has no indices. */
static void divide_mesh(test_scene *s, sbl_mesh *m, int times) {
    for (; times > 0; times--) {
        const float *from = (const float *)m->positions.data;
        const uint32_t *indices = (const uint32_t *)m->indices.data;
        const int count = m->index_count ? m->index_count / 3 : m->vertex_count / 3;
        float *to = (float *)scene_alloc(s, sizeof *to * 36 * (size_t)count);
        int i, j, k;
        for (i = 0; i < count; i++) {
            static const int pairs[12][2] = {
                { 0, 0 }, { 0, 1 }, { 0, 2 }, { 0, 1 }, { 1, 1 }, { 1, 2 },
                { 0, 2 }, { 1, 2 }, { 2, 2 }, { 0, 1 }, { 1, 2 }, { 0, 2 } };
            for (j = 0; j < 12; j++)
                for (k = 0; k < 3; k++) {
                    const size_t a = (size_t)(3 * i + pairs[j][0]), b = (size_t)(3 * i + pairs[j][1]);
                    to[36 * i + 3 * j + k] = 0.5f * (from[3 * (m->index_count ? indices[a] : a) + (size_t)k] +
                                                     from[3 * (m->index_count ? indices[b] : b) + (size_t)k]);
                }
        }
        m->positions.data = to;
        m->vertex_count = 12 * count;
        m->index_count = 0;
        memset(&m->indices, 0, sizeof m->indices);
        memset(&m->texcoords, 0, sizeof m->texcoords);
    }
}

static void leak_scene(test_scene *s, int kind) {
    int grey, material, i;
    if (kind < 5) lit_room(s);
    grey = scene_material(s, 0.8f, 0.8f, 0.8f);
    switch (kind) {
        case 0: scene_box(s, grey, 1.53f, 0.51f, 1.37f, 2.12f, 1.1f, 2.03f); break;
        case 1:
            scene_box(s, grey, 1.53f, 0.51f, 1.37f, 2.12f, 1.1f, 2.03f);
            scene_box(s, grey, 1.5f, 0.48f, 1.34f, 2.15f, 1.13f, 2.06f);
            break;
        case 2: box_of_slabs(s, grey, 1.53f, 0.51f, 1.37f, 2.12f, 1.1f, 2.03f, 0.04f); break;
        case 3: box_without_bottom(s, grey, 1.53f, 0, 1.37f, 2.12f, 0.6f, 2.03f); break;
        case 4:  /* a rotated box of small triangles */
            box_without_bottom(s, grey, -0.3f, 0, -0.2f, 0.3f, 0.6f, 0.2f);
            for (i = s->mesh_count - 5; i < s->mesh_count; i++) {
                turn_mesh(s, &s->meshes[i], 0.5, 2, 0, 1.7f);
                divide_mesh(s, &s->meshes[i], 4);
            }
            break;
        case 8:  /* ground that only the sun and a box see */
            scene_quad(s, grey, -20, 0, -20, -20, 0, 20, 20, 0, 20, 20, 0, -20);
            box_without_bottom(s, grey, 1.53f, 0, 1.37f, 2.12f, 0.6f, 2.03f);
            scene_light(s, SBL_LIGHT_DIRECTIONAL, 3, 3, 3)->direction[1] = -1;
            break;
        case 9:  /* a room that the plane x + z = 3.9 divides */
            scene_box(s, scene_material(s, 0.7f, 0.6f, 0.5f), 0, 0, 0, 4, 3, 4);
            scene_quad(s, scene_lamp(s, 5, 5, 5), 0.7f, 2.9f, 0.8f, 1.7f, 2.9f, 0.8f, 1.7f, 2.9f, 1.8f, 0.7f, 2.9f,
                       1.8f);
            scene_quad(s, grey, 3.9f, 0, 0, 3.9f, 3, 0, 0, 3, 3.9f, 0, 0, 3.9f);
            break;
        default:  /* two rooms */
            scene_box(s, scene_material(s, 0.7f, 0.6f, 0.5f), 0, 0, 0, 8, 3, 4);
            material = scene_lamp(s, 5, 5, 5);
            scene_quad(s, material, 0.7f, 2.9f, 0.8f, 1.7f, 2.9f, 0.8f, 1.7f, 2.9f, 1.8f, 0.7f, 2.9f, 1.8f);
            if (kind == 5) scene_quad(s, grey, 3.87f, 0, 0, 3.87f, 3, 0, 3.87f, 3, 4, 3.87f, 0, 4);
            else scene_quad(s, grey, 3.87f, 0, 0, 3.87f, 3, 0, 2.93f, 3, 4, 2.93f, 0, 4);
            if (kind == 7) divide_mesh(s, &s->meshes[s->mesh_count - 1], 5);
    }
}

/* Adds sites on the floor, the ceiling, a wall and the plane x + z = 3.9, on the side where x + z is larger. */
static void add_sites_behind_slanted_wall(int n) {
    int i, j;
    for (i = 0; i < n; i++)
        for (j = 0; j < n; j++) {
            const double x = 3.9 * (i + 0.5) / n, z = 3.9 - x + (0.1 + x) * (j + 0.3) / n, y = 3 * (j + 0.5) / n;
            add_site(x, 0, z, 0, 1, 0, 1);
            add_site(x, 3, z, 0, -1, 0, 1);
            add_site(4, y, x, -1, 0, 0, 1);
            add_site(x, y, 3.9 - x, sqrt(0.5), 0, sqrt(0.5), 1);
        }
}

static void leak_sites(int kind, int n) {
    site_count = 0;
    if (kind < 3) add_sites_in_box(1.53, 0.51, 1.37, 2.12, 1.1, 2.03, n);
    else if (kind == 3 || kind == 8) add_sites_in_box(1.53, 0, 1.37, 2.12, 0.6, 2.03, n);
    else if (kind == 4) add_sites_in_box(2 - 0.15, 0, 1.7 - 0.1, 2 + 0.15, 0.6, 1.7 + 0.1, n);
    else if (kind == 9) add_sites_behind_slanted_wall(n);
    else add_sites_in_box(3.88, 0, 0, 8, 3, 4, n);
}

/* Closed boxes and rooms in a lit room stay dark: R inside is below 1e-4 of R in the room. This is tested with up to
   three numbers of cells, and at three scales with the smallest number. */
TEST(walls_keep_light_out) {
    static const char *const names[] = { "a thin box", "a hollow box", "a box of slabs", "a box on the floor",
        "a turned box", "two rooms", "two rooms askew",
                                         "a wall of small triangles", "a box on open ground", "a slanted wall" };
    int kind, i, j;
    for (kind = 0; kind < 10; kind++)
        for (i = 0; i < 3; i++)
            for (j = 0; j < 3; j++) {
                test_scene s = { 0 };
                int inside;
                double lit, dark;
                if (i != 1 && (j > 0 || kind == 1 || kind % 3 == i)) continue;
                if (j == 2 && kind != 3 && kind != 9) continue;  /* skips cases that take two seconds each */
                if (i != 1 && !test_kind_is("plain")) continue;
                leak_scene(&s, kind);
                scene_scale_and_move(&s, scales[i], 0, 0, 0);
                leak_sites(kind, 5);
                inside = site_count;
                add_site(0.5, 0, 0.5, 0, 1, 0, 1);
                add_site(1, 0, 1.5, 0, 1, 0, 1);
                add_site(0.1, 1.5, 2, 1, 0, 0, 1);
                scale_sites(scales[i]);
                if (!use_scene(&s, budgets[j]) || !gather(SBL_MODE_GI, SBL_BACKEND_TRACE, 256)) {
                    scene_free(&s);
                    return;
                }
                lit = mean_of(inside, site_count, 0);
                dark = most_of(0, inside);
                if (dark > 0)
                    printf("  %s, scale %g, %d: lit %g, dark %g; %d leaves %.2f s\n", names[kind], (double)scales[i],
                           budgets[j], lit, dark, sbl_query_stats(context).store.cells,
                           sbl_query_stats(context).seconds.bounce);
                CHECK(lit > 0.1, "%s, scale %g, %d cells: the room's R is %g", names[kind], (double)scales[i],
                      budgets[j], lit);
                CHECK(dark < 1e-4 * lit, "%s, scale %g, %d cells: R in the dark is %g of the room's", names[kind],
                      (double)scales[i], budgets[j], dark / lit);
                scene_free(&s);
            }
}

/* A wall separates two rooms, one of which is a thousand times brighter. R on each side equals R when the other side
   has no light. The lights are point lights, because these have no noise. */
TEST(two_sides_of_a_wall) {
    double worst = 0;
    int i, j, k;
    for (i = 0; i < 9; i++) {
        double alone[2] = { 0, 0 }, both[2] = { 0, 0 };
        if (i % 3 != (i / 3) % 2) continue;  /* each scale with one number of cells */
        for (k = 0; k < 3; k++) {
            const float bright = k == 1 ? 0 : 10, dim = k == 0 ? 0 : 0.01f;
            test_scene s = { 0 };
            sbl_light *light;
            leak_scene(&s, 5);
            for (j = 0; j < 3; j++) s.materials[2].emission[j] = 0;
            light = scene_light(&s, SBL_LIGHT_POINT, bright, bright, bright);
            light->position[0] = 1.7f; light->position[1] = 2.2f; light->position[2] = 1.4f;
            light = scene_light(&s, SBL_LIGHT_POINT, dim, dim, dim);
            light->position[0] = 6.2f; light->position[1] = 1.2f; light->position[2] = 2.4f;
            scene_scale_and_move(&s, scales[i / 3], 0, 0, 0);
            site_count = 0;
            for (j = 0; j < 16; j++)
                add_site(3.87, 0.2 + 0.35 * (j % 8), 0.3 + 0.45 * (j % 8), j < 8 ? -1 : 1, 0, 0, 1);
            scale_sites(scales[i / 3]);
            if (!use_scene(&s, budgets[i % 3]) || !gather(SBL_MODE_GI, SBL_BACKEND_TRACE, 256)) {
                scene_free(&s);
                return;
            }
            for (j = 0; j < 2; j++) {
                const double mean = mean_of(8 * j, 8 * j + 8, 0);
                if (k == 2) both[j] = mean;
                else if (k == j) alone[j] = mean;
                else CHECK(mean == 0, "scale %g, %d cells: light comes through the wall: %g", (double)scales[i / 3],
                           budgets[i % 3], mean);
            }
            scene_free(&s);
        }
        for (k = 0; k < 2; k++) {
            worst = test_max(worst, fabs(both[k] / alone[k] - 1));
            CHECK(alone[k] > 1e-4 && fabs(both[k] / alone[k] - 1) < 0.01,
                  "scale %g, %d cells, side %d: R is %g, without the other light %g", (double)scales[i / 3],
                  budgets[i % 3], k, both[k], alone[k]);
        }
    }
    printf("  off by %.2g at most\n", worst);
}

/* >>furnaces: in a closed scene where all surfaces emit E and reflect rho, R is E / (1 - rho) everywhere. With a few
   hundred lamps, one sensor has a noise of a few percent, which the mean over many sensors averages out. */

/* Returns the largest error over all readings and channels, where R must be 1. mean: receives the error of the mean */
static double off_one(double *mean) {
    double worst = 0, sum = 0;
    int i, k;
    for (i = 0; i < site_count; i++)
        for (k = 0; k < 3; k++) {
            const double r = (double)readings[i].radiance[k];
            worst = test_max(worst, fabs(r - 1));
            sum += r / (3 * site_count);
        }
    *mean = fabs(sum - 1);
    return worst;
}

/* Returns the root mean square of R - 1 over the sites. */
static double rms_off_one(void) {
    double sum = 0;
    int i;
    for (i = 0; i < site_count; i++) sum += pow((double)readings[i].radiance[1] - 1, 2);
    return sqrt(sum / site_count);
}

/* Adds a material that reflects rho and emits 1 - rho, so that R is 1. Returns its index. */
static int furnace_material(test_scene *s, float rho) {
    const int m = scene_lamp(s, 1 - rho, 1 - rho, 1 - rho);
    s->materials[m].albedo[0] = s->materials[m].albedo[1] = s->materials[m].albedo[2] = rho;
    return m;
}

/* Adds sites with random positions and normals inside a ball around the origin. */
static void add_sites_anywhere(double radius, int count) {
    uint32_t hash = 1;
    while (count > 0) {
        double p[6], length = 0;
        int k;
        for (k = 0; k < 6; k++) p[k] = 2 * ((hash = test_hash(hash)) / 4294967296.0) - 1;
        for (k = 3; k < 6; k++) length += p[k] * p[k];
        if (length > 1 || length < 0.01 || p[0] * p[0] + p[1] * p[1] + p[2] * p[2] > 1) continue;
        length = sqrt(length);
        add_site(radius * p[0], radius * p[1], radius * p[2], p[3] / length, p[4] / length, p[5] / length, 1);
        count--;
    }
}

static void check_furnace_picture(double rho, int kind) {
    sbl_picture_desc view = scene_view(16, 12, 70, 0.3f, 0.1f, 0.2f, -0.5f, -0.3f, -0.4f);
    float *radiance, *final;
    double worst = 0, mean = 0, sum = 0;
    int i;
    view.options.mode = SBL_MODE_GI;
    view.samples = 1;
    view.options.rays = 256;
    REQUIRE(sbl_render_picture(context, &view) == SBL_SUCCESS, "no picture: %s", watch_last(&seen));
    radiance = scene_channel(context, &view, SBL_CHANNEL_RADIANCE);
    final = scene_channel(context, &view, SBL_CHANNEL_FINAL);
    for (i = 0; i < 3 * 16 * 12; i++) {
        worst = test_max(worst, fabs((double)radiance[i] - 1));
        mean += (double)radiance[i] / (3 * 16 * 12);
        sum += (double)final[i] / (3 * 16 * 12);
    }
    printf("  furnace %d of albedo %g, picture: mean %.5f, worst %.2g\n", kind, rho, mean, worst);
    CHECK(fabs(mean - 1) < 0.005 && fabs(sum - 1) < 0.005 && worst < (kind ? 0.05 : 0.03),
        "furnace %d of albedo %g: R of a picture is %g, final %g, off by %g at most", kind, rho, mean, sum, worst);
    free(radiance);
    free(final);
}

/* Closed boxes and spheres, whose surfaces have one of four albedos and emit 1 - albedo, have R = 1 everywhere inside,
   in readings and in pictures. */
TEST(furnaces) {
    static const float albedos[] = { 0.2f, 0.5f, 0.8f, 0.95f };
    int kind, i, raster;
    for (kind = 0; kind < 3; kind++)
        for (i = 0; i < 4; i++)
            for (raster = 0; raster < (kind == 0 && i == 1 ? 2 : 1); raster++) {
                test_scene s = { 0 };
                if (kind && i == (kind == 1 ? 0 : 2)) continue;  /* each albedo with at least two kinds */
                const int m = furnace_material(&s, albedos[i]);
                double worst, mean;
                if (kind == 0) scene_box(&s, m, -1.2f, -1, -0.9f, 1.2f, 1, 0.9f);
                if (kind == 1) scene_sphere(&s, m, 0, 0, 0, 1, 20, 12, 0);
                if (kind == 2) scene_sphere(&s, m, 0, 0, 0, 1, 48, 28, 1);
                site_count = 0;
                add_sites_anywhere(0.9, 200);
                if (!use_scene(&s, 6144) || !gather(SBL_MODE_GI, raster ? SBL_BACKEND_RASTER : SBL_BACKEND_TRACE,
                                                    512)) {
                    scene_free(&s);
                    return;
                }
                worst = off_one(&mean);
                printf("  furnace %d of albedo %g%s: mean off by %.2g, worst %.2g; %d\n", kind, (double)albedos[i],
                       raster ? ", rasterised" : "", mean, worst, sbl_query_stats(context).store.cells);
                CHECK(mean < 0.005 && worst < (kind ? 0.05 : 0.015),
                      "furnace %d of albedo %g: the mean of R is off by %g, at most %g", kind, (double)albedos[i], mean,
                      worst);
                if (!raster && i != 1) check_furnace_picture((double)albedos[i], kind);
                scene_free(&s);
            }
}

/* A furnace of size 2 stands on a ground of up to 3,000, in a black box of 6,000, or both. Nearly all surface area is
   outside of it, but cells must still be small enough for its inside. */
TEST(a_furnace_in_a_large_scene) {
    static const float grounds[] = { 100, 1000, 3000, 0, 100, 0 }, boxes[] = { 0, 0, 0, 6000, 6000, 60000 };
    int i, k;
    for (i = 0; i < 6; i++) {
        test_scene s = { 0 };
        const float h = grounds[i] / 2, half = boxes[i] / 2;
        double worst, mean;
        scene_box(&s, furnace_material(&s, 0.5f), -1.2f, -1, -0.9f, 1.2f, 1, 0.9f);
        if (h > 0) scene_quad(&s, scene_material(&s, 0.3f, 0.3f, 0.3f), -h, -1.1f, -h, -h, -1.1f, h, h, -1.1f, h, h,
                              -1.1f, -h);
        if (half > 0) scene_box(&s, scene_material(&s, 0, 0, 0), -half, -half, -half, half, half, half);
        site_count = 0;
        add_sites_anywhere(0.9, 100);
        /* not moved; the default offset grows with the scene, and would be too large here */
        for (k = 0; k < site_count; k++) sites[k].offset = -1;
        if (use_scene(&s, 6144) && gather(SBL_MODE_GI, SBL_BACKEND_TRACE, 512)) {
            worst = off_one(&mean);
            printf("  ground of %g, box of %g: mean off by %.2g, rms %.2g, worst %.2g; %d cells\n", (double)grounds[i],
                   (double)boxes[i], mean, rms_off_one(), worst, sbl_query_stats(context).store.cells);
            CHECK(mean < 0.006 && worst < 0.06, "ground of %g, box of %g: the mean of R is off by %g, at most %g",
                  (double)grounds[i], (double)boxes[i], mean, worst);
            CHECK(rms_off_one() < 0.0135, "ground of %g, box of %g: R has an error of %g", (double)grounds[i],
                  (double)boxes[i], rms_off_one());
            CHECK(sbl_query_stats(context).store.cells > 6144 / 10, "ground of %g, box of %g: only %d cells",
                  (double)grounds[i], (double)boxes[i], sbl_query_stats(context).store.cells);
        }
        scene_free(&s);
    }
}

/* Under a sky of radiance 1, surfaces of any shape that emit what they do not reflect have R = 1. */
TEST(furnace_under_the_sky) {
    test_scene s = { 0 };
    double mean, worst;
    int i, k;
    scene_cornell_box(&s);
    for (i = 0; i < s.material_count; i++)
        for (k = 0; k < 3; k++) {
            s.materials[i].albedo[k] = 0.1f + 0.27f * (float)((3 * i + k) % 4);
            s.materials[i].emission[k] = 1 - s.materials[i].albedo[k];
        }
    scene_sky(&s, 1, 1, 1);
    site_count = 0;
    add_sites_in_box(10, 10, 10, 540, 540, 550, 4);
    if (use_scene(&s, 4096) && gather(SBL_MODE_GI, SBL_BACKEND_TRACE, 256)) {
        worst = off_one(&mean);
        printf("  mean off by %.2g, worst %.2g\n", mean, worst);
        CHECK(mean < 0.003 && worst < 0.05, "R is off by %g, at most %g", mean, worst);
    }
    scene_free(&s);
    /* on a convex body R is 1 for any albedo */
    scene_sphere(&s, scene_material(&s, 0.2f, 0.5f, 0.9f), 0, 0, 0, 1, 16, 8, 0);
    scene_sky(&s, 1, 1, 1);
    site_count = 0;
    for (i = 0; i < 8; i++)
        add_site(i & 1 ? 1 : -1, i & 2 ? 1 : -1, i & 4 ? 1 : -1, i & 1 ? 1 : -1, i & 2 ? 1 : -1, i & 4 ? 1 : -1, 1);
    if (use_scene(&s, 1024) && gather(SBL_MODE_GI, SBL_BACKEND_TRACE, 256)) {
        worst = off_one(&mean);
        CHECK(worst < 1e-5, "R of a convex thing is off by %g", worst);
    }
    scene_free(&s);
}

/* An albedo of 1 in a closed scene would make the light infinite. Bounced light uses at most 0.98, and a warning says
   so. */
TEST(albedo_of_one) {
    test_scene s = { 0 };
    int m = furnace_material(&s, 0.98f), i;
    double mean, worst;
    for (i = 0; i < 3; i++) s.materials[m].albedo[i] = 1;
    scene_box(&s, m, -1, -1, -1, 1, 1, 1);
    site_count = 0;
    add_sites_anywhere(0.9, 32);
    watch_forget(&seen);
    REQUIRE(use_scene(&s, 1024) && gather(SBL_MODE_DIRECT, SBL_BACKEND_TRACE, 64), "no scene");
    CHECK(seen.warnings == 0, "a warning in a mode without bounces: %s", watch_last(&seen));
    for (i = 0; i < 2; i++) REQUIRE(gather(SBL_MODE_GI, SBL_BACKEND_TRACE, 64), "no light");
    worst = off_one(&mean);
    printf("  mean off by %.2g, worst %.2g\n", mean, worst);
    CHECK(worst < 0.05, "R is off by %g", worst);
    CHECK(seen.warnings == 1 && watch_said(&seen, SBL_LOG_WARNING, SBL_LOG_ITEM_ALBEDO, "0.98", NULL, NULL),
          "%d warnings: %s", seen.warnings,
        watch_last(&seen));
    s.materials[m].albedo[1] = 0.5f;  /* no warning if one channel is below 1 */
    watch_forget(&seen);
    REQUIRE(use_scene(&s, 1024) && gather(SBL_MODE_GI, SBL_BACKEND_TRACE, 64), "no scene");
    CHECK(seen.warnings == 0, "a warning: %s", watch_last(&seen));
    scene_free(&s);
}

/* >>energy: in a closed box, the walls absorb as much light as is emitted */

enum { AREA_LIGHT, POINT_LIGHT, ROUND_LIGHT, SPOT_LIGHT, SOFT_SPOT, LIGHTS };

static double flux_scene(test_scene *s, int kind) {
    const double pi = TEST_PI, inner = cos(15 * pi / 180), outer = cos(35 * pi / 180);
    sbl_light *light = NULL;
    scene_box(s, scene_material(s, 0.3f, 0.6f, 0.85f), 0, 0, 0, 3, 2, 2.2f);
    if (kind == AREA_LIGHT) {
        scene_quad(s, scene_lamp(s, 4, 4, 4), 1, 1.7f, 0.8f, 1.8f, 1.7f, 0.8f, 1.8f, 1.7f, 1.4f, 1, 1.7f, 1.4f);
        s->materials[1].flags = SBL_MATERIAL_ONE_SIDED_EMISSION;
        return pi * 4 * 0.8 * 0.6;
    }
    light = scene_light(s, kind < SPOT_LIGHT ? SBL_LIGHT_POINT : SBL_LIGHT_SPOT, 4, 4, 4);
    light->position[0] = 1.4f; light->position[1] = 1.1f; light->position[2] = 1;
    light->direction[0] = 0.3f; light->direction[1] = -1; light->direction[2] = 0.2f;
    if (kind == ROUND_LIGHT) light->radius = 0.2f;
    light->cone = 70;
    light->inner_cone = kind == SPOT_LIGHT ? 70 : 30;
    if (kind == SPOT_LIGHT) return 4 * 2 * pi * (1 - outer);
    if (kind == SOFT_SPOT) return 4 * 2 * pi * (1 - inner + (inner - outer) / 3);
    return 4 * 4 * pi;
}

/* For each kind of light and several albedos, the absorbed flux equals the emitted flux within 1 %. */
TEST(light_is_neither_made_nor_lost) {
    static const double rho[3] = { 0.3, 0.6, 0.85 };
    int kind, k, i;
    for (kind = 0; kind < LIGHTS; kind++) {
        test_scene s = { 0 };
        const double emitted = flux_scene(&s, kind), corner[3] = { 1, 1.7, 0.8 }, u[3] = { 0.8, 0, 0 },
            v[3] = { 0, 0, 0.6 };
        int walls;
        site_count = 0;
        add_sites_in_box(0, 0, 0, 3, 2, 2.2, 14);
        walls = site_count;
        if (kind == AREA_LIGHT) { add_sites(corner, u, v, 6); add_sites(corner, v, u, 6); }
        if (!use_scene(&s, 12288) || !gather(SBL_MODE_GI, SBL_BACKEND_TRACE, 128)) { scene_free(&s); return; }
        for (k = 0; k < 3; k++) {
            double absorbed = 0;
            for (i = 0; i < site_count; i++)
                absorbed += (i < walls ? 1 - rho[k] : 1) * TEST_PI * (double)readings[i].radiance[k] * areas[i];
            printf("  light %d, albedo %g: %.4f of the flux is absorbed\n", kind, rho[k], absorbed / emitted);
            CHECK(fabs(absorbed / emitted - 1) < 0.01, "light %d, albedo %g: %g of the flux is absorbed", kind, rho[k],
                  absorbed / emitted);
        }
        scene_free(&s);
    }
}

/* >>reference: a cube whose six faces differ, compared with a path tracer */

static const float face_albedo[6][3] = { { 0.8f, 0.1f, 0.5f }, { 0.1f, 0.8f, 0.5f }, { 0.7f, 0.7f, 0.2f },
    { 0.9f, 0.6f, 0.4f }, { 0.3f, 0.5f, 0.9f },
    { 0.5f, 0.5f, 0 } };
static const float face_emission[6][3] = { { 0, 0, 0.2f }, { 0, 0, 0 }, { 0, 0, 0 }, { 1, 0.5f, 2 }, { 0, 0.3f, 0 },
    { 0.1f, 0, 0 } };

static double chance(uint32_t *state) {
    *state = *state * 747796405u + 2891336453u;
    return (test_hash(*state) + 0.5) / 4294967296.0;
}

/* Adds the light along a random path that starts at a random point of a face. Faces have the indices 2 * axis +
   side. */
static void follow_path(int face, uint32_t *state, double light[3]) {
    double at[3], share[3] = { 1, 1, 1 };
    int k, bounce;
    for (k = 0; k < 3; k++) at[k] = chance(state);
    at[face / 2] = face % 2;
    for (bounce = 0; bounce < 60; bounce++) {
        const int axis = face / 2;
        const double u = chance(state), angle = 2 * TEST_PI * chance(state);
        double way[3], nearest = 1e30;
        way[(axis + 1) % 3] = sqrt(u) * cos(angle);
        way[(axis + 2) % 3] = sqrt(u) * sin(angle);
        way[axis] = face % 2 ? -sqrt(1 - u) : sqrt(1 - u);
        for (k = 0; k < 3; k++) {
            const double t = ((way[k] > 0 ? 1 : 0) - at[k]) / way[k];
            if (k == axis && way[k] == 0) continue;
            if ((k != axis || t > 0.5 / fabs(way[k])) && t < nearest) { nearest = t; face = 2 * k + (way[k] > 0); }
        }
        for (k = 0; k < 3; k++) at[k] += nearest * way[k];
        at[face / 2] = face % 2;
        for (k = 0; k < 3; k++) {
            light[k] += share[k] * (double)face_emission[face][k];
            share[k] *= (double)face_albedo[face][k];
        }
    }
}

/* The mean of R on each face agrees with 200,000 random paths per face within 1 %. */
TEST(a_cube_by_paths) {
    enum { PATHS = 100000, SIDE = 14 };
    test_scene s = { 0 };
    static const int faces[6] = { 0, 1, 2, 3, 4, 5 };  /* the face of each quad of scene_box */
    double worst = 0;
    uint32_t state = 7;
    int f, k, i;
    scene_box(&s, 0, 0, 0, 0, 1, 1, 1);
    for (f = 0; f < 6; f++) {
        s.meshes[f].material = scene_material(&s, face_albedo[faces[f]][0], face_albedo[faces[f]][1],
                                              face_albedo[faces[f]][2]);
        memcpy(s.materials[f].emission, face_emission[faces[f]], sizeof s.materials[f].emission);
    }
    site_count = 0;
    add_sites_in_box(0, 0, 0, 1, 1, 1, SIDE);
    if (use_scene(&s, 8192) && gather(SBL_MODE_GI, SBL_BACKEND_TRACE, 256))
        for (f = 0; f < 6; f++) {
            double light[3] = { 0, 0, 0 };
            for (i = 0; i < PATHS; i++) follow_path(f, &state, light);
            for (k = 0; k < 3; k++) {
                const double mean = mean_of(f * SIDE * SIDE, (f + 1) * SIDE * SIDE, k), wanted = light[k] / PATHS;
                worst = test_max(worst, fabs(mean / wanted - 1));
                CHECK(fabs(mean / wanted - 1) < 0.01, "face %d, channel %d: the mean of R is %g, by path tracing %g", f,
                      k,
                      mean, wanted);
            }
        }
    printf("  off by %.2g at most\n", worst);
    scene_free(&s);
}

/* >>textures, vertex colours, cutouts */

/* Makes a cube of edge 1 with a lamp in its middle. The caller adds the wall at x = 0. */
static void room_but_a_wall(test_scene *s) {
    static const unsigned char texels[8] = { 255, 255, 255, 255, 255, 255, 255, 0 };
    static const float outside[12] = { 0, -0.1f, 0, 0.01f, -0.1f, 0, 0.01f, -0.1f, 0.01f, 0, -0.1f, 0.01f };
    int cloth;
    scene_box(s, scene_material(s, 0.6f, 0.6f, 0.6f), 0, 0, 0, 1, 1, 1);
    s->meshes[0] = s->meshes[--s->mesh_count];
    scene_quad(s, scene_lamp(s, 3, 3, 3), 0.4f, 0.9f, 0.4f, 0.6f, 0.9f, 0.4f, 0.6f, 0.9f, 0.6f, 0.4f, 0.9f, 0.6f);
    cloth = scene_material(s, 0, 0, 0);  /* all rooms then use the same programs */
    s->materials[cloth].albedo_texture = scene_texture(s, texels, sizeof texels, SBL_PIXELS_LINEAR8, 2, 1, 4);
    s->materials[cloth].alpha_cutoff = 0.5f;
    scene_quad_uv(s, cloth, outside, 1, 1);
}

static void quarter_of_a_wall(test_scene *s, int material, float y0, float y1, float z0, float z1) {
    scene_quad(s, material, 0, y0, z0, 0, y0, z1, 0, y1, z1, 0, y1, z0);
}

/* Measures sites on the floor near each half of the wall. means[half][channel] receives the mean of R. */
static int read_halves(const test_scene *s, double means[2][3]) {
    int i, k;
    site_count = 0;
    for (i = 0; i < 128; i++) add_site(0.1 + 0.1 * (i % 8), 0, (i < 64 ? 0.05 : 0.55) + 0.05 * (i / 8 % 8), 0, 1, 0, 1);
    if (!use_scene(s, 4096) || !gather(SBL_MODE_GI, SBL_BACKEND_TRACE, 256)) return 0;
    for (i = 0; i < 2; i++) for (k = 0; k < 3; k++) means[i][k] = mean_of(64 * i, 64 * i + 64, k);
    return 1;
}

static void check_halves(const char *what, const test_scene *s, double wanted[2][3]) {
    double found[2][3], worst = 0;
    int i, k;
    if (!read_halves(s, found)) return;
    for (i = 0; i < 2; i++)
        for (k = 0; k < 3; k++) {
            worst = test_max(worst, fabs(found[i][k] / wanted[i][k] - 1));
            CHECK(fabs(found[i][k] / wanted[i][k] - 1) < 0.02, "%s, half %d, channel %d: R is %g, with plain walls %g",
                  what, i, k, found[i][k], wanted[i][k]);
        }
    printf("  %s: off by %.2g at most\n", what, worst);
}

/* A wall that is half red and half blue, by a texture, by vertex colours or by a cut-out, gives the light of two walls
   of plain colours. */
TEST(colours_of_a_wall) {
    enum { WIDE = 128 };
    static const float red[3] = { 0.8f, 0.1f, 0.1f }, blue[3] = { 0.1f, 0.1f, 0.8f };
    static const float corners[12] = { 0, 0, 0, 0, 0, 1, 0, 1, 1, 0, 1, 0 };
    float pixels[WIDE][4], colors[8][4], eight[24];
    double wanted[2][3];
    test_scene s = { 0 };
    sbl_mesh *m;
    int i, k, way;
    room_but_a_wall(&s);
    quarter_of_a_wall(&s, scene_material(&s, red[0], red[1], red[2]), 0, 1, 0, 0.5f);
    quarter_of_a_wall(&s, scene_material(&s, blue[0], blue[1], blue[2]), 0, 1, 0.5f, 1);
    i = read_halves(&s, wanted);
    scene_free(&s);
    REQUIRE(i, "no plain walls");
    CHECK(wanted[0][0] > 1.03 * wanted[1][0] && wanted[1][2] > 1.03 * wanted[0][2],
          "red gives %g and %g, blue %g and %g", wanted[0][0], wanted[1][0],
        wanted[0][2], wanted[1][2]);
    for (i = 0; i < WIDE; i++) {
        for (k = 0; k < 3; k++) pixels[i][k] = (i < WIDE / 2 ? red : blue)[k];
        pixels[i][3] = 1;
    }
    for (way = 0; way < 3; way++) {
        static const char *const names[] = { "a texture", "vertex colours", "cutouts" };
        room_but_a_wall(&s);
        if (way == 0) {
            k = scene_material(&s, 1, 1, 1);
            s.materials[k].albedo_texture = scene_texture(&s, pixels, sizeof pixels, SBL_PIXELS_FLOAT, WIDE, 1, 4);
            scene_quad_uv(&s, k, corners, 1, 1);
        } else if (way == 1) {
            static const uint32_t indices[12] = { 0, 1, 2, 0, 2, 3, 4, 5, 6, 4, 6, 7 };
            for (i = 0; i < 8; i++) {
                memcpy(colors[i], i < 4 ? red : blue, sizeof red);
                colors[i][3] = 1;
                eight[3 * i] = 0;
                eight[3 * i + 1] = corners[3 * (i % 4) + 1];
                eight[3 * i + 2] = (i < 4 ? 0 : 0.5f) + 0.5f * corners[3 * (i % 4) + 2];
            }
            m = scene_mesh(&s, scene_material(&s, 1, 1, 1), eight, NULL, NULL, 8, indices, 12);
            m->colors.data = scene_copy(&s, colors[0], 32);
        } else {  /* a red wall with a hole, in front of a blue wall */
            for (i = 0; i < WIDE; i++) {
                memcpy(pixels[i], red, sizeof red);
                pixels[i][3] = i < WIDE / 2 ? 1.0f : 0;
            }
            k = scene_material(&s, 1, 1, 1);
            s.materials[k].albedo_texture = scene_texture(&s, pixels, sizeof pixels, SBL_PIXELS_FLOAT, WIDE, 1, 4);
            s.materials[k].alpha_cutoff = 0.5f;
            scene_quad_uv(&s, k, corners, 1, 1);
            quarter_of_a_wall(&s, scene_material(&s, blue[0], blue[1], blue[2]), 0, 1, 0, 1);
            m = &s.meshes[s.mesh_count - 1];
            m->positions.data = scene_copy(&s, corners, 12);
            for (i = 0; i < 4; i++) ((float *)s.blocks[s.block_count - 1])[3 * i] = -0.001f;
        }
        check_halves(names[way], &s, wanted);
        scene_free(&s);
    }
}

/* A furnace whose albedo comes from a texture has R = 1. */
TEST(furnace_of_a_texture) {
    static const unsigned char greys[4] = { 128, 128, 128, 128 };
    test_scene s = { 0 };
    const float rho = 0.8f * 128 / 255;
    const int m = furnace_material(&s, rho);
    double worst, mean;
    int k;
    for (k = 0; k < 3; k++) s.materials[m].albedo[k] = 0.8f;
    s.materials[m].albedo_texture = scene_texture(&s, greys, sizeof greys, SBL_PIXELS_LINEAR8, 2, 2, 1);
    scene_box(&s, m, -1.2f, -1, -0.9f, 1.2f, 1, 0.9f);
    site_count = 0;
    add_sites_anywhere(0.9, 100);
    if (use_scene(&s, 4096) && gather(SBL_MODE_GI, SBL_BACKEND_TRACE, 256)) {
        worst = off_one(&mean);
        printf("  mean off by %.2g, worst %.2g\n", mean, worst);
        CHECK(mean < 0.005 && worst < 0.01, "the mean of R is off by %g, at most %g", mean, worst);
    }
    scene_free(&s);
}

/* >>keeping and rebuilding the store */

enum { WIDTH = 20, HEIGHT = 15, PIXELS = WIDTH * HEIGHT };

static sbl_picture_desc reuse_view(int number) {
    sbl_picture_desc view = scene_view(WIDTH, HEIGHT, 60, number ? 3.5f : 0.5f, 1.5f, number ? 3 : 3.5f, 2, 0.8f, 1);
    view.options.mode = SBL_MODE_GI;
    view.options.rays = 32;
    view.samples = 1;
    return view;
}

static void reuse_scene(test_scene *s) {
    lit_room(s);
    scene_box(s, scene_material(s, 0.2f, 0.7f, 0.3f), 1.5f, 0, 1.3f, 2.1f, 0.8f, 2);
}

/* Renders a picture in a new context; the caller frees it. moved: if >= 0, this mesh is first moved by 0.3 along x */
static float *fresh_picture(const test_scene *s, const sbl_picture_desc *view, int moved, sbl_stats *stats) {
    static watch quiet;
    const sbl_context_desc desc = watch_desc(&quiet);
    sbl_context *shared = context, *fresh = watch_context(&quiet, &desc, s);
    float *picture = NULL;
    memset(stats, 0, sizeof *stats);
    context = fresh;
    if (fresh) {
        sbl_scene_desc scene = scene_desc(s);
        float transform[16] = { 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0.3f, 0, 0, 1 };
        scene.max_bounce_cells = 2048;
        CHECK(sbl_set_scene(fresh, &scene) == SBL_SUCCESS, "no scene: %s", watch_last(&quiet));
        if (moved >= 0)
            CHECK(sbl_set_mesh_transform(fresh, moved, transform) == SBL_SUCCESS, "no move: %s", watch_last(&quiet));
        CHECK(sbl_render_picture(fresh, view) == SBL_SUCCESS, "no picture: %s", watch_last(&quiet));
        *stats = sbl_query_stats(fresh);
        picture = scene_channel(fresh, view, SBL_CHANNEL_FINAL);
    }
    sbl_destroy(fresh);
    context = shared;
    return picture;
}

/* Renders with the shared context and checks that the picture equals that of a new context, to the bit. Returns the
   difference from *last, which is replaced. */
static double check_fresh(const char *what, const test_scene *s, int number, int moved, float **last) {
    const sbl_picture_desc view = reuse_view(number);
    sbl_stats stats, own;
    float *fresh = fresh_picture(s, &view, moved, &stats), *mine = NULL;
    double off = 0, sum = 0;
    int i;
    CHECK(sbl_render_picture(context, &view) == SBL_SUCCESS, "%s: no picture: %s", what, watch_last(&seen));
    own = sbl_query_stats(context);
    mine = scene_channel(context, &view, SBL_CHANNEL_FINAL);
    CHECK(fresh && memcmp(fresh, mine, 3 * PIXELS * sizeof *mine) == 0,
          "%s: the picture differs from that of a new context", what);
    CHECK(stats.store.cells == own.store.cells && own.store.cells > 100, "%s: %d cells, in a new context %d", what,
          own.store.cells, stats.store.cells);
    for (i = 0; i < 3 * PIXELS; i++) {
        off += *last ? fabs((double)mine[i] - (double)(*last)[i]) : 0;
        sum += (double)mine[i];
    }
    free(fresh);
    free(*last);
    *last = mine;
    if (number) {  /* the store already exists */
        CHECK(own.sensors.readbacks < stats.sensors.readbacks,
              "%s: %d readbacks in a new context, but %d with the store", what,
              own.sensors.readbacks, stats.sensors.readbacks);
        CHECK(own.store.rays == 0, "%s: %.0f rays for a store that exists", what, (double)own.store.rays);
    } else
        CHECK(own.store.rays == stats.store.rays && own.store.rays > 1000,
              "%s: a store of %.0f rays, in a new context %.0f",
              what, (double)own.store.rays, (double)stats.store.rays);
    return off / sum;
}

/* The store is kept while only the camera changes, and is rebuilt when the scene changes. All pictures equal those of
   new contexts. */
TEST(the_store_is_kept_and_renewed) {
    const float transform[16] = { 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0.3f, 0, 0, 1 };
    test_scene s = { 0 };
    float *last = NULL;
    double off;
    reuse_scene(&s);
    REQUIRE(use_scene(&s, 2048), "no scene");
    check_fresh("the first picture", &s, 0, -1, &last);
    check_fresh("another camera", &s, 1, -1, &last);
    REQUIRE(sbl_set_mesh_transform(context, 6, transform) == SBL_SUCCESS, "no move");  /* moves the lamp */
    check_fresh("a lamp that moved", &s, 0, 6, &last);
    check_fresh("another camera again", &s, 1, 6, &last);
    s.materials[0].albedo[0] = 0.1f;
    REQUIRE(use_scene(&s, 2048), "no scene");
    check_fresh("a darker room", &s, 0, -1, &last);
    off = check_fresh("the same again", &s, 1, -1, &last);
    CHECK(off > 0.01, "two cameras show the same");
    free(last);
    scene_free(&s);
}

/* >>a trench under the sky that is narrower than the cells, compared with radiosity in its cross-section */

enum { STRIPS = 120 };  /* strips on each side: left wall, floor, right wall */

static double apart(const double a[2], const double b[2]) { return hypot(a[0] - b[0], a[1] - b[1]); }

/* Computes the end points of strip i of a trench of width 1 and depth 1, counted from its left rim downwards. */
static void strip_of(int i, double from[2], double to[2]) {
    const double a = i % STRIPS / (double)STRIPS, b = (i % STRIPS + 1) / (double)STRIPS;
    const int side = i / STRIPS;
    from[0] = side == 0 ? 0 : side == 1 ? a : 1;
    from[1] = side == 0 ? -a : side == 1 ? -1 : a - 1;
    to[0] = side == 0 ? 0 : side == 1 ? b : 1;
    to[1] = side == 0 ? -b : side == 1 ? -1 : b - 1;
}

/* Computes R along the inside of the trench, which reflects rho, under a sky of 1. Form factors are by crossed strings
   (Hottel 1954). */
static void trench_by_radiosity(double rho, double r[3 * STRIPS]) {
    static double factor[3 * STRIPS][3 * STRIPS];
    const double rim[2][2] = { { 0, 0 }, { 1, 0 } };
    double sky[3 * STRIPS];
    int i, j, round;
    for (i = 0; i < 3 * STRIPS; i++) {
        double a[2], b[2], c[2], d[2];
        strip_of(i, a, b);
        for (j = 0; j < 3 * STRIPS; j++) {
            strip_of(j, c, d);
            factor[i][j] = i / STRIPS == j / STRIPS ? 0 : (apart(a, c) + apart(b, d) - apart(a, d) - apart(b, c)) *
                STRIPS / 2;
        }
        sky[i] = (apart(a, rim[1]) + apart(b, rim[0]) - apart(a, rim[0]) - apart(b, rim[1])) * STRIPS / 2;
        sky[i] = fabs(sky[i]);
        r[i] = sky[i];
    }
    for (round = 0; round < 100; round++)
        for (i = 0; i < 3 * STRIPS; i++) {
            double sum = sky[i];
            for (j = 0; j < 3 * STRIPS; j++) sum += rho * fabs(factor[i][j]) * r[j];
            r[i] = sum;
        }
}

/* R in the trench agrees with radiosity, although the cells are larger than the trench. */
TEST(a_trench_narrower_than_cells) {
    static double expected[3 * STRIPS];
    test_scene s = { 0 };
    const float w = 15;
    double off = 0, worst = 0;
    int m = scene_material(&s, 0.8f, 0.8f, 0.8f), i;
    scene_quad(&s, m, 0, -1, -w, 1, -1, -w, 1, -1, w, 0, -1, w);
    scene_quad(&s, m, 0, -1, -w, 0, -1, w, 0, 0, w, 0, 0, -w);
    scene_quad(&s, m, 1, -1, -w, 1, 0, -w, 1, 0, w, 1, -1, w);
    scene_quad(&s, m, -60, -4, -60, 60, -4, -60, 60, -4, 60, -60, -4, 60);  /* a large scene has large cells */
    scene_sky(&s, 1, 1, 1);
    trench_by_radiosity(0.8, expected);
    site_count = 0;
    for (i = 0; i < 18; i++) {
        const int strip = i * STRIPS / 6 + STRIPS / 12;
        double a[2], b[2];
        strip_of(strip, a, b);
        add_site((a[0] + b[0]) / 2, (a[1] + b[1]) / 2, 0.1, strip < STRIPS ? 1 : strip < 2 * STRIPS ? 0 : -1,
                 strip / STRIPS == 1, 0, 1);
    }
    if (use_scene(&s, 1024) && gather(SBL_MODE_GI, SBL_BACKEND_TRACE, 2048)) {
        printf("  cells of %g\n", (double)inside_cell_length(context));
        for (i = 0; i < site_count; i++) {
            const double here = (double)readings[i].radiance[0] / expected[i * STRIPS / 6 + STRIPS / 12] - 1;
            off += fabs(here) / site_count;
            worst = fabs(here) > worst ? fabs(here) : worst;
        }
        printf("  off by %.2g, at most %.2g\n", off, worst);
        CHECK(inside_cell_length(context) > 1, "cells are no wider than the trench");
        CHECK(off < 0.02 && worst < 0.06, "R is off by %g on average, %g at most", off, worst);
    }
    scene_free(&s);
}

/* >>black plates close above bright ground, over cells that are wider than the gap */

/* Returns the form factor at the origin, towards +y, of a rectangle at height h, from x0, z0 to x1, z1. */
static double seen_rectangle(double h, double x0, double z0, double x1, double z1) {
    double sum = 0;
    int i;
    for (i = 0; i < 4; i++) {
        const double a = (i & 1 ? x1 : x0) / h, b = (i & 2 ? z1 : z0) / h, c = sqrt(1 + a * a), d = sqrt(1 + b * b);
        sum += (i == 0 || i == 3 ? 1 : -1) * (a / c * atan(b / c) + b / d * atan(a / d)) / (2 * TEST_PI);
    }
    return sum;
}

/* Makes the ground, which reflects 0.8, and a plate at height h. Larger ground below makes the cells large. Then adds
   sites on the underside of the plate. */
static void plate_above_ground(test_scene *s, float half, float h, float ground, float below) {
    int i;
    scene_quad(s, scene_material(s, 0.8f, 0.8f, 0.8f), -ground, 0, -ground, -ground, 0, ground, ground, 0, ground,
               ground, 0, -ground);
    scene_quad(s, scene_material(s, 0, 0, 0), -half, h, -half, -half, h, half, half, h, half, half, h, -half);
    scene_quad(s, 1, -below, -4, -below, below, -4, -below, below, -4, below, -below, -4, below);
    site_count = 0;
    for (i = 0; i < 9; i++)
        add_site(0.3 * (double)half * (i % 3 - 1), (double)h, 0.3 * (double)half * (i / 3 - 1), 0, -1, 0, 1);
}

/* Near the middle of a plate, rays find ground that receives little of the sky, although its cell stores the light of
   the complete sky. R is the mean of the light of the ground over a cosine distribution of directions. */
TEST(near_hits_find_their_own_light) {
    enum { RINGS = 100, TURNS = 64 };
    const double half = 0.3, h = 0.05, ground = 6;
    test_scene s = { 0 };
    double expected = 0;
    int i;
    plate_above_ground(&s, (float)half, (float)h, (float)ground, 12);
    scene_sky(&s, 1, 1, 1);
    for (i = 0; i < site_count * RINGS * TURNS; i++) {
        const float *site = sites[i / (RINGS * TURNS)].position;
        const double u = (i / TURNS % RINGS + 0.5) / RINGS, turn = 2 * TEST_PI * (i % TURNS + 0.5) / TURNS;
        const double r = h * sqrt(u / (1 - u));
        const double x = (double)site[0] + r * cos(turn), z = (double)site[2] + r * sin(turn);
        const int beyond = fabs(x) > ground || fabs(z) > ground;
        const double hidden = seen_rectangle(h, -half - x, -half - z, half - x, half - z);
        expected += (beyond ? 1 : 0.8 * (1 - hidden)) / (site_count * RINGS * TURNS);
    }
    if (use_scene(&s, 1024) && gather(SBL_MODE_GI, SBL_BACKEND_TRACE, 1024)) {
        printf("  R is %.4f, expected %.4f; cells of %g\n", mean_of(0, site_count, 0), expected,
               (double)inside_cell_length(context));
        CHECK((double)inside_cell_length(context) > 2 * half, "cells are no wider than the plate");
        CHECK(fabs(mean_of(0, site_count, 0) / expected - 1) < 0.03, "R is %g, expected %g", mean_of(0, site_count, 0),
              expected);
    }
    scene_free(&s);
}

enum { NEAR_SUN, NEAR_POINT, NEAR_SPOT, NEAR_TRIANGLES, NEAR_SUN_AND_SPOT, NEAR_LAMPS };

/* Returns R of the ground at (x, z) in the light of a lamp of this kind. The shadow of the sun ends at x = shade. */
static double ground_by(int lamp, double x, double z, double shade) {
    const double away2 = (x - 0.15) * (x - 0.15) + 0.04 + z * z, cosine = 0.2 / sqrt(away2);
    const double limit = cos(TEST_PI / 6), spot = cosine > limit ? (cosine - limit) / (1 - limit) : 0;
    const double sun = x > shade ? 1 : 0, spotlight = spot * spot * cosine / away2;
    if (lamp == NEAR_SUN || lamp == NEAR_SUN_AND_SPOT) return sun + (lamp == NEAR_SUN ? 0 : spotlight);
    if (lamp == NEAR_SPOT) return spotlight;
    return (lamp == NEAR_TRIANGLES ? cosine : 1) * cosine / away2;
}

/* A black wall stands on ground of albedo 0.5. The light of a lamp varies strongly within a cell of the ground, because
   a shadow covers the foot of the wall or another lamp is near. Sites on the wall are close above the ground. */
TEST(lamps_light_near_hits) {
    enum { STEPS = 1000 };
    static const float shade = 0.05f, height = 0.03f, quarter[3] = { 0.25f, 0.25f, 0.25f };
    int lamp, i;
    for (lamp = 0; lamp < NEAR_LAMPS; lamp++) {
        test_scene s = { 0 };
        sbl_light *light = NULL;
        double expected = 0, found;
        const int white = scene_material(&s, 0.5f, 0.5f, 0.5f), black = scene_material(&s, 0, 0, 0);
        if (lamp == NEAR_POINT) scene_quad(&s, white, -5, 0, -5, 5, 0, -5, 5, 0, 5, -5, 0, 5);  /* its back is seen */
        else scene_floor(&s, white, 0, 5);
        scene_quad(&s, black, 0, 0, -5, 0, 0, 5, 0, 4, 5, 0, 4, -5);
        if (lamp == NEAR_SUN || lamp == NEAR_SUN_AND_SPOT) {
            scene_quad(&s, black, 0, 3, -5, 0, 3, 5, shade, 3, 5, shade, 3, -5);
            scene_light(&s, SBL_LIGHT_DIRECTIONAL, (float)TEST_PI, 0, 0)->direction[1] = -1;
        }
        if (lamp == NEAR_TRIANGLES) {
            const float a = 0.01f, l = (float)(TEST_PI / 0.0004);
            scene_quad(&s, scene_lamp(&s, 4 * l, 0, 0), 0.15f - a, 0.2f, -a, 0.15f + a, 0.2f, -a, 0.15f + a, 0.2f, a,
                       0.15f - a, 0.2f, a);
            s.materials[s.material_count - 1].emission_texture =
                scene_texture(&s, quarter, sizeof quarter, SBL_PIXELS_FLOAT, 1, 1, 3);
        } else if (lamp != NEAR_SUN) {
            light = scene_light(&s, lamp == NEAR_POINT ? SBL_LIGHT_POINT : SBL_LIGHT_SPOT, (float)TEST_PI, 0, 0);
            light->position[0] = 0.15f;
            light->position[1] = 0.2f;
            light->direction[1] = -1;
            light->cone = 60;
        }
        site_count = 0;
        for (i = 0; i < 16; i++) add_site(0, (double)height, 0, 1, 0, 0, 1);
        for (i = 0; i < STEPS * STEPS; i++) {
            const double r = sqrt((i / STEPS + 0.5) / STEPS), turn = 2 * TEST_PI * (i % STEPS + 0.5) / STEPS;
            const double down = -r * sin(turn), far = (double)height / down;
            const double x = sqrt(1 - r * r) * far, z = r * cos(turn) * far;
            if (down > 0 && x < 5 && fabs(z) < 5)
                expected += 0.5 * ground_by(lamp, x, z, (double)shade) / (STEPS * STEPS);
        }
        if (use_scene(&s, 1024) && gather(SBL_MODE_GI, SBL_BACKEND_TRACE, 1024)) {
            found = mean_of(0, site_count, 0);
            if (gather(SBL_MODE_DIRECT, SBL_BACKEND_TRACE, 1024)) found -= mean_of(0, site_count, 0);
            printf("  lamp %d: bounced light %.4f, expected %.4f; cells of %g\n", lamp, found, expected,
                   (double)inside_cell_length(context));
            CHECK(inside_cell_length(context) > 4 * shade, "cells are no wider than the shade");
            CHECK(fabs(found / expected - 1) < 0.03, "lamp %d: bounced light is %g, expected %g", lamp, found,
                  expected);
        }
        scene_free(&s);
    }
}

/* A plate blocks the sun from the ground below it. Walls see the lit parts of the same cells, but only from afar. The
   light that these find does not reach the plate. */
TEST(far_light_is_not_near_light) {
    test_scene s = { 0 };
    int i;
    plate_above_ground(&s, 2, 0.01f, 12, 24);
    for (i = 0; i < 2; i++) {
        const float x = i ? 12.0f : -12.0f;
        scene_quad(&s, 1, x, 0, -12, x, 0, 12, x, 2, 12, x, 2, -12);
    }
    scene_light(&s, SBL_LIGHT_DIRECTIONAL, (float)TEST_PI, 0, 0)->direction[1] = -1;
    add_site(-6, 1, 0, 0, -1, 0, 1);
    if (use_scene(&s, 1024) && gather(SBL_MODE_GI, SBL_BACKEND_TRACE, 1024)) {
        const double dark = mean_of(0, 9, 0), lit = (double)readings[9].radiance[0];
        printf("  R is %.4f below the plate, %.4f above the ground; cells of %g\n", dark, lit,
               (double)inside_cell_length(context));
        CHECK(inside_cell_length(context) > 2, "cells are no wider than half of the plate");
        CHECK(lit > 0.6 && dark < 0.05 * lit, "R is %g below the plate, %g above the ground", dark, lit);
    }
    scene_free(&s);
}

enum { FACETS = 20 };

/* Adds the strips between neighbours of a list of points (x and y), from z = -half to half, as one mesh above a black
   ground. The scene is large, so that cells are, too. */
static void extruded(test_scene *s, double (*outline)[2], int facets, double half, float albedo, float size) {
    static float corners[18 * FACETS];
    int i, k;
    for (i = 0; i < facets; i++)
        for (k = 0; k < 6; k++) {
            const double *at = outline[i + (k == 1 || k == 2 || k == 4)];
            float *p = &corners[18 * i + 3 * k];
            p[0] = (float)at[0];
            p[1] = (float)at[1];
            p[2] = (float)(k == 2 || k > 3 ? half : -half);
        }
    scene_quad(s, scene_material(s, 0, 0, 0), -size, -1, -size, size, -1, -size, size, -1, size, -size, -1, size);
    scene_mesh(s, scene_material(s, albedo, albedo, albedo), corners, NULL, NULL, 6 * facets, NULL, 6 * facets);
}

/* Renders a view in which the test reads stored light. Returns 0 if that fails. */
static int render_stored(const test_scene *s, sbl_picture_desc *view) {
    view->options.mode = SBL_MODE_GI;
    view->samples = 1;
    view->options.rays = 16;
    if (use_scene(s, 1024) && sbl_render_picture(context, view) == SBL_SUCCESS) return 1;
    CHECK(0, "no picture: %s", watch_last(&seen));
    return 0;
}

/* A pleated sheet is a mesh with steep pleats that are narrower than the cells. A sun lights every second pleat. R on
   the others stays near 0, although each cell contains pleats of both kinds. The store is read in a view from above. */
TEST(a_pleated_sheet) {
    double outline[FACETS + 1][2];
    test_scene s = { 0 };
    sbl_picture_desc view = scene_view(WIDTH, HEIGHT, 60, 0.01f, 0.3f, 0, 0.01f, 0, 0);
    double lit = 0, most = 0;
    sbl_light *light;
    int i, count = 0;
    for (i = 0; i <= FACETS; i++) {
        outline[i][0] = 0.05 * (i - FACETS / 2);
        outline[i][1] = i % 2 ? 0.0483 : 0;  /* slopes of 44 degrees */
    }
    extruded(&s, outline, FACETS, 0.25, 0.001f, 2);
    light = scene_light(&s, SBL_LIGHT_DIRECTIONAL, 1, 1, 1);  /* 42 degrees above the horizon */
    light->direction[0] = -0.743f;
    light->direction[1] = -0.669f;
    if (render_stored(&s, &view)) {
        float *stored = scene_channel(context, &view, SBL_CHANNEL_STORE),
              *normal = scene_channel(context, &view, SBL_CHANNEL_NORMAL);
        for (i = 0; i < PIXELS; i++) {
            const double x = (double)normal[3 * i], here = (double)stored[3 * i];
            if (x > 0.1) { lit += here; count++; }
            if (x < -0.1) most = test_max(most, here);
        }
        lit /= count;
        printf("  lit %g, in the dark %g at most; cells of %g\n", lit, most, (double)inside_cell_length(context));
        CHECK(inside_cell_length(context) > 0.1f, "cells are no wider than two pleats");
        CHECK(count > PIXELS / 10 && lit > 0.1, "R of the lit pleats is %g", lit);
        CHECK(most < 0.01 * lit, "R of the dark pleats is %g of the lit ones'", most / lit);
        free(stored);
        free(normal);
    }
    scene_free(&s);
}

/* The outside and the inside of a hollow body do not share leaves, even if the body is smooth and thinner than a cell.
   Under a sky of radiance 1, R of its upper side is 1; inside, almost no light arrives. */
TEST(a_hollow_body) {
    enum { ARC = 6, AROUND = 2 * (ARC + 1) };  /* outline: two straight lines and two arcs of 6 facets each */
    const double r = 0.02;
    test_scene s = { 0 };
    sbl_picture_desc view = scene_view(WIDTH, HEIGHT, 30, 0.01f, 1, 0, 0, 0, 0);
    double outline[AROUND + 1][2], least = 2, most = 0;
    int i, count = 0;
    for (i = 0; i <= AROUND; i++) {
        const int right = i <= ARC || i == AROUND;
        const double angle = TEST_PI * (i % (ARC + 1) + (right ? 0 : ARC)) / ARC;
        outline[i][0] = r * sin(angle) + (right ? 0.2 : -0.2);
        outline[i][1] = r * cos(angle);
    }
    extruded(&s, outline, AROUND, 1, 0.5f, 4);
    scene_sky(&s, 1, 1, 1);
    if (render_stored(&s, &view)) {
        float *stored = scene_channel(context, &view, SBL_CHANNEL_STORE),
              *normal = scene_channel(context, &view, SBL_CHANNEL_NORMAL),
              *albedo = scene_channel(context, &view, SBL_CHANNEL_ALBEDO);
        for (i = 0; i < PIXELS; i++) {
            if (albedo[3 * i] < 0.4f || fabsf(normal[3 * i + 1]) < 0.999f) continue;
            least = test_min(least, (double)stored[3 * i]);
            most = test_max(most, (double)stored[3 * i]);
            count++;
        }
        printf("  R of the upper side: %g to %g; cells of %g\n", least, most, (double)inside_cell_length(context));
        CHECK(inside_cell_length(context) > 2 * (float)r, "cells are no longer than the body is thick");
        CHECK(count > PIXELS / 10 && least > 0.99 && most < 1.01, "R is %g to %g instead of 1", least, most);
        free(stored);
        free(normal);
        free(albedo);
    }
    scene_free(&s);
}

/* A furnace has more surfaces than the store can hold in cells of the initial size, so that the surfaces found last get
   larger cells. R is still 1. */
TEST(a_crowd_of_boxes) {
    test_scene s = { 0 };
    double mean, worst;
    int m = furnace_material(&s, 0.8f), i;
    scene_box(&s, m, -1, -1, -1, 1, 1, 1);
    for (i = 0; i < 15; i++) {
        const float x = 0.45f * (float)(i % 4) - 0.9f, z = 0.45f * (float)(i / 4) - 0.9f;
        scene_box(&s, m, x, -1, z, x + 0.2f, -0.8f, z + 0.2f);
    }
    site_count = 0;
    add_sites_in_box(-1, -0.7, -1, 1, 1, 1, 5);
    for (i = 0; i < 2; i++) {
        if (!use_scene(&s, i ? 1424 : 8192) || !gather(SBL_MODE_GI, SBL_BACKEND_TRACE, 128)) break;
        worst = off_one(&mean);
        printf("  mean off by %.2g, worst %.2g; %d samples, cells of %g\n", mean, worst,
               sbl_query_stats(context).store.cells, (double)inside_cell_length(context));
        CHECK(mean < 0.01 && worst < 0.05, "R is off by %g, at most %g", mean, worst);
        CHECK(inside_cell_length(context) < 0.45f, "all cells have grown, to %g", (double)inside_cell_length(context));
    }
    scene_free(&s);
}

enum { SHELVES = 700 };
static float shelf_corners[SHELVES][18];

/* Makes horizontal squares one above the other, in eight stacks, as one mesh. */
static void shelves(test_scene *s, int material) {
    int i, k;
    for (i = 0; i < SHELVES; i++)
        for (k = 0; k < 6; k++) {
            float *p = &shelf_corners[i][3 * k];
            p[0] = (float)(k == 1 || k == 2 || k == 4) + 1.5f * (float)(i % 4);
            p[1] = 0.05f * (float)(i / 8);
            p[2] = (float)(k == 2 || k > 3) + 1.5f * (float)(i / 4 % 2);
            if (k == 3 || k == 4) p[0] = (float)(k == 4) + 1.5f * (float)(i % 4);
            if (k == 3) p[2] = 1.5f * (float)(i / 4 % 2);
            if (k == 4) p[2] = 1 + 1.5f * (float)(i / 4 % 2);
        }
    scene_mesh(s, material, shelf_corners[0], NULL, NULL, 6 * SHELVES, NULL, 6 * SHELVES);
}

/* A furnace has more sides of triangles than the store can hold in cells of any size. Building the store ends, and no
   side stays dark. Many shelves share a few measurements, so R is only about 1. */
TEST(more_sides_than_samples) {
    test_scene s = { 0 };
    int i, k;
    shelves(&s, furnace_material(&s, 0.5f));
    site_count = 0;
    for (i = 0; i < 40; i++) add_site(0.5, 0.05 * i + 0.01, 0.5, 0, 1, 0, 1);
    for (k = 1024; k <= 1184; k += 80) {
        double off = 0, mean;
        if (!use_scene(&s, k) || !gather(SBL_MODE_GI, SBL_BACKEND_TRACE, 256)) break;
        for (i = 0; i < site_count; i++) off += fabs((double)readings[i].radiance[0] - 1) / site_count;
        mean = mean_of(0, site_count, 0);
        printf("  %d samples of %d: mean %.3f, off by %.3f\n", sbl_query_stats(context).store.cells, k, mean, off);
        CHECK(sbl_query_stats(context).store.cells > 100 && sbl_query_stats(context).store.cells <= k,
              "%d cells of %d", sbl_query_stats(context).store.cells, k);
        CHECK(fabs(mean - 1) < 0.25 && off < 0.25, "R is %g on average, off by %g", mean, off);
    }
    scene_free(&s);
}

static int give_up(float done, void *calls) { (void)done; return ++*(int *)calls > 1000; }

/* Each shelf is a mesh of its own. Surfaces of different meshes share no cells, so larger cells do not help, but the
   store is built nevertheless. */
TEST(more_meshes_than_samples) {
    static sbl_mesh meshes[SHELVES];
    test_scene s = { 0 };
    sbl_scene_desc scene;
    sbl_readings_desc desc;
    int i, calls = 0;
    shelves(&s, furnace_material(&s, 0.5f));
    if (!use_scene(&s, 1024)) return;
    for (i = 0; i < SHELVES; i++) {
        meshes[i] = s.meshes[0];
        meshes[i].positions.data = shelf_corners[i];
        meshes[i].vertex_count = meshes[i].index_count = 6;
    }
    scene = scene_desc(&s);
    scene.meshes = meshes;
    scene.mesh_count = SHELVES;
    scene.max_bounce_cells = 1024;
    site_count = 0;
    add_site(0.5, 0.51, 0.5, 0, 1, 0, 1);
    desc = readings_of(SBL_MODE_GI, SBL_BACKEND_TRACE);
    desc.options.progress = give_up;
    desc.options.progress_user = &calls;
    CHECK(sbl_set_scene(context, &scene) == SBL_SUCCESS && sbl_gather_readings(context, &desc) == SBL_SUCCESS,
          "after %d calls: %s", calls, watch_last(&seen));
    printf("  %d cells; %d pieces\n", sbl_query_stats(context).store.cells, calls);
    CHECK(sbl_query_stats(context).store.cells > 1000, "%d cells of 1024", sbl_query_stats(context).store.cells);
    scene_free(&s);
}

/* Ground that no other surface sees has light for sites in the air. A square of ground in the sun, seen from above its
   middle, is compared with the form factor of a square. */
TEST(ground_that_no_surface_sees) {
    static const float sizes[] = { 1, 30 };  /* edges of the ground; the site is 1 above it */
    int i;
    for (i = 0; i < 2; i++) {
        test_scene s = { 0 };
        const double half = (double)sizes[i], x = half / sqrt(1 + half * half), seen_share = 4 / TEST_PI * x * atan(x);
        const float w = sizes[i];
        double expected = 0.5 * 3 / TEST_PI * seen_share;
        scene_quad(&s, scene_material(&s, 0.5f, 0.5f, 0.5f), -w, -1, -w, -w, -1, w, w, -1, w, w, -1, -w);
        if (i) scene_box(&s, 0, 9, -1, 9, 10, 0, 10);  /* a distant box whose sides see the ground */
        scene_light(&s, SBL_LIGHT_DIRECTIONAL, 3, 3, 3)->direction[1] = -1;
        site_count = 0;
        add_site(0, 0, 0, 0, -1, 0, 1);
        if (use_scene(&s, 4096) && gather(SBL_MODE_GI, SBL_BACKEND_TRACE, 4096)) {
            printf("  %g of %g; %d samples\n", (double)readings[0].radiance[0], expected,
                   sbl_query_stats(context).store.cells);
            CHECK(fabs((double)readings[0].radiance[0] / expected - 1) < 0.02, "R is %g, not %g",
                  (double)readings[0].radiance[0], expected);
        }
        scene_free(&s);
    }
}

/* >>geometry that the host draws */

/* light: the ambient cube that the last draw callback received */
static struct drawn { GLuint program; float albedo, emission, light[6][3]; int views; } drawn;

/* A draw callback that draws a cube of half edge 0.3 around the origin, which reflects the ambient cube that it
   receives. */
static void draw_box(const sbl_draw_view *view, void *user) {
    static const char vertex[] =
        "uniform vec4 column[4];\n"
        "out vec3 normal;\n"
        "void main() {\n"
        "    int face = gl_VertexID / 6, axis = face >> 1, corner = gl_VertexID % 6, q = corner < 3 ? corner : corner "
            "== 3 ? 0 : corner - 2;\n"
        "    float side = (face & 1) == 0 ? 1.0 : -1.0;\n"
        "    vec2 uv = vec2(q == 1 || q == 2 ? 1.0 : -1.0, q >= 2 ? 1.0 : -1.0) * vec2(side, 1.0);\n"
        "    vec3 p = axis == 0 ? vec3(side, uv) : axis == 1 ? vec3(uv.y, side, uv.x) : vec3(uv, side);\n"
        "    normal = axis == 0 ? vec3(side, 0, 0) : axis == 1 ? vec3(0, side, 0) : vec3(0, 0, side);\n"
        "    gl_Position = mat4(column[0], column[1], column[2], column[3]) * vec4(0.3 * p, 1.0);\n"
        "}\n";
    static const char fragment[] =
        "uniform vec3 light[6];\n"
        "uniform float albedo, emission, radiance_scale, depth_scale;\n"
        "in vec3 normal;\n"
        "layout(location = 0) out vec4 radiance;\n"
        "void main() {\n"
        "    vec3 n = normalize(normal), w = n * n;\n"
        "    vec3 r = w.x * light[n.x < 0.0 ? 1 : 0] + w.y * light[n.y < 0.0 ? 3 : 2] + w.z * light[n.z < 0.0 ? 5 : 4]"
            ";\n"
        "    radiance = vec4((emission + albedo * r) * radiance_scale, gl_FrontFacing ? 1.0 / gl_FragCoord.w : -1.0 / "
            "gl_FragCoord.w);\n"
        "#ifdef WRITE_DEPTH\n"
        "    gl_FragDepth = gl_FragCoord.w * depth_scale;\n"
        "#endif\n"
        "}\n";
    int i;
    (void)user;
    if (view->kind != SBL_VIEW_SENSOR) return;
    if (!drawn.program)
        drawn.program = host_gl_program("test_bounce", view->write_depth ? "#define WRITE_DEPTH\n" : "", vertex,
                                        fragment);
    drawn.views++;
    memcpy(drawn.light, view->light, sizeof drawn.light);
    gl.UseProgram(drawn.program);
    for (i = 0; i < 4; i++) {
        const char name[] = { 'c', 'o', 'l', 'u', 'm', 'n', '[', (char)('0' + i), ']', 0 };
        const float *x = view->world_to_clip + 4 * i;
        gl.Uniform4f(gl.GetUniformLocation(drawn.program, name), x[0], x[1], x[2], x[3]);
    }
    for (i = 0; i < 6; i++) {
        const char name[] = { 'l', 'i', 'g', 'h', 't', '[', (char)('0' + i), ']', 0 };
        gl.Uniform3fv(gl.GetUniformLocation(drawn.program, name), 1, view->light[i]);
    }
    gl.Uniform1f(gl.GetUniformLocation(drawn.program, "albedo"), drawn.albedo);
    gl.Uniform1f(gl.GetUniformLocation(drawn.program, "emission"), drawn.emission);
    gl.Uniform1f(gl.GetUniformLocation(drawn.program, "radiance_scale"), view->radiance_scale);
    gl.Uniform1f(gl.GetUniformLocation(drawn.program, "depth_scale"), view->depth_scale);
    gl.DrawArrays(GL_TRIANGLES, 0, 36);
}

static struct { unsigned char bytes[1 << 22]; size_t count, at; } saved;

static size_t saved_put(const void *data, size_t bytes, void *user) {
    (void)user;
    if (bytes > sizeof saved.bytes - saved.count) return 0;
    memcpy(saved.bytes + saved.count, data, bytes);
    saved.count += bytes;
    return bytes;
}

static size_t saved_get(void *data, size_t bytes, void *user) {
    (void)user;
    bytes = bytes < saved.count - saved.at ? bytes : saved.count - saved.at;
    memcpy(data, saved.bytes + saved.at, bytes);
    saved.at += bytes;
    return bytes;
}

/* In a furnace, where R is 1 everywhere, the draw callback draws a cube that emits what it does not reflect. The cube
   then looks like the walls, so that R stays 1. Below a sun, the callback is told the light that reaches the sides of
   the cube. A saved store includes this light, and is refused if the geometry is drawn elsewhere. */
TEST(draw_callback_receives_the_ambient_light) {
    test_scene s = { 0 };
    sbl_scene_desc scene;
    const int m = furnace_material(&s, 0.5f);
    double mean, worst, least = 2, most = 0;
    int i;
    /* loads the GL functions; the context that sbl.h creates uses the same ones */
    REQUIRE(host_gl_open("test_bounce"), "no GL");
    scene_box(&s, m, -1.2f, -1, -0.9f, 1.2f, 1, 0.9f);
    if (!use_scene(&s, 4096)) return;
    scene = scene_desc(&s);
    scene.draw = draw_box;
    for (i = 0; i < 3; i++) { scene.draw_bounds[0][i] = -0.3f; scene.draw_bounds[1][i] = 0.3f; }
    scene.draw_max_radiance = 1;
    scene.max_bounce_cells = 4096;
    drawn.albedo = 0.8f;
    drawn.emission = 0.2f;
    site_count = 0;
    add_sites_in_box(-1.2, -1, -0.9, 1.2, 1, 0.9, 3);
    REQUIRE(sbl_set_scene(context, &scene) == SBL_SUCCESS && gather(SBL_MODE_GI, SBL_BACKEND_RASTER, 64),
            "no light: %s", watch_last(&seen));
    worst = off_one(&mean);
    for (i = 0; i < 18; i++) {
        least = fmin(least, (double)drawn.light[i / 3][i % 3]);
        most = test_max(most, (double)drawn.light[i / 3][i % 3]);
    }
    printf("  %d views; received %.4f to %.4f; mean off by %.2g, worst %.2g\n", drawn.views, least, most, mean, worst);
    CHECK(drawn.views > 54 && least > 0.99 && most < 1.01, "%d views receive %g to %g", drawn.views, least, most);
    CHECK(mean < 0.005 && worst < 0.05, "R is off by %g, at most %g", mean, worst);
    drawn.emission = 0;  /* a dark cube changes R, which shows that it is drawn at all */
    REQUIRE(gather(SBL_MODE_GI, SBL_BACKEND_RASTER, 64), "no light: %s", watch_last(&seen));
    off_one(&mean);
    CHECK(mean > 0.01, "a dark cube changes R by only %g", mean);
    scene_free(&s);
    memset(&s, 0, sizeof s);
    scene_quad(&s, scene_material(&s, 0.5f, 0.5f, 0.5f), -1, -1, -1, -1, -1, 1, 1, -1, 1, 1, -1, -1);
    /* under a vertical sun, R of a side that faces up is known */
    scene_light(&s, SBL_LIGHT_DIRECTIONAL, 2, 3, 5)->direction[1] = -1;
    scene.meshes = s.meshes;
    scene.mesh_count = s.mesh_count;
    scene.materials = s.materials;
    scene.lights = s.lights;
    scene.light_count = s.light_count;
    site_count = 0;
    add_site(0, -1, 0, 0, 1, 0, 1);
    REQUIRE(sbl_set_scene(context, &scene) == SBL_SUCCESS && gather(SBL_MODE_GI, SBL_BACKEND_RASTER, 64),
            "no light: %s", watch_last(&seen));
    CHECK(fabs((double)drawn.light[2][2] * TEST_PI / 5 - 1) < 0.001, "the side that faces up receives %g",
          (double)drawn.light[2][2]);
    CHECK(drawn.light[3][0] > 0.05f && drawn.light[3][0] < 0.5f * drawn.light[2][0],
          "the side that faces down receives %g",
          (double)drawn.light[3][0]);
    {
        const float before = drawn.light[2][2];
        REQUIRE(
            sbl_save_store(context, saved_put, NULL) == SBL_SUCCESS && sbl_set_scene(context, &scene) == SBL_SUCCESS &&
                sbl_load_store(context, saved_get, NULL) == SBL_SUCCESS && gather(SBL_MODE_GI, SBL_BACKEND_RASTER, 64),
            "%s", watch_last(&seen));
        CHECK(sbl_query_stats(context).store.rays == 0 && !memcmp(&drawn.light[2][2], &before, sizeof before),
              "after loading the cube receives %g, not %g", (double)drawn.light[2][2], (double)before);
        scene.draw_bounds[0][0] = -0.4f;
        saved.at = 0;
        CHECK(sbl_set_scene(context, &scene) == SBL_SUCCESS && sbl_load_store(context, saved_get, NULL) ==
              SBL_ERROR_INVALID_ARGUMENT,
            "a store of things drawn elsewhere was loaded");
    }
    REQUIRE(gather(SBL_MODE_DIRECT, SBL_BACKEND_RASTER, 64), "no light: %s", watch_last(&seen));
    CHECK(most_of(0, 1) >= 0 && drawn.light[2][2] == 0, "in SBL_MODE_DIRECT the cube receives %g",
          (double)drawn.light[2][2]);
    host_gl_close();
    scene_free(&s);
}

/* A lamp that is little wider than a texel of the views stands close beside the outline of what the host draws. It is
   not hidden, so R is nearly that of the lamp alone. */
TEST(lamps_beside_what_the_host_draws) {
    enum { SITES = 32 };
    test_scene s = { 0 };
    sbl_scene_desc scene;
    sbl_readings_desc single;
    double alone = 0, beside = 0;
    int i;
    REQUIRE(host_gl_open("test_bounce"), "no GL");
    drawn.albedo = drawn.emission = 0;
    for (i = 0; i < 2; i++) {
        const float x = i ? -0.88f : 0.88f, corners[9] = { x, 1, 0, x + (i ? -0.2f : 0.2f), 1, 0, x, 1, 0.2f };
        scene_mesh(&s, scene_lamp(&s, 9, 9, 9), corners, NULL, NULL, 3, NULL, 0);
    }
    if (!use_scene(&s, 4096)) return;
    site_count = 0;
    for (i = 0; i < SITES; i++) add_site(0, -1, 0, 0, 1, 0, 1);
    if (gather(SBL_MODE_DIRECT, SBL_BACKEND_TRACE, 64)) alone = mean_of(0, SITES, 0);
    scene = scene_desc(&s);
    scene.draw = draw_box;
    for (i = 0; i < 3; i++) { scene.draw_bounds[0][i] = -0.3f; scene.draw_bounds[1][i] = 0.3f; }
    REQUIRE(sbl_set_scene(context, &scene) == SBL_SUCCESS && gather(SBL_MODE_DIRECT, SBL_BACKEND_RASTER, 64),
            "no light: %s", watch_last(&seen));
    beside = mean_of(0, SITES, 0);
    printf("  R is %.5f, without a box %.5f\n", beside, alone);
    CHECK(alone > 0 && fabs(beside / alone - 1) < 0.01, "R is %g, without a box %g", beside, alone);
    /* a box that shines has the same size in the single view of 135 degrees as in the views of a hemicube */
    drawn.emission = 1;
    scene.draw_max_radiance = 1;
    REQUIRE(sbl_set_scene(context, &scene) == SBL_SUCCESS && gather(SBL_MODE_DIRECT, SBL_BACKEND_RASTER, 64),
            "no light: %s", watch_last(&seen));
    beside = mean_of(0, SITES, 0);
    single = readings_of(SBL_MODE_DIRECT, SBL_BACKEND_RASTER);
    single.sensor_kind = SBL_SENSOR_SINGLE;
    single.options.sensor_size = 32;
    REQUIRE(sbl_gather_readings(context, &single) == SBL_SUCCESS, "no light: %s", watch_last(&seen));
    alone = mean_of(0, SITES, 0);
    printf("  the box shines: R is %.4f, in a single view %.4f\n", beside, alone);
    CHECK(beside > 0.1 && fabs(beside / alone - 1) < 0.05, "R is %g, in a single view %g", beside, alone);
    host_gl_close();
    scene_free(&s);
}

/* Rasterised light is proportional to the emission of the lamp over 18 orders of magnitude, although the texels of
   views have 16 bits per channel. */
TEST(light_of_any_strength) {
    static const float strengths[] = { 1, 1e-9f, 1e9f };
    double first = 0;
    int i, k;
    for (i = 0; i < 3; i++) {
        test_scene s = { 0 };
        sbl_light *light;
        double mean;
        scene_box(&s, scene_material(&s, 0.7f, 0.6f, 0.5f), -1, -1, -1, 1, 1, 1);
        light = scene_light(&s, SBL_LIGHT_POINT, strengths[i], strengths[i], strengths[i]);
        for (k = 0; k < 3; k++) light->position[k] = 0.3f * (float)k;
        site_count = 0;
        add_sites_anywhere(0.5, 30);
        if (use_scene(&s, 1024) && gather(SBL_MODE_GI, SBL_BACKEND_RASTER, 64)) {
            mean = mean_of(0, site_count, 0) / (double)strengths[i];
            if (i == 0) first = mean;
            CHECK(mean > 0.05 && fabs(mean / first - 1) < 1e-3,
                  "emission %g gives R = %g times itself, emission 1 gives %g",
                  (double)strengths[i], mean, first);
        }
        scene_free(&s);
    }
}

/* >>agreement of the front ends */

static int inspect_all(int *same) {
    int i, shown = 0;
    *same = 0;
    for (i = 0; i < PIXELS; i++) {
        sbl_sensor sensor;
        memset(&sites[i], 0, sizeof sites[i]);
        sites[i].normal[1] = 1;
        readings[i].valid = 0;
        if (sbl_inspect_sensor(context, i % WIDTH, i / WIDTH, &sensor, NULL, NULL, 0) != SBL_SUCCESS) continue;
        sites[i] = sensor.site;
        *same += fabs((double)(sensor.from_surroundings[0] + sensor.from_lamps[0]) - (double)sensor.radiance[0]) <
            1e-4 * (double)sensor.radiance[0] + 1e-6;
        shown++;
    }
    site_count = PIXELS;
    return shown;
}

/* Gathered readings and inspected sensors equal the pixels of a picture with one sensor per pixel. */
TEST(gather_inspection_and_picture_agree) {
    static const sbl_backend backends[] = { SBL_BACKEND_TRACE, SBL_BACKEND_RASTER };
    test_scene s = { 0 };
    float *radiance[2] = { NULL, NULL };
    double sums[2] = { 0, 0 };
    int i, b;
    scene_cornell_box(&s);
    s.materials[0].albedo_texture = 0;
    REQUIRE(use_scene(&s, 4096), "no scene");
    for (b = 0; b < 2; b++) {
        sbl_picture_desc view = scene_plain(scene_cornell_view(WIDTH, HEIGHT), SBL_MODE_GI, 16);
        sbl_readings_desc desc;
        int shown, inspected, same = 0, close = 0;
        view.options.backend = backends[b];
        view.options.rays = 64;
        view.options.seed = 7;
        REQUIRE(sbl_render_picture(context, &view) == SBL_SUCCESS, "no picture: %s", watch_last(&seen));
        radiance[b] = scene_channel(context, &view, SBL_CHANNEL_RADIANCE);
        shown = inspect_all(&inspected);
        desc = scene_readings(sites, readings, PIXELS, SBL_MODE_GI);
        desc.options.backend = backends[b];
        desc.options.rays = 64;
        desc.options.sensor_size = 16;
        desc.options.seed = 7;
        REQUIRE(sbl_gather_readings(context, &desc) == SBL_SUCCESS, "no gather: %s", watch_last(&seen));
        for (i = 0; i < PIXELS; i++) {
            const double r = (double)radiance[b][3 * i];
            if (sites[i].position[2] == 0 && sites[i].position[1] == 0 && sites[i].position[0] == 0) continue;
            same += memcmp(readings[i].radiance, radiance[b] + 3 * i, sizeof readings[i].radiance) == 0;
            close += fabs((double)readings[i].radiance[0] - r) < 1e-4 * r + 1e-6;
            sums[b] += r;
        }
        printf("  %d shown, %d close, %d the same, %d inspected\n", shown, close, same, inspected);
        CHECK(shown > PIXELS / 2 && close > shown * (b ? 95 : 100) / 100 - 1,
              "backend %d: %d of %d readings are close to the picture's", b, close, shown);
        if (b == 0) CHECK(same == shown, "%d of %d readings equal the picture's R to the bit", same, shown);
        CHECK(inspected > shown * 98 / 100, "backend %d: %d of %d inspections equal the picture's R", b, inspected,
              shown);
    }
    printf("  rasterised against traced: %.4f\n", sums[1] / sums[0]);
    CHECK(fabs(sums[1] / sums[0] - 1) < 0.02, "rasterised R is %g of the traced R", sums[1] / sums[0]);
    free(radiance[0]);
    free(radiance[1]);
    scene_free(&s);
}

/* >>bright places */

/* Makes a small patch that a spot lights from below, and a black ground, which receives light only from the patch. A
   black plate hides part of the patch from some sites on the ground. */
static void patch_above_ground(test_scene *s, float half) {
    sbl_light *spot = scene_light(s, SBL_LIGHT_SPOT, 50, 50, 50);
    const int black = scene_material(s, 0, 0, 0);
    int i;
    spot->position[1] = spot->direction[1] = 1;
    spot->cone = 60;
    spot->inner_cone = 59;
    scene_quad(s, scene_material(s, 0.8f, 0.8f, 0.8f), -half, 2, -half, half, 2, -half, half, 2, half, -half, 2, half);
    scene_quad(s, black, -2, 0, -2, -2, 0, 2, 2, 0, 2, 2, 0, -2);
    scene_quad(s, black, -2, 0.9f, -2, -2, 0.9f, 2, 0, 0.9f, 2, 0, 0.9f, -2);
    site_count = 0;
    for (i = 0; i < 8; i++) add_site(i < 4 ? 0.04 * i - 0.04 : 0.4 * i - 1.4, 0, 0.1 * i, 0, 1, 0, 1);
}

/* Returns R on the ground from the patch of patch_above_ground. end: the patch is black where x is larger */
static double light_of_patch(double half, double end, const float site[3]) {
    enum { STEPS = 400 };
    double sum = 0;
    int i;
    for (i = 0; i < STEPS * STEPS; i++) {
        const double x = half * (2 * (i % STEPS + 0.5) / STEPS - 1), z = half * (2 * (i / STEPS + 0.5) / STEPS - 1);
        const double to_spot2 = x * x + z * z + 1, dx = x - (double)site[0], dz = z - (double)site[2];
        const double radiance = 0.8 * 50 / TEST_PI / (to_spot2 * sqrt(to_spot2)), d2 = dx * dx + dz * dz + 4;
        if (x > end || (double)site[0] + 0.45 * dx < 0) continue;  /* the line to the patch passes the plate */
        sum += radiance * 4 / (TEST_PI * d2 * d2) * (4 * half * half / (STEPS * STEPS));
    }
    return sum;
}

static double worst_below_patch(double half) {
    double worst = 0;
    int i;
    for (i = 0; i < site_count; i++) {
        const double expected = light_of_patch(half, half, sites[i].position);
        worst = test_max(worst, fabs((double)readings[i].radiance[1] - expected));
    }
    return worst / light_of_patch(half, half, sites[4].position);
}

/* Few rays find a small bright place by chance, so it must be a lamp. A store that is saved and loaded
   still gives the same light. */
TEST(a_small_bright_place) {
    static const double halves[] = { 0.02, 0.1, 0.3 };
    static sbl_reading first[MOST_SITES];
    int i;
    for (i = 0; i < 3; i++) {
        test_scene s = { 0 };
        sbl_scene_desc scene;
        patch_above_ground(&s, (float)halves[i]);
        scene = scene_desc(&s);
        saved.count = saved.at = 0;
        if (use_scene(&s, 8192) && gather(SBL_MODE_GI, SBL_BACKEND_RASTER, 64)) {
            printf("  patch of %g: rasterised: within %.2f %% of the light\n", 2 * halves[i],
                   100 * worst_below_patch(halves[i]));
            CHECK(worst_below_patch(halves[i]) < 0.05, "R of a rasterised sensor is wrong by %.1f %%",
                  100 * worst_below_patch(halves[i]));
        }
        if (gather(SBL_MODE_GI, SBL_BACKEND_TRACE, 64)) {
            printf("  patch of %g: traced: within %.2f %%\n", 2 * halves[i], 100 * worst_below_patch(halves[i]));
            CHECK(worst_below_patch(halves[i]) < 0.05, "R is wrong by %.1f %%", 100 * worst_below_patch(halves[i]));
        }
        memcpy(first, readings, sizeof first);
        CHECK(sbl_save_store(context, saved_put, NULL) == SBL_SUCCESS &&
              sbl_set_scene(context, &scene) == SBL_SUCCESS &&
              sbl_load_store(context, saved_get, NULL) == SBL_SUCCESS && gather(SBL_MODE_GI, SBL_BACKEND_TRACE, 64),
              "the store was not saved and loaded: %s", watch_last(&seen));
        CHECK(!memcmp(first, readings, (size_t)site_count * sizeof *first), "a loaded store gives other light");
        saved.at = 0;
        CHECK(inside_glow_count(context) > 0 && sbl_load_store(context, saved_get, NULL) == SBL_SUCCESS &&
              inside_glow_count(context) == 0, "glows outlast the store that they were made from");
        scene_free(&s);
    }
}

/* The patch has a texture, which makes its half with x > 0 black. Its light comes from the other half. */
TEST(glows_show_their_texture) {
    enum { TEXELS = 64 };
    const double half = 0.3;
    static unsigned char texels[TEXELS];
    test_scene s = { 0 };
    double sum = 0, expected = 0;
    int i;
    for (i = 0; i < TEXELS; i++) texels[i] = i < TEXELS / 2 ? 255 : 0;
    patch_above_ground(&s, (float)half);
    s.materials[s.meshes[0].material].albedo_texture =
        scene_texture(&s, texels, TEXELS, SBL_PIXELS_LINEAR8, TEXELS, 1, 1);
    if (use_scene(&s, 8192) && gather(SBL_MODE_GI, SBL_BACKEND_TRACE, 64)) {
        CHECK(inside_glow_count(context) > 0, "the patch has made no glow");
        for (i = 4; i < site_count; i++) {  /* the plate hides a part of the patch from the first four sites */
            sum += (double)readings[i].radiance[1];
            expected += light_of_patch(half, 0, sites[i].position);
        }
        printf("  light on the ground: %.4f, expected %.4f; behind the plate: %.4f\n", sum, expected,
               (double)readings[0].radiance[1]);
        CHECK(fabs(sum / expected - 1) < 0.05, "the patch sends %g, expected %g", sum, expected);
        CHECK(readings[0].radiance[1] < 0.005f, "the black half sends %g", (double)readings[0].radiance[1]);
    }
    scene_free(&s);
}

/* Sensors face grey ground from a height of 0.02. Where a ray hits ground this near, it continues with further segments
   instead of reading the store. The ground receives light only from a glow behind the sensors, so that only the further
   segments can find the glow. */
TEST(near_hits_find_glows) {
    const double half = 0.3;
    double sum = 0, expected = 0;
    test_scene s = { 0 };
    int i;
    patch_above_ground(&s, (float)half);
    scene_quad(&s, scene_material(&s, 0.8f, 0.8f, 0.8f), -2, 0.01f, -2, -2, 0.01f, 2, 2, 0.01f, 2, 2, 0.01f, -2);
    site_count = 0;
    for (i = 0; i < 16; i++) add_site(0.5 + 0.2 * (i % 4), 0.03, 0.2 * (i / 4), 0, -1, 0, 1);
    if (use_scene(&s, 8192) && gather(SBL_MODE_GI, SBL_BACKEND_TRACE, 4096)) {
        CHECK(inside_glow_count(context) > 0, "the patch has made no glow");
        for (i = 0; i < site_count; i++) {
            sum += (double)readings[i].radiance[1];
            expected += 0.8 * light_of_patch(half, half, sites[i].position);
        }
        printf("  light of the ground: %.4f, expected %.4f; %d glows\n", sum / 16, expected / 16,
               inside_glow_count(context));
        CHECK(fabs(sum / expected - 1) < 0.1, "the ground sends %g, expected %g", sum / 16, expected / 16);
    }
    scene_free(&s);
}

/* If the light of the spot that lights the glows is halved, R is halved, too. The store keeps its cells and hits, and
   only computes their light again. */
TEST(glows_follow_new_lights) {
    test_scene s = { 0 };
    double before = 0, after = 0;
    int i, k;
    patch_above_ground(&s, 0.3f);
    if (use_scene(&s, 8192) && gather(SBL_MODE_GI, SBL_BACKEND_TRACE, 256)) {
        const double rays = (double)sbl_query_stats(context).store.rays;
        for (i = 0; i < site_count; i++) before += (double)readings[i].radiance[1];
        for (k = 0; k < 3; k++) s.lights[0].intensity[k] *= 0.5f;
        CHECK(sbl_set_lights(context, s.lights, s.light_count) == SBL_SUCCESS &&
              gather(SBL_MODE_GI, SBL_BACKEND_TRACE, 256), "%s", watch_last(&seen));
        for (i = 0; i < site_count; i++) after += (double)readings[i].radiance[1];
        printf("  R %g, then %g; %d glows; %.0f rays, then %.0f\n", before / site_count, after / site_count,
               inside_glow_count(context), rays, (double)sbl_query_stats(context).store.rays);
        CHECK(before > 0 && fabs(2 * after / before - 1) < 0.02, "R is %g, then %g", before / site_count,
              after / site_count);
        CHECK(inside_glow_count(context) > 0, "there are no glows");
        CHECK((double)sbl_query_stats(context).store.rays < 0.5 * rays, "the hits are not kept");
    }
    scene_free(&s);
}

/* Returns R on the floor y = 0 from the patch of bright_leaves_are_right_on_average, at the height `up`. */
static double floor_below_patch(double half, double up, double x, double z) {
    enum { STEPS = 12 };
    double sum = 0;
    int i;
    for (i = 0; i < STEPS * STEPS; i++) {
        const double px = half * (2 * (i % STEPS + 0.5) / STEPS - 1), pz = half * (2 * (i / STEPS + 0.5) / STEPS - 1);
        const double to_spot2 = px * px + pz * pz + up * up / 4, dx = px - x, dz = pz - z;
        const double radiance = 0.8 * 50 / TEST_PI * (up / 2) / (to_spot2 * sqrt(to_spot2));
        const double d2 = dx * dx + dz * dz + up * up;
        sum += radiance * up * up / (TEST_PI * d2 * d2) * (4 * half * half / (STEPS * STEPS));
    }
    return sum;
}

/* A spot lights a small patch above a white floor, and the patch alone lights the floor. The rays of a black ceiling
   find the whole floor. Few rays of the floor's points hit the patch, and leaves whose points hit it more often than
   expected are chosen as bright leaves. They must not keep this estimate, which makes the floor 56 % too bright. */
TEST(bright_leaves_are_right_on_average) {
    enum { STEPS = 400 };
    const double half = 0.08, up = 0.5, side = 4;
    static double floor_light[STEPS * STEPS];
    double sum = 0, expected = 0;
    test_scene s = { 0 };
    sbl_light *spot = scene_light(&s, SBL_LIGHT_SPOT, 50, 50, 50);
    const int white = scene_material(&s, 0.8f, 0.8f, 0.8f);
    int i, k;
    spot->position[1] = (float)(up / 2);
    spot->direction[1] = 1;
    spot->cone = 60;
    spot->inner_cone = 59;
    scene_quad(&s, white, -(float)half, (float)up, -(float)half, (float)half, (float)up, -(float)half, (float)half,
               (float)up, (float)half, -(float)half, (float)up, (float)half);
    scene_quad(&s, white, -2, 0, -2, -2, 0, 2, 2, 0, 2, 2, 0, -2);
    scene_quad(&s, scene_material(&s, 0, 0, 0), -3, 2, -3, 3, 2, -3, 3, 2, 3, -3, 2, 3);
    site_count = 0;
    for (i = 0; i < 8; i++) add_site(1.2 * cos(i), 1.5, 1.2 * sin(i), 0, -1, 0, 1);
    for (i = 0; i < STEPS * STEPS; i++)
        floor_light[i] = floor_below_patch(half, up, side * ((i % STEPS + 0.5) / STEPS - 0.5),
                                           side * ((i / STEPS + 0.5) / STEPS - 0.5));
    if (use_scene(&s, 32768) && gather(SBL_MODE_GI, SBL_BACKEND_TRACE, 4096)) {
        for (k = 0; k < site_count; k++) {
            sum += (double)readings[k].radiance[1];
            for (i = 0; i < STEPS * STEPS; i++) {
                const double x = side * ((i % STEPS + 0.5) / STEPS - 0.5) - (double)sites[k].position[0];
                const double z = side * ((i / STEPS + 0.5) / STEPS - 0.5) - (double)sites[k].position[2];
                const double y = (double)sites[k].position[1], d2 = x * x + y * y + z * z, t = 1 - up / y;
                const double px = (double)sites[k].position[0] + t * x, pz = (double)sites[k].position[2] + t * z;
                if (fabs(px) < half && fabs(pz) < half) continue;  /* the patch hides this part of the floor */
                expected += 0.8 * floor_light[i] * y * y / (TEST_PI * d2 * d2) * side * side / (STEPS * STEPS);
            }
        }
        printf("  light above the floor: %.5f, expected %.5f; %d glows\n", sum / site_count, expected / site_count,
               inside_glow_count(context));
        CHECK(inside_glow_count(context) > 0, "nothing has made a glow");
        CHECK(fabs(sum / expected - 1) < 0.05, "R is %.1f %% of the expected one", 100 * sum / expected);
    }
    scene_free(&s);
}

/* A narrow spot lights a disc of a white floor, about as large as four cells of the store. The edge of the disc crosses
   cells, and the few points of a leaf there may all be in the light, or all outside it. The glows must nevertheless
   have the power of the spot, wherever the spot stands. Leaves that turn out to be dark make no glows. */
TEST(glows_have_the_power_of_a_spot) {
    enum { SPOTS = 8, STEPS = 64 };
    const double height = 0.5, cone = 24, radius = height * tan(0.5 * cone * TEST_PI / 180);
    double squares = 0;
    int i, k, spot;
    for (spot = 0; spot < SPOTS; spot++) {
        test_scene s = { 0 };
        sbl_light *light = scene_light(&s, SBL_LIGHT_SPOT, 50, 50, 50);
        const double at[2] = { 0.037 * spot - 0.1, 0.1 - 0.053 * spot };
        double sum = 0, expected = 0;
        for (k = 0; k < 2; k++) light->position[2 * k] = (float)at[k];
        light->position[1] = (float)height;
        light->direction[1] = -1;
        light->cone = (float)cone;
        light->inner_cone = (float)cone;
        scene_quad(&s, scene_material(&s, 0.8f, 0.8f, 0.8f), -2, 0, -2, -2, 0, 2, 2, 0, 2, 2, 0, -2);
        scene_quad(&s, scene_material(&s, 0, 0, 0), -3, 2, -3, 3, 2, -3, 3, 2, 3, -3, 2, 3);
        site_count = 0;
        for (i = 0; i < 8; i++) add_site(1.2 * cos(i), 1.5, 1.2 * sin(i), 0, -1, 0, 1);
        if (use_scene(&s, 8192) && gather(SBL_MODE_GI, SBL_BACKEND_TRACE, 1024)) {
            for (k = 0; k < site_count; k++) {
                const float *site = sites[k].position;
                sum += (double)readings[k].radiance[1];
                for (i = 0; i < STEPS * STEPS; i++) {  /* rings of equal area */
                    const double r = radius * sqrt((i % STEPS + 0.5) / STEPS);
                    const double turn = 2 * TEST_PI * (i / STEPS) / STEPS;
                    const double x = at[0] + r * cos(turn) - (double)site[0], y = (double)site[1];
                    const double z = at[1] + r * sin(turn) - (double)site[2];
                    const double spot2 = r * r + height * height, d2 = x * x + y * y + z * z;
                    expected += 0.8 * 50 / TEST_PI * height / (spot2 * sqrt(spot2)) * y * y / (TEST_PI * d2 * d2) *
                                TEST_PI * radius * radius / (STEPS * STEPS);
                }
            }
            printf("  spot %d: %.2f %% of the expected R, %d glows\n", spot, 100 * sum / expected,
                   inside_glow_count(context));
            CHECK(inside_glow_count(context) > 0, "nothing has made a glow");
            CHECK(inside_glow_count(context) < 40, "dark leaves make glows");
            squares += (sum / expected - 1) * (sum / expected - 1);
        }
        scene_free(&s);
    }
    CHECK(sqrt(squares / SPOTS) < 0.03, "R differs by %.1f %%", 100 * sqrt(squares / SPOTS));
}

/* A lamp in a black tube lights a small patch above a floor, and the patch lights the floor. The sites face the floor,
   and the tube hides the lamp from them. Nevertheless, their rays must go to glows of the floor and not only to the
   lamp, which is expected to be far stronger. Otherwise the readings are noisy. */
TEST(glows_beside_a_hidden_lamp) {
    enum { SEEDS = 24 };
    const float half = 0.08f, up = 0.5f, w = 0.06f, low = 0.2f, high = 0.45f;
    test_scene s = { 0 };
    const int white = scene_material(&s, 0.8f, 0.8f, 0.8f), black = scene_material(&s, 0, 0, 0);
    const int lamp = scene_lamp(&s, 4000, 4000, 4000);
    double sum = 0, squares = 0;
    int i;
    s.materials[lamp].flags = SBL_MATERIAL_ONE_SIDED_EMISSION;
    scene_quad(&s, lamp, -0.01f, low, -0.01f, -0.01f, low, 0.01f, 0.01f, low, 0.01f, 0.01f, low, -0.01f);
    scene_quad(&s, black, -w, 0.1f, -w, -w, high, -w, -w, high, w, -w, 0.1f, w);
    scene_quad(&s, black, w, 0.1f, -w, w, high, -w, w, high, w, w, 0.1f, w);
    scene_quad(&s, black, -w, 0.1f, -w, -w, high, -w, w, high, -w, w, 0.1f, -w);
    scene_quad(&s, black, -w, 0.1f, w, -w, high, w, w, high, w, w, 0.1f, w);
    scene_quad(&s, white, -half, up, -half, half, up, -half, half, up, half, -half, up, half);
    scene_quad(&s, white, -2, 0, -2, -2, 0, 2, 2, 0, 2, 2, 0, -2);
    scene_quad(&s, black, -3, 2, -3, 3, 2, -3, 3, 2, 3, -3, 2, 3);
    site_count = 0;
    for (i = 0; i < SEEDS; i++) add_site(1.2, 1.5, 0, 0, -1, 0, 1);
    if (use_scene(&s, 32768) && gather(SBL_MODE_GI, SBL_BACKEND_TRACE, 256)) {
        for (i = 0; i < SEEDS; i++) {
            const double r = (double)readings[i].radiance[1];
            sum += r / SEEDS;
            squares += r * r / SEEDS;
        }
        printf("  R %.5f, standard deviation %.1f %%, %d glows\n", sum, 100 * sqrt(squares - sum * sum) / sum,
               inside_glow_count(context));
        CHECK(inside_glow_count(context) > 0, "nothing has made a glow");
        CHECK(sqrt(squares - sum * sum) < 0.2 * sum, "readings differ by %.1f %%",
              100 * sqrt(squares - sum * sum) / sum);
    }
    scene_free(&s);
}

/* A lamp lights a floor under a black sky. The floor is far brighter than the mean of the light that rays find, because
   most rays hit nothing. It must not become a glow, because its reflected light is weak compared with the lamp. */
TEST(a_lit_floor_is_no_glow) {
    test_scene s = { 0 };
    const int white = scene_material(&s, 0.8f, 0.8f, 0.8f), lamp = scene_lamp(&s, 20, 20, 20);
    scene_quad(&s, white, -6, 0, -6, -6, 0, 6, 6, 0, 6, 6, 0, -6);
    scene_box(&s, white, -0.8f, 0.9f, -0.7f, 0.8f, 0.96f, 0.7f);
    scene_quad(&s, lamp, -0.6f, 3, -0.6f, 0.6f, 3, -0.6f, 0.6f, 3, 0.6f, -0.6f, 3, 0.6f);
    site_count = 0;
    add_site(1, 0, 1, 0, 1, 0, 1);
    if (use_scene(&s, 8192) && gather(SBL_MODE_GI, SBL_BACKEND_TRACE, 64))
        CHECK(inside_glow_count(context) == 0, "%d glows", inside_glow_count(context));
    scene_free(&s);
}

/* Returns R that the floor at y = 0 gives a site above it, by quadrature. A spotlight at (lamp, 1, 0) lights a disc. A
   plate at x = 0 that begins at y = edge hides part of the disc from the site. */
static double light_below_an_edge(const float site[3], double lamp, double edge) {
    enum { STEPS = 300 };
    const double limit = cos(TEST_PI / 6), side = 1.2;
    double sum = 0;
    int i;
    for (i = 0; i < STEPS * STEPS; i++) {
        const double x = lamp + side * ((i / STEPS + 0.5) / STEPS - 0.5), z = side * ((i % STEPS + 0.5) / STEPS - 0.5);
        const double cosine = 1 / sqrt(1 + (x - lamp) * (x - lamp) + z * z);
        const double spot = cosine > limit ? (cosine - limit) / (1 - limit) : 0, y = (double)site[1];
        const double across = x - (double)site[0], along = z - (double)site[2];
        const double away2 = across * across + y * y + along * along;
        if (y * (1 + (double)site[0] / across) > edge) continue;
        sum += 0.5 * spot * spot * cosine * cosine * cosine * y * y / (away2 * away2);
    }
    return sum * side * side / (TEST_PI * STEPS * STEPS);
}

/* A spotlight lights a disc of the floor. Sites under the ceiling see part of the disc below the edge of a black plate.
   The visible part of a leaf differs from the rest of it, so leaves must be narrow where the light varies. */
TEST(leaves_are_divided_where_light_varies) {
    enum { SIDES = 8 };
    const double edge = 1.2, lamp = 0.65;
    test_scene s = { 0 };
    const int white = scene_material(&s, 0.5f, 0.5f, 0.5f), black = scene_material(&s, 0, 0, 0);
    double off = 0, all = 0;
    sbl_light *light;
    int cells, k;
    scene_floor(&s, white, 0, 5);
    scene_quad(&s, black, -5, 4, -5, 5, 4, -5, 5, 4, 5, -5, 4, 5);
    scene_quad(&s, black, 0, (float)edge, -5, 0, (float)edge, 5, 0, 4, 5, 0, 4, -5);
    light = scene_light(&s, SBL_LIGHT_SPOT, (float)TEST_PI, 0, 0);
    light->position[0] = (float)lamp;
    light->position[1] = 1;
    light->direction[1] = -1;
    light->cone = 60;
    site_count = 0;
    for (k = 0; k < SIDES; k++) add_site(-1.2 - 0.1 * k, 3.99, 0.15 * k - 0.5, 0, -1, 0, 0);
    for (cells = 10240; cells <= 20480; cells += 2048) {
        if (!use_scene(&s, cells) || !gather(SBL_MODE_GI, SBL_BACKEND_TRACE, 512)) break;
        for (k = 0; k < SIDES; k++) {
            const double expected = light_below_an_edge(sites[k].position, lamp, edge);
            off += fabs((double)readings[k].radiance[0] - expected);
            all += expected;
        }
    }
    printf("  off by %.2f %% of the light\n", 100 * off / all);
    CHECK(all > 0 && off < 0.06 * all, "off by %g of the light", off / all);
    scene_free(&s);
}

/* Returns R on the floor below a ceiling of albedo 0.9, which a light `gap` below it illuminates, as a sum over rings
   of the ceiling. The light is at x = z = 0, points up, and has the intensity PI and a cone of 160 degrees. */
static double light_of_a_ceiling(const float p[3], double height, double gap) {
    enum { RINGS = 4000, SECTORS = 64 };
    const double widest = gap * tan(80 * TEST_PI / 180), x = hypot((double)p[0], (double)p[2]);
    double sum = 0;
    int i, k;
    for (i = 0; i < RINGS; i++) {
        const double r = widest * (i + 0.5) / RINGS, d2 = r * r + gap * gap;
        const double radiance = 0.9 * gap / (d2 * sqrt(d2));  /* 0.9 / PI * intensity * cosine / d2 */
        for (k = 0; k < SECTORS; k++) {
            const double angle = 2 * TEST_PI * (k + 0.5) / SECTORS, h2 = height * height;
            const double away2 = r * r + x * x - 2 * r * x * cos(angle) + h2;
            sum += radiance * h2 / (away2 * away2) / TEST_PI * r * widest / RINGS * 2 * TEST_PI / SECTORS;
        }
    }
    return sum;
}

/* A light close below the ceiling makes a bright spot that is no wider than a few cells, so that few points cannot
   measure it. Leaves there have more than four points, and those beyond the fourth are where distant rays hit. The mean
   over sites on the floor is compared with the closed form for several sizes of the store. */
TEST(bright_leaves_get_more_points) {
    enum { SIDES = 8, STORES = 8 };
    const double height = 6, gap = 0.25;
    const float y = (float)height;
    test_scene s = { 0 };
    double squares = 0;
    sbl_light *light;
    int i, k;
    scene_box(&s, scene_material(&s, 0, 0, 0), -2, 0, -2, 2, y + 0.001f, 2);
    scene_quad(&s, scene_material(&s, 0.9f, 0.9f, 0.9f), -2, y, -2, 2, y, -2, 2, y, 2, -2, y, 2);
    light = scene_light(&s, SBL_LIGHT_SPOT, (float)TEST_PI, 0, 0);
    light->position[1] = (float)(height - gap);
    light->direction[1] = 1;
    light->cone = light->inner_cone = 160;
    site_count = 0;
    for (k = 0; k < SIDES; k++) add_site(0.3 * k - 1, 0, 0.2 * k - 0.6, 0, 1, 0, 0);
    for (i = 0; i < STORES; i++) {
        double found = 0, expected = 0;
        if (!use_scene(&s, 8192 + 1024 * i) || !gather(SBL_MODE_GI, SBL_BACKEND_TRACE, 1024)) break;
        for (k = 0; k < SIDES; k++) {
            found += (double)readings[k].radiance[0];
            expected += light_of_a_ceiling(sites[k].position, height, gap);
        }
        printf("  %d of %d cells, up to %d points: off by %+.2f %%\n", sbl_query_stats(context).store.cells,
               8192 + 1024 * i, inside_most_points(context), 100 * (found / expected - 1));
        CHECK(inside_most_points(context) > 8 && inside_most_points(context) <= 32, "no leaf has more than %d points",
              inside_most_points(context));
        CHECK(inside_near_points(context) == 0, "rays from nearby have chosen %d points", inside_near_points(context));
        squares += (found / expected - 1) * (found / expected - 1);
    }
    printf("  root mean square %.2f %%\n", 100 * sqrt(squares / STORES));
    CHECK(i == STORES && squares < 0.02 * 0.02 * STORES, "R of the floor is off by %g", sqrt(squares / STORES));
    scene_free(&s);
}

int main(void) {
    RUN_PLAIN(walls_keep_light_out);
    RUN_PLAIN(two_sides_of_a_wall);
    RUN_PLAIN(furnaces);
    RUN_PLAIN(a_furnace_in_a_large_scene);
    RUN(furnace_under_the_sky);
    RUN_UNSANITIZED(furnace_of_a_texture);
    RUN(a_wall_in_the_light_of_a_picture);
    RUN(albedo_of_one);
    RUN_PLAIN(light_is_neither_made_nor_lost);
    RUN_PLAIN(a_cube_by_paths);
    RUN_PLAIN(colours_of_a_wall);
    RUN(the_store_is_kept_and_renewed);
    RUN(a_trench_narrower_than_cells);
    RUN(near_hits_find_their_own_light);
    RUN(lamps_light_near_hits);
    RUN_PLAIN(leaves_are_divided_where_light_varies);
    RUN_PLAIN(bright_leaves_get_more_points);
    RUN(far_light_is_not_near_light);
    RUN(a_pleated_sheet);
    RUN(a_hollow_body);
    RUN_UNSANITIZED(a_crowd_of_boxes);
    RUN_PLAIN(more_sides_than_samples);
    RUN_PLAIN(more_meshes_than_samples);
    RUN_PLAIN(ground_that_no_surface_sees);
    RUN(draw_callback_receives_the_ambient_light);
    RUN(lamps_beside_what_the_host_draws);
    RUN(light_of_any_strength);
    RUN_PLAIN(gather_inspection_and_picture_agree);
    RUN(a_small_bright_place);
    RUN(glows_show_their_texture);
    RUN(near_hits_find_glows);
    RUN(glows_follow_new_lights);
    RUN_UNSANITIZED(bright_leaves_are_right_on_average);
    RUN_UNSANITIZED(glows_have_the_power_of_a_spot);
    RUN_UNSANITIZED(glows_beside_a_hidden_lamp);
    RUN(a_lit_floor_is_no_glow);
    sbl_destroy(context);
    return test_report();
}
