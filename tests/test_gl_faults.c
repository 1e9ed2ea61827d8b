/* Tests failures of GL and of the allocator, simulated at every place where they can happen. Each failure must give the
   right result and a message, leak nothing and restore the GL state, and afterwards the context must render the same
   picture as before. SBL_SUCCESS with another picture is never allowed. */
#include <execinfo.h>
#include "../sbl.h"
#include "support/test.h"
#include "support/scenes.h"
#include "support/inside.h"
#include "support/gl_watch.h"
#include "support/gl_scene.h"
#include "support/gl_host.h"
#include "support/gl_state.h"
#include "support/gl_fake.h"

static watch seen;
static gl_state before, after;
static test_scene scene, second;   /* second: the small scene with one box moved */
static GLuint buffer, texture;
static small_picture expected, expected_moved;
static float bounds[2][3];
/* moves a mesh out of the bounds of the scene */
static const float moved[16] = { 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 3, 0.1f, 0.2f, 1 };

static sbl_context_desc faulty_desc(void) {
    sbl_context_desc desc = watch_desc(&seen);
    desc.get_gl_function = fake_proc;
    desc.sensor_texture_size = 256;
    return desc;
}

static void scenes_make(void) {
    static const unsigned char texels[16] = { 255, 128, 0, 255, 0, 128, 255, 255, 90, 180, 45, 255, 200, 200, 10, 255 };
    static const float corners[9] = { -0.9f, 0.2f, 0.5f, -0.6f, 0.2f, 0.9f, -0.9f, 0.6f, 0.9f };
    static const uint32_t copies[3 * 12] = { 0, 1, 2, 0, 1, 2, 0, 1, 2, 0, 1, 2, 0, 1, 2, 0, 1, 2, 0, 1, 2, 0, 1, 2, 0,
        1, 2, 0, 1, 2, 0, 1, 2, 0, 1, 2 };
    sbl_mesh *m;
    small_scene(&scene);
    /* duplicate triangles; the hierarchy drops the copies, and needs memory for this, which it may not get */
    scene_mesh(&scene, 0, corners, NULL, NULL, 3, copies, 3 * 12);
    gl.GenBuffers(1, &buffer);
    gl.BindBuffer(GL_ARRAY_BUFFER, buffer);
    gl.BufferData(GL_ARRAY_BUFFER, (GLsizeiptr)(3 * 4 * sizeof(float)), scene.meshes[SMALL_FLOOR].positions.data,
                  GL_STATIC_DRAW);
    gl.BindBuffer(GL_ARRAY_BUFFER, 0);
    gl.GenTextures(1, &texture);
    gl.BindTexture(GL_TEXTURE_2D, texture);
    gl.TexImage2D(GL_TEXTURE_2D, 0, GL_RGBA8, 2, 2, 0, GL_RGBA, GL_UNSIGNED_BYTE, texels);
    gl.TexParameteri(GL_TEXTURE_2D, GL_TEXTURE_MIN_FILTER, GL_NEAREST);
    gl.BindTexture(GL_TEXTURE_2D, 0);
    m = &scene.meshes[SMALL_FLOOR];
    m->positions.data = NULL;
    m->positions.gl_buffer = buffer;
    memset(&scene.textures[0], 0, sizeof scene.textures[0]);
    scene.textures[0].gl_texture = texture;
    second = scene;
    memcpy(second.meshes[SMALL_BOX].transform, moved, sizeof moved);
}

/* >>places: where a fault is possible

   A run reaches many places, most of them in loops. Places that the same chain of calls reaches behave alike, so only
   the first of them is tested. A recorded run without a fault finds them. A chain begins at the recorded call, so that
   a chain that was tested with one back end is not tested again with another. */

enum { MOST_PLACES = 4096, LONGEST_CHAIN = 64, MOST_SEEN = 8192 };

static struct {
    int recording, count;              /* count: number of places that the recorded run has reached */
    int depth;                         /* number of calls that are not part of a chain, since they surround it */
    fake_fault fault;
    uint64_t chains[MOST_PLACES];      /* hash of the chain of calls of each place */
    int chosen, numbers[MOST_PLACES];  /* numbers of the places to test, from 1; the last one is MOST_PLACES */
    int hits;                          /* number of tested places at which the fault happened */
    int seen_count;
    uint64_t seen[MOST_SEEN];          /* chains of earlier choices, each mixed with its fault and kind */
} places;

static void place_reached(fake_fault fault) {
    void *calls[LONGEST_CHAIN];
    uint64_t chain = 0;
    int i, count;
    if (!places.recording || fault != places.fault || places.count == MOST_PLACES) return;
    count = backtrace(calls, LONGEST_CHAIN) - places.depth;
    for (i = 0; i < count; i++) chain = (chain ^ (uint64_t)(uintptr_t)calls[i]) * 0x100000001b3u;
    if (fault == FAKE_LOOKUP) chain = (uint64_t)places.count;  /* each function counts */
    places.chains[places.count++] = chain;
}
static void allocation_reached(void) { place_reached(FAKE_NONE); }

/* Records the places of the calls until places_choose. FAKE_NONE stands for a failing allocation. */
static __attribute__((noinline)) void places_record(fake_fault fault) {
    void *calls[LONGEST_CHAIN];
    fake_disarm();
    fake.reached = place_reached;
    seen.reached = allocation_reached;
    places.depth = backtrace(calls, LONGEST_CHAIN) - 1;
    places.fault = fault;
    places.count = 0;
    places.recording = 1;
}

/* Returns 1 if the place number i + 1 is the first one with its chain, and no earlier choice has seen the key. */
static int place_is_new(int i, uint64_t key) {
    int k;
    for (k = 0; k < i && places.chains[k] != places.chains[i]; k++) continue;
    if (k < i) return 0;
    for (k = 0; k < places.seen_count && places.seen[k] != key; k++) continue;
    return k == places.seen_count;
}

/* Kinds of places. A chain is tested once in each kind. The first four kinds are those of every_place. */
enum { LARGER_PICTURE = 4, SLOW_KINDS, FIRST_INSPECTION = SLOW_KINDS, BAKE, SCENE_PROGRAMS, CREATION };

/* Chooses the places to test among those with chains of calls that differ and that no earlier choice has seen, and adds
   a place that no run reaches. Chooses every third one, starting with number `first` modulo 3; every fifth of the
   missing functions; and every sixth for the kinds that make a new context or bake for each place, which takes long.
   Returns the number of places that the run reached. */
static int places_choose(int first, int kind) {
    const int step = places.fault == FAKE_LOOKUP ? 5 : kind >= SLOW_KINDS ? 6 : 3;
    int i, different = 0;
    places.recording = 0;
    for (i = places.chosen = 0; i < places.count; i++) {
        const uint64_t key = (places.chains[i] ^ (uint64_t)(16 * kind + (int)places.fault)) * 0x100000001b3u;
        if (!place_is_new(i, key)) continue;
        if (different++ % step == first % step) places.numbers[places.chosen++] = i + 1;
        if (places.seen_count < MOST_SEEN) places.seen[places.seen_count++] = key;
    }
    CHECK(places.count < MOST_PLACES && places.seen_count < MOST_SEEN, "the places do not end");
    places.numbers[places.chosen] = MOST_PLACES;
    places.hits = 0;
    return places.count;
}

/* Counts a place that was tested, and checks the counts after the last place. index: of the place in places.numbers;
   hit: 1 if the fault happened there. A later run may have fewer places than the recorded run, because the library
   divides its work by the time that the work takes. */
static void place_tested(int index, int hit) {
    places.hits += hit;
    if (index < places.chosen) return;
    CHECK(!hit, "the fault happened past the end");
    CHECK(2 * places.hits >= places.chosen, "the fault happened at only %d of %d places", places.hits, places.chosen);
}

/* >>phases: calls that can fail; all calls before them have succeeded */

typedef enum phase {
    PHASE_SCENE,
    PHASE_MOVE,
    PHASE_BEGIN,
    PHASE_RENDER,
    PHASE_READ,
    PHASE_TEXTURE,
    PHASE_INSPECT,
    PHASE_GATHER,
    PHASES
} phase;
static const char *const phase_names[PHASES] = { "sbl_set_scene",      "sbl_set_mesh_transform", "sbl_begin",
                                                 "sbl_step",           "sbl_read_channel",       "sbl_channel_texture",
                                                 "sbl_inspect_sensor", "sbl_gather_readings" };

static small_picture picture;
static int replacing;
static float radiance[4 * 64 * 64], weights[64 * 64];
static sbl_sensor sensor, expected_sensor;
static float expected_radiance[4 * 64 * 64], expected_weights[64 * 64];
static sbl_sensor_ray expected_rays[2048];
static sbl_sensor_lamp expected_lamps[64];

enum { SITES = 3 };
static sbl_reading readings[SITES], expected_readings[SITES];

static sbl_result small_gather(sbl_context *context) {
    static const sbl_site sites[SITES] = { { { 1, 0, 0.5f }, { 0, 1, 0 }, { 0, 0, 0 }, 0 },
        { { 0, 0.7f, 0 }, { 0, 1, 0 }, { 0, 0, 0 }, 0 },
        /* the last site is inside the box: it sees back faces, so it gets a stuck test */
                                           { { 0, 0.3f, 0 }, { 1, 0, 0 }, { 0, 0, 0 }, 0 } };
    const sbl_picture_desc view = small_view();
    sbl_readings_desc desc = scene_readings(sites, readings, SITES, view.options.mode);
    memset(readings, 0, sizeof readings);
    desc.options.backend = view.options.backend;
    desc.options.rays = view.options.rays;
    desc.options.sensor_size = view.options.sensor_size;
    return sbl_gather_readings(context, &desc);
}

/* Compares sensors. Their arrays belong to the context, so only the contents are compared. */
static int sensor_same(void) {
    sbl_sensor a = sensor, b = expected_sensor;
    a.rays = b.rays = NULL;
    a.lamps = b.lamps = NULL;
    return memcmp(&a, &b, sizeof a) == 0 && memcmp(sensor.rays, expected_rays,
                                                   (size_t)a.ray_count * sizeof *sensor.rays) == 0 &&
           memcmp(sensor.lamps, expected_lamps, (size_t)a.lamp_count * sizeof *sensor.lamps) == 0 &&
           memcmp(radiance, expected_radiance, sizeof radiance) == 0 &&
               memcmp(weights, expected_weights, sizeof weights) == 0;
}

/* Makes the calls that must precede the phase. Returns 0 on failure. */
static int phase_prepare(sbl_context *context, phase p) {
    sbl_picture_desc view = small_view();
    /* sets the scene again, so that the tested call builds the data that is built once per scene */
    if (p == PHASE_RENDER) {
        sbl_scene_desc desc = scene_desc(&scene);
        return sbl_set_scene(context, &desc) == SBL_SUCCESS && sbl_begin_picture(context, &view) == SBL_SUCCESS;
    }
    if (p >= PHASE_READ) return sbl_render_picture(context, &view) == SBL_SUCCESS;
    return 1;
}

static sbl_result phase_run(sbl_context *context, phase p) {
    sbl_picture_desc view = small_view();
    sbl_scene_desc desc = scene_desc(&second);
    switch (p) {
        case PHASE_SCENE: return sbl_set_scene(context, &desc);
        case PHASE_MOVE: return sbl_set_mesh_transform(context, SMALL_BOX, moved);
        case PHASE_BEGIN: return sbl_begin_picture(context, &view);
        case PHASE_RENDER: return sbl_step(context, 0);
        case PHASE_READ: return small_read(context, &picture);
        case PHASE_TEXTURE: return sbl_channel_texture(context, SBL_CHANNEL_DEPTH) &&
                                   sbl_channel_texture(context, SBL_CHANNEL_SENSORS) ? SBL_SUCCESS : SBL_ERROR_GL;
        case PHASE_GATHER: return small_gather(context);
        default: return sbl_inspect_sensor(context, SMALL_WIDTH / 2, SMALL_HEIGHT - 1, &sensor, radiance, weights,
                                           64 * 64);
    }
}

/* Returns 1 if the result of the phase equals the result without faults. */
static int phase_right(sbl_context *context, phase p) {
    sbl_picture_desc view = small_view();
    if (p == PHASE_READ) return small_same(&picture, &expected);
    if (p == PHASE_INSPECT) return sensor_same();
    if (p == PHASE_GATHER) return memcmp(readings, expected_readings, sizeof readings) == 0;
    if (p == PHASE_BEGIN && sbl_step(context, 0) != SBL_SUCCESS) return 0;
    if ((p == PHASE_SCENE || p == PHASE_MOVE) && sbl_render_picture(context, &view) != SBL_SUCCESS) return 0;
    return small_read(context, &picture) == SBL_SUCCESS &&
           small_same(&picture, p == PHASE_SCENE || p == PHASE_MOVE ? &expected_moved : &expected);
}

/* After a fault, every function can be called: it succeeds, or reports that there is no picture. If only reading
   failed, or readings, which are dropped, then the finished picture still exists, and sbl_step has nothing to do. */
static void every_function(sbl_context *context, phase p, const char *fault, int place) {
    const sbl_result none = p >= PHASE_READ ? SBL_SUCCESS : SBL_ERROR_STATE;
    const sbl_result dropped = p == PHASE_GATHER ? SBL_ERROR_STATE : none;
    static small_picture read;
    const sbl_result step = sbl_step(context, 0), reading = small_read(context, &read),
        inspection = phase_run(context, PHASE_INSPECT);
    CHECK((step == SBL_SUCCESS || step == dropped) && (reading == SBL_SUCCESS || reading == none) &&
          (inspection == SBL_SUCCESS || inspection == none),
          "%s, %s %d: afterwards sbl_step gives \"%s\", sbl_read_channel \"%s\", sbl_inspect_sensor \"%s\"",
          phase_names[p], fault, place,
          sbl_result_string(step), sbl_result_string(reading), sbl_result_string(inspection));
    CHECK(p < PHASE_READ || (small_same(&read, &expected) && sensor_same()),
          "%s, %s %d: afterwards the picture or its sensor differs", phase_names[p], fault, place);
    CHECK(p < PHASE_READ || phase_run(context, PHASE_TEXTURE) == SBL_SUCCESS,
          "%s, %s %d: afterwards there is no texture", phase_names[p], fault, place);
    CHECK(small_gather(context) == SBL_SUCCESS && (p < PHASE_RENDER || phase_right(context, PHASE_GATHER)),
          "%s, %s %d: afterwards sbl_gather_readings fails, or differs", phase_names[p], fault, place);
    CHECK(p < PHASE_READ || (phase_run(context, PHASE_INSPECT) == SBL_SUCCESS && sensor_same()),
          "%s, %s %d: after a gather the sensor differs", phase_names[p], fault, place);
}

/* Checks that the context has its scene and renders its picture as before. First undoes the changes of a successful
   call. */
static void still_usable(sbl_context *context, phase p, int succeeded, const char *fault, int place) {
    sbl_picture_desc view = small_view();
    float low[3], high[3];
    static small_picture again;
    sbl_result result;
    /* also replaces a half-built scene */
    if ((succeeded && (p == PHASE_SCENE || p == PHASE_MOVE)) || (p == PHASE_RENDER && replacing)) {
        sbl_scene_desc desc = scene_desc(&scene);
        CHECK(sbl_set_scene(context, &desc) == SBL_SUCCESS, "%s, %s %d: the scene cannot be set again: %s",
              phase_names[p], fault, place, watch_last(&seen));
    }
    result = small_render(context, &view, &again);
    CHECK(result == SBL_SUCCESS && small_same(&again, &expected),
          "%s, %s %d: afterwards the context gives \"%s\", or the picture differs",
          phase_names[p], fault, place, sbl_result_string(result));
    CHECK(scene_bounds(context, low, high) && memcmp(low, bounds[0], sizeof low) == 0 &&
              memcmp(high, bounds[1], sizeof high) == 0,
          "%s, %s %d: the scene's bounds have changed", phase_names[p], fault, place);
}

/* Memory and GL objects in use after the known picture is finished. No fault may change these numbers. */
typedef struct usage { int blocks, objects[FAKE_KINDS]; size_t host, gpu; } usage;

static usage usage_take(sbl_context *context) {
    usage u;
    sbl_memory memory = sbl_query_memory(context);
    memset(&u, 0, sizeof u);
    u.blocks = seen.blocks;
    memcpy(u.objects, fake.live, sizeof u.objects);
    u.host = memory.host_bytes;
    u.gpu = memory.gpu_bytes;
    return u;
}

/* Arms a fault for the opportunity number `place` from now on. FAKE_NONE stands for a failing allocation. */
static void fault_arm(fake_fault fault, int place, GLenum error) {
    if (fault == FAKE_NONE) watch_refuse(&seen, place);
    else fake_arm(fault, place, error);
}

/* Disarms the fault. Returns 1 if it happened. */
static int fault_disarm(fake_fault fault) {
    const int hit = fault == FAKE_NONE ? seen.refused : fake.hits;
    seen.refuse_at = 0;
    fake_disarm();
    return hit;
}

/* Tests one fault at the places of one phase. Returns the number of places. */
static int every_place(sbl_context *context, phase p, fake_fault fault, GLenum error, sbl_result right,
                       const char *name) {
    usage start, end;
    sbl_picture_desc view = small_view();
    const int kind = (right == SBL_ERROR_GL) + 2 * replacing;
    int i, count, errors = test_errors;
    if (sbl_render_picture(context, &view) != SBL_SUCCESS) return 0;
    if (phase_run(context, PHASE_INSPECT) != SBL_SUCCESS || sbl_render_picture(context, &view) != SBL_SUCCESS)
        return 0; /* all programs already exist */
    start = usage_take(context);
    CHECK(phase_prepare(context, p), "%s, %s: cannot be prepared", phase_names[p], name);
    places_record(fault);
    CHECK(phase_run(context, p) == SBL_SUCCESS, "%s, %s: %s", phase_names[p], name, watch_last(&seen));
    count = places_choose((int)p + (int)fault + (right == SBL_ERROR_GL) + replacing, kind);
    still_usable(context, p, 1, name, 0);
    for (i = 0; i <= places.chosen && test_errors <= errors + 20; i++) {
        const int place = places.numbers[i];
        sbl_result result;
        int hit;
        if (!phase_prepare(context, p)) {
            CHECK(0, "%s, %s %d: cannot be prepared: %s", phase_names[p], name, place, watch_last(&seen));
            return count;
        }
        watch_forget(&seen);
        gl_state_take(&before);
        fault_arm(fault, place, error);
        result = phase_run(context, p);
        hit = fault_disarm(fault);
        gl_state_take(&after);
        CHECK(!gl_state_difference(&before, &after), "%s, %s %d changes GL state: %s", phase_names[p], name, place,
              gl_state_difference(&before, &after));
        CHECK(gl.GetError() == GL_NO_ERROR, "%s, %s %d leaves a GL error", phase_names[p], name, place);
        if (result == SBL_SUCCESS)
            CHECK(phase_right(context, p), "%s, %s %d: success, but the picture differs", phase_names[p], name,
                  place);
        else {
            CHECK(result == right || p == PHASE_TEXTURE, "%s, %s %d: \"%s\", expected \"%s\"", phase_names[p], name,
                  place,
                  sbl_result_string(result), sbl_result_string(right));
            CHECK(seen.errors > 0, "%s, %s %d fails without a message", phase_names[p], name, place);
        }
        place_tested(i, hit);
        if (p >= PHASE_READ || i % 3 == 1) every_function(context, p, name, place);
        still_usable(context, p, result == SBL_SUCCESS, name, place);
        end = usage_take(context);
        CHECK(start.blocks == end.blocks && start.host == end.host && start.gpu == end.gpu &&
              memcmp(start.objects, end.objects, sizeof end.objects) == 0,
              "%s, %s %d: in use %d blocks, %.0f and %.0f bytes, %d GL objects; before %d, %.0f, %.0f", phase_names[p],
              name, place, end.blocks,
              (double)end.host, (double)end.gpu, fake_live(), start.blocks, (double)start.host, (double)start.gpu);
    }
    return count;
}

static void every_phase(fake_fault fault, GLenum error, sbl_result right, const char *name, int least) {
    sbl_context_desc desc = faulty_desc();
    sbl_scene_desc first = scene_desc(&scene);
    sbl_context *context;
    int p, reached = 0, blocks = seen.blocks;
    fake_disarm();
    REQUIRE(sbl_create(&desc, &context) == SBL_SUCCESS && sbl_set_scene(context, &first) == SBL_SUCCESS, "%s",
            watch_last(&seen));
    for (p = 0; p < PHASES; p++) {
        if (small_mode == SBL_MODE_GI && p != PHASE_RENDER) continue;  /* only this phase fills the store */
        replacing = 0;
        reached += every_place(context, (phase)p, fault, error, right, name);
        replacing = 1;
        if (p == PHASE_RENDER && small_mode != SBL_MODE_GI)
            every_place(context, PHASE_RENDER, fault, error, right, name);
    }
    CHECK(reached >= least, "%s is possible at only %d places", name, reached);
    sbl_destroy(context);
    CHECK(seen.blocks == blocks && seen.strangers == 0, "%d blocks leaked, %d freed twice or never allocated",
          seen.blocks - blocks,
          seen.strangers);
    CHECK(fake_live() == 0 && fake.strangers == 0,
          "%d GL objects leaked (buffers %d, framebuffers %d, textures %d, arrays %d, programs %d, shaders %d), %d "
          "deleted twice or never made", fake_live(),
          fake.live[0], fake.live[1], fake.live[2], fake.live[3], fake.live[4], fake.live[5], fake.strangers);
}

/* Tests each kind of fault in every phase. */
TEST(allocations) { every_phase(FAKE_NONE, 0, SBL_ERROR_OUT_OF_MEMORY, "allocation", 20); }
TEST(calls_out_of_memory) {
    every_phase(FAKE_REFUSE, GL_OUT_OF_MEMORY, SBL_ERROR_OUT_OF_MEMORY, "GL_OUT_OF_MEMORY by call", 40);
}
TEST(calls_invalid) {
    every_phase(FAKE_REFUSE, GL_INVALID_OPERATION, SBL_ERROR_GL, "GL_INVALID_OPERATION by call", 40);
}
/* The first inspection compiles its programs. After a fault in it, the next inspection shows the sensor. */
TEST(first_inspections) {
    static const struct { fake_fault fault; GLenum error; int least; } faults[] = {
        { FAKE_NONE, 0, 8 }, { FAKE_ERROR, GL_OUT_OF_MEMORY, 3 }, { FAKE_COMPILE, 0, 1 }, { FAKE_NO_NAME, 0, 5 } };
    sbl_context_desc desc = faulty_desc();
    sbl_picture_desc view = small_view();
    sbl_scene_desc first = scene_desc(&scene);
    int i, k, failed;
    for (i = 0; i < (int)(sizeof faults / sizeof *faults); i++) {
        /* the first turn records the places */
        for (k = -1, failed = 0; k < 0 || k <= places.chosen; k++) {
            sbl_context *context;
            sbl_result result;
            fake_disarm();
            REQUIRE(sbl_create(&desc, &context) == SBL_SUCCESS && sbl_set_scene(context, &first) == SBL_SUCCESS &&
                        sbl_render_picture(context, &view) == SBL_SUCCESS,
                    "%s", watch_last(&seen));
            if (k < 0) places_record(faults[i].fault);
            else fault_arm(faults[i].fault, places.numbers[k], faults[i].error);
            result = phase_run(context, PHASE_INSPECT);
            if (k < 0)
                CHECK(places_choose(0, FIRST_INSPECTION) >= faults[i].least, "fault %d is possible at only %d places",
                      i, places.count);
            else place_tested(k, fault_disarm(faults[i].fault));
            CHECK(result != SBL_SUCCESS || sensor_same(), "fault %d, turn %d: success, but the sensor differs", i, k);
            failed += result != SBL_SUCCESS;
            result = phase_run(context, PHASE_INSPECT);
            CHECK(result == SBL_SUCCESS && sensor_same(), "fault %d, turn %d: afterwards \"%s\", or the sensor differs",
                  i, k, sbl_result_string(result));
            sbl_destroy(context);
        }
        CHECK((failed > 0 || !places.chosen) && failed <= places.chosen, "fault %d: %d of %d inspections failed", i,
              failed, places.chosen);
    }
}

TEST(errors_out_of_memory) {
    every_phase(FAKE_ERROR, GL_OUT_OF_MEMORY, SBL_ERROR_OUT_OF_MEMORY, "GL_OUT_OF_MEMORY at glGetError", 40);
}
TEST(no_names) { every_phase(FAKE_NO_NAME, 0, SBL_ERROR_GL, "no name by glGen", 20); }
TEST(framebuffers) { every_phase(FAKE_FRAMEBUFFER, 0, SBL_ERROR_GL, "framebuffer status", 5); }

/* Makes allocations fail that the small picture does not need: lists that grow with the number of sensors, and lists of
   sensors inside geometry. For the latter, a box floats above a floor by less than the offset of sensors, and is seen
   through the gap; see test_validity.c. */
static void larger_picture(const test_scene *s, const sbl_picture_desc *view, int stuck) {
    sbl_context_desc desc = faulty_desc();
    sbl_scene_desc first = scene_desc(s);
    sbl_context *context;
    int i, refused = 0, before_all = seen.blocks, blocks;
    REQUIRE(sbl_create(&desc, &context) == SBL_SUCCESS && sbl_set_scene(context, &first) == SBL_SUCCESS &&
                sbl_render_picture(context, view) == SBL_SUCCESS,
            "%s", watch_last(&seen));
    CHECK((sbl_query_stats(context).sensors.invalid > 0) == stuck, "%d sensors are invalid",
          (int)sbl_query_stats(context).sensors.invalid);
    sbl_end(context);
    blocks = seen.blocks;
    places_record(FAKE_NONE);
    CHECK(sbl_render_picture(context, view) == SBL_SUCCESS, "%s", watch_last(&seen));
    CHECK(places_choose(stuck, LARGER_PICTURE) > 10, "only %d allocations", places.count);
    sbl_end(context);
    for (i = 0; i <= places.chosen; i++) {
        sbl_result result;
        fault_arm(FAKE_NONE, places.numbers[i], 0);
        result = sbl_render_picture(context, view);
        CHECK(result == (fault_disarm(FAKE_NONE) ? SBL_ERROR_OUT_OF_MEMORY : SBL_SUCCESS), "allocation %d: \"%s\"",
              places.numbers[i], sbl_result_string(result));
        refused += result != SBL_SUCCESS;
        sbl_end(context);
        CHECK(seen.blocks == blocks, "allocation %d: %d blocks leaked", places.numbers[i], seen.blocks - blocks);
    }
    CHECK(2 * refused >= places.chosen, "only %d of %d allocations were refused", refused, places.chosen);
    sbl_destroy(context);
    CHECK(seen.blocks == before_all && fake_live() == 0, "%d blocks and %d GL objects leaked", seen.blocks - before_all,
          fake_live());
}

/* Allocations fail in a larger picture, and in one with sensors inside geometry. */
TEST(allocations_of_larger_pictures) {
    const float slope = 3e-5f;
    test_scene gap = { 0 };
    sbl_picture_desc view = small_view();
    int grey = scene_material(&gap, 0.5f, 0.5f, 0.5f);
    view.width = 64;
    view.height = 48;
    view.tile = 1;
    view.samples = 1;
    view.options.sensor_size = 4;
    larger_picture(&scene, &view, 0);
    scene_floor(&gap, grey, 0, 10);
    scene_box(&gap, grey, -1, small_backend == SBL_BACKEND_TRACE ? 4e-5f : 2.3e-5f, -1, 1, 1, 1);
    scene_sky(&gap, 0, 1, 0);
    view.width = 8;
    view.height = 64;
    view.options.sensor_size = 16;
    sbl_look_at(view.world_to_view, -1.2f - 3, 3 * slope, 0, -1.2f, 0, 0, 0, 1, 0);  /* seen at a grazing angle */
    memset(view.view_to_clip, 0, sizeof view.view_to_clip);
    view.view_to_clip[0] = 2;
    view.view_to_clip[5] = 1 / slope;
    view.view_to_clip[10] = -1;
    view.view_to_clip[15] = 1;
    larger_picture(&gap, &view, 1);
    scene_free(&gap);
}

/* >>bakes: a lightmap with all options, vertices, probes */

enum { BAKE_LIGHTMAP, BAKE_VERTICES, BAKE_PROBES, BAKES };
enum { MAP = 8, BAKE_FLOATS = 18 * MAP * MAP };

static float baked[BAKE_FLOATS];

static void bake_room(test_scene *s) {
    static const float left[8] = { 0.05f, 0.1f, 0.45f, 0.1f, 0.45f, 0.9f, 0.05f, 0.9f },
        right[8] = { 0.55f, 0.1f, 0.95f, 0.1f, 0.95f, 0.9f, 0.55f, 0.9f };
    int material;
    memset(s, 0, sizeof *s);
    material = scene_material(s, 0.5f, 0.5f, 0.5f);
    scene_quad(s, material, -1, 0, -1, -1, 0, 1, 0, 0, 1, 0, 0, -1)->lightmap_texcoords.data = left;
    scene_quad(s, material, 0, 0, -1, 0, 0, 1, 1, 0, 1, 1, 0, -1)->lightmap_texcoords.data = right;
    scene_quad(s, scene_lamp(s, 5, 5, 5), -0.3f, 1, -0.3f, 0.3f, 1, -0.3f, 0.3f, 1, 0.3f, -0.3f, 1, 0.3f);
    scene_sky(s, 0.1f, 0.2f, 0.3f);
}

static sbl_result bake_one(sbl_context *context, int kind) {
    static sbl_probe probes[2];
    sbl_result result;
    memset(baked, 0, sizeof baked);
    if (kind == BAKE_LIGHTMAP) {
        sbl_lightmap_desc map;
        int channel;
        memset(&map, 0, sizeof map);
        map.width = map.height = MAP;
        map.directional = 1;
        map.supersample = 2;
        map.gutter = 2;
        map.options.rays = 16;
        map.options.mode = SBL_MODE_DIRECT;
        result = sbl_bake_lightmap(context, &map);
        for (channel = 0; channel < 6 && result == SBL_SUCCESS; channel++)
            result = sbl_read_channel(context, channel < 4 ? (sbl_channel)(SBL_CHANNEL_SH_0 + channel) : channel == 4
                                      ? SBL_CHANNEL_FINAL : SBL_CHANNEL_RADIANCE,
                                      baked + 3 * MAP * MAP * channel, 3 * MAP * MAP);
    } else if (kind == BAKE_VERTICES) {
        sbl_vertices_desc light;
        memset(&light, 0, sizeof light);
        light.radiance = baked;
        light.float_count = BAKE_FLOATS;
        light.options.rays = 8;
        light.options.mode = SBL_MODE_DIRECT;
        result = sbl_bake_vertices(context, &light);
    } else {
        sbl_probes_desc desc;
        memset(&desc, 0, sizeof desc);
        desc.probes = probes;
        desc.grid[0] = 2;
        desc.grid[1] = desc.grid[2] = 1;
        desc.options.rays = 64;
        desc.options.mode = SBL_MODE_DIRECT;
        result = sbl_bake_probes(context, &desc);
        memcpy(baked, probes, sizeof probes);
    }
    return result;
}

TEST(bakes) {
    static const struct { fake_fault fault; GLenum error; sbl_result right; } faults[] = {
        { FAKE_NONE, 0, SBL_ERROR_OUT_OF_MEMORY }, { FAKE_ERROR, GL_OUT_OF_MEMORY, SBL_ERROR_OUT_OF_MEMORY },
        { FAKE_REFUSE, GL_INVALID_OPERATION, SBL_ERROR_GL },
        { FAKE_NO_NAME, 0, SBL_ERROR_GL }, { FAKE_FRAMEBUFFER, 0, SBL_ERROR_GL } };
    static float right[BAKE_FLOATS];
    sbl_context_desc desc = faulty_desc();
    test_scene room;
    sbl_scene_desc bare;
    int i, k, kind, lit, blocks = seen.blocks;
    bake_room(&room);
    bare = scene_desc(&room);
    for (kind = 0; kind < BAKES; kind++) {
        sbl_context *context;
        usage start, end;
        fake_disarm();
        REQUIRE(sbl_create(&desc, &context) == SBL_SUCCESS && sbl_set_scene(context, &bare) == SBL_SUCCESS &&
                bake_one(context, kind) == SBL_SUCCESS, "%s",
                watch_last(&seen));
        memcpy(right, baked, sizeof right);
        CHECK(bake_one(context, kind) == SBL_SUCCESS && memcmp(baked, right, sizeof right) == 0,
              "kind %d: a second bake differs",
              kind);
        for (i = lit = 0; i < BAKE_FLOATS; i++) lit += right[i] > 0;
        CHECK(lit > 20, "kind %d: only %d values are lit", kind, lit);
        start = usage_take(context);
        for (i = 0; i < (int)(sizeof faults / sizeof *faults); i++) {
            /* Setting the scene again makes each bake build the data that is built once per scene. */
            CHECK(sbl_set_scene(context, &bare) == SBL_SUCCESS, "%s", watch_last(&seen));
            places_record(faults[i].fault);
            CHECK(bake_one(context, kind) == SBL_SUCCESS, "%s", watch_last(&seen));
            CHECK(places_choose(kind + i, BAKE) > (faults[i].fault == FAKE_FRAMEBUFFER ? 0 : 6), "kind %d, fault %d is "
                  "possible at only %d places", kind, i, places.count);
            for (k = 0; k <= places.chosen && test_errors <= 20; k++) {
                sbl_result result;
                CHECK(sbl_set_scene(context, &bare) == SBL_SUCCESS, "%s", watch_last(&seen));
                watch_forget(&seen);
                gl_state_take(&before);
                fault_arm(faults[i].fault, places.numbers[k], faults[i].error);
                result = bake_one(context, kind);
                place_tested(k, fault_disarm(faults[i].fault));
                gl_state_take(&after);
                CHECK(!gl_state_difference(&before, &after), "kind %d, fault %d at %d changes GL state: %s", kind, i,
                      places.numbers[k], gl_state_difference(&before, &after));
                if (result == SBL_SUCCESS)
                    CHECK(memcmp(baked, right, sizeof right) == 0,
                          "kind %d, fault %d at %d: success, but the light differs", kind, i, places.numbers[k]);
                else CHECK(result == faults[i].right && seen.errors > 0, "kind %d, fault %d at %d: \"%s\", %d messages",
                           kind, i, places.numbers[k], sbl_result_string(result), seen.errors);
                result = bake_one(context, kind);
                CHECK(result == SBL_SUCCESS && memcmp(baked, right, sizeof right) == 0,
                      "kind %d, fault %d at %d: afterwards \"%s\", or the light differs", kind, i, places.numbers[k],
                      sbl_result_string(result));
                end = usage_take(context);
                CHECK(start.blocks == end.blocks && start.host == end.host && start.gpu == end.gpu &&
                      memcmp(start.objects, end.objects, sizeof end.objects) == 0,
                      "kind %d, fault %d at %d: in use %d blocks, %.0f and %.0f bytes; before %d, %.0f, %.0f", kind, i,
                      places.numbers[k], end.blocks, (double)end.host, (double)end.gpu, start.blocks,
                      (double)start.host, (double)start.gpu);
            }
        }
        sbl_destroy(context);
    }
    CHECK(seen.blocks == blocks && fake_live() == 0, "%d blocks and %d GL objects leaked", seen.blocks - blocks,
          fake_live());
    scene_free(&room);
}

/* A scene beyond the limit of buffer textures needs other programs, which its first picture compiles. After a fault,
   the next attempt succeeds, and so does the previous scene. */
TEST(scene_programs) {
    static const struct { fake_fault fault; GLenum error; sbl_result right; int least; } faults[] = {
        { FAKE_COMPILE, 0, SBL_ERROR_GL, 3 }, { FAKE_LINK, 0, SBL_ERROR_GL, 3 }, { FAKE_NO_NAME, 0, SBL_ERROR_GL, 10 },
        { FAKE_REFUSE, GL_OUT_OF_MEMORY, SBL_ERROR_OUT_OF_MEMORY, 10 } };
    sbl_context_desc desc = faulty_desc();
    sbl_picture_desc view = small_view();
    test_scene ball = { 0 };
    sbl_scene_desc fits = scene_desc(&scene), past;
    static small_picture of_past;
    int i, k, known = 0;
    scene_sphere(&ball, scene_lamp(&ball, 1, 2, 3), 0, 0, 0, 2, 12, 8, 1);
    past = scene_desc(&ball);
    fake.most_texels = 100;
    for (i = 0; i < (int)(sizeof faults / sizeof *faults); i++)
        for (k = -1; k < 0 || k <= places.chosen; k++) {  /* the first turn records the places */
            const int place = k < 0 ? 0 : places.numbers[k];
            sbl_context *context;
            int faulty = 0;
            sbl_result result;
            fake_disarm();
            REQUIRE(sbl_create(&desc, &context) == SBL_SUCCESS && sbl_set_scene(context, &fits) == SBL_SUCCESS &&
                        sbl_render_picture(context, &view) == SBL_SUCCESS &&
                        sbl_set_scene(context, &past) == SBL_SUCCESS,
                    "%s", watch_last(&seen));
            watch_forget(&seen);
            if (k < 0) places_record(faults[i].fault);
            else fake_arm(faults[i].fault, place, faults[i].error);
            result = sbl_render_picture(context, &view);
            if (k < 0)
                CHECK(places_choose(i, SCENE_PROGRAMS) >= faults[i].least, "fault %d is possible at only %d places", i,
                      places.count);
            else place_tested(k, faulty = fake.hits);
            fake_disarm();
            CHECK(result == (faulty ? faults[i].right : SBL_SUCCESS), "fault %d at %d: \"%s\"", i, place,
                  sbl_result_string(result));
            CHECK(!faulty || seen.errors > 0, "fault %d at %d: no message", i, place);
            CHECK(small_render(context, &view, &picture) == SBL_SUCCESS && (!known || small_same(&picture, &of_past)),
                  "fault %d at %d: afterwards the picture fails or differs", i, place);
            if (!known) of_past = picture;
            known = 1;
            CHECK(sbl_set_scene(context, &fits) == SBL_SUCCESS &&
                  small_render(context, &view, &picture) == SBL_SUCCESS && small_same(&picture, &expected),
                  "fault %d at %d: the former scene's picture differs", i, place);
            sbl_destroy(context);
            CHECK(fake_live() == 0 && fake.strangers == 0,
                  "fault %d at %d: %d GL objects leaked, %d deleted twice or never made", i, place, fake_live(),
                  fake.strangers);
        }
    fake.most_texels = 0;
    scene_free(&ball);
}

/* If a driver has too few texture units for a program, the program is refused by name, instead of drawing without some
   of its textures. A driver with exactly as many units as textures is not refused. */
TEST(too_few_texture_units) {
    sbl_context_desc desc = faulty_desc();
    sbl_scene_desc fits = scene_desc(&scene);
    sbl_picture_desc view = small_view();
    int least = 0, refused = 0;
    fake_disarm();
    desc.compile_ahead = 0;
    for (fake.units = 1; fake.units <= 16; fake.units++) {
        sbl_context *context = NULL;
        const char *at;
        sbl_result result;
        watch_forget(&seen);
        result = sbl_create(&desc, &context);
        if (result == SBL_SUCCESS) result = sbl_set_scene(context, &fits);
        if (result == SBL_SUCCESS) result = small_render(context, &view, &picture);
        if (result == SBL_SUCCESS) {
            CHECK(small_same(&picture, &expected), "%d units: the picture differs", fake.units);
            if (!least) least = fake.units;
        } else {
            CHECK(result == SBL_ERROR_UNSUPPORTED && !least, "%d units: \"%s\"", fake.units, sbl_result_string(result));
            CHECK(
                watch_said(&seen, SBL_LOG_ERROR, SBL_LOG_ITEM_TOO_LARGE, "the program \"", "textures", "texture units"),
                "%d units: %s", fake.units, watch_last(&seen));
            at = strstr(watch_last(&seen), "reads ");
            CHECK(at && atoi(at + 6) > fake.units, "%d units: %s", fake.units, watch_last(&seen));
            refused++;
        }
        sbl_destroy(context);
        CHECK(fake_live() == 0 && fake.strangers == 0, "%d units: %d GL objects leaked", fake.units, fake_live());
    }
    fake.units = 0;
    printf("  a picture needs %d texture units\n", least);
    CHECK(least > 4 && least <= inside_guard_units() && refused == least - 1,
          "%d units suffice, but there were %d refusals", least,
          refused);
}

/* >>faults in sbl_create */

static void every_creation(fake_fault fault, GLenum error, sbl_result right, const char *name, int least) {
    const int first = error == GL_INVALID_OPERATION ? 3 : 0;  /* the two errors are tested at different places */
    sbl_context_desc desc = faulty_desc();
    sbl_context *whole;
    int i, optional = 0, blocks = seen.blocks;
    desc.compile_ahead = 1;
    places_record(fault);
    CHECK(sbl_create(&desc, &whole) == SBL_SUCCESS, "%s", watch_last(&seen));
    CHECK(places_choose(first, CREATION + (right == SBL_ERROR_GL)) >= least, "%s is possible at only %d places", name,
          places.count);
    sbl_destroy(whole);
    for (i = 0; i <= places.chosen; i++) {
        const int place = places.numbers[i];
        sbl_context *context = (sbl_context *)&seen;
        sbl_result result;
        int hit;
        watch_forget(&seen);
        gl_state_take(&before);
        fault_arm(fault, place, error);
        result = sbl_create(&desc, &context);
        hit = fault_disarm(fault);
        gl_state_take(&after);
        CHECK(!gl_state_difference(&before, &after), "%s %d changes GL state: %s", name, place,
              gl_state_difference(&before, &after));
        if (result == SBL_SUCCESS) {  /* the context must be fully usable */
            sbl_scene_desc desc_of_scene = scene_desc(&scene);
            sbl_picture_desc view = small_view();
            CHECK(sbl_set_scene(context, &desc_of_scene) == SBL_SUCCESS && small_render(context, &view, &picture) ==
                  SBL_SUCCESS &&
                  small_same(&picture, &expected),
                  "%s %d: sbl_create gives success, but the context does not work: %s", name, place, watch_last(&seen));
            sbl_destroy(context);
        } else {
            CHECK(result == right, "%s %d: \"%s\", expected \"%s\"", name, place, sbl_result_string(result),
                  sbl_result_string(right));
            CHECK(context == NULL, "%s %d: sbl_create failed, but returned a context", name, place);
            CHECK(seen.errors > 0, "%s %d fails without a message", name, place);
            if (fault == FAKE_LOOKUP)
                CHECK(watch_said(&seen, SBL_LOG_ERROR, SBL_LOG_ITEM_GL_FUNCTION_MISSING, fake.lookup, NULL, NULL),
                      "no message mentions %s: %s",
                      fake.lookup, watch_last(&seen));
        }
        optional += fault == FAKE_LOOKUP && hit && result == SBL_SUCCESS;
        if (fault == FAKE_LOOKUP && hit)
            CHECK((result == SBL_SUCCESS) == inside_gl_is_optional(fake.lookup), "without %s: \"%s\"", fake.lookup,
                  sbl_result_string(result));
        CHECK(seen.blocks == blocks && seen.strangers == 0, "%s %d: %d blocks leaked", name, place,
              seen.blocks - blocks);
        CHECK(fake_live() == 0 && fake.strangers == 0, "%s %d: %d GL objects leaked, %d deleted twice or never made",
              name, place,
              fake_live(), fake.strangers);
        place_tested(i, hit);
    }
    CHECK(fault != FAKE_LOOKUP || optional > 1, "%d of the missing functions were optional", optional);
}

/* Tests each kind of fault in sbl_create. */
TEST(create_functions_missing) { every_creation(FAKE_LOOKUP, 0, SBL_ERROR_UNSUPPORTED, "function", 80); }
TEST(create_allocations) { every_creation(FAKE_NONE, 0, SBL_ERROR_OUT_OF_MEMORY, "allocation", 0); }
TEST(create_no_names) { every_creation(FAKE_NO_NAME, 0, SBL_ERROR_GL, "no name", 1); }
TEST(create_errors) {
    every_creation(FAKE_ERROR, GL_OUT_OF_MEMORY, SBL_ERROR_OUT_OF_MEMORY, "GL_OUT_OF_MEMORY", 8);
    every_creation(FAKE_ERROR, GL_INVALID_OPERATION, SBL_ERROR_GL, "GL_INVALID_OPERATION", 8);
}
TEST(create_shaders) {
    every_creation(FAKE_COMPILE, 0, SBL_ERROR_GL, "shader", 14);
    every_creation(FAKE_LINK, 0, SBL_ERROR_GL, "program", 7);
}

static sbl_gl_function knows_nothing(const char *name, void *user) { (void)name; ++*(int *)user; return NULL; }

/* If no GL function is found, each missing function is reported. */
TEST(create_without_any_function) {
    sbl_context_desc desc = faulty_desc();
    sbl_context *context = NULL;
    int calls = 0, blocks = seen.blocks;
    desc.get_gl_function = knows_nothing;
    desc.gl_user = &calls;
    watch_forget(&seen);
    CHECK(sbl_create(&desc, &context) == SBL_ERROR_UNSUPPORTED && !context,
          "a loader without any function is accepted");
    CHECK(calls > 80 && seen.errors >= calls - 1, "%d functions were requested, %d reported missing", calls,
          seen.errors);
    CHECK(seen.blocks == blocks, "%d blocks leaked", seen.blocks - blocks);
}

/* Some Windows drivers return small numbers from -1 to 3 for functions that they lack. */
static intptr_t answer;
static sbl_gl_function answering_proc(const char *name, void *user) {
    return strcmp(name, "glCreateShader") == 0 ? (sbl_gl_function)answer : gl_host_proc(name, user);
}

/* Small numbers instead of function pointers count as missing functions. */
TEST(create_with_answers_that_are_no_functions) {
    sbl_context_desc desc = faulty_desc();
    sbl_context *context = NULL;
    desc.get_gl_function = answering_proc;
    for (answer = -1; answer <= 3; answer++) {
        watch_forget(&seen);
        CHECK(sbl_create(&desc, &context) == SBL_ERROR_UNSUPPORTED && !context,
              "the value %d is accepted as a function",
              (int)answer);
        CHECK(watch_said(&seen, SBL_LOG_ERROR, SBL_LOG_ITEM_GL_FUNCTION_MISSING, "glCreateShader", NULL, NULL),
              "%d: %s", (int)answer, watch_last(&seen));
    }
}

/* A driver that accepts a call and does nothing or something wrong. */
static const char *idle_function;
static void idle_draw(GLenum mode, GLint first, GLsizei count, GLsizei instances) {
    (void)mode; (void)first; (void)count; (void)instances;
}
static void idle_dispatch(GLuint x, GLuint y, GLuint z) { (void)x; (void)y; (void)z; }

static void APIENTRY clear_to_one(GLenum what, GLint index, const GLuint *value) {
    static const GLuint ones[4] = { 1, 1, 1, 1 };
    (void)value;
    ((PFNGLCLEARBUFFERUIVPROC)gl_host_proc("glClearBufferuiv", NULL))(what, index, ones);
}
static GLint APIENTRY forget_epsilon(GLuint program, const GLchar *name) {
    return strcmp(name, "epsilon") ? gl.GetUniformLocation(program, name) : -1;
}

static sbl_gl_function idle_proc(const char *name, void *user) {
    if (strcmp(name, idle_function)) return fake_proc(name, user);
    return strcmp(name, "glClearBufferuiv") == 0        ? (sbl_gl_function)clear_to_one
           : strcmp(name, "glGetUniformLocation") == 0  ? (sbl_gl_function)forget_epsilon
           : strcmp(name, "glDrawArraysInstanced") == 0 ? (sbl_gl_function)idle_draw
                                                        : (sbl_gl_function)idle_dispatch;
}

/* The trial in sbl_create finds drivers whose draws or dispatches have no effect, that show something beside the
   triangle, or that lose the ambient light of its surface. */
TEST(create_with_a_driver_that_draws_wrong) {
    static const struct { const char *function, *words; uint32_t disabled; } ways[] = {
        { "glDrawArraysInstanced", "does not draw a known triangle", 0 },
        { "glDrawArraysInstanced", "does not draw a known triangle", SBL_CAPABILITY_ALL },
        { "glDispatchCompute", "traces a known ray", 0 }, { "glClearBufferuiv", "does not draw a known triangle", 0 },
        { "glGetUniformLocation", "traces a known ray", 0 } };
    sbl_context_desc desc = faulty_desc();
    sbl_context *context;
    int i, blocks = seen.blocks;
    fake_disarm();
    desc.get_gl_function = idle_proc;
    for (i = 0; i < 5; i++) {
        sbl_result result;
        idle_function = ways[i].function;
        desc.disabled = ways[i].disabled;
        watch_forget(&seen);
        result = sbl_create(&desc, &context);
        if (i == 2 && result == SBL_SUCCESS && !(sbl_query_capabilities(context).available & SBL_CAPABILITY_COMPUTE)) {
            sbl_destroy(context);
            continue;
        }
        CHECK(result == SBL_ERROR_GL && strstr(watch_last(&seen), ways[i].words) &&
              strstr(watch_last(&seen), (const char *)gl.GetString(GL_RENDERER)),
              "without %s: \"%s\", \"%s\"", ways[i].function, sbl_result_string(result), watch_last(&seen));
    }
    CHECK(seen.blocks == blocks && fake_live() == 0, "%d blocks and %d GL objects leaked", seen.blocks - blocks,
          fake_live());
}

/* GL versions below 3.3, and OpenGL ES, are refused. */
TEST(create_old_gl) {
    static const struct { const char *version; int major, minor;
        } old[] = { { "2.1 Mesa", 2, 1 }, { "3.2 (Core Profile)", 3, 2 }, { "OpenGL ES 3.2 Mesa", 3, 2 },
            { "OpenGL ES 4.6", 4, 6 } };
    sbl_context_desc desc = faulty_desc();
    sbl_context *context = NULL;
    int i, blocks = seen.blocks;
    for (i = 0; i < 4; i++) {
        fake.version = old[i].version;
        fake.major = old[i].major;
        fake.minor = old[i].minor;
        watch_forget(&seen);
        CHECK(sbl_create(&desc, &context) == SBL_ERROR_UNSUPPORTED && !context, "\"%s\" is accepted", old[i].version);
        CHECK(watch_said(&seen, SBL_LOG_ERROR, SBL_LOG_ITEM_NO_GL, old[i].version, "3.3", NULL), "\"%s\": %s",
              old[i].version, watch_last(&seen));
    }
    fake.version = NULL;
    fake.major = fake.minor = 0;
    CHECK(seen.blocks == blocks && fake_live() == 0, "%d blocks and %d GL objects leaked", seen.blocks - blocks,
          fake_live());
}

/* A GL error that never ends, as a lost context reports it. */
static GLenum APIENTRY lost(void) { return 0x0507; }
static int lose;
static sbl_gl_function losing_proc(const char *name, void *user) {
    return lose && strcmp(name, "glGetError") == 0 ? (sbl_gl_function)lost : gl_host_proc(name, user);
}

/* A lost GL context is refused and leaks nothing. */
TEST(context_lost) {
    sbl_context_desc desc = faulty_desc();
    sbl_context *context = NULL;
    int blocks = seen.blocks;
    desc.get_gl_function = losing_proc;
    lose = 1;
    watch_forget(&seen);
    CHECK(sbl_create(&desc, &context) == SBL_ERROR_GL && !context && seen.errors > 0, "a lost context is accepted");
    lose = 0;
    CHECK(seen.blocks == blocks, "%d blocks leaked", seen.blocks - blocks);
    while (gl.GetError() != GL_NO_ERROR) {}
}

/* Renders the references of a back end without faults. Returns 0 on failure. */
static int references(sbl_backend backend) {
    sbl_context_desc desc = faulty_desc();
    sbl_scene_desc first = scene_desc(&scene), other = scene_desc(&second);
    sbl_picture_desc view;
    sbl_context *context;
    int good;
    small_backend = backend;
    view = small_view();
    fake_disarm();
    if (sbl_create(&desc, &context) != SBL_SUCCESS) return 0;
    good = sbl_set_scene(context, &first) == SBL_SUCCESS && small_render(context, &view, &expected) == SBL_SUCCESS &&
           sbl_query_stats(context).backend == backend &&
           sbl_inspect_sensor(context, SMALL_WIDTH / 2, SMALL_HEIGHT - 1, &expected_sensor, expected_radiance,
                              expected_weights, 64 * 64) == SBL_SUCCESS &&
           expected_sensor.ray_count > 0 && expected_sensor.ray_count <= 2048 && expected_sensor.lamp_count > 0 &&
           expected_sensor.lamp_count <= 64 && small_gather(context) == SBL_SUCCESS &&
           memcpy(expected_readings, readings, sizeof readings) && readings[0].radiance[0] > 0 &&
           readings[2].back_share > 0.5f &&
           memcpy(expected_rays, expected_sensor.rays, (size_t)expected_sensor.ray_count * sizeof *expected_rays) &&
           memcpy(expected_lamps, expected_sensor.lamps, (size_t)expected_sensor.lamp_count * sizeof *expected_lamps) &&
           scene_bounds(context, bounds[0], bounds[1]) && sbl_set_scene(context, &other) == SBL_SUCCESS &&
           small_render(context, &view, &expected_moved) == SBL_SUCCESS && small_plausible(&expected) &&
           !small_same(&expected, &expected_moved);
    sbl_destroy(context);
    return good && fake.made >= 20 && fake_live() == 0;
}

int main(void) {
    if (!gl_host_open()) { printf("no GL context\n"); return 1; }
    scenes_make();
    if (!references(SBL_BACKEND_RASTER)) {
        printf("without faults: %s; %d GL objects made, %d left\n", watch_last(&seen), fake.made, fake_live());
        return 1;
    }
    RUN(create_functions_missing);
    RUN(create_allocations);
    RUN(create_no_names);
    RUN(create_errors);
    RUN(create_shaders);
    RUN(create_without_any_function);
    RUN(create_with_answers_that_are_no_functions);
    RUN(create_with_a_driver_that_draws_wrong);
    RUN(create_old_gl);
    RUN(context_lost);
    RUN(allocations);
    RUN(calls_out_of_memory);
    RUN(calls_invalid);
    RUN(errors_out_of_memory);
    RUN(first_inspections);
    RUN(no_names);
    RUN(framebuffers);
    RUN(allocations_of_larger_pictures);
    printf("traced:\n");
    if (!references(SBL_BACKEND_TRACE)) {
        printf("without faults: %s; %d GL objects made, %d left\n", watch_last(&seen), fake.made, fake_live());
        return 1;
    }
    RUN(allocations);
    RUN(calls_out_of_memory);
    RUN(calls_invalid);
    RUN(errors_out_of_memory);
    RUN(first_inspections);
    RUN(no_names);
    RUN(framebuffers);
    RUN(allocations_of_larger_pictures);
    RUN(scene_programs);
    RUN(too_few_texture_units);
    if (getenv("MESA_GL_VERSION_OVERRIDE")) goto wide;  /* an older GL has the same places */
    RUN(bakes);
    printf("with bounced light:\n");
    small_mode = SBL_MODE_GI;
    if (!references(SBL_BACKEND_TRACE)) {
        printf("without faults: %s; %d GL objects made, %d left\n", watch_last(&seen), fake.made, fake_live());
        return 1;
    }
    RUN(allocations);
    RUN(calls_out_of_memory);
    RUN(no_names);
    RUN(framebuffers);
    RUN(too_few_texture_units);
    small_mode = SBL_MODE_AMBIENT;
wide:
    printf("traced, with a scene that exceeds the limit of buffer textures:\n");
    fake.most_texels = 50;
    if (!references(SBL_BACKEND_TRACE)) {
        printf("without faults: %s; %d GL objects made, %d left\n", watch_last(&seen), fake.made, fake_live());
        return 1;
    }
    RUN(calls_out_of_memory);
    RUN(no_names);
    scene_free(&scene);
    return test_report();
}
