/* Reads a scene file into the arrays that sbl_set_scene takes: everything assimp reads (.obj, .gltf, .glb, .fbx, .ply, ...), pictures through
   stb_image. Include after sbl.h, with _DEFAULT_SOURCE defined before the first header; link with -lassimp.

       char error[512];
       scene_file *file = scene_file_load("room.glb", NULL, error, sizeof error);
       if (!file) { fprintf(stderr, "%s\n", error); return 1; }
       sbl_set_scene(context, &file->scene);
       scene_file_free(file);

   scene_file_load_sky reads a picture of the sky in the same way, into scene.environment.picture.

   What is read: triangles and polygons (points and lines are left out), normals where the file has them, one set of texture coordinates, vertex
   colours, nodes with their transforms (each use of a mesh is an sbl_mesh with an id of its own), the first perspective camera, point, spot and
   directional lights, and

       OBJ   Kd map_Kd Ke map_Ke d map_d: a constant d below 0.5 leaves the mesh out, map_d becomes the alpha of the albedo texture, cut off
             at 0.5; map_Ke without Ke counts as Ke 1 1 1
       glTF  baseColor, emissive times KHR_materials_emissive_strength (needs cJSON: define SBL_RENDER_CJSON, link with -lcjson),
             alphaMode MASK with its cutoff, BLEND as a cutout at 0.5; metal and gloss are left out. KHR_lights_punctual without ranges; that
             several nodes may share a light needs cJSON, too
       else  the colour of a light is its intensity; how it is attenuated besides by distance is left out

   A file from a stranger can crash its reader, make it hang or eat all memory. So a child process reads it, with a limit of time and memory, into
   pages that both share; only when the child has ended well is the result used. */
#ifndef SCENE_FILE_H
#define SCENE_FILE_H

#include <errno.h>
#include <math.h>
#include <poll.h>
#include <signal.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>
#include <fcntl.h>
#include <sys/mman.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>
#include <assimp/cfileio.h>
#include <assimp/cimport.h>
#include <assimp/GltfMaterial.h>
#include <assimp/light.h>
#include <assimp/material.h>
#include <assimp/postprocess.h>
#include <assimp/scene.h>
#ifdef SBL_RENDER_CJSON
  #include <cjson/cJSON.h>
#endif
#define STB_IMAGE_IMPLEMENTATION
#define STBI_NO_STDIO
#define STBI_MAX_DIMENSIONS 16384
#include <stb/stb_image.h>
#if defined(__SANITIZE_ADDRESS__)
  #define SCENE__SANITIZED 1
#elif defined(__has_feature)
  #if __has_feature(address_sanitizer)
    #define SCENE__SANITIZED 1
  #endif
#endif
#ifdef SCENE__SANITIZED
  #include <sanitizer/lsan_interface.h>
#endif

enum { SCENE_FILE_WARNINGS = 8, SCENE_FILE_SECONDS = 30, SCENE_FILE_READ = 1024 };

typedef struct scene_file_camera {
    float eye[3], forward[3], up[3], fov_y, fov_x;
} scene_file_camera; /* degrees; one of the two angles is 0 */

typedef struct scene_file {
    sbl_scene_desc scene;         /* sky left black; or nothing but a picture of the sky */
    const char *const *names;     /* of the meshes */
    int has_camera;
    scene_file_camera camera;
    int warning_count;            /* of which the first are kept */
    char warnings[SCENE_FILE_WARNINGS][256];
    int read_count;               /* of the files that were read, the first ones */
    struct { dev_t device; ino_t inode; } read[SCENE_FILE_READ];
    /* private */
    char error[512];
    size_t capacity, used;        /* of the pages, which begin with this struct */
} scene_file;

static void scene__print(char *out, size_t size, const char *format, ...) {
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(out, size, format, arguments);  /* cut off where it is too long */
    va_end(arguments);
}

static void scene__fail(scene_file *file, const char *format, ...) {
    va_list arguments;
    va_start(arguments, format);
    if (!file->error[0]) vsnprintf(file->error, sizeof file->error, format, arguments);
    va_end(arguments);
}

static void scene__warn(scene_file *file, const char *format, ...) {
    va_list arguments;
    int i;
    char text[sizeof file->warnings[0]];
    va_start(arguments, format);
    vsnprintf(text, sizeof text, format, arguments);
    va_end(arguments);
    for (i = 0; i < file->warning_count && i < SCENE_FILE_WARNINGS; i++)
        if (strcmp(file->warnings[i], text) == 0) return;
    if (file->warning_count < SCENE_FILE_WARNINGS) strcpy(file->warnings[file->warning_count], text);
    file->warning_count++;
}

/* Zeroed memory in the shared pages; NULL, and an error, where they are full. */
static void *scene__alloc(scene_file *file, size_t count, size_t bytes) {
    size_t room = file->capacity - file->used, size;
    if (bytes && count > (SIZE_MAX - 15) / bytes) room = 0;
    size = (count * bytes + 15) & ~(size_t)15;
    if (size > room) {
        scene__fail(file, "it needs more than %.0f MB of memory; use a smaller scene or smaller textures", (double)file->capacity / 1e6);
        return NULL;
    }
    file->used += size;
    return (char *)file + file->used - size;
}

/* ---- files: assimp is given whole files from memory, so that a glTF file can be mended before it sees it ---- */

typedef struct scene__bytes { char *data; size_t size; } scene__bytes;

static scene_file *scene__reading;  /* what this process reads; NULL: nothing */

/* Reads a regular file whole; 0 and errno where that fails. The time limit grows with what there is to read. */
static int scene__slurp(const char *path, scene__bytes *out) {
    struct stat info;
    size_t got = 0;
    ssize_t n = 1;
    int handle = open(path, O_RDONLY | O_NONBLOCK);  /* a pipe nobody writes to must not block */
    out->data = NULL;
    if (handle < 0) return 0;
    if (fstat(handle, &info) == 0 && !S_ISREG(info.st_mode)) {
        close(handle);
        errno = S_ISDIR(info.st_mode) ? EISDIR : EINVAL;
        return 0;
    }
    if (scene__reading && scene__reading->read_count < SCENE_FILE_READ) {
        scene__reading->read[scene__reading->read_count].device = info.st_dev;
        scene__reading->read[scene__reading->read_count++].inode = info.st_ino;
    }
    out->size = (size_t)info.st_size;
    out->data = (char *)malloc(out->size + 1);
    while (out->data && got < out->size && n > 0) {
        n = read(handle, out->data + got, out->size - got);
        if (n > 0) got += (size_t)n;
    }
    close(handle);
    if (!out->data || n < 0) {
        if (!out->data) errno = ENOMEM;
        free(out->data);
        out->data = NULL;
        return 0;
    }
    out->size = got;
    out->data[got] = 0;
    alarm(alarm(0) + (unsigned)(got >> 19));
    return 1;
}

typedef struct scene__stream { scene__bytes bytes; size_t at; int shared; } scene__stream;
typedef struct scene__main_file { const char *path; scene__bytes bytes; } scene__main_file;

static scene__stream *scene__of(struct aiFile *file) { return (scene__stream *)(void *)file->UserData; }

static size_t scene__read(struct aiFile *file, char *out, size_t size, size_t count) {
    scene__stream *s = scene__of(file);
    size_t whole = size ? (s->bytes.size - s->at) / size : 0;
    if (count > whole) count = whole;
    memcpy(out, s->bytes.data + s->at, size * count);
    s->at += size * count;
    return count;
}
static size_t scene__write(struct aiFile *file, const char *data, size_t size, size_t count) { (void)file; (void)data; (void)size; (void)count; return 0; }
static size_t scene__tell(struct aiFile *file) { return scene__of(file)->at; }
static size_t scene__size(struct aiFile *file) { return scene__of(file)->bytes.size; }
static void scene__flush(struct aiFile *file) { (void)file; }
static enum aiReturn scene__seek(struct aiFile *file, size_t offset, enum aiOrigin origin) {
    scene__stream *s = scene__of(file);
    size_t from = origin == aiOrigin_SET ? 0 : origin == aiOrigin_CUR ? s->at : s->bytes.size;
    if (from + offset > s->bytes.size) return aiReturn_FAILURE;  /* offsets back from the end wrap around as they should */
    s->at = from + offset;
    return aiReturn_SUCCESS;
}

static struct aiFile *scene__open(struct aiFileIO *io, const char *path, const char *mode) {
    scene__main_file *main_file = (scene__main_file *)(void *)io->UserData;
    scene__stream *s = (scene__stream *)calloc(1, sizeof *s);
    struct aiFile *file = (struct aiFile *)calloc(1, sizeof *file);
    if (!s || !file || strchr(mode, 'w') || strchr(mode, 'a')) goto fail;
    if (strcmp(path, main_file->path) == 0) {
        s->bytes = main_file->bytes;
        s->shared = 1;
    } else if (!scene__slurp(path, &s->bytes)) goto fail;
    file->ReadProc = scene__read;
    file->WriteProc = scene__write;
    file->TellProc = scene__tell;
    file->FileSizeProc = scene__size;
    file->SeekProc = scene__seek;
    file->FlushProc = scene__flush;
    file->UserData = (char *)s;
    return file;
fail:
    free(s);
    free(file);
    return NULL;
}

static void scene__close(struct aiFileIO *io, struct aiFile *file) {
    (void)io;
    if (!scene__of(file)->shared) free(scene__of(file)->bytes.data);
    free(scene__of(file));
    free(file);
}

static int scene__ends_with(const char *path, const char *ending) {
    size_t a = strlen(path), b = strlen(ending);
    return a >= b && strcasecmp(path + a - b, ending) == 0;
}

#ifdef SBL_RENDER_CJSON
static const cJSON *scene__item(const cJSON *object, const char *name) { return cJSON_GetObjectItemCaseSensitive(object, name); }

static void scene__part_lights(scene_file *file, cJSON *root, const char *extension) {
    const cJSON *old = scene__item(scene__item(scene__item(root, "extensions"), extension), "lights");
    cJSON *lights = cJSON_CreateArray(), *node;
    const int count = cJSON_GetArraySize(old);
    int number = 0;
    cJSON_ArrayForEach(node, scene__item(root, "nodes")) {
        cJSON *use = cJSON_GetObjectItemCaseSensitive(scene__item(node, "extensions"), extension);
        const cJSON *index = scene__item(use, "light"), *light;
        const char *name = cJSON_GetStringValue(scene__item(node, "name")), *type;
        char unique[256];
        scene__print(unique, sizeof unique, "%.200s (node %d)", name ? name : "without name", number++);
        if (!use) continue;
        light = cJSON_IsNumber(index) && index->valuedouble >= 0 && index->valuedouble < count ? cJSON_GetArrayItem(old, index->valueint) : NULL;
        type = cJSON_GetStringValue(scene__item(light, "type"));
        if (type && (strcmp(type, "point") == 0 || strcmp(type, "directional") == 0 ||
                     (strcmp(type, "spot") == 0 && cJSON_IsObject(scene__item(light, "spot"))))) {
            cJSON_ReplaceItemInObjectCaseSensitive(use, "light", cJSON_CreateNumber(cJSON_GetArraySize(lights)));
            cJSON_AddItemToArray(lights, cJSON_Duplicate(light, 1));
            cJSON_DeleteItemFromObjectCaseSensitive(node, "name");
            cJSON_AddStringToObject(node, "name", unique);
        } else {
            scene__warn(file, "light of %s: it is no point, spot or directional light and was left out", unique);
            cJSON_DeleteItemFromObjectCaseSensitive(cJSON_GetObjectItemCaseSensitive(node, "extensions"), extension);
        }
    }
    node = cJSON_GetObjectItemCaseSensitive(cJSON_GetObjectItemCaseSensitive(root, "extensions"), extension);
    if (!old || !cJSON_ReplaceItemInObjectCaseSensitive(node, "lights", lights)) cJSON_Delete(lights);
}
#endif

/* assimp up to 5.2 drops KHR_materials_emissive_strength, and materials come out of it in another order than the file has them: so the strength
   is multiplied into emissiveFactor beforehand. A camera's aspectRatio is taken away, which makes every version of assimp hand over yfov itself.
   assimp tells where a light is by the name of one node: so each node gets a light of its own and a name that no other has.
   bytes: a .gltf or .glb, replaced where there was something to mend. What is not valid is left for assimp to complain about. */
static void scene__mend_gltf(scene_file *file, scene__bytes *bytes) {
    static const char strength_name[] = "KHR_materials_emissive_strength", lights_name[] = "KHR_lights_punctual";
    unsigned char *head = (unsigned char *)bytes->data;
    int binary = bytes->size >= 20 && memcmp(head, "glTF", 4) == 0;
    size_t start = binary ? 20 : 0, length = bytes->size - start, i;
    int strength_used = 0, aspect_used = 0, lights_used = 0;
    if (binary) {
        length = head[12] | (size_t)head[13] << 8 | (size_t)head[14] << 16 | (size_t)head[15] << 24;
        if (length > bytes->size - start) return;
    }
    for (i = start; i + sizeof strength_name <= start + length; i++) {
        if (bytes->data[i] == 'K' && memcmp(bytes->data + i, strength_name, sizeof strength_name - 1) == 0) strength_used = 1;
        if (bytes->data[i] == 'K' && memcmp(bytes->data + i, lights_name, sizeof lights_name - 1) == 0) lights_used = 1;
        if (bytes->data[i] == 'a' && memcmp(bytes->data + i, "aspectRatio", 11) == 0) aspect_used = 1;
    }
    if (!strength_used && !aspect_used && !lights_used) return;
#ifdef SBL_RENDER_CJSON
    {
        cJSON *root = cJSON_ParseWithLength(bytes->data + start, length), *item, *number;
        char *text = NULL, *joined = NULL;
        if (!root) return;
        cJSON_ArrayForEach(item, cJSON_GetObjectItemCaseSensitive(root, "materials")) {
            cJSON *extensions = cJSON_GetObjectItemCaseSensitive(item, "extensions");
            cJSON *strength =
                cJSON_GetObjectItemCaseSensitive(cJSON_GetObjectItemCaseSensitive(extensions, strength_name), "emissiveStrength");
            if (cJSON_IsNumber(strength))
                cJSON_ArrayForEach(number, cJSON_GetObjectItemCaseSensitive(item, "emissiveFactor"))
                    if (cJSON_IsNumber(number)) cJSON_SetNumberHelper(number, number->valuedouble * strength->valuedouble);
            cJSON_DeleteItemFromObjectCaseSensitive(extensions, strength_name);
        }
        cJSON_ArrayForEach(item, cJSON_GetObjectItemCaseSensitive(root, "cameras"))
            cJSON_DeleteItemFromObjectCaseSensitive(cJSON_GetObjectItemCaseSensitive(item, "perspective"), "aspectRatio");
        if (lights_used) scene__part_lights(file, root, lights_name);
        text = cJSON_PrintUnformatted(root);
        if (text) {
            size_t text_size = strlen(text), padded = binary ? (text_size + 3) & ~(size_t)3 : text_size, rest = bytes->size - start - length;
            joined = (char *)malloc(start + padded + rest + 1);
            if (joined) {
                memcpy(joined, bytes->data, start);
                memcpy(joined + start, text, text_size);
                memset(joined + start + text_size, ' ', padded - text_size);
                memcpy(joined + start + padded, bytes->data + start + length, rest);
                joined[start + padded + rest] = 0;
                for (i = 0; binary && i < 4; i++) {
                    joined[8 + i] = (char)((start + padded + rest) >> 8 * i & 255);
                    joined[12 + i] = (char)(padded >> 8 * i & 255);
                }
                free(bytes->data);
                bytes->data = joined;
                bytes->size = start + padded + rest;
            }
        }
        cJSON_free(text);
        cJSON_Delete(root);
        if (!joined) scene__fail(file, "out of memory while mending it");
    }
#else
    if (strength_used) scene__warn(file, "built without cJSON: %s is not read, lamps may be too dark", strength_name);
#endif
}

/* assimp takes "v .5 -.5 0" for a line with one number: the noughts before the points are put in beforehand. */
static void scene__mend_obj(scene_file *file, scene__bytes *bytes) {
    size_t i, inserted = 0, pass;
    char *out = NULL;
    for (pass = 0; pass < 2; pass++) {  /* count, then copy */
        int vertex = 0, line_start = 1;
        char last = '\n';
        if (pass == 1) {
            if (!inserted) return;
            out = (char *)malloc(bytes->size + inserted + 1);
            if (!out) { scene__fail(file, "out of memory while mending it"); return; }
            inserted = 0;
        }
        for (i = 0; i < bytes->size; i++) {
            char c = bytes->data[i];
            if (c == '\n' || c == '\r') line_start = 1;
            else if (line_start && c != ' ' && c != '\t') { vertex = c == 'v'; line_start = 0; }
            if (vertex && c == '.' && (last == ' ' || last == '\t' || last == '-' || last == '+')) {
                if (out) out[i + inserted] = '0';
                inserted++;
            }
            if (out) out[i + inserted] = c;
            last = c;
        }
    }
    out[bytes->size + inserted] = 0;
    free(bytes->data);
    bytes->data = out;
    bytes->size += inserted;
}

/* ---- textures and materials ---- */

typedef struct scene__picture { const char *path; enum aiTextureMapMode wrap[2]; unsigned set; } scene__picture;
typedef struct scene__pixels { void *data; int width, height, channels, is_float; } scene__pixels;  /* stb_image's memory */

typedef struct scene__reader {
    scene_file *file;
    const char *path;
    const struct aiScene *in;
    sbl_material *materials;
    sbl_texture *textures;
    int texture_count, texture_room;
    struct scene__texture_key { char *albedo, *mask; sbl_wrap wrap; } *keys;  /* of each texture; malloc's memory */
    int *left_out;       /* of each material: nothing of it is there */
    unsigned *uv_set;    /* of each material */
    struct scene__lamp { const struct aiLight *light; int placed; } *lamps;  /* the file's lights by name */
    sbl_light *lights;
} scene__reader;

static const struct aiTexture *scene__embedded(const scene__reader *r, const char *path) {
    unsigned i;
    if (path[0] == '*') {
        char *end;
        unsigned long number = strtoul(path + 1, &end, 10);
        return *end == 0 && end != path + 1 && number < r->in->mNumTextures ? r->in->mTextures[number] : NULL;
    }
    for (i = 0; i < r->in->mNumTextures; i++)
        if (r->in->mTextures[i]->mFilename.length && strcmp(r->in->mTextures[i]->mFilename.data, path) == 0) return r->in->mTextures[i];
    return NULL;
}

/* A picture file that a scene names: beside the scene, backslashes and %20 undone, by its bare name, and at last without the options that
   assimp did not understand. */
static int scene__slurp_picture(const scene__reader *r, const char *name, scene__bytes *out) {
    const char *slash = strrchr(r->path, '/');
    size_t folder = slash ? (size_t)(slash - r->path) + 1 : 0, length = strlen(name);
    char *path = (char *)malloc(folder + length + 1), *at;
    int done = 0, i;
    if (!path) { errno = ENOMEM; return 0; }
    memcpy(path, r->path, folder);
    at = path + folder;
    if (name[0] == '/' && scene__slurp(name, out)) done = 1;
    for (i = 0; i < 5 && !done; i++) {
        const char *from = name;
        char *to = at, *bare;
        unsigned byte;
        while (*from) {
            if (i >= 2 && from[0] == '%' && from[1] && from[2] && sscanf(from + 1, "%2x", &byte) == 1 && byte) {
                *to++ = (char)byte;
                from += 3;
            } else {
                *to++ = i >= 1 && *from == '\\' ? '/' : *from;
                from++;
            }
        }
        while (i >= 1 && to > at && to[-1] == ' ') to--;
        *to = 0;
        bare = strrchr(at, i == 4 ? ' ' : '/');
        if (i >= 3 && bare) memmove(at, bare + 1, strlen(bare));
        done = scene__slurp(path, out);
    }
    free(path);
    return done;
}

/* 0 and a warning where the picture cannot be had: its material then keeps its plain colour. */
static int scene__decode(scene__reader *r, const char *name, scene__pixels *out) {
    const struct aiTexture *embedded = scene__embedded(r, name);
    scene__bytes bytes = { NULL, 0 };
    const stbi_uc *data;
    size_t size;
    memset(out, 0, sizeof *out);
    if (embedded && embedded->mHeight) {  /* texels as they are */
        size_t count = (size_t)embedded->mWidth * embedded->mHeight, i;
        stbi_uc *rgba =
            embedded->mWidth <= STBI_MAX_DIMENSIONS && embedded->mHeight <= STBI_MAX_DIMENSIONS ? (stbi_uc *)malloc(count * 4) : NULL;
        if (!rgba) { scene__warn(r->file, "texture %s is too large; its material keeps its plain colour", name); return 0; }
        for (i = 0; i < count; i++) {
            rgba[4 * i] = embedded->pcData[i].r;
            rgba[4 * i + 1] = embedded->pcData[i].g;
            rgba[4 * i + 2] = embedded->pcData[i].b;
            rgba[4 * i + 3] = embedded->pcData[i].a;
        }
        out->data = rgba;
        out->width = (int)embedded->mWidth;
        out->height = (int)embedded->mHeight;
        out->channels = 4;
        return 1;
    }
    if (!embedded && !scene__slurp_picture(r, name, &bytes)) {
        scene__warn(r->file, "texture %s cannot be read (%s); its material keeps its plain colour", name, strerror(errno));
        return 0;
    }
    data = embedded ? (const stbi_uc *)embedded->pcData : (const stbi_uc *)bytes.data;
    size = embedded ? embedded->mWidth : bytes.size;
    if (size <= INT32_MAX) {
        out->is_float = stbi_is_hdr_from_memory(data, (int)size);
        out->data = out->is_float ? (void *)stbi_loadf_from_memory(data, (int)size, &out->width, &out->height, &out->channels, 0)
                                  : (void *)stbi_load_from_memory(data, (int)size, &out->width, &out->height, &out->channels, 0);
    }
    free(bytes.data);
    if (!out->data) scene__warn(r->file, "texture %s cannot be decoded (%s); its material keeps its plain colour", name,
                                size <= INT32_MAX ? stbi_failure_reason() : "too large");
    return out->data != NULL;
}

/* Albedo and mask in one: alpha is the mask's, or its grey where it has no alpha. The larger size wins, the other is read to the nearest texel. */
static int scene__merge_mask(scene__pixels *albedo, const scene__pixels *mask) {
    scene__pixels out = { NULL, 0, 0, 4, 0 };
    const stbi_uc *from_mask = (const stbi_uc *)mask->data, *from_albedo = (const stbi_uc *)albedo->data;
    stbi_uc *to;
    int x, y, k;
    if (mask->is_float || albedo->is_float) return 0;
    out.width = albedo->width > mask->width ? albedo->width : mask->width;
    out.height = albedo->height > mask->height ? albedo->height : mask->height;
    out.data = to = (stbi_uc *)malloc((size_t)out.width * (size_t)out.height * 4);
    if (!to) return 0;
    for (y = 0; y < out.height; y++)
        for (x = 0; x < out.width; x++, to += 4) {
            size_t m = (size_t)((int64_t)y * mask->height / out.height * mask->width + (int64_t)x * mask->width / out.width) *
                       (size_t)mask->channels;
            if (from_albedo) {
                size_t a = (size_t)((int64_t)y * albedo->height / out.height * albedo->width + (int64_t)x * albedo->width / out.width) *
                           (size_t)albedo->channels;
                for (k = 0; k < 3; k++) to[k] = from_albedo[a + (size_t)(albedo->channels >= 3 ? k : 0)];
            } else memset(to, 255, 3);
            to[3] = from_mask[m + (size_t)(mask->channels % 2 ? 0 : mask->channels - 1)];
        }
    stbi_image_free(albedo->data);
    *albedo = out;
    return 1;
}

static char *scene__copy_name(const char *name) {
    char *copy = (char *)malloc(name ? strlen(name) + 1 : 1);
    if (copy) strcpy(copy, name ? name : "");
    return copy;
}

/* The number of a texture counted from 1, read now or found among those read before; 0 where there is none. Either name may be NULL. */
static int scene__texture(scene__reader *r, const char *albedo, const char *mask, sbl_wrap wrap) {
    scene__pixels pixels = { NULL, 0, 0, 0, 0 }, mask_pixels = { NULL, 0, 0, 0, 0 };
    sbl_texture *texture;
    struct scene__texture_key *key;
    size_t bytes;
    int i;
    for (i = 0; i < r->texture_count; i++)
        if (strcmp(r->keys[i].albedo, albedo ? albedo : "") == 0 && strcmp(r->keys[i].mask, mask ? mask : "") == 0 &&
            r->keys[i].wrap == wrap)
            return i + 1;
    if (r->texture_count == r->texture_room) return 0;  /* cannot be: two a material */
    if (albedo) scene__decode(r, albedo, &pixels);
    if (mask && scene__decode(r, mask, &mask_pixels)) {
        if (!scene__merge_mask(&pixels, &mask_pixels))
            scene__warn(r->file, "texture %s cannot be used as a mask; what it cuts out stays solid", mask);
        stbi_image_free(mask_pixels.data);
    }
    if (!pixels.data) return 0;
    bytes = (size_t)pixels.width * (size_t)pixels.height * (size_t)pixels.channels * (pixels.is_float ? sizeof(float) : 1);
    texture = &r->textures[r->texture_count];
    texture->pixels = scene__alloc(r->file, bytes, 1);
    if (texture->pixels) memcpy((char *)(uintptr_t)texture->pixels, pixels.data, bytes);
    stbi_image_free(pixels.data);
    key = &r->keys[r->texture_count];
    key->albedo = scene__copy_name(albedo);
    key->mask = scene__copy_name(mask);
    key->wrap = wrap;
    texture->format = pixels.is_float ? SBL_PIXELS_FLOAT : SBL_PIXELS_SRGB8;
    texture->width = pixels.width;
    texture->height = pixels.height;
    texture->channels = pixels.channels;
    texture->wrap = wrap;
    r->texture_count++;
    if (!key->albedo || !key->mask) { scene__fail(r->file, "out of memory"); return 0; }
    return texture->pixels ? r->texture_count : 0;
}

static int scene__picture_of(const struct aiMaterial *m, enum aiTextureType type, struct aiString *name, scene__picture *out) {
    enum aiTextureMapping mapping = aiTextureMapping_UV;
    out->wrap[0] = out->wrap[1] = aiTextureMapMode_Wrap;
    out->set = 0;
    if (aiGetMaterialTexture(m, type, 0, name, &mapping, &out->set, NULL, NULL, out->wrap, NULL) != aiReturn_SUCCESS || !name->length)
        return 0;
    out->path = name->data;
    return 1;
}

static sbl_wrap scene__wrap_of(const scene__picture *p) {
    return p->wrap[0] == aiTextureMapMode_Clamp && p->wrap[1] == aiTextureMapMode_Clamp ? SBL_WRAP_CLAMP : SBL_WRAP_REPEAT;
}

static float scene__number(const struct aiMaterial *m, const char *key, unsigned type, unsigned index, float otherwise) {
    ai_real value;
    return aiGetMaterialFloatArray(m, key, type, index, &value, NULL) == aiReturn_SUCCESS ? value : otherwise;
}

static void scene__material(scene__reader *r, unsigned index) {
    const struct aiMaterial *m = r->in->mMaterials[index];
    sbl_material *out = &r->materials[index];
    struct aiString albedo_name, emission_name, mask_name, alpha_mode, name;
    struct aiColor4D color;
    scene__picture albedo, emission, mask;
    int has_albedo = scene__picture_of(m, aiTextureType_DIFFUSE, &albedo_name, &albedo) ||
                     scene__picture_of(m, aiTextureType_BASE_COLOR, &albedo_name, &albedo);
    int has_emission = scene__picture_of(m, aiTextureType_EMISSIVE, &emission_name, &emission);
    int has_mask = 0, clamped = 0, k;
    float opacity = scene__number(m, AI_MATKEY_OPACITY, 1), cutoff = 0, strength = scene__number(m, AI_MATKEY_EMISSIVE_INTENSITY, 1), rgb[3];

    if (aiGetMaterialString(m, AI_MATKEY_NAME, &name) != aiReturn_SUCCESS) { name.length = 0; name.data[0] = 0; }
    if (aiGetMaterialColor(m, AI_MATKEY_COLOR_DIFFUSE, &color) != aiReturn_SUCCESS &&
        aiGetMaterialColor(m, AI_MATKEY_BASE_COLOR, &color) != aiReturn_SUCCESS)
        color.r = color.g = color.b = has_albedo ? 1.0f : 0.6f;
    rgb[0] = color.r; rgb[1] = color.g; rgb[2] = color.b;
    for (k = 0; k < 3; k++) {
        if (rgb[k] < 0.0f || rgb[k] > 1.0f) { rgb[k] = rgb[k] < 0.0f ? 0.0f : 1.0f; clamped = 1; }
        out->albedo[k] = rgb[k];
    }
    if (clamped) scene__warn(r->file, "material %s: its colour is not within 0 to 1 and was clamped", name.data);
    if (aiGetMaterialColor(m, AI_MATKEY_COLOR_EMISSIVE, &color) != aiReturn_SUCCESS) color.r = color.g = color.b = 0;
    out->emission[0] = strength * color.r;
    out->emission[1] = strength * color.g;
    out->emission[2] = strength * color.b;

    if (aiGetMaterialString(m, AI_MATKEY_GLTF_ALPHAMODE, &alpha_mode) == aiReturn_SUCCESS) {
        if (strcmp(alpha_mode.data, "MASK") == 0) cutoff = scene__number(m, AI_MATKEY_GLTF_ALPHACUTOFF, 0.5f);
        else if (strcmp(alpha_mode.data, "BLEND") == 0) cutoff = 0.5f;
        else opacity = 1;
    } else {
        has_mask = scene__picture_of(m, aiTextureType_OPACITY, &mask_name, &mask);
        if (has_mask || opacity < 0.5f) cutoff = 0.5f;
        if (has_emission && !(out->emission[0] != 0.0f || out->emission[1] != 0.0f || out->emission[2] != 0.0f))
            out->emission[0] = out->emission[1] = out->emission[2] = 1;
    }
    if (cutoff > opacity) r->left_out[index] = 1;  /* textures and vertices only lessen it */
    else out->alpha_cutoff = cutoff > 0.0f ? cutoff / opacity : 0.0f;
    if (r->left_out[index]) return;

    if (has_albedo || has_mask)
        out->albedo_texture =
            scene__texture(r, has_albedo ? albedo.path : NULL, has_mask ? mask.path : NULL, scene__wrap_of(has_albedo ? &albedo : &mask));
    if (has_emission) {
        out->emission_texture = scene__texture(r, emission.path, NULL, scene__wrap_of(&emission));
        if (!out->emission_texture)
            out->emission[0] = out->emission[1] = out->emission[2] = 0; /* better dark than a wall that shines all over */
        if (has_albedo && emission.set != albedo.set)
            scene__warn(r->file,
                        "material %s: colour and emission use different texture coordinates; those of the colour are taken for both",
                        name.data);
    }
    r->uv_set[index] = has_albedo ? albedo.set : has_emission ? emission.set : has_mask ? mask.set : 0;
}

/* ---- meshes and nodes ---- */

static void scene__multiply(double out[16], const double a[16], const struct aiMatrix4x4 *b) {  /* row-major, as assimp has them */
    const double right[16] = { b->a1, b->a2, b->a3, b->a4, b->b1, b->b2, b->b3, b->b4,
                               b->c1, b->c2, b->c3, b->c4, b->d1, b->d2, b->d3, b->d4 };
    int i, j, k;
    for (i = 0; i < 4; i++)
        for (j = 0; j < 4; j++) {
            out[4 * i + j] = 0;
            for (k = 0; k < 4; k++) out[4 * i + j] += a[4 * i + k] * right[4 * k + j];
        }
}

/* The arrays of one mesh, shared by all its uses; vertex_count stays 0 where it has no triangles. */
static void scene__mesh(scene__reader *r, const struct aiMesh *in, sbl_mesh *out) {
    scene_file *file = r->file;
    unsigned i, triangles = 0, set = in->mMaterialIndex < r->in->mNumMaterials ? r->uv_set[in->mMaterialIndex] : 0;
    uint32_t *indices;
    float *positions, *normals, *texcoords, *colors;
    for (i = 0; i < in->mNumFaces; i++) triangles += in->mFaces[i].mNumIndices == 3;
    if (!triangles || !in->mVertices) return;
    if (in->mNumVertices > INT32_MAX / 3 || triangles > INT32_MAX / 3) {
        scene__fail(file, "mesh %s has too many triangles", in->mName.data);
        return;
    }
    indices = (uint32_t *)scene__alloc(file, triangles, 3 * sizeof *indices);
    positions = (float *)scene__alloc(file, in->mNumVertices, 3 * sizeof *positions);
    if (!indices || !positions) return;
    out->indices.data = indices;
    out->indices.type = SBL_UINT32;
    out->index_count = (int)(3 * triangles);
    for (i = 0; i < in->mNumFaces; i++)
        if (in->mFaces[i].mNumIndices == 3) {
            memcpy(indices, in->mFaces[i].mIndices, 3 * sizeof *indices);
            indices += 3;
        }
    out->positions.data = positions;
    out->vertex_count = (int)in->mNumVertices;
    for (i = 0; i < in->mNumVertices; i++) {
        positions[3 * i] = in->mVertices[i].x;
        positions[3 * i + 1] = in->mVertices[i].y;
        positions[3 * i + 2] = in->mVertices[i].z;
    }
    if (in->mNormals && (normals = (float *)scene__alloc(file, in->mNumVertices, 3 * sizeof *normals)) != NULL) {
        out->normals.data = normals;
        for (i = 0; i < in->mNumVertices; i++) {
            normals[3 * i] = in->mNormals[i].x;
            normals[3 * i + 1] = in->mNormals[i].y;
            normals[3 * i + 2] = in->mNormals[i].z;
        }
    }
    if (set >= AI_MAX_NUMBER_OF_TEXTURECOORDS) set = 0;
    if (in->mTextureCoords[set] && (texcoords = (float *)scene__alloc(file, in->mNumVertices, 2 * sizeof *texcoords)) != NULL) {
        out->texcoords.data = texcoords;
        for (i = 0; i < in->mNumVertices; i++) {
            texcoords[2 * i] = in->mTextureCoords[set][i].x;
            texcoords[2 * i + 1] = 1 - in->mTextureCoords[set][i].y;  /* assimp counts v from the picture's bottom, for glTF too */
        }
    }
    if (in->mColors[0] && (colors = (float *)scene__alloc(file, in->mNumVertices, 4 * sizeof *colors)) != NULL) {
        unsigned k;
        out->colors.data = colors;
        for (i = 0; i < in->mNumVertices; i++) {
            colors[4 * i] = in->mColors[0][i].r;
            colors[4 * i + 1] = in->mColors[0][i].g;
            colors[4 * i + 2] = in->mColors[0][i].b;
            colors[4 * i + 3] = in->mColors[0][i].a;
            for (k = 4 * i; k < 4 * i + 4; k++) {
                if (colors[k] < 0.0f) colors[k] = 0;
                if (colors[k] > 1.0f) colors[k] = 1;
            }
        }
    }
}

static void scene__direction(float out[3], const double m[16], const struct aiVector3D *v) {
    int i;
    for (i = 0; i < 3; i++) out[i] = (float)(m[4 * i] * v->x + m[4 * i + 1] * v->y + m[4 * i + 2] * v->z);
}

static void scene__camera(scene_file *file, const struct aiCamera *in, const double m[16], int is_gltf) {
    const double degrees = 45 / atan(1.0);
    scene_file_camera *c = &file->camera;
    double x = 0.5 * in->mHorizontalFOV;
    int i;
    memset(c->eye, 0, sizeof c->eye);
    if (!is_gltf) scene__direction(c->eye, m, &in->mPosition);  /* of a glTF camera assimp gives the node's own translation here, once more */
    for (i = 0; i < 3; i++) c->eye[i] += (float)m[4 * i + 3];
    scene__direction(c->forward, m, &in->mLookAt);
    scene__direction(c->up, m, &in->mUp);
    c->fov_x = c->fov_y = 0;
    if (is_gltf) c->fov_y = (float)(2 * x * degrees);  /* see scene__mend_gltf */
    else if (in->mAspect > 0) c->fov_y = (float)(2 * atan(tan(x) / in->mAspect) * degrees);
    else c->fov_x = (float)(2 * x * degrees);
    file->has_camera = 1;
}

static int scene__by_name(const void *a, const void *b) {
    return strcmp(((const struct scene__lamp *)a)->light->mName.data, ((const struct scene__lamp *)b)->light->mName.data);
}

/* A light as sbl_set_scene takes it; 0 and a warning where it cannot be one. */
static int scene__light(scene_file *file, const struct aiLight *in, const double m[16], int is_gltf, sbl_light *out) {
    const double degrees = 45 / atan(1.0), cone = (is_gltf ? 2 : 1) * degrees;  /* glTF's angles are from the axis */
    const float color[3] = { in->mColorDiffuse.r, in->mColorDiffuse.g, in->mColorDiffuse.b };
    const char *wrong = NULL;
    double length = 0;
    int i;
    memset(out, 0, sizeof *out);
    if (in->mType == aiLightSource_POINT) out->kind = SBL_LIGHT_POINT;
    else if (in->mType == aiLightSource_SPOT) out->kind = SBL_LIGHT_SPOT;
    else if (in->mType == aiLightSource_DIRECTIONAL) out->kind = SBL_LIGHT_DIRECTIONAL;
    else wrong = "it is no point, spot or directional light";
    scene__direction(out->position, m, &in->mPosition);
    for (i = 0; i < 3; i++) {
        out->intensity[i] = color[i];
        if (!(color[i] >= 0 && color[i] < 1e30f)) wrong = "its intensity is negative or no number";
        out->position[i] += (float)m[4 * i + 3];
        if (!(fabsf(out->position[i]) < 1e18f)) wrong = "its position is out of range";
    }
    if (out->kind != SBL_LIGHT_POINT) {
        const struct aiVector3D *d = &in->mDirection;
        double direction[3];
        for (i = 0; i < 3; i++) direction[i] = m[4 * i] * (double)d->x + m[4 * i + 1] * (double)d->y + m[4 * i + 2] * (double)d->z;
        for (i = 0; i < 3; i++) length += direction[i] * direction[i];
        for (i = 0; i < 3; i++) out->direction[i] = (float)(direction[i] / sqrt(length));
        if (!(length > 0 && length < 1e300)) wrong = "it has no direction";
    }
    if (out->kind == SBL_LIGHT_SPOT) {
        out->cone = (float)(cone * (double)in->mAngleOuterCone);
        out->inner_cone = (float)(cone * (double)in->mAngleInnerCone);
        if (!(out->cone > 0 && out->inner_cone >= 0)) wrong = "its cone is empty";
        if (out->cone > 180.001f && !wrong) scene__warn(file, "light %s: its cone is wider than 180 degrees and was narrowed", in->mName.data);
        if (out->cone > 180) out->cone = 180;
        if (out->inner_cone > out->cone) out->inner_cone = out->cone;
    }
    if (wrong) scene__warn(file, "light %s: %s; it was left out", in->mName.data, wrong);
    return !wrong;
}

/* The lights at a node: those of its name that no node before it had. */
static void scene__lights(scene__reader *r, const struct aiNode *node, const double m[16], int is_gltf) {
    unsigned low = 0, high = r->in->mNumLights;
    while (low < high) {
        unsigned middle = low + (high - low) / 2;
        if (strcmp(r->lamps[middle].light->mName.data, node->mName.data) < 0) low = middle + 1;
        else high = middle;
    }
    for (; low < r->in->mNumLights && !r->lamps[low].placed && strcmp(r->lamps[low].light->mName.data, node->mName.data) == 0; low++) {
        r->lamps[low].placed = 1;
        r->file->scene.light_count += scene__light(r->file, r->lamps[low].light, m, is_gltf, &r->lights[r->file->scene.light_count]);
    }
}

typedef struct scene__visit { const struct aiNode *node; double transform[16]; } scene__visit;

/* Nodes in depth-first order, with a list of those still to come: a chain of a million nodes must not overflow the stack. */
static void scene__nodes(scene__reader *r, const sbl_mesh *shared) {
    static const double identity[16] = { 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1 };
    scene_file *file = r->file;
    size_t room = 64, count = 0, used = 0, total = 0, pass;
    unsigned i, best_camera = r->in->mNumCameras;
    const int is_gltf = scene__ends_with(r->path, ".gltf") || scene__ends_with(r->path, ".glb");
    scene__visit *list = (scene__visit *)malloc(room * sizeof *list);
    sbl_mesh *meshes = NULL;
    const char **names = NULL;
    if (!list) { scene__fail(file, "out of memory"); return; }
    for (pass = 0; pass < 2 && !file->error[0]; pass++) {  /* count, then fill in */
        if (pass == 1) {
            if (total > INT32_MAX) { scene__fail(file, "it uses its meshes too often"); break; }
            meshes = (sbl_mesh *)scene__alloc(file, total, sizeof *meshes);
            names = (const char **)scene__alloc(file, total, sizeof *names);
            if (!meshes || !names) break;
        }
        list[0].node = r->in->mRootNode;
        scene__multiply(list[0].transform, identity, &r->in->mRootNode->mTransformation);
        count = 1;
        while (count && !file->error[0]) {
            scene__visit at = list[--count];
            for (i = 0; i < at.node->mNumMeshes; i++) {
                unsigned number = at.node->mMeshes[i], material;
                int k;
                if (number >= r->in->mNumMeshes || !shared[number].vertex_count) continue;
                material = r->in->mMeshes[number]->mMaterialIndex;
                if (material >= r->in->mNumMaterials) material = 0;
                if (r->left_out[material]) continue;
                if (pass == 0) { total++; continue; }
                meshes[used] = shared[number];
                meshes[used].material = (int)material;
                meshes[used].id = (uint32_t)used + 1;
                for (k = 0; k < 16; k++) meshes[used].transform[k] = (float)at.transform[k % 4 * 4 + k / 4];
                {
                    const struct aiString *name = &(at.node->mName.length ? at.node : r->in->mRootNode)->mName;
                    char *copy = (char *)scene__alloc(file, strlen(name->data) + 1, 1);
                    if (!copy) break;
                    strcpy(copy, name->data);
                    names[used++] = copy;
                }
            }
            for (i = 0; pass == 1 && i < best_camera; i++)
                if (r->in->mCameras[i]->mOrthographicWidth == 0.0f && strcmp(r->in->mCameras[i]->mName.data, at.node->mName.data) == 0) {
                    scene__camera(file, r->in->mCameras[i], at.transform, is_gltf);
                    best_camera = i;
                }
            if (pass == 1) scene__lights(r, at.node, at.transform, is_gltf);
            if (count + at.node->mNumChildren > room) {
                scene__visit *larger;
                while (room < count + at.node->mNumChildren) room *= 2;
                larger = (scene__visit *)realloc(list, room * sizeof *list);
                if (!larger) { scene__fail(file, "out of memory"); break; }
                list = larger;
            }
            for (i = at.node->mNumChildren; i-- > 0; count++) {
                list[count].node = at.node->mChildren[i];
                scene__multiply(list[count].transform, at.transform, &at.node->mChildren[i]->mTransformation);
            }
        }
    }
    free(list);
    file->scene.meshes = meshes;
    file->scene.mesh_count = (int)used;
    file->names = names;
    if (!file->error[0] && !used) scene__fail(file, "there are no triangles in it");
}

/* ---- pictures of the sky ---- */

typedef struct scene__source { scene_file *file; scene__bytes bytes; size_t at; } scene__source;

static int scene__source_read(void *user, char *out, int size) {
    scene__source *s = (scene__source *)user;
    size_t left = s->bytes.size - s->at, n = (size_t)size < left ? (size_t)size : left;
    if (!n) {  /* stb_image takes what is missing for noughts, some of them for ever */
        scene__fail(s->file, "it ends too soon; copy or save it anew");
        _exit(0);
    }
    memcpy(out, s->bytes.data + s->at, n);
    s->at += n;
    return (int)n;
}
static void scene__source_skip(void *user, int count) {
    scene__source *s = (scene__source *)user;
    if (count < 0) s->at -= (size_t)-count < s->at ? (size_t)-count : s->at;
    else s->at += (size_t)count < s->bytes.size - s->at ? (size_t)count : s->bytes.size - s->at;
}
static int scene__source_ended(void *user) { return ((scene__source *)user)->at == ((scene__source *)user)->bytes.size; }

static void scene__load_sky_here(scene_file *file, const char *path) {
    const stbi_io_callbacks calls = { scene__source_read, scene__source_skip, scene__source_ended };
    sbl_texture *out = &file->scene.environment.picture;
    scene__source source = { file, { NULL, 0 }, 0 };
    void *pixels, *copy;
    int channels, is_float;
    size_t size;
    if (!scene__slurp(path, &source.bytes)) { scene__fail(file, "%s; give a .hdr, .png or .jpg picture", strerror(errno)); return; }
    is_float = stbi_is_hdr_from_callbacks(&calls, &source);
    source.at = 0;
    pixels = is_float ? (void *)stbi_loadf_from_callbacks(&calls, &source, &out->width, &out->height, &channels, 3)
                      : (void *)stbi_load_from_callbacks(&calls, &source, &out->width, &out->height, &channels, 3);
    if (!pixels) scene__fail(file, "it is no picture that can be read (%s); give a .hdr, .png or .jpg picture", stbi_failure_reason());
    else {
        out->format = is_float ? SBL_PIXELS_FLOAT : SBL_PIXELS_SRGB8;
        out->channels = 3;
        size = (size_t)out->width * (size_t)out->height * 3 * (is_float ? sizeof(float) : 1);
        out->pixels = copy = scene__alloc(file, size, 1);
        if (copy) memcpy(copy, pixels, size);
    }
    stbi_image_free(pixels);
    free(source.bytes.data);
}

/* ---- the child process ---- */

static void scene__convert(scene__reader *r) {
    scene_file *file = r->file;
    const size_t materials = r->in->mNumMaterials ? r->in->mNumMaterials : 1;
    sbl_mesh *shared = (sbl_mesh *)calloc((size_t)r->in->mNumMeshes + 1, sizeof *shared);
    unsigned i;
    r->texture_room = (int)(2 * materials);
    r->materials = (sbl_material *)scene__alloc(file, materials, sizeof *r->materials);
    r->textures = (sbl_texture *)scene__alloc(file, 2 * materials, sizeof *r->textures);
    r->keys = (struct scene__texture_key *)calloc(2 * materials, sizeof *r->keys);
    r->left_out = (int *)calloc(materials, sizeof *r->left_out);
    r->uv_set = (unsigned *)calloc(materials, sizeof *r->uv_set);
    r->lamps = (struct scene__lamp *)calloc((size_t)r->in->mNumLights + 1, sizeof *r->lamps);
    r->lights = (sbl_light *)scene__alloc(file, r->in->mNumLights, sizeof *r->lights);
    if (!shared || !r->keys || !r->left_out || !r->uv_set || !r->lamps) scene__fail(file, "out of memory");
    for (i = 0; i < 3 && !file->error[0]; i++) r->materials[0].albedo[i] = 0.6f;  /* where the file has none */
    for (i = 0; i < r->in->mNumMaterials && !file->error[0]; i++) scene__material(r, i);
    for (i = 0; i < r->in->mNumMeshes && !file->error[0]; i++) scene__mesh(r, r->in->mMeshes[i], &shared[i]);
    for (i = 0; i < r->in->mNumLights && r->lamps; i++) r->lamps[i].light = r->in->mLights[i];
    if (r->lamps) qsort(r->lamps, r->in->mNumLights, sizeof *r->lamps, scene__by_name);
    if (!file->error[0]) scene__nodes(r, shared);
    file->scene.lights = r->lights;
    file->scene.materials = r->materials;
    file->scene.material_count = (int)materials;
    file->scene.textures = r->textures;
    file->scene.texture_count = r->texture_count;
    for (i = 0; r->keys && i < (unsigned)r->texture_count; i++) {
        free(r->keys[i].albedo);
        free(r->keys[i].mask);
    }
    free(r->keys);
    free(r->left_out);
    free(r->uv_set);
    free(r->lamps);
    free(shared);
}

static void scene__load_scene_here(scene_file *file, const char *path) {
    scene__main_file main_file;
    struct aiFileIO io;
    struct aiPropertyStore *properties;
    scene__reader reader;
    memset(&reader, 0, sizeof reader);
    main_file.path = path;
    if (!scene__slurp(path, &main_file.bytes)) {
        scene__fail(file, "%s", strerror(errno));
        return;
    }
    if (scene__ends_with(path, ".gltf") || scene__ends_with(path, ".glb")) scene__mend_gltf(file, &main_file.bytes);
    if (scene__ends_with(path, ".obj")) scene__mend_obj(file, &main_file.bytes);
    io.OpenProc = scene__open;
    io.CloseProc = scene__close;
    io.UserData = (char *)&main_file;
    properties = aiCreatePropertyStore();
    aiSetImportPropertyInteger(properties, AI_CONFIG_PP_SBP_REMOVE, aiPrimitiveType_POINT | aiPrimitiveType_LINE);
    reader.file = file;
    reader.path = path;
    reader.in =
        aiImportFileExWithProperties(path, aiProcess_Triangulate | aiProcess_SortByPType | aiProcess_TransformUVCoords, &io, properties);
    if (reader.in && reader.in->mRootNode) scene__convert(&reader);
    else if (strcmp(aiGetErrorString(), "No meshes remaining") == 0) scene__fail(file, "there are no triangles in it");
    else
        scene__fail(file, "assimp cannot read it (%s); repair it or convert it to .glb or .obj",
                    aiGetErrorString()[0] ? aiGetErrorString() : "it holds no scene");
    if (reader.in) aiReleaseImport(reader.in);
    aiReleasePropertyStore(properties);
    free(main_file.bytes.data);
}

/* Never returns. */
static void scene__child(scene_file *file, const char *path, size_t memory, void (*load_here)(scene_file *file, const char *path)) {
    struct rlimit limit = { 0, 0 };
    scene__reading = file;
    signal(SIGINT, SIG_DFL);
    signal(SIGALRM, SIG_DFL);
    setrlimit(RLIMIT_CORE, &limit);
    alarm(SCENE_FILE_SECONDS);
#ifndef SCENE__SANITIZED  /* sanitizers need much address space, and what they say must be seen */
    {
        int nowhere = open("/dev/null", O_WRONLY);
        if (nowhere >= 0) dup2(nowhere, STDERR_FILENO);  /* a library that dies may have last words */
    }
    limit.rlim_cur = limit.rlim_max = memory;
    setrlimit(RLIMIT_DATA, &limit);
#else
    (void)memory;
#endif
    load_here(file, path);
#ifdef SCENE__SANITIZED
    if (__lsan_do_recoverable_leak_check()) _exit(23);
#endif
    _exit(0);
}

static void scene_file_free(scene_file *file);

/* advice: what to do about a file whose reader breaks down. */
static scene_file *scene__load(void (*load_here)(scene_file *file, const char *path), const char *advice, const char *path,
                               const volatile sig_atomic_t *cancel, char *error, size_t error_size) {
    const size_t largest = sizeof(size_t) > 4 ? (size_t)16 << 20 << 10 : (size_t)1 << 30;
    size_t memory = (size_t)sysconf(_SC_PHYS_PAGES) / 2 * (size_t)sysconf(_SC_PAGESIZE), capacity;
    scene_file *file = (scene_file *)MAP_FAILED;
    struct pollfd waiting;
    int ends[2], status = 0, stopped = 0;
    pid_t child;
    error[0] = 0;
    if (memory > largest) memory = largest;
    /* Pages cost nothing before they are touched. */
    for (capacity = memory; file == (scene_file *)MAP_FAILED && capacity >= (size_t)1 << 24;
         capacity = file == (scene_file *)MAP_FAILED ? capacity / 2 : capacity)
        file = (scene_file *)mmap(NULL, capacity, PROT_READ | PROT_WRITE, MAP_SHARED | MAP_ANONYMOUS | MAP_NORESERVE, -1, 0);
    if (file == (scene_file *)MAP_FAILED || pipe(ends) != 0) {
        scene__print(error, error_size, "%s: no memory to read it into: %s", path, strerror(errno));
        if (file != (scene_file *)MAP_FAILED) munmap(file, capacity);
        return NULL;
    }
    file->capacity = capacity;
    file->used = (sizeof *file + 15) & ~(size_t)15;
    fflush(NULL);
    child = fork();
    if (child == 0) {
        close(ends[0]);
        scene__child(file, path, memory, load_here);
    }
    close(ends[1]);
    waiting.fd = ends[0];
    waiting.events = POLLIN;
    /* The child holds the pipe's other end: it reads as closed once the child is gone. */
    while (child > 0 && !stopped && poll(&waiting, 1, 50) <= 0)
        if (cancel && *cancel) stopped = 1;
    if (stopped) kill(child, SIGKILL);
    while (child > 0 && waitpid(child, &status, 0) < 0 && errno == EINTR) continue;
    close(ends[0]);
    if (cancel && *cancel) stopped = 1;
    if (!stopped) {
        if (child < 0) scene__print(error, error_size, "%s: no process to read it in: %s", path, strerror(errno));
        else if (file->error[0]) scene__print(error, error_size, "%s: %s", path, file->error);
        else if (WIFSIGNALED(status) && WTERMSIG(status) == SIGALRM)
            scene__print(error, error_size, "%s: reading it takes too long; the file may be damaged, %s", path, advice);
        else if (!WIFEXITED(status) || WEXITSTATUS(status))
            scene__print(error, error_size, "%s: its reader broke down (%s %d); the file may be damaged, %s", path,
                     WIFSIGNALED(status) ? "signal" : "status", WIFSIGNALED(status) ? WTERMSIG(status) : WEXITSTATUS(status), advice);
    }
    if (stopped || error[0]) {
        scene_file_free(file);
        return NULL;
    }
    return file;
}

/* ---- public ---- */

static void scene_file_free(scene_file *file) {
    if (file) munmap(file, file->capacity);
}

/* Both return NULL and one line in `error` where the file cannot be read, or, with error empty, where *cancel became nonzero. */
static scene_file *scene_file_load(const char *path, const volatile sig_atomic_t *cancel, char *error, size_t error_size) {
    return scene__load(scene__load_scene_here, "convert it to .glb or .obj", path, cancel, error, error_size);
}

static inline scene_file *scene_file_load_sky(const char *path, const volatile sig_atomic_t *cancel, char *error, size_t error_size) {
    return scene__load(scene__load_sky_here, "save it anew as .hdr or .png", path, cancel, error, error_size);
}

#endif
