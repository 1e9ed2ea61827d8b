/* Private values of the implementation that tests read. sbl.c defines these functions together with the implementation;
   tests that need no other private names share its object. Include after sbl.h. */
#ifndef INSIDE_H
#define INSIDE_H

float inside_cell_length(const sbl_context *context);       /* edge length of the store's smallest cells */
int inside_glow_count(const sbl_context *context);          /* number of glows, see >>glow in sbl.h */
int inside_most_points(const sbl_context *context);         /* largest number of points of a leaf of the store */
int inside_near_points(const sbl_context *context);         /* number of points, from the fifth of a leaf on, that
                                                               lie where a ray of at most eight cells' length hit */
/* the largest distance of a pixel's sensor from its surface */
float inside_farthest_offset(const sbl_context *context);
void inside_sample_offset(int sample, int samples, float offset[2]);
uint16_t inside_to_half(float value);
float inside_from_half(uint16_t half);
uint64_t inside_saved_sum(const void *bytes, size_t count);  /* the checksum at the end of a saved store */
int inside_gl_is_optional(const char *function);             /* whether sbl.h works without the function "glName" */
/* Casts rays (origin x y z 0, direction x y z 0 each) into the context's scene with shaders_embedded/traverse.glsl.
   Returns whether that works. */
typedef struct traced_hit { float number, distance, b1, b2; } traced_hit;  /* number: of the triangle; < 0: no hit */
int inside_cast(sbl_context *context, const float *rays, int count, traced_hit *hits);
int inside_triangle_count(const sbl_context *context);
const float *inside_triangle_corner(const sbl_context *context, int triangle, int corner);
int inside_node_count(const sbl_context *context); /* number of nodes of the hierarchy */
/* Returns the distance of the pixel's sensor from its surface. */
float inside_pixel_offset(const sbl_context *context, size_t pixel);
int inside_pixel_looks(const sbl_context *context, size_t pixel);  /* number of looks of the picture's pixel */


#if defined _WIN32 && !defined __CYGWIN__
#define INSIDE_CALL __stdcall  /* the calling convention of GL functions */
#else
#define INSIDE_CALL
#endif

/* Replaces glShaderSource in the context, and returns the function that was there. */
typedef void (INSIDE_CALL *inside_source)(unsigned shader, int count, const char *const *strings, const int *lengths);
inside_source inside_replace_source(sbl_context *context, inside_source source);

int inside_guard_units(void); /* number of texture units whose state the guard restores */

/* A square of 17 x 17 pixels, refined no further than its corners. With strips: the left columns are one surface, the
   next columns a second one without any sensor, the rest a third. Each corner's sensor reads light, and its variance is
   100 light^2. */
typedef struct inside_weight { float noise2, bias2, light, split_gain; } inside_weight;
inside_weight inside_weigh_corners(int strips, float light);

/* Returns 1 if a picture with these relative errors needs no further looks or splits. sensors: error of interpolation
   and noise; store: uncertainty of stored light */
int inside_is_exact(float target, double sensors, double store);

/* Returns what a round buys of three things that it could buy, the most worthwhile first: the sum of their gains.
   error2: sum of squared errors of 100 pixels; target: the target error; gains: by how much each reduces error2 */
double inside_bought(float target, double error2, const double gains[3]);

#endif
