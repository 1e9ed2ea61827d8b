/* Draws the window of sbl_view: a picture or a channel in false colours, lines and bars. Include after host_gl.h.

   The frame is a texture with the shown picture: exposed and tone-mapped, but linear. It remains visible when sbl.h
   begins the next picture, which has no textures of its own at first. */
#ifndef VIEW_DRAW_H
#define VIEW_DRAW_H

static const char view_vertex[] =
    "out vec2 at;\n"
    "void main() {\n"
    "    at = vec2(gl_VertexID & 1, gl_VertexID >> 1) * 2.0;\n"
    "    gl_Position = vec4(at * 2.0 - 1.0, 0.0, 1.0);\n"
    "}\n";

/* Copies a picture into the frame, pixel for pixel, row 0 to row 0. tone: 0 copies the picture, clamped to 0..1,
   without a backdrop; 1 to 3 is an sbl_tone, which is applied to the picture times factor. The curves are those of
   shaders_embedded/tone.glsl: PBR Neutral (Khronos Group 2024) and AgX (Sobotka 2022). backdrop: see
   sbl_picture_desc.backdrop; with a tone, it is shown where depths is 0 and it is brighter than the picture */
static const char view_tone_fragment[] =
    "uniform sampler2D picture;\n"
    "uniform sampler2D depths;\n"
    "uniform int tone;\n"
    "uniform float factor;\n"
    "uniform vec3 backdrop;\n"
    "out vec4 color;\n"
    "vec3 neutral(vec3 c) {\n"
    "    float least = min(c.r, min(c.g, c.b)), peak, shown;\n"
    "    c -= least < 0.08 ? least - least * least / 0.16 : 0.04;\n"
    "    peak = max(c.r, max(c.g, c.b));\n"
    "    if (peak <= 0.76) return c;\n"
    "    shown = 1.0 - 0.24 * 0.24 / (peak + 0.24 - 0.76);\n"
    "    return mix(vec3(shown), c * (shown / peak), 1.0 / (0.15 * (peak - shown) + 1.0));\n"
    "}\n"
    "vec3 half_curve(vec3 x, float end, float power) {\n"
    "    float a = (pow(4.0 * end, power) - 1.0) / pow(end, power);\n"
    "    return 2.0 * x * pow(1.0 + a * pow(x, vec3(power)), vec3(-1.0 / power));\n"
    "}\n"
    "vec3 agx(vec3 c) {\n"
    "    const float grey = 10.0 / 16.5;\n"
    "    const mat3 mixed = mat3(0.842401, 0.042401, 0.042401, 0.078437, 0.878437, 0.078437,\n"
    "                            0.079162, 0.079162, 0.879162);\n"
    "    const mat3 unmixed = mat3(1.196999, -0.053001, -0.053001, -0.098046, 1.151954, -0.098046,\n"
    "                              -0.098953, -0.098953, 1.151047);\n"
    "    vec3 x = clamp(log2(max(mixed * c, 1e-10) / 0.18) / 16.5 + grey, 0.0, 1.0) - grey;\n"
    "    vec3 y = 0.5 + half_curve(max(x, 0.0), 1.0 - grey, 3.25) - half_curve(max(-x, 0.0), grey, 3.0);\n"
    "    return pow(max(unmixed * y, 0.0), vec3(2.2));\n"
    "}\n"
    "void main() {\n"
    "    vec3 c = texelFetch(picture, ivec2(gl_FragCoord.xy), 0).rgb;\n"
    "    if (tone > 0) c = min(max(c * factor, 0.0), 1e8);\n"
    "    vec3 least = backdrop * mix(0.3, 1.0, gl_FragCoord.y / float(textureSize(picture, 0).y));\n"
    "    c = clamp(tone == 2 ? neutral(c) : tone == 3 ? agx(c) : c, 0.0, 1.0);\n"
    "    if (tone > 0 && texelFetch(depths, ivec2(gl_FragCoord.xy), 0).r == 0.0) c = max(c, least);\n"
    "    color = vec4(c, 1.0);\n"
    "}\n";

/* Draws a texture, whose first row is the top row. encode: 1 if its values are linear */
static const char view_fragment[] =
    "uniform sampler2D picture;\n"
    "uniform int encode;\n"
    "in vec2 at;\n"
    "out vec4 color;\n"
    "void main() {\n"
    "    vec3 c = texture(picture, vec2(at.x, 1.0 - at.y)).rgb;\n"
    "    vec3 s = mix(12.92 * c, 1.055 * pow(c, vec3(1.0 / 2.4)) - 0.055, greaterThan(c, vec3(0.0031308)));\n"
    "    color = vec4(encode == 1 ? s : c, 1.0);\n"
    "}\n";

static const char view_line_vertex[] =  /* only w is clipped, because lines have no depth */
    "in vec4 position;\n"
    "in vec4 ink;\n"
    "out vec4 paint;\n"
    "void main() { paint = ink; gl_Position = vec4(position.xy, 0.0, position.w); }\n";
static const char view_line_fragment[] =
    "in vec4 paint;\n"
    "out vec4 color;\n"
    "void main() { color = paint; }\n";

/* An end point of a line: its position in clip space (y is up) and its colour. */
typedef struct view_corner { float position[4], color[4]; } view_corner;

static struct view_gl {
    GLuint tone, show, line;                           /* programs */
    GLuint array, lines, framebuffer;
    GLuint frame, colors, disc;                        /* textures */
    int size[2];                                       /* size of the frame; 0 if there is none yet */
    int shows_colors;                                  /* 1: the window shows `colors` instead of `frame` */
    GLint position, ink;
} view_gl;

static GLuint view_texture(void) {
    GLuint texture;
    gl.GenTextures(1, &texture);
    gl.BindTexture(GL_TEXTURE_2D, texture);
    gl.TexParameteri(GL_TEXTURE_2D, GL_TEXTURE_MIN_FILTER, GL_LINEAR);
    gl.TexParameteri(GL_TEXTURE_2D, GL_TEXTURE_WRAP_S, GL_CLAMP_TO_EDGE);
    gl.TexParameteri(GL_TEXTURE_2D, GL_TEXTURE_WRAP_T, GL_CLAMP_TO_EDGE);
    return texture;
}

/* Creates the programs and textures. Returns 0 and prints a message on failure. */
static int view_gl_start(void) {
    view_gl.tone = host_gl_program(TOOL_NAME, "", view_vertex, view_tone_fragment);
    view_gl.show = host_gl_program(TOOL_NAME, "", view_vertex, view_fragment);
    view_gl.line = host_gl_program(TOOL_NAME, "", view_line_vertex, view_line_fragment);
    if (!view_gl.tone || !view_gl.show || !view_gl.line) return 0;
    view_gl.position = gl.GetAttribLocation(view_gl.line, "position");
    view_gl.ink = gl.GetAttribLocation(view_gl.line, "ink");
    gl.GenVertexArrays(1, &view_gl.array);
    gl.BindVertexArray(view_gl.array);
    gl.GenBuffers(1, &view_gl.lines);
    gl.GenFramebuffers(1, &view_gl.framebuffer);
    view_gl.frame = view_texture();
    view_gl.colors = view_texture();
    view_gl.disc = view_texture();
    gl.PixelStorei(GL_UNPACK_ALIGNMENT, 1);
    gl.PixelStorei(GL_PACK_ALIGNMENT, 1);
    return 1;
}

static void view_gl_stop(void) {
    const GLuint textures[] = { view_gl.frame, view_gl.colors, view_gl.disc };
    gl.DeleteProgram(view_gl.tone);
    gl.DeleteProgram(view_gl.show);
    gl.DeleteProgram(view_gl.line);
    gl.DeleteVertexArrays(1, &view_gl.array);
    gl.DeleteBuffers(1, &view_gl.lines);
    gl.DeleteFramebuffers(1, &view_gl.framebuffer);
    gl.DeleteTextures(3, textures);
}

/* The source of a new frame. */
typedef struct view_source {
    GLuint picture, depths;  /* textures; depths is used only with a tone */
    int tone;                /* 0, or an sbl_tone that is applied to the radiance times factor */
    float factor, backdrop[3];
} view_source;

static void view_make_frame(const view_source *source, const int size[2]) {
    gl.BindTexture(GL_TEXTURE_2D, view_gl.frame);
    if (view_gl.size[0] != size[0] || view_gl.size[1] != size[1])
        gl.TexImage2D(GL_TEXTURE_2D, 0, GL_RGBA32F, size[0], size[1], 0, GL_RGBA, GL_FLOAT, NULL);
    memcpy(view_gl.size, size, sizeof view_gl.size);
    view_gl.shows_colors = 0;
    gl.BindFramebuffer(GL_FRAMEBUFFER, view_gl.framebuffer);
    gl.FramebufferTexture2D(GL_FRAMEBUFFER, GL_COLOR_ATTACHMENT0, GL_TEXTURE_2D, view_gl.frame, 0);
    gl.Viewport(0, 0, size[0], size[1]);
    gl.UseProgram(view_gl.tone);
    gl.Uniform1i(host_gl_uniform(view_gl.tone, "tone"), source->tone);
    gl.Uniform1i(host_gl_uniform(view_gl.tone, "depths"), 1);
    gl.Uniform1f(host_gl_uniform(view_gl.tone, "factor"), source->factor);
    gl.Uniform3fv(host_gl_uniform(view_gl.tone, "backdrop"), 1, source->backdrop);
    gl.ActiveTexture(GL_TEXTURE1);
    gl.BindTexture(GL_TEXTURE_2D, source->depths ? source->depths : source->picture);
    gl.ActiveTexture(GL_TEXTURE0);
    gl.BindTexture(GL_TEXTURE_2D, source->picture);
    gl.DrawArrays(GL_TRIANGLES, 0, 3);
    gl.BindFramebuffer(GL_FRAMEBUFFER, 0);
}

/* Copies the frame: size[0] * size[1] * 3 linear floats, top row first. */
static void view_read_frame(float *out) {
    gl.BindFramebuffer(GL_FRAMEBUFFER, view_gl.framebuffer);
    gl.ReadPixels(0, 0, view_gl.size[0], view_gl.size[1], GL_RGB, GL_FLOAT, out);
    gl.BindFramebuffer(GL_FRAMEBUFFER, 0);
}

/* Makes the window show a picture of 8-bit colours instead of the frame. */
static void view_set_colors(const unsigned char *rgb, int width, int height) {
    gl.BindTexture(GL_TEXTURE_2D, view_gl.colors);
    gl.TexImage2D(GL_TEXTURE_2D, 0, GL_RGB8, width, height, 0, GL_RGB, GL_UNSIGNED_BYTE, rgb);
    view_gl.shows_colors = 1;
}

static void view_draw_texture(GLuint texture, const int rect[4], int encode) {
    gl.Viewport(rect[0], rect[1], rect[2], rect[3]);
    gl.UseProgram(view_gl.show);
    gl.Uniform1i(host_gl_uniform(view_gl.show, "encode"), encode);
    gl.BindTexture(GL_TEXTURE_2D, texture);
    gl.DrawArrays(GL_TRIANGLES, 0, 3);
}

/* Draws the picture so that it fills the window. */
static void view_draw_picture(const int size[2]) {
    static const float dark[4] = { 0.1f, 0.12f, 0.15f, 1 };
    const int all[4] = { 0, 0, size[0], size[1] };
    gl.BindFramebuffer(GL_FRAMEBUFFER, 0);
    if (!view_gl.size[0] && !view_gl.shows_colors) gl.ClearBufferfv(GL_COLOR, 0, dark);
    else view_draw_texture(view_gl.shows_colors ? view_gl.colors : view_gl.frame, all, !view_gl.shows_colors);
}

/* Fills a rectangle. x, y: its left and lower edge */
static void view_draw_rect(int x, int y, int width, int height, const float color[4]) {
    gl.Enable(GL_SCISSOR_TEST);
    gl.Scissor(x, y, width > 0 ? width : 0, height);
    gl.ClearBufferfv(GL_COLOR, 0, color);
    gl.Disable(GL_SCISSOR_TEST);
}

static void view_draw_lines(const view_corner *corners, int count, const int size[2]) {
    gl.Viewport(0, 0, size[0], size[1]);
    gl.UseProgram(view_gl.line);
    gl.BindBuffer(GL_ARRAY_BUFFER, view_gl.lines);
    gl.BufferData(GL_ARRAY_BUFFER, (GLsizeiptr)((size_t)count * sizeof *corners), corners, GL_STREAM_DRAW);
    gl.EnableVertexAttribArray((GLuint)view_gl.position);
    gl.EnableVertexAttribArray((GLuint)view_gl.ink);
    gl.VertexAttribPointer((GLuint)view_gl.position, 4, GL_FLOAT, GL_FALSE, sizeof *corners, NULL);
    gl.VertexAttribPointer((GLuint)view_gl.ink, 4, GL_FLOAT, GL_FALSE, sizeof *corners,
                           (const char *)NULL + offsetof(view_corner, color));
    gl.Enable(GL_BLEND);
    gl.BlendFunc(GL_SRC_ALPHA, GL_ONE_MINUS_SRC_ALPHA);
    gl.DrawArrays(GL_LINES, 0, count);
    gl.Disable(GL_BLEND);
}

#endif
