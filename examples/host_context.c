/* Demonstrates calling sbl.h in the middle of a frame of a program that has a GL context, state and drawing of its own.

   Each frame draws a shape, gives sbl.h its slice of time, and clears and draws the shape again without setting
   anything: both must be the same, pixel for pixel, and what GL says of the state must not change. Beside the shape its
   picture appears, straight from its texture: from the first level on, each level sharper; over it a bar shows how far
   it is. The last frame goes to host_context.png; the first argument is the folder for it. */
#define SBL_IMPLEMENTATION
#include "../sbl.h"
#include "cornell_box.h"
#include "host_gl.h"
#define STB_IMAGE_WRITE_IMPLEMENTATION
#include <stb/stb_image_write.h>
#include <stdlib.h>

enum { WIDTH = 480, HEIGHT = 320, SHAPE = 160, PICTURE = 320, FRAMES_AFTER = 8, FRAMES_MOST = 100000 };
static const double slice = 0.02;  /* seconds of each frame that sbl.h may have */

/* ---- the program's own drawing */

static const char shape_vertex[] =
    "layout(location = 0) in vec2 corner;\n"
    "layout(location = 1) in vec3 color;\n"
    "uniform float angle;\n"
    "out vec3 tint;\n"
    "void main() {\n"
    "    float c = cos(angle), s = sin(angle);\n"
    "    tint = color;\n"
    "    gl_Position = vec4(mat2(c, s, -s, c) * corner, 0.0, 1.0);\n"
    "}\n";
static const char shape_fragment[] =
    "uniform sampler2D pattern;\n"
    "in vec3 tint;\n"
    "out vec4 color;\n"
    "void main() { color = vec4(tint * texture(pattern, gl_FragCoord.xy / 32.0).rgb, 0.75); }\n";

static const char picture_vertex[] =
    "out vec2 at;\n"
    "void main() {\n"
    "    at = vec2(gl_VertexID & 1, gl_VertexID >> 1) * 2.0;\n"
    "    gl_Position = vec4(at * 2.0 - 1.0, 0.0, 1.0);\n"
    "}\n";
static const char picture_fragment[] =  /* the texture's first row is the picture's top; its values are linear */
    "uniform sampler2D picture;\n"
    "in vec2 at;\n"
    "out vec4 color;\n"
    "void main() {\n"
    "    vec3 c = clamp(texture(picture, vec2(at.x, 1.0 - at.y)).rgb, 0.0, 1.0);\n"
    "    color = vec4(mix(12.92 * c, 1.055 * pow(c, vec3(1.0 / 2.4)) - 0.055, greaterThan(c, vec3(0.0031308))), 1);\n"
    "}\n";

static struct host {
    GLuint framebuffer, color, depth;
    GLuint shape_program, shape_array, shape_buffer, pattern, sampler;
    GLuint picture_program, picture_array;
    GLint angle;
} host;

static GLuint texture_make(GLint internal, GLsizei width, GLsizei height, GLenum format, GLenum type, const void *pixels) {
    GLuint id = 0;
    gl.GenTextures(1, &id);
    gl.BindTexture(GL_TEXTURE_2D, id);
    gl.TexImage2D(GL_TEXTURE_2D, 0, internal, width, height, 0, format, type, pixels);
    gl.TexParameteri(GL_TEXTURE_2D, GL_TEXTURE_MIN_FILTER, GL_NEAREST);
    gl.TexParameteri(GL_TEXTURE_2D, GL_TEXTURE_MAG_FILTER, GL_NEAREST);
    return id;
}

static int host_start(void) {
    static const float corners[3][5] = { { -0.8f, -0.7f, 1, 0.3f, 0.2f }, { 0.9f, -0.5f, 0.2f, 1, 0.3f }, { 0.1f, 0.9f, 0.3f, 0.4f, 1 } };
    static const unsigned char checks[2][4][3] = { { { 255, 255, 255 }, { 160, 160, 160 } }, { { 160, 160, 160 }, { 255, 255, 255 } } };
    host.shape_program = host_gl_program("host_context", "", shape_vertex, shape_fragment);
    host.picture_program = host_gl_program("host_context", "", picture_vertex, picture_fragment);
    if (!host.shape_program || !host.picture_program) return 0;
    host.angle = host_gl_uniform(host.shape_program, "angle");
    host.color = texture_make(GL_RGBA8, WIDTH, HEIGHT, GL_RGBA, GL_UNSIGNED_BYTE, NULL);
    host.depth = texture_make(GL_DEPTH24_STENCIL8, WIDTH, HEIGHT, GL_DEPTH_STENCIL, GL_UNSIGNED_INT_24_8, NULL);
    gl.GenFramebuffers(1, &host.framebuffer);
    gl.BindFramebuffer(GL_FRAMEBUFFER, host.framebuffer);
    gl.FramebufferTexture2D(GL_FRAMEBUFFER, GL_COLOR_ATTACHMENT0, GL_TEXTURE_2D, host.color, 0);
    gl.FramebufferTexture2D(GL_FRAMEBUFFER, GL_DEPTH_STENCIL_ATTACHMENT, GL_TEXTURE_2D, host.depth, 0);
    if (gl.CheckFramebufferStatus(GL_FRAMEBUFFER) != GL_FRAMEBUFFER_COMPLETE) {
        fprintf(stderr, "host_context: the driver cannot draw to an 8-bit texture with depth and stencil\n");
        return 0;
    }
    gl.PixelStorei(GL_UNPACK_ROW_LENGTH, 4);  /* rows of four texels, of which two are used */
    gl.PixelStorei(GL_UNPACK_ALIGNMENT, 1);
    host.pattern = texture_make(GL_RGB8, 2, 2, GL_RGB, GL_UNSIGNED_BYTE, checks);
    gl.GenSamplers(1, &host.sampler);
    gl.SamplerParameteri(host.sampler, GL_TEXTURE_MIN_FILTER, GL_NEAREST);
    gl.SamplerParameteri(host.sampler, GL_TEXTURE_MAG_FILTER, GL_NEAREST);
    gl.GenVertexArrays(1, &host.picture_array);
    gl.GenVertexArrays(1, &host.shape_array);
    gl.BindVertexArray(host.shape_array);
    gl.GenBuffers(1, &host.shape_buffer);
    gl.BindBuffer(GL_ARRAY_BUFFER, host.shape_buffer);
    gl.BufferData(GL_ARRAY_BUFFER, (GLsizeiptr)sizeof corners, corners, GL_STATIC_DRAW);
    gl.VertexAttribPointer(0, 2, GL_FLOAT, GL_FALSE, (GLsizei)sizeof corners[0], NULL);
    gl.VertexAttribPointer(1, 3, GL_FLOAT, GL_FALSE, (GLsizei)sizeof corners[0], (const void *)(2 * sizeof(float)));
    gl.EnableVertexAttribArray(0);
    gl.EnableVertexAttribArray(1);
    return 1;
}

static void host_stop(void) {
    gl.DeleteProgram(host.shape_program);
    gl.DeleteProgram(host.picture_program);
    gl.DeleteVertexArrays(1, &host.shape_array);
    gl.DeleteVertexArrays(1, &host.picture_array);
    gl.DeleteBuffers(1, &host.shape_buffer);
    gl.DeleteSamplers(1, &host.sampler);
    gl.DeleteTextures(1, &host.pattern);
    gl.DeleteTextures(1, &host.color);
    gl.DeleteTextures(1, &host.depth);
    gl.DeleteFramebuffers(1, &host.framebuffer);
}

/* All that a frame sets, once at its start; nearly every value differs from GL's default. */
static void host_state(float angle) {
    gl.BindFramebuffer(GL_FRAMEBUFFER, host.framebuffer);
    gl.Disable(GL_SCISSOR_TEST);
    gl.ColorMask(GL_TRUE, GL_TRUE, GL_TRUE, GL_TRUE);
    gl.DepthMask(GL_TRUE);
    gl.StencilMask(0xff);
    gl.ClearColor(0.1f, 0.12f, 0.15f, 1);
    gl.ClearDepth(0.5);
    gl.ClearStencil(2);
    gl.Clear(GL_COLOR_BUFFER_BIT | GL_DEPTH_BUFFER_BIT | GL_STENCIL_BUFFER_BIT);
    gl.ColorMask(GL_TRUE, GL_TRUE, GL_TRUE, GL_FALSE);
    gl.DepthMask(GL_FALSE);
    gl.DepthRange(0.25, 0.75);
    gl.DepthFunc(GL_LEQUAL);
    gl.Enable(GL_DEPTH_TEST);
    gl.StencilFunc(GL_EQUAL, 2, 0x0f);
    gl.StencilOp(GL_KEEP, GL_KEEP, GL_KEEP);
    gl.StencilMask(0x0f);
    gl.Enable(GL_STENCIL_TEST);
    gl.BlendFunc(GL_SRC_ALPHA, GL_ONE_MINUS_SRC_ALPHA);
    gl.Enable(GL_BLEND);
    gl.FrontFace(GL_CW);
    gl.CullFace(GL_FRONT);
    gl.Enable(GL_CULL_FACE);
    gl.Enable(GL_POLYGON_OFFSET_FILL);
    gl.PolygonOffset(-1, -1);
    gl.Viewport(0, SHAPE / 2, SHAPE, SHAPE);
    gl.Scissor(4, SHAPE / 2 + 4, SHAPE - 8, SHAPE - 8);
    gl.Enable(GL_SCISSOR_TEST);
    gl.PixelStorei(GL_PACK_ALIGNMENT, 1);
    gl.PixelStorei(GL_UNPACK_ROW_LENGTH, 4);
    gl.PixelStorei(GL_UNPACK_ALIGNMENT, 1);
    gl.ActiveTexture(GL_TEXTURE0 + 1);
    gl.BindTexture(GL_TEXTURE_2D, host.pattern);
    gl.BindSampler(1, host.sampler);
    gl.BindVertexArray(host.shape_array);
    gl.BindBuffer(GL_ARRAY_BUFFER, host.shape_buffer);
    gl.UseProgram(host.shape_program);
    gl.Uniform1i(host_gl_uniform(host.shape_program, "pattern"), 1);
    gl.Uniform1f(host.angle, angle);
}

/* ---- what must not change across a call */

static const struct { GLenum name; const char *words; int count; } watched[] = {
    { GL_DRAW_FRAMEBUFFER_BINDING, "the draw framebuffer", 1 }, { GL_READ_FRAMEBUFFER_BINDING, "the read framebuffer", 1 },
    { GL_CURRENT_PROGRAM, "the program", 1 }, { GL_VERTEX_ARRAY_BINDING, "the vertex array", 1 }, { GL_ARRAY_BUFFER_BINDING, "the array buffer", 1 },
    { GL_PIXEL_PACK_BUFFER_BINDING, "the pack buffer", 1 }, { GL_PIXEL_UNPACK_BUFFER_BINDING, "the unpack buffer", 1 },
    { GL_TEXTURE_BUFFER, "the texture buffer", 1 }, { GL_UNIFORM_BUFFER_BINDING, "the uniform buffer", 1 },
    { GL_ACTIVE_TEXTURE, "the active texture unit", 1 }, { GL_TEXTURE_BINDING_2D, "the unit's texture", 1 }, { GL_SAMPLER_BINDING, "the unit's sampler", 1 },
    { GL_VIEWPORT, "the viewport", 4 }, { GL_SCISSOR_BOX, "the scissor box", 4 }, { GL_SCISSOR_TEST, "the scissor test", 1 },
    { GL_COLOR_CLEAR_VALUE, "the clear colour", 4 }, { GL_DEPTH_CLEAR_VALUE, "the clear depth", 1 }, { GL_STENCIL_CLEAR_VALUE, "the clear stencil", 1 },
    { GL_COLOR_WRITEMASK, "the colour mask", 4 }, { GL_DEPTH_WRITEMASK, "the depth mask", 1 }, { GL_STENCIL_WRITEMASK, "the stencil mask", 1 },
    { GL_DEPTH_TEST, "the depth test", 1 }, { GL_DEPTH_FUNC, "the depth function", 1 }, { GL_DEPTH_RANGE, "the depth range", 2 },
    { GL_STENCIL_TEST, "the stencil test", 1 }, { GL_STENCIL_FUNC, "the stencil function", 1 }, { GL_STENCIL_REF, "the stencil reference", 1 },
    { GL_BLEND, "blending", 1 }, { GL_BLEND_SRC_RGB, "the blend source", 1 }, { GL_BLEND_DST_RGB, "the blend destination", 1 },
    { GL_CULL_FACE, "culling", 1 }, { GL_CULL_FACE_MODE, "the culled face", 1 }, { GL_FRONT_FACE, "the front face", 1 },
    { GL_POLYGON_OFFSET_FILL, "polygon offset", 1 }, { GL_POLYGON_OFFSET_FACTOR, "the polygon offset's factor", 1 },
    { GL_FRAMEBUFFER_SRGB, "sRGB encoding", 1 }, { GL_CLIP_DISTANCE0, "clip distance 0", 1 }, { GL_DEPTH_CLAMP, "depth clamping", 1 },
    { GL_PACK_ALIGNMENT, "the pack alignment", 1 }, { GL_UNPACK_ROW_LENGTH, "the unpack row length", 1 }, { GL_UNPACK_ALIGNMENT, "the unpack alignment", 1 }
};
enum { WATCHED = sizeof watched / sizeof watched[0] };

static void watch(float values[WATCHED][4]) {
    int i;
    memset(values, 0, WATCHED * sizeof values[0]);
    for (i = 0; i < WATCHED; i++) gl.GetFloatv(watched[i].name, values[i]);
}

/* Returns 0 and names the first difference where there is one. */
static int compare(float before[WATCHED][4], float after[WATCHED][4], int frame) {
    int i, k;
    for (i = 0; i < WATCHED; i++)
        for (k = 0; k < watched[i].count; k++) {
            if (!(before[i][k] < after[i][k] || before[i][k] > after[i][k])) continue;
            fprintf(stderr, "host_context: in frame %d sbl.h changed %s from %g to %g\n", frame, watched[i].words, (double)before[i][k], (double)after[i][k]);
            return 0;
        }
    return 1;
}

/* ---- the frame */

/* Relies on the frame's state: also the clear colour, and the scissor, which leaves a margin. */
static void shape_draw(unsigned char *pixels) {
    gl.Clear(GL_COLOR_BUFFER_BIT);
    gl.DrawArrays(GL_TRIANGLES, 0, 3);
    gl.ReadPixels(0, SHAPE / 2, SHAPE, SHAPE, GL_RGB, GL_UNSIGNED_BYTE, pixels);
}

static int shape_size(const unsigned char *pixels) {
    int i, size = 0;
    for (i = 0; i < SHAPE * SHAPE; i++) size += memcmp(pixels, pixels + 3 * i, 3) != 0;
    return size;
}

static void picture_draw(GLuint texture) {
    gl.Viewport(SHAPE, 0, PICTURE, PICTURE);
    gl.Disable(GL_SCISSOR_TEST);
    gl.Disable(GL_CULL_FACE);
    gl.UseProgram(host.picture_program);
    gl.Uniform1i(host_gl_uniform(host.picture_program, "picture"), 1);
    gl.BindTexture(GL_TEXTURE_2D, texture);
    gl.BindVertexArray(host.picture_array);
    gl.DrawArrays(GL_TRIANGLES, 0, 3);
}

static void bar_draw(float done) {
    gl.Enable(GL_SCISSOR_TEST);
    gl.Scissor(SHAPE + 20, 12, 1 + (int)((float)(PICTURE - 40) * done), 8);
    gl.ClearColor(0.9f, 0.7f, 0.3f, 1);
    gl.Clear(GL_COLOR_BUFFER_BIT);
}

static sbl_gl_function gl_function(const char *name, void *user) {
    (void)user;
    return host_gl_function(name);
}

static int run(sbl_context *context, unsigned char *pixels) {
    static float before[WATCHED][4], after[WATCHED][4];
    static unsigned char shape_before[3 * SHAPE * SHAPE], shape_after[3 * SHAPE * SHAPE];
    sbl_picture_desc view = { 0 };
    cornell_box box;
    GLuint texture = 0;
    int frame, frames_after = 0, frames_working = 0, frames_early = 0;
    sbl_result result = SBL_UNFINISHED;
    if (sbl_set_scene(context, cornell_box_make(&box)) != SBL_SUCCESS) return 0;
    cornell_box_view(&view, PICTURE, PICTURE);
    view.preset = SBL_PRESET_DRAFT;
    view.samples = 4;
    for (frame = 0; frame < FRAMES_MOST && frames_after < FRAMES_AFTER; frame++) {
        host_state(0.05f * (float)frame);
        shape_draw(shape_before);
        watch(before);
        if (frame == 0 && sbl_begin(context, &view) != SBL_SUCCESS) return 0;
        if (result == SBL_UNFINISHED) {
            result = sbl_step(context, slice);
            if (result != SBL_SUCCESS && result != SBL_UNFINISHED) return 0;
            frames_working++;
        }
        texture = sbl_channel_texture(context, SBL_CHANNEL_FINAL);  /* the best so far; 0: nothing yet */
        frames_early += texture && result == SBL_UNFINISHED;
        frames_after += result == SBL_SUCCESS;
        watch(after);
        if (!compare(before, after, frame)) return 0;
        if (gl.GetError() != GL_NO_ERROR) return fprintf(stderr, "host_context: sbl.h left a GL error in frame %d\n", frame), 0;
        shape_draw(shape_after);
        if (memcmp(shape_before, shape_after, sizeof shape_before))
            return fprintf(stderr, "host_context: the shape drawn after sbl.h in frame %d differs from the one before\n", frame), 0;
        if (shape_size(shape_after) < SHAPE * SHAPE / 8) return fprintf(stderr, "host_context: the shape is missing in frame %d\n", frame), 0;
        if (texture) picture_draw(texture);
        if (result == SBL_UNFINISHED) bar_draw(sbl_progress(context));
    }
    gl.ReadPixels(0, 0, WIDTH, HEIGHT, GL_RGB, GL_UNSIGNED_BYTE, pixels);
    if (!texture) return fprintf(stderr, "host_context: no picture after %d frames\n", frame), 0;
    printf("host_context: state intact, %d values and the shape's pixels over %d frames, sbl.h at work in %d of them, to be seen in %d of these\n",
           (int)WATCHED, frame, frames_working, frames_early);
    return 1;
}

int main(int argc, char **argv) {
    static unsigned char pixels[WIDTH * HEIGHT * 3];
    sbl_context_desc desc = { 0 };
    sbl_context *context = NULL;
    char path[1024];
    int ok = 0;
    if (!host_gl_open("host_context")) return 1;
    desc.get_gl_function = gl_function;
    if (host_start() && sbl_create(&desc, &context) == SBL_SUCCESS) ok = run(context, pixels);  /* sbl.h says what is wrong on stderr */
    sbl_destroy(context);
    host_stop();
    host_gl_close();
    if (!ok) return 1;
    snprintf(path, sizeof path, "%s/host_context.png", argc > 1 ? argv[1] : ".");
    stbi_flip_vertically_on_write(1);  /* GL's first row is the lowest */
    if (stbi_write_png(path, WIDTH, HEIGHT, 3, pixels, 0)) return 0;
    return fprintf(stderr, "host_context: cannot write %s\n", path), 1;
}
