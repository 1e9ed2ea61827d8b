/* Creates a GL core context on Windows in a window that is never shown. Other systems use EGL.

       if (!wgl_open("name of the program")) return 1;
       clear = (PFNGLCLEARPROC)wgl_function("glClear");
       wgl_close(); */
#ifndef WGL_H
#define WGL_H

#ifndef WIN32_LEAN_AND_MEAN
  #define WIN32_LEAN_AND_MEAN  /* omits headers that this file does not need */
#endif
#include <windows.h>
#include <GL/glcorearb.h>
#include <GL/wglext.h>
#include <stdio.h>
#include <string.h>

typedef void (*wgl_any)(void);

static struct wgl { HWND window; HDC device; HGLRC context; } wgl;

/* Returns a GL function. wglGetProcAddress does not find functions of GL 1.1; those come from opengl32.dll. */
static inline wgl_any wgl_function(const char *name) {
    const wgl_any found = (wgl_any)wglGetProcAddress(name);
    return found ? found : (wgl_any)GetProcAddress(GetModuleHandleA("opengl32.dll"), name);
}

static inline void wgl_close(void) {
    wglMakeCurrent(NULL, NULL);
    if (wgl.context) wglDeleteContext(wgl.context);
    if (wgl.window) DestroyWindow(wgl.window);
    memset(&wgl, 0, sizeof wgl);
}

/* Replaces the current legacy context by a core context. Windows can create a core context only while another context
   is current. */
static inline void wgl__to_core(void) {
    static const int wishes[] = { WGL_CONTEXT_MAJOR_VERSION_ARB, 3, WGL_CONTEXT_MINOR_VERSION_ARB, 3,
                                  WGL_CONTEXT_PROFILE_MASK_ARB, WGL_CONTEXT_CORE_PROFILE_BIT_ARB, 0 };
    const PFNWGLCREATECONTEXTATTRIBSARBPROC create =
        (PFNWGLCREATECONTEXTATTRIBSARBPROC)(wgl_any)wglGetProcAddress("wglCreateContextAttribsARB");
    const HGLRC core = create ? create(wgl.device, NULL, wishes) : NULL, old = wgl.context;
    if (!core || !wglMakeCurrent(wgl.device, core)) return;
    wgl.context = core;
    wglDeleteContext(old);
}

/* Creates the window and the context. Returns 0 and prints a message on failure. */
static inline int wgl_open(const char *program) {
    PIXELFORMATDESCRIPTOR format;
    WNDCLASSA kind;
    memset(&format, 0, sizeof format);
    memset(&kind, 0, sizeof kind);
    format.nSize = sizeof format;
    format.nVersion = 1;
    format.dwFlags = PFD_DRAW_TO_WINDOW | PFD_SUPPORT_OPENGL | PFD_DOUBLEBUFFER;
    format.cColorBits = 24;
    kind.style = CS_OWNDC;
    kind.lpfnWndProc = DefWindowProcA;
    kind.lpszClassName = program;
    RegisterClassA(&kind);
    wgl.window = CreateWindowA(program, program, 0, 0, 0, 16, 16, NULL, NULL, NULL, NULL);
    wgl.device = GetDC(wgl.window);
    if (wgl.window && SetPixelFormat(wgl.device, ChoosePixelFormat(wgl.device, &format), &format))
        wgl.context = wglCreateContext(wgl.device);
    if (wgl.context && wglMakeCurrent(wgl.device, wgl.context)) {
        wgl__to_core();
        return 1;
    }
    fprintf(stderr, "%s: cannot create a window with OpenGL (Windows error %lu)\n", program, GetLastError());
    wgl_close();
    return 0;
}

#endif
