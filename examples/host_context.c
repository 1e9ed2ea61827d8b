/* Demonstrates sbl.h in the frame loop of a program that has its own GL context and does its own drawing.

   Each frame draws a shape and then gives sbl.h a slice of time. The unfinished picture is drawn next to the shape,
   directly from its texture; it becomes sharper with each level. A bar over it shows the progress. The program sets its
   own GL state only once, because sbl.h restores all state that it changes. The last frame is written to
   host_context.png; the first argument is the folder for it. With a second argument, the picture is a quarter as wide
   and high, is drawn larger, and has few cells for bounced light. */
#define SBL_IMPLEMENTATION
#include "../sbl.h"
#include "cornell_box.h"
#include "host_gl.h"
#define STB_IMAGE_WRITE_IMPLEMENTATION
#include <stb/stb_image_write.h>

enum { WIDTH = 480, HEIGHT = 320, SHAPE = 160, PICTURE = 320 };
static const double slice = 0.02;  /* seconds per frame that sbl.h may use */

/* ---- the program's own drawing ---- */

static const char shape_vertex[] =
    "uniform float angle;\n"
    "out vec3 tint;\n"
    "void main() {\n"
    "    float a = angle + 2.1 * float(gl_VertexID);\n"
    "    tint = 0.6 + 0.4 * cos(vec3(0, 2, 4) + 2.1 * float(gl_VertexID));\n"
    "    gl_Position = vec4(cos(a), sin(a), 0.0, 1.0);\n"
    "}\n";
static const char shape_fragment[] =
    "in vec3 tint;\n"
    "out vec4 color;\n"
    "void main() { color = vec4(tint, 1.0); }\n";

static const char picture_vertex[] =
    "out vec2 at;\n"
    "void main() {\n"
    "    at = vec2(gl_VertexID & 1, gl_VertexID >> 1) * 2.0;\n"
    "    gl_Position = vec4(at * 2.0 - 1.0, 0.0, 1.0);\n"
    "}\n";
static const char picture_fragment[] =  /* row 0 of the texture is the top of the picture; values are linear */
    "uniform sampler2D picture;\n"
    "in vec2 at;\n"
    "out vec4 color;\n"
    "void main() {\n"
    "    vec3 c = clamp(texture(picture, vec2(at.x, 1.0 - at.y)).rgb, 0.0, 1.0);\n"
    "    color = vec4(mix(12.92 * c, 1.055 * pow(c, vec3(1.0 / 2.4)) - 0.055, greaterThan(c, vec3(0.0031308))), 1);\n"
    "}\n";

static struct host {
    GLuint framebuffer, color, array, shape_program, picture_program;
} host;

static int host_start(void) {
    host.shape_program = host_gl_program("host_context", "", shape_vertex, shape_fragment);
    host.picture_program = host_gl_program("host_context", "", picture_vertex, picture_fragment);
    if (!host.shape_program || !host.picture_program) return 0;
    gl.GenTextures(1, &host.color);
    gl.BindTexture(GL_TEXTURE_2D, host.color);
    gl.TexImage2D(GL_TEXTURE_2D, 0, GL_RGBA8, WIDTH, HEIGHT, 0, GL_RGBA, GL_UNSIGNED_BYTE, NULL);
    gl.GenFramebuffers(1, &host.framebuffer);
    gl.BindFramebuffer(GL_FRAMEBUFFER, host.framebuffer);
    gl.FramebufferTexture2D(GL_FRAMEBUFFER, GL_COLOR_ATTACHMENT0, GL_TEXTURE_2D, host.color, 0);
    if (gl.CheckFramebufferStatus(GL_FRAMEBUFFER) != GL_FRAMEBUFFER_COMPLETE)
        return fprintf(stderr, "host_context: the driver cannot draw to an 8-bit texture\n"), 0;
    gl.GenVertexArrays(1, &host.array);
    gl.BindVertexArray(host.array);
    gl.ClearColor(0.1f, 0.12f, 0.15f, 1);
    return 1;
}

static void host_stop(void) {
    gl.DeleteProgram(host.shape_program);
    gl.DeleteProgram(host.picture_program);
    gl.DeleteVertexArrays(1, &host.array);
    gl.DeleteTextures(1, &host.color);
    gl.DeleteFramebuffers(1, &host.framebuffer);
}

static void shape_draw(float angle) {
    gl.Clear(GL_COLOR_BUFFER_BIT);
    gl.Viewport(0, SHAPE / 2, SHAPE, SHAPE);
    gl.UseProgram(host.shape_program);
    gl.Uniform1f(host_gl_uniform(host.shape_program, "angle"), angle);
    gl.DrawArrays(GL_TRIANGLES, 0, 3);
}

static void picture_draw(GLuint texture) {
    gl.Viewport(SHAPE, 0, PICTURE, PICTURE);
    gl.UseProgram(host.picture_program);
    gl.BindTexture(GL_TEXTURE_2D, texture);
    gl.DrawArrays(GL_TRIANGLES, 0, 3);
}

static void bar_draw(float done) {
    static const float yellow[4] = { 0.9f, 0.7f, 0.3f, 1 };
    gl.Enable(GL_SCISSOR_TEST);
    gl.Scissor(SHAPE + 20, 12, 1 + (int)((float)(PICTURE - 40) * done), 8);
    gl.ClearBufferfv(GL_COLOR, 0, yellow);
    gl.Disable(GL_SCISSOR_TEST);
}

/* ---- sbl.h ---- */

static sbl_gl_function gl_function(const char *name, void *user) {
    (void)user;
    return host_gl_function(name);
}

static int run(sbl_context *context, int size) {
    sbl_picture_desc view = { 0 };
    cornell_box box;
    sbl_scene_desc scene = *cornell_box_make(&box);
    int frame, seen = 0;
    sbl_result result = SBL_UNFINISHED;
    cornell_box_view(&view, size, size);
    view.options.preset = SBL_PRESET_DRAFT;
    view.samples = 4;
    if (size < PICTURE) scene.max_bounce_cells = 2048;
    if (sbl_set_scene(context, &scene) != SBL_SUCCESS) return 0;
    if (sbl_begin_picture(context, &view) != SBL_SUCCESS) return 0;
    for (frame = 0; result == SBL_UNFINISHED; frame++) {
        GLuint texture;
        shape_draw(0.05f * (float)frame);
        result = sbl_step(context, slice);
        texture = sbl_channel_texture(context, SBL_CHANNEL_FINAL);  /* unfinished picture; 0: none yet */
        if (texture) picture_draw(texture);
        if (result == SBL_UNFINISHED) bar_draw(sbl_progress(context));
        seen += texture && result == SBL_UNFINISHED;
    }
    printf("host_context: done after %d frames; %d of them showed the unfinished picture\n", frame, seen);
    return result == SBL_SUCCESS;
}

int main(int argc, char **argv) {
    static unsigned char pixels[WIDTH * HEIGHT * 3];
    sbl_context_desc desc = { 0 };
    sbl_context *context = NULL;
    char path[1024];
    int ok = 0;
    if (!host_gl_open("host_context")) return 1;
    desc.get_gl_function = gl_function;
    if (host_start() && sbl_create(&desc, &context) == SBL_SUCCESS)
        ok = run(context, argc > 2 ? PICTURE / 4 : PICTURE);  /* sbl.h prints error messages to stderr */
    gl.ReadPixels(0, 0, WIDTH, HEIGHT, GL_RGB, GL_UNSIGNED_BYTE, pixels);
    sbl_destroy(context);
    host_stop();
    host_gl_close();
    if (!ok) return 1;
    snprintf(path, sizeof path, "%s/host_context.png", argc > 1 ? argv[1] : ".");
    stbi_flip_vertically_on_write(1);  /* GL reads the lowest row first */
    if (stbi_write_png(path, WIDTH, HEIGHT, 3, pixels, 0)) return 0;
    return fprintf(stderr, "host_context: cannot write %s\n", path), 1;
}
