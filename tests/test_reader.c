/* Tests of the process that reads scenes (examples/scene_file.h): its access to files, its limits of time and memory,
   and its end. The readers of these tests are functions of this program, each of which does one forbidden thing.
   Further tests check the materials that the process returns, and examples/gltf_file.h, which writes materials. */
#define _DEFAULT_SOURCE
#include "../sbl.h"
#include "../examples/scene_file.h"
/* gltf_file.h calls to_byte, which the tools get from picture_file.h. */
static unsigned char to_byte(double x) { return (unsigned char)(255 * x + 0.5); }
#include "../examples/gltf_file.h"
#include "support/test.h"
#include <sys/inotify.h>
#include <sys/ptrace.h>
#include <sys/socket.h>
#include <sys/un.h>

static char folder[64], error[512];

/* Notes that readers write into shared memory. They remain when the pages of the scene are unmapped. */
static struct notes {
    volatile pid_t child;
    volatile size_t taken;
    int handle, reads_of_outside;
} *notes;

static char *in_folder(const char *name) {
    static char path[4][256];
    static int next;
    next = (next + 1) % 4;
    snprintf(path[next], sizeof path[next], "%s/%s", folder, name);
    return path[next];
}
static void write_text(const char *name, const char *text) {
    FILE *out = fopen(in_folder(name), "wb");
    if (out) { fputs(text, out); fclose(out); }
}

/* Returns 1 if the process has ended or is a zombie. */
static int is_gone(pid_t child) {
    char path[64], state = 0;
    FILE *in;
    snprintf(path, sizeof path, "/proc/%d/stat", (int)child);
    in = fopen(path, "r");
    if (!in) return 1;
    if (fscanf(in, "%*d (%*[^)]) %c", &state) != 1) state = 'X';
    fclose(in);
    return state == 'Z' || state == 'X';
}
static int goes(pid_t child) {
    int i;
    for (i = 0; i < 36000 && !is_gone(child); i++) poll(NULL, 0, 100);
    return i < 600;
}

/* Reads room.obj with the function `reading`. The default time limit is half a second. */
static scene_file *load(scene__reading reading, const scene_file_options *given) {
    scene_file_options options;
    memset(&options, 0, sizeof options);
    if (given) options = *given;
    if (options.seconds == 0) options.seconds = 0.5;
    notes->child = 0;
    write_text("room.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n");
    return scene__load(reading, in_folder("room.obj"), &options, error, sizeof error);
}

/* >>access to files and to the rest of the machine */

/* Adds a warning to the scene if a call succeeds that must fail. */
#define MUST_FAIL(call, what) do { if ((call) >= 0) scene__warn(file, "%s", what); } while (0)

static void look_around(scene_file *file, const char *path, scene__bytes *bytes) {
    char other[300], byte;
    struct rlimit more = { RLIM_INFINITY, RLIM_INFINITY };
    (void)bytes;
    MUST_FAIL(read(notes->handle, &byte, 1), "a handle of the host's");
    snprintf(other, sizeof other, "%.*s/other.txt", (int)(strrchr(path, '/') - path), path);
    if (open(other, O_RDONLY) < 0) scene__warn(file, "a file of the scene's folder: %s", strerror(errno));
    if (strstr(file->confined, "Landlock active")) {
        MUST_FAIL(open("/etc/passwd", O_RDONLY), "a file outside");
        MUST_FAIL(open("/", O_RDONLY), "a folder outside");
        MUST_FAIL(open("/proc/self/maps", O_RDONLY), "/proc");
        MUST_FAIL(open(other, O_WRONLY), "writing");
        MUST_FAIL(unlink(other), "deleting");
        MUST_FAIL(mkdir("/tmp/sbl_reader_was_here", 0777), "making a folder");
    }
    MUST_FAIL(setrlimit(RLIMIT_DATA, &more), "more memory");
    MUST_FAIL(setrlimit(RLIMIT_CPU, &more), "more time");
    if (prctl(PR_GET_NO_NEW_PRIVS, 0, 0, 0, 0) == 0) scene__warn(file, "%s", "new privileges");
    if (!strstr(file->confined, "seccomp active")) return;
    MUST_FAIL(socket(AF_INET, SOCK_STREAM, 0), "a socket of the network");
    MUST_FAIL(socket(AF_UNIX, SOCK_STREAM, 0), "a socket of this machine");
    MUST_FAIL(execl("/bin/true", "true", (char *)NULL), "another program");
    MUST_FAIL(ptrace(PTRACE_TRACEME, 0, NULL, NULL), "tracing");
    MUST_FAIL(kill(getppid(), 0), "signals");
    MUST_FAIL(open("/tmp/sbl_reader_was_here", O_RDWR | O_CREAT, 0666), "making a file");
    if (mmap(NULL, 4096, PROT_READ | PROT_EXEC, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0) != MAP_FAILED)
        scene__warn(file, "%s", "code made of data");
    if (fork() == 0) _exit(0);
    else if (errno != ENOSYS) scene__warn(file, "another process: %s", strerror(errno));
}

static void complain(const scene_file *file) {
    int i;
    for (i = 0; i < file->warning_count && i < SCENE_FILE_WARNINGS; i++) CHECK(0, "this should have failed: %s",
        file->warnings[i]);
    CHECK(file->warning_count == 0, "%d forbidden things were possible", file->warning_count);
}

static char told[512];
static void listen_to(const char *path, const char *message, void *user) {
    (void)user;
    snprintf(told, sizeof told, "%s: %s", path, message);
}

/* A reader can open files in the folder of the scene and nothing else: no other files, sockets, processes or executable
   memory. */
TEST(reader_opens_only_the_scene_folder) {
    scene_file_options options;
    scene_file *file;
    if (SCENE__SANITIZED) SKIP("under sanitizers the reader is not confined");
    memset(&options, 0, sizeof options);
    options.log = listen_to;
    options.seconds = 60;
    write_text("other.txt", "other");
    notes->handle = open(in_folder("other.txt"), O_RDONLY);
    file = load(look_around, &options);
    close(notes->handle);
    REQUIRE(file, "%s", error);
    complain(file);
    printf("  %s\n", told);
    CHECK(strstr(told, "room.obj: Landlock ") && strstr(told, "seccomp "),
          "expected Landlock and seccomp to be named: %s", told);
    if (syscall(SCENE__LANDLOCK_CREATE, NULL, 0, 1) >= 1)
        CHECK(strstr(told, "Landlock active"), "the kernel has Landlock, but it is not used: %s", told);
#ifdef SCENE__MACHINE
    if (prctl(PR_GET_SECCOMP, 0, 0, 0, 0) >= 0)
        CHECK(strstr(told, "seccomp active"), "the kernel has seccomp, but it is not used: %s", told);
#endif
    scene_file_free(file);
}

/* Makes Landlock and seccomp unavailable in a copy of this process, with a seccomp filter. The other limits must still
   work. */
static int without_both(void) {
    struct sock_filter code[] = {
        BPF_STMT(BPF_LD | BPF_W | BPF_ABS, offsetof(struct seccomp_data, nr)),
        BPF_JUMP(BPF_JMP | BPF_JEQ | BPF_K, SCENE__LANDLOCK_CREATE, 3, 0),
        BPF_JUMP(BPF_JMP | BPF_JEQ | BPF_K, SYS_prctl, 0, 3),
        BPF_STMT(BPF_LD | BPF_W | BPF_ABS, offsetof(struct seccomp_data, args)),
        BPF_JUMP(BPF_JMP | BPF_JEQ | BPF_K, PR_SET_SECCOMP, 0, 1),
        BPF_STMT(BPF_RET | BPF_K, SECCOMP_RET_ERRNO | ENOSYS),
        BPF_STMT(BPF_RET | BPF_K, SECCOMP_RET_ALLOW) };
    struct sock_fprog program = { sizeof code / sizeof *code, code };
    return prctl(PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0) == 0 && prctl(PR_SET_SECCOMP, SECCOMP_MODE_FILTER, &program) == 0;
}

static void read_outside(scene_file *file, const char *path, scene__bytes *bytes) {
    scene__bytes other;
    (void)path; (void)bytes;
    notes->reads_of_outside = scene__slurp(file, "/etc/passwd", &other) || errno != SCENE__REFUSED;
}

/* Without Landlock and seccomp the scene is still read, and a message says that they are missing. */
TEST(a_missing_sandbox_is_reported) {
    scene_file_options options;
    int status = -1;
    pid_t child;
    if (SCENE__SANITIZED) SKIP("under sanitizers the reader is not confined");
    fflush(NULL);
    child = fork();
    if (child == 0) {
        scene_file *file;
        memset(&options, 0, sizeof options);
        options.log = listen_to;
        options.seconds = 60;
        if (!without_both()) _exit(77);
        notes->reads_of_outside = -1;
        file = load(read_outside, &options);
        _exit(!file ? 1 : notes->reads_of_outside != 0 ? 2 : !strstr(told, "Landlock not available") ? 3 :
              !strstr(told, "seccomp not available") ? 4 : 0);
    }
    waitpid(child, &status, 0);
    if (WIFEXITED(status) && WEXITSTATUS(status) == 77) SKIP("no seccomp to simulate an older kernel with");
    CHECK(WIFEXITED(status) && WEXITSTATUS(status) == 0, "status %#x: 1 not read, 2 read a file outside, 3 no message "
          "about "
        "Landlock,"
          " 4 none of seccomp", status);
}

/* >>a reader that an attacker controls */

static int called;
static void be_called(const float direction[3], float radiance[3], void *user) {
    (void)direction; (void)user;
    radiance[0] = radiance[1] = radiance[2] = 0;
    called++;
}
static void draw_nothing(const sbl_draw_view *view, void *user) { (void)view; (void)user; called++; }

static int lie;
static float elsewhere[64];

/* Leaves a valid scene with one inconsistent value in shared memory, as an attacker who controls the reader could. */
static void leave_a_lie(scene_file *file, const char *path, scene__bytes *bytes) {
    sbl_mesh *m = (sbl_mesh *)scene__alloc(file, 1, sizeof *m);
    sbl_texture *t = (sbl_texture *)scene__alloc(file, 1, sizeof *t);
    const char **names = (const char **)scene__alloc(file, 1, sizeof *names);
    int *maps = (int *)scene__alloc(file, 1, sizeof *maps);
    scene_file_place *places = (scene_file_place *)scene__alloc(file, 1, sizeof *places);
    sbl_light *light = (sbl_light *)scene__alloc(file, 1, sizeof *light);
    const char **light_names = (const char **)scene__alloc(file, 1, sizeof *light_names);
    char *name = (char *)scene__alloc(file, 8, 1);
    (void)path; (void)bytes;
    if (!m || !t || !names || !maps || !places || !light || !light_names || !name) return;
    m->positions.data = scene__alloc(file, 9, sizeof(float));
    m->lightmap_texcoords.data = scene__alloc(file, 6, sizeof(float));
    m->indices.data = scene__alloc(file, 3, sizeof(uint32_t));
    m->indices.type = SBL_UINT32;
    m->vertex_count = m->index_count = 3;
    t->pixels = scene__alloc(file, 4, 4);
    t->width = t->height = 2;
    t->channels = 4;
    names[0] = light_names[0] = name;
    file->names = names;
    file->light_names = light_names;
    file->maps = maps;
    file->places = places;
    file->map_count = 1;
    file->scene.meshes = m;
    file->scene.textures = t;
    file->scene.lights = light;
    file->scene.mesh_count = file->scene.texture_count = file->scene.light_count = 1;
    switch (lie) {
        case 1: m->positions.data = elsewhere; break;
        case 2: m->normals.data = elsewhere; break;
        case 3: m->vertex_count = 1 << 20; break;
        case 4: m->index_count = -3; break;
        case 5: t->pixels = elsewhere; break;
        case 6: t->width = 1 << 20; break;
        case 7: file->scene.meshes = (const sbl_mesh *)(const void *)elsewhere; break;
        case 8: file->scene.mesh_count = 1 << 20; break;
        case 9: names[0] = (const char *)elsewhere; break;
        case 10: memset(name, 'x', file->used - (size_t)(name - (char *)file)); break;
        case 11: file->used = (size_t)1 << 50; break;
        case 12: file->scene.environment.picture = *t; file->scene.environment.picture.pixels = elsewhere; break;
        case 13: file->warning_count = -1; break;
        case 14: file->scene.lights = (const sbl_light *)(const void *)elsewhere; break;
        case 15: file->finished = 1; abort();
        case 16: file->simplified[SCENE_FILE_LINES] = -1; break;
        case 17: file->units = SCENE_UNITS_COUNT; break;
        case 18: file->units = -1; break;
        case 19: file->frames = (const scene_file_camera *)(const void *)elsewhere; file->frame_count = 1; break;
        case 20: file->frame_count = 1; break;
        case 21: maps[0] = 1; break;
        case 22: maps[0] = -1; break;
        case 23: m->lightmap_texcoords.data = NULL; break;
        case 24: file->maps = (const int *)(const void *)elsewhere; break;
        case 25: file->places = (const scene_file_place *)(const void *)elsewhere; break;

        case 26: places[0].offset[1] = (float)INFINITY; break;
        case 27: file->map_size = 1 << 20; break;
        case 28: file->light_names = (const char *const *)(const void *)elsewhere; break;
        case 29: light_names[0] = (const char *)elsewhere; break;
        default: break;
    }
    if (lie) return;
    m->positions.gl_buffer = m->indices.gl_buffer = t->gl_texture = 1;
    m->positions.offset = m->indices.stride = t->stride = 1 << 30;
    file->scene.environment.radiance = be_called;
    file->scene.draw = draw_nothing;
    memset(file->warnings, 'x', sizeof file->warnings);
    memset(file->confined, 'x', sizeof file->confined);
    file->capacity = (size_t)1 << 50;
}

/* Each of 29 inconsistent values in the shared memory makes reading fail. Pointers to functions and names of GL objects
   are set to 0. */
TEST(inconsistent_shared_values_are_refused) {
    scene_file_options options;
    scene_file *file;
    memset(&options, 0, sizeof options);
    options.seconds = 60;
    for (lie = 1; lie <= 29; lie++) {
        file = load(leave_a_lie, &options);
        CHECK(!file && strstr(error, "its reader crashed"), "lie %d: %s", lie,
              file ? "the lie was believed" : error);
        scene_file_free(file);
    }
    lie = 0;
    file = load(leave_a_lie, &options);
    REQUIRE(file, "%s", error);
    CHECK(!file->scene.draw && !file->scene.environment.radiance, "a callback of the reader was kept");
    CHECK(!file->scene.meshes[0].positions.gl_buffer && !file->scene.meshes[0].indices.gl_buffer &&
              !file->scene.textures[0].gl_texture, "names of GL objects were kept");
    CHECK(!file->scene.meshes[0].positions.offset && !file->scene.meshes[0].indices.stride &&
              !file->scene.textures[0].stride, "offsets beyond the arrays were kept");
    CHECK(memchr(file->warnings[0], 0, sizeof file->warnings[0]) && memchr(file->confined, 0, sizeof file->confined),
          "a text is not terminated");
    CHECK(file->capacity >= file->used && file->capacity < 1 << 20, "the capacity is %.0f bytes",
          (double)file->capacity);
    scene_file_free(file);
}

/* >>textures */

/* A broken texture file is opened only once, however many materials use it. */
TEST(a_broken_picture_is_opened_once) {
    char text[8192] = "";
    int i, opened = 0, watch = inotify_init1(O_NONBLOCK);
    char events[8192], *at;
    ssize_t got;
    scene_file *file;
    FILE *out = fopen(in_folder("many.mtl"), "w");
    for (i = 0; i < 50; i++) {
        fprintf(out, "newmtl m%d\nmap_Kd broken.png\n%s", i, i % 3 ? "map_d broken.png\n" : "");
        sprintf(text + strlen(text), "usemtl m%d\nf 1/1 2/1 3/1\n", i);
    }
    fclose(out);
    out = fopen(in_folder("many.obj"), "w");
    fprintf(out, "mtllib many.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\n%s", text);
    fclose(out);
    write_text("broken.png", "\x89PNG\r\n\x1a\nthis is none");
    if (watch < 0 || inotify_add_watch(watch, in_folder("broken.png"), IN_OPEN | IN_CLOSE) < 0) SKIP("no inotify");
    file = scene_file_load(in_folder("many.obj"), NULL, error, sizeof error);
    REQUIRE(file, "%s", error);
    CHECK(file->warning_count == 1 && strstr(file->warnings[0], "broken.png"), "%d warnings: %s", file->warning_count,
        file->warnings[0]);
    while ((got = read(watch, events, sizeof events)) > 0)
        for (at = events; at < events + got;
            at += sizeof(struct inotify_event) + ((struct inotify_event *)(void *)at)->len)
            opened += (((struct inotify_event *)(void *)at)->mask & IN_OPEN) != 0;
    close(watch);
    CHECK(opened == 1, "50 materials opened the file %d times", opened);
    scene_file_free(file);
}

/* >>metalness, roughness and transmission */

typedef struct gloss { double ior, metallic, roughness; } gloss;
enum { GLOSSES = 12 };
static const gloss matte = { 0, 0, 0 };

/* Writes a scene with one triangle for each of the materials, which are separated by bars. The first triangle uses the
   last material, because assimp returns materials in the order of their use. Texture 0 is two.png, texture 1 is two.png
   with clamping, and texture 2 is a missing file. Textures 3 to 9 are copies of two.png, and 10 to 16 are the same
   copies with clamping. */
static void write_materials(const char *name, const char *materials) {
    static const char corners[] = "AAAAAAAAAAAAAAAAAACAPwAAAAAAAAAAAAAAAAAAgD8AAAAA";  /* 0 0 0, 1 0 0, 0 1 0 */
    static char json[8192];
    int n, i, count = 1;
    n = sprintf(json, "{\"asset\":{\"version\":\"2.0\"},\"extensionsUsed\":[\"KHR_materials_unlit\","
                "\"KHR_materials_transmission\",\"KHR_materials_ior\",\"KHR_materials_specular\","
                "\"KHR_materials_pbrSpecularGlossiness\",\"KHR_texture_transform\"],"
                "\"images\":[{\"uri\":\"two.png\"},{\"uri\":\"absent.png\"}");
    for (i = 1; i <= 7; i++) n += sprintf(json + n, ",{\"uri\":\"%.*stwo.png\"}", 2 * i, "./././././././");
    n += sprintf(json + n, "],\"samplers\":[{\"wrapS\":33071,\"wrapT\":33071}],\"textures\":[{\"source\":0},"
                 "{\"source\":0,\"sampler\":0},{\"source\":1}");
    for (i = 0; i < 14; i++) n += sprintf(json + n, ",{\"source\":%d%s}", 2 + i % 7, i < 7 ? "" : ",\"sampler\":0");
    n += sprintf(json + n, "],\"materials\":[{");
    for (; *materials; materials++) {
        count += *materials == '|';
        n += sprintf(json + n, *materials == '|' ? "},{" : "%c", *materials);
    }
    n += sprintf(json + n, "}],\"meshes\":[{\"primitives\":[");
    for (i = 0; i < count; i++)
        n += sprintf(json + n, "%s{\"attributes\":{\"POSITION\":0,\"TEXCOORD_0\":1,\"TEXCOORD_1\":2},\"material\":%d}",
                     i ? "," : "", count - 1 - i);
    sprintf(json + n, "]}],\"nodes\":[{\"mesh\":0}],\"scenes\":[{\"nodes\":[0]}],\"scene\":0,\"accessors\":["
            "{\"bufferView\":0,\"componentType\":5126,\"count\":3,\"type\":\"VEC3\",\"min\":[0,0,0],\"max\":[1,1,0]},"
            "{\"bufferView\":0,\"componentType\":5126,\"count\":3,\"type\":\"VEC2\"},"
            "{\"bufferView\":0,\"byteOffset\":12,\"componentType\":5126,\"count\":3,\"type\":\"VEC2\"}],"
            "\"bufferViews\":[{\"buffer\":0,\"byteLength\":36}],\"buffers\":[{\"byteLength\":36,"
            "\"uri\":\"data:application/octet-stream;base64,%s\"}]}", corners);
    write_text(name, json);
}

/* Returns 1 if a file contains a text. */
static int has_text(const char *name, const char *text) {
    static char all[16384];
    FILE *in = fopen(in_folder(name), "rb");
    const size_t size = in ? fread(all, 1, sizeof all - 1, in) : 0;
    if (in) fclose(in);
    all[size] = 0;
    return strstr(all, text) != NULL;
}

static scene_file *read_back(const char *name, int all_matte) {
    scene_file_options options;
    memset(&options, 0, sizeof options);
    options.matte = all_matte;
    return scene_file_load(in_folder(name), &options, error, sizeof error);
}

/* Returns the material of the mesh with index `number`. */
static const sbl_material *material_of(const scene_file *file, int number) {
    return &file->scene.materials[file->scene.meshes[number].material];
}

static int is_gloss(const sbl_material *m, const gloss *g) {
    return fabs((double)m->ior - g->ior) <= 1e-6 * g->ior && fabs((double)m->metallic - g->metallic) < 1e-6 &&
           fabs((double)m->roughness - g->roughness) < 1e-6;
}

/* Reads a scene and checks its materials: triangle i must have the material all[backwards ? count - 1 - i : i]. Returns
   the scene. */
static scene_file *check_gloss(const char *name, const char *what, const gloss *all, int backwards) {
    scene_file *file = read_back(name, 0), *plain = read_back(name, 1);
    int i;
    CHECK(file && plain, "%s: %s", what, error);
    for (i = 0; file && plain && i < file->scene.mesh_count; i++) {
        const gloss *g = &all[backwards ? file->scene.mesh_count - 1 - i : i];
        const sbl_material *m = material_of(file, i);
        CHECK(is_gloss(m, g), "%s: triangle %d: ior %.9g, metallic %.9g, roughness %.9g; expected %g %g %g", what, i,
              (double)m->ior, (double)m->metallic, (double)m->roughness, g->ior, g->metallic, g->roughness);
        CHECK(is_gloss(material_of(plain, i), &matte) && !material_of(plain, i)->specular_texture,
              "%s: triangle %d is not matte with options.matte", what, i);
    }
    scene_file_free(plain);
    return file;
}

#define MODEL(values) "\"pbrMetallicRoughness\":{" values "}"
#define FACTORS(metal, rough) MODEL("\"metallicFactor\":" metal ",\"roughnessFactor\":" rough)
#define EXTENSION(name, values) "\"extensions\":{\"KHR_materials_" name "\":{" values "}}"
#define BLACK_LAMP MODEL("\"baseColorFactor\":[0,0,0,1],\"roughnessFactor\":0.5") ",\"emissiveFactor\":[0,0,1]"

/* Each material of a .gltf has the values of the file. All materials are matte if no material of the file has
   metalness, a roughness below 1, a texture of these or transmission. A material that gives neither factors nor a
   texture for metal and roughness does not count as metal here; unlit surfaces and black lamps never count; see
   scene_file.h. */
TEST(gloss_of_gltf) {
    static const struct { const char *materials; gloss all[GLOSSES]; } files[] = {
        { FACTORS("0", "1") "||" MODEL("\"baseColorFactor\":[1,0,0,1]") "|\"emissiveFactor\":[1,1,1]",
          { { 0, 0, 0 } } },
        { FACTORS("0", "1") "|" BLACK_LAMP, { { 0, 0, 0 } } },
        { FACTORS("0", "1") "|" FACTORS("0", "0.2") "," EXTENSION("unlit", ""), { { 0, 0, 0 } } },
        { FACTORS("0", "1") "|" EXTENSION("ior", "\"ior\":1.3"), { { 0, 0, 0 } } },
        { FACTORS("0", "1") "|" FACTORS("0", "0.99"), { { 1.5, 0, 1 }, { 1.5, 0, 0.99 } } },
        { FACTORS("0", "1") "|" FACTORS("0.01", "1"), { { 1.5, 0, 1 }, { 1.5, 0.01, 1 } } },
        { FACTORS("0", "1") "|" MODEL("\"metallicFactor\":1"), { { 1.5, 0, 1 }, { 1.5, 1, 1 } } },
        { FACTORS("0", "1") "|" MODEL("\"roughnessFactor\":1"), { { 1.5, 0, 1 }, { 1.5, 1, 1 } } },
        { FACTORS("0", "1") "|" FACTORS("0", "1") "," EXTENSION("transmission", "\"transmissionFactor\":0.1"),
          { { 1.5, 0, 1 }, { 1.5, 0, 1 } } },
        { FACTORS("0", "0") "||" BLACK_LAMP "|\"emissiveFactor\":[1,1,1]|" FACTORS("0.25", "0.75") "|"
          EXTENSION("unlit", "") "|" MODEL("\"roughnessFactor\":0.5,\"baseColorFactor\":[0,0,0,1]"),
          { { 1.5, 0, 0 }, { 1.5, 1, 1 }, { 0, 0, 0 }, { 1.5, 1, 1 }, { 1.5, 0.25, 0.75 }, { 0, 0, 0 },
            { 1.5, 1, 0.5 } } },
        { FACTORS("0", "0.5") "|" EXTENSION("ior", "\"ior\":1.33") "|" EXTENSION("ior", "\"ior\":0") "|"
          EXTENSION("ior", "\"ior\":0.5") "|" EXTENSION("ior", "\"ior\":2e7") "|" EXTENSION("ior", "") "|"
          FACTORS("0", "0.5") ",\"name\":\"x (ior 7, 0)\"," EXTENSION("ior", "\"ior\":1") "|" FACTORS("0.5", "0.5") ","
          EXTENSION("specular", "\"specularFactor\":0") "|" FACTORS("0", "0.5") "," EXTENSION("specular", "") "|"
          FACTORS("0", "0.5") "," EXTENSION("specular", "\"specularColorFactor\":[0,0,0]") "|"
          FACTORS("0", "0.5") "," EXTENSION("specular", "\"specularColorFactor\":[0,0,0.1]"),
          { { 1.5, 0, 0.5 }, { 1.33, 1, 1 }, { 1e6, 1, 1 }, { 1, 1, 1 }, { 1e6, 1, 1 }, { 1.5, 1, 1 }, { 1, 0, 0.5 },
            { 0, 0.5, 0.5 }, { 1.5, 0, 0.5 }, { 0, 0, 0 }, { 1.5, 0, 0.5 } } },
        { "\"name\":\"a\"," EXTENSION("pbrSpecularGlossiness", "\"glossinessFactor\":0.75") "|" FACTORS("2", "-1") "|"
          EXTENSION("pbrSpecularGlossiness", "\"specularGlossinessTexture\":{\"index\":0}"),
          { { 1.5, 0, 0.25 }, { 1.5, 1, 0 }, { 0, 0, 0 } } } };
    size_t i;
#ifndef SBL_RENDER_CJSON
    SKIP("without cJSON, only assimp's values are known");
#endif
    for (i = 0; i < sizeof files / sizeof *files; i++) {
        const size_t count = sizeof files / sizeof *files;
        const int outside = i + 2 >= count;  /* one file with a refraction of 0.5, one with metal 2 and roughness -1 */
        scene_file *file;
        write_materials("gloss.gltf", files[i].materials);
        file = check_gloss("gloss.gltf", files[i].materials, files[i].all, 1);
        CHECK(!file || file->warning_count == outside, "%s: %d warnings, the first is %s", files[i].materials,
              file->warning_count, file->warnings[0]);
        scene_file_free(file);
    }
}

#define TEXTURED(values, texture) MODEL(values ",\"metallicRoughnessTexture\":{\"index\":" texture "}")

/* A picture that is used for both colour and metalness becomes two textures, one in sRGB and one linear. If the picture
   is missing, the surface is matte. */
TEST(textures_of_metal) {
    static const unsigned char texels[6] = { 10, 128, 250, 200, 64, 3 };
    static const gloss all[4] = { { 1.5, 1, 1 }, { 1.5, 0.5, 0.25 }, { 1.5, 1, 1 }, { 0, 0, 0 } };
    const sbl_material *m[4];
    scene_file *file;
    int i;
    stbi_write_png(in_folder("two.png"), 2, 1, 3, texels, 6);
    write_materials("metal.gltf", TEXTURED("\"baseColorTexture\":{\"index\":0}", "0") "|"
                    TEXTURED("\"metallicFactor\":0.5,\"roughnessFactor\":0.25", "0") "|"
                    TEXTURED("\"baseColorTexture\":{\"index\":0}", "1") ",\"name\":\"clamped\"|"
                    TEXTURED("\"baseColorTexture\":{\"index\":0}", "2"));
    file = check_gloss("metal.gltf", "textures", all, 1);
    REQUIRE(file, "%s", error);
    for (i = 0; i < 4; i++) m[i] = material_of(file, 3 - i);
    CHECK(file->scene.texture_count == 3, "%d textures: expected colour, metal, and metal that is clamped",
          file->scene.texture_count);
    CHECK(m[0]->albedo_texture && m[0]->specular_texture && m[0]->albedo_texture != m[0]->specular_texture &&
          m[0]->albedo_texture == m[3]->albedo_texture && m[0]->specular_texture == m[1]->specular_texture &&
          m[0]->specular_texture != m[2]->specular_texture, "colour is %d %d, metal is %d %d %d", m[0]->albedo_texture,
          m[3]->albedo_texture, m[0]->specular_texture, m[1]->specular_texture, m[2]->specular_texture);
    for (i = 0; i < file->scene.texture_count; i++) {
        const sbl_texture *t = &file->scene.textures[i];
        CHECK(t->format == (i + 1 == m[0]->albedo_texture ? SBL_PIXELS_SRGB8 : SBL_PIXELS_LINEAR8) &&
              t->wrap == (i + 1 == m[2]->specular_texture ? SBL_WRAP_CLAMP : SBL_WRAP_REPEAT) && t->width == 2 &&
              t->channels == 3 && memcmp(t->pixels, texels, 6) == 0, "texture %d: format %d, wrap %d, %d x %d", i,
              (int)t->format, (int)t->wrap, t->width, t->channels);
    }
    CHECK(!m[3]->specular_texture && file->warning_count == 1 && strstr(file->warnings[0], "absent.png"), "%d: %s",
          file->warning_count, file->warnings[0]);
    scene_file_free(file);
}

/* Warnings count what is not shown. In matte scenes, gloss counts from a glossiness of 0.5 and from an Ns of 30 on. In
   others, KHR_materials_specular counts where a surface is glossy, and textures of metal do not count. */
TEST(gloss_that_is_lost_is_counted) {
    static const char shiny[] = EXTENSION("pbrSpecularGlossiness", "\"glossinessFactor\":0.75");
    static const char dull[] = "|" EXTENSION("pbrSpecularGlossiness", "\"glossinessFactor\":0.25");
    static const char specular[] = "\"extensions\":{\"KHR_materials_specular\":{\"specularFactor\":0.5}";
    char materials[1024];
    scene_file *file;
    snprintf(materials, sizeof materials, "%s%s%s", shiny, dull, dull);
    write_materials("lost.gltf", materials);
    file = read_back("lost.gltf", 1);
    CHECK(file && file->simplified[SCENE_FILE_GLOSS] == 1, "%d glossy materials of glTF: %s",
          file ? file->simplified[SCENE_FILE_GLOSS] : 0, error);
    scene_file_free(file);
    write_text("lost.mtl", "newmtl a\nKs 1 1 1\nNs 29\nillum 2\nnewmtl b\nKs 1 1 1\nNs 31\nillum 2\n");
    write_text("lost.obj", "mtllib lost.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl a\nf 1 2 3\nusemtl b\nf 1 2 3\n");
    file = read_back("lost.obj", 1);
    CHECK(file && file->simplified[SCENE_FILE_GLOSS] == 1, "%d glossy materials of OBJ: %s",
          file ? file->simplified[SCENE_FILE_GLOSS] : 0, error);
    scene_file_free(file);
    snprintf(materials, sizeof materials, "%s,%s}|%s,%s}|%s", FACTORS("0", "0.5"), specular, BLACK_LAMP, specular,
             TEXTURED("\"metallicFactor\":1", "0"));
    write_materials("lost.gltf", materials);
    file = read_back("lost.gltf", 0);
    CHECK(file && file->simplified[SCENE_FILE_SPECULAR] == 1 && !file->simplified[SCENE_FILE_MAP],
          "%d with strength of reflections, %d with maps: %s", file ? file->simplified[SCENE_FILE_SPECULAR] : 0,
          file ? file->simplified[SCENE_FILE_MAP] : 0, error);
    scene_file_free(file);
}

/* All textures of a material use one set of texture coordinates: that of its colour texture or, without one, that of
   its metalness texture. */
TEST(coordinates_of_metal) {
    scene_file *file;
    const float *v;
    write_materials("uv.gltf", TEXTURED("\"metallicFactor\":1", "0,\"texCoord\":1"));
    file = read_back("uv.gltf", 0);
    REQUIRE(file, "%s", error);
    v = (const float *)file->scene.meshes[0].texcoords.data;  /* expects TEXCOORD_1: 1 0, 0 0, 1 0 */
    CHECK(!file->warning_count && v && v[0] > 0.5f && v[2] < 0.5f, "%s", file->warnings[0]);
    scene_file_free(file);
    write_materials("uv.gltf", TEXTURED("\"baseColorTexture\":{\"index\":0}", "0,\"texCoord\":1") ",\"name\":\"shoe\"");
    file = read_back("uv.gltf", 0);
    REQUIRE(file, "%s", error);
    v = (const float *)file->scene.meshes[0].texcoords.data;  /* expects TEXCOORD_0: 0 0, 0 1, 0 0 */
    CHECK(v && v[0] < 0.5f && v[3] > 0.5f, "the coordinates are not those of the colour");
    CHECK(file->warning_count == 1 && strstr(file->warnings[0], "material shoe: its textures use different"), "%s",
          file->warnings[0]);
    scene_file_free(file);
}

static const char phong_dae[] =
    "<?xml version=\"1.0\"?><COLLADA xmlns=\"http://www.collada.org/2005/11/COLLADASchema\" "
    "version=\"1.4.1\"><library_effects><effect id=\"e\"><profile_COMMON><technique sid=\"t\"><phong><diffuse><color>"
    ".5 .5 .5 1</color></diffuse><specular><color>1 1 1 1</color></specular><shininess><float>98</float></shininess>"
    "<index_of_refraction><float>1.7</float></index_of_refraction></phong></technique></profile_COMMON></effect>"
    "</library_effects><library_materials><material id=\"m\"><instance_effect url=\"#e\"/></material>"
    "</library_materials><library_geometries><geometry id=\"g\"><mesh><source id=\"s\"><float_array id=\"a\" "
    "count=\"9\">0 0 0 1 0 0 0 1 0</float_array><technique_common><accessor source=\"#a\" count=\"3\" stride=\"3\">"
    "<param name=\"X\" type=\"float\"/><param name=\"Y\" type=\"float\"/><param name=\"Z\" type=\"float\"/></accessor>"
    "</technique_common></source><vertices id=\"v\"><input semantic=\"POSITION\" source=\"#s\"/></vertices>"
    "<triangles count=\"1\" material=\"m\"><input semantic=\"VERTEX\" source=\"#v\" offset=\"0\"/><p>0 1 2</p>"
    "</triangles></mesh></geometry></library_geometries><library_visual_scenes><visual_scene id=\"w\"><node>"
    "<instance_geometry url=\"#g\"><bind_material><technique_common><instance_material symbol=\"m\" target=\"#m\"/>"
    "</technique_common></bind_material></instance_geometry></node></visual_scene></library_visual_scenes><scene>"
    "<instance_visual_scene url=\"#w\"/></scene></COLLADA>";

/* The highlights of OBJ and Collada become roughness and metalness. */
TEST(gloss_of_other_formats) {
    static const struct { const char *material; gloss expected; double red; } materials[] = {
        { "Kd .5 .5 .5\nKs 1 1 1\nNs 98\nNi 1.7\nillum 2", { 1.7, 0, 0.37606031 }, 0.5 },
        { "Kd .5 .5 .5\nKs .1 0 0\nNs 0\nNi 1\nillum 2", { 1.5, 0, 1 }, 0.5 },
        { "Kd .5 .5 .5\nKs 0 0 0\nNs 98\nillum 2", { 0, 0, 0 }, 0.5 },
        { "Kd .5 .5 .5\nKs 1 1 1\nNs 98\nillum 1", { 0, 0, 0 }, 0.5 },
        { "Kd .04 .04 .04\nKs .8 .4 .1\nNs 98\nillum 3", { 1.5, 1, 0.37606031 }, 0.8 },
        { "Kd .04 .04 .04\nKs .8 .4 .1\nNs 98\nillum 2", { 1.5, 0, 0.37606031 }, 0.04 },
        { "Kd .04 .04 .06\nKs .8 .4 .1\nNs 98\nillum 5", { 1.5, 0, 0.37606031 }, 0.04 },
        { "Kd 0 0 0\nKs .5 .5 .5\nNs 98\nNi 2\nillum 5", { 2, 0, 0.37606031 }, 0 },
        { "Kd 0 0 0\nKe 1 1 1\nKs 1 1 1\nNs 98\nillum 3", { 0, 0, 0 }, 0 },
        { "Kd .5 .5 .5\nPr .3\nPm .75", { 1.5, 0.75, 0.3 }, 0.5 },
        { "Kd .5 .5 .5\nKs 1 1 1\nNs -5\nillum 2", { 1.5, 0, 1 }, 0.5 },
        { "Kd 0 0 0\nKs 3 .4 .1\nNs 98\nillum 3", { 1.5, 1, 0.37606031 }, 1 } };
    enum { COUNT = sizeof materials / sizeof *materials };
    gloss all[COUNT];
    scene_file *file;
    FILE *mtl = fopen(in_folder("gloss.mtl"), "w"), *obj = fopen(in_folder("gloss.obj"), "w");
    int i;
    fprintf(obj, "mtllib gloss.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\n");
    for (i = 0; i < COUNT; i++) {
        fprintf(mtl, "newmtl m%d\n%s\n", i, materials[i].material);
        fprintf(obj, "usemtl m%d\nf 1 2 3\n", i);
        all[i] = materials[i].expected;
    }
    fclose(mtl);
    fclose(obj);
    file = check_gloss("gloss.obj", "gloss.obj", all, 0);
    for (i = 0; file && i < COUNT; i++)
        CHECK(fabs((double)material_of(file, i)->albedo[0] - materials[i].red) < 1e-6, "m%d: red is %g, expected %g", i,
              (double)material_of(file, i)->albedo[0], materials[i].red);
    scene_file_free(file);
    file = read_back("gloss.obj", 1);
    CHECK(file && fabs((double)material_of(file, 4)->albedo[0] - 0.04) < 1e-6, "with options.matte, metal has Kd");
    scene_file_free(file);
    write_text("gloss.mtl", "newmtl m0\nKd 1 1 1\nKs 1 1 1\nNs 0\nillum 2\n");
    write_text("gloss.obj", "mtllib gloss.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl m0\nf 1 2 3\n");
    scene_file_free(check_gloss("gloss.obj", "only Ns 0", &matte, 0));
    write_text("gloss.dae", phong_dae);
    scene_file_free(check_gloss("gloss.dae", "gloss.dae", all, 0));
}

/* Surfaces without a material are grey in all formats but glTF. Vertex colours, textures and materials stay as they
   are. */
TEST(grey_without_material) {
#define PLY(columns, values, more) "ply\nformat ascii 1.0\n" more "element vertex 3\nproperty float x\n" \
    "property float y\nproperty float z\n" columns "element face 1\nproperty list uchar int vertex_indices\n" \
    "end_header\n0 0 0" values "\n1 0 0" values "\n0 1 0" values "\n3 0 1 2\n"
    static const struct { const char *name, *text; double albedo; } files[] = {
        { "bare.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", 0.6 },
        { "bare.off", "OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n", 0.6 },
        { "bare.stl", "solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\n"
                      "endfacet\nendsolid a\n", 0.6 },
        { "bare.ply", PLY("", "", ""), 0.6 },
        { "colours.ply", PLY("property uchar red\nproperty uchar green\nproperty uchar blue\n", " 255 0 0", ""), 1 },
        { "texture.ply", PLY("property float s\nproperty float t\n", " 0 0", "comment TextureFile two.png\n"), 1 } };
    int i;
    for (i = 0; i < (int)(sizeof files / sizeof *files); i++) {
        scene_file *file;
        write_text(files[i].name, files[i].text);
        file = read_back(files[i].name, 0);
        CHECK(file, "%s: %s", files[i].name, error);
        CHECK(!file || fabs((double)material_of(file, 0)->albedo[1] - files[i].albedo) < 1e-6, "%s: albedo is %g, "
              "expected %g", files[i].name, (double)material_of(file, 0)->albedo[1], files[i].albedo);
        scene_file_free(file);
    }
}

/* Expected values of panes and blended surfaces: transmittance, textures and flags, and the alpha of their vertex
   colours (1 without vertex colours). */
typedef struct pane { double transmission, cutoff, alpha; int is_blended, has_texture; } pane;

static double alpha_of(const sbl_mesh *m) {
    return m->colors.data ? (double)((const float *)m->colors.data)[4 * m->vertex_count - 1] : 1;
}

/* Compares the material of the triangle with index `number` with the expected values. */
static void check_pane(const scene_file *file, int number, const char *what, const pane *expected) {
    const sbl_material *m = material_of(file, number);
    const double alpha = alpha_of(&file->scene.meshes[number]);
    CHECK(fabs((double)m->transmission - expected->transmission) < 1e-6 &&
          fabs((double)m->alpha_cutoff - expected->cutoff) < 1e-6 && fabs(alpha - expected->alpha) < 1e-6 &&
          m->flags == (expected->is_blended ? (uint32_t)SBL_MATERIAL_BLEND : 0) &&
          !m->transmission_texture == !expected->has_texture,
          "%s: triangle %d: transmission %g, texture %d, cutoff %g, flags %u, alpha %g", what, number,
          (double)m->transmission, m->transmission_texture, (double)m->alpha_cutoff, (unsigned)m->flags, alpha);
}

/* Reads a scene of `count` panes and compares all materials. all: in the order of the file; the first triangle uses the
   last one. */
static void check_panes(const char *materials, int all_matte, const pane *all, int count) {
    scene_file *file;
    int i;
    write_materials("panes.gltf", materials);
    file = read_back("panes.gltf", all_matte);
    REQUIRE(file && file->scene.mesh_count == count, "%s: %d triangles: %s", materials,
            file ? file->scene.mesh_count : 0, error);
    for (i = 0; i < count; i++) check_pane(file, i, materials, &all[count - 1 - i]);
    scene_file_free(file);
}

#define PANE(values) FACTORS("0", "1") "," EXTENSION("transmission", values)
#define COLORED(alpha) MODEL("\"metallicFactor\":0,\"roughnessFactor\":1,\"baseColorFactor\":[1,1,1," alpha "]")

/* The transmittance of a material is the value of KHR_materials_transmission. Unlit materials are opaque. A pane whose
   texture is missing is opaque. */
TEST(panes_of_gltf) {
    static const unsigned char texels[6] = { 10, 128, 250, 200, 64, 3 };
    static const char materials[] = PANE("\"transmissionFactor\":0.25") "|"
        PANE("\"transmissionFactor\":0.5,\"transmissionTexture\":{\"index\":0}") "|"
        PANE("\"transmissionTexture\":{\"index\":0}") "|" PANE("\"transmissionFactor\":7") "|"
        PANE("\"transmissionFactor\":1,\"transmissionTexture\":{\"index\":2}") "|"
        TEXTURED("\"baseColorTexture\":{\"index\":0}", "0") "|\"extensions\":{\"KHR_materials_unlit\":{},"
        "\"KHR_materials_transmission\":{\"transmissionFactor\":1}}";
    static const pane shown[7] = { { 0.25, 0, 1, 0, 0 }, { 0.5, 0, 1, 0, 1 }, { 0, 0, 1, 0, 0 }, { 1, 0, 1, 0, 0 },
        { 0, 0, 1, 0, 0 }, { 0, 0, 1, 0, 0 }, { 0, 0, 1, 0, 0 } };
    static const pane opaque[7] = { { 0, 0, 1, 0, 0 }, { 0, 0, 1, 0, 0 }, { 0, 0, 1, 0, 0 }, { 0, 0, 1, 0, 0 },
        { 0, 0, 1, 0, 0 }, { 0, 0, 1, 0, 0 }, { 0, 0, 1, 0, 0 } };
    scene_file *file;
    const sbl_texture *t;
    stbi_write_png(in_folder("two.png"), 2, 1, 3, texels, 6);
    check_panes(materials, 0, shown, 7);
    check_panes(materials, 1, opaque, 7);
    file = read_back("panes.gltf", 0);
    REQUIRE(file, "%s", error);
    CHECK(file->warning_count == 2 && file->scene.texture_count == 2, "%d warnings, %d textures", file->warning_count,
          file->scene.texture_count);
    t = &file->scene.textures[material_of(file, 5)->transmission_texture - 1];
    CHECK(t->format == SBL_PIXELS_LINEAR8 && memcmp(t->pixels, texels, 6) == 0 &&
          material_of(file, 5)->transmission_texture == material_of(file, 1)->specular_texture &&
          material_of(file, 5)->transmission_texture != material_of(file, 1)->albedo_texture,
          "transmission is not the linear texture");
    scene_file_free(file);
    write_materials("panes.gltf", MODEL("\"metallicFactor\":0,\"baseColorTexture\":{\"index\":0}") ","
        EXTENSION("transmission", "\"transmissionFactor\":1,\"transmissionTexture\":{\"index\":0,\"texCoord\":1}"));
    file = read_back("panes.gltf", 0);
    CHECK(file && file->warning_count == 1 && strstr(file->warnings[0], "different texture coordinates"), "%s",
          file ? file->warnings[0] : error);
    scene_file_free(file);
}

/* BLEND makes a surface partly transparent, and its alpha factor becomes the alpha of the vertex colours. In scenes
   that are matte otherwise, BLEND becomes a cut-out at an alpha of 0.5, and the scene stays matte. */
TEST(blending_of_gltf) {
    static const char materials[] = FACTORS("0", "0.5") "|" COLORED("0.25") ",\"alphaMode\":\"BLEND\"|"
        COLORED("0.75") ",\"alphaMode\":\"BLEND\"|" COLORED("1") ",\"alphaMode\":\"BLEND\"|"
        COLORED("0.25") "|" COLORED("0.75") ",\"alphaMode\":\"MASK\"|" COLORED("0") ",\"alphaMode\":\"BLEND\"|"
        COLORED("0.25") ",\"alphaMode\":\"MASK\"|" COLORED("0.5") ",\"alphaMode\":\"BLEND\","
        EXTENSION("unlit", "") "|" COLORED("-1");
    static const pane blended[8] = { { 0, 0, 1, 0, 0 }, { 0, 0, 0.25, 1, 0 }, { 0, 0, 0.75, 1, 0 }, { 0, 0, 1, 1, 0 },
        { 0, 0, 1, 0, 0 }, { 0, 2 / 3.0, 1, 0, 0 }, { 0, 0, 0.5, 1, 0 }, { 0, 0, 1, 0, 0 } };
    static const pane cut[7] = { { 0, 0, 1, 0, 0 }, { 0, 2 / 3.0, 1, 0, 0 }, { 0, 0.5, 1, 0, 0 }, { 0, 0, 1, 0, 0 },
        { 0, 2 / 3.0, 1, 0, 0 }, { 0, 1, 1, 0, 0 }, { 0, 0, 1, 0, 0 } };
    static const char thin[] = FACTORS("0", "1") "|" MODEL("\"metallicFactor\":0,\"roughnessFactor\":0.5,"
        "\"baseColorFactor\":[1,1,1,0.125]") ",\"alphaMode\":\"BLEND\"";
    static const char gone[] = FACTORS("0", "1") "|" MODEL("\"metallicFactor\":0,\"roughnessFactor\":0.5,"
        "\"baseColorFactor\":[1,1,1,0]") ",\"alphaMode\":\"BLEND\"";
    static const pane two[2] = { { 0, 0, 1, 0, 0 }, { 0, 0, 0.125, 1, 0 } };
    scene_file *file;
    check_panes(materials, 0, blended, 8);
    check_panes(materials, 1, cut, 7);
    check_panes(strchr(materials, '|') + 1, 0, cut + 1, 6);  /* no other material: the scene is matte */
    file = read_back("panes.gltf", 0);
    CHECK(file && is_gloss(material_of(file, 0), &matte) && file->simplified[SCENE_FILE_BLEND] == 2,
          "BLEND made a file glossy");
    scene_file_free(file);
    check_panes(thin, 0, two, 2);
    check_panes(gone, 0, two, 1);
    file = read_back("panes.gltf", 0);
    CHECK(file && is_gloss(material_of(file, 0), &matte), "an invisible surface made a file glossy");
    scene_file_free(file);
}

/* Glass of OBJ becomes a pane, whose colour is given by d and Tf. Other materials with d are blended with the
   background, unless the scene is matte. */
TEST(glass_of_obj) {
    static const struct { const char *material; pane expected; double red, blue; } materials[] = {
        { "Kd 1 1 1\nKs 1 1 1\nNs 98\nillum 4\nd 0.25", { 0.75, 0, 1, 0, 0 }, 1, 1 },
        { "Kd 0 0 0\nKs 1 1 1\nNs 98\nillum 7\nNi 1.5\nTf .2 .2 .1", { 1, 0, 1, 0, 0 }, 0.9, 0.45 },
        { "Kd 0 0 0\nillum 6\nNi 1.5\nTf 0 0 0", { 1, 0, 1, 0, 0 }, 0.9, 0.9 },
        { "Kd .5 .5 .5\nillum 9\nd 0.5", { 2 / 3.0, 0, 1, 0, 0 }, 0.75, 0.75 },
        { "Kd .5 .5 .5\nillum 9\nd 0", { 1, 0, 1, 0, 0 }, 1, 1 },
        { "Kd .5 .5 .5\nKs .5 .5 .5\nNs 18\nillum 4\nTf 1 1 1\nNi 1", { 0, 0, 1, 0, 0 }, 0.5, 0.5 },
        { "Kd .5 .5 .5\nKs .5 .5 .5\nNi 1.5\nillum 5", { 0, 0, 1, 0, 0 }, 0.5, 0.5 },
        { "Kd .5 .5 .5\nillum 9\nd -1", { 1, 0, 1, 0, 0 }, 1, 1 },
        { "Kd .5 .5 .5\nd 0.25", { 0, 0, 0.25, 1, 0 }, 0.5, 0.5 },
        { "Kd .5 .5 .5\nd 0", { 0, 0, 1, 0, 0 }, -1, -1 } };
    enum { COUNT = sizeof materials / sizeof *materials };
    FILE *mtl = fopen(in_folder("glass.mtl"), "w"), *obj = fopen(in_folder("glass.obj"), "w");
    scene_file *file;
    int i;
    fprintf(obj, "mtllib glass.mtl\nv 0 0 0 .5 1 1\nv 1 0 0 .5 1 1\nv 0 1 0 .5 1 1\n");
    for (i = 0; i < COUNT; i++) {
        fprintf(mtl, "newmtl m%d\n%s\n", i, materials[i].material);
        fprintf(obj, "usemtl m%d\nf 1 2 3\n", i);
    }
    fclose(mtl);
    fclose(obj);
    file = read_back("glass.obj", 0);
    REQUIRE(file && file->scene.mesh_count == COUNT - 1, "%d triangles: %s", file ? file->scene.mesh_count : 0, error);
    for (i = 0; i < COUNT - 1; i++) {
        const sbl_material *m = material_of(file, i);
        const float *color = (const float *)file->scene.meshes[i].colors.data;
        check_pane(file, i, materials[i].material, &materials[i].expected);
        CHECK(fabs((double)m->albedo[0] - materials[i].red) < 1e-6 && m->metallic <= 0 &&
              fabs((double)m->albedo[2] - materials[i].blue) < 1e-6, "m%d: red %g, blue %g, metal %g", i,
              (double)m->albedo[0], (double)m->albedo[2], (double)m->metallic);
        CHECK(color && fabs((double)color[0] - 0.5) < 1e-6, "m%d: the colours of vertices are lost", i);
    }
    CHECK(file->simplified[SCENE_FILE_REFRACTION] == 2, "%d refract", file->simplified[SCENE_FILE_REFRACTION]);
    scene_file_free(file);
    file = read_back("glass.obj", 1);
    CHECK(file && file->scene.mesh_count == 5 && material_of(file, 1)->albedo[0] <= 0, "with options.matte, glass is "
          "read as before");
    for (i = 0; file && i < file->scene.mesh_count; i++)
        CHECK(material_of(file, i)->transmission <= 0 && !material_of(file, i)->flags, "m%d lets light pass", i);
    scene_file_free(file);
}

/* Returns the camera of a scene in the form that gltf_file.h needs, or NULL. */
static const float *camera_of(const scene_file *file) {
    static float v[10];
    if (!file->has_camera) return NULL;
    memcpy(v, file->camera.eye, 12);
    memcpy(v + 3, file->camera.forward, 12);
    memcpy(v + 6, file->camera.up, 12);
    v[9] = file->camera.fov_y;
    return v;
}

/* Writes a scene as glTF. */
static void write_scene(const scene_file *from, const char *name) {
    const gltf_file out = { .scene = &from->scene, .names = from->names, .bin = "again.bin", .has_lights = 1,
                            .camera = camera_of(from) };
    char texture[GLTF_NAME];
    FILE *json = fopen(in_folder(name), "wb"), *bin = fopen(in_folder("again.bin"), "wb"), *png;
    int i;
    gltf_write_json(json, &out);
    gltf_write_bin(bin, &out);
    fclose(json);
    fclose(bin);
    for (i = 0; i < from->scene.texture_count; i++) {
        gltf_texture_name(texture, i);
        png = fopen(in_folder(texture), "wb");
        gltf_write_texture(png, &out, i);
        fclose(png);
    }
}

/* A scene that gltf_file.h writes has the same materials when it is read again, also if only some of them are matte. */
TEST(written_gloss_is_read_again) {
    static const unsigned char texels[6] = { 10, 128, 250, 200, 64, 3 };
    scene_file *file, *again;
    int i;
#ifndef SBL_RENDER_CJSON
    SKIP("without cJSON, only assimp's values are known");
#endif
    stbi_write_png(in_folder("two.png"), 2, 1, 3, texels, 6);
    write_materials("gloss.gltf", FACTORS("0", "0.3") "|" FACTORS("1", "1") "|" EXTENSION("ior", "\"ior\":1.8") "|"
                    BLACK_LAMP "|" TEXTURED("\"baseColorTexture\":{\"index\":0}", "0") "|" EXTENSION("unlit", "") "|"
                    FACTORS("0.5", "0") "," EXTENSION("specular", "\"specularFactor\":0") "|"
                    FACTORS("0", "1") ",\"emissiveFactor\":[1,1,1],\"extensions\":{\"KHR_materials_emissive_strength\":"
                    "{\"emissiveStrength\":3},\"KHR_materials_ior\":{\"ior\":0}}|"
                    PANE("\"transmissionFactor\":0.5,\"transmissionTexture\":{\"index\":0}") "|"
                    COLORED("0.25") ",\"alphaMode\":\"BLEND\"|" COLORED("0.75") ",\"alphaMode\":\"MASK\"");
    file = read_back("gloss.gltf", 0);
    REQUIRE(file, "%s", error);
    write_scene(file, "again.gltf");
    again = read_back("again.gltf", 0);
    REQUIRE(again && again->scene.mesh_count == 11 && !again->warning_count, "%s", again ? again->warnings[0] : error);
    for (i = 0; i < 11; i++) {
        const sbl_material *a = material_of(file, i), *b = material_of(again, i);
        const gloss g = { (double)a->ior, (double)a->metallic, (double)a->roughness };
        const pane p = { (double)a->transmission, (double)a->alpha_cutoff, alpha_of(&file->scene.meshes[i]),
            (a->flags & SBL_MATERIAL_BLEND) != 0, a->transmission_texture };
        check_pane(again, i, "written", &p);
        CHECK(is_gloss(b, &g), "triangle %d: ior %g, metallic %g, roughness %g; before %g %g %g", i, (double)b->ior,
              (double)b->metallic, (double)b->roughness, g.ior, g.metallic, g.roughness);
        CHECK(fabs((double)a->emission[0] - (double)b->emission[0]) < 1e-5, "triangle %d: emission %g", i,
              (double)b->emission[0]);
        CHECK((a->specular_texture != 0) == (b->specular_texture != 0), "triangle %d: texture %d", i,
              b->specular_texture);
        if (a->specular_texture && b->specular_texture)
            CHECK(memcmp(again->scene.textures[b->specular_texture - 1].pixels, texels, 6) == 0, "other texels");
    }
    CHECK(material_of(again, 2)->transmission > 0 && material_of(again, 1)->flags, "nothing lets light pass");
    CHECK(again->simplified[SCENE_FILE_SPECULAR] == 0, "KHR_materials_specular with the factor 0 is read");
    scene_file_free(again);
    scene_file_free(file);
}

static int is_near(const float *a, const float *b, int count) {
    int i;
    for (i = 0; i < count; i++) if (!(fabsf(a[i] - b[i]) < 1e-4f)) return 0;
    return 1;
}

/* Lights and a camera that gltf_file.h writes are the same when they are read again. */
TEST(written_lights_are_read_again) {
    scene_file *file = scene_file_load("examples/scenes/lights.gltf", NULL, error, sizeof error), *again;
    int i;
    REQUIRE(file && file->scene.light_count == 3 && file->has_camera, "%s", error);
    write_scene(file, "again.gltf");
    again = read_back("again.gltf", 0);
    REQUIRE(again && again->scene.light_count == 3 && again->has_camera && !again->warning_count, "%s",
            again ? again->warnings[0] : error);
    for (i = 0; i < 3; i++) {
        const sbl_light *a = &file->scene.lights[i], *b = &again->scene.lights[i];
        CHECK(a->kind == b->kind && is_near(a->intensity, b->intensity, 3), "light %d: intensity %g %g %g", i,
              (double)b->intensity[0], (double)b->intensity[1], (double)b->intensity[2]);
        CHECK(a->kind == SBL_LIGHT_DIRECTIONAL || is_near(a->position, b->position, 3), "light %d: position", i);
        CHECK(a->kind == SBL_LIGHT_POINT || is_near(a->direction, b->direction, 3), "light %d: direction", i);
        CHECK(a->kind != SBL_LIGHT_SPOT || (fabsf(a->cone - b->cone) < 0.01f && a->cone > 1 &&
              fabsf(a->inner_cone - b->inner_cone) < 0.01f), "light %d: cones of %g and %g degrees", i,
              (double)b->inner_cone, (double)b->cone);
    }
    CHECK(is_near(file->camera.eye, again->camera.eye, 3) && is_near(file->camera.up, again->camera.up, 3) &&
          is_near(file->camera.forward, again->camera.forward, 3) &&
          is_near(&file->camera.fov_y, &again->camera.fov_y, 1), "another camera");
    scene_file_free(again);
    scene_file_free(file);
}

/* Writes a triangle that several nodes use. texcoords: the attributes of the triangle after POSITION; nodes: the
   members of each node after its mesh, separated by bars. */
static void write_places(const char *name, const char *texcoords, const char *nodes) {
    static char json[4096];
    int n, i, count = 1;
    n = sprintf(json, "{\"asset\":{\"version\":\"2.0\"},"
                "\"meshes\":[{\"primitives\":[{\"attributes\":{\"POSITION\":0%s}}]}],"
                "\"nodes\":[{\"mesh\":0", texcoords);
    for (; *nodes; nodes++) {
        count += *nodes == '|';
        n += sprintf(json + n, *nodes == '|' ? "},{\"mesh\":0" : "%c", *nodes);
    }
    n += sprintf(json + n, "}],\"scenes\":[{\"nodes\":[0");
    for (i = 1; i < count; i++) n += sprintf(json + n, ",%d", i);
    sprintf(json + n, "]}],\"scene\":0,\"accessors\":["
            "{\"bufferView\":0,\"componentType\":5126,\"count\":3,\"type\":\"VEC3\",\"min\":[0,0,0],\"max\":[1,1,0]},"
            "{\"bufferView\":0,\"componentType\":5126,\"count\":3,\"type\":\"VEC2\"},"
            "{\"bufferView\":0,\"byteOffset\":12,\"componentType\":5126,\"count\":3,\"type\":\"VEC2\"}],"
            "\"bufferViews\":[{\"buffer\":0,\"byteLength\":36}],\"buffers\":[{\"byteLength\":36,"
            "\"uri\":\"data:application/octet-stream;base64,AAAAAAAAAAAAAAAAAACAPwAAAAAAAAAAAAAAAAAAgD8AAAAA\"}]}");
    write_text(name, json);
}

/* Returns the lightmap coordinate u of the first corner of a mesh, or -1 without lightmap coordinates. */
static double map_u(const scene_file *file, int number) {
    const float *v = (const float *)file->scene.meshes[number].lightmap_texcoords.data;
    return v ? (double)v[0] : -1;
}

#define PLACE(v) ",\"extras\":{\"lightmapScaleOffset\":" v "}"
#define IN_MAP(v) ",\"extras\":{\"lightmapIndex\":" v "}"

/* The extras of a node give a scale and an offset for the lightmap coordinates of its mesh, u = 1 0 1 and v = 0 0 0.
   They are applied to these coordinates and to nothing else. Invalid values are ignored. */
TEST(places_in_lightmaps) {
    static const float moved[6] = { 0.75f, 0.5f, 0.25f, 0.5f, 0.75f, 0.5f };
    scene_file *file;
    int i;
#ifndef SBL_RENDER_CJSON
    SKIP("places need cJSON");
#endif
    write_places("places.gltf", ",\"TEXCOORD_0\":1,\"TEXCOORD_1\":2", ",\"name\":\"a (b)\"" PLACE("[0.5,2,0.25,0.5]")
                 "|,\"name\":\"c\"|" PLACE("[1,1,0.125,0]") "|" PLACE("[0.5,2,0.25]") "|" PLACE("[1e30,1,0,0]") "|"
                 PLACE("[1,1,0,0,0]") "|" PLACE("7"));
    file = read_back("places.gltf", 0);
    REQUIRE(file && file->scene.mesh_count == 7, "%s", error);
    CHECK(is_near((const float *)file->scene.meshes[0].lightmap_texcoords.data, moved, 6), "u = %g", map_u(file, 0));
    for (i = 1; i < 7; i++)
        CHECK(fabs(map_u(file, i) - (i == 2 ? 1.125 : 1)) < 1e-6, "node %d: u = %g", i, map_u(file, i));
    for (i = 0; i < 7; i++)
        CHECK(file->scene.meshes[i].texcoords.data == file->scene.meshes[0].texcoords.data &&
              !strstr(file->names[i], "map"), "node %d is %s", i, file->names[i]);
    CHECK(strcmp(file->names[0], "a (b)") == 0 && strcmp(file->names[1], "c") == 0, "%s, %s", file->names[0],
          file->names[1]);
    CHECK(file->warning_count == 4 && strstr(file->warnings[3], "node 6: its place in the lightmap"), "%d: %s",
          file->warning_count, file->warnings[0]);
    CHECK(file->map_count == 1, "%d maps", file->map_count);
    scene_file_free(file);
}

/* Each mesh has the map that its node names, and scene_file_keep_map removes the lightmap coordinates of all other
   maps. TEXCOORD_1 is used without TEXCOORD_0, and the order of the attributes does not matter. Later sets are only
   used if all sets before them exist. */
TEST(sets_and_maps) {
    static const char *const sets[] = { ",\"TEXCOORD_1\":2", ",\"TEXCOORD_1\":2,\"TEXCOORD_0\":1",
        ",\"TEXCOORD_0\":1,\"TEXCOORD_2\":2", ",\"TEXCOORD_0\":1,\"TEXCOORD_1\":2,\"TEXCOORD_3\":1" };
    scene_file *file;
    int i;
#ifndef SBL_RENDER_CJSON
    SKIP("maps need cJSON");
#endif
    for (i = 0; i < 4; i++) {
        write_places("sets.gltf", sets[i], IN_MAP("0") "|" IN_MAP("2") "|" IN_MAP("-1"));
        file = scene_file_load(in_folder("sets.gltf"), NULL, error, sizeof error);
        REQUIRE(file && file->scene.mesh_count == 3, "%s", error);
        CHECK(file->map_count == (i == 2 ? 0 : 3) && file->scene.meshes[0].texcoords.data && file->warning_count == 1,
              "%s: %d maps, %d warnings", sets[i], file->map_count, file->warning_count);
        CHECK(file->maps[0] == (i == 2 ? -1 : 0) && file->maps[1] == (i == 2 ? -1 : 2) && file->maps[2] == file->maps[0]
              && file->places[0].node == 0 && file->places[1].node == 1 && file->places[2].node == -1,
              "%s: maps %d %d %d", sets[i], file->maps[0], file->maps[1], file->maps[2]);
        scene_file_keep_map(file, 2);
        CHECK(map_u(file, 0) < 0 && map_u(file, 2) < 0 && (map_u(file, 1) > 0.5) == (i != 2) && file->map_count == 1 &&
              file->maps[0] == -1 && file->maps[1] == (i == 2 ? -1 : 0), "%s: u = %g %g %g", sets[i], map_u(file, 0),
              map_u(file, 1), map_u(file, 2));
        scene_file_free(file);
    }
}

/* A scene that gltf_file.h writes keeps its matte materials if its only other material is a pane. */
TEST(written_panes_are_read_again) {
    scene_file *file, *again;
    int i;
#ifndef SBL_RENDER_CJSON
    SKIP("without cJSON, only assimp's values are known");
#endif
    write_materials("panes.gltf", FACTORS("0", "1") ",\"extensions\":{\"KHR_materials_transmission\":"
                    "{\"transmissionFactor\":0.75},\"KHR_materials_specular\":{\"specularFactor\":0}}|"
                    EXTENSION("unlit", ""));
    file = read_back("panes.gltf", 0);
    REQUIRE(file, "%s", error);
    file->scene.material_count = 2;  /* removes the default material of assimp, which is unused and metallic */
    write_scene(file, "again.gltf");
    scene_file_free(file);
    again = read_back("again.gltf", 0);
    REQUIRE(again && again->scene.mesh_count == 2, "%s", error);
    for (i = 0; i < 2; i++)
        CHECK(is_gloss(material_of(again, i), &matte) &&
              fabs((double)material_of(again, i)->transmission - 0.75 * i) < 1e-6,
              "triangle %d: ior %g, transmission %g", i, (double)material_of(again, i)->ior,
              (double)material_of(again, i)->transmission);
    scene_file_free(again);
}

/* >>normal maps */

#define NORMAL(values) "\"normalTexture\":{" values "}"
#define BASE(index) MODEL("\"baseColorTexture\":{\"index\":" index "}")

/* Checks the normal map of a triangle. scale: its factor; 0: there must be no normal map */
static void check_normals(const scene_file *file, int number, const char *what, double scale) {
    const sbl_material *m = material_of(file, number);
    CHECK((m->normal_texture != 0) == (fabs(scale) > 0) && fabs((double)m->normal_scale - scale) < 1e-6,
          "%s: triangle %d: texture of normals %d, factor %g; expected the factor %g", what, number, m->normal_texture,
          (double)m->normal_scale, scale);
}

/* Normal maps and their factors are those of the .gltf file. They do not make a matte scene one that is not matte. A
   material gets no normal map if its picture is missing or grey, if the factor is 0, or if it is unlit. options.matte
   removes all normal maps. */
TEST(normals_of_gltf) {
    static const unsigned char texels[6] = { 10, 128, 250, 200, 64, 3 }, grey[6] = { 7, 7, 7, 7, 8, 7 };
    static const char materials[] = NORMAL("\"index\":0") "," BASE("0") "|" NORMAL("\"index\":0,\"scale\":0.25") "|"
        NORMAL("\"index\":1,\"scale\":-2") "|" NORMAL("\"index\":2") ",\"name\":\"torn\"|"
        NORMAL("\"index\":0,\"scale\":0") "|" NORMAL("\"index\":0") "," EXTENSION("unlit", "") "|"
        NORMAL("\"index\":0,\"scale\":1e9") ",\"name\":\"steep\"|" BASE("0");
    static const double scales[8] = { 1, 0.25, -2, 0, 0, 0, 1000, 0 };
    scene_file *file, *plain;
    const sbl_material *m[8];
    int i;
    stbi_write_png(in_folder("two.png"), 2, 1, 3, texels, 6);
    write_materials("normals.gltf", materials);
    file = read_back("normals.gltf", 0);
    plain = read_back("normals.gltf", 1);
    REQUIRE(file && plain && file->scene.mesh_count == 8 && plain->scene.mesh_count == 8, "%s", error);
    for (i = 0; i < 8; i++) {
        m[i] = material_of(file, 7 - i);
        check_normals(file, 7 - i, "as in the file", scales[i]);
        check_normals(plain, 7 - i, "matte", 0);
        CHECK(is_gloss(m[i], &matte), "triangle %d: normal maps made a file glossy", 7 - i);
    }
    CHECK(file->warning_count == 2 && strstr(file->warnings[1], "absent.png") && strstr(file->warnings[0],
          "material steep: the factor of its normal map is outside"), "%d: %s; %s", file->warning_count,
          file->warnings[0], file->warnings[1]);
    CHECK(!file->simplified[SCENE_FILE_NORMAL_MAP] && plain->simplified[SCENE_FILE_NORMAL_MAP] == 6, "%d, %d ignored",
          file->simplified[SCENE_FILE_NORMAL_MAP], plain->simplified[SCENE_FILE_NORMAL_MAP]);
    CHECK(file->scene.texture_count == 3 && m[0]->normal_texture == m[1]->normal_texture && m[0]->albedo_texture &&
          m[0]->normal_texture != m[0]->albedo_texture && m[0]->normal_texture != m[2]->normal_texture,
          "%d textures: expected colour, normals, and normals that are clamped", file->scene.texture_count);
    for (i = 0; i < 3; i++) {
        const sbl_texture *t = &file->scene.textures[i];
        CHECK(t->format == (i + 1 == m[0]->albedo_texture ? SBL_PIXELS_SRGB8 : SBL_PIXELS_LINEAR8) &&
              t->wrap == (i + 1 == m[2]->normal_texture ? SBL_WRAP_CLAMP : SBL_WRAP_REPEAT) &&
              memcmp(t->pixels, texels, 6) == 0, "texture %d: format %d, wrap %d", i, (int)t->format, (int)t->wrap);
    }
    scene_file_free(plain);
    scene_file_free(file);
    stbi_write_png(in_folder("two.png"), 1, 1, 3, grey, 3);
    file = read_back("normals.gltf", 0);
    REQUIRE(file, "%s", error);
    for (i = 0; i < 8; i++) check_normals(file, i, "grey", 0);
    CHECK(file->warning_count == 3 && strstr(file->warnings[1], "texture two.png is grey, so it is not a normal map"),
          "%d: %s", file->warning_count, file->warnings[1]);
    scene_file_free(file);
    stbi_write_png(in_folder("two.png"), 2, 1, 3, grey, 6);
    file = read_back("normals.gltf", 0);
    REQUIRE(file, "%s", error);
    check_normals(file, 7, "one texel is grey", 1);
    scene_file_free(file);
}

/* A material can have five different textures. A picture that is used for both metalness and normals is one texture. */
TEST(five_textures_per_material) {
    static const unsigned char texels[6] = { 10, 128, 250, 200, 64, 3 };
    enum { COUNT = 5 };  /* more textures fit with fewer materials, because assimp adds one */
    char text[COUNT * 512] = "";
    scene_file *file;
    int i, at[5], k;
    stbi_write_png(in_folder("two.png"), 2, 1, 3, texels, 6);
    for (i = 0; i < COUNT; i++) {
        for (k = 0; k < 5; k++) at[k] = k < 2 ? 2 * i + k : 3 * i + k - 2;
        for (k = 0; k < 5; k++) at[k] += at[k] >= 2;  /* texture 2 is missing */
        sprintf(text + strlen(text), "%s" MODEL("\"baseColorTexture\":{\"index\":%d},\"metallicRoughnessTexture\":"
                "{\"index\":%d}") ",\"emissiveFactor\":[1,1,1],\"emissiveTexture\":{\"index\":%d},"
                NORMAL("\"index\":%d") "," EXTENSION("transmission",
                "\"transmissionFactor\":1,\"transmissionTexture\":{\"index\":%d}"),
                i ? "|" : "", at[0], at[2], at[1], at[3], at[4]);
    }
    write_materials("five.gltf", text);
    file = read_back("five.gltf", 0);
    REQUIRE(file && file->scene.mesh_count == COUNT, "%s", error);
    CHECK(file->scene.texture_count == 5 * COUNT, "%d textures of %d", file->scene.texture_count, 5 * COUNT);
    for (i = 0; i < COUNT; i++) {
        const sbl_material *m = material_of(file, i);
        CHECK(m->albedo_texture && m->emission_texture && m->specular_texture && m->transmission_texture &&
              m->normal_texture, "triangle %d lacks a texture", i);
    }
    scene_file_free(file);
    write_materials("five.gltf", TEXTURED("\"metallicFactor\":1", "0") "," NORMAL("\"index\":0"));
    file = read_back("five.gltf", 0);
    CHECK(file && file->scene.texture_count == 1 && material_of(file, 0)->specular_texture == 1 &&
          material_of(file, 0)->normal_texture == 1, "%d textures", file ? file->scene.texture_count : 0);
    scene_file_free(file);
}

#define TRANSFORM "\"extensions\":{\"KHR_texture_transform\":{\"offset\":[0.25,0.5]}}"

/* Reads a material, and compares the texture coordinates of corner 1 of its triangle, which has TEXCOORD_0 = (0, 1) and
   TEXCOORD_1 = (0, 0). warning: a part of the only warning; NULL: there must be no warning */
static void check_coordinates(const char *material, double u, double v, const char *warning) {
    scene_file *file;
    const float *at;
    write_materials("uv.gltf", material);
    file = read_back("uv.gltf", 0);
    REQUIRE(file, "%s: %s", material, error);
    at = (const float *)file->scene.meshes[0].texcoords.data;
    CHECK(at && fabs((double)at[2] - u) < 1e-6 && fabs((double)at[3] - v) < 1e-6, "%s: coordinates %g %g", material,
          (double)at[2], (double)at[3]);
    check_normals(file, 0, material, 1);
    CHECK(warning ? file->warning_count == 1 && strstr(file->warnings[0], warning) : !file->warning_count, "%s: %s",
          material, file->warnings[0]);
    scene_file_free(file);
}

/* A normal map without other textures uses its own set of texture coordinates and its KHR_texture_transform. With
   another texture in the material, it uses the coordinates of that texture. */
TEST(coordinates_of_normals) {
    static const unsigned char texels[6] = { 10, 128, 250, 200, 64, 3 };
    stbi_write_png(in_folder("two.png"), 2, 1, 3, texels, 6);
    check_coordinates(NORMAL("\"index\":0"), 0, 1, NULL);
    check_coordinates(NORMAL("\"index\":0,\"texCoord\":1"), 0, 0, NULL);
    check_coordinates(NORMAL("\"index\":0," TRANSFORM), 0.25, 1.5, NULL);
    check_coordinates(MODEL("\"baseColorTexture\":{\"index\":0," TRANSFORM "}") "," NORMAL("\"index\":0," TRANSFORM),
                      0.25, 1.5, NULL);
    check_coordinates(BASE("0") "," NORMAL("\"index\":0,\"texCoord\":1") ",\"name\":\"shoe\"", 0, 1,
                      "material shoe: its textures use different texture coordinates; those of its colour are used");
    check_coordinates(BASE("0") "," NORMAL("\"index\":0," TRANSFORM), 0, 1, "different texture coordinates");
    check_coordinates(TEXTURED("\"metallicFactor\":1", "0,\"texCoord\":1") "," NORMAL("\"index\":0"), 0, 0,
                      "those of its metal are used");
}

#define TURNED(more) "\"extensions\":{\"KHR_texture_transform\":{\"rotation\":0.5,\"scale\":[2,3]," \
    "\"offset\":[0.1,0.2]" more "}}"

/* KHR_texture_transform scales, then turns, then moves the texture coordinates; those of lightmaps stay, even if other
   textures have other coordinates. Its texCoord chooses the set. */
TEST(transforms_of_texture_coordinates) {
    static const unsigned char texels[6] = { 10, 128, 250, 200, 64, 3 };
    static const struct { const char *material; float from[6]; int warnings; } cases[] = {
        { MODEL("\"baseColorTexture\":{\"index\":0," TURNED("") "}"), { 0, 0, 0, 1, 0, 0 }, 0 },
        { MODEL("\"baseColorTexture\":{\"index\":0,\"texCoord\":1," TURNED("") "}"), { 1, 0, 0, 0, 1, 0 }, 0 },
        { MODEL("\"baseColorTexture\":{\"index\":0," TURNED(",\"texCoord\":1") "}"), { 1, 0, 0, 0, 1, 0 }, 0 },
        { MODEL("\"baseColorTexture\":{\"index\":0," TURNED("") "}") ",\"emissiveFactor\":[1,1,1],"
          "\"emissiveTexture\":{\"index\":0,\"texCoord\":1}", { 0, 0, 0, 1, 0, 0 }, 1 },
        { MODEL("\"metallicFactor\":0") "," EXTENSION("transmission", "\"transmissionFactor\":1,"
          "\"transmissionTexture\":{\"index\":0," TURNED("") "}"), { 0, 0, 0, 1, 0, 0 }, 0 } };
    static const float lightmap[6] = { 1, 0, 0, 0, 1, 0 };
    const double c = cos(0.5), s = sin(0.5);
    size_t i;
    int k;
#ifndef SBL_RENDER_CJSON
    SKIP("transforms need cJSON");
#endif
    stbi_write_png(in_folder("two.png"), 2, 1, 3, texels, 6);
    for (i = 0; i < sizeof cases / sizeof *cases; i++) {
        float expected[6];
        scene_file *file;
        write_materials("turned.gltf", cases[i].material);
        file = read_back("turned.gltf", 0);
        REQUIRE(file, "case %d: %s", (int)i, error);
        for (k = 0; k < 6; k += 2) {
            const double u = 2 * (double)cases[i].from[k], v = 3 * (double)cases[i].from[k + 1];
            expected[k] = (float)(c * u + s * v + 0.1);
            expected[k + 1] = (float)(c * v - s * u + 0.2);
        }
        CHECK(is_near((const float *)file->scene.meshes[0].texcoords.data, expected, 6), "case %d: wrong coordinates",
              (int)i);
        CHECK(is_near((const float *)file->scene.meshes[0].lightmap_texcoords.data, lightmap, 6),
              "case %d: the coordinates in the lightmap changed", (int)i);
        CHECK(file->warning_count == cases[i].warnings, "case %d: %d warnings", (int)i, file->warning_count);
        scene_file_free(file);
    }
}

/* A texture that is mirrored, or clamped along one axis, is repeated. This is counted only if coordinates leave the
   range 0 to 1 along that axis. */
TEST(repeated_textures_are_counted) {
    static const unsigned char texels[6] = { 10, 128, 250, 200, 64, 3 };
    static const struct { int wraps[2], axis; double scale; int counted; } cases[] = {
        { { 33648, 10497 }, 0, 1, 0 }, { { 33648, 10497 }, 0, 2, 1 }, { { 33648, 10497 }, 1, 2, 0 },
        { { 10497, 33071 }, 1, 2, 1 }, { { 33071, 33071 }, 0, 2, 0 }, { { 10497, 10497 }, 0, 2, 0 } };
    char text[2048];
    size_t i;
#ifndef SBL_RENDER_CJSON
    SKIP("transforms need cJSON");
#endif
    stbi_write_png(in_folder("two.png"), 2, 1, 3, texels, 6);
    for (i = 0; i < sizeof cases / sizeof *cases; i++) {
        scene_file *file;
        snprintf(text, sizeof text, "{\"asset\":{\"version\":\"2.0\"},\"images\":[{\"uri\":\"two.png\"}],"
                 "\"samplers\":[{\"wrapS\":%d,\"wrapT\":%d}],\"textures\":[{\"source\":0,\"sampler\":0}],"
                 "\"materials\":[{\"pbrMetallicRoughness\":{\"baseColorTexture\":{\"index\":0,\"extensions\":"
                 "{\"KHR_texture_transform\":{\"scale\":[%g,%g]}}}}}],\"meshes\":[{\"primitives\":[{\"attributes\":"
                 "{\"POSITION\":0,\"TEXCOORD_0\":1},\"material\":0}]}],\"nodes\":[{\"mesh\":0}],"
                 "\"scenes\":[{\"nodes\":[0]}],\"scene\":0,\"accessors\":[{\"bufferView\":0,"
                 "\"componentType\":5126,\"count\":3,\"type\":\"VEC3\"},{\"bufferView\":0,\"byteOffset\":%d,"
                 "\"componentType\":5126,\"count\":3,\"type\":\"VEC2\"}],\"bufferViews\":[{\"buffer\":0,"
                 "\"byteLength\":36}],\"buffers\":[{\"byteLength\":36,\"uri\":\"data:application/octet-stream;"
                 "base64,AAAAAAAAAAAAAAAAAACAPwAAAAAAAAAAAAAAAAAAgD8AAAAA\"}]}", cases[i].wraps[0],
                 cases[i].wraps[1], cases[i].scale, cases[i].scale, cases[i].axis ? 0 : 4);
        write_text("wraps.gltf", text);
        file = read_back("wraps.gltf", 0);
        REQUIRE(file, "case %d: %s", (int)i, error);
        CHECK(file->simplified[SCENE_FILE_WRAP] == cases[i].counted && !file->warning_count, "case %d: %d are counted",
              (int)i, file->simplified[SCENE_FILE_WRAP]);
        scene_file_free(file);
    }
}

/* ---- vertices of integers ---- */

/* Positions of shorts, normals of signed bytes, and texture coordinates of unsigned shorts and bytes, three of each. */
static const unsigned char integers[18 + 2 + 12 + 12 + 12] = {
    0, 0, 0, 0, 0, 0,  100, 0, 0, 0, 0, 0,  0, 0, 0x9c, 0xff, 0, 0,  0, 0,  /* the last position is 0 -100 0 */
    0, 0, 127, 0,  0, 0x80, 0, 0,  127, 0, 0, 0,                            /* the second normal is 0 -1 0 */
    0, 0, 0xff, 0xff,  0xff, 0xff, 0, 0,  0x33, 0x33, 0, 0,
    0, 255, 9, 9,  255, 0, 9, 9,  51, 0, 9, 9
};

/* Returns the JSON of a triangle of integers. buffer: further members of its buffer; more: those of its positions */
static const char *of_integers(const char *buffer, const char *more) {
    static char text[2048];
    snprintf(text, sizeof text, "{\"asset\":{\"version\":\"2.0\"},\"extensionsRequired\":[\"KHR_mesh_quantization\"],"
             "\"meshes\":[{\"primitives\":[{\"attributes\":{\"POSITION\":0,\"NORMAL\":1,\"TEXCOORD_0\":2,"
             "\"TEXCOORD_1\":3}}]}],\"nodes\":[{\"mesh\":0}],\"scenes\":[{\"nodes\":[0]}],\"scene\":0,"
             "\"accessors\":[{\"bufferView\":0,\"componentType\":5122,\"count\":3,\"type\":\"VEC3\"%s},"
             "{\"bufferView\":1,\"componentType\":5120,\"normalized\":true,\"count\":3,\"type\":\"VEC3\"},"
             "{\"bufferView\":1,\"byteOffset\":12,\"componentType\":5123,\"normalized\":true,\"count\":3,"
             "\"type\":\"VEC2\"},{\"bufferView\":1,\"byteOffset\":24,\"componentType\":5121,\"normalized\":true,"
             "\"count\":3,\"type\":\"VEC2\"}],\"bufferViews\":[{\"buffer\":0,\"byteLength\":18},{\"buffer\":0,"
             "\"byteOffset\":20,\"byteLength\":36,\"byteStride\":4}],\"buffers\":[{\"byteLength\":56%s}]}", more,
             buffer);
    return text;
}

/* Writes a .glb. text: its JSON; bytes, count: its buffer */
static void write_glb(const char *name, const char *text, const void *bytes, size_t count) {
    FILE *out = fopen(in_folder(name), "wb");
    const size_t padded = (strlen(text) + 3) & ~(size_t)3;
    if (!out) return;
    fwrite("glTF\2\0\0\0", 1, 8, out);
    gltf__put_word(out, (uint32_t)(12 + 8 + padded + 8 + count));
    gltf__put_word(out, (uint32_t)padded);
    fprintf(out, "JSON%-*s", (int)padded, text);
    gltf__put_word(out, (uint32_t)count);
    fwrite("BIN\0", 1, 4, out);
    fwrite(bytes, 1, count, out);
    fclose(out);
}

/* Vertices that a file stores as integers become floats. The integers are in a .glb, in a file whose name has a blank,
   or in base64. A file whose integers cannot be read is refused. */
TEST(integers_become_floats) {
    static const char *const names[] = { "integers.glb", "integers.gltf", "base64.gltf" };
    static const float positions[9] = { 0, 0, 0, 100, 0, 0, 0, -100, 0 }, normals[9] = { 0, 0, 1, 0, -1, 0, 1, 0, 0 };
    static const float texcoords[6] = { 0, 1, 1, 0, 0.2f, 0 };
    FILE *out = fopen(in_folder("a b%.bin"), "wb");
    size_t i;
#ifndef SBL_RENDER_CJSON
    SKIP("integers need cJSON");
#endif
    REQUIRE(out && fwrite(integers, 1, sizeof integers, out) == sizeof integers && fclose(out) == 0, "no file");
    write_glb("integers.glb", of_integers("", ""), integers, sizeof integers);
    write_text("integers.gltf", of_integers(",\"uri\":\"a%20b%25.bin\"", ""));
    write_text("base64.gltf", of_integers(",\"uri\":\"data:;base64,AAAAAAAAZAAAAAAAAACc/wAAAAAAAH8AAIAAAH8AAAAAAP////8A"
                                          "ADMzAAAA/wkJ/wAJCTMACQk=\"", ""));
    for (i = 0; i < 3; i++) {
        scene_file *file = read_back(names[i], 0);
        const sbl_mesh *m = file ? &file->scene.meshes[0] : NULL;
        REQUIRE(m && m->vertex_count == 3, "%s: %s", names[i], error);
        CHECK(is_near((const float *)m->positions.data, positions, 9), "%s: wrong positions", names[i]);
        CHECK(is_near((const float *)m->normals.data, normals, 9), "%s: wrong normals", names[i]);
        CHECK(is_near((const float *)m->texcoords.data, texcoords, 6) &&
              is_near((const float *)m->lightmap_texcoords.data, texcoords, 6), "%s: wrong coordinates", names[i]);
        scene_file_free(file);
    }
    write_text("integers.gltf", of_integers(",\"uri\":\"a%20b%25.bin\"", ",\"byteOffset\":1"));
    CHECK(!read_back("integers.gltf", 0) && strstr(error, "vertices as integers"), "%s", error);
    write_text("integers.gltf", of_integers(",\"uri\":\"absent.bin\"", ""));
    CHECK(!read_back("integers.gltf", 0) && strstr(error, "vertices as integers"), "%s", error);
}

/* The name of a buffer is a URI. A file that has the name as it is written counts first. */
TEST(names_of_buffers) {
    static const float corners[2][9] = { { 0, 0, 0, 1, 0, 0, 0, 1, 0 }, { 0, 0, 0, 2, 0, 0, 0, 1, 0 } };
    static const char *const names[2] = { "c d.bin", "c%20d.bin" };
    int i;
    write_text("uri.gltf", "{\"asset\":{\"version\":\"2.0\"},\"meshes\":[{\"primitives\":[{\"attributes\":"
               "{\"POSITION\":0}}]}],\"nodes\":[{\"mesh\":0}],\"scenes\":[{\"nodes\":[0]}],\"scene\":0,\"accessors\":"
               "[{\"bufferView\":0,\"componentType\":5126,\"count\":3,\"type\":\"VEC3\"}],\"bufferViews\":"
               "[{\"buffer\":0,\"byteLength\":36}],\"buffers\":[{\"byteLength\":36,\"uri\":\"c%20d.bin\"}]}");
    for (i = 0; i < 2; i++) {
        FILE *out = fopen(in_folder(names[i]), "wb");
        scene_file *file;
        REQUIRE(out && fwrite(corners[i], 1, 36, out) == 36 && fclose(out) == 0, "no file");
        file = read_back("uri.gltf", 0);
        REQUIRE(file, "%s: %s", names[i], error);
        CHECK(is_near((const float *)file->scene.meshes[0].positions.data, corners[i], 9), "%s: other positions",
              names[i]);
        scene_file_free(file);
    }
}

/* The reader gives the rotations of nodes length 1, so that they do not scale the nodes. It warns only of rotations
   whose length differs much from 1. The new JSON of the .glb is longer than the whole file was, but the reader still
   finds the buffer. */
TEST(rotations_do_not_scale) {
    static const float corners[9] = { 0, 0, 0, 1, 0, 0, 0, 1, 0 };
    static const struct { const char *rotation; float x[3]; } nodes[] = {
        { "0,0,1,1", { 0, 1, 0 } }, { "0,0,0.70711,0.70711", { 0, 1, 0 } }, { "0,-0.5,0,0", { -1, 0, 0 } },
        { "0,0,0,0", { 1, 0, 0 } }, { "0,0,1e200,1e200", { 0, 1, 0 } } };
    enum { COUNT = 5 };
    char text[2048], *at = text;
    scene_file *file;
    int i, k;
#ifndef SBL_RENDER_CJSON
    SKIP("lengths of rotations need cJSON");
#endif
    at += sprintf(at, "{\"asset\":{\"version\":\"2.0\"},\"meshes\":[{\"primitives\":[{\"attributes\":"
                  "{\"POSITION\":0}}]}],\"scenes\":[{\"nodes\":[0,1,2,3,4]}],\"scene\":0,\"accessors\":["
                  "{\"bufferView\":0,\"componentType\":5126,\"count\":3,\"type\":\"VEC3\"}],"
                  "\"bufferViews\":[{\"buffer\":0,\"byteLength\":36}],"
                  "\"buffers\":[{\"byteLength\":36}],\"nodes\":[");
    for (i = 0; i < COUNT; i++)
        at += sprintf(at, "%s{\"name\":\"n%d\",\"mesh\":0,\"rotation\":[%s]}", i ? "," : "", i, nodes[i].rotation);
    strcpy(at, "]}");
    write_glb("turned.glb", text, corners, sizeof corners);
    file = read_back("turned.glb", 0);
    REQUIRE(file && file->scene.mesh_count == COUNT, "%s", error);
    for (i = 0; i < COUNT; i++) {
        const float *m = file->scene.meshes[i].transform;
        CHECK(is_near(m, nodes[i].x, 3), "%s: x becomes %g %g %g", nodes[i].rotation, (double)m[0], (double)m[1],
              (double)m[2]);
        for (k = 0; k < 12; k += 4)
            CHECK(fabs(sqrt((double)m[k] * m[k] + (double)m[k + 1] * m[k + 1] + (double)m[k + 2] * m[k + 2]) - 1) <
                  1e-6, "%s: axis %d is scaled", nodes[i].rotation, k / 4);
    }
    CHECK(file->warning_count == 1 && strstr(file->warnings[0], "4 rotations are not of length 1") &&
          strstr(file->warnings[0], "n0 (node 0)"), "%d warnings: %s", file->warning_count, file->warnings[0]);
    scene_file_free(file);
}

/* ---- OBJ ---- */

/* Writes plain.obj: a triangle for each of the materials m0, m1, ... mtl: its .mtl file; start: the first bytes of both
   files */
static scene_file *read_obj(const char *start, const char *mtl, int count) {
    char text[1024];
    int n, i;
    snprintf(text, sizeof text, "%s%s", start, mtl);
    write_text("plain.mtl", text);
    n = sprintf(text, "%smtllib plain.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\n", start);
    for (i = 0; i < count; i++) n += sprintf(text + n, "usemtl m%d\nf 1/1 2/1 3/1\n", i);
    write_text("plain.obj", text);
    return read_back("plain.obj", 0);
}

/* Surfaces that are left out because they are transparent are counted. If nothing else is left, the message says so. */
TEST(transparent_surfaces_are_counted) {
    scene_file *file = read_obj("", "newmtl m0\nd 0.3\nnewmtl m1\nd 0\nnewmtl m2\nKd 1 1 1\n", 3);
    REQUIRE(file, "%s", error);
    CHECK(file->scene.mesh_count == 1 && file->simplified[SCENE_FILE_GONE] == 2, "%d meshes, %d left out",
          file->scene.mesh_count, file->simplified[SCENE_FILE_GONE]);
    scene_file_free(file);
    CHECK(!read_obj("", "newmtl m0\nTr 0.8\n", 1) && strstr(error, "all its surfaces are transparent"), "%s", error);
    write_materials("gone.gltf", MODEL("\"baseColorFactor\":[1,1,1,0]") ",\"alphaMode\":\"BLEND\"|"
                    MODEL("\"baseColorFactor\":[1,1,1,0.2]") ",\"alphaMode\":\"BLEND\"|" MODEL(""));
    file = read_back("gone.gltf", 0);
    REQUIRE(file, "%s", error);
    CHECK(file->scene.mesh_count == 1 && file->simplified[SCENE_FILE_GONE] == 1, "%d meshes, %d left out",
          file->scene.mesh_count, file->simplified[SCENE_FILE_GONE]);
    scene_file_free(file);
}

/* A byte order mark is no part of the first line of an .obj or .mtl file, whose lines before the first material are
   ignored. An OBJ file without materials has the colours
   of its vertices. */
TEST(oddities_of_obj) {
    static const float points[9] = { -0.5f, 0.25f, 0, 0.5f, -0.25f, 0, 0.5f, 0.75f, -0.125f };
    scene_file *file = read_obj("\xef\xbb\xbf", "map_Kd two.png\nnewmtl m0\nKd 1 0.5 0\n", 1);
    REQUIRE(file, "%s", error);
    CHECK(fabs((double)material_of(file, 0)->albedo[0] - 1) < 1e-6, "red is %g",
          (double)material_of(file, 0)->albedo[0]);
    scene_file_free(file);
    write_text("plain.obj", "v 0 0 0 1 0 0\nv 1 0 0 1 0 0\nv 0 1 0 1 0 0\nf 1 2 3\n");
    file = read_back("plain.obj", 0);
    REQUIRE(file && file->scene.meshes[0].colors.data, "%s", error);
    CHECK(fabs((double)material_of(file, 0)->albedo[0] - 1) < 1e-6, "the factor is %g",
          (double)material_of(file, 0)->albedo[0]);
    scene_file_free(file);
    write_text("plain.obj", "v -.5 .25 0\nv +.5 -.25 0\nv\t.5 .75 -.125\nf 1 2 3\n");
    file = read_back("plain.obj", 0);
    REQUIRE(file && file->scene.meshes[0].vertex_count == 3, "%s", error);
    CHECK(is_near((const float *)file->scene.meshes[0].positions.data, points, 9), "numbers without a zero are wrong");
    scene_file_free(file);
}

/* The options -s and -o scale and move texture coordinates, also with fewer than three numbers. Other options do not
   hide the name of the texture. A texture without Kd keeps its colours. */
TEST(options_of_obj_textures) {
    static const unsigned char texels[6] = { 10, 128, 250, 200, 64, 3 };
    static const struct { const char *mtl; float kd, uv[2]; const char *warning; } cases[] = {
        { "map_Kd two.png", 1, { 0, 1 }, NULL },
        { "Kd .5 .5 .5\nmap_Kd -s 1 1 1 -o 0 0 0 two.png", 0.5f, { 0, 1 }, NULL },
        { "map_Kd -s 2 4 1 -o 0.25 0.5 0 two.png\nKd 1 1 1", 1, { 0.25f, 0.5f }, NULL },
        { "map_Kd -o 0.25 -s 2 4 two.png", 1, { 0.25f, 1 }, NULL },
        { "\tmap_Kd -clamp on -cc on two.png", 1, { 0, 1 }, NULL },
        { "map_Kd -mm 0 1 two.png\nnewmtl m1\nKd 1 1 1", 1, { 0, 1 }, NULL },
        { "map_Kd -mm 0 2 two.png", 1, { 0, 1 }, "-mm is ignored" },
        { "map_Kd two.png\nmap_d -o .5 .5 two.png", 1, { 0, 1 }, "those of its colour are used for all" },
        { "map_Kd two.png\nKe 1 1 1\nmap_Ke -o .5 .5 two.png", 1, { 0, 1 },
          "those of its colour are used for all" } };
    char mtl[256];
    size_t i;
    stbi_write_png(in_folder("two.png"), 2, 1, 3, texels, 6);
    for (i = 0; i < sizeof cases / sizeof *cases; i++) {
        scene_file *file;
        snprintf(mtl, sizeof mtl, "newmtl m0\n%s\n", cases[i].mtl);
        file = read_obj("", mtl, 1);
        REQUIRE(file, "case %d: %s", (int)i, error);
        CHECK(material_of(file, 0)->albedo_texture && is_near(material_of(file, 0)->albedo, &cases[i].kd, 1),
              "case %d: no texture, or another factor", (int)i);
        CHECK(is_near((const float *)file->scene.meshes[0].texcoords.data, cases[i].uv, 2), "case %d: %g %g", (int)i,
              (double)((const float *)file->scene.meshes[0].texcoords.data)[0],
              (double)((const float *)file->scene.meshes[0].texcoords.data)[1]);
        CHECK(file->warning_count == (cases[i].warning != NULL) &&
              (!cases[i].warning || strstr(file->warnings[0], cases[i].warning)), "case %d: %s", (int)i,
              file->warnings[0]);
        scene_file_free(file);
    }
}

/* Materials that no .mtl file defines are named, also without any .mtl file. */
TEST(undefined_materials_of_obj) {
    scene_file *file = read_obj("", "newmtl m0 \nKd 1 1 1\n", 3);
    REQUIRE(file, "%s", error);
    CHECK(file->warning_count == 1 && strstr(file->warnings[0], "defines 2 of the materials, such as m1"), "%s",
          file->warnings[0]);
    scene_file_free(file);
    write_text("plain.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl wood\nf 1 2 3\n");
    file = read_back("plain.obj", 0);
    REQUIRE(file, "%s", error);
    CHECK(file->warning_count == 1 && strstr(file->warnings[0], "no .mtl file defines the material wood"), "%s",
          file->warnings[0]);
    scene_file_free(file);
}

/* ---- Collada and FBX ---- */

/* Reads a .dae with a triangle. cameras: its library of cameras; node: a further node. Both may be empty texts. */
static scene_file *read_collada(const char *cameras, const char *node) {
    static char text[4096];
    snprintf(text, sizeof text, "<?xml version=\"1.0\"?><COLLADA "
             "xmlns=\"http://www.collada.org/2005/11/COLLADASchema\" version=\"1.4.1\"><asset><unit meter=\"1\"/>"
             "<up_axis>Y_UP</up_axis></asset>%s<library_effects><effect "
             "id=\"e\"><profile_COMMON><technique sid=\"t\"><lambert><emission><color>1 1 1 1</color></emission>"
             "</lambert></technique></profile_COMMON></effect></library_effects><library_materials><material "
             "id=\"a\"><instance_effect url=\"#e\"/></material></library_materials><library_geometries><geometry "
             "id=\"g\"><mesh><source id=\"p\"><float_array id=\"f\" count=\"9\">0 0 0 1 0 0 0 1 0</float_array>"
             "<technique_common><accessor source=\"#f\" count=\"3\" stride=\"3\"><param name=\"X\" type=\"float\"/>"
             "<param name=\"Y\" type=\"float\"/><param name=\"Z\" type=\"float\"/></accessor></technique_common>"
             "</source><vertices id=\"v\"><input semantic=\"POSITION\" source=\"#p\"/></vertices><triangles "
             "count=\"1\"><input semantic=\"VERTEX\" source=\"#v\" offset=\"0\"/><p>0 1 2</p></triangles></mesh>"
             "</geometry></library_geometries><library_visual_scenes><visual_scene id=\"s\"><node id=\"n\">"
             "<instance_geometry url=\"#g\"/></node>%s</visual_scene></library_visual_scenes><scene>"
             "<instance_visual_scene url=\"#s\"/></scene></COLLADA>", cameras, node);
    write_text("collada.dae", text);
    return read_back("collada.dae", 0);
}

/* In Collada, a surface without a material is grey, although assimp gives it the first material of the file. */
TEST(collada_without_material) {
    static const float grey = 0.6f;
    scene_file *file = read_collada("", "");
    REQUIRE(file, "%s", error);
    CHECK(is_near(material_of(file, 0)->albedo, &grey, 1) && !(material_of(file, 0)->emission[0] > 0),
          "albedo %g, emission %g", (double)material_of(file, 0)->albedo[0],
          (double)material_of(file, 0)->emission[0]);
    scene_file_free(file);
}

/* A camera of Collada has two of three: the horizontal and the vertical field of view, and the aspect ratio. If both
   the horizontal one and the aspect ratio are known, the picture shows the vertical one. */
TEST(cameras_of_collada) {
    static const struct { const char *lens; double fov_x, fov_y; } lenses[] = {
        { "<xfov>90</xfov><aspect_ratio>2</aspect_ratio>", 0, 53.1301 },
        { "<yfov>60</yfov><aspect_ratio>1.5</aspect_ratio>", 0, 60 },
        { "<xfov>90</xfov>", 90, 0 } };
    char cameras[512];
    size_t i;
    for (i = 0; i < sizeof lenses / sizeof *lenses; i++) {
        scene_file *file;
        snprintf(cameras, sizeof cameras, "<library_cameras><camera id=\"c\" name=\"c\"><optics>"
                 "<technique_common><perspective>%s<znear>0.1</znear><zfar>9</zfar></perspective></technique_common>"
                 "</optics></camera></library_cameras>", lenses[i].lens);
        file = read_collada(cameras, "<node id=\"m\"><translate>1 2 3</translate><instance_camera url=\"#c\"/>"
                            "</node>");
        REQUIRE(file && file->has_camera, "%s", error);
        CHECK(fabs((double)file->camera.fov_x - lenses[i].fov_x) < 1e-3 &&
              fabs((double)file->camera.fov_y - lenses[i].fov_y) < 1e-3, "%s: fields of view %g and %g", lenses[i].lens,
              (double)file->camera.fov_x, (double)file->camera.fov_y);
        CHECK(fabs((double)file->camera.eye[0] - 1) + fabs((double)file->camera.eye[2] - 3) < 1e-5 &&
              file->camera.forward[2] < -0.99f, "%s: the camera is at %g, %g, %g", lenses[i].lens,
              (double)file->camera.eye[0], (double)file->camera.eye[1], (double)file->camera.eye[2]);
        scene_file_free(file);
    }
}

/* Lengths of FBX files become metres. */
TEST(units_of_fbx) {
    static const struct { const char *unit; double metres; } cases[] = {
        { "1", 0.01 }, { "2.54", 0.0254 }, { "100", 1 } };
    char text[1024];
    size_t i;
    for (i = 0; i < sizeof cases / sizeof *cases; i++) {
        scene_file *file;
        snprintf(text, sizeof text, "; FBX 7.3.0 project file\nFBXHeaderExtension: {\nFBXVersion: 7300\n}\n"
                 "GlobalSettings: {\nVersion: 1000\nProperties70: {\nP: \"UnitScaleFactor\", \"double\", \"Number\", "
                 "\"\",%s\n}\n}\nObjects: {\nGeometry: 1, \"Geometry::g\", \"Mesh\" {\nVertices: *9 {\na: "
                 "0,0,0,1,0,0,0,1,0\n}\nPolygonVertexIndex: *3 {\na: 0,1,-3\n}\nGeometryVersion: 124\n}\nModel: 2, "
                 "\"Model::m\", \"Mesh\" {\nVersion: 232\nProperties70: {\n}\n}\n}\nConnections: {\nC: \"OO\",2,0\n"
                 "C: \"OO\",1,2\n}\n", cases[i].unit);
        write_text("unit.fbx", text);
        file = read_back("unit.fbx", 0);
        REQUIRE(file, "%s", error);
        CHECK(fabs((double)file->scene.meshes[0].transform[0] / cases[i].metres - 1) < 1e-5 &&
              fabs(file->unit / cases[i].metres - 1) < 1e-5, "unit %s: %g", cases[i].unit,
              (double)file->scene.meshes[0].transform[0]);
        scene_file_free(file);
    }
}

/* ---- incomplete glTF ---- */

/* Writes a triangle with a texture, and nodes for two cameras. more: further members of the file; attributes: those of
   the triangle after its positions; texture: the texture; count_of_colors: 3 or 4 */
static scene_file *read_triangle(const char *more, const char *attributes, const char *texture, int count_of_colors) {
    char text[2048];
    snprintf(text, sizeof text, "{\"asset\":{\"version\":\"2.0\"},%s\"images\":[{\"uri\":\"two.png\"}],\"textures\":"
             "[{%s}],\"materials\":[{\"pbrMetallicRoughness\":{\"baseColorTexture\":{\"index\":0},"
             "\"metallicFactor\":0}}],\"meshes\":[{\"primitives\":[{\"attributes\":{\"POSITION\":0%s},"
             "\"material\":0}]}],\"nodes\":[{\"mesh\":0},{\"camera\":0},{\"camera\":1}],\"scenes\":"
             "[{\"nodes\":[0,1,2]}],\"scene\":0,"
             "\"accessors\":[{\"bufferView\":0,\"componentType\":5126,\"count\":3,\"type\":\"VEC3\"},{\"bufferView\":0,"
             "\"componentType\":5126,\"count\":3,\"type\":\"VEC2\"},{\"bufferView\":%d,\"componentType\":5126,"
             "\"count\":3,\"type\":\"VEC%d\"}],\"bufferViews\":[{\"buffer\":0,\"byteLength\":36},{\"buffer\":1,"
             "\"byteLength\":48}],\"buffers\":[{\"byteLength\":36,\"uri\":\"data:application/octet-stream;base64,"
             "AAAAAAAAAAAAAAAAAACAPwAAAAAAAAAAAAAAAAAAgD8AAAAA\"},{\"byteLength\":48,\"uri\":\"data:application/"
             "octet-stream;base64,AACAPwAAgD8AAIA/AAAAPwAAgD8AAIA/AACAPwAAAD8AAIA/AACAPwAAgD8AAAA/\"}]}", more, texture,
             attributes, count_of_colors == 4, count_of_colors);
    write_text("triangle.gltf", text);
    return read_back("triangle.gltf", 0);
}

#define ORTHOGRAPHIC "{\"type\":\"orthographic\",\"orthographic\":{\"xmag\":1,\"ymag\":1,\"znear\":0,\"zfar\":9}}"
#define BOTH ORTHOGRAPHIC "," ORTHOGRAPHIC

/* Vertex colours without alpha are opaque. A texture on a mesh without coordinates, a texture without a picture in a
   known format, and an orthographic camera cause warnings. */
TEST(what_gltf_lacks_is_named) {
    static const unsigned char texels[6] = { 10, 128, 250, 200, 64, 3 };
    static const float one = 1, half = 0.5f;
    scene_file *file;
    stbi_write_png(in_folder("two.png"), 2, 1, 3, texels, 6);
    file = read_triangle("\"cameras\":[" BOTH "],", ",\"TEXCOORD_0\":1,\"COLOR_0\":2", "\"source\":0", 3);
    REQUIRE(file, "%s", error);
    CHECK(is_near((const float *)file->scene.meshes[0].colors.data + 3, &one, 1), "an alpha of %g",
          (double)((const float *)file->scene.meshes[0].colors.data)[3]);
    CHECK(file->simplified[SCENE_FILE_CAMERA] == 2 && !file->simplified[SCENE_FILE_UNMAPPED] && !file->warning_count,
          "%d cameras, %d meshes, %s", file->simplified[SCENE_FILE_CAMERA], file->simplified[SCENE_FILE_UNMAPPED],
          file->warnings[0]);
    scene_file_free(file);
    file = read_triangle("\"cameras\":[{\"type\":\"perspective\",\"perspective\":{\"yfov\":1,\"znear\":1}},"
                         ORTHOGRAPHIC "],", ",\"COLOR_0\":2", "\"source\":0", 4);
    REQUIRE(file, "%s", error);
    CHECK(is_near((const float *)file->scene.meshes[0].colors.data + 4, &one, 1) &&
          is_near((const float *)file->scene.meshes[0].colors.data + 11, &half, 1), "other colours");
    CHECK(!file->simplified[SCENE_FILE_CAMERA] && file->simplified[SCENE_FILE_UNMAPPED] == 1, "%d cameras, %d meshes",
          file->simplified[SCENE_FILE_CAMERA], file->simplified[SCENE_FILE_UNMAPPED]);
    scene_file_free(file);
#ifdef SBL_RENDER_CJSON
    file = read_triangle("\"cameras\":[" BOTH "],", ",\"TEXCOORD_0\":1", "\"extensions\":{\"EXT_texture_webp\":"
                         "{\"source\":0}}", 3);
    REQUIRE(file, "%s", error);
    CHECK(file->warning_count == 1 && strstr(file->warnings[0], "picture are left out (1 texture, EXT_texture_webp)"),
          "%s", file->warnings[0]);
    scene_file_free(file);
#endif
}

/* The reader counts triangles that refer to vertices that do not exist, triangles whose last indices are missing, and
   meshes that have fewer normals than positions. Strips, fans and meshes without a node are not counted. */
TEST(broken_meshes_are_counted) {
#define QUAD "{\"attributes\":{\"POSITION\":0}"
    scene_file *file;
#ifndef SBL_RENDER_CJSON
    SKIP("counting them needs cJSON");
#endif
    write_text("broken.gltf", "{\"asset\":{\"version\":\"2.0\"},\"meshes\":["
        "{\"primitives\":[" QUAD ",\"indices\":1}," QUAD ",\"indices\":4,\"mode\":5}," QUAD ",\"mode\":6}," QUAD
        ",\"mode\":1}]},{\"primitives\":[" QUAD ",\"indices\":2}," QUAD ",\"indices\":3}]},{\"primitives\":[{"
        "\"attributes\":{\"POSITION\":0,\"NORMAL\":5},\"indices\":1}]},{\"primitives\":[" QUAD ",\"indices\":2}]}],"
        "\"nodes\":[{\"mesh\":0},{\"mesh\":1},{\"mesh\":1},{\"mesh\":2}],\"scenes\":[{\"nodes\":[0,1,2,3]}],"
        "\"scene\":0,\"accessors\":["
        "{\"bufferView\":0,\"componentType\":5126,\"count\":4,\"type\":\"VEC3\"},"
        "{\"bufferView\":1,\"componentType\":5121,\"count\":6,\"type\":\"SCALAR\"},"
        "{\"bufferView\":1,\"byteOffset\":6,\"componentType\":5121,\"count\":6,\"type\":\"SCALAR\"},"
        "{\"bufferView\":1,\"componentType\":5121,\"count\":5,\"type\":\"SCALAR\"},"
        "{\"bufferView\":1,\"byteOffset\":12,\"componentType\":5121,\"count\":4,\"type\":\"SCALAR\"},"
        "{\"bufferView\":0,\"componentType\":5126,\"count\":3,\"type\":\"VEC3\"}],"
        "\"bufferViews\":[{\"buffer\":0,\"byteLength\":48},{\"buffer\":0,\"byteOffset\":48,"
        "\"byteLength\":16}],"
        "\"buffers\":[{\"byteLength\":64,\"uri\":\"data:application/octet-stream;base64,AAAAAAAAAAAAAAAAAACAPwAA"
        "AAAAAAAAAACAPwAAgD8AAAAAAAAAAAAAgD8AAAAAAAECAAIDAAECAAIJAAEDAg==\"}]}");
    file = read_back("broken.gltf", 0);
    REQUIRE(file, "%s", error);
    CHECK(file->simplified[SCENE_FILE_CORNERS] == 2 && file->simplified[SCENE_FILE_ATTRIBUTE] == 1 &&
          file->scene.mesh_count == 8, "%d triangles, %d meshes with other normals, %d meshes",
          file->simplified[SCENE_FILE_CORNERS], file->simplified[SCENE_FILE_ATTRIBUTE], file->scene.mesh_count);
    CHECK(strcmp(file->names[0], "nodes[0]") == 0, "the name %s", file->names[0]);
    scene_file_free(file);
    write_text("broken.gltf", "{\"asset\":{\"version\":\"2.0\"},\"accessors\":[{\"normalized\":true}],\"meshes\":"
               "[{\"primitives\":[{\"attributes\":[0]}]}],\"nodes\":[{\"mesh\":0}],\"scenes\":[{\"nodes\":[0]}]}");
    file = read_back("broken.gltf", 0);
    CHECK(!file && strstr(error, "attributes"), "a list of attributes: %s", error);
    if (file) scene_file_free(file);
}

/* Names of meshes keep all characters, and the name of the .bin is written as a URI. */
TEST(written_names) {
    const char *const names[] = { "gr\xc3\xbc\"n \xff\n" };
    scene_file *file;
    gltf_file out;
    FILE *stream = fopen(in_folder("names.gltf"), "wb");
    write_materials("plain.gltf", MODEL(""));
    file = read_back("plain.gltf", 0);
    REQUIRE(file && stream, "%s", error);
    memset(&out, 0, sizeof out);
    out.scene = &file->scene;
    out.names = names;
    out.bin = "a \xc3\xbc\"50%.bin";
    CHECK(gltf_write_json(stream, &out), "the .gltf is not written");
    fclose(stream);
    CHECK(has_text("names.gltf", "\"gr\xc3\xbc\\\"n ??\""), "another name of the mesh");
    CHECK(has_text("names.gltf", "\"uri\": \"a%20%C3%BC%2250%25.bin\""), "another name of the .bin");
    scene_file_free(file);
}

/* In OBJ, `norm` is a normal map. The texture coordinates of OBJ, which begin at the bottom, are flipped. Height maps
   are counted and not used. */
TEST(normals_of_obj) {
    static const unsigned char texels[6] = { 10, 128, 250, 200, 64, 3 };
    static const char *const materials[] = { "norm two.png", "map_Bump two.png", "bump two.png\nnorm two.png",
        "disp two.png", "Kd 1 1 1" };
    static const double scales[5] = { 1, 0, 1, 0, 0 };
    FILE *mtl = fopen(in_folder("normals.mtl"), "w"), *obj = fopen(in_folder("normals.obj"), "w");
    scene_file *file;
    const float *v;
    int i;
    stbi_write_png(in_folder("two.png"), 2, 1, 3, texels, 6);
    fprintf(obj, "mtllib normals.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0.25\nvt 1 0.25\nvt 0 1\n");
    for (i = 0; i < 5; i++) {
        fprintf(mtl, "newmtl m%d\n%s\n", i, materials[i]);
        fprintf(obj, "usemtl m%d\nf 1/1 2/2 3/3\n", i);
    }
    fclose(mtl);
    fclose(obj);
    file = read_back("normals.obj", 0);
    REQUIRE(file && file->scene.mesh_count == 5, "%s", error);
    for (i = 0; i < 5; i++) check_normals(file, i, materials[i], scales[i]);
    v = (const float *)file->scene.meshes[0].texcoords.data;
    CHECK(v && fabs((double)v[1] - 0.75) < 1e-6 && fabs((double)v[5]) < 1e-6, "v is not turned upside down");
    CHECK(file->simplified[SCENE_FILE_HEIGHT] == 3 && !file->simplified[SCENE_FILE_NORMAL_MAP] &&
          !file->simplified[SCENE_FILE_MAP] && !file->warning_count, "%d with heights, %d with maps",
          file->simplified[SCENE_FILE_HEIGHT], file->simplified[SCENE_FILE_MAP]);
    CHECK(file->scene.texture_count == 1 && file->scene.textures[0].format == SBL_PIXELS_LINEAR8, "%d textures",
          file->scene.texture_count);
    scene_file_free(file);
}

/* Normal maps and factors that gltf_file.h writes are the same when they are read again. Textures without a file are
   written with the same bytes. */
TEST(written_normals_are_read_again) {
    static const unsigned char texels[6] = { 10, 128, 250, 200, 64, 3 };
    static const float numbers[6] = { 10 / 255.0f, 128 / 255.0f, 250 / 255.0f, 200 / 255.0f, 64 / 255.0f, 3 / 255.0f };
    static const double scales[5] = { 1, 0.25, -2, 0, 1 };
    sbl_texture *t;
    scene_file *file, *again;
    int i, k;
    stbi_write_png(in_folder("two.png"), 2, 1, 3, texels, 6);
    write_materials("normals.gltf", NORMAL("\"index\":0") "," BASE("0") "|" NORMAL("\"index\":0,\"scale\":0.25") "|"
                    NORMAL("\"index\":1,\"scale\":-2") "|" BASE("0") "|" NORMAL("\"index\":0"));
    file = read_back("normals.gltf", 0);
    REQUIRE(file, "%s", error);
    t = (sbl_texture *)(uintptr_t)&file->scene.textures[material_of(file, 2)->normal_texture - 1];
    t->format = SBL_PIXELS_FLOAT;
    t->pixels = numbers;
    ((sbl_material *)(uintptr_t)material_of(file, 0))->normal_scale = 0;
    write_scene(file, "again.gltf");
    again = read_back("again.gltf", 0);
    REQUIRE(again && again->scene.mesh_count == 5 && !again->warning_count, "%s", again ? again->warnings[0] : error);
    for (i = 0; i < 5; i++) {
        const sbl_material *m = material_of(again, 4 - i);
        check_normals(again, 4 - i, "written", scales[i]);
        CHECK(is_gloss(m, &matte), "triangle %d is glossy", 4 - i);
        for (k = 0; k < 6 && m->normal_texture; k++) {
            const int byte = ((const unsigned char *)again->scene.textures[m->normal_texture - 1].pixels)[k];
            CHECK(byte == texels[k], "triangle %d: byte %d is %d, not %d", 4 - i, k, byte, texels[k]);
        }
    }
    CHECK(!has_text("again.gltf", "\"scale\": 1}") && has_text("again.gltf", "\"scale\": 0.25}"), "a factor of 1 needs "
          "no words");
    scene_file_free(again);
    scene_file_free(file);
}

/* >>time limits */

static void read_on(scene_file *file, const char *path,
    scene__bytes *bytes) {  /* runs endlessly, like a file that includes itself */
    notes->child = getpid();
    for (;;) {
        scene__bytes again = { NULL, 0 };
        (void)bytes;
        if (!scene__slurp(file, path, &again)) return;
        free(again.data);
        poll(NULL, 0, 10);
    }
}
static void wait_for_ever(scene_file *file, const char *path, scene__bytes *bytes) {
    sigset_t all;
    (void)file; (void)path; (void)bytes;
    sigfillset(&all);
    sigprocmask(SIG_SETMASK, &all, NULL);
    notes->child = getpid();
    for (;;) sleep(1000);
}
static void pretend_to_be_gone(scene_file *file, const char *path, scene__bytes *bytes) {
    int i;
    for (i = 3; i < 100; i++) close(i);
    wait_for_ever(file, path, bytes);
}
static void compute_for_ever(scene_file *file, const char *path, scene__bytes *bytes) {
    volatile unsigned n = 0;
    (void)file; (void)path; (void)bytes;
    notes->child = getpid();
    for (;;) n++;
}

/* Readers that run endlessly, ignore signals or pretend to have ended are killed at the time limit. */
TEST(the_deadline_stands) {
    static const struct { const char *name; scene__reading reading; } late[] = {
        { "reading endlessly", read_on }, { "ignoring signals", wait_for_ever }, { "pretending to have ended",
            pretend_to_be_gone },
        { "computing", compute_for_ever } };
    size_t i;
    for (i = 0; i < sizeof late / sizeof *late; i++) {
        scene_file *file = load(late[i].reading, NULL);
        CHECK(!file && strstr(error, "room.obj: reading it takes longer than 0.5 s") && strstr(error, "--read-time"),
            "%s: %s",
              late[i].name, file ? "the file was read" : error);
        CHECK(notes->child > 0 && kill(notes->child, 0) != 0 && errno == ESRCH, "%s: the reader still exists",
            late[i].name);
        scene_file_free(file);
    }
}

/* A cancelled call of the reader returns NULL without a message, and the process of the reader has ended. */
TEST(a_cancelled_reader_is_gone) {
    static volatile sig_atomic_t cancel = 1;
    scene_file_options options;
    scene_file *file;
    memset(&options, 0, sizeof options);
    options.cancel = &cancel;
    options.seconds = 1000;
    strcpy(error, "old");
    file = load(wait_for_ever, &options);
    CHECK(!file && !error[0], "expected neither a scene nor a message: %s", error);
    CHECK(notes->child == 0 || kill(notes->child, 0) != 0, "the reader still exists");
    scene_file_free(file);
}

/* Starts a process that waits for its reader for longer than this test takes. Returns its id. */
static pid_t load_elsewhere(scene__reading reading, double seconds) {
    scene_file_options options;
    pid_t host;
    int i;
    notes->child = 0;
    fflush(NULL);
    host = fork();
    if (host == 0) {
        memset(&options, 0, sizeof options);
        options.seconds = seconds;
        load(reading, &options);
        _exit(0);
    }
    for (i = 0; i < 36000 && !notes->child; i++) poll(NULL, 0, 100);
    return host;
}

/* A limit of processor time ends the reader even if its host is stopped. */
TEST(its_processor_time_is_limited) {
    pid_t host;
    if (SCENE__SANITIZED) SKIP("under sanitizers the reader is not confined");
    host = load_elsewhere(compute_for_ever, 1);
    kill(host, SIGSTOP);  /* a stopped host cannot enforce the time limit */
    CHECK(notes->child && goes(notes->child), "with a stopped host, the reader computes for ever");
    if (notes->child && !is_gone(notes->child)) kill(notes->child, SIGKILL);
    kill(host, SIGKILL);
    waitpid(host, NULL, 0);
}

/* The reader ends if its host is killed. */
TEST(it_does_not_outlive_its_host) {
    pid_t host = load_elsewhere(wait_for_ever, 1000), child = notes->child;
    kill(host, SIGKILL);
    waitpid(host, NULL, 0);
    CHECK(child && goes(child), "the reader still exists");
    if (child && !is_gone(child)) kill(child, SIGKILL);
}

/* A reader whose host ended before the reader started ends at once. */
TEST(a_host_that_is_gone_already) {
    int status = -1;
    pid_t child;
    fflush(NULL);
    child = fork();
    if (child == 0) {
        scene__die_with(getpid());  /* a process that is not the parent */
        _exit(0);
    }
    waitpid(child, &status, 0);
    CHECK(WIFEXITED(status) && WEXITSTATUS(status) == 1, "status %#x: the reader should end at once", status);
}

/* >>memory limits */

enum { MEGABYTE = 1 << 20, LIMIT = 64 * MEGABYTE };

static void take_all(scene_file *file, const char *path, scene__bytes *bytes) {
    void *block;
    (void)file; (void)path; (void)bytes;
    for (notes->taken = 0; notes->taken < 8 * (size_t)LIMIT && (block = malloc(MEGABYTE)) != NULL;
        notes->taken += MEGABYTE)
        memset(block, 1, MEGABYTE);
}
static void share_all(scene_file *file, const char *path, scene__bytes *bytes) {
    take_all(file, path, bytes);
    notes->taken = 0;
    while (scene__alloc(file, 1000, MEGABYTE / 1000)) notes->taken += MEGABYTE;
}
static void share_most(scene_file *file, const char *path, scene__bytes *bytes) {
    size_t i;
    (void)path; (void)bytes;
    for (i = 0; i < LIMIT / MEGABYTE * 3 / 4; i++)
        if (!scene__alloc(file, MEGABYTE, 1)) return;
}
static void take_the_rest(scene_file *file, const char *path, scene__bytes *bytes) {
    share_most(file, path, bytes);
    take_all(file, path, bytes);
}

/* A reader can allocate only as much memory as the limit, less what it shares with the program that started it. A
   reader that shares more than the limit fails with a message. */
TEST(memory_is_limited) {
    scene_file_options options;
    scene_file *file;
    memset(&options, 0, sizeof options);
    options.seconds = 60;
    options.memory = LIMIT;
    if (SCENE__SANITIZED) SKIP("under sanitizers the reader's own memory is not limited");
    file = load(take_all, &options);
    CHECK(file && notes->taken > LIMIT / 2 && notes->taken <= LIMIT,
          "with a limit of %d bytes the reader allocated %.0f: %s", LIMIT,
        (double)notes->taken, error);
    scene_file_free(file);
    file = load(share_all, &options);
    CHECK(!file && notes->taken < LIMIT / 2, "with a limit of %d bytes the reader could share %.0f more", LIMIT,
        (double)notes->taken);
    CHECK(strstr(error, "room.obj: it needs ") && strstr(error, "0.0625 GB") && strstr(error, "--memory"), "%s", error);
    scene_file_free(file);
    file = load(take_the_rest, &options);
    CHECK(file && notes->taken > LIMIT / 8 && notes->taken <= LIMIT / 4,
          "with a limit of %d bytes the reader shared 3/4 and allocated %.0f: "
        "%s", LIMIT,
          (double)notes->taken, error);
    scene_file_free(file);
}

/* Shared pages that the reader did not use are released. */
TEST(shared_pages_are_limited) {
    scene_file_options options;
    scene_file *file;
    memset(&options, 0, sizeof options);
    options.seconds = 60;
    options.memory = LIMIT;
    file = load(share_most, &options);
    REQUIRE(file, "%s", error);
    CHECK(file->capacity < LIMIT && file->capacity >= LIMIT / 4 * 3, "%.0f of %d bytes are kept",
        (double)file->capacity, LIMIT);
    scene_file_free(file);
}

/* Memory limits of control groups are read from the files of cgroup versions 1 and 2. */
TEST(control_groups_are_heeded) {
    static const struct { const char *groups, *file, *text; double limit; } cases[] = {
        { "0::/a/b\n", "/a/b/memory.max", "1000\n", 1000 },
        { "0::/a/b\n", "/a/memory.max", "2000\n", 2000 },
        { "0::/host/path\n", "/memory.max", "3000\n", 3000 },
        { "0::/a/b\n", "/a/b/memory.max", "max\n", -1 },
        { "0::/\n", "/memory.max", "4000\n", 4000 },
        { "9:cpu:/a\n4:memory:/a/b\n0::/\n", "/memory/a/b/memory.limit_in_bytes", "5000\n", 5000 },
        { "4:memory:/a/b\n", "/memory/memory.limit_in_bytes", "6000\n", 6000 },
        { "9:cpu:/memory\n", "/memory/memory.limit_in_bytes", "7000\n", -1 },
        { "", "/memory.max", "8000\n", -1 } };
    static const char *const folders[] = { "groups", "groups/a", "groups/a/b", "groups/memory", "groups/memory/a",
        "groups/memory/a/b" };
    char name[128];
    size_t i;
    for (i = 0; i < sizeof folders / sizeof *folders; i++) mkdir(in_folder(folders[i]), 0777);
    for (i = 0; i < sizeof cases / sizeof *cases; i++) {
        size_t limit, expected = cases[i].limit < 0 ? SIZE_MAX : (size_t)cases[i].limit;
        snprintf(name, sizeof name, "groups%s", cases[i].file);
        write_text(name, cases[i].text);
        write_text("cgroup", cases[i].groups);
        limit = scene__group_limit(in_folder("cgroup"), in_folder("groups"));
        CHECK(limit == expected, "%s in %s: %.0f, expected %.0f", cases[i].file, cases[i].groups, (double)limit,
            cases[i].limit);
        remove(in_folder(name));
    }
    CHECK(scene__group_limit(in_folder("absent"), in_folder("groups")) == SIZE_MAX,
        "without control groups there should be no limit");
}

/* The default limit is half of the physical memory or of ulimit -v, if that is less. A smaller limit that the caller
   requests is used. */
TEST(ulimit_is_heeded) {
    const size_t before = scene__memory_limit(0), mine = scene__memory_limit((size_t)1 << 30);
    int status = -1;
    pid_t child;
    CHECK(before > 0 && before <= (size_t)sysconf(_SC_PHYS_PAGES) * (size_t)sysconf(_SC_PAGESIZE) / 2,
        "the default is %.0f bytes", (double)before);
    CHECK(mine == (size_t)1 << 30, "a requested limit became %.0f bytes", (double)mine);
    if (SCENE__SANITIZED) SKIP("sanitizers need much address space");
    fflush(NULL);
    child = fork();
    if (child == 0) {
        struct rlimit limit;
        limit.rlim_cur = limit.rlim_max = (rlim_t)1 << 30;
        setrlimit(RLIMIT_AS, &limit);
        _exit(!(scene__memory_limit(0) <= (size_t)1 << 29 && scene__memory_limit((size_t)1 << 40) <= (size_t)1 << 29 &&
                scene__memory_limit((size_t)1 << 20) == (size_t)1 << 20));
    }
    waitpid(child, &status, 0);
    CHECK(status == 0, "the limit is more than half of ulimit -v, or less than requested");
}

int main(void) {
    const char *temporary = getenv("TMPDIR");
    char command[128];
    int failed;
    alarm(7200);  /* ends this test if a parent waits forever */
    snprintf(folder, sizeof folder, "%.40s/sbl_reader_XXXXXX", temporary && *temporary ? temporary : "/tmp");
    notes = (struct notes *)mmap(NULL, sizeof *notes, PROT_READ | PROT_WRITE, MAP_SHARED | MAP_ANONYMOUS, -1, 0);
    if (!mkdtemp(folder) || notes == MAP_FAILED) { printf("no temporary folder %s\n0 passed, 1 failed, 0 skipped\n",
        folder); return 1; }
    RUN(reader_opens_only_the_scene_folder);
    RUN(a_missing_sandbox_is_reported);
    RUN(inconsistent_shared_values_are_refused);
    RUN(a_broken_picture_is_opened_once);
    RUN(gloss_of_gltf);
    RUN(textures_of_metal);
    RUN(gloss_that_is_lost_is_counted);
    RUN(coordinates_of_metal);
    RUN(gloss_of_other_formats);
    RUN(grey_without_material);
    RUN(panes_of_gltf);
    RUN(blending_of_gltf);
    RUN(glass_of_obj);
    RUN(written_gloss_is_read_again);
    RUN(written_panes_are_read_again);
    RUN(written_lights_are_read_again);
    RUN(places_in_lightmaps);
    RUN(sets_and_maps);
    RUN(normals_of_gltf);
    RUN(five_textures_per_material);
    RUN(coordinates_of_normals);
    RUN(transforms_of_texture_coordinates);
    RUN(repeated_textures_are_counted);
    RUN(integers_become_floats);
    RUN(names_of_buffers);
    RUN(rotations_do_not_scale);
    RUN(transparent_surfaces_are_counted);
    RUN(oddities_of_obj);
    RUN(options_of_obj_textures);
    RUN(undefined_materials_of_obj);
    RUN(collada_without_material);
    RUN(cameras_of_collada);
    RUN(units_of_fbx);
    RUN(what_gltf_lacks_is_named);
    RUN(broken_meshes_are_counted);
    RUN(written_names);
    RUN(normals_of_obj);
    RUN(written_normals_are_read_again);
    RUN(the_deadline_stands);
    RUN(a_cancelled_reader_is_gone);
    RUN(its_processor_time_is_limited);
    RUN(it_does_not_outlive_its_host);
    RUN(a_host_that_is_gone_already);
    RUN(memory_is_limited);
    RUN(shared_pages_are_limited);
    RUN(control_groups_are_heeded);
    RUN(ulimit_is_heeded);
    snprintf(command, sizeof command, "rm -rf %s", folder);
    failed = system(command) != 0;
    return test_report() || failed;
}
