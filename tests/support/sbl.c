/* The library as an object of its own, for the tests that only use its interface: see scripts/Makefile. */
#define SBL_IMPLEMENTATION
#define SBL_EGL
#include "../../sbl.h"
