/* Demonstrates materials that reflect or transmit light: a room with a large mirror, a glass table, a polished floor,
   and balls of metal and plastic with different roughness. The first argument is the folder for the picture. With a
   second argument, the picture is a small draft. */
#define SBL_IMPLEMENTATION
#include "headless.h"
#define STB_IMAGE_WRITE_IMPLEMENTATION
#include <stb/stb_image_write.h>
#include <math.h>

enum { WIDTH = 360, HEIGHT = 240, SLICES = 32, BALLS = 5 };

/* ---- materials ---- */

enum { PLASTER, BLUE_PLASTER, FLOOR, LAMP, MIRROR, STEEL, GLASS, FIRST_BALL, MATERIALS = FIRST_BALL + BALLS };
static const sbl_material materials[MATERIALS] = {
    [PLASTER] = { .albedo = { 0.72f, 0.7f, 0.66f } },  /* a material without ior and metallic is matte */
    [BLUE_PLASTER] = { .albedo = { 0.2f, 0.32f, 0.5f } },
    [FLOOR] = { .albedo = { 0.35f, 0.2f, 0.1f }, .ior = 1.5f, .roughness = 0.25f },
    [LAMP] = { .emission = { 14, 12.5f, 10 } },
    [MIRROR] = { .albedo = { 0.92f, 0.93f, 0.92f }, .metallic = 1 },  /* roughness is 0 */
    [STEEL] = { .albedo = { 0.56f, 0.57f, 0.58f }, .metallic = 1, .roughness = 0.35f },
    [GLASS] = { .albedo = { 0.86f, 0.96f, 0.9f }, .ior = 1.5f, .transmission = 1 },
    { .albedo = { 1, 0.77f, 0.34f }, .metallic = 1, .roughness = 0.1f },  /* gold */
    { .albedo = { 0.95f, 0.64f, 0.54f }, .metallic = 1, .roughness = 0.3f },  /* copper */
    { .albedo = { 0.91f, 0.92f, 0.92f }, .metallic = 1, .roughness = 0.5f },  /* aluminium */
    { .albedo = { 0.7f, 0.06f, 0.05f }, .ior = 1.5f },  /* smooth plastic */
    { .albedo = { 0.06f, 0.35f, 0.12f }, .ior = 1.5f, .roughness = 0.4f } };

/* ---- shapes ---- */

#define SIDE(ax, ay, az, bx, by, bz, cx, cy, cz, dx, dy, dz) \
    ax, ay, az, bx, by, bz, cx, cy, cz, ax, ay, az, cx, cy, cz, dx, dy, dz
static const float box[] = {
    SIDE(0, 1, 0, 0, 1, 1, 1, 1, 1, 1, 1, 0), SIDE(0, 0, 0, 1, 0, 0, 1, 0, 1, 0, 0, 1),
    SIDE(0, 0, 1, 1, 0, 1, 1, 1, 1, 0, 1, 1), SIDE(1, 0, 0, 0, 0, 0, 0, 1, 0, 1, 1, 0),
    SIDE(1, 0, 1, 1, 0, 0, 1, 1, 0, 1, 1, 1), SIDE(0, 0, 0, 0, 0, 1, 0, 1, 1, 0, 1, 0) };
static const float plate[] = { SIDE(0, 0, 0, 0, 0, 1, 1, 0, 1, 1, 0, 0) };  /* a pane is a single surface */
static float ball[4 * SLICES * (SLICES - 1) * 9];  /* positions, which also serve as normals */

static void make_ball(void) {
    static const int corner[6][2] = { { 0, 0 }, { 1, 0 }, { 1, 1 }, { 0, 0 }, { 1, 1 }, { 0, 1 } };
    const double pi = 4 * atan(1.0);
    float *to = ball;
    int i, j, k;
    for (i = 0; i < SLICES; i++)
        for (j = 0; j < 2 * SLICES; j++)
            for (k = i < SLICES - 1 ? 0 : 3; k < (i ? 6 : 3); k++) {  /* one triangle at a pole, otherwise two */
                const double polar = pi * (i + corner[k][0]) / SLICES, turn = pi * (j + corner[k][1]) / SLICES;
                *to++ = (float)(sin(polar) * sin(turn));
                *to++ = (float)cos(polar);
                *to++ = (float)(sin(polar) * cos(turn));
            }
}

static sbl_mesh meshes[64];
static int mesh_count;

/* Adds a shape of the given size. x, y, z: its lowest corner, or the middle of a ball */
static void add(const float *shape, size_t bytes, int material, float x, float y, float z, float width, float height,
                float depth) {
    const sbl_mesh mesh = {
        .positions = { .data = shape }, .normals = { .data = shape == ball ? ball : NULL },
        .vertex_count = (int)(bytes / (3 * sizeof *shape)), .material = material,
        .transform = { width, 0, 0, 0,  0, height, 0, 0,  0, 0, depth, 0,  x, y, z, 1 } };
    meshes[mesh_count++] = mesh;
}
#define ADD(shape, ...) add(shape, sizeof shape, __VA_ARGS__)

static void furnish(void) {
    int i;
    ADD(plate, FLOOR, -3, 0, -3, 6, 1, 6);
    ADD(plate, PLASTER, -3, 2.8f, -3, 6, 1, 6);
    ADD(box, PLASTER, -3, 0, -3.1f, 6, 2.8f, 0.1f);
    ADD(box, BLUE_PLASTER, -3.1f, 0, -3, 0.1f, 2.8f, 6);
    ADD(box, PLASTER, 3, 0, -3, 0.1f, 2.8f, 6);
    ADD(box, PLASTER, -3, 0, 3, 6, 2.8f, 0.1f);
    ADD(box, LAMP, -0.6f, 2.7f, -0.4f, 1.2f, 0.05f, 1.2f);
    ADD(box, MIRROR, -2.2f, 0.5f, -2.98f, 2.6f, 1.9f, 0.02f);
    ADD(plate, GLASS, -0.3f, 0.8f, -1.6f, 2, 1, 1.3f);  /* the table */
    for (i = 0; i < 4; i++)
        ADD(box, STEEL, i & 1 ? 1.6f : -0.25f, 0, i & 2 ? -0.4f : -1.55f, 0.05f, 0.79f, 0.05f);
    for (i = 0; i < 2; i++) ADD(ball, FIRST_BALL + i, 0.3f + 0.7f * (float)i, 1.01f, -1, 0.2f, 0.2f, 0.2f);
    for (i = 2; i < BALLS; i++) ADD(ball, FIRST_BALL + i, 0.9f * (float)i - 3.4f, 0.3f, 0.1f, 0.3f, 0.3f, 0.3f);
}

int main(int argc, char **argv) {
    static float picture[WIDTH * HEIGHT * 3];
    static unsigned char pixels[WIDTH * HEIGHT * 3];
    sbl_scene_desc scene = { .meshes = meshes, .materials = materials, .material_count = MATERIALS };
    const int width = argc > 2 ? WIDTH / 3 : WIDTH, height = argc > 2 ? HEIGHT / 3 : HEIGHT;
    const size_t count = (size_t)(3 * width * height);
    sbl_picture_desc view = { .width = width, .height = height, .tone = SBL_TONE_NEUTRAL, .auto_exposure = 1 };
    sbl_context *context;
    sbl_stats stats;
    char path[1024];
    int ok;
    if (argc > 2) {
        view.options.preset = SBL_PRESET_DRAFT;
        scene.max_bounce_cells = 2048;
    }
    if (sbl_create(headless("reflections"), &context) != SBL_SUCCESS) return 1;  /* sbl.h prints errors to stderr */
    make_ball();
    furnish();
    scene.mesh_count = mesh_count;
    sbl_look_at(view.world_to_view, 1.5f, 1.7f, 2.8f, -0.1f, 0.8f, -1, 0, 1, 0);
    sbl_perspective(view.view_to_clip, 50, (float)WIDTH / HEIGHT);
    ok = sbl_set_scene(context, &scene) == SBL_SUCCESS && sbl_render_picture(context, &view) == SBL_SUCCESS &&
         sbl_read_channel(context, SBL_CHANNEL_DISPLAY, picture, count) == SBL_SUCCESS;
    stats = sbl_query_stats(context);
    sbl_destroy(context);
    if (!ok) return 1;
    printf("predicted error: light %.2f %%, reflections %.2f %%; %.1f s\n", 100 * (double)stats.picture.radiance_error,
           100 * (double)stats.picture.specular_error, stats.seconds.total);
    sbl_encode_srgb8(pixels, picture, count, 1);
    snprintf(path, sizeof path, "%s/reflections.png", argc > 1 ? argv[1] : ".");
    if (stbi_write_png(path, width, height, 3, pixels, 0)) return 0;
    return fprintf(stderr, "reflections: cannot write %s\n", path), 1;
}
