/* The specular lobe for a single reflection, computed in double precision without code of the library: f = F D Vis with
   the GGX distribution (alpha = roughness^2), Smith's height-correlated visibility and Schlick's Fresnel term. The
   normal is z. v and l are unit vectors from the surface to the viewer and to the light. f0 is one channel.
       lobe_brdf(v, l, roughness, f0)            f
       lobe_albedo(mu, roughness, f0)            integral of f cos over the hemisphere; mu is the cosine of v
       lobe_sphere(roughness, f0)                mean of the albedo over the picture of a sphere
       lobe_matte(mu)                            mean of 1 - (1 - v.h)^5 over a Lambertian lobe
       lobe_highlight(v, corners, roughness, f0) integral of f cos over a flat convex quadrilateral that the
                                                 origin sees: the radiance toward v if its sides emit 1.
                                                 A triangle repeats a corner. The part below z = 0 has no effect
   The errors of lobe_albedo and lobe_sphere are at most 2e-4 for mu >= 0.02 and roughness >= 0.05. lobe_highlight
   takes 512 x 512 points at equal steps. Its width must be at most 256 roughness^2 times its distance. */
#ifndef LOBE_H
#define LOBE_H

#include <math.h>

static const double lobe__pi = 3.14159265358979323846;

static inline double lobe__dot(const double *a, const double *b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

static inline double lobe__fresnel(double vh, double f0) {
    const double rest = 1 - fmin(vh, 1), rest2 = rest * rest;  /* products take a tenth of the time of pow */
    return f0 + (1 - f0) * rest2 * rest2 * rest;
}

/* Returns 1 plus the function Lambda of Smith. */
static inline double lobe__lambda(double cosine, double alpha) {
    double tangent = alpha * sqrt(fmax(0, 1 - cosine * cosine)) / cosine;
    return (1 + sqrt(1 + tangent * tangent)) / 2;
}

/* Returns Vis, which is the share of visible facets divided by 4 v.n l.n. */
static inline double lobe__visibility(double mu, double l_z, double alpha) {
    return 1 / (4 * mu * l_z * (lobe__lambda(mu, alpha) + lobe__lambda(l_z, alpha) - 1));
}

static inline double lobe_brdf(const double v[3], const double l[3], double roughness, double f0) {
    double alpha = roughness * roughness, h[3], length, cosine2, spread;
    int i;
    if (v[2] <= 0 || l[2] <= 0) return 0;
    for (i = 0; i < 3; i++) h[i] = v[i] + l[i];
    length = sqrt(lobe__dot(h, h));
    for (i = 0; i < 3; i++) h[i] /= length;
    cosine2 = h[2] * h[2];
    spread = (h[0] * h[0] + h[1] * h[1]) + cosine2 * alpha * alpha;
    return lobe__fresnel(lobe__dot(v, h), f0) * alpha * alpha / (lobe__pi * spread * spread) *
        lobe__visibility(v[2], l[2], alpha);
}

enum { LOBE__STEPS = 512 };

/* Computes the cosines, and sines unless these are NULL, of the middles of `steps` parts of pi. */
static inline void lobe__turns(int steps, double *cosines, double *sines) {
    int i;
    for (i = 0; i < steps; i++) {
        cosines[i] = cos((i + 0.5) / steps * lobe__pi);
        if (sines) sines[i] = sin((i + 0.5) / steps * lobe__pi);
    }
}

/* Returns the albedo, which is a mean over half vectors with the density D cos. Their angles to the normal and around
   it are the points of a grid of steps x steps. steps: at most LOBE__STEPS */
static inline double lobe__albedo(double mu, double roughness, double f0, int steps) {
    double cosines[LOBE__STEPS], sines[LOBE__STEPS], alpha = roughness * roughness, v[3], sum = 0;
    int i, j;
    lobe__turns(steps, cosines, sines);
    v[0] = sqrt(1 - mu * mu);
    v[1] = 0;
    v[2] = mu;
    for (i = 0; i < steps; i++) {
        /* The grid is finer where s is close to 1, because this gives steep facets, which are rare. */
        double s = (i + 0.5) / steps, u = s * s * (3 - 2 * s), tangent = alpha * sqrt(u / (1 - u));
        double weight = 6 * s * (1 - s), h_z = 1 / sqrt(1 + tangent * tangent);
        for (j = 0; j < steps; j++) {
            double h[3], vh, l_z;
            h[0] = tangent * h_z * cosines[j];
            h[1] = tangent * h_z * sines[j];
            h[2] = h_z;
            vh = lobe__dot(v, h);
            l_z = 2 * vh * h_z - mu;
            if (vh <= 0 || l_z <= 0) continue;
            sum += weight * lobe__fresnel(vh, f0) * 4 * vh * l_z / h_z * lobe__visibility(mu, l_z, alpha);
        }
    }
    return sum / steps / steps;
}

static inline double lobe_albedo(double mu, double roughness, double f0) {
    return lobe__albedo(mu, roughness, f0, LOBE__STEPS);
}

static inline double lobe_sphere(double roughness, double f0) {
    enum { STEPS = 100 };
    double sum = 0;
    int i;
    for (i = 0; i < STEPS; i++) {
        double mu = (i + 0.5) / STEPS;
        sum += 2 * mu * lobe__albedo(mu, roughness, f0, 200);
    }
    return sum / STEPS;
}

static inline double lobe_matte(double mu) {
    enum { STEPS = 400 };
    double cosines[STEPS], sum = 0, side = sqrt(1 - mu * mu);
    int i, j;
    lobe__turns(STEPS, cosines, NULL);
    for (i = 0; i < STEPS; i++) {
        double z2 = (i + 0.5) / STEPS, up = mu * sqrt(z2), across = side * sqrt(1 - z2);
        for (j = 0; j < STEPS; j++) sum += lobe__fresnel(sqrt(fmax(0, 1 + up + across * cosines[j]) / 2), 0);
    }
    return 1 - sum / STEPS / STEPS;
}

/* Computes the point (s, t) of the quadrilateral. area: receives the area of the parallelogram of its derivatives, as a
   vector */
static inline void lobe__place(double corners[4][3], double s, double t, double place[3], double area[3]) {
    double along_s[3], along_t[3];
    int i;
    for (i = 0; i < 3; i++) {
        double a = corners[0][i], b = corners[1][i], c = corners[2][i], d = corners[3][i];
        place[i] = (1 - t) * ((1 - s) * a + s * b) + t * ((1 - s) * d + s * c);
        along_s[i] = (1 - t) * (b - a) + t * (c - d);
        along_t[i] = (1 - s) * (d - a) + s * (c - b);
    }
    for (i = 0; i < 3; i++) {
        int j = (i + 1) % 3, k = (i + 2) % 3;
        area[i] = along_s[j] * along_t[k] - along_s[k] * along_t[j];
    }
}

static inline double lobe_highlight(const double v[3], double corners[4][3], double roughness, double f0) {
    enum { STEPS = 512 };
    double sum = 0;
    int i, j, k;
    for (i = 0; i < STEPS; i++) {
        for (j = 0; j < STEPS; j++) {
            double l[3], area[3], distance, facing;
            lobe__place(corners, (i + 0.5) / STEPS, (j + 0.5) / STEPS, l, area);
            distance = sqrt(lobe__dot(l, l));
            for (k = 0; k < 3; k++) l[k] /= distance;
            facing = fabs(lobe__dot(l, area)) / (distance * distance);
            if (l[2] > 0) sum += lobe_brdf(v, l, roughness, f0) * l[2] * facing;
        }
    }
    return sum / STEPS / STEPS;
}

#endif
