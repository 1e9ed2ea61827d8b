/* Tests that need Windows: test_windows.sh compiles this file with mingw-w64 and runs it under wine. */
#include "../../examples/wgl.h"
#include "../support/private.h"
#include "../support/test.h"

static int unknown;  /* number of functions that wglGetProcAddress did not find */

/* For a function that they do not have, drivers return NULL or one of these numbers. */
static sbl_gl_function wgl_loader(const char *name, void *user) {
    const sbl_gl_function found = (sbl_gl_function)wglGetProcAddress(name);
    if (found) return found;
    unknown++;
    return (sbl_gl_function)*(const intptr_t *)user;
}

TEST(gl_1_1_is_found_without_the_loader) {
    static const intptr_t answers[] = { 0, 1, 2, 3, -1 };
    sbl_context_desc desc = { 0 };
    int i;
    desc.get_gl_function = wgl_loader;
    for (i = 0; i < 5; i++) {
        intptr_t answer = answers[i];
        sbl_context *context = NULL;
        desc.gl_user = &answer;
        unknown = 0;
        CHECK(sbl_create(&desc, &context) == SBL_SUCCESS, "the loader returns %d", (int)answer);
        CHECK(unknown > 20, "wglGetProcAddress finds all but %d functions; this test needs more", unknown);
        sbl_destroy(context);
    }
}

TEST(clock_goes_by_seconds) {
    const double start = sbl__now();
    double seconds;
    Sleep(200);
    seconds = sbl__now() - start;
    CHECK(seconds > 0.19 && seconds < 60, "0.2 s took %g s", seconds);
}

TEST(large_numbers_are_printed) {
    const int64_t sensors = (int64_t)1 << 40;
    char text[64];
    snprintf(text, sizeof text, "%lld %zu", (long long)sensors, (size_t)7);  /* like the examples */
    CHECK(strcmp(text, "1099511627776 7") == 0, "%s", text);
}

int main(void) {
    if (!wgl_open("windows")) return 1;
    RUN(gl_1_1_is_found_without_the_loader);
    RUN(clock_goes_by_seconds);
    RUN(large_numbers_are_printed);
    wgl_close();
    return test_report();
}
