/* Light that bounces: SBL_MODE_GI. What closed forms, sums of light and a path tracer say it must be, what walls must keep out, and when the
   store of it is made anew. */
#define SBL_IMPLEMENTATION
#define SBL_EGL
#include "../sbl.h"
#include "test.h"
#include "scenes.h"
#include "gl_watch.h"

enum { MOST_SITES = 2048 };

static watch seen;
static sbl_context *context;
static sbl_site sites[MOST_SITES];
static sbl_reading readings[MOST_SITES];
static double areas[MOST_SITES];  /* of the surface that each stands for */
static int site_count;

/* Sets the scene in the one context that all share. samples: of the store; 0 is the default. */
static int use_scene(const test_scene *s, int samples) {
    const sbl_context_desc desc = watch_desc(&seen);
    sbl_scene_desc scene = scene_desc(s);
    scene.bounce_samples = samples;
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

/* n x n sites in the middles of parts of a parallelogram that the corner and two edges span, looking along u x v. */
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

/* n x n on each of a box's faces, looking inwards; their areas are what they stand for. */
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

/* Readings at all sites. */
static int gather(sbl_mode mode, sbl_backend backend, int rays) {
    sbl_gather_desc desc;
    sbl_result result;
    memset(&desc, 0, sizeof desc);
    memset(readings, 0xff, sizeof readings);
    desc.sites = sites;
    desc.readings = readings;
    desc.site_count = site_count;
    desc.mode = mode;
    desc.backend = backend;
    desc.rays = rays;
    desc.sensor_size = 32;
    result = sbl_gather(context, &desc);
    CHECK(result == SBL_SUCCESS, "no readings: %s", watch_last(&seen));
    return result == SBL_SUCCESS;
}

/* Mean and greatest R of a channel over sites from .. to - 1. */
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

/* >>leaks */

static const float scales[] = { 1e-2f, 1, 1e3f };
static const int budgets[] = { 1024, 8192, 49152 };

/* A room of 4 x 3 x 4 with a lamp below its ceiling. */
static void lit_room(test_scene *s) {
    scene_box(s, scene_material(s, 0.7f, 0.6f, 0.5f), 0, 0, 0, 4, 3, 4);
    scene_quad(s, scene_lamp(s, 5, 5, 5), 0.7f, 2.9f, 0.8f, 1.7f, 2.9f, 0.8f, 1.7f, 2.9f, 1.8f, 0.7f, 2.9f, 1.8f);
}

static void box_of_slabs(test_scene *s, int material, float x0, float y0, float z0, float x1, float y1, float z1, float t) {
    scene_box(s, material, x0 - t, y0 - t, z0 - t, x1 + t, y0, z1 + t);
    scene_box(s, material, x0 - t, y1, z0 - t, x1 + t, y1 + t, z1 + t);
    scene_box(s, material, x0 - t, y0, z0, x0, y1, z1);
    scene_box(s, material, x1, y0, z0, x1 + t, y1, z1);
    scene_box(s, material, x0 - t, y0, z0 - t, x1 + t, y1, z0);
    scene_box(s, material, x0 - t, y0, z1, x1 + t, y1, z1 + t);
}

/* Four sides and a top. */
static void box_without_bottom(test_scene *s, int material, float x0, float y0, float z0, float x1, float y1, float z1) {
    scene_box(s, material, x0, y0, z0, x1, y1, z1);
    s->meshes[s->mesh_count - 4] = s->meshes[s->mesh_count - 1];
    s->mesh_count--;
}

/* Its places, about the y axis, and moved. */
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

/* Each triangle becomes four, and again, so many times; no indices any more. */
static void divide_mesh(test_scene *s, sbl_mesh *m, int times) {
    for (; times > 0; times--) {
        const float *from = (const float *)m->positions.data;
        const uint32_t *indices = (const uint32_t *)m->indices.data;
        const int count = m->index_count ? m->index_count / 3 : m->vertex_count / 3;
        float *to = (float *)scene_alloc(s, sizeof *to * 36 * (size_t)count);
        int i, j, k;
        for (i = 0; i < count; i++) {
            static const int pairs[12][2] = { { 0, 0 }, { 0, 1 }, { 0, 2 }, { 0, 1 }, { 1, 1 }, { 1, 2 }, { 0, 2 }, { 1, 2 }, { 2, 2 }, { 0, 1 }, { 1, 2 }, { 0, 2 } };
            for (j = 0; j < 12; j++)
                for (k = 0; k < 3; k++) {
                    const size_t a = (size_t)(3 * i + pairs[j][0]), b = (size_t)(3 * i + pairs[j][1]);
                    to[36 * i + 3 * j + k] = 0.5f * (from[3 * (m->index_count ? indices[a] : a) + (size_t)k] + from[3 * (m->index_count ? indices[b] : b) + (size_t)k]);
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
        case 4:  /* turned, and of small triangles */
            box_without_bottom(s, grey, -0.3f, 0, -0.2f, 0.3f, 0.6f, 0.2f);
            for (i = s->mesh_count - 5; i < s->mesh_count; i++) {
                turn_mesh(s, &s->meshes[i], 0.5, 2, 0, 1.7f);
                divide_mesh(s, &s->meshes[i], 4);
            }
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

static void leak_sites(int kind, int n) {
    site_count = 0;
    if (kind < 3) add_sites_in_box(1.53, 0.51, 1.37, 2.12, 1.1, 2.03, n);
    else if (kind == 3) add_sites_in_box(1.53, 0, 1.37, 2.12, 0.6, 2.03, n);
    else if (kind == 4) add_sites_in_box(2 - 0.15, 0, 1.7 - 0.1, 2 + 0.15, 0.6, 1.7 + 0.1, n);
    else add_sites_in_box(3.88, 0, 0, 8, 3, 4, n);
}

TEST(walls_keep_light_out) {
    static const char *const names[] = { "a thin box", "a hollow box", "a box of slabs", "a box on the floor", "a turned box", "two rooms", "two rooms askew",
                                         "a wall of small triangles" };
    int kind, i, j;
    for (kind = 0; kind < 8; kind++)
        for (i = 0; i < 3; i++)
            for (j = 0; j < 3; j++) {
                test_scene s = { 0 };
                int inside;
                double lit, dark;
                if (j == 2 && i != 1 && kind != 3 && kind != 5) continue;
                leak_scene(&s, kind);
                scene_scale_and_move(&s, scales[i], 0, 0, 0);
                leak_sites(kind, 5);
                inside = site_count;
                add_site(0.5, 0, 0.5, 0, 1, 0, 1);
                add_site(1, 0, 1.5, 0, 1, 0, 1);
                add_site(0, 1.5, 2, 1, 0, 0, 1);
                scale_sites(scales[i]);
                if (!use_scene(&s, budgets[j]) || !gather(SBL_MODE_GI, SBL_BACKEND_TRACE, 256)) { scene_free(&s); return; }
                lit = mean_of(inside, site_count, 0);
                dark = most_of(0, inside);
                if (i == 1) printf("  %s, scale %g, %d: lit %g, dark %g; %d leaves %.2f s\n", names[kind], (double)scales[i], budgets[j], lit, dark,
                       sbl_query_stats(context).bounce_samples, sbl_query_stats(context).seconds.bounce);
                CHECK(lit > 0.1, "%s, scale %g, %d samples: the room's R is %g", names[kind], (double)scales[i], budgets[j], lit);
                CHECK(dark < 1e-4 * lit, "%s, scale %g, %d samples: R in the dark is %g of the room's", names[kind], (double)scales[i],
                      budgets[j], dark / lit);
                scene_free(&s);
            }
}

/* Both sides of one wall, of which one has a thousand times the light, against each side where the other is dark. */
TEST(two_sides_of_a_wall) {
    double worst = 0;
    int i, j, k, n;
    for (i = 0; i < 9; i++) {
        double alone[2] = { 0, 0 }, both[2] = { 0, 0 };
        for (k = 0; k < 3; k++) {
            test_scene s = { 0 };
            leak_scene(&s, 5);
            scene_quad(&s, scene_lamp(&s, 0.005f, 0.005f, 0.005f), 5.7f, 2.8f, 1.8f, 6.7f, 2.8f, 1.8f, 6.7f, 2.8f, 2.8f, 5.7f, 2.8f, 2.8f);
            for (j = 0; j < 3; j++) {
                if (k == 0) s.materials[s.mesh_count == 9 ? 3 : s.material_count - 1].emission[j] = 0;
                if (k == 1) s.materials[1].emission[j] = s.materials[2].emission[j] = 0;
            }
            scene_scale_and_move(&s, scales[i / 3], 0, 0, 0);
            site_count = 0;
            for (n = 0; n < 8; n++) add_site(3.87, 0.2 + 0.35 * n, 0.3 + 0.45 * n, -1, 0, 0, 1);
            for (n = 0; n < 8; n++) add_site(3.87, 0.2 + 0.35 * n, 0.3 + 0.45 * n, 1, 0, 0, 1);
            scale_sites(scales[i / 3]);
            if (!use_scene(&s, budgets[i % 3] / (i / 3 == 1 ? 1 : i % 3 == 2 ? 4 : 1)) || !gather(SBL_MODE_GI, SBL_BACKEND_TRACE, 256)) { scene_free(&s); return; }
            if (k < 2) alone[k] = mean_of(8 * k, 8 * k + 8, 0);
            else { both[0] = mean_of(0, 8, 0); both[1] = mean_of(8, 16, 0); }
            scene_free(&s);
        }
        for (k = 0; k < 2; k++) {
            worst = test_max(worst, fabs(both[k] / alone[k] - 1));
            CHECK(alone[k] > 1e-4 && fabs(both[k] / alone[k] - 1) < 0.01, "scale %g, %d samples, side %d: R is %g, alone %g", (double)scales[i / 3],
                  budgets[i % 3], k, both[k], alone[k]);
        }
    }
    printf("  off by %.2g at most\n", worst);
}

int main(void) {
    RUN(walls_keep_light_out);
    RUN(two_sides_of_a_wall);
    sbl_destroy(context);
    return test_report();
}
