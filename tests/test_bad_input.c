/* Tests mistakes of a host: wrong values in every field of every descriptor, NULL, calls in the wrong order, arrays
   that are too small, cancelling, and abandoning work. For each mistake the tests check the result, and a message that
   names the place, the field and the value. They also check that nothing has changed or leaked: the context must still
   render a known picture, equal to the bit. */
#define _DEFAULT_SOURCE
#include "../sbl.h"
#include "support/test.h"
#include "support/scenes.h"
#include "support/gl_watch.h"
#include "support/gl_scene.h"
#include <limits.h>
#include <unistd.h>

#define INF ((float)HUGE_VAL)
#define NOT ((float)NAN)

static watch seen;
static sbl_context *context;
static test_scene small;
static small_picture expected, expected_traced;
static sbl_memory memory;  /* memory in use after the known picture is finished */
static int blocks;
static sbl_picture_desc view;

/* Brings the context into the state in which every test finds and leaves it: the small scene is set, and its picture
   has been rendered, first traced, then rasterised. */
static void known_picture(void) {
    sbl_scene_desc desc = scene_desc(&small);
    if (sbl_set_scene(context, &desc) != SBL_SUCCESS) abort();
    view = small_view();
    view.options.backend = SBL_BACKEND_TRACE;
    if (small_render(context, &view, &expected_traced) != SBL_SUCCESS) abort();
    view.options.backend = SBL_BACKEND_RASTER;
    if (small_render(context, &view, &expected) != SBL_SUCCESS) abort();
    memory = sbl_query_memory(context);
    blocks = seen.blocks;
}

/* Renders the known picture again, traced and rasterised, and compares the picture and the memory in use. The context
   must have the small scene. Returns 1 if all are equal. */
static int usable(const char *after) {
    static small_picture picture;
    sbl_result result;
    sbl_memory now;
    view = small_view();
    view.options.backend = SBL_BACKEND_TRACE;
    result = small_render(context, &view, &picture);
    CHECK(result == SBL_SUCCESS && small_same(&picture, &expected_traced),
          "after %s: the traced known picture gives \"%s\" or has changed: %s",
          after, sbl_result_string(result), watch_last(&seen));
    view.options.backend = SBL_BACKEND_RASTER;
    result = small_render(context, &view, &picture);
    now = sbl_query_memory(context);
    CHECK(result == SBL_SUCCESS, "after %s: the known picture gives \"%s\": %s", after, sbl_result_string(result),
          watch_last(&seen));
    CHECK(result != SBL_SUCCESS || small_same(&picture, &expected), "after %s: the known picture has changed", after);
    CHECK(now.host_bytes == memory.host_bytes && now.gpu_bytes == memory.gpu_bytes,
          "after %s: %.0f host and %.0f GPU bytes in use, before %.0f and %.0f", after,
          (double)now.host_bytes, (double)now.gpu_bytes, (double)memory.host_bytes, (double)memory.gpu_bytes);
    CHECK(seen.blocks == blocks, "after %s: %d blocks of memory in use, before %d", after, seen.blocks, blocks);
    CHECK(seen.strangers == 0, "after %s: a block was freed twice, or was never allocated", after);
    return result == SBL_SUCCESS;
}

static void refused(sbl_result result, sbl_result wanted, sbl_log_item item, const char *mistake, const char *where,
                    const char *field, const char *value) {
    CHECK(result == wanted, "%s: \"%s\", expected \"%s\"", mistake, sbl_result_string(result),
          sbl_result_string(wanted));
    CHECK(watch_said(&seen, SBL_LOG_ERROR, item, where, field, value),
          "%s: no message with \"%s\", \"%s\", \"%s\" (%s); the last of %d messages: %s",
          mistake, where ? where : "",
          field ? field : "", value ? value : "", sbl_log_item_string(item), seen.count, watch_last(&seen));
}

/* >>invalid sbl_context_desc fields */

static void bad_context(const sbl_context_desc *desc, const char *mistake, const char *field, const char *value) {
    sbl_context *out = (sbl_context *)&seen;
    int before = seen.blocks;
    watch_forget(&seen);
    refused(sbl_create(desc, &out), SBL_ERROR_INVALID_ARGUMENT, SBL_LOG_ITEM_INVALID_CONTEXT_DESC, mistake,
            "sbl_context_desc", field, value);
    CHECK(out == NULL, "%s: sbl_create returned a context", mistake);
    CHECK(seen.blocks == before, "%s: %d blocks leaked", mistake, seen.blocks - before);
}

#define BAD_CONTEXT(change, field, value) \
    do { sbl_context_desc d = watch_desc(&seen); change; bad_context(&d, #change, field, value); } while (0)

static int has_no_bounds(const sbl_context *c) {
    static const sbl_bounds none;
    const sbl_bounds bounds = sbl_query_bounds(c);
    return memcmp(&bounds, &none, sizeof none) == 0;
}

/* sbl_create refuses each invalid field of sbl_context_desc with a message that names the field and the value. */
TEST(context_desc) {
    BAD_CONTEXT(d.allocator.free = NULL, "allocator.free", "NULL");
    BAD_CONTEXT(d.allocator.alloc = NULL, "allocator.alloc", "NULL");
    BAD_CONTEXT(d.disabled = 0x80000000u, "disabled", "0x80000000");
    BAD_CONTEXT(d.disabled = SBL_CAPABILITY_ALL + 1, "disabled", "0x");
    BAD_CONTEXT(d.sensor_texture_size = -1, "sensor_texture_size", "-1");
    BAD_CONTEXT(d.sensor_texture_size = 255, "sensor_texture_size", "255");
    BAD_CONTEXT(d.sensor_texture_size = 16385, "sensor_texture_size", "16385");
    BAD_CONTEXT(d.sensor_texture_size = INT_MIN, "sensor_texture_size", "-2147483648");
    BAD_CONTEXT(d.batch = -1, "batch", "-1");
    BAD_CONTEXT(d.batch = INT_MIN, "batch", "-2147483648");
    usable("bad context descriptors");
}

/* The logger and the allocator of a struct that was not zeroed are no functions. The message goes to stderr. */
TEST(context_desc_not_zeroed) {
    int way;
    for (way = 0; way < 4; way++) {  /* a byte of every field, either canary, and no place for the context */
        sbl_context_desc d = watch_desc(&seen);
        sbl_context *out = (sbl_context *)&seen;
        char text[256] = "";
        FILE *said = tmpfile();
        const int before = dup(2);
        sbl_result result;
        if (!said) abort();
        if (way == 0 || way == 3) memset(&d, 0xcc, sizeof d);
        if (way == 1) d.start_canary = 0xabc;
        if (way == 2) d.end_canary = 0xabc;
        watch_forget(&seen);
        fflush(stderr);
        dup2(fileno(said), 2);
        result = sbl_create(&d, way < 3 ? &out : NULL);
        fflush(stderr);
        dup2(before, 2);
        close(before);
        rewind(said);
        text[fread(text, 1, sizeof text - 1, said)] = 0;
        fclose(said);
        CHECK(result == SBL_ERROR_INVALID_ARGUMENT && (way == 3 || !out), "way %d: \"%s\"", way,
              sbl_result_string(result));
        CHECK(!strncmp(text, "sbl: error: ", 12) && strstr(text, way == 3 ? "out is NULL" : "zero the whole struct") &&
              strstr(text, way == 0 ? "cccccccc" : way < 3 ? "abc" : ""), "way %d says on stderr: %s", way, text);
        CHECK(!seen.count, "way %d calls the logger of the struct: %s", way, watch_last(&seen));
    }
    usable("context descriptors that were not zeroed");
}

/* Four invalid fields cause four messages. */
TEST(context_desc_all_at_once) {
    sbl_context_desc d = watch_desc(&seen);
    sbl_context *out = NULL;
    d.allocator.free = NULL;
    d.disabled = 0xff00;
    d.sensor_texture_size = 7;
    d.batch = -3;
    watch_forget(&seen);
    CHECK(sbl_create(&d, &out) == SBL_ERROR_INVALID_ARGUMENT && !out, "four mistakes are accepted");
    CHECK(seen.errors == 4, "%d errors for four mistakes", seen.errors);
    refused(SBL_ERROR_INVALID_ARGUMENT, SBL_ERROR_INVALID_ARGUMENT, SBL_LOG_ITEM_INVALID_CONTEXT_DESC, "of four", NULL,
            "allocator.free", NULL);
    refused(SBL_ERROR_INVALID_ARGUMENT, SBL_ERROR_INVALID_ARGUMENT, SBL_LOG_ITEM_INVALID_CONTEXT_DESC, "of four", NULL,
            "disabled", "ff00");
    refused(SBL_ERROR_INVALID_ARGUMENT, SBL_ERROR_INVALID_ARGUMENT, SBL_LOG_ITEM_INVALID_CONTEXT_DESC, "of four", NULL,
            "sensor_texture_size", "7");
    refused(SBL_ERROR_INVALID_ARGUMENT, SBL_ERROR_INVALID_ARGUMENT, SBL_LOG_ITEM_INVALID_CONTEXT_DESC, "of four", NULL,
            "batch", "-3");
}

/* >>invalid fields of sbl_scene_desc, sbl_mesh, sbl_stream, sbl_material, sbl_texture, sbl_light and sbl_environment.
   Each test changes one field of a valid scene. The mistakes are in the second mesh, material and texture, so that a
   message that always says 0 fails the test. */

typedef struct fixture {
    float positions[12], normals[12], texcoords[8], colors[16];
    uint8_t indices8[6];
    uint16_t indices16[6];
    uint32_t indices32[6];
    unsigned char bytes[4 * 4];
    float floats[4 * 4];
    sbl_mesh meshes[2];
    sbl_material materials[2];
    sbl_texture textures[2];
    sbl_light lights[3];
    sbl_scene_desc scene;
} fixture;

static fixture f;

static void fixture_reset(void) {
    static const float corners[12] = { -1, 0, -1, -1, 0, 1, 1, 0, 1, 1, 0, -1 };
    static const uint32_t indices[6] = { 0, 1, 2, 0, 2, 3 };
    int i;
    memset(&f, 0, sizeof f);
    memcpy(f.positions, corners, sizeof corners);
    memcpy(f.indices32, indices, sizeof indices);
    for (i = 0; i < 6; i++) { f.indices8[i] = (uint8_t)indices[i]; f.indices16[i] = (uint16_t)indices[i]; }
    for (i = 0; i < 4; i++) f.normals[3 * i + 1] = 1;
    for (i = 0; i < 16; i++) { f.colors[i] = 0.5f; f.floats[i] = 0.5f; f.bytes[i] = 99; }
    for (i = 0; i < 2; i++) {
        sbl_mesh *m = &f.meshes[i];
        m->positions.data = f.positions;
        m->normals.data = f.normals;
        m->texcoords.data = f.texcoords;
        m->colors.data = f.colors;
        m->indices.data = f.indices32;
        m->indices.type = SBL_UINT32;
        m->vertex_count = 4;
        m->index_count = 6;
        m->material = i;
        f.materials[i].albedo[1] = 0.5f;
        f.materials[i].albedo_texture = 1;
        f.materials[i].emission_texture = 2;
        f.textures[i].width = f.textures[i].height = 2;
    }
    f.textures[0].pixels = f.bytes;
    f.textures[1].pixels = f.floats;
    f.textures[1].format = SBL_PIXELS_FLOAT;
    f.scene.meshes = f.meshes;
    f.scene.mesh_count = 2;
    f.scene.materials = f.materials;
    f.scene.material_count = 2;
    f.scene.textures = f.textures;
    f.scene.texture_count = 2;
    for (i = 0; i < 3; i++) {
        sbl_light *l = &f.lights[i];
        l->kind = (sbl_light_kind)i;
        l->intensity[1] = 2;
        l->position[1] = 3;
        l->direction[1] = -1;
    }
    f.scene.lights = f.lights;
    f.scene.light_count = 3;
    f.scene.environment.picture.pixels = f.floats;
    f.scene.environment.picture.format = SBL_PIXELS_FLOAT;
    f.scene.environment.picture.width = f.scene.environment.picture.height = 2;
}

static void identity(float m[16]) {
    int i;
    for (i = 0; i < 16; i++) m[i] = i % 5 == 0;
}

static void draws_nothing(const sbl_draw_view *v, void *user) { (void)v; (void)user; }

static void bad_scene(sbl_result wanted, sbl_log_item item, const char *mistake, const char *where, const char *field,
                      const char *value) {
    sbl_result result;
    watch_forget(&seen);
    result = sbl_set_scene(context, &f.scene);
    refused(result, wanted, item, mistake, where, field, value);
    /* if a mistake is accepted, this keeps later tests from failing, too */
    if (result == SBL_SUCCESS) known_picture();
    CHECK(seen.blocks == blocks, "%s: %d blocks leaked", mistake, seen.blocks - blocks);
}

#define BAD_SCENE(change, item, where, field, value)                                                                 \
    do { fixture_reset(); change; bad_scene(SBL_ERROR_INVALID_ARGUMENT, SBL_LOG_ITEM_INVALID_##item, #change, where, \
                                            field, value); } while (0)

/* sbl_set_scene accepts the unchanged fixture; otherwise the refusals below would prove nothing. */
TEST(scene_without_mistakes) {
    sbl_result result;
    fixture_reset();
    watch_forget(&seen);
    result = sbl_set_scene(context, &f.scene);
    CHECK(result == SBL_SUCCESS && seen.errors == 0 && seen.warnings == 0, "\"%s\": %s", sbl_result_string(result),
          watch_last(&seen));
    known_picture();
    CHECK(seen.blocks == blocks, "blocks leaked");
}

/* sbl_set_scene refuses each invalid field of sbl_scene_desc with a message that names the field and the value. */
TEST(scene_desc) {
    int i, k;
    BAD_SCENE(f.scene.start_canary = 0xabc, SCENE_DESC, "sbl_scene_desc", "start_canary", "abc");
    BAD_SCENE(f.scene.end_canary = 0xabc, SCENE_DESC, "sbl_scene_desc", "end_canary", "abc");
    BAD_SCENE(f.scene.mesh_count = -1, SCENE_DESC, "sbl_scene_desc", "mesh_count is -1; it must not be", "negative");
    BAD_SCENE(f.scene.mesh_count = INT_MIN, SCENE_DESC, "sbl_scene_desc", "mesh_count", "-2147483648");
    BAD_SCENE(f.scene.meshes = NULL, SCENE_DESC, "sbl_scene_desc", "mesh_count is 2, but the array is", "NULL");
    BAD_SCENE(f.scene.material_count = -1, SCENE_DESC, "sbl_scene_desc", "material_count", "-1");
    BAD_SCENE(f.scene.materials = NULL, SCENE_DESC, "sbl_scene_desc", "material_count is 2", "NULL");
    BAD_SCENE(f.scene.texture_count = -1, SCENE_DESC, "sbl_scene_desc", "texture_count", "-1");
    BAD_SCENE(f.scene.textures = NULL, SCENE_DESC, "sbl_scene_desc", "texture_count is 2", "NULL");
    for (i = 0; i < 3; i++) {
        char field[32];
        snprintf(field, sizeof field, "sky[%d]", i);
        BAD_SCENE(f.scene.sky[i] = NOT, SCENE_DESC, "sbl_scene_desc", field, "nan");
        BAD_SCENE(f.scene.sky[i] = INF, SCENE_DESC, "sbl_scene_desc", field, "inf");
        BAD_SCENE(f.scene.sky[i] = -0.5f, SCENE_DESC, "sbl_scene_desc", field, "-0.5");
    }
    for (i = 0; i < 2; i++)
        for (k = 0; k < 3; k++) {
            char field[32];
            snprintf(field, sizeof field, "draw_bounds[%d][%d]", i, k);
            BAD_SCENE((f.scene.draw = draws_nothing, f.scene.draw_bounds[i][k] = NOT), SCENE_DESC, "sbl_scene_desc",
                      field, "nan");
            BAD_SCENE((f.scene.draw = draws_nothing, f.scene.draw_bounds[i][k] = INF), SCENE_DESC, "sbl_scene_desc",
                      field, "inf");
        }
    BAD_SCENE((f.scene.draw = draws_nothing, f.scene.draw_bounds[0][1] = 2), SCENE_DESC, "sbl_scene_desc",
              "draw_bounds[0][1]", "2");
    BAD_SCENE(f.scene.draw_max_radiance = NOT, SCENE_DESC, "sbl_scene_desc", "draw_max_radiance", "nan");
    BAD_SCENE(f.scene.draw_max_radiance = INF, SCENE_DESC, "sbl_scene_desc", "draw_max_radiance", "inf");
    BAD_SCENE(f.scene.draw_max_radiance = -2, SCENE_DESC, "sbl_scene_desc", "draw_max_radiance", "-2");
    BAD_SCENE(f.scene.max_bounce_cells = -2, SCENE_DESC, "sbl_scene_desc", "max_bounce_cells", "-2");
    BAD_SCENE(f.scene.max_bounce_cells = 1, SCENE_DESC, "sbl_scene_desc", "max_bounce_cells", "is 1;");
    BAD_SCENE(f.scene.max_bounce_cells = 1023, SCENE_DESC, "sbl_scene_desc", "max_bounce_cells", "1023");
    BAD_SCENE(f.scene.max_bounce_cells = 1048577, SCENE_DESC, "sbl_scene_desc", "max_bounce_cells", "1048577");
    usable("bad scene descriptors");
}

/* Invalid counts and materials of a mesh are refused, and the message names the mesh. */
TEST(mesh_counts_and_material) {
    BAD_SCENE(f.meshes[1].vertex_count = -1, MESH, "mesh 1", "vertex_count", "-1");
    BAD_SCENE(f.meshes[1].vertex_count = INT_MIN, MESH, "mesh 1", "vertex_count", "-2147483648");
    BAD_SCENE((f.meshes[1].indices.data = NULL, f.meshes[1].vertex_count = 4), MESH, "mesh 1", "vertex_count", "4");
    BAD_SCENE(f.meshes[1].index_count = -3, MESH, "mesh 1", "index_count", "-3");
    BAD_SCENE(f.meshes[1].index_count = 4, MESH, "mesh 1", "index_count", "4");
    BAD_SCENE(f.meshes[1].positions.data = NULL, MESH, "mesh 1", "positions", "4");
    BAD_SCENE(f.meshes[1].material = -1, MESH, "mesh 1", "material", "-1");
    BAD_SCENE(f.meshes[1].material = 2, MESH, "mesh 1", "material is 2", "2");
    BAD_SCENE(f.meshes[1].material = INT_MAX, MESH, "mesh 1", "material", "2147483647");
    BAD_SCENE((f.scene.material_count = 0, f.scene.materials = NULL), MESH, "mesh 1", "material is 1", "0");
    usable("bad meshes");
}

/* Indices beyond the last vertex are refused, and the message names the mesh and the index. */
TEST(mesh_indices_past_the_end) {
    BAD_SCENE(f.indices32[4] = 4, MESH, "mesh 0", "index 4", "4");
    BAD_SCENE(f.indices32[4] = 0xffffffffu, MESH, "mesh 0", "index 4", "4294967295");
    BAD_SCENE(f.indices32[0] = 0x80000000u, MESH, "mesh 0", "index 0", "2147483648");
    BAD_SCENE((f.meshes[1].indices.data = f.indices16, f.meshes[1].indices.type = SBL_UINT16, f.indices16[5] = 65535),
              MESH, "mesh 1", "index 5", "65535");
    BAD_SCENE((f.meshes[1].indices.data = f.indices8, f.meshes[1].indices.type = SBL_UINT8, f.indices8[5] = 255), MESH,
              "mesh 1", "index 5", "255");
    BAD_SCENE((f.meshes[1].vertex_count = 0, f.meshes[1].positions.data = NULL), MESH, "mesh 1", "index 0",
              "0 vertices");
    usable("indices past the end");
}

static sbl_stream *stream(int which) {
    sbl_mesh *m = &f.meshes[1];
    return which == 0 ? &m->positions : which == 1 ? &m->normals : which == 2 ? &m->texcoords : which == 3 ? &m->colors
        : &m->indices;
}

/* Every field of every vertex stream is checked, including sizes whose products overflow. */
TEST(streams) {
    static const char *const names[5] = { "positions", "normals", "texcoords", "colors", "indices" };
    static const int components[5] = { 3, 3, 2, 4, 1 };
    int i, type;
    for (i = 0; i < 5; i++) {
        char field[32];
        snprintf(field, sizeof field, "%s.type", names[i]);
        BAD_SCENE(stream(i)->type = (sbl_type)-1, MESH, "mesh 1", field, "-1");
        BAD_SCENE(stream(i)->type = SBL_TYPE_COUNT, MESH, "mesh 1", field, "9");
        BAD_SCENE(stream(i)->type = (sbl_type)1000, MESH, "mesh 1", field, "1000");
        for (type = 0; type < SBL_TYPE_COUNT; type++) {
            char value[16];
            snprintf(value, sizeof value, "is %d", type);
            if ((i == 4) != (type >= SBL_UINT8))
                BAD_SCENE(stream(i)->type = (sbl_type)type, MESH, "mesh 1", field, value);
        }
        snprintf(field, sizeof field, "%s.stride", names[i]);
        BAD_SCENE(stream(i)->stride = (size_t)(4 * components[i] - 1), MESH, "mesh 1", field, components[i] ==
                  1 ? "3" : "1");
        BAD_SCENE(stream(i)->stride = 1, MESH, "mesh 1", field, "1");
        /* strides, offsets and counts whose products overflow size_t */
        snprintf(field, sizeof field, "%s.", names[i]);
        BAD_SCENE(stream(i)->stride = SIZE_MAX, MESH, "mesh 1", field, "stride");
        BAD_SCENE(stream(i)->stride = SIZE_MAX / 2, MESH, "mesh 1", field, "stride");
        BAD_SCENE(stream(i)->stride = SIZE_MAX / 4 + 1, MESH, "mesh 1", field, "stride");
        BAD_SCENE(stream(i)->offset = SIZE_MAX, MESH, "mesh 1", field, "offset");
        BAD_SCENE(stream(i)->offset = SIZE_MAX - 8, MESH, "mesh 1", field, "offset");
        snprintf(field, sizeof field, "%s.gl_buffer", names[i]);
        BAD_SCENE(stream(i)->gl_buffer = 12345, MESH, "mesh 1", field, "(12345) are both set");  /* data is also set */
        BAD_SCENE((stream(i)->gl_buffer = 12345, stream(i)->data = NULL), MESH, "mesh 1", field, "12345");
    }
    /* SBL_UINT8_NORM is allowed only for colours and texture coordinates */
    BAD_SCENE(f.meshes[1].positions.type = SBL_UINT8_NORM, MESH, "mesh 1", "positions.type", "2");
    BAD_SCENE(f.meshes[1].normals.type = SBL_UINT8_NORM, MESH, "mesh 1", "normals.type", "2");
    usable("bad streams");
}

/* NaN, infinities and colours out of range are refused, and the message names the mesh and the vertex. */
TEST(vertices_that_are_no_numbers) {
    static const float values[3] = { NOT, INF, -INF };
    static const char *const words[3] = { "nan", "inf", "-inf" };
    int i, v;
    for (v = 0; v < 3; v++) {
        for (i = 0; i < 12; i++) {
            char vertex[32];
            snprintf(vertex, sizeof vertex, "vertex %d", i / 3);
            BAD_SCENE(f.positions[i] = values[v], MESH, "mesh 0: positions", vertex, words[v]);
            BAD_SCENE(f.normals[i] = values[v], MESH, "mesh 1: normals", vertex, words[v]);
        }
        for (i = 0; i < 8; i++) {
            char vertex[32];
            snprintf(vertex, sizeof vertex, "vertex %d", i / 2);
            BAD_SCENE(f.texcoords[i] = values[v], MESH, "mesh 1: texcoords", vertex, words[v]);
        }
        for (i = 0; i < 16; i++) {
            char vertex[32];
            snprintf(vertex, sizeof vertex, "vertex %d", i / 4);
            BAD_SCENE(f.colors[i] = values[v], MESH, "mesh 1: colors", vertex, words[v]);
        }
    }
    BAD_SCENE(f.colors[6] = -0.25f, MESH, "mesh 1: colors", "vertex 1", "-0.25");
    BAD_SCENE(f.colors[6] = 1.25f, MESH, "mesh 1: colors", "vertex 1", "1.25");
    BAD_SCENE(f.positions[3] = 1e30f, MESH, "mesh 0", "vertex 1", "1e+30");
    BAD_SCENE((identity(f.meshes[1].transform), f.meshes[1].transform[12] = 1e30f), MESH, "mesh 1", "vertex 0",
              "1e+30");
    usable("vertices that are no numbers");
}

/* Transforms that are singular, not finite or not affine are refused. */
TEST(mesh_transforms) {
    int i;
    for (i = 0; i < 16; i++) {
        char field[32];
        snprintf(field, sizeof field, "transform[%d]", i);
        BAD_SCENE((identity(f.meshes[1].transform), f.meshes[1].transform[i] = NOT), MESH, "mesh 1", field, "nan");
        BAD_SCENE((identity(f.meshes[1].transform), f.meshes[1].transform[i] = -INF), MESH, "mesh 1", field, "-inf");
    }
    BAD_SCENE((identity(f.meshes[1].transform), f.meshes[1].transform[5] = 0), MESH, "mesh 1", "transform", "singular");
    for (i = 3; i < 16; i += 4)
        BAD_SCENE((identity(f.meshes[1].transform), f.meshes[1].transform[i] += 0.5f), MESH, "mesh 1", "transform",
        i < 15 ? "0.5" : "1.5");
    usable("bad transforms");
}

/* Each invalid field of sbl_material is refused, and the message names the material. */
TEST(materials) {
    int i;
    for (i = 0; i < 3; i++) {
        char field[32];
        snprintf(field, sizeof field, "albedo[%d]", i);
        BAD_SCENE(f.materials[1].albedo[i] = NOT, MATERIAL, "material 1", field, "nan");
        BAD_SCENE(f.materials[1].albedo[i] = INF, MATERIAL, "material 1", field, "inf");
        BAD_SCENE(f.materials[1].albedo[i] = -0.5f, MATERIAL, "material 1", field, "-0.5");
        BAD_SCENE(f.materials[1].albedo[i] = 1.5f, MATERIAL, "material 1", field, "1.5");
        snprintf(field, sizeof field, "emission[%d]", i);
        BAD_SCENE(f.materials[1].emission[i] = NOT, MATERIAL, "material 1", field, "nan");
        BAD_SCENE(f.materials[1].emission[i] = INF, MATERIAL, "material 1", field, "inf");
        BAD_SCENE(f.materials[1].emission[i] = -4, MATERIAL, "material 1", field, "-4");
    }
    BAD_SCENE(f.materials[1].albedo_texture = -1, MATERIAL, "material 1", "albedo_texture", "-1");
    BAD_SCENE(f.materials[1].albedo_texture = 3, MATERIAL, "material 1", "albedo_texture is 3",
              "0 (no texture) or 1 to 2");
    BAD_SCENE((f.scene.textures = NULL, f.scene.texture_count = 0, f.materials[1].albedo_texture = 1), MATERIAL,
              "material 1", "albedo_texture is 1", "the scene has no textures");
    BAD_SCENE(f.materials[1].albedo_texture = INT_MAX, MATERIAL, "material 1", "albedo_texture", "2147483647");
    BAD_SCENE(f.materials[1].emission_texture = -1, MATERIAL, "material 1", "emission_texture", "-1");
    BAD_SCENE(f.materials[1].emission_texture = 3, MATERIAL, "material 1", "emission_texture", "3");
    BAD_SCENE(f.materials[1].flags = SBL_MATERIAL_FLAGS_ALL + 1, MATERIAL, "material 1", "flags", "0x20");
    for (i = 0; i < 5; i++) {
        static const char *const names[5] = { "ior", "metallic", "roughness", "transmission", "alpha_cutoff" };
        float *field = i == 0 ? &f.materials[1].ior : i == 1 ? &f.materials[1].metallic
            : i == 2 ? &f.materials[1].roughness : i == 3 ? &f.materials[1].transmission : &f.materials[1].alpha_cutoff;
        BAD_SCENE(*field = NOT, MATERIAL, "material 1", names[i], "nan");
        BAD_SCENE(*field = INF, MATERIAL, "material 1", names[i], "inf");
        BAD_SCENE(*field = -1, MATERIAL, "material 1", names[i], "-1");
        BAD_SCENE(*field = i ? 1.5f : 0.5f, MATERIAL, "material 1", names[i], i ? "1.5" : "0.5");
    }
    BAD_SCENE(f.materials[1].ior = 2e6f, MATERIAL, "material 1", "ior", "2e+06");
    BAD_SCENE(f.materials[1].metallic = 2, MATERIAL, "material 1", "metallic", "2");
    BAD_SCENE(f.materials[1].specular_texture = -1, MATERIAL, "material 1", "specular_texture", "-1");
    BAD_SCENE(f.materials[1].specular_texture = 3, MATERIAL, "material 1", "specular_texture", "3");
    BAD_SCENE(f.materials[1].transmission_texture = -1, MATERIAL, "material 1", "transmission_texture", "-1");
    BAD_SCENE(f.materials[1].transmission_texture = 3, MATERIAL, "material 1", "transmission_texture", "3");
    BAD_SCENE(f.materials[1].normal_texture = -1, MATERIAL, "material 1", "normal_texture", "-1");
    BAD_SCENE(f.materials[1].normal_texture = 3, MATERIAL, "material 1", "normal_texture", "3");
    BAD_SCENE(f.materials[1].normal_scale = NOT, MATERIAL, "material 1", "normal_scale", "nan");
    BAD_SCENE(f.materials[1].normal_scale = INF, MATERIAL, "material 1", "normal_scale", "inf");
    BAD_SCENE(f.materials[1].normal_scale = 2000, MATERIAL, "material 1", "normal_scale", "2000");
    BAD_SCENE(f.materials[1].normal_scale = -1001, MATERIAL, "material 1", "normal_scale", "-1001");
    BAD_SCENE(f.materials[1].flags = 0xffffffffu, MATERIAL, "material 1", "flags", "0xffffffff");
    usable("bad materials");
}

/* Each invalid field of sbl_texture and each invalid pixel is refused, and the message names the texture. */
TEST(textures) {
    int i;
    BAD_SCENE(f.textures[1].pixels = NULL, TEXTURE, "texture 2", "pixels", "0");
    BAD_SCENE(f.textures[1].gl_texture = 777, TEXTURE, "texture 2", "gl_texture", "(777) are both set");
    BAD_SCENE((f.textures[1].pixels = NULL, f.textures[1].gl_texture = 777), TEXTURE, "texture 2", "gl_texture", "777");
    BAD_SCENE(f.textures[1].format = (sbl_pixel_format)-1, TEXTURE, "texture 2", "format", "-1");
    BAD_SCENE(f.textures[1].format = SBL_PIXEL_FORMAT_COUNT, TEXTURE, "texture 2", "format", "3");
    BAD_SCENE(f.textures[1].wrap = (sbl_wrap)-1, TEXTURE, "texture 2", "wrap", "-1");
    BAD_SCENE(f.textures[1].wrap = SBL_WRAP_COUNT, TEXTURE, "texture 2", "wrap", "2");
    BAD_SCENE(f.textures[1].channels = -1, TEXTURE, "texture 2", "channels", "-1");
    BAD_SCENE(f.textures[1].channels = 5, TEXTURE, "texture 2", "channels", "5");
    BAD_SCENE(f.textures[1].width = 0, TEXTURE, "texture 2", "size", "0 x 2");
    BAD_SCENE(f.textures[1].width = -2, TEXTURE, "texture 2", "size", "-2 x 2");
    BAD_SCENE(f.textures[1].width = INT_MAX, TEXTURE, "texture 2", "size", "2147483647 x 2");
    BAD_SCENE(f.textures[1].height = 0, TEXTURE, "texture 2", "size", "2 x 0");
    BAD_SCENE(f.textures[1].height = INT_MIN, TEXTURE, "texture 2", "size", "2 x -2147483648");
    BAD_SCENE(f.textures[1].stride = 31, TEXTURE, "texture 2", "stride", "31");
    BAD_SCENE(f.textures[0].stride = 7, TEXTURE, "texture 1", "stride", "7");
    /* rows of this stride, times the height, exceed the address space */
    BAD_SCENE(f.textures[1].stride = SIZE_MAX, TEXTURE, "texture 2", "stride", NULL);
    BAD_SCENE(f.textures[1].stride = SIZE_MAX / 2 + 1, TEXTURE, "texture 2", "stride", NULL);
    for (i = 0; i < 16; i++) {
        char pixel[32];
        snprintf(pixel, sizeof pixel, "component %d of pixel %d %d", i % 4, i / 4 % 2, i / 8);
        BAD_SCENE(f.floats[i] = NOT, TEXTURE, "texture 2", pixel, "nan");
        BAD_SCENE(f.floats[i] = INF, TEXTURE, "texture 2", pixel, "inf");
        BAD_SCENE(f.floats[i] = -0.25f, TEXTURE, "texture 2", pixel, "-0.25");
    }
    usable("bad textures");
}

/* Each invalid field of sbl_light is refused. Light 0 of the fixture is a point light, light 1 a spot, and light 2
   directional. */
TEST(lights) {
    int i, k;
    BAD_SCENE(f.scene.light_count = -1, SCENE_DESC, "sbl_scene_desc", "light_count", "-1");
    BAD_SCENE(f.scene.light_count = INT_MIN, SCENE_DESC, "sbl_scene_desc", "light_count", "-2147483648");
    BAD_SCENE(f.scene.lights = NULL, SCENE_DESC, "sbl_scene_desc", "light_count is 3", "NULL");
    BAD_SCENE(f.lights[1].kind = (sbl_light_kind)-1, LIGHT, "light 1", "kind", "-1");
    BAD_SCENE(f.lights[1].kind = SBL_LIGHT_KIND_COUNT, LIGHT, "light 1", "kind", "3");
    BAD_SCENE(f.lights[1].kind = (sbl_light_kind)1000, LIGHT, "light 1", "kind", "1000");
    for (i = 0; i < 3; i++) {
        char light[32];
        snprintf(light, sizeof light, "light %d", i);
        for (k = 0; k < 3; k++) {
            char field[32];
            snprintf(field, sizeof field, "intensity[%d]", k);
            BAD_SCENE(f.lights[i].intensity[k] = -1, LIGHT, light, field, "-1");
            BAD_SCENE(f.lights[i].intensity[k] = NOT, LIGHT, light, field, "nan");
            BAD_SCENE(f.lights[i].intensity[k] = INF, LIGHT, light, field, "inf");
            if (i < 2) {
                snprintf(field, sizeof field, "position[%d]", k);
                BAD_SCENE(f.lights[i].position[k] = NOT, LIGHT, light, field, "nan");
                BAD_SCENE(f.lights[i].position[k] = -INF, LIGHT, light, field, "-inf");
            }
            if (i > 0) {
                snprintf(field, sizeof field, "direction[%d]", k);
                BAD_SCENE(f.lights[i].direction[k] = NOT, LIGHT, light, field, "nan");
                BAD_SCENE(f.lights[i].direction[k] = INF, LIGHT, light, field, "inf");
            }
        }
        if (i > 0) BAD_SCENE(f.lights[i].direction[1] = 0, LIGHT, light, "direction", "0 0 0");
        if (i < 2) {
            BAD_SCENE(f.lights[i].radius = -0.5f, LIGHT, light, "radius", "-0.5");
            BAD_SCENE(f.lights[i].radius = NOT, LIGHT, light, "radius", "nan");
            BAD_SCENE(f.lights[i].radius = INF, LIGHT, light, "radius", "inf");
        }
    }
    BAD_SCENE(f.lights[2].angle = -0.5f, LIGHT, "light 2", "angle", "-0.5");
    BAD_SCENE(f.lights[2].angle = 180.5f, LIGHT, "light 2", "angle", "180.5");
    BAD_SCENE(f.lights[2].angle = NOT, LIGHT, "light 2", "angle", "nan");
    BAD_SCENE(f.lights[1].cone = -0.5f, LIGHT, "light 1", "cone", "-0.5");
    BAD_SCENE(f.lights[1].cone = 180.5f, LIGHT, "light 1", "cone", "180.5");
    BAD_SCENE(f.lights[1].cone = NOT, LIGHT, "light 1", "cone", "nan");
    BAD_SCENE(f.lights[1].inner_cone = -0.5f, LIGHT, "light 1", "inner_cone", "-0.5");
    BAD_SCENE(f.lights[1].inner_cone = 90.5f, LIGHT, "light 1", "inner_cone", "90.5");  /* the default cone is 90 */
    BAD_SCENE((f.lights[1].cone = 30, f.lights[1].inner_cone = 31), LIGHT, "light 1", "inner_cone", "31");
    BAD_SCENE(f.lights[1].inner_cone = NOT, LIGHT, "light 1", "inner_cone", "nan");
    /* each mistake causes one message */
    fixture_reset();
    f.lights[0].radius = -1;
    f.lights[1].cone = 200;
    f.lights[1].intensity[2] = NOT;
    f.lights[2].angle = INF;
    watch_forget(&seen);
    CHECK(sbl_set_scene(context, &f.scene) == SBL_ERROR_INVALID_ARGUMENT && seen.errors == 4,
          "%d errors for four mistakes", seen.errors);
    usable("bad lights");
}

static void glows(const float direction[3], float radiance[3], void *user) {
    (void)user;
    radiance[0] = radiance[1] = radiance[2] = 1 + 0.5f * direction[1];
}

static void glows_wrongly(const float direction[3], float radiance[3], void *user) {
    (void)direction;
    radiance[0] = radiance[1] = 1;
    radiance[2] = *(const float *)user;
}

/* Each invalid field, pixel and callback of sbl_environment is refused. */
TEST(environments) {
    sbl_environment *e = &f.scene.environment;
    float wrong;
    int i, k;
    BAD_SCENE(e->picture.width = 0, LIGHT, "environment", "picture", "0 x 2");
    BAD_SCENE(e->picture.width = -2, LIGHT, "environment", "picture", "-2 x 2");
    BAD_SCENE(e->picture.height = 0, LIGHT, "environment", "picture", "2 x 0");
    BAD_SCENE(e->picture.height = INT_MIN, LIGHT, "environment", "picture", "2 x -2147483648");
    BAD_SCENE(e->picture.pixels = NULL, LIGHT, "environment", "picture", "NULL");
    BAD_SCENE((e->picture.pixels = NULL, e->picture.width = 0), LIGHT, "environment", "picture", "0 x 2");
    BAD_SCENE(e->picture.gl_texture = 777, LIGHT, "environment", "gl_texture", "777");
    BAD_SCENE((e->picture.gl_texture = 777, e->picture.pixels = NULL, e->picture.width = e->picture.height = 0), LIGHT,
              "environment", "gl_texture", "777");
    BAD_SCENE(e->radiance = glows, LIGHT, "environment", "pixels", "both set");
    BAD_SCENE(e->picture.format = (sbl_pixel_format)-1, LIGHT, "environment", "format", "-1");
    BAD_SCENE(e->picture.format = SBL_PIXEL_FORMAT_COUNT, LIGHT, "environment", "format", "3");
    BAD_SCENE(e->picture.channels = -1, LIGHT, "environment", "channels", "-1");
    BAD_SCENE(e->picture.channels = 5, LIGHT, "environment", "channels", "5");
    BAD_SCENE(e->picture.stride = 31, LIGHT, "environment", "stride", "31");
    BAD_SCENE(e->picture.stride = SIZE_MAX / 2 + 1, LIGHT, "environment", "stride", NULL);
    BAD_SCENE(e->scale = NOT, LIGHT, "environment", "scale", "nan");
    BAD_SCENE(e->scale = INF, LIGHT, "environment", "scale", "inf");
    BAD_SCENE(e->rotation = NOT, LIGHT, "environment", "rotation", "nan");
    BAD_SCENE(e->rotation = INF, LIGHT, "environment", "rotation", "inf");
    for (k = 0; k < 3; k++) {
        char field[32];
        snprintf(field, sizeof field, "up[%d]", k);
        BAD_SCENE(e->up[k] = NOT, LIGHT, "environment", field, "nan");
        BAD_SCENE(e->up[k] = -INF, LIGHT, "environment", field, "-inf");
    }
    for (i = 0; i < 16; i++) {
        char pixel[32];
        if (i % 4 == 3) continue;  /* the alpha of a sky is ignored */
        snprintf(pixel, sizeof pixel, "component %d of pixel %d %d", i % 4, i / 4 % 2, i / 8);
        /* The textures get another format, so that the changed float does not also belong to a texture. */
        BAD_SCENE((f.textures[1].format = SBL_PIXELS_LINEAR8, f.floats[i] = NOT), LIGHT, "environment", pixel, "nan");
        BAD_SCENE((f.textures[1].format = SBL_PIXELS_LINEAR8, f.floats[i] = INF), LIGHT, "environment", pixel, "inf");
        BAD_SCENE((f.textures[1].format = SBL_PIXELS_LINEAR8, f.floats[i] = -0.25f), LIGHT, "environment", pixel,
                  "-0.25");
    }
    for (i = 0; i < 3; i++) {
        static const char *const words[3] = { "nan", "inf", "-3" };
        wrong = i == 0 ? NOT : i == 1 ? INF : -3;
        BAD_SCENE((memset(&e->picture, 0, sizeof e->picture), e->radiance = glows_wrongly, e->user = &wrong), LIGHT,
                  "environment", "component 2", words[i]);
    }
    /* each mistake causes one message */
    fixture_reset();
    e->scale = NOT;
    e->rotation = NOT;
    e->up[2] = INF;
    e->picture.channels = 7;
    watch_forget(&seen);
    CHECK(sbl_set_scene(context, &f.scene) == SBL_ERROR_INVALID_ARGUMENT && seen.errors == 4,
          "%d errors for four mistakes", seen.errors);
    usable("bad environments");
}

/* Lights of intensity 0 and a black sky picture are valid, even with extreme directions, angles and rotations. The
   picture equals that without lights, to the bit. */
TEST(lights_without_light) {
    static small_picture without, with;
    static float black[4 * 4];
    sbl_scene_desc desc = scene_desc(&small);
    sbl_light unlit[3];
    int way;
    memset(unlit, 0, sizeof unlit);
    unlit[1].kind = SBL_LIGHT_SPOT;
    unlit[1].direction[0] = 1e-30f;
    unlit[1].cone = unlit[1].inner_cone = 180;
    unlit[2].kind = SBL_LIGHT_DIRECTIONAL;
    unlit[2].direction[2] = 1e30f;
    unlit[2].angle = 180;
    for (way = 0; way < 2; way++) {
        view = small_view();
        view.options.backend = way ? SBL_BACKEND_TRACE : SBL_BACKEND_RASTER;
        memset(&desc.environment, 0, sizeof desc.environment);
        desc.light_count = 0;
        REQUIRE(sbl_set_scene(context, &desc) == SBL_SUCCESS && small_render(context, &view, &without) == SBL_SUCCESS,
                "%s", watch_last(&seen));
        desc.lights = unlit;
        desc.light_count = 3;
        desc.environment.picture.pixels = black;
        desc.environment.picture.format = SBL_PIXELS_FLOAT;
        desc.environment.picture.width = desc.environment.picture.height = 2;
        desc.environment.rotation = -1000;
        watch_forget(&seen);
        REQUIRE(sbl_set_scene(context, &desc) == SBL_SUCCESS && seen.errors == 0, "dark lights are refused: %s",
                watch_last(&seen));
        REQUIRE(small_render(context, &view, &with) == SBL_SUCCESS, "dark lights are not rendered: %s",
                watch_last(&seen));
        CHECK(small_same(&with, &without), "%s: lights without light change the picture", way ? "traced" : "drawn");
    }
    known_picture();
    usable("lights without light");
}

/* Scenes that are too large are refused before any of their data is read. */
TEST(scenes_too_large) {
    fixture_reset();
    f.meshes[1].vertex_count = INT_MAX;
    f.meshes[1].normals.data = f.meshes[1].texcoords.data = f.meshes[1].colors.data = NULL;
    bad_scene(SBL_ERROR_UNSUPPORTED, SBL_LOG_ITEM_TOO_LARGE, "INT_MAX vertices", "2147483651", NULL, NULL);
    fixture_reset();
    f.meshes[0].index_count = f.meshes[1].index_count = INT_MAX / 3 * 3;
    bad_scene(SBL_ERROR_UNSUPPORTED, SBL_LOG_ITEM_TOO_LARGE, "INT_MAX indices, twice", "triangles", NULL, NULL);
    fixture_reset();
    f.textures[1].width = f.textures[1].height = 65536;
    bad_scene(SBL_ERROR_UNSUPPORTED, SBL_LOG_ITEM_TOO_LARGE, "a texture of 65536 x 65536", "texture 2", NULL, NULL);
    usable("scenes too large");
}

/* A scene with a mistake in every part causes one message for each. */
TEST(scene_all_at_once) {
    static const struct { sbl_log_item item; const char *where, *field; } mistakes[] = {
        { SBL_LOG_ITEM_INVALID_SCENE_DESC, "sbl_scene_desc", "sky[2]" },
        { SBL_LOG_ITEM_INVALID_SCENE_DESC, "sbl_scene_desc", "draw_max_radiance" },
        { SBL_LOG_ITEM_INVALID_MESH, "mesh 0", "positions.stride" },
        { SBL_LOG_ITEM_INVALID_MESH, "mesh 0", "material" }, { SBL_LOG_ITEM_INVALID_MESH, "mesh 0", "transform[3]" },
        { SBL_LOG_ITEM_INVALID_MESH, "mesh 1", "index_count" }, { SBL_LOG_ITEM_INVALID_MESH, "mesh 1", "colors.type" },
        { SBL_LOG_ITEM_INVALID_MATERIAL, "material 0", "albedo[0]" },
        { SBL_LOG_ITEM_INVALID_MATERIAL, "material 1", "flags" },
        { SBL_LOG_ITEM_INVALID_MATERIAL, "material 1", "alpha_cutoff" },
        { SBL_LOG_ITEM_INVALID_TEXTURE, "texture 1", "channels" },
        { SBL_LOG_ITEM_INVALID_TEXTURE, "texture 2", "size" }, { SBL_LOG_ITEM_INVALID_TEXTURE, "texture 2", "wrap" } };
    int i, count = (int)(sizeof mistakes / sizeof *mistakes);
    fixture_reset();
    f.scene.sky[2] = NOT;
    f.scene.draw_max_radiance = -1;
    f.meshes[0].positions.stride = 5;
    f.meshes[0].material = 9;
    identity(f.meshes[0].transform);
    f.meshes[0].transform[3] = INF;
    f.meshes[1].index_count = 5;
    f.meshes[1].colors.type = SBL_UINT32;
    f.materials[0].albedo[0] = 2;
    f.materials[1].flags = 0x100;
    f.materials[1].alpha_cutoff = 7;
    f.textures[0].channels = 8;
    f.textures[1].width = 0;
    f.textures[1].wrap = SBL_WRAP_COUNT;
    watch_forget(&seen);
    CHECK(sbl_set_scene(context, &f.scene) == SBL_ERROR_INVALID_ARGUMENT, "%d mistakes are accepted", count);
    for (i = 0; i < count; i++)
        CHECK(watch_said(&seen, SBL_LOG_ERROR, mistakes[i].item, mistakes[i].where, mistakes[i].field, NULL),
              "%s: no message mentions %s",
              mistakes[i].where, mistakes[i].field);
    CHECK(seen.errors == count, "%d errors for %d mistakes", seen.errors, count);
    /* the vertices of every mesh are checked, and the messages name each bad mesh */
    fixture_reset();
    f.meshes[0].positions.offset = 0;
    f.positions[1] = NOT;
    watch_forget(&seen);
    CHECK(sbl_set_scene(context, &f.scene) == SBL_ERROR_INVALID_ARGUMENT, "NaN in two meshes is accepted");
    CHECK(watch_said(&seen, SBL_LOG_ERROR, SBL_LOG_ITEM_INVALID_MESH, "mesh 0", "positions", "nan"),
          "no message mentions mesh 0");
    CHECK(watch_said(&seen, SBL_LOG_ERROR, SBL_LOG_ITEM_INVALID_MESH, "mesh 1", "positions", "nan"),
          "no message mentions mesh 1");
    usable("many mistakes");
}

/* Empty scenes and empty meshes are valid. */
TEST(empty_scenes_and_meshes) {
    sbl_scene_desc nothing;
    static small_picture picture;
    int i, way;
    float low[3] = { 9, 9, 9 }, high[3] = { 9, 9, 9 };
    memset(&nothing, 0, sizeof nothing);
    nothing.sky[1] = 0.5f;
    watch_forget(&seen);
    REQUIRE(sbl_set_scene(context, &nothing) == SBL_SUCCESS, "an empty scene is refused: %s", watch_last(&seen));
    CHECK(scene_bounds(context, low, high) && low[0] == 0 && low[2] == 0 && high[1] == 0, "its bounds are not 0");
    for (way = 0; way < 2; way++) {
        view = small_view();
        view.options.backend = way ? SBL_BACKEND_TRACE : SBL_BACKEND_RASTER;
        watch_forget(&seen);
        REQUIRE(small_render(context, &view, &picture) == SBL_SUCCESS, "an empty scene is not rendered: %s",
                watch_last(&seen));
        for (i = 0; i < 3 * SMALL_PIXELS; i++) if (picture.values[i] != nothing.sky[i % 3]) break;
        CHECK(i == 3 * SMALL_PIXELS, "float %d of the sky is %g", i, (double)picture.values[i % SMALL_FLOATS]);
        CHECK(watch_said(&seen, SBL_LOG_WARNING, SBL_LOG_ITEM_NOTHING_VISIBLE, NULL, NULL, NULL),
              "no warning that nothing is visible");
    }
    memset(&view, 0, sizeof view);
    view.options.mode = SBL_MODE_AMBIENT;
    view.width = view.height = 4;
    view.options.sensor_size = 4;
    CHECK(sbl_render_picture(context, &view) == SBL_SUCCESS, "the default camera fails in an empty scene: %s",
          watch_last(&seen));

    fixture_reset();  /* meshes without vertices, without triangles, and with indices but an index_count of 0 */
    memset(&f.meshes[1], 0, sizeof f.meshes[1]);
    CHECK(sbl_set_scene(context, &f.scene) == SBL_SUCCESS && sbl_query_stats(context).scene.triangles == 2,
          "an empty mesh is refused: %s", watch_last(&seen));
    fixture_reset();
    f.meshes[0].index_count = f.meshes[1].index_count = 0;
    CHECK(sbl_set_scene(context, &f.scene) == SBL_SUCCESS && sbl_query_stats(context).scene.triangles == 0,
          "meshes without triangles are refused: %s", watch_last(&seen));
    view = small_view();
    CHECK(sbl_render_picture(context, &view) == SBL_SUCCESS, "meshes without triangles are not rendered: %s",
          watch_last(&seen));
    view.options.backend = SBL_BACKEND_TRACE;
    CHECK(sbl_render_picture(context, &view) == SBL_SUCCESS, "meshes without triangles are not traced: %s",
          watch_last(&seen));
    known_picture();
    usable("empty scenes");
}

/* Degenerate triangles cause one warning per mesh and leave the picture unchanged, to the bit. */
TEST(degenerate_triangles) {
    static small_picture without, with;
    /* 2 valid triangles, then triangles with two or three equal indices, with collinear corners, and with equal
       positions */
    static const uint32_t spoiled[18] = { 0, 1, 2, 0, 0, 1, 0, 2, 3, 2, 2, 2, 0, 4, 5, 1, 6, 2 };
    static const float corners[21] = { -1, 0, -1, -1, 0, 1, 1, 0, 1, 1, 0, -1,  0, 0, 0, 1, 0, 1, 1, 0, 1 };
    float lamp[12] = { -1, 1, -1, -1, 1, 1, 1, 1, 1, 1, 1, -1 };
    test_scene good = { 0 }, bad = { 0 };
    sbl_scene_desc desc;
    int i, way;
    static const uint32_t quad[6] = { 0, 1, 2, 0, 2, 3 };
    for (i = 0; i < 2; i++) {
        test_scene *s = i ? &bad : &good;
        scene_mesh(s, scene_material(s, 0.5f, 0.5f, 0.5f), corners, NULL, NULL, 7, i ? spoiled : quad, i ? 18 : 6);
        scene_mesh(s, scene_lamp(s, 1, 2, 3), lamp, NULL, NULL, 4, quad, 6);
    }
    for (way = 0; way < 2; way++) {
        view = small_view();
        view.options.backend = way ? SBL_BACKEND_TRACE : SBL_BACKEND_RASTER;
        desc = scene_desc(&good);
        watch_forget(&seen);
        REQUIRE(sbl_set_scene(context, &desc) == SBL_SUCCESS && small_render(context, &view, &without) == SBL_SUCCESS,
                "%s", watch_last(&seen));
        CHECK(seen.warnings == 0, "an unjustified warning: %s", watch_last(&seen));
        desc = scene_desc(&bad);
        watch_forget(&seen);
        REQUIRE(sbl_set_scene(context, &desc) == SBL_SUCCESS, "degenerate triangles are an error: %s",
                watch_last(&seen));
        CHECK(seen.warnings == 1 && seen.errors == 0 &&
              watch_said(&seen, SBL_LOG_WARNING, SBL_LOG_ITEM_DEGENERATE_TRIANGLES, "4", NULL, NULL),
              "%d warnings, the last: %s",
              seen.warnings, watch_last(&seen));
        CHECK(sbl_query_stats(context).scene.triangles == 4, "%d triangles are left, expected 4",
              sbl_query_stats(context).scene.triangles);
        REQUIRE(small_render(context, &view, &with) == SBL_SUCCESS, "%s", watch_last(&seen));
        CHECK(small_same(&with, &without), "degenerate triangles change the picture");
    }
    scene_free(&good);
    scene_free(&bad);
    known_picture();
}

/* The brightest and the dimmest allowed lights give finite, positive pictures. */
TEST(extreme_light) {
    static const float lights[] = { 1e-45f, 1e-40f, 1e-37f, 1e-20f, 1e20f, 1e37f };
    int i, k, way;
    for (i = 0; i < (int)(sizeof lights / sizeof *lights); i++) for (way = 0; way < 2; way++) {
        test_scene s = { 0 };
        sbl_scene_desc desc;
        static small_picture picture;
        scene_floor(&s, scene_material(&s, 0.5f, 0.5f, 0.5f), 0, 2);
        scene_floor(&s, scene_lamp(&s, lights[i], lights[i], lights[i]), 1, 1);
        desc = scene_desc(&s);
        view = small_view();
        view.options.mode = SBL_MODE_DIRECT;
        view.options.backend = way ? SBL_BACKEND_TRACE : SBL_BACKEND_RASTER;
        CHECK(sbl_set_scene(context, &desc) == SBL_SUCCESS && small_render(context, &view, &picture) == SBL_SUCCESS,
              "light of %g fails", (double)lights[i]);
        for (k = 0; k < 3 * SMALL_PIXELS; k++)
            if (!(picture.values[k] >= 0 && picture.values[k] <= lights[i] * 1.01f)) break;
        CHECK(k == 3 * SMALL_PIXELS, "light of %g: float %d of the picture is %g", (double)lights[i], k,
              (double)picture.values[k]);
        scene_free(&s);
    }
    known_picture();
}

/* Light that is too bright for variances gives finite pictures and predictions. */
TEST(light_too_bright) {
    enum { SIDE = 16 };
    static float final[3 * SIDE * SIDE];
    test_scene s = { 0 };
    const int metal = scene_material(&s, 0.5f, 0.5f, 0.5f);
    sbl_picture_desc bright = scene_view(SIDE, SIDE, 60, 0, 1, 3.5f, 0, 1, 0);
    sbl_stats stats;
    int k;
    s.materials[metal].metallic = 1;
    s.materials[metal].roughness = 0.4f;
    scene_box(&s, metal, -1, 0, -1, 1, 2, 1);
    s.mesh_count--;  /* the box is open towards the camera */
    scene_floor(&s, scene_lamp(&s, 1e24f, 1e24f, 1e24f), 1.9f, 0.3f);
    bright.options.mode = SBL_MODE_GI;
    CHECK(scene_render(context, &s, &bright) && sbl_read_channel(context, SBL_CHANNEL_FINAL, final, 3 * SIDE * SIDE) ==
          SBL_SUCCESS, "no picture: %s", watch_last(&seen));
    stats = sbl_query_stats(context);
    CHECK(isfinite(stats.picture.expected_error) && isfinite(stats.picture.radiance_error) &&
          isfinite(stats.picture.specular_error) && isfinite(stats.picture.stored_error), "errors: %g, %g, %g, %g",
          (double)stats.picture.expected_error, (double)stats.picture.radiance_error,
          (double)stats.picture.specular_error, (double)stats.picture.stored_error);
    for (k = 0; k < 3 * SIDE * SIDE; k++) if (!isfinite(final[k])) break;
    CHECK(k == 3 * SIDE * SIDE, "float %d of the picture is %g", k, (double)final[k]);
    known_picture();
    scene_free(&s);
}

/* Light whose sums or variances overflow becomes NaN in no channel. */
TEST(sums_of_light_that_overflow) {
    enum { SIDE = 16 };
    static float values[3 * SIDE * SIDE];
    int way, channel, k;
    for (way = 0; way < 2; way++) {  /* emission in a metal box; a light in a matte box */
        test_scene s = { 0 };
        const int walls = scene_material(&s, 0.9f, 0, 0.5f);
        sbl_picture_desc bright = scene_view(SIDE, SIDE, 50, 0, 0, 3, 0, 0, 0);
        scene_box(&s, walls, -1, -1, -1, 1, 1, 1);
        s.mesh_count--;  /* the box is open towards the camera */
        s.materials[walls].metallic = way ? 0.0f : 1.0f;
        s.materials[walls].roughness = 0.3f;
        if (way) scene_light(&s, SBL_LIGHT_POINT, 1e36f, 0, 1e36f)->position[1] = 0.01f;
        else scene_floor(&s, scene_lamp(&s, 1e37f, 1e37f, 1e37f), 0.9f, 0.4f);
        bright.options.mode = SBL_MODE_GI;
        bright.options.preset = SBL_PRESET_DRAFT;
        bright.target_error = 0.5f;
        CHECK(scene_render(context, &s, &bright), "no picture: %s", watch_last(&seen));
        for (channel = 0; channel < SBL_CHANNEL_COUNT; channel++) {
            const int count = SIDE * SIDE * sbl_channel_components((sbl_channel)channel);
            CHECK(sbl_read_channel(context, (sbl_channel)channel, values, (size_t)count) == SBL_SUCCESS, "channel %d",
                  channel);
            for (k = 0; k < count && !isnan(values[k]); k++) {}
            CHECK(k == count, "%s: float %d of channel %d is NaN", way ? "light" : "emission", k, channel);
        }
        scene_free(&s);
    }
    known_picture();
}

/* >>invalid sbl_picture_desc fields */

static void bad_picture(const sbl_picture_desc *desc, sbl_result wanted, sbl_log_item item, const char *mistake,
                        const char *field, const char *value) {
    static small_picture picture;
    watch_forget(&seen);
    refused(sbl_begin_picture(context, desc), wanted, item, mistake, "sbl_picture_desc", field, value);
    CHECK(small_read(context, &picture) == SBL_SUCCESS && small_same(&picture, &expected),
          "%s: the finished picture is gone", mistake);
    CHECK(seen.blocks == blocks, "%s: %d blocks leaked", mistake, seen.blocks - blocks);
}

#define BAD_PICTURE(change, field, value) do {                                                                 \
        sbl_picture_desc d = small_view();                                                                     \
        change;                                                                                                \
        bad_picture(&d, SBL_ERROR_INVALID_ARGUMENT, SBL_LOG_ITEM_INVALID_PICTURE_DESC, #change, field, value); \
    } while (0)

/* Each invalid field of sbl_picture_desc is refused, and the finished picture remains readable. */
TEST(picture_desc) {
    int i;
    BAD_PICTURE(d.start_canary = 0xabc, "start_canary", "abc");
    BAD_PICTURE(d.end_canary = 0xabc, "end_canary", "abc");
    BAD_PICTURE(d.max_bounce_cells = 1023, "max_bounce_cells", "1023");
    BAD_PICTURE(d.max_bounce_cells = -2, "max_bounce_cells", "-2");
    BAD_PICTURE(d.width = 0, "width", "0");
    BAD_PICTURE(d.width = -1, "width", "-1");
    BAD_PICTURE(d.width = 16385, "width", "16385");
    BAD_PICTURE(d.width = INT_MIN, "width", "-2147483648");
    BAD_PICTURE(d.height = 0, "height is 0; it must be 1 to 16384", "both width and height 0 for the default");
    BAD_PICTURE(d.height = -1, "height", "-1");
    BAD_PICTURE(d.height = INT_MAX, "height", "2147483647");
    BAD_PICTURE(d.options.mode = (sbl_mode)-1, "options.mode", "-1");
    BAD_PICTURE(d.options.mode = SBL_MODE_COUNT, "options.mode", "5");
    BAD_PICTURE(d.options.preset = (sbl_preset)-1, "options.preset", "-1");
    BAD_PICTURE(d.options.preset = SBL_PRESET_COUNT, "options.preset", "3");
    BAD_PICTURE(d.sensor_kind = (sbl_sensor_kind)-1, "sensor_kind", "-1");
    BAD_PICTURE(d.sensor_kind = SBL_SENSOR_KIND_COUNT, "sensor_kind", "3");
    BAD_PICTURE((d.options.mode = SBL_MODE_PAPER, d.sensor_kind = SBL_SENSOR_HEMICUBE), "sensor_kind", "HEMICUBE");
    BAD_PICTURE(d.options.backend = (sbl_backend)-1, "options.backend", "-1");
    BAD_PICTURE(d.options.backend = SBL_BACKEND_COUNT, "options.backend", "3");
    BAD_PICTURE((d.options.backend = SBL_BACKEND_TRACE, d.options.mode = SBL_MODE_PAPER),
                "options.backend is SBL_BACKEND_TRACE", "SBL_MODE_PAPER");
    BAD_PICTURE((d.options.backend = SBL_BACKEND_TRACE, d.sensor_kind = SBL_SENSOR_SINGLE),
                "options.backend is SBL_BACKEND_TRACE", "SBL_SENSOR_SINGLE");
    BAD_PICTURE(d.options.rays = -1, "options.rays", "-1");
    BAD_PICTURE(d.options.rays = 4097, "options.rays", "4097");
    BAD_PICTURE(d.options.sensor_size = -1, "options.sensor_size", "-1");
    BAD_PICTURE(d.options.sensor_size = 3, "options.sensor_size", "3");
    BAD_PICTURE(d.options.sensor_size = 513, "options.sensor_size", "513");
    BAD_PICTURE(d.sensor_fov = NOT, "sensor_fov", "nan");
    BAD_PICTURE(d.sensor_fov = INF, "sensor_fov", "inf");
    BAD_PICTURE(d.sensor_fov = 0.5f, "sensor_fov", "0.5");
    BAD_PICTURE(d.sensor_fov = 179.5f, "sensor_fov", "179.5");
    BAD_PICTURE(d.sensor_fov = -90, "sensor_fov", "-90");
    BAD_PICTURE(d.tile = -1, "tile", "-1");
    BAD_PICTURE(d.tile = 1025, "tile", "1025");
    BAD_PICTURE(d.target_error = -0.25f, "target_error", "-0.25");
    BAD_PICTURE(d.target_error = 1.5f, "target_error", "1.5");
    BAD_PICTURE(d.target_error = NOT, "target_error", "nan");
    BAD_PICTURE(d.threshold = NOT, "threshold", "nan");
    BAD_PICTURE(d.threshold = INF, "threshold", "inf");
    BAD_PICTURE(d.options.epsilon = NOT, "options.epsilon", "nan");
    BAD_PICTURE(d.options.epsilon = INF, "options.epsilon", "inf");
    BAD_PICTURE(d.options.ray_length = NOT, "options.ray_length", "nan");
    BAD_PICTURE(d.options.ray_length = -2, "options.ray_length", "-2");
    BAD_PICTURE(d.facet_limit = NOT, "facet_limit", "nan");
    BAD_PICTURE(d.facet_limit = INF, "facet_limit", "inf");
    BAD_PICTURE(d.filter_radius = 33, "filter_radius", "33");
    BAD_PICTURE(d.filter_radius = INT_MAX, "filter_radius", "2147483647");
    BAD_PICTURE(d.samples = -1, "samples", "-1");
    BAD_PICTURE(d.samples = 65, "samples", "65");
    for (i = 0; i < 16; i++) {
        char field[32];
        snprintf(field, sizeof field, "world_to_view[%d]", i);
        BAD_PICTURE(d.world_to_view[i] = NOT, field, "nan");
        BAD_PICTURE(d.world_to_view[i] = INF, field, "inf");
        snprintf(field, sizeof field, "view_to_clip[%d]", i);
        BAD_PICTURE(d.view_to_clip[i] = NOT, field, "nan");
        BAD_PICTURE(d.view_to_clip[i] = -INF, field, "-inf");
    }
    for (i = 0; i < 3; i++)
        BAD_PICTURE((identity(d.world_to_view), d.world_to_view[5 * i] = 1.1f), "world_to_view", "rigid");
    for (i = 3; i < 16; i += 4)
        BAD_PICTURE((identity(d.world_to_view), d.world_to_view[i] += 0.5f), "world_to_view", "rigid");
    BAD_PICTURE((identity(d.world_to_view), d.world_to_view[0] = -1), "world_to_view", "rigid");  /* mirrored */
    BAD_PICTURE((identity(d.world_to_view), d.world_to_view[4] = 0.5f), "world_to_view", "rigid");  /* sheared */
    BAD_PICTURE(d.view_to_clip[11] = 1, "view_to_clip", "1");    /* looks along +z */
    BAD_PICTURE(d.view_to_clip[0] = 0, "view_to_clip", NULL);
    BAD_PICTURE(d.view_to_clip[5] = 0, "view_to_clip", NULL);
    BAD_PICTURE(d.view_to_clip[15] = 1, "view_to_clip", NULL);   /* neither perspective nor orthographic */
    BAD_PICTURE(d.view_to_clip[3] = 0.5f, "view_to_clip", "0.5");
    BAD_PICTURE(d.view_to_clip[4] = 0.5f, "view_to_clip", NULL);
    for (i = 12; i < 14; i++) BAD_PICTURE(d.view_to_clip[i] = 0.5f, "view_to_clip", NULL);
    for (i = 8; i < 10; i++)  /* orthographic, but sheared */
        BAD_PICTURE((identity(d.view_to_clip), d.view_to_clip[i] = 0.5f), "view_to_clip", NULL);
    usable("bad picture descriptors");
}

/* Many invalid fields of sbl_picture_desc cause one message each. */
TEST(picture_desc_all_at_once) {
    static const char *const fields[] = { "width", "height", "mode", "preset", "sensor_kind", "backend", "rays",
        "sensor_size", "sensor_fov", "tile", "threshold", "epsilon", "facet_limit", "filter_radius", "samples",
                                          "world_to_view[2]", "world_to_view[9]", "view_to_clip[7]" };
    int i, count = (int)(sizeof fields / sizeof *fields);
    sbl_picture_desc d = small_view();
    d.width = d.height = -5;
    d.options.mode = SBL_MODE_COUNT;
    d.options.preset = SBL_PRESET_COUNT;
    d.sensor_kind = SBL_SENSOR_KIND_COUNT;
    d.options.backend = SBL_BACKEND_COUNT;
    d.options.rays = d.options.sensor_size = d.tile = d.samples = -1;
    d.sensor_fov = d.threshold = d.options.epsilon = d.facet_limit = NOT;
    d.filter_radius = 99;
    d.world_to_view[2] = d.world_to_view[9] = d.view_to_clip[7] = INF;
    watch_forget(&seen);
    CHECK(sbl_render_picture(context, &d) == SBL_ERROR_INVALID_ARGUMENT, "%d mistakes are accepted", count);
    for (i = 0; i < count; i++)
        CHECK(watch_said(&seen, SBL_LOG_ERROR, SBL_LOG_ITEM_INVALID_PICTURE_DESC, "sbl_picture_desc", fields[i], NULL),
              "no message mentions %s", fields[i]);
    CHECK(seen.errors == count, "%d errors for %d mistakes", seen.errors, count);
    usable("many mistakes");
}

/* Both ends of every range of sbl_picture_desc are accepted. */
TEST(picture_desc_ends_of_ranges) {
    sbl_picture_desc d = small_view();
    d.width = d.height = 1;
    d.options.sensor_size = 4;
    d.sensor_kind = SBL_SENSOR_SINGLE;
    d.sensor_fov = 179;
    d.tile = 1024;
    d.filter_radius = 32;
    d.samples = 64;
    d.threshold = 1e-30f;
    d.options.seed = 0xffffffffu;
    CHECK(sbl_render_picture(context, &d) == SBL_SUCCESS, "%s", watch_last(&seen));
    d.width = 3;
    d.height = 1;
    d.sensor_fov = 1;
    d.options.sensor_size = 512;
    d.tile = 1;
    d.filter_radius = INT_MIN;
    d.samples = 1;
    d.threshold = 3e38f;
    CHECK(sbl_render_picture(context, &d) == SBL_SUCCESS, "%s", watch_last(&seen));
    d.options.backend = SBL_BACKEND_TRACE;
    d.sensor_kind = SBL_SENSOR_DEFAULT;
    d.options.rays = 4096;
    CHECK(sbl_render_picture(context, &d) == SBL_SUCCESS, "%s", watch_last(&seen));
    d.options.rays = 1;
    CHECK(sbl_render_picture(context, &d) == SBL_SUCCESS, "%s", watch_last(&seen));
    usable("the ends of ranges");
}

/* SBL_BACKEND_TRACE is refused if the scene has a draw callback. */
TEST(rays_with_a_draw_callback) {
    sbl_scene_desc desc = scene_desc(&small);
    desc.draw = draws_nothing;
    REQUIRE(sbl_set_scene(context, &desc) == SBL_SUCCESS, "%s", watch_last(&seen));
    view = small_view();
    view.options.backend = SBL_BACKEND_TRACE;
    watch_forget(&seen);
    refused(sbl_begin_picture(context, &view), SBL_ERROR_INVALID_ARGUMENT, SBL_LOG_ITEM_INVALID_PICTURE_DESC,
            "rays with a draw callback", "sbl_picture_desc", "options.backend is SBL_BACKEND_TRACE", "draw callback");
    known_picture();
}

/* Both ends of the range of max_bounce_cells are accepted, and 0 selects the default. */
TEST(max_bounce_cells_ends_of_range) {
    static const int samples[] = { 0, 1024, 1048576 };
    int i;
    for (i = 0; i < 3; i++) {
        sbl_scene_desc desc = scene_desc(&small);
        sbl_picture_desc d = small_view();
        sbl_stats stats;
        desc.max_bounce_cells = samples[i];
        d.options.mode = i ? SBL_MODE_GI : SBL_MODE_DEFAULT;
        watch_forget(&seen);
        if (samples[i] > 2000) {  /* only begins the work, because completing it takes long */
            CHECK(sbl_set_scene(context, &desc) == SBL_SUCCESS && sbl_begin_picture(context, &d) == SBL_SUCCESS &&
                      sbl_step(context, 1e-3) == SBL_UNFINISHED,
                  "max_bounce_cells of %d: %s", samples[i], watch_last(&seen));
            continue;
        }
        REQUIRE(sbl_set_scene(context, &desc) == SBL_SUCCESS && sbl_render_picture(context, &d) == SBL_SUCCESS,
                "max_bounce_cells of %d: %s", samples[i], watch_last(&seen));
        stats = sbl_query_stats(context);
        CHECK(stats.mode == SBL_MODE_GI && stats.store.cells > 100 && stats.store.cells <= (i ? samples[i] : 49152),
              "store.cells of %d gives %d", samples[i], stats.store.cells);
        CHECK(stats.seconds.bounce > 0 && stats.seconds.bounce < stats.seconds.total, "the store takes %g s of %g",
              stats.seconds.bounce, stats.seconds.total);
    }
    sbl_end(context);
    known_picture();
    usable("max_bounce_cells");
}

/* >>calls with wrong arguments or in the wrong order */

#define SAID(call, wanted, item, a, b) \
    do { watch_forget(&seen); refused(call, wanted, SBL_LOG_ITEM_##item, #call, a, b, NULL); } while (0)

/* NULL for any parameter is refused, and no function crashes without a context. */
TEST(null_parameters) {
    float three[3], matrix[16];
    sbl_sensor sensor;
    sbl_context *out;
    sbl_context_desc desc = watch_desc(&seen);
    sbl_scene_desc scene = scene_desc(&small);
    view = small_view();
    identity(matrix);
    SAID(sbl_create(&desc, NULL), SBL_ERROR_INVALID_ARGUMENT, INVALID_ARGUMENT, "sbl_create", "out");
    SAID(sbl_set_scene(context, NULL), SBL_ERROR_INVALID_ARGUMENT, INVALID_ARGUMENT, "sbl_set_scene", "desc");
    SAID(sbl_set_mesh_transform(context, 0, NULL), SBL_ERROR_INVALID_ARGUMENT, INVALID_ARGUMENT,
         "sbl_set_mesh_transform", "transform");
    SAID(sbl_set_mesh_transform(context, -1, matrix), SBL_ERROR_INVALID_ARGUMENT, INVALID_ARGUMENT,
         "sbl_set_mesh_transform", "mesh is -1");
    SAID(sbl_set_mesh_transform(context, 8, matrix), SBL_ERROR_INVALID_ARGUMENT, INVALID_ARGUMENT,
         "sbl_set_mesh_transform", "mesh is 8");
    SAID(sbl_read_channel(context, SBL_CHANNEL_FINAL, NULL, 1000000), SBL_ERROR_INVALID_ARGUMENT, INVALID_ARGUMENT,
         "sbl_read_channel", "out is NULL; it receives the channel");
    SAID(sbl_inspect_sensor(context, 1, 1, NULL, NULL, NULL, 0), SBL_ERROR_INVALID_ARGUMENT, INVALID_ARGUMENT,
         "sbl_inspect_sensor", "sensor");
    SAID(sbl_save_store(context, NULL, NULL), SBL_ERROR_INVALID_ARGUMENT, INVALID_ARGUMENT, "sbl_save_store", "put");
    SAID(sbl_load_store(context, NULL, NULL), SBL_ERROR_INVALID_ARGUMENT, INVALID_ARGUMENT, "sbl_load_store", "get");

    CHECK(sbl_set_scene(NULL, &scene) == SBL_ERROR_INVALID_ARGUMENT, "sbl_set_scene without context");
    CHECK(sbl_set_mesh_transform(NULL, 0, matrix) == SBL_ERROR_INVALID_ARGUMENT,
          "sbl_set_mesh_transform without context");
    CHECK(sbl_render_picture(NULL, &view) == SBL_ERROR_INVALID_ARGUMENT, "sbl_render without context");
    CHECK(sbl_begin_picture(NULL, &view) == SBL_ERROR_INVALID_ARGUMENT, "sbl_begin without context");
    CHECK(sbl_step(NULL, 0) == SBL_ERROR_INVALID_ARGUMENT, "sbl_step without context");
    CHECK(sbl_read_channel(NULL, SBL_CHANNEL_FINAL, three, 3) == SBL_ERROR_INVALID_ARGUMENT,
          "sbl_read_channel without context");
    CHECK(sbl_inspect_sensor(NULL, 0, 0, &sensor, NULL, NULL, 0) == SBL_ERROR_INVALID_ARGUMENT,
          "sbl_inspect_sensor without context");
    CHECK(sbl_channel_texture(NULL, SBL_CHANNEL_FINAL) == 0, "sbl_channel_texture without context");
    CHECK(sbl_progress(NULL) == 0, "sbl_progress without context");
    sbl_end(NULL);
    sbl_destroy(NULL);

    /* a NULL descriptor selects all defaults; the default logger writes one line to stderr */
    CHECK(sbl_create(NULL, &out) == SBL_SUCCESS, "sbl_create without a descriptor");
    CHECK(sbl_begin_picture(out, NULL) == SBL_ERROR_STATE, "sbl_begin without a scene");
    sbl_destroy(out);
    usable("NULL parameters");
}

/* Enumeration values out of range are refused, or result in empty strings and zeros. */
TEST(values_that_do_not_exist) {
    float some[3];
    small_picture picture;
    SAID(sbl_read_channel(context, (sbl_channel)-1, some, 3), SBL_ERROR_INVALID_ARGUMENT, INVALID_ARGUMENT,
         "sbl_read_channel", "channel is -1");
    SAID(sbl_read_channel(context, SBL_CHANNEL_COUNT, picture.values, SMALL_FLOATS), SBL_ERROR_INVALID_ARGUMENT,
         INVALID_ARGUMENT,
        "sbl_read_channel", "channel is 29");
    CHECK(sbl_channel_texture(context, (sbl_channel)-1) == 0 && sbl_channel_texture(context, SBL_CHANNEL_COUNT) == 0,
          "textures of channels that do not exist");
    CHECK(sbl_channel_components((sbl_channel)-1) == 0 && sbl_channel_components(SBL_CHANNEL_COUNT) == 0,
          "components of channels that do not exist");
    CHECK(sbl_result_string((sbl_result)-1) && sbl_result_string(SBL_RESULT_COUNT) &&
          *sbl_result_string((sbl_result)99), "results that do not exist");
    CHECK(sbl_log_item_string((sbl_log_item)-1) && sbl_log_item_string(SBL_LOG_ITEM_COUNT),
          "log items that do not exist");
    usable("values that do not exist");
}

/* sbl_look_at and sbl_perspective return 0 for impossible input and do not write their output. */
TEST(helpers_out_of_range) {
    float m[16], before[16];
    int i;
    for (i = 0; i < 16; i++) m[i] = before[i] = (float)i;
    CHECK(!sbl_look_at(m, 1, 1, 1, 1, 1, 1, 0, 1, 0), "sbl_look_at at the eye itself");
    CHECK(!sbl_look_at(m, 0, 0, 0, 0, 1, 0, 0, 2, 0), "sbl_look_at along up");
    CHECK(!sbl_look_at(m, 0, 0, 0, 0, 0, 1, 0, 0, 0), "sbl_look_at without up");
    CHECK(!sbl_look_at(m, NOT, 0, 0, 0, 0, 1, 0, 1, 0), "sbl_look_at from nan");
    CHECK(!sbl_look_at(m, 0, 0, 0, INF, 0, 1, 0, 1, 0), "sbl_look_at at inf");
    CHECK(!sbl_look_at(m, 3e38f, 3e38f, 3e38f, -3e38f, -3e38f, 3e38f, 0, 1, 0),
          "sbl_look_at from beyond the range of float");
    CHECK(!sbl_perspective(m, 1e-42f, 1) && !sbl_perspective(m, 40, 1e-42f),
          "sbl_perspective: angles below the range of float");
    CHECK(!sbl_perspective(m, 0, 1) && !sbl_perspective(m, 180, 1) && !sbl_perspective(m, -10, 1) &&
          !sbl_perspective(m, NOT, 1), "sbl_perspective: fov_y");
    CHECK(!sbl_perspective(m, 40, 0) && !sbl_perspective(m, 40, -1) && !sbl_perspective(m, 40, NOT) &&
          !sbl_perspective(m, 40, INF), "sbl_perspective: aspect");
    CHECK(memcmp(m, before, sizeof m) == 0, "a helper failed, but wrote to its output");
}

static void little_room(sbl_backend backend) {
    static float floats[SMALL_FLOATS], radiance[4 * 64 * 64], weights[64 * 64];
    sbl_sensor sensor;
    int channel, i;
    size_t texels;
    view = small_view();
    view.options.backend = backend;
    REQUIRE(sbl_render_picture(context, &view) == SBL_SUCCESS, "%s", watch_last(&seen));
    for (channel = 0; channel < SBL_CHANNEL_COUNT; channel++) {
        size_t needed = (size_t)(SMALL_PIXELS * sbl_channel_components((sbl_channel)channel));
        for (i = 0; i < SMALL_FLOATS; i++) floats[i] = 7;
        SAID(sbl_read_channel(context, (sbl_channel)channel, floats, needed - 1), SBL_ERROR_INVALID_ARGUMENT,
             INVALID_ARGUMENT, "sbl_read_channel", "count");
        SAID(sbl_read_channel(context, (sbl_channel)channel, floats, 0), SBL_ERROR_INVALID_ARGUMENT, INVALID_ARGUMENT,
             "count is 0", NULL);
        for (i = 0; i < SMALL_FLOATS && floats[i] == 7; i++) {}
        CHECK(i == SMALL_FLOATS, "channel %d: float %d was written, but the array is too small", channel, i);
        CHECK(sbl_read_channel(context, (sbl_channel)channel, floats, needed) == SBL_SUCCESS,
              "channel %d: exactly enough room is refused", channel);
        for (i = (int)needed; i < SMALL_FLOATS && floats[i] == 7; i++) {}
        CHECK(i == SMALL_FLOATS, "channel %d: float %d was written past the end", channel, i);
    }
    REQUIRE(sbl_inspect_sensor(context, SMALL_WIDTH / 2, SMALL_HEIGHT - 1, &sensor, NULL, NULL, 0) == SBL_SUCCESS,
            "sbl_inspect_sensor: %s", watch_last(&seen));
    texels = (size_t)(sensor.sheet_width * sensor.sheet_height);
    REQUIRE(texels > 1 && texels <= 64 * 64, "a sheet of %d x %d", sensor.sheet_width, sensor.sheet_height);
    for (i = 0; i < 64 * 64; i++) weights[i] = radiance[4 * i] = 7;
    SAID(sbl_inspect_sensor(context, SMALL_WIDTH / 2, SMALL_HEIGHT - 1, &sensor, radiance, NULL, texels - 1),
         SBL_ERROR_INVALID_ARGUMENT,
        INVALID_ARGUMENT, "sbl_inspect_sensor", "count");
    SAID(sbl_inspect_sensor(context, SMALL_WIDTH / 2, SMALL_HEIGHT - 1, &sensor, NULL, weights, texels - 1),
         SBL_ERROR_INVALID_ARGUMENT,
        INVALID_ARGUMENT, "sbl_inspect_sensor", "count");
    SAID(sbl_inspect_sensor(context, -1, 0, &sensor, NULL, NULL, 0), SBL_ERROR_INVALID_ARGUMENT, INVALID_ARGUMENT,
         "sbl_inspect_sensor", "-1 0");
    SAID(sbl_inspect_sensor(context, 0, -1, &sensor, NULL, NULL, 0), SBL_ERROR_INVALID_ARGUMENT, INVALID_ARGUMENT,
         "sbl_inspect_sensor", "0 -1");
    SAID(sbl_inspect_sensor(context, SMALL_WIDTH, 0, &sensor, NULL, NULL, 0), SBL_ERROR_INVALID_ARGUMENT,
         INVALID_ARGUMENT, "sbl_inspect_sensor", "11 0");
    SAID(sbl_inspect_sensor(context, 0, INT_MAX, &sensor, NULL, NULL, 0), SBL_ERROR_INVALID_ARGUMENT, INVALID_ARGUMENT,
         "sbl_inspect_sensor", "2147483647");
    SAID(sbl_inspect_sensor(context, 0, 0, &sensor, NULL, NULL, 0), SBL_ERROR_INVALID_ARGUMENT, INVALID_ARGUMENT,
         "sbl_inspect_sensor", "no surface");
    for (i = 0; i < 64 * 64 && weights[i] == 7 && radiance[4 * i] == 7; i++) {}
    CHECK(i == 64 * 64, "texel %d was written, but the array is too small", i);
    CHECK(sbl_inspect_sensor(context, SMALL_WIDTH / 2, SMALL_HEIGHT - 1, &sensor, radiance, weights, texels) ==
          SBL_SUCCESS,
          "exactly enough room is refused: %s", watch_last(&seen));
    for (i = (int)texels; i < 64 * 64 && weights[i] == 7; i++) {}
    CHECK(i == 64 * 64, "weight %d was written past the end", i);
    usable("too little room");
}

/* Arrays that are one element too small are refused and not written; arrays of the exact size are accepted. */
TEST(too_little_room) {
    little_room(SBL_BACKEND_RASTER);
    little_room(SBL_BACKEND_TRACE);
}

/* Every function that is called too early or too late returns SBL_ERROR_STATE. */
TEST(wrong_order) {
    sbl_context_desc desc = watch_desc(&seen);
    sbl_scene_desc scene = scene_desc(&small);
    sbl_context *fresh;
    sbl_sensor sensor;
    float three[3], matrix[16];
    static float floats[SMALL_FLOATS];
    int before = seen.blocks;
    identity(matrix);
    view = small_view();
    REQUIRE(sbl_create(&desc, &fresh) == SBL_SUCCESS, "%s", watch_last(&seen));
#define NOT_YET(call, function) SAID(call, SBL_ERROR_STATE, WRONG_ORDER, function, NULL)
    NOT_YET(sbl_set_mesh_transform(fresh, 0, matrix), "sbl_set_mesh_transform");
    CHECK(has_no_bounds(fresh), "bounds without a scene");
    NOT_YET(sbl_begin_picture(fresh, &view), "sbl_begin_picture");
    NOT_YET(sbl_begin_picture(fresh, NULL), "sbl_begin");
    NOT_YET(sbl_render_picture(fresh, &view), "sbl_begin");
    NOT_YET(sbl_step(fresh, 0), "sbl_step");
    NOT_YET(sbl_read_channel(fresh, SBL_CHANNEL_FINAL, floats, SMALL_FLOATS), "sbl_read_channel");
    NOT_YET(sbl_inspect_sensor(fresh, 0, 0, &sensor, NULL, NULL, 0), "sbl_inspect_sensor");
    CHECK(sbl_channel_texture(fresh, SBL_CHANNEL_FINAL) == 0 && sbl_progress(fresh) == 0,
          "there is a texture or progress before any picture was begun");
    sbl_end(fresh);
    REQUIRE(sbl_set_scene(fresh, &scene) == SBL_SUCCESS, "%s", watch_last(&seen));
    NOT_YET(sbl_step(fresh, 0), "sbl_step");
    NOT_YET(sbl_read_channel(fresh, SBL_CHANNEL_ID, floats, SMALL_FLOATS), "sbl_read_channel");
    REQUIRE(sbl_begin_picture(fresh, &view) == SBL_SUCCESS && sbl_step(fresh, 1e-9) == SBL_UNFINISHED, "%s",
            watch_last(&seen));
    watch_forget(&seen);
    floats[0] = 7;
    CHECK(sbl_read_channel(fresh, SBL_CHANNEL_FINAL, floats, SMALL_FLOATS) == SBL_UNFINISHED &&
          sbl_channel_texture(fresh, SBL_CHANNEL_FINAL) == 0 &&
          floats[0] == 7 && seen.count == 0, "channels of a picture that has just begun can be read: %s",
              watch_last(&seen));
    NOT_YET(sbl_inspect_sensor(fresh, 5, 5, &sensor, NULL, NULL, 0), "sbl_inspect_sensor");
    REQUIRE(sbl_step(fresh, 0) == SBL_SUCCESS, "%s", watch_last(&seen));
    CHECK(sbl_step(fresh, 0) == SBL_SUCCESS && sbl_progress(fresh) == 1, "sbl_step fails after the picture is done");
    CHECK(sbl_read_channel(fresh, SBL_CHANNEL_FINAL, floats, SMALL_FLOATS) == SBL_SUCCESS, "%s", watch_last(&seen));
    sbl_end(fresh);
    sbl_end(fresh);
    NOT_YET(sbl_step(fresh, 0), "sbl_step");
    NOT_YET(sbl_read_channel(fresh, SBL_CHANNEL_FINAL, floats, SMALL_FLOATS), "sbl_read_channel");
    CHECK(sbl_set_mesh_transform(fresh, 0, matrix) == SBL_SUCCESS && scene_bounds(fresh, three, three), "%s",
          watch_last(&seen));
    sbl_destroy(fresh);
    CHECK(seen.blocks == before && seen.strangers == 0, "%d blocks leaked", seen.blocks - before);
    usable("the wrong order");
}

/* >>cancelling and abandoning */

typedef struct canceller { int calls, stop_at, out_of_order; float last; } canceller;

static int cancel(float done, void *user) {
    canceller *c = (canceller *)user;
    if (!(done >= c->last && done <= 1)) c->out_of_order++;
    c->last = done;
    return ++c->calls == c->stop_at;
}

/* A progress callback that cancels at its Nth call, for small and a few large N, ends the picture. Nothing leaks. */
TEST(cancel_at_every_call) {
    int stop, budget, steps, most = 0;
    for (budget = 0; budget < 4; budget++)
        for (stop = 1; stop < 500; stop += 1 + stop / 8) {
            canceller c = { 0, 0, 0, 0 };
            sbl_result result;
            float value;
            c.stop_at = stop;
            view = small_view();
            view.options.backend = budget < 2 ? SBL_BACKEND_RASTER : SBL_BACKEND_TRACE;
            view.options.progress = cancel;
            view.options.progress_user = &c;
            result = sbl_begin_picture(context, &view);
            for (steps = 0; steps < 10000 && (steps == 0 ? result == SBL_SUCCESS : result == SBL_UNFINISHED); steps++)
                result = sbl_step(context, budget % 2 ? 1e-9 : 0);
            REQUIRE(steps < 10000, "the picture is not done after %d calls of sbl_step", steps);
            CHECK(c.out_of_order == 0, "progress decreased or left the range 0 to 1");
            if (c.calls < stop) {
                CHECK(result == SBL_SUCCESS && c.last == 1, "not cancelled: \"%s\", progress %g",
                      sbl_result_string(result), (double)c.last);
                break;
            }
            CHECK(result == SBL_CANCELLED, "cancelled at call %d: \"%s\"", stop, sbl_result_string(result));
            CHECK(sbl_read_channel(context, SBL_CHANNEL_ID, &value, 1) == SBL_ERROR_STATE && sbl_step(context, 0) ==
                  SBL_ERROR_STATE &&
                  sbl_progress(context) == 0,
                  "cancelled at call %d: the picture still exists", stop);
            if (!usable("cancelling")) return;
            most = stop;
        }
    CHECK(most >= 5, "only %d calls of the progress callback", most);
    usable("cancelling");
}

/* Ending, replacing or destroying an unfinished picture after 0 to 11 steps leaks nothing. */
TEST(giving_up_midway) {
    sbl_scene_desc scene = scene_desc(&small);
    float matrix[16];
    int way, steps, k;
    identity(matrix);
    for (way = 0; way < 5; way++)
        for (steps = 0; steps < 12; steps++) {
            sbl_context_desc desc = watch_desc(&seen);
            sbl_context *c = context;
            int before = seen.blocks;
            view = small_view();
            view.options.backend = steps % 2 ? SBL_BACKEND_TRACE : SBL_BACKEND_RASTER;
            if (way == 4)
                REQUIRE(sbl_create(&desc, &c) == SBL_SUCCESS && sbl_set_scene(c, &scene) == SBL_SUCCESS, "%s",
                        watch_last(&seen));
            REQUIRE(sbl_begin_picture(c, &view) == SBL_SUCCESS, "%s", watch_last(&seen));
            for (k = 0; k < steps; k++) if (sbl_step(c, 1e-9) != SBL_UNFINISHED) break;
            if (way == 0) sbl_end(c);
            else if (way == 1) CHECK(sbl_set_scene(c, &scene) == SBL_SUCCESS, "%s", watch_last(&seen));
            else if (way == 2) CHECK(sbl_set_mesh_transform(c, 0, matrix) == SBL_SUCCESS, "%s", watch_last(&seen));
            else if (way == 3) CHECK(sbl_begin_picture(c, &view) == SBL_SUCCESS, "%s", watch_last(&seen));
            else sbl_destroy(c);
            if (way < 3)
                CHECK(sbl_progress(c) == 0 && sbl_step(c, 0) == SBL_ERROR_STATE, "the abandoned picture continues");
            if (way == 4)
                CHECK(seen.blocks == before, "%d blocks leaked by sbl_destroy after %d steps", seen.blocks - before,
                      steps);
        }
    usable("giving up midway");
}

/* >>callbacks that call sbl.h */

typedef struct meddler {
    sbl_context *context;
    int which, calls, refused, said, read;
} meddler;

enum { MEDDLINGS = 20 };

static size_t put_nothing(const void *data, size_t size, void *user) { return (void)data, (void)size, (void)user, 0; }
static size_t get_nothing(void *data, size_t size, void *user) { return (void)data, (void)size, (void)user, 0; }

/* Makes one call that is forbidden inside a callback, and counts its refusals. */
static int meddle(meddler *m) {
    static sbl_sensor sensor;
    static float values[3 * SMALL_PIXELS];
    const sbl_scene_desc scene = scene_desc(&small);
    const sbl_picture_desc view_of_it = small_view();
    sbl_context *c = m->context;
    sbl_site site;
    sbl_reading reading;
    sbl_readings_desc gather;
    sbl_lightmap_desc lightmap;
    sbl_vertices_desc vertices;
    sbl_probes_desc probes;
    sbl_probe probe;
    float matrix[16], light[3 * 64];
    const int errors = seen.errors;
    sbl_result result;
    if (m->which < 0) return 0;
    identity(matrix);
    memset(&gather, 0, sizeof gather);
    memset(&lightmap, 0, sizeof lightmap);
    memset(&vertices, 0, sizeof vertices);
    memset(&probes, 0, sizeof probes);
    memset(&site, 0, sizeof site);
    site.normal[1] = 1;
    gather.sites = &site;
    gather.readings = &reading;
    gather.site_count = 1;
    gather.options.mode = lightmap.options.mode = vertices.options.mode = probes.options.mode = SBL_MODE_AMBIENT;
    lightmap.width = lightmap.height = 8;
    vertices.radiance = light;
    vertices.float_count = 64;
    probes.positions = light;
    probes.probe_count = 1;
    probes.probes = &probe;
    m->calls++;
    switch (m->which) {
        case 0: result = sbl_set_scene(c, &scene); break;
        case 1: result = sbl_set_mesh_transform(c, 0, matrix); break;
        case 2: result = sbl_begin_picture(c, &view_of_it); break;
        case 3: result = sbl_begin_readings(c, &gather); break;
        case 4: result = sbl_step(c, 0); break;
        case 5: result = sbl_inspect_sensor(c, 5, 5, &sensor, NULL, NULL, 0); break;
        case 6: result = sbl_render_picture(c, &view_of_it); break;
        case 7: result = sbl_gather_readings(c, &gather); break;
        case 8: result = sbl_begin_lightmap(c, &lightmap); break;
        case 9: result = sbl_bake_lightmap(c, &lightmap); break;
        case 10: result = sbl_begin_vertices(c, &vertices); break;
        case 11: result = sbl_bake_vertices(c, &vertices); break;
        case 12: result = sbl_begin_probes(c, &probes); break;
        case 13: result = sbl_bake_probes(c, &probes); break;
        case 14: result = sbl_set_materials(c, scene.materials, scene.material_count); break;
        case 15: result = sbl_set_lights(c, scene.lights, scene.light_count); break;
        case 16: result = sbl_save_store(c, put_nothing, NULL); break;
        case 17: result = sbl_load_store(c, get_nothing, NULL); break;
        case 18: sbl_end(c); result = SBL_ERROR_STATE; break;
        default: sbl_destroy(c); result = SBL_ERROR_STATE; break;
    }
    if (sbl_query_stats(c).scene.triangles > 0 && result == SBL_ERROR_STATE) m->refused++;
    m->said += seen.errors - errors;
    if (sbl_read_channel(c, SBL_CHANNEL_RADIANCE, values, 3 * SMALL_PIXELS) == SBL_SUCCESS) m->read++;
    return 0;
}

static int meddling_progress(float done, void *user) { return (void)done, meddle((meddler *)user); }

static void meddling_draw(const sbl_draw_view *drawn, void *user) {
    (void)drawn;
    meddle((meddler *)user);
}

/* A call of sbl.h from inside a callback is refused and has no effect. It is logged once for each piece of work, though
   the callback repeats it. The picture equals that without such calls, to the bit. */
TEST(callbacks_that_call_back) {
    static small_picture plain, other;
    sbl_scene_desc scene = scene_desc(&small);
    int way, which;
    for (way = 0; way < 3; way++) {  /* ways: progress callback rasterised, progress callback traced, draw callback */
        view = small_view();
        view.options.backend = way == 1 ? SBL_BACKEND_TRACE : SBL_BACKEND_RASTER;
        REQUIRE(sbl_set_scene(context, &scene) == SBL_SUCCESS, "%s", watch_last(&seen));
        for (which = -1; which < MEDDLINGS; which++) {  /* -1 makes no call */
            meddler m = { NULL, 0, 0, 0, 0, 0 };
            sbl_result result;
            m.context = context;
            m.which = which;
            if (way == 2) {
                sbl_scene_desc drawn = scene;
                int k;
                drawn.draw = meddling_draw;
                drawn.draw_user = &m;
                for (k = 0; k < 3; k++) { drawn.draw_bounds[0][k] = -0.1f; drawn.draw_bounds[1][k] = 0.1f; }
                result = sbl_set_scene(context, &drawn);
                REQUIRE(result == SBL_SUCCESS, "%s", watch_last(&seen));
            } else {
                view.options.progress = meddling_progress;
                view.options.progress_user = &m;
            }
            REQUIRE(sbl_begin_picture(context, &view) == SBL_SUCCESS, "%s", watch_last(&seen));
            result = sbl_step(context, 0);
            if (which < 0) {
                REQUIRE(result == SBL_SUCCESS && small_read(context, &plain) == SBL_SUCCESS && small_plausible(&plain),
                        "%s", watch_last(&seen));
                continue;
            }
            CHECK(result == SBL_SUCCESS && small_read(context, &other) == SBL_SUCCESS && small_same(&other, &plain),
                  "way %d, call %d: \"%s\", or the picture differs",
                  way, which, sbl_result_string(result));
            CHECK(m.calls > 1 && m.refused == m.calls, "way %d, call %d: refused %d of %d times", way, which, m.refused,
                  m.calls);
            CHECK(m.said == 1, "way %d, call %d: %d messages for %d calls", way, which, m.said, m.calls);
            CHECK((m.read > 0) == (way < 2), "way %d, call %d: %d channels were read", way, which, m.read);
        }
        view.options.progress = NULL;
    }
    REQUIRE(sbl_set_scene(context, &scene) == SBL_SUCCESS, "%s", watch_last(&seen));
    usable("callbacks that call back");
}

/* A scene of triangles with sizes from 1e-20 to 1e17, some of them needles, gives finite values in all channels. */
TEST(sizes_far_apart) {
    static const float sizes[] = { 1e-20f, 1e-18f, 1e-12f, 1e-6f, 1, 1e6f, 1e12f, 1e17f };
    static small_picture picture;
    test_scene s = { 0 };
    sbl_scene_desc desc;
    const int count = (int)(sizeof sizes / sizeof *sizes), grey = scene_material(&s, 0.5f, 0.5f, 0.5f),
        lamp = scene_lamp(&s, 1, 2, 3);
    int i, k, way;
    for (i = 0; i < count; i++) {
        const float a = sizes[i], plain[9] = { -a, -a, -a, a, -a, -a, 0, a, -a },
            needle[9] = { -a, 0, -a, a, 1e-20f, -a, a, 0, -a * 1.001f };
        scene_mesh(&s, i % 3 ? grey : lamp, plain, NULL, NULL, 3, NULL, 0);
        scene_mesh(&s, i % 2 ? grey : lamp, needle, NULL, NULL, 3, NULL, 0);
    }
    scene_sky(&s, 0.1f, 0.2f, 0.3f);
    desc = scene_desc(&s);
    REQUIRE(sbl_set_scene(context, &desc) == SBL_SUCCESS, "%s", watch_last(&seen));
    for (i = 0; i < count; i++) for (way = 0; way < 2; way++) {
        view = small_view();
        view.options.backend = way ? SBL_BACKEND_TRACE : SBL_BACKEND_RASTER;
        sbl_look_at(view.world_to_view, 0.3f * sizes[i], 0.2f * sizes[i], 2 * sizes[i], 0, 0, 0, 0, 1, 0);
        CHECK(small_render(context, &view, &picture) == SBL_SUCCESS, "from %g: %s", (double)sizes[i],
              watch_last(&seen));
        for (k = 0; k < SMALL_FLOATS; k++) if (!isfinite(picture.values[k])) break;
        CHECK(k == SMALL_FLOATS, "from %g: float %d of the channels is %g", (double)sizes[i], k,
              (double)picture.values[k]);
    }
    known_picture();
    usable("sizes far apart");
    scene_free(&s);
}

/* Valid but suspicious scenes cause a warning and are accepted: without any light, too small or too large, too far from
   the origin for their size, too bright or too dark. */
TEST(warnings) {
    static const struct { float size, offset, bright; int light, warnings; sbl_log_item item; } cases[] = {
        { 1, 0, 3, 1, 0, SBL_LOG_ITEM_OK }, { 1, 0, 3, 2, 0, SBL_LOG_ITEM_OK },
        { 1, 0, 3, 0, 1, SBL_LOG_ITEM_NO_LIGHT }, { 1e-9f, 0, 3, 1, 0, SBL_LOG_ITEM_OK },
        { 1e-11f, 0, 3, 1, 1, SBL_LOG_ITEM_SCALE }, { 1e9f, 0, 3, 1, 0, SBL_LOG_ITEM_OK },
        { 1e11f, 0, 3, 1, 1, SBL_LOG_ITEM_SCALE }, { 1, 1e3f, 3, 1, 0, SBL_LOG_ITEM_OK },
        { 1, 1e5f, 3, 1, 1, SBL_LOG_ITEM_SCALE }, { 1, 0, 3e-10f, 1, 1, SBL_LOG_ITEM_SCALE },
        { 1, 0, 2e-9f, 1, 0, SBL_LOG_ITEM_OK }, { 1, 0, 6e16f, 1, 0, SBL_LOG_ITEM_OK },
        { 1, 0, 3e17f, 1, 1, SBL_LOG_ITEM_SCALE } };
    static const unsigned char white[3] = { 255, 255, 255 };
    int i, way;
    for (i = 0; i < (int)(sizeof cases / sizeof *cases); i++) {
        const float size = cases[i].size, away = cases[i].offset, bright = cases[i].bright,
            move[16] = { 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, away, away, away, 1 };
        test_scene s = { 0 };
        sbl_scene_desc desc;
        static small_picture picture;
        scene_floor(&s, scene_material(&s, 0.5f, 0.5f, 0.5f), 0, 2 * size);
        if (cases[i].light)
            scene_quad(&s, scene_lamp(&s, bright, bright, bright), -0.5f * size, size, -0.5f * size, -0.5f * size, size,
                       0.5f * size, 0.5f * size, size, 0.5f * size, 0.5f * size, size, -0.5f * size);
        if (cases[i].light == 2)  /* the lamp has a texture */
            s.materials[s.material_count - 1].emission_texture =
                scene_texture(&s, white, sizeof white, SBL_PIXELS_SRGB8, 1, 1, 3);
        for (way = 0; way < s.mesh_count; way++) memcpy(s.meshes[way].transform, move, sizeof move);
        desc = scene_desc(&s);
        watch_forget(&seen);
        CHECK(sbl_set_scene(context, &desc) == SBL_SUCCESS && seen.errors == 0 && seen.warnings == cases[i].warnings,
              "case %d: %d errors, %d warnings: %s", i,
              seen.errors, seen.warnings, watch_last(&seen));
        if (cases[i].warnings)
            CHECK(seen.messages[0].item == cases[i].item, "case %d: the warning is \"%s\"", i, watch_last(&seen));
        /* scenes without a warning must be rendered correctly: compares with the exact form factor (Howell B-4) */
        for (way = 0; way < 2 && !cases[i].warnings; way++) {
            const double form = 2 / sqrt(1.25) * atan(0.5 / sqrt(1.25)) / TEST_PI;
            double found;
            view = small_view();
            view.options.mode = SBL_MODE_DIRECT;
            view.options.backend = way ? SBL_BACKEND_TRACE : SBL_BACKEND_RASTER;
            view.tile = 1;
            view.filter_radius = -1;
            sbl_look_at(view.world_to_view, away, away + 0.9f * size, away + 0.001f * size, away, away, away, 0, 1, 0);
            sbl_perspective(view.view_to_clip, 2, 1);
            CHECK(small_render(context, &view, &picture) == SBL_SUCCESS, "case %d: %s", i, watch_last(&seen));
            found = (double)picture.values[3 * (SMALL_PIXELS + SMALL_PIXELS / 2)] / (double)bright;
            CHECK(fabs(found / form - 1) < 2e-3, "case %d: R is %g of the lamp's radiance, expected %g", i, found,
                  form);
        }
        scene_free(&s);
    }
    known_picture();
    usable("warnings");
}

/* A mesh that moves so far that the scene becomes too large causes one warning; further such moves cause none. */
TEST(warnings_of_moves) {
    static const struct { float x; int warnings; } moves[] = { { 0, 0 }, { 1e3f, 0 }, { 1e11f, 1 }, { 2e11f, 0 },
                                                               { 0, 0 }, { 1e11f, 1 } };
    test_scene s = { 0 };
    sbl_scene_desc desc;
    int i;
    scene_floor(&s, scene_material(&s, 0.5f, 0.5f, 0.5f), 0, 2);
    scene_floor(&s, scene_lamp(&s, 3, 3, 3), 1, 1);
    desc = scene_desc(&s);
    CHECK(sbl_set_scene(context, &desc) == SBL_SUCCESS, "no scene: %s", watch_last(&seen));
    for (i = 0; i < (int)(sizeof moves / sizeof *moves); i++) {
        const float to[16] = { 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, moves[i].x, 0, 0, 1 };
        watch_forget(&seen);
        CHECK(sbl_set_mesh_transform(context, 1, to) == SBL_SUCCESS && seen.errors == 0 &&
              seen.warnings == moves[i].warnings, "move %d: %d errors, %d warnings: %s", i, seen.errors, seen.warnings,
              watch_last(&seen));
        if (moves[i].warnings)
            CHECK(seen.messages[0].item == SBL_LOG_ITEM_SCALE, "move %d: the warning is \"%s\"", i, watch_last(&seen));
    }
    known_picture();
    usable("moves");
    scene_free(&s);
}

/* The product of a finite emission and a finite texel may overflow a float; such a scene is refused. Materials that are
   too bright for sums of light are refused, too. */
TEST(radiance_that_overflows) {
    static const float bright[3] = { 8, 8, 8 }, sky[3] = { 6e36f, 6e36f, 6e36f };
    test_scene s = { 0 };
    sbl_material materials[SCENE_MATERIALS];
    sbl_scene_desc desc;
    const int lamp = scene_lamp(&s, 3e38f, 3e38f, 3e38f);
    int k;
    s.materials[lamp].emission_texture = scene_texture(&s, bright, sizeof bright, SBL_PIXELS_FLOAT, 1, 1, 3);
    scene_floor(&s, lamp, 0, 2);
    desc = scene_desc(&s);
    watch_forget(&seen);
    CHECK(sbl_set_scene(context, &desc) == SBL_ERROR_INVALID_ARGUMENT && seen.errors == 1, "%d errors: %s", seen.errors,
          watch_last(&seen));
    usable("radiance that overflows");
    desc = scene_desc(&small);
    for (k = 0; k < 3; k++) desc.sky[k] = 6e36f;  /* the picture is added to it */
    desc.environment.picture.pixels = sky;
    desc.environment.picture.format = SBL_PIXELS_FLOAT;
    desc.environment.picture.width = desc.environment.picture.height = 1;
    desc.environment.picture.channels = 3;
    watch_forget(&seen);
    CHECK(sbl_set_scene(context, &desc) == SBL_ERROR_INVALID_ARGUMENT && seen.errors == 1, "%d errors: %s", seen.errors,
          watch_last(&seen));
    usable("sky and picture that overflow together");
    memcpy(materials, small.materials, sizeof materials);
    materials[0].emission[0] = 3e38f;
    watch_forget(&seen);
    CHECK(sbl_set_materials(context, materials, small.material_count) == SBL_ERROR_INVALID_ARGUMENT &&
              seen.errors == 1, "%d errors: %s", seen.errors, watch_last(&seen));
    usable("materials that overflow");
    scene_free(&s);
}

/* After the last context is destroyed, the counting allocator holds no blocks. */
TEST(nothing_leaked) {
    sbl_destroy(context);
    CHECK(seen.blocks == 0 && seen.bytes == 0, "%d blocks, %.0f bytes leaked", seen.blocks, (double)seen.bytes);
    CHECK(seen.strangers == 0, "%d blocks were freed that were not allocated", seen.strangers);
}

int main(void) {
    sbl_context_desc desc = watch_desc(&seen);
    if (sbl_create(&desc, &context) != SBL_SUCCESS) { printf("no context: %s\n", watch_last(&seen)); return 1; }
    small_scene(&small);
    known_picture();
    if (!small_plausible(&expected) || !small_plausible(&expected_traced) ||
        small_same(&expected, &expected_traced)) {
            printf("the known picture is not usable as a reference\n");
            return 1;
        }
    RUN(context_desc);
    RUN(context_desc_all_at_once);
    RUN(context_desc_not_zeroed);
    RUN(scene_without_mistakes);
    RUN(scene_desc);
    RUN(mesh_counts_and_material);
    RUN(mesh_indices_past_the_end);
    RUN(streams);
    RUN(vertices_that_are_no_numbers);
    RUN(mesh_transforms);
    RUN(materials);
    RUN(textures);
    RUN(lights);
    RUN(environments);
    RUN(lights_without_light);
    RUN(scenes_too_large);
    RUN(scene_all_at_once);
    RUN(empty_scenes_and_meshes);
    RUN(degenerate_triangles);
    RUN(extreme_light);
    RUN(light_too_bright);
    RUN(sums_of_light_that_overflow);
    RUN(picture_desc);
    RUN(picture_desc_all_at_once);
    RUN(picture_desc_ends_of_ranges);
    RUN(rays_with_a_draw_callback);
    RUN(max_bounce_cells_ends_of_range);
    RUN(null_parameters);
    RUN(values_that_do_not_exist);
    RUN(helpers_out_of_range);
    RUN(too_little_room);
    RUN(wrong_order);
    RUN(cancel_at_every_call);
    RUN(giving_up_midway);
    RUN(callbacks_that_call_back);
    RUN(sizes_far_apart);
    RUN(warnings);
    RUN(warnings_of_moves);
    RUN(radiance_that_overflows);
    RUN(nothing_leaked);
    scene_free(&small);
    return test_report();
}
