/* Tests that sbl.h does not change the GL state of a host. Every function is called with success, failure and
   cancelling, and all GL state is compared before and after: once with the defaults of GL, once with values that no
   program has by chance. The pictures of both must be the same to the bit. The tests also check that several contexts,
   in one GL context or headless, do not disturb each other. */
#include <EGL/egl.h>
#include <string.h>
#include "../sbl.h"
#include "support/test.h"
#include "support/scenes.h"
#include "support/gl_watch.h"
#include "support/gl_scene.h"
#include "support/gl_host.h"
#include "support/gl_state.h"
#include "support/gl_fake.h"

static const char *missing;  /* name of a function that the loader of headless contexts does not find, or NULL */

/* The linker redirects all calls of eglGetProcAddress to this function; see scripts/Makefile. */
typedef __eglMustCastToProperFunctionPointerType egl_function;
egl_function __real_eglGetProcAddress(const char *name);
egl_function __wrap_eglGetProcAddress(const char *name);
egl_function __wrap_eglGetProcAddress(const char *name) {
    return missing && strcmp(name, missing) == 0 ? NULL : __real_eglGetProcAddress(name);
}

static watch seen;
static gl_state before, after;
static gl_odd odd;
static const char *situation = "";

/* Makes a call and checks that the GL state is the same before and after. */
#define KEPT(call) do {                                                                              \
        const char *difference_;                                                                     \
        gl_state_take(&before);                                                                      \
        call;                                                                                        \
        gl_state_take(&after);                                                                       \
        difference_ = gl_state_difference(&before, &after);                                          \
        CHECK(!difference_, "%s%s changes GL state: %s", #call, situation, difference_ ? difference_ : ""); \
    } while (0)

#define GIVES(call, right) do {                                                               \
        sbl_result result_ = SBL_RESULT_COUNT;                                                \
        KEPT(result_ = (call));                                                               \
        CHECK(result_ == (right), "%s%s gives \"%s\", expected \"%s\": %s", #call, situation, \
              sbl_result_string(result_), sbl_result_string(right), watch_last(&seen));       \
    } while (0)

/* >>the scene of the host: one mesh has positions and indices in GL buffers, and one texture is in GL */

typedef struct host_scene { test_scene small; GLuint buffers[2], texture; sbl_scene_desc desc; } host_scene;

static void host_scene_make(host_scene *h) {
    static const unsigned char texels[4 * 4] = { 255, 128, 0, 255, 0, 128, 255, 255, 90, 180, 45, 255, 200, 200, 10,
        255 };
    static const float corners[12] = { -1, 0.2f, -1, -1, 0.4f, 1, 1, 0.4f, 1, 1, 0.2f, -1 };
    static const uint16_t quad[6] = { 0, 1, 2, 0, 2, 3 };
    sbl_mesh *m;
    small_scene(&h->small);
    gl.GenBuffers(2, h->buffers);
    gl.BindBuffer(GL_ARRAY_BUFFER, h->buffers[0]);
    gl.BufferData(GL_ARRAY_BUFFER, sizeof corners, corners, GL_STATIC_DRAW);
    gl.BindBuffer(GL_ARRAY_BUFFER, h->buffers[1]);
    gl.BufferData(GL_ARRAY_BUFFER, sizeof quad, quad, GL_STATIC_DRAW);
    gl.BindBuffer(GL_ARRAY_BUFFER, 0);
    gl.GenTextures(1, &h->texture);
    gl.BindTexture(GL_TEXTURE_2D, h->texture);
    gl.TexImage2D(GL_TEXTURE_2D, 0, GL_SRGB8_ALPHA8, 2, 2, 0, GL_RGBA, GL_UNSIGNED_BYTE, texels);
    gl.TexParameteri(GL_TEXTURE_2D, GL_TEXTURE_MIN_FILTER, GL_NEAREST);
    gl.BindTexture(GL_TEXTURE_2D, 0);
    m = &h->small.meshes[h->small.mesh_count++];
    memset(m, 0, sizeof *m);
    m->positions.gl_buffer = h->buffers[0];
    m->vertex_count = 4;
    m->indices.gl_buffer = h->buffers[1];
    m->indices.type = SBL_UINT16;
    m->index_count = 6;
    m->material = scene_material(&h->small, 0.9f, 0.8f, 0.7f);
    h->small.textures[h->small.texture_count++].gl_texture = h->texture;
    h->small.materials[m->material].albedo_texture = h->small.texture_count;
    h->desc = scene_desc(&h->small);
}

static host_scene scene;

static int cancel_second(float done, void *user) { (void)done; return ++*(int *)user == 2; }

/* Calls every function that uses GL, with every outcome. picture, traced: receive the last pictures of the two back
   ends */
static void every_function(small_picture *picture, small_picture *traced) {
    sbl_context_desc desc = watch_desc(&seen);
    sbl_picture_desc view = small_view(), bad = small_view();
    sbl_scene_desc wrong = scene.desc;
    sbl_context *context = NULL;
    sbl_sensor sensor;
    static float radiance[4 * 64 * 64], weights[64 * 64], room[SMALL_FLOATS];
    float moved[16] = { 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0.1f, 0.05f, 0, 1 }, back[16] = { 0 };
    int channel, steps, early = 0, calls = 0, start = seen.blocks, i;
    GLuint name = 0;
    desc.get_gl_function = fake_proc;
    desc.batch = 7;
    desc.compile_ahead = 1;

    for (i = 1; i <= 8; i++) {
        fake_arm(FAKE_COMPILE, 2 * i - 1, 0);
        GIVES(sbl_create(&desc, &context), SBL_ERROR_GL);
        fake_arm(FAKE_LINK, i, 0);
        GIVES(sbl_create(&desc, &context), SBL_ERROR_GL);
    }
    fake_arm(FAKE_LOOKUP, 20, 0);
    GIVES(sbl_create(&desc, &context), SBL_ERROR_UNSUPPORTED);
    fake_disarm();
    watch_refuse(&seen, 1);
    GIVES(sbl_create(&desc, &context), SBL_ERROR_OUT_OF_MEMORY);
    desc.compile_ahead = 0;
    GIVES(sbl_create(&desc, &context), SBL_SUCCESS);
    if (!context) return;

    GIVES(sbl_begin_picture(context, &view), SBL_ERROR_STATE);
    GIVES(sbl_step(context, 0), SBL_ERROR_STATE);
    GIVES(sbl_set_scene(context, NULL), SBL_ERROR_INVALID_ARGUMENT);
    wrong.sky[0] = -1;
    GIVES(sbl_set_scene(context, &wrong), SBL_ERROR_INVALID_ARGUMENT);
    wrong = scene.desc;
    scene.small.meshes[1].material = 77;
    GIVES(sbl_set_scene(context, &wrong), SBL_ERROR_INVALID_ARGUMENT);
    scene.small.meshes[1].material = 1;
    GIVES(sbl_set_scene(context, &scene.desc), SBL_SUCCESS);
    for (i = 1; i < 1000; i++) {  /* GL refuses each call in turn */
        sbl_result result = SBL_RESULT_COUNT;
        fake_arm(FAKE_REFUSE, i, GL_OUT_OF_MEMORY);
        KEPT(result = sbl_set_scene(context, &scene.desc));
        if (!fake.hits) break;
        CHECK(result == SBL_ERROR_OUT_OF_MEMORY, "sbl_set_scene, refusal %d%s: \"%s\"", i, situation,
              sbl_result_string(result));
    }
    CHECK(i > 5 && i < 1000, "%d refusals of sbl_set_scene", i);
    fake_disarm();  /* otherwise GL would refuse the last call below */
    for (i = 1; i < 1000; i++) {  /* each allocation fails in turn */
        sbl_result result = SBL_RESULT_COUNT;
        watch_refuse(&seen, i);
        KEPT(result = sbl_set_scene(context, &scene.desc));
        if (!watch_refused(&seen, i, result)) break;
    }
    fake_disarm();

    GIVES(sbl_set_mesh_transform(context, -1, moved), SBL_ERROR_INVALID_ARGUMENT);
    GIVES(sbl_set_mesh_transform(context, SMALL_BOX, moved), SBL_SUCCESS);
    fake_arm(FAKE_REFUSE, 1, GL_OUT_OF_MEMORY);
    GIVES(sbl_set_mesh_transform(context, SMALL_BOX, back), SBL_ERROR_OUT_OF_MEMORY);
    fake_disarm();
    GIVES(sbl_set_mesh_transform(context, SMALL_BOX, back), SBL_SUCCESS);

    bad.width = -1;
    GIVES(sbl_begin_picture(context, &bad), SBL_ERROR_INVALID_ARGUMENT);
    bad = small_view();
    bad.options.mode = SBL_MODE_COUNT;
    GIVES(sbl_begin_picture(context, &bad), SBL_ERROR_INVALID_ARGUMENT);
    bad.options.mode = SBL_MODE_GI;
    GIVES(sbl_begin_picture(context, &bad), SBL_SUCCESS);
    GIVES(sbl_step(context, 1e-9), SBL_UNFINISHED);
    GIVES(sbl_step(context, 0), SBL_SUCCESS);
    GIVES(sbl_begin_picture(context, &view), SBL_SUCCESS);
    fake_arm(FAKE_FRAMEBUFFER, 2, 0);
    GIVES(sbl_step(context, 0), SBL_ERROR_GL);
    fake_disarm();
    for (i = 1; i <= 8; i++) {  /* faults in compiling; programs are compiled when they are first used */
        GIVES(sbl_begin_picture(context, &view), SBL_SUCCESS);
        fake_arm(i % 2 ? FAKE_COMPILE : FAKE_LINK, 1, 0);
        GIVES(sbl_step(context, 0), SBL_ERROR_GL);
        fake_disarm();
    }
    GIVES(sbl_begin_picture(context, NULL), SBL_SUCCESS);
    KEPT(sbl_end(context));
    view.options.progress = cancel_second;
    view.options.progress_user = &calls;
    GIVES(sbl_begin_picture(context, &view), SBL_SUCCESS);
    GIVES(sbl_step(context, 0), SBL_CANCELLED);
    view.options.progress = NULL;
    for (i = 1; i < 1000; i++) {
        fake_arm(FAKE_REFUSE, i, GL_INVALID_OPERATION);
        KEPT(sbl_render_picture(context, &view));
        if (!fake.hits) break;
    }
    view.options.backend = SBL_BACKEND_TRACE;
    for (i = 1; i < 1000; i++) {
        fake_arm(FAKE_REFUSE, i, GL_OUT_OF_MEMORY);
        KEPT(sbl_render_picture(context, &view));
        if (!fake.hits) break;
    }
    fake_disarm();
    GIVES(sbl_render_picture(context, &view), SBL_SUCCESS);
    CHECK(small_read(context, traced) == SBL_SUCCESS, "the traced picture%s cannot be read: %s", situation,
          watch_last(&seen));
    GIVES(sbl_inspect_sensor(context, SMALL_WIDTH / 2, SMALL_HEIGHT - 1, &sensor, radiance, weights, 64 * 64),
          SBL_SUCCESS);
    view = small_view();

    GIVES(sbl_begin_picture(context, &view), SBL_SUCCESS);
    for (steps = 0; steps < 10000; steps++) {
        sbl_result result = SBL_RESULT_COUNT;
        KEPT(result = sbl_step(context, 1e-9));
        if (result != SBL_UNFINISHED) break;
        if (steps % 8 == 0) KEPT(early += sbl_channel_texture(context, SBL_CHANNEL_FINAL) != 0);
    }
    CHECK(early > 0, "the unfinished picture was never visible%s", situation);
    CHECK(steps >= 5 && steps < 10000, "%d steps", steps);
    for (channel = 0; channel < SBL_CHANNEL_COUNT; channel++) {
        GIVES(sbl_read_channel(context, (sbl_channel)channel, room, SMALL_FLOATS), SBL_SUCCESS);
        GIVES(sbl_read_channel(context, (sbl_channel)channel, room, 1), SBL_ERROR_INVALID_ARGUMENT);
        KEPT(name = sbl_channel_texture(context, (sbl_channel)channel));
        CHECK(name != 0, "channel %d has no texture%s", channel, situation);
    }
    GIVES(sbl_inspect_sensor(context, SMALL_WIDTH / 2, SMALL_HEIGHT - 1, &sensor, radiance, weights, 64 * 64),
          SBL_SUCCESS);
    GIVES(sbl_inspect_sensor(context, -1, 0, &sensor, radiance, weights, 64 * 64), SBL_ERROR_INVALID_ARGUMENT);
    fake_arm(FAKE_REFUSE, 2, GL_OUT_OF_MEMORY);
    GIVES(sbl_inspect_sensor(context, SMALL_WIDTH / 2, SMALL_HEIGHT - 1, &sensor, radiance, weights, 64 * 64),
          SBL_ERROR_OUT_OF_MEMORY);
    fake_disarm();

    gl.Enable(0xdead);  /* a GL error that the host has left */
    GIVES(sbl_render_picture(context, &view), SBL_SUCCESS);
    CHECK(gl.GetError() == GL_NO_ERROR, "sbl_render%s leaves a GL error", situation);
    CHECK(small_read(context, picture) == SBL_SUCCESS, "the picture%s cannot be read: %s", situation,
          watch_last(&seen));
    KEPT(sbl_destroy(context));
    CHECK(seen.blocks == start && seen.strangers == 0, "%d blocks leaked%s", seen.blocks - start, situation);
    CHECK(fake_live() == 0 && fake.strangers == 0, "%d GL objects leaked, %d deleted that are not sbl.h's%s",
          fake_live(),
          fake.strangers, situation);
}

static small_picture by_default[2], by_odd[2];

/* With the default state of GL, no function changes any of it. */
TEST(default_state) {
    situation = ", GL's state being the default,";
    every_function(&by_default[0], &by_default[1]);
    CHECK(small_plausible(&by_default[0]) && small_plausible(&by_default[1]) &&
          !small_same(&by_default[0], &by_default[1]),
          "the picture has only one colour, or contains NaN");
}

/* The unusual state differs from the default in every value. A value that stays the same would not show that sbl.h
   fails to set or restore it. */
TEST(unusual_state) {
    static gl_state usual, unusual;
    int i, k, left = 0;
    gl_state_take(&usual);
    gl_odd_make(&odd);
    gl_state_odd(&odd);
    gl_state_take(&unusual);
    for (i = 0; i < GL_STATE__COUNT(gl_state__switches) + GL_STATE__COUNT(gl_state__numbers); i++) {
        int is_switch = i < GL_STATE__COUNT(gl_state__switches), at = i - GL_STATE__COUNT(gl_state__switches);
        const char *name = is_switch ? gl_state__switches[i].name : gl_state__numbers[at].name;
        if (!is_switch && !gl_state__numbers[at].odd) continue;
        for (k = 0; k < usual.count && k < unusual.count; k++) {
            if (strcmp(usual.entries[k].name, name) != 0) continue;
            if (memcmp(usual.entries[k].value, unusual.entries[k].value, sizeof usual.entries[k].value) == 0) {
                left++;
                printf("  %s is still the default\n", name);
            }
        }
    }
    CHECK(left == 0, "%d values are still the default", left);
    situation = ", GL's state being unusual,";
    every_function(&by_odd[0], &by_odd[1]);
    CHECK(small_same(&by_default[0], &by_odd[0]) && small_same(&by_default[1], &by_odd[1]),
          "the host's state changes the picture");
    CHECK(gl_odd_changed(&odd) == 0, "the contents of %d of the host's buffers and framebuffers have changed",
          gl_odd_changed(&odd));
    gl_state_odd(&odd);
}

/* Each switch and the winding are changed alone, because one may hide another (discarding hides all). */
TEST(one_by_one) {
    sbl_context_desc desc = watch_desc(&seen);
    sbl_picture_desc view = small_view();
    sbl_context *context;
    static small_picture alone[2], picture;
    GLuint sampler;
    int i, k, way;
    if (!host_gl_open("test")) SKIP("no second GL context");  /* a new context, in which all state is default again */
    desc.get_gl_function = gl_host_proc;
    situation = ", one value being unusual,";
    scene_free(&scene.small);
    host_scene_make(&scene);
    REQUIRE(sbl_create(&desc, &context) == SBL_SUCCESS && sbl_set_scene(context, &scene.desc) == SBL_SUCCESS &&
            small_render(context, &view, &alone[0]) == SBL_SUCCESS, "%s", watch_last(&seen));
    view.options.backend = SBL_BACKEND_TRACE;
    REQUIRE(small_render(context, &view, &alone[1]) == SBL_SUCCESS, "%s", watch_last(&seen));
    CHECK(small_same(&alone[0], &by_default[0]) && small_same(&alone[1], &by_default[1]),
          "the picture differs in another GL context");
    gl.GenSamplers(1, &sampler);
    gl.SamplerParameteri(sampler, GL_TEXTURE_MIN_FILTER, GL_LINEAR_MIPMAP_LINEAR);
    for (i = 0; i < GL_STATE__COUNT(gl_state__switches) + 7; i++) {
        int n = i - GL_STATE__COUNT(gl_state__switches);
        const char *name = n < 0 ? gl_state__switches[i].name : n == 0 ? "FRONT_FACE" : n == 1 ? "PROVOKING_VERTEX"
            : n == 2 ? "CLIP_CONTROL" : n == 3 ? "POLYGON_MODE" :
                           n == 4 ? "DEPTH_RANGE" : n == 5 ? "DEPTH_MASK" : "a sampler";
        if (n < 0 && gl_state__switches[i].version > more_gl.version) continue;
        if (n < 0) {
            if (gl.IsEnabled(gl_state__switches[i].id)) gl.Disable(gl_state__switches[i].id);
            else gl.Enable(gl_state__switches[i].id);
        }
        if (n == 0) gl.FrontFace(GL_CW);
        if (n == 1) more_gl.ProvokingVertex(GL_FIRST_VERTEX_CONVENTION);
        if (n == 2 && more_gl.ClipControl) more_gl.ClipControl(GL_UPPER_LEFT, GL_ZERO_TO_ONE);
        if (n == 3) more_gl.PolygonMode(GL_FRONT_AND_BACK, GL_POINT);
        if (n == 4) gl.DepthRange(1, 0.5);
        if (n == 5) gl.DepthMask(GL_FALSE);
        if (n == 6) for (k = 0; k < 16; k++) gl.BindSampler((GLuint)k, sampler);
        for (way = 0; way < 2; way++) {
            view.options.backend = way ? SBL_BACKEND_TRACE : SBL_BACKEND_RASTER;
            KEPT(small_render(context, &view, &picture));
            CHECK(small_same(&picture, &alone[way]), "%s changes the %s picture", name, way ? "traced" : "rasterised");
        }
        KEPT(sbl_set_scene(context, &scene.desc));
        if (n < 0) {
            if (gl.IsEnabled(gl_state__switches[i].id)) gl.Disable(gl_state__switches[i].id);
            else gl.Enable(gl_state__switches[i].id);
        }
        gl.FrontFace(GL_CCW);
        more_gl.ProvokingVertex(GL_LAST_VERTEX_CONVENTION);
        if (more_gl.ClipControl) more_gl.ClipControl(GL_LOWER_LEFT, GL_NEGATIVE_ONE_TO_ONE);
        more_gl.PolygonMode(GL_FRONT_AND_BACK, GL_FILL);
        gl.DepthRange(0, 1);
        gl.DepthMask(GL_TRUE);
        for (k = 0; k < 16; k++) gl.BindSampler((GLuint)k, 0);
    }
    sbl_destroy(context);
}

/* >>drawing by the host, which relies on everything it has set, including state that the lists above do not contain */

enum { SHAPE = 96 };

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

static GLuint shape_texture(GLint internal, GLsizei size, GLenum format, GLenum type, const void *pixels) {
    GLuint id = 0;
    gl.GenTextures(1, &id);
    gl.BindTexture(GL_TEXTURE_2D, id);
    gl.TexImage2D(GL_TEXTURE_2D, 0, internal, size, size, 0, format, type, pixels);
    gl.TexParameteri(GL_TEXTURE_2D, GL_TEXTURE_MIN_FILTER, GL_NEAREST);
    gl.TexParameteri(GL_TEXTURE_2D, GL_TEXTURE_MAG_FILTER, GL_NEAREST);
    return id;
}

/* Compiles the program of the host. Returns 0 on failure. */
static GLuint shape_make(void) {
    static const float corners[3][5] = { { -0.8f, -0.7f, 1, 0.3f, 0.2f }, { 0.9f, -0.5f, 0.2f, 1, 0.3f },
        { 0.1f, 0.9f, 0.3f, 0.4f, 1 } };
    static const unsigned char checks[2][4][3] = { { { 255, 255, 255 }, { 160, 160, 160 } },
        { { 160, 160, 160 }, { 255, 255, 255 } } };
    GLuint program = host_gl_program("test", "", shape_vertex, shape_fragment), framebuffer, array, buffer, sampler,
        color, depth;
    color = shape_texture(GL_RGBA8, SHAPE, GL_RGBA, GL_UNSIGNED_BYTE, NULL);
    depth = shape_texture(GL_DEPTH24_STENCIL8, SHAPE, GL_DEPTH_STENCIL, GL_UNSIGNED_INT_24_8, NULL);
    gl.GenFramebuffers(1, &framebuffer);
    gl.BindFramebuffer(GL_FRAMEBUFFER, framebuffer);
    gl.FramebufferTexture2D(GL_FRAMEBUFFER, GL_COLOR_ATTACHMENT0, GL_TEXTURE_2D, color, 0);
    gl.FramebufferTexture2D(GL_FRAMEBUFFER, GL_DEPTH_STENCIL_ATTACHMENT, GL_TEXTURE_2D, depth, 0);
    gl.ActiveTexture(GL_TEXTURE0 + 1);
    gl.PixelStorei(GL_UNPACK_ROW_LENGTH, 4);  /* rows of four texels, two of which are used */
    gl.PixelStorei(GL_UNPACK_ALIGNMENT, 1);
    shape_texture(GL_RGB8, 2, GL_RGB, GL_UNSIGNED_BYTE, checks);
    gl.GenSamplers(1, &sampler);
    gl.SamplerParameteri(sampler, GL_TEXTURE_MIN_FILTER, GL_NEAREST);
    gl.SamplerParameteri(sampler, GL_TEXTURE_MAG_FILTER, GL_NEAREST);
    gl.BindSampler(1, sampler);
    gl.GenVertexArrays(1, &array);
    gl.BindVertexArray(array);
    gl.GenBuffers(1, &buffer);
    gl.BindBuffer(GL_ARRAY_BUFFER, buffer);
    gl.BufferData(GL_ARRAY_BUFFER, (GLsizeiptr)sizeof corners, corners, GL_STATIC_DRAW);
    gl.VertexAttribPointer(0, 2, GL_FLOAT, GL_FALSE, (GLsizei)sizeof corners[0], NULL);
    gl.VertexAttribPointer(1, 3, GL_FLOAT, GL_FALSE, (GLsizei)sizeof corners[0], (const void *)(2 * sizeof(float)));
    gl.EnableVertexAttribArray(0);
    gl.EnableVertexAttribArray(1);
    gl.UseProgram(program);
    gl.Uniform1i(host_gl_uniform(program, "pattern"), 1);
    return program;
}

/* Sets the state of the host, only once; nearly every value differs from the default of GL. */
static void shape_state(void) {
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
    gl.StencilMask(0x0f);
    gl.Enable(GL_STENCIL_TEST);
    gl.BlendFunc(GL_SRC_ALPHA, GL_ONE_MINUS_SRC_ALPHA);
    gl.Enable(GL_BLEND);
    gl.FrontFace(GL_CW);
    gl.CullFace(GL_FRONT);
    gl.Enable(GL_CULL_FACE);
    gl.Enable(GL_POLYGON_OFFSET_FILL);
    gl.PolygonOffset(-1, -1);
    gl.Viewport(0, 0, SHAPE, SHAPE);
    gl.Scissor(4, 4, SHAPE - 8, SHAPE - 8);
    gl.Enable(GL_SCISSOR_TEST);
    gl.PixelStorei(GL_PACK_ALIGNMENT, 1);
}

static void shape_draw(unsigned char *pixels) {
    gl.Clear(GL_COLOR_BUFFER_BIT);
    gl.DrawArrays(GL_TRIANGLES, 0, 3);
    gl.ReadPixels(0, 0, SHAPE, SHAPE, GL_RGB, GL_UNSIGNED_BYTE, pixels);
}

/* The host draws the same to the bit between all steps of sbl.h. */
TEST(the_host_draws_on) {
    static unsigned char first[3 * SHAPE * SHAPE], then[3 * SHAPE * SHAPE];
    sbl_context_desc desc = watch_desc(&seen);
    sbl_picture_desc view = small_view();
    sbl_context *context = NULL;
    sbl_result result = SBL_UNFINISHED;
    GLuint program;
    int steps, i, differing = 0, size = 0;
    if (!host_gl_open("test")) SKIP("no second GL context");
    desc.get_gl_function = gl_host_proc;
    scene_free(&scene.small);
    host_scene_make(&scene);
    program = shape_make();
    REQUIRE(program && gl.CheckFramebufferStatus(GL_FRAMEBUFFER) == GL_FRAMEBUFFER_COMPLETE,
            "the shape cannot be made");
    shape_state();
    REQUIRE(sbl_create(&desc, &context) == SBL_SUCCESS && sbl_set_scene(context, &scene.desc) == SBL_SUCCESS &&
            sbl_begin_picture(context, &view) == SBL_SUCCESS, "%s", watch_last(&seen));
    for (steps = 0; result == SBL_UNFINISHED; steps++) {
        gl.Uniform1f(host_gl_uniform(program, "angle"), 0.05f * (float)steps);
        shape_draw(first);
        result = sbl_step(context, 1e-9);
        if (steps % 8 == 0) sbl_channel_texture(context, SBL_CHANNEL_FINAL);
        shape_draw(then);
        differing += memcmp(first, then, sizeof first) != 0;
    }
    CHECK(result == SBL_SUCCESS && steps >= 5, "%d steps: %s", steps, watch_last(&seen));
    for (i = 0; i < SHAPE * SHAPE; i++) size += memcmp(then, then + 3 * i, 3) != 0;
    CHECK(size > SHAPE * SHAPE / 8, "the shape has %d pixels", size);
    CHECK(!differing, "after %d of %d steps the host draws the shape differently", differing, steps);
    CHECK(gl.GetError() == GL_NO_ERROR, "a GL error is left");
    sbl_destroy(context);
}

/* >>the draw callback */

typedef struct mess { int on; GLuint objects[5]; int calls; } mess;

/* Draws nothing, but changes state like a program that draws, and restores none of it. */
static void make_mess(const sbl_draw_view *v, void *user) {
    mess *m = (mess *)user;
    int first = !m->objects[0];
    m->calls++;
    (void)v;
    if (!m->on) return;
    if (!m->objects[0]) {
        gl.GenTextures(1, &m->objects[0]);
        gl.GenBuffers(1, &m->objects[1]);
        gl.GenVertexArrays(1, &m->objects[2]);
        gl.GenSamplers(1, &m->objects[3]);
        m->objects[4] = host_gl_program("test", "", "void main() { gl_Position = vec4(0); }\n",
                                        "out vec4 color; void main() { color = vec4(1); }\n");
    }
    gl.UseProgram(m->objects[4]);
    gl.BindVertexArray(m->objects[2]);
    gl.BindBuffer(GL_ARRAY_BUFFER, m->objects[1]);
    gl.BindBuffer(GL_PIXEL_UNPACK_BUFFER, m->objects[1]);
    gl.BindBuffer(GL_PIXEL_PACK_BUFFER, m->objects[1]);
    gl.BindSampler(0, m->objects[3]);
    gl.ActiveTexture(GL_TEXTURE0 + 3);
    gl.BindTexture(GL_TEXTURE_2D, m->objects[0]);
    gl.ActiveTexture(GL_TEXTURE0 + 15);  /* a unit that sbl.h does not use, whose binding must stay */
    if (first) gl.BindTexture(GL_TEXTURE_2D, m->objects[0]);
    gl.Enable(GL_BLEND);
    gl.Enable(GL_CULL_FACE);
    gl.Enable(GL_STENCIL_TEST);
    gl.Enable(GL_RASTERIZER_DISCARD);
    gl.Enable(GL_FRAMEBUFFER_SRGB);
    gl.Enable(GL_CLIP_DISTANCE0);
    gl.Enable(GL_CLIP_DISTANCE1 + 4);
    gl.Enable(GL_POLYGON_OFFSET_FILL);
    gl.Disable(GL_DEPTH_CLAMP);
    gl.Disable(GL_DEPTH_TEST);
    gl.Disable(GL_SCISSOR_TEST);
    gl.FrontFace(GL_CW);
    gl.DepthMask(GL_FALSE);
    gl.DepthFunc(GL_NEVER);
    gl.DepthRange(1, 0);
    gl.ColorMask(0, 1, 0, 1);
    gl.Viewport(0, 0, 1, 1);
    gl.Scissor(0, 0, 1, 1);
    gl.PixelStorei(GL_PACK_ROW_LENGTH, 3);
    gl.PixelStorei(GL_UNPACK_SKIP_PIXELS, 2);
    more_gl.PolygonMode(GL_FRONT_AND_BACK, GL_LINE);
    if (more_gl.ClipControl) more_gl.ClipControl(GL_UPPER_LEFT, GL_NEGATIVE_ONE_TO_ONE);
    gl.BindFramebuffer(GL_FRAMEBUFFER, 0);
    if (m->on > 1) gl.Enable(0xdead);
}

/* A draw callback that restores nothing changes neither the picture nor the state of the host. */
TEST(draw_callback_that_puts_nothing_back) {
    sbl_context_desc desc = watch_desc(&seen);
    sbl_picture_desc view = small_view();
    sbl_scene_desc with = scene.desc;
    sbl_context *context;
    static small_picture polite, rude;
    static mess m;
    const char *difference;
    GLint unit_15 = 0, unit_15_buffer = 0;
    sbl_result result = SBL_RESULT_COUNT;
    int i;
    desc.get_gl_function = gl_host_proc;
    with.draw = make_mess;
    with.draw_user = &m;
    for (i = 0; i < 3; i++) { with.draw_bounds[0][i] = -1; with.draw_bounds[1][i] = 1; }
    REQUIRE(sbl_create(&desc, &context) == SBL_SUCCESS && sbl_set_scene(context, &with) == SBL_SUCCESS, "%s",
            watch_last(&seen));
    CHECK(small_render(context, &view, &polite) == SBL_SUCCESS, "%s", watch_last(&seen));
    CHECK(m.calls > 10, "the callback was called %d times", m.calls);
    m.on = 1;
    gl_state_take(&before);
    CHECK(small_render(context, &view, &rude) == SBL_SUCCESS, "%s", watch_last(&seen));
    CHECK(gl.GetError() == GL_NO_ERROR, "the GL error of the callback remains");
    gl_state_take(&after);
    gl.ActiveTexture(GL_TEXTURE0 + 15);
    gl.GetIntegerv(GL_TEXTURE_BINDING_2D, &unit_15);
    gl.GetIntegerv(GL_TEXTURE_BINDING_BUFFER, &unit_15_buffer);
    CHECK((GLuint)unit_15 == m.objects[0] && unit_15_buffer == 0,
          "texture unit 15 has bindings %d and %d, the callback bound %u", unit_15, unit_15_buffer,
          m.objects[0]);
    for (i = 0; i < after.count; i++)
        if (strcmp(after.entries[i].name, "TEXTURE_2D 15") == 0)
            memcpy(after.entries[i].value, before.entries[i].value, sizeof after.entries[i].value);
    difference = gl_state_difference(&before, &after);
    CHECK(!difference, "state changed by the callback is not restored: %s", difference ? difference : "");
    CHECK(small_same(&polite, &rude), "state that the callback changes affects the picture");
    m.on = 2;  /* also causes GL errors, which may make the picture fail, but must not change it */
    watch_forget(&seen);
    KEPT(result = small_render(context, &view, &rude));
    CHECK(result == SBL_SUCCESS ? small_same(&polite, &rude) : result == SBL_ERROR_GL && seen.errors > 0,
          "after a GL error of the callback: \"%s\"",
          sbl_result_string(result));
    CHECK(gl.GetError() == GL_NO_ERROR, "the GL error of the callback remains");
    sbl_destroy(context);
}

/* >>several contexts */

static test_scene other;

static sbl_picture_desc other_view(void) {
    sbl_picture_desc view = small_view();
    view.tile = 3;
    view.options.sensor_size = 12;
    view.samples = 1;
    view.options.mode = SBL_MODE_DIRECT;
    view.options.backend = SBL_BACKEND_TRACE;
    view.options.seed = 5;
    return view;
}

/* Renders two scenes, each in a context of its own made from desc: first one after the other, then in alternating
   steps. Each scene must give the same picture both times. */
static void side_by_side(const sbl_context_desc *desc, const char *where) {
    static small_picture alone[2], together[2];
    static test_scene first;
    sbl_scene_desc scenes[2];
    sbl_picture_desc views[2];
    sbl_context *contexts[2] = { NULL, NULL };
    int i, round, done = 0;
    small_scene(&first);
    scenes[0] = scene_desc(&first);
    scenes[1] = scene_desc(&other);
    views[0] = small_view();
    views[1] = other_view();
    for (i = 0; i < 2; i++) {
        sbl_context *c;
        REQUIRE(sbl_create(desc, &c) == SBL_SUCCESS && sbl_set_scene(c, &scenes[i]) == SBL_SUCCESS &&
                small_render(c, &views[i], &alone[i]) == SBL_SUCCESS, "%s: %s", where, watch_last(&seen));
        sbl_destroy(c);
    }
    CHECK(!small_same(&alone[0], &alone[1]), "%s: the two pictures are the same", where);
    for (i = 0; i < 2; i++) REQUIRE(sbl_create(desc, &contexts[i]) == SBL_SUCCESS, "%s: %s", where, watch_last(&seen));
    for (i = 0; i < 2; i++)
        CHECK(sbl_set_scene(contexts[i], &scenes[i]) == SBL_SUCCESS, "%s: %s", where, watch_last(&seen));
    for (i = 0; i < 2; i++)
        CHECK(sbl_begin_picture(contexts[i], &views[i]) == SBL_SUCCESS, "%s: %s", where, watch_last(&seen));
    for (round = 0; round < 10000 && done != 3; round++)
        for (i = 0; i < 2; i++) {
            sbl_result result = sbl_step(contexts[i], 1e-9);
            CHECK(result == SBL_SUCCESS || result == SBL_UNFINISHED, "%s: %s", where, watch_last(&seen));
            if (result != SBL_UNFINISHED) done |= 1 << i;
        }
    CHECK(round > 3 && done == 3, "%s: %d rounds", where, round);
    for (i = 0; i < 2; i++) {
        CHECK(small_read(contexts[i], &together[i]) == SBL_SUCCESS, "%s: %s", where, watch_last(&seen));
        CHECK(small_same(&together[i], &alone[i]), "%s: picture %d differs from the one made alone", where, i);
    }
    sbl_destroy(contexts[0]);  /* the other context must still work */
    CHECK(small_render(contexts[1], &views[1], &together[1]) == SBL_SUCCESS && small_same(&together[1], &alone[1]),
          "%s: the other context fails after the first is destroyed", where);
    sbl_destroy(contexts[1]);
    scene_free(&first);
}

/* Two sbl.h contexts in one GL context do not disturb each other. */
TEST(two_contexts_in_one_gl_context) {
    sbl_context_desc desc = watch_desc(&seen);
    desc.get_gl_function = gl_host_proc;
    side_by_side(&desc, "in one GL context");
}

/* Two headless contexts do not disturb each other. */
TEST(two_headless_contexts) {
    sbl_context_desc desc = watch_desc(&seen);
    side_by_side(&desc, "headless");
}

/* >>the binding of EGL, which headless contexts must restore */

typedef struct binding { EGLDisplay display; EGLContext context; EGLSurface draw, read; EGLenum api; } binding;

static binding binding_take(void) {
    binding b;
    b.api = eglQueryAPI();
    b.display = eglGetCurrentDisplay();
    b.context = eglGetCurrentContext();
    b.draw = eglGetCurrentSurface(EGL_DRAW);
    b.read = eglGetCurrentSurface(EGL_READ);
    return b;
}

static int binding_same(binding a, binding b) {
    return a.api == b.api && a.display == b.display && a.context == b.context && a.draw == b.draw && a.read == b.read;
}

#define BOUND(call) do {                                                                                              \
        binding before_ = binding_take(), after_;                                                                     \
        call;                                                                                                         \
        after_ = binding_take();                                                                                      \
        CHECK(binding_same(before_, after_), "%s%s changes EGL's binding: context %p, API 0x%x; now %p, 0x%x", #call, \
              situation, before_.context, before_.api, after_.context, after_.api);                                   \
    } while (0)

static void headless_functions(void) {
    sbl_context_desc desc = watch_desc(&seen);
    sbl_picture_desc view = other_view();
    sbl_scene_desc s = scene_desc(&other);
    sbl_context *context = NULL;
    sbl_sensor sensor;
    static float room[SMALL_FLOATS];
    float back[16] = { 0 };
    int calls = 0;
    BOUND(CHECK(sbl_create(&desc, &context) == SBL_SUCCESS, "%s", watch_last(&seen)));
    if (!context) return;
    BOUND(CHECK(sbl_set_scene(context, &s) == SBL_SUCCESS, "%s", watch_last(&seen)));
    BOUND(CHECK(sbl_set_scene(context, NULL) != SBL_SUCCESS, "NULL"));
    BOUND(CHECK(sbl_set_mesh_transform(context, 0, back) == SBL_SUCCESS, "%s", watch_last(&seen)));
    BOUND(CHECK(sbl_begin_picture(context, &view) == SBL_SUCCESS, "%s", watch_last(&seen)));
    BOUND(CHECK(sbl_step(context, 1e-9) == SBL_UNFINISHED, "%s", watch_last(&seen)));
    BOUND(CHECK(sbl_step(context, 0) == SBL_SUCCESS, "%s", watch_last(&seen)));
    BOUND(CHECK(sbl_read_channel(context, SBL_CHANNEL_FINAL, room, SMALL_FLOATS) == SBL_SUCCESS, "%s",
                watch_last(&seen)));
    BOUND(CHECK(sbl_channel_texture(context, SBL_CHANNEL_DEPTH) != 0, "%s", watch_last(&seen)));
    BOUND(CHECK(sbl_inspect_sensor(context, SMALL_WIDTH / 2, SMALL_HEIGHT - 1, &sensor, NULL, NULL, 0) == SBL_SUCCESS,
                "%s", watch_last(&seen)));
    view.options.progress = cancel_second;
    view.options.progress_user = &calls;
    BOUND(CHECK(sbl_render_picture(context, &view) == SBL_CANCELLED, "%s", watch_last(&seen)));
    BOUND(CHECK(sbl_begin_picture(context, &view) == SBL_SUCCESS, "%s", watch_last(&seen)));
    BOUND(sbl_end(context));
    BOUND(sbl_destroy(context));
}

static void headless_fails(void) {
    static const char *const names[] = { "glActiveTexture", "glFlush", "glViewport" };
    sbl_context_desc desc = watch_desc(&seen);
    sbl_context *context = NULL;
    int i, blocks = seen.blocks;
    for (i = 0; i < 3; i++) {
        missing = names[i];
        BOUND(CHECK(sbl_create(&desc, &context) == SBL_ERROR_UNSUPPORTED && !context, "%s is missing: %s", names[i],
                    watch_last(&seen)));
        missing = NULL;
    }
    CHECK(seen.blocks == blocks, "%d blocks leaked", seen.blocks - blocks);
}

/* Headless contexts leave the GL context of the host current and its state unchanged. */
TEST(headless_beside_the_hosts_context) {
    EGLContext host = eglGetCurrentContext();
    situation = ", the host's GL context being current,";
    REQUIRE(host != EGL_NO_CONTEXT, "no context of the host");
    headless_functions();
    CHECK(eglGetCurrentContext() == host, "the host's context is no longer current");
    gl_state_take(&before);
    headless_functions();
    gl_state_take(&after);
    CHECK(!gl_state_difference(&before, &after), "the host's state: %s", gl_state_difference(&before, &after));
}

/* Headless contexts leave the surfaces of a host that draws to one and reads from another. */
TEST(headless_beside_two_surfaces) {
    static const EGLint wishes[] = { EGL_SURFACE_TYPE, EGL_PBUFFER_BIT, EGL_RENDERABLE_TYPE, EGL_OPENGL_BIT, EGL_NONE };
    static const EGLint size[] = { EGL_WIDTH, 8, EGL_HEIGHT, 8, EGL_NONE };
    const EGLContext host = eglGetCurrentContext();
    EGLSurface surfaces[2] = { EGL_NO_SURFACE, EGL_NO_SURFACE };
    EGLContext own = EGL_NO_CONTEXT;
    EGLConfig config;
    EGLint count = 0;
    int i, current = 0;
    if (eglChooseConfig(gl.display, wishes, &config, 1, &count) && count) {
        own = eglCreateContext(gl.display, config, EGL_NO_CONTEXT, NULL);
        for (i = 0; i < 2; i++) surfaces[i] = eglCreatePbufferSurface(gl.display, config, size);
        current = eglMakeCurrent(gl.display, surfaces[0], surfaces[1], own) && eglGetCurrentSurface(EGL_DRAW) !=
            eglGetCurrentSurface(EGL_READ);
    }
    situation = ", the host's surfaces being two,";
    if (current) headless_functions();
    if (current) headless_fails();
    eglMakeCurrent(gl.display, EGL_NO_SURFACE, EGL_NO_SURFACE, host);
    for (i = 0; i < 2; i++) if (surfaces[i] != EGL_NO_SURFACE) eglDestroySurface(gl.display, surfaces[i]);
    if (own != EGL_NO_CONTEXT) eglDestroyContext(gl.display, own);
    if (!current) SKIP("no two surfaces can be made current");
}

/* Failed creations of headless contexts restore the binding of EGL. */
TEST(headless_creation_fails) {
    EGLContext host = eglGetCurrentContext();
    situation = ", the host's GL context being current,";
    headless_fails();
    eglMakeCurrent(gl.display, EGL_NO_SURFACE, EGL_NO_SURFACE, host);
}

/* Headless contexts leave no context current if none was, and keep the current API of EGL. */
TEST(headless_with_nothing_current) {
    EGLContext host = eglGetCurrentContext();
    eglMakeCurrent(gl.display, EGL_NO_SURFACE, EGL_NO_SURFACE, EGL_NO_CONTEXT);
    situation = ", nothing being current,";
    headless_functions();
    headless_fails();
    if (eglBindAPI(EGL_OPENGL_ES_API)) {
        situation = ", the API being OpenGL ES,";
        headless_functions();
        headless_fails();
    }
    eglBindAPI(EGL_OPENGL_API);
    eglMakeCurrent(gl.display, EGL_NO_SURFACE, EGL_NO_SURFACE, host);
}

/* >>documentation of the state that sbl.h cannot save */

/* Returns the chapter ON GL STATE of the manual, or NULL if sbl.h is not in the current directory. */
static const char *chapter(void) {
    static char text[1 << 16];
    FILE *file = fopen("sbl.h", "rb");
    char *start, *end;
    if (!file) return NULL;
    text[fread(text, 1, sizeof text - 1, file)] = 0;
    fclose(file);
    start = strstr(text, "\n   ON GL STATE\n");
    end = start ? strstr(start, "\n   ON DETERMINISM\n") : NULL;
    if (end) *end = 0;
    return end ? start : "";
}

/* The manual mentions the state that sbl.h does not save. */
TEST(limits_are_documented) {
    static const char *const words[] = { "conditional render", "transform feedback", "quer" };
    const char *text = chapter();
    int i;
    if (!text) SKIP("sbl.h is not in the current directory");
    for (i = 0; i < 3; i++)
        CHECK(strstr(text, words[i]), "ON GL STATE does not mention an active %s...", words[i]);
}

/* glViewport, glScissor and glDepthRange set all sixteen viewports of GL 4.1, so sbl.h must restore each. */
TEST(viewport_array) {
    sbl_context_desc desc = watch_desc(&seen);
    sbl_picture_desc view = small_view();
    sbl_context *context = NULL;
    const char *text = chapter();
    if (!more_gl.ViewportIndexedf) SKIP("GL %d.%d has no viewport array", more_gl.version / 10, more_gl.version % 10);
    if (text && strstr(text, "viewport array")) SKIP("documented as a limit");
    situation = ", the viewports being different,";
    more_gl.ViewportIndexedf(1, 5, 6, 7, 8);
    more_gl.ScissorIndexed(2, 1, 1, 9, 9);
    more_gl.DepthRangeIndexed(3, 0.5, 0.25);
    more_gl.Enablei(GL_SCISSOR_TEST, 1);
    desc.get_gl_function = gl_host_proc;
    GIVES(sbl_create(&desc, &context), SBL_SUCCESS);
    if (!context) return;
    GIVES(sbl_set_scene(context, &scene.desc), SBL_SUCCESS);
    GIVES(sbl_render_picture(context, &view), SBL_SUCCESS);
    view.options.backend = SBL_BACKEND_TRACE;
    GIVES(sbl_render_picture(context, &view), SBL_SUCCESS);
    sbl_destroy(context);
}

int main(void) {
    if (!gl_host_open()) { printf("no GL context\n"); return 1; }
    if (eglGetCurrentContext() == EGL_NO_CONTEXT) return 1;
    host_scene_make(&scene);
    scene_floor(&other, scene_material(&other, 0.5f, 0.4f, 0.3f), 0, 3);
    scene_box(&other, scene_lamp(&other, 3, 2, 1), -0.3f, 0.4f, -0.3f, 0.3f, 1, 0.3f);
    RUN(default_state);
    RUN(unusual_state);
    RUN(the_host_draws_on);
    RUN(one_by_one);
    RUN(draw_callback_that_puts_nothing_back);
    RUN(two_contexts_in_one_gl_context);
    RUN(two_headless_contexts);
    RUN(headless_beside_the_hosts_context);
    RUN(headless_beside_two_surfaces);
    RUN(headless_creation_fails);
    RUN(headless_with_nothing_current);
    RUN(limits_are_documented);
    RUN(viewport_array);
    scene_free(&scene.small);
    scene_free(&other);
    return test_report();
}
