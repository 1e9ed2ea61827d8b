/* A path tracer for benches: the radiance that reaches the camera from rooms with metal, gloss, mirrors and panes,
   unbiased. The material model is glTF's, as sbl.h describes it under ON REFLECTIONS, without textures. It shares no
   code with sbl.h. Include after bench_truth.h and bench_gloss_rooms.h.
       gloss_truth_render(&room, samples, halves);   two independent pictures, one per thread
   Lamps are sampled directly, and by way of the flat mirrors that the tracer finds in the room; both are weighted
   against paths that meet the lamp by chance (balance heuristic, Veach 1997). */
#ifndef BENCH_GLOSS_TRUTH_H
#define BENCH_GLOSS_TRUTH_H

enum { GLOSS_NUMBERS = 12, GLOSS_PASSES = 64, GLOSS_MIRRORS = 8 };
#define GLOSS_TIE 0.005  /* a point this close to an edge, in pixels, lies on it */

/* A surface as light meets it. n is the shading normal, face the geometric one, both on the side of the viewer v. */
typedef struct gloss_surface {
    ref_point at;
    v3 n, face, v;
    double base[3], metallic, alpha, f0, opacity, transmission, clear[3];  /* alpha 0: a mirror; f0 < 0: matte */
    double through, diffuse;  /* chances that a path passes through, and that it is reflected diffusely */
} gloss_surface;

/* A direction that a path has chosen at a surface, stored until it is known what the path meets next. is_set: 1: there
   is such a direction; f: BRDF times cosine; lobe: density of the glossy lobe times the chance that this lobe is
   chosen; diffuse, guided, cosine: for truth_onward; target: see truth_direction */
typedef struct gloss_turn { int is_set, target; double f[3], lobe, diffuse, guided, cosine; } gloss_turn;

/* A path. number: GLOSS_NUMBERS numbers of a sequence, which the first choices use; numbers: how many are used. The
   following fields count from the last direction that was neither mirrored nor passed on by a pane. density: of that
   direction; -1: there was none; way: length since then; mirrors: how many perfect mirrors have reflected the path
   since then; mirror: index of the last of these in gloss_tracer, -1: not listed there */
typedef struct gloss_path {
    const double *number;
    int numbers;
    uint64_t *random;
    double share[3], density, way, guided;
    int mirrors, mirror;
    gloss_turn turn;
} gloss_path;

static double gloss_number(gloss_path *p) {
    return p->numbers < GLOSS_NUMBERS ? p->number[p->numbers++] : ref_random(p->random);
}

/* A tracer and the flat mirrors of its scene. Each mirror is a rectangle and a mesh of its own. triangle: index of the
   first of its two triangles in the scene */
typedef struct gloss_mirror { v3 corner, across, up; int mesh, triangle; } gloss_mirror;
typedef struct gloss_tracer { truth *t; gloss_mirror mirrors[GLOSS_MIRRORS]; int mirror_count; } gloss_tracer;

/* >>materials */

static double gloss_schlick(double f0, double cosine) {
    const double x = 1 - fmin(fabs(cosine), 1);
    return f0 + (1 - f0) * x * x * x * x * x;
}

static gloss_surface gloss_surface_at(const truth *t, ref_hit hit, v3 d) {
    gloss_surface s;
    const ref_triangle *tri = &t->scene->triangles[hit.triangle];
    const sbl_mesh *mesh = &t->scene->desc.meshes[tri->mesh];
    const sbl_material *m = &t->scene->desc.materials[mesh->material];
    const double ior = m->ior > 0 ? (double)m->ior : 1.5;
    double cosine, mirrored = 0, passed = 0, scattered = 0, sum;
    int k;
    s.at = ref_surface(t->scene, hit, d);
    s.v = v3_scale(d, -1);
    s.face = s.at.face;
    s.n = s.at.normal;
    if (v3_dot(s.n, s.v) < 1e-3) s.n = v3_unit(v3_mad(s.n, s.v, 1e-3 - v3_dot(s.n, s.v)));
    s.metallic = (double)m->metallic;
    s.alpha = m->roughness < 0.05f ? 0 : (double)m->roughness * (double)m->roughness;
    s.f0 = m->ior > 0 || m->metallic > 0 ? (ior - 1) * (ior - 1) / ((ior + 1) * (ior + 1)) : -1;
    s.opacity = 1;
    if (m->flags & SBL_MATERIAL_BLEND)
        s.opacity = (1 - hit.b1 - hit.b2) * tri->color[0][3] + hit.b1 * tri->color[1][3] + hit.b2 * tri->color[2][3];
    s.transmission = (double)m->transmission;
    cosine = fmax(v3_dot(s.n, s.v), 1e-3);
    for (k = 0; k < 3; k++) {
        const double fd = s.f0 < 0 ? 0 : gloss_schlick(s.f0, cosine);
        s.base[k] = s.at.albedo[k];
        s.clear[k] = 1 - s.opacity + s.opacity * (1 - s.metallic) * s.transmission * s.base[k] * (1 - fd);
        passed += s.clear[k];
        scattered += s.opacity * (1 - s.metallic) * (1 - s.transmission) * s.base[k] * (1 - fd);
        if (s.f0 >= 0) mirrored += s.opacity * ((1 - s.metallic) * fd + s.metallic * gloss_schlick(s.base[k], cosine));
    }
    sum = passed + scattered + mirrored + 1e-300;
    s.through = passed / sum;
    s.diffuse = scattered / sum;
    return s;
}

/* Sets `out` to BRDF times cosine for light from l, without what a perfect mirror reflects. Returns the density with
   which gloss_lobe_direction draws l, times the chance that the glossy lobe is chosen. */
static double gloss_reflects(const gloss_surface *s, v3 l, double out[3]) {
    const double nl = v3_dot(s->n, l), nv = fmax(v3_dot(s->n, s->v), 1e-3), a2 = s->alpha * s->alpha;
    const v3 h = v3_unit(v3_add(s->v, l));
    const double nh = v3_dot(s->n, h), vh = v3_dot(s->v, h);
    double lobe = 0, density = 0;
    int k;
    out[0] = out[1] = out[2] = 0;
    if (nl <= 0 || v3_dot(s->face, l) <= 0) return 0;
    if (s->f0 >= 0 && s->alpha > 0) {
        const double x = 1 + (a2 - 1) * nh * nh, d = a2 / (REF_PI * x * x);
        const double root_v = sqrt(a2 + (1 - a2) * nv * nv);
        lobe = 0.5 * d / (nl * root_v + nv * sqrt(a2 + (1 - a2) * nl * nl));
        density = (1 - s->through - s->diffuse) * d / (2 * (nv + root_v));
    }
    for (k = 0; k < 3; k++) {
        const double fd = s->f0 < 0 ? 0 : gloss_schlick(s->f0, vh), fm = gloss_schlick(s->base[k], vh);
        out[k] = s->opacity * nl * ((1 - s->metallic) * (1 - s->transmission) * (1 - fd) * s->base[k] / REF_PI +
                                    ((1 - s->metallic) * fd + s->metallic * fm) * lobe);
    }
    return density;
}

/* Returns what a perfect mirror reflects of one colour. */
static double gloss_mirrors(const gloss_surface *s, int k) {
    const double cosine = v3_dot(s->n, s->v);
    return s->opacity * ((1 - s->metallic) * gloss_schlick(s->f0, cosine) +
                         s->metallic * gloss_schlick(s->base[k], cosine));
}

static void gloss_axes(v3 n, v3 *x, v3 *y) {
    *x = v3_unit(v3_cross(fabs(n.x) < 0.5 ? v3_of(1, 0, 0) : v3_of(0, 1, 0), n));
    *y = v3_cross(n, *x);
}

static v3 gloss_mirrored(v3 v, v3 n) { return v3_mad(v3_scale(v, -1), n, 2 * v3_dot(v, n)); }

/* Draws a normal that the viewer sees (Heitz 2018, "Sampling the GGX Distribution of Visible Normals"), and returns the
   direction that it mirrors the view to. */
static v3 gloss_lobe_direction(const gloss_surface *s, double u, double w) {
    const double r = sqrt(u), phi = 2 * REF_PI * w, t1 = r * cos(phi);
    double t2 = r * sin(phi), half;
    v3 x, y, view, a, b, h;
    gloss_axes(s->n, &x, &y);
    view = v3_unit(v3_of(s->alpha * v3_dot(s->v, x), s->alpha * v3_dot(s->v, y), v3_dot(s->v, s->n)));
    a = view.x * view.x + view.y * view.y > 1e-12 ? v3_unit(v3_of(-view.y, view.x, 0)) : v3_of(1, 0, 0);
    b = v3_cross(view, a);
    half = 0.5 * (1 + view.z);
    t2 = (1 - half) * sqrt(fmax(1 - t1 * t1, 0)) + half * t2;
    h = v3_add(v3_add(v3_scale(a, t1), v3_scale(b, t2)), v3_scale(view, sqrt(fmax(1 - t1 * t1 - t2 * t2, 0))));
    h = v3_unit(v3_of(s->alpha * h.x, s->alpha * h.y, fmax(h.z, 0)));
    return gloss_mirrored(s->v, v3_add(v3_add(v3_scale(x, h.x), v3_scale(y, h.y)), v3_scale(s->n, h.z)));
}

/* >>lamps */

/* Follows a line from p for a length, and multiplies light by what the surfaces on it let pass. Returns 0 if nothing
   passes. first: becomes the first hit of the line if that is nearer than `first` is */
static int gloss_passes(const truth *t, v3 p, v3 d, double length, double light[3], ref_hit *first) {
    int i, k;
    for (i = 0; i < GLOSS_PASSES; i++) {
        const ref_hit hit = truth_trace(t, p, d);
        gloss_surface s;
        if (i == 0 && hit.triangle >= 0 && hit.t < first->t) *first = hit;
        if (hit.triangle < 0 || hit.t >= length) return 1;
        s = gloss_surface_at(t, hit, d);
        if (!(s.through > 0)) return 0;
        for (k = 0; k < 3; k++) light[k] *= s.clear[k];
        p = v3_mad(v3_mad(p, d, hit.t), s.face, -TRUTH_OFFSET);
        length -= hit.t;
    }
    return 0;
}

/* A way from a surface to a lamp: one straight part, or two parts that meet at a flat mirror. from: where each part
   begins; d: its unit direction; whole: sum of the lengths; first: the first hit on the way, see gloss_way_is_free */
typedef struct gloss_way { v3 from[2], d[2]; double length[2], whole; int parts; ref_hit first; } gloss_way;

/* Finds the point m of a flat mirror where p sees q. Returns 0 if there is none. off: becomes that point, moved a
   little off the mirror towards p */
static int gloss_mirror_point(const gloss_mirror *g, v3 p, v3 q, v3 *m, v3 *off) {
    const v3 n = v3_unit(v3_cross(g->across, g->up));
    const double hp = v3_dot(v3_sub(p, g->corner), n), hq = v3_dot(v3_sub(q, g->corner), n);
    double u, v;
    if (!(hp * hq > 0)) return 0;
    *m = v3_add(v3_scale(v3_mad(p, n, -hp), hq / (hp + hq)), v3_scale(v3_mad(q, n, -hq), hp / (hp + hq)));
    *off = v3_mad(*m, n, hp > 0 ? TRUTH_OFFSET : -TRUTH_OFFSET);
    u = v3_dot(v3_sub(*m, g->corner), g->across) / v3_dot(g->across, g->across);
    v = v3_dot(v3_sub(*m, g->corner), g->up) / v3_dot(g->up, g->up);
    return u >= 0 && u <= 1 && v >= 0 && v <= 1;
}

/* Finds the way by which ends[0] sees ends[1], directly if mirror is NULL. Multiplies light by what the mirror
   reflects. Returns 0 if the mirror does not show ends[1]. Whether a surface blocks the way is left open, see
   gloss_way_is_free. */
static int gloss_find_way(const truth *t, const gloss_mirror *mirror, const v3 ends[2], gloss_way *w,
                          double light[3]) {
    v3 m = ends[1];
    gloss_surface s;
    ref_hit hit;
    int i, k;
    w->parts = mirror ? 2 : 1;
    w->from[0] = ends[0];
    if (mirror && !gloss_mirror_point(mirror, ends[0], ends[1], &m, &w->from[1])) return 0;
    w->d[0] = v3_sub(m, ends[0]);
    w->d[1] = v3_sub(ends[1], m);
    for (i = 0, w->whole = 0; i < w->parts; i++) {
        w->length[i] = v3_length(w->d[i]);
        w->d[i] = v3_scale(w->d[i], 1 / w->length[i]);
        w->whole += w->length[i];
    }
    if (!mirror) return 1;
    hit.triangle = mirror->triangle;
    hit.t = w->length[0]; hit.b1 = hit.b2 = 1 / 3.0;
    s = gloss_surface_at(t, hit, w->d[0]);
    for (k = 0; k < 3; k++) light[k] *= gloss_mirrors(&s, k);
    return 1;
}

/* Multiplies light by what the surfaces on the way let pass. Returns 0 if nothing arrives. Sets w->first to the first
   hit on the way, which is the lamp if a direct way meets nothing else. triangle: of the lamp; -1: it has none */
static int gloss_way_is_free(const truth *t, gloss_way *w, int triangle, double light[3]) {
    ref_hit unused;
    int i;
    w->first.triangle = triangle;
    w->first.t = w->parts == 1 ? w->length[0] * (1 - 1e-5) - 2 * TRUTH_OFFSET : HUGE_VAL;
    for (i = 0; i < w->parts; i++)
        if (!gloss_passes(t, w->from[i], w->d[i], w->length[i] * (1 - 1e-5) - 2 * TRUTH_OFFSET, light,
                          i ? &unused : &w->first)) return 0;
    if (w->first.triangle == triangle && w->parts == 1) w->first.t = w->length[0];
    return 1;
}

/* Adds to sum the reflected light of a random point of a lamp, which is random, too. mirror: index of the mirror by way
   of which the light arrives; -1: it arrives directly */
static void gloss_add_lamp(const gloss_tracer *g, const gloss_surface *s, gloss_path *path, int mirror,
                           double sum[3]) {
    const truth *t = g->t;
    const truth_lamp *l = t->lamps, *last = l + t->lamp_count - 1;
    double left = gloss_number(path), a = gloss_number(path), b = gloss_number(path), f[3], light[3], density;
    gloss_way w;
    v3 ends[2];
    int k;
    while (l < last && left > l->chance) left -= l++->chance;
    if (l->triangle >= 0 && a + b > 1) { a = 1 - a; b = 1 - b; }
    memcpy(light, l->light, sizeof light);
    ends[0] = v3_mad(s->at.position, s->face, TRUTH_OFFSET);
    ends[1] = v3_mad(v3_mad(l->corner, l->u, a), l->v, b);
    if (!gloss_find_way(t, mirror < 0 ? NULL : &g->mirrors[mirror], ends, &w, light)) return;
    density = gloss_reflects(s, w.d[0], f);
    density += truth_density(t, (int)(l - t->lamps), w.d[w.parts - 1], w.whole) / (mirror < 0 ? 1 : g->mirror_count);
    if (!(f[0] + f[1] + f[2] > 0) || !gloss_way_is_free(t, &w, l->triangle, light)) return;
    density += s->diffuse * truth_onward(t, path->guided, w.first.triangle, w.d[0], v3_dot(s->n, w.d[0]), w.first.t);
    for (k = 0; k < 3; k++) sum[k] += path->share[k] * f[k] * light[k] / density;
}

/* Adds to sum the reflected light of a point or spot light. mirror: as in gloss_add_lamp */
static void gloss_add_light(const gloss_tracer *g, const gloss_surface *s, const gloss_path *path, const sbl_light *l,
                            int mirror, double sum[3]) {
    double f[3], light[3], cone = 1;
    gloss_way w;
    v3 ends[2];
    int k;
    for (k = 0; k < 3; k++) light[k] = (double)l->intensity[k] * (mirror < 0 ? 1 : g->mirror_count);
    ends[0] = v3_mad(s->at.position, s->face, TRUTH_OFFSET);
    ends[1] = v3_from(l->position);
    if (!gloss_find_way(g->t, mirror < 0 ? NULL : &g->mirrors[mirror], ends, &w, light)) return;
    if (l->kind == SBL_LIGHT_SPOT) {
        const double outer = cos((double)l->cone * REF_PI / 360), inner = cos((double)l->inner_cone * REF_PI / 360);
        cone = (-v3_dot(w.d[w.parts - 1], v3_unit(v3_from(l->direction))) - outer) / (inner - outer);
        cone = fmin(fmax(cone, 0), 1);
    }
    gloss_reflects(s, w.d[0], f);
    if (!(f[0] + f[1] + f[2] > 0) || cone <= 0 || !gloss_way_is_free(g->t, &w, -1, light)) return;
    for (k = 0; k < 3; k++) sum[k] += path->share[k] * f[k] * light[k] * cone * cone / (w.whole * w.whole);
}

/* >>paths */

/* Returns the weight of the light of a lamp that a path has met. lamp: -1: the path met something else; d: direction of
   the path's last part */
static double gloss_met(const gloss_tracer *g, const gloss_path *p, int lamp, v3 d) {
    if (p->density < 0 || lamp < 0 || p->mirrors > 1 || (p->mirrors && p->mirror < 0)) return 1;
    return p->density / (p->density + truth_density(g->t, lamp, d, p->way) / (p->mirrors ? g->mirror_count : 1));
}

/* Chooses how the path goes on from a surface, and sets where its next part starts and which direction it has. Returns
   0 if the path ends. */
static int gloss_go_on(const gloss_tracer *g, const gloss_surface *s, gloss_path *p, v3 *from, v3 *d) {
    const double choice = gloss_number(p), lobe = s->f0 < 0 ? 0 : 1 - s->through - s->diffuse;
    gloss_turn *turn = &p->turn;
    double u[4];
    int k;
    for (k = 0; k < 4; k++) u[k] = gloss_number(p);
    *from = v3_mad(s->at.position, s->face, choice < s->through ? -TRUTH_OFFSET : TRUTH_OFFSET);
    if (choice < s->through) {
        for (k = 0; k < 3; k++) p->share[k] *= s->clear[k] / s->through;
        return 1;
    }
    if (choice >= s->through + s->diffuse && !(lobe > 0)) return 0;  /* a black surface, such as a lamp */
    if (choice >= s->through + s->diffuse && s->alpha <= 0) {
        *d = gloss_mirrored(s->v, s->n);
        for (k = 0; k < 3; k++) p->share[k] *= gloss_mirrors(s, k) / lobe;
        p->mirrors++;
        for (k = g->mirror_count - 1; k >= 0 && g->mirrors[k].mesh != s->at.mesh; k--) {}
        p->mirror = k;
        return v3_dot(*d, s->face) > 0;
    }
    turn->target = -1;
    if (choice < s->through + s->diffuse) *d = truth_direction(g->t, p->guided, *from, s->n, u, &turn->target);
    else *d = gloss_lobe_direction(s, u[0], u[1]);
    turn->is_set = 1;
    turn->lobe = gloss_reflects(s, *d, turn->f);
    turn->diffuse = s->diffuse;
    turn->guided = p->guided;
    turn->cosine = v3_dot(s->n, *d);
    return turn->f[0] + turn->f[1] + turn->f[2] > 0;
}

/* Multiplies the path's share by the weight of the direction that it chose last, now that its hit is known. Returns 0
   if the path ends. */
static int gloss_end_turn(const truth *t, gloss_path *p, ref_hit hit, v3 d) {
    const gloss_turn *turn = &p->turn;
    int k;
    if (!turn->is_set) return 1;
    if (turn->target >= 0 && hit.triangle != turn->target) return 0;
    p->density = turn->lobe + turn->diffuse * truth_onward(t, turn->guided, hit.triangle, d, turn->cosine, hit.t);
    for (k = 0; k < 3; k++) p->share[k] *= turn->f[k] / p->density;
    p->turn.is_set = p->mirrors = 0;
    p->way = 0;
    return 1;
}

/* Adds the light of one random lamp and of all point and spot lights, directly, and by way of one random mirror. */
static void gloss_add_lamps(const gloss_tracer *g, const gloss_surface *s, gloss_path *p, double sum[3]) {
    int i, k;
    for (i = 0; i <= (g->mirror_count > 0); i++) {
        const int mirror = i ? (int)(ref_random(p->random) * g->mirror_count) : -1;
        if (g->t->lamp_count) gloss_add_lamp(g, s, p, mirror, sum);
        for (k = 0; k < g->t->scene->desc.light_count; k++)
            gloss_add_light(g, s, p, &g->t->scene->desc.lights[k], mirror, sum);
    }
}

static void gloss_trace(const gloss_tracer *g, v3 from, v3 d, gloss_path *p, double sum[3]) {
    const truth *t = g->t;
    double distance, survive;
    int bounce, k;
    for (bounce = 0; bounce < TRUTH_BOUNCES; bounce++) {
        const ref_hit hit = truth_trace(t, from, d);
        gloss_surface s;
        if (!gloss_end_turn(t, p, hit, d)) return;
        p->guided = truth_share(t, bounce);
        if (hit.triangle < 0) {
            const int lamp = truth_window(t, from, d, &distance);
            p->way += lamp < 0 ? 0 : distance;
            for (k = 0; k < 3; k++) sum[k] += p->share[k] * (double)t->scene->desc.sky[k] * gloss_met(g, p, lamp, d);
            return;
        }
        s = gloss_surface_at(t, hit, d);
        p->way += hit.t;
        for (k = 0; k < 3; k++)
            sum[k] += p->share[k] * s.opacity * s.at.emission[k] * gloss_met(g, p, t->lamp_of[hit.triangle], d);
        survive = bounce < 4 ? 1 : fmin(fmax(p->share[0], fmax(p->share[1], p->share[2])), 1);
        if (ref_random(p->random) >= survive) return;
        for (k = 0; k < 3; k++) p->share[k] /= survive;
        if (s.diffuse > 0 || s.alpha > 0) gloss_add_lamps(g, &s, p, sum);
        if (!gloss_go_on(g, &s, p, &from, &d)) return;
    }
}

/* >>pictures */

typedef struct gloss_job {
    const gloss_tracer *tracer;
    const sbl_picture_desc *view;
    int samples, half;
    float *rgb;
    pthread_t thread;
} gloss_job;

static void *gloss_run(void *user) {
    const gloss_job *job = (const gloss_job *)user;
    const int width = job->view->width, height = job->view->height;
    int i, j, k;
    for (i = 0; i < width * height; i++) {
        uint64_t random = 2 * (uint64_t)i + (uint64_t)job->half + ((uint64_t)77 << 40);
        double start[GLOSS_NUMBERS], number[GLOSS_NUMBERS], sum[3] = { 0, 0, 0 };
        v3 from, d;
        random = (uint64_t)(ref_random(&random) * 9e15);
        for (k = 0; k < GLOSS_NUMBERS; k++) start[k] = ref_random(&random);
        ref_camera_ray(job->view, i % width + 0.5, i / width + 0.5, &from, &d);
        for (j = 0; j < job->samples; j++) {
            gloss_path p;
            v3 origin = from, direction = d;
            double alpha = 1;
            for (k = 0; k < GLOSS_NUMBERS; k++) {  /* a Kronecker sequence */
                alpha /= 1.0570506;
                number[k] = fmod(start[k] + (j + 1) * alpha, 1);
            }
            memset(&p, 0, sizeof p);
            p.number = number;
            p.random = &random;
            p.share[0] = p.share[1] = p.share[2] = 1;
            p.density = -1;
            gloss_trace(job->tracer, origin, direction, &p, sum);
        }
        for (k = 0; k < 3; k++) job->rgb[3 * i + k] = (float)(sum[k] / job->samples);
    }
    return NULL;
}

/* Finds the flat mirrors: all perfect mirrors and panes that consist of two triangles. */
static void gloss_find_mirrors(gloss_tracer *g) {
    const ref_scene *scene = g->t->scene;
    int i;
    for (i = 0; i < scene->desc.mesh_count; i++) {
        const sbl_mesh *mesh = &scene->desc.meshes[i];
        const sbl_material *m = &scene->desc.materials[mesh->material];
        const float *corners = (const float *)mesh->positions.data;
        gloss_mirror *to = &g->mirrors[g->mirror_count];
        if (mesh->vertex_count != 6 || m->roughness >= 0.05f || !(m->ior > 0 || m->metallic > 0)) continue;
        if (g->mirror_count++ == GLOSS_MIRRORS) abort();
        to->corner = v3_from(corners);
        to->across = v3_sub(v3_from(corners + 3), to->corner);
        to->up = v3_sub(v3_from(corners + 15), to->corner);
        to->mesh = i;
        while (scene->triangles[to->triangle].mesh != i) to->triangle++;
    }
}

/* Follows the ray through a point of the picture by way of mirrors and panes. Returns 1 and sets `seen` to the surface
   at its end and *parts to the number of its parts; returns 0 if it ends at a lamp or in the sky. */
static int gloss_seen(const truth *t, const sbl_picture_desc *view, double x, double y, gloss_surface *seen,
                      int *parts) {
    v3 from, d;
    ref_camera_ray(view, x, y, &from, &d);
    for (*parts = 1; *parts <= 8; ++*parts) {
        const ref_hit hit = ref_trace(t->scene, from, d, 0, HUGE_VAL, 0);
        if (hit.triangle < 0) return 0;
        *seen = gloss_surface_at(t, hit, d);
        if (seen->at.emission[0] > 0) return 0;
        if (seen->through < 0.5 && !(seen->alpha <= 0 && seen->f0 >= 0 && seen->metallic > 0.5)) break;
        from = v3_mad(seen->at.position, seen->face, seen->through < 0.5 ? TRUTH_OFFSET : -TRUTH_OFFSET);
        if (seen->through < 0.5) d = gloss_mirrored(seen->v, seen->n);
    }
    return 1;
}

/* Sets kind to 0 where a pixel shows a lamp or the sky, directly or by way of mirrors and panes, because all pictures
   are exact there; and where the centre of a pixel lies on an edge, because rasterisers round corners to parts of a
   pixel, so that pictures may show either of two surfaces. */
static void gloss_leave_out(ref_scene *scene, const sbl_picture_desc *view, unsigned char *kind) {
    truth t;
    int i, j;
    memset(&t, 0, sizeof t);
    t.scene = scene;
    for (i = 0; i < view->width * view->height; i++) {
        const double x = i % view->width + 0.5, y = i / view->width + 0.5;
        gloss_surface seen, beside;
        int parts, other;
        if (!kind[i] || !gloss_seen(&t, view, x, y, &seen, &parts)) { kind[i] = 0; continue; }
        for (j = 0; j < 4; j++)
            if (!gloss_seen(&t, view, x + (j & 1 ? GLOSS_TIE : -GLOSS_TIE), y + (j & 2 ? GLOSS_TIE : -GLOSS_TIE),
                            &beside, &other) ||
                parts != other || seen.at.mesh != beside.at.mesh || v3_dot(seen.at.face, beside.at.face) < 0.9)
                kind[i] = 0;
    }
}

/* Makes two independent pictures of the radiance at pixel centres, on two threads. */
static void gloss_truth_render(const gloss_room *room, int samples, float *halves[2]) {
    gloss_tracer tracer;
    gloss_job jobs[2];
    int i;
    memset(&tracer, 0, sizeof tracer);
    tracer.t = truth_create(&room->made.scene, room->made.windows, room->made.window_count);
    gloss_find_mirrors(&tracer);
    for (i = 0; i < 2; i++) {
        memset(&jobs[i], 0, sizeof jobs[i]);
        jobs[i].tracer = &tracer;
        jobs[i].view = &room->made.view;
        jobs[i].samples = samples;
        jobs[i].half = i;
        jobs[i].rgb = halves[i];
        if (pthread_create(&jobs[i].thread, NULL, gloss_run, &jobs[i]) != 0) abort();
    }
    for (i = 0; i < 2; i++) pthread_join(jobs[i].thread, NULL);
    truth_destroy(tracer.t);
}

#endif
