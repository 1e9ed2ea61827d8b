/* Writes files completely or not at all: data goes to a temporary file in the folder of the target. At the end the file
   is flushed to disk and renamed to the target. Needs POSIX; include with _DEFAULT_SOURCE defined before the first
   header.

       output_file out;
       FILE *stream;
       output_find(&out, "room.png");
       stream = output_open(&out);
       if (stream) { complete = write(..., stream); ok = output_close(&out, stream, complete, NULL); }
       output_free(&out);

   The new file gets the permissions of the file that it replaces, and the same owner and group as far as the system
   allows. If the target is a symbolic link, the file behind it is replaced and the link stays. If the old file has
   further hard links, they keep the old content. Devices, pipes and /dev/stdout are written in place.

   Functions that fail set errno. Only one file can be open at a time. output_abandon removes the temporary file; signal
   handlers may call it. */
#ifndef OUTPUT_FILE_H
#define OUTPUT_FILE_H

#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/time.h>
#include <unistd.h>

typedef struct output_file {
    const char *name;  /* as the caller gave it */
    char *path;        /* the target: absolute, with all links resolved; NULL if its folder does not exist */
    int error;         /* errno if path is NULL */
    int in_place;      /* 1: the target is a device or a pipe, and is written in place */
    int keep_existing; /* 1: a target that exists at the end is left alone, which counts as success */
    char *temporary;   /* path of the temporary file while it is open */
} output_file;

/* ---- resolving names ---- */

/* Returns the path folder/name, which the caller frees, or NULL if memory runs out. length: number of characters of
   folder to use */
static char *output__join(const char *folder, size_t length, const char *name) {
    char *path = (char *)malloc(length + strlen(name) + 2);
    if (!path) {
        errno = ENOMEM;
        return NULL;
    }
    memcpy(path, folder, length);
    if (length && folder[length - 1] != '/') path[length++] = '/';
    strcpy(path + length, name);
    return path;
}

/* Returns the path with all links in its folder resolved, or NULL if the folder does not exist. Frees path. */
static char *output__true_folder(char *path) {
    char *slash = path ? strrchr(path, '/') : NULL, *folder, *joined = NULL;
    const char *name = slash ? slash + 1 : path;
    if (slash == path) return path; /* the file is in the root folder, or path is NULL */
    if (slash) *slash = 0;
    folder = realpath(slash ? path : ".", NULL);
    if (folder) joined = output__join(folder, strlen(folder), name);
    free(folder);
    free(path);
    return joined;
}

/* Returns 1 if the path is one of the links in /dev or /proc to the open files of this process. Such a file may have no
   other name. */
static int output__is_handle(const char *path) {
    return strncmp(path, "/dev/std", 8) == 0 || strncmp(path, "/dev/fd/", 8) == 0 || strncmp(path, "/proc/", 6) == 0;
}

/* Resolves all links of a name. Unlike realpath, this also works if the file itself does not exist. Returns NULL and
   sets errno on failure. */
static char *output__follow(const char *name) {
    char link[PATH_MAX], *path = output__true_folder(output__join("", 0, name));
    int links;
    for (links = 0; path && links < 40; links++) {
        const ssize_t n = output__is_handle(path) ? -1 : readlink(path, link, sizeof link - 1);
        char *next;
        if (n < 0) return path;
        link[n] = 0;
        next = output__join(path, link[0] == '/' ? 0 : (size_t)(strrchr(path, '/') - path) + 1, link);
        free(path);
        path = output__true_folder(next);
    }
    if (path) errno = ELOOP;
    free(path);
    return NULL;
}

/* Resolves a name and fills in o. Returns 0 on failure, for example if the folder does not exist. */
static int output_find(output_file *o, const char *name) {
    struct stat info;
    memset(o, 0, sizeof *o);
    o->name = name;
    o->path = output__follow(name);
    o->error = o->path ? 0 : errno;
    if (o->path)
        o->in_place = output__is_handle(o->path) ||
                      (stat(o->path, &info) == 0 && !S_ISREG(info.st_mode) && !S_ISDIR(info.st_mode));
    return o->path != NULL;
}

static void output_free(output_file *o) {
    free(o->path);
    o->path = NULL;
}

/* Returns 1 if a and b are the same file, or will be once they are written. Character devices such as /dev/null never
   count as the same file, because they store nothing. */
static inline int output_same(const output_file *a, const output_file *b) {
    struct stat of_a, of_b;
    if (!a->path || !b->path) return 0;
    if (stat(a->path, &of_a) != 0 || stat(b->path, &of_b) != 0) return strcmp(a->path, b->path) == 0;
    return of_a.st_dev == of_b.st_dev && of_a.st_ino == of_b.st_ino && !S_ISCHR(of_a.st_mode);
}

/* ---- writing ---- */

static char *volatile output__open; /* path of the temporary file that exists now, or NULL */

/* Removes the temporary file, if one exists. Signal handlers call this before they end the program. */
static inline void output_abandon(void) {
    if (output__open) unlink(output__open);
}

/* Creates a file with a new, unpredictable name in the folder of path. Returns its handle, or -1 and sets errno. The
   name does not include the name of the target, which may already have the maximum allowed length. name: receives the
   path of the new file, which the caller frees */
static int output__create(const char *path, char **name) {
    const int folder = (int)(strrchr(path, '/') - path);
    const size_t size = (size_t)folder + 40;
    struct timeval t;
    sigset_t all, before;
    unsigned long random;
    int handle = -1, tries;
    *name = (char *)malloc(size);
    if (!*name) {
        errno = ENOMEM;
        return -1;
    }
    gettimeofday(&t, NULL);
    random = (unsigned long)t.tv_usec << 12 ^ (unsigned long)t.tv_sec ^ (unsigned long)getpid() << 16;
    sigfillset(&all);
    for (tries = 0; tries < 100 && handle < 0; tries++) {
        random = (random * 1103515245 + 12345) & 0xffffffff;
        snprintf(*name, size, "%.*s/sbl_render.%08lx.part", folder, path, random);
        sigprocmask(SIG_SETMASK, &all, &before); /* blocks signals until output_abandon knows the file */
        handle = open(*name, O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0666);
        if (handle >= 0) output__open = *name;
        sigprocmask(SIG_SETMASK, &before, NULL);
        if (handle < 0 && errno != EEXIST) break;
    }
    if (handle < 0) {
        free(*name);
        *name = NULL;
    }
    return handle;
}

/* Moves the temporary file to the target if `complete` is 1; otherwise deletes it. With keep_existing, an existing
   target is left alone, which counts as success. Returns 1 if a complete target exists afterwards. */
static int output__commit_or_discard(output_file *o, int complete) {
    int error;
    if (complete && o->keep_existing) complete = link(o->temporary, o->path) == 0 || errno == EEXIST;
    else if (complete && rename(o->temporary, o->path) != 0) complete = 0;
    error = errno;
    if (!complete || o->keep_existing) unlink(o->temporary);
    output__open = NULL;
    free(o->temporary);
    o->temporary = NULL;
    errno = error;
    return complete;
}

/* Opens the temporary file, or a target that is written in place. Returns NULL and sets errno on failure. */
static FILE *output_open(output_file *o) {
    struct stat old;
    FILE *stream;
    int handle;
    if (!o->path) {
        errno = o->error;
        return NULL;
    }
    if (o->in_place) return fopen(o->path, "wb");
    if (stat(o->path, &old) != 0) old.st_mode = 0;
    if (S_ISDIR(old.st_mode)) {
        errno = EISDIR;
        return NULL;
    }
    handle = output__create(o->path, &o->temporary);
    if (handle < 0) return NULL;
    if (old.st_mode) {
        /* If the group cannot be set, the group permissions are removed, because they would apply to another group. */
        const int grouped = fchown(handle, old.st_uid, old.st_gid) == 0 || fchown(handle, (uid_t)-1, old.st_gid) == 0;
        fchmod(handle, old.st_mode & (grouped ? 0777 : 0707));
    }
    stream = fdopen(handle, "wb");
    if (!stream) {
        close(handle);
        output__commit_or_discard(o, 0);
    }
    return stream;
}

/* Closes the file and moves it to the target. Returns 1 if a complete target exists afterwards. Returns 0 if anything
   failed or *cancel is not 0; the old target is then unchanged, unless it is written in place. complete: 0 if the
   writer failed */
static int output_close(output_file *o, FILE *stream, int complete, const volatile sig_atomic_t *cancel) {
    if (ferror(stream)) complete = 0;
    if (complete && !o->in_place && (fflush(stream) != 0 || fsync(fileno(stream)) != 0)) complete = 0;
    if (fclose(stream) != 0) complete = 0;
    if (o->in_place) return complete;
    if (complete && cancel && *cancel) {
        errno = EINTR;
        complete = 0;
    }
    return output__commit_or_discard(o, complete);
}

typedef int (*output_writer)(FILE *out, const void *what);  /* returns 0 on failure, and may then set errno */

/* Opens a file, calls a writer and closes the file. Returns the result of output_close. */
static inline int output_write(output_file *o, output_writer write, const void *what,
                               const volatile sig_atomic_t *cancel) {
    FILE *out = output_open(o);
    int ok;
    if (!out) return 0;
    errno = 0;
    ok = write(out, what);
    return output_close(o, out, ok, cancel);
}

/* Creates and removes a temporary file to test whether the target can be written. Returns 1 if it can. Called before
   long work. */
static inline int output_check(output_file *o) {
    FILE *stream;
    if (o->path && o->in_place) return 1; /* opening a pipe would wait for its reader */
    stream = output_open(o);
    if (stream) output_close(o, stream, 0, NULL);
    return stream != NULL;
}

#endif
