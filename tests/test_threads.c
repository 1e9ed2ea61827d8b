/* Two threads, each with its own GL context and its own sbl.h context, make all kinds of calls at the same time. Each
   must get the same results as when it runs alone, to the bit. scripts/test also runs this program with the thread
   sanitizer, which finds shared data even if the results are right. tests/support/tsan.supp lists the functions of the
   driver. */
#define _POSIX_C_SOURCE 200809L
#include "../sbl.h"
#include <pthread.h>
#include "support/test.h"
#include "support/scenes.h"
#include "support/gl_watch.h"
#include "support/gl_scene.h"
#include "support/gl_host.h"

enum { THREADS = 2, ROUNDS = 4, SITES = 5, SHEET = 4096 };

/* The results of one round. */
typedef struct output {
    sbl_result result;
    small_picture rasterised, traced;
    sbl_reading readings[SITES];
    float bounds[6], radiance[4 * SHEET], weights[SHEET];
} output;

typedef struct worker {
    int number, rounds, round;
    pthread_barrier_t *barrier;  /* NULL: no other thread runs */
    watch log;
    sbl_context *context;
    test_scene scene;            /* the sky differs between the threads */
    output outputs[ROUNDS];
} worker;

static output expected[THREADS];
static worker workers[THREADS];
static EGLDisplay display;
static EGLConfig config;

/* Creates the context of a round. In even rounds the sbl.h context uses the GL context of the thread. In odd rounds it
   has its own GL context, which it makes current in each call. */
static sbl_result create(worker *w, output *out) {
    sbl_context_desc desc = watch_desc(&w->log);
    (void)out;
    if (w->round % 2 == 0) desc.get_gl_function = gl_host_proc;
    return sbl_create(&desc, &w->context);
}

static sbl_result set_scene(worker *w, output *out) {
    sbl_scene_desc desc = scene_desc(&w->scene);
    (void)out;
    return sbl_set_scene(w->context, &desc);
}

static sbl_result move(worker *w, output *out) {
    static const float matrix[16] = { 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0.25f, 0, 0, 1 };
    sbl_result result = sbl_set_mesh_transform(w->context, SMALL_BOX, matrix);
    scene_bounds(w->context, out->bounds, out->bounds + 3);
    return result;
}

static sbl_result render(worker *w, sbl_backend backend, double seconds) {
    sbl_picture_desc view = small_view();
    sbl_result result;
    view.options.backend = backend;
    view.options.seed = (uint32_t)w->number;
    result = sbl_begin_picture(w->context, &view);
    if (result == SBL_SUCCESS) do result = sbl_step(w->context, seconds); while (result == SBL_UNFINISHED);
    return result;
}

static sbl_result rasterise(worker *w, output *out) { (void)out; return render(w, SBL_BACKEND_RASTER, 0); }
static sbl_result read_rasterised(worker *w, output *out) { return small_read(w->context, &out->rasterised); }
static sbl_result trace(worker *w, output *out) { (void)out; return render(w, SBL_BACKEND_TRACE, 0.003); }
static sbl_result read_traced(worker *w, output *out) { return small_read(w->context, &out->traced); }

static sbl_result inspect(worker *w, output *out) {
    sbl_result result = SBL_ERROR_INVALID_ARGUMENT;
    sbl_sensor sensor;
    int i;
    /* finds the first pixel that shows a surface */
    for (i = 0; i < SMALL_PIXELS && result == SBL_ERROR_INVALID_ARGUMENT; i++)
        result = sbl_inspect_sensor(w->context, i % SMALL_WIDTH, i / SMALL_WIDTH, &sensor, out->radiance, out->weights,
                                    SHEET);
    return result;
}

static sbl_result gather(worker *w, output *out) {
    sbl_site sites[SITES];
    sbl_readings_desc desc;
    int i;
    memset(sites, 0, sizeof sites);
    for (i = 0; i < SITES; i++) { sites[i].position[0] = 0.3f * (float)i; sites[i].normal[1] = 1; }
    desc = scene_readings(sites, out->readings, SITES, SBL_MODE_AMBIENT);
    desc.options.rays = 20;
    return sbl_gather_readings(w->context, &desc);
}

static sbl_result destroy(worker *w, output *out) { (void)out; sbl_destroy(w->context); return SBL_SUCCESS; }

static void *work(void *user) {
    /* The threads wait for each other before each call. Otherwise the locks of the driver could order the calls, and
       the sanitizer finds no race between ordered calls. */
    static sbl_result (*const calls[])(worker *, output *) = {
        create, set_scene, move, rasterise, read_rasterised, inspect, trace, read_traced, inspect, gather, destroy
    };
    static const EGLint wishes[] = { EGL_CONTEXT_MAJOR_VERSION, 3, EGL_CONTEXT_MINOR_VERSION, 3,
                                     EGL_CONTEXT_OPENGL_PROFILE_MASK, EGL_CONTEXT_OPENGL_CORE_PROFILE_BIT, EGL_NONE };
    worker *w = (worker *)user;
    EGLContext context;
    int i;
    eglBindAPI(EGL_OPENGL_API);
    context = eglCreateContext(display, config, EGL_NO_CONTEXT, wishes);
    if (!eglMakeCurrent(display, EGL_NO_SURFACE, EGL_NO_SURFACE, context)) abort();
    small_scene(&w->scene);
    w->scene.sky[0] = (float)(1 + w->number);
    for (w->round = 0; w->round < w->rounds; w->round++) {
        output *out = &w->outputs[w->round];
        memset(out, 0, sizeof *out);
        for (i = 0; i < (int)(sizeof calls / sizeof *calls); i++) {
            if (w->barrier) pthread_barrier_wait(w->barrier);
            if (out->result == SBL_SUCCESS) out->result = calls[i](w, out);
        }
    }
    scene_free(&w->scene);
    eglMakeCurrent(display, EGL_NO_SURFACE, EGL_NO_SURFACE, EGL_NO_CONTEXT);
    eglDestroyContext(display, context);
    return NULL;
}

/* Each thread gets its reference results while it runs alone. This test uses threads, too, so that the sanitizer checks
   the same code in both tests. */
TEST(one_thread_at_a_time) {
    pthread_t thread;
    int i;
    for (i = 0; i < THREADS; i++) {
        const output *out = &expected[i];
        workers[i].number = i;
        workers[i].rounds = 1;
        if (pthread_create(&thread, NULL, work, &workers[i])) abort();
        pthread_join(thread, NULL);
        expected[i] = workers[i].outputs[0];
        REQUIRE(out->result == SBL_SUCCESS, "%s: %s", sbl_result_string(out->result), watch_last(&workers[i].log));
        CHECK(small_plausible(&out->rasterised) && small_plausible(&out->traced), "the picture is not usable");
        CHECK(out->readings[0].radiance[0] > 0 && out->weights[0] > 0, "nothing was gathered");
    }
    CHECK(!small_same(&expected[0].traced, &expected[1].traced), "the threads' pictures are the same");
}

/* Two threads at the same time get the results that each gets alone. */
TEST(threads_side_by_side) {
    pthread_barrier_t barrier;
    pthread_t threads[THREADS];
    int i, round;
    REQUIRE(!pthread_barrier_init(&barrier, NULL, THREADS), "no barrier");
    for (i = 0; i < THREADS; i++) {
        workers[i].rounds = ROUNDS;
        workers[i].barrier = &barrier;
        if (pthread_create(&threads[i], NULL, work, &workers[i])) abort();
    }
    for (i = 0; i < THREADS; i++) pthread_join(threads[i], NULL);
    pthread_barrier_destroy(&barrier);
    for (i = 0; i < THREADS; i++)
        for (round = 0; round < ROUNDS; round++) {
            const output *out = &workers[i].outputs[round];
            CHECK(out->result == SBL_SUCCESS, "thread %d, round %d: %s, %s", i, round, sbl_result_string(out->result),
                  watch_last(&workers[i].log));
            CHECK(!memcmp(out, &expected[i], sizeof *out), "thread %d, round %d: the results differ from those of the "
                  "thread alone", i, round);
        }
    for (i = 0; i < THREADS; i++)
        CHECK(workers[i].log.blocks == 0 && workers[i].log.strangers == 0, "thread %d: %d blocks leaked", i,
              workers[i].log.blocks);
}

int main(void) {
    static const EGLint wishes[] = { EGL_SURFACE_TYPE, EGL_PBUFFER_BIT, EGL_RENDERABLE_TYPE, EGL_OPENGL_BIT, EGL_NONE };
    EGLint count = 0;
    if (!gl_host_open()) return 1;
    display = gl.display;
    host_gl_close();
    if (!eglChooseConfig(display, wishes, &config, 1, &count) || count < 1) { printf("no EGL config\n"); return 1; }
    RUN(one_thread_at_a_time);
    RUN(threads_side_by_side);
    return test_report();
}
