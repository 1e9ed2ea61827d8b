/* Prints the measurement of a sensor: its sums, its rays and its lamps. Include after sbl.h. */
#ifndef SENSOR_WORDS_H
#define SENSOR_WORDS_H

#include <stdio.h>
#include <stdlib.h>

enum { SENSOR_LAMPS_SHOWN = 20 };

static double sensor__sum(const float v[3]) { return (double)v[0] + (double)v[1] + (double)v[2]; }

static void sensor__print_lamp(const sbl_sensor *s, int number) {
    const sbl_sensor_lamp *l = &s->lamps[number];
    if (l->kind == SBL_LAMP_TRIANGLE) printf("  triangle %d of mesh %d:", l->number, l->mesh);
    else printf("  %s %d:", l->kind == SBL_LAMP_LIGHT ? "light" : "texel of the sky", l->number);
    if (sensor__sum(l->unhindered) > 0)
        printf(" unobstructed %g %g %g,", (double)l->unhindered[0], (double)l->unhindered[1], (double)l->unhindered[2]);
    printf(" %d of %d rays arrive\n", l->open, l->rays);
}

/* Prints the lamps with the greatest contributions; a blocked lamp counts with its unblocked contribution. */
static void sensor__print_lamps(const sbl_sensor *s) {
    double *worth = (double *)calloc((size_t)s->lamp_count + 1, sizeof *worth);
    int i, k, best;
    if (!worth) return;
    for (i = 0; i < s->lamp_count; i++) worth[i] = sensor__sum(s->lamps[i].unhindered);
    for (i = 0; i < s->ray_count; i++)
        if (s->rays[i].lamp >= 0) worth[s->rays[i].lamp] += sensor__sum(s->rays[i].radiance);
    for (i = 0; i < s->lamp_count && i < SENSOR_LAMPS_SHOWN; i++) {
        for (k = best = 0; k < s->lamp_count; k++)
            if (worth[k] > worth[best]) best = k;
        sensor__print_lamp(s, best);
        worth[best] = -1;
    }
    if (s->lamp_count > SENSOR_LAMPS_SHOWN) printf("  and %d more lamps\n", s->lamp_count - SENSOR_LAMPS_SHOWN);
    free(worth);
}

/* Prints the measurement of the sensor at a pixel. sheet_sum: sum of weight times radiance over the sheet */
static void sensor_print(const sbl_sensor *s, const int pixel[2], const double sheet_sum[3]) {
    int i, aimed = 0;
    for (i = 0; i < s->ray_count; i++) aimed += s->rays[i].lamp >= 0;
    printf("pixel %d,%d: %s, level %d%s\n", pixel[0], pixel[1],
           s->sensed ? "had a sensor" : "was interpolated; this is what a sensor measures there", s->level,
           s->valid ? "" : ", stuck inside geometry");
    printf("position %g %g %g\nnormal %g %g %g\n", (double)s->position[0], (double)s->position[1],
           (double)s->position[2],
           (double)s->normal[0], (double)s->normal[1], (double)s->normal[2]);
    printf("R %g %g %g\n", (double)s->radiance[0], (double)s->radiance[1], (double)s->radiance[2]);
    if (s->noise > 0) printf("standard error %g\n", (double)s->noise);
    if (s->looks > 1) printf("mean of %d looks; the values below are those of the first look\n", s->looks);
    printf("sum of weight * radiance over the sheet %g %g %g\nsum of weights %.6f, ", sheet_sum[0], sheet_sum[1],
           sheet_sum[2],
           (double)s->weight_sum);
    if (s->view_count) printf("%d views, %d x %d texels\n", s->view_count, s->sheet_width, s->sheet_height);
    else printf("%d rays\n", s->ray_count - aimed);
    if (s->hit_mean > 0)
        printf("back faces %.2f %%, nearest surface %g, mean distance %g\n", 100 * (double)s->back_share,
               (double)s->hit_min, (double)s->hit_mean);
    else printf("no surface was met\n");
    printf("from lamps %g %g %g: %d lamps, %d rays towards them\n", (double)s->from_lamps[0], (double)s->from_lamps[1],
           (double)s->from_lamps[2], s->lamp_count, aimed);
    sensor__print_lamps(s);
}

#endif
