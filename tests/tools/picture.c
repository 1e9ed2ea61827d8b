/* Checks the pictures that the examples write; test_examples.sh builds and runs it. It decodes with stb_image and
   shares no code with sbl.h. Each command prints its measurements and fails if the picture is not as described:
       picture varied FILE WIDTH HEIGHT     it has that size, and is neither of one colour nor almost black or white
       picture exposed FILE WHITE BLACK     at most these percentages of the pixels are white and black; the standard
                                            deviation of the brightness is at least a tenth of the range
       picture pyramid FILE                 minimal: an orange pyramid with one brighter face, before grey
       picture cornell FILE                 host_context: the Cornell box in the right part, correctly oriented, and a
                                            shape in the left part
       picture charts FILE                  bake_lightmap: 4 x 4 charts, coloured light on the back wall, and no black
                                            texels between charts
       picture slabs WITH BARE              host_draw: lit slabs, their shadow and their emitted light, compared with
                                            the picture without slabs
       picture alike A B [ROWS]             they are equal except for a few pixels; only the first ROWS rows count
       picture plot FILE SERIES             lines of SERIES colours inside the axes
       picture halves FILE                  two pictures side by side, varied and similar, but not the same */
#define STB_IMAGE_IMPLEMENTATION
#define STBI_ONLY_PNG
#include <stb/stb_image.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

typedef struct picture { int width, height; unsigned char *pixels; } picture;

static picture load(const char *path) {
    picture p;
    int channels;
    p.pixels = stbi_load(path, &p.width, &p.height, &channels, 3);
    if (!p.pixels) {
        printf("%s does not decode: %s\n", path, stbi_failure_reason());
        exit(1);
    }
    return p;
}

static const unsigned char *at(const picture *p, int x, int y) { return p->pixels + 3 * (y * p->width + x); }
static int light(const unsigned char *c) { return c[0] + c[1] + c[2]; }

static int fail(const char *what) { return printf("  expected: %s\n", what), 1; }

/* Computes mean and standard deviation of the brightness of the columns x0 to x1 - 1, from 0 to 255. */
static void spread(const picture *p, int x0, int x1, double *mean, double *deviation) {
    double sum = 0, squares = 0, count = (double)(x1 - x0) * p->height;
    int x, y;
    for (y = 0; y < p->height; y++)
        for (x = x0; x < x1; x++) {
            double v = light(at(p, x, y)) / 3.0;
            sum += v;
            squares += v * v;
        }
    *mean = sum / count;
    *deviation = sqrt(fmax(0, squares / count - *mean * *mean));
}

static int varied(const picture *p, int width, int height) {
    double mean, deviation;
    spread(p, 0, p->width, &mean, &deviation);
    printf("%d x %d, mean %.1f, deviation %.1f\n", p->width, p->height, mean, deviation);
    if (p->width != width || p->height != height) return fail("the requested size");
    if (deviation < 8) return fail("a picture that is not of one colour");
    if (mean < 10 || mean > 245) return fail("a picture that is neither black nor white");
    return 0;
}

static int exposed(const picture *p, int white_most, int black_most) {
    const int pixels = p->width * p->height;
    double mean, deviation;
    int x, y, white = 0, black = 0;
    spread(p, 0, p->width, &mean, &deviation);
    for (y = 0; y < p->height; y++)
        for (x = 0; x < p->width; x++) {
            const unsigned char *c = at(p, x, y);
            white += c[0] == 255 && c[1] == 255 && c[2] == 255;
            black += c[0] == 0 && c[1] == 0 && c[2] == 0;
        }
    printf("%.1f %% white, %.1f %% black, deviation %.1f\n", 100.0 * white / pixels, 100.0 * black / pixels, deviation);
    if (100 * white > white_most * pixels) return fail("fewer white pixels");
    if (100 * black > black_most * pixels) return fail("fewer black pixels");
    if (deviation < 25.5) return fail("more contrast");
    return 0;
}

static int pyramid(const picture *p) {
    int x, y, orange = 0, grey = 0, brightest = 0, darkest = 765;
    for (y = 0; y < p->height; y++)
        for (x = 0; x < p->width; x++) {
            const unsigned char *c = at(p, x, y);
            if (c[0] > 1.4 * c[2] && c[0] > c[1] + 10) {
                orange++;
                if (light(c) > brightest) brightest = light(c);
                if (light(c) < darkest) darkest = light(c);
            } else if (abs(c[0] - c[2]) < 50 && light(c) > 150 && light(c) < 750) grey++;
        }
    printf("%d orange pixels, brightness %d to %d; %d grey\n", orange, darkest, brightest, grey);
    if (orange < p->width * p->height / 50) return fail("a pyramid");
    if (brightest < 1.5 * darkest) return fail("faces of different brightness");
    if (grey < p->width * p->height / 3) return fail("a lit room");
    return 0;
}

static int cornell(const picture *p) {
    int side = p->height, left = p->width - side, x, y, red[2] = { 0, 0 }, green[2] = { 0, 0 }, lamp[2] = { 0, 0 },
        shape = 0;
    for (y = 0; y < side; y++)
        for (x = 0; x < side; x++) {
            const unsigned char *c = at(p, left + x, y);
            red[x > side / 2] += c[0] > 2 * c[1] && c[0] > 40;
            green[x > side / 2] += c[1] > 2 * c[0] && c[1] > 40;
            lamp[y > side / 2] += c[0] == 255 && c[1] == 255 && c[2] == 255;
        }
    for (y = 0; y < side; y++)
        for (x = 0; x < left; x++) shape += memcmp(at(p, x, y), at(p, 0, 0), 3) != 0;
    printf("red %d left, %d right; green %d left, %d right; lamp %d above, %d below; shape %d\n", red[0], red[1],
           green[0], green[1], lamp[0], lamp[1], shape);
    if (red[0] < side * side / 20 || red[1] > red[0] / 10) return fail("a red wall on the left");
    if (green[1] < side * side / 20 || green[0] > green[1] / 10) return fail("a green wall on the right");
    if (lamp[0] < side * side / 500 || lamp[1]) return fail("a lamp above");
    if (shape < left * left / 8) return fail("the host's own shape");
    return 0;
}

static int charts(const picture *p) {
    const int cell = p->width / 4;
    const unsigned char *left = at(p, 3 * cell + cell / 16, cell / 3), *right = at(p, 4 * cell - cell / 16, cell / 3),
        *lamp = at(p, cell + cell / 2, cell / 2);
    const unsigned char *top = at(p, 3 * cell + cell / 2, 2 * cell + cell / 2);
    int x, black = 0;
    for (x = 0; x < p->width; x++) black += light(at(p, x, cell)) == 0;
    printf("back wall %d %d %d to %d %d %d; %d black texels between charts\n", left[0], left[1], left[2], right[0],
           right[1], right[2], black);
    if (left[0] * right[1] < 1.1 * left[1] * right[0]) return fail("a back wall that is redder near the red wall, "
                                                                            "greener near the green one");
    if (light(top) < 1.5 * light(lamp) || light(lamp) < 100)
        return fail("a tall block lit by the lamp, and a lamp lit by the room");
    if (black) return fail("charts continued beyond their edges");
    return 0;
}

static int slabs(const picture *with, const picture *bare) {
    int x, y, teal = 0, glowing = 0, shadow = 0, warmed = 0, coloured = 0;
    double light_of_teal = 0;
    if (with->width != bare->width || with->height != bare->height) return fail("pictures of one size");
    for (y = 0; y < with->height; y++)
        for (x = 0; x < with->width; x++) {
            const unsigned char *a = at(with, x, y), *b = at(bare, x, y);
            coloured += abs(b[0] - b[1]) > 12 || abs(b[1] - b[2]) > 12;
            if (a[1] > 1.4 * a[0]) {
                teal++;
                light_of_teal += a[1];
            } else if (a[0] > 240 && a[2] < 140) glowing++;
            else {
                shadow += a[0] < 0.9 * b[0] && a[1] < 0.9 * b[1] && a[2] < 0.9 * b[2];
                warmed += (double)a[0] / (a[2] + 1) > 1.1 * b[0] / (b[2] + 1);
            }
        }
    printf("%d pixels of slabs, green %.1f; %d emit; %d in shadow, %d lit by them; %d coloured without them\n",
           teal, teal ? light_of_teal / teal : 0, glowing, shadow, warmed, coloured);
    if (coloured) return fail("a grey room without the slabs");
    if (teal < with->width * with->height / 100) return fail("slabs");
    if (light_of_teal / teal < 50) return fail("slabs that are lit");
    if (glowing < 200) return fail("slabs that emit");
    if (shadow < with->width * with->height / 200) return fail("their shadow");
    if (warmed < with->width * with->height / 400) return fail("a room lit by their emission");
    return 0;
}

static int alike(const picture *a, const picture *b, int rows) {
    int i, other = 0, size = a->width * (rows ? rows : a->height);
    if (a->width != b->width || a->height != b->height || rows > a->height) return fail("pictures of one size");
    for (i = 0; i < 3 * size; i++) other += abs(a->pixels[i] - b->pixels[i]) > 8;
    printf("%d of %d values differ by more than 8\n", other, 3 * size);
    return other > size / 100 ? fail("alike") : 0;
}

static int plot(const picture *p, int series) {
    int hues[3] = { 0, 0, 0 }, found = 0, x, y, k;
    if (p->width < 400 || p->height < 300) return fail("a plot's size");
    for (y = p->height / 8; y < p->height * 7 / 8; y++)  /* skips the row of the legend at the top */
        for (x = p->width / 8; x < p->width; x++) {
            const unsigned char *c = at(p, x, y);
            if (c[0] > c[1] + 80 && c[0] > c[2] + 80) hues[0]++;
            if (c[2] > c[0] + 80 && c[2] > c[1] + 40) hues[1]++;
            if (c[1] > c[0] + 60 && c[1] > c[2] + 40) hues[2]++;
        }
    /* counts a colour if it has more pixels than a line across the plot whose parts others may cover */
    for (k = 0; k < 3; k++) found += hues[k] > p->width / 8;
    printf("red %d, blue %d, green %d\n", hues[0], hues[1], hues[2]);
    return found == series ? 0 : fail("the given number of lines");
}

static int halves(const picture *p) {
    int side = p->height, x, y, differing = 0;
    double mean[2], deviation[2];
    spread(p, 0, side, &mean[0], &deviation[0]);
    spread(p, p->width - side, p->width, &mean[1], &deviation[1]);
    for (y = 0; y < side; y++)
        for (x = 0; x < side; x++) differing += abs(light(at(p, x, y)) - light(at(p, p->width - side + x, y))) > 6;
    printf("means %.1f and %.1f, deviations %.1f and %.1f, %d pixels differ\n", mean[0], mean[1], deviation[0],
           deviation[1], differing);
    if (p->width <= 2 * side || deviation[0] < 8 || deviation[1] < 8) return fail("two pictures");
    if (fabs(mean[0] - mean[1]) > 0.15 * mean[1]) return fail("the same scene");
    if (differing < side * side / 100) return fail("more noise in one of them");
    return 0;
}

int main(int argc, char **argv) {
    picture a, b;
    int status = 2;
    if (argc < 3) return fprintf(stderr, "usage: see picture.c\n"), 2;
    memset(&b, 0, sizeof b);
    a = load(argv[2]);
    if (strcmp(argv[1], "varied") == 0 && argc == 5) status = varied(&a, atoi(argv[3]), atoi(argv[4]));
    else if (strcmp(argv[1], "exposed") == 0 && argc == 5) status = exposed(&a, atoi(argv[3]), atoi(argv[4]));
    else if (strcmp(argv[1], "pyramid") == 0) status = pyramid(&a);
    else if (strcmp(argv[1], "cornell") == 0) status = cornell(&a);
    else if (strcmp(argv[1], "slabs") == 0 && argc == 4) status = slabs(&a, (b = load(argv[3]), &b));
    else if (strcmp(argv[1], "alike") == 0 && argc >= 4)
        status = alike(&a, (b = load(argv[3]), &b), argc > 4 ? atoi(argv[4]) : 0);
    else if (strcmp(argv[1], "plot") == 0 && argc == 4) status = plot(&a, atoi(argv[3]));
    else if (strcmp(argv[1], "charts") == 0) status = charts(&a);
    else if (strcmp(argv[1], "halves") == 0) status = halves(&a);
    stbi_image_free(a.pixels);
    if (b.pixels) stbi_image_free(b.pixels);
    return status;
}
