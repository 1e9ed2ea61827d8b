/* Part of scene_file.h: the units of lights.

   sbl.h computes with plain numbers. They are consistent if emission and sky are radiance, point and spot lights are
   radiance times area, and directional lights are irradiance. The units of glTF are consistent: nit, candela and lux.
   Blender computes in watts; its exporter ("Khronos glTF Blender I/O") writes emission unchanged, but converts lights:

       since 3.4   Standard, the default: W/m2 times 683 for suns, W times 683 / (4 pi) for point and spot lights
                   Unitless, a setting: the same without 683
       before 3.4  W/m2 for suns, W for point and spot lights

   This file converts the lights back to the unit of emission in Blender, so that a sun of strength 1 has the irradiance
   1. The file does not record the setting, but the intensity of a sun reveals it: 10 lux in Standard mean a strength of
   0.015, which is black in a picture of Blender, whereas the usual strengths, 1 to 10, are 1 to 10 lux in Unitless. */
#ifndef SCENE_UNITS_H
#define SCENE_UNITS_H

#define SCENE__LUMENS_PER_WATT 683
#define SCENE__LUX_MIN 10

static const struct scene__unit {
    double lamp, sun;  /* factors for point and spot lights, and for directional lights */
    const char *note;  /* the assumption, as a note for the user; %d.%d is the version of the exporter */
} scene__units[SCENE_UNITS_COUNT] = {
    { 1, 1, NULL },
    { 1.0 / SCENE__LUMENS_PER_WATT, 1.0 / SCENE__LUMENS_PER_WATT,
      "Blender's exporter %d.%d multiplies lights by 683, but not emission; lights were divided by 683; --light-scale "
      "1 uses them as they are" },
    { 1, 1, "suns below 10 lux show that Blender's exporter %d.%d wrote lights without units; they are used as they "
      "are; --light-scale 0.001464 divides them by 683" },
    { 0.0795774715459477, 1, "Blender's exporter %d.%d writes the watts of point and spot lights as candela; these "
      "were divided by 4 pi; --light-scale 1 uses them as they are" }
};

/* Runs in the child, after the lights are converted: recognises the exporter of Blender by asset.generator, and sets
   file->units. */
static void scene__find_units(scene_file *file, const char *generator) {
    int *version = file->exporter_version, i, k;
    float sun = 0;
    if (sscanf(generator, "Khronos glTF Blender I/O v%4d.%4d", &version[0], &version[1]) != 2) return;
    for (i = 0; i < file->scene.light_count; i++)
        for (k = 0; k < 3 && file->scene.lights[i].kind == SBL_LIGHT_DIRECTIONAL; k++)
            if (file->scene.lights[i].intensity[k] > sun) sun = file->scene.lights[i].intensity[k];
    if (version[0] < 3 || (version[0] == 3 && version[1] < 4)) file->units = SCENE_UNITS_BLENDER_RAW;
    else if (sun > 0 && sun < SCENE__LUX_MIN) file->units = SCENE_UNITS_BLENDER_UNITLESS;
    else file->units = SCENE_UNITS_BLENDER;
}

/* Multiplies the intensities of the lights by a factor. scale: the factor; if negative, the factor that undoes the
   conversion of the exporter */
static inline void scene_file_scale_lights(scene_file *file, double scale) {
    const struct scene__unit *unit = &scene__units[file->units];
    int i, k;
    for (i = 0; i < file->scene.light_count; i++) {
        sbl_light *light = (sbl_light *)(uintptr_t)&file->scene.lights[i];
        const double fitting = light->kind == SBL_LIGHT_DIRECTIONAL ? unit->sun : unit->lamp;
        for (k = 0; k < 3; k++) light->intensity[k] = (float)(light->intensity[k] * (scale < 0 ? fitting : scale));
    }
}

/* Writes a note about the assumption of scene_file_scale_lights for a negative scale, or an empty text if it assumes
   nothing. */
static inline void scene_file_note_units(const scene_file *file, char *out, size_t size) {
    const char *note = scene__units[file->units].note;
    int i, lamps = 0;
    for (i = 0; i < file->scene.light_count; i++) lamps += file->scene.lights[i].kind != SBL_LIGHT_DIRECTIONAL;
    out[0] = 0;
    if (!note || !file->scene.light_count || (file->units == SCENE_UNITS_BLENDER_RAW && !lamps)) return;
    snprintf(out, size, note, file->exporter_version[0], file->exporter_version[1]);
}

#endif
