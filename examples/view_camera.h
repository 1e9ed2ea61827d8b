/* The camera of sbl_view and its movements. Include after tool_camera.h. */
#ifndef VIEW_CAMERA_H
#define VIEW_CAMERA_H

/* The axes of the camera, as unit vectors. */
typedef struct view_axes { double right[3], up[3], forward[3]; } view_axes;

static double view_dot(const double a[3], const double b[3]) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

static void view_cross(const double a[3], const double b[3], double out[3]) {
    out[0] = a[1] * b[2] - a[2] * b[1];
    out[1] = a[2] * b[0] - a[0] * b[2];
    out[2] = a[0] * b[1] - a[1] * b[0];
}

static void view_unit(double v[3]) {
    const double length = sqrt(view_dot(v, v));
    int k;
    for (k = 0; k < 3 && length > 0; k++) v[k] /= length;
}

static view_axes view_axes_of(const camera_view *c) {
    view_axes a;
    memcpy(a.forward, c->forward, sizeof a.forward);
    view_unit(a.forward);
    view_cross(a.forward, c->up, a.right);
    view_unit(a.right);
    view_cross(a.right, a.forward, a.up);
    return a;
}

/* Rotates v about a unit axis by an angle in radians. */
static void view_turn(double v[3], const double axis[3], double angle) {
    const double along = view_dot(v, axis) * (1 - cos(angle));
    double side[3];
    int k;
    view_cross(axis, v, side);
    for (k = 0; k < 3; k++) v[k] = v[k] * cos(angle) + side[k] * sin(angle) + axis[k] * along;
}

/* Rotates the camera about a point: by `turn` about the up direction, and by `tilt` about its own axis to the right. It
   stops 2 degrees before it looks straight up or down. */
static void view_orbit(camera_view *c, const double pivot[3], double turn, double tilt) {
    const double steepest = cos(atan(1.0) * 2 / 45), before = view_axes_of(c).forward[1];
    double up[3], from[3];
    view_axes a;
    int k;
    memcpy(up, c->up, sizeof up);
    view_unit(up);
    for (k = 0; k < 3; k++) from[k] = c->eye[k] - pivot[k];
    view_turn(c->forward, up, turn);
    view_turn(from, up, turn);
    a = view_axes_of(c);
    memcpy(c->forward, a.forward, sizeof c->forward);
    view_turn(a.forward, a.right, tilt);
    if (fabs(view_dot(a.forward, up)) < steepest || fabs(view_dot(a.forward, up)) < fabs(before)) {
        memcpy(c->forward, a.forward, sizeof c->forward);
        view_turn(from, a.right, tilt);
    }
    for (k = 0; k < 3; k++) c->eye[k] = pivot[k] + from[k];
}

/* Moves the camera along its own axes. */
static void view_move(camera_view *c, double right, double up, double forward) {
    const view_axes a = view_axes_of(c);
    int k;
    for (k = 0; k < 3; k++) c->eye[k] += right * a.right[k] + up * a.up[k] + forward * a.forward[k];
}

/* Returns the distance of a point from the camera, measured along the viewing direction. */
static double view_depth(const camera_view *c, const double at[3]) {
    const view_axes a = view_axes_of(c);
    double to[3];
    int k;
    for (k = 0; k < 3; k++) to[k] = at[k] - c->eye[k];
    return view_dot(to, a.forward);
}

/* Returns the size of a pixel in world units at a depth. */
static double view_pixel(const camera_view *c, double depth) {
    return 2 * depth * tan(c->fov * atan(1.0) / 90) / camera.size[1];
}

/* Computes the clip-space position of a world point. */
static void view_project(const float world_to_view[16], const float view_to_clip[16], const double at[3],
                         float out[4]) {
    const float *m = world_to_view, *p = view_to_clip;
    double v[4];
    int i;
    for (i = 0; i < 4; i++)
        v[i] = (double)m[i] * at[0] + (double)m[4 + i] * at[1] + (double)m[8 + i] * at[2] + (double)m[12 + i];
    for (i = 0; i < 4; i++)
        out[i] = (float)((double)p[i] * v[0] + (double)p[4 + i] * v[1] + (double)p[8 + i] * v[2] +
                         (double)p[12 + i] * v[3]);
}

#endif
