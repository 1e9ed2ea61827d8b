/* The private names of the implementation, for tests that call private functions or read private structures. Include it
   instead of sbl.h, before the system headers. The public functions still come from the object that all programs share
   (see scripts/Makefile): gnu_inline makes the compiler drop their bodies here, with all private functions that only
   they call, so that a test compiles only the private functions that it calls itself. system_header: a compiler without
   this word complains that these inline functions use static ones; other files test the warnings of sbl.h. */
#ifndef PRIVATE_H
#define PRIVATE_H
#pragma GCC system_header
#define SBL_IMPLEMENTATION
#ifndef _WIN32
  #define SBL_EGL
#endif
#define SBL_API extern inline __attribute__((gnu_inline))
#include "../../sbl.h"
#endif
