/* Reads a scene file into the arrays that sbl_set_scene takes: everything assimp reads (.obj, .gltf, .glb, .fbx, .ply,
   ...), pictures through stb_image. Include after sbl.h, with _DEFAULT_SOURCE defined before the first header; link
   with -lassimp.

       char error[512];
       scene_file *file = scene_file_load("room.glb", NULL, error, sizeof error);
       if (!file) { fprintf(stderr, "%s\n", error); return 1; }
       sbl_set_scene(context, &file->scene);
       scene_file_free(file);

   scene_file_load_sky reads a picture of the sky in the same way, into scene.environment.picture.

   What is read: triangles and polygons (points and lines are left out), normals where the file has them, one set of
   texture coordinates, a second one for lightmaps (TEXCOORD_1), vertex colours, nodes with their transforms (each use
   of a mesh is an sbl_mesh with an id of its own; all uses share its arrays), the first perspective camera, point, spot
   and directional lights, and

       OBJ   Kd map_Kd Ke map_Ke d map_d: a constant d below 0.5 leaves the mesh out, map_d becomes the alpha of the
             albedo texture, cut off at 0.5; map_Ke without Ke counts as Ke 1 1 1
       glTF  baseColor, emissive times KHR_materials_emissive_strength (needs cJSON: define SBL_RENDER_CJSON, link with
             -lcjson), alphaMode MASK with its cutoff, BLEND as a cutout at 0.5; metal and gloss are left out.
             KHR_lights_punctual without ranges; that several nodes may share a light needs cJSON, too
       else  the colour of a light is its intensity; how it is attenuated besides by distance is left out

   A file from a stranger can crash its reader, take it over, make it hang or eat all memory, or name files that are
   none of its business. So

       a child process reads it, into pages that both share; only when the child has ended well is the result used
           (scene_child.h), within a limit of time and of memory (scene_memory.h), and only as far as it is in order
           (scene_trust.h);
       it reads no files but those in the scene's own folder and in folders that the user allows (scene_paths.h);
       the kernel lets it do hardly anything else (scene_sandbox.h).

   In the child, scene_assimp.h converts what assimp reads, of a .gltf as scene_gltf.h mends it, and scene_pictures.h
   decodes pictures. */
#ifndef SCENE_FILE_H
#define SCENE_FILE_H

#include <signal.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <string.h>
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

enum { SCENE_FILE_WARNINGS = 8, SCENE_FILE_FOLDERS = 16, SCENE_FILE_SECONDS = 60, SCENE_FILE_READ = 1024 };

/* Zero means default. */
typedef struct scene_file_options {
    const char *allow[SCENE_FILE_FOLDERS];  /* folders to be read from besides the file's own */
    size_t memory;   /* bytes, for the reader and for rendering what it read; default: half of what the machine has, or
                        of what a control group leaves; never more than half of what ulimit -v leaves */
    double seconds;  /* for reading; default 60 */
    const volatile sig_atomic_t *cancel;            /* reading stops where it becomes nonzero */
    void (*log)(const char *path, const char *message, void *user);  /* is told how the reader was confined */
    void *log_user;
} scene_file_options;

typedef struct scene_file_camera {
    float eye[3], forward[3], up[3], fov_y, fov_x;
} scene_file_camera; /* degrees; one of the two angles is 0 */

typedef struct scene_file {
    sbl_scene_desc scene;         /* sky left black; or nothing but a picture of the sky */
    const char *const *names;     /* of the meshes */
    int has_camera;
    scene_file_camera camera;
    int warning_count;            /* of which the first are kept */
    char warnings[SCENE_FILE_WARNINGS][256];
    int read_count;               /* of the files that were read, the first ones */
    struct { dev_t device; ino_t inode; } read[SCENE_FILE_READ];
    /* private */
    char error[512];
    int finished;                              /* the child came to its end */
    char confined[256];                        /* how */
    const struct scene__folders *folders;      /* the child's: where it may read */
    size_t capacity, used;                     /* of the pages, which begin with this struct */
    size_t memory, own_at_start;               /* the limit; the child's memory before it began */
    double rendering;                          /* bytes that sbl.h will take for what is read so far */
    int own_handle;                            /* tells the child how much it has */
} scene_file;

#if defined(__GNUC__)
  #define SCENE__PRINTF(text, rest) __attribute__((format(printf, text, rest)))
#else
  #define SCENE__PRINTF(text, rest)
#endif

SCENE__PRINTF(3, 4) static void scene__print(char *out, size_t size, const char *format, ...) {
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(out, size, format, arguments);  /* cut off where it is too long */
    va_end(arguments);
}

/* The first one counts. */
SCENE__PRINTF(2, 3) static void scene__fail(scene_file *file, const char *format, ...) {
    va_list arguments;
    va_start(arguments, format);
    if (!file->error[0]) vsnprintf(file->error, sizeof file->error, format, arguments);
    va_end(arguments);
}

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

#include "scene_memory.h"
#include "scene_paths.h"
#include "scene_pictures.h"
#include "scene_gltf.h"
#include "scene_assimp.h"
#include "scene_sandbox.h"
#include "scene_trust.h"
#include "scene_child.h"

static void scene_file_free(scene_file *file) {
    if (file) munmap(file, file->capacity);
}

/* Both return NULL and one line in `error` where the file cannot be read, or, with error empty, where *cancel became
   nonzero. options: NULL for the defaults. */
static scene_file *scene_file_load(const char *path, const scene_file_options *options, char *error,
                                   size_t error_size) {
    return scene__load(scene__read_scene, path, options, error, error_size);
}

static inline scene_file *scene_file_load_sky(const char *path, const scene_file_options *options, char *error,
                                              size_t error_size) {
    return scene__load(scene__read_sky, path, options, error, error_size);
}

#endif
