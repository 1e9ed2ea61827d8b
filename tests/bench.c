/* bench: what gathering in batches is worth, on the Cornell box's 32 triangles.

   Side by side in one process and one GL context, in several alternating runs, for each kind of sensor and several sizes:

       sbl      the gather of a picture with a sensor at every pixel (sbl_stats.seconds.gather)
       plain    the plain way, written here with GL of its own: for every sensor a clear, a draw per view, two reduction passes and a
                readback. The same points, normals, projections, texel formats, weights and sum; only rotation about the normal is left out
       fill     the time in which GL fills as many texels as the sensors' views have, as often as the scene's mean depth complexity
                (counted here by additive blending), by passes over a whole target that write a constant

   Prints medians of the runs; --json prints the same as one JSON object; --quick measures less. Never fails on a timing: only when
   something does not work at all, or when both ways do not see the same light. */
#define _POSIX_C_SOURCE 199309L
#define SBL_IMPLEMENTATION
#include "../sbl.h"
#include "../examples/cornell_box.h"
#include "../examples/host_gl.h"
#include <stdlib.h>
#include <time.h>

enum { SIZES = 4, RUNS_MOST = 7, FILL_SIZE = 2048, BLOCK = 8 };
static const int sizes[SIZES] = { 16, 32, 64, 128 };

typedef struct vec3 { float x, y, z; } vec3;

static vec3 vec3_make(float x, float y, float z) { vec3 v; v.x = x; v.y = y; v.z = z; return v; }
static vec3 vec3_mix(vec3 a, float s, vec3 b) { return vec3_make(a.x + s * b.x, a.y + s * b.y, a.z + s * b.z); }
static vec3 vec3_cross(vec3 a, vec3 b) { return vec3_make(a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x); }
static float vec3_dot(vec3 a, vec3 b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
static vec3 vec3_unit(vec3 a) { return vec3_mix(vec3_make(0, 0, 0), 1 / sqrtf(vec3_dot(a, a)), a); }

static double now(void) {
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static int fail(const char *what) { return fprintf(stderr, "bench: %s\n", what), 0; }

/* ---- the plain way */

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
static const char full_vertex[] = "void main() { gl_Position = vec4(vec2(gl_VertexID & 1, gl_VertexID >> 1) * 4.0 - 1.0, 0.0, 1.0); }\n";
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
    return gl.CheckFramebufferStatus(GL_FRAMEBUFFER) == GL_FRAMEBUFFER_COMPLETE || fail("the driver cannot draw to float textures");
}

static void target_free(target *t) {
    gl.DeleteFramebuffers(1, &t->framebuffer);
    gl.DeleteTextures(1, &t->texture);
    if (t->depth) gl.DeleteTextures(1, &t->depth);
}

static struct {
    GLuint draw, count, block, sum, fill;  /* programs */
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
        gl.VertexAttribPointer((GLuint)i, 3, GL_FLOAT, GL_FALSE, (GLsizei)sizeof vertices[0], (const void *)(3 * sizeof(float) * (size_t)i));
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

/* One kind of sensor at one size: views side by side on a sheet, a hemicube's sides cut at the horizon. */
typedef struct sheet {
    int size, views, width, height, rects[5][4];
    float half;          /* of the view's width, at unit distance */
    int blocks[2];
    GLuint weights;
    target texels, block_sums, sum;
} sheet;

/* Projected solid angle over pi of a texel of the plane at unit distance: the form factor of a rectangle, by its four corners' antiderivative.
   top: the plane lies along the normal; otherwise it stands upright and y is the height above the horizon. */
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
    static const int cells[5][4] = { { 0, 0, 2, 2 }, { 2, 0, 2, 1 }, { 2, 1, 2, 1 }, { 0, 2, 2, 1 }, { 2, 2, 2, 1 } };  /* in half sizes */
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
                double h = (double)s->half, x0 = h * (2.0 * x / size - 1), y0 = view ? 2.0 * y / size : h * (2.0 * y / size - 1), step = 2 * h / size;
                weights[(r[1] + y) * s->width + r[0] + x] = (float)texel_weight(view == 0, x0, x0 + step, y0, y0 + step);
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
           target_make(&s->block_sums, GL_RGBA32F, s->blocks[0], s->blocks[1], 0) && target_make(&s->sum, GL_RGBA32F, 1, 1, 0);
}

static void sheet_free(sheet *s) {
    gl.DeleteTextures(1, &s->weights);
    target_free(&s->texels);
    target_free(&s->block_sums);
    target_free(&s->sum);
}

/* world_to_clip of one view, column by column: depth is 1 - near / distance, without a far plane. */
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
    rows[1] = view ? vec3_mix(vec3_mix(vec3_make(0, 0, 0), 2, up), -1, forward) : vec3_mix(vec3_make(0, 0, 0), 1 / s->half, up);  /* a side shows 0 to 1 */
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

/* Sums one sheet's texels by their weights, in two passes, and reads the result back. */
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

/* Seconds for all points; mean: of their light. */
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

/* Fragments a texel of the views, without a depth test. */
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

/* Seconds a texel: passes over a whole target of the atlas's format that write a constant. */
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
        gl.Finish();  /* each by itself: a tiling renderer drops what the next pass covers */
    }
    return (now() - start) / passes / ((double)FILL_SIZE * FILL_SIZE);
}

/* ---- sbl.h */

/* Where a gather's time goes: sbl.h is handed GL functions that, in a run apart from the timed ones, wait for the GPU before and after.
   A gather starts with an instanced draw of its views and ends with reading its results; the full-target draws between are the reduction. */
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

static void APIENTRY draw_arrays(GLenum mode, GLint first, GLsizei count) {
    double start = profile.on ? profile_start() : 0;
    gl.DrawArrays(mode, first, count);
    if (profile.on && profile.drawn && !profile.read) profile_end(REDUCE, start);
}

static void APIENTRY read_pixels(GLint x, GLint y, GLsizei width, GLsizei height, GLenum format, GLenum type, void *pixels) {
    double start = profile.on ? profile_start() : 0;
    gl.ReadPixels(x, y, width, height, format, type, pixels);
    if (profile.on && profile.drawn) profile_end(READ, start);
    profile.read = 1;
}

static sbl_gl_function gl_function(const char *name, void *user) {
    (void)user;
    if (strcmp(name, "glClearBufferfv") == 0) return (sbl_gl_function)clear_buffer;
    if (strcmp(name, "glDrawElementsInstanced") == 0) return (sbl_gl_function)draw_instanced;
    if (strcmp(name, "glDrawArrays") == 0) return (sbl_gl_function)draw_arrays;
    if (strcmp(name, "glReadPixels") == 0) return (sbl_gl_function)read_pixels;
    return eglGetProcAddress(name);
}

static int sbl_gather(sbl_context *context, int hemicube, int size, int side, sbl_stats *stats) {
    sbl_picture_desc view = { 0 };
    cornell_box_view(&view, side, side);
    view.mode = SBL_MODE_AMBIENT;
    view.sensor_kind = hemicube ? SBL_SENSOR_HEMICUBE : SBL_SENSOR_SINGLE;
    view.backend = SBL_BACKEND_RASTER;
    view.sensor_size = size;
    view.tile = 1;
    view.filter_radius = -1;
    view.samples = 1;
    if (sbl_render(context, &view) != SBL_SUCCESS) return 0;  /* sbl.h says what is wrong on stderr */
    *stats = sbl_query_stats(context);
    return stats->sensors > 0 || fail("the picture has no sensors");
}

/* Every stride-th surface point of the finished picture, and the mean of what sbl.h found there. */
static int points_read(sbl_context *context, int width, int height, int most, points *p, double mean[3]) {
    size_t pixels = (size_t)width * (size_t)height, i, count = 0, stride;
    float *values = (float *)malloc(pixels * 10 * sizeof(float));
    float *position = values, *normal = values + 3 * pixels, *radiance = values + 6 * pixels, *id = values + 9 * pixels;
    int k, ok;
    p->count = 0;
    p->positions = (vec3 *)malloc(2 * (size_t)most * sizeof(vec3));
    p->normals = p->positions + most;
    ok = values && p->positions && sbl_read_channel(context, SBL_CHANNEL_POSITION, position, 3 * pixels) == SBL_SUCCESS &&
         sbl_read_channel(context, SBL_CHANNEL_NORMAL, normal, 3 * pixels) == SBL_SUCCESS &&
         sbl_read_channel(context, SBL_CHANNEL_RADIANCE, radiance, 3 * pixels) == SBL_SUCCESS && sbl_read_channel(context, SBL_CHANNEL_ID, id, pixels) == SBL_SUCCESS;
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

/* ---- the runs */

typedef struct row {
    int hemicube, size, runs;
    double sbl[RUNS_MOST], total[RUNS_MOST], plain[RUNS_MOST], fill[RUNS_MOST];  /* microseconds a sensor */
    double speedup[RUNS_MOST], over_fill[RUNS_MOST];                              /* ratios within a run */
    double parts[PARTS];                                                          /* microseconds a sensor, in a run of its own */
    double complexity, light_ratio;                                               /* light: sbl's mean over the plain way's */
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
    ok = sheet_make(&s, r->hemicube, r->size) && sbl_gather(context, r->hemicube, r->size, side, &stats) &&  /* warms up, too */
         points_read(context, side, side, most, &p, light);
    if (ok) r->complexity = depth_complexity(&s, &p);
    if (ok) plain_gather(&s, &p, plain_light);
    for (run = 0; ok && run < runs; run++) {
        int n = r->runs;
        double texels = (double)s.width * s.height;
        ok = sbl_gather(context, r->hemicube, r->size, side, &stats);
        if (!ok) break;
        r->sensors = (long long)stats.sensors;
        r->sbl[n] = 1e6 * stats.seconds.gather / (double)stats.sensors;
        r->total[n] = 1e6 * stats.seconds.total / (double)stats.sensors;
        r->plain[n] = 1e6 * plain_gather(&s, &p, plain_light) / p.count;
        r->fill[n] = 1e6 * fill_seconds(8) * texels * r->complexity;
        r->speedup[n] = r->plain[n] / r->sbl[n];
        r->over_fill[n] = r->sbl[n] / r->fill[n];
        r->runs++;
    }
    if (ok) {
        memset(&profile, 0, sizeof profile);
        profile.on = 1;
        ok = sbl_gather(context, r->hemicube, r->size, side, &stats);
        profile.on = 0;
        for (run = 0; ok && run < PARTS; run++) r->parts[run] = 1e6 * profile.seconds[run] / (double)stats.sensors;
    }
    if (ok) r->light_ratio = (light[0] + light[1] + light[2]) / (plain_light[0] + plain_light[1] + plain_light[2]);
    if (gl.GetError() != GL_NO_ERROR) ok = fail("a GL error in the plain way");
    free(p.positions);
    sheet_free(&s);
    return ok;
}

static void print_table(const row *rows, int count, const char *renderer) {
    int i;
    printf("gather on %s\n32 triangles; medians, microseconds a sensor\n\n", renderer);
    printf("kind      size  sensors/s |     sbl  (total)     plain  plain/sbl | complexity    fill  sbl/fill | light\n");
    for (i = 0; i < count; i++) {
        const row *r = &rows[i];
        double sbl = median(r->sbl, r->runs);
        printf("%-8s  %4d  %9.0f | %7.1f %8.1f %9.1f %9.2fx | %10.2f %7.1f %8.2fx | %.3f\n", r->hemicube ? "hemicube" : "single", r->size, 1e6 / sbl, sbl,
               median(r->total, r->runs), median(r->plain, r->runs), median(r->speedup, r->runs), r->complexity, median(r->fill, r->runs),
               median(r->over_fill, r->runs), r->light_ratio);
    }
    printf("\nwhere sbl's gather spends its time (a run apart that waits after every call)\n\n"
           "kind      size |   clear     draw   reduce     read\n");
    for (i = 0; i < count; i++) {
        const row *r = &rows[i];
        printf("%-8s  %4d | %7.2f %8.2f %8.2f %8.2f\n", r->hemicube ? "hemicube" : "single", r->size,
               r->parts[CLEAR], r->parts[DRAW], r->parts[REDUCE], r->parts[READ]);
    }
    printf("\nplain/sbl: how many times as many sensors a second as a draw per view, a reduction and a readback per sensor\n"
           "sbl/fill:  drawing and reducing over filling the same texels as often as the depth complexity\n"
           "light:     sbl's mean over the plain way's at the same points\n");
}

static void print_json(const row *rows, int count, const char *renderer) {
    int i;
    printf("{\"renderer\": \"");
    for (; *renderer; renderer++)
        if (*renderer != '"' && *renderer != '\\' && (unsigned char)*renderer >= ' ') putchar(*renderer);
    printf("\", \"triangles\": %d, \"rows\": [", CORNELL_TRIANGLES);
    for (i = 0; i < count; i++) {
        const row *r = &rows[i];
        printf("%s\n  {\"kind\": \"%s\", \"size\": %d, \"sensors\": %lld, \"runs\": %d, \"sbl_us\": %.3f, \"sbl_total_us\": %.3f, \"plain_us\": %.3f, \"speedup\": %.3f, "
               "\"depth_complexity\": %.3f, \"fill_us\": %.3f, \"over_fill\": %.3f, "
               "\"clear_us\": %.3f, \"draw_us\": %.3f, \"reduce_us\": %.3f, \"read_us\": %.3f, \"light_ratio\": %.4f}", i ? "," : "", r->hemicube ? "hemicube" : "single", r->size,
               r->sensors, r->runs, median(r->sbl, r->runs), median(r->total, r->runs), median(r->plain, r->runs), median(r->speedup, r->runs), r->complexity,
               median(r->fill, r->runs), median(r->over_fill, r->runs), r->parts[CLEAR], r->parts[DRAW], r->parts[REDUCE], r->parts[READ], r->light_ratio);
    }
    printf("\n]}\n");
}

#include "bench_trace.h"

int main(int argc, char **argv) {
    static row rows[2 * SIZES];
    sbl_context_desc desc = { 0 };
    sbl_context *context = NULL;
    cornell_box box;
    int json = 0, quick = 0, raster = 1, trace = 1, i, ok, count = 0;
    for (i = 1; i < argc; i++) {
        if (strcmp(argv[i], "--json") == 0) json = 1;
        else if (strcmp(argv[i], "--quick") == 0) quick = 1;
        else if (strcmp(argv[i], "raster") == 0) trace = 0;
        else if (strcmp(argv[i], "trace") == 0) raster = 0;
        else return fprintf(stderr, "usage: bench [raster | trace] [--json] [--quick]\n"), 2;
    }
    if (!host_gl_open("bench")) return 1;
    desc.get_gl_function = gl_function;
    ok = sbl_create(&desc, &context) == SBL_SUCCESS && sbl_set_scene(context, cornell_box_make(&box)) == SBL_SUCCESS &&
         plain_start(&box, sbl_picture_desc_defaults(NULL).epsilon);
    for (i = 0; ok && raster && i < 2 * (quick ? 2 : SIZES); i++) {
        row *r = &rows[count];
        r->hemicube = i % 2 == 0;
        r->size = sizes[i / 2];
        ok = row_measure(context, r, quick ? 1 : 5, quick ? 32 : r->size > 64 ? 48 : 72, quick ? 64 : r->size > 64 ? 128 : 384);
        /* few texels across the lamp, and at the plain way's one orientation: coarse sensors agree coarsely */
        if (ok && !(fabs(r->light_ratio - 1) < (r->size < 64 ? 0.3 : 0.05))) {
            fprintf(stderr, "bench: at %s %d sbl.h finds %.3f times the plain way's light: not the same work\n",
                    r->hemicube ? "hemicube" : "single", r->size, r->light_ratio);
            ok = 0;
        }
        count += ok;
    }
    if (ok && raster) (json ? print_json : print_table)(rows, count, (const char *)gl.GetString(GL_RENDERER));
    if (ok && trace) ok = bench_trace(context, quick, json, (const char *)gl.GetString(GL_RENDERER));
    sbl_destroy(context);
    plain_stop();
    host_gl_close();
    return !ok;
}
