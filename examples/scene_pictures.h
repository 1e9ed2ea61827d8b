/* Part of scene_file.h: decodes textures and pictures of the sky with stb_image. */
#ifndef SCENE_PICTURES_H
#define SCENE_PICTURES_H

#define STB_IMAGE_IMPLEMENTATION
#define STBI_NO_STDIO
#define STBI_MAX_DIMENSIONS 16384
#include <stb/stb_image.h>

typedef struct scene__pixels { void *data; int width, height, channels, is_float; } scene__pixels;  /* data: malloc */

/* ---- decoding ---- */

typedef struct scene__source {
    scene_file *file;
    const char *data;
    size_t size, at;
    int strict;  /* 1: fail if data is missing at the end */
} scene__source;

static int scene__source_read(void *user, char *out, int size) {
    scene__source *s = (scene__source *)user;
    size_t left = s->size - s->at, n = (size_t)size < left ? (size_t)size : left;
    if (!n && s->strict) {  /* stb_image reads missing data as zeros, in some formats forever */
        scene__fail(s->file, "it ends too soon; copy or save it again");
        _exit(0);
    }
    memcpy(out, s->data + s->at, n);
    s->at += n;
    return (int)n;
}
static void scene__source_skip(void *user, int count) {
    scene__source *s = (scene__source *)user;
    if (count < 0) s->at -= (size_t)-count < s->at ? (size_t)-count : s->at;
    else s->at += (size_t)count < s->size - s->at ? (size_t)count : s->size - s->at;
}
static int scene__source_ended(void *user) {
    return ((scene__source *)user)->at == ((scene__source *)user)->size;
}

static size_t scene__bytes_of(const scene__pixels *p) {
    return (size_t)p->width * (size_t)p->height * (size_t)p->channels * (p->is_float ? sizeof(float) : 1);
}

/* Decodes a picture. Returns NULL, or the reason of a failure. If the picture needs too much memory, the scene cannot
   be read. channels: number of channels to convert to, or 0 for the channels of the file */
static const char *scene__decode(scene__source *s, const char *name, int channels, scene__pixels *out) {
    const stbi_io_callbacks calls = { scene__source_read, scene__source_skip, scene__source_ended };
    char what[320];
    int is_wide;
    double texels;
    if (!stbi_info_from_callbacks(&calls, s, &out->width, &out->height, &out->channels)) return stbi_failure_reason();
    s->at = 0;
    out->is_float = stbi_is_hdr_from_callbacks(&calls, s);
    s->at = 0;
    is_wide = stbi_is_16_bit_from_callbacks(&calls, s);
    s->at = 0;
    if (channels) out->channels = channels;
    if (out->width > STBI_MAX_DIMENSIONS || out->height > STBI_MAX_DIMENSIONS) return "too large";
    scene__print(what, sizeof what, "%.200s (%d x %d pixels)", name, out->width, out->height);
    /* reading needs the unpacked file, the decoded picture and the copy in the shared pages; rendering needs four
       channels each in sbl.h and in GL */
    texels = (double)out->width * out->height;
    if (!scene__afford(s->file, what, (is_wide ? 5.0 : 3.0) * (double)scene__bytes_of(out),
                       (out->is_float ? 16 : 8) * texels))
        return "too large";
    if (out->is_float)
        out->data = stbi_loadf_from_callbacks(&calls, s, &out->width, &out->height, &out->channels, channels);
    else out->data = stbi_load_from_callbacks(&calls, s, &out->width, &out->height, &out->channels, channels);
    if (channels) out->channels = channels;
    if (out->data) return NULL;
    if (strcmp(stbi_failure_reason(), "outofmem") == 0) scene__fail_for_memory(s->file, what);
    return stbi_failure_reason();
}

/* Copies the pixels to the shared pages and frees them. Returns 0 if memory runs out. */
static int scene__keep(scene_file *file, scene__pixels *from, sbl_texture *to) {
    void *copy = scene__alloc(file, scene__bytes_of(from), 1);
    if (copy) memcpy(copy, from->data, scene__bytes_of(from));
    to->pixels = copy;
    to->format = from->is_float ? SBL_PIXELS_FLOAT : SBL_PIXELS_SRGB8;
    to->width = from->width;
    to->height = from->height;
    to->channels = from->channels;
    stbi_image_free(from->data);
    from->data = NULL;
    return copy != NULL;
}

/* ---- the textures of a scene ---- */

/* A picture inside a scene file. If height is 0, data is a complete picture file of size bytes; otherwise it consists
   of texels of four bytes in the order blue, green, red, alpha. */
typedef struct scene__embedded { const void *data; size_t size; unsigned width, height; } scene__embedded;

typedef struct scene__pictures {
    scene_file *file;
    const char *path;    /* path of the scene file */
    int (*embedded)(const void *scene, const char *name, scene__embedded *out);  /* returns 0 if absent */
    const void *scene;
    sbl_texture *textures;
    int count, room;
    struct scene__texture_key { char *albedo, *mask; sbl_wrap wrap; int linear; } *keys;  /* one per texture; the names
                                                                                             are from malloc */
    char **failed;       /* names of pictures that could not be read, so that each is tried only once */
    int failed_count, failed_room;
} scene__pictures;

static char *scene__copy_name(const char *name) {
    char *copy = (char *)malloc(name ? strlen(name) + 1 : 1);
    if (copy) strcpy(copy, name ? name : "");
    return copy;
}

/* Writes a guess at the path of a file to `to`, which must be as long as name. attempt: 0 keeps the name; 1 turns
   backslashes into slashes; 2 also decodes characters such as %20; 3 also removes the folders; 4 instead removes
   everything up to the last blank, because assimp leaves unknown options in the name */
static void scene__guess_path(const char *name, int attempt, char *to) {
    char *start = to, *bare;
    unsigned byte;
    while (*name) {
        if (attempt >= 2 && name[0] == '%' && name[1] && name[2] && sscanf(name + 1, "%2x", &byte) == 1 && byte) {
            *to++ = (char)byte;
            name += 3;
        } else {
            *to++ = attempt >= 1 && *name == '\\' ? '/' : *name;
            name++;
        }
    }
    while (attempt >= 1 && to > start && to[-1] == ' ') to--;
    *to = 0;
    bare = strrchr(start, attempt == 4 ? ' ' : '/');
    if (attempt >= 3 && bare) memmove(start, bare + 1, strlen(bare));
}

/* Reads a file that a scene refers to by name, relative to the folder of the scene. Returns 0 and sets errno on
   failure. If no guess at its path can be read and one was outside of the allowed folders, the scene cannot be read.
   scene_path: path of the scene file */
static int scene__slurp_named(scene_file *file, const char *scene_path, const char *name, scene__bytes *out) {
    const char *slash = strrchr(scene_path, '/');
    const size_t folder = slash ? (size_t)(slash - scene_path) + 1 : 0;
    char *path = (char *)malloc(folder + strlen(name) + 1), *refused = NULL;
    int done = 0, i, error = ENOENT;
    for (i = name[0] == '/' ? -1 : 0; path && i < 5 && !done; i++) {
        memcpy(path, scene_path, folder);
        if (i < 0) strcpy(path, name);
        else scene__guess_path(name, i, path + folder);
        done = scene__slurp(file, path, out);
        if (!done && errno != ENOENT) error = errno;
        if (!done && errno == SCENE__REFUSED && !refused) refused = scene__copy_name(path);
    }
    if (!done && refused) scene__refuse(file, refused);
    free(refused);
    free(path);
    errno = error;
    return done;
}

static const char *scene__convert_texels(scene_file *file, const scene__embedded *from, scene__pixels *out) {
    const size_t count = (size_t)from->width * from->height;
    const stbi_uc *bgra = (const stbi_uc *)from->data;
    stbi_uc *rgba;
    size_t i;
    if (from->width > STBI_MAX_DIMENSIONS || from->height > STBI_MAX_DIMENSIONS) return "too large";
    if (!scene__afford(file, "a texture", 8.0 * (double)count, 8.0 * (double)count)) return "too large";
    out->data = rgba = (stbi_uc *)malloc(4 * count + 1);
    if (!rgba) return "out of memory";
    for (i = 0; i < 4 * count; i++) rgba[i] = bgra[i % 4 == 3 ? i : i - i % 4 + 2 - i % 4];
    out->width = (int)from->width;
    out->height = (int)from->height;
    out->channels = 4;
    out->is_float = 0;
    return NULL;
}

/* Reads and decodes a picture. Returns NULL, or the reason of a failure. */
static const char *scene__read_picture(const scene__pictures *p, const char *name, scene__pixels *out) {
    scene__embedded inside = { NULL, 0, 0, 0 };
    scene__bytes bytes = { NULL, 0 };
    scene__source source;
    const char *wrong;
    char what[256];
    if (p->embedded(p->scene, name, &inside)) {
        if (inside.height) return scene__convert_texels(p->file, &inside, out);
    } else {
        if (!scene__slurp_named(p->file, p->path, name, &bytes)) return scene__why();
        inside.data = bytes.data;
        inside.size = bytes.size;
    }
    memset(&source, 0, sizeof source);
    source.file = p->file;
    source.data = (const char *)inside.data;
    source.size = inside.size;
    scene__print(what, sizeof what, "texture %.200s", name);
    wrong = scene__decode(&source, what, 0, out);
    free(bytes.data);
    return wrong;
}

/* Reads a picture. Returns 0 and adds a warning on failure; the material then keeps its plain colour. */
static int scene__picture(scene__pictures *p, const char *name, scene__pixels *out) {
    const char *wrong;
    int i;
    memset(out, 0, sizeof *out);
    for (i = 0; i < p->failed_count; i++)
        if (strcmp(p->failed[i], name) == 0) return 0;
    wrong = scene__read_picture(p, name, out);
    if (!wrong) return 1;
    scene__warn(p->file, "texture %s cannot be read (%s); its material keeps its plain colour", name, wrong);
    if (p->failed_count == p->failed_room) {
        const int room = 2 * p->failed_room + 16;
        char **more = (char **)realloc(p->failed, (size_t)room * sizeof *more);
        if (!more) { scene__fail_for_memory(p->file, "it"); return 0; }
        p->failed = more;
        p->failed_room = room;
    }
    p->failed[p->failed_count] = scene__copy_name(name);
    if (p->failed[p->failed_count]) p->failed_count++;
    return 0;
}

/* Returns the texel of p that is nearest to the texel x, y of a picture with the size of `of`. */
static const stbi_uc *scene__texel(const scene__pixels *p, int x, int y, const scene__pixels *of) {
    const int64_t row = (int64_t)y * p->height / of->height, column = (int64_t)x * p->width / of->width;
    return (const stbi_uc *)p->data + (row * p->width + column) * p->channels;
}

/* Combines albedo (white if missing) and mask into one RGBA picture that replaces *albedo. Its alpha is the alpha of
   the mask, or the first channel of a mask without alpha. Its size is the larger width and the larger height; both
   pictures are sampled at the nearest texel. Returns 0 on failure. */
static int scene__merge_mask(scene_file *file, scene__pixels *albedo, const scene__pixels *mask) {
    scene__pixels out = { NULL, 0, 0, 4, 0 };
    stbi_uc *to;
    int x, y, k;
    if (mask->is_float || albedo->is_float) return 0;
    out.width = albedo->width > mask->width ? albedo->width : mask->width;
    out.height = albedo->height > mask->height ? albedo->height : mask->height;
    if (!scene__afford(file, "a texture with its mask", 2.0 * (double)scene__bytes_of(&out), 0)) return 0;
    out.data = to = (stbi_uc *)malloc(scene__bytes_of(&out));
    if (!to) return 0;
    for (y = 0; y < out.height; y++)
        for (x = 0; x < out.width; x++, to += 4) {
            const stbi_uc *from = albedo->data ? scene__texel(albedo, x, y, &out) : NULL;
            for (k = 0; k < 3; k++) to[k] = (stbi_uc)(from ? from[albedo->channels >= 3 ? k : 0] : 255);
            to[3] = scene__texel(mask, x, y, &out)[mask->channels % 2 ? 0 : mask->channels - 1];
        }
    stbi_image_free(albedo->data);
    *albedo = out;
    return 1;
}

/* Returns the number of a texture, from 1, and reads it if it is new. Returns 0 if it cannot be read. albedo, mask:
   names of pictures, or NULL. linear: 1 if its values are not colours; a picture that is used in both ways becomes two
   textures */
static int scene__texture(scene__pictures *p, const char *albedo, const char *mask, sbl_wrap wrap, int linear) {
    scene__pixels pixels, mask_pixels;
    struct scene__texture_key *key = &p->keys[p->count];
    int i;
    for (i = 0; i < p->count; i++)
        if (strcmp(p->keys[i].albedo, albedo ? albedo : "") == 0 && strcmp(p->keys[i].mask, mask ? mask : "") == 0 &&
            p->keys[i].wrap == wrap && p->keys[i].linear == linear)
            return i + 1;
    if (p->count == p->room) return 0;  /* cannot happen, because a material has at most five textures */
    memset(&pixels, 0, sizeof pixels);
    if (albedo) scene__picture(p, albedo, &pixels);
    if (mask && scene__picture(p, mask, &mask_pixels)) {
        if (!scene__merge_mask(p->file, &pixels, &mask_pixels))
            scene__warn(p->file, "texture %s cannot be used as a mask; nothing is cut out", mask);
        stbi_image_free(mask_pixels.data);
    }
    if (!pixels.data) return 0;
    p->textures[p->count].wrap = wrap;
    key->albedo = scene__copy_name(albedo);
    key->mask = scene__copy_name(mask);
    key->wrap = wrap;
    key->linear = linear;
    if (!key->albedo || !key->mask) scene__fail_for_memory(p->file, "it");
    p->count++;
    if (!scene__keep(p->file, &pixels, &p->textures[p->count - 1])) return 0;
    if (linear && !pixels.is_float) p->textures[p->count - 1].format = SBL_PIXELS_LINEAR8;
    return p->count;
}

/* Returns 1 if red, green and blue are equal in all texels. */
static int scene__is_grey(const sbl_texture *t) {
    const size_t count = (size_t)t->width * (size_t)t->height, size = t->format == SBL_PIXELS_FLOAT ? sizeof(float) : 1;
    const char *at = (const char *)t->pixels;
    size_t i;
    for (i = 0; i < count && t->channels >= 3; i++, at += size * (size_t)t->channels)
        if (memcmp(at, at + size, 2 * size) != 0) return 0;
    return 1;
}

static void scene__free_pictures(scene__pictures *p) {
    while (p->keys && p->count > 0) {
        p->count--;
        free(p->keys[p->count].albedo);
        free(p->keys[p->count].mask);
    }
    while (p->failed_count > 0) free(p->failed[--p->failed_count]);
    free(p->keys);
    free(p->failed);
}

/* ---- the sky ---- */

static void scene__read_sky(scene_file *file, const char *path, scene__bytes *bytes) {
    scene__source source = { NULL, NULL, 0, 0, 1 };
    scene__pixels pixels;
    const char *wrong;
    source.file = file;
    source.data = bytes->data;
    source.size = bytes->size;
    (void)path;
    wrong = scene__decode(&source, "it", 3, &pixels);
    if (wrong) scene__fail(file, "this picture cannot be read (%s); give a .hdr, .png or .jpg picture", wrong);
    else scene__keep(file, &pixels, &file->scene.environment.picture);
}

#endif
