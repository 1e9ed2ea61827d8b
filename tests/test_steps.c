/* Tests of pictures in steps. Every stage is divided into pieces; the size of GL submissions follows the limit;
   programs are compiled when they are first used, or all at the start; unfinished pictures can be read; finished
   pictures stay readable. No test depends on the real time: the tests count pieces, or give sbl.h a clock that advances
   by a fixed amount per call. */
#include "support/private.h"
#include <sys/time.h>
#include "support/test.h"
#include "support/scenes.h"
#include "support/gl_watch.h"
#include "support/gl_host.h"
#include "support/gl_fake.h"

enum { WIDTH = 160, HEIGHT = 120, PIXELS = WIDTH * HEIGHT };

static watch seen;
static test_scene cornell;

static long clock_tick, clock_now;  /* in microseconds; a tick of 0: the real time is used */

/* The linker replaces gettimeofday by __wrap_gettimeofday; see scripts/Makefile. */
int __real_gettimeofday(struct timeval *out, void *zone);
int __wrap_gettimeofday(struct timeval *out, void *zone);
int __wrap_gettimeofday(struct timeval *out, void *zone) {
    if (!clock_tick) return __real_gettimeofday(out, zone);
    clock_now += clock_tick;
    out->tv_sec = clock_now / 1000000;
    out->tv_usec = clock_now % 1000000;
    return 0;
}

static sbl_picture_desc view_of(sbl_backend backend) {
    sbl_picture_desc view = scene_cornell_view(WIDTH, HEIGHT);
    view.options.mode = SBL_MODE_AMBIENT;
    view.options.epsilon = 0.1f;
    view.options.backend = backend;
    view.options.rays = 24;
    view.options.sensor_size = 16;
    view.samples = 3;
    return view;
}

/* >>pieces of work */

/* With very short time slices, every stage takes several steps. sbl_begin neither allocates textures nor compiles. */
TEST(every_stage_comes_in_pieces) {
    enum { FILTERS = SBL__PICTURE_DONE, SENSES };  /* parts of stages that the test counts separately */
    static const struct { int stage; int least; const char *name;
    } stages[] = { { SBL__MAP_SURFACE, 4, "the G-buffer" },
                   { SBL__MAP_READ, 1, "reading it" },
                   { SENSES, 100, "sensors" },
                   { FILTERS, 3, "the filter" },
                   { SBL__PICTURE_SAMPLE, 6, "samples' G-buffers" },
                   { SBL__PICTURE_RESOLVE, 6, "resolving" } };
    sbl_context_desc desc = watch_desc(&seen);
    sbl_picture_desc view = view_of(SBL_BACKEND_TRACE);
    sbl_context *context = watch_context(&seen, &desc, &cornell);
    sbl_result result = SBL_UNFINISHED;
    int counts[SENSES + 1] = { 0 }, steps = 0, i;
    size_t gpu;
    if (!context) return;
    view.width = 640;
    view.height = 480;
    view.tile = 64;
    view.threshold = 10;
    gpu = sbl_query_memory(context).gpu_bytes;
    i = sbl_query_programs(context).compiled;
    REQUIRE(sbl_begin_picture(context, &view) == SBL_SUCCESS, "cannot begin");
    CHECK(sbl_query_memory(context).gpu_bytes == gpu && sbl_query_programs(context).compiled == i,
          "sbl_begin makes textures or compiles");
    while (result == SBL_UNFINISHED && steps++ < 1000000) {
        const sbl__map *map = &context->picture.map;
        const int filters = map->work.stages.stage == SBL__MAP_DEVELOP && map->developing.stage == SBL__DEVELOP_FILTER;
        const int senses = map->work.stages.stage == SBL__MAP_REFINE && sbl__refine_is_sensing(&map->refine);
        counts[filters ? FILTERS : senses ? SENSES : map->work.stages.stage]++;
        result = sbl_step(context, 1e-9);
    }
    CHECK(result == SBL_SUCCESS, "no picture: %s", watch_last(&seen));
    for (i = 0; i < (int)(sizeof stages / sizeof *stages); i++)
        CHECK(counts[stages[i].stage] >= stages[i].least, "%s took only %d steps", stages[i].name,
              counts[stages[i].stage]);
    sbl_destroy(context);
}

/* The hierarchy and the lamps of 18,000 triangles are prepared in many steps. */
TEST(the_hierarchy_comes_in_pieces) {
    test_scene s = { 0 };
    sbl_context_desc desc = watch_desc(&seen);
    sbl_context *context = NULL;
    sbl_scene_desc scene;
    sbl_picture_desc view = view_of(SBL_BACKEND_TRACE);
    sbl_result result = SBL_UNFINISHED;
    int steps = 0, before = 0;
    scene_sphere(&s, scene_lamp(&s, 1, 1, 1), 0, 0, 0, 1, 96, 96, 0);
    scene_floor(&s, scene_material(&s, 0.5f, 0.5f, 0.5f), -1, 5);
    scene = scene_desc(&s);
    memset(view.world_to_view, 0, sizeof view.world_to_view);
    view.width = view.height = 8;
    REQUIRE(sbl_create(&desc, &context) == SBL_SUCCESS && sbl_set_scene(context, &scene) == SBL_SUCCESS &&
                sbl_begin_picture(context, &view) == SBL_SUCCESS,
            "%s", watch_last(&seen));
    while (result == SBL_UNFINISHED && steps++ < 1000000) {
        before += context->picture.map.work.stages.stage == SBL__MAP_PREPARE;
        result = sbl_step(context, 1e-9);
    }
    CHECK(result == SBL_SUCCESS, "no picture: %s", watch_last(&seen));
    CHECK(before > 500, "18,000 triangles and as many lamps were prepared in only %d steps", before);
    sbl_destroy(context);
    scene_free(&s);
}

/* Returns the number of GL calls that draw, write or read in one sbl_render, with the given limit of a submission. */
static int calls_at(float longest, sbl_backend backend, float *radiance) {
    sbl_context_desc desc = watch_desc(&seen);
    sbl_picture_desc view = view_of(backend);
    sbl_context *context;
    int count = 0;
    desc.get_gl_function = fake_proc;
    desc.longest_submission = longest;
    context = watch_context(&seen, &desc, &cornell);
    if (!context) return 0;
    fake_arm(FAKE_REFUSE, INT_MAX, 0);
    CHECK(sbl_render_picture(context, &view) == SBL_SUCCESS, "no picture: %s", watch_last(&seen));
    count = fake.counts[FAKE_REFUSE];
    fake_disarm();
    CHECK(sbl_read_channel(context, SBL_CHANNEL_FINAL, radiance, 3 * PIXELS) == SBL_SUCCESS, "no picture");
    sbl_destroy(context);
    return count;
}

/* A lower limit of a submission gives more GL calls and the same picture, to the bit. */
TEST(submissions_follow_the_limit) {
    static float base[3 * PIXELS], now[3 * PIXELS];
    int b;
    for (b = 0; b < 2; b++) {
        const sbl_backend backend = b ? SBL_BACKEND_RASTER : SBL_BACKEND_TRACE;
        const int many = calls_at(1e-6f, backend, base), few = calls_at(100, backend, now);
        CHECK(memcmp(base, now, sizeof base) == 0, "back end %d: the limit changes the picture", b);
        CHECK(many > few + 100, "back end %d: %d calls with a limit of 1 us, %d with 100 s", b, many, few);
    }
}

/* A step ends at most one piece after the requested time, and takes more than half of it. This is true for pictures and
   for gathers. */
TEST(steps_keep_to_their_time) {
    enum { BUDGET = 20000, GIVE = 3000, SITES = 40000 };
    static sbl_site sites[SITES];
    static sbl_reading readings[SITES];
    sbl_context_desc desc = watch_desc(&seen);
    sbl_readings_desc gather = scene_readings(sites, readings, SITES, SBL_MODE_AMBIENT);
    int way, i, steps = 0;
    gather.options.rays = 4;
    for (i = 0; i < SITES; i++) {
        sites[i].position[0] = sites[i].position[2] = 200;
        sites[i].position[1] = 100;
        sites[i].normal[1] = 1;
    }
    for (way = 0; way < 3; way++) {
        sbl_picture_desc view = view_of(way ? SBL_BACKEND_TRACE : SBL_BACKEND_RASTER);
        sbl_context *context = watch_context(&seen, &desc, &cornell);
        sbl_result result = SBL_UNFINISHED;
        long longest = 0, shortest = BUDGET;
        if (!context) return;
        clock_tick = 100;
        REQUIRE((way < 2 ? sbl_begin_picture(context, &view) : sbl_begin_readings(context, &gather)) == SBL_SUCCESS,
                "cannot begin: %s", watch_last(&seen));
        for (steps = 0; result == SBL_UNFINISHED && steps < 100000; steps++) {
            const long start = clock_now;
            result = sbl_step(context, 1e-6 * BUDGET);
            if (clock_now - start > longest) longest = clock_now - start;
            if (result == SBL_UNFINISHED && clock_now - start < shortest) shortest = clock_now - start;
        }
        clock_tick = 0;
        CHECK(result == SBL_SUCCESS && steps > 3, "%s after %d steps: %s", sbl_result_string(result), steps,
              watch_last(&seen));
        CHECK(longest < BUDGET + GIVE && shortest > BUDGET / 2, "way %d: steps of %d us took %ld to %ld", way, BUDGET,
              shortest, longest);
        printf("  %d steps of %ld to %ld us\n", steps, shortest, longest);
        sbl_destroy(context);
    }
}

/* >>steps of bounced light */

/* The gather has so many sites, in a square, that it takes several steps. */
enum { GATHER_SITES = 64 };
static sbl_site gather_sites[GATHER_SITES];
static sbl_reading gather_readings[GATHER_SITES];

static sbl_readings_desc gather_of(sbl_mode mode) {
    sbl_readings_desc gather = scene_readings(gather_sites, gather_readings, GATHER_SITES, mode);
    int i;
    for (i = 0; i < GATHER_SITES; i++) {
        gather_sites[i].position[0] = 50 + 60 * (float)(i % 8);
        gather_sites[i].position[2] = 50 + 60 * (float)(i / 8);
        gather_sites[i].normal[1] = 1;
    }
    gather.options.rays = 8;
    return gather;
}

/* Describes a small picture. Most of its work is filling the store. */
static sbl_picture_desc bounced_view(void) {
    sbl_picture_desc view = scene_cornell_view(WIDTH / 8, HEIGHT / 8);
    view.options.mode = SBL_MODE_GI;
    view.options.backend = SBL_BACKEND_TRACE;
    view.options.rays = 8;
    view.samples = 1;
    return view;
}

enum { BOUNCED = 3 * (WIDTH / 8) * (HEIGHT / 8) };

static sbl_result bounced_read(sbl_context *context, float *out) {
    memset(out, 0xff, sizeof(float) * BOUNCED);
    return sbl_read_channel(context, SBL_CHANNEL_RADIANCE, out, BOUNCED);
}

/* Makes steps of a given length until the picture is complete. counts[stage]: receives the number of steps that began
   in this stage of the store. */
static sbl_result bounced_steps(sbl_context *context, double seconds, int counts[SBL__BOUNCE_DONE + 1]) {
    sbl_result result = SBL_UNFINISHED;
    int steps = 0;
    while (result == SBL_UNFINISHED && steps++ < 1000000) {
        if (context->core.bounce) counts[context->core.bounce->stages.stage]++;
        result = sbl_step(context, seconds);
    }
    return result;
}

/* Every stage of the store takes several short steps, and the picture does not depend on their length. */
TEST(the_store_comes_in_pieces) {
    static const double budgets[] = { 1e-9, 1e-4, 2e-3 };
    static float whole[BOUNCED], now[BOUNCED];
    sbl_context_desc desc = watch_desc(&seen);
    sbl_picture_desc view = bounced_view();
    sbl_scene_desc scene = scene_desc(&cornell);
    sbl_context *context = watch_context(&seen, &desc, &cornell);
    sbl_stats stats, again;
    int i, stage;
    if (!context) return;
    REQUIRE(sbl_render_picture(context, &view) == SBL_SUCCESS && bounced_read(context, whole) == SBL_SUCCESS,
            "no picture: %s", watch_last(&seen));
    stats = sbl_query_stats(context);
    CHECK(stats.store.cells > 100 && stats.store.cells <= 1024, "%d samples", stats.store.cells);
    REQUIRE(sbl_render_picture(context, &view) == SBL_SUCCESS && bounced_read(context, now) == SBL_SUCCESS,
            "no picture: %s", watch_last(&seen));
    again = sbl_query_stats(context);
    CHECK(memcmp(now, whole, sizeof now) == 0, "a second picture from the same store differs");
    CHECK(stats.store.rays > 1000 && again.store.rays == 0 && again.store.cells == stats.store.cells &&
              again.sensors.rays == stats.sensors.rays,
          "a store of %d cells and %.0f rays, then %d cells and %.0f rays", stats.store.cells, (double)stats.store.rays,
          again.store.cells, (double)again.store.rays);
    for (i = 0; i < 3; i++) {
        int counts[SBL__BOUNCE_DONE + 1] = { 0 };
        REQUIRE(sbl_set_scene(context, &scene) == SBL_SUCCESS && sbl_begin_picture(context, &view) == SBL_SUCCESS,
                "cannot begin");
        REQUIRE(bounced_steps(context, budgets[i], counts) == SBL_SUCCESS && bounced_read(context, now) == SBL_SUCCESS,
                "no picture: %s", watch_last(&seen));
        CHECK(memcmp(now, whole, sizeof now) == 0, "in steps of %g s the picture differs", budgets[i]);
        /* the stage for light in the air runs only if the host draws, the stages for layers run only with light groups,
           and the stages that measure bright leaves run only if there are any */
        for (stage = SBL__BOUNCE_PATCHES; stage <= SBL__BOUNCE_SEND && i == 0; stage++)
            if (stage != SBL__BOUNCE_LAYERS && stage != SBL__BOUNCE_LAYERS_GATHER && stage != SBL__BOUNCE_CORRECT &&
                (stage < SBL__BOUNCE_SPREAD || stage > SBL__BOUNCE_SPREAD_LIGHT))
                CHECK(counts[stage] >= (stage == SBL__BOUNCE_LIGHT ? 10 : 1), "stage %d took %d steps", stage,
                      counts[stage]);
    }
    sbl_destroy(context);
}

/* Returns the relative difference of two pictures of the store. */
static double store_distance(const float *a, const float *b) {
    double sum = 0, off = 0;
    int i;
    for (i = 0; i < BOUNCED; i++) { sum += (double)a[i]; off += fabs((double)a[i] - b[i]); }
    return off / sum;
}

static int cancels(float done, void *user) { (void)done; return --*(int *)user <= 0; }

/* Returns 1 if the store has begun to measure the light of lamps. */
static int lit(const sbl_context *context) {
    const sbl__bounce *b = context->core.bounce;
    return b && b->stages.stage == SBL__BOUNCE_LIGHT && b->job.stages.stage == SBL__JOB_READ;
}

/* Nine kinds of calls abandon a picture after each number of short steps, first while the store measures lamps. The
   next complete picture must have the usual bits. */
TEST(the_store_is_left_at_any_step) {
    static const char *const names[] = { "the same picture again", "an ambient picture", "an ambient gather",
        "a gather with bounced light", "sbl_end", "a move there and back",
                                         "the scene again", "cancelling", "a rasterised picture" };
    static const float away[16] = { 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 100, 0, 1 }, back[16] = { 0 };
    static float whole[BOUNCED], moved[BOUNCED], now[BOUNCED];
    static sbl_reading ambient[GATHER_SITES];
    sbl_context_desc desc = watch_desc(&seen);
    sbl_context *context = watch_context(&seen, &desc, &cornell);
    sbl_scene_desc scene = scene_desc(&cornell);
    sbl_readings_desc gather = gather_of(SBL_MODE_AMBIENT), like = gather_of(SBL_MODE_GI);
    const int whats = (int)(sizeof names / sizeof *names);
    int what, at, blocks, round = 0;
    if (!context) return;
    {
        sbl_picture_desc view = bounced_view();
        REQUIRE(sbl_gather_readings(context, &gather) == SBL_SUCCESS, "no gather");
        memcpy(ambient, gather_readings, sizeof ambient);
        REQUIRE(sbl_render_picture(context, &view) == SBL_SUCCESS && bounced_read(context, whole) == SBL_SUCCESS,
                "no picture: %s", watch_last(&seen));
    }
    {
        sbl_picture_desc view = bounced_view();
        REQUIRE(sbl_set_scene(context, &scene) == SBL_SUCCESS &&
                sbl_set_mesh_transform(context, 3, away) == SBL_SUCCESS &&
                sbl_render_picture(context, &view) == SBL_SUCCESS && bounced_read(context, moved) == SBL_SUCCESS,
                "no picture: %s", watch_last(&seen));
    }
    sbl_end(context);
    REQUIRE(sbl_set_scene(context, &scene) == SBL_SUCCESS, "no scene");
    blocks = seen.blocks;
    for (at = 0; at < 100000; at += 2 + 4 * at - (round & 1), round++) {
        int done = 0;
        for (what = at ? round % 3 : 0; what < whats; what += at ? 3 : 1) {
            sbl_picture_desc view = bounced_view(), other = bounced_view();
            sbl_result result = SBL_UNFINISHED;
            int steps, calls = at + 1;
            REQUIRE(sbl_set_scene(context, &scene) == SBL_SUCCESS, "no scene");
            if (what == 7) { view.options.progress = cancels; view.options.progress_user = &calls; }
            REQUIRE(sbl_begin_picture(context, &view) == SBL_SUCCESS, "cannot begin");
            for (steps = 0; (steps < at || what == 7) && result == SBL_UNFINISHED; steps++)
                result = sbl_step(context, 1e-9);
            while (at == 0 && what != 7 && result == SBL_UNFINISHED && !lit(context)) result = sbl_step(context, 1e-9);
            done += result == SBL_SUCCESS;
            CHECK(what != 7 || !context->core.bounce || context->core.scene.store.ready,
                  "cancelled after %d steps, but a store that is not ready remains", at);
            CHECK(result == SBL_SUCCESS || result == (what == 7 ? SBL_CANCELLED : SBL_UNFINISHED), "%s",
                  watch_last(&seen));
            view.options.progress = NULL;
            result = SBL_SUCCESS;
            switch (what) {
                case 1: other.options.mode = SBL_MODE_AMBIENT; result = sbl_render_picture(context, &other); break;
                case 2: result = sbl_gather_readings(context, &gather);
                    CHECK(memcmp(ambient, gather_readings, sizeof ambient) == 0, "after %d steps the gather differs",
                          at);
                    break;
                case 3: result = sbl_begin_readings(context, &like); if (at & 1) sbl_step(context, 1e-9); break;
                case 4: case 7:
                    sbl_end(context);
                    sbl_set_scene(context, &scene);
                    CHECK(seen.blocks == blocks, "%s after %d steps: %d blocks, expected %d", names[what], at,
                          seen.blocks,
                          blocks);
                    break;
                case 5: result = sbl_set_mesh_transform(context, 3, away);
                        if (at & 1) sbl_begin_picture(context, &view), sbl_step(context, 1e-9);
                        else if (sbl_render_picture(context, &view) == SBL_SUCCESS) {
                            bounced_read(context, now);
                            CHECK(memcmp(now, moved, sizeof now) == 0, "moved after %d steps: the picture differs", at);
                        }
                        sbl_set_mesh_transform(context, 3, back); break;
                case 6: result = sbl_set_scene(context, &scene); break;
                case 8:
                    other.options.backend = SBL_BACKEND_RASTER;
                    other.options.sensor_size = 4;
                    result = sbl_begin_picture(context, &other);
                    sbl_step(context, 1e-9);
                    break;
                default: break;
            }
            CHECK(result == SBL_SUCCESS, "%s after %d steps: %s", names[what], at, watch_last(&seen));
            CHECK(sbl_render_picture(context, &view) == SBL_SUCCESS && bounced_read(context, now) == SBL_SUCCESS,
                  "%s after %d steps: %s", names[what], at, watch_last(&seen));
            CHECK(memcmp(now, whole, sizeof now) == 0, "%s after %d steps changes the picture by a share of %g",
                  names[what],
                  at, store_distance(whole, now));
        }
        if (done == whats / 3) break;
    }
    CHECK(at < 100000, "the picture is not done after %d steps", at);
    printf("  abandoned after up to %d steps\n", at);
    sbl_destroy(context);
}

/* >>shader programs */

/* Without compile_ahead each step compiles at most one program. With it, sbl_create compiles all programs. */
TEST(programs_compile_when_used_or_ahead) {
    sbl_context_desc desc = watch_desc(&seen);
    sbl_context *context;
    sbl_picture_desc view = view_of(SBL_BACKEND_TRACE);
    sbl_programs before, after;
    static const unsigned char texel[4] = { 200, 150, 100, 255 };
    test_scene textured = { 0 };
    sbl_scene_desc scene;
    int programs, most = 0, steps = 0, material = scene_material(&textured, 0.5f, 0.5f, 0.5f), k;
    sbl_result result = SBL_UNFINISHED;
    context = watch_context(&seen, &desc, &cornell);
    if (!context) return;
    before = sbl_query_programs(context);
    /* sbl_create compiles only the programs of the section >>trial of sbl.h */
    CHECK(before.compiled <= 4, "%d programs are compiled before they are used", before.compiled);
    REQUIRE(sbl_begin_picture(context, &view) == SBL_SUCCESS, "cannot begin");
    while (result == SBL_UNFINISHED && steps++ < 1000000) {
        programs = sbl_query_programs(context).compiled;
        result = sbl_step(context, 1e-9);
        programs = sbl_query_programs(context).compiled - programs;
        most = programs > most ? programs : most;
    }
    after = sbl_query_programs(context);
    CHECK(result == SBL_SUCCESS && most == 1, "%d programs compiled in one step", most);
    CHECK(after.compiled >= 5 && after.compile_seconds > 0, "%d programs in %g s", after.compiled,
          after.compile_seconds);
    CHECK(sbl_render_picture(context, &view) == SBL_SUCCESS && sbl_query_programs(context).compiled == after.compiled,
          "a program was compiled again");
    sbl_destroy(context);

    desc.compile_ahead = 1;
    context = watch_context(&seen, &desc, &cornell);
    if (!context) return;
    before = sbl_query_programs(context);
    CHECK(before.compiled > after.compiled && before.compile_seconds > 0, "ahead: %d programs in %g s", before.compiled,
          before.compile_seconds);
    CHECK(sbl_render_picture(context, &view) == SBL_SUCCESS, "no picture");
    view.options.backend = SBL_BACKEND_RASTER;
    CHECK(sbl_render_picture(context, &view) == SBL_SUCCESS, "no picture");
    view.options.mode = SBL_MODE_PAPER;
    CHECK(sbl_render_picture(context, &view) == SBL_SUCCESS, "no picture");
    for (k = 0; k < 3; k++) {  /* bounced light: rays, views, and rays with a guide */
        sbl_picture_desc bounced = bounced_view();
        bounced.options.backend = k == 1 ? SBL_BACKEND_RASTER : SBL_BACKEND_TRACE;
        if (k == 2) bounced.options.rays = 0;
        CHECK(sbl_render_picture(context, &bounced) == SBL_SUCCESS, "no picture with bounced light");
    }
    scene_quad(&textured, material, -1, 0, -1, 1, 0, -1, 1, 0, 1, -1, 0, 1);
    textured.materials[material].albedo_texture =
        scene_texture(&textured, texel, sizeof texel, SBL_PIXELS_SRGB8, 1, 1, 4);
    textured.environment.picture = textured.textures[0];
    scene_quad(&textured, scene_lamp(&textured, 1, 1, 1), -1, 1, -1, 1, 1, -1, 1, 1, 1, -1, 1, 1);
    scene = scene_desc(&textured);
    CHECK(sbl_set_scene(context, &scene) == SBL_SUCCESS, "no textured scene: %s", watch_last(&seen));
    for (k = 0; k < 2; k++) {
        sbl_picture_desc plain = view_of(k ? SBL_BACKEND_RASTER : SBL_BACKEND_TRACE);
        memset(plain.world_to_view, 0, sizeof plain.world_to_view);
        CHECK(sbl_render_picture(context, &plain) == SBL_SUCCESS, "no textured picture");
    }
    CHECK(sbl_query_programs(context).compiled == before.compiled, "%d programs were not compiled ahead",
          sbl_query_programs(context).compiled - before.compiled);
    sbl_destroy(context);
    scene_free(&textured);
}

/* A context keeps all programs that it compiles. Their greatest possible number must not exceed SBL__PROGRAMS_MOST. */
TEST(programs_have_room) {
    static const sbl__recipe *const recipes[] = {
        &sbl__recipe_copy, &sbl__recipe_visibility, &sbl__recipe_gbuffer, &sbl__recipe_lamps, &sbl__recipe_sensor,
            &sbl__recipe_sky,
        &sbl__recipe_reduce_blocks, &sbl__recipe_trace, &sbl__recipe_reduce_sum, &sbl__recipe_cast,
            &sbl__recipe_cast_metal, &sbl__recipe_filter, &sbl__recipe_resolve };
    int i, k, all = 0;
    for (i = 0; i < SBL__COUNT(recipes); i++) {
        int variants = 1;
        for (k = 0; k < SBL__FEATURES; k++)  /* features of the driver are omitted: they do not depend on the scene */
            if ((recipes[i]->features & ~(unsigned)(SBL__WRITE_DEPTH | SBL__COMPUTE)) >> k & 1) variants *= 2;
        all += variants;
    }
    CHECK(all > 60 && all <= SBL__PROGRAMS_MOST, "up to %d programs are possible, but SBL__PROGRAMS_MOST is %d", all,
          SBL__PROGRAMS_MOST);
}

/* >>reading unfinished pictures */

static double distance(const float *a, const float *b) {
    double sum = 0;
    int i;
    for (i = 0; i < 3 * PIXELS; i++) sum += ((double)a[i] - b[i]) * ((double)a[i] - b[i]);
    return sqrt(sum / (3 * PIXELS));
}

/* The picture can be read after the first level, and its error decreases with each level. */
TEST(each_level_is_sharper) {
    static const sbl_channel channels[] = { SBL_CHANNEL_RADIANCE, SBL_CHANNEL_FINAL };
    static float whole[2][3 * PIXELS], now[2][3 * PIXELS], last[2][3 * PIXELS];
    sbl_context_desc desc = watch_desc(&seen);
    sbl_picture_desc view = view_of(SBL_BACKEND_TRACE);
    sbl_context *context = watch_context(&seen, &desc, &cornell);
    sbl_result result = SBL_UNFINISHED;
    double first[2] = { 0, 0 }, before[2] = { 0, 0 }, error;
    int64_t sensors = 0;
    int k, shown = 0, waiting = 0, seen_before = 0;
    if (!context) return;
    view.samples = 1;
    REQUIRE(sbl_render_picture(context, &view) == SBL_SUCCESS, "no picture");
    for (k = 0; k < 2; k++)
        REQUIRE(sbl_read_channel(context, channels[k], whole[k], 3 * PIXELS) == SBL_SUCCESS, "not read");
    REQUIRE(sbl_begin_picture(context, &view) == SBL_SUCCESS, "cannot begin");
    CHECK(sbl_channel_texture(context, SBL_CHANNEL_FINAL) == 0, "a texture before the first step");
    memset(last, 0, sizeof last);
    while (result == SBL_UNFINISHED) {
        result = sbl_step(context, 1e-9);
        if (result != SBL_UNFINISHED) break;
        for (k = 0; k < 2; k++) {
            const sbl_result is = sbl_read_channel(context, channels[k], now[k], 3 * PIXELS);
            if (is == SBL_UNFINISHED) {
                waiting++;
                CHECK(!seen_before, "a visible picture became unreadable");
                continue;
            }
            REQUIRE(is == SBL_SUCCESS, "an unfinished picture cannot be read: %s", sbl_result_string(is));
            seen_before = 1;
            if (memcmp(now[k], last[k], sizeof last[k]) == 0) continue;
            memcpy(last[k], now[k], sizeof last[k]);
            error = distance(now[k], whole[k]);
            /* Within a level, some pieces may increase the error. The states that a host sees depend on the length of
               the steps. */
            if (before[k] > 0)
                CHECK(error < 1.1 * before[k], "channel %d: a level brings the error from %g to %g", k, before[k],
                      error);
            else first[k] = error;
            before[k] = error;
            /* rows of the picture appear one after another */
            if (k && sbl_query_stats(context).sensors.sites != sensors) shown++;
            if (k) sensors = sbl_query_stats(context).sensors.sites;
        }
    }
    CHECK(result == SBL_SUCCESS, "no picture: %s", watch_last(&seen));
    CHECK(waiting > 0 && shown >= 4, "%d attempts to read before the first level, %d pictures were read", waiting,
          shown);
    for (k = 0; k < 2; k++) {
        /* the last preview may lack a quarter of the looks */
        CHECK(before[k] < 0.5 * first[k], "channel %d: error %g in the first picture read, %g in the last", k,
              first[k], before[k]);
        CHECK(sbl_read_channel(context, channels[k], now[k], 3 * PIXELS) == SBL_SUCCESS &&
              memcmp(now[k], whole[k], sizeof now[k]) == 0,
              "channel %d: reading the unfinished picture changes it", k);
    }
    CHECK(before[1] == 0, "the last preview does not have the final R: it is off by %g", before[1]);
    printf("  R is off by %.4g in the first picture read, by %.4g in the last of %d\n", first[0], before[0], shown);
    sbl_destroy(context);
}

/* Makes a picture, and reads FINAL into `preview` once, `late` steps after R is final. Returns 0 if the picture is
   complete before. out: receives FINAL of the complete picture */
static int late_preview(sbl_context *context, const sbl_picture_desc *view, int late, float *preview, float *out) {
    const size_t count = (size_t)(3 * view->width * view->height);
    sbl_result result = sbl_begin_picture(context, view) == SBL_SUCCESS ? SBL_UNFINISHED : SBL_ERROR_STATE;
    int steps = -1, read = 0;
    while (result == SBL_UNFINISHED) {
        result = sbl_step(context, 1e-9);
        steps += context->picture.map.developed;
        if (result != SBL_UNFINISHED || read || steps < late) continue;
        CHECK(sbl_read_channel(context, SBL_CHANNEL_FINAL, preview, count) == SBL_SUCCESS, "%s", watch_last(&seen));
        read = 1;
    }
    CHECK(sbl_read_channel(context, SBL_CHANNEL_FINAL, out, count) == SBL_SUCCESS, "%s", watch_last(&seen));
    return read;
}

/* A preview that is first read after R is final shows one sample at the centre of each pixel, with the emission there.
   Reading it does not change the finished picture, whichever samples have been drawn before. */
TEST(late_previews_change_nothing) {
    enum { NARROW = WIDTH / 2, LOW = HEIGHT / 2, BYTES = 3 * NARROW * LOW * (int)sizeof(float) };
    sbl_picture_desc view = view_of(SBL_BACKEND_TRACE), single;
    sbl_context *context = watch_context(&seen, NULL, &cornell);
    float *pictures[4];
    int i, late;
    if (!context) return;
    view.width = NARROW;
    view.height = LOW;
    view.threshold = 10;
    single = view;
    single.samples = 1;
    for (i = 0; i < 4; i++) pictures[i] = (float *)malloc(BYTES);
    late_preview(context, &single, INT_MAX, NULL, pictures[0]);
    late_preview(context, &view, INT_MAX, NULL, pictures[1]);
    for (late = 0; late_preview(context, &view, late, pictures[2], pictures[3]); late++) {
        CHECK(!memcmp(pictures[0], pictures[2], BYTES), "step %d: the preview differs", late);
        CHECK(!memcmp(pictures[1], pictures[3], BYTES), "step %d: the picture differs", late);
    }
    CHECK(late > 12, "the picture has %d late steps", late);
    for (i = 0; i < 4; i++) free(pictures[i]);
    sbl_destroy(context);
}

/* If no memory is left to show an unfinished picture, the picture is dropped, and the next one is right. */
TEST(pictures_that_cannot_be_shown_are_dropped) {
    enum { WIDE = 32, HIGH = 24, FLOATS = 3 * WIDE * HIGH };
    static float whole[FLOATS], now[FLOATS];
    sbl_context_desc desc = watch_desc(&seen);
    sbl_picture_desc view = view_of(SBL_BACKEND_TRACE);
    sbl_context *context = watch_context(&seen, &desc, &cornell);
    if (!context) return;
    view.width = WIDE;
    view.height = HIGH;
    view.samples = 1;
    REQUIRE(sbl_render_picture(context, &view) == SBL_SUCCESS &&
            sbl_read_channel(context, SBL_CHANNEL_FINAL, whole, FLOATS) == SBL_SUCCESS, "no picture");
    REQUIRE(sbl_begin_picture(context, &view) == SBL_SUCCESS, "cannot begin");
    while (sbl_step(context, 1e-9) == SBL_UNFINISHED && (sbl__refine_error(&context->picture.map.refine) < 0 ||
                                                         context->picture.map.glimpse == SBL__GLIMPSE_UNDER_WAY)) {}
    context->core.base.budget = 1;
    CHECK(sbl_read_channel(context, SBL_CHANNEL_FINAL, now, FLOATS) == SBL_ERROR_OUT_OF_MEMORY,
          "the preview needs no memory");
    context->core.base.budget = 0;
    CHECK(sbl_step(context, 0) == SBL_ERROR_STATE, "a picture that cannot be shown goes on");
    CHECK(sbl_render_picture(context, &view) == SBL_SUCCESS &&
          sbl_read_channel(context, SBL_CHANNEL_FINAL, now, FLOATS) == SBL_SUCCESS &&
          memcmp(now, whole, sizeof now) == 0, "the next picture differs");
    sbl_destroy(context);
}

/* The predicted number of looks is exact at the end of refinement, and close to the final number as soon as it is
   reported as certain. Progress increases to 1. */
TEST(refinement_foresees_its_looks) {
    sbl_context_desc desc = watch_desc(&seen);
    sbl_picture_desc view = view_of(SBL_BACKEND_TRACE);
    sbl_context *context = watch_context(&seen, &desc, &cornell);
    sbl_result result = SBL_UNFINISHED;
    double foreseen[64], sure[64], looks = 0;
    float before = 0;
    int i, rounds = 0, surer = 0;
    if (!context) return;
    view.samples = 1;
    view.target_error = 0.03f;
    clock_tick = 1;
    REQUIRE(sbl_begin_picture(context, &view) == SBL_SUCCESS, "cannot begin");
    while (result == SBL_UNFINISHED) {
        const sbl__refine *r = &context->picture.map.refine;
        result = sbl_step(context, 1e-9);
        CHECK(sbl_progress(context) >= before && (result != SBL_UNFINISHED || sbl_progress(context) < 1),
              "progress is %g after %g", (double)sbl_progress(context), (double)before);
        before = sbl_progress(context);
        if (r->stages.stage != SBL__REFINE_SPEND || r->stages.at || rounds == 64) continue;
        foreseen[rounds] = sbl__refine_looks_expected(r);
        sure[rounds++] = r->expected_weight;
        looks = (double)sbl__refine_looks(r);
    }
    clock_tick = 0;
    CHECK(result == SBL_SUCCESS && before == 1, "%s, progress %g", watch_last(&seen), (double)before);
    REQUIRE(rounds > 3, "%d rounds", rounds);
    for (i = 0; i < rounds; i++) {
        printf("  round %d: foreseen %.2f of all looks, sure %.2f\n", i, foreseen[i] / looks, sure[i]);
        surer += sure[i] > 0.5;
        CHECK(sure[i] >= 0 && sure[i] <= 1, "round %d: sure %g", i, sure[i]);
        CHECK(sure[i] < 0.5 || fabs(foreseen[i] / looks - 1) < 0.3, "round %d: %g looks are foreseen instead of %g", i,
              foreseen[i], looks);
    }
    CHECK(sure[0] < 0.2 && surer > 1, "the first round is sure by %g; %d of %d rounds are sure", sure[0], surer,
          rounds);
    CHECK(foreseen[rounds - 1] == looks && sure[rounds - 1] == 1, "in the end %g looks are foreseen instead of %g",
          foreseen[rounds - 1], looks);
    sbl_destroy(context);
}

/* Channels that show only surfaces can be read before the first sensor has measured, and are final then. */
TEST(surfaces_are_shown_before_sensors) {
    static const sbl_channel channels[] = { SBL_CHANNEL_ALBEDO, SBL_CHANNEL_NORMAL, SBL_CHANNEL_POSITION,
                                            SBL_CHANNEL_ID, SBL_CHANNEL_DEPTH };
    static float early[5][3 * PIXELS], now[3 * PIXELS];
    sbl_context_desc desc = watch_desc(&seen);
    sbl_picture_desc view = view_of(SBL_BACKEND_TRACE);
    sbl_context *context = watch_context(&seen, &desc, &cornell);
    sbl_result result = SBL_UNFINISHED;
    int k;
    if (!context) return;
    REQUIRE(sbl_begin_picture(context, &view) == SBL_SUCCESS, "cannot begin");
    while (result == SBL_UNFINISHED && !sbl_channel_texture(context, SBL_CHANNEL_NORMAL))
        result = sbl_step(context, 1e-9);
    CHECK(result == SBL_UNFINISHED && sbl_query_stats(context).sensors.sites == 0, "normals come after %.0f sensors",
          (double)sbl_query_stats(context).sensors.sites);
    for (k = 0; k < 5; k++)
        CHECK(sbl_read_channel(context, channels[k], early[k], 3 * PIXELS) == SBL_SUCCESS, "channel %d", channels[k]);
    CHECK(sbl_read_channel(context, SBL_CHANNEL_FINAL, now, 3 * PIXELS) == SBL_UNFINISHED, "light without sensors");
    REQUIRE(sbl_step(context, 0) == SBL_SUCCESS, "no picture: %s", watch_last(&seen));
    for (k = 0; k < 5; k++)
        CHECK(sbl_read_channel(context, channels[k], now, 3 * PIXELS) == SBL_SUCCESS &&
                  memcmp(now, early[k], PIXELS * sizeof(float) * (size_t)sbl_channel_components(channels[k])) == 0,
              "channel %d has changed", channels[k]);
    sbl_destroy(context);
}

/* Results for a host that reads the picture before each step, starting with step `from`: the number of steps in all,
   before the first readable picture and before the store is ready, and the mean R of the first picture. */
typedef struct watching { int steps, first, store; float mean; } watching;

/* Makes a picture with bounced light in steps of the shortest length and returns the counts. Progress must not
   decrease, and a picture that was readable must stay readable. */
static watching watch_bounces(sbl_context *context, const sbl_picture_desc *view, int from) {
    static float now[3 * PIXELS];
    watching w = { 0, -1, -1, 0 };
    sbl_result result = sbl_begin_picture(context, view);
    float done = 0;
    int back = 0, lost = 0;
    size_t i;
    const size_t floats = 3 * (size_t)view->width * (size_t)view->height;
    for (; result == SBL_SUCCESS || result == SBL_UNFINISHED; w.steps++) {
        const sbl_result is = w.steps < from ? SBL_UNFINISHED
                                             : sbl_read_channel(context, SBL_CHANNEL_RADIANCE, now, 3 * PIXELS);
        for (i = 0; i < floats && is == SBL_SUCCESS && w.first < 0; i++) w.mean += now[i] / (float)floats;
        if (is == SBL_SUCCESS && w.first < 0) w.first = w.steps;
        if (context->core.scene.store.ready && w.store < 0) w.store = w.steps;
        lost += is != SBL_SUCCESS && w.first >= 0;
        result = sbl_step(context, 1e-9);
        back += sbl_progress(context) < done;
        done = sbl_progress(context);
        if (result == SBL_SUCCESS) break;
    }
    CHECK(result == SBL_SUCCESS, "no picture: %s", watch_last(&seen));
    CHECK(back == 0 && done == 1, "progress decreases %d times and ends at %g", back, (double)done);
    CHECK(lost == 0, "a visible picture became unreadable %d times", lost);
    return w;
}

/* A host that reads unfinished pictures gets a picture of direct light before the bounced light is stored. At the end
   it gets the same picture and statistics as a host that does not read them. It may start reading at any time. */
TEST(direct_light_is_shown_first) {
    static float whole[5][3 * PIXELS], now[3 * PIXELS];
    static const sbl_channel channels[5] = { SBL_CHANNEL_FINAL, SBL_CHANNEL_RADIANCE, SBL_CHANNEL_STORE,
                                             SBL_CHANNEL_SENSORS, SBL_CHANNEL_ERROR };
    sbl_context_desc desc = watch_desc(&seen);
    sbl_context *context = watch_context(&seen, &desc, &cornell);
    sbl_picture_desc view = scene_cornell_view(WIDTH / 2, HEIGHT / 2);
    sbl_scene_desc scene = scene_desc(&cornell);
    const int pixels = PIXELS / 4;
    sbl_stats stats, again;
    watching w;
    float mean = 0;
    int k, i, turn;
    if (!context) return;
    view.options.mode = SBL_MODE_GI;
    view.samples = 2;
    w = watch_bounces(context, &view, INT_MAX);
    CHECK(context->picture.map.glimpse == SBL__GLIMPSE_NONE, "direct light is measured for a host that does not watch");
    stats = sbl_query_stats(context);
    for (k = 0; k < 5; k++)
        REQUIRE(sbl_read_channel(context, channels[k], whole[k], 3 * PIXELS) == SBL_SUCCESS, "channel %d", k);
    for (i = 0; i < 3 * pixels; i++) mean += whole[1][i] / (float)(3 * pixels);
    for (turn = 0; turn < 4; turn += turn == 0 ? 2 : 1) {
        const int from = turn < 3 ? turn * w.store / 4 : (w.store + w.steps) / 2;
        watching late;
        REQUIRE(sbl_set_scene(context, &scene) == SBL_SUCCESS, "no scene");
        late = watch_bounces(context, &view, from);
        printf("  watched from step %d of %d: first picture at %d, the store is ready at %d\n", from, late.steps,
               late.first, late.store);
        if (turn < 3) {
            CHECK(late.first > from && late.first < late.store && late.first - from < late.steps / 4,
                  "watched from step %d of %d: first picture at %d, the store is ready at %d", from, late.steps,
                  late.first, late.store);
            CHECK(late.mean > 0.2f * mean && late.mean < 0.97f * mean, "its mean is %g, with bounces %g",
                  (double)late.mean, (double)mean);
        }
        again = sbl_query_stats(context);
        CHECK(again.sensors.sites == stats.sensors.sites && again.sensors.rays == stats.sensors.rays &&
                  again.store.rays == stats.store.rays && again.sensors.invalid == stats.sensors.invalid &&
                  memcmp(&again.picture, &stats.picture, sizeof stats.picture) == 0,
              "watched from step %d: %.0f sensors and %.0f rays, otherwise %.0f and %.0f", from,
              (double)again.sensors.sites, (double)again.sensors.rays, (double)stats.sensors.sites,
              (double)stats.sensors.rays);
        for (k = 0; k < 5; k++)
            CHECK(sbl_read_channel(context, channels[k], now, 3 * PIXELS) == SBL_SUCCESS &&
                      memcmp(now, whole[k], 4 * (size_t)(pixels * sbl_channel_components(channels[k]))) == 0,
                  "watched from step %d: channel %d differs", from, (int)channels[k]);
    }
    sbl_destroy(context);
}

/* >>lifetime of pictures */

/* A finished picture stays readable while other work is begun, fails or is refused, until sbl_end. */
TEST(a_finished_picture_stays) {
    static float whole[SBL_CHANNEL_COUNT][3 * PIXELS], now[3 * PIXELS];
    static const float away[16] = { 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 5000, 0, 1 };
    float bad[16] = { (float)NAN };
    sbl_context_desc desc = watch_desc(&seen);
    sbl_picture_desc view = view_of(SBL_BACKEND_TRACE);
    sbl_context *context = watch_context(&seen, &desc, &cornell);
    sbl_scene_desc scene = scene_desc(&cornell), empty;
    sbl_sensor sensor;
    sbl_site site;
    sbl_reading reading;
    sbl_readings_desc gather;
    uint32_t name;
    int k, step;
    if (!context) return;
    memset(&empty, 0, sizeof empty);
    memset(&site, 0, sizeof site);
    site.normal[1] = 1;
    gather = scene_readings(&site, &reading, 1, SBL_MODE_AMBIENT);
    REQUIRE(sbl_render_picture(context, &view) == SBL_SUCCESS, "no picture");
    for (k = 0; k < SBL_CHANNEL_COUNT; k++)
        REQUIRE(sbl_read_channel(context, (sbl_channel)k, whole[k], 3 * PIXELS) == SBL_SUCCESS, "channel %d", k);
    name = sbl_channel_texture(context, SBL_CHANNEL_FINAL);
    CHECK(name && sbl_inspect_sensor(context, 80, 80, &sensor, NULL, NULL, 0) == SBL_SUCCESS,
          "no texture, or no inspection");
    for (step = -2; step < 6; step++) {
        switch (step) {
            case -2: case -1:  /* the first allocation fails, or a later one */
                seen.refuse_at = seen.allocations + (step == -2 ? 1 : 9);
                CHECK(sbl_set_scene(context, &empty) == (step == -2 ? SBL_ERROR_OUT_OF_MEMORY : SBL_SUCCESS) ||
                      seen.refused, "a failing allocation");
                break;
            case 0: CHECK(sbl_set_mesh_transform(context, 0, bad) == SBL_ERROR_INVALID_ARGUMENT, "a bad matrix"); break;
            case 1: CHECK(sbl_gather_readings(context, &gather) == SBL_SUCCESS, "a gather"); break;
            case 2: CHECK(sbl_begin_readings(context, &gather) == SBL_SUCCESS, "beginning a gather"); break;
            case 3: CHECK(sbl_set_mesh_transform(context, 0, away) == SBL_SUCCESS, "a move"); break;
            case 4: CHECK(sbl_set_scene(context, &empty) == SBL_SUCCESS, "an empty scene"); break;
            default: CHECK(sbl_set_scene(context, &scene) == SBL_SUCCESS, "the scene again"); break;
        }
        for (k = 0; k < SBL_CHANNEL_COUNT; k++) {
            size_t bytes = sizeof(float) * PIXELS * (size_t)sbl_channel_components((sbl_channel)k);
            CHECK(sbl_read_channel(context, (sbl_channel)k, now, 3 * PIXELS) == SBL_SUCCESS &&
                  memcmp(now, whole[k], bytes) == 0, "after event %d, channel %d differs", step, k);
        }
        CHECK(sbl_channel_texture(context, SBL_CHANNEL_FINAL) == name, "after event %d, the texture is another one",
              step);
        CHECK(sbl_inspect_sensor(context, 80, 80, &sensor, NULL, NULL, 0) == (step < 3 ? SBL_SUCCESS : SBL_ERROR_STATE),
              "after event %d: the inspected sensor differs", step);
    }
    sbl_end(context);
    CHECK(sbl_read_channel(context, SBL_CHANNEL_FINAL, now, 3 * PIXELS) == SBL_ERROR_STATE &&
          sbl_channel_texture(context, SBL_CHANNEL_FINAL) == 0, "the picture remains after sbl_end");
    sbl_destroy(context);
}

/* >>inspected sensors */

/* The sheet, the rays and the lamps of an inspected sensor add up to its R, which equals R of the picture. */
TEST(inspection_adds_up) {
    sbl_context_desc desc = watch_desc(&seen);
    sbl_context *context = watch_context(&seen, &desc, &cornell);
    int b, at, lit = 0, half = 0;
    if (!context) return;
    for (b = 0; b < 2; b++) {
        sbl_picture_desc view = scene_plain(view_of(SBL_BACKEND_TRACE), SBL_MODE_AMBIENT, b ? 16 : 0);
        REQUIRE(sbl_render_picture(context, &view) == SBL_SUCCESS, "no picture");
        for (at = 1; at < 60; at += 4) {
            const int x = 20 + 2 * at, y = 10 + (at * 53) % 100;
            static float radiance[4 * 64 * 64], weights[64 * 64];
            double sum[3] = { 0, 0, 0 }, rays[3] = { 0, 0, 0 }, lamps = 0;
            int i, k, open = 0, sent = 0;
            sbl_sensor s;
            watch_forget(&seen);
            if (sbl_inspect_sensor(context, x, y, &s, radiance, weights, 64 * 64) != SBL_SUCCESS) continue;
            REQUIRE(s.looks == 1 && s.sensed, "%d %d: %d looks", x, y, s.looks);
            for (i = 0; i < s.sheet_width * s.sheet_height; i++)
                for (k = 0; k < 3; k++) sum[k] += (double)radiance[4 * i + k] * weights[i];
            for (i = 0; i < s.ray_count; i++) {
                if (s.rays[i].lamp >= 0) {
                    sent++;
                    lamps += s.rays[i].radiance[0];
                    continue;
                }
                for (k = 0; k < 3; k++) rays[k] += (double)s.rays[i].radiance[k] / view.options.rays;
            }
            for (i = 0, k = 0; i < s.lamp_count; i++) { k += s.lamps[i].rays; open += s.lamps[i].open; }
            for (i = 0; i < 3; i++) {
                CHECK(fabs(sum[i] - s.from_surroundings[i]) < 1e-4 * s.radiance[i] + 1e-6,
                      "%d %d: the sheet gives %g, surroundings %g", x, y, sum[i],
                      (double)s.from_surroundings[i]);
                CHECK(fabs((double)s.from_surroundings[i] + s.from_lamps[i] - s.radiance[i]) < 1e-5 * s.radiance[i] +
                      1e-7, "%d %d: %g and %g are not %g", x, y,
                      (double)s.from_surroundings[i], (double)s.from_lamps[i], (double)s.radiance[i]);
                if (b == 0)
                    CHECK(fabs(rays[i] - s.from_surroundings[i]) < 1e-4 * s.radiance[i] + 1e-6, "%d %d: rays give %g",
                          x, y, rays[i]);
            }
            for (i = 0; i < s.lamp_count; i++)
                CHECK(s.lamps[i].kind == SBL_LAMP_TRIANGLE && s.lamps[i].mesh == 1 && (unsigned)s.lamps[i].number < 2,
                      "%d %d: lamp %d is triangle %d of mesh %d",
                      x, y, i, s.lamps[i].number, s.lamps[i].mesh);
            CHECK(k == sent && open <= sent, "%d %d: the lamps count %d rays, but there are %d", x, y, k, sent);
            CHECK((s.from_lamps[0] > 0) == (open > 0), "%d %d: %g from lamps, %d rays reach them", x, y,
                  (double)s.from_lamps[0], open);
            CHECK((b == 0) == (s.backend == SBL_BACKEND_TRACE) && (b == 0) == (s.view_count == 0),
                  "%d %d: wrong back end or counts", x, y);
            lit += open > 0;
            half += open > 0 && open < sent;
        }
    }
    CHECK(lit > 10 && half > 0, "%d sensors are lit, %d of them partly", lit, half);
    sbl_destroy(context);
}

/* The inspection of a pixel without a sensor makes a sensor with sensed = 0. A pixel with a sensor reports the level
   that SBL_CHANNEL_SENSORS shows. */
TEST(inspection_tells_levels) {
    static float levels[PIXELS];
    sbl_context_desc desc = watch_desc(&seen);
    sbl_context *context = watch_context(&seen, &desc, &cornell);
    sbl_picture_desc view = view_of(SBL_BACKEND_TRACE);
    int met[SBL_MAX_LEVELS + 1] = { 0 }, at, wrong = 0;
    if (!context) return;
    view.samples = 1;
    REQUIRE(sbl_render_picture(context, &view) == SBL_SUCCESS &&
                sbl_read_channel(context, SBL_CHANNEL_SENSORS, levels, PIXELS) == SBL_SUCCESS,
            "no picture");
    for (at = 0; at < PIXELS; at++) {
        const int level = (int)levels[at];
        sbl_sensor s;
        if (met[level] == 8 || sbl_inspect_sensor(context, at % WIDTH, at / WIDTH, &s, NULL, NULL, 0) != SBL_SUCCESS)
            continue;
        met[level]++;
        wrong += s.sensed != (level > 0) || s.level != (level > 0 ? level - 1 : 0);
    }
    CHECK(met[0] == 8 && met[1] == 8 && met[2] == 8 && met[3] == 8, "%d %d %d %d sensors of the first levels", met[0],
          met[1], met[2], met[3]);
    CHECK(wrong == 0, "%d sensors report another level than the channel", wrong);
    sbl_destroy(context);
}

/* The statistics report the numbers of lamps and triangles and the bytes of the Cornell box. */
TEST(stats_tell_of_lamps_and_the_hierarchy) {
    sbl_context_desc desc = watch_desc(&seen);
    sbl_context *context = watch_context(&seen, &desc, &cornell);
    sbl_picture_desc view = view_of(SBL_BACKEND_TRACE);
    const sbl__hierarchy *h;
    size_t records;
    int i;
    sbl_stats stats;
    if (!context) return;
    view.width = view.height = 8;
    view.tile = 4;
    REQUIRE(sbl_render_picture(context, &view) == SBL_SUCCESS, "no picture");
    stats = sbl_query_stats(context);
    CHECK(stats.scene.lamps == 2 && stats.scene.triangles == 32, "%d lamps among %d triangles; expected 2 among 32",
          stats.scene.lamps, stats.scene.triangles);
    CHECK(stats.sensors.sites > 0 && fabs(stats.sensors.microseconds * (double)stats.sensors.sites / 1e6 /
                                          stats.seconds.total - 1) < 1e-6, "%g us for each of %g sensors in %g s",
          stats.sensors.microseconds, (double)stats.sensors.sites, stats.seconds.total);
    for (i = 0; i < SBL_MAX_LEVELS; i++)
        CHECK(stats.picture.levels[i].tile == (i == 0 ? 4 : i == 1 ? 2 : 1), "tiles of level %d are %d pixels "
              "wide", i, stats.picture.levels[i].tile);
    h = &context->core.scene.hierarchy;
    records = (size_t)h->node_count * sizeof(sbl__node) + (size_t)h->triangle_count * sizeof(sbl__triangle);
    CHECK(h->node_count > 0 && stats.scene.bvh_bytes >= records && stats.scene.bvh_bytes < 32 * 200,
          "the hierarchy of 32 triangles takes %.0f bytes, its records %.0f", (double)stats.scene.bvh_bytes,
          (double)records);
    view.options.mode = SBL_MODE_PAPER;
    view.options.backend = SBL_BACKEND_AUTO;
    REQUIRE(sbl_render_picture(context, &view) == SBL_SUCCESS, "no picture");
    CHECK(sbl_query_stats(context).scene.lamps == 0, "SBL_MODE_PAPER reports %d lamps",
          sbl_query_stats(context).scene.lamps);
    sbl_destroy(context);
}

/* After all tests the counting allocator holds no blocks. */
TEST(nothing_is_left) {
    CHECK(seen.blocks == 0 && seen.strangers == 0, "%d blocks are not freed, %d were freed twice or never allocated",
          seen.blocks, seen.strangers);
}

/* The lamps become twice as bright after some leaves have been divided and before the others are divided. The light
   must double, because no leaf may be lost. */
TEST(lamps_change_while_leaves_are_divided) {
    static float before[BOUNCED], after[BOUNCED];
    sbl_context_desc desc = watch_desc(&seen);
    sbl_context *context = watch_context(&seen, &desc, &cornell);
    sbl_picture_desc view = bounced_view();
    sbl_scene_desc scene = scene_desc(&cornell);
    sbl_material materials[SCENE_MATERIALS];
    sbl_result result = SBL_UNFINISHED;
    double sum = 0, off = 0;
    int i, k, divided = 0, lost = 0;
    if (!context) return;
    view.options.rays = 256;
    scene.max_bounce_cells = 8192;
    REQUIRE(sbl_set_scene(context, &scene) == SBL_SUCCESS && sbl_render_picture(context, &view) == SBL_SUCCESS &&
            bounced_read(context, before) == SBL_SUCCESS, "no picture: %s", watch_last(&seen));
    REQUIRE(sbl_set_scene(context, &scene) == SBL_SUCCESS && sbl_begin_picture(context, &view) == SBL_SUCCESS,
            "cannot begin");
    while (result == SBL_UNFINISHED && divided < 300) {
        const sbl__bounce *b = context->core.bounce;
        result = sbl_step(context, b && b->division ? 1e-5 : 1e-3);
        b = context->core.bounce;
        divided = b && b->stages.stage == SBL__BOUNCE_DIVIDE ? b->changed : 0;
    }
    CHECK(divided >= 300, "%d leaves are divided", divided);
    memcpy(materials, cornell.materials, sizeof materials);
    for (i = 0; i < cornell.material_count; i++)
        for (k = 0; k < 3; k++) materials[i].emission[k] *= 2;
    REQUIRE(sbl_set_materials(context, materials, cornell.material_count) == SBL_SUCCESS &&
            sbl_render_picture(context, &view) == SBL_SUCCESS && bounced_read(context, after) == SBL_SUCCESS,
            "no picture: %s", watch_last(&seen));
    for (i = 0; i < BOUNCED; i++) {
        sum += (double)before[i];
        off += fabs(0.5 * (double)after[i] - (double)before[i]);
    }
    for (i = 0; i < context->core.scene.store.cut_count; i++) {
        const sbl__cut *cut = &context->core.scene.store.cuts[i];
        lost += cut->divides && (!cut->sides[0] || !cut->sides[1]);
    }
    CHECK(!lost, "%d parts of divided leaves are lost", lost);
    CHECK(off < 0.02 * sum, "the light is off by %.2f %%", 100 * off / sum);
    sbl_destroy(context);
}

int main(void) {
    if (!gl_host_open()) return 1;
    scene_cornell_box(&cornell);
    RUN(every_stage_comes_in_pieces);
    RUN(the_hierarchy_comes_in_pieces);
    RUN_UNSANITIZED(submissions_follow_the_limit);
    RUN(steps_keep_to_their_time);
    RUN(the_store_comes_in_pieces);
    RUN(the_store_is_left_at_any_step);
    RUN_UNSANITIZED(lamps_change_while_leaves_are_divided);
    RUN(programs_compile_when_used_or_ahead);
    RUN(programs_have_room);
    RUN_UNSANITIZED(each_level_is_sharper);
    RUN(late_previews_change_nothing);
    RUN(pictures_that_cannot_be_shown_are_dropped);
    RUN_UNSANITIZED(refinement_foresees_its_looks);
    RUN(surfaces_are_shown_before_sensors);
    RUN_UNSANITIZED(direct_light_is_shown_first);
    RUN(a_finished_picture_stays);
    RUN(inspection_adds_up);
    RUN(inspection_tells_levels);
    RUN(stats_tell_of_lamps_and_the_hierarchy);
    RUN(nothing_is_left);
    scene_free(&cornell);
    host_gl_close();
    return test_report();
}
