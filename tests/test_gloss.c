/* Tests surfaces that are not matte: metal, gloss, panes and blended surfaces. The expected values come from lobe.h, a
   quadrature of the material model of glTF in double precision, and from the Fresnel term. */
#include "../sbl.h"
#include "support/test.h"
#include "support/scenes.h"
#include "support/gl_watch.h"
#include "support/inside.h"
#include "support/lobe.h"

static watch seen;
static sbl_context *context;

/* >>helpers */

static void set3(double *out, double x, double y, double z) { out[0] = x; out[1] = y; out[2] = z; }
static double unit(double v[3]) {
    const double length = sqrt(lobe__dot(v, v));
    int k;
    for (k = 0; k < 3; k++) v[k] /= length;
    return length;
}

/* Converts a vector to the frame of lobe.h, whose normal is z, for a surface whose normal is y. */
static void stand_up(const float *v, double out[3]) { set3(out, (double)v[0], (double)v[2], (double)v[1]); }

/* Adds a material with reflections and the index of refraction 1.5. Returns its index. */
static int scene_gloss(test_scene *s, double red, double green, double blue, double metallic, double roughness) {
    const int number = scene_material(s, (float)red, (float)green, (float)blue);
    s->materials[number].ior = 1.5f;
    s->materials[number].metallic = (float)metallic;
    s->materials[number].roughness = (float)roughness;
    return number;
}

/* Adds a thin, smooth pane of glass. Returns its index. */
static int scene_pane(test_scene *s, double red, double green, double blue, double transmission) {
    const int number = scene_gloss(s, red, green, blue, 0, 0);
    s->materials[number].transmission = (float)transmission;
    return number;
}

/* Gives a mesh a coverage: sets the alpha of its vertices, and the flag of its material. */
static void scene_blend(test_scene *s, sbl_mesh *mesh, float alpha) {
    float *colors = (float *)scene_alloc(s, 16 * sizeof(float) * (size_t)mesh->vertex_count);
    int i;
    for (i = 0; i < 4 * mesh->vertex_count; i++) colors[i] = i % 4 < 3 ? 1 : alpha;
    mesh->colors.data = colors;
    s->materials[mesh->material].flags |= SBL_MATERIAL_BLEND;
}

/* A picture and its channels, which are read on first use. */
typedef struct shot { sbl_picture_desc view; sbl_context *context; float *channels[SBL_CHANNEL_COUNT]; } shot;

static int shoot(shot *p, const test_scene *s, const sbl_picture_desc *view) {
    memset(p, 0, sizeof *p);
    p->view = *view;
    p->context = context;
    return scene_render(context, s, view);
}

static void forget(shot *p) {
    int i;
    for (i = 0; i < SBL_CHANNEL_COUNT; i++) free(p->channels[i]);
    memset(p, 0, sizeof *p);
}

static const float *at(shot *p, sbl_channel channel, int x, int y) {
    const int n = sbl_channel_components(channel) > 1 ? 3 : 1;
    if (!p->channels[channel]) p->channels[channel] = scene_channel(p->context, &p->view, channel);
    return p->channels[channel] + n * (y * p->view.width + x);
}

/* Computes the unit vector along which the camera looks through the centre of a pixel. */
static void look(const sbl_picture_desc *view, int x, int y, double out[3]) {
    const float *m = view->world_to_view, *c = view->view_to_clip;
    double way[3] = { 0, 0, -1 };
    int k;
    if (c[11] < 0) {
        way[0] = ((2 * x + 1.0) / view->width - 1) / (double)c[0];
        way[1] = (1 - (2 * y + 1.0) / view->height) / (double)c[5];
    }
    for (k = 0; k < 3; k++)
        out[k] = (double)m[4 * k] * way[0] + (double)m[4 * k + 1] * way[1] + (double)m[4 * k + 2] * way[2];
    unit(out);
}

static double cosine_at(shot *p, int x, int y) {
    const float *normal = at(p, SBL_CHANNEL_NORMAL, x, y);
    double way[3];
    look(&p->view, x, y, way);
    return -((double)normal[0] * way[0] + (double)normal[1] * way[1] + (double)normal[2] * way[2]);
}

/* Returns the light that the lobe of a pixel reflects in one channel. */
static double reflected(shot *p, int x, int y, int k) {
    return (double)at(p, SBL_CHANNEL_SPECULAR_ALBEDO, x, y)[k] * (double)at(p, SBL_CHANNEL_SPECULAR, x, y)[k];
}

static double mean_reflected(shot *p, int k) {
    const int count = p->view.width * p->view.height;
    double sum = 0;
    int i;
    for (i = 0; i < count; i++) sum += reflected(p, i % p->view.width, i / p->view.width, k) / count;
    return sum;
}

/* Returns a view with a sensor at each pixel and no filter. The camera sees the origin from a distance of 4, at an
   angle to y. */
static sbl_picture_desc view_of_plate(int width, int height, double fov, double degrees, int rays) {
    const double angle = degrees * TEST_PI / 180;
    sbl_picture_desc view = scene_plain(scene_view(width, height, (float)fov, (float)(4 * sin(angle)),
                                                   (float)(4 * cos(angle)), 0, 0, 0, 0), SBL_MODE_DIRECT, 0);
    view.options.rays = rays;
    return view;
}

/* Returns an orthographic view of a ball of radius 1 around the origin. */
static sbl_picture_desc view_of_ball(int side, int rays) {
    sbl_picture_desc view = scene_plain(scene_view(side, side, 40, 0, 0, 4, 0, 0, 0), SBL_MODE_DIRECT, 0);
    memset(view.view_to_clip, 0, sizeof view.view_to_clip);
    view.view_to_clip[0] = view.view_to_clip[5] = 1;
    view.view_to_clip[10] = -0.2f;
    view.view_to_clip[14] = -1;
    view.view_to_clip[15] = 1;
    view.options.rays = rays;
    return view;
}

/* >>silhouettes */

/* Adds a box from -half to half with bevelled edges, turned about the y axis. Each corner has three vertices, one per
   face. Flat faces have flat normals. */
static void scene_bevelled(test_scene *s, int material, float half, float bevel, float turn) {
    float positions[72], normals[72] = { 0 };
    uint32_t corners[3 * 44];
    int count = 0, c, a, k;
    for (c = 0; c < 8; c++)
        for (a = 0; a < 3; a++) {
            float *p = positions + 9 * c + 3 * a, *n = normals + 9 * c + 3 * a, x;
            for (k = 0; k < 3; k++) p[k] = (c >> k & 1 ? 1.0f : -1.0f) * (half - (k == a ? 0 : bevel));
            n[a] = c >> a & 1 ? 1.0f : -1.0f;
            for (k = 0; k < 2; k++, p = n) {
                x = cosf(turn) * p[0] + sinf(turn) * p[2];
                p[2] = cosf(turn) * p[2] - sinf(turn) * p[0];
                p[0] = x;
            }
        }
    for (a = 0; a < 3; a++)
        for (k = 0; k < 4; k++) {  /* a quad along an edge and, for two of four, a face */
            const int u = 1 << (a + 1) % 3, w = 1 << (a + 2) % 3;
            const int from = (k & 1 ? u : 0) | (k & 2 ? w : 0), face = k & 1 ? 1 << a : 0;
            const int edge[4] = { 3 * from + (a + 1) % 3, 3 * from + (a + 2) % 3,
                                  3 * (from | 1 << a) + (a + 2) % 3, 3 * (from | 1 << a) + (a + 1) % 3 };
            const int flat[4] = { 3 * face + a, 3 * (face | u) + a, 3 * (face | u | w) + a, 3 * (face | w) + a };
            int i;
            for (i = 0; i < 6; i++) corners[count++] = (uint32_t)edge[i < 3 ? i : i == 3 ? 0 : i - 2];
            for (i = 0; i < 6 && k < 2; i++) corners[count++] = (uint32_t)flat[i < 3 ? i : i == 3 ? 0 : i - 2];
        }
    for (c = 0; c < 24; c++) corners[count++] = (uint32_t)c;
    for (c = 0; c < count; c += 3) {  /* all triangles face outwards */
        const float *p = positions + 3 * corners[c], *q = positions + 3 * corners[c + 1],
            *r = positions + 3 * corners[c + 2];
        const float out = p[0] * (q[1] * r[2] - q[2] * r[1]) + p[1] * (q[2] * r[0] - q[0] * r[2]) +
                          p[2] * (q[0] * r[1] - q[1] * r[0]);
        const uint32_t second = corners[c + 1];
        if (out < 0) corners[c + 1] = corners[c + 2], corners[c + 2] = second;
    }
    scene_mesh(s, material, positions, normals, NULL, 24, corners, count);
}

/* Every pixel of a white mirror with fine bevels in a white furnace has the value 1. The rasteriser finds a triangle
   beside the centre of some pixels at the silhouette, whose back or whose other end the ray must not show. */
TEST(silhouettes_of_mirrors_are_white) {
    enum { SIDE = 48 };
    static const struct { float bevel, away, turn; } cases[] = {
        { 0.0005f, 40, 0.01f * 5 }, { 0.002f, 150, 0.01f * 42 }, { 0.002f, 150, 0.01f * 54 },
        { 0.0005f, 150, 0.01f * 156 }
    };
    int i, k;
    for (i = 0; i < (int)(sizeof cases / sizeof *cases); i++) {
        const float away = cases[i].away;
        const sbl_picture_desc view = scene_plain(scene_view(SIDE, SIDE, 160 / away, 0.6f * away, 0.2f * away,
                                                             0.77f * away, 0, 0, 0), SBL_MODE_DIRECT, 0);
        test_scene s = { 0 };
        shot p;
        scene_sky(&s, 1, 1, 1);
        scene_bevelled(&s, scene_gloss(&s, 1, 1, 1, 1, 0), 0.7f, cases[i].bevel, cases[i].turn);
        if (!shoot(&p, &s, &view)) return;
        for (k = 0; k < SIDE * SIDE; k++) {
            const double shown = (double)at(&p, SBL_CHANNEL_FINAL, k % SIDE, k / SIDE)[1];
            CHECK(fabs(shown - 1) < 1e-3, "case %d: pixel %d %d shows %.4f", i, k % SIDE, k / SIDE, shown);
        }
        forget(&p);
        scene_free(&s);
    }
}

/* >>furnaces */

enum { ANGLES = 48 };

/* Computes a table over the cosine of the view angle: the share of light that a white surface of index 1.5, or a metal,
   reflects. */
static void furnace_table(double roughness, int metal, double table[ANGLES + 1]) {
    int i;
    for (i = 0; i <= ANGLES; i++) {
        const double mu = test_max(0.01, (double)i / ANGLES);
        table[i] = lobe__albedo(mu, roughness < 0.05 ? 1e-3 : roughness, metal ? 1 : 0.04, 160);
        if (roughness < 0.05 && !metal) table[i] = lobe__fresnel(mu, 0.04);
        if (!metal) table[i] += 0.96 * lobe_matte(mu);
    }
}

static double look_up(const double table[ANGLES + 1], double mu) {
    const int i = mu * ANGLES < ANGLES - 1 ? (int)(mu * ANGLES) : ANGLES - 1;
    return table[i] + (mu * ANGLES - i) * (table[i + 1] - table[i]);
}

/* Balls in a uniform sky of radiance 1 show their albedo, on average and at each angle. Their normals are smooth, even
   if their triangles are as small as pixels, unless the balls are rough. */
static void furnace(double roughness, int metal, double whole) {
    enum { BINS = 8, SIDE = 96 };
    double table[ANGLES + 1], sums[BINS] = { 0 }, expected[BINS] = { 0 }, mean = 0, count = 0, across = 0;
    test_scene s = { 0 };
    sbl_picture_desc view = view_of_ball(SIDE, 96);
    shot p;
    int i;
    view.facet_limit = 2;
    furnace_table(roughness, metal, table);
    scene_sky(&s, 1, 1, 1);
    scene_sphere(&s, scene_gloss(&s, 1, 1, 1, metal, roughness), 0, 0, 0, 1, 128, 64, 1);
    if (!shoot(&p, &s, &view)) return;
    for (i = 0; i < SIDE * SIDE; i++) {
        const int x = i % SIDE, y = i / SIDE;
        const double shown = (double)at(&p, SBL_CHANNEL_FINAL, x, y)[1], mu = cosine_at(&p, x, y);
        const float *normal = at(&p, SBL_CHANNEL_NORMAL, x, y);
        if (at(&p, SBL_CHANNEL_ID, x, y)[0] <= 0) continue;
        across = test_max(across, fabs((double)normal[0] - (2 * x + 1.0) / SIDE + 1));
        mean += shown;
        count++;
        if (mu < 1.0 / BINS) continue;
        sums[(int)test_min(BINS * mu, BINS - 1)] += shown;
        expected[(int)test_min(BINS * mu, BINS - 1)] += look_up(table, mu);
    }
    mean /= count;
    printf("    roughness %.1f, %s: mean %.4f of %.4f;", roughness, metal ? "metal" : "plastic", mean, whole);
    for (i = 1; i < BINS; i++) printf(" %+.2f", 100 * (sums[i] / expected[i] - 1));
    printf(" %% by angle\n");
    CHECK(roughness < 0.6 ? across < 0.002 : across > 0.01, "roughness %g: normals are off by %.4f", roughness, across);
    CHECK(whole <= 0 || fabs(mean / whole - 1) < 0.005, "roughness %g: mean %.4f, not %.4f", roughness, mean, whole);
    for (i = 1; i < BINS; i++)
        CHECK(fabs(sums[i] / expected[i] - 1) < 0.005, "roughness %g, metal %d, cosine %.2f: %.4f times as bright",
              roughness, metal, (i + 0.5) / BINS, sums[i] / expected[i]);
    forget(&p);
    scene_free(&s);
}

TEST(furnace_of_metal) {
    furnace(0.3, 1, 0.976);
    furnace(0.6, 1, 0.803);
    furnace(1, 1, 0.409);
}

TEST(furnace_of_plastic) {
    furnace(0, 0, 0);
    furnace(0.3, 0, 0);
    furnace(1, 0, 0);
}

/* >>albedo */

/* SBL_CHANNEL_SPECULAR_ALBEDO and ALBEDO are right for metals and plastics of five roughnesses, seen at five angles. */
TEST(albedo_of_lobes) {
    static const double angles[5] = { 2, 30, 55, 75, 84 }, roughness[5] = { 0.09, 0.2, 0.4, 0.7, 1 };
    enum { PLATES = 15 };
    double worst = 0, worst_matte = 0;
    test_scene s = { 0 };
    int i, j, k;
    for (i = 0; i < PLATES; i++) {
        const float x = 0.1f * (float)(i - 7);
        const int number = i % 3 == 0 ? scene_gloss(&s, 1, 0.7, 0.3, 1, roughness[i / 3])
            : scene_gloss(&s, 0.9, 0.5, 0.1, i % 3 == 1 ? 0 : 0.5, roughness[i / 3]);
        sbl_mesh *plate = scene_quad(&s, number, -1, 0, x - 0.05f, -1, 0, x + 0.05f, 1, 0, x + 0.05f, 1, 0, x - 0.05f);
        plate->id = (uint32_t)i + 1;
        if (i % 3 != 1) s.materials[number].ior = i % 6 == 2 ? 2 : 0;  /* metal, also partial: an ior of 0 means 1.5 */
    }
    for (j = 0; j < 5; j++) {
        sbl_picture_desc view = view_of_plate(45, 1, 0.476, angles[j], 1);
        shot p;
        if (!shoot(&p, &s, &view)) continue;
        for (i = 0; i < PLATES; i++) {
            const int x = 3 * i + 1, id = (int)at(&p, SBL_CHANNEL_ID, x, 0)[0] - 1;
            const float *got = at(&p, SBL_CHANNEL_SPECULAR_ALBEDO, x, 0), *matte = at(&p, SBL_CHANNEL_ALBEDO, x, 0);
            const double mu = cosine_at(&p, x, 0), ior = id % 6 == 2 ? 2 : 1.5;
            const double f0 = (ior - 1) * (ior - 1) / ((ior + 1) * (ior + 1)), rest = lobe_matte(mu);
            double black, white;
            REQUIRE(id >= 0 && id < PLATES, "no plate at pixel %d", x);
            black = lobe__albedo(mu, roughness[id / 3], 0, 256);
            white = lobe__albedo(mu, roughness[id / 3], 1, 256);
            for (k = 0; k < 3; k++) {
                const sbl_material *m = &s.materials[id];
                const double metal = (double)m->metallic, base = (double)m->albedo[k];
                const double front = metal * base + (1 - metal) * f0, wanted = black + front * (white - black);
                worst = test_max(worst, fabs((double)got[k] - wanted));
                CHECK(fabs((double)got[k] - wanted) < 0.003, "plate %d at %g degrees: colour %d of the lobe has the "
                      "albedo %.4f, not %.4f", id, angles[j], k, (double)got[k], wanted);
                worst_matte = test_max(worst_matte, fabs((double)matte[k] - base * (1 - metal) * (1 - f0) * rest));
            }
        }
        forget(&p);
    }
    printf("    largest error %.5f of lobes, %.5f of diffuse parts\n", worst, worst_matte);
    CHECK(worst_matte < 0.0005, "the diffuse part is off by %.5f", worst_matte);
    scene_free(&s);
}

/* The green channel of the texture multiplies the roughness, and the blue channel multiplies metallic; red has no
   effect. Products above 1 count as 1. */
TEST(specular_textures) {
    static const float texels[8] = { 1, 0.5f, 3, 1, 0.04f, 2, 0.2f, 1 };
    test_scene s = { 0 };
    sbl_picture_desc view = view_of_plate(2, 1, 1, 60, 1);
    shot p;
    int i, k, number = scene_gloss(&s, 0.8, 0.5, 0.2, 1, 0.8);
    const int texture = scene_texture(&s, texels, sizeof texels, SBL_PIXELS_FLOAT, 2, 1, 4);
    scene_quad(&s, number, -1, 0, 1, 1, 0, 1, 1, 0, -1, -1, 0, -1);
    s.materials[number].specular_texture = texture;
    s.textures[texture - 1].wrap = SBL_WRAP_CLAMP;
    for (i = 0; i < 8; i++) ((float *)(uintptr_t)s.meshes[0].texcoords.data)[i] = i % 2 ? 0.5f : i < 4 ? 0.25f : 0.75f;
    for (i = 0; i < 2; i++) {
        double black, white, f;
        for (k = 0; k < 8; k += 2) ((float *)(uintptr_t)s.meshes[0].texcoords.data)[k] = i ? 0.75f : 0.25f;
        if (!shoot(&p, &s, &view)) break;
        f = cosine_at(&p, 0, 0);
        black = lobe_albedo(f, i ? 1 : 0.8 * 0.5, 0);
        white = lobe_albedo(f, i ? 1 : 0.8 * 0.5, 1);
        for (k = 0; k < 3; k++) {
            const double base = (double)s.materials[number].albedo[k], front = i ? 0.2 * base + 0.8 * 0.04 : base;
            const double got = (double)at(&p, SBL_CHANNEL_SPECULAR_ALBEDO, 0, 0)[k];
            CHECK(fabs(got - black - front * (white - black)) < 0.003, "texel %d: the lobe's albedo is %.4f, not %.4f",
                  i, got, black + front * (white - black));
        }
        forget(&p);
    }
    scene_free(&s);
}

/* >>normal maps */

/* Adds a texture with one texel that holds a vector in tangent space, and assigns it to a material. */
static void scene_normal(test_scene *s, int number, const double v[3]) {
    float texel[3];
    int k;
    for (k = 0; k < 3; k++) texel[k] = (float)(v[k] / 2 + 0.5);
    s->materials[number].normal_texture = scene_texture(s, texel, sizeof texel, SBL_PIXELS_FLOAT, 1, 1, 3);
}

/* Directions of u and v of the texture coordinates of a floor, the side from which the camera looks, and
   normal_scale. */
typedef struct tilting { double u[3], v[3]; int below; float scale; } tilting;

static const tilting tilts[6] = {
    { { 1, 0, 0 }, { 0, 0, 1 }, 0, 0 }, { { -1, 0, 0 }, { 0, 0, 1 }, 0, 0 }, { { 0, 0, 1 }, { 1, 0, 0 }, 0, 0.5f },
    { { 0.8, 0, 0.6 }, { -0.6, 0, 0.8 }, 0, -1 }, { { 1, 0, 0 }, { 0, 0, 1 }, 1, 0 },
    { { 0, 0, -1 }, { 1, 0, 0 }, 1, 2 }
};

/* Computes the expected normal, towards the camera. The first component of tangent space points along u, and the second
   against v, but both are perpendicular to the normal of the vertices. */
static void tilted(const tilting *t, const float normal[3], const double texel[3], double out[3]) {
    const double scale = t->scale == 0 ? 1 : (double)t->scale, side = t->below ? -1 : 1;
    double n[3], x[3], y[3], up;
    int k;
    set3(n, (double)normal[0], (double)normal[1], (double)normal[2]);
    for (k = 0; k < 3; k++) x[k] = t->u[k] - lobe__dot(t->u, n) * n[k];
    unit(x);
    set3(y, n[1] * x[2] - n[2] * x[1], n[2] * x[0] - n[0] * x[2], n[0] * x[1] - n[1] * x[0]);
    up = lobe__dot(y, t->v) > 0 ? -scale : scale;
    for (k = 0; k < 3; k++) out[k] = side * (scale * texel[0] * x[k] + up * texel[1] * y[k] + texel[2] * n[k]);
    unit(out);
}

/* A floor with one tilted normal has the right NORMAL, and the right R below a directional light and a sky. Light that
   would come from below the floor, where a lamp shines, is missing. Vertex normals change none of this, unless they
   lean, as in the last case. */
TEST(normals_are_tilted) {
    static const double texel[3] = { 0.48, 0.6, 0.64 };
    double worst = 0, worst_light = 0;
    int i, j, k, sky;
    for (i = 0; i < 13; i++) {
        const tilting *t = &tilts[i / 2 % 6];
        const double side = t->below ? -1 : 1;
        double expected[3], wanted;
        sky = i % 2;
        {
            test_scene s = { 0 };
            const int number = scene_material(&s, 0.5f, 0.5f, 0.5f);
            const float x = i == 12 ? 0.6f : 0, y = i == 12 ? 0.8f : 1;
            const float normals[12] = { x, y, 0, x, y, 0, x, y, 0, x, y, 0 };
            sbl_picture_desc view = scene_plain(scene_view(3, 3, 4, 1, 4 * (float)side, 0.5f, 0, 0, 0),
                                                SBL_MODE_DIRECT, 0);
            sbl_mesh *floor = scene_floor(&s, number, 0, 5);
            float uv[8];
            shot p;
            view.options.rays = sky ? 4096 : 16;
            if (sky || i == 12) floor->normals.data = scene_copy(&s, normals, 12);
            for (j = 0; j < 8; j++) {
                const float *corner = (const float *)floor->positions.data + 3 * (j / 2);
                const double *way = j % 2 ? t->v : t->u;
                uv[j] = (float)((double)corner[0] * way[0] + (double)corner[2] * way[2]);
            }
            floor->texcoords.data = scene_copy(&s, uv, 8);
            scene_normal(&s, number, texel);
            s.materials[number].normal_scale = t->scale;
            tilted(t, normals, texel, expected);
            scene_quad(&s, scene_lamp(&s, 50, 50, 50), -5, -(float)side, -5, -5, -(float)side, 5, 5, -(float)side, 5,
                       5, -(float)side, -5);
            if (sky) scene_sky(&s, 1, 1, 1);
            else {
                sbl_light *sun = scene_light(&s, SBL_LIGHT_DIRECTIONAL, 3, 3, 3);
                sun->direction[0] = 0.3f;
                sun->direction[1] = -0.8f * (float)side;
                sun->direction[2] = 0.4f;
            }
            if (!shoot(&p, &s, &view)) return;
            wanted = -(0.3 * expected[0] - 0.8 * side * expected[1] + 0.4 * expected[2]) / sqrt(0.89);
            wanted = sky ? (1 + side * expected[1]) / 2 : 3 / TEST_PI * test_max(wanted, 0);
            for (k = 0; k < 3; k++)
                worst = test_max(worst, fabs((double)at(&p, SBL_CHANNEL_NORMAL, 1, 1)[k] - expected[k]));
            worst_light = test_max(worst_light, fabs((double)at(&p, SBL_CHANNEL_RADIANCE, 1, 1)[0] - wanted));
            CHECK(worst < 0.002, "case %d: a component of the normal is off by %g", i, worst);
            CHECK(worst_light < 0.005, "case %d: R is %g, not %g", i, (double)at(&p, SBL_CHANNEL_RADIANCE, 1, 1)[0],
                  wanted);
            forget(&p);
            scene_free(&s);
        }
    }
    printf("    largest error %.5f of a component, %.5f of R\n", worst, worst_light);
}

/* Returns the light of intensity 3 that metal with this normal reflects from a direction. way: direction from the
   camera */
static double reflect_at(const double n[3], const double way[3], const double to[3], double square) {
    double x[3], y[3], v[3], w[3];
    set3(x, n[1], -n[0], 0);
    unit(x);
    set3(y, x[1] * n[2] - x[2] * n[1], x[2] * n[0] - x[0] * n[2], x[0] * n[1] - x[1] * n[0]);
    set3(v, -lobe__dot(way, x), -lobe__dot(way, y), -lobe__dot(way, n));
    set3(w, lobe__dot(to, x), lobe__dot(to, y), lobe__dot(to, n));
    return 3 / square * w[2] * lobe_brdf(v, w, 0.3, 1);
}

/* A pixel that shows many normals has their mean normal, and a lobe that is widened by their spread. The highlight of a
   lamp is compared with the mean of the highlights of the single normals, whose shape is not quite GGX. */
TEST(pixels_average_normals) {
    enum { SIZE = 32, SIDE = 8 };
    static float texels[3 * SIZE * SIZE];
    static double normals[SIZE * SIZE][3];
    double worst = 0, sum = 0, wanted = 0, narrow = 0;
    test_scene s = { 0 };
    const int number = scene_gloss(&s, 1, 1, 1, 1, 0.3);
    sbl_picture_desc view = view_of_plate(SIDE, SIDE, 16, 40, 16);
    sbl_light *l = scene_light(&s, SBL_LIGHT_POINT, 3, 3, 3);
    shot p;
    int i, j, k;
    l->position[0] = -3;
    l->position[1] = 3.6f;
    for (i = 0; i < SIZE * SIZE; i++) {  /* slopes with a normal distribution of standard deviation 0.1 */
        const double turn = (double)(test_hash((uint32_t)i) >> 8) / (1 << 24) * 2 * TEST_PI;
        const double slope = 0.1 * sqrt(-2 * log((test_hash((uint32_t)i + 7777u) + 0.5) / 4294967296.0));
        set3(normals[i], slope * cos(turn), 1, -slope * sin(turn));
        unit(normals[i]);
        for (k = 0; k < 3; k++)
            texels[3 * i + k] = (float)(0.5 + 0.5 * (k == 1 ? -1 : 1) * normals[i][k == 0 ? 0 : 3 - k]);
    }
    scene_quad(&s, number, -5, 0, -5, 5, 0, -5, 5, 0, 5, -5, 0, 5);
    for (i = 0; i < 8; i++) ((float *)(uintptr_t)s.meshes[0].texcoords.data)[i] *= 40;
    s.materials[number].normal_texture = scene_texture(&s, texels, sizeof texels, SBL_PIXELS_FLOAT, SIZE, SIZE, 3);
    if (!shoot(&p, &s, &view)) return;
    for (i = 0; i < SIDE * SIDE; i++) {
        static const double up[3] = { 0, 1, 0 };
        const float *position = at(&p, SBL_CHANNEL_POSITION, i % SIDE, i / SIDE);
        double way[3], to[3], length;
        look(&view, i % SIDE, i / SIDE, way);
        for (k = 0; k < 3; k++) to[k] = (double)(l->position[k] - position[k]);
        length = unit(to);
        sum += reflected(&p, i % SIDE, i / SIDE, 1);
        worst = test_max(worst, 1 - (double)at(&p, SBL_CHANNEL_NORMAL, i % SIDE, i / SIDE)[1]);
        narrow += reflect_at(up, way, to, length * length);
        for (j = 0; j < SIZE * SIZE; j++)
            wanted += reflect_at(normals[j], way, to, length * length) / (SIZE * SIZE);
    }
    printf("    highlights of %.3f times the expected light (%.3f with one normal); normals are off by %.5f\n",
           sum / wanted, narrow / wanted, worst);
    CHECK(worst < 0.002, "the mean normal is off by %g", worst);
    CHECK(fabs(sum / wanted - 1) < 0.2 && fabs(narrow / wanted - 1) > 0.3, "highlights are %.3f times as bright",
          sum / wanted);
    forget(&p);
    scene_free(&s);
}

/* >>mirrors */

/* A metal mirror reflects a lamp, attenuated by the Fresnel term; so do two mirrors in sequence and smooth black
   plastic. The lamp may let light pass. The channels show the point that a perfect mirror shows, also if the mirror is
   a little rough. */
TEST(mirrors_show_lamps) {
    static const double base[3] = { 0.9, 0.6, 0.3 };
    static const char *const names[5] = { "a mirror", "roughness 0.07", "two mirrors", "plastic", "a clear lamp" };
    int kind, k, i;
    for (kind = 0; kind < 5; kind++) {
        test_scene s = { 0 };
        const sbl_picture_desc view = view_of_plate(4, 4, 4, 60, 64);
        const int mirror = kind == 3 ? scene_gloss(&s, 0, 0, 0, 0, 0)
            : scene_gloss(&s, base[0], base[1], base[2], 1, kind == 1 ? 0.07 : 0.02);
        const int lamp = scene_lamp(&s, 3, 2, 1);
        double worst = 0;
        shot p;
        scene_floor(&s, mirror, 0, 0.8f);
        if (kind == 2) scene_quad(&s, mirror, -1, 0.2f, -1, -1, 0.2f, 1, -1, 2, 1, -1, 2, -1);
        if (kind == 2) scene_quad(&s, lamp, 1, 0.9f, -2, 1, 0.9f, 2, 1, 4, 2, 1, 4, -2);  /* seen from below */
        else scene_quad(&s, lamp, -2, 0.2f, -2, -2, 0.2f, 2, -2, 3, 2, -2, 3, -2);
        s.meshes[s.mesh_count - 1].id = 99;
        s.materials[lamp].transmission = kind == 4;
        for (k = 0; k < 3; k++) s.materials[lamp].albedo[k] = kind == 4;
        if (!shoot(&p, &s, &view)) return;
        for (i = 0; i < 16; i++) {
            const float *final = at(&p, SBL_CHANNEL_FINAL, i % 4, i / 4);
            const float *position = at(&p, SBL_CHANNEL_POSITION, i % 4, i / 4);
            double way[3], slope;
            look(&view, i % 4, i / 4, way);
            slope = (4 * sin(60 * TEST_PI / 180) + 2) / -way[0];
            CHECK(kind > 1 || (fabs((double)position[1] + 4 * cos(60 * TEST_PI / 180) + slope * way[1]) < 1e-3 &&
                               fabs((double)position[2] - slope * way[2]) < 1e-3),
                  "%s: shows the point %g %g", names[kind], (double)position[1], (double)position[2]);
            CHECK(kind > 2 || (int)at(&p, SBL_CHANNEL_ID, i % 4, i / 4)[0] == 99, "%s: no lamp is shown", names[kind]);
            for (k = 0; k < 3; k++) {
                double wanted = (3 - k) * lobe__fresnel(fabs(way[1]), kind == 3 ? 0.04 : base[k]);
                if (kind == 2) wanted *= lobe__fresnel(fabs(way[0]), base[k]);
                worst = test_max(worst, fabs((double)final[k] / wanted - 1));
            }
        }
        printf("    %s: %.3f %%\n", names[kind], 100 * worst);
        CHECK(worst < 0.005, "%s: the lamp in the mirror is off by %.3f %%", names[kind], 100 * worst);
        forget(&p);
        scene_free(&s);
    }
}

/* A mirror shows the same points with the same light as a camera behind the mirror would see. */
TEST(mirrors_show_surfaces) {
    enum { SIDE = 24 };
    enum { SAME = 5 };
    static const sbl_channel same[SAME] = { SBL_CHANNEL_RADIANCE, SBL_CHANNEL_POSITION, SBL_CHANNEL_NORMAL,
        SBL_CHANNEL_ID, SBL_CHANNEL_SPECULAR_ALBEDO };  /* the mirror reflects a part of the last */
    test_scene s = { 0 };
    sbl_picture_desc view = scene_plain(scene_view(SIDE, SIDE, 12, 2, 2, 0.2f, 0, 0, 0), SBL_MODE_DIRECT, 0), behind;
    shot p, q;
    double worst[SAME] = { 0 };
    int i, j, k, seen_points = 0;
    scene_box(&s, scene_gloss(&s, 0.6, 0.5, 0.4, 0, 0.5), -1.6f, 0.4f, -0.5f, -0.8f, 1.4f, 0.5f);
    for (i = 0; i < s.mesh_count; i++) s.meshes[i].id = (uint32_t)i + 1;
    s.lights[0].kind = SBL_LIGHT_POINT;
    scene_light(&s, SBL_LIGHT_POINT, 3, 4, 5)->position[0] = 1;
    s.lights[0].position[1] = 0.6f;
    s.lights[0].position[2] = 0.8f;
    behind = view;  /* the camera is at y = -2, and its picture is upside down */
    sbl_look_at(behind.world_to_view, 2, -2, 0.2f, 0, 0, 0, 0, 1, 0);
    if (!shoot(&q, &s, &behind)) return;
    for (i = 0; i < SAME; i++) at(&q, same[i], 0, 0);
    scene_floor(&s, scene_gloss(&s, 0.6, 0.6, 0.6, 1, 0), 0, 1);
    if (!shoot(&p, &s, &view)) return;
    for (i = 0; i < SIDE * SIDE; i++)
        for (j = 0; j < SAME; j++)
            for (k = 0; k < (j == 3 ? 1 : 3); k++) {
                const int x = i % SIDE, y = i / SIDE;
                double way[3], a = (double)at(&p, same[j], x, y)[k], b = (double)at(&q, same[j], x, SIDE - 1 - y)[k];
                const float id = at(&p, SBL_CHANNEL_ID, x, y)[0], other = at(&q, SBL_CHANNEL_ID, x, SIDE - 1 - y)[0];
                look(&view, x, y, way);
                if (other <= 0 || (j != 3 && id != other)) continue;
                if (j == 4) b *= lobe__fresnel(-way[1], 0.6);
                seen_points += j == 3;
                if (j != 3) worst[j] = test_max(worst[j], fabs(a - b) / (j ? 1 : fabs(b) + 0.01));
                else worst[j] += a != b;
            }
    printf("    R %.4f %%, position %.5f, normal %.5f, %g other ids of %d, albedo of lobes %.5f\n", 100 * worst[0],
           worst[1], worst[2], worst[3], seen_points, worst[4]);
    CHECK(seen_points > 100, "only %d points are seen", seen_points);
    CHECK(worst[0] < 0.002 && worst[1] < 1e-3 && worst[2] < 1e-3 && worst[3] <= 3 && worst[4] < 2e-3,
          "the mirror shows something else");
    forget(&p);
    forget(&q);
    scene_free(&s);
}

/* A mirror that is not perfect blurs the edge of a lamp like a quadrature of its lobe, also if a pixel has one
   anti-aliasing sample. */
TEST(mirrors_blur_what_they_show) {
    enum { WIDE = 32 };
    test_scene s = { 0 };
    const sbl_picture_desc view = view_of_plate(WIDE, 2, 0.25, 45, 64);
    const double roughness = 0.07;
    double off2 = 0, sharp2 = 0;
    shot p;
    int i, j;
    scene_floor(&s, scene_gloss(&s, 1, 1, 1, 1, roughness), 0, 1);
    scene_quad(&s, scene_lamp(&s, 1, 1, 1), -1.3f, 1.5f, 0, -1.3f, 1.5f, 0.4f, -1.5f, 1.3f, 0.4f, -1.5f, 1.3f, 0);
    if (!shoot(&p, &s, &view)) return;
    for (i = 0; i < WIDE; i++) {
        const double eye = 4 * sqrt(0.5), shown = (double)at(&p, SBL_CHANNEL_FINAL, i, 0)[0];
        double way[3], v[3], corners[4][3], wanted, sharp, across;
        look(&view, i, 0, way);
        across = eye * way[2] / -way[1] + way[2] * 1.4 / -way[1];  /* where a sharp mirror would show the lamp */
        set3(v, -way[0], -way[2], -way[1]);
        for (j = 0; j < 4; j++)  /* relative to the point of the mirror that the pixel shows; here z is up */
            set3(corners[j], (j < 2 ? -1.3 : -1.5) - (eye - eye * way[0] / way[1]),
                 (j == 1 || j == 2 ? 0.4 : 0) + eye * way[2] / way[1], j < 2 ? 1.5 : 1.3);
        wanted = lobe_highlight(v, corners, roughness, 1);
        sharp = across > 0 && across < 0.4;
        off2 += (shown - wanted) * (shown - wanted) / WIDE;
        sharp2 += (sharp - wanted) * (sharp - wanted) / WIDE;
    }
    printf("    error %.4f of the lamp's radiance; that of a sharp edge would be %.4f\n", sqrt(off2), sqrt(sharp2));
    CHECK(sqrt(off2) < 0.03 && sqrt(sharp2) > 0.06, "the blurred edge is off by %.4f", sqrt(off2));
    forget(&p);
    scene_free(&s);
}

/* Returns the largest difference between the last column of a window, which ends `width` pixels from the left edge, and
   the same column of the whole picture. */
static double last_column_differs(const test_scene *s, sbl_picture_desc view, int width, shot *whole) {
    double off = 0;
    shot part;
    int y;
    view.window[2] = width;
    view.window[3] = view.height;
    if (!shoot(&part, s, &view)) return 1e9;
    part.view.width = width;
    for (y = 0; y < view.height; y++)
        off = test_max(off, fabs((double)(at(&part, SBL_CHANNEL_FINAL, width - 1, y)[0] -
                                          at(whole, SBL_CHANNEL_FINAL, width - 1, y)[0])));
    forget(&part);
    return off;
}

/* The right half of the picture shows a blurred mirror, which is narrower at one end, and a lamp beside the narrow end.
   The mirror shows a lamp behind the camera with a slanted edge, and another lamp at its left edge. The left half of
   the picture shows one more lamp with slanted edges. With few samples per pixel, lamps that are seen directly show
   multiples of 1 / samples of their radiance. The mirror is the same as with `least` samples, which blurred pixels
   have at least. */
static void few_samples_and_many(int samples, int least) {
    enum { WIDE = 24 };
    const float pixel = (float)(8 * tan(15 * TEST_PI / 180) / WIDE);  /* the width of a pixel at the mirror */
    const float left = 0.7f * pixel;  /* the mirror does not contain the centres of the pixels at its left edge */
    test_scene s = { 0 };
    sbl_picture_desc view = scene_plain(scene_view(WIDE, WIDE, 30, 0, 0, 4, 0, 0, 0), SBL_MODE_DIRECT, 0);
    int x, y, edges = 0, beside = 0, bright = 0, blurred = 0;
    double worst = 0, off = 0, display = 0;
    shot few, many;
    scene_quad(&s, scene_gloss(&s, 1, 1, 1, 1, 0.07), left, -8 * pixel, 0, 2, -8 * pixel, 0, 2, 8 * pixel, 0, left,
               8 * pixel, 0);
    scene_quad(&s, scene_gloss(&s, 1, 1, 1, 1, 0.07), left, -2, 0, 4 * pixel, -2, 0, 4 * pixel, -8 * pixel, 0, left,
               -8 * pixel, 0);
    scene_quad(&s, scene_lamp(&s, 1, 1, 1), 7.3f * pixel, -12 * pixel, 0, 11 * pixel, -12 * pixel, 0, 8 * pixel,
               -9.2f * pixel, 0, 7.3f * pixel, -9.2f * pixel, 0);
    scene_quad(&s, scene_lamp(&s, 1, 1, 1), -0.2f, -2, 0, -0.25f, 2, 0, -0.4f, 2, 0, -0.8f, -2, 0);
    scene_quad(&s, scene_lamp(&s, 1, 1, 1), 4, -4, 6, 4, 4, 6, 1.5f, 4, 6, 2, -4, 6);
    scene_quad(&s, scene_lamp(&s, 1, 1, 1), 0.4f, -4, 6, 0.4f, 4, 6, -1, 4, 6, -1, -4, 6);
    view.tone = SBL_TONE_NEUTRAL;
    view.samples = samples;
    if (!shoot(&few, &s, &view)) return;
    at(&few, SBL_CHANNEL_FINAL, 0, 0);  /* keeps the channel for later, when the next picture has begun */
    at(&few, SBL_CHANNEL_DISPLAY, 0, 0);
    view.samples = least;
    if (!shoot(&many, &s, &view)) return;
    view.samples = samples;
    for (y = 0; y < WIDE; y++)
        for (x = 0; x < WIDE; x++) {
            const double shown = (double)at(&few, SBL_CHANNEL_FINAL, x, y)[0];
            if (x >= WIDE / 2 && (x < WIDE / 2 + 5 || y < WIDE / 2 + 9)) {
                off = test_max(off, fabs(shown - (double)at(&many, SBL_CHANNEL_FINAL, x, y)[0]));
                display = test_max(display, fabs((double)at(&few, SBL_CHANNEL_DISPLAY, x, y)[0] -
                                                 (double)at(&many, SBL_CHANNEL_DISPLAY, x, y)[0]));
                blurred += shown > 0.01 && shown < 0.99;
            } else {
                worst = test_max(worst, fabs(samples * shown - floor(samples * shown + 0.5)));
                edges += shown > 0.01 && shown < 0.99;
                beside += shown > 0.01 && shown < 0.99 && x >= WIDE / 2;
                bright += shown > 0.999;
            }
        }
    printf("    %d pixels at the edge, off by %.6f; %d blurred pixels, off by %.6f and %.6f\n", edges, worst, blurred,
           off, display);
    CHECK(edges > 20 && beside > 2 && bright > 20 && blurred > 20, "%d, %d, %d and %d pixels", edges, beside, bright,
          blurred);
    CHECK(worst < 1e-4 && off < 1e-5 && display < 1e-5, "off by %.6f, %.6f and %.6f", worst, off, display);
    off = last_column_differs(&s, view, WIDE / 2 + 1, &many);  /* the next column shows the mirror */
    CHECK(off < 1e-5, "a window beside the mirror is off by %.6f", off);
    forget(&few);
    forget(&many);
    scene_free(&s);
}
TEST(only_blurred_pixels_get_further_samples) {
    few_samples_and_many(3, 15);
    few_samples_and_many(4, 16);
}

/* Under a sky of 1, white metal with a little diffuse light, and white, blurred metal that covers half of the sky below
   it, lose no light. */
TEST(mirrors_lose_no_light) {
    int kind;
    for (kind = 0; kind < 2; kind++) {
        test_scene s = { 0 };
        sbl_mesh *plate;
        shot p;
        const sbl_picture_desc view = view_of_plate(1, 1, 1, 50, 16);
        scene_sky(&s, 1, 1, 1);
        plate = scene_floor(&s, scene_gloss(&s, 1, 1, 1, kind ? 1 : 0.9, kind ? 0.07 : 0.06), 0, 1);
        if (kind) scene_blend(&s, plate, 0.5f);
        if (!shoot(&p, &s, &view)) return;
        printf("    %.4f\n", (double)at(&p, SBL_CHANNEL_FINAL, 0, 0)[0]);
        CHECK(fabs((double)at(&p, SBL_CHANNEL_FINAL, 0, 0)[0] - 1) < 0.01, "a mirror shows %.4f",
              (double)at(&p, SBL_CHANNEL_FINAL, 0, 0)[0]);
        forget(&p);
        scene_free(&s);
    }
}

/* A pane mirrors another pane, which tints the sky behind it, or thin metal, which shows three quarters of the sky. */
TEST(panes_show_panes_in_mirrors) {
    const sbl_picture_desc view = view_of_plate(1, 1, 1, 70, 16);
    const double once = lobe__fresnel(cos(70 * TEST_PI / 180), 0.04);
    int metal;
    for (metal = 0; metal < 2; metal++) {
        const double wanted = 1 - once + once * (metal ? 0.75 : 0.6 * (1 - once));
        test_scene s = { 0 };
        sbl_mesh *other;
        double shown;
        shot p;
        scene_sky(&s, 1, 1, 1);
        scene_floor(&s, scene_pane(&s, 1, 1, 1, 1), 0, 1);
        other = scene_quad(&s, metal ? scene_gloss(&s, 0.5, 0.5, 0.5, 1, 0) : scene_pane(&s, 0.6, 0.6, 0.6, 1), -4, 1,
                           -1, -4, 1, 1, -2, 1, 1, -2, 1, -1);
        if (metal) scene_blend(&s, other, 0.25f);
        if (!shoot(&p, &s, &view)) return;
        shown = (double)at(&p, SBL_CHANNEL_FINAL, 0, 0)[1];
        printf("    %.4f of %.4f\n", shown, wanted);
        CHECK(fabs(shown - wanted) < 0.003, "the pane shows %.4f, not %.4f", shown, wanted);
        forget(&p);
        scene_free(&s);
    }
}

/* A pane mirrors a plate of polished metal, which mirrors the edge of a lamp. The plate blurs the edge like a
   quadrature of its lobe, also if a pixel has one anti-aliasing sample. */
TEST(panes_blur_polished_metal) {
    enum { WIDE = 32 };
    test_scene s = { 0 };
    const sbl_picture_desc view = view_of_plate(WIDE, 2, 0.1, 70, 16);
    const double roughness = 0.12;
    double off2 = 0, sharp2 = 0;
    shot p;
    int i, j;
    scene_floor(&s, scene_pane(&s, 1, 1, 1, 1), 0, 1);
    scene_quad(&s, scene_gloss(&s, 1, 1, 1, 1, roughness), -4, 1, -1, -4, 1, 1, -2, 1, 1, -2, 1, -1);
    scene_quad(&s, scene_lamp(&s, 1, 1, 1), -7, 0, 0, -7, 0, 2, -4, 0, 2, -4, 0, 0);
    if (!shoot(&p, &s, &view)) return;
    for (i = 0; i < WIDE; i++) {
        const double shown = (double)at(&p, SBL_CHANNEL_FINAL, i, 0)[0], eye[2] = { 4 * sin(70 * TEST_PI / 180),
                                                                                    4 * cos(70 * TEST_PI / 180) };
        double way[3], v[3], corners[4][3], wanted, sharp, pane, length;
        look(&view, i, 0, way);
        pane = lobe__fresnel(-way[1], 0.04);
        length = (eye[1] + 1) / -way[1];  /* from the eye to the plate */
        set3(v, -way[0], -way[2], -way[1]);
        for (j = 0; j < 4; j++)  /* relative to the point of the plate that the pixel shows; here z is down */
            set3(corners[j], (j < 2 ? -7 : -4) - eye[0] - length * way[0],
                 (j == 1 || j == 2 ? 2 : 0) - length * way[2], 1);
        wanted = lobe_highlight(v, corners, roughness, 1);
        sharp = (length + 1 / -way[1]) * way[2] > 0;
        off2 += pow(shown / pane - wanted, 2) / WIDE;
        sharp2 += (sharp - wanted) * (sharp - wanted) / WIDE;
    }
    printf("    error %.4f of the lamp's radiance; that of a sharp edge would be %.4f\n", sqrt(off2), sqrt(sharp2));
    CHECK(sqrt(off2) < 0.06 && sqrt(sharp2) > 0.12, "the blurred edge is off by %.4f", sqrt(off2));
    forget(&p);
    scene_free(&s);
}

/* A texture of transmission takes effect through its red channel. The coverage of a blended pane is the product of the
   alpha of its vertices and its texels. */
TEST(panes_read_red) {
    static const unsigned char texel[4] = { 51, 230, 128, 255 }, cover[4] = { 255, 255, 255, 204 };
    int blends;
    for (blends = 0; blends < 2; blends++) {
        test_scene s = { 0 };
        const sbl_picture_desc view = view_of_plate(1, 1, 1, 0, 1);
        const int pane = scene_pane(&s, 1, 1, 1, 1);
        const double wanted = blends ? 0.6 + 0.4 * 0.2 * 0.96 : 0.2 * 0.96;
        sbl_mesh *floor;
        shot p;
        s.materials[pane].transmission_texture = scene_texture(&s, texel, sizeof texel, SBL_PIXELS_LINEAR8, 1, 1, 4);
        floor = scene_floor(&s, pane, 0, 1);
        if (blends) {
            s.materials[pane].albedo_texture = scene_texture(&s, cover, sizeof cover, SBL_PIXELS_LINEAR8, 1, 1, 4);
            scene_blend(&s, floor, 0.5f);
        }
        scene_floor(&s, scene_lamp(&s, 1, 1, 1), -1, 3);
        if (!shoot(&p, &s, &view)) return;
        CHECK(fabs((double)at(&p, SBL_CHANNEL_FINAL, 0, 0)[1] - wanted) < 0.002, "the lamp behind shows %.4f, not %.4f",
              (double)at(&p, SBL_CHANNEL_FINAL, 0, 0)[1], wanted);
        forget(&p);
        scene_free(&s);
    }
}

/* In a closed room where everything has the radiance 1, half of it reflected, a pane seen at an angle also has the
   radiance 1, with one and with several anti-aliasing samples. Thus the mirror image in the pane includes the light
   that walls reflect. This light is stored in cells, and the predicted error of the pane contains 13 % of it. */
TEST(panes_mirror_bounced_light) {
    enum { SIDE = 16 };
    int samples, i;
    for (samples = 1; samples <= 3; samples += 2) {
        test_scene s = { 0 };
        const int walls = scene_material(&s, 0.5f, 0.5f, 0.5f), pane = scene_pane(&s, 1, 1, 1, 1);
        sbl_picture_desc view = scene_view(SIDE, SIDE, 6, 2.9f, 0.75f, 0, 0, 0, 0);  /* the Fresnel term is 0.24 */
        double mean = 0, error = 0;
        shot p;
        for (i = 0; i < 3; i++) s.materials[walls].emission[i] = 0.5f;
        scene_box(&s, walls, -3, -3, -3, 3, 3, 3);
        scene_floor(&s, pane, 0, 1);
        view.options.mode = SBL_MODE_GI;
        view.samples = samples;
        if (!shoot(&p, &s, &view)) return;
        for (i = 0; i < SIDE * SIDE; i++) {
            mean += (double)at(&p, SBL_CHANNEL_FINAL, i % SIDE, i / SIDE)[1] / SIDE / SIDE;
            error += (double)at(&p, SBL_CHANNEL_ERROR, i % SIDE, i / SIDE)[0] / SIDE / SIDE;
        }
        printf("    %d samples: %.4f, predicted error %.4f\n", samples, mean, error);
        CHECK(fabs(mean - 1) < 0.01, "%d samples: the pane has the radiance %.4f instead of 1", samples, mean);
        CHECK(error > 0.13 * 0.1 && error < 0.13 * 0.15, "%d samples: the predicted error is %.4f", samples, error);
        forget(&p);
        scene_free(&s);
    }
}

/* A pane is seen at 70 degrees under a sky of 1. It mirrors a metal plate, which mirrors the sky: the pane has the
   radiance 1 - F + F * Fm, where F is the Fresnel term of the pane and Fm the Fresnel term of the plate. A plate with
   the roughness 0.6 shows stored light, which is 0 in direct light. */
TEST(panes_mirror_metal) {
    enum { SIDE = 8 };
    const float away = -2.7f;  /* the pane's mirrored rays meet the plate here */
    int kind;
    for (kind = 0; kind < 3; kind++) {
        test_scene s = { 0 };
        const int plate = scene_gloss(&s, 0.5, 0.5, 0.5, 1, kind == 2 ? 0.6 : 0.2 * kind);
        sbl_picture_desc view = view_of_plate(SIDE, SIDE, 4, 70, 16);
        const double cosine = cos(70 * TEST_PI / 180), pane = lobe__fresnel(cosine, 0.04);
        const double wanted = 1 - pane + pane * (kind == 0 ? lobe__fresnel(cosine, 0.5) :
                                                 kind == 1 ? lobe_albedo(cosine, 0.2, 0.5) : 0);
        double mean = 0;
        shot p;
        int i;
        scene_sky(&s, 1, 1, 1);
        scene_floor(&s, scene_pane(&s, 1, 1, 1, 1), 0, 1);
        scene_quad(&s, plate, away - 1, 1, -1, away - 1, 1, 1, away + 1, 1, 1, away + 1, 1, -1);
        if (!shoot(&p, &s, &view)) return;
        for (i = 0; i < SIDE * SIDE; i++)
            mean += (double)at(&p, SBL_CHANNEL_FINAL, i % SIDE, i / SIDE)[1] / SIDE / SIDE;
        printf("    plate of roughness %.1f: %.4f of %.4f\n", (double)s.materials[plate].roughness, mean, wanted);
        CHECK(fabs(mean - wanted) < 0.003, "kind %d: the pane has the radiance %.4f, not %.4f", kind, mean, wanted);
        forget(&p);
        scene_free(&s);
    }
}

/* >>highlights of lamps */

/* Returns the roughness of the surfaces in the tests of highlights, which are of metal (even) or plastic, with three
   roughnesses each. */
static double highlight_roughness(int kind) { return kind & 4 ? 1 : kind & 2 ? 0.5 : 0.2; }
static int highlight_material(test_scene *s, int kind) {
    return scene_gloss(s, 0.9, 0.5, 0.2, kind & 1 ? 0 : 1, highlight_roughness(kind));
}
static double highlight_reflectance(int kind, int k) {
    static const double base[3] = { 0.9, 0.5, 0.2 };
    return kind & 1 ? 0.04 : base[k];
}

/* Like lobe_highlight, but only for the part of the lamp that the plane y = 1 at x > edge does not hide. */
static double half_highlight(const double v[3], double corners[4][3], double roughness, double f0, double edge) {
    enum { STEPS = 300 };
    double sum = 0;
    int i, k;
    for (i = 0; i < STEPS * STEPS; i++) {
        double l[3], area[3], distance, facing;
        lobe__place(corners, (i % STEPS + 0.5) / STEPS, (i / STEPS + 0.5) / STEPS, l, area);
        if (l[2] > 1 && l[0] / l[2] > edge) continue;
        distance = unit(l);
        for (k = 0, facing = 0; k < 3; k++) facing += l[k] * area[k];
        sum += lobe_brdf(v, l, roughness, f0) * l[2] * fabs(facing) / (distance * distance);
    }
    return sum / STEPS / STEPS;
}

/* Highlights of a square lamp are right at their middle and beside it, for the complete lamp and for a lamp that is
   half hidden. */
TEST(highlights_of_lamps) {
    enum { SIDE = 8 };
    int kind, place, k;
    for (kind = 0; kind < 4; kind++) {
        double peak[3] = { 0, 0, 0 };
        for (place = 0; place < 3; place++) {
            const double tilt = (place == 1 ? 33 : 45) * TEST_PI / 180, far_away = 2, half = 0.15;
            const double middle[3] = { -far_away * sin(tilt), 0, far_away * cos(tilt) };
            const double side[3] = { half * cos(tilt), 0, half * sin(tilt) };
            const double edge = -sin(tilt) / cos(tilt);
            const double v[3] = { sin(TEST_PI / 4), 0, cos(TEST_PI / 4) };
            const sbl_picture_desc view = view_of_plate(SIDE, SIDE, 0.1, 45, 1024);
            test_scene s = { 0 };
            double corners[4][3], off = 0;
            int i;
            shot p;
            for (i = 0; i < 4; i++)
                set3(corners[i], middle[0] + (i == 0 || i == 3 ? 1 : -1) * side[0], i < 2 ? half : -half,
                     middle[2] + (i == 0 || i == 3 ? 1 : -1) * side[2]);
            scene_floor(&s, highlight_material(&s, kind), 0, 0.5f);
            scene_quad(&s, scene_lamp(&s, 3, 2, 1), (float)corners[0][0], (float)corners[0][2], (float)corners[0][1],
                       (float)corners[1][0], (float)corners[1][2], (float)corners[1][1], (float)corners[2][0],
                       (float)corners[2][2], (float)corners[2][1], (float)corners[3][0], (float)corners[3][2],
                       (float)corners[3][1]);
            if (place == 2)
                scene_quad(&s, scene_material(&s, 0, 0, 0), (float)edge, 1, -0.6f, -0.5f, 1, -0.6f, -0.5f, 1, 0.6f,
                           (float)edge, 1, 0.6f);
            if (!shoot(&p, &s, &view)) return;
            for (k = 0; k < 3; k++) {
                const double f0 = highlight_reflectance(kind, k), roughness = highlight_roughness(kind);
                const double wanted = place == 2 ? half_highlight(v, corners, roughness, f0, edge)
                    : lobe_highlight(v, corners, roughness, f0);
                const double got = mean_reflected(&p, k) / (3 - k);
                if (place == 0) peak[k] = wanted;
                off = test_max(off, fabs(got - wanted) / peak[k]);
                CHECK(fabs(got - wanted) < 0.01 * peak[k],
                      "surface %d, place %d: colour %d shines %.4f, not %.4f; the peak is %.4f", kind, place, k, got,
                      wanted, peak[k]);
            }
            printf("    surface %d, place %d: error %.2f %% of the peak %.3f\n", kind, place, 100 * off, peak[0]);
            forget(&p);
            scene_free(&s);
        }
    }
}

/* Highlights of a point light, a spot light and a directional light are right at every pixel, seen from three sides. */
TEST(highlights_of_lights) {
    enum { SIDE = 16 };
    int kind, light, i, k;
    for (kind = 0; kind < 6; kind++)
        for (light = 0; light < 3; light++) {
            const double turn = light * 2.1, angle = (kind > 1 ? 70 : 50) * TEST_PI / 180;
            const double across = 4 * sin(angle), up = 4 * cos(angle);
            sbl_picture_desc view = scene_plain(scene_view(SIDE, SIDE, 12, (float)(across * cos(turn)), (float)up,
                                                           (float)(across * sin(turn)), 0, 0, 0), SBL_MODE_DIRECT, 0);
            test_scene s = { 0 };
            sbl_light *l = scene_light(&s, light == 0 ? SBL_LIGHT_POINT : light == 1 ? SBL_LIGHT_SPOT
                                       : SBL_LIGHT_DIRECTIONAL, 3, 2, 1);
            double worst = 0, largest = 0;
            shot p;
            view.options.rays = 16;
            l->position[0] = (float)(-1.2 * cos(turn));
            l->position[1] = 1.1f;
            l->position[2] = (float)(-1.2 * sin(turn) + 0.1);
            l->direction[0] = (float)(1.2 * cos(turn));
            l->direction[1] = -1;
            l->direction[2] = (float)(1.2 * sin(turn));
            l->cone = 179;
            l->inner_cone = 178;
            scene_floor(&s, highlight_material(&s, kind), 0, 5);
            if (!shoot(&p, &s, &view)) return;
            for (i = 0; i < SIDE * SIDE; i++) {
                const int x = i % SIDE, y = i / SIDE;
                const float *position = at(&p, SBL_CHANNEL_POSITION, x, y);
                float to[3], from[3];
                double v[3], w[3], way[3], strength = 1;
                look(&view, x, y, way);
                for (k = 0; k < 3; k++) {
                    from[k] = (float)-way[k];
                    to[k] = light == 2 ? -l->direction[k] : l->position[k] - position[k];
                }
                stand_up(from, v);
                stand_up(to, w);
                strength = unit(w);
                strength = light == 2 ? 1 : 1 / (strength * strength);
                for (k = 0; k < 3; k++) {
                    const double f0 = highlight_reflectance(kind, k);
                    const double wanted = (3 - k) * strength * w[2] * lobe_brdf(v, w, highlight_roughness(kind), f0);
                    largest = test_max(largest, wanted);
                    worst = test_max(worst, fabs(reflected(&p, x, y, k) / wanted - 1));
                }
            }
            printf("    surface %d, light %d: error %.3f %%, largest %.3f\n", kind, light, 100 * worst, largest);
            CHECK(worst < 0.01, "surface %d, light %d: a highlight is off by %.2f %%", kind, light, 100 * worst);
            forget(&p);
            scene_free(&s);
        }
}

/* Highlights of a sky picture are right for a bright texel and a wide spot in front of a gradient. */
TEST(highlights_of_the_sky) {
    enum { SIDE = 8, ACROSS = 64, DOWN = 32, CUT = 8 };
    static float pixels[3 * ACROSS * DOWN];
    int kind, i, j;
    for (i = 0; i < ACROSS * DOWN; i++) {
        const int x = i % ACROSS, y = i / ACROSS;
        const double bright = x == 2 && y == 10 ? 60 : x < 6 && y > 3 && y < 7 ? 3 : 0.3 + 0.01 * y;
        pixels[3 * i] = pixels[3 * i + 1] = pixels[3 * i + 2] = (float)bright;
    }
    for (kind = 0; kind < 4; kind += 2) {
        const sbl_picture_desc view = view_of_plate(SIDE, SIDE, 0.1, 45, 1024);
        const double v[3] = { sin(TEST_PI / 4), 0, cos(TEST_PI / 4) };
        double wanted = 0;
        test_scene s = { 0 };
        shot p;
        s.environment.picture.pixels = pixels;
        s.environment.picture.format = SBL_PIXELS_FLOAT;
        s.environment.picture.width = ACROSS;
        s.environment.picture.height = DOWN;
        s.environment.picture.channels = 3;
        scene_floor(&s, highlight_material(&s, kind), 0, 0.5f);
        if (!shoot(&p, &s, &view)) return;
        for (i = 0; i < ACROSS * DOWN; i++)
            for (j = 0; j < CUT * CUT; j++) {
                const double across = (i % ACROSS + (j % CUT + 0.5) / CUT) / ACROSS;
                const double theta = TEST_PI * (i / ACROSS + (j / CUT + 0.5) / CUT) / DOWN;
                const double phi = 2 * TEST_PI * (across - 0.5);
                const double size = 2 * TEST_PI * TEST_PI / (ACROSS * DOWN) / CUT / CUT;
                double w[3];
                set3(w, sin(theta) * cos(phi), sin(theta) * sin(phi), cos(theta));
                if (w[2] <= 0) continue;
                wanted += (double)pixels[3 * i] * size * sin(theta) * w[2] * lobe_brdf(v, w, highlight_roughness(kind),
                                                                                      highlight_reflectance(kind, 0));
            }
        printf("    surface %d: %.4f of %.4f\n", kind, mean_reflected(&p, 0), wanted);
        CHECK(fabs(mean_reflected(&p, 0) / wanted - 1) < 0.01, "surface %d shows %.4f of the sky, not %.4f", kind,
              mean_reflected(&p, 0), wanted);
        forget(&p);
        scene_free(&s);
    }
}

/* A plate of rough metal shows the flank of the highlight of a sun, which is one texel of a sky picture. Pixels have 64
   rays each, and differ little, because rays to the sun find nearly all of its light. */
TEST(highlights_of_suns_have_little_noise) {
    enum { SIDE = 12, ACROSS = 256, DOWN = 128, ROW = 40, CUT = 4 };
    static float pixels[3 * ACROSS * DOWN];
    const sbl_picture_desc view = view_of_plate(SIDE, SIDE, 0.01, 45, 64);
    const double v[3] = { sin(TEST_PI / 4), 0, cos(TEST_PI / 4) };
    const double size = 2 * TEST_PI * TEST_PI / (ACROSS * DOWN) / CUT / CUT;
    double wanted = 0, mean, squares = 0;
    test_scene s = { 0 };
    shot p;
    int i;
    for (i = 0; i < 3; i++) pixels[3 * ROW * ACROSS + i] = 20000;  /* towards -x */
    s.environment.picture.pixels = pixels;
    s.environment.picture.format = SBL_PIXELS_FLOAT;
    s.environment.picture.width = ACROSS;
    s.environment.picture.height = DOWN;
    s.environment.picture.channels = 3;
    scene_floor(&s, scene_gloss(&s, 1, 1, 1, 1, 0.2), 0, 0.5f);
    if (!shoot(&p, &s, &view)) return;
    for (i = 0; i < CUT * CUT; i++) {
        const double theta = TEST_PI * (ROW + (i / CUT + 0.5) / CUT) / DOWN;
        const double phi = 2 * TEST_PI * ((i % CUT + 0.5) / CUT / ACROSS - 0.5);
        double w[3];
        set3(w, sin(theta) * cos(phi), sin(theta) * sin(phi), cos(theta));
        wanted += 20000 * size * sin(theta) * w[2] * lobe_brdf(v, w, 0.2, 1);
    }
    mean = mean_reflected(&p, 0);
    for (i = 0; i < SIDE * SIDE; i++) squares += pow(reflected(&p, i % SIDE, i / SIDE, 0) - mean, 2) / SIDE / SIDE;
    printf("    %.4f of %.4f, pixels differ by %.4f of it\n", mean, wanted, sqrt(squares) / wanted);
    CHECK(fabs(mean / wanted - 1) < 0.02, "the plate shows %.4f, not %.4f", mean, wanted);
    CHECK(sqrt(squares) < 0.1 * wanted, "pixels differ by %.4f of the highlight", sqrt(squares) / wanted);
    forget(&p);
    scene_free(&s);
}

/* >>far from the origin */

enum { FAR_SIDE = 8 };
static const float far_off[3] = { 4096, -2048, 3072 };

/* Makes a scene 2 high, and a view of it. kind: 0: a light above plastic, 1: a lamp above metal, 2: a lamp in a mirror,
   3: a lamp behind a pane. at: where the middle of its floor is */
static void scene_far(test_scene *s, sbl_picture_desc *view, int kind, const float at[3]) {
    const int surface = kind == 3 ? scene_pane(s, 0.9, 0.7, 0.8, 1)
        : scene_gloss(s, 0.9, 0.5, 0.2, kind > 0, kind == 2 ? 0.02 : 0.2);
    scene_floor(s, surface, 0, 1);
    if (kind == 0) {
        float *position = scene_light(s, SBL_LIGHT_POINT, 3, 2, 1)->position;
        position[0] = -1.5f;
        position[1] = 1.5f;
        position[2] = -0.25f;
    } else if (kind == 3) scene_floor(s, scene_lamp(s, 3, 2, 1), -1, 4);
    else scene_quad(s, scene_lamp(s, 3, 2, 1), -1.75f, 1.25f, -0.25f, -1.75f, 1.25f, 0.25f, -1.25f, 1.75f, 0.25f,
                    -1.25f, 1.75f, -0.25f);
    scene_scale_and_move(s, 1, at[0], at[1], at[2]);
    *view = scene_plain(scene_view(FAR_SIDE, FAR_SIDE, 4, at[0] + 1.5f, at[1] + 1.5f, at[2] + 0.25f, at[0], at[1],
                                   at[2]), SBL_MODE_DIRECT, 0);
    view->options.rays = kind == 1 ? 1024 : 64;
}

/* Highlights, mirrors and panes look the same if the scene moves away by 2,700 times its height. The steps of floats
   are 1 / 2,048 there, in which the camera and the corners are rounded. */
TEST(distance_keeps_highlights) {
    static const float here[3] = { 0, 0, 0 };
    int kind, i, k;
    for (kind = 0; kind < 4; kind++) {
        double worst = 0, worst_place = 0, largest = 0;
        test_scene near_s = { 0 }, far_s = { 0 };
        sbl_picture_desc near_view, far_view;
        shot p, q;
        scene_far(&near_s, &near_view, kind, here);
        scene_far(&far_s, &far_view, kind, far_off);
        if (!shoot(&p, &near_s, &near_view)) return;
        for (i = 0; i < FAR_SIDE * FAR_SIDE; i++) {
            at(&p, SBL_CHANNEL_FINAL, i % FAR_SIDE, i / FAR_SIDE);
            at(&p, SBL_CHANNEL_POSITION, i % FAR_SIDE, i / FAR_SIDE);
        }
        if (!shoot(&q, &far_s, &far_view)) return;
        for (i = 0; i < 3 * FAR_SIDE * FAR_SIDE; i++) {
            const int x = i / 3 % FAR_SIDE, y = i / 3 / FAR_SIDE;
            const double wanted = (double)at(&p, SBL_CHANNEL_FINAL, x, y)[i % 3];
            const double place = (double)at(&q, SBL_CHANNEL_POSITION, x, y)[i % 3] - (double)far_off[i % 3];
            k = i % 3;
            largest = test_max(largest, wanted);
            worst = test_max(worst, fabs((double)at(&q, SBL_CHANNEL_FINAL, x, y)[k] - wanted));
            worst_place = test_max(worst_place, fabs(place - (double)at(&p, SBL_CHANNEL_POSITION, x, y)[k]));
        }
        printf("    kind %d: off by %.3f %% of the largest value %.3f; positions by %.5f\n", kind,
               100 * worst / largest, largest, worst_place);
        CHECK(worst < 0.01 * largest && worst_place < 0.002, "kind %d: light is off by %.2f %%, positions by %.5f",
              kind, 100 * worst / largest, worst_place);
        forget(&p);
        forget(&q);
        scene_free(&near_s);
        scene_free(&far_s);
    }
}

/* Everything that has a position moves with the scene: bounds, the camera that is chosen, inspected sensors, readings,
   probes, and lights that are set later. */
TEST(distance_moves_positions) {
    static const float here[3] = { 0, 0, 0 };
    float light[2][4], scale[2];
    sbl_site site;
    int away, k;
    for (away = 0; away < 2; away++) {
        const float *to = away ? far_off : here;
        test_scene s = { 0 };
        sbl_picture_desc view, whole = sbl_picture_desc_defaults(NULL);
        sbl_readings_desc readings;
        sbl_probes_desc probes;
        sbl_reading reading;
        sbl_sensor sensor;
        sbl_probe probe;
        sbl_bounds bounds;
        shot p;
        scene_far(&s, &view, 0, to);
        if (!shoot(&p, &s, &view)) return;
        bounds = sbl_query_bounds(context);
        for (k = 0; k < 3; k++)
            CHECK(bounds.lowest[k] == to[k] - (k != 1) && bounds.highest[k] == to[k] + (k != 1), "bounds %d: %g %g", k,
                  (double)bounds.lowest[k], (double)bounds.highest[k]);
        CHECK(sbl_inspect_sensor(context, 4, 4, &sensor, NULL, NULL, 0) == SBL_SUCCESS, "no sensor");
        for (k = 0; k < 3; k++)
            CHECK(fabs((double)(sensor.site.position[k] - at(&p, SBL_CHANNEL_POSITION, 4, 4)[k])) < 0.002 &&
                  fabs((double)(sensor.position[k] - sensor.site.position[k])) < 0.002, "the sensor is elsewhere");
        memset(&site, 0, sizeof site);
        for (k = 0; k < 3; k++) site.position[k] = to[k] + 0.25f * (float)(k != 1);
        site.normal[1] = 1;
        readings = scene_readings(&site, &reading, 1, SBL_MODE_DIRECT);
        CHECK(sbl_gather_readings(context, &readings) == SBL_SUCCESS && reading.valid, "no reading");
        light[away][0] = reading.radiance[0];
        memset(&probes, 0, sizeof probes);
        memset(&probe, 0, sizeof probe);
        probes.probes = &probe;
        probes.grid[0] = probes.grid[1] = probes.grid[2] = probes.probe_count = 1;
        probes.lowest[0] = to[0] - 0.5f;
        probes.highest[0] = to[0] + 0.5f;
        probes.lowest[1] = probes.highest[1] = to[1] + 0.5f;
        probes.lowest[2] = probes.highest[2] = to[2];
        probes.options.mode = SBL_MODE_DIRECT;
        CHECK(sbl_bake_probes(context, &probes) == SBL_SUCCESS, "no probe");
        for (k = 0; k < 3; k++)
            CHECK(probe.position[k] == to[k] + 0.5f * (float)(k == 1), "the probe is at %g", (double)probe.position[k]);
        light[away][1] = probe.sh[0][0];
        memset(probes.lowest, 0, sizeof probes.lowest);
        memset(probes.highest, 0, sizeof probes.highest);
        CHECK(sbl_bake_probes(context, &probes) == SBL_SUCCESS && probe.position[0] == to[0], "the grid is elsewhere");
        s.lights[0].position[1] -= 1;
        CHECK(sbl_set_lights(context, s.lights, 1) == SBL_SUCCESS, "no lights");
        CHECK(sbl_gather_readings(context, &readings) == SBL_SUCCESS, "no reading");
        light[away][2] = reading.radiance[0];
        whole.width = whole.height = FAR_SIDE;
        whole.options.mode = SBL_MODE_DIRECT;
        forget(&p);
        REQUIRE(sbl_render_picture(context, &whole) == SBL_SUCCESS, "no picture");
        p.view = whole;
        p.context = context;
        scale[away] = at(&p, SBL_CHANNEL_DEPTH, 4, 4)[0];
        light[away][3] = at(&p, SBL_CHANNEL_ALBEDO, 4, 4)[0];
        forget(&p);
        scene_free(&s);
    }
    for (k = 0; k < 4; k++)
        CHECK(light[0][k] > 0 && fabs((double)(light[1][k] / light[0][k]) - 1) < 0.005, "value %d: %g, and far away %g",
              k, (double)light[0][k], (double)light[1][k]);
    CHECK(fabs((double)(scale[1] / scale[0]) - 1) < 0.005, "the camera is elsewhere");
}

/* >>panes */

/* Adds a light that is off and a distant pane, so that all scenes of these tests use the same programs. */
static void scene_company(test_scene *s) {
    scene_light(s, SBL_LIGHT_POINT, 0, 0, 0)->position[1] = 50;
    scene_floor(s, scene_pane(s, 1, 1, 1, 1), -60, 0.1f);
}

/* A viewer at 50 degrees sees a lamp of radiance 3 2 1 through panes and blended surfaces. The last panes also mirror a
   sky of radiance 0.5. */
TEST(lamps_behind_panes) {
    static const double tint[3] = { 0.9, 0.7, 0.8 };
    static const char *const names[8] = { "a pane", "two panes", "without reflections", "blended", "a blended pane",
        "a half transparent pane", "a pane under the sky", "a rough pane under the sky" };
    int kind, i, k;
    for (kind = 0; kind < 8; kind++) {
        const sbl_picture_desc view = view_of_plate(4, 4, 8, 50, 16);
        test_scene s = { 0 };
        sbl_mesh *pane;
        double worst = 0;
        shot p;
        int number = kind == 3 ? scene_material(&s, 0, 0, 0)
            : scene_pane(&s, tint[0], tint[1], tint[2], kind == 5 ? 0.8 : 1);
        if (kind == 2) s.materials[number].ior = 0;
        pane = scene_floor(&s, number, 0, 1);
        if (kind == 3 || kind == 4) scene_blend(&s, pane, 0.25f);
        if (kind == 1) scene_floor(&s, number, 0.3f, 1);
        if (kind >= 6) scene_sky(&s, 0.5f, 0.5f, 0.5f);
        if (kind == 7) s.materials[number].roughness = 0.6f;
        scene_company(&s);
        scene_floor(&s, scene_lamp(&s, 3, 2, 1), -1, 4);
        if (!shoot(&p, &s, &view)) return;
        for (i = 0; i < 16; i++) {
            double way[3];
            look(&view, i % 4, i / 4, way);
            for (k = 0; k < 3; k++) {
                const double fresnel = lobe__fresnel(-way[1], 0.04);
                const double got = (double)at(&p, SBL_CHANNEL_FINAL, i % 4, i / 4)[k];
                double through = tint[k] * (1 - fresnel);
                if (kind == 1) through *= through;
                if (kind == 2) through = tint[k];
                if (kind == 3) through = 0.75;
                if (kind == 4) through = 0.75 + 0.25 * through;
                if (kind == 5) through *= 0.8;
                if (kind == 6) through += fresnel * 0.5 / (3 - k);
                if (kind == 7) through += lobe__albedo(-way[1], 0.6, 0.04, 96) * 0.5 / (3 - k);
                worst = test_max(worst, fabs(got / (3 - k) / through - 1));
            }
        }
        printf("    %s: %.4f %%\n", names[kind], 100 * worst);
        CHECK(worst < 0.002, "%s: transmittance is off by %.3f %%", names[kind], 100 * worst);
        forget(&p);
        scene_free(&s);
    }
}

/* Light reaches a floor through panes: R equals R without panes times their transmittance, seen by a camera below the
   panes. Then the camera looks at the same floor through the panes. */
enum { PANES = 6, BLENDED = 12 };
static const double pane_tint[3] = { 0.9, 0.7, 0.8 };

/* Adds one of the cases of panes at a height above a floor. */
static void scene_panes(test_scene *s, int kind, float height) {
    const int number = kind == 2 || kind == 5 ? scene_material(s, 0, 0, 0)
        : scene_pane(s, pane_tint[0], pane_tint[1], pane_tint[2], kind == 3 ? 0.7 : 1);
    sbl_mesh *pane = scene_floor(s, number, height, 3);
    int i;
    if (kind == 2 || kind == 4) scene_blend(s, pane, 0.25f);
    if (kind == 1) scene_floor(s, number, height + 0.1f, 3);
    if (kind == 5) scene_blend(s, pane, 0.05f);
    for (i = 1; kind == 5 && i < BLENDED; i++)
        scene_blend(s, scene_floor(s, number, height + 0.01f * (float)i, 3), 0.05f);
    if (kind == 4) {  /* a mask that is cut out everywhere */
        s->materials[number].flags = 0;
        s->materials[number].alpha_cutoff = 0.5f;
    }
}

/* Returns the share of light that passes in channel k. */
static double passing(int kind, double cosine, int k) {
    const double one = pane_tint[k] * (1 - lobe__fresnel(cosine, 0.04));
    if (kind == 5) return pow(0.95, BLENDED);
    return kind == 0 ? one : kind == 1 ? one * one : kind == 2 ? 0.75 : kind == 3 ? 0.7 * one : 1;
}

/* Compares a floor with panes and without. lamp: 1: an emitting lamp, 0: a light. through: 1: the camera is above the
   panes, and the light is below */
static void floor_behind(int kind, int lamp, int through) {
    static const char *const names[PANES] = { "a pane", "two panes", "blended", "a half transparent pane", "a mask",
                                             "twelve blended" };
    enum { SIDE = 6 };
    const sbl_picture_desc view = scene_plain(scene_view(SIDE, SIDE, 12, 1, 0.6f, 0.5f, 0, 0, 0), SBL_MODE_DIRECT, 0);
    double expected[SIDE * SIDE][3], worst = 0;
    int panes, i, k;
    for (panes = 0; panes < 2; panes++) {
        test_scene s = { 0 };
        shot p;
        scene_floor(&s, scene_material(&s, 0.8f, 0.8f, 0.8f), 0, 1);
        if (lamp) {
            const int bright = scene_lamp(&s, 300, 200, 100);
            scene_quad(&s, bright, -4, 5, -0.1f, -4, 5, 0.1f, -3.8f, 5, 0.1f, -3.8f, 5, -0.1f);
        } else {
            sbl_light *l = scene_light(&s, SBL_LIGHT_POINT, 30, 20, 10);
            l->position[0] = through ? -0.4f : -3.9f;
            l->position[1] = through ? 0.25f : 5;
        }
        if (panes) scene_panes(&s, kind, through ? 0.3f : 1);
        scene_company(&s);
        if (!shoot(&p, &s, &view)) return;
        for (i = 0; i < SIDE * SIDE; i++)
            for (k = 0; k < 3; k++) {
                const int x = i % SIDE, y = i / SIDE;
                const float *position = at(&p, SBL_CHANNEL_POSITION, x, y);
                const double got = (double)at(&p, through ? SBL_CHANNEL_FINAL : SBL_CHANNEL_RADIANCE, x, y)[k];
                double to[3], way[3];
                if (!panes) { expected[i][k] = got; continue; }
                set3(to, -3.9 - (double)position[0], 5, -(double)position[2]);
                unit(to);
                look(&view, x, y, way);
                worst = test_max(worst, fabs(got / expected[i][k] / passing(kind, through ? -way[1] : to[1], k) - 1));
            }
        forget(&p);
        scene_free(&s);
    }
    printf("    %s, %s%s: %.4f %%\n", names[kind], lamp ? "a lamp" : "a light", through ? ", seen through" : "",
           100 * worst);
    /* Each pane moves the ray a little (SBL_OFFSET). */
    CHECK(worst < (kind == 5 ? 0.01 : 0.002), "%s, lamp %d, seen through %d: light is off by %.3f %%", names[kind],
          lamp, through, 100 * worst);
}

TEST(floors_behind_panes) {
    int i;
    for (i = 0; i < 3 * PANES; i++) floor_behind(i / 3, i % 3 == 1, i % 3 == 2);
}

/* Meshes that sbl_set_mesh_transform moves away together, and back again, look the same as before. Lights may be set
   before the meshes move, or after that. */
TEST(distance_of_moved_meshes) {
    static const float here[3] = { 0, 0, 0 };
    double largest = 0, worst[2] = { 0, 0 };
    test_scene s = { 0 };
    sbl_picture_desc view;
    shot p, q;
    int way, i, k;
    scene_far(&s, &view, 0, here);
    if (!shoot(&p, &s, &view)) return;
    for (i = 0; i < FAR_SIDE * FAR_SIDE; i++) at(&p, SBL_CHANNEL_FINAL, i % FAR_SIDE, i / FAR_SIDE);
    for (way = 0; way < 2; way++) {
        const float *to = way ? here : far_off, sign = way ? -1 : 1;
        const float move[16] = { 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, to[0], to[1], to[2], 1 };
        for (k = 0; k < 3; k++) s.lights[0].position[k] += sign * far_off[k];
        if (way) CHECK(sbl_set_lights(context, s.lights, 1) == SBL_SUCCESS, "no lights");
        for (i = 0; i < s.mesh_count; i++)
            CHECK(sbl_set_mesh_transform(context, i, move) == SBL_SUCCESS, "mesh %d does not move", i);
        if (!way) CHECK(sbl_set_lights(context, s.lights, 1) == SBL_SUCCESS, "no lights");
        memset(&q, 0, sizeof q);
        q.context = context;
        q.view = scene_plain(scene_view(FAR_SIDE, FAR_SIDE, 4, to[0] + 1.5f, to[1] + 1.5f, to[2] + 0.25f, to[0], to[1],
                                        to[2]), SBL_MODE_DIRECT, 0);
        q.view.options.rays = 64;
        REQUIRE(sbl_render_picture(context, &q.view) == SBL_SUCCESS, "no picture");
        for (i = 0; i < 3 * FAR_SIDE * FAR_SIDE; i++) {
            const int x = i / 3 % FAR_SIDE, y = i / 3 / FAR_SIDE;
            const double wanted = (double)at(&p, SBL_CHANNEL_FINAL, x, y)[i % 3];
            largest = test_max(largest, wanted);
            worst[way] = test_max(worst[way], fabs((double)at(&q, SBL_CHANNEL_FINAL, x, y)[i % 3] - wanted));
        }
        CHECK(worst[way] < 0.01 * largest, "%s: light is off by %.2f %%", way ? "back" : "away",
              100 * worst[way] / largest);
        forget(&q);
    }
    printf("    off by %.3f %% of the largest value far away, %.3f %% after the return\n", 100 * worst[0] / largest,
           100 * worst[1] / largest);
    forget(&p);
    scene_free(&s);
}

/* Each of several panes at the same place tints the light that passes, also if they are many. */
TEST(panes_at_one_place_all_tint) {
    static const int counts[3] = { 1, 3, 24 };
    double without = 0;
    int i, k;
    for (i = 0; i < 4; i++) {
        test_scene s = { 0 };
        const int pane = scene_pane(&s, 0.95, 0.95, 0.95, 1), count = i ? counts[i - 1] : 0;
        sbl_readings_desc desc;
        sbl_site site;
        sbl_reading reading;
        sbl_scene_desc scene;
        s.materials[pane].ior = 0;
        for (k = 0; k < count; k++) scene_floor(&s, pane, 1, 2);
        scene_floor(&s, scene_material(&s, 0.5f, 0.5f, 0.5f), 0, 1);
        scene_company(&s);
        scene_light(&s, SBL_LIGHT_POINT, 3, 3, 3)->position[1] = 2;
        scene = scene_desc(&s);
        memset(&site, 0, sizeof site);
        site.position[0] = 0.3f;
        site.normal[1] = 1;
        desc = scene_readings(&site, &reading, 1, SBL_MODE_DIRECT);
        REQUIRE(sbl_set_scene(context, &scene) == SBL_SUCCESS && sbl_gather_readings(context, &desc) == SBL_SUCCESS,
                "no reading");
        if (i == 0) without = (double)reading.radiance[0];
        CHECK(fabs((double)reading.radiance[0] / without / pow(0.95, count) - 1) < 0.002, "%d panes pass %.4f of %.4f",
              count, (double)reading.radiance[0] / without, pow(0.95, count));
        scene_free(&s);
    }
}

/* A blended surface shows the surfaces behind it, and its own share of emission and of reflected light. Where most
   light passes, the reflected light is stored light. */
TEST(blended_surfaces_show_themselves) {
    static const float alphas[3] = { 0.25f, 0.5f, 0.75f };
    int kind, i;
    for (kind = 0; kind < 6; kind++) {
        const float alpha = alphas[kind % 3];
        sbl_picture_desc view = view_of_plate(4, 4, 8, 50, 16);
        test_scene s = { 0 };
        shot p;
        double wanted, worst = 0;
        const int number = scene_material(&s, 0.8f, 0.8f, 0.8f);
        if (kind < 3) s.materials[number].emission[0] = 2;
        scene_blend(&s, scene_floor(&s, number, 0, 1), alpha);
        scene_floor(&s, scene_lamp(&s, 3, 2, 1), -1, 40);
        s.materials[number + 1].flags = SBL_MATERIAL_ONE_SIDED_EMISSION;
        if (kind >= 3) {
            view.options.mode = SBL_MODE_GI;
            scene_light(&s, SBL_LIGHT_DIRECTIONAL, 5, 5, 5)->direction[1] = -1;
            wanted = 0.8 * 5 / TEST_PI;
        } else wanted = 2;
        scene_company(&s);
        if (!shoot(&p, &s, &view)) return;
        wanted = (1 - (double)alpha) * 3 + (double)alpha * wanted;
        for (i = 0; i < 16; i++)
            worst = test_max(worst, fabs((double)at(&p, SBL_CHANNEL_FINAL, i % 4, i / 4)[0] / wanted - 1));
        printf("    %s, alpha %.2f: %.4f %%\n", kind < 3 ? "emits" : "reflects", (double)alpha, 100 * worst);
        CHECK(worst < (kind < 3 ? 0.002 : 0.01), "%s, alpha %g: %.4f, not %.4f",
              kind < 3 ? "emits" : "reflects", (double)alpha, (double)at(&p, SBL_CHANNEL_FINAL, 0, 0)[0], wanted);
        forget(&p);
        scene_free(&s);
    }
}

/* >>rooms */

/* In a closed room whose walls have the radiance 1, by emission alone or half by reflection, white metal of roughness
   0.1 loses no light, and does not change the light of the walls. Plastic and rough metal show their albedo. */
TEST(furnace_of_a_room) {
    enum { SIDE = 32 };
    int kind, i;
    for (kind = 0; kind < 5; kind++) {
        test_scene s = { 0 };
        const int metal = kind < 2 || kind == 3, lit = kind == 1;  /* lit: 0: walls emit 1; 1: 0.5 */
        const double roughness = kind == 3 ? 0.6 : kind == 4 ? 0.3 : 0.1;
        const int walls = lit ? scene_material(&s, 0.5f, 0.5f, 0.5f) : scene_lamp(&s, 1, 1, 1);
        const int body = scene_gloss(&s, 1, 1, 1, metal, roughness);
        sbl_picture_desc view = scene_view(SIDE, SIDE, 60, 0, 0, 2.9f, 0, 0, 0);
        double table[ANGLES + 1], mean = 0, wanted = 0, mean_wall = 0, walls_seen = 0, most = 0, count = 0, off2 = 0;
        double predicted;
        shot p;
        for (i = 0; i < 3; i++) s.materials[walls].emission[i] = lit ? 0.5f : 1;
        scene_box(&s, walls, -3, -3, -3, 3, 3, 3);
        scene_sphere(&s, body, 0, 0, 0, 1, 64, 32, 1)->id = 50;
        view.options.mode = SBL_MODE_GI;
        view.samples = 1;
        furnace_table(roughness, metal, table);
        if (!shoot(&p, &s, &view)) return;
        for (i = 0; i < SIDE * SIDE; i++) {
            const int x = i % SIDE, y = i / SIDE;
            const double shown = (double)at(&p, SBL_CHANNEL_FINAL, x, y)[1];
            double here;
            if (at(&p, SBL_CHANNEL_ID, x, y)[0] != 50) { mean_wall += shown; walls_seen++; continue; }
            here = look_up(table, cosine_at(&p, x, y));
            most = test_max(most, shown / here);
            off2 += (shown - here) * (shown - here);
            mean += shown;
            wanted += here;
            count++;
        }
        predicted = (double)sbl_query_stats(context).picture.specular_error;
        printf("    roughness %.1f, %s, %s: %.4f times as bright, at most %.3f times, error %.4f, %.4f predicted, "
               "walls %.4f\n", roughness, metal ? "metal" : "plastic", lit ? "walls reflect" : "lamps", mean / wanted,
               most, sqrt(off2 / (SIDE * SIDE)), predicted, mean_wall / walls_seen);
        CHECK(count > 200 && fabs(mean / wanted - 1) < 0.02, "kind %d: %.4f times as bright", kind, mean / wanted);
        CHECK(!lit || fabs(mean_wall / walls_seen - 1) < 0.02, "kind %d: walls %.4f", kind, mean_wall / walls_seen);
        CHECK(sqrt(off2 / (SIDE * SIDE)) < 0.02 && most < 1.5, "kind %d: error %.4f, at most %.3f times", kind,
              sqrt(off2 / (SIDE * SIDE)), most);
        forget(&p);
        scene_free(&s);
    }
}

/* Returns the descriptor of `count` readings, with all bounces, at the same place: a floor at the origin. */
static sbl_readings_desc floor_readings(sbl_reading *readings, int count, int rays) {
    static sbl_site sites[256];
    sbl_readings_desc desc = scene_readings(sites, readings, count, SBL_MODE_GI);
    int i;
    for (i = 0; i < count; i++) sites[i].normal[1] = sites[i].geometric_normal[1] = 1;
    desc.options.rays = rays;
    return desc;
}

/* Returns the standard deviation of R, in green, of some readings. mean: receives their mean */
static double deviation_of(const sbl_reading *readings, int count, double *mean) {
    double squares = 0;
    int i;
    *mean = 0;
    for (i = 0; i < count; i++) *mean += (double)readings[i].radiance[1] / count;
    for (i = 0; i < count; i++) squares += pow((double)readings[i].radiance[1] - *mean, 2) / count;
    return sqrt(squares);
}

/* Returns R of a floor, under the sky or a lamp, beside a wall: black if `metal` is 0, white metal if it is 1, black
   gloss if it is -1. R is the mean of readings of this many rays. spread: receives their standard deviation */
static double readings_beside(int metal, int lamp, double roughness, int rays, double *spread) {
    enum { RAYS = 32768, SITES = 256 };
    const int count = RAYS / rays;
    sbl_reading readings[SITES];
    const sbl_readings_desc desc = floor_readings(readings, count, rays);
    sbl_scene_desc scene;
    test_scene s = { 0 };
    const int wall = metal > 0 ? scene_gloss(&s, 1, 1, 1, 1, roughness) : metal < 0 ?
        scene_gloss(&s, 0, 0, 0, 0, roughness) : scene_material(&s, 0, 0, 0);
    double mean;
    memset(readings, 0, sizeof readings);
    scene_quad(&s, wall, -0.2f, 0, -60, -0.2f, 0, 60, -0.2f, 60, 60, -0.2f, 60, -60);
    if (lamp) scene_quad(&s, scene_lamp(&s, 1, 1, 1), 0.5f, 1.5f, -1, 0.5f, 1.5f, 1, 2.5f, 1.5f, 1, 2.5f, 1.5f, -1);
    else scene_sky(&s, 1, 1, 1);
    scene = scene_desc(&s);
    CHECK(sbl_set_scene(context, &scene) == SBL_SUCCESS && sbl_gather_readings(context, &desc) == SBL_SUCCESS,
          "no reading: %s", watch_last(&seen));
    scene_free(&s);
    *spread = deviation_of(readings, count, &mean);
    return mean;
}

static double beside_a_wall(int metal, int lamp, double roughness) {
    double spread;
    return readings_beside(metal, lamp, roughness, 2048, &spread);
}

/* Walls of metal reflect the sky and a lamp to the floor beside them. For light that rays find by way of mirrors, a
   mirror has the roughness 0.3, because such light is blurred. The light of the lamp is a sum of lobe_brdf over 400 x
   400 directions and 60 x 60 points of the lamp. */
TEST(metal_lights_floors) {
    static const struct { double roughness, sky, lamp; } cases[3] = {
        { 0, 0.976, 0.0944 }, { 0.3, 0.976, 0.0944 }, { 0.45, 0.948, 0.0858 } };
    const double half = beside_a_wall(0, 0, 0), lamp = beside_a_wall(0, 1, 0);
    int i;
    CHECK(fabs(half - 0.5) < 0.005, "a black wall leaves %.4f of the sky", half);
    for (i = 0; i < 3; i++) {
        const double sky = beside_a_wall(1, 0, cases[i].roughness);
        const double added = beside_a_wall(1, 1, cases[i].roughness) - lamp;
        printf("    roughness %.2f: sky %.4f of %.4f, lamp %.4f of %.4f\n", cases[i].roughness, sky,
               cases[i].sky, added, cases[i].lamp);
        CHECK(fabs(sky / cases[i].sky - 1) < 0.01, "roughness %g: %.4f of the sky", cases[i].roughness, sky);
        CHECK(fabs(added / cases[i].lamp - 1) < 0.03, "roughness %g: the wall adds %.4f, not %.4f", cases[i].roughness,
              added, cases[i].lamp);
    }
}

/* Readings of 128 rays differ little where metal reflects a lamp to the floor, because each ray that meets the metal
   chooses among points of the lamp. With one point per ray, they would differ by 0.0116. */
TEST(metal_lights_floors_evenly) {
    double spread, mean = readings_beside(1, 1, 0.45, 128, &spread);
    printf("    readings of mean %.4f differ by %.4f\n", mean, spread);
    CHECK(spread < 0.0095, "the readings differ by %.4f", spread);
}

/* A wall of black gloss reflects the sky to the floor beside it, mostly at grazing angles. The floor sees the wall at a
   cosine c with the weight 2 / pi (1 - c^2)^(1/2), so that the wall adds more than twice its mean albedo of 0.08. */
TEST(gloss_lights_floors) {
    enum { STEPS = 200 };
    int kind, i;
    for (kind = 0; kind < 2; kind++) {
        const double roughness = 0.3 + 0.15 * kind, added = beside_a_wall(-1, 0, roughness) - 0.5;
        double wanted = 0;
        for (i = 0; i < STEPS; i++) {
            const double c = (i + 0.5) / STEPS;
            wanted += 2 / TEST_PI * sqrt(1 - c * c) * lobe__albedo(c, roughness, 0.04, 128) / STEPS;
        }
        printf("    roughness %.2f: the wall adds %.4f of %.4f\n", roughness, added, wanted);
        CHECK(fabs(added / wanted - 1) < 0.03, "roughness %g: the wall adds %.4f, not %.4f", roughness, added, wanted);
    }
}

/* Returns R on the floor of a tall tube of metal whose lid is lit by a lamp below it, which only shines upwards.
   reflectance: of the lid, along its normal */
static double below_a_lid(double reflectance) {
    enum { SITES = 64 };
    static sbl_reading readings[SITES];
    const sbl_readings_desc desc = floor_readings(readings, SITES, 512);
    test_scene s = { 0 };
    const int tube = scene_gloss(&s, 1, 1, 1, 1, 0.3), lamp = scene_lamp(&s, 30, 30, 30);
    const int lid = scene_gloss(&s, reflectance, reflectance, reflectance, 1, 0.4);
    sbl_scene_desc scene;
    double mean = 0;
    int i;
    s.materials[lamp].flags = SBL_MATERIAL_ONE_SIDED_EMISSION;
    scene_box(&s, tube, -0.5f, -0.001f, -0.5f, 0.5f, 3, 0.5f);
    scene_floor(&s, scene_material(&s, 0, 0, 0), 0, 0.5f);
    scene_floor(&s, lid, 2.999f, 0.5f);
    scene_quad(&s, lamp, -0.2f, 2.8f, -0.2f, -0.2f, 2.8f, 0.2f, 0.2f, 2.8f, 0.2f, 0.2f, 2.8f, -0.2f);
    scene = scene_desc(&s);
    CHECK(sbl_set_scene(context, &scene) == SBL_SUCCESS && sbl_gather_readings(context, &desc) == SBL_SUCCESS,
          "no reading: %s", watch_last(&seen));
    for (i = 0; i < SITES; i++) mean += (double)readings[i].radiance[1] / SITES;
    scene_free(&s);
    return mean;
}

/* Light arrives at a floor by way of metal and then a lid. It makes little difference whether the lid counts as metal
   (SBL__STRONG), at which all rays continue, or as gloss. Where rays end, metal has its mean albedo, and gloss has the
   albedo for the direction of the ray, which is lower here. */
TEST(weak_metal_is_like_strong_gloss) {
    const double gloss = below_a_lid(0.199), metal = below_a_lid(0.201);
    printf("    R below a lid of gloss %.4f, of metal %.4f\n", gloss, metal);
    CHECK(gloss > 0 && fabs(gloss / metal - 1) < 0.15, "R is %.4f below gloss, %.4f below metal", gloss, metal);
}

/* The same wall also reflects a lamp to the floor, mostly at angles at which it reflects less than a tenth. The light
   is a sum as for metal. */
TEST(gloss_mirrors_lamps_to_floors) {
    static const double wanted[2] = { 0.00461, 0.00418 };
    const double lamp = beside_a_wall(0, 1, 0);
    int kind;
    for (kind = 0; kind < 2; kind++) {
        const double roughness = 0.3 + 0.15 * kind, added = beside_a_wall(-1, 1, roughness) - lamp;
        printf("    roughness %.2f: lamp %.5f of %.5f\n", roughness, added, wanted[kind]);
        CHECK(fabs(added / wanted[kind] - 1) < 0.06, "roughness %g: the wall adds %.5f of the lamp, not %.5f",
              roughness, added, wanted[kind]);
    }
}

/* In a box of red panes, which pass no green light, the light of the sky is red in the store, whether it comes straight
   through a pane or by way of metal. */
TEST(stored_light_behind_red_panes_is_red) {
    enum { SIDE = 8 };
    const sbl_picture_desc view = scene_plain(scene_view(SIDE, SIDE, 40, 0.31f, 1.8f, 0, 0.3f, 0, 0), SBL_MODE_GI, 0);
    test_scene s = { 0 };
    const int floor = scene_material(&s, 0.5f, 0.5f, 0.5f), metal = scene_gloss(&s, 1, 1, 1, 1, 0.3);
    double least = 2, green = 0;
    shot p;
    int i;
    scene_quad(&s, floor, -0.8f, 0, -0.8f, -0.8f, 0, 0.8f, 0.8f, 0, 0.8f, 0.8f, 0, -0.8f);
    scene_quad(&s, metal, -0.3f, 0, -0.8f, -0.3f, 0, 0.8f, -0.3f, 1.5f, 0.8f, -0.3f, 1.5f, -0.8f);
    scene_box(&s, scene_pane(&s, 1, 0, 0, 1), -1, -0.2f, -1, 1, 2, 1);
    scene_sky(&s, 1, 1, 1);
    if (!shoot(&p, &s, &view)) return;
    for (i = 0; i < SIDE * SIDE; i++) {
        const float *stored = at(&p, SBL_CHANNEL_STORE, i % SIDE, i / SIDE);
        if (!(at(&p, SBL_CHANNEL_POSITION, i % SIDE, i / SIDE)[0] > -0.29f)) continue;
        least = test_min(least, (double)stored[0]);
        green = test_max(green, (double)stored[1]);
    }
    printf("    red at least %.3f, green at most %.5f\n", least, green);
    CHECK(least > 0.7 && least < 1 && green < 1e-3, "red is at least %.3f, green at most %.5f", least, green);
    forget(&p);
    scene_free(&s);
}

/* Adds a square whose normal is z. half: half of its side */
static sbl_mesh *scene_upright(test_scene *s, int material, float z, float half) {
    return scene_quad(s, material, -half, -half, z, half, -half, z, half, half, z, -half, half, z);
}

/* In a room where all light is 1, surfaces that let light pass are white in each other's mirrors and one behind the
   other: a pane that a pane mirrors, a mirror and a blended surface behind another one, and panes between two mirrors,
   of which pixels show only a few. */
TEST(panes_in_furnaces_are_white) {
    enum { SIDE = 8 };
    int kind, i;
    for (kind = 0; kind < 4; kind++) {
        test_scene s = { 0 };
        const int wall = scene_material(&s, 0.5f, 0.5f, 0.5f), matte = scene_material(&s, 0.4f, 0.4f, 0.4f);
        const int pane = scene_pane(&s, 1, 1, 1, 1), mirror = scene_gloss(&s, 1, 1, 1, 1, 0);
        sbl_picture_desc view = scene_view(SIDE, SIDE, 8, 0, 0, 1, 0, 0, 0);
        double least = 2, most = 0;
        shot p;
        for (i = 0; i < 3; i++) s.materials[wall].emission[i] = 0.5f;
        for (i = 0; i < 3; i++) s.materials[matte].emission[i] = 0.6f;
        scene_box(&s, wall, -2, -2, -2, 2, 2, 2);
        if (kind == 0) {
            view = scene_view(SIDE, SIDE, 4, 0, 0.15f, 0.9f, 0, 0, -0.1f);
            scene_floor(&s, pane, 0, 1);
            scene_upright(&s, pane, -1.1f, 1);
        } else if (kind == 3) {
            view = scene_view(SIDE, SIDE, 8, 0, 0, 0.3f, 0.01f, 0.02f, 0);
            scene_upright(&s, mirror, -0.5f, 1);
            scene_upright(&s, pane, 0, 1);
            scene_upright(&s, mirror, 0.5f, 1);
        } else {
            scene_blend(&s, scene_upright(&s, matte, 0, 1), 0.6f);
            if (kind == 1) scene_upright(&s, mirror, -0.5f, 1);
            else scene_blend(&s, scene_upright(&s, matte, -0.5f, 1), 0.6f);
        }
        view.options.mode = SBL_MODE_GI;
        view.samples = 1;
        if (!shoot(&p, &s, &view)) return;
        for (i = 0; i < SIDE * SIDE; i++) {
            const double shown = (double)at(&p, SBL_CHANNEL_FINAL, i % SIDE, i / SIDE)[1];
            least = test_min(least, shown);
            most = test_max(most, shown);
        }
        printf("    kind %d: %.3f to %.3f\n", kind, least, most);
        CHECK(least > 0.9 && most < 1.1, "kind %d: pixels show %.3f to %.3f", kind, least, most);
        forget(&p);
        scene_free(&s);
    }
}

/* Adds a ball of metal, a lamp beside it, and a plate that hides the lamp from the origin. slices: those of the lamp */
static void lamp_beside_a_ball(test_scene *s, int slices) {
    scene_sphere(s, scene_gloss(s, 1, 1, 1, 1, 0.3), 1, 0.6f, 0, 0.5f, 48, 24, 1);
    scene_sphere(s, scene_lamp(s, 50, 50, 50), 0.42f, 0.6f, 0, 0.05f, slices, slices / 2, 1);
    scene_quad(s, scene_material(s, 0, 0, 0), 0.4f, 0.48f, -0.1f, 0.4f, 0.48f, 0.1f, 0.3f, 0.55f, 0.1f, 0.3f, 0.55f,
               -0.1f);
}

/* Readings of a floor that sees a lamp only by way of a ball of metal differ from each other by less than 3.6 times
   their mean, whatever the number of the lamp's triangles. If rays to lamps were weighed by the triangle that was
   picked, and not by the whole lamp, the readings would differ by 4.3, 5.6 and 6.3 times their mean. */
TEST(lamps_of_many_triangles_add_no_noise) {
    enum { SITES = 256 };
    static const int slices[3] = { 8, 16, 40 };
    static sbl_reading readings[SITES];
    const sbl_readings_desc desc = floor_readings(readings, SITES, 128);
    double first = 0;
    int kind;
    for (kind = 0; kind < 3; kind++) {
        test_scene s = { 0 };
        double mean, spread;
        sbl_scene_desc scene;
        lamp_beside_a_ball(&s, slices[kind]);
        scene = scene_desc(&s);
        CHECK(sbl_set_scene(context, &scene) == SBL_SUCCESS && sbl_gather_readings(context, &desc) == SBL_SUCCESS,
              "no reading: %s", watch_last(&seen));
        scene_free(&s);
        spread = deviation_of(readings, SITES, &mean) / mean;
        if (!kind) first = spread;
        printf("    %d slices: readings of %.4f differ by %.2f of it\n", slices[kind], mean, spread);
        CHECK(spread < 3.6 && spread < 1.2 * first, "%d slices: readings differ by %.2f of their mean", slices[kind],
              spread);
    }
}

/* A lamp that grows after sbl_set_scene gives the same readings as one that has this size from the beginning. */
TEST(lamps_may_grow) {
    enum { SITES = 32 };
    static const float large[16] = { 2, 0, 0, 0, 0, 2, 0, 0, 0, 0, 2, 0, -0.42f, -0.6f, 0, 1 };
    static sbl_reading readings[2][SITES];
    test_scene s = { 0 };
    sbl_scene_desc scene;
    int later, i;
    lamp_beside_a_ball(&s, 8);
    for (later = 1; later >= 0; later--) {
        const sbl_readings_desc desc = floor_readings(readings[later], SITES, 128);
        memcpy(s.meshes[1].transform, large, later ? 0 : sizeof large);
        scene = scene_desc(&s);
        CHECK(sbl_set_scene(context, &scene) == SBL_SUCCESS, "no scene");
        if (later) CHECK(sbl_set_mesh_transform(context, 1, large) == SBL_SUCCESS, "the lamp does not grow");
        CHECK(sbl_gather_readings(context, &desc) == SBL_SUCCESS, "no reading: %s", watch_last(&seen));
    }
    for (i = 0; i < SITES; i++)
        CHECK(readings[1][i].valid && readings[1][i].radiance[1] > 0 &&
              memcmp(&readings[0][i], &readings[1][i], sizeof readings[0][i]) == 0, "reading %d: %g and %g", i,
              (double)readings[0][i].radiance[1], (double)readings[1][i].radiance[1]);
    scene_free(&s);
}

/* Returns the radiance that a black wall at x = -0.2 sends to the origin, which sees it in the unit direction `way`.
   The wall mirrors a light by a lobe. */
static double mirrored_radiance(const sbl_light *l, double roughness, double f0, const double way[3]) {
    double to[3], v[3], w[3], distance = 1;
    int k;
    for (k = 0; k < 3; k++) to[k] = -(double)l->direction[k];
    if (l->kind == SBL_LIGHT_POINT)
        for (k = 0; k < 3; k++) to[k] = (double)l->position[k] - way[k] * 0.2 / -way[0];
    distance = unit(to);
    if (l->kind != SBL_LIGHT_POINT) distance = 1;
    set3(v, -way[1], -way[2], -way[0]);
    set3(w, to[1], to[2], to[0]);
    return lobe_brdf(v, w, roughness, f0) * w[2] * (double)l->intensity[0] / (distance * distance);
}

/* Returns R that this wall adds on a floor at the origin. */
static double mirrored_wanted(const sbl_light *l, double roughness, double f0) {
    enum { STEPS = 800 };
    double sum = 0;
    int i;
    for (i = 0; i < STEPS * STEPS; i++) {  /* equal parts of R */
        const double r = sqrt((i % STEPS + 0.5) / STEPS), turn = 2 * TEST_PI * (i / STEPS + 0.5) / STEPS;
        double way[3];
        set3(way, r * cos(turn), sqrt(1 - r * r), r * sin(turn));
        if (way[0] < 0) sum += mirrored_radiance(l, roughness, f0, way);
    }
    return sum / STEPS / STEPS;
}

/* Sensors send rays to lamps that flat surfaces mirror. Rays in other directions find these narrow highlights by
   chance: readings of 128 such rays differ by 4, 8 and 0.2 times what walls of gloss, panes and metal add. Rays that
   hit gloss or metal see at least the roughness of the table. Faint mirrors and wide highlights get fewer rays, which
   other light needs more; `spread` therefore has a lower limit, too. */
TEST(mirrored_lamps_are_found) {
    static const struct { const char *what; double metallic, pane, roughness, f0, spread[2]; } walls[3] = {
        { "gloss", 0, 0, 0.15, 0.04, { 0.06, 0.3 } }, { "pane", 0, 1, 0.15, 0.04, { 0.3, 0.7 } },
        { "metal", 1, 0, 0.3, 1, { 0.04, 0.075 } }
    };
    enum { SITES = 256 };
    static sbl_reading readings[SITES];
    const sbl_readings_desc desc = floor_readings(readings, SITES, 128);
    int kind, i;
    for (kind = 0; kind < 6; kind++) {
        const int wall = kind / 2;
        const double metallic = walls[wall].metallic;
        test_scene s = { 0 };
        sbl_light *l = scene_light(&s, kind & 1 ? SBL_LIGHT_DIRECTIONAL : SBL_LIGHT_POINT, 3, 3, 3);
        const int number = walls[wall].pane > 0 ? scene_pane(&s, 1, 1, 1, 1)
            : scene_gloss(&s, metallic, metallic, metallic, metallic, 0);
        double mean = 0, squares = 0, direct, wanted;
        sbl_scene_desc scene;
        l->position[0] = 1; l->position[1] = 1.5f; l->position[2] = 0.2f;
        l->direction[0] = l->direction[1] = -1; l->direction[2] = 0.3f;
        scene_quad(&s, number, -0.2f, -60, -60, -0.2f, -60, 60, -0.2f, 60, 60, -0.2f, 60, -60);
        scene = scene_desc(&s);
        CHECK(sbl_set_scene(context, &scene) == SBL_SUCCESS && sbl_gather_readings(context, &desc) == SBL_SUCCESS,
              "no reading: %s", watch_last(&seen));
        wanted = mirrored_wanted(l, walls[wall].roughness, walls[wall].f0);
        direct = kind & 1 ? 3 / sqrt(2.09) / TEST_PI : 3 * 1.5 / pow(1 + 2.25 + 0.04, 1.5) / TEST_PI;
        for (i = 0; i < SITES; i++) mean += ((double)readings[i].radiance[1] - direct) / SITES;
        for (i = 0; i < SITES; i++) squares += pow((double)readings[i].radiance[1] - direct - mean, 2) / SITES;
        printf("    %s, %s: the wall adds %.5f of %.5f; readings differ by %.3f of it\n", walls[wall].what,
               kind & 1 ? "sun" : "lamp", mean, wanted, sqrt(squares) / wanted);
        CHECK(fabs(mean / wanted - 1) < 0.05, "%s %d: %.5f of %.5f", walls[wall].what, kind & 1, mean, wanted);
        CHECK(sqrt(squares) > walls[wall].spread[0] * wanted && sqrt(squares) < walls[wall].spread[1] * wanted,
              "%s %d: readings differ by %.3f", walls[wall].what, kind & 1, sqrt(squares) / wanted);
        scene_free(&s);
    }
}

/* A wall of strong gloss mirrors two lights, of which one or the other is brighter, or one light and a sky of radiance
   1. Rays find all of them, and add the right light. Readings of 128 rays would differ by 1.5 times what the wall adds,
   if no ray were sent to the weaker light. */
TEST(several_lamps_are_mirrored) {
    enum { SITES = 256, STEPS = 100 };
    static sbl_reading readings[SITES];
    const sbl_readings_desc desc = floor_readings(readings, SITES, 128);
    const double f0 = 1.6 * 1.6 / 3.6 / 3.6;
    int kind, i;
    for (kind = 0; kind < 3; kind++) {
        test_scene s = { 0 };
        double mean = 0, all = 0, squares = 0, wanted = 0;
        sbl_scene_desc scene;
        const int wall = scene_gloss(&s, 0, 0, 0, 0, 0), lights = kind == 2 ? 1 : 2;
        s.materials[wall].ior = 2.6f;
        for (i = 0; i < lights; i++) {
            const float strength = i == kind ? 1 : 3;
            sbl_light *l = scene_light(&s, SBL_LIGHT_POINT, strength, strength, strength);
            l->position[0] = i ? 0.6f : 1;
            l->position[1] = i ? 0.8f : 1.5f;
            l->position[2] = i ? -1.2f : 0.2f;
        }
        if (kind == 2) scene_sky(&s, 1, 1, 1);
        scene_quad(&s, wall, -0.2f, -60, -60, -0.2f, -60, 60, -0.2f, 60, 60, -0.2f, 60, -60);
        scene = scene_desc(&s);
        CHECK(sbl_set_scene(context, &scene) == SBL_SUCCESS && sbl_gather_readings(context, &desc) == SBL_SUCCESS,
              "no reading: %s", watch_last(&seen));
        for (i = 0; i < lights; i++) {
            const float *at = s.lights[i].position;
            const double d2 = (double)(at[0] * at[0] + at[1] * at[1] + at[2] * at[2]);
            wanted += mirrored_wanted(&s.lights[i], 0.15, f0);
            mean -= (double)s.lights[i].intensity[0] * (double)at[1] / pow(d2, 1.5) / TEST_PI;
        }
        for (i = 0; i < STEPS && kind == 2; i++) {
            const double c = (i + 0.5) / STEPS;
            wanted += 0.5 / STEPS + 2 / TEST_PI * sqrt(1 - c * c) * lobe__albedo(c, 0.15, f0, 128) / STEPS;
        }
        for (i = 0; i < SITES; i++) all += (double)readings[i].radiance[1] / SITES;
        for (i = 0; i < SITES; i++) squares += pow((double)readings[i].radiance[1] - all, 2) / SITES;
        mean += all;
        printf("    kind %d: %.5f of %.5f; readings differ by %.3f of it\n", kind, mean, wanted,
               sqrt(squares) / wanted);
        CHECK(fabs(mean / wanted - 1) < 0.03, "kind %d: %.5f of %.5f", kind, mean, wanted);
        CHECK(sqrt(squares) < 0.5 * wanted, "kind %d: readings differ by %.3f", kind, sqrt(squares) / wanted);
        scene_free(&s);
    }
}

/* Returns R that a wall of metal at x = -0.2, with a roughness of 0.3, adds on a floor at the origin, from a point
   light that is so near to the wall that most of this R comes from a small part of the wall. */
static double mirrored_beside(const sbl_light *l) {
    enum { STEPS = 300 };
    const double height = (double)l->position[0] + 0.2;
    double sum = 0;
    int i;
    for (i = 0; i < STEPS * STEPS; i++) {  /* points of the wall, denser near the light */
        const double x = (i % STEPS + 0.5) / STEPS, turn = 2 * TEST_PI * (i / STEPS + 0.5) / STEPS;
        const double r = height * sqrt(x / (1 - x)), area = TEST_PI * height * height / ((1 - x) * (1 - x));
        double way[3], away2;
        set3(way, -0.2, (double)l->position[1] + r * cos(turn), (double)l->position[2] + r * sin(turn));
        away2 = pow(unit(way), 2);
        sum += mirrored_radiance(l, 0.3, 1, way) * fmax(way[1], 0) * -way[0] * area / away2 / TEST_PI;
    }
    return sum / STEPS / STEPS;
}

/* Highlights of a lamp that almost touches a mirror are narrow for a sensor far from both. The densities of the rays
   that find them are exact all the same. */
TEST(lamps_beside_mirrors) {
    enum { SITES = 64 };
    static sbl_reading readings[SITES];
    static const float heights[2] = { 0.03f, 0.0011f };
    const sbl_readings_desc desc = floor_readings(readings, SITES, 128);
    int kind, i;
    for (kind = 0; kind < 2; kind++) {
        test_scene s = { 0 };
        sbl_light *l = scene_light(&s, SBL_LIGHT_POINT, 3, 3, 3);
        double mean = 0, direct, wanted;
        sbl_scene_desc scene;
        l->position[0] = -0.2f + heights[kind];
        l->position[1] = 0.25f;
        direct = 3 * 0.25 / pow((double)l->position[0] * (double)l->position[0] + 0.0625, 1.5) / TEST_PI;
        scene_quad(&s, scene_gloss(&s, 1, 1, 1, 1, 0), -0.2f, -1, -1, -0.2f, -1, 1, -0.2f, 1, 1, -0.2f, 1, -1);
        scene = scene_desc(&s);
        REQUIRE(sbl_set_scene(context, &scene) == SBL_SUCCESS && sbl_gather_readings(context, &desc) == SBL_SUCCESS,
                "no reading: %s", watch_last(&seen));
        wanted = mirrored_beside(l);
        for (i = 0; i < SITES; i++) mean += ((double)readings[i].radiance[1] - direct) / SITES;
        printf("    %.4f beside the wall: the wall adds %.4f of %.4f\n", (double)heights[kind], mean, wanted);
        CHECK(fabs(mean / wanted - 1) < 0.03, "%.4f beside the wall: %.4f of %.4f", (double)heights[kind], mean,
              wanted);
        scene_free(&s);
    }
}

/* A spot light lights a small patch above a dark floor, and the patch becomes glows. The mirror beside the floor shows
   the spot light in the same clusters as it would without glows. */
TEST(glows_do_not_widen_lamps_in_mirrors) {
    static sbl_reading readings[16];
    const sbl_readings_desc desc = floor_readings(readings, 16, 64);
    test_scene s = { 0 };
    sbl_light *spot = scene_light(&s, SBL_LIGHT_SPOT, 50, 50, 50);
    sbl_scene_desc scene;
    spot->position[1] = spot->direction[1] = 1;
    spot->cone = 60;
    scene_quad(&s, scene_material(&s, 0.8f, 0.8f, 0.8f), -0.3f, 2, -0.3f, 0.3f, 2, -0.3f, 0.3f, 2, 0.3f, -0.3f, 2,
               0.3f);
    scene_quad(&s, scene_material(&s, 0, 0, 0), -2, 0, -2, -2, 0, 2, 2, 0, 2, 2, 0, -2);
    scene_quad(&s, scene_gloss(&s, 1, 1, 1, 1, 0), -2, 0, -2, -2, 2, -2, -2, 2, 2, -2, 0, 2);
    scene = scene_desc(&s);
    REQUIRE(sbl_set_scene(context, &scene) == SBL_SUCCESS && sbl_gather_readings(context, &desc) == SBL_SUCCESS,
            "no reading: %s", watch_last(&seen));
    printf("    %d glows, %d clusters in mirrors\n", inside_glow_count(context), inside_mirrored(context));
    CHECK(inside_glow_count(context) > 0 && inside_mirrored(context) > 0, "%d glows, %d clusters in mirrors",
          inside_glow_count(context), inside_mirrored(context));
    scene_free(&s);
}

/* Readings of light that a mirror reflects from the sun do not depend on the unit of length. */
TEST(mirrored_suns_have_no_unit) {
    enum { SITES = 64 };
    static sbl_reading readings[2][SITES];
    double worst = 0;
    int small_unit, i;
    for (small_unit = 0; small_unit < 2; small_unit++) {
        const float unit_of = small_unit ? 1.0f / (1 << 20) : 1;
        test_scene s = { 0 };
        sbl_light *l = scene_light(&s, SBL_LIGHT_DIRECTIONAL, 3, 3, 3);
        const sbl_readings_desc desc = floor_readings(readings[small_unit], SITES, 32);
        sbl_scene_desc scene;
        l->direction[0] = l->direction[1] = -1;
        scene_quad(&s, scene_gloss(&s, 1, 1, 1, 1, 0), -0.2f, -1, -1, -0.2f, -1, 1, -0.2f, 0.3f, 1, -0.2f, 0.3f, -1);
        scene_scale_and_move(&s, unit_of, 0, 0, 0);
        scene = scene_desc(&s);
        REQUIRE(sbl_set_scene(context, &scene) == SBL_SUCCESS && sbl_gather_readings(context, &desc) == SBL_SUCCESS,
                "no reading: %s", watch_last(&seen));
        scene_free(&s);
    }
    for (i = 0; i < SITES; i++)
        worst = test_max(worst, fabs((double)(readings[0][i].radiance[0] - readings[1][i].radiance[0])));
    CHECK(worst < 1e-4 * (double)readings[0][0].radiance[0], "readings differ by %g of %g", worst,
          (double)readings[0][0].radiance[0]);
}

/* Inspected rays have the right directions, also those to mirrored lamps: each ray is as long as the way to the walls
   of a box in its direction. */
TEST(rays_to_mirrored_lamps_are_inspected) {
    enum { SIDE = 8 };
    test_scene s = { 0 };
    sbl_scene_desc scene;
    sbl_picture_desc view = scene_view(SIDE, SIDE, 60, 0, 0, 0.9f, 0, 0, -1);
    const int wall = scene_material(&s, 0.6f, 0.6f, 0.6f), floor = scene_gloss(&s, 0.9, 0.9, 0.9, 1, 0.1);
    sbl_light *l = scene_light(&s, SBL_LIGHT_POINT, 1, 1, 1);
    int pixel, i, k, rays = 0, wrong = 0, uneven = 0;
    l->position[1] = 0.9f;
    scene_box(&s, wall, -1, -1, -1, 1, 1, 1);
    scene_floor(&s, floor, -0.999f, 1);
    view.options.mode = SBL_MODE_GI;
    view.options.rays = 64;
    scene = scene_desc(&s);
    scene.max_bounce_cells = 1024;
    REQUIRE(sbl_set_scene(context, &scene) == SBL_SUCCESS && sbl_render_picture(context, &view) == SBL_SUCCESS,
            "no picture: %s", watch_last(&seen));
    for (pixel = 0; pixel < SIDE * SIDE; pixel += 3) {
        static float weights[4096];
        sbl_sensor sensor;
        if (sbl_inspect_sensor(context, pixel % SIDE, pixel / SIDE, &sensor, NULL, weights, 4096) != SBL_SUCCESS ||
            !sensor.sensed) continue;
        for (i = 0; i < sensor.ray_count && sensor.rays[i].lamp < 0; i++) {
            const sbl_sensor_ray *ray = &sensor.rays[i];
            double least = 10;
            if (!(weights[i] > 0)) continue;
            for (k = 0; k < 3; k++) {
                const double low = k == 1 ? -0.999 : -1, way = (double)ray->direction[k];
                least = test_min(least, ((way > 0 ? 1 : low) - (double)sensor.position[k]) / way);
            }
            rays++;
            wrong += fabs(least - fabs((double)ray->distance)) > 1e-3;
            uneven += fabs((double)weights[i] * 64 - 1) > 0.01;
        }
    }
    printf("    %d of %d rays have a weight of their own, %d the wrong length\n", uneven, rays, wrong);
    CHECK(rays > 500 && uneven > rays / 4 && !wrong, "%d of %d rays have the wrong length; %d have a weight of their "
          "own", wrong, rays, uneven);
    scene_free(&s);
}

/* A light that almost touches a floor is far brighter than its image in a ceiling far above. No ray is sent to the
   image, so that all rays of a sensor have the same weight. */
TEST(near_lamps_outshine_their_images) {
    static float weights[4096];
    test_scene s = { 0 };
    sbl_scene_desc scene;
    sbl_sensor sensor;
    sbl_picture_desc view = scene_view(1, 1, 2, 0.5f, 1, 0, 0, 0, 0);
    const int ceiling = scene_gloss(&s, 0, 0, 0, 0, 0);
    int i, rays = 0;
    s.materials[ceiling].ior = 2.6f;
    scene_light(&s, SBL_LIGHT_POINT, 1, 1, 1)->position[1] = 0.1f;
    scene_floor(&s, scene_material(&s, 0.6f, 0.6f, 0.6f), 0, 1);
    scene_floor(&s, ceiling, 5, 20);
    view.options.mode = SBL_MODE_GI;
    view.options.rays = 64;
    scene = scene_desc(&s);
    scene.max_bounce_cells = 1024;
    REQUIRE(sbl_set_scene(context, &scene) == SBL_SUCCESS && sbl_render_picture(context, &view) == SBL_SUCCESS &&
            sbl_inspect_sensor(context, 0, 0, &sensor, NULL, weights, 4096) == SBL_SUCCESS && sensor.sensed,
            "no sensor: %s", watch_last(&seen));
    for (i = 0; i < sensor.ray_count; i++) {
        if (sensor.rays[i].lamp >= 0) continue;
        CHECK(fabs((double)weights[i] * 64 - 1) < 0.01, "ray %d has the weight %g / 64", i, (double)weights[i] * 64);
        rays++;
    }
    CHECK(rays >= 64, "%d rays", rays);
    scene_free(&s);
}

/* Rays that a guide directs and rays to mirrored lamps give the same light together as without a guide. */
TEST(guided_rays_and_mirrored_lamps) {
    enum { SIDE = 24 };
    static float light[2][3 * SIDE * SIDE];
    double mean[2] = { 0, 0 };
    int guided, i;
    for (guided = 0; guided < 2; guided++) {
        sbl_picture_desc view = scene_view(SIDE, SIDE, 60, 0.5f, 2.5f, 1.5f, 0.2f, 0, 0);
        test_scene s = { 0 };
        const int wall = scene_gloss(&s, 0.5, 0.5, 0.5, 0, 0.1), floor = scene_material(&s, 0.6f, 0.6f, 0.6f);
        sbl_light *l = scene_light(&s, SBL_LIGHT_POINT, 3, 3, 3);
        l->position[0] = 1; l->position[1] = 1.5f;
        scene_quad(&s, wall, -1, 0, -2, -1, 0, 2, -1, 2, 2, -1, 2, -2);
        scene_floor(&s, floor, 0, 2);
        view.options.mode = SBL_MODE_GI;
        view.target_error = 0.01f;
        view.look_rays = guided ? -64 : 64;
        CHECK(scene_render(context, &s, &view) && sbl_read_channel(context, SBL_CHANNEL_RADIANCE, light[guided],
                                                                  3 * SIDE * SIDE) == SBL_SUCCESS, "no picture");
        for (i = 0; i < 3 * SIDE * SIDE; i++) mean[guided] += (double)light[guided][i] / (3 * SIDE * SIDE);
        scene_free(&s);
    }
    printf("    mean R %.5f with guides, %.5f without\n", mean[1], mean[0]);
    CHECK(fabs(mean[1] / mean[0] - 1) < 0.01, "mean R %.5f with guides, %.5f without", mean[1], mean[0]);
}

/* Returns the mean R on the floor of a wide room. All light comes from a bright spot on a ceiling of metal. cells:
   limit of the cells of the store */
static double below_a_spot(double roughness, int cells) {
    enum { SIDE = 24 };
    sbl_picture_desc view = scene_view(SIDE, SIDE, 80, 0, 2.5f, 0.01f, 0, 0, 0);
    static float light[3 * SIDE * SIDE];
    test_scene s = { 0 };
    sbl_scene_desc desc;
    double sum = 0;
    const int ceiling = scene_gloss(&s, 0.9, 0.9, 0.9, 1, roughness), walls = scene_material(&s, 0.5f, 0.5f, 0.5f);
    const int lamp = scene_lamp(&s, 1000, 1000, 1000);
    int i;
    view.options.mode = SBL_MODE_GI;
    s.materials[lamp].flags = SBL_MATERIAL_ONE_SIDED_EMISSION;
    scene_quad(&s, ceiling, -5, 3, -5, 5, 3, -5, 5, 3, 5, -5, 3, 5);
    scene_floor(&s, walls, 0, 5);
    scene_quad(&s, walls, -5, 0, -5, 5, 0, -5, 5, 3, -5, -5, 3, -5);
    scene_quad(&s, walls, -5, 0, 5, -5, 3, 5, 5, 3, 5, 5, 0, 5);
    scene_quad(&s, walls, -5, 0, -5, -5, 3, -5, -5, 3, 5, -5, 0, 5);
    scene_quad(&s, walls, 5, 0, -5, 5, 0, 5, 5, 3, 5, 5, 3, -5);
    scene_quad(&s, lamp, -0.15f, 2.8f, -0.15f, -0.15f, 2.8f, 0.15f, 0.15f, 2.8f, 0.15f, 0.15f, 2.8f, -0.15f);
    desc = scene_desc(&s);
    desc.max_bounce_cells = cells;
    CHECK(sbl_set_scene(context, &desc) == SBL_SUCCESS && sbl_render_picture(context, &view) == SBL_SUCCESS &&
          sbl_read_channel(context, SBL_CHANNEL_RADIANCE, light, 3 * SIDE * SIDE) == SBL_SUCCESS, "no picture");
    for (i = 0; i < 3 * SIDE * SIDE; i++) sum += (double)light[i];
    scene_free(&s);
    return sum / (3 * SIDE * SIDE);
}

/* Light that bright metal reflects is counted once, whether glows or rays find it. The values are from a path tracer of
   a few lines that was written for this room, with a noise of 0.7 %. */
TEST(glows_of_metal_count_once) {
    static const double roughnesses[3] = { 0.45, 0.52, 1 }, traced[3] = { 1.252, 1.192, 0.467 };
    double light[3];
    int i;
    for (i = 0; i < 3; i++) {
        light[i] = below_a_spot(roughnesses[i], 12288);
        printf("    R below a ceiling of roughness %.2f: %.3f of %.3f\n", roughnesses[i], light[i], traced[i]);
        CHECK(fabs(light[i] / traced[i] - 1) < 0.15, "roughness %.2f: R is %.3f, not %.3f", roughnesses[i], light[i],
              traced[i]);
    }
    CHECK(light[2] < 0.55 * light[1], "the roughest metal reflects %.3f, rough metal %.3f", light[2], light[1]);
}

/* Measures the light of a floor that gets light only by way of a ceiling, from a patch which a wall hides from the
   floor. spot: 1: a spot of this intensity lights the patch; 0: the patch emits `light` itself. opacity: that of the
   ceiling. up: 1: the ceiling is gloss, and the light is R at the floor; 0: the ceiling is metal, and the light is that
   which cells of the floor reflect */
static double by_way_of_a_ceiling(int spot, double light, double opacity, int up) {
    enum { SITES = 64 };
    static sbl_site sites[SITES];
    static sbl_reading readings[SITES];
    sbl_readings_desc gather;
    sbl_scene_desc desc;
    test_scene s = { 0 };
    const int ceiling = up ? scene_gloss(&s, 0, 0, 0, 0, 0.15) : scene_gloss(&s, 0.9, 0.9, 0.9, 1, 0.3);
    const int floor = scene_material(&s, 0.8f, 0.8f, 0.8f);
    const int wall = scene_material(&s, 0, 0, 0), lamp = scene_lamp(&s, (float)light, (float)light, (float)light);
    double sum = 0;
    int i;
    if (up) s.materials[ceiling].ior = 2.6f;  /* the reflectance is just below that of metal, SBL__STRONG */
    s.materials[lamp].flags = SBL_MATERIAL_ONE_SIDED_EMISSION;
    scene_blend(&s, scene_quad(&s, ceiling, -2, 1, -2, 2, 1, -2, 2, 1, 2, -2, 1, 2), (float)opacity);
    scene_quad(&s, spot ? floor : lamp, -0.6f, 0, -0.2f, -0.6f, 0, 0.2f, -0.2f, 0, 0.2f, -0.2f, 0, -0.2f);
    scene_quad(&s, wall, 0, -0.1f, -1, 0, -0.1f, 1, 0, 0.75f, 1, 0, 0.75f, -1);
    scene_quad(&s, floor, 0.1f, 0, -0.5f, 0.1f, 0, 0.5f, 1.1f, 0, 0.5f, 1.1f, 0, -0.5f);
    if (spot) {
        sbl_light *l = scene_light(&s, SBL_LIGHT_SPOT, (float)light, (float)light, (float)light);
        l->position[0] = -0.4f;
        l->position[1] = 0.8f;
        l->direction[1] = -1;
        l->cone = l->inner_cone = 60;
    }
    memset(sites, 0, sizeof sites);
    for (i = 0; i < SITES; i++) {
        sites[i].position[0] = 0.3f + 0.05f * (float)(i % 8);
        sites[i].position[1] = up ? 0 : 0.2f;
        sites[i].position[2] = 0.05f * (float)(i / 8) - 0.175f;
        sites[i].normal[1] = up ? 1 : -1;
    }
    gather = scene_readings(sites, readings, SITES, SBL_MODE_GI);
    gather.options.rays = up ? 4096 : 256;
    desc = scene_desc(&s);
    desc.max_bounce_cells = 32768;
    CHECK(sbl_set_scene(context, &desc) == SBL_SUCCESS && sbl_gather_readings(context, &gather) == SBL_SUCCESS,
          "no readings");
    CHECK((inside_glow_count(context) > 0) == spot, "%d glows", inside_glow_count(context));
    for (i = 0; i < SITES; i++) sum += (double)readings[i].radiance[0] / SITES;
    scene_free(&s);
    return sum;
}

/* A floor that sees a bright place only by way of metal or gloss gets the same light, whether the place is lit or emits
   as much itself. Metal with a coverage of one half reflects half. */
TEST(bright_places_are_seen_by_way_of_metal) {
    double lit = 0, emits, glows, half;
    int i, up;
    for (i = 0; i < 64; i++) {  /* the patch reflects this much light, on average */
        const double x = 0.05 * (i % 8) - 0.175, z = 0.05 * (i / 8) - 0.175, d2 = 0.64 + x * x + z * z;
        lit += 0.8 * 20 * (0.8 / sqrt(d2)) / d2 / TEST_PI / 64;
    }
    for (up = 1; up >= 0; up--) {
        emits = by_way_of_a_ceiling(0, lit, 1, up);
        glows = by_way_of_a_ceiling(1, 20, 1, up);
        printf("    %s the floor %.5f from a lamp, %.5f from the patch\n", up ? "at" : "before", emits, glows);
        CHECK(fabs(glows / emits - 1) < 0.15, "R is %g, that of a lamp %g", glows, emits);
    }
    half = by_way_of_a_ceiling(1, 20, 0.5, 0);
    printf("    before the floor %.5f by half a ceiling\n", half);
    CHECK(fabs(half / glows - 0.5) < 0.06, "R by half a ceiling is %g, by a whole one %g", half, glows);
}

/* A ball that mirrors all light shows the sky everywhere, also where its interpolated normals would lead a reflection
   into the ball. */
TEST(furnace_of_a_mirror_ball) {
    enum { SIDE = 32 };
    sbl_picture_desc view = scene_view(SIDE, SIDE, 40, 0, 0.5f, 3, 0, 0, 0);
    static float final[3 * SIDE * SIDE], id[SIDE * SIDE];
    double worst = 0;
    test_scene s = { 0 };
    int i, shown = 0;
    view.options.mode = SBL_MODE_DIRECT;
    view.options.preset = SBL_PRESET_DRAFT;
    view.samples = 1;
    scene_sphere(&s, scene_gloss(&s, 1, 1, 1, 1, 0), 0, 0, 0, 1, 8, 4, 1);
    scene_sky(&s, 1, 1, 1);
    if (!scene_render(context, &s, &view)) return;
    CHECK(sbl_read_channel(context, SBL_CHANNEL_FINAL, final, 3 * SIDE * SIDE) == SBL_SUCCESS &&
          sbl_read_channel(context, SBL_CHANNEL_ID, id, SIDE * SIDE) == SBL_SUCCESS, "no channel");
    for (i = 0; i < SIDE * SIDE; i++) {
        if (id[i] > 0) worst = test_max(worst, fabs((double)final[3 * i] - 1));
        shown += id[i] > 0;
    }
    CHECK(shown > SIDE * SIDE / 3 && worst < 0.02, "%d pixels show the ball, one is off by %g", shown, worst);
    scene_free(&s);
}

/* Metal reflects almost nothing of the colours that its albedo lacks. The light in its lobe stays finite there. */
TEST(lobes_may_be_black) {
    enum { SIDE = 32 };
    sbl_picture_desc view = scene_view(SIDE, SIDE, 40, 0.01f, 3, 0.013f, 0, 0, 0);
    static float light[3 * SIDE * SIDE], final[3 * SIDE * SIDE];
    double most = 0, green = 0;
    test_scene s = { 0 };
    int i;
    scene_floor(&s, scene_gloss(&s, 1, 0, 0, 1, 0.5), 0, 2);
    scene_quad(&s, scene_lamp(&s, 30, 30, 30), 2, 0.5f, -1, 2, 1.5f, -1, 2, 1.5f, 1, 2, 0.5f, 1);
    if (!scene_render(context, &s, &view)) return;
    CHECK(sbl_read_channel(context, SBL_CHANNEL_SPECULAR, light, 3 * SIDE * SIDE) == SBL_SUCCESS, "no channel");
    CHECK(sbl_read_channel(context, SBL_CHANNEL_FINAL, final, 3 * SIDE * SIDE) == SBL_SUCCESS, "no channel");
    for (i = 0; i < 3 * SIDE * SIDE; i++) {
        most = fmax(most, (double)light[i]);
        if (i % 3 == 1) green = fmax(green, (double)final[i]);
        CHECK(final[i] >= 0, "FINAL is %g", (double)final[i]);
    }
    CHECK(most < 30, "light in the lobe: %g", most);
    CHECK(green > 0 && green < 0.01, "red metal reflects %g of green light", green);
    CHECK(sbl_query_stats(context).picture.specular_error < 0.03f, "predicted error %g",
          (double)sbl_query_stats(context).picture.specular_error);
    scene_free(&s);
}

/* >>materials, steps and failures */

enum { WIDTH = 40, HEIGHT = 30, FLOATS = 3 * WIDTH * HEIGHT };

/* Makes a scene with a rough plastic floor, a ball of metal, a mirror, a pane, a blended surface, a lamp and a
   light. */
static void glossy_scene(test_scene *s, int matte) {
    const int floor = scene_gloss(s, 0.5, 0.4, 0.3, 0, 0.3), metal = scene_gloss(s, 0.9, 0.8, 0.4, 1, 0.25);
    const int mirror = scene_gloss(s, 0.8, 0.8, 0.8, 1, 0), pane = scene_pane(s, 0.8, 0.9, 0.8, 1);
    const int veil = scene_material(s, 0.5f, 0.5f, 0.5f);
    sbl_mesh *mesh;
    int i;
    scene_floor(s, floor, 0, 2);
    scene_sphere(s, metal, -0.6f, 0.5f, 0, 0.5f, 24, 12, 1);
    scene_quad(s, mirror, -1.5f, 0, -1, 1.5f, 0, -1, 1.5f, 1.5f, -1.2f, -1.5f, 1.5f, -1.2f);
    scene_quad(s, pane, 0.3f, 0, 0.5f, 1.2f, 0, 0.3f, 1.2f, 0.9f, 0.3f, 0.3f, 0.9f, 0.5f);
    mesh = scene_quad(s, veil, -0.2f, 1.2f, 0.5f, 0.6f, 1.2f, 0.5f, 0.6f, 1.2f, -0.3f, -0.2f, 1.2f, -0.3f);
    scene_blend(s, mesh, 0.6f);
    scene_quad(s, scene_lamp(s, 9, 8, 7), -0.3f, 2, 0.3f, 0.3f, 2, 0.3f, 0.3f, 2, -0.3f, -0.3f, 2, -0.3f);
    scene_light(s, SBL_LIGHT_POINT, 1, 1, 2)->position[0] = 1;
    s->lights[0].position[1] = 1.5f;
    scene_sky(s, 0.1f, 0.1f, 0.2f);
    for (i = 0; i < s->mesh_count; i++) s->meshes[i].id = (uint32_t)i + 1;
    for (i = 0; matte && i < s->material_count; i++) {
        s->materials[i].ior = s->materials[i].metallic = s->materials[i].transmission = 0;
        s->materials[i].flags = 0;
    }
}

static sbl_picture_desc glossy_view(sbl_mode mode) {
    sbl_picture_desc view = scene_view(WIDTH, HEIGHT, 40, 0.3f, 1.2f, 4, 0, 0.5f, 0);
    view.options.mode = mode;
    view.options.preset = SBL_PRESET_DRAFT;
    view.samples = 2;
    return view;
}

static void read_all(sbl_context *c, float *all[SBL_CHANNEL_COUNT], const sbl_picture_desc *view) {
    int i;
    for (i = 0; i < SBL_CHANNEL_COUNT; i++) all[i] = scene_channel(c, view, (sbl_channel)i);
}

static int same_channels(float *a[SBL_CHANNEL_COUNT], float *b[SBL_CHANNEL_COUNT], size_t pixels) {
    int i;
    for (i = 0; i < SBL_CHANNEL_COUNT; i++)
        if (memcmp(a[i], b[i], pixels * sizeof(float) * (sbl_channel_components((sbl_channel)i) > 1 ? 3 : 1)) != 0) {
            printf("    channel %d differs\n", i);
            return 0;
        }
    return 1;
}

static void free_all(float *all[SBL_CHANNEL_COUNT]) {
    int i;
    for (i = 0; i < SBL_CHANNEL_COUNT; i++) free(all[i]);
}

static double largest(const float *values, int count) {
    double most = 0;
    int i;
    for (i = 0; i < count; i++) most = test_max(most, fabs((double)values[i]));
    return most;
}

/* A scene of matte surfaces has no reflections, and materials that no mesh uses change no bit of the picture. */
TEST(matte_scenes_stay_the_same) {
    const sbl_picture_desc view = glossy_view(SBL_MODE_DIRECT);
    float *before[SBL_CHANNEL_COUNT], *after[SBL_CHANNEL_COUNT];
    test_scene s = { 0 };
    glossy_scene(&s, 1);
    if (!scene_render(context, &s, &view)) return;
    read_all(context, before, &view);
    CHECK(largest(before[SBL_CHANNEL_SPECULAR], FLOATS) <= 0, "matte surfaces have reflections");
    CHECK(largest(before[SBL_CHANNEL_SPECULAR_ALBEDO], FLOATS) <= 0, "matte surfaces have lobes");
    CHECK(sbl_query_stats(context).picture.specular_error <= 0, "there is an error of reflections");
    scene_pane(&s, 1, 1, 1, 1);
    scene_gloss(&s, 1, 1, 1, 1, 0.1);
    if (!scene_render(context, &s, &view)) return;
    read_all(context, after, &view);
    CHECK(same_channels(before, after, WIDTH * HEIGHT), "materials that no mesh uses change the picture");
    free_all(before);
    free_all(after);
    scene_free(&s);
}

/* A room whose walls all emit e and reflect the share a of light on average has R = e / (1 - a). Plastic reflects the
   share given by the quadrature. Walls with a coverage of one half emit and reflect half. */
TEST(rooms_reflect_their_mean) {
    enum { STEPS = 20 };
    const double base = 0.8, roughness = 0.6;
    double mean = 0;
    int half, i;
    for (i = 0; i < STEPS; i++) {
        const double mu = (i + 0.5) / STEPS;
        mean += 2 * mu * (lobe__albedo(mu, roughness, 0.04, 64) + base * 0.96 * lobe_matte(mu)) / STEPS;
    }
    for (half = 0; half < 2; half++) {
        const double share = half ? 0.5 : 1, wanted = share / (1 - share * mean);
        test_scene s = { 0 };
        sbl_scene_desc scene;
        sbl_site site;
        sbl_reading reading;
        sbl_readings_desc desc;
        const int walls = scene_gloss(&s, base, base, base, 0, roughness);
        for (i = 0; i < 3; i++) s.materials[walls].emission[i] = 1;
        scene_box(&s, walls, -1, -1, -1, 1, 1, 1);
        for (i = 0; i < s.mesh_count && half; i++) scene_blend(&s, &s.meshes[i], 0.5f);
        scene = scene_desc(&s);
        memset(&site, 0, sizeof site);
        site.normal[1] = 1;
        desc = scene_readings(&site, &reading, 1, SBL_MODE_GI);
        scene.max_bounce_cells = 1024;
        REQUIRE(sbl_set_scene(context, &scene) == SBL_SUCCESS && sbl_gather_readings(context, &desc) == SBL_SUCCESS,
                "%s", watch_last(&seen));
        printf("    share %g: R is %.4f, expected %.4f\n", share, (double)reading.radiance[1], wanted);
        CHECK(fabs((double)reading.radiance[1] / wanted - 1) < 0.02, "share %g: R is %.4f, not %.4f", share,
              (double)reading.radiance[1], wanted);
        scene_free(&s);
    }
}

/* If no visible surface has a lobe, the relative error of FINAL equals that of R, because all surfaces have the same
   albedo. */
TEST(metal_out_of_view) {
    sbl_picture_desc view = glossy_view(SBL_MODE_DIRECT);
    test_scene s = { 0 };
    sbl_stats stats;
    glossy_scene(&s, 1);
    s.materials[s.meshes[0].material].albedo[1] = s.materials[s.meshes[0].material].albedo[2] = 0.5f;
    s.mesh_count = 1;
    scene_quad(&s, scene_gloss(&s, 1, 1, 1, 1, 0.2), -1, 0, 8, 1, 0, 8, 1, 1, 8, -1, 1, 8);
    if (!scene_render(context, &s, &view)) return;
    stats = sbl_query_stats(context);
    printf("    error of FINAL %g, of R %g\n", (double)stats.picture.expected_error,
           (double)stats.picture.radiance_error);
    CHECK(stats.picture.radiance_error > 0 && stats.picture.radiance_error < 0.1f &&
              fabs((double)stats.picture.expected_error / (double)stats.picture.radiance_error - 1) < 0.05,
          "the error of FINAL is %g, that of R %g", (double)stats.picture.expected_error,
          (double)stats.picture.radiance_error);
    scene_free(&s);
}

/* Changing materials gives the same picture as a new scene with them: from matte to glossy, and back. */
TEST(materials_change) {
    const sbl_picture_desc view = glossy_view(SBL_MODE_DIRECT);
    float *fresh[2][SBL_CHANNEL_COUNT], *changed[SBL_CHANNEL_COUNT];
    test_scene s[2];
    int matte;
    memset(s, 0, sizeof s);
    for (matte = 0; matte < 2; matte++) {
        glossy_scene(&s[matte], matte);
        if (!scene_render(context, &s[matte], &view)) return;
        read_all(context, fresh[matte], &view);
    }
    for (matte = 0; matte < 2; matte++) {
        const sbl_scene_desc desc = scene_desc(&s[matte]);
        CHECK(sbl_set_materials(context, desc.materials, desc.material_count) == SBL_SUCCESS &&
              sbl_render_picture(context, &view) == SBL_SUCCESS, "no picture: %s", watch_last(&seen));
        read_all(context, changed, &view);
        CHECK(same_channels(fresh[matte], changed, WIDTH * HEIGHT), "materials that become %s make another picture",
              matte ? "matte" : "glossy");
        free_all(changed);
    }
    for (matte = 0; matte < 2; matte++) {
        free_all(fresh[matte]);
        scene_free(&s[matte]);
    }
}

/* In SBL_MODE_PAPER all surfaces are matte. */
TEST(paper_is_matte) {
    sbl_picture_desc view = glossy_view(SBL_MODE_PAPER);
    float *all[2][SBL_CHANNEL_COUNT];
    test_scene s = { 0 };
    int i, k;
    glossy_scene(&s, 0);
    for (i = 0; i < s.material_count; i++) {
        s.materials[i].transmission = 0;
        s.materials[i].flags = 0;
    }
    for (k = 0; k < 2; k++) {
        for (i = 0; k && i < s.material_count; i++) s.materials[i].ior = s.materials[i].metallic = 0;
        if (!scene_render(context, &s, &view)) return;
        read_all(context, all[k], &view);
    }
    CHECK(same_channels(all[0], all[1], WIDTH * HEIGHT), "metal and gloss change a picture of SBL_MODE_PAPER");
    CHECK(largest(all[0][SBL_CHANNEL_SPECULAR], FLOATS) <= 0, "there are reflections");
    CHECK(largest(all[0][SBL_CHANNEL_FINAL], FLOATS) > 0.1, "the picture is black");
    free_all(all[0]);
    free_all(all[1]);
    scene_free(&s);
}

/* A glossy picture in very short steps is the same to the bit, whether or not it is read meanwhile. */
TEST(steps_make_the_same_picture) {
    const sbl_picture_desc view = glossy_view(SBL_MODE_DIRECT);
    float *whole[SBL_CHANNEL_COUNT], *stepped[SBL_CHANNEL_COUNT];
    test_scene s = { 0 };
    int watching;
    glossy_scene(&s, 0);
    if (!scene_render(context, &s, &view)) return;
    read_all(context, whole, &view);
    CHECK(largest(whole[SBL_CHANNEL_SPECULAR], FLOATS) > 0.1, "there are no reflections");
    for (watching = 0; watching < 2; watching++) {
        sbl_result result = sbl_begin_picture(context, &view);
        int steps = 0, bad = 0, early = 0, i;
        float before = 0;
        if (result == SBL_SUCCESS) result = SBL_UNFINISHED;
        while (result == SBL_UNFINISHED && steps++ < 1000000) {
            const float done = sbl_progress(context);
            bad += !(done >= before && done <= 1);
            before = done;
            result = sbl_step(context, 1e-9);
            if (watching && steps % 16 == 0 && result == SBL_UNFINISHED) {
                static float now[FLOATS];
                const sbl_result reads = sbl_read_channel(context, SBL_CHANNEL_FINAL, now, FLOATS);
                bad += reads != SBL_SUCCESS && reads != SBL_UNFINISHED;
                early += reads == SBL_SUCCESS;
                for (i = 0; i < FLOATS; i++) bad += !(now[i] >= 0 && now[i] < 1e3f);
            }
        }
        CHECK(result == SBL_SUCCESS && steps > 50, "%s after %d steps", sbl_result_string(result), steps);
        CHECK(!watching || early > 5, "the picture was read %d times meanwhile", early);
        CHECK(!bad, "%d pixels or progresses are wrong meanwhile", bad);
        read_all(context, stepped, &view);
        CHECK(same_channels(whole, stepped, WIDTH * HEIGHT), "the picture in %d steps, watched %d, is different", steps,
              watching);
        printf("    %d steps\n", steps);
        free_all(stepped);
    }
    free_all(whole);
    scene_free(&s);
}

/* A window of a glossy picture shows the same surfaces as the full picture, and about the same light. Its error is
   relative to the mean of the full picture, if the host gives that. */
TEST(windows_show_the_same) {
    static const int window[4] = { 10, 6, 20, 16 };
    static const sbl_channel channels[4] = { SBL_CHANNEL_FINAL, SBL_CHANNEL_ALBEDO, SBL_CHANNEL_SPECULAR_ALBEDO,
        SBL_CHANNEL_SPECULAR };
    sbl_picture_desc view = glossy_view(SBL_MODE_DIRECT);
    test_scene s = { 0 };
    double whole;
    int plain, i, j, k;
    glossy_scene(&s, 0);
    if (!scene_render(context, &s, &view)) return;
    whole = (double)sbl_query_stats(context).picture.specular_error;
    for (plain = 0; plain < 2; plain++) {
        sbl_picture_desc part;
        double off2[4] = { 0 }, all2[4] = { 0 }, sums[2] = { 0, 0 }, error, given;
        shot p, q;
        view = plain ? scene_plain(glossy_view(SBL_MODE_DIRECT), SBL_MODE_DIRECT, 0) : glossy_view(SBL_MODE_DIRECT);
        if (plain) view.options.rays = 64;
        part = view;
        if (!shoot(&p, &s, &view)) return;
        for (j = 0; j < 4; j++) at(&p, channels[j], 0, 0);
        for (i = 0; i < 4; i++) part.window[i] = window[i];
        if (!shoot(&q, &s, &part)) return;
        q.view.width = window[2];
        q.view.height = window[3];
        for (i = 0; i < window[2] * window[3]; i++)
            for (j = 0; j < 4; j++)
                for (k = 0; k < 3; k++) {
                    const int x = i % window[2], y = i / window[2];
                    const double a = (double)at(&p, channels[j], window[0] + x, window[1] + y)[k];
                    const double b = (double)at(&q, channels[j], x, y)[k];
                    off2[j] += (a - b) * (a - b);
                    all2[j] += a * a;
                    sums[0] += a;
                    sums[1] += b;
                }
        for (j = 0; j < 4; j++) {
            const double off = sqrt(off2[j] / all2[j]);
            printf("    channel %d, %s: %.5f\n", (int)channels[j], plain ? "all pixels sense" : "default", off);
            CHECK(off < (j == 1 || j == 2 ? 1e-5 : 0.1), "channel %d, plain %d: off by %.4f", (int)channels[j], plain,
                  off);
        }
        CHECK(fabs(sums[1] / sums[0] - 1) < 0.01, "plain %d: %.4f times as bright", plain, sums[1] / sums[0]);
        error = (double)sbl_query_stats(context).picture.specular_error;
        for (k = 0; k < 3; k++) part.mean_final[k] = 50;  /* a window in a dark part of a bright picture */
        if (!scene_render(context, &s, &part)) return;
        given = (double)sbl_query_stats(context).picture.specular_error;
        printf("    predicted error %.5f, of a bright picture %.5f\n", error, given);
        CHECK(given > 0 && given < 0.2 * error, "plain %d: the predicted error is %.4f, in a bright picture %.4f",
              plain, error, given);
        forget(&p);
        forget(&q);
    }
    view = glossy_view(SBL_MODE_DIRECT);
    view.price = 1e30f;  /* looks at lobes have a price of their own: without it, they go on to the target */
    if (!scene_render(context, &s, &view)) return;
    printf("    with a price, predicted error %.5f\n", (double)sbl_query_stats(context).picture.specular_error);
    CHECK((double)sbl_query_stats(context).picture.specular_error < 1.1 * whole, "with a price of R, the predicted "
          "error is %.5f, not %.5f", (double)sbl_query_stats(context).picture.specular_error, whole);
    scene_free(&s);
}

/* What the quarters of a glossy picture have together: rays, mean squared error, the share of the pixels whose looks at
   R are not those of the complete picture, and the difference of SPECULAR as a share of its mean. */
typedef struct quarters { double rays, error2, changed, off; } quarters;

/* Renders the picture and its quarters. Returns 0 if that failed. */
static int make_quarters(const test_scene *s, sbl_picture_desc view, quarters *whole, quarters *parts) {
    const int width = view.width, w = width / 2, h = view.height / 2;
    float *looks, *light;
    double off2 = 0, sum = 0;
    int i, k, n;
    memset(whole, 0, sizeof *whole);
    memset(parts, 0, sizeof *parts);
    if (!scene_render(context, s, &view)) return 0;
    whole->rays = (double)sbl_query_stats(context).sensors.rays;
    whole->error2 = pow((double)sbl_query_stats(context).picture.expected_error, 2);
    looks = scene_channel(context, &view, SBL_CHANNEL_LOOKS);
    light = scene_channel(context, &view, SBL_CHANNEL_SPECULAR);
    for (n = 0; n < 4; n++) {
        sbl_picture_desc shown = view;
        float *part_looks, *part_light;
        shown.width = view.window[2] = w;
        shown.height = view.window[3] = h;
        view.window[0] = n % 2 * w;
        view.window[1] = n / 2 * h;
        if (!scene_render(context, s, &view)) break;
        parts->rays += (double)sbl_query_stats(context).sensors.rays;
        parts->error2 += pow((double)sbl_query_stats(context).picture.expected_error, 2) / 4;
        part_looks = scene_channel(context, &shown, SBL_CHANNEL_LOOKS);
        part_light = scene_channel(context, &shown, SBL_CHANNEL_SPECULAR);
        for (i = 0; i < w * h; i++) {
            const int there = (n / 2 * h + i / w) * width + n % 2 * w + i % w;
            parts->changed += (double)part_looks[i] != (double)looks[there];
            for (k = 0; k < 3; k++) {
                off2 += pow((double)part_light[3 * i + k] - (double)light[3 * there + k], 2);
                sum += (double)light[3 * there + k];
            }
        }
        free(part_looks);
        free(part_light);
    }
    parts->changed /= 4 * w * h;
    parts->off = sqrt(off2 * 12 * w * h) / sum;
    free(looks);
    free(light);
    return n == 4;
}

/* Windows with the means and prices of a complete picture take its looks, at R and at lobes, and have its light and its
   error. Without them, every window reaches the target error by itself: the dark ones take many looks. */
TEST(windows_share_prices_of_lobes) {
    sbl_picture_desc view = glossy_view(SBL_MODE_DIRECT);
    test_scene s = { 0 };
    quarters whole, parts, alone;
    sbl_stats stats;
    glossy_scene(&s, 0);
    view.width = 96;
    view.height = 72;
    view.target_error = 0.03f;
    if (!make_quarters(&s, view, &whole, &alone) || !scene_render(context, &s, &view)) return;
    stats = sbl_query_stats(context);
    CHECK(stats.picture.mean_final[1] > 0.05f && stats.picture.mean_final[1] < 0.08f, "the mean of FINAL is %g",
          (double)stats.picture.mean_final[1]);
    memcpy(view.mean_radiance, stats.picture.mean_radiance, sizeof view.mean_radiance);
    memcpy(view.mean_final, stats.picture.mean_final, sizeof view.mean_final);
    view.look_rays = stats.picture.look_rays;
    view.price = stats.picture.price;
    view.specular_price = stats.picture.specular_price;
    if (!make_quarters(&s, view, &whole, &parts)) return;
    printf("    rays %.0f, in windows %.0f, without prices %.0f\n    error %.5f, with prices %.5f, in windows %.5f\n"
           "    windows: looks of %.2f %% of the pixels change, SPECULAR by %.4f, without prices by %.4f\n", whole.rays,
           parts.rays, alone.rays, (double)stats.picture.expected_error, sqrt(whole.error2), sqrt(parts.error2),
           100 * parts.changed, parts.off, alone.off);
    CHECK(fabs(sqrt(whole.error2) / (double)stats.picture.expected_error - 1) < 0.1, "error %g, with the prices %g",
          (double)stats.picture.expected_error, sqrt(whole.error2));
    CHECK(parts.rays < 1.8 * whole.rays, "%g rays in windows, %g in the whole", parts.rays, whole.rays);
    CHECK(fabs(sqrt(parts.error2 / whole.error2) - 1) < 0.1, "error %g in windows, %g in the whole",
          sqrt(parts.error2), sqrt(whole.error2));
    CHECK(parts.changed < 0.001 && parts.off < 0.01, "%.2f %% of the looks change, and SPECULAR by %g",
          100 * parts.changed, parts.off);
    view.specular_price = -1;
    CHECK(sbl_begin_picture(context, &view) == SBL_ERROR_INVALID_ARGUMENT, "a negative price is accepted");
    view.specular_price = 0;
    view.mean_final[2] = (float)NAN;
    CHECK(sbl_begin_picture(context, &view) == SBL_ERROR_INVALID_ARGUMENT, "a mean that is no number is accepted");
    scene_free(&s);
}

/* Errors and prices are relative to the mean of FINAL, which may be far from (mean R) * (mean albedo): here the bright
   half is black. The picture reaches its target, and a picture with its price has the same error. */
TEST(prices_are_shares_of_final) {
    sbl_picture_desc view = scene_view(48, 48, 40, 0, 4, 0, 0, 0, 0);
    test_scene s = { 0 };
    sbl_stats stats;
    double error;
    scene_quad(&s, scene_material(&s, 0.02f, 0.02f, 0.02f), -1.5f, 0, -1.5f, -1.5f, 0, 1.5f, 0, 0, 1.5f, 0, 0, -1.5f);
    scene_quad(&s, scene_material(&s, 0.9f, 0.9f, 0.9f), 0, 0, -1.5f, 0, 0, 1.5f, 1.5f, 0, 1.5f, 1.5f, 0, -1.5f);
    scene_sphere(&s, scene_gloss(&s, 0.2, 0.2, 0.2, 0, 0.4), 0.8f, 0.3f, 0, 0.3f, 24, 12, 1);
    scene_quad(&s, scene_lamp(&s, 40, 40, 40), -1.4f, 0.8f, -0.3f, -1.2f, 0.8f, -0.3f, -1.2f, 0.8f, 0.3f, -1.4f, 0.8f,
               0.3f);
    scene_quad(&s, 0, 0, 0, -1.5f, 0, 0.5f, -1.5f, 0, 0.5f, 1.5f, 0, 0, 1.5f);
    view.options.mode = SBL_MODE_DIRECT;
    view.target_error = 0.02f;
    if (!scene_render(context, &s, &view)) return;
    stats = sbl_query_stats(context);
    memcpy(view.mean_radiance, stats.picture.mean_radiance, sizeof view.mean_radiance);
    memcpy(view.mean_final, stats.picture.mean_final, sizeof view.mean_final);
    view.look_rays = stats.picture.look_rays;
    view.price = stats.picture.price;
    view.specular_price = stats.picture.specular_price;
    if (!scene_render(context, &s, &view)) return;
    error = (double)sbl_query_stats(context).picture.radiance_error;
    printf("    mean R %.4f, mean of FINAL %.4f; error of R %.5f, with the price %.5f\n",
           (double)stats.picture.mean_radiance[1], (double)stats.picture.mean_final[1],
           (double)stats.picture.radiance_error, error);
    CHECK(stats.picture.radiance_error < 0.022f, "error %g", (double)stats.picture.radiance_error);
    CHECK(fabs(error / (double)stats.picture.radiance_error - 1) < 0.15, "error %g, with its price %g",
          (double)stats.picture.radiance_error, error);
    scene_free(&s);
}

/* A glossy picture that ends early, at any point, leaks no memory. */
TEST(ends_leave_nothing) {
    const sbl_picture_desc view = glossy_view(SBL_MODE_DIRECT);
    test_scene s = { 0 };
    sbl_memory memory;
    int stop, blocks, finished = 0;
    glossy_scene(&s, 0);
    if (!scene_render(context, &s, &view)) return;
    sbl_end(context);
    memory = sbl_query_memory(context);
    blocks = seen.blocks;
    for (stop = 1; !finished; stop += 1 + stop / 6) {
        sbl_memory now;
        int i;
        CHECK(sbl_begin_picture(context, &view) == SBL_SUCCESS, "cannot begin");
        for (i = 0; i < stop && !finished; i++) finished = sbl_step(context, 1e-9) != SBL_UNFINISHED;
        sbl_end(context);
        now = sbl_query_memory(context);
        CHECK(now.host_bytes == memory.host_bytes && now.gpu_bytes == memory.gpu_bytes && seen.blocks == blocks,
              "after %d steps: %.0f host and %.0f GPU bytes in use, before %.0f and %.0f", stop, (double)now.host_bytes,
              (double)now.gpu_bytes, (double)memory.host_bytes, (double)memory.gpu_bytes);
    }
    scene_free(&s);
}

/* When memory runs out anywhere in a glossy picture, the picture fails and leaks nothing, and the next picture is as
   usual. */
TEST(memory_runs_out) {
    sbl_picture_desc view = glossy_view(SBL_MODE_DIRECT);
    float *expected, *final;
    test_scene s = { 0 };
    int place, blocks, tried = 0;
    view.width = 12;
    view.height = 9;
    glossy_scene(&s, 0);
    if (!scene_render(context, &s, &view)) return;
    expected = scene_channel(context, &view, SBL_CHANNEL_FINAL);
    sbl_end(context);
    blocks = seen.blocks;
    for (place = 1;; place++) {
        sbl_result result;
        watch_refuse(&seen, place);
        result = sbl_render_picture(context, &view);
        if (!watch_refused(&seen, place, result)) break;
        CHECK(seen.errors > 0, "allocation %d: no message", place);
        sbl_end(context);
        CHECK(seen.blocks == blocks, "allocation %d: %d blocks are left", place, seen.blocks - blocks);
        tried++;
    }
    printf("    %d allocations of %d\n", tried, place);
    final = scene_channel(context, &view, SBL_CHANNEL_FINAL);
    CHECK(tried > 20, "only %d allocations were refused", tried);
    CHECK(memcmp(final, expected, 12 * 9 * 3 * sizeof *final) == 0, "the picture after lack of memory is different");
    free(final);
    free(expected);
    scene_free(&s);
}

/* Without the functions that GL 3.3 lacks, the picture is about the same. */
TEST(old_gl_makes_the_same_picture) {
    sbl_picture_desc view = scene_plain(glossy_view(SBL_MODE_DIRECT), SBL_MODE_DIRECT, 0);
    sbl_context_desc desc = watch_desc(&seen);
    float *new_picture, *old_picture;
    test_scene s = { 0 };
    sbl_context *old;
    double off = 0, all = 0;
    int i, different = 0;
    glossy_scene(&s, 0);
    view.options.rays = 32;
    if (!scene_render(context, &s, &view)) return;
    new_picture = scene_channel(context, &view, SBL_CHANNEL_FINAL);
    desc.disabled = SBL_CAPABILITY_ALL;
    old = watch_context(&seen, &desc, &s);
    REQUIRE(old, "no context");
    CHECK(sbl_query_capabilities(old).used == 0, "there are capabilities");
    CHECK(sbl_render_picture(old, &view) == SBL_SUCCESS, "no picture: %s", watch_last(&seen));
    old_picture = scene_channel(old, &view, SBL_CHANNEL_FINAL);
    for (i = 0; i < FLOATS; i++) {
        off += fabs((double)old_picture[i] - (double)new_picture[i]);
        all += (double)new_picture[i];
        different += fabs((double)old_picture[i] - (double)new_picture[i]) > 1e-3 * (double)new_picture[i];
    }
    printf("    mean difference %.6f, %d of %d values\n", off / all, different, FLOATS);
    CHECK(off < 0.002 * all && different < FLOATS / 50, "the picture is different by %.5f", off / all);
    sbl_destroy(old);
    free(new_picture);
    free(old_picture);
    scene_free(&s);
}

/* >>predicted errors */

enum { ROOM_WIDTH = 80, ROOM_HEIGHT = 60, ROOM_PIXELS = ROOM_WIDTH * ROOM_HEIGHT, SEEDS = 3 };

/* Makes a room with two balls, of metal and of smooth plastic, and a lamp just below the ceiling. kind: 0: walls of
   rough plastic; 1: of metal; 2: matte */
static void glossy_room(test_scene *s, int kind) {
    const int walls = kind == 0 ? scene_gloss(s, 0.6, 0.6, 0.5, 0, 0.6)
                    : kind == 1 ? scene_gloss(s, 0.8, 0.7, 0.6, 1, 0.4) : scene_material(s, 0.6f, 0.6f, 0.5f);
    const int metal = scene_gloss(s, 0.9, 0.8, 0.4, 1, 0.45), plastic = scene_gloss(s, 0.1, 0.2, 0.6, 0, 0.15);
    const int lamp = scene_lamp(s, 12, 11, 9);
    int i;
    scene_box(s, walls, -2, 0, -2, 2, 2, 2);
    scene_sphere(s, metal, -0.7f, 0.5f, -0.5f, 0.5f, 48, 24, 1);
    scene_sphere(s, plastic, 0.7f, 0.4f, 0.2f, 0.4f, 48, 24, 1);
    scene_quad(s, lamp, -0.6f, 1.99f, -0.6f, 0.6f, 1.99f, -0.6f, 0.6f, 1.99f, 0.6f, -0.6f, 1.99f, 0.6f);
    for (i = 0; i < s->mesh_count; i++) s->meshes[i].id = (uint32_t)i + 1;
}

static double luminance_of(const float *c) {
    return 0.2126 * (double)c[0] + 0.7152 * (double)c[1] + 0.0722 * (double)c[2];
}

/* Sums over pixels or over pictures; names that end in 2 are sums of squares. */
typedef struct foretold { double off2, predicted2, of_r2, stated2, stated_r2, final; } foretold;

/* Adds a picture to the sums. exact: the same picture without errors */
static void foretell(foretold *f, shot *p, shot *exact) {
    const sbl_stats stats = sbl_query_stats(context);
    int i, k;
    f->stated2 += pow((double)stats.picture.expected_error, 2) / SEEDS;
    f->stated_r2 += pow((double)stats.picture.radiance_error, 2) / SEEDS;
    for (i = 0; i < ROOM_PIXELS; i++) {
        const int x = i % ROOM_WIDTH, y = i / ROOM_WIDTH;
        const float *matte = at(p, SBL_CHANNEL_ALBEDO, x, y), *light = at(p, SBL_CHANNEL_RADIANCE, x, y);
        float final[3];  /* without emission */
        for (k = 0; k < 3; k++) final[k] = matte[k] * light[k] + (float)reflected(p, x, y, k);
        f->off2 += pow(luminance_of(at(p, SBL_CHANNEL_FINAL, x, y)) -
                       luminance_of(at(exact, SBL_CHANNEL_FINAL, x, y)), 2);
        f->predicted2 += pow((double)at(p, SBL_CHANNEL_ERROR, x, y)[0], 2);
        f->of_r2 += pow(luminance_of(matte) * (double)at(p, SBL_CHANNEL_RADIANCE_ERROR, x, y)[0], 2);
        f->final += luminance_of(final);
    }
}

/* Predicted errors are shares of the mean, also if no sensor of the first level sees the only surface, which is black
   plastic, and if a window shows only the sky. */
TEST(errors_of_small_things_are_shares) {
    static const sbl_backend backends[2] = { SBL_BACKEND_RASTER, SBL_BACKEND_TRACE };
    int kind;
    for (kind = 0; kind < 4; kind++) {
        test_scene s = { 0 };
        sbl_picture_desc view = scene_view(32, 32, 45, 0, 1.5f, 3, 0, 0.5f, 0);
        sbl_stats stats;
        shot p;
        scene_floor(&s, scene_gloss(&s, 0, 0, 0, 0, 0.3), 0, 1);
        scene_sky(&s, 1, 1, 1);
        view.options.mode = SBL_MODE_DIRECT;
        view.options.rays = 48;
        view.options.backend = backends[kind & 1];
        if (kind >= 2) view.window[2] = view.window[3] = 6;
        if (!shoot(&p, &s, &view)) return;
        stats = sbl_query_stats(context);
        CHECK(stats.picture.specular_error < 0.1f && stats.picture.expected_error < 0.1f &&
              stats.picture.radiance_error < 0.1f, "kind %d: errors %g, of lobes %g", kind,
              (double)stats.picture.expected_error, (double)stats.picture.specular_error);
        CHECK(kind >= 2 || stats.picture.specular_error > 0, "kind %d: no lobe is seen", kind);
        forget(&p);
        scene_free(&s);
    }
}

/* The predicted error of FINAL, for pixels and for the picture, is close to the true error. The exact picture has many
   rays at each pixel. */
TEST(errors_of_final_are_foretold) {
    int kind, seed, i;
    for (kind = 0; kind < 3; kind++) {
        sbl_picture_desc view = scene_view(ROOM_WIDTH, ROOM_HEIGHT, 65, 0.2f, 1, 1.9f, 0, 0.9f, 0), exact;
        const double pixels = SEEDS * ROOM_PIXELS;
        double error, predicted, of_r;
        foretold f = { 0, 0, 0, 0, 0, 0 };
        test_scene s = { 0 };
        shot p, q;
        glossy_room(&s, kind);
        view.options.mode = SBL_MODE_DIRECT;
        view.samples = 1;
        exact = scene_plain(view, SBL_MODE_DIRECT, 0);
        exact.options.rays = 512;
        if (!shoot(&q, &s, &exact)) return;
        for (i = 0; i < ROOM_PIXELS; i++) at(&q, SBL_CHANNEL_FINAL, i % ROOM_WIDTH, i / ROOM_WIDTH);
        for (seed = 0; seed < SEEDS; seed++) {
            view.options.seed = (uint32_t)seed;
            if (!shoot(&p, &s, &view)) return;
            foretell(&f, &p, &q);
            forget(&p);
        }
        error = sqrt(f.off2 * pixels) / f.final;
        predicted = sqrt(f.predicted2 * pixels) / f.final;
        of_r = sqrt(f.of_r2 * pixels) / f.final;
        printf("    kind %d: error %.4f, %.4f predicted, %.4f stated; R: %.4f predicted, %.4f stated\n", kind, error,
               predicted, sqrt(f.stated2), of_r, sqrt(f.stated_r2));
        CHECK(predicted < 1.4 * error && error < 1.4 * predicted, "kind %d: the error is %.4f, %.4f predicted", kind,
              error, predicted);
        CHECK(fabs(sqrt(f.stated2) / predicted - 1) < 0.15, "kind %d: stated error %.4f", kind, sqrt(f.stated2));
        CHECK(fabs(sqrt(f.stated_r2) / of_r - 1) < 0.15, "kind %d: stated error of R %.4f", kind, sqrt(f.stated_r2));
        forget(&q);
        scene_free(&s);
    }
}

/* Beside a lamp that almost touches a rough surface, one column of pixels reflects far more light than its neighbours.
   Sensors of lobes are placed there, because R reveals the lamp. The view without `tile` has a sensor at each pixel. */
TEST(lamps_show_in_lobes_beside_them) {
    enum { SIDE = 64, COLUMN = 43 };
    static const float edge = (COLUMN + 0.5f) / (SIDE / 2) - 1 - 0.0005f;
    sbl_picture_desc exact = view_of_ball(SIDE, 512), view = exact;
    test_scene s = { 0 };
    double sums[2] = { 0, 0 };
    shot p;
    int i, k;
    view.tile = view.filter_radius = view.options.rays = 0;
    scene_quad(&s, scene_gloss(&s, 0.7, 0.7, 0.7, 0, 1), -1, -1, 0, 1, -1, 0, 1, 1, 0, -1, 1, 0);
    scene_quad(&s, scene_lamp(&s, 8, 8, 8), -edge, -0.5f, 0.005f, edge, -0.5f, 0.005f, edge, 0.5f, 0.005f, -edge,
               0.5f, 0.005f);
    for (k = 0; k < 2; k++) {
        if (!shoot(&p, &s, k ? &exact : &view)) return;
        for (i = SIDE / 4 + 2; i < 3 * SIDE / 4 - 2; i++) sums[k] += reflected(&p, COLUMN, i, 1);
        forget(&p);
    }
    printf("    %.4f of the light\n", sums[0] / sums[1]);
    CHECK(sums[1] > 1 && fabs(sums[0] / sums[1] - 1) < 0.25, "%.4f instead of %.4f", sums[0], sums[1]);
    scene_free(&s);
}

/* The squared error of FINAL is the sum of the squares of three parts: albedo * R, the error of the sensors of lobes,
   and stored light in lobes, which only SBL_MODE_GI has. */
TEST(parts_of_the_error_add_up) {
    int gi, i;
    for (gi = 0; gi < 2; gi++) {
        sbl_picture_desc view = scene_view(ROOM_WIDTH, ROOM_HEIGHT, 65, 0.2f, 1, 1.9f, 0, 0.9f, 0);
        double matte2 = 0, all2 = 0, share;
        foretold f = { 0, 0, 0, 0, 0, 0 };
        test_scene s = { 0 };
        sbl_stats stats;
        shot p;
        glossy_room(&s, 1);
        view.options.mode = gi ? SBL_MODE_GI : SBL_MODE_DIRECT;
        view.options.preset = SBL_PRESET_DRAFT;
        view.samples = 1;
        if (!shoot(&p, &s, &view)) return;
        stats = sbl_query_stats(context);
        foretell(&f, &p, &p);
        for (i = 0; i < ROOM_PIXELS; i++) {
            const int x = i % ROOM_WIDTH, y = i / ROOM_WIDTH;
            matte2 += pow((double)at(&p, SBL_CHANNEL_RADIANCE_ERROR, x, y)[0] *
                          luminance_of(at(&p, SBL_CHANNEL_ALBEDO, x, y)) / f.final, 2) * ROOM_PIXELS;
        }
        all2 = pow((double)stats.picture.expected_error, 2);
        share = (all2 - pow((double)stats.picture.specular_error, 2) - matte2) / all2;
        printf("    %s: %.4f of the square are of stored light, %.4f of albedo * R\n", gi ? "all bounces" : "direct",
               share, matte2 / all2);
        CHECK(gi ? share > 0.1 && share < 0.3 : fabs(share) < 0.02, "share of stored light: %.4f", share);
        forget(&p);
        scene_free(&s);
    }
}

/* Metal that no pixel shows has no effect on the predicted error of FINAL: it is that of R times albedo, also if the
   surfaces in penumbrae are dark. */
TEST(errors_without_visible_lobes) {
    sbl_picture_desc view = scene_view(ROOM_WIDTH, ROOM_HEIGHT, 40, 0, 3, 0.01f, 0, 0, 0);
    const int dark = 4;
    double off2 = 0, final = 0, wanted, stated;
    test_scene s = { 0 };
    shot p;
    int i;
    glossy_scene(&s, 1);
    for (i = 0; i < 3; i++) s.materials[dark].albedo[i] = 0.05f;
    s.mesh_count = 1;
    scene_quad(&s, dark, -4, 0.001f, -4, -4, 0.001f, 4, 0, 0.001f, 4, 0, 0.001f, -4);
    scene_quad(&s, dark, -0.5f, 0.4f, -0.5f, -0.5f, 0.4f, 0.5f, -0.1f, 0.4f, 0.5f, -0.1f, 0.4f, -0.5f);
    scene_quad(&s, scene_gloss(&s, 1, 1, 1, 1, 0.2), -1, 0, 8, 1, 0, 8, 1, 1, 8, -1, 1, 8);
    view.options.mode = SBL_MODE_DIRECT;
    view.samples = 1;
    if (!shoot(&p, &s, &view)) return;
    stated = (double)sbl_query_stats(context).picture.expected_error;
    for (i = 0; i < ROOM_PIXELS; i++) {
        const int x = i % ROOM_WIDTH, y = i / ROOM_WIDTH;
        off2 += pow((double)at(&p, SBL_CHANNEL_RADIANCE_ERROR, x, y)[0] *
                    luminance_of(at(&p, SBL_CHANNEL_ALBEDO, x, y)), 2);
        final += luminance_of(at(&p, SBL_CHANNEL_FINAL, x, y));
    }
    wanted = sqrt(off2 * ROOM_PIXELS) / final;
    printf("    error of FINAL %.5f, %.5f stated; of R %.5f\n", wanted, stated,
           (double)sbl_query_stats(context).picture.radiance_error);
    CHECK(fabs(stated / wanted - 1) < 0.005, "the error of FINAL is %g, not %g", stated, wanted);
    forget(&p);
    scene_free(&s);
}

/* The error of reflections is close to the prediction. */
TEST(errors_are_foretold) {
    sbl_picture_desc view = glossy_view(SBL_MODE_DIRECT), exact = scene_plain(view, SBL_MODE_DIRECT, 0);
    test_scene s = { 0 };
    double off2 = 0, sum = 0, error, predicted;
    shot p, q;
    int i;
    glossy_scene(&s, 0);
    exact.options.rays = 256;
    if (!shoot(&q, &s, &exact)) return;
    at(&q, SBL_CHANNEL_SPECULAR, 0, 0);
    at(&q, SBL_CHANNEL_SPECULAR_ALBEDO, 0, 0);
    at(&q, SBL_CHANNEL_FINAL, 0, 0);
    if (!shoot(&p, &s, &view)) return;
    predicted = (double)sbl_query_stats(context).picture.specular_error;
    for (i = 0; i < WIDTH * HEIGHT; i++) {
        const double a = reflected(&p, i % WIDTH, i / WIDTH, 1), b = reflected(&q, i % WIDTH, i / WIDTH, 1);
        off2 += (a - b) * (a - b) / (WIDTH * HEIGHT);
        sum += (double)at(&q, SBL_CHANNEL_FINAL, i % WIDTH, i / WIDTH)[1] / (WIDTH * HEIGHT);
    }
    error = sqrt(off2) / sum;
    printf("    error %.4f, %.4f predicted\n", error, predicted);
    CHECK(error > 0.2 * predicted && error < 1.6 * predicted && predicted < 0.06, "the error is %.4f, %.4f predicted",
          error, predicted);
    forget(&p);
    forget(&q);
    scene_free(&s);
}

/* A smooth floor reflects a wall, half of which lies in a shadow. The reflection shows the edge of the shadow and the
   light beside it, although the wall has only a few cells. */
TEST(smooth_floors_show_no_cells) {
    enum { SIDE = 12 };
    sbl_picture_desc view = scene_plain(view_of_plate(SIDE, SIDE, 12, 45, 64), SBL_MODE_GI, 0);
    test_scene s = { 0 };
    const double lit = 0.8 * 3 / TEST_PI;
    double worst = 0;
    sbl_scene_desc scene;
    int i, beside = 0;
    shot p;
    scene_floor(&s, scene_gloss(&s, 0, 0, 0, 0, 0.1), 0, 1);
    scene_quad(&s, scene_material(&s, 0.8f, 0.8f, 0.8f), -1, 0, -2, -1, 0, 2, -1, 3, 2, -1, 3, -2);
    scene_quad(&s, scene_material(&s, 0, 0, 0), 4, 0, -3, 4, 0, 0, 4, 4, 0, 4, 4, -3);
    scene_floor(&s, scene_material(&s, 0, 0, 0), -20, 8);  /* this floor takes most of the cells */
    scene_light(&s, SBL_LIGHT_DIRECTIONAL, 3, 3, 3)->direction[0] = -1;
    scene = scene_desc(&s);
    scene.max_bounce_cells = 1024;
    memset(&p, 0, sizeof p);
    p.view = view;
    p.context = context;
    REQUIRE(sbl_set_scene(context, &scene) == SBL_SUCCESS && sbl_render_picture(context, &view) == SBL_SUCCESS,
            "no picture: %s", watch_last(&seen));
    for (i = 0; i < SIDE * SIDE; i++) {
        const double shown = (double)at(&p, SBL_CHANNEL_SPECULAR, i % SIDE, i / SIDE)[1];
        double way[3], z;
        look(&view, i % SIDE, i / SIDE, way);
        z = (4 * sqrt(0.5) + 1) / -way[0] * way[2];
        if (fabs(z) < 0.15) continue;
        worst = test_max(worst, fabs(shown - (z > 0 ? lit : 0)));
        beside += fabs(z) < 0.3;
    }
    printf("    off by %.4f of %.4f\n", worst, lit);
    CHECK(worst < 0.1 * lit && beside > 20, "off by %.4f of %.4f, %d pixels beside the edge", worst, lit, beside);
    forget(&p);
    scene_free(&s);
}

/* A rough floor sees a light in a mirror. All its pixels see the same, and they differ little: for rays of the floor's
   lobe, the mirror has half the roughness of the floor, and so it blurs the light. */
TEST(floors_see_lights_in_mirrors_evenly) {
    enum { SIDE = 12 };
    sbl_picture_desc view = scene_plain(view_of_plate(SIDE, SIDE, 0.1, 45, 64), SBL_MODE_GI, 0);
    const double side = sqrt(0.5), v[3] = { side, 0, side }, l[3] = { -side, 0, side };
    const double sharp = lobe_brdf(v, l, 0.4, 1) * side / 18;  /* the image of the light is at -3 3 0 */
    test_scene s = { 0 };
    double mean = 0, squares = 0;
    int i;
    shot p;
    view.options.rays = 256;
    scene_floor(&s, scene_gloss(&s, 1, 1, 1, 1, 0.4), 0, 0.1f);
    scene_quad(&s, scene_gloss(&s, 1, 1, 1, 1, 0), -1, 0, -2, -1, 0, 2, -1, 3, 2, -1, 3, -2);
    scene_light(&s, SBL_LIGHT_POINT, 1, 1, 1)->position[0] = 1;
    s.lights[0].position[1] = 3;
    if (!shoot(&p, &s, &view)) return;
    for (i = 0; i < SIDE * SIDE; i++) mean += reflected(&p, i % SIDE, i / SIDE, 1) / (SIDE * SIDE);
    for (i = 0; i < SIDE * SIDE; i++) squares += pow(reflected(&p, i % SIDE, i / SIDE, 1) - mean, 2) / (SIDE * SIDE);
    printf("    %.4f, %.4f if the mirror did not blur; pixels differ by %.4f of it\n", mean, sharp,
           sqrt(squares) / mean);
    CHECK(mean < sharp && mean > 0.8 * sharp && sqrt(squares) < 0.1 * mean, "%.4f of %.4f; pixels differ by %.4f", mean,
          sharp, sqrt(squares));
    forget(&p);
    scene_free(&s);
}

/* A lamp is much wider than the lobe of a floor, and most of it is hidden, but not most of the light in the lobe. The
   predicted error is between about one and three times the deviation of the pixels, which all see the same. */
TEST(noise_in_lobes_is_foretold) {
    enum { SIDE = 16 };
    static const double roughnesses[2] = { 0.25, 0.4 };
    int kind, i;
    for (kind = 0; kind < 2; kind++) {
        sbl_picture_desc view = view_of_plate(SIDE, SIDE, 0.1, 45, 64);
        double mean = 0, squares = 0, foretold2 = 0, deviation;
        test_scene s = { 0 };
        shot p;
        scene_floor(&s, scene_gloss(&s, 1, 1, 1, 1, roughnesses[kind]), 0, 0.5f);
        scene_quad(&s, scene_lamp(&s, 1, 1, 1), -3, 2, -1, -3, 2, 4, -0.5f, 2, 4, -0.5f, 2, -1);
        scene_quad(&s, scene_material(&s, 0, 0, 0), -3, 1, 0.2f, -3, 1, 4, 0, 1, 4, 0, 1, 0.2f);
        if (!shoot(&p, &s, &view)) return;
        for (i = 0; i < SIDE * SIDE; i++) {
            const double light = reflected(&p, i % SIDE, i / SIDE, 1);
            mean += light / (SIDE * SIDE);
            squares += light * light / (SIDE * SIDE);
            foretold2 += pow((double)at(&p, SBL_CHANNEL_ERROR, i % SIDE, i / SIDE)[0], 2) / (SIDE * SIDE);
        }
        deviation = sqrt(squares - mean * mean);
        printf("    roughness %.2f: light %.4f deviates by %.5f, %.5f predicted\n", roughnesses[kind], mean, deviation,
               sqrt(foretold2));
        CHECK(sqrt(foretold2) > 0.8 * deviation && sqrt(foretold2) < 3 * deviation,
              "roughness %.2f: a deviation of %.5f, %.5f predicted", roughnesses[kind], deviation, sqrt(foretold2));
        forget(&p);
        scene_free(&s);
    }
}

/* Few rays find a lamp by way of metal or a pane. Each of them makes a tile look noisy. The smaller tiles that replace
   the tile soon trust their own sensors: the picture takes 323,000 rays. If they never did, it would take 399,000 rays
   for nearly the same error, which stored light causes. */
TEST(chance_finds_buy_few_looks) {
    sbl_picture_desc view = scene_view(32, 24, 70, 0, 1, 1.9f, 0, 0.8f, -1);
    test_scene s = { 0 };
    double rays, error;
    scene_box(&s, scene_material(&s, 0.7f, 0.7f, 0.7f), -1.5f, 0, -1, 1.5f, 2, 2);
    scene_quad(&s, scene_pane(&s, 0.95, 0.95, 0.95, 1), 0.6f, 0, -0.9f, 0.6f, 0, 0.5f, 0.6f, 1.8f, 0.5f, 0.6f, 1.8f,
               -0.9f);
    scene_sphere(&s, scene_gloss(&s, 0.9, 0.9, 0.9, 1, 0.1), -0.5f, 0.3f, -0.3f, 0.3f, 24, 12, 1);
    scene_box(&s, scene_lamp(&s, 100, 90, 70), -0.1f, 1.6f, -0.9f, 0.1f, 1.65f, -0.85f);
    view.options.mode = SBL_MODE_GI;
    view.target_error = 0.02f;
    if (!scene_render(context, &s, &view)) return;
    rays = (double)sbl_query_stats(context).sensors.rays;
    error = (double)sbl_query_stats(context).picture.radiance_error;
    printf("    %.0f rays, error of R %.4f\n", rays, error);
    CHECK(rays < 360000 && error < 0.044, "%.0f rays, error of R %.4f", rays, error);
    scene_free(&s);
}

/* With rasterised views for R, rays still measure the reflections. */
TEST(views_and_lobes) {
    sbl_picture_desc view = scene_plain(glossy_view(SBL_MODE_DIRECT), SBL_MODE_DIRECT, 0);
    double sums[2] = { 0, 0 };
    test_scene s = { 0 };
    int raster, i;
    glossy_scene(&s, 0);
    view.options.rays = 64;
    view.options.sensor_size = 16;
    for (raster = 0; raster < 2; raster++) {
        shot p;
        view.options.backend = raster ? SBL_BACKEND_RASTER : SBL_BACKEND_TRACE;
        if (!shoot(&p, &s, &view)) return;
        for (i = 0; i < WIDTH * HEIGHT; i++) sums[raster] += reflected(&p, i % WIDTH, i / WIDTH, 1);
        forget(&p);
    }
    printf("    reflections with views %.3f, without %.3f\n", sums[1], sums[0]);
    CHECK(sums[0] > 1 && fabs(sums[1] / sums[0] - 1) < 0.01, "reflections are %.4f times as bright", sums[1] / sums[0]);
    scene_free(&s);
}

int main(void) {
    const sbl_context_desc desc = watch_desc(&seen);
    if (sbl_create(&desc, &context) != SBL_SUCCESS) { printf("no context\n0 passed, 1 failed, 0 skipped\n"); return 1; }
    RUN_UNSANITIZED(silhouettes_of_mirrors_are_white);
    RUN_UNSANITIZED(furnace_of_metal);
    RUN_UNSANITIZED(furnace_of_plastic);
    RUN_UNSANITIZED(albedo_of_lobes);
    RUN_UNSANITIZED(specular_textures);
    RUN(normals_are_tilted);
    RUN_UNSANITIZED(pixels_average_normals);
    RUN_UNSANITIZED(mirrors_show_lamps);
    RUN_UNSANITIZED(mirrors_show_surfaces);
    RUN_UNSANITIZED(mirrors_blur_what_they_show);
    RUN(only_blurred_pixels_get_further_samples);
    RUN_UNSANITIZED(mirrors_lose_no_light);
    RUN_UNSANITIZED(panes_mirror_bounced_light);
    RUN_UNSANITIZED(panes_mirror_metal);
    RUN_UNSANITIZED(panes_blur_polished_metal);
    RUN_UNSANITIZED(panes_show_panes_in_mirrors);
    RUN_UNSANITIZED(panes_read_red);
    RUN_UNSANITIZED(highlights_of_lamps);
    RUN_UNSANITIZED(highlights_of_lights);
    RUN_UNSANITIZED(highlights_of_the_sky);
    RUN_UNSANITIZED(highlights_of_suns_have_little_noise);
    RUN_UNSANITIZED(distance_keeps_highlights);
    RUN_UNSANITIZED(distance_moves_positions);
    RUN_UNSANITIZED(lamps_behind_panes);
    RUN_UNSANITIZED(floors_behind_panes);
    RUN_UNSANITIZED(distance_of_moved_meshes);
    RUN_UNSANITIZED(panes_at_one_place_all_tint);
    RUN_UNSANITIZED(blended_surfaces_show_themselves);
    RUN_UNSANITIZED(furnace_of_a_room);
    RUN_UNSANITIZED(metal_lights_floors);
    RUN_UNSANITIZED(metal_lights_floors_evenly);
    RUN_UNSANITIZED(gloss_lights_floors);
    RUN_UNSANITIZED(weak_metal_is_like_strong_gloss);
    RUN_UNSANITIZED(gloss_mirrors_lamps_to_floors);
    RUN_UNSANITIZED(stored_light_behind_red_panes_is_red);
    RUN_UNSANITIZED(panes_in_furnaces_are_white);
    RUN_UNSANITIZED(lamps_of_many_triangles_add_no_noise);
    RUN(lamps_may_grow);
    RUN_UNSANITIZED(mirrored_lamps_are_found);
    RUN_UNSANITIZED(several_lamps_are_mirrored);
    RUN_UNSANITIZED(lamps_beside_mirrors);
    RUN(glows_do_not_widen_lamps_in_mirrors);
    RUN_UNSANITIZED(mirrored_suns_have_no_unit);
    RUN_UNSANITIZED(guided_rays_and_mirrored_lamps);
    RUN_UNSANITIZED(rays_to_mirrored_lamps_are_inspected);
    RUN_UNSANITIZED(near_lamps_outshine_their_images);
    RUN_UNSANITIZED(glows_of_metal_count_once);
    RUN_UNSANITIZED(bright_places_are_seen_by_way_of_metal);
    RUN_UNSANITIZED(furnace_of_a_mirror_ball);
    RUN_UNSANITIZED(lobes_may_be_black);
    RUN(matte_scenes_stay_the_same);
    RUN_UNSANITIZED(rooms_reflect_their_mean);
    RUN_UNSANITIZED(metal_out_of_view);
    RUN_UNSANITIZED(materials_change);
    RUN(paper_is_matte);
    RUN(steps_make_the_same_picture);
    RUN(windows_show_the_same);
    RUN_UNSANITIZED(windows_share_prices_of_lobes);
    RUN_UNSANITIZED(prices_are_shares_of_final);
    RUN_UNSANITIZED(lamps_show_in_lobes_beside_them);
    RUN_UNSANITIZED(errors_of_small_things_are_shares);
    RUN_UNSANITIZED(errors_of_final_are_foretold);
    RUN_UNSANITIZED(parts_of_the_error_add_up);
    RUN_UNSANITIZED(errors_without_visible_lobes);
    RUN_UNSANITIZED(errors_are_foretold);
    RUN_UNSANITIZED(smooth_floors_show_no_cells);
    RUN_UNSANITIZED(floors_see_lights_in_mirrors_evenly);
    RUN_UNSANITIZED(noise_in_lobes_is_foretold);
    RUN(chance_finds_buy_few_looks);
    RUN_UNSANITIZED(views_and_lobes);
    RUN(ends_leave_nothing);
    RUN(memory_runs_out);
    RUN(old_gl_makes_the_same_picture);
    sbl_destroy(context);
    return test_report();
}
