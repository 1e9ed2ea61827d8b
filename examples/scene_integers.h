/* Part of scene_file.h: converts the vertices of a .gltf or .glb that are stored as integers to floats, because assimp
   takes the bytes of integers for floats. These are positions and normals of KHR_mesh_quantization, and texture
   coordinates of any file. The floats become a file that exists only in memory. Its name is scene__floats_name, and the
   edited .gltf refers to it. */
#ifndef SCENE_INTEGERS_H
#define SCENE_INTEGERS_H

#include <math.h>
#include <stdlib.h>
#ifdef SBL_RENDER_CJSON
  #include <cjson/cJSON.h>
#endif

static const char scene__floats_name[] = ".sbl floats";

#ifdef SBL_RENDER_CJSON

static cJSON *scene__item(const cJSON *object, const char *name) {
    return cJSON_GetObjectItemCaseSensitive(object, name);
}

enum { SCENE__BYTE = 5120, SCENE__UNSIGNED_BYTE, SCENE__SHORT, SCENE__UNSIGNED_SHORT, SCENE__FLOAT = 5126 };

typedef struct scene__integers {
    scene_file *file;
    const char *path;    /* path of the .gltf file */
    scene__bytes inside; /* the binary part of a .glb */
    cJSON *root, *views;
    cJSON **accessor, **view;  /* items of the file's lists, because cJSON finds an item only by counting */
    int accessor_count, view_count, added_views;
    scene__bytes *read;  /* one per buffer of the file; data is NULL until it is read */
    int buffer_count;
    size_t room;
    scene__bytes *floats;
} scene__integers;

static int scene__digit_of_base64(char c) {
    return c >= 'A' && c <= 'Z' ? c - 'A' : c >= 'a' && c <= 'z' ? c - 'a' + 26 : c >= '0' && c <= '9' ? c - '0' + 52
         : c == '+' ? 62 : c == '/' ? 63 : -1;
}

/* Decodes base64 up to the first other character. Returns 0 if memory runs out. */
static int scene__decode_base64(const char *text, scene__bytes *out) {
    unsigned word = 0;
    int bits = 0;
    out->size = 0;
    out->data = (char *)malloc(strlen(text) + 1);
    for (; out->data && scene__digit_of_base64(*text) >= 0; text++) {
        word = word << 6 | (unsigned)scene__digit_of_base64(*text);
        bits += 6;
        if (bits < 8) continue;
        bits -= 8;
        out->data[out->size++] = (char)(word >> bits & 255);
    }
    return out->data != NULL;
}

/* Returns an array of the items of a list, which the caller frees, or NULL if memory runs out. */
static cJSON **scene__items_of(cJSON *list, int *count) {
    cJSON **items = (cJSON **)calloc((size_t)cJSON_GetArraySize(list) + 1, sizeof *items), *item;
    *count = 0;
    if (items) cJSON_ArrayForEach(item, list) items[(*count)++] = item;
    return items;
}

/* Returns the content of a buffer. Its data is NULL if it cannot be read. */
static scene__bytes scene__buffer(scene__integers *s, int number) {
    static const scene__bytes none = { NULL, 0 };
    const cJSON *const buffer = cJSON_GetArrayItem(scene__item(s->root, "buffers"), number);
    const char *const uri = cJSON_GetStringValue(scene__item(buffer, "uri"));
    const char *const comma = uri && strncmp(uri, "data:", 5) == 0 ? strchr(uri, ',') : NULL;
    scene__bytes *const read = number >= 0 && number < s->buffer_count ? &s->read[number] : NULL;
    if (!read) return none;
    if (!uri) return s->inside;
    if (!read->data && comma) scene__decode_base64(comma + 1, read);
    else if (!read->data) scene__slurp_named(s->file, s->path, uri, read);
    return *read;
}

static double scene__whole_of(const cJSON *object, const char *name, double otherwise) {
    const cJSON *number = scene__item(object, name);
    return cJSON_IsNumber(number) ? number->valuedouble : otherwise;
}

/* Returns the index of another item that an item refers to, or -1 if there is none. */
static int scene__index_of(const cJSON *object, const char *name) {
    const cJSON *number = scene__item(object, name);
    return cJSON_IsNumber(number) ? number->valueint : -1;
}

/* Returns a component as a number. normalized: 1: integers stand for -1 to 1, or 0 to 1 */
static float scene__component(const unsigned char *at, int type, int normalized) {
    static const double most[] = { 127, 255, 32767, 65535 };
    const int wide = type >= SCENE__SHORT, sign = type == SCENE__BYTE || type == SCENE__SHORT;
    int value = wide ? at[0] | at[1] << 8 : at[0];
    if (sign && value > (wide ? 32767 : 127)) value -= wide ? 65536 : 256;
    return (float)(normalized ? fmax(value / most[type - SCENE__BYTE], -1) : value);
}

/* Appends the components of an accessor to the floats. from: its first element; step: bytes between elements. Returns 0
   if memory runs out. */
static int scene__append_floats(scene__integers *s, const cJSON *accessor, const unsigned char *from, size_t step,
                                size_t count, size_t components) {
    const int type = (int)scene__whole_of(accessor, "componentType", 0);
    const int normalized = cJSON_IsTrue(scene__item(accessor, "normalized"));
    const size_t bytes = count * components * sizeof(float), size = type >= SCENE__SHORT ? 2 : 1;
    size_t i, k;
    char *more;
    if (!scene__afford(s->file, "its vertices as floats", 2.0 * (double)bytes, 0)) return 0;
    if (s->floats->size + bytes > s->room) {
        s->room = 2 * (s->floats->size + bytes);
        more = (char *)realloc(s->floats->data, s->room);
        if (!more) { scene__fail_for_memory(s->file, "its vertices as floats"); return 0; }
        s->floats->data = more;
    }
    for (i = 0; i < count; i++)
        for (k = 0; k < components; k++) {
            const float value = scene__component(from + i * step + k * size, type, normalized);
            memcpy(s->floats->data + s->floats->size, &value, sizeof value);
            s->floats->size += sizeof value;
        }
    return 1;
}

/* Lets an accessor refer to floats that begin at the byte `start`. */
static void scene__refer_to_floats(scene__integers *s, cJSON *accessor, size_t start) {
    static const char *const old[] = { "bufferView", "byteOffset", "componentType", "normalized", "min", "max" };
    cJSON *const view = cJSON_CreateObject();
    size_t i;
    for (i = 0; i < sizeof old / sizeof *old; i++) cJSON_DeleteItemFromObjectCaseSensitive(accessor, old[i]);
    cJSON_AddNumberToObject(accessor, "bufferView", s->view_count + s->added_views++);
    cJSON_AddNumberToObject(accessor, "componentType", SCENE__FLOAT);
    cJSON_AddNumberToObject(view, "buffer", s->buffer_count);
    cJSON_AddNumberToObject(view, "byteOffset", (double)start);
    cJSON_AddNumberToObject(view, "byteLength", (double)(s->floats->size - start));
    cJSON_AddItemToArray(s->views, view);
}

/* Converts an accessor that holds integers. */
static void scene__convert_accessor(scene__integers *s, cJSON *accessor) {
    const double type = scene__whole_of(accessor, "componentType", 0), count = scene__whole_of(accessor, "count", -1);
    const char *const shape = cJSON_GetStringValue(scene__item(accessor, "type"));
    const size_t start = s->floats->size, components = shape && strcmp(shape, "VEC2") == 0 ? 2 : 3;
    const double element = (double)components * (type >= SCENE__SHORT ? 2 : 1);
    const int number = scene__index_of(accessor, "bufferView");
    const cJSON *const view = number >= 0 && number < s->view_count ? s->view[number] : NULL;
    const double step = scene__whole_of(view, "byteStride", element), at = scene__whole_of(accessor, "byteOffset", 0);
    const double begin = scene__whole_of(view, "byteOffset", 0), size = scene__whole_of(view, "byteLength", 0);
    scene__bytes bytes;
    if (!(type >= SCENE__BYTE && type <= SCENE__UNSIGNED_SHORT)) return;
    bytes = scene__buffer(s, scene__index_of(view, "buffer"));
    if (!bytes.data || !(count >= 1 && count < 1e9 && at >= 0 && begin >= 0 && step >= element && step <= 252) ||
        at + step * (count - 1) + element > size || begin + size > (double)bytes.size ||
        scene__item(accessor, "sparse")) {
        scene__fail(s->file, "it stores vertices as integers in a way that cannot be read; export them as floats");
        return;
    }
    if (scene__append_floats(s, accessor, (const unsigned char *)bytes.data + (size_t)begin + (size_t)at, (size_t)step,
                             (size_t)count, components))
        scene__refer_to_floats(s, accessor, start);
}

/* Converts the positions, normals and texture coordinates of all meshes. path: of the .gltf; inside: the binary part of
   a .glb; floats: receives the content of the file scene__floats_name, which the caller frees */
static void scene__convert_integers(scene_file *file, const char *path, scene__bytes inside, cJSON *root,
                                    scene__bytes *floats) {
    const cJSON *mesh, *primitive, *attribute;
    cJSON *const buffers = scene__item(root, "buffers"), *buffer;
    scene__integers s;
    int i;
    memset(&s, 0, sizeof s);
    s.file = file;
    s.path = path;
    s.inside = inside;
    s.root = root;
    s.views = scene__item(root, "bufferViews");
    s.buffer_count = cJSON_GetArraySize(buffers);
    s.read = (scene__bytes *)calloc((size_t)s.buffer_count + 1, sizeof *s.read);
    s.floats = floats;
    s.accessor = scene__items_of(scene__item(root, "accessors"), &s.accessor_count);
    s.view = scene__items_of(s.views, &s.view_count);
    if (!s.read || !s.accessor || !s.view) scene__fail_for_memory(file, "it");
    cJSON_ArrayForEach(mesh, scene__item(root, "meshes"))
        cJSON_ArrayForEach(primitive, scene__item(mesh, "primitives"))
            cJSON_ArrayForEach(attribute, scene__item(primitive, "attributes")) {
                const char *name = attribute->string;
                const int number = cJSON_IsNumber(attribute) ? attribute->valueint : -1;
                if (file->error[0] || !name || number < 0 || number >= s.accessor_count) continue;
                if (strcmp(name, "POSITION") == 0 || strcmp(name, "NORMAL") == 0 || strncmp(name, "TEXCOORD_", 9) == 0)
                    scene__convert_accessor(&s, s.accessor[number]);
            }
    if (floats->size) {
        buffer = cJSON_CreateObject();
        cJSON_AddStringToObject(buffer, "uri", scene__floats_name);
        cJSON_AddNumberToObject(buffer, "byteLength", (double)floats->size);
        cJSON_AddItemToArray(buffers, buffer);
    }
    for (i = 0; s.read && i < s.buffer_count; i++) free(s.read[i].data);
    free(s.read);
    free(s.accessor);
    free(s.view);
}

#endif

#endif
