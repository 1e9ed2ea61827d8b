/* Tests direct light of every kind. It is compared with closed forms, and its energy is balanced: the light that leaves
   the lamps arrives at the walls around them. truth() computes the expected R in double precision from the description
   of the scene: triangles by Lambert's formula, spheres and suns as fans of triangles, points by the inverse square
   law. An opaque edge cuts each lamp by the plane through the edge and the sensor. */
#include "../sbl.h"
#include "support/test.h"
#include "support/scenes.h"
#include "support/reference.h"

static sbl_context *context;

enum { BODY = 1000 };  /* id of closed convex lamps, of which only triangles that face the sensor count */

/* >>expected values */

/* a straight edge through the point `at`; light passes on the side that `open` points to */
typedef struct edge { v3 at, along, open; } edge;

static v3 edge_plane(const edge *e, v3 p) {
    v3 m = v3_cross(e->along, v3_sub(e->at, p));
    return v3_dot(m, e->open) < 0 ? v3_scale(m, -1) : m;
}

/* Returns R at p, with the normal n, from a triangle of radiance 1. e: the edge that cuts the light, or NULL */
static double triangle_share(v3 p, v3 n, const v3 corners[3], const edge *e) {
    v3 left[4];
    if (!e) return ref_polygon(p, n, corners, 3);
    return ref_polygon(p, n, left, ref_clip(p, edge_plane(e, p), corners, 3, left));
}

/* The same for all directions within the angle `half` of `axis`. The fan of triangles is inscribed in the cone and
   misses 0.0025 % of it. */
static double cone_share(v3 p, v3 n, v3 axis, double half, const edge *e) {
    enum { FAN = 512 };
    v3 u = v3_unit(v3_cross(axis, fabs(axis.x) < 0.5 ? v3_of(1, 0, 0) : v3_of(0, 1, 0))), v = v3_cross(axis, u),
        corners[3];
    double sum = 0;
    int i;
    corners[0] = v3_add(p, axis);
    for (i = 0; i <= FAN; i++) {
        double phi = 2 * REF_PI * i / FAN;
        corners[1] = corners[2];
        corners[2] = v3_add(p, v3_add(v3_scale(axis, cos(half)),
                                      v3_scale(v3_add(v3_scale(u, cos(phi)), v3_scale(v, sin(phi))), sin(half))));
        if (i) sum += triangle_share(p, n, corners, e);
    }
    return sum;
}

/* Returns 1 - cosine of half the cone of a spot. */
static double spot_versine(const sbl_light *l) {
    return 2 * pow(sin((l->cone > 0 ? (double)l->cone : 90) * REF_PI / 720), 2);
}

/* Returns the share of the intensity of a spot in the direction d, as sbl_light defines it. If both cones are equal,
   the edge is slightly soft. */
static double spot_share(const sbl_light *l, v3 d) {
    const double outer = spot_versine(l), inner = 2 * pow(sin((double)l->inner_cone * REF_PI / 720), 2);
    const v3 off = v3_sub(d, v3_unit(v3_from(l->direction)));
    const double share = (outer - 0.5 * v3_dot(off, off)) / fmax(0.001 * outer, outer - inner);
    return share < 0 ? 0 : share > 1 ? 1 : share * share;
}

/* Returns R from one light of intensity 1. */
static double light_share(const sbl_light *l, v3 p, v3 n, const edge *e) {
    int sun = l->kind == SBL_LIGHT_DIRECTIONAL;
    v3 d = sun ? v3_scale(v3_unit(v3_from(l->direction)), -1) : v3_sub(v3_from(l->position), p);
    double away = v3_length(d), half = sun ? (double)l->angle * REF_PI / 360 : l->radius > 0
        ? asin((double)l->radius / away) : 0, given = 1 / REF_PI;
    d = v3_scale(d, 1 / away);
    if (l->kind == SBL_LIGHT_SPOT) given *= spot_share(l, v3_scale(d, -1));
    if (!sun) given /= away * away;
    if (half > 0) return given / (sin(half) * sin(half)) * cone_share(p, n, d, half, e);
    return v3_dot(d, n) > 0 && (!e || v3_dot(d, edge_plane(e, p)) > 0) ? given * v3_dot(d, n) : 0;
}

static void even(const float direction[3], float radiance[3], void *user) {
    (void)direction, (void)user;
    radiance[0] = radiance[1] = radiance[2] = 1;
}

/* Computes R at p from the emitting triangles, lights and constant sky of the scene, with no occluder except the edge.
   Lamps must not cover one another. */
static void truth(const ref_scene *scene, v3 p, v3 n, const edge *e, double rgb[3]) {
    double covered = 0, share;
    int i, k;
    rgb[0] = rgb[1] = rgb[2] = 0;
    for (i = 0; i < scene->triangle_count; i++) {
        const ref_triangle *t = &scene->triangles[i];
        const sbl_mesh *mesh = &scene->desc.meshes[t->mesh];
        const sbl_material *m = &scene->desc.materials[mesh->material];
        int away = v3_dot(v3_cross(v3_sub(t->p[1], t->p[0]), v3_sub(t->p[2], t->p[0])), v3_sub(p, t->p[0])) < 0;
        if (m->emission[0] <= 0 || (away && (mesh->id == BODY || (m->flags & SBL_MATERIAL_ONE_SIDED_EMISSION))))
            continue;
        share = triangle_share(p, n, t->p, e);
        covered += share;
        for (k = 0; k < 3; k++) rgb[k] += share * (double)m->emission[k];
    }
    for (i = 0; i < scene->desc.light_count; i++) {
        share = light_share(&scene->desc.lights[i], p, n, e);
        for (k = 0; k < 3; k++) rgb[k] += share * (double)scene->desc.lights[i].intensity[k];
    }
    for (k = 0; k < 3; k++)
        rgb[k] += (1 - covered) * ((double)scene->desc.sky[k] + (scene->desc.environment.radiance == even));
}

/* The formulas above agree with sums over directions. All later tests rely on them. */
TEST(formulas_against_quadrature) {
    static const double directions[4][3] = { { 0.2, 1, -0.3 }, { 1, 0.25, 0.1 }, { -0.3, 0.02, 1 },
        { 0.4, -0.1, 0.3 } };
    v3 n = v3_of(0, 1, 0), origin = v3_of(0, 0, 0), corners[3];
    int i, j, k, rings = 600, turn = 1200;
    corners[0] = v3_of(0.9, 1, -0.8); corners[1] = v3_of(-1, 1.2, -0.3); corners[2] = v3_of(0.8, -0.5, 0.9);
    for (k = 0; k < 5; k++) {  /* four cones and a triangle, each with an edge across it */
        double sums[2] = { 0, 0 }, half = k < 4 ? 0.3 : REF_PI / 2, formula;
        v3 axis = k < 4 ? v3_unit(v3_of(directions[k][0], directions[k][1], directions[k][2])) : n;
        v3 middle = v3_add(corners[0], v3_add(corners[1], corners[2]));
        v3 u = v3_unit(v3_cross(axis, v3_of(0.3, 0.4, 0.5))), v = v3_cross(axis, u), normal;
        edge e;
        e.at = k < 4 ? axis : middle; e.along = v3_of(0.3, 1, 1); e.open = v3_of(1, 0, 0);
        /* normal of the plane through the origin that contains the edge */
        normal = v3_of(e.at.y - e.at.z, 0.3 * e.at.z - e.at.x, e.at.x - 0.3 * e.at.y);
        for (i = 0; i < rings; i++)
            for (j = 0; j < turn; j++) {
                double t = half * (i + 0.5) / rings, phi = 2 * REF_PI * (j + 0.5) / turn, weight;
                v3 d = v3_add(v3_scale(axis, cos(t)),
                              v3_scale(v3_add(v3_scale(u, cos(phi)), v3_scale(v, sin(phi))), sin(t)));
                int outside = 0, side;
                /* a direction is inside if it is on the same side of all three planes as the centre of the triangle */
                for (side = 0; side < 3 && k == 4; side++) {
                    v3 plane = v3_cross(corners[side], corners[(side + 1) % 3]);
                    outside |= (v3_dot(plane, d) > 0) != (v3_dot(plane, middle) > 0);
                }
                if (d.y <= 0 || outside) continue;
                weight = d.y * sin(t) * half / rings * 2 / turn;
                sums[0] += weight;
                if ((v3_dot(d, normal) > 0) == (normal.x > 0)) sums[1] += weight;
            }
        for (j = 0; j < 2; j++) {
            const edge *past = j ? &e : NULL;
            formula = k < 4 ? cone_share(origin, n, axis, half, past) : triangle_share(origin, n, corners, past);
            CHECK(fabs(formula - sums[j]) < 2e-3 * sums[0], "case %d, %s: formula %.7f, sum %.7f", k,
                  j ? "past an edge" : "open", formula, sums[j]);
        }
        CHECK(sums[1] > 0.05 * sums[0] && sums[1] < 0.95 * sums[0], "case %d: the edge leaves %.3f of all", k,
              sums[1] / sums[0]);
    }
}

/* >>one lamp of each kind, at a given position and of about the given size, which shines towards the origin. The floor
   is mesh 0 */

enum { QUAD, TRIANGLE, DISC, BALL, SPHERE, SUN, POINT, SPOT, DISTANT, KINDS, FINE_DISC = KINDS };
static const char *const kind_names[KINDS + 1] = { "quad", "triangle", "disc of 200 triangles", "ball of 256 triangles",
    "sphere light", "sun",
                                               "point light", "spot light", "sun without diameter",
                                               "disc of 1,000 triangles" };

static void add_floor(test_scene *s) { scene_floor(s, scene_material(s, 0.5f, 0.5f, 0.5f), 0, 3); }

static void add_lamp(test_scene *s, int kind, v3 c, double size) {
    v3 d = v3_unit(v3_add(v3_scale(v3_unit(c), -1), v3_of(0.2, 0.1, -0.1))),
        u = v3_unit(v3_cross(d, v3_of(0.2, 0.3, 0.9))), v = v3_cross(d, u);
    float scale = (float)(kind >= POINT ? 4 : REF_PI * size * size), centre[3], pu[3], pv[3];
    int k, lamp = kind < SPHERE || kind == FINE_DISC ? scene_lamp(s, 2, 1, 0.5f) : -1;
    centre[0] = (float)c.x; centre[1] = (float)c.y; centre[2] = (float)c.z;
    pu[0] = (float)(u.x * size); pu[1] = (float)(u.y * size); pu[2] = (float)(u.z * size);
    pv[0] = (float)(v.x * size); pv[1] = (float)(v.y * size); pv[2] = (float)(v.z * size);
    if (lamp >= 0) s->materials[lamp].flags = SBL_MATERIAL_HIDDEN_FROM_CAMERA;
    if (kind == QUAD || kind == TRIANGLE) {
        float corners[12];
        for (k = 0; k < 3; k++) {
            corners[k] = centre[k] - pu[k] - pv[k];
            corners[3 + k] = centre[k] + pu[k] - pv[k];
            corners[6 + k] = centre[k] + pu[k] + pv[k];
            corners[9 + k] = centre[k] - pu[k] + pv[k];
        }
        scene_polygon(s, lamp, corners, kind == QUAD ? 4 : 3);
    } else if (kind == DISC || kind == FINE_DISC) {
        scene_disc(s, lamp, centre, pu, pv, kind == DISC ? 200 : 1000);
    } else if (kind == BALL) {
        scene_sphere(s, lamp, centre[0], centre[1], centre[2], (float)size, 16, 9, 0)->id = BODY;
    } else {
        sbl_light *l = scene_light(s, kind == SUN || kind == DISTANT ? SBL_LIGHT_DIRECTIONAL : kind == SPOT
                                   ? SBL_LIGHT_SPOT : SBL_LIGHT_POINT,
                                   2 * scale, scale, 0.5f * scale);
        for (k = 0; k < 3; k++) { l->position[k] = centre[k]; l->direction[k] = -3 * centre[k]; }
        if (kind == SPHERE) l->radius = (float)size;
        if (kind == SUN) l->angle = (float)(360 / REF_PI * asin(size / v3_length(c)));
        if (kind == SPOT) { l->cone = 40; l->inner_cone = 20; }
    }
}

/* Returns a view down at a square of the floor around (x, 0, z). plain: 1: a sensor at every pixel and no filter; 0:
   default settings */
static sbl_picture_desc patch(int width, int height, double size, double x, double z, int plain) {
    sbl_picture_desc view =
        scene_view(width, height, (float)(360 / REF_PI * atan(size / 6)), (float)x, 3, (float)z, (float)x, 0, (float)z);
    view.options.mode = SBL_MODE_DIRECT;
    if (plain) { view.tile = 1; view.filter_radius = -1; view.samples = 1; view.options.rays = 256; }
    else view.target_error = 0.002f;
    return view;
}

/* Errors of R. bias, rms: relative to the light without an edge. worst: relative to the expected value of the pixel, or
   to a twentieth of the brightest pixel if that is larger */
typedef struct errors { double bias, rms, worst, dimmest; int pixels; } errors;

/* Renders, and compares all components of R with truth() at all pixels that show mesh 0. */
static errors compare(const test_scene *s, const sbl_picture_desc *view, const edge *e) {
    sbl_scene_desc desc = scene_desc(s);
    ref_scene *scene = ref_create(&desc);
    double sum = 0, squares = 0, least[3] = { 0, 0, 0 };
    errors error = { NAN, NAN, NAN, HUGE_VAL, 0 };
    int x, y, k;
    if (scene_render(context, s, view)) {
        float *radiance = scene_channel(context, view, SBL_CHANNEL_RADIANCE);
        error.worst = 0;
        for (x = 0; x < 3 * view->width * view->height; x++)
            least[x % 3] = fmax(least[x % 3], 0.05 * (double)radiance[x]);
        for (y = 0; y < view->height; y++)
            for (x = 0; x < view->width; x++) {
                ref_point p = ref_pixel(scene, view, x, y);
                double expected[3], full[3];
                if (!p.hit || p.mesh != 0) continue;
                truth(scene, p.position, p.normal, e, expected);
                truth(scene, p.position, p.normal, NULL, full);
                error.pixels++;
                for (k = 0; k < 3; k++) {
                    double off = (double)radiance[3 * (y * view->width + x) + k] - expected[k];
                    sum += full[k] > 0 ? off / full[k] : 0;
                    squares += full[k] > 0 ? off * off / (full[k] * full[k]) : 0;
                    off = fabs(off) / fmax(expected[k], least[k]);
                    if (!(off <= error.worst)) error.worst = off;
                    if (expected[k] < error.dimmest) error.dimmest = expected[k];
                }
            }
        error.bias = sum / (3 * error.pixels);
        error.rms = sqrt(squares / (3 * error.pixels));
        free(radiance);
    }
    CHECK(error.pixels > 0, "the floor is not seen");
    ref_destroy(scene);
    return error;
}

static const struct { const char *name; double at[3], size; int horizon; } places[] = {
    { "overhead", { 0, 1, 0 }, 0.4, 0 }, { "aside", { 1.2, 0.8, -0.5 }, 0.3, 0 }, { "large", { 0.3, 2, 0.2 }, 1.5, 0 },
    { "a ten-thousandth of the hemisphere", { 0.3, 1, 0.2 }, 0.01, 0 }, { "a millionth", { -0.4, 1, 0.2 }, 0.001, 0 },
    { "half below the horizon", { 1, 0.05, 0.3 }, 0.4, 1 }, { "mostly below", { 0.3, -0.2, 1 }, 0.4, 1 },
    { "just dipping", { -1, 0.35, 0.2 }, 0.4, 1 } };
enum { PLACES = sizeof places / sizeof *places };

static void fully_visible(sbl_backend backend, int plain, double tolerance, double horizon_tolerance) {
    int kind, place;
    for (kind = 0; kind < KINDS; kind++)
        for (place = 0; place < PLACES; place++) {
            test_scene s = { 0 };
            sbl_picture_desc view = plain ? patch(8, 6, 0.5, 0.05, 0.1, 1) : patch(40, 30, 0.02, 0.05, 0.1, 0);
            errors error;
            double allowed = places[place].horizon ? horizon_tolerance : tolerance;
            if (kind >= POINT && (places[place].at[1] < 0 || (place > 2 && place != 5))) continue;
            view.options.backend = backend;
            if (backend == SBL_BACKEND_RASTER) { view.width = 4; view.height = 3; }
            add_floor(&s);
            add_lamp(&s, kind, v3_of(places[place].at[0], places[place].at[1], places[place].at[2]),
                     places[place].size);
            error = compare(&s, &view, NULL);
            CHECK(error.worst <= allowed, "%s, %s%s: R is off by %.4f %% at worst, mean %+.4f %%", kind_names[kind],
                  places[place].name,
                  plain ? "" : ", default settings", 100 * error.worst, 100 * error.bias);
            scene_free(&s);
        }
}

/* Without occluders, R of every kind of lamp at every position is within 0.1 % of the closed form. */
TEST(fully_visible) { fully_visible(SBL_BACKEND_AUTO, 1, 0.001, 0.002); }
/* The same holds with default settings, and within 0.3 % with rasterised sensors. */
TEST(fully_visible_default_settings) { fully_visible(SBL_BACKEND_AUTO, 0, 0.001, 0.002); }
TEST(fully_visible_raster) { fully_visible(SBL_BACKEND_RASTER, 1, 0.003, 0.003); }

/* The intensity of spots falls off from the axis to the edge of the cone as expected, for cones from narrow to a half
   space, and is 0 outside. */
TEST(spot_cones) {
    static const float cones[][2] = { { 90, 0 }, { 0, 45 }, { 30, 30 }, { 60, 59.9f }, { 170, 100 }, { 180, 180 },
        { 180, 0 }, { 4, 3 }, { 2, 0 }, { 0.5f, 0 } };
    int i, x, way;
    for (i = 0; i < (int)(sizeof cones / sizeof *cones); i++)
        for (way = 0; way < 2; way++) {
            test_scene s = { 0 };
            sbl_scene_desc desc;
            const double narrow = cones[i][0] > 0 && cones[i][0] < 5 ? sin((double)cones[i][0] * REF_PI / 180) : 0;
            sbl_picture_desc view = patch(64, 1, (narrow > 0 ? 2 * narrow : 4) / 64, narrow > 0 ? 0.1 : 0, 0, 1);
            ref_scene *scene;
            sbl_light *l;
            double worst = 0, brightest = 0;
            int dark = 0;
            add_floor(&s);
            l = scene_light(&s, SBL_LIGHT_SPOT, 3, 2, 1);
            l->position[0] = 0.3f; l->position[1] = 1;
            l->direction[0] = -0.02f; l->direction[1] = -0.1f;
            l->cone = cones[i][0];
            l->inner_cone = cones[i][1];
            view.options.backend = way ? SBL_BACKEND_RASTER : SBL_BACKEND_AUTO;
            if (way) { view.options.sensor_size = 4; }
            desc = scene_desc(&s);
            scene = ref_create(&desc);
            if (scene_render(context, &s, &view)) {
                float *radiance = scene_channel(context, &view, SBL_CHANNEL_RADIANCE);
                for (x = 0; x < view.width; x++) {
                    ref_point p = ref_pixel(scene, &view, x, 0);
                    v3 d = v3_unit(v3_sub(p.position, v3_from(l->position)));
                    double expected[3], step = 1 - v3_dot(d, v3_unit(v3_from(l->direction))) - spot_versine(l);
                    if (fabs(step) < 1e-5 * fmin(10 * spot_versine(l), 1)) continue;
                    truth(scene, p.position, p.normal, NULL, expected);
                    dark += expected[0] == 0;
                    if (expected[0] == 0)
                        CHECK(radiance[3 * x] == 0, "cone %g: R outside of the cone is %g", (double)l->cone,
                              (double)radiance[3 * x]);
                    else worst = test_max(worst, fabs((double)radiance[3 * x] - expected[0]) / fmax(expected[0], 1e-2));
                    brightest = fmax(brightest, expected[0]);
                }
                free(radiance);
            }
            CHECK(brightest > 0.5 && (l->cone > 90 || dark > 3),
                  "cone %g: the brightest R is %g, %d of %d pixels are outside",
                  (double)l->cone, brightest, dark,
                  view.width);
            CHECK(worst < (way ? 0.003 : 0.001), "cone %g, inner %g: R is off by %.4f %%", (double)l->cone,
                  (double)l->inner_cone, 100 * worst);
            ref_destroy(scene);
            scene_free(&s);
        }
}

/* There are 600 spotlights, which is more than a look has entries. Every other one is a thousand times as strong, but
   its light misses the floor: it faces away, or it shines past the floor with a narrow cone. Rays must go to those that
   light the floor, whose axes differ if the cones are narrow. */
TEST(spots_that_miss) {
    enum { SPOTS = 600 };
    sbl_picture_desc view = patch(32, 1, 4.0 / 32, 0, 0, 1);
    int narrow, i, x;
    for (narrow = 0; narrow < 2; narrow++) {
        test_scene s = { 0 };
        sbl_scene_desc desc;
        ref_scene *scene;
        double off = 0, bias = 0, all = 0;
        add_floor(&s);
        for (i = 0; i < SPOTS; i++) {
            const float strength = i & 1 ? 10.0f : 0.01f;
            sbl_light *l = scene_light(&s, SBL_LIGHT_SPOT, strength, strength, strength);
            l->position[0] = 0.16f * (float)(i % 25) - 2;
            l->position[1] = 1.5f;
            l->position[2] = 0.16f * (float)(i / 25) - 2;
            l->direction[0] = !narrow ? 0.0f : i & 1 ? 1.0f : 0.4f * (float)(i % 3) - 0.4f;
            l->direction[1] = i & 1 ? narrow ? -0.1f : 1.0f : -1.0f;
            l->cone = narrow ? 20 : 120;
        }
        desc = scene_desc(&s);
        scene = ref_create(&desc);
        if (scene_render(context, &s, &view)) {
            float *radiance = scene_channel(context, &view, SBL_CHANNEL_RADIANCE);
            for (x = 0; x < view.width; x++) {
                const ref_point p = ref_pixel(scene, &view, x, 0);
                double expected[3];
                truth(scene, p.position, p.normal, NULL, expected);
                off += fabs((double)radiance[3 * x] - expected[0]);
                bias += (double)radiance[3 * x] - expected[0];
                all += expected[0];
            }
            free(radiance);
        }
        printf("  %s: off by %.2f %%, in the mean by %+.2f %%\n", narrow ? "narrow cones" : "facing away",
               100 * off / all, 100 * bias / all);
        CHECK(fabs(bias) < 0.015 * all, "the mean is off by %+.2f %%", 100 * bias / all);
        CHECK(all > 0 && off < (narrow ? 0.12 : 0.02) * all, "R is off by %.2f %%", 100 * off / all);
        ref_destroy(scene);
        scene_free(&s);
    }
}

/* Disc and sphere agree with another formula: a lamp centred above a horizontal point gives R = sin^2 of half the angle
   that it subtends. */
TEST(disc_and_sphere_overhead) {
    int kind;
    for (kind = 0; kind < 3; kind++) {
        static const float centre[3] = { 0, 1, 0 }, u[3] = { 0.7f, 0, 0 }, v[3] = { 0, 0, 0.7f };
        test_scene s = { 0 };
        sbl_picture_desc view = patch(6, 6, 1e-4, 0, 0, 1);
        double expected, mean = 0;
        int i;
        add_floor(&s);
        if (kind < 2) {
            int lamp = scene_lamp(&s, 2, 2, 2);
            s.materials[lamp].flags = SBL_MATERIAL_HIDDEN_FROM_CAMERA;
            if (kind == 0) scene_disc(&s, lamp, centre, u, v, 256);
            else scene_sphere(&s, lamp, 0, 1, 0, 0.7f, 100, 51, 0);
        } else {
            sbl_light *l = scene_light(&s, SBL_LIGHT_POINT, 0, 0, 0);
            l->radius = 0.7f;
            l->position[1] = 1;
            l->intensity[0] = (float)(2 * REF_PI * 0.49);
        }
        expected = 2 * 0.49 / (kind == 0 ? 1.49 : 1);
        if (scene_render(context, &s, &view)) {
            float *radiance = scene_channel(context, &view, SBL_CHANNEL_RADIANCE);
            for (i = 0; i < 36; i++) mean += (double)radiance[3 * i] / 36;
            /* The ball of 10,000 triangles is 0.2 % smaller than the sphere, and its triangles are sampled at
               random. */
            CHECK(fabs(mean / expected - 1) < (kind == 1 ? 0.015 : 0.001), "%s: R is %.5f, expected %.5f",
                  kind == 0 ? "disc" : kind == 1 ? "fine ball" : "sphere light", mean, expected);
            free(radiance);
        }
        scene_free(&s);
    }
}

/* The centre of a small light is at heights[i] times its radius above the horizon. The quadrature cuts the part of the
   light's disc that is above the horizon into strips. */
TEST(small_lights_on_the_horizon) {
    static const double heights[3] = { -0.7, 0, 0.6 };
    const float radius = 0.005f;
    sbl_site site = { { 0, 0, 0 }, { 0, 1, 0 }, { 0, 0, 0 }, -1 };
    int i, k;
    for (i = 0; i < 3; i++) {
        const int strips = 2000;
        double expected = 0;
        sbl_reading reading;
        sbl_readings_desc desc = scene_readings(&site, &reading, 1, SBL_MODE_DIRECT);
        sbl_scene_desc scene;
        test_scene s = { 0 };
        sbl_light *light;
        scene_quad(&s, scene_material(&s, 0.5f, 0.5f, 0.5f), -1, -9, -1, -1, -9, 1, 1, -9, 1, 1, -9, -1);
        light = scene_light(&s, SBL_LIGHT_POINT, 1, 1, 1);
        light->position[0] = 1;
        light->position[1] = (float)heights[i] * radius;
        light->radius = radius;
        for (k = 0; k < strips; k++) {
            const double t = -1 + 2 * (k + 0.5) / strips, above = heights[i] + t;
            if (above > 0) expected += above * 2 * sqrt(1 - t * t) * 2 / strips * (double)radius / (REF_PI * REF_PI);
        }
        scene = scene_desc(&s);
        REQUIRE(sbl_set_scene(context, &scene) == SBL_SUCCESS && sbl_gather_readings(context, &desc) == SBL_SUCCESS,
                "the reading fails");
        CHECK(fabs((double)reading.radiance[0] / expected - 1) < 0.003, "height %g: R is %.4g, expected %.4g",
              heights[i], (double)reading.radiance[0], expected);
        scene_free(&s);
    }
}

/* Where a floor touches the sphere of a light, or is inside of it, the sphere fills the whole hemisphere, and R is its
   radiance, even if the light is a spot that points away from the floor. No ray is blocked by the floor itself. */
TEST(floors_inside_a_light) {
    static const float radii[3] = { 0.5f, 0.5000001f, 2 };
    static const sbl_backend backends[2] = { SBL_BACKEND_TRACE, SBL_BACKEND_RASTER };
    sbl_site sites[2] = { { { 0, 0, 0 }, { 0, 1, 0 }, { 0, 0, 0 }, 0 }, { { 0, 0, 0 }, { 0, 1, 0 }, { 0, 0, 0 }, -1 } };
    int i;
    for (i = 0; i < 6; i++) {
        const double radius = (double)radii[i / 2], expected = 1 / (REF_PI * radius * radius);
        sbl_reading readings[2];
        sbl_readings_desc desc = scene_readings(sites, readings, 2, SBL_MODE_DIRECT);
        sbl_scene_desc scene;
        test_scene s = { 0 };
        sbl_light *light;
        int k;
        add_floor(&s);
        light = scene_light(&s, i < 4 ? SBL_LIGHT_POINT : SBL_LIGHT_SPOT, 1, 1, 1);
        light->position[1] = 0.5f;
        light->direction[1] = 1;
        light->radius = (float)radius;
        scene = scene_desc(&s);
        desc.options.backend = backends[i % 2];
        desc.options.rays = 64;
        REQUIRE(sbl_set_scene(context, &scene) == SBL_SUCCESS && sbl_gather_readings(context, &desc) == SBL_SUCCESS,
                "the readings fail");
        for (k = 0; k < 2; k++)
            CHECK(fabs((double)readings[k].radiance[0] / expected - 1) < 1e-5, "radius %.7f, %s, site %d: R is %.6f, "
                  "expected %.6f", radius, i % 2 ? "views" : "rays", k, (double)readings[k].radiance[0], expected);
        scene_free(&s);
    }
}

/* >>half covered lamps */

/* Moves an opaque half plane at height 0.5, whose edge is not parallel to an axis, in small steps across the lamp at
   height 1. Compares R with truth() at all steps and pixels, relative to the unoccluded light. Returns the predicted
   RMS error divided by the true one. jump_allowed: largest change of the error of a pixel from one step to the next */
static double sweep(const char *name, test_scene *s, double reach, sbl_picture_desc view, int steps, double rms_allowed,
                    double jump_allowed) {
    enum { PIXELS = 64 };
    double before[PIXELS], full[PIXELS][3], squares = 0, predicted = 0, jump = 0, jump_at = 0, lowest = 1, highest = 0,
        sum = 0;
    sbl_scene_desc desc;
    ref_scene *scene;
    float place[16] = { 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1 };
    int step, i, count = 0, black = scene_material(s, 0, 0, 0), cover = s->mesh_count;
    edge e;
    s->materials[black].flags = SBL_MATERIAL_HIDDEN_FROM_CAMERA;
    e.along = v3_unit(v3_of(0.3, 0, 1));
    e.open = v3_unit(v3_of(1, 0, -0.3));
    {
        v3 a = v3_scale(e.along, 8), b = v3_sub(a, v3_scale(e.open, 8));
        scene_quad(s, black, (float)a.x, 0, (float)a.z, (float)-a.x, 0, (float)-a.z, (float)(b.x - 2 * a.x), 0,
                   (float)(b.z - 2 * a.z),
                   (float)b.x, 0, (float)b.z);
    }
    desc = scene_desc(s);
    scene = ref_create(&desc);
    CHECK(view.width * view.height <= PIXELS && sbl_set_scene(context, &desc) == SBL_SUCCESS, "%s: the scene failed",
          name);
    for (step = 0; step < steps; step++) {
        float *radiance, *error;
        e.at = v3_mad(v3_of(0, 0.5, 0), e.open, reach * (2 * step / (steps - 1.0) - 1));
        place[12] = (float)e.at.x; place[13] = (float)e.at.y; place[14] = (float)e.at.z;
        if (sbl_set_mesh_transform(context, cover, place) != SBL_SUCCESS ||
            sbl_render_picture(context, &view) != SBL_SUCCESS)
            break;
        radiance = scene_channel(context, &view, SBL_CHANNEL_RADIANCE);
        error = scene_channel(context, &view, SBL_CHANNEL_ERROR);
        for (i = 0; i < view.width * view.height; i++) {
            ref_point p = ref_pixel(scene, &view, i % view.width, i / view.width);
            double expected[3], off;
            if (!step) truth(scene, p.position, p.normal, NULL, full[i]);
            truth(scene, p.position, p.normal, &e, expected);
            off = ((double)radiance[3 * i] - expected[0]) / full[i][0];
            squares += off * off;
            predicted += (double)error[i] * (double)error[i] / (full[i][0] * full[i][0]);
            sum += off;
            if (step && !(fabs(off - before[i]) <= jump)) {
                jump = fabs(off - before[i]);
                jump_at = expected[0] / full[i][0];
            }
            before[i] = off;
            lowest = test_min(lowest, expected[0] / full[i][0]);
            highest = test_max(highest, expected[0] / full[i][0]);
            count++;
        }
        free(radiance);
        free(error);
    }
    printf("    %s: %.3f %% rms, predicted %.2f times that, mean %+.3f %%, largest jump %.3f %%, where %.1f %% is "
           "visible\n", name,
           100 * sqrt(squares / count), sqrt(predicted / squares), 100 * sum / count, 100 * jump, 100 * jump_at);
    CHECK(step == steps, "%s: step %d failed", name, step);
    CHECK(lowest < 0.05 && highest > 0.95, "%s: the sweep covers only %g to %g of the light", name, lowest, highest);
    CHECK(sqrt(squares / count) <= rms_allowed, "%s: R is off by %.3f %% rms", name, 100 * sqrt(squares / count));
    CHECK(jump <= jump_allowed, "%s: R jumps by %.3f %% where %.1f %% of the light is visible", name, 100 * jump,
          100 * jump_at);
    ref_destroy(scene);
    return sqrt(predicted / squares);
}

static void half_covered(sbl_backend backend, int plain, int steps, double rms_allowed, double jump_allowed) {
    int kind;
    for (kind = QUAD; kind <= SUN; kind++) {
        test_scene s = { 0 };
        /* half of the width of the penumbra; the patch shows a small part of it */
        double reach = kind == SUN ? 0.06 : kind == QUAD || kind == TRIANGLE ? 0.4 : 0.27;
        sbl_picture_desc view = backend == SBL_BACKEND_RASTER ? patch(1, 1, 0.01, 0, 0, 1)
            : patch(5, 4, 0.05 * reach, 0, 0, plain);
        char name[80];
        view.options.backend = backend;
        add_floor(&s);
        add_lamp(&s, kind, v3_of(0, 1, 0), kind == SUN ? sin(5 * REF_PI / 180) : 0.4);
        snprintf(name, sizeof name, "%s%s", kind_names[kind], backend ==
                 SBL_BACKEND_RASTER ? ", raster" : plain ? "" : ", default settings");
        /* the other triangles of a ball hide half of its triangles, which get half of the rays */
        sweep(name, &s, reach, view, steps, rms_allowed, (kind == BALL && plain ? 2 : 1) * jump_allowed);
        scene_free(&s);
    }
}

/* An opaque edge moves across a lamp in steps. With one look per sensor and no filter, the RMS error is at most 1.2 %
   of the unoccluded light, and the error of a pixel changes by at most 4 % from one step to the next. */
TEST(half_covered_single_looks) { half_covered(SBL_BACKEND_AUTO, 1, 50, 0.012, 0.04); }
/* With default settings, the RMS error is at most 0.16 %, and a step changes the error by at most 1.45 %. */
TEST(half_covered_default_settings) {
    half_covered(SBL_BACKEND_AUTO, 0, 10, 0.0016, 0.0145);
}

/* At an edge across a lamp, rays have smaller errors if the lamp has more strata; a thousand triangles share their
   strata. The predicted error is 0.8 to 1.25 times the true error. */
TEST(half_covered_noise_is_known) {
    static const int kinds[] = { QUAD, DISC, FINE_DISC, BALL, SPHERE, SUN };
    int i;
    for (i = 0; i < (int)(sizeof kinds / sizeof *kinds); i++) {
        test_scene s = { 0 };
        const double reach = kinds[i] == SUN ? 0.06 : kinds[i] == QUAD ? 0.4 : 0.27;
        sbl_picture_desc view = patch(5, 4, 0.05 * reach, 0, 0, 1);
        double known;
        view.options.rays = 64;
        add_floor(&s);
        add_lamp(&s, kinds[i], v3_of(0, 1, 0), kinds[i] == SUN ? sin(5 * REF_PI / 180) : 0.4);
        known = sweep(kind_names[kinds[i]], &s, 0.9 * reach, view, 60, 0.04, 0.2);
        CHECK(known > 0.8 && known < 1.25, "%s: the predicted error is %.2f times the true one", kind_names[kinds[i]],
              known);
        scene_free(&s);
    }
}

/* With rasterised sensors, the RMS error is also at most 1.2 %, and a step changes the error by at most 4 %. */
TEST(half_covered_raster) { half_covered(SBL_BACKEND_RASTER, 1, 25, 0.012, 0.04); }

/* >>textures */

/* Adds the triangles of a lamp at y = 1. kind: 'd', 'u': emits downwards or upwards; 'b', 'B': emits from both sides,
   and faces downwards or upwards. turn: which corner comes first */
static void add_plate(test_scene *s, char kind, int turn) {
    static const float corners[4][3] = { { -0.3f, 1, -0.3f }, { 0.3f, 1, -0.3f }, { 0.3f, 1, 0.3f },
                                         { -0.3f, 1, 0.3f } };
    const int lamp = scene_lamp(s, 1, 1, 1), up = kind == 'u' || kind == 'B';
    float p[12];
    int i;
    for (i = 0; i < 4; i++) memcpy(p + 3 * (up ? 3 - i : i), corners[(i + turn) % 4], sizeof corners[0]);
    if (up) {  /* keeps the diagonal */
        float last[3];
        memcpy(last, p + 9, sizeof last);
        memmove(p + 3, p, 9 * sizeof *p);
        memcpy(p, last, sizeof last);
    }
    if (kind == 'u' || kind == 'd') s->materials[lamp].flags |= SBL_MATERIAL_ONE_SIDED_EMISSION;
    scene_quad_uv(s, lamp, p, 1, 1);
}

/* Lamps with the same corners give as much light as one of them, from each side from which at least one emits. */
TEST(lamps_at_one_place) {
    static const struct { const char *plates; int down, up, lamps; } cases[] = {  /* lamps: 0: 2 or 4 */
        { "b", 1, 1, 2 }, { "bb", 1, 1, 2 }, { "bB", 1, 1, 2 }, { "Bb", 1, 1, 2 }, { "bBb", 1, 1, 2 },
        { "bbbbbbbbbbbb", 1, 1, 2 }, { "d", 1, 0, 2 }, { "dd", 1, 0, 2 }, { "du", 1, 1, 4 }, { "ud", 1, 1, 4 },
        { "db", 1, 1, 2 }, { "bd", 1, 1, 2 }, { "dub", 1, 1, 0 }, { "uu", 0, 1, 2 }
    };
    double one = 0;
    int i, k;
    for (i = 0; i < (int)(sizeof cases / sizeof *cases); i++) {
        test_scene s = { 0 };
        sbl_readings_desc desc;
        sbl_site sites[2];
        sbl_reading readings[2];
        sbl_scene_desc scene;
        memset(sites, 0, sizeof sites);
        for (k = 0; k < 2; k++) {
            sites[k].position[0] = 0.2f;
            sites[k].position[1] = k ? 1.5f : 0.5f;
            sites[k].normal[1] = k ? -1.0f : 1.0f;
        }
        for (k = 0; cases[i].plates[k]; k++) add_plate(&s, cases[i].plates[k], 2 * (k % 2));
        desc = scene_readings(sites, readings, 2, SBL_MODE_DIRECT);
        scene = scene_desc(&s);
        REQUIRE(sbl_set_scene(context, &scene) == SBL_SUCCESS && sbl_gather_readings(context, &desc) == SBL_SUCCESS,
                "no readings");
        if (i == 0) one = (double)readings[0].radiance[1];
        for (k = 0; k < 2; k++)
            CHECK(fabs((double)readings[k].radiance[1] / one - (k ? cases[i].up : cases[i].down)) < 0.001,
                  "%s: R is %.4f times that of one lamp", cases[i].plates, (double)readings[k].radiance[1] / one);
        k = sbl_query_stats(context).scene.lamps;
        CHECK(!cases[i].lamps || k == cases[i].lamps, "%s: %d lamps", cases[i].plates, k);
        scene_free(&s);
    }
}

/* A lamp whose texture is half black, or of which one half is a hole, gives half of the light. Interpolation blurs the
   border over one texel of 64, symmetrically. */
TEST(textured_lamp) {
    static float pixels[64 * 4];
    int way, i, half, holes;
    for (way = 0; way < 2; way++)
        for (half = 0; half < (way ? 2 : 3); half++) {
            test_scene s = { 0 }, bright = { 0 };
            sbl_picture_desc view = patch(way ? 4 : 24, way ? 3 : 18, 0.5, 0.05, 0.1, 1);
            float corners[12] = { -0.4f, 1, -0.3f, 0.4f, 1, -0.3f, 0.4f, 1.2f, 0.3f, -0.4f, 1.2f, 0.3f };
            double sum = 0, expected_sum = 0, squares = 0;
            sbl_scene_desc desc;
            ref_scene *scene;
            int lamp = scene_lamp(&bright, 0, 0, 0);
            view.options.backend = way ? SBL_BACKEND_RASTER : SBL_BACKEND_AUTO;
            holes = half / 2;
            for (i = 0; i < 64 * 4; i++)
                pixels[i] = (float)((i % 4 == 3) != holes || (i >= 32 * 4) == half % 2);
            add_floor(&s);
            scene_lamp(&s, 2, 1, 0.5f);
            *(holes ? &s.materials[1].albedo_texture : &s.materials[1].emission_texture) =
                scene_texture(&s, pixels, sizeof pixels, SBL_PIXELS_FLOAT, 64, 1, 4);
            s.materials[1].alpha_cutoff = holes ? 0.5f : 0;
            s.materials[1].flags = SBL_MATERIAL_HIDDEN_FROM_CAMERA;
            s.textures[0].wrap = SBL_WRAP_CLAMP;
            scene_quad_uv(&s, 1, corners, 1, 1);
            bright.materials[lamp].emission[0] = 2;
            for (i = 0; i < 4; i++) if ((corners[3 * i] > 0) != half % 2) corners[3 * i] = 0;
            scene_quad_uv(&bright, lamp, corners, 1, 1);
            desc = scene_desc(&bright);
            scene = ref_create(&desc);
            if (scene_render(context, &s, &view)) {
                float *radiance = scene_channel(context, &view, SBL_CHANNEL_RADIANCE),
                    *position = scene_channel(context, &view, SBL_CHANNEL_POSITION);
                for (i = 0; i < view.width * view.height; i++) {
                    double expected[3], off;
                    truth(scene, v3_from(position + 3 * i), v3_of(0, 1, 0), NULL, expected);
                    off = (double)radiance[3 * i] / expected[0] - 1;
                    sum += (double)radiance[3 * i];
                    expected_sum += expected[0];
                    squares += off * off;
                }
                free(radiance);
                free(position);
            }
            squares = sqrt(squares / (view.width * view.height));
            printf("    half a %s%s: mean %+.3f %%, %.3f %% rms\n", holes ? "hole" : "texture", way ? ", raster" : "",
                   100 * (sum / expected_sum - 1), 100 * squares);
            CHECK(fabs(sum / expected_sum - 1) < (way ? 0.02 : 0.002), "%s: mean R is off by %+.3f %%",
                  way ? "raster" : "traced",
                  100 * (sum / expected_sum - 1));
            CHECK(squares < (way ? 0.03 : 0.015), "%s: R is off by %.3f %% rms", way ? "raster" : "traced",
                  100 * squares);
            ref_destroy(scene);
            scene_free(&s);
            scene_free(&bright);
        }
}

/* Few rays find the bright texels of a lamp, or the parts of it that are no holes. The readings then differ, and their
   noise must tell by how much, even though no ray is blocked. */
TEST(textures_of_lamps_are_noise) {
    enum { TEXELS = 16 * 16, SITES = 256 };
    static float pixels[4 * TEXELS];
    static sbl_site sites[SITES];
    static sbl_reading readings[SITES];
    int i, holes;
    for (i = 0; i < SITES; i++) sites[i].normal[1] = 1;  /* all are at the same place, but rotated differently */
    for (holes = 0; holes < 2; holes++) {
        test_scene s = { 0 };
        sbl_scene_desc scene;
        sbl_readings_desc desc;
        sbl_material *m;
        double sum = 0, squares = 0, noise = 0;
        for (i = 0; i < 4 * TEXELS; i++)
            pixels[i] = (float)((i % 4 == 3) != holes || test_hash((uint32_t)i / 4) % 10 == 0);
        add_floor(&s);
        m = &s.materials[scene_lamp(&s, 1, 1, 1)];
        *(holes ? &m->albedo_texture : &m->emission_texture) =
            scene_texture(&s, pixels, sizeof pixels, SBL_PIXELS_FLOAT, 16, 16, 4);
        m->alpha_cutoff = holes ? 0.5f : 0;
        scene_quad(&s, 1, -0.5f, 1, -0.5f, 0.5f, 1, -0.5f, 0.5f, 1, 0.5f, -0.5f, 1, 0.5f);
        scene = scene_desc(&s);
        desc = scene_readings(sites, readings, SITES, SBL_MODE_DIRECT);
        desc.options.rays = 16;
        CHECK(sbl_set_scene(context, &scene) == SBL_SUCCESS && sbl_gather_readings(context, &desc) == SBL_SUCCESS,
              "no readings");
        for (i = 0; i < SITES; i++) {
            sum += (double)readings[i].radiance[0] / SITES;
            squares += pow((double)readings[i].radiance[0], 2) / SITES;
            noise += pow((double)readings[i].noise, 2) / SITES;
        }
        noise = sqrt(noise / (squares - sum * sum));
        printf("    %s: the predicted noise is %.2f of the true noise\n", holes ? "holes" : "a texture", noise);
        CHECK(noise > 0.8 && noise < 1.5, "a lamp with %s: the predicted noise is %.2f of the true noise",
              holes ? "holes" : "a texture", noise);
        scene_free(&s);
    }
}

/* >>sky callbacks and pictures */

/* Adds a plate that faces n, and returns a view of it. */
static sbl_picture_desc plate(test_scene *s, v3 n, int width, int height) {
    v3 u = v3_unit(v3_cross(n, v3_of(0.3, 0.2, 0.5))), v = v3_cross(n, u), a = v3_scale(v3_add(u, v), 20),
        b = v3_scale(v3_sub(u, v), 20);
    v3 eye = v3_scale(n, 3);
    sbl_picture_desc view = scene_view(width, height, 10, (float)eye.x, (float)eye.y, (float)eye.z, 0, 0, 0);
    scene_quad(s, scene_material(s, 0.5f, 0.5f, 0.5f), (float)a.x, (float)a.y, (float)a.z, (float)b.x, (float)b.y,
               (float)b.z,
               (float)-a.x, (float)-a.y, (float)-a.z, (float)-b.x, (float)-b.y, (float)-b.z);
    view.options.mode = SBL_MODE_DIRECT;
    view.tile = 1;
    view.filter_radius = -1;
    return view;
}

/* Checks the mean and the RMS of the errors of all components of R against one expected colour. */
static void check_even(const char *what, const test_scene *s, const sbl_picture_desc *view, double r, double g,
                       double b, double bias, double rms) {
    double expected[3], sum = 0, squares = 0;
    int i, count = 3 * view->width * view->height;
    expected[0] = r; expected[1] = g; expected[2] = b;
    if (!scene_render(context, s, view)) return;
    {
        float *radiance = scene_channel(context, view, SBL_CHANNEL_RADIANCE);
        for (i = 0; i < count; i++) {
            double off = (double)radiance[i] / expected[i % 3] - 1;
            sum += off;
            squares += off * off;
        }
        free(radiance);
    }
    CHECK(fabs(sum / count) < bias, "%s: mean R is off by %+.4f %%", what, 100 * sum / count);
    CHECK(sqrt(squares / count) < rms, "%s: R is off by %.4f %% rms", what, 100 * sqrt(squares / count));
}

typedef struct sky_calls { int count, odd; v3 lean; double base; } sky_calls;

/* A sky callback: base + direction . lean, and twice that in red. It counts calls whose direction is not the centre of
   a texel of a 512 x 256 picture about +y, unrotated. */
static void gradient(const float direction[3], float radiance[3], void *user) {
    sky_calls *c = (sky_calls *)user;
    v3 d = v3_from(direction);
    double light = c->base + v3_dot(d, c->lean), u = 512 * (0.5 + atan2(d.z, d.x) / (2 * REF_PI)),
        v = 256 * acos(d.y) / REF_PI;
    c->count++;
    c->odd += fabs(v3_length(d) - 1) > 1e-5 || fabs(u - floor(u) - 0.5) > 0.02 || fabs(v - floor(v) - 0.5) > 0.02;
    radiance[0] = (float)(2 * light);
    radiance[1] = radiance[2] = (float)light;
}

static const v3 plates[4] = { { 0, 1, 0 }, { 0.6, 0.8, 0 }, { 0, -0.6, 0.8 }, { -0.48, -0.64, -0.6 } };

/* A sky callback gives the closed form of a linear gradient, and is called once per texel. */
TEST(sky_by_function) {
    int i, way;
    for (way = 0; way < 2; way++)
        for (i = 0; i < 4; i++) {
            test_scene s = { 0 };
            sky_calls calls = { 0, 0, { 0, 0, 0 }, 1 };
            sbl_picture_desc view = plate(&s, plates[i], way ? 3 : 8, way ? 2 : 6);
            double r;
            view.options.backend = way ? SBL_BACKEND_RASTER : SBL_BACKEND_AUTO;
            s.environment.radiance = gradient;
            s.environment.user = &calls;
            check_even("a sky of 1", &s, &view, 2, 1, 1, 0.001, 0.002);
            CHECK(calls.count == 512 * 256 && calls.odd == 0, "%d calls, %d of them not at the centre of a texel",
                  calls.count, calls.odd);
            /* the integral of d . g cos / pi over the hemisphere is 2/3 n . g */
            calls.lean = v3_of(0.3, 0.7, -0.4);
            r = 1 + 2 * v3_dot(calls.lean, plates[i]) / 3;
            check_even("a gradient", &s, &view, 2 * r, r, r, 0.002, 0.01);
            s.environment.scale = 3;
            s.environment.up[0] = -0.4f; s.environment.up[1] = 0.2f; s.environment.up[2] = 0.7f;
            s.environment.rotation = 77;  /* changes the directions of the texels, but not the light */
            s.environment.picture.width = 300;
            s.environment.picture.height = 200;
            calls.count = 0;
            scene_sky(&s, 0.5f, 0.5f, 0.5f);
            check_even("a gradient in rotated texels", &s, &view, 6 * r + 0.5, 3 * r + 0.5, 3 * r + 0.5, 0.002, 0.01);
            CHECK(calls.count == 300 * 200, "%d calls for a picture of 300 x 200", calls.count);
            scene_free(&s);
        }
}

/* A sky picture of 1 + d . g is rotated by `rotation` about `up`, after the shortest rotation that takes +y to `up`.
   The result equals that of g rotated in the same way. */
TEST(sky_picture_rotated) {
    enum { WIDTH = 256, HEIGHT = 128 };
    static const struct { float rotation, up[3]; } poses[] = {
        { 0, { 0, 0, 0 } }, { 90, { 0, 0, 0 } }, { -30, { 0, 2, 0 } }, { 0, { 1, 0, 0 } }, { 0, { 0, 0, 1 } },
        { 50, { 0, 0, 1 } }, { 400, { 0.3f, 0.5f, -0.2f } }, { 20, { 0.1f, -0.5f, 0.2f } } };
    static float pixels[WIDTH * HEIGHT * 3];
    v3 g = v3_of(0.5, 0.35, -0.2);
    int i, k, pose, way;
    for (i = 0; i < WIDTH * HEIGHT; i++) {
        double phi = 2 * REF_PI * ((i % WIDTH + 0.5) / WIDTH - 0.5), theta = REF_PI * (i / WIDTH + 0.5) / HEIGHT;
        v3 d = v3_of(sin(theta) * cos(phi), cos(theta), sin(theta) * sin(phi));
        for (k = 0; k < 3; k++) pixels[3 * i + k] = (float)(1 + v3_dot(d, g));
    }
    for (way = 0; way < 2; way++)
        for (pose = 0; pose < (int)(sizeof poses / sizeof *poses); pose++)
            for (i = 0; i < 4; i++) {
                double a = (double)poses[pose].rotation * REF_PI / 180, cosine, r;
                v3 up = v3_from(poses[pose].up), turned, axis;
                test_scene s = { 0 };
                sbl_picture_desc view = plate(&s, plates[i], way ? 3 : 8, way ? 2 : 6);
                char name[80];
                view.options.backend = way ? SBL_BACKEND_RASTER : SBL_BACKEND_AUTO;
                s.environment.picture.pixels = pixels;
                s.environment.picture.format = SBL_PIXELS_FLOAT;
                s.environment.picture.width = WIDTH;
                s.environment.picture.height = HEIGHT;
                s.environment.picture.channels = 3;
                s.environment.rotation = poses[pose].rotation;
                memcpy(s.environment.up, poses[pose].up, sizeof poses[pose].up);
                /* counter-clockwise seen from above: x goes to -z */
                turned = v3_of(g.x * cos(a) + g.z * sin(a), g.y, g.z * cos(a) - g.x * sin(a));
                up = v3_length(up) > 0 ? v3_unit(up) : v3_of(0, 1, 0);
                /* Rodrigues' formula, with sine and cosine of the angle between +y and up */
                axis = v3_cross(v3_of(0, 1, 0), up);
                cosine = up.y;
                turned = v3_add(v3_add(v3_scale(turned, cosine), v3_cross(axis, turned)),
                                v3_scale(axis, v3_dot(axis, turned) / (1 + cosine)));
                r = 1 + 2 * v3_dot(turned, plates[i]) / 3;
                snprintf(name, sizeof name, "pose %d, plate %d%s", pose, i, way ? ", raster" : "");
                check_even(name, &s, &view, r, r, r, 0.003, 0.01);
                scene_free(&s);
            }
}

/* A bright sun of a few texels in a sky of 1, with and without a wall that casts its shadow. The picture is rotated so
   that every sun is at the same place, 28 degrees beside +x. Checks R in light and shadow. */
static void sun_in_a_picture(int number, int wall, int plain) {
    enum { WIDTH = 512, HEIGHT = 256 };
    static const int sizes[] = { 1, 2, 5, 20 };
    static float pixels[WIDTH * HEIGHT];
    int size = sizes[number], cut = size < 5 ? 8 : 3, u0 = WIDTH / 2 + 40 + 64 * number, v0 = HEIGHT / 4 - size / 2,
        counts[2] = { 0, 0 }, i, j, x, y;
    double sums[2] = { 0, 0 }, squares[2] = { 0, 0 };
    test_scene s = { 0 };
    sbl_scene_desc desc;
    ref_scene *scene;
    sbl_picture_desc view = patch(wall ? 72 : 12, 12, wall ? 2.0 / 6 : 1, wall ? 0.7 : 0, 0, plain);
    for (i = 0; i < WIDTH * HEIGHT; i++)
        pixels[i] = i % WIDTH >= u0 && i % WIDTH < u0 + size && i / WIDTH >= v0 && i / WIDTH < v0 + size ? 1e4f : 1;
    add_floor(&s);
    s.materials[0].albedo[0] = 0;
    if (wall) scene_quad(&s, 0, 2, 0, -200, 2, 0, 200, 2, 1, 200, 2, 1, -200);
    s.environment.picture.pixels = pixels;
    s.environment.picture.format = SBL_PIXELS_FLOAT;
    s.environment.picture.width = WIDTH;
    s.environment.picture.height = HEIGHT;
    s.environment.picture.channels = 1;
    s.environment.rotation = 45 * (float)number;
    desc = scene_desc(&s);
    scene = ref_create(&desc);
    if (scene_render(context, &s, &view)) {
        float *radiance = scene_channel(context, &view, SBL_CHANNEL_RADIANCE);
        for (y = 0; y < view.height; y++)
            for (x = 0; x < view.width; x++) {
                /* The wall hides the sun below the elevation atan(1 / away), and a share of the sky with a closed form;
                   see test_closed_forms. */
                double away = 2 - ref_pixel(scene, &view, x, y).position.x,
                    expected = wall ? 0.5 * (1 + away / sqrt(away * away + 1)) : 1, off;
                int lit, open = 0, cells = (size + 2) * cut;
                /* tests all parts of the texels of the sun and a border of one texel, into which interpolation may
                   spread the sun; pixels that see only some of these parts are ignored */
                for (i = 0; i < cells; i++)
                    for (j = 0; j < cells; j++) {
                        double phi = 2 * REF_PI * ((u0 - 1 + (i + 0.5) / cut) / WIDTH - 0.5 - number / 8.0);
                        double theta = REF_PI * (v0 - 1 + (j + 0.5) / cut) / HEIGHT;
                        if (wall && cos(theta) * away <= sin(theta) * cos(phi)) continue;
                        open++;
                        if (i >= cut && j >= cut && i < cells - cut && j < cells - cut)
                            expected += 9999 / REF_PI * cos(theta) * sin(theta) * (2 * REF_PI / WIDTH / cut) *
                                (REF_PI / HEIGHT / cut);
                    }
                if (open > 0 && open < cells * cells) continue;
                lit = open > 0;
                off = (double)radiance[3 * (y * view.width + x) + 1] / expected - 1;
                sums[lit] += off;
                squares[lit] += off * off;
                counts[lit]++;
            }
        free(radiance);
    }
    for (i = wall ? 0 : 1; i < 2; i++) {
        double mean = sums[i] / counts[i], rms = sqrt(squares[i] / counts[i]);
        char name[100];
        snprintf(name, sizeof name, "a sun of %d texels%s%s, %s", size, wall ? " and a wall" : "",
                 plain ? "" : ", default settings",
                 i ? "lit" : "in the shadow");
        printf("    %s: mean %+.3f %%, %.3f %% rms\n", name, 100 * mean, 100 * rms);
        CHECK(counts[i] > 30, "%s: %d pixels", name, counts[i]);
        CHECK(fabs(mean) < (plain ? 0.003 : 0.005), "%s: mean R is off by %+.3f %%", name, 100 * mean);
        /* the target error is relative to the light of the lit floor */
        CHECK(rms < (plain || !i ? 0.015 : 0.01), "%s: R is off by %.3f %% rms", name, 100 * rms);
    }
    ref_destroy(scene);
    scene_free(&s);
}

/* Suns of 1 to 20 texels are right, open and behind a wall, with and without default settings. */
TEST(sun_in_a_picture) {
    int number, way;
    for (number = 0; number < 4; number++)
        for (way = 0; way < 4; way++) sun_in_a_picture(number, way / 2, way % 2);
}

/* >>many lamps */

/* Adds 1,000 small emitting quads. up: 1: their front sides face upwards; 0: downwards */
static void ceiling(test_scene *s, uint32_t flags, int up) {
    float *corners = (float *)scene_alloc(s, sizeof(float) * 12 * 1000);
    uint32_t *indices = (uint32_t *)scene_alloc(s, sizeof(uint32_t) * 6 * 1000), order[6] = { 0, 1, 2, 0, 2, 3 };
    uint64_t seed = 1;
    int i, k, lamp = scene_lamp(s, 20, 10, 5);
    s->materials[lamp].flags = SBL_MATERIAL_HIDDEN_FROM_CAMERA | flags;
    for (i = 0; i < 1000; i++) {
        double x = (i % 40 - 19.5) / 10, z = (i / 40 - 12) / 6.0, size = 0.01 + 0.03 * ref_random(&seed);
        for (k = 0; k < 4; k++) {
            corners[12 * i + 3 * k] = (float)(x + (k == 1 || k == 2 ? size : -size));
            corners[12 * i + 3 * k + 1] = 1;
            corners[12 * i + 3 * k + 2] = (float)(z + (k >= 2 ? size : -size));
        }
        for (k = 0; k < 6; k++) indices[6 * i + k] = (uint32_t)(4 * i) + order[up ? 5 - k : k];
    }
    scene_mesh(s, lamp, corners, NULL, NULL, 4000, indices, 6000);
}

/* Scenes of up to 10,000 lamps, open or half covered, have the R of truth() without bias, with noise below 1.6 %. */
TEST(many_lamps) {
    static const char *const names[] = {
        "1,000 quads from behind", "1,000 quads, one-sided", "1,000 quads under a sky of 1",
        "a ball of 10,000 triangles", "a one-sided ball of 10,000 triangles",
        "half of 1,000 quads", "half of a ball of 10,000 triangles", "a quad under an environment of 1",
        "a ball under an environment of 1",
        "two quads and two sphere lights, one of each hidden" };
    int i;
    for (i = 0; i < 10; i++) {
        test_scene s = { 0 };
        sbl_picture_desc view = patch(32, 24, 1, 0.05, 0.1, 1);
        int covered = i == 5 || i == 6 || i == 9, ball = i == 3 || i == 4 || i == 6;
        errors error;
        edge e;
        add_floor(&s);
        if (ball) {
            int lamp = scene_lamp(&s, 2, 1, 0.5f);
            s.materials[lamp].flags = SBL_MATERIAL_HIDDEN_FROM_CAMERA |
                (i == 4 ? (uint32_t)SBL_MATERIAL_ONE_SIDED_EMISSION : 0);
            scene_sphere(&s, lamp, 0.2f, 1, 0, 0.4f, 100, 51, 0)->id = BODY;
        } else if (i == 9) {
            add_lamp(&s, QUAD, v3_of(-1.4, 1, 0.2), 0.3);
            add_lamp(&s, QUAD, v3_of(1.6, 1, 0.1), 0.3);
            add_lamp(&s, SPHERE, v3_of(-1.8, 1.2, 0.5), 0.3);
            add_lamp(&s, SPHERE, v3_of(1.5, 1.3, 1.1), 0.3);
        } else if (i > 6) {
            add_lamp(&s, i == 7 ? QUAD : BALL, v3_of(0.2, 1, 0), 0.4);
            s.environment.radiance = even;
        } else ceiling(&s, i == 1 ? SBL_MATERIAL_ONE_SIDED_EMISSION : 0, i == 0);
        if (i == 2) scene_sky(&s, 1, 1, 1);
        e.at = v3_of(0.1, 0.5, 0); e.along = v3_of(0, 0, 1); e.open = v3_of(1, 0, 0);
        if (covered) {
            int black = scene_material(&s, 0, 0, 0);
            s.materials[black].flags = SBL_MATERIAL_HIDDEN_FROM_CAMERA;
            scene_quad(&s, black, 0.1f, 0.5f, -9, 0.1f, 0.5f, 9, -9, 0.5f, 9, -9, 0.5f, -9);
        }
        error = compare(&s, &view, covered ? &e : NULL);
        printf("    %s: mean %+.3f %%, %.3f %% rms of full light\n", names[i], 100 * error.bias, 100 * error.rms);
        CHECK(covered || error.dimmest > 0.01, "%s: too little light, %g", names[i], error.dimmest);
        CHECK(fabs(error.bias) < 0.001, "%s: mean R is off by %+.3f %%", names[i], 100 * error.bias);
        CHECK(error.rms < 0.016, "%s: R is off by %.3f %% rms", names[i], 100 * error.rms);
        scene_free(&s);
    }
}

/* Returns R on the floor at (x, 0, z) of the quads of ceiling(), seen through a square hole at y = 0.5. */
static double through_hole(const float *corners, double x, double z, double low, double high) {
    enum { STEPS = 12 };
    double sum = 0;
    int i, k;
    for (i = 0; i < 1000; i++)
        for (k = 0; k < STEPS * STEPS; k++) {
            const float *c = corners + 12 * i;
            const double side = (double)c[3] - (double)c[0], dx = (double)c[0] + side * (k % STEPS + 0.5) / STEPS - x;
            const double dz = (double)c[2] + side * (k / STEPS + 0.5) / STEPS - z, d2 = dx * dx + dz * dz + 1;
            const double hx = x + 0.5 * dx, hz = z + 0.5 * dz;  /* where the ray meets the plane of the hole */
            if (hx > low && hx < high && hz > low && hz < high)
                sum += 20 * side * side / (STEPS * STEPS) / (TEST_PI * d2 * d2);
        }
    return sum;
}

/* A thousand lamps on 0.4 x 0.4 m, which are few clusters, shine through a small hole, so that a site sees a few of
   them. The first rays often find only hidden lamps. More rays must follow. */
TEST(few_of_many_lamps) {
    test_scene s = { 0 };
    sbl_picture_desc view = patch(24, 24, 0.001, 0.01, 0.01, 1);
    const float low = 0.002f, high = 0.018f, y = 0.5f, to = 9;
    sbl_scene_desc desc;
    ref_scene *scene;
    double off = 0, all = 0;
    int black, i;
    add_floor(&s);
    ceiling(&s, 0, 0);
    for (i = 0; i < 12000; i++)
        if (i % 3 != 1) ((float *)(uintptr_t)s.meshes[1].positions.data)[i] *= 0.1f;
    black = scene_material(&s, 0, 0, 0);
    s.materials[black].flags = SBL_MATERIAL_HIDDEN_FROM_CAMERA;
    scene_quad(&s, black, -to, y, -to, -to, y, to, low, y, to, low, y, -to);
    scene_quad(&s, black, high, y, -to, high, y, to, to, y, to, to, y, -to);
    scene_quad(&s, black, low, y, -to, low, y, low, high, y, low, high, y, -to);
    scene_quad(&s, black, low, y, high, low, y, to, high, y, to, high, y, high);
    view.options.rays = 256;
    view.filter_radius = -1;
    desc = scene_desc(&s);
    scene = ref_create(&desc);
    if (scene_render(context, &s, &view)) {
        float *radiance = scene_channel(context, &view, SBL_CHANNEL_RADIANCE);
        for (i = 0; i < view.width * view.height; i++) {
            const ref_point p = ref_pixel(scene, &view, i % view.width, i / view.width);
            const double expected = through_hole((const float *)s.meshes[1].positions.data, p.position.x, p.position.z,
                                                 (double)low, (double)high);
            off += fabs((double)radiance[3 * i] - expected);
            all += expected;
        }
        free(radiance);
    }
    printf("  off by %.1f %% of the light\n", 100 * off / all);
    CHECK(all > 0 && off < 0.5 * all, "R is off by %.1f %%", 100 * off / all);
    ref_destroy(scene);
    scene_free(&s);
}

/* >>shadows at every scale */

static const float scales[] = { 0.01f, 1, 1000, 100000 };

static float brightest(const test_scene *s, const sbl_picture_desc *view) {
    float most = 0, *radiance;
    int i;
    if (!scene_render(context, s, view)) return (float)HUGE_VAL;
    radiance = scene_channel(context, view, SBL_CHANNEL_RADIANCE);
    for (i = 0; i < 3 * view->width * view->height; i++) if (!(radiance[i] <= most)) most = radiance[i];
    free(radiance);
    return most;
}

static void bright(const float direction[3], float radiance[3], void *user) {
    (void)user;
    radiance[0] = radiance[1] = radiance[2] = direction[1] > 0.97f ? 1000 : 1;
}

/* Lights outside of a room from -1 to 1, close to its walls, edges and corners. */
enum { OUTSIDE = 10 };
static void outside(test_scene *s, int kind) {
    static const float places_outside[4][3] = { { 1.02f, 1.02f, 1.02f }, { 1.01f, 1.01f, 0 }, { 0.2f, 1.5f, 0 },
        { 1.3f, 0.5f, 0 } };
    int lamp = kind < 2 ? scene_lamp(s, 100, 100, 100) : 0;
    sbl_light *l;
    if (kind == 0) scene_quad(s, lamp, 1.02f, -0.5f, -0.5f, 1.02f, 0.9f, -0.5f, 1.02f, 0.9f, 0.5f, 1.02f, -0.5f, 0.5f);
    else if (kind == 1) scene_sphere(s, lamp, 0, 1.3f, 0.3f, 0.25f, 12, 8, 0);
    else if (kind == 8) {
        s->environment.radiance = bright;
        s->environment.picture.width = 64;
        s->environment.picture.height = 32;
    }
    else if (kind == 9) scene_sky(s, 10, 10, 10);
    else {
        l = scene_light(s, kind < 4 ? SBL_LIGHT_POINT : kind == 4 ? SBL_LIGHT_SPOT : kind == 5 ? SBL_LIGHT_POINT
                        : SBL_LIGHT_DIRECTIONAL, 100, 100, 100);
        if (kind < 6) memcpy(l->position, places_outside[kind - 2], sizeof l->position);
        l->direction[0] = kind == 4 ? 0 : -0.6f;
        l->direction[1] = -1;
        l->direction[2] = kind == 4 ? 0 : -0.5f;
        if (kind == 5) l->radius = 0.2f;
        if (kind == 7) l->angle = 20;
    }
}

/* A closed room of thin or thick walls is dark inside, with any light outside, at four scales. */
TEST(no_light_under_thin_walls) {
    static const char *const names[OUTSIDE] = { "quad", "ball", "point at a corner", "point at an edge", "spot",
        "sphere light", "sun without diameter", "sun",
                                                "environment", "constant sky" };
    int i, kind, thick, way;
    for (i = 0; i < 4; i++)
        for (kind = 0; kind < OUTSIDE; kind++)
            for (thick = -1; thick < 2; thick++)
                for (way = 0; way < (thick < 0 ? 1 : 2); way++) {
                    static float arrives;
                    float scale = scales[i], inside;
                    test_scene s = { 0 };
                    sbl_picture_desc view = scene_view(24, 18, 100, -0.9f * scale, 0.9f * scale, -0.9f * scale, scale,
                                                       -0.9f * scale, scale);
                    int white = scene_material(&s, 0.8f, 0.8f, 0.8f);
                    view.options.mode = SBL_MODE_DIRECT;
                    if (way) { view.tile = 1; view.filter_radius = -1; }
                    /* the floor alone, for the light that arrives without walls */
                    if (thick < 0) scene_quad(&s, white, -1, -1, -1, 1, -1, -1, 1, -1, 1, -1, -1, 1);
                    else if (thick == 0) scene_box(&s, white, -1, -1, -1, 1, 1, 1);
                    else {
                        int axis, side, k;
                        for (axis = 0; axis < 3; axis++)
                            for (side = 0; side < 2; side++) {
                                float low[3], high[3];
                                for (k = 0; k < 3; k++) { low[k] = -1.002f; high[k] = 1.002f; }
                                if (side) low[axis] = 1; else high[axis] = -1;
                                scene_box(&s, white, low[0], low[1], low[2], high[0], high[1], high[2]);
                            }
                    }
                    outside(&s, kind);
                    scene_scale_and_move(&s, scale, 0, 0, 0);
                    inside = brightest(&s, &view);
                    if (thick < 0) {
                        arrives = inside;
                        CHECK(arrives > 0.3f && arrives < 1e6f, "%s at scale %g: R without walls is %g", names[kind],
                              (double)scale, (double)arrives);
                    } else CHECK(inside <= 1e-4f * arrives, "%s at scale %g%s, %s walls: R inside is %g, without "
                                 "walls %g",
                                 names[kind], (double)scale,
                                 way ? ", a sensor a pixel" : "", thick ? "thick" : "thin", (double)inside,
                                     (double)arrives);
                    scene_free(&s);
                }
}

/* The shadow of a box or a single sheet on the floor, lit from behind, begins where it touches the floor. In every
   column, the test takes the pixel below the lowest one that shows the box. */
TEST(contact_shadows_touch) {
    int i, kind, plain, sheet, x, y;
    for (i = 0; i < 4; i++)
        for (kind = 0; kind < 6; kind++)
            for (plain = 0; plain < 2; plain++) {
                float scale = scales[i];
                test_scene s = { 0 };
                sbl_picture_desc view = scene_view(64, 48, 40, 0, 1.5f * scale, 3 * scale, 0, 0.1f * scale,
                                                   0.3f * scale);
                sbl_light *l;
                int feet = 0, lit = 0;
                view.options.mode = SBL_MODE_DIRECT;
                if (plain) { view.tile = 1; view.filter_radius = -1; }
                add_floor(&s);
                sheet = kind / 3;
                if (sheet) scene_quad(&s, 0, -0.5f, 0, 0.5f, 0.5f, 0, 0.5f, 0.5f, 0.7f, 0.5f, -0.5f, 0.7f, 0.5f);
                else scene_box(&s, 0, -0.5f, 0, -0.5f, 0.5f, 0.7f, 0.5f);
                l = scene_light(&s, kind % 3 ? SBL_LIGHT_DIRECTIONAL : SBL_LIGHT_POINT, 10, 10, 10);
                l->position[1] = 2; l->position[2] = -3;
                l->direction[1] = -1; l->direction[2] = 1;
                l->angle = kind % 3 == 2 ? 0.53f : 0;
                scene_scale_and_move(&s, scale, 0, 0, 0);
                if (scene_render(context, &s, &view)) {
                    float *radiance = scene_channel(context, &view, SBL_CHANNEL_RADIANCE),
                        *id = scene_channel(context, &view, SBL_CHANNEL_ID);
                    for (x = 0; x < view.width; x++)
                        for (y = 1; y < view.height; y++) {
                            int at = y * view.width + x;
                            lit += id[at] == 1 && radiance[3 * at] > 0.1f;
                            if (id[at] != 1 || id[at - view.width] < 2) continue;
                            /* at the corners of the box, part of the pixel may see past them */
                            if (x == 0 || x == view.width - 1 || id[at - view.width - 1] < 2 ||
                                id[at - view.width + 1] < 2) continue;
                            feet++;
                            CHECK(radiance[3 * at] < 1e-6f, "scale %g, %s and %s%s: R at the foot of column %d is %g",
                                  (double)scale, sheet ? "sheet" : "box",
                                  kind % 3 ? "sun" : "point", plain ? "" : ", default settings", x,
                                      (double)radiance[3 * at]);
                        }
                    free(radiance);
                    free(id);
                }
                CHECK(feet > 8 && lit > 200, "%d columns show the foot, %d pixels are lit", feet, lit);
                scene_free(&s);
            }
}

/* Lit surfaces without occluders have R = cosine: a plane at grazing light, and flat and smooth balls. */
TEST(no_acne) {
    int i, kind, plain, x, y;
    for (i = 0; i < 4; i++)
        for (kind = 0; kind < 4; kind++)
            for (plain = 0; plain < 2; plain++) {
                float scale = scales[i];
                test_scene s = { 0 };
                sbl_scene_desc desc;
                ref_scene *scene;
                sbl_picture_desc view = scene_view(48, 36, 40, 0, scale, 3 * scale, 0, 0, 0);
                sbl_light *l;
                double worst = 0, darkest = 1;
                int seen = 0;
                view.options.mode = SBL_MODE_DIRECT;
                if (plain) { view.tile = 1; view.filter_radius = -1; }
                if (kind == 0) add_floor(&s);
                else scene_sphere(&s, scene_material(&s, 1, 1, 1), 0, 0, 0, 0.8f, kind == 3 ? 200 : 24, kind ==
                                  3 ? 120 : 16, kind > 1);
                l = scene_light(&s, SBL_LIGHT_DIRECTIONAL, (float)REF_PI, 1, 1);
                l->direction[0] = -1;
                l->direction[1] = kind ? -0.3f : -0.02f;  /* the light meets the floor at 1.1 degrees */
                l->direction[2] = 0.2f;
                scene_scale_and_move(&s, scale, 0, 0, 0);
                desc = scene_desc(&s);
                scene = ref_create(&desc);
                if (scene_render(context, &s, &view)) {
                    float *radiance = scene_channel(context, &view, SBL_CHANNEL_RADIANCE),
                        *normal = scene_channel(context, &view, SBL_CHANNEL_NORMAL);
                    v3 d = v3_scale(v3_unit(v3_from(l->direction)), -1);
                    for (y = 0; y < view.height; y++)
                        for (x = 0; x < view.width; x++) {
                            ref_point p = ref_pixel(scene, &view, x, y);
                            double expected = v3_dot(v3_from(normal + 3 * (y * view.width + x)), d), ratio;
                            if (!p.hit || ref_is_edge(scene, &view, x, y)) continue;
                            /* Skips pixels where the sun is at or below the horizon of the geometric or the shading
                               normal: near the terminator of a coarse ball, shading normals still face the sun where
                               the triangles do not. */
                            if (kind > 0 && (v3_dot(p.face, d) < 0.02 || expected < 0.02)) continue;
                            ratio = (double)radiance[3 * (y * view.width + x)] / expected;
                            seen++;
                            worst = test_max(worst, fabs(ratio - 1));
                            darkest = test_min(darkest, ratio);
                        }
                    free(radiance);
                    free(normal);
                }
                CHECK(seen > 200, "only %d pixels are lit", seen);
                if (plain)
                    CHECK(worst < 0.002, "scale %g, case %d: R is off by %.3f %%, darkest %.3f", (double)scale, kind,
                          100 * worst, darkest);
                else CHECK(darkest > 0.8, "scale %g, case %d, default settings: R is %.3f of the expected value",
                           (double)scale, kind, darkest);
                ref_destroy(scene);
                scene_free(&s);
            }
}

/* >>conservation of energy */

/* Returns the sum of E * area over the six sides of a box around the origin, seen from inside or outside. A camera in
   front of the centre of each side renders all of it, so that the pixels form an even grid on it. */
static double arriving(const test_scene *s, v3 half, int from_outside, int across) {
    double sum = 0;
    sbl_scene_desc desc = scene_desc(s);
    int side, i;
    CHECK(sbl_set_scene(context, &desc) == SBL_SUCCESS, "the scene failed");
    for (side = 0; side < 6; side++) {
        double sign = side & 1 ? 1 : -1;
        int axis = side / 2;
        double width = 2 * (axis == 0 ? half.z : half.x), height = 2 * (axis == 1 ? half.z : half.y), mean = 0;
        float d[3] = { 0, 0, 0 }, eye = from_outside ? 3 : 0;
        sbl_picture_desc view;
        float *radiance;
        d[axis] = (float)sign;
        view = scene_view(across, across, 40, eye * d[0], eye * d[1], eye * d[2], (3 - eye) * d[0], (3 - eye) * d[1],
                          (3 - eye) * d[2]);
        sbl_perspective(view.view_to_clip,
                        (float)(360 / REF_PI * atan(height / 2 / fabs((double)eye - v3_axis(half, axis)))),
                        (float)(width / height));
        view.options.mode = SBL_MODE_DIRECT;
        view.tile = 1;
        view.filter_radius = -1;
        view.samples = 1;
        if (sbl_render_picture(context, &view) != SBL_SUCCESS) return NAN;
        CHECK(sbl_query_stats(context).picture.visible_pixels == across * across, "side %d is seen by %d of %d pixels",
              side, sbl_query_stats(context).picture.visible_pixels, across * across);
        radiance = scene_channel(context, &view, SBL_CHANNEL_RADIANCE);
        for (i = 0; i < across * across; i++) mean += (double)radiance[3 * i] / (across * across);
        free(radiance);
        sum += REF_PI * mean * width * height;
    }
    return sum;
}

/* Returns the flux of red light that leaves the lamps of the scene, from their areas and intensities. */
static double leaving(const test_scene *s) {
    sbl_scene_desc desc = scene_desc(s);
    ref_scene *scene = ref_create(&desc);
    double sum = 0;
    int i, k;
    for (i = 0; i < scene->triangle_count; i++) {
        const ref_triangle *t = &scene->triangles[i];
        const sbl_mesh *mesh = &desc.meshes[t->mesh];
        const sbl_material *m = &desc.materials[mesh->material];
        double area = 0.5 * v3_length(v3_cross(v3_sub(t->p[1], t->p[0]), v3_sub(t->p[2], t->p[0])));
        sum += REF_PI * area * (double)m->emission[0] *
            ((m->flags & SBL_MATERIAL_ONE_SIDED_EMISSION) || mesh->id == BODY ? 1 : 2);
    }
    for (i = 0; i < desc.light_count; i++) {
        const sbl_light *l = &desc.lights[i];
        if (l->kind == SBL_LIGHT_POINT) sum += 4 * REF_PI * (double)l->intensity[0];
        /* sums over rings about the axis, of equal height on the unit sphere */
        for (k = 0; l->kind == SBL_LIGHT_SPOT && k < 100000; k++) {
            double cosine = 1 - 2 * (k + 0.5) / 100000;
            v3 axis = v3_unit(v3_from(l->direction)), aside = v3_unit(v3_cross(axis, v3_of(0.1, 0.7, 0.2)));
            v3 d = v3_add(v3_scale(axis, cosine), v3_scale(aside, sqrt(1 - cosine * cosine)));
            sum += 4 * REF_PI / 100000 * (double)l->intensity[0] * spot_share(l, d);
        }
    }
    ref_destroy(scene);
    return sum;
}

/* Returns the flux that the black lamps absorb from each other. No lamp may be between two others. */
static double swallowed(const test_scene *s) {
    enum { CUT = 12 };
    sbl_scene_desc desc = scene_desc(s);
    ref_scene *scene = ref_create(&desc);
    double sum = 0, rgb[3];
    int t, i, j, side;
    for (t = 0; t < scene->triangle_count; t++) {
        const ref_triangle *tri = &scene->triangles[t];
        v3 u = v3_sub(tri->p[1], tri->p[0]), v = v3_sub(tri->p[2], tri->p[0]), twice = v3_cross(u, v),
            n = v3_unit(twice);
        if (desc.materials[desc.meshes[tri->mesh].material].emission[0] <= 0) continue;
        for (side = 0; side < (desc.meshes[tri->mesh].id == BODY ? 1 : 2); side++, n = v3_scale(n, -1))
            for (i = 0; i < CUT; i++)
                for (j = 0; j < CUT; j++) {
                    double a = (i + 0.5) / CUT, b = (j + 0.5) / CUT;
                    if (a + b > 1) { a = 1 - a; b = 1 - b; }
                    /* slightly in front of the triangle, so that it does not light itself */
                    truth(scene, v3_mad(v3_add(tri->p[0], v3_add(v3_scale(u, a), v3_scale(v, b))), n, 1e-7), n, NULL,
                          rgb);
                    sum += REF_PI * rgb[0] * v3_length(twice) / 2 / (CUT * CUT);
                }
    }
    ref_destroy(scene);
    return sum;
}

/* In a closed box of 2 x 1.6 x 1.2, the flux that arrives at the walls equals the flux that leaves the lamps. */
TEST(energy_in_a_box) {
    static const char *const names[] = { "quad", "one-sided quad", "ball", "point light", "sphere light", "spot light",
        "wide spot light",
                                         "a mixture of all" };
    int kind, k;
    for (kind = 0; kind < 8; kind++) {
        test_scene s = { 0 };
        double out, lost, in;
        scene_box(&s, scene_material(&s, 0.5f, 0.5f, 0.5f), -1, -0.8f, -0.6f, 1, 0.8f, 0.6f);
        for (k = 0; k < 7; k++) {
            if (k != kind && kind != 7) continue;
            if (k < 3) {
                int lamp = scene_lamp(&s, 3 + (float)k, 1, 1);
                s.materials[lamp].flags = SBL_MATERIAL_HIDDEN_FROM_CAMERA |
                    (k == 1 ? (uint32_t)SBL_MATERIAL_ONE_SIDED_EMISSION : 0);
                if (k == 2) scene_sphere(&s, lamp, 0.4f, -0.1f, 0.1f, 0.15f, 16, 9, 0)->id = BODY;
                else if (k == 1)
                    scene_quad(&s, lamp, -0.7f, -0.3f, 0.1f, -0.6f, -0.2f, -0.2f, -0.4f, -0.4f, -0.2f, -0.5f, -0.5f,
                               0.1f);
                else scene_quad(&s, lamp, -0.2f, 0.1f, 0.1f, -0.2f, 0.1f, -0.2f, 0.1f, 0.2f, -0.2f, 0.1f, 0.2f, 0.1f);
            } else {
                sbl_light *l = scene_light(&s, k < 5 ? SBL_LIGHT_POINT : SBL_LIGHT_SPOT, 0.3f, 1, 1);
                l->position[0] = 0.2f * (float)k - 1; l->position[1] = 0.45f; l->position[2] = 0.1f * (float)k - 0.5f;
                l->direction[0] = 1; l->direction[1] = -2; l->direction[2] = 0.5f;
                if (k == 4) l->radius = 0.2f;
                if (k == 5) { l->cone = 50; l->inner_cone = 20; }
                if (k == 6) { l->cone = 180; l->inner_cone = 90; }
            }
        }
        out = leaving(&s);
        lost = kind == 7 ? swallowed(&s) : 0;
        in = arriving(&s, v3_of(1, 0.8, 0.6), 0, 32);
        printf("    %s: flux %.4f leaves, %.4f reaches other lamps, the walls get %+.3f %% too much\n", names[kind],
               out, lost,
               100 * ((in + lost) / out - 1));
        CHECK(fabs((in + lost) / out - 1) < (kind == 7 ? 0.004 : 0.0007),
              "%s: flux %.5f leaves, %.5f reaches other lamps, %.5f arrives", names[kind], out, lost, in);
        scene_free(&s);
    }
}

/* Distant light: a box of edges a, b, c shows the area bc |x| + ca |y| + ab |z| in the direction (x, y, z). The
   radiance times this area, integrated over all directions, arrives at the six sides. */
TEST(energy_from_afar) {
    enum { WIDTH = 128, HEIGHT = 64, CUT = 4 };
    static const char *const names[] = { "sun without diameter", "sun", "environment", "a mixture of all" };
    static float pixels[WIDTH * HEIGHT * 3];
    v3 half = v3_of(1, 0.8, 0.6), area = v3_of(4 * 0.8 * 0.6, 4 * 0.6 * 1, 4 * 1 * 0.8);
    int kind, i;
    for (kind = 0; kind < 4; kind++) {
        test_scene s = { 0 };
        double in, total = 0;
        scene_box(&s, scene_material(&s, 0.5f, 0.5f, 0.5f), -1, -0.8f, -0.6f, 1, 0.8f, 0.6f);
        for (i = 0; i < 2; i++) {
            sbl_light *l;
            v3 d;
            if (kind != i && kind != 3) continue;
            l = scene_light(&s, SBL_LIGHT_DIRECTIONAL, 2 - (float)i, 1, 1);
            l->direction[0] = -1; l->direction[1] = i ? 0.8f : -2; l->direction[2] = 0.7f;
            l->angle = i ? 20 : 0;
            d = v3_unit(v3_from(l->direction));
            total += (double)l->intensity[0] * (area.x * fabs(d.x) + area.y * fabs(d.y) + area.z * fabs(d.z));
        }
        if (kind >= 2) {
            uint64_t seed = 5;
            for (i = 0; i < WIDTH * HEIGHT; i++) {
                int x = i % WIDTH, y = i / WIDTH, j;
                double sun = x >= 40 && x < 43 && y >= 20 && y < 23 ? 3000 : 0;
                pixels[3 * i] = (float)(ref_random(&seed) * (1 + sin(x / 20.0) * cos(y / 9.0)) + sun);
                for (j = 0; j < CUT * CUT; j++) {
                    double phi = 2 * REF_PI * ((x + (j % CUT + 0.5) / CUT) / WIDTH - 0.5),
                        theta = REF_PI * (y + (j / CUT + 0.5) / CUT) / HEIGHT;
                    double shown = area.x * fabs(sin(theta) * cos(phi)) + area.y * fabs(cos(theta)) + area.z *
                        fabs(sin(theta) * sin(phi));
                    total += (double)pixels[3 * i] * shown * sin(theta) * 2 * REF_PI / WIDTH * REF_PI / HEIGHT /
                        (CUT * CUT);
                }
            }
            s.environment.picture.pixels = pixels;
            s.environment.picture.format = SBL_PIXELS_FLOAT;
            s.environment.picture.width = WIDTH;
            s.environment.picture.height = HEIGHT;
            s.environment.picture.channels = 3;
        }
        in = arriving(&s, half, 1, 16);
        printf("    %s: flux %.4f, the walls get %+.3f %% too much\n", names[kind], total, 100 * (in / total - 1));
        CHECK(fabs(in / total - 1) < 0.0007, "%s: flux %.5f, %.5f arrives", names[kind], total, in);
        scene_free(&s);
    }
}

/* In SBL_MODE_PAPER, only emitting surfaces give light; sbl_lights and the environment give none. */
TEST(only_surfaces_emit_in_paper_mode) {
    test_scene s = { 0 };
    sbl_picture_desc view = patch(4, 3, 0.5, 0, 0, 1);
    add_floor(&s);
    add_lamp(&s, SPHERE, v3_of(0, 1, 0), 0.3);
    add_lamp(&s, SUN, v3_of(0, 1, 0), 0.3);
    s.environment.radiance = bright;
    CHECK(brightest(&s, &view) > 1, "the scene is dark in direct mode, too");
    view.options.mode = SBL_MODE_PAPER;
    view.options.epsilon = 1e-6f;
    CHECK(brightest(&s, &view) < 1e-5f, "lights give light in paper mode: %g", (double)brightest(&s, &view));
    scene_free(&s);
}

/* Many rays to a lamp are traced in several passes, which mostly end when the rays of the first pass agree. A sensor
   sees a hundredth of a lamp through a hole, or all but a hundredth. The mean over many such sensors is the closed
   form, and their noise agrees with the prediction, although most first passes find the lamp completely blocked or
   completely open. */
TEST(few_rays_that_differ_are_not_lost) {
    enum { SENSORS = 8192 };
    sbl_site *sites = (sbl_site *)calloc(SENSORS, sizeof *sites);
    sbl_reading *readings = (sbl_reading *)calloc(SENSORS, sizeof *readings);
    const v3 up = v3_of(0, 1, 0), origin = v3_of(0, 0, 0);
    const v3 part[4] = { v3_of(0.4, 2, 0.2), v3_of(0.6, 2, 0.2), v3_of(0.6, 2, 0.4), v3_of(0.4, 2, 0.4) };
    const v3 lamp[4] = { v3_of(-1, 2, -1), v3_of(1, 2, -1), v3_of(1, 2, 1), v3_of(-1, 2, 1) };
    int open, i;
    for (i = 0; i < SENSORS; i++) sites[i].normal[1] = sites[i].geometric_normal[1] = 1;
    for (open = 0; open < 2; open++) {
        const double seen = ref_polygon(origin, up, part, 4), whole = ref_polygon(origin, up, lamp, 4);
        const double expected = open ? whole - seen : seen;
        test_scene s = { 0 };
        sbl_readings_desc desc;
        sbl_scene_desc scene;
        double mean = 0, squares = 0, variance = 0;
        scene_quad(&s, scene_lamp(&s, 1, 1, 1), -1, 2, -1, 1, 2, -1, 1, 2, 1, -1, 2, 1);
        if (!open) scene_plate_with_hole(&s);
        else scene_quad(&s, scene_material(&s, 0, 0, 0), 0.2f, 1, 0.1f, 0.3f, 1, 0.1f, 0.3f, 1, 0.2f, 0.2f, 1, 0.2f);
        scene = scene_desc(&s);
        desc = scene_readings(sites, readings, SENSORS, SBL_MODE_DIRECT);
        desc.options.backend = SBL_BACKEND_TRACE;
        desc.options.rays = 256;
        CHECK(sbl_set_scene(context, &scene) == SBL_SUCCESS && sbl_gather_readings(context, &desc) == SBL_SUCCESS,
              "the readings fail");
        for (i = 0; i < SENSORS; i++) {
            mean += (double)readings[i].radiance[0] / SENSORS;
            squares += (double)readings[i].radiance[0] * (double)readings[i].radiance[0] / SENSORS;
            variance += (double)readings[i].noise * (double)readings[i].noise / SENSORS;
        }
        CHECK(fabs(mean - expected) < 0.1 * seen, "%s: mean R is %.6f, not %.6f", open ? "almost open"
              : "almost hidden", mean, expected);
        squares -= mean * mean;
        CHECK(fabs(log(variance / squares)) < 0.3, "%s: the variance is %.3g, predicted %.3g", open ? "almost open"
              : "almost hidden", squares, variance);
        scene_free(&s);
    }
    free(sites);
    free(readings);
}

int main(void) {
    if (sbl_create(NULL, &context) != SBL_SUCCESS) { printf("no context\n0 passed, 1 failed, 0 skipped\n"); return 1; }
    RUN(formulas_against_quadrature);
    RUN(fully_visible);
    RUN(fully_visible_default_settings);
    RUN(fully_visible_raster);
    RUN(spot_cones);
    RUN(spots_that_miss);
    RUN(disc_and_sphere_overhead);
    RUN(small_lights_on_the_horizon);
    RUN(floors_inside_a_light);
    RUN(half_covered_single_looks);
    RUN(half_covered_default_settings);
    RUN(half_covered_noise_is_known);
    RUN(half_covered_raster);
    RUN(lamps_at_one_place);
    RUN(textured_lamp);
    RUN(textures_of_lamps_are_noise);
    RUN(sky_by_function);
    RUN(sky_picture_rotated);
    RUN(sun_in_a_picture);
    RUN(many_lamps);
    RUN(few_of_many_lamps);
    RUN(no_light_under_thin_walls);
    RUN(contact_shadows_touch);
    RUN(no_acne);
    RUN(energy_in_a_box);
    RUN(energy_from_afar);
    RUN(only_surfaces_emit_in_paper_mode);
    RUN(few_rays_that_differ_are_not_lost);
    sbl_destroy(context);
    return test_report();
}
