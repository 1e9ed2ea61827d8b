/* Checks of the path tracer of glossy rooms against closed forms and sums over a lamp's points. Include after
   bench_gloss_truth.h.
       gloss_check()   returns 0 and prints what differs if the path tracer is wrong */
#ifndef BENCH_GLOSS_CHECK_H
#define BENCH_GLOSS_CHECK_H

enum { GLOSS_CHECK_SAMPLES = 20000, GLOSS_CHECK_STEPS = 200 };

/* Returns the mean radiance in the green colour that arrives along d, or, if evenly is set, along directions to the
   floor that have a cosine distribution. */
static double gloss_mean(gloss_room *r, v3 from, v3 d, int evenly) {
    gloss_tracer g;
    double sum[3] = { 0, 0, 0 }, number[GLOSS_NUMBERS];
    uint64_t random = 5;
    int i, k;
    furnished_finish(&r->made);
    memset(&g, 0, sizeof g);
    g.t = truth_create(&r->made.scene, r->made.windows, r->made.window_count);
    gloss_find_mirrors(&g);
    for (i = 0; i < GLOSS_CHECK_SAMPLES; i++) {
        const double angle = 2 * REF_PI * ref_random(&random), x = ref_random(&random);
        gloss_path p;
        for (k = 0; k < GLOSS_NUMBERS; k++) number[k] = ref_random(&random);
        memset(&p, 0, sizeof p);
        p.number = number;
        p.random = &random;
        p.share[0] = p.share[1] = p.share[2] = 1;
        p.density = -1;
        if (evenly) d = v3_of(sqrt(x) * cos(angle), -sqrt(1 - x), sqrt(x) * sin(angle));
        gloss_trace(&g, v3_mad(from, d, -0.1), d, &p, sum);
    }
    truth_destroy(g.t);
    gloss_room_free(r);
    return sum[1] / GLOSS_CHECK_SAMPLES;
}

static int gloss_agrees(const char *name, double found, double expected, double tolerance) {
    if (fabs(found / expected - 1) < tolerance) return 1;
    fprintf(stderr, "bench_error: the path tracer is wrong: %s: %g instead of %g\n", name, found, expected);
    return 0;
}

/* A metal floor under a sky of 1, seen evenly from everywhere. */
static int gloss_check_metal(gloss_room *r, double roughness, double expected) {
    int k;
    for (k = 0; k < 3; k++) r->made.scene.sky[k] = 1;
    gloss_metal(r, 1, 1, 1, roughness);
    gloss_plate(r, 1, 0, -1, -1, 1, 1);
    return gloss_agrees("metal under a sky", gloss_mean(r, v3_of(0, 0, 0), v3_of(0, -1, 0), 1), expected, 0.01);
}

/* A closed room where everything has the radiance 1, half of it reflected, with panes and mirrors that lose nothing. */
static int gloss_check_furnace(gloss_room *r) {
    sbl_material *m;
    int k;
    gloss_matte(r, 0.5, 0.5, 0.5);
    gloss_box(r, -2, -2, -2, 2, 2, 2);
    for (k = 0; k < 3; k++) r->made.materials[0].emission[k] = 0.5f;
    gloss_metal(r, 1, 1, 1, 0);
    gloss_plate(r, 1, -1, -1, -1, 1, 1);
    gloss_metal(r, 1, 1, 1, 0);
    gloss_ball(r, -1, 0, 1, 0.5);
    m = gloss_begin(r, 1, 1, 1, 0, 0);
    m->ior = 1.5f;
    m->transmission = 1;
    gloss_plate(r, 0, 0.5, -1, -1, 1, 1);
    return gloss_agrees("furnace", gloss_mean(r, v3_of(0, 0, 0), v3_of(0, -1, 0), 1), 1, 0.01);
}

/* Returns R at the origin of a floor below a lamp 0.4 m square at a height of 1 m, as a sum over the lamp's points.
   side: if it is above 0, a mirror or a pane in the plane x = side reflects the lamp. base: reflectance of the mirror;
   0: a pane. pane: if it is above 0, a pane lies between the lamp and the floor. direct: 0: without the lamp itself */
static double gloss_lamp_light(double side, double base, double pane, int direct) {
    double sum = 0;
    int i, j;
    for (i = 0; i < GLOSS_CHECK_STEPS * GLOSS_CHECK_STEPS; i++) {
        const double x = 0.4 * (i % GLOSS_CHECK_STEPS + 0.5) / GLOSS_CHECK_STEPS - 0.2;
        const double z = 0.4 * (i / GLOSS_CHECK_STEPS + 0.5) / GLOSS_CHECK_STEPS - 0.2;
        for (j = direct ? 0 : 1; j < (side > 0 ? 2 : 1); j++) {
            const v3 d = v3_of(j ? 2 * side - x : x, 1, z);
            const double away = v3_length(d), up = d.y / away, across = d.x / away;
            double share = j ? base > 0 ? gloss_schlick(base, across) : gloss_schlick(0.04, across) : 1;
            if (pane > 0) share *= 1 - gloss_schlick(0.04, up);
            sum += share * up * up / (away * away);
        }
    }
    return sum * 0.16 / GLOSS_CHECK_STEPS / GLOSS_CHECK_STEPS / REF_PI;
}

/* The floor below a lamp, with a mirror or pane beside the floor or a pane above it. kind: 0: a pane above; 1: a mirror
   beside; 2: a pane beside; 3: a pane beside, with a screen that hides the lamp itself */
static int gloss_check_floor(gloss_room *r, int kind) {
    static const char *const names[4] = { "floor below a pane", "floor beside a mirror", "floor beside a pane",
                                          "floor lit by a pane alone" };
    const double expected = 0.5 * gloss_lamp_light(kind ? 0.45 : 0, kind == 1 ? 0.6 : 0, kind ? 0 : 0.5, kind != 3);
    gloss_matte(r, 0.5, 0.5, 0.5);
    gloss_plate(r, 1, 0, -0.01, -0.01, 0.01, 0.01);
    gloss_begin(r, 0, 0, 0, 0, 0)->emission[1] = 1;
    gloss_plate(r, 1, 1, -0.2, -0.2, 0.2, 0.2);
    if (kind == 1) gloss_metal(r, 0.6, 0.6, 0.6, 0);
    else {
        sbl_material *m = gloss_begin(r, 1, 1, 1, 0, 0);
        m->ior = 1.5f;
        m->transmission = 1;
    }
    if (kind) gloss_plate(r, 0, 0.45, -4, -4, 4, 4);
    else gloss_plate(r, 1, 0.5, -4, -4, 4, 4);
    gloss_matte(r, 0, 0, 0);
    if (kind == 3) gloss_plate(r, 1, 0.5, -0.16, -0.16, 0.16, 0.16);
    return gloss_agrees(names[kind], gloss_mean(r, v3_of(0, 0, 0), v3_unit(v3_of(0.2, -0.9, 0.3)), 0), expected, 0.01);
}

/* A lamp that is seen in a mirror at 60 degrees, or through a pane. */
static int gloss_check_seen(gloss_room *r, int pane) {
    const double cosine = 0.5, away = sqrt(1 - cosine * cosine);
    const double expected = pane ? 0.98 * (1 - gloss_schlick(0.04, cosine)) : gloss_schlick(0.6, cosine);
    if (pane) gloss_glass(r, 1);
    else gloss_metal(r, 0.6, 0.6, 0.6, 0);
    gloss_plate(r, 1, 0, -1, -1, 1, 1);
    gloss_begin(r, 0, 0, 0, 0, 0)->emission[1] = 1;
    gloss_plate(r, 1, pane ? -1 : 1, -9, -9, 9, 9);
    return gloss_agrees(pane ? "lamp behind a pane" : "lamp in a mirror",
                        gloss_mean(r, v3_of(0, 0, 0), v3_of(away, -cosine, 0), 0), expected, pane ? 0.005 : 1e-5);
}

static int gloss_check(void) {
    static const double metal[3][2] = { { 0.3, 0.976 }, { 0.6, 0.803 }, { 1, 0.409 } };
    gloss_room *r = (gloss_room *)calloc(1, sizeof *r);
    int i, ok = 1;
    if (!r) abort();
    for (i = 0; i < 3; i++) ok &= gloss_check_metal(r, metal[i][0], metal[i][1]);
    ok &= gloss_check_furnace(r);
    for (i = 0; i < 4; i++) ok &= gloss_check_floor(r, i);
    for (i = 0; i < 2; i++) ok &= gloss_check_seen(r, i);
    free(r);
    return ok;
}

#endif
