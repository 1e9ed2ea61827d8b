/* Part of scene_file.h: the kernel restricts the process that reads a scene. The restrictions need no privileges and
   are independent of each other. scene_file_options.log reports which of them are active.

       limits    limits processor time, and forbids writing files and core dumps
       Landlock  allows only reading of files below the allowed folders; forbids TCP and signals to other processes, if
                 the kernel supports these rules
       seccomp   allows only the system calls in scene__calls, and thus no network, no new process or program, no
                 tracing

   Only Linux has these restrictions. They are not used with sanitizers, which read files and trace processes
   themselves. */
#ifndef SCENE_SANDBOX_H
#define SCENE_SANDBOX_H

#ifdef __linux__
  #include <linux/audit.h>
  #include <linux/filter.h>
  #include <linux/seccomp.h>
  #include <sys/mman.h>
  #include <sys/prctl.h>
  #include <sys/syscall.h>

/* ---- Landlock; its constants are defined here, because older kernel headers lack them ---- */

enum { SCENE__LANDLOCK_CREATE = 444, SCENE__LANDLOCK_ADD = 445, SCENE__LANDLOCK_ENTER = 446 };
typedef struct scene__ruleset { uint64_t files, net, scopes; } scene__ruleset;
typedef struct scene__rule { uint64_t rights; int32_t folder; } scene__rule;  /* 12 bytes in the kernel */

/* Activates Landlock. Returns its version, or 0 if it is not available. */
static int scene__enter_landlock(const scene__folders *folders) {
    const uint64_t read_file = 1 << 2;
    const int version = (int)syscall(SCENE__LANDLOCK_CREATE, NULL, 0, 1);
    scene__ruleset set = { (1 << 13) - 1, 0, 0 };
    int i, ruleset, ok;
    if (version < 1) return 0;
    if (version >= 2) set.files |= 1 << 13;  /* forbids renaming and linking across folders */
    if (version >= 3) set.files |= 1 << 14;  /* forbids truncation */
    if (version >= 4) set.net = 3;           /* forbids bind and connect of TCP sockets */
    if (version >= 5) set.files |= 1 << 15;  /* forbids ioctl on devices */
    if (version >= 6) set.scopes = 3;        /* forbids abstract sockets, and signals to other processes */
    ruleset = (int)syscall(SCENE__LANDLOCK_CREATE, &set, sizeof set, 0);
    if (ruleset < 0) return 0;
    for (i = 0, ok = 1; i < folders->count && ok; i++) {
        scene__rule rule;
        rule.rights = read_file;
        rule.folder = folders->list[i].handle;
        ok = syscall(SCENE__LANDLOCK_ADD, ruleset, 1, &rule, 0) == 0;
    }
    ok = ok && syscall(SCENE__LANDLOCK_ENTER, ruleset, 0) == 0;
    close(ruleset);
    return ok ? version : 0;
}

/* ---- seccomp ---- */

  #if defined(__x86_64__)
    #define SCENE__MACHINE AUDIT_ARCH_X86_64
  #elif defined(__aarch64__)
    #define SCENE__MACHINE AUDIT_ARCH_AARCH64
  #elif defined(__riscv) && __riscv_xlen == 64
    #define SCENE__MACHINE AUDIT_ARCH_RISCV64
  #endif

  #ifdef SCENE__MACHINE
enum { SCENE__OWN_PID = -1 };

/* The allowed calls. A call is allowed if the bits of `mask` in the argument with the index `argument` equal `value`.
   All other calls fail with ENOSYS, as on a kernel that lacks them, which libraries can handle. */
static const struct scene__call { int number, argument; unsigned mask; int value; } scene__calls[] = {
    { SYS_read, 0, 0, 0 }, { SYS_pread64, 0, 0, 0 }, { SYS_readv, 0, 0, 0 }, { SYS_lseek, 0, 0, 0 },
    { SYS_write, 0, 0, 0 }, { SYS_writev, 0, 0, 0 }, { SYS_close, 0, 0, 0 }, { SYS_fstat, 0, 0, 0 },
    { SYS_newfstatat, 0, 0, 0 }, { SYS_statx, 0, 0, 0 }, { SYS_readlinkat, 0, 0, 0 }, { SYS_getcwd, 0, 0, 0 },
    { SYS_openat, 2, O_ACCMODE | O_CREAT | O_TRUNC, O_RDONLY },
    { SYS_mmap, 2, PROT_EXEC, 0 }, { SYS_mprotect, 2, PROT_EXEC, 0 },
    { SYS_munmap, 0, 0, 0 }, { SYS_mremap, 0, 0, 0 }, { SYS_madvise, 0, 0, 0 }, { SYS_brk, 0, 0, 0 },
    { SYS_prlimit64, 0, ~0u, 0 }, { SYS_setrlimit, 0, 0, 0 }, { SYS_getrlimit, 0, 0, 0 },
    { SYS_futex, 0, 0, 0 }, { SYS_rt_sigaction, 0, 0, 0 }, { SYS_rt_sigprocmask, 0, 0, 0 },
    { SYS_rt_sigreturn, 0, 0, 0 }, { SYS_restart_syscall, 0, 0, 0 }, { SYS_getpid, 0, 0, 0 }, { SYS_gettid, 0, 0, 0 },
    { SYS_tgkill, 0, ~0u, SCENE__OWN_PID },  /* used by abort */
    { SYS_exit, 0, 0, 0 }, { SYS_exit_group, 0, 0, 0 },
    { SYS_clock_gettime, 0, 0, 0 }, { SYS_gettimeofday, 0, 0, 0 }, { SYS_clock_nanosleep, 0, 0, 0 },
    { SYS_getrandom, 0, 0, 0 }, { SYS_sched_yield, 0, 0, 0 }, { SYS_sysinfo, 0, 0, 0 },
    #ifdef SYS_open  /* older calls of x86-64 */
    { SYS_open, 1, O_ACCMODE | O_CREAT | O_TRUNC, O_RDONLY },
    { SYS_stat, 0, 0, 0 }, { SYS_lstat, 0, 0, 0 }, { SYS_readlink, 0, 0, 0 }, { SYS_time, 0, 0, 0 },
    #endif
};

/* Builds and installs the filter. Returns 1 on success. Each allowed call takes six instructions: one compares its
   number, the others check its argument. */
static int scene__enter_seccomp(void) {
    enum { CALLS = sizeof scene__calls / sizeof *scene__calls, REFUSE = SECCOMP_RET_ERRNO | ENOSYS };
    const unsigned low = __BYTE_ORDER__ == __ORDER_LITTLE_ENDIAN__ ? 0 : 4;
    struct sock_filter code[6 * CALLS + 5], *to = code;
    struct sock_fprog program;
    size_t i;
    #define SCENE__STATEMENT(kind, k) *to++ = (struct sock_filter)BPF_STMT(kind, (uint32_t)(k))
    #define SCENE__JUMP(k, yes, no) \
        *to++ = (struct sock_filter)BPF_JUMP(BPF_JMP | BPF_JEQ | BPF_K, (uint32_t)(k), yes, no)
    SCENE__STATEMENT(BPF_LD | BPF_W | BPF_ABS, offsetof(struct seccomp_data, arch));
    SCENE__JUMP(SCENE__MACHINE, 1, 0);
    SCENE__STATEMENT(BPF_RET | BPF_K, REFUSE);
    SCENE__STATEMENT(BPF_LD | BPF_W | BPF_ABS, offsetof(struct seccomp_data, nr));
    for (i = 0; i < CALLS; i++) {
        const struct scene__call *c = &scene__calls[i];
        const size_t argument = offsetof(struct seccomp_data, args) + 8 * (size_t)c->argument + low;
        SCENE__JUMP(c->number, 0, 5);
        SCENE__STATEMENT(BPF_LD | BPF_W | BPF_ABS, argument);
        SCENE__STATEMENT(BPF_ALU | BPF_AND | BPF_K, c->mask);
        SCENE__JUMP(c->value == SCENE__OWN_PID ? getpid() : c->value, 0, 1);
        SCENE__STATEMENT(BPF_RET | BPF_K, SECCOMP_RET_ALLOW);
        SCENE__STATEMENT(BPF_RET | BPF_K, REFUSE);
    }
    SCENE__STATEMENT(BPF_RET | BPF_K, REFUSE);
    program.len = (unsigned short)(to - code);
    program.filter = code;
    return prctl(PR_SET_SECCOMP, SECCOMP_MODE_FILTER, &program) == 0;
}
  #else
static int scene__enter_seccomp(void) { return 0; }
  #endif

static void scene__close_range(unsigned from, unsigned to) {
    if (from > to || syscall(436 /* close_range */, from, to, 0) == 0) return;
    for (; from <= to && from < 4096; from++) close((int)from);
}

/* Closes all handles that the host had open, except for 0 to 2 and those in kept. */
static void scene__close_others(const int *kept, int count) {
    unsigned from = 3, next;
    int i;
    do {
        for (next = ~0u, i = 0; i < count; i++)
            if (kept[i] >= 0 && (unsigned)kept[i] >= from && (unsigned)kept[i] < next) next = (unsigned)kept[i];
        scene__close_range(from, next - (next != ~0u));
        from = next + 1;
    } while (next != ~0u);
}

static void scene__limit(int what, rlim_t soft, rlim_t hard) {
    struct rlimit limit;
    limit.rlim_cur = soft;
    limit.rlim_max = hard;
    setrlimit(what, &limit);
}

/* Confines this process. From then on, it can only read, compute and exit. The handles in kept stay open. */
static void scene__confine(scene_file *file, double seconds, const int *kept, int count) {
    const rlim_t whole = (rlim_t)seconds + 1;
    int landlock = 0, seccomp = 0;
    scene__print(file->confined, sizeof file->confined, "not confined, because this build uses sanitizers");
    if (SCENE__SANITIZED) return;
    scene__limit(RLIMIT_CORE, 0, 0);
    scene__limit(RLIMIT_FSIZE, 0, 0);
    scene__limit(RLIMIT_CPU, whole, whole + 1);
    scene__limit_own_memory(file);
    if (prctl(PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0) == 0) {
        landlock = scene__enter_landlock(file->folders);
        scene__close_others(kept, count);
        seccomp = scene__enter_seccomp();
    } else scene__close_others(kept, count);
    scene__print(file->confined, sizeof file->confined, "Landlock %s (version %d), seccomp %s",
                 landlock ? "active" : "not available", landlock, seccomp ? "active" : "not available");
}
#else
static void scene__confine(scene_file *file, double seconds, const int *kept, int count) {
    (void)seconds; (void)kept; (void)count;
    scene__print(file->confined, sizeof file->confined, "Landlock not available, seccomp not available");
}
#endif

#endif
