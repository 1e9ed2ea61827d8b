/* Demonstrates a whole tool on top of sbl.h: reads a scene file, renders it and writes a picture and statistics. `sbl_render --help` says how. */
#define _DEFAULT_SOURCE
#define SBL_IMPLEMENTATION
#define SBL_EGL
#include "../sbl.h"
#include "output_file.h"
#include "scene_file.h"
#include "sensor_disc.h"
#include <ctype.h>
#include <sys/time.h>
#define STB_IMAGE_WRITE_IMPLEMENTATION
#include <stb/stb_image_write.h>
#ifdef SBL_RENDER_OPENEXR
  #include <openexr.h>
#endif

enum { DONE = 0, FAILED = 1, BAD_USAGE = 2, INTERRUPTED = 128 };  /* and the signal's number */

static volatile sig_atomic_t interrupted;  /* the signal's number */

/* Who asks twice is not made to wait. */
static void on_interrupt(int number) {
    if (interrupted) { output_abandon(); _exit(INTERRUPTED + number); }
    interrupted = number;
}

static void catch_signals(void) {
    static const int numbers[] = { SIGINT, SIGTERM, SIGHUP };
    struct sigaction action, before;
    int i, handle;
    memset(&action, 0, sizeof action);
    action.sa_handler = on_interrupt;
    sigfillset(&action.sa_mask);
    for (i = 0; i < 3; i++)  /* what nohup or the shell has it ignore stays ignored */
        if (sigaction(numbers[i], NULL, &before) == 0 && before.sa_handler != SIG_IGN)
            sigaction(numbers[i], &action, NULL);
    signal(SIGPIPE, SIG_IGN);  /* a closed pipe is a failed write, */
    signal(SIGXFSZ, SIG_IGN);  /* and so is a file that may not grow */
    do handle = open("/dev/null", O_RDWR);  /* closed ones are filled, or what is said goes into some file */
    while (handle >= 0 && handle <= STDERR_FILENO);
    if (handle >= 0) close(handle);
}

static double now(void) {
    struct timeval t;
    gettimeofday(&t, NULL);
    return (double)t.tv_sec + 1e-6 * (double)t.tv_usec;
}

/* ---- what is said: one line each, whatever the names of files and meshes hold ---- */

static void say(const char *kind, const char *format, va_list arguments) {
    char text[1024], *c;
    vsnprintf(text, sizeof text, format, arguments);
    for (c = text; *c; c++)
        if ((unsigned char)*c < 32 || *c == 127) *c = '?';
    fprintf(stderr, "sbl_render: %s%s\n", kind, text);
}

/* They return the exit status. */
static int fail(const char *format, ...) {
    va_list arguments;
    va_start(arguments, format);
    say("", format, arguments);
    va_end(arguments);
    return FAILED;
}
static int misuse(const char *format, ...) {
    va_list arguments;
    va_start(arguments, format);
    say("", format, arguments);
    va_end(arguments);
    return BAD_USAGE;
}

static int stop(const char *format, ...) {
    va_list arguments;
    va_start(arguments, format);
    say("interrupted; ", format, arguments);
    va_end(arguments);
    return INTERRUPTED + interrupted;
}

static void tell(const char *format, ...) {
    va_list arguments;
    va_start(arguments, format);
    say("", format, arguments);
    va_end(arguments);
}

static void warn(const char *format, ...) {
    va_list arguments;
    va_start(arguments, format);
    say("warning: ", format, arguments);
    va_end(arguments);
}

/* What sbl.h logs: the first error becomes the one line of a failure, warnings are shown when all went well. */
typedef struct messages {
    char error[640];
    int errors;
    char warnings[8][512];
    int warnings_kept;
    const scene_file *file;
} messages;

static void on_log(sbl_log_level level, sbl_log_item item, const char *message, void *user) {
    messages *m = (messages *)user;
    int mesh;
    (void)item;
    if (level == SBL_LOG_ERROR && m->errors++ == 0) {
        if (m->file && sscanf(message, "mesh %d:", &mesh) == 1 && mesh >= 0 && mesh < m->file->scene.mesh_count)
            snprintf(m->error, sizeof m->error, "%.500s (mesh %d is \"%.100s\")", message, mesh, m->file->names[mesh]);
        else snprintf(m->error, sizeof m->error, "%.600s", message);
    }
    if (level == SBL_LOG_WARNING && m->warnings_kept < 8) snprintf(m->warnings[m->warnings_kept++], sizeof m->warnings[0], "%.500s", message);
}

static int fail_with(const messages *m, const char *where, sbl_result result) {
    if (!m->errors) return fail("%s: %s", where, sbl_result_string(result));
    if (m->errors == 1) return fail("%s: %s", where, m->error);
    return fail("%s: %s, and %d mistakes more", where, m->error, m->errors - 1);
}

/* ---- the command line ---- */

static struct options {
    const char *scene, *output, *stats, *sky_picture, *store;
    int channel, mode, preset, backend;
    int size[2], inspect[2];
    double eye[3], look_at[3], up[3], fov, sky[3], sky_rotation, sky_scale, sky_up[3], epsilon, sensor_fov, error, threshold, facet_limit, exposure;
    int rays, bounce_samples, sensor_size, tile, filter_radius, samples, seed;
    scene_file_options reading;
} options = { .output = "sbl.png", .size = { 640, 480 }, .up = { 0, 1, 0 }, .fov = 40, .sky_scale = 1, .sky_up = { 0, 1, 0 }, .facet_limit = 2 };

typedef enum option_kind { FLAG, TEXT, CHOICE, INTEGERS, NUMBERS, LIST, BYTES } option_kind;

enum { CHANNEL_WORDS, MODE_WORDS, PRESET_WORDS, BACKEND_WORDS };
static const char *const words[][SBL_CHANNEL_COUNT + 1] = {
    { "final", "radiance", "albedo", "normal", "position", "id", "depth", "sensors", "store", "error", NULL },  /* as sbl_channel */
    { "gi", "ambient", "direct", "paper", NULL },
    { "draft", "default", "high", NULL },
    { "auto", "raster", "trace", NULL } };
static const sbl_mode modes[] = { SBL_MODE_GI, SBL_MODE_AMBIENT, SBL_MODE_DIRECT, SBL_MODE_PAPER };
static const sbl_backend backends[] = { SBL_BACKEND_AUTO, SBL_BACKEND_RASTER, SBL_BACKEND_TRACE };
static const sbl_preset presets[] = { SBL_PRESET_DRAFT, SBL_PRESET_DEFAULT, SBL_PRESET_HIGH };

enum {
    OUTPUT, CHANNEL, SIZE, EYE, LOOK_AT, UP, FOV, SKY, SKY_ROTATION, SKY_SCALE, SKY_UP, MODE, PRESET, ERROR, BACKEND, RAYS, BOUNCE_SAMPLES, EPSILON, SENSOR_SIZE, SENSOR_FOV, TILE, THRESHOLD, FACET_LIMIT,
    FILTER_RADIUS, SAMPLES, EXPOSURE, SEED, INSPECT, STATS, ALLOW_PATH, MEMORY, READ_TIME, STORE, QUIET, VERBOSE, HELP, VERSION, OPTION_COUNT
};

static const struct option {
    const char *name, *argument;
    option_kind kind;
    void *value;
    int count;         /* of numbers, or which words */
    double low, high;  /* of each number */
    const char *help;
} table[OPTION_COUNT] = {
    [OUTPUT]        = { "--output", "FILE", TEXT, &options.output, 0, 0, 0, "also -o; .png (8-bit sRGB), .pfm or .exr (linear float32); default sbl.png" },
    [CHANNEL]       = { "--channel", "NAME", CHOICE, &options.channel, CHANNEL_WORDS, 0, 0,
                        "final (default) | radiance (R: light without surface colour) | albedo | normal | position | id | depth |\n"
                        "sensors (which pixels had a sensor, by level) | store (what is kept of bounced light, cell by cell) |\n"
                        "error (how far radiance is predicted to be off: one standard deviation of its luminance)" },
    [SIZE]          = { "--size", "WxH", INTEGERS, options.size, 2, 1, 16384, "pixels; default 640x480" },
    [EYE]           = { "--eye", "X,Y,Z", NUMBERS, options.eye, 3, -1e18, 1e18, "where the camera stands" },
    [LOOK_AT]       = { "--look-at", "X,Y,Z", NUMBERS, options.look_at, 3, -1e18, 1e18, "what it looks at" },
    [UP]            = { "--up", "X,Y,Z", NUMBERS, options.up, 3, -1e18, 1e18, "what is up" },
    [FOV]           = { "--fov", "DEGREES", NUMBERS, &options.fov, 1, 1, 179, "vertical; the defaults of these four: the file's camera, else one that frames the scene" },
    [SKY]           = { "--sky", "R,G,B|FILE", NUMBERS, options.sky, 3, 0, 1e30,
                        "constant radiance of all that is not hit; default 0,0,0, or 1,1,1 where nothing else shines; or a picture of it\n"
                        "(FILE.hdr; .png, .jpg, ... are decoded from sRGB): equirectangular, its upper edge is straight up, its middle is +x" },
    [SKY_ROTATION]  = { "--sky-rotation", "DEGREES", NUMBERS, &options.sky_rotation, 1, -360, 360, "of the picture, counter-clockwise seen from above; default 0" },
    [SKY_SCALE]     = { "--sky-scale", "F", NUMBERS, &options.sky_scale, 1, 0, 1e30, "of the picture's light; default 1" },
    [SKY_UP]        = { "--sky-up", "X,Y,Z", NUMBERS, options.sky_up, 3, -1e18, 1e18, "what is up in the picture; default 0,1,0" },
    [MODE]          = { "--mode", "NAME", CHOICE, &options.mode, MODE_WORDS, 0, 0,
                        "gi (default: lamps, sky, and what all surfaces reflect, to the last bounce) | direct (lamps and sky only) |\n"
                        "ambient (direct, and a faint glow of every surface) | paper (exactly the paper: one 135 degree view,\n"
                        "epsilon, tiles, Gaussian)" },
    [PRESET]        = { "--preset", "NAME", CHOICE, &options.preset, PRESET_WORDS, 0, 0, "draft | default | high" },
    [BACKEND]       = { "--backend", "NAME", CHOICE, &options.backend, BACKEND_WORDS, 0, 0, "auto (default: trace; raster in mode paper) | raster | trace" },
    [ERROR]         = { "--error", "E", NUMBERS, &options.error, 1, 0.0001, 1,
                        "how far radiance may be off, such as 2% or 0.02: root mean square over the picture, as a share of its mean;\n"
                        "default 5%, 1.5%, 0.75% by preset, or what 512 rays a sensor give (high: 1024)" },
    [RAYS]          = { "--rays", "N", INTEGERS, &options.rays, 1, 1, 4096, "samples of a traced sensor, the same for all; default: as many as the error takes" },
    [BOUNCE_SAMPLES] = { "--bounce-samples", "N", INTEGERS, &options.bounce_samples, 1, 1024, 1048576,
                         "places that bounced light is stored for, in mode gi, at most: more where light comes through gaps or geometry\n"
                         "is fine; about 4 KB of memory each; default 49152" },
    [EPSILON]       = { "--epsilon", "E", NUMBERS, &options.epsilon, 1, 0, 1e30, "ambient factor of the modes paper and ambient; default 0.02" },
    [SENSOR_SIZE]   = { "--sensor-size", "N", INTEGERS, &options.sensor_size, 1, 4, 512, "texels across a sensor's view; default 32, 64, 128 by preset" },
    [SENSOR_FOV]    = { "--sensor-fov", "DEGREES", NUMBERS, &options.sensor_fov, 1, 1, 179, "mode paper only; default 135" },
    [TILE]          = { "--tile", "N", INTEGERS, &options.tile, 1, 1, 1024, "first distance between sensors in pixels, 1 senses every pixel; default 16" },
    [THRESHOLD]     = { "--threshold", "T", NUMBERS, &options.threshold, 1, 0, 1e30,
                        "refine where neighbours differ by more, instead of where the error says: a share of their mean;\n"
                        "in mode paper a radiance, default 0.05" },
    [FACET_LIMIT]   = { "--facet-limit", "PIXELS", NUMBERS, &options.facet_limit, 1, 0, 1e30,
                        "triangles of smaller height are lit by their true normals, larger ones by the file's; default 2" },
    [FILTER_RADIUS] = { "--filter-radius", "N", INTEGERS, &options.filter_radius, 1, 0, 32, "of the Gaussian, pixels, 0 for none; default 2" },
    [SAMPLES]       = { "--samples", "N", INTEGERS, &options.samples, 1, 1, 64, "anti-aliasing of final, samples a pixel; default 1, 4, 16 by preset" },
    [EXPOSURE]      = { "--exposure", "STOPS", NUMBERS, &options.exposure, 1, -100, 100, "brightens final and radiance in a .png; default 0" },
    [SEED]          = { "--seed", "N", INTEGERS, &options.seed, 1, 0, INT_MAX, "of the sensors' rotations; default 0" },
    [INSPECT]       = { "--inspect", "X,Y", INTEGERS, options.inspect, 2, 0, 16383,
                        "writes what the sensor of that pixel sees instead of the picture, and prints its sums" },
    [STORE]         = { "--store", "FILE", TEXT, &options.store, 0, 0, 0,
                        "bounced light is loaded from there where it fits the scene, else made and saved there; --mode gi" },
    [STATS]         = { "--stats", "FILE", TEXT, &options.stats, 0, 0, 0, "counts, seconds (total: from start to picture) and peak memory as JSON" },
    [ALLOW_PATH]    = { "--allow-path", "DIR", LIST, options.reading.allow, SCENE_FILE_FOLDERS, 0, 0,
                        "the scene may name files beneath it, besides those beneath its own folder; may be given several times" },
    [MEMORY]        = { "--memory", "SIZE", BYTES, &options.reading.memory, 1, 16.0 * (1 << 20), 1024.0 * (1 << 30) * 1024,
                        "what the scene may take, such as 512M or 4G; default half of the machine's memory, or of what its control\n"
                        "group has; never more than half of what ulimit -v leaves" },
    [READ_TIME]     = { "--read-time", "SECONDS", NUMBERS, &options.reading.seconds, 1, 0.1, 1e6, "what reading the scene may take; default 60" },
    [QUIET]         = { "--quiet", NULL, FLAG, NULL, 0, 0, 0, "no progress bar, no warnings" },
    [VERBOSE]       = { "--verbose", NULL, FLAG, NULL, 0, 0, 0, "tells how far the kernel confines the process that reads files" },
    [HELP]          = { "--help", NULL, FLAG, NULL, 0, 0, 0, "this text" },
    [VERSION]       = { "--version", NULL, FLAG, NULL, 0, 0, 0, "the version" },
};
static int given[OPTION_COUNT];

static void print_help(void) {
    const char *line;
    int i;
    printf("usage: sbl_render SCENE [options]\n\n"
           "Renders a scene file by sensor based lighting.\n"
           "SCENE: .obj .gltf .glb, and what else assimp reads (.fbx, .ply, ...)\n\n");
    for (i = 0; i < OPTION_COUNT; i++) {
        int width = printf("  %s%s%s", table[i].name, table[i].argument ? " " : "", table[i].argument ? table[i].argument : "");
        for (line = table[i].help; line; line = strchr(line, '\n') ? strchr(line, '\n') + 1 : NULL) {
            printf("%*s%.*s\n", 26 - width, "", (int)strcspn(line, "\n"), line);
            width = 0;
        }
    }
    printf("\nMaterials: OBJ Kd map_Kd Ke map_Ke d map_d (cutout at 0.5); glTF base colour, emission with KHR_materials_emissive_strength,\n"
           "alphaMode MASK (BLEND as a cutout at 0.5). Metal and gloss are read as their base colour. A surface emits to both sides.\n"
           "Lights: glTF KHR_lights_punctual (candela and lux are radiance times area and irradiance here; ranges are left out), and the\n"
           "point, spot and directional lights of other formats.\n"
           "In a .png a normal is 0.5 + 0.5 n, a position is relative to what is visible, near is light in a depth, ids are random\n"
           "colours, and sensors run from blue (first level) over green and yellow to red (last). In .pfm and .exr all values are raw.\n"
           "\nA file is written whole or not at all: the new one takes its name at the end, and the permissions of the old one.\n"
           "A symbolic link stays, and what it leads to is replaced; where a file has other names (hard links), these keep the\n"
           "old picture. What is read cannot be overwritten. Ctrl-C, SIGTERM and SIGHUP leave the picture so far, if there is\n"
           "anything to be seen yet, in NAME.partial.png (.pfm, .exr); a second one ends at once.\n"
           "\nExit status: 0 done; 1 failed, with one line on stderr; 2 bad usage; interrupted: 130 by SIGINT, 143 by SIGTERM,\n"
           "129 by SIGHUP.\n");
}

/* count numbers, separated by commas or, for a size, by an x; 0 where the text is anything else. */
static int parse_numbers(const struct option *o, const char *text) {
    double numbers[3];
    char *end;
    int i;
    for (i = 0; i < o->count; i++) {
        if (i && *text++ != (o == &table[SIZE] ? 'x' : ',')) return 0;
        if (!*text || strchr(" \t\n\v\f\r", *text)) return 0;
        if (o->kind == INTEGERS) {
            size_t digits = strspn(text, "0123456789");
            if (!digits || digits > 10) return 0;
            for (numbers[i] = 0; digits > 0; digits--) numbers[i] = 10 * numbers[i] + (*text++ - '0');
        } else {
            numbers[i] = strtod(text, &end);
            if (end == text) return 0;
            text = end;
            if (o == &table[ERROR] && *text == '%') { numbers[i] /= 100; text++; }
        }
        if (!(numbers[i] >= o->low && numbers[i] <= o->high)) return 0;
    }
    if (*text) return 0;
    for (i = 0; i < o->count; i++) {
        if (o->kind == INTEGERS) ((int *)o->value)[i] = (int)numbers[i];
        else ((double *)o->value)[i] = numbers[i];
    }
    return 1;
}

/* A number and K, M, G, T or nothing. */
static int parse_bytes(const struct option *o, const char *text) {
    static const char units[] = "KMGT";
    char *end;
    const double number = isdigit((unsigned char)*text) ? strtod(text, &end) : -1;
    const char *unit = number >= 0 && *end ? strchr(units, toupper((unsigned char)*end)) : NULL;
    const double bytes = number * (unit ? pow(1024, (double)(unit - units) + 1) : 1);
    if (number < 0 || (*end && (!unit || end[1])) || !(bytes >= o->low && bytes <= o->high)) return 0;
    *(size_t *)o->value = bytes < (double)SIZE_MAX ? (size_t)bytes : SIZE_MAX;
    return 1;
}

static int ends_with(const char *path, const char *ending) { return scene__ends_with(path, ending); }

/* It has an ending: a point and a letter, no comma after them. Numbers have not, but for 1.e5 and the like. */
static int names_a_file(const char *text) {
    const char *point = strrchr(text, '.');
    return point && isalpha((unsigned char)point[1]) && !strchr(point, ',') && !(strchr("eE", point[1]) && !isalpha((unsigned char)point[2]));
}

static int parse(int argc, char **argv) {
    int i, k, only_files = 0;
    for (i = 1; i < argc; i++) {
        const char *argument = argv[i], *value = strchr(argument, '='), *name = argument;
        const struct option *o = NULL;
        if (only_files || argument[0] != '-' || !argument[1]) {
            if (options.scene) return misuse("two scenes, %s and %s; give one", options.scene, argument);
            options.scene = argument;
            continue;
        }
        if (strcmp(argument, "--") == 0) { only_files = 1; continue; }
        if (strcmp(argument, "-o") == 0) name = "--output";
        if (strcmp(argument, "-h") == 0) name = "--help";
        for (k = 0; k < OPTION_COUNT && !o; k++)
            if (strcmp(name, table[k].name) == 0 ||
                (value && strlen(table[k].name) == (size_t)(value - name) && strncmp(name, table[k].name, (size_t)(value - name)) == 0))
                o = &table[k];
        if (!o) return misuse("there is no option %s; see --help", argument);
        given[o - table] = 1;
        if (o->kind == FLAG) {
            if (value) return misuse("%s takes no value", o->name);
            continue;
        }
        if (value && name == argument) value++;
        else if (i + 1 < argc) value = argv[++i];
        else return misuse("%s needs a value: %s", o->name, o->argument);
        if (o->kind == TEXT) *(const char **)o->value = value;
        else if (o->kind == LIST) {
            for (k = 0; k < o->count && ((const char **)o->value)[k]; k++) continue;
            if (k == o->count) return misuse("%s %s: it may be given %d times", o->name, value, k);
            ((const char **)o->value)[k] = value;
        } else if (o->kind == BYTES) {
            if (!parse_bytes(o, value)) return misuse("%s %s: it must be a number from 16M to 1024T, such as 512M or 4G", o->name, value);
        }
        else if (o->kind == CHOICE) {
            for (k = 0; words[o->count][k] && strcmp(words[o->count][k], value) != 0; k++) continue;
            if (!words[o->count][k]) {
                char list[256] = "";
                for (k = 0; words[o->count][k]; k++) sprintf(list + strlen(list), " %s", words[o->count][k]);
                return misuse("%s %s: it must be one of%s", o->name, value, list);
            }
            *(int *)o->value = k;
        } else if (o == &table[SKY] && names_a_file(value)) options.sky_picture = value;
        else if (parse_numbers(o, value)) {
            if (o == &table[SKY]) options.sky_picture = NULL;  /* the last one counts */
        } else
            return misuse("%s %s: it must be %s with %s from %g to %g", o->name, value, o->argument,
                          o->kind == INTEGERS ? "whole numbers" : "numbers", o->low, o->high);
    }
    if (given[HELP] || given[VERSION]) return DONE;
    if (!options.scene) return misuse("usage: sbl_render SCENE [options]; see --help");
    if (!ends_with(options.output, ".png") && !ends_with(options.output, ".pfm") && !ends_with(options.output, ".exr"))
        return misuse("--output %s: the name must end in .png, .pfm or .exr", options.output);
#ifndef SBL_RENDER_OPENEXR
    if (ends_with(options.output, ".exr")) return fail("--output %s: built without OpenEXR; write a .pfm", options.output);
#endif
    if (given[STORE] && given[MODE] && modes[options.mode] != SBL_MODE_GI)
        return misuse("--store needs --mode gi: other modes have no light that bounces");
    if (given[SENSOR_FOV] && (!given[MODE] || modes[options.mode] != SBL_MODE_PAPER))
        return misuse("--sensor-fov needs --mode paper: other sensors see the whole hemisphere");
    if (given[EPSILON] && (!given[MODE] || modes[options.mode] == SBL_MODE_GI || modes[options.mode] == SBL_MODE_DIRECT))
        return misuse("--epsilon needs --mode ambient or paper: the other modes have no ambient factor");
    if (options.sky_picture && given[MODE] && modes[options.mode] == SBL_MODE_PAPER)
        return misuse("--sky %s: --mode paper has no sky pictures; give a colour or choose another --mode", options.sky_picture);
    if (!options.sky_picture && (given[SKY_ROTATION] || given[SKY_SCALE] || given[SKY_UP]))
        return misuse("--sky-rotation, --sky-scale, --sky-up: they need --sky with a picture");
    if (options.sky_up[0] == 0.0 && options.sky_up[1] == 0.0 && options.sky_up[2] == 0.0) return misuse("--sky-up: it must not be 0,0,0");
    if (given[INSPECT] && given[CHANNEL]) return misuse("--inspect writes a sensor's view, --channel chooses a picture; give one of them");
    if (strcmp(words[BACKEND_WORDS][options.backend], "trace") == 0 && given[MODE] && modes[options.mode] == SBL_MODE_PAPER)
        return misuse("--backend trace: the paper's sensor rasterises; leave it out or choose another --mode");
    return DONE;
}

/* ---- the camera ---- */

static void place_camera(sbl_picture_desc *desc, const sbl_context *context, const scene_file *file) {
    static const double from[3] = { 0.35, 0.3, 0.89 };  /* unit: the front, a little to the right and above */
    const double radians = atan(1.0) / 45, aspect = (double)options.size[0] / options.size[1];
    const scene_file_camera *c = &file->camera;
    double eye[3], at[3], to[3], up[3], fov = options.fov, half, distance = 0;
    float lowest[3], highest[3];
    int i, use_file = file->has_camera;
    if (use_file) {  /* a damaged one is as good as none */
        float unused[16];
        fov = (double)c->fov_y;
        if (c->fov_x > 0 && c->fov_x < 179) fov = 2 * atan(tan(0.5 * (double)c->fov_x * radians) / aspect) / radians;
        use_file = fov >= 1 && fov <= 179 &&
                   sbl_look_at(unused, 0, 0, 0, c->forward[0], c->forward[1], c->forward[2], c->up[0], c->up[1], c->up[2]);
        for (i = 0; i < 3; i++) use_file = use_file && fabs((double)c->eye[i]) < 1e18;
    }
    if (!use_file || given[FOV]) fov = options.fov;
    sbl_query_bounds(context, lowest, highest);
    for (i = 0; i < 3; i++) {
        at[i] = 0.5 * ((double)lowest[i] + (double)highest[i]);
        distance += 0.25 * pow((double)highest[i] - (double)lowest[i], 2);
    }
    half = 0.5 * fov * radians;
    if (aspect < 1) half = atan(tan(half) * aspect);
    distance = (distance > 0 ? sqrt(distance) : 1) / sin(half);
    for (i = 0; i < 3; i++) {
        double forward = use_file ? (double)c->forward[i] : -from[i];
        if (given[LOOK_AT]) at[i] = options.look_at[i];
        eye[i] = given[EYE] ? options.eye[i] : use_file ? (double)c->eye[i] : at[i] + distance * from[i];
        if (use_file && !given[LOOK_AT]) at[i] = eye[i] + forward;
        up[i] = use_file && !given[UP] ? (double)c->up[i] : options.up[i];
    }
    for (i = 0; i < 3; i++) at[i] -= eye[i];  /* from here on: the direction */
    if (!given[LOOK_AT] && at[0] == 0.0 && at[1] == 0.0 && at[2] == 0.0) at[2] = -1;  /* the eye stands in the centre */
    if (!given[UP] && at[0] == 0.0 && at[2] == 0.0) { up[0] = up[1] = 0; up[2] = at[1] < 0 ? -1 : 1; }
    /* As long as the eye is far from the origin, or rounding to float turns the camera. */
    distance = sqrt(at[0] * at[0] + at[1] * at[1] + at[2] * at[2]);
    for (i = 0; i < 3; i++)
        to[i] = eye[i] + (distance > 0 ? at[i] / distance * (1 + fabs(eye[0]) + fabs(eye[1]) + fabs(eye[2])) : 0);
    if (!sbl_look_at(desc->world_to_view, (float)eye[0], (float)eye[1], (float)eye[2], (float)to[0], (float)to[1], (float)to[2],
                     (float)up[0], (float)up[1], (float)up[2]))
        memset(desc->world_to_view, 0, sizeof desc->world_to_view);
    sbl_perspective(desc->view_to_clip, (float)fov, (float)aspect);
}

/* ---- progress ---- */

typedef struct progress { int shown; double start, last; } progress;

static int on_progress(float done, void *user) {
    progress *p = (progress *)user;
    double time = now();
    if (p->shown && (p->last <= 0 || time - p->last > 0.1)) {
        double left = done > 0.01f ? (time - p->start) * (1 - (double)done) / (double)done : -1;
        char bar[41];
        int i;
        for (i = 0; i < 40; i++) bar[i] = (float)i < 40 * done ? '#' : '.';
        bar[40] = 0;
        fprintf(stderr, "\r[%s] %3d %%", bar, (int)(100 * done));
        if (left >= 0) fprintf(stderr, "  %d:%02d left ", (int)left / 60, (int)left % 60);
        fflush(stderr);
        p->last = time;
    }
    return 0;  /* cancelling would lose the picture so far */
}

/* ---- pictures ---- */

typedef struct image { int width, height, components; float *values; } image;  /* top row first */

static unsigned char to_byte(double x) { return (unsigned char)(255 * (x > 0 ? x < 1 ? x : 1 : 0) + 0.5); }  /* 0 for NaN */

static void hue(double h, unsigned char *out) {
    int k;
    for (k = 0; k < 3; k++) out[k] = to_byte(fabs(fmod(h * 6 + 4 * ((k * 2) % 3) / 2.0, 6) - 3) - 1);  /* h in 0..1: red, green, blue, red */
}

/* The picture's three bytes a pixel; each channel so that its values can be told apart. */
static unsigned char *make_visible(const image *in, sbl_channel channel) {
    const size_t pixels = (size_t)in->width * (size_t)in->height;
    const int n = in->components;
    const float exposure = (float)pow(2, options.exposure);
    unsigned char *out = (unsigned char *)malloc(pixels * 3);
    double low[3] = { 1e30, 1e30, 1e30 }, high[3] = { -1e30, -1e30, -1e30 };
    size_t i;
    int k;
    if (!out) return NULL;
    for (i = 0; i < pixels; i++) {  /* where there is a surface: extent of positions, depths and levels */
        const float *v = in->values + i * (size_t)n;
        int surface = 0;
        for (k = 0; k < n; k++) surface |= v[k] != 0.0f;
        for (k = 0; k < n && surface; k++) {
            if ((double)v[k] < low[k]) low[k] = (double)v[k];
            if ((double)v[k] > high[k]) high[k] = (double)v[k];
        }
    }
    for (i = 0; i < pixels; i++) {
        const float *v = in->values + i * (size_t)n;
        unsigned char *to = out + 3 * i;
        int surface = 0;
        for (k = 0; k < n; k++) surface |= v[k] != 0.0f;
        for (k = 0; k < 3; k++) {
            double x = (double)v[n == 3 ? k : 0];
            int c = n == 3 ? k : 0;
            switch (channel) {
                case SBL_CHANNEL_FINAL: case SBL_CHANNEL_RADIANCE: case SBL_CHANNEL_STORE: case SBL_CHANNEL_ERROR:
                    sbl_encode_srgb8(to + k, v + c, 1, exposure);
                    break;
                case SBL_CHANNEL_ALBEDO: sbl_encode_srgb8(to + k, v + c, 1, 1); break;
                case SBL_CHANNEL_NORMAL: to[k] = surface ? to_byte(0.5 + 0.5 * x) : 0; break;
                case SBL_CHANNEL_POSITION: to[k] = surface ? to_byte(high[c] > low[c] ? (x - low[c]) / (high[c] - low[c]) : 0.5) : 0; break;
                case SBL_CHANNEL_DEPTH:
                    to[k] = surface ? to_byte(high[0] > low[0] ? 1 - 0.9 * (x - low[0]) / (high[0] - low[0]) : 1) : 0;
                    break;
                default: to[k] = 0; break;
            }
        }
        /* Golden ratio steps keep neighbouring ids apart. */
        if (channel == SBL_CHANNEL_ID && surface) hue(fmod((double)v[0] * 0.6180339887498949, 1), to);
        if (channel == SBL_CHANNEL_SENSORS && surface) hue(high[0] > 1 ? (1 - ((double)v[0] - 1) / (high[0] - 1)) * 2 / 3 : 2.0 / 3, to);
    }
    return out;
}

static void write_bytes(void *user, void *data, int size) { fwrite(data, 1, (size_t)size, (FILE *)user); }

/* The writers return 0 where they fail for another reason than the file's; errno says why, where it is not 0. */
static int write_png(FILE *out, const image *picture, sbl_channel channel) {
    unsigned char *bytes = make_visible(picture, channel);
    const int width = picture->width;
    int ok = bytes && stbi_write_png_to_func(write_bytes, out, width, picture->height, 3, bytes, 3 * width);
    free(bytes);
    return ok;
}

static int write_pfm(FILE *out, const image *picture) {
    int x, y, k;
    fprintf(out, "PF\n%d %d\n-1.0\n", picture->width, picture->height);  /* negative: little-endian */
    for (y = picture->height - 1; y >= 0; y--)  /* bottom row first */
        for (x = 0; x < picture->width; x++) {
            const float *v = picture->values + ((size_t)y * (size_t)picture->width + (size_t)x) * (size_t)picture->components;
            unsigned char bytes[12];
            for (k = 0; k < 3; k++) {
                uint32_t bits;
                int b;
                memcpy(&bits, &v[picture->components == 3 ? k : 0], 4);
                for (b = 0; b < 4; b++) bytes[4 * k + b] = (unsigned char)(bits >> 8 * b & 255);
            }
            fwrite(bytes, 1, sizeof bytes, out);
        }
    return 1;
}

#ifdef SBL_RENDER_OPENEXR
static void on_exr_error(exr_const_context_t context, exr_result_t code, const char *message) { (void)context; (void)code; (void)message; }

/* OpenEXR comes back to what it wrote. */
static int64_t write_exr_bytes(exr_const_context_t context, void *user, const void *data, uint64_t size,
                               uint64_t offset, exr_stream_error_func_ptr_t error) {
    uint64_t done;
    ssize_t n;
    (void)context; (void)error;
    for (done = 0; done < size; done += (uint64_t)n) {
        n = pwrite(fileno((FILE *)user), (const char *)data + done, (size_t)(size - done), (off_t)(offset + done));
        if (n < 0 && errno == EINTR) n = 0;
        if (n < 0) return -1;
    }
    return (int64_t)size;
}

static int write_exr(FILE *out, const image *picture) {
    static const char *const names[2][3] = { { "Y", NULL, NULL }, { "R", "G", "B" } };
    exr_context_initializer_t settings = EXR_DEFAULT_CONTEXT_INITIALIZER;
    exr_context_t context = NULL;
    exr_encode_pipeline_t encoder;
    exr_chunk_info_t chunk;
    int part, y, k, begun = 0;
    int32_t rows = 1;
    exr_result_t result;
    settings.error_handler_fn = on_exr_error;
    settings.write_fn = write_exr_bytes;
    settings.user_data = out;
    result = exr_start_write(&context, options.output, EXR_WRITE_FILE_DIRECTLY, &settings);
    if (result == EXR_ERR_SUCCESS) result = exr_add_part(context, "picture", EXR_STORAGE_SCANLINE, &part);
    if (result == EXR_ERR_SUCCESS)
        result = exr_initialize_required_attr_simple(context, part, picture->width, picture->height, EXR_COMPRESSION_ZIP);
    for (k = 0; k < picture->components && result == EXR_ERR_SUCCESS; k++)
        result = exr_add_channel(context, part, names[picture->components == 3][k], EXR_PIXEL_FLOAT, EXR_PERCEPTUALLY_LINEAR, 1, 1);
    if (result == EXR_ERR_SUCCESS) result = exr_write_header(context);
    if (result == EXR_ERR_SUCCESS) result = exr_get_scanlines_per_chunk(context, part, &rows);
    for (y = 0; y < picture->height && result == EXR_ERR_SUCCESS; y += rows) {
        result = exr_write_scanline_chunk_info(context, part, y, &chunk);
        if (result == EXR_ERR_SUCCESS)
            result =
                begun ? exr_encoding_update(context, part, &chunk, &encoder) : exr_encoding_initialize(context, part, &chunk, &encoder);
        for (k = 0; k < picture->components && result == EXR_ERR_SUCCESS; k++) {
            exr_coding_channel_info_t *channel = &encoder.channels[k];  /* in the order of their names */
            int component = channel->channel_name[0] == 'G' ? 1 : channel->channel_name[0] == 'B' ? 2 : 0;
            channel->encode_from_ptr =
                (const uint8_t *)(picture->values + (size_t)y * (size_t)picture->width * (size_t)picture->components + component);
            channel->user_bytes_per_element = 4;
            channel->user_data_type = EXR_PIXEL_FLOAT;
            channel->user_pixel_stride = 4 * picture->components;
            channel->user_line_stride = 4 * picture->components * picture->width;
        }
        if (result == EXR_ERR_SUCCESS && !begun) result = exr_encoding_choose_default_routines(context, part, &encoder);
        begun = 1;
        if (result == EXR_ERR_SUCCESS) result = exr_encoding_run(context, part, &encoder);
    }
    if (begun) exr_encoding_destroy(context, &encoder);
    if (context && exr_finish(&context) != EXR_ERR_SUCCESS && result == EXR_ERR_SUCCESS) result = EXR_ERR_WRITE_IO;
    return result == EXR_ERR_SUCCESS;
}
#endif

static int write_picture(FILE *out, const image *picture, sbl_channel channel) {
    if (ends_with(options.output, ".png")) return write_png(out, picture, channel);
#ifdef SBL_RENDER_OPENEXR
    if (ends_with(options.output, ".exr")) return write_exr(out, picture);
#endif
    return write_pfm(out, picture);
}

/* ---- statistics ---- */

typedef struct totals { int lights; double load, seconds; } totals;

static int write_stats(FILE *out, const sbl_context *context, const totals *all) {
    const sbl_stats s = sbl_query_stats(context);
    const sbl_capabilities capabilities = sbl_query_capabilities(context);
    const char *c, *mode;
    struct rusage self, child;
    int i;
    getrusage(RUSAGE_SELF, &self);
    getrusage(RUSAGE_CHILDREN, &child);  /* the one that read the scene; it was gone before this one grew */
    if (child.ru_maxrss > self.ru_maxrss) self.ru_maxrss = child.ru_maxrss;
    fprintf(out, "{\n  \"version\": \"%s\",\n  \"renderer\": \"", sbl_version());
    for (c = capabilities.renderer; *c; c++) {
        if (*c == '"' || *c == '\\') fputc('\\', out);
        fputc((unsigned char)*c < 32 ? ' ' : *c, out);
    }
    mode = s.mode == SBL_MODE_GI ? "gi" : s.mode == SBL_MODE_DIRECT ? "direct" : s.mode == SBL_MODE_PAPER ? "paper" : "ambient";
    fprintf(out, "\",\n  \"mode\": \"%s\",\n  \"size\": [%d, %d],\n  \"triangles\": %d,\n  \"lights\": %d,\n  \"visible_pixels\": %d,\n", mode, s.width,
            s.height, s.triangles, all->lights, s.visible_pixels);
    fprintf(out, "  \"backend\": \"%s\",\n", s.backend == SBL_BACKEND_TRACE ? "trace" : "raster");
    fprintf(out, "  \"error\": {\"asked\": %.6g, \"expected\": %.6g},\n", (double)s.error_asked, (double)s.error_expected);
    fprintf(out, "  \"sensors\": %.0f,\n  \"sensor_views\": %.0f,\n  \"sensor_texels\": %.0f,\n  \"rays\": %.0f,\n  \"bounce_samples\": %d,\n  \"bounce_rays\": %.0f,\n"
            "  \"levels\": [",
            (double)s.sensors, (double)s.sensor_views, (double)s.sensor_texels, (double)s.rays, s.bounce_samples, (double)s.bounce_rays);
    for (i = 0; i < s.level_count; i++)
        fprintf(out, "%s{\"tile\": %d, \"sensors\": %.0f}", i ? ", " : "", s.levels[i].tile, (double)s.levels[i].sensors);
    fprintf(out, "],\n  \"seconds\": {\"load\": %.6f, \"scene\": %.6f, \"surface\": %.6f, \"gather\": %.6f, \"bounce\": %.6f, ", all->load, s.seconds.scene,
            s.seconds.surface, s.seconds.gather, s.seconds.bounce);
    fprintf(out, "\"refine\": %.6f, \"filter\": %.6f, \"resolve\": %.6f, \"total\": %.6f},\n", s.seconds.refine, s.seconds.filter, s.seconds.resolve, all->seconds);
    fprintf(out, "  \"microseconds_per_sensor\": %.6f,\n  \"peak_gpu_bytes\": %.0f,\n  \"peak_host_bytes\": %.0f\n}\n",
            s.microseconds_per_sensor, (double)sbl_query_memory(context).gpu_peak_bytes, 1024.0 * (double)self.ru_maxrss);
    return 1;
}

/* ---- what is written ---- */

static output_file targets[4];
enum { PICTURE, PARTIAL, STATISTICS, STORED, TARGETS };  /* partial: the best so far of an interrupted picture, room.partial.png */

/* Returns the exit status. */
static int find_targets(void) {
    static char partial[PATH_MAX];
    const char *ending = strrchr(options.output, '.');
    const char *const inputs[2] = { options.scene, options.sky_picture };
    output_file input;
    int i, k, status = DONE;
    snprintf(partial, sizeof partial, "%.*s.partial%s", (int)(ending - options.output), options.output, ending);
    output_find(&targets[PICTURE], options.output);
    output_find(&targets[PARTIAL], partial);
    if (options.stats) output_find(&targets[STATISTICS], options.stats);
    if (options.store) output_find(&targets[STORED], options.store);
    for (i = 0; i < TARGETS; i++)
        for (k = i + 1; k < TARGETS; k++)
            if (output_same(&targets[i], &targets[k]))
                return misuse("%s and %s are one file; give %s another name", targets[i].name, targets[k].name,
                              k == STORED ? "--store" : "--stats");
    for (k = 0; k < 2 && status == DONE; k++) {
        if (!inputs[k] || !output_find(&input, inputs[k])) continue;
        for (i = 0; i < TARGETS && status == DONE; i++)
            if (output_same(&targets[i], &input))
                status = misuse("%s would overwrite %s, which is read; give another name", targets[i].name, inputs[k]);
        output_free(&input);
    }
    for (i = 0; i < TARGETS && status == DONE; i++)
        if (i != PARTIAL && targets[i].name && !output_check(&targets[i]))
            status = fail("%s: cannot be written: %s; give another file name", targets[i].name, strerror(errno));
    return status;
}

/* What the scene's reader has opened besides is known once it has ended. */
static int check_overwriting(const scene_file *file) {
    struct stat info;
    int i, k;
    for (i = 0; i < TARGETS; i++)
        for (k = 0; k < file->read_count && targets[i].path && stat(targets[i].path, &info) == 0; k++)
            if (file->read[k].device == info.st_dev && file->read[k].inode == info.st_ino)
                return misuse("%s would overwrite a file that %s reads; give another name", targets[i].name,
                              options.scene);
    return DONE;
}

/* picture NULL: the statistics. 0: nothing is written; also after an interrupt, but for what it makes us write. */
static int write_whole(output_file *target, const image *picture, sbl_channel channel, const sbl_context *context,
                       const totals *all) {
    FILE *out = output_open(target);
    int ok;
    if (!out) return 0;
    errno = 0;
    ok = picture ? write_picture(out, picture, channel) : write_stats(out, context, all);
    return output_close(target, out, ok, target == &targets[PARTIAL] ? NULL : &interrupted);
}

static const char *why_not_written(void) { return errno ? strerror(errno) : "the writer failed"; }

static int fail_to_write(const char *name) {
    return fail("%s: cannot be written: %s; free some space or give another file name", name, why_not_written());
}

/* Both return the exit status. done: how far the picture is, 0 to 1. */
static int keep_picture(const image *picture, sbl_channel channel, float done) {
    if (!interrupted && write_whole(&targets[PICTURE], picture, channel, NULL, NULL)) return DONE;
    if (!interrupted) return fail_to_write(options.output);
    if (!write_whole(&targets[PARTIAL], picture, channel, NULL, NULL))
        return stop("the picture so far cannot be written to %s: %s", targets[PARTIAL].name, why_not_written());
    return stop("the picture so far (%.0f %%) is in %s", floor(100 * (double)done), targets[PARTIAL].name);
}
static int keep_stats(const sbl_context *context, const totals *all) {
    if (!interrupted && write_whole(&targets[STATISTICS], NULL, SBL_CHANNEL_FINAL, context, all)) return DONE;
    return interrupted ? stop("%s is written, %s is not", options.output, options.stats) : fail_to_write(options.stats);
}

/* ---- bounced light that is kept ---- */

static size_t put_bytes(const void *data, size_t bytes, void *user) { return fwrite(data, 1, bytes, (FILE *)user); }
static size_t get_bytes(void *data, size_t bytes, void *user) { return fread(data, 1, bytes, (FILE *)user); }

/* 1: it is there, and is of this scene. Otherwise it is made anew, which a warning says where there was something. */
static int load_store(sbl_context *context, messages *said) {
    FILE *in = options.store ? fopen(options.store, "rb") : NULL;
    int loaded;
    if (!in) return 0;
    loaded = sbl_load_store(context, get_bytes, in) == SBL_SUCCESS;
    fclose(in);
    if (!loaded && said->warnings_kept < 8)
        snprintf(said->warnings[said->warnings_kept++], sizeof said->warnings[0], "--store %.200s: %.250s; it is made "
                 "anew", options.store, strncmp(said->error, "sbl_load_store: ", 16) ? said->error : said->error + 16);
    said->errors = 0;
    return loaded;
}

/* Returns the exit status. */
static int keep_store(sbl_context *context) {
    FILE *out = output_open(&targets[STORED]);
    errno = 0;
    if (out && output_close(&targets[STORED], out, sbl_save_store(context, put_bytes, out) == SBL_SUCCESS, &interrupted))
        return DONE;
    return interrupted ? stop("%s is written, %s is not", options.output, options.store) : fail_to_write(options.store);
}

/* ---- one sensor ---- */

enum { DISC = 512, LAMPS_SHOWN = 20 };

static double sum_of(const float v[3]) { return (double)v[0] + (double)v[1] + (double)v[2]; }

static void describe_lamp(const sbl_sensor *s, int number) {
    const sbl_sensor_lamp *l = &s->lamps[number];
    if (l->kind == SBL_LAMP_TRIANGLE) printf("  triangle %d of mesh %d:", l->number, l->mesh);
    else printf("  %s %d:", l->kind == SBL_LAMP_LIGHT ? "light" : "texel of the sky", l->number);
    if (sum_of(l->unhindered) > 0)
        printf(" unhindered %g %g %g,", (double)l->unhindered[0], (double)l->unhindered[1], (double)l->unhindered[2]);
    printf(" %d of %d rays arrive\n", l->open, l->rays);
}

/* Those that give most, or would. */
static void describe_lamps(const sbl_sensor *s) {
    double *worth = (double *)calloc((size_t)s->lamp_count + 1, sizeof *worth);
    int i, k, best;
    if (!worth) return;
    for (i = 0; i < s->lamp_count; i++) worth[i] = sum_of(s->lamps[i].unhindered);
    for (i = 0; i < s->ray_count; i++)
        if (s->rays[i].lamp >= 0) worth[s->rays[i].lamp] += sum_of(s->rays[i].radiance);
    for (i = 0; i < s->lamp_count && i < LAMPS_SHOWN; i++) {
        for (k = best = 0; k < s->lamp_count; k++)
            if (worth[k] > worth[best]) best = k;
        describe_lamp(s, best);
        worth[best] = -1;
    }
    if (s->lamp_count > LAMPS_SHOWN) printf("  and %d lamps more\n", s->lamp_count - LAMPS_SHOWN);
    free(worth);
}

/* sheet_sum: of weight times radiance. */
static void describe(const sbl_sensor *s, const double sheet_sum[3]) {
    int i, aimed = 0;
    for (i = 0; i < s->ray_count; i++) aimed += s->rays[i].lamp >= 0;
    printf("pixel %d,%d: %s, level %d%s\n", options.inspect[0], options.inspect[1],
           s->sensed ? "had a sensor" : "was interpolated; this is what a sensor would see", s->level,
           s->valid ? "" : ", judged to be stuck inside geometry");
    printf("position %g %g %g\nnormal %g %g %g\n", (double)s->position[0], (double)s->position[1], (double)s->position[2],
           (double)s->normal[0], (double)s->normal[1], (double)s->normal[2]);
    printf("R %g %g %g\n", (double)s->radiance[0], (double)s->radiance[1], (double)s->radiance[2]);
    if (s->noise > 0) printf("standard error %g\n", (double)s->noise);
    if (s->looks > 1) printf("mean of %d looks; what follows is of the first\n", s->looks);
    printf("sum of weight * radiance over the sheet %g %g %g\nsum of weights %.6f, ", sheet_sum[0], sheet_sum[1], sheet_sum[2],
           (double)s->weight_sum);
    if (s->view_count) printf("%d views, %d x %d texels\n", s->view_count, s->sheet_width, s->sheet_height);
    else printf("%d rays\n", s->ray_count - aimed);
    printf("back faces %.2f %%, nearest surface %g, mean distance %g\n", 100 * (double)s->back_share, (double)s->hit_min,
           (double)s->hit_mean);
    printf("from lamps %g %g %g: %d lamps, %d rays towards them\n", (double)s->from_lamps[0], (double)s->from_lamps[1],
           (double)s->from_lamps[2], s->lamp_count, aimed);
    describe_lamps(s);
}

/* What the sensor's views show, or its rays. */
static sbl_result inspect(sbl_context *context, image *shown) {
    sbl_sensor s;
    const int x = options.inspect[0], y = options.inspect[1];
    sbl_result result = sbl_inspect_sensor(context, x, y, &s, NULL, NULL, 0);
    float *radiance, *weights;
    double sum[3] = { 0, 0, 0 };
    size_t texels, i;
    if (result != SBL_SUCCESS) return result;
    texels = (size_t)s.sheet_width * (size_t)s.sheet_height;
    shown->width = s.view_count ? s.sheet_width : DISC;
    shown->height = s.view_count ? s.sheet_height : DISC;
    shown->components = 3;
    shown->values = (float *)malloc((size_t)shown->width * (size_t)shown->height * 3 * sizeof *shown->values);
    radiance = (float *)malloc(texels * 4 * sizeof *radiance);
    weights = (float *)malloc(texels * sizeof *weights);
    result = SBL_ERROR_OUT_OF_MEMORY;
    if (radiance && weights && shown->values) result = sbl_inspect_sensor(context, x, y, &s, radiance, weights, texels);
    for (i = 0; i < 3 * texels && result == SBL_SUCCESS; i++) {
        sum[i % 3] += (double)weights[i / 3] * (double)radiance[i / 3 * 4 + i % 3];
        if (s.view_count) shown->values[i] = radiance[i / 3 * 4 + i % 3];
    }
    if (result == SBL_SUCCESS) {
        if (!s.view_count) sensor_disc(&s, DISC, shown->values);
        describe(&s, sum);
    }
    free(radiance);
    free(weights);
    return result;
}

/* ---- all of it ---- */

static const float least = 1e-30f;  /* to sbl.h zero means the default; on the command line it means zero */

static void fill_desc(sbl_picture_desc *desc, progress *bar) {
    memset(desc, 0, sizeof *desc);
    desc->width = options.size[0];
    desc->height = options.size[1];
    if (given[MODE]) desc->mode = modes[options.mode];
    if (given[PRESET]) desc->preset = presets[options.preset];
    desc->backend = backends[options.backend];
    desc->error = (float)options.error;
    desc->rays = options.rays;
    desc->sensor_size = options.sensor_size;
    desc->sensor_fov = (float)options.sensor_fov;
    desc->tile = options.tile;
    if (given[THRESHOLD]) desc->threshold = options.threshold > (double)least ? (float)options.threshold : least;
    desc->facet_limit = (float)options.facet_limit;
    if (given[EPSILON]) desc->epsilon = options.epsilon > (double)least ? (float)options.epsilon : least;
    if (given[FILTER_RADIUS]) desc->filter_radius = options.filter_radius ? options.filter_radius : -1;
    desc->samples = (sbl_channel)options.channel == SBL_CHANNEL_FINAL ? options.samples : 1;  /* the other channels show pixel centres */
    desc->seed = (uint32_t)options.seed;
    desc->progress = on_progress;
    desc->progress_user = bar;
}

/* Until the picture is done, or interrupted: SBL_UNFINISHED. */
static sbl_result work(sbl_context *context) {
    const double slice = 0.25;  /* seconds that an interrupt may wait, about */
    sbl_result result = SBL_UNFINISHED;
    while (result == SBL_UNFINISHED && !interrupted) result = sbl_step(context, slice);
    return result;
}

static sbl_result read_picture(sbl_context *context, const sbl_picture_desc *desc, sbl_channel channel,
                               image *picture) {
    size_t count;
    picture->width = desc->width;
    picture->height = desc->height;
    picture->components = sbl_channel_components(channel);
    count = (size_t)desc->width * (size_t)desc->height * (size_t)picture->components;
    picture->values = (float *)malloc(count * sizeof(float));
    return picture->values ? sbl_read_channel(context, channel, picture->values, count) : SBL_ERROR_OUT_OF_MEMORY;
}

/* Does anything in it shine? */
static int is_lit(const sbl_scene_desc *scene) {
    int i, k;
    if (scene->light_count > 0) return 1;
    for (i = 0; i < scene->mesh_count; i++)
        for (k = 0; k < 3; k++) if (scene->materials[scene->meshes[i].material].emission[k] > 0) return 1;
    return scene->mesh_count == 0;
}

/* A scene in which nothing shines gets a sky. */
static int lit_by_us(const sbl_scene_desc *scene) { return !given[SKY] && !is_lit(scene); }

/* sky: NULL, or its picture. */
static int render(const scene_file *file, const scene_file *sky, sbl_context *context, messages *said, double start, double load) {
    const sbl_channel channel = given[INSPECT] ? SBL_CHANNEL_FINAL : (sbl_channel)options.channel;
    progress bar = { !given[QUIET] && isatty(STDERR_FILENO), now(), 0 };
    sbl_picture_desc desc;
    image picture = { 0, 0, 0, NULL };
    sbl_scene_desc scene = file->scene;
    sbl_result result;
    totals all = { file->scene.light_count, load, 0 };
    int i, status = DONE, loaded;
    for (i = 0; i < 3; i++) scene.sky[i] = options.sky_picture ? 0 : (float)options.sky[i];
    for (i = 0; i < 3 && lit_by_us(&scene); i++) scene.sky[i] = 1;
    if (sky) {
        scene.environment.picture = sky->scene.environment.picture;
        scene.environment.scale = options.sky_scale > (double)least ? (float)options.sky_scale : least;
        scene.environment.rotation = (float)options.sky_rotation;
        for (i = 0; i < 3; i++) scene.environment.up[i] = (float)options.sky_up[i];
    }
    scene.bounce_samples = options.bounce_samples;
    result = sbl_set_scene(context, &scene);
    if (result != SBL_SUCCESS) return fail_with(said, options.scene, result);
    if (interrupted) return stop("no picture was begun");
    loaded = load_store(context, said);
    fill_desc(&desc, &bar);
    place_camera(&desc, context, file);
    if (desc.world_to_view[15] == 0.0f)
        return misuse("--eye, --look-at, --up: the camera looks along its up vector, or stands where it looks; change one of them");
    result = sbl_begin(context, &desc);
    if (result == SBL_SUCCESS) result = work(context);
    if (bar.shown) fprintf(stderr, "\r%70s\r", "");
    if (!given[INSPECT] && (result == SBL_SUCCESS || result == SBL_UNFINISHED))
        result = read_picture(context, &desc, channel, &picture);
    else if (result == SBL_SUCCESS) result = inspect(context, &picture);
    all.seconds = now() - start;
    if (result == SBL_SUCCESS) status = keep_picture(&picture, channel, sbl_progress(context));
    else if (result == SBL_UNFINISHED) status = stop("there is nothing to be seen yet");
    else status = fail_with(said, options.scene, result);
    if (status == DONE && options.stats) status = keep_stats(context, &all);
    if (status == DONE && options.store && !loaded) status = keep_store(context);
    free(picture.values);
    if (status == DONE && bar.shown) fprintf(stderr, "%s: %d x %d, %.0f sensors, %.1f s\n", options.output, picture.width, picture.height,
                                            (double)sbl_query_stats(context).sensors, all.seconds);
    return status;
}

static void on_confined(const char *path, const char *message, void *user) {
    (void)user;
    tell("%s: the process that read it: %s", path, message);
}

/* ---- ulimit -v: drivers break down where they get no memory ---- */

static void on_breakdown(int number) {
    static const char line[] = "sbl_render: the graphics driver broke down for want of memory; allow more than this ulimit -v\n";
    (void)number;
    if (write(STDERR_FILENO, line, sizeof line - 1) >= 0) _exit(FAILED);
    _exit(FAILED);
}

/* Where memory is limited: whether a driver can be loaded at all; and from now on one that breaks down does it in words. */
static int check_address_space(void) {
    const size_t driver = (size_t)512 << 20;  /* Mesa's software renderer on two cores */
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

int main(int argc, char **argv) {
    const double start = now();
    sbl_context_desc context_desc;
    sbl_context *context = NULL;
    scene_file *file = NULL, *sky = NULL;
    messages said;
    sbl_result result;
    char error[512];
    double load;
    int i, status = parse(argc, argv);
    if (status != DONE) return status;
    if (given[HELP]) { print_help(); return fflush(stdout) == 0 ? DONE : FAILED; }
    if (given[VERSION]) { printf("sbl_render %s\n", sbl_version()); return fflush(stdout) == 0 ? DONE : FAILED; }
    catch_signals();
    status = find_targets();
    if (status != DONE) goto done;
    options.reading.cancel = &interrupted;
    if (given[VERBOSE]) options.reading.log = on_confined;
    file = scene_file_load(options.scene, &options.reading, error, sizeof error);
    if (file && options.sky_picture) sky = scene_file_load_sky(options.sky_picture, &options.reading, error, sizeof error);
    load = now() - start;
    if (interrupted) status = stop("no picture was begun");
    else if (!file || (options.sky_picture && !sky)) status = fail("%s", error);
    else if (!check_address_space()) status = fail("OpenGL: ulimit -v leaves less than 512 MB for the driver; allow more");
    else if ((status = check_overwriting(file)) == DONE) {
        memset(&said, 0, sizeof said);
        said.file = file;
        memset(&context_desc, 0, sizeof context_desc);
        context_desc.logger.log = on_log;
        context_desc.logger.user = &said;
        result = sbl_create(&context_desc, &context);
        status = result == SBL_SUCCESS ? render(file, sky, context, &said, start, load) : fail_with(&said, "OpenGL", result);
        sbl_destroy(context);
        if (status == DONE && !given[QUIET]) {
            if (lit_by_us(&file->scene))
                warn("%s: nothing in it shines; an even sky of 1,1,1 lights it, --sky chooses another", options.scene);
            for (i = 0; i < file->warning_count && i < SCENE_FILE_WARNINGS; i++) warn("%s: %s", options.scene, file->warnings[i]);
            if (file->warning_count > SCENE_FILE_WARNINGS)
                warn("%s: and %d warnings more", options.scene, file->warning_count - SCENE_FILE_WARNINGS);
            for (i = 0; i < said.warnings_kept; i++) warn("%s: %s", options.scene, said.warnings[i]);
        }
    }
done:
    scene_file_free(file);
    scene_file_free(sky);
    for (i = 0; i < TARGETS; i++) output_free(&targets[i]);
    return status;
}
