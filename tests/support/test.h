/* The test harness. A test program consists of TEST functions and a main with RUN lines.
       TEST(sum_is_one) { CHECK(fabs(sum - 1) < 1e-5, "sum %.9g, expected 1", sum); }
       int main(void) { RUN(sum_is_one); return test_report(); }
   CHECK reports a failure and continues; REQUIRE reports it and leaves the test. SKIP prints a reason and leaves the
   test. The last line of the output is "N passed, N failed, N skipped"; scripts/test adds these up. A test without any
   CHECK counts as failed.
       TEST_ONLY=sum_is_one build/test_NAME        runs only this test; fails if it does not exist */
#ifndef TEST_H
#define TEST_H

#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#ifndef _WIN32
#include <sys/resource.h>
#endif

static int test_passed, test_failed, test_skipped;
static int test_checks, test_errors, test_left_out;

#define TEST(name) static void test_##name(void)
#define TEST__FAIL(...) (test_errors++, printf("  %s:%d: ", __FILE__, __LINE__), printf(__VA_ARGS__), printf("\n"))
#define CHECK(condition, ...) do { test_checks++; if (!(condition)) TEST__FAIL(__VA_ARGS__); } while (0)
#define REQUIRE(condition, ...) do { test_checks++; if (!(condition)) { TEST__FAIL(__VA_ARGS__); return; } } while (0)
#define SKIP(...) do { test_left_out = 1; printf("  skipped: "); printf(__VA_ARGS__); printf("\n"); return; } while (0)

#define TEST_PI 3.14159265358979323846

/* Returns 1 if this is a run of the given kind (see scripts/test). A program that is run by hand counts as plain. */
static inline int test_kind_is(const char *kind) {
    const char *now = getenv("TEST_KIND");
    return strcmp(now ? now : "plain", kind) == 0;
}
/* Runs a test in all runs except `rest`, because the sanitized run of the program already runs it. */
#define RUN(name) do { if (!test_kind_is("rest")) test_run(#name, test_##name); } while (0)

/* Runs a long test only once. Each program has either a plain run or a `rest` run, and the test runs only there.
   Shorter tests cover the same code in the other runs. */
#define RUN_PLAIN(name) \
    do { if (test_kind_is("plain") || test_kind_is("rest")) test_run(#name, test_##name); } while (0)

/* Runs a test only without sanitizers. This is for numeric comparisons whose code other tests run with sanitizers. */
#define RUN_UNSANITIZED(name) do { if (!test_kind_is("sanitized")) test_run(#name, test_##name); } while (0)

/* Unlike fmax and fmin, these return NaN if an argument is NaN, so that every comparison with the result fails. */
static inline double test_max(double a, double b) { return a >= b || a != a ? a : b; }
static inline double test_min(double a, double b) { return a <= b || a != a ? a : b; }

/* Hashes x to 32 bits (PCG), which gives sequences of numbers without a pattern. */
static inline uint32_t test_hash(uint32_t x) {
    uint32_t word;
    x = x * 747796405u + 2891336453u;
    word = ((x >> ((x >> 28) + 4u)) ^ x) * 277803737u;
    return (word >> 22) ^ word;
}

/* Returns the seconds of processor time that this process and its ended children have used. On Windows, children are
   not counted. */
static inline double test_seconds(void) {
#ifdef _WIN32
    return (double)clock() / CLOCKS_PER_SEC;
#else
    double seconds = 0;
    int i;
    for (i = 0; i < 2; i++) {
        struct rusage used;
        getrusage(i ? RUSAGE_CHILDREN : RUSAGE_SELF, &used);
        seconds += (double)(used.ru_utime.tv_sec + used.ru_stime.tv_sec) +
            1e-6 * (double)(used.ru_utime.tv_usec + used.ru_stime.tv_usec);
    }
    return seconds;
#endif
}

static void test_run(const char *name, void (*function)(void)) {
    const char *only = getenv("TEST_ONLY");
    const double start = test_seconds();
    if (only && strcmp(only, name) != 0) return;
    test_checks = test_errors = test_left_out = 0;
    function();
    if (!test_left_out && test_checks == 0) { test_errors++; printf("  %s checks nothing\n", name); }
    if (test_errors) test_failed++;
    else if (test_left_out) test_skipped++;
    else test_passed++;
    printf("%s %s  %.1f s\n", test_errors ? "FAIL" : test_left_out ? "skip" : "ok  ", name,
           test_seconds() - start);
    fflush(stdout);
}

static int test_report(void) {
    printf("%d passed, %d failed, %d skipped\n", test_passed, test_failed, test_skipped);
    return test_failed != 0 || test_passed + test_skipped == 0;
}

#endif
