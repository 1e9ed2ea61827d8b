/* Tests cube maps: the filter against closed forms and sums computed here, .ktx2 files as GL reads them, and the
   reflection probes of sbl_bake --cubemaps. */
#define _XOPEN_SOURCE 700
#define _DEFAULT_SOURCE
#include "support/test.h"
#include "support/tool.h"
#include "../sbl.h"
#include "support/gl_host.h"
#include "support/gl_map.h"
#include "../examples/cube_filter.h"
#include "../examples/ktx2_file.h"

#define BAKE(...) (tool_use("sbl_bake"), run((const char *const[]){ __VA_ARGS__, NULL }))
#define FAST "--mode", "direct", "--preset", "draft"
#define REFUSED(code, words, ...) do {                                                         \
        CHECK(BAKE(__VA_ARGS__) == code && said(words) && ran.err_lines == 1,                  \
              "exit status %d, expected %d and \"%s\": %s", ran.status, code, words, ran.err); \
    } while (0)

/* ---- expected values ---- */

/* Returns GGX with alpha^2 = a2 and normal = view = reflection, as in Karis 2013: D(h) dot(n, l), where h is halfway
   between n and l, and c is dot(n, l). */
static double lobe_weight(double c, double a2) {
    const double h2 = 0.5 * (1 + c), q = h2 * (a2 - 1) + 1;  /* h2: square of dot(n, h) */
    return c > 0 ? a2 / (TEST_PI * q * q) * c : 0;
}

/* Returns the factor of c that the lobe leaves of light proportional to c. */
static double lobe_cosine(double a2) {
    double sum = 0, all = 0;
    int i;
    for (i = 0; i < 200000; i++) {
        const double angle = (i + 0.5) / 200000 * TEST_PI / 2, w = lobe_weight(cos(angle), a2) * sin(angle);
        sum += w * cos(angle);
        all += w;
    }
    return sum / all;
}

/* Computes the direction of a point in a face, from the table of the OpenGL specification: sc = s * |ma|, tc = t *
   |ma|. */
static void gl_direction(int face, double s, double t, double out[3]) {
    const double x[6] = { 1, -1, s, s, s, -s }, y[6] = { -t, -t, 1, -1, -t, -t }, z[6] = { -s, s, t, -t, 1, -1 };
    const double length = sqrt(1 + s * s + t * t);
    out[0] = x[face] / length;
    out[1] = y[face] / length;
    out[2] = z[face] / length;
}

/* Computes the direction of the texel with the index i over all faces. */
static void texel_direction(int size, int i, double out[3]) {
    const int face = i / (size * size), y = i / size % size, x = i % size;
    gl_direction(face, (2.0 * x + 1) / size - 1, (2.0 * y + 1) / size - 1, out);
}

/* Returns the sum over all texels with the weights of the lobe. Each texel is divided into finer x finer pieces. */
static double sum_of_lobe(int size, const float *values, int finer, double a2, const double r[3]) {
    const int across = size * finer;
    double sum = 0, all = 0, d[3];
    int face, x, y;
    for (face = 0; face < 6; face++)
        for (y = 0; y < across; y++)
            for (x = 0; x < across; x++) {
                const double s = (2.0 * x + 1) / across - 1, t = (2.0 * y + 1) / across - 1;
                double w;
                gl_direction(face, s, t, d);
                w = lobe_weight(d[0] * r[0] + d[1] * r[1] + d[2] * r[2], a2) * pow(1 + s * s + t * t, -1.5);
                sum += w * (double)values[3 * ((face * size + y / finer) * size + x / finer)];
                all += w;
            }
    return sum / all;
}

/* ---- the filter ---- */

enum { SIDE = 32, TEXELS = 6 * SIDE * SIDE };
static float source[3 * TEXELS], filtered[3 * TEXELS];

/* Makes the source. Red is 2, green is 1 + z, and blue is noise with a lamp that is 2000 times as bright. */
static void make_source(void) {
    double d[3];
    int i;
    for (i = 0; i < TEXELS; i++) {
        texel_direction(SIDE, i, d);
        source[3 * i] = 2;
        source[3 * i + 1] = (float)(1 + d[2]);
        source[3 * i + 2] = d[0] > 0.98 && d[1] > 0.1 ? 2000 : 0.5f + (float)(test_hash((uint32_t)i) % 1000) / 1000;
    }
}

/* The filter keeps a constant and the shape of linear light, whose factor is an integral of one variable, 2/3 for the
   roughness 1. It conserves the energy of all light. */
TEST(closed_forms) {
    static const double roughness[4] = { 0.1, 0.35, 0.7, 1 };
    const int side = 16;
    cube_tree tree;
    int i, k;
    make_source();
    REQUIRE(cube_tree_make(&tree, SIDE, source), "no memory");
    for (k = 0; k < 4; k++) {
        const double factor = lobe_cosine(pow(roughness[k], 4));
        double constant = 0, linear = 0, before = 0, after = 0, d[3];
        cube_filter(&tree, roughness[k], side, filtered);
        for (i = 0; i < 6 * side * side; i++) {
            texel_direction(side, i, d);
            constant = test_max(constant, fabs((double)filtered[3 * i] - 2));
            linear = test_max(linear, fabs((double)filtered[3 * i + 1] - 1 - factor * d[2]));
            after += cube_solid_angle(side, i % side, i / side % side) * (double)filtered[3 * i + 2];
        }
        for (i = 0; i < TEXELS; i++)
            before += cube_solid_angle(SIDE, i % SIDE, i / SIDE % SIDE) * (double)source[3 * i + 2];
        printf("  roughness %.2f: linear light %.1e, energy %.1e\n", roughness[k], linear, after / before - 1);
        CHECK(constant < 1e-6, "a constant differs by %g", constant);
        CHECK(linear < 1.5e-3, "linear light differs by %g", linear);
        CHECK(fabs(after / before - 1) < (roughness[k] < 0.2 ? 0.03 : 0.002), "roughness %g: energy %g of %g",
              roughness[k], after, before);
    }
    CHECK(fabs(lobe_cosine(1) - 2.0 / 3) < 1e-6, "lobe_cosine is wrong");
    cube_tree_free(&tree);
}

/* The sum over squares of texels equals the sum over all pieces of texels, also beside a bright lamp. */
TEST(sums_of_texels) {
    static const double roughness[3] = { 0.25, 0.5, 1 };
    cube_tree tree;
    double worst = 0;
    int i, k;
    make_source();
    REQUIRE(cube_tree_make(&tree, SIDE, source), "no memory");
    for (i = 0; i < 24; i++) {
        float direction[3], light[3];
        double r[3], expected;
        texel_direction(SIDE, (int)(test_hash((uint32_t)i + 77) % TEXELS), r);
        for (k = 0; k < 3; k++) direction[k] = (float)r[k];
        cube_lobe_light(&tree, roughness[i % 3], direction, light);
        expected = sum_of_lobe(SIDE, source + 2, 4, pow(roughness[i % 3], 4), r);
        worst = test_max(worst, fabs((double)light[2] / expected - 1));
    }
    printf("  largest difference %.1e\n", worst);
    CHECK(worst < 5e-3, "the filter differs from the sum by %g", worst);
    cube_tree_free(&tree);
}

/* ---- files ---- */

static uint64_t number_at(const unsigned char *at, int bytes) {
    uint64_t number = 0;
    while (--bytes >= 0) number = number << 8 | at[bytes];
    return number;
}

static float from_half(unsigned bits) {
    const int exponent = bits >> 10 & 31, rest = bits & 1023;
    const double value = exponent ? ldexp(1024 + rest, exponent - 25) : ldexp(rest, -24);
    return (float)(bits & 0x8000 ? -value : value);
}

/* The levels of a .ktx2 cube map of half floats, with three floats per texel. */
typedef struct cube { int size, levels; float *values[16]; } cube;

static void free_cube(cube *c) {
    int i;
    for (i = 0; i < c->levels; i++) free(c->values[i]);
    memset(c, 0, sizeof *c);
}

/* Reads a .ktx2 file as the specification of KTX 2.0 describes it. Returns 1 if it is a cube map of half floats. */
static int read_ktx2(const char *name, cube *c) {
    static const char mark[] = "\253KTX 20\273\r\n\032\n";
    static unsigned char bytes[1 << 20];
    FILE *in = fopen(in_folder(name), "rb");
    const size_t size = in ? fread(bytes, 1, sizeof bytes, in) : 0;
    size_t end = 0;
    int i, k;
    memset(c, 0, sizeof *c);
    if (in) fclose(in);
    if (size < 200 || memcmp(bytes, mark, 12) != 0 || number_at(bytes + 12, 4) != 97 || number_at(bytes + 16, 4) != 2 ||
        number_at(bytes + 20, 4) != number_at(bytes + 24, 4) || number_at(bytes + 28, 8) != 0 ||
        number_at(bytes + 36, 4) != 6 || number_at(bytes + 44, 4) != 0)
        return 0;
    c->size = (int)number_at(bytes + 20, 4);
    c->levels = (int)number_at(bytes + 40, 4);
    if (number_at(bytes + 48, 4) != 80 + 24 * (uint64_t)c->levels || number_at(bytes + 52, 4) != 92 ||
        number_at(bytes + number_at(bytes + 48, 4), 4) != 92)
        return 0;
    for (i = c->levels - 1; i >= 0; i--) {  /* the smallest level comes first in the file */
        const uint64_t at = number_at(bytes + 80 + 24 * i, 8), length = number_at(bytes + 88 + 24 * i, 8);
        const int side = c->size >> i, texels = 6 * side * side;
        if (at % 8 || at < end || at + length > size || length != 8 * (uint64_t)texels) return 0;
        end = (size_t)(at + length);
        c->values[i] = (float *)malloc(3 * sizeof(float) * (size_t)texels);
        for (k = 0; k < 3 * texels; k++)
            c->values[i][k] = from_half((unsigned)number_at(bytes + at + 8 * (size_t)(k / 3) + 2 * (size_t)(k % 3), 2));
    }
    return end == size;
}

/* Half floats are rounded to the nearest. */
TEST(half_floats) {
    static const struct { float value; unsigned bits; } known[] = {
        { 0, 0 }, { 1, 0x3c00 }, { -2.5f, 0xc100 }, { 65504, 0x7bff }, { 65519, 0x7bff }, { 1e9f, 0x7bff },
        { 6.1035156e-5f, 0x0400 }, { 5.9604645e-8f, 1 }, { 2.9e-8f, 0 }, { 1.00048828f, 0x3c00 },
        { 1.0014648f, 0x3c02 }, { -1e9f, 0xfbff }
    };
    size_t i;
    int k;
    for (i = 0; i < sizeof known / sizeof *known; i++)
        CHECK(ktx2_half(known[i].value) == known[i].bits, "%g is %04x, expected %04x", (double)known[i].value,
              ktx2_half(known[i].value), known[i].bits);
    CHECK(ktx2_half(NAN) == 0, "NaN is %04x", ktx2_half(NAN));
    for (k = 0; k < 0x7c00; k++)
        if (ktx2_half(from_half((unsigned)k)) != k || ktx2_half(from_half((unsigned)k + 0x8000)) != k + 0x8000) break;
    CHECK(k == 0x7c00, "half float %04x becomes %04x", (unsigned)k, ktx2_half(from_half((unsigned)k)));
}

static GLuint upload(const cube *c) {
    GLuint texture;
    int level, face;
    gl.GenTextures(1, &texture);
    gl.ActiveTexture(GL_TEXTURE1);
    gl.BindTexture(GL_TEXTURE_CUBE_MAP, texture);
    for (level = 0; level < c->levels; level++)
        for (face = 0; face < 6; face++) {
            const int side = c->size >> level;
            gl.TexImage2D(GL_TEXTURE_CUBE_MAP_POSITIVE_X + (GLenum)face, level, GL_RGB32F, side, side, 0, GL_RGB,
                          GL_FLOAT, c->values[level] + 3 * face * side * side);
        }
    gl.TexParameteri(GL_TEXTURE_CUBE_MAP, GL_TEXTURE_MAX_LEVEL, c->levels - 1);
    gl.TexParameteri(GL_TEXTURE_CUBE_MAP, GL_TEXTURE_MIN_FILTER, GL_LINEAR_MIPMAP_LINEAR);
    gl.TexParameteri(GL_TEXTURE_CUBE_MAP, GL_TEXTURE_MAG_FILTER, GL_LINEAR);
    gl.Enable(GL_TEXTURE_CUBE_MAP_SEAMLESS);
    return texture;
}

/* Sets the colours of a level to 1 + the direction. */
static void show_directions(int side, float *values) {
    double d[3];
    int i, k;
    for (i = 0; i < 6 * side * side; i++) {
        texel_direction(side, i, d);
        for (k = 0; k < 3; k++) values[3 * i + k] = (float)(1 + d[k]);
    }
}

/* Makes questions with directions for all levels. A quarter of the directions are at the edges of faces. */
static void ask_directions(float *questions, int count, int levels) {
    int i, k;
    for (i = 0; i < count; i++) {
        for (k = 0; k < 3; k++) questions[8 * i + k] = (float)(test_hash((uint32_t)(3 * i + k)) % 2001) / 1000 - 1;
        questions[8 * i + i % 3] = i % 2 ? 1.0f : -1.0f;
        if (i % 4 == 0) questions[8 * i + (i + 1) % 3] = i % 8 ? 0.999f : -0.999f;
        questions[8 * i + 4] = (float)(i / 4 % levels);
    }
}

/* Writes, reads and samples a cube map whose colours are 1 + the direction. In every level, also across the edges of
   faces, GL returns the direction that it samples, so that edges are invisible. */
TEST(gl_samples_the_written_cube_map) {
    enum { SIZE = 32, LEVELS = 4, COUNT = 512 };
    static float values[LEVELS][3 * 6 * SIZE * SIZE], questions[8 * COUNT], answers[4 * COUNT];
    const float *levels[LEVELS];
    const ktx2_picture p = { SIZE, SIZE, 6, LEVELS, 3, KTX2_HALF, levels, "test" };
    FILE *out = fopen(in_folder("cube.ktx2"), "wb");
    GLuint texture, program;
    double worst[LEVELS] = { 0 };
    cube c;
    int i, k;
    for (k = 0; k < LEVELS; k++) {
        levels[k] = values[k];
        show_directions(SIZE >> k, values[k]);
    }
    REQUIRE(ktx2_write(out, &p), "the file was not written");
    fclose(out);
    REQUIRE(read_ktx2("cube.ktx2", &c) && c.size == SIZE && c.levels == LEVELS, "the file is wrong");
    if (!gl_host_open()) SKIP("no OpenGL");
    texture = upload(&c);
    program = gl_map_program("uniform samplerCube map;\nvec4 answer(vec4 a, vec4 b) { return textureLod(map, a.xyz, "
                             "b.x); }\n");
    REQUIRE(program, "the shader does not compile");
    gl.UseProgram(program);
    gl.Uniform1i(gl.GetUniformLocation(program, "map"), 1);
    ask_directions(questions, COUNT, LEVELS);
    CHECK(gl_map_run(program, questions, COUNT, answers), "GL reports an error");
    for (i = 0; i < COUNT; i++) {
        const float *q = questions + 8 * i;
        const double length = sqrt((double)(q[0] * q[0] + q[1] * q[1] + q[2] * q[2]));
        for (k = 0; k < 3; k++)
            worst[i / 4 % LEVELS] = test_max(worst[i / 4 % LEVELS], fabs((double)answers[4 * i + k] - 1 -
                                                                         (double)q[k] / length));
    }
    for (k = 0; k < LEVELS; k++)
        CHECK(worst[k] < 0.002 + 1.5 * pow(1.0 / (SIZE >> k), 1.5), "level %d differs by %g", k, worst[k]);
    gl.DeleteTextures(1, &texture);
    gl.DeleteProgram(program);
    host_gl_close();
    free_cube(&c);
}

/* ---- comparison with cmgen ---- */

/* Reads the red values of a face that cmgen has written as .psd: planes of big-endian floats, red first. (A .dds of
   four floats from cmgen is of no use, because all its values are 3.) */
static int read_psd(const char *name, int side, float *out) {
    static unsigned char bytes[1 << 17];
    FILE *in = fopen(in_folder(name), "rb");
    const size_t size = in ? fread(bytes, 1, sizeof bytes, in) : 0, planes = 12 * (size_t)(side * side);
    const unsigned char *at = bytes + size - planes;
    int i;
    if (in) fclose(in);
    if (size < planes + 100 || size > planes + 400 || memcmp(bytes, "8BPS", 4) != 0) return 0;
    for (i = 0; i < side * side; i++, at += 4) {
        const uint32_t bits = (uint32_t)at[0] << 24 | (uint32_t)at[1] << 16 | (uint32_t)at[2] << 8 | at[3];
        memcpy(out + i, &bits, 4);
    }
    return 1;
}

/* Writes the source for cmgen as a cross of faces, in an uncompressed .hdr. */
static void write_cross(int size, const float *values) {
    static const int places[6][2] = { { 2, 1 }, { 0, 1 }, { 1, 0 }, { 1, 2 }, { 1, 1 }, { 3, 1 } };
    FILE *out = fopen(in_folder("cross.hdr"), "wb");
    int x, y, face;
    fprintf(out, "#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y %d +X %d\n", 3 * size, 4 * size);
    for (y = 0; y < 3 * size; y++)
        for (x = 0; x < 4 * size; x++) {
            float value = 0;
            int exponent = 0, k;
            for (face = 0; face < 6; face++)
                if (x / size == places[face][0] && y / size == places[face][1])
                    value = values[3 * ((face * size + y % size) * size + x % size)];
            if (value > 0) frexp((double)value, &exponent);
            for (k = 0; k < 3; k++) fputc(value > 0 ? (int)ldexp((double)value, 8 - exponent) : 0, out);
            fputc(value > 0 ? exponent + 128 : 0, out);
        }
    fclose(out);
}

/* Debian's cmgen filters by samples of blurred levels. With more samples, its levels are less blurred and nearer to
   ours. The source has values that a .hdr stores exactly: integers up to 255. */
TEST(cmgen_agrees) {
    enum { SIZE = 64 };
    static const char *const faces[6] = { "px", "nx", "py", "ny", "pz", "nz" };
    static float values[3 * 6 * SIZE * SIZE], level[3 * 6 * SIZE * SIZE / 4], theirs[SIZE * SIZE / 4];
    char command[512], words[256], name[64];
    double d[3], roughness;
    cube_tree tree;
    FILE *in;
    int i, k, face;
    if (system("command -v cmgen > /dev/null 2>&1") != 0) SKIP("cmgen (libfilament-tools) is not installed");
    for (i = 0; i < 6 * SIZE * SIZE; i++) {
        texel_direction(SIZE, i, d);
        values[3 * i] = (float)(d[0] > 0.8 && d[1] > 0.2 ? 200 : d[1] < -0.3 ? 4 : 10 + (int)(8 * d[2]));
    }
    write_cross(SIZE, values);
    snprintf(command, sizeof command, "cd '%s' && cmgen --no-mirror --ibl-samples=8192 --size=%d --format=psd "
             "--compression=32 --ibl-ld=out cross.hdr > cmgen.log 2>&1", folder, SIZE);
    REQUIRE(system(command) == 0, "cmgen failed");
    REQUIRE(cube_tree_make(&tree, SIZE, values), "no memory");
    for (k = 1; k < 3; k++) {
        const int side = SIZE >> k;
        double off = 0, squares = 0, most = 0;
        snprintf(words, sizeof words, "grep -ao 'Level %d, roughness = [^,]*, roughness (perceptual) = [0-9.]*' "
                 "'%s/cmgen.log' | head -n 1 | sed 's/.* //'", k, folder);
        in = popen(words, "r");
        if (!in || fscanf(in, "%lf", &roughness) != 1) roughness = 0;
        if (in) pclose(in);
        REQUIRE(roughness > 0 && roughness <= 1, "cmgen does not tell its roughness");
        cube_filter(&tree, roughness, side, level);
        for (face = 0; face < 6; face++) {
            snprintf(name, sizeof name, "out/cross/m%d_%s.psd", k, faces[face]);
            REQUIRE(read_psd(name, side, theirs), "%s is missing", name);
            for (i = 0; i < side * side; i++) {
                const double ours = (double)level[3 * (face * side * side + i)];
                most = test_max(most, fabs(ours - (double)theirs[i]));
                off += pow(ours - (double)theirs[i], 2);
                squares += ours * ours;
            }
        }
        printf("  roughness %.3f: root mean square difference %.3f %%, largest %.2f of 200\n", roughness,
               100 * sqrt(off / squares), most);
        CHECK(sqrt(off / squares) < 0.06, "level %d differs by %g", k, sqrt(off / squares));
    }
    cube_tree_free(&tree);
}

/* ---- the tool ---- */

/* A room from (-2, 0, -1) to (3, 2, 4), whose walls +x, -x, +y ... each emit their own light. The corners of each wall
   are counter-clockwise as seen from inside. A box inside, whose sides face outwards, emits 0.5. */
static const double room[2][3] = { { -2, 0, -1 }, { 3, 2, 4 } }, box[2][3] = { { 2, 0.2, 3 }, { 2.5, 0.7, 3.5 } };
static const int emitted[6] = { 1, 2, 3, 4, 5, 6 };

static int put_box(char *text, const double ends[2][3], int inside, int *corners) {
    static const int sides[6][4][3] = {
        { { 1, 0, 0 }, { 1, 1, 0 }, { 1, 1, 1 }, { 1, 0, 1 } }, { { 0, 0, 0 }, { 0, 0, 1 }, { 0, 1, 1 }, { 0, 1, 0 } },
        { { 0, 1, 0 }, { 0, 1, 1 }, { 1, 1, 1 }, { 1, 1, 0 } }, { { 0, 0, 0 }, { 1, 0, 0 }, { 1, 0, 1 }, { 0, 0, 1 } },
        { { 0, 0, 1 }, { 1, 0, 1 }, { 1, 1, 1 }, { 0, 1, 1 } }, { { 0, 0, 0 }, { 0, 1, 0 }, { 1, 1, 0 }, { 1, 0, 0 } }
    };
    int side, i, k, n = 0;
    for (side = 0; side < 6; side++) {
        for (i = 0; i < 4; i++) {
            const int *corner = sides[side][inside ? 3 - i : i];
            n += sprintf(text + n, "v");
            for (k = 0; k < 3; k++) n += sprintf(text + n, " %g", ends[corner[k]][k]);
            n += sprintf(text + n, "\n");
        }
        n += sprintf(text + n, "usemtl m%d\nf %d %d %d %d\n", inside ? side + 1 : 0, *corners, *corners + 1,
                     *corners + 2, *corners + 3);
        *corners += 4;
    }
    return n;
}

/* scale: factor of all lengths */
static void glowing_room(double scale) {
    static char text[8192];
    double walls[2][3], solid[2][3];
    int i, n = 0, corners = 1;
    for (i = 0; i < 6; i++) {
        walls[i / 3][i % 3] = scale * room[i / 3][i % 3];
        solid[i / 3][i % 3] = scale * box[i / 3][i % 3];
    }
    for (i = 0; i < 7; i++)
        n += sprintf(text + n, "newmtl m%d\nKd 0 0 0\nKe %g %g %g\n", i, i ? emitted[i - 1] : 0.5,
                     i ? emitted[i - 1] : 0.5, i ? 2.0 * emitted[i - 1] : 0.5);
    write_text("glow.mtl", text);
    n = sprintf(text, "mtllib glow.mtl\n");
    n += put_box(text + n, (const double (*)[3])walls, 1, &corners);
    put_box(text + n, (const double (*)[3])solid, 0, &corners);
    write_text("glow.obj", text);
}

/* Returns the distance at which a ray from a point leaves a box, or enters it if `enters` is 1; negative if it misses.
   side: receives the side */
static double meet(const double ends[2][3], const double at[3], const double d[3], int enters, int *side) {
    double in = -1e30, out = 1e30;
    int k, first = 0, last = 0;
    for (k = 0; k < 3; k++) {
        const double a = (ends[d[k] > 0 ? 0 : 1][k] - at[k]) / d[k], b = (ends[d[k] > 0 ? 1 : 0][k] - at[k]) / d[k];
        if (a > in) { in = a; first = 2 * k + (d[k] > 0); }
        if (b < out) { out = b; last = 2 * k + (d[k] < 0); }
    }
    if (side) *side = enters ? first : last;
    return enters ? in < out ? in : -1 : out;
}

/* Checks that all levels are filtered from level 0. */
static void check_levels(const cube *c) {
    cube_tree tree;
    int i;
    REQUIRE(cube_tree_make(&tree, c->size, c->values[0]), "no memory");
    for (i = 1; i < c->levels; i++) {
        const int side = c->size >> i;
        const double found = (double)c->values[i][3 * ((2 * side + side / 2) * side + side / 2)];
        float light[3], direction[3];
        cube_direction(2, 1 / (float)side, 1 / (float)side, direction);
        cube_lobe_light(&tree, (double)i / (c->levels - 1), direction, light);
        CHECK(fabs(found / (double)light[0] - 1) < 2e-3, "level %d is %g, expected %g", i, found, (double)light[0]);
    }
    cube_tree_free(&tree);
}

/* Each texel of level 0 shows what a ray from the point hits, so the order and orientation of faces are right. The box
   equals the room, and a point in a solid has no cube map. */
TEST(texels_show_what_rays_meet) {
    static const double at[3] = { 0.5, 0.7, 1 };
    static char json[16384];
    double d[3];
    int i, side, lines, wrong = 0, seen = 0;
    cube c;
    glowing_room(1);
    write_text("list.txt", "0.5 0.7 1\n2.25 0.45 3.25\n");
    REQUIRE(BAKE("glow.obj", FAST, "--cubemaps", "list.txt", "--cubemap-size", "32", "-o", "out") == 0, "%s", ran.err);
    CHECK(said("1 of 2 points are inside geometry"), "%s", ran.err);
    REQUIRE(read_ktx2("out/cubemap_0000.ktx2", &c) && c.size == 32 && c.levels == 4, "no cube map");
    for (i = 0; i < TEXELS; i++) {
        int near_edge = 0, x = i % SIDE, y = i / SIDE % SIDE, k;
        double expected[5];
        for (k = 0; k < 5; k++) {  /* anti-aliasing mixes the centre of the texel with its corners */
            gl_direction(i / SIDE / SIDE, (2.0 * x + 1 + (k % 3 - 1) * (k > 0)) / SIDE - 1,
                         (2.0 * y + 1 + (k > 2 ? 1 : k > 0 ? -1 : 0)) / SIDE - 1, d);
            expected[k] = meet(box, at, d, 1, NULL) > 0 ? 0.5 : emitted[(meet(room, at, d, 0, &side), side)];
            near_edge |= expected[k] != expected[0];
        }
        if (near_edge) continue;
        seen |= 1 << (expected[0] < 1 ? 0 : (int)expected[0]);
        wrong += fabs((double)c.values[0][3 * i] - expected[0]) > 1e-3 ||
                 fabs((double)c.values[0][3 * i + 2] - (expected[0] < 1 ? 1 : 2) * expected[0]) > 1e-3;
    }
    CHECK(wrong == 0 && seen == 127, "%d texels show something else; %d are seen", wrong, seen);
    read_text(in_folder("out/cubemaps.json"), json, sizeof json, &lines);
    CHECK(strstr(json, "{\"lowest\": [-2, 0, -1], \"highest\": [3, 2, 4], \"from\": [\"wall\", \"wall\", \"wall\", "
                 "\"wall\", \"wall\", \"wall\"]}"), "the box is wrong: %s", json);
    CHECK(strstr(json, "{\"position\": [2.25, 0.449999988, 3.25], \"valid\": false}"), "no solid: %s", json);
    CHECK(strstr(json, "\"levels\": [{\"size\": 32, \"roughness\": 0}, {\"size\": 16, \"roughness\": 0.333333333}, "),
          "levels are wrong: %s", json);
    CHECK(exists("out/cubemap_0000_3.exr") && !exists("out/cubemap_0001.ktx2"), "files are wrong");
    check_levels(&c);
    free_cube(&c);
}

/* In a room whose coordinates are so large that adding 1 does not change them, each face shows its wall. */
TEST(large_rooms) {
    int face;
    cube c;
    glowing_room(1e8);
    write_text("list.txt", "5e7 7e7 1e8\n");
    REQUIRE(BAKE("glow.obj", FAST, "--cubemaps", "list.txt", "--cubemap-size", "8", "-o", "large") == 0, "%s", ran.err);
    REQUIRE(read_ktx2("large/cubemap_0000.ktx2", &c), "no cube map");
    for (face = 0; face < 6; face++) {
        const double found = (double)c.values[0][3 * (64 * face + 36)];
        CHECK(fabs(found - emitted[face]) < 1e-3, "face %d shows %g, expected %d", face, found, emitted[face]);
    }
    free_cube(&c);
}

/* Without walls, the box ends at the bounds of the scene, and the sky is visible. The grid is the same as for
   probes. */
TEST(outdoors) {
    static char json[16384];
    int lines, i;
    cube c;
    write_text("floor.obj", "v -4 0 -4\nv -4 0 4\nv 4 0 4\nv 4 0 -4\nv 0 1 0\nv 0 1 1\nv .1 3 0\nf 1 2 3 4\nf 5 6 7\n");
    REQUIRE(BAKE("floor.obj", FAST, "--sky", "1,2,3", "--cubemaps", "1x2x1", "--cubemap-size", "8", "-o", "sky") == 0 &&
            !ran.err[0], "%s", ran.err);
    read_text(in_folder("sky/cubemaps.json"), json, sizeof json, &lines);
    CHECK(strstr(json, "\"position\": [0, 0.75, 0]") && strstr(json, "\"position\": [0, 2.25, 0]") &&
          strstr(json, "\"grid\": [1, 2, 1]"), "%s", json);
    CHECK(strstr(json, "{\"lowest\": [-4, 0, -4], \"highest\": [4, 3, 4], \"from\": [\"bounds\", \"bounds\", "
                 "\"bounds\", \"wall\", \"bounds\", \"bounds\"]}"), "%s", json);
    REQUIRE(read_ktx2("sky/cubemap_0001.ktx2", &c) && c.levels == 2, "no cube map");
    for (i = 0; i < 3; i++)
        CHECK(fabs((double)c.values[0][3 * 2 * 64 + i] - i - 1) < 1e-3, "the sky is %g", (double)c.values[0][384 + i]);
    free_cube(&c);
}

TEST(wrong_command_lines_are_refused) {
    write_text("file", "x");
    REFUSED(2, "--cubemaps 2", "glow.obj", "--cubemaps", "2", "-o", "no");
    REFUSED(2, "power of two", "glow.obj", "--cubemaps", "1x1x1", "--cubemap-size", "48", "-o", "no");
    REFUSED(2, "--cubemap-size needs --cubemaps", "glow.obj", "--probes", "1x1x1", "--cubemap-size", "8", "-o",
            "no.json");
    REFUSED(2, "--part does not divide cube maps", "glow.obj", "--cubemaps", "1x1x1", "--part", "1/2", "-o", "no");
    REFUSED(2, "--resume needs --lightmap", "glow.obj", "--cubemaps", "1x1x1", "--resume", "-o", "no");
    REFUSED(2, "not a folder", "glow.obj", "--cubemaps", "1x1x1", "-o", "file");
    REFUSED(2, "--cubemaps 4096x4096x4096: the grid has 68719476736 points; at most 10000 are", "glow.obj",
            "--cubemaps", "4096x4096x4096", "-o", "no");
    REFUSED(2, "at most 10000", "glow.obj", "--cubemaps", "100x100x2", "-o", "no");
    REFUSED(2, "give one of", "glow.obj", "--cubemaps", "1x1x1", "--vertices", "-o", "no");
    CHECK(!exists("no") && !parts_left(), "a folder or a file was left behind");
}

/* If the last level cannot be written, no file of the cube map is written. */
TEST(no_half_cube_maps) {
    glowing_room(1);
    mkdir(in_folder("half"), 0777);
    mkdir(in_folder("half/cubemap_0000_1.exr"), 0777);
    REFUSED(1, "half/cubemap_0000_1.exr: cannot be written", "glow.obj", FAST, "--cubemaps", "1x1x1",
            "--cubemap-size", "8", "-o", "half");
    CHECK(!exists("half/cubemap_0000.ktx2") && !exists("half/cubemap_0000_0.exr"), "there are half cube maps");
}

int main(int argc, char **argv) {
    (void)argc;
    if (!tool_begin(argv[0])) return 1;
    RUN(closed_forms);
    RUN_UNSANITIZED(sums_of_texels);
    RUN(half_floats);
    RUN(gl_samples_the_written_cube_map);
    RUN_UNSANITIZED(cmgen_agrees);
    RUN(texels_show_what_rays_meet);
    RUN(large_rooms);
    RUN(outdoors);
    RUN(wrong_command_lines_are_refused);
    RUN(no_half_cube_maps);
    tool_end();
    return test_report();
}
