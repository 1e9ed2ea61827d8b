/* Part of scene_file.h: decides which files a scene may refer to, and reads them.

   The path of a file with all links and ".." resolved decides. Therefore the file is first opened without reading
   (O_PATH, which has no side effects and never blocks), then its path is read from the kernel (/proc/self/fd) and
   checked, and then the same open file is read. Thus nobody can replace the file between the check and the reading. */
#ifndef SCENE_PATHS_H
#define SCENE_PATHS_H

#include <errno.h>
#include <fcntl.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>
#include <sys/stat.h>
#include <unistd.h>
#ifndef O_PATH  /* glibc declares O_PATH only with _GNU_SOURCE */
  #define O_PATH 010000000
#endif

enum { SCENE__PATH = 4096, SCENE__REFUSED = EXDEV /* errno value for a file outside of the allowed folders */ };

typedef struct scene__folders {
    struct { int handle; char path[SCENE__PATH]; } list[SCENE_FILE_FOLDERS + 1];
    int count;
} scene__folders;

/* Gets the path of an open file. Returns 0 and sets errno on failure. */
static int scene__path_of(int handle, char out[SCENE__PATH]) {
    char link[64];
    ssize_t length;
    scene__print(link, sizeof link, "/proc/self/fd/%d", handle);
    length = readlink(link, out, SCENE__PATH - 1);
    if (length < 0) return 0;
    out[length] = 0;
    return 1;
}

/* Returns 1 if a path without links is inside one of the folders. */
static int scene__allowed(const scene__folders *folders, const char *path) {
    int i;
    for (i = 0; i < folders->count; i++) {
        const char *folder = folders->list[i].path;
        const size_t length = strcmp(folder, "/") == 0 ? 0 : strlen(folder);
        if (strncmp(path, folder, length) == 0 && path[length] == '/') return 1;
    }
    return 0;
}

/* Opens a regular file for reading. Returns -1 and sets errno on failure. folders: the allowed folders, or NULL to
   allow all */
static int scene__open_regular(const scene__folders *folders, const char *path) {
    const int found = open(path, O_PATH | O_CLOEXEC);
    char where[SCENE__PATH];
    struct stat info;
    int handle = -1, error = 0;
    if (found < 0) return -1;
    if (fstat(found, &info) != 0 || !scene__path_of(found, where)) error = errno;
    else if (!S_ISREG(info.st_mode)) error = S_ISDIR(info.st_mode) ? EISDIR : EINVAL;
    else if (folders && !scene__allowed(folders, where)) error = SCENE__REFUSED;
    else {
        scene__print(where, sizeof where, "/proc/self/fd/%d", found);
        handle = open(where, O_RDONLY | O_CLOEXEC);
        error = errno;
    }
    close(found);
    errno = error;
    return handle;
}

/* Returns a text that says why a file could not be opened or read, from errno. */
static const char *scene__why(void) {
    return errno == EINVAL ? "it is a pipe or a device, not a file" : strerror(errno);
}

/* Sets the error about a refused file. */
static void scene__refuse(scene_file *file, const char *path) {
    const int found = open(path, O_PATH | O_CLOEXEC);
    char where[SCENE__PATH];
    if (found < 0 || !scene__path_of(found, where)) scene__print(where, sizeof where, "%s", path);
    if (found >= 0) close(found);
    scene__fail(file, "it refers to the file %.300s, which is outside its folder and was not read; to allow it, give "
                "the folder of that file with --allow-path", where);
}

/* Adds an allowed folder. Returns 0 and sets errno on failure. */
static int scene__add_folder(scene__folders *folders, const char *path) {
    const int low = open(path, O_PATH | O_DIRECTORY | O_CLOEXEC);
    const int handle = low < 0 ? -1 : fcntl(low, F_DUPFD_CLOEXEC, 3);  /* the child redirects handles 0 to 2 */
    if (low >= 0) close(low);
    if (handle < 0) return 0;
    if (!scene__path_of(handle, folders->list[folders->count].path)) { close(handle); return 0; }
    folders->list[folders->count++].handle = handle;
    return 1;
}

static void scene__close_folders(scene__folders *folders) {
    while (folders->count) close(folders->list[--folders->count].handle);
}

/* ---- reading ---- */

typedef struct scene__bytes { char *data; size_t size; } scene__bytes;

/* Reads a complete file, appends a zero byte, and closes the handle. Returns 0 and sets errno on failure. */
static int scene__read_all(scene_file *file, int handle, scene__bytes *out) {
    struct stat info;
    size_t got = 0;
    ssize_t n = 1;
    out->data = NULL;
    if (fstat(handle, &info) != 0) { close(handle); return 0; }
    if (file->read_count < SCENE_FILE_READ) {
        file->read[file->read_count].device = info.st_dev;
        file->read[file->read_count++].inode = info.st_ino;
    }
    out->size = (size_t)info.st_size;
    out->data = (char *)malloc(out->size + 1);
    while (out->data && got < out->size && n > 0) {
        n = read(handle, out->data + got, out->size - got);
        if (n > 0) got += (size_t)n;
    }
    if (!out->data) errno = ENOMEM;
    close(handle);
    if (!out->data || n < 0) {
        free(out->data);
        out->data = NULL;
        return 0;
    }
    out->size = got;
    out->data[got] = 0;
    return 1;
}

/* Reads a file that a scene refers to. Returns 0 and sets errno on failure, also if the file is not allowed. */
static int scene__slurp(scene_file *file, const char *path, scene__bytes *out) {
    const int handle = scene__open_regular(file->folders, path);
    out->data = NULL;
    return handle >= 0 && scene__read_all(file, handle, out);
}

static int scene__ends_with(const char *path, const char *ending) {
    size_t a = strlen(path), b = strlen(ending);
    return a >= b && strcasecmp(path + a - b, ending) == 0;
}

#endif
