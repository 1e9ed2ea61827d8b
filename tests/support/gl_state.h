/* All GL state that sbl.h must not change, as a list of named numbers, which is taken before and after a call and
   compared. gl_state_odd sets this state to values that no program has by chance. Include after gl_host.h. */
#ifndef GL_STATE_H
#define GL_STATE_H

enum { GL_STATE_ENTRIES = 1024, GL_STATE_UNITS = 32 };

typedef struct gl_state {
    int count;
    struct { char name[64]; double value[4]; } entries[GL_STATE_ENTRIES];
} gl_state;

static inline double *gl_state__add(gl_state *s, const char *name, int index) {
    int at = s->count++;
    if (at == GL_STATE_ENTRIES) abort();
    snprintf(s->entries[at].name, sizeof s->entries[at].name, index < 0 ? "%s" : "%s %d", name, index);
    memset(s->entries[at].value, 0, sizeof s->entries[at].value);
    return s->entries[at].value;
}

static const struct { const char *name; unsigned id; int version; } gl_state__switches[] = {
#define X(name, version) { #name, GL_##name, version }
    X(CULL_FACE, 33), X(DEPTH_TEST, 33), X(STENCIL_TEST, 33), X(SCISSOR_TEST, 33), X(COLOR_LOGIC_OP, 33), X(DITHER, 33),
    X(POLYGON_OFFSET_FILL, 33),
    X(POLYGON_OFFSET_LINE, 33), X(POLYGON_OFFSET_POINT, 33), X(LINE_SMOOTH, 33), X(POLYGON_SMOOTH, 33),
    X(MULTISAMPLE, 33), X(SAMPLE_ALPHA_TO_COVERAGE, 33),
    X(SAMPLE_ALPHA_TO_ONE, 33), X(SAMPLE_COVERAGE, 33), X(SAMPLE_MASK, 33), X(DEPTH_CLAMP, 33),
    X(RASTERIZER_DISCARD, 33), X(FRAMEBUFFER_SRGB, 33),
    X(PRIMITIVE_RESTART, 33), X(PROGRAM_POINT_SIZE, 33), X(TEXTURE_CUBE_MAP_SEAMLESS, 33), X(CLIP_DISTANCE0, 33),
    X(CLIP_DISTANCE1, 33), X(CLIP_DISTANCE2, 33),
    X(CLIP_DISTANCE3, 33), X(CLIP_DISTANCE4, 33), X(CLIP_DISTANCE5, 33), X(CLIP_DISTANCE6, 33), X(CLIP_DISTANCE7, 33),
    X(SAMPLE_SHADING, 40),
    X(PRIMITIVE_RESTART_FIXED_INDEX, 43)
};

/* odd: 1 if gl_state_odd changes it */
static const struct { const char *name; unsigned id; int version, odd; } gl_state__numbers[] = {
#undef X
#define X(name, version, odd) { #name, GL_##name, version, odd }
    X(FRONT_FACE, 33, 1), X(CULL_FACE_MODE, 33, 1), X(POLYGON_MODE, 33, 1), X(POLYGON_OFFSET_FACTOR, 33, 1),
    X(POLYGON_OFFSET_UNITS, 33, 1),
    X(DEPTH_FUNC, 33, 1),
    X(DEPTH_WRITEMASK, 33, 1), X(DEPTH_CLEAR_VALUE, 33, 1), X(DEPTH_RANGE, 33, 1), X(STENCIL_FUNC, 33, 1),
    X(STENCIL_REF, 33, 1), X(STENCIL_VALUE_MASK, 33, 1),
    X(STENCIL_WRITEMASK, 33, 1), X(STENCIL_FAIL, 33, 1), X(STENCIL_PASS_DEPTH_FAIL, 33, 1),
    X(STENCIL_PASS_DEPTH_PASS, 33, 1), X(STENCIL_BACK_FUNC, 33, 1),
    X(STENCIL_BACK_REF, 33, 1), X(STENCIL_BACK_VALUE_MASK, 33, 1), X(STENCIL_BACK_WRITEMASK, 33, 1),
    X(STENCIL_BACK_FAIL, 33, 1),
    X(STENCIL_BACK_PASS_DEPTH_FAIL, 33, 1), X(STENCIL_BACK_PASS_DEPTH_PASS, 33, 1), X(STENCIL_CLEAR_VALUE, 33, 1),
    X(COLOR_CLEAR_VALUE, 33, 1),
    X(BLEND_SRC_RGB, 33, 1), X(BLEND_SRC_ALPHA, 33, 1), X(BLEND_DST_RGB, 33, 1), X(BLEND_DST_ALPHA, 33, 1),
    X(BLEND_EQUATION_RGB, 33, 1),
    X(BLEND_EQUATION_ALPHA, 33, 1), X(BLEND_COLOR, 33, 1), X(LOGIC_OP_MODE, 33, 1), X(SAMPLE_COVERAGE_VALUE, 33, 1),
    X(SAMPLE_COVERAGE_INVERT, 33, 1),
    X(VIEWPORT, 33, 1), X(SCISSOR_BOX, 33, 1), X(LINE_WIDTH, 33, 0), X(POINT_SIZE, 33, 1),
    X(PRIMITIVE_RESTART_INDEX, 33, 1), X(PROVOKING_VERTEX, 33, 1),
    X(CLAMP_READ_COLOR, 33, 1), X(LINE_SMOOTH_HINT, 33, 1), X(POLYGON_SMOOTH_HINT, 33, 1),
    X(TEXTURE_COMPRESSION_HINT, 33, 1),
    X(FRAGMENT_SHADER_DERIVATIVE_HINT, 33, 1), X(UNPACK_SWAP_BYTES, 33, 1), X(UNPACK_LSB_FIRST, 33, 1),
    X(UNPACK_ROW_LENGTH, 33, 1), X(UNPACK_SKIP_ROWS, 33, 1),
    X(UNPACK_SKIP_PIXELS, 33, 1), X(UNPACK_ALIGNMENT, 33, 1), X(UNPACK_SKIP_IMAGES, 33, 1),
    X(UNPACK_IMAGE_HEIGHT, 33, 1), X(PACK_SWAP_BYTES, 33, 1),
    X(PACK_LSB_FIRST, 33, 1), X(PACK_ROW_LENGTH, 33, 1), X(PACK_SKIP_ROWS, 33, 1), X(PACK_SKIP_PIXELS, 33, 1),
    X(PACK_ALIGNMENT, 33, 1),
    X(PACK_SKIP_IMAGES, 33, 1),
    X(PACK_IMAGE_HEIGHT, 33, 1), X(CURRENT_PROGRAM, 33, 1), X(VERTEX_ARRAY_BINDING, 33, 1),
    X(ARRAY_BUFFER_BINDING, 33, 1),
    X(ELEMENT_ARRAY_BUFFER_BINDING, 33, 1),
    X(PIXEL_PACK_BUFFER_BINDING, 33, 1), X(PIXEL_UNPACK_BUFFER_BINDING, 33, 1), X(COPY_READ_BUFFER_BINDING, 33, 1),
    X(COPY_WRITE_BUFFER_BINDING, 33, 1),
    X(UNIFORM_BUFFER_BINDING, 33, 1), X(TRANSFORM_FEEDBACK_BUFFER_BINDING, 33, 1), X(TEXTURE_BUFFER_BINDING, 33, 1),
    X(DRAW_FRAMEBUFFER_BINDING, 33, 1),
    X(READ_FRAMEBUFFER_BINDING, 33, 1), X(RENDERBUFFER_BINDING, 33, 1), X(ACTIVE_TEXTURE, 33, 1),
    X(DRAW_BUFFER0, 33, 1), X(DRAW_BUFFER1, 33, 0),
    X(DRAW_BUFFER2, 33, 1), X(DRAW_BUFFER3, 33, 0), X(READ_BUFFER, 33, 1), X(MIN_SAMPLE_SHADING_VALUE, 40, 1),
    X(PATCH_VERTICES, 40, 1),
    X(DRAW_INDIRECT_BUFFER_BINDING, 40, 1), X(CLIP_ORIGIN, 45, 1), X(CLIP_DEPTH_MODE, 45, 1)
#undef X
};

static const struct { const char *name; unsigned binding, target; } gl_state__targets[] = {
    { "TEXTURE_2D", GL_TEXTURE_BINDING_2D, GL_TEXTURE_2D },
    { "TEXTURE_BUFFER", GL_TEXTURE_BINDING_BUFFER, GL_TEXTURE_BUFFER },
    { "TEXTURE_1D", GL_TEXTURE_BINDING_1D, GL_TEXTURE_1D }, { "TEXTURE_3D", GL_TEXTURE_BINDING_3D, GL_TEXTURE_3D },
    { "TEXTURE_CUBE_MAP", GL_TEXTURE_BINDING_CUBE_MAP, GL_TEXTURE_CUBE_MAP },
    { "TEXTURE_RECTANGLE", GL_TEXTURE_BINDING_RECTANGLE, GL_TEXTURE_RECTANGLE },
    { "TEXTURE_1D_ARRAY", GL_TEXTURE_BINDING_1D_ARRAY, GL_TEXTURE_1D_ARRAY },
    { "TEXTURE_2D_ARRAY", GL_TEXTURE_BINDING_2D_ARRAY, GL_TEXTURE_2D_ARRAY }
};

#define GL_STATE__COUNT(array) ((int)(sizeof(array) / sizeof((array)[0])))

static inline void gl_state_take(gl_state *s) {
    GLint active = 0, texture_2d = 0, texture_buffer = 0, got[4] = { 0, 0, 0, 0 };
    GLboolean mask[4];
    double *v;
    int i, k;
    s->count = 0;
    for (i = 0; i < GL_STATE__COUNT(gl_state__switches); i++)
        if (gl_state__switches[i].version <= more_gl.version)
            *gl_state__add(s, gl_state__switches[i].name, -1) = gl.IsEnabled(gl_state__switches[i].id);
    for (i = 0; i < GL_STATE__COUNT(gl_state__numbers); i++)
        if (gl_state__numbers[i].version <= more_gl.version) {
            double values[16] = { 0 };
            more_gl.GetDoublev(gl_state__numbers[i].id, values);
            memcpy(gl_state__add(s, gl_state__numbers[i].name, -1), values, 4 * sizeof *values);
        }
    for (i = 0; i < 8; i++) {
        *gl_state__add(s, "BLEND", i) = more_gl.IsEnabledi(GL_BLEND, (GLuint)i);
        more_gl.GetBooleani_v(GL_COLOR_WRITEMASK, (GLuint)i, mask);
        v = gl_state__add(s, "COLOR_WRITEMASK", i);
        for (k = 0; k < 4; k++) v[k] = mask[k];
    }
    more_gl.GetIntegeri_v(GL_SAMPLE_MASK_VALUE, 0, got);
    *gl_state__add(s, "SAMPLE_MASK_VALUE", 0) = (double)(unsigned)got[0];
    for (i = 0; i < 4; i++) {
        more_gl.GetIntegeri_v(GL_UNIFORM_BUFFER_BINDING, (GLuint)i, got);
        *gl_state__add(s, "UNIFORM_BUFFER", i) = got[0];
        more_gl.GetIntegeri_v(GL_TRANSFORM_FEEDBACK_BUFFER_BINDING, (GLuint)i, got);
        *gl_state__add(s, "TRANSFORM_FEEDBACK_BUFFER", i) = got[0];
    }
    for (i = 0; more_gl.BindImageTexture && i < 8; i++) {
        static const unsigned names[6] = { GL_IMAGE_BINDING_NAME, GL_IMAGE_BINDING_LEVEL, GL_IMAGE_BINDING_LAYERED,
            GL_IMAGE_BINDING_LAYER, GL_IMAGE_BINDING_ACCESS, GL_IMAGE_BINDING_FORMAT };
        for (k = 0; k < 6; k++) {
            more_gl.GetIntegeri_v(names[k], (GLuint)i, got);
            *gl_state__add(s, k == 0 ? "IMAGE" : "IMAGE's level, layered, layer, access or format", i) = got[0];
        }
    }
    if (more_gl.ViewportIndexedf)
        for (i = 0; i < 4; i++) {
            float box[4];
            double range[2] = { 0, 0 };
            more_gl.GetFloati_v(GL_VIEWPORT, (GLuint)i, box);
            v = gl_state__add(s, "VIEWPORT of the viewport array", i);
            for (k = 0; k < 4; k++) v[k] = (double)box[k];
            more_gl.GetIntegeri_v(GL_SCISSOR_BOX, (GLuint)i, got);
            v = gl_state__add(s, "SCISSOR_BOX of the viewport array", i);
            for (k = 0; k < 4; k++) v[k] = got[k];
            *gl_state__add(s, "SCISSOR_TEST of the viewport array", i) = more_gl.IsEnabledi(GL_SCISSOR_TEST, (GLuint)i);
            more_gl.GetDoublei_v(GL_DEPTH_RANGE, (GLuint)i, range);
            memcpy(gl_state__add(s, "DEPTH_RANGE of the viewport array", i), range, sizeof range);
        }
    gl.GetIntegerv(GL_VERTEX_ARRAY_BINDING, got);
    if (got[0])
        for (i = 0; i < 12; i++) {
            static const GLenum names[] = { GL_VERTEX_ATTRIB_ARRAY_ENABLED, GL_VERTEX_ATTRIB_ARRAY_BUFFER_BINDING,
                GL_VERTEX_ATTRIB_ARRAY_DIVISOR, GL_VERTEX_ATTRIB_ARRAY_STRIDE };
            v = gl_state__add(s, "vertex attribute: on, buffer, divisor, stride", i);
            for (k = 0; k < 4; k++) {
                more_gl.GetVertexAttribiv((GLuint)i, names[k], got);
                v[k] = got[0];
            }
        }
    gl.GetIntegerv(GL_ACTIVE_TEXTURE, &active);
    for (i = 0; i < GL_STATE_UNITS; i++) {
        gl.ActiveTexture(GL_TEXTURE0 + (GLenum)i);
        for (k = 0; k < GL_STATE__COUNT(gl_state__targets); k++) {
            gl.GetIntegerv(gl_state__targets[k].binding, got);
            *gl_state__add(s, gl_state__targets[k].name, i) = got[0];
            if (i == 0 && k == 0) texture_2d = got[0];
            if (i == 0 && k == 1) texture_buffer = got[0];
        }
        gl.GetIntegerv(GL_SAMPLER_BINDING, got);
        *gl_state__add(s, "SAMPLER", i) = got[0];
    }
    /* The default textures (name 0) are included, because a host may use them, and a missing glBindTexture would write
       to them. */
    gl.ActiveTexture(GL_TEXTURE0);
    gl.BindTexture(GL_TEXTURE_2D, 0);
    more_gl.GetTexLevelParameteriv(GL_TEXTURE_2D, 0, GL_TEXTURE_WIDTH, got);
    *gl_state__add(s, "width of the default 2D texture", -1) = got[0];
    more_gl.GetTexParameteriv(GL_TEXTURE_2D, GL_TEXTURE_MIN_FILTER, got);
    *gl_state__add(s, "filter of the default 2D texture", -1) = got[0];
    gl.BindTexture(GL_TEXTURE_2D, (GLuint)texture_2d);
    gl.BindTexture(GL_TEXTURE_BUFFER, 0);
    got[0] = 0;
    more_gl.GetTexLevelParameteriv(GL_TEXTURE_BUFFER, 0, GL_TEXTURE_BUFFER_DATA_STORE_BINDING, got);
    *gl_state__add(s, "buffer of the default buffer texture", -1) = got[0];
    gl.BindTexture(GL_TEXTURE_BUFFER, (GLuint)texture_buffer);
    gl.ActiveTexture((GLenum)active);
    while (gl.GetError() != GL_NO_ERROR) {}
}

/* Returns the names of up to three entries that differ, or NULL if all are equal. */
static inline const char *gl_state_difference(const gl_state *a, const gl_state *b) {
    static char text[512];
    int i, found = 0;
    size_t used = 0;
    if (a->count != b->count) return "the number of entries differs";  /* a vertex array was bound or unbound */
    for (i = 0; i < a->count; i++)
        if (memcmp(a->entries[i].value, b->entries[i].value, sizeof a->entries[i].value) && found++ < 3) {
            const double *p = a->entries[i].value, *q = b->entries[i].value;
            int written = snprintf(text + used, sizeof text - used, "%s%s was %g %g %g %g and is %g %g %g %g",
                                   found > 1 ? "; " : "",
                                   a->entries[i].name, p[0], p[1], p[2], p[3],
                                   q[0], q[1], q[2], q[3]);
            if (written > 0) used += (size_t)written < sizeof text - used ? (size_t)written : sizeof text - used - 1;
        }
    return found ? text : NULL;
}

/* >>unusual values */

typedef struct gl_odd {
    GLuint textures[GL_STATE_UNITS][8], samplers[2], buffers[10], framebuffers[2], colors[3], renderbuffers[2],
        vertex_array, program;
} gl_odd;

enum { GL_ODD_BUFFER_BYTES = 256, GL_ODD_SIZE = 8 };

static inline GLuint gl_odd__target(int unit, int target, gl_odd *o) {
    GLuint name = 0;
    gl.GenTextures(1, &name);
    gl.ActiveTexture(GL_TEXTURE0 + (GLenum)unit);
    gl.BindTexture(gl_state__targets[target].target, name);
    o->textures[unit][target] = name;
    return name;
}

/* Creates objects whose content can be checked afterwards: buffers of the byte 0x5a, and colour attachments of one
   colour. */
static inline void gl_odd_make(gl_odd *o) {
    unsigned char bytes[4 * GL_ODD_SIZE * GL_ODD_SIZE];
    int i;
    memset(o, 0, sizeof *o);
    memset(bytes, 0x5a, sizeof bytes);
    gl.GenBuffers(10, o->buffers);
    for (i = 0; i < 10; i++) {
        gl.BindBuffer(GL_ARRAY_BUFFER, o->buffers[i]);
        gl.BufferData(GL_ARRAY_BUFFER, GL_ODD_BUFFER_BYTES, bytes, GL_STATIC_DRAW);
    }
    gl.BindBuffer(GL_ARRAY_BUFFER, 0);
    gl.GenTextures(3, o->colors);
    for (i = 0; i < 3; i++) {
        gl.BindTexture(GL_TEXTURE_2D, o->colors[i]);
        gl.TexImage2D(GL_TEXTURE_2D, 0, GL_RGBA8, GL_ODD_SIZE, GL_ODD_SIZE, 0, GL_RGBA, GL_UNSIGNED_BYTE, bytes);
        gl.TexParameteri(GL_TEXTURE_2D, GL_TEXTURE_MIN_FILTER, GL_NEAREST);
    }
    gl.BindTexture(GL_TEXTURE_2D, 0);
    gl.GenFramebuffers(2, o->framebuffers);
    more_gl.GenRenderbuffers(2, o->renderbuffers);
    more_gl.BindRenderbuffer(GL_RENDERBUFFER, o->renderbuffers[0]);
    more_gl.RenderbufferStorage(GL_RENDERBUFFER, GL_DEPTH24_STENCIL8, GL_ODD_SIZE, GL_ODD_SIZE);
    gl.BindFramebuffer(GL_FRAMEBUFFER, o->framebuffers[0]);
    gl.FramebufferTexture2D(GL_FRAMEBUFFER, GL_COLOR_ATTACHMENT0, GL_TEXTURE_2D, o->colors[0], 0);
    gl.FramebufferTexture2D(GL_FRAMEBUFFER, GL_COLOR_ATTACHMENT1, GL_TEXTURE_2D, o->colors[1], 0);
    more_gl.FramebufferRenderbuffer(GL_FRAMEBUFFER, GL_DEPTH_STENCIL_ATTACHMENT, GL_RENDERBUFFER, o->renderbuffers[0]);
    gl.BindFramebuffer(GL_FRAMEBUFFER, o->framebuffers[1]);
    gl.FramebufferTexture2D(GL_FRAMEBUFFER, GL_COLOR_ATTACHMENT0, GL_TEXTURE_2D, o->colors[2], 0);
    gl.FramebufferTexture2D(GL_FRAMEBUFFER, GL_COLOR_ATTACHMENT1, GL_TEXTURE_2D, o->colors[1], 0);
    gl.BindFramebuffer(GL_FRAMEBUFFER, 0);
    gl.GenSamplers(2, o->samplers);
    /* With this sampler, texelFetch would return undefined values from textures without mip maps. */
    gl.SamplerParameteri(o->samplers[0], GL_TEXTURE_MIN_FILTER, GL_LINEAR_MIPMAP_LINEAR);
    gl.SamplerParameteri(o->samplers[1], GL_TEXTURE_COMPARE_MODE, GL_COMPARE_REF_TO_TEXTURE);
    gl.GenVertexArrays(1, &o->vertex_array);
    o->program = host_gl_program("test", "", "void main() { gl_Position = vec4(0); }\n",
                                 "out vec4 color; void main() { color = vec4(1); }\n");
}

static inline void gl_state_odd(gl_odd *o) {
    const GLenum buffers[3] = { GL_COLOR_ATTACHMENT1, GL_NONE, GL_COLOR_ATTACHMENT0 };
    int i, k;
    for (i = 0; i < GL_STATE__COUNT(gl_state__switches); i++) {
        unsigned id = gl_state__switches[i].id;
        if (gl_state__switches[i].version > more_gl.version) continue;
        /* turns off switches that are on by default, and turns on all others */
        if (id == GL_DITHER || id == GL_MULTISAMPLE) gl.Disable(id); else gl.Enable(id);
    }
    for (i = 0; i < 8; i++) {
        more_gl.Enablei(GL_BLEND, (GLuint)i);
        more_gl.ColorMaski((GLuint)i, (GLboolean)(i & 1), (GLboolean)(i >> 1 & 1), (GLboolean)(i >> 2 & 1), 0);
    }
    gl.FrontFace(GL_CW);
    gl.CullFace(GL_FRONT);
    more_gl.PolygonMode(GL_FRONT_AND_BACK, GL_LINE);
    gl.PolygonOffset(3, 7);
    gl.DepthFunc(GL_NOTEQUAL);
    gl.DepthMask(GL_FALSE);
    gl.ClearDepth(0.25);
    gl.DepthRange(0.75, 0.125);
    more_gl.StencilFuncSeparate(GL_FRONT, GL_NEVER, 3, 0x55);
    more_gl.StencilFuncSeparate(GL_BACK, GL_GEQUAL, 5, 0x33);
    more_gl.StencilMaskSeparate(GL_FRONT, 0x0f);
    more_gl.StencilMaskSeparate(GL_BACK, 0xf0);
    more_gl.StencilOpSeparate(GL_FRONT, GL_INVERT, GL_INCR, GL_DECR);
    more_gl.StencilOpSeparate(GL_BACK, GL_ZERO, GL_REPLACE, GL_INCR_WRAP);
    gl.ClearStencil(9);
    gl.ClearColor(0.5f, 0.25f, 0.75f, 0.125f);
    more_gl.BlendFuncSeparate(GL_DST_COLOR, GL_ONE_MINUS_SRC_ALPHA, GL_SRC_ALPHA_SATURATE, GL_CONSTANT_COLOR);
    more_gl.BlendEquationSeparate(GL_FUNC_REVERSE_SUBTRACT, GL_MAX);
    more_gl.BlendColor(0.25f, 0.5f, 0.125f, 0.75f);
    more_gl.LogicOp(GL_XOR);
    more_gl.SampleCoverage(0.25f, GL_TRUE);
    more_gl.SampleMaski(0, 0x2);
    if (more_gl.MinSampleShading) more_gl.MinSampleShading(0.5f);
    if (more_gl.PatchParameteri) more_gl.PatchParameteri(GL_PATCH_VERTICES, 5);
    gl.Viewport(1, 2, 3, 4);
    gl.Scissor(2, 1, 1, 2);
    more_gl.PointSize(5);
    more_gl.PrimitiveRestartIndex(2);  /* would break every mesh, because each has a vertex 2 */
    more_gl.ProvokingVertex(GL_FIRST_VERTEX_CONVENTION);
    more_gl.ClampColor(GL_CLAMP_READ_COLOR, GL_TRUE);
    more_gl.Hint(GL_LINE_SMOOTH_HINT, GL_NICEST);
    more_gl.Hint(GL_POLYGON_SMOOTH_HINT, GL_FASTEST);
    more_gl.Hint(GL_TEXTURE_COMPRESSION_HINT, GL_NICEST);
    more_gl.Hint(GL_FRAGMENT_SHADER_DERIVATIVE_HINT, GL_NICEST);
    for (i = 0; i < 2; i++) {
        gl.PixelStorei(i ? GL_PACK_SWAP_BYTES : GL_UNPACK_SWAP_BYTES, 1);
        gl.PixelStorei(i ? GL_PACK_LSB_FIRST : GL_UNPACK_LSB_FIRST, 1);
        gl.PixelStorei(i ? GL_PACK_ROW_LENGTH : GL_UNPACK_ROW_LENGTH, 17 + i);
        gl.PixelStorei(i ? GL_PACK_SKIP_ROWS : GL_UNPACK_SKIP_ROWS, 1 + i);
        gl.PixelStorei(i ? GL_PACK_SKIP_PIXELS : GL_UNPACK_SKIP_PIXELS, 2 + i);
        gl.PixelStorei(i ? GL_PACK_ALIGNMENT : GL_UNPACK_ALIGNMENT, 8);
        gl.PixelStorei(i ? GL_PACK_SKIP_IMAGES : GL_UNPACK_SKIP_IMAGES, 1 + i);
        gl.PixelStorei(i ? GL_PACK_IMAGE_HEIGHT : GL_UNPACK_IMAGE_HEIGHT, 19 + i);
    }
    if (more_gl.ClipControl) more_gl.ClipControl(GL_UPPER_LEFT, GL_ZERO_TO_ONE);
    for (i = 0; i < GL_STATE_UNITS; i++) {
        for (k = 0; k < GL_STATE__COUNT(gl_state__targets); k++) {
            if (o->textures[i][k]) {
                gl.ActiveTexture(GL_TEXTURE0 + (GLenum)i);
                gl.BindTexture(gl_state__targets[k].target, o->textures[i][k]);
            } else gl_odd__target(i, k, o);
        }
        gl.BindSampler((GLuint)i, o->samplers[i & 1]);
    }
    for (i = 0; more_gl.BindImageTexture && i < 8; i++)
        more_gl.BindImageTexture((GLuint)i, o->colors[i % 3], 1 + i, (GLboolean)!(i & 1), 9 - i,
                                 i & 1 ? GL_READ_WRITE : GL_WRITE_ONLY, i & 2 ? GL_RGBA8 : GL_R32UI);
    gl.ActiveTexture(GL_TEXTURE0 + 13);
    gl.UseProgram(o->program);
    gl.BindVertexArray(o->vertex_array);
    gl.BindBuffer(GL_ELEMENT_ARRAY_BUFFER, o->buffers[0]);
    gl.BindBuffer(GL_ARRAY_BUFFER, o->buffers[1]);
    for (i = 0; i < 10; i++) {
        gl.VertexAttribPointer((GLuint)i, 1 + i % 4, GL_FLOAT, GL_FALSE, 32, (const void *)0);
        gl.EnableVertexAttribArray((GLuint)i);
        more_gl.VertexAttribDivisor((GLuint)i, 3);
    }
    gl.BindBuffer(GL_PIXEL_PACK_BUFFER, o->buffers[2]);
    gl.BindBuffer(GL_PIXEL_UNPACK_BUFFER, o->buffers[3]);
    gl.BindBuffer(GL_COPY_READ_BUFFER, o->buffers[4]);
    gl.BindBuffer(GL_COPY_WRITE_BUFFER, o->buffers[5]);
    more_gl.BindBufferBase(GL_UNIFORM_BUFFER, 0, o->buffers[6]);
    more_gl.BindBufferBase(GL_UNIFORM_BUFFER, 2, o->buffers[7]);
    more_gl.BindBufferBase(GL_TRANSFORM_FEEDBACK_BUFFER, 1, o->buffers[8]);
    gl.BindBuffer(GL_TEXTURE_BUFFER, o->buffers[9]);
    if (more_gl.version >= 40) gl.BindBuffer(GL_DRAW_INDIRECT_BUFFER, o->buffers[1]);
    gl.BindFramebuffer(GL_DRAW_FRAMEBUFFER, o->framebuffers[0]);
    gl.BindFramebuffer(GL_READ_FRAMEBUFFER, o->framebuffers[1]);
    more_gl.DrawBuffers(3, buffers);
    more_gl.ReadBuffer(GL_COLOR_ATTACHMENT1);
    more_gl.BindRenderbuffer(GL_RENDERBUFFER, o->renderbuffers[1]);
    while (gl.GetError() != GL_NO_ERROR) {}
}

/* Returns the number of objects whose content has changed. Changes GL state. */
static inline int gl_odd_changed(const gl_odd *o) {
    static unsigned char bytes[4 * GL_ODD_SIZE * GL_ODD_SIZE];
    int i, k, changed = 0;
    gl.BindBuffer(GL_PIXEL_PACK_BUFFER, 0);
    for (i = 0; i < GL_STATE__COUNT(gl_state__numbers); i++)
        if (strncmp(gl_state__numbers[i].name, "PACK_", 5) == 0)
            gl.PixelStorei(gl_state__numbers[i].id, gl_state__numbers[i].id == GL_PACK_ALIGNMENT);
    for (i = 0; i < 10; i++) {
        int differs = 0;
        gl.BindBuffer(GL_COPY_READ_BUFFER, o->buffers[i]);
        memset(bytes, 0, sizeof bytes);
        more_gl.GetBufferSubData(GL_COPY_READ_BUFFER, 0, GL_ODD_BUFFER_BYTES, bytes);
        for (k = 0; k < GL_ODD_BUFFER_BYTES; k++) differs |= bytes[k] != 0x5a;
        changed += differs;
    }
    for (i = 0; i < 3; i++) {
        int differs = 0;
        gl.BindTexture(GL_TEXTURE_2D, o->colors[i]);
        memset(bytes, 0, sizeof bytes);
        more_gl.GetTexImage(GL_TEXTURE_2D, 0, GL_RGBA, GL_UNSIGNED_BYTE, bytes);
        for (k = 0; k < (int)sizeof bytes; k++) differs |= bytes[k] != 0x5a;
        changed += differs;
    }
    return changed;
}

#endif
