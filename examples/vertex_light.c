/* Demonstrates light at arbitrary points, here the vertices of a finely divided Cornell box. sbl_gather_readings
   measures light at points with normals. vertex_light.ply is the mesh with its light as vertex colours, for any model
   viewer; vertex_light.png is a picture of it. The first argument is the folder for the files. With a second argument,
   the light is a draft with few rays and few cells for bounced light. */
#define SBL_IMPLEMENTATION
#include "headless.h"
#include "cornell_box.h"
#define STB_IMAGE_WRITE_IMPLEMENTATION
#include <stb/stb_image_write.h>

enum { GRID = 40, CELLS = GRID * GRID, SIDE = GRID + 1, PER_QUAD = SIDE * SIDE };  /* each quad is cut into GRID x GRID
                                                                                      cells */
enum { VERTICES = CORNELL_QUADS * PER_QUAD, TRIANGLES = 2 * CORNELL_QUADS * CELLS, ACROSS = 512 };

static const float inset = 0.002f;  /* sites at the edge of a quad are moved inwards by this fraction of the quad, away
                                       from the adjoining wall */

static sbl_site sites[VERTICES];
static sbl_reading readings[VERTICES];
static float positions[VERTICES][3], colors[VERTICES][4], picture[3 * ACROSS * ACROSS];
static unsigned char bytes[3 * VERTICES], pixels[3 * ACROSS * ACROSS];
static unsigned short cells[CELLS][6];  /* corners of the two triangles of each cell; the same for every quad */

static float corner_mix(const float *corners, int axis, float u, float v) {
    const float low = (1 - u) * corners[axis] + u * corners[3 + axis];
    const float high = (1 - u) * corners[9 + axis] + u * corners[6 + axis];
    return (1 - v) * low + v * high;
}

static void vertices_make(void) {
    int quad, i, j, k;
    for (quad = 0; quad < CORNELL_QUADS; quad++) {
        const float *c = cornell_corners[quad];
        float a[3], b[3];
        for (k = 0; k < 3; k++) { a[k] = c[3 + k] - c[k]; b[k] = c[9 + k] - c[k]; }
        for (j = 0; j < SIDE; j++)
            for (i = 0; i < SIDE; i++) {
                const int at = quad * PER_QUAD + j * SIDE + i;
                const float u = (float)i / GRID, v = (float)j / GRID;
                for (k = 0; k < 3; k++) {
                    positions[at][k] = corner_mix(c, k, u, v);
                    sites[at].position[k] = corner_mix(c, k, inset + (1 - 2 * inset) * u, inset + (1 - 2 * inset) * v);
                    sites[at].normal[k] = a[(k + 1) % 3] * b[(k + 2) % 3] - a[(k + 2) % 3] * b[(k + 1) % 3];
                }
            }
    }
    for (j = 0; j < GRID; j++)
        for (i = 0; i < GRID; i++) {
            unsigned short *cell = cells[j * GRID + i], first = (unsigned short)(j * SIDE + i);
            cell[0] = cell[3] = first;
            cell[1] = (unsigned short)(first + 1);
            cell[2] = cell[4] = (unsigned short)(first + SIDE + 1);
            cell[5] = (unsigned short)(first + SIDE);
        }
}

/* Returns 1 if a point is inside geometry: it is stuck, or sees mostly back faces. Here these are points of the floor
   under the blocks. */
static int inside(const sbl_reading *r) { return !r->valid || r->back_share > 0.5f; }

/* Computes the colour of each vertex: emission plus reflected light. Points inside geometry take the light of the
   nearest other point in their row, so that interpolation does not darken the visible edge. */
static void vertices_light(void) {
    int at, k, step;
    for (at = 0; at < VERTICES; at++) {
        const int row = at / SIDE * SIDE, material = cornell_material(at / PER_QUAD);
        const sbl_reading *r = &readings[at];
        for (step = 1; inside(r) && step < SIDE; step++) {
            if (at - step >= row && !inside(&readings[at - step])) r = &readings[at - step];
            else if (at + step < row + SIDE && !inside(&readings[at + step])) r = &readings[at + step];
        }
        for (k = 0; k < 3; k++) {
            const float own = material == CORNELL_LAMP ? cornell_lamp[k] : 0;
            const float light = own + cornell_albedo[material][k] * r->radiance[k];
            colors[at][k] = light < 1 ? light : 1;
            sbl_encode_srgb8(&bytes[3 * at + k], &light, 1, 1);
        }
        colors[at][3] = 1;
    }
}

/* Opens the file of the mesh. This happens before the measurement, so that no work is lost if the file cannot be
   written. */
static FILE *ply_open(const char *folder) {
    char path[1024];
    FILE *file;
    snprintf(path, sizeof path, "%s/vertex_light.ply", folder);
    file = fopen(path, "wb");
    if (!file) fprintf(stderr, "vertex_light: cannot write %s\n", path);
    return file;
}

/* Closes the file. Returns 1 if everything was written. */
static int ply_close(FILE *file) {
    const int failed = ferror(file);
    if (fclose(file) == 0 && !failed) return 1;
    return fprintf(stderr, "vertex_light: cannot write the mesh\n"), 0;
}

static void ply_write(FILE *file) {
    int i;
    fprintf(file, "ply\nformat ascii 1.0\ncomment light at the vertices of the Cornell box\n");
    fprintf(file, "element vertex %d\nproperty float x\nproperty float y\nproperty float z\n", (int)VERTICES);
    fprintf(file, "property uchar red\nproperty uchar green\nproperty uchar blue\n");
    fprintf(file, "element face %d\nproperty list uchar int vertex_indices\nend_header\n", (int)TRIANGLES);
    for (i = 0; i < VERTICES; i++)
        fprintf(file, "%g %g %g %d %d %d\n", (double)positions[i][0], (double)positions[i][1], (double)positions[i][2],
                bytes[3 * i], bytes[3 * i + 1], bytes[3 * i + 2]);
    for (i = 0; i < TRIANGLES; i++) {
        const int quad = i / (2 * CELLS), first = quad * PER_QUAD;
        const unsigned short *corner = cells[i / 2 % CELLS] + 3 * (i % 2);
        fprintf(file, "3 %d %d %d\n", first + corner[0], first + corner[1], first + corner[2]);
    }
}

/* Renders the coloured mesh without lighting, as the albedo channel of a picture. Returns 0 on failure. */
static int picture_make(sbl_context *context) {
    const sbl_material plain = { .albedo = { 1, 1, 1 } };
    sbl_mesh meshes[CORNELL_QUADS] = { { .vertex_count = 0 } };
    const sbl_scene_desc scene = {
        .meshes = meshes, .mesh_count = CORNELL_QUADS, .materials = &plain, .material_count = 1, .sky = { 1, 1, 1 } };
    sbl_picture_desc view = { .options.mode = SBL_MODE_DIRECT,
                              .options.preset = SBL_PRESET_DRAFT,
                              .tile = 1024,
                              .options.rays = 4 }; /* the light is not used, so few rays suffice */
    int quad;
    for (quad = 0; quad < CORNELL_QUADS; quad++) {
        meshes[quad].positions.data = positions[quad * PER_QUAD];
        meshes[quad].colors.data = colors[quad * PER_QUAD];
        meshes[quad].vertex_count = PER_QUAD;
        meshes[quad].indices.data = cells;
        meshes[quad].indices.type = SBL_UINT16;
        meshes[quad].index_count = 6 * CELLS;
    }
    cornell_box_view(&view, ACROSS, ACROSS);
    return sbl_set_scene(context, &scene) == SBL_SUCCESS && sbl_render_picture(context, &view) == SBL_SUCCESS &&
           sbl_read_channel(context, SBL_CHANNEL_ALBEDO, picture, 3 * ACROSS * ACROSS) == SBL_SUCCESS;
}

int main(int argc, char **argv) {
    const char *folder = argc > 1 ? argv[1] : ".";
    const sbl_readings_desc gather = { .sites = sites, .readings = readings, .site_count = VERTICES,
                                       .options.preset = argc > 2 ? SBL_PRESET_DRAFT : SBL_PRESET_DEFAULT,
                                       .options.rays = argc > 2 ? 16 : 0 };
    sbl_context *context;
    cornell_box box;
    sbl_scene_desc scene = *cornell_box_make(&box);
    char path[1024];
    FILE *file = ply_open(folder);
    int i, hidden = 0, ok;
    if (!file) return 1;
    vertices_make();
    if (argc > 2) scene.max_bounce_cells = 2048;
    if (sbl_create(headless("vertex_light"), &context) != SBL_SUCCESS) return 1;  /* sbl.h prints errors to stderr */
    ok = sbl_set_scene(context, &scene) == SBL_SUCCESS &&
         sbl_gather_readings(context, &gather) == SBL_SUCCESS;
    if (ok) {
        for (i = 0; i < VERTICES; i++) hidden += inside(&readings[i]);
        printf("vertex_light: %d vertices, %d of them inside geometry, %.2f s\n", (int)VERTICES, hidden,
               sbl_query_stats(context).seconds.total);
        vertices_light();
        ply_write(file);
        ok = picture_make(context);
    }
    ok = ply_close(file) && ok;
    sbl_destroy(context);
    if (!ok) return 1;
    sbl_encode_srgb8(pixels, picture, 3 * ACROSS * ACROSS, 1);
    snprintf(path, sizeof path, "%s/vertex_light.png", folder);
    if (stbi_write_png(path, ACROSS, ACROSS, 3, pixels, 0)) return 0;
    return fprintf(stderr, "vertex_light: cannot write %s\n", path), 1;
}
