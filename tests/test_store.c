/* Tests of the store of bounced light: its use by later pictures, its update after a change of lamps, saving and
   loading, its channel in pictures, and surfaces without sensors. */
#include "../sbl.h"
#include "support/test.h"
#include "support/scenes.h"
#include "support/inside.h"
#include "support/gl_watch.h"
#include <float.h>

enum { SITES = 48, SIDE = 24, PIXELS = SIDE * SIDE, STREAM = 1 << 22, WALLS = 0, LAMP = 1, BOX = 2 };

static watch seen;
static sbl_context *context;
static test_scene scene;

/* A stream in memory. Writing fails beyond `room` bytes, and reading ends there. */
static struct { unsigned char bytes[STREAM]; size_t count, at, room; } stream;

static size_t put(const void *data, size_t bytes, void *user) {
    (void)user;
    if (bytes > stream.room - stream.count) bytes = stream.room - stream.count;
    memcpy(stream.bytes + stream.count, data, bytes);
    stream.count += bytes;
    return bytes;
}

static size_t get(void *data, size_t bytes, void *user) {
    (void)user;
    if (bytes > stream.count - stream.at) bytes = stream.count - stream.at;
    memcpy(data, stream.bytes + stream.at, bytes);
    stream.at += bytes;
    return bytes;
}

/* Makes a room with a lamp, a point light and a textured box. */
static void make_room(test_scene *s) {
    static const unsigned char checks[2 * 2 * 3] = { 255, 200, 100, 30, 60, 90, 30, 90, 60, 200, 255, 100 };
    memset(s, 0, sizeof *s);
    scene_material(s, 0.7f, 0.6f, 0.5f);
    scene_lamp(s, 6, 5, 4);
    s->materials[LAMP].albedo[1] = 0.5f;
    scene_material(s, 0.5f, 0.6f, 0.7f);
    s->materials[BOX].albedo_texture = scene_texture(s, checks, sizeof checks, SBL_PIXELS_SRGB8, 2, 2, 3);
    scene_box(s, WALLS, 0, 0, 0, 4, 3, 5);
    scene_quad(s, LAMP, 1.5f, 2.9f, 2, 2.5f, 2.9f, 2, 2.5f, 2.9f, 3, 1.5f, 2.9f, 3);
    scene_box(s, BOX, 2.5f, 0.01f, 3, 3.2f, 0.9f, 4);
    scene_light(s, SBL_LIGHT_POINT, 1, 1, 1)->position[0] = 0.7f;
    s->lights[0].position[1] = s->lights[0].position[2] = 1;
}

static sbl_result set(const test_scene *s) {
    sbl_scene_desc desc = scene_desc(s);
    desc.max_bounce_cells = 2048;
    return sbl_set_scene(context, &desc);
}

/* Creates a new context and sets the current scene. Returns 0 on failure. */
static int start(void) {
    const sbl_context_desc desc = watch_desc(&seen);
    sbl_destroy(context);
    context = NULL;
    return sbl_create(&desc, &context) == SBL_SUCCESS && set(&scene) == SBL_SUCCESS;
}

static struct { sbl_light light; float emission; uint32_t flags; int64_t rays; } first_lamp;

/* Measures the light at sites in all parts of the room. */
static sbl_result gather(sbl_reading readings[SITES]) {
    sbl_readings_desc desc;
    sbl_site sites[SITES];
    int i;
    memset(sites, 0, sizeof sites);
    for (i = 0; i < SITES; i++) {
        sites[i].position[0] = 0.3f + 0.07f * (float)i;
        sites[i].position[1] = 0.5f;
        sites[i].position[2] = 0.4f + 0.05f * (float)i;
        sites[i].normal[i % 3] = i & 1 ? 1.0f : -1.0f;
    }
    desc = scene_readings(sites, readings, SITES, SBL_MODE_GI);
    desc.options.rays = 32;
    return sbl_gather_readings(context, &desc);
}

static sbl_picture_desc view_of(float x) {
    sbl_picture_desc view = scene_view(SIDE, SIDE, 70, x, 1.5f, 0.3f, 2.2f, 1, 4);
    view.options.mode = SBL_MODE_GI;
    view.options.rays = 32;
    view.tile = 4;
    view.samples = 1;
    return view;
}

/* Checks that the light equals that of a new context, to the bit. bounced: 1: the light must have needed rays that fill
   the store */
static void same_as_fresh(const char *what, int bounced) {
    static sbl_reading here[SITES], fresh[SITES];
    REQUIRE(gather(here) == SBL_SUCCESS, "%s: %s", what, watch_last(&seen));
    CHECK((sbl_query_stats(context).store.rays > 0) == bounced, "%s: %.0f rays of bounced light", what,
          (double)sbl_query_stats(context).store.rays);
    REQUIRE(start() && gather(fresh) == SBL_SUCCESS, "%s: a new context fails: %s", what, watch_last(&seen));
    CHECK(!memcmp(here, fresh, sizeof fresh), "%s: first site %.9g, in a new context %.9g", what,
          (double)here[0].radiance[0], (double)fresh[0].radiance[0]);
}

/* >>reuse and updates of the store */

/* Returns the mean difference of two sets of readings, relative to the mean of the first set. */
static double apart(const sbl_reading one[SITES], const sbl_reading other[SITES]) {
    double sum = 0, off = 0;
    int i;
    for (i = 0; i < SITES; i++) {
        sum += (double)one[i].radiance[0];
        off += fabs((double)other[i].radiance[0] - (double)one[i].radiance[0]);
    }
    return off / sum;
}

/* Sets other lamps (others = 1) or the first ones, and measures. Checks that few rays are traced: only points may send
   rays, which find out whether they are stuck. Returns 0 on failure. */
static int measure_lamps(int others, sbl_reading readings[SITES]) {
    scene.materials[LAMP].emission[0] = others ? 1.0f : first_lamp.emission;
    scene.materials[LAMP].flags = others ? SBL_MATERIAL_ONE_SIDED_EMISSION : first_lamp.flags;
    scene.lights[0] = first_lamp.light;
    if (others) {
        scene.lights[0].intensity[1] = 0.1f;
        scene.lights[0].position[2] = 2;
    }
    if (sbl_set_materials(context, scene.materials, scene.material_count) != SBL_SUCCESS ||
        sbl_set_lights(context, scene.lights, scene.light_count) != SBL_SUCCESS ||
        gather(readings) != SBL_SUCCESS) return 0;
    CHECK(4 * sbl_query_stats(context).store.rays < first_lamp.rays, "%.0f rays of bounced light for new lamps",
          (double)sbl_query_stats(context).store.rays);
    return 1;
}

/* A change of lamps changes the light without new rays between surfaces. The leaves stay divided as for the first
   lamps; therefore the light is only close to that of a new context. It does not depend on the lamps between the first
   ones and the current ones. */
TEST(new_lamps_keep_the_rays_of_the_store) {
    static sbl_reading before[SITES], after[SITES], first[SITES], again[SITES], fresh[SITES];
    make_room(&scene);
    first_lamp.emission = scene.materials[LAMP].emission[0];
    first_lamp.flags = scene.materials[LAMP].flags;
    first_lamp.light = scene.lights[0];
    REQUIRE(start() && gather(before) == SBL_SUCCESS, "%s", watch_last(&seen));
    first_lamp.rays = sbl_query_stats(context).store.rays;
    REQUIRE(measure_lamps(1, after) && measure_lamps(0, first), "%s", watch_last(&seen));
    CHECK(after[0].radiance[0] < 0.7f * before[0].radiance[0], "other lamps do not change the light: %g, before %g",
          (double)after[0].radiance[0], (double)before[0].radiance[0]);
    CHECK(apart(before, first) < 0.02, "the first lamps again: %g of the light away from before", apart(before, first));
    REQUIRE(measure_lamps(1, again), "%s", watch_last(&seen));
    CHECK(!memcmp(after, again, sizeof again), "the other lamps again: first site %.9g, before %.9g",
          (double)again[0].radiance[0], (double)after[0].radiance[0]);
    REQUIRE(start() && gather(fresh) == SBL_SUCCESS, "%s", watch_last(&seen));
    printf("  other lamps: %.2g of the light away from a new context; the first ones again: %.2g\n",
           apart(fresh, after), apart(before, first));
    CHECK(apart(fresh, after) < 0.03, "other lamps: %g of the light away from a new context", apart(fresh, after));
    scene_free(&scene);
}

/* A change of surfaces fills the store again. The result equals that of a new context. */
TEST(surfaces_change) {
    static sbl_reading before[SITES];
    make_room(&scene);
    REQUIRE(start() && gather(before) == SBL_SUCCESS, "%s", watch_last(&seen));
    scene.materials[WALLS].albedo[2] = 0.1f;
    REQUIRE(sbl_set_materials(context, scene.materials, scene.material_count) == SBL_SUCCESS, "%s", watch_last(&seen));
    same_as_fresh("other colours", 1);
    scene.materials[BOX].albedo_texture = 0;
    REQUIRE(sbl_set_materials(context, scene.materials, scene.material_count) == SBL_SUCCESS, "%s", watch_last(&seen));
    same_as_fresh("a box without a texture", 1);
    scene.materials[BOX].flags = SBL_MATERIAL_HIDDEN_FROM_SENSORS;
    REQUIRE(sbl_set_materials(context, scene.materials, scene.material_count) == SBL_SUCCESS, "%s", watch_last(&seen));
    same_as_fresh("a box that is hidden", 1);
    scene_free(&scene);
}

/* A transform is refused that takes the second corner of a mesh too far away, but not the first. The bounds, which are
   measured again when another mesh moves, stay the same. */
static void refused_transform_changes_nothing(void) {
    static const float beyond[16] = { 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 2.8e17f, 0, 0, 0, 0, 1 }, none[16];
    sbl_bounds before, after;
    int mesh = 0;
    while (scene.meshes[mesh].material != BOX) mesh++;
    before = sbl_query_bounds(context);
    CHECK(sbl_set_mesh_transform(context, mesh, beyond) == SBL_ERROR_INVALID_ARGUMENT &&
          watch_said(&seen, SBL_LOG_ERROR, SBL_LOG_ITEM_INVALID_MESH, "vertex 1", "1e18", ""), "%s", watch_last(&seen));
    CHECK(sbl_set_mesh_transform(context, mesh + 1, none) == SBL_SUCCESS, "%s", watch_last(&seen));
    after = sbl_query_bounds(context);
    CHECK(!memcmp(&before, &after, sizeof after), "a refused transform changes the bounds to %g .. %g in z",
          (double)after.lowest[2], (double)after.highest[2]);
}

/* Materials, lights and transforms that are refused do not change the light, to the bit, or the bounds. */
TEST(refused_changes_change_nothing) {
    static sbl_reading before[SITES], after[SITES];
    sbl_picture_desc view = view_of(0.5f);
    sbl_material other[3];
    sbl_result result;
    make_room(&scene);
    CHECK(sbl_set_materials(NULL, scene.materials, 3) == SBL_ERROR_INVALID_ARGUMENT &&
          sbl_set_lights(NULL, scene.lights, 1) == SBL_ERROR_INVALID_ARGUMENT, "a NULL context is accepted");
    REQUIRE(start() && gather(before) == SBL_SUCCESS, "%s", watch_last(&seen));
    memcpy(other, scene.materials, sizeof other);
    other[WALLS].albedo[0] = 0.1f;
    other[BOX].albedo[1] = 1.5f;
    CHECK(sbl_set_materials(context, other, 3) == SBL_ERROR_INVALID_ARGUMENT &&
          watch_said(&seen, SBL_LOG_ERROR, SBL_LOG_ITEM_INVALID_MATERIAL, "material 2", "1.5", "0 to 1"), "%s",
          watch_last(&seen));
    CHECK(sbl_set_materials(context, scene.materials, 2) == SBL_ERROR_INVALID_ARGUMENT &&
          watch_said(&seen, SBL_LOG_ERROR, SBL_LOG_ITEM_INVALID_ARGUMENT, "sbl_set_materials", "2", "3"), "%s",
          watch_last(&seen));
    CHECK(sbl_set_materials(context, NULL, 3) == SBL_ERROR_INVALID_ARGUMENT &&
          sbl_set_lights(context, NULL, 1) == SBL_ERROR_INVALID_ARGUMENT, "NULL is accepted");
    scene.lights[0].intensity[0] = -1;
    CHECK(sbl_set_lights(context, scene.lights, 1) == SBL_ERROR_INVALID_ARGUMENT &&
          watch_said(&seen, SBL_LOG_ERROR, SBL_LOG_ITEM_INVALID_LIGHT, "light 0", "intensity", "-1"), "%s",
          watch_last(&seen));
    other[BOX].albedo[1] = 0.5f;
    other[LAMP].emission[0] = 3e38f;
    CHECK(sbl_set_materials(context, other, 3) == SBL_ERROR_INVALID_ARGUMENT, "an emission of 3e38 is accepted");
    REQUIRE(gather(after) == SBL_SUCCESS, "%s", watch_last(&seen));
    CHECK(!memcmp(before, after, sizeof after), "refused materials and lights change the light");
    scene.lights[0].intensity[0] = 2;
    REQUIRE(sbl_begin_picture(context, &view) == SBL_SUCCESS && sbl_step(context, 1e-9) == SBL_UNFINISHED, "%s",
            watch_last(&seen));
    watch_refuse(&seen, 1);
    result = sbl_set_lights(context, scene.lights, 1);
    CHECK(watch_refused(&seen, 1, result), "without memory, other lights are accepted");
    CHECK(sbl_step(context, 0) == SBL_SUCCESS, "a change of lights that fails has dropped the picture");
    refused_transform_changes_nothing();
    scene_free(&scene);
}

/* sbl_end frees the rays of the store even if the work that traced them was abandoned. */
TEST(the_end_frees_rays) {
    static sbl_reading readings[SITES];
    size_t with, without;
    int64_t rays;
    make_room(&scene);
    REQUIRE(start() && gather(readings) == SBL_SUCCESS, "%s", watch_last(&seen));
    rays = sbl_query_stats(context).store.rays;
    REQUIRE(sbl_set_lights(context, scene.lights, scene.light_count) == SBL_SUCCESS, "%s", watch_last(&seen));
    with = sbl_query_memory(context).host_bytes;
    sbl_end(context);
    without = sbl_query_memory(context).host_bytes;
    CHECK(rays > 10000 && without + 16 * (size_t)rays < with, "%zu bytes before sbl_end, %zu after it, %.0f rays", with,
          without, (double)rays);
    scene_free(&scene);
}

/* >>saving to streams and loading */

/* Loads the stream. The call must fail with a message that has this item and contains these words, and the light must
   not change. */
static void refused(const char *what, sbl_log_item item, const char *words) {
    static sbl_reading readings[SITES];
    stream.at = 0;
    watch_forget(&seen);
    CHECK(sbl_load_store(context, get, NULL) == SBL_ERROR_INVALID_ARGUMENT &&
          watch_said(&seen, SBL_LOG_ERROR, item, words, "", ""), "%s: %s", what, watch_last(&seen));
    CHECK(gather(readings) == SBL_SUCCESS && sbl_query_stats(context).store.rays == 0, "%s: the old store is lost",
          what);
}

/* A loaded store gives the same light as the saved one, to the bit. Loading drops a picture under way. */
TEST(saved_and_loaded) {
    static sbl_reading made[SITES], loaded[SITES];
    sbl_picture_desc view;
    make_room(&scene);
    stream.count = stream.at = 0;
    stream.room = STREAM;
    REQUIRE(start(), "%s", watch_last(&seen));
    CHECK(sbl_save_store(context, put, NULL) == SBL_ERROR_STATE, "a store is saved before there is one");
    REQUIRE(gather(made) == SBL_SUCCESS && sbl_save_store(context, put, NULL) == SBL_SUCCESS, "%s", watch_last(&seen));
    REQUIRE(start() && sbl_load_store(context, get, NULL) == SBL_SUCCESS, "%s", watch_last(&seen));
    CHECK(stream.at == stream.count, "%.0f of %.0f bytes are read", (double)stream.at, (double)stream.count);
    REQUIRE(gather(loaded) == SBL_SUCCESS, "%s", watch_last(&seen));
    CHECK(sbl_query_stats(context).store.rays == 0, "a loaded store is filled again");
    CHECK(!memcmp(made, loaded, sizeof made), "first site %.9g, loaded %.9g", (double)made[0].radiance[0],
          (double)loaded[0].radiance[0]);
    view = view_of(0);
    stream.at = 0;
    REQUIRE(sbl_begin_picture(context, &view) == SBL_SUCCESS && sbl_step(context, 1e-9) == SBL_UNFINISHED &&
            sbl_load_store(context, get, NULL) == SBL_SUCCESS, "%s", watch_last(&seen));
    CHECK(sbl_step(context, 0) == SBL_ERROR_STATE, "a picture goes on with another store");
    scene.materials[LAMP].emission[1] = 9;
    REQUIRE(sbl_set_materials(context, scene.materials, scene.material_count) == SBL_SUCCESS, "%s", watch_last(&seen));
    same_as_fresh("other lamps over a loaded store", 1);
    scene_free(&scene);
}

/* Creates a context with the current scene, measures light, and saves the store to the stream. Returns 0 on failure. */
static int start_and_save(sbl_reading readings[SITES]) {
    stream.count = stream.at = 0;
    stream.room = STREAM;
    return start() && gather(readings) == SBL_SUCCESS && sbl_save_store(context, put, NULL) == SBL_SUCCESS;
}

/* Damaged and incomplete streams, and streams of other versions and machines, are refused, each with its own
   message. */
TEST(streams_that_are_refused) {
    static const char *const words[] = { "not stored light", "another version", "byte order" };
    static sbl_reading made[SITES];
    size_t whole, i;
    make_room(&scene);
    REQUIRE(start_and_save(made), "%s", watch_last(&seen));
    whole = stream.count;
    for (i = 0; i < 3; i++) {
        const size_t place = i ? 4 * i + 4 : 0;
        stream.bytes[place] ^= 0x40;
        refused(words[i], i ? SBL_LOG_ITEM_OTHER_STORE : SBL_LOG_ITEM_INVALID_STORE, words[i]);
        stream.bytes[place] ^= 0x40;
    }
    for (i = 0; i < 44; i++) {  /* flips one bit, 4 times in the hashes of the scene and 40 times after the header */
        const size_t at = i < 4 ? 16 + 8 * i : 80 + (whole - 80) * (i - 4) / 40;
        stream.bytes[at] ^= (unsigned char)(1 << i % 8);
        refused("a bit", SBL_LOG_ITEM_INVALID_STORE, "");
        stream.bytes[at] ^= (unsigned char)(1 << i % 8);
    }
    for (i = 0; i < 20; i++) {
        stream.count = whole * i / 20;
        refused("a part", SBL_LOG_ITEM_INVALID_STORE, i ? "too soon" : "not stored light");
    }
    stream.count = stream.at = 0;
    stream.room = whole - 1;
    CHECK(sbl_save_store(context, put, NULL) == SBL_ERROR_INVALID_ARGUMENT, "a full disk is not reported");
    scene_free(&scene);
}

/* Makes the room, with a sky picture. */
static void make_room_with_sky(test_scene *s) {
    float sky[4 * 2 * 3];
    int i;
    for (i = 0; i < 24; i++) sky[i] = 0.2f;
    make_room(s);
    scene_texture(s, sky, sizeof sky, SBL_PIXELS_FLOAT, 4, 2, 3);
    s->environment.picture = s->textures[--s->texture_count];
}

/* Makes change `number` to the scene, which the stored light depends on. Returns the words by which the message must
   name it, or NULL if there is no such change. */
static const char *change(test_scene *s, int number) {
    static const float tilted[12] = { 0.1f, -1, 0, 0.1f, -1, 0, 0.1f, -1, 0, 0.1f, -1, 0 };
    sbl_mesh *lamp = s->meshes;
    while (lamp->material != LAMP) lamp++;
    switch (number) {
        case 0: lamp->transform[0] = lamp->transform[5] = lamp->transform[10] = lamp->transform[15] = 1;
                lamp->transform[12] = 0.1f;
                return "a scene with other meshes";
        case 1: lamp->normals.data = scene_copy(s, tilted, 12); return "a scene with other meshes";
        case 2: s->mesh_count--; return "a scene with other meshes and other materials or textures";
        case 3: s->materials[WALLS].albedo[1] = 0.5f; return "a scene with other materials or textures";
        case 4: lamp->material = WALLS; return "a scene with other materials or textures";
        case 5: ((unsigned char *)(uintptr_t)s->textures[0].pixels)[0] ^= 8;
                return "a scene with other materials or textures";
        case 6: s->lights[0].intensity[2] = 2; return "a scene with other lights";
        case 7: s->light_count = 0; return "a scene with other lights";
        case 8: s->sky[0] = 0.1f; return "a scene with another sky";
        case 9: s->environment.rotation = 90; return "a scene with another sky";
        case 10: s->environment.scale = 0.5f; return "a scene with another sky";
        case 11: s->environment.picture.width = 2;  /* the same texels in another shape */
                 s->environment.picture.height = 4;
                 return "a scene with another sky";
        case 12: s->sky[2] = 0.1f;
                 s->lights[0].position[0] = 1;
                 s->materials[LAMP].emission[0] = 2;
                 return "a scene with other materials or textures, other lights and another sky";
        default: return NULL;
    }
}

/* A stored light of another scene is refused, and the message names exactly the parts of the scene that differ. An
   incomplete or damaged stream of another scene is refused as damaged. */
TEST(parts_that_differ_are_named) {
    static sbl_reading made[SITES];
    const char *words, *end;
    size_t whole;
    int i;
    make_room_with_sky(&scene);
    REQUIRE(start_and_save(made), "%s", watch_last(&seen));
    whole = stream.count;
    for (i = 0;; i++) {
        scene_free(&scene);
        make_room_with_sky(&scene);
        words = change(&scene, i);
        REQUIRE(set(&scene) == SBL_SUCCESS, "%s", watch_last(&seen));
        watch_forget(&seen);
        stream.at = 0;
        if (!words) break;
        CHECK(sbl_load_store(context, get, NULL) == SBL_ERROR_INVALID_ARGUMENT &&
              watch_said(&seen, SBL_LOG_ERROR, SBL_LOG_ITEM_OTHER_STORE, words, "", ""), "change %d: %s, expected %s",
              i, watch_last(&seen), words);
        end = strstr(watch_last(&seen), words);
        CHECK(end && !end[strlen(words)], "change %d: %s, expected only %s", i, watch_last(&seen), words);
    }
    CHECK(sbl_load_store(context, get, NULL) == SBL_SUCCESS, "the same scene: %s", watch_last(&seen));
    scene.sky[0] = 0.1f;
    REQUIRE(set(&scene) == SBL_SUCCESS && gather(made) == SBL_SUCCESS, "%s", watch_last(&seen));
    refused("another sky", SBL_LOG_ITEM_OTHER_STORE, "another sky");
    stream.count = whole - 100;
    refused("a part of another scene's stream", SBL_LOG_ITEM_INVALID_STORE, "too soon");
    stream.count = whole;
    stream.bytes[whole / 2] ^= 4;
    refused("another scene's stream with a wrong bit", SBL_LOG_ITEM_INVALID_STORE, "damaged");
    scene_free(&scene);
}

/* Light that was made with fewer cells than the scene allows is loaded with a warning. It is saved with its own number
   of cells. */
TEST(a_store_with_few_cells_causes_a_warning) {
    static sbl_reading made[SITES];
    sbl_scene_desc desc;
    int i;
    make_room(&scene);
    REQUIRE(start_and_save(made), "%s", watch_last(&seen));
    desc = scene_desc(&scene);
    for (i = 0; i < 4; i++) {
        const int limit = i % 2 ? 4096 : 1024, coarse = limit > 2048;  /* the saved scene allows 2048 */
        if (i == 2) {  /* saves the loaded light from a scene with another limit */
            stream.count = 0;
            REQUIRE(sbl_save_store(context, put, NULL) == SBL_SUCCESS, "%s", watch_last(&seen));
        }
        desc.max_bounce_cells = limit;
        REQUIRE(sbl_set_scene(context, &desc) == SBL_SUCCESS, "%s", watch_last(&seen));
        watch_forget(&seen);
        stream.at = 0;
        CHECK(sbl_load_store(context, get, NULL) == SBL_SUCCESS, "limit %d: %s", limit, watch_last(&seen));
        CHECK(watch_said(&seen, SBL_LOG_WARNING, SBL_LOG_ITEM_COARSE_STORE, "2048", "4096", "finer") == coarse,
              "limit %d: %s", limit, watch_last(&seen));
    }
    for (i = 0; i < 2; i++) {  /* a picture keeps loaded light unless it sets another number */
        sbl_picture_desc view = scene_view(8, 8, 40, 0, 1, 3, 0, 0.5f, 0);
        view.options.mode = SBL_MODE_GI;
        view.max_bounce_cells = i ? 1024 : 2048;
        CHECK(sbl_render_picture(context, &view) == SBL_SUCCESS &&
                  (sbl_query_stats(context).store.rays > 0) == i &&
                  sbl_query_stats(context).store.max_cells == view.max_bounce_cells,
              "%d cells: %.0f rays", view.max_bounce_cells, (double)sbl_query_stats(context).store.rays);
    }
    scene_free(&scene);
}

/* The default of max_bounce_cells increases with the number of triangles, within limits. A picture may raise it to
   196608, but neither a number that the host sets nor the value -1. The warning about coarse light names the number of
   cells. */
TEST(more_triangles_get_more_cells) {
    static const struct { int slices, stacks; const char *cells; } balls[] = {  /* the room has 26 triangles */
        { 8, 5, "49152" }, { 200, 101, "60039" }, { 400, 166, "196608" } };
    static sbl_reading made[SITES];
    int i;
    for (i = 0; i < (int)(sizeof balls / sizeof balls[0]); i++) {
        sbl_scene_desc desc;
        make_room(&scene);
        scene_sphere(&scene, BOX, 1, 0.7f, 3, 0.4f, balls[i].slices, balls[i].stacks, 0);
        REQUIRE(start_and_save(made), "%s", watch_last(&seen));
        desc = scene_desc(&scene);
        CHECK(inside_most_cells(context) == 2048, "a picture may raise 2048 cells to %d", inside_most_cells(context));
        desc.max_bounce_cells = -1;
        REQUIRE(sbl_set_scene(context, &desc) == SBL_SUCCESS, "%s", watch_last(&seen));
        CHECK(inside_most_cells(context) == atoi(balls[i].cells), "a picture may raise %s cells to %d", balls[i].cells,
              inside_most_cells(context));
        desc.max_bounce_cells = 0;
        REQUIRE(sbl_set_scene(context, &desc) == SBL_SUCCESS, "%s", watch_last(&seen));
        CHECK(inside_most_cells(context) == 196608, "a picture may raise the number to %d", inside_most_cells(context));
        watch_forget(&seen);
        stream.at = 0;
        CHECK(sbl_load_store(context, get, NULL) == SBL_SUCCESS &&
              watch_said(&seen, SBL_LOG_WARNING, SBL_LOG_ITEM_COARSE_STORE, "2048", balls[i].cells, "finer"),
              "ball %d: %s", i, watch_last(&seen));
        scene_free(&scene);
    }
}

static uint32_t word_of(size_t number) {
    uint32_t word;
    memcpy(&word, stream.bytes + 4 * number, 4);
    return word;
}

/* Replaces word `number` of the stream, and updates its checksum. */
static void forge(size_t number, uint32_t word) {
    uint64_t sum;
    memcpy(stream.bytes + 4 * number, &word, 4);
    sum = inside_saved_sum(stream.bytes, stream.count - 8);
    memcpy(stream.bytes + stream.count - 8, &sum, 8);
}

/* A stream with a valid checksum and one value that no store can have is refused. The test tries one value of each
   kind. */
TEST(forged_values_are_refused) {
    enum { TRIANGLES = 13, CELLS, CUTS, LEAVES, ORIGIN = 18, LENGTH = 21, AIR = 22, PATCHES = 40 };  /* 32-bit words */
    static sbl_reading readings[SITES];
    size_t cells, leaves, places[8];
    int i;
    make_room(&scene);
    REQUIRE(start_and_save(readings), "%s", watch_last(&seen));
    cells = PATCHES + word_of(TRIANGLES);
    leaves = stream.count / 4 - 2 - 4 * (size_t)word_of(LEAVES);
    REQUIRE(word_of(CUTS) > 0 && cells + 2 * (size_t)word_of(CELLS) + 8 * (size_t)word_of(CUTS) == leaves,
            "the format has changed: %u cuts", word_of(CUTS));
    places[0] = CELLS;
    places[1] = ORIGIN + 1;
    places[2] = LENGTH;
    places[3] = AIR + 17;
    places[4] = cells + 11;       /* the reference in the sixth slot */
    places[5] = leaves - 8 + 4;   /* a child of the last cut */
    places[6] = leaves - 8 + 2;   /* the normal of the last cut */
    places[7] = stream.count / 4 - 2 - 3;  /* the green channel of the last leaf */
    for (i = 0; i < 8; i++) {
        const uint32_t word = word_of(places[i]);
        forge(places[i], 0x7fc00000u);  /* a NaN as a float, and too large as a reference or a count */
        refused("a forged value", SBL_LOG_ITEM_INVALID_STORE, "damaged");
        forge(places[i], word);
    }
    stream.at = 0;
    CHECK(sbl_load_store(context, get, NULL) == SBL_SUCCESS, "%s", watch_last(&seen));
    scene_free(&scene);
}

/* Streams may have a valid checksum and wrong contents: references that are out of range or circular, and light that is
   not finite. Such streams are refused, or give finite light. */
TEST(forged_streams_do_no_harm) {
    static sbl_reading readings[SITES];
    uint32_t state = 7;
    int i, k, accepted = 0;
    make_room(&scene);
    REQUIRE(start() && gather(readings) == SBL_SUCCESS, "%s", watch_last(&seen));
    for (i = 0; i < 60; i++) {
        size_t words;
        stream.count = stream.at = 0;
        stream.room = STREAM;
        REQUIRE(sbl_save_store(context, put, NULL) == SBL_SUCCESS, "%s", watch_last(&seen));
        words = (stream.count - 8) / 4;
        for (k = 0; k < 4; k++) {
            uint32_t word;
            state = test_hash(state);
            word = state % 3 ? state : 0xffffffffu >> state % 29;
            forge(12 + test_hash(state) % (i % 2 ? 12 : words - 12), word);
        }
        accepted += sbl_load_store(context, get, NULL) == SBL_SUCCESS;
        REQUIRE(gather(readings) == SBL_SUCCESS, "forgery %d: %s", i, watch_last(&seen));
        for (k = 0; k < SITES; k++)
            CHECK(readings[k].radiance[0] >= 0 && readings[k].radiance[0] <= FLT_MAX, "forgery %d: R is %g", i,
                  (double)readings[k].radiance[0]);
        if (i % 8 == 7) REQUIRE(start() && gather(readings) == SBL_SUCCESS, "%s", watch_last(&seen));
    }
    CHECK(accepted < 60, "all forgeries are accepted");
    scene_free(&scene);
}

/* >>progress of the store */

static struct { int calls, stop_at; float last; int falls; } told;

static int on_progress(float done, void *user) {
    (void)user;
    told.falls += done < told.last;
    told.last = done;
    return ++told.calls == told.stop_at;
}

/* Even in a single call the store is filled in pieces. Each piece calls the progress callback, which can cancel. */
TEST(progress_covers_the_store) {
    sbl_picture_desc view = view_of(0.5f);
    sbl_readings_desc desc;
    sbl_reading reading;
    sbl_site site;
    int calls, i;
    make_room(&scene);
    view.options.progress = on_progress;
    memset(&told, 0, sizeof told);
    REQUIRE(start() && sbl_render_picture(context, &view) == SBL_SUCCESS, "%s", watch_last(&seen));
    CHECK(told.calls > 30 && !told.falls && told.last >= 1, "%d calls, %d of them decreasing, the last one %g",
          told.calls,
          told.falls, (double)told.last);
    calls = told.calls;
    memset(&told, 0, sizeof told);
    told.stop_at = calls / 5;
    REQUIRE(start() && sbl_render_picture(context, &view) == SBL_CANCELLED, "the picture is not cancelled: %s",
            watch_last(&seen));
    CHECK(told.calls == told.stop_at && told.last > 0.02f && told.last < 0.34f, "%d calls, %g done", told.calls,
          (double)told.last);
    same_as_fresh("after a cancelled store", 1);
    memset(&site, 0, sizeof site);  /* once the store is there, readings begin at 0 */
    memset(&desc, 0, sizeof desc);
    for (i = 0; i < 3; i++) site.position[i] = 1;
    site.normal[1] = 1;
    desc.sites = &site;
    desc.readings = &reading;
    desc.site_count = 1;
    REQUIRE(sbl_gather_readings(context, &desc) == SBL_SUCCESS && sbl_begin_readings(context, &desc) == SBL_SUCCESS,
            "%s", watch_last(&seen));
    sbl_step(context, 1e-9);
    CHECK(sbl_progress(context) < 0.3f, "readings begin with a progress of %g", (double)sbl_progress(context));
    scene_free(&scene);
}

/* >>SBL_CHANNEL_STORE */

/* SBL_CHANNEL_STORE shows R as the store has it. Surfaces without sensors get R from the store. In modes without
   bounced light the channel is 0. */
TEST(pictures_of_the_store) {
    static float stored[3 * PIXELS], light[3 * PIXELS], excluded[3 * PIXELS], sensors[PIXELS], ids[PIXELS];
    sbl_picture_desc view = view_of(0.5f);
    double sums[3] = { 0, 0, 0 }, box[2] = { 0, 0 };
    int i, shown = 0, sensed = 0;
    make_room(&scene);
    scene.meshes[scene.mesh_count - 1].id = 77;
    REQUIRE(start() && sbl_render_picture(context, &view) == SBL_SUCCESS, "%s", watch_last(&seen));
    REQUIRE(sbl_read_channel(context, SBL_CHANNEL_STORE, stored, 3 * PIXELS) == SBL_SUCCESS &&
            sbl_read_channel(context, SBL_CHANNEL_RADIANCE, light, 3 * PIXELS) == SBL_SUCCESS, "%s", watch_last(&seen));
    CHECK(sbl_channel_texture(context, SBL_CHANNEL_STORE) != 0, "no texture: %s", watch_last(&seen));
    for (i = 0; i < 3 * PIXELS; i++) { sums[0] += (double)stored[i]; sums[1] += (double)light[i]; }
    CHECK(fabs(sums[0] / sums[1] - 1) < 0.1, "R of the store is %g of R", sums[0] / sums[1]);
    scene.materials[BOX].flags = SBL_MATERIAL_NO_SENSORS;
    for (i = 0; i < scene.mesh_count; i++) if (scene.meshes[i].material == BOX) scene.meshes[i].id = 77;
    REQUIRE(set(&scene) == SBL_SUCCESS && sbl_render_picture(context, &view) == SBL_SUCCESS, "%s", watch_last(&seen));
    REQUIRE(sbl_read_channel(context, SBL_CHANNEL_RADIANCE, excluded, 3 * PIXELS) == SBL_SUCCESS &&
            sbl_read_channel(context, SBL_CHANNEL_SENSORS, sensors, PIXELS) == SBL_SUCCESS &&
            sbl_read_channel(context, SBL_CHANNEL_ID, ids, PIXELS) == SBL_SUCCESS, "%s", watch_last(&seen));
    for (i = 0; i < PIXELS; i++) {
        if (ids[i] < 77 || ids[i] > 77) continue;
        shown++;
        sensed += sensors[i] > 0;
        box[0] += (double)excluded[3 * i];
        box[1] += (double)light[3 * i];
    }
    CHECK(shown > 20 && sensed == 0, "%d pixels show the box, %d have sensors", shown, sensed);
    CHECK(fabs(box[0] / box[1] - 1) < 0.15, "R of the box is %g of the R that sensors find", box[0] / box[1]);
    /* If looks are too noisy for the target, sensors start again with guided rays. This must not place sensors on
       surfaces without sensors. */
    view.options.rays = 0;
    REQUIRE(sbl_render_picture(context, &view) == SBL_SUCCESS, "%s", watch_last(&seen));
    for (i = sensed = 0; i < PIXELS; i++)
        sensed += ids[i] >= 77 && ids[i] <= 77 && inside_pixel_looks(context, (size_t)i) > 0;
    CHECK(sensed == 0, "after a restart, %d pixels of the box have sensors", sensed);
    view.options.rays = 32;
    view.options.mode = SBL_MODE_DIRECT;
    REQUIRE(sbl_render_picture(context, &view) == SBL_SUCCESS &&
            sbl_read_channel(context, SBL_CHANNEL_STORE, stored, 3 * PIXELS) == SBL_SUCCESS, "%s", watch_last(&seen));
    for (i = 0; i < 3 * PIXELS; i++) sums[2] += (double)stored[i];
    CHECK(sums[2] == 0, "in SBL_MODE_DIRECT the channel has a sum of %g", sums[2]);
    scene_free(&scene);
}

int main(void) {
    RUN(new_lamps_keep_the_rays_of_the_store);
    RUN(surfaces_change);
    RUN(refused_changes_change_nothing);
    RUN(the_end_frees_rays);
    RUN(saved_and_loaded);
    RUN(streams_that_are_refused);
    RUN(parts_that_differ_are_named);
    RUN(a_store_with_few_cells_causes_a_warning);
    RUN(more_triangles_get_more_cells);
    RUN(forged_values_are_refused);
    RUN(forged_streams_do_no_harm);
    RUN(progress_covers_the_store);
    RUN(pictures_of_the_store);
    sbl_destroy(context);
    return test_report();
}
