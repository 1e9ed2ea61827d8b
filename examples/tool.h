/* Messages, signals and a progress bar for all tools. Include after sbl.h and output_file.h. Define TOOL_NAME (such as
   "sbl_render") and TOOL_MAKES (such as "picture") first. */
#ifndef TOOL_H
#define TOOL_H

#include <signal.h>
#include <sys/resource.h>
#include <sys/mman.h>
#include <sys/time.h>

/* Exit statuses. After a signal, the status is INTERRUPTED plus the number of the signal. */
enum { DONE = 0, FAILED = 1, BAD_USAGE = 2, INTERRUPTED = 128 };

static volatile sig_atomic_t interrupted;  /* number of the received signal, or 0 */

#define DRIVER_WAIT 6  /* seconds after a signal until the program ends, if the driver does not return */

/* Notes a signal. A second signal ends the program at once. */
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
    signal(SIGXFSZ, SIG_IGN);  /* exceeding the file size limit also becomes a failed write */
    /* Opens standard handles that are closed. Otherwise an output file could get number 2 and receive messages. */
    do handle = open("/dev/null", O_RDWR);
    while (handle >= 0 && handle <= STDERR_FILENO);
    if (handle >= 0) close(handle);
}

static double now(void) {
    struct timeval t;
    gettimeofday(&t, NULL);
    return (double)t.tv_sec + 1e-6 * (double)t.tv_usec;
}

/* ---- messages, each of one line, even if names of files and meshes contain line breaks ---- */

static void say(const char *kind, const char *format, va_list arguments) {
    char text[1024], *c;
    vsnprintf(text, sizeof text, format, arguments);
    for (c = text; *c; c++)
        if ((unsigned char)*c < 32 || *c == 127) *c = '?';
    fprintf(stderr, TOOL_NAME ": %s%s\n", kind, text);
}

/* The functions fail, misuse and stop print a message and return the exit status. */
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

static inline void tell(const char *format, ...) {
    va_list arguments;
    va_start(arguments, format);
    say("", format, arguments);
    va_end(arguments);
}

static inline void warn(const char *format, ...) {
    va_list arguments;
    va_start(arguments, format);
    say("warning: ", format, arguments);
    va_end(arguments);
}

static int verbose;  /* 1: --verbose was given */

/* With --verbose, prints a choice or finding of the tool in one line. */
static inline void detail(const char *format, ...) {
    va_list arguments;
    if (!verbose) return;
    va_start(arguments, format);
    say("", format, arguments);
    va_end(arguments);
}

/* ---- progress ---- */

typedef struct progress {
    int shown;
    double start, last;
    double from, to;  /* the current work moves the bar from this fraction to that one; both 0: the complete bar */
} progress;

static inline int on_progress(float done, void *user) {
    progress *p = (progress *)user;
    double time = now();
    if (p->to > 0) done = (float)(p->from + (double)done * (p->to - p->from));
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
    return 0;  /* never cancels, because that would lose the unfinished picture */
}

/* Erases the progress bar. */
static inline void clear_progress(const progress *p) { if (p->shown) fprintf(stderr, "\r%70s\r", ""); }

/* ---- running the work ---- */

#define WORK_SLICE 0.25  /* seconds per step; about the longest time until a signal is handled */
#define WORK_LINGER 2.0  /* seconds; see work_to_save */

/* Works until the result is finished, or returns SBL_UNFINISHED after a signal. */
static inline sbl_result work(sbl_context *context) {
    sbl_result result = SBL_UNFINISHED;
    while (result == SBL_UNFINISHED && !interrupted) result = sbl_step(context, WORK_SLICE);
    return result;
}

#define WORK_GLANCE 0.02  /* seconds per step of work_until, which looks for the channel before each step */

/* Works until a channel can be read, or until a signal arrives. */
static inline sbl_result work_until(sbl_context *context, sbl_channel channel) {
    sbl_result result = SBL_UNFINISHED;
    while (result == SBL_UNFINISHED && !interrupted && !sbl_channel_texture(context, channel))
        result = sbl_step(context, WORK_GLANCE);
    return result;
}

/* Works like `work` on a picture or lightmap. If a signal arrives before anything can be saved, it works for up to
   WORK_LINGER further seconds. In SBL_MODE_GI, asking for the channel makes sbl.h compute a first picture of direct
   light. */
static inline sbl_result work_to_save(sbl_context *context) {
    sbl_result result = work(context);
    const double end = now() + WORK_LINGER;
    while (result == SBL_UNFINISHED && now() < end && !sbl_channel_texture(context, SBL_CHANNEL_FINAL))
        result = sbl_step(context, WORK_SLICE);
    alarm(0);  /* the driver has returned; writing the unfinished result may take longer than DRIVER_WAIT */
    return result;
}

#endif
