/* Are all functions of sbl.h's list what GL's own header declares, to the type? On Windows that has the calling
   convention in it: __stdcall, of which a wrong one breaks the stack on 32 bits. Compiles, or does not. */
#define SBL_IMPLEMENTATION
#include "../../sbl.h"
#ifdef _WIN32
  #include <windows.h>
#endif
#define GL_GLEXT_PROTOTYPES
#include <GL/glcorearb.h>

/* int and long are the same on 32 bits, but not to the compiler */
#define ptrdiff_t GLsizeiptr
#define int64_t GLint64
#define SAME(type, name, parameters) \
    typedef char name##_is_as_declared[ \
        __builtin_types_compatible_p(type (SBL__GLAPI *) parameters, __typeof__(&gl##name)) ? 1 : -1];
SBL__GL_FUNCTIONS(SAME)
SBL__GL_OPTIONAL_FUNCTIONS(SAME)

int main(void) { return 0; }
