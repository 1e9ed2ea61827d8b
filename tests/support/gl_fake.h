/* A GL that fails on demand: its functions, for sbl_context_desc.get_gl_function, call the real ones. It also records
   the names of all objects that are created, to check that each is deleted exactly once.
       desc.get_gl_function = fake_proc;
       fake_arm(FAKE_NO_NAME, 3, 0);        the third glGen or glCreate from now on returns 0
       ...
       fake_disarm();  fake.hits            the number of times that the fault happened
   Include after gl_host.h. */
#ifndef GL_FAKE_H
#define GL_FAKE_H

typedef enum fake_fault {
    FAKE_NONE = 0,
    FAKE_LOOKUP,       /* the loader does not find the function */
    FAKE_NO_NAME,      /* glGen* and glCreate* return 0 */
    FAKE_REFUSE,       /* a call that stores, draws or reads has no effect; glGetError then returns fake.error */
    FAKE_ERROR,        /* glGetError returns fake.error, although the call had its effect */
    FAKE_FRAMEBUFFER,  /* glCheckFramebufferStatus returns GL_FRAMEBUFFER_UNSUPPORTED */
    FAKE_COMPILE,      /* a shader does not compile */
    FAKE_LINK,         /* a program does not link */
    FAKE_FAULTS
} fake_fault;

typedef enum fake_kind { FAKE_BUFFER, FAKE_FRAMEBUFFER_OBJECT, FAKE_TEXTURE, FAKE_VERTEX_ARRAY, FAKE_PROGRAM,
    FAKE_SHADER, FAKE_KINDS } fake_kind;

enum { FAKE_NAMES = 512 };

static struct {
    fake_fault fault;
    int at, hits;
    int counts[FAKE_FAULTS];       /* number of calls since fake_arm at which each fault was possible */
    GLenum error, pending;
    char lookup[64];               /* name that FAKE_LOOKUP did not find */
    const char *version;           /* if not NULL, replaces GL_VERSION */
    int major, minor;              /* if not 0, replace GL_MAJOR_VERSION and GL_MINOR_VERSION */
    int most_texels, texture_size; /* if not 0, replace GL_MAX_TEXTURE_BUFFER_SIZE and GL_MAX_TEXTURE_SIZE */
    int units;                     /* if not 0, replaces GL_MAX_TEXTURE_IMAGE_UNITS */
    int texels;                    /* size of the largest buffer texture so far */
    GLuint names[FAKE_KINDS][FAKE_NAMES];
    int live[FAKE_KINDS], made;
    int strangers;                 /* number of deletions of names that were already deleted or never created */
    void (*reached)(fake_fault);   /* if not NULL, called wherever a fault is possible */
} fake;

static inline void fake_arm(fake_fault fault, int at, GLenum error) {
    memset(fake.counts, 0, sizeof fake.counts);
    fake.fault = fault;
    fake.at = at;
    fake.error = error;
    fake.pending = GL_NO_ERROR;
    fake.hits = 0;
}

static inline void fake_disarm(void) { fake.fault = FAKE_NONE; }

static inline int fake_live(void) {
    int kind, sum = 0;
    for (kind = 0; kind < FAKE_KINDS; kind++) sum += fake.live[kind];
    return sum;
}

static inline int fake__strikes(fake_fault fault) {
    if (fake.reached) fake.reached(fault);
    if (++fake.counts[fault] != fake.at || fake.fault != fault) return 0;
    fake.hits++;
    return 1;
}

static inline int fake__refuses(void) {
    if (!fake__strikes(FAKE_REFUSE)) return 0;
    fake.pending = fake.error;
    return 1;
}

static inline void fake__born(fake_kind kind, GLuint name) {
    if (!name) return;
    if (fake.live[kind] == FAKE_NAMES) abort();
    fake.names[kind][fake.live[kind]++] = name;
    fake.made++;
}

static inline void fake__died(fake_kind kind, GLuint name) {
    int i;
    if (!name) return;  /* GL ignores the name 0 */
    for (i = 0; i < fake.live[kind]; i++)
        if (fake.names[kind][i] == name) {
            fake.names[kind][i] = fake.names[kind][--fake.live[kind]];
            return;
        }
    fake.strangers++;
}

#define FAKE_GEN(Names, kind)                                                              \
    static void APIENTRY fake_Gen##Names(GLsizei count, GLuint *names) {                   \
        int i, none = fake__strikes(FAKE_NO_NAME);                                         \
        if (none) memset(names, 0, (size_t)count * sizeof *names);                         \
        else gl.Gen##Names(count, names);                                                  \
        for (i = 0; i < count; i++) fake__born(kind, names[i]);                            \
    }                                                                                      \
    static void APIENTRY fake_Delete##Names(GLsizei count, const GLuint *names) {          \
        int i;                                                                             \
        for (i = 0; i < count; i++) fake__died(kind, names[i]);                            \
        gl.Delete##Names(count, names);                                                    \
    }
FAKE_GEN(Buffers, FAKE_BUFFER)
FAKE_GEN(Framebuffers, FAKE_FRAMEBUFFER_OBJECT)
FAKE_GEN(Textures, FAKE_TEXTURE)
FAKE_GEN(VertexArrays, FAKE_VERTEX_ARRAY)

static GLuint APIENTRY fake_CreateProgram(void) {
    GLuint name = fake__strikes(FAKE_NO_NAME) ? 0 : gl.CreateProgram();
    fake__born(FAKE_PROGRAM, name);
    return name;
}
static GLuint APIENTRY fake_CreateShader(GLenum type) {
    GLuint name = fake__strikes(FAKE_NO_NAME) ? 0 : gl.CreateShader(type);
    fake__born(FAKE_SHADER, name);
    return name;
}
static void APIENTRY fake_DeleteProgram(GLuint name) { fake__died(FAKE_PROGRAM, name); gl.DeleteProgram(name); }
static void APIENTRY fake_DeleteShader(GLuint name) { fake__died(FAKE_SHADER, name); gl.DeleteShader(name); }

static GLenum APIENTRY fake_GetError(void) {
    GLenum error = fake.pending;
    fake.pending = GL_NO_ERROR;
    if (error == GL_NO_ERROR) error = gl.GetError();
    if (fake__strikes(FAKE_ERROR)) return fake.error;
    return error;
}
static GLenum APIENTRY fake_CheckFramebufferStatus(GLenum target) {
    return fake__strikes(FAKE_FRAMEBUFFER) ? GL_FRAMEBUFFER_UNSUPPORTED : gl.CheckFramebufferStatus(target);
}
static void APIENTRY fake_GetShaderiv(GLuint shader, GLenum name, GLint *out) {
    PFNGLGETSHADERIVPROC real = (PFNGLGETSHADERIVPROC)eglGetProcAddress("glGetShaderiv");
    real(shader, name, out);
    if (name == GL_COMPILE_STATUS && fake__strikes(FAKE_COMPILE)) *out = 0;
}
static void APIENTRY fake_GetProgramiv(GLuint program, GLenum name, GLint *out) {
    gl.GetProgramiv(program, name, out);
    if (name == GL_LINK_STATUS && fake__strikes(FAKE_LINK)) *out = 0;
}
static const GLubyte *APIENTRY fake_GetString(GLenum name) {
    return name == GL_VERSION && fake.version ? (const GLubyte *)fake.version : gl.GetString(name);
}
static void APIENTRY fake_GetIntegerv(GLenum name, GLint *out) {
    gl.GetIntegerv(name, out);
    if (fake.major && name == GL_MAJOR_VERSION) *out = fake.major;
    if (fake.major && name == GL_MINOR_VERSION) *out = fake.minor;
    if (fake.most_texels && name == GL_MAX_TEXTURE_BUFFER_SIZE) *out = fake.most_texels;
    if (fake.units && name == GL_MAX_TEXTURE_IMAGE_UNITS) *out = fake.units;
    if (fake.texture_size && name == GL_MAX_TEXTURE_SIZE) *out = fake.texture_size;
}

static void APIENTRY fake_BufferData(GLenum target, GLsizeiptr size, const void *data, GLenum usage) {
    if (!fake__refuses()) gl.BufferData(target, size, data, usage);
}
static void APIENTRY fake_BufferSubData(GLenum target, GLintptr offset, GLsizeiptr size, const void *data) {
    PFNGLBUFFERSUBDATAPROC real = (PFNGLBUFFERSUBDATAPROC)eglGetProcAddress("glBufferSubData");
    if (!fake__refuses()) real(target, offset, size, data);
}
static void APIENTRY fake_GetBufferSubData(GLenum target, GLintptr offset, GLsizeiptr size, void *data) {
    if (!fake__refuses()) more_gl.GetBufferSubData(target, offset, size, data);
}
static void APIENTRY fake_TexBuffer(GLenum target, GLenum format, GLuint buffer) {
    GLint texels = 0;
    if (fake__refuses()) return;
    more_gl.TexBuffer(target, format, buffer);
    more_gl.GetTexLevelParameteriv(target, 0, GL_TEXTURE_WIDTH, &texels);
    if (texels > fake.texels) fake.texels = texels;
}
static void APIENTRY fake_TexImage2D(GLenum target, GLint level, GLint internal_format, GLsizei width, GLsizei height,
                                     GLint border, GLenum format,
    GLenum type, const void *pixels) {
    if (!fake__refuses()) gl.TexImage2D(target, level, internal_format, width, height, border, format, type, pixels);
}
static void APIENTRY fake_TexSubImage2D(GLenum target, GLint level, GLint x, GLint y, GLsizei width, GLsizei height,
                                        GLenum format, GLenum type,
    const void *pixels) {
    if (!fake__refuses()) more_gl.TexSubImage2D(target, level, x, y, width, height, format, type, pixels);
}
static void APIENTRY fake_DrawArrays(GLenum mode, GLint first, GLsizei count) {
    if (!fake__refuses()) gl.DrawArrays(mode, first, count);
}
static void APIENTRY fake_DrawElements(GLenum mode, GLsizei count, GLenum type, const void *indices) {
    if (!fake__refuses()) more_gl.DrawElements(mode, count, type, indices);
}
static void APIENTRY fake_DrawElementsInstanced(GLenum mode, GLsizei count, GLenum type, const void *indices,
                                                GLsizei instances) {
    PFNGLDRAWELEMENTSINSTANCEDPROC real = (PFNGLDRAWELEMENTSINSTANCEDPROC)eglGetProcAddress("glDrawElementsInstanced");
    if (!fake__refuses()) real(mode, count, type, indices, instances);
}
static void APIENTRY fake_DispatchCompute(GLuint x, GLuint y, GLuint z) {
    PFNGLDISPATCHCOMPUTEPROC real = (PFNGLDISPATCHCOMPUTEPROC)eglGetProcAddress("glDispatchCompute");
    if (!fake__refuses()) real(x, y, z);
}
static void APIENTRY fake_ReadPixels(GLint x, GLint y, GLsizei width, GLsizei height, GLenum format, GLenum type,
                                     void *pixels) {
    if (!fake__refuses()) gl.ReadPixels(x, y, width, height, format, type, pixels);
}

static inline sbl_gl_function fake_proc(const char *name, void *user) {
    static const struct { const char *name; sbl_gl_function function; } fakes[] = {
#define X(name) { "gl" #name, (sbl_gl_function)fake_##name },
        X(GenBuffers) X(GenFramebuffers) X(GenTextures) X(GenVertexArrays) X(DeleteBuffers) X(DeleteFramebuffers)
        X(DeleteTextures) X(DeleteVertexArrays)
        X(CreateProgram) X(CreateShader) X(DeleteProgram) X(DeleteShader) X(GetError) X(CheckFramebufferStatus)
        X(GetShaderiv) X(GetProgramiv) X(GetString)
        X(GetIntegerv) X(BufferData) X(BufferSubData) X(GetBufferSubData) X(TexBuffer) X(TexImage2D) X(TexSubImage2D)
        X(DrawArrays) X(DrawElements)
        X(DrawElementsInstanced) X(DispatchCompute) X(ReadPixels)
#undef X
    };
    int i;
    if (fake__strikes(FAKE_LOOKUP)) {
        snprintf(fake.lookup, sizeof fake.lookup, "%s", name);
        return NULL;
    }
    for (i = 0; i < (int)(sizeof fakes / sizeof *fakes); i++)
        if (strcmp(fakes[i].name, name) == 0) return fakes[i].function;
    return gl_host_proc(name, user);
}

#endif
