/* Writes a scene as glTF 2.0: a .gltf, a .bin with the arrays, and a .png for each texture. The arrays of the scene
   must be in client memory, with 32-bit floats and indices, and colour textures must be sRGB or floats, as scene_file.h
   makes them. Lights are omitted unless has_lights is set, because baked light replaces them. If the scene has any
   glossy, metallic or transmissive material, matte materials get KHR_materials_specular with the factor 0, which
   removes their reflections. SBL_MATERIAL_BLEND becomes alphaMode BLEND, which has no cutoff. The materials of meshes
   in a lightmap get the extension MOZ_lightmap (index of the texture, texCoord 1, intensity). A viewer computes
   irradiance = intensity * texture, after decoding the texture from sRGB. If meshes with the same material use
   different lightmaps, or some use none, the material is written once for each case. Include after sbl.h and
   picture_file.h. This file includes stb_image_write.h.

       gltf_map map = { "atlas.png", 3.5 };
       gltf_file out = { .scene = &file->scene, .names = file->names, .bin = "scene.bin", .maps = &map,
                         .map_count = 1, .map_of = file->maps };
       ok = gltf_write_json(stream, &out);

   gltf_write_bin and gltf_write_texture write the other files in the same way. */
#ifndef GLTF_FILE_H
#define GLTF_FILE_H

#include <ctype.h>
#define STB_IMAGE_WRITE_IMPLEMENTATION
#include <stb/stb_image_write.h>

enum { GLTF_NAME = 32, GLTF_PARTS = 8 };  /* size of the file name of a texture; maximum number of parts of radiance */

typedef struct gltf_map {
    const char *name;           /* file name of the lightmap */
    double intensity;           /* the irradiance for a decoded texture value of 1 */
} gltf_map;

/* A material together with the lightmap of the meshes that use it; map is -1 for meshes without a lightmap. */
typedef struct gltf__use { int material, map; } gltf__use;

/* The materials as the .gltf lists them. */
typedef struct gltf__materials {
    int *numbers;               /* index in the .gltf of each use, at [material * (map_count + 1) + map + 1]; or -1 */
    gltf__use *uses;            /* one per material of the .gltf */
    int count;
} gltf__materials;

typedef struct gltf_file {
    const sbl_scene_desc *scene;
    const char *const *names;   /* one per mesh */
    const char *bin;            /* file name of the .bin */
    const gltf_map *maps;       /* the lightmaps that materials refer to */
    int map_count;              /* may be 0 */
    const float *radiance;      /* NULL, or three floats per vertex, mesh after mesh, for the attribute _RADIANCE; the
                                   arrays of the parts follow in the same form */
    const char *const *parts;   /* names of the parts; each becomes an attribute _RADIANCE_NAME */
    int part_count;             /* at most GLTF_PARTS */
    size_t vertex_count;        /* number of vertices of all meshes; used only if there are parts */
    const char *extras;         /* NULL, or a JSON object, which becomes the extras of the asset */
    int has_lights;             /* 1: write the lights of the scene, too */
    const float *camera;        /* NULL, or a camera: eye, forward, up (three floats each), fov_y in degrees */
    const int *map_of;          /* one per mesh: index of its lightmap, or -1; NULL if map_count is 0 */
    const gltf__materials *materials;  /* leave NULL; gltf_write_json sets it in its own copy */
} gltf_file;

static void gltf_texture_name(char name[GLTF_NAME], int number) { snprintf(name, GLTF_NAME, "texture_%d.png", number); }

/* ---- arrays, in the order of the .bin ---- */

enum { GLTF_POSITION, GLTF_NORMAL, GLTF_TEXCOORD_0, GLTF_TEXCOORD_1, GLTF_COLOR_0, GLTF_RADIANCE,
    GLTF_INDICES = GLTF_RADIANCE + 1 + GLTF_PARTS, GLTF_ARRAYS };

typedef struct gltf__array { const void *data; int count, components; } gltf__array;

/* Lists the arrays of a mesh. An array that the mesh lacks gets the count 0. first: index of the first vertex of the
   mesh among the vertices of all meshes */
static void gltf__arrays(const gltf_file *f, const sbl_mesh *m, size_t first, gltf__array out[GLTF_ARRAYS]) {
    const gltf__array all[] = {
        { m->positions.data, m->vertex_count, 3 }, { m->normals.data, m->vertex_count, 3 },
        { m->texcoords.data, m->vertex_count, 2 }, { m->lightmap_texcoords.data, m->vertex_count, 2 },
        { m->colors.data, m->vertex_count, 4 }, { f->radiance ? f->radiance + 3 * first : NULL, m->vertex_count, 3 }
    };
    const gltf__array indices = { m->indices.data, m->index_count, 1 };
    int i;
    /* glTF forbids TEXCOORD_1 without TEXCOORD_0, so the lightmap coordinates serve as both */
    for (i = 0; i <= GLTF_RADIANCE; i++) out[i] = all[i == GLTF_TEXCOORD_0 && !all[i].data ? GLTF_TEXCOORD_1 : i];
    for (; i < GLTF_INDICES; i++) {
        out[i] = all[GLTF_RADIANCE];
        out[i].data = i - GLTF_RADIANCE > f->part_count ? NULL
                    : f->radiance + 3 * (first + (size_t)(i - GLTF_RADIANCE) * f->vertex_count);
    }
    out[GLTF_INDICES] = indices;
    for (i = 0; i < GLTF_ARRAYS; i++) {
        if (!out[i].data || out[i].count <= 0) out[i].count = 0;
    }
    for (i = 0; i < GLTF_ARRAYS && (!out[GLTF_POSITION].count || !out[GLTF_INDICES].count); i++) out[i].count = 0;
}

static size_t gltf__bytes(const gltf__array *a) { return 4 * (size_t)a->count * (size_t)a->components; }

static void gltf__put_word(FILE *out, uint32_t word) {
    unsigned char bytes[4];
    int i;
    for (i = 0; i < 4; i++) bytes[i] = (unsigned char)(word >> 8 * i & 255);
    fwrite(bytes, 1, 4, out);
}

/* Writes normals, scaled to length 1 as glTF requires. A normal of length 0 becomes (0, 1, 0). */
static void gltf__put_normals(FILE *out, const float *v, int count) {
    int i, k;
    for (i = 0; i < count; i++, v += 3) {
        const double length = sqrt((double)v[0] * (double)v[0] + (double)v[1] * (double)v[1] + (double)v[2] *
                                   (double)v[2]);
        for (k = 0; k < 3; k++) {
            const float unit = length > 0 ? (float)((double)v[k] / length) : k == 1 ? 1.0f : 0.0f;
            uint32_t word;
            memcpy(&word, &unit, 4);
            gltf__put_word(out, word);
        }
    }
}

static inline int gltf_write_bin(FILE *out, const gltf_file *f) {
    const sbl_mesh *m = f->scene->meshes;
    gltf__array arrays[GLTF_ARRAYS];
    size_t first = 0, i;
    int number, k;
    for (number = 0; number < f->scene->mesh_count; first += (size_t)m->vertex_count, number++, m++) {
        gltf__arrays(f, m, first, arrays);
        for (k = 0; k < GLTF_ARRAYS; k++) {
            const size_t words = gltf__bytes(&arrays[k]) / 4;
            if (k == GLTF_NORMAL) gltf__put_normals(out, (const float *)arrays[k].data, arrays[k].count);
            for (i = 0; i < words && k != GLTF_NORMAL; i++) {
                uint32_t word;
                memcpy(&word, (const char *)arrays[k].data + 4 * i, 4);
                gltf__put_word(out, word);
            }
        }
    }
    return 1;
}

/* ---- textures ---- */

static void gltf__put_bytes(void *user, void *data, int size) { fwrite(data, 1, (size_t)size, (FILE *)user); }

/* Returns 1 if a texture holds metalness and roughness, transmission or normals, which are not encoded as sRGB. number:
   index of the texture, from 0 */
static int gltf__is_linear(const sbl_scene_desc *scene, int number) {
    int i;
    for (i = 0; i < scene->material_count; i++)
        if (scene->materials[i].specular_texture == number + 1 || scene->materials[i].normal_texture == number + 1 ||
            scene->materials[i].transmission_texture == number + 1) return 1;
    return 0;
}

/* Writes a texture as .png: colours as 8-bit sRGB, other values as linear bytes. Returns 0 on failure. number: index of
   the texture, from 0 */
static inline int gltf_write_texture(FILE *out, const gltf_file *f, int number) {
    const sbl_texture *t = &f->scene->textures[number];
    const size_t count = (size_t)t->width * (size_t)t->height * (size_t)t->channels;
    const float *linear = (const float *)t->pixels;
    const int is_linear = gltf__is_linear(f->scene, number);
    unsigned char *bytes;
    size_t i;
    int ok;
    if (t->format != SBL_PIXELS_FLOAT)
        return stbi_write_png_to_func(gltf__put_bytes, out, t->width, t->height, t->channels, t->pixels, 0);
    bytes = (unsigned char *)malloc(count);
    if (!bytes) return 0;
    sbl_encode_srgb8(bytes, linear, count, 1);
    for (i = 0; i < count; i++)
        if (is_linear || (t->channels % 2 == 0 && (int)(i % (size_t)t->channels) == t->channels - 1))
            bytes[i] = to_byte((double)linear[i]);
    ok = stbi_write_png_to_func(gltf__put_bytes, out, t->width, t->height, t->channels, bytes, 0);
    free(bytes);
    return ok;
}

/* ---- the .gltf ---- */

/* Returns the number of bytes of the character at the start of a text, or 0 if it is not valid UTF-8. */
static int gltf__character(const char *text) {
    static const unsigned least[5] = { 0, 0, 0x80, 0x800, 0x10000 };
    const unsigned char *c = (const unsigned char *)text;
    const int length = c[0] < 0x80 ? 1 : c[0] >> 5 == 6 ? 2 : c[0] >> 4 == 14 ? 3 : c[0] >> 3 == 30 ? 4 : 0;
    unsigned code = length == 1 ? c[0] : c[0] & (0x7fu >> length);
    int i;
    for (i = 1; i < length; i++) {
        if (c[i] >> 6 != 2) return 0;
        code = code << 6 | (c[i] & 63u);
    }
    return !length || code < least[length] || code > 0x10ffff || (code >> 11 == 0x1b) ? 0 : length;
}

/* Writes a JSON string. Control characters, and bytes that are not UTF-8, become '?'. */
static void gltf__put_name(FILE *out, const char *name) {
    fputc('"', out);
    while (*name) {
        const int length = gltf__character(name);
        if (length == 0 || (unsigned char)*name < 32 || *name == 127) fputc('?', out);
        else fprintf(out, "%s%.*s", *name == '"' || *name == '\\' ? "\\" : "", length, name);
        name += length ? length : 1;
    }
    fputc('"', out);
}

/* Writes the name of a file as the JSON string of a URI. Bytes that a URI cannot contain become %20 and the like. */
static void gltf__put_uri(FILE *out, const char *name) {
    fputc('"', out);
    for (; *name; name++)
        fprintf(out, (*name & 0x80) == 0 && (isalnum((unsigned char)*name) || strchr("-._~/", *name)) ? "%c" : "%%%02X",
                (unsigned char)*name);
    fputc('"', out);
}

static int gltf__is_matte(const sbl_material *m) { return !(m->ior > 0 || m->metallic > 0); }

static double gltf__strength(const sbl_material *m) {
    double most = 1;
    int k;
    for (k = 0; k < 3; k++) if ((double)m->emission[k] > most) most = (double)m->emission[k];
    return most;
}

enum { GLTF__STRENGTH = 1, GLTF__IOR = 2, GLTF__SPECULAR = 4, GLTF__TRANSMISSION = 8 };

/* Returns a bit mask of the extensions that a material uses. */
static int gltf__extensions(const gltf_file *f, const sbl_material *m) {
    int i, bits = (gltf__strength(m) > 1 ? GLTF__STRENGTH : 0) | (m->transmission > 0 ? GLTF__TRANSMISSION : 0);
    if (m->ior > 0) return m->ior < 1.5f || m->ior > 1.5f ? bits | GLTF__IOR : bits;
    for (i = 0; i < f->scene->material_count; i++)
        if (!gltf__is_matte(&f->scene->materials[i]) || f->scene->materials[i].transmission > 0)
            return bits | GLTF__SPECULAR;
    return bits;
}

static void gltf__put_transmission(FILE *out, const sbl_material *m) {
    fprintf(out, "\"KHR_materials_transmission\": {\"transmissionFactor\": %.7g", (double)m->transmission);
    if (m->transmission_texture)
        fprintf(out, ", \"transmissionTexture\": {\"index\": %d}", m->transmission_texture - 1);
    fputc('}', out);
}

static void gltf__put_extensions(FILE *out, const gltf_file *f, const sbl_material *m, int map) {
    const int bits = gltf__extensions(f, m);
    const char *before = ", \"extensions\": {";
    if (!bits && map < 0) return;
    if (bits & GLTF__STRENGTH) {
        fprintf(out, "%s\"KHR_materials_emissive_strength\": {\"emissiveStrength\": %.7g}", before, gltf__strength(m));
        before = ", ";
    }
    if (bits & GLTF__IOR) fprintf(out, "%s\"KHR_materials_ior\": {\"ior\": %.7g}", before, (double)m->ior);
    else if (bits & GLTF__SPECULAR) fprintf(out, "%s\"KHR_materials_specular\": {\"specularFactor\": 0}", before);
    if (bits & (GLTF__IOR | GLTF__SPECULAR)) before = ", ";
    if (bits & GLTF__TRANSMISSION) {
        fputs(before, out);
        gltf__put_transmission(out, m);
        before = ", ";
    }
    if (map >= 0)
        fprintf(out, "%s\"MOZ_lightmap\": {\"index\": %d, \"texCoord\": 1, \"intensity\": %.7g}", before,
                f->scene->texture_count + map, f->maps[map].intensity);
    fputc('}', out);
}

static void gltf__put_normal_texture(FILE *out, const sbl_material *m) {
    const float scale = m->normal_scale < 0 || m->normal_scale > 0 ? m->normal_scale : 1;
    if (!m->normal_texture) return;
    fprintf(out, ", \"normalTexture\": {\"index\": %d", m->normal_texture - 1);
    if (scale < 1 || scale > 1) fprintf(out, ", \"scale\": %.9g", (double)scale);
    fputc('}', out);
}

static void gltf__put_material(FILE *out, const gltf_file *f, int number) {
    const gltf__use *use = &f->materials->uses[number];
    const sbl_material *m = &f->scene->materials[use->material];
    const double most = gltf__strength(m);
    fprintf(out, "%s\n    {\"doubleSided\": true, \"pbrMetallicRoughness\": {\"metallicFactor\": %.7g, "
            "\"roughnessFactor\": %.7g, "
            "\"baseColorFactor\": [%.7g, %.7g, %.7g, 1]", number ? "," : "", (double)m->metallic,
            gltf__is_matte(m) ? 1 : (double)m->roughness, (double)m->albedo[0], (double)m->albedo[1],
            (double)m->albedo[2]);
    if (m->albedo_texture) fprintf(out, ", \"baseColorTexture\": {\"index\": %d}", m->albedo_texture - 1);
    if (m->specular_texture && !gltf__is_matte(m))
        fprintf(out, ", \"metallicRoughnessTexture\": {\"index\": %d}", m->specular_texture - 1);
    fputc('}', out);
    gltf__put_normal_texture(out, m);
    fprintf(out, ", \"emissiveFactor\": [%.7g, %.7g, %.7g]", (double)m->emission[0] / most,
            (double)m->emission[1] / most, (double)m->emission[2] / most);
    if (m->emission_texture) fprintf(out, ", \"emissiveTexture\": {\"index\": %d}", m->emission_texture - 1);
    if (m->flags & SBL_MATERIAL_BLEND) fprintf(out, ", \"alphaMode\": \"BLEND\"");
    else if (m->alpha_cutoff > 0)
        fprintf(out, ", \"alphaMode\": \"MASK\", \"alphaCutoff\": %.7g", (double)m->alpha_cutoff);
    gltf__put_extensions(out, f, m, use->map);
    fputc('}', out);
}

/* Returns the index into gltf__materials.numbers for the material of a mesh. number: index of the mesh */
static size_t gltf__use_of(const gltf_file *f, int number) {
    const int map = f->map_of && f->map_count ? f->map_of[number] : -1;
    return (size_t)f->scene->meshes[number].material * (size_t)(f->map_count + 1) + (size_t)(map + 1);
}

/* Assigns indices to the materials of the .gltf. Each material of the scene keeps its index, with the lightmap of the
   first mesh that uses it; its uses with other lightmaps follow at the end. Returns 0 if memory runs out. */
static int gltf__find_materials(const gltf_file *f, gltf__materials *out) {
    const size_t maps = (size_t)f->map_count + 1, count = (size_t)f->scene->material_count;
    size_t i;
    int number;
    out->count = f->scene->material_count;
    out->numbers = (int *)malloc((count * maps + 1) * sizeof *out->numbers);
    out->uses = (gltf__use *)malloc((count * maps + 1) * sizeof *out->uses);
    if (!out->numbers || !out->uses) return 0;
    for (i = 0; i < count * maps; i++) out->numbers[i] = -1;
    for (i = 0; i < count; i++) {
        out->uses[i].material = (int)i;
        out->uses[i].map = -2;  /* not yet known */
    }
    for (number = 0; number < f->scene->mesh_count; number++) {
        const size_t at = gltf__use_of(f, number);
        const int material = f->scene->meshes[number].material, map = (int)(at % maps) - 1;
        if (out->numbers[at] >= 0) continue;
        out->numbers[at] = out->uses[material].map == -2 ? material : out->count++;
        out->uses[out->numbers[at]].material = material;
        out->uses[out->numbers[at]].map = map;
    }
    return 1;
}

/* Writes the minimum and maximum of the positions, which glTF requires. */
static void gltf__put_bounds(FILE *out, const gltf__array *a) {
    const float *v = (const float *)a->data;
    float low[3], high[3];
    int i, k;
    for (k = 0; k < 3; k++) low[k] = high[k] = v[k];
    for (i = 0; i < a->count; i++, v += 3)
        for (k = 0; k < 3; k++) {
            if (v[k] < low[k]) low[k] = v[k];
            if (v[k] > high[k]) high[k] = v[k];
        }
    fprintf(out, ", \"min\": [%.9g, %.9g, %.9g], \"max\": [%.9g, %.9g, %.9g]", (double)low[0], (double)low[1],
            (double)low[2],
            (double)high[0], (double)high[1], (double)high[2]);
}

enum { GLTF__ACCESSORS, GLTF__VIEWS, GLTF__MESHES };

/* Writes one JSON list for all arrays of all meshes. what: the accessors, the buffer views, or the meshes, which refer
   to the accessors. Returns the size of all arrays in bytes. */
static double gltf__put_arrays(FILE *out, const gltf_file *f, int what) {
    static const char *const attributes[] = { "POSITION", "NORMAL", "TEXCOORD_0", "TEXCOORD_1", "COLOR_0",
        "_RADIANCE" };
    static const char *const types[5] = { "", "SCALAR", "VEC2", "VEC3", "VEC4" };
    const sbl_mesh *m = f->scene->meshes;
    gltf__array arrays[GLTF_ARRAYS];
    double at = 0;
    size_t first = 0;
    int number, k, accessor = 0, meshes = 0;
    for (number = 0; number < f->scene->mesh_count; first += (size_t)m->vertex_count, number++, m++) {
        gltf__arrays(f, m, first, arrays);
        if (!arrays[GLTF_POSITION].count) continue;
        if (what == GLTF__MESHES)
            fprintf(out, "%s\n    {\"primitives\": [{\"material\": %d, \"attributes\": {", meshes++ ? "," : "",
                    f->materials->numbers[gltf__use_of(f, number)]);
        for (k = 0; k < GLTF_ARRAYS; k++) {
            const gltf__array *a = &arrays[k];
            if (!a->count) continue;
            if (what == GLTF__VIEWS)
                fprintf(out, "%s\n    {\"buffer\": 0, \"byteOffset\": %.0f, \"byteLength\": %.0f, \"target\": %d}",
                        accessor ? "," : "", at,
                        (double)gltf__bytes(a), k == GLTF_INDICES ? 34963 : 34962);
            else if (what == GLTF__ACCESSORS) {
                fprintf(out, "%s\n    {\"bufferView\": %d, \"componentType\": %d, \"count\": %d, \"type\": \"%s\"",
                        accessor ? "," : "", accessor,
                        k == GLTF_INDICES ? 5125 : 5126, a->count, types[a->components]);
                if (k == GLTF_POSITION) gltf__put_bounds(out, a);
                fputc('}', out);
            } else if (k == GLTF_INDICES) fprintf(out, "}, \"indices\": %d", accessor);
            else if (k <= GLTF_RADIANCE) fprintf(out, "%s\"%s\": %d", k ? ", " : "", attributes[k], accessor);
            else fprintf(out, ", \"_RADIANCE_%s\": %d", f->parts[k - GLTF_RADIANCE - 1], accessor);
            at += (double)gltf__bytes(a);
            accessor++;
        }
        if (what == GLTF__MESHES) fprintf(out, "}]}");
    }
    return at;
}

/* ---- lights and camera ---- */

static int gltf__light_count(const gltf_file *f) { return f->has_lights ? f->scene->light_count : 0; }

/* Writes the matrix of a node at `eye` whose -z axis points forward. up: any vector; if it is parallel to forward,
   another is used */
static void gltf__put_frame(FILE *out, const float *eye, const float *forward, const float *up) {
    double z[3], x[3] = { 0, 0, 0 }, y[3], m[16] = { 0 }, length = 0;
    int k, pass;
    for (k = 0; k < 3; k++) length += (double)forward[k] * (double)forward[k];
    for (k = 0; k < 3; k++) z[k] = length > 0 ? -(double)forward[k] / sqrt(length) : k == 2;
    for (pass = 0, length = 0; pass < 2 && !(length > 1e-12); pass++) {  /* second pass: up is parallel to forward */
        const double a[3] = { (double)up[pass], (double)up[(1 + pass) % 3], (double)up[(2 + pass) % 3] };
        for (k = 0; k < 3; k++) x[k] = a[(k + 1) % 3] * z[(k + 2) % 3] - a[(k + 2) % 3] * z[(k + 1) % 3];
        length = x[0] * x[0] + x[1] * x[1] + x[2] * x[2];
    }
    for (k = 0; k < 3; k++) x[k] /= sqrt(length);
    for (k = 0; k < 3; k++) y[k] = z[(k + 1) % 3] * x[(k + 2) % 3] - z[(k + 2) % 3] * x[(k + 1) % 3];
    for (k = 0; k < 3; k++) { m[k] = x[k]; m[4 + k] = y[k]; m[8 + k] = z[k]; m[12 + k] = (double)eye[k]; }
    m[15] = 1;
    for (k = 0; k < 16; k++) fprintf(out, "%s%.9g", k ? ", " : "\"matrix\": [", m[k]);
    fputc(']', out);
}

/* Writes the nodes of the lights and of the camera. nodes: number of nodes written before. Returns the number of all
   nodes. */
static int gltf__put_light_nodes(FILE *out, const gltf_file *f, int nodes) {
    static const float origin[3] = { 0, 0, 0 }, down[3] = { 0, 0, -1 }, up[3] = { 0, 1, 0 };
    int i;
    for (i = 0; i < gltf__light_count(f); i++, nodes++) {
        const sbl_light *l = &f->scene->lights[i];
        fprintf(out, "%s\n    {\"name\": \"light %d\", ", nodes ? "," : "", i);
        gltf__put_frame(out, l->kind == SBL_LIGHT_DIRECTIONAL ? origin : l->position,
                        l->kind == SBL_LIGHT_POINT ? down : l->direction, up);
        fprintf(out, ", \"extensions\": {\"KHR_lights_punctual\": {\"light\": %d}}}", i);
    }
    if (!f->camera) return nodes;
    fprintf(out, "%s\n    {\"name\": \"camera\", \"camera\": 0, ", nodes ? "," : "");
    gltf__put_frame(out, f->camera, f->camera + 3, f->camera + 6);
    fputc('}', out);
    return nodes + 1;
}

static void gltf__put_lights(FILE *out, const gltf_file *f) {
    static const char *const kinds[] = { "point", "spot", "directional" };
    const double radians = atan(1.0) / 45;
    int i, k;
    if (f->camera)
        fprintf(out, ",\n  \"cameras\": [{\"type\": \"perspective\", \"perspective\": {\"yfov\": %.9g, "
                "\"znear\": 0.01}}]", (double)f->camera[9] * radians);
    for (i = 0; i < gltf__light_count(f); i++) {
        const sbl_light *l = &f->scene->lights[i];
        double most = 0;
        for (k = 0; k < 3; k++) if ((double)l->intensity[k] > most) most = (double)l->intensity[k];
        fprintf(out, "%s\n    {\"type\": \"%s\", \"intensity\": %.9g, \"color\": [",
                i ? "," : ",\n  \"extensions\": {\"KHR_lights_punctual\": {\"lights\": [",
                kinds[l->kind == SBL_LIGHT_POINT ? 0 : l->kind == SBL_LIGHT_SPOT ? 1 : 2], most);
        for (k = 0; k < 3; k++)
            fprintf(out, "%s%.9g", k ? ", " : "", most > 0 ? (double)l->intensity[k] / most : 0);
        fputc(']', out);
        if (l->kind == SBL_LIGHT_SPOT)
            fprintf(out, ", \"spot\": {\"innerConeAngle\": %.9g, \"outerConeAngle\": %.9g}",
                    (double)l->inner_cone * radians / 2, (double)l->cone * radians / 2);
        fputc('}', out);
    }
    if (i) fprintf(out, "\n  ]}}");
}

static void gltf__put_nodes(FILE *out, const gltf_file *f) {
    const sbl_mesh *m = f->scene->meshes;
    gltf__array arrays[GLTF_ARRAYS];
    int number, k, moved, all, nodes = 0;
    for (number = 0; number < f->scene->mesh_count; number++, m++) {
        gltf__arrays(f, m, 0, arrays);
        if (!arrays[GLTF_POSITION].count) continue;
        fprintf(out, "%s\n    {\"name\": ", nodes ? "," : "");
        gltf__put_name(out, f->names[number]);
        fprintf(out, ", \"mesh\": %d", nodes++);
        for (k = moved = 0; k < 16; k++) moved |= m->transform[k] != 0.0f;
        for (k = 0; k < 16 && moved; k++)
            fprintf(out, "%s%.9g%s", k ? ", " : ", \"matrix\": [", (double)m->transform[k], k == 15 ? "]" : "");
        fputc('}', out);
    }
    all = gltf__put_light_nodes(out, f, nodes);
    fprintf(out, "\n  ],\n  \"scene\": 0, \"scenes\": [{\"nodes\": [");
    for (k = 0; k < all; k++) fprintf(out, "%s%d", k ? ", " : "", k);
    fprintf(out, "]}]");
}

static void gltf__put_textures(FILE *out, const gltf_file *f) {
    const int count = f->scene->texture_count, all = count + f->map_count;
    char name[GLTF_NAME];
    int i;
    if (!all) return;
    fprintf(out, ",\n  \"images\": [");
    for (i = 0; i < all; i++) {
        gltf_texture_name(name, i);
        fprintf(out, "%s\n    {\"uri\": \"%s\"}", i ? "," : "", i < count ? name : f->maps[i - count].name);
    }
    fprintf(out, "\n  ],\n  \"samplers\": [{\"wrapS\": 10497, \"wrapT\": 10497}, {\"wrapS\": 33071, \"wrapT\": 33071}],"
            "\n  \"textures\": [");
    for (i = 0; i < all; i++)
        fprintf(out, "%s\n    {\"source\": %d, \"sampler\": %d}", i ? "," : "", i, i >= count ||
                f->scene->textures[i].wrap == SBL_WRAP_CLAMP);
    fprintf(out, "\n  ]");
}

static void gltf__put_extensions_used(FILE *out, const gltf_file *f) {
    static const char *const names[] = { "KHR_materials_emissive_strength", "KHR_materials_ior",
        "KHR_materials_specular", "KHR_materials_transmission", "MOZ_lightmap",
        "KHR_lights_punctual" };
    int i, bits = (f->map_count ? 16 : 0) | (gltf__light_count(f) ? 32 : 0), count = 0;
    for (i = 0; i < f->scene->material_count; i++) bits |= gltf__extensions(f, &f->scene->materials[i]);
    for (i = 0; i < 6; i++)
        if (bits >> i & 1) fprintf(out, "%s\"%s\"", count++ ? ", " : ",\n  \"extensionsUsed\": [", names[i]);
    if (count) fputc(']', out);
}

static void gltf__put_json(FILE *out, const gltf_file *f) {
    double bytes;
    int i;
    fprintf(out, "{\n  \"asset\": {\"version\": \"2.0\", \"generator\": \"sbl.h %s\"%s%s}", sbl_version(),
            f->extras ? ", \"extras\": " : "", f->extras ? f->extras : "");
    gltf__put_extensions_used(out, f);
    fprintf(out, ",\n  \"materials\": [");
    for (i = 0; i < f->materials->count; i++) gltf__put_material(out, f, i);
    fprintf(out, "\n  ]");
    gltf__put_textures(out, f);
    fprintf(out, ",\n  \"accessors\": [");
    bytes = gltf__put_arrays(out, f, GLTF__ACCESSORS);
    fprintf(out, "\n  ],\n  \"bufferViews\": [");
    gltf__put_arrays(out, f, GLTF__VIEWS);
    fprintf(out, "\n  ],\n  \"buffers\": [{\"uri\": ");
    gltf__put_uri(out, f->bin);
    fprintf(out, ", \"byteLength\": %.0f}],\n  \"meshes\": [", bytes);
    gltf__put_arrays(out, f, GLTF__MESHES);
    fprintf(out, "\n  ],\n  \"nodes\": [");
    gltf__put_nodes(out, f);
    gltf__put_lights(out, f);
    fprintf(out, "\n}\n");
}

/* Writes the .gltf. Returns 0 if memory runs out. */
static inline int gltf_write_json(FILE *out, const gltf_file *f) {
    gltf__materials materials = { NULL, NULL, 0 };
    gltf_file own = *f;
    const int ok = gltf__find_materials(f, &materials);
    own.materials = &materials;
    if (ok) gltf__put_json(out, &own);
    free(materials.numbers);
    free(materials.uses);
    return ok;
}

#endif
