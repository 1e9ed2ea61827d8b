/* Reads the maps that map_file.h writes: .pfm, .exr (16-bit or 32-bit floats), .ktx2, .hdr and .rgbm.png. The first row
   of the result is the top row. Include after picture_file.h, scene_file.h and tool_scene.h.

       image light = { 0 };
       ok = map_read("baked/atlas.ktx2", &light);  // the caller frees light.values */
#ifndef MAP_READER_H
#define MAP_READER_H

#ifdef SCENE_FILE_ELSEWHERE  /* the object of scene_file.h contains stb_image; otherwise, scene_file.h includes it */
  #define STBI_NO_STDIO
  #include <stb/stb_image.h>
#endif

enum { MAP_READ_MAX = 16384 };  /* maximum width and height in pixels */

/* Allocates values of three components for a picture. Returns 0 if its size is not allowed or memory runs out. */
static int map__room(image *picture) {
    const int w = picture->width, h = picture->height;
    if (w < 1 || h < 1 || w > MAP_READ_MAX || h > MAP_READ_MAX) return 0;
    picture->components = 3;
    picture->values = (float *)malloc((size_t)w * (size_t)h * 3 * sizeof(float));
    return picture->values != NULL;
}

/* Reads a .pfm as picture_file.h writes it, with the bottom row first. */
static int map__read_pfm(FILE *in, image *picture) {
    char line[4] = "";
    double scale = 0;
    int y, ok = fgets(line, 4, in) && strcmp(line, "PF\n") == 0 &&
                fscanf(in, "%d %d %lf", &picture->width, &picture->height, &scale) == 3 && fgetc(in) == '\n' &&
                scale < 0 && map__room(picture);
    for (y = picture->height - 1; ok && y >= 0; y--) {
        const size_t row = 3 * (size_t)picture->width;
        ok = fread(picture->values + (size_t)y * row, sizeof(float), row, in) == row;
    }
    return ok;
}

/* Returns the value of a 16-bit float; NaN for infinities. */
static float map__of_half(unsigned half) {
    const int exponent = (int)(half >> 10 & 31), digits = (int)(half & 1023);
    const double v = exponent == 31 ? NAN : exponent ? ldexp(1024 + digits, exponent - 25) : ldexp(digits, -24);
    return (float)(half & 0x8000 ? -v : v);
}

static uint32_t map__word(const unsigned char *p) {
    return (uint32_t)p[0] | (uint32_t)p[1] << 8 | (uint32_t)p[2] << 16 | (uint32_t)p[3] << 24;
}

/* Reads a .ktx2 with one uncompressed level in VK_FORMAT_R16G16B16A16_SFLOAT. */
static int map__read_ktx2(FILE *in, image *picture) {
    unsigned char head[104], texel[8];
    size_t i, texels;
    int k, ok = fread(head, 1, sizeof head, in) == sizeof head && memcmp(head, "\xabKTX 20\xbb\r\n\x1a\n", 12) == 0 &&
                map__word(head + 12) == 97 && map__word(head + 40) == 1 && map__word(head + 44) == 0;
    picture->width = (int)map__word(head + 20);
    picture->height = (int)map__word(head + 24);
    ok = ok && map__room(picture) && fseek(in, (long)(map__word(head + 80) & 0x7fffffff), SEEK_SET) == 0;
    texels = (size_t)picture->width * (size_t)picture->height;
    for (i = 0; i < texels && ok; i++) {
        ok = fread(texel, 1, 8, in) == 8;
        for (k = 0; k < 3 && ok; k++)
            picture->values[3 * i + (size_t)k] = map__of_half(texel[2 * k] | (unsigned)texel[2 * k + 1] << 8);
    }
    return ok;
}

/* Reads all bytes of a file, which the caller frees. Returns NULL on failure. */
static unsigned char *map__bytes(FILE *in, int *size) {
    const long long end = fseek(in, 0, SEEK_END) == 0 ? ftell(in) : -1;
    unsigned char *bytes = end > 0 && end <= INT_MAX ? (unsigned char *)malloc((size_t)end) : NULL;
    *size = (int)end;
    if (bytes && fseek(in, 0, SEEK_SET) == 0 && fread(bytes, 1, (size_t)end, in) == (size_t)end) return bytes;
    free(bytes);
    return NULL;
}

static int map__read_hdr(FILE *in, image *picture) {
    int channels, size, ok;
    unsigned char *bytes = map__bytes(in, &size);
    float *values = bytes ? stbi_loadf_from_memory(bytes, size, &picture->width, &picture->height, &channels, 3) : NULL;
    ok = values && map__room(picture);
    if (ok) memcpy(picture->values, values, (size_t)picture->width * (size_t)picture->height * 3 * sizeof *values);
    stbi_image_free(values);
    free(bytes);
    return ok;
}

/* Reads the range of rgbm from the text chunks of a .png. Returns 0 if they contain none. */
static double map__rgbm_range(FILE *in) {
    static const char key[] = "sbl.range";
    unsigned char head[8], text[64];
    double range = 0;
    if (fseek(in, 8, SEEK_SET) != 0) return 0;
    while (range <= 0 && fread(head, 1, 8, in) == 8 && memcmp(head + 4, "IDAT", 4) != 0) {
        const long length = (long)head[0] << 24 | (long)head[1] << 16 | (long)head[2] << 8 | (long)head[3];
        const long used = memcmp(head + 4, "tEXt", 4) == 0 && length > 10 && length < 64 ? length : 0;
        if (length < 0 || fread(text, 1, (size_t)used, in) != (size_t)used) return 0;
        text[used] = 0;
        if (used && memcmp(text, key, sizeof key) == 0) range = strtod((const char *)text + sizeof key, NULL);
        if (fseek(in, length - used + 4, SEEK_CUR) != 0) return 0;
    }
    return range;
}

static int map__read_rgbm(FILE *in, image *picture) {
    const double range = map__rgbm_range(in);
    int channels, k, size, ok;
    unsigned char *file = range > 0 ? map__bytes(in, &size) : NULL, *bytes = NULL;
    size_t i, texels;
    if (file) bytes = stbi_load_from_memory(file, size, &picture->width, &picture->height, &channels, 4);
    free(file);
    ok = bytes && map__room(picture);
    texels = (size_t)picture->width * (size_t)picture->height;
    for (i = 0; i < texels && ok; i++)
        for (k = 0; k < 3; k++) {
            const double root = range * bytes[4 * i + 3] / 255 * bytes[4 * i + (size_t)k] / 255;
            picture->values[3 * i + (size_t)k] = (float)(root * root);
        }
    stbi_image_free(bytes);
    return ok;
}

#ifdef SBL_RENDER_OPENEXR
/* Decodes the pixels of an .exr with the channels R, G and B. Returns 0 on failure. top: first row of the data
   window */
static int map__decode_exr(exr_context_t exr, image *picture, int top) {
    exr_decode_pipeline_t decoder;
    exr_chunk_info_t chunk;
    exr_result_t result = EXR_ERR_SUCCESS;
    int32_t step = 1;
    int y, k;
    memset(&decoder, 0, sizeof decoder);
    if (exr_get_scanlines_per_chunk(exr, 0, &step) != EXR_ERR_SUCCESS || step < 1) return 0;
    for (y = 0; y < picture->height && result == EXR_ERR_SUCCESS; y += step) {
        result = exr_read_scanline_chunk_info(exr, 0, top + y, &chunk);
        if (result == EXR_ERR_SUCCESS)
            result = y ? exr_decoding_update(exr, 0, &chunk, &decoder)
                       : exr_decoding_initialize(exr, 0, &chunk, &decoder);
        for (k = 0; k < decoder.channel_count && result == EXR_ERR_SUCCESS; k++) {
            exr_coding_channel_info_t *c = &decoder.channels[k];
            const int component = picture__component(picture, c->channel_name);
            if (component < 0) continue;
            c->decode_to_ptr = (uint8_t *)(picture->values + 3 * (size_t)y * (size_t)picture->width + component);
            c->user_bytes_per_element = 4;
            c->user_data_type = EXR_PIXEL_FLOAT;
            c->user_pixel_stride = 12;
            c->user_line_stride = 12 * picture->width;
        }
        if (result == EXR_ERR_SUCCESS && !y) result = exr_decoding_choose_default_routines(exr, 0, &decoder);
        if (result == EXR_ERR_SUCCESS) result = exr_decoding_run(exr, 0, &decoder);
    }
    exr_decoding_destroy(exr, &decoder);
    return result == EXR_ERR_SUCCESS;
}

/* Returns 1 if an .exr has a single part of scanlines with exactly the channels R, G and B. */
static int map__is_rgb(exr_context_t exr) {
    const image rgb = { 1, 1, 3, NULL, NULL, { 0, 0 }, { 0, 0 }, NULL, 0 };
    const exr_attr_chlist_t *list = NULL;
    exr_storage_t storage;
    int count = 0, k;
    if (exr_get_count(exr, &count) != EXR_ERR_SUCCESS || count != 1) return 0;
    if (exr_get_storage(exr, 0, &storage) != EXR_ERR_SUCCESS || storage != EXR_STORAGE_SCANLINE) return 0;
    if (exr_get_channels(exr, 0, &list) != EXR_ERR_SUCCESS || !list || list->num_channels != 3) return 0;
    for (k = 0; k < 3; k++)
        if (picture__component(&rgb, list->entries[k].name.str) < 0 || list->entries[k].x_sampling != 1 ||
            list->entries[k].y_sampling != 1 || list->entries[k].pixel_type == EXR_PIXEL_UINT) return 0;
    return 1;
}

static int map__read_exr(const char *path, image *picture) {
    exr_context_initializer_t settings = EXR_DEFAULT_CONTEXT_INITIALIZER;
    exr_context_t exr = NULL;
    exr_attr_box2i_t data;
    int ok;
    settings.error_handler_fn = on_exr_error;
    if (exr_start_read(&exr, path, &settings) != EXR_ERR_SUCCESS) return 0;
    ok = map__is_rgb(exr) && exr_get_data_window(exr, 0, &data) == EXR_ERR_SUCCESS;
    if (ok) {
        picture->width = data.max.x - data.min.x + 1;
        picture->height = data.max.y - data.min.y + 1;
        ok = map__room(picture) && map__decode_exr(exr, picture, data.min.y);
    }
    exr_finish(&exr);
    return ok;
}
#else
static int map__read_exr(const char *path, image *picture) { (void)path; (void)picture; return 0; }
#endif

/* Reads a map; the ending of the file name selects the format. Returns 0 if the file cannot be read completely or holds
   a value that is not finite. */
static inline int map_read(const char *path, image *picture) {
    FILE *in = input_open(path);
    size_t i;
    int ok = 0;
    if (!in) return 0;
    if (scene__ends_with(path, ".pfm")) ok = map__read_pfm(in, picture);
    else if (scene__ends_with(path, ".exr")) ok = map__read_exr(path, picture);
    else if (scene__ends_with(path, ".ktx2")) ok = map__read_ktx2(in, picture);
    else if (scene__ends_with(path, ".hdr")) ok = map__read_hdr(in, picture);
    else if (scene__ends_with(path, ".png")) ok = map__read_rgbm(in, picture);
    fclose(in);
    for (i = 0; ok && i < 3 * (size_t)picture->width * (size_t)picture->height; i++) ok = isfinite(picture->values[i]);
    return ok;
}

/* Finds the newest of the maps name.pfm, name.exr, name.ktx2, name.hdr and name.rgbm.png, for a name such as
   "baked/atlas". Among files of the same time it prefers the earlier in this list. path: receives the path, or name.exr
   if no file exists */
static inline void map_find(char *path, size_t size, const char *name) {
    static const char *const endings[] = { ".pfm", ".exr", ".ktx2", ".hdr", ".rgbm.png" };
    char other[PATH_MAX];
    struct stat info, best;
    size_t i;
    int found = 0;
    snprintf(path, size, "%s.exr", name);
    memset(&best, 0, sizeof best);
    for (i = 0; i < sizeof endings / sizeof *endings; i++) {
        snprintf(other, sizeof other, "%s%s", name, endings[i]);
        if (stat(other, &info) != 0) continue;
        if (found && (info.st_mtim.tv_sec < best.st_mtim.tv_sec || (info.st_mtim.tv_sec == best.st_mtim.tv_sec &&
                      info.st_mtim.tv_nsec <= best.st_mtim.tv_nsec))) continue;
        found = 1;
        best = info;
        snprintf(path, size, "%s", other);
    }
}

#endif
