/* The camera of tools that draw pictures: its options, which follow the common options in the table of the tool, and
   its matrices. Include after tool_scene.h and tool_survey.h. */
#ifndef TOOL_CAMERA_H
#define TOOL_CAMERA_H

static struct tool_camera {
    int size[2];
    double eye[3], look_at[3], up[3], fov;
} camera = { .size = { 640, 480 }, .up = { 0, 1, 0 }, .fov = 40 };

enum { SIZE = COMMON_OPTIONS, EYE, LOOK_AT, UP, FOV, CAMERA_END };

#define CAMERA_ROWS \
    [SIZE]          = { "--size", "WxH", SIZES, camera.size, 2, 1, 16384, \
                        "width and height in pixels; default 640x480", NULL, NULL }, \
    [EYE]           = { "--eye", "X,Y,Z", NUMBERS, camera.eye, 3, -1e18, 1e18, \
                        "the position of the camera; default: see --fov", NULL, NULL }, \
    [LOOK_AT]       = { "--look-at", "X,Y,Z", NUMBERS, camera.look_at, 3, -1e18, 1e18, \
                        "the point that the camera looks at; default: see --fov", NULL, NULL }, \
    [UP]            = { "--up", "X,Y,Z", NUMBERS, camera.up, 3, -1e18, 1e18, \
                        "the direction that is up in the picture; default: see --fov", NULL, NULL }, \
    [FOV]           = { "--fov", "DEGREES", NUMBERS, &camera.fov, 1, 1, 179, \
                        "vertical field of view. Defaults of --eye, --look-at, --up and --fov: the camera of the " \
                        "file, or one that fits the scene: in front of an object, in front of the open side of a " \
                        "room, or inside a room; --verbose shows it", NULL, NULL }

#define CAMERA_LINES \
    { SIZE, "width and height in pixels; default 640x480" }, \
    { EYE, "position; default: as in the file, else automatic" }, \
    { LOOK_AT, "the point that the camera looks at" }, \
    { UP, "the direction that is up in the picture" }, \
    { FOV, "vertical field of view" }

/* A camera. camera_choose chooses it for the scene; camera_place then lets the options replace parts of it. */
typedef struct camera_view {
    double eye[3], forward[3], up[3], fov;
    int of_file;        /* 1: it is the camera of the file */
    const char *where;  /* description of the choice for --verbose */
} camera_view;

/* Computes the tangents of half of the field of view, horizontally and vertically. */
static void camera__tangents(double fov, double out[2]) {
    out[1] = tan(fov * atan(1.0) / 90);
    out[0] = out[1] * camera.size[0] / camera.size[1];
}

/* Returns 1 if the camera of the file seems never to have been placed by its author: it is where Blender puts the
   camera of a new file, in any unit of length, and inside the bounds of the scene, so that the model may surround
   it. */
static int camera_is_unplaced(const scene_file *file, const survey *s) {
    static const double defaults[2][3] = { { 7.48113, 5.34367, 6.50764 },    /* Blender until 2.79 */
                                           { 7.35889, 4.95831, 6.92579 } };  /* Blender since 2.80 */
    const float *eye = file->camera.eye;
    int i, k, inside = file->has_camera, found = 0;
    for (k = 0; k < 3; k++) inside = inside && eye[k] > s->bounds.lowest[k] && eye[k] < s->bounds.highest[k];
    for (i = 0; i < 2 && inside; i++) {
        const double unit = (double)eye[0] / defaults[i][0];
        int same = unit > 0;
        for (k = 1; k < 3; k++) same = same && fabs((double)eye[k] / unit - defaults[i][k]) < 1e-3;
        found = found || same;
    }
    return found;
}

/* Converts a camera of the file. Returns 0 if its values are invalid. */
static int camera_take(const scene_file_camera *c, camera_view *view) {
    const double radians = atan(1.0) / 45, aspect = (double)camera.size[0] / camera.size[1];
    float unused[16];
    const float *to = c->forward, *up = c->up;
    int i, ok = sbl_look_at(unused, 0, 0, 0, to[0], to[1], to[2], up[0], up[1], up[2]);
    view->fov = (double)c->fov_y;
    if (c->fov_x > 0 && c->fov_x < 179)
        view->fov = 2 * atan(tan(0.5 * (double)c->fov_x * radians) / aspect) / radians;
    for (i = 0; i < 3; i++) {
        view->eye[i] = (double)c->eye[i];
        view->forward[i] = (double)c->forward[i];
        view->up[i] = (double)c->up[i];
        ok = ok && fabs(view->eye[i]) < 1e18;
    }
    view->where = "of the file";
    return view->of_file = ok && view->fov >= 1 && view->fov <= 179;
}

/* Takes the camera of the file. Returns 0 if its values are invalid or its author never placed it; it is then
   ignored. */
static int camera_of_file(const scene_file *file, camera_view *view, const survey *s) {
    return view->of_file = file->has_camera && camera_take(&file->camera, view) && !camera_is_unplaced(file, s);
}

/* Warns if the file has a camera whose values are invalid. */
static inline void camera_check(const scene_file *file) {
    camera_view unused;
    if (file->has_camera && !camera_take(&file->camera, &unused))
        warn("%s: the camera of the file is not used, because its field of view (%.3g degrees) is not between 1 and "
             "179 degrees, or its position is too far away; the tool chose a view", common.scene,
             (double)(file->camera.fov_y > 0 ? file->camera.fov_y : file->camera.fov_x));
}

/* Places the camera so that the corners of the bounds just fit into the picture, with a margin of a fourteenth of the
   picture on each side. */
static void camera__frame(const survey *s, camera_view *view) {
    double right[3], up[3], tangents[2], most[2][2], shift[2], distance = 0, length;
    int i, k, axis;
    length = sqrt(s->from[0] * s->from[0] + s->from[2] * s->from[2]);
    right[0] = s->from[2] / length;
    right[1] = 0;
    right[2] = -s->from[0] / length;
    up[0] = s->from[1] * right[2];  /* cross product of from and right */
    up[1] = s->from[2] * right[0] - s->from[0] * right[2];
    up[2] = -s->from[1] * right[0];
    camera__tangents(view->fov, tangents);
    for (i = 0; i < 4; i++) most[i / 2][i % 2] = -1e300;
    for (i = 0; i < 8; i++) {
        double x[2] = { 0, 0 }, towards = 0;  /* a corner from the centre: to the right, up; towards the camera */
        for (k = 0; k < 3; k++) {
            const double half = (i >> k & 1 ? 0.5 : -0.5) * survey__size(s, k);
            x[0] += half * right[k];
            x[1] += half * up[k];
            towards += half * s->from[k];
        }
        for (axis = 0; axis < 2; axis++)
            for (k = 0; k < 2; k++) {
                const double t = 0.86 * tangents[axis], reach = (k ? -x[axis] : x[axis]) + t * towards;
                if (reach > most[axis][k]) most[axis][k] = reach;
            }
    }
    for (axis = 0; axis < 2; axis++) {
        const double fits = (most[axis][0] + most[axis][1]) / (2 * 0.86 * tangents[axis]);
        shift[axis] = 0.5 * (most[axis][0] - most[axis][1]);
        if (fits > distance) distance = fits;
    }
    if (!(distance > 0)) distance = 1;
    for (k = 0; k < 3; k++) {
        view->eye[k] = survey__center(s, k) + distance * s->from[k] + shift[0] * right[k] + shift[1] * up[k];
        view->forward[k] = -s->from[k];
    }
    view->where = "in front of an object";
}

/* Places the camera in front of the open side of a room, so that the opening covers the picture. An opening that is
   more than twice as long as it is high, relative to the picture, or the reverse, does not cover it: half of its longer
   side fits into the picture, and borders remain beside the shorter side. */
static void camera__look_in(const survey *s, camera_view *view) {
    const int axis = s->side / 2, across = axis == 0 ? 2 : 0;
    double tangents[2], wide, high, covers, distance;
    int k;
    camera__tangents(view->fov, tangents);
    wide = 0.5 * survey__size(s, across) / tangents[0];
    high = 0.5 * survey__size(s, 1) / tangents[1];
    covers = 0.98 * (wide < high ? wide : high);
    distance = 0.5 * (wide < high ? high : wide);
    if (distance < covers) distance = covers;
    for (k = 0; k < 3; k++) {
        const double out = k == axis ? s->side % 2 ? -1 : 1 : 0;
        view->eye[k] = survey__center(s, k) + out * (0.5 * survey__size(s, k) + distance);
        view->forward[k] = -out;
    }
    view->where = "in front of the open side of a room";
}

enum { CAMERA__ROOM_FOV = 60 };  /* field of view inside a room in degrees, as of a wide-angle lens */

/* Chooses the camera of the file, or one that fits the scene (see the help text of --fov). It uses only the options
   --size and --fov. */
static void camera_choose(camera_view *view, const scene_file *file, const int *given, const survey *s) {
    int i;
    if (camera_of_file(file, view, s)) { if (given[FOV]) view->fov = camera.fov; return; }
    view->fov = s->kind == SURVEY_ROOM && !given[FOV] ? CAMERA__ROOM_FOV : camera.fov;
    for (i = 0; i < 3; i++) {
        view->eye[i] = s->eye[i];
        view->forward[i] = s->forward[i];
        view->up[i] = i == 1;
    }
    view->where = "inside a room";
    if (s->kind == SURVEY_OBJECT) camera__frame(s, view);
    if (s->kind == SURVEY_OPEN_ROOM) camera__look_in(s, view);
}

/* Lets the options replace parts of the camera. For an object with --look-at but without --eye, the camera is placed so
   far from this point that a sphere around it, as large as the scene, fits into the picture. With --eye but without
   --look-at, the camera looks at the centre of the scene, or as the camera of the file does. */
static void camera__options(camera_view *view, const int *given, const survey *s) {
    double tangents[2], at[3], distance;
    int i;
    if (given[EYE] && !view->of_file) view->fov = camera.fov;
    camera__tangents(view->fov, tangents);
    distance = atan(tangents[0] < tangents[1] ? tangents[0] : tangents[1]);
    distance = (survey__radius(s) > 0 ? survey__radius(s) : 1) / sin(distance);
    for (i = 0; i < 3; i++) {
        at[i] = given[LOOK_AT] ? camera.look_at[i] : survey__center(s, i);
        if (given[EYE]) view->eye[i] = camera.eye[i];
        else if (given[LOOK_AT] && !view->of_file && s->kind == SURVEY_OBJECT)
            view->eye[i] = at[i] + distance * s->from[i];
        if (given[LOOK_AT] || (given[EYE] && !view->of_file)) view->forward[i] = at[i] - view->eye[i];
        if (given[UP]) view->up[i] = camera.up[i];
    }
    if (!given[LOOK_AT] && view->forward[0] == 0.0 && view->forward[1] == 0.0 && view->forward[2] == 0.0)
        view->forward[2] = -1;  /* the eye is at the centre of the scene, so any direction will do */
    if (!given[UP] && view->forward[0] == 0.0 && view->forward[2] == 0.0) {
        view->up[0] = view->up[1] = 0;
        view->up[2] = view->forward[1] < 0 ? -1 : 1;
    }
    if (given[EYE] || given[LOOK_AT]) view->where = "of the options";
}

/* Computes the matrices of a camera. Returns 0 if its directions are degenerate. */
static int camera_matrices(float world_to_view[16], float view_to_clip[16], const camera_view *view) {
    const double *eye = view->eye, *forward = view->forward, *up = view->up;
    double to[3], distance;
    int i;
    /* The vector to the look-at point is made as long as the distance of the eye from the origin. With a shorter
       vector, rounding to float would rotate the camera. */
    distance = sqrt(forward[0] * forward[0] + forward[1] * forward[1] + forward[2] * forward[2]);
    for (i = 0; i < 3; i++)
        to[i] = eye[i] + (distance > 0 ? forward[i] / distance * (1 + fabs(eye[0]) + fabs(eye[1]) + fabs(eye[2])) : 0);
    return sbl_perspective(view_to_clip, (float)view->fov, (float)((double)camera.size[0] / camera.size[1])) &&
           sbl_look_at(world_to_view, (float)eye[0], (float)eye[1], (float)eye[2], (float)to[0], (float)to[1],
                       (float)to[2], (float)up[0], (float)up[1], (float)up[2]);
}

/* Applies the options to the chosen camera and computes its matrices. Returns 0 if the directions are degenerate. */
static int camera_place(float world_to_view[16], float view_to_clip[16], camera_view *view, const int *given,
                        const survey *s) {
    camera__options(view, given, s);
    return camera_matrices(world_to_view, view_to_clip, view);
}

/* Writes a camera as the options that reproduce it. */
static inline void camera_words(char *out, size_t size, const camera_view *c, const survey *s) {
    double at[3], length = 0, distance = 0;
    int k;
    for (k = 0; k < 3; k++) length += c->forward[k] * c->forward[k];
    for (k = 0; k < 3; k++) distance += (survey__center(s, k) - c->eye[k]) * c->forward[k] / length;
    for (k = 0; k < 3; k++) at[k] = c->eye[k] + c->forward[k] * (distance > 0 ? distance : 1);
    snprintf(out, size, "--eye %.6g,%.6g,%.6g --look-at %.6g,%.6g,%.6g --up %.6g,%.6g,%.6g --fov %.4g", c->eye[0],
             c->eye[1], c->eye[2], at[0], at[1], at[2], c->up[0], c->up[1], c->up[2], c->fov);
}

static int camera_misuse(void) {
    return misuse("--eye, --look-at, --up: the camera looks along its up vector, or at its own position; change one "
        "of them");
}

#endif
