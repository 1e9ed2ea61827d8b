/* Runs command line tools for tests as a user would, in a temporary folder: build/sbl_render, or after tool_use("NAME")
   another tool. Include after test.h.
       int main(int argc, char **argv) {
           if (!tool_begin(argv[0])) return 1;
           ...  TOOL("room.obj", "-o", "room.png") == 0, and `ran` holds its output
           tool_end(); */
#ifndef TOOL_H
#define TOOL_H

#include <errno.h>
#include <fcntl.h>
#include <ftw.h>
#include <math.h>
#include <poll.h>
#include <signal.h>
#include <stdint.h>
#include <stdlib.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>
#define STB_IMAGE_IMPLEMENTATION
#define STBI_ONLY_PNG
#include <stb/stb_image.h>
#if defined(__SANITIZE_ADDRESS__)
  #define SANITIZED 1
#elif defined(__has_feature)
  #if __has_feature(address_sanitizer)
    #define SANITIZED 1
  #endif
#endif
#ifndef SANITIZED
  #define SANITIZED 0
#endif

static char tool[1024], folder[64];

/* A run of a tool with sanitizers takes three times as long as one without. Therefore a test program with sanitizers
   starts the sanitized tool for the first of every four runs, and the plain tool for the others. SANITIZE_ALL=1 in the
   environment makes all runs sanitized. */
enum { RUNS_PER_SANITIZED_RUN = 4 };
static char plain_tool[1024]; /* empty if all runs start the same program */

static struct {
    int status; /* exit status, or minus the number of a signal */
    char out[65536], err[16384];
    int out_lines, err_lines;
} ran;

static void read_text(const char *path, char *text, size_t size, int *lines) {
    FILE *in = fopen(path, "rb");
    size_t n = in ? fread(text, 1, size - 1, in) : 0, i;
    if (in) fclose(in);
    text[n] = 0;
    *lines = n && text[n - 1] != '\n';
    for (i = 0; i < n; i++) *lines += text[i] == '\n';
}

enum { MOST_ARGUMENTS = 48 };

/* In mode gi, these come before the arguments of the test, which can override them. A small store of bounced light is
   fast. */
static const char *const first_arguments[] = { "--bounce-samples", "1024" };
enum { FIRST_ARGUMENTS = 2 };

/* Returns 1 if the run measures bounced light, because the mode is gi, the default. Returns 0 for host_lightmap,
   sbl_merge and scene_to_gltf, which do not have the option, and for --channel albedo. */
static int bounces(const char *const *arguments) {
    if (strstr(tool, "host_lightmap") || strstr(tool, "sbl_merge") || strstr(tool, "scene_to_gltf")) return 0;
    for (; arguments[0] && arguments[1]; arguments++) {
        if (strcmp(arguments[0], "--channel") == 0 && strcmp(arguments[1], "albedo") == 0) return 0;
        if (strcmp(arguments[0], "--mode") == 0) return strcmp(arguments[1], "gi") == 0;
    }
    return 1;
}

static void (*in_child)(void); /* if not NULL, called in the child process before the tool starts */

/* Returns the path of the program for the next run of the tool. */
static char *next_program(void) {
    static int runs;
    return *plain_tool && runs++ % RUNS_PER_SANITIZED_RUN ? plain_tool : tool;
}

/* Starts the tool in the folder of the test. terminal: handle of its stderr, or -1. file_limit: largest size of a file
   in bytes, or 0 for no limit */
static pid_t start(const char *const *arguments, int terminal, rlim_t file_limit) {
    char *argv[FIRST_ARGUMENTS + MOST_ARGUMENTS + 2];
    int i, k = 1;
    pid_t child;
    argv[0] = next_program();
    for (i = 0; i < FIRST_ARGUMENTS && bounces(arguments); i++) argv[k++] = (char *)(uintptr_t)first_arguments[i];
    for (i = 0; arguments[i] && i < MOST_ARGUMENTS; i++) argv[k++] = (char *)(uintptr_t)arguments[i];
    argv[k] = NULL;
    fflush(NULL);
    child = fork();
    if (child == 0) {
        int in = open("/dev/null", O_RDONLY), out, err;
        if (chdir(folder) != 0) _exit(99);
        out = open("stdout", O_WRONLY | O_CREAT | O_TRUNC, 0666);
        err = terminal >= 0 ? terminal : open("stderr", O_WRONLY | O_CREAT | O_TRUNC, 0666);
        dup2(in, 0);
        dup2(out, 1);
        dup2(err, 2);
        if (file_limit) {
            struct rlimit limit;
            limit.rlim_cur = limit.rlim_max = file_limit;
            setrlimit(RLIMIT_FSIZE, &limit);
        }
        if (in_child) in_child();
        execv(argv[0], argv);
        _exit(99);
    }
    return child;
}

static void finish(pid_t child) {
    char path[128];
    int status = 0;
    while (waitpid(child, &status, 0) < 0 && errno == EINTR) continue;
    ran.status = WIFEXITED(status) ? WEXITSTATUS(status) : -WTERMSIG(status);
    snprintf(path, sizeof path, "%s/stdout", folder);
    read_text(path, ran.out, sizeof ran.out, &ran.out_lines);
    snprintf(path, sizeof path, "%s/stderr", folder);
    read_text(path, ran.err, sizeof ran.err, &ran.err_lines);
}

static int run(const char *const *arguments) {
    finish(start(arguments, -1, 0));
    return ran.status;
}
#define TOOL(...) run((const char *const[]){ __VA_ARGS__, NULL })
#define SMALL "--samples", "1"

/* Returns the length of the longest line of a text. */
static inline int longest_line(const char *text) {
    int longest = 0;
    for (; *text; text += strcspn(text, "\n"), text += *text == '\n')
        if ((int)strcspn(text, "\n") > longest) longest = (int)strcspn(text, "\n");
    return longest;
}

static inline int said(const char *words) { return strstr(ran.err, words) != NULL; }

/* ---- signals ---- */

enum { SIGNALS = 3 };
static const int signals[SIGNALS] = { SIGINT, SIGTERM, SIGHUP };

/* Restores the default handling of signals, because a shell without job control starts background jobs with SIGINT
   ignored. */
static inline void hear_signals(void) {
    int i;
    for (i = 0; i < SIGNALS; i++) signal(signals[i], SIG_DFL);
}

static char on_terminal[1 << 18];

/* Runs the tool on a terminal until its progress bar shows `percent`, then sends the signal. The output goes to
   on_terminal, and its end to ran.err. Returns 0 if the system provides no terminals. */
static inline int interrupt_at(const char *const *arguments, int percent, int number) {
    struct pollfd waiting;
    size_t n = 0;
    int master = posix_openpt(O_RDWR | O_NOCTTY), slave = -1, sent = 0;
    const char *name;
    pid_t child;
    if (master < 0 || grantpt(master) != 0 || unlockpt(master) != 0 || (name = ptsname(master)) == NULL ||
        (slave = open(name, O_RDWR | O_NOCTTY)) < 0)
        return 0;
    in_child = hear_signals;
    child = start(arguments, slave, 0);
    in_child = NULL;
    close(slave);
    waiting.fd = master;
    waiting.events = POLLIN;
    while (poll(&waiting, 1, -1) > 0 && n < sizeof on_terminal - 1) {
        const ssize_t got = read(master, on_terminal + n, sizeof on_terminal - 1 - n);
        const char *last;
        if (got <= 0) break;
        on_terminal[n += (size_t)got] = 0;
        last = strrchr(on_terminal, ']');
        if (!sent && last && strchr(last, '%') && atoi(last + 1) >= percent) {
            kill(child, number);
            sent = 1;
        }
    }
    finish(child);
    close(master);
    on_terminal[n] = 0;
    snprintf(ran.err, sizeof ran.err, "%.500s", on_terminal + (n < 500 ? 0 : n - 500));
    return 1;
}

/* ---- files ---- */

static char *in_folder(const char *name) {
    static char path[8][512];
    static int next;
    next = (next + 1) % 8;
    snprintf(path[next], sizeof path[next], "%s/%s", folder, name);
    return path[next];
}

/* Returns the number that follows the words in a file in the folder of the test, or -1. */
static inline double number_after(const char *name, const char *words) {
    static char text[16384];
    const char *at;
    int lines;
    read_text(in_folder(name), text, sizeof text, &lines);
    at = strstr(text, words);
    return at ? atof(at + strlen(words)) : -1;
}

static int exists(const char *name) {
    struct stat info;
    return stat(in_folder(name), &info) == 0;
}

static void write_file(const char *name, const void *data, size_t size) {
    FILE *out = fopen(in_folder(name), "wb");
    if (out) {
        fwrite(data, 1, size, out);
        fclose(out);
    }
}
static void write_text(const char *name, const char *text) { write_file(name, text, strlen(text)); }

/* Starts the tool, and waits until a file exists or the tool ends. */
static inline pid_t start_until(const char *const *arguments, const char *name) {
    static const struct timespec pause = { 0, 2000000 };
    const pid_t child = start(arguments, -1, 0);
    siginfo_t info;
    memset(&info, 0, sizeof info);
    while (!exists(name) && waitid(P_PID, (id_t)child, &info, WEXITED | WNOHANG | WNOWAIT) == 0 && !info.si_pid)
        nanosleep(&pause, NULL);
    return child;
}

/* Replaces a text of a file in the folder of the test, which has at most 4095 bytes, once. Returns 0 if the file does
   not contain it. */
static inline int replace_in(const char *name, const char *from, const char *to) {
    static char before[4096], after[4096];
    const char *at;
    int lines;
    read_text(in_folder(name), before, sizeof before, &lines);
    at = strstr(before, from);
    if (!at) return 0;
    snprintf(after, sizeof after, "%.*s%s%s", (int)(at - before), before, to, at + strlen(from));
    write_text(name, after);
    return 1;
}

/* Returns the number of finished windows of an output. */
static inline int finished_windows(const char *output) {
    char name[64];
    int i, count = 0;
    for (i = 1; i < 100; i++) {
        snprintf(name, sizeof name, "%s.parts/%d.exr", output, i);
        count += exists(name);
    }
    return count;
}

/* Starts the tool, and waits until `count` windows of the output are finished or the tool ends. */
static inline pid_t start_windows(const char *const *arguments, const char *output, int count) {
    char last[64];
    snprintf(last, sizeof last, "%s.parts/%d.exr", output, count);
    return start_until(arguments, count ? last : ".");
}

/* Kills the tool as soon as `count` windows are finished. Returns 1 if it was killed before it ended. */
static inline int kill_when(const char *const *arguments, const char *output, int count) {
    const pid_t child = start_windows(arguments, output, count);
    kill(child, SIGKILL);
    finish(child);
    return ran.status == -SIGKILL;
}

/* Runs the tool once for each of `count` parts, with the arguments, --part K/N and -o PATTERN; the tool replaces %d in
   the pattern by K. Returns 1 if all runs succeeded. */
static inline int run_parts(const char *const *arguments, const char *pattern, int count) {
    const char *all[40];
    char part[32];
    int k, i = 0, ok = 1;
    for (; arguments[i]; i++) all[i] = arguments[i];
    all[i] = "--part";
    all[i + 1] = part;
    all[i + 2] = "-o";
    all[i + 3] = pattern;
    all[i + 4] = NULL;
    for (k = 1; k <= count && ok; k++) {
        snprintf(part, sizeof part, "%d/%d", k, count);
        ok = run(all) == 0;
    }
    return ok;
}

static int leftovers;
static int count_leftover(const char *path, const struct stat *info, int kind, struct FTW *where) {
    (void)info;
    (void)kind;
    (void)where;
    leftovers += strlen(path) > 5 && strcmp(path + strlen(path) - 5, ".part") == 0;
    return 0;
}
static int parts_left(void) {
    leftovers = 0;
    nftw(folder, count_leftover, 8, FTW_PHYS);
    return leftovers;
}

/* Returns 1 if two files exist and are equal. */
static inline int same_files(const char *a, const char *b) {
    FILE *in[2] = { fopen(in_folder(a), "rb"), fopen(in_folder(b), "rb") };
    int c[2] = { 0, 0 }, k;
    while (in[0] && in[1] && c[0] == c[1] && c[0] != EOF)
        for (k = 0; k < 2; k++) c[k] = fgetc(in[k]);
    for (k = 0; k < 2; k++) if (in[k]) fclose(in[k]);
    return in[0] && in[1] && c[0] == c[1];
}

/* Copies `from` to `to` without its last `missing` bytes, and, if `at` is not negative, with a changed byte at the
   offset `at`. */
static inline void damage(const char *from, const char *to, long missing, long at) {
    static char bytes[1 << 18];
    FILE *in = fopen(in_folder(from), "rb");
    const size_t size = in ? fread(bytes, 1, sizeof bytes, in) : 0;
    if (in) fclose(in);
    if (at >= 0) bytes[at] = (char)~bytes[at];
    write_file(to, bytes, size - (size_t)missing);
}

typedef struct picture {
    int width, height;
    float *values;
} picture; /* three values per pixel, top row first */

static inline picture read_pfm(const char *name) {
    picture p = { 0, 0, NULL };
    FILE *in = fopen(in_folder(name), "rb");
    float scale = 0;
    int y, head = 0, length;
    char line[64];
    if (!in) return p;
    if (fgets(line, sizeof line, in) && strcmp(line, "PF\n") == 0 &&
        fscanf(in, "%d %d\n%f%n", &p.width, &p.height, &scale, &head) == 3 && fgetc(in) == '\n' && scale < 0 &&
        p.width > 0 && p.height > 0 && p.width < 4096 && p.height < 4096) {
        length = 3 * p.width;
        p.values = (float *)calloc((size_t)(length * p.height), sizeof(float));
        for (y = p.height - 1; y >= 0; y--)
            if (fread(p.values + y * length, sizeof(float), (size_t)length, in) != (size_t)length) break;
        if (y >= 0 || fgetc(in) != EOF) {
            free(p.values);
            p.values = NULL;
        }
    }
    fclose(in);
    return p;
}

/* Returns the mean absolute difference of two .pfm files, relative to the mean of the first; a negative number if their
   sizes differ. */
static inline double mean_difference(const char *a, const char *b) {
    picture p = read_pfm(a), q = read_pfm(b);
    double off = 0, mean = 0;
    int i;
    if (!p.values || !q.values || p.width != q.width || p.height != q.height) mean = -1;
    for (i = 0; mean >= 0 && i < 3 * p.width * p.height; i++) {
        off += fabs((double)p.values[i] - (double)q.values[i]);
        mean += fabs((double)p.values[i]);
    }
    free(p.values);
    free(q.values);
    return mean > 0 ? off / mean : mean;
}

/* Writes room.obj: a lamp over a floor, in front of a wall. Some numbers have no zero before the point. */
static inline void room_obj(void) {
    write_text("room.mtl", "newmtl floor\nKd .7 .5 .3\nnewmtl lamp\nKd 0 0 0\nKe 5 6 7\n");
    write_text(
        "room.obj",
        "mtllib room.mtl\nv -2 0 -2\nv -2 0 2\nv 2 0 2\nv 2 0 -2\nv -.5 1 -.5\nv .5 1 -.5\nv .5 1 .5\nv -.5 1 .5\n"
        "v -2 2 -2\nv 2 2 -2\nusemtl floor\nf 1 2 3 4\nf 1 4 10 9\nusemtl lamp\nf 5 6 7 8\n");
}
#define ROOM "room.obj", "--eye", "0,1.4,3", "--look-at", "0,.5,0", "--size", "24x16", SMALL

/* Makes later runs use build/NAME. */
static inline void tool_use(const char *name) {
    strcpy(strrchr(tool, '/') + 1, name);
    if (*plain_tool) strcpy(strrchr(plain_tool, '/') + 1, name);
}

/* Creates the temporary folder. Returns 0 on failure. */
static int tool_begin(const char *argv0) {
    const char *slash = strrchr(argv0, '/'), *temporary = getenv("TMPDIR");
    char here[700], *full;
    snprintf(here, sizeof here, "%.*s", slash ? (int)(slash - argv0) : 1, slash ? argv0 : ".");
    full = realpath(here, NULL);
    snprintf(tool, sizeof tool, "%.900s/sbl_render", full ? full : here);
    free(full);
    if (SANITIZED) {
        const char *sanitized = strstr(tool, "/sanitize/sbl_render");
        if (sanitized && !getenv("SANITIZE_ALL"))
            snprintf(plain_tool, sizeof plain_tool, "%.*s/sbl_render", (int)(sanitized - tool), tool);
        /* Some test files request dozens of gigabytes. With sanitizers, the sanitizer must refuse what the memory limit
           refuses otherwise. */
        const char *options = getenv("ASAN_OPTIONS");
        char more[512];
        snprintf(more, sizeof more, "%.400s%smax_allocation_size_mb=1024", options ? options : "",
                 options && *options ? ":" : "");
        setenv("ASAN_OPTIONS", more, 1);
    }
    snprintf(folder, sizeof folder, "%.40s/sbl_cli_XXXXXX", temporary && *temporary ? temporary : "/tmp");
    if (!mkdtemp(folder)) {
        printf("no temporary folder %s\n0 passed, 1 failed, 0 skipped\n", folder);
        return 0;
    }
    return 1;
}

static int remove_entry(const char *path, const struct stat *info, int kind, struct FTW *where) {
    (void)info;
    (void)kind;
    (void)where;
    return remove(path);
}
static void tool_end(void) { nftw(folder, remove_entry, 16, FTW_DEPTH | FTW_PHYS); }

#endif
