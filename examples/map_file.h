/* Writes lightmaps in formats that engines load. The first row in the file is the top row, except in a .pfm, whose
   first row is the bottom row.

       format      file         a texel
       exr         .exr         three 16-bit floats
       exr32       .exr         three 32-bit floats
       hdr         .hdr         RGBE: three bytes and a common exponent; nothing negative
       rgbm        .rgbm.png    four bytes: R = (range * alpha * rgb)^2, bytes are linear; nothing negative
       ktx2        .ktx2        four 16-bit floats (VK_FORMAT_R16G16B16A16_SFLOAT), alpha 1, not compressed
       pfm         .pfm         three 32-bit floats

   A file contains finite numbers only: a value beyond the range of the format becomes the nearest value in the range,
   and NaN becomes 0. map_survey_of counts such values beforehand. Include after picture_file.h, gltf_file.h and
   ktx2_file.h.

       map_survey_of(&survey, &picture);
       ok = map_write(stream, &(map_source){ &picture, MAP_HDR, 0, 0 }); */
#ifndef MAP_FILE_H
#define MAP_FILE_H

typedef enum map_format { MAP_RGBM, MAP_HDR, MAP_KTX2, MAP_EXR, MAP_PFM, MAP_FORMATS } map_format;

static const char *const map_endings[MAP_FORMATS] = { ".rgbm.png", ".hdr", ".ktx2", ".exr", ".pfm" };

/* The formats to write. exact: 1 if a .exr has 32-bit floats */
typedef struct map_formats { int wanted[MAP_FORMATS], exact; } map_formats;

/* Reads a list such as "exr,ktx2". Returns NULL, or a message for the user that is valid until the next call. */
static inline const char *map_formats_read(map_formats *out, const char *list) {
    static const struct { const char *name; map_format format; int exact; } known[] = {
        { "exr", MAP_EXR, 0 }, { "exr32", MAP_EXR, 1 }, { "hdr", MAP_HDR, 0 }, { "rgbm", MAP_RGBM, 0 },
        { "ktx2", MAP_KTX2, 0 }, { "pfm", MAP_PFM, 0 }
    };
    static char message[160];
    size_t i, length;
    memset(out, 0, sizeof *out);
    for (;; list += length + 1) {
        length = strcspn(list, ",");
        for (i = 0; i < 6; i++)
            if (strlen(known[i].name) == length && strncmp(known[i].name, list, length) == 0) break;
        snprintf(message, sizeof message, "'%.*s' is not one of exr, exr32, hdr, rgbm, ktx2, pfm", (int)(length < 40 ?
                 length : 40), list);
        if (i == 6) return message;
        if (out->wanted[known[i].format] && known[i].format == MAP_EXR && out->exact != known[i].exact)
            return "exr and exr32 would write the same file; give one of them";
        out->wanted[known[i].format] = 1;
        out->exact |= known[i].exact;
        if (!list[length]) return NULL;
    }
}

static inline int map_holds_negative(map_format format) { return format != MAP_HDR && format != MAP_RGBM; }

/* ---- ranges of values ---- */

#define MAP_HALF_MAX 65504.0f    /* largest finite 16-bit float */
#define MAP_HALF_MIN 6.1035e-5f /* smallest 16-bit float with full precision */
#define MAP_RGBE_MAX 1e38f
#define MAP_FLOAT_MAX 3.4e38f

/* Statistics of the values of a map. */
typedef struct map_survey {
    size_t strange, above_half;   /* numbers of values: not finite; finite, but beyond MAP_HALF_MAX */
    float most;                   /* largest finite value */
} map_survey;

static inline void map_survey_of(map_survey *s, const image *map) {
    const size_t count = (size_t)map->width * (size_t)map->height * (size_t)map->components;
    size_t i;
    for (i = 0; i < count; i++) {
        const float v = map->values[i];
        if (!isfinite(v)) { s->strange++; continue; }
        s->above_half += v > MAP_HALF_MAX || v < -MAP_HALF_MAX;
        if (v > s->most) s->most = v;
    }
}

/* Returns the range of rgbm for a map whose largest value is `most`: the smallest power of two whose square is not
   below it. */
static inline double map_rgbm_range(float most) {
    double range = 1.0 / (1 << 20);
    while (range * range < (double)most) range *= 2;
    return range;
}

/* Returns the value that a format with the range from least to most stores instead of v. NaN becomes 0. */
static inline float map__fit(float v, float least, float most) {
    return v >= most ? most : v <= least ? least : isnan(v) ? 0.0f : v;
}

/* ---- writing ---- */

/* A map and the way to write it. exact: as in map_formats; range: for rgbm only */
typedef struct map_source { const image *map; map_format format; int exact; double range; } map_source;

enum { MAP_BAND = 64 };  /* number of rows that are converted at a time */

/* Copies rows of a map, with values clamped to a range. */
static void map__copy(float *to, const image *map, int first, int rows, float least, float most) {
    const size_t row = (size_t)map->width * (size_t)map->components;
    const float *from = map->values + (size_t)first * row;
    size_t i;
    for (i = 0; i < row * (size_t)rows; i++) to[i] = map__fit(from[i], least, most);
}

/* Writes a .exr or .pfm in bands of rows. A .pfm begins with the last band. Returns 0 on failure. */
static int map__write_floats(FILE *out, const map_source *s) {
    const image *map = s->map;
    const int bands = (map->height + MAP_BAND - 1) / MAP_BAND, is_half = s->format == MAP_EXR && !s->exact;
    const float most = is_half ? MAP_HALF_MAX : MAP_FLOAT_MAX;
    float *band = (float *)malloc((size_t)map->width * MAP_BAND * (size_t)map->components * sizeof *band);
    image frame = *map;
    picture_writer w;
    int i, ok;
    if (!band) return 0;
    frame.is_half = is_half;
    ok = picture_begin(&w, out, map_endings[s->format], &frame, SBL_CHANNEL_FINAL, 0);
    for (i = 0; i < bands && ok; i++) {
        const int first = MAP_BAND * (s->format == MAP_PFM ? bands - 1 - i : i);
        const int rows = map->height - first < MAP_BAND ? map->height - first : MAP_BAND;
        map__copy(band, map, first, rows, -most, most);
        ok = picture_put(&w, first, rows, band);
    }
    free(band);
    return picture_end(&w, ok);
}

/* stb_image_write truncates mantissas to eight bits. This adds half a step to each component, so that truncation
   rounds. */
static void map__round_rgbe(float *v) {
    const float most = v[0] > v[1] ? v[0] > v[2] ? v[0] : v[2] : v[1] > v[2] ? v[1] : v[2];
    int exponent, k;
    float step;
    frexp((double)most, &exponent);
    step = (float)ldexp(1, exponent - 9);
    if (frexp((double)(most + step), &k) >= 0.5 && k > exponent) step *= 2;
    for (k = 0; k < 3 && most > 1e-30f; k++) v[k] += step;
}

static int map__write_hdr(FILE *out, const map_source *s) {
    const image *map = s->map;
    const size_t texels = (size_t)map->width * (size_t)map->height;
    float *values = (float *)malloc(3 * texels * sizeof *values);
    size_t i;
    int ok;
    if (!values) return 0;
    map__copy(values, map, 0, map->height, 0, MAP_RGBE_MAX);
    for (i = 0; i < texels; i++) map__round_rgbe(values + 3 * i);
    ok = stbi_write_hdr_to_func(gltf__put_bytes, out, map->width, map->height, 3, values);
    free(values);
    return ok;
}

/* Converts a texel to rgbm. */
static void map__to_rgbm(unsigned char out[4], const float *v, double range) {
    double root[3], most = 0, m;
    int k;
    for (k = 0; k < 3; k++) {
        root[k] = sqrt((double)map__fit(v[k], 0, MAP_FLOAT_MAX)) / range;
        if (root[k] > most) most = root[k];
    }
    m = ceil(most * 255);
    if (m < 1) m = 1;
    if (m > 255) m = 255;
    for (k = 0; k < 3; k++) out[k] = to_byte(root[k] * 255 / m);
    out[3] = (unsigned char)m;
}

/* Converts row y of a picture to bytes, all channels of a pixel together. what: the value passed to map_write_bytes */
typedef void (*map_row)(unsigned char *to, const void *what, int y);

/* Writes a .png from the bytes that row_of makes; no colour space is applied or recorded. Returns 1 on success.
   channels: 1 (grey) or 4 (rgba). texts: text_count texts that the file also stores, each with a key */
static int map_write_bytes(FILE *out, const image *size, int channels, map_row row_of, const void *what,
                           const png_text *texts, int text_count) {
    png_structp png = png_create_write_struct(PNG_LIBPNG_VER_STRING, NULL, on_png_error, on_png_warning);
    png_infop info = png ? png_create_info_struct(png) : NULL;
    unsigned char *volatile row = (unsigned char *)malloc((size_t)channels * (size_t)size->width);
    volatile int ok = 0, y;
    if (info && row && !setjmp(png_jmpbuf(png))) {
        png_init_io(png, out);
        png_set_IHDR(png, info, (png_uint_32)size->width, (png_uint_32)size->height, 8,
                     channels == 1 ? PNG_COLOR_TYPE_GRAY : PNG_COLOR_TYPE_RGB_ALPHA, PNG_INTERLACE_NONE,
                     PNG_COMPRESSION_TYPE_DEFAULT, PNG_FILTER_TYPE_DEFAULT);
        if (text_count) png_set_text(png, info, texts, text_count);
        png_write_info(png, info);
        for (y = 0; y < size->height; y++) {
            row_of(row, what, y);
            png_write_row(png, row);
        }
        png_write_end(png, info);
        ok = 1;
    }
    free(row);
    if (png) png_destroy_write_struct(&png, &info);
    return ok;
}

/* Converts values from 0 to 1 to bytes. what: an image */
static inline void map_row_of_fractions(unsigned char *to, const void *what, int y) {
    const image *map = (const image *)what;
    const size_t count = (size_t)map->width * (size_t)map->components;
    size_t i;
    for (i = 0; i < count; i++) to[i] = to_byte((double)map->values[count * (size_t)y + i]);
}

static void map__row_of_rgbm(unsigned char *to, const void *what, int y) {
    const map_source *s = (const map_source *)what;
    const float *from = s->map->values + 3 * (size_t)y * (size_t)s->map->width;
    int x;
    for (x = 0; x < s->map->width; x++) map__to_rgbm(to + 4 * (size_t)x, from + 3 * (size_t)x, s->range);
}

static int map__write_rgbm(FILE *out, const map_source *s) {
    char range[32];
    png_text texts[2];
    snprintf(range, sizeof range, "%.9g", s->range);
    memset(texts, 0, sizeof texts);
    texts[0].compression = texts[1].compression = PNG_TEXT_COMPRESSION_NONE;
    texts[0].key = (char *)(uintptr_t)"sbl.range";
    texts[0].text = range;
    texts[1].key = (char *)(uintptr_t)"sbl.light";
    texts[1].text = (char *)(uintptr_t)"R = (range * alpha * rgb)^2, bytes are linear; irradiance = pi * R";
    return map_write_bytes(out, s->map, 4, map__row_of_rgbm, s, texts, 2);
}

static int map__write_ktx2(FILE *out, const map_source *s) {
    const float *const levels[1] = { s->map->values };
    const ktx2_picture picture = { s->map->width, s->map->height, 1, 1, 3, KTX2_HALF, levels, "sbl.h" };
    return ktx2_write(out, &picture);
}

/* Writes a map of three components. Returns 0 on failure. Some formats do not report errors of the stream here, so the
   caller must also check ferror(out). */
static inline int map_write(FILE *out, const map_source *s) {
    switch (s->format) {
        case MAP_HDR: return map__write_hdr(out, s);
        case MAP_RGBM: return map__write_rgbm(out, s);
        case MAP_KTX2: return map__write_ktx2(out, s);
        default: return map__write_floats(out, s);
    }
}

#endif
