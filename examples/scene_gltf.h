/* Part of scene_file.h: edits a .gltf or .glb before assimp reads it, to work around limits of assimp.

   assimp up to 5.2 drops KHR_materials_emissive_strength, and does not keep the order of materials. Therefore the
   strength is multiplied into emissiveFactor. If a camera has no aspectRatio, every version of assimp returns yfov
   itself; therefore aspectRatio is removed. assimp identifies the position of a light by the name of one node;
   therefore each node gets its own copy of its light, and a unique name. assimp drops the interpolation of animations;
   if the options ask for frames, it is appended to the names of animated nodes. assimp replaces missing metallicFactor
   and roughnessFactor by 1; version 5.2 drops KHR_materials_specular, and older versions also drop KHR_materials_ior;
   therefore these facts are appended to the names of materials. assimp refuses TEXCOORD_1 without TEXCOORD_0; therefore
   such a set also becomes the first. assimp drops lists in extras; therefore the lightmap placements are put before the
   names of nodes. assimp takes integers for floats; therefore scene_integers.h converts the vertices. assimp scales and
   turns texture coordinates about a wrong point, and stores them in the place of TEXCOORD_1; therefore
   KHR_texture_transform is removed, and the reader transforms the coordinates. assimp takes compressed meshes for
   floats; therefore a file that requires one of these extensions is refused. assimp scales a node whose rotation is not
   of length 1, which glTF forbids; therefore rotations get this length. assimp drops triangles and attributes that
   are broken, without a message; therefore the index of each mesh is put before its name, and the reader counts what is
   missing. Other invalid content is left unchanged, so that assimp reports it. */
#ifndef SCENE_GLTF_H
#define SCENE_GLTF_H

#include <math.h>
#include <stdlib.h>

static const char scene__strength_name[] = "KHR_materials_emissive_strength";

#define SCENE__IOR      1.5  /* index of refraction of a material that states none */
#define SCENE__MOST_IOR 1e6
#define SCENE__MOST_SCALE 1000.0f  /* maximum scale of a normal map */
enum { SCENE__MOST_MAPS = 10000, SCENE__MOST_SIZE = 16384 };  /* number of lightmaps; their width in texels */

/* The textures of a material, in the order in which the first one chooses the coordinates of all. */
enum { SCENE__ALBEDO, SCENE__EMISSION, SCENE__SPECULAR, SCENE__TRANSMISSION, SCENE__NORMAL, SCENE__MASK,
    SCENE__PICTURES };

/* The KHR_texture_transform of a texture: u becomes m[0] u + m[1] v + m[2], and v becomes m[3] u + m[4] v + m[5]. */
typedef struct scene__transform { float m[6]; } scene__transform;

/* What scene__mend_gltf takes out of a .gltf for the reader, which frees it. */
typedef struct scene__taken {
    scene__transform *transforms;  /* SCENE__PICTURES for each material, in the order of the file; or NULL */
    int material_count;
    double *triangles;             /* the number of triangles of each mesh, in the order of the file; or NULL */
    int mesh_count;
    scene__bytes floats;           /* see scene_integers.h; data is NULL if no vertices were integers */
} scene__taken;

/* Facts about a material, as bits in its name. */
enum {
    SCENE__TOLD_GLOSS = 1,       /* the file states metalness, roughness or gloss */
    SCENE__TOLD_SPECULAR = 2,    /* it has a KHR_materials_specular, which is ignored */
    SCENE__TOLD_ANISOTROPY = 4,
    SCENE__TOLD_OTHER = 8        /* it has other extensions that are ignored */
};

#ifdef SBL_RENDER_CJSON
static const char scene__lights_name[] = "KHR_lights_punctual";

static int scene__is_light(const cJSON *light) {
    const char *type = cJSON_GetStringValue(scene__item(light, "type"));
    if (!type) return 0;
    if (strcmp(type, "spot") == 0) return cJSON_IsObject(scene__item(light, "spot"));
    return strcmp(type, "point") == 0 || strcmp(type, "directional") == 0;
}

/* Gives each node with a light its own copy of the light and a unique name. */
static void scene__part_lights(scene_file *file, cJSON *root) {
    cJSON *all = scene__item(scene__item(root, "extensions"), scene__lights_name), *old = scene__item(all, "lights");
    cJSON *lights = cJSON_CreateArray(), *node;
    const int count = cJSON_GetArraySize(old);
    int number = 0;
    cJSON_ArrayForEach(node, scene__item(root, "nodes")) {
        cJSON *extensions = scene__item(node, "extensions"), *use = scene__item(extensions, scene__lights_name);
        const cJSON *index = scene__item(use, "light"), *light = NULL;
        const char *name = cJSON_GetStringValue(scene__item(node, "name"));
        char unique[256];
        scene__print(unique, sizeof unique, "%.200s (node %d)", name ? name : "without name", number++);
        if (!use) continue;
        if (cJSON_IsNumber(index) && index->valuedouble >= 0 && index->valuedouble < count)
            light = cJSON_GetArrayItem(old, index->valueint);
        if (scene__is_light(light)) {
            cJSON_ReplaceItemInObjectCaseSensitive(use, "light", cJSON_CreateNumber(cJSON_GetArraySize(lights)));
            cJSON_AddItemToArray(lights, cJSON_Duplicate(light, 1));
            cJSON_DeleteItemFromObjectCaseSensitive(node, "name");
            cJSON_AddStringToObject(node, "name", unique);
        } else {
            scene__warn(file, "light of %s: it is not a point, spot or directional light and was left out", unique);
            cJSON_DeleteItemFromObjectCaseSensitive(extensions, scene__lights_name);
        }
    }
    if (!old || !cJSON_ReplaceItemInObjectCaseSensitive(all, "lights", lights)) cJSON_Delete(lights);
}

/* Returns the letter for the interpolation of an animation sampler: L (LINEAR, the default), S (STEP) or C
   (CUBICSPLINE). */
static char scene__letter(const cJSON *sampler) {
    const char *words = cJSON_GetStringValue(scene__item(sampler, "interpolation"));
    return words && strcmp(words, "STEP") == 0 ? 'S' : words && strcmp(words, "CUBICSPLINE") == 0 ? 'C' : 'L';
}

/* Gives each node that is animated or has a camera a unique name. The name ends with one letter each for translation,
   rotation and scale: the interpolation in the first animation of the node, or "-" if this is not animated. See
   scene__motion_kind. */
static void scene__name_animated(scene_file *file, cJSON *root) {
    static const char *const paths[] = { "translation", "rotation", "scale" };
    const cJSON *animation, *channel, *nodes = scene__item(root, "nodes");
    const int count = cJSON_GetArraySize(nodes);
    struct moved { cJSON *node; const cJSON *by; char letters[4]; } *all;
    cJSON *node;
    int i = 0, k;
    all = (struct moved *)calloc((size_t)count + 1, sizeof *all);
    if (!all) { scene__fail_for_memory(file, "it"); return; }
    cJSON_ArrayForEach(node, nodes) all[i++].node = node;
    cJSON_ArrayForEach(animation, scene__item(root, "animations")) {
        const cJSON *samplers = scene__item(animation, "samplers");
        cJSON_ArrayForEach(channel, scene__item(animation, "channels")) {
            const cJSON *target = scene__item(channel, "target"), *number = scene__item(target, "node");
            const cJSON *sampler = scene__item(channel, "sampler");
            const char *path = cJSON_GetStringValue(scene__item(target, "path"));
            if (!cJSON_IsNumber(number) || !(number->valuedouble >= 0 && number->valuedouble < count)) continue;
            i = number->valueint;
            if (!all[i].by) { all[i].by = animation; strcpy(all[i].letters, "---"); }
            for (k = 0; k < 3 && path && all[i].by == animation && cJSON_IsNumber(sampler); k++)
                if (strcmp(path, paths[k]) == 0)
                    all[i].letters[k] = scene__letter(cJSON_GetArrayItem(samplers, sampler->valueint));
        }
    }
    for (i = 0; i < count; i++) {
        const char *name = cJSON_GetStringValue(scene__item(all[i].node, "name"));
        char unique[256];
        if ((!all[i].by && !scene__item(all[i].node, "camera")) || !cJSON_IsObject(all[i].node)) continue;
        scene__print(unique, sizeof unique, "%.200s (node %d %s)", name ? name : "without name", i,
                     all[i].by ? all[i].letters : "---");
        cJSON_DeleteItemFromObjectCaseSensitive(all[i].node, "name");
        cJSON_AddStringToObject(all[i].node, "name", unique);
    }
    free(all);
}

/* Returns the index of refraction that sbl.h uses for a material of the file; 0 means no reflections except those of
   metal. A KHR_materials_ior of 0 means infinite. A factor of 0 in KHR_materials_specular removes the reflections. A
   black colour there counts as a factor of 0, because Blender writes it for matte surfaces, although glTF would keep
   reflections at grazing angles. */
static double scene__ior_of(const cJSON *extensions) {
    const cJSON *ior = scene__item(scene__item(extensions, "KHR_materials_ior"), "ior");
    const cJSON *specular = scene__item(extensions, "KHR_materials_specular"), *number;
    const cJSON *factor = scene__item(specular, "specularFactor");
    const cJSON *color = scene__item(specular, "specularColorFactor");
    const double value = cJSON_IsNumber(ior) ? ior->valuedouble : SCENE__IOR;
    int is_black = cJSON_GetArraySize(color) == 3;
    cJSON_ArrayForEach(number, color) is_black &= cJSON_IsNumber(number) && number->valuedouble <= 0;
    if (is_black || (cJSON_IsNumber(factor) && factor->valuedouble <= 0)) return 0;
    return value == 0.0 || value > SCENE__MOST_IOR ? SCENE__MOST_IOR : value > 1 ? value : 1;
}

/* Warns of an index of refraction that glTF does not allow, and that scene__ior_of replaces by 1. */
static void scene__check_ior(scene_file *file, const cJSON *material, const char *name) {
    const cJSON *ior = scene__item(scene__item(scene__item(material, "extensions"), "KHR_materials_ior"), "ior");
    if (!file->matte && cJSON_IsNumber(ior) && ior->valuedouble < 1 && ior->valuedouble != 0.0)
        scene__warn(file, "material %.100s: its index of refraction is %g, but glTF allows only 0 and values from 1 "
                    "on; 1 is used", name, ior->valuedouble);
}

/* Returns the SCENE__TOLD_ bits of a material of the file. */
static int scene__bits_of(const cJSON *material) {
    static const char start[] = "KHR_materials_";
    static const struct { const char *name; int bits; } known[] = { { "anisotropy", SCENE__TOLD_ANISOTROPY },
        { "clearcoat", 0 }, { "emissive_strength", 0 }, { "ior", 0 }, { "pbrSpecularGlossiness", SCENE__TOLD_GLOSS },
        { "sheen", 0 }, { "specular", SCENE__TOLD_SPECULAR }, { "transmission", 0 }, { "unlit", 0 }, { "variants", 0 },
        { "volume", 0 } };
    const size_t most = sizeof known / sizeof *known;
    const cJSON *model = scene__item(material, "pbrMetallicRoughness");
    const cJSON *extensions = scene__item(material, "extensions"), *extension;
    int bits = 0;
    if (scene__item(model, "metallicFactor") || scene__item(model, "roughnessFactor") ||
        scene__item(model, "metallicRoughnessTexture")) bits = SCENE__TOLD_GLOSS;
    cJSON_ArrayForEach(extension, extensions) {
        const char *name = extension->string ? extension->string : "";
        size_t i = 0;
        if (strncmp(name, start, sizeof start - 1) != 0) continue;
        while (i < most && strcmp(name + sizeof start - 1, known[i].name) != 0) i++;
        bits |= i < most ? known[i].bits : SCENE__TOLD_OTHER;
        /* without members it changes nothing, and a factor of 0 is read, so neither is ignored */
        if (i < most && known[i].bits == SCENE__TOLD_SPECULAR && (!extension->child || scene__ior_of(extensions) <= 0))
            bits &= ~SCENE__TOLD_SPECULAR;
    }
    return bits;
}

/* Returns a number of a list, or `otherwise` if it is missing. */
static double scene__number_at(const cJSON *list, int index, double otherwise) {
    const cJSON *number = cJSON_GetArrayItem(list, index);
    return cJSON_IsNumber(number) ? number->valuedouble : otherwise;
}

/* Reads the KHR_texture_transform of a texture: it scales, then rotates, then moves. */
static scene__transform scene__transform_of(const cJSON *texture) {
    const cJSON *from = scene__item(scene__item(texture, "extensions"), "KHR_texture_transform");
    const cJSON *offset = scene__item(from, "offset"), *scale = scene__item(from, "scale");
    const cJSON *rotation = scene__item(from, "rotation");
    const double angle = cJSON_IsNumber(rotation) ? rotation->valuedouble : 0, c = cos(angle), s = sin(angle);
    const double x = scene__number_at(scale, 0, 1), y = scene__number_at(scale, 1, 1);
    scene__transform out;
    out.m[0] = (float)(c * x);
    out.m[1] = (float)(s * y);
    out.m[2] = (float)scene__number_at(offset, 0, 0);
    out.m[3] = (float)(-s * x);
    out.m[4] = (float)(c * y);
    out.m[5] = (float)scene__number_at(offset, 1, 0);
    return out;
}

/* Removes KHR_texture_transform from an item and all items in it. Its texCoord replaces that of the texture. */
static void scene__remove_transforms(cJSON *item) {
    cJSON *extensions = scene__item(item, "extensions"), *child;
    cJSON *transform = cJSON_DetachItemFromObjectCaseSensitive(extensions, "KHR_texture_transform");
    const cJSON *set = scene__item(transform, "texCoord");
    if (cJSON_IsNumber(set)) {
        cJSON_DeleteItemFromObjectCaseSensitive(item, "texCoord");
        cJSON_AddNumberToObject(item, "texCoord", set->valuedouble);
    }
    cJSON_Delete(transform);
    cJSON_ArrayForEach(child, item) scene__remove_transforms(child);
}

/* Moves the transforms of all textures from the materials to out->transforms. */
static void scene__take_transforms(scene_file *file, cJSON *root, scene__taken *out) {
    cJSON *const materials = scene__item(root, "materials"), *material;
    scene__transform *to;
    out->material_count = cJSON_GetArraySize(materials);
    out->transforms = to = (scene__transform *)calloc((size_t)out->material_count * SCENE__PICTURES + 1, sizeof *to);
    if (!to) { scene__fail_for_memory(file, "it"); return; }
    cJSON_ArrayForEach(material, materials) {
        const cJSON *extensions = scene__item(material, "extensions");
        const cJSON *model = scene__item(material, "pbrMetallicRoughness");
        const cJSON *other = scene__item(extensions, "KHR_materials_pbrSpecularGlossiness");
        const cJSON *glass = scene__item(extensions, "KHR_materials_transmission");
        const cJSON *albedo = scene__item(other, "diffuseTexture");
        to[SCENE__ALBEDO] = scene__transform_of(albedo ? albedo : scene__item(model, "baseColorTexture"));
        to[SCENE__EMISSION] = scene__transform_of(scene__item(material, "emissiveTexture"));
        to[SCENE__SPECULAR] = scene__transform_of(scene__item(model, "metallicRoughnessTexture"));
        to[SCENE__TRANSMISSION] = scene__transform_of(scene__item(glass, "transmissionTexture"));
        to[SCENE__NORMAL] = scene__transform_of(scene__item(material, "normalTexture"));
        to += SCENE__PICTURES;
    }
    scene__remove_transforms(materials);
}

/* Appends to the name of each material the facts that scene__told_by reads, the last of which is its number. */
static void scene__name_materials(scene_file *file, cJSON *root) {
    cJSON *material;
    int number = 0;
    cJSON_ArrayForEach(material, scene__item(root, "materials")) {
        const char *name = cJSON_GetStringValue(scene__item(material, "name"));
        char unique[256];
        number++;
        if (!cJSON_IsObject(material)) continue;
        scene__check_ior(file, material, name ? name : "without name");
        scene__print(unique, sizeof unique, "%.200s (ior %.9g, %d, %d)", name ? name : "",
                     scene__ior_of(scene__item(material, "extensions")), scene__bits_of(material), number - 1);
        cJSON_DeleteItemFromObjectCaseSensitive(material, "name");
        cJSON_AddStringToObject(material, "name", unique);
    }
}

/* Returns the count of an accessor, or 0 if there is no such accessor. item: refers to it */
static double scene__count_of(const cJSON *item, cJSON *const *accessors, int accessor_count) {
    const int number = cJSON_IsNumber(item) ? item->valueint : -1;
    return number >= 0 && number < accessor_count ? scene__whole_of(accessors[number], "count", 0) : 0;
}

/* Returns the number of triangles of a primitive, where one that lacks a corner counts, too. vertices: number of its
   positions */
static double scene__triangles_of(const cJSON *primitive, double vertices, cJSON *const *accessors, int count) {
    const cJSON *indices = scene__item(primitive, "indices");
    const double mode = scene__whole_of(primitive, "mode", 4);
    const double corners = indices ? scene__count_of(indices, accessors, count) : vertices;
    if (mode < 4) return 0;
    return mode > 4 ? fmax(corners - 2, 0) : ceil(corners / 3);
}

/* Returns 1 if the reader uses an attribute of this name in addition to the positions. name: NULL if the file has a
   list in the place of the attributes */
static int scene__is_read(const char *name) {
    if (!name) return 0;
    return strcmp(name, "NORMAL") == 0 || strcmp(name, "COLOR_0") == 0 || strncmp(name, "TEXCOORD_", 9) == 0;
}

/* Puts before the name of each mesh the text that scene__count_lost reads, and stores the number of its triangles.
   Counts the meshes with attributes that assimp drops, because they have fewer or more elements than the positions. */
static void scene__name_meshes(scene_file *file, cJSON *root, scene__taken *out) {
    cJSON *const meshes = scene__item(root, "meshes"), *mesh, *primitive, *attribute;
    int count, number = 0;
    cJSON **accessors = scene__items_of(scene__item(root, "accessors"), &count);
    out->mesh_count = cJSON_GetArraySize(meshes);
    out->triangles = (double *)calloc((size_t)out->mesh_count + 1, sizeof *out->triangles);
    if (!accessors || !out->triangles) { scene__fail_for_memory(file, "it"); free(accessors); return; }
    cJSON_ArrayForEach(mesh, meshes) {
        const char *name = cJSON_GetStringValue(scene__item(mesh, "name"));
        char unique[256];
        int differs = 0;
        cJSON_ArrayForEach(primitive, scene__item(mesh, "primitives")) {
            const cJSON *attributes = scene__item(primitive, "attributes");
            const double vertices = scene__count_of(scene__item(attributes, "POSITION"), accessors, count);
            out->triangles[number] += scene__triangles_of(primitive, vertices, accessors, count);
            cJSON_ArrayForEach(attribute, attributes)
                if (scene__is_read(attribute->string))
                    differs |= fabs(scene__count_of(attribute, accessors, count) - vertices) > 0;
        }
        if (differs) scene__count(file, SCENE_FILE_ATTRIBUTE);
        scene__print(unique, sizeof unique, "(mesh %d) %.200s", number++, name ? name : "");
        cJSON_DeleteItemFromObjectCaseSensitive(mesh, "name");
        cJSON_AddStringToObject(mesh, "name", unique);
    }
    free(accessors);
}

/* Makes the sets of texture coordinates of each primitive contiguous. A TEXCOORD_1 without TEXCOORD_0 becomes both.
   Sets after a missing one are dropped. */
static void scene__order_texcoords(cJSON *root) {
    cJSON *mesh, *primitive;
    cJSON_ArrayForEach(mesh, scene__item(root, "meshes"))
        cJSON_ArrayForEach(primitive, scene__item(mesh, "primitives")) {
            cJSON *attributes = scene__item(primitive, "attributes"), *sets[8] = { NULL };
            char name[16];
            int i, ended = 0;
            for (i = 0; i < 8; i++) {
                scene__print(name, sizeof name, "TEXCOORD_%d", i);
                sets[i] = cJSON_DetachItemFromObjectCaseSensitive(attributes, name);
            }
            if (!sets[0]) sets[0] = cJSON_Duplicate(sets[1], 1);
            for (i = 0; i < 8; i++) {
                scene__print(name, sizeof name, "TEXCOORD_%d", i);
                ended |= !sets[i];
                if (ended) cJSON_Delete(sets[i]);
                else cJSON_AddItemToObject(attributes, name, sets[i]);
            }
        }
}

/* Puts before the name of each node with a lightmap placement the text that scene__place_of reads. If there are several
   lightmaps, each node with a mesh gets one. */
static void scene__name_places(scene_file *file, cJSON *root) {
    cJSON *node, *const nodes = scene__item(root, "nodes");
    int number = -1, several = 0;
    cJSON_ArrayForEach(node, nodes) several |= scene__item(scene__item(node, "extras"), "lightmapIndex") != NULL;
    cJSON_ArrayForEach(node, nodes) {
        const cJSON *extras = scene__item(node, "extras"), *list = scene__item(extras, "lightmapScaleOffset"), *part;
        const cJSON *map = scene__item(extras, "lightmapIndex");
        const char *name = cJSON_GetStringValue(scene__item(node, "name"));
        double v[4] = { 1, 1, 0, 0 };
        char own[16], unique[320];
        int count = 0, valid = !map || (cJSON_IsNumber(map) && map->valuedouble >= 0 &&
                                        map->valuedouble < SCENE__MOST_MAPS);
        number++;
        if ((!list && !map && !several) || !cJSON_IsObject(node) || !scene__item(node, "mesh")) continue;
        cJSON_ArrayForEach(part, list) {
            valid &= cJSON_IsNumber(part) && fabs(part->valuedouble) < 1e6 && count < 4;
            if (valid) v[count++] = part->valuedouble;
        }
        scene__print(own, sizeof own, "node %d", number);
        if (!valid || (list && count != 4)) {
            scene__warn(file, "%.100s: its place in the lightmap (extras) is not valid and is ignored",
                        name ? name : own);
            continue;
        }
        scene__print(unique, sizeof unique, "(node %d, map %d, %.9g %.9g %.9g %.9g) %.200s", number,
                     map ? map->valueint : 0, v[0], v[1], v[2], v[3], name ? name : own);
        cJSON_DeleteItemFromObjectCaseSensitive(node, "name");
        cJSON_AddStringToObject(node, "name", unique);
    }
}

static int scene__lists(const cJSON *list, const char *name) {
    const cJSON *item;
    cJSON_ArrayForEach(item, list)
        if (cJSON_IsString(item) && strcmp(item->valuestring, name) == 0) return 1;
    return 0;
}

/* Warns of extensions that the file requires and that neither assimp nor this reader knows. Extensions of materials
   have warnings of their own (SCENE_FILE_EXTENSION). Without Draco, assimp refuses the file itself. */
static void scene__check_required(scene_file *file, const cJSON *required) {
    static const char *const known[] = { "KHR_lights_punctual", "KHR_texture_transform", "KHR_draco_mesh_compression",
        "KHR_mesh_quantization", "EXT_meshopt_compression", "KHR_meshopt_compression", "EXT_mesh_gpu_instancing",
        "KHR_node_visibility", "MOZ_lightmap", "KHR_texture_basisu", "EXT_texture_webp", "EXT_texture_avif" };
    static const char start[] = "KHR_materials_";
    const cJSON *item;
    cJSON_ArrayForEach(item, required) {
        size_t i = 0;
        if (!cJSON_IsString(item) || strncmp(item->valuestring, start, sizeof start - 1) == 0) continue;
        while (i < sizeof known / sizeof *known && strcmp(item->valuestring, known[i]) != 0) i++;
        if (i == sizeof known / sizeof *known)
            scene__warn(file, "it requires %.100s, which is not known: parts of the scene can be wrong or missing",
                        item->valuestring);
    }
}

/* Refuses a file with compressed meshes, which assimp takes for floats. Warns of other extensions that change
   the scene, and that assimp drops. */
static void scene__check_extensions(scene_file *file, const cJSON *root) {
    static const char *const refused[] = { "EXT_meshopt_compression", "KHR_meshopt_compression" };
    static const char *const ignored[][2] = {
        { "EXT_mesh_gpu_instancing", "only one copy of each of its meshes is shown" },
        { "KHR_node_visibility", "hidden nodes are shown" } };
    const cJSON *required = scene__item(root, "extensionsRequired"), *used = scene__item(root, "extensionsUsed");
    size_t i;
    for (i = 0; i < sizeof refused / sizeof *refused; i++)
        if (scene__lists(required, refused[i]))
            scene__fail(file, "it requires %s, which is not supported; export it without that", refused[i]);
    for (i = 0; i < sizeof ignored / sizeof *ignored; i++)
        if (scene__lists(used, ignored[i][0]) || scene__lists(required, ignored[i][0]))
            scene__warn(file, "%s is ignored: %s", ignored[i][0], ignored[i][1]);
    scene__check_required(file, required);
}

/* Warns of textures without a picture in a format that every reader of glTF knows; assimp omits them. */
static void scene__check_textures(scene_file *file, const cJSON *root) {
    const cJSON *texture, *extension;
    const char *format = NULL;
    int count = 0;
    cJSON_ArrayForEach(texture, scene__item(root, "textures")) {
        if (scene__item(texture, "source")) continue;
        count++;
        cJSON_ArrayForEach(extension, scene__item(texture, "extensions")) format = extension->string;
    }
    if (count)
        scene__warn(file, "textures without a .png or .jpg picture are left out (%d %s%s%.100s)", count,
                    count == 1 ? "texture" : "textures", format ? ", " : "", format ? format : "");
}

#define SCENE__ROTATION_OFF 1e-3  /* a rotation whose length differs from 1 by more causes a warning */

/* Gives the rotations of all nodes length 1. A rotation of length 0 is removed. */
static void scene__unit_rotations(scene_file *file, const cJSON *root) {
    cJSON *node, *number;
    char first[128] = "";
    int i = 0, wrong = 0;
    cJSON_ArrayForEach(node, scene__item(root, "nodes")) {
        cJSON *rotation = scene__item(node, "rotation");
        const char *name = cJSON_GetStringValue(scene__item(node, "name"));
        double length = 0;
        int count = 0;
        i++;
        cJSON_ArrayForEach(number, rotation) {
            length = hypot(length, number->valuedouble);
            count += cJSON_IsNumber(number);
        }
        if (count != 4 || cJSON_GetArraySize(rotation) != 4 || !isfinite(length)) continue;
        if (fabs(length - 1) > SCENE__ROTATION_OFF && !wrong++)
            scene__print(first, sizeof first, "%.90s (node %d)", name ? name : "without name", i - 1);
        if (length > 0)
            cJSON_ArrayForEach(number, rotation) cJSON_SetNumberHelper(number, number->valuedouble / length);
        else cJSON_DeleteItemFromObjectCaseSensitive(node, "rotation");
    }
    if (wrong)
        scene__warn(file, "%d rotation%s not of length 1, which glTF demands, such as that of %s; length 1 is used",
                    wrong, wrong > 1 ? "s are" : " is", first);
}

static void scene__mend_json(scene_file *file, cJSON *root, scene__taken *taken) {
    cJSON *item, *number;
    scene__check_extensions(file, root);
    scene__check_textures(file, root);
    scene__unit_rotations(file, root);
    item = scene__item(scene__item(scene__item(root, "asset"), "extras"), "lightmapSize");
    if (cJSON_IsNumber(item) && item->valuedouble >= 1 && item->valuedouble <= SCENE__MOST_SIZE)
        file->map_size = item->valueint;
    scene__name_meshes(file, root, taken);
    scene__order_texcoords(root);
    scene__name_places(file, root);
    scene__name_materials(file, root);
    scene__take_transforms(file, root, taken);
    cJSON_ArrayForEach(item, scene__item(root, "materials")) {
        cJSON *extensions = scene__item(item, "extensions");
        const cJSON *strength = scene__item(scene__item(extensions, scene__strength_name), "emissiveStrength");
        if (cJSON_IsNumber(strength))
            cJSON_ArrayForEach(number, scene__item(item, "emissiveFactor"))
                if (cJSON_IsNumber(number)) cJSON_SetNumberHelper(number, number->valuedouble * strength->valuedouble);
        cJSON_DeleteItemFromObjectCaseSensitive(extensions, scene__strength_name);
    }
    cJSON_ArrayForEach(item, scene__item(root, "cameras"))
        cJSON_DeleteItemFromObjectCaseSensitive(scene__item(item, "perspective"), "aspectRatio");
    scene__part_lights(file, root);
    if (file->frames_asked) scene__name_animated(file, root);
}

/* Replaces `length` bytes of JSON at the offset `start` by a text. In a .glb, also updates the sizes. Returns 0 if
   memory runs out. */
static int scene__replace_json(scene__bytes *bytes, size_t start, size_t length, const char *text) {
    const int binary = start > 0;
    const size_t size = strlen(text), padded = binary ? (size + 3) & ~(size_t)3 : size;
    const size_t rest = bytes->size - start - length, total = start + padded + rest;
    char *joined = (char *)malloc(total + 1);
    size_t i;
    if (!joined) return 0;
    memcpy(joined, bytes->data, start);
    memcpy(joined + start, text, size);
    memset(joined + start + size, ' ', padded - size);
    memcpy(joined + start + padded, bytes->data + start + length, rest);
    joined[total] = 0;
    for (i = 0; binary && i < 4; i++) {
        joined[8 + i] = (char)(total >> 8 * i & 255);
        joined[12 + i] = (char)(padded >> 8 * i & 255);
    }
    free(bytes->data);
    bytes->data = joined;
    bytes->size = total;
    return 1;
}
#endif

static int scene__mentions(const scene__bytes *bytes, const char *word) {
    const size_t length = strlen(word);
    size_t i;
    for (i = 0; i + length <= bytes->size; i++)
        if (bytes->data[i] == word[0] && memcmp(bytes->data + i, word, length) == 0) return 1;
    return 0;
}

/* Edits a file as described at the top. bytes: the content, which is replaced if anything changes. taken: all 0 before
   the call */
static void scene__mend_gltf(scene_file *file, const char *path, scene__bytes *bytes, scene__taken *taken) {
#ifdef SBL_RENDER_CJSON
    const unsigned char *head = (const unsigned char *)bytes->data;
    const int binary = bytes->size >= 20 && memcmp(head, "glTF", 4) == 0;
    const size_t start = binary ? 20 : 0;
    size_t length = bytes->size - start;
    scene__bytes inside = { NULL, 0 };
    static const char *const reasons[] = { "KHR_materials_", "metallicFactor", "roughnessFactor",
        "metallicRoughnessTexture", "KHR_lights_punctual", "aspectRatio", "TEXCOORD_1", "lightmapScaleOffset",
        "lightmapIndex", "lightmapSize", "extensionsRequired", "EXT_mesh_gpu_instancing", "KHR_node_visibility",
        "KHR_texture_transform", "KHR_mesh_quantization", "normalized", "_texture_", "indices", "NORMAL", "COLOR_0",
        "rotation" };
    const int count = (int)(sizeof reasons / sizeof *reasons);
    int edited = file->frames_asked, i;
    cJSON *root;
    char *text;
    for (i = 0; i < count && !edited; i++) edited = scene__mentions(bytes, reasons[i]);
    if (binary) length = head[12] | (size_t)head[13] << 8 | (size_t)head[14] << 16 | (size_t)head[15] << 24;
    if (length > bytes->size - start) return;
    if (!edited) return;
    root = cJSON_ParseWithLength(bytes->data + start, length);
    if (!root) return;
    scene__mend_json(file, root, taken);
    if (binary && bytes->size - start - length > 8) {
        inside.data = bytes->data + start + length + 8;
        inside.size = bytes->size - start - length - 8;
    }
    scene__convert_integers(file, path, inside, root, &taken->floats);
    text = cJSON_PrintUnformatted(root);
    if (!text || !scene__replace_json(bytes, start, length, text)) scene__fail_for_memory(file, "it");
    cJSON_free(text);
    cJSON_Delete(root);
#else
    if (scene__mentions(bytes, scene__strength_name))
        scene__warn(file, "this program was built without cJSON: %s is ignored, lamps may be too dark",
                    scene__strength_name);
    if (scene__mentions(bytes, "lightmapScaleOffset") || scene__mentions(bytes, "lightmapIndex"))
        scene__warn(file, "this program was built without cJSON: places in a lightmap (extras) are ignored");
    if (scene__mentions(bytes, "KHR_texture_transform"))
        scene__warn(file, "this program was built without cJSON: turned and scaled textures are in wrong places");
    if (scene__mentions(bytes, "extensionsRequired"))
        scene__warn(file, "this program was built without cJSON: extensions that the file requires are not checked");
    if (file->frames_asked)
        scene__fail(file, "this program was built without cJSON, which reading an animated camera needs");
    (void)path;
    (void)taken;
#endif
}

#endif
