/* One program of three files, part 1: the implementation, compiled as C or as C++. */
#define SBL_IMPLEMENTATION
#define SBL_EGL
#include "../../sbl.h"
