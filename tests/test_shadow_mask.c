/* Tests of sbl_bake --shadow-mask. The visibility of lights on a floor with a thin wall is compared with the visibility
   that geometry gives. */
#define _GNU_SOURCE
#include "support/test.h"
#include "support/tool.h"
#include "../sbl.h"

enum { SIZE = 32, LIGHTS = 4 };

/* The floor is 4 x 4 in size, and its chart extends from 1/8 to 7/8 of the map, with u along x and v along z. A wall of
   height 1 stands at x = 0, from z = -1 to 1. */
static const float vertices[8][3] = {
    { -2, 0, -2 }, { -2, 0, 2 }, { 2, 0, 2 }, { 2, 0, -2 }, { 0, 0, -1 }, { 0, 1, -1 }, { 0, 1, 1 }, { 0, 0, 1 }
};
static const float places[4][2] = { { 0.125f, 0.125f }, { 0.125f, 0.875f }, { 0.875f, 0.875f }, { 0.875f, 0.125f } };
static const unsigned corners[6] = { 0, 1, 2, 0, 2, 3 };

/* Writes the scene with five lights: a dim lamp beside the wall; a sun that shines down along x at 45 degrees; a spot
   above x = 1 that shines down; a lamp below the floor; and a fifth light. nodes: indices of further nodes in addition
   to the floor and the wall; spot: intensity of the spot */
static void write_wall(const char *name, const char *nodes, double spot) {
    char json[4096];
    FILE *out = fopen(in_folder("wall.bin"), "wb");
    fwrite(vertices, 1, sizeof vertices, out);
    fwrite(places, 1, sizeof places, out);
    fwrite(corners, 1, sizeof corners, out);
    fclose(out);
    snprintf(json, sizeof json,
             "{\"asset\":{\"version\":\"2.0\"},\"extensionsUsed\":[\"KHR_lights_punctual\"],\"scene\":0,"
             "\"extensions\":{\"KHR_lights_punctual\":{\"lights\":[{\"type\":\"point\",\"intensity\":0.001},"
             "{\"type\":\"directional\",\"intensity\":700},{\"type\":\"spot\",\"intensity\":%g,"
             "\"spot\":{\"outerConeAngle\":0.4}},{\"type\":\"point\",\"intensity\":0}]}},"
             "\"scenes\":[{\"nodes\":[0,1%s]}],\"nodes\":[{\"mesh\":0},{\"mesh\":1}"
             ",{\"name\":\"lamp\",\"translation\":[-1,1.25,0.25],"
             "\"extensions\":{\"KHR_lights_punctual\":{\"light\":0}}}"
             ",{\"name\":\"sun\",\"rotation\":[-0.27059805,-0.65328148,-0.27059805,0.65328148],"
             "\"extensions\":{\"KHR_lights_punctual\":{\"light\":1}}}"
             ",{\"name\":\"spot\",\"translation\":[1,2,0],\"rotation\":[-0.70710678,0,0,0.70710678],"
             "\"extensions\":{\"KHR_lights_punctual\":{\"light\":2}}}"
             ",{\"name\":\"below\",\"translation\":[0,-1,0],\"extensions\":{\"KHR_lights_punctual\":{\"light\":0}}}"
             ",{\"name\":\"off\",\"translation\":[0,5,0],\"extensions\":{\"KHR_lights_punctual\":{\"light\":3}}}],"
             "\"meshes\":[{\"primitives\":[{\"attributes\":{\"POSITION\":0,\"TEXCOORD_1\":2},\"indices\":3}]},"
             "{\"primitives\":[{\"attributes\":{\"POSITION\":1},\"indices\":3}]}],\"accessors\":["
             "{\"bufferView\":0,\"componentType\":5126,\"count\":4,\"type\":\"VEC3\","
             "\"min\":[-2,0,-2],\"max\":[2,0,2]},"
             "{\"bufferView\":1,\"componentType\":5126,\"count\":4,\"type\":\"VEC3\","
             "\"min\":[0,0,-1],\"max\":[0,1,1]},"
             "{\"bufferView\":2,\"componentType\":5126,\"count\":4,\"type\":\"VEC2\"},"
             "{\"bufferView\":3,\"componentType\":5125,\"count\":6,\"type\":\"SCALAR\"}],\"bufferViews\":["
             "{\"buffer\":0,\"byteLength\":48},{\"buffer\":0,\"byteOffset\":48,\"byteLength\":48},"
             "{\"buffer\":0,\"byteOffset\":96,\"byteLength\":32},{\"buffer\":0,\"byteOffset\":128,\"byteLength\":24}],"
             "\"buffers\":[{\"uri\":\"wall.bin\",\"byteLength\":152}]}", spot, nodes);
    write_text(name, json);
}

/* Returns 1 if a light reaches a point of the floor. */
static int reaches(int light, double x, double z) {
    const double at = 1 / (x + 1);  /* the share of the way from the lamp to the point at which it crosses the wall */
    if (light == 0) return x < 0 || 1.25 * (1 - at) > 1 || fabs(0.25 + at * (z - 0.25)) > 1;
    if (light == 1) return x < 0 || x > 1 || fabs(z) > 1;
    return light == 2 && hypot(x - 1, z) < 2 * tan(0.4);
}

/* Returns the expected visibility of a light in a texel: the share of its points that the light reaches. For the spot
   it is 1 if any point is in the cone. A texel outside the floor has the value of the closest one at the edge of the
   floor. across: number of points across a texel */
static double share_at(int light, int x, int y, int across) {
    const int low = SIZE / 8, high = SIZE - low - 1;
    int i, lit = 0;
    x = x < low ? low : x > high ? high : x;
    y = y < low ? low : y > high ? high : y;
    for (i = 0; i < across * across; i++)
        lit += reaches(light, ((x + (i % across + 0.5) / across) / SIZE - 0.5) * 16 / 3,
                       ((y + (double)(i / across + 0.5) / across) / SIZE - 0.5) * 16 / 3);
    return light == 2 ? lit > 0 : lit / (double)(across * across);
}

/* Each channel shows the visibility of its light, dim or bright. It is 1 to the edge of the cone of the spot, and
   between 0 and 1 in texels at the edges of shadows. The gutters continue it. */
TEST(channels_show_lights) {
    unsigned char *bytes;
    int i, x, y, wide = 0, high = 0, parts = 0, edges = 0;
    double worst[LIGHTS] = { 0 }, worst_edge = 0;
    write_wall("wall.gltf", ",2,3,4,5,6", 9);
    REQUIRE(TOOL("wall.gltf", "--mode", "direct", "--lightmap", "32", "--preset", "draft", "--shadow-mask",
                 "--supersample", "4", "--lit", "0", "-o", "out") == 0, "%s", ran.err);
    CHECK(said("channel R: the light \"lamp (node 2)\"") && said("channel G: the light \"sun (node 3)\"") &&
          said("1 more light") && said("channel A: the light \"below (node 5)\""), "%s", ran.err);
    bytes = stbi_load(in_folder("out/shadow.png"), &wide, &high, &parts, 4);
    REQUIRE(bytes && wide == SIZE && high == SIZE && parts == 4, "%d x %d, %d channels", wide, high, parts);
    for (i = LIGHTS * SIZE * SIZE / 8; i < LIGHTS * SIZE * SIZE * 7 / 8; i++) {  /* the rows of texels on the floor */
        const int light = i % LIGHTS;
        double expected, off;
        x = i / LIGHTS % SIZE;
        y = i / LIGHTS / SIZE;
        expected = share_at(light, x, y, 4);
        off = fabs(bytes[i] / 255.0 - expected);
        if (expected > 0 && expected < 1) { worst_edge = test_max(worst_edge, off); edges++; }
        else if (y >= SIZE / 8 + 4 && y < SIZE - SIZE / 8 - 4) worst[light] = test_max(worst[light], off);
    }
    printf("  off by %.3f %.3f %.3f %.3f, in %d texels at edges %.3f\n", worst[0], worst[1], worst[2], worst[3], edges,
           worst_edge);
    for (i = 0; i < LIGHTS; i++) CHECK(worst[i] < 0.01, "channel %d is off by %g", i, worst[i]);
    CHECK(edges > 10 && worst_edge < 0.1, "edges are off by %g", worst_edge);
    free(bytes);
#ifdef SBL_RENDER_OPENEXR
    CHECK(exists("out/shadow.exr"), "no .exr");
#endif
}

/* The edge of a cone is sharp even if the light is very dim, although a filter would take such light for noise. */
TEST(rims_are_sharp) {
    unsigned char *bytes;
    int x, y, wide = 0, high = 0, parts = 0, lit = 0;
    write_wall("dim.gltf", ",4,6", 1e-6);
    REQUIRE(TOOL("dim.gltf", "--mode", "direct", "--lightmap", "32", "--preset", "draft", "--shadow-mask",
                 "--supersample", "2", "--lit", "0", "-o", "rims") == 0, "%s", ran.err);
    bytes = stbi_load(in_folder("rims/shadow.png"), &wide, &high, &parts, 4);
    REQUIRE(bytes && wide == SIZE && high == SIZE, "%d x %d", wide, high);
    for (y = SIZE / 8; y < SIZE * 7 / 8; y++)
        for (x = SIZE / 8; x < SIZE * 7 / 8; x++) {
            const int expected = 255 * (int)share_at(2, x, y, 2);
            CHECK(bytes[LIGHTS * (SIZE * y + x)] == expected, "texel %d %d is %d, not %d", x, y,
                  bytes[LIGHTS * (SIZE * y + x)], expected);
            CHECK(abs(2 * x + 1 - SIZE) < 4 || bytes[LIGHTS * (SIZE * y + x) + 1] == 255, "texel %d %d is %d: the "
                  "light above the wall is off, but would reach it", x, y, bytes[LIGHTS * (SIZE * y + x) + 1]);
            lit += expected > 0;
        }
    CHECK(lit > 40, "%d texels are lit", lit);
    free(bytes);
}

#define REFUSED(code, words, ...) \
    CHECK(TOOL(__VA_ARGS__) == code && said(words) && ran.err_lines == 1, "exit status %d: %s", ran.status, ran.err)

TEST(what_cannot_be_is_refused) {
    write_wall("dark.gltf", "", 9);
    REFUSED(1, "the file has no lights", "dark.gltf", "--lightmap", "8", "-o", "new", "--shadow-mask", "--quiet");
    REFUSED(2, "--shadow-mask needs --lightmap", "dark.gltf", "--vertices", "-o", "no.ply", "--shadow-mask");
    REFUSED(2, "baked at once; leave out --part", "dark.gltf", "--lightmap", "8", "-o", "no.exr", "--shadow-mask",
            "--part", "1/2");
    REFUSED(2, "--shadow-mask needs rays", "dark.gltf", "--lightmap", "8", "-o", "new", "--shadow-mask", "--backend",
            "raster");
    CHECK(!exists("new") && !parts_left(), "something is left");
}

int main(int argc, char **argv) {
    (void)argc;
    if (!tool_begin(argv[0])) return 1;
    tool_use("sbl_bake");
    RUN(channels_show_lights);
    RUN(rims_are_sharp);
    RUN(what_cannot_be_is_refused);
    tool_end();
    return test_report();
}
