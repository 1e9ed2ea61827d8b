/* Tests the command line tool build/sbl_render as a user runs it. The tests create all input files, so that the correct
   output is known. */
#define _XOPEN_SOURCE 700
#define _DEFAULT_SOURCE
#include "support/test.h"
#include "support/tool.h"
#include "../examples/tool_words.h"
#include <fts.h>
#include <math.h>
#include <poll.h>
#include <stdarg.h>
#include <time.h>
#define STB_IMAGE_WRITE_IMPLEMENTATION
#include <stb/stb_image_write.h>
/* >>pictures */

static double at(const picture *p, int x, int y, int k) {
    return p->values ? (double)p->values[3 * (y * p->width + x) + k] : -1;
}

static double decode_srgb(double x) { return x <= 0.04045 ? x / 12.92 : pow((x + 0.055) / 1.055, 2.4); }
static int encode_srgb(double x) {
    double v = x <= 0.0031308 ? 12.92 * x : 1.055 * pow(x, 1 / 2.4) - 0.055;
    return (int)(255 * (v > 1 ? 1 : v) + 0.5);
}

/* Returns component k of a texel of the 4 x 4 test texture. All texels differ, so that flips and rotations are
   noticed. */
static int texel(int x, int y, int k) {
    return k == 3 ? 17 * (4 * y + x) : k == 0 ? 60 + 50 * x : k == 1 ? 250 - 60 * y : 40 + 12 * (4 * y + x);
}
static void make_texels(unsigned char *out, int channels) {
    int x, y, k;
    for (y = 0; y < 4; y++)
        for (x = 0; x < 4; x++)
            for (k = 0; k < channels; k++) *out++ = (unsigned char)texel(x, y, k);
}

/* >>scenes: a wall of 4 x 4 cells, seen from the front in a picture of 16 x 16, so that each cell covers 4 x 4
   pixels */

#define WALL_CAMERA "--eye", "0,0,1", "--look-at", "0,0,0", "--fov", "90"
#define WALL_SIZE "--size", "16x16"

static void wall_obj(void) {
    unsigned char rgb[48], rgba[64], mask[64], wide_mask[192];
    static const char *const materials[] = {
        "Kd .2 .4 .6", "Kd 1 1 1\nmap_Kd rgb.png", "Kd .5 .25 1\nmap_Kd rgb.png", "Kd 0 0 0\nKe 1 2 3",
        "Kd 0 0 0\nKe 2 4 8\nmap_Ke rgb.png", "Kd 0 0 0\nmap_Ke rgb.png", "Kd .5 .5 .5\nmap_d mask.png",
        "Kd 1 1 1\nmap_Kd rgb.png\nmap_d wide.png",
        "Kd .5 .5 .5\nd 0.3", "Kd .5 .5 .5\nd 0.7", "Kd 1 1 1\nmap_Kd rgba.png", "Kd .3 .3 .3\nmap_Kd absent.png",
        "Kd .5 .5 .5\nTr 0.8", "Kd 1 1 1\nmap_Kd sub\\again.png", "Kd 1 1 1\nmap_Kd rgba.png\nmap_d rgba.png",
        "Kd 1 1 1\nmap_Kd -s 1 1 1 rgb.png" };
    FILE *obj, *mtl;
    int i, x, y;
    make_texels(rgb, 3);
    make_texels(rgba, 4);
    for (i = 0; i < 16; i++) mask[i] = (unsigned char)((i ^ i >> 2) & 1 ? 255 : 0);           /* a checkerboard */
    for (y = 0; y < 8; y++)
        /* the lower left half; green and blue do not count */
        for (x = 0; x < 24; x++) wide_mask[24 * y + x] = (unsigned char)(!(x % 3) && y / 2 >= x / 6 ? 200 : 100);
    mkdir(in_folder("sub"), 0777);
    stbi_write_png(in_folder("rgb.png"), 4, 4, 3, rgb, 12);
    stbi_write_png(in_folder("sub/again.png"), 4, 4, 3, rgb, 12);
    stbi_write_png(in_folder("rgba.png"), 4, 4, 4, rgba, 16);
    stbi_write_png(in_folder("mask.png"), 4, 4, 1, mask, 4);
    stbi_write_png(in_folder("wide.png"), 8, 8, 3, wide_mask, 24);
    mtl = fopen(in_folder("wall.mtl"), "w");
    obj = fopen(in_folder("wall.obj"), "w");
    fprintf(obj, "mtllib wall.mtl\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n");
    for (i = 0; i < 16; i++) {
        double left = -1 + 0.5 * (i % 4), top = 1 - 0.5 * (i / 4);
        fprintf(mtl, "newmtl m%d\n%s\n", i, materials[i]);
        fprintf(obj, "g cell%d\nusemtl m%d\nv %g %g 0\nv %g %g 0\nv %g %g 0\nv %g %g 0\nf %d/1 %d/2 %d/3 %d/4\n", i, i,
                left, top - 0.5,
                left + 0.5, top - 0.5, left + 0.5, top, left, top, 4 * i + 1, 4 * i + 2, 4 * i + 3, 4 * i + 4);
    }
    fclose(mtl);
    fclose(obj);
}

/* Compares the 4 x 4 pixels of a cell with their expected values. */
typedef double (*expected_value)(int x, int y, int k);
static void check_cell(const picture *p, int cell, expected_value expected, double tolerance, const char *what) {
    int x, y, k, bad = 0, bx = 0, by = 0, bk = 0;
    for (y = 0; y < 4; y++)
        for (x = 0; x < 4; x++)
            for (k = 0; k < 3; k++) {
                double value = at(p, cell % 4 * 4 + x, cell / 4 * 4 + y, k);
                if (!(fabs(value - expected(x, y, k)) <= tolerance) && !bad++) { bx = x; by = y; bk = k; }
            }
    CHECK(!bad, "%s: %d values of 48 differ, the first at %d %d component %d: %g, expected %g", what, bad, bx, by, bk,
          at(p, cell % 4 * 4 + bx, cell / 4 * 4 + by, bk), expected(bx, by, bk));
}
static double nothing(int x, int y, int k) { (void)x; (void)y; (void)k; return 0; }
static double one(int x, int y, int k) { (void)x; (void)y; (void)k; return 1; }
static double half(int x, int y, int k) { (void)x; (void)y; (void)k; return 0.5; }
static double three_tenths(int x, int y, int k) { (void)x; (void)y; (void)k; return 0.3; }
static double kd(int x, int y, int k) { (void)x; (void)y; return 0.2 * (k + 1); }
static double tex(int x, int y, int k) { return decode_srgb(texel(x, y, k) / 255.0); }
static double tinted(int x, int y, int k) { return (k == 0 ? 0.5 : k == 1 ? 0.25 : 1) * tex(x, y, k); }
static double ke(int x, int y, int k) { (void)x; (void)y; return k + 1; }
static double ke_tex(int x, int y, int k) { return (2 << k) * tex(x, y, k); }
static double checkered(int x, int y, int k) { (void)k; return (x ^ y) & 1 ? 0.5 : 0; }
static double lower_left(int x, int y, int k) { return y >= x ? tex(x, y, k) : 0; }
static double by_alpha(int x, int y, int k) { return texel(x, y, 3) >= 128 ? tex(x, y, k) : 0; }

/* Every cell of an .obj scene has the albedo or emission that its .mtl file defines. */
TEST(obj_materials_and_textures) {
    picture albedo, final;
    wall_obj();
    CHECK(TOOL("wall.obj", WALL_CAMERA, WALL_SIZE, SMALL, "--mode", "direct", "--channel", "albedo", "-o",
               "albedo.pfm") == 0,
          "exit status %d: %s", ran.status, ran.err);
    CHECK(ran.err_lines == 3 && strstr(ran.err, "warning") && strstr(ran.err, "absent.png") &&
              strstr(ran.err, "partial transparency is read as a cutout: opaque from 0.5 on (1 material)") &&
              strstr(ran.err, "transparent surfaces are left out: their opacity is 0, or below the cutoff"
                              " (2 materials)"),
          "expected three warnings, about the missing texture, d 0.7, and surfaces that are left out: %s", ran.err);
    albedo = read_pfm("albedo.pfm");
    CHECK(TOOL("wall.obj", WALL_CAMERA, WALL_SIZE, SMALL, "--mode", "direct", "--quiet", "-o", "final.pfm") == 0,
          "exit status %d: %s",
          ran.status, ran.err);
    CHECK(!ran.err[0], "--quiet should say nothing: %s", ran.err);
    final = read_pfm("final.pfm");
    REQUIRE(albedo.values && final.values && albedo.width == 16 && albedo.height == 16, "the pictures are not there");
    check_cell(&albedo, 0, kd, 0.002, "Kd");
    check_cell(&albedo, 1, tex, 0.004, "map_Kd");
    check_cell(&albedo, 2, tinted, 0.004, "Kd times map_Kd");
    check_cell(&final, 3, ke, 0.004, "Ke");
    check_cell(&final, 4, ke_tex, 0.03, "Ke times map_Ke");
    check_cell(&final, 5, tex, 0.004, "map_Ke alone");
    check_cell(&final, 1, nothing, 1e-4, "light where there is no lamp");
    check_cell(&albedo, 6, checkered, 0.002, "map_d");
    check_cell(&albedo, 7, lower_left, 0.004, "map_d of another size");
    check_cell(&albedo, 8, nothing, 0, "d 0.3");
    check_cell(&albedo, 9, half, 0.002, "d 0.7");
    check_cell(&albedo, 10, tex, 0.004, "alpha that no map_d asks for");
    check_cell(&albedo, 11, three_tenths, 0.002, "missing texture");
    check_cell(&albedo, 12, nothing, 0, "Tr 0.8");
    check_cell(&albedo, 13, tex, 0.004, "texture in a folder, with a backslash");
    check_cell(&albedo, 14, by_alpha, 0.004, "map_d with an alpha channel");
    check_cell(&albedo, 15, tex, 0.004, "map_Kd with an option");
    free(albedo.values);
    free(final.values);
}

/* The wall as glTF, with a camera of 90 degrees. The order of the materials differs from the order of their use, and
   two have no name. */
enum { GLTF_CELLS = 16 };
static const char *const gltf_materials[GLTF_CELLS] = {
    "\"pbrMetallicRoughness\":{\"baseColorFactor\":[0.2,0.4,0.6,1]}",
    "\"pbrMetallicRoughness\":{\"baseColorFactor\":[0.5,0.25,1,1],\"baseColorTexture\":{\"index\":0}}",
    "\"emissiveFactor\":[0.125,0.25,0.375],\"extensions\":{\"KHR_materials_emissive_strength\":{\"emissiveStrength\":8}"
        "}",
    "\"emissiveFactor\":[0.125,0.25,0.375],"
        "\"extensions\":{\"KHR_materials_emissive_strength\":{\"emissiveStrength\":800}}",
    "\"emissiveFactor\":[0.5,1,1],\"emissiveTexture\":{\"index\":1},"
        "\"extensions\":{\"KHR_materials_emissive_strength\":{\"emissiveStrength\":4}}",
    "\"alphaMode\":\"MASK\",\"pbrMetallicRoughness\":{\"baseColorTexture\":{\"index\":0}}",
    "\"alphaMode\":\"MASK\",\"alphaCutoff\":0.25,\"pbrMetallicRoughness\":{\"baseColorTexture\":{\"index\":0}}",
    "\"alphaMode\":\"BLEND\",\"pbrMetallicRoughness\":{\"baseColorTexture\":{\"index\":0}}",
    "\"alphaMode\":\"OPAQUE\",\"pbrMetallicRoughness\":{\"baseColorTexture\":{\"index\":0}}",
    "\"alphaMode\":\"MASK\",\"pbrMetallicRoughness\":{\"baseColorFactor\":[1,1,1,0.4]}",
    "\"alphaMode\":\"MASK\",\"alphaCutoff\":0.25,\"pbrMetallicRoughness\":{\"baseColorFactor\":[1,1,1,0.5],"
        "\"baseColorTexture\":{\"index\":0}}",
    "\"pbrMetallicRoughness\":{\"baseColorFactor\":[1,1,1,0.1]}",
    "\"emissiveFactor\":[1,1,1]", "\"name\":\"unused\",\"emissiveFactor\":[1,1,1],"
        "\"extensions\":{\"KHR_materials_emissive_strength\":{\"emissiveStrength\":70}}",
    "\"name\":\"m\"", "\"name\":\"m\",\"pbrMetallicRoughness\":{\"metallicFactor\":1,\"baseColorFactor\":[0.5,0.5,0.5,"
        "1]}" };

static size_t base64(const unsigned char *data, size_t size, char *out) {
    static const char digits[] = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    size_t i, n = 0;
    for (i = 0; i < size; i += 3) {
        unsigned b = (unsigned)data[i] << 16 | (i + 1 < size ? (unsigned)data[i + 1] << 8 : 0) |
            (i + 2 < size ? data[i + 2] : 0u);
        out[n++] = digits[b >> 18];
        out[n++] = digits[b >> 12 & 63];
        out[n++] = i + 1 < size ? digits[b >> 6 & 63] : '=';
        out[n++] = i + 2 < size ? digits[b & 63] : '=';
    }
    out[n] = 0;
    return n;
}

static void wall_gltf(const char *name, int binary) {
    static unsigned char buffer[4096];
    static char json[32768], text[8192];
    const float positions[12] = { 0, -0.5f, 0, 0.5f, -0.5f, 0, 0.5f, 0, 0, 0, 0, 0 },
                texcoords[8] = { 0, 1, 1, 1, 1, 0, 0, 0 }; /* in glTF, v = 0 is the top row */
    const float colors[16] = { 0, 0, 0, 1, 1, 0, 0, 1, 1, 1, 0, 1, 0, 1, 0, 1 };
    const unsigned short indices[6] = { 0, 1, 2, 0, 2, 3 };
    unsigned char rgba[64], *png;
    int png_size, i, n = 0;
    size_t size = 48 + 32 + 64 + 12;
    make_texels(rgba, 4);
    memcpy(buffer, positions, 48);
    memcpy(buffer + 48, texcoords, 32);
    memcpy(buffer + 80, colors, 64);
    memcpy(buffer + 144, indices, 12);
    png = stbi_write_png_to_mem(rgba, 16, 4, 4, 4, &png_size);
    memcpy(buffer + size, png, (size_t)png_size);
    size = (size + (size_t)png_size + 3) & ~(size_t)3;
    n += sprintf(
        json + n,
        "{\"asset\":{\"version\":\"2.0\"},\"extensionsUsed\":[\"KHR_materials_emissive_strength\"],\"scene\":0,"
            "\"scenes\":[{\"nodes\":[");
    for (i = 0; i < GLTF_CELLS; i++) n += sprintf(json + n, "%d,", GLTF_CELLS - 1 - i);
    n += sprintf(json + n,
                 "%d]}],\"cameras\":[{\"type\":\"perspective\",\"perspective\":{\"yfov\":1.5707963267948966,"
                     "\"aspectRatio\":1.7,\"znear\":"
                 "0.01}}],\"nodes\":[",
                 GLTF_CELLS);
    for (i = 0; i < GLTF_CELLS; i++) {
        /* Nodes 14 and 15 use meshes 12 and 0 again. Node 14 is a parent that translates; its child, with mesh 12,
           scales. */
        if (i == 14) n += sprintf(json + n, "{\"translation\":[0,-0.75,0],\"children\":[%d]},", GLTF_CELLS + 1);
        else n += sprintf(json + n, "{\"mesh\":%d,\"translation\":[%g,%g,0]},", i == 15 ? 0 : i, -1 + 0.5 * (i % 4),
                          1 - 0.5 * (i / 4));
    }
    n += sprintf(json + n, "{\"camera\":0,\"translation\":[0,0,1]},{\"mesh\":12,\"scale\":[0.5,0.5,1]}],\"meshes\":[");
    for (i = 0; i < GLTF_CELLS; i++)
        n += sprintf(json + n, "%s{\"primitives\":[{\"attributes\":{\"POSITION\":0,\"TEXCOORD_0\":1%s},\"indices\":3,"
                     "\"material\":%d}]}",
                     i ? "," : "", i == 11 ? ",\"COLOR_0\":2" : "", (i + 3) % GLTF_CELLS);
    n += sprintf(json + n, "],\"materials\":[");
    for (i = 0; i < GLTF_CELLS; i++)
        n += sprintf(json + n, "%s{%s}", i ? "," : "", gltf_materials[(i + GLTF_CELLS - 3) % GLTF_CELLS]);
    n += sprintf(json + n, "],\"samplers\":[{}],\"textures\":[{\"source\":0,\"sampler\":0},{\"source\":0}],"
                 "\"images\":[");
    base64(png, (size_t)png_size, text);
    n += binary ? sprintf(json + n, "{\"bufferView\":4,\"mimeType\":\"image/png\"}")
                : sprintf(json + n, "{\"uri\":\"data:image/png;base64,%s\"}", text);
    n += sprintf(
        json + n,
        "],\"accessors\":[{\"bufferView\":0,\"componentType\":5126,\"count\":4,\"type\":\"VEC3\",\"min\":[0,-0.5,0],"
            "\"max\":[0.5,0,0]},"
        "{\"bufferView\":1,\"componentType\":5126,\"count\":4,\"type\":\"VEC2\"},{\"bufferView\":2,"
            "\"componentType\":5126,\"count\":4,"
        "\"type\":\"VEC4\"},"
        "{\"bufferView\":3,\"componentType\":5123,\"count\":6,\"type\":\"SCALAR\"}],"
        "\"bufferViews\":[{\"buffer\":0,\"byteLength\":48},{\"buffer\":0,\"byteOffset\":48,\"byteLength\":32},"
        "{\"buffer\":0,\"byteOffset\":80,\"byteLength\":64},{\"buffer\":0,\"byteOffset\":144,\"byteLength\":12}");
    if (binary) n += sprintf(json + n, ",{\"buffer\":0,\"byteOffset\":156,\"byteLength\":%d}", png_size);
    base64(buffer, size, text);
    if (binary) n += sprintf(json + n, "],\"buffers\":[{\"byteLength\":%d}]}", (int)size);
    else n += sprintf(json + n, "],\"buffers\":[{\"byteLength\":%d,\"uri\":\"data:application/octet-stream;base64,%s\"}"
                      "]}", (int)size, text);
    if (binary) {
        uint32_t head[5], chunk[2];
        FILE *out = fopen(in_folder(name), "wb");
        while (n % 4) json[n++] = ' ';
        head[0] = 0x46546c67; head[1] = 2; head[2] = (uint32_t)(20 + n + 8) + (uint32_t)size; head[3] =
            (uint32_t)n; head[4] = 0x4e4f534a;
        chunk[0] = (uint32_t)size; chunk[1] = 0x004e4942;
        fwrite(head, 4, 5, out);
        fwrite(json, 1, (size_t)n, out);
        fwrite(chunk, 4, 2, out);
        fwrite(buffer, 1, size, out);
        fclose(out);
    } else write_file(name, json, (size_t)n);
    free(png);
}

static double ke_glb(int x, int y, int k) { return ke(x, y, k); }
static double ke_strong(int x, int y, int k) { return 100 * ke(x, y, k); }
static double ke_tex_glb(int x, int y, int k) { return (k ? 4 : 2) * tex(x, y, k); }
static double alpha_quarter(int x, int y, int k) { return texel(x, y, 3) >= 64 ? tex(x, y, k) : 0; }
static double vertex_colors(int x, int y, int k) {  /* two triangles, below and above the diagonal */
    double u = (x + 0.5) / 4, v = 1 - (y + 0.5) / 4;
    if (k == 2) return 0;
    return k == 0 ? (u > v ? u : u) : v;
}

static void check_gltf(const char *scene) {
    picture albedo, final;
    int x, y, k, lit = 0;
    char channel[64];
    snprintf(channel, sizeof channel, "%s.albedo.pfm", scene);
    CHECK(TOOL(scene, WALL_SIZE, SMALL, "--mode", "direct", "--channel", "albedo", "-o", channel) == 0,
          "exit status %d: %s", ran.status,
          ran.err);
    CHECK(ran.err_lines == 2 && said("partial transparency is read as a cutout: opaque from 0.5 on (1 material)") &&
          said("transparent surfaces are left out: their opacity is 0, or below the cutoff (1 material)"),
          "expected warnings about BLEND: %s", ran.err);
    albedo = read_pfm(channel);
    CHECK(TOOL(scene, WALL_SIZE, SMALL, "--mode", "direct", "-o", "final.pfm") == 0, "exit status %d: %s", ran.status,
          ran.err);
    final = read_pfm("final.pfm");
    REQUIRE(albedo.values && final.values, "the pictures are not there");
    check_cell(&albedo, 0, kd, 0.002, "baseColorFactor");
    check_cell(&albedo, 1, tinted, 0.004, "factor times texture");
    check_cell(&final, 2, ke_glb, 0.004, "emissive strength 8");
    check_cell(&final, 3, ke_strong, 0.4, "emissive strength 800 beside it");
    check_cell(&final, 4, ke_tex_glb, 0.02, "emissive texture times factor times strength");
    check_cell(&albedo, 5, by_alpha, 0.004, "MASK");
    check_cell(&albedo, 6, alpha_quarter, 0.004, "MASK with a cutoff of a quarter");
    check_cell(&albedo, 7, by_alpha, 0.004, "BLEND");
    check_cell(&albedo, 8, tex, 0.004, "OPAQUE");
    check_cell(&albedo, 9, nothing, 0, "MASK with a factor below the cutoff");
    check_cell(&albedo, 10, by_alpha, 0.004, "MASK with a factor and a texture");
    check_cell(&albedo, 11, vertex_colors, 0.004, "COLOR_0 in an opaque material");
    check_cell(&final, 12, one, 0.002, "emission without strength");
    check_cell(&albedo, 15, kd, 0.002, "a second instance of a mesh");
    for (y = 0; y < 4; y++)  /* translated by its parent and scaled to half: columns 8 and 9, rows 14 and 15 */
        for (x = 0; x < 4; x++)
            for (k = 0; k < 3; k++) lit += fabs(at(&final, 8 + x, 12 + y, k) - (x < 2 && y >= 2)) < 0.002;
    CHECK(lit == 48, "a mesh instance with a parent: %d values of 48 are right", lit);
    free(albedo.values);
    free(final.values);
}
/* Every cell of the wall as .gltf and as .glb has the albedo or emission that its material defines. */
TEST(gltf_materials_and_camera) { wall_gltf("wall.gltf", 0); check_gltf("wall.gltf"); }
TEST(glb_materials_and_camera) { wall_gltf("wall.glb", 1); check_gltf("wall.glb"); }

/* Every instance of a mesh has its own id. */
TEST(each_use_of_a_mesh_has_an_id) {
    picture id;
    int cell, other;
    wall_gltf("wall.glb", 1);
    REQUIRE(TOOL("wall.glb", WALL_SIZE, SMALL, "--channel", "id", "-o", "id.pfm") == 0, "exit status %d: %s",
            ran.status, ran.err);
    id = read_pfm("id.pfm");
    REQUIRE(id.values, "the picture is not there");
    for (cell = 0; cell < 16; cell++) {
        if (cell == 9 || cell == 14) continue;  /* cell 9 is cut out, and cell 14 is only partly filled */
        CHECK(at(&id, cell % 4 * 4 + 3, cell / 4 * 4 + 3, 0) > 0, "cell %d has no id", cell);
        for (other = 0; other < cell; other++)
            CHECK(other == 9 || other == 14 ||
                      at(&id, cell % 4 * 4 + 3, cell / 4 * 4 + 3, 0) !=
                          at(&id, other % 4 * 4 + 3, other / 4 * 4 + 3, 0),
                  "cells %d and %d share an id", cell, other);
    }
    free(id.values);
}

/* >>cameras */

/* A camera that is where Blender puts the camera of a new file, inside the model, is not used, and a note says so. Any
   other camera at the same place is used. */
TEST(blenders_first_camera_is_not_used_inside) {
    static const char *const eyes[3] = { "7.48113,5.34367,6.50764", "0.735889,0.495831,0.692579", "7.48,5.34,6.7" };
    char text[2048];
    int i;
    for (i = 0; i < 3; i++) {
        snprintf(text, sizeof text, "{\"asset\":{\"version\":\"2.0\"},\"scene\":0,\"scenes\":[{\"nodes\":[0,1]}],"
                 "\"nodes\":[{\"mesh\":0},{\"camera\":0,\"translation\":[%s]}],\"cameras\":[{\"type\":"
                 "\"perspective\",\"perspective\":{\"yfov\":0.7,\"znear\":0.1}}],\"meshes\":[{\"primitives\":[{"
                 "\"attributes\":{\"POSITION\":0}}]}],\"accessors\":[{\"bufferView\":0,\"componentType\":5126,"
                 "\"count\":3,\"type\":\"VEC3\",\"min\":[-100,-100,-100],\"max\":[100,100,100]}],\"bufferViews\":[{"
                 "\"buffer\":0,\"byteLength\":36}],\"buffers\":[{\"byteLength\":36,\"uri\":\"data:application/"
                 "octet-stream;base64,%s\"}]}", eyes[i],
                 "AADIwgAAyMIAAMjCAADIQgAAyMIAAMhCAAAAAAAAyEIAAAAA");
        write_text("first.gltf", text);
        CHECK(TOOL("first.gltf", "--size", "16x16", "--channel", "depth", "--verbose", "-o", "depth.pfm") == 0,
              "exit status %d: %s", ran.status, ran.err);
        CHECK(said("is that of a new Blender file") == (i < 2) && said("camera: of the file") == (i == 2), "%s: %s",
              eyes[i], ran.err);
    }
}

/* Options give the same picture as an equal camera in the file, and override the camera of the file. */
TEST(options_override_the_files_camera) {
    picture a, b;
    wall_gltf("wall.glb", 1);
    CHECK(TOOL("wall.glb", WALL_SIZE, SMALL, "--channel", "position", "-o", "a.pfm") == 0, "exit status %d: %s",
          ran.status, ran.err);
    CHECK(TOOL("wall.glb", WALL_SIZE, SMALL, "--channel", "position", "--eye=0,0,1", "--look-at", "0,0,-5", "--up",
               "0,2,0", "--fov", "90",
               "-o", "b.pfm") == 0,
          "exit status %d: %s", ran.status, ran.err);
    a = read_pfm("a.pfm");
    b = read_pfm("b.pfm");
    REQUIRE(a.values && b.values, "the pictures are not there");
    CHECK(fabs(at(&a, 0, 0, 0) + 15 / 16.0) < 1e-4 && fabs(at(&a, 0, 0, 1) - 15 / 16.0) < 1e-4,
          "the top left pixel shows %g %g",
          at(&a, 0, 0, 0), at(&a, 0, 0, 1));
    CHECK(memcmp(a.values, b.values, 16 * 16 * 3 * sizeof(float)) == 0,
          "the file's camera and the same one in options differ");
    free(a.values);
    free(b.values);
    CHECK(TOOL("wall.glb", WALL_SIZE, SMALL, "--channel", "position", "--fov", "45.0", "--up", "1,0,0", "-o",
               "a.pfm") == 0,
          "exit status %d: %s", ran.status, ran.err);
    a = read_pfm("a.pfm");
    REQUIRE(a.values, "the picture is not there");
    /* The camera is rolled by a quarter turn: up is +x, so the right side is -y. Half of the visible height is tan(22.5
       degrees). */
    CHECK(fabs(at(&a, 1, 1, 0) - 13 / 16.0 * tan(atan(1.0) / 2)) < 1e-4 &&
          fabs(at(&a, 1, 1, 1) - 13 / 16.0 * tan(atan(1.0) / 2)) < 1e-4,
          "rolled camera: pixel 1 1 shows %g %g", at(&a, 1, 1, 0), at(&a, 1, 1, 1));
    free(a.values);
}

static void check_framed(const char *size, int width, int height) {
    picture id;
    int x, y, seen = 0, border = 0;
    REQUIRE(TOOL("block.obj", "--size", size, SMALL, "--quiet", "--channel", "id", "-o", "id.pfm") == 0,
            "exit status %d: %s",
            ran.status, ran.err);
    id = read_pfm("id.pfm");
    REQUIRE(id.values, "the picture is not there");
    for (y = 0; y < height; y++)
        for (x = 0; x < width; x++)
            if (at(&id, x, y, 0) == 1.0) { seen++; border += x == 0 || y == 0 || x == width - 1 || y == height - 1; }
    CHECK(seen * 12 > (width < height ? width * width : height * height) && !border,
          "%s: %d pixels of the scene are seen, %d of them at the border", size, seen, border);
    free(id.values);
}
/* Without a camera in the file, the complete scene is visible and fills the picture. */
TEST(without_a_camera_the_scene_is_framed) {
    int i;
    char text[2048] = "";
    for (i = 0; i < 8; i++)
        sprintf(text + strlen(text), "v %d %d %d\n", 1000 + 40 * (i & 1), -500 + 30 * (i >> 1 & 1), 20 * (i >> 2));
    strcat(text, "f 1 2 4 3\nf 5 6 8 7\nf 1 2 6 5\nf 3 4 8 7\nf 1 3 7 5\nf 2 4 8 6\n");
    write_text("block.obj", text);
    check_framed("32x32", 32, 32);
    check_framed("48x24", 48, 24);
    check_framed("20x60", 20, 60);
}

/* >>light and camera of files that have none */

enum { ALL_SIDES = 63, WITHOUT_X = ALL_SIDES & ~1, WITHOUT_TOP = ALL_SIDES & ~4 };

/* Adds a box to the text of an .obj. sides: bits for +x -x +y -y +z -z. inward: 1 if the faces look inward */
static void add_box(char *text, const double low[3], const double high[3], int sides, int inward) {
    static const int faces[6][4] = { { 1, 3, 7, 5 }, { 0, 4, 6, 2 }, { 2, 6, 7, 3 }, { 0, 1, 5, 4 }, { 4, 5, 7, 6 },
        { 0, 2, 3, 1 } };
    int side, k;
    for (side = 0; side < 6; side++) {
        if (!(sides >> side & 1)) continue;
        for (k = 0; k < 4; k++) {
            const int corner = faces[side][inward ? 3 - k : k];
            sprintf(text + strlen(text), "v %g %g %g\n", corner & 1 ? high[0] : low[0], corner & 2 ? high[1] : low[1],
                    corner & 4 ? high[2] : low[2]);
        }
        strcat(text, "f -4 -3 -2 -1\n");
    }
}

static void write_boxes(const char *name, int sides, int inward, int thick, const char *before) {
    static const double low[3] = { 0, 0, 0 }, high[3] = { 5, 2.8, 4 };
    static const double within[3] = { 0.2, 0.2, 0.2 }, upto[3] = { 4.8, 2.6, 3.8 };
    static const double foot[3] = { 1, 0.2, 1 }, top[3] = { 2, 1, 2 };
    char text[8192];
    snprintf(text, sizeof text, "%s", before);
    add_box(text, low, high, sides, inward);
    if (thick) add_box(text, within, upto, ALL_SIDES, 1);
    if (inward || thick) add_box(text, foot, top, ALL_SIDES, 0);
    write_text(name, text);
}

/* Writes a scene with only a white box. */
static void white_obj(void) {
    write_text("white.mtl", "newmtl white\nKd .8 .8 .8\n");
    write_boxes("white.obj", ALL_SIDES, 0, 0, "mtllib white.mtl\nusemtl white\n");
}

/* Returns the luminance of a pixel of a picture. */
static double luminance(const picture *p, int x, int y) {
    return 0.2126 * at(p, x, y, 0) + 0.7152 * at(p, x, y, 1) + 0.0722 * at(p, x, y, 2);
}

#define STUDIO_SHOT "--size", "48x36", "--bounce-samples", "4096"

/* A white box without any light gets a studio: the ground is darker than the lit front of the box and receives its
   shadow. The ids of the file stay unchanged, and the ground has the next id. */
TEST(a_file_without_light_gets_a_studio) {
    picture final, id;
    int x, y, boxes = 0, grounds = 0, others = 0, black = 0, clipped = 0;
    double front = 0, darkest = 1e9, far, near, middle = 0, shadow = 0, shade = 0;
    white_obj();
    REQUIRE(TOOL("white.obj", STUDIO_SHOT, "-o", "white.pfm") == 0, "exit status %d: %s", ran.status, ran.err);
    CHECK(said("the file has no light") && said("a sun and a ground") && ran.err_lines == 1, "said: %s", ran.err);
    REQUIRE(TOOL("white.obj", STUDIO_SHOT, "--channel", "id", "--quiet", "-o", "id.pfm") == 0 && !ran.err[0],
            "exit status %d: %s", ran.status, ran.err);
    final = read_pfm("white.pfm");
    id = read_pfm("id.pfm");
    REQUIRE(final.values && id.values, "the pictures are not there");
    for (y = 0; y < 36; y++)
        for (x = 0; x < 48; x++) {
            const int which = (int)at(&id, x, y, 0);
            const double value = luminance(&final, x, y);
            boxes += which == 1;
            grounds += which == 2;
            others += which > 2 || (which == 0 && y > 18);
            black += value < 0.02;
            clipped += value > 1;
            if (which == 1 && value > front) front = value;
            if (which == 2 && value < darkest) darkest = value;
            middle += which == 1 ? x : 0;
        }
    far = luminance(&final, 1, 0);
    for (y = 0; y < 36; y++)
        for (x = 0; x < 48; x++) {
            const double missing = at(&id, x, y, 0) == 2 ? test_max(far - luminance(&final, x, y), 0) : 0;
            shade += missing;
            shadow += missing * x;
        }
    near = luminance(&final, 1, 34);
    CHECK(boxes > 300 && grounds > 300 && !others, "%d pixels show the box, %d the ground, %d others", boxes, grounds,
          others);
    CHECK(!black && !clipped && front > 2 * far, "%d pixels are black, %d too bright; front %g, background %g", black,
          clipped, front, far);
    CHECK(fabs(near / far - 1) < 0.06, "the ground has %g in front and %g far away", near, far);
    CHECK(darkest < 0.7 * far, "the shadow has %g, the background %g", darkest, far);
    CHECK(shadow / shade > middle / boxes + 2, "the sun is on the left, but the shadow of a box in column %g is in %g",
          middle / boxes, shadow / shade);
    free(final.values);
    free(id.values);
}

/* The edge of the ground is invisible against the sky, even if the ground does not fill the picture: for a low, distant
   eye, the edge is in the lower half of the picture. */
TEST(the_edge_of_the_ground_is_not_seen) {
    picture final, id;
    int y, edge = -1;
    white_obj();
    REQUIRE(TOOL("white.obj", STUDIO_SHOT, "--mode", "direct", "--eye", "-30,4,2", "--look-at", "-29,3.9,2", "--quiet",
                 "--samples", "1", "-o", "white.pfm") == 0, "exit status %d: %s", ran.status, ran.err);
    REQUIRE(TOOL("white.obj", STUDIO_SHOT, "--eye", "-30,4,2", "--look-at", "-29,3.9,2", "--quiet", "--channel", "id",
                 "-o", "id.pfm") == 0, "exit status %d: %s", ran.status, ran.err);
    final = read_pfm("white.pfm");
    id = read_pfm("id.pfm");
    REQUIRE(final.values && id.values, "the pictures are not there");
    for (y = 0; y + 1 < 36; y++)
        if ((at(&id, 10, y, 0) > 0) != (at(&id, 10, y + 1, 0) > 0)) {
            const double above = luminance(&final, 10, y), below = luminance(&final, 10, y + 1);
            CHECK(fabs(above / below - 1) < 0.03, "row %d: %g above the edge, %g below", y, above, below);
            edge = y;
        }
    CHECK(edge >= 0, "no edge of the ground is in the picture");
    free(final.values);
    free(id.values);
}

/* A file gets no studio with --sky, with --mode paper, or if it has lights; --studio replaces lights; a file with its
   own ground gets no second one; a room gets a lamp inside. */
TEST(who_gets_a_studio) {
    char floor_text[256];
    white_obj();
    room_obj();
    TOOL("white.obj", SMALL, "--size", "8x8", "--sky", "1,1,1", "-o", "none.pfm");
    CHECK(ran.status == 0 && !ran.err[0], "--sky: exit status %d: %s", ran.status, ran.err);
    TOOL("white.obj", SMALL, "--size", "8x8", "--mode", "paper", "-o", "none.pfm");
    CHECK(ran.status == 0 && said("a constant sky of 1,1,1"), "--mode paper: exit status %d: %s", ran.status, ran.err);
    TOOL("room.obj", SMALL, "--size", "8x8", "-o", "none.pfm");
    CHECK(ran.status == 0 && !ran.err[0], "a lamp: exit status %d: %s", ran.status, ran.err);
    TOOL("room.obj", SMALL, "--size", "8x8", "--studio", "--verbose", "-o", "none.pfm");
    CHECK(ran.status == 0 && said("light: a studio sky") && !said("has no light"), "--studio: exit status %d: %s",
          ran.status, ran.err);
    snprintf(floor_text, sizeof floor_text, "v -9 0 -9\nv -9 0 9\nv 9 0 9\nv 9 0 -9\nf 1 2 3 4\n");
    write_boxes("floored.obj", ALL_SIDES, 0, 0, floor_text);
    TOOL("floored.obj", SMALL, "--size", "8x8", "-o", "none.pfm");
    CHECK(ran.status == 0 && said("lit by a studio sky and a sun;"), "a floor: exit status %d: %s", ran.status,
          ran.err);
    write_boxes("closed.obj", ALL_SIDES, 1, 0, "");
    TOOL("closed.obj", SMALL, "--size", "8x8", "-o", "none.pfm");
    CHECK(ran.status == 0 && said("lit by a studio sky and a lamp inside;"), "a room: exit status %d: %s", ran.status,
          ran.err);
}

/* The chosen camera is inside rooms, in front of their open side, or in front of objects, and --verbose says which. An
   object seen from outside does not touch the border of the picture; a room fills the complete picture. */
TEST(the_camera_tells_rooms_from_objects) {
    static const struct { const char *name; int sides, inward, thick; const char *camera; } scenes[] = {
        { "closed.obj", ALL_SIDES, 1, 0, "camera: inside a room" },
        { "open.obj", WITHOUT_X, 1, 0, "camera: in front of the open side of a room" },
        { "topless.obj", WITHOUT_TOP, 1, 0, "camera: in front of an object" },
        { "solid.obj", ALL_SIDES, 0, 0, "camera: in front of an object" },
        { "hollow.obj", ALL_SIDES, 0, 1, "camera: in front of an object" } };
    int i, k;
    for (i = 0; i < 5; i++) {
        const int room = i < 2;
        int missed = 0, border = 0;
        picture depth;
        write_boxes(scenes[i].name, scenes[i].sides, scenes[i].inward, scenes[i].thick, "");
        TOOL(scenes[i].name, SMALL, "--size", "32x24", "--sky", "1,1,1", "--verbose", "--channel", "depth", "-o",
             "depth.pfm");
        CHECK(ran.status == 0 && said(scenes[i].camera), "%s: exit status %d: %s", scenes[i].name, ran.status, ran.err);
        depth = read_pfm("depth.pfm");
        for (k = 0; k < 32 * 24; k++) {
            const int x = k % 32, y = k / 32, seen = at(&depth, x, y, 0) > 0;
            missed += !seen;
            border += seen && (x == 0 || y == 0 || x == 31 || y == 23);
        }
        CHECK(room ? !missed : missed && !border, "%s: %d pixels show nothing, %d at the border show the scene",
              scenes[i].name, missed, border);
        free(depth.values);
    }
}

/* Walls modelled with two sides look like an object from outside. With a lamp inside, the outside is dark, and the
   camera is placed inside. */
TEST(a_lit_room_with_thick_walls_is_looked_at_from_inside) {
    write_text("lamp.mtl", "newmtl lamp\nKd 0 0 0\nKe 9 9 9\nnewmtl white\nKd .8 .8 .8\n");
    write_boxes("thick.obj", ALL_SIDES, 0, 1, "mtllib lamp.mtl\nusemtl lamp\nv 2 2.5 1\nv 3 2.5 1\nv 3 2.5 2\n"
                "v 2 2.5 2\nf -4 -3 -2 -1\nusemtl white\n");
    TOOL("thick.obj", SMALL, "--size", "16x12", "--verbose", "-o", "none.pfm");
    CHECK(ran.status == 0 && said("camera: inside a room"), "exit status %d: %s", ran.status, ran.err);
}

/* The Cornell box of the repository, rendered without options except the size, is seen through its open side. */
TEST(the_cornell_box_is_seen_from_its_open_side) {
    char scene[4096];
    picture final;
    int x, y, black = 0;
    if (!realpath("examples/scenes/cornell_box.obj", scene)) SKIP("not run in the repository's root");
    REQUIRE(TOOL(scene, "--size", "48x36", "-o", "box.pfm") == 0, "exit status %d: %s", ran.status, ran.err);
    final = read_pfm("box.pfm");
    REQUIRE(final.values, "the picture is not there");
    for (y = 0; y < 36; y++)
        for (x = 0; x < 48; x++) black += luminance(&final, x, y) < 0.001;
    CHECK(!black, "%d of 1728 pixels are black", black);
    CHECK(at(&final, 2, 18, 0) > 2 * at(&final, 2, 18, 1) && at(&final, 45, 18, 1) > 2 * at(&final, 45, 18, 0),
          "the left wall should be red, the right wall green");
    free(final.values);
}

/* >>outputs */

/* A .png holds the values of the .pfm with exposure and sRGB encoding applied. */
TEST(png_is_the_encoded_pfm) {
    picture p;
    unsigned char *png;
    int width = 0, height = 0, channels, i, bad = 0, bright = 0;
    room_obj();
    CHECK(TOOL(ROOM, "-o", "room.pfm") == 0 && !ran.err[0] && !ran.out[0], "exit status %d: %s", ran.status, ran.err);
    CHECK(TOOL(ROOM, "--tone", "none", "--exposure", "-1.5", "--output=room.png") == 0,
          "exit status %d: %s", ran.status, ran.err);
    p = read_pfm("room.pfm");
    png = stbi_load(in_folder("room.png"), &width, &height, &channels, 0);
    REQUIRE(p.values && png && p.width == 24 && p.height == 16 && width == 24 && height == 16 && channels == 3,
            "the pictures are not there");
    for (i = 0; i < 24 * 16 * 3; i++) {
        double exposed = (double)p.values[i] / pow(2, 1.5);
        bad += abs(encode_srgb(exposed) - png[i]) > 1;
        bright += exposed > 0.1;
    }
    CHECK(!bad && bright > 30, "%d of 1152 bytes differ, %d are bright", bad, bright);
    CHECK(at(&p, 12, 4, 1) > 5.9 || at(&p, 12, 3, 1) > 5.9, "the lamp should be in the upper half");
    CHECK(at(&p, 12, 14, 0) > at(&p, 12, 14, 2) && at(&p, 12, 14, 2) > 0, "the floor should be below, lit and reddish");
    stbi_image_free(png);
    free(p.values);
}

/* Eight channels can be written as .pfm and .png, and none has only one colour. */
TEST(every_channel_is_written) {
    static const char *const names[] = { "final", "radiance", "albedo", "normal", "position", "id", "depth",
        "sensors" };
    int i, k;
    room_obj();
    for (i = 0; i < 8; i++) {
        picture p;
        unsigned char *png;
        int width = 0, height = 0, channels, differing = 0, colors = 0;
        CHECK(TOOL(ROOM, "--channel", names[i], "-o", "channel.pfm") == 0, "%s: exit status %d: %s", names[i],
              ran.status, ran.err);
        CHECK(TOOL(ROOM, "--channel", names[i], "-o", "channel.png") == 0, "%s: exit status %d: %s", names[i],
              ran.status, ran.err);
        p = read_pfm("channel.pfm");
        png = stbi_load(in_folder("channel.png"), &width, &height, &channels, 0);
        REQUIRE(p.values && png && width == 24, "%s: the pictures are not there", names[i]);
        for (k = 0; k < 24 * 16; k++) {
            if (i >= 5) differing += p.values[3 * k] != p.values[3 * k + 1] || p.values[3 * k] != p.values[3 * k + 2];
            colors += memcmp(png, png + 3 * k, 3) != 0;
        }
        CHECK(!differing, "%s: a grey channel should have three equal components", names[i]);
        CHECK(colors > 0, "%s: the .png is of one colour", names[i]);
        if (i == 6) {  /* the nearest surface is white, and the farthest is still visible */
            double range[2] = { 1e30, 0 };
            int nearest = 0, farthest = 0;
            for (k = 0; k < 24 * 16; k++) {
                const double depth = (double)p.values[3 * k];
                if (depth > 0 && depth < range[0]) { range[0] = depth; nearest = png[3 * k]; }
                if (depth > range[1]) { range[1] = depth; farthest = png[3 * k]; }
            }
            CHECK(nearest == 255 && abs(farthest - 26) <= 1, "depths %g and %g are %d and %d", range[0], range[1],
                  nearest, farthest);
        }
        stbi_image_free(png);
        free(p.values);
    }
}

/* A build with OpenEXR writes .exr; a build without it refuses in one line. */
TEST(exr_is_written_or_refused) {
    unsigned char head[4] = { 0 };
    FILE *in;
    room_obj();
    TOOL(ROOM, "-o", "room.exr");
    if (ran.status == 1) {
        CHECK(strstr(ran.err, "OpenEXR") && ran.err_lines == 1 && !exists("room.exr"),
              "a build without OpenEXR should say so: %s", ran.err);
        return;
    }
    CHECK(ran.status == 0 && !ran.err[0], "exit status %d: %s", ran.status, ran.err);
    in = fopen(in_folder("room.exr"), "rb");
    REQUIRE(in && fread(head, 1, 4, in) == 4, "the picture is not there");
    fclose(in);
    CHECK(head[0] == 0x76 && head[1] == 0x2f && head[2] == 0x31 && head[3] == 0x01, "the file is no OpenEXR");
}

/* Reads the four numbers of a box2i attribute of an OpenEXR file. Returns 0 if it is missing. */
static int exr_box(const char *name, const char *attribute, int32_t box[4]) {
    unsigned char head[4096];
    FILE *in = fopen(in_folder(name), "rb");
    const size_t got = in ? fread(head, 1, sizeof head, in) : 0, length = strlen(attribute) + 1;
    size_t i;
    int k;
    if (in) fclose(in);
    for (i = 0; i + length + 26 < got; i++) {
        if (memcmp(head + i, attribute, length) || memcmp(head + i + length, "box2i", 6)) continue;
        for (k = 0; k < 4; k++) {
            const unsigned char *b = head + i + length + 10 + 4 * k;
            box[k] = (int32_t)(b[0] | (uint32_t)b[1] << 8 | (uint32_t)b[2] << 16 | (uint32_t)b[3] << 24);
        }
        return 1;
    }
    return 0;
}

/* Windows equal the same areas of the full picture, with its exposure and its mean; .exr files record their
   positions. */
TEST(windows_are_parts_of_the_picture) {
    static const struct { const char *option; int x, y; } parts[3] = { { "--window=0,0,9,7", 0, 0 },
        { "--window=9,4,9,7", 9, 4 }, { "--window=15,9,9,7", 15, 9 } };
    static const char *const channels[2] = { "position", "final" };
    char stats[8192];
    double means[4];
    int32_t box[4] = { 0, 0, 0, 0 };
    int i, k, lines;
    room_obj();
    for (k = 0; k < 2; k++) {
        const char *channel = channels[k];
        picture whole;
        CHECK(TOOL(ROOM, "--channel", channel, "-o", "whole.pfm", "--stats", "stats.json") == 0, "%s", ran.err);
        read_text(in_folder("stats.json"), stats, sizeof stats, &lines);
        means[3] = k ? strtod(strstr(stats, "\"mean\": [") + 9, NULL) : 0;
        whole = read_pfm("whole.pfm");
        REQUIRE(whole.values, "no picture");
        for (i = 0; i < 3; i++) {
            double off = 0, mean = 0;
            picture part;
            int n;
            CHECK(TOOL(ROOM, "--channel", channel, parts[i].option, "-o", "part.pfm", "--stats", "stats.json") == 0,
                  "%s", ran.err);
            read_text(in_folder("stats.json"), stats, sizeof stats, &lines);
            if (k) means[i] = strtod(strstr(stats, "\"mean\": [") + 9, NULL);
            part = read_pfm("part.pfm");
            CHECK(part.values && part.width == 9 && part.height == 7, "%s: a part of %d x %d pixels", channel,
                  part.width, part.height);
            if (!part.values || part.width != 9 || part.height != 7) continue;
            for (n = 0; n < 9 * 7 * 3; n++) {
                const double w = at(&whole, parts[i].x + n / 3 % 9, parts[i].y + n / 27, n % 3);
                off += fabs(at(&part, n / 3 % 9, n / 27, n % 3) - w) / (9 * 7 * 3);
                mean += fabs(w) / (9 * 7 * 3);
            }
            CHECK(off <= (k ? 0.06 : 0.001) * mean, "%s, part %d: differs by %g, mean %g", channel, i, off, mean);
            free(part.values);
        }
        free(whole.values);
    }
    CHECK(means[0] > 0 && !(means[0] < means[1]) && !(means[0] > means[1]) && fabs(means[2] / means[3] - 1) < 0.1,
          "means of parts %g %g %g, of the whole %g", means[0], means[1], means[2], means[3]);
    CHECK(TOOL(ROOM, "--window", "20,0,5,5", "-o", "part.pfm") == 2 && said("picture of 24 x 16"), "%s", ran.err);
    CHECK(TOOL(ROOM, "--window", "0,0,0,5", "-o", "part.pfm") == 2 && said("picture of 24 x 16"), "%s", ran.err);
    if (TOOL(ROOM, parts[1].option, "-o", "part.exr") == 1 && strstr(ran.err, "OpenEXR")) return;
    CHECK(exr_box("part.exr", "dataWindow", box) && box[0] == 9 && box[1] == 4 && box[2] == 17 && box[3] == 10,
          "data window %d %d %d %d", box[0], box[1], box[2], box[3]);
    CHECK(exr_box("part.exr", "displayWindow", box) && box[0] == 0 && box[1] == 0 && box[2] == 23 && box[3] == 15,
          "display window %d %d %d %d", box[0], box[1], box[2], box[3]);
    CHECK(TOOL(ROOM, "-o", "whole.exr") == 0 && exr_box("whole.exr", "dataWindow", box) && box[0] == 0 && box[1] == 0 &&
          box[2] == 23 && box[3] == 15, "data window of the whole %d %d %d %d", box[0], box[1], box[2], box[3]);
}

/* Returns the number after "key": in the text, or a negative number if the key is missing. */
static double json_number(const char *text, const char *key) {
    char quoted[64];
    const char *found;
    snprintf(quoted, sizeof quoted, "\"%s\":", key);
    found = strstr(text, quoted);
    return found ? strtod(found + strlen(quoted), NULL) : -1;
}

/* --stats writes every field, and the numbers are consistent. */
TEST(statistics_have_every_field) {
    static const char *const counts[] = { "triangles", "visible_pixels", "sensors", "sensor_views", "sensor_texels",
        "rays", "bounce_samples", "max_bounce_cells", "bounce_rays", "microseconds_per_sensor", "peak_gpu_bytes",
        "peak_host_bytes" };
    static const char *const seconds[] = { "load", "scene", "surface", "gather", "bounce", "refine", "filter",
        "resolve", "total" };
    char text[8192];
    const char *level;
    double sum = 0, parts = 0;
    int i, lines;
    room_obj();
    REQUIRE(TOOL(ROOM, "--mode", "direct", "--backend", "raster", "--sensor-size", "8", "--stats", "stats.json",
                 "--quiet", "-o", "room.pfm") == 0, "exit status %d: %s", ran.status,
            ran.err);
    read_text(in_folder("stats.json"), text, sizeof text, &lines);
    REQUIRE(text[0] == '{' && strstr(text, "}\n"), "it is no JSON object: %s", text);
    CHECK(strstr(text, "\"version\": \"") && strstr(text, "\"renderer\": \"") && strstr(text, "\"mode\": \"direct\"") &&
              strstr(text, "\"backend\": \"raster\"") && strstr(text, "\"size\": [24, 16]"),
          "a field is missing or wrong: %s", text);
    for (i = 0; i < 10; i++) CHECK(json_number(text, counts[i]) >= 0, "%s is missing", counts[i]);
    for (i = 0; i < 9; i++) {
        CHECK(json_number(text, seconds[i]) >= 0, "seconds.%s is missing", seconds[i]);
        if (i < 8) parts += json_number(text, seconds[i]);
    }
    CHECK(json_number(text, "triangles") == 6.0, "%g triangles", json_number(text, "triangles"));
    CHECK(json_number(text, "lights") == 0.0, "%g lights", json_number(text, "lights"));
    CHECK(json_number(text, "rays") == 0.0, "rays are counted, but the rasteriser was used");
    CHECK(json_number(text, "sensors") > 0 && json_number(text, "sensor_texels") >= json_number(text, "sensors") * 64,
          "%g sensors, %g texels", json_number(text, "sensors"), json_number(text, "sensor_texels"));
    for (level = strstr(text, "\"levels\""); level && (level = strstr(level, "{\"tile\"")) != NULL; level++)
        sum += json_number(level, "sensors");
    CHECK(sum == json_number(text, "sensors"), "the levels' sensors add up to %g of %g", sum,
          json_number(text, "sensors"));
    CHECK(json_number(text, "total") >= parts && json_number(text, "load") > 0,
          "the parts take %g s, the total is %g s",
          parts,
          json_number(text, "total"));
    CHECK(json_number(text, "peak_host_bytes") > 1e6 && json_number(text, "peak_gpu_bytes") > 1e5,
          "peak memory is %g and %g bytes",
          json_number(text, "peak_host_bytes"), json_number(text, "peak_gpu_bytes"));
    CHECK(!parts_left(), "%d temporary files are left", leftovers);
}

/* --backend trace casts the given number of rays per sensor; invalid combinations of options give exit status 2. */
TEST(rays_can_be_traced) {
    char text[8192];
    int lines;
    room_obj();
    REQUIRE(TOOL(ROOM, "--mode", "ambient", "--backend", "trace", "--rays", "33", "--tile", "1", "--stats",
                 "stats.json", "-o", "room.pfm") == 0,
            "exit status %d: %s", ran.status, ran.err);
    read_text(in_folder("stats.json"), text, sizeof text, &lines);
    CHECK(strstr(text, "\"backend\": \"trace\"") && json_number(text, "rays") == 33 * json_number(text, "sensors") &&
          json_number(text, "rays") > 0,
          "statistics: %s", text);
    CHECK(TOOL(ROOM, "--backend", "trace", "--mode", "paper") == 2 && strstr(ran.err, "--backend trace"),
          "the paper's mode: exit status %d: %s", ran.status, ran.err);
    CHECK(TOOL(ROOM, "--rays", "4097") == 2, "4097 rays: exit status %d: %s", ran.status, ran.err);
}

/* The default mode is gi: the room is brighter than with direct light alone. */
TEST(light_bounces_by_default) {
    picture all, direct;
    double sum[2] = { 0, 0 };
    char text[8192];
    int lines, i;
    room_obj();
    REQUIRE(TOOL(ROOM, "--bounce-samples", "2000", "--channel", "radiance", "--stats", "stats.json", "-o", "all.pfm") ==
            0,
            "exit status %d: %s", ran.status, ran.err);
    read_text(in_folder("stats.json"), text, sizeof text, &lines);
    CHECK(strstr(text, "\"mode\": \"gi\"") && json_number(text, "bounce") > 0 && json_number(text, "bounce_samples") >
          0 &&
          json_number(text, "bounce_samples") <= 2000 && (int)json_number(text, "max_bounce_cells") == 2000,
          "statistics: %s", text);
    TOOL(ROOM, "--mode", "direct", "--channel", "radiance", "-o", "direct.pfm");
    all = read_pfm("all.pfm");
    direct = read_pfm("direct.pfm");
    REQUIRE(all.values && direct.values, "a picture is missing");
    for (i = 0; i < 24 * 16 * 3; i++) { sum[0] += (double)all.values[i]; sum[1] += (double)direct.values[i]; }
    CHECK(sum[1] > 0 && sum[0] > 1.02 * sum[1], "R sums to %g, direct light to %g", sum[0], sum[1]);
    free(all.values);
    free(direct.values);
}

/* --store writes the bounced light to a file, and the next run loads it and gives the same picture to the bit. Other
   modes refuse --store, and it must not name the output file. */
TEST(bounced_light_is_kept) {
    picture made, loaded;
    char text[8192];
    int lines, i, same = 1;
    room_obj();
    REQUIRE(TOOL(ROOM, "--bounce-samples", "2000", "--channel", "radiance", "--store", "light.sbl", "-o", "made.pfm") ==
            0 &&
            exists("light.sbl"), "exit status %d: %s", ran.status, ran.err);
    REQUIRE(TOOL(ROOM, "--channel", "radiance", "--store", "light.sbl", "--stats", "stats.json", "-o", "loaded.pfm") ==
            0,
            "exit status %d: %s", ran.status, ran.err);
    read_text(in_folder("stats.json"), text, sizeof text, &lines);
    CHECK(json_number(text, "bounce") < 1e-3, "the bounced light was computed again: %s", text);
    made = read_pfm("made.pfm");
    loaded = read_pfm("loaded.pfm");
    REQUIRE(made.values && loaded.values, "a picture is missing");
    for (i = 0; i < 24 * 16 * 3; i++) same = same && fabs((double)made.values[i] - (double)loaded.values[i]) == 0;
    CHECK(same, "the picture differs");
    free(made.values);
    free(loaded.values);
    CHECK(TOOL(ROOM, "--mode", "direct", "--store", "light.sbl") == 2 && strstr(ran.err, "--store needs --mode gi"),
          "exit status %d: %s", ran.status, ran.err);
    CHECK(TOOL(ROOM, "--store", "made.pfm", "-o", "made.pfm") == 2, "one file for both: exit status %d: %s", ran.status,
          ran.err);
}

/* Returns 1 if two files have the same bytes. */
static int same_bytes(const char *a, const char *b) {
    FILE *in[2];
    int x = 0, y = 0;
    in[0] = fopen(in_folder(a), "rb");
    in[1] = fopen(in_folder(b), "rb");
    while (in[0] && in[1] && x == y && x != EOF) { x = fgetc(in[0]); y = fgetc(in[1]); }
    if (in[0]) fclose(in[0]);
    if (in[1]) fclose(in[1]);
    return in[0] && in[1] && x == y;
}

/* Copies the first bytes of light.sbl to another file. */
static void copy_store(const char *name, size_t bytes) {
    static char data[1 << 20];
    FILE *in = fopen(in_folder("light.sbl"), "rb");
    const size_t n = in ? fread(data, 1, sizeof data, in) : 0;
    if (in) fclose(in);
    write_file(name, data, n < bytes ? n : bytes);
}

#define RED_ROOM ROOM, "--sky", "1,0,0"
#define REFUSED(words, ...) \
    CHECK(TOOL(RED_ROOM, "-o", "refused.pfm", __VA_ARGS__) == 1 && ran.err_lines == 1 && said(words) && \
          !exists("refused.pfm"), "%s: exit status %d: %s", words, ran.status, ran.err)

/* A file of --store with other light is refused before the work, or replaced with --store-replace. A file that does not
   hold stored light is never replaced. */
TEST(stores_are_not_overwritten) {
    static const char *const not_files[] = { "store.pipe", "/dev/zero", "/dev/null", "/dev/stdout", "sub" };
    const char *data = "not light";
    int i;
    room_obj();
    REQUIRE(TOOL(ROOM, "--store", "light.sbl", "-o", "made.pfm") == 0 && ran.err_lines == 0, "exit status %d: %s",
            ran.status, ran.err);
    copy_store("old.sbl", SIZE_MAX);
    copy_store("cut.sbl", 3000);
    REFUSED("light.sbl: the light was stored for a scene with another sky; --store-replace", "--store", "light.sbl");
    CHECK(same_bytes("light.sbl", "old.sbl"), "the store of another scene is not as it was");
    for (i = 0; i < 3; i++) {
        write_text("notes.txt", data + 9 * (i == 2));
        if (i < 2) {
            const char *option = i ? "--store-replace" : "--quiet";
            REFUSED("notes.txt: the data are not stored light", "--store", "notes.txt", option);
            REFUSED("cut.sbl: the stored light is damaged: it ends too soon; such a file is never", "--store",
                    "cut.sbl", option);
        } else CHECK(TOOL(RED_ROOM, "--store", "notes.txt", "-o", "made.pfm") == 0 && ran.err_lines == 0,
                     "an empty file: exit status %d: %s", ran.status, ran.err);
    }
    REFUSED("the data are not stored light", "--store", "made.pfm", "--store-replace");
    mkfifo(in_folder("store.pipe"), 0666);
    mkdir(in_folder("sub"), 0777);
    for (i = 0; i < 5; i++)
        REFUSED(i < 4 ? "a pipe or a device, not a file" : "Is a directory", "--store", not_files[i]);
    CHECK(TOOL(RED_ROOM, "--store", "light.sbl", "--store-replace", "-o", "made.pfm") == 0 && ran.err_lines == 1 &&
          said("another sky; new light will replace it"), "exit status %d: %s", ran.status, ran.err);
    CHECK(!same_bytes("light.sbl", "old.sbl") && same_bytes("light.sbl", "notes.txt"), "the store is not the new one");
    CHECK(TOOL(RED_ROOM, "--store", "light.sbl", "--store-replace", "-o", "made.pfm") == 0 && ran.err_lines == 0,
          "light that fits: exit status %d: %s", ran.status, ran.err);
    CHECK(TOOL(ROOM, "--store-replace", "-o", "refused.pfm") == 2 && said("needs --store"), "exit status %d: %s",
          ran.status, ran.err);
}

/* A channel that shows only surfaces needs no stored light, unless --store asks for it. */
TEST(surfaces_need_no_light) {
    char text[8192];
    int i, lines;
    room_obj();
    remove(in_folder("light.sbl"));
    for (i = 0; i < 2; i++) {
        CHECK(TOOL(ROOM, "--channel", "normal", "--stats", "stats.json", "-o", "normal.pfm", i ? "--store" : "--quiet",
                   i ? "light.sbl" : "--tile=16") == 0, "exit status %d: %s", ran.status, ran.err);
        read_text(in_folder("stats.json"), text, sizeof text, &lines);
        CHECK((json_number(text, "bounce_samples") > 0) == i && exists("light.sbl") == i, "%s", text);
    }
}

/* A store in a folder where no file can be created is loaded, but not replaced. The path of the folder is so long that
   the name of a temporary file would be too long. Unlike a missing write permission, this also stops root. */
TEST(stores_in_closed_folders) {
    char path[PATH_MAX], whole[PATH_MAX], data[4096];
    size_t length, bytes;
    FILE *in, *out;
    room_obj();
    remove(in_folder("light.sbl"));
    REQUIRE(TOOL(ROOM, "--store", "light.sbl", "-o", "made.pfm") == 0 && realpath(in_folder("."), path), "%s", ran.err);
    while ((length = strlen(path)) < PATH_MAX - 24) {  /* leaves 20 characters: enough for l.sbl, too few for 24 */
        size_t more = PATH_MAX - 22 - length;
        if (more > 200) more = more > 300 ? 200 : 100;
        memset(path + length, 'd', more);
        path[length] = '/';
        path[length + more] = 0;
        mkdir(path, 0777);
    }
    snprintf(whole, sizeof whole, "%.*s/l.sbl", PATH_MAX - 8, path);
    in = fopen(in_folder("light.sbl"), "rb");
    out = fopen(whole, "wb");
    while (in && out && (bytes = fread(data, 1, sizeof data, in)) > 0) fwrite(data, 1, bytes, out);
    if (in) fclose(in);
    REQUIRE(out && fclose(out) == 0 && symlink(whole, in_folder("far.sbl")) == 0, "%s", strerror(errno));
    CHECK(TOOL(ROOM, "--store", "far.sbl", "-o", "made.pfm") == 0 && !ran.err[0], "exit status %d: %s", ran.status,
          ran.err);
    CHECK(TOOL(ROOM, "--store", "far.sbl", "--store-replace", "-o", "made.pfm") == 1 && said("cannot be written"),
          "exit status %d: %s", ran.status, ran.err);
}

/* A store with fewer cells than are now allowed is used with a warning, or rebuilt with --store-replace. */
TEST(coarse_stores) {
    char text[8192];
    int i, lines;
    room_obj();
    remove(in_folder("light.sbl"));
    REQUIRE(TOOL(ROOM, "--store", "light.sbl", "-o", "made.pfm") == 0, "exit status %d: %s", ran.status, ran.err);
    copy_store("old.sbl", SIZE_MAX);
    for (i = 0; i < 3; i++) {
        CHECK(TOOL(ROOM, "--max-bounce-cells", "2000", "--store", "light.sbl", "--stats", "stats.json", "-o",
                   "made.pfm", i == 1 ? "--store-replace" : "--tile=16") == 0 && ran.err_lines == (i < 2),
              "run %d: exit status %d: %s", i, ran.status, ran.err);
        read_text(in_folder("stats.json"), text, sizeof text, &lines);
        CHECK((json_number(text, "bounce_rays") > 0) == (i == 1), "run %d: %s", i, text);
        CHECK(same_bytes("light.sbl", "old.sbl") == (i == 0), "run %d", i);
        CHECK(i > 1 || said(i ? "2000, which would be finer; new light" : "1024 cells, and this scene may have 2000"),
              "run %d: %s", i, ran.err);
    }
}

/* The old store remains when its replacement fails, because of a signal just before it or a full disk. Files that
   another program has written meanwhile remain, too. */
TEST(stores_are_never_lost) {
    static const char *const arguments[] = { RED_ROOM, "--store", "light.sbl", "--store-replace", "--stats",
        "stats.pipe", "-o", "made.pfm", NULL };
    int i, stats;
    room_obj();
    remove(in_folder("light.sbl"));
    REQUIRE(TOOL(ROOM, "--store", "light.sbl", "-o", "made.pfm") == 0, "exit status %d: %s", ran.status, ran.err);
    copy_store("old.sbl", SIZE_MAX);
    finish(start((const char *const[]){ RED_ROOM, "--store", "light.sbl", "--store-replace", "-o", "made.pfm", NULL },
                 -1, 20000));
    CHECK(ran.status == 1 && said("light.sbl: cannot be written: File too large") && !parts_left() &&
          same_bytes("light.sbl", "old.sbl"), "a full disk: exit status %d: %s", ran.status, ran.err);
    mkfifo(in_folder("stats.pipe"), 0666);
    for (i = 0; i < 2; i++) {  /* the tool waits at the statistics, after the picture and before the store */
        char text[4096];
        pid_t child;
        int wait;
        remove(in_folder("made.pfm"));
        child = start(arguments, -1, 0);
        for (wait = 0; wait < 60000 && !exists("made.pfm"); wait++) poll(NULL, 0, 10);
        if (i) write_text("light.sbl", "written by another program");
        else kill(child, SIGTERM);
        stats = open(in_folder("stats.pipe"), i ? O_RDONLY : O_RDONLY | O_NONBLOCK);
        while (read(stats, text, sizeof text) > 0) continue;
        finish(child);
        close(stats);
        CHECK(ran.status == (i ? 0 : 143) && said(i ? "another program has written it" : "made.pfm is written, ") &&
              !parts_left(), "run %d: exit status %d: %s", i, ran.status, ran.err);
        if (!i) CHECK(same_bytes("light.sbl", "old.sbl"), "after a signal the old store is not as it was");
    }
    write_text("old.sbl", "written by another program");
    CHECK(same_bytes("light.sbl", "old.sbl"), "what another program has written is replaced");
}

/* The sums that --inspect prints agree: the weights add up to 1, and R is the sum of the sheet and the lamps. The light
   of the only lamp has the colour of the lamp. */
static void inspect_with(const char *backend, const char *seen) {
    double sum[3], r[3], lamps[3], weights;
    const char *line;
    int k, arrive, rays;
    CHECK(TOOL(ROOM, "--mode", "ambient", "--backend", backend, "--inspect", "12,14", "--tile", "1", "-o",
               "sheet.png") == 0, "exit status %d: %s",
          ran.status, ran.err);
    CHECK(exists("sheet.png"), "the picture is not there");
    line = strstr(ran.out, "\nR ");
    REQUIRE(line && sscanf(line, "\nR %lf %lf %lf", &r[0], &r[1], &r[2]) == 3, "R is missing: %s", ran.out);
    line = strstr(ran.out, "over the sheet ");
    REQUIRE(line && sscanf(line, "over the sheet %lf %lf %lf", &sum[0], &sum[1], &sum[2]) == 3,
            "the sum is missing: %s", ran.out);
    line = strstr(ran.out, "\nfrom lamps ");
    REQUIRE(line && sscanf(line, "\nfrom lamps %lf %lf %lf", &lamps[0], &lamps[1], &lamps[2]) == 3,
            "the lamps are missing: %s", ran.out);
    line = strstr(ran.out, "sum of weights ");
    REQUIRE(line && sscanf(line, "sum of weights %lf", &weights) == 1, "the weights are missing: %s", ran.out);
    CHECK(fabs(weights - 1) < 1e-4, "the weights sum to %g", weights);
    for (k = 0; k < 3; k++)
        CHECK(sum[k] > 0 && lamps[k] > 0 && fabs(r[k] - sum[k] - lamps[k]) < 1e-3 * r[k],
              "R is %g, the sheet's sum %g, R from lamps %g", r[k],
              sum[k], lamps[k]);
    CHECK(fabs(lamps[2] / lamps[0] - 7.0 / 5) < 0.02, "R from lamps is %g %g %g", lamps[0], lamps[1], lamps[2]);
    line = strstr(ran.out, "  triangle ");
    REQUIRE(line && (line = strstr(line, ", ")) && sscanf(line, ", %d of %d rays", &arrive, &rays) == 2,
            "no lamp is listed: %s", ran.out);
    CHECK(rays > 0 && arrive >= 0 && arrive <= rays, "%d of %d rays", arrive, rays);
    CHECK(strstr(ran.out, seen), "no %s: %s", seen, ran.out);
}

/* --inspect prints a sensor with both back ends, and refuses pixels outside of the picture. */
TEST(a_sensor_can_be_inspected) {
    room_obj();
    inspect_with("trace", " 32 rays\n");
    inspect_with("raster", " 5 views, 128 x 96 texels\n");
    CHECK(TOOL(ROOM, "--inspect", "24,0", "-o", "outside.png") == 1 && ran.err_lines == 1 && !exists("outside.png"),
          "a pixel outside of the picture: exit status %d: %s", ran.status, ran.err);
}

/* In sbl.h a zero means the default; on the command line a zero means zero. A number that is 0 as a float counts as
   zero. */
TEST(zero_options_mean_zero) {
    picture direct, dark, glow, raw, smooth;
    char text[8192];
    double all, usual;
    int lines;
    room_obj();
    TOOL(ROOM, "--mode", "direct", "-o", "direct.pfm");
    TOOL(ROOM, "--mode", "ambient", "--epsilon", "1e-60", "-o", "dark.pfm");
    TOOL(ROOM, "--mode", "ambient", "--epsilon", "0.5", "--channel", "radiance", "-o", "glow.pfm");
    TOOL(ROOM, "--mode", "direct", "--filter-radius", "0", "--channel", "radiance", "-o", "raw.pfm");
    TOOL(ROOM, "--mode", "direct", "--channel", "radiance", "-o", "smooth.pfm");
    TOOL(ROOM, "--mode", "direct", "--size", "96x64", "--threshold", "0", "-o", "all.pfm",
         "--stats", "stats.json");
    read_text(in_folder("stats.json"), text, sizeof text, &lines);
    all = json_number(text, "sensors");
    TOOL(ROOM, "--mode", "direct", "--size", "96x64", "-o", "usual.pfm", "--stats",
         "stats.json");
    read_text(in_folder("stats.json"), text, sizeof text, &lines);
    usual = json_number(text, "sensors");
    direct = read_pfm("direct.pfm"); dark = read_pfm("dark.pfm"); glow = read_pfm("glow.pfm");
    raw = read_pfm("raw.pfm"); smooth = read_pfm("smooth.pfm");
    REQUIRE(direct.values && dark.values && glow.values && raw.values && smooth.values, "a picture is not there");
    CHECK(memcmp(direct.values, dark.values, 24 * 16 * 3 * sizeof(float)) == 0,
          "ambient light with epsilon 1e-60 should be direct light");
    CHECK(memcmp(smooth.values, glow.values, 24 * 16 * 3 * sizeof(float)) != 0, "epsilon makes no difference");
    CHECK(memcmp(raw.values, smooth.values, 24 * 16 * 3 * sizeof(float)) != 0,
          "filter radius 0 should not be the default");
    CHECK(usual > 0 && all > 1.1 * usual, "threshold 0 should not be the default: %g sensors, and %g by default", all,
          usual);
    free(direct.values); free(dark.values); free(glow.values); free(raw.values); free(smooth.values);
}

/* --facet-limit 0 keeps the normals of the file. The scene is a wall of triangles smaller than a pixel with tilted
   normals, so that the default limit replaces them by facet normals. */
TEST(facet_limit_zero_is_zero) {
    char text[16384] = "vn 1 0.5 0\n";
    picture usual, none;
    int i, k;
    for (i = 0; i <= 16; i++)
        for (k = 0; k <= 16; k++) sprintf(text + strlen(text), "v 0 %g %g\n", i / 8.0 - 1, 1 - k / 8.0);
    for (i = 0; i < 16; i++)
        for (k = 0; k < 16; k++)
            sprintf(text + strlen(text), "f %d//1 %d//1 %d//1\n", 17 * i + k + 1, 17 * i + k + 2, 17 * i + k + 18);
    write_text("fine.obj", text);
#define FINE "fine.obj", "--eye", "9,0,0", "--look-at", "0,0,0", "--fov", "5", "--size", "8x8", "--mode", "direct", \
             "--quiet", "--channel", "normal"
    TOOL(FINE, "-o", "usual.pfm");
    TOOL(FINE, "--facet-limit", "0", "-o", "none.pfm");
    usual = read_pfm("usual.pfm");
    none = read_pfm("none.pfm");
    REQUIRE(usual.values && none.values, "a picture is not there: %s", ran.err);
    for (i = k = 0; i < 8 * 8; i++) {
        if (usual.values[3 * i] == 0) continue;  /* half of the wall is missing */
        CHECK(fabs((double)usual.values[3 * i] - 1) < 1e-5, "pixel %d: with the default limit a small facet has the "
              "file's normal",
              i);
        CHECK(fabs((double)none.values[3 * i] - sqrt(0.8)) < 1e-5, "pixel %d: --facet-limit 0 is not 0", i);
        k++;
    }
    CHECK(k >= 20, "only %d pixels show the wall", k);
    free(usual.values);
    free(none.values);
}

/* Former names of options still work. */
TEST(old_names_of_options) {
    static const char *const names[2] = { "--target-error", "--error" }, *const cells[2] = { "--max-bounce-cells=1500",
                                                                                            "--bounce-samples=1500" };
    picture shown[2];
    int i;
    room_obj();
    for (i = 0; i < 2; i++) {
        TOOL(ROOM, names[i], "20%", cells[i], "-o", "named.pfm", "--stats", "stats.json");
        CHECK(ran.status == 0, "%s: exit status %d: %s", names[i], ran.status, ran.err);
        shown[i] = read_pfm("named.pfm");
        CHECK(TOOL(ROOM, names[i], "7") == 2 && said(i ? " --error 7" : "--target-error 7"), "the message does not "
              "name the option %s: %s", names[i], ran.err);
        CHECK(TOOL(ROOM, names[i]) == 2 && said(i ? " --error needs" : "--target-error needs"),
              "%s without a value: %s", names[i], ran.err);
    }
    REQUIRE(shown[0].values && shown[1].values, "a picture is not there");
    CHECK(memcmp(shown[0].values, shown[1].values, 24 * 16 * 3 * sizeof(float)) == 0,
          "the former name gives another picture");
    free(shown[0].values);
    free(shown[1].values);
    CHECK(TOOL("--help", "all") == 0 && strstr(ran.out, "\n  --target-error E, --error E\n     ") &&
              strstr(ran.out, "\n  --max-bounce-cells N, --bounce-samples N\n     "),
          "--help all does not show both names in one line");
}

/* >>lights: R of every pixel is compared with the closed form at the position of the pixel. EXACT: one sensor per
   pixel, no filter */

#define EXACT "--mode", "direct", "--tile", "1", "--filter-radius", "0", "--size", "48x36", "--quiet", "--samples", "1"

static double dot(const double a[3], const double b[3]) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

/* Returns R per unit of intensity of a point light at (x, y, z), at the point p of the ground (y is up): cos / (pi
   d^2). */
static double lamp_at(double x, double y, double z, const double p[3]) {
    double d2 = (x - p[0]) * (x - p[0]) + (y - p[1]) * (y - p[1]) + (z - p[2]) * (z - p[2]);
    return (y - p[1]) / sqrt(d2) / (acos(-1.0) * d2);
}

/* Returns the same as lamp_at for a spot light. It has full intensity inside the inner angle and none outside the outer
   angle. Both angles are measured from the axis, in radians. */
static double spot_at(double x, double y, double z, const double axis[3], double inner, double outer,
                      const double p[3]) {
    const double to[3] = { p[0] - x, p[1] - y, p[2] - z };
    double share = (dot(to, axis) / sqrt(dot(to, to) * dot(axis, axis)) - cos(outer)) / (cos(inner) - cos(outer));
    share = share < 0 ? 0 : share > 1 ? 1 : share;
    return share * share * lamp_at(x, y, z, p);
}

/* Returns 1 if the segment from p to p + way hits the box of scenes/lights.gltf, enlarged by `more` on all sides. */
static int meets_box(const double p[3], const double way[3], double more) {
    const double low[3] = { -0.5 - more, 0 - more, -0.5 - more }, high[3] = { 0.5 + more, 1 + more, 0.5 + more };
    double from = 0, to = 1;
    int i;
    for (i = 0; i < 3; i++) {
        double a = (low[i] - p[i]) / way[i], b = (high[i] - p[i]) / way[i];
        from = fmax(from, fmin(a, b));
        to = fmin(to, fmax(a, b));
    }
    return from < to;
}

/* Renders positions and R of a scene, seen from the camera of its file or from above. Returns 0 on failure. */
static int shoot(const char *scene, int own_camera, picture *position, picture *radiance) {
    int i;
    for (i = 0; i < 2; i++) {
        picture *p = i ? radiance : position;
        const char *const channel = i ? "radiance" : "position";
        if (own_camera) TOOL(scene, EXACT, "--channel", channel, "-o", "shot.pfm", "--stats", "shot.json");
        else TOOL(scene, EXACT, "--eye", "0,6,0", "--look-at", "0,0,0", "--up", "0,0,-1", "--fov", "60", "--channel",
                  channel, "-o", "shot.pfm", "--stats", "shot.json");
        *p = read_pfm("shot.pfm");
        CHECK(ran.status == 0 && p->values, "%s: exit status %d: %s", scene, ran.status, ran.err);
        if (!p->values) return 0;
    }
    return 1;
}

static double light_count(void) {
    char text[8192];
    int lines;
    read_text(in_folder("shot.json"), text, sizeof text, &lines);
    return json_number(text, "lights");
}

/* Compares all components of every pixel that shows the ground. */
static void check_ground(const picture *position, const picture *radiance,
                         void (*expected)(const double p[3], double r[3]), const char *what) {
    int x, y, k, bad = 0, pixels = 0, lit = 0;
    for (y = 0; y < position->height; y++)
        for (x = 0; x < position->width; x++) {
            double p[3], r[3] = { 0, 0, 0 };
            for (k = 0; k < 3; k++) p[k] = at(position, x, y, k);
            if ((p[0] == 0.0 && p[2] == 0.0) || fabs(p[1]) > 1e-3) continue;
            expected(p, r);
            for (k = 0; k < 3; k++) {
                double value = at(radiance, x, y, k);
                if (r[k] != r[k]) continue;  /* at the edge of a shadow */
                pixels++;
                lit += r[k] > 0.01;
                if (!(fabs(value - r[k]) <= 0.002 * r[k] + 1e-5) && bad++ < 3)
                    CHECK(0, "%s: %g %g %g component %d: R is %g, expected %g", what, p[0], p[1], p[2], k, value, r[k]);
            }
        }
    CHECK(!bad && pixels > 1000 && lit > 100, "%s: %d of %d values are wrong, %d should be lit", what, bad, pixels,
          lit);
}

static void three_primaries(const double p[3], double r[3]) {
    static const double axis[3] = { 0, -0.8660254, -0.5 };
    const double to[3][3] = { { -1.5 - p[0], 2 - p[1], 1 - p[2] }, { 0.8 - p[0], 3 - p[1], 2.2 - p[2] },
        { 6.1237244, 7.0710678, 3.5355339 } };
    int k;
    r[0] = 9 * lamp_at(-1.5, 2, 1, p);
    r[1] = 16 * spot_at(0.8, 3, 2.2, axis, 0.3, 0.5, p);
    r[2] = 2 * sqrt(0.5) / acos(-1.0);
    for (k = 0; k < 3; k++) {
        if (meets_box(p, to[k], -0.01)) r[k] = 0;
        else if (meets_box(p, to[k], 0.01)) r[k] = NAN;
    }
}
/* Point, spot and sun of a glTF scene have the closed forms of their light and shadows. */
TEST(lights_of_a_gltf_scene) {
    picture position, radiance;
    char scene[4096];
    if (!realpath("examples/scenes/lights.gltf", scene)) SKIP("not run in the repository's root");
    REQUIRE(shoot(scene, 1, &position, &radiance), "the pictures are not there");
    CHECK(light_count() == 3.0, "%g lights", light_count());
    check_ground(&position, &radiance, three_primaries, "point, spot and sun");
    free(position.values);
    free(radiance.values);
}

static const char *generator = "test_cli";  /* asset.generator of the next file */

/* Writes a scene with a ground of 8 by 8, the given lights, and the given nodes that use them, numbered from 1. */
static void lamps_gltf(const char *lights, int node_count, const char *nodes) {
    static char json[8192];
    const float corners[12] = { -4, 0, -4, -4, 0, 4, 4, 0, 4, 4, 0, -4 };
    const unsigned short indices[6] = { 0, 1, 2, 0, 2, 3 };
    unsigned char buffer[60];
    int i, n;
    memcpy(buffer, corners, 48);
    memcpy(buffer + 48, indices, 12);
    write_file("ground.bin", buffer, sizeof buffer);
    n = sprintf(json, "{\"asset\":{\"version\":\"2.0\",\"generator\":\"%s\"},"
                "\"extensionsUsed\":[\"KHR_lights_punctual\"],"
                "\"extensions\":{\"KHR_lights_punctual\":{\"lights\":[%s]}},"
                      "\"scene\":0,\"scenes\":[{\"nodes\":[0", generator, lights);
    for (i = 1; i <= node_count; i++) n += sprintf(json + n, ",%d", i);
    n += sprintf(json + n, "]}],\"nodes\":[{\"mesh\":0}%s],"
                 "\"meshes\":[{\"primitives\":[{\"attributes\":{\"POSITION\":0},\"indices\":1}]}],"
                 "\"accessors\":[{\"bufferView\":0,\"componentType\":5126,\"count\":4,\"type\":\"VEC3\",\"min\":[-4,0,"
                     "-4],\"max\":[4,0,4]},"
                 "{\"bufferView\":1,\"componentType\":5123,\"count\":6,\"type\":\"SCALAR\"}],"
                 "\"bufferViews\":[{\"buffer\":0,\"byteLength\":48},{\"buffer\":0,\"byteOffset\":48,\"byteLength\":12}"
                     "],"
                 "\"buffers\":[{\"byteLength\":60,\"uri\":\"ground.bin\"}]}", nodes);
    write_file("lamps.gltf", json, (size_t)n);
}
#define LIGHT(n) "\"extensions\":{\"KHR_lights_punctual\":{\"light\":" #n "}}"

static void check_lamps(const char *scene, int lights, void (*expected)(const double p[3], double r[3]),
                        const char *what) {
    picture position, radiance;
    if (!shoot(scene, 0, &position, &radiance)) return;
    CHECK(light_count() == lights, "%s: %g lights, expected %d", what, light_count(), lights);
    check_ground(&position, &radiance, expected, what);
    free(position.values);
    free(radiance.values);
}

static void four_lamps(const double p[3], double r[3]) {
    int k;
    for (k = 0; k < 3; k++)
        r[k] = (8 >> k) * (lamp_at(1, 1, 0, p) + lamp_at(-2, 2, 1, p) + lamp_at(0, 1.5, -2, p)) + 3 *
            lamp_at(2, 1, 2, p);
}
/* A glTF light that three nodes use shines at all three. */
TEST(a_light_of_many_nodes) {
    lamps_gltf("{\"type\":\"point\",\"intensity\":8,\"color\":[1,0.5,0.25],\"range\":1.5},{\"type\":\"point\","
               "\"intensity\":3}", 3,
               ",{\"name\":\"lamp\",\"translation\":[1,1,0]," LIGHT(0) "},{\"name\":\"lamp\",\"translation\":[-2,2,1],"
                   "" LIGHT(0) "},"
               "{\"translation\":[2,1,2]," LIGHT(1) ",\"children\":[4]},{\"name\":\"lamp\",\"translation\":[-2,0.5,-4],"
                   "" LIGHT(0) "}");
    check_lamps("lamps.gltf", 4, four_lamps, "a light of three nodes of one name, and another");
}

static void three_spots(const double p[3], double r[3]) {
    static const double down[3] = { 0, -1, 0 }, aslant[3] = { 1, -1, 0 };
    int k;
    r[0] = 10 * spot_at(0, 2, 0, down, 0, acos(-1.0) / 4, p);  /* the default cone angles */
    r[1] = 10 * spot_at(-2, 2, 0, aslant, 0.2, 0.6, p);
    r[2] = 10 * spot_at(0, 1, 1, down, 0, acos(-1.0) / 2, p);
    for (k = 0; k < 3; k++) r[k] += 0.001;
}
/* Spots shine along -z of their node, whatever its scale. A weak directional light is moved by two parents. */
TEST(spots_of_gltf) {
    char lights[1024];
    snprintf(lights, sizeof lights, "{\"type\":\"spot\",\"intensity\":10,\"color\":[1,0,0],\"spot\":{}},"
             "{\"type\":\"spot\",\"intensity\":10,\"color\":[0,1,0],\"spot\":{\"innerConeAngle\":0.2,"
                 "\"outerConeAngle\":0.6}},"
             "{\"type\":\"spot\",\"intensity\":10,\"color\":[0,0,1],\"spot\":{\"outerConeAngle\":1.5707963267948966}},"
             "{\"type\":\"directional\",\"intensity\":%.9g}", 0.001 * acos(-1.0));
    /* One node is rotated by -90 degrees about x, to point down. Another is rotated by -90 degrees about y, which turns
       -z to +x, and then by -45 degrees about z. */
    lamps_gltf(lights, 3, ",{\"translation\":[0,2,0],\"rotation\":[-0.70710678,0,0,0.70710678]," LIGHT(0) "},"
               "{\"translation\":[0,1,1],\"rotation\":[-0.70710678,0,0,0.70710678],\"scale\":[3,3,0.01]," LIGHT(2) "},"
               "{\"translation\":[-2,2,0],\"rotation\":[0,0,-0.38268343,0.92387953],\"scale\":[2,2,2],\"children\":[4]"
                   "},"
               "{\"rotation\":[0,-0.70710678,0,0.70710678]," LIGHT(1) ",\"children\":[5]},"
               "{\"matrix\":[1,0,0,0,0,0.70710678,-0.70710678,0,0,0.70710678,0.70710678,0,0,0,0,1]," LIGHT(3) "}");
    check_lamps("lamps.gltf", 4, three_spots, "spots");
}

/* In COLLADA, spot angles are full angles, and colours are intensities. */
static void collada_lamps(const double p[3], double r[3]) {
    static const double down[3] = { 0, -1, 0 };
    r[0] = 10 * lamp_at(1, 2, 1, p);
    r[1] = 8 * spot_at(0, 2, 0, down, acos(-1.0) / 6, acos(-1.0) / 4.5, p);
    r[2] = 3 / acos(-1.0);
}
/* Writes lamps.dae: a ground with lamps of all kinds, and a camera with a horizontal field of view of 90 degrees. */
static void lamps_dae(void) {
    write_text("lamps.dae", "<?xml version=\"1.0\"?><COLLADA xmlns=\"http://www.collada.org/2005/11/COLLADASchema\" "
               "version=\"1.4.1\"><asset><up_axis>Y_UP</up_axis></asset>"
               "<library_cameras><camera id=\"e\" name=\"e\"><optics><technique_common><perspective><xfov>90</xfov>"
                   "<znear>0.1</znear><zfar>9</zfar></perspective></technique_common></optics></camera>"
                   "</library_cameras>"
               "<library_lights><light id=\"a\"><technique_common><point><color>10 0 "
                   "0</color><quadratic_attenuation>0.1</quadratic_attenuation></point></technique_common></light>"
               "<light id=\"b\"><technique_common><spot><color>0 8 "
                   "0</color><falloff_angle>60</falloff_angle></spot></technique_common>"
               "<extra><technique "
                   "profile=\"MAX3D\"><max_light>"
                   "<decay_falloff>80</decay_falloff></max_light></technique></extra></light>"
               "<light id=\"c\"><technique_common><directional><color>0 0 "
                   "3</color></directional></technique_common></light>"
               "<light id=\"d\"><technique_common><ambient><color>1 1 "
                   "1</color></ambient></technique_common></light></library_lights>"
               "<library_geometries><geometry id=\"g\"><mesh><source id=\"p\"><float_array id=\"f\" count=\"12\">-4 0 "
                   "-4 -4 0 4 4 0 4 4 0 -4</float_array>"
               "<technique_common><accessor source=\"#f\" count=\"4\" stride=\"3\"><param name=\"X\" "
                   "type=\"float\"/><param name=\"Y\" type=\"float\"/>"
               "<param name=\"Z\" type=\"float\"/></accessor></technique_common></source><vertices id=\"v\"><input "
                   "semantic=\"POSITION\" source=\"#p\"/></vertices>"
               "<triangles count=\"2\"><input semantic=\"VERTEX\" source=\"#v\" offset=\"0\"/><p>0 1 2 0 2 "
                   "3</p></triangles></mesh></geometry></library_geometries>"
               "<library_visual_scenes><visual_scene id=\"s\"><node id=\"ground\"><instance_geometry "
                   "url=\"#g\"/></node>"
               "<node id=\"n1\"><translate>1 2 1</translate><instance_light url=\"#a\"/></node>"
               "<node id=\"n2\"><translate>0 2 0</translate><rotate>1 0 0 -90</rotate><instance_light "
                   "url=\"#b\"/><instance_light url=\"#c\"/></node>"
               "<node id=\"n4\"><translate>0 1 3</translate><instance_camera url=\"#e\"/></node>"
               "<node id=\"n3\"><instance_light url=\"#d\"/></node></visual_scene></library_visual_scenes>"
               "<scene><instance_visual_scene url=\"#s\"/></scene></COLLADA>");
}

/* The light that lamps of a COLLADA file give the ground agrees with closed forms; ambient lights are ignored. Its
   camera is used. */
TEST(lights_of_other_formats) {
    lamps_dae();
    check_lamps("lamps.dae", 3, collada_lamps, "COLLADA");
    /* in a picture that is twice as wide as high, the vertical field of view is 2 atan(1 / 2) */
    CHECK(TOOL("lamps.dae", "--channel", "normal", "--size", "20x10", "--verbose", "-o", "wide.pfm") == 0 &&
          said("--eye 0,1,3 ") && said(" --fov 53.13\n"), "%s", ran.err);
}

static void one_lamp(const double p[3], double r[3]) { r[0] = r[1] = r[2] = lamp_at(0, 1, 0, p); }
/* Each broken light causes one warning and is ignored. */
TEST(broken_lights_are_left_out) {
    static const char *const bad[][2] = {
        { "{\"type\":\"point\",\"intensity\":-1}", "intensity" },
        { "{\"type\":\"point\",\"intensity\":1e300}", "intensity" },
        { "{\"type\":\"point\",\"intensity\":1e30,\"color\":[1e30,0,0]}", "intensity" },
        { "{\"type\":\"area\"}", "left out" },
        { "{\"type\":\"spot\"}", "left out" }, { "{\"type\":7}", "left out" }, { "5", "left out" },
        { "{}", "left out" },
        { "{\"type\":\"spot\",\"spot\":{\"outerConeAngle\":0}}", "cone" },
        { "{\"type\":\"spot\",\"spot\":{\"outerConeAngle\":-1}}", "cone" },
        { "{\"type\":\"spot\",\"spot\":{\"innerConeAngle\":-1}}", "cone" },
        { "{\"type\":\"directional\",\"intensity\":-0.001}", "intensity" } };
    static const char *const nodes[][2] = {
        { "\"scale\":[0,0,0]," LIGHT(1), "direction" },
        { "\"translation\":[0,1e38,0],\"scale\":[1e38,1e38,1e38]," LIGHT(1), "out" }, { LIGHT(2), "left out" },
        { LIGHT(-1), "left out" }, { LIGHT(1.5e9), "left out" }, { LIGHT("x"), "left out" },
        { "\"extensions\":{\"KHR_lights_punctual\":{}}", "left out" },
        { "\"extensions\":{\"KHR_lights_punctual\":[]}", "left out" } };
    enum { BAD = sizeof bad / sizeof *bad, NODES = sizeof nodes / sizeof *nodes, MOST = 8 };
    char lights[2048], uses[2048], name[32];
    size_t n, m;
    int first, count, i;
    for (first = 0; first < BAD + NODES; first += count) {  /* the tool prints only the first MOST warnings */
        const int in_node = first >= BAD, left = in_node ? BAD + NODES - first : BAD - first;
        const char *const (*broken)[2] = in_node ? nodes + first - BAD : bad + first;
        count = left < MOST ? left : MOST;
        n = (size_t)sprintf(lights, "{\"type\":\"point\"}%s", in_node ? ",{\"type\":\"directional\"}" : "");
        m = (size_t)sprintf(uses, ",{\"name\":\"good\",\"translation\":[0,1,0]," LIGHT(0) "}");
        for (i = 0; i < count; i++) {
            if (!in_node) n += (size_t)snprintf(lights + n, sizeof lights - n, ",%s", broken[i][0]);
            m += (size_t)snprintf(uses + m, sizeof uses - m, ",{\"name\":\"broken%d\",", i);
            if (in_node) m += (size_t)snprintf(uses + m, sizeof uses - m, "%s}", broken[i][0]);
            else m += (size_t)snprintf(uses + m, sizeof uses - m, "\"extensions\":{\"KHR_lights_punctual\":{\"light\":"
                                       "%d}}}", i + 1);
        }
        lamps_gltf(lights, count + 1, uses);
        CHECK(TOOL("lamps.gltf", "--size", "4x4", SMALL, "--mode", "direct", "--eye", "0,6,0", "--look-at", "0,0,0",
                   "-o", "lamps.pfm") == 0 && ran.err_lines == count, "exit status %d, expected %d warnings: %s",
              ran.status, count, ran.err);
        for (i = 0; i < count; i++) {
            char line[512] = "";
            const char *at;
            snprintf(name, sizeof name, "broken%d (node %d)", i, i + 2);
            at = strstr(ran.err, name);
            while (at && at > ran.err && at[-1] != '\n') at--;
            if (at) snprintf(line, sizeof line, "%.*s", (int)strcspn(at, "\n"), at);
            CHECK(strstr(line, "warning: lamps.gltf: light") && strstr(line, broken[i][1]), "%s: \"%s\" in: %s",
                  broken[i][0], line, ran.err);
        }
        check_lamps("lamps.gltf", 1, one_lamp, broken[0][0]);
    }
    lamps_gltf("{\"type\":\"spot\",\"spot\":{\"innerConeAngle\":3,\"outerConeAngle\":3}}", 1,
               ",{\"rotation\":[-0.70710678,0,0,0.70710678],\"translation\":[0,1,0]," LIGHT(0) "}");
    CHECK(TOOL("lamps.gltf", WALL_SIZE, SMALL, "-o", "lamps.pfm") == 0 && ran.err_lines == 1 &&
          strstr(ran.err, "narrowed"), "exit status %d: %s", ran.status, ran.err);
    check_lamps("lamps.gltf", 1, one_lamp, "a spot that shines everywhere");
}

/* Renders a sun or a point light alone, straight above the ground of lamps.gltf. Returns R below the light. option,
   value: added to the command line, or NULL */
static double r_below(int point, double intensity, const char *option, const char *value) {
    char lights[128];
    picture p;
    double r;
    snprintf(lights, sizeof lights, "{\"type\":\"%s\",\"intensity\":%.9g}", point ? "point" : "directional", intensity);
    lamps_gltf(lights, 1, point ? ",{\"translation\":[0,1,0]," LIGHT(0) "}"
                                : ",{\"rotation\":[-0.70710678,0,0,0.70710678]," LIGHT(0) "}");
    TOOL("lamps.gltf", "--mode", "direct", "--tile", "1", "--filter-radius", "0", "--size", "33x33", "--samples", "1",
         "--eye", "0,6,0", "--look-at", "0,0,0", "--up", "0,0,-1", "--fov", "20", "--channel", "radiance", "-o",
         "below.pfm", option, value);
    p = read_pfm("below.pfm");
    r = ran.status == 0 ? at(&p, 16, 16, 1) : -1;
    free(p.values);
    return r;
}

/* Lights of the exporter of Blender are converted to the unit of emission: a sun of strength 1 has the irradiance 1,
   and a point light of P watts has the intensity P / (4 pi). --light-scale replaces this conversion. */
TEST(units_of_blender) {
    static const double pi = 3.14159265358979, no = 0;
    static const struct { const char *generator; int point; double intensity, expected; const char *note; } cases[] = {
        { "test_cli", 0, 683, 683, NULL },
        { "Khronos glTF Blender I/O v4.2.60", 0, 683, 1, "exporter 4.2" },
        { "Khronos glTF Blender I/O v3.4.50", 0, 2049, 3, "--light-scale 1 uses" },
        { "Khronos glTF Blender I/O v4.2.60", 1, 5435.14, 100 / 12.5663706, "divided by 683" },
        { "Khronos glTF Blender I/O v4.0.44", 0, 3, 3, "without units; they are used as they are" },
        { "Khronos glTF Blender I/O v3.3.36", 1, 100, 100 / 12.5663706, "exporter 3.3 writes the watts" },
        { "Khronos glTF Blender I/O v1.6.16", 0, 2, 2, NULL },
        { "Khronos glTF Blender I/O", 0, 683, 683, NULL } };
    size_t i;
    for (i = 0; i < sizeof cases / sizeof *cases; i++) {
        double r;
        generator = cases[i].generator;
        r = r_below(cases[i].point, cases[i].intensity, NULL, NULL);
        CHECK(fabs(r * pi - cases[i].expected) < 0.003 * cases[i].expected, "%s, %g: the irradiance is %g, expected "
              "%g: %s", generator, cases[i].intensity, r * pi, cases[i].expected, ran.err);
        CHECK(ran.err_lines == (cases[i].note != NULL) && (!cases[i].note || said(cases[i].note)), "%s: %s", generator,
              ran.err);
        r = r_below(cases[i].point, cases[i].intensity, "--light-scale", "0.25");
        CHECK(fabs(r * pi - 0.25 * cases[i].intensity) < 0.001 * cases[i].intensity && !ran.err[0],
              "%s: --light-scale 0.25 gives %g: %s", generator, r * pi, ran.err);
    }
    CHECK(r_below(0, 683, "--light-scale", "0") == no, "--light-scale 0: exit status %d: %s", ran.status, ran.err);
    generator = cases[1].generator;
    CHECK(r_below(0, 683, "--quiet", NULL) > 0.3 && !ran.err[0], "--quiet says: %s", ran.err);
    generator = "test_cli";
}

/* >>warnings about unsupported material and scene features */

/* Writes squares.gltf with one square per material. materials: the JSON bodies of the materials, separated by '|'.
   more: further top-level glTF members, as JSON */
static void materials_gltf(const char *materials, const char *more) {
    static char json[16384];
    const float corners[12] = { -4, 0, -4, -4, 0, 4, 4, 0, 4, 4, 0, -4 };
    const unsigned short indices[6] = { 0, 1, 2, 0, 2, 3 };
    const unsigned char grey[4] = { 128, 128, 128, 128 };
    unsigned char buffer[60];
    const char *c = materials;
    int n, i, count = 1;
    memcpy(buffer, corners, 48);
    memcpy(buffer + 48, indices, 12);
    write_file("squares.bin", buffer, sizeof buffer);
    stbi_write_png(in_folder("grey.png"), 1, 1, 4, grey, 4);
    n = sprintf(json, "{\"asset\":{\"version\":\"2.0\"},\"extensionsUsed\":[\"KHR_materials_unlit\","
                "\"KHR_materials_clearcoat\",\"KHR_materials_sheen\",\"KHR_materials_transmission\","
                "\"KHR_materials_volume\","
                "\"KHR_lights_punctual\"],\"images\":[{\"uri\":\"grey.png\"}],\"textures\":[{\"source\":0}],"
                "\"materials\":[{");
    for (; *c; c++) {
        count += *c == '|';
        n += sprintf(json + n, *c == '|' ? "},{" : "%c", *c);
    }
    n += sprintf(json + n, "}],\"meshes\":[{\"primitives\":[");
    for (i = 0; i < count; i++)
        n += sprintf(json + n, "%s{\"attributes\":{\"POSITION\":0,\"TEXCOORD_0\":2},\"indices\":1,\"material\":%d}",
                     i ? "," : "", i);
    n += sprintf(json + n, "]},{\"primitives\":[{\"attributes\":{\"POSITION\":0},\"indices\":1,\"material\":0,"
                 "\"targets\":[{\"POSITION\":0}]}]},{\"primitives\":[{\"attributes\":{\"POSITION\":0},\"mode\":3}]}],"
                 "\"accessors\":[{\"bufferView\":0,\"componentType\":5126,\"count\":4,\"type\":\"VEC3\","
                     "\"min\":[-4,0,-4],\"max\":[4,0,4]},"
                 "{\"bufferView\":1,\"componentType\":5123,\"count\":6,\"type\":\"SCALAR\"},"
                 "{\"bufferView\":0,\"componentType\":5126,\"count\":4,\"type\":\"VEC2\"}],"
                 "\"bufferViews\":[{\"buffer\":0,\"byteLength\":48},{\"buffer\":0,\"byteOffset\":48,\"byteLength\":12}"
                     "],\"buffers\":[{\"byteLength\":60,\"uri\":\"squares.bin\"}],\"scene\":0,%s}", more);
    write_file("squares.gltf", json, (size_t)n);
}

#define MATTE "\"pbrMetallicRoughness\":{\"metallicFactor\":0,\"roughnessFactor\":0.5"
#define TEXTURE "{\"index\":0}"
/* Shows the surfaces of a scene, for the warnings about its file: a picture of light would need many more programs.
   --sky keeps the studio away; the warning that it has no effect is removed. option, value: further arguments, or
   NULL */
static void show_surfaces(const char *scene, const char *option, const char *value) {
    char *line;
    TOOL(scene, "--size", "16x16", "--channel", "albedo", "--sky", "1,1,1", "-o", "squares.pfm", option, value);
    line = strstr(ran.err, "sbl_render: warning: no effect: --sky (");
    if (!line) return;
    memmove(line, line + strcspn(line, "\n") + 1, strlen(line + strcspn(line, "\n") + 1) + 1);
    ran.err_lines--;
}

#define ONE_BOUNCE "--size", "16x16", SMALL, "--preset", "draft", "--sky", "1,1,1", "--store", "matte.sbl"

/* Checks that the last run printed exactly these warnings, each on a line, in this order. */
static void check_warnings(const char *scene, const char *const *lines, int count) {
    const char *at_line = ran.err;
    char line[512];
    int i;
    CHECK(ran.status == 0 && ran.err_lines == count, "%s: %d warnings, expected %d: %s", scene, ran.err_lines, count,
          ran.err);
    for (i = 0; i < count && at_line; i++) {
        snprintf(line, sizeof line, "sbl_render: warning: %s: %s\n", scene, lines[i]);
        CHECK(strncmp(at_line, line, strlen(line)) == 0, "expected \"%s\" at: %s", line, at_line);
        at_line = strchr(at_line, '\n');
        if (at_line) at_line++;
    }
}

/* Each kind of simplification causes one warning with a count. A matte file causes none, and neither does any file with
   --quiet. With --materials matte, the warnings name metal and gloss; without it, they name unsupported details of
   these. */
TEST(substitutions_are_named) {
    static const char *const gltf_lines[] = {
        "metal is read as a matte surface of its base colour (2 materials)",
        "gloss is ignored (roughness below 0.5, or Ns above 30): the surface is matte (1 material)",
        "clear coat is ignored (1 material)", "sheen is ignored (1 material)", "anisotropy is ignored (1 material)",
        "transmission, refraction and volume are ignored: the surface is opaque (2 materials)",
        "partial transparency is read as a cutout: opaque from 0.5 on (2 materials)",
        "normal maps are ignored (1 material)", "textures of metal, roughness or gloss are not read (1 material)",
        "unlit materials are lit like all others (1 material)",
        "further material extensions, such as iridescence, are ignored (2 materials)",
        "the range of lights is ignored: they reach everywhere (1 light)",
        "lines and points are left out (1 mesh)", "skins and morph targets are read in their rest pose (1 mesh)",
        "animations are ignored: nodes stand where the file puts them (1 animation)" };
    static const char *const obj_lines[] = {
        "gloss is ignored (roughness below 0.5, or Ns above 30): the surface is matte (1 material)",
        "mirrors and glass (illum 3 to 9) are read as matte, opaque surfaces (2 materials)",
        "partial transparency is read as a cutout: opaque from 0.5 on (1 material)",
        "bump maps and displacement (textures of heights) are ignored (2 materials)",
        "textures of metal, roughness or gloss are not read (1 material)",
        "lines and points are left out (1 mesh)" };
    static const char *const gloss_lines[] = {
        "refraction and volume are ignored: light passes as through a thin pane (1 material)",
        "bump maps and displacement (textures of heights) are ignored (2 materials)",
        "textures of specular colour or gloss are not read; those of metal and roughness are read only from glTF "
            "(1 material)",
        "lines and points are left out (1 mesh)" };
    const char *lines[16];
    static const char *const area_line[] = { "area lights and ambient lights are left out (1 light)" };
    static const char *const materials[] = { "Ns 40\nKs 1 1 1", "Ns 20\nKs 1 1 1", "Ns 400\nKs 0 0 0", "illum 5",
        "illum 6\nNi 1.5", "d 0.8", "map_bump grey.png", "disp grey.png", "map_Ks grey.png",
        "Kd 1 1 1\nillum 2\nmap_Kd grey.png" };
    FILE *mtl, *obj;
    int i;
    materials_gltf(MATTE "}|" MATTE ",\"baseColorTexture\":" TEXTURE "},\"alphaMode\":\"MASK\"|"
                   MATTE "},\"occlusionTexture\":" TEXTURE, "\"nodes\":[{\"mesh\":0}],\"scenes\":[{\"nodes\":[0]}]");
    show_surfaces("squares.gltf", NULL, NULL);
    check_warnings("squares.gltf", NULL, 0);
    materials_gltf(
        "|\"name\":\"half metal\",\"pbrMetallicRoughness\":{\"metallicFactor\":0.5,\"roughnessFactor\":0.1}|"
        "\"pbrMetallicRoughness\":{\"metallicFactor\":0,\"roughnessFactor\":0.49}|"
        "\"pbrMetallicRoughness\":{\"metallicRoughnessTexture\":" TEXTURE "},\"normalTexture\":" TEXTURE "|"
        MATTE "},\"extensions\":{\"KHR_materials_clearcoat\":{\"clearcoatFactor\":1}}|"
        MATTE "},\"extensions\":{\"KHR_materials_sheen\":{\"sheenColorFactor\":[1,1,1]}}|"
        MATTE "},\"extensions\":{\"KHR_materials_transmission\":{\"transmissionFactor\":1}}|"
        MATTE "},\"extensions\":{\"KHR_materials_transmission\":{\"transmissionFactor\":1},"
        "\"KHR_materials_volume\":{\"thicknessFactor\":0.1}}|"
        MATTE ",\"baseColorFactor\":[1,1,1,0.7]},\"alphaMode\":\"BLEND\"|"
        MATTE ",\"baseColorTexture\":" TEXTURE "},\"alphaMode\":\"BLEND\"|" MATTE "},\"alphaMode\":\"BLEND\"|"
        "\"extensions\":{\"KHR_materials_unlit\":{}}|" MATTE "},\"extensions\":{\"KHR_materials_anisotropy\":{},"
        "\"KHR_materials_specular\":{\"specularFactor\":0.5}}|" MATTE "},\"extensions\":{"
        "\"KHR_materials_iridescence\":{},\"KHR_materials_dispersion\":{},"
        "\"KHR_materials_specular\":{\"specularColorFactor\":[1,0,0]}}|"
        MATTE "},\"extensions\":{\"KHR_materials_dispersion\":{},\"KHR_materials_specular\":{}}",
        "\"nodes\":[{\"mesh\":0},{\"mesh\":1},{\"mesh\":2},{" LIGHT(0) "}],\"scenes\":[{\"nodes\":[0,1,2,3]}],"
        "\"extensions\":{\"KHR_lights_punctual\":{\"lights\":[{\"type\":\"point\",\"range\":5}]}},"
        "\"animations\":[{\"samplers\":[{\"input\":1,\"output\":0}],\"channels\":[{\"sampler\":0,"
            "\"target\":{\"node\":0,\"path\":\"translation\"}}]}]");
    show_surfaces("squares.gltf", "--materials", "matte");
    check_warnings("squares.gltf", gltf_lines, 15);
    lines[0] = "texture grey.png is grey, so it is not a normal map; its material is shown without it";
    for (i = 1; i < 4; i++) lines[i] = gltf_lines[i + 1];  /* without metal and gloss */
    lines[i++] = "strength and colour of reflections (KHR_materials_specular) are ignored (2 materials)";
    lines[i++] = gloss_lines[0];                           /* one of two panes is thick */
    for (; i < 12; i++) lines[i] = gltf_lines[i + 3];      /* without transmission, blending and textures of metal */
    show_surfaces("squares.gltf", NULL, NULL);
    check_warnings("squares.gltf", lines, 12);
    show_surfaces("squares.gltf", "--quiet", NULL);
    CHECK(ran.status == 0 && !ran.err[0], "--quiet says: %s", ran.err);

    mtl = fopen(in_folder("kinds.mtl"), "w");
    obj = fopen(in_folder("kinds.obj"), "w");
    fprintf(obj, "mtllib kinds.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\n");
    for (i = 0; i < (int)(sizeof materials / sizeof *materials); i++) {
        fprintf(mtl, "newmtl m%d\n%s\n", i, materials[i]);
        fprintf(obj, "usemtl m%d\nf 1/1 2/1 3/1\n", i);
    }
    fprintf(mtl, "newmtl unused\nillum 5\n");
    fprintf(obj, "usemtl m0\nl 1 2\n");
    fclose(mtl);
    fclose(obj);
    show_surfaces("kinds.obj", "--materials", "matte");
    check_warnings("kinds.obj", obj_lines, 6);
    show_surfaces("kinds.obj", NULL, NULL);
    check_warnings("kinds.obj", gloss_lines, 4);
    lamps_dae();
    show_surfaces("lamps.dae", NULL, NULL);
    check_warnings("lamps.dae", area_line, 1);
}

/* Files whose meshes assimp would misread are refused. What is dropped is named, and does not stop the rest. */
TEST(dropped_parts_of_gltf_are_named) {
    static const char *const refused[] = { "EXT_meshopt_compression", "KHR_meshopt_compression" };
    static const char *const lines[] = {
        "EXT_mesh_gpu_instancing is ignored: only one copy of each of its meshes is shown",
        "KHR_node_visibility is ignored: hidden nodes are shown",
        "nodes whose scale is 0 along an axis are left out (1 node)" };
    static const char *const more_lines[] = {
        "it requires ACME_world, which is not known: parts of the scene can be wrong or missing",
        "material without name: its index of refraction is 0.5, but glTF allows only 0 and values from 1 on; 1 is "
        "used" };
    char more[256];
    int i;
    materials_gltf(MATTE "}", "\"extensionsRequired\":[\"EXT_mesh_gpu_instancing\",\"KHR_node_visibility\"],"
                   "\"nodes\":[{\"mesh\":0},{\"mesh\":0,\"scale\":[1,0,1]}],\"scenes\":[{\"nodes\":[0,1]}]");
    show_surfaces("squares.gltf", NULL, NULL);
    check_warnings("squares.gltf", lines, 3);
    materials_gltf(MATTE "},\"extensions\":{\"KHR_materials_ior\":{\"ior\":0.5}}",
                   "\"extensionsRequired\":[\"KHR_lights_punctual\",\"KHR_materials_ior\",\"ACME_world\"],"
                   "\"nodes\":[{\"mesh\":0}],\"scenes\":[{\"nodes\":[0]}]");
    show_surfaces("squares.gltf", NULL, NULL);
    check_warnings("squares.gltf", more_lines, 2);
    show_surfaces("squares.gltf", "--materials", "matte");
    check_warnings("squares.gltf", more_lines, 1);
    for (i = 0; i < 2; i++) {
        sprintf(more, "\"extensionsRequired\":[\"%s\"],\"nodes\":[{\"mesh\":0}],\"scenes\":[{\"nodes\":[0]}]",
                refused[i]);
        materials_gltf(MATTE "}", more);
        show_surfaces("squares.gltf", NULL, NULL);
        CHECK(ran.status == 1 && ran.err_lines == 1 && strstr(ran.err, refused[i]), "%s: exit %d, \"%s\"", refused[i],
              ran.status, ran.err);
    }
}

/* If the only camera of a file is orthographic, or has a field of view that no tool can use, another view is chosen,
   and a warning says so. The unit of an FBX file
   is printed, because it changes the positions that options give. */
TEST(cameras_and_units_are_named) {
    static const char *const lines[] = {
        "orthographic cameras are not used, and the file has no other: the tool chose a view (1 camera)" };
    static const char *const narrow[] = { "the camera of the file is not used, because its field of view (0.573 "
        "degrees) is not between 1 and 179 degrees, or its position is too far away; the tool chose a view" };
    materials_gltf(MATTE "}", "\"cameras\":[{\"type\":\"orthographic\",\"orthographic\":{\"xmag\":1,\"ymag\":1,"
                   "\"znear\":0,\"zfar\":9}}],\"nodes\":[{\"mesh\":0},{\"camera\":0}],\"scenes\":[{\"nodes\":[0,1]}]");
    show_surfaces("squares.gltf", NULL, NULL);
    check_warnings("squares.gltf", lines, 1);
    materials_gltf(MATTE "}", "\"cameras\":[{\"type\":\"perspective\",\"perspective\":{\"yfov\":0.01,\"znear\":1}}],"
                   "\"nodes\":[{\"mesh\":0},{\"camera\":0}],\"scenes\":[{\"nodes\":[0,1]}]");
    show_surfaces("squares.gltf", NULL, NULL);
    check_warnings("squares.gltf", narrow, 1);
    show_surfaces("squares.gltf", "--eye", "0,1,9");
    check_warnings("squares.gltf", NULL, 0);
    tool_use("sbl_bake");
    TOOL("squares.gltf", "--mode", "direct", "--sky", "1,1,1", "--preset", "draft", "--vertices", "-o", "squares.ply");
    check_warnings("squares.gltf", NULL, 0);
    tool_use("sbl_render");
    write_text("unit.fbx", "; FBX 7.3.0 project file\nFBXHeaderExtension: {\nFBXVersion: 7300\n}\nGlobalSettings: {\n"
               "Version: 1000\nProperties70: {\nP: \"UnitScaleFactor\", \"double\", \"Number\", \"\",1\n}\n}\n"
               "Objects: {\nGeometry: 1, \"Geometry::g\", \"Mesh\" {\nVertices: *9 {\na: 0,0,0,100,0,0,0,100,0\n}\n"
               "PolygonVertexIndex: *3 {\na: 0,1,-3\n}\nGeometryVersion: 124\n}\nModel: 2, \"Model::m\", \"Mesh\" {\n"
               "Version: 232\nProperties70: {\n}\n}\n}\nConnections: {\nC: \"OO\",2,0\nC: \"OO\",1,2\n}\n");
    show_surfaces("unit.fbx", NULL, NULL);
    CHECK(ran.status == 0 && ran.err_lines == 1 && strstr(ran.err, "its unit is 0.01 m"), "%s", ran.err);
}

/* The converter names what it drops, too, because it cannot be seen in the file that it writes. It writes no .glb. */
TEST(the_converter_names_what_it_drops) {
    materials_gltf(MATTE "},\"extensions\":{\"KHR_materials_clearcoat\":{\"clearcoatFactor\":1}}", "\"cameras\":["
                   "{\"type\":\"orthographic\",\"orthographic\":{\"xmag\":1,\"ymag\":1,\"znear\":0,\"zfar\":9}}],"
                   "\"nodes\":[{\"mesh\":0},{\"mesh\":2},{\"camera\":0}],\"scenes\":[{\"nodes\":[0,1,2]}]");
    tool_use("scene_to_gltf");
    TOOL("squares.gltf", "converted.gltf");
    CHECK(ran.status == 0 && ran.err_lines == 2 &&
          strstr(ran.err, "squares.gltf: clear coat is ignored (1 material)") &&
          strstr(ran.err, "squares.gltf: lines and points are left out (1 mesh)"), "%d: %s", ran.status, ran.err);
    TOOL("squares.gltf", "converted.glb");
    CHECK(ran.status == 2 && strstr(ran.err, "FILE.gltf"), "%d: %s", ran.status, ran.err);
    tool_use("sbl_render");
}

/* Copies the texts from `at` to the next semicolon that is not in a text, each with a line end, and returns their end.
   Adjacent texts are one text. */
static const char *literals(const char *at, char *out, size_t size) {
    size_t used = 0;
    int inside = 0;
    for (; *at && (inside || *at != ';'); at++) {
        if (*at == '"') inside = !inside;
        else if (inside && *at == '\\') at++;
        else if (inside && used + 1 < size) out[used++] = *at;
        if (!inside && *at == '"' && used + 1 < size) out[used++] = '\n';
        if (!inside && *at == '"' && at[1 + strspn(at + 1, " \n")] == '"') used--;
    }
    out[used] = 0;
    return at;
}

/* Returns 1 if a text contains a name of C: letters around an underscore. */
static int has_c_name(const char *text) {
    const char *at;
    for (at = strchr(text, '_'); at; at = strchr(at + 1, '_'))
        if (at > text && isalnum((unsigned char)at[-1]) && isalpha((unsigned char)at[1])) return 1;
    return 0;
}

/* Messages of sbl.h that a tool passes on name options instead of C names. Every text that the tools replace exists in
   sbl.h. Messages about descriptors are excepted if tools check these fields themselves. */
TEST(messages_name_no_fields) {
    static const char *const unreachable[] = { "sbl_context_desc.memory_budget", "gl_texture", "call sbl_set_scene",
        "get_gl_function is NULL", "sbl_create: out" };
    static char source[2000000], joined[sizeof source], text[4096], out[4096];
    size_t i, k, used = 0;
    int lines, messages = 0;
    const char *at;
    read_text("sbl.h", source, sizeof source, &lines);
    for (at = strstr(source, "#ifdef SBL_IMPLEMENTATION\n"); at && *at; at++) {
        if (*at == '"' && at[1 + strspn(at + 1, " \n")] == '"') at += 1 + strspn(at + 1, " \n");
        else joined[used++] = *at;
    }
    REQUIRE(used > 500000, "sbl.h cannot be read");
    for (i = 0; i < sizeof tool__words / sizeof *tool__words; i++)
        CHECK(strstr(joined, tool__words[i][0]), "no message of sbl.h says \"%s\"", tool__words[i][0]);
    for (at = source; (at = strstr(at, "sbl__log(")) != NULL; messages++) {
        at = literals(at, text, sizeof text);
        for (k = 0; k < sizeof unreachable / sizeof *unreachable && !strstr(text, unreachable[k]); k++) continue;
        tool_translate(out, sizeof out, text);
        CHECK(k < sizeof unreachable / sizeof *unreachable || !has_c_name(out), "a tool says: %s", out);
    }
    CHECK(messages > 40, "%d messages", messages);
    tool_translate(out, sizeof out, "sbl_picture_desc: options.rays is 5000; it must be 1 to 4096");
    CHECK(strcmp(out, "--rays is 5000; it must be 1 to 4096") == 0, "%s", out);
    tool_translate(out, sizeof out, "my_target_error target_errors target_error: target_error");
    CHECK(strcmp(out, "my_target_error target_errors --target-error: --target-error") == 0, "%s", out);
    tool_translate(out, 12, "target_error is 7");
    CHECK(strcmp(out, "--target-er") == 0, "%s", out);
    wall_obj();
    TOOL("wall.obj", "--eye", "0,0,1", "--look-at", "0,0,5", SMALL, WALL_SIZE, "-o", "away.pfm");
    CHECK(ran.status == 0 && strstr(ran.err, "the camera sees no surface; check --eye, --look-at, --up and --fov\n"),
          "exit %d: %s", ran.status, ran.err);
}

/* An .obj file without its .mtl file is rendered in grey, with a warning. assimp also looks for an .mtl file with the
   name of the .obj file. */
TEST(missing_mtl_files_are_named) {
    static const char obj[] = "mtllib absent.mtl\nusemtl m\nv -4 0 -4\nv -4 0 4\nv 4 0 4\nv 4 0 -4\nf 1 2 3 4\n";
    static const char *const lines[] = { "materials absent.mtl cannot be read; surfaces that use them are grey" };
    write_text("bare.obj", obj);
    show_surfaces("bare.obj", NULL, NULL);
    check_warnings("bare.obj", lines, 1);
    write_text("bare.mtl", "newmtl m\nKd 0.5 0.1 0.1\n");
    show_surfaces("bare.obj", NULL, NULL);
    check_warnings("bare.obj", NULL, 0);
}

/* A scene with --materials matte equals the same scene with matte materials to the bit. Both have the same stored
   light, which differs from that of --materials file. */
TEST(materials_can_be_matte) {
    static const char obj[] = "mtllib m.mtl\nusemtl m\nv -4 0 -4\nv -4 0 4\nv 4 0 4\nv 4 0 -4\nf 1 2 3 4\n";
    static const char *const mtl[2] = { "newmtl m\nKd .5 .6 .7\nKs 1 1 1\nNs 98\nillum 2\n",
                                        "newmtl m\nKd .5 .6 .7\n" };
    static const char *const gltf[2] = {
        "\"pbrMetallicRoughness\":{\"roughnessFactor\":0.3,\"baseColorFactor\":[0.5,0.6,0.7,1]}|"
            "\"pbrMetallicRoughness\":{\"metallicRoughnessTexture\":" TEXTURE ",\"baseColorTexture\":" TEXTURE "}",
        MATTE ",\"baseColorFactor\":[0.5,0.6,0.7,1]}|" MATTE ",\"baseColorTexture\":" TEXTURE "}" };
    int kind, i;
    for (kind = 0; kind < 2; kind++) {
        const char *scene = kind ? "matte.obj" : "squares.gltf";
        write_file("matte.obj", obj, sizeof obj - 1);
        remove(in_folder("matte.sbl"));
        for (i = 1; i >= 0; i--) {  /* matte.pfm is from the matte scene, glossy.pfm from the other */
            write_file("m.mtl", mtl[i], strlen(mtl[i]));
            materials_gltf(gltf[i], "\"nodes\":[{\"mesh\":0}],\"scenes\":[{\"nodes\":[0]}]");
            CHECK(TOOL(scene, ONE_BOUNCE, "--materials", "matte", "-o", i ? "matte.pfm" : "glossy.pfm") == 0, "%s: %s",
                  scene, ran.err);
        }
        CHECK(same_bytes("matte.pfm", "glossy.pfm"), "%s: --materials matte gives another picture", scene);
        CHECK(TOOL(scene, ONE_BOUNCE, "-o", "glossy.pfm") == 1 && said("for a scene with other materials"), "%s: exit "
              "status %d: %s", scene, ran.status, ran.err);
    }
}

/* A wall shows the normals of its texture, in which red points to the right and green to the top of the picture: in
   OBJ, whose texture coordinates begin at the bottom, and in glTF. With --materials matte, it equals a wall without the
   texture, to the bit. */
TEST(normal_maps_are_shown) {
    static const char obj[] = "mtllib n.mtl\nusemtl n\nv -1 -1 0\nv 1 -1 0\nv 1 1 0\nv -1 1 0\nvt 0 0\nvt 1 0\nvt 1 1\n"
        "vt 0 1\nf 1/1 2/2 3/3 4/4\n";
    static const unsigned char blue[3] = { 189, 209, 204 };  /* 0.48, 0.64, 0.6 */
    static const float corners[20] = { -1, -1, 0, 1, -1, 0, 1, 1, 0, -1, 1, 0, 0, 1, 1, 1, 1, 0, 0, 0 };
    static const char gltf[] = "{\"asset\":{\"version\":\"2.0\"},\"images\":[{\"uri\":\"blue.png\"}],\"textures\":["
        "{\"source\":0}],\"materials\":[{%s}],\"meshes\":[{\"primitives\":[{\"attributes\":{\"POSITION\":0,"
        "\"TEXCOORD_0\":1},\"indices\":2,\"material\":0}]}],\"nodes\":[{\"mesh\":0}],\"scenes\":[{\"nodes\":[0]}],"
        "\"scene\":0,\"accessors\":[{\"bufferView\":0,\"componentType\":5126,\"count\":4,\"type\":\"VEC3\",\"min\":"
        "[-1,-1,0],\"max\":[1,1,0]},{\"bufferView\":1,\"componentType\":5126,\"count\":4,\"type\":\"VEC2\"},"
        "{\"bufferView\":2,\"componentType\":5121,\"count\":6,\"type\":\"SCALAR\"}],\"bufferViews\":[{\"buffer\":0,"
        "\"byteLength\":48},{\"buffer\":0,\"byteOffset\":48,\"byteLength\":32},{\"buffer\":0,\"byteOffset\":80,"
        "\"byteLength\":6}],\"buffers\":[{\"byteLength\":86,\"uri\":\"n.bin\"}]}";
    static const char *const mtl[2] = { "newmtl n\nnorm blue.png\n", "newmtl n\n" };
    static const char *const maps[2] = { "\"normalTexture\":{\"index\":0}", "" };
    static const double tilted[3] = { 0.48, 0.64, 0.6 };
    char text[2048];
    unsigned char bytes[86] = { 0 };
    int kind, i, k;
    picture p;
    memcpy(bytes, corners, 80);
    memcpy(bytes + 80, "\0\1\2\0\2\3", 6);
    write_file("n.bin", bytes, sizeof bytes);
    write_file("n.obj", obj, sizeof obj - 1);
    stbi_write_png(in_folder("blue.png"), 1, 1, 3, blue, 3);
#define WALL_OF(kind) kind ? "n.obj" : "n.gltf", "--eye", "0,0,3", "--look-at", "0,0,0", "--fov", "30", "--size", \
             "4x4", "--quiet"
    for (kind = 0; kind < 2; kind++) {
        for (i = 1; i >= 0; i--) {
            snprintf(text, sizeof text, gltf, maps[i]);
            write_text("n.gltf", text);
            write_text("n.mtl", mtl[i]);
            CHECK(TOOL(WALL_OF(kind), "--materials", "matte", "--mode", "direct", "--sky", "1,1,1", "-o",
                       i ? "plain.pfm" : "matte.pfm") == 0, "%s", ran.err);
        }
        CHECK(same_bytes("matte.pfm", "plain.pfm"), "kind %d: --materials matte shows normal maps", kind);
        CHECK(TOOL(WALL_OF(kind), "--channel", "normal", "-o", "normal.pfm") == 0, "%s", ran.err);
        p = read_pfm("normal.pfm");
        REQUIRE(p.values, "kind %d: no picture", kind);
        for (i = 0; i < 16; i++)
            for (k = 0; k < 3; k++)
                CHECK(fabs((double)p.values[3 * i + k] - tilted[k]) < 0.01, "kind %d, pixel %d: component %d of the "
                      "normal is %g, expected %g", kind, i, k, (double)p.values[3 * i + k], tilted[k]);
        free(p.values);
    }
}

/* >>a missed target error */

#define RASTER "--mode", "direct", "--backend", "raster", "--sensor-size", "8"

/* If a picture misses its target error, one line says so and what helps. Other pictures print no such line. */
TEST(a_missed_target_is_said) {
    room_obj();
    CHECK(TOOL(ROOM, "--target-error", "0.05%", "-o", "room.pfm") == 0 && ran.err_lines == 1 &&
              said("room.obj: the predicted error is ") && said(" %, 0.05 % was asked for: stored light limits it; ") &&
              said("--max-bounce-cells 4096 may help\n"), "stored light: exit status %d: %s", ran.status, ran.err);
    CHECK(TOOL(ROOM, RASTER, "-o", "room.pfm") == 0 && ran.err_lines == 1 &&
              said(" %, 1.5 % was asked for: the default limit of rays per sensor was reached; --target-error 1.5% "
                   "allows more"), "rays: exit status %d: %s",
          ran.status, ran.err);
    CHECK(TOOL(ROOM, RASTER, "--target-error", "0.01%", "--size", "6x4", "-o", "room.pfm") == 0 && ran.err_lines == 1 &&
              said("the maximum number of rays per sensor was reached; a larger --filter-radius"),
          "all rays: exit status %d: %s", ran.status, ran.err);
    CHECK(TOOL(ROOM, RASTER, "--threshold", "0.5", "-o", "room.pfm") == 0 && !ran.err[0], "--threshold: %s", ran.err);
    CHECK(TOOL(ROOM, "--target-error", "0.05%", "--rays", "64", "-o", "room.pfm") == 0 && !ran.err[0],
          "--rays: exit status %d: %s", ran.status, ran.err);
    CHECK(TOOL(ROOM, "--target-error", "20%", "-o", "room.pfm") == 0 && !ran.err[0], "a target that was reached: %s",
          ran.err);
    CHECK(TOOL(ROOM, RASTER, "--quiet", "-o", "room.pfm") == 0 && !ran.err[0], "--quiet: %s", ran.err);
    CHECK(TOOL(ROOM, "--mode", "paper", "-o", "room.pfm") == 0 && !ran.err[0], "mode paper: %s", ran.err);
}

#define LIGHTS "--size", "128x96", "--max-bounce-cells", "49152", "-o", "lights.pfm"

/* If stored light alone causes most of the requested error, the tool advises a smaller target error. A run with the
   advised target reaches the error that was requested first. The test reads the error of stored light from one run and
   requests 1.15 times that error in the next. */
TEST(advice_on_a_missed_target_helps) {
    char scene[4096], asked[16], expected[80], advised[16] = "", text[8192];
    const char *advice;
    double target;
    int lines;
    if (!realpath("examples/scenes/lights.gltf", scene)) SKIP("not run in the repository's root");
    TOOL(scene, LIGHTS, "--stats", "stats.json");
    read_text(in_folder("stats.json"), text, sizeof text, &lines);
    target = 1.15 * json_number(text, "stored");
    REQUIRE(target > 0, "the error of stored light is %g", target);
    snprintf(asked, sizeof asked, "%.6f%%", 100 * target);
    snprintf(expected, sizeof expected, " %.2g %% was asked for: stored light limits it; --target-error ",
             100 * target);
    TOOL(scene, LIGHTS, "--target-error", asked);
    advice = strstr(ran.err, expected);
    REQUIRE(ran.err_lines == 1 && advice && sscanf(strstr(advice, "--"), "--target-error %15s", advised) == 1,
            "exit status %d, no smaller target than %s is advised: %s", ran.status, asked, ran.err);
    TOOL(scene, LIGHTS, "--target-error", advised, "--stats", "stats.json");
    read_text(in_folder("stats.json"), text, sizeof text, &lines);
    CHECK(ran.status == 0 && json_number(text, "expected") <= target, "--target-error %s: the error is %g instead of "
          "%s: %s", advised, json_number(text, "expected"), asked, ran.err);
}

/* >>sky pictures */

/* Writes a wall that faces +x in the open, without any ground. */
static void lone_wall(void) {
    write_text("lone.mtl", "newmtl grey\nKd .5 .5 .5\n");
    write_text("lone.obj", "mtllib lone.mtl\nusemtl grey\nv 0 -1 1\nv 0 -1 -1\nv 0 1 -1\nv 0 1 1\nf 1 2 3 4\n");
}

/* Returns the mean R of the wall in component k. deviation: receives the largest difference of a pixel from the mean */
static double wall_mean(int k, double *deviation) {
    picture p = read_pfm("sky.pfm");
    double sum = 0;
    int i;
    *deviation = 0;
    if (!p.values || ran.status) { free(p.values); return -1; }
    for (i = 0; i < p.width * p.height; i++) sum += (double)p.values[3 * i + k] / (p.width * p.height);
    for (i = 0; i < p.width * p.height; i++) *deviation = fmax(*deviation, fabs((double)p.values[3 * i + k] - sum));
    free(p.values);
    return sum;
}
#define WALL_IN_THE_OPEN \
    "lone.obj", "--eye", "0.5,0,0", "--look-at", "0,0,0", "--fov", "60", "--size", "12x12", "--mode", "direct", \
    "--rays", "256", "--quiet", "--channel", "radiance", "-o", "sky.pfm"
static void check_sky(double expected, double tolerance, const char *what) {
    double deviation, mean = wall_mean(1, &deviation);
    CHECK(ran.status == 0 && fabs(mean - expected) <= tolerance && deviation <= tolerance,
          "%s: exit status %d, R is %g +- %g, expected %g: %s", what, ran.status,
          mean, deviation, expected, ran.err);
}

/* Writes a sky of 64 x 32 texels that has the given colour where bright() returns 1, and is black elsewhere. */
static void write_sky(const char *name, int (*bright)(int x, int y), float red, float green, float blue) {
    static float texels[32][64][3];
    int x, y;
    for (y = 0; y < 32; y++)
        for (x = 0; x < 64; x++) {
            texels[y][x][0] = bright(x, y) ? red : 0;
            texels[y][x][1] = bright(x, y) ? green : 0;
            texels[y][x][2] = bright(x, y) ? blue : 0;
        }
    stbi_write_hdr(in_folder(name), 64, 32, 3, &texels[0][0][0]);
}
static int everywhere(int x, int y) { (void)x; (void)y; return 1; }
static int towards_minus_z(int x, int y) { (void)y; return x < 32; }
static int above(int x, int y) { (void)x; return y < 16; }

/* A sky picture lights the wall like a constant sky of its mean. --sky-scale multiplies it, its colours are not
   swapped, and of several --sky options the last counts. */
TEST(sky_pictures) {
    unsigned char grey[2 * 2 * 4];
    double deviation;
    lone_wall();
    write_sky("one.hdr", everywhere, 1, 1, 1);
    TOOL(WALL_IN_THE_OPEN, "--sky", "one.hdr");
    check_sky(1, 0.001, "a constant picture");
    TOOL(WALL_IN_THE_OPEN, "--sky", "one.hdr", "--backend", "raster");
    check_sky(1, 0.005, "a constant picture, rasterised");
    TOOL(WALL_IN_THE_OPEN, "--sky", "one.hdr", "--sky-scale", "0.25");
    check_sky(0.25, 0.001, "a quarter of it");
    TOOL(WALL_IN_THE_OPEN, "--sky", "one.hdr", "--sky-scale", "0");
    check_sky(0, 1e-9, "nothing of it");
    TOOL(WALL_IN_THE_OPEN, "--sky", "one.hdr", "--sky", "0.5,0.5,5.e-1");  /* this is no name of a file */
    check_sky(0.5, 0.001, "of two --sky options the last counts");
    TOOL(WALL_IN_THE_OPEN, "--sky", "9,9,9", "--sky", "one.hdr");
    check_sky(1, 0.001, "of two --sky options the last counts, a picture");
    write_sky("colors.hdr", everywhere, 64, 0.5f, 2);
    TOOL(WALL_IN_THE_OPEN, "--sky=colors.hdr");
    check_sky(0.5, 0.001, "a bright picture");
    CHECK(fabs(wall_mean(0, &deviation) - 64) < 0.1 && fabs(wall_mean(2, &deviation) - 2) < 0.01,
          "the colours of the picture are swapped");
    memset(grey, 188, sizeof grey);
    grey[3] = grey[7] = grey[11] = grey[15] = 10;  /* the alpha of a sky is ignored */
    stbi_write_png(in_folder("grey.PNG"), 2, 2, 4, grey, 8);
    TOOL(WALL_IN_THE_OPEN, "--sky", "grey.PNG");
    check_sky(decode_srgb(188 / 255.0), 0.003, "a .png");
    CHECK(TOOL("lone.obj", "--eye", "0.5,0,0", "--look-at", "1,0,0", "--sky", "one.hdr", "--size", "8x8", "--quiet",
               "-o", "sky.pfm") == 0, "exit status %d: %s", ran.status, ran.err);
    CHECK(fabs(wall_mean(1, &deviation) - 1) < 0.001 && deviation < 0.001, "the sky should be seen: %g +- %g",
          wall_mean(1, &deviation), deviation);
}

/* The wall faces +x, which is the middle of a sky picture. Seen from the wall, the left half of the picture is towards
   -z; a quarter turn about y moves it to -x. */
TEST(sky_pictures_turn) {
    static const struct { const char *degrees; double r;
        } turns[] = { { "0", 1 }, { "90", 0 }, { "-90", 2 }, { "270", 2 }, { "180", 1 }, { "-30", 1.5 } };
    static const struct { const char *up; double r;
        } ups[] = { { "0,5,0", 1 }, { "0,-1,0", 1 }, { "1e-3,0,0", 2 }, { "-1,0,0", 0 }, { "1,0,1", 1 + 0.70710678 } };
    size_t i;
    lone_wall();
    write_sky("left.hdr", towards_minus_z, 2, 2, 2);
    for (i = 0; i < sizeof turns / sizeof *turns; i++) {
        TOOL(WALL_IN_THE_OPEN, "--sky", "left.hdr", "--sky-rotation", turns[i].degrees);
        check_sky(turns[i].r, 0.02, turns[i].degrees);
    }
    write_sky("above.hdr", above, 2, 2, 2);
    for (i = 0; i < sizeof ups / sizeof *ups; i++) {
        TOOL(WALL_IN_THE_OPEN, "--sky", "above.hdr", "--sky-up", ups[i].up);
        check_sky(ups[i].r, 0.02, ups[i].up);
    }
}

/* --inspect says that a sensor hits nothing, instead of printing distances of 0. */
TEST(a_sensor_may_meet_nothing) {
    lone_wall();
    CHECK(TOOL("lone.obj", "--size", "9x9", "--sky", "1,1,1", "--inspect", "4,4", "-o", "sheet.png") == 0 &&
              strstr(ran.out, "\nno surface was met\n") && !strstr(ran.out, "nearest"), "%s%s", ran.err, ran.out);
}

/* >>failures */

/* Wrong command lines give exit status 2 and one line on stderr, and no picture is written. */
TEST(wrong_usage_gives_status_2) {
    static const char *const lines[][6] = { { NULL },
                                            { "--size" },
                                            { "room.obj", "--size", "0x5" },
                                            { "room.obj", "--size", "640" },
                                            { "room.obj", "--size", "640x480x2" },
                                            { "room.obj", "--size", "16385x16" },
                                            { "room.obj", "--size", "-5x5" },
                                            { "room.obj", "--eye", "1,2" },
                                            { "room.obj", "--eye", "1,2,x" },
                                            { "room.obj", "--eye", "1,2,nan" },
                                            { "room.obj", "--look-at", "1,2,inf" },
                                            { "room.obj", "--eye", "1, 2,3" },
                                            { "room.obj", "--up", "" },
                                            { "room.obj", "--fov", "180" },
                                            { "room.obj", "--fov", "0" },
                                            { "room.obj", "--fov", "40deg" },
                                            { "room.obj", "--sky", "1,1,-1" },
                                            { "room.obj", "--sky", "1,1" },
                                            { "room.obj", "--sky", "1,1,1.hdr,1" },
                                            { "room.obj", "--sky", "blue" },
                                            { "room.obj", "--sky", "" },
                                            { "room.obj", "--sky", "1,1,1", "--sky-scale", "2" },
                                            { "room.obj", "--sky-rotation", "90" },
                                            { "room.obj", "--studio", "--sky", "1,1,1" },
                                            { "room.obj", "--studio", "--mode", "paper" },
                                            { "room.obj", "--sky", "sky.hdr", "--sky-rotation", "east" },
                                            { "room.obj", "--sky", "sky.hdr", "--sky-rotation", "361" },
                                            { "room.obj", "--sky", "sky.hdr", "--sky-scale", "-1" },
                                            { "room.obj", "--sky", "sky.hdr", "--sky-scale", "nan" },
                                            { "room.obj", "--sky", "sky.hdr", "--sky-up", "0,0,0" },
                                            { "room.obj", "--sky", "sky.hdr", "--sky-up", "0,1" },
                                            { "room.obj", "--sky", "sky.hdr", "--mode", "paper" },
                                            { "room.obj", "--mode", "fast" },
                                            { "room.obj", "--preset", "High" },
                                            { "room.obj", "--channel", "beauty" },
                                            { "room.obj", "--backend", "metal" },
                                            { "room.obj", "--sensor-size", "3" },
                                            { "room.obj", "--sensor-size", "513" },
                                            { "room.obj", "--sensor-size", "12.5" },
                                            { "room.obj", "--sensor-fov", "100" },
                                            { "room.obj", "--mode", "paper", "--sensor-fov", "180" },
                                            { "room.obj", "--tile", "0" },
                                            { "room.obj", "--threshold", "-1" },
                                            { "room.obj", "--filter-radius", "33" },
                                            { "room.obj", "--samples", "65" },
                                            { "room.obj", "--exposure", "bright" },
                                            { "room.obj", "--seed", "99999999999" },
                                            { "room.obj", "--allow-path" },
                                            { "room.obj", "--memory", "4X" },
                                            { "room.obj", "--memory", "1K" },
                                            { "room.obj", "--read-time", "0" },
                                            { "room.obj", "--epsilon", "-0.1" },
                                            { "room.obj", "--epsilon", "0.1" },
                                            { "room.obj", "--mode", "direct", "--epsilon", "0.1" },
                                            { "room.obj", "--bounce-samples", "1023" },
                                            { "room.obj", "-o", "out.jpg" },
                                            { "room.obj", "-o" },
                                            { "room.obj", "--fast" },
                                            { "room.obj", "--quiet=yes" },
                                            { "room.obj", "-x" },
                                            { "room.obj", "other.obj" },
                                            { "room.obj", "--inspect", "5" },
                                            { "room.obj", "--inspect", "5,5", "--channel", "id" },
                                            { "room.obj", "--stats" },
                                            { "room.obj", "--eye", "0,0,0", "--look-at", "0,0,0" },
                                            { "room.obj", "--up", "0,0,0" } };
    size_t i, k;
    room_obj();
    for (i = 0; i < sizeof lines / sizeof lines[0]; i++) {
        char shown[256] = "";
        for (k = 0; k < 6 && lines[i][k]; k++) { strcat(shown, " "); strcat(shown, lines[i][k]); }
        remove(in_folder("sbl.png"));
        run(lines[i]);
        CHECK(ran.status == 2, "sbl_render%s: exit status %d, expected 2: %s", shown, ran.status, ran.err);
        CHECK(ran.err_lines == 1 && strncmp(ran.err, "sbl_render: ", 12) == 0 && !ran.out[0],
              "sbl_render%s: expected one line on stderr: %s%s", shown, ran.err, ran.out);
        CHECK(!exists("sbl.png"), "sbl_render%s: a picture was written", shown);
    }
}

/* Checks that the last run failed with one line on stderr that contains the words, and left no file behind. */
static void check_refused(const char *what, const char *words) {
    CHECK(ran.status == 1, "%s: exit status %d, expected 1: %s", what, ran.status, ran.err);
    CHECK(ran.err_lines == 1 && strncmp(ran.err, "sbl_render: ", 12) == 0, "%s: expected one line on stderr: %s", what,
          ran.err);
    CHECK(strstr(ran.err, words), "%s: expected \"%s\" in: %s", what, words, ran.err);
    CHECK(!exists("refused.png") && !parts_left(), "%s: something was written", what);
}

/* Failures at run time give exit status 1 and one line that names the file. */
TEST(failures_give_status_1) {
    room_obj();
    TOOL("absent.obj", "-o", "refused.png"); check_refused("no scene", "absent.obj: No such file");
    TOOL(".", "-o", "refused.png"); check_refused("a folder", "directory");
    TOOL("/dev/null", "-o", "refused.png"); check_refused("a device", "/dev/null");
    TOOL(ROOM, "-o", "nowhere/refused.png"); check_refused("no such folder", "nowhere/refused.png");
    TOOL(ROOM, "-o", "refused.png", "--stats", "nowhere/stats"); check_refused("no folder for the statistics",
                                                                      "nowhere/stats");
    mkdir(in_folder("folder.png"), 0777);
    TOOL(ROOM, "-o", "folder.png"); check_refused("a folder for the picture", "folder.png");
    CHECK(TOOL(ROOM, "--backend", "raster", "-o", "raster.pfm") == 0, "--backend raster: exit status %d: %s",
          ran.status, ran.err);
    CHECK(TOOL(ROOM, "--backend", "auto", "-o", "auto.pfm") == 0, "--backend auto: exit status %d: %s", ran.status,
          ran.err);
}

/* Damaged, truncated and missing sky pictures give exit status 1 and a message with the name of the file. */
TEST(broken_sky_pictures_are_refused) {
    static const struct { const char *name, *text, *words; } files[] = {
        { "empty.hdr", "", "too soon" }, { "text.hdr",
            "this is no picture, and long enough to be found out as one that is not", "picture cannot be read" },
        { "head.hdr", "#?RADIANCE\n", "too soon" },
        { "format.hdr", "#?RADIANCE\nFORMAT=other\n\n-Y 4 +X 4\n                          ", "cannot be read" },
        { "large.hdr", "#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 99999 +X 99999\n                          ",
          "cannot be read" },
        { "lies.hdr", "#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 16384 +X 16384\n\2\2\100", "lies.hdr" },
        { "sky.exr", "\166\57\61\1 this one only writes, and whoever has it must convert it", "cannot be read" } };
    char whole[16384], shown[64];
    struct stat info;
    size_t size, i;
    FILE *in;
    lone_wall();
    for (i = 0; i < sizeof files / sizeof *files; i++) {
        write_text(files[i].name, files[i].text);
        TOOL("lone.obj", SMALL, "--size", "8x8", "--sky", files[i].name, "-o", "refused.png");
        check_refused(files[i].name, files[i].words);
        CHECK(strstr(ran.err, files[i].name), "%s is not named: %s", files[i].name, ran.err);
    }
    write_sky("whole.hdr", above, 3, 2, 1);
    in = fopen(in_folder("whole.hdr"), "rb");
    REQUIRE(in && stat(in_folder("whole.hdr"), &info) == 0, "there is no picture");
    size = fread(whole, 1, sizeof whole, in);
    fclose(in);
    REQUIRE(size == (size_t)info.st_size && size > 400, "%d bytes of it", (int)size);
    for (i = 1; i < 20; i += 3) {  /* a reader that misses the end of the file would loop forever */
        write_file("cut.hdr", whole, size * i / 20);
        TOOL("lone.obj", SMALL, "--size", "8x8", "--sky", "cut.hdr", "-o", "refused.png");
        snprintf(shown, sizeof shown, "%d bytes of %d", (int)(size * i / 20), (int)size);
        check_refused(shown, "cut.hdr: it ends too soon");
    }
    TOOL("lone.obj", "--sky", "absent.hdr", "-o", "refused.png"); check_refused("no picture",
                                                                      "absent.hdr: No such file");
    mkdir(in_folder("folder.hdr"), 0777);
    TOOL("lone.obj", "--sky", "folder.hdr", "-o", "refused.png"); check_refused("a folder", "folder.hdr");
}

/* Invalid scenes give exit status 1 and one line that names the mistake. */
TEST(hostile_files_are_refused) {
    static const struct { const char *name, *text, *words;
    } files[] = {
        { "empty.obj", "", "empty.obj" },
        { "points.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\np 1 2 3\n", "no triangles" },
        { "index.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9999\n", "index.obj" },
        { "nan.obj", "g door\nv nan 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "finite" },
        { "far.obj", "v 1e30 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "vertex 0" },
        { "text.gltf", "this is no JSON KHR_materials_emissive_strength", "text.gltf" },
        { "nodes.gltf", "{\"asset\":{\"version\":\"2.0\"},\"scene\":0,\"scenes\":[{\"nodes\":[0]}],"
          "\"nodes\":[{\"children\":[0]}]}",
          "nodes.gltf" },
        { "types.gltf",
          "{\"asset\":{\"version\":\"2.0\"},\"materials\":{\"extensions\":\"KHR_materials_emissive_strength\"},"
              "\"cameras\":7,\"scene\":[]}",
          "types.gltf" },
        { "short.glb", "glTF\2\0\0\0", "short.glb" },
        { "lies.glb", "glTF\2\1\1\1\377\377\377\177\377\377\377\177JSON{\"aspectRatio\":1}", "lies.glb" },
        { "kind.unknown", "hello", "kind.unknown" },
        { "line\nfeed.obj", "v 0 0 0\n", "line?feed.obj" }
    };
    char deep[3000], *text;
    size_t i;
    for (i = 0; i < sizeof files / sizeof files[0]; i++) {
        write_text(files[i].name, files[i].text);
        TOOL(files[i].name, "--size", "8x8", SMALL, "-o", "refused.png");
        check_refused(files[i].name, files[i].words);
    }
    memset(deep, '[', sizeof deep - 1);
    deep[sizeof deep - 1] = 0;
    text = (char *)malloc(4096);
    sprintf(text, "{\"KHR_materials_emissive_strength\":%s", deep);
    write_text("deep.gltf", text);
    free(text);
    TOOL("deep.gltf", "-o", "refused.png");
    check_refused("deep.gltf", "deep.gltf");
    TOOL("nan.obj", "--quiet", "-o", "refused.png");
    check_refused("nan.obj with --quiet", "door");
}

static int tried;
static void try_file(const char *path) {
    static const char *const kinds[] = { ".obj", ".gltf", ".glb", ".off", ".dae", ".ply", ".3ds", ".ase", ".lwo",
        ".md5mesh", ".raw", ".smd", ".x", ".xml", NULL };
    const char *ending = strrchr(strrchr(path, '/'), '.');
    char full[4096];
    int i;
    for (i = 0; ending && kinds[i] && strcmp(ending, kinds[i]) != 0; i++) continue;
    if ((ending && !kinds[i]) || !realpath(path, full)) return;
    tried++;
    /* Only every third file is rendered with bounced light, because that takes twice as long. */
    TOOL(full, "--quiet", "--mode", tried % 3 ? "direct" : "gi", "--size", "8x6", "--sensor-size", "4", "--samples",
         "1", "--tile", "8", "--threshold", "100", "--memory", "1G", "-o", "hostile.png");
    if (SANITIZED && ran.status == 1 && strstr(ran.err, "SUMMARY: AddressSanitizer")) {
        /* Readers run in a process of their own. With the sanitizer, a crash of that process is reported here; it must
           be in libassimp, not in our code. */
        const char *summary = strstr(ran.err, "SUMMARY: AddressSanitizer"),
                   *memory = strstr(ran.err, "ERROR: AddressSanitizer: requested allocation size");
        if (!memory) memory = strstr(ran.err, "ERROR: AddressSanitizer: allocator is out of memory");
        CHECK((strstr(summary, "libassimp") || (memory && strstr(memory, "libassimp"))) &&
              strstr(summary, "sbl_render: "), "%s: %s", path,
              ran.err);
    } else if (SANITIZED && strncmp(ran.err, "ai_assert failure in ", 21) == 0)
        CHECK(ran.status == 1 && ran.err_lines == 2, "%s: exit status %d: %s", path, ran.status, ran.err);
    else
        CHECK((ran.status == 0 && !ran.err[0]) || (ran.status == 1 && ran.err_lines == 1), "%s: exit status %d: %s",
              path, ran.status,
              ran.err);
    CHECK(exists("hostile.png") == (ran.status == 0) && !parts_left(), "%s: exit status %d, but the picture is%s there",
          path, ran.status,
          exists("hostile.png") ? "" : " not");
    remove(in_folder("hostile.png"));
}
static int by_name(const FTSENT **a, const FTSENT **b) { return strcmp((*a)->fts_name, (*b)->fts_name); }
/* Every file of a collection of damaged scenes is rendered or refused without a crash. The files are tried in the order
   of their names, so that the same ones meet the sanitizer each time. */
TEST(collected_hostile_files) {
    char top[] = "../shared/scenes/hostile", *tops[] = { top, NULL };
    struct stat info;
    FTSENT *entry;
    FTS *walk;
    if (stat(top, &info) != 0) SKIP("no ../shared/scenes/hostile beside the repository");
    walk = fts_open(tops, FTS_PHYSICAL | FTS_NOCHDIR, by_name);
    while (walk && (entry = fts_read(walk)))
        if (entry->fts_info == FTS_F) try_file(entry->fts_path);
    if (walk) fts_close(walk);
    CHECK(tried > 50, "only %d files were tried", tried);
}

/* When a write fails, the old file remains, and no temporary file is left. */
TEST(a_file_is_written_whole_or_not_at_all) {
    static const char *const arguments[] = { "room.obj", "--size", "64x48", SMALL, "--mode", "direct", "-o",
        "whole.pfm", NULL };
    static const char *const png[] = { "room.obj", "--size", "64x48", SMALL, "--channel", "position", "-o", "whole.png",
        NULL };
    static const char *const exr[] = { "room.obj", "--size", "64x48", SMALL, "--channel", "position", "-o", "whole.exr",
        NULL };
    static const char *const link_to[] = { "room.obj", "--size", "8x8", SMALL, "--mode", "direct", "-o", "link.pfm",
        NULL };
    static const char *const *const all[] = { arguments, png, exr };
    static const char *const names[] = { "whole.pfm", "whole.png", "whole.exr" };
    char text[64], stats[4096];
    struct stat info;
    ssize_t got;
    int i, lines, reader;
    room_obj();
    for (i = 0; i < 3; i++) {
        write_text(names[i], "old\n");
        finish(start(all[i], -1, 500));  /* the limit of the file size acts like a full disk */
        CHECK(ran.status == 1 && strstr(ran.err, names[i]) && ran.err_lines == 1, "%s: exit status %d: %s", names[i],
              ran.status, ran.err);
        read_text(in_folder(names[i]), text, sizeof text, &lines);
        CHECK(strcmp(text, "old\n") == 0, "%s: the old file should have stayed", names[i]);
        CHECK(!parts_left(), "%s: %d temporary files are left", names[i], leftovers);
    }
    CHECK(run(arguments) == 0 && stat(in_folder("whole.pfm"), &info) == 0 && info.st_size > 64 * 48 * 12,
          "exit status %d: %s", ran.status,
          ran.err);
    /* A symbolic link stays a link, and the file behind it is written. Statistics can go into a pipe. */
    CHECK(symlink("whole.pfm", in_folder("link.pfm")) == 0 && run(link_to) == 0 &&
          lstat(in_folder("link.pfm"), &info) == 0 &&
              S_ISLNK(info.st_mode) && stat(in_folder("whole.pfm"), &info) == 0 && info.st_size < 1000,
          "a link should be written through: %s", ran.err);
    reader = mkfifo(in_folder("pipe"), 0666) == 0 ? open(in_folder("pipe"), O_RDONLY | O_NONBLOCK) : -1;
    REQUIRE(reader >= 0, "no pipe: %s", strerror(errno));
    CHECK(TOOL(ROOM, "-o", "room.pfm", "--stats", "pipe") == 0 && lstat(in_folder("pipe"), &info) == 0 &&
          S_ISFIFO(info.st_mode),
          "a pipe should stay one: %s", ran.err);
    got = read(reader, stats, sizeof stats - 1);
    stats[got > 0 ? got : 0] = 0;
    CHECK(json_number(stats, "triangles") == 6.0, "statistics into a pipe: %s", stats);
    close(reader);
}

/* The progress bar appears only if stderr is a terminal, and not with --quiet. */
TEST(progress_is_for_terminals) {
    static const char *const arguments[] = { "room.obj", "--size", "160x120", "--tile", "1",
        "-o", "bar.png", NULL };
    static const char *const quiet[] = { "room.obj", "--size", "16x12", SMALL, "--quiet", "-o", "bar.png", NULL };
    static char shown[1 << 16];
    size_t n;
    int i, master, slave;
    room_obj();
    for (i = 0; i < 2; i++) {
        pid_t child;
        struct pollfd waiting;
        const char *name;
        master = posix_openpt(O_RDWR | O_NOCTTY);
        if (master < 0 || grantpt(master) != 0 || unlockpt(master) != 0 || (name = ptsname(master)) == NULL ||
            (slave = open(name, O_RDWR | O_NOCTTY)) < 0)
            SKIP("no pseudo-terminals");
        child = start(i ? quiet : arguments, slave, 0);
        close(slave);
        waiting.fd = master;
        waiting.events = POLLIN;
        for (n = 0; poll(&waiting, 1, -1) > 0 && n < sizeof shown - 1;) {
            ssize_t got = read(master, shown + n, sizeof shown - 1 - n);
            if (got <= 0) break;
            n += (size_t)got;
        }
        shown[n] = 0;
        finish(child);
        close(master);
        CHECK(ran.status == 0, "exit status %d: %s", ran.status, shown);
        if (i) CHECK(n == 0, "--quiet should say nothing: %s", shown);
        else
            CHECK(strstr(shown, "%") && strstr(shown, "\r["), "expected a bar with a percentage: %s", shown);
    }
    CHECK(run(arguments) == 0 && !strchr(ran.err, '\r'), "a progress bar was written to a file: %s", ran.err);
}

/* A .png is exposed and tone-mapped by default: a room whose lamp is a thousand times brighter or darker gives the same
   picture. --tone none --exposure 0 writes the plain values, and one line says that these are too bright. */
TEST(a_png_is_made_for_screens) {
    static const char *const lamps[] = { "0.004", "4", "4000" };
    unsigned char *png[3], *none;
    int i, k, width, height, channels, worst = 0, white = 0;
    for (i = 0; i < 3; i++) {
        char text[1024];
        snprintf(text, sizeof text, "newmtl lamp\nKe %s %s %s\nnewmtl wall\nKd 0.8 0.8 0.8\n", lamps[i], lamps[i],
                 lamps[i]);
        write_text("lit.mtl", text);
        write_text("lit.obj", "mtllib lit.mtl\nv -1 -1 -1\nv 1 -1 -1\nv 1 1 -1\nv -1 1 -1\nv -1 -1 1\nv 1 -1 1\n"
                   "v 1 1 1\nv -1 1 1\nusemtl wall\nf 1 2 3 4\nf 1 5 6 2\nf 1 4 8 5\nf 2 6 7 3\nusemtl lamp\n"
                   "v -0.3 0.9 -0.6\nv 0.3 0.9 -0.6\nv 0.3 0.9 0\nv -0.3 0.9 0\nf 9 10 11 12\n");
        CHECK(TOOL("lit.obj", "--eye", "0,0,1.5", "--look-at", "0,0,0", "--fov", "50", "--size", "32x32", "--mode",
                   "direct", "-o", "lit.png") == 0 && !ran.err[0], "exit status %d: %s", ran.status, ran.err);
        png[i] = stbi_load(in_folder("lit.png"), &width, &height, &channels, 3);
        REQUIRE(png[i], "no picture");
    }
    for (k = 0; k < 3 * 32 * 32; k++) {
        worst = abs(png[0][k] - png[1][k]) > worst ? abs(png[0][k] - png[1][k]) : worst;
        worst = abs(png[2][k] - png[1][k]) > worst ? abs(png[2][k] - png[1][k]) : worst;
        white += png[1][k] == 255;
    }
    CHECK(worst <= 2 && white < 150, "the pictures differ by %d, %d bytes are white", worst, white);
    CHECK(TOOL("lit.obj", "--eye", "0,0,1.5", "--look-at", "0,0,0", "--fov", "50", "--size", "32x32", "--mode",
               "direct", "--tone", "none", "--exposure", "0", "-o", "lit.png") == 0 && ran.err_lines == 1 &&
          strstr(ran.err, "of the picture is white") && strstr(ran.err, "--exposure"), "expected a line on white: %s",
          ran.err);
    none = stbi_load(in_folder("lit.png"), &width, &height, &channels, 3);
    for (k = white = 0; none && k < 3 * 32 * 32; k++) white += none[k] == 255;
    CHECK(white > 1500, "without a tone, %d bytes are white", white);
    CHECK(TOOL("lit.obj", "--eye", "0,0,9", "--look-at", "0,0,20", "--size", "8x8", "--mode", "direct", "--sky",
               "0,0,0", "-o", "lit.png") == 0 && strstr(ran.err, "100 % of the picture is black"),
          "expected a line on black: %s", ran.err);
    CHECK(TOOL("lit.obj", "--eye", "0,0,9", "--look-at", "0,0,20", "--size", "8x8", "--mode", "direct", "--sky",
               "9,0,0", "--tone", "none", "--exposure", "0", "-o", "lit.png") == 0 && !said("white") && !said("black"),
          "a red picture is neither white nor black: %s", ran.err);
    for (i = 0; i < 3; i++) stbi_image_free(png[i]);
    stbi_image_free(none);
}

#define LIT_SHOT "lit.obj", "--eye", "0,0,9", "--look-at", "0,0,0", "--size", "32x32", "--mode", "direct"

/* In a .png, a file with its own light has a grey backdrop instead of a black one, unless --sky is given. The backdrop
   is not light: a .pfm does not contain it. */
TEST(a_lit_object_has_a_backdrop) {
    static const char *const options[3] = { "--quiet", "--sky=0,0,0", "--studio" };
    picture p;
    int i, width, height, channels;
    write_text("lit.mtl", "newmtl lamp\nKe 9 9 9\n");
    write_text("lit.obj", "mtllib lit.mtl\nusemtl lamp\nv -1 -1 0\nv 1 -1 0\nv 0 1 0\nf 1 2 3\n");
    CHECK(TOOL(LIT_SHOT, "-o", "lit.png") == 0 && ran.err_lines == 1 && said("lights but no sky: a grey backdrop") &&
          said("--sky 0,0,0 turns it off"), "exit status %d: %s", ran.status, ran.err);
    for (i = 0; i < 3; i++) {
        unsigned char *png;
        const int least = i == 1 ? 0 : 40, most = i == 1 ? 0 : i == 2 ? 255 : 100;
        CHECK(TOOL(LIT_SHOT, "-o", "lit.png", options[i]) == 0 && !said("backdrop"), "%s: %s", options[i], ran.err);
        png = stbi_load(in_folder("lit.png"), &width, &height, &channels, 3);
        CHECK(png && png[0] >= least && png[0] <= most && png[3 * 31 * 32] >= least && png[3 * 31 * 32] <= most,
              "%s: %d above, %d below", options[i], png ? png[0] : 0, png ? png[3 * 31 * 32] : 0);
        stbi_image_free(png);
    }
    CHECK(TOOL(LIT_SHOT, "-o", "lit.pfm") == 0 && !ran.err[0], "exit status %d: %s", ran.status, ran.err);
    p = read_pfm("lit.pfm");
    REQUIRE(p.values, "no picture");
    CHECK(p.values[0] == 0.0f && at(&p, 16, 16, 0) > 8.9, "%g in a corner, %g in the middle", (double)p.values[0],
          at(&p, 16, 16, 0));
    free(p.values);
}

/* --help shows at most 40 lines, in groups; --help all has the same groups and every option. */
TEST(help_is_short_or_complete) {
    static const char *const names[] = {
        "--output", "-o", "--channel", "--size", "--eye", "--look-at", "--up", "--fov", "--sky", "--sky-rotation",
        "--sky-scale", "--sky-up", "--mode", "--preset", "--backend", "--rays", "--max-bounce-cells", "--epsilon",
        "--sensor-size", "--sensor-fov", "--tile", "--threshold", "--filter-radius", "--exposure", "--seed",
        "--quiet", "--stats", "--samples", "--inspect", "--allow-path", "--memory", "--read-time", "--verbose",
        "130", "640x480", "sbl.png", "--target-error", "--error", "--facet-limit", "--store", "--help", "--version",
        "--bounce-samples", "Ctrl-C", "--studio", "--tone", "--store-replace",
        "--light-scale", "--materials", "--window", "--part", "--plan", "--resume"
    };
    static const char *const groups[] = { "Task:", "Camera:", "Light:", "Quality:", "Output:", "Safety:" };
    char all[sizeof ran.out];
    size_t i, k;
    TOOL("--help", "all");
    strcpy(all, ran.out);
    CHECK(ran.status == 0 && !ran.err[0], "exit status %d: %s", ran.status, ran.err);
    CHECK(longest_line(all) <= 80, "--help all prints lines of up to %d characters", longest_line(all));
    for (i = 0; i < sizeof names / sizeof names[0]; i++)
        CHECK(strstr(ran.out, names[i]), "--help all does not mention %s", names[i]);
    CHECK(!strstr(ran.out, "Other:"), "an option is in no group: %s", strstr(ran.out, "Other:"));
    CHECK(TOOL("--help=all") == 0 && strcmp(ran.out, all) == 0, "--help=all differs");
    CHECK(TOOL("--help", "some.obj") == 0 && ran.out_lines <= 40 && longest_line(ran.out) <= 80,
          "--help prints %d lines of up to %d characters", ran.out_lines, longest_line(ran.out));
    CHECK(strstr(ran.out, "--help all explains all options") && !strstr(ran.out, "Exit status"), "%s", ran.out);
    for (k = 0; k < 2; k++) {
        const char *at = k ? all : ran.out;
        for (i = 0; at && i < sizeof groups / sizeof groups[0]; i++) {
            at = strstr(at, groups[i]);
            CHECK(at && at[-1] == '\n', "%s is missing, or not in its place", groups[i]);
        }
    }
    CHECK(TOOL("--help=some") == 2 && said("the value must be all"), "%s", ran.err);
    CHECK(TOOL("--version") == 0 && strncmp(ran.out, "sbl_render ", 11) == 0 && isdigit((unsigned char)ran.out[11]),
          "--version: %s", ran.out);
}

/* For a misspelled option, the message suggests the option that it resembles, if there is one. */
TEST(misspelled_options_are_recognised) {
    static const struct { const char *typed, *meant; } words[] = {
        { "--exposre", "--exposure" }, { "--expsoure=2", "--exposure" }, { "--eror", "--error" }, { "-size", "--size" },
        { "--look_at", "--look-at" }, { "--sampels", "--samples" }, { "--target", "--target-error" },
        { "--bounce-sample", "--bounce-samples" }, { "--fog", "--fov" }, { "--width", NULL }, { "--s", NULL },
        { "--zebra", NULL }, { "--ep", NULL }, { "--sky-", "--sky" }, { "--=", NULL },
        { "--max-bounce-cells-and-much-more-than-any-name-can-be", NULL } };
    char text[64];
    size_t i;
    for (i = 0; i < sizeof words / sizeof *words; i++) {
        snprintf(text, sizeof text, "did you mean %s?\n", words[i].meant ? words[i].meant : "");
        CHECK(TOOL("room.obj", words[i].typed) == 2 && ran.err_lines == 1 && said("there is no option "), "%s: %s",
              words[i].typed, ran.err);
        CHECK(words[i].meant ? said(text) : said("; see --help\n"), "%s: %s", words[i].typed, ran.err);
    }
}

/* A message about a value describes the allowed values, with numbers as people write them. */
TEST(messages_show_what_values_look_like) {
    static const struct { const char *option, *value, *words; } lines[] = {
        { "--error", "3", "--error 3: the value must be a fraction, such as 2% or 0.02, from 0.01% to 100%\n" },
        { "--sky", "blue", "must be three numbers R,G,B from 0 to 1e30, or a picture file such as noon.hdr\n" },
        { "--eye", "1,2", "must be three numbers X,Y,Z from -1e18 to 1e18\n" },
        { "--size", "640", "must be WxH with whole numbers from 1 to 16384\n" },
        { "--inspect", "5", "must be two whole numbers X,Y from 0 to 16383\n" },
        { "--window", "1,2,3", "must be four whole numbers X,Y,W,H from 0 to 16384\n" },
        { "--fov", "wide", "must be a number from 1 to 179\n" },
        { "--max-bounce-cells", "9", "must be a whole number from 1024 to 1048576\n" },
        { "--seed", "-1", "must be a whole number from 0 to 2147483647\n" },
        { "--mode", "gl", "must be gi, ambient, direct or paper\n" },
        { "--materials", "glossy", "must be file or matte\n" },
        { "--memory", "1K", "must be a size from 16M to 1024T, such as 512M or 4G\n" },
        { "--rays", NULL, "--rays needs a value: a whole number from 1 to 4096\n" },
        { "--stats", NULL, "--stats needs a value: FILE\n" } };
    size_t i;
    for (i = 0; i < sizeof lines / sizeof *lines; i++) {
        TOOL("room.obj", lines[i].option, lines[i].value);
        CHECK(ran.status == 2 && said(lines[i].words), "expected \"%s\": %s", lines[i].words, ran.err);
    }
}

/* One warning names the options without effect, and no others. */
TEST(options_without_effect_are_named) {
    /* options of one picture, of which up to three have no effect, and a part of the message on each */
    static const struct { const char *words[3], *options[8]; } lines[] = {
        { { "--sensor-size (rays" }, { "--sensor-size", "8" } },
        { { "--samples (only", "--tone (only channel final" }, { "--samples", "4", "--tone", "agx", "--channel",
            "radiance" } },
        { { "--exposure (only a .png" }, { "--exposure", "1", "-o", "idle.pfm" } },
        { { "--exposure (only final", "--seed (the channel" }, { "--exposure", "1", "--seed", "2", "--channel",
            "normal" } },
        { { "--target-error (--rays and --tile" }, { "--error", "9%", "--rays", "16", "--tile", "1" } },
        { { "--target-error (the channel" }, { "--error", "0.2%", "--channel", "depth" } },
        { { "--light-scale (the file has no lights" }, { "--light-scale", "2" } },
        { { "--max-bounce-cells (only" }, { "--max-bounce-cells", "2048", "--mode", "direct" } },
        { { "--threshold (--tile" }, { "--threshold", "0.1", "--tile", "1" } },
        { { "--target-error (--rays and --threshold" }, { "--error", "9%", "--rays", "16", "--threshold", "1" } },
        { { "--rays (", "--seed (", "--target-error (in" }, { "--rays", "16", "--seed", "1", "--error", "9%", "--mode",
            "paper" } },
        { { NULL }, { "--error", "9%", "--rays", "16" } },
        { { NULL }, { "--sensor-size", "8", "--backend", "raster", "--error", "9%" } },
        { { NULL }, { "--sensor-size", "8", "--mode", "paper", "--threshold", "0.1" } },
        { { NULL }, { "--exposure", "1", "--channel", "radiance" } } };
    size_t i;
    int k;
    room_obj();
    for (i = 0; i < sizeof lines / sizeof *lines; i++) {
        const char *const *o = lines[i].options;
        CHECK(TOOL("room.obj", "--sky", "1,1,1", "--size", "8x8", "-o", "idle.png", o[0], o[1], o[2], o[3], o[4], o[5],
                   o[6], o[7]) == 0, "%s: %s", o[0], ran.err);
        CHECK(lines[i].words[0] ? ran.err_lines == 1 && said("warning: no effect: ") : !ran.err[0], "%s %s: %s", o[0],
              o[2] ? o[2] : "", ran.err);
        for (k = 0; k < 3 && lines[i].words[k]; k++)
            CHECK(said(lines[i].words[k]), "%s, %s: %s", o[0], lines[i].words[k], ran.err);
    }
    CHECK(TOOL("room.obj", "--size", "8x8", "-o", "idle.pfm", "--sensor-size", "8", "--rays", "8", "--tile", "1",
               "--threshold", "1") == 0 && ran.err_lines == 1 && said("--sensor-size (") && said(", --threshold ("),
          "%s", ran.err);
    CHECK(TOOL("room.obj", "--size", "8x8", "-o", "idle.png", "--sensor-size", "8", "--quiet") == 0 && !ran.err[0],
          "%s", ran.err);
}

/* --verbose prints findings and choices. */
TEST(choices_are_printed) {
    static const char *const lines[] = { "\nsbl_render: light: 2 emitting triangles, 0 lights, sky 0,0,0.5\n",
        "camera: of the options: --eye 0,1.4,3 --look-at 0,", " --up 0,1,0 --fov 40\n", "\nsbl_render: exposure: ",
        "\nsbl_render: mode: direct\n", "\nsbl_render: size: 24 x 16, ", "\nsbl_render: target error: 5 %, predicted ",
        "\nsbl_render: back end: trace\n", "\nsbl_render: OpenGL renderer: " };
    /* from above, from below, and away from the scene */
    static const char *const views[3][3] = {
        { "0,6,0", "0,1,0", "--eye 0,6,0 --look-at 0,1,0 --up 0,0,-1 " },
        { "0,-6,0", "0,1,0", "--eye 0,-6,0 --look-at 0,1,0 --up 0,0,1 " },
        { "0,1,3", "0,1,4", "--eye 0,1,3 --look-at 0,1,4 --up 0,1,0 " } };
    size_t i;
    room_obj();
    for (i = 0; i < 3; i++)
        CHECK(TOOL("room.obj", "--size", "8x8", "--channel", "normal", "--eye", views[i][0], "--look-at", views[i][1],
                   "--verbose", "-o", "told.pfm") == 0 && said(views[i][2]), "view %d: %s", (int)i, ran.err);
    TOOL(ROOM, "--mode", "direct", "--preset", "draft", "--sky", "0,0,0.5", "--verbose", "-o", "told.png");
    for (i = 0; i < sizeof lines / sizeof *lines; i++)
        CHECK(ran.status == 0 && said(lines[i]), "\"%s\" is missing: %s", lines[i], ran.err);
    TOOL("room.obj", SMALL, "--size", "8x8", "--verbose", "-o", "told.png");
    CHECK(ran.status == 0 && said("camera: in front of an object: --eye "), "%s", ran.err);
    CHECK(TOOL("room.obj", SMALL, "--size", "8x8", "-o", "told.pfm") == 0 && !ran.err[0], "%s", ran.err);
}

#define SOFTPIPE_BOX scene, "--eye", "278,273,-800", "--look-at", "278,273,0", "--fov", "39.3", "--mode", "direct"

/* Makes Mesa use softpipe, which interprets shaders. */
static void use_softpipe(void) {
    setenv("LIBGL_ALWAYS_SOFTWARE", "1", 1);
    setenv("GALLIUM_DRIVER", "softpipe", 1);
    setenv("ASAN_OPTIONS", "detect_leaks=0", 1);  /* the driver itself leaks */
}

/* On softpipe, whose loops once did not end, the Cornell box is as bright as on other drivers. */
TEST(softpipe_finishes_the_cornell_box) {
    char scene[1024];
    double sums[2] = { 0, 0 };
    int i, k;
    if (!realpath("examples/scenes/cornell_box.obj", scene)) SKIP("not run in the repository's root");
    for (k = 0; k < 2; k++) {
        picture p;
        in_child = k ? use_softpipe : NULL;
        CHECK(TOOL(SOFTPIPE_BOX, "--size", "16x16", "--rays", "4", "--channel", "radiance", "-o", "box.pfm") == 0,
              "run %d: exit status %d: %s", k, ran.status, ran.err);
        in_child = NULL;
        p = read_pfm("box.pfm");
        for (i = 0; p.values && i < 3 * 16 * 16; i++) sums[k] += (double)p.values[i];
        free(p.values);
    }
    CHECK(sums[0] > 0 && fabs(sums[1] / sums[0] - 1) < 0.03, "the sums of R are %g and, on softpipe, %g", sums[0],
          sums[1]);
}

static void use_stuck_driver(void) { setenv("LD_PRELOAD", "./stuck.so", 1); }

/* One signal ends the tool within 10 s, even if the driver never returns. */
TEST(a_signal_ends_a_stuck_driver) {
    static const char *const source = "#include <unistd.h>\n"
        "unsigned eglInitialize(void *d, int *a, int *b) { for (;;) { write(2, \"stuck\", 5); pause(); } }\n";
    char text[4096] = "", command[512];
    struct timespec from, to;
    double seconds;
    int i, lines;
    pid_t child;
    room_obj();
    write_text("stuck.c", source);
    snprintf(command, sizeof command, "cd '%s' && cc -w -shared -fPIC -o stuck.so stuck.c", folder);
    if (system(command) != 0) SKIP("there is no compiler cc");
    in_child = use_stuck_driver;
    child = start((const char *const[]){ RED_ROOM, "-o", "stuck.pfm", NULL }, -1, 0);
    in_child = NULL;
    for (i = 0; i < 6000 && !strstr(text, "stuck"); i++) {
        poll(NULL, 0, 10);
        read_text(in_folder("stderr"), text, sizeof text, &lines);
    }
    clock_gettime(CLOCK_MONOTONIC, &from);
    kill(child, SIGTERM);
    finish(child);
    clock_gettime(CLOCK_MONOTONIC, &to);
    seconds = (double)(to.tv_sec - from.tv_sec) + 1e-9 * (double)(to.tv_nsec - from.tv_nsec);
    CHECK(ran.status == 128 + SIGTERM && said("the graphics driver did not return") && !exists("stuck.pfm") &&
          !parts_left(), "exit status %d: %s", ran.status, ran.err);
    CHECK(seconds > 4 && seconds < 10, "the tool ended %.1f s after the signal", seconds);
}

/* The Cornell box in examples/scenes has a red left wall, a green right wall and a white back wall. */
TEST(the_cornell_box_of_the_repository) {
    picture albedo;
    char text[8192];
    int lines;
    char scene[4096];
    if (!realpath("examples/scenes/cornell_box.obj", scene)) SKIP("not run in the repository's root");
    REQUIRE(TOOL(scene, "--size", "64x64", "--eye", "278,273,-800", "--look-at", "278,273,0", "--fov", "39.3077", SMALL,
                 "--channel",
                 "albedo", "--stats", "stats.json", "-o", "box.pfm") == 0,
            "exit status %d: %s", ran.status, ran.err);
    read_text(in_folder("stats.json"), text, sizeof text, &lines);
    CHECK(json_number(text, "triangles") == 32.0, "%g triangles", json_number(text, "triangles"));
    albedo = read_pfm("box.pfm");
    REQUIRE(albedo.values, "the picture is not there");
    CHECK(fabs(at(&albedo, 4, 32, 0) - 0.6) < 0.01 && fabs(at(&albedo, 4, 32, 1) - 0.1) < 0.01,
          "the left wall should be red");
    CHECK(fabs(at(&albedo, 59, 32, 1) - 0.6) < 0.01 && fabs(at(&albedo, 59, 32, 0) - 0.1) < 0.01,
          "the right wall should be green");
    CHECK(fabs(at(&albedo, 32, 20, 2) - 0.75) < 0.01, "the back wall should be white");
    free(albedo.values);
}

int main(int argc, char **argv) {
    (void)argc;
    if (!tool_begin(argv[0])) return 1;
    RUN(help_is_short_or_complete);
    RUN(misspelled_options_are_recognised);
    RUN(messages_show_what_values_look_like);
    RUN_PLAIN(options_without_effect_are_named);
    RUN(choices_are_printed);
    RUN(wrong_usage_gives_status_2);
    RUN(failures_give_status_1);
    RUN(messages_name_no_fields);
    RUN(obj_materials_and_textures);
    RUN(gltf_materials_and_camera);
    RUN(glb_materials_and_camera);
    RUN(each_use_of_a_mesh_has_an_id);
    RUN(blenders_first_camera_is_not_used_inside);
    RUN(options_override_the_files_camera);
    RUN(without_a_camera_the_scene_is_framed);
    RUN(a_file_without_light_gets_a_studio);
    RUN_PLAIN(the_edge_of_the_ground_is_not_seen);
    RUN_PLAIN(who_gets_a_studio);
    RUN_PLAIN(the_camera_tells_rooms_from_objects);
    RUN_PLAIN(a_lit_room_with_thick_walls_is_looked_at_from_inside);
    RUN_PLAIN(the_cornell_box_is_seen_from_its_open_side);
    RUN(png_is_the_encoded_pfm);
    RUN_PLAIN(every_channel_is_written);
    RUN(surfaces_need_no_light);
    RUN(exr_is_written_or_refused);
    RUN_PLAIN(windows_are_parts_of_the_picture);
    RUN(statistics_have_every_field);
    RUN(rays_can_be_traced);
    RUN(light_bounces_by_default);
    RUN(bounced_light_is_kept);
    RUN(stores_are_not_overwritten);
    RUN(stores_in_closed_folders);
    RUN_PLAIN(coarse_stores);
    RUN(stores_are_never_lost);
    RUN(a_sensor_can_be_inspected);
    RUN_PLAIN(zero_options_mean_zero);
    RUN_PLAIN(facet_limit_zero_is_zero);
    RUN(old_names_of_options);
    RUN(lights_of_a_gltf_scene);
    RUN(a_light_of_many_nodes);
    RUN(spots_of_gltf);
    RUN(lights_of_other_formats);
    RUN_PLAIN(broken_lights_are_left_out);
    RUN_PLAIN(units_of_blender);
    RUN_PLAIN(substitutions_are_named);
    RUN(dropped_parts_of_gltf_are_named);
    RUN(cameras_and_units_are_named);
    RUN(the_converter_names_what_it_drops);
    RUN(missing_mtl_files_are_named);
    RUN_PLAIN(materials_can_be_matte);
    RUN_PLAIN(normal_maps_are_shown);
    RUN_PLAIN(a_missed_target_is_said);
    RUN_PLAIN(advice_on_a_missed_target_helps);
    RUN(sky_pictures);
    RUN_PLAIN(sky_pictures_turn);
    RUN(a_sensor_may_meet_nothing);
    RUN(broken_sky_pictures_are_refused);
    RUN(hostile_files_are_refused);
    RUN(collected_hostile_files);
    RUN(a_file_is_written_whole_or_not_at_all);
    RUN(progress_is_for_terminals);
    RUN_PLAIN(a_png_is_made_for_screens);
    RUN_PLAIN(a_lit_object_has_a_backdrop);
    RUN(the_cornell_box_of_the_repository);
    RUN_PLAIN(softpipe_finishes_the_cornell_box);
    RUN_PLAIN(a_signal_ends_a_stuck_driver);
    tool_end();
    return test_report();
}
