/* Prints the defaults as sbl.h fills them in, one field a line: NAME DRAFT DEFAULT HIGH, then those that depend on the mode.
   tests/test_header.sh compares them with the comments beside the fields. */
#define SBL_IMPLEMENTATION
#include "../../sbl.h"
#include <stdio.h>

static double fov_y(const sbl_picture_desc *d) { return 2 * atan(1 / (double)d->view_to_clip[5]) * 180 / SBL__PI; }

int main(void) {
    static const sbl_preset presets[3] = { SBL_PRESET_DRAFT, SBL_PRESET_DEFAULT, SBL_PRESET_HIGH };
    sbl_picture_desc zero = { 0 }, d[3], direct, paper;
    sbl_readings_desc gather = { 0 }, g[3];
    sbl_lightmap_desc lightmap = { 0 }, l[3];
    sbl_probes_desc probes = { 0 }, p[3];
    sbl_vertices_desc vertices = { 0 }, v[3];
    int i;
    zero.options.mode = gather.options.mode = lightmap.options.mode = probes.options.mode = vertices.options.mode = SBL_MODE_AMBIENT;  /* which has an epsilon */
    for (i = 0; i < 3; i++) {
        zero.options.preset = presets[i];
        d[i] = sbl_picture_desc_defaults(&zero);
        gather.options.preset = presets[i];
        g[i] = sbl_readings_desc_defaults(&gather);
        lightmap.options.preset = presets[i];
        l[i] = sbl_lightmap_desc_defaults(&lightmap);
        probes.options.preset = presets[i];
        p[i] = sbl_probes_desc_defaults(&probes);
        vertices.options.preset = presets[i];
        v[i] = sbl_vertices_desc_defaults(&vertices);
    }
    zero.options.preset = SBL_PRESET_DEFAULT;
    zero.options.mode = SBL_MODE_DIRECT;
    direct = sbl_picture_desc_defaults(&zero);
    zero.options.mode = SBL_MODE_PAPER;
    paper = sbl_picture_desc_defaults(&zero);
#define PRINT(field) printf(#field " %g %g %g\n", (double)d[0].field, (double)d[1].field, (double)d[2].field)
    PRINT(width);
    PRINT(height);
    printf("view_to_clip %.4g %.4g %.4g\n", fov_y(&d[0]), fov_y(&d[1]), fov_y(&d[2]));
    PRINT(options.sensor_size);
    PRINT(sensor_fov);
    PRINT(target_error);
    PRINT(options.rays);
    PRINT(tile);
    PRINT(threshold);
    PRINT(options.epsilon);
    PRINT(filter_radius);
    PRINT(samples);
#define PRINT_GATHER(field) printf("gather." #field " %g %g %g\n", (double)g[0].field, (double)g[1].field, (double)g[2].field)
    PRINT_GATHER(options.rays);
    PRINT_GATHER(options.sensor_size);
    PRINT_GATHER(sensor_fov);
    PRINT_GATHER(options.epsilon);
#define PRINT_LIGHTMAP(field) printf("lightmap." #field " %g %g %g\n", (double)l[0].field, (double)l[1].field, (double)l[2].field)
    PRINT_LIGHTMAP(supersample);
    PRINT_LIGHTMAP(width);
    PRINT_LIGHTMAP(height);
    PRINT_LIGHTMAP(gutter);
    PRINT_LIGHTMAP(target_error);
    PRINT_LIGHTMAP(options.rays);
    PRINT_LIGHTMAP(options.sensor_size);
    PRINT_LIGHTMAP(tile);
    PRINT_LIGHTMAP(threshold);
    PRINT_LIGHTMAP(options.epsilon);
    PRINT_LIGHTMAP(filter_radius);
#define PRINT_PROBES(field) printf("probes." #field " %g %g %g\n", (double)p[0].field, (double)p[1].field, (double)p[2].field)
    PRINT_PROBES(move);
    PRINT_PROBES(options.rays);
    PRINT_PROBES(options.sensor_size);
    PRINT_PROBES(options.epsilon);
#define PRINT_VERTICES(field) printf("vertices." #field " %g %g %g\n", (double)v[0].field, (double)v[1].field, (double)v[2].field)
    PRINT_VERTICES(samples);
    PRINT_VERTICES(smoothing);
    PRINT_VERTICES(options.rays);
    PRINT_VERTICES(options.sensor_size);
    PRINT_VERTICES(options.epsilon);
    printf("longest_submission %g\n", (double)sbl_context_desc_defaults(NULL).longest_submission);
    printf("atlas_size %d\n", sbl_context_desc_defaults(NULL).sensor_texture_size);
    printf("threshold in paper mode %g\n", (double)paper.threshold);
    printf("epsilon in direct mode %g\n", (double)direct.options.epsilon);
    printf("mode %s\n", sbl_picture_desc_defaults(NULL).options.mode == SBL_MODE_GI ? "GI" : "another");
    printf("sensor_kind %s, in paper mode %s\n", d[1].sensor_kind == SBL_SENSOR_HEMICUBE ? "HEMICUBE" : "another",
           paper.sensor_kind == SBL_SENSOR_SINGLE ? "SINGLE" : "another");
    return 0;
}
