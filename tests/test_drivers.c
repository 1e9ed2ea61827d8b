/* Renders small pictures with other drivers, in processes of their own: Mesa's softpipe, which interprets shaders and
   has only GL 3.3, and zink, which uses Vulkan (here lavapipe). They must agree with llvmpipe, which the other tests
   compare with references. */
#define _DEFAULT_SOURCE
#include "../sbl.h"
#include "support/test.h"
#include "support/scenes.h"
#include "support/gl_watch.h"
#include "support/gl_scene.h"
#include <sys/wait.h>
#include <unistd.h>

enum { PICTURES = 3 };

static const char *program;

/* The child process: renders with the driver that the environment selects, and writes the name of the driver and the
   pictures. */
static int child(const char *path) {
    static const struct { sbl_mode mode; sbl_backend backend; } ways[PICTURES] = {
        { SBL_MODE_AMBIENT, SBL_BACKEND_TRACE }, { SBL_MODE_AMBIENT, SBL_BACKEND_RASTER },
        { SBL_MODE_PAPER, SBL_BACKEND_RASTER } };
    static small_picture picture;
    sbl_context *context;
    sbl_capabilities about;
    sbl_scene_desc desc;
    sbl_context_desc small_atlas;
    test_scene s;
    FILE *file = fopen(path, "wb");
    int i, good = file != NULL;
    small_scene(&s);
    desc = scene_desc(&s);
    memset(&small_atlas, 0, sizeof small_atlas);
    small_atlas.sensor_texture_size = 256;
    if (!good || sbl_create(&small_atlas, &context) != SBL_SUCCESS) return 1;
    about = sbl_query_capabilities(context);
    good = fwrite(about.renderer, sizeof about.renderer, 1, file) == 1 && sbl_set_scene(context, &desc) == SBL_SUCCESS;
    for (i = 0; i < PICTURES && good; i++) {
        sbl_picture_desc view;
        small_backend = ways[i].backend;
        view = small_view();
        view.options.mode = ways[i].mode;
        view.options.rays = 8;
        good = small_render(context, &view, &picture) == SBL_SUCCESS && fwrite(&picture, sizeof picture, 1, file) == 1;
    }
    sbl_destroy(context);
    scene_free(&s);
    return fclose(file) == 0 && good ? 0 : 1;
}

/* Runs the child. Returns 0 on failure, or if another driver was used. */
static int pictures_of(const char *driver, char renderer[128], small_picture out[PICTURES]) {
    char path[] = "/tmp/sbl_drivers_XXXXXX";
    const int handle = mkstemp(path);
    int status = -1, good = 0;
    pid_t pid;
    FILE *file;
    if (handle < 0) return 0;
    close(handle);
    fflush(stdout);
    pid = fork();
    if (pid == 0) {
        setenv("LIBGL_ALWAYS_SOFTWARE", "1", 1);
        setenv("GALLIUM_DRIVER", driver, 1);
        /* the driver itself leaks, in modules that no suppression names */
        setenv("ASAN_OPTIONS", "detect_leaks=0:max_malloc_fill_size=1073741824:malloc_fill_byte=0", 1);
        /* softpipe reads memory that it has not set (valgrind shows it inside the driver), so that its pictures differ
           from run to run; with 255, malloc fills new memory with zeros */
        setenv("MALLOC_PERTURB_", "255", 1);
        execl(program, program, path, (char *)NULL);
        _exit(1);
    }
    if (pid > 0 && waitpid(pid, &status, 0) == pid && status == 0) {
        file = fopen(path, "rb");
        good = file && fread(renderer, 128, 1, file) == 1 && fread(out, sizeof *out, PICTURES, file) == PICTURES &&
            strstr(renderer, driver) != NULL;
        if (file) fclose(file);
    } else snprintf(renderer, 128, "status 0x%x", (unsigned)status);
    unlink(path);
    return good;
}

/* Returns the RMS difference of R, relative to its mean. */
static double difference(const small_picture *a, const small_picture *b) {
    const float *x = a->values + 3 * SMALL_PIXELS * SBL_CHANNEL_RADIANCE,
        *y = b->values + 3 * SMALL_PIXELS * SBL_CHANNEL_RADIANCE;
    double squares = 0, sum = 0;
    int i;
    for (i = 0; i < 3 * SMALL_PIXELS; i++) {
        squares += ((double)x[i] - y[i]) * ((double)x[i] - y[i]);
        sum += y[i];
    }
    return sqrt(squares * 3 * SMALL_PIXELS) / sum;
}

/* Compares a driver with llvmpipe. views: 1 to compare rasterised hemicubes, too; on softpipe these differ from run to
   run. most: greatest error; in such small pictures, a single texel or ray on the other side of an edge matters */
static void agrees(const char *driver, double most, int views) {
    static small_picture truth[PICTURES], other[PICTURES];
    char renderer[128] = "";
    int i;
    if (!pictures_of("llvmpipe", renderer, truth)) SKIP("llvmpipe is not available (%s)", renderer);
    if (!pictures_of(driver, renderer, other)) SKIP("the driver is not available (%s)", renderer);
    for (i = 0; i < PICTURES; i++) {
        const double error = difference(&other[i], &truth[i]);
        printf("  picture %d: %.4f %%\n", i, 100 * error);
        CHECK((i == 1 && !views) || (small_plausible(&truth[i]) && small_plausible(&other[i]) && error < most),
              "picture %d of %s: off by %.3f %%", i, renderer, 100 * error);
    }
}

/* Pictures of each driver agree with those of llvmpipe within 3 %, and within 0.1 % RMS. */
TEST(softpipe) { agrees("softpipe", 0.03, 0); }
TEST(zink) { agrees("zink", 1e-3, 1); }

int main(int argc, char **argv) {
    program = argv[0];
    if (argc == 2) return child(argv[1]);
    RUN(softpipe);
    RUN(zink);
    return test_report();
}
