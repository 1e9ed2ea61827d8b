/* A fuzz target: the input bytes become calls in any order, with scenes, pictures, gathers, bakes and allocators that
   are often invalid. sbl.h must either refuse with a message or do the work. No NaN or infinity may come out, nothing
   may leak, and the context must render a known picture as before. tests/test_fuzz.c runs a bounded, repeatable part of
   this; build/test_fuzz FILE... runs single inputs. To fuzz for as long as you want:
       clang -g -O1 -fsanitize=fuzzer,address,undefined tests/fuzz/fuzz.c -lEGL -lm -o build/fuzz &&
       mkdir -p build/corpus && ASAN_OPTIONS=detect_leaks=0 build/fuzz -max_len=1024 build/corpus tests/fuzz/corpus
   This file counts leaks itself, because drivers leak, too. Client arrays have exactly the size that their descriptor
   requires, and are freed as soon as sbl.h may no longer read them. */
#define SBL_IMPLEMENTATION
#define SBL_EGL
#include "../../sbl.h"
#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>
#include "../support/test.h"
#include "../support/gl_host.h"

enum { FUZZ_CALLS = 24, FUZZ_MESHES = 3, FUZZ_MATERIALS = 3, FUZZ_TEXTURES = 2, FUZZ_LIGHTS = 2, FUZZ_SITES = 6,
       FUZZ_SIDE = 8, FUZZ_ARRAY = 1 << 14, FUZZ_BLOCKS = 64 };

static const float fuzz_least = 1e-30f, fuzz_most = 1e30f;

/* A context, its allocator and logger, and the state that the calls so far should have led to. */
typedef struct fuzz_context {
    sbl_context *sbl;
    /* refuse_in: which allocation fails, from 1; refuse_on: all later ones fail, too */
    int blocks, refuse_in, refuse_on, refused;
    int errors, cancel_in, cancelled;
    int glossy;                                 /* 1: the scene is a glossy fuzz_known_scene */
    int refused_before, errors_before;
    int width, height;                          /* of the picture that was begun last */
    sbl_site *sites;                            /* of the gather in progress */
    sbl_reading *readings;
    int site_count;
    void *baked_from;                           /* data that the bake in progress reads */
    float *baked;                               /* result of the bake in progress */
    size_t baked_count;
} fuzz_context;

typedef struct fuzz_bytes {
    const unsigned char *at, *end;
    void *blocks[FUZZ_BLOCKS];  /* memory of the scene description that is being made */
    int block_count;
} fuzz_bytes;

static struct {
    /* the first lives as long as the process, in the host's GL context; the second is created and destroyed by calls */
    fuzz_context contexts[2];
    sbl_memory memory;         /* memory of the first context after the known picture */
    int blocks;
    float known[3 * 16];
    GLuint buffer, texture;    /* GL objects of the host */
} fuzz;
static struct { int accepted, refused, pictures, glossy, gathers, bakes, inspections, out_of_memory; } fuzz_counts;
static int fuzz_failures;

#define FUZZ_CHECK(condition, ...) do { if (!(condition)) FUZZ__FAIL(__VA_ARGS__); } while (0)
#define FUZZ__FAIL(...) (fuzz_failures++, printf("  fuzz: "), printf(__VA_ARGS__), printf("\n"), fflush(stdout))

/* >>bytes */

static unsigned fuzz_byte(fuzz_bytes *b) { return b->at < b->end ? *b->at++ : 0; }

/* Returns a value from lowest to highest most of the time, sometimes a wild one. */
static int fuzz_int(fuzz_bytes *b, int lowest, int highest) {
    static const int wild[8] = { -1, -2147483647 - 1, 2147483647, 65536, 0, 3, 1 << 24, -65537 };
    unsigned byte = fuzz_byte(b);
    return byte >= 254 ? wild[fuzz_byte(b) % 8] : lowest + (int)(byte % (unsigned)(highest - lowest + 1));
}

static float fuzz_float(fuzz_bytes *b, float lowest, float highest) {
    const float wild[8] = { -1, 0, 2, -0.0f, 1e-40f, (float)NAN, (float)HUGE_VAL, -(float)HUGE_VAL };
    unsigned byte = fuzz_byte(b);
    if (byte == 255) return wild[fuzz_byte(b) % 8];
    if (byte >= 253) return (byte == 253 ? 1.0f : -1.0f) * fuzz_least *
                            powf(fuzz_most / fuzz_least, (float)fuzz_byte(b) / 255);
    return lowest + (highest - lowest) * (float)byte / 252;
}

static void fuzz_floats(fuzz_bytes *b, float *out, int count, float lowest, float highest) {
    int i;
    for (i = 0; i < count; i++) out[i] = fuzz_float(b, lowest, highest);
}

static void *fuzz_block(fuzz_bytes *b, size_t bytes) {
    void *block = malloc(bytes ? bytes : 1);
    if (!block || b->block_count == FUZZ_BLOCKS) abort();
    return b->blocks[b->block_count++] = block;
}

/* >>scenes */

static int fuzz_wild_size(fuzz_bytes *b) { return fuzz_byte(b) >= 253; }

/* Makes a stream of `count` elements in an array that ends with its last byte. The stream is left empty if its size
   would be large but legal. vertices: number of vertices that indices may refer to; 0 for streams that are not
   indices. */
static void fuzz_stream(fuzz_bytes *b, sbl_stream *s, int components, int count, int vertices) {
    static const int sizes[SBL_TYPE_COUNT] = { 4, 2, 1, 2, 1, 2, 1, 2, 4 };
    const int type = vertices ? fuzz_int(b, SBL_UINT8, SBL_UINT32) : fuzz_int(b, 0, SBL_INT16_NORM);
    const size_t item = (size_t)(type < 0 || type >= SBL_TYPE_COUNT ? 4 : sizes[type]);
    const size_t element = item * (size_t)components, n = count > 0 ? (size_t)count : 0;
    const unsigned shape = fuzz_byte(b);
    size_t stride, bytes, i;
    unsigned char *data;
    s->type = (sbl_type)type;
    if (shape % 4 == 1) s->stride = fuzz_wild_size(b) ? SIZE_MAX / (1 + fuzz_byte(b) % 8) : element + fuzz_byte(b) % 16;
    if (shape % 8 == 1) s->offset = fuzz_wild_size(b) ? SIZE_MAX - fuzz_byte(b) : fuzz_byte(b);
    if (shape >= 248) { s->gl_buffer = shape & 1 ? fuzz.buffer : 1 + fuzz_byte(b); return; }
    stride = s->stride ? s->stride : element;
    if (n == 0) { s->data = fuzz_block(b, 1); return; }
    if (s->offset > FUZZ_ARRAY || stride > FUZZ_ARRAY || stride * n > FUZZ_ARRAY) {
        /* a stream larger than the address space must be refused; one that is only large would be read */
        if (s->offset > SIZE_MAX / 2 || n - 1 > SIZE_MAX / 2 / stride) s->data = fuzz_block(b, 1);
        else memset(s, 0, sizeof *s);
        return;
    }
    bytes = s->offset + stride * (n - 1) + element;
    data = (unsigned char *)fuzz_block(b, bytes);
    memset(data, 0, bytes);
    for (i = 0; i < n * (size_t)components; i++) {
        unsigned char *to = data + s->offset + i / (size_t)components * stride + i % (size_t)components * item;
        if (type == SBL_FLOAT32) { float x = fuzz_float(b, components == 4 ? 0.0f : -1.0f, 1); memcpy(to, &x, 4); }
        else if (vertices) *to = (unsigned char)(fuzz_byte(b) % (unsigned)(vertices + 1 - (fuzz_byte(b) < 250)));
        else to[item - 1] = (unsigned char)fuzz_byte(b);  /* the high byte, so that some half floats are infinite */
    }
    s->data = data;
}

/* Makes a picture in an array that ends with its last byte. */
static void fuzz_texture(fuzz_bytes *b, sbl_texture *t) {
    size_t texel, row, bytes, at;
    unsigned char *data;
    t->format = (sbl_pixel_format)fuzz_int(b, 0, 2);
    t->width = fuzz_int(b, 1, 9);
    t->height = fuzz_int(b, 1, 9);
    t->channels = fuzz_int(b, 0, 4);
    t->wrap = (sbl_wrap)fuzz_int(b, 0, 1);
    texel = (size_t)(t->channels < 1 || t->channels > 4 ? 4 : t->channels) * (t->format == SBL_PIXELS_FLOAT ? 4 : 1);
    if (t->width > 64 || t->height > 64) t->width = 0;  /* a large but legal picture would be read */
    if (t->width < 1 || t->height < 1) { t->pixels = fuzz_block(b, 1); return; }
    row = texel * (size_t)t->width;
    if (fuzz_byte(b) % 4 == 1) t->stride = row + fuzz_byte(b) % 8;
    bytes = (t->stride ? t->stride : row) * (size_t)(t->height - 1) + row;
    t->pixels = data = (unsigned char *)fuzz_block(b, bytes);
    memset(data, 0, bytes);
    for (at = 0; at + 4 <= bytes; at += 4) {
        if (t->format == SBL_PIXELS_FLOAT) { float x = fuzz_float(b, 0, 1); memcpy(data + at, &x, 4); }
        else data[at] = (unsigned char)fuzz_byte(b);
    }
}

static void fuzz_light(fuzz_bytes *b, sbl_light *l) {
    const unsigned shape = fuzz_byte(b);
    l->kind = (sbl_light_kind)fuzz_int(b, 0, SBL_LIGHT_KIND_COUNT - 1);
    fuzz_floats(b, l->intensity, 3, 0, 4);
    fuzz_floats(b, l->position, 3, -2, 2);
    fuzz_floats(b, l->direction, 3, -1, 1);
    if (shape & 1) l->radius = fuzz_float(b, 0, 1);
    if (shape & 2) l->angle = fuzz_float(b, 0, 180);
    if (shape & 4) l->cone = fuzz_float(b, 1, 180);
    if (shape & 8) l->inner_cone = fuzz_float(b, 0, 45);
}

static void fuzz_material(fuzz_bytes *b, sbl_material *m, int textures) {
    const unsigned shape = fuzz_byte(b);
    fuzz_floats(b, m->albedo, 3, 0, 1);
    if (shape & 1) fuzz_floats(b, m->emission, 3, 0, 4);
    if (shape & 2) m->albedo_texture = fuzz_int(b, 0, textures);
    if (shape & 4) m->emission_texture = fuzz_int(b, 0, textures);
    if (shape & 8) m->alpha_cutoff = fuzz_float(b, 0, 1);
    if (shape & 16) m->flags = fuzz_byte(b) % 9;
    if (shape & 128) {
        m->normal_texture = fuzz_int(b, 0, textures);
        m->normal_scale = fuzz_float(b, -2, 2);
    }
    if ((shape & 96) != 96) return;
    m->ior = fuzz_byte(b) % 2 ? 0 : fuzz_float(b, 1, 2);
    m->metallic = fuzz_float(b, 0, 1);
    m->roughness = fuzz_float(b, 0, 1);
    m->specular_texture = fuzz_int(b, 0, textures);
    m->transmission = fuzz_byte(b) % 2 ? 0 : fuzz_float(b, 0, 1);
    m->transmission_texture = fuzz_int(b, 0, textures);
    if (fuzz_byte(b) % 2) m->flags |= SBL_MATERIAL_BLEND;
}

static void fuzz_transform(fuzz_bytes *b, float m[16]) {
    int k;
    for (k = 0; k < 16; k++) m[k] = k % 4 == 3 ? 0.0f : fuzz_float(b, -2, 2);
    m[15] = fuzz_byte(b) < 250 ? 1.0f : 0.0f;
}

static void fuzz_mesh(fuzz_bytes *b, sbl_mesh *m) {
    const unsigned shape = fuzz_byte(b);
    m->vertex_count = fuzz_int(b, 0, 4);
    m->index_count = fuzz_int(b, 0, 5);
    if (m->vertex_count > 0 && m->vertex_count < 5) m->vertex_count *= 3;
    if (m->index_count > 0 && m->index_count < 6) m->index_count *= 3;
    fuzz_stream(b, &m->positions, 3, m->vertex_count, 0);
    if (shape & 1) fuzz_stream(b, &m->normals, 3, m->vertex_count, 0);
    if (shape & 2) fuzz_stream(b, &m->texcoords, 2, m->vertex_count, 0);
    if (shape & 4) fuzz_stream(b, &m->colors, 4, m->vertex_count, 0);
    if (shape & 8)
        fuzz_stream(b, &m->indices, 1, m->index_count,
                    m->vertex_count < 1 ? 1 : m->vertex_count > 200 ? 200 : m->vertex_count);
    if (shape & 16) fuzz_transform(b, m->transform);
    if (shape & 32) fuzz_stream(b, &m->lightmap_texcoords, 2, m->vertex_count, 0);
    m->material = fuzz_int(b, 0, FUZZ_MATERIALS - 1);
    m->id = fuzz_byte(b);
}

static void fuzz_sky(const float direction[3], float radiance[3], void *user) {
    int i;
    (void)user;
    for (i = 0; i < 3; i++) radiance[i] = direction[i] > 0 ? direction[i] : 0;
}

static void fuzz_environment(fuzz_bytes *b, sbl_environment *e) {
    const unsigned shape = fuzz_byte(b);
    if (shape & 1) fuzz_texture(b, &e->picture);
    if (shape & 2) { e->radiance = fuzz_sky; if (fuzz_byte(b) < 250) e->picture.pixels = NULL; }
    /* the default, 512 x 256, would be slow */
    if (e->radiance && !e->picture.width) e->picture.width = e->picture.height = 4;
    e->picture.wrap = SBL_WRAP_REPEAT;
    e->scale = fuzz_float(b, 0, 4);
    e->rotation = fuzz_float(b, -180, 180);
    fuzz_floats(b, e->up, 3, -1, 1);
}

static void fuzz_draw(const sbl_draw_view *view, void *user) { (void)view; (void)user; }

static sbl_result fuzz_set_scene(fuzz_bytes *b, sbl_context *context) {
    sbl_mesh meshes[FUZZ_MESHES];
    sbl_material materials[FUZZ_MATERIALS];
    sbl_texture textures[FUZZ_TEXTURES];
    sbl_light lights[FUZZ_LIGHTS];
    sbl_scene_desc scene;
    const unsigned shape = fuzz_byte(b);
    unsigned last;
    sbl_result result;
    int i;
    memset(meshes, 0, sizeof meshes);
    memset(materials, 0, sizeof materials);
    memset(textures, 0, sizeof textures);
    memset(lights, 0, sizeof lights);
    memset(&scene, 0, sizeof scene);
    scene.meshes = meshes;
    scene.mesh_count = (int)(shape % 4);
    scene.materials = materials;
    scene.material_count = FUZZ_MATERIALS;
    scene.textures = textures;
    scene.texture_count = (int)(shape / 4 % 3);
    scene.lights = lights;
    scene.light_count = (int)(shape / 16 % 3);
    fuzz_floats(b, scene.sky, 3, 0, 2);
    for (i = 0; i < scene.mesh_count; i++) fuzz_mesh(b, &meshes[i]);
    for (i = 0; i < scene.light_count; i++) fuzz_light(b, &lights[i]);
    if (shape & 64) fuzz_environment(b, &scene.environment);
    for (i = 0; i < FUZZ_MATERIALS; i++) fuzz_material(b, &materials[i], scene.texture_count);
    for (i = 0; i < scene.texture_count; i++) {
        fuzz_texture(b, &textures[i]);
        if (shape & 128 && fuzz_byte(b) & 1) { textures[i].pixels = NULL; textures[i].gl_texture = fuzz.texture; }
    }
    if (shape & 128 && fuzz_byte(b) & 1) {
        scene.draw = fuzz_draw;
        fuzz_floats(b, scene.draw_bounds[0], 3, -2, 0);
        fuzz_floats(b, scene.draw_bounds[1], 3, 0, 2);
        scene.draw_max_radiance = fuzz_float(b, 0, 4);
    }
    last = fuzz_byte(b);
    scene.max_bounce_cells = last == 253 ? 1023 : 1024 + (int)last;
    if (last >= 254) scene.start_canary = 1;
    result = sbl_set_scene(context, &scene);
    while (b->block_count) free(b->blocks[--b->block_count]);
    return result;
}

/* A wall and a lamp in front of it: a valid scene. glossy: 0: the wall is matte; 1: plastic that lets light pass; 2:
   rough metal; 3: a mirror */
static sbl_result fuzz_known_scene(sbl_context *context, int glossy) {
    static const float corners[18] = { -3, -3, -1, 3, -3, -1, 0, 4, -2, -1, -1, 1, 1, -1, 1, 0, 1, 2 };
    static const float places[6] = { 0.1f, 0.1f, 0.9f, 0.1f, 0.5f, 0.9f };
    sbl_material materials[2];
    sbl_mesh meshes[2];
    sbl_scene_desc scene;
    int i;
    memset(materials, 0, sizeof materials);
    memset(meshes, 0, sizeof meshes);
    memset(&scene, 0, sizeof scene);
    for (i = 0; i < 3; i++) materials[0].albedo[i] = materials[1].emission[i] = 0.5f;
    materials[0].ior = glossy == 1 ? 1.5f : 0.0f;
    materials[0].transmission = glossy == 1 ? 0.25f : 0.0f;
    materials[0].metallic = glossy > 1 ? 1.0f : 0.0f;
    materials[0].roughness = glossy == 3 ? 0.0f : 0.3f;
    for (i = 0; i < 2; i++) {
        meshes[i].positions.data = corners + 9 * i;
        meshes[i].vertex_count = 3;
        meshes[i].material = i;
    }
    meshes[0].lightmap_texcoords.data = places;
    scene.meshes = meshes;
    scene.mesh_count = 2;
    scene.materials = materials;
    scene.material_count = 2;
    scene.sky[2] = 0.25f;
    scene.max_bounce_cells = 1024;
    return sbl_set_scene(context, &scene);
}

/* >>pictures and gathers */

static int fuzz_progress(float done, void *user) {
    fuzz_context *c = (fuzz_context *)user;
    FUZZ_CHECK(done >= 0 && done <= 1, "progress is %g", (double)done);
    if (c->cancel_in == 0 || --c->cancel_in > 0) return 0;
    c->cancelled = 1;
    return 1;
}

static int fuzz_cancel(fuzz_bytes *b) { const unsigned byte = fuzz_byte(b); return byte < 64 ? (int)byte : 0; }

static void fuzz_picture(fuzz_bytes *b, fuzz_context *c, sbl_picture_desc *view) {
    const unsigned shape = fuzz_byte(b);
    float eye[3];
    int i;
    memset(view, 0, sizeof *view);
    view->width = fuzz_int(b, 1, FUZZ_SIDE);
    view->height = fuzz_int(b, 1, FUZZ_SIDE);
    if (view->width * (double)view->height > FUZZ_SIDE * FUZZ_SIDE || (!view->width && !view->height)) view->width = -1;
    view->options.mode = (sbl_mode)fuzz_int(b, 0, SBL_MODE_COUNT - 1);
    view->options.backend = (sbl_backend)fuzz_int(b, 0, SBL_BACKEND_COUNT - 1);
    view->options.rays = fuzz_int(b, 1, 40);
    view->options.sensor_size = fuzz_int(b, 4, 16);
    view->tile = fuzz_int(b, 1, 8);
    view->filter_radius = fuzz_int(b, -1, 3);
    view->samples = fuzz_int(b, 1, 3);
    view->options.seed = fuzz_byte(b);
    /* the target error decides the number of rays; values above 1 and below 0 are invalid */
    if ((view->options.seed & 3) == 3) {
        view->options.rays = 0;
        view->target_error = view->options.seed == 255 ? -1 : 0.02f * (float)(view->options.seed >> 2);
    }
    if (shape & 1) view->threshold = fuzz_float(b, 0, 1);
    if (shape & 2) view->options.epsilon = fuzz_float(b, 0, 1);
    if (shape & 4) view->facet_limit = fuzz_float(b, 0, 4);
    if (shape & 8) view->sensor_fov = fuzz_float(b, 1, 179);
    if (shape & 16) view->sensor_kind = (sbl_sensor_kind)fuzz_int(b, 0, SBL_SENSOR_KIND_COUNT - 1);
    if (shape & 32) {
        fuzz_floats(b, eye, 3, -3, 3);
        sbl_look_at(view->world_to_view, eye[0], eye[1], eye[2], 0, 0, 0, 0, 1, 0);
    }
    if (shape & 64) sbl_perspective(view->view_to_clip, fuzz_float(b, 1, 179), fuzz_float(b, 0.5f, 2));
    if (shape & 128) {  /* orthographic or arbitrary */
        fuzz_floats(b, view->view_to_clip, 1, 0, 2);
        fuzz_floats(b, view->view_to_clip + 5, 1, 0, 2);
        fuzz_floats(b, view->view_to_clip + 10, 6, -1, 1);
        if (fuzz_byte(b) < 240) {
            memset(view->view_to_clip + 10, 0, 6 * sizeof(float));
            view->view_to_clip[10] = -1;
            view->view_to_clip[15] = 1;
        }
    }
    if (view->options.seed & 16) {  /* a window, which lies partly outside now and then */
        for (i = 0; i < 2; i++) {
            view->window[2 + i] = fuzz_int(b, 0, FUZZ_SIDE / 2);
            view->window[i] = fuzz_int(b, 0, FUZZ_SIDE / 2);
        }
        view->mean_radiance[1] = fuzz_float(b, 0, 2);
    }
    c->cancel_in = fuzz_cancel(b);
    view->options.progress = fuzz_progress;
    view->options.progress_user = c;
}

/* The caller must free sites and readings. */
static void fuzz_gather(fuzz_bytes *b, fuzz_context *c, sbl_readings_desc *gather) {
    const unsigned shape = fuzz_byte(b);
    const int count = (int)(fuzz_byte(b) % (FUZZ_SITES + 1));
    sbl_site *sites = (sbl_site *)calloc((size_t)count + !count, sizeof *sites);
    int i;
    memset(gather, 0, sizeof *gather);
    gather->sites = sites;
    gather->readings = (sbl_reading *)malloc(((size_t)count + !count) * sizeof *gather->readings);
    if (!sites || !gather->readings) abort();
    memset(gather->readings, 0xff, ((size_t)count + !count) * sizeof *gather->readings);  /* NaN */
    gather->site_count = count;
    for (i = 0; i < count; i++) {
        fuzz_floats(b, sites[i].position, 3, -2, 2);
        fuzz_floats(b, sites[i].normal, 3, -1, 1);
        if (shape & 1) fuzz_floats(b, sites[i].geometric_normal, 3, -1, 1);
        if (shape & 2) sites[i].offset = fuzz_float(b, -1, 1);
    }
    gather->options.mode = (sbl_mode)fuzz_int(b, 0, SBL_MODE_COUNT - 1);
    gather->options.backend = (sbl_backend)fuzz_int(b, 0, SBL_BACKEND_COUNT - 1);
    gather->options.rays = fuzz_int(b, 0, 40);
    gather->options.sensor_size = fuzz_int(b, 4, 16);
    gather->options.seed = fuzz_byte(b);
    if (shape & 4) gather->options.epsilon = fuzz_float(b, 0, 1);
    if (shape & 8) gather->sensor_fov = fuzz_float(b, 1, 179);
    if (shape & 16) gather->sensor_kind = (sbl_sensor_kind)fuzz_int(b, 0, SBL_SENSOR_KIND_COUNT - 1);
    c->cancel_in = fuzz_cancel(b);
    gather->options.progress = fuzz_progress;
    gather->options.progress_user = c;
}

/* >>bakes. The caller must free the floats into which vertices and probes are baked. */

static void fuzz_lightmap(fuzz_bytes *b, fuzz_context *c, sbl_lightmap_desc *map) {
    const unsigned shape = fuzz_byte(b);
    memset(map, 0, sizeof *map);
    map->width = fuzz_int(b, 1, FUZZ_SIDE);
    map->height = fuzz_int(b, 1, FUZZ_SIDE);
    if (map->width * (double)map->height > FUZZ_SIDE * FUZZ_SIDE || (!map->width && !map->height)) map->width = -1;
    map->gutter = fuzz_int(b, -1, 4);
    map->directional = shape & 1 ? fuzz_int(b, 0, 1) : 0;
    map->supersample = shape & 2 ? fuzz_int(b, 1, 3) : 0;
    map->seams = shape & 4 ? -1 : 0;
    map->options.mode = (sbl_mode)fuzz_int(b, 0, SBL_MODE_COUNT - 1);
    map->options.backend = (sbl_backend)fuzz_int(b, 0, SBL_BACKEND_COUNT - 1);
    map->options.rays = shape & 8 ? 0 : fuzz_int(b, 1, 40);
    map->target_error = shape & 16 ? fuzz_float(b, 0, 1) : 0;
    map->options.sensor_size = fuzz_int(b, 4, 16);
    map->tile = fuzz_int(b, 1, 8);
    map->filter_radius = fuzz_int(b, -1, 3);
    if (shape & 128) map->facet_limit = fuzz_float(b, -1, 4);
    if (shape & 32) map->threshold = fuzz_float(b, 0, 1);
    if (shape & 64) map->options.epsilon = fuzz_float(b, 0, 1);
    map->options.seed = fuzz_byte(b);
    c->cancel_in = fuzz_cancel(b);
    map->options.progress = fuzz_progress;
    map->options.progress_user = c;
}

/* meshes: storage for the list of meshes, which some descriptors use. */
static void fuzz_vertices(fuzz_bytes *b, fuzz_context *c, int meshes[2], sbl_vertices_desc *light) {
    const unsigned shape = fuzz_byte(b);
    int i;
    memset(light, 0, sizeof *light);
    for (i = 0; i < 2; i++) meshes[i] = fuzz_int(b, 0, FUZZ_MESHES - 1);
    if (shape & 1) { light->meshes = meshes; light->mesh_count = fuzz_int(b, 0, 2) % 3; }
    light->float_count = shape & 2 ? fuzz_byte(b) % 128 : 3 * 12 * FUZZ_MESHES;
    light->radiance = (float *)malloc(light->float_count * sizeof(float) + 1);
    if (!light->radiance) abort();
    light->samples = fuzz_int(b, 0, 9);
    light->average = (int)(shape >> 2 & 1);
    light->smoothing = shape & 8 ? fuzz_float(b, -1, 1) : 0;
    light->options.mode = (sbl_mode)fuzz_int(b, 0, SBL_MODE_COUNT - 1);
    light->options.backend = (sbl_backend)fuzz_int(b, 0, SBL_BACKEND_COUNT - 1);
    light->options.rays = fuzz_int(b, 0, 40);
    light->options.sensor_size = fuzz_int(b, 4, 16);
    if (shape & 16) light->options.epsilon = fuzz_float(b, 0, 1);
    light->options.seed = fuzz_byte(b);
    memset(light->radiance, 0, light->float_count * sizeof(float));
    c->cancel_in = fuzz_cancel(b);
    light->options.progress = fuzz_progress;
    light->options.progress_user = c;
}

static void fuzz_probes(fuzz_bytes *b, fuzz_context *c, float **positions, sbl_probes_desc *desc) {
    const unsigned shape = fuzz_byte(b);
    const int count = (int)(fuzz_byte(b) % (FUZZ_SITES + 1));
    memset(desc, 0, sizeof *desc);
    *positions = (float *)malloc(3 * (size_t)count * sizeof(float) + 1);
    desc->probes = (sbl_probe *)malloc(((size_t)count + !count) * sizeof *desc->probes);
    if (!*positions || !desc->probes) abort();
    memset(desc->probes, 0, ((size_t)count + !count) * sizeof *desc->probes);
    fuzz_floats(b, *positions, 3 * count, -2, 2);
    desc->probe_count = count;
    if (shape & 1) desc->positions = *positions;
    else {  /* a grid of the right or a wrong number of probes */
        desc->grid[0] = fuzz_int(b, 1, 1);
        desc->grid[1] = count ? count : 1;
        desc->grid[2] = 1;
        if (!count && desc->grid[0] > 0) desc->probe_count = -1;
    }
    if (shape & 2) { fuzz_floats(b, desc->lowest, 3, -2, 0); fuzz_floats(b, desc->highest, 3, 0, 2); }
    if (shape & 4) desc->move = fuzz_float(b, 0, 1);
    desc->options.mode = (sbl_mode)fuzz_int(b, 0, SBL_MODE_COUNT - 1);
    desc->options.backend = (sbl_backend)fuzz_int(b, 0, SBL_BACKEND_COUNT - 1);
    desc->options.rays = fuzz_int(b, 64, 100);
    desc->options.sensor_size = fuzz_int(b, 4, 16);
    if (shape & 8) desc->options.epsilon = fuzz_float(b, 0, 1);
    desc->options.seed = fuzz_byte(b);
    c->cancel_in = fuzz_cancel(b);
    desc->options.progress = fuzz_progress;
    desc->options.progress_user = c;
}

/* >>contexts and calls */

/* Blocks are filled with NaN, so that floats that were never written are found. */
static void *fuzz_alloc(size_t bytes, void *user) {
    fuzz_context *c = (fuzz_context *)user;
    void *block;
    if (c->refuse_in && --c->refuse_in == 0) { c->refuse_in = c->refuse_on; c->refused++; return NULL; }
    block = malloc(bytes);
    if (!block) abort();
    memset(block, 0xff, bytes);
    c->blocks++;
    return block;
}

static void fuzz_free(void *pointer, void *user) {
    ((fuzz_context *)user)->blocks--;
    free(pointer);
}

static void fuzz_log(sbl_log_level level, sbl_log_item item, const char *message, void *user) {
    fuzz_context *c = (fuzz_context *)user;
    if (level == SBL_LOG_ERROR) c->errors++;
    FUZZ_CHECK(message[0] && sbl_log_item_string(item)[0], "an empty message");
}

static void fuzz_before(fuzz_context *c) {
    c->refused_before = c->refused;
    c->errors_before = c->errors;
    c->cancelled = 0;
}

static sbl_result fuzz_after(fuzz_context *c, const char *call, sbl_result result) {
    const char *words = sbl_result_string(result);
    const int refused = c->refused - c->refused_before;
    const int error = result >= SBL_ERROR_INVALID_ARGUMENT, oom = result == SBL_ERROR_OUT_OF_MEMORY;
    if (result == SBL_SUCCESS) fuzz_counts.accepted++;
    if (error) fuzz_counts.refused++;
    if (oom) fuzz_counts.out_of_memory++;
    FUZZ_CHECK((int)result >= 0 && result < SBL_RESULT_COUNT, "%s: result %d", call, (int)result);
    FUZZ_CHECK(result != SBL_ERROR_GL, "%s: %s", call, words);
    FUZZ_CHECK(!c->sbl || !error || c->errors > c->errors_before, "%s: \"%s\", but no message", call, words);
    FUZZ_CHECK(oom == (refused > 0), "%s: \"%s\", %d allocations refused", call, words, refused);
    FUZZ_CHECK((result == SBL_CANCELLED) == c->cancelled || refused, "%s: \"%s\", cancelled: %d", call, words,
               c->cancelled);
    return result;
}

#define FUZZ_CALL(c, call) (fuzz_before(c), fuzz_after(c, #call, call))

static void fuzz_numbers(const char *what, const float *values, size_t count) {
    size_t i;
    for (i = 0; i < count && values[i] - values[i] == 0; i++) {}
    FUZZ_CHECK(i == count, "%s: number %d of %d is %g", what, (int)i, (int)count, (double)values[i]);
}

static void fuzz_make(fuzz_context *c, const sbl_context_desc *wishes) {
    sbl_context_desc desc = *wishes;
    desc.allocator.alloc = fuzz_alloc;
    desc.allocator.free = fuzz_free;
    desc.logger.log = fuzz_log;
    desc.allocator.user = desc.logger.user = c;
    FUZZ_CALL(c, sbl_create(&desc, &c->sbl));
}

/* Frees the arrays of a gather or bake that has ended. whole: 1: its results are complete, and are checked first */
static void fuzz_gather_gone(fuzz_context *c, int whole) {
    if (whole && c->readings) {
        fuzz_numbers("readings", (const float *)c->readings, sizeof *c->readings / 4 * (size_t)c->site_count);
        fuzz_counts.gathers++;
    }
    if (whole && c->baked) {
        fuzz_numbers("baked light", c->baked, c->baked_count);
        fuzz_counts.bakes++;
    }
    free(c->sites);
    free(c->readings);
    free(c->baked_from);
    free(c->baked);
    c->sites = NULL;
    c->readings = NULL;
    c->baked_from = NULL;
    c->baked = NULL;
}

static void fuzz_destroy(fuzz_context *c) {
    sbl_destroy(c->sbl);
    fuzz_gather_gone(c, 0);
    FUZZ_CHECK(c->blocks == 0, "%d blocks leaked by sbl_destroy", c->blocks);
    memset(c, 0, sizeof *c);
}

static void fuzz_read(fuzz_context *c, int channel, size_t room) {
    const int components = sbl_channel_components((sbl_channel)channel);
    const size_t count = (size_t)c->width * (size_t)c->height * (size_t)components, less = room < count ? room : count;
    float *out = (float *)malloc(less * sizeof *out + 1);
    char what[32];
    if (!out) abort();
    memset(out, 0xff, less * sizeof *out);
    snprintf(what, sizeof what, "channel %d", channel);
    if (FUZZ_CALL(c, sbl_read_channel(c->sbl, (sbl_channel)channel, out, less)) == SBL_SUCCESS) {
        FUZZ_CHECK(less == count, "channel %d: %d floats were written into an array of %d", channel, (int)count,
                   (int)less);
        fuzz_numbers(what, out, less);
    }
    free(out);
}

static void fuzz_inspect(fuzz_context *c, int x, int y, size_t room) {
    sbl_sensor s;
    size_t count;
    float *radiance, *weights;
    int i;
    memset(&s, 0xff, sizeof s);
    if (FUZZ_CALL(c, sbl_inspect_sensor(c->sbl, x, y, &s, NULL, NULL, 0)) != SBL_SUCCESS) return;
    count = (size_t)s.sheet_width * (size_t)s.sheet_height;
    room = room < count ? room : count;
    radiance = (float *)malloc(room * 16 + 1);
    weights = (float *)malloc(room * 4 + 1);
    if (!radiance || !weights) abort();
    if (FUZZ_CALL(c, sbl_inspect_sensor(c->sbl, x, y, &s, radiance, weights, room)) == SBL_SUCCESS) {
        FUZZ_CHECK(room == count, "a sheet was written into an array that is too small");
        fuzz_counts.inspections++;
        fuzz_numbers("inspected radiance", radiance, 4 * room);
        fuzz_numbers("inspected weights", weights, room);
        fuzz_numbers("inspected site", s.site.position, 10);
        fuzz_numbers("inspected sensor from position to noise", s.position, 10);
        fuzz_numbers("inspected sums", s.from_surroundings, 10);
        for (i = 0; i < s.ray_count; i++) fuzz_numbers("inspected ray", s.rays[i].direction, 7);
        for (i = 0; i < s.lamp_count; i++) fuzz_numbers("inspected lamp", s.lamps[i].unhindered, 3);
    }
    free(radiance);
    free(weights);
}

static void fuzz_queries(fuzz_bytes *b, fuzz_context *c) {
    const int number = fuzz_int(b, 0, 40);
    sbl_picture_desc picture = sbl_picture_desc_defaults(NULL);
    sbl_readings_desc gather = sbl_readings_desc_defaults(NULL);
    sbl_stats stats = sbl_query_stats(c->sbl);
    sbl_memory memory = sbl_query_memory(c->sbl);
    const sbl_programs programs = sbl_query_programs(c->sbl);
    sbl_context_desc desc = sbl_query_desc(c->sbl);
    const sbl_bounds bounds = sbl_query_bounds(c->sbl);
    float numbers[12], m[16];
    unsigned char bytes[12];
    fuzz_floats(b, numbers, 12, -2, 2);
    fuzz_numbers("bounds", bounds.lowest, 3);
    fuzz_numbers("bounds", bounds.highest, 3);
    if (sbl_look_at(m, numbers[0], numbers[1], numbers[2], numbers[3], numbers[4], numbers[5], numbers[6], numbers[7],
                    numbers[8])) fuzz_numbers("sbl_look_at", m, 16);
    if (sbl_perspective(m, 60 * numbers[9], numbers[10])) fuzz_numbers("sbl_perspective", m, 16);
    sbl_encode_srgb8(bytes, numbers, sizeof bytes, numbers[11]);
    FUZZ_CHECK(sbl_progress(c->sbl) >= 0 && sbl_progress(c->sbl) <= 1, "sbl_progress");
    FUZZ_CHECK(sbl_result_string((sbl_result)number)[0] && sbl_log_item_string((sbl_log_item)number)[0],
               "a result or log item has no text");
    FUZZ_CHECK(memory.host_bytes <= memory.host_peak_bytes && memory.gpu_bytes <= memory.gpu_peak_bytes, "peaks");
    FUZZ_CHECK(picture.width && gather.options.rays && stats.sensors.sites >= 0, "defaults");
    FUZZ_CHECK(!desc.sensor_texture_size == !c->sbl, "sbl_query_desc does not fit the context");
    FUZZ_CHECK(!c->sbl || programs.compiled <= 128, "%d programs", programs.compiled);
}

static double fuzz_seconds(fuzz_bytes *b) {
    static const double seconds[4] = { 1e-9, 1e-9, 0.002, 0 };
    const unsigned byte = fuzz_byte(b);
    return byte == 255 ? NAN : byte == 254 ? HUGE_VAL : byte == 253 ? -1.0 : seconds[byte % 4];
}

static void fuzz_step(fuzz_context *c, double seconds) {
    const sbl_result result = FUZZ_CALL(c, sbl_step(c->sbl, seconds));
    if (result != SBL_UNFINISHED) fuzz_gather_gone(c, result == SBL_SUCCESS);
}

static void fuzz_render(fuzz_bytes *b, fuzz_context *c, int whole) {
    sbl_picture_desc view;
    sbl_result result;
    int channel;
    fuzz_picture(b, c, &view);
    result = FUZZ_CALL(c, whole ? sbl_render_picture(c->sbl, &view) : sbl_begin_picture(c->sbl, &view));
    if (result == SBL_ERROR_INVALID_ARGUMENT || result == SBL_ERROR_STATE || result == SBL_ERROR_UNSUPPORTED) return;
    fuzz_gather_gone(c, 0);
    c->width = view.window[2] ? view.window[2] : view.width;
    c->height = view.window[2] ? view.window[3] : view.height;
    if (!whole || result != SBL_SUCCESS) return;
    fuzz_counts.pictures++;
    fuzz_counts.glossy += c->glossy;
    for (channel = 0; channel < SBL_CHANNEL_COUNT; channel++) {
        fuzz_read(c, channel, SIZE_MAX);
        if (view.window[2]) sbl_channel_texture(c->sbl, (sbl_channel)channel);
    }
    fuzz_inspect(c, (int)view.options.seed % c->width, (int)view.options.seed / c->width % c->height, SIZE_MAX);
}

static void fuzz_gathering(fuzz_bytes *b, fuzz_context *c, int whole) {
    fuzz_context before = *c;
    sbl_readings_desc gather;
    sbl_result result;
    fuzz_gather(b, c, &gather);
    result = FUZZ_CALL(c, sbl_begin_readings(c->sbl, &gather));
    if (result == SBL_SUCCESS) {
        fuzz_gather_gone(c, 0);
        c->sites = (sbl_site *)(size_t)gather.sites;
        c->readings = gather.readings;
        c->site_count = gather.site_count;
        if (whole) fuzz_step(c, 0);
        return;
    }
    c->cancel_in = before.cancel_in;
    free((void *)(size_t)gather.sites);
    free(gather.readings);
}

static void fuzz_bake_lightmap(fuzz_bytes *b, fuzz_context *c, int whole) {
    sbl_lightmap_desc map;
    sbl_result result;
    int channel;
    fuzz_lightmap(b, c, &map);
    result = FUZZ_CALL(c, whole ? sbl_bake_lightmap(c->sbl, &map) : sbl_begin_lightmap(c->sbl, &map));
    if (result == SBL_ERROR_INVALID_ARGUMENT || result == SBL_ERROR_STATE || result == SBL_ERROR_UNSUPPORTED) return;
    fuzz_gather_gone(c, 0);
    c->width = map.width;
    c->height = map.height;
    if (!whole || result != SBL_SUCCESS) return;
    fuzz_counts.bakes++;
    for (channel = 0; channel < SBL_CHANNEL_COUNT; channel++) {
        fuzz_read(c, channel, SIZE_MAX);
        if (map.options.seed & 1) sbl_channel_texture(c->sbl, (sbl_channel)channel);
    }
    fuzz_inspect(c, (int)map.options.seed % map.width, (int)map.options.seed / map.width % map.height, SIZE_MAX);
}

/* Bakes vertices or probes. */
static void fuzz_bake(fuzz_bytes *b, fuzz_context *c, int whole) {
    const fuzz_context before = *c;
    const int of_probes = fuzz_byte(b) & 1;
    sbl_vertices_desc light;
    sbl_probes_desc probes;
    int *meshes = (int *)calloc(2, sizeof *meshes);
    float *positions = NULL, *out;
    size_t count;
    sbl_result result;
    if (!meshes) abort();
    if (of_probes) {
        fuzz_probes(b, c, &positions, &probes);
        out = (float *)probes.probes;
        count = probes.probe_count > 0 ? sizeof *probes.probes / 4 * (size_t)probes.probe_count : 0;
        result = FUZZ_CALL(c, sbl_begin_probes(c->sbl, &probes));
    } else {
        fuzz_vertices(b, c, meshes, &light);
        out = light.radiance;
        count = light.float_count;
        result = FUZZ_CALL(c, sbl_begin_vertices(c->sbl, &light));
    }
    free(meshes);  /* the list is read only when the bake begins */
    if (result == SBL_SUCCESS) {
        fuzz_gather_gone(c, 0);
        c->baked_from = positions;
        c->baked = out;
        c->baked_count = count;
        if (whole) fuzz_step(c, 0);
        return;
    }
    c->cancel_in = before.cancel_in;
    free(positions);
    free(out);
}

/* Reads a byte. The allocation with the number byte % 64, counted from now, fails, and all later ones fail if the byte
   is at least 192. If byte % 64 is 0, none fails. */
static void fuzz_refuse(fuzz_bytes *b, fuzz_context *c) {
    const unsigned byte = fuzz_byte(b);
    c->refuse_in = (int)(byte % 64);
    c->refuse_on = byte >= 192;
}

static void fuzz_second(fuzz_bytes *b, fuzz_context *c) {
    const unsigned shape = fuzz_byte(b);
    sbl_context_desc desc;
    fuzz_destroy(c);
    if (shape & 1) return;
    memset(&desc, 0, sizeof desc);
    /* sbl_create makes a GL context of its own unless it gets this function */
    if (shape & 2) desc.get_gl_function = gl_host_proc;
    if (shape & 4) fuzz_refuse(b, c);
    desc.disabled = shape >> 3 & SBL_CAPABILITY_ALL;
    desc.batch = shape & 32 ? fuzz_int(b, 0, 9) : 0;
    desc.sensor_texture_size = shape & 64 ? fuzz_int(b, 256, 300) : 0;
    desc.longest_submission = shape & 128 ? fuzz_float(b, 0, 1) : 0;
    fuzz_make(c, &desc);
}

static void fuzz_one_call(fuzz_bytes *b) {
    const unsigned what = fuzz_byte(b);
    fuzz_context *c = &fuzz.contexts[what >> 7];
    float m[16];
    int i;
    /* calls that were added last; older inputs of the corpus do not use these values */
    if ((what >> 4 & 7) == 7 && what % 16 > 7) {
        if (what & 1) fuzz_bake_lightmap(b, c, (int)(what >> 1 & 1));
        else fuzz_bake(b, c, (int)(what >> 1 & 1));
        FUZZ_CHECK(eglGetCurrentContext() == gl.context, "the host's GL context is not current any more");
        return;
    }
    switch (what % 16) {
        case 0:
            if (FUZZ_CALL(c, fuzz_set_scene(b, c->sbl)) != SBL_SUCCESS) break;
            c->glossy = 0;
            fuzz_gather_gone(c, 0);
            break;
        case 1:
            i = (what >> 5 & 3) == 3 ? (int)(what >> 4 & 1) + 2 : (what >> 4 & 7) == 2;
            if (FUZZ_CALL(c, fuzz_known_scene(c->sbl, i)) != SBL_SUCCESS) break;
            c->glossy = i > 0;
            fuzz_gather_gone(c, 0);
            break;
        case 2:
            fuzz_transform(b, m);
            i = fuzz_int(b, 0, 2);
            if (FUZZ_CALL(c, sbl_set_mesh_transform(c->sbl, i, m)) == SBL_SUCCESS) fuzz_gather_gone(c, 0);
            break;
        case 3: fuzz_render(b, c, 0); break;
        case 4: fuzz_gathering(b, c, 0); break;
        case 5: fuzz_step(c, fuzz_seconds(b)); break;
        case 6: for (i = (int)(fuzz_byte(b) % 32); i >= 0; i--) fuzz_step(c, 1e-9); break;
        case 7: fuzz_render(b, c, 1); break;
        case 8: fuzz_gathering(b, c, 1); break;
        case 9:
            i = fuzz_int(b, 0, SBL_CHANNEL_COUNT - 1);
            fuzz_read(c, i, fuzz_byte(b) < 240 ? SIZE_MAX : fuzz_byte(b));
            break;
        case 10: sbl_channel_texture(c->sbl, (sbl_channel)fuzz_int(b, 0, SBL_CHANNEL_COUNT - 1)); break;
        case 11:
            i = fuzz_int(b, 0, FUZZ_SIDE - 1);
            fuzz_inspect(c, i, fuzz_int(b, 0, FUZZ_SIDE - 1), fuzz_byte(b) < 240 ? SIZE_MAX : fuzz_byte(b));
            break;
        case 12: sbl_end(c->sbl); fuzz_gather_gone(c, 0); break;
        case 13: fuzz_queries(b, c); break;
        case 14: fuzz_second(b, &fuzz.contexts[1]); break;
        default: fuzz_refuse(b, c); break;
    }
    FUZZ_CHECK(eglGetCurrentContext() == gl.context, "the host's GL context is not current any more");
}

/* >>inputs */

/* Renders the known picture, then sets an empty scene, so that only the constant memory of a context is in use. */
static sbl_result fuzz_known(fuzz_context *c, float picture[3 * 16]) {
    sbl_scene_desc empty;
    sbl_picture_desc view;
    sbl_result result = fuzz_known_scene(c->sbl, 0);
    memset(&empty, 0, sizeof empty);
    memset(&view, 0, sizeof view);
    view.width = view.height = view.options.rays = 4;
    view.tile = 2;
    view.samples = 1;
    view.options.mode = SBL_MODE_GI;
    if (result == SBL_SUCCESS) result = sbl_render_picture(c->sbl, &view);
    if (result == SBL_SUCCESS) result = sbl_read_channel(c->sbl, SBL_CHANNEL_FINAL, picture, 3 * 16);
    if (result == SBL_SUCCESS) result = sbl_set_scene(c->sbl, &empty);
    sbl_end(c->sbl);
    return result;
}

/* Called once per process. Returns 0 if there is no GL. */
static int fuzz_open(void) {
    static const unsigned char pixels[16] = { 255, 0, 0, 255, 0, 255, 0, 128, 0, 0, 255, 0, 9, 99, 200, 255 };
    float values[256];
    sbl_context_desc desc;
    int i;
    if (!gl_host_open()) return 0;
    for (i = 0; i < 256; i++) values[i] = (float)(i * 37 % 64) / 32 - 1;
    gl.GenBuffers(1, &fuzz.buffer);
    gl.BindBuffer(GL_ARRAY_BUFFER, fuzz.buffer);
    gl.BufferData(GL_ARRAY_BUFFER, sizeof values, values, GL_STATIC_DRAW);
    gl.GenTextures(1, &fuzz.texture);
    gl.BindTexture(GL_TEXTURE_2D, fuzz.texture);
    gl.TexImage2D(GL_TEXTURE_2D, 0, GL_RGBA8, 2, 2, 0, GL_RGBA, GL_UNSIGNED_BYTE, pixels);
    memset(&desc, 0, sizeof desc);
    desc.get_gl_function = gl_host_proc;
    fuzz_make(&fuzz.contexts[0], &desc);
    if (!fuzz.contexts[0].sbl || fuzz_known(&fuzz.contexts[0], fuzz.known) != SBL_SUCCESS) return 0;
    fuzz.memory = sbl_query_memory(fuzz.contexts[0].sbl);
    fuzz.blocks = fuzz.contexts[0].blocks;
    return 1;
}

static void fuzz_close(void) {
    fuzz_destroy(&fuzz.contexts[0]);
    host_gl_close();
}

static void fuzz_one(const unsigned char *data, size_t size) {
    fuzz_context *c = &fuzz.contexts[0];
    float picture[3 * 16];
    sbl_result result;
    sbl_memory memory;
    fuzz_bytes b;
    int calls;
    memset(&b, 0, sizeof b);
    b.at = data;
    b.end = data + size;
    for (calls = 0; calls < FUZZ_CALLS && b.at < b.end; calls++) fuzz_one_call(&b);
    fuzz_destroy(&fuzz.contexts[1]);
    c->refuse_in = c->refuse_on = 0;
    result = fuzz_known(c, picture);
    c->glossy = 0;
    fuzz_gather_gone(c, 0);
    memory = sbl_query_memory(c->sbl);
    FUZZ_CHECK(result == SBL_SUCCESS, "the known picture: %s", sbl_result_string(result));
    FUZZ_CHECK(result != SBL_SUCCESS || !memcmp(picture, fuzz.known, sizeof picture), "the known picture has changed");
    FUZZ_CHECK(memory.host_bytes == fuzz.memory.host_bytes && c->blocks == fuzz.blocks,
               "%.0f bytes in %d blocks, before %.0f bytes in %d", (double)memory.host_bytes, c->blocks,
               (double)fuzz.memory.host_bytes, fuzz.blocks);
    FUZZ_CHECK(memory.gpu_bytes == fuzz.memory.gpu_bytes, "%.0f bytes of GPU memory, before %.0f",
               (double)memory.gpu_bytes, (double)fuzz.memory.gpu_bytes);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);
int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    if (!fuzz.contexts[0].sbl && !fuzz_open()) abort();
    fuzz_one(data, size);
    if (fuzz_failures) abort();
    return 0;
}
