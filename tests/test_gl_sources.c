/* Tests GL objects as input and output. Meshes in GL buffers and textures in GL textures give the same picture as the
   same bytes in client memory, to the bit. The texture of a channel holds the values that sbl_read_channel returns. */
#include "../sbl.h"
#include "support/test.h"
#include "support/scenes.h"
#include "support/gl_host.h"

static sbl_context *context;

static unsigned buffer_of(const void *bytes, size_t size) {
    GLuint name = 0;
    gl.GenBuffers(1, &name);
    gl.BindBuffer(GL_ARRAY_BUFFER, name);
    gl.BufferData(GL_ARRAY_BUFFER, (GLsizeiptr)size, bytes, GL_STATIC_DRAW);
    gl.BindBuffer(GL_ARRAY_BUFFER, 0);
    return name;
}

/* A white, textured floor under a small lamp; positions and texture coordinates are interleaved. */
static const float corners[] = { -1, 0, -1, 0, 0,   -1, 0, 1, 0, 1,   1, 0, 1, 1, 1,   1, 0, -1, 1, 0 };
static const unsigned short quad[] = { 7, 7, 0, 1, 2, 0, 2, 3 };  /* the offset skips the first two */
/* the alpha of the third texel is below the cutoff, and would be above it if it were encoded as sRGB */
static const unsigned char texels[] = { 255, 0, 0, 255,   0, 200, 0, 255,   0, 0, 150, 100,   90, 90, 90, 255 };

/* GL buffers and textures give the same picture as arrays, to the bit. */
TEST(gl_objects_are_as_good_as_arrays) {
    float *pictures[3] = { NULL, NULL, NULL };
    int kind, i;
    sbl_picture_desc view = scene_view(32, 24, 50, 0, 2, 2, 0, 0, 0);
    /* arrays; GL objects; GL objects with other bytes, which must change the picture */
    for (kind = 0; kind < 3; kind++) {
        test_scene s = { 0 };
        sbl_mesh *m;
        int white = scene_material(&s, 0.9f, 0.9f, 0.9f), lamp = scene_lamp(&s, 9, 9, 9);
        float bytes[20];
        GLuint texture = 0;
        s.materials[white].alpha_cutoff = 0.5f;
        memcpy(bytes, corners, sizeof bytes);
        if (kind == 2) bytes[0] = -0.2f;
        scene_quad(&s, lamp, -0.2f, 1, -0.2f, 0.2f, 1, -0.2f, 0.2f, 1, 0.2f, -0.2f, 1, 0.2f);
        m = scene_floor(&s, white, 0, 1);
        m->vertex_count = 4;
        m->positions.stride = m->texcoords.stride = 20;
        m->texcoords.offset = 12;
        m->indices.type = SBL_UINT16;
        m->indices.offset = 4;
        m->indices.stride = 0;
        m->index_count = 6;
        if (kind == 0) {
            m->positions.data = m->texcoords.data = bytes;
            m->indices.data = quad;
            s.materials[white].albedo_texture = scene_texture(&s, texels, sizeof texels, SBL_PIXELS_SRGB8, 2, 2, 4);
        } else {
            m->positions.data = m->texcoords.data = m->indices.data = NULL;
            m->positions.gl_buffer = m->texcoords.gl_buffer = buffer_of(bytes, sizeof bytes);
            m->indices.gl_buffer = buffer_of(quad, sizeof quad);
            gl.GenTextures(1, &texture);
            gl.BindTexture(GL_TEXTURE_2D, texture);
            gl.TexImage2D(GL_TEXTURE_2D, 0, GL_SRGB8_ALPHA8, 2, 2, 0, GL_RGBA, GL_UNSIGNED_BYTE, texels);
            gl.BindTexture(GL_TEXTURE_2D, 0);
            s.textures[s.texture_count++].gl_texture = texture;
            s.materials[white].albedo_texture = s.texture_count;
        }
        REQUIRE(scene_render(context, &s, &view), "no picture of kind %d", kind);
        pictures[kind] = scene_channel(context, &view, SBL_CHANNEL_FINAL);
        if (kind) {
            gl.DeleteBuffers(1, &m->positions.gl_buffer);
            gl.DeleteBuffers(1, &m->indices.gl_buffer);
            gl.DeleteTextures(1, &texture);
        }
        scene_free(&s);
    }
    for (i = 0; i < 32 * 24 * 3 && pictures[0][i] == pictures[1][i];) i++;
    CHECK(i == 32 * 24 * 3, "float %d is %g from arrays, %g from GL objects", i, (double)pictures[0][i % 2304],
          (double)pictures[1][i % 2304]);
    CHECK(memcmp(pictures[1], pictures[2], sizeof(float) * 32 * 24 * 3) != 0,
          "the contents of the buffer have no effect");
    for (kind = 0; kind < 3; kind++) free(pictures[kind]);
}

/* A buffer must hold all elements of a stream, which begin at the offset; one byte less is refused. */
TEST(buffers_hold_all_elements) {
    enum { OFFSET = 8, SIZE = OFFSET + 4 * 12 };
    static const char zeros[SIZE];
    int less;
    for (less = 0; less < 2; less++) {
        test_scene s = { 0 };
        sbl_mesh *m = scene_floor(&s, scene_material(&s, 1, 1, 1), 0, 1);
        sbl_scene_desc desc;
        m->normals.gl_buffer = buffer_of(zeros, (size_t)(SIZE - less));
        m->normals.offset = OFFSET;
        desc = scene_desc(&s);
        CHECK(m->vertex_count == 4 && sbl_set_scene(context, &desc) ==
              (less ? SBL_ERROR_INVALID_ARGUMENT : SBL_SUCCESS), "%d bytes", SIZE - less);
        gl.DeleteBuffers(1, &m->normals.gl_buffer);
        m->normals.gl_buffer = 0;
        scene_free(&s);
    }
}

/* Compares all channels of a picture, unfinished or finished, with their textures. Returns the number of available
   channels. */
static int compare_channels(const char *when) {
    enum { PIXELS = 32 * 24 };
    static float read[3 * PIXELS], held[4 * PIXELS];
    static unsigned ids[PIXELS];
    int channel, shown = 0;
    for (channel = 0; channel < SBL_CHANNEL_COUNT; channel++) {
        const int components = sbl_channel_components((sbl_channel)channel);
        const sbl_result result = sbl_read_channel(context, (sbl_channel)channel, read, 3 * PIXELS);
        const GLuint name = sbl_channel_texture(context, (sbl_channel)channel);
        GLint size[2] = { 0, 0 };
        int i, k, wrong = 0;
        CHECK((name != 0) == (result == SBL_SUCCESS), "%s, channel %d: texture %u, reading gives %s", when, channel,
              name, sbl_result_string(result));
        if (!name) continue;
        shown++;
        gl.BindTexture(GL_TEXTURE_2D, name);
        more_gl.GetTexLevelParameteriv(GL_TEXTURE_2D, 0, GL_TEXTURE_WIDTH, &size[0]);
        more_gl.GetTexLevelParameteriv(GL_TEXTURE_2D, 0, GL_TEXTURE_HEIGHT, &size[1]);
        if (size[0] == 32 && size[1] == 24 && channel == SBL_CHANNEL_ID) {
            more_gl.GetTexImage(GL_TEXTURE_2D, 0, GL_RED_INTEGER, GL_UNSIGNED_INT, ids);
            for (i = 0; i < PIXELS; i++) held[4 * i] = (float)ids[i];
        } else if (size[0] == 32 && size[1] == 24) more_gl.GetTexImage(GL_TEXTURE_2D, 0, GL_RGBA, GL_FLOAT, held);
        gl.BindTexture(GL_TEXTURE_2D, 0);
        CHECK(size[0] == 32 && size[1] == 24 && gl.GetError() == GL_NO_ERROR, "%s, channel %d: a texture of %d x %d",
              when, channel, size[0], size[1]);
        for (i = 0; i < PIXELS; i++)
            for (k = 0; k < components; k++) wrong += !(held[4 * i + k] == read[components * i + k]);
        CHECK(wrong == 0, "%s, channel %d: %d of %d floats differ between texture and reading", when, channel, wrong,
              PIXELS * components);
    }
    return shown;
}

/* The textures of all channels hold the values that sbl_read_channel returns, before and after the end of the
   picture. */
TEST(textures_hold_the_channels) {
    test_scene s = { 0 };
    sbl_picture_desc view = scene_view(32, 24, 50, 0.3f, 2, 2, 0, 0, 0);
    sbl_scene_desc desc;
    sbl_result result = SBL_UNFINISHED;
    int shown = 0, steps;
    scene_sphere(&s, scene_material(&s, 0.3f, 0.6f, 0.9f), 0.2f, 0.3f, 0, 0.3f, 16, 12, 1);
    scene_floor(&s, scene_material(&s, 0.9f, 0.5f, 0.2f), 0, 1);
    scene_quad(&s, scene_lamp(&s, 9, 8, 7), -0.2f, 1, -0.2f, 0.2f, 1, -0.2f, 0.2f, 1, 0.2f, -0.2f, 1, 0.2f);
    scene_sky(&s, 0.1f, 0.2f, 0.3f);
    desc = scene_desc(&s);
    REQUIRE(sbl_set_scene(context, &desc) == SBL_SUCCESS && sbl_begin_picture(context, &view) == SBL_SUCCESS,
            "no scene");
    for (steps = 0; result == SBL_UNFINISHED && steps < 100000; steps++) {
        result = sbl_step(context, 1e-9);
        if (result == SBL_UNFINISHED && steps % 16 == 0) shown += compare_channels("unfinished");
    }
    CHECK(result == SBL_SUCCESS && shown > SBL_CHANNEL_COUNT, "%d channels were available before the end: %s", shown,
          sbl_result_string(result));
    CHECK(compare_channels("finished") == SBL_CHANNEL_COUNT, "channels without a texture");
    view.width = 70;  /* a window of 32 x 24 pixels in a larger picture */
    view.height = 50;
    view.window[0] = 33;
    view.window[1] = 11;
    view.window[2] = 32;
    view.window[3] = 24;
    CHECK(sbl_render_picture(context, &view) == SBL_SUCCESS && compare_channels("a window") == SBL_CHANNEL_COUNT,
          "the window failed or has channels without a texture");
    scene_free(&s);
}

int main(void) {
    sbl_context_desc desc;
    memset(&desc, 0, sizeof desc);
    if (!gl_host_open()) return 1;
    desc.get_gl_function = gl_host_proc;
    if (sbl_create(&desc, &context) != SBL_SUCCESS) return 1;
    RUN(gl_objects_are_as_good_as_arrays);
    RUN(buffers_hold_all_elements);
    RUN(textures_hold_the_channels);
    sbl_destroy(context);
    host_gl_close();
    return test_report();
}
