/* bench: measures how fast sbl.h gathers light.
       bench [raster] [trace] [lamps] [--json] [--quick] [FILE...]     default: all parts
   raster: the gain from gathering in batches, in the Cornell box of 32 triangles. For each kind of sensor and several
   sizes, three times are measured alternately in one process and one GL context:
       sbl      the gather of a picture with a sensor at every pixel (sbl_stats.seconds.gather)
       plain    the same work without batches, by GL code in this file: for every sensor a clear, one draw per view, two
                reduction passes and a readback. It uses the same points, normals, projections, texel formats, weights
                and sums, but does not rotate the views about the normal
       fill     the time that GL needs to fill as many texels as the views of the sensors have, times the mean depth
                complexity of the scene (counted by additive blending); each pass writes a constant to a complete target
   trace: the cost of rays in the Cornell box, in rooms of 1,000 to 1,000,000 triangles, and in scene FILEs (default:
   two rooms beside the repository, if they exist). They are compared with rasterised sensors of about the same error
   and, if it is installed, with Embree. Every pixel has a sensor. There are no lamps: each surface radiates its albedo,
   so that the light is smooth. All scenes and methods are measured alternately.
   lamps: see bench_lamps.h.
   The bench prints the medians of the runs; --json prints them as one JSON object; --quick measures less. A slow result
   is never a failure. The bench fails only if something does not work, or if two methods find different light. */
#define _DEFAULT_SOURCE
#define SBL_IMPLEMENTATION
#include "../../sbl.h"
#include "../../examples/cornell_box.h"
#include "../../examples/host_gl.h"
#include "../../examples/scene_file.h"
#include "bench_embree.h"
#include <stdlib.h>
#include <time.h>

enum { SIZES = 4, RUNS_MOST = 7, FILL_SIZE = 2048, BLOCK = 8 };
static const int sizes[SIZES] = { 16, 32, 64, 128 };

typedef struct vec3 { float x, y, z; } vec3;

static vec3 vec3_make(float x, float y, float z) { vec3 v; v.x = x; v.y = y; v.z = z; return v; }
static vec3 vec3_mix(vec3 a, float s, vec3 b) { return vec3_make(a.x + s * b.x, a.y + s * b.y, a.z + s * b.z); }
static vec3 vec3_cross(vec3 a, vec3 b) {
    return vec3_make(a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x);
}
static float vec3_dot(vec3 a, vec3 b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
static vec3 vec3_unit(vec3 a) { return vec3_mix(vec3_make(0, 0, 0), 1 / sqrtf(vec3_dot(a, a)), a); }

static double now(void) {
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static int fail(const char *what) { return fprintf(stderr, "bench: %s\n", what), 0; }

/* Returns the seconds at which an error is reached, by linear interpolation in the logarithms of both between the two
   neighbouring measured points, or by extrapolation from the last two. */
static double seconds_at(const double *seconds, const double *errors, int count, double error) {
    int i = 0;
    while (i + 2 < count && errors[i + 1] > error) i++;
    if (!(errors[i] > errors[i + 1])) return seconds[i];
    return seconds[i] * exp(log(seconds[i + 1] / seconds[i]) * log(error / errors[i]) / log(errors[i + 1] / errors[i]));
}

/* ---- gathering without batches */

static const char draw_vertex[] =
    "layout(location = 0) in vec3 position;\n"
    "layout(location = 1) in vec3 light;\n"
    "uniform mat4 world_to_clip;\n"
    "flat out vec3 radiance;\n"
    "void main() { radiance = light; gl_Position = world_to_clip * vec4(position, 1.0); }\n";
static const char draw_fragment[] =
    "flat in vec3 radiance;\n"
    "layout(location = 0) out vec4 color;\n"
    "void main() { color = vec4(radiance, 1.0 / gl_FragCoord.w); }\n";
static const char count_fragment[] =
    "layout(location = 0) out vec4 color;\n"
    "void main() { color = vec4(1); }\n";
static const char full_vertex[] = "void main() { gl_Position = vec4(vec2(gl_VertexID & 1, gl_VertexID >> 1) * 4.0 - "
    "1.0, 0.0, 1.0); }\n";
static const char block_fragment[] =
    "uniform sampler2D texels, weights;\n"
    "layout(location = 0) out vec4 color;\n"
    "void main() {\n"
    "    ivec2 corner = ivec2(gl_FragCoord.xy) * 8, size = textureSize(texels, 0);\n"
    "    vec4 sum = vec4(0);\n"
    "    for (int y = 0; y < 8; y++)\n"
    "        for (int x = 0; x < 8; x++) {\n"
    "            ivec2 at = corner + ivec2(x, y);\n"
    "            if (at.x < size.x && at.y < size.y) sum += texelFetch(weights, at, 0).x * texelFetch(texels, at, 0);\n"
    "        }\n"
    "    color = sum;\n"
    "}\n";
static const char sum_fragment[] =
    "uniform sampler2D blocks;\n"
    "layout(location = 0) out vec4 color;\n"
    "void main() {\n"
    "    ivec2 size = textureSize(blocks, 0);\n"
    "    vec4 sum = vec4(0);\n"
    "    for (int y = 0; y < size.y; y++)\n"
    "        for (int x = 0; x < size.x; x++) sum += texelFetch(blocks, ivec2(x, y), 0);\n"
    "    color = sum;\n"
    "}\n";
static const char fill_fragment[] =
    "layout(location = 0) out vec4 color;\n"
    "void main() { color = vec4(0.5, 0.25, 0.125, 1); }\n";

typedef struct target { GLuint texture, depth, framebuffer; } target;

static int target_make(target *t, GLint format, int width, int height, int with_depth) {
    gl.GenTextures(1, &t->texture);
    gl.BindTexture(GL_TEXTURE_2D, t->texture);
    gl.TexImage2D(GL_TEXTURE_2D, 0, format, width, height, 0, GL_RGBA, GL_FLOAT, NULL);
    gl.TexParameteri(GL_TEXTURE_2D, GL_TEXTURE_MIN_FILTER, GL_NEAREST);
    gl.TexParameteri(GL_TEXTURE_2D, GL_TEXTURE_MAG_FILTER, GL_NEAREST);
    gl.GenFramebuffers(1, &t->framebuffer);
    gl.BindFramebuffer(GL_FRAMEBUFFER, t->framebuffer);
    gl.FramebufferTexture2D(GL_FRAMEBUFFER, GL_COLOR_ATTACHMENT0, GL_TEXTURE_2D, t->texture, 0);
    t->depth = 0;
    if (with_depth) {
        gl.GenTextures(1, &t->depth);
        gl.BindTexture(GL_TEXTURE_2D, t->depth);
        gl.TexImage2D(GL_TEXTURE_2D, 0, GL_DEPTH_COMPONENT32F, width, height, 0, GL_DEPTH_COMPONENT, GL_FLOAT, NULL);
        gl.FramebufferTexture2D(GL_FRAMEBUFFER, GL_DEPTH_ATTACHMENT, GL_TEXTURE_2D, t->depth, 0);
    }
    return gl.CheckFramebufferStatus(GL_FRAMEBUFFER) == GL_FRAMEBUFFER_COMPLETE ||
        fail("the driver cannot draw to float textures");
}

static void target_free(target *t) {
    gl.DeleteFramebuffers(1, &t->framebuffer);
    gl.DeleteTextures(1, &t->texture);
    if (t->depth) gl.DeleteTextures(1, &t->depth);
}

static struct {
    GLuint draw, count, block, sum, fill;  /* GL programs */
    GLuint vertex_array, vertex_buffer, empty_array;
    target fill_target;
} plain;

static int plain_start(const cornell_box *box, float epsilon) {
    static float vertices[CORNELL_TRIANGLES * 3][6];
    static const int corner[6] = { 0, 1, 2, 0, 2, 3 };
    int i, k, n = 0;
    plain.draw = host_gl_program("bench", "", draw_vertex, draw_fragment);
    plain.count = host_gl_program("bench", "", draw_vertex, count_fragment);
    plain.block = host_gl_program("bench", "", full_vertex, block_fragment);
    plain.sum = host_gl_program("bench", "", full_vertex, sum_fragment);
    plain.fill = host_gl_program("bench", "", full_vertex, fill_fragment);
    if (!plain.draw || !plain.count || !plain.block || !plain.sum || !plain.fill) return 0;
    for (i = 0; i < CORNELL_QUADS; i++)
        for (k = 0; k < 6; k++, n++) {
            const sbl_material *m = &box->materials[cornell_material(i)];
            int c;
            memcpy(vertices[n], cornell_corners[i] + 3 * corner[k], 3 * sizeof(float));
            for (c = 0; c < 3; c++) vertices[n][3 + c] = m->emission[0] > 0 ? m->emission[c] : epsilon * m->albedo[c];
        }
    gl.GenVertexArrays(1, &plain.empty_array);
    gl.GenVertexArrays(1, &plain.vertex_array);
    gl.BindVertexArray(plain.vertex_array);
    gl.GenBuffers(1, &plain.vertex_buffer);
    gl.BindBuffer(GL_ARRAY_BUFFER, plain.vertex_buffer);
    gl.BufferData(GL_ARRAY_BUFFER, (GLsizeiptr)sizeof vertices, vertices, GL_STATIC_DRAW);
    for (i = 0; i < 2; i++) {
        gl.VertexAttribPointer((GLuint)i, 3, GL_FLOAT, GL_FALSE, (GLsizei)sizeof vertices[0],
                               (const void *)(3 * sizeof(float) * (size_t)i));
        gl.EnableVertexAttribArray((GLuint)i);
    }
    return target_make(&plain.fill_target, GL_RGBA16F, FILL_SIZE, FILL_SIZE, 0);
}

static void plain_stop(void) {
    gl.DeleteProgram(plain.draw);
    gl.DeleteProgram(plain.count);
    gl.DeleteProgram(plain.block);
    gl.DeleteProgram(plain.sum);
    gl.DeleteProgram(plain.fill);
    gl.DeleteVertexArrays(1, &plain.vertex_array);
    gl.DeleteVertexArrays(1, &plain.empty_array);
    gl.DeleteBuffers(1, &plain.vertex_buffer);
    target_free(&plain.fill_target);
}

/* One kind of sensor at one size, with its views side by side on a sheet. The sides of a hemicube end at the
   horizon. */
typedef struct sheet {
    int size, views, width, height, rects[5][4];
    float half;          /* half of the width of a view at unit distance */
    int blocks[2];
    GLuint weights;
    target texels, block_sums, sum;
} sheet;

/* Returns the form factor (projected solid angle / pi) of a rectangle in the plane at unit distance, by the
   antiderivative at its four corners. top: 1: the plane is perpendicular to the normal; 0: it contains the direction of
   the normal, and y is the height above the horizon */
static double texel_weight(int top, double x0, double x1, double y0, double y1) {
    double sum = 0;
    int i;
    for (i = 0; i < 4; i++) {
        double x = i & 1 ? x1 : x0, y = i & 2 ? y1 : y0, sign = i == 0 || i == 3 ? 1 : -1;
        double a = sqrt(1 + x * x), b = sqrt(1 + y * y);
        if (top) sum += sign * 0.5 * (x / a * atan(y / a) + y / b * atan(x / b));
        else sum += sign * 0.5 * -(1 / b) * atan(x / b);
    }
    return sum / (4 * atan(1.0));
}

static int sheet_make(sheet *s, int hemicube, int size) {
    /* in units of half the size of a view */
    static const int cells[5][4] = { { 0, 0, 2, 2 }, { 2, 0, 2, 1 }, { 2, 1, 2, 1 }, { 0, 2, 2, 1 }, { 2, 2, 2, 1 } };
    float *weights;
    int view, x, y, k;
    memset(s, 0, sizeof *s);
    s->size = size;
    s->views = hemicube ? 5 : 1;
    s->half = hemicube ? 1 : (float)tan(135.0 / 2 * atan(1.0) / 45);
    s->width = hemicube ? 2 * size : size;
    s->height = hemicube ? 3 * size / 2 : size;
    weights = (float *)calloc((size_t)(s->width * s->height), sizeof(float));
    if (!weights) return fail("out of memory");
    for (view = 0; view < s->views; view++) {
        int *r = s->rects[view];
        for (k = 0; k < 4; k++) r[k] = cells[view][k] * size / 2;
        for (y = 0; y < r[3]; y++)
            for (x = 0; x < r[2]; x++) {
                double h = (double)s->half, x0 = h * (2.0 * x / size - 1),
                    y0 = view ? 2.0 * y / size : h * (2.0 * y / size - 1), step = 2 * h / size;
                weights[(r[1] + y) * s->width + r[0] + x] =
                    (float)texel_weight(view == 0, x0, x0 + step, y0, y0 + step);
            }
    }
    gl.GenTextures(1, &s->weights);
    gl.BindTexture(GL_TEXTURE_2D, s->weights);
    gl.TexImage2D(GL_TEXTURE_2D, 0, GL_R32F, s->width, s->height, 0, GL_RED, GL_FLOAT, weights);
    gl.TexParameteri(GL_TEXTURE_2D, GL_TEXTURE_MIN_FILTER, GL_NEAREST);
    gl.TexParameteri(GL_TEXTURE_2D, GL_TEXTURE_MAG_FILTER, GL_NEAREST);
    free(weights);
    s->blocks[0] = (s->width + BLOCK - 1) / BLOCK;
    s->blocks[1] = (s->height + BLOCK - 1) / BLOCK;
    return target_make(&s->texels, GL_RGBA16F, s->width, s->height, 1) &&
           target_make(&s->block_sums, GL_RGBA32F, s->blocks[0], s->blocks[1], 0) &&
               target_make(&s->sum, GL_RGBA32F, 1, 1, 0);
}

static void sheet_free(sheet *s) {
    gl.DeleteTextures(1, &s->weights);
    target_free(&s->texels);
    target_free(&s->block_sums);
    target_free(&s->sum);
}

/* Computes world_to_clip of one view, column by column. Depth is 1 - near / distance; there is no far plane. */
static void view_matrix(const sheet *s, int view, vec3 eye, vec3 normal, float m[16]) {
    const float near = 0.5f;
    vec3 tangent = vec3_unit(vec3_cross(normal, fabsf(normal.x) > 0.5f ? vec3_make(0, 1, 0) : vec3_make(1, 0, 0)));
    vec3 bitangent = vec3_cross(normal, tangent), forward = normal, up = bitangent, right = tangent, rows[4];
    float offsets[4];
    int i;
    if (view) {
        vec3 around[4];
        around[0] = tangent;
        around[1] = bitangent;
        around[2] = vec3_mix(vec3_make(0, 0, 0), -1, tangent);
        around[3] = vec3_mix(vec3_make(0, 0, 0), -1, bitangent);
        forward = around[view - 1];
        up = normal;
        right = vec3_cross(forward, up);
    }
    rows[0] = vec3_mix(vec3_make(0, 0, 0), 1 / s->half, right);
    rows[1] = view ? vec3_mix(vec3_mix(vec3_make(0, 0, 0), 2, up), -1, forward)
        : vec3_mix(vec3_make(0, 0, 0), 1 / s->half, up);  /* a side view shows y from 0 to 1 */
    rows[2] = rows[3] = forward;
    for (i = 0; i < 4; i++) offsets[i] = -vec3_dot(rows[i], eye);
    offsets[2] -= 2 * near;  /* clip z = w - 2 near */
    for (i = 0; i < 4; i++) {
        m[i] = rows[i].x;
        m[4 + i] = rows[i].y;
        m[8 + i] = rows[i].z;
        m[12 + i] = offsets[i];
    }
}

static void views_draw(const sheet *s, GLuint program, vec3 eye, vec3 normal) {
    GLint uniform = host_gl_uniform(program, "world_to_clip");
    float matrix[16];
    int view;
    gl.UseProgram(program);
    gl.BindVertexArray(plain.vertex_array);
    for (view = 0; view < s->views; view++) {
        const int *r = s->rects[view];
        view_matrix(s, view, eye, normal, matrix);
        gl.Viewport(r[0], r[1], r[2], r[3]);
        gl.UniformMatrix4fv(uniform, 1, GL_FALSE, matrix);
        gl.DrawArrays(GL_TRIANGLES, 0, 3 * CORNELL_TRIANGLES);
    }
}

static void texture_use(GLuint program, const char *name, GLint unit, GLuint texture) {
    gl.ActiveTexture(GL_TEXTURE0 + (GLenum)unit);
    gl.BindTexture(GL_TEXTURE_2D, texture);
    gl.Uniform1i(host_gl_uniform(program, name), unit);
}

/* Computes the weighted sum of the texels of a sheet in two passes, and reads it back. */
static void sheet_sum(const sheet *s, float sum[4]) {
    gl.Disable(GL_DEPTH_TEST);
    gl.BindVertexArray(plain.empty_array);
    gl.BindFramebuffer(GL_FRAMEBUFFER, s->block_sums.framebuffer);
    gl.Viewport(0, 0, s->blocks[0], s->blocks[1]);
    gl.UseProgram(plain.block);
    texture_use(plain.block, "texels", 0, s->texels.texture);
    texture_use(plain.block, "weights", 1, s->weights);
    gl.DrawArrays(GL_TRIANGLES, 0, 3);
    gl.BindFramebuffer(GL_FRAMEBUFFER, s->sum.framebuffer);
    gl.Viewport(0, 0, 1, 1);
    gl.UseProgram(plain.sum);
    texture_use(plain.sum, "blocks", 0, s->block_sums.texture);
    gl.DrawArrays(GL_TRIANGLES, 0, 3);
    gl.ReadPixels(0, 0, 1, 1, GL_RGBA, GL_FLOAT, sum);
}

typedef struct points { int count; vec3 *positions, *normals; } points;

/* Measures light at all points. Returns the seconds. mean: receives the mean light */
static double plain_gather(const sheet *s, const points *p, double mean[3]) {
    double start = now();
    int i, k;
    for (k = 0; k < 3; k++) mean[k] = 0;
    for (i = 0; i < p->count; i++) {
        float sum[4];
        gl.BindFramebuffer(GL_FRAMEBUFFER, s->texels.framebuffer);
        gl.ClearColor(0, 0, 0, 0);
        gl.ClearDepth(1);
        gl.Clear(GL_COLOR_BUFFER_BIT | GL_DEPTH_BUFFER_BIT);
        gl.Enable(GL_DEPTH_TEST);
        gl.DepthFunc(GL_LESS);
        views_draw(s, plain.draw, vec3_mix(p->positions[i], 0.01f, p->normals[i]), p->normals[i]);
        sheet_sum(s, sum);
        for (k = 0; k < 3; k++) mean[k] += (double)sum[k] / p->count;
    }
    return now() - start;
}

/* Returns the mean number of fragments per texel of the views, without a depth test. */
static double depth_complexity(const sheet *s, const points *p) {
    float *texels = (float *)malloc((size_t)(s->width * s->height) * 4 * sizeof(float));
    double sum = 0;
    int i, k;
    if (!texels) return 0;
    gl.BindFramebuffer(GL_FRAMEBUFFER, s->texels.framebuffer);
    gl.Disable(GL_DEPTH_TEST);
    gl.Enable(GL_BLEND);
    gl.BlendFunc(GL_ONE, GL_ONE);
    for (i = 0; i < p->count; i++) {
        gl.ClearColor(0, 0, 0, 0);
        gl.Clear(GL_COLOR_BUFFER_BIT);
        views_draw(s, plain.count, vec3_mix(p->positions[i], 0.01f, p->normals[i]), p->normals[i]);
        gl.ReadPixels(0, 0, s->width, s->height, GL_RGBA, GL_FLOAT, texels);
        for (k = 0; k < s->width * s->height; k++) sum += (double)texels[4 * k];
    }
    gl.Disable(GL_BLEND);
    free(texels);
    return sum / p->count / (s->width * s->height);
}

/* Returns the seconds per texel of passes that write a constant to a complete target in the format of the view
   texture. */
static double fill_seconds(int passes) {
    double start;
    int i;
    gl.Disable(GL_DEPTH_TEST);
    gl.BindFramebuffer(GL_FRAMEBUFFER, plain.fill_target.framebuffer);
    gl.Viewport(0, 0, FILL_SIZE, FILL_SIZE);
    gl.BindVertexArray(plain.empty_array);
    gl.UseProgram(plain.fill);
    gl.DrawArrays(GL_TRIANGLES, 0, 3);
    gl.Finish();
    start = now();
    for (i = 0; i < passes; i++) {
        gl.DrawArrays(GL_TRIANGLES, 0, 3);
        gl.Finish();  /* waits after each pass, because a tiling renderer omits passes that the next one overwrites */
    }
    return (now() - start) / passes / ((double)FILL_SIZE * FILL_SIZE);
}

/* ---- gathering with sbl.h */

/* Profiles a gather. sbl.h gets GL functions that wait for the GPU before and after each call; this happens in a
   separate run, which is not timed otherwise. A gather starts with an instanced draw of its views and ends with the
   reading of its results; draws over the complete target in between are the reduction. */
enum { CLEAR, DRAW, REDUCE, READ, PARTS };
static struct { int on, drawn, read; double seconds[PARTS]; } profile;

static double profile_start(void) {
    gl.Finish();
    return now();
}

static void profile_end(int part, double start) {
    gl.Finish();
    profile.seconds[part] += now() - start;
}

static void APIENTRY clear_buffer(GLenum buffer, GLint index, const GLfloat *value) {
    double start = profile.on ? profile_start() : 0;
    gl.ClearBufferfv(buffer, index, value);
    if (profile.on) profile_end(CLEAR, start);
}

static void APIENTRY draw_instanced(GLenum mode, GLsizei count, GLenum type, const void *indices, GLsizei instances) {
    double start = profile.on ? profile_start() : 0;
    gl.DrawElementsInstanced(mode, count, type, indices, instances);
    if (profile.on) profile_end(DRAW, start);
    profile.drawn = 1;
    profile.read = 0;
}

/* A single triangle that covers a target belongs to the reduction if views have been drawn before. */
static void APIENTRY draw_arrays_instanced(GLenum mode, GLint first, GLsizei count, GLsizei instances) {
    const int reduces = count == 3 && instances == 1 && profile.drawn && !profile.read;
    double start = profile.on ? profile_start() : 0;
    gl.DrawArraysInstanced(mode, first, count, instances);
    if (profile.on && reduces) profile_end(REDUCE, start);
}

static void APIENTRY read_pixels(GLint x, GLint y, GLsizei width, GLsizei height, GLenum format, GLenum type,
                                 void *pixels) {
    double start = profile.on ? profile_start() : 0;
    gl.ReadPixels(x, y, width, height, format, type, pixels);
    if (profile.on && profile.drawn) profile_end(READ, start);
    profile.read = 1;
}

static sbl_gl_function gl_function(const char *name, void *user) {
    (void)user;
    if (strcmp(name, "glClearBufferfv") == 0) return (sbl_gl_function)clear_buffer;
    if (strcmp(name, "glDrawElementsInstanced") == 0) return (sbl_gl_function)draw_instanced;
    if (strcmp(name, "glDrawArraysInstanced") == 0) return (sbl_gl_function)draw_arrays_instanced;
    if (strcmp(name, "glReadPixels") == 0) return (sbl_gl_function)read_pixels;
    return eglGetProcAddress(name);
}

static int box_render(sbl_context *context, int hemicube, int size, int side, sbl_stats *stats) {
    sbl_picture_desc view = { 0 };
    cornell_box_view(&view, side, side);
    view.options.mode = SBL_MODE_AMBIENT;
    view.sensor_kind = hemicube ? SBL_SENSOR_HEMICUBE : SBL_SENSOR_SINGLE;
    view.options.backend = SBL_BACKEND_RASTER;
    view.options.sensor_size = size;
    view.options.rays = 256;
    view.tile = 1;
    view.filter_radius = -1;
    view.samples = 1;
    if (sbl_render_picture(context, &view) != SBL_SUCCESS) return 0;  /* sbl.h has printed the reason to stderr */
    *stats = sbl_query_stats(context);
    return stats->sensors.sites > 0 || fail("the picture has no sensors");
}

/* Reads every stride-th surface point of the finished picture, and the mean R that sbl.h measured at these points. */
static int points_read(sbl_context *context, int side, int most, points *p, double mean[3]) {
    size_t pixels = (size_t)side * (size_t)side, i, count = 0, stride;
    float *values = (float *)malloc(pixels * 10 * sizeof(float));
    float *position = values, *normal = values + 3 * pixels, *radiance = values + 6 * pixels, *id = values + 9 * pixels;
    int k, ok;
    p->count = 0;
    p->positions = (vec3 *)malloc(2 * (size_t)most * sizeof(vec3));
    p->normals = p->positions + most;
    ok = values && p->positions && sbl_read_channel(context, SBL_CHANNEL_POSITION, position, 3 * pixels) ==
        SBL_SUCCESS &&
         sbl_read_channel(context, SBL_CHANNEL_NORMAL, normal, 3 * pixels) == SBL_SUCCESS &&
         sbl_read_channel(context, SBL_CHANNEL_RADIANCE, radiance, 3 * pixels) == SBL_SUCCESS &&
             sbl_read_channel(context, SBL_CHANNEL_ID, id, pixels) == SBL_SUCCESS;
    for (k = 0; k < 3; k++) mean[k] = 0;
    for (i = 0; ok && i < pixels; i++) count += id[i] > 0;
    stride = count / (size_t)most + 1;
    for (i = 0, count = 0; ok && i < pixels && p->count < most; i++) {
        if (!(id[i] > 0) || count++ % stride) continue;
        p->positions[p->count] = vec3_make(position[3 * i], position[3 * i + 1], position[3 * i + 2]);
        p->normals[p->count] = vec3_make(normal[3 * i], normal[3 * i + 1], normal[3 * i + 2]);
        p->count++;
        for (k = 0; k < 3; k++) mean[k] += (double)radiance[3 * i + (size_t)k];
    }
    for (k = 0; k < 3 && p->count; k++) mean[k] /= p->count;
    free(values);
    return ok && p->count > 0;
}

/* ---- raster: the runs */

typedef struct row {
    int hemicube, size, runs;
    double sbl[RUNS_MOST], total[RUNS_MOST], plain[RUNS_MOST], fill[RUNS_MOST];  /* in microseconds per sensor */
    double speedup[RUNS_MOST], over_fill[RUNS_MOST];                              /* ratios within a run */
    /* in microseconds per sensor, from a separate run */
    double parts[PARTS];
    /* light_ratio: mean R of sbl.h divided by that of the method without batches */
    double complexity, light_ratio;
    long long sensors;
} row;

static int ascending(const void *a, const void *b) {
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

static double median(const double *values, int count) {
    double sorted[RUNS_MOST];
    memcpy(sorted, values, (size_t)count * sizeof sorted[0]);
    qsort(sorted, (size_t)count, sizeof sorted[0], ascending);
    return count & 1 ? sorted[count / 2] : (sorted[count / 2 - 1] + sorted[count / 2]) / 2;
}

static int row_measure(sbl_context *context, row *r, int runs, int side, int most) {
    sheet s;
    points p = { 0, NULL, NULL };
    sbl_stats stats;
    double light[3], plain_light[3];
    int run, ok;
    /* this first picture also warms up the driver */
    ok = sheet_make(&s, r->hemicube, r->size) && box_render(context, r->hemicube, r->size, side, &stats) &&
         points_read(context, side, most, &p, light);
    if (ok) r->complexity = depth_complexity(&s, &p);
    if (ok) plain_gather(&s, &p, plain_light);
    for (run = 0; ok && run < runs; run++) {
        int n = r->runs;
        double texels = (double)s.width * s.height;
        ok = box_render(context, r->hemicube, r->size, side, &stats);
        if (!ok) break;
        r->sensors = (long long)stats.sensors.sites;
        r->sbl[n] = 1e6 * stats.seconds.gather / (double)stats.sensors.sites;
        r->total[n] = 1e6 * stats.seconds.total / (double)stats.sensors.sites;
        r->plain[n] = 1e6 * plain_gather(&s, &p, plain_light) / p.count;
        r->fill[n] = 1e6 * fill_seconds(8) * texels * r->complexity;
        r->speedup[n] = r->plain[n] / r->sbl[n];
        r->over_fill[n] = r->sbl[n] / r->fill[n];
        r->runs++;
    }
    if (ok) {
        memset(&profile, 0, sizeof profile);
        profile.on = 1;
        ok = box_render(context, r->hemicube, r->size, side, &stats);
        profile.on = 0;
        for (run = 0; ok && run < PARTS; run++)
            r->parts[run] = 1e6 * profile.seconds[run] / (double)stats.sensors.sites;
    }
    if (ok) r->light_ratio = (light[0] + light[1] + light[2]) / (plain_light[0] + plain_light[1] + plain_light[2]);
    if (gl.GetError() != GL_NO_ERROR) ok = fail("a GL error in the plain method");
    free(p.positions);
    sheet_free(&s);
    return ok;
}

static void raster_table(const row *rows, int count) {
    int i;
    printf("raster: 32 triangles; medians, microseconds per sensor\n\n");
    printf("kind      size  sensors/s |     sbl  (total)     plain  plain/sbl | complexity    fill  sbl/fill | "
           "light\n");
    for (i = 0; i < count; i++) {
        const row *r = &rows[i];
        double sbl = median(r->sbl, r->runs);
        printf("%-8s  %4d  %9.0f | %7.1f %8.1f %9.1f %9.2fx | %10.2f %7.1f %8.2fx | %.3f\n",
               r->hemicube ? "hemicube" : "single", r->size, 1e6 / sbl, sbl,
               median(r->total, r->runs), median(r->plain, r->runs), median(r->speedup, r->runs), r->complexity,
                   median(r->fill, r->runs),
               median(r->over_fill, r->runs), r->light_ratio);
    }
    printf("\nparts of sbl's gather (from a separate run that waits after every call)\n\n"
           "kind      size |   clear     draw   reduce     read\n");
    for (i = 0; i < count; i++) {
        const row *r = &rows[i];
        printf("%-8s  %4d | %7.2f %8.2f %8.2f %8.2f\n", r->hemicube ? "hemicube" : "single", r->size,
               r->parts[CLEAR], r->parts[DRAW], r->parts[REDUCE], r->parts[READ]);
    }
    printf("\nplain/sbl: how many times as many sensors a second as a draw per view, a reduction and a readback per "
           "sensor\n"
           "sbl/fill:  time to draw and reduce, divided by the time to fill the same texels, times the depth "
           "complexity\n"
           "light:     sbl's mean R divided by the plain method's, at the same points\n");
}

static void raster_json(const row *rows, int count) {
    int i;
    printf(", \"triangles\": %d, \"rows\": [", CORNELL_TRIANGLES);
    for (i = 0; i < count; i++) {
        const row *r = &rows[i];
        printf("%s\n  {\"kind\": \"%s\", \"size\": %d, \"sensors\": %lld, \"runs\": %d, \"sbl_us\": %.3f, "
               "\"sbl_total_us\": %.3f, \"plain_us\": %.3f, \"speedup\": %.3f, "
               "\"depth_complexity\": %.3f, \"fill_us\": %.3f, \"over_fill\": %.3f, "
               "\"clear_us\": %.3f, \"draw_us\": %.3f, \"reduce_us\": %.3f, \"read_us\": %.3f, \"light_ratio\": %.4f}",
                   i ? "," : "", r->hemicube ? "hemicube" : "single", r->size,
               r->sensors, r->runs, median(r->sbl, r->runs), median(r->total, r->runs), median(r->plain, r->runs),
                   median(r->speedup, r->runs), r->complexity,
               median(r->fill, r->runs), median(r->over_fill, r->runs), r->parts[CLEAR], r->parts[DRAW],
                   r->parts[REDUCE], r->parts[READ], r->light_ratio);
    }
    printf("\n]");
}

static int raster_part(int json, int quick) {
    static row rows[2 * SIZES];
    sbl_context_desc desc = { 0 };
    sbl_context *context = NULL;
    cornell_box box;
    int i, ok, count = 0;
    desc.get_gl_function = gl_function;
    ok = sbl_create(&desc, &context) == SBL_SUCCESS && sbl_set_scene(context, cornell_box_make(&box)) == SBL_SUCCESS &&
         plain_start(&box, sbl_picture_desc_defaults(NULL).options.epsilon);
    for (i = 0; ok && i < 2 * (quick ? 2 : SIZES); i++) {
        row *r = &rows[count];
        r->hemicube = i % 2 == 0;
        r->size = sizes[i / 2];
        ok = row_measure(context, r, quick ? 1 : 5, quick ? 32 : r->size > 64 ? 48 : 72,
                         quick ? 64 : r->size > 64 ? 128 : 384);
        /* coarse sensors agree only roughly, because few texels cover the lamp, and the method without batches does not
           rotate its views */
        if (ok && !(fabs(r->light_ratio - 1) < (r->size < 64 ? 0.3 : 0.05))) {
            fprintf(stderr, "bench: at %s %d sbl.h finds %.3f times the light of the plain method; the comparison is "
                    "invalid\n",
                    r->hemicube ? "hemicube" : "single", r->size, r->light_ratio);
            ok = 0;
        }
        count += ok;
    }
    if (ok) (json ? raster_json : raster_table)(rows, count);
    sbl_destroy(context);
    plain_stop();
    return ok;
}

/* ---- trace: rays in rooms of 32 to 1,000,000 triangles */

enum { BALLS = 40, ROOMS = 5, FILES_MOST = 8, RAYS = 3, VIEWS = 5, SMALL_MOST = 48, SIDE_MOST = 1024 };
enum { REFERENCE_RAYS = 4096, REFERENCE_SEED = 77 };
/* in scenes of at least this many triangles, rasterised sensors are measured only once, at one size */
enum { HEAVY = 200000 };
static const int room_triangles[ROOMS] = { CORNELL_TRIANGLES, 1000, 32768, 131072, 1000000 };
static const int ray_counts[RAYS] = { 64, 256, 1024 }, view_sizes[VIEWS] = { 4, 8, 16, 32, 64 };

/* The Cornell box with bumpy balls of many sizes. The shapes are always the same; only the tessellation varies. */
typedef struct room {
    cornell_box box;
    sbl_mesh meshes[CORNELL_QUADS + BALLS];
    void *arrays[2 * BALLS];
} room;

static double room_random(uint32_t *state) {
    *state = *state * 1664525u + 1013904223u;
    return (*state >> 8) / 16777216.0;
}

/* Makes a ball of about this many triangles. Returns 0 if memory runs out. */
static int ball_make(sbl_mesh *mesh, void *arrays[2], const double centre[3], double radius, int triangles) {
    const double pi = 4 * atan(1.0);
    int stacks = (int)((1 + sqrt(1.0 + triangles)) / 2), slices, vertices, i, j, n = 0;
    float *positions;
    uint32_t *indices;
    if (stacks < 3) stacks = 3;
    slices = (triangles + stacks - 1) / (2 * (stacks - 1));
    if (slices < 3) slices = 3;
    vertices = (stacks - 1) * slices + 2;
    arrays[0] = positions = (float *)malloc((size_t)vertices * 3 * sizeof *positions);
    arrays[1] = indices = (uint32_t *)malloc((size_t)slices * (size_t)(stacks - 1) * 6 * sizeof *indices);
    if (!positions || !indices) return 0;
    for (i = 0; i < vertices; i++) {  /* first the two poles, then the rings */
        double theta = i == 0 ? 0 : i == 1 ? pi : pi * ((i - 2) / slices + 1) / stacks,
            phi = 2 * pi * ((i + slices - 2) % slices) / slices;
        double x = sin(theta) * cos(phi), y = cos(theta), z = sin(theta) * sin(phi);
        double bumps = 0.12 * sin(5 * x + radius) * sin(4 * y) + 0.04 * sin(17 * y + x) * sin(13 * z) + 0.01 *
            sin(61 * z) * sin(53 * x);
        double r = radius * (1 + bumps);
        positions[3 * i] = (float)(centre[0] + r * x);
        positions[3 * i + 1] = (float)(centre[1] + r * y);
        positions[3 * i + 2] = (float)(centre[2] + r * z);
    }
    for (i = 0; i < stacks; i++)
        for (j = 0; j < slices; j++) {
            int ring = 2 + (i - 1) * slices, next = (j + 1) % slices;
            uint32_t a = i > 0 ? (uint32_t)(ring + j) : 0, b = i > 0 ? (uint32_t)(ring + next) : 0;
            uint32_t c = i < stacks - 1 ? (uint32_t)(ring + slices + j) : 1,
                d = i < stacks - 1 ? (uint32_t)(ring + slices + next) : 1;
            if (i > 0) { indices[n++] = a; indices[n++] = b; indices[n++] = c; }
            if (i < stacks - 1) { indices[n++] = b; indices[n++] = d; indices[n++] = c; }
        }
    mesh->positions.data = positions;
    mesh->vertex_count = vertices;
    mesh->indices.data = indices;
    mesh->indices.type = SBL_UINT32;
    mesh->index_count = n;
    return 1;
}

static int room_make(room *r, int triangles, sbl_scene_desc *desc) {
    const double size[3] = { 549, 548, 559 };
    double centres[BALLS][3], radii[BALLS];
    uint32_t random = 1;
    int i, j, k, attempt, left = triangles - CORNELL_TRIANGLES;
    *desc = *cornell_box_make(&r->box);
    memcpy(r->meshes, r->box.meshes, sizeof r->box.meshes);
    desc->meshes = r->meshes;
    for (i = 0; i < BALLS && left > 0; i++) {
        sbl_mesh *mesh = &r->meshes[CORNELL_QUADS + i];
        double *centre = centres[i];
        radii[i] = 90 * pow(6, -i / (BALLS - 1.0));  /* radii from 90 to 15 */
        for (attempt = 0; attempt < 1000; attempt++) {  /* tries places until the ball touches no other */
            for (k = 0; k < 3; k++) centre[k] = 1.2 * radii[i] + (size[k] - 2.4 * radii[i]) * room_random(&random);
            for (j = 0; j < i; j++) {
                double x = centre[0] - centres[j][0], y = centre[1] - centres[j][1], z = centre[2] - centres[j][2];
                if (sqrt(x * x + y * y + z * z) < 1.15 * (radii[i] + radii[j])) break;
            }
            if (j == i) break;
        }
        if (!ball_make(mesh, r->arrays + 2 * i, centre, radii[i], left / (BALLS - i))) return fail("out of memory");
        mesh->material = i % 3;
        left -= mesh->index_count / 3;
        desc->mesh_count++;
    }
    return 1;
}

typedef struct place {
    char name[32];
    sbl_scene_desc desc;
    sbl_material *materials;      /* the materials of desc, with their lamps off */
    room *room;                   /* source of the scene: a room or a file */
    scene_file *file;
    sbl_context *context;
    embree *embree;
    sbl_picture_desc view;        /* the camera */
    points points;
    /* edge lengths in pixels of the pictures for speed (side), and of those for errors and views (small) */
    int triangles, side, small;
    double light[3];              /* mean R at the points */
    float reference[3 * SMALL_MOST * SMALL_MOST];
    double errors[RAYS + VIEWS];
    int runs, view_runs[VIEWS];
    /* in microseconds per sensor; in millions of rays per second */
    double us[RAYS + VIEWS][RUNS_MOST], mrays[RAYS][RUNS_MOST];
    double bvh[RUNS_MOST];                                       /* seconds to build the hierarchy */
    size_t bvh_bytes;
    /* millions of rays per second of Embree, with 64 rays per point, on one thread and on all */
    double embree_one[RUNS_MOST], embree_all[RUNS_MOST];
    double over_embree[RUNS_MOST];                               /* speed of sbl.h divided by that of Embree */
    double embree_light[3];
} place;

/* Renders a picture of the place. Returns 0 on failure. amount: rays of a traced sensor, or texels across the view of a
   rasterised one */
static int place_render(place *p, sbl_backend backend, int amount, int side, uint32_t seed, sbl_stats *stats) {
    sbl_picture_desc view = p->view;
    view.width = view.height = side;
    view.options.mode = SBL_MODE_AMBIENT;
    view.options.epsilon = 1;
    view.options.backend = backend;
    if (backend == SBL_BACKEND_TRACE) view.options.rays = amount;
    else { view.options.sensor_size = amount; view.options.rays = 256; }
    view.tile = 1;
    view.filter_radius = -1;
    view.samples = 1;
    view.options.seed = seed;
    if (sbl_render_picture(p->context, &view) != SBL_SUCCESS) return 0;  /* sbl.h has printed the reason to stderr */
    *stats = sbl_query_stats(p->context);
    return (stats->backend == backend && stats->sensors.sites > 0) || fail("the picture has no sensors");
}

/* Computes the relative RMSE of R in the small picture that was rendered last. */
static int place_error(const place *p, double *error) {
    static float radiance[3 * SMALL_MOST * SMALL_MOST];
    size_t values = 3 * (size_t)p->small * (size_t)p->small, i, count = 0;
    double squares = 0, sum = 0;
    if (sbl_read_channel(p->context, SBL_CHANNEL_RADIANCE, radiance, values) != SBL_SUCCESS) return 0;
    for (i = 0; i < values; i++) {
        double difference = (double)radiance[i] - (double)p->reference[i];
        squares += difference * difference;
        sum += (double)p->reference[i];
        count += p->reference[i] > 0;
    }
    *error = count ? sqrt(squares / (double)count) / (sum / (double)count) : 1;
    return 1;
}

/* Copies the materials with their lamps off, and takes the camera of the file, if it has one. */
static int place_prepare(place *p) {
    int i;
    p->materials = (sbl_material *)malloc((size_t)(p->desc.material_count + 1) * sizeof *p->materials);
    if (!p->materials) return fail("out of memory");
    for (i = 0; i < p->desc.material_count; i++) {
        p->materials[i] = p->desc.materials[i];
        memset(p->materials[i].emission, 0, sizeof p->materials[i].emission);
    }
    p->desc.materials = p->materials;
    if (p->room) cornell_box_view(&p->view, 1, 1);
    else if (p->file->has_camera) {
        const scene_file_camera *c = &p->file->camera;
        const float *e = c->eye, *f = c->forward;
        sbl_look_at(p->view.world_to_view, e[0], e[1], e[2], e[0] + f[0], e[1] + f[1], e[2] + f[2], c->up[0], c->up[1],
                    c->up[2]);
        sbl_perspective(p->view.view_to_clip, c->fov_y > 0 ? c->fov_y : c->fov_x, 1);
    }
    return 1;
}

/* Prints only errors, because otherwise each run would repeat a warning about degenerate triangles. */
static void log_error(sbl_log_level level, sbl_log_item item, const char *message, void *user) {
    (void)item;
    (void)user;
    if (level == SBL_LOG_ERROR) fprintf(stderr, "%s\n", message);
}

/* Chooses the sizes of the pictures, measures the errors of the rays, and collects points for Embree. This compiles all
   shaders before anything is timed. */
static int place_open(place *p, int quick) {
    sbl_context_desc desc = { 0 };
    sbl_stats stats;
    sbl_bounds bounds;
    float extent = 0;
    int i, k, most = quick ? 36 : SMALL_MOST * SMALL_MOST;
    desc.get_gl_function = gl_function;
    desc.logger.log = log_error;
    if (!place_prepare(p) || sbl_create(&desc, &p->context) != SBL_SUCCESS || sbl_set_scene(p->context, &p->desc) !=
        SBL_SUCCESS) return 0;
    for (p->side = 64; ; p->side *= 2) {  /* makes the picture large enough to be timed, also on a GPU */
        for (k = 0; k < 2; k++)
            if (!place_render(p, SBL_BACKEND_TRACE, ray_counts[0], p->side, 0, &stats)) return 0;
        if (quick || stats.seconds.gather > 0.08 || p->side >= SIDE_MOST) break;
    }
    p->triangles = stats.scene.triangles;
    if (!points_read(p->context, p->side, p->side * p->side + 1, &p->points, p->light)) return 0;
    /* the cost of a rasterised sensor is proportional to the number of triangles */
    p->small = (int)sqrt(fmin(fmax(4e6 / p->triangles, 49), most));
    if (!place_render(p, SBL_BACKEND_TRACE, REFERENCE_RAYS, p->small, REFERENCE_SEED, &stats) ||
        sbl_read_channel(p->context, SBL_CHANNEL_RADIANCE, p->reference, 3 * (size_t)p->small * (size_t)p->small) !=
            SBL_SUCCESS) return 0;
    for (i = 0; i < RAYS; i++)
        if (!place_render(p, SBL_BACKEND_TRACE, ray_counts[i], p->small, 0, &stats) || !place_error(p, &p->errors[i]))
            return 0;
    for (i = 0; i < VIEWS; i++) {
        p->view_runs[i] = p->triangles < HEAVY ? 3 : view_sizes[i] == 8;
        if (p->view_runs[i] && !place_render(p, SBL_BACKEND_RASTER, view_sizes[i], 1, 0, &stats)) return 0;
    }
    bounds = sbl_query_bounds(p->context);
    for (k = 0; k < 3; k++) extent = fmaxf(extent, bounds.highest[k] - bounds.lowest[k]);
    p->embree = embree_make(&p->desc, 1e-4f * extent);
    return 1;
}

static void place_close(place *p) {
    int i;
    sbl_destroy(p->context);
    embree_free(p->embree);
    for (i = 0; p->room && i < 2 * BALLS; i++) free(p->room->arrays[i]);
    free(p->room);
    scene_file_free(p->file);
    free(p->materials);
    free(p->points.positions);
}

/* Runs one round: sets the scene again, then measures each method once. */
static int place_run(place *p) {
    sbl_stats stats;
    int i, n = p->runs;
    if (sbl_set_scene(p->context, &p->desc) != SBL_SUCCESS ||
        !place_render(p, SBL_BACKEND_TRACE, ray_counts[0], 8, 0, &stats))
        return 0;
    p->bvh[n] = stats.scene.bvh_seconds;
    p->bvh_bytes = stats.scene.bvh_bytes;
    for (i = 0; i < RAYS; i++) {
        if (!place_render(p, SBL_BACKEND_TRACE, ray_counts[i], i < 2 ? p->side : p->side / 2, 0, &stats)) return 0;
        p->us[i][n] = 1e6 * stats.seconds.gather / (double)stats.sensors.sites;
        p->mrays[i][n] = 1e-6 * (double)stats.sensors.rays / stats.seconds.gather;
    }
    if (p->embree) {
        const points *at = &p->points;
        const int all = p->embree->threads;
        for (i = 0; i < 2; i++) {
            double seconds;
            p->embree->threads = i ? all : 1;
            seconds = embree_gather(p->embree, &at->positions->x, &at->normals->x, at->count, ray_counts[0],
                                    p->embree_light);
            if (!(seconds > 0)) return fail("no threads for Embree");
            (i ? p->embree_all : p->embree_one)[n] = 1e-6 * at->count * ray_counts[0] / seconds;
        }
        p->over_embree[n] = p->mrays[0][n] / p->embree_all[n];
    }
    for (i = 0; i < VIEWS; i++) {
        if (n >= p->view_runs[i]) continue;
        if (!place_render(p, SBL_BACKEND_RASTER, view_sizes[i], p->small, 0, &stats) ||
            !place_error(p, &p->errors[RAYS + i]))
            return 0;
        p->us[RAYS + i][n] = 1e6 * stats.seconds.gather / (double)stats.sensors.sites;
    }
    p->runs++;
    return 1;
}

/* ---- trace: results */

/* Returns the median of a[run] / b[run]. */
static double median_ratio(const double *a, const double *b, int runs) {
    double ratios[RUNS_MOST];
    int i;
    for (i = 0; i < runs; i++) ratios[i] = a[i] / b[i];
    return median(ratios, runs);
}

/* The size of view whose error is nearest to the error of the rays, and the ratio of traced to rasterised sensors per
   second. */
typedef struct pair { int texels; double errors, speedup; } pair;

static pair place_pair(const place *p, int way) {
    pair best = { 0, 1e30, 0 };
    int v;
    for (v = 0; v < VIEWS; v++) {
        double errors = p->errors[way] / p->errors[RAYS + v];
        if (!p->view_runs[v] || !(fabs(log(errors)) < fabs(log(best.errors)))) continue;
        best.texels = view_sizes[v];
        best.errors = errors;
        best.speedup = median_ratio(p->us[RAYS + v], p->us[way], p->runs < p->view_runs[v] ? p->runs : p->view_runs[v]);
    }
    return best;
}

static double view_median(const place *p, int view) {
    return median(p->us[RAYS + view], p->runs < p->view_runs[view] ? p->runs : p->view_runs[view]);
}

static const struct { const char *name, *path; } default_files[2] = {
    { "staircase2", "../shared/scenes/staircase2/staircase2.glb" },
    { "living-room", "../shared/scenes/living-room/living-room.glb" } };

static struct { place *places; int count, skipped[2]; } trace;

static void trace_table(void) {
    const place *base = &trace.places[1];
    int i, k, embree_on = base->embree != NULL;
    printf("trace: no lamps, each surface radiates its albedo; medians of %d runs\n\n", base->runs);
    printf("                         |      Mrays/s by rays   | microseconds / sensor | growth | Embree Mrays/s  sbl / "
           "| BVH: seconds/million  bytes/\n"
           "scene          triangles |    64     256    1024  |    64     256    1024 |   (64) | 1 thread   all Embree "
               "|        sbl   Embree triangle\n");
    for (i = 0; i < trace.count; i++) {
        const place *p = &trace.places[i];
        printf("%-16.16s %7d |", p->name, p->triangles);
        for (k = 0; k < RAYS; k++) printf(" %5.2f  ", median(p->mrays[k], p->runs));
        printf("|");
        for (k = 0; k < RAYS; k++) printf(" %5.1f%s", median(p->us[k], p->runs), k < RAYS - 1 ? "  " : " ");
        printf("| %5.2fx |", median_ratio(p->us[0], base->us[0], p->runs));
        if (p->embree)
            printf(" %8.2f %5.2f %5.2fx |", median(p->embree_one, p->runs), median(p->embree_all, p->runs),
                   median(p->over_embree, p->runs));
        else printf("        -     -      - |");
        if (p->triangles < 1000) printf("          -        -        -\n");
        else {
            printf(" %10.2f", 1e6 * median(p->bvh, p->runs) / p->triangles);
            if (p->embree) printf(" %8.2f", 1e6 * p->embree->build_seconds / p->triangles);
            else printf("        -");
            printf(" %8.1f\n", (double)p->bvh_bytes / p->triangles);
        }
    }
    printf("\nerror in %% and microseconds per sensor, with\n"
           "scene          triangles  pixels |  64 rays      256 rays     1024 rays    |  4 texels        8 texels     "
               "    "
           "16 texels        32 texels        64 texels\n");
    for (i = 0; i < trace.count; i++) {
        const place *p = &trace.places[i];
        printf("%-16.16s %7d %7d |", p->name, p->triangles, p->small * p->small);
        for (k = 0; k < RAYS; k++) printf(" %5.2f %6.1f", 100 * p->errors[k], median(p->us[k], p->runs));
        printf(" |");
        for (k = 0; k < VIEWS; k++)
            if (p->view_runs[k]) printf(" %5.2f %9.1f ", 100 * p->errors[RAYS + k], view_median(p, k));
            else printf("     -         - ");
        printf("\n");
    }
    printf("\ntraced sensors per second / rasterised ones of the nearest error (their texels, ratio of the errors)\n"
           "scene          triangles |  64 rays                256 rays               1024 rays\n");
    for (i = 0; i < trace.count; i++) {
        const place *p = &trace.places[i];
        printf("%-16.16s %7d |", p->name, p->triangles);
        for (k = 0; k < RAYS; k++) {
            pair best = place_pair(p, k);
            printf(" %7.1fx (%2d, %4.2f)%s", best.speedup, best.texels, best.errors, k < RAYS - 1 ? "    " : "\n");
        }
    }
    for (i = 0; i < 2; i++)
        if (trace.skipped[i]) printf("%s: skipped, there is no %s\n", default_files[i].name, default_files[i].path);
    printf("\ngrowth:  microseconds per sensor, relative to the scene of %d triangles, run by run\n", base->triangles);
    if (embree_on)
        printf("Embree:  rtcIntersect1 on 1 thread and on all %d, one ray at a time, 64 rays per point: the same "
               "points and normals, a similar distribution;\n"
               "         includes generating the rays and summing the radiance, but not textures and cut-outs. "
                   "sbl: the whole gather, on all\n"
               "         of GL's threads; sbl / Embree compares all threads\n",
               base->embree->threads);
    else printf("Embree:  was not installed when the bench was built\n");
    printf("BVH:     built by one thread\n"
           "error:   relative RMSE of R over the pixels of a small picture, against %d traced rays of another seed, "
               "i.e. against sbl.h itself\n"
           "texels:  across the views of a hemicube; from %d triangles on only one size, measured once\n",
           REFERENCE_RAYS, HEAVY);
}

static void trace_json(void) {
    int i, k;
    printf(", \"trace\": {\"reference_rays\": %d, \"scenes\": [", REFERENCE_RAYS);
    for (i = 0; i < trace.count; i++) {
        const place *p = &trace.places[i];
        printf("%s\n  {\"scene\": \"%s\", \"triangles\": %d, \"sensors\": %d, \"runs\": %d, \"growth\": %.3f, ",
               i ? "," : "", p->name, p->triangles,
               p->points.count, p->runs, median_ratio(p->us[0], trace.places[1].us[0], p->runs));
        printf("\"bvh_seconds\": %.4f, \"bvh_bytes\": %lld, \"ways\": [", median(p->bvh, p->runs),
               (long long)p->bvh_bytes);
        for (k = 0; k < RAYS; k++)
            printf("%s{\"rays\": %d, \"us\": %.3f, \"mrays\": %.4f, \"error\": %.5f}", k ? ", " : "", ray_counts[k],
                   median(p->us[k], p->runs),
                   median(p->mrays[k], p->runs), p->errors[k]);
        for (k = 0; k < VIEWS; k++)
            if (p->view_runs[k])
                printf(", {\"texels\": %d, \"us\": %.1f, \"error\": %.5f}", view_sizes[k], view_median(p, k),
                       p->errors[RAYS + k]);
        printf("], \"error_pixels\": %d, \"nearest_error\": [", p->small * p->small);
        for (k = 0; k < RAYS; k++) {
            pair best = place_pair(p, k);
            printf("%s{\"rays\": %d, \"texels\": %d, \"errors\": %.4f, \"speedup\": %.2f}", k ? ", " : "",
                   ray_counts[k], best.texels,
                   best.errors, best.speedup);
        }
        printf("], \"embree\": ");
        if (p->embree)
            printf("{\"threads\": %d, \"mrays\": %.4f, \"one_thread_mrays\": %.4f, \"sbl_over_embree\": %.4f, "
                   "\"build_seconds\": %.4f}}",
                   p->embree->threads, median(p->embree_all, p->runs), median(p->embree_one, p->runs),
                       median(p->over_embree, p->runs),
                   p->embree->build_seconds);
        else printf("null}");
    }
    printf("\n], \"skipped\": [");
    for (i = 0, k = 0; i < 2; i++)
        if (trace.skipped[i]) printf("%s\"%s\"", k++ ? ", " : "", default_files[i].name);
    printf("]}");
}

/* Loads rooms and files. This happens before GL is started, because a child process reads the files. */
static int trace_load(int quick, char **files, int file_count) {
    int rooms = quick ? 2 : ROOMS, i;
    trace.places = (place *)calloc(ROOMS + FILES_MOST, sizeof *trace.places);
    if (!trace.places) return fail("out of memory");
    for (i = 0; i < rooms; i++) {
        place *p = &trace.places[trace.count++];
        snprintf(p->name, sizeof p->name, i ? "room" : "Cornell box");
        p->room = (room *)calloc(1, sizeof *p->room);
        if (!p->room) return fail("out of memory");
        if (!room_make(p->room, room_triangles[i], &p->desc)) return 0;
    }
    for (i = 0; i < (file_count ? file_count : quick ? 0 : 2); i++) {
        const char *path = file_count ? files[i] : default_files[i].path,
            *name = strrchr(path, '/') ? strrchr(path, '/') + 1 : path;
        place *p = &trace.places[trace.count];
        char error[512];
        trace.skipped[i % 2] = !file_count && access(path, R_OK) != 0;
        if (!file_count && trace.skipped[i]) continue;
        p->file = scene_file_load(path, NULL, error, sizeof error);
        if (!p->file) return fail(error);
        for (; *name && *name != '.' && strlen(p->name) + 1 < sizeof p->name; name++)
            p->name[strlen(p->name)] = *name == '"' || *name == '\\' || (unsigned char)*name < ' ' ? '_' : *name;
        p->desc = p->file->scene;
        p->desc.sky[0] = p->desc.sky[1] = p->desc.sky[2] = 1;
        trace.count++;
    }
    return 1;
}

static int trace_part(int json, int quick) {
    int i, run, ok = 1;
    for (i = 0; i < trace.count && ok; i++) ok = place_open(&trace.places[i], quick);
    for (run = 0; ok && run < (quick ? 1 : 5); run++)
        for (i = 0; i < trace.count && ok; i++) ok = place_run(&trace.places[i]);
    for (i = 0; i < trace.count && ok; i++) {
        const place *p = &trace.places[i];
        double ratio = (p->light[0] + p->light[1] + p->light[2]) /
            (p->embree_light[0] + p->embree_light[1] + p->embree_light[2]);
        if (!p->embree || !p->room || fabs(ratio - 1) < 0.01) continue;
        fprintf(stderr, "bench: with %d triangles sbl.h finds %.3f times Embree's light; the comparison is invalid\n",
                p->triangles, ratio);
        ok = 0;
    }
    if (ok) (json ? trace_json : trace_table)();
    return ok;
}

static void trace_free(void) {
    while (trace.count) place_close(&trace.places[--trace.count]);
    free(trace.places);
}

#include "bench_lamps.h"

int main(int argc, char **argv) {
    char *files[FILES_MOST];
    int json = 0, quick = 0, file_count = 0, raster_on = 0, trace_on = 0, lamps_on = 0, i, ok;
    for (i = 1; i < argc; i++) {
        if (strcmp(argv[i], "--json") == 0) json = 1;
        else if (strcmp(argv[i], "--quick") == 0) quick = 1;
        else if (strcmp(argv[i], "raster") == 0) raster_on = 1;
        else if (strcmp(argv[i], "trace") == 0) trace_on = 1;
        else if (strcmp(argv[i], "lamps") == 0) lamps_on = 1;
        else if (argv[i][0] != '-' && file_count < FILES_MOST) files[file_count++] = argv[i];
        else return fprintf(stderr, "usage: bench [raster] [trace] [lamps] [--json] [--quick] [FILE...]\n"), 2;
    }
    if (!raster_on && !trace_on && !lamps_on) raster_on = trace_on = lamps_on = 1;
    ok = !trace_on || trace_load(quick, files, file_count);
    ok = ok && host_gl_open("bench");
    if (ok) {
        const char *renderer = (const char *)gl.GetString(GL_RENDERER);
        if (json) {
            printf("{\"renderer\": \"");
            for (; *renderer; renderer++)
                if (*renderer != '"' && *renderer != '\\' && (unsigned char)*renderer >= ' ') putchar(*renderer);
            printf("\"");
        } else printf("%s\n\n", renderer);
        if (raster_on) ok = raster_part(json, quick);
        if (!json && raster_on && trace_on) printf("\n");
        if (ok && trace_on) ok = trace_part(json, quick);
        if (!json && lamps_on && (raster_on || trace_on)) printf("\n");
        if (ok && lamps_on) ok = lamps_part(json, quick);
        if (json) printf("}\n");
    }
    trace_free();
    host_gl_close();
    return !ok;
}
