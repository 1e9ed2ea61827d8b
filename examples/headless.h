/* Includes sbl.h for examples without a GL context of their own. Include this file instead of sbl.h.

       if (sbl_create(headless("name of the program"), &context) != SBL_SUCCESS) return 1;

   With SBL_EGL, sbl.h creates a context itself. On Windows, which has no EGL, a hidden window provides the context
   until the program ends, and sbl.h gets the function loader of that window. */
#ifndef HEADLESS_H
#define HEADLESS_H

#ifdef _WIN32

#include "../sbl.h"
#include "wgl.h"
#include <stdlib.h>

static inline sbl_gl_function headless__function(const char *name, void *user) {
    (void)user;
    return (sbl_gl_function)wglGetProcAddress(name);  /* sbl.h loads functions of GL 1.1 itself */
}

/* Ends the program with a message on stderr if no window can be created. */
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
