/* Picture sequences: each frame has a picture and a camera of its own. The cameras come from the file of --cameras, or
   from the animated camera of a .gltf or .glb file. Include after tool_camera.h and tool_plan.h.

   The file of --cameras is JSON, and lists one camera per frame, with these keys:

       {"cameras": [{"eye": [0, 1, 3], "look_at": [0, 0.5, 0], "up": [0, 1, 0], "fov": 40},
                    {"camera_to_world": [1, 0, 0, 0,  0, 1, 0, 0,  0, 0, 1, 0,  0, 1, 3, 1], "fov": 35}]}

       eye, look_at     X, Y, Z: as --eye and --look-at, see tool_camera.h
       up, fov          optional; default: the values of --up and --fov, or their defaults for --eye and --look-at
       camera_to_world  replaces eye, look_at and up: a matrix of 16 numbers, column by column as in glTF; the camera
                        looks along its -z axis, and its y axis is up

   The first camera is frame 1. All frames use the automatic exposure and the studio light of frame 1. Thus a frame does
   not depend on which other frames a run renders. */
#ifndef TOOL_FRAMES_H
#define TOOL_FRAMES_H

#ifdef SBL_RENDER_CJSON
  #include <cjson/cJSON.h>
#endif

/* maximum frame number; maximum number of bytes of a file of --cameras */
enum { FRAMES_MAX = 100000, FRAMES_BYTES = 16 << 20 };

/* A camera of the file of --cameras. The fields are the values of the options --eye, --look-at, --up and --fov. */
typedef struct frame_camera { double eye[3], look_at[3], up[3], fov; int has_up, has_fov; } frame_camera;

static struct tool_frames {
    const char *file, *range;    /* values of --cameras and --frames, or NULL */
    double rate;                 /* value of --fps */
    int first, last;             /* the frames that this run renders; 0 if it renders a single picture */
    int now;                     /* the frame that is being rendered, or 0 */
    const char *pattern;         /* file name of the pictures, with %d or %04d */
    frame_camera *cameras;       /* from the file of --cameras; NULL if the camera is animated */
    int count;
    struct tool_camera asked;    /* the camera as the options set it */
} frames = { .rate = 24 };

enum { CAMERAS = CAMERA_END, FRAMES, FPS, FRAMES_END };

#define FRAMES_ROWS \
    [CAMERAS]       = { "--cameras", "FILE", TEXT, &frames.file, 0, 0, 0, \
                        "makes a picture for each camera that FILE lists. FILE is JSON: {\"cameras\": [{\"eye\": " \
                        "[X, Y, Z], \"look_at\": [X, Y, Z], \"up\": [X, Y, Z], \"fov\": DEGREES}, ...]}. If up or " \
                        "fov is missing, --up or --fov applies, or its default. \"camera_to_world\": [16 numbers, " \
                        "column by column, as in glTF] may replace eye, look_at and up. The --output " \
                        "needs %d or %04d, which becomes the number of the frame; the first camera is frame 1. All " \
                        "frames use the automatic exposure and the studio light of frame 1", NULL, NULL }, \
    [FRAMES]        = { "--frames", "A-B|A", TEXT, &frames.range, 0, 0, 0, \
                        "makes only frames A to B, or frame A. The cameras come from --cameras, or from the " \
                        "animated camera of a .gltf or .glb file (LINEAR or STEP keys); frame 1 is at time 0. Only " \
                        "the camera moves. With --part K/N, a run makes the K-th of N parts of the frames. In mode " \
                        "gi, each run makes a small picture of frame 1 first, unless the FILE of --store exists, " \
                        "so that all runs use the same number of cells. --stats writes the sums over all frames. " \
                        "After Ctrl-C, finished frames stay, and the unfinished one is not saved. " \
                        "--resume continues the unfinished windows of a frame; it refuses a frame that already has " \
                        "its output file and no folder of windows", NULL, NULL }, \
    [FPS]           = { "--fps", "N", NUMBERS, &frames.rate, 1, 0.001, 1000, \
                        "frames per second of an animated camera; default 24", NULL, NULL }

#define FRAMES_LINES \
    { CAMERAS, "a picture for each camera in FILE; see --help all" }, \
    { FRAMES, NULL }, { FPS, NULL }

static void frames_free(void) {
    free(frames.cameras);
    frames.cameras = NULL;
}

/* ---- reading the file of cameras ---- */

static int frames__refuse(int number, const char *key, const char *words) {
    return fail("--cameras %s: camera %d: \"%.64s\" %s", frames.file, number, key, words);
}

#ifdef SBL_RENDER_CJSON
enum { FRAME__EYE, FRAME__LOOK_AT, FRAME__UP, FRAME__FOV, FRAME__MATRIX, FRAME__KEYS };
static const struct { const char *name; int count; double low, high; const char *words; } frames__keys[FRAME__KEYS] = {
    { "eye", 3, -1e18, 1e18, "three numbers from -1e18 to 1e18" },
    { "look_at", 3, -1e18, 1e18, "three numbers from -1e18 to 1e18" },
    { "up", 3, -1e18, 1e18, "three numbers from -1e18 to 1e18" },
    { "fov", 1, 1, 179, "a number from 1 to 179" },
    { "camera_to_world", 16, -1e18, 1e18, "16 numbers from -1e18 to 1e18" }
};

typedef struct frames__values { double numbers[FRAME__KEYS][16]; int has[FRAME__KEYS]; } frames__values;

/* Reads a number or an array of numbers. Returns 0 if the item is anything else, or a number is out of range. */
static int frames__numbers(const cJSON *item, int key, double *out) {
    const int count = frames__keys[key].count;
    const cJSON *number = item;
    int i;
    if (count > 1) {
        if (!cJSON_IsArray(item)) return 0;
        number = item->child;
    }
    for (i = 0; i < count; i++) {
        if (!cJSON_IsNumber(number)) return 0;
        out[i] = number->valuedouble;
        if (!(out[i] >= frames__keys[key].low && out[i] <= frames__keys[key].high)) return 0;
        number = number->next;
    }
    return count == 1 || !number;
}

/* Reads the keys of the camera with this number, from 1. Returns the exit status. */
static int frames__read_keys(const cJSON *item, int number, frames__values *v) {
    const cJSON *child;
    char words[80];
    int key;
    memset(v, 0, sizeof *v);
    if (!cJSON_IsObject(item))
        return fail("--cameras %s: camera %d: it must be an object {...}", frames.file, number);
    cJSON_ArrayForEach(child, item) {
        for (key = 0; key < FRAME__KEYS && strcmp(child->string, frames__keys[key].name) != 0; key++) continue;
        if (key == FRAME__KEYS)
            return frames__refuse(number, child->string, "is not a key of a camera; remove it (see --help all)");
        if (v->has[key]++) return frames__refuse(number, child->string, "is given twice; remove one of them");
        snprintf(words, sizeof words, "must be %s", frames__keys[key].words);
        if (!frames__numbers(child, key, v->numbers[key])) return frames__refuse(number, child->string, words);
    }
    for (key = FRAME__EYE; key <= FRAME__UP; key++) {
        if (v->has[FRAME__MATRIX] && v->has[key])
            return frames__refuse(number, frames__keys[key].name,
                                  "cannot be combined with \"camera_to_world\"; remove one of them");
        if (!v->has[FRAME__MATRIX] && !v->has[key] && key != FRAME__UP)
            return frames__refuse(number, frames__keys[key].name, "is missing");
    }
    return DONE;
}

/* Returns 1 if a matrix can place a camera: its axes are at right angles, of any length, it does not mirror, and its
   last row is 0, 0, 0, 1. */
static int frames__is_camera(const double m[16]) {
    double length[3], volume = 0;  /* negative if the matrix mirrors */
    int i, ok = fabs(m[15] - 1) < 1e-6;
    for (i = 0; i < 3; i++) {
        const double *c = m + 4 * i;
        length[i] = sqrt(c[0] * c[0] + c[1] * c[1] + c[2] * c[2]);
        ok = ok && length[i] > 0 && fabs(c[3]) < 1e-6;
        volume += m[i] * (m[4 + (i + 1) % 3] * m[8 + (i + 2) % 3] - m[4 + (i + 2) % 3] * m[8 + (i + 1) % 3]);
    }
    for (i = 0; i < 3; i++) {
        const double *a = m + 4 * i, *b = m + 4 * ((i + 1) % 3);
        ok = ok && fabs(a[0] * b[0] + a[1] * b[1] + a[2] * b[2]) <= 1e-3 * length[i] * length[(i + 1) % 3];
    }
    return ok && volume > 0;
}

/* Reads one camera of the list. Returns the exit status. */
static int frames__read_camera(const cJSON *item, int number, frame_camera *out) {
    frames__values v;
    const double *m = v.numbers[FRAME__MATRIX];
    int k, status = frames__read_keys(item, number, &v);
    if (status != DONE) return status;
    if (v.has[FRAME__MATRIX]) {
        const double length = sqrt(m[8] * m[8] + m[9] * m[9] + m[10] * m[10]);
        const double distance = 1 + fabs(m[12]) + fabs(m[13]) + fabs(m[14]);
        if (!frames__is_camera(m))
            return frames__refuse(number, "camera_to_world", "must be a rotation and a translation: axes at right "
                                  "angles, not mirrored, and 0, 0, 0, 1 as the last row");
        for (k = 0; k < 3; k++) {
            v.numbers[FRAME__EYE][k] = m[12 + k];
            v.numbers[FRAME__LOOK_AT][k] = m[12 + k] - distance * m[8 + k] / length;
            v.numbers[FRAME__UP][k] = m[4 + k];
        }
    }
    memcpy(out->eye, v.numbers[FRAME__EYE], sizeof out->eye);
    memcpy(out->look_at, v.numbers[FRAME__LOOK_AT], sizeof out->look_at);
    memcpy(out->up, v.numbers[FRAME__UP], sizeof out->up);
    out->fov = v.numbers[FRAME__FOV][0];
    out->has_up = v.has[FRAME__UP] || v.has[FRAME__MATRIX];
    out->has_fov = v.has[FRAME__FOV];
    return DONE;
}

/* Reads the list of cameras. Returns the exit status. */
static int frames__read_list(const cJSON *root) {
    const cJSON *list = NULL, *child;
    int status = DONE, number = 0;
    if (!cJSON_IsObject(root)) return fail("--cameras %s: it must be an object {\"cameras\": [...]}", frames.file);
    cJSON_ArrayForEach(child, root) {
        if (strcmp(child->string, "cameras") != 0 || list)
            return fail("--cameras %s: there must be one key, \"cameras\"; remove \"%.64s\"", frames.file,
                        child->string);
        list = child;
    }
    frames.count = cJSON_IsArray(list) ? cJSON_GetArraySize(list) : 0;
    if (!frames.count) return fail("--cameras %s: \"cameras\" must be a list of cameras", frames.file);
    if (frames.count > FRAMES_MAX)
        return fail("--cameras %s: it has %d cameras; at most %d are possible", frames.file, frames.count, FRAMES_MAX);
    frames.cameras = (frame_camera *)calloc((size_t)frames.count, sizeof *frames.cameras);
    if (!frames.cameras) return fail("out of memory");
    cJSON_ArrayForEach(child, list) {
        status = frames__read_camera(child, number + 1, &frames.cameras[number]);
        if (status != DONE) break;
        number++;
    }
    return status;
}

/* Parses the text of the file, which has `size` bytes and a zero byte. Returns the exit status. */
static int frames__parse(const char *text, size_t size) {
    const char *end = text, *c;
    int line = 1, status;
    cJSON *root = strlen(text) == size ? cJSON_ParseWithLengthOpts(text, size + 1, &end, 1) : NULL;
    if (!root) {
        for (c = text; c < end && *c; c++) line += *c == '\n';
        return fail("--cameras %s: line %d is not valid JSON", frames.file, line);
    }
    status = frames__read_list(root);
    cJSON_Delete(root);
    return status;
}
#endif

/* Reads the file of --cameras. Returns the exit status. */
static int frames__load(void) {
#ifdef SBL_RENDER_CJSON
    FILE *in = input_open(frames.file);
    char *text = NULL;
    size_t size;
    int status;
    if (!in) return fail("--cameras %s: it cannot be read: %s", frames.file, scene__why());
    text = (char *)malloc(FRAMES_BYTES + 2);
    if (!text) {
        fclose(in);
        return fail("out of memory");
    }
    size = fread(text, 1, FRAMES_BYTES + 1, in);
    text[size] = 0;
    if (ferror(in)) status = fail("--cameras %s: it cannot be read: %s", frames.file, strerror(errno));
    else if (size > FRAMES_BYTES)
        status = fail("--cameras %s: it is larger than %d MB; write shorter numbers, or fewer cameras", frames.file,
                      FRAMES_BYTES >> 20);
    else status = frames__parse(text, size);
    fclose(in);
    free(text);
    return status;
#else
    return fail("--cameras %s: this program was built without cJSON, which reads it; build it again with cJSON",
                frames.file);
#endif
}

/* ---- the options ---- */

/* Reads the value of --frames. Returns the exit status. */
static int frames__read_range(void) {
    const char *text = frames.range;
    char *end = NULL;
    long first, last;
    first = last = isdigit((unsigned char)*text) ? strtol(text, &end, 10) : 0;
    if (first > 0 && *end == '-' && isdigit((unsigned char)end[1])) last = strtol(end + 1, &end, 10);
    if (first < 1 || *end || last < first || last > FRAMES_MAX)
        return misuse("--frames %s: the value must be A-B or A, with numbers of frames from 1 to %d", text,
                      FRAMES_MAX);
    if (frames.file && last > frames.count)
        return misuse("--frames %s: %s has %d cameras, so there is no frame %ld", text, frames.file, frames.count,
                      last);
    frames.first = (int)first;
    frames.last = (int)last;
    return DONE;
}

/* Reduces the frames of this run to the K-th of N parts. Returns the exit status. */
static int frames__share(part_choice *part) {
    const int first = frames.first, all = frames.last - frames.first + 1;
    const int status = plan_part(part);
    if (status != DONE) return status;
    if (part->count > all)
        return misuse("--part %s: there are %d frames, which make at most %d parts", part->text, all, all);
    frames.first = first + (int)((long long)all * (part->number - 1) / part->count);
    frames.last = first + (int)((long long)all * part->number / part->count) - 1;
    return DONE;
}

/* Starts a frame: common.output becomes the pattern with this number. Returns 0 if the pattern is not valid. */
static int frames_go(int number) {
    static char name[PATH_MAX];
    frames.now = number;
    common.output = name;
    return numbered_name(name, sizeof name, frames.pattern, number);
}

/* Reads the options for frames. If there are frames, starts the first of this run. Returns the exit status. part:
   --part; its text is NULL if it was not given */
static int frames_parse(const int *given, part_choice *part) {
    int status = DONE;
    if (given[FPS] && (given[CAMERAS] || !given[FRAMES]))
        return misuse("--fps needs --frames A-B, without --cameras: it is for animated cameras of .gltf and .glb "
                      "files");
    if (!given[CAMERAS] && !given[FRAMES]) return DONE;
    if (given[CAMERAS] && (given[EYE] || given[LOOK_AT]))
        return misuse("--cameras and %s both place the camera; give only one of them",
                      given[EYE] ? "--eye" : "--look-at");
    if (!strchr(common.output, '%'))
        return misuse("--output %s: with frames, the name needs %%d or %%04d, which becomes the number of the frame",
                      common.output);
    if (given[CAMERAS]) status = frames__load();
    frames.first = 1;
    frames.last = frames.count;
    frames.asked = camera;
    frames.pattern = common.output;
    common.input = frames.file;
    if (status == DONE && given[FRAMES]) status = frames__read_range();
    if (status == DONE && !given[CAMERAS]) {
        common.reading.frames = frames.last;
        common.reading.frame_rate = frames.rate;
    }
    if (status == DONE && part->text) status = frames__share(part);
    if (status != DONE) return status;
    if (!frames_go(frames.last) || !frames_go(frames.first))
        return misuse("--output %s: %%d or %%04d stands for the number of the frame; no other %% is allowed",
                      frames.pattern);
    return DONE;
}

/* ---- the camera of a frame ---- */

/* Sets the options that describe the camera of the current frame. Returns which options count as given. given: the
   options of the command line, which are returned if there is no file of --cameras */
static const int *frames_options(const int *given) {
    static int options_of_frame[CAMERA_END];
    const frame_camera *f;
    if (!frames.cameras) return given;
    f = &frames.cameras[frames.now - 1];
    memcpy(options_of_frame, given, sizeof options_of_frame);
    camera = frames.asked;
    memcpy(camera.eye, f->eye, sizeof camera.eye);
    memcpy(camera.look_at, f->look_at, sizeof camera.look_at);
    if (f->has_up) memcpy(camera.up, f->up, sizeof camera.up);
    if (f->has_fov) camera.fov = f->fov;
    options_of_frame[EYE] = options_of_frame[LOOK_AT] = 1;
    options_of_frame[UP] |= f->has_up;
    options_of_frame[FOV] |= f->has_fov;
    return options_of_frame;
}

/* Chooses the camera: if it is animated, the camera of the current frame, with --fov; otherwise as camera_choose does.
   Returns 0 if the animated camera is invalid in this frame. */
static int frames_choose(camera_view *view, const scene_file *file, const int *given, const survey *s) {
    if (!frames.now || frames.cameras) { camera_choose(view, file, given, s); return 1; }
    if (frames.now > file->frame_count || !camera_take(&file->frames[frames.now - 1], view)) return 0;
    if (given[FOV]) view->fov = camera.fov;
    return 1;
}

static int frames_misuse(void) {
    if (!frames.now) return camera_misuse();
    if (frames.cameras)
        return frames__refuse(frames.now, "look_at", "and \"up\": the camera looks along its up vector, or at its own "
                              "position; change one of them");
    return fail("%s: frame %d: the animated camera is invalid there, or looks along its up vector; give cameras with "
                "--cameras FILE", common.scene, frames.now);
}

#endif
