/* Tests the formats of lightmaps (sbl_bake --formats) and scene_lit.glb: their content, values beyond their range, and
   the files left after a failure. test_engines.sh loads them into three.js. */
#define _GNU_SOURCE
#include "../sbl.h"
#include "../examples/picture_file.h"
#include "../examples/gltf_file.h"
#include "../examples/ktx2_file.h"
#include "../examples/map_file.h"
#include "../examples/lit_file.h"
#include "support/test.h"
#include "support/tool.h"
#include "support/mapped_room.h"

static float apart[QUADS][4] = { { 0.1f, 0.1f, 0.6f, 0.6f }, { 0.7f, 0.7f, 0.9f, 0.9f } };

#define DIRECT "room.gltf", "--mode", "direct", "--preset", "draft", "--lightmap", "64"
#define FROM_ABOVE "--eye", "0.25,1.5,0", "--look-at", "0.25,-0.5,0", "--up", "0,0,-1", "--fov", "80", "--size", \
                   "40x40", "--channel", "radiance"
#ifdef SBL_RENDER_OPENEXR
  #define EXACT "exr32"
  #define IF_EXR(list) "exr," list
#else
  #define EXACT "pfm"
  #define IF_EXR(list) list
#endif

/* ---- the content of formats ---- */

/* Draws the room by host_lightmap with a map in a folder of its own. Returns the picture. */
static picture draw_with(const char *baked) {
    picture none = { 0, 0, NULL };
    char name[64];
    int status;
    snprintf(name, sizeof name, "%s.pfm", baked);
    tool_use("host_lightmap");
    status = TOOL("room.gltf", baked, FROM_ABOVE, "-o", name);
    tool_use("sbl_bake");
    if (status == 0) return read_pfm(name);
    CHECK(0, "%s: %s", baked, ran.err);
    return none;
}

/* Returns the largest difference between two pictures, relative to the first, where that is not dark. */
static double worst_share(const picture *a, const picture *b) {
    double worst = a->values && b->values ? 0 : 1e30;
    int i;
    for (i = 0; worst < 1 && i < 3 * a->width * a->height; i++)
        if (a->values[i] > 0.01f)
            worst = test_max(worst, fabs((double)b->values[i] / (double)a->values[i] - 1));
    return worst;
}

/* Reads a file in the folder of the test. The caller frees the bytes. */
static unsigned char *bytes_of(const char *name, size_t *size) {
    FILE *in = fopen(in_folder(name), "rb");
    unsigned char *bytes = NULL;
    *size = 0;
    if (!in) return NULL;
    fseek(in, 0, SEEK_END);
    *size = (size_t)ftell(in);
    bytes = (unsigned char *)calloc(1, *size + 1);
    fseek(in, 0, SEEK_SET);
    if (fread(bytes, 1, *size, in) != *size) *size = 0;
    fclose(in);
    return bytes;
}

/* Returns the type of the first channel of an OpenEXR file: 1: 16-bit floats; 2: 32-bit floats; -1: unknown. */
static int type_of_exr(const char *file) {
    static const char name[] = "channels\0chlist";  /* a size of 4 bytes and the text "B" follow */
    size_t size, at = 0;
    unsigned char *bytes = bytes_of(file, &size);
    int type;
    if (!bytes) return -1;
    while (at + sizeof name + 7 < size && memcmp(bytes + at, name, sizeof name) != 0) at++;
    type = at + sizeof name + 7 < size ? bytes[at + sizeof name + 6] : -1;
    free(bytes);
    return type;
}

/* host_lightmap draws the same light from each format, within the precision of the format. */
TEST(all_formats_hold_the_light) {
    static const struct { const char *format, *file; double most; } formats[] = {
#ifdef SBL_RENDER_OPENEXR
        { "exr", "atlas.exr", 0.0011 }, { "exr32", "atlas.exr", 0.0011 },
#endif
        { "ktx2", "atlas.ktx2", 0.0011 }, { "hdr", "atlas.hdr", 0.009 }, { "rgbm", "atlas.rgbm.png", 0.02 }
    };
    picture truth, seen;
    char file[64];
    size_t i;
    write_scene("room.gltf", apart, 1);
    REQUIRE(TOOL(DIRECT, "--formats", "pfm", "--lit", "0", "-o", "pfm") == 0 && ran.err_lines == 0, "%s", ran.err);
    CHECK(exists("pfm/lightmap.pfm") && !exists("pfm/lightmap.exr") && !exists("pfm/scene_lit.glb"), "other files");
    truth = draw_with("pfm");
    for (i = 0; i < sizeof formats / sizeof *formats; i++) {
        CHECK(TOOL(DIRECT, "--formats", formats[i].format, "--lit", "0", "-o", formats[i].format) == 0, "%s", ran.err);
        CHECK(strcmp(formats[i].format, "rgbm") == 0 ? said("range of rgbm: 0.5; R = (0.5 * alpha * rgb)^2")
              : ran.err_lines == 0, "%s: %s", formats[i].format, ran.err);
        snprintf(file, sizeof file, "%s/%s", formats[i].format, formats[i].file);
        CHECK(exists(file), "%s is missing", file);
        if (strncmp(formats[i].format, "exr", 3) == 0)
            CHECK(type_of_exr(file) == (formats[i].format[3] ? 2 : 1), "%s: type %d", file, type_of_exr(file));
        snprintf(file, sizeof file, "%s/lightmap.pfm", formats[i].format);
        CHECK(!exists(file), "%s was written", file);
        seen = draw_with(formats[i].format);
        CHECK(worst_share(&truth, &seen) < formats[i].most, "%s: off by %g", formats[i].format,
              worst_share(&truth, &seen));
        free(seen.values);
    }
    free(truth.values);
}

/* Numbers below 2^-14 have fewer digits in a .ktx2, but the right size. */
TEST(dim_maps_are_dim) {
    static const char *const formats[2] = { "pfm", "ktx2" };
    picture seen[2];
    double worst = 0;
    int i, lit = 0;
    strength = 5e-4;
    write_scene("room.gltf", apart, 1);
    strength = 5;
    for (i = 0; i < 2; i++) {
        char baked[16];
        snprintf(baked, sizeof baked, "dim_%s", formats[i]);
        CHECK(TOOL(DIRECT, "--formats", formats[i], "--lit", "0", "-o", baked) == 0, "%s", ran.err);
        seen[i] = draw_with(baked);
    }
    for (i = 0; seen[0].values && seen[1].values && i < 3 * seen[0].width * seen[0].height; i++) {
        if (!(seen[0].values[i] > 5e-6f && seen[0].values[i] < 6e-5f)) continue;
        worst = test_max(worst, fabs((double)seen[1].values[i] / (double)seen[0].values[i] - 1));
        lit++;
    }
    CHECK(lit > 300 && worst < 0.02, "%d dim pixels are off by up to %g", lit, worst);
    for (i = 0; i < 2; i++) free(seen[i].values);
}

/* If a folder holds maps of several bakes, host_lightmap draws the newest. */
TEST(the_newest_map_is_drawn) {
    picture before, after;
    write_scene("room.gltf", apart, 1);
    CHECK(TOOL(DIRECT, "--formats", "pfm", "--lit", "0", "-o", "twice") == 0, "%s", ran.err);
    before = draw_with("twice");
    CHECK(TOOL(DIRECT, "--sky", "1,1,1", "--formats", "hdr", "--lit", "0", "-o", "twice") == 0, "%s", ran.err);
    after = draw_with("twice");
    CHECK(worst_share(&before, &after) > 0.5, "the old map is drawn");
    free(before.values);
    free(after.values);
}

/* Harmonics are written in the formats that can store negative values. */
TEST(harmonics_need_negative_values) {
    write_scene("room.gltf", apart, 1);
    CHECK(TOOL(DIRECT, "--directional", "--formats", "hdr,rgbm", "-o", "no") == 2 && said("hold no negative numbers") &&
          !exists("no"), "%s", ran.err);
    CHECK(TOOL(DIRECT, "--directional", "--formats", "hdr,ktx2,pfm", "--lit", "0", "--quiet", "-o", "signs") == 0,
          "%s", ran.err);
    CHECK(exists("signs/sh_3.ktx2") && exists("signs/sh_0.pfm") && !exists("signs/sh_0.hdr") &&
          exists("signs/atlas.hdr"), "other files");
}

TEST(wrong_formats_are_refused) {
    static const struct { const char *list, *words; } wrong[] = {
        { "", "'' is not one of exr, exr32" }, { "exr,", "'' is not one of" }, { "bc6h", "'bc6h' is not one of" },
        { "exrs", "'exrs' is not" }, { "hdr,exr,exr32", "the same file" }, { "EXR", "'EXR'" }
    };
    size_t i;
    write_scene("room.gltf", apart, 1);
    for (i = 0; i < sizeof wrong / sizeof *wrong; i++)
        CHECK(TOOL(DIRECT, "-o", "no", "--formats", wrong[i].list) == 2 && said(wrong[i].words) && ran.err_lines == 1 &&
              !exists("no"), "%s: status %d: %s", wrong[i].list, ran.status, ran.err);
    CHECK(TOOL("room.gltf", "--vertices", "-o", "no.ply", "--formats", "hdr") == 2 &&
          said("--formats needs --lightmap"), "%s", ran.err);
    CHECK(TOOL("room.gltf", "--vertices", "-o", "no.ply", "--lit", "64") == 2 && said("--lit needs"), "%s", ran.err);
    CHECK(TOOL(DIRECT, "--lit", "0", "--exposure", "1", "-o", "idle") == 0 && said("--exposure (scene_lit.glb is not"),
          "%s", ran.err);
}

/* The brightest colour of an rgbm texel is as precise as a byte allows. */
TEST(rgbm_keeps_the_brightest) {
    int i;
    for (i = 0; i < 200; i++) {
        const double root = 0.2 + i / 250.0;
        const float v[3] = { (float)(root * root), 0, (float)(root * root / 9) };
        unsigned char out[4];
        map__to_rgbm(out, v, 2);
        CHECK(fabs(2 * out[0] / 255.0 * out[3] / 255.0 / root - 1) < 0.006, "%g became %d * %d", root, out[0], out[3]);
    }
}

/* ---- values beyond the range ---- */

enum { WIDTH = 4, STRANGE = 12 };
static const float strange[STRANGE] = { NAN, INFINITY, -INFINITY, 1e30f, -3, 65519, 0, 1, 0.5f, 0, 0, 0 };

/* Writes a map of four texels in a format to a file, and reads the bytes of the file. Returns its size. */
static size_t written(map_format format, int exact, unsigned char *bytes, size_t room) {
    float values[STRANGE];
    image map = { WIDTH, 1, 3, values, NULL, { 0, 0 }, { 0, 0 }, NULL, 0 };
    const map_source s = { &map, format, exact, map_rgbm_range(1e30f) };
    FILE *file = fopen(in_folder("strange"), "w+b");
    size_t size = 0;
    memcpy(values, strange, sizeof values);
    if (file && map_write(file, &s) && fflush(file) == 0 && fseek(file, 0, SEEK_SET) == 0)
        size = fread(bytes, 1, room, file);
    if (file) fclose(file);
    return size;
}

/* No file holds infinities or NaN; signs and values within the range are kept. */
TEST(strange_values_become_finite) {
    static const unsigned halves[STRANGE] = { 0, 0x7bff, 0xfbff, 0x7bff, 0xc200, 0x7bff, 0, 0x3c00, 0x3800, 0, 0, 0 };
    unsigned char bytes[4096], *pixels;
    map_survey low, survey = { 0, 0, 0 };
    const size_t pfm = written(MAP_PFM, 0, bytes, sizeof bytes);
    image map = { WIDTH, 1, 3, NULL, NULL, { 0, 0 }, { 0, 0 }, NULL, 0 };
    float v[STRANGE];
    int i, width, height, channels, wrong = 0;
    size_t size;
    REQUIRE(pfm > sizeof v, "no .pfm");
    memcpy(v, bytes + pfm - sizeof v, sizeof v);
    CHECK(v[0] <= 0 && v[0] >= 0 && v[1] > 3e38f && v[2] < -3e38f && isfinite(v[1]) && isfinite(v[2]) && v[3] > 9e29f &&
          v[4] < -2.9f && v[8] > 0.4f, "%g %g %g %g", (double)v[0], (double)v[1], (double)v[2], (double)v[3]);
    size = written(MAP_KTX2, 0, bytes, sizeof bytes);
    REQUIRE(size == 240 + 8 * WIDTH, "%d bytes of .ktx2", (int)size);
    for (i = 0; i < STRANGE; i++) {
        const unsigned char *at = bytes + 240 + 8 * (i / 3) + 2 * (i % 3);
        wrong += (at[0] | (unsigned)at[1] << 8) != halves[i];
    }
    CHECK(wrong == 0, "%d halves are wrong", wrong);
    size = written(MAP_HDR, 0, bytes, sizeof bytes);
    REQUIRE(size > 4 * WIDTH, "no .hdr");
    pixels = bytes + size - 4 * WIDTH;
    CHECK(pixels[0] == 0 && pixels[1] > 100 && pixels[2] == 0 && pixels[3] > 250 && pixels[5] == 0 &&
          pixels[8] == 0 && pixels[9] == 128 && pixels[10] == 64 && pixels[11] == 129 && pixels[15] == 0,
          "RGBE %d %d %d %d", pixels[8], pixels[9], pixels[10], pixels[11]);
    size = written(MAP_RGBM, 0, bytes, sizeof bytes);
    pixels = stbi_load_from_memory(bytes, (int)size, &width, &height, &channels, 4);
    REQUIRE(pixels && width == WIDTH && height == 1 && channels == 4, "no .png");
    CHECK(pixels[0] == 0 && pixels[1] == 255 && pixels[2] == 0 && pixels[3] == 255 && pixels[5] == 0, "RGBM");
    stbi_image_free(pixels);
    memcpy(v, strange, sizeof v);
    map.values = v;
    map_survey_of(&survey, &map);
    v[4] = -1e5f;
    memset(&low, 0, sizeof low);
    map_survey_of(&low, &map);
    CHECK(low.above_half == 3 && low.most == survey.most, "%d above", (int)low.above_half);
    CHECK(survey.strange == 3 && survey.above_half == 2 && survey.most > 9e29f && survey.most < 2e30f,
          "%d strange, %d above", (int)survey.strange, (int)survey.above_half);
}

static unsigned number_at(const unsigned char *bytes, size_t at) {
    return bytes[at] | (unsigned)bytes[at + 1] << 8 | (unsigned)bytes[at + 2] << 16 | (unsigned)bytes[at + 3] << 24;
}

/* The descriptor of a .ktx2 gives the bits, the meaning and the range of each channel (Khronos Data Format 1.3). */
TEST(ktx2_describes_its_channels) {
    enum { OFFSET = 48, SAMPLES = 28, SAMPLE = 16, SIGNED_FLOAT = 0xc0, ALPHA = 15 };
    unsigned char bytes[4096];
    const size_t size = written(MAP_KTX2, 0, bytes, sizeof bytes), first = number_at(bytes, OFFSET) + SAMPLES;
    unsigned i;
    REQUIRE(size > first + 4 * SAMPLE, "no descriptor");
    for (i = 0; i < 4; i++) {
        const size_t at = first + SAMPLE * i;
        CHECK(bytes[at] == 16 * i && bytes[at + 2] == 15 && bytes[at + 3] == ((i < 3 ? i : ALPHA) | SIGNED_FLOAT),
              "channel %u: bit %d, %d bits, kind %d", i, bytes[at], bytes[at + 2] + 1, bytes[at + 3]);
        CHECK(number_at(bytes, at + 8) == 0xbf800000 && number_at(bytes, at + 12) == 0x3f800000, "range of channel %u",
              i);
    }
}

/* A component of a .hdr is rounded to the nearest step of the exponent, also if rounding raises the exponent. */
TEST(hdr_rounds_to_the_nearest) {
    static const float texels[3][3] = { { 0.9985f, 0.5045f, 0.25f }, { 0.75f, 0.5045f, 0.001f }, { 3, 1.005f, 0 } };
    int i, k, exponent;
    for (i = 0; i < 3; i++) {
        float v[3];
        double most, step;
        memcpy(v, texels[i], sizeof v);
        map__round_rgbe(v);
        most = test_max((double)v[0], test_max((double)v[1], (double)v[2]));
        frexp(most, &exponent);
        step = ldexp(1, exponent - 8);
        for (k = 0; k < 3; k++)
            CHECK(fabs(floor((double)v[k] / step) * step - (double)texels[i][k]) <= 0.5001 * step,
                  "texel %d: %g becomes %g, in steps of %g", i, (double)texels[i][k],
                  floor((double)v[k] / step) * step, step);
    }
}

/* A .bin has normals of length 1. A normal of length 0, which glTF forbids, points up. */
TEST(written_normals_have_length_1) {
    static const float normals[9] = { 0, 0, 0, 0, 0, -4, 0.6f, 0.8f, 0 }, units[9] = { 0, 1, 0, 0, 0, -1, 0.6f, 0.8f,
        0 };
    float found[9];
    FILE *file = tmpfile();
    int k;
    REQUIRE(file, "no temporary file");
    gltf__put_normals(file, normals, 3);
    rewind(file);
    REQUIRE(fread(found, 1, sizeof found, file) == sizeof found, "the file is too short");
    fclose(file);
    for (k = 0; k < 9; k++) CHECK(fabs((double)found[k] - (double)units[k]) < 1e-6, "%d: %g", k, (double)found[k]);
}

/* A texture of floats becomes a .png of 8 bits, whose colours are encoded as sRGB, and whose alpha is linear. */
TEST(alpha_of_textures_is_linear) {
    static const float texels[6] = { 0.5f, 0.5f, 1, 0.25f, 0, 0.75f };
    static const unsigned char expected[6] = { 188, 128, 255, 64, 0, 191 };
    unsigned char file[1024], *bytes;
    sbl_texture texture;
    sbl_scene_desc scene;
    gltf_file out;
    FILE *stream = fmemopen(file, sizeof file, "wb");
    int width = 0, height = 0, channels = 0, written = 0;
    memset(&texture, 0, sizeof texture);
    memset(&scene, 0, sizeof scene);
    memset(&out, 0, sizeof out);
    texture.pixels = texels;
    texture.format = SBL_PIXELS_FLOAT;
    texture.width = 3;
    texture.height = 1;
    texture.channels = 2;
    scene.textures = &texture;
    scene.texture_count = 1;
    out.scene = &scene;
    if (stream) {
        written = gltf_write_texture(stream, &out, 0);
        fclose(stream);
    }
    REQUIRE(written, "no .png");
    bytes = stbi_load_from_memory(file, sizeof file, &width, &height, &channels, 0);
    REQUIRE(bytes && width == 3 && height == 1 && channels == 2, "a .png of %d x %d, %d channels", width, height,
            channels);
    CHECK(memcmp(bytes, expected, sizeof expected) == 0, "%d %d, %d %d, %d %d", bytes[0], bytes[1], bytes[2], bytes[3],
          bytes[4], bytes[5]);
    stbi_image_free(bytes);
}

/* The texture of a lit scene shows glass as transparent by 0.9 of its transmission. Highlights lower the exposure by at
   most 1.5 stops. */
TEST(glass_is_transparent_in_lit_scenes) {
    static float light[3] = { 1, 1, 1 }, shown[100];
    static const float at[9] = { 0, 0, 0, 1, 0, 0, 0, 1, 0 }, uv[6] = { -1, -1, 3, -1, -1, 3 };
    static const uint32_t corners[3] = { 0, 1, 2 };
    static const int map = 0;
    image atlas = { 1, 1, 3, light, NULL, { 0, 0 }, { 0, 0 }, NULL, 0 };
    sbl_material material;
    sbl_mesh mesh;
    sbl_scene_desc scene;
    lit_scene lit;
    int i;
    memset(&material, 0, sizeof material);
    memset(&mesh, 0, sizeof mesh);
    memset(&scene, 0, sizeof scene);
    memset(&lit, 0, sizeof lit);
    material.transmission = 0.5f;
    mesh.positions.data = at;
    mesh.lightmap_texcoords.data = uv;
    mesh.vertex_count = mesh.index_count = 3;
    mesh.indices.data = corners;
    scene.meshes = &mesh;
    scene.materials = &material;
    scene.mesh_count = scene.material_count = 1;
    lit.scene = &scene;
    lit.maps = &map;
    lit.atlases = &atlas;
    lit.map_count = 1;
    lit.size = 4;
    REQUIRE(lit_make(&lit), "no texture");
    for (i = 0; i < 16; i++) CHECK(abs(lit.texels[4 * i + 3] - 140) <= 1, "alpha is %d", lit.texels[4 * i + 3]);
    lit_free(&lit);
    for (i = 0; i < 100; i++) shown[i] = 28;
    CHECK(fabs(lit__excess(shown, 100, 0) - 1.5) < 1e-6, "%g stops too much", lit__excess(shown, 100, 0));
    CHECK(fabs(lit__excess(shown, 100, -3) - log(10) / log(2) + 3) < 1e-5, "%g stops too much",
          lit__excess(shown, 100, -3));
}

/* A texel between two charts shows the nearer one, in whatever order they are drawn. */
TEST(gaps_show_the_nearer_chart) {
    static float light[3] = { 1, 1, 1 };
    static const float at[9] = { 0, 0, 0, 1, 0, 0, 0, 1, 0 };
    static const float uv[2][6] = { { -9, 0, 0.36f, -9, 0.36f, 9 }, { 9, 0, 0.55f, -9, 0.55f, 9 } };  /* left, right */
    static const uint32_t corners[3] = { 0, 1, 2 };
    static const int maps[2] = { 0, 0 };
    image atlas = { 1, 1, 3, light, NULL, { 0, 0 }, { 0, 0 }, NULL, 0 };
    sbl_material materials[2];
    sbl_mesh meshes[2];
    sbl_scene_desc scene;
    int i, turn;
    for (turn = 0; turn < 2; turn++) {
        lit_scene lit;
        memset(materials, 0, sizeof materials);
        memset(meshes, 0, sizeof meshes);
        memset(&scene, 0, sizeof scene);
        memset(&lit, 0, sizeof lit);
        for (i = 0; i < 2; i++) {
            materials[i].albedo[0] = 0.2f + 0.6f * (float)i;
            meshes[i].material = i;
            meshes[i].positions.data = at;
            meshes[i].lightmap_texcoords.data = uv[i ^ turn];
            meshes[i].vertex_count = meshes[i].index_count = 3;
            meshes[i].indices.data = corners;
        }
        scene.meshes = meshes;
        scene.materials = materials;
        scene.mesh_count = scene.material_count = 2;
        lit.scene = &scene;
        lit.maps = maps;
        lit.atlases = &atlas;
        lit.map_count = 1;
        lit.size = 8;
        REQUIRE(lit_make(&lit), "no texture");
        for (i = 0; i < 8; i++) {
            const unsigned char *row = lit.texels + 4 * 8 * i;
            CHECK(row[0] != row[4 * 7] && row[4 * 3] == row[0] && row[4 * 4] == row[4 * 7],
                  "order %d, row %d: %d %d %d %d", turn, i, row[0], row[4 * 3], row[4 * 4], row[4 * 7]);
        }
        lit_free(&lit);
    }
}

/* Values that are too large for 16-bit floats are lowered to finite ones, and a message says how to keep them. */
TEST(too_large_values_are_reported) {
    picture light;
    write_scene("room.gltf", apart, 1);
    CHECK(TOOL(DIRECT, "--sky", "1e6,1e6,1e6", "--formats", IF_EXR("ktx2,rgbm,hdr"), "-o", "bright") == 0 &&
          ran.err_lines == 2 && said("above 65504") && said("--formats exr32 keeps them"), "%s", ran.err);
    CHECK(TOOL(DIRECT, "--sky", "1e6,1e6,1e6", "--formats", EXACT, "-o", "exact") == 0 && ran.err_lines == 0, "%s",
          ran.err);
    light = draw_with("bright");  /* fails if there are infinities */
    CHECK(light.values && light.values[3 * (20 * 40 + 5)] > 6e4f && light.values[3 * (20 * 40 + 5)] < 65505, "R is %g",
          light.values ? (double)light.values[3 * (20 * 40 + 5)] : 0.0);
    free(light.values);
}

/* ---- failures ---- */

/* If the disk is too full for a file, no part of it is left, in any format. */
TEST(a_full_disk_leaves_nothing) {
    static const char *const formats[] = { "hdr", "rgbm", "ktx2", EXACT };
    char files[2][64];
    size_t i;
    write_scene("room.gltf", apart, 1);
    for (i = 0; i < sizeof formats / sizeof *formats; i++) {
        char full[32];
        const char *const arguments[] = { DIRECT, "-o", full, "--formats", formats[i], "--quiet", NULL };
        snprintf(full, sizeof full, "full_%s", formats[i]);
        finish(start(arguments, -1, 1024));
        CHECK(ran.status == 1 && said("cannot be written") && ran.err_lines == 1 && !parts_left(), "%s: status %d: %s",
              formats[i], ran.status, ran.err);
        snprintf(files[0], sizeof files[0], "%s/scene.gltf", full);
        snprintf(files[1], sizeof files[1], "%s/scene_lit.glb", full);
        CHECK(!exists(files[0]) && !exists(files[1]), "%s: an incomplete scene is left", formats[i]);
    }
    {
        const char *const arguments[] = { DIRECT, "-o", "lit", "--formats", "rgbm", "--lit", "1024", "--quiet", NULL };
        finish(start(arguments, -1, 20000));
        CHECK(ran.status == 1 && said("scene_lit.glb: cannot be written") && !exists("lit/scene_lit.glb") &&
              !parts_left(), "status %d: %s", ran.status, ran.err);
    }
}

/* Files that cannot be written are reported before the work. */
TEST(unwritable_files_are_reported_before_the_work) {
    write_scene("room.gltf", apart, 1);
    mkdir(in_folder("way"), 0777);
    mkdir(in_folder("way/atlas.ktx2"), 0777);
    CHECK(TOOL(DIRECT, "-o", "way", "--formats", "hdr,ktx2") == 1 && said("atlas.ktx2: cannot be written") &&
          !exists("way/lightmap.hdr"), "%s", ran.err);
    CHECK(TOOL(DIRECT, "-o", "way", "--formats", "hdr", "--lit", "0") == 0, "%s", ran.err);
    mkdir(in_folder("way/scene_lit.glb"), 0777);
    CHECK(TOOL(DIRECT, "-o", "way", "--formats", "hdr") == 1 && said("scene_lit.glb: cannot be written"), "%s",
          ran.err);
}

/* The picture of overlaps of an earlier bake in the same folder is removed if this bake has none. Other files stay. */
TEST(old_overlaps_are_removed) {
    static float overlapping[QUADS][4] = { { 0.1f, 0.1f, 0.6f, 0.6f }, { 0.5f, 0.5f, 0.9f, 0.9f } };
    write_scene("room.gltf", overlapping, 1);
    CHECK(TOOL(DIRECT, "-o", "old", "--formats", "hdr", "--lit", "0") == 0 && exists("old/overlap.png"), "%s", ran.err);
    write_scene("room.gltf", apart, 1);
    write_text("old/notes.txt", "mine");
    CHECK(TOOL(DIRECT, "-o", "old", "--formats", "ktx2", "--lit", "0") == 0 && !exists("old/overlap.png") &&
          exists("old/atlas.hdr") && exists("old/notes.txt"), "%s", ran.err);
}

/* ---- joining parts ---- */

/* Parts are .exr files, and --join writes the chosen formats. sbl_merge refuses parts of a map. */
TEST(joined_maps_have_formats) {
#ifdef SBL_RENDER_OPENEXR
    write_scene("room.gltf", apart, 1);
    mkdir(in_folder("parts"), 0777);
    CHECK(TOOL(DIRECT, "--part", "1/2", "-o", "parts/1.exr", "--formats", "hdr") == 0 && ran.err_lines == 1 &&
          said("--formats (a part is an .exr"), "%s", ran.err);
    CHECK(TOOL(DIRECT, "--part", "2/2", "-o", "parts/2.exr") == 0 && ran.err_lines == 0, "%s", ran.err);
    CHECK(TOOL(DIRECT, "--join", "parts", "-o", "joined", "--formats", "rgbm,ktx2") == 0, "%s", ran.err);
    CHECK(exists("joined/atlas.rgbm.png") && exists("joined/lightmap.ktx2") && exists("joined/scene_lit.glb") &&
          !exists("joined/atlas.exr"), "other files");
    tool_use("sbl_merge");
    CHECK(TOOL("parts/1.exr", "parts/2.exr", "-o", "map.exr") == 1 && said("sbl_bake --lightmap with --join"), "%s",
          ran.err);
    tool_use("sbl_bake");
#else
    SKIP("built without OpenEXR");
#endif
}

/* ---- scene_lit.glb ---- */

static double linear_of(double byte) {
    const double c = byte / 255;
    return c <= 0.04045 ? c / 12.92 : pow((c + 0.055) / 1.055, 2.4);
}

/* Returns the largest difference between the floor in a picture of the size of the map and albedo times light, one stop
   darker and tone-mapped; 1 if too little of the floor is visible. */
static double worst_of_floor(const unsigned char *rgb, const picture *light) {
    double worst = 0;
    int x, y, k, seen = 0;
    for (y = 8; y < 37; y++)
        for (x = 8; x < 29; x++) {  /* up to the middle of the second texel of floor.ppm */
            const double along = 2 * fabs(((x + 0.5) / 64 - 0.1) / 0.5 - 0.25);
            const double albedo[3] = { 0.5 * (1 - along + along * linear_of(0x80)),
                                       0.5 * (1 - along + along * linear_of(0x40)), 1 };
            double shown[3], least = 1;
            for (k = 0; k < 3; k++) {
                shown[k] = 0.5 * albedo[k] * (double)light->values[3 * (64 * y + x) + k];
                if (shown[k] < least) least = shown[k];
            }
            for (k = 0; k < 3; k++) {
                const double toe = least < 0.08 ? least - 6.25 * least * least : 0.04;
                if (shown[k] - toe > 0.7) continue;
                worst = test_max(worst, fabs(linear_of(rgb[3 * (64 * y + x) + k]) - (shown[k] - toe)));
                seen++;
            }
        }
    return seen > 1000 ? worst : 1;
}

/* In the lit scene, vertex colours tint the albedo, and the transform of a mesh moves its vertices. The exposure
   ignores texels below a twentieth of the mean, which are hidden. */
TEST(lit_scenes_have_tints_places_and_exposure) {
    enum { ACROSS = 10, HIDDEN = 40 };
    static float light[3] = { 0.4f, 0.4f, 0.4f }, dark[3 * ACROSS * ACROSS];
    static const float at[9] = { 0, 0, 0, 1, 2, 3, 0, 1, 0 }, uv[6] = { -1, -1, 3, -1, -1, 3 };
    static const float tints[12] = { 1, 0.5f, 0.25f, 1, 1, 0.5f, 0.25f, 1, 1, 0.5f, 0.25f, 1 };
    static const float turned[16] = { 0, 2, 0, 0, -1, 0, 0, 0, 0, 0, 1, 0, 10, 20, 30, 1 };
    static const uint32_t corners[3] = { 0, 1, 2 };
    static const int map = 0;
    image atlas = { 1, 1, 3, light, NULL, { 0, 0 }, { 0, 0 }, NULL, 0 };
    image metered = { ACROSS, ACROSS, 3, dark, NULL, { 0, 0 }, { 0, 0 }, NULL, 0 };
    sbl_material material;
    sbl_mesh mesh;
    sbl_scene_desc scene;
    lit_scene lit;
    float moved_to[3];
    int i;
    memset(&material, 0, sizeof material);
    memset(&mesh, 0, sizeof mesh);
    memset(&scene, 0, sizeof scene);
    memset(&lit, 0, sizeof lit);
    for (i = 0; i < 3; i++) material.albedo[i] = 1;
    mesh.positions.data = at;
    mesh.colors.data = tints;
    mesh.lightmap_texcoords.data = uv;
    mesh.vertex_count = mesh.index_count = 3;
    mesh.indices.data = corners;
    scene.meshes = &mesh;
    scene.materials = &material;
    scene.mesh_count = scene.material_count = 1;
    lit.scene = &scene;
    lit.maps = &map;
    lit.atlases = &atlas;
    lit.map_count = 1;
    lit.size = 4;
    REQUIRE(lit_make(&lit), "no texture");
    for (i = 0; i < 3; i++)  /* the tone curve subtracts 0.04 */
        CHECK(fabs(linear_of(lit.texels[i]) - (0.4 / (1 << i) - 0.04)) < 0.003, "channel %d is %d", i, lit.texels[i]);
    lit_free(&lit);
    lit__position(&mesh, 1, moved_to);
    CHECK(!memcmp(moved_to, at + 3, sizeof moved_to), "a mesh without a transform moves");
    memcpy(mesh.transform, turned, sizeof turned);
    lit__position(&mesh, 1, moved_to);  /* x' = 10 - y, y' = 20 + 2 x, z' = 30 + z */
    CHECK(fabs((double)moved_to[0] - 8) + fabs((double)moved_to[1] - 22) + fabs((double)moved_to[2] - 33) < 1e-5,
          "the vertex is at %g %g %g", (double)moved_to[0], (double)moved_to[1], (double)moved_to[2]);
    for (i = 0; i < 3 * ACROSS * ACROSS; i++) dark[i] = i < 3 * HIDDEN ? 0.02f : 1;
    REQUIRE(lit_meter(&lit, &metered), "out of memory");
    CHECK(fabs(lit_stops(&lit) - log(0.71) / log(2)) < 1e-5, "the exposure is %g stops", lit_stops(&lit));
    lit_free(&lit);
}

/* The texture shows albedo times light, exposed, tone-mapped and encoded. The lamp is white. Both sets of texture
   coordinates equal those of the map. */
TEST(a_lit_scene_shows_the_light) {
    size_t size, at = 0;
    unsigned char *bytes, *png;
    const char *json;
    int width = 0, height = 0, channels;
    picture light;
    write_scene("room.gltf", apart, 1);
    REQUIRE(TOOL(DIRECT, "--formats", "pfm", "--lit", "64", "--exposure", "-1", "-o", "out") == 0, "%s", ran.err);
    light = read_pfm("out/atlas.pfm");
    bytes = bytes_of("out/scene_lit.glb", &size);
    REQUIRE(bytes && size > 1000 && memcmp(bytes, "glTF\2\0\0\0", 8) == 0 && light.values, "no .glb");
    json = (const char *)bytes + 20;
    CHECK(strstr(json, "\"KHR_materials_unlit\": {}") && strstr(json, "\"texCoord\": 1") &&
          strstr(json, "\"exposure_stops\": -1}") && strstr(json, "\"TEXCOORD_0\": 1, \"TEXCOORD_1\": 1}"), "%.2000s",
          json);
    while (at + 8 < size && memcmp(bytes + at, "\x89PNG\r\n", 6) != 0) at++;
    png = stbi_load_from_memory(bytes + at, (int)(size - at), &width, &height, &channels, 3);
    REQUIRE(png && width == 64 && height == 64, "no texture of 64 x 64");
    CHECK(worst_of_floor(png, &light) < 0.006, "off by %g", worst_of_floor(png, &light));
    CHECK(png[3 * (51 * 64 + 51)] > 200, "the lamp is %d", png[3 * (51 * 64 + 51)]);
    CHECK(png[0] > 0, "texels between the charts are not filled");
    stbi_image_free(png);
    free(bytes);
    free(light.values);
}

int main(int argc, char **argv) {
    (void)argc;
    if (!tool_begin(argv[0])) return 1;
    tool_use("sbl_bake");
    RUN(all_formats_hold_the_light);
    RUN(dim_maps_are_dim);
    RUN(the_newest_map_is_drawn);
    RUN(harmonics_need_negative_values);
    RUN(wrong_formats_are_refused);
    RUN(rgbm_keeps_the_brightest);
    RUN(strange_values_become_finite);
    RUN(ktx2_describes_its_channels);
    RUN(hdr_rounds_to_the_nearest);
    RUN(written_normals_have_length_1);
    RUN(alpha_of_textures_is_linear);
    RUN(glass_is_transparent_in_lit_scenes);
    RUN(lit_scenes_have_tints_places_and_exposure);
    RUN(gaps_show_the_nearer_chart);
    RUN(too_large_values_are_reported);
    RUN(a_full_disk_leaves_nothing);
    RUN(unwritable_files_are_reported_before_the_work);
    RUN(old_overlaps_are_removed);
    RUN(joined_maps_have_formats);
    RUN(a_lit_scene_shows_the_light);
    tool_end();
    return test_report();
}
