/* Demonstrates a tool that joins parts into one file: the parts of a picture from sbl_render --part or --window, or the
   parts of probes or vertices from sbl_bake --part. The parts may come from several machines. `sbl_merge --help`
   explains its options. */
#define _DEFAULT_SOURCE
#include "../sbl.h"
#include "output_file.h"
#include "picture_file.h"
#include "part_list.h"
#include "picture_parts.h"
#include "bake_parts.h"
#define TOOL_NAME "sbl_merge"
#define TOOL_MAKES "file"
#include "tool.h"
#include "tool_options.h"

static struct options {
    const char *output, *parts[PARTS_MAX];
    double exposure;  /* NaN: automatic */
    int help_all;
} options = { .exposure = NAN };

static const char *const help_words[] = { "all", NULL };

enum { OUTPUT, EXPOSURE, QUIET, HELP, VERSION, OPTION_COUNT };

static const tool_option table[OPTION_COUNT] = {
    [OUTPUT] = { "--output", "FILE", TEXT, &options.output, 0, 0, 0,
                 "also -o; a picture: .png (8-bit sRGB), .pfm or .exr (linear 32-bit floats); a bake: .json or .ply" },
    [EXPOSURE] = { "--exposure", "STOPS", NUMBERS, &options.exposure, 1, -100, 100,
                   "each stop doubles the brightness of a .png; default auto: the exposure that sbl_render chose for "
                   "the complete picture. Not for parts of channel display", exposure_words },
    [QUIET] = { "--quiet", NULL, FLAG, NULL, 0, 0, 0, "shows no warnings" },
    [HELP] = { "--help", "[all]", FLAG_OR_WORD, &options.help_all, 0, 0, 0, "also -h; this text", help_words },
    [VERSION] = { "--version", NULL, FLAG, NULL, 0, 0, 0, "shows the version" }
};
static int given[OPTION_COUNT];

static void print_help(void) {
    static const tool_line lines[] = {
        { TOOL_HEADING, "Options:" }, { OUTPUT, "" }, { EXPOSURE, "" }, { QUIET, "" }, { HELP, "" }, { VERSION, "" }
    };
    tool_print_text("usage: sbl_merge PART... -o FILE [options]\n"
                    "\n"
                    "Joins the parts of a picture (sbl_render --part K/N or --window) or of a bake (sbl_bake --part "
                    "K/N with --probes or --vertices; sbl_bake --join joins lightmaps). A PART is a file, or a folder "
                    "that holds the parts. For a picture, all .exr files of the folder are parts; for a bake, all "
                    "files with the ending of the output (.json or .ply). The joined file of a bake is byte-identical "
                    "to that of a bake without --part. It is an error if a part is missing, given twice or "
                    "incomplete, or comes from another scene, other options or another version; the message names the "
                    "part. sbl_merge needs little memory, even for large parts.\n");
    tool_print_help(table, OPTION_COUNT, lines, (int)(sizeof lines / sizeof *lines), 1);
    tool_print_text("\n" TOOL_STATUS_WORDS);
}

static int ends_with(const char *path, const char *ending) {
    const size_t length = strlen(path), tail = strlen(ending);
    return length > tail && strcmp(path + length - tail, ending) == 0;
}

static const char *const formats[] = { ".png", ".pfm", ".exr", ".json", ".ply", NULL };
enum { PICTURE_FORMATS = 3 };  /* number of picture formats, which come first in `formats` */

/* The parts are in `bakes` if is_bake is 1, otherwise in `pictures`. The ending of the output name decides. */
static int is_bake;
static picture_parts pictures;
static bake_parts bakes = { .cancel = &interrupted };

static part_list *parts_given(void) { return is_bake ? &bakes.list : &pictures.list; }

static int parse(int argc, char **argv) {
    const tool_command command = { argc, argv, table, OPTION_COUNT, given, options.parts, PARTS_MAX };
    const int status = tool_parse(&command);
    int i;
    if (status != DONE || given[HELP] || given[VERSION]) return status;
    if (!options.parts[0] || !options.output) return misuse("usage: sbl_merge PART... -o FILE; see --help");
    for (i = 0; formats[i] && !ends_with(options.output, formats[i]); i++) continue;
    if (!formats[i])
        return misuse("--output %s: the name must end in .png, .pfm, .exr, .json or .ply", options.output);
    is_bake = i >= PICTURE_FORMATS;
    bakes.is_ply = ends_with(options.output, ".ply");
    if (is_bake && given[EXPOSURE]) return misuse("--exposure is for pictures; leave it out for %s", options.output);
    return DONE;
}

static int add_part(const char *name) { return is_bake ? bake_add(&bakes, name) : parts_add(&pictures, name); }

/* Adds the files of a folder whose names end like those of parts. Returns 1 on success. */
static int add_folder(const char *folder) {
    int i, count = 0, ok;
    char **names = parts_folder(parts_given(), folder, !is_bake ? ".exr" : bakes.is_ply ? ".ply" : ".json", &count);
    ok = names != NULL;
    for (i = 0; i < count && ok; i++) ok = add_part(names[i]);
    parts_folder_free(names, count);
    return ok;
}

/* Returns the channel that a fact names. Only channels that a .png shows in a special way are distinguished; all others
   become SBL_CHANNEL_FINAL. */
static sbl_channel channel_of(const char *name) {
    static const struct { const char *name; sbl_channel channel; } words[] = {
        { "albedo", SBL_CHANNEL_ALBEDO }, { "normal", SBL_CHANNEL_NORMAL }, { "position", SBL_CHANNEL_POSITION },
        { "id", SBL_CHANNEL_ID }, { "depth", SBL_CHANNEL_DEPTH }, { "sensors", SBL_CHANNEL_SENSORS },
        { "error", SBL_CHANNEL_ERROR }, { "looks", SBL_CHANNEL_LOOKS },
        { "radiance_error", SBL_CHANNEL_RADIANCE_ERROR }
    };
    size_t i;
    for (i = 0; i < sizeof words / sizeof *words; i++)
        if (strcmp(words[i].name, name) == 0) return words[i].channel;
    return SBL_CHANNEL_FINAL;
}

/* Chooses the channel and exposure for the output, and warns if highlights are lost. */
static void show_picture(parts_job *job) {
    const char *channel = pictures.list.facts[FACT_CHANNEL].text;
    job->channel = channel_of(channel);
    job->stops = !isnan(options.exposure) ? options.exposure
               : strcmp(channel, "display") == 0 ? 0 : strtod(pictures.list.facts[FACT_EXPOSURE].text, NULL);
    if (picture_is_error(job->channel) && isnan(options.exposure)) job->stops += PICTURE_ERROR_STOPS;
    if (given[EXPOSURE] && !ends_with(options.output, ".png") && !given[QUIET])
        warn("no effect: --exposure (only a .png is exposed)");
    if (strcmp(channel, "final") == 0 && ends_with(options.output, ".png") && !given[QUIET])
        warn("highlights above 1 are cut off, because these parts have no tone; make them again with --channel "
             "display");
}

/* Reads the parts. Returns 1 if all could be read and together they are complete. Sets job->region, which is used only
   for pictures. */
static int read_parts(parts_job *job) {
    struct stat info;
    int i, ok = 1;
    for (i = 0; i < PARTS_MAX && options.parts[i] && ok; i++)
        ok = stat(options.parts[i], &info) == 0 && S_ISDIR(info.st_mode) ? add_folder(options.parts[i])
                                                                         : add_part(options.parts[i]);
    job->region[2] = pictures.frame.width;
    job->region[3] = pictures.frame.height;
    return ok && (is_bake ? bake_check(&bakes) : parts_check(&pictures, job->region));
}

/* Joins the parts and writes the output file. Returns the exit status. */
static int merge(void) {
    parts_job job = { &pictures, options.output, { 0, 0, 0, 0 }, NULL, SBL_CHANNEL_FINAL, 0, &interrupted };
    bake_parts *all = &bakes;
    const part_list *list = parts_given();
    output_file target;
    struct stat part, out;
    int i, ok;
    if (!read_parts(&job)) return fail("%s", list->error);
    for (i = 0; i < list->count; i++)
        if (stat(list->files[i].name, &part) == 0 && stat(options.output, &out) == 0 &&
            part.st_dev == out.st_dev && part.st_ino == out.st_ino)
            return misuse("%s would overwrite a part; give another name", options.output);
    if (list->drivers && !given[QUIET])
        warn("the parts were made by different graphics drivers, whose light differs by rounding and noise");
    if (given[EXPOSURE] && strcmp(list->facts[FACT_CHANNEL].text, "display") == 0)
        return misuse("--exposure: these parts are of channel display, which contains the exposure; leave it out, or "
                      "make the parts again with --exposure");
    if (!is_bake) show_picture(&job);
    output_find(&target, options.output);
    ok = target.path && (is_bake ? output_write(&target, bake_write, &all, &interrupted)
                                 : output_write(&target, parts_write, &job, &interrupted));
    output_free(&target);
    if (ok) return DONE;
    if (interrupted) return stop("%s is not written", options.output);
    return list->error[0] ? fail("%s", list->error)
                          : fail("%s: cannot be written: %s; free some space or give another file name",
                                 options.output, errno ? strerror(errno) : "the writer failed");
}

int main(int argc, char **argv) {
    int status = parse(argc, argv);
    if (status != DONE) return status;
    if (given[HELP]) { print_help(); return fflush(stdout) == 0 ? DONE : FAILED; }
    if (given[VERSION]) { printf("sbl_merge %s\n", sbl_version()); return fflush(stdout) == 0 ? DONE : FAILED; }
    catch_signals();
    status = merge();
    parts_free(&pictures);
    bake_free(&bakes);
    return status;
}
