/* Computes the directions of the texels of cube maps, and filters cube maps into levels for rough reflections. Needs
   neither GL nor sbl.h.

       cube_tree tree;
       if (!cube_tree_make(&tree, 128, values)) ...          // values: 6 * 128 * 128 colours
       cube_filter(&tree, roughness, 64, level);             // level: 6 * 64 * 64 colours
       cube_tree_free(&tree);

   Faces and rows are those of OpenGL, Vulkan, Direct3D, KTX and glTF: +x, -x, +y, -y, +z, -z, and the first row of a
   face in memory has the texture coordinate 0. A shader that samples the map in a world direction gets the light that
   arrives from that direction. Seen from inside the cube, each face is mirrored, as these formats require.

   The filter is the first sum of the split-sum approximation (B. Karis, "Real Shading in Unreal Engine 4", SIGGRAPH
   2013 course): a GGX lobe with alpha = roughness^2, whose normal, view and reflection have the same direction r. With
   c = dot(r, w), light from w has the weight

       w(c) = c / (alpha^2 + (1 - alpha^2) (1 - c) / 2)^2        if c > 0, otherwise 0

   The filter takes no random samples; it sums over all texels. Where the weight hardly changes, squares of 2^k x 2^k
   texels are added in advance and weighted as one. */
#ifndef CUBE_FILTER_H
#define CUBE_FILTER_H

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { CUBE_FACES = 6, CUBE_SIZE_MAX = 1024, CUBE_DEPTHS = 11 };

/* The axes of each face: the directions in which its columns and its rows run, and the direction of its centre. The
   point (u, v) of a face, both from -1 to 1, has the direction u * columns + v * rows + centre. */
static const float cube_axes[CUBE_FACES][3][3] = {
    { { 0, 0, -1 }, { 0, -1, 0 }, { 1, 0, 0 } },  { { 0, 0, 1 }, { 0, -1, 0 }, { -1, 0, 0 } },
    { { 1, 0, 0 }, { 0, 0, 1 }, { 0, 1, 0 } },    { { 1, 0, 0 }, { 0, 0, -1 }, { 0, -1, 0 } },
    { { 1, 0, 0 }, { 0, -1, 0 }, { 0, 0, 1 } },   { { -1, 0, 0 }, { 0, -1, 0 }, { 0, 0, -1 } }
};
static const char *const cube_names[CUBE_FACES] = { "+x", "-x", "+y", "-y", "+z", "-z" };

/* Computes the unit direction of a point in a face. u, v: -1 to 1 */
static inline void cube_direction(int face, float u, float v, float out[3]) {
    const float scale = 1 / sqrtf(1 + u * u + v * v);
    int k;
    for (k = 0; k < 3; k++)
        out[k] = scale * (u * cube_axes[face][0][k] + v * cube_axes[face][1][k] + cube_axes[face][2][k]);
}

/* Returns the solid angle of the rectangle from the centre of a face to (u, v). Any other rectangle is a sum of four
   such terms. */
static inline double cube__corner(double u, double v) { return atan2(u * v, sqrt(1 + u * u + v * v)); }

/* Returns the solid angle of a texel. size: width of a face in texels */
static inline double cube_solid_angle(int size, int x, int y) {
    const double u = 2.0 * x / size - 1, v = 2.0 * y / size - 1, step = 2.0 / size;
    return cube__corner(u + step, v + step) - cube__corner(u, v + step) - cube__corner(u + step, v) +
           cube__corner(u, v);
}

/* A pyramid of sums over a cube map. Level 0 has one square per face; each further level has four times as many. */
typedef struct cube_tree {
    int depth;                     /* index of the level whose squares are single texels */
    float *sums[CUBE_DEPTHS];      /* for each square: red, green and blue times solid angle, then the solid angle */
} cube_tree;

static inline void cube_tree_free(cube_tree *t) {
    int i;
    for (i = 0; i < CUBE_DEPTHS; i++) free(t->sums[i]);
    memset(t, 0, sizeof *t);
}

/* Computes the pyramid of a cube map. Returns 0 if memory runs out. size: a power of two, at most CUBE_SIZE_MAX.
   values: three floats per texel, face by face */
static inline int cube_tree_make(cube_tree *t, int size, const float *values) {
    int i, x, y, face, k;
    memset(t, 0, sizeof *t);
    while (1 << t->depth < size) t->depth++;
    for (i = t->depth; i >= 0; i--) {
        const int across = 1 << i;
        float *out = (float *)malloc(sizeof(float) * 4 * CUBE_FACES * (size_t)across * (size_t)across);
        t->sums[i] = out;
        if (!out) {
            cube_tree_free(t);
            return 0;
        }
        for (face = 0; face < CUBE_FACES; face++)
            for (y = 0; y < across; y++)
                for (x = 0; x < across; x++, out += 4) {
                    const size_t below = 4 * (((size_t)face * 2 * (size_t)across + 2 * (size_t)y) * 2 * (size_t)across +
                                              2 * (size_t)x);
                    const float *four = i < t->depth ? t->sums[i + 1] + below : NULL;
                    const float solid = four ? 0 : (float)cube_solid_angle(across, x, y);
                    for (k = 0; k < 4; k++)
                        out[k] = four ? four[k] + four[4 + k] + four[8 * across + k] + four[8 * across + 4 + k]
                                      : k < 3 ? solid * *values++ : solid;
                }
    }
    return 1;
}

/* A lobe in the axes of one face, and the sum over the squares so far. */
typedef struct cube_lobe {
    const cube_tree *tree;
    int face;
    float r[3], square;            /* direction of the lobe, and alpha^2 */
    double sum[4];                 /* weighted light in three channels, and the sum of the weights */
} cube_lobe;

#define CUBE__FINENESS 0.12f       /* a square has one weight if it is narrower than this times the width of the lobe;
                                      otherwise each of its quarters has its own */
enum { CUBE__FINER = 3 };          /* where the lobe is narrow, texels are halved up to this many times */

/* Adds the light of a square, or of its four quarters if it is too wide for one weight. A square smaller than a texel
   has the radiance of its texel. */
static inline void cube__add(cube_lobe *lobe, int level, int x, int y) {
    const int depth = lobe->tree->depth, finer = level > depth ? level - depth : 0, across = 1 << level;
    const float half = 1 / (float)across, u = (float)(2 * x + 1) * half - 1, v = (float)(2 * y + 1) * half - 1;
    const float scale = 1 / sqrtf(1 + u * u + v * v);
    const float c = scale * (u * lobe->r[0] + v * lobe->r[1] + lobe->r[2]);
    const float q = lobe->square + (1 - lobe->square) * 0.5f * (1 - c);
    const float width = 2 * half * scale, about = 4 * q < 1 ? 4 * q : 1;  /* about: squared angle at which q doubles */
    if (c < -1.5f * width) return;
    if (level < depth + CUBE__FINER && width * width > CUBE__FINENESS * CUBE__FINENESS * about) {
        cube__add(lobe, level + 1, 2 * x, 2 * y);
        cube__add(lobe, level + 1, 2 * x + 1, 2 * y);
        cube__add(lobe, level + 1, 2 * x, 2 * y + 1);
        cube__add(lobe, level + 1, 2 * x + 1, 2 * y + 1);
    } else if (c > 0) {
        const int stored = across >> finer;
        const float *sums = lobe->tree->sums[level - finer] +
                            4 * (((size_t)lobe->face * (size_t)stored + (size_t)(y >> finer)) * (size_t)stored +
                                 (size_t)(x >> finer));
        const double weight = (double)(c / (q * q)) *
                              (finer ? (double)(4 * half * half * scale * scale * scale / sums[3]) : 1);
        int k;
        for (k = 0; k < 4; k++) lobe->sum[k] += weight * (double)sums[k];
    }
}

/* Computes the light of a lobe around a unit direction. roughness: above 0, up to 1 */
static inline void cube_lobe_light(const cube_tree *tree, double roughness, const float direction[3], float out[3]) {
    const double alpha = roughness * roughness;
    cube_lobe lobe = { tree, 0, { 0, 0, 0 }, (float)(alpha * alpha), { 0, 0, 0, 0 } };
    int i, k;
    for (lobe.face = 0; lobe.face < CUBE_FACES; lobe.face++) {
        const float (*axes)[3] = cube_axes[lobe.face];
        for (i = 0; i < 3; i++)
            lobe.r[i] = axes[i][0] * direction[0] + axes[i][1] * direction[1] + axes[i][2] * direction[2];
        cube__add(&lobe, 0, 0, 0);
    }
    for (k = 0; k < 3; k++) out[k] = (float)(lobe.sum[k] / lobe.sum[3]);
}

/* Computes one filtered level of a cube map. size: width of a face in texels. out: three floats per texel, face by
   face */
static inline void cube_filter(const cube_tree *tree, double roughness, int size, float *out) {
    int face, x, y;
    for (face = 0; face < CUBE_FACES; face++)
        for (y = 0; y < size; y++)
            for (x = 0; x < size; x++, out += 3) {
                float direction[3];
                cube_direction(face, (float)(2 * x + 1) / (float)size - 1, (float)(2 * y + 1) / (float)size - 1,
                               direction);
                cube_lobe_light(tree, roughness, direction, out);
            }
}

#endif
