/* Demonstrates light at the vertices of a coarse mesh, as games use it. sbl_bake_vertices fits the light of the
   vertices by least squares to points on the triangles. The program writes bake_vertices.ply, the Cornell box with its
   light as vertex colours, for any model viewer. It compares the interpolated light with that of a mesh of four times
   as many triangles, and prints the error of the fit and of plain averages. The first argument is the folder for the
   file. With a second argument, the light is a draft with few cells for bounced light. */
#define SBL_IMPLEMENTATION
#include "headless.h"
#include "cornell_box.h"
#include <math.h>
#include <stdio.h>
#include <stdlib.h>

enum { COARSE = 6, FINE = 12 };  /* squares along each side of a quad */

/* The Cornell box, in which each quad is cut into cells x cells squares of two triangles. */
typedef struct box { int cells; float (*positions)[3]; unsigned *indices; } box;

static int vertices_of(int cells) { return CORNELL_QUADS * (cells + 1) * (cells + 1); }

static int box_make(box *b, int cells) {
    const int side = cells + 1;
    unsigned *index;
    int quad, i, j, k;
    b->cells = cells;
    b->positions = (float (*)[3])malloc((size_t)vertices_of(cells) * sizeof *b->positions);
    b->indices = index = (unsigned *)malloc((size_t)(CORNELL_QUADS * cells * cells * 6) * sizeof *b->indices);
    if (!b->positions || !b->indices) return 0;
    for (quad = 0; quad < CORNELL_QUADS; quad++)
        for (j = 0; j < side; j++)
            for (i = 0; i < side; i++) {
                const float *c = cornell_corners[quad], u = (float)i / (float)cells, v = (float)j / (float)cells;
                float *p = b->positions[(quad * side + j) * side + i];
                const unsigned first = (unsigned)((quad * side + j) * side + i), above = first + (unsigned)side;
                for (k = 0; k < 3; k++)
                    p[k] = (1 - v) * ((1 - u) * c[k] + u * c[3 + k]) + v * ((1 - u) * c[9 + k] + u * c[6 + k]);
                if (i == cells || j == cells) continue;
                *index++ = first; *index++ = first + 1; *index++ = above + 1;
                *index++ = first; *index++ = above + 1; *index++ = above;
            }
    return 1;
}

static void box_free(box *b) { free(b->positions); free(b->indices); }

/* Bakes the light of a box. Returns 0 on failure. light: receives three floats per vertex */
static int box_bake(sbl_context *context, const box *b, int average, sbl_preset preset, float *light) {
    const int side = b->cells + 1, triangles = b->cells * b->cells * 6;
    sbl_mesh meshes[CORNELL_QUADS] = { { .vertex_count = 0 } };
    cornell_box plain;
    sbl_scene_desc scene = *cornell_box_make(&plain);
    sbl_vertices_desc bake = { .radiance = light,
                               .float_count = 3 * (size_t)vertices_of(b->cells),
                               .average = average,
                               .options.preset = preset };
    unsigned *local = (unsigned *)malloc((size_t)triangles * sizeof *local);
    int i, ok;
    if (!local) return 0;
    for (i = 0; i < triangles; i++) local[i] = b->indices[i];  /* the indices are the same for every quad */
    for (i = 0; i < CORNELL_QUADS; i++) {
        meshes[i].positions.data = b->positions[i * side * side];
        meshes[i].vertex_count = side * side;
        meshes[i].indices.data = local;
        meshes[i].indices.type = SBL_UINT32;
        meshes[i].index_count = triangles;
        meshes[i].material = cornell_material(i);
    }
    scene.meshes = meshes;
    scene.mesh_count = CORNELL_QUADS;
    if (preset == SBL_PRESET_DRAFT) scene.max_bounce_cells = 8192;
    /* sbl.h prints error messages to stderr */
    ok = sbl_set_scene(context, &scene) == SBL_SUCCESS && sbl_bake_vertices(context, &bake) == SBL_SUCCESS;
    free(local);
    return ok;
}

/* Returns the relative error of the coarse box: the root mean square of its difference from the fine box, divided by
   the mean of the fine box. The light of the coarse box is interpolated within its triangles to the vertices of the
   fine box. */
static double difference(const float *coarse, const float *fine) {
    double sum = 0, mean = 0;
    int quad, i, j, k;
    for (quad = 0; quad < CORNELL_QUADS; quad++)
        for (j = 0; j <= FINE; j++)
            for (i = 0; i <= FINE; i++) {
                const int times = FINE / COARSE, x = i < FINE ? i / times : COARSE - 1,
                    y = j < FINE ? j / times : COARSE - 1;
                const double u = (double)i / times - x, v = (double)j / times - y;
                const float *a = coarse + 3 * ((quad * (COARSE + 1) + y) * (COARSE + 1) + x), *b = a + 3 * (COARSE + 1);
                const float *truth = fine + 3 * ((quad * (FINE + 1) + j) * (FINE + 1) + i);
                for (k = 0; k < 3; k++) {
                    const double shown = u > v ? (1 - u) * (double)a[k] + (u - v) * (double)a[3 + k] + v *
                        (double)b[3 + k]
                                               : (1 - v) * (double)a[k] + (v - u) * (double)b[k] + u * (double)b[3 + k];
                    sum += (shown - (double)truth[k]) * (shown - (double)truth[k]);
                    mean += (double)truth[k];
                }
            }
    k = 3 * vertices_of(FINE);
    return sqrt(sum / k) / (mean / k);
}

/* Opens the file of the mesh. This happens before the bake, so that no work is lost if the file cannot be written. */
static FILE *ply_open(const char *folder) {
    char path[1024];
    FILE *file;
    snprintf(path, sizeof path, "%s/bake_vertices.ply", folder);
    file = fopen(path, "wb");
    if (!file) fprintf(stderr, "bake_vertices: cannot write %s\n", path);
    return file;
}

/* Closes the file. Returns 1 if everything was written. */
static int ply_close(FILE *file) {
    const int failed = ferror(file);
    if (fclose(file) == 0 && !failed) return 1;
    return fprintf(stderr, "bake_vertices: cannot write the mesh\n"), 0;
}

static void ply_write(FILE *file, const box *b, const float *light) {
    const int vertices = vertices_of(b->cells), side = b->cells + 1,
        triangles = CORNELL_QUADS * b->cells * b->cells * 2;
    int i, k;
    fprintf(file, "ply\nformat ascii 1.0\nelement vertex %d\nproperty float x\nproperty float y\nproperty float z\n",
            vertices);
    fprintf(file, "property uchar red\nproperty uchar green\nproperty uchar blue\n");
    fprintf(file, "element face %d\nproperty list uchar int vertex_indices\nend_header\n", triangles);
    for (i = 0; i < vertices; i++) {
        const int material = cornell_material(i / (side * side));
        unsigned char color[3];
        for (k = 0; k < 3; k++) {
            const float own = material == CORNELL_LAMP ? cornell_lamp[k] : 0,
                out = own + cornell_albedo[material][k] * light[3 * i + k];
            sbl_encode_srgb8(&color[k], &out, 1, 1);
        }
        fprintf(file, "%g %g %g %d %d %d\n", (double)b->positions[i][0], (double)b->positions[i][1],
                (double)b->positions[i][2], color[0], color[1], color[2]);
    }
    for (i = 0; i < 3 * triangles; i += 3)
        fprintf(file, "3 %u %u %u\n", b->indices[i], b->indices[i + 1], b->indices[i + 2]);
}

int main(int argc, char **argv) {
    box coarse = { 0, NULL, NULL }, fine = { 0, NULL, NULL };
    float *fitted = (float *)calloc((size_t)vertices_of(COARSE), 3 * sizeof *fitted);
    float *average = (float *)calloc((size_t)vertices_of(COARSE), 3 * sizeof *average);
    float *truth = (float *)calloc((size_t)vertices_of(FINE), 3 * sizeof *truth);
    FILE *file = ply_open(argc > 1 ? argv[1] : ".");
    sbl_context *context = NULL;
    const sbl_preset preset = argc > 2 ? SBL_PRESET_DRAFT : SBL_PRESET_DEFAULT;
    int ok = file && fitted && average && truth && box_make(&coarse, COARSE) && box_make(&fine, FINE) &&
        sbl_create(headless("bake_vertices"), &context) == SBL_SUCCESS;
    ok = ok && box_bake(context, &fine, 0, preset, truth) && box_bake(context, &coarse, 1, preset, average) &&
        box_bake(context, &coarse, 0, preset, fitted);
    if (ok) {
        printf("bake_vertices: %d vertices, off by %.1f %% (by averages %.1f %%), %.2f s\n", vertices_of(COARSE),
               100 * difference(fitted, truth),
               100 * difference(average, truth), sbl_query_stats(context).seconds.total);
        ply_write(file, &coarse, fitted);
    }
    if (file) ok = ply_close(file) && ok;
    sbl_destroy(context);
    box_free(&coarse);
    box_free(&fine);
    free(fitted);
    free(average);
    free(truth);
    return ok ? 0 : 1;
}
