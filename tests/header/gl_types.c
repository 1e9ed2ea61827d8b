/* Compiles only if every function in sbl.h's list has exactly the type that GL's own header declares. On Windows this
   includes the calling convention: a wrong one instead of __stdcall breaks the stack on 32 bits. */
#define SBL_IMPLEMENTATION
#include "../../sbl.h"
#ifdef _WIN32
  #include <windows.h>
#endif
#define GL_GLEXT_PROTOTYPES
#include <GL/glcorearb.h>

/* on 32 bits int and long are equal, but different types for the compiler */
#define ptrdiff_t GLsizeiptr
#define int64_t GLint64
#define SAME(type, name, parameters) \
    typedef char name##_is_as_declared[ \
        __builtin_types_compatible_p(type (SBL__GLAPI *) parameters, __typeof__(&gl##name)) ? 1 : -1];
SBL__GL_FUNCTIONS(SAME)
SBL__GL_OPTIONAL_FUNCTIONS(SAME)

int main(void) { return 0; }
