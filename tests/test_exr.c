/* Tests .exr files from examples/picture_file.h: OpenEXR reads the values that were written. */
#define _DEFAULT_SOURCE
#define SBL_IMPLEMENTATION
#include "../sbl.h"
#include "../examples/picture_file.h"
#include "support/test.h"

#ifdef SBL_RENDER_OPENEXR

enum { ACROSS = 16, FLOATS = ACROSS * ACROSS * 3 };

/* Reads a picture of one chunk. Returns 0 on failure. */
static int read_chunk(const char *path, float *values) {
    exr_context_initializer_t settings = EXR_DEFAULT_CONTEXT_INITIALIZER;
    exr_decode_pipeline_t decoder = EXR_DECODE_PIPELINE_INITIALIZER;
    exr_chunk_info_t chunk;
    exr_context_t exr = NULL;
    int k, ok = exr_start_read(&exr, path, &settings) == EXR_ERR_SUCCESS &&
                exr_read_scanline_chunk_info(exr, 0, 0, &chunk) == EXR_ERR_SUCCESS &&
                exr_decoding_initialize(exr, 0, &chunk, &decoder) == EXR_ERR_SUCCESS;
    for (k = 0; ok && k < decoder.channel_count; k++) {
        exr_coding_channel_info_t *c = &decoder.channels[k];
        c->decode_to_ptr = (uint8_t *)(values + (c->channel_name[0] == 'R' ? 0 : c->channel_name[0] == 'G' ? 1 : 2));
        c->user_bytes_per_element = 4;
        c->user_data_type = EXR_PIXEL_FLOAT;
        c->user_pixel_stride = 12;
        c->user_line_stride = 12 * ACROSS;
    }
    ok = ok && exr_decoding_choose_default_routines(exr, 0, &decoder) == EXR_ERR_SUCCESS &&
         exr_decoding_run(exr, 0, &decoder) == EXR_ERR_SUCCESS;
    exr_decoding_destroy(exr, &decoder);
    if (exr) exr_finish(&exr);
    return ok;
}

/* OpenEXR reads the values that were written, even where compression does not shorten the data. Noise that is partly
   constant has about the same length when compressed, and in some of these pictures exactly the same length. */
TEST(noise) {
    static float written[FLOATS], got[FLOATS];
    char path[] = "/tmp/sbl_exr_XXXXXX";
    const int handle = mkstemp(path);
    image picture = { ACROSS, ACROSS, 3, written, NULL, { 0, 0 }, { 0, 0 }, NULL, 0 };
    int constant, round, i;
    REQUIRE(handle >= 0, "no temporary file");
    close(handle);
    for (round = 0; round < 8; round++)
        for (constant = 0; constant < 60; constant++) {
            FILE *out = fopen(path, "wb");
            int ok;
            for (i = 0; i < FLOATS; i++) {
                const uint32_t bits = test_hash((uint32_t)(i + FLOATS * (constant + 60 * round))) & 0x7f7fffffu;
                if (i < constant) written[i] = 1;
                else memcpy(&written[i], &bits, 4);
            }
            ok = out && picture_write(out, "x.exr", &picture, SBL_CHANNEL_FINAL, 0);
            if (out) fclose(out);
            CHECK(ok && read_chunk(path, got) && memcmp(written, got, sizeof got) == 0,
                  "round %d, %d constants: the file has other values", round, constant);
        }
    unlink(path);
}

#else
TEST(noise) { SKIP("built without OpenEXR"); }
#endif

int main(void) {
    RUN(noise);
    return test_report();
}
