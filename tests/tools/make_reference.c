/* make_reference FILE.pfm [SIZE [SIDE]]: computes direct light R in the Cornell box through its published camera, with
   the ray caster of the tests. At every pixel it is the closed form of the lamp times its visible share, from two
   estimates of SIDE x SIDE rays each (defaults: SIZE 256, SIDE 16). Pixels that must not be compared are NaN: on the
   lamp, at edges, and where nothing is hit. The program prints the noise, which is the difference of the two
   estimates. */
#define SBL_IMPLEMENTATION
#include "../../sbl.h"
#include "../../examples/cornell_box.h"
#include "../support/reference.h"
#include <stdio.h>

/* Estimates R of a lamp of radiance 1 twice. Returns 0 if the pixel must not be compared. */
static int compared(const ref_scene *scene, const sbl_picture_desc *view, int x, int y, int side, double estimates[2]) {
    const int lamp = 1;
    ref_point p = ref_pixel(scene, view, x, y);
    v3 corners[4];
    int i;
    if (!p.hit || ref_glows(scene, &p) || ref_is_edge(scene, view, x, y)) return 0;
    for (i = 0; i < 4; i++) corners[i] = v3_from(cornell_corners[lamp] + 3 * i);
    for (i = 0; i < 2; i++) {
        uint64_t seed = (uint64_t)(2 * (y * view->width + x) + i) << 32;
        estimates[i] = ref_quad_light(scene, p.position, p.normal, corners, lamp, side, &seed);
    }
    return 1;
}

int main(int argc, char **argv) {
    const int size = argc > 2 ? atoi(argv[2]) : 256, side = argc > 3 ? atoi(argv[3]) : 16;
    const double luminance = 0.2126 * (double)cornell_lamp[0] + 0.7152 * (double)cornell_lamp[1] + 0.0722 *
        (double)cornell_lamp[2];
    cornell_box box;
    ref_scene *scene;
    sbl_picture_desc view;
    float *picture;
    double sum = 0, squares = 0;
    size_t values;
    int x, y, k, count = 0, written;
    FILE *out;
    if (argc < 2 || argc > 4 || size < 1 || size > 4096 || side < 1 || side > 1024) {
        fprintf(stderr, "usage: make_reference FILE.pfm [SIZE [SIDE]]\n");
        return 2;
    }
    memset(&view, 0, sizeof view);
    cornell_box_view(&view, size, size);
    scene = ref_create(cornell_box_make(&box));
    values = (size_t)size * (size_t)size * 3;
    picture = (float *)malloc(values * sizeof *picture);
    if (!picture) abort();
    for (y = 0; y < size; y++)
        for (x = 0; x < size; x++) {
            /* a .pfm stores the bottom row first */
            float *rgb = picture + 3 * ((size_t)(size - 1 - y) * (size_t)size + (size_t)x);
            double e[2];
            int seen = compared(scene, &view, x, y, side, e);
            for (k = 0; k < 3; k++) rgb[k] = seen ? (float)((e[0] + e[1]) / 2 * (double)cornell_lamp[k]) : NAN;
            if (!seen) continue;
            count++;
            sum += (e[0] + e[1]) / 2;
            squares += (e[0] - e[1]) * (e[0] - e[1]) / 4;  /* the variance of the mean of two estimates */
        }
    ref_destroy(scene);
    out = fopen(argv[1], "wb");
    written = out && fprintf(out, "PF\n%d %d\n-1.0\n", size, size) > 0 &&
        fwrite(picture, sizeof *picture, values, out) == values;
    if (out && fclose(out) != 0) written = 0;
    free(picture);
    if (!written) {
        fprintf(stderr, "make_reference: %s cannot be written\n", argv[1]);
        return 1;
    }
    printf("%d pixels, mean %.5f, noise %.3f %%\n", count, sum / count * luminance,
           100 * sqrt(squares / count) / (sum / count));
    return 0;
}
