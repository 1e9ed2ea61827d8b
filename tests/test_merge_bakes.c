/* Tests of bakes in parts: sbl_bake --part and sbl_merge, for probes and for light at vertices. Joined parts must equal
   the file of a bake in one piece, to the byte. */
#define _XOPEN_SOURCE 700
#define _DEFAULT_SOURCE
#include "support/test.h"
#include "support/tool.h"

/* These run sbl_merge or sbl_bake with the given arguments. */
#define MERGE(...) (tool_use("sbl_merge"), run((const char *const[]){ __VA_ARGS__, NULL }))
#define BAKE(...) (tool_use("sbl_bake"), run((const char *const[]){ __VA_ARGS__, NULL }))

/* The scene is a room of four meshes. The bakes use direct light and few rays. */
#define FAST "--mode", "direct", "--preset", "draft", "--quiet"
#define PROBES "meshes.obj", FAST, "--probes", "3x2x3"
#define VERTICES "meshes.obj", FAST, "--vertices"

/* Writes meshes.obj: three floors of 2, 12 and 4 triangles at different heights, and a lamp. */
static void meshes_obj(void) {
    static const int sides[3] = { 1, 6, 2 };
    char text[4096];
    int n, i, k, at = 1;
    write_text("room.mtl", "newmtl floor\nKd .7 .5 .3\nnewmtl wall\nKd .2 .5 .3\nnewmtl roof\nKd .5 .5 .5\n"
               "newmtl lamp\nKd 0 0 0\nKe 5 6 7\n");
    n = sprintf(text, "mtllib room.mtl\n");
    for (i = 0; i < 3; i++) {
        static const char *const names[3] = { "floor", "wall", "roof" };
        n += sprintf(text + n, "usemtl %s\n", names[i]);
        for (k = 0; k <= sides[i]; k++)
            n += sprintf(text + n, "v %g %g -2\nv %g %g 2\n", -2 + 4.0 * k / sides[i], 0.4 * i,
                         -2 + 4.0 * k / sides[i], 0.4 * i);
        for (k = 0; k < sides[i]; k++, at += 2) n += sprintf(text + n, "f %d %d %d %d\n", at, at + 1, at + 3, at + 2);
        at += 2;
    }
    sprintf(text + n, "usemtl lamp\nv -.5 2 -.5\nv .5 2 -.5\nv .5 2 .5\nv -.5 2 .5\nf -4 -3 -2 -1\n");
    write_text("meshes.obj", text);
}

/* Makes parts 1 to `count` as NAME.1.ENDING, NAME.2.ENDING and so on. arguments: arguments of sbl_bake, then NULL.
   Returns 1 if all parts were made. */
static int make_parts(const char *name, const char *ending, int count, const char *const *arguments) {
    char pattern[64];
    snprintf(pattern, sizeof pattern, "%s.%%d%s", name, ending);
    tool_use("sbl_bake");
    return run_parts(arguments, pattern, count);
}
#define PARTS(name, ending, count, ...) make_parts(name, ending, count, (const char *const[]){ __VA_ARGS__, NULL })

/* Returns a value from the head of a part, such as "first": of probes, or comment sbl.first of vertices. */
static int fact_of(const char *name, const char *fact) { return (int)number_after(name, fact); }

/* Limits the tool to 10 open files. */
static void few_files(void) {
    struct rlimit limit;
    limit.rlim_cur = limit.rlim_max = 10;
    setrlimit(RLIMIT_NOFILE, &limit);
}

/* ---- joining ---- */

/* Joined parts of a grid equal the file of the complete bake, also with one part, and with one part per probe. The
   number of parts may exceed the number of files that can be open. */
TEST(parts_of_a_grid) {
    meshes_obj();
    REQUIRE(BAKE(PROBES, "-o", "whole.json") == 0, "%s", ran.err);
    REQUIRE(PARTS("one", ".json", 1, PROBES) && MERGE("one.1.json", "-o", "all.json") == 0, "%s", ran.err);
    CHECK(same_files("all.json", "whole.json") && !ran.err[0], "one part is not the whole: %s", ran.err);
    mkdir(in_folder("parts"), 0777);
    REQUIRE(PARTS("parts/p", ".json", 18, PROBES), "%s", ran.err);
    in_child = few_files;
    CHECK(MERGE("parts", "-o", "all.json") == 0, "%s", ran.err);
    in_child = NULL;
    CHECK(same_files("all.json", "whole.json"), "18 parts are not the whole");
    REQUIRE(PARTS("p", ".json", 4, PROBES), "%s", ran.err);
    CHECK(MERGE("p.3.json", "p.1.json", "p.4.json", "p.2.json", "-o", "all.json") == 0 &&
          same_files("all.json", "whole.json"), "4 parts are not the whole: %s", ran.err);
    CHECK(fact_of("p.3.json", "\"first\": ") == 9 && fact_of("p.3.json", "\"count\": ") == 4 &&
          fact_of("p.3.json", "\"total\": ") == 18, "part 3 of 4 is %d, %d of %d", fact_of("p.3.json", "\"first\": "),
          fact_of("p.3.json", "\"count\": "), fact_of("p.3.json", "\"total\": "));
    CHECK(BAKE(PROBES, "-o", "whole.json", "--move", "1") == 0 && PARTS("m", ".json", 2, PROBES, "--move", "1") &&
          MERGE("m.1.json", "m.2.json", "-o", "all.json") == 0 && same_files("all.json", "whole.json"),
          "moved probes differ: %s", ran.err);
}

/* Joined parts of a list of positions equal the file of the complete bake. The list may have another name on another
   machine, a byte order mark, and lines of any length. */
TEST(parts_of_a_list) {
    char text[1024] = "", longer[2048];
    int i;
    meshes_obj();
    for (i = 0; i < 7; i++) sprintf(text + strlen(text), "%g 1.5 %g\n", 0.2 * i - 1, 0.1 * i);
    write_text("points.txt", text);
    sprintf(longer, "\xef\xbb\xbf%s#%504s 7 8 9\n", text, "");
    write_text("other name.txt", longer);
    REQUIRE(BAKE("meshes.obj", FAST, "--probes", "points.txt", "-o", "whole.json") == 0, "%s", ran.err);
    REQUIRE(PARTS("p", ".json", 3, "meshes.obj", FAST, "--probes", "points.txt"), "%s", ran.err);
    CHECK(BAKE("meshes.obj", FAST, "--probes", "9x9x9", "--probes", "other name.txt", "--part=2/3", "-o",
               "p.2.json") == 0, "%s", ran.err);
    CHECK(MERGE("p.1.json", "p.2.json", "p.3.json", "-o", "all.json") == 0 && same_files("all.json", "whole.json"),
          "parts are not the whole: %s", ran.err);
    text[0] = '3';
    write_text("points.txt", text);
    CHECK(BAKE("meshes.obj", FAST, "--probes", "points.txt", "--part=2/3", "-o", "p.2.json") == 0, "%s", ran.err);
    CHECK(MERGE("p.1.json", "p.2.json", "p.3.json", "-o", "no.json") == 1 && said("7 listed probes") &&
          said("of something else") && !exists("no.json"), "%s", ran.err);
    write_text("points.txt", "# none\n");
    CHECK(BAKE("meshes.obj", FAST, "--probes", "points.txt", "-o", "no.json", "--part", "1/1") == 1 &&
          said("it has no positions") && !exists("no.json"), "%s", ran.err);
}

/* Joined parts of meshes equal the file of the complete bake. The parts have similar numbers of triangles. */
TEST(parts_of_vertices) {
    int count;
    meshes_obj();
    REQUIRE(BAKE(VERTICES, "-o", "whole.ply") == 0, "%s", ran.err);
    for (count = 1; count <= 4; count++) {
        char name[16];
        snprintf(name, sizeof name, "v%d", count);
        mkdir(in_folder(name), 0777);
        snprintf(name, sizeof name, "v%d/v", count);
        REQUIRE(PARTS(name, ".ply", count, VERTICES), "%s", ran.err);
        name[2] = 0;
        CHECK(MERGE(name, "-o", "all.ply") == 0 && same_files("all.ply", "whole.ply"), "%d parts are not the whole: %s",
              count, ran.err);
    }
    /* the meshes have 2, 12, 4 and 2 triangles */
    CHECK(fact_of("v2/v.2.ply", "comment sbl.first ") == 2 && fact_of("v3/v.2.ply", "comment sbl.first ") == 1 &&
          fact_of("v3/v.2.ply", "comment sbl.count ") == 1 && fact_of("v4/v.4.ply", "comment sbl.first ") == 3,
          "parts begin at %d, %d (%d), %d", fact_of("v2/v.2.ply", "comment sbl.first "),
          fact_of("v3/v.2.ply", "comment sbl.first "), fact_of("v3/v.2.ply", "comment sbl.count "),
          fact_of("v4/v.4.ply", "comment sbl.first "));
    /* The last of three meshes has the most triangles. The first two parts must leave it to part 3, because each part
       gets at least one mesh. */
    write_text("late.obj", "mtllib room.mtl\nv -2 0 -2\nv -2 0 2\nv 2 0 2\nv 2 0 -2\nusemtl floor\nf 1 2 3\n"
               "usemtl wall\nf 1 3 4\nv -1 2 -1\nv 1 2 -1\nv 1 2 0\nv -1 2 0\nv 1 2 1\nv -1 2 1\nusemtl lamp\n"
               "f 5 6 7 8\nf 8 7 9 10\n");
    CHECK(BAKE("late.obj", FAST, "--vertices", "-o", "whole.ply") == 0 &&
          PARTS("l", ".ply", 3, "late.obj", FAST, "--vertices") &&
          MERGE("l.1.ply", "l.2.ply", "l.3.ply", "-o", "all.ply") == 0 && same_files("all.ply", "whole.ply") &&
          fact_of("l.3.ply", "comment sbl.first ") == 2, "the last mesh is large: %s", ran.err);
    CHECK(BAKE(VERTICES, "--average", "-o", "whole.ply") == 0 && PARTS("a", ".ply", 2, VERTICES, "--average") &&
          MERGE("a.1.ply", "a.2.ply", "-o", "all.ply") == 0 && same_files("all.ply", "whole.ply"),
          "averages differ: %s", ran.err);
}

/* Joined parts with light groups equal the file of the complete bake. Parts with other groups are refused, and so are
   damaged groups. */
TEST(parts_with_light_groups) {
    static const char *const names[2] = { "whole.json", "whole.ply" };
    static const char *const edits[][2] = { { "{\"above\": {", "{\"about\": {" }, { "\"rest\"]", "\"res t\"" },
                                            { "\"rest\"]", "\"fest\"]" },
                                            { "property float radiance_rest_g", "property float radiance_rest_h" } };
    static char text[65536], stars[125];
    size_t i;
    int lines;
#define GROUPS "--sky", "0.3,0.2,0.1", "--light-groups", "above=sky"
    meshes_obj();
    memset(stars, '*', sizeof stars - 1);
    REQUIRE(BAKE(PROBES, GROUPS, "-o", names[0]) == 0 && BAKE(VERTICES, GROUPS, "-o", names[1]) == 0 &&
            PARTS("p", ".json", 2, PROBES, GROUPS) && PARTS("v", ".ply", 3, VERTICES, GROUPS), "%s", ran.err);
    CHECK(MERGE("p.2.json", "p.1.json", "-o", "all.json") == 0 && same_files("all.json", names[0]), "%s", ran.err);
    CHECK(MERGE("v.2.ply", "v.3.ply", "v.1.ply", "-o", "all.ply") == 0 && same_files("all.ply", names[1]), "%s",
          ran.err);
    REQUIRE(PARTS("o", ".ply", 3, VERTICES, "--sky", "0.3,0.2,0.1", "--light-groups", "beyond=sky"), "%s", ran.err);
    CHECK(MERGE("v.1.ply", "o.2.ply", "v.3.ply", "-o", "no.ply") == 1 && said("other options"), "%s", ran.err);
    for (i = 0; i < 2; i++) {  /* the lists of groups differ only after 255 characters */
        char list[300], name[16];
        sprintf(list, "a=[!s]%s,b=sky%s", stars + 3, stars + i);
        sprintf(name, "l%d", (int)i);
        REQUIRE(PARTS(name, ".json", 2, PROBES, "--sky", "0.3,0.2,0.1", "--light-groups", list), "%s", ran.err);
    }
    CHECK(MERGE("l0.1.json", "l1.2.json", "-o", "no.json") == 1 && said("other options"), "%s", ran.err);
    for (i = 0; i < 4; i++) {
        const char *from = i < 3 ? "p.2.json" : "v.2.ply", *to = i < 3 ? "bad.json" : "bad.ply";
        FILE *in = fopen(in_folder(from), "rb");
        const size_t size = in ? fread(text, 1, sizeof text - 1, in) : 0;
        char *at;
        if (in) fclose(in);
        text[size] = 0;
        at = strstr(text, edits[i][0]);
        REQUIRE(at, "%s has no %s", from, edits[i][0]);
        memcpy(at, edits[i][1], strlen(edits[i][1]));
        write_file(to, text, size);
        CHECK(MERGE(i < 3 ? "p.1.json" : "v.1.ply", to, "-o", i < 3 ? "no.json" : "no.ply") == 1 &&
              said("damaged"), "%s: %s", edits[i][1], ran.err);
    }
    read_text(in_folder("all.ply"), text, sizeof text, &lines);
    CHECK(strstr(text, "property float radiance_above_b\nproperty float radiance_rest_r\n"), "%.600s", text);
}

/* With bounced light, joined parts equal the complete bake, both if the parts share a store and if each part makes its
   own. */
TEST(parts_with_bounced_light) {
    meshes_obj();
#define GI "meshes.obj", "--preset", "draft", "--quiet", "--max-bounce-cells", "1024"
    REQUIRE(BAKE(GI, "--probes", "2x1x2", "-o", "whole.json") == 0 && BAKE(GI, "--vertices", "-o", "whole.ply") == 0,
            "%s", ran.err);
    CHECK(PARTS("p", ".json", 2, GI, "--probes", "2x1x2", "--store", "light") && exists("light") &&
          MERGE("p.1.json", "p.2.json", "-o", "all.json") == 0 && same_files("all.json", "whole.json"),
          "with one store: %s", ran.err);
    CHECK(PARTS("p", ".json", 2, GI, "--probes", "2x1x2") && MERGE("p.1.json", "p.2.json", "-o", "all.json") == 0 &&
          same_files("all.json", "whole.json"), "without a store: %s", ran.err);
    CHECK(PARTS("v", ".ply", 2, GI, "--vertices", "--store", "light") &&
          MERGE("v.1.ply", "v.2.ply", "-o", "all.ply") == 0 && same_files("all.ply", "whole.ply"), "vertices: %s",
          ran.err);
}

/* Parts are valid files for other programs. Python reads the JSON, also if options contain special characters. assimp
   reads the .ply through sbl_render, and the .ply has as many bytes as its header announces. */
TEST(parts_are_valid_files) {
    static char text[65536];
    const char *at;
    char command[1024];
    FILE *in;
    size_t size;
    int vertices = 0, faces = 0;
    meshes_obj();
    write_file("sky \"1\"\\\n\xe4.ppm", "P6\n2 1\n255\n\xff\xff\xff\x80\x40\xff", 11 + 6);
    REQUIRE(PARTS("p", ".json", 2, PROBES, "--sky", "sky \"1\"\\\n\xe4.ppm") &&
            PARTS("v", ".ply", 2, VERTICES, "--sky", "sky \"1\"\\\n\xe4.ppm"), "%s", ran.err);
    CHECK(MERGE("p.1.json", "p.2.json", "-o", "all.json") == 0 && MERGE("v.1.ply", "v.2.ply", "-o", "all.ply") == 0,
          "%s", ran.err);
    in = fopen(in_folder("v.2.ply"), "rb");
    size = in ? fread(text, 1, sizeof text - 1, in) : 0;
    if (in) fclose(in);
    at = strstr(text, "end_header\n");
    REQUIRE(at && strstr(text, "element vertex ") && strstr(text, "element face "), "the head is %.600s", text);
    vertices = atoi(strstr(text, "element vertex ") + 15);
    faces = atoi(strstr(text, "element face ") + 13);
    CHECK(size == (size_t)(at + 11 - text) + 36 * (size_t)vertices + 13 * (size_t)faces && faces > 0,
          "%d vertices, %d faces, %d bytes", vertices, faces, (int)size);
    tool_use("sbl_render");
    CHECK(TOOL("v.2.ply", "--mode", "direct", "--size", "8x8", "-o", "seen.png", "--quiet") == 0, "%s", ran.err);
    if (system("python3 --version > /dev/null 2>&1") != 0) SKIP("python3 is not installed");
    snprintf(command, sizeof command, "cd %s && python3 -c \"import json; d = json.load(open('p.2.json')); "
             "assert len(d['probes']) == d['sbl']['count'] == 9 and d['grid'] == [3, 2, 3]; "
             "assert chr(34) + '1' + chr(34) + chr(92) + chr(10) + chr(228) in d['sbl']['options']\"", folder);
    CHECK(system(command) == 0, "Python does not read the part");
}

/* ---- refused parts ---- */

#define REFUSED(words, ...) do {                                                                    \
        CHECK(MERGE(__VA_ARGS__) == 1 && said(words) && ran.err_lines == 1, "%s: %s", words, ran.err); \
    } while (0)

/* Wrong parts of probes are refused with an error that names the part, and an existing output file stays unchanged. */
TEST(wrong_probes_are_refused) {
    static char text[65536];
    int lines;
    meshes_obj();
    REQUIRE(PARTS("p", ".json", 3, PROBES) && PARTS("two", ".json", 2, PROBES) &&
            PARTS("seed", ".json", 3, PROBES, "--seed", "7") && PARTS("v", ".ply", 3, VERTICES) &&
            PARTS("grid", ".json", 3, "meshes.obj", FAST, "--probes", "3x2x2"), "%s", ran.err);
    write_text("all.json", "old");
#define TO_JSON "-o", "all.json"
    REFUSED("part 2 of 3 is missing", "p.1.json", "p.3.json", TO_JSON);
    REFUSED("2 of 3 parts are missing; the first is part 1", "p.2.json", TO_JSON);
    REFUSED("are both part 3 of 3", "p.1.json", "p.2.json", "p.3.json", "p.3.json", TO_JSON);
    REFUSED("two.2.json does not fit p.1.json: it is a part of 2, not of 3", "p.1.json", "two.2.json", TO_JSON);
    REFUSED("seed.3.json does not fit p.1.json: it was made with other options: it has --mode=direct --preset=draft "
            "--seed=7, the other has --mode=direct --preset=draft", "p.1.json", "p.2.json", "seed.3.json", TO_JSON);
    REFUSED("grid.2.json does not fit p.1.json: it was made of something else: it has probes of 3x2x2", "p.1.json",
            "grid.2.json", TO_JSON);
    REFUSED("no such.json: No such file", "p.1.json", "no such.json", TO_JSON);
    REFUSED("v.2.ply: not a part made by sbl_bake --probes --part", "p.1.json", "v.2.ply", TO_JSON);
    REFUSED("all.json: not a part", "all.json", "-o", "no.json");
    CHECK(BAKE(PROBES, "-o", "whole.json") == 0, "%s", ran.err);
    REFUSED("whole.json: not a part", "whole.json", TO_JSON);
    mkfifo(in_folder("pipe.json"), 0666);
    REFUSED("pipe.json: not a regular file", "pipe.json", TO_JSON);
    damage("p.2.json", "short.json", 1, -1);
    REFUSED("short.json: it is damaged or incomplete; make this part again", "p.1.json", "short.json", "p.3.json",
            TO_JSON);
    read_text(in_folder("p.2.json"), text, sizeof text, &lines);
    write_file("long.json", text, strlen(text) + 1);
    REFUSED("long.json: it is damaged", "p.1.json", "long.json", "p.3.json", TO_JSON);
    write_text("room.mtl", "newmtl floor\nKd .7 .5 .2\nnewmtl wall\nKd .2 .5 .3\nnewmtl roof\nKd .5 .5 .5\n"
               "newmtl lamp\nKd 0 0 0\nKe 5 6 7\n");
    CHECK(BAKE(PROBES, "--part", "2/3", "-o", "scene.json") == 0, "%s", ran.err);
    REFUSED("scene.json does not fit p.1.json: it was made from another scene", "p.1.json", "scene.json", TO_JSON);
    CHECK(!said("it has"), "the message shows a hash: %s", ran.err);
    CHECK(MERGE("p.1.json", "p.2.json", "p.3.json", "-o", "p.2.json") == 2 && said("overwrite"), "%s", ran.err);
    CHECK(MERGE("p.1.json", "-o", "all.txt") == 2 && said(".json or .ply"), "%s", ran.err);
    CHECK(MERGE("p.1.json", TO_JSON, "--exposure", "1") == 2 && said("--exposure"), "%s", ran.err);
    read_text(in_folder("all.json"), text, sizeof text, &lines);
    CHECK(strcmp(text, "old") == 0, "a refused merge has changed the file");
    CHECK(MERGE("p.1.json", "p.2.json", "p.3.json", TO_JSON) == 0 && !parts_left() &&
          same_files("all.json", "whole.json"), "%s", ran.err);
}

/* Replaces words in a part by others, and checks that sbl_merge refuses it. */
static void refuse_edited(const char *from, const char *words, const char *others, const char *message) {
    static char text[65536], edited[70000];
    char to[64];
    char *at;
    int lines;
    const char *ending = strrchr(from, '.');
    read_text(in_folder(from), text, sizeof text, &lines);
    at = strstr(text, words);
    REQUIRE(at, "%s has no %s", from, words);
    snprintf(edited, sizeof edited, "%.*s%s%s", (int)(at - text), text, others, at + strlen(words));
    snprintf(to, sizeof to, "edited%s", ending);
    write_text(to, edited);
    REQUIRE(MERGE("p.1.json", to, "-o", "no.json") == 1 && said(message) && ran.err_lines == 1 && !exists("no.json"),
            "%.40s instead of %s: status %d, %s", others, words, ran.status, ran.err);
}

/* Probes are copied only if they have exactly the form that sbl_bake writes. */
TEST(the_form_of_probes_is_checked) {
    static const char *const edits[][2] = {
        { "\"valid\": true", "\"valid\": truth" }, { "\"sh\": [[", "\"sh\": [[1, 2, 3], [" },
        { "\"cube\": [[", "\"cube\": [[0x1, " }, { "\"sky\": ", "\"sky\": nan" }, { "\"sky\": ", "\"sky\": 1-" },
        { "\"sky\": ", "\"sky\": +" }, { "\"distance\": [", "\"distance\": [0, " }, { ", \"back_share\"", "" },
        { "  {\"position\"", "{\"position\"" }, { "},\n  {\"position\"", "}\n  {\"position\"" },
        { "\n]}\n", "\n]}\n\n" }, { "\n]}\n", "\n]}" }, { "\n]}\n", "\n" }, { "\n]}\n", ",\n]}\n" },
        { "\"grid\": [3, 2, 3]", "\"grid\": [3, 3, 2]" }, { "\"grid\": [3, 2, 3]", "\"grid\": [03, 2, 3]" },
        { "\"grid\": [3, 2, 3]", "\"grid\": [3, 2, 2]" },
        { "\"count\": 9", "\"count\": 0" }, { "\"count\": 9", "\"count\": 10" },
        { "\"count\": 9", "\"count\": 99999999999" },
        { "\"origin\": [", "\"origin\": [1, " }, { "\"spacing\": [", "\"spacing\": [1" },
        { "\"constants\": [0.28", "\"constants\": [0.29" },
        { "\"probes\": [", "\"probes\": [ " }, { "\"options\": \"", "\"options\": \"\t" },
    };
    enum { LONG = 1024 };  /* facts are shorter than this */
    static char longest[16384], text[65536];
    size_t i, length;
    int lines;
    meshes_obj();
    REQUIRE(PARTS("p", ".json", 2, PROBES), "%s", ran.err);
    for (i = 0; i < sizeof edits / sizeof *edits; i++)
        refuse_edited("p.2.json", edits[i][0], edits[i][1], "edited.json: it is damaged");
    refuse_edited("p.2.json", "\"first\": 9", "\"first\": 8", "edited.json: it begins with number 8, not 9");
    refuse_edited("p.2.json", "\"part\": \"2/2\"", "\"part\": \"3/2\"", "it claims to be part 3 of 2");
    refuse_edited("p.2.json", "\"part\": \"2/2\"", "\"part\": \"0/2\"", "it claims to be part 0 of 2");
    refuse_edited("p.2.json", "\"part\": \"2/2\"", "\"part\": \"2/99999\"", "it claims to be part 2 of 99999");
    refuse_edited("p.2.json", "\"version\": \"", "\"version\": \"9", "by another version of sbl.h");
    memset(longest, '1', sizeof longest - 1);
    refuse_edited("p.2.json", "\"sky\": ", longest, "edited.json: it is damaged");
    refuse_edited("p.2.json", "\"options\": \"", longest, "edited.json: not a part");
    read_text(in_folder("p.2.json"), text, sizeof text, &lines);
    length = strcspn(strstr(text, "\"options\": \"") + 12, "\"");
    memcpy(longest, "\"options\": \"", 12);
    longest[12 + LONG - length] = 0;
    refuse_edited("p.2.json", "\"options\": \"", longest, "edited.json: it is damaged");
    longest[12 + LONG - length - 1] = 0;
    refuse_edited("p.2.json", "\"options\": \"", longest, "with other options");
    refuse_edited("p.2.json", "\"count\": 9", "\"count\": 8", "1 of 18 probes are in no part");
}

/* Wrong parts of vertices are refused, also those with another size than the header announces, and those with faces
   that refer to vertices of other parts. */
TEST(wrong_vertices_are_refused) {
    struct stat info;
    long size;
    meshes_obj();
    REQUIRE(PARTS("v", ".ply", 3, VERTICES) && PARTS("a", ".ply", 3, VERTICES, "--average") &&
            PARTS("p", ".json", 1, PROBES) && BAKE(VERTICES, "-o", "whole.ply") == 0, "%s", ran.err);
#define TO_PLY "-o", "no.ply"
    REFUSED("part 3 of 3 is missing", "v.1.ply", "v.2.ply", TO_PLY);
    REFUSED("are both part 1 of 3", "v.1.ply", "v.1.ply", "v.2.ply", "v.3.ply", TO_PLY);
    REFUSED("a.3.ply does not fit v.1.ply: it was made with other options: it has --mode=direct --preset=draft "
            "--average", "v.1.ply", "v.2.ply", "a.3.ply", TO_PLY);
    REFUSED("whole.ply: not a part made by sbl_bake --vertices --part", "whole.ply", TO_PLY);
    REFUSED("p.1.json: not a part", "p.1.json", TO_PLY);
    damage("v.2.ply", "short.ply", 1, -1);
    REFUSED("short.ply: it is damaged or incomplete; make this part again", "v.1.ply", "short.ply", "v.3.ply", TO_PLY);
    stat(in_folder("v.2.ply"), &info);
    size = (long)info.st_size;
    damage("v.2.ply", "turned.ply", 0, size - 13);
    REFUSED("turned.ply: it is damaged", "v.1.ply", "turned.ply", "v.3.ply", TO_PLY);
    damage("v.2.ply", "turned.ply", 0, size - 1);
    REFUSED("turned.ply: it is damaged", "v.1.ply", "turned.ply", "v.3.ply", TO_PLY);
    CHECK(MERGE("v.1.ply", "v.2.ply", "v.3.ply", "-o", "v.2.ply") == 2 && said("overwrite"), "%s", ran.err);
    CHECK(!exists("no.ply") && !parts_left(), "a file is left");
}

/* Invalid values of --part and --output are refused. */
TEST(invalid_parts_are_refused) {
#define CANNOT(words, ...) do {                                                                            \
        CHECK(BAKE(__VA_ARGS__) == 2 && said(words) && ran.err_lines == 1, "%s: %d, %s", words, ran.status, ran.err); \
    } while (0)
    meshes_obj();
    CANNOT("10000 parts are too many for 18 probes", PROBES, "--part", "1/10000", "-o", "no.json");
    CANNOT("19 parts are too many for 18 probes", PROBES, "--part", "19/19", "-o", "no.json");
    CANNOT("there are 3 parts, so part 4 does not exist", PROBES, "--part", "4/3", "-o", "no.json");
    CANNOT("5 parts are too many for 4 meshes: a part contains at least one mesh", VERTICES, "--part", "1/5", "-o",
           "no.ply");
    CANNOT("a part is a .ply file", VERTICES, "--part", "1/2", "-o", "no.gltf");
    CANNOT("must end in .json", PROBES, "--part", "1/2", "-o", "no.txt");
    CANNOT("K/N", PROBES, "--part", "1/10001", "-o", "no.json");
    CANNOT("SLURM_ARRAY_TASK_ID", PROBES, "--part", "auto/3", "-o", "no.json");
    CANNOT("%04d", PROBES, "--part", "1/3", "-o", "no%s.json");
    CHECK(!exists("no.json") && !exists("no.ply") && !exists("no"), "something was written");
    setenv("SLURM_ARRAY_TASK_ID", "2", 1);
    CHECK(BAKE(PROBES, "--part", "auto/3", "-o", "a%03d.json") == 0 && fact_of("a002.json", "\"first\": ") == 6, "%s",
          ran.err);
    unsetenv("SLURM_ARRAY_TASK_ID");
    setenv("JOB_COMPLETION_INDEX", "9223372036854775807", 1);
    CANNOT("JOB_COMPLETION_INDEX is 9223372036854775807, which is not the number", PROBES, "--part", "auto/3", "-o",
           "no.json");
    unsetenv("JOB_COMPLETION_INDEX");
}

/* Parts that were made with different drivers give one warning. Mesa's software renderer counts as another driver if
   its vectors have another width. */
TEST(drivers_may_differ) {
    meshes_obj();
    REQUIRE(PARTS("p", ".json", 3, PROBES), "%s", ran.err);
    setenv("LP_NATIVE_VECTOR_WIDTH", "128", 1);
    CHECK(BAKE(PROBES, "--part", "2/3", "-o", "p.2.json", "--verbose") == 0, "%s", ran.err);
    unsetenv("LP_NATIVE_VECTOR_WIDTH");
    if (!said("128 bits")) SKIP("the driver has no vectors to choose from");
    CHECK(MERGE("p.1.json", "p.2.json", "p.3.json", "-o", "all.json") == 0 && said("different graphics drivers") &&
          ran.err_lines == 1, "%s", ran.err);
    CHECK(MERGE("p.1.json", "p.2.json", "p.3.json", "-o", "all.json", "--quiet") == 0 && !ran.err[0], "%s", ran.err);
}

/* Interrupted runs and runs on a full disk leave no incomplete file. */
TEST(no_half_files) {
    static const char *const slow[] = { "meshes.obj", "--mode", "direct", "--rays", "4096", "--probes", "40x40x40",
        "--part", "2/3", "-o", "no.json", NULL };
    static const char *const full[] = { PROBES, "--part", "1/1", "-o", "no.json", NULL };
    static const char *const merge[] = { "one.1.json", "-o", "no.json", NULL };
    meshes_obj();
    tool_use("sbl_bake");
    if (interrupt_at(slow, 0, SIGTERM))
        CHECK(ran.status == 143 && said("nothing was written") && !exists("no.json") && !parts_left(),
              "exit status %d: %s", ran.status, ran.err);
    finish(start(full, -1, 4096));
    CHECK(ran.status == 1 && said("no.json: cannot be written") && !exists("no.json") && !parts_left(), "%d: %s",
          ran.status, ran.err);
    REQUIRE(PARTS("one", ".json", 1, PROBES), "%s", ran.err);
    tool_use("sbl_merge");
    finish(start(merge, -1, 4096));
    CHECK(ran.status == 1 && said("no.json: cannot be written") && !exists("no.json") && !parts_left(), "%d: %s",
          ran.status, ran.err);
}

int main(int argc, char **argv) {
    (void)argc;
    if (!tool_begin(argv[0])) return 1;
    RUN(parts_of_a_grid);
    RUN(parts_of_a_list);
    RUN(parts_of_vertices);
    RUN(parts_with_light_groups);
    RUN_PLAIN(parts_with_bounced_light);
    RUN(parts_are_valid_files);
    RUN(wrong_probes_are_refused);
    RUN(the_form_of_probes_is_checked);
    RUN(wrong_vertices_are_refused);
    RUN(invalid_parts_are_refused);
    RUN_PLAIN(drivers_may_differ);
    RUN(no_half_files);
    tool_end();
    return test_report();
}
