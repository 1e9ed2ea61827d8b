/* Shared by the tools: messages, signals and a progress bar. Include after sbl.h, output_file.h and scene_file.h.
   Define TOOL_NAME (such as "sbl_render") and TOOL_MAKES (such as "picture") first. */
#ifndef TOOL_H
#define TOOL_H

#include <signal.h>
#include <sys/resource.h>
#include <sys/mman.h>
#include <sys/time.h>

/* Exit statuses. The number of the signal is added to INTERRUPTED. */
enum { DONE = 0, FAILED = 1, BAD_USAGE = 2, INTERRUPTED = 128 };

static volatile sig_atomic_t interrupted;  /* number of the signal that was received, or 0 */

#define DRIVER_WAIT 6  /* seconds after a signal until the program ends, if the driver does not return */

/* A second signal ends the program at once. */
static void on_interrupt(int number) {
    if (interrupted) { output_abandon(); _exit(INTERRUPTED + number); }
    interrupted = number;
    alarm(DRIVER_WAIT);
}

static void on_driver_wait(int number) {
    static const char line[] = TOOL_NAME ": interrupted; the graphics driver did not return, and nothing was saved\n";
    (void)number;
    output_abandon();
    if (write(STDERR_FILENO, line, sizeof line - 1) < 0) _exit(INTERRUPTED + interrupted);
    _exit(INTERRUPTED + interrupted);
}

static void catch_signals(void) {
    static const int numbers[] = { SIGINT, SIGTERM, SIGHUP };
    struct sigaction action, before;
    int i, handle;
    memset(&action, 0, sizeof action);
    action.sa_handler = on_interrupt;
    sigfillset(&action.sa_mask);
    for (i = 0; i < 3; i++)  /* a signal that nohup or the shell ignores stays ignored */
        if (sigaction(numbers[i], NULL, &before) == 0 && before.sa_handler != SIG_IGN)
            sigaction(numbers[i], &action, NULL);
    signal(SIGALRM, on_driver_wait);
    signal(SIGPIPE, SIG_IGN);  /* writing to a closed pipe fails instead of ending the program */
    signal(SIGXFSZ, SIG_IGN);  /* exceeding the limit on file size is a failed write, too */
    /* Open closed standard handles: otherwise an output file could get number 2, and receive messages. */
    do handle = open("/dev/null", O_RDWR);
    while (handle >= 0 && handle <= STDERR_FILENO);
    if (handle >= 0) close(handle);
}

static double now(void) {
    struct timeval t;
    gettimeofday(&t, NULL);
    return (double)t.tv_sec + 1e-6 * (double)t.tv_usec;
}

/* ---- messages: one line each, even if names of files and meshes contain line breaks ---- */

static void say(const char *kind, const char *format, va_list arguments) {
    char text[1024], *c;
    vsnprintf(text, sizeof text, format, arguments);
    for (c = text; *c; c++)
        if ((unsigned char)*c < 32 || *c == 127) *c = '?';
    fprintf(stderr, TOOL_NAME ": %s%s\n", kind, text);
}

/* fail, misuse and stop print a message and return the exit status. */
static int fail(const char *format, ...) {
    va_list arguments;
    va_start(arguments, format);
    say("", format, arguments);
    va_end(arguments);
    return FAILED;
}
static int misuse(const char *format, ...) {
    va_list arguments;
    va_start(arguments, format);
    say("", format, arguments);
    va_end(arguments);
    return BAD_USAGE;
}

static int stop(const char *format, ...) {
    va_list arguments;
    va_start(arguments, format);
    say("interrupted; ", format, arguments);
    va_end(arguments);
    return INTERRUPTED + interrupted;
}

static void tell(const char *format, ...) {
    va_list arguments;
    va_start(arguments, format);
    say("", format, arguments);
    va_end(arguments);
}

static void warn(const char *format, ...) {
    va_list arguments;
    va_start(arguments, format);
    say("warning: ", format, arguments);
    va_end(arguments);
}

static int verbose;  /* 1: --verbose was given */

/* Prints what the tool chose or found, in one line, only with --verbose. */
static inline void detail(const char *format, ...) {
    va_list arguments;
    if (!verbose) return;
    va_start(arguments, format);
    say("", format, arguments);
    va_end(arguments);
}

/* Messages from sbl.h. The first error is printed if the work fails; warnings are printed if it succeeds. */
typedef struct messages {
    char error[640];
    int errors;
    char warnings[8][512];
    int warnings_kept;
    char store[256];              /* what sbl_load_store has said, and its item; see load_store in tool_scene.h */
    sbl_log_item store_item;
    const scene_file *file;
} messages;

static void on_log(sbl_log_level level, sbl_log_item item, const char *message, void *user) {
    messages *m = (messages *)user;
    int mesh;
    if (item == SBL_LOG_ITEM_INVALID_STORE || item == SBL_LOG_ITEM_OTHER_STORE || item == SBL_LOG_ITEM_COARSE_STORE) {
        const char *words = strstr(message, ": ");  /* after the name of the function */
        snprintf(m->store, sizeof m->store, "%.250s", words ? words + 2 : message);
        m->store_item = item;
        return;
    }
    if (level == SBL_LOG_ERROR && m->errors++ == 0) {
        if (m->file && sscanf(message, "mesh %d:", &mesh) == 1 && mesh >= 0 && mesh < m->file->scene.mesh_count)
            snprintf(m->error, sizeof m->error, "%.500s (mesh %d is \"%.100s\")", message, mesh, m->file->names[mesh]);
        else snprintf(m->error, sizeof m->error, "%.600s", message);
    }
    if (level == SBL_LOG_WARNING && m->warnings_kept < 8)
        snprintf(m->warnings[m->warnings_kept++], sizeof m->warnings[0], "%.500s", message);
}

/* Keeps a warning, which is printed at the end if the work succeeds. */
static inline void warn_later(messages *m, const char *format, ...) {
    va_list arguments;
    if (m->warnings_kept == 8) return;
    va_start(arguments, format);
    vsnprintf(m->warnings[m->warnings_kept++], sizeof m->warnings[0], format, arguments);
    va_end(arguments);
}

static int fail_with(const messages *m, const char *where, sbl_result result) {
    if (!m->errors) return fail("%s: %s", where, sbl_result_string(result));
    if (m->errors == 1) return fail("%s: %s", where, m->error);
    return fail("%s: %s (and %d more errors)", where, m->error, m->errors - 1);
}

/* ---- progress ---- */

typedef struct progress { int shown; double start, last; } progress;

static inline int on_progress(float done, void *user) {
    progress *p = (progress *)user;
    double time = now();
    if (p->shown && (p->last <= 0 || time - p->last > 0.1)) {
        double left = done > 0.01f ? (time - p->start) * (1 - (double)done) / (double)done : -1;
        char bar[41];
        int i;
        for (i = 0; i < 40; i++) bar[i] = (float)i < 40 * done ? '#' : '.';
        bar[40] = 0;
        fprintf(stderr, "\r[%s] %3d %%", bar, (int)(100 * done));
        if (left >= 0) fprintf(stderr, "  %d:%02d left ", (int)left / 60, (int)left % 60);
        fflush(stderr);
        p->last = time;
    }
    return 0;  /* never cancels: that would lose the unfinished picture */
}

/* ---- work ---- */

#define WORK_SLICE 0.25  /* seconds; about the longest time until a signal is handled */
#define WORK_LINGER 2.0  /* seconds; a second signal ends the program at once */

/* Works until the picture is finished, or returns SBL_UNFINISHED when a signal arrives. */
static inline sbl_result work(sbl_context *context) {
    sbl_result result = SBL_UNFINISHED;
    while (result == SBL_UNFINISHED && !interrupted) result = sbl_step(context, WORK_SLICE);
    return result;
}

#define WORK_GLANCE 0.02  /* seconds; the slices of work_until are short, because it looks for the channel after each */

/* Works until a channel can be read, or a signal arrives. */
static inline sbl_result work_until(sbl_context *context, sbl_channel channel) {
    sbl_result result = SBL_UNFINISHED;
    while (result == SBL_UNFINISHED && !interrupted && !sbl_channel_texture(context, channel))
        result = sbl_step(context, WORK_GLANCE);
    return result;
}

/* Like `work` for pictures and lightmaps, but works on for up to WORK_LINGER seconds after a signal if there is nothing
   to save yet. In SBL_MODE_GI, sbl.h makes a first picture of direct light when it is asked for one. */
static inline sbl_result work_to_save(sbl_context *context) {
    sbl_result result = work(context);
    const double end = now() + WORK_LINGER;
    while (result == SBL_UNFINISHED && now() < end && !sbl_channel_texture(context, SBL_CHANNEL_FINAL))
        result = sbl_step(context, WORK_SLICE);
    alarm(0);  /* the driver has returned; the unfinished work may take long to write */
    return result;
}

/* ---- ulimit -v: GL drivers crash if they get no memory ---- */

static void on_breakdown(int number) {
    static const char line[] = TOOL_NAME ": the graphics driver crashed because memory ran out; raise the limit of "
        "ulimit -v\n";
    (void)number;
    if (write(STDERR_FILENO, line, sizeof line - 1) >= 0) _exit(FAILED);
    _exit(FAILED);
}

/* Returns whether ulimit -v leaves enough address space for a GL driver. If there is a limit, a driver that crashes
   from now on ends the program with a message. */
static int check_address_space(void) {
    const size_t driver = (size_t)512 << 20;  /* what Mesa's software renderer needs on two cores */
    struct rlimit limit;
    void *room;
    if (getrlimit(RLIMIT_AS, &limit) != 0 || limit.rlim_cur == RLIM_INFINITY) return 1;
    signal(SIGSEGV, on_breakdown);
    signal(SIGBUS, on_breakdown);
    signal(SIGABRT, on_breakdown);
    room = mmap(NULL, driver, PROT_NONE, MAP_PRIVATE | MAP_ANONYMOUS | MAP_NORESERVE, -1, 0);
    if (room != MAP_FAILED) munmap(room, driver);
    return room != MAP_FAILED;
}


static void on_confined(const char *path, const char *message, void *user) {
    (void)user;
    tell("%s: protection of the process that read it: %s", path, message);
}

/* ---- files ---- */

/* Opens a regular file for reading, and never waits for a pipe or a device. Returns NULL and sets errno on failure. */
static inline FILE *input_open(const char *name) {
    const int handle = scene__open_regular(NULL, name);
    FILE *in = handle < 0 ? NULL : fdopen(handle, "rb");
    if (handle >= 0 && !in) close(handle);
    return in;
}

static size_t put_bytes(const void *data, size_t bytes, void *user) { return fwrite(data, 1, bytes, (FILE *)user); }
static size_t get_bytes(void *data, size_t bytes, void *user) { return fread(data, 1, bytes, (FILE *)user); }

#endif
