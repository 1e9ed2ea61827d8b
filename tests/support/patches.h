/* A scene for tests of lightmaps: a ball of 32 charts. Include after lightmap.h and reference.h. */
#ifndef PATCHES_H
#define PATCHES_H

enum { PATCHES_X = 8, PATCHES_Y = 4, PATCH = 4, BALL_X = PATCHES_X * PATCH, BALL_Y = PATCHES_Y * PATCH };

/* The ball has smooth normals, and holes in place of its poles. It consists of patches that are separate charts. This
   computes the position of corner i, j. */
static void ball_corner(int i, int j, float out[3]) {
    const double a = 2 * REF_PI * (i % BALL_X) / BALL_X, b = REF_PI * (0.15 + 0.7 * j / BALL_Y);
    out[0] = (float)(cos(a) * sin(b));
    out[1] = (float)cos(b);
    out[2] = (float)(sin(a) * sin(b));
}

/* Computes the map coordinates of corner i, j in the chart of patch x, y. */
static void ball_place(int x, int y, int i, int j, double out[2]) {
    out[0] = (x + 0.1 + 0.8 * (i - PATCH * x) / PATCH) / PATCHES_X;
    out[1] = (y + 0.1 + 0.8 * (j - PATCH * y) / PATCH) / PATCHES_Y;
}

static void ball_of_patches(test_scene *s, int material) {
    int x, y, i, j, k;
    for (y = 0; y < PATCHES_Y; y++)
        for (x = 0; x < PATCHES_X; x++) {
            float positions[PATCH * PATCH * 6 * 3], uv[PATCH * PATCH * 6 * 2];
            int n = 0;
            sbl_mesh *mesh;
            for (j = PATCH * y; j < PATCH * (y + 1); j++)
                for (i = PATCH * x; i < PATCH * (x + 1); i++)
                    for (k = 0; k < 6; k++, n++) {
                        static const int corners[6][2] = { { 0, 0 }, { 1, 1 }, { 0, 1 }, { 0, 0 }, { 1, 0 }, { 1, 1 } };
                        double place[2];
                        ball_corner(i + corners[k][0], j + corners[k][1], positions + 3 * n);
                        ball_place(x, y, i + corners[k][0], j + corners[k][1], place);
                        uv[2 * n] = (float)place[0];
                        uv[2 * n + 1] = (float)place[1];
                    }
            mesh = scene_mesh(s, material, positions, positions, NULL, n, NULL, 0);
            uv_set(s, mesh, uv);
        }
}

#endif
