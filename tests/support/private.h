/* The private names of the implementation, for tests that call private functions or read private structures. Include it
   instead of sbl.h, before the system headers. The public functions still come from the object that all programs share
   (see scripts/Makefile). With -O1 and -fno-inline, gnu_inline makes the compiler drop their bodies here, and with them
   all private functions that only they call. A test then compiles only the private functions that it calls itself.
   system_header: without this word the compiler complains that inline functions use static ones. Other files test the
   warnings of sbl.h. */
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
