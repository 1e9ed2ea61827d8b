/* Reads a scene file into the arrays that sbl_set_scene takes. assimp reads scenes (.obj, .gltf, .glb, .fbx, .ply,
   ...), and stb_image reads pictures. Include after sbl.h, with _DEFAULT_SOURCE defined before the first header; link
   with -lassimp.

       char error[512];
       scene_file *file = scene_file_load("room.glb", NULL, error, sizeof error);
       if (!file) { fprintf(stderr, "%s\n", error); return 1; }
       sbl_set_scene(context, &file->scene);
       scene_file_free(file);

   scene_file_load_sky reads a picture of the sky in the same way, and puts it into scene.environment.picture.

   The reader converts: triangles and polygons (no points and lines), normals if the file has them, one set of texture
   coordinates, a second set for lightmaps (TEXCOORD_1, with the scale and offset that scripts/sbl_unwrap notes for each
   glTF node in extras.lightmapScaleOffset: scale * texcoord + offset; this needs cJSON), vertex colours, nodes with
   their transforms (each use of a mesh becomes an sbl_mesh with its own id; all uses share the arrays), the first
   perspective camera, point, spot and directional lights, and these materials and lights:

       OBJ   Kd map_Kd Ke map_Ke d map_d. map_d becomes the alpha of the albedo texture, with the cutoff 0.5. map_Kd
             without Kd gets Kd 1 1 1, map_Ke without Ke gets Ke 1 1 1. The options -s and -o of textures are read. Ns
             Ks Ni illum (or Pr Pm) become gloss or metal, see scene__phong_gloss; illum 4, 6, 7 and 9 with d, Ni and
             Tf become panes, see scene__glass and scene__glaze. norm is a normal map
       glTF  baseColor; emissive times KHR_materials_emissive_strength (needs cJSON: define SBL_RENDER_CJSON, link with
             -lcjson); alphaMode MASK with its cutoff, and BLEND; metallicFactor, roughnessFactor,
             metallicRoughnessTexture, KHR_materials_transmission, KHR_materials_ior, and KHR_materials_specular if its
             factor is 0; normalTexture with its scale. KHR_lights_punctual without ranges. Several nodes can share a
             light, textures can have a KHR_texture_transform, and vertices can be integers (KHR_mesh_quantization),
             but only with cJSON
       else  the same features, as far as assimp returns them; the colour of a light is its intensity; a falloff
             other than by the square of the distance is ignored

   FBX files state a unit of length, mostly a centimetre; their lengths become metres.

   Surfaces without a material have the albedo 0.6. In glTF, such a surface has the albedo 1, as glTF requires. STL, PLY
   and OBJ without an .mtl have no materials; their vertex colours and textures are not multiplied by 0.6.

   Metal and gloss follow one rule for the complete file. If no used material has metalness, a roughness below 1, a
   texture of one of these, or transmission, all materials are matte, because exporters write roughness 1 for surfaces
   that are meant to be matte. Otherwise all materials of a .gltf are read by the material model of glTF. A material
   without metallicFactor, roughnessFactor and metallicRoughnessTexture counts as matte for the rule, although glTF
   reads it as metal of roughness 1. Emitting surfaces with a black colour and unlit surfaces are always matte.

   BLEND, and a constant opacity below 1 in other formats, become SBL_MATERIAL_BLEND if the file is not matte. In matte
   files they are cut out where their alpha is below 0.5; meshes with a constant alpha below 0.5 are omitted. Such
   materials alone do not count against a matte file.

   Normal maps are shown in matte files, too, and do not count against them. A material whose normal map is missing or
   grey is shown without it, because a grey picture holds heights.

   A file from an untrusted source can crash its reader, take control of it, make it hang, exhaust the memory, or refer
   to files that it must not access. For this reason:

       A child process reads the file, into pages that it shares with the parent. The parent uses the result only if the
           child succeeded (scene_child.h), within limits on time and memory (scene_memory.h), and checks all of it
           (scene_trust.h).
       The child reads only files in the folder of the scene and in folders that the user allows (scene_paths.h).
       The kernel forbids the child almost everything else (scene_sandbox.h).

   In the child, scene_gltf.h edits a .gltf before assimp reads it, scene_integers.h converts its integers to floats,
   scene_obj.h edits .obj and .mtl files, scene_assimp.h converts the result of assimp, scene_motion.h computes the
   poses of animated nodes, and scene_pictures.h decodes pictures. */
#ifndef SCENE_FILE_H
#define SCENE_FILE_H

#include <signal.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/types.h>
#if defined(__SANITIZE_ADDRESS__)
  #define SCENE__SANITIZED 1
#elif defined(__has_feature)
  #if __has_feature(address_sanitizer)
    #define SCENE__SANITIZED 1
  #endif
#endif
#ifndef SCENE__SANITIZED
  #define SCENE__SANITIZED 0
#endif
/* Several programs can share one object of the reader. It is compiled from this header with SCENE_FILE_API defined as
   nothing. A program that is linked with it defines SCENE_FILE_API as nothing, too, and SCENE_FILE_ELSEWHERE. */
#ifndef SCENE_FILE_API
  #define SCENE_FILE_API static inline
#endif

enum { SCENE_FILE_WARNINGS = 8, SCENE_FILE_FOLDERS = 16, SCENE_FILE_SECONDS = 60, SCENE_FILE_READ = 1024,
    SCENE_FILE_RATE = 24 };

/* Options for reading. A field that is 0 selects its default. */
typedef struct scene_file_options {
    const char *allow[SCENE_FILE_FOLDERS];  /* folders that may be read in addition to the folder of the scene */
    size_t memory;   /* limit in bytes for reading and rendering the scene; default: half of the memory of the machine
                        or of its control group. It is never more than half of what ulimit -v leaves */
    double seconds;  /* limit for the reading time; default 60 */
    int frames;      /* 0, or the number of frames: the file must then have an animated camera, which is read at each
                        frame; see scene_file.frames */
    double frame_rate;  /* frames per second; default 24 */
    int matte;       /* 1: read all materials as matte, metal as a matte surface of its base colour, and ignore normal
                        maps */
    const volatile sig_atomic_t *cancel;            /* NULL, or a flag: reading stops when it becomes nonzero */
    void (*log)(const char *path, const char *message, void *user);  /* receives a description of the sandbox */
    void *log_user;
} scene_file_options;

/* The features that are simplified or ignored: kind, counted items (one, several), and text of the warning. METAL,
   GLOSS, GLASS, ILLUM, NORMAL_MAP and TEXTURE are counted only with options.matte; MAP, SPECULAR and REFRACTION only
   without it. BLEND is counted in matte files, whether the rule or the option makes them so. */
#define SCENE_FILE_KINDS(X) \
    X(METAL, "material", "materials", "metal is read as a matte surface of its base colour") \
    X(GLOSS, "material", "materials", "gloss is ignored (roughness below 0.5, or Ns above 30): the surface is matte") \
    X(COAT, "material", "materials", "clear coat is ignored") \
    X(SHEEN, "material", "materials", "sheen is ignored") \
    X(ANISOTROPY, "material", "materials", "anisotropy is ignored") \
    X(SPECULAR, "material", "materials", "strength and colour of reflections (KHR_materials_specular) are ignored") \
    X(GLASS, "material", "materials", "transmission, refraction and volume are ignored: the surface is opaque") \
    X(REFRACTION, "material", "materials", "refraction and volume are ignored: light passes as through a thin pane") \
    X(ILLUM, "material", "materials", "mirrors and glass (illum 3 to 9) are read as matte, opaque surfaces") \
    X(BLEND, "material", "materials", "partial transparency is read as a cutout: opaque from 0.5 on") \
    X(GONE, "material", "materials", "transparent surfaces are left out: their opacity is 0, or below the cutoff") \
    X(WRAP, "mesh", "meshes", "textures that the file mirrors, or clamps along one axis, are repeated") \
    X(UNMAPPED, "mesh", "meshes", "without texture coordinates, a texture shows only the colour of its corner") \
    X(NORMAL_MAP, "material", "materials", "normal maps are ignored") \
    X(HEIGHT, "material", "materials", "bump maps and displacement (textures of heights) are ignored") \
    X(TEXTURE, "material", "materials", "textures of metal, roughness or gloss are not read") \
    X(MAP, "material", "materials", "textures of specular colour or gloss are not read; those of metal and roughness " \
        "are read only from glTF") \
    X(UNLIT, "material", "materials", "unlit materials are lit like all others") \
    X(EXTENSION, "material", "materials", "further material extensions, such as iridescence, are ignored") \
    X(RANGE, "light", "lights", "the range of lights is ignored: they reach everywhere") \
    X(AREA, "light", "lights", "area lights and ambient lights are left out") \
    X(CAMERA, "camera", "cameras", "orthographic cameras are not used, and the file has no other: the tool chose a " \
        "view") \
    X(LINES, "mesh", "meshes", "lines and points are left out") \
    X(CORNERS, "triangle", "triangles", "triangles with missing corners are left out: an index is too large, or the " \
        "number of indices is wrong") \
    X(ATTRIBUTE, "mesh", "meshes", "normals, colours or texture coordinates are ignored, because their number is not " \
        "that of the positions") \
    X(FLAT, "node", "nodes", "nodes whose scale is 0 along an axis are left out") \
    X(POSE, "mesh", "meshes", "skins and morph targets are read in their rest pose") \
    X(ANIMATION, "animation", "animations", "animations are ignored: nodes stand where the file puts them")

#define SCENE__KIND(kind, one, several, text) SCENE_FILE_##kind,
typedef enum scene_file_kind { SCENE_FILE_KINDS(SCENE__KIND) SCENE_FILE_KIND_COUNT } scene_file_kind;
#undef SCENE__KIND

/* The unit of lights: the unit of sbl.h, or one that Blender writes; see scene_units.h. */
enum { SCENE_UNITS_FIT, SCENE_UNITS_BLENDER, SCENE_UNITS_BLENDER_UNITLESS, SCENE_UNITS_BLENDER_RAW, SCENE_UNITS_COUNT };

typedef struct scene_file_camera {
    float eye[3], forward[3], up[3], fov_y, fov_x;
} scene_file_camera; /* fields of view in degrees; one of the two is 0 */

/* The lightmap placement of a glTF node: its mesh has the lightmap coordinates scale * TEXCOORD_1 + offset. */
typedef struct scene_file_place {
    int node;                     /* index of the node in the file; -1 if the node states no placement */
    float scale[2], offset[2];
} scene_file_place;

typedef struct scene_file {
    sbl_scene_desc scene;         /* without a sky; after scene_file_load_sky, only the picture of a sky */
    const char *const *names;     /* one per mesh */
    const char *const *light_names;  /* one per light: the name of its node */
    int has_camera;
    scene_file_camera camera;
    int frame_count;
    const scene_file_camera *frames;  /* the animated camera of each frame, at the times 0, 1, 2, ... divided by
                                         options.frame_rate, in seconds; NULL if options.frames is 0 */
    int warning_count;            /* number of warnings; only the first SCENE_FILE_WARNINGS are stored */
    char warnings[SCENE_FILE_WARNINGS][256];
    int simplified[SCENE_FILE_KIND_COUNT];  /* for each kind: number of materials, lights, ... */
    int map_count;                /* number of lightmaps for which the file has coordinates */
    int map_size;                 /* width of a lightmap in texels, as sbl_unwrap has noted it; 0 if not known */
    const int *maps;              /* one per mesh: index of its lightmap (extras.lightmapIndex, or 0), below map_count;
                                     -1 if it has no second texture coordinates */
    const scene_file_place *places;  /* one per mesh; lightmap_texcoords already include it */
    int units;                    /* unit of the lights, one of SCENE_UNITS_; see scene_file_scale_lights */
    double unit;                  /* unit of length of the file in metres, by which lengths were multiplied; 1 if the
                                     file is in metres or states no unit */
    int exporter_version[2];      /* major and minor version of Blender's exporter */
    int read_count;               /* number of files in `read`, which lists the first files that were read */
    struct { dev_t device; ino_t inode; } read[SCENE_FILE_READ];
    /* ---- private ---- */
    char error[512];
    int finished;                              /* 1: the child has finished reading */
    char confined[256];                        /* description of the sandbox of the child */
    const struct scene__folders *folders;      /* the folders from which the child may read */
    size_t capacity, used;                     /* size and used part of the shared pages in bytes */
    size_t memory, own_at_start;               /* limit in bytes; the memory of the child itself at its start */
    int frames_asked;                          /* number of frames that the options ask for */
    double frame_rate;
    int matte;                                 /* as in the options */
    double rendering;                          /* bytes that sbl.h will need to render what has been read so far */
    int own_handle;                            /* /proc/self/statm of the child, which states its memory */
} scene_file;

#if defined(__GNUC__)
  #define SCENE__PRINTF(text, rest) __attribute__((format(printf, text, rest)))
#else
  #define SCENE__PRINTF(text, rest)
#endif

#ifdef SCENE_FILE_ELSEWHERE
  #pragma GCC diagnostic push
  #pragma GCC diagnostic ignored "-Wunused-function"  /* the program may use only some of these functions */
#endif
SCENE__PRINTF(3, 4) static void scene__print(char *out, size_t size, const char *format, ...) {
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(out, size, format, arguments);  /* truncates texts that are too long */
    va_end(arguments);
}

/* Sets the error. Only the first error is kept. */
SCENE__PRINTF(2, 3) static void scene__fail(scene_file *file, const char *format, ...) {
    va_list arguments;
    va_start(arguments, format);
    if (!file->error[0]) vsnprintf(file->error, sizeof file->error, format, arguments);
    va_end(arguments);
}

/* Adds a warning, unless the list already contains it. */
SCENE__PRINTF(2, 3) static void scene__warn(scene_file *file, const char *format, ...) {
    va_list arguments;
    int i;
    char text[sizeof file->warnings[0]];
    va_start(arguments, format);
    vsnprintf(text, sizeof text, format, arguments);
    va_end(arguments);
    for (i = 0; i < file->warning_count && i < SCENE_FILE_WARNINGS; i++)
        if (strcmp(file->warnings[i], text) == 0) return;
    if (file->warning_count < SCENE_FILE_WARNINGS) strcpy(file->warnings[file->warning_count], text);
    file->warning_count++;
}

/* Counts one more material, light, ... of a kind. */
static void scene__count(scene_file *file, scene_file_kind kind) {
    if (file->simplified[kind] < INT32_MAX) file->simplified[kind]++;
}

#include "scene_units.h"
#include "scene_memory.h"
#include "scene_paths.h"
#ifdef SCENE_FILE_ELSEWHERE
  #pragma GCC diagnostic pop
#else
  #include "scene_pictures.h"
  #include "scene_integers.h"
  #include "scene_gltf.h"
  #include "scene_obj.h"
  #include "scene_motion.h"
  #include "scene_assimp.h"
  #include "scene_sandbox.h"
  #include "scene_trust.h"
  #include "scene_child.h"
#endif

/* Writes the warning of a kind, or an empty text if no feature of this kind was found. */
static inline void scene_file_warning(const scene_file *file, scene_file_kind kind, char *out, size_t size) {
#define SCENE__KIND(kind, one, several, text) { one, several, text },
    static const char *const words[SCENE_FILE_KIND_COUNT][3] = { SCENE_FILE_KINDS(SCENE__KIND) };
#undef SCENE__KIND
    const int count = file->simplified[kind];
    out[0] = 0;
    if (count) snprintf(out, size, "%s (%d %s)", words[kind][2], count, words[kind][count > 1]);
}

/* Keeps only one lightmap, which gets the index 0: removes the lightmap coordinates of all meshes that are not in
   it. */
static inline void scene_file_keep_map(scene_file *file, int map) {
    sbl_mesh *meshes = (sbl_mesh *)(uintptr_t)file->scene.meshes;
    int *maps = (int *)(uintptr_t)file->maps, i;
    for (i = 0; i < file->scene.mesh_count; i++) {
        maps[i] = maps[i] == map ? 0 : -1;
        if (maps[i] < 0) meshes[i].lightmap_texcoords.data = NULL;
    }
    file->map_count = 1;
}

static inline void scene_file_free(scene_file *file) {
    if (file) munmap(file, file->capacity);
}

/* Both functions return NULL on failure, with a message of one line in error, and on cancellation, with an empty error.
   options: NULL for the defaults */
SCENE_FILE_API scene_file *scene_file_load(const char *path, const scene_file_options *options, char *error,
                                           size_t error_size);
SCENE_FILE_API scene_file *scene_file_load_sky(const char *path, const scene_file_options *options, char *error,
                                               size_t error_size);

#ifndef SCENE_FILE_ELSEWHERE
SCENE_FILE_API scene_file *scene_file_load(const char *path, const scene_file_options *options, char *error,
                                           size_t error_size) {
    return scene__load(scene__read_scene, path, options, error, error_size);
}

SCENE_FILE_API scene_file *scene_file_load_sky(const char *path, const scene_file_options *options, char *error,
                                               size_t error_size) {
    return scene__load(scene__read_sky, path, options, error, error_size);
}
#endif

#endif
