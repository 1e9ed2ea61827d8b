/* Demonstrates the shortest useful program. It renders a few triangles and a lamp to minimal.png. The first argument is
   the folder for the picture. */
#define SBL_IMPLEMENTATION
#include "headless.h"  /* includes sbl.h and creates a GL context without a window */
#define STB_IMAGE_WRITE_IMPLEMENTATION
#include <stb/stb_image_write.h>

enum { WIDTH = 480, HEIGHT = 360 };

static const float room[] = {      /* triangles of the floor and the back wall */
    -5, 0, 4,   5, 0, 4,   5, 0, -2,      -5, 0, 4,   5, 0, -2,   -5, 0, -2,
    -5, 0, -2,  5, 0, -2,  5, 3, -2,      -5, 0, -2,  5, 3, -2,   -5, 3, -2 };
static const float pyramid[] = {
    0.4f, 0, 1,   1.3f, 0, -0.3f,   0.1f, 1.2f, 0,    1.3f, 0, -0.3f,  -0.8f, 0, -0.9f,  0.1f, 1.2f, 0,
    -0.8f, 0, -0.9f,  -1.1f, 0, 0.5f,  0.1f, 1.2f, 0,    -1.1f, 0, 0.5f,   0.4f, 0, 1,   0.1f, 1.2f, 0 };
static const float lamp[] = {
    -2.2f, 3, -0.5f,   -2.2f, 3, 1,   -0.7f, 3, 1,     -2.2f, 3, -0.5f,   -0.7f, 3, 1,   -0.7f, 3, -0.5f };

int main(int argc, char **argv) {
    static float picture[WIDTH * HEIGHT * 3];
    static unsigned char pixels[WIDTH * HEIGHT * 3];
    const sbl_material materials[3] = {
        { .albedo = { 0.7f, 0.7f, 0.7f } }, { .albedo = { 0.8f, 0.3f, 0.1f } }, { .emission = { 13, 11, 8 } } };
    const sbl_mesh meshes[3] = {
        { .positions = { .data = room }, .vertex_count = 12, .material = 0 },
        { .positions = { .data = pyramid }, .vertex_count = 12, .material = 1 },
        { .positions = { .data = lamp }, .vertex_count = 6, .material = 2 } };
    const sbl_scene_desc scene = {
        .meshes = meshes, .mesh_count = 3, .materials = materials, .material_count = 3, .sky = { 0.04f, 0.06f, 0.1f } };
    sbl_picture_desc view = { .width = WIDTH, .height = HEIGHT };  /* all other fields keep their defaults */
    sbl_context *context;
    char path[1024];
    int ok;
    sbl_look_at(view.world_to_view, 0.5f, 1.5f, 6, 0, 0.9f, 0, 0, 1, 0);
    sbl_perspective(view.view_to_clip, 40, (float)WIDTH / HEIGHT);
    if (sbl_create(headless("minimal"), &context) != SBL_SUCCESS) return 1;  /* sbl.h prints error messages to stderr */
    ok = sbl_set_scene(context, &scene) == SBL_SUCCESS && sbl_render_picture(context, &view) == SBL_SUCCESS &&
         sbl_read_channel(context, SBL_CHANNEL_FINAL, picture, WIDTH * HEIGHT * 3) == SBL_SUCCESS;
    sbl_destroy(context);
    if (!ok) return 1;
    sbl_encode_srgb8(pixels, picture, WIDTH * HEIGHT * 3, 1);
    snprintf(path, sizeof path, "%s/minimal.png", argc > 1 ? argv[1] : ".");
    if (stbi_write_png(path, WIDTH, HEIGHT, 3, pixels, 0)) return 0;
    return fprintf(stderr, "minimal: cannot write %s\n", path), 1;
}
