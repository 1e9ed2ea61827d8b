/* A small plotter: lines with marks over linear or logarithmic axes, ticks with numbers, a title and a legend, into an RGB picture.

       plot p = plot_make("TITLE", "X AXIS", "Y AXIS", 0, 1);
       plot_series *s = plot_add(&p, "LEGEND");
       plot_point(s, 1, 2); ...
       unsigned char *pixels = plot_draw(&p);   PLOT_WIDTH x PLOT_HEIGHT x 3, to be freed

   Legends stand in one row, nine characters each. Text is upper case letters, digits and a little punctuation: the font has no more. */
#ifndef PLOT_H
#define PLOT_H

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { PLOT_WIDTH = 760, PLOT_HEIGHT = 500, PLOT_SERIES = 4, PLOT_POINTS = 32 };

typedef struct plot_series {
    const char *name;
    int count;
    double x[PLOT_POINTS], y[PLOT_POINTS];
} plot_series;

typedef struct plot {
    const char *title, *x_name, *y_name;
    int log_x, log_y;  /* bases 2 and 10; linear axes start at 0 */
    int count;
    plot_series series[PLOT_SERIES];
} plot;

static inline plot plot_make(const char *title, const char *x_name, const char *y_name, int log_x, int log_y) {
    plot p;
    memset(&p, 0, sizeof p);
    p.title = title;
    p.x_name = x_name;
    p.y_name = y_name;
    p.log_x = log_x;
    p.log_y = log_y;
    return p;
}

static inline plot_series *plot_add(plot *p, const char *name) {
    plot_series *s = &p->series[p->count];
    if (p->count == PLOT_SERIES) return NULL;
    p->count++;
    s->name = name;
    return s;
}

static inline void plot_point(plot_series *s, double x, double y) {
    if (!s || s->count == PLOT_POINTS) return;
    s->x[s->count] = x;
    s->y[s->count++] = y;
}

/* ---- the picture: colours are mixed by coverage */

static inline void plot_mix(unsigned char *pixels, int x, int y, const unsigned char color[3], double share) {
    int k;
    if (x < 0 || y < 0 || x >= PLOT_WIDTH || y >= PLOT_HEIGHT || share <= 0) return;
    if (share > 1) share = 1;
    for (k = 0; k < 3; k++) {
        unsigned char *c = &pixels[3 * (y * PLOT_WIDTH + x) + k];
        *c = (unsigned char)(*c + (color[k] - *c) * share + 0.5);
    }
}

/* A line with round ends; a dot where both are the same. */
static inline void plot_line(unsigned char *pixels, double x0, double y0, double x1, double y1, double radius, const unsigned char color[3]) {
    double dx = x1 - x0, dy = y1 - y0, length2 = dx * dx + dy * dy;
    int x, y;
    for (y = (int)(fmin(y0, y1) - radius - 1); y <= (int)(fmax(y0, y1) + radius + 1); y++)
        for (x = (int)(fmin(x0, x1) - radius - 1); x <= (int)(fmax(x0, x1) + radius + 1); x++) {
            double px = x + 0.5 - x0, py = y + 0.5 - y0, t = length2 > 0 ? fmax(0, fmin(1, (px * dx + py * dy) / length2)) : 0;
            plot_mix(pixels, x, y, color, radius + 0.5 - hypot(px - t * dx, py - t * dy));
        }
}

/* Letters are five columns of seven bits, the lowest bit on top. */
static inline const unsigned char *plot_letter(char c) {
    static const char letters[] = " 0123456789ABCDEFGHIJKLMNOPQRSTUVWXYZ.,:-+/()%=";
    static const unsigned char font[sizeof letters - 1][5] = {
        { 0, 0, 0, 0, 0 },
        { 0x3e, 0x51, 0x49, 0x45, 0x3e }, { 0x00, 0x42, 0x7f, 0x40, 0x00 }, { 0x62, 0x51, 0x49, 0x49, 0x46 }, { 0x22, 0x41, 0x49, 0x49, 0x36 },
        { 0x18, 0x14, 0x12, 0x7f, 0x10 }, { 0x27, 0x45, 0x45, 0x45, 0x39 }, { 0x3c, 0x4a, 0x49, 0x49, 0x30 }, { 0x01, 0x71, 0x09, 0x05, 0x03 },
        { 0x36, 0x49, 0x49, 0x49, 0x36 }, { 0x06, 0x49, 0x49, 0x29, 0x1e },
        { 0x7e, 0x09, 0x09, 0x09, 0x7e }, { 0x7f, 0x49, 0x49, 0x49, 0x36 }, { 0x3e, 0x41, 0x41, 0x41, 0x22 }, { 0x7f, 0x41, 0x41, 0x41, 0x3e },
        { 0x7f, 0x49, 0x49, 0x49, 0x41 }, { 0x7f, 0x09, 0x09, 0x09, 0x01 }, { 0x3e, 0x41, 0x49, 0x49, 0x3a }, { 0x7f, 0x08, 0x08, 0x08, 0x7f },
        { 0x00, 0x41, 0x7f, 0x41, 0x00 }, { 0x20, 0x40, 0x40, 0x40, 0x3f }, { 0x7f, 0x08, 0x14, 0x22, 0x41 }, { 0x7f, 0x40, 0x40, 0x40, 0x40 },
        { 0x7f, 0x02, 0x0c, 0x02, 0x7f }, { 0x7f, 0x04, 0x08, 0x10, 0x7f }, { 0x3e, 0x41, 0x41, 0x41, 0x3e }, { 0x7f, 0x09, 0x09, 0x09, 0x06 },
        { 0x3e, 0x41, 0x51, 0x21, 0x5e }, { 0x7f, 0x09, 0x19, 0x29, 0x46 }, { 0x26, 0x49, 0x49, 0x49, 0x32 }, { 0x01, 0x01, 0x7f, 0x01, 0x01 },
        { 0x3f, 0x40, 0x40, 0x40, 0x3f }, { 0x0f, 0x30, 0x40, 0x30, 0x0f }, { 0x3f, 0x40, 0x38, 0x40, 0x3f }, { 0x63, 0x14, 0x08, 0x14, 0x63 },
        { 0x03, 0x04, 0x78, 0x04, 0x03 }, { 0x61, 0x51, 0x49, 0x45, 0x43 },
        { 0x00, 0x60, 0x60, 0x00, 0x00 }, { 0x00, 0xa0, 0x60, 0x00, 0x00 }, { 0x00, 0x36, 0x36, 0x00, 0x00 }, { 0x08, 0x08, 0x08, 0x08, 0x08 },
        { 0x08, 0x08, 0x3e, 0x08, 0x08 }, { 0x60, 0x10, 0x08, 0x04, 0x03 }, { 0x00, 0x1c, 0x22, 0x41, 0x00 }, { 0x00, 0x41, 0x22, 0x1c, 0x00 },
        { 0x63, 0x13, 0x08, 0x64, 0x63 }, { 0x14, 0x14, 0x14, 0x14, 0x14 } };
    const char *found = c ? strchr(letters, c) : NULL;
    return font[found ? found - letters : 0];
}

/* align: -1 starts at x, 0 is centred on it, 1 ends there; y is the middle. scale: pixels a dot. */
static inline void plot_text(unsigned char *pixels, double x, double y, const char *text, int align, int scale) {
    static const unsigned char ink[3] = { 30, 30, 40 };
    int length = (int)strlen(text), left = (int)(x - (align + 1) * 0.5 * (6 * length - 1) * scale), top = (int)(y - 3.5 * scale), i, u, v;
    for (i = 0; i < length; i++)
        for (u = 0; u < 5 * scale; u++)
            for (v = 0; v < 8 * scale; v++)
                if (plot_letter(text[i])[u / scale] >> (v / scale) & 1) plot_mix(pixels, left + 6 * scale * i + u, top + v, ink, 1);
}

/* ---- axes */

typedef struct plot_axis { double low, high, step; int log; } plot_axis;  /* log: exponents of its base */

static inline plot_axis plot_axis_make(const plot *p, int of_y) {
    plot_axis a = { 0, 0, 1, 0 };
    double lowest = 1e300, highest = -1e300;
    int i, k;
    for (i = 0; i < p->count; i++)
        for (k = 0; k < p->series[i].count; k++) {
            double value = of_y ? p->series[i].y[k] : p->series[i].x[k];
            lowest = fmin(lowest, value);
            highest = fmax(highest, value);
        }
    a.log = (of_y ? p->log_y : p->log_x) && lowest > 0 ? (of_y ? 10 : 2) : 0;
    if (highest < lowest) { lowest = 0; highest = 1; }
    if (a.log) {
        a.low = floor(log(lowest) / log(a.log) + 1e-9);
        a.high = fmax(ceil(log(highest) / log(a.log) - 1e-9), a.low + 1);
    } else {
        double power = pow(10, floor(log10(highest > 0 ? highest : 1)));  /* steps of 1, 2 or 5 times a power of ten, 4 to 10 of them */
        a.step = highest / power > 5 ? power : highest / power > 2 ? power / 2 : power / 5;
        a.high = a.step * ceil(fmax(highest, power) / a.step * 1.02);
    }
    return a;
}

static inline double plot_place(const plot_axis *a, double value) {
    return ((a->log ? log(value) / log(a->log) : value) - a->low) / (a->high - a->low);
}

static inline void plot_number(char *text, size_t size, const plot_axis *a, double value) {
    snprintf(text, size, "%.*f", value >= 1 || value == 0 ? (a->log || a->step >= 1 ? 0 : 1) : value >= 0.1 ? 1 : value >= 0.01 ? 2 : 3, value);
}

static inline unsigned char *plot_draw(const plot *p) {
    static const unsigned char colors[PLOT_SERIES][3] = { { 214, 69, 48 }, { 28, 110, 180 }, { 44, 145, 80 }, { 150, 90, 170 } };
    static const unsigned char grid[3] = { 222, 222, 226 }, frame[3] = { 120, 120, 130 };
    const double left = 100, right = PLOT_WIDTH - 30, top = 64, bottom = PLOT_HEIGHT - 70;
    unsigned char *pixels = (unsigned char *)malloc((size_t)PLOT_WIDTH * PLOT_HEIGHT * 3);
    plot_axis axes[2];
    char text[64];
    double tick;
    int i, k;
    if (!pixels) return NULL;
    memset(pixels, 255, (size_t)PLOT_WIDTH * PLOT_HEIGHT * 3);
    for (k = 0; k < 2; k++) {
        const plot_axis *a = &axes[k];
        axes[k] = plot_axis_make(p, k);
        for (tick = a->low; tick <= a->high + 1e-6 * a->step; tick += a->step) {
            double value = a->log ? pow(a->log, tick) : tick, at = plot_place(a, value), x = left + at * (right - left), y = bottom + at * (top - bottom);
            plot_number(text, sizeof text, a, value);
            if (k) plot_line(pixels, left, y, right, y, 0.2, grid); else plot_line(pixels, x, bottom, x, top, 0.2, grid);
            if (k) plot_text(pixels, left - 8, y, text, 1, 2); else plot_text(pixels, x, bottom + 18, text, 0, 2);
        }
    }
    plot_line(pixels, left, bottom, right, bottom, 0.5, frame);
    plot_line(pixels, left, bottom, left, top, 0.5, frame);
    plot_text(pixels, PLOT_WIDTH / 2.0, 14, p->title, 0, 2);
    plot_text(pixels, 12, 40, p->y_name, -1, 2);
    plot_text(pixels, (left + right) / 2, bottom + 46, p->x_name, 0, 2);
    for (i = 0; i < p->count; i++) {
        const plot_series *s = &p->series[i];
        double before_x = 0, before_y = 0;
        for (k = 0; k < s->count; k++) {
            double x = left + plot_place(&axes[0], s->x[k]) * (right - left), y = bottom + plot_place(&axes[1], s->y[k]) * (top - bottom);
            if (k) plot_line(pixels, before_x, before_y, x, y, 1, colors[i]);
            plot_line(pixels, x, y, x, y, 3.5, colors[i]);
            before_x = x;
            before_y = y;
        }
        if (p->count > 1) {
            double x = right - 132.0 * (p->count - i) + 24, y = 40;
            plot_line(pixels, x - 20, y, x - 6, y, 1, colors[i]);
            plot_line(pixels, x - 13, y, x - 13, y, 3.5, colors[i]);
            plot_text(pixels, x, y, s->name, -1, 2);
        }
    }
    return pixels;
}

#endif
