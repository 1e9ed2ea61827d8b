/* Part of scene_file.h: the child process that reads the file.

   The parent maps shared pages, which begin with a scene_file, and forks. The child opens the file, confines itself,
   reads, and exits. The parent waits until the child has ended, and kills it at the deadline or when the user cancels.
   The parent uses the content of the pages only if the child succeeded. */
#ifndef SCENE_CHILD_H
#define SCENE_CHILD_H

#include <poll.h>
#include <sys/mman.h>
#include <sys/wait.h>
#include <time.h>
#ifdef __linux__
  #include <sys/prctl.h>
#endif
#if SCENE__SANITIZED
  #include <sanitizer/lsan_interface.h>
#endif

/* Reads a scene. bytes: the complete content of the file. The function may replace it by other memory from malloc; its
   caller frees it. */
typedef void (*scene__reading)(scene_file *file, const char *path, scene__bytes *bytes);

typedef struct scene__task {
    scene_file *file;
    const char *path;
    scene__reading reading;
    double seconds;
    size_t capacity;
    pid_t parent;
    int alive;    /* write end of a pipe, which closes when the child ends */
} scene__task;

/* ---- the child ---- */

/* Makes the kernel kill the child when the parent ends for any reason. */
static void scene__die_with(pid_t parent) {
#ifdef __linux__
    prctl(PR_SET_PDEATHSIG, SIGKILL);
#endif
    if (getppid() != parent) _exit(1);  /* the parent had already ended */
}

static void scene__default_signals(void) {
    static const int numbers[] = { SIGINT, SIGTERM, SIGHUP, SIGQUIT, SIGPIPE, SIGALRM, SIGXCPU, SIGXFSZ, SIGCHLD };
    sigset_t none;
    size_t i;
    for (i = 0; i < sizeof numbers / sizeof *numbers; i++) signal(numbers[i], SIG_DFL);
    sigemptyset(&none);
    sigprocmask(SIG_SETMASK, &none, NULL);
}

/* Replaces standard input, output and error by /dev/null, because a library may print something when it crashes. With
   sanitizers, stderr stays, because they report there. */
static void scene__leave_terminal(void) {
    int nowhere, i;
    do nowhere = open("/dev/null", O_RDWR); while (nowhere >= 0 && nowhere < 3);
    for (i = 0; i < (SCENE__SANITIZED ? 2 : 3); i++)
        if (nowhere >= 0) dup2(nowhere, i);
}

/* Runs the child. Never returns. */
static void scene__child(const scene__task *task) {
    scene_file *file = task->file;
    scene__bytes bytes = { NULL, 0 };
    int handle, kept[3];
    scene__die_with(task->parent);
    scene__default_signals();
    scene__leave_terminal();
    kept[0] = task->alive;
    kept[1] = file->own_handle = open("/proc/self/statm", O_RDONLY);
    kept[2] = handle = scene__open_regular(NULL, task->path);
    if (handle < 0) {
        scene__fail(file, "%s", scene__why());
        _exit(0);
    }
    file->own_at_start = scene__own_memory(file);
    scene__confine(file, task->seconds, kept, 3);
    if (scene__read_all(file, handle, &bytes)) task->reading(file, task->path, &bytes);
    else if (errno == ENOMEM) scene__fail_for_memory(file, "it");
    else scene__fail(file, "%s", strerror(errno));
    free(bytes.data);
#if SCENE__SANITIZED
    if (__lsan_do_recoverable_leak_check()) _exit(23);
#endif
    file->finished = 1;
    _exit(0);
}

/* ---- the parent ---- */

static double scene__clock(void) {
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

typedef enum scene__end { SCENE__ENDED, SCENE__CANCELLED, SCENE__LATE } scene__end;

/* Waits until the child has ended for any reason. alive: read end of a pipe whose write end only the child has open */
static scene__end scene__wait(pid_t child, int alive, double deadline, const volatile sig_atomic_t *cancel,
                              int *status) {
    scene__end end = SCENE__ENDED;
    struct pollfd waiting;
    waiting.fd = alive;
    waiting.events = POLLIN;
    for (;;) {
        const pid_t gone = waitpid(child, status, WNOHANG);
        if (gone == child || (gone < 0 && errno != EINTR)) return end;
        if (cancel && *cancel) end = SCENE__CANCELLED;
        else if (scene__clock() > deadline) end = SCENE__LATE;
        if (end != SCENE__ENDED) kill(child, SIGKILL);
        if (poll(&waiting, 1, 20) > 0) {  /* the child is ending, or has closed the pipe and still runs */
            waiting.fd = -1;
            if (end == SCENE__ENDED && waitpid(child, status, WNOHANG) == child) return end;
        }
    }
}

/* Maps the shared pages, which use no memory until they are touched. If the address space is too small, maps fewer.
   Returns NULL on failure. */
static scene_file *scene__map(size_t memory) {
    const size_t least = (size_t)1 << 20, page = (size_t)sysconf(_SC_PAGESIZE);
    scene_file *file = (scene_file *)MAP_FAILED;
    size_t capacity = memory / page * page;
    for (; file == (scene_file *)MAP_FAILED && capacity >= least; capacity = capacity / 2 / page * page) {
        file = (scene_file *)mmap(NULL, capacity, PROT_READ | PROT_WRITE, MAP_SHARED | MAP_ANONYMOUS | MAP_NORESERVE,
                                  -1, 0);
        if (file != (scene_file *)MAP_FAILED) file->capacity = file->memory = capacity;
    }
    if (file == (scene_file *)MAP_FAILED) return NULL;
    file->used = (sizeof *file + 15) & ~(size_t)15;
    return file;
}

/* Unmaps the unused pages, so that rendering can use their address space. */
static void scene__unmap_rest(scene_file *file) {
    const size_t page = (size_t)sysconf(_SC_PAGESIZE), used = (file->used + page - 1) / page * page;
    if (used < file->capacity && munmap((char *)file + used, file->capacity - used) == 0) file->capacity = used;
}

/* Opens the folder of the scene and the folders that the user allows. Returns 0 and sets error on failure. */
static int scene__allow(scene__folders *folders, const char *path, const scene_file_options *options, char *error,
                        size_t error_size) {
    const char *slash = strrchr(path, '/');
    char own[SCENE__PATH];
    int i;
    folders->count = 0;
    scene__print(own, sizeof own, "%.*s", slash ? (int)(slash - path) + 1 : 1, slash ? path : ".");
    if (!scene__add_folder(folders, own)) {
        scene__print(error, error_size, "%s: %s", path, strerror(errno));
        return 0;
    }
    for (i = 0; i < SCENE_FILE_FOLDERS && options->allow[i]; i++)
        if (!scene__add_folder(folders, options->allow[i])) {
            scene__print(error, error_size, "--allow-path %s: %s; give a folder", options->allow[i], strerror(errno));
            scene__close_folders(folders);
            return 0;
        }
    return 1;
}

/* Sets error if the child did not succeed, except after a cancellation. */
static void scene__judge(const scene__task *task, scene__end end, int status, char *error, size_t error_size) {
    scene_file *file = task->file;
    const char *path = task->path;
    file->error[sizeof file->error - 1] = 0;
    if (end == SCENE__CANCELLED) return;
    if (file->error[0]) scene__print(error, error_size, "%s: %s", path, file->error);
    else if (end == SCENE__LATE || (WIFSIGNALED(status) && WTERMSIG(status) == SIGXCPU))
        scene__print(error, error_size, "%s: reading it takes longer than %g s; the file may be damaged: save it "
                     "again, or allow more with --read-time", path, task->seconds);
    else if (!file->finished || WIFSIGNALED(status) || !scene__trust(file, task->capacity))
        scene__print(error, error_size, "%s: its reader crashed (%s %d); the file may be damaged: save it again, or "
                     "in another format", path, WIFSIGNALED(status) ? "signal" : "status",
                     WIFSIGNALED(status) ? WTERMSIG(status) : WEXITSTATUS(status));
}

/* Forks the child and waits for it. Returns 1 if it succeeded. Otherwise sets error, except after a cancellation. */
static int scene__run(scene__task *task, const volatile sig_atomic_t *cancel, char *error, size_t error_size) {
    const double deadline = scene__clock() + task->seconds;
    int ends[2], status = 0;
    scene__end end = SCENE__ENDED;
    pid_t child = -1;
    if (pipe(ends) == 0) {
        task->parent = getpid();
        task->alive = ends[1];
        fflush(NULL);
        child = fork();
        if (child == 0) scene__child(task);
        close(ends[1]);
        if (child > 0) end = scene__wait(child, ends[0], deadline, cancel, &status);
        close(ends[0]);
    }
    if (child < 0)
        scene__print(error, error_size, "%s: cannot start a process to read it: %s", task->path, strerror(errno));
    else scene__judge(task, end, status, error, error_size);
    return !error[0] && end != SCENE__CANCELLED;
}

static scene_file *scene__load(scene__reading reading, const char *path, const scene_file_options *options, char *error,
                               size_t error_size) {
    static const scene_file_options defaults;
    const size_t memory = scene__memory_limit(options ? options->memory : 0);
    scene_file *file = NULL;
    scene__folders folders;
    scene__task task;
    int done;
    if (!options) options = &defaults;
    error[0] = 0;
    if (!scene__allow(&folders, path, options, error, error_size)) return NULL;
    file = scene__map(memory);
    if (!file)
        scene__print(error, error_size, "%s: not enough memory to read it; allow more (ulimit -v, --memory)", path);
    else {
        file->folders = &folders;
        file->frames_asked = options->frames;
        file->matte = options->matte;
        file->frame_rate = options->frame_rate > 0 ? options->frame_rate : SCENE_FILE_RATE;
        memset(&task, 0, sizeof task);
        task.file = file;
        task.path = path;
        task.capacity = file->capacity;
        task.reading = reading;
        task.seconds = options->seconds > 0 ? options->seconds : SCENE_FILE_SECONDS;
        done = scene__run(&task, options->cancel, error, error_size);
        file->folders = NULL;
        file->confined[sizeof file->confined - 1] = 0;
        if (options->log && file->confined[0]) options->log(path, file->confined, options->log_user);
        if (done) scene__unmap_rest(file);
        else {
            munmap(file, task.capacity);
            file = NULL;
        }
    }
    scene__close_folders(&folders);
    return file;
}

#endif
