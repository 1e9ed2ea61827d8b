/* Tests of the files that sbl_render writes, and of the files that remain when it is interrupted. Signals are sent at
   chosen moments: at a certain system call, which this program observes with ptrace, or when the progress bar shows a
   certain percentage. No test depends on speed. */
#define _GNU_SOURCE
#include "../examples/output_file.h"
#include "support/test.h"
#include "support/tool.h"
#include <grp.h>
#include <sys/ptrace.h>
#include <sys/syscall.h>

static mode_t mode_of(const char *name) {
    struct stat info;
    return stat(in_folder(name), &info) == 0 ? info.st_mode & 07777 : 0;
}
static int is_link(const char *name) {
    struct stat info;
    return lstat(in_folder(name), &info) == 0 && S_ISLNK(info.st_mode);
}
static int is_picture(const char *name, int width, int height) {
    int w = 0, h = 0, channels;
    stbi_uc *pixels = stbi_load(in_folder(name), &w, &h, &channels, 0);
    stbi_image_free(pixels);
    return pixels && w == width && h == height;
}
static int holds(const char *name, const char *words) {
    char text[256];
    int lines;
    read_text(in_folder(name), text, sizeof text, &lines);
    return strcmp(text, words) == 0;
}

/* >>moments: stopping the tool at system calls that concern its temporary files */

enum { OPENS, WRITES, RENAMES, WAITS, CALLS }; /* WAITS: waits for the process that reads the scene */

typedef struct moment {
    int call, signal;
    void (*act)(const char *path);
} moment;

static pid_t traced;

static int traced_call(const struct __ptrace_syscall_info *call, int part) {
    const unsigned long n = (unsigned long)call->entry.nr;
#ifdef SYS_rename
    if (n == SYS_rename) return RENAMES;
#endif
#ifdef SYS_renameat
    if (n == SYS_renameat) return RENAMES;
#endif
#ifdef SYS_poll
    if (n == SYS_poll) return WAITS;
#endif
    if (n == SYS_renameat2) return RENAMES;
    if (n == SYS_ppoll) return WAITS;
    if ((n == SYS_write || n == SYS_pwrite64) && part >= 0 && (int)call->entry.args[0] == part) return WRITES;
    return n == SYS_openat ? OPENS : CALLS;
}

static void read_path(pid_t child, unsigned long long at, char *path, size_t size) {
    size_t i;
    for (i = 0; i + 1 < size && (i == 0 || path[i - 1]); i++) {
        const unsigned long long from = at + i, word = from & ~7ull;
        const long data = ptrace(PTRACE_PEEKDATA, child, (void *)(uintptr_t)word, NULL);
        path[i] = ((const char *)&data)[from - word];
    }
    path[i] = 0;
}

static void be_traced(void) {
    char more[600];
    const char *options = getenv("ASAN_OPTIONS");
    hear_signals();
    snprintf(more, sizeof more, "%.500s%sdetect_leaks=0", options ? options : "", options && *options ? ":" : "");
    setenv("ASAN_OPTIONS", more, 1); /* the leak checker uses ptrace, too */
    if (ptrace(PTRACE_TRACEME, 0, NULL, NULL) != 0) _exit(98);
}

/* Runs the tool. At each moment in turn, calls its action and sends its signal. Returns the number of moments that
   occurred, or -1 if ptrace is not permitted. */
static int run_traced_as(void (*child_start)(void), const char *const *arguments, const moment *moments, int count) {
    struct __ptrace_syscall_info call;
    char path[600];
    int status, part = -1, opening = 0, pass = 0, done = 0;
    pid_t child;
    in_child = child_start;
    child = traced = start(arguments, -1, 0);
    in_child = NULL;
    waitpid(child, &status, 0);
    if (WIFEXITED(status)) {
        ran.status = WEXITSTATUS(status);
        return -1;
    }
    ptrace(PTRACE_SETOPTIONS, child, NULL, (void *)(uintptr_t)(PTRACE_O_TRACESYSGOOD | PTRACE_O_EXITKILL));
    while (done < count) {
        int kind;
        ptrace(PTRACE_SYSCALL, child, NULL, (void *)(uintptr_t)pass);
        if (waitpid(child, &status, __WALL) != child || !WIFSTOPPED(status)) break;
        pass = WSTOPSIG(status);
        if (pass != (SIGTRAP | 0x80)) continue;
        pass = 0;
        if (ptrace(PTRACE_GET_SYSCALL_INFO, child, (void *)sizeof call, &call) <= 0) {
            kill(child, SIGKILL);
            done = -1;
            break;
        }
        if (call.op == PTRACE_SYSCALL_INFO_EXIT && opening) {
            part = (int)call.exit.rval;
            opening = 0;
        }
        if (call.op != PTRACE_SYSCALL_INFO_ENTRY) continue;
        kind = traced_call(&call, part);
        if (kind == OPENS) {
            read_path(child, call.entry.args[1], path, sizeof path);
            if (strlen(path) < 5 || strcmp(path + strlen(path) - 5, ".part") != 0) continue;
            opening = 1;
        }
        if (kind != moments[done].call) continue;
        if (moments[done].act) moments[done].act(path);
        if (moments[done].signal) syscall(SYS_tgkill, child, child, moments[done].signal);
        done++;
    }
    if (WIFSTOPPED(status)) ptrace(PTRACE_DETACH, child, NULL, NULL);
    finish(child);
    if (!WIFSTOPPED(status))
        ran.status = WIFEXITED(status) ? WEXITSTATUS(status) : -WTERMSIG(status); /* the process has already ended */
    return done;
}
#define TRACED(arguments, moments, count)                                                                         \
  do {                                                                                                            \
    const int came_ = run_traced_as(be_traced, arguments, moments, count);                                        \
    if (came_ < 0) SKIP("processes cannot be traced here");                                                       \
    CHECK(came_ == (count), "only %d of %d moments occurred: exit status %d: %s", came_, count, ran.status, ran.err); \
  } while (0)

static const char *const room_arguments[] = { ROOM, "-o", "out.png", NULL };

/* >>names of files */

static char planted[600];
static void plant(const char *path) {
    snprintf(planted, sizeof planted, "%.500s", path[0] == '/' ? path : in_folder(path));
    CHECK(symlink("victim", planted) == 0, "%s: %s", planted, strerror(errno));
}

/* A symbolic link that exists at the name of the temporary file is not followed. The tool opens a temporary file twice:
   as a test of permissions, and to write. */
TEST(planted_links_are_not_written_through) {
    static const moment first[] = { { OPENS, 0, plant } }, second[] = { { OPENS, 0, NULL }, { OPENS, 0, plant } };
    int i;
    room_obj();
    for (i = 0; i < 2; i++) {
        write_text("victim", "dear\n");
        remove(in_folder("out.png"));
        planted[0] = 0;
        if (i) TRACED(room_arguments, second, 2);
        else TRACED(room_arguments, first, 1);
        CHECK(ran.status == 0 && is_picture("out.png", 24, 16), "opening %d: exit status %d: %s", i, ran.status,
              ran.err);
        CHECK(holds("victim", "dear\n"), "opening %d: the tool wrote through a planted link", i);
        CHECK(remove(planted) == 0 && !parts_left() && !is_link("out.png"), "opening %d: %d temporary files are left",
              i, leftovers);
    }
}

/* An output name of the greatest length works, although names of temporary files are derived from it. */
TEST(the_longest_file_name_works) {
    char name[256];
    memset(name, 'x', sizeof name);
    strcpy(name + 251, ".png");
    room_obj();
    CHECK(TOOL(ROOM, "-o", name) == 0 && is_picture(name, 24, 16), "exit status %d: %s", ran.status, ran.err);
    remove(in_folder(name));
}

/* >>existing output files */

/* New files get the permissions of the umask. Existing files keep their permissions. */
TEST(permissions_are_kept) {
    static const mode_t masks[] = { 0, 022, 027, 077 }, modes[] = { 0644, 0640, 0600, 0444, 0666, 0755 };
    const mode_t mask = umask(0);
    size_t i;
    room_obj();
    for (i = 0; i < sizeof masks / sizeof *masks; i++) {
        remove(in_folder("new.png"));
        umask(masks[i]);
        TOOL(ROOM, "-o", "new.png", "--stats", "new.json");
        CHECK(mode_of("new.png") == (0666 & ~masks[i]) && mode_of("new.json") == (0666 & ~masks[i]),
              "umask %o gives %o and %o", masks[i], mode_of("new.png"), mode_of("new.json"));
        remove(in_folder("new.json"));
    }
    umask(077);
    for (i = 0; i < sizeof modes / sizeof *modes; i++) {
        write_text("old.png", "old\n");
        chmod(in_folder("old.png"), modes[i]);
        TOOL(ROOM, "-o", "old.png");
        CHECK(is_picture("old.png", 24, 16) && mode_of("old.png") == modes[i], "%o became %o: %s", modes[i],
              mode_of("old.png"), ran.err);
        chmod(in_folder("old.png"), 0600);
        remove(in_folder("old.png"));
    }
    umask(mask);
}

/* Replaces a file as another user, who is not in its group. Returns 1 on success. */
static int replace_as_nobody(const char *path) {
    enum { NOBODY = 65534 };
    output_file out;
    FILE *stream;
    int ok;
    if (setgroups(0, NULL) != 0 || setgid(NOBODY) != 0 || setuid(NOBODY) != 0 || !output_find(&out, path)) return 0;
    stream = output_open(&out);
    ok = stream && fputs("new\n", stream) >= 0 && output_close(&out, stream, 1, NULL);
    output_free(&out);
    return ok;
}

/* If the group of the old file cannot be kept, the group of the writer gets none of its permissions. */
TEST(another_group_gets_no_permissions) {
    int status = 0;
    pid_t child;
    if (geteuid() != 0) SKIP("only root can act as another user");
    chmod(folder, 0777);
    write_text("shared.txt", "old\n");
    chmod(in_folder("shared.txt"), 0664);
    child = fork();
    if (!child) _exit(!replace_as_nobody(in_folder("shared.txt")));
    waitpid(child, &status, 0);
    chmod(folder, 0700);
    CHECK(status == 0 && holds("shared.txt", "new\n") && mode_of("shared.txt") == 0604, "the mode is %o",
          mode_of("shared.txt"));
}

/* If a write has failed, the old file stays, although later writes and the closing of the file may succeed. */
TEST(a_failed_write_is_remembered) {
    output_file out;
    FILE *stream;
    write_text("kept.txt", "old\n");
    REQUIRE(output_find(&out, in_folder("kept.txt")) && (stream = output_open(&out)) != NULL, "no file");
    fputs("new\n", stream);
    fgetc(stream);  /* a stream for writing cannot be read; this sets the same flag as a failed write */
    CHECK(!output_close(&out, stream, 1, NULL) && holds("kept.txt", "old\n") && !parts_left(), "the file is replaced");
    output_free(&out);
}

/* Symbolic links are followed and remain. A hard link is separated from the others: these keep the old contents. */
TEST(links_stay) {
    struct stat info;
    room_obj();
    mkdir(in_folder("far"), 0777);
    write_text("far/true.png", "old\n");
    CHECK(symlink("far/second.png", in_folder("first.png")) == 0 &&
              symlink("true.png", in_folder("far/second.png")) == 0,
          "no links");
    CHECK(TOOL(ROOM, "-o", "first.png") == 0, "exit status %d: %s", ran.status, ran.err);
    CHECK(is_link("first.png") && is_link("far/second.png") && !is_link("far/true.png") &&
              is_picture("far/true.png", 24, 16),
          "the picture should be in the file that the links lead to");
    CHECK(symlink("far/absent.png", in_folder("dangling.png")) == 0, "no link");
    CHECK(TOOL(ROOM, "-o", "dangling.png") == 0, "exit status %d: %s", ran.status, ran.err);
    CHECK(is_link("dangling.png") && is_picture("far/absent.png", 24, 16),
          "a link to a file that does not exist yet should be followed");
    CHECK(symlink("round.png", in_folder("round.png")) == 0 && TOOL(ROOM, "-o", "round.png") == 1 &&
              ran.err_lines == 1 && said("round.png"),
          "a link to itself: exit status %d: %s", ran.status, ran.err);
    write_text("one.png", "old\n");
    CHECK(link(in_folder("one.png"), in_folder("two.png")) == 0, "no hard links");
    CHECK(TOOL(ROOM, "-o", "one.png") == 0 && is_picture("one.png", 24, 16) && holds("two.png", "old\n"),
          "the other hard link should keep the old contents");
    CHECK(stat(in_folder("one.png"), &info) == 0 && info.st_nlink == 1 && !parts_left(), "%d links, %d temporary files",
          (int)info.st_nlink, leftovers);
}

/* Devices, pipes and links to them are written in place and remain. */
TEST(devices_and_pipes_are_written_to) {
    static const char *const into_pipe[] = { ROOM, "-o", "pipe.png", NULL };
    static unsigned char bytes[1 << 16];
    struct stat info;
    ssize_t n, got = 0;
    pid_t child;
    int reader, width, height, channels;
    stbi_uc *pixels;
    room_obj();
    CHECK(TOOL(ROOM, "-o", "out.png", "--stats", "/dev/stdout") == 0 && strstr(ran.out, "\"triangles\": 6"),
          "/dev/stdout: %s%s", ran.out, ran.err);
    CHECK(TOOL(ROOM, "-o", "out.png", "--stats", "/dev/null") == 0 && stat("/dev/null", &info) == 0 &&
              S_ISCHR(info.st_mode),
          "/dev/null: %s", ran.err);
    CHECK(symlink("/dev/null", in_folder("null.png")) == 0 &&
              TOOL(ROOM, "-o", "null.png", "--stats", "/dev/null") == 0 && is_link("null.png"),
          "a link to /dev/null: %s", ran.err);
    CHECK(symlink("/dev/stdout", in_folder("out.json")) == 0 &&
              TOOL(ROOM, "-o", "out.png", "--stats", "out.json") == 0 && is_link("out.json") &&
              strstr(ran.out, "\"triangles\": 6"),
          "a link to /dev/stdout: %s%s", ran.out, ran.err);
    REQUIRE(mkfifo(in_folder("pipe.png"), 0666) == 0, "no pipe: %s", strerror(errno));
    child = start(into_pipe, -1, 0);
    reader = open(in_folder("pipe.png"), O_RDONLY);
    while (reader >= 0 && (n = read(reader, bytes + got, sizeof bytes - (size_t)got)) > 0) got += n;
    close(reader);
    finish(child);
    pixels = stbi_load_from_memory(bytes, (int)got, &width, &height, &channels, 0);
    CHECK(ran.status == 0 && pixels && width == 24 && height == 16, "exit status %d, %d bytes: %s", ran.status,
          (int)got, ran.err);
    CHECK(lstat(in_folder("pipe.png"), &info) == 0 && S_ISFIFO(info.st_mode) && !parts_left(),
          "the pipe should stay a pipe");
    stbi_image_free(pixels);
}

/* >>outputs that are the same file as another output or an input */

static void check_misuse(const char *what) {
    CHECK(ran.status == 2 && ran.err_lines == 1 && strncmp(ran.err, "sbl_render: ", 12) == 0, "%s: exit status %d: %s",
          what, ran.status, ran.err);
    CHECK(!parts_left(), "%s: %d temporary files are left", what, leftovers);
}

/* A picture and statistics with the same file are refused, also if the names differ or links are used. */
TEST(outputs_are_two_files) {
    char whole[256];
    room_obj();
    mkdir(in_folder("sub"), 0777);
    CHECK(symlink(".", in_folder("here")) == 0 && symlink("same.png", in_folder("alias.png")) == 0, "no links");
    snprintf(whole, sizeof whole, "%s", in_folder("same.png"));
    TOOL(ROOM, "-o", "same.png", "--stats", "same.png");
    check_misuse("one name");
    TOOL(ROOM, "-o", "same.png", "--stats", "./same.png");
    check_misuse("./");
    TOOL(ROOM, "-o", "sub/../same.png", "--stats", "same.png");
    check_misuse("..");
    TOOL(ROOM, "-o", "same.png", "--stats", whole);
    check_misuse("an absolute name");
    TOOL(ROOM, "-o", "same.png", "--stats", "here/same.png");
    check_misuse("a link to the folder");
    TOOL(ROOM, "-o", "same.png", "--stats", "alias.png");
    check_misuse("a link to a file that does not exist yet");
    TOOL(ROOM, "-o", "alias.png", "--stats", "same.png");
    check_misuse("the same with the two options exchanged");
    TOOL(ROOM, "-o", "same.png", "--stats", "same.partial.png");
    check_misuse("the name of a partial picture");
    TOOL(ROOM, "-o", "stdout.png", "--stats", "/dev/stdout");
    CHECK(ran.status == 0, "another file on stdout: %s", ran.err);
    CHECK(symlink("stdout", in_folder("output.png")) == 0 &&
              TOOL(ROOM, "-o", "output.png", "--stats", "/dev/stdout") == 2,
          "the file that stdout goes to: %s", ran.err);
    CHECK(!exists("same.png"), "a picture was written");
    write_text("same.png", "old\n");
    CHECK(link(in_folder("same.png"), in_folder("hard")) == 0, "no hard links");
    TOOL(ROOM, "-o", "same.png", "--stats", "hard");
    check_misuse("two names of a file");
    CHECK(holds("same.png", "old\n"), "the old file should have stayed");
    CHECK(TOOL(ROOM, "-o", "same.png", "--stats", "same.json") == 0, "two files: %s", ran.err);
}

/* An output that is an input file of the scene is refused. */
TEST(what_is_read_is_not_overwritten) {
    static const char mtl[] = "newmtl m\nKd 1 1 1\nmap_Kd wood.png\n";
    static const char obj[] = "mtllib wood.mtl\nvt 0 0\nv -1 0 -1\nv -1 0 1\nv 1 0 1\nusemtl m\nf 1/1 2/1 3/1\n";
    static const char *const pictures[] = { "wood.png", "link.png", "hard.png", "./wood.png", "sky.png" };
    static const char *const others[] = { "wood.obj", "sub/../wood.obj", "wood.mtl", "wood.png", "sky.png" };
    size_t i;
    room_obj();
    mkdir(in_folder("sub"), 0777);
    write_text("wood.mtl", mtl);
    write_text("wood.obj", obj);
    REQUIRE(TOOL(ROOM, "-o", "wood.png") == 0 && TOOL(ROOM, "-o", "sky.png") == 0, "%s", ran.err);
    REQUIRE(symlink("wood.png", in_folder("link.png")) == 0 && link(in_folder("wood.png"), in_folder("hard.png")) == 0,
            "no links");
    for (i = 0; i < sizeof pictures / sizeof *pictures; i++) {
        TOOL("wood.obj", "--sky", "sky.png", "--size", "8x8", SMALL, "-o", pictures[i]);
        check_misuse(pictures[i]);
    }
    for (i = 0; i < sizeof others / sizeof *others; i++) {
        TOOL("wood.obj", "--sky", "sky.png", "--size", "8x8", SMALL, "-o", "of_wood.png", "--stats", others[i]);
        check_misuse(others[i]);
        CHECK(!exists("of_wood.png"), "%s: a picture was written", others[i]);
    }
    CHECK(holds("wood.obj", obj) && holds("wood.mtl", mtl) && is_picture("wood.png", 24, 16) &&
              is_picture("sky.png", 24, 16),
          "a file was changed");
    CHECK(TOOL("wood.obj", "--sky", "sky.png", "--size", "8x8", SMALL, "-o", "of_wood.png", "--stats",
               "of_wood.json") == 0,
          "%s", ran.err);
}

/* >>signals while files are written */

/* Checks that the signal ended the last run, that the run printed one line with the given words, and that no temporary
   files remain. */
static void check_interrupted(const char *what, int number, const char *words) {
    CHECK(ran.status == 128 + number, "%s: exit status %d, expected %d: %s", what, ran.status, 128 + number, ran.err);
    CHECK(ran.err_lines == 1 && said("sbl_render: interrupted; ") && said(words), "%s: expected \"%s\" in one line: %s",
          what, words, ran.err);
    CHECK(!parts_left(), "%s: %d temporary files are left", what, leftovers);
}

static void forget(void) {
    static const char *const names[] = { "out.png", "out.partial.png", "out.pfm", "out.partial.pfm", "out.json" };
    size_t i;
    for (i = 0; i < sizeof names / sizeof *names; i++) remove(in_folder(names[i]));
}

/* A signal before the first pixel leaves no files. */
TEST(before_there_is_a_picture) {
    static const int calls[] = { OPENS, WAITS };
    int i, k;
    room_obj();
    for (i = 0; i < 2; i++)
        for (k = 0; k < SIGNALS; k++) {
            moment m = { 0, 0, NULL };
            m.call = calls[i];
            m.signal = signals[k];
            forget();
            TRACED(room_arguments, &m, 1);
            check_interrupted(i ? "while the scene is read" : "at the first test of the folder", signals[k],
                              "no picture");
            CHECK(!exists("out.png") && !exists("out.partial.png"), "signal %d: a picture was written", signals[k]);
        }
}

/* If a signal comes while the picture is written, the picture does not get its final name. The first opening of the
   temporary file only tests whether it can be written. */
TEST(while_the_picture_is_written) {
    static const char *const arguments[] = { ROOM, "-o", "out.pfm", "--stats", "out.json", NULL };
    int k;
    picture p;
    room_obj();
    for (k = 0; k < SIGNALS; k++) {
        moment m[3] = { { OPENS, 0, NULL }, { OPENS, 0, NULL }, { WRITES, 0, NULL } };
        m[2].signal = signals[k];
        forget();
        write_text("out.pfm", "old\n");
        TRACED(arguments, m, 3);
        check_interrupted("while the picture is written", signals[k], "is in out.partial.pfm");
        CHECK(holds("out.pfm", "old\n") && !exists("out.json"), "signal %d: the output was written", signals[k]);
        p = read_pfm("out.partial.pfm");
        CHECK(p.values && p.width == 24 && p.height == 16, "signal %d: the partial picture is not there", signals[k]);
        free(p.values);
    }
}

/* A signal after the picture is written keeps the picture. No statistics are written. */
TEST(while_the_statistics_are_written) {
    static const char *const arguments[] = { ROOM, "--sky", "0,0,0", "-o", "out.png", "--stats", "out.json",
                                             NULL };
    static const moment m[] = { { RENAMES, 0, NULL }, { OPENS, SIGTERM, NULL } };
    room_obj();
    forget();
    TRACED(arguments, m, 2);
    check_interrupted("while the statistics are written", SIGTERM, "out.png is written, out.json is not");
    CHECK(is_picture("out.png", 24, 16) && !exists("out.partial.png") && !exists("out.json"),
          "the picture should be complete, and the only file");
}

/* A second signal ends the tool at once, even while it handles the first one. */
TEST(a_second_signal_ends_at_once) {
    int i, k;
    room_obj();
    for (i = 0; i < 2; i++)
        for (k = 0; k < SIGNALS; k++) {
            moment m[5] = { { OPENS, 0, NULL },
                            { OPENS, 0, NULL },
                            { WRITES, SIGINT, NULL },
                            { OPENS, 0, NULL },
                            { WRITES, 0, NULL } };
            m[3].signal = i ? 0 : signals[k];
            m[4].signal = signals[k];
            forget();
            TRACED(room_arguments, m, i ? 5 : 4);
            CHECK(ran.status == 128 + signals[k] && !ran.err[0], "signal %d: exit status %d: %s", signals[k],
                  ran.status, ran.err);
            CHECK(!exists("out.png") && !exists("out.partial.png") && !parts_left(),
                  "signal %d: %d temporary files are left", signals[k], leftovers);
        }
}

static void be_traced_deaf(void) {
    int i;
    be_traced();
    for (i = 0; i < SIGNALS; i++) signal(signals[i], SIG_IGN);
}

/* Signals that are ignored at the start, as nohup does, stay ignored. */
TEST(what_is_ignored_stays_ignored) {
    static const moment m[] = { { OPENS, SIGHUP, NULL }, { WAITS, SIGINT, NULL }, { WRITES, SIGTERM, NULL } };
    int came;
    room_obj();
    forget();
    came = run_traced_as(be_traced_deaf, room_arguments, m, 3);
    if (came < 0) SKIP("processes cannot be traced here");
    CHECK(came == 3 && ran.status == 0 && is_picture("out.png", 24, 16), "%d moments, exit status %d: %s", came,
          ran.status, ran.err);
}

/* >>signals during the work. With one sensor per pixel the picture takes a minute on two cores; therefore the signals
   come before its end on any machine. */

#define LONG \
    "room.obj", "--mode", "ambient", "--size", "320x240", "--rays", "4096", "--threshold", "0", "--samples", "1"

/* If the tool is interrupted before the end of the first level, it writes nothing. */
TEST(before_the_first_level) {
    static const char *const arguments[] = { LONG, "--tile", "1", "-o", "out.png", "--stats", "out.json", NULL };
    int k;
    room_obj();
    for (k = 0; k < SIGNALS; k++) {
        forget();
        if (!interrupt_at(arguments, k, signals[k])) SKIP("no pseudo-terminals");
        CHECK(ran.status == 128 + signals[k] && said("interrupted; there is no picture yet"),
              "exit status %d: %s", ran.status, ran.err);
        CHECK(k < 2 || strstr(on_terminal, " left"), "the progress bar should show the time left: %s", ran.err);
        CHECK(!exists("out.png") && !exists("out.partial.png") && !exists("out.json") && !parts_left(),
              "something was written");
    }
}

/* If the tool is interrupted after the first of five levels, which ends at 5 %, it writes a partial picture. */
TEST(after_the_first_level) {
    static const char *const png[] = { LONG, "--tile", "16", "-o", "out.png", "--stats", "out.json", NULL };
    static const char *const sensor[] = { LONG, "--tile", "16", "--inspect", "5,5", "-o", "out.png", NULL };
    int k;
    room_obj();
    for (k = 0; k < SIGNALS; k++) {
        forget();
        write_text("out.png", "old\n");
        if (!interrupt_at(png, 6 + k, signals[k])) SKIP("no pseudo-terminals");
        CHECK(ran.status == 128 + signals[k] && said("interrupted; the unfinished picture (") &&
                  said("%) is in out.partial.png"),
              "exit status %d: %s", ran.status, ran.err);
        CHECK(is_picture("out.partial.png", 320, 240) && holds("out.png", "old\n") && !exists("out.json") &&
                  !parts_left(),
              "signal %d: %d temporary files are left", signals[k], leftovers);
    }
    forget();
    interrupt_at(sensor, 6, SIGINT);
    CHECK(ran.status == 130 && said("no picture yet") && !exists("out.partial.png"), "a sensor: exit status %d: %s",
          ran.status, ran.err);
}

/* >>broken pipes and closed file descriptors */

static int closed_handle;
static void break_pipe(void) {
    int ends[2];
    signal(SIGPIPE, SIG_DFL);
    if (pipe(ends) != 0) _exit(97);
    close(ends[0]);
    dup2(ends[1], closed_handle);
}
static void run_with(void (*before)(void), const char *const *arguments) {
    in_child = before;
    finish(start(arguments, -1, 0));
    in_child = NULL;
}

/* SIGPIPE does not kill the tool. A broken pipe is ignored for warnings, and is a write error for outputs. */
TEST(a_broken_pipe_is_a_failed_write) {
    static const char *const warned[] = { "warned.obj", "--size", "24x16", SMALL, "-o", "out.png", NULL };
    static const char *const stats[] = { ROOM, "-o", "out.png", "--stats", "/dev/stdout", NULL };
    static const char *const sums[] = { ROOM, "-o", "out.png", "--inspect", "12,14", NULL };
    room_obj();
    write_text("warned.mtl", "newmtl m\nKd 1 1 1\nmap_Kd absent.png\n");
    write_text("warned.obj", "mtllib warned.mtl\nvt 0 0\nv -1 0 -1\nv -1 0 1\nv 1 0 1\nusemtl m\nf 1/1 2/1 3/1\n");
    forget();
    closed_handle = 2;
    run_with(break_pipe, warned);
    CHECK(ran.status == 0 && is_picture("out.png", 24, 16), "stderr is a broken pipe: exit status %d", ran.status);
    forget();
    closed_handle = 1;
    run_with(break_pipe, stats);
    CHECK(ran.status == 1 && said("/dev/stdout") && is_picture("out.png", 24, 16),
          "the statistics go into a broken pipe: exit status %d: %s", ran.status, ran.err);
    forget();
    run_with(break_pipe, sums);
    CHECK(ran.status >= 0 && !parts_left() && exists("out.png"),
          "--inspect prints into a broken pipe: exit status %d: %s",
          ran.status, ran.err);
}

static int handles_lead_away;
static void look_at_handles(const char *path) {
    char name[64], to[64];
    ssize_t n;
    int i;
    (void)path;
    for (i = handles_lead_away = 0; i < 3; i++) {
        snprintf(name, sizeof name, "/proc/%ld/fd/%d", (long)traced, i);
        n = readlink(name, to, sizeof to - 1);
        to[n > 0 ? n : 0] = 0;
        handles_lead_away += strcmp(to, "/dev/null") == 0;
    }
}
static void be_traced_closed(void) {
    be_traced();
    close(0);
    close(1);
    close(2);
}

/* If stdin, stdout and stderr are closed, an opened file could get one of their file descriptors, and messages would go
   into the picture. Therefore the tool must open /dev/null for all three. */
TEST(closed_handles_do_no_harm) {
    static const moment m[] = { { WRITES, 0, look_at_handles } };
    int came;
    forget();
    came = run_traced_as(be_traced_closed, room_arguments, m, 1);
    if (came < 0) SKIP("processes cannot be traced here");
    CHECK(came == 1 && handles_lead_away == 3, "%d of the first three handles are /dev/null", handles_lead_away);
    CHECK(ran.status == 0 && is_picture("out.png", 24, 16), "exit status %d", ran.status);
}

int main(int argc, char **argv) {
    (void)argc;
    if (!tool_begin(argv[0])) return 1;
    RUN(planted_links_are_not_written_through);
    RUN(the_longest_file_name_works);
    RUN(permissions_are_kept);
    RUN(another_group_gets_no_permissions);
    RUN(a_failed_write_is_remembered);
    RUN(links_stay);
    RUN(devices_and_pipes_are_written_to);
    RUN(outputs_are_two_files);
    RUN(what_is_read_is_not_overwritten);
    RUN(before_there_is_a_picture);
    RUN(while_the_picture_is_written);
    RUN(while_the_statistics_are_written);
    RUN(a_second_signal_ends_at_once);
    RUN(what_is_ignored_stays_ignored);
    RUN(before_the_first_level);
    RUN(after_the_first_level);
    RUN(a_broken_pipe_is_a_failed_write);
    RUN(closed_handles_do_no_harm);
    tool_end();
    return test_report();
}
