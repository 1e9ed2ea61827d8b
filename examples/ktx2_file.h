/* Writes uncompressed float textures as .ktx2 (KTX 2.0, Khronos): pictures or cube maps, with mip levels. Needs neither
   GL nor sbl.h.

       ktx2_picture p = { 128, 128, 6, 6, 3, KTX2_HALF, levels, "my program" };
       ok = ktx2_write(stream, &p);

   Values are linear. Half floats are rounded to nearest; values beyond 65504 become 65504, and NaN becomes 0. */
#ifndef KTX2_FILE_H
#define KTX2_FILE_H

#include <stdint.h>
#include <stdio.h>
#include <string.h>

/* The values of VkFormat for R16G16B16A16_SFLOAT and R32G32B32A32_SFLOAT. Texels always have four channels: colour
   channels that the picture lacks become 0, and a missing alpha becomes 1. */
typedef enum ktx2_format { KTX2_HALF = 97, KTX2_FLOAT = 109 } ktx2_format;

typedef struct ktx2_picture {
    int width, height;         /* size of level 0; each further level has half the size, rounded down, but at least 1 */
    int faces;                 /* 1, or 6 for a cube map, whose faces are +x -x +y -y +z -z */
    int levels;                /* 1 or more */
    int components;            /* floats per texel in values, 1 to 4 */
    ktx2_format format;
    const float *const *values;  /* one array per level: face after face, each starting with its first row */
    const char *writer;        /* name of the program, which the file records; or NULL */
} ktx2_picture;

/* Converts a float to the bits of a half float. */
static inline uint16_t ktx2_half(float value) {
    uint32_t bits, magnitude, sign;
    int shift;
    memcpy(&bits, &value, 4);
    sign = bits >> 16 & 0x8000;
    magnitude = bits & 0x7fffffff;
    if (magnitude > 0x7f800000) return 0;                                  /* NaN */
    if (magnitude >= 0x477ff000) return (uint16_t)(sign | 0x7bff);         /* 65520 and above would round to infinity */
    if (magnitude < 0x33000000) return (uint16_t)sign;                     /* below 2^-25 rounds to zero */
    shift = magnitude < 0x38800000 ? 126 - (int)(magnitude >> 23) : 13;    /* below 2^-14: denormal, fewer bits */
    if (shift > 13) magnitude = (magnitude & 0x7fffff) | 0x800000;
    else magnitude -= 112u << 23;
    magnitude += (1u << (shift - 1)) - 1 + (magnitude >> shift & 1);       /* rounds to nearest, ties to even */
    return (uint16_t)(sign | magnitude >> shift);
}

/* Writes an integer of any width, lowest byte first. */
static inline void ktx2__put(FILE *out, uint64_t value, int bytes) {
    for (; bytes > 0; bytes--, value >>= 8) fputc((int)(value & 255), out);
}

static inline int ktx2__side(int side, int level) { return side >> level > 1 ? side >> level : 1; }

static inline uint64_t ktx2__bytes(const ktx2_picture *p, int level) {
    return (uint64_t)ktx2__side(p->width, level) * (uint64_t)ktx2__side(p->height, level) * (uint64_t)p->faces *
           (p->format == KTX2_HALF ? 8u : 16u);
}

enum { KTX2__INDEX = 80, KTX2__LEVEL = 24, KTX2__DESCRIPTOR = 4 + 24 + 4 * 16 };

/* Writes the data format descriptor: four channels of signed, linear floats with the primaries of BT.709. */
static inline void ktx2__put_descriptor(FILE *out, int bits) {
    int i;
    ktx2__put(out, KTX2__DESCRIPTOR, 4);
    ktx2__put(out, 0, 4);                       /* basic descriptor, by Khronos */
    ktx2__put(out, 2, 2);                       /* version 1.3 */
    ktx2__put(out, KTX2__DESCRIPTOR - 4, 2);
    ktx2__put(out, 1, 1);                       /* colour model RGBSDA */
    ktx2__put(out, 1, 1);                       /* primaries BT.709 */
    ktx2__put(out, 1, 1);                       /* linear transfer function */
    ktx2__put(out, 0, 1);                       /* straight alpha */
    ktx2__put(out, 0, 4);                       /* blocks of one texel */
    ktx2__put(out, (uint64_t)(bits / 2), 8);    /* bytes per texel: 4 * bits / 8 */
    for (i = 0; i < 4; i++) {
        ktx2__put(out, (uint64_t)(i * bits), 2);
        ktx2__put(out, (uint64_t)(bits - 1), 1);
        ktx2__put(out, (i < 3 ? (uint64_t)i : 15u) | 0xc0, 1);  /* channel; flags float and signed */
        ktx2__put(out, 0, 4);
        ktx2__put(out, 0xbf800000, 4);          /* lowest value, -1.0 */
        ktx2__put(out, 0x3f800000, 4);          /* highest value, 1.0 */
    }
}

/* Writes one key with its text, padded to a multiple of 4 bytes. Returns the number of bytes. out: NULL to count
   only */
static inline uint64_t ktx2__key(FILE *out, const char *key, const char *text) {
    const size_t length = strlen(key) + strlen(text) + 2, all = (4 + length + 3) / 4 * 4;
    if (!out) return all;
    ktx2__put(out, length, 4);
    fwrite(key, 1, strlen(key) + 1, out);
    fwrite(text, 1, strlen(text) + 1, out);
    ktx2__put(out, 0, (int)(all - 4 - length));
    return all;
}

static inline uint64_t ktx2__keys(FILE *out, const ktx2_picture *p) {
    const uint64_t bytes = ktx2__key(out, "KTXorientation", "rd");
    return bytes + (p->writer ? ktx2__key(out, "KTXwriter", p->writer) : 0);
}

static inline void ktx2__put_texels(FILE *out, const ktx2_picture *p, int level) {
    const uint64_t texels = ktx2__bytes(p, level) / (p->format == KTX2_HALF ? 8u : 16u);
    const float *from = p->values[level];
    uint64_t i;
    int k;
    for (i = 0; i < texels; i++, from += p->components)
        for (k = 0; k < 4; k++) {
            const float value = k < p->components ? from[k] : k == 3 ? 1.0f : 0.0f;
            uint32_t bits;
            memcpy(&bits, &value, 4);
            if (p->format == KTX2_HALF) ktx2__put(out, ktx2_half(value), 2);
            else ktx2__put(out, bits, 4);
        }
}

/* Writes a file. Returns 1 on success. */
static inline int ktx2_write(FILE *out, const ktx2_picture *p) {
    static const unsigned char mark[12] = { 0xab, 'K', 'T', 'X', ' ', '2', '0', 0xbb, '\r', '\n', 0x1a, '\n' };
    const int bits = p->format == KTX2_HALF ? 16 : 32;
    const uint64_t descriptor = KTX2__INDEX + (uint64_t)p->levels * KTX2__LEVEL, keys = descriptor + KTX2__DESCRIPTOR;
    const uint64_t end = keys + ktx2__keys(NULL, p), first = (end + 15) / 16 * 16;
    uint64_t at = first;
    int i, k;
    fwrite(mark, 1, sizeof mark, out);
    ktx2__put(out, (uint64_t)p->format, 4);
    ktx2__put(out, (uint64_t)(bits / 8), 4);
    ktx2__put(out, (uint64_t)p->width, 4);
    ktx2__put(out, (uint64_t)p->height, 4);
    ktx2__put(out, 0, 8);                       /* neither depth nor layers */
    ktx2__put(out, (uint64_t)p->faces, 4);
    ktx2__put(out, (uint64_t)p->levels, 4);
    ktx2__put(out, 0, 4);                       /* no supercompression */
    ktx2__put(out, descriptor, 4);
    ktx2__put(out, KTX2__DESCRIPTOR, 4);
    ktx2__put(out, keys, 4);
    ktx2__put(out, end - keys, 4);
    ktx2__put(out, 0, 16);
    for (i = 0; i < p->levels; i++) {           /* in the file, the smallest level comes first */
        for (at = first, k = p->levels - 1; k > i; k--) at += ktx2__bytes(p, k);
        ktx2__put(out, at, 8);
        ktx2__put(out, ktx2__bytes(p, i), 8);
        ktx2__put(out, ktx2__bytes(p, i), 8);
    }
    ktx2__put_descriptor(out, bits);
    ktx2__keys(out, p);
    ktx2__put(out, 0, (int)(first - end));
    for (i = p->levels - 1; i >= 0; i--) ktx2__put_texels(out, p, i);
    return !ferror(out);
}

#endif
