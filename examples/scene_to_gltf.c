/* Demonstrates how to read a scene file and write it as glTF: scene_to_gltf SCENE FOLDER/FILE.gltf. It also writes
   FOLDER/scene.bin, and a FOLDER/texture_N.png for each texture, and overwrites existing files. It prints what the
   reader simplifies or ignores. scripts/sbl_unwrap uses it for scenes in other formats. */
#define _DEFAULT_SOURCE
#include "../sbl.h"
#include "picture_file.h"
#include "scene_file.h"
#include "gltf_file.h"

static int fail(const char *path, const char *why) {
    fprintf(stderr, "scene_to_gltf: %s: %s\n", path, why);
    return 0;
}

enum { THE_BIN = -1, THE_GLTF = -2 };

/* Writes one file. Returns 0 and prints a message on failure. what: the index of a texture, THE_BIN or THE_GLTF. path:
   path of the .gltf */
static int write_one(const gltf_file *f, const char *path, int what) {
    const char *slash = strrchr(path, '/');
    const int folder = what == THE_GLTF || !slash ? 0 : (int)(slash - path) + 1;
    char own[SCENE__PATH], name[GLTF_NAME];
    FILE *out;
    int ok;
    gltf_texture_name(name, what);
    scene__print(own, sizeof own, "%.*s%s", folder, path, what == THE_GLTF ? path : what == THE_BIN ? f->bin : name);
    out = fopen(own, "wb");
    if (!out) return fail(own, strerror(errno));
    ok = what == THE_GLTF ? gltf_write_json(out, f) : what == THE_BIN ? gltf_write_bin(out, f)
                                                                      : gltf_write_texture(out, f, what);
    ok = !ferror(out) && ok;
    return fclose(out) == 0 && ok ? 1 : fail(own, "it cannot be written");
}

/* Prints the warnings of the reader, except that about a camera, which says that another view was chosen. */
static void print_warnings(const scene_file *file, const char *path) {
    char text[256];
    int i;
    for (i = 0; i < file->warning_count && i < SCENE_FILE_WARNINGS; i++)
        fprintf(stderr, "scene_to_gltf: warning: %s: %s\n", path, file->warnings[i]);
    for (i = 0; i < SCENE_FILE_KIND_COUNT; i++) {
        scene_file_warning(file, (scene_file_kind)i, text, sizeof text);
        if (text[0] && i != SCENE_FILE_CAMERA) fprintf(stderr, "scene_to_gltf: warning: %s: %s\n", path, text);
    }
}

int main(int argc, char **argv) {
    char error[512];
    float camera[10];
    scene_file *file;
    gltf_file out;
    int i, ok = 1;
    if (argc != 3 || !scene__ends_with(argv[2], ".gltf")) {
        fprintf(stderr, "usage: scene_to_gltf SCENE FOLDER/FILE.gltf\n");
        return 2;
    }
    file = scene_file_load(argv[1], NULL, error, sizeof error);
    if (!file) {
        fprintf(stderr, "scene_to_gltf: %s\n", error);
        return 1;
    }
    print_warnings(file, argv[1]);
    scene_file_scale_lights(file, -1);
    memset(&out, 0, sizeof out);
    out.scene = &file->scene;
    out.names = file->names;
    out.bin = "scene.bin";
    out.has_lights = 1;
    if (file->has_camera && file->camera.fov_y > 0) {
        memcpy(camera, file->camera.eye, 12);
        memcpy(camera + 3, file->camera.forward, 12);
        memcpy(camera + 6, file->camera.up, 12);
        camera[9] = file->camera.fov_y;
        out.camera = camera;
    }
    for (i = THE_GLTF; i < file->scene.texture_count && ok; i++) ok = write_one(&out, argv[2], i);
    scene_file_free(file);
    return !ok;
}
