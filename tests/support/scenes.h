/* Builds scenes for the tests with public types only, and makes the few calls that every picture needs.
       test_scene s = { 0 };
       int white = scene_material(&s, 0.7f, 0.7f, 0.7f);
       scene_box(&s, white, -1, -1, -1, 1, 1, 1);
       ... scene_desc(&s) ... scene_free(&s);
   Include after sbl.h and test.h. */
#ifndef SCENES_H
#define SCENES_H

#include <math.h>
#include <stdint.h>
#include <stdlib.h>

#define SCENE_PI 3.14159265358979323846

enum { SCENE_MESHES = 96, SCENE_MATERIALS = 96, SCENE_TEXTURES = 64, SCENE_LIGHTS = 640, SCENE_BLOCKS = 512 };

typedef struct test_scene {
    sbl_mesh meshes[SCENE_MESHES];
    sbl_material materials[SCENE_MATERIALS];
    sbl_texture textures[SCENE_TEXTURES];
    sbl_light lights[SCENE_LIGHTS];
    int mesh_count, material_count, texture_count, light_count;
    float sky[3];
    sbl_environment environment;
    void *blocks[SCENE_BLOCKS];  /* memory that the meshes and textures use */
    int block_count;
} test_scene;

static inline void *scene_alloc(test_scene *s, size_t bytes) {
    void *block = calloc(1, bytes ? bytes : 1);
    if (!block || s->block_count == SCENE_BLOCKS) abort();
    s->blocks[s->block_count++] = block;
    return block;
}

static inline void scene_free(test_scene *s) {
    while (s->block_count) free(s->blocks[--s->block_count]);
    memset(s, 0, sizeof *s);
}

/* Returns the descriptor of the scene, with the smallest store of bounced light, which is filled fastest. */
static inline sbl_scene_desc scene_desc(const test_scene *s) {
    sbl_scene_desc desc;
    memset(&desc, 0, sizeof desc);
    desc.max_bounce_cells = 1024;
    desc.meshes = s->meshes;
    desc.mesh_count = s->mesh_count;
    desc.materials = s->materials;
    desc.material_count = s->material_count;
    desc.textures = s->textures;
    desc.texture_count = s->texture_count;
    desc.lights = s->lights;
    desc.light_count = s->light_count;
    desc.environment = s->environment;
    memcpy(desc.sky, s->sky, sizeof desc.sky);
    return desc;
}

static inline void scene_sky(test_scene *s, float r, float g, float b) {
    s->sky[0] = r; s->sky[1] = g; s->sky[2] = b;
}

static inline int scene_material(test_scene *s, float r, float g, float b) {
    sbl_material *m = &s->materials[s->material_count];
    if (s->material_count == SCENE_MATERIALS) abort();
    memset(m, 0, sizeof *m);
    m->albedo[0] = r; m->albedo[1] = g; m->albedo[2] = b;
    return s->material_count++;
}

/* Adds a light. The caller sets its position and direction. */
static inline sbl_light *scene_light(test_scene *s, sbl_light_kind kind, float r, float g, float b) {
    sbl_light *light = &s->lights[s->light_count];
    if (s->light_count++ == SCENE_LIGHTS) abort();
    memset(light, 0, sizeof *light);
    light->kind = kind;
    light->intensity[0] = r; light->intensity[1] = g; light->intensity[2] = b;
    return light;
}

/* Adds a material that emits and does not reflect. */
static inline int scene_lamp(test_scene *s, float r, float g, float b) {
    int material = scene_material(s, 0, 0, 0);
    float *emission = s->materials[material].emission;
    emission[0] = r; emission[1] = g; emission[2] = b;
    return material;
}

/* Adds a texture and copies its pixels; `bytes` is height times stride. Returns the number for materials, which counts
   from 1. */
static inline int scene_texture(test_scene *s, const void *pixels, size_t bytes, sbl_pixel_format format, int width,
                                int height, int channels) {
    sbl_texture *t = &s->textures[s->texture_count];
    void *copy = scene_alloc(s, bytes);
    if (s->texture_count == SCENE_TEXTURES) abort();
    memcpy(copy, pixels, bytes);
    memset(t, 0, sizeof *t);
    t->pixels = copy;
    t->format = format;
    t->width = width;
    t->height = height;
    t->channels = channels;
    return ++s->texture_count;
}

static inline const float *scene_copy(test_scene *s, const float *values, int count) {
    float *copy = (float *)scene_alloc(s, sizeof(float) * (size_t)count);
    memcpy(copy, values, sizeof(float) * (size_t)count);
    return copy;
}

/* Adds a mesh. normals, texcoords: NULL, or 3 and 2 floats per vertex. indices: NULL if each three vertices form a
   triangle */
static inline sbl_mesh *scene_mesh(test_scene *s, int material, const float *positions, const float *normals,
                                   const float *texcoords, int vertex_count,
                                   const uint32_t *indices, int index_count) {
    sbl_mesh *m = &s->meshes[s->mesh_count];
    uint32_t *copy = (uint32_t *)scene_alloc(s, sizeof *indices * (size_t)index_count);
    if (s->mesh_count++ == SCENE_MESHES) abort();
    memset(m, 0, sizeof *m);
    if (indices) memcpy(copy, indices, sizeof *indices * (size_t)index_count);
    m->positions.data = scene_copy(s, positions, 3 * vertex_count);
    if (normals) m->normals.data = scene_copy(s, normals, 3 * vertex_count);
    if (texcoords) m->texcoords.data = scene_copy(s, texcoords, 2 * vertex_count);
    m->vertex_count = vertex_count;
    m->indices.data = indices ? copy : NULL;
    m->indices.type = SBL_UINT32;
    m->index_count = index_count;
    m->material = material;
    return m;
}

/* Adds a convex polygon. corners: in order */
static inline sbl_mesh *scene_polygon(test_scene *s, int material, const float *corners, int count) {
    uint32_t indices[3 * 16];
    int i;
    if (count > 18) abort();
    for (i = 0; i < count - 2; i++) {
        indices[3 * i] = 0;
        indices[3 * i + 1] = (uint32_t)i + 1;
        indices[3 * i + 2] = (uint32_t)i + 2;
    }
    return scene_mesh(s, material, corners, NULL, NULL, count, indices, 3 * (count - 2));
}

/* Adds a quad with the corners a b c d in order and the texture coordinates 0 0, u 0, u v, 0 v. */
static inline sbl_mesh *scene_quad_uv(test_scene *s, int material, const float corners[12], float u, float v) {
    static const uint32_t indices[6] = { 0, 1, 2, 0, 2, 3 };
    float uv[8] = { 0, 0, 0, 0, 0, 0, 0, 0 };
    uv[2] = uv[4] = u;
    uv[5] = uv[7] = v;
    return scene_mesh(s, material, corners, NULL, uv, 4, indices, 6);
}

static inline sbl_mesh *scene_quad(test_scene *s, int material, float ax, float ay, float az, float bx, float by,
                                   float bz,
                                   float cx, float cy, float cz, float dx, float dy, float dz) {
    const float corners[12] = { ax, ay, az, bx, by, bz, cx, cy, cz, dx, dy, dz };
    return scene_quad_uv(s, material, corners, 1, 1);
}

/* Adds a square floor about (0, y, 0), counter-clockwise as seen from above. */
static inline sbl_mesh *scene_floor(test_scene *s, int material, float y, float half) {
    return scene_quad(s, material, -half, y, -half, -half, y, half, half, y, half, half, y, -half);
}

/* Adds a black square plate with a rectangular hole. The plate is at y = 1 and extends from -0.6 to 0.6 in x and z.
   Seen from the origin, the hole shows the part of the plane y = 2 with x from 0.4 to 0.6 and z from 0.2 to 0.4. */
static inline void scene_plate_with_hole(test_scene *s) {
    static const float x[4] = { -0.6f, 0.2f, 0.3f, 0.6f }, z[4] = { -0.6f, 0.1f, 0.2f, 0.6f };
    const int black = scene_material(s, 0, 0, 0);
    int i;
    for (i = 0; i < 9; i++) {
        const float *a = x + i % 3, *b = z + i / 3;
        if (i != 4) scene_quad(s, black, a[0], 1, b[0], a[0], 1, b[1], a[1], 1, b[1], a[1], 1, b[0]);
    }
}

/* Adds six quads that face outwards; each is a mesh with its own id. */
static inline void scene_box(test_scene *s, int material, float x0, float y0, float z0, float x1, float y1, float z1) {
    scene_quad(s, material, x0, y0, z0, x0, y0, z1, x0, y1, z1, x0, y1, z0);
    scene_quad(s, material, x1, y0, z0, x1, y1, z0, x1, y1, z1, x1, y0, z1);
    scene_quad(s, material, x0, y0, z0, x1, y0, z0, x1, y0, z1, x0, y0, z1);
    scene_quad(s, material, x0, y1, z0, x0, y1, z1, x1, y1, z1, x1, y1, z0);
    scene_quad(s, material, x0, y0, z0, x0, y1, z0, x1, y1, z0, x1, y0, z0);
    scene_quad(s, material, x0, y0, z1, x1, y0, z1, x1, y1, z1, x0, y1, z1);
}

static inline sbl_mesh *scene_sphere(test_scene *s, int material, float x, float y, float z, float radius, int slices,
                                     int stacks, int smooth) {
    int row = slices + 1, vertices = row * (stacks + 1), i, j, n = 0;
    float *positions = (float *)scene_alloc(s, sizeof(float) * 3 * (size_t)vertices),
        *normals = (float *)scene_alloc(s, sizeof(float) * 3 * (size_t)vertices);
    uint32_t *indices = (uint32_t *)scene_alloc(s, sizeof *indices * 6 * (size_t)(slices * stacks));
    const double pi = SCENE_PI;
    for (i = 0; i <= stacks; i++)
        for (j = 0; j <= slices; j++) {
            double theta = pi * i / stacks, phi = 2 * pi * (j % slices) / slices, ring = i == 0 || i ==
                stacks ? 0 : sin(theta);
            float *p = positions + 3 * (i * row + j), *q = normals + 3 * (i * row + j);
            q[0] = (float)(ring * cos(phi)); q[1] = (float)cos(theta); q[2] = (float)(-ring * sin(phi));
            p[0] = x + radius * q[0]; p[1] = y + radius * q[1]; p[2] = z + radius * q[2];
        }
    for (i = 0; i < stacks; i++)
        for (j = 0; j < slices; j++) {
            uint32_t a = (uint32_t)(i * row + j), b = a + (uint32_t)row;
            if (i > 0) { indices[n++] = a; indices[n++] = b; indices[n++] = a + 1; }
            if (i < stacks - 1) { indices[n++] = a + 1; indices[n++] = b; indices[n++] = b + 1; }
        }
    return scene_mesh(s, material, positions, smooth ? normals : NULL, NULL, vertices, indices, n);
}

/* Applies scale * position + offset to all vertices and lights, without transforms. The lights cause the same
   irradiance as before. */
static inline void scene_scale_and_move(test_scene *s, float scale, float x, float y, float z) {
    float offset[3];
    int i, j;
    offset[0] = x; offset[1] = y; offset[2] = z;
    for (i = 0; i < s->mesh_count; i++) {
        const float *from = (const float *)s->meshes[i].positions.data;
        float *to = (float *)scene_alloc(s, sizeof(float) * 3 * (size_t)s->meshes[i].vertex_count);
        for (j = 0; j < 3 * s->meshes[i].vertex_count; j++) to[j] = from[j] * scale + offset[j % 3];
        s->meshes[i].positions.data = to;
    }
    for (i = 0; i < s->light_count; i++) {
        sbl_light *light = &s->lights[i];
        light->radius *= scale;
        for (j = 0; j < 3; j++) {
            light->position[j] = light->position[j] * scale + offset[j];
            if (light->kind != SBL_LIGHT_DIRECTIONAL) light->intensity[j] *= scale * scale;
        }
    }
}

/* Adds a flat fan of triangles around its centre. Its corners are at centre + u cos + v sin, counter-clockwise as seen
   from the side that u x v points to. */
static inline sbl_mesh *scene_disc(test_scene *s, int material, const float centre[3], const float u[3],
                                   const float v[3], int triangles) {
    float *positions = (float *)scene_alloc(s, sizeof(float) * 3 * (size_t)(triangles + 1));
    uint32_t *indices = (uint32_t *)scene_alloc(s, sizeof *indices * 3 * (size_t)triangles);
    int i, k;
    for (k = 0; k < 3; k++) positions[3 * triangles + k] = centre[k];
    for (i = 0; i < triangles; i++) {
        double phi = 2 * SCENE_PI * i / triangles;
        for (k = 0; k < 3; k++)
            positions[3 * i + k] = (float)((double)centre[k] + (double)u[k] * cos(phi) + (double)v[k] * sin(phi));
        indices[3 * i] = (uint32_t)triangles;
        indices[3 * i + 1] = (uint32_t)i;
        indices[3 * i + 2] = (uint32_t)((i + 1) % triangles);
    }
    return scene_mesh(s, material, positions, NULL, NULL, triangles + 1, indices, 3 * triangles);
}

/* Adds the Cornell box with the published measurements in millimetres, open at the front (z = 0) and lit by one quad.
   Meshes: 0 floor, 1 lamp, 2 ceiling, 3 back, 4 right, 5 left, 6 to 10 short block, 11 to 15 tall block. */
static inline void scene_cornell_box(test_scene *s) {
    static const float quads[16][12] = {
        { 552.8f, 0, 0, 0, 0, 0, 0, 0, 559.2f, 549.6f, 0, 559.2f },
        { 343, 548.7f, 227, 343, 548.7f, 332, 213, 548.7f, 332, 213, 548.7f, 227 },
        { 556, 548.8f, 0, 556, 548.8f, 559.2f, 0, 548.8f, 559.2f, 0, 548.8f, 0 },
        { 549.6f, 0, 559.2f, 0, 0, 559.2f, 0, 548.8f, 559.2f, 556, 548.8f, 559.2f },
        { 0, 0, 559.2f, 0, 0, 0, 0, 548.8f, 0, 0, 548.8f, 559.2f },
        { 552.8f, 0, 0, 549.6f, 0, 559.2f, 556, 548.8f, 559.2f, 556, 548.8f, 0 },
        { 130, 165, 65, 82, 165, 225, 240, 165, 272, 290, 165, 114 },
        { 290, 0, 114, 290, 165, 114, 240, 165, 272, 240, 0, 272 },
        { 130, 0, 65, 130, 165, 65, 290, 165, 114, 290, 0, 114 },
        { 82, 0, 225, 82, 165, 225, 130, 165, 65, 130, 0, 65 },
        { 240, 0, 272, 240, 165, 272, 82, 165, 225, 82, 0, 225 },
        { 423, 330, 247, 265, 330, 296, 314, 330, 456, 472, 330, 406 },
        { 423, 0, 247, 423, 330, 247, 472, 330, 406, 472, 0, 406 },
        { 472, 0, 406, 472, 330, 406, 314, 330, 456, 314, 0, 456 },
        { 314, 0, 456, 314, 330, 456, 265, 330, 296, 265, 0, 296 },
        { 265, 0, 296, 265, 330, 296, 423, 330, 247, 423, 0, 247 } };
    int white = scene_material(s, 0.75f, 0.75f, 0.75f), green = scene_material(s, 0.1f, 0.6f, 0.1f);
    int red = scene_material(s, 0.6f, 0.1f, 0.1f), lamp = scene_lamp(s, 17, 12, 4), i;
    for (i = 0; i < 16; i++) scene_quad_uv(s, i == 1 ? lamp : i == 4 ? green : i == 5 ? red : white, quads[i], 1, 1);
}

/* >>making pictures */

/* Gets the bounds of the scene. Returns 1. */
static inline int scene_bounds(const sbl_context *context, float lowest[3], float highest[3]) {
    const sbl_bounds bounds = sbl_query_bounds(context);
    memcpy(lowest, bounds.lowest, sizeof bounds.lowest);
    memcpy(highest, bounds.highest, sizeof bounds.highest);
    return 1;
}

/* Returns a view in SBL_MODE_AMBIENT, which is faster than the default and whose epsilon closed forms use. facet_limit
   is off, as in references and closed forms, so that shading normals apply to all triangles. */
static inline sbl_picture_desc scene_view(int width, int height, float fov, float ex, float ey, float ez, float ax,
                                          float ay, float az) {
    sbl_picture_desc view;
    memset(&view, 0, sizeof view);
    view.options.mode = SBL_MODE_AMBIENT;
    view.facet_limit = -1;
    view.width = width;
    view.height = height;
    if (!sbl_look_at(view.world_to_view, ex, ey, ez, ax, ay, az, 0, 1, 0))
        sbl_look_at(view.world_to_view, ex, ey, ez, ax, ay, az, 0, 0, -1);
    sbl_perspective(view.view_to_clip, fov, (float)width / (float)height);
    return view;
}

/* Returns a descriptor that measures R at these sites. */
static inline sbl_readings_desc scene_readings(const sbl_site *sites, sbl_reading *readings, int count, sbl_mode mode) {
    sbl_readings_desc desc;
    memset(&desc, 0, sizeof desc);
    desc.sites = sites;
    desc.readings = readings;
    desc.site_count = count;
    desc.options.mode = mode;
    return desc;
}

static inline sbl_picture_desc scene_cornell_view(int width, int height) {
    return scene_view(width, height, 39.3077f, 278, 273, -800, 278, 273, 0);
}

/* Gives a view a sensor at every pixel and no filter, so that only the measurement is tested. */
static inline sbl_picture_desc scene_plain(sbl_picture_desc view, sbl_mode mode, int sensor_size) {
    view.options.mode = mode;
    view.tile = 1;
    view.filter_radius = -1;
    view.samples = 1;
    view.options.sensor_size = sensor_size;
    view.options.rays = 256;
    if (sensor_size) view.options.backend = SBL_BACKEND_RASTER;
    return view;
}

static inline int scene_render(sbl_context *context, const test_scene *s, const sbl_picture_desc *view) {
    sbl_scene_desc desc = scene_desc(s);
    sbl_result result = sbl_set_scene(context, &desc);
    if (result == SBL_SUCCESS) result = sbl_render_picture(context, view);
    CHECK(result == SBL_SUCCESS, "the picture failed: %s", sbl_result_string(result));
    return result == SBL_SUCCESS;
}

/* Returns a channel of the finished picture, which the caller frees. If the channel cannot be read, it is filled with
   NaN, so that every comparison fails. */
static inline float *scene_channel(sbl_context *context, const sbl_picture_desc *view, sbl_channel channel) {
    size_t count = (size_t)view->width * (size_t)view->height * (size_t)(sbl_channel_components(channel) > 1 ? 3 : 1),
        i;
    float *values = (float *)malloc(count * sizeof *values);
    if (!values) abort();
    for (i = 0; i < count; i++) values[i] = (float)NAN;
    CHECK(sbl_read_channel(context, channel, values, count) == SBL_SUCCESS, "channel %d cannot be read", (int)channel);
    return values;
}

#endif
