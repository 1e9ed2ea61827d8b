/* Prints the defaults that sbl.h fills in, one line for each field of a descriptor and each mode:
       DESCRIPTOR FIELD MODE DRAFT DEFAULT HIGH
   DESCRIPTOR is the name without sbl_ and _desc, MODE the number of the requested sbl_mode. tests/tools/defaults.py
   compares the lines with the comments of the fields. */
#include "../../sbl.h"
#include <math.h>
#include <stdio.h>
#include <string.h>

static const sbl_preset presets[3] = { SBL_PRESET_DRAFT, SBL_PRESET_DEFAULT, SBL_PRESET_HIGH };

/* Fills d[0] to d[2] with the defaults of a front end in a mode, one for each preset. */
#define FILL(front_end)                                                  \
    sbl_##front_end##_desc d[3], zero;                                   \
    const char *const name = #front_end;                                 \
    int i;                                                               \
    memset(&zero, 0, sizeof zero);                                       \
    for (i = 0; i < 3; i++) {                                            \
        zero.options.mode = mode;                                        \
        zero.options.preset = presets[i];                                \
        d[i] = sbl_##front_end##_desc_defaults(&zero);                   \
    }                                                                    \
    PRINT(options.mode); PRINT(options.backend); PRINT(options.rays);    \
    PRINT(options.sensor_size); PRINT(options.epsilon);                  \
    PRINT(options.seed); PRINT(options.ray_length)

#define PRINT(field) \
    printf("%s %s %d %g %g %g\n", name, #field, (int)mode, (double)d[0].field, (double)d[1].field, (double)d[2].field)

/* Returns the vertical field of view in degrees, rounded to 4 decimals, as the comment in sbl.h states it. */
static double fov_y(const sbl_picture_desc *d) {
    return floor(2e4 * atan(1 / (double)d->view_to_clip[5]) * 180 / 3.14159265358979323846 + 0.5) / 1e4;
}

static void picture(sbl_mode mode) {
    FILL(picture);
    PRINT(width); PRINT(height); PRINT(window[2]);
    PRINT(world_to_view[0]);
    printf("%s view_to_clip %d %g %g %g\n", name, (int)mode, fov_y(&d[0]), fov_y(&d[1]), fov_y(&d[2]));
    PRINT(sensor_kind); PRINT(sensor_fov);
    PRINT(target_error); PRINT(mean_radiance[0]); PRINT(price); PRINT(mean_final[0]); PRINT(specular_price);
    PRINT(tile); PRINT(threshold); PRINT(facet_limit);
    PRINT(look_rays); PRINT(max_bounce_cells); PRINT(measure_work);
    PRINT(filter_radius); PRINT(samples);
    PRINT(exposure); PRINT(auto_exposure); PRINT(backdrop[0]);
}

static void readings(sbl_mode mode) {
    FILL(readings);
    PRINT(site_count); PRINT(sensor_kind); PRINT(sensor_fov);
}

static void lightmap(sbl_mode mode) {
    FILL(lightmap);
    PRINT(width); PRINT(height); PRINT(window[2]);
    PRINT(mesh_count); PRINT(gutter); PRINT(seams); PRINT(directional); PRINT(grouped); PRINT(supersample);
    PRINT(target_error); PRINT(mean_radiance[0]); PRINT(price); PRINT(look_rays); PRINT(max_bounce_cells);
    PRINT(tile); PRINT(threshold); PRINT(facet_limit); PRINT(filter_radius);
}

static void vertices(sbl_mode mode) {
    FILL(vertices);
    PRINT(mesh_count); PRINT(float_count); PRINT(group_float_count); PRINT(samples); PRINT(average); PRINT(smoothing);
}

static void probes(sbl_mode mode) {
    FILL(probes);
    PRINT(probe_count); PRINT(first_probe); PRINT(grid[0]); PRINT(lowest[0]); PRINT(highest[0]); PRINT(move);
}

static void context(void) {
    const sbl_mode mode = SBL_MODE_DEFAULT;
    const char *const name = "context";
    sbl_context_desc d[3];
    d[0] = d[1] = d[2] = sbl_context_desc_defaults(NULL);
    PRINT(disabled); PRINT(sensor_texture_size); PRINT(batch); PRINT(longest_submission); PRINT(compile_ahead);
    PRINT(memory_budget);
}

int main(void) {
    int mode;
    for (mode = 0; mode < SBL_MODE_COUNT; mode++) {
        picture((sbl_mode)mode);
        readings((sbl_mode)mode);
        if (mode == SBL_MODE_PAPER) continue;  /* only pictures and readings have this mode */
        lightmap((sbl_mode)mode);
        vertices((sbl_mode)mode);
        probes((sbl_mode)mode);
    }
    context();
    return 0;
}
