/* Demonstrates the use of baked light in an engine: draws a scene in plain OpenGL 3.3 with a lightmap from sbl_bake,
   and in it a moving ball that is lit by probes. `host_lightmap --help` explains its options. */
#define _DEFAULT_SOURCE
#define SBL_IMPLEMENTATION
#define SBL_EGL
#include "../sbl.h"
#include "output_file.h"
#include "picture_file.h"
#include "scene_file.h"
#define TOOL_NAME "host_lightmap"
#define TOOL_MAKES "picture"
#include "tool.h"
#include "tool_options.h"
#include "tool_scene.h"
#include "map_reader.h"
#include "tool_survey.h"
#include "tool_camera.h"
#include "host_gl.h"

/* ---- the command line ---- */

static const char *files[2];  /* file name of the scene, and folder of the lightmap */
static int channel;
enum { FINAL, RADIANCE };
static const char *const channel_words[] = { "final", "radiance", NULL };

enum { OUTPUT = CAMERA_END, CHANNEL, OPTION_COUNT };

static const tool_option table[OPTION_COUNT] = {
    COMMON_ROWS,
    CAMERA_ROWS,
    [OUTPUT]  = { "--output", "FILE", TEXT, &common.output, 0, 0, 0,
        "also -o; .png or .pfm; default: several frames, see above" },
    [CHANNEL] = { "--channel", "NAME", CHOICE, &channel, 0, 0, 0,
        "final (default) | radiance (R: light without surface colour)", channel_words },
};
static int given[OPTION_COUNT];

/* Notes options without effect: with --output, the options for the light of probes; always, the options for making a
   lightmap. */
static void note_effects(void) {
    static const int light[] = { MODE, PRESET, BACKEND, RAYS, MAX_BOUNCE_CELLS, EPSILON, SENSOR_SIZE, SEED, LIGHT_SCALE,
                                 SKY_ROTATION, SKY_SCALE, SKY_UP };
    static const int maps[] = { TILE, THRESHOLD, FILTER_RADIUS };
    size_t i;
    if (!common.output) common_note(given, table);
    for (i = 0; i < sizeof light / sizeof *light && common.output; i++)
        note_if(1, given, table, light[i], "with -o no probes are baked");
    for (i = 0; i < sizeof maps / sizeof *maps; i++) note_if(1, given, table, maps[i], "sbl_bake made the lightmap");
}

static int parse(int argc, char **argv) {
    const tool_command command = { argc, argv, table, OPTION_COUNT, given, files, 2 };
    int status = tool_parse(&command);
    if (status != DONE || given[HELP] || given[VERSION]) return status;
    if (!files[0] || !files[1]) return misuse("usage: host_lightmap SCENE FOLDER [options]; see --help");
    common.scene = files[0];
    status = common_check(given);
    if (status != DONE) return status;
    if (common.output && !scene__ends_with(common.output, ".png") && !scene__ends_with(common.output, ".pfm"))
        return misuse("--output %s: the name must end in .png or .pfm", common.output);
    if (common.output && given[STORE])
        return misuse("--store keeps the light of probes, and with -o no probes are baked; give only one of them");
    note_effects();
    return DONE;
}

/* ---- the scene in GL ---- */

static const char vertex_shader[] =
    "uniform mat4 object_to_world, world_to_view, view_to_clip;\n"
    "layout(location = 0) in vec3 position;\n"
    "layout(location = 1) in vec2 texcoord;\n"
    "layout(location = 2) in vec2 lightmap_texcoord;\n"
    "layout(location = 3) in vec4 vertex_color;\n"
    "out vec2 uv, lightmap_uv;\n"
    "out vec4 tint;\n"
    "void main() {\n"
    "    uv = texcoord;\n"
    "    lightmap_uv = lightmap_texcoord;\n"
    "    tint = vertex_color;\n"
    "    gl_Position = view_to_clip * (world_to_view * (object_to_world * vec4(position, 1.0)));\n"
    "}\n";

/* All that a shader needs for a lightmap: light = albedo * R + emission. */
static const char fragment_shader[] =
    "uniform sampler2D lightmap, albedo_texture, emission_texture;\n"
    "uniform vec3 albedo, emission;\n"
    "uniform float alpha_cutoff;\n"
    "uniform int channel;\n"
    "in vec2 uv, lightmap_uv;\n"
    "in vec4 tint;\n"
    "out vec4 light;\n"
    "void main() {\n"
    "    vec4 color = texture(albedo_texture, uv) * tint;\n"
    "    vec3 R = texture(lightmap, lightmap_uv).rgb;\n"
    "    if (color.a < alpha_cutoff) discard;\n"
    "    light = vec4(channel == 1 ? R : albedo * color.rgb * R + emission * texture(emission_texture, uv).rgb, 1);\n"
    "}\n";

/* Draws a ball: gl_VertexID counts the vertices of a grid over the sphere. */
static const char ball_vertex_shader[] =
    "uniform mat4 world_to_view, view_to_clip;\n"
    "uniform vec3 middle;\n"
    "uniform float radius;\n"
    "out vec3 normal;\n"
    "void main() {\n"
    "    int cell = gl_VertexID / 6, corner = gl_VertexID % 6;\n"
    "    ivec2 at = ivec2(cell % 48, cell / 48) + ivec2(corner == 1 || corner > 3 ? 1 : 0, corner == 2 || corner == 3 "
        "|| corner == 5 ? 1 : 0);\n"
    "    vec2 angles = vec2(at) * vec2(6.2831853 / 48.0, 3.1415927 / 24.0);\n"
    "    normal = vec3(cos(angles.x) * sin(angles.y), cos(angles.y), sin(angles.x) * sin(angles.y));\n"
    "    gl_Position = view_to_clip * (world_to_view * vec4(middle + radius * normal, 1.0));\n"
    "}\n";

/* This shader needs only R for the normal of a pixel, which it computes from the ambient cube of the probe. The cube is
   never negative, unlike the sum of the nine harmonics near a strong lamp. */
static const char ball_fragment_shader[] =
    "uniform vec3 cube[6];\n"
    "in vec3 normal;\n"
    "out vec4 light;\n"
    "void main() {\n"
    "    vec3 n = normalize(normal), w = n * n;\n"
    "    vec3 R = w.x * cube[n.x < 0.0 ? 1 : 0] + w.y * cube[n.y < 0.0 ? 3 : 2] + w.z * cube[n.z < 0.0 ? 5 : 4];\n"
    "    light = vec4(0.8 * R, 1);\n"
    "}\n";
enum { BALL_VERTICES = 48 * 24 * 6 };

typedef struct drawn { GLuint array, buffers[5]; } drawn;  /* a mesh in GL */

typedef struct host {
    GLuint program, ball_program, ball_array, white, framebuffer, color, depth;
    GLuint *textures, *lightmaps;
    drawn *meshes;
} host;

static GLuint texture_of(GLenum format, int width, int height, GLenum from, GLenum type, const void *pixels) {
    GLuint texture = 0;
    gl.GenTextures(1, &texture);
    gl.BindTexture(GL_TEXTURE_2D, texture);
    gl.PixelStorei(GL_UNPACK_ALIGNMENT, 1);
    gl.TexImage2D(GL_TEXTURE_2D, 0, (GLint)format, width, height, 0, from, type, pixels);
    gl.TexParameteri(GL_TEXTURE_2D, GL_TEXTURE_MIN_FILTER, GL_LINEAR);
    gl.TexParameteri(GL_TEXTURE_2D, GL_TEXTURE_MAG_FILTER, GL_LINEAR);
    return texture;
}

static GLuint scene_texture(const sbl_texture *t) {
    static const GLenum formats[5] = { 0, GL_RED, GL_RG, GL_RGB, GL_RGBA };
    const int is_float = t->format == SBL_PIXELS_FLOAT, wrap = t->wrap == SBL_WRAP_CLAMP ? GL_CLAMP_TO_EDGE : GL_REPEAT;
    const GLuint texture = texture_of(is_float ? GL_RGBA16F : GL_SRGB8_ALPHA8, t->width, t->height,
                                      formats[t->channels],
                                      is_float ? GL_FLOAT : GL_UNSIGNED_BYTE, t->pixels);
    gl.TexParameteri(GL_TEXTURE_2D, GL_TEXTURE_WRAP_S, wrap);
    gl.TexParameteri(GL_TEXTURE_2D, GL_TEXTURE_WRAP_T, wrap);
    if (t->channels < 3) {
        gl.TexParameteri(GL_TEXTURE_2D, GL_TEXTURE_SWIZZLE_G, GL_RED);
        gl.TexParameteri(GL_TEXTURE_2D, GL_TEXTURE_SWIZZLE_B, GL_RED);
        gl.TexParameteri(GL_TEXTURE_2D, GL_TEXTURE_SWIZZLE_A, t->channels == 2 ? GL_GREEN : GL_ONE);
    }
    return texture;
}

static void mesh_make(drawn *d, const sbl_mesh *m) {
    const struct { const void *data; int components; float otherwise; } streams[4] = {
        { m->positions.data, 3, 0 }, { m->texcoords.data, 2, 0 }, { m->lightmap_texcoords.data, 2, 0 },
        { m->colors.data, 4, 1 }
    };
    int i;
    gl.GenVertexArrays(1, &d->array);
    gl.BindVertexArray(d->array);
    gl.GenBuffers(5, d->buffers);
    for (i = 0; i < 4; i++) {
        const float v = streams[i].otherwise;
        if (!streams[i].data) { gl.VertexAttrib4f((GLuint)i, v, v, v, v); continue; }
        gl.BindBuffer(GL_ARRAY_BUFFER, d->buffers[i]);
        gl.BufferData(GL_ARRAY_BUFFER, (GLsizeiptr)m->vertex_count * streams[i].components * 4, streams[i].data,
                      GL_STATIC_DRAW);
        gl.VertexAttribPointer((GLuint)i, streams[i].components, GL_FLOAT, GL_FALSE, 0, NULL);
        gl.EnableVertexAttribArray((GLuint)i);
    }
    gl.BindBuffer(GL_ELEMENT_ARRAY_BUFFER, d->buffers[4]);
    gl.BufferData(GL_ELEMENT_ARRAY_BUFFER, (GLsizeiptr)m->index_count * 4, m->indices.data, GL_STATIC_DRAW);
}

static int host_make(host *h, const scene_file *file, const image *lightmaps) {
    const sbl_scene_desc *scene = &file->scene;
    static const unsigned char white[4] = { 255, 255, 255, 255 };
    int i;
    h->program = host_gl_program(TOOL_NAME, "", vertex_shader, fragment_shader);
    h->textures = (GLuint *)calloc((size_t)scene->texture_count + 1, sizeof *h->textures);
    h->lightmaps = (GLuint *)calloc((size_t)file->map_count + 1, sizeof *h->lightmaps);
    h->meshes = (drawn *)calloc((size_t)scene->mesh_count + 1, sizeof *h->meshes);
    h->ball_program = host_gl_program(TOOL_NAME, "", ball_vertex_shader, ball_fragment_shader);
    if (!h->program || !h->ball_program || !h->textures || !h->lightmaps || !h->meshes) return 0;
    gl.GenVertexArrays(1, &h->ball_array);
    h->white = texture_of(GL_RGBA8, 1, 1, GL_RGBA, GL_UNSIGNED_BYTE, white);
    /* Bilinear filtering suffices, because light is smooth. Mip maps would mix neighbouring charts where gutters are
       narrow. */
    for (i = 0; i < file->map_count; i++) {
        const image *from = &lightmaps[i];
        h->lightmaps[i] = texture_of(GL_RGB16F, from->width, from->height, GL_RGB, GL_FLOAT, from->values);
        gl.TexParameteri(GL_TEXTURE_2D, GL_TEXTURE_WRAP_S, GL_CLAMP_TO_EDGE);
        gl.TexParameteri(GL_TEXTURE_2D, GL_TEXTURE_WRAP_T, GL_CLAMP_TO_EDGE);
    }
    for (i = 0; i < scene->texture_count; i++) h->textures[i] = scene_texture(&scene->textures[i]);
    for (i = 0; i < scene->mesh_count; i++) mesh_make(&h->meshes[i], &scene->meshes[i]);
    h->color = texture_of(GL_RGBA32F, camera.size[0], camera.size[1], GL_RGBA, GL_FLOAT, NULL);
    h->depth = texture_of(GL_DEPTH_COMPONENT32F, camera.size[0], camera.size[1], GL_DEPTH_COMPONENT, GL_FLOAT, NULL);
    gl.GenFramebuffers(1, &h->framebuffer);
    gl.BindFramebuffer(GL_FRAMEBUFFER, h->framebuffer);
    gl.FramebufferTexture2D(GL_FRAMEBUFFER, GL_COLOR_ATTACHMENT0, GL_TEXTURE_2D, h->color, 0);
    gl.FramebufferTexture2D(GL_FRAMEBUFFER, GL_DEPTH_ATTACHMENT, GL_TEXTURE_2D, h->depth, 0);
    return gl.CheckFramebufferStatus(GL_FRAMEBUFFER) == GL_FRAMEBUFFER_COMPLETE;
}

static void bind_texture(const host *h, const char *name, GLint unit, GLuint texture) {
    gl.Uniform1i(host_gl_uniform(h->program, name), unit);
    gl.ActiveTexture(GL_TEXTURE0 + (GLenum)unit);
    gl.BindTexture(GL_TEXTURE_2D, texture);
}

static void draw(const host *h, const scene_file *file, const float world_to_view[16], const float view_to_clip[16]) {
    static const float still[16] = { 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1 };
    const sbl_scene_desc *scene = &file->scene;
    int i, k, moved;
    gl.Viewport(0, 0, camera.size[0], camera.size[1]);
    gl.ClearColor((float)common.sky[0], (float)common.sky[1], (float)common.sky[2], 1);
    gl.Clear(GL_COLOR_BUFFER_BIT | GL_DEPTH_BUFFER_BIT);
    gl.Enable(GL_DEPTH_TEST);
    gl.UseProgram(h->program);
    gl.UniformMatrix4fv(host_gl_uniform(h->program, "world_to_view"), 1, GL_FALSE, world_to_view);
    gl.UniformMatrix4fv(host_gl_uniform(h->program, "view_to_clip"), 1, GL_FALSE, view_to_clip);
    gl.Uniform1i(host_gl_uniform(h->program, "channel"), channel);
    for (i = 0; i < scene->mesh_count; i++) {
        const sbl_mesh *m = &scene->meshes[i];
        const sbl_material *material = &scene->materials[m->material];
        for (k = moved = 0; k < 16; k++) moved |= m->transform[k] != 0.0f;
        gl.UniformMatrix4fv(host_gl_uniform(h->program, "object_to_world"), 1, GL_FALSE, moved ? m->transform : still);
        gl.Uniform3fv(host_gl_uniform(h->program, "albedo"), 1, material->albedo);
        gl.Uniform3fv(host_gl_uniform(h->program, "emission"), 1, material->emission);
        gl.Uniform1f(host_gl_uniform(h->program, "alpha_cutoff"), material->alpha_cutoff);
        bind_texture(h, "lightmap", 0, h->lightmaps[file->maps[i] < 0 ? 0 : file->maps[i]]);
        bind_texture(h, "albedo_texture", 1, material->albedo_texture ? h->textures[material->albedo_texture - 1]
                     : h->white);
        bind_texture(h, "emission_texture", 2, material->emission_texture ? h->textures[material->emission_texture - 1]
                     : h->white);
        gl.BindVertexArray(h->meshes[i].array);
        gl.DrawElementsInstanced(GL_TRIANGLES, m->index_count, GL_UNSIGNED_INT, NULL, 1);
    }
}

/* ---- the probes that light the ball ---- */

enum { ACROSS = 6, PROBES = ACROSS * ACROSS * ACROSS };

typedef struct room {
    float lowest[3], highest[3];
    float across;                                   /* width + height + depth */
    float world_to_view[16], view_to_clip[16];  /* matrices of the camera */
    sbl_probe probes[PROBES];
} room;

/* Bakes a grid of probes over the bounds of the scene. */
static sbl_result room_bake(room *r, sbl_context *context) {
    progress bar = { 0, now(), 0, 0, 0 };
    sbl_probes_desc desc;
    int k;
    memset(&desc, 0, sizeof desc);
    for (k = 0; k < 3; k++) desc.grid[k] = ACROSS;
    desc.probes = r->probes;
    desc.options = common_options(given, &bar);
    return sbl_bake_probes(context, &desc);
}

/* Computes the position of a camera. The rows of its view matrix are the directions right, up and back. */
static void eye_of(const float world_to_view[16], float eye[3]) {
    const float *m = world_to_view;
    int k;
    for (k = 0; k < 3; k++) eye[k] = -(m[4 * k] * m[12] + m[4 * k + 1] * m[13] + m[4 * k + 2] * m[14]);
}

static sbl_result room_make(room *r, const scene_file *file, sbl_context *context, int *misplaced) {
    const sbl_bounds bounds = sbl_query_bounds(context);
    sbl_result result = SBL_SUCCESS;
    camera_view shot;
    survey s;
    int k;
    memcpy(r->lowest, bounds.lowest, sizeof r->lowest);
    memcpy(r->highest, bounds.highest, sizeof r->highest);
    for (k = 0; k < 3; k++) r->across += r->highest[k] - r->lowest[k];
    survey_begin(&s, context);
    if (!given[EYE] && !camera_of_file(file, &shot, &s)) result = survey_take(&s, context);
    if (result != SBL_SUCCESS) return result;
    camera_choose(&shot, file, given, &s);
    *misplaced = !camera_place(r->world_to_view, r->view_to_clip, &shot, given, &s);
    r->view_to_clip[14] = -0.001f * r->across;  /* puts the near plane at 0.0005 * across */
    return *misplaced || common.output ? result : room_bake(r, context);
}

/* Interpolates the ambient cubes of the eight probes around a point; only valid probes count. */
static void room_light(const room *r, const float point[3], float cube[6][3]) {
    int cell[3], corner, i, k;
    float fraction[3], all = 0;
    memset(cube, 0, 6 * sizeof *cube);
    for (k = 0; k < 3; k++) {
        const float at = (point[k] - r->lowest[k]) / (r->highest[k] - r->lowest[k]) * ACROSS - 0.5f;
        cell[k] = at < 0 ? 0 : at > ACROSS - 2 ? ACROSS - 2 : (int)at;
        fraction[k] = at - (float)cell[k];
        fraction[k] = fraction[k] < 0 ? 0 : fraction[k] > 1 ? 1 : fraction[k];
    }
    for (corner = 0; corner < 8; corner++) {
        float weight = 1;
        int number = 0;
        for (k = 2; k >= 0; k--) {
            weight *= corner >> k & 1 ? fraction[k] : 1 - fraction[k];
            number = number * ACROSS + cell[k] + (corner >> k & 1);
        }
        if (!r->probes[number].valid) continue;
        for (i = 0; i < 6; i++) for (k = 0; k < 3; k++) cube[i][k] += weight * r->probes[number].cube[i][k];
        all += weight;
    }
    for (i = 0; i < 6 && all > 0; i++) for (k = 0; k < 3; k++) cube[i][k] /= all;
}

static void draw_ball(const host *h, const room *r, const float middle[3], const float world_to_view[16],
                      const float view_to_clip[16]) {
    float cube[6][3];
    room_light(r, middle, cube);
    gl.UseProgram(h->ball_program);
    gl.UniformMatrix4fv(host_gl_uniform(h->ball_program, "world_to_view"), 1, GL_FALSE, world_to_view);
    gl.UniformMatrix4fv(host_gl_uniform(h->ball_program, "view_to_clip"), 1, GL_FALSE, view_to_clip);
    gl.Uniform3fv(host_gl_uniform(h->ball_program, "middle"), 1, middle);
    gl.Uniform3fv(host_gl_uniform(h->ball_program, "cube"), 6, cube[0]);
    gl.Uniform1f(host_gl_uniform(h->ball_program, "radius"), 0.015f * r->across);
    gl.BindVertexArray(h->ball_array);
    gl.DrawArraysInstanced(GL_TRIANGLES, 0, BALL_VERTICES, 1);
}

/* ---- the main program ---- */

enum { FRAMES = 12, PICTURE = OWN_TARGETS };

static const tool_line lines[] = {
    { TOOL_HEADING, "Task:" },
    { CHANNEL, "final (default) or radiance" },
    { MODE, NULL },
    { TOOL_HEADING, "Camera:" },
    CAMERA_LINES,
    { TOOL_HEADING, "Light:" },
    LIGHT_LINES,
    { TOOL_HEADING, "Quality:" },
    QUALITY_LINES,
    { TOOL_HEADING, "Output:" },
    { OUTPUT, "also -o; .png or .pfm; default: several frames" },
    OUTPUT_LINES,
    { TOOL_HEADING, "Safety:" },
    SAFETY_LINES
};

static void print_help(void) {
    printf("usage: host_lightmap SCENE FOLDER -o FILE [options]\n"
           "       host_lightmap SCENE FOLDER [options]\n");
    tool_print_text("\n"
                    "Draws SCENE, which has a second set of texture coordinates, in plain OpenGL 3.3, with the light "
                    "that sbl_bake SCENE --lightmap N -o FOLDER wrote to FOLDER: the newest of atlas.exr, .pfm, "
                    ".ktx2, .hdr and .rgbm.png; of several maps, atlas_K.exr and so on for each map K. Without -o, "
                    "the camera moves a little, while a ball passes through the light of probes, and a few frames "
                    "are written: FOLDER/frame_00.png and so on. Options for light apply to the probes.\n");
    tool_print_help(table, OPTION_COUNT, lines, (int)(sizeof lines / sizeof *lines), common.help_all);
}

typedef struct frame { const char *name; image picture; } frame;

static int write_frame(FILE *out, const void *what) {
    const frame *f = (const frame *)what;
    return picture_write(out, f->name, &f->picture, SBL_CHANNEL_FINAL, 0);
}

/* Reads the drawn picture, top row first. Returns 0 on failure. */
static int read_drawn(image *picture) {
    const size_t row = 3 * (size_t)picture->width, height = (size_t)picture->height;
    size_t y, i;
    picture->values = (float *)malloc(row * height * sizeof(float));
    if (!picture->values) return 0;
    gl.ReadPixels(0, 0, picture->width, picture->height, GL_RGB, GL_FLOAT, picture->values);
    for (y = 0; y < height / 2; y++)
        for (i = 0; i < row; i++) {
            float *a = picture->values + y * row + i, *b = picture->values + (height - 1 - y) * row + i;
            const float kept = *a;
            *a = *b;
            *b = kept;
        }
    return gl.GetError() == GL_NO_ERROR;
}

/* Writes the drawn picture as a frame. Returns the exit status. */
static int keep_frame(int number) {
    frame f;
    int status = DONE;
    memset(&f, 0, sizeof f);
    f.name = targets[PICTURE + number].name;
    f.picture.width = camera.size[0];
    f.picture.height = camera.size[1];
    f.picture.components = 3;
    if (!read_drawn(&f.picture)) status = fail("the driver cannot return what it drew");
    else if (!target_write(&targets[PICTURE + number], write_frame, &f, 0))
        status = interrupted ? stop("%s was not written", f.name) : fail_to_write(f.name);
    free(f.picture.values);
    return status;
}

/* Draws all frames: the camera moves to the right, and the ball moves in the same direction, but faster. */
static int draw_walk(const host *h, const scene_file *file, const room *r) {
    const float *start = r->world_to_view, across = r->across;
    float world_to_view[16], eye[3], ball[3];
    int i, k, status = DONE;
    for (i = 0; i < FRAMES && status == DONE; i++) {
        const float time = (float)i / (FRAMES - 1) - 0.5f;
        memcpy(world_to_view, start, sizeof world_to_view);
        world_to_view[12] -= 0.006f * across * time;
        eye_of(world_to_view, eye);
        for (k = 0; k < 3; k++)
            ball[k] = eye[k] + across * (0.08f * time * start[4 * k] - 0.015f * start[4 * k + 1] - 0.1f *
                                         start[4 * k + 2]);
        draw(h, file, world_to_view, r->view_to_clip);
        draw_ball(h, r, ball, world_to_view, r->view_to_clip);
        status = keep_frame(i);
    }
    return status;
}

static int show(const scene_file *file, const image *lightmaps, const room *r) {
    host h = { 0 };
    int status;
    if (!host_gl_open(TOOL_NAME)) return FAILED;
    if (!host_make(&h, file, lightmaps)) status = fail("the driver cannot draw the scene");
    else if (!common.output) status = draw_walk(&h, file, r);
    else {
        draw(&h, file, r->world_to_view, r->view_to_clip);
        status = keep_frame(0);
    }
    free(h.textures);
    free(h.lightmaps);
    free(h.meshes);
    host_gl_close();  /* also destroys all objects of the context */
    return status;
}

/* Reads the maps of all meshes. Returns the exit status. */
static int read_maps(const scene_file *file, image *maps) {
    char path[PATH_MAX], name[PATH_MAX - 16];
    int i;
    if (!maps) return fail("out of memory");
    for (i = 0; i < file->map_count; i++) {
        snprintf(name, sizeof name, file->map_count > 1 ? "%s/atlas_%d" : "%s/atlas", files[1], i);
        map_find(path, sizeof path, name);
        if (!map_read(path, &maps[i]))
            return fail("%s: missing, or not a map of finite numbers; sbl_bake %s --lightmap 512 -o %s makes it", path,
                        files[0], files[1]);
    }
    return DONE;
}

static int draw_all(tool_task *task, double *seconds) {
    const int count = task->file->map_count;
    image *maps = (image *)calloc((size_t)count + 1, sizeof *maps);
    room *r = (room *)calloc(1, sizeof *r);
    sbl_result result = SBL_ERROR_OUT_OF_MEMORY;
    int i, status, misplaced = 0;
    if (r) result = room_make(r, task->file, task->context, &misplaced);
    if (misplaced) status = camera_misuse();
    else if (result == SBL_UNFINISHED) status = stop("nothing was written");
    else if (result != SBL_SUCCESS) status = fail_with(task->said, files[0], result);
    else {
        status = read_maps(task->file, maps);
        if (status == DONE) status = show(task->file, maps, r);
    }
    for (i = 0; i < count && maps; i++) free(maps[i].values);
    free(maps);
    free(r);
    *seconds = now() - task->start;
    return status;
}

int main(int argc, char **argv) {
    static char paths[FRAMES][PATH_MAX];
    const double start = now();
    int i, status = parse(argc, argv);
    if (status != DONE) return status;
    if (given[HELP]) { print_help(); return fflush(stdout) == 0 ? DONE : FAILED; }
    if (given[VERSION]) { printf("host_lightmap %s\n", sbl_version()); return fflush(stdout) == 0 ? DONE : FAILED; }
    catch_signals();
    targets_begin();
    for (i = 0; i < (common.output ? 1 : FRAMES); i++) {
        snprintf(paths[i], sizeof paths[i], "%s/frame_%02d.png", files[1], i);
        output_find(&targets[PICTURE + i], common.output ? common.output : paths[i]);
        target_count = PICTURE + i + 1;
    }
    status = targets_check(target_count, given);
    if (status == DONE) status = tool_run(start, given, draw_all, NULL, NULL);
    targets_free();
    return status;
}
