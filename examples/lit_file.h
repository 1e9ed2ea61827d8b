/* Writes a scene with its baked light as one .glb. A glTF viewer shows it without lights, and needs no extension other
   than KHR_materials_unlit: each material is unlit, and its only texture holds the final colours for the screen. These
   are colour times light plus emission, exposed, tone-mapped (PBR Neutral, as SBL_TONE_NEUTRAL) and encoded as sRGB.

   An unlit material shows a single texture; no viewer multiplies two. Therefore the surface colours are copied into the
   charts of the lightmap. They get the texel density of the new texture; reflections and normal maps are lost, and the
   light is fixed. Cut-outs and partial transparency are kept in the alpha of the texture. TEXCOORD_0 and TEXCOORD_1 are
   the same array, the lightmap coordinates, so that viewers with only one set of texture coordinates also show the
   file. Positions are in world space, because the matrix of a glTF node must not contain shear.

   The file has one texture for each lightmap. Meshes without a lightmap are shown in the mean light of the maps.
   Include after gltf_file.h.

       lit_scene lit = { &file->scene, file->names, file->maps, &atlas, 1, 2048 };
       ok = lit_meter(&lit, &light);  // once for each map
       lit.stops = lit_stops(&lit);
       ok = ok && lit_spare(&lit) && lit_make(&lit) && output_write(&target, lit_write, &lit, &interrupted);
       lit_free(&lit); */
#ifndef LIT_FILE_H
#define LIT_FILE_H

#include <signal.h>

typedef struct lit_scene {
    const sbl_scene_desc *scene;
    const char *const *names;   /* one per mesh */
    const int *maps;            /* one per mesh: the index of its map, or -1 if it has none */
    const image *atlases;       /* R of each map, with filled gutters */
    int map_count;
    int size;                   /* width of each texture in texels */
    double stops;               /* exposure in stops */
    double mean[3];             /* lit_meter adds up R here; lit_stops divides by the number of texels */
    double *log_luminances;     /* logarithms of the luminances, from lit_meter */
    size_t log_count;
    int map_index;              /* index of the map whose texture is being drawn */
    unsigned char *texels;      /* the texture: rgba in sRGB; the smaller levels of its pyramid follow */
    unsigned char *rank;        /* per texel: 0: unknown; 255: in a triangle; between: outside, greater if nearer */
    char **pngs;                /* the textures as .png files in memory */
    size_t *png_sizes;
    double gain;                /* 2 to the power of stops */
    const volatile sig_atomic_t *cancel;  /* NULL, or a flag: drawing stops if it is not 0 */
    float *metered;             /* if not NULL, drawing stores luminances here instead of colours in texels */
    int *slots;                 /* index in the .glb of each use of a material: for each map, then for no map, one per
                                   material; -1 if no mesh has this use */
} lit_scene;

enum { LIT_SIZE_MAX = 4096, LIT_SIZE_MIN = 512, LIT_SCALE = 4, LIT_SAMPLES = 4, LIT_METERED = 65536, LIT_SPARED = 256 };
#define LIT_BYTES 7.0  /* bytes per texel of a texture, with its pyramid */

/* Returns the width of the textures for maps of this size: the size of the map if no surface has a texture, otherwise
   LIT_SCALE times the size. The width is halved until the texture fits into `bytes`. */
static inline int lit_size(const sbl_scene_desc *scene, int map_size, double bytes) {
    int i, textured = 0, size;
    for (i = 0; i < scene->material_count; i++)
        textured |= scene->materials[i].albedo_texture || scene->materials[i].emission_texture;
    size = map_size > LIT_SIZE_MAX / LIT_SCALE ? LIT_SIZE_MAX : map_size * LIT_SCALE;
    if (!textured) size = map_size < LIT_SIZE_MAX ? map_size : LIT_SIZE_MAX;
    if (textured && size < LIT_SIZE_MIN) size = LIT_SIZE_MIN;
    while (size > 64 && LIT_BYTES * size * size > bytes) size /= 2;
    return size;
}

/* ---- display colours ---- */

/* The tone curve PBR Neutral, as in shaders_embedded/tone.glsl. */
static inline void lit_tone(double c[3]) {
    const double toe = 0.08, knee = 0.76, fade = 0.15, room = 1 - knee;
    double least = 1e8, peak = 0, shown, fraction;
    int k;
    for (k = 0; k < 3; k++) {
        c[k] = c[k] > 0 ? c[k] < 1e8 ? c[k] : 1e8 : 0;
        if (c[k] < least) least = c[k];
    }
    for (k = 0; k < 3; k++) {
        c[k] -= least < toe ? least - least * least / (2 * toe) : toe / 2;
        if (c[k] > peak) peak = c[k];
    }
    if (peak <= knee) return;
    shown = 1 - room * room / (peak + room - knee);
    fraction = 1 / (fade * (peak - shown) + 1);
    for (k = 0; k < 3; k++) c[k] = shown + (c[k] * (shown / peak) - shown) * fraction;
}

static int lit__compare(const void *a, const void *b) {
    const double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

/* Collects the luminances of a map. Returns 0 if memory runs out. light: R, 0 where there is no surface */
static inline int lit_meter(lit_scene *l, const image *light) {
    const size_t all = (size_t)light->width * (size_t)light->height, step = all / LIT_METERED + 1;
    double *logs = (double *)realloc(l->log_luminances, (l->log_count + all / step + 1) * sizeof *logs);
    size_t i;
    int k;
    if (!logs) return 0;
    l->log_luminances = logs;
    for (i = 0; i < all; i += step) {
        const float *v = light->values + 3 * i;
        const double luminance = 0.2126 * (double)v[0] + 0.7152 * (double)v[1] + 0.0722 * (double)v[2];
        if (!(luminance > 0 && luminance < 1e30)) continue;
        for (k = 0; k < 3; k++) l->mean[k] += (double)v[k];
        logs[l->log_count++] = log(luminance);
    }
    return 1;
}

/* Computes the mean of R and returns the exposure in stops. This is the first rule of sbl_picture_desc.auto_exposure:
   the geometric mean of the luminance, without the darkest and the brightest 5 % of the texels, becomes 0.71. Texels
   below a twentieth of the mean are ignored, because many of them are hidden. */
static inline double lit_stops(lit_scene *l) {
    double *logs = l->log_luminances, sum = 0, stops = 0, mean;
    size_t i, count = l->log_count, dark = 0, cut;
    int k;
    for (k = 0; k < 3 && count; k++) l->mean[k] /= (double)count;
    if (count) qsort(logs, count, sizeof *logs, lit__compare);
    mean = 0.2126 * l->mean[0] + 0.7152 * l->mean[1] + 0.0722 * l->mean[2];
    while (dark < count && logs[dark] < log(mean / 20)) dark++;
    count -= dark;
    cut = count / 20;
    for (i = cut; i < count - cut; i++) sum += logs[dark + i];
    if (count) stops = (log(0.71) - sum / (double)(count - 2 * cut)) / log(2.0);
    return stops;
}

/* ---- surface colours ---- */

static float lit__linear[256];  /* the linear value of each sRGB byte */

static void lit__fill_table(void) {
    int i;
    for (i = 0; i < 256; i++) {
        const double c = i / 255.0;
        lit__linear[i] = (float)(c <= 0.04045 ? c / 12.92 : pow((c + 0.055) / 1.055, 2.4));
    }
}

/* Reads a pixel of a texture as linear RGB and alpha. */
static void lit__pixel(const sbl_texture *t, int x, int y, double out[4]) {
    const int n = t->channels, has_alpha = n % 2 == 0;
    const size_t at = ((size_t)y * (size_t)t->width + (size_t)x) * (size_t)n;
    int k;
    for (k = 0; k < 4; k++) {
        const int alpha = k == 3, from = alpha ? n - 1 : n < 3 ? 0 : k;
        const unsigned char byte = t->format == SBL_PIXELS_FLOAT ? 0 : ((const unsigned char *)t->pixels)[at +
            (size_t)from];
        out[k] = alpha && !has_alpha ? 1
               : t->format == SBL_PIXELS_FLOAT ? (double)((const float *)t->pixels)[at + (size_t)from]
               : alpha || t->format == SBL_PIXELS_LINEAR8 ? byte / 255.0 : (double)lit__linear[byte];
    }
}

static int lit__wrapped(int at, int size, sbl_wrap wrap) {
    if (wrap == SBL_WRAP_CLAMP) return at < 0 ? 0 : at >= size ? size - 1 : at;
    return (at % size + size) % size;
}

/* Reads a texture with bilinear filtering. */
static void lit__sample(const sbl_texture *t, const double uv[2], double out[4]) {
    const int size[2] = { t->width, t->height };
    double fraction[2], pixel[4];
    int from[2], i, k;
    for (k = 0; k < 2; k++) {
        double at = uv[k] * size[k] - 0.5;
        if (!(at > -1e9 && at < 1e9)) at = 0;
        from[k] = (int)floor(at);
        fraction[k] = at - from[k];
    }
    for (k = 0; k < 4; k++) out[k] = 0;
    for (i = 0; i < 4; i++) {
        const double weight = (i & 1 ? fraction[0] : 1 - fraction[0]) * (i & 2 ? fraction[1] : 1 - fraction[1]);
        lit__pixel(t, lit__wrapped(from[0] + (i & 1), size[0], t->wrap),
                   lit__wrapped(from[1] + (i >> 1), size[1], t->wrap), pixel);
        for (k = 0; k < 4; k++) out[k] += weight * pixel[k];
    }
}

/* Reads the light of the map with bilinear filtering. x, y: in texels, from the upper left corner of the map */
static void lit__light(const image *atlas, double x, double y, double out[3]) {
    const double at[2] = { x - 0.5, y - 0.5 };
    const int from[2] = { (int)floor(at[0]), (int)floor(at[1]) };
    int i, k;
    for (k = 0; k < 3; k++) out[k] = 0;
    for (i = 0; i < 4; i++) {
        const int column = lit__wrapped(from[0] + (i & 1), atlas->width, SBL_WRAP_CLAMP);
        const int row = lit__wrapped(from[1] + (i >> 1), atlas->height, SBL_WRAP_CLAMP);
        const double weight = (i & 1 ? at[0] - from[0] : 1 - at[0] + from[0]) *
                              (i & 2 ? at[1] - from[1] : 1 - at[1] + from[1]);
        const float *v = atlas->values + 3 * ((size_t)row * (size_t)atlas->width + (size_t)column);
        for (k = 0; k < 3; k++) out[k] += weight * (double)v[k];
    }
}

/* ---- drawing triangles into the texture ---- */

/* A triangle in the coordinates of the texture. */
typedef struct lit_triangle {
    const sbl_mesh *mesh;
    const sbl_material *material;
    uint32_t corners[3];
    double at[3][2];        /* the corners, in texels */
    double area;            /* twice the signed area */
    int samples;            /* number of samples along each side of a texel */
} lit_triangle;

/* Computes the barycentric coordinates of a point. inside: if 1, negative coordinates become 0, which moves a point
   outside the triangle to its edge */
static void lit__weights(const lit_triangle *t, double x, double y, int inside, double out[3]) {
    double sum = 0;
    int i;
    for (i = 0; i < 3; i++) {
        const double *a = t->at[(i + 1) % 3], *b = t->at[(i + 2) % 3];
        out[i] = ((a[0] - x) * (b[1] - y) - (a[1] - y) * (b[0] - x)) / t->area;
        if (inside && out[i] < 0) out[i] = 0;
        sum += out[i];
    }
    for (i = 0; i < 3; i++) out[i] /= sum;
}

/* Returns the distance from a point to the triangle in texels; 0 inside. */
static double lit__distance(const lit_triangle *t, double x, double y) {
    double weights[3], least = 1e30;
    int i;
    lit__weights(t, x, y, 0, weights);
    if (weights[0] >= 0 && weights[1] >= 0 && weights[2] >= 0) return 0;
    for (i = 0; i < 3; i++) {
        const double *a = t->at[i], *b = t->at[(i + 1) % 3], d[2] = { b[0] - a[0], b[1] - a[1] };
        const double length = d[0] * d[0] + d[1] * d[1];
        double along = length > 0 ? ((x - a[0]) * d[0] + (y - a[1]) * d[1]) / length : 0, apart;
        along = along < 0 ? 0 : along > 1 ? 1 : along;
        apart = hypot(x - a[0] - along * d[0], y - a[1] - along * d[1]);
        if (apart < least) least = apart;
    }
    return least;
}

/* Interpolates n floats per vertex. */
static void lit__mix(const lit_triangle *t, const void *data, int n, const double weights[3], double *out) {
    int i, k;
    for (k = 0; k < n; k++) out[k] = 0;
    for (i = 0; i < 3; i++)
        for (k = 0; k < n; k++)
            out[k] += weights[i] * (double)((const float *)data)[(size_t)n * t->corners[i] + (size_t)k];
}

/* Adds one sample of the surface to a sum of RGB and alpha: colour times light plus emission. */
static void lit__add(const lit_scene *l, const lit_triangle *t, double x, double y, double sum[4]) {
    const sbl_material *m = t->material;
    const image *atlas = &l->atlases[l->map_index];
    const double scale = (double)atlas->width / l->size;
    double weights[3], uv[2] = { 0, 0 }, color[4] = { 1, 1, 1, 1 }, tint[4], glow[4] = { 1, 1, 1, 1 }, R[3];
    int k;
    lit__weights(t, x, y, 1, weights);
    if (t->mesh->texcoords.data) lit__mix(t, t->mesh->texcoords.data, 2, weights, uv);
    if (m->albedo_texture) lit__sample(&l->scene->textures[m->albedo_texture - 1], uv, color);
    if (m->emission_texture) lit__sample(&l->scene->textures[m->emission_texture - 1], uv, glow);
    if (t->mesh->colors.data) {
        lit__mix(t, t->mesh->colors.data, 4, weights, tint);
        for (k = 0; k < 4; k++) color[k] *= tint[k];
    }
    lit__light(atlas, x * scale, y * scale, R);
    for (k = 0; k < 3; k++)
        sum[k] += (double)m->albedo[k] * color[k] * R[k] + (double)m->emission[k] * glow[k];
    sum[3] += color[3] * (1 - 0.9 * (double)m->transmission);
}

/* Computes the texel in column x and row y, or its luminance if l->metered is set. out: receives rgba */
static void lit__texel(const lit_scene *l, const lit_triangle *t, int x, int y, unsigned char *out) {
    const int n = t->samples;
    double sum[4] = { 0, 0, 0, 0 };
    float shown[3];
    int i, k;
    for (i = 0; i < n * n; i++) lit__add(l, t, x + (i % n + 0.5) / n, y + (i / n + 0.5) / n, sum);
    for (k = 0; k < 3; k++) sum[k] *= l->gain / (n * n);
    if (l->metered) {
        l->metered[y * l->size + x] = (float)(0.2126 * sum[0] + 0.7152 * sum[1] + 0.0722 * sum[2]);
        return;
    }
    lit_tone(sum);
    for (k = 0; k < 3; k++) shown[k] = (float)sum[k];
    sbl_encode_srgb8(out, shown, 3, 1);
    out[3] = to_byte(sum[3] / (n * n));
}

/* Returns how many samples along each side of a texel resolve the texels of the surface's texture. */
static int lit__samples(const lit_scene *l, const lit_triangle *t) {
    const int number = t->material->albedo_texture ? t->material->albedo_texture : t->material->emission_texture;
    const double texels = (double)l->atlases[l->map_index].width;
    double least = texels / l->size, across[2] = { 0, 0 }, base[3], moved[3], a[2], b[2];
    int i, samples;
    for (i = 0; i < 2 && number && t->mesh->texcoords.data; i++) {
        const sbl_texture *texture = &l->scene->textures[number - 1];
        lit__weights(t, 0, 0, 0, base);
        lit__weights(t, i == 0, i == 1, 0, moved);
        lit__mix(t, t->mesh->texcoords.data, 2, base, a);
        lit__mix(t, t->mesh->texcoords.data, 2, moved, b);
        across[i] = hypot((b[0] - a[0]) * texture->width, (b[1] - a[1]) * texture->height);
        if (across[i] > least) least = across[i];
    }
    samples = least < LIT_SAMPLES ? (int)ceil(least) : LIT_SAMPLES;
    return samples < 1 ? 1 : samples;
}

/* Draws a triangle and a margin of 1.5 texels. A texel of the margin belongs to the nearest triangle. */
static void lit__draw(lit_scene *l, lit_triangle *t) {
    int low[2], high[2], i, k, x, y;
    for (k = 0; k < 2; k++) {
        double least = t->at[0][k], most = t->at[0][k];
        for (i = 1; i < 3; i++) {
            if (t->at[i][k] < least) least = t->at[i][k];
            if (t->at[i][k] > most) most = t->at[i][k];
        }
        if (!(least > -1e6 && most < 1e6)) return;
        low[k] = least > 2 ? (int)(least - 2) : 0;
        high[k] = most + 2 < l->size ? (int)(most + 2) : l->size;
    }
    t->area = (t->at[1][0] - t->at[0][0]) * (t->at[2][1] - t->at[0][1]) -
              (t->at[1][1] - t->at[0][1]) * (t->at[2][0] - t->at[0][0]);
    if (!(fabs(t->area) > 1e-9)) return;
    t->samples = lit__samples(l, t);
    for (y = low[1]; y < high[1]; y++)
        for (x = low[0]; x < high[0]; x++) {
            const size_t at = (size_t)y * (size_t)l->size + (size_t)x;
            const double distance = l->rank[at] == 255 ? 2 : lit__distance(t, x + 0.5, y + 0.5);
            const int rank = distance > 1.5 ? 0 : distance > 0 ? 254 - (int)(distance * 160) : 255;
            if (rank <= l->rank[at]) continue;
            l->rank[at] = (unsigned char)rank;
            lit__texel(l, t, x, y, l->texels ? l->texels + 4 * at : NULL);
        }
}

static void lit__draw_mesh(lit_scene *l, const sbl_mesh *m) {
    const uint32_t *indices = (const uint32_t *)m->indices.data;
    const float *at = (const float *)m->lightmap_texcoords.data;
    lit_triangle t;
    int i, corner, k;
    memset(&t, 0, sizeof t);
    t.mesh = m;
    t.material = &l->scene->materials[m->material];
    for (i = 0; i + 2 < m->index_count && !(l->cancel && *l->cancel); i += 3) {
        for (corner = 0; corner < 3; corner++) {
            t.corners[corner] = indices[i + corner];
            for (k = 0; k < 2; k++) t.at[corner][k] = (double)at[2 * (size_t)t.corners[corner] + (size_t)k] * l->size;
        }
        lit__draw(l, &t);
    }
}

/* ---- exposure of bright areas ---- */

/* Returns by how many stops the exposure is too high, at most 1.5. This is the second rule of
   sbl_picture_desc.auto_exposure: the geometric mean of the brightest 5 % must not exceed 2.8. shown: luminances of all
   texels before exposure, 0 where there is no surface. stops: the exposure */
static double lit__excess(const float *shown, size_t count, double stops) {
    size_t i, known = 0, top;
    double *logs = (double *)malloc((count + 1) * sizeof *logs), sum = 0, excess;
    for (i = 0; i < count && logs; i++) if (shown[i] > 0) logs[known++] = log((double)shown[i]);
    if (known) qsort(logs, known, sizeof *logs, lit__compare);
    top = (known + 19) / 20;
    for (i = known - top; i < known; i++) sum += logs[i];
    free(logs);
    if (!top) return 0;
    excess = (sum / (double)top - log(2.8)) / log(2.0) + stops;
    return excess < 0 ? 0 : excess > 1.5 ? 1.5 : excess;
}

/* Draws the meshes that use a map. */
static void lit__draw_map(lit_scene *l, int map) {
    int i;
    l->map_index = map;
    for (i = 0; i < l->scene->mesh_count; i++)
        if (l->maps[i] == map) lit__draw_mesh(l, &l->scene->meshes[i]);
}

/* Lowers the exposure by lit__excess, which is measured in small versions of the textures. Returns 0 if memory runs
   out. */
static inline int lit_spare(lit_scene *l) {
    lit_scene small = *l;
    size_t count, all;
    float *shown;
    int map, ok;
    small.size = l->size < LIT_SPARED ? l->size : LIT_SPARED;
    count = (size_t)small.size * (size_t)small.size;
    all = count * (size_t)l->map_count;
    small.gain = 1;
    shown = (float *)calloc(all, sizeof *shown);
    small.rank = (unsigned char *)malloc(count);
    small.texels = NULL;
    ok = shown && small.rank;
    if (ok) lit__fill_table();
    for (map = 0; map < l->map_count && ok; map++) {
        memset(small.rank, 0, count);
        small.metered = shown + count * (size_t)map;
        lit__draw_map(&small, map);
    }
    if (ok) l->stops -= lit__excess(shown, all, l->stops);
    free(shown);
    free(small.rank);
    return ok;
}

/* ---- filling texels outside of triangles ---- */

/* Averages the known texels among four of a larger level into one of the next smaller level. Returns 1 if any was
   known. */
static unsigned char lit__shrink(const unsigned char *texels, const unsigned char *rank, int size, int x, int y,
                                 unsigned char *out) {
    int sum[4] = { 0, 0, 0, 0 }, known = 0, i, k;
    for (i = 0; i < 4; i++) {
        const int column = 2 * x + (i & 1), row = 2 * y + (i >> 1);
        const size_t at = (size_t)row * (size_t)size + (size_t)column;
        if (column >= size || row >= size || !rank[at]) continue;
        for (k = 0; k < 4; k++) sum[k] += texels[4 * at + (size_t)k];
        known++;
    }
    for (k = 0; k < 4 && known; k++) out[k] = (unsigned char)(sum[k] / known);
    return known > 0;
}

/* Fills unknown texels from the smaller levels of a pyramid, so that the mip maps of a viewer mix charts with similar
   colours only. texels, rank: of this level; those of the next smaller level follow in memory */
static void lit__fill(unsigned char *texels, unsigned char *rank, int size) {
    const int half = (size + 1) / 2;
    const size_t count = (size_t)size * (size_t)size;
    unsigned char *next = texels + 4 * count, *next_rank = rank + count;
    int x, y;
    if (size <= 1) return;
    for (y = 0; y < half; y++)
        for (x = 0; x < half; x++) {
            const size_t at = (size_t)y * (size_t)half + (size_t)x;
            next_rank[at] = lit__shrink(texels, rank, size, x, y, next + 4 * at);
        }
    lit__fill(next, next_rank, half);
    for (y = 0; y < size; y++)
        for (x = 0; x < size; x++) {
            const size_t at = (size_t)y * (size_t)size + (size_t)x;
            if (!rank[at]) memcpy(texels + 4 * at, next + 4 * ((size_t)(y / 2) * (size_t)half + (size_t)(x / 2)), 4);
            rank[at] = 1;
        }
}

/* ---- the texture as .png ---- */

static int lit__has_alpha(const sbl_material *m) {
    return (m->flags & SBL_MATERIAL_BLEND) || m->alpha_cutoff > 0 || m->transmission > 0;
}

static int lit__write_png(FILE *out, const lit_scene *l) {
    png_structp png = png_create_write_struct(PNG_LIBPNG_VER_STRING, NULL, on_png_error, on_png_warning);
    png_infop info = png ? png_create_info_struct(png) : NULL;
    volatile int ok = 0, y, alpha = 0;
    int i;
    for (i = 0; i < l->scene->material_count; i++) alpha |= lit__has_alpha(&l->scene->materials[i]);
    if (info && !setjmp(png_jmpbuf(png))) {
        png_init_io(png, out);
        png_set_IHDR(png, info, (png_uint_32)l->size, (png_uint_32)l->size, 8,
                     alpha ? PNG_COLOR_TYPE_RGB_ALPHA : PNG_COLOR_TYPE_RGB, PNG_INTERLACE_NONE,
                     PNG_COMPRESSION_TYPE_DEFAULT, PNG_FILTER_TYPE_DEFAULT);
        png_set_compression_level(png, 4);
        png_write_info(png, info);
        if (!alpha) png_set_filler(png, 0, PNG_FILLER_AFTER);
        for (y = 0; y < l->size; y++) png_write_row(png, l->texels + 4 * (size_t)y * (size_t)l->size);
        png_write_end(png, info);
        ok = 1;
    }
    if (png) png_destroy_write_struct(&png, &info);
    return ok;
}

static inline void lit_free(lit_scene *l) {
    int map;
    for (map = 0; map < l->map_count && l->pngs; map++) free(l->pngs[map]);
    free(l->texels);
    free(l->rank);
    free(l->pngs);
    free(l->png_sizes);
    free(l->slots);
    free(l->log_luminances);
    memset(l, 0, sizeof *l);
}

/* ---- the .glb ---- */

enum { LIT_POSITIONS, LIT_TEXCOORDS, LIT_INDICES, LIT_ARRAYS };

/* Returns 1 if a mesh has triangles to write. */
static int lit__is_shown(const sbl_mesh *m) {
    return m->positions.data && m->indices.data && m->vertex_count > 0 && m->index_count >= 3;
}

/* Returns the size in bytes of an array of a mesh; 0 if the mesh lacks it. */
static size_t lit__bytes(const sbl_mesh *m, int array) {
    if (array == LIT_POSITIONS) return 12 * (size_t)m->vertex_count;
    if (array == LIT_INDICES) return 4 * (size_t)(m->index_count - m->index_count % 3);
    return m->lightmap_texcoords.data ? 8 * (size_t)m->vertex_count : 0;
}

/* Returns the index into l->slots for the material of the mesh with the index i. */
static int lit__slot(const lit_scene *l, int i) {
    const int map = l->maps[i] < 0 ? l->map_count : l->maps[i];
    return l->scene->meshes[i].material + map * l->scene->material_count;
}

static int lit__slot_count(const lit_scene *l) { return (l->map_count + 1) * l->scene->material_count; }

/* Assigns indices to the materials in the order of their first use. Returns 0 if memory runs out. */
static int lit__find_slots(lit_scene *l) {
    const int count = lit__slot_count(l);
    int i, used = 0;
    l->slots = (int *)malloc(((size_t)count + 1) * sizeof *l->slots);
    for (i = 0; i < count && l->slots; i++) l->slots[i] = -1;
    for (i = 0; i < l->scene->mesh_count && l->slots; i++) {
        int *slot = &l->slots[lit__slot(l, i)];
        if (lit__is_shown(&l->scene->meshes[i]) && *slot < 0) *slot = used++;
    }
    return l->slots != NULL;
}

/* Returns the number of arrays in the .glb. */
static int lit__array_count(const lit_scene *l) {
    int i, k, count = 0;
    for (i = 0; i < l->scene->mesh_count; i++)
        for (k = 0; k < LIT_ARRAYS && lit__is_shown(&l->scene->meshes[i]); k++)
            count += lit__bytes(&l->scene->meshes[i], k) > 0;
    return count;
}

/* Computes the world position of a vertex. */
static void lit__position(const sbl_mesh *m, int vertex, float out[3]) {
    const float *p = (const float *)m->positions.data + 3 * (size_t)vertex, *t = m->transform;
    int k, moved = 0;
    for (k = 0; k < 16; k++) moved |= t[k] != 0.0f;
    for (k = 0; k < 3; k++)
        out[k] = !moved ? p[k] : (float)((double)t[k] * (double)p[0] + (double)t[4 + k] * (double)p[1] +
                                         (double)t[8 + k] * (double)p[2] + (double)t[12 + k]);
}

static void lit__put_float(FILE *out, float v) {
    uint32_t word;
    memcpy(&word, &v, 4);
    gltf__put_word(out, word);
}

static void lit__put_mesh_bytes(FILE *out, const sbl_mesh *m) {
    const int has_map = m->lightmap_texcoords.data != NULL;
    float p[3];
    int i, k;
    for (i = 0; i < m->vertex_count; i++) {
        lit__position(m, i, p);
        for (k = 0; k < 3; k++) lit__put_float(out, p[k]);
    }
    for (i = 0; i < 2 * m->vertex_count && has_map; i++)
        lit__put_float(out, ((const float *)m->lightmap_texcoords.data)[i]);
    for (i = 0; i < m->index_count - m->index_count % 3; i++)
        gltf__put_word(out, ((const uint32_t *)m->indices.data)[i]);
}

static void lit__put_bounds(FILE *out, const sbl_mesh *m) {
    float low[3] = { 0, 0, 0 }, high[3] = { 0, 0, 0 }, p[3];
    int i, k;
    for (i = 0; i < m->vertex_count; i++) {
        lit__position(m, i, p);
        for (k = 0; k < 3; k++) {
            if (i == 0 || p[k] < low[k]) low[k] = p[k];
            if (i == 0 || p[k] > high[k]) high[k] = p[k];
        }
    }
    fprintf(out, ", \"min\": [%.9g, %.9g, %.9g], \"max\": [%.9g, %.9g, %.9g]", (double)low[0], (double)low[1],
            (double)low[2], (double)high[0], (double)high[1], (double)high[2]);
}

/* Writes the accessors, or (views: 1) the buffer views of all arrays and textures. Returns the size of the views in
   bytes. */
static double lit__put_arrays(FILE *out, const lit_scene *l, int views) {
    static const struct { const char *type; int component, target, bytes; } kinds[LIT_ARRAYS] = {
        { "VEC3", 5126, 34962, 12 }, { "VEC2", 5126, 34962, 8 }, { "SCALAR", 5125, 34963, 4 }
    };
    int i, k, count = 0;
    double at = 0;
    for (i = 0; i < l->scene->mesh_count; i++) {
        const sbl_mesh *m = &l->scene->meshes[i];
        for (k = 0; k < LIT_ARRAYS && lit__is_shown(m); k++) {
            const size_t bytes = lit__bytes(m, k);
            if (!bytes) continue;
            if (views)
                fprintf(out, "%s\n    {\"buffer\": 0, \"byteOffset\": %.0f, \"byteLength\": %.0f, \"target\": %d}",
                        count ? "," : "", at, (double)bytes, kinds[k].target);
            else {
                fprintf(out, "%s\n    {\"bufferView\": %d, \"componentType\": %d, \"count\": %.0f, \"type\": \"%s\"",
                        count ? "," : "", count, kinds[k].component, (double)bytes / kinds[k].bytes, kinds[k].type);
                if (k == LIT_POSITIONS) lit__put_bounds(out, m);
                fputc('}', out);
            }
            at += (double)bytes;
            count++;
        }
    }
    for (k = 0; k < l->map_count; k++) {
        if (views)
            fprintf(out, ",\n    {\"buffer\": 0, \"byteOffset\": %.0f, \"byteLength\": %.0f}", at,
                    (double)l->png_sizes[k]);
        at += (double)l->png_sizes[k];
    }
    return at;
}

/* Writes the material of a slot of l->slots. */
static void lit__put_material(FILE *out, const lit_scene *l, int slot) {
    const sbl_material *m = &l->scene->materials[slot % l->scene->material_count];
    const int map = slot / l->scene->material_count, mapped = map < l->map_count;
    double color[3];
    int k;
    for (k = 0; k < 3; k++) color[k] = l->gain * ((double)m->albedo[k] * l->mean[k] + (double)m->emission[k]);
    lit_tone(color);
    fprintf(out, "{\"doubleSided\": true, \"extensions\": {\"KHR_materials_unlit\": {}}, "
            "\"pbrMetallicRoughness\": {\"metallicFactor\": 0, \"roughnessFactor\": 1, ");
    if (mapped) fprintf(out, "\"baseColorTexture\": {\"index\": %d, \"texCoord\": 1}}", map);
    else fprintf(out, "\"baseColorFactor\": [%.7g, %.7g, %.7g, 1]}", color[0], color[1], color[2]);
    if (mapped && ((m->flags & SBL_MATERIAL_BLEND) || m->transmission > 0)) fprintf(out, ", \"alphaMode\": \"BLEND\"");
    else if (mapped && m->alpha_cutoff > 0)
        fprintf(out, ", \"alphaMode\": \"MASK\", \"alphaCutoff\": %.7g", (double)m->alpha_cutoff);
    fputc('}', out);
}

/* Writes the materials that meshes use, in the order of their indices. */
static void lit__put_materials(FILE *out, const lit_scene *l) {
    const int count = lit__slot_count(l);
    int number, i, found = 1;
    for (number = 0; found; number++)
        for (i = 0, found = 0; i < count && !found; i++) {
            if (l->slots[i] != number) continue;
            fprintf(out, "%s\n    ", number ? "," : "");
            lit__put_material(out, l, i);
            found = 1;
        }
}

static void lit__put_meshes(FILE *out, const lit_scene *l) {
    const sbl_mesh *m = l->scene->meshes;
    int i, count = 0, accessor = 0;
    for (i = 0; i < l->scene->mesh_count; i++, m++) {
        const int mapped = m->lightmap_texcoords.data != NULL;
        if (!lit__is_shown(m)) continue;
        fprintf(out, "%s\n    {\"primitives\": [{\"material\": %d, \"attributes\": {\"POSITION\": %d",
                count++ ? "," : "", l->slots[lit__slot(l, i)], accessor);
        if (mapped) fprintf(out, ", \"TEXCOORD_0\": %d, \"TEXCOORD_1\": %d", accessor + 1, accessor + 1);
        fprintf(out, "}, \"indices\": %d}]}", accessor + 1 + mapped);
        accessor += 2 + mapped;
    }
}

static void lit__put_nodes(FILE *out, const lit_scene *l) {
    int i, count = 0;
    for (i = 0; i < l->scene->mesh_count; i++) {
        if (!lit__is_shown(&l->scene->meshes[i])) continue;
        fprintf(out, "%s\n    {\"name\": ", count ? "," : "");
        gltf__put_name(out, l->names[i]);
        fprintf(out, ", \"mesh\": %d}", count++);
    }
    fprintf(out, "\n  ],\n  \"scene\": 0, \"scenes\": [{\"nodes\": [");
    for (i = 0; i < count; i++) fprintf(out, "%s%d", i ? ", " : "", i);
    fprintf(out, "]}]");
}

/* Writes the JSON of the .glb. Returns the size of the arrays and textures in bytes. */
static double lit__put_json(FILE *out, const lit_scene *l) {
    const int arrays = lit__array_count(l);
    double bytes;
    int map;
    fprintf(out, "{\n  \"asset\": {\"version\": \"2.0\", \"generator\": \"sbl.h %s\", \"extras\": {\"tone\": "
            "\"PBR Neutral\", \"exposure_stops\": %.9g}},\n  \"extensionsUsed\": [\"KHR_materials_unlit\"],\n"
            "  \"images\": [", sbl_version(), l->stops);
    for (map = 0; map < l->map_count; map++)
        fprintf(out, "%s{\"mimeType\": \"image/png\", \"bufferView\": %d}", map ? ", " : "", arrays + map);
    fprintf(out, "],\n  \"samplers\": [{\"magFilter\": 9729, \"minFilter\": 9987, \"wrapS\": 33071, "
            "\"wrapT\": 33071}],\n  \"textures\": [");
    for (map = 0; map < l->map_count; map++)
        fprintf(out, "%s{\"source\": %d, \"sampler\": 0}", map ? ", " : "", map);
    fprintf(out, "],\n  \"materials\": [");
    lit__put_materials(out, l);
    fprintf(out, "\n  ],\n  \"accessors\": [");
    lit__put_arrays(out, l, 0);
    fprintf(out, "\n  ],\n  \"bufferViews\": [");
    bytes = lit__put_arrays(out, l, 1);
    fprintf(out, "\n  ],\n  \"buffers\": [{\"byteLength\": %.0f}],\n  \"meshes\": [", bytes);
    lit__put_meshes(out, l);
    fprintf(out, "\n  ],\n  \"nodes\": [");
    lit__put_nodes(out, l);
    fprintf(out, "\n}\n");
    return bytes;
}

/* Draws and compresses the texture of one map. Returns 0 if memory runs out. */
static int lit__make_texture(lit_scene *l, int map, size_t levels) {
    FILE *out;
    int ok;
    memset(l->texels, 0, 4 * levels);
    memset(l->rank, 0, levels);
    lit__draw_map(l, map);
    if (l->cancel && *l->cancel) return 1;
    lit__fill(l->texels, l->rank, l->size);
    out = open_memstream(&l->pngs[map], &l->png_sizes[map]);
    if (!out) return 0;
    ok = lit__write_png(out, l);
    return fclose(out) == 0 && ok;
}

/* Draws and compresses the textures of all maps, or stops early if *l->cancel is not 0. Returns 0 if memory runs
   out. */
static inline int lit_make(lit_scene *l) {
    const size_t count = (size_t)l->size * (size_t)l->size, levels = count + count / 3 + 4 * (size_t)l->size + 64;
    int map, ok = lit__find_slots(l);
    l->gain = pow(2, l->stops);
    lit__fill_table();
    l->texels = (unsigned char *)malloc(4 * levels);
    l->rank = (unsigned char *)malloc(levels);
    l->pngs = (char **)calloc((size_t)l->map_count + 1, sizeof *l->pngs);
    l->png_sizes = (size_t *)calloc((size_t)l->map_count + 1, sizeof *l->png_sizes);
    ok = ok && l->texels && l->rank && l->pngs && l->png_sizes;
    for (map = 0; map < l->map_count && ok && !(l->cancel && *l->cancel); map++)
        ok = lit__make_texture(l, map, levels);
    return ok;
}

/* Writes the .glb, for output_write. Returns 0 and sets errno on failure. */
static inline int lit_write(FILE *out, const void *what) {
    const lit_scene *l = (const lit_scene *)what;
    char *json = NULL;
    size_t length = 0, i;
    double bytes, total;
    int map;
    FILE *text = open_memstream(&json, &length);
    if (!text) return 0;
    bytes = lit__put_json(text, l);
    if (fclose(text) != 0) { free(json); return 0; }
    total = 28 + ceil((double)length / 4) * 4 + ceil(bytes / 4) * 4;
    if (total > 4294967295.0) {
        free(json);
        errno = EFBIG;
        return 0;
    }
    gltf__put_word(out, 0x46546c67);  /* "glTF" */
    gltf__put_word(out, 2);
    gltf__put_word(out, (uint32_t)total);
    gltf__put_word(out, (uint32_t)((length + 3) / 4 * 4));
    gltf__put_word(out, 0x4e4f534a);  /* "JSON" */
    fwrite(json, 1, length, out);
    for (i = length; i % 4; i++) fputc(' ', out);
    free(json);
    i = (size_t)bytes;
    gltf__put_word(out, (uint32_t)((i + 3) / 4 * 4));
    gltf__put_word(out, 0x004e4942);  /* "BIN" */
    for (length = 0; length < (size_t)l->scene->mesh_count; length++)
        if (lit__is_shown(&l->scene->meshes[length])) lit__put_mesh_bytes(out, &l->scene->meshes[length]);
    for (map = 0; map < l->map_count; map++) fwrite(l->pngs[map], 1, l->png_sizes[map], out);
    for (; i % 4; i++) fputc(0, out);
    return 1;
}

#endif
