/* The rooms that benches measure, with their cameras. Include after sbl.h and scene_file.h. */
#ifndef BENCH_ROOMS_H
#define BENCH_ROOMS_H

#include <time.h>

typedef struct bench_room {
    const char *name, *file;
    float eye[3], at[3], up[3], fov, sky;
} bench_room;

static const bench_room bench_rooms[] = {
    { "cornell_box", "examples/scenes/cornell_box.obj", { 278, 273, -800 }, { 278, 273, 0 }, { 0, 1, 0 }, 39.3077f, 0 },
    { "staircase2", "../shared/scenes/staircase2/staircase2.glb", { 6.91182f, 1.65163f, 2.55414f },
      { 6.011643f, 1.65163f, 2.118617f }, { 0, 1, 0 }, 70, 0 },
    { "living-room", "../shared/scenes/living-room/living-room.glb", { 5.10518f, 0.731065f, -2.31789f },
      { 4.143388f, 0.805472f, -2.054414f }, { 0.071763f, 0.997228f, -0.019659f }, 58.7155f, 1 },
    { "veach-ajar", "../shared/scenes/veach-ajar/veach-ajar.glb", { 4.05402f, 1.61647f, -2.30652f },
      { 3.064005f, 1.584172f, -2.443733f }, { -0.0319925f, 0.999478f, -0.00443408f }, 35.9834f, 0 }
};
enum { BENCH_ROOMS = sizeof bench_rooms / sizeof *bench_rooms };

static inline int bench_room_exists(const bench_room *r) {
    FILE *file = fopen(r->file, "rb");
    if (file) fclose(file);
    return file != NULL;
}

/* Loads a room. Sets the scene, and the size and the camera of the view. Returns NULL, with a message, on failure. */
static inline scene_file *bench_room_load(const bench_room *r, int width, int height, sbl_scene_desc *scene,
                                          sbl_picture_desc *view) {
    char error[512];
    scene_file *file = scene_file_load(r->file, NULL, error, sizeof error);
    int i;
    if (!file) { fprintf(stderr, "%s\n", error); return NULL; }
    *scene = file->scene;
    for (i = 0; i < 3; i++) scene->sky[i] = r->sky;
    view->width = width;
    view->height = height;
    sbl_look_at(view->world_to_view, r->eye[0], r->eye[1], r->eye[2], r->at[0], r->at[1], r->at[2], r->up[0], r->up[1],
                r->up[2]);
    sbl_perspective(view->view_to_clip, r->fov, (float)width / (float)height);
    return file;
}

/* Returns the seconds of a clock, such as CLOCK_MONOTONIC. */
static inline double bench_clock(clockid_t id) {
    struct timespec t;
    clock_gettime(id, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

#endif
