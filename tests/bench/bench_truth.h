/* Two programs for benches that measure R without bias at the surfaces that a camera shows: a path tracer, which
   follows light from these surfaces back to the lamps, and a light tracer, which follows it from the lamps. The light
   tracer has less noise, most of all if lamps are hidden. Embree 3 casts the rays if scripts/Makefile defines
   BENCH_EMBREE, otherwise reference.h does. They share no code with sbl.h. Include after sbl.h and bench_furnished.h.
       truth *t = truth_create(&scene, windows, window_count);
       truth_render(t, points, count, samples, halves);   two independent pictures, one per thread
       truth_spread(t, &view, paths, halves);             the same by the light tracer
       truth_destroy(t); */
#ifndef BENCH_TRUTH_H
#define BENCH_TRUTH_H

#include <pthread.h>
#ifdef BENCH_EMBREE
#include <embree3/rtcore.h>
#endif

#define TRUTH_OFFSET 2e-5  /* distance in metres between a surface and the start of a ray */

enum { TRUTH_BOUNCES = 200, TRUTH_NUMBERS = 7, TRUTH_GUIDE_PATHS = 32 };

/* An object that is sampled as a lamp: an emitting triangle, or a window (a parallelogram) through which the sky
   shines. */
typedef struct truth_lamp {
    v3 corner, u, v, normal;
    double area, chance, light[3];
    int triangle;  /* index of the triangle; -1: a window */
} truth_lamp;

typedef struct truth {
    ref_scene *scene;
    truth_lamp *lamps;
    int lamp_count, *lamp_of;  /* lamp_of: index of the lamp of each triangle, or -1 */
    int guided;                /* 1: the guide has been computed */
    double *guide;             /* approximate share of each triangle in all reflected light */
    double *guide_end;         /* cumulative sum of the shares, including each triangle */
#ifdef BENCH_EMBREE
    RTCDevice device;
    RTCScene embree;
#endif
} truth;

/* >>setup */

#ifdef BENCH_EMBREE
static void truth_embree(truth *t) {
    const int count = t->scene->triangle_count;
    RTCGeometry geometry;
    float *corners;
    unsigned *indices;
    int i;
    t->device = rtcNewDevice("threads=1");
    t->embree = rtcNewScene(t->device);
    rtcSetSceneFlags(t->embree, RTC_SCENE_FLAG_ROBUST);
    geometry = rtcNewGeometry(t->device, RTC_GEOMETRY_TYPE_TRIANGLE);
    corners = (float *)rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3, 12,
                                               3 * (size_t)count);
    indices = (unsigned *)rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3, 12,
                                                  (size_t)count);
    if (!corners || !indices) abort();
    for (i = 0; i < 3 * count; i++) {
        const v3 p = t->scene->triangles[i / 3].p[i % 3];
        corners[3 * i] = (float)p.x; corners[3 * i + 1] = (float)p.y; corners[3 * i + 2] = (float)p.z;
        indices[i] = (unsigned)i;
    }
    rtcCommitGeometry(geometry);
    rtcAttachGeometry(t->embree, geometry);
    rtcReleaseGeometry(geometry);
    rtcCommitScene(t->embree);
}
#endif

static void truth_add(truth *t, int triangle, v3 corner, v3 u, v3 v, const double light[3]) {
    truth_lamp *l = &t->lamps[t->lamp_count];
    const v3 cross = v3_cross(u, v);
    l->corner = corner; l->u = u; l->v = v;
    l->normal = v3_unit(cross);
    l->area = v3_length(cross) * (triangle < 0 ? 1 : 0.5);
    memcpy(l->light, light, sizeof l->light);
    l->triangle = triangle;
    l->chance = l->area * (light[0] + light[1] + light[2]);
    if (l->chance > 0) t->lamp_count++;
}

/* >>rays; their directions are unit vectors */

#ifdef BENCH_EMBREE
static void truth_ray(struct RTCRay *ray, v3 p, v3 d, double far) {
    memset(ray, 0, sizeof *ray);
    ray->org_x = (float)p.x; ray->org_y = (float)p.y; ray->org_z = (float)p.z;
    ray->dir_x = (float)d.x; ray->dir_y = (float)d.y; ray->dir_z = (float)d.z;
    ray->tfar = (float)far;
    ray->mask = ~0u;
}
static ref_hit truth_trace(const truth *t, v3 p, v3 d) {
    struct RTCIntersectContext context;
    struct RTCRayHit ray;
    ref_hit hit;
    rtcInitIntersectContext(&context);
    truth_ray(&ray.ray, p, d, HUGE_VAL);
    ray.hit.geomID = ray.hit.instID[0] = RTC_INVALID_GEOMETRY_ID;
    rtcIntersect1(t->embree, &context, &ray);
    hit.triangle = ray.hit.geomID == RTC_INVALID_GEOMETRY_ID ? -1 : (int)ray.hit.primID;
    hit.t = (double)ray.ray.tfar; hit.b1 = (double)ray.hit.u; hit.b2 = (double)ray.hit.v;
    return hit;
}
static int truth_blocked(const truth *t, v3 p, v3 d, double far) {
    struct RTCIntersectContext context;
    struct RTCRay ray;
    rtcInitIntersectContext(&context);
    truth_ray(&ray, p, d, far);
    rtcOccluded1(t->embree, &context, &ray);
    return ray.tfar < 0;
}
#else
static ref_hit truth_trace(const truth *t, v3 p, v3 d) { return ref_trace(t->scene, p, d, 0, HUGE_VAL, 0); }
static int truth_blocked(const truth *t, v3 p, v3 d, double far) {
    return ref_trace(t->scene, p, d, 0, far, 0).triangle >= 0;
}
#endif

/* >>light */

/* Returns the density over solid angle with which lamps are sampled in a direction from p. lamp: the lamp that the
   direction hits at `distance`; -1: none */
static double truth_density(const truth *t, int lamp, v3 d, double distance) {
    const truth_lamp *l = &t->lamps[lamp < 0 ? 0 : lamp];
    return lamp < 0 ? 0 : l->chance * distance * distance / (l->area * fabs(v3_dot(l->normal, d)) + 1e-300);
}

/* Returns the index of the window through which a ray leaves, or -1. */
static int truth_window(const truth *t, v3 p, v3 d, double *distance) {
    int i;
    for (i = 0; i < t->lamp_count && t->lamps[i].triangle < 0; i++) {
        const truth_lamp *l = &t->lamps[i];
        const double slope = v3_dot(l->normal, d);
        v3 at;
        *distance = v3_dot(v3_sub(l->corner, p), l->normal) / (slope == 0 ? 1e-300 : slope);
        at = v3_sub(v3_mad(p, d, *distance), l->corner);
        if (*distance > 0 && v3_dot(at, l->u) >= 0 && v3_dot(at, l->u) <= v3_dot(l->u, l->u) &&
            v3_dot(at, l->v) >= 0 && v3_dot(at, l->v) <= v3_dot(l->v, l->v)) return i;
    }
    return -1;
}

/* Returns the share of paths that continue to a triangle chosen by its reflected light; the others have
   cosine-distributed directions. After the first bounce the share is small, because weights of up to 1 / (1 - share)
   multiply. */
static double truth_share(const truth *t, int bounce) { return !t->guided ? 0 : bounce ? 0.25 : 0.5; }

/* Returns the density over solid angle with which a path continues from a surface to the first point in a direction.
   share: see truth_share; triangle: the triangle with the point, at `distance`; -1: there is no point */
static double truth_onward(const truth *t, double share, int triangle, v3 d, double cosine, double distance) {
    const ref_triangle *tri = &t->scene->triangles[triangle < 0 ? 0 : triangle];
    const double even = (1 - share) * cosine / REF_PI;
    double twice;
    if (triangle < 0 || !(share * t->guide[triangle] > 0)) return even;
    twice = fabs(v3_dot(v3_cross(v3_sub(tri->p[1], tri->p[0]), v3_sub(tri->p[2], tri->p[0])), d));
    return even + 2 * share * t->guide[triangle] * distance * distance / (twice + 1e-300);
}

/* Chooses the direction in which a path continues. u: the first two numbers give the direction, the others choose the
   point of a triangle. target: receives the triangle that the direction must hit first; -1: any hit is valid */
static v3 truth_direction(const truth *t, double share, v3 p, v3 n, const double u[4], int *target) {
    const v3 right = v3_unit(v3_cross(fabs(n.x) < 0.5 ? v3_of(1, 0, 0) : v3_of(0, 1, 0), n));
    const double radius = sqrt((u[0] - share) / (1 - share)), angle = 2 * REF_PI * u[1];
    int low = 0, high = t->scene->triangle_count - 1;
    const ref_triangle *tri;
    double b = u[2], c = u[3];
    *target = -1;
    if (u[0] >= share)
        return v3_add(v3_add(v3_scale(right, radius * cos(angle)), v3_scale(v3_cross(n, right), radius * sin(angle))),
                      v3_scale(n, sqrt(fmax(1 - radius * radius, 0))));
    while (low < high) {
        const int middle = (low + high) / 2;
        if (t->guide_end[middle] > u[0] / share) high = middle; else low = middle + 1;
    }
    tri = &t->scene->triangles[*target = low];
    if (b + c > 1) { b = 1 - b; c = 1 - c; }
    return v3_unit(v3_sub(v3_mad(v3_mad(tri->p[0], v3_sub(tri->p[1], tri->p[0]), b), v3_sub(tri->p[2], tri->p[0]), c),
                          p));
}

/* A path: its last surface; the factor (share) of the light there in R; guided: see truth_share. */
typedef struct truth_state { v3 p, n; double share[3], guided; } truth_state;

/* Adds to R the light of a point on a lamp, which three numbers choose. The light is weighted against paths that hit
   the lamp (balance heuristic, Veach 1997). */
static void truth_add_lamp(const truth *t, const truth_state *s, const double u[3], double sum[3]) {
    double left = u[0], a = u[1], b = u[2], distance, cosine, density;
    const truth_lamp *l = t->lamps, *last = l + t->lamp_count - 1;
    v3 d;
    int k;
    while (l < last && left > l->chance) left -= l++->chance;
    if (l->triangle >= 0 && a + b > 1) { a = 1 - a; b = 1 - b; }
    d = v3_sub(v3_mad(v3_mad(l->corner, l->u, a), l->v, b), s->p);
    distance = v3_length(d);
    d = v3_scale(d, 1 / distance);
    cosine = v3_dot(d, s->n);
    if (cosine <= 0) return;
    density = truth_density(t, (int)(l - t->lamps), d, distance) +
              truth_onward(t, s->guided, l->triangle, d, cosine, distance);
    if (truth_blocked(t, s->p, d, l->triangle < 0 ? HUGE_VAL : distance * (1 - 1e-5) - TRUTH_OFFSET)) return;
    for (k = 0; k < 3; k++) sum[k] += s->share[k] * l->light[k] * cosine / REF_PI / density;
}

/* Adds one sample of R at a point. number: the first numbers of the path, in [0, 1) */
static void truth_path(const truth *t, ref_point at, const double number[], uint64_t *random, double sum[3]) {
    double u[TRUTH_NUMBERS], distance = 0, survive, cosine, density;
    truth_state s;
    int bounce, k, target;
    s.share[0] = s.share[1] = s.share[2] = 1;
    for (bounce = 0; bounce < TRUTH_BOUNCES; bounce++) {
        v3 d;
        ref_hit hit;
        s.n = at.face;
        s.p = v3_mad(at.position, s.n, TRUTH_OFFSET);
        s.guided = truth_share(t, bounce);
        for (k = 0; k < TRUTH_NUMBERS; k++) u[k] = bounce ? ref_random(random) : number[k];
        if (t->lamp_count) truth_add_lamp(t, &s, u, sum);
        d = truth_direction(t, s.guided, s.p, s.n, u + 3, &target);
        cosine = v3_dot(d, s.n);
        if (cosine <= 0) return;
        hit = truth_trace(t, s.p, d);
        if (target >= 0 && hit.triangle != target) return;
        density = truth_onward(t, s.guided, hit.triangle, d, cosine, hit.t);
        if (hit.triangle < 0) {
            const int lamp = truth_window(t, s.p, d, &distance);
            density += truth_density(t, lamp, d, distance);
            for (k = 0; k < 3; k++) sum[k] += s.share[k] * (double)t->scene->desc.sky[k] * cosine / REF_PI / density;
            return;
        }
        at = ref_surface(t->scene, hit, d);
        for (k = 0, survive = 0; k < 3; k++) {
            sum[k] += s.share[k] * at.emission[k] * cosine / REF_PI /
                      (density + truth_density(t, t->lamp_of[hit.triangle], d, hit.t));
            s.share[k] *= at.albedo[k] * cosine / REF_PI / density;
            survive = at.albedo[k] > survive ? at.albedo[k] : survive;
        }
        if (survive > 0 && bounce < 1) survive = 1;
        if (ref_random(random) >= survive) return;
        for (k = 0; k < 3; k++) s.share[k] /= survive;
    }
}

/* >>creation */

/* Estimates how much light each triangle reflects on both sides. */
static void truth_make_guide(truth *t) {
    uint64_t random = 99;
    double sum = 0;
    int i, j, k;
    for (i = 0; i < t->scene->triangle_count; i++) {
        const ref_triangle *tri = &t->scene->triangles[i];
        ref_hit hit;
        hit.triangle = i;
        hit.t = 1; hit.b1 = hit.b2 = 1 / 3.0;
        for (j = 0; j < TRUTH_GUIDE_PATHS; j++) {
            double light[3] = { 0, 0, 0 }, number[TRUTH_NUMBERS];
            ref_point at = ref_surface(t->scene, hit, j & 1 ? tri->p[0] : v3_scale(tri->p[0], -1));
            const v3 edge = v3_cross(v3_sub(tri->p[1], tri->p[0]), v3_sub(tri->p[2], tri->p[0]));
            at.face = v3_scale(v3_unit(edge), j & 1 ? 1 : -1);
            for (k = 0; k < TRUTH_NUMBERS; k++) number[k] = ref_random(&random);
            truth_path(t, at, number, &random, light);
            for (k = 0; k < 3; k++) t->guide[i] += light[k] * at.albedo[k] * 0.5 * v3_length(edge);
        }
        sum += t->guide[i];
    }
    for (i = 0; i < t->scene->triangle_count && sum > 0; i++) {
        t->guide[i] /= sum;
        t->guide_end[i] = t->guide[i] + (i ? t->guide_end[i - 1] : 0);
    }
    t->guided = sum > 0;
}

static truth *truth_create(const sbl_scene_desc *scene, const furnished_window *windows, int window_count) {
    truth *t = (truth *)calloc(1, sizeof *t);
    double light[3], sum = 0;
    int i, k, count;
    if (!t) abort();
    t->scene = ref_create(scene);
    count = t->scene->triangle_count;
    t->lamps = (truth_lamp *)calloc((size_t)(count + window_count + 1), sizeof *t->lamps);
    t->lamp_of = (int *)calloc((size_t)count + 1, sizeof *t->lamp_of);
    t->guide = (double *)calloc((size_t)count + 1, sizeof *t->guide);
    t->guide_end = (double *)calloc((size_t)count + 1, sizeof *t->guide_end);
    if (!t->lamps || !t->lamp_of || !t->guide || !t->guide_end) abort();
    for (k = 0; k < 3; k++) light[k] = (double)scene->sky[k];
    for (i = 0; i < window_count; i++) truth_add(t, -1, windows[i].corner, windows[i].across, windows[i].up, light);
    for (i = 0; i < count; i++) {
        const ref_triangle *tri = &t->scene->triangles[i];
        const int before = t->lamp_count;
        for (k = 0; k < 3; k++) light[k] = (double)scene->materials[scene->meshes[tri->mesh].material].emission[k];
        truth_add(t, i, tri->p[0], v3_sub(tri->p[1], tri->p[0]), v3_sub(tri->p[2], tri->p[0]), light);
        t->lamp_of[i] = t->lamp_count > before ? before : -1;
    }
    for (i = 0; i < t->lamp_count; i++) sum += t->lamps[i].chance;
    for (i = 0; i < t->lamp_count; i++) t->lamps[i].chance /= sum;
#ifdef BENCH_EMBREE
    truth_embree(t);
#endif
    truth_make_guide(t);
    return t;
}

static void truth_destroy(truth *t) {
#ifdef BENCH_EMBREE
    rtcReleaseScene(t->embree);
    rtcReleaseDevice(t->device);
#endif
    ref_destroy(t->scene);
    free(t->lamps);
    free(t->lamp_of);
    free(t->guide);
    free(t->guide_end);
    free(t);
}

/* >>pictures */

typedef struct truth_job {
    const truth *t;
    const ref_point *points;
    int count, samples, half;
    float *rgb;
    pthread_t thread;
} truth_job;

/* The first numbers of paths come from a Kronecker sequence with a random start at each point, so that each half is
   unbiased. */
static void *truth_run(void *user) {
    static const double alpha[TRUTH_NUMBERS] = { 0.8812714616335696, 0.7766393890897682, 0.6844301295853427,
                                                 0.6031687406857282, 0.5315553977157913, 0.4141935,
                                                 0.7320508075688772 };
    const truth_job *job = (const truth_job *)user;
    int i, j, k;
    for (i = 0; i < job->count; i++) {
        uint64_t random = 2 * (uint64_t)i + (uint64_t)job->half + ((uint64_t)77 << 40);
        double start[TRUTH_NUMBERS], number[TRUTH_NUMBERS], sum[3] = { 0, 0, 0 };
        random = (uint64_t)(ref_random(&random) * 9e15);
        for (k = 0; k < TRUTH_NUMBERS; k++) start[k] = ref_random(&random);
        for (j = 0; j < job->samples && job->points[i].hit; j++) {
            for (k = 0; k < TRUTH_NUMBERS; k++) number[k] = fmod(start[k] + (j + 1) * alpha[k], 1);
            truth_path(job->t, job->points[i], number, &random, sum);
        }
        for (k = 0; k < 3; k++) job->rgb[3 * i + k] = (float)(sum[k] / job->samples);
    }
    return NULL;
}

/* Computes two independent pictures of R at the points, with `samples` paths each, on two threads. */
static void truth_render(const truth *t, const ref_point *points, int count, int samples, float *halves[2]) {
    truth_job jobs[2];
    int i;
    for (i = 0; i < 2; i++) {
        memset(&jobs[i], 0, sizeof jobs[i]);
        jobs[i].t = t;
        jobs[i].points = points;
        jobs[i].count = count;
        jobs[i].samples = samples;
        jobs[i].half = i;
        jobs[i].rgb = halves[i];
        if (pthread_create(&jobs[i].thread, NULL, truth_run, &jobs[i]) != 0) abort();
    }
    for (i = 0; i < 2; i++) pthread_join(jobs[i].thread, NULL);
}

/* >>pictures by the light tracer */

/* The camera of a picture: its position, and the factors of view_to_clip. */
typedef struct truth_camera { const sbl_picture_desc *view; v3 eye; double scale[2], shift[2]; } truth_camera;

typedef struct truth_spread_job {
    const truth *t;
    const truth_camera *camera;
    double paths, *sums;   /* sums: 3 per pixel */
    uint64_t random;
    pthread_t thread;
} truth_spread_job;

static truth_camera truth_camera_of(const sbl_picture_desc *view) {
    const float *m = view->world_to_view, *c = view->view_to_clip;
    truth_camera camera;
    double eye[3];
    int k;
    for (k = 0; k < 3; k++)  /* the inverse of a rotation is its transpose */
        eye[k] = -((double)m[4 * k] * (double)m[12] + (double)m[4 * k + 1] * (double)m[13] +
                   (double)m[4 * k + 2] * (double)m[14]);
    camera.view = view;
    camera.eye = v3_of(eye[0], eye[1], eye[2]);
    for (k = 0; k < 2; k++) {
        camera.scale[k] = (double)c[5 * k];
        camera.shift[k] = (double)c[8 + k];
    }
    return camera;
}

/* Chooses a point of a lamp and the side on which a path begins. power: receives what the lamps radiate, divided by the
   probability of this choice. Windows radiate only to the side of the camera. */
static v3 truth_emit(const truth *t, v3 eye, uint64_t *random, v3 *normal, double power[3]) {
    double left = ref_random(random), a = ref_random(random), b = ref_random(random);
    const truth_lamp *l = t->lamps, *last = l + t->lamp_count - 1;
    v3 p;
    int k, turned;
    while (l < last && left > l->chance) left -= l++->chance;
    if (l->triangle >= 0 && a + b > 1) { a = 1 - a; b = 1 - b; }
    p = v3_mad(v3_mad(l->corner, l->u, a), l->v, b);
    turned = l->triangle >= 0 ? ref_random(random) < 0.5 : v3_dot(l->normal, v3_sub(eye, p)) < 0;
    *normal = v3_scale(l->normal, turned ? -1 : 1);
    for (k = 0; k < 3; k++) power[k] = l->light[k] * l->area * REF_PI * (l->triangle >= 0 ? 2 : 1) / l->chance;
    return p;
}

/* Adds the light that arrives at the point p of a surface to the pixel that shows this point, if the camera sees it. n:
   normal on the side where the light arrives. power: the light that arrives. R of the pixel grows by power / pi,
   divided by the area that the pixel shows. */
static void truth_show(const truth *t, const truth_camera *c, v3 p, v3 n, const double power[3], double *sums) {
    const float *m = c->view->world_to_view;
    const int size[2] = { c->view->width, c->view->height };
    v3 to = v3_sub(c->eye, p);
    double distance = v3_length(to), at[3], pixels;
    int k, pixel[2];
    to = v3_scale(to, 1 / distance);
    if (v3_dot(to, n) <= 0) return;
    for (k = 0; k < 3; k++)
        at[k] = (double)m[k] * p.x + (double)m[4 + k] * p.y + (double)m[8 + k] * p.z + (double)m[12 + k];
    if (at[2] >= 0) return;
    for (k = 0; k < 2; k++) {
        const double clip = (c->scale[k] * at[k] + c->shift[k] * at[2]) / -at[2];
        if (fabs(clip) >= 1) return;
        pixel[k] = (int)((k ? 1 - clip : 1 + clip) / 2 * size[k]);
        if (pixel[k] >= size[k]) return;
    }
    if (truth_blocked(t, v3_mad(p, n, TRUTH_OFFSET), to, distance - TRUTH_OFFSET)) return;
    pixels = c->scale[0] * c->scale[1] * size[0] * size[1] / 4 * v3_dot(to, n) * distance / pow(-at[2], 3);
    for (k = 0; k < 3; k++) sums[3 * (pixel[1] * size[0] + pixel[0]) + k] += power[k] / REF_PI * pixels;
}

/* Follows a path from a lamp until it leaves the scene or is absorbed. */
static void truth_follow(const truth *t, const truth_camera *c, uint64_t *random, double *sums) {
    double power[3], survive, u[4] = { 0, 0, 0, 0 };
    v3 n, p = truth_emit(t, c->eye, random, &n, power);
    int bounce, k, target;
    for (bounce = 0; bounce < TRUTH_BOUNCES; bounce++) {
        ref_point at;
        ref_hit hit;
        v3 d;
        for (k = 0; k < 2; k++) u[k] = ref_random(random);
        d = truth_direction(t, 0, p, n, u, &target);
        hit = truth_trace(t, v3_mad(p, n, TRUTH_OFFSET), d);
        if (hit.triangle < 0) return;
        at = ref_surface(t->scene, hit, d);
        p = at.position;
        n = at.face;
        truth_show(t, c, p, n, power, sums);
        for (k = 0, survive = 0; k < 3; k++) survive = fmax(survive, at.albedo[k]);
        if (ref_random(random) >= survive) return;
        for (k = 0; k < 3; k++) power[k] *= at.albedo[k] / survive;
    }
}

static void *truth_spread_run(void *user) {
    truth_spread_job *job = (truth_spread_job *)user;
    double i;
    for (i = 0; i < job->paths; i++) truth_follow(job->t, job->camera, &job->random, job->sums);
    return NULL;
}

/* Computes two independent pictures of R with `paths` paths each, on two threads. A pixel is the mean over the area
   that it shows, which is R at its centre only if it shows a single plane. */
static void truth_spread(const truth *t, const sbl_picture_desc *view, double paths, float *halves[2]) {
    const truth_camera camera = truth_camera_of(view);
    const int floats = 3 * view->width * view->height;
    truth_spread_job jobs[2];
    int i, k;
    for (i = 0; i < 2; i++) {
        jobs[i].t = t;
        jobs[i].camera = &camera;
        jobs[i].paths = t->lamp_count ? paths : 0;
        jobs[i].random = (uint64_t)(i + 1) << 50;
        jobs[i].sums = (double *)calloc((size_t)floats, sizeof(double));
        if (!jobs[i].sums || pthread_create(&jobs[i].thread, NULL, truth_spread_run, &jobs[i]) != 0) abort();
    }
    for (i = 0; i < 2; i++) {
        pthread_join(jobs[i].thread, NULL);
        for (k = 0; k < floats; k++) halves[i][k] = (float)(jobs[i].sums[k] / paths);
        free(jobs[i].sums);
    }
}

#endif
