/* Prints the defaults as sbl.h fills them in, one field a line: NAME DRAFT DEFAULT HIGH, then those that depend on the
   mode. tests/test_header.sh compares them with the comments beside the fields. */
#define SBL_IMPLEMENTATION
#include "../../sbl.h"
#include <stdio.h>

static double fov_y(const sbl_picture_desc *d) { return 2 * atan(1 / (double)d->view_to_clip[5]) * 180 / SBL__PI; }

int main(void) {
    static const sbl_preset presets[3] = { SBL_PRESET_DRAFT, SBL_PRESET_DEFAULT, SBL_PRESET_HIGH };
    sbl_picture_desc zero = { 0 }, d[3], direct, paper;
    sbl_gather_desc gather = { 0 }, g[3];
    sbl_lightmap_desc lightmap = { 0 }, l[3];
    sbl_probes_desc probes = { 0 }, p[3];
    sbl_vertices_desc vertices = { 0 }, v[3];
    int i;
    /* which has an epsilon */
    zero.mode = gather.mode = lightmap.mode = probes.mode = vertices.mode = SBL_MODE_AMBIENT;
    for (i = 0; i < 3; i++) {
        zero.preset = presets[i];
        d[i] = sbl_picture_desc_defaults(&zero);
        gather.preset = presets[i];
        g[i] = sbl_gather_desc_defaults(&gather);
        lightmap.preset = presets[i];
        l[i] = sbl_lightmap_desc_defaults(&lightmap);
        probes.preset = presets[i];
        p[i] = sbl_probes_desc_defaults(&probes);
        vertices.preset = presets[i];
        v[i] = sbl_vertices_desc_defaults(&vertices);
    }
    zero.preset = SBL_PRESET_DEFAULT;
    zero.mode = SBL_MODE_DIRECT;
    direct = sbl_picture_desc_defaults(&zero);
    zero.mode = SBL_MODE_PAPER;
    paper = sbl_picture_desc_defaults(&zero);
#define PRINT(field) printf(#field " %g %g %g\n", (double)d[0].field, (double)d[1].field, (double)d[2].field)
    PRINT(width);
    PRINT(height);
    printf("view_to_clip %.4g %.4g %.4g\n", fov_y(&d[0]), fov_y(&d[1]), fov_y(&d[2]));
    PRINT(sensor_size);
    PRINT(sensor_fov);
    PRINT(error);
    PRINT(rays);
    PRINT(tile);
    PRINT(threshold);
    PRINT(epsilon);
    PRINT(filter_radius);
    PRINT(samples);
#define PRINT_GATHER(field) \
    printf("gather." #field " %g %g %g\n", (double)g[0].field, (double)g[1].field, (double)g[2].field)
    PRINT_GATHER(rays);
    PRINT_GATHER(sensor_size);
    PRINT_GATHER(sensor_fov);
    PRINT_GATHER(epsilon);
#define PRINT_LIGHTMAP(field) \
    printf("lightmap." #field " %g %g %g\n", (double)l[0].field, (double)l[1].field, (double)l[2].field)
    PRINT_LIGHTMAP(supersample);
    PRINT_LIGHTMAP(width);
    PRINT_LIGHTMAP(height);
    PRINT_LIGHTMAP(gutter);
    PRINT_LIGHTMAP(error);
    PRINT_LIGHTMAP(rays);
    PRINT_LIGHTMAP(sensor_size);
    PRINT_LIGHTMAP(tile);
    PRINT_LIGHTMAP(threshold);
    PRINT_LIGHTMAP(epsilon);
    PRINT_LIGHTMAP(filter_radius);
#define PRINT_PROBES(field) \
    printf("probes." #field " %g %g %g\n", (double)p[0].field, (double)p[1].field, (double)p[2].field)
    PRINT_PROBES(move);
    PRINT_PROBES(rays);
    PRINT_PROBES(sensor_size);
    PRINT_PROBES(epsilon);
#define PRINT_VERTICES(field) \
    printf("vertices." #field " %g %g %g\n", (double)v[0].field, (double)v[1].field, (double)v[2].field)
    PRINT_VERTICES(samples);
    PRINT_VERTICES(smoothing);
    PRINT_VERTICES(rays);
    PRINT_VERTICES(sensor_size);
    PRINT_VERTICES(epsilon);
    printf("longest_submission %g\n", (double)sbl_context_desc_defaults(NULL).longest_submission);
    printf("atlas_size %d\n", sbl_context_desc_defaults(NULL).atlas_size);
    printf("threshold in paper mode %g\n", (double)paper.threshold);
    printf("epsilon in direct mode %g\n", (double)direct.epsilon);
    printf("mode %s\n", sbl_picture_desc_defaults(NULL).mode == SBL_MODE_GI ? "GI" : "another");
    printf("sensor_kind %s, paper mode %s\n", d[1].sensor_kind == SBL_SENSOR_HEMICUBE ? "HEMICUBE" : "another",
           paper.sensor_kind == SBL_SENSOR_SINGLE ? "SINGLE" : "another");
    return 0;
}
