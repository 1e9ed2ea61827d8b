/* Writes pictures of floats, at once or in bands of rows, as .png (8-bit sRGB, with a visible form of each channel),
   .pfm (linear 32-bit floats) or .exr (linear 32-bit or 16-bit floats). A .png needs libpng; an .exr needs OpenEXR and
   the macro SBL_RENDER_OPENEXR. Include after sbl.h, with _DEFAULT_SOURCE defined before the first header.

       picture_writer writer;
       ok = picture_begin(&writer, stream, "room.png", &frame, channel, stops);  // frame: an image without values
       for (...) ok = ok && picture_put(&writer, first_row, rows, values);
       ok = picture_end(&writer, ok); */
#ifndef PICTURE_FILE_H
#define PICTURE_FILE_H

#include <errno.h>
#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>
#include <png.h>
#ifdef SBL_RENDER_OPENEXR
  #include <openexr.h>
#endif

enum { PICTURE_ERROR_STOPS = 5 };  /* error channels are shown brighter by this, because errors are small */

/* Facts about a picture, each with a name and a text. */
enum { PICTURE_FACTS = 12, PICTURE_FACT_SIZE = 1024 };
typedef struct picture_fact { const char *name; char text[PICTURE_FACT_SIZE]; } picture_fact;

/* A picture, top row first. If it is a window of a larger picture, `at` is the position of its first pixel in that
   picture and `full` is the size of that picture; otherwise all are 0. facts: NULL, or PICTURE_FACTS facts; unused ones
   have no name. Only .exr files store `at`, `full` and the facts. */
typedef struct image {
    int width, height, components;
    float *values;
    const char *const *channels;  /* names of the components in an .exr file; NULL: Y, or R, G and B */
    int at[2], full[2];
    const picture_fact *facts;
    int is_half;                  /* 1: an .exr stores 16-bit floats; values above 65504 become infinite */
} image;

/* Maps 0..1 to a byte; NaN becomes 0. */
static unsigned char to_byte(double x) { return (unsigned char)(255 * (x > 0 ? x < 1 ? x : 1 : 0) + 0.5); }

static void hue(double h, unsigned char *out) {
    int k;
    /* h from 0 to 1 runs through red, green, blue and back to red */
    for (k = 0; k < 3; k++) out[k] = to_byte(fabs(fmod(h * 6 + 4 * ((k * 2) % 3) / 2.0, 6) - 3) - 1);
}

static inline int picture_is_error(sbl_channel channel) {
    return channel == SBL_CHANNEL_ERROR || channel == SBL_CHANNEL_RADIANCE_ERROR;
}

/* The lowest and highest value of each component over all pixels that show a surface. */
typedef struct picture_range { double low[3], high[3]; } picture_range;

static const picture_range picture_no_range = { { 1e30, 1e30, 1e30 }, { -1e30, -1e30, -1e30 } };

static int picture__shows_surface(const float *value, int components) {
    int k, surface = 0;
    for (k = 0; k < components; k++) surface |= value[k] != 0.0f;
    return surface;
}

/* Extends a range by the values of `pixels` pixels of n components. */
static void picture_extend(picture_range *range, const float *values, size_t pixels, int n) {
    size_t i;
    int k;
    for (i = 0; i < pixels; i++, values += n)
        for (k = 0; k < n && picture__shows_surface(values, n); k++) {
            if ((double)values[k] < range->low[k]) range->low[k] = (double)values[k];
            if ((double)values[k] > range->high[k]) range->high[k] = (double)values[k];
        }
}

/* Converts pixels of n components to three bytes each, scaled so that the values of the channel become distinguishable.
   range: over the full picture; only the channels position, depth and sensors need it. scale: 2 to the power of the
   exposure */
static void picture__make_visible(unsigned char *out, const float *values, size_t pixels, int n, sbl_channel channel,
                                  const picture_range *range, float scale) {
    const double *low = range->low, *high = range->high;
    size_t i;
    int k;
    for (i = 0; i < pixels; i++) {
        const float *v = values + i * (size_t)n;
        const int surface = picture__shows_surface(v, n);
        unsigned char *to = out + 3 * i;
        for (k = 0; k < 3; k++) {
            double x = (double)v[n == 3 ? k : 0];
            int c = n == 3 ? k : 0;
            switch (channel) {
                case SBL_CHANNEL_FINAL: case SBL_CHANNEL_RADIANCE: case SBL_CHANNEL_STORE: case SBL_CHANNEL_ERROR:
                case SBL_CHANNEL_RADIANCE_ERROR:
                    sbl_encode_srgb8(to + k, v + c, 1, scale);
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
}

/* ---- writing ---- */

typedef enum picture_format { PICTURE_PNG, PICTURE_PFM, PICTURE_EXR } picture_format;

/* A file that is being written. */
typedef struct picture_writer {
    FILE *out;
    picture_format format;
    image frame;             /* the picture without its values */
    sbl_channel channel;
    float scale;             /* for a .png: 2 to the power of the exposure */
    picture_range range;     /* for a .png: must be set before the first band if the channel needs it */
    png_structp png;
    png_infop info;
#ifdef SBL_RENDER_OPENEXR
    exr_context_t exr;
    exr_encode_pipeline_t encoder;
    int encodes;             /* 1: the encoder is initialised */
    exr_result_t (*compress)(exr_encode_pipeline_t *encoder);  /* OpenEXR's, which picture__compress calls */
#endif
} picture_writer;

/* The functions of the formats return 0 on failure, and set errno if they know the reason. They do not check for errors
   of the stream. The bands of a .pfm must come from the last to the first, those of other formats from the first to the
   last. */

static void on_png_error(png_structp png, png_const_charp message) {
    (void)message;
    png_longjmp(png, 1);
}

static void on_png_warning(png_structp png, png_const_charp message) {
    (void)png;
    (void)message;
}

static int picture__begin_png(picture_writer *w) {
    w->png = png_create_write_struct(PNG_LIBPNG_VER_STRING, NULL, on_png_error, on_png_warning);
    w->info = w->png ? png_create_info_struct(w->png) : NULL;
    if (!w->info || setjmp(png_jmpbuf(w->png))) return 0;
    png_init_io(w->png, w->out);
    png_set_user_limits(w->png, 1 << 30, 1 << 30);
    png_set_IHDR(w->png, w->info, (png_uint_32)w->frame.width, (png_uint_32)w->frame.height, 8, PNG_COLOR_TYPE_RGB,
                 PNG_INTERLACE_NONE, PNG_COMPRESSION_TYPE_DEFAULT, PNG_FILTER_TYPE_DEFAULT);
    png_write_info(w->png, w->info);
    return 1;
}

static int picture__put_png(picture_writer *w, int rows, const float *values) {
    const size_t width = (size_t)w->frame.width;
    const int n = w->frame.components;
    unsigned char *volatile bytes = (unsigned char *)malloc(3 * width);
    volatile int y;
    if (!bytes || setjmp(png_jmpbuf(w->png))) {
        free(bytes);
        return 0;
    }
    for (y = 0; y < rows; y++) {
        picture__make_visible(bytes, values + (size_t)y * width * (size_t)n, width, n, w->channel, &w->range, w->scale);
        png_write_row(w->png, bytes);
    }
    free(bytes);
    return 1;
}

static int picture__end_png(picture_writer *w, int ok) {
    volatile int done = 0;
    if (ok && !setjmp(png_jmpbuf(w->png))) {
        png_write_end(w->png, w->info);
        done = 1;
    }
    if (w->png) png_destroy_write_struct(&w->png, &w->info);
    return done;
}

static int picture__put_pfm(picture_writer *w, int rows, const float *values) {
    const int n = w->frame.components;
    int x, y, k, b;
    for (y = rows - 1; y >= 0; y--)  /* a .pfm stores the bottom row first */
        for (x = 0; x < w->frame.width; x++) {
            const float *v = values + ((size_t)y * (size_t)w->frame.width + (size_t)x) * (size_t)n;
            unsigned char bytes[12];
            for (k = 0; k < 3; k++) {
                uint32_t bits;
                memcpy(&bits, &v[n == 3 ? k : 0], 4);
                for (b = 0; b < 4; b++) bytes[4 * k + b] = (unsigned char)(bits >> 8 * b & 255);
            }
            fwrite(bytes, 1, sizeof bytes, w->out);
        }
    return 1;
}

#ifdef SBL_RENDER_OPENEXR
static void on_exr_error(exr_const_context_t context, exr_result_t code, const char *message) {
    (void)context;
    (void)code;
    (void)message;
}

/* Writes bytes at an offset, because OpenEXR returns to earlier places of the file and overwrites them. */
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

/* Returns the name of a component as an .exr channel. */
static const char *picture__channel(const image *frame, int component) {
    static const char *const names[2][3] = { { "Y", NULL, NULL }, { "R", "G", "B" } };
    return frame->channels ? frame->channels[component] : names[frame->components == 3][component];
}

/* Returns the index, from 0, of the component with this channel name, or -1. */
static int picture__component(const image *frame, const char *name) {
    int k = frame->components;
    while (--k >= 0 && strcmp(picture__channel(frame, k), name) != 0) continue;
    return k;
}

static int picture__begin_exr(picture_writer *w) {
    const image *frame = &w->frame;
    exr_context_initializer_t settings = EXR_DEFAULT_CONTEXT_INITIALIZER;
    const exr_attr_v2f_t centre = { { { 0, 0 } } };
    exr_attr_box2i_t data, display;
    int part, k;
    exr_result_t result;
    data.min.x = frame->at[0];
    data.min.y = frame->at[1];
    data.max.x = data.min.x + frame->width - 1;
    data.max.y = data.min.y + frame->height - 1;
    display.min.x = display.min.y = 0;
    display.max.x = (frame->full[0] ? frame->full[0] : frame->width) - 1;
    display.max.y = (frame->full[1] ? frame->full[1] : frame->height) - 1;
    settings.error_handler_fn = on_exr_error;
    settings.write_fn = write_exr_bytes;
    settings.user_data = w->out;
    result = exr_start_write(&w->exr, "picture.exr", EXR_WRITE_FILE_DIRECTLY, &settings);
    if (result == EXR_ERR_SUCCESS) result = exr_add_part(w->exr, "picture", EXR_STORAGE_SCANLINE, &part);
    if (result == EXR_ERR_SUCCESS)
        result = exr_initialize_required_attr(w->exr, part, &display, &data, 1, &centre, 1, EXR_LINEORDER_INCREASING_Y,
                                              EXR_COMPRESSION_ZIP);
    for (k = 0; k < frame->components && result == EXR_ERR_SUCCESS; k++)
        result = exr_add_channel(w->exr, part, picture__channel(frame, k),
                                 frame->is_half ? EXR_PIXEL_HALF : EXR_PIXEL_FLOAT, EXR_PERCEPTUALLY_LINEAR, 1, 1);
    for (k = 0; k < PICTURE_FACTS && frame->facts && result == EXR_ERR_SUCCESS; k++)
        if (frame->facts[k].name)
            result = exr_attr_set_string(w->exr, part, frame->facts[k].name, frame->facts[k].text);
    if (result == EXR_ERR_SUCCESS) result = exr_write_header(w->exr);
    return result == EXR_ERR_SUCCESS;
}

/* Compresses a chunk. A reader takes a chunk of the uncompressed length for uncompressed data, but OpenEXR 3.1 may also
   write compressed data of exactly this length. Such a chunk is replaced by the uncompressed data. */
static exr_result_t picture__compress(exr_encode_pipeline_t *encoder) {
    const picture_writer *w = (const picture_writer *)encoder->encoding_user_data;
    const exr_result_t result = w->compress(encoder);
    if (result == EXR_ERR_SUCCESS && encoder->compressed_bytes == encoder->packed_bytes)
        memcpy(encoder->compressed_buffer, encoder->packed_buffer, (size_t)encoder->packed_bytes);
    return result;
}

/* Writes rows in chunks; the compression decides how many rows are a chunk. The first row of a band must be the first
   row of a chunk. */
static int picture__put_exr(picture_writer *w, int first, int rows, const float *values) {
    const int n = w->frame.components, width = w->frame.width;
    exr_chunk_info_t chunk;
    int32_t step = 1;
    int y, k;
    exr_result_t result = exr_get_scanlines_per_chunk(w->exr, 0, &step);
    for (y = 0; y < rows && result == EXR_ERR_SUCCESS; y += step) {
        const float *from = values + (size_t)y * (size_t)width * (size_t)n;
        const int begun = w->encodes;
        result = exr_write_scanline_chunk_info(w->exr, 0, w->frame.at[1] + first + y, &chunk);
        if (result == EXR_ERR_SUCCESS)
            result = begun ? exr_encoding_update(w->exr, 0, &chunk, &w->encoder)
                           : exr_encoding_initialize(w->exr, 0, &chunk, &w->encoder);
        w->encodes = begun || result == EXR_ERR_SUCCESS;
        for (k = 0; k < n && result == EXR_ERR_SUCCESS; k++) {
            exr_coding_channel_info_t *channel = &w->encoder.channels[k];  /* OpenEXR sorts channels by name */
            const int component = picture__component(&w->frame, channel->channel_name);
            channel->encode_from_ptr = (const uint8_t *)(from + component);
            channel->user_bytes_per_element = 4;
            channel->user_data_type = EXR_PIXEL_FLOAT;
            channel->user_pixel_stride = 4 * n;
            channel->user_line_stride = 4 * n * width;
        }
        if (result == EXR_ERR_SUCCESS && !begun) {
            result = exr_encoding_choose_default_routines(w->exr, 0, &w->encoder);
            w->compress = w->encoder.compress_fn;
            w->encoder.encoding_user_data = w;
            w->encoder.compress_fn = w->compress ? picture__compress : NULL;
        }
        if (result == EXR_ERR_SUCCESS) result = exr_encoding_run(w->exr, 0, &w->encoder);
    }
    return result == EXR_ERR_SUCCESS;
}

static int picture__end_exr(picture_writer *w, int ok) {
    if (w->encodes) exr_encoding_destroy(w->exr, &w->encoder);
    return (!w->exr || exr_finish(&w->exr) == EXR_ERR_SUCCESS) && ok;
}
#endif

static picture_format picture_format_of(const char *name) {
    const char *ending = strrchr(name, '.');
    if (ending && strcmp(ending, ".png") == 0) return PICTURE_PNG;
#ifdef SBL_RENDER_OPENEXR
    if (ending && strcmp(ending, ".exr") == 0) return PICTURE_EXR;
#endif
    return PICTURE_PFM;
}

/* Begins a picture. The ending of the name selects the format. stops: exposure of a .png; only the channels final,
   radiance, store and error use it. Returns 0 on failure; the caller must call picture_end even then. */
static inline int picture_begin(picture_writer *w, FILE *out, const char *name, const image *frame,
                                sbl_channel channel, double stops) {
    memset(w, 0, sizeof *w);
    w->out = out;
    w->format = picture_format_of(name);
    w->frame = *frame;
    w->channel = channel;
    w->scale = (float)pow(2, stops);
    w->range = picture_no_range;
    if (w->format == PICTURE_PNG) return picture__begin_png(w);
#ifdef SBL_RENDER_OPENEXR
    if (w->format == PICTURE_EXR) return picture__begin_exr(w);
#endif
    fprintf(out, "PF\n%d %d\n-1.0\n", frame->width, frame->height);  /* the negative scale means little-endian */
    return 1;
}

/* Writes a band of rows. Returns 0 on failure. first: index of its first row, a multiple of 64. Bands come in order
   from the top, but from the bottom for a .pfm. */
static inline int picture_put(picture_writer *w, int first, int rows, const float *values) {
    if (w->format == PICTURE_PNG) return picture__put_png(w, rows, values);
#ifdef SBL_RENDER_OPENEXR
    if (w->format == PICTURE_EXR) return picture__put_exr(w, first, rows, values);
#endif
    (void)first;
    return picture__put_pfm(w, rows, values);
}

/* Ends the picture. ok: 0 if an earlier call failed. Returns 1 if the file is complete. */
static inline int picture_end(picture_writer *w, int ok) {
    if (w->format == PICTURE_PNG) return picture__end_png(w, ok);
#ifdef SBL_RENDER_OPENEXR
    if (w->format == PICTURE_EXR) return picture__end_exr(w, ok);
#endif
    return ok;
}

/* Writes a picture at once. Returns 0 on failure. */
static inline int picture_write(FILE *out, const char *name, const image *picture, sbl_channel channel, double stops) {
    picture_writer w;
    int ok = picture_begin(&w, out, name, picture, channel, stops);
    if (w.format == PICTURE_PNG)  /* pictures in other formats may have more components than a range */
        picture_extend(&w.range, picture->values, (size_t)picture->width * (size_t)picture->height,
                       picture->components);
    ok = ok && picture_put(&w, 0, picture->height, picture->values);
    return picture_end(&w, ok);
}

/* Reads a channel of the current picture or lightmap. The caller frees picture->values, also on failure. */
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
