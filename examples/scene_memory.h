/* Part of scene_file.h: the memory limit, and allocation in the pages that child and parent share.

   One limit covers all memory that a file can make the program use: the shared pages, the memory of the child itself
   (RLIMIT_DATA stops libraries that allocate too much), and the predicted memory for rendering the scene. Where an
   amount is known in advance, scene__afford checks it, so that the message can name its purpose. */
#ifndef SCENE_MEMORY_H
#define SCENE_MEMORY_H

#include <stdlib.h>
#include <sys/resource.h>
#include <unistd.h>

static double scene__gigabytes(double bytes) { return bytes / (1 << 30); }

/* Returns the number with the index `field` (from 0) in a file of numbers, times unit; SIZE_MAX if there is none. */
static size_t scene__number_in(const char *path, int field, size_t unit) {
    unsigned long long number = 0;
    FILE *in = fopen(path, "r");
    int ok = in != NULL;
    for (; ok && field >= 0; field--) ok = fscanf(in, "%llu", &number) == 1;
    if (in) fclose(in);
    return ok && number <= SIZE_MAX / unit ? (size_t)number * unit : SIZE_MAX;
}

/* Returns the memory limit of the control groups (version 1 or 2) of this process: the smallest limit of its group and
   all groups above it. In a container, the path may be the path on the host and not exist; the root group always
   exists. groups: /proc/self/cgroup; mount: /sys/fs/cgroup */
static size_t scene__group_limit(const char *groups, const char *mount) {
    char line[1024], path[2200], *name, *end;
    size_t least = SIZE_MAX, limit;
    FILE *in = fopen(groups, "r");
    while (in && fgets(line, sizeof line, in)) {
        const int second = strncmp(line, "0::", 3) == 0;
        line[strcspn(line, "\n")] = 0;
        name = strchr(line, '/');
        if (!name || (!second && !(strstr(line, "memory") && strstr(line, "memory") < name))) continue;
        for (end = name + strlen(name); end; end = strrchr(name, '/')) {
            *end = 0;
            scene__print(path, sizeof path, "%s%s%s/%s", mount, second ? "" : "/memory", name,
                         second ? "memory.max" : "memory.limit_in_bytes");
            limit = scene__number_in(path, 0, 1);
            if (limit < least) least = limit;
        }
    }
    if (in) fclose(in);
    return least;
}

/* Returns the memory limit in bytes. The address space that ulimit -v leaves is divided by two, because the shared
   pages and the memory of the child both need it. wanted: the user's choice, or 0 */
static size_t scene__memory_limit(size_t wanted) {
    const size_t page = (size_t)sysconf(_SC_PAGESIZE), machine = (size_t)sysconf(_SC_PHYS_PAGES);
    const size_t group = scene__group_limit("/proc/self/cgroup", "/sys/fs/cgroup");
    size_t limit = machine < SIZE_MAX / page ? machine * page : SIZE_MAX, taken;
    struct rlimit space;
    if (group < limit) limit = group;
    limit = wanted ? wanted : limit / 2;
    if (getrlimit(RLIMIT_AS, &space) == 0 && space.rlim_cur != RLIM_INFINITY) {
        taken = scene__number_in("/proc/self/statm", 0, page);
        if (taken > space.rlim_cur) taken = space.rlim_cur;
        if (limit > (space.rlim_cur - taken) / 2) limit = (space.rlim_cur - taken) / 2;
    }
    return limit;
}

/* ---- functions of the child ---- */

/* Returns the bytes that this process has allocated since its start, not counting the shared pages. */
static size_t scene__own_memory(const scene_file *file) {
    char text[128];
    unsigned long pages = 0;
    const ssize_t got = file->own_handle >= 0 ? pread(file->own_handle, text, sizeof text - 1, 0) : 0;
    size_t own;
    if (got <= 0) return 0;
    text[got] = 0;
    if (sscanf(text, "%*u %*u %*u %*u %*u %lu", &pages) != 1) return 0;
    own = (size_t)pages * (size_t)sysconf(_SC_PAGESIZE);
    return own > file->own_at_start ? own - file->own_at_start : 0;
}

/* Limits the memory of the child itself to what the shared pages leave of the limit. With sanitizers, which exceed any
   limit, only scene__afford checks. */
static void scene__limit_own_memory(const scene_file *file) {
    struct rlimit limit;
    limit.rlim_cur = limit.rlim_max = file->own_at_start + (file->memory - file->used);
    if (!SCENE__SANITIZED) setrlimit(RLIMIT_DATA, &limit);
}

/* Returns 1 if the limit allows further memory; otherwise sets the error. reading: bytes that the child needs now, in
   addition to its current memory. rendering: bytes that rendering will need later, when the child has ended. what: the
   purpose for the message, such as "texture wood.png" */
static int scene__afford(scene_file *file, const char *what, double reading, double rendering) {
    const double now = reading + (double)scene__own_memory(file), later = rendering + file->rendering;
    const double total = (double)file->used + (now > later ? now : later);
    if (total <= (double)file->memory) {
        file->rendering += rendering;
        return 1;
    }
    scene__fail(file, "%.200s needs %.3g GB of memory, which makes %.3g GB in all; the limit is %.3g GB: use a smaller "
                "one, or allow more with --memory", what, scene__gigabytes(now > later ? reading : rendering),
                scene__gigabytes(total), scene__gigabytes((double)file->memory));
    return 0;
}

/* Sets the error after a library ran out of memory. */
static void scene__fail_for_memory(scene_file *file, const char *what) {
    scene__fail(file, "%.200s needs more memory than the limit of %.3g GB; use a smaller one, or allow more with "
                "--memory", what, scene__gigabytes((double)file->memory));
}

/* Allocates zeroed memory in the shared pages. Returns NULL and sets the error if they are full. */
static void *scene__alloc(scene_file *file, size_t count, size_t bytes) {
    const size_t step = 20;  /* the limits are checked once per megabyte */
    size_t room = file->capacity - file->used, size;
    if (bytes && count > (SIZE_MAX - 15) / bytes) room = 0;
    size = (count * bytes + 15) & ~(size_t)15;
    if (size > room) { scene__fail_for_memory(file, "it"); return NULL; }
    if ((file->used + size) >> step != file->used >> step && !scene__afford(file, "it", (double)size, 0)) return NULL;
    file->used += size;
    if (file->used >> step != (file->used - size) >> step) scene__limit_own_memory(file);
    return (char *)file + file->used - size;
}

#endif
