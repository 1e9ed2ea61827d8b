/* The second half of bench.c: sensors that trace rays, in rooms of 32 to a million triangles, beside rasterised ones and, where the compiler finds
   Embree 3, beside the same kind of rays in Embree. The rooms are the Cornell box, filled with dented balls that share a number of triangles. */
#ifndef BENCH_TRACE_H
#define BENCH_TRACE_H

#if defined(__has_include)
#if __has_include(<embree3/rtcore.h>) && defined(BENCH_EMBREE)
#include <embree3/rtcore.h>
#define EMBREE 1
#endif
#endif

enum { BALLS = 12, ROOMS = 5 };

typedef struct room {
    cornell_box box;
    sbl_mesh meshes[CORNELL_QUADS + BALLS];
    sbl_scene_desc scene;
    float *positions;
    unsigned *indices;
    int triangles, ball_vertices, ball_triangles;
} room;

/* About `triangles` of them. */
static int room_make(room *r, int triangles) {
    int rings = (int)sqrt((triangles - CORNELL_TRIANGLES) / (4.0 * BALLS)), around = 2 * rings, ball, i, j;
    float *p;
    unsigned *index;
    if (triangles <= CORNELL_TRIANGLES) rings = around = 0;
    r->ball_vertices = (rings + 1) * around;
    r->ball_triangles = 2 * rings * around;
    r->triangles = CORNELL_TRIANGLES + BALLS * r->ball_triangles;
    r->scene = *cornell_box_make(&r->box);
    memset(r->box.materials[CORNELL_LAMP].emission, 0, sizeof r->box.materials[CORNELL_LAMP].emission);  /* rays to lamps would come on top, uncounted */
    memcpy(r->meshes, r->box.meshes, sizeof r->box.meshes);
    r->scene.meshes = r->meshes;
    r->positions = p = (float *)malloc(sizeof(float) * 3 * (size_t)(BALLS * r->ball_vertices + 1));
    r->indices = index = (unsigned *)malloc(sizeof(unsigned) * 3 * (size_t)(r->ball_triangles + 1));
    if (!p || !index) return fail("out of memory");
    for (j = 0; j < rings; j++)
        for (i = 0; i < around; i++) {
            unsigned a = (unsigned)(j * around + i), b = (unsigned)(j * around + (i + 1) % around), c = a + (unsigned)around, d = b + (unsigned)around;
            *index++ = a; *index++ = b; *index++ = d;
            *index++ = a; *index++ = d; *index++ = c;
        }
    for (ball = 0; ball < BALLS && rings; ball++) {
        sbl_mesh *mesh = &r->meshes[CORNELL_QUADS + ball];
        memset(mesh, 0, sizeof *mesh);
        mesh->positions.data = p;
        mesh->indices.data = r->indices;
        mesh->indices.type = SBL_UINT32;
        mesh->vertex_count = r->ball_vertices;
        mesh->index_count = 3 * r->ball_triangles;
        for (j = 0; j <= rings; j++)
            for (i = 0; i < around; i++) {
                double v = 3.14159265 * j / rings, u = 6.2831853 * i / around, radius = (30 + 5 * ball) * (1 + 0.1 * sin(9 * u) * sin(v) * sin(7 * v));
                *p++ = (float)(100 + 115 * (ball % 4) + radius * sin(v) * cos(u));
                *p++ = (float)(440 - 150 * (ball / 4) + radius * cos(v));
                *p++ = (float)(120 + 100 * ((ball * 5) % 4) + radius * sin(v) * sin(u));
            }
    }
    r->scene.mesh_count = CORNELL_QUADS + (rings ? BALLS : 0);
    return 1;
}

static void room_free(room *r) { free(r->positions); free(r->indices); }

/* A picture with a sensor at every pixel, in smooth light: every surface glows with its albedo. */
static int room_render(sbl_context *context, sbl_backend backend, int amount, int width, uint32_t seed, sbl_stats *stats, float *radiance) {
    sbl_picture_desc view = { 0 };
    cornell_box_view(&view, width, width * 9 / 16);
    view.mode = SBL_MODE_AMBIENT;
    view.epsilon = 1;
    view.tile = 1;
    view.filter_radius = -1;
    view.samples = 1;
    view.backend = backend;
    if (backend == SBL_BACKEND_TRACE) view.rays = amount;
    else view.sensor_size = amount;
    view.seed = seed;
    if (sbl_render(context, &view) != SBL_SUCCESS) return 0;
    *stats = sbl_query_stats(context);
    return !radiance || sbl_read_channel(context, SBL_CHANNEL_RADIANCE, radiance, 3 * (size_t)(width * (width * 9 / 16))) == SBL_SUCCESS;
}

static double room_error(const float *a, const float *truth, int count) {
    double squares = 0, sum = 0;
    int i;
    for (i = 0; i < count; i++) { squares += ((double)a[i] - truth[i]) * ((double)a[i] - truth[i]); sum += truth[i]; }
    return sqrt(squares / count) / (sum / count);
}

#ifdef EMBREE
/* Millions of rays a second on one thread: as many over the hemisphere of each point, one rtcIntersect1 each. */
static double embree_speed(const room *r, const points *p, int rays, double seconds) {
    RTCDevice device = rtcNewDevice(NULL);
    RTCScene scene = rtcNewScene(device);
    struct RTCIntersectContext how;
    long long traced = 0;
    double start;
    int m, i = 0, k;
    for (m = 0; m < r->scene.mesh_count; m++) {
        const sbl_mesh *mesh = &r->scene.meshes[m];
        RTCGeometry g = rtcNewGeometry(device, RTC_GEOMETRY_TYPE_TRIANGLE);
        unsigned *index = (unsigned *)rtcSetNewGeometryBuffer(g, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3, 12, (size_t)mesh->index_count / 3);
        memcpy(rtcSetNewGeometryBuffer(g, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3, 12, (size_t)mesh->vertex_count), mesh->positions.data, 12 * (size_t)mesh->vertex_count);
        for (k = 0; k < mesh->index_count; k++)
            index[k] = mesh->indices.type == SBL_UINT16 ? ((const unsigned short *)mesh->indices.data)[k] : ((const unsigned *)mesh->indices.data)[k];
        rtcCommitGeometry(g);
        rtcAttachGeometry(scene, g);
        rtcReleaseGeometry(g);
    }
    rtcCommitScene(scene);
    rtcInitIntersectContext(&how);
    start = now();
    while (now() - start < seconds) {
        vec3 n = p->normals[i], up = fabsf(n.z) < 0.9f ? vec3_make(0, 0, 1) : vec3_make(1, 0, 0), right = vec3_unit(vec3_cross(up, n));
        up = vec3_cross(n, right);
        for (k = 0; k < rays; k++) {
            struct RTCRayHit hit;
            float u = ((float)k + 0.5f) / (float)rays, a = 2.399963f * (float)(k + 7 * i), s = sqrtf(u);  /* along a spiral of the golden angle */
            vec3 d = vec3_mix(vec3_mix(vec3_mix(vec3_make(0, 0, 0), sqrtf(1 - u), n), s * cosf(a), right), s * sinf(a), up);
            memset(&hit, 0, sizeof hit);
            hit.ray.org_x = p->positions[i].x; hit.ray.org_y = p->positions[i].y; hit.ray.org_z = p->positions[i].z;
            hit.ray.dir_x = d.x; hit.ray.dir_y = d.y; hit.ray.dir_z = d.z;
            hit.ray.tnear = 0.01f;
            hit.ray.tfar = 1e30f;
            hit.ray.mask = ~0u;
            hit.hit.geomID = RTC_INVALID_GEOMETRY_ID;
            rtcIntersect1(scene, &how, &hit);
        }
        traced += rays;
        i = (i + 1) % p->count;
    }
    start = now() - start;
    rtcReleaseScene(scene);
    rtcReleaseDevice(device);
    return (double)traced / start * 1e-6;
}
#endif

static int bench_trace(sbl_context *context, int quick, int json, const char *renderer) {
    static const int sizes_of[ROOMS] = { CORNELL_TRIANGLES, 1000, 32768, 131072, 1000000 };
    static const int ways[4] = { 8, 4, 16, 32 };  /* texels across a rasterised sensor; in large rooms the first has to do */
    enum { WIDTH = 96, SMALL = 32 };
    float *truth = (float *)malloc(sizeof(float) * 3 * 2 * SMALL * SMALL), *found = truth + 3 * SMALL * SMALL;
    double thousand = 0;
    int i, k, n, ok = truth != NULL;
    if (json) printf("{\"renderer\": \"%s\", \"rooms\": [", renderer);
    else printf("\ntraced sensors on %s; medians. us: microseconds a sensor of 64 rays; growth: over the room of a thousand triangles\n\n"
                "triangles | Mrays/s 64    256 |     us  growth | build s/M   bytes/triangle | error 64 rays | raster of like error: size, error, trace/raster | Embree Mrays/s a thread\n",
                renderer);
    for (i = 0; ok && i < (quick ? 2 : ROOMS); i++) {
        room r = { 0 };
        sbl_stats stats = { 0 }, raster = { 0 };
        double speeds[2][RUNS_MOST], us, error, best = 1e30, best_error = 0, raster_us = 0, embree = 0;
        int runs = quick ? 1 : 5, width = quick ? SMALL : WIDTH, best_size = 0;
        points p = { 0 };
        double mean[3];
        ok = room_make(&r, sizes_of[i]) && sbl_set_scene(context, &r.scene) == SBL_SUCCESS;
        for (k = 0; k < 2 && ok; k++)
            for (n = -1; n < runs && ok; n++) {  /* once to warm up */
                ok = room_render(context, SBL_BACKEND_TRACE, k ? 256 : 64, width, 0, &stats, NULL);
                if (n >= 0) speeds[k][n] = (double)stats.rays / stats.seconds.gather * 1e-6;
            }
        us = ok ? 64 / median(speeds[0], runs) : 0;
        if (i == 1) thousand = us;
        /* the truth: as many rays as there may be, of another seed */
        width = r.triangles < 20000 ? SMALL : 16;
        ok = ok && room_render(context, SBL_BACKEND_TRACE, 4096, width, 99, &raster, truth) && room_render(context, SBL_BACKEND_TRACE, 64, width, 0, &raster, found);
        n = 3 * width * (width * 9 / 16);
        error = ok ? room_error(found, truth, n) : 0;
        for (k = 0; k < (r.triangles < 20000 ? 4 : 1) && ok; k++) {
            double e;
            ok = room_render(context, SBL_BACKEND_RASTER, ways[k], width, 0, &raster, found);
            e = room_error(found, truth, n);
            if (fabs(log(e / error)) > best) continue;
            best = fabs(log(e / error));
            best_error = e;
            best_size = ways[k];
            raster_us = raster.seconds.gather * 1e6 / (double)raster.sensors;
        }
#ifdef EMBREE
        ok = ok && room_render(context, SBL_BACKEND_TRACE, 64, SMALL, 0, &raster, NULL) && points_read(context, SMALL, SMALL * 9 / 16, 400, &p, mean);
        if (ok) embree = embree_speed(&r, &p, 64, quick ? 0.05 : 0.5);
        free(p.positions);
#else
        (void)p; (void)mean;
#endif
        if (ok && json)
            printf("%s\n  {\"triangles\": %d, \"mrays_64\": %.3f, \"mrays_256\": %.3f, \"us\": %.3f, \"build_seconds\": %.4f, \"bvh_bytes\": %.0f, \"error_64\": %.5f, \"raster_size\": %d, "
                   "\"raster_error\": %.5f, \"raster_us\": %.2f, \"embree_mrays\": %.3f}", i ? "," : "", r.triangles, median(speeds[0], runs), median(speeds[1], runs), us,
                   stats.bvh_seconds, (double)stats.bvh_bytes, error, best_size, best_error, raster_us, embree);
        else if (ok) {
            printf("%9d | %10.2f %6.2f | %6.1f %6.2fx | %9.2f %16.0f | %11.2f %% | ", r.triangles, median(speeds[0], runs), median(speeds[1], runs), us, thousand > 0 ? us / thousand : 1,
                   stats.bvh_seconds * 1e6 / r.triangles, (double)stats.bvh_bytes / r.triangles, 100 * error);
            printf("%26d %7.2f %% %9.1fx | ", best_size, 100 * best_error, raster_us / us);
            if (embree > 0) printf("%.2f\n", embree);
            else printf("built without\n");
        }
        room_free(&r);
    }
    if (json) printf("\n]}\n");
    free(truth);
    return ok;
}

#endif
