/* The common parts of tools that read a scene, let sbl.h work on it, and write files: messages of sbl.h, common
   options, the default sky, output files, statistics, stored light, and the order of these steps. Include after tool.h,
   tool_options.h and output_file.h. Define TOOL_DRAWS first if the tool renders pictures, which adds --mode paper. The
   table of a tool lists its own options after the common ones:

       enum { OUTPUT = COMMON_OPTIONS, ..., OPTION_COUNT };
       static int given[OPTION_COUNT];
       static const tool_option table[OPTION_COUNT] = { COMMON_ROWS, [OUTPUT] = { ... }, ... }; */
#ifndef TOOL_SCENE_H
#define TOOL_SCENE_H

#include "tool_words.h"

/* ---- messages of sbl.h ---- */

/* Messages from sbl.h. If the work fails, the first error is printed; if it succeeds, the warnings are printed. */
typedef struct messages {
    char error[640];
    int errors;
    char warnings[8][512];
    int warnings_kept;
    char store[256];              /* the message of sbl_load_store and its item; see load_store */
    sbl_log_item store_item;
    const scene_file *file;
} messages;

/* Stores a warning, unless the list already contains it. It is printed at the end if the work succeeds. */
static inline void warn_later(messages *m, const char *format, ...) {
    va_list arguments;
    int i = 0;
    if (m->warnings_kept == 8) return;
    va_start(arguments, format);
    vsnprintf(m->warnings[m->warnings_kept], sizeof m->warnings[0], format, arguments);
    va_end(arguments);
    while (strcmp(m->warnings[i], m->warnings[m->warnings_kept]) != 0) i++;
    m->warnings_kept += i == m->warnings_kept;
}

static void on_log(sbl_log_level level, sbl_log_item item, const char *from_library, void *user) {
    messages *m = (messages *)user;
    char message[640];
    int mesh;
    tool_translate(message, sizeof message, from_library);
    if (item == SBL_LOG_ITEM_INVALID_STORE || item == SBL_LOG_ITEM_OTHER_STORE || item == SBL_LOG_ITEM_COARSE_STORE) {
        snprintf(m->store, sizeof m->store, "%.250s", message);
        m->store_item = item;
        return;
    }
    if (level == SBL_LOG_ERROR && m->errors++ == 0) {
        if (m->file && sscanf(message, "mesh %d:", &mesh) == 1 && mesh >= 0 && mesh < m->file->scene.mesh_count)
            snprintf(m->error, sizeof m->error, "%.500s (mesh %d is \"%.100s\")", message, mesh, m->file->names[mesh]);
        else snprintf(m->error, sizeof m->error, "%.600s", message);
    }
    if (level == SBL_LOG_WARNING) warn_later(m, "%.500s", message);
}

static int fail_with(const messages *m, const char *where, sbl_result result) {
    if (!m->errors) return fail("%s: %s", where, sbl_result_string(result));
    if (m->errors == 1) return fail("%s: %s", where, m->error);
    return fail("%s: %s (and %d more errors)", where, m->error, m->errors - 1);
}

/* ---- ulimit -v: GL drivers crash if they get no memory ---- */

static void on_breakdown(int number) {
    static const char line[] = TOOL_NAME ": the graphics driver crashed because memory ran out; raise the limit of "
        "ulimit -v\n";
    (void)number;
    if (write(STDERR_FILENO, line, sizeof line - 1) >= 0) _exit(FAILED);
    _exit(FAILED);
}

/* Returns 1 if ulimit -v leaves enough address space for a GL driver. If there is a limit, a later crash of the driver
   ends the program with a message. */
static int check_address_space(void) {
    const size_t driver = (size_t)512 << 20;  /* need of the software renderer of Mesa on two cores */
    struct rlimit limit;
    void *room;
    if (getrlimit(RLIMIT_AS, &limit) != 0 || limit.rlim_cur == RLIM_INFINITY) return 1;
    signal(SIGSEGV, on_breakdown);
    signal(SIGBUS, on_breakdown);
    signal(SIGABRT, on_breakdown);
    room = mmap(NULL, driver, PROT_NONE, MAP_PRIVATE | MAP_ANONYMOUS | MAP_NORESERVE, -1, 0);
    if (room != MAP_FAILED) munmap(room, driver);
    return room != MAP_FAILED;
}

static void on_confined(const char *path, const char *message, void *user) {
    (void)user;
    tell("%s: protection of the process that read it: %s", path, message);
}

/* ---- input files and streams ---- */

/* Opens a regular file for reading, without ever waiting for a pipe or a device. Returns NULL and sets errno on
   failure. */
static inline FILE *input_open(const char *name) {
    const int handle = scene__open_regular(NULL, name);
    FILE *in = handle < 0 ? NULL : fdopen(handle, "rb");
    if (handle >= 0 && !in) close(handle);
    return in;
}

static size_t put_bytes(const void *data, size_t bytes, void *user) { return fwrite(data, 1, bytes, (FILE *)user); }
static size_t get_bytes(void *data, size_t bytes, void *user) { return fread(data, 1, bytes, (FILE *)user); }

/* ---- options ---- */

static struct tool_common {
    const char *scene, *output, *stats, *sky_picture, *store, *input;  /* input: a further input file, or NULL */
    int help_all, mode, preset, backend, rays, max_bounce_cells, sensor_size, tile, filter_radius, seed;
    double sky[3], sky_rotation, sky_scale, sky_up[3], light_scale, epsilon, threshold;
    scene_file_options reading;
} common = { .sky_scale = 1, .sky_up = { 0, 1, 0 } };

static const char *const help_words[] = { "all", NULL };
#ifdef TOOL_DRAWS
#define TOOL__PAPER(text) text
#define TOOL__BAKE(text)
#define TOOL__TILE "16"
#define TOOL__PIXEL "pixel"
enum { TOOL_RAYS_MAX = 4096, TOOL__HAS_CAMERA = 1 };
static const char *const mode_words[] = { "gi", "ambient", "direct", "paper", NULL };
#else
#define TOOL__PAPER(text)
#define TOOL__BAKE(text) text
#define TOOL__TILE "8"
#define TOOL__PIXEL "texel"
enum { TOOL__HAS_CAMERA = 0, TOOL_RAYS_MAX = 65536 };  /* rays of probes; sbl_bake checks the limits of others */
static const char *const mode_words[] = { "gi", "ambient", "direct", NULL };
#endif
static const char *const preset_words[] = { "draft", "default", "high", NULL };
static const char *const materials_words[] = { "file", "matte", NULL };
static const char *const backend_words[] = { "auto", "raster", "trace", NULL };
static const sbl_mode modes[] = { SBL_MODE_GI, SBL_MODE_AMBIENT, SBL_MODE_DIRECT, SBL_MODE_PAPER };
static const sbl_backend backends[] = { SBL_BACKEND_AUTO, SBL_BACKEND_RASTER, SBL_BACKEND_TRACE };
static const sbl_preset presets[] = { SBL_PRESET_DRAFT, SBL_PRESET_DEFAULT, SBL_PRESET_HIGH };

enum {
    SKY, SKY_ROTATION, SKY_SCALE, SKY_UP, LIGHT_SCALE, MATERIALS, MODE, PRESET, BACKEND, RAYS, MAX_BOUNCE_CELLS,
    EPSILON, SENSOR_SIZE, TILE, THRESHOLD, FILTER_RADIUS, SEED, STATS, ALLOW_PATH, MEMORY, READ_TIME, STORE,
    STORE_REPLACE, QUIET, VERBOSE, HELP, VERSION, COMMON_OPTIONS
};

#define COMMON_ROWS \
    [SKY]           = { "--sky", "R,G,B|FILE", NUMBERS_OR_FILE, common.sky, 3, 0, 1e30, \
                        "constant radiance of the sky; default 0,0,0. Default for a file without any light: " \
                        TOOL__PAPER("the light of --studio, or with --mode paper a sky of ") "1,1,1." \
                        TOOL__PAPER(" If the file has light, and neither --sky nor --studio is given, screens (a " \
                                    ".png, channel display, and sbl_view) show a grey backdrop, which lights " \
                                    "nothing.") \
                        "\nFILE: equirectangular picture of the sky: .hdr, or .png, .jpg, ..., which are decoded " \
                        "from sRGB. The upper edge of the picture is straight up, its centre is +x", NULL, \
                        &common.sky_picture, .file_words = "a picture file such as noon.hdr" }, \
    [SKY_ROTATION]  = { "--sky-rotation", "DEGREES", NUMBERS, &common.sky_rotation, 1, -360, 360, \
                        "rotates the sky picture counter-clockwise, seen from above; default 0", NULL, NULL }, \
    [SKY_SCALE]     = { "--sky-scale", "F", NUMBERS, &common.sky_scale, 1, 0, 1e30, \
                        "multiplies the radiance of the sky picture; default 1", NULL, NULL }, \
    [SKY_UP]        = { "--sky-up", "X,Y,Z", NUMBERS, common.sky_up, 3, -1e18, 1e18, \
                        "the direction that is up in the sky picture; default 0,1,0", NULL, NULL }, \
    [LIGHT_SCALE]   = { "--light-scale", "F", NUMBERS, &common.light_scale, 1, 0, 1e30, \
                        "multiplies the lights of the file, but not emission and not the sky. Default 1, but for " \
                        "glTF from Blender the factor that makes lights fit emission, which is 1/683 in most cases " \
                        "(see Units in examples/README.md)", NULL, NULL }, \
    [MATERIALS]     = { "--materials", "NAME", CHOICE, &common.reading.matte, 0, 0, 0, \
                        "file      the default: metal, gloss, transparent surfaces (thin panes) and normal maps " \
                        "as in the file (see Metal and gloss in examples/README.md)\n" \
                        "matte     all surfaces are matte, opaque and without normal maps; metal has its base " \
                        "colour", materials_words, NULL }, \
    [MODE]          = { "--mode", "NAME", CHOICE, &common.mode, 0, 0, 0, \
                        "gi        the default: emitters, lights, sky, and the light that surfaces reflect, with " \
                        "all bounces\n" \
                        "direct    emitters, lights and sky only\n" \
                        "ambient   direct light, and surfaces that do not emit have the radiance epsilon * albedo" \
                        TOOL__PAPER("\npaper     the method of the paper, with one view of 135 degrees"), \
                            mode_words, NULL }, \
    [PRESET]        = { "--preset", "NAME", CHOICE, &common.preset, 0, 0, 0, \
                        "draft | default | high (default: default). Where this text says \"by preset\", the three " \
                        "values are those of draft, default and high", preset_words, NULL }, \
    [BACKEND]       = { "--backend", "NAME", CHOICE, &common.backend, 0, 0, 0, \
                        "how sensors measure: auto (default: trace" TOOL__PAPER(", but raster in mode paper") \
                        ") | raster (draw views) | trace (trace rays)", backend_words, NULL }, \
    [RAYS]          = { "--rays", "N", INTEGERS, &common.rays, 1, 1, TOOL_RAYS_MAX, \
                        "traces exactly this many rays for each sensor; the target error then decides only where " \
                        "sensors are placed. Default: as many as the target error requires" \
                        TOOL__BAKE(". For light at vertices: the rays of each point on a triangle; default 16, 64, " \
                                   "256 by preset. For probes: the rays of a probe, in all directions, at least 64; " \
                                   "default 1024, 4096, 16384 by preset"), NULL, NULL }, \
    [MAX_BOUNCE_CELLS] = { "--max-bounce-cells", "N", INTEGERS, &common.max_bounce_cells, 1, 1024, 1048576, \
                        "maximum number of cells that store bounced light, in mode gi; each needs about 4 KB of " \
                        "memory. Default: 1.5 per triangle, limited to 49152..196608, or 196608 if the error of " \
                        "stored light exceeds 1.5 times the target error (but not if the scene has several " \
                        "lightmaps). For parts, a small picture of the whole decides this, and for frames one of " \
                        "frame 1. Use more if light comes through gaps, or if geometry is fine. --bounce-samples is " \
                        "a synonym", \
                        .synonym = "--bounce-samples" }, \
    [EPSILON]       = { "--epsilon", "E", NUMBERS, &common.epsilon, 1, 0, 1e30, \
                        "the epsilon of mode" TOOL__PAPER("s paper and") \
                        " ambient: surfaces that do not emit have the radiance epsilon * albedo; default 0.02", \
                        NULL, NULL }, \
    [SENSOR_SIZE]   = { "--sensor-size", "N", INTEGERS, &common.sensor_size, 1, 4, 512, \
                        "texels across one view of a rasterised sensor; default 32, 64, 128 by preset" \
                        TOOL__BAKE(", of probes 8, 16, 32"), NULL, NULL }, \
    [TILE]          = { "--tile", "N", INTEGERS, &common.tile, 1, 1, 1024, \
                        "size of the first tiles in " TOOL__PIXEL "s: sensors are placed at their corners; 1 places " \
                        "a sensor at every " TOOL__PIXEL "; default " TOOL__TILE \
                        TOOL__BAKE(". --supersample K makes this unit K times as small"), \
                        NULL, NULL }, \
    [THRESHOLD]     = { "--threshold", "T", NUMBERS, &common.threshold, 1, 0, 1e30, \
                        "subdivides tiles where neighbouring sensors differ by more than this fraction of their " \
                        "mean, instead of where the predicted error is large" \
                        TOOL__PAPER(". In mode paper, T is an absolute difference of radiance; default 0.05"), \
                        NULL, NULL }, \
    [FILTER_RADIUS] = { "--filter-radius", "N", INTEGERS, &common.filter_radius, 1, 0, 32, \
                        "radius of the Gaussian filter in " TOOL__PIXEL "s; 0 turns it off; default 2" \
                        TOOL__BAKE("; unit as for --tile"), NULL, NULL }, \
    [SEED]          = { "--seed", "N", INTEGERS, &common.seed, 1, 0, INT_MAX, \
                        "changes the rotations of the sensors, and so the noise; default 0", NULL, NULL }, \
    [STORE]         = { "--store", "FILE", TEXT, &common.store, 0, 0, 0, \
                        "loads the bounced light from FILE; if FILE does not exist or is empty, computes the light " \
                        "and writes it there. Light of another scene, or of this scene with other materials, lights " \
                        "or sky, is refused. Light that was made with a smaller --max-bounce-cells is used, with a " \
                        "warning; mode gi only", \
                        NULL, NULL }, \
    [STORE_REPLACE] = { "--store-replace", NULL, FLAG, NULL, 0, 0, 0, \
                        "with --store: if FILE holds light of another scene, or light that was made with a smaller " \
                        "--max-bounce-cells, computes the light and replaces FILE at the end. A file that holds no " \
                        "stored light is never replaced", NULL, NULL }, \
    [STATS]         = { "--stats", "FILE", TEXT, &common.stats, 0, 0, 0, \
                        "writes counts, times in seconds (total: from start to result) and peak memory as JSON", \
                        NULL, NULL }, \
    [ALLOW_PATH]    = { "--allow-path", "DIR", LIST, common.reading.allow, SCENE_FILE_FOLDERS, 0, 0, \
                        "allows the scene to refer to files below DIR, in addition to its own folder; can be given " \
                        "several times", NULL, NULL }, \
    [MEMORY]        = { "--memory", "SIZE", BYTES, &common.reading.memory, 1, 16.0 * (1 << 20), \
        1024.0 * (1 << 30) * 1024, \
                        "limit on the memory for the scene and for a picture, such as 512M or 4G. Default: half of " \
                        "the memory of the machine or of the control group, but never more than half of what ulimit " \
                        "-v leaves. A scene that needs more is refused; a picture that needs more is made window by " \
                        "window", NULL, NULL }, \
    [READ_TIME]     = { "--read-time", "SECONDS", NUMBERS, &common.reading.seconds, 1, 0.1, 1e6, \
                        "limit on the time for reading the scene; default 60", NULL, NULL }, \
    [QUIET]         = { "--quiet", NULL, FLAG, NULL, 0, 0, 0, "shows no progress bar and no warnings", NULL, NULL }, \
    [VERBOSE]       = { "--verbose", NULL, FLAG, NULL, 0, 0, 0, \
                        "prints what was found and chosen, one line each: the lights, the camera of a picture, " \
                        "mode, target error, size, back end, the OpenGL renderer, and how the kernel restricts the " \
                        "process that reads files", NULL, NULL }, \
    [HELP]          = { "--help", "[all]", FLAG_OR_WORD, &common.help_all, 0, 0, 0, \
                        "also -h; prints the most common options; --help all prints all options, and explains files " \
                        "and exit status", help_words, NULL }, \
    [VERSION]       = { "--version", NULL, FLAG, NULL, 0, 0, 0, "shows the version", NULL, NULL }

/* The lines of the help text that all tools share; see tool_line. */
#define LIGHT_LINES \
    { SKY, "colour of the sky, or a picture such as noon.hdr" }, \
    { SKY_ROTATION, "rotates the sky picture" }, \
    { SKY_SCALE, "multiplies the radiance of the sky picture" }, \
    { SKY_UP, NULL }, { LIGHT_SCALE, "scales the lights of the file, but not emission or sky" }, { MATERIALS, NULL }
#define QUALITY_LINES \
    { PRESET, "draft, default or high" }, \
    { BACKEND, NULL }, { RAYS, NULL }, { MAX_BOUNCE_CELLS, NULL }, { EPSILON, NULL }, { SENSOR_SIZE, NULL }, \
    { TILE, NULL }, { THRESHOLD, NULL }, { FILTER_RADIUS, NULL }, { SEED, NULL }
#define OUTPUT_LINES \
    { STORE, "loads bounced light; if FILE is missing, writes it" }, { STORE_REPLACE, NULL }, \
    { STATS, "writes counts, times and memory as JSON" }, \
    { QUIET, "no progress bar and no warnings" }, \
    { VERBOSE, "prints what was found and chosen" }, \
    { HELP, "also -h; all: lists every option" }, \
    { VERSION, "prints the version" }
#define SAFETY_LINES \
    { ALLOW_PATH, "the scene may also refer to files below DIR" }, \
    { MEMORY, "limit on memory, such as 4G" }, \
    { READ_TIME, "limit on the time for reading the scene; default 60" }

static sbl_mode common_mode(const int *given) { return given[MODE] ? modes[common.mode] : SBL_MODE_GI; }

/* Refuses options that contradict each other. Returns the exit status. */
static int common_check(const int *given) {
    const sbl_mode mode = common_mode(given);
    if (!common.scene) return misuse("usage: " TOOL_NAME " SCENE [options]; see --help");
    if (given[STORE] && mode != SBL_MODE_GI)
        return misuse("--store needs --mode gi: other modes have no bounced light");
    if (given[STORE_REPLACE] && !given[STORE])
        return misuse("--store-replace needs --store FILE, the file to replace");
    if (given[EPSILON] && (mode == SBL_MODE_GI || mode == SBL_MODE_DIRECT))
        return misuse("--epsilon needs --mode ambient" TOOL__PAPER(" or paper")
                      ": the other modes have no ambient factor");
    if (common.sky_picture && mode == SBL_MODE_PAPER)
        return misuse("--sky %s: --mode paper allows no sky picture; give a colour or choose another --mode",
            common.sky_picture);
    if (!common.sky_picture && (given[SKY_ROTATION] || given[SKY_SCALE] || given[SKY_UP]))
        return misuse("--sky-rotation, --sky-scale and --sky-up need --sky with a picture");
    if (common.sky_up[0] == 0.0 && common.sky_up[1] == 0.0 && common.sky_up[2] == 0.0)
        return misuse("--sky-up must not be 0,0,0");
    if (backends[common.backend] == SBL_BACKEND_TRACE && mode == SBL_MODE_PAPER)
        return misuse("--backend trace: --mode paper needs raster; leave out --backend or choose another --mode");
    return DONE;
}

/* ---- options without effect ---- */

static char without_effect[512];  /* names of given options without effect, with the reasons */

/* If the option was given and the condition is true, adds the option to without_effect. why: the reason, which is
   printed in parentheses after the name */
static void note_if(int condition, const int *given, const tool_option *table, int option, const char *why) {
    const size_t used = strlen(without_effect);
    if (condition && given[option])
        snprintf(without_effect + used, sizeof without_effect - used, "%s%s (%s)", used ? ", " : "", table[option].name,
                 why);
}

/* Returns 1 if sensors draw views, and 0 if they trace rays. */
static int common_draws_views(const int *given) {
    return backends[common.backend] == SBL_BACKEND_RASTER || common_mode(given) == SBL_MODE_PAPER;
}

static inline void common_note(const int *given, const tool_option *table) {
    note_if(!common_draws_views(given), given, table, SENSOR_SIZE, "rays are traced; only --backend raster has views");
    note_if(common_mode(given) == SBL_MODE_PAPER, given, table, RAYS, "--mode paper traces no rays");
    note_if(common_mode(given) == SBL_MODE_PAPER, given, table, SEED, "--mode paper rotates no sensors");
    note_if(common_mode(given) != SBL_MODE_GI, given, table, MAX_BOUNCE_CELLS, "only --mode gi has bounced light");
}

/* Notes options without effect on pictures and lightmaps. target_error: index of that option in the table */
static inline void common_note_refinement(const int *given, const tool_option *table, int target_error) {
    note_if(common.tile == 1, given, table, THRESHOLD, "--tile 1 has a sensor at every pixel");
    note_if(given[RAYS] && common.tile == 1, given, table, target_error, "--rays and --tile set the quality");
    note_if(given[RAYS] && given[THRESHOLD] && common.tile != 1, given, table, target_error,
            "--rays and --threshold set the quality");
}

/* ---- converting options for sbl.h ---- */

/* Converts a number of the command line to a field of sbl.h. On the command line 0 means 0; in a field 0 means the
   default, and a negative number means 0. */
static float zero_or(double x) { return (float)x > 0 ? (float)x : -1; }

static inline sbl_options common_options(const int *given, progress *bar) {
    sbl_options o;
    memset(&o, 0, sizeof o);
    o.mode = common_mode(given);
    if (given[PRESET]) o.preset = presets[common.preset];
    o.backend = backends[common.backend];
    o.rays = common.rays;
    o.sensor_size = common.sensor_size;
    if (given[EPSILON]) o.epsilon = zero_or(common.epsilon);
    o.seed = (uint32_t)common.seed;
    o.progress = on_progress;
    o.progress_user = bar;
    return o;
}

/* ---- the light of the scene ---- */

/* Returns 1 if the scene has lights or emitting surfaces. An empty scene counts as lit. */
static int is_lit(const sbl_scene_desc *scene) {
    int i, k;
    if (scene->light_count > 0) return 1;
    for (i = 0; i < scene->mesh_count; i++)
        for (k = 0; k < 3; k++) if (scene->materials[scene->meshes[i].material].emission[k] > 0) return 1;
    return scene->mesh_count == 0;
}

/* Returns 1 if the tool adds a default sky, because the scene emits no light and --sky was not given. */
static int lit_by_us(const sbl_scene_desc *scene, const int *given) { return !given[SKY] && !is_lit(scene); }

/* Returns the scene of the file with the sky of the options. sky: the picture of the sky, or NULL */
static sbl_scene_desc common_scene(const scene_file *file, const scene_file *sky, const int *given) {
    sbl_scene_desc scene = file->scene;
    int i;
    for (i = 0; i < 3; i++) scene.sky[i] = common.sky_picture ? 0 : (float)common.sky[i];
    for (i = 0; i < 3 && lit_by_us(&scene, given); i++) scene.sky[i] = 1;
    if (sky) {
        scene.environment.picture = sky->scene.environment.picture;
        scene.environment.scale = zero_or(common.sky_scale);
        scene.environment.rotation = (float)common.sky_rotation;
        for (i = 0; i < 3; i++) scene.environment.up[i] = (float)common.sky_up[i];
    }
    scene.max_bounce_cells = common.max_bounce_cells;
    return scene;
}

/* ---- output files, which are written completely or not at all, and never over input files ---- */

enum { STATISTICS, STORED, OWN_TARGETS, TARGETS_MAX = 4096 };
static output_file targets[TARGETS_MAX];
static int target_count;

static void targets_free(void) { while (target_count > 0) output_free(&targets[--target_count]); }

/* Begins the list of targets with the files of --stats and --store. The tool adds its own files from OWN_TARGETS on. */
static void targets_begin(void) {
    if (common.stats) output_find(&targets[STATISTICS], common.stats);
    if (common.store) output_find(&targets[STORED], common.store);
    target_count = OWN_TARGETS;
}

/* Returns 1 if the file of --store will not be written, because it already holds light that is kept. */
static int targets__store_stays(const int *given) {
    struct stat info;
    return !given[STORE_REPLACE] && stat(targets[STORED].path, &info) == 0 && info.st_size > 0;
}

/* Checks that no two targets are the same file, that no target is an input file, and that the first `checked` targets
   can be written. Returns the exit status. */
static int targets_check(int checked, const int *given) {
    const char *const inputs[3] = { common.scene, common.sky_picture, common.input };
    output_file input;
    int i, k, status = DONE;
    if (common.store && targets[STORED].in_place)
        return fail("--store %s: it is a pipe or a device, not a file; give the name of a file", common.store);
    for (k = 0; k < target_count; k++)
        for (i = k + 1; i < target_count; i++)
            if (output_same(&targets[i], &targets[k]))
                return misuse("%s and %s are the same file; give %s another name", targets[i].name, targets[k].name,
                              k == STORED ? "--store" : k == STATISTICS ? "--stats" : "one of them");
    for (k = 0; k < 3 && status == DONE; k++) {
        if (!inputs[k] || !output_find(&input, inputs[k])) continue;
        for (i = 0; i < target_count && status == DONE; i++)
            if (output_same(&targets[i], &input))
                status = misuse("%s would overwrite the input file %s; give another name", targets[i].name, inputs[k]);
        output_free(&input);
    }
    for (i = 0; i < checked && status == DONE; i++)
        if (targets[i].name && (i != STORED || !targets__store_stays(given)) && !output_check(&targets[i]))
            status = fail("%s: cannot be written: %s; give another file name", targets[i].name, strerror(errno));
    return status;
}

/* Checks that no target is a file that the scene was read from, such as a texture. Returns the exit status. */
static int targets_check_read(const scene_file *file) {
    struct stat info;
    int i, k;
    for (i = 0; i < target_count; i++)
        for (k = 0; k < file->read_count && targets[i].path && stat(targets[i].path, &info) == 0; k++)
            if (file->read[k].device == info.st_dev && file->read[k].inode == info.st_ino)
                return misuse("%s would overwrite a file that %s reads; give another name", targets[i].name,
                    common.scene);
    return DONE;
}

/* Writes a target. Returns 1 on success. After a signal this fails, unless `late` is 1, which is for unfinished
   results. */
static int target_write(output_file *target, output_writer write, const void *what, int late) {
    return output_write(target, write, what, late ? NULL : &interrupted);
}

static const char *why_not_written(void) { return errno ? strerror(errno) : "the writer failed"; }

/* Reports a file that could not be written, because of an error or of a signal. Returns the exit status. */
static int fail_to_write(const char *name) {
    if (interrupted) return stop("%s was not written", name);
    return fail("%s: cannot be written: %s; free some space or give another file name", name, why_not_written());
}

/* ---- the task of a tool ---- */

typedef struct tool_task {
    const scene_file *file;
    const sbl_scene_desc *scene;  /* the scene of the file, with the sky and the arranger's additions */
    sbl_context *context;         /* has this scene set */
    messages *said;
    double start, load;           /* time when the tool started; seconds spent on reading files */
    const char *light;            /* describes the light added to a file without light; NULL: default sky */
    int unplaced;                 /* 1: the camera of the file is ignored, because its author never placed it */
    int makes_store;              /* 1: the file of --store has not been written yet */
    sbl_stats stats;              /* statistics of the work */
    int has_stats;                /* 1: the worker has filled in stats itself, because its work had several pieces */
} tool_task;

/* ---- statistics ---- */

typedef struct totals { const tool_task *task; double seconds; } totals;

static const char *name_of_mode(sbl_mode mode) {
    return mode == SBL_MODE_GI ? "gi" : mode == SBL_MODE_DIRECT ? "direct" : mode == SBL_MODE_PAPER ? "paper" :
        "ambient";
}

static int write_stats(FILE *out, const void *what) {
    const totals *all = (const totals *)what;
    const sbl_context *context = all->task->context;
    const sbl_stats s = all->task->stats;
    const sbl_capabilities capabilities = sbl_query_capabilities(context);
    const char *c;
    struct rusage self, child;
    int i;
    getrusage(RUSAGE_SELF, &self);
    getrusage(RUSAGE_CHILDREN, &child);  /* the process that read the scene; it ended before this process grew */
    if (child.ru_maxrss > self.ru_maxrss) self.ru_maxrss = child.ru_maxrss;
    fprintf(out, "{\n  \"version\": \"%s\",\n  \"renderer\": \"", sbl_version());
    for (c = capabilities.renderer; *c; c++) {
        if (*c == '"' || *c == '\\') fputc('\\', out);
        fputc((unsigned char)*c < 32 ? ' ' : *c, out);
    }
    fprintf(out, "\",\n  \"mode\": \"%s\",\n  \"size\": [%d, %d],\n  \"triangles\": %d,\n  \"lights\": %d,\n  "
        "\"visible_pixels\": %d,\n", name_of_mode(s.mode), s.picture.width,
            s.picture.height, s.scene.triangles, all->task->file->scene.light_count, s.picture.visible_pixels);
    if (s.picture.width)
        fprintf(out, "  \"mean\": [%.9g, %.9g, %.9g],\n", (double)s.picture.mean_radiance[0],
                (double)s.picture.mean_radiance[1], (double)s.picture.mean_radiance[2]);
    fprintf(out, "  \"backend\": \"%s\",\n", s.backend == SBL_BACKEND_TRACE ? "trace" : "raster");
    fprintf(out, "  \"error\": {\"asked\": %.6g, \"expected\": %.6g, \"radiance\": %.6g, \"specular\": %.6g, "
        "\"stored\": %.6g},\n", (double)s.picture.target_error, (double)s.picture.expected_error,
            (double)s.picture.radiance_error, (double)s.picture.specular_error, (double)s.picture.stored_error);
    if (s.lightmap.seams)
        fprintf(out, "  \"seams\": {\"edges\": %d, \"largest_before\": %.6g, \"largest_after\": %.6g},\n",
            s.lightmap.seams, (double)s.lightmap.seam_before,
                (double)s.lightmap.seam_after);
    fprintf(out, "  \"sensors\": %.0f,\n  \"sensor_views\": %.0f,\n  \"sensor_texels\": %.0f,\n  \"rays\": %.0f,\n  "
        "\"bounce_samples\": %d,\n  \"max_bounce_cells\": %d,\n  \"bounce_rays\": %.0f,\n"
            "  \"levels\": [",
            (double)s.sensors.sites, (double)s.sensors.views, (double)s.sensors.texels, (double)s.sensors.rays,
                s.store.cells, s.store.max_cells, (double)s.store.rays);
    for (i = 0; i < s.picture.level_count; i++)
        fprintf(out, "%s{\"tile\": %d, \"sensors\": %.0f}", i ? ", " : "", s.picture.levels[i].tile,
            (double)s.picture.levels[i].sensors);
    fprintf(out, "],\n  \"seconds\": {\"load\": %.6f, \"scene\": %.6f, \"surface\": %.6f, \"gather\": %.6f, "
        "\"bounce\": %.6f, ", all->task->load, s.seconds.scene,
            s.seconds.surface, s.seconds.gather, s.seconds.bounce);
    fprintf(out, "\"refine\": %.6f, \"filter\": %.6f, \"resolve\": %.6f, \"total\": %.6f},\n", s.seconds.refine,
        s.seconds.filter, s.seconds.resolve, all->seconds);
    fprintf(out, "  \"microseconds_per_sensor\": %.6f,\n  \"peak_gpu_bytes\": %.0f,\n  \"peak_host_bytes\": %.0f\n}\n",
            s.sensors.microseconds, (double)sbl_query_memory(context).gpu_peak_bytes, 1024.0 * (double)self.ru_maxrss);
    return 1;
}

/* Writes the file of --stats. Returns the exit status. */
static int keep_stats(const totals *all) {
    if (!interrupted && target_write(&targets[STATISTICS], write_stats, all, 0)) return DONE;
    return interrupted ? stop("%s is written, %s is not", common.output, common.stats) : fail_to_write(common.stats);
}

/* Sets the scene. Returns the exit status. */
static int set_scene(const tool_task *task) {
    const sbl_result result = sbl_set_scene(task->context, task->scene);
    return result == SBL_SUCCESS ? DONE : fail_with(task->said, common.scene, result);
}

/* ---- stored bounced light ---- */

/* State of the file of --store before the work. All fields are 0 if it did not exist. */
static struct stat store_before;

/* Loads the file of --store, or sets task->makes_store if the light must be computed and written to it. No file may be
   lost: a file that does not hold stored light is never replaced, and light of another scene only with --store-replace.
   Returns the exit status. */
static int load_store(tool_task *task, const int *given) {
    messages *said = task->said;
    const char *name = common.store;
    FILE *in = name ? input_open(name) : NULL;
    sbl_result result;
    task->makes_store = 0;
    if (!name) return DONE;
    if (!in && errno != ENOENT)
        return fail("--store %s: it cannot be read: %s; give the name of a file that can", name, scene__why());
    if (in) fstat(fileno(in), &store_before);
    task->makes_store = store_before.st_size == 0;
    if (task->makes_store) {
        if (in) fclose(in);
        return DONE;
    }
    said->store_item = SBL_LOG_ITEM_OK;
    result = sbl_load_store(task->context, get_bytes, in);
    if (ferror(in)) said->store_item = SBL_LOG_ITEM_INVALID_STORE;
    fclose(in);
    task->makes_store = given[STORE_REPLACE] && said->store_item != SBL_LOG_ITEM_OK;
    if (said->store_item == SBL_LOG_ITEM_INVALID_STORE)
        return fail("--store %s: %s; such a file is never replaced: give another FILE, or remove it", name,
                    said->store);
    if (result != SBL_SUCCESS && said->store_item != SBL_LOG_ITEM_OTHER_STORE) return fail_with(said, name, result);
    if (task->makes_store) {
        if (!given[QUIET]) tell("--store %s: %s; new light will replace it", name, said->store);
        /* the loaded light will not be used; setting the scene again discards it */
        return result == SBL_SUCCESS ? set_scene(task) : DONE;
    }
    if (result != SBL_SUCCESS)
        return fail("--store %s: %s; --store-replace replaces it, another FILE keeps it", name, said->store);
    if (said->store_item && !given[QUIET])
        warn("--store %s: %s; it is used as it is; --store-replace makes new light", name, said->store);
    return DONE;
}

/* Writes the file of --store if that is still to be done and no other program has written it since the work began.
   Returns the exit status. */
static int keep_store(tool_task *task, const int *given) {
    output_file *target = &targets[STORED];
    struct stat info;
    FILE *out;
    if (!task->makes_store) return DONE;
    task->makes_store = 0;
    if (stat(target->path, &info) != 0) memset(&info, 0, sizeof info);
    if (info.st_size && (info.st_dev != store_before.st_dev || info.st_ino != store_before.st_ino ||
                         info.st_size != store_before.st_size || info.st_mtime != store_before.st_mtime)) {
        if (!given[QUIET]) warn("--store %s: another program has written it meanwhile; it is kept", common.store);
        return DONE;
    }
    out = output_open(target);
    errno = 0;
    if (out && output_close(target, out, sbl_save_store(task->context, put_bytes, out) == SBL_SUCCESS, &interrupted))
        return DONE;
    return interrupted ? stop("%s is written, %s is not", common.output, common.store) : fail_to_write(common.store);
}


/* ---- choices and findings, for --verbose ---- */

static void detail_light(const sbl_scene_desc *scene) {
    const sbl_material *m;
    double triangles = 0;
    int i;
    for (i = 0; i < scene->mesh_count; i++) {
        m = &scene->materials[scene->meshes[i].material];
        if (m->emission[0] > 0 || m->emission[1] > 0 || m->emission[2] > 0)
            triangles += scene->meshes[i].index_count / 3;
    }
    if (common.sky_picture)
        detail("light: %.0f emitting triangles, %d lights, sky from %s", triangles, scene->light_count,
               common.sky_picture);
    else
        detail("light: %.0f emitting triangles, %d lights, sky %g,%g,%g", triangles, scene->light_count,
               (double)scene->sky[0], (double)scene->sky[1], (double)scene->sky[2]);
}

/* Prints the choices of the last work. */
static void detail_choices(const tool_task *task) {
    const sbl_stats s = task->stats;
    detail("mode: %s", name_of_mode(s.mode));
    if (s.picture.width)
        detail("size: %d x %d, %d with a surface, %.0f sensors", s.picture.width, s.picture.height,
               s.picture.visible_pixels, (double)s.sensors.sites);
    if (s.picture.target_error > 0)
        detail("target error: %.3g %%, predicted %.3g %%", 100 * (double)s.picture.target_error,
               100 * (double)s.picture.expected_error);
    if (s.picture.exposure != 0) detail("exposure: %.2f stops", (double)s.picture.exposure);
    detail("back end: %s", s.backend == SBL_BACKEND_TRACE ? "trace" : "raster");
    detail("OpenGL renderer: %s", sbl_query_capabilities(task->context).renderer);
}


/* ---- the order of the steps ---- */

/* Does the work of a tool. Returns the exit status. seconds: receives the time from the start to the result, for the
   statistics */
typedef int (*tool_worker)(tool_task *task, double *seconds);

/* Called after the scene is set; may change the scene and set it again. Returns the exit status. */
typedef int (*tool_arranger)(tool_task *task, sbl_scene_desc *scene);

static int tool__work(const scene_file *file, const scene_file *sky, tool_task *task, const int *given,
    tool_worker worker, tool_arranger arrange) {
    sbl_scene_desc scene = common_scene(file, sky, given);
    totals all = { task, 0 };
    int status, loaded;
    task->scene = &scene;
    status = set_scene(task);
    if (status == DONE && arrange) status = arrange(task, &scene);
    if (status == DONE && interrupted) return stop("no " TOOL_MAKES " was started");
    if (status == DONE) detail_light(&scene);
    if (status == DONE) status = load_store(task, given);
    loaded = common.store && !task->makes_store;
    if (status == DONE) status = worker(task, &all.seconds);
    if (!task->has_stats) task->stats = sbl_query_stats(task->context);
    if (status == DONE && loaded && task->stats.store.rays > 0 && !given[QUIET])
        warn("--store %s: its light was not used, because this work needs another number of cells", common.store);
    if (status == DONE) detail_choices(task);
    if (status == DONE && common.stats) status = keep_stats(&all);
    if (status == DONE) status = keep_store(task, given);
    return status;
}

static void tool__warn(const scene_file *file, const tool_task *task, const int *given) {
    const messages *said = task->said;
    char text[256];
    int i;
    scene_file_note_units(file, text, sizeof text);
    if (text[0] && !given[LIGHT_SCALE]) tell("%s: %s", common.scene, text);
    if (file->unit > 0 && fabs(file->unit - 1) > 1e-6)
        tell("%s: its unit is %g m: lengths and positions are converted to metres", common.scene, file->unit);
    if (without_effect[0]) warn("no effect: %s", without_effect);
    if (given[LIGHT_SCALE] && !file->scene.light_count)
        warn("no effect: --light-scale (the file has no lights; emission and sky are not scaled)");
    if (task->unplaced)
        tell("%s: the camera of the file is that of a new Blender file, and inside the model: another one is chosen; "
             "--eye X,Y,Z places it", common.scene);
    if (task->light)
        tell("%s: the file has no light: it is lit by %s; --sky R,G,B or --sky FILE gives it another light",
             common.scene, task->light);
    else if (lit_by_us(&file->scene, given))
        warn("%s: the scene emits no light; a constant sky of 1,1,1 lights it; --sky chooses another", common.scene);
    for (i = 0; i < file->warning_count && i < SCENE_FILE_WARNINGS; i++) warn("%s: %s", common.scene,
        file->warnings[i]);
    if (file->warning_count > SCENE_FILE_WARNINGS)
        warn("%s: and %d more warnings", common.scene, file->warning_count - SCENE_FILE_WARNINGS);
    for (i = 0; i < SCENE_FILE_KIND_COUNT; i++) {
        if (i == SCENE_FILE_CAMERA && !TOOL__HAS_CAMERA) continue;
        scene_file_warning(file, (scene_file_kind)i, text, sizeof text);
        if (text[0]) warn("%s: %s", common.scene, text);
    }
    for (i = 0; i < said->warnings_kept; i++) warn("%s: %s", common.scene, said->warnings[i]);
}

static sbl_context_desc tool_context_desc;  /* a tool with its own GL context fills this in before the work */

/* Reads the scene, calls the worker, writes statistics and stored light, and prints warnings. Returns the exit status.
   prepare: NULL, or a function that is called between reading the scene and the work; it may change the scene, and
   returns an exit status. arrange: NULL, or see tool_arranger */
static int tool_run(double start, const int *given, tool_worker worker, int (*prepare)(scene_file *file),
    tool_arranger arrange) {
    scene_file *file, *sky = NULL;
    messages said;
    tool_task task;
    char error[512];
    sbl_result result;
    int status = DONE;
    memset(&task, 0, sizeof task);
    memset(&said, 0, sizeof said);
    common.reading.cancel = &interrupted;
    verbose = given[VERBOSE];
    if (verbose) common.reading.log = on_confined;
    file = scene_file_load(common.scene, &common.reading, error, sizeof error);
    if (file && common.sky_picture) sky = scene_file_load_sky(common.sky_picture, &common.reading, error, sizeof error);
    if (file) scene_file_scale_lights(file, given[LIGHT_SCALE] ? common.light_scale : -1);
    task.file = said.file = file;
    task.said = &said;
    task.start = start;
    task.load = now() - start;
    if (interrupted) status = stop("no " TOOL_MAKES " was started");
    else if (!file || (common.sky_picture && !sky)) status = fail("%s", error);
    else if (!check_address_space()) status = fail("OpenGL: ulimit -v leaves less than 512 MB for the driver; raise "
        "the limit");
    if (status == DONE && prepare) status = prepare(file);
    if (status == DONE) status = targets_check_read(file);
    if (status == DONE) {
        tool_context_desc.logger.log = on_log;
        tool_context_desc.logger.user = &said;
        result = sbl_create(&tool_context_desc, &task.context);
        status = result == SBL_SUCCESS ? tool__work(file, sky, &task, given, worker, arrange)
                                       : fail_with(&said, "OpenGL", result);
        sbl_destroy(task.context);
        if (status == DONE && !given[QUIET]) tool__warn(file, &task, given);
    }
    scene_file_free(file);
    scene_file_free(sky);
    return status;
}

#endif
