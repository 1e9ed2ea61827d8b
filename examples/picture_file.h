/* Writes pictures of floats as .png (8-bit sRGB; every channel is made visible), .pfm or .exr (32-bit float, linear).
   .exr needs OpenEXR: define SBL_RENDER_OPENEXR. Include after sbl.h, with _DEFAULT_SOURCE defined before the first
   header. This file includes stb_image_write.h. */
#ifndef PICTURE_FILE_H
#define PICTURE_FILE_H

#include <errno.h>
#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>
#define STB_IMAGE_WRITE_IMPLEMENTATION
#include <stb/stb_image_write.h>
#ifdef SBL_RENDER_OPENEXR
  #include <openexr.h>
#endif

/* A picture, top row first. If it is a window of a whole picture, `at` is the position of its first pixel in that
   picture, and `whole` is the size of that picture; otherwise all are 0. Only .exr files store these. */
typedef struct image { int width, height, components; float *values; int at[2], whole[2]; } image;

/* maps 0..1 to a byte; NaN becomes 0 */
static unsigned char to_byte(double x) { return (unsigned char)(255 * (x > 0 ? x < 1 ? x : 1 : 0) + 0.5); }

static void hue(double h, unsigned char *out) {
    int k;
    /* h from 0 to 1: red, green, blue, red */
    for (k = 0; k < 3; k++) out[k] = to_byte(fabs(fmod(h * 6 + 4 * ((k * 2) % 3) / 2.0, 6) - 3) - 1);
}

/* Returns three bytes per pixel, scaled for each channel such that its values can be distinguished; NULL if memory runs
   out. */
static unsigned char *make_visible(const image *in, sbl_channel channel, double stops) {
    const size_t pixels = (size_t)in->width * (size_t)in->height;
    const int n = in->components;
    const float exposure = (float)pow(2, stops);
    unsigned char *out = (unsigned char *)malloc(pixels * 3);
    double low[3] = { 1e30, 1e30, 1e30 }, high[3] = { -1e30, -1e30, -1e30 };
    size_t i;
    int k;
    if (!out) return NULL;
    for (i = 0; i < pixels; i++) {  /* bounds of the values where there is a surface */
        const float *v = in->values + i * (size_t)n;
        int surface = 0;
        for (k = 0; k < n; k++) surface |= v[k] != 0.0f;
        for (k = 0; k < n && surface; k++) {
            if ((double)v[k] < low[k]) low[k] = (double)v[k];
            if ((double)v[k] > high[k]) high[k] = (double)v[k];
        }
    }
    for (i = 0; i < pixels; i++) {
        const float *v = in->values + i * (size_t)n;
        unsigned char *to = out + 3 * i;
        int surface = 0;
        for (k = 0; k < n; k++) surface |= v[k] != 0.0f;
        for (k = 0; k < 3; k++) {
            double x = (double)v[n == 3 ? k : 0];
            int c = n == 3 ? k : 0;
            switch (channel) {
                case SBL_CHANNEL_FINAL: case SBL_CHANNEL_RADIANCE: case SBL_CHANNEL_STORE: case SBL_CHANNEL_ERROR:
                    sbl_encode_srgb8(to + k, v + c, 1, exposure);
                    break;
                case SBL_CHANNEL_ALBEDO: sbl_encode_srgb8(to + k, v + c, 1, 1); break;
                case SBL_CHANNEL_NORMAL: to[k] = surface ? to_byte(0.5 + 0.5 * x) : 0; break;
                case SBL_CHANNEL_POSITION: to[k] = surface ? to_byte(high[c] > low[c] ? (x - low[c]) /
                                                                     (high[c] - low[c]) : 0.5) : 0; break;
                case SBL_CHANNEL_DEPTH:
                    to[k] = surface ? to_byte(high[0] > low[0] ? 1 - 0.9 * (x - low[0]) / (high[0] - low[0]) : 1) : 0;
                    break;
                default: to[k] = 0; break;
            }
        }
        /* steps of the golden ratio give neighbouring ids different hues */
        if (channel == SBL_CHANNEL_ID && surface) hue(fmod((double)v[0] * 0.6180339887498949, 1), to);
        if (channel == SBL_CHANNEL_SENSORS && surface)
            hue(high[0] > 1 ? (1 - ((double)v[0] - 1) / (high[0] - 1)) * 2 / 3 : 2.0 / 3, to);
    }
    return out;
}

static void write_bytes(void *user, void *data, int size) { fwrite(data, 1, (size_t)size, (FILE *)user); }

/* The writers return 0 on failures other than those of the stream, and set errno if they know the reason. */
static int write_png(FILE *out, const image *picture, sbl_channel channel, double stops) {
    unsigned char *bytes = make_visible(picture, channel, stops);
    const int width = picture->width;
    int ok = bytes && stbi_write_png_to_func(write_bytes, out, width, picture->height, 3, bytes, 3 * width);
    free(bytes);
    return ok;
}

static int write_pfm(FILE *out, const image *picture) {
    int x, y, k;
    fprintf(out, "PF\n%d %d\n-1.0\n", picture->width, picture->height);  /* negative scale: little-endian */
    for (y = picture->height - 1; y >= 0; y--)  /* bottom row first */
        for (x = 0; x < picture->width; x++) {
            const float *v = picture->values + ((size_t)y * (size_t)picture->width + (size_t)x) *
                (size_t)picture->components;
            unsigned char bytes[12];
            for (k = 0; k < 3; k++) {
                uint32_t bits;
                int b;
                memcpy(&bits, &v[picture->components == 3 ? k : 0], 4);
                for (b = 0; b < 4; b++) bytes[4 * k + b] = (unsigned char)(bits >> 8 * b & 255);
            }
            fwrite(bytes, 1, sizeof bytes, out);
        }
    return 1;
}

#ifdef SBL_RENDER_OPENEXR
static void on_exr_error(exr_const_context_t context, exr_result_t code, const char *message) {
    (void)context;
    (void)code;
    (void)message;
}

/* Writes at an offset: OpenEXR also overwrites parts that it wrote before. */
static int64_t write_exr_bytes(exr_const_context_t context, void *user, const void *data, uint64_t size,
                               uint64_t offset, exr_stream_error_func_ptr_t error) {
    uint64_t done;
    ssize_t n;
    (void)context; (void)error;
    for (done = 0; done < size; done += (uint64_t)n) {
        n = pwrite(fileno((FILE *)user), (const char *)data + done, (size_t)(size - done), (off_t)(offset + done));
        if (n < 0 && errno == EINTR) n = 0;
        if (n < 0) return -1;
    }
    return (int64_t)size;
}

static int write_exr(FILE *out, const image *picture) {
    static const char *const names[2][3] = { { "Y", NULL, NULL }, { "R", "G", "B" } };
    exr_context_initializer_t settings = EXR_DEFAULT_CONTEXT_INITIALIZER;
    exr_context_t context = NULL;
    exr_encode_pipeline_t encoder;
    exr_chunk_info_t chunk;
    const exr_attr_v2f_t centre = { { { 0, 0 } } };
    exr_attr_box2i_t data, display;
    int part, y, k, begun = 0;
    int32_t rows = 1;
    exr_result_t result;
    data.min.x = picture->at[0];
    data.min.y = picture->at[1];
    data.max.x = data.min.x + picture->width - 1;
    data.max.y = data.min.y + picture->height - 1;
    display.min.x = display.min.y = 0;
    display.max.x = (picture->whole[0] ? picture->whole[0] : picture->width) - 1;
    display.max.y = (picture->whole[1] ? picture->whole[1] : picture->height) - 1;
    settings.error_handler_fn = on_exr_error;
    settings.write_fn = write_exr_bytes;
    settings.user_data = out;
    result = exr_start_write(&context, "picture.exr", EXR_WRITE_FILE_DIRECTLY, &settings);
    if (result == EXR_ERR_SUCCESS) result = exr_add_part(context, "picture", EXR_STORAGE_SCANLINE, &part);
    if (result == EXR_ERR_SUCCESS)
        result = exr_initialize_required_attr(context, part, &display, &data, 1, &centre, 1,
                                              EXR_LINEORDER_INCREASING_Y, EXR_COMPRESSION_ZIP);
    for (k = 0; k < picture->components && result == EXR_ERR_SUCCESS; k++)
        result = exr_add_channel(context, part, names[picture->components == 3][k], EXR_PIXEL_FLOAT,
                                 EXR_PERCEPTUALLY_LINEAR, 1, 1);
    if (result == EXR_ERR_SUCCESS) result = exr_write_header(context);
    if (result == EXR_ERR_SUCCESS) result = exr_get_scanlines_per_chunk(context, part, &rows);
    for (y = 0; y < picture->height && result == EXR_ERR_SUCCESS; y += rows) {
        result = exr_write_scanline_chunk_info(context, part, data.min.y + y, &chunk);
        if (result == EXR_ERR_SUCCESS)
            result =
                begun ? exr_encoding_update(context, part, &chunk, &encoder)
                    : exr_encoding_initialize(context, part, &chunk, &encoder);
        for (k = 0; k < picture->components && result == EXR_ERR_SUCCESS; k++) {
            exr_coding_channel_info_t *channel = &encoder.channels[k];  /* channels are sorted by name */
            int component = channel->channel_name[0] == 'G' ? 1 : channel->channel_name[0] == 'B' ? 2 : 0;
            channel->encode_from_ptr =
                (const uint8_t *)(picture->values + (size_t)y * (size_t)picture->width * (size_t)picture->components +
                                  component);
            channel->user_bytes_per_element = 4;
            channel->user_data_type = EXR_PIXEL_FLOAT;
            channel->user_pixel_stride = 4 * picture->components;
            channel->user_line_stride = 4 * picture->components * picture->width;
        }
        if (result == EXR_ERR_SUCCESS && !begun) result = exr_encoding_choose_default_routines(context, part, &encoder);
        begun = 1;
        if (result == EXR_ERR_SUCCESS) result = exr_encoding_run(context, part, &encoder);
    }
    if (begun) exr_encoding_destroy(context, &encoder);
    if (context && exr_finish(&context) != EXR_ERR_SUCCESS && result == EXR_ERR_SUCCESS) result = EXR_ERR_WRITE_IO;
    return result == EXR_ERR_SUCCESS;
}
#endif

/* Writes a picture in the format that the extension of the name selects. stops: exposure of channels final and radiance
   in a .png. */
static inline int picture_write(FILE *out, const char *name, const image *picture, sbl_channel channel, double stops) {
    const char *ending = strrchr(name, '.');
    if (ending && strcmp(ending, ".png") == 0) return write_png(out, picture, channel, stops);
#ifdef SBL_RENDER_OPENEXR
    if (ending && strcmp(ending, ".exr") == 0) return write_exr(out, picture);
#endif
    return write_pfm(out, picture);
}

/* Reads a channel of the current picture or lightmap. The caller frees picture->values. */
static inline sbl_result picture_read(sbl_context *context, int width, int height, sbl_channel channel,
                                      image *picture) {
    size_t count;
    picture->width = width;
    picture->height = height;
    picture->components = sbl_channel_components(channel);
    count = (size_t)width * (size_t)height * (size_t)picture->components;
    picture->values = (float *)malloc(count * sizeof(float));
    return picture->values ? sbl_read_channel(context, channel, picture->values, count) : SBL_ERROR_OUT_OF_MEMORY;
}

#endif
