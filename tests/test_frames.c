/* Tests picture sequences: sbl_render --cameras, --frames and --fps. */
#define _XOPEN_SOURCE 700
#define _DEFAULT_SOURCE
#include "support/test.h"
#include "support/tool.h"
#include <math.h>

/* A room of 32 x 24 pixels in direct light, without a camera. */
#define LOOK "--size", "32x24", SMALL, "--mode", "direct", "--preset", "draft", "--quiet"
#define VIEW "room.obj", LOOK
#define FIVE VIEW, "--cameras", "five.json"
#define GI "--mode", "gi", "--max-bounce-cells", "1024"

/* Writes a text in which every ' is replaced by ". */
static void write_json(const char *name, const char *text) {
    char *copy = strdup(text), *c;
    for (c = copy; *c; c++) if (*c == '\'') *c = '"';
    write_text(name, copy);
    free(copy);
}

/* Writes the room and a file of five cameras. The floor is bright in the first picture, and each later camera sees less
   of it. */
static void begin(void) {
    room_obj();
    write_json("five.json", "{'cameras': [\n"
               "  {'eye': [0, 1.4, 3], 'look_at': [0, 0.5, 0]},\n"
               "  {'eye': [0.5, 1.4, 3], 'look_at': [0, 0.5, 0], 'fov': 50, 'up': [0.1, 1, 0]},\n"
               "  {'camera_to_world': [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 1, 3, 1], 'fov': 35},\n"
               "  {'look_at': [1, 0.5, 0], 'eye': [0, 1.4, 3e0]},\n"
               "  {'eye': [1.5, 1.9, -1], 'look_at': [1.5, 0, -1.5], 'up': [0, 0, -1], 'fov': 20}]}\n");
}

static int has_cjson(void) {
    begin();
    return !(TOOL(FIVE, "--frames", "1", "-o", "probe%d.pfm") == 1 && said("cJSON"));
}

/* Returns the exposure that --verbose prints, in hundredths of a stop. */
static int exposure(void) {
    const char *words = strstr(ran.err, "exposure: ");
    return words ? (int)lround(100 * atof(words + 10)) : -100000;
}

/* ---- cameras from a file ---- */

/* Each frame equals, to the bit, the picture with the options for its camera. --fov and --up apply to cameras that do
   not state them. */
TEST(cameras_are_those_of_the_options) {
    if (!has_cjson()) SKIP("built without cJSON");
    CHECK(TOOL(FIVE, "-o", "f%d.pfm") == 0 && !ran.err[0], "%s", ran.err);
    CHECK(TOOL(VIEW, "-o", "o.pfm", "--eye", "0,1.4,3", "--look-at", "0,.5,0") == 0 && same_files("o.pfm", "f1.pfm"),
          "frame 1 differs: %s", ran.err);
    CHECK(TOOL(VIEW, "-o", "o.pfm", "--eye", ".5,1.4,3", "--look-at", "0,.5,0", "--fov", "50", "--up", ".1,1,0") == 0 &&
          same_files("o.pfm", "f2.pfm"), "frame 2 differs: %s", ran.err);
    CHECK(TOOL(VIEW, "-o", "o.pfm", "--eye", "0,1,3", "--look-at", "0,1,0", "--fov", "35") == 0 &&
          same_files("o.pfm", "f3.pfm"), "frame 3 differs: %s", ran.err);
    CHECK(TOOL(VIEW, "-o", "o.pfm", "--eye", "0,1.4,3", "--look-at", "1,.5,0") == 0 && same_files("o.pfm", "f4.pfm"),
          "frame 4 differs: %s", ran.err);
    CHECK(!same_files("f1.pfm", "f4.pfm") && !same_files("f1.pfm", "f2.pfm"), "frames do not differ");
    CHECK(TOOL(FIVE, "-o", "g%04d.pfm", "--fov", "60", "--up", "1,0,0", "--frames", "1-3") == 0, "%s", ran.err);
    CHECK(TOOL(VIEW, "-o", "o.pfm", "--eye", "0,1.4,3", "--look-at", "0,.5,0", "--fov", "60", "--up", "1,0,0") == 0 &&
          same_files("o.pfm", "g0001.pfm") && same_files("f2.pfm", "g0002.pfm"), "other defaults: %s", ran.err);
    CHECK(same_files("f3.pfm", "g0003.pfm"), "--up turns a camera that has a matrix");
    CHECK(!exists("g0004.pfm") && !parts_left(), "too many files");
}

/* A frame has the same bits and the same exposure, whichever other frames a run renders: with stored light, and with
   the light of a studio, which depends on a camera. */
TEST(frames_do_not_depend_on_each_other) {
    if (!has_cjson()) SKIP("built without cJSON");
    write_text("dark.mtl", "newmtl floor\nKd .7 .5 .3\nnewmtl lamp\nKd .1 .1 .1\n");
    CHECK(TOOL(FIVE, GI, "--store", "light", "-o", "a%d.png") == 0, "%s", ran.err);
    CHECK(TOOL(FIVE, GI, "--store", "light", "-o", "b%d.png", "--frames", "4") == 0 &&
          same_files("a4.png", "b4.png"), "one frame of stored light differs: %s", ran.err);
    CHECK(TOOL(FIVE, GI, "-o", "b%d.png", "--frames", "3-5") == 0 && same_files("a3.png", "b3.png") &&
          same_files("a4.png", "b4.png") && same_files("a5.png", "b5.png"), "three frames differ: %s", ran.err);
    CHECK(TOOL(FIVE, GI, "-o", "b%d.png", "--part", "3/3") == 0 && same_files("a4.png", "b4.png") &&
          same_files("a5.png", "b5.png"), "a share of the frames differs: %s", ran.err);
    CHECK(TOOL(FIVE, "--studio", "-o", "a%d.png") == 0, "%s", ran.err);
    CHECK(TOOL(FIVE, "--studio", "-o", "b%d.png", "--frames", "5") == 0 && same_files("a5.png", "b5.png"),
          "the light of a studio differs: %s", ran.err);
}

/* All frames use the automatic exposure of frame 1, even if frame 5 alone would get another. An explicit --exposure
   overrides it. */
TEST(exposure_does_not_flicker) {
    int first, fifth, alone;
    if (!has_cjson()) SKIP("built without cJSON");
    TOOL(FIVE, "--verbose", "--frames", "1", "-o", "f%d.png");
    first = exposure();
    TOOL(FIVE, "--verbose", "--frames", "5", "-o", "f%d.png");
    fifth = exposure();
    TOOL(VIEW, "--verbose", "-o", "o.png", "--eye", "1.5,1.9,-1", "--look-at", "1.5,0,-1.5", "--up", "0,0,-1", "--fov",
         "20");
    alone = exposure();
    CHECK(first == fifth && first > -10000, "exposures in hundredths of a stop: %d and %d", first, fifth);
    CHECK(abs(alone - first) > 10, "this test needs cameras with different exposures: %d and %d", alone, first);
    CHECK(TOOL(FIVE, "--verbose", "--frames", "5", "-o", "g%d.png", "--exposure", "1.5") == 0 && exposure() == 150,
          "%s", ran.err);
    CHECK(TOOL(VIEW, "-o", "o.png", "--eye", "1.5,1.9,-1", "--look-at", "1.5,0,-1.5", "--up", "0,0,-1", "--fov", "20",
               "--exposure", "1.5") == 0 && same_files("o.png", "g5.png"), "%s", ran.err);
}

/* Parts are contiguous ranges of frames. */
TEST(parts_share_the_frames) {
    static const char made[3][6] = { "10000", "11100", "11111" };  /* the frames that exist after parts 1, 2 and 3 */
    char part[16], name[16];
    int k, i;
    if (!has_cjson()) SKIP("built without cJSON");
    for (k = 1; k <= 3; k++) {
        snprintf(part, sizeof part, k == 2 ? "auto/3" : "%d/3", k);
        setenv("SLURM_ARRAY_TASK_ID", "2", 1);
        CHECK(TOOL(FIVE, "--part", part, "-o", "s%d.pfm") == 0, "%s", ran.err);
        unsetenv("SLURM_ARRAY_TASK_ID");
        for (i = 1; i <= 5; i++) {
            snprintf(name, sizeof name, "s%d.pfm", i);
            CHECK(exists(name) == (made[k - 1][i - 1] == '1'), "after part %d, %s is %s", k, name,
                  exists(name) ? "there" : "missing");
        }
    }
    CHECK(TOOL(FIVE, "--part", "2/2", "--frames", "2-4", "-o", "t%d.pfm") == 0 && !exists("t2.pfm") &&
          exists("t3.pfm") && exists("t4.pfm") && !exists("t5.pfm"), "%s", ran.err);
    CHECK(TOOL(FIVE, "--part", "1/6", "-o", "t%d.pfm") == 2 && said("5 frames") && said("at most 5"), "%s", ran.err);
    CHECK(TOOL(FIVE, "--part", "6/5", "-o", "t%d.pfm") == 2 && said("--part 6/5"), "%s", ran.err);
}

/* A window shows a part of each frame, with the exposure of frame 1. */
TEST(windows_of_frames) {
    int first;
    if (!has_cjson()) SKIP("built without cJSON");
    CHECK(TOOL(FIVE, "--window", "4,5,20,10", "--frames", "1-2", "-o", "w%d.pfm") == 0, "%s", ran.err);
    CHECK(TOOL(VIEW, "-o", "o.pfm", "--eye", ".5,1.4,3", "--look-at", "0,.5,0", "--fov", "50", "--up", ".1,1,0",
               "--window", "4,5,20,10") == 0 && same_files("o.pfm", "w2.pfm"), "%s", ran.err);
    CHECK(TOOL(FIVE, "--window", "4,5,20,10", "--verbose", "--frames", "1", "-o", "w%d.png") == 0, "%s", ran.err);
    first = exposure();
    CHECK(TOOL(FIVE, "--window", "4,5,20,10", "--verbose", "--frames", "5", "-o", "w%d.png") == 0 &&
          first == exposure() && first > -10000, "%d and %d: %s", first, exposure(), ran.err);
    CHECK(TOOL(FIVE, "--window", "4,5,20,10", "--frames", "1-2", "-o", "v%d.png") == 0 &&
          same_files("w1.png", "v1.png"), "%s", ran.err);
}

/* Frames that are rendered in windows can be continued after the tool was killed; finished frames are not rendered
   again. */
TEST(large_frames_go_on) {
#define LARGE FIVE, "--size", "320x200", "--memory", "24M", "--frames"
    const char *const arguments[] = { LARGE, "1-2", "-o", "l%d.exr", NULL };
    const char *const all[] = { LARGE, "1-2", "-o", "l%d.exr", "--resume", NULL };
    if (!has_cjson()) SKIP("built without cJSON");
    finish(start_until(arguments, "l1.exr.parts/lock"));
    if (said("OpenEXR")) SKIP("built without OpenEXR");
    CHECK(ran.status == 0 && exists("l1.exr") && exists("l2.exr") && !exists("l1.exr.parts"), "%s", ran.err);
    CHECK(TOOL(LARGE, "2", "-o", "m%d.exr") == 0 && same_files("l2.exr", "m2.exr"), "%s", ran.err);
    remove(in_folder("l2.exr"));
    {
        const pid_t child = start_until(arguments, "l2.exr.parts/1.exr");
        kill(child, SIGKILL);
        finish(child);
    }
    if (ran.status != -SIGKILL) SKIP("it was not killed in time");
    CHECK(run(all) == 2 && said("l1.exr exists") && said("--frames"), "%s", ran.err);
    CHECK(TOOL(LARGE, "2", "-o", "l%d.exr") == 1 && said("--resume"), "%s", ran.err);
    CHECK(TOOL(LARGE, "2", "-o", "l%d.exr", "--resume") == 0 && same_files("l2.exr", "m2.exr") &&
          !exists("l2.exr.parts"), "%s", ran.err);
}

/* The statistics are sums over the frames. */
TEST(statistics_are_sums) {
    char text[3][8192];
    double sensors[3], pixels[3];
    int k, lines;
    if (!has_cjson()) SKIP("built without cJSON");
    for (k = 0; k < 3; k++) {
        const char *const words = k == 2 ? "1-2" : k == 1 ? "2" : "1";
        CHECK(TOOL(FIVE, "--frames", words, "-o", "f%d.pfm", "--stats", "s.json") == 0, "%s", ran.err);
        read_text(in_folder("s.json"), text[k], sizeof text[k], &lines);
        REQUIRE(strstr(text[k], "\"sensors\": ") && strstr(text[k], "\"size\": [32, 24]"), "%s", text[k]);
        sensors[k] = atof(strstr(text[k], "\"sensors\": ") + 11);
        pixels[k] = atof(strstr(text[k], "\"visible_pixels\": ") + 18);
    }
    CHECK(sensors[0] > 0 && sensors[0] + sensors[1] == sensors[2] && pixels[0] + pixels[1] == pixels[2],
          "sensors: %g and %g, together %g", sensors[0], sensors[1], sensors[2]);
}

/* ---- errors ---- */

/* Wrong camera files are refused in one line that names the file, the camera and the key. */
TEST(wrong_cameras_are_refused) {
#define EYE "'eye': [0, 1, 3]"
#define GOOD "{" EYE ", 'look_at': [0, 0, 0]}"
#define TURN "'camera_to_world': [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 1, 3, 1]"
    static const struct { const char *text, *words; } wrong[] = {
        { "", "line 1 is not valid JSON" },
        { "{'cameras': [" GOOD ",\n" GOOD "\n", "line 3 is not valid JSON" },
        { "{'cameras': [" GOOD "]} more", "line 1 is not valid JSON" },
        { "[" GOOD "]", "must be an object" },
        { "{}", "must be a list" },
        { "{'cameras': []}", "must be a list" },
        { "{'cameras': " GOOD "}", "must be a list" },
        { "{'camera': [" GOOD "]}", "\"camera\"" },
        { "{'cameras': [" GOOD "], 'fps': 24}", "\"fps\"" },
        { "{'cameras': [" GOOD "], 'cameras': [" GOOD "]}", "\"cameras\"" },
        { "{'cameras': [" GOOD ", 7]}", "camera 2: it must be an object" },
        { "{'cameras': [" GOOD ", {'look_at': [0, 0, 0]}]}", "camera 2: \"eye\" is missing" },
        { "{'cameras': [{" EYE "}]}", "camera 1: \"look_at\" is missing" },
        { "{'cameras': [{" EYE ", 'look_at': [0, 0]}]}", "camera 1: \"look_at\" must be three numbers" },
        { "{'cameras': [{" EYE ", 'look_at': [0, 0, 0, 0]}]}", "camera 1: \"look_at\" must be three numbers" },
        { "{'cameras': [{" EYE ", 'look_at': [0, '0', 0]}]}", "camera 1: \"look_at\" must be three numbers" },
        { "{'cameras': [{" EYE ", 'look_at': [0, null, 0]}]}", "camera 1: \"look_at\" must be three numbers" },
        { "{'cameras': [{" EYE ", 'look_at': 0}]}", "camera 1: \"look_at\" must be three numbers" },
        { "{'cameras': [{" EYE ", 'look_at': [0, 0, 1e19]}]}", "camera 1: \"look_at\" must be three numbers" },
        { "{'cameras': [{" EYE ", 'look_at': [0, 0, 1e999]}]}", "camera 1: \"look_at\" must be three numbers" },
        { "{'cameras': [{" EYE ", 'look_at': [0, 0, NaN]}]}", "line 1 is not valid JSON" },
        { "{'cameras': [{" EYE ", " EYE ", 'look_at': [0, 0, 0]}]}", "camera 1: \"eye\" is given twice" },
        { "{'cameras': [{" EYE ", 'look_at': [0, 0, 0], 'roll': 0}]}", "camera 1: \"roll\" is not a key" },
        { "{'cameras': [{" EYE ", 'look_at': [0, 0, 0], 'fov': 0}]}", "camera 1: \"fov\" must be a number from 1" },
        { "{'cameras': [{" EYE ", 'look_at': [0, 0, 0], 'fov': [40]}]}", "camera 1: \"fov\" must be a number from 1" },
        { "{'cameras': [{" EYE ", " TURN "}]}", "camera 1: \"eye\" cannot be combined" },
        { "{'cameras': [{'up': [0, 1, 0], " TURN "}]}", "camera 1: \"up\" cannot be combined" },
        { "{'cameras': [{'camera_to_world': [1, 2]}]}", "camera 1: \"camera_to_world\" must be 16 numbers" },
        { "{'cameras': [{'camera_to_world': [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, -1, 0, 0, 1, 3, 1]}]}", "not mirrored" },
        { "{'cameras': [{'camera_to_world': [1, 0, 0, 0, 1, 1, 0, 0, 0, 0, 1, 0, 0, 1, 3, 1]}]}", "right angles" },
        { "{'cameras': [{'camera_to_world': [1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1, 0, 0, 1, 3, 1]}]}", "right angles" },
        { "{'cameras': [{'camera_to_world': [1, 0, 0, 0, 0, 1, 0, 1, 0, 0, 1, 0, 0, 1, 3, 1]}]}", "last row" },
        { "{'cameras': [" GOOD ", {" EYE ", 'look_at': [0, 1, 3]}]}", "camera 2: \"look_at\" and \"up\"" },
        { "{'cameras': [" GOOD ", {" EYE ", 'look_at': [0, 0, 0], 'up': [0, 1, 3]}]}", "camera 2: \"look_at\" and" }
    };
    size_t i;
    if (!has_cjson()) SKIP("built without cJSON");
    for (i = 0; i < sizeof wrong / sizeof *wrong; i++) {
        write_json("wrong.json", wrong[i].text);
        CHECK(TOOL(VIEW, "--cameras", "wrong.json", "-o", "q%d.pfm") == 1 && said("--cameras wrong.json: ") &&
              said(wrong[i].words) && ran.err_lines == 1 && !exists("q1.pfm"), "%s: status %d: %s", wrong[i].text,
              ran.status, ran.err);
    }
    CHECK(!parts_left(), "files are left");
}

/* Hostile files are refused: deeply nested, huge, truncated anywhere, with zero bytes, and names that are not regular
   files. */
TEST(hostile_cameras_are_refused) {
    const size_t large = (16 << 20) + 1;
    char *text = (char *)malloc(large), whole[1024];
    size_t i, size;
    int lines;
    REQUIRE(text, "no memory");
    if (!has_cjson()) { free(text); SKIP("built without cJSON"); }
#define HOSTILE(...) (TOOL(VIEW, "--cameras", __VA_ARGS__, "-o", "h%d.pfm") == 1 && ran.err_lines == 1)
    memset(text, '[', large);
    write_file("deep.json", text, 100000);
    CHECK(HOSTILE("deep.json") && said("not valid JSON"), "status %d: %s", ran.status, ran.err);
    memcpy(text, "{\"cameras\":", 11);
    write_file("deep.json", text, 100000);
    CHECK(HOSTILE("deep.json") && said("not valid JSON"), "status %d: %s", ran.status, ran.err);
    write_file("huge.json", text, large);
    CHECK(HOSTILE("huge.json") && said("larger than 16 MB"), "status %d: %s", ran.status, ran.err);
    for (i = 0; i + 3 < large; i += 2) memcpy(text + i, i < 100000 ? "[]" : ",0", 2);
    memset(text, '0', 1 << 20);
    write_file("number.json", text, 1 << 20);
    CHECK(HOSTILE("number.json"), "status %d: %s", ran.status, ran.err);
    free(text);
    read_text(in_folder("five.json"), whole, sizeof whole, &lines);
    size = strlen(whole);
    for (i = 0; i + 2 < size; i += 23) {
        write_file("cut.json", whole, i);
        CHECK(HOSTILE("cut.json") && said("not valid JSON"), "%d bytes: status %d: %s", (int)i, ran.status, ran.err);
    }
    whole[size] = 0;
    write_file("zero.json", whole, size + 1);
    CHECK(HOSTILE("zero.json") && said("not valid JSON"), "status %d: %s", ran.status, ran.err);
    CHECK(mkfifo(in_folder("fifo.json"), 0666) == 0 && HOSTILE("fifo.json") && said("pipe"), "%s", ran.err);
    CHECK(HOSTILE("missing.json") && said("No such file"), "%s", ran.err);
    CHECK(HOSTILE(".") && said("directory"), "%s", ran.err);
}

/* Contradictory options are refused. */
TEST(contradictory_options_are_refused) {
    static const char *const ranges[] = { "0", "0-2", "3-2", "a", "1-", "-1", "1-2x", "1,2", "1-100001",
        "99999999999999999999", "4-6", "" };
    size_t i;
    if (!has_cjson()) SKIP("built without cJSON");
    for (i = 0; i < sizeof ranges / sizeof *ranges; i++)
        CHECK(TOOL(FIVE, "-o", "x%d.pfm", "--frames", ranges[i]) == 2 && said("--frames") && ran.err_lines == 1,
              "--frames %s: %s", ranges[i], ran.err);
#define REFUSED(words, ...) \
    CHECK(TOOL(__VA_ARGS__) == 2 && said(words) && ran.err_lines == 1, "%s: status %d: %s", words, ran.status, ran.err)
    REFUSED("%04d", FIVE, "-o", "x.pfm");
    REFUSED("%04d", FIVE);
    REFUSED("%04d", FIVE, "-o", "x%s.pfm");
    REFUSED("%04d", FIVE, "-o", "x%d%d.pfm");
    REFUSED("--plan", FIVE, "-o", "x%d.exr", "--part", "1/2", "--plan", "p");
    REFUSED("--inspect", FIVE, "-o", "x%d.pfm", "--inspect", "1,1");
    REFUSED("--eye", FIVE, "-o", "x%d.pfm", "--eye", "0,0,0");
    REFUSED("--look-at", FIVE, "-o", "x%d.pfm", "--look-at", "0,0,0");
    REFUSED("--fps", FIVE, "-o", "x%d.pfm", "--fps", "30");
    REFUSED("--fps", VIEW, "-o", "x.pfm", "--fps", "30");
    REFUSED("five.json", FIVE, "-o", "x%d.pfm", "--stats", "five.json");
    REFUSED("x4.pfm", FIVE, "-o", "x%d.pfm", "--stats", "x4.pfm");
    CHECK(TOOL(VIEW, "-o", "x%d.pfm", "--frames", "1-3") == 1 && said("no animated camera") && said("--cameras"), "%s",
          ran.err);
    for (i = 1; i <= 5; i++) {
        char name[16];
        snprintf(name, sizeof name, "x%d.pfm", (int)i);
        CHECK(!exists(name), "%s was made", name);
    }
}

/* A frame that cannot be written is named before the work: no frame is made. */
TEST(a_frame_that_cannot_be_written_is_named_first) {
    if (!has_cjson()) SKIP("built without cJSON");
    mkdir(in_folder("n3.pfm"), 0777);
    CHECK(TOOL(FIVE, "-o", "n%d.pfm") == 1 && said("n3.pfm: cannot be written") && ran.err_lines == 1, "%s", ran.err);
    CHECK(!exists("n1.pfm") && !exists("n2.pfm") && !exists("n4.pfm") && !parts_left(), "other files than expected");
}

/* After a signal, the finished frames remain, and the message says how to render the rest. */
TEST(interrupted_sequences_go_on) {
    enum { FRAMES = 300 };
    const char *const arguments[] = { VIEW, "--cameras", "many.json", "-o", "i%d.pfm", NULL };
    static char text[FRAMES * 100];
    char name[16], rest[32];
    const char *words;
    int i, finished = 0, all = 0, from = 0, to = 0, made = 0;
    pid_t child;
    if (!has_cjson()) SKIP("built without cJSON");
    strcpy(text, "{'cameras': [");
    for (i = 0; i < FRAMES; i++)
        snprintf(text + strlen(text), 100, "%s{'eye': [%g, 1, 3], 'look_at': [0, 0, 0]}", i ? ",\n" : "", 0.001 * i);
    strcat(text, "]}");
    write_json("many.json", text);
    in_child = hear_signals;
    child = start_until(arguments, "i3.pfm");
    in_child = NULL;
    kill(child, SIGINT);
    finish(child);
    words = strstr(ran.err, "interrupted; ");
    REQUIRE(ran.status == 130 && ran.err_lines == 1 && words &&
            sscanf(words, "interrupted; %d of %d frames are finished; --frames %d-%d makes the rest", &finished, &all,
                   &from, &to) == 4, "status %d: %s", ran.status, ran.err);
    for (i = 1; i <= FRAMES; i++) {
        snprintf(name, sizeof name, "i%d.pfm", i);
        made += exists(name);
        CHECK(exists(name) == (i < from), "the rest begins with %d, but %s is %s", from, name,
              exists(name) ? "there" : "missing");
    }
    CHECK(finished == made && all == FRAMES && from == finished + 1 && to == FRAMES && !parts_left(),
          "%d of %d files, from %d to %d", made, all, from, to);
    snprintf(rest, sizeof rest, "%d-%d", from, from + 1);
    CHECK(TOOL(VIEW, "--cameras", "many.json", "-o", "i%d.pfm", "--frames", rest) == 0, "%s", ran.err);
    snprintf(name, sizeof name, "i%d.pfm", from);
    CHECK(exists(name), "%s is missing", name);
}

/* ---- animated cameras ---- */

static float last_key = 1;  /* in seconds */
static const char *later = "";  /* further animations, which the camera does not follow */
static const char *scaled = "";  /* scale of the node */

/* Writes scene.gltf and scene.bin: an emitting floor, and a camera below a node. An animation changes the `path` of the
   node from one value at 0 s to another at last_key. count: numbers per value, times 3 for CUBICSPLINE */
static void animated(const char *path, const char *interpolation, int count, const float from[], const float to[]) {
    static const float floor_corners[12] = { -4, 0, -4, -4, 0, 4, 4, 0, 4, 4, 0, -4 };
    static const uint32_t indices[6] = { 0, 1, 2, 0, 2, 3 };
    const float times[2] = { 0, last_key };
    unsigned char bytes[512];
    char text[4096];
    const int value = 4 * count;
    memcpy(bytes, floor_corners, 48);
    memcpy(bytes + 48, indices, 24);
    memcpy(bytes + 72, times, 8);
    memcpy(bytes + 80, from, (size_t)value);
    memcpy(bytes + 80 + value, to, (size_t)value);
    write_file("scene.bin", bytes, (size_t)(80 + 2 * value));
    snprintf(text, sizeof text,
        "{'asset': {'version': '2.0'}, 'scene': 0, 'scenes': [{'nodes': [0, 1]}], 'nodes': [{'mesh': 0, 'name': 'same'"
        "}, {'name': 'same', 'children': [2]%s}, {'name': 'same', 'camera': 0, 'translation': [0, 1, 3]}],"
        "'cameras': [{'type': 'perspective', 'perspective': {'yfov': 0.7, 'znear': 0.1}}],"
        "'meshes': [{'primitives': [{'attributes': {'POSITION': 0}, 'indices': 1, 'material': 0}]}],"
        "'materials': [{'emissiveFactor': [1, 1, 1]}], 'accessors': ["
        "{'bufferView': 0, 'componentType': 5126, 'count': 4, 'type': 'VEC3', 'min': [-4, 0, -4], 'max': [4, 0, 4]},"
        "{'bufferView': 1, 'componentType': 5125, 'count': 6, 'type': 'SCALAR'},"
        "{'bufferView': 2, 'componentType': 5126, 'count': 2, 'type': 'SCALAR', 'min': [0], 'max': [%.9g]},"
        "{'bufferView': 3, 'componentType': 5126, 'count': %d, 'type': 'VEC%d'}],"
        "'bufferViews': [{'buffer': 0, 'byteLength': 48}, {'buffer': 0, 'byteOffset': 48, 'byteLength': 24},"
        "{'buffer': 0, 'byteOffset': 72, 'byteLength': 8}, {'buffer': 0, 'byteOffset': 80, 'byteLength': %d}],"
        "'buffers': [{'byteLength': %d, 'uri': 'scene.bin'}], 'animations': [{'channels': [{'sampler': 0, 'target':"
        "{'node': 1, 'path': '%s'}}], 'samplers': [{'input': 2, 'output': 3, 'interpolation': '%s'}]}%s]}",
        scaled, (double)last_key, count > 4 ? 6 : 2, count > 4 ? count / 3 : count, 2 * value, 80 + 2 * value, path,
        interpolation, later);
    write_json("scene.gltf", text);
}

#define MOVING "scene.gltf", LOOK, "--channel", "position"

/* Returns the greatest difference of the positions in two pictures; negative if they cannot be read. */
static double difference(const char *a, const char *b) {
    picture p = read_pfm(a), q = read_pfm(b);
    double most = 0;
    int i;
    if (!p.values || !q.values || p.width != q.width || p.height != q.height) most = -1;
    for (i = 0; most >= 0 && i < 3 * p.width * p.height; i++)
        most = fmax(most, fabs((double)p.values[i] - (double)q.values[i]));
    free(p.values);
    free(q.values);
    return most;
}

/* Frame n shows the view of the camera at (n - 1) / fps seconds: between the keys, at them, and after the last. */
TEST(an_animated_camera_moves) {
    static const float zero[3] = { 0, 0, 0 }, right[3] = { 2, 0, 0 };
    static const struct { const char *file, *eye, *at; } moments[] = {
        { "1", "0,1,3", "0,1,0" }, { "7", ".5,1,3", ".5,1,0" }, { "25", "2,1,3", "2,1,0" }, { "60", "2,1,3", "2,1,0" }
    };
    char name[16];
    size_t i;
    if (!has_cjson()) SKIP("built without cJSON");
    animated("translation", "LINEAR", 3, zero, right);
    CHECK(TOOL(MOVING, "--frames", "1-60", "-o", "m%d.pfm", "--verbose") == 0 && !said("warning"), "%s", ran.err);
    for (i = 0; i < sizeof moments / sizeof *moments; i++) {
        snprintf(name, sizeof name, "m%s.pfm", moments[i].file);
        CHECK(TOOL(MOVING, "--eye", moments[i].eye, "--look-at", moments[i].at, "-o", "o.pfm") == 0 &&
              fabs(difference("o.pfm", name)) < 1e-4, "frame %s is off by %g: %s", moments[i].file,
              difference("o.pfm", name), ran.err);
    }
    CHECK(TOOL(MOVING, "--frames", "4", "--fps", "12", "-o", "n%d.pfm") == 0 && same_files("m7.pfm", "n4.pfm"), "%s",
          ran.err);
    CHECK(TOOL(MOVING, "--frames", "1-7", "--part", "7/7", "-o", "n%d.pfm") == 0 && same_files("m7.pfm", "n7.pfm"),
          "%s", ran.err);
    CHECK(difference("m1.pfm", "m7.pfm") > 0.1, "the camera does not move");
    later = ", {'channels': [{'sampler': 0, 'target': {'node': 1, 'path': 'translation'}}], 'samplers': [{'input': 2, "
            "'output': 3, 'interpolation': 'STEP'}]}";
    animated("translation", "LINEAR", 3, zero, right);
    later = "";
    CHECK(TOOL(MOVING, "--frames", "7", "-o", "n%d.pfm") == 0 && same_files("m7.pfm", "n7.pfm"),
          "the second animation counts: %s", ran.err);
    write_json("eye.json", "{'cameras': [{'eye': [0, 2, 4], 'look_at': [0, 0, 0]}]}");
    CHECK(TOOL(MOVING, "--cameras", "eye.json", "-o", "e%d.pfm") == 0 &&
          TOOL(MOVING, "--eye", "0,2,4", "--look-at", "0,0,0", "-o", "o.pfm") == 0 && same_files("e1.pfm", "o.pfm"),
          "a camera without a field of view has not that of the file: %s", ran.err);
    animated("translation", "STEP", 3, zero, right);
    CHECK(TOOL(MOVING, "--frames", "1-25", "-o", "s%d.pfm") == 0 && same_files("m1.pfm", "s24.pfm") &&
          same_files("m25.pfm", "s25.pfm"), "steps: %s", ran.err);
    last_key = 1 / 24.0f;  /* rounding moves the key to a later time */
    animated("translation", "STEP", 3, zero, right);
    CHECK(TOOL(MOVING, "--frames", "2", "-o", "s%d.pfm") == 0 && same_files("m25.pfm", "s2.pfm"),
          "a step comes late: %s", ran.err);
    last_key = 1;
}

/* The camera is a child of a rotating node. Between two keys, the node takes the shorter of the two possible rotations,
   at a constant rate. The scale of a node is applied before its rotation. */
TEST(an_animated_camera_turns) {
    static const float zero[4] = { 0, 0, 0, 1 }, turned[4] = { 0, -0.70710678f, 0, -0.70710678f };  /* 90 degrees */
    static const float tilted[4] = { 0, 0, 0.25881905f, 0.96592583f };  /* 30 degrees */
    if (!has_cjson()) SKIP("built without cJSON");
    animated("rotation", "LINEAR", 4, zero, turned);
    CHECK(TOOL(MOVING, "--frames", "9-25", "-o", "m%d.pfm") == 0, "status %d: %s", ran.status, ran.err);
    CHECK(TOOL(MOVING, "--eye", "1.5,1,2.5980762", "--look-at", "0,1,0", "-o", "o.pfm") == 0 &&
          fabs(difference("o.pfm", "m9.pfm")) < 1e-3, "30 degrees are off by %g", difference("o.pfm", "m9.pfm"));
    CHECK(TOOL(MOVING, "--eye", "3,1,0", "--look-at", "0,1,0", "-o", "o.pfm") == 0 &&
          fabs(difference("o.pfm", "m25.pfm")) < 1e-3, "90 degrees are off by %g", difference("o.pfm", "m25.pfm"));
    CHECK(TOOL(MOVING, "--look-at", "0,0,0", "--frames", "25", "-o", "n%d.pfm") == 0 &&
          TOOL(MOVING, "--eye", "3,1,0", "--look-at", "0,0,0", "-o", "o.pfm") == 0 &&
          fabs(difference("o.pfm", "n25.pfm")) < 1e-3, "--look-at is off by %g: %s", difference("o.pfm", "n25.pfm"),
          ran.err);
    scaled = ", 'scale': [3, 2, 0.5]";
    animated("rotation", "LINEAR", 4, zero, tilted);
    scaled = "";
    CHECK(TOOL(MOVING, "--frames", "25", "-o", "n%d.pfm") == 0 &&
          TOOL(MOVING, "--eye", "-1,1.7320508,1.5", "--look-at", "-1,1.7320508,0", "--up", "-0.5,0.8660254,0", "-o",
               "o.pfm") == 0 && fabs(difference("o.pfm", "n25.pfm")) < 1e-3, "a node with a scale is off by %g: %s",
          difference("o.pfm", "n25.pfm"), ran.err);
}

/* Unsupported animations are refused. */
TEST(unsupported_animations_are_refused) {
    static const float spline[9] = { 0 };
    static const float zero[3] = { 0, 0, 0 }, nowhere[3] = { NAN, INFINITY, 1e30f };
    if (!has_cjson()) SKIP("built without cJSON");
    animated("translation", "CUBICSPLINE", 9, spline, spline);
    CHECK(TOOL(MOVING, "--frames", "1-2", "-o", "c%d.pfm") == 1 && said("CUBICSPLINE") && said("--cameras") &&
          ran.err_lines == 1, "%s", ran.err);
    animated("translation", "LINEAR", 3, zero, nowhere);
    CHECK(TOOL(MOVING, "--frames", "1-2", "-o", "c%d.pfm") == 1 && said("frame 2") && ran.err_lines == 1 &&
          !exists("c1.pfm"), "%s", ran.err);
    animated("colour", "LINEAR", 3, zero, zero);
    CHECK(TOOL(MOVING, "--frames", "1-2", "-o", "c%d.pfm") == 1 && said("no animated camera") && ran.err_lines == 1,
          "%s", ran.err);
    animated("translation", "LINEAR", 3, zero, zero);
    CHECK(TOOL(MOVING, "--frames", "100001", "-o", "c%d.pfm") == 2, "%s", ran.err);
    CHECK(TOOL(MOVING, "--frames", "100000", "-o", "c%d.pfm") == 0 && exists("c100000.pfm"), "%s", ran.err);
}

int main(int argc, char **argv) {
    (void)argc;
    if (!tool_begin(argv[0])) return 1;
    RUN(cameras_are_those_of_the_options);
    RUN(frames_do_not_depend_on_each_other);
    RUN_PLAIN(exposure_does_not_flicker);
    RUN(parts_share_the_frames);
    RUN_PLAIN(windows_of_frames);
    RUN_PLAIN(large_frames_go_on);
    RUN_PLAIN(statistics_are_sums);
    RUN(wrong_cameras_are_refused);
    RUN(hostile_cameras_are_refused);
    RUN(contradictory_options_are_refused);
    RUN(a_frame_that_cannot_be_written_is_named_first);
    RUN(interrupted_sequences_go_on);
    RUN(an_animated_camera_moves);
    RUN_PLAIN(an_animated_camera_turns);
    RUN(unsupported_animations_are_refused);
    tool_end();
    return test_report();
}
