/* The GL of a host program for tests: the context and functions of the examples, and further functions that the tests
   call. Include after sbl.h and test.h.
       if (!gl_host_open()) ...            makes a context current; its functions are gl.Name and more_gl.Name
       desc.get_gl_function = gl_host_proc */
#ifndef GL_HOST_H
#define GL_HOST_H

#include "../../examples/host_gl.h"

#define GL_HOST_FUNCTIONS(X)                                                                                          \
    X(BEGINCONDITIONALRENDER, BeginConditionalRender) X(BINDBUFFERBASE, BindBufferBase)                               \
    X(BINDBUFFERRANGE, BindBufferRange)                                                                               \
    X(BINDRENDERBUFFER, BindRenderbuffer) X(FRAMEBUFFERRENDERBUFFER, FramebufferRenderbuffer)                         \
    X(BLENDCOLOR, BlendColor) X(BLENDEQUATIONSEPARATE, BlendEquationSeparate) X(BLENDFUNCSEPARATE, BlendFuncSeparate) \
    X(CLAMPCOLOR, ClampColor) X(COLORMASKI, ColorMaski) X(DELETERENDERBUFFERS, DeleteRenderbuffers)                   \
    X(DISABLEI, Disablei)                                                                                             \
    X(DRAWBUFFERS, DrawBuffers) X(DRAWELEMENTS, DrawElements) X(ENABLEI, Enablei)                                     \
    X(GENRENDERBUFFERS, GenRenderbuffers)                                                                             \
    X(GETBOOLEANI_V, GetBooleani_v) X(GETBOOLEANV, GetBooleanv) X(GETBUFFERSUBDATA, GetBufferSubData)                 \
    X(GETDOUBLEV, GetDoublev)                                                                                         \
    X(GETINTEGER64I_V, GetInteger64i_v) X(GETINTEGERI_V, GetIntegeri_v) X(GETTEXIMAGE, GetTexImage)                   \
    X(GETTEXLEVELPARAMETERIV, GetTexLevelParameteriv) X(GETTEXPARAMETERIV, GetTexParameteriv)                         \
    X(GETVERTEXATTRIBIV, GetVertexAttribiv)                                                                           \
    X(HINT, Hint) X(ISENABLEDI, IsEnabledi) X(LINEWIDTH, LineWidth) X(LOGICOP, LogicOp) X(PIXELSTOREF, PixelStoref)   \
    X(POINTSIZE, PointSize) X(POLYGONMODE, PolygonMode) X(PRIMITIVERESTARTINDEX, PrimitiveRestartIndex)               \
    X(PROVOKINGVERTEX, ProvokingVertex) X(READBUFFER, ReadBuffer) X(RENDERBUFFERSTORAGE, RenderbufferStorage)         \
    X(SAMPLECOVERAGE, SampleCoverage) X(SAMPLEMASKI, SampleMaski) X(STENCILFUNCSEPARATE, StencilFuncSeparate)         \
    X(STENCILMASKSEPARATE, StencilMaskSeparate) X(STENCILOPSEPARATE, StencilOpSeparate) X(TEXBUFFER, TexBuffer)       \
    X(TEXIMAGE1D, TexImage1D) X(TEXIMAGE3D, TexImage3D) X(TEXSUBIMAGE2D, TexSubImage2D)                               \
    X(VERTEXATTRIBDIVISOR, VertexAttribDivisor)

/* functions of newer GL versions; NULL if the driver lacks them */
#define GL_HOST_OPTIONAL_FUNCTIONS(X)                                                                     \
    X(CLIPCONTROL, ClipControl) X(MINSAMPLESHADING, MinSampleShading) X(PATCHPARAMETERI, PatchParameteri) \
    X(VIEWPORTINDEXEDF, ViewportIndexedf)                                                                 \
    X(SCISSORINDEXED, ScissorIndexed) X(GETFLOATI_V, GetFloati_v) X(DEPTHRANGEINDEXED, DepthRangeIndexed) \
    X(GETDOUBLEI_V, GetDoublei_v)                                                                         \
    X(BINDIMAGETEXTURE, BindImageTexture)

static struct gl_host_more {
#define X(TYPE, name) PFNGL##TYPE##PROC name;
    GL_HOST_FUNCTIONS(X)
    GL_HOST_OPTIONAL_FUNCTIONS(X)
#undef X
    int version;  /* such as 33 or 45 */
} more_gl;

static inline sbl_gl_function gl_host_proc(const char *name, void *user) {
    (void)user;
    return (sbl_gl_function)eglGetProcAddress(name);
}

static inline int gl_host_open(void) {
    GLint major = 0, minor = 0;
    if (!host_gl_open("test")) return 0;
    gl.GetIntegerv(GL_MAJOR_VERSION, &major);
    gl.GetIntegerv(GL_MINOR_VERSION, &minor);
    more_gl.version = 10 * major + minor;
#define X(TYPE, name) \
    if (!(more_gl.name = (PFNGL##TYPE##PROC)eglGetProcAddress("gl" #name))) { printf("no gl" #name "\n"); return 0; }
    GL_HOST_FUNCTIONS(X)
#undef X
#define X(TYPE, name) more_gl.name = (PFNGL##TYPE##PROC)eglGetProcAddress("gl" #name);
    GL_HOST_OPTIONAL_FUNCTIONS(X)
#undef X
    /* loaders also return functions that the version of the context does not have */
    if (more_gl.version < 45) more_gl.ClipControl = NULL;
    if (more_gl.version < 42) more_gl.BindImageTexture = NULL;
    if (more_gl.version < 41) {
        more_gl.ViewportIndexedf = NULL;
        more_gl.ScissorIndexed = NULL;
        more_gl.DepthRangeIndexed = NULL;
    }
    if (more_gl.version < 40) { more_gl.MinSampleShading = NULL; more_gl.PatchParameteri = NULL; }
    return 1;
}

#endif
