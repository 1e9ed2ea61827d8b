/* The camera of tools that draw: options, which follow the common options in the table of the tool, and matrices.
   Include after tool_scene.h. */
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
                            "file, or a\n" \
                        "camera that shows the whole scene", NULL, NULL }

#define CAMERA_LINES \
    { SIZE, "width and height in pixels; default 640x480" }, \
    { EYE, "position; default: from the file, or chosen" }, \
    { LOOK_AT, "the point that the camera looks at" }, \
    { UP, "the direction that is up in the picture" }, \
    { FOV, "vertical field of view" }

/* Prints the camera for --verbose. forward: from the eye to the point that it looks at. */
static void detail_camera(const double eye[3], const double forward[3], const double up[3], double fov,
                          const char *source) {
    detail("camera: --eye %g,%g,%g --look-at %g,%g,%g --up %g,%g,%g --fov %g (%s)", eye[0], eye[1], eye[2],
           eye[0] + forward[0], eye[1] + forward[1], eye[2] + forward[2], up[0], up[1], up[2], fov, source);
}

/* Computes the camera: from the options, otherwise from the file, otherwise such that the bounds of the scene are
   visible. lowest, highest: these bounds. Returns 0 if the directions are degenerate. */
static int camera_place(float world_to_view[16], float view_to_clip[16], const scene_file *file, const int *given,
                        const float lowest[3], const float highest[3]) {
    static const double from[3] = { 0.35, 0.3, 0.89 };  /* unit vector: from the front, slightly from the right and
                                                           above */
    const double radians = atan(1.0) / 45, aspect = (double)camera.size[0] / camera.size[1];
    const scene_file_camera *c = &file->camera;
    double eye[3], at[3], to[3], up[3], fov = camera.fov, half, distance = 0;
    int i, use_file = file->has_camera;
    if (use_file) {  /* a camera with invalid values is ignored */
        float unused[16];
        fov = (double)c->fov_y;
        if (c->fov_x > 0 && c->fov_x < 179) fov = 2 * atan(tan(0.5 * (double)c->fov_x * radians) / aspect) / radians;
        use_file = fov >= 1 && fov <= 179 &&
                   sbl_look_at(unused, 0, 0, 0, c->forward[0], c->forward[1], c->forward[2], c->up[0], c->up[1],
                       c->up[2]);
        for (i = 0; i < 3; i++) use_file = use_file && fabs((double)c->eye[i]) < 1e18;
    }
    if (!use_file || given[FOV]) fov = camera.fov;
    for (i = 0; i < 3; i++) {
        at[i] = 0.5 * ((double)lowest[i] + (double)highest[i]);
        distance += 0.25 * pow((double)highest[i] - (double)lowest[i], 2);
    }
    half = 0.5 * fov * radians;
    if (aspect < 1) half = atan(tan(half) * aspect);
    distance = (distance > 0 ? sqrt(distance) : 1) / sin(half);
    for (i = 0; i < 3; i++) {
        double forward = use_file ? (double)c->forward[i] : -from[i];
        if (given[LOOK_AT]) at[i] = camera.look_at[i];
        eye[i] = given[EYE] ? camera.eye[i] : use_file ? (double)c->eye[i] : at[i] + distance * from[i];
        if (use_file && !given[LOOK_AT]) at[i] = eye[i] + forward;
        up[i] = use_file && !given[UP] ? (double)c->up[i] : camera.up[i];
    }
    for (i = 0; i < 3; i++) at[i] -= eye[i];  /* from here on at is a direction */
    if (!given[LOOK_AT] && at[0] == 0.0 && at[1] == 0.0 && at[2] == 0.0) at[2] = -1;  /* the eye is at the centre of the
                                                                                         scene */
    if (!given[UP] && at[0] == 0.0 && at[2] == 0.0) { up[0] = up[1] = 0; up[2] = at[1] < 0 ? -1 : 1; }
    detail_camera(eye, at, up, fov, given[EYE] && given[LOOK_AT] ? "from the options"
                  : use_file ? given[EYE] || given[LOOK_AT] ? "from the file and the options" : "from the file"
                  : given[EYE] || given[LOOK_AT] ? "from the options; the rest shows the whole scene"
                  : "shows the whole scene");
    /* The direction is made as long as the eye is far from the origin. Otherwise rounding to float would turn the
       camera. */
    distance = sqrt(at[0] * at[0] + at[1] * at[1] + at[2] * at[2]);
    for (i = 0; i < 3; i++)
        to[i] = eye[i] + (distance > 0 ? at[i] / distance * (1 + fabs(eye[0]) + fabs(eye[1]) + fabs(eye[2])) : 0);
    return sbl_perspective(view_to_clip, (float)fov, (float)aspect) &&
           sbl_look_at(world_to_view, (float)eye[0], (float)eye[1], (float)eye[2], (float)to[0], (float)to[1],
               (float)to[2],
                       (float)up[0], (float)up[1], (float)up[2]);
}

static int camera_misuse(void) {
    return misuse("--eye, --look-at, --up: the camera looks along its up vector, or at its own position; change one "
        "of them");
}

#endif
