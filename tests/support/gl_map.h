/* Runs a GLSL function for many inputs, one per fragment, to test shader code and textures as hosts use them. Include
   after gl_host.h.
       GLuint program = gl_map_program("uniform samplerCube map;\n"
                                       "vec4 answer(vec4 a, vec4 b) { return textureLod(map, a.xyz, b.x); }\n");
       gl.UseProgram(program); ...                               // set uniforms; bind textures to units from 1 on
       gl_map_run(program, questions, count, answers);           // 8 floats for each question, 4 for each answer */
#ifndef GL_MAP_H
#define GL_MAP_H

/* Compiles a program around the function. Returns 0 and prints a message on failure. */
static inline GLuint gl_map_program(const char *function) {
    static char fragment[32768];
    snprintf(fragment, sizeof fragment, "%s\nuniform sampler2D map_questions;\nout vec4 map_answer;\n"
             "void main() {\n    int i = int(gl_FragCoord.x);\n"
             "    map_answer = answer(texelFetch(map_questions, ivec2(0, i), 0), "
             "texelFetch(map_questions, ivec2(1, i), 0));\n}\n", function);
    return host_gl_program("test", "", "void main() {\n    vec2 p = vec2(gl_VertexID & 1, gl_VertexID >> 1);\n"
                           "    gl_Position = vec4(4.0 * p - 1.0, 0, 1);\n}\n", fragment);
}

/* Creates a float texture without filtering and binds it to a unit. */
static inline GLuint gl_map_texture(int unit, int width, int height, const float *texels) {
    GLuint texture;
    gl.GenTextures(1, &texture);
    gl.ActiveTexture(GL_TEXTURE0 + (GLenum)unit);
    gl.BindTexture(GL_TEXTURE_2D, texture);
    gl.TexImage2D(GL_TEXTURE_2D, 0, GL_RGBA32F, width, height, 0, GL_RGBA, GL_FLOAT, texels);
    gl.TexParameteri(GL_TEXTURE_2D, GL_TEXTURE_MIN_FILTER, GL_NEAREST);
    gl.TexParameteri(GL_TEXTURE_2D, GL_TEXTURE_MAG_FILTER, GL_NEAREST);
    return texture;
}

/* Runs the function for `count` questions, at most 4096. Returns 1 if GL reported no error. */
static inline int gl_map_run(GLuint program, const float *questions, int count, float *answers) {
    const GLuint asked = gl_map_texture(0, 2, count, questions), answer = gl_map_texture(0, count, 1, NULL);
    GLuint framebuffer, array;
    gl.GenFramebuffers(1, &framebuffer);
    gl.BindFramebuffer(GL_FRAMEBUFFER, framebuffer);
    gl.FramebufferTexture2D(GL_FRAMEBUFFER, GL_COLOR_ATTACHMENT0, GL_TEXTURE_2D, answer, 0);
    gl.GenVertexArrays(1, &array);
    gl.BindVertexArray(array);
    gl.ActiveTexture(GL_TEXTURE0);
    gl.BindTexture(GL_TEXTURE_2D, asked);
    gl.UseProgram(program);
    gl.Uniform1i(gl.GetUniformLocation(program, "map_questions"), 0);
    gl.Viewport(0, 0, count, 1);
    gl.DrawArrays(GL_TRIANGLES, 0, 3);
    gl.ReadPixels(0, 0, count, 1, GL_RGBA, GL_FLOAT, answers);
    gl.DeleteVertexArrays(1, &array);
    gl.DeleteFramebuffers(1, &framebuffer);
    gl.DeleteTextures(1, &asked);
    gl.DeleteTextures(1, &answer);
    return gl.GetError() == GL_NO_ERROR;
}

#endif
