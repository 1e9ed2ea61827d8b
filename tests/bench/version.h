/* One version of sbl.h behind plain numbers, so that a program can hold two of them: tests/bench/version.c is compiled
   once with each header. */
#ifndef VERSION_H
#define VERSION_H

typedef struct version_view {
    double eye[3], look_at[3], up[3], fov;  /* fov: vertical, degrees */
    int width, height;
    float sky;                /* radiance */
} version_view;

typedef struct version_settings {
    int preset;               /* 0 draft, 1 default, 2 high */
    float error;              /* 0: the preset's. Only the newer version has it */
    /* rays: 0: the preset's; else a sensor with so many stands at every pixel, and nothing is smoothed */
    int rays, seed;
    int window[4];            /* x, y, width, height of the pixels wanted, from the top left; width 0: all */
} version_settings;

typedef struct version_cost { double seconds; long long sensors; } version_cost;

/* All return 0 where they fail; why is on stderr. */
typedef struct version {
    int (*load)(const char *path);
    int (*start)(void (*(*get)(const char *name, void *user))(void), float sky);
    int (*render)(const version_view *view, const version_settings *settings, float *radiance, version_cost *cost);
    void (*stop)(void);
} version;

extern const version version_now, version_before;

#endif
