/* Writes files whole or not at all: what is written goes to a new file in the same folder, which takes the target's
   name at the end. Needs POSIX; include with _DEFAULT_SOURCE defined before the first header.

       output_file out;
       FILE *stream;
       output_find(&out, "room.png");
       stream = output_open(&out);
       if (stream) { whole = write(..., stream); ok = output_close(&out, stream, whole, NULL); }
       output_free(&out);

   A file that is there already gives its permissions, and where the system lets us its owner and group, to the new one.
   Symbolic links are followed and stay. A hard link is cut: other names keep the old file, since a file that is written
   in place is not whole meanwhile. Devices, pipes and /dev/stdout are written to as they are.

   All that fails says why in errno. One file can be open at a time; output_abandon removes it, in a signal handler. */
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
    const char *name; /* as it was given */
    char *path;       /* where that leads: absolute, without links; NULL: nowhere */
    int error;        /* why nowhere */
    int in_place;     /* it is written to as it is */
    char *temporary;  /* while it is open */
} output_file;

/* ---- where a name leads ---- */

/* folder/name, to be freed; a folder of so many characters. */
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

/* The same name in the true folder; NULL where there is no such folder. Frees path. */
static char *output__true_folder(char *path) {
    char *slash = path ? strrchr(path, '/') : NULL, *folder, *whole = NULL;
    const char *name = slash ? slash + 1 : path;
    if (slash == path) return path; /* the root; or NULL */
    if (slash) *slash = 0;
    folder = realpath(slash ? path : ".", NULL);
    if (folder) whole = output__join(folder, strlen(folder), name);
    free(folder);
    free(path);
    return whole;
}

/* Links of /dev and /proc lead to what this process has open, which has no name of its own. */
static int output__is_handle(const char *path) {
    return strncmp(path, "/dev/std", 8) == 0 || strncmp(path, "/dev/fd/", 8) == 0 || strncmp(path, "/proc/", 6) == 0;
}

/* realpath demands that the file be there; a link may also lead to where one is to be. */
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

/* Returns 0 where the name leads nowhere. */
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

/* Writing both would spoil one: they are the same file, or will be. What a device takes it does not keep. */
static int output_same(const output_file *a, const output_file *b) {
    struct stat of_a, of_b;
    if (!a->path || !b->path) return 0;
    if (stat(a->path, &of_a) != 0 || stat(b->path, &of_b) != 0) return strcmp(a->path, b->path) == 0;
    return of_a.st_dev == of_b.st_dev && of_a.st_ino == of_b.st_ino && !S_ISCHR(of_a.st_mode);
}

/* ---- writing ---- */

static char *volatile output__open; /* the temporary file that is there now */

/* For signal handlers, on the way out. */
static inline void output_abandon(void) {
    if (output__open) unlink(output__open);
}

/* Creates a file that was not there, in the folder of path, with an unpredictable name; in *name, to be freed. Its name
   does not contain the target's, which may be as long as names can be. */
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
        sigprocmask(SIG_SETMASK, &all, &before); /* a handler that removes it must know of it once it is there */
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

/* The temporary file gets its name, or goes; returns whether it got it. */
static int output__done(output_file *o, int whole) {
    int error;
    if (whole && rename(o->temporary, o->path) != 0) whole = 0;
    error = errno;
    if (!whole) unlink(o->temporary);
    output__open = NULL;
    free(o->temporary);
    o->temporary = NULL;
    errno = error;
    return whole;
}

/* NULL where it cannot be written. */
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
        /* A group that it cannot have must not get the rights of another one. */
        const int grouped = fchown(handle, old.st_uid, old.st_gid) == 0 || fchown(handle, (uid_t)-1, old.st_gid) == 0;
        fchmod(handle, old.st_mode & (grouped ? 0777 : 0707));
    }
    stream = fdopen(handle, "wb");
    if (!stream) {
        close(handle);
        output__done(o, 0);
    }
    return stream;
}

/* whole: all was written, as far as the writer knows. 1: it is whole, and has its name. 0: nothing has changed; also
   where *cancel is not 0 by then. */
static int output_close(output_file *o, FILE *stream, int whole, const volatile sig_atomic_t *cancel) {
    if (ferror(stream)) whole = 0;
    if (fclose(stream) != 0) whole = 0;
    if (o->in_place) return whole;
    if (whole && cancel && *cancel) {
        errno = EINTR;
        whole = 0;
    }
    return output__done(o, whole);
}

/* Could it be written? Found out before the work, not after it. */
static int output_check(output_file *o) {
    FILE *stream;
    if (o->path && o->in_place) return 1; /* opening a pipe waits for its reader */
    stream = output_open(o);
    if (stream) output_close(o, stream, 0, NULL);
    return stream != NULL;
}

#endif
