/* Sets up GL for a host program: creates a context without a window by EGL, or with a hidden window on Windows, and
   loads the program's own pointers to GL functions. The examples that run sbl.h inside a host program use it, and the
   bench. This file does not depend on sbl.h.

       if (!host_gl_open("name of the program")) return 1;
       gl.ClearColor(0, 0, 0, 1);
       host_gl_close(); */
#ifndef HOST_GL_H
#define HOST_GL_H

#ifdef _WIN32
  #include "wgl.h"
#else
  #include <EGL/egl.h>
  #include <EGL/eglext.h>
#endif
#include <GL/glcorearb.h>
#include <stdio.h>
#include <string.h>

#define HOST_GL_FUNCTIONS(X)                                                                                          \
    X(ACTIVETEXTURE, ActiveTexture) X(ATTACHSHADER, AttachShader) X(BINDBUFFER, BindBuffer)                           \
    X(BINDFRAMEBUFFER, BindFramebuffer)                                                                               \
    X(BINDSAMPLER, BindSampler) X(BINDTEXTURE, BindTexture) X(BINDVERTEXARRAY, BindVertexArray)                       \
    X(BLENDFUNC, BlendFunc)                                                                                           \
    X(BUFFERDATA, BufferData) X(CHECKFRAMEBUFFERSTATUS, CheckFramebufferStatus) X(CLEAR, Clear)                       \
    X(CLEARBUFFERFV, ClearBufferfv) X(CLEARCOLOR, ClearColor) X(DRAWELEMENTSINSTANCED, DrawElementsInstanced)         \
    X(CLEARDEPTH, ClearDepth) X(CLEARSTENCIL, ClearStencil) X(COLORMASK, ColorMask) X(COMPILESHADER, CompileShader)   \
    X(CREATEPROGRAM, CreateProgram) X(CREATESHADER, CreateShader) X(CULLFACE, CullFace)                               \
    X(DELETEBUFFERS, DeleteBuffers)                                                                                   \
    X(DELETEFRAMEBUFFERS, DeleteFramebuffers) X(DELETEPROGRAM, DeleteProgram) X(DELETESAMPLERS, DeleteSamplers)       \
    X(DELETESHADER, DeleteShader) X(DELETETEXTURES, DeleteTextures) X(DELETEVERTEXARRAYS, DeleteVertexArrays)         \
    X(DEPTHFUNC, DepthFunc) X(DEPTHMASK, DepthMask) X(DEPTHRANGE, DepthRange) X(DISABLE, Disable)                     \
    X(DRAWARRAYS, DrawArrays)                                                                                         \
    X(DRAWARRAYSINSTANCED, DrawArraysInstanced) X(ENABLE, Enable) X(ENABLEVERTEXATTRIBARRAY, EnableVertexAttribArray) \
    X(FINISH, Finish) X(FRAMEBUFFERTEXTURE2D, FramebufferTexture2D) X(FRONTFACE, FrontFace) X(GENBUFFERS, GenBuffers) \
    X(GENFRAMEBUFFERS, GenFramebuffers) X(GENSAMPLERS, GenSamplers) X(GENTEXTURES, GenTextures)                       \
    X(GENVERTEXARRAYS, GenVertexArrays)                                                                               \
    X(GETATTRIBLOCATION, GetAttribLocation)                                                                           \
    X(GETERROR, GetError) X(GETFLOATV, GetFloatv) X(GETINTEGERV, GetIntegerv) X(GETPROGRAMINFOLOG, GetProgramInfoLog) \
    X(GETPROGRAMIV, GetProgramiv) X(GETSTRING, GetString) X(GETUNIFORMLOCATION, GetUniformLocation)                   \
    X(ISENABLED, IsEnabled)                                                                                           \
    X(LINKPROGRAM, LinkProgram) X(PIXELSTOREI, PixelStorei) X(POLYGONOFFSET, PolygonOffset) X(READPIXELS, ReadPixels) \
    X(SAMPLERPARAMETERI, SamplerParameteri) X(SCISSOR, Scissor) X(SHADERSOURCE, ShaderSource)                         \
    X(STENCILFUNC, StencilFunc)                                                                                       \
    X(STENCILMASK, StencilMask) X(STENCILOP, StencilOp) X(TEXIMAGE2D, TexImage2D) X(TEXPARAMETERI, TexParameteri)     \
    X(UNIFORM1F, Uniform1f) X(UNIFORM1I, Uniform1i) X(UNIFORM2F, Uniform2f) X(UNIFORM2I, Uniform2i)                   \
    X(UNIFORM3FV, Uniform3fv)                                                                                         \
    X(UNIFORM4F, Uniform4f) X(UNIFORMMATRIX4FV, UniformMatrix4fv) X(USEPROGRAM, UseProgram)                           \
    X(VERTEXATTRIB4F, VertexAttrib4f) X(VERTEXATTRIBPOINTER, VertexAttribPointer) X(VIEWPORT, Viewport)

static struct host_gl {
#define X(TYPE, name) PFNGL##TYPE##PROC name;
    HOST_GL_FUNCTIONS(X)
#undef X
#ifndef _WIN32
    EGLDisplay display;
    EGLContext context;
#endif
} gl;

#ifdef _WIN32

static inline int host_gl__open_context(const char *program) { return wgl_open(program); }
static inline void host_gl_close(void) { wgl_close(); }
static inline void (*host_gl_function(const char *name))(void) { return wgl_function(name); }

#else

/* Initialises the display and makes a new context current, without a surface. Returns 0 on failure. */
static inline int host_gl_try(EGLDisplay display) {
    static const EGLint config_wishes[] = { EGL_SURFACE_TYPE, EGL_PBUFFER_BIT, EGL_RENDERABLE_TYPE, EGL_OPENGL_BIT,
        EGL_NONE };
    static const EGLint context_wishes[] = { EGL_CONTEXT_MAJOR_VERSION, 3, EGL_CONTEXT_MINOR_VERSION, 3,
                                             EGL_CONTEXT_OPENGL_PROFILE_MASK, EGL_CONTEXT_OPENGL_CORE_PROFILE_BIT,
                                                 EGL_NONE };
    EGLConfig config;
    EGLint count = 0;
    if (display == EGL_NO_DISPLAY || !eglInitialize(display, NULL, NULL)) return 0;
    if (eglBindAPI(EGL_OPENGL_API) && eglChooseConfig(display, config_wishes, &config, 1, &count) && count) {
        gl.context = eglCreateContext(display, config, EGL_NO_CONTEXT, context_wishes);
        if (gl.context != EGL_NO_CONTEXT && eglMakeCurrent(display, EGL_NO_SURFACE, EGL_NO_SURFACE, gl.context)) {
            gl.display = display;
            return 1;
        }
    }
    return 0;
}

/* Destroys the context. Does not terminate the display, because sbl.h or another library may use it, too. */
static inline void host_gl_close(void) {
    if (gl.display == EGL_NO_DISPLAY) return;
    eglMakeCurrent(gl.display, EGL_NO_SURFACE, EGL_NO_SURFACE, EGL_NO_CONTEXT);
    eglDestroyContext(gl.display, gl.context);
    gl.display = EGL_NO_DISPLAY;
}

static inline int host_gl__open_context(const char *program) {
    PFNEGLGETPLATFORMDISPLAYEXTPROC get_display =
        (PFNEGLGETPLATFORMDISPLAYEXTPROC)eglGetProcAddress("eglGetPlatformDisplayEXT");
    PFNEGLQUERYDEVICESEXTPROC query_devices = (PFNEGLQUERYDEVICESEXTPROC)eglGetProcAddress("eglQueryDevicesEXT");
    EGLDeviceEXT devices[16];
    EGLint device_count = 0, i;
    int opened = 0;
    if (get_display) {
        if (query_devices && !query_devices(16, devices, &device_count)) device_count = 0;
        opened = host_gl_try(get_display(EGL_PLATFORM_SURFACELESS_MESA, EGL_DEFAULT_DISPLAY, NULL));
        for (i = 0; i < device_count && !opened; i++)
            opened = host_gl_try(get_display(EGL_PLATFORM_DEVICE_EXT, devices[i], NULL));
    }
    if (!opened && !host_gl_try(eglGetDisplay(EGL_DEFAULT_DISPLAY))) {
        fprintf(stderr, "%s: EGL provides no OpenGL 3.3 context; is a GL driver (such as Mesa) installed?\n", program);
        return 0;
    }
    return 1;
}

static inline void (*host_gl_function(const char *name))(void) { return eglGetProcAddress(name); }

#endif

/* Loads all functions of the current context. Prints a message and returns 0 if one is missing. */
static inline int host_gl_load(const char *program, void (*(*find)(const char *name))(void)) {
#define X(TYPE, name)                                                                          \
    if (!(gl.name = (PFNGL##TYPE##PROC)find("gl" #name)))                                      \
        return fprintf(stderr, "%s: the GL driver has no gl" #name "\n", program), 0;
    HOST_GL_FUNCTIONS(X)
#undef X
    return 1;
}

/* Creates the context and loads all functions. Prints a message and returns 0 on failure. */
static inline int host_gl_open(const char *program) {
    if (!host_gl__open_context(program)) return 0;
    if (host_gl_load(program, host_gl_function)) return 1;
    host_gl_close();
    return 0;
}

/* Compiles a GL program. Prints a message and returns 0 on failure. vertex, fragment: GLSL without #version. defines:
   "", or lines of #define */
static inline GLuint host_gl_program(const char *program, const char *defines, const char *vertex,
                                     const char *fragment) {
    GLuint id = gl.CreateProgram();
    GLint linked = 0;
    char log[1024] = "";
    int i;
    for (i = 0; i < 2; i++) {
        const char *source[3] = { "#version 330 core\n", "", "" };
        GLuint shader = gl.CreateShader(i ? GL_FRAGMENT_SHADER : GL_VERTEX_SHADER);
        source[1] = defines;
        source[2] = i ? fragment : vertex;
        gl.ShaderSource(shader, 3, source, NULL);
        gl.CompileShader(shader);
        gl.AttachShader(id, shader);
        gl.DeleteShader(shader);
    }
    gl.LinkProgram(id);
    gl.GetProgramiv(id, GL_LINK_STATUS, &linked);
    if (linked) return id;
    gl.GetProgramInfoLog(id, (GLsizei)sizeof log, NULL, log);
    log[strcspn(log, "\n")] = 0;
    fprintf(stderr, "%s: a shader of this program does not compile: %s\n", program, log);
    gl.DeleteProgram(id);
    return 0;
}

static inline GLint host_gl_uniform(GLuint program, const char *name) { return gl.GetUniformLocation(program, name); }

#endif
