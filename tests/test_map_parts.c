/* Tests of lightmaps in parts: sbl_bake --lightmap with --part, --plan and --join. Further tests bake large maps window
   by window, and continue runs that were killed. */
#define _XOPEN_SOURCE 700
#define _DEFAULT_SOURCE
#include "support/test.h"
#include "support/tool.h"
#include "support/mapped_room.h"
#include <math.h>

#define FILES "--formats", "exr,pfm"
#define MAP "room.gltf", "--lightmap", "96", "--mode", "direct", "--quiet", FILES
#define LARGE "room.gltf", "--lightmap", "320", "--mode", "direct", "--quiet", "--preset", "draft", "--memory", "24M", \
    FILES
#define BAKE(...) (tool_use("sbl_bake"), run((const char *const[]){ __VA_ARGS__, NULL }))
#define MERGE(...) (tool_use("sbl_merge"), run((const char *const[]){ __VA_ARGS__, NULL }))

static float apart[QUADS][4] = { { 0.1f, 0.1f, 0.6f, 0.6f }, { 0.7f, 0.7f, 0.9f, 0.9f } };
static float overlapping[QUADS][4] = { { 0.1f, 0.1f, 0.6f, 0.6f }, { 0.5f, 0.5f, 0.9f, 0.9f } };

static int has_openexr(void) {
    write_scene("room.gltf", apart, 1);
    return !(BAKE(MAP, "--part", "1/1", "-o", "probe.exr") == 1 && said("OpenEXR"));
}

/* Makes parts 1 to `count` in a folder. more: an option and its value, or NULL. Returns 1 if all parts were made. */
static int make_parts(const char *to, int count, const char *more, const char *value) {
    const char *const arguments[] = { MAP, more, value, NULL };
    char pattern[64];
    mkdir(in_folder(to), 0777);
    snprintf(pattern, sizeof pattern, "%s/%%02d.exr", to);
    tool_use("sbl_bake");
    return run_parts(arguments, pattern, count);
}

/* Joined parts equal the map that is baked at once: its light, gutters, harmonics, scene and picture of overlaps. */
TEST(parts_make_the_map) {
    static const char *const files[] = { "lightmap.pfm", "atlas.pfm", "sh_0.pfm", "sh_3.pfm" };
    char names[2][64];
    int i;
    if (!has_openexr()) SKIP("built without OpenEXR");
    write_scene("room.gltf", overlapping, 1);
    CHECK(BAKE(MAP, "--directional", "-o", "whole") == 0, "%s", ran.err);
    REQUIRE(make_parts("parts", 3, "--directional", NULL), "%s", ran.err);
    CHECK(BAKE(MAP, "--directional", "--join", "parts", "-o", "joined") == 0 && !ran.err[0], "%s", ran.err);
    for (i = 0; i < 4; i++) {
        snprintf(names[0], sizeof names[0], "whole/%s", files[i]);
        snprintf(names[1], sizeof names[1], "joined/%s", files[i]);
        CHECK(fabs(mean_difference(names[0], names[1])) < 0.01, "%s differs by %g", files[i],
              mean_difference(names[0], names[1]));
    }
    CHECK(mean_difference("joined/lightmap.pfm", "joined/atlas.pfm") > 0.02, "there are no gutters");
    CHECK(same_files("whole/overlap.png", "joined/overlap.png"), "overlaps differ");
    CHECK(exists("joined/scene.gltf") && exists("joined/atlas.png") && exists("joined/atlas.exr") && !parts_left(),
          "files are missing");
    CHECK(BAKE(MAP, "--directional", "--join", "parts", "-o", "plain", "--gutter", "0") == 0 &&
              fabs(mean_difference("plain/lightmap.pfm", "plain/atlas.pfm")) < 1e-6, "%s", ran.err);
}

/* Joined parts have the same light groups as the map that is baked at once. The groups add up to its light. */
TEST(parts_have_light_groups) {
    static const char *const files[] = { "atlas.pfm", "atlas_above.pfm", "atlas_lamp.pfm" };
    const char *const arguments[] = { MAP, "--sky", "0.3,0.2,0.1", "--light-groups", "above=sky,lamp=*", NULL };
    char names[2][64];
    picture p[3];
    double off = 0, mean = 0;
    int i;
    if (!has_openexr()) SKIP("built without OpenEXR");
    mkdir(in_folder("g"), 0777);
    tool_use("sbl_bake");
    REQUIRE(run_parts(arguments, "g/%d.exr", 2), "%s", ran.err);
    CHECK(BAKE(MAP, "--sky", "0.3,0.2,0.1", "--light-groups", "above=sky,lamp=*", "-o", "whole") == 0, "%s", ran.err);
    CHECK(BAKE(MAP, "--sky", "0.3,0.2,0.1", "--light-groups", "above=sky,lamp=*", "--join", "g", "-o", "joined") == 0 &&
          !ran.err[0], "%s", ran.err);
    for (i = 0; i < 3; i++) {
        snprintf(names[0], sizeof names[0], "whole/%s", files[i]);
        snprintf(names[1], sizeof names[1], "joined/%s", files[i]);
        CHECK(fabs(mean_difference(names[0], names[1])) < 0.01, "%s differs by %g", files[i],
              mean_difference(names[0], names[1]));
        p[i] = read_pfm(names[1]);
        REQUIRE(p[i].values, "%s is missing", names[1]);
    }
    for (i = 0; i < 3 * p[0].width * p[0].height; i++) {
        off = test_max(off, fabs((double)p[1].values[i] + (double)p[2].values[i] - (double)p[0].values[i]));
        mean += (double)p[0].values[i] / (3 * p[0].width * p[0].height);
    }
    CHECK(off < 1e-5 * mean && mean > 0, "the sum is off by %g, mean %g", off, mean);
    for (i = 0; i < 3; i++) free(p[i].values);
}

/* A part has the same bits with the plan of another run and with a plan that its own run makes. */
TEST(parts_do_not_depend_on_each_other) {
    if (!has_openexr()) SKIP("built without OpenEXR");
    CHECK(BAKE(MAP, "--part", "2/3", "-o", "a.exr", "--plan", "plan") == 0 && exists("plan"), "%s", ran.err);
    CHECK(BAKE(MAP, "--part", "2/3", "-o", "b.exr", "--plan", "plan") == 0 && same_files("a.exr", "b.exr"),
          "with the plan of a file: %s", ran.err);
    setenv("SLURM_ARRAY_TASK_ID", "2", 1);
    CHECK(BAKE(MAP, "--part", "auto/3", "-o", "c%d.exr") == 0 && same_files("a.exr", "c2.exr"),
          "with a plan of its own: %s", ran.err);
    unsetenv("SLURM_ARRAY_TASK_ID");
    CHECK(BAKE(MAP, "--part", "1/2", "-o", "b.exr", "--plan", "plan") == 1 && said("3 parts"), "%s", ran.err);
}

/* The part of a map uses the number of cells of its plan. */
TEST(plans_set_the_number_of_cells) {
#define BOUNCED(...) BAKE("room.gltf", "--lightmap", "24", "--preset", "draft", "--quiet", "--max-bounce-cells", \
                          "1200", "--part", "1/2", "-o", "a.exr", "--plan", "cells", __VA_ARGS__)
    char text[8192];
    int lines;
    if (!has_openexr()) SKIP("built without OpenEXR");
    CHECK(BOUNCED(FILES) == 0, "%s", ran.err);
    REQUIRE(replace_in("cells", "\nsbl.cells 1200\n", "\nsbl.cells 1100\n"), "the plan has no number of cells");
    CHECK(BOUNCED("--stats", "stats.json") == 0, "%s", ran.err);
    read_text(in_folder("stats.json"), text, sizeof text, &lines);
    CHECK(strstr(text, "\"max_bounce_cells\": 1100,"), "statistics: %s", text);
#undef BOUNCED
}

/* Parts that do not belong together are refused with an error that names the part, and nothing is written. */
TEST(wrong_parts_are_refused) {
    if (!has_openexr()) SKIP("built without OpenEXR");
    REQUIRE(make_parts("p", 3, NULL, NULL), "%s", ran.err);
    CHECK(BAKE(MAP, "--join", "p", "-o", "out", "--seed", "4") == 1 && said("p/01.exr does not fit") &&
          said("other options") && said("--seed=4"), "%s", ran.err);
    CHECK(BAKE("room.gltf", "--lightmap", "97", "--mode", "direct", "--join", "p", "-o", "out") == 1 &&
          said("96x96"), "%s", ran.err);
    CHECK(BAKE(MAP, "--directional", "--join", "p", "-o", "out") == 1 && said("p/01.exr does not fit") &&
          said("other channels"), "%s", ran.err);
    CHECK(BAKE(MAP, "--join", "none", "-o", "out") == 1 && said("none: this folder cannot be read"), "%s", ran.err);
    mkdir(in_folder("empty"), 0777);
    CHECK(BAKE(MAP, "--join", "empty", "-o", "out") == 1 &&
          said("empty: this folder has no files whose names end in .exr"), "%s", ran.err);
    CHECK(MERGE("p", "-o", "all.exr") == 1 && said("--join"), "%s", ran.err);
    damage("p/02.exr", "p/04.exr", 0, -1);
    CHECK(BAKE(MAP, "--join", "p", "-o", "out") == 1 && said("p/02.exr and p/04.exr are both part 2 of 3"), "%s",
          ran.err);
    remove(in_folder("p/04.exr"));
    damage("p/03.exr", "p/03.exr", 1, -1);
    CHECK(BAKE(MAP, "--join", "p", "-o", "out") == 1 && said("p/03.exr"), "%s", ran.err);
    remove(in_folder("p/03.exr"));
    CHECK(BAKE(MAP, "--join", "p", "-o", "out") == 1 && said("part 3 of 3 is missing"), "%s", ran.err);
    write_scene("room.gltf", overlapping, 1);
    CHECK(BAKE(MAP, "--join", "p", "-o", "out") == 1 && said("another scene") && !said("it has"), "%s",
          ran.err);
    CHECK(!exists("out"), "a folder is left");
}

/* Moves the lamp next to the floor in the map, so that their charts share a seam. */
static void move_lamp(void) {
    static const float beside[4][3] = { { 2.25f, -0.5f, -2 }, { 2.25f, -0.5f, 2 }, { 6.25f, -0.5f, 2 },
                                        { 6.25f, -0.5f, -2 } };
    FILE *out = fopen(in_folder("room.gltf.bin"), "r+b");
    if (!out) return;
    fseek(out, 112, SEEK_SET);
    fwrite(beside, 1, sizeof beside, out);
    fclose(out);
}

/* The statistics of a joined map describe the complete map. Options that have no effect on joining are named in a
   message, and change nothing. */
TEST(joining_is_described) {
    enum { SEAMS = 3 };
    static const struct { const char *name, *words; } facts[] = {
        { "mode", "\"mode\": \"direct\"" }, { "size", "\"size\": [96, 96]" }, { "mean", "\"mean\": [" },
        { "seams", "\"seams\": {\"edges\": 1," }
    };
    char text[4096];
    size_t i;
    int lines;
    if (!has_openexr()) SKIP("built without OpenEXR");
    write_scene("room.gltf", apart, 1);
    move_lamp();
    CHECK(BAKE(LARGE, "-o", "large", "--stats", "stats.json") == 0, "%s", ran.err);
    read_text(in_folder("stats.json"), text, sizeof text, &lines);
    CHECK(strstr(text, facts[SEAMS].words), "window by window: %s", text);
    REQUIRE(make_parts("s", 2, NULL, NULL), "%s", ran.err);
    CHECK(BAKE(MAP, "--join", "s", "-o", "joined", "--stats", "stats.json") == 0, "%s", ran.err);
    read_text(in_folder("stats.json"), text, sizeof text, &lines);
    for (i = 0; i < sizeof facts / sizeof *facts; i++)
        CHECK(strstr(text, facts[i].words), "%s: %s", facts[i].name, text);
    CHECK(!strstr(text, "\"visible_pixels\": 0,"), "%s", text);
    CHECK(BAKE("room.gltf", "--lightmap", "96", "--part", "1/1", "-o", "s/1.exr", "--gutter", "3") == 0 &&
              said("no effect: --gutter"), "%s", ran.err);
    remove(in_folder("s/01.exr"));
    remove(in_folder("s/02.exr"));
    CHECK(BAKE("room.gltf", "--lightmap", "96", "--join", "s", "-o", "gi", "--store", "light", "--stats", "stats.json")
              == 0 && said("no effect: --store") && !exists("light"), "%s", ran.err);
    read_text(in_folder("stats.json"), text, sizeof text, &lines);
    CHECK(strstr(text, "\"mode\": \"gi\""), "%s", text);
    CHECK(BAKE("room.gltf", "--lightmap", "96", "--join", "s", "-o", "s/.") == 2 && said("among its parts"), "%s",
          ran.err);
}

/* A damaged plan is refused with an error that names it. An output never replaces a plan. */
TEST(plans_are_checked) {
    static const char *const facts[][2] = { { "mean", "nan 0 0" }, { "mean", "-1 0 0" }, { "mean", "0 0" },
        { "mean", "1e999 0 0" }, { "mean", "1 1 1 x" }, { "price", "1 -1 64" }, { "price", "1 1" },
        { "cells", "1023" }, { "cells", "1048577" }, { "cells", "2000 1" } };
    char text[4096], begin[64], *fact, other[4096];
    size_t i;
    int lines;
    if (!has_openexr()) SKIP("built without OpenEXR");
    CHECK(BAKE(MAP, "--part", "1/2", "-o", "new.exr", "--plan", "new.exr") == 2 && said("overwrite") &&
              !exists("new.exr"), "%s", ran.err);
    write_file("sky\n.ppm", "P6\n2 1\n255\n\xff\xff\xff\x80\x40\xff", 11 + 6);
    CHECK(BAKE(MAP, "--sky", "sky\n.ppm", "--part", "1/2", "-o", "a.exr", "--plan", "lines") == 0, "%s", ran.err);
    CHECK(BAKE(MAP, "--sky", "sky\n.ppm", "--part", "2/2", "-o", "a.exr", "--plan", "lines") == 0, "%s", ran.err);
    REQUIRE(BAKE(MAP, "--part", "1/2", "-o", "a.exr", "--plan", "good") == 0, "%s", ran.err);
    read_text(in_folder("good"), text, sizeof text, &lines);
    for (i = 0; i < sizeof facts / sizeof *facts; i++) {
        snprintf(begin, sizeof begin, "sbl.%s ", facts[i][0]);
        fact = strstr(text, begin);
        REQUIRE(fact, "%s", text);
        snprintf(other, sizeof other, "%.*s%s%s%s", (int)(fact - text), text, begin, facts[i][1], strchr(fact, '\n'));
        write_text("bad", other);
        CHECK(BAKE(MAP, "--part", "1/2", "-o", "a.exr", "--plan", "bad") == 1 && said("bad: it is damaged"),
              "%s%s: %s", begin, facts[i][1], ran.err);
    }
}

/* A map is refused before it is baked if the allowed memory is too small to join it. */
TEST(memory_for_joining) {
    if (!has_openexr()) SKIP("built without OpenEXR");
    CHECK(BAKE("room.gltf", "--lightmap", "4096", "--memory", "512M", "-o", "m") == 1 &&
              said("--memory allows 537 MB") && !exists("m") && !exists("m.parts"), "%s", ran.err);
    REQUIRE(make_parts("parts", 1, NULL, NULL), "%s", ran.err);
    CHECK(BAKE("room.gltf", "--lightmap", "4096", "--memory", "512M", "--join", "parts", "-o", "m") == 1 &&
              said("--memory allows"), "%s", ran.err);
}

TEST(wrong_usage) {
    static const struct { const char *part, *words; } wrong[] = { { "0/2", "K/N" }, { "3/2", "does not exist" } };
    size_t i;
    if (!has_openexr()) SKIP("built without OpenEXR");
    for (i = 0; i < sizeof wrong / sizeof *wrong; i++)
        CHECK(BAKE(MAP, "--part", wrong[i].part, "-o", "a.exr") == 2 && said(wrong[i].words), "%s", ran.err);
    CHECK(BAKE(MAP, "--part", "1/2", "-o", "folder") == 2 && said("--join"), "%s", ran.err);
    CHECK(BAKE(MAP, "--plan", "p", "-o", "out") == 2 && said("--part"), "%s", ran.err);
    CHECK(BAKE(MAP, "--part", "1/2", "--join", "p", "-o", "a.exr") == 2 && said("only one"), "%s", ran.err);
    CHECK(BAKE(MAP, "--resume", "--join", "p", "-o", "out") == 2 && said("only one"), "%s", ran.err);
    CHECK(BAKE("room.gltf", "--probes", "1x1x1", "--resume", "-o", "a.json") == 2 && said("--lightmap"), "%s", ran.err);
    CHECK(BAKE("room.gltf", "--lightmap", "2", "--part", "5/5", "-o", "a.exr") == 2 && said("too many"), "%s", ran.err);
}

/* A map that exceeds the allowed memory is baked window by window. A run that was killed continues with the first
   missing window, and the result has the same bits. A part can also be made window by window. */
TEST(killed_runs_go_on) {
    const char *const arguments[] = { LARGE, "-o", "often/", "--resume", NULL };
    int killed, windows;
    if (!has_openexr()) SKIP("built without OpenEXR");
    CHECK(BAKE(LARGE, "-o", "once", "--verbose") == 0 && said("window 2 of ") && !exists("once.parts"), "%s", ran.err);
    killed = kill_when(arguments, "often", 1);
    windows = finished_windows("often");
    CHECK(killed && windows >= 1, "killed %d, with %d windows", killed, windows);
    CHECK(BAKE(LARGE, "-o", "often") == 1 && said("--resume"), "finished work is lost: %s", ran.err);
    CHECK(BAKE(LARGE, "-o", "often", "--resume", "--supersample", "2") == 1 && said("other options"), "%s", ran.err);
    CHECK(run(arguments) == 0, "%s", ran.err);
    CHECK(same_files("once/lightmap.exr", "often/lightmap.exr") && same_files("once/atlas.exr", "often/atlas.exr") &&
              same_files("once/scene.gltf", "often/scene.gltf") && !exists("often.parts") && !parts_left(),
          "the map differs, or files are left");
    CHECK(BAKE(LARGE, "--memory", "4G", "-o", "whole") == 0 &&
              fabs(mean_difference("whole/atlas.pfm", "once/atlas.pfm")) < 0.03, "differs by %g from the whole: %s",
          mean_difference("whole/atlas.pfm", "once/atlas.pfm"), ran.err);
    mkdir(in_folder("one"), 0777);
    CHECK(BAKE(LARGE, "--part", "1/1", "-o", "one/a.exr", "--verbose") == 0 && said("window 2 of ") &&
              !exists("one/a.exr.parts"), "%s", ran.err);
    CHECK(BAKE(LARGE, "--join", "one", "-o", "joined") == 0 &&
              fabs(mean_difference("whole/atlas.pfm", "joined/atlas.pfm")) < 0.03, "%s", ran.err);
}

int main(int argc, char **argv) {
    (void)argc;
    if (!tool_begin(argv[0])) return 1;
    RUN(parts_make_the_map);
    RUN(parts_have_light_groups);
    RUN(parts_do_not_depend_on_each_other);
    RUN(plans_set_the_number_of_cells);
    RUN(wrong_parts_are_refused);
    RUN(joining_is_described);
    RUN(plans_are_checked);
    RUN(memory_for_joining);
    RUN(wrong_usage);
    RUN(killed_runs_go_on);
    tool_end();
    return test_report();
}
