/* Tests build/sbl_bake as a user runs it, and build/host_lightmap, which draws its output. The scene is a floor below a
   lamp, whose light is known from Lambert's formula. */
#define _GNU_SOURCE
#include "support/test.h"
#include "support/tool.h"
#include "../sbl.h"
#include "support/reference.h"
#include "support/mapped_room.h"

static float apart[QUADS][4] = { { 0.1f, 0.1f, 0.6f, 0.6f }, { 0.7f, 0.7f, 0.9f, 0.9f } };

/* Returns R of the floor at a point of the map. */
static double truth_at(double u, double v) {
    const float *c = apart[FLOOR];
    const v3 p = { -2 + 4 * (u - (double)c[0]) / (double)(c[2] - c[0]) + (double)moved[0], (double)moved[1],
                   -2 + 4 * (v - (double)c[1]) / (double)(c[3] - c[1]) }, n = { 0, 1, 0 };
    v3 corners[4];
    int i;
    for (i = 0; i < 4; i++) {
        corners[i].x = (double)quads[LAMP][i][0];
        corners[i].y = (double)quads[LAMP][i][1];
        corners[i].z = (double)quads[LAMP][i][2];
    }
    return strength * ref_polygon(p, n, corners, 4);
}

#define MAP 64
#define DIRECT "--mode", "direct", "--lightmap", "64", "--quiet", "--formats", MAP_FORMATS
#ifdef SBL_RENDER_OPENEXR
  #define MAP_FORMATS "exr,pfm"
#else
  #define MAP_FORMATS "pfm"
#endif

static int inside(const float *chart, int x, int y) {  /* Returns 1 if the centre of the texel is in the chart. */
    const double u = (x + 0.5) / MAP, v = (y + 0.5) / MAP;
    return u > (double)chart[0] && u < (double)chart[2] && v > (double)chart[1] && v < (double)chart[3];
}

/* Returns 1 if texel and chart overlap. */
static int touches(const float *chart, int x, int y) {
    return x + 1 > MAP * chart[0] && x < MAP * chart[2] && y + 1 > MAP * chart[1] && y < MAP * chart[3];
}

static const float *texel(const picture *p, int x, int y) { return p->values + 3 * (y * p->width + x); }

/* ---- lightmaps ---- */

/* The lightmap equals Lambert's light within 1 % of the brightest texel; atlas.pfm also fills the gutter. */
TEST(a_lightmap_holds_lamberts_light) {
    picture light, atlas;
    int x, y, k, wrong = 0, dark = 0, filled = 0;
    double worst = 0;
    write_scene("room.gltf", apart, 1);
    REQUIRE(TOOL("room.gltf", DIRECT, "-o", "out", "--stats", "out.json") == 0, "exit status %d: %s", ran.status,
            ran.err);
    CHECK(ran.err_lines == 0 && ran.out_lines == 0 && exists("out.json") && !parts_left(), "unexpected output: %s%s",
          ran.err,
          ran.out);
    light = read_pfm("out/lightmap.pfm");
    atlas = read_pfm("out/atlas.pfm");
    REQUIRE(light.values && atlas.values && light.width == MAP && light.height == MAP && atlas.width == MAP,
            "no lightmap");
    for (y = 0; y < MAP; y++)
        for (x = 0; x < MAP; x++) {
            const float *R = texel(&light, x, y), *a = texel(&atlas, x, y);
            const int on = touches(apart[FLOOR], x, y) || touches(apart[LAMP], x, y);
            if (inside(apart[FLOOR], x, y)) {
                const double truth = truth_at((x + 0.5) / MAP, (y + 0.5) / MAP);
                worst = test_max(worst, test_max(fabs((double)R[0] - truth), fabs(2 * (double)R[2] - truth)) /
                                 truth_at(0.35, 0.35));
            }
            for (k = 0; k < 3; k++) {
                wrong += on ? R[k] != a[k] : R[k] != 0.0f;
                filled += !on && a[k] > 0;
                dark += touches(apart[FLOOR], x, y) && !(R[k] > 0);
            }
        }
    CHECK(worst < 0.01, "off by %g of the brightest", worst);
    CHECK(wrong == 0 && dark == 0, "%d values are wrong, %d are dark", wrong, dark);
    CHECK(filled > 3 * 400, "only %d values in the gutter", filled);
    free(light.values);
    free(atlas.values);
#ifdef SBL_RENDER_OPENEXR
    CHECK(exists("out/lightmap.exr") && exists("out/atlas.exr"), "no .exr");
#endif
    CHECK(!exists("out/overlap.png"), "overlap.png was written without an overlap");
}

/* The values of the .png, times the factor in the .gltf, equal the light within one step of 8 bits. A thousandth of the
   lit texels is brighter than the factor. */
TEST(viewers_get_the_same_light) {
    char text[16384];
    const char *extension;
    picture atlas, light;
    unsigned char *png;
    double intensity = 0, worst = 0;
    int lines, width = 0, height = 0, channels, i, index = -1, set = -1, bright = 0, lit = 0, brighter = 0;
    write_scene("room.gltf", apart, 1);
    REQUIRE(TOOL("room.gltf", DIRECT, "-o", "out") == 0, "exit status %d: %s", ran.status, ran.err);
    read_text(in_folder("out/scene.gltf"), text, sizeof text, &lines);
    extension = strstr(text, "\"MOZ_lightmap\": {");
    REQUIRE(extension && sscanf(extension, "\"MOZ_lightmap\": {\"index\": %d, \"texCoord\": %d, \"intensity\": %lf}",
                                &index, &set, &intensity) == 3,
            "no MOZ_lightmap in %s", text);
    CHECK(set == 1 && index == 1 && strstr(text, "\"uri\": \"atlas.png\"") && strstr(text, "TEXCOORD_1") && intensity >
          0, "the extension is %.100s", extension);
    atlas = read_pfm("out/atlas.pfm");
    light = read_pfm("out/lightmap.pfm");
    png = stbi_load(in_folder("out/atlas.png"), &width, &height, &channels, 3);
    REQUIRE(atlas.values && light.values && png && width == MAP && height == MAP, "no atlas");
    for (i = 0; i < 3 * MAP * MAP; i++) {
        const double c = png[i] / 255.0, linear = c <= 0.04045 ? c / 12.92 : pow((c + 0.055) / 1.055, 2.4);
        const double R = intensity * linear / REF_PI, step = 0.012 * intensity / REF_PI;
        bright += png[i] == 255;
        if (png[i] < 255) worst = test_max(worst, fabs(R - (double)atlas.values[i]) / step);
        else CHECK((double)atlas.values[i] > R - step, "texel %d is %g", i / 3, (double)atlas.values[i]);
    }
    CHECK(worst < 1, "off by %g steps of eight bits", worst);
    CHECK(bright > 0 && bright < 3 * 200, "%d values are 255", bright);
    for (i = 0; i < MAP * MAP; i++) {
        const float *v = light.values + 3 * i;
        const double most = test_max((double)v[0], test_max((double)v[1], (double)v[2]));
        lit += most > 0;
        brighter += most > intensity / REF_PI * (1 + 1e-5);
    }
    CHECK(brighter > 0 && brighter <= lit / 1000, "%d of %d texels are brighter", brighter, lit);
    free(atlas.values);
    free(light.values);
    stbi_image_free(png);
}

/* A point light close to the floor makes a small part of it very bright. Eight times the mean of the lit texels becomes
   white then, because a range that contains the brightest texels would leave few steps for all others. */
TEST(a_small_highlight_does_not_darken_the_rest) {
    static const char *const edits[3][2] = {  /* words in the scene, and words that are put behind them */
        { "\"extensionsUsed\":[", "\"KHR_lights_punctual\"," },
        { "\"scenes\":[{\"nodes\":[0,1", ",2" },
        { ",{\"mesh\":1}", ",{\"translation\":[0.25,-0.2,0],\"extensions\":{\"KHR_lights_punctual\":"
                             "{\"light\":0}}}" } };
    char text[16384], rest[16384], *at;
    const char *extension;
    picture light;
    double intensity = 0, sum = 0, most = 0;
    int lines, i, count = 0;
    write_scene("room.gltf", apart, 1);
    read_text(in_folder("room.gltf"), text, sizeof text, &lines);
    for (i = 0; i < 3; i++) {
        at = strstr(text, edits[i][0]);
        REQUIRE(at, "the scene has no %s", edits[i][0]);
        at += strlen(edits[i][0]);
        snprintf(rest, sizeof rest, "%s%s", edits[i][1], at);
        snprintf(at, sizeof text - (size_t)(at - text), "%s", rest);
    }
    strcpy(strrchr(text, '}'), ",\"extensions\":{\"KHR_lights_punctual\":{\"lights\":[{\"type\":\"point\","
           "\"intensity\":50}]}}}");
    write_text("near.gltf", text);
    REQUIRE(TOOL("near.gltf", DIRECT, "--lit", "0", "-o", "near") == 0, "exit status %d: %s", ran.status, ran.err);
    read_text(in_folder("near/scene.gltf"), text, sizeof text, &lines);
    extension = strstr(text, "\"MOZ_lightmap\": {");
    light = read_pfm("near/lightmap.pfm");
    REQUIRE(extension && light.values, "no map");
    REQUIRE(sscanf(strstr(extension, "\"intensity\": "), "\"intensity\": %lf", &intensity) == 1, "%.100s", extension);
    for (i = 0; i < MAP * MAP; i++) {
        const float *v = light.values + 3 * i;
        const double larger = test_max((double)v[0], test_max((double)v[1], (double)v[2]));
        sum += larger;
        count += larger > 0;
        most = test_max(most, larger);
    }
    CHECK(most > 12 * sum / count && fabs(intensity / (8 * REF_PI * sum / count) - 1) < 1e-4,
          "%g becomes white; the mean is %g, the most %g", intensity / REF_PI, sum / count, most);
    free(light.values);
}

/* The written scene is complete: it gives the same lightmap and the same picture as the original. */
TEST(the_scene_is_written_whole) {
    picture light, again, seen, seen_again;
    int i, differ = 0, colored = 0;
    write_scene("room.gltf", apart, 1);
    REQUIRE(TOOL("room.gltf", DIRECT, "-o", "out") == 0, "exit status %d: %s", ran.status, ran.err);
    REQUIRE(TOOL("out/scene.gltf", DIRECT, "-o", "again") == 0, "exit status %d: %s", ran.status, ran.err);
    light = read_pfm("out/lightmap.pfm");
    again = read_pfm("again/lightmap.pfm");
    REQUIRE(light.values && again.values, "no lightmap");
    for (i = 0; i < 3 * MAP * MAP; i++)
        differ += fabs((double)light.values[i] - (double)again.values[i]) > 1e-5 * (double)light.values[i];
    CHECK(differ == 0, "%d values differ", differ);
    tool_use("sbl_render");
    CHECK(TOOL("room.gltf", "--channel", "albedo", "--size", "40x30", "-o", "a.pfm") == 0, "%s", ran.err);
    CHECK(TOOL("out/scene.gltf", "--channel", "albedo", "--size", "40x30", "-o", "b.pfm") == 0, "%s", ran.err);
    tool_use("sbl_bake");
    seen = read_pfm("a.pfm");
    seen_again = read_pfm("b.pfm");
    REQUIRE(seen.values && seen_again.values, "no picture");
    for (i = 0, differ = 0; i < 3 * 40 * 30; i++) {
        differ += fabs((double)seen.values[i] - (double)seen_again.values[i]) > 1e-4;
        colored += i % 3 == 0 && seen.values[i] > 0 && fabs((double)seen.values[i] - (double)seen.values[i + 1]) > 0.05;
    }
    CHECK(differ == 0 && colored > 20, "%d values differ; %d are coloured", differ, colored);
    free(light.values);
    free(again.values);
    free(seen.values);
    free(seen_again.values);
}

/* Overlapping charts cause a warning, and overlap.png marks the shared texels. */
TEST(overlaps_are_shown) {
    static float over[QUADS][4] = { { 0.1f, 0.1f, 0.6f, 0.6f }, { 0.5f, 0.5f, 0.9f, 0.9f } };
    int width = 0, height = 0, channels, x, y, wrong = 0;
    unsigned char *png;
    write_scene("room.gltf", over, 1);
    REQUIRE(TOOL("room.gltf", "--mode", "direct", "--lightmap", "64", "-o", "out") == 0, "exit status %d: %s",
            ran.status, ran.err);
    CHECK(said("share texel") && said("overlap in"), "%s", ran.err);
    png = stbi_load(in_folder("out/overlap.png"), &width, &height, &channels, 3);
    REQUIRE(png && width == MAP && height == MAP, "no overlap.png");
    for (y = 0; y < MAP; y++)
        for (x = 0; x < MAP; x++) {
            const unsigned char *p = png + 3 * (y * MAP + x);
            const int red = p[0] > 200 && p[1] < 50;
            wrong += red != (inside(over[FLOOR], x, y) && inside(over[LAMP], x, y));
        }
    CHECK(wrong == 0, "%d texels are wrong", wrong);
    stbi_image_free(png);
}

/* ---- vertices and probes ---- */

/* The floor has only four corners. Its light at vertices equals the best fit, which the test computes independently. */
TEST(vertices_fit_lamberts_light) {
    enum { HEAD = 1024, VERTEX = 36, CELLS = 200 };
    static unsigned char file[65536];
    FILE *in;
    size_t size;
    const unsigned char *body;
    const char *end;
    double b[4] = { 0 }, best[4], m[4][4] = { { 0 } };
    float v[8][9];
    int i, k, x, y, side, faces = 0, step;
    write_scene("room.gltf", apart, 1);
    REQUIRE(TOOL("room.gltf", "--mode", "direct", "--vertices", "--preset", "high", "-o", "out.ply", "--quiet") == 0 &&
            ran.err_lines == 0,
            "exit status %d: %s", ran.status, ran.err);
    in = fopen(in_folder("out.ply"), "rb");
    REQUIRE(in, "no out.ply");
    size = fread(file, 1, sizeof file - 1, in);
    fclose(in);
    end = strstr((const char *)file, "end_header\n");
    REQUIRE(end && strstr((const char *)file, "ply\nformat binary_little_endian 1.0\n") &&
            strstr((const char *)file, "element vertex 8\n") &&
            strstr((const char *)file, "element face 4\n"), "the head is %.300s", (const char *)file);
    body = (const unsigned char *)end + strlen("end_header\n");
    REQUIRE(size == (size_t)(body - file) + 8 * VERTEX + 4 * 13, "the file has %d bytes", (int)size);
    memcpy(v, body, sizeof v);  /* the test assumes a little-endian machine */
    for (body += 8 * VERTEX; faces < 4; faces++, body += 13) {
        uint32_t corner[3];
        memcpy(corner, body + 1, 12);
        CHECK(body[0] == 3 && corner[0] < 8 && corner[1] < 8 && corner[2] < 8 && (corner[0] < 4) == (corner[2] < 4),
              "face %d", faces);
    }
    /* least squares over the two triangles of the floor, 0 1 2 and 0 2 3, on a fine grid, by Gauss-Seidel */
    for (side = 0; side < 2; side++)
        for (y = 0; y < CELLS; y++)
            for (x = 0; x < CELLS; x++) {
                const double s = (x + 0.5) / CELLS, t = (y + 0.5) / CELLS;  /* position along x and z */
                const double truth = truth_at(0.1 + 0.5 * s, 0.1 + 0.5 * t);
                const double hat[2][4] = { { 1 - t, t - s, s, 0 }, { 1 - s, 0, t, s - t } };
                if ((t > s) != (side == 0)) continue;
                for (i = 0; i < 4; i++) {
                    b[i] += hat[side][i] * truth;
                    for (k = 0; k < 4; k++) m[i][k] += hat[side][i] * hat[side][k];
                }
            }
    for (i = 0; i < 4; i++) best[i] = 0;
    for (step = 0; step < 2000; step++)
        for (i = 0; i < 4; i++) {
            double rest = b[i];
            for (k = 0; k < 4; k++) rest -= k == i ? 0 : m[i][k] * best[k];
            best[i] = rest / m[i][i];
        }
    for (i = 0; i < 8; i++) {
        const int quad = i / 4;
        int found = -1;
        for (k = 0; k < 4; k++)
            if (fabs((double)(v[i][0] - quads[quad][k][0] - (quad ? 0 : moved[0]))) < 1e-5 &&
                fabs((double)(v[i][2] - quads[quad][k][2])) < 1e-5 &&
                fabs((double)(v[i][1] - quads[quad][k][1] - (quad ? 0 : moved[1]))) < 1e-5) found = k;
        CHECK(found >= 0, "vertex %d is at %g %g %g", i, (double)v[i][0], (double)v[i][1], (double)v[i][2]);
        CHECK(fabs((double)v[i][3]) < 1e-5 && fabs(fabs((double)v[i][4]) - 1) < 1e-5 && (v[i][4] > 0) == (quad == 0),
              "normal %g %g %g", (double)v[i][3],
              (double)v[i][4], (double)v[i][5]);
        if (quad == 0 && found >= 0)
            CHECK(fabs((double)v[i][6] - test_max(best[found], 0)) < 0.08 * truth_at(0.35, 0.35) &&
                  fabs(2 * (double)v[i][8] - (double)v[i][6]) < 1e-3,
                  "vertex %d has R = %g %g, expected %g", i, (double)v[i][6], (double)v[i][8], best[found]);
    }
    REQUIRE(TOOL("room.gltf", "--mode", "direct", "--vertices", "-o", "new.gltf", "--quiet") == 0, "exit status %d: %s",
            ran.status, ran.err);
    read_text(in_folder("new.gltf"), (char *)file, sizeof file, &i);
    CHECK(strstr((const char *)file, "\"_RADIANCE\": ") && strstr((const char *)file, "\"uri\": \"new.bin\"") &&
          exists("new.bin") && exists("texture_0.png"),
          "no attribute");
    CHECK(TOOL("new.gltf", DIRECT, "-o", "again") == 0 && exists("again/lightmap.pfm"), "the output cannot be read: %s",
          ran.err);
}

/* The normals of a .ply are those of the file, transformed so that they stay perpendicular to the surface, also if a
   node mirrors its mesh or stretches it. */
TEST(normals_of_a_ply_are_in_world_space) {
    enum { NODES = 3, VERTEX = 9 };
    static const float vertices[18] = { 0, 0, 0, 0, 0, 1, 1, 0, 0, 0.6f, 0.8f, 0, 0.6f, 0.8f, 0, 0, 0.8f, 0.6f };
    static const double scales[NODES][3] = { { 1, 1, 1 }, { -1, 1, 1 }, { 2, 1, 1 } };
    static unsigned char file[8192];
    char json[1024];
    float v[VERTEX];
    const char *end;
    FILE *in;
    int i, k, corner;
    write_file("normals.bin", (const char *)vertices, sizeof vertices);
    snprintf(json, sizeof json, "{\"asset\":{\"version\":\"2.0\"},\"scene\":0,\"scenes\":[{\"nodes\":[0,1,2]}],"
             "\"nodes\":[{\"mesh\":0},{\"mesh\":0,\"scale\":[-1,1,1]},{\"mesh\":0,\"scale\":[2,1,1]}],\"meshes\":["
             "{\"primitives\":[{\"attributes\":{\"POSITION\":0,\"NORMAL\":1}}]}],\"accessors\":[{\"bufferView\":0,"
             "\"componentType\":5126,\"count\":3,\"type\":\"VEC3\"},{\"bufferView\":0,\"byteOffset\":36,"
             "\"componentType\":5126,\"count\":3,\"type\":\"VEC3\"}],\"bufferViews\":["
             "{\"buffer\":0,\"byteLength\":72}],\"buffers\":[{\"uri\":\"normals.bin\",\"byteLength\":72}]}");
    write_text("normals.gltf", json);
    REQUIRE(TOOL("normals.gltf", "--mode", "direct", "--sky", "1,1,1", "--vertices", "--preset", "draft", "-o",
                 "normals.ply", "--quiet") == 0, "exit status %d: %s", ran.status, ran.err);
    in = fopen(in_folder("normals.ply"), "rb");
    REQUIRE(in && fread(file, 1, sizeof file - 1, in) > 300, "no normals.ply");
    fclose(in);
    end = strstr((const char *)file, "end_header\n");
    REQUIRE(end, "no head");
    for (i = 0; i < NODES; i++)
        for (corner = 0; corner < 3; corner++) {
            double n[3], length = 0;
            memcpy(v, end + strlen("end_header\n") + sizeof v * (size_t)(3 * i + corner), sizeof v);
            for (k = 0; k < 3; k++) n[k] = (double)vertices[9 + 3 * corner + k] / scales[i][k];
            for (k = 0; k < 3; k++) length += n[k] * n[k];
            for (k = 0; k < 3; k++)
                CHECK(fabs((double)v[3 + k] - n[k] / sqrt(length)) < 1e-5, "node %d, corner %d: normal %g %g %g", i,
                      corner, (double)v[3], (double)v[4], (double)v[5]);
        }
}

static double basis(int i, const double d[3]) {  /* Returns a real, orthonormal spherical harmonic. */
    const double x = d[0], y = d[1], z = d[2], pi = REF_PI;
    switch (i) {
        case 0: return sqrt(1 / (4 * pi));
        case 1: return sqrt(3 / (4 * pi)) * y;
        case 2: return sqrt(3 / (4 * pi)) * z;
        case 3: return sqrt(3 / (4 * pi)) * x;
        case 4: return sqrt(15 / (4 * pi)) * x * y;
        case 5: return sqrt(15 / (4 * pi)) * y * z;
        case 6: return sqrt(5 / (16 * pi)) * (3 * z * z - 1);
        case 7: return sqrt(15 / (4 * pi)) * x * z;
        default: return sqrt(15 / (16 * pi)) * (x * x - y * y);
    }
}

/* Probes below and beside the lamp are compared with a numerical integral over the lamp. In this mode the floor
   reflects no light. */
TEST(probes_hold_the_lamps_light) {
    static const double points[2][3] = { { 0.2, 1, 0.1 }, { -1, 1.5, 0.4 } };
    static char text[65536];
    const char *at;
    int lines, i, k, x, y, probe;
    write_scene("room.gltf", apart, 1);
    write_text("points.txt", "# two\n0.2 1 0.1\n\n -1, 1.5,0.4  # beside\n");
    REQUIRE(TOOL("room.gltf", "--mode", "direct", "--probes", "points.txt", "-o", "out.json", "--quiet") == 0 &&
            ran.err_lines == 0, "exit status %d: %s",
            ran.status, ran.err);
    read_text(in_folder("out.json"), text, sizeof text, &lines);
    at = text;
    for (probe = 0; probe < 2; probe++) {
        double truth[9] = { 0 }, norm = 0, position[3] = { 0, 0, 0 }, sh[3];
        int count = 0;
        at = strstr(at, "{\"position\": [");
        REQUIRE(at && sscanf(at, "{\"position\": [%lf, %lf, %lf], \"valid\": true, \"sh\": [%n", &position[0],
                             &position[1], &position[2], &count) == 3 && count,
                "probe %d is missing: %.200s", probe, at ? at : text);
        for (k = 0; k < 3; k++) CHECK(fabs(position[k] - points[probe][k]) < 1e-6, "the probe is at %g", position[k]);
        at += count;
        for (y = 0; y < 200; y++)
            for (x = 0; x < 200; x++) {
                const double d[3] = { -0.5 + (x + 0.5) / 200 - points[probe][0], 2 - points[probe][1],
                    -0.5 + (y + 0.5) / 200 - points[probe][2] };
                const double r = sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2]),
                    unit[3] = { d[0] / r, d[1] / r, d[2] / r };
                for (i = 0; i < 9; i++) truth[i] += strength * basis(i, unit) * fabs(unit[1]) / (r * r) / 40000;
            }
        for (i = 0; i < 4; i++) norm += truth[i] * truth[i];
        for (i = 0; i < 9; i++) {
            REQUIRE(sscanf(at, "%*[, ][%lf, %lf, %lf]%n", &sh[0], &sh[1], &sh[2], &count) == 3 ||
                    sscanf(at, "[%lf, %lf, %lf]%n", &sh[0], &sh[1], &sh[2], &count) == 3,
                    "coefficient %d is missing: %.80s", i, at);
            at += count;
            CHECK(fabs(sh[0] - truth[i]) < 0.005 * sqrt(norm) && fabs(2 * sh[2] - sh[0]) < 1e-3 * sqrt(norm),
                  "probe %d, coefficient %d is %g %g, expected %g", probe, i,
                  sh[0], sh[2], truth[i]);
        }
    }
    CHECK(!strstr(at, "\"position\""), "there are more probes");
    REQUIRE(TOOL("room.gltf", "--mode", "direct", "--probes", "2x3x1", "--preset", "draft", "-o", "out.json",
                 "--quiet") == 0, "%s", ran.err);
    read_text(in_folder("out.json"), text, sizeof text, &lines);
    /* the bounds are -1.75 to 2.25, -0.5 to 2, -2 to 2 */
    for (i = 0, at = text; (at = strstr(at, "{\"position\": [")) != NULL; i++, at++) {
        double p[3] = { 0, 0, 0 };
        const double expected[3] = { -1.75 + 4 * (i % 2 + 0.5) / 2, -0.5 + 2.5 * (i / 2 + 0.5) / 3, 0 };
        CHECK(sscanf(at, "{\"position\": [%lf, %lf, %lf]", &p[0], &p[1], &p[2]) == 3, "%.50s", at);
        for (k = 0; k < 3; k++)
            CHECK(fabs(p[k] - expected[k]) < 1e-5, "point %d: %g, expected %g", i, p[k], expected[k]);
    }
    CHECK(i == 6 && strstr(text, "\"grid\": [2, 3, 1]"), "%d probes", i);
}

/* ---- mistakes and failures ---- */

/* With --ao, each texel of the floor shows the share of the sky that the lamp does not cover, and no occlusion, because
   no surface is closer than 1. The light and the stored light equal those of a bake without --ao. */
TEST(ao_and_sky_maps) {
    static const char *const names[2] = { "occluded/sky.png", "occluded/ao.png" };
    static const char bright[] = "#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 1 +X 1\n\x80\x80\x80\x84";  /* 8, 8, 8 */
    int file, x, y, wide, high, parts;
    write_scene("room.gltf", apart, 1);
#define EXACT_DRAFT "room.gltf", "--lightmap", "64", "--preset", "draft", "--error", "0.5%"
    REQUIRE(TOOL(EXACT_DRAFT, "-o", "lit", "--store", "a.light") == 0 &&
            TOOL(EXACT_DRAFT, "-o", "occluded", "--store", "b.light", "--ao", "1") == 0, "%s", ran.err);
    CHECK(same_files("lit/lightmap.exr", "occluded/lightmap.exr") && same_files("a.light", "b.light"),
          "--ao changes the light");
    for (file = 0; file < 2; file++) {
        const float *c = apart[FLOOR];
        double worst = 0;
        unsigned char *bytes = stbi_load(in_folder(names[file]), &wide, &high, &parts, 1);
        REQUIRE(bytes && wide == 64 && high == 64, "%s is missing", names[file]);
        for (y = (int)ceilf(64 * c[1]); y < (int)(64 * c[3]); y++)
            for (x = (int)ceilf(64 * c[0]); x < (int)(64 * c[2]); x++) {
                const double lamp = truth_at((x + 0.5) / 64, (y + 0.5) / 64) / strength;
                worst = test_max(worst, fabs(bytes[64 * y + x] / 255.0 - (file ? 1 : 1 - lamp)));
            }
        CHECK(worst < (file ? 0.003 : 0.02), "%s differs by %g", names[file], worst);
        free(bytes);
    }
#ifdef SBL_RENDER_OPENEXR
    CHECK(exists("occluded/ao.exr") && exists("occluded/sky.exr"), "no .exr");
#endif
    write_file("bright.hdr", bright, sizeof bright - 1);
    CHECK(TOOL(EXACT_DRAFT, "-o", "skylit", "--mode", "direct", "--sky", "bright.hdr", "--ao", "1") == 0 &&
          same_files("skylit/ao.png", "occluded/ao.png") && same_files("skylit/sky.png", "occluded/sky.png"),
          "a picture of the sky changes occlusion: %s", ran.err);
}

#define REFUSED(code, words, ...) do {                                                         \
        CHECK(TOOL(__VA_ARGS__) == code && said(words) && ran.err_lines == 1,                  \
              "exit status %d, expected %d and \"%s\": %s", ran.status, code, words, ran.err); \
    } while (0)

/* Each wrong command line gives its exit status and one line that names the mistake. */
TEST(wrong_command_lines_are_refused) {
    write_scene("room.gltf", apart, 1);
    write_scene("plain.gltf", apart, 0);
    write_text("file", "x");
    write_text("bad.json", "1 2 3\n");
    mkdir(in_folder("folder.txt"), 0777);
    REFUSED(2, "usage: sbl_bake", "--lightmap", "64");
    REFUSED(2, "give one of --lightmap, --vertices, --probes and --cubemaps", "room.gltf", "-o", "out");
    REFUSED(2, "give one of --lightmap, --vertices, --probes and --cubemaps", "room.gltf", "-o", "out", "--lightmap",
            "64", "--vertices");
    REFUSED(2, "--gutter needs --lightmap", "room.gltf", "--vertices", "-o", "no.ply", "--gutter", "3");
    REFUSED(2, "--move needs --probes", "room.gltf", "--vertices", "-o", "no.ply", "--move", "3");
    REFUSED(2, "--ao needs --lightmap", "room.gltf", "--vertices", "-o", "no.ply", "--ao", "1");
    REFUSED(2, "--ao needs a map that is baked at once; leave out --part", "room.gltf", "--lightmap", "8", "-o",
            "no.exr", "--ao", "1", "--part", "1/2");
    REFUSED(2, "--ao needs rays", "room.gltf", "--lightmap", "8", "-o", "no", "--ao", "1", "--backend", "raster");
    REFUSED(2, "--ao 0: the value must be a number", "room.gltf", "--lightmap", "8", "-o", "no", "--ao", "0");
    REFUSED(2, "must end in .ply or .gltf", "room.gltf", "--vertices", "-o", "out.obj");
    REFUSED(2, "must end in .json", "room.gltf", "--probes", "2x2x2", "-o", "out.txt");
    REFUSED(2, "AxBxC with whole numbers from 1 to 4096, or a text file", "room.gltf", "--probes", "2", "-o",
            "no.json");
    REFUSED(2, "--probes 2x2", "room.gltf", "--probes", "2x2", "-o", "no.json");
    REFUSED(2, "--probes 0x1x1", "room.gltf", "--probes", "0x1x1", "-o", "no.json");
    REFUSED(2, "has 68719476736 points", "room.gltf", "--probes", "4096x4096x4096", "-o", "no.json", "--quiet");
    REFUSED(1, "cannot be read", "room.gltf", "--probes", "none.txt", "-o", "no.json", "--quiet");
    mkfifo(in_folder("pipe.txt"), 0666);
    REFUSED(1, "pipe.txt: cannot be read: it is a pipe", "none.gltf", "--probes", "pipe.txt", "-o", "no.json");
    REFUSED(1, "cannot be read: Is a directory", "none.gltf", "--probes", "folder.txt", "-o", "no.json");
    REFUSED(1, "--store pipe.txt: it is a pipe", "room.gltf", "--probes", "2x2x2", "-o", "no.json", "--store",
            "pipe.txt");
    REFUSED(1, "--store bad.json: the data are not stored light", "room.gltf", "--probes", "2x2x2", "-o", "no.json",
            "--store", "bad.json", "--store-replace");
    REFUSED(1, "pipe.txt: it is a pipe", "pipe.txt", "--probes", "2x2x2", "-o", "no.json");
    write_text("empty.txt", "# none\n\n");
    REFUSED(1, "empty.txt: it has no positions", "room.gltf", "--probes", "empty.txt", "-o", "no.json", "--quiet");
    write_text("bad.txt", "1 2 3\n\n# none\n4 5\n");
    REFUSED(1, "line 4 is not three numbers", "room.gltf", "--probes", "bad.txt", "-o", "no.json", "--quiet");
    REFUSED(2, "would overwrite the input file", "room.gltf", "--probes", "bad.json", "-o", "bad.json");
    CHECK(!exists("no.json") && !exists("no.ply"), "something was written");
    REFUSED(2, "--output is missing", "room.gltf", "--lightmap", "64");
    REFUSED(2, "not a folder", "room.gltf", "--lightmap", "64", "-o", "file");
    REFUSED(1, "cannot be created", "room.gltf", "--lightmap", "64", "-o", "no/such/folder");
    REFUSED(2, "--mode paper: the value must be gi, ambient or direct", "room.gltf", "--lightmap", "64", "-o", "new",
            "--mode", "paper");
    REFUSED(2, "--lightmap 0", "room.gltf", "--lightmap", "0", "-o", "new");
    REFUSED(2, "--lightmap 16385", "room.gltf", "--lightmap", "16385", "-o", "new");
    REFUSED(2, "--gutter -1", "room.gltf", "--lightmap", "64", "--gutter", "-1", "-o", "new");
    REFUSED(2, "there is no option --eye", "room.gltf", "--lightmap", "64", "-o", "new", "--eye", "0,0,0");
    REFUSED(1, "sbl_unwrap makes them", "plain.gltf", "--lightmap", "64", "-o", "new", "--quiet");
    CHECK(!exists("new"), "an empty folder is left");
    mkdir(in_folder("old"), 0777);
    REFUSED(1, "sbl_unwrap makes them", "plain.gltf", "--lightmap", "64", "-o", "old", "--quiet");
    CHECK(exists("old"), "a folder that was there is removed");
    CHECK(TOOL("room.gltf", DIRECT, "-o", "here") == 0, "%s", ran.err);
    REFUSED(2, "would overwrite the input file", "here/scene.gltf", DIRECT, "-o", "here");
    CHECK(TOOL("--version") == 0 && strstr(ran.out, "sbl_bake 0."), "%s", ran.out);
}

/* --light-groups writes a map for the group of the lamp and one for the sky. Their sum equals the atlas, and each
   equals a bake of its sources alone. */
TEST(groups_have_maps) {
    picture atlas, lamp, sky, rest, alone;
    double off = 0, mean = 0, sky_off = 0;
    int i;
    write_scene("room.gltf", apart, 1);
    CHECK(TOOL("room.gltf", DIRECT, "--sky", "0.3,0.2,0.1", "--light-groups", "above=sky,nothing=floor*,lamp=*", "-o",
               "bad") == 2 && said("no light, emitting mesh or sky has a name like \"floor*\""), "%s", ran.err);
    CHECK(TOOL("room.gltf", DIRECT, "--sky", "0.3,0.2,0.1", "--light-groups", "above=s?y", "-o", "groups") == 0, "%s",
          ran.err);
    CHECK(TOOL("room.gltf", DIRECT, "--sky", "0.3,0.2,0.1", "--light-groups", "above=sky,lamp=*", "-o", "groups") == 0,
          "%s", ran.err);
    CHECK(TOOL("room.gltf", DIRECT, "-o", "alone") == 0, "%s", ran.err);
    atlas = read_pfm("groups/atlas.pfm");
    lamp = read_pfm("groups/atlas_lamp.pfm");
    sky = read_pfm("groups/atlas_above.pfm");
    rest = read_pfm("groups/atlas_rest.pfm");
    alone = read_pfm("alone/atlas.pfm");
    REQUIRE(atlas.values && lamp.values && sky.values && rest.values && alone.values, "a map is missing");
    for (i = 0; i < 3 * atlas.width * atlas.height; i++) {
        mean += (double)atlas.values[i];
        off = test_max(off, fabs((double)lamp.values[i] + (double)sky.values[i] - (double)atlas.values[i]));
        sky_off += fabs((double)lamp.values[i] - (double)alone.values[i]);
        CHECK(lamp.values[i] == rest.values[i], "the group rest differs from a group of the same sources");
    }
    mean /= 3 * atlas.width * atlas.height;
    sky_off /= 3 * atlas.width * atlas.height;
    CHECK(off < 1e-5 * mean, "the sum is off by %g, mean %g", off, mean);
    CHECK(sky_off < 0.02 * mean, "the lamp alone is off by %g, mean %g", sky_off, mean);
    free(atlas.values); free(lamp.values); free(sky.values); free(rest.values); free(alone.values);
    CHECK(TOOL("room.gltf", DIRECT, "--light-groups", "rest=nothing,lamp=*", "-o", "groups") == 0, "%s", ran.err);
    REFUSED(2, "letters, digits", "room.gltf", DIRECT, "--light-groups", "a b=*", "-o", "new");
    REFUSED(2, "two groups have the name a", "room.gltf", DIRECT, "--light-groups", "a=x,a=y", "-o", "new");
    REFUSED(2, "more than 8", "room.gltf", DIRECT, "--light-groups", "a,b,c,d,e,f,g,h,i", "-o", "new");
    REFUSED(2, "does not work with --directional", "room.gltf", DIRECT, "--light-groups", "sky", "--directional", "-o",
            "new");
    REFUSED(2, "does not work with --cubemaps", "room.gltf", "--cubemaps", "1x1x1", "--light-groups", "sky", "-o",
            "new");
    CHECK(TOOL("room.gltf", "--lightmap", "16", "--preset", "draft", "--quiet", "--light-groups", "lamp=*", "--ao",
               "1", "-o", "dim") == 0 && exists("dim/ao.png") && exists("dim/atlas_lamp.exr"), "%s", ran.err);
}

/* A lamp without red is in its group, too. */
TEST(groups_of_green_lamps) {
    static char text[16384];
    picture lamp;
    char *emission;
    double green = 0;
    int i, lines;
    FILE *out;
    write_scene("room.gltf", apart, 1);
    read_text(in_folder("room.gltf"), text, sizeof text, &lines);
    emission = strstr(text, "[1,1,0.5]");
    REQUIRE(emission, "the lamp has another emission");
    emission[1] = '0';
    out = fopen(in_folder("green.gltf"), "w");
    fputs(text, out);
    fclose(out);
    CHECK(TOOL("green.gltf", DIRECT, "--light-groups", "above=sky,lamp=*", "--sky", "0.1,0.1,0.1", "-o", "green") == 0,
          "%s", ran.err);
    lamp = read_pfm("green/atlas_lamp.pfm");
    REQUIRE(lamp.values, "a map is missing");
    for (i = 0; i < lamp.width * lamp.height; i++) green += (double)lamp.values[3 * i + 1];
    CHECK(green > 0, "the group has no light");
    free(lamp.values);
}

#define SKY "--mode", "direct", "--quiet", "--sky", "0.3,0.2,0.1"
#define TWO "--light-groups", "above=sky,lamp=*"

/* Reads the content of a .ply: `floats` for each of the 8 vertices of the room. Returns 0 if its header lacks the
   words. */
static int read_vertices(const char *name, const char *words, int floats, float *out) {
    static char bytes[4096];
    FILE *in = fopen(in_folder(name), "rb");
    const size_t size = in ? fread(bytes, 1, sizeof bytes - 1, in) : 0;
    const char *body;
    if (in) fclose(in);
    bytes[size] = 0;
    body = strstr(bytes, "end_header\n");
    if (!body || !strstr(bytes, words)) return 0;
    body += strlen("end_header\n");
    memcpy(out, body, 32 * (size_t)floats);
    return size == (size_t)(body - bytes) + 32 * (size_t)floats + 4 * 13;
}

/* Light at vertices has a group for the lamp and one for the sky, in .ply and .gltf. Their sum equals the total, and
   the first equals a bake without the sky. */
TEST(groups_at_vertices) {
    enum { LAYERS = 3, VERTEX = 28 + 12 * LAYERS, MESH = 4 * VERTEX + 24 };  /* bytes in the .bin */
    float v[8][15], alone[8][9], seen[4][3];
    static char text[16384];
    double off = 0, apart_by = 0, sky = 0;
    int i, k, mesh, layer, lines;
    FILE *in;
    write_scene("room.gltf", apart, 1);
    REQUIRE(TOOL("room.gltf", SKY, "--vertices", TWO, "-o", "v.ply") == 0 &&
            TOOL("room.gltf", SKY, "--vertices", TWO, "-o", "v.gltf") == 0 &&
            TOOL("room.gltf", "--mode", "direct", "--vertices", "--quiet", "-o", "alone.ply") == 0, "%s", ran.err);
    REQUIRE(read_vertices("v.ply", "property float radiance_b\nproperty float radiance_above_r\nproperty float "
                          "radiance_above_g\nproperty float radiance_above_b\nproperty float radiance_lamp_r\n", 15,
                          v[0]) && read_vertices("alone.ply", "", 9, alone[0]), "the files have another form");
    for (i = 0; i < 8; i++)
        for (k = 0; k < 3; k++) {
            off = test_max(off, fabs((double)v[i][9 + k] + (double)v[i][12 + k] - (double)v[i][6 + k]));
            apart_by = test_max(apart_by, fabs((double)v[i][12 + k] - (double)alone[i][6 + k]));
            sky = test_max(sky, (double)v[i][9 + k]);
        }
    CHECK(off < 1e-6 && sky > 0.2, "the sum is off by %g; the sky gives at most %g", off, sky);
    CHECK(apart_by < 0.02 * truth_at(0.35, 0.35), "the lamp alone is off by %g", apart_by);
    read_text(in_folder("v.gltf"), text, sizeof text, &lines);
    CHECK(strstr(text, "\"_RADIANCE_above\": 4, \"_RADIANCE_lamp\": 5}, \"indices\": 6"), "%s", text);
    in = fopen(in_folder("v.bin"), "rb");
    for (mesh = 0; mesh < 2 && in; mesh++)
        for (layer = 0; layer < LAYERS; layer++) {
            fseek(in, MESH * mesh + 4 * 28 + 48 * layer, SEEK_SET);
            CHECK(fread(seen, sizeof seen, 1, in) == 1, "v.bin is short");
            for (i = 0; i < 4; i++)
                CHECK(memcmp(seen[i], &v[4 * mesh + i][6 + 3 * layer], 12) == 0, "layer %d differs in v.bin", layer);
        }
    if (in) fclose(in);
}

/* Reads numbers that brackets and commas separate. */
static void read_numbers(const char *at, double *out, int count) {
    for (; count > 0 && at; count--) {
        char *end;
        at += strspn(at, "[], ");
        *out++ = strtod(at, &end);
        at = end == at ? NULL : end;
    }
    while (count-- > 0) *out++ = NAN;
}

/* Reads sh and cube of a probe after these words; sets NAN if the words are missing. */
static void read_light(const char *line, const char *words, double out[45]) {
    const char *sh = line ? strstr(line, words) : NULL, *cube;
    sh = sh ? strstr(sh, "\"sh\": ") : NULL;
    cube = sh ? strstr(sh, "\"cube\": ") : NULL;
    read_numbers(sh ? sh + 6 : NULL, out, 27);
    read_numbers(cube ? cube + 8 : NULL, out + 27, 18);
}

/* Probes have the same groups, in harmonics and cubes. */
TEST(groups_of_probes) {
    static char text[32768], other[32768];
    double whole[45], above[45], lamp[45], alone[45], off = 0, apart_by = 0, norm = 0;
    const char *at = text, *at_other = other;
    int i, lines, probe;
    write_scene("room.gltf", apart, 1);
    REQUIRE(TOOL("room.gltf", SKY, "--probes", "2x1x1", TWO, "-o", "p.json") == 0 &&
            TOOL("room.gltf", "--mode", "direct", "--probes", "2x1x1", "--quiet", "-o", "q.json") == 0, "%s", ran.err);
    read_text(in_folder("p.json"), text, sizeof text, &lines);
    read_text(in_folder("q.json"), other, sizeof other, &lines);
    CHECK(strstr(text, "\n \"groups\": [\"above\", \"lamp\"],\n \"probes\": ["), "%s", text);
    for (probe = 0; probe < 2; probe++) {
        at = strstr(at + 1, "{\"position\"");
        at_other = strstr(at_other + 1, "{\"position\"");
        REQUIRE(at && at_other, "probe %d is missing", probe);
        read_light(at, "position", whole);
        read_light(at, "\"groups\": {\"above\": ", above);
        read_light(at, ", \"lamp\": ", lamp);
        read_light(at_other, "position", alone);
        for (i = 0; i < 45; i++) {
            CHECK(isfinite(above[i] + lamp[i]), "probe %d lacks value %d of a group", probe, i);
            off = test_max(off, fabs(above[i] + lamp[i] - whole[i]));
            apart_by = test_max(apart_by, fabs(lamp[i] - alone[i]));
            norm = test_max(norm, fabs(alone[i]));
        }
    }
    CHECK(off < 2e-6 * norm, "the sum is off by %g of %g", off, norm);
    CHECK(apart_by < 0.02 * norm, "the lamp alone is off by %g of %g", apart_by, norm);
    /* the lamp, which matches no pattern, joins the group with the name "rest" */
    CHECK(TOOL("room.gltf", SKY, "--probes", "1x1x1", "--light-groups", "rest=nothing,above=sky", "-o", "r.json") == 0,
          "%s", ran.err);
    read_text(in_folder("r.json"), text, sizeof text, &lines);
    CHECK(strstr(text, "\n \"groups\": [\"rest\", \"above\"],\n \"probes\": ["), "%s", text);
}

/* Probes take more rays than sensors do. A number outside of the range is a misuse that names the option. */
TEST(rays_have_limits) {
    write_scene("room.gltf", apart, 1);
    CHECK(TOOL("room.gltf", "--probes", "1x1x1", "--rays", "63", "-o", "p.json") == 2 &&
              said("--rays 63: the number must be 64 to 65536"), "%s", ran.err);
    CHECK(TOOL("room.gltf", "--vertices", "--rays", "4097", "-o", "v.ply") == 2 &&
              said("--rays 4097: the number must be 1 to 4096"), "%s", ran.err);
    CHECK(TOOL("room.gltf", "--probes", "1x1x1", "--rays", "65537", "-o", "p.json") == 2 && said("--rays"), "%s",
          ran.err);
    CHECK(TOOL("room.gltf", "--mode", "direct", "--probes", "1x1x1", "--rays", "4097", "-o", "p.json") == 0, "%s",
          ran.err);
}

/* --help has at most 40 short lines; --help all names every option of sbl_bake, and no other. */
TEST(help_is_short_or_complete) {
    static const char *const names[] = { "--output", "--lightmap", "--map", "--gutter", "--directional",
        "--supersample", "--light-groups", "--target-error", "--error", "--vertices", "--average", "--formats", "--lit",
        "--exposure", "--ao", "--shadow-mask", "--cubemaps", "--cubemap-size", "--samples", "--smoothing", "--probes",
        "--move", "--facet-limit",
        "--sky", "--sky-rotation", "--sky-scale", "--sky-up", "--mode", "--preset", "--backend", "--rays",
        "--max-bounce-cells", "--bounce-samples", "--epsilon", "--sensor-size", "--tile", "--threshold",
        "--filter-radius", "--seed", "--stats", "--allow-path", "--memory", "--read-time", "--store", "--quiet",
        "--materials",
        "--verbose", "--help", "--version",
        "MOZ_lightmap", "Ctrl-C" };
    size_t i;
    CHECK(TOOL("--help") == 0 && ran.out_lines <= 40 && longest_line(ran.out) <= 80, "%d lines of up to %d characters",
          ran.out_lines, longest_line(ran.out));
    CHECK(TOOL("--help", "all") == 0 && ran.out_lines > 80 && longest_line(ran.out) <= 80,
          "%d lines of up to %d characters", ran.out_lines, longest_line(ran.out));
    for (i = 0; i < sizeof names / sizeof *names; i++)
        CHECK(strstr(ran.out, names[i]), "--help all does not mention %s", names[i]);
    CHECK(!strstr(ran.out, "Other:") && !strstr(ran.out, "paper") && !strstr(ran.out, "PATH"), "%s", ran.out);
}

/* A warning names options without effect. */
TEST(options_without_effect_are_named) {
    write_scene("room.gltf", apart, 1);
    CHECK(TOOL("room.gltf", "--mode", "direct", "--lightmap", "16", "-o", "idle", "--rays", "16", "--tile", "1",
               "--error", "9%", "--max-bounce-cells", "2048") == 0 && ran.err_lines == 1 && said("no effect: ") &&
              said("--max-bounce-cells (only") && said("--target-error (--rays and --tile"), "%s", ran.err);
    CHECK(TOOL("room.gltf", "--mode", "direct", "--vertices", "-o", "idle.ply", "--average", "--smoothing", "1") == 0 &&
              ran.err_lines == 1 && said("--smoothing ("), "%s", ran.err);
    CHECK(TOOL("room.gltf", "--mode", "direct", "--vertices", "-o", "idle.ply", "--rays", "16") == 0 &&
              ran.err_lines == 0, "%s", ran.err);
}

/* A full disk causes a message, and no incomplete file remains. */
TEST(a_full_disk_is_said) {
    static const char *const arguments[] = { "room.gltf", DIRECT, "-o", "full", NULL };
    write_scene("room.gltf", apart, 1);
    finish(start(arguments, -1, 4096));
    CHECK(ran.status == 1 && said("cannot be written") && ran.err_lines == 1 && !parts_left(), "exit status %d: %s",
          ran.status, ran.err);
    CHECK(!exists("full/lightmap.pfm") && !exists("full/atlas.pfm"), "an incomplete file is left");
}

/* If it is interrupted early, the tool works on for a moment, then writes any light that exists, and says so. If it is
   interrupted later, it writes the light computed so far. */
TEST(interrupted) {
    static const char *const early[] = { "room.gltf", "--lightmap", "1024", "--rays", "4096", "--tile", "1", "-o",
        "early", NULL };
    static const char *const late[] = { "room.gltf", "--lightmap", "512", "--mode", "ambient", "--rays", "4096",
        "--threshold", "0", "-o", "late", NULL };
    picture light;
    int kept;
    write_scene("room.gltf", apart, 1);
    if (!interrupt_at(early, 0, SIGINT)) SKIP("no pseudo-terminals");
    light = read_pfm("early/lightmap.partial.pfm");
    kept = light.values != NULL;
    CHECK(ran.status == 130 && said(kept ? "interrupted; the unfinished lightmap ("
                                         : "interrupted; there is no light yet") &&
          exists("early/lightmap.partial.pfm") == kept && !exists("early/lightmap.pfm") && !parts_left(),
          "exit status %d, %s is kept: %s", ran.status, kept ? "light" : "nothing", ran.err);
    CHECK(!kept || light.width == 1024, "the unfinished lightmap is %d wide", light.width);
    free(light.values);
    CHECK(interrupt_at(late, 2, SIGTERM) && ran.status == 143 && said("unfinished lightmap ("), "exit status %d: %s",
          ran.status, ran.err);
    light = read_pfm("late/lightmap.partial.pfm");
    CHECK(light.values && light.width == 512 && *texel(&light, 150, 150) > 0 && !exists("late/lightmap.pfm") &&
          !parts_left(), "there is no partial output");
    free(light.values);
}

/* ---- drawing the lightmap in a host ---- */

/* Seen from above, host_lightmap draws the light of the map on the floor; a pixel is as large as a texel. */
TEST(host_lightmap_draws_the_map) {
    picture drawn;
    double worst = 0;
    int x, y, seen = 0;
    write_scene("room.gltf", apart, 1);
    REQUIRE(TOOL("room.gltf", "--mode", "direct", "--lightmap", "256", "-o", "out") == 0, "%s", ran.err);
    tool_use("host_lightmap");
    CHECK(TOOL("room.gltf", "out", "--eye", "0.25,1.5,0", "--look-at", "0.25,-0.5,0", "--up", "0,0,-1", "--fov", "80",
               "--size", "50x50", "--channel",
               "radiance", "-o", "drawn.pfm") == 0 && ran.err_lines == 0, "exit status %d: %s", ran.status, ran.err);
    drawn = read_pfm("drawn.pfm");
    CHECK(drawn.values != NULL, "nothing is drawn");
    for (y = 0; y < 50 && drawn.values; y++)
        for (x = 0; x < 50; x++) {
            const double across = 2 * tan(40 * REF_PI / 180) * 2, u = 0.35 + ((x + 0.5) / 50 - 0.5) * across / 4 * 0.5,
                         v = 0.35 + ((y + 0.5) / 50 - 0.5) * across / 4 * 0.5;
            if (u < 0.11 || u > 0.59 || v < 0.11 || v > 0.59) continue;
            seen++;
            worst = test_max(worst, fabs((double)*texel(&drawn, x, y) - truth_at(u, v)) / truth_at(0.35, 0.35));
        }
    CHECK(seen > 2000 && worst < 0.015, "%d pixels, off by %g of the brightest", seen, worst);
    free(drawn.values);
    CHECK(TOOL("room.gltf", "out", "--eye", "0.25,1.4,3", "--look-at", "0.25,0.5,0", "--size", "60x40", "--sky",
               "1,1,1", "--mode", "direct") == 0 && exists("out/frame_00.png") &&
          exists("out/frame_11.png"), "exit status %d: %s", ran.status, ran.err);
    for (x = 0; x < 2; x++) {  /* The ball moves from left to right, over pixels that showed the sky before. */
        int width = 0, height = 0, channels, column, from = x ? 30 : 0, balls = 0;
        unsigned char *png = stbi_load(in_folder(x ? "out/frame_11.png" : "out/frame_00.png"), &width, &height,
                                       &channels, 3);
        for (column = from; png && column < from + 30; column++) {
            const unsigned char *p = png + 3 * (23 * width + column);
            balls += p[0] > 10 && p[0] < 250;
        }
        CHECK(png && width == 60 && height == 40, "frame %d", x ? 11 : 0);
        stbi_image_free(png);
        CHECK(balls > 0, "no ball in frame %d", x ? 11 : 0);
    }
    CHECK(TOOL("room.gltf", "out", "--size", "8x8", "--tile", "8", "--preset", "high", "-o", "noted.pfm") == 0 &&
          ran.err_lines == 1 && said("--preset (with -o no probes") && said("--tile (sbl_bake made"), "%s", ran.err);
    CHECK(TOOL("room.gltf", "out", "--size", "8x8", "--tile", "8", "--preset", "draft", "--mode", "direct") == 0 &&
          ran.err_lines == 1 && !said("--preset") && said("--tile (sbl_bake made"), "%s", ran.err);
    REFUSED(2, "no probes are baked", "room.gltf", "out", "--store", "light.sbl", "-o", "x.pfm");
    REFUSED(1, "atlas.exr", "room.gltf", "nowhere", "-o", "x.png");
    REFUSED(2, "usage", "room.gltf");
    REFUSED(2, "must end in", "room.gltf", "out", "-o", "x.jpg");
    tool_use("sbl_bake");
}

/* Writes a box whose emitting walls face inwards. Each wall is a quad with a chart in a map of three by two cells. */
static void write_closed_room(void) {
    static const char json[] =
        "{\"asset\":{\"version\":\"2.0\"},\"scene\":0,\"scenes\":[{\"nodes\":[0]}],\"nodes\":[{\"mesh\":0}],"
            "\"meshes\":[{\"primitives\":[{\"attributes\":"
        "{\"POSITION\":0,\"TEXCOORD_0\":1,\"TEXCOORD_1\":1},\"indices\":2,\"material\":0}]}],"
            "\"materials\":[{\"emissiveFactor\":[0.2,0.2,0.2],\"pbrMetallicRoughness\":"
        "{\"baseColorFactor\":[0.5,0.5,0.5,1],\"metallicFactor\":0}}],\"accessors\":[{"
            "\"bufferView\":0,\"componentType\":5126,\"count\":24,"
            "\"type\":\"VEC3\",\"min\":[-2,-1,-3],"
        "\"max\":[2,1,3]},{\"bufferView\":1,\"componentType\":5126,\"count\":24,\"type\":\"VEC2\"},{\"bufferView\":2,"
            "\"componentType\":5125,\"count\":36,"
        "\"type\":\"SCALAR\"}],\"bufferViews\":[{\"buffer\":0,\"byteOffset\":0,\"byteLength\":288},{\"buffer\":0,"
            "\"byteOffset\":288,\"byteLength\":192},"
        "{\"buffer\":0,\"byteOffset\":480,\"byteLength\":144}],\"buffers\":[{\"uri\":\"closed.bin\",\"byteLength\":624}"
            "]}";
    static const float half[3] = { 2, 1, 3 };
    float positions[24][3], texcoords[24][2];
    unsigned indices[36];
    FILE *out;
    int i, k;
    for (i = 0; i < 24; i++) {  /* wall i / 4 is at the lower or upper end of axis wall / 2; its corners go around it */
        const int wall = i / 4, axis = wall / 2, side = wall % 2 ? 1 : -1, u = (i & 3) == 1 || (i & 3) == 2,
            v = (i & 3) >= 2;
        for (k = 0; k < 3; k++) positions[i][k] = 0;
        positions[i][axis] = (float)side * half[axis];
        positions[i][(axis + 1) % 3] = (float)(side < 0 ? 2 * u - 1 : 2 * v - 1) * half[(axis + 1) % 3];
        positions[i][(axis + 2) % 3] = (float)(side < 0 ? 2 * v - 1 : 2 * u - 1) * half[(axis + 2) % 3];
        texcoords[i][0] = ((float)(wall % 3) + (u ? 0.9f : 0.1f)) / 3;
        texcoords[i][1] = ((float)(wall / 3) + (v ? 0.9f : 0.1f)) / 2;
    }
    for (i = 0; i < 36; i++) indices[i] = (unsigned)(i / 6 * 4) + (unsigned)("012023"[i % 6] - '0');
    out = fopen(in_folder("closed.bin"), "wb");
    fwrite(positions, 1, sizeof positions, out);
    fwrite(texcoords, 1, sizeof texcoords, out);
    fwrite(indices, 1, sizeof indices, out);
    fclose(out);
    write_file("closed.gltf", json, strlen(json));
}

/* From outside, only the back faces of the walls would be visible, so host_lightmap must place its camera inside. */
TEST(host_lightmap_starts_inside_a_room) {
    unsigned char *png;
    int width = 0, height = 0, channels, i, dark = 0;
    write_closed_room();
    REQUIRE(TOOL("closed.gltf", "--mode", "direct", "--lightmap", "48", "-o", "out") == 0 && ran.err_lines == 0, "%s",
            ran.err);
    tool_use("host_lightmap");
    CHECK(TOOL("closed.gltf", "out", "--mode", "direct", "--size", "60x40") == 0 && ran.err_lines == 0,
          "exit status %d: %s", ran.status, ran.err);
    png = stbi_load(in_folder("out/frame_06.png"), &width, &height, &channels, 3);
    for (i = 0; png && i < width * height; i++) dark += png[3 * i] < 100;
    CHECK(png && width == 60 && height == 40 && dark < 24, "%d of %d x %d pixels are dark", dark, width, height);
    stbi_image_free(png);
    tool_use("sbl_bake");
}

int main(int argc, char **argv) {
    (void)argc;
    if (!tool_begin(argv[0])) return 1;
    tool_use("sbl_bake");
    RUN(a_lightmap_holds_lamberts_light);
    RUN(viewers_get_the_same_light);
    RUN(a_small_highlight_does_not_darken_the_rest);
    RUN(the_scene_is_written_whole);
    RUN(overlaps_are_shown);
    RUN(vertices_fit_lamberts_light);
    RUN(normals_of_a_ply_are_in_world_space);
    RUN(probes_hold_the_lamps_light);
    RUN(ao_and_sky_maps);
    RUN(wrong_command_lines_are_refused);
    RUN(groups_have_maps);
    RUN(groups_of_green_lamps);
    RUN(groups_at_vertices);
    RUN(groups_of_probes);
    RUN(rays_have_limits);
    RUN(help_is_short_or_complete);
    RUN(options_without_effect_are_named);
    RUN(a_full_disk_is_said);
    RUN(interrupted);
    RUN(host_lightmap_draws_the_map);
    RUN(host_lightmap_starts_inside_a_room);
    tool_end();
    return test_report();
}
