/* sbl.h for the examples that have no GL of their own; include it instead.

       if (sbl_create(headless("name of the program"), &context) != SBL_SUCCESS) return 1;

   SBL_EGL lets sbl.h make a context by itself. On Windows, where there is no EGL, a hidden window has one until the
   program ends, and sbl.h gets its loader. */
#ifndef HEADLESS_H
#define HEADLESS_H

#ifdef _WIN32

#include "../sbl.h"
#include "wgl.h"
#include <stdlib.h>

static inline sbl_gl_function headless__function(const char *name, void *user) {
    (void)user;
    return (sbl_gl_function)wglGetProcAddress(name);  /* sbl.h finds those of GL 1.1 by itself */
}

/* Without a window the program ends here, having said so on stderr. */
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
