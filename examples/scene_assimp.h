/* Part of scene_file.h: reads scenes with assimp and converts them to the arrays of sbl.h. */
#ifndef SCENE_ASSIMP_H
#define SCENE_ASSIMP_H

#include <math.h>
#include <assimp/cfileio.h>
#include <assimp/cimport.h>
#include <assimp/commonMetaData.h>
#include <assimp/GltfMaterial.h>
#include <assimp/light.h>
#include <assimp/material.h>
#include <assimp/ObjMaterial.h>
#include <assimp/postprocess.h>
#include <assimp/scene.h>

/* ---- file access of assimp, which reads from memory so that files can be edited before ---- */

typedef struct scene__stream { scene__bytes bytes; size_t at; int shared; } scene__stream;
typedef struct scene__main_file {
    scene_file *file;
    const char *path;
    scene__bytes bytes;
    const scene__bytes *floats;  /* content of the file scene__floats_name */
    char missing[160];  /* an .mtl file that could not be read, or an empty text */
    scene__mtl *mtl;    /* receives the materials of all .mtl files */
} scene__main_file;

static scene__stream *scene__of(struct aiFile *file) { return (scene__stream *)(void *)file->UserData; }

static size_t scene__read(struct aiFile *file, char *out, size_t size, size_t count) {
    scene__stream *s = scene__of(file);
    size_t available = size ? (s->bytes.size - s->at) / size : 0;
    if (count > available) count = available;
    memcpy(out, s->bytes.data + s->at, size * count);
    s->at += size * count;
    return count;
}
static size_t scene__write(struct aiFile *file, const char *data, size_t size, size_t count) {
    (void)file; (void)data; (void)size; (void)count;
    return 0;
}
static size_t scene__tell(struct aiFile *file) { return scene__of(file)->at; }
static size_t scene__size(struct aiFile *file) { return scene__of(file)->bytes.size; }
static void scene__flush(struct aiFile *file) { (void)file; }
static enum aiReturn scene__seek(struct aiFile *file, size_t offset, enum aiOrigin origin) {
    scene__stream *s = scene__of(file);
    size_t from = origin == aiOrigin_SET ? 0 : origin == aiOrigin_CUR ? s->at : s->bytes.size;
    /* negative offsets work, too, because unsigned addition wraps around */
    if (from + offset > s->bytes.size) return aiReturn_FAILURE;
    s->at = from + offset;
    return aiReturn_SUCCESS;
}

/* Notes whether an .mtl file could be read. assimp tries several paths for it, and does not report a failure. bytes:
   its content, or NULL */
static void scene__note_mtl(scene__main_file *main_file, const char *path, scene__bytes *bytes) {
    char *missing = main_file->missing;
    if (!scene__ends_with(path, ".mtl")) return;
    if (bytes) scene__mend_mtl(main_file->file, path, bytes, main_file->mtl);
    if (bytes) missing[0] = 0;
    else if (!missing[0]) scene__print(missing, sizeof main_file->missing, "%s", path);
}

/* Reads a file that the main file refers to. assimp has put the folder of the main file before its name, but has not
   decoded characters such as %20 in the names of buffers of glTF. Returns 0 and sets errno on failure. */
static int scene__read_beside(const scene__main_file *main_file, const char *path, scene__bytes *out) {
    const char *slash = strrchr(main_file->path, '/');
    const size_t folder = slash ? (size_t)(slash - main_file->path) + 1 : 0;
    if (strchr(path, '%') && strncmp(path, main_file->path, folder) == 0 &&
        (scene__ends_with(main_file->path, ".gltf") || scene__ends_with(main_file->path, ".glb")))
        return scene__slurp_named(main_file->file, main_file->path, path + folder, out);
    return scene__slurp(main_file->file, path, out);
}

static struct aiFile *scene__open(struct aiFileIO *io, const char *path, const char *mode) {
    scene__main_file *main_file = (scene__main_file *)(void *)io->UserData;
    scene__stream *s = (scene__stream *)calloc(1, sizeof *s);
    struct aiFile *file = (struct aiFile *)calloc(1, sizeof *file);
    if (!s || !file || strchr(mode, 'w') || strchr(mode, 'a')) goto fail;
    if (strcmp(path, main_file->path) == 0) {
        s->bytes = main_file->bytes;
        s->shared = 1;
    } else if (main_file->floats->data && scene__ends_with(path, scene__floats_name)) {
        s->bytes = *main_file->floats;
        s->shared = 1;
    } else if (!scene__read_beside(main_file, path, &s->bytes)) {
        if (errno == SCENE__REFUSED) scene__refuse(main_file->file, path);
        scene__note_mtl(main_file, path, NULL);
        goto fail;
    }
    scene__note_mtl(main_file, path, &s->bytes);
    file->ReadProc = scene__read;
    file->WriteProc = scene__write;
    file->TellProc = scene__tell;
    file->FileSizeProc = scene__size;
    file->SeekProc = scene__seek;
    file->FlushProc = scene__flush;
    file->UserData = (char *)s;
    return file;
fail:
    free(s);
    free(file);
    return NULL;
}

static void scene__close(struct aiFileIO *io, struct aiFile *file) {
    (void)io;
    if (!scene__of(file)->shared) free(scene__of(file)->bytes.data);
    free(scene__of(file));
    free(file);
}

/* ---- materials ---- */

typedef struct scene__reader {
    scene_file *file;
    const struct aiScene *in;
    int is_gltf;
    int is_obj;
    double unit;         /* factor of all lengths; see scene__unit_of */
    int is_bare;         /* 1: the file has no materials; assimp then returns one of its own */
    int lacks_mtl;       /* 1: an .mtl file could not be read, which a warning has said */
    scene__mtl mtl;      /* the materials of an .obj file */
    sbl_material *materials;
    scene__pictures pictures;
    int not_matte;       /* 1: a material is glossy, metallic or transmissive; see scene__gloss */
    int *left_out;       /* one per material; 1: its surface is cut out everywhere, so its meshes are omitted */
    int left_out_uses;   /* number of uses of such meshes */
    unsigned *uv_set;    /* one per material: index of its set of texture coordinates */
    scene__taken taken;  /* from a .gltf */
    char *repeated;      /* one per material: axes of its textures; see scene__repeats_instead */
    const scene__transform **moves;  /* one per material: the transform of its texture coordinates, or NULL */
    float *opacity;      /* one per material: factor for the alpha of vertex colours */
    char *shown, *posed; /* one per material, 1: used; one per mesh, 1: used, with bones or morph targets */
    sbl_mesh *shared;    /* one per mesh of the file: its arrays, which all uses share */
    sbl_mesh *meshes;    /* one per use of a mesh by a node */
    const char **names, **light_names;
    int *maps;
    scene_file_place *places;
    size_t use_count;
    double triangles, vertices;  /* sums over all uses of meshes */
    unsigned best_camera;
    const struct aiNode *camera_node;  /* node of best_camera; NULL if the file has no camera */
    scene__motion motion;              /* motion of camera_node, if the options ask for frames */
    struct scene__lamp { const struct aiLight *light; int placed; } *lamps;  /* lights of the file, sorted by name */
    sbl_light *lights;
} scene__reader;

static int scene__find_embedded(const void *scene, const char *name, scene__embedded *out) {
    const struct aiScene *in = (const struct aiScene *)scene;
    const struct aiTexture *found = NULL;
    unsigned i;
    if (name[0] == '*') {
        char *end;
        unsigned long number = strtoul(name + 1, &end, 10);
        if (*end == 0 && end != name + 1 && number < in->mNumTextures) found = in->mTextures[number];
    } else
        for (i = 0; i < in->mNumTextures && !found; i++)
            if (in->mTextures[i]->mFilename.length && strcmp(in->mTextures[i]->mFilename.data, name) == 0)
                found = in->mTextures[i];
    if (!found) return 0;
    out->data = found->pcData;
    out->size = found->mHeight ? 0 : found->mWidth;
    out->width = found->mWidth;
    out->height = found->mHeight;
    return 1;
}

typedef struct scene__use_of_picture {
    struct aiString name;
    enum aiTextureMapMode wrap[2];
    unsigned set;
} scene__use_of_picture;

static int scene__picture_of(const struct aiMaterial *m, enum aiTextureType type, scene__use_of_picture *out) {
    enum aiTextureMapping mapping = aiTextureMapping_UV;
    out->wrap[0] = out->wrap[1] = aiTextureMapMode_Wrap;
    out->set = 0;
    return aiGetMaterialTexture(m, type, 0, &out->name, &mapping, &out->set, NULL, NULL, out->wrap, NULL) ==
               aiReturn_SUCCESS && out->name.length;
}

/* Returns the axes along which sbl.h repeats a texture although the file mirrors or clamps it, as bits: 1: u, 2: v. */
static int scene__repeats_instead(const scene__use_of_picture *p) {
    int k, clamped = 1, axes = 0;
    for (k = 0; k < 2; k++) {
        clamped &= p->wrap[k] == aiTextureMapMode_Clamp;
        if (p->wrap[k] == aiTextureMapMode_Clamp || p->wrap[k] == aiTextureMapMode_Mirror) axes |= 1 << k;
    }
    return clamped ? 0 : axes;
}

static sbl_wrap scene__wrap_of(const scene__use_of_picture *p) {
    const int clamped = p->wrap[0] == aiTextureMapMode_Clamp && p->wrap[1] == aiTextureMapMode_Clamp;
    return clamped ? SBL_WRAP_CLAMP : SBL_WRAP_REPEAT;
}

static float scene__number(const struct aiMaterial *m, const char *key, unsigned type, unsigned index,
                           float otherwise) {
    ai_real value;
    return aiGetMaterialFloatArray(m, key, type, index, &value, NULL) == aiReturn_SUCCESS ? value : otherwise;
}

/* The name of a material, and the facts that scene_gltf.h has appended to it. */
typedef struct scene__told { char name[256]; int is_told, bits, number; float ior; } scene__told;

/* Splits a material name into the original name and the facts that scene__name_materials appended. */
static scene__told scene__told_by(const scene__reader *r, const struct aiMaterial *m) {
    struct aiString name;
    scene__told out;
    char *added, end = 0;
    memset(&out, 0, sizeof out);
    if (aiGetMaterialString(m, AI_MATKEY_NAME, &name) == aiReturn_SUCCESS)
        scene__print(out.name, sizeof out.name, "%s", name.data);
    added = r->is_gltf ? strrchr(out.name, '(') : NULL;
    out.is_told = added && sscanf(added, "(ior %f, %d, %d%c", &out.ior, &out.bits, &out.number, &end) == 4 &&
                  end == ')';
    if (out.is_told) added[added > out.name ? -1 : 0] = 0;
    return out;
}

#define SCENE__GREY 0.6f  /* albedo of surfaces whose file states no colour */

static int scene__has_vertex_colors(const struct aiScene *in) {
    unsigned i, found = 0;
    for (i = 0; i < in->mNumMeshes; i++) found |= in->mMeshes[i]->mColors[0] != NULL;
    return found != 0;
}

static void scene__colors(scene__reader *r, const struct aiMaterial *m, int has_albedo, sbl_material *out) {
    const float strength = scene__number(m, AI_MATKEY_EMISSIVE_INTENSITY, 1);
    struct aiColor4D color;
    float rgb[3];
    int clamped = 0, k;
    if (aiGetMaterialColor(m, AI_MATKEY_COLOR_DIFFUSE, &color) != aiReturn_SUCCESS &&
        aiGetMaterialColor(m, AI_MATKEY_BASE_COLOR, &color) != aiReturn_SUCCESS)
        color.r = color.g = color.b = has_albedo ? 1.0f : SCENE__GREY;
    if (r->is_bare && !has_albedo)
        color.r = color.g = color.b = scene__has_vertex_colors(r->in) ? 1.0f : SCENE__GREY;
    rgb[0] = color.r; rgb[1] = color.g; rgb[2] = color.b;
    for (k = 0; k < 3; k++) {
        if (rgb[k] < 0.0f || rgb[k] > 1.0f) { rgb[k] = rgb[k] < 0.0f ? 0.0f : 1.0f; clamped = 1; }
        out->albedo[k] = rgb[k];
    }
    if (clamped)
        scene__warn(r->file, "material %s: its colour is outside of 0 to 1 and was clamped", scene__told_by(r, m).name);
    if (aiGetMaterialColor(m, AI_MATKEY_COLOR_EMISSIVE, &color) != aiReturn_SUCCESS) color.r = color.g = color.b = 0;
    out->emission[0] = strength * color.r;
    out->emission[1] = strength * color.g;
    out->emission[2] = strength * color.b;
}

static int scene__illum(const struct aiMaterial *m) { return (int)scene__number(m, AI_MATKEY_OBJ_ILLUM, 0); }

/* Returns the transmission of the glass of an OBJ file, or 0 if the material is not glass. It is 1 - d if d is below 1,
   otherwise 0.9 if Ni is above 1. The condition on Ni is needed because Maya writes illum 4 with Ni 1 for every
   material. */
static float scene__glass(const struct aiMaterial *m) {
    const float opacity = scene__number(m, AI_MATKEY_OPACITY, 1);
    const int illum = scene__illum(m);
    if (illum != 4 && illum != 6 && illum != 7 && illum != 9) return 0;
    if (opacity < 1) return opacity > 0 ? 1 - opacity : 1;
    return scene__number(m, AI_MATKEY_REFRACTI, 0) > 1 ? 0.9f : 0;
}

/* The alpha of a material. */
typedef struct scene__alpha {
    float cutoff, opacity;  /* cutoff: 0 if there is none */
    int is_blended;         /* 1: the alpha is a coverage, unless the file is matte */
    int has_mask;
    scene__use_of_picture mask;
} scene__alpha;

/* Reads alphaMode and alpha of a glTF file, or the opacity in other formats. In matte files, a partly transparent
   surface is cut out where its alpha is below 0.5, and glass is opaque. */
static scene__alpha scene__alpha_of(const struct aiMaterial *m, int is_matte) {
    struct aiString mode;
    scene__alpha out;
    memset(&out, 0, sizeof out);
    out.opacity = scene__number(m, AI_MATKEY_OPACITY, 1);
    if (aiGetMaterialString(m, AI_MATKEY_GLTF_ALPHAMODE, &mode) == aiReturn_SUCCESS) {
        out.is_blended = strcmp(mode.data, "BLEND") == 0;
        if (strcmp(mode.data, "MASK") == 0) out.cutoff = scene__number(m, AI_MATKEY_GLTF_ALPHACUTOFF, 0.5f);
        else if (out.is_blended) out.cutoff = 0.5f;
        else out.opacity = 1;
    } else {
        if (!is_matte && scene__glass(m) > 0) out.opacity = 1;
        out.has_mask = scene__picture_of(m, aiTextureType_OPACITY, &out.mask);
        out.is_blended = out.opacity < 1;
        out.cutoff = out.has_mask || out.opacity < 0.5f ? 0.5f : 0;
    }
    if (out.is_blended && !is_matte) out.cutoff = 0;
    return out;
}

/* Returns 1 if a surface is invisible everywhere. Textures and vertex colours can only reduce its opacity further. */
static int scene__is_gone(const scene__alpha *a, int is_matte) {
    return a->cutoff > a->opacity || (a->is_blended && !is_matte && a->opacity <= 0);
}

/* ---- metal and gloss; scene_file.h describes the rule for a file at its top ---- */

static int scene__shading(const struct aiMaterial *m) {
    int shading = 0;
    aiGetMaterialIntegerArray(m, AI_MATKEY_SHADING_MODEL, &shading, NULL);
    return shading;
}

static void scene__make_matte(sbl_material *m) {
    m->ior = m->metallic = m->roughness = 0;
    m->specular_texture = 0;
}

/* Clamps a value to a range. Returns 1 if this changed it. */
static int scene__clamp(float *value, float low, float high) {
    const float before = *value;
    if (!(*value >= low)) *value = low;
    if (*value > high) *value = high;
    return !(*value >= before && *value <= before);
}

/* Converts the highlight of a format other than glTF. If the material has a roughness (Pr and Pm in OBJ), that is used.
   Otherwise the material is:

       matte   if it has no highlight: illum below 2 in OBJ, in other formats a shading model other than Phong, Blinn or
               Cook-Torrance; or if Ks is black
       metal   if illum is 3 or more, Ks above 0.5 in a component, and Kd below 0.05 in all; its colour is Ks
       glossy  in all other cases; its index of refraction is Ni if that is above 1, otherwise 1.5

   The roughness becomes (2 / (Ns + 2))^(1/4), because roughness^2 is the width of a microfacet lobe, and such a lobe
   resembles a Phong lobe with Ns = 2 / width^2 - 2 (Walter et al., Microfacet Models for Refraction, 2007). Glass is
   never metal. */
static void scene__phong_gloss(const struct aiMaterial *m, sbl_material *out) {
    const int shading = scene__shading(m);
    const int has_highlight = shading == aiShadingMode_Phong || shading == aiShadingMode_Blinn ||
                              shading == aiShadingMode_CookTorrance;
    const float illum = scene__number(m, AI_MATKEY_OBJ_ILLUM, has_highlight ? 2 : 1);
    const float roughness = scene__number(m, AI_MATKEY_ROUGHNESS_FACTOR, -1);
    const float exponent = scene__number(m, AI_MATKEY_SHININESS, 0), ior = scene__number(m, AI_MATKEY_REFRACTI, 0);
    struct aiColor4D color;
    float most = 0, *a = out->albedo;
    if (aiGetMaterialColor(m, AI_MATKEY_COLOR_SPECULAR, &color) == aiReturn_SUCCESS)
        most = fmaxf(color.r, fmaxf(color.g, color.b));
    if (roughness < 0 && (illum < 2 || !(most > 0))) return;
    out->ior = ior > 1 ? ior : (float)SCENE__IOR;
    out->roughness = roughness < 0 ? (float)pow(2 / (fmax((double)exponent, 0) + 2), 0.25) : roughness;
    if (roughness >= 0) out->metallic = scene__number(m, AI_MATKEY_METALLIC_FACTOR, 0);
    else if (illum > 2.5f && !(scene__glass(m) > 0) && most > 0.5f && fmaxf(a[0], fmaxf(a[1], a[2])) < 0.05f) {
        const float ks[3] = { color.r, color.g, color.b };
        int k;
        out->metallic = 1;
        for (k = 0; k < 3; k++) a[k] = fminf(fmaxf(ks[k], 0), 1);
    }
}

/* Converts the glass of an OBJ file to a thin pane. The fraction `passing` of the light is transmitted and tinted by
   Tf; the rest is reflected with the diffuse colour Kd. sbl.h has one colour for both, which becomes the sum of the
   two; `transmission` is the transmitted fraction of this sum. Tf is divided by its largest component, because programs
   disagree about its brightness; a black Tf counts as white. */
static void scene__glaze(const struct aiMaterial *m, float passing, sbl_material *out) {
    struct aiColor4D color;
    float filter[3] = { 1, 1, 1 }, most = 0, clear = 0, sum = 0;
    int k;
    if (aiGetMaterialColor(m, AI_MATKEY_COLOR_TRANSPARENT, &color) == aiReturn_SUCCESS) {
        filter[0] = color.r; filter[1] = color.g; filter[2] = color.b;
    }
    for (k = 0; k < 3; k++) if (filter[k] > most) most = filter[k];
    for (k = 0; k < 3; k++) {
        const float tint = passing * (most > 0 && most < 1e30f ? fmaxf(filter[k] / most, 0) : 1);
        out->albedo[k] = (1 - passing) * out->albedo[k] + tint;
        clear += tint;
        sum += out->albedo[k];
    }
    out->transmission = clear / sum;
}

/* Reads metal and gloss of a glTF material, except for their texture. */
static void scene__gltf_gloss(const struct aiMaterial *m, const scene__told *told, sbl_material *out) {
    const float glossiness = scene__number(m, AI_MATKEY_GLOSSINESS_FACTOR, -1);
    out->ior = told->ior;
    out->metallic = scene__number(m, AI_MATKEY_METALLIC_FACTOR, 1);
    out->roughness = scene__number(m, AI_MATKEY_ROUGHNESS_FACTOR, 1);
    if (glossiness < 0) return;
    /* KHR_materials_pbrSpecularGlossiness, without its gloss texture */
    out->metallic = 0;
    out->roughness = 1 - glossiness;
    if (aiGetMaterialTextureCount(m, aiTextureType_SPECULAR)) scene__make_matte(out);
}

/* Returns 1 if a glTF material has a texture of metalness and roughness. out: receives it */
static int scene__specular_picture(const scene__reader *r, const struct aiMaterial *m, scene__use_of_picture *out) {
    return r->is_gltf && scene__number(m, AI_MATKEY_GLOSSINESS_FACTOR, -1) < 0 &&
           (scene__picture_of(m, aiTextureType_DIFFUSE_ROUGHNESS, out) ||
            scene__picture_of(m, aiTextureType_UNKNOWN, out));
}

/* Reads metal, gloss and transmission of a material, except for their textures. Sets r->not_matte if it makes the file
   one that is not matte. The colours must have been read before. */
static void scene__gloss(scene__reader *r, const struct aiMaterial *m, sbl_material *out) {
    const float *a = out->albedo, *e = out->emission;
    scene__told told = scene__told_by(r, m);
    scene__use_of_picture picture;
    int has_picture = scene__specular_picture(r, m, &picture), states = 1, is_outside;
    if (r->file->matte || scene__shading(m) == aiShadingMode_NoShading) return;
    if (!(a[0] > 0 || a[1] > 0 || a[2] > 0) && (e[0] > 0 || e[1] > 0 || e[2] > 0)) return;
    if (!told.is_told) told.ior = scene__number(m, AI_MATKEY_REFRACTI, (float)SCENE__IOR);
    out->transmission = scene__number(m, AI_MATKEY_TRANSMISSION_FACTOR, 0);
    if (r->is_gltf) {
        scene__gltf_gloss(m, &told, out);
        /* without cJSON, factors with their default values count as missing */
        states = told.is_told ? (told.bits & SCENE__TOLD_GLOSS) != 0
                              : has_picture || out->metallic < 1 || out->roughness < 1;
    } else {
        scene__phong_gloss(m, out);
        if (scene__glass(m) > 0) scene__glaze(m, scene__glass(m), out);
    }
    is_outside = scene__clamp(&out->metallic, 0, 1) | scene__clamp(&out->roughness, 0, 1) |
                 scene__clamp(&out->transmission, 0, 1);
    if (out->ior > 0 || out->ior < 0) is_outside |= scene__clamp(&out->ior, 1, (float)SCENE__MOST_IOR);
    if (is_outside)
        scene__warn(r->file, "material %s: its metal, roughness, transmission or index of refraction is out of range "
                    "and was clamped", told.name);
    r->not_matte |= out->transmission > 0 ||
                    (states && (has_picture || out->metallic > 0 || (out->ior > 0 && out->roughness < 1)));
    if (!(out->ior > 0 || out->metallic > 0)) scene__make_matte(out);
}

/* Reads the scalar and colour factors of a material. After this has run for all materials, r->not_matte tells whether
   any is glossy, metallic or transmissive. */
static void scene__factors(scene__reader *r, unsigned index) {
    const struct aiMaterial *m = r->in->mMaterials[index];
    sbl_material *out = &r->materials[index];
    scene__use_of_picture picture;
    const int has_albedo = scene__picture_of(m, aiTextureType_DIFFUSE, &picture) ||
                           scene__picture_of(m, aiTextureType_BASE_COLOR, &picture);
    const scene__alpha alpha = scene__alpha_of(m, r->file->matte);
    struct aiString mode;
    scene__colors(r, m, has_albedo, out);
    if (scene__picture_of(m, aiTextureType_EMISSIVE, &picture) &&
        aiGetMaterialString(m, AI_MATKEY_GLTF_ALPHAMODE, &mode) != aiReturn_SUCCESS &&
        !(out->emission[0] != 0.0f || out->emission[1] != 0.0f || out->emission[2] != 0.0f))
        out->emission[0] = out->emission[1] = out->emission[2] = 1;
    if (!scene__is_gone(&alpha, r->file->matte)) scene__gloss(r, m, out);
}

/* Finds the normal map of a material and reads its scale. Returns 0 if the material has none or is shown without it:
   with options.matte, if it is unlit, or if the scale is 0, which would mean 1 in sbl.h. */
static int scene__normal_map(const scene__reader *r, const struct aiMaterial *m, scene__use_of_picture *picture,
                             sbl_material *out) {
    float scale;
    if (r->file->matte || scene__shading(m) == aiShadingMode_NoShading) return 0;
    if (!scene__picture_of(m, aiTextureType_NORMALS, picture) &&
        !scene__picture_of(m, aiTextureType_NORMAL_CAMERA, picture)) return 0;
    scale = scene__number(m, AI_MATKEY_GLTF_TEXTURE_SCALE(aiTextureType_NORMALS, 0), 1);
    if (scene__clamp(&scale, -SCENE__MOST_SCALE, SCENE__MOST_SCALE))
        scene__warn(r->file, "material %s: the factor of its normal map is outside of -%g to %g and was clamped",
                    scene__told_by(r, m).name, (double)SCENE__MOST_SCALE, (double)SCENE__MOST_SCALE);
    if (!(scale > 0 || scale < 0)) return 0;
    out->normal_scale = scale;
    return 1;
}

/* Reads the textures that have no alpha. Where a texture cannot be read, the surface does not emit, is matte, is opaque
   or is smooth. A grey normal map is refused, because it holds heights: the OBJ reader of Blender takes them for
   normals. */
static void scene__plain_textures(scene__reader *r, const scene__use_of_picture *all, const int *has,
                                  sbl_material *out) {
    int *numbers[SCENE__PICTURES], i;
    numbers[SCENE__EMISSION] = &out->emission_texture;
    numbers[SCENE__SPECULAR] = &out->specular_texture;
    numbers[SCENE__TRANSMISSION] = &out->transmission_texture;
    numbers[SCENE__NORMAL] = &out->normal_texture;
    for (i = SCENE__EMISSION; i <= SCENE__NORMAL; i++)
        if (has[i])
            *numbers[i] = scene__texture(&r->pictures, all[i].name.data, NULL, scene__wrap_of(&all[i]),
                                         i != SCENE__EMISSION);
    if (has[SCENE__EMISSION] && !out->emission_texture)
        out->emission[0] = out->emission[1] = out->emission[2] = 0;
    if (has[SCENE__SPECULAR] && !out->specular_texture) scene__make_matte(out);
    if (has[SCENE__TRANSMISSION] && !out->transmission_texture) out->transmission = 0;
    if (out->normal_texture && scene__is_grey(&r->pictures.textures[out->normal_texture - 1])) {
        scene__warn(r->file, "texture %s is grey, so it is not a normal map; its material is shown without it",
                    all[SCENE__NORMAL].name.data);
        out->normal_texture = 0;
    }
    if (!out->normal_texture) out->normal_scale = 0;
}

/* Returns the transforms of the texture coordinates of a material, one per texture, or NULL. */
static const scene__transform *scene__moves_of(const scene__reader *r, const scene__told *told) {
    const scene__defined *defined = r->is_obj ? scene__find_defined(&r->mtl, told->name) : NULL;
    const int is_known = told->is_told && told->number >= 0 && told->number < r->taken.material_count;
    if (defined) return defined->moves;
    return is_known ? r->taken.transforms + SCENE__PICTURES * told->number : NULL;
}

/* Chooses the set of texture coordinates of a material and their transform: those of its first texture. Warns if others
   have other ones. has: 1 for each texture that the material has */
static void scene__choose_texcoords(scene__reader *r, unsigned index, const scene__use_of_picture *all,
                                    const int *has) {
    static const char *const words[SCENE__PICTURES] = { "colour", "emission", "metal", "transmission", "normals",
        "mask" };
    static const scene__transform none = { { 1, 0, 0, 0, 1, 0 } };
    const scene__told told = scene__told_by(r, r->in->mMaterials[index]);
    const scene__transform *own = scene__moves_of(r, &told);
    int i, first = 0, differs = 0;
    while (first < SCENE__PICTURES && !has[first]) first++;
    r->uv_set[index] = first < SCENE__PICTURES ? all[first].set : 0;
    if (own && first < SCENE__PICTURES && memcmp(&own[first], &none, sizeof none) != 0) r->moves[index] = &own[first];
    for (i = first; i < SCENE__PICTURES; i++)
        if (has[i]) r->repeated[index] |= (char)scene__repeats_instead(&all[i]);
    for (i = first; i < SCENE__PICTURES; i++)
        differs |= has[i] && (all[i].set != all[first].set || (own && memcmp(&own[i], &own[first], sizeof *own) != 0));
    if (differs)
        scene__warn(r->file, "material %s: its textures use different texture coordinates; those of its %s are used "
                    "for all", told.name, words[first]);
}

/* Reads the alpha and the textures of a material. */
static void scene__material(scene__reader *r, unsigned index) {
    const struct aiMaterial *m = r->in->mMaterials[index];
    sbl_material *out = &r->materials[index];
    scene__alpha alpha = scene__alpha_of(m, !r->not_matte);
    scene__use_of_picture all[SCENE__PICTURES];
    int has[SCENE__PICTURES];
    r->opacity[index] = 1;
    r->left_out[index] = scene__is_gone(&alpha, !r->not_matte);
    if (r->left_out[index]) return;
    if (alpha.is_blended && r->not_matte) {
        out->flags |= SBL_MATERIAL_BLEND;
        r->opacity[index] = alpha.opacity;
    }
    has[SCENE__ALBEDO] = scene__picture_of(m, aiTextureType_DIFFUSE, &all[SCENE__ALBEDO]) ||
                         scene__picture_of(m, aiTextureType_BASE_COLOR, &all[SCENE__ALBEDO]);
    has[SCENE__EMISSION] = scene__picture_of(m, aiTextureType_EMISSIVE, &all[SCENE__EMISSION]);
    has[SCENE__SPECULAR] = (out->ior > 0 || out->metallic > 0) &&
                           scene__specular_picture(r, m, &all[SCENE__SPECULAR]);
    has[SCENE__TRANSMISSION] = out->transmission > 0 &&
                               scene__picture_of(m, aiTextureType_TRANSMISSION, &all[SCENE__TRANSMISSION]);
    has[SCENE__NORMAL] = scene__normal_map(r, m, &all[SCENE__NORMAL], out);
    has[SCENE__MASK] = alpha.has_mask;
    all[SCENE__MASK] = alpha.mask;
    out->alpha_cutoff = alpha.cutoff > 0.0f ? alpha.cutoff / alpha.opacity : 0.0f;
    scene__choose_texcoords(r, index, all, has);
    if (has[SCENE__ALBEDO] || alpha.has_mask)
        out->albedo_texture = scene__texture(&r->pictures, has[SCENE__ALBEDO] ? all[SCENE__ALBEDO].name.data : NULL,
                                             alpha.has_mask ? alpha.mask.name.data : NULL,
                                             scene__wrap_of(has[SCENE__ALBEDO] ? &all[SCENE__ALBEDO] : &alpha.mask), 0);
    scene__plain_textures(r, all, has, out);
}

/* ---- warnings about simplified features; see SCENE_FILE_KINDS ---- */

/* Returns 1 if a surface has a visible highlight: its roughness is below 0.5; or, for a Phong exponent, the exponent is
   above 30 and a component of the specular colour is above 0.05. By roughness^4 = 2 / (exponent + 2), an exponent of 30
   means a roughness of 0.5. */
static int scene__is_glossy(const struct aiMaterial *m) {
    const float exponent = scene__number(m, AI_MATKEY_SHININESS, 0);
    const float roughness = scene__number(m, AI_MATKEY_ROUGHNESS_FACTOR, -1);
    const float glossiness = scene__number(m, AI_MATKEY_GLOSSINESS_FACTOR, -1);
    struct aiColor4D color;
    if (glossiness >= 0) return glossiness > 0.5f;
    if (roughness >= 0) return roughness < 0.5f;
    return exponent > 30 && aiGetMaterialColor(m, AI_MATKEY_COLOR_SPECULAR, &color) == aiReturn_SUCCESS &&
           (color.r > 0.05f || color.g > 0.05f || color.b > 0.05f);
}

/* Returns 1 if the material has a texture of one of these types. */
static int scene__has_picture(const struct aiMaterial *m, const enum aiTextureType *types, size_t count) {
    size_t i;
    for (i = 0; i < count; i++) if (aiGetMaterialTextureCount(m, types[i])) return 1;
    return 0;
}

/* Returns 1 if partial transparency of the material becomes a cutout. */
static int scene__is_cut(const scene__reader *r, unsigned index) {
    const struct aiMaterial *m = r->in->mMaterials[index];
    const int texture = r->materials[index].albedo_texture;
    const float opacity = scene__number(m, AI_MATKEY_OPACITY, 1);
    struct aiString mode;
    if (r->not_matte) return 0;
    if (aiGetMaterialString(m, AI_MATKEY_GLTF_ALPHAMODE, &mode) != aiReturn_SUCCESS) return opacity < 1;
    return strcmp(mode.data, "BLEND") == 0 &&
           (opacity < 1 || (texture && r->pictures.textures[texture - 1].channels % 2 == 0));
}

/* Counts the features of a material that --materials matte simplifies. */
static void scene__count_matte(const scene__reader *r, const struct aiMaterial *m) {
    static const enum aiTextureType maps[] = { aiTextureType_SPECULAR, aiTextureType_SHININESS, aiTextureType_METALNESS,
        aiTextureType_DIFFUSE_ROUGHNESS, aiTextureType_UNKNOWN /* holds metalness and roughness in glTF */,
        aiTextureType_REFLECTION };
    static const enum aiTextureType normals[] = { aiTextureType_NORMALS, aiTextureType_NORMAL_CAMERA };
    const int mapped = scene__has_picture(m, maps, sizeof maps / sizeof *maps);
    const int is_metal = scene__number(m, AI_MATKEY_METALLIC_FACTOR, 0) > 0 &&
                         scene__number(m, AI_MATKEY_GLOSSINESS_FACTOR, -1) < 0;
    if (mapped) scene__count(r->file, SCENE_FILE_TEXTURE);
    if (is_metal && !mapped) scene__count(r->file, SCENE_FILE_METAL);
    else if (scene__number(m, AI_MATKEY_OBJ_ILLUM, 0) > 2.5f) scene__count(r->file, SCENE_FILE_ILLUM);
    else if (scene__is_glossy(m)) scene__count(r->file, SCENE_FILE_GLOSS);
    if (scene__number(m, AI_MATKEY_TRANSMISSION_FACTOR, 0) > 0) scene__count(r->file, SCENE_FILE_GLASS);
    if (scene__has_picture(m, normals, sizeof normals / sizeof *normals)) scene__count(r->file, SCENE_FILE_NORMAL_MAP);
}

/* Counts a material for the warnings MAP (it has textures of metal or gloss that are not read) and REFRACTION (the file
   describes a solid body, which is shown as a thin pane). */
static void scene__count_gloss(const scene__reader *r, unsigned index) {
    static const enum aiTextureType maps[] = { aiTextureType_SPECULAR, aiTextureType_SHININESS,
        aiTextureType_REFLECTION, aiTextureType_METALNESS, aiTextureType_DIFFUSE_ROUGHNESS, aiTextureType_UNKNOWN };
    const struct aiMaterial *m = r->in->mMaterials[index];
    const int refracts = scene__number(m, AI_MATKEY_VOLUME_THICKNESS_FACTOR, 0) > 0 || scene__illum(m) == 6 ||
                         scene__illum(m) == 7;
    if (scene__has_picture(m, maps, r->is_gltf ? 3 : 6)) scene__count(r->file, SCENE_FILE_MAP);
    if (r->materials[index].transmission > 0 && refracts) scene__count(r->file, SCENE_FILE_REFRACTION);
}

/* Counts the features of a used material that sbl.h does not support. */
static void scene__count_material(const scene__reader *r, unsigned index) {
    static const enum aiTextureType heights[] = { aiTextureType_HEIGHT, aiTextureType_DISPLACEMENT };
    const struct aiMaterial *m = r->in->mMaterials[index];
    const scene__told told = scene__told_by(r, m);
    struct aiColor4D sheen;
    struct aiString name;
    if (r->is_gltf && index + 1 == r->in->mNumMaterials &&  /* assimp's default material */
        aiGetMaterialString(m, AI_MATKEY_NAME, &name) != aiReturn_SUCCESS) return;
    if (scene__is_cut(r, index)) scene__count(r->file, SCENE_FILE_BLEND);
    if (told.bits & SCENE__TOLD_OTHER) scene__count(r->file, SCENE_FILE_EXTENSION);
    if (scene__shading(m) == aiShadingMode_NoShading) {
        scene__count(r->file, SCENE_FILE_UNLIT);
        return;
    }
    if (r->file->matte) scene__count_matte(r, m);
    else scene__count_gloss(r, index);
    if (scene__has_picture(m, heights, sizeof heights / sizeof *heights)) scene__count(r->file, SCENE_FILE_HEIGHT);
    if (scene__number(m, AI_MATKEY_CLEARCOAT_FACTOR, 0) > 0) scene__count(r->file, SCENE_FILE_COAT);
    if (aiGetMaterialColor(m, AI_MATKEY_SHEEN_COLOR_FACTOR, &sheen) == aiReturn_SUCCESS &&
        (sheen.r > 0 || sheen.g > 0 || sheen.b > 0))
        scene__count(r->file, SCENE_FILE_SHEEN);
    if (told.bits & SCENE__TOLD_ANISOTROPY) scene__count(r->file, SCENE_FILE_ANISOTROPY);
    if ((told.bits & SCENE__TOLD_SPECULAR) && r->materials[index].ior > 0) scene__count(r->file, SCENE_FILE_SPECULAR);
}

/* Warns of used materials that no .mtl file defines. */
static void scene__warn_of_undefined(const scene__reader *r) {
    const int is_colored = r->is_bare && scene__has_vertex_colors(r->in);
    char first[128] = "";
    unsigned i, count = 0;
    for (i = 0; i < r->in->mNumMaterials && r->is_obj && !r->lacks_mtl && !is_colored; i++) {
        const scene__told told = scene__told_by(r, r->in->mMaterials[i]);
        if (!r->shown[i] || strcmp(told.name, AI_DEFAULT_MATERIAL_NAME) == 0) continue;
        if (scene__find_defined(&r->mtl, told.name)) continue;
        if (!count++) scene__print(first, sizeof first, "%s", told.name);
    }
    if (count == 1) scene__warn(r->file, "no .mtl file defines the material %s: its surfaces are grey", first);
    else if (count)
        scene__warn(r->file, "no .mtl file defines %u of the materials, such as %s: their surfaces are grey", count,
                    first);
}

/* Counts the features of the scene that sbl.h does not support. Called after the meshes are placed. */
static void scene__count_all(const scene__reader *r) {
    unsigned i;
    scene__warn_of_undefined(r);
    for (i = 0; i < r->in->mNumCameras && !r->file->has_camera; i++)
        if (r->in->mCameras[i]->mOrthographicWidth != 0.0f) scene__count(r->file, SCENE_FILE_CAMERA);
    for (i = 0; i < r->in->mNumMaterials; i++) if (r->shown[i]) scene__count_material(r, i);
    for (i = 0; i < r->in->mNumAnimations; i++)
        if (!scene__motion_has_all(&r->motion, r->in->mAnimations[i])) scene__count(r->file, SCENE_FILE_ANIMATION);
    for (i = 0; i < r->in->mNumMeshes; i++) {
        if (r->posed[i]) scene__count(r->file, SCENE_FILE_POSE);
        if (!(r->in->mMeshes[i]->mPrimitiveTypes & (aiPrimitiveType_TRIANGLE | aiPrimitiveType_POLYGON)))
            scene__count(r->file, SCENE_FILE_LINES);
    }
}

/* ---- meshes ---- */

/* Multiplies two matrices, both row-major as in assimp. */
static void scene__multiply(double out[16], const double a[16], const struct aiMatrix4x4 *b) {
    const double right[16] = { b->a1, b->a2, b->a3, b->a4, b->b1, b->b2, b->b3, b->b4,
                               b->c1, b->c2, b->c3, b->c4, b->d1, b->d2, b->d3, b->d4 };
    int i, j, k;
    for (i = 0; i < 4; i++)
        for (j = 0; j < 4; j++) {
            out[4 * i + j] = 0;
            for (k = 0; k < 4; k++) out[4 * i + j] += a[4 * i + k] * right[4 * k + j];
        }
}

/* Returns an array of `components` floats per vertex, or NULL if memory runs out. step: floats per vertex in `from` */
static float *scene__vectors(scene_file *file, const ai_real *from, unsigned count, unsigned components,
                             unsigned step) {
    float *out = (float *)scene__alloc(file, count, components * sizeof *out), *to = out;
    unsigned i, k;
    for (i = 0; out && i < count; i++, from += step)
        for (k = 0; k < components; k++) *to++ = (float)from[k];
    return out;
}

/* Returns a set of texture coordinates, or NULL. It flips v, because assimp has v = 0 at the bottom, also for glTF.
   move: NULL, or a transform that is then applied */
static float *scene__texcoords(scene__reader *r, const struct aiMesh *in, unsigned set, const scene__transform *move) {
    const unsigned count = in->mNumVertices;
    float *v = in->mTextureCoords[set] ? scene__vectors(r->file, &in->mTextureCoords[set]->x, count, 2, 3) : NULL, *uv;
    size_t i;
    for (i = 0; v && i < count; i++) {
        const float x = v[2 * i], y = 1 - v[2 * i + 1];
        uv = v + 2 * i;
        uv[0] = move ? move->m[0] * x + move->m[1] * y + move->m[2] : x;
        uv[1] = move ? move->m[3] * x + move->m[4] * y + move->m[5] : y;
    }
    return v;
}

/* Returns 1 if vertex colours have an alpha. assimp returns 0 for all vertices if a .gltf has only red, green and
   blue. */
static int scene__has_alpha(const struct aiMesh *in) {
    unsigned i;
    for (i = 0; in->mColors[0] && i < in->mNumVertices; i++) if (in->mColors[0][i].a != 0.0f) return 1;
    return 0;
}

/* Returns the vertex colours of a mesh, or NULL if none are needed. Their alpha includes the opacity of the material,
   because sbl_material has no factor for alpha. This is exact with and without a texture, and needs no copy of a
   picture. */
static float *scene__vertex_colors(scene__reader *r, const struct aiMesh *in, float opacity) {
    const size_t count = in->mNumVertices;
    const int has_alpha = scene__has_alpha(in);
    float *v;
    size_t i;
    if (!in->mColors[0] && !(opacity < 1)) return NULL;
    v = in->mColors[0] ? scene__vectors(r->file, &in->mColors[0]->r, in->mNumVertices, 4, 4)
                       : (float *)scene__alloc(r->file, count, 4 * sizeof *v);
    for (i = 0; v && i < 4 * count; i++) {
        if (!in->mColors[0] || (i % 4 == 3 && !has_alpha)) v[i] = 1;
        if (i % 4 == 3) v[i] *= opacity;
        if (v[i] < 0.0f) v[i] = 0;
        if (v[i] > 1.0f) v[i] = 1;
    }
    return v;
}

/* Counts a mesh whose texture is repeated although the file mirrors or clamps it, if its coordinates leave the range 0
   to 1 along these axes. axes: see scene__repeats_instead */
static void scene__count_repeats(scene_file *file, const float *texcoords, int count, int axes) {
    int i, k, leaves = 0;
    for (i = 0; i < count && texcoords && !leaves; i++)
        for (k = 0; k < 2; k++)
            leaves |= (axes >> k & 1) && (texcoords[2 * i + k] < -0.001f || texcoords[2 * i + k] > 1.001f);
    if (leaves) scene__count(file, SCENE_FILE_WRAP);
}

static int scene__has_texture(const sbl_material *m) {
    return m->albedo_texture || m->emission_texture || m->specular_texture || m->transmission_texture ||
           m->normal_texture;
}

static void scene__attributes(scene__reader *r, const struct aiMesh *in, sbl_mesh *out) {
    const int has_material = in->mMaterialIndex < r->in->mNumMaterials;
    const unsigned set_of = has_material ? r->uv_set[in->mMaterialIndex] : 0;
    const unsigned set = set_of < AI_MAX_NUMBER_OF_TEXTURECOORDS ? set_of : 0, count = in->mNumVertices;
    const scene__transform *move = has_material ? r->moves[in->mMaterialIndex] : NULL;
    out->positions.data = scene__vectors(r->file, &in->mVertices->x, count, 3, 3);
    if (in->mNormals) out->normals.data = scene__vectors(r->file, &in->mNormals->x, count, 3, 3);
    out->texcoords.data = scene__texcoords(r, in, set, move);
    out->lightmap_texcoords.data = set == 1 && !move ? out->texcoords.data : scene__texcoords(r, in, 1, NULL);
    if (has_material && r->repeated[in->mMaterialIndex])
        scene__count_repeats(r->file, (const float *)out->texcoords.data, (int)count, r->repeated[in->mMaterialIndex]);
    if (has_material && !out->texcoords.data && scene__has_texture(&r->materials[in->mMaterialIndex]))
        scene__count(r->file, SCENE_FILE_UNMAPPED);
    out->colors.data = scene__vertex_colors(r, in, has_material ? r->opacity[in->mMaterialIndex] : 1);
}

/* Converts the arrays of a mesh. If the mesh has no triangles, vertex_count stays 0. */
static void scene__mesh(scene__reader *r, const struct aiMesh *in, sbl_mesh *out) {
    unsigned i, triangles = 0;
    uint32_t *indices;
    for (i = 0; i < in->mNumFaces; i++) triangles += in->mFaces[i].mNumIndices == 3;
    if (!triangles || !in->mVertices) return;
    if (in->mNumVertices > INT32_MAX / 3 || triangles > INT32_MAX / 3) {
        scene__fail(r->file, "mesh %s has too many triangles", in->mName.data);
        return;
    }
    indices = (uint32_t *)scene__alloc(r->file, triangles, 3 * sizeof *indices);
    if (!indices) return;
    out->indices.data = indices;
    out->indices.type = SBL_UINT32;
    out->index_count = (int)(3 * triangles);
    out->vertex_count = (int)in->mNumVertices;
    for (i = 0; i < in->mNumFaces; i++)
        if (in->mFaces[i].mNumIndices == 3) {
            memcpy(indices, in->mFaces[i].mIndices, 3 * sizeof *indices);
            indices += 3;
        }
    scene__attributes(r, in, out);
}

/* Counts the triangles of a .gltf that assimp has dropped, because they lack a corner; see scene__name_meshes. Meshes
   that no node of the scene uses are not read. */
static void scene__count_lost(const scene__reader *r) {
    const scene__taken *t = &r->taken;
    double lost = 0;
    unsigned i, k;
    int number;
    char *is_read = (char *)calloc((size_t)t->mesh_count + 1, 1);
    if (!is_read) { scene__fail_for_memory(r->file, "it"); return; }
    for (i = 0; i < r->in->mNumMeshes && t->triangles; i++) {
        const struct aiMesh *in = r->in->mMeshes[i];
        if (sscanf(in->mName.data, "(mesh %d)", &number) != 1 || number < 0 || number >= t->mesh_count) continue;
        is_read[number] = 1;
        for (k = 0; k < in->mNumFaces; k++) t->triangles[number] -= in->mFaces[k].mNumIndices == 3;
    }
    for (number = 0; number < t->mesh_count; number++)
        if (is_read[number] && t->triangles[number] > 0) lost += t->triangles[number];
    r->file->simplified[SCENE_FILE_CORNERS] = (int)fmin(lost, INT32_MAX);
    free(is_read);
}

/* ---- cameras and lights ---- */

static void scene__direction(float out[3], const double m[16], const struct aiVector3D *v) {
    int i;
    for (i = 0; i < 3; i++) out[i] = (float)(m[4 * i] * v->x + m[4 * i + 1] * v->y + m[4 * i + 2] * v->z);
}

/* Converts a camera. m: transform of its node */
static void scene__camera(scene_file_camera *c, const struct aiCamera *in, const double m[16], int is_gltf) {
    const double degrees = 45 / atan(1.0);
    double x = 0.5 * in->mHorizontalFOV;
    int i;
    memset(c->eye, 0, sizeof c->eye);
    /* for glTF, mPosition repeats the translation of the node */
    if (!is_gltf) scene__direction(c->eye, m, &in->mPosition);
    for (i = 0; i < 3; i++) c->eye[i] += (float)m[4 * i + 3];
    scene__direction(c->forward, m, &in->mLookAt);
    scene__direction(c->up, m, &in->mUp);
    c->fov_x = c->fov_y = 0;
    if (is_gltf) c->fov_y = (float)(2 * x * degrees);  /* the full vertical angle; see scene_gltf.h */
    else if (in->mAspect > 0) c->fov_y = (float)(2 * atan(tan(x) / in->mAspect) * degrees);
    else c->fov_x = (float)(2 * x * degrees);
}

/* Computes the camera of each frame that the options ask for. */
static void scene__frames(scene__reader *r) {
    static const double identity[16] = { 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1 };
    scene_file *file = r->file;
    scene_file_camera *frames = NULL;
    double m[2][16];
    size_t count, k;
    int i;
    if (scene__motion_begin(&r->motion, file, r->in, r->is_gltf ? r->camera_node : NULL))
        frames = (scene_file_camera *)scene__alloc(file, (size_t)file->frames_asked, sizeof *frames);
    count = r->motion.count;
    for (i = 0; frames && i < file->frames_asked; i++) {
        memcpy(m[count % 2], identity, sizeof identity);
        for (k = count; k-- > 0;) {
            struct aiMatrix4x4 local;
            scene__motion_pose(&r->motion.links[k], i / file->frame_rate, 1 / file->frame_rate, &local);
            scene__multiply(m[k % 2], m[(k + 1) % 2], &local);
        }
        scene__camera(&frames[i], r->in->mCameras[r->best_camera], m[0], r->is_gltf);
    }
    file->frames = frames;
    file->frame_count = frames ? file->frames_asked : 0;
}

static int scene__by_name(const void *a, const void *b) {
    const struct aiLight *first = ((const struct scene__lamp *)a)->light;
    const struct aiLight *second = ((const struct scene__lamp *)b)->light;
    return strcmp(first->mName.data, second->mName.data);
}

/* The functions scene__aim and scene__open_cone return NULL, or a description of the error. */
static const char *scene__aim(const struct aiVector3D *d, const double m[16], sbl_light *out) {
    double direction[3], length = 0;
    int i;
    for (i = 0; i < 3; i++) {
        direction[i] = m[4 * i] * (double)d->x + m[4 * i + 1] * (double)d->y + m[4 * i + 2] * (double)d->z;
        length += direction[i] * direction[i];
    }
    for (i = 0; i < 3; i++) out->direction[i] = (float)(direction[i] / sqrt(length));
    return length > 0 && length < 1e300 ? NULL : "it has no direction";
}
static const char *scene__open_cone(scene_file *file, const struct aiLight *in, int is_gltf, sbl_light *out) {
    const double cone = (is_gltf ? 2 : 1) * 45 / atan(1.0);  /* glTF measures angles from the axis */
    out->cone = (float)(cone * (double)in->mAngleOuterCone);
    out->inner_cone = (float)(cone * (double)in->mAngleInnerCone);
    if (!(out->cone > 0 && out->inner_cone >= 0)) return "its cone is empty";
    if (out->cone > 180.001f)
        scene__warn(file, "light %s: its cone is wider than 180 degrees and was narrowed", in->mName.data);
    if (out->cone > 180) out->cone = 180;
    if (out->inner_cone > out->cone) out->inner_cone = out->cone;
    return NULL;
}

/* Converts a light. Returns 0 and adds a warning if that is not possible. */
static int scene__light(scene_file *file, const struct aiLight *in, const double m[16], int is_gltf, sbl_light *out) {
    const float color[3] = { in->mColorDiffuse.r, in->mColorDiffuse.g, in->mColorDiffuse.b };
    const char *wrong = NULL;
    int i;
    memset(out, 0, sizeof *out);
    if (in->mType == aiLightSource_POINT) out->kind = SBL_LIGHT_POINT;
    else if (in->mType == aiLightSource_SPOT) out->kind = SBL_LIGHT_SPOT;
    else if (in->mType == aiLightSource_DIRECTIONAL) out->kind = SBL_LIGHT_DIRECTIONAL;
    else if (in->mType == aiLightSource_AREA || in->mType == aiLightSource_AMBIENT) {
        scene__count(file, SCENE_FILE_AREA);
        return 0;
    } else wrong = "it is not a point, spot or directional light";
    scene__direction(out->position, m, &in->mPosition);
    for (i = 0; i < 3; i++) {
        out->intensity[i] = color[i];
        if (!(color[i] >= 0 && color[i] < 1e30f)) wrong = "its intensity is negative or not a number";
        out->position[i] += (float)m[4 * i + 3];
        if (!(fabsf(out->position[i]) < 1e18f)) wrong = "its position is out of range";
    }
    if (!wrong && out->kind != SBL_LIGHT_POINT) wrong = scene__aim(&in->mDirection, m, out);
    if (!wrong && out->kind == SBL_LIGHT_SPOT) wrong = scene__open_cone(file, in, is_gltf, out);
    if (wrong) scene__warn(file, "light %s: %s; it was left out", in->mName.data, wrong);
    return !wrong;
}

static int scene__has_range(const struct aiNode *node) {
    const struct aiMetadata *m = node->mMetaData;
    unsigned i;
    for (i = 0; m && i < m->mNumProperties; i++) if (strcmp(m->mKeys[i].data, "PBR_LightRange") == 0) return 1;
    return 0;
}

/* Copies a text into the shared pages. */
static const char *scene__copy_text(scene_file *file, const char *text) {
    char *copy = (char *)scene__alloc(file, strlen(text) + 1, 1);
    return copy ? strcpy(copy, text) : "";
}

/* Adds the lights of a node: those that have its name and belong to no earlier node. */
static void scene__lights(scene__reader *r, const struct aiNode *node, const double m[16]) {
    sbl_scene_desc *scene = &r->file->scene;
    unsigned low = 0, high = r->in->mNumLights;
    while (low < high) {
        unsigned middle = low + (high - low) / 2;
        if (strcmp(r->lamps[middle].light->mName.data, node->mName.data) < 0) low = middle + 1;
        else high = middle;
    }
    for (; low < r->in->mNumLights; low++) {
        struct scene__lamp *lamp = &r->lamps[low];
        if (lamp->placed || strcmp(lamp->light->mName.data, node->mName.data) != 0) break;
        lamp->placed = 1;
        if (scene__has_range(node)) scene__count(r->file, SCENE_FILE_RANGE);
        if (!scene__light(r->file, lamp->light, m, r->is_gltf, &r->lights[scene->light_count])) continue;
        r->light_names[scene->light_count++] = scene__copy_text(r->file, node->mName.data);
    }
}

/* ---- nodes ---- */

typedef struct scene__node { const struct aiNode *node; double transform[16]; } scene__node;

/* Visits all nodes in depth-first order. It uses a list instead of recursion, so that a chain of a million nodes cannot
   overflow the stack. */
static void scene__walk(scene__reader *r, void (*visit)(scene__reader *r, const scene__node *at)) {
    const double scaled[16] = { r->unit, 0, 0, 0, 0, r->unit, 0, 0, 0, 0, r->unit, 0, 0, 0, 0, 1 };
    size_t room = 64, count = 1;
    unsigned i;
    scene__node *list = (scene__node *)malloc(room * sizeof *list);
    if (!list) { scene__fail_for_memory(r->file, "it"); return; }
    list[0].node = r->in->mRootNode;
    scene__multiply(list[0].transform, scaled, &r->in->mRootNode->mTransformation);
    while (count && !r->file->error[0]) {
        const scene__node at = list[--count];
        visit(r, &at);
        if (count + at.node->mNumChildren > room) {
            scene__node *larger;
            while (room < count + at.node->mNumChildren) room *= 2;
            larger = (scene__node *)realloc(list, room * sizeof *list);
            if (!larger) { scene__fail_for_memory(r->file, "it"); break; }
            list = larger;
        }
        for (i = at.node->mNumChildren; i-- > 0; count++) {
            list[count].node = at.node->mChildren[i];
            scene__multiply(list[count].transform, at.transform, &at.node->mChildren[i]->mTransformation);
        }
    }
    free(list);
}

/* Returns 1 if a scale of 0 makes the meshes of a node flat, which sbl_mesh.transform does not allow. */
static int scene__is_flat(const scene__node *at) {
    float m[12];
    double determinant = 0;
    int i;
    for (i = 0; i < 12; i++) m[i] = (float)at->transform[i];
    for (i = 0; i < 3; i++)
        determinant += (double)m[i] * ((double)m[4 + (i + 1) % 3] * (double)m[8 + (i + 2) % 3] -
                                       (double)m[4 + (i + 2) % 3] * (double)m[8 + (i + 1) % 3]);
    return determinant == 0.0;
}

/* Returns the mesh with the index `i` in a node, and its material. Returns NULL if the mesh has no triangles or the
   node is flat. The mesh is omitted if r->left_out says so of its material. */
static const sbl_mesh *scene__used(const scene__reader *r, const scene__node *at, unsigned i, unsigned *material) {
    const unsigned number = at->node->mMeshes[i];
    if (scene__is_flat(at)) return NULL;
    if (number >= r->in->mNumMeshes || !r->shared[number].vertex_count) return NULL;
    *material = r->in->mMeshes[number]->mMaterialIndex;
    if (*material >= r->in->mNumMaterials) *material = 0;
    return &r->shared[number];
}

/* Counts a use of a mesh that is omitted, and its material once. A glTF material with an opacity of 0 is meant to be
   invisible, but in OBJ it may be a mistake: some programs write d 0 or Tr 1 for opaque surfaces. */
static void scene__count_left_out(scene__reader *r, unsigned material) {
    const float opacity = scene__alpha_of(r->in->mMaterials[material], !r->not_matte).opacity;
    r->left_out_uses++;
    if (r->left_out[material]++ == 1 && (opacity > 0 || !r->is_gltf)) scene__count(r->file, SCENE_FILE_GONE);
}

static void scene__count_uses(scene__reader *r, const scene__node *at) {
    unsigned i, material;
    if (at->node->mNumMeshes && scene__is_flat(at)) scene__count(r->file, SCENE_FILE_FLAT);
    for (i = 0; i < at->node->mNumMeshes; i++) {
        const sbl_mesh *mesh = scene__used(r, at, i, &material);
        const struct aiMesh *in = mesh ? r->in->mMeshes[at->node->mMeshes[i]] : NULL;
        if (!mesh) continue;
        if (r->left_out[material]) { scene__count_left_out(r, material); continue; }
        r->use_count++;
        r->shown[material] = 1;
        r->posed[at->node->mMeshes[i]] = in->mNumBones > 0 || in->mNumAnimMeshes > 0;
        r->triangles += mesh->index_count / 3;
        r->vertices += mesh->vertex_count;
    }
}

/* Reads the lightmap placement that scene__name_places has put before the name of a node. Returns the original name. */
static const char *scene__place_of(const scene__reader *r, const char *name, scene_file_place *out, int *map) {
    static const scene_file_place none = { -1, { 1, 1 }, { 0, 0 } };
    int length = 0;
    *map = 0;
    *out = none;
    if (r->is_gltf && sscanf(name, "(node %d, map %d, %f %f %f %f) %n", &out->node, map, &out->scale[0], &out->scale[1],
                             &out->offset[0], &out->offset[1], &length) == 6 && length && *map >= 0 &&
        *map < SCENE__MOST_MAPS && isfinite(out->scale[0] + out->scale[1] + out->offset[0] + out->offset[1]))
        return name + length;
    *map = 0;
    *out = none;
    return name;
}

/* Applies scale and offset to the lightmap coordinates of one use of a mesh, in a copy if needed. */
static void scene__put_place(scene__reader *r, const scene_file_place *place, sbl_mesh *use) {
    const float *from = (const float *)use->lightmap_texcoords.data;
    const int moves = place->scale[0] < 1 || place->scale[0] > 1 || place->scale[1] < 1 || place->scale[1] > 1 ||
                      place->offset[0] != 0.0f || place->offset[1] != 0.0f;
    float *out;
    int i, k;
    if (!from || !moves) return;
    out = (float *)scene__alloc(r->file, (size_t)use->vertex_count, 2 * sizeof *out);
    for (i = 0; out && i < use->vertex_count; i++)
        for (k = 0; k < 2; k++) out[2 * i + k] = place->scale[k] * from[2 * i + k] + place->offset[k];
    use->lightmap_texcoords.data = out;
}

static void scene__add_uses(scene__reader *r, const scene__node *at) {
    const struct aiString *full_name = &(at->node->mName.length ? at->node : r->in->mRootNode)->mName;
    scene_file_place place;
    int map;
    const char *name = scene__place_of(r, full_name->data, &place, &map);
    unsigned i, material;
    int k;
    for (i = 0; i < at->node->mNumMeshes; i++) {
        const sbl_mesh *mesh = scene__used(r, at, i, &material);
        sbl_mesh *use = &r->meshes[r->use_count];
        char *copy;
        if (!mesh || r->left_out[material]) continue;
        *use = *mesh;
        use->material = (int)material;
        use->id = (uint32_t)r->use_count + 1;
        scene__put_place(r, &place, use);
        r->places[r->use_count] = place;
        r->maps[r->use_count] = use->lightmap_texcoords.data ? map : -1;
        if (r->maps[r->use_count] >= r->file->map_count) r->file->map_count = map + 1;
        for (k = 0; k < 16; k++) use->transform[k] = (float)at->transform[k % 4 * 4 + k / 4];
        copy = (char *)scene__alloc(r->file, strlen(name) + 1, 1);
        if (!copy) return;
        strcpy(copy, name);
        r->names[r->use_count++] = copy;
    }
    for (i = 0; i < r->best_camera; i++) {
        const struct aiCamera *camera = r->in->mCameras[i];
        if (camera->mOrthographicWidth != 0.0f || strcmp(camera->mName.data, at->node->mName.data) != 0) continue;
        scene__camera(&r->file->camera, camera, at->transform, r->is_gltf);
        r->file->has_camera = 1;
        r->camera_node = at->node;
        r->best_camera = i;
    }
    scene__lights(r, at->node, at->transform);
}

/* Measured memory that sbl.h needs to render a scene, in bytes, with its GL buffers. Each use of a mesh needs as much
   as a mesh of its own. */
#define SCENE__PER_TRIANGLE 120.0
#define SCENE__PER_VERTEX   120.0

static void scene__nodes(scene__reader *r) {
    scene_file *file = r->file;
    char what[160];
    scene__walk(r, scene__count_uses);
    if (!r->use_count) {
        scene__fail(file, r->left_out_uses ? "all its surfaces are transparent, so nothing is left; give one an "
                    "opacity of at least 0.5" : "it has no triangles");
        return;
    }
    if (r->use_count > INT32_MAX) { scene__fail(file, "it has too many uses of meshes"); return; }
    scene__print(what, sizeof what, "rendering it (%.0f uses of meshes, %.0f triangles)", (double)r->use_count,
                 r->triangles);
    if (!scene__afford(file, what, 0, SCENE__PER_TRIANGLE * r->triangles + SCENE__PER_VERTEX * r->vertices)) return;
    r->meshes = (sbl_mesh *)scene__alloc(file, r->use_count, sizeof *r->meshes);
    r->names = (const char **)scene__alloc(file, r->use_count, sizeof *r->names);
    r->maps = (int *)scene__alloc(file, r->use_count, sizeof *r->maps);
    r->places = (scene_file_place *)scene__alloc(file, r->use_count, sizeof *r->places);
    if (!r->meshes || !r->names || !r->maps || !r->places) return;
    r->use_count = 0;
    r->best_camera = r->in->mNumCameras;
    scene__walk(r, scene__add_uses);
    file->scene.meshes = r->meshes;
    file->scene.mesh_count = (int)r->use_count;
    file->names = r->names;
    file->maps = r->maps;
    file->places = r->places;
}

/* ---- the complete scene ---- */

static int scene__make_room(scene__reader *r) {
    const size_t materials = r->in->mNumMaterials ? r->in->mNumMaterials : 1;
    scene__pictures *p = &r->pictures;
    p->room = (int)(SCENE__MASK * materials);  /* a mask joins the albedo texture */
    p->textures = (sbl_texture *)scene__alloc(r->file, SCENE__MASK * materials, sizeof *p->textures);
    p->keys = (struct scene__texture_key *)calloc(SCENE__MASK * materials, sizeof *p->keys);
    r->materials = (sbl_material *)scene__alloc(r->file, materials, sizeof *r->materials);
    r->lights = (sbl_light *)scene__alloc(r->file, r->in->mNumLights, sizeof *r->lights);
    r->light_names = (const char **)scene__alloc(r->file, r->in->mNumLights, sizeof *r->light_names);
    r->left_out = (int *)calloc(materials, sizeof *r->left_out);
    r->uv_set = (unsigned *)calloc(materials, sizeof *r->uv_set);
    r->moves = (const scene__transform **)calloc(materials, sizeof *r->moves);
    r->repeated = (char *)calloc(materials, 1);
    r->opacity = (float *)calloc(materials, sizeof *r->opacity);
    r->shown = (char *)calloc(materials, 1);
    r->posed = (char *)calloc((size_t)r->in->mNumMeshes + 1, 1);
    r->shared = (sbl_mesh *)calloc((size_t)r->in->mNumMeshes + 1, sizeof *r->shared);
    r->lamps = (struct scene__lamp *)calloc((size_t)r->in->mNumLights + 1, sizeof *r->lamps);
    if (!p->keys || !r->left_out || !r->uv_set || !r->moves || !r->repeated || !r->opacity || !r->shown || !r->posed ||
        !r->shared || !r->lamps)
        scene__fail_for_memory(r->file, "it");
    return !r->file->error[0];
}

/* Returns the length of the unit of an FBX file in metres: its UnitScaleFactor is in centimetres. Returns 1 for other
   files: glTF is in metres, assimp has converted the lengths of Collada, and the others have no unit. */
static double scene__unit_of(const struct aiScene *in, const char *path) {
    const struct aiMetadata *m = in->mMetaData;
    double centimetres = 1;
    unsigned i;
    if (!scene__ends_with(path, ".fbx")) return 1;
    for (i = 0; m && i < m->mNumProperties; i++) {
        if (strcmp(m->mKeys[i].data, "UnitScaleFactor") != 0) continue;
        if (m->mValues[i].mType == AI_FLOAT) centimetres = (double)*(const float *)m->mValues[i].mData;
        if (m->mValues[i].mType == AI_DOUBLE) centimetres = *(const double *)m->mValues[i].mData;
    }
    return centimetres > 1e-6 && centimetres < 1e9 ? 0.01 * centimetres : 0.01;
}

/* Returns the name of the program that wrote the file, or an empty text. */
static const char *scene__generator(const struct aiScene *in) {
    const struct aiMetadata *m = in->mMetaData;
    unsigned i;
    for (i = 0; m && i < m->mNumProperties; i++)
        if (strcmp(m->mKeys[i].data, AI_METADATA_SOURCE_GENERATOR) == 0 && m->mValues[i].mType == AI_AISTRING)
            return ((const struct aiString *)m->mValues[i].mData)->data;
    return "";
}

static void scene__convert(scene__reader *r) {
    scene_file *file = r->file;
    unsigned i;
    file->unit = r->unit = scene__unit_of(r->in, r->pictures.path);
    if (scene__make_room(r)) {
        for (i = 0; i < 3; i++) r->materials[0].albedo[i] = SCENE__GREY;  /* default material, if the file has none */
        for (i = 0; i < r->in->mNumMaterials && !file->error[0]; i++) scene__factors(r, i);
        for (i = 0; i < r->in->mNumMaterials && !r->not_matte; i++) scene__make_matte(&r->materials[i]);
        for (i = 0; i < r->in->mNumMaterials && !file->error[0]; i++) scene__material(r, i);
        for (i = 0; i < r->in->mNumMeshes && !file->error[0]; i++) scene__mesh(r, r->in->mMeshes[i], &r->shared[i]);
        if (r->is_gltf) scene__count_lost(r);
        for (i = 0; i < r->in->mNumLights; i++) r->lamps[i].light = r->in->mLights[i];
        qsort(r->lamps, r->in->mNumLights, sizeof *r->lamps, scene__by_name);
        if (!file->error[0]) scene__nodes(r);
        if (!file->error[0] && file->frames_asked) scene__frames(r);
        if (!file->error[0]) scene__count_all(r);
    }
    file->scene.lights = r->lights;
    file->light_names = r->light_names;
    file->scene.materials = r->materials;
    file->scene.material_count = r->in->mNumMaterials ? (int)r->in->mNumMaterials : 1;
    file->scene.textures = r->pictures.textures;
    file->scene.texture_count = r->pictures.count;
    scene__find_units(file, scene__generator(r->in));
    scene__free_pictures(&r->pictures);
    free(r->left_out);
    free(r->uv_set);
    free(r->moves);
    free(r->repeated);
    free(r->opacity);
    free(r->shown);
    free(r->posed);
    free(r->shared);
    free(r->lamps);
    free(r->motion.links);
}

/* Adds a grey material to a Collada file, whose id precedes all others, because assimp gives the first material to
   surfaces that have none. */
static void scene__mend_dae(scene_file *file, scene__bytes *bytes) {
    static const char added[] = "<library_effects><effect id=\"!\"><profile_COMMON><technique sid=\"common\"><lambert>"
        "<diffuse><color>0.6 0.6 0.6 1</color></diffuse></lambert></technique></profile_COMMON></effect>"
        "</library_effects><library_materials><material id=\"!\"><instance_effect url=\"#!\"/></material>"
        "</library_materials>";
    const char *const end = strstr(bytes->data, "</asset>");
    const size_t before = end ? (size_t)(end - bytes->data) + 8 : 0, length = sizeof added - 1;
    char *out = end ? (char *)malloc(bytes->size + length + 1) : NULL;
    if (!end) return;
    if (!out) { scene__fail_for_memory(file, "it"); return; }
    memcpy(out, bytes->data, before);
    memcpy(out + before, added, length);
    memcpy(out + before + length, bytes->data + before, bytes->size - before + 1);
    free(bytes->data);
    bytes->data = out;
    bytes->size += length;
}

/* Reads a scene. bytes: content of the file, which the caller frees */
static void scene__read_scene(scene_file *file, const char *path, scene__bytes *bytes) {
    scene__main_file main_file;
    struct aiFileIO io;
    const unsigned steps = aiProcess_Triangulate | aiProcess_SortByPType | aiProcess_TransformUVCoords;
    scene__reader r;
    memset(&r, 0, sizeof r);
    r.is_gltf = scene__ends_with(path, ".gltf") || scene__ends_with(path, ".glb");
    r.is_obj = scene__ends_with(path, ".obj");
    if (r.is_gltf || r.is_obj) scene__remove_mark(bytes);
    if (r.is_gltf) scene__mend_gltf(file, path, bytes, &r.taken);
    r.is_bare = scene__ends_with(path, ".stl") ||
                (scene__ends_with(path, ".ply") && !scene__mentions(bytes, "element material")) ||
                (r.is_obj && !scene__mentions(bytes, "mtllib"));
    if (r.is_obj) scene__mend_obj(file, bytes);
    if (scene__ends_with(path, ".dae")) scene__mend_dae(file, bytes);
    main_file.file = file;
    main_file.path = path;
    main_file.bytes = *bytes;
    main_file.floats = &r.taken.floats;
    main_file.missing[0] = 0;
    main_file.mtl = &r.mtl;
    io.OpenProc = scene__open;
    io.CloseProc = scene__close;
    io.UserData = (char *)&main_file;
    r.in = aiImportFileEx(path, steps, &io);
    if (main_file.missing[0])
        scene__warn(file, "materials %s cannot be read; surfaces that use them are grey", main_file.missing);
    r.lacks_mtl = main_file.missing[0] != 0;
    r.file = r.pictures.file = file;
    r.pictures.path = path;
    r.pictures.embedded = scene__find_embedded;
    r.pictures.scene = r.in;
    if (r.in && r.in->mRootNode) scene__convert(&r);
    else if (strstr(aiGetErrorString(), "bad_alloc")) scene__fail_for_memory(file, "it");
    else
        scene__fail(file, "assimp cannot read it (%s); repair it or convert it to .glb or .obj",
                    aiGetErrorString()[0] ? aiGetErrorString() : "it contains no scene");
    if (r.in) aiReleaseImport(r.in);
    free(r.taken.transforms);
    free(r.taken.triangles);
    free(r.taken.floats.data);
    scene__free_mtl(&r.mtl);
}

#endif
