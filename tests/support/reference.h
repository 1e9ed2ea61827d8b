/* A ray caster for the tests, in double precision on the CPU. It shares no code with sbl.h. It reads scenes and cameras
   from the public types, so that one description serves both.
       ref_scene *scene = ref_create(&desc);
       ref_hit hit = ref_trace(scene, origin, direction, 0, HUGE_VAL, SBL_MATERIAL_HIDDEN_FROM_CAMERA);
       if (hit.triangle >= 0) point = ref_surface(scene, hit, direction);
       ref_destroy(scene);
   Include it after sbl.h. */
#ifndef REFERENCE_H
#define REFERENCE_H

#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#define REF_PI 3.14159265358979323846

/* >>vectors */

typedef struct v3 { double x, y, z; } v3;

static inline v3 v3_of(double x, double y, double z) { v3 v; v.x = x; v.y = y; v.z = z; return v; }
static inline v3 v3_from(const float *f) { return v3_of((double)f[0], (double)f[1], (double)f[2]); }
static inline v3 v3_add(v3 a, v3 b) { return v3_of(a.x + b.x, a.y + b.y, a.z + b.z); }
static inline v3 v3_sub(v3 a, v3 b) { return v3_of(a.x - b.x, a.y - b.y, a.z - b.z); }
static inline v3 v3_scale(v3 a, double s) { return v3_of(a.x * s, a.y * s, a.z * s); }
static inline v3 v3_mad(v3 a, v3 b, double s) { return v3_of(a.x + b.x * s, a.y + b.y * s, a.z + b.z * s); }
static inline double v3_dot(v3 a, v3 b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
static inline v3 v3_cross(v3 a, v3 b) {
    return v3_of(a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x);
}
static inline double v3_length(v3 a) { return sqrt(v3_dot(a, a)); }
static inline v3 v3_unit(v3 a) { return v3_scale(a, 1 / v3_length(a)); }
static inline double v3_axis(v3 a, int axis) { return axis == 0 ? a.x : axis == 1 ? a.y : a.z; }

/* Returns a pseudo-random number that is uniform in [0, 1). */
static inline double ref_random(uint64_t *state) {
    uint64_t z = (*state += 0x9E3779B97F4A7C15u);  /* SplitMix64 (Steele, Lea and Flood 2014) */
    z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9u;
    z = (z ^ (z >> 27)) * 0x94D049BB133111EBu;
    return (double)((z ^ (z >> 31)) >> 11) / 9007199254740992.0;
}

/* >>scene */

typedef struct ref_triangle {
    v3 p[3], n[3];
    double uv[3][2], color[3][4];
    int mesh, smooth;
} ref_triangle;

typedef struct ref_node {
    double low[3], high[3];
    int first, count;  /* triangles of a leaf; count 0: an inner node with the children next and `first` */
} ref_node;

typedef struct ref_scene {
    sbl_scene_desc desc;  /* its pointers refer to the data of the caller */
    ref_triangle *triangles;
    ref_node *nodes;
    int triangle_count, node_count;
} ref_scene;

static inline double ref_number(const unsigned char *at, sbl_type type) {
    uint16_t u16;
    uint32_t u32;
    float f32;
    int integer;
    double value;
    switch (type) {
    case SBL_FLOAT32: memcpy(&f32, at, 4); return (double)f32;
    case SBL_FLOAT16:
        memcpy(&u16, at, 2);
        integer = (u16 >> 10) & 31;
        value = integer ? ldexp(1024 + (u16 & 1023), integer - 25) : ldexp(u16 & 1023, -24);
        return u16 & 0x8000 ? -value : value;
    case SBL_UINT8_NORM: return at[0] / 255.0;
    case SBL_UINT16_NORM: memcpy(&u16, at, 2); return u16 / 65535.0;
    case SBL_INT8_NORM: integer = at[0] < 128 ? at[0] : at[0] - 256; return integer < -127 ? -1 : integer / 127.0;
    case SBL_INT16_NORM:
        memcpy(&u16, at, 2);
        integer = u16 < 32768 ? u16 : u16 - 65536;
        return integer < -32767 ? -1 : integer / 32767.0;
    case SBL_UINT8: return at[0];
    case SBL_UINT16: memcpy(&u16, at, 2); return u16;
    case SBL_UINT32: memcpy(&u32, at, 4); return u32;
    default: return NAN;
    }
}

static inline size_t ref_type_bytes(sbl_type type) {
    return type == SBL_FLOAT32 || type == SBL_UINT32 ? 4 : type == SBL_UINT8 || type == SBL_UINT8_NORM || type ==
        SBL_INT8_NORM ? 1 : 2;
}

static inline void ref_element(const sbl_stream *stream, size_t number, int components, double *out) {
    size_t bytes = ref_type_bytes(stream->type), stride = stream->stride ? stream->stride : bytes * (size_t)components;
    const unsigned char *at = (const unsigned char *)stream->data + stream->offset + number * stride;
    int i;
    for (i = 0; i < components; i++) out[i] = ref_number(at + (size_t)i * bytes, stream->type);
}

static inline void ref_load_mesh(ref_scene *scene, int number) {
    const sbl_mesh *mesh = &scene->desc.meshes[number];
    int corners = mesh->indices.data ? mesh->index_count : mesh->vertex_count, i, k;
    double m[16], e[4], index;
    int identity = 1;
    for (i = 0; i < 16; i++) { m[i] = (double)mesh->transform[i]; if (m[i] != 0) identity = 0; }
    if (identity) m[0] = m[5] = m[10] = m[15] = 1;
    for (i = 0; i + 2 < corners; i += 3) {
        ref_triangle *t = &scene->triangles[scene->triangle_count];
        memset(t, 0, sizeof *t);
        t->mesh = number;
        t->smooth = mesh->normals.data != NULL;
        for (k = 0; k < 3; k++) {
            v3 a = v3_of(m[0], m[1], m[2]), b = v3_of(m[4], m[5], m[6]), c = v3_of(m[8], m[9], m[10]);
            size_t v;
            index = i + k;
            if (mesh->indices.data) ref_element(&mesh->indices, (size_t)(i + k), 1, &index);
            v = (size_t)index;
            ref_element(&mesh->positions, v, 3, e);
            t->p[k] = v3_mad(v3_mad(v3_mad(v3_of(m[12], m[13], m[14]), a, e[0]), b, e[1]), c, e[2]);
            /* normals are transformed by the inverse transpose, which equals the cofactor matrix up to a factor */
            if (t->smooth) {
                ref_element(&mesh->normals, v, 3, e);
                t->n[k] = v3_unit(v3_add(v3_add(v3_scale(v3_cross(b, c), e[0]), v3_scale(v3_cross(c, a), e[1])),
                                         v3_scale(v3_cross(a, b), e[2])));
            }
            if (mesh->texcoords.data) ref_element(&mesh->texcoords, v, 2, t->uv[k]);
            if (mesh->colors.data) ref_element(&mesh->colors, v, 4, t->color[k]);
            else t->color[k][0] = t->color[k][1] = t->color[k][2] = t->color[k][3] = 1;
        }
        if (v3_length(v3_cross(v3_sub(t->p[1], t->p[0]), v3_sub(t->p[2], t->p[0]))) > 0) scene->triangle_count++;
    }
}

static int ref_sort_axis;

static inline int ref_by_centre(const void *a, const void *b) {
    const v3 *p = ((const ref_triangle *)a)->p, *q = ((const ref_triangle *)b)->p;
    double x = v3_axis(p[0], ref_sort_axis) + v3_axis(p[1], ref_sort_axis) + v3_axis(p[2], ref_sort_axis);
    double y = v3_axis(q[0], ref_sort_axis) + v3_axis(q[1], ref_sort_axis) + v3_axis(q[2], ref_sort_axis);
    return x < y ? -1 : x > y;
}

/* Divides the triangles along the longest side of their box until each leaf has few. */
static inline void ref_build(ref_scene *scene, int first, int count) {
    int self = scene->node_count++, i, k, axis;
    ref_node *node = &scene->nodes[self];
    for (axis = 0; axis < 3; axis++) {
        node->low[axis] = HUGE_VAL;
        node->high[axis] = -HUGE_VAL;
        for (i = first; i < first + count; i++)
            for (k = 0; k < 3; k++) {
                double x = v3_axis(scene->triangles[i].p[k], axis);
                if (x < node->low[axis]) node->low[axis] = x;
                if (x > node->high[axis]) node->high[axis] = x;
            }
    }
    node->first = first;
    node->count = count;
    if (count <= 3) return;
    ref_sort_axis = 0;
    for (axis = 1; axis < 3; axis++)
        if (node->high[axis] - node->low[axis] > node->high[ref_sort_axis] - node->low[ref_sort_axis])
            ref_sort_axis = axis;
    qsort(scene->triangles + first, (size_t)count, sizeof *scene->triangles, ref_by_centre);
    node->count = 0;
    ref_build(scene, first, count / 2);
    scene->nodes[self].first = scene->node_count;
    ref_build(scene, first + count / 2, count - count / 2);
}

static inline ref_scene *ref_create(const sbl_scene_desc *desc) {
    ref_scene *scene = (ref_scene *)calloc(1, sizeof *scene);
    size_t most = 0;
    int i;
    if (!scene) abort();
    scene->desc = *desc;
    for (i = 0; i < desc->mesh_count; i++)
        most += (size_t)(desc->meshes[i].indices.data ? desc->meshes[i].index_count : desc->meshes[i].vertex_count) / 3;
    scene->triangles = (ref_triangle *)calloc(most + 1, sizeof *scene->triangles);
    scene->nodes = (ref_node *)calloc(2 * most + 2, sizeof *scene->nodes);
    if (!scene->triangles || !scene->nodes) abort();
    for (i = 0; i < desc->mesh_count; i++) ref_load_mesh(scene, i);
    if (scene->triangle_count) ref_build(scene, 0, scene->triangle_count);
    return scene;
}

static inline void ref_destroy(ref_scene *scene) {
    free(scene->triangles);
    free(scene->nodes);
    free(scene);
}

/* >>textures */

static inline double ref_from_srgb(double c) { return c <= 0.04045 ? c / 12.92 : pow((c + 0.055) / 1.055, 2.4); }

static inline void ref_texel(const sbl_texture *texture, int x, int y, double rgba[4]) {
    int channels = texture->channels ? texture->channels : 4, c;
    size_t bytes = texture->format == SBL_PIXELS_FLOAT ? 4 : 1;
    size_t stride = texture->stride ? texture->stride : bytes * (size_t)(channels * texture->width);
    const unsigned char *at;
    double value[4];
    if (texture->wrap == SBL_WRAP_CLAMP) {
        x = x < 0 ? 0 : x >= texture->width ? texture->width - 1 : x;
        y = y < 0 ? 0 : y >= texture->height ? texture->height - 1 : y;
    } else {
        x = ((x % texture->width) + texture->width) % texture->width;
        y = ((y % texture->height) + texture->height) % texture->height;
    }
    at = (const unsigned char *)texture->pixels + (size_t)y * stride + (size_t)(x * channels) * bytes;
    for (c = 0; c < channels; c++)
        value[c] = ref_number(at + (size_t)c * bytes, texture->format ==
                              SBL_PIXELS_FLOAT ? SBL_FLOAT32 : SBL_UINT8_NORM);
    for (c = 0; c < 3; c++) {
        rgba[c] = value[channels < 3 ? 0 : c];
        if (texture->format == SBL_PIXELS_SRGB8) rgba[c] = ref_from_srgb(rgba[c]);
    }
    rgba[3] = channels == 2 ? value[1] : channels == 4 ? value[3] : 1;
}

/* Samples a texture. number: from 1; 0 means white */
static inline void ref_sample(const ref_scene *scene, int number, double u, double v, double rgba[4]) {
    double corner[4][4], x, y, fx, fy;
    int i, x0, y0;
    for (i = 0; i < 4; i++) rgba[i] = 1;
    if (!number) return;
    x = u * scene->desc.textures[number - 1].width - 0.5;
    y = v * scene->desc.textures[number - 1].height - 0.5;
    x0 = (int)floor(x); y0 = (int)floor(y);
    fx = x - x0; fy = y - y0;
    for (i = 0; i < 4; i++) ref_texel(&scene->desc.textures[number - 1], x0 + (i & 1), y0 + (i >> 1), corner[i]);
    for (i = 0; i < 4; i++)
        rgba[i] = (1 - fy) * ((1 - fx) * corner[0][i] + fx * corner[1][i]) + fy *
            ((1 - fx) * corner[2][i] + fx * corner[3][i]);
}

/* >>rays */

typedef struct ref_hit {
    int triangle;      /* -1: nothing was hit */
    double t, b1, b2;  /* distance / length of the direction; weights of the second and third corner */
} ref_hit;

typedef struct ref_point {
    v3 position, normal, face;  /* normal: shading normal; face: geometric normal; both face the ray */
    double albedo[3], emission[3];
    uint32_t id;
    int mesh, back, hit;
} ref_point;

static inline void ref_albedo(const ref_scene *scene, ref_hit hit, double rgba[4]) {
    const ref_triangle *t = &scene->triangles[hit.triangle];
    const sbl_material *material = &scene->desc.materials[scene->desc.meshes[t->mesh].material];
    double b0 = 1 - hit.b1 - hit.b2;
    int i;
    ref_sample(scene, material->albedo_texture, b0 * t->uv[0][0] + hit.b1 * t->uv[1][0] + hit.b2 * t->uv[2][0],
               b0 * t->uv[0][1] + hit.b1 * t->uv[1][1] + hit.b2 * t->uv[2][1], rgba);
    for (i = 0; i < 4; i++)
        rgba[i] *= (i < 3 ? (double)material->albedo[i] : 1) *
            (b0 * t->color[0][i] + hit.b1 * t->color[1][i] + hit.b2 * t->color[2][i]);
}

/* Returns the nearest hit with low < t < high. It ignores materials with the flag `hidden` and cut-out parts. */
static inline ref_hit ref_trace(const ref_scene *scene, v3 origin, v3 direction, double low, double high,
                                uint32_t hidden) {
    int stack[64], depth = 0, i, axis;
    ref_hit best;
    best.triangle = -1;
    best.t = high;
    best.b1 = best.b2 = 0;
    if (scene->node_count) stack[depth++] = 0;
    while (depth) {
        const int self = stack[--depth];
        const ref_node *node = &scene->nodes[self];
        double enter = low, leave = best.t;
        for (axis = 0; axis < 3; axis++) {
            double d = v3_axis(direction, axis), o = v3_axis(origin, axis),
                slack = 1e-9 * (fabs(node->low[axis]) + fabs(node->high[axis]));
            double a = node->low[axis] - slack, b = node->high[axis] + slack;
            if (d == 0) { if (o < a || o > b) leave = -HUGE_VAL; continue; }
            a = (a - o) / d; b = (b - o) / d;
            if (a > b) { double swap = a; a = b; b = swap; }
            if (a > enter) enter = a;
            if (b < leave) leave = b;
        }
        if (enter > leave) continue;
        if (!node->count) { stack[depth++] = self + 1; stack[depth++] = node->first; continue; }
        for (i = node->first; i < node->first + node->count; i++) {
            const ref_triangle *tri = &scene->triangles[i];
            const sbl_material *material = &scene->desc.materials[scene->desc.meshes[tri->mesh].material];
            v3 e1 = v3_sub(tri->p[1], tri->p[0]), e2 = v3_sub(tri->p[2], tri->p[0]), s = v3_sub(origin, tri->p[0]);
            v3 h = v3_cross(direction, e2), q = v3_cross(s, e1);
            double determinant = v3_dot(e1, h), rgba[4];
            ref_hit hit;
            if (determinant == 0 || (material->flags & hidden)) continue;
            hit.triangle = i;
            hit.b1 = v3_dot(s, h) / determinant;
            hit.b2 = v3_dot(direction, q) / determinant;
            hit.t = v3_dot(e2, q) / determinant;
            /* the triangle is enlarged slightly, so that no ray passes between two triangles */
            if (hit.b1 < -1e-9 || hit.b2 < -1e-9 || hit.b1 + hit.b2 > 1 + 1e-9 || hit.t <= low || hit.t >= best.t)
                continue;
            if (material->alpha_cutoff > 0) {
                ref_albedo(scene, hit, rgba);
                if (rgba[3] < (double)material->alpha_cutoff) continue;
            }
            best = hit;
        }
    }
    return best;
}

static inline ref_point ref_surface(const ref_scene *scene, ref_hit hit, v3 direction) {
    ref_point point;
    const ref_triangle *t;
    const sbl_mesh *mesh;
    const sbl_material *material;
    double b0 = 1 - hit.b1 - hit.b2, rgba[4], emission[4];
    int i;
    memset(&point, 0, sizeof point);
    if (hit.triangle < 0) return point;
    t = &scene->triangles[hit.triangle];
    mesh = &scene->desc.meshes[t->mesh];
    material = &scene->desc.materials[mesh->material];
    point.hit = 1;
    point.mesh = t->mesh;
    point.id = mesh->id ? mesh->id : (uint32_t)t->mesh + 1;
    point.position = v3_add(v3_add(v3_scale(t->p[0], b0), v3_scale(t->p[1], hit.b1)), v3_scale(t->p[2], hit.b2));
    point.face = v3_unit(v3_cross(v3_sub(t->p[1], t->p[0]), v3_sub(t->p[2], t->p[0])));
    point.back = v3_dot(point.face, direction) > 0;
    if (point.back) point.face = v3_scale(point.face, -1);
    point.normal = point.face;
    if (t->smooth) {
        point.normal = v3_unit(v3_add(v3_add(v3_scale(t->n[0], b0), v3_scale(t->n[1], hit.b1)),
                                      v3_scale(t->n[2], hit.b2)));
        if (v3_dot(point.normal, point.face) < 0) point.normal = v3_scale(point.normal, -1);
    }
    ref_albedo(scene, hit, rgba);
    ref_sample(scene, material->emission_texture, b0 * t->uv[0][0] + hit.b1 * t->uv[1][0] + hit.b2 * t->uv[2][0],
               b0 * t->uv[0][1] + hit.b1 * t->uv[1][1] + hit.b2 * t->uv[2][1], emission);
    for (i = 0; i < 3; i++) {
        point.albedo[i] = rgba[i];
        point.emission[i] = point.back && (material->flags & SBL_MATERIAL_ONE_SIDED_EMISSION) ? 0
            : (double)material->emission[i] * emission[i];
    }
    return point;
}

static inline int ref_glows(const ref_scene *scene, const ref_point *point) {
    const sbl_material *m = &scene->desc.materials[scene->desc.meshes[point->mesh].material];
    if (point->back && (m->flags & SBL_MATERIAL_ONE_SIDED_EMISSION)) return 0;
    return m->emission[0] > 0 || m->emission[1] > 0 || m->emission[2] > 0;
}

/* Computes Ck of the paper: the radiance of an emitter, epsilon * albedo for other surfaces, or the sky if nothing is
   hit. */
static inline void ref_light(const ref_scene *scene, const ref_point *point, double epsilon, double rgb[3]) {
    int i;
    for (i = 0; i < 3; i++)
        rgb[i] = !point->hit ? (double)scene->desc.sky[i] : ref_glows(scene, point) ? point->emission[i] : epsilon *
            point->albedo[i];
}

/* >>camera */

/* Computes the ray through the picture coordinates (x, y), in pixels from the top left corner; the centre of pixel (i,
   j) is (i + 0.5, j + 0.5). All points v of the ray satisfy clip(v).xy = ndc * clip(v).w. These equations describe two
   planes, which meet in the ray. */
static inline void ref_camera_ray(const sbl_picture_desc *view, double x, double y, v3 *origin, v3 *direction) {
    const float *c = view->view_to_clip, *m = view->world_to_view;
    double ndc[2], plane[2][4], w[4], det;
    v3 a, b, along, third, o, axis[3];
    int i, k;
    ndc[0] = 2 * x / view->width - 1;
    ndc[1] = 1 - 2 * y / view->height;
    for (k = 0; k < 4; k++) {
        w[k] = (double)c[4 * k + 3];
        for (i = 0; i < 2; i++) plane[i][k] = (double)c[4 * k + i] - ndc[i] * w[k];
    }
    a = v3_of(plane[0][0], plane[0][1], plane[0][2]);
    b = v3_of(plane[1][0], plane[1][1], plane[1][2]);
    along = v3_unit(v3_cross(a, b));
    if (along.z > 0) along = v3_scale(along, -1);
    /* the origin is the eye, where w is 0; for parallel rays, it is in the plane z = 0 */
    third = v3_of(w[0], w[1], w[2]);
    if (v3_length(third) == 0) { third = v3_of(0, 0, 1); w[3] = 0; }
    det = v3_dot(third, v3_cross(a, b));
    o = v3_scale(v3_add(v3_add(v3_scale(v3_cross(a, b), -w[3]), v3_scale(v3_cross(b, third), -plane[0][3])),
                        v3_scale(v3_cross(third, a), -plane[1][3])), 1 / det);
    for (i = 0; i < 3; i++) axis[i] = v3_of((double)m[i], (double)m[4 + i], (double)m[8 + i]);
    o = v3_sub(o, v3_of((double)m[12], (double)m[13], (double)m[14]));
    *origin = v3_add(v3_add(v3_scale(axis[0], o.x), v3_scale(axis[1], o.y)), v3_scale(axis[2], o.z));
    *direction = v3_add(v3_add(v3_scale(axis[0], along.x), v3_scale(axis[1], along.y)), v3_scale(axis[2], along.z));
}

static inline ref_point ref_camera_point(const ref_scene *scene, const sbl_picture_desc *view, double x, double y) {
    v3 origin, direction;
    ref_camera_ray(view, x, y, &origin, &direction);
    return ref_surface(scene, ref_trace(scene, origin, direction, 0, HUGE_VAL, SBL_MATERIAL_HIDDEN_FROM_CAMERA),
                       direction);
}

static inline ref_point ref_pixel(const ref_scene *scene, const sbl_picture_desc *view, int x, int y) {
    return ref_camera_point(scene, view, x + 0.5, y + 0.5);
}

static inline double ref_depth(const sbl_picture_desc *view, v3 p) {
    const float *m = view->world_to_view;
    return -((double)m[2] * p.x + (double)m[6] * p.y + (double)m[10] * p.z + (double)m[14]);
}

/* Returns 1 unless all rays up to 0.01 pixels around the centre hit the same plane of the same surface. At an edge,
   rounding decides which surface is seen. */
static inline int ref_is_edge(const ref_scene *scene, const sbl_picture_desc *view, int x, int y) {
    ref_point centre = ref_pixel(scene, view, x, y);
    int i;
    for (i = 0; i < 8; i++) {
        static const double around[8][2] = { { -1, -1 }, { 0, -1 }, { 1, -1 }, { -1, 0 }, { 1, 0 }, { -1, 1 }, { 0, 1 },
            { 1, 1 } };
        ref_point other = ref_camera_point(scene, view, x + 0.5 + 0.01 * around[i][0], y + 0.5 + 0.01 * around[i][1]);
        if (other.id != centre.id) return 1;
        if (centre.hit && v3_dot(other.face, centre.face) < 0.9999 && v3_dot(other.normal, centre.normal) < 0.9999)
            return 1;
    }
    return 0;
}

/* >>light */

/* Clips a polygon by the plane through p with the normal m, and keeps the side that m points to. Returns the number of
   corners. out: must have room for one corner more than the polygon */
static inline int ref_clip(v3 p, v3 m, const v3 *corners, int count, v3 *out) {
    int i, kept = 0;
    for (i = 0; i < count; i++) {
        v3 a = corners[i], b = corners[(i + 1) % count];
        double ha = v3_dot(v3_sub(a, p), m), hb = v3_dot(v3_sub(b, p), m);
        if (ha > 0) out[kept++] = a;
        if ((ha > 0) != (hb > 0)) out[kept++] = v3_mad(a, v3_sub(b, a), ha / (ha - hb));
    }
    return kept;
}

/* Returns the share of the cosine-weighted hemisphere about n that a polygon of up to 30 corners covers, by Lambert's
   sum over its edges. The part below the horizon is clipped first. R from an unoccluded polygon is its radiance times
   this share. */
static inline double ref_polygon(v3 p, v3 n, const v3 *corners, int count) {
    v3 above[32];
    double sum = 0;
    int i, kept = 0;
    for (i = 0; i < count; i++) {
        v3 a = v3_sub(corners[i], p), b = v3_sub(corners[(i + 1) % count], p);
        double ha = v3_dot(a, n), hb = v3_dot(b, n);
        if (ha > 0) above[kept++] = a;
        if ((ha > 0) != (hb > 0)) above[kept++] = v3_mad(a, v3_sub(b, a), ha / (ha - hb));
    }
    for (i = 0; i < kept; i++) {
        v3 c = v3_cross(above[i], above[(i + 1) % kept]);
        double length = v3_length(c);
        if (length > 0) sum += atan2(length, v3_dot(above[i], above[(i + 1) % kept])) * v3_dot(c, n) / length;
    }
    return fabs(sum) / (2 * REF_PI);
}

/* Estimates R at a point. Emitting triangles are sampled by points on their area, everything else by cosine-distributed
   rays. Both are stratified: each cell of a grid gets one sample, with lamp_side and side cells along each edge. The
   result is the mean of `rounds` independent estimates. error: receives the standard error of the mean */
static inline void ref_gather(const ref_scene *scene, v3 p, v3 n, double epsilon, int side, int lamp_side, int rounds,
                              uint64_t *seed, double rgb[3], double error[3]) {
    double sum[3] = { 0, 0, 0 }, squares[3] = { 0, 0, 0 }, light[3], nearest = 1e-7 * (1 + v3_length(p));
    v3 up = fabs(n.x) < 0.5 ? v3_of(1, 0, 0) : v3_of(0, 1, 0), right = v3_unit(v3_cross(up, n));
    int round, i, j, k, l;
    up = v3_cross(n, right);
    for (round = 0; round < rounds; round++) {
        double once[3] = { 0, 0, 0 };
        for (i = 0; i < side; i++)
            for (j = 0; j < side; j++) {
                double r = sqrt((i + ref_random(seed)) / side), phi = 2 * REF_PI * (j + ref_random(seed)) / side;
                v3 d = v3_add(v3_add(v3_scale(right, r * cos(phi)), v3_scale(up, r * sin(phi))),
                              v3_scale(n, sqrt(1 - r * r)));
                ref_point seen = ref_surface(scene, ref_trace(scene, p, d, nearest, HUGE_VAL,
                                                              SBL_MATERIAL_HIDDEN_FROM_SENSORS), d);
                if (seen.hit && ref_glows(scene, &seen)) continue;
                ref_light(scene, &seen, epsilon, light);
                for (k = 0; k < 3; k++) once[k] += light[k] / (side * side);
            }
        for (l = 0; l < scene->triangle_count; l++) {
            const ref_triangle *t = &scene->triangles[l];
            const sbl_material *m = &scene->desc.materials[scene->desc.meshes[t->mesh].material];
            v3 e1 = v3_sub(t->p[1], t->p[0]), e2 = v3_sub(t->p[2], t->p[0]), twice_area = v3_cross(e1, e2);
            if (!(m->emission[0] > 0 || m->emission[1] > 0 || m->emission[2] > 0)) continue;
            for (i = 0; i < lamp_side; i++)
                for (j = 0; j < lamp_side; j++) {
                    double s = sqrt((i + ref_random(seed)) / lamp_side), b2 = s * (j + ref_random(seed)) / lamp_side,
                        b1 = s - b2;
                    v3 d = v3_sub(v3_add(t->p[0], v3_add(v3_scale(e1, b1), v3_scale(e2, b2))), p);
                    double distance = v3_length(d), cosine = v3_dot(d, n) / distance;
                    ref_hit hit;
                    ref_point seen;
                    if (cosine <= 0) continue;
                    hit = ref_trace(scene, p, v3_scale(d, 1 / distance), nearest, distance * (1 + 1e-9),
                                    SBL_MATERIAL_HIDDEN_FROM_SENSORS);
                    if (hit.triangle != l) continue;
                    seen = ref_surface(scene, hit, d);
                    if (!ref_glows(scene, &seen)) continue;
                    for (k = 0; k < 3; k++)
                        once[k] += seen.emission[k] * cosine * fabs(v3_dot(d, twice_area)) / 2 /
                            (distance * distance * distance) / (REF_PI * lamp_side * lamp_side);
                }
        }
        for (k = 0; k < 3; k++) { sum[k] += once[k]; squares[k] += once[k] * once[k]; }
    }
    for (k = 0; k < 3; k++) {
        double variance = squares[k] / rounds - sum[k] * sum[k] / rounds / rounds;
        rgb[k] = sum[k] / rounds;
        error[k] = rounds > 1 && variance > 0 ? sqrt(variance / (rounds - 1)) : 0;
    }
}

/* Returns the share of the light of a quad lamp that arrives at p, ignoring other lamps: its closed form times the
   visible share of side * side points on it, each weighted by its contribution. lamp: index of the mesh of the lamp;
   corners: its four corners in order */
static inline double ref_quad_light(const ref_scene *scene, v3 p, v3 n, const v3 corners[4], int lamp, int side,
                                    uint64_t *seed) {
    double given = 0, seen = 0, whole = ref_polygon(p, n, corners, 4), nearest = 1e-7 * (1 + v3_length(p));
    v3 u = v3_sub(corners[1], corners[0]), v = v3_sub(corners[3], corners[0]), normal = v3_cross(u, v);
    int i, j;
    if (whole <= 0) return 0;
    for (i = 0; i < side; i++)
        for (j = 0; j < side; j++) {
            v3 d = v3_sub(v3_mad(v3_mad(corners[0], u, (i + ref_random(seed)) / side), v,
                                 (j + ref_random(seed)) / side), p);
            double length = v3_length(d), weight = v3_dot(d, n) * fabs(v3_dot(d, normal)) / pow(length, 4);
            ref_hit hit;
            if (weight <= 0) continue;
            given += weight;
            hit = ref_trace(scene, p, d, nearest / length, 1 + 1e-9, SBL_MATERIAL_HIDDEN_FROM_SENSORS);
            if (hit.triangle >= 0 && scene->triangles[hit.triangle].mesh == lamp) seen += weight;
        }
    return given > 0 ? whole * seen / given : 0;
}

#endif
