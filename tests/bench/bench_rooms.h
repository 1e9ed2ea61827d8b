/* The rooms that the benches measure, with their cameras. Include after sbl.h and scene_file.h. */
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

/* Loads a room. Sets the scene, and the size and camera of the view. Returns NULL and prints a message on failure. */
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

/* A random room: a box with boxes and balls, and lamps or a window with sky. The constants with which sbl_progress
   predicts times were chosen with these rooms, so that the rooms of ../shared can test them. */
typedef struct bench_random {
    float positions[400000][3], albedo[3][3];
    unsigned indices[600000];
    sbl_mesh meshes[3];          /* furniture, walls, lamps */
    sbl_material materials[3];
    int vertices, corners;
    uint32_t seed;
} bench_random;

static inline float bench_number(bench_random *b, float from, float to) {
    b->seed = b->seed * 1664525u + 1013904223u;
    return from + (to - from) * (float)(b->seed >> 8) / 16777216.0f;
}

/* Adds a parallelogram of n x n quads. */
static inline void bench_grid(bench_random *b, const float p[4][3], int n) {
    int x, y, k;
    for (y = 0; y <= n; y++)
        for (x = 0; x <= n; x++, b->vertices++)
            for (k = 0; k < 3; k++) {
                const float u = (float)x / (float)n, v = (float)y / (float)n;
                b->positions[b->vertices][k] = (1 - v) * ((1 - u) * p[0][k] + u * p[1][k]) +
                                               v * ((1 - u) * p[3][k] + u * p[2][k]);
            }
    for (y = 0; y < n; y++)
        for (x = 0; x < n; x++) {
            const unsigned first = (unsigned)(b->vertices - (n + 1) * (n + 1) + y * (n + 1) + x), w = (unsigned)n + 1;
            const unsigned quad[6] = { 0, 1, w + 1, 0, w + 1, w };
            for (k = 0; k < 6; k++) b->indices[b->corners++] = first + quad[k];
        }
}

/* Adds a box that is rotated about the vertical axis, or a ball if round is 1. faces: mask of the faces that exist,
   with the bits 2 * axis + side */
static inline void bench_box(bench_random *b, const float at[3], const float size[3], float turn, int n, int round,
                             int faces) {
    int axis, side, k, i;
    for (axis = 0; axis < 3; axis++)
        for (side = 0; side < 2; side++) {
            const int first = b->vertices;
            float p[4][3];
            if (!(faces >> (2 * axis + side) & 1)) continue;
            for (k = 0; k < 4; k++) {
                const float u = k == 1 || k == 2 ? 1.0f : -1.0f, v = k > 1 ? 1.0f : -1.0f;
                p[k][axis] = side ? 1.0f : -1.0f;
                p[k][(axis + 1) % 3] = side ? u : v;
                p[k][(axis + 2) % 3] = side ? v : u;
            }
            bench_grid(b, (const float (*)[3])p, n);
            for (i = first; i < b->vertices; i++) {
                float *q = b->positions[i], x, length = sqrtf(q[0] * q[0] + q[1] * q[1] + q[2] * q[2]);
                for (k = 0; k < 3; k++) q[k] *= size[k] / (round ? length : 1);
                x = q[0];
                q[0] = at[0] + cosf(turn) * x - sinf(turn) * q[2];
                q[1] += at[1];
                q[2] = at[2] + sinf(turn) * x + cosf(turn) * q[2];
            }
        }
}

static inline void bench_mesh(bench_random *b, int mesh, int first) {
    sbl_mesh *m = &b->meshes[mesh];
    m->positions.data = b->positions;
    m->vertex_count = b->vertices;
    m->indices.data = b->indices + first;
    m->indices.type = SBL_UINT32;
    m->index_count = b->corners - first;
    m->material = mesh;
}

/* Makes the room of a seed. Returns NULL if memory runs out. */
static inline bench_random *bench_room_random(unsigned seed, int width, int height, sbl_scene_desc *scene,
                                              sbl_picture_desc *view) {
    bench_random *b = (bench_random *)calloc(1, sizeof *b);
    float half[3], zero[3] = { 0, 0, 0 };
    int i, k, first, lamps, window;
    if (!b) return NULL;
    b->seed = seed * 2654435761u + 12345u;
    for (i = 0; i < 8; i++) bench_number(b, 0, 1);
    half[0] = bench_number(b, 1.5f, 5); half[1] = bench_number(b, 1.2f, 2); half[2] = bench_number(b, 1.5f, 5);
    window = bench_number(b, 0, 1) < 0.35f;
    for (i = (int)bench_number(b, 1, 30); i > 0; i--) {
        float size[3], at[3];
        const int round = bench_number(b, 0, 1) < 0.4f;
        const float fine = bench_number(b, 0, 1);
        const int n = round ? 4 + (int)(20 * fine) : 1 + (int)(6 * fine * fine);
        for (k = 0; k < 3; k++) size[k] = bench_number(b, 0.05f, 0.5f);
        if (round) size[1] = size[2] = size[0];
        for (k = 0; k < 3; k++) at[k] = bench_number(b, -0.8f, 0.8f) * half[k];
        at[1] = bench_number(b, 0, 1) < 0.7f ? size[1] - half[1] : at[1];
        bench_box(b, at, size, bench_number(b, 0, 3), n, round, 63);
    }
    bench_mesh(b, 0, 0);
    first = b->corners;
    bench_box(b, zero, half, 0, 1, 0, window ? 62 : 63);
    for (i = first; i < b->corners; i += 3) {  /* the walls face inward */
        const unsigned corner = b->indices[i];
        b->indices[i] = b->indices[i + 1];
        b->indices[i + 1] = corner;
    }
    if (window) {  /* the left wall is a frame of four pieces around the window */
        const float sill = bench_number(b, 0.2f, 0.8f), wide = bench_number(b, 0.2f, 0.9f);
        float at[3] = { 0, 0, 0 }, size[3];
        at[0] = -half[0]; size[0] = 0.01f;
        size[1] = half[1]; size[2] = half[2] * (1 - wide) / 2;
        at[2] = half[2] - size[2]; bench_box(b, at, size, 0, 1, 0, 63);
        at[2] = -at[2]; bench_box(b, at, size, 0, 1, 0, 63);
        at[2] = 0; size[2] = half[2]; size[1] = half[1] * sill / 2;
        at[1] = size[1] - half[1]; bench_box(b, at, size, 0, 1, 0, 63);
        at[1] = half[1] - size[1] / 2; size[1] /= 2; bench_box(b, at, size, 0, 1, 0, 63);
    }
    bench_mesh(b, 1, first);
    first = b->corners;
    lamps = window && bench_number(b, 0, 1) < 0.6f ? 0 : 1 + (int)(20 * powf(bench_number(b, 0, 1), 3));
    for (i = 0; i < lamps; i++) {
        float size[3], at[3];
        for (k = 0; k < 3; k++) {
            size[k] = bench_number(b, 0.03f, 0.4f);
            at[k] = bench_number(b, -0.8f, 0.8f) * half[k];
        }
        size[1] = 0.02f;
        at[1] = half[1] - (bench_number(b, 0, 1) < 0.7f ? 0.05f : bench_number(b, 0.05f, 1.5f * half[1]));
        bench_box(b, at, size, 0, 1, 0, 63);
    }
    bench_mesh(b, 2, first);
    for (k = 0; k < 3; k++) {
        b->materials[0].albedo[k] = bench_number(b, 0.2f, 0.9f);
        b->materials[1].albedo[k] = bench_number(b, 0.3f, 0.85f);
        b->materials[2].emission[k] = bench_number(b, 4, 12);
    }
    memset(scene, 0, sizeof *scene);
    for (k = 0; k < 3; k++) scene->sky[k] = window ? bench_number(b, 0.8f, 1.2f) : 0;
    scene->meshes = b->meshes;
    scene->mesh_count = lamps ? 3 : 2;
    scene->materials = b->materials;
    scene->material_count = 3;
    memset(view, 0, sizeof *view);
    view->width = width;
    view->height = height;
    sbl_look_at(view->world_to_view, 0.9f * half[0], bench_number(b, -0.3f, 0.6f) * half[1], 0.9f * half[2], 0,
                bench_number(b, -0.5f, 0.2f), 0, 0, 1, 0);
    sbl_perspective(view->view_to_clip, bench_number(b, 40, 75), (float)width / (float)height);
    return b;
}

/* Returns the seconds of a clock such as CLOCK_MONOTONIC. */
static inline double bench_clock(clockid_t id) {
    struct timespec t;
    clock_gettime(id, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

#endif
