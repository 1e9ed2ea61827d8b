/* A fuzz target: bytes become a scene and a picture, mostly wrong ones; sbl.h must refuse them with a message or render them without NaN.
   tests/test_bad_input.c runs a bounded, repeatable part of it. By itself, for as long as wanted:

       clang -g -O1 -fsanitize=fuzzer,address,undefined tests/fuzz_scene.c -lEGL -lm -o build/fuzz_scene && build/fuzz_scene

   Client arrays are allocated at exactly the size that their descriptor asks for, so that the address sanitizer sees every byte read past it. */
#ifndef SBL_IMPLEMENTATION
#define SBL_IMPLEMENTATION
#define SBL_EGL
#include "../sbl.h"
#define FUZZ_ALONE
#endif
#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

enum { FUZZ_MESHES = 3, FUZZ_MATERIALS = 3, FUZZ_TEXTURES = 2, FUZZ_LIGHTS = 2, FUZZ_ARRAY = 1 << 14 };

typedef struct fuzz_bytes { const unsigned char *at, *end; void *blocks[64]; int block_count; } fuzz_bytes;

static int fuzz_accepted, fuzz_refused, fuzz_rendered, fuzz_silent, fuzz_odd;

static unsigned fuzz_byte(fuzz_bytes *b) { return b->at < b->end ? *b->at++ : 0; }

/* Mostly one of the good values, sometimes a wild one. */
static int fuzz_int(fuzz_bytes *b, int lowest, int highest) {
    static const int wild[8] = { -1, -2147483647 - 1, 2147483647, 65536, 0, 3, 1 << 24, -65537 };
    unsigned byte = fuzz_byte(b);
    return byte >= 254 ? wild[fuzz_byte(b) % 8] : lowest + (int)(byte % (unsigned)(highest - lowest + 1));
}

static float fuzz_float(fuzz_bytes *b, float lowest, float highest) {
    static const float wild[8] = { -1, 0, 1e30f, 1e-40f, 1e9f, -1e-9f, 1e17f, 2 };
    unsigned byte = fuzz_byte(b);
    if (byte >= 254) return wild[fuzz_byte(b) % 8];
    if (byte == 253) return fuzz_byte(b) & 1 ? (float)NAN : (float)HUGE_VAL;
    return lowest + (highest - lowest) * (float)byte / 252;
}

static void *fuzz_block(fuzz_bytes *b, size_t bytes) {
    void *block = malloc(bytes ? bytes : 1);
    if (!block || b->block_count == 64) abort();
    b->blocks[b->block_count++] = block;
    return block;
}

/* A stream of `count` elements in an array that ends with its last byte. Absent where it would be large but not too large to exist. */
static void fuzz_stream(fuzz_bytes *b, sbl_stream *s, int components, int count, int indices, int vertices) {
    static const int sizes[SBL_TYPE_COUNT] = { 4, 2, 1, 2, 1, 2, 1, 2, 4 };
    int type = indices ? fuzz_int(b, SBL_UINT8, SBL_UINT32) : fuzz_int(b, 0, 1);
    size_t element, stride, bytes, i;
    unsigned char *data;
    s->type = (sbl_type)type;
    element = (size_t)(type < 0 || type >= SBL_TYPE_COUNT ? 4 : sizes[type]) * (size_t)components;
    if (fuzz_byte(b) % 4 == 0) s->stride = fuzz_byte(b) >= 253 ? SIZE_MAX / (size_t)(1 + fuzz_byte(b) % 8) : element + fuzz_byte(b) % 16;
    if (fuzz_byte(b) % 4 == 0) s->offset = fuzz_byte(b) >= 253 ? SIZE_MAX - fuzz_byte(b) : fuzz_byte(b);
    stride = s->stride ? s->stride : element;
    if (count <= 0) { s->data = fuzz_block(b, 1); return; }
    if (s->offset > FUZZ_ARRAY || stride > FUZZ_ARRAY || stride * (size_t)count > FUZZ_ARRAY) {
        /* what is more than memory must be refused; what only is large would be read */
        if (s->offset > SIZE_MAX / 2 || (size_t)count - 1 > SIZE_MAX / 2 / stride) s->data = fuzz_block(b, 1);
        else memset(s, 0, sizeof *s);
        return;
    }
    bytes = s->offset + stride * ((size_t)count - 1) + element;
    data = (unsigned char *)fuzz_block(b, bytes);
    memset(data, 0, bytes);
    for (i = 0; i < (size_t)count * (size_t)components; i++) {
        unsigned char *to = data + s->offset + i / (size_t)components * stride + i % (size_t)components * (element / (size_t)components);
        if (indices) *to = (unsigned char)(fuzz_byte(b) % (unsigned)(vertices > 0 && vertices < 256 ? vertices + (fuzz_byte(b) > 250) : 1));  /* little-endian; else the other byte */
        else if (type == SBL_FLOAT32) { float value = fuzz_float(b, components == 4 ? 0.0f : -1.0f, 1); memcpy(to, &value, 4); }
        else { unsigned half = fuzz_byte(b) * 60; to[0] = (unsigned char)half; to[1] = (unsigned char)(half >> 8); }
    }
    s->data = data;
}

/* A picture in an array that ends with its last byte. */
static void fuzz_texture(fuzz_bytes *b, sbl_texture *t) {
    size_t texel, bytes, at;
    t->format = (sbl_pixel_format)fuzz_int(b, 0, 2);
    t->width = fuzz_int(b, 1, 9);
    t->height = fuzz_int(b, 1, 9);
    t->channels = fuzz_int(b, 0, 4);
    t->wrap = (sbl_wrap)fuzz_int(b, 0, 1);
    texel = (size_t)(t->channels < 1 || t->channels > 4 ? 4 : t->channels) * (t->format == SBL_PIXELS_FLOAT ? 4 : 1);
    if (t->width > 64 || t->height > 64) t->width = 0;  /* large, but not wrong: it would be read */
    if (t->width < 1 || t->height < 1) { t->pixels = fuzz_block(b, 1); return; }
    if (fuzz_byte(b) % 4 == 0) t->stride = texel * (size_t)t->width + fuzz_byte(b) % 8;
    bytes = (t->stride ? t->stride : texel * (size_t)t->width) * (size_t)(t->height - 1) + texel * (size_t)t->width;
    t->pixels = fuzz_block(b, bytes);
    memset(b->blocks[b->block_count - 1], 0, bytes);
    for (at = 0; at + 4 <= bytes; at += 4) {
        float value = fuzz_float(b, 0, 1);
        unsigned char *to = (unsigned char *)b->blocks[b->block_count - 1] + at;
        if (t->format == SBL_PIXELS_FLOAT) memcpy(to, &value, 4);
        else *to = (unsigned char)fuzz_byte(b);
    }
}

static void fuzz_sky(const float direction[3], float radiance[3], void *user) {
    int i;
    (void)user;
    for (i = 0; i < 3; i++) radiance[i] = direction[i] > 0 ? direction[i] : 0;
}

static const int *fuzz_messages;  /* how many the logger has had; set by the caller */

/* sbl.h takes NaN nowhere, so none may come out. */
static void fuzz_one(sbl_context *context, const unsigned char *data, size_t size) {
    static float picture[16 * 16 * 3];
    sbl_mesh meshes[FUZZ_MESHES];
    sbl_material materials[FUZZ_MATERIALS];
    sbl_texture textures[FUZZ_TEXTURES];
    sbl_light lights[FUZZ_LIGHTS];
    sbl_scene_desc scene;
    sbl_picture_desc view;
    fuzz_bytes b = { 0 };
    int i, k, messages, tame = 1;
    sbl_result result;
    b.at = data;
    b.end = data + size;
    memset(meshes, 0, sizeof meshes);
    memset(materials, 0, sizeof materials);
    memset(textures, 0, sizeof textures);
    memset(lights, 0, sizeof lights);
    memset(&scene, 0, sizeof scene);
    memset(&view, 0, sizeof view);
    scene.meshes = meshes;
    scene.mesh_count = (int)(fuzz_byte(&b) % (FUZZ_MESHES + 1));
    scene.materials = materials;
    scene.material_count = FUZZ_MATERIALS;
    scene.textures = textures;
    scene.texture_count = (int)(fuzz_byte(&b) % (FUZZ_TEXTURES + 1));
    scene.lights = lights;
    scene.light_count = (int)(fuzz_byte(&b) % (FUZZ_LIGHTS + 1));
    for (i = 0; i < 3; i++) scene.sky[i] = fuzz_float(&b, 0, 2);
    for (i = 0; i < FUZZ_MATERIALS; i++) {
        for (k = 0; k < 3; k++) materials[i].albedo[k] = fuzz_float(&b, 0, 1);
        for (k = 0; k < 3; k++) materials[i].emission[k] = fuzz_float(&b, 0, 4);
        for (k = 0; k < 3; k++) if (!(materials[i].emission[k] < 1e20f)) tame = 0;  /* light beyond the range of floats is the host's */
        materials[i].albedo_texture = scene.texture_count ? fuzz_int(&b, 0, scene.texture_count) : 0;
        materials[i].emission_texture = scene.texture_count ? fuzz_int(&b, 0, scene.texture_count) : 0;
        materials[i].alpha_cutoff = fuzz_byte(&b) % 2 ? 0 : fuzz_float(&b, 0, 1);
        materials[i].flags = fuzz_byte(&b) % 9;
    }
    for (i = 0; i < 3; i++) if (!(scene.sky[i] < 1e20f)) tame = 0;
    for (i = 0; i < scene.texture_count; i++) fuzz_texture(&b, &textures[i]);
    for (i = 0; i < scene.light_count; i++) {
        sbl_light *l = &lights[i];
        l->kind = (sbl_light_kind)fuzz_int(&b, 0, SBL_LIGHT_KIND_COUNT - 1);
        for (k = 0; k < 3; k++) l->intensity[k] = fuzz_float(&b, 0, 4);
        for (k = 0; k < 3; k++) if (!(l->intensity[k] < 1e20f)) tame = 0;
        for (k = 0; k < 3; k++) l->position[k] = fuzz_float(&b, -2, 2);
        for (k = 0; k < 3; k++) l->direction[k] = fuzz_float(&b, -1, 1);
        if (fuzz_byte(&b) % 2) l->radius = fuzz_float(&b, 0, 1);
        if (fuzz_byte(&b) % 2) l->angle = fuzz_float(&b, 0, 180);
        if (fuzz_byte(&b) % 2) l->cone = fuzz_float(&b, 1, 180);
        if (fuzz_byte(&b) % 2) l->inner_cone = fuzz_float(&b, 0, 45);
    }
    if (fuzz_byte(&b) % 3 == 0) {
        sbl_environment *e = &scene.environment;
        fuzz_texture(&b, &e->picture);
        e->picture.wrap = SBL_WRAP_REPEAT;
        if (fuzz_byte(&b) % 4 == 0) { e->radiance = fuzz_sky; e->picture.pixels = NULL; }
        e->scale = fuzz_float(&b, 0, 4);
        if (!(e->scale < 1e8f)) tame = 0;
        e->rotation = fuzz_float(&b, -180, 180);
        for (k = 0; k < 3; k++) e->up[k] = fuzz_float(&b, -1, 1);
    }
    for (i = 0; i < scene.mesh_count; i++) {
        sbl_mesh *m = &meshes[i];
        int indexed = fuzz_byte(&b) % 2 == 0;
        m->vertex_count = fuzz_int(&b, 1, 4);
        m->index_count = fuzz_int(&b, 1, 5);
        if (m->vertex_count > 0 && m->vertex_count < 5) m->vertex_count *= 3;
        if (m->index_count > 0 && m->index_count < 6) m->index_count *= 3;
        fuzz_stream(&b, &m->positions, 3, m->vertex_count, 0, 0);
        if (fuzz_byte(&b) % 4 == 0) fuzz_stream(&b, &m->normals, 3, m->vertex_count, 0, 0);
        if (fuzz_byte(&b) % 4 == 0) fuzz_stream(&b, &m->texcoords, 2, m->vertex_count, 0, 0);
        if (fuzz_byte(&b) % 4 == 0) fuzz_stream(&b, &m->colors, 4, m->vertex_count, 0, 0);
        if (indexed) fuzz_stream(&b, &m->indices, 1, m->index_count, 1, m->vertex_count);
        m->material = fuzz_int(&b, 0, FUZZ_MATERIALS - 1);
        if (fuzz_byte(&b) % 4 == 0) {
            for (k = 0; k < 12; k++) m->transform[k + k / 3] = fuzz_float(&b, -2, 2);
            m->transform[3] = m->transform[7] = m->transform[11] = 0;
            m->transform[15] = 1;
        }
        m->id = fuzz_byte(&b);
    }
    messages = *fuzz_messages;
    result = sbl_set_scene(context, &scene);
    if (result == SBL_SUCCESS) fuzz_accepted++; else fuzz_refused++;
    if (result == SBL_SUCCESS) {
        view.width = 1 + (int)(fuzz_byte(&b) % 16);
        view.height = 1 + (int)(fuzz_byte(&b) % 16);
        view.mode = (sbl_mode)fuzz_int(&b, 0, SBL_MODE_PAPER);
        view.backend = (sbl_backend)fuzz_int(&b, 0, 2);
        view.rays = fuzz_int(&b, 1, 40);
        if (view.rays > 4000) view.rays = 4000;
        view.sensor_size = fuzz_int(&b, 4, 16);
        if (view.sensor_size > 64) view.sensor_size = 64;
        view.sensor_fov = fuzz_float(&b, 1, 179);
        view.tile = fuzz_int(&b, 1, 8);
        view.threshold = fuzz_float(&b, 0, 1);
        view.epsilon = fuzz_float(&b, 0, 1);
        if (!(view.epsilon < 1e20f)) tame = 0;
        view.filter_radius = fuzz_int(&b, -1, 3);
        view.samples = 1 + (int)(fuzz_byte(&b) % 3);
        view.seed = fuzz_byte(&b);
        if (fuzz_byte(&b) % 2) {
            float from[3];
            for (k = 0; k < 3; k++) from[k] = fuzz_float(&b, -3, 3);
            sbl_look_at(view.world_to_view, from[0], from[1], from[2], 0, 0, 0, 0, 1, 0);
        }
        result = sbl_render(context, &view);
        if (result == SBL_SUCCESS) {
            int floats = 3 * view.width * view.height;
            fuzz_rendered++;
            result = sbl_read_channel(context, SBL_CHANNEL_FINAL, picture, sizeof picture / sizeof *picture);
            for (i = 0; i < floats; i++) if (picture[i] != picture[i] && tame) break;
            if (i < floats) fuzz_odd++;
        }
    }
    if (result != SBL_SUCCESS && *fuzz_messages == messages) fuzz_silent++;
    for (i = 0; i < b.block_count; i++) free(b.blocks[i]);
}

#ifdef FUZZ_ALONE
static int fuzz_logged;
static void fuzz_log(sbl_log_level level, sbl_log_item item, const char *message, void *user) {
    (void)level; (void)item; (void)message; (void)user;
    fuzz_logged++;
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);
int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    static sbl_context *context;
    sbl_context_desc desc;
    memset(&desc, 0, sizeof desc);
    desc.logger.log = fuzz_log;
    fuzz_messages = &fuzz_logged;
    if (!context && sbl_create(&desc, &context) != SBL_SUCCESS) abort();
    fuzz_one(context, data, size);
    if (fuzz_odd || fuzz_silent) abort();
    return 0;
}
#endif
