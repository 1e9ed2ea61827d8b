/* Loses a context: tests/test_scripts.sh wants the leak sanitizer to say so, driver's suppressions or not. */
#define SBL_IMPLEMENTATION
#define SBL_EGL
#include "../../sbl.h"

int main(void) {
    sbl_context *context;
    if (sbl_create(NULL, &context) != SBL_SUCCESS) return 0;
    context = NULL;
    return context != NULL;
}
