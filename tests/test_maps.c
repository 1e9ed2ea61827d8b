/* Tests of scenes with several lightmaps. One run of sbl_bake bakes them all with the same bounced light. The result
   equals that of one run with --map for each lightmap, and the output says which mesh is in which map. test_unwrap.sh
   makes such scenes. */
#define _XOPEN_SOURCE 700
#define _DEFAULT_SOURCE
#include "support/test.h"
#include "support/tool.h"
#include "support/mapped_room.h"

static float apart[QUADS][4] = { { 0.1f, 0.1f, 0.6f, 0.6f }, { 0.7f, 0.7f, 0.9f, 0.9f } };

#define BAKE "two.gltf", "--preset", "draft", "--lightmap", "32", "--formats", "pfm,ktx2"
#define DIRECT "two.gltf", "--preset", "draft", "--lightmap", "32", "--formats", "pfm", "--mode", "direct"
#define LARGE "two.gltf", "--lightmap", "320", "--mode", "direct", "--quiet", "--preset", "draft", "--memory", "24M", \
    "--formats", "pfm"
#define SUN "\"KHR_lights_punctual\""

/* Replaces the first occurrence of a fragment in a text. */
static void replace(char *text, const char *old, const char *with) {
    char *const at = strstr(text, old);
    REQUIRE(at, "%s is missing", old);
    memmove(at + strlen(with), at + strlen(old), strlen(at + strlen(old)) + 1);
    memcpy(at, with, strlen(with));
}

/* Writes the room with a sun and a shelf that uses the same mesh as the floor. The floor is in map 0, all other nodes
   are in map `map`. */
static void write_two(const char *name, int map) {
    static char text[16384];
    char more[512];
    int lines;
    write_scene("room.gltf", apart, 1);
    read_text(in_folder("room.gltf"), text, sizeof text, &lines);
    snprintf(more, sizeof more, "{\"name\":\"lamp\",\"mesh\":1,\"extras\":{\"lightmapIndex\":%d}},{\"name\":\"shelf\","
             "\"mesh\":0,\"translation\":[0.5,0,0.5],\"scale\":[0.25,1,0.25],\"extras\":{\"lightmapIndex\":%d,"
             "\"lightmapScaleOffset\":[0.75,0.5,0.125,0.25]}},{\"rotation\":[-0.7071068,0,0,0.7071068],"
             "\"extensions\":{" SUN ":{\"light\":0}}}]", map, map);
    replace(text, "{\"mesh\":1}]", more);
    replace(text, "[0,1]", "[0,1,2,3]");
    replace(text, "\"scene\":0,", "\"scene\":0,\"extensions\":{" SUN ":{\"lights\":[{\"type\":\"directional\"}]}},");
    replace(text, "strength\"]", "strength\"," SUN "]");
    write_text(name, text);
}

/* Writes the room. Returns 0 if sbl_bake was built without cJSON, which several maps need. */
static int make_room(void) {
    write_two("two.gltf", 1);
    return !(TOOL(DIRECT, "--map", "1", "--part", "1/1", "-o", "no.exr") == 1 && said("map 1"));
}

/* Checks that the files of maps 0 and 1 in `all` equal those in the folders one_0 and one_1. */
static void check_files(const char *all, const char *const *files, int count) {
    char a[64], b[64];
    int map, i;
    for (map = 0; map < 2; map++)
        for (i = 0; i < count; i++) {
            const char *const dot = strchr(files[i], '.');
            snprintf(a, sizeof a, "%s/%.*s_%d%s", all, (int)(dot - files[i]), files[i], map, dot);
            snprintf(b, sizeof b, "one_%d/%s", map, files[i]);
            CHECK(same_files(a, b), "%s and %s differ", a, b);
        }
}

/* Checks that maps.json of a folder contains these texts, and that the files of map 1 which it names exist. */
static void check_table(const char *baked, const char *const *texts, int count) {
    static char text[32768];
    char name[64];
    const char *at;
    int lines, i;
    snprintf(name, sizeof name, "%s/maps.json", baked);
    read_text(in_folder(name), text, sizeof text, &lines);
    for (i = 0; i < count; i++) CHECK(strstr(text, texts[i]) != NULL, "%s is not in the table: %s", texts[i], text);
    for (at = strstr(text, "_1."); at; at = strstr(at + 1, "_1.")) {
        const char *first = at, *const last = strchr(at, '"');
        while (first > text && first[-1] != '"') first--;
        snprintf(name, sizeof name, "%s/%.*s", baked, last ? (int)(last - first) : 0, first);
        CHECK(exists(name), "the table names %s, which does not exist", name);
    }
}

/* >>baking all maps in one run */

/* Each map equals that of its own run, to the bit, and the bounced light is computed only once. */
TEST(maps_are_those_of_their_own_runs) {
    static const char *const files[] = { "lightmap.pfm", "lightmap.ktx2", "atlas.pfm", "atlas.ktx2", "atlas.png",
                                         "sh_3.pfm", "ao.png", "sky.png", "shadow.png" };
    static const char *const named[] = { "\"atlas\": [\"atlas_1.", "\"sh\": [[\"sh_0_1.",
                                         "\"ao\": \"ao_1.png\", \"sky\": \"sky_1.png\", \"shadow\": "
                                         "\"shadow_1.png\"" };
    double rays;
    if (!make_room()) SKIP("built without cJSON");
    CHECK(TOOL(BAKE, "--directional", "--ao", "1", "--shadow-mask", "--quiet", "-o", "all", "--stats", "all.json") == 0,
          "%s", ran.err);
    CHECK(TOOL(BAKE, "--directional", "--ao", "1", "--shadow-mask", "--quiet", "--map", "0", "-o", "one_0", "--stats",
               "0.json") == 0, "%s", ran.err);
    CHECK(TOOL(BAKE, "--directional", "--ao", "1", "--shadow-mask", "--quiet", "--map", "1", "-o", "one_1") == 0, "%s",
          ran.err);
    check_files("all", files, (int)(sizeof files / sizeof *files));
    check_table("all", named, 3);
    CHECK(!same_files("one_0/atlas.pfm", "one_1/atlas.pfm"), "both maps are the same");
    CHECK(!exists("all/atlas.pfm") && !exists("one_0/maps.json") && exists("all/scene_lit.glb"), "other files");
    rays = number_after("0.json", "\"bounce_rays\":");
    CHECK(rays > 0 && number_after("all.json", "\"bounce_rays\":") == rays, "%g rays of bounced light, not %g",
          number_after("all.json", "\"bounce_rays\":"), rays);
    CHECK(number_after("all.json", "\"sensors\":") > number_after("0.json", "\"sensors\":"),
          "the sensors of one map are told");
}

/* Light groups are written to one file per map. */
TEST(groups_of_maps) {
    static const char *const files[] = { "atlas_lamp.pfm", "atlas_rest.pfm" };
    static const char *const named[] = { "\"groups\": {\"lamp\": [\"atlas_lamp_1.pfm\"], \"rest\": ["
                                         "\"atlas_rest_1.pfm\"]}" };
    if (!make_room()) SKIP("built without cJSON");
    CHECK(TOOL(DIRECT, "--light-groups", "lamp", "--lit", "0", "-o", "all") == 0, "%s", ran.err);
    CHECK(TOOL(DIRECT, "--light-groups", "lamp", "--lit", "0", "--map", "0", "-o", "one_0") == 0, "%s", ran.err);
    CHECK(TOOL(DIRECT, "--light-groups", "lamp", "--lit", "0", "--map", "1", "-o", "one_1") == 0, "%s", ran.err);
    check_files("all", files, 2);
    check_table("all", named, 1);
}

/* The table of an earlier bake in the same folder is removed if the scene now has one map, but not by --map. */
TEST(old_tables_are_removed) {
    if (!make_room()) SKIP("built without cJSON");
    CHECK(TOOL(DIRECT, "--lit", "0", "-o", "old") == 0 && exists("old/maps.json"), "%s", ran.err);
    CHECK(TOOL(DIRECT, "--lit", "0", "--map", "1", "-o", "old") == 0 && exists("old/maps.json"), "%s", ran.err);
    write_two("two.gltf", 0);
    CHECK(TOOL(DIRECT, "--lit", "0", "-o", "old") == 0 && !exists("old/maps.json"), "%s", ran.err);
}

/* >>the map of each mesh */

static char text[32768];

static void read_json(const char *name) {
    int lines;
    read_text(in_folder(name), text, sizeof text, &lines);
}

TEST(maps_json_lists_nodes_and_maps) {
    if (!make_room()) SKIP("built without cJSON");
    CHECK(TOOL(DIRECT, "--formats", "pfm,rgbm", "--quiet", "--lit", "0", "-o", "table") == 0, "%s", ran.err);
    read_json("table/maps.json");
    CHECK(strstr(text, "\"size\": 32,") && strstr(text, "{\"atlas\": [\"atlas_0.rgbm.png\", \"atlas_0.pfm\"], \"png\": "
          "\"atlas_0.png\", \"intensity\": ") && strstr(text, "[\"atlas_1.rgbm.png\", ") && strstr(text,
          "\"rgbm_range\": "), "%s", text);
    CHECK(strstr(text, "{\"name\": \"floor \\\"1\\\"\", \"node\": 0, \"map\": 0, \"scale\": [1, 1], \"offset\": "
          "[0, 0]}"), "%s", text);
    CHECK(strstr(text, "{\"name\": \"lamp\", \"node\": 1, \"map\": 1, \"scale\": [1, 1], \"offset\": [0, 0]}"), "%s",
          text);
    CHECK(strstr(text, "{\"name\": \"shelf\", \"node\": 2, \"map\": 1, \"scale\": [0.75, 0.5], \"offset\": "
          "[0.125, 0.25]}"), "%s", text);
}

/* Returns the text of element i of a JSON list whose elements are on lines of their own. */
static const char *element(const char *list, int i) {
    const char *at = strstr(text, list);
    for (i++; at && i > 0; i--) at = strstr(at + 1, "\n    {");
    return at ? at + 5 : "";
}

/* Returns the number after a key in the rest of a line, or -1 if the key is missing. */
static int number_in(const char *line, const char *key) {
    const char *const at = strstr(line, key), *const end = strchr(line, '\n');
    return at && (!end || at < end) ? atoi(at + strlen(key)) : -1;
}

/* The material of the floor is written twice, because the shelf uses it with another map. With --map 1, the floor uses
   it without a map. */
TEST(materials_refer_to_their_maps) {
    static const int expected[2][3] = { { 1, 2, 2 }, { -1, 1, 1 } };  /* per mesh: index of the texture of its map */
    int only, mesh;
    if (!make_room()) SKIP("built without cJSON");
    for (only = 0; only < 2; only++) {
        const char *const out = only ? "other" : "both";
        CHECK(TOOL(DIRECT, "--lit", "32", "-o", out, only ? "--map" : "--quiet", only ? "1" : NULL) == 0, "%s",
              ran.err);
        read_json(only ? "other/scene.gltf" : "both/scene.gltf");
        for (mesh = 0; mesh < 3; mesh++) {
            const int material = number_in(element("\"meshes\"", mesh), "\"material\": ");
            const char *const line = element("\"materials\"", material);
            CHECK(number_in(line, "\"MOZ_lightmap\": {\"index\": ") == expected[only][mesh] &&
                  (number_in(line, "\"baseColorTexture\": {\"index\": ") == 0) == (mesh != 1), "%s: mesh %d: %.300s",
                  out, mesh, line);
        }
        CHECK(strstr(text, only ? "\"atlas.png\"" : "\"atlas_1.png\"") && !strstr(text, "\"atlas_2.png\""), "%s", text);
        read_json(only ? "other/scene_lit.glb" : "both/scene_lit.glb");
        memmove(text, text + 20, sizeof text - 20);
        for (mesh = 0; mesh < 3; mesh++) {
            const int material = number_in(element("\"meshes\"", mesh), "\"material\": ");
            const char *const line = element("\"materials\"", material);
            const int texture = number_in(line, "\"baseColorTexture\": {\"index\": ");
            CHECK(texture == (only ? (mesh ? 0 : -1) : mesh > 0), "%s: mesh %d: %.300s", out, mesh, line);
        }
    }
}

/* >>windows and parts */

TEST(some_need_one_map) {
    if (!make_room()) SKIP("built without cJSON");
    CHECK(TOOL(DIRECT, "--part", "1/2", "-o", "1.exr") == 1 && said("it has 2 lightmaps, and --part works with one") &&
          ran.err_lines == 1, "%s", ran.err);
    mkdir(in_folder("parts"), 0777);
    CHECK(TOOL(DIRECT, "--join", "parts", "-o", "joined") == 1 && said("and --join works with one; choose it: --map 0 "
          "to --map 1") && !exists("joined"), "%s", ran.err);
    CHECK(TOOL(DIRECT, "--map", "2", "-o", "no") == 1 && said("no mesh is in map 2") && !exists("no"), "%s", ran.err);
    CHECK(TOOL(DIRECT, "--lightmap", "auto", "-o", "no") == 1 && said("does not say how large its map is") &&
          !exists("no"), "%s", ran.err);
    write_two("two.gltf", 2);
    CHECK(TOOL(DIRECT, "-o", "no") == 1 && said("no mesh is in map 1; the maps of the scene are 0 to 2") &&
          ran.err_lines == 1 && !exists("no"), "%s", ran.err);
    CHECK(TOOL(DIRECT, "--map", "2", "--lit", "0", "-o", "last") == 0 && exists("last/atlas.pfm"), "%s", ran.err);
    write_two("two.gltf", 9999);
    CHECK(TOOL(DIRECT, "-o", "no") == 1 && said("no mesh is in map 1") && !parts_left(), "%s", ran.err);
}

/* The windows of all maps are kept until the last map is complete. A run that was killed in the second map continues
   there, and the result has the same bits. */
TEST(killed_runs_go_on) {
    const char *const arguments[] = { LARGE, "-o", "often", "--resume", NULL };
    int killed;
    if (!make_room()) SKIP("built without cJSON");
    CHECK(TOOL(LARGE, "-o", "once", "--verbose") == 0, "%s", ran.err);
    if (said("OpenEXR")) SKIP("built without OpenEXR");
    CHECK(said("window 2 of ") && !exists("once_0.parts") && !exists("once_1.parts"), "%s", ran.err);
    killed = kill_when(arguments, "often_1", 1);
    CHECK(killed && finished_windows("often_0") > 1 && finished_windows("often_1") > 0, "killed %d", killed);
    CHECK(TOOL(LARGE, "-o", "often") == 1 && said("often_0.parts has finished windows"), "%s", ran.err);
    CHECK(run(arguments) == 0, "%s", ran.err);
    CHECK(same_files("once/atlas_0.pfm", "often/atlas_0.pfm") && same_files("once/atlas_1.pfm", "often/atlas_1.pfm") &&
          same_files("once/scene.gltf", "often/scene.gltf") && same_files("once/maps.json", "often/maps.json"),
          "the maps differ");
    CHECK(!exists("often_0.parts") && !exists("often_1.parts") && !parts_left(), "files are left");
}

int main(int argc, char **argv) {
    (void)argc;
    if (!tool_begin(argv[0])) return 1;
    tool_use("sbl_bake");
    RUN_UNSANITIZED(maps_are_those_of_their_own_runs);
    RUN(groups_of_maps);
    RUN(old_tables_are_removed);
    RUN(maps_json_lists_nodes_and_maps);
    RUN(materials_refer_to_their_maps);
    RUN(some_need_one_map);
    RUN(killed_runs_go_on);
    tool_end();
    return test_report();
}
