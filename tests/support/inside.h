/* Private values of the implementation that tests read. sbl.c defines these functions in the same object as the
   implementation. Tests that need other private names include private.h. Include this file after sbl.h. */
#ifndef INSIDE_H
#define INSIDE_H

float inside_cell_length(const sbl_context *context);       /* edge length of the smallest cells of the store */
int inside_glow_count(const sbl_context *context);          /* number of glows; see >>glow in sbl.h */
/* Sets the number of cells that the store of the scene may have, and the number to which a picture may raise it. */
void inside_limit_cells(sbl_context *context, int usual, int most);
int inside_most_cells(const sbl_context *context);          /* the number to which a picture may raise it */
int inside_mirrored(const sbl_context *context);            /* number of clusters of lamps in mirrors, see >>lamps; -1:
                                                               there are glows, and their table has other clusters */
int inside_most_points(const sbl_context *context);         /* largest number of points in a leaf of the store */
int inside_near_points(const sbl_context *context);         /* number of points beyond the first four of their leaf that
                                                               were placed by a ray no longer than eight cells */
/* the largest distance between the sensor of a pixel and its surface */
float inside_farthest_offset(const sbl_context *context);
void inside_sample_offset(int sample, int samples, float offset[2]);
uint16_t inside_to_half(float value);
float inside_from_half(uint16_t half);
uint64_t inside_saved_sum(const void *bytes, size_t count);  /* checksum at the end of a saved store */
int inside_gl_is_optional(const char *function);             /* 1: sbl.h works without the function "glName" */
/* Casts rays (each: origin x y z 0, direction x y z 0) into the scene of the context with
   shaders_embedded/traverse.glsl. Returns 1 on success. */
typedef struct traced_hit { float number, distance, b1, b2; } traced_hit;  /* number: index of the triangle; < 0:
                                                                              none */
int inside_cast(sbl_context *context, const float *rays, int count, traced_hit *hits);
int inside_triangle_count(const sbl_context *context);
const float *inside_triangle_corner(const sbl_context *context, int triangle, int corner);
int inside_node_count(const sbl_context *context); /* number of nodes of the hierarchy */
/* Returns the distance between the sensor of a pixel and its surface. */
float inside_pixel_offset(const sbl_context *context, size_t pixel);
int inside_pixel_looks(const sbl_context *context, size_t pixel);  /* number of looks of a pixel of the picture */


#if defined _WIN32 && !defined __CYGWIN__
#define INSIDE_CALL __stdcall  /* the calling convention of GL functions */
#else
#define INSIDE_CALL
#endif

/* Replaces glShaderSource in the context. Returns the previous function. */
typedef void (INSIDE_CALL *inside_source)(unsigned shader, int count, const char *const *strings, const int *lengths);
inside_source inside_replace_source(sbl_context *context, inside_source source);

int inside_guard_units(void); /* number of texture units whose state the guard restores */

/* Computes the weights of a square of 17 x 17 pixels that has sensors only at its corners. Each sensor measures `light`
   with the variance 100 light^2. strips: 0: all pixels show one surface; 1: the left columns show one surface, the next
   columns a second one, which has no sensor, and the other columns a third one */
typedef struct inside_weight { float noise2, bias2, light, split_gain; } inside_weight;
inside_weight inside_weigh_corners(int strips, float light);

/* Returns 1 if a picture with these relative errors needs no further looks or splits. sensors: error from interpolation
   and noise; store: uncertainty of stored light */
int inside_is_exact(float target, double sensors, double store);

/* Offers a round of refinement three purchases, in order of falling worth. Returns the sum of the gains of those that
   the round buys. It stops as soon as the error is low enough for one round, see sbl__weigh_price. error2: sum of the
   squared errors of 100 pixels; target: the target error; gains: by how much each purchase reduces error2 */
double inside_bought(float target, double error2, const double gains[3]);

/* Offers two rounds of refinement one purchase each, of the given worth. Returns the price of the picture. */
double inside_price(float first, float second);

#endif
