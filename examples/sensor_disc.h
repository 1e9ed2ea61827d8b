/* Draws the view of a traced sensor as a disc. Each direction is projected onto the tangent plane, so that equal areas
   of the disc have equal weight. Each pixel shows the radiance of the nearest ray. Rays to lamps are drawn as dots,
   which are red if the ray is blocked. */
#ifndef SENSOR_DISC_H
#define SENSOR_DISC_H

#include <math.h>

/* Computes two tangents of the sensor. up points towards world +y, or towards -z if the normal is nearly parallel to
   y. */
static void sensor_disc_axes(const sbl_sensor *s, double right[3], double up[3]) {
    const float *n = s->normal;
    const double lean = fabs((double)n[1]) > 0.999;
    double length;
    int k;
    up[0] = 0; up[1] = 1 - lean; up[2] = -lean;
    right[0] = n[1] * up[2] - n[2] * up[1];
    right[1] = n[2] * up[0] - n[0] * up[2];
    right[2] = n[0] * up[1] - n[1] * up[0];
    length = sqrt(right[0] * right[0] + right[1] * right[1] + right[2] * right[2]);
    for (k = 0; k < 3; k++) right[k] /= length;
    up[0] = right[1] * n[2] - right[2] * n[1];
    up[1] = right[2] * n[0] - right[0] * n[2];
    up[2] = right[0] * n[1] - right[1] * n[0];
}

static double sensor_disc_dot(const double a[3], const float b[3]) {
    return a[0] * (double)b[0] + a[1] * (double)b[1] + a[2] * (double)b[2];
}

/* Draws the disc. rgb: receives size * size * 3 linear floats, top row first; black outside of the disc */
static void sensor_disc(const sbl_sensor *s, int size, float *rgb) {
    double right[3], up[3];
    int i, k, x, y;
    sensor_disc_axes(s, right, up);
    for (y = 0; y < size; y++)
        for (x = 0; x < size; x++) {
            const double u = (2 * x + 1.0) / size - 1, v = 1 - (2 * y + 1.0) / size;
            double nearest = 4;
            int ray = -1;
            for (i = 0; i < s->ray_count && s->rays[i].lamp < 0 && u * u + v * v < 1; i++) {
                const double du = sensor_disc_dot(right, s->rays[i].direction) - u;
                const double dv = sensor_disc_dot(up, s->rays[i].direction) - v;
                if (du * du + dv * dv < nearest) { nearest = du * du + dv * dv; ray = i; }
            }
            for (k = 0; k < 3; k++) rgb[3 * (y * size + x) + k] = ray < 0 ? 0 : s->rays[ray].radiance[k];
        }
    for (i = 0; i < s->ray_count; i++) {
        const sbl_sensor_ray *r = &s->rays[i];
        const int open = r->radiance[0] > 0 || r->radiance[1] > 0 || r->radiance[2] > 0, reach = size / 256;
        const int cx = (int)((sensor_disc_dot(right, r->direction) + 1) / 2 * size);
        const int cy = (int)((1 - sensor_disc_dot(up, r->direction)) / 2 * size);
        if (r->lamp < 0) continue;
        for (y = cy - reach; y <= cy + reach; y++)
            for (x = cx - reach; x <= cx + reach; x++)
                for (k = 0; k < 3 && x >= 0 && y >= 0 && x < size && y < size; k++)
                    rgb[3 * (y * size + x) + k] = open ? r->radiance[k] : k == 0;
    }
}

#endif
