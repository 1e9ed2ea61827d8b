/* Data for the GPU, checked as the GPU reads it: as 32-bit words and floats, in either byte order. tests/test_header.sh
   runs it on a big-endian machine that qemu emulates. Needs no GL. */
#define SBL_IMPLEMENTATION
#define SBL_STATIC
#include "sbl.h"

static int wrong;
#define CHECK(condition) ((condition) ? (void)0 : (void)(wrong++, printf("line %d: %s\n", __LINE__, #condition)))

static uint32_t word_of(const void *at, int index) {
    uint32_t word;
    memcpy(&word, (const char *)at + 4 * index, sizeof word);
    return word;
}

int main(void) {
    static const float red_green[2] = { 1, 0.25f }, numbers[4] = { 1, -2, 0.5f, 3e38f };
    static const unsigned char bytes[4] = { 0, 51, 102, 255 };
    static const uint16_t shorts[2] = { 65535, 13107 };
    const uint32_t one = 1, packed = sbl__pack_color(red_green);
    sbl__attributes attributes;
    int i;
    printf("%s-endian\n", *(const unsigned char *)&one ? "little" : "big");
    CHECK((packed & 65535u) == 65535u && packed >> 16 == 16384u);
    memset(&attributes, 0, sizeof attributes);
    attributes.color_rg = packed;
    attributes.color_ba = 7;
    /* the array of unsigned ints and the texel that the shader reads */
    CHECK(word_of(&attributes, (int)(offsetof(sbl__attributes, color_rg) / 4)) == packed);
    CHECK(offsetof(sbl__attributes, color_ba) == offsetof(sbl__attributes, color_rg) + 4);
    for (i = 0; i < 4; i++) CHECK(sbl__from_half(sbl__to_half(numbers[i])) == (i < 3 ? numbers[i] : 65504.0f));
    CHECK(fabsf(sbl__component(bytes + 1, SBL_UINT8_NORM) - 0.2f) < 1e-7f &&
          sbl__component((const unsigned char *)shorts, SBL_UINT16_NORM) > 0.99999f);
    CHECK(sbl__component((const unsigned char *)(shorts + 1), SBL_UINT16) == 13107);
    CHECK(sbl__all_finite(numbers, 4));
    printf("%d wrong\n", wrong);
    return wrong != 0;
}
