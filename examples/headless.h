/* Include this file instead of sbl.h in an example that has no GL context of its own.

       if (sbl_create(headless("name of the program"), &context) != SBL_SUCCESS) return 1;

   It defines SBL_EGL, with which sbl.h creates a context itself. Windows has no EGL; there, a hidden window provides
   the context until the program ends, and headless returns a descriptor with the function loader of that window. */
#ifndef HEADLESS_H
#define HEADLESS_H

#ifdef _WIN32

#include "../sbl.h"
#include "wgl.h"
#include <stdlib.h>

static inline sbl_gl_function headless__function(const char *name, void *user) {
    (void)user;
    return (sbl_gl_function)wglGetProcAddress(name);  /* does not find functions of GL 1.1; sbl.h loads those itself */
}

/* Returns the descriptor for sbl_create. If no window can be created, prints a message to stderr and ends the
   program. */
static inline const sbl_context_desc *headless(const char *program) {
    static sbl_context_desc desc;
    if (!wgl_open(program)) exit(1);
    desc.get_gl_function = headless__function;
    return &desc;
}

#else

#define SBL_EGL
#include "../sbl.h"

static inline const sbl_context_desc *headless(const char *program) { (void)program; return NULL; }

#endif
#endif
