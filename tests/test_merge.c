/* Tests of pictures in parts: sbl_render --part and --plan, and sbl_merge. Further tests make large pictures window by
   window, and continue runs that were killed. */
#define _XOPEN_SOURCE 700
#define _DEFAULT_SOURCE
#include "support/test.h"
#include "support/tool.h"
#include <math.h>
#include <time.h>

/* VIEW is a room in direct light. PICTURE has 48 x 32 pixels. LARGE has 900 x 600 pixels, and so little memory that it
   is made window by window. */
#define VIEW "room.obj", "--eye", "0,1.4,3", "--look-at", "0,.5,0", SMALL, "--mode", "direct", "--quiet"
#define PICTURE VIEW, "--size", "48x32"
#define LARGE VIEW, "--size", "450x300", "--preset", "draft", "--memory", "24M"

/* Runs sbl_merge with these arguments. */
#define MERGE(...) (tool_use("sbl_merge"), run((const char *const[]){ __VA_ARGS__, NULL }))
#define RENDER(...) (tool_use("sbl_render"), run((const char *const[]){ __VA_ARGS__, NULL }))

static int has_openexr(void) {
    room_obj();
    return !(RENDER(VIEW, "--size", "4x4", "-o", "probe.exr") == 1 && said("OpenEXR"));
}

/* Makes parts 1 to `count` of the picture as NAME.1.exr, NAME.2.exr and so on. more: an option and its value, or NULL.
   Returns 1 if all parts were made. */
static int make_parts(const char *name, int count, const char *more, const char *value) {
    const char *const arguments[] = { PICTURE, more, value, NULL };
    char pattern[64];
    snprintf(pattern, sizeof pattern, "%s.%%d.exr", name);
    tool_use("sbl_render");
    return run_parts(arguments, pattern, count);
}

/* ---- parts and their joining ---- */

/* Joined parts equal the picture that is made at once, pixel by pixel, in every format. A folder of parts can be given
   in place of their names. */
TEST(parts_make_the_whole) {
    picture positions;
    if (!has_openexr()) SKIP("built without OpenEXR");
    CHECK(RENDER(PICTURE, "--channel", "position", "-o", "whole.pfm") == 0, "%s", ran.err);
    REQUIRE(make_parts("at", 5, "--channel", "position"), "%s", ran.err);
    CHECK(MERGE("at.1.exr", "at.2.exr", "at.3.exr", "at.4.exr", "at.5.exr", "-o", "all.pfm") == 0 && !ran.err[0], "%s",
          ran.err);
    CHECK(fabs(mean_difference("whole.pfm", "all.pfm")) < 1e-5, "positions differ by %g",
          mean_difference("whole.pfm", "all.pfm"));
    positions = read_pfm("all.pfm");
    CHECK(positions.values && positions.values[3 * (48 * 31 + 24) + 2] > 0, "the lowest row is not the nearest");
    free(positions.values);
    CHECK(RENDER(PICTURE, "-o", "whole.pfm") == 0, "%s", ran.err);
    mkdir(in_folder("parts"), 0777);
    REQUIRE(make_parts("parts/light", 3, NULL, NULL), "%s", ran.err);
    CHECK(MERGE("parts", "-o", "all.pfm") == 0, "%s", ran.err);
    CHECK(fabs(mean_difference("whole.pfm", "all.pfm")) < 0.04, "light differs by %g",
          mean_difference("whole.pfm", "all.pfm"));
}

/* Returns the mean difference of two .png files of 48 x 32 pixels; 1000 if one cannot be read or is black. */
static double png_off(const char *one, const char *other) {
    stbi_uc *pixels[2];
    int w, h, n, i, k, off = 0, ok = 1, sum[2] = { 0, 0 };
    for (k = 0; k < 2; k++) {
        pixels[k] = stbi_load(in_folder(k ? other : one), &w, &h, &n, 3);
        ok = ok && pixels[k] && w == 48 && h == 32;
    }
    for (i = 0; i < 3 * 48 * 32 && ok; i++) {
        off += abs(pixels[0][i] - pixels[1][i]);
        for (k = 0; k < 2; k++) sum[k] += pixels[k][i];
    }
    for (k = 0; k < 2; k++) stbi_image_free(pixels[k]);
    return sum[0] && sum[1] ? off / (3.0 * 48 * 32) : 1000;
}

/* A .png that is joined from parts with the display channel looks like a .png that is made at once. The same is true of
   the error channels, which a .png shows brighter. */
TEST(parts_make_a_png) {
    static const char *const errors[] = { "--channel=error", "--channel=radiance_error" };
    int i;
    if (!has_openexr()) SKIP("built without OpenEXR");
    CHECK(RENDER(PICTURE, "-o", "whole.png", "--exposure", "1") == 0, "%s", ran.err);
    REQUIRE(make_parts("shown", 2, "--channel=display", "--exposure=1"), "%s", ran.err);
    CHECK(MERGE("shown.1.exr", "shown.2.exr", "-o", "all.png") == 0 && !ran.err[0], "%s", ran.err);
    CHECK(MERGE("shown.1.exr", "shown.2.exr", "-o", "all.exr", "--exposure", "1") == 2 && said("contains the exposure"),
          "the exposure is applied twice: %s", ran.err);
    CHECK(png_off("whole.png", "all.png") < 4, "the mean difference is %g of 255", png_off("whole.png", "all.png"));
    for (i = 0; i < 2; i++) {
        CHECK(RENDER(PICTURE, errors[i], "-o", "error.png") == 0, "%s", ran.err);
        REQUIRE(make_parts("errors", 2, errors[i], NULL), "%s", ran.err);
        CHECK(MERGE("errors.1.exr", "errors.2.exr", "-o", "all.png") == 0 && png_off("error.png", "all.png") < 16,
              "%s: the mean difference is %g of 255: %s", errors[i], png_off("error.png", "all.png"), ran.err);
    }
    REQUIRE(make_parts("light", 2, "--exposure=1", NULL), "%s", ran.err);
    CHECK(MERGE("light.1.exr", "light.2.exr", "-o", "all.png") == 0 && said("--channel display"), "%s", ran.err);
    CHECK(MERGE("light.1.exr", "light.2.exr", "-o", "all.exr", "--exposure", "1") == 0 &&
          said("no effect: --exposure"), "%s", ran.err);
}

/* A part has the same bits after other work, with the plan of another run, and if a scheduler gives the number of the
   part in an environment variable. Grid Engine sets its variable to "undefined" in jobs that are no array. */
TEST(parts_do_not_depend_on_each_other) {
    static const struct { const char *name, *value; } variables[] = { { "SLURM_ARRAY_TASK_ID", "2" },
        { "SGE_TASK_ID", "2" }, { "PBS_ARRAY_INDEX", "2" }, { "JOB_COMPLETION_INDEX", "1" },
        { "AWS_BATCH_JOB_ARRAY_INDEX", "1" } };
    int i;
    if (!has_openexr()) SKIP("built without OpenEXR");
    CHECK(RENDER(PICTURE, "--part", "2/3", "-o", "a.exr", "--plan", "plan") == 0 && exists("plan"), "%s", ran.err);
    CHECK(RENDER(PICTURE, "--part=2/3", "-o", "b.exr", "--plan", "plan") == 0 && same_files("a.exr", "b.exr"),
          "with the plan of a file: %s", ran.err);
    CHECK(RENDER(PICTURE, "--part", "2/3", "-o", "b%04d.exr") == 0 && same_files("a.exr", "b0002.exr"),
          "with a plan of its own: %s", ran.err);
    for (i = 0; i < 5; i++) {
        if (i > 1) setenv("SGE_TASK_ID", "undefined", 1);
        setenv(variables[i].name, variables[i].value, 1);
        CHECK(RENDER(PICTURE, "--part", "auto/3", "-o", "c%d.exr") == 0 && same_files("a.exr", "c2.exr"), "%s: %s",
              variables[i].name, ran.err);
        unsetenv(variables[i].name);
        remove(in_folder("c2.exr"));
    }
    unsetenv("SGE_TASK_ID");
    CHECK(RENDER(PICTURE, "--part", "auto/3", "-o", "c.exr") == 2 && said("SLURM_ARRAY_TASK_ID"), "%s", ran.err);
}

/* The first plan is kept and used. A run that does not fit it, because the number of parts or an option differs, is
   refused; so is a file that is no plan or a damaged plan. The message names a difference that a user can see. */
TEST(the_first_plan_counts) {
    static const char *const outside[2] = { "window 0 0 48 16\nwindow 0 17 48 16\nend 2\n",
                                            "window 0 0 24 32\nwindow 25 0 24 32\nend 2\n" };
    char before[4096], after[4096];
    int lines, i;
    if (!has_openexr()) SKIP("built without OpenEXR");
    CHECK(RENDER(PICTURE, "--part", "1/2", "-o", "a.exr", "--plan", "first") == 0, "%s", ran.err);
    read_text(in_folder("first"), before, sizeof before, &lines);
    CHECK(strstr(before, "\nend 2\n") && strstr(before, "\nwindow 0 0 "), "the plan is %s", before);
    CHECK(RENDER(PICTURE, "--part", "1/3", "-o", "a.exr", "--plan", "first") == 1 && said("2 parts"), "%s", ran.err);
    CHECK(RENDER(PICTURE, "--part", "1/2", "-o", "a.exr", "--plan", "first", "--preset", "high") == 1 &&
          said("other options") && said("--preset=high"), "%s", ran.err);
    CHECK(RENDER(VIEW, "--size", "48x33", "--part", "1/2", "-o", "a.exr", "--plan", "first") == 1 &&
          said("for another size: it has 48x32, this run has 48x33"), "%s", ran.err);
    CHECK(RENDER(PICTURE, "--part", "1/2", "-o", "a.exr", "--plan", "first", "--sky", "2,2,2") == 1 &&
          said("other options") && said("--sky=2,2,2"), "%s", ran.err);
    CHECK(RENDER(PICTURE, "--part", "1/2", "-o", "a.exr", "--plan", "first", "--eye", "0,1.4,4") == 1 &&
          said("was made with another camera; remove it"), "%s", ran.err);
    read_text(in_folder("first"), after, sizeof after, &lines);
    CHECK(strcmp(before, after) == 0, "the plan was changed");
    write_text("no_plan", "something\n");
    CHECK(RENDER(PICTURE, "--part", "1/2", "-o", "a.exr", "--plan", "no_plan") == 1 && said("not a plan"), "%s",
          ran.err);
    strstr(after, "\nend 2")[1] = 0;
    write_text("short", after);
    CHECK(RENDER(PICTURE, "--part", "1/2", "-o", "a.exr", "--plan", "short") == 1 && said("damaged"), "%s", ran.err);
    for (i = 0; i < 2; i++) {  /* the picture has 48 x 32 pixels */
        strcpy(strstr(after, "\nwindow ") + 1, outside[i]);
        write_text("outside", after);
        CHECK(RENDER(PICTURE, "--part", "1/2", "-o", "a.exr", "--plan", "outside") == 1 && said("damaged"),
              "%s: status %d: %s", outside[i], ran.status, ran.err);
    }
}

/* A plan tells the parts how many cells the store of the complete picture has. Parts whose numbers differ are not
   joined. */
TEST(parts_share_the_number_of_cells) {
#define BOUNCED(...) RENDER(PICTURE, "--mode", "gi", "--preset", "draft", "--max-bounce-cells", "1200", __VA_ARGS__)
    char text[8192];
    int lines;
    if (!has_openexr()) SKIP("built without OpenEXR");
    CHECK(BOUNCED("--part", "1/2", "-o", "p.1.exr", "--plan", "cells") == 0, "%s", ran.err);
    CHECK(BOUNCED("--part", "2/2", "-o", "p.2.exr", "--plan", "cells") == 0, "%s", ran.err);
    CHECK(MERGE("p.1.exr", "p.2.exr", "-o", "all.pfm") == 0, "%s", ran.err);
    REQUIRE(replace_in("cells", "\nsbl.cells 1200\n", "\nsbl.cells 1100\n"), "the plan has no number of cells");
    CHECK(BOUNCED("--part", "2/2", "-o", "p.2.exr", "--plan", "cells", "--stats", "stats.json") == 0, "%s", ran.err);
    read_text(in_folder("stats.json"), text, sizeof text, &lines);
    CHECK(strstr(text, "\"max_bounce_cells\": 1100,"), "statistics: %s", text);
    CHECK(MERGE("p.1.exr", "p.2.exr", "-o", "all.pfm") == 1 && said("another plan"), "%s", ran.err);
#undef BOUNCED
}

/* A plan that cannot be written, and more parts than pixels, are reported before the scene is read. */
TEST(impossible_plans_are_reported_before_the_work) {
    if (!has_openexr()) SKIP("built without OpenEXR");
    CHECK(RENDER("absent.obj", "--part", "1/2", "-o", "a.exr", "--plan", "absent/plan") == 1 &&
          said("--plan absent/plan: cannot be written"), "%s", ran.err);
    CHECK(RENDER("absent.obj", "--size", "3x2", "--part", "1/7", "-o", "a.exr") == 2 && said("7 parts are too many"),
          "%s", ran.err);
    tool_use("sbl_bake");
    CHECK(TOOL("absent.obj", "--lightmap", "2", "--part", "1/2", "-o", "a.exr", "--plan", "absent/plan") == 1 &&
          said("--plan absent/plan: cannot be written"), "%s", ran.err);
    CHECK(TOOL("absent.obj", "--lightmap", "2", "--part", "1/5", "-o", "a.exr") == 2 && said("5 parts are too many"),
          "%s", ran.err);
}

/* Returns the price that a plan contains. */
static double price_in(const char *plan) {
    char text[4096];
    const char *found;
    int lines;
    read_text(in_folder(plan), text, sizeof text, &lines);
    found = strstr(text, "\nsbl.price ");
    return found ? strtod(found + 11, NULL) : NAN;
}

/* The price of the complete picture equals that of the preview picture, multiplied by the ratio of the numbers of
   pixels to the power of 0.4 (see ON PARTS in sbl.h). Both pictures of this test have the same preview of 192 x 128
   pixels. */
TEST(prices_grow_with_the_pixels) {
    double prices[2];
    if (!has_openexr()) SKIP("built without OpenEXR");
    CHECK(RENDER(VIEW, "--size", "192x128", "--part", "1/24", "-o", "a.exr", "--plan", "one") == 0, "%s", ran.err);
    CHECK(RENDER(VIEW, "--size", "384x256", "--part", "1/96", "-o", "a.exr", "--plan", "two") == 0, "%s", ran.err);
    prices[0] = price_in("one");
    prices[1] = price_in("two");
    CHECK(fabs(prices[1] / prices[0] / pow(4, 0.4) - 1) < 1e-5, "prices %g and %g", prices[0], prices[1]);
}

/* The windows of a plan take about the same time, and not only the same number of rays: a floor under an even sky looks
   the same everywhere, but rays from its left half pass thousands of small leaves. The left part is then smaller. */
TEST(plans_know_what_rays_take) {
    enum { LEAVES = 3000 };
    const size_t room = (size_t)LEAVES * 128 + 256;
    char *text = (char *)malloc(room), plan[4096];
    const char *first;
    int i, k, lines, width = 0;
    size_t used;
    uint32_t seed = 7;
    if (!has_openexr()) SKIP("built without OpenEXR");
    REQUIRE(text, "out of memory");
    used = (size_t)snprintf(text, room, "v -9 0 -9\nv -9 0 9\nv 9 0 9\nv 9 0 -9\nf 1 2 3 4\n");
    for (i = 0; i < LEAVES; i++) {
        double at[3];
        for (k = 0; k < 3; k++) at[k] = (double)((seed = seed * 1664525u + 1013904223u) >> 8) / 16777216;
        at[0] = 3 * at[0] - 3, at[1] = 1.1 + at[1], at[2] = 3 * at[2] - 1.5;
        used += (size_t)snprintf(text + used, room - used, "v %.4f %.4f %.4f\nv %.4f %.4f %.4f\nv %.4f %.4f %.4f\n"
                         "f -1 -2 -3\n", at[0], at[1], at[2], at[0] + 0.004, at[1], at[2], at[0], at[1], at[2] + 0.004);
    }
    write_text("leaves.obj", text);
    free(text);
    CHECK(RENDER("leaves.obj", "--sky", "1,1,1", "--eye", "0,1,0", "--look-at", "0,0,0", "--up", "0,0,-1", "--fov",
                 "35", SMALL, "--quiet", "--mode", "direct", "--size", "192x64", "--part", "1/2", "-o", "a.exr",
                 "--plan", "leaves") == 0, "%s", ran.err);
    read_text(in_folder("leaves"), plan, sizeof plan, &lines);
    first = strstr(plan, "\nwindow 0 0 ");
    CHECK(first && sscanf(first, " window 0 0 %d", &width) == 1 && width >= 16 && width <= 80,
          "the left part is %d of 192 pixels wide", width);
}

/* Copies a part to the file `to`, and changes the width of the complete picture in it to about 2^30 pixels. */
static void widen(const char *from, const char *to) {
    static const char name[] = "displayWindow\0box2i";
    static char bytes[1 << 18];
    FILE *in = fopen(in_folder(from), "rb");
    const size_t size = in ? fread(bytes, 1, sizeof bytes, in) : 0;
    size_t i;
    if (in) fclose(in);
    for (i = 0; i + sizeof name + 20 < size; i++)  /* the name, its size, and x and y of the first pixel come first */
        if (memcmp(bytes + i, name, sizeof name) == 0) bytes[i + sizeof name + 4 + 8 + 3] = 0x3f;
    write_file(to, bytes, size);
}

/* Plans count the margin of a window in its cost. On an evenly lit floor, six windows of 96 x 16 pixels are least
   expensive as three columns in two rows. Without margins, two columns would stay whole, and with wide ones all. */
TEST(plans_know_what_margins_take) {
    char text[4096];
    const char *at;
    int lines, count = 0, w[4];
    if (!has_openexr()) SKIP("built without OpenEXR");
    write_text("floor.obj", "v -90 0 -90\nv 90 0 -90\nv 90 0 90\nv -90 0 90\nf 4 3 2 1\n");
    CHECK(RENDER("floor.obj", "--eye", "0,5,0.1", "--look-at", "0,0,0", SMALL, "--mode", "direct", "--quiet", "--sky",
                 "1,1,1", "--size", "96x16", "--part", "1/6", "-o", "a.exr", "--plan", "floor") == 0, "%s", ran.err);
    read_text(in_folder("floor"), text, sizeof text, &lines);
    for (at = strstr(text, "\nwindow "); at; at = strstr(at + 1, "\nwindow "), count++)
        CHECK(sscanf(at, "\nwindow %d %d %d %d", &w[0], &w[1], &w[2], &w[3]) == 4 && w[2] == 32 && w[3] == 8,
              "window %d has %d x %d pixels", count + 1, w[2], w[3]);
    CHECK(count == 6, "%d windows", count);
}

/* sbl_merge refuses missing, duplicate, damaged or foreign parts with one error that names the part or file, and leaves
   an existing output file unchanged. */
TEST(wrong_parts_are_refused) {
    if (!has_openexr()) SKIP("built without OpenEXR");
    REQUIRE(make_parts("p", 3, NULL, NULL) && make_parts("other", 2, NULL, NULL) &&
            make_parts("high", 3, "--preset", "high") && make_parts("seed", 3, "--seed", "7"), "%s", ran.err);
    write_text("all.exr", "old");
#define REFUSED(words, ...) do { \
        CHECK(MERGE(__VA_ARGS__, "-o", "all.exr") == 1 && said(words) && ran.err_lines == 1, "%s: %s", words, \
              ran.err); \
    } while (0)
    REFUSED("part 2 of 3 is missing", "p.1.exr", "p.3.exr");
    REFUSED("2 of 3 parts are missing; the first is part 1", "p.2.exr");
    REFUSED("are both part 3 of 3", "p.1.exr", "p.2.exr", "p.3.exr", "p.3.exr");
    REFUSED("other.2.exr does not fit p.1.exr: it is a part of 2, not of 3", "p.1.exr", "other.2.exr");
    REFUSED("high.2.exr does not fit p.1.exr: it was made with other options: it has --mode=direct --preset=high",
            "p.1.exr", "high.2.exr", "p.3.exr");
    REFUSED("seed.3.exr does not fit p.1.exr: it was made with other options: it has --mode=direct --seed=7", "p.1.exr",
            "p.2.exr", "seed.3.exr");
    REFUSED("no such.exr", "p.1.exr", "p.2.exr", "no such.exr");
    write_text("words.exr", "no picture");
    REFUSED("words.exr: not a complete .exr file", "p.1.exr", "words.exr", "p.3.exr");
    CHECK(RENDER(PICTURE, "-o", "whole.exr") == 0, "%s", ran.err);
    REFUSED("whole.exr: not a part", "whole.exr");
    damage("p.2.exr", "short.exr", 1, -1);
    REFUSED("short.exr: ", "p.1.exr", "short.exr", "p.3.exr");
    damage("p.2.exr", "turned.exr", 0, 1500);
    REFUSED("turned.exr: ", "p.1.exr", "turned.exr", "p.3.exr");
    widen("p.1.exr", "wide.exr");
    REFUSED("wide.exr: it is damaged: it is a part of a picture of ", "wide.exr");
    mkdir(in_folder("bare"), 0777);
    REFUSED("bare: this folder has no files whose names end in .exr", "bare");
    write_text("room.mtl", "newmtl floor\nKd .7 .5 .2\nnewmtl lamp\nKd 0 0 0\nKe 5 6 7\n");
    CHECK(RENDER(PICTURE, "--part", "2/3", "-o", "scene.exr") == 0, "%s", ran.err);
    REFUSED("scene.exr does not fit p.1.exr: it was made from another scene", "p.1.exr", "scene.exr", "p.3.exr");
    CHECK(!said("it has"), "the message shows a hash: %s", ran.err);
    room_obj();
    CHECK(RENDER(PICTURE, "--sky", "1,1,2", "--part", "2/3", "-o", "sky.exr") == 0, "%s", ran.err);
    REFUSED("sky.exr does not fit p.1.exr: it was made with other options: it has --sky=1,1,2 --mode=direct", "p.1.exr",
            "sky.exr", "p.3.exr");
    CHECK(RENDER(PICTURE, "--fov", "41", "--part", "2/3", "-o", "camera.exr") == 0, "%s", ran.err);
    REFUSED("camera.exr does not fit p.1.exr: it was made with another camera", "p.1.exr", "camera.exr", "p.3.exr");
    CHECK(MERGE("p.1.exr", "p.2.exr", "p.3.exr", "-o", "p.2.exr") == 2 && said("overwrite"), "%s", ran.err);
    CHECK(MERGE("p.1.exr", "-o", "all.jpg") == 2, "%s", ran.err);
    CHECK(MERGE("p.1.exr") == 2, "%s", ran.err);
    read_text(in_folder("all.exr"), ran.out, sizeof ran.out, &ran.out_lines);
    CHECK(strcmp(ran.out, "old") == 0, "a refused merge has changed the file");
    CHECK(MERGE("p.1.exr", "p.2.exr", "p.3.exr", "-o", "all.exr") == 0 && !parts_left(), "%s", ran.err);
}

/* Windows that the user chose are joined if they cover the picture and each pixel is in one window. */
TEST(windows_are_joined) {
    if (!has_openexr()) SKIP("built without OpenEXR");
    CHECK(RENDER(PICTURE, "--window", "0,0,20,32", "-o", "left.exr") == 0 &&
          RENDER(PICTURE, "--window", "20,0,28,32", "-o", "right.exr") == 0 &&
          RENDER(PICTURE, "--window", "19,0,29,32", "-o", "wide.exr") == 0 &&
          RENDER(PICTURE, "--window", "21,0,1,1", "-o", "pixel.exr") == 0, "%s", ran.err);
    CHECK(RENDER(PICTURE, "-o", "whole.pfm") == 0 && MERGE("right.exr", "left.exr", "-o", "all.pfm") == 0 &&
          fabs(mean_difference("whole.pfm", "all.pfm")) < 0.04, "light differs by %g",
          mean_difference("whole.pfm", "all.pfm"));
    CHECK(MERGE("left.exr", "wide.exr", "-o", "all.pfm") == 1 && said("left.exr and wide.exr overlap"), "%s", ran.err);
    CHECK(MERGE("left.exr", "pixel.exr", "-o", "all.pfm") == 1 && said("895 of 1536 pixels are in no part"), "%s",
          ran.err);
}

/* Parts that were made with different drivers but one plan can be joined; this gives one warning. Mesa's software
   renderer counts as another driver if its vectors have another width. */
TEST(drivers_may_differ) {
    if (!has_openexr()) SKIP("built without OpenEXR");
    CHECK(RENDER(PICTURE, "--part", "1/2", "-o", "a.exr", "--plan", "drivers") == 0, "%s", ran.err);
    setenv("LP_NATIVE_VECTOR_WIDTH", "128", 1);
    CHECK(RENDER(PICTURE, "--part", "2/2", "-o", "b.exr", "--plan", "drivers", "--verbose") == 0, "%s", ran.err);
    unsetenv("LP_NATIVE_VECTOR_WIDTH");
    if (!said("128 bits")) SKIP("the driver has no vectors to choose from");
    CHECK(MERGE("a.exr", "b.exr", "-o", "all.pfm") == 0 && said("different graphics drivers") && ran.err_lines == 1,
          "%s", ran.err);
    CHECK(MERGE("a.exr", "b.exr", "-o", "all.pfm", "--quiet") == 0 && !ran.err[0], "%s", ran.err);
}

/* oiiotool of OpenImageIO joins the parts to the same pixels. */
TEST(oiiotool_joins_parts) {
    char command[1024];
    if (!has_openexr()) SKIP("built without OpenEXR");
    if (system("oiiotool --version > /dev/null 2>&1") != 0) SKIP("oiiotool is not installed");
    REQUIRE(make_parts("p", 3, NULL, NULL) && MERGE("p.1.exr", "p.2.exr", "p.3.exr", "-o", "all.exr") == 0, "%s",
            ran.err);
    snprintf(command, sizeof command, "cd %s && oiiotool p.1.exr p.2.exr --add p.3.exr --add -o tool.exr && "
             "oiiotool --fail 0 --diff tool.exr all.exr > /dev/null", folder);
    CHECK(system(command) == 0, "oiiotool finds a difference, or fails");
}

/* Invalid values of --part and --output are refused. */
TEST(invalid_parts_are_refused) {
    static const char *const wrong[] = { "0/3", "4/3", "1/0", "1/10001", "1", "1/", "/3", "a/3", "1/3x", "-1/3",
        "auto/" };
    size_t i;
    room_obj();
    for (i = 0; i < sizeof wrong / sizeof *wrong; i++)
        CHECK(RENDER(PICTURE, "--part", wrong[i], "-o", "a.exr") == 2 && said("--part") && ran.err_lines == 1, "%s: %s",
              wrong[i], ran.err);
    CHECK(RENDER(PICTURE, "--part", "1/2", "-o", "a.png") == 2 && said("sbl_merge"), "%s", ran.err);
    CHECK(RENDER(PICTURE, "--part", "1/2", "-o", "a%s.exr") == 2 && said("%04d"), "%s", ran.err);
    CHECK(RENDER(PICTURE, "--part", "1/2", "-o", "a%d%d.exr") == 2 && said("%04d"), "%s", ran.err);
    CHECK(RENDER(PICTURE, "--part", "1/2", "--window", "0,0,1,1", "-o", "a.exr") == 2 && said("only one"), "%s",
          ran.err);
    CHECK(RENDER(PICTURE, "--part", "1/2", "--inspect", "0,0", "-o", "a.exr") == 2 && said("--inspect"), "%s", ran.err);
    CHECK(RENDER(PICTURE, "--plan", "p", "-o", "a.exr") == 2 && said("--part"), "%s", ran.err);
    if (!has_openexr()) return;
    CHECK(RENDER(VIEW, "--size", "3x2", "--part", "7/7", "-o", "a.exr") == 2 && said("too many"), "%s", ran.err);
    CHECK(RENDER(VIEW, "--size", "3x2", "--part", "6/6", "-o", "a.exr") == 0, "%s", ran.err);
    CHECK(RENDER(PICTURE, "--part", "1/1", "-o", "a.exr") == 0, "%s", ran.err);
    CHECK(MERGE("a.exr", "-o", "all.exr") == 0, "%s", ran.err);
}

/* ---- pictures that are made window by window ---- */

/* Kills sbl_render as soon as `count` windows of the large picture are finished; see kill_when. */
static int kill_after(int count, const char *output) {
    const char *const arguments[] = { LARGE, "-o", output, "--resume", NULL };
    tool_use("sbl_render");
    return kill_when(arguments, output, count);
}

/* A picture that exceeds the allowed memory is made window by window. It shows the same as the picture that is made at
   once. A run that was killed continues with the first missing window, and the result has the same bits. No temporary
   files remain. */
TEST(killed_runs_go_on) {
    int killed[3], windows[3], all = -1, of_levels = 0, k;
    const char *at;
    if (!has_openexr()) SKIP("built without OpenEXR");
    CHECK(RENDER(LARGE, "-o", "once.exr", "--verbose", "--stats", "stats.json") == 0 && said("window 2 of "), "%s",
          ran.err);
    read_text(in_folder("stats.json"), ran.out, sizeof ran.out, &ran.out_lines);
    CHECK(strstr(ran.out, "\"size\": [450, 300]") && !strstr(ran.out, "\"sensors\": 0,"), "statistics: %s", ran.out);
    for (at = ran.out; (at = strstr(at, "\"sensors\": ")) != NULL; at++) {  /* first all, then those of levels */
        if (all < 0) all = atoi(at + 11);
        else of_levels += atoi(at + 11);
    }
    CHECK(all > 0 && all == of_levels, "%d sensors, %d in levels: %s", all, of_levels, ran.out);
    CHECK(!exists("once.exr.parts"), "the folder is left");
    for (k = 0; k < 3; k++) {
        killed[k] = kill_after(k, "often.exr");
        windows[k] = finished_windows("often.exr");
    }
    CHECK(killed[1] && windows[1] >= 1 && windows[2] >= 2, "killed %d %d %d, with %d %d %d windows", killed[0],
          killed[1], killed[2], windows[0], windows[1], windows[2]);
    CHECK(!killed[2] || (RENDER(LARGE, "-o", "often.exr") == 1 && said("--resume")), "finished work is lost: %s",
          ran.err);
    CHECK(!killed[2] || (RENDER(LARGE, "-o", "often.exr", "--seed", "3", "--resume") == 1 && said("other options") &&
          said("--seed=3")), "%s", ran.err);
    if (exists("often.exr.parts")) write_text("often.exr.parts/sbl_render.00000000.part", "left by a killed run");
    CHECK(RENDER(LARGE, "-o", "often.exr", "--resume") == 0, "%s", ran.err);
    CHECK(same_files("once.exr", "often.exr") && !exists("often.exr.parts"), "the picture differs, or files are left");
    CHECK(RENDER(LARGE, "-o", "once.pfm") == 0 && RENDER(LARGE, "--memory", "4G", "-o", "whole.pfm") == 0 &&
          fabs(mean_difference("whole.pfm", "once.pfm")) < 0.05, "differs by %g from the whole: %s",
          mean_difference("whole.pfm", "once.pfm"), ran.err);
}

/* Large pictures of channels that need no light are also made window by window. */
TEST(large_surfaces) {
    if (!has_openexr()) SKIP("built without OpenEXR");
    CHECK(RENDER(LARGE, "--channel", "depth", "-o", "depth.exr") == 0 && !exists("depth.exr.parts"), "status %d: %s",
          ran.status, ran.err);
}

/* Finished windows that were damaged later are made again. Bounced light is not computed again. */
TEST(finished_windows_are_checked) {
    static const char *const gi[] = { "room.obj", "--eye", "0,1.4,3", "--look-at", "0,.5,0", SMALL, "--quiet", "--size",
        "450x300", "--preset", "draft", "--memory", "24M", "-o", "light.exr", "--resume", NULL };
    if (!has_openexr()) SKIP("built without OpenEXR");
    REQUIRE(kill_after(2, "a.exr") && finished_windows("a.exr") >= 2, "it was not killed in time");
    damage("a.exr.parts/1.exr", "a.exr.parts/1.exr", 1, -1);
    CHECK(RENDER(LARGE, "-o", "a.exr", "--resume") == 0 && RENDER(LARGE, "-o", "b.exr") == 0 &&
          same_files("a.exr", "b.exr"), "%s", ran.err);
    REQUIRE(kill_when(gi, "light.exr", 1), "it was not killed in time: %d", ran.status);
    CHECK(exists("light.exr.parts/light"), "bounced light is not kept");
    CHECK(run(gi) == 0, "%s", ran.err);
    rename(in_folder("light.exr"), in_folder("killed.exr"));
    CHECK(run(gi) == 0 && same_files("light.exr", "killed.exr"), "%s", ran.err);
}

/* Two programs cannot use one folder of windows at the same time. A signal keeps the finished windows. A large picture
   cannot be written to a pipe. */
TEST(a_folder_has_one_user) {
    const char *const arguments[] = { LARGE, "-o", "one.exr", NULL };
    pid_t child;
    int tries = 0;
    if (!has_openexr()) SKIP("built without OpenEXR");
    for (;;) {  /* on a busy machine, the run may end before it is stopped */
        child = start_windows(arguments, "one.exr", 1);
        kill(child, SIGSTOP);
        if (finished_windows("one.exr") >= 1) break;
        kill(child, SIGCONT);
        finish(child);
        REQUIRE(++tries < 20, "no window is left behind: %s", ran.err);
    }
    CHECK(RENDER(LARGE, "-o", "one.exr", "--resume") == 1 && said("another program"), "%s", ran.err);
    kill(child, SIGINT);
    kill(child, SIGCONT);
    finish(child);
    CHECK(ran.status == 130 && said("--resume"), "status %d: %s", ran.status, ran.err);
    CHECK(RENDER(LARGE, "-o", "one.exr", "--resume") == 0 && !exists("one.exr.parts"), "%s", ran.err);
    CHECK(RENDER(LARGE, "-o", "/dev/null/.exr") != 0, "a path below a device is accepted");
    CHECK(symlink("/dev/null", in_folder("null.png")) == 0 && RENDER(LARGE, "-o", "null.png") == 1 && said("pipe"),
          "%s", ran.err);
}

/* If the disk is full, the run reports it. A later run continues when there is space. The windows of one part are not
   used for another part. */
TEST(a_full_disk_loses_nothing) {
    const char *const arguments[] = { LARGE, "-o", "full.pfm", NULL };
    const char *const again[] = { LARGE, "-o", "full.pfm", "--resume", NULL };
    const char *const first[] = { LARGE, "--part", "1/2", "-o", "part.exr", NULL };
    if (!has_openexr()) SKIP("built without OpenEXR");
    tool_use("sbl_render");
    finish(start(arguments, -1, 20000));
    CHECK(ran.status == 1 && said("1.exr: cannot be written"), "status %d: %s", ran.status, ran.err);
    finish(start(again, -1, 800000));
    CHECK(ran.status == 1 && said("full.pfm: cannot be written") && !exists("full.pfm"), "status %d: %s", ran.status,
          ran.err);
    CHECK(run(again) == 0 && exists("full.pfm") && !exists("full.pfm.parts") && !parts_left(), "%s", ran.err);
    finish(start(first, -1, 20000));
    CHECK(ran.status == 1 && said("1.exr: cannot be written"), "status %d: %s", ran.status, ran.err);
    CHECK(RENDER(LARGE, "--part", "2/2", "-o", "part.exr", "--resume") == 1 && said("another part"), "%s", ran.err);
    CHECK(RENDER(LARGE, "--part", "1/2", "-o", "part.exr", "--resume") == 0 && !exists("part.exr.parts"), "%s",
          ran.err);
}

/* Bounced light is stored beside the finished windows. A later run makes the missing window with this light, and then
   removes everything. */
TEST(bounced_light_waits_for_the_rest) {
    const char *const arguments[] = { "room.obj", "--eye", "0,1.4,3", "--look-at", "0,.5,0", SMALL, "--quiet",
        "--size", "320x200", "--preset", "draft", "--memory", "24M", "--max-bounce-cells", "1024", "-o", "gi.pfm",
        "--stats", "gi.json", "--resume", NULL };
    char stats[4096];
    int lines;
    if (!has_openexr()) SKIP("built without OpenEXR");
    tool_use("sbl_render");
    finish(start(arguments, -1, 500000));
    CHECK(ran.status == 1 && said("gi.pfm: cannot be written") && exists("gi.pfm.parts/light"), "status %d: %s",
          ran.status, ran.err);
    REQUIRE(finished_windows("gi.pfm") > 1 && unlink(in_folder("gi.pfm.parts/2.exr")) == 0, "%d windows",
            finished_windows("gi.pfm"));
    CHECK(run(arguments) == 0 && exists("gi.pfm") && !exists("gi.pfm.parts"), "files are left: %s", ran.err);
    read_text(in_folder("gi.json"), stats, sizeof stats, &lines);
    CHECK(strstr(stats, "\"bounce_rays\": 0,") && strstr(stats, "\"mode\": \"gi\"") && !strstr(stats, "\"rays\": 0,"),
          "the stored light was not used: %s", stats);
}

int main(int argc, char **argv) {
    (void)argc;
    if (!tool_begin(argv[0])) return 1;
    RUN(parts_make_the_whole);
    RUN_PLAIN(parts_make_a_png);
    RUN(parts_do_not_depend_on_each_other);
    RUN(the_first_plan_counts);
    RUN(parts_share_the_number_of_cells);
    RUN(impossible_plans_are_reported_before_the_work);
    RUN_PLAIN(prices_grow_with_the_pixels);
    RUN_PLAIN(plans_know_what_rays_take);
    RUN_PLAIN(plans_know_what_margins_take);
    RUN(wrong_parts_are_refused);
    RUN_PLAIN(windows_are_joined);
    RUN_PLAIN(drivers_may_differ);
    RUN_PLAIN(oiiotool_joins_parts);
    RUN(invalid_parts_are_refused);
    RUN(killed_runs_go_on);
    RUN(large_surfaces);
    RUN_PLAIN(finished_windows_are_checked);
    RUN(a_folder_has_one_user);
    RUN(a_full_disk_loses_nothing);
    RUN(bounced_light_waits_for_the_rest);
    tool_end();
    return test_report();
}
