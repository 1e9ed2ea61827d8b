/* Demonstrates the draw callback with a spiral of slabs, which exists only in the vertex shader of the host. Some slabs
   emit light. A room, given as vertex arrays, is lit together with them: the slabs cast shadows and light into the
   room, and the room lights the slabs.

   See sbl_draw_view in sbl.h for the duties of the shaders of a callback. The picture is written to host_draw.png; the
   first argument is the folder for it. Further arguments: --bare omits the slabs, and --draft halves the width and
   height of the picture. */
#define SBL_IMPLEMENTATION
#include "../sbl.h"
#include "host_gl.h"
#define STB_IMAGE_WRITE_IMPLEMENTATION
#include <stb/stb_image_write.h>
#include <math.h>

enum { WIDTH = 400, HEIGHT = 320, SLABS = 21, SLAB_VERTICES = 36 };
static const float slab_albedo[3] = { 0.1f, 0.5f, 0.45f }, slab_glow[3] = { 2.4f, 0.7f, 0.15f };

/* Computes the corners of the slab with the index gl_InstanceID. gl_VertexID counts the corners of its twelve
   triangles; no vertex array is used. In each group of five slabs, the fourth emits light. */
static const char vertex_shader[] =
    "uniform mat4 world_to_clip;\n"
    "out vec3 position;\n"
    "flat out vec3 normal;\n"
    "flat out float glow;\n"
    "flat out uint id;\n"
    "void main() {\n"
    "    int face = gl_VertexID / 6, axis = face >> 1, corner = gl_VertexID % 6;\n"
    "    float side = (face & 1) == 0 ? 1.0 : -1.0;\n"
    "    int q = corner < 3 ? corner : corner == 3 ? 0 : corner - 2;\n"  // triangles 0 1 2 and 0 2 3
    // counter-clockwise, as seen from outside
    "    vec2 uv = vec2(q == 1 || q == 2 ? 1.0 : -1.0, q >= 2 ? 1.0 : -1.0) * vec2(side, 1.0);\n"
    "    vec3 n = axis == 0 ? vec3(side, 0, 0) : axis == 1 ? vec3(0, side, 0) : vec3(0, 0, side);\n"
    "    vec3 p = axis == 0 ? vec3(side, uv) : axis == 1 ? vec3(uv.y, side, uv.x) : vec3(uv, side);\n"
    "    float t = float(gl_InstanceID), angle = 0.42 * t;\n"
    "    mat3 turn = mat3(cos(angle), 0, -sin(angle), 0, 1, 0, sin(angle), 0, cos(angle));\n"
    "    position = turn * (p * vec3(0.3, 0.035, 0.1) + vec3(0.38, 0.16 + 0.085 * t, 0.0));\n"
    "    normal = turn * n;\n"
    "    glow = gl_InstanceID % 5 == 3 ? 1.0 : 0.0;\n"
    "    id = 1000u + uint(gl_InstanceID);\n"
    "    gl_Position = world_to_clip * vec4(position, 1.0);\n"
    "}\n";

/* The source of four programs: one for sensors and one for the camera, each with and without writing depth. */
static const char fragment_shader[] =
    "uniform vec3 eye, albedo, emission, light[6];\n"  // light is described at sbl_draw_view
    "uniform float radiance_scale, depth_scale;\n"
    "in vec3 position;\n"
    "flat in vec3 normal;\n"
    "flat in float glow;\n"
    "flat in uint id;\n"
    "#ifdef CAMERA\n"
    "layout(location = 0) out vec4 out_position;\n"
    "layout(location = 1) out vec4 out_normal;\n"
    "layout(location = 2) out vec4 out_geometric_normal;\n"
    "layout(location = 3) out vec4 out_albedo;\n"
    "layout(location = 4) out vec4 out_emission;\n"
    "layout(location = 5) out uint out_id;\n"
    "#else\n"
    "layout(location = 0) out vec4 out_radiance;\n"
    "#endif\n"
    "void main() {\n"
    "#ifdef CAMERA\n"
    "    vec3 towards = dot(normal, eye - position) < 0.0 ? -normal : normal;\n"
    "    out_position = vec4(position, 0);\n"
    "    out_normal = vec4(towards, 0);\n"
    "    out_geometric_normal = vec4(towards, 0);\n"
    "    out_albedo = vec4(glow > 0.0 ? vec3(0) : albedo, 1);\n"
    "    out_emission = vec4(glow * emission, 0);\n"
    "    out_id = id;\n"
    "#else\n"
    "    vec3 w = normal * normal;\n"
    "    vec3 r = w.x * light[normal.x < 0.0 ? 1 : 0] + w.y * light[normal.y < 0.0 ? 3 : 2] + w.z * light[normal.z < "
        "0.0 ? 5 : 4];\n"
    "    vec3 radiance = glow > 0.0 ? emission : albedo * r;\n"
    "    out_radiance = vec4(radiance * radiance_scale, gl_FrontFacing ? 1.0 / gl_FragCoord.w : -1.0 / "
        "gl_FragCoord.w);\n"
    "#endif\n"
    "#ifdef WRITE_DEPTH\n"
    "    gl_FragDepth = gl_FragCoord.w * depth_scale;\n"
    "#endif\n"
    "}\n";

typedef struct slabs { GLuint programs[2][2], vertex_array; } slabs;

static int slabs_make(slabs *s) {
    static const char *const defines[2][2] = { { "#define CAMERA\n", "#define CAMERA\n#define WRITE_DEPTH\n" },
        { "", "#define WRITE_DEPTH\n" } };
    int kind, write_depth;
    for (kind = 0; kind < 2; kind++)
        for (write_depth = 0; write_depth < 2; write_depth++) {
            GLuint program = host_gl_program("host_draw", defines[kind][write_depth], vertex_shader, fragment_shader);
            if (!program) return 0;
            s->programs[kind][write_depth] = program;
        }
    gl.GenVertexArrays(1, &s->vertex_array);
    return 1;
}

/* The callback. Before it, sbl.h binds the framebuffer and sets viewport, scissor and depth test. Afterwards, sbl.h
   restores the state that the callback changed. */
static void slabs_draw(const sbl_draw_view *view, void *user) {
    const slabs *s = (const slabs *)user;
    GLuint program = s->programs[view->kind == SBL_VIEW_SENSOR][view->write_depth != 0];
    gl.UseProgram(program);
    gl.UniformMatrix4fv(host_gl_uniform(program, "world_to_clip"), 1, GL_FALSE, view->world_to_clip);
    gl.Uniform3fv(host_gl_uniform(program, "eye"), 1, view->eye);
    gl.Uniform3fv(host_gl_uniform(program, "albedo"), 1, slab_albedo);
    gl.Uniform3fv(host_gl_uniform(program, "emission"), 1, slab_glow);
    gl.Uniform1f(host_gl_uniform(program, "radiance_scale"), view->radiance_scale);
    gl.Uniform3fv(host_gl_uniform(program, "light"), 6, view->light[0]);
    gl.Uniform1f(host_gl_uniform(program, "depth_scale"), view->depth_scale);
    gl.BindVertexArray(s->vertex_array);
    gl.DrawArraysInstanced(GL_TRIANGLES, 0, SLAB_VERTICES, SLABS);
}

static const float room_corners[] = {  /* floor, back wall, left wall and lamp, with four corners each */
    -3, 0, -2,   -3, 0, 3,    3, 0, 3,    3, 0, -2,
    -3, 0, -2,    3, 0, -2,   3, 3, -2,  -3, 3, -2,
    -3, 0, 3,    -3, 0, -2,  -3, 3, -2,  -3, 3, 3,
    -1.2f, 3, 0.2f,   0.3f, 3, 0.2f,   0.3f, 3, 1.7f,   -1.2f, 3, 1.7f };

static int width = WIDTH, height = HEIGHT;

static int render(sbl_context *context, slabs *s, float *picture) {
    static const unsigned short quad[6] = { 0, 1, 2, 0, 2, 3 };
    sbl_material materials[2] = { { .albedo = { 0.7f, 0.7f, 0.7f } }, { .emission = { 7, 7, 7 } } };
    sbl_mesh meshes[4] = { { .vertex_count = 4 } };
    sbl_scene_desc scene = { 0 };
    sbl_picture_desc view = { 0 };
    int i;
    for (i = 0; i < 4; i++) {
        meshes[i].positions.data = room_corners + 12 * i;
        meshes[i].vertex_count = 4;
        meshes[i].indices.data = quad;
        meshes[i].indices.type = SBL_UINT16;
        meshes[i].index_count = 6;
        meshes[i].material = i == 3;
    }
    scene.meshes = meshes;
    scene.mesh_count = 4;
    scene.materials = materials;
    scene.material_count = 2;
    for (i = 0; i < 3; i++) scene.sky[i] = 0.1f;
    if (s) {
        scene.draw = slabs_draw;
        scene.draw_user = s;
        scene.draw_bounds[0][0] = scene.draw_bounds[0][2] = -0.75f;
        scene.draw_bounds[1][0] = scene.draw_bounds[1][2] = 0.75f;
        scene.draw_bounds[0][1] = 0.1f;
        scene.draw_bounds[1][1] = 0.2f + 0.085f * SLABS;
        scene.draw_max_radiance = slab_glow[0];
    }
    view.width = width;
    view.height = height;
    view.options.preset = SBL_PRESET_DRAFT;  /* cheap: the callback runs five times per sensor */
    view.samples = 4;
    sbl_look_at(view.world_to_view, 0.6f, 1.7f, 5.2f, 0, 1, 0, 0, 1, 0);
    sbl_perspective(view.view_to_clip, 34, (float)WIDTH / HEIGHT);
    return sbl_set_scene(context, &scene) == SBL_SUCCESS && sbl_render_picture(context, &view) == SBL_SUCCESS &&
           sbl_read_channel(context, SBL_CHANNEL_FINAL, picture, (size_t)(width * height * 3)) == SBL_SUCCESS;
}

static sbl_gl_function gl_function(const char *name, void *user) {
    (void)user;
    return host_gl_function(name);
}

int main(int argc, char **argv) {
    static float picture[WIDTH * HEIGHT * 3];
    static unsigned char pixels[WIDTH * HEIGHT * 3];
    int bare = 0, draft = 0, ok = 0, i, k;
    slabs s = { { { 0, 0 }, { 0, 0 } }, 0 };
    sbl_context_desc desc = { 0 };
    sbl_context *context = NULL;
    char path[1024];
    for (i = 2; i < argc; i++) {
        bare |= strcmp(argv[i], "--bare") == 0;
        draft |= strcmp(argv[i], "--draft") == 0;
    }
    width >>= draft;
    height >>= draft;
    if (!host_gl_open("host_draw")) return 1;
    desc.get_gl_function = gl_function;
    if (slabs_make(&s) && sbl_create(&desc, &context) == SBL_SUCCESS) {  /* sbl.h prints error messages to stderr */
        ok = render(context, bare ? NULL : &s, picture);
        printf("host_draw: %lld sensors, %.0f us each\n", (long long)sbl_query_stats(context).sensors.sites,
               sbl_query_stats(context).sensors.microseconds);
    }
    sbl_destroy(context);
    for (i = 0; i < 2; i++)
        for (k = 0; k < 2; k++) gl.DeleteProgram(s.programs[i][k]);
    gl.DeleteVertexArrays(1, &s.vertex_array);
    host_gl_close();
    if (!ok) return 1;
    sbl_encode_srgb8(pixels, picture, (size_t)(width * height * 3), 1);
    snprintf(path, sizeof path, "%s/host_draw.png", argc > 1 ? argv[1] : ".");
    if (stbi_write_png(path, width, height, 3, pixels, 0)) return 0;
    return fprintf(stderr, "host_draw: cannot write %s\n", path), 1;
}
