/* Leaks a context. tests/test_scripts.sh checks that the leak sanitizer reports it in spite of the driver's
   suppressions. */
#define SBL_IMPLEMENTATION
#define SBL_EGL
#include "../../sbl.h"

int main(void) {
    sbl_context *context;
    if (sbl_create(NULL, &context) != SBL_SUCCESS) return 0;
    context = NULL;
    return context != NULL;
}
