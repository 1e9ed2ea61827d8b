/* Embree for the bench: the same triangles, and rays from the same points, cosine-distributed about the same normals,
   with one rtcIntersect1 per ray, on all cores. Textures and cut-outs are ignored. Without BENCH_EMBREE, which
   scripts/Makefile defines if <embree3/rtcore.h> exists, embree_make returns NULL. Include after sbl.h. */
#ifndef BENCH_EMBREE_H
#define BENCH_EMBREE_H

#ifndef BENCH_EMBREE
typedef struct embree { int threads; double build_seconds; } embree;
static inline embree *embree_make(const sbl_scene_desc *scene, float nearest) {
    (void)scene;
    (void)nearest;
    return NULL;
}
static inline void embree_free(embree *e) { (void)e; }
static inline double embree_gather(embree *e, const float *positions, const float *normals, int count, int rays,
                                   double mean[3]) {
    (void)e; (void)positions; (void)normals; (void)count; (void)rays; (void)mean;
    return 0;
}
#else

#include <embree3/rtcore.h>
#include <math.h>
#include <pthread.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

enum { EMBREE_THREADS_MOST = 64 };

typedef struct embree {
    RTCDevice device;
    RTCScene scene;
    float *light;          /* albedo of each mesh, three floats; in the bench, each surface radiates its albedo */
    float nearest;         /* nearer hits are on the surface that the ray starts from */
    int threads;
    double build_seconds;  /* seconds on one thread */
} embree;

typedef struct embree_job {
    const embree *e;
    const float *positions, *normals;
    int count, rays;
    double light[3];
    pthread_t thread;
} embree_job;

static double embree_now(void) {
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static void embree_free(embree *e) {
    if (!e) return;
    if (e->scene) rtcReleaseScene(e->scene);
    if (e->device) rtcReleaseDevice(e->device);
    free(e->light);
    free(e);
}

/* Adds a mesh with float positions and indices of any type, as in the scenes of the bench. */
static int embree_mesh(embree *e, const sbl_mesh *mesh, unsigned id) {
    static const float identity[16] = { 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1 };
    const float *m = mesh->transform[15] != 0 ? mesh->transform : identity;
    size_t stride = mesh->positions.stride ? mesh->positions.stride : 12, count = (size_t)mesh->index_count, i;
    const char *data = (const char *)mesh->positions.data + mesh->positions.offset;
    const char *indices = (const char *)mesh->indices.data + mesh->indices.offset;
    RTCGeometry geometry;
    float *vertices;
    unsigned *corners;
    int k;
    if (mesh->positions.type != SBL_FLOAT32 || !mesh->positions.data || !mesh->indices.data || mesh->indices.stride)
        return 0;
    geometry = rtcNewGeometry(e->device, RTC_GEOMETRY_TYPE_TRIANGLE);
    vertices = (float *)rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3, 12,
                                                (size_t)mesh->vertex_count);
    corners = (unsigned *)rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3, 12, count / 3);
    for (i = 0; vertices && i < (size_t)mesh->vertex_count; i++) {
        float p[3];
        memcpy(p, data + i * stride, sizeof p);
        for (k = 0; k < 3; k++)
            vertices[3 * i + (size_t)k] = m[k] * p[0] + m[4 + k] * p[1] + m[8 + k] * p[2] + m[12 + k];
    }
    for (i = 0; corners && i < count; i++)
        corners[i] = mesh->indices.type == SBL_UINT32 ? ((const uint32_t *)(const void *)indices)[i] :
                     mesh->indices.type == SBL_UINT16 ? ((const uint16_t *)(const void *)indices)[i]
                         : ((const uint8_t *)indices)[i];
    rtcCommitGeometry(geometry);
    rtcAttachGeometryByID(e->scene, geometry, id);
    rtcReleaseGeometry(geometry);
    return vertices && corners;
}

/* Builds the scene. Returns NULL if Embree cannot represent it. */
static embree *embree_make(const sbl_scene_desc *scene, float nearest) {
    embree *e = (embree *)calloc(1, sizeof *e);
    int i, ok;
    double start;
    if (!e) return NULL;
    e->nearest = nearest;
    e->threads = (int)sysconf(_SC_NPROCESSORS_ONLN);
    if (e->threads < 1) e->threads = 1;
    if (e->threads > EMBREE_THREADS_MOST) e->threads = EMBREE_THREADS_MOST;
    e->light = (float *)malloc((size_t)(scene->mesh_count + 1) * 3 * sizeof(float));
    e->device = rtcNewDevice("threads=1");
    if (e->device) e->scene = rtcNewScene(e->device);
    ok = e->light && e->scene;
    for (i = 0; ok && i < scene->mesh_count; i++) {
        memcpy(e->light + 3 * i, scene->materials[scene->meshes[i].material].albedo, 3 * sizeof(float));
        ok = scene->meshes[i].index_count == 0 || embree_mesh(e, &scene->meshes[i], (unsigned)i);
    }
    start = embree_now();
    if (ok) rtcCommitScene(e->scene);
    e->build_seconds = embree_now() - start;
    if (ok && rtcGetDeviceError(e->device) == RTC_ERROR_NONE) return e;
    embree_free(e);
    return NULL;
}

static uint32_t embree_hash(uint32_t x) {
    x = (x ^ x >> 16) * 0x7feb352du;
    x = (x ^ x >> 15) * 0x846ca68bu;
    return x ^ x >> 16;
}

/* Returns the bits of x at even positions, packed. */
static uint32_t embree_even_bits(uint32_t x) {
    uint32_t bit, out = 0;
    for (bit = 0; bit < 16; bit++) out |= (x >> 2 * bit & 1) << bit;
    return out;
}

/* Casts rays for one thread. The number of rays per point is a power of 4. Each ray passes through a random point of
   its cell of a grid on the unit square that maps to the disc. The cells follow a Morton curve, so that consecutive
   rays are neighbours. */
static void *embree_run(void *user) {
    embree_job *job = (embree_job *)user;
    const float cell = 1 / sqrtf((float)job->rays);
    struct RTCIntersectContext context;
    uint32_t random = 0;
    int i, j, k;
    rtcInitIntersectContext(&context);
    for (i = 0; i < job->count; i++) {
        const float *n = job->normals + 3 * i, *p = job->positions + 3 * i;
        float s = n[2] < 0 ? -1.0f : 1.0f, f = -1 / (s + n[2]), g = n[0] * n[1] * f, light[3] = { 0, 0, 0 };
        float right[3], up[3];
        right[0] = 1 + s * n[0] * n[0] * f; right[1] = s * g;                   right[2] = -s * n[0];
        up[0] = g;                          up[1] = s + n[1] * n[1] * f;        up[2] = -n[1];
        random = embree_hash(random + (uint32_t)i);
        for (j = 0; j < job->rays; j++) {
            uint32_t jitter = embree_hash(random++);
            float u = ((float)embree_even_bits((uint32_t)j) + (float)(jitter >> 16) / 65536) * cell;
            float v = ((float)embree_even_bits((uint32_t)j >> 1) + (float)(jitter & 0xffff) / 65536) * cell;
            float x = sqrtf(u) * cosf(6.2831853f * v), y = sqrtf(u) * sinf(6.2831853f * v), z = sqrtf(1 - u);
            struct RTCRayHit ray;
            memset(&ray, 0, sizeof ray);
            ray.ray.org_x = p[0]; ray.ray.org_y = p[1]; ray.ray.org_z = p[2];
            ray.ray.dir_x = x * right[0] + y * up[0] + z * n[0];
            ray.ray.dir_y = x * right[1] + y * up[1] + z * n[1];
            ray.ray.dir_z = x * right[2] + y * up[2] + z * n[2];
            ray.ray.tnear = job->e->nearest;
            ray.ray.tfar = INFINITY;
            ray.ray.mask = ~0u;
            ray.hit.geomID = ray.hit.instID[0] = RTC_INVALID_GEOMETRY_ID;
            rtcIntersect1(job->e->scene, &context, &ray);
            if (ray.hit.geomID == RTC_INVALID_GEOMETRY_ID) continue;
            for (k = 0; k < 3; k++) light[k] += job->e->light[3 * ray.hit.geomID + (unsigned)k];
        }
        for (k = 0; k < 3; k++) job->light[k] += (double)light[k] / job->rays;
    }
    return NULL;
}

/* Casts rays from the points. Returns the seconds, or 0 if a thread cannot be started. mean: receives the mean light at
   the points */
static double embree_gather(embree *e, const float *positions, const float *normals, int count, int rays,
                            double mean[3]) {
    embree_job jobs[EMBREE_THREADS_MOST];
    double start = embree_now();
    int i, k, started;
    for (i = 0; i < e->threads; i++) {
        embree_job *job = &jobs[i];
        int first = (int)((long long)count * i / e->threads), last = (int)((long long)count * (i + 1) / e->threads);
        memset(job, 0, sizeof *job);
        job->e = e;
        job->positions = positions + 3 * first;
        job->normals = normals + 3 * first;
        job->count = last - first;
        job->rays = rays;
        if (pthread_create(&job->thread, NULL, embree_run, job) != 0) break;
    }
    started = i;
    for (k = 0; k < 3; k++) mean[k] = 0;
    for (i = 0; i < started; i++) {
        pthread_join(jobs[i].thread, NULL);
        for (k = 0; k < 3; k++) mean[k] += jobs[i].light[k] / count;
    }
    return started == e->threads ? embree_now() - start : 0;
}

#endif
#endif
