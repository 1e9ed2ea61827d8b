/* One version of sbl.h with an interface of plain numbers, so that a program can contain two versions:
   tests/bench/version.c is compiled once with each header. */
#ifndef VERSION_H
#define VERSION_H

typedef struct version_view {
    double eye[3], look_at[3], up[3], fov;  /* fov: vertical, in degrees */
    int width, height;
    float sky;                /* radiance */
} version_view;

typedef struct version_settings {
    int preset;               /* 0 draft, 1 default, 2 high */
    float error;              /* target error; 0: that of the preset. The older version ignores it */
    /* rays: 0: those of the preset; otherwise every pixel has a sensor with this many rays, and there is no filter */
    int rays, seed;
    /* x, y, width, height in pixels of the part to render, from the top left; width 0: everything */
    int window[4];
} version_settings;

typedef struct version_cost { double seconds; long long sensors; } version_cost;

/* All functions return 0 on failure and print the reason on stderr. */
typedef struct version {
    int (*load)(const char *path);
    int (*start)(void (*(*get)(const char *name, void *user))(void), float sky);
    int (*render)(const version_view *view, const version_settings *settings, float *radiance, version_cost *cost);
    void (*stop)(void);
} version;

extern const version version_now, version_before;

#endif
