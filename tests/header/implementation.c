/* One program of three files, part 1: the implementation, in C (or, compiled as such, in C++). */
#define SBL_IMPLEMENTATION
#define SBL_EGL
#include "../../sbl.h"
