/* Demonstrates every kind of light in one picture each, and the penumbra of a large lamp at each preset. Below the
   pictures of the penumbra, the rays of four sensors are drawn; those that are blocked on their way to the lamp are
   red. The first argument is the folder for the pictures. With a second argument, the pictures are an eighth as wide
   and high, bounced light has few cells, and the pictures of the kinds are drafts. */
#define SBL_IMPLEMENTATION
#include "headless.h"
#include "sensor_disc.h"
#define STB_IMAGE_WRITE_IMPLEMENTATION
#include <stb/stb_image_write.h>
#include <math.h>
#include <stdlib.h>

enum { WIDTH = 320, HEIGHT = 240, INSETS = 4, INSET = WIDTH / INSETS, SLICES = 24, PANES = 6, FEW_CELLS = 2048 };

/* ---- three shapes, from which the scenes are built ---- */

#define SIDE(ax, ay, az, bx, by, bz, cx, cy, cz, dx, dy, dz) \
    ax, ay, az, bx, by, bz, cx, cy, cz, ax, ay, az, cx, cy, cz, dx, dy, dz
static const float quad[] = { SIDE(-1, 0, -1, -1, 0, 1, 1, 0, 1, 1, 0, -1) };
static const float quad_texcoords[] = { 0, 0, 0, 1, 1, 1, 0, 0, 1, 1, 1, 0 };
static const float box[] = {  /* stands on the ground, and has no bottom face */
    SIDE(-1, 2, -1, -1, 2, 1, 1, 2, 1, 1, 2, -1), SIDE(-1, 0, 1, 1, 0, 1, 1, 2, 1, -1, 2, 1),
        SIDE(1, 0, -1, -1, 0, -1, -1, 2, -1, 1, 2, -1),
    SIDE(1, 0, 1, 1, 0, -1, 1, 2, -1, 1, 2, 1), SIDE(-1, 0, -1, -1, 0, 1, -1, 2, 1, -1, 2, -1) };
static float ball[4 * SLICES * (SLICES - 1) * 9];  /* positions, which also serve as normals */

static void make_ball(void) {
    static const int corner[6][2] = { { 0, 0 }, { 1, 0 }, { 1, 1 }, { 0, 0 }, { 1, 1 }, { 0, 1 } };
    float *to = ball;
    int i, j, k;
    for (i = 0; i < SLICES; i++)
        for (j = 0; j < 2 * SLICES; j++)
            for (k = i < SLICES - 1 ? 0 : 3; k < (i ? 6 : 3); k++) {  /* one triangle at a pole, otherwise two */
                double polar = 4 * atan(1.0) * (i + corner[k][0]) / SLICES,
                    turn = 4 * atan(1.0) * (j + corner[k][1]) / SLICES;
                *to++ = (float)(sin(polar) * sin(turn));
                *to++ = (float)cos(polar);
                *to++ = (float)(sin(polar) * cos(turn));
            }
}

enum { WHITE, RED, BLUE, LAMP, WARM, COLD, GLASS, MATERIALS };
static const sbl_material materials[MATERIALS] = {
    [WHITE] = { .albedo = { 0.7f, 0.7f, 0.7f } }, [RED] = { .albedo = { 0.7f, 0.25f, 0.15f } },
    [BLUE] = { .albedo = { 0.2f, 0.35f, 0.65f } },
    [LAMP] = { .emission = { 20, 18, 14 } }, [WARM] = { .emission = { 120, 70, 25 } },
    [COLD] = { .emission = { 30, 60, 120 } },
    [GLASS] = { .emission = { 40, 40, 40 }, .emission_texture = 1 } };
static const unsigned char panes[PANES * 3] = { 255, 40, 20,  255, 220, 30,  30, 230, 60,  20, 90, 255,  200, 30, 220,
    255, 255, 255 };
static const sbl_texture window_picture = { .pixels = panes, .width = PANES, .height = 1, .channels = 3,
    .wrap = SBL_WRAP_CLAMP };

typedef struct world { sbl_mesh meshes[1024]; int count; } world;

/* Adds an object with this shape. x, y, z: centre of its base, or of the ball */
static void add(world *w, const float *shape, int vertices, float x, float y, float z, float width, float height,
                float depth, int material) {
    const sbl_mesh mesh = {
        .positions = { .data = shape }, .normals = { .data = shape == ball ? ball : NULL },
        .texcoords = { .data = shape == quad ? quad_texcoords : NULL },
        .vertex_count = vertices, .material = material,
        .transform = { width / 2, 0, 0, 0,  0, height / 2, 0, 0,  0, 0, depth / 2, 0,  x, y, z, 1 } };
    w->meshes[w->count++] = mesh;
}
#define ADD(w, shape, ...) add(w, shape, (int)(sizeof shape / (3 * sizeof *shape)), __VA_ARGS__)

/* ---- the kinds of light ---- */

static void sunny(const float direction[3], float radiance[3], void *user) {
    const float to_sun[3] = { 0.6f, 0.64f, 0.48f }, sky[3] = { 0.22f, 0.36f, 0.65f };
    const float towards = to_sun[0] * direction[0] + to_sun[1] * direction[1] + to_sun[2] * direction[2];
    int i;
    (void)user;
    for (i = 0; i < 3; i++)
        radiance[i] = towards > 0.9998f ? 2200 - 300 * (float)i : sky[i] *
            (direction[1] > 0 ? 1 - 0.6f * direction[1] : 0.2f);
}

static const struct kind {
    const char *name;
    int lamps, material;  /* number of emitting quads, and their material */
    void (*sky)(const float direction[3], float radiance[3], void *user);
    sbl_light light;
} kinds[] = {
    { .name = "quad", .lamps = 1, .material = LAMP },
    { .name = "textured", .lamps = 1, .material = GLASS },
    { .name = "thousand_lamps", .lamps = 1000 },
    { .name = "sphere", .light = { SBL_LIGHT_POINT, .intensity = { 22, 20, 16 }, .position = { -1, 3, 1.2f },
        .radius = 0.35f } },
    { .name = "point", .light = { SBL_LIGHT_POINT, .intensity = { 22, 20, 16 }, .position = { -1, 3, 1.2f } } },
    { .name = "spot", .light = { SBL_LIGHT_SPOT, .intensity = { 40, 37, 30 }, .position = { -1.6f, 3.2f, 2 },
        .direction = { 1.7f, -3, -2 },
                                 .cone = 50, .inner_cone = 40 } },
    { .name = "sun", .light = { SBL_LIGHT_DIRECTIONAL, .intensity = { 3.2f, 3, 2.6f }, .direction = { 0.6f, -1, -0.5f },
        .angle = 0.53f } },
    { .name = "sky", .sky = sunny }
};

static void furnish(world *w, const struct kind *k) {
    int i;
    w->count = 0;
    ADD(w, quad, 0, 0, 0, 12, 1, 12, WHITE);
    ADD(w, box, -1.1f, 0, -0.6f, 0.8f, 1.5f, 0.8f, WHITE);
    ADD(w, box, -0.2f, 0, 0.9f, 0.6f, 0.35f, 0.6f, BLUE);
    ADD(w, ball, 0.4f, 0.5f, 0, 1, 1, 1, RED);
    ADD(w, box, 1.6f, 0, 0, 0.01f, 1.1f, 2.2f, WHITE);  /* a wall of thickness 0.01 */
    if (k->lamps == 1) ADD(w, quad, -1, 3, 1.2f, 1, 1, 1, k->material);
    for (i = 0; i < k->lamps && k->lamps > 1; i++)  /* small lamps along a spiral */
        ADD(w, quad, (float)(0.05 * sqrt(i) * cos(2.4 * i)), 1.9f, (float)(0.05 * sqrt(i) * sin(2.4 * i)), 0.014f, 1,
            0.014f, i % 5 ? WARM : COLD);
}

/* ---- pictures ---- */

static unsigned char pixels[(HEIGHT + INSET) * WIDTH * 3];
static int shrink = 1;  /* by how much pictures are smaller than WIDTH x HEIGHT */

static int render(sbl_context *context, const sbl_picture_desc *view, const char *name) {
    static float picture[WIDTH * HEIGHT * 3];
    const size_t count = (size_t)(view->width * view->height * 3);
    sbl_stats stats;
    if (sbl_render_picture(context, view) != SBL_SUCCESS) return 0;
    if (sbl_read_channel(context, SBL_CHANNEL_FINAL, picture, count) != SBL_SUCCESS) return 0;
    sbl_encode_srgb8(pixels, picture, count, 1);
    stats = sbl_query_stats(context);
    printf("%-16s %6.0f sensors %7.2f s\n", name, (double)stats.sensors.sites, stats.seconds.total);
    return 1;
}

static int write_picture(const char *folder, const char *name, int height) {
    char path[1024];
    snprintf(path, sizeof path, "%s/%s.png", folder, name);
    if (stbi_write_png(path, WIDTH / shrink, height / shrink, 3, pixels, 0)) return 1;
    return fprintf(stderr, "lights: cannot write %s\n", path), 0;
}

static int show_kind(sbl_context *context, const struct kind *k, sbl_preset preset, const char *folder) {
    static world w;
    sbl_scene_desc scene = { .meshes = w.meshes, .materials = materials, .material_count = MATERIALS,
        .textures = &window_picture, .texture_count = 1 };
    sbl_picture_desc view = {  /* other fields: default */
        .width = WIDTH / shrink, .height = HEIGHT / shrink, .options.preset = preset };
    furnish(&w, k);
    scene.mesh_count = w.count;
    scene.lights = &k->light;
    scene.light_count = k->light.intensity[0] > 0;
    scene.environment.radiance = k->sky;
    if (shrink > 1) scene.max_bounce_cells = FEW_CELLS;
    scene.environment.picture.width = 1024;
    scene.environment.picture.height = 512;
    if (!k->sky) scene.environment.picture.width = scene.environment.picture.height = 0;
    sbl_look_at(view.world_to_view, 0.6f, 2.6f, 6, 0.2f, 0.6f, 0, 0, 1, 0);
    sbl_perspective(view.view_to_clip, 36, (float)WIDTH / HEIGHT);
    return sbl_set_scene(context, &scene) == SBL_SUCCESS && render(context, &view, k->name) &&
        write_picture(folder, k->name, HEIGHT);
}

/* Draws, below the picture, the rays of the sensor at one pixel (see sensor_disc.h), and a red square around that
   pixel. */
static int draw_inset(sbl_context *context, int number, int px, int py) {
    static float disc[INSET * INSET * 3];
    const int width = WIDTH / shrink, height = HEIGHT / shrink, inset = INSET / shrink;
    sbl_sensor s;
    int x, y;
    if (sbl_inspect_sensor(context, px, py, &s, NULL, NULL, 0) != SBL_SUCCESS) return 0;
    sensor_disc(&s, inset, disc);
    for (y = 0; y < inset; y++)
        sbl_encode_srgb8(pixels + 3 * ((height + y) * width + number * inset), disc + 3 * y * inset,
                         (size_t)(3 * inset), 1);
    for (y = -4; y <= 4; y++)
        for (x = -4; x <= 4; x++)
            if (abs(x) == 4 || abs(y) == 4) {
                unsigned char *to = pixels + 3 * ((py + y) * width + px + x);
                to[0] = 255; to[1] = to[2] = 0;
            }
    return 1;
}

static int show_penumbra(sbl_context *context, sbl_preset preset, const char *folder) {
    static const char *const names[SBL_PRESET_COUNT] = { "penumbra_default", "penumbra_draft", "penumbra_high" };
    static world w;
    sbl_scene_desc scene = { .meshes = w.meshes,
                             .materials = materials,
                             .material_count = MATERIALS,
                             .textures = &window_picture,
                             .texture_count = 1 };
    sbl_picture_desc view = { .width = WIDTH / shrink, .height = HEIGHT / shrink, .options.preset = preset,
        .samples = 4 };
    int i;
    view.options.rays = preset == SBL_PRESET_DRAFT ? 64 : preset == SBL_PRESET_HIGH ? 1024 : 256;  /* rays per sensor */
    w.count = 0;
    ADD(&w, quad, 0, 0, 0, 12, 1, 12, WHITE);
    ADD(&w, box, -0.8f, 0.9f, -0.2f, 1.6f, 0.06f, 1.4f, BLUE);  /* a table */
    ADD(&w, box, -0.8f, 0, -0.2f, 0.1f, 0.9f, 0.1f, BLUE);
    ADD(&w, quad, 0, 3, -0.2f, 1.2f, 1, 1.2f, LAMP);
    scene.mesh_count = w.count;
    if (shrink > 1) scene.max_bounce_cells = FEW_CELLS;
    sbl_look_at(view.world_to_view, 0.4f, 1.9f, 4.4f, 0.1f, 0.4f, 0, 0, 1, 0);
    sbl_perspective(view.view_to_clip, 40, (float)WIDTH / HEIGHT);
    if (sbl_set_scene(context, &scene) != SBL_SUCCESS || !render(context, &view, names[preset])) return 0;
    for (i = 0; i < INSETS; i++)
        if (!draw_inset(context, i, (125 + 25 * i) / shrink, 140 / shrink)) return 0;
    return write_picture(folder, names[preset], HEIGHT + INSET);
}

int main(int argc, char **argv) {
    const char *folder = argc > 1 ? argv[1] : ".";
    const sbl_preset preset = argc > 2 ? SBL_PRESET_DRAFT : SBL_PRESET_DEFAULT;
    sbl_context *context;
    size_t i;
    int ok = 1;
    if (argc > 2) shrink = 8;
    if (sbl_create(headless("lights"), &context) != SBL_SUCCESS) return 1;  /* sbl.h prints error messages to stderr */
    make_ball();
    for (i = 0; i < sizeof kinds / sizeof *kinds && ok; i++) ok = show_kind(context, &kinds[i], preset, folder);
    ok = ok && show_penumbra(context, SBL_PRESET_DRAFT, folder) && show_penumbra(context, SBL_PRESET_DEFAULT, folder) &&
         show_penumbra(context, SBL_PRESET_HIGH, folder);
    sbl_destroy(context);
    return !ok;
}
