/* Tests of what an engine gets from the files of sbl_bake --probes if it follows the formulas in these files: from a
   reader in this file, and from examples/engines/probes.glsl, which GL compiles and runs. */
#define _XOPEN_SOURCE 700
#define _DEFAULT_SOURCE
#include "support/test.h"
#include "support/tool.h"
#include "../sbl.h"
#include "support/gl_host.h"
#include "support/gl_map.h"

#define BAKE(...) (tool_use("sbl_bake"), run((const char *const[]){ __VA_ARGS__, NULL }))
enum { PROBES = 64 };

/* The contents of a file of probes. */
typedef struct grid {
    int count[3], probes, valid[PROBES];
    double origin[3], spacing[3], constants[9], weights[9], over_pi[9], position[PROBES][3], sh[PROBES][9][3];
} grid;

/* Reads the numbers after `name`, starting the search at `text`. Returns the position after them, or NULL. */
static const char *numbers(const char *text, const char *name, double *out, int count) {
    const char *at = text ? strstr(text, name) : NULL;
    char *end;
    int i;
    if (!at) return NULL;
    for (at += strlen(name), i = 0; i < count; i++, at = end) {
        at += strspn(at, "[], ");
        out[i] = strtod(at, &end);
        if (end == at) return NULL;
    }
    return at;
}

static int read_grid(const char *name, grid *g) {
    static char text[1 << 17];
    const char *at;
    double count[3];
    int lines, i, k, ok;
    memset(g, 0, sizeof *g);
    read_text(in_folder(name), text, sizeof text, &lines);
    ok = numbers(text, "\"grid\": ", count, 3) && numbers(text, "\"origin\": ", g->origin, 3) &&
         numbers(text, "\"spacing\": ", g->spacing, 3) && numbers(text, "\"constants\": ", g->constants, 9) &&
         numbers(text, "\"irradiance_weights\": ", g->weights, 9) &&
         numbers(text, "\"irradiance_over_pi_weights\": ", g->over_pi, 9) &&
         strstr(text, "[\"1\", \"y\", \"z\", \"x\", \"x*y\", \"y*z\", \"3*z*z - 1\", \"x*z\", \"x*x - y*y\"]");
    for (k = 0, g->probes = 1; k < 3 && ok; k++) g->probes *= g->count[k] = (int)count[k];
    for (i = 0, at = text; i < g->probes && i < PROBES && ok; i++) {
        at = numbers(at, "\"position\": ", g->position[i], 3);
        g->valid[i] = at && strncmp(at, "], \"valid\": true", 16) == 0;
        at = numbers(at, "\"sh\": ", g->sh[i][0], 27);
        ok = at != NULL;
    }
    return ok && g->probes <= PROBES;
}

/* Evaluates the basis functions that the file describes. */
static void functions(const double n[3], double out[9]) {
    const double x = n[0], y = n[1], z = n[2];
    const double all[9] = { 1, y, z, x, x * y, y * z, 3 * z * z - 1, x * z, x * x - y * y };
    memcpy(out, all, sizeof all);
}

/* Returns the irradiance at a probe, computed with the formula of the file. over_pi: 1: the result is divided by pi */
static double irradiance(const grid *g, int probe, const double n[3], int channel, int over_pi) {
    double y[9], sum = 0;
    int i;
    functions(n, y);
    for (i = 0; i < 9; i++)
        sum += (over_pi ? g->over_pi : g->weights)[i] * g->constants[i] * y[i] * g->sh[probe][i][channel];
    return sum;
}

/* Interpolates irradiance / pi between the valid probes around a position. */
static double interpolate(const grid *g, const double position[3], const double n[3], int channel) {
    double at[3], sum = 0, all = 0;
    int i, k, probe;
    for (k = 0; k < 3; k++) {
        at[k] = (position[k] - g->origin[k]) / g->spacing[k];
        at[k] = at[k] < 0 ? 0 : at[k] > g->count[k] - 1 ? g->count[k] - 1 : at[k];
    }
    for (probe = 0; probe < g->probes; probe++) {  /* probes beyond the cell have a weight of 0 */
        double weight = g->valid[probe];
        for (k = 0, i = probe; k < 3; i /= g->count[k++]) weight *= test_max(0, 1 - fabs(at[k] - i % g->count[k]));
        if (weight <= 0) continue;
        sum += weight * irradiance(g, probe, n, channel, 1);
        all += weight;
    }
    return all > 0 ? test_max(0, sum / all) : 0;
}

/* Writes two tiny triangles at (0, 0, 0) and (2, 1, 3), and a sun with irradiance pi that shines along -z. */
static void sun_gltf(void) {
    static const char text[] = "{\"asset\": {\"version\": \"2.0\"}, \"extensionsUsed\": [\"KHR_lights_punctual\"],\n"
        "\"extensions\": {\"KHR_lights_punctual\": {\"lights\": [{\"type\": \"directional\", \"intensity\": "
        "3.14159265}]}},\n\"scene\": 0, \"scenes\": [{\"nodes\": [0, 1]}],\n"
        "\"nodes\": [{\"mesh\": 0}, {\"extensions\": {\"KHR_lights_punctual\": {\"light\": 0}}}],\n"
        "\"meshes\": [{\"primitives\": [{\"attributes\": {\"POSITION\": 0}, \"material\": 0}]}],\n"
        "\"materials\": [{\"pbrMetallicRoughness\": {\"baseColorFactor\": [0, 0, 0, 1], \"metallicFactor\": 0}}],\n"
        "\"accessors\": [{\"bufferView\": 0, \"componentType\": 5126, \"count\": 6, \"type\": \"VEC3\",\n"
        "  \"min\": [0, 0, 0], \"max\": [2, 1, 3]}],\n"
        "\"bufferViews\": [{\"buffer\": 0, \"byteLength\": 72}], \"buffers\": [{\"uri\": \"sun.bin\", "
        "\"byteLength\": 72}]}\n";
    static const float corners[18] = { 0, 0, 0, 0.01f, 0, 0, 0, 0.01f, 0, 2, 1, 3, 1.99f, 1, 3, 2, 0.99f, 3 };
    write_text("sun.gltf", text);
    write_file("sun.bin", corners, sizeof corners);
}

static void random_normal(int i, double n[3]) {
    double length = 0;
    int k;
    for (k = 0; k < 3; k++) {
        n[k] = test_hash((uint32_t)(3 * i + k)) % 2001 / 1000.0 - 1;
        length += n[k] * n[k];
    }
    for (k = 0; k < 3; k++) n[k] /= sqrt(length);
}

/* The numbers of the file give the irradiance of a sun with irradiance pi in harmonics of degrees 0 to 2: pi (1/4 + c/2
   + 5/32 (3 c^2 - 1)), where c is the cosine of the angle between the normal and the direction to the sun. The origin
   and the spacing in the file give the positions of the probes. */
TEST(the_file_tells_irradiance) {
    static grid g;
    double n[3];
    int i, k;
    sun_gltf();
    REQUIRE(BAKE("sun.gltf", "--mode", "direct", "--preset", "draft", "--probes", "2x2x3", "-o", "sun.json") == 0, "%s",
            ran.err);
    REQUIRE(read_grid("sun.json", &g) && g.probes == 12, "the file lacks something");
    for (i = 0; i < g.probes; i++)
        for (k = 0; k < 3; k++) {
            const int at = k == 0 ? i % 2 : k == 1 ? i / 2 % 2 : i / 4;
            CHECK(fabs(g.position[i][k] - g.origin[k] - at * g.spacing[k]) < 1e-6, "probe %d is at %g", i,
                  g.position[i][k]);
        }
    CHECK(g.origin[0] == 0.5 && g.origin[1] == 0.25 && g.origin[2] == 0.5 && g.spacing[0] == 1 && g.spacing[1] == 0.5 &&
          g.spacing[2] == 1, "the grid is elsewhere");
    for (i = 0; i < 50; i++) {
        double expected, found;
        random_normal(i, n);
        expected = TEST_PI * (0.25 + 0.5 * n[2] + 5.0 / 32 * (3 * n[2] * n[2] - 1));
        found = irradiance(&g, i % 12, n, i % 3, 0);
        CHECK(fabs(found - expected) < 0.01 * TEST_PI, "irradiance %g, expected %g", found, expected);
        CHECK(fabs(irradiance(&g, i % 12, n, i % 3, 1) * TEST_PI - found) < 1e-6, "the weights differ");
    }
}

static char *read_shader(void) {
    static char text[8192];
    int lines;
    read_text("examples/engines/probes.glsl", text, sizeof text, &lines);
    return text;
}

/* Runs the shader for positions in and around the grid. Returns 0 on failure. */
static int shade(const grid *g, const float *questions, int count, float *answers) {
    static float texels[4 * 9 * PROBES];
    const float origin[3] = { (float)g->origin[0], (float)g->origin[1], (float)g->origin[2] };
    const float spacing[3] = { (float)g->spacing[0], (float)g->spacing[1], (float)g->spacing[2] };
    const int width = 9 * g->count[0], height = g->count[1] * g->count[2];
    char source[16384];
    GLuint program, texture;
    int i, k, c, ok;
    for (i = 0; i < g->probes; i++)
        for (k = 0; k < 9; k++) {  /* the formula in probes.glsl */
            const int x = i % g->count[0], y = i / g->count[0] % g->count[1], z = i / g->count[0] / g->count[1];
            float *texel = texels + 4 * ((y + g->count[1] * z) * width + 9 * x + k);
            for (c = 0; c < 3; c++) texel[c] = (float)g->sh[i][k][c];
            texel[3] = (float)g->valid[i];
        }
    snprintf(source, sizeof source, "%s\nvec4 answer(vec4 a, vec4 b) { return vec4(sbl_probe_light(a.xyz, b.xyz), 1); "
             "}\n", read_shader());
    program = gl_map_program(source);
    if (!program) return 0;
    texture = gl_map_texture(1, width, height, texels);
    gl.UseProgram(program);
    gl.Uniform1i(host_gl_uniform(program, "sbl_probe_texels"), 1);
    gl.Uniform3fv(host_gl_uniform(program, "sbl_probe_origin"), 1, origin);
    gl.Uniform3fv(host_gl_uniform(program, "sbl_probe_spacing"), 1, spacing);
    ((PFNGLUNIFORM3IPROC)host_gl_function("glUniform3i"))(host_gl_uniform(program, "sbl_probe_grid"), g->count[0],
                                                          g->count[1], g->count[2]);
    ok = gl_map_run(program, questions, count, answers);
    gl.DeleteTextures(1, &texture);
    gl.DeleteProgram(program);
    return ok;
}

/* The shader gives the values that the formulas of the file give, also outside of the grid and beside invalid probes,
   whose light it never uses. If all probes around a position are invalid, the shader returns 0. */
TEST(the_shader_reads_probes) {
    enum { COUNT = 256 };
    static grid g;
    static float questions[8 * COUNT], answers[4 * COUNT];
    double worst = 0, n[3], at[3];
    int i, k, black = 0;
    room_obj();
    REQUIRE(BAKE("room.obj", "--mode", "direct", "--preset", "draft", "--probes", "3x2x3", "-o", "room.json") == 0,
            "%s", ran.err);
    REQUIRE(read_grid("room.json", &g) && !parts_left(), "the file lacks something");
    for (i = 0; i < g.probes; i++) {
        g.valid[i] = i % 4 != 1 && i < 12;
        for (k = 0; k < 27 && !g.valid[i]; k++) g.sh[i][k / 3][k % 3] = 1e6;
    }
    for (i = 0; i < COUNT; i++) {
        random_normal(i, n);
        for (k = 0; k < 3; k++) {
            const double share = test_hash((uint32_t)(3 * i + k) + 5000u) % 1000 / 999.0;
            questions[8 * i + k] = (float)(g.origin[k] + g.spacing[k] * ((g.count[k] + 1) * share - 1));
            questions[8 * i + 4 + k] = (float)(3 * n[k]);
        }
    }
    if (!gl_host_open()) SKIP("no OpenGL");
    REQUIRE(shade(&g, questions, COUNT, answers), "the shader fails");
    for (i = 0; i < COUNT; i++) {
        random_normal(i, n);
        for (k = 0; k < 3; k++) at[k] = (double)questions[8 * i + k];
        for (k = 0; k < 3; k++)
            worst = test_max(worst, fabs((double)answers[4 * i + k] - interpolate(&g, at, n, k)));
        black += answers[4 * i] == 0;
    }
    printf("  largest difference %.1e\n", worst);
    CHECK(worst < 1e-4 && black > 5 && black < COUNT / 2, "differs by %g; %d are black", worst, black);
    host_gl_close();
}

int main(int argc, char **argv) {
    (void)argc;
    if (!tool_begin(argv[0])) return 1;
    RUN(the_file_tells_irradiance);
    RUN(the_shader_reads_probes);
    tool_end();
    return test_report();
}
