/* Tests that everything besides plain pictures does not change unintentionally: glossy pictures, windows, lightmaps,
   vertices, readings, probes, inspections, the store, and statistics. A hash of each is stored for each renderer, as in
   test_pinned.c. A commit that changes light intentionally updates the hashes. */
#include "../sbl.h"
#include "support/test.h"
#include "support/scenes.h"
#include "support/pins.h"
#include "support/gl_watch.h"
#include "support/lightmap.h"
#include "support/inside.h"

enum { GROUPS = 3, SIZE = 40, HEIGHT = 32, TEXELS = SIZE * SIZE, LAYERS = 5 };
enum { LAMPS, LIGHTS, SKY };  /* the light groups */

static float buffer[3 * GROUPS * 4096];

/* >>scenes */

static void lit_from(sbl_light *light, float x, float y, float z, float dx, float dy, float dz) {
    const float position[3] = { x, y, z }, direction[3] = { dx, dy, dz };
    memcpy(light->position, position, sizeof position);
    memcpy(light->direction, direction, sizeof direction);
    light->light_group = LIGHTS;
}

/* Makes a room with a gap in the ceiling. Its floor consists of two charts with a seam, a wall and a ball have charts,
   too. A lamp shines at the ceiling from a bowl, so that bright leaves become lamps; there are lights of all kinds. */
static void room(test_scene *s) {
    static const unsigned char checks[] = { 255, 255, 255, 255, 200, 30, 20, 255, 20, 60, 190, 90, 240, 240, 80, 255 };
    const int white = scene_material(s, 0.7f, 0.7f, 0.7f), red = scene_material(s, 0.7f, 0.3f, 0.2f);
    const int lamp = scene_lamp(s, 60, 50, 40), cloth = scene_material(s, 0.9f, 0.8f, 0.7f);
    sbl_mesh *ball;
    float *uv;
    int i;
    s->materials[cloth].albedo_texture = scene_texture(s, checks, sizeof checks, SBL_PIXELS_SRGB8, 2, 2, 4);
    s->materials[cloth].alpha_cutoff = 0.5f;
    s->materials[lamp].light_group = LAMPS;
    uv_rectangle(s, scene_quad(s, white, -1, 0, -1, -1, 0, 1, 0, 0, 1, 0, 0, -1), 0.03f, 0.03f, 0.27f, 0.47f);
    uv_rectangle(s, scene_quad(s, white, 0, 0, -1, 0, 0, 1, 1, 0, 1, 1, 0, -1), 0.33f, 0.03f, 0.57f, 0.47f);
    uv_rectangle(s, scene_quad(s, red, -1, 0, -1, -1, 2, -1, -1, 2, 1, -1, 0, 1), 0.03f, 0.53f, 0.47f, 0.97f);
    scene_quad(s, white, 1, 0, -1, 1, 0, 1, 1, 2, 1, 1, 2, -1);
    scene_quad(s, white, -1, 0, -1, 1, 0, -1, 1, 2, -1, -1, 2, -1);
    scene_quad(s, white, -1, 2, -1, 0.6f, 2, -1, 0.6f, 2, 1, -1, 2, 1);
    scene_box(s, red, 0.2f, 0, -0.8f, 0.7f, 0.5f, -0.4f);
    ball = scene_sphere(s, white, -0.4f, 0.35f, 0.2f, 0.35f, 10, 6, 1);
    uv = (float *)scene_alloc(s, sizeof(float) * 2 * (size_t)ball->vertex_count);
    for (i = 0; i < ball->vertex_count; i++) {
        uv[2 * i] = 0.53f + 0.44f * (float)(i % 11) / 10;
        uv[2 * i + 1] = 0.53f + 0.44f * (float)(i / 11) / 6;
    }
    ball->lightmap_texcoords.data = uv;
    scene_quad(s, lamp, -0.7f, 1.6f, -0.7f, -0.7f, 1.6f, -0.5f, -0.5f, 1.6f, -0.5f, -0.5f, 1.6f, -0.7f);
    scene_box(s, red, -0.75f, 1.5f, -0.75f, -0.45f, 1.58f, -0.45f);
    scene_quad(s, cloth, 0.1f, 0.8f, 0.9f, 0.9f, 0.8f, 0.7f, 0.9f, 1.6f, 0.7f, 0.1f, 1.6f, 0.9f);
    lit_from(scene_light(s, SBL_LIGHT_POINT, 0.2f, 0.3f, 0.5f), 0.6f, 1.3f, -0.6f, 0, 0, 0);
    s->lights[0].radius = 0.05f;
    lit_from(scene_light(s, SBL_LIGHT_SPOT, 0.5f, 0.5f, 0.2f), 0.5f, 1.8f, 0.3f, -1, -2, 0);
    s->lights[1].cone = 70;
    lit_from(scene_light(s, SBL_LIGHT_DIRECTIONAL, 3, 2.5f, 2), 0, 0, 0, -0.4f, -1, 0.2f);
    s->lights[2].angle = 1;
    scene_sky(s, 0.5f, 0.7f, 1);
    for (i = 0; i < s->mesh_count; i++) s->meshes[i].id = (uint32_t)i + 1;
}

static void shine(sbl_material *m, float metallic, float roughness) {
    m->ior = 1.5f;
    m->metallic = metallic;
    m->roughness = roughness;
}

/* Makes the walls glossy, the ball and the box metal, and the cloth a pane; adds textures of roughness and normals. */
static void polish(test_scene *s) {
    static const unsigned char rough[] = { 0, 255, 255, 0, 90, 40 }, bumps[] = { 150, 110, 250, 110, 150, 240 };
    const int ball = scene_material(s, 0.9f, 0.8f, 0.4f);
    shine(&s->materials[0], 0, 0.4f);
    shine(&s->materials[1], 1, 0.3f);
    shine(&s->materials[3], 0, 0);
    shine(&s->materials[ball], 1, 0.02f);
    s->meshes[12].material = ball;
    s->materials[3].transmission = 0.8f;
    s->materials[1].specular_texture = scene_texture(s, rough, sizeof rough, SBL_PIXELS_LINEAR8, 2, 1, 3);
    s->materials[0].normal_texture = scene_texture(s, bumps, sizeof bumps, SBL_PIXELS_LINEAR8, 2, 1, 3);
    s->materials[0].normal_scale = 0.7f;
}

static int set_room(int glossy, int cells) {
    static test_scene s;
    sbl_scene_desc desc;
    scene_free(&s);
    room(&s);
    if (glossy) polish(&s);
    desc = scene_desc(&s);
    desc.max_bounce_cells = cells;
    desc.light_groups = GROUPS;
    desc.sky_group = SKY;
    return sbl_set_scene(context, &desc) == SBL_SUCCESS;
}

/* Makes a closed room in which a spot light shines at the ceiling from below, where the bright place is a lamp. A dim
   light belongs to another light group. */
static int set_glow_room(uint32_t ground_flags) {
    static test_scene s;
    sbl_scene_desc desc;
    int white, blue;
    scene_free(&s);
    white = scene_material(&s, 0.8f, 0.7f, 0.6f);
    blue = scene_material(&s, 0.5f, 0.6f, 0.7f);
    s.materials[blue].flags = ground_flags;
    scene_box(&s, white, -1.01f, -0.01f, -0.99f, 1.02f, 2.03f, 1.04f);
    uv_rectangle(&s, scene_quad(&s, blue, -1, 0, -1, -1, 0, 1, 1, 0, 1, 1, 0, -1), 0.03f, 0.03f, 0.57f, 0.57f);
    scene_box(&s, white, -0.6f, 0.4f, -0.4f, -0.1f, 0.6f, 0.1f);
    lit_from(scene_light(&s, SBL_LIGHT_SPOT, 9, 8, 6), 0.33f, 1.4f, 0.21f, 0.1f, 1, 0);
    s.lights[0].cone = 40;
    lit_from(scene_light(&s, SBL_LIGHT_POINT, 0.2f, 0.1f, 0.3f), -0.5f, 1, 0.6f, 0, 0, 0);
    s.lights[1].light_group = LAMPS;
    desc = scene_desc(&s);
    desc.max_bounce_cells = 2000;
    desc.light_groups = GROUPS;
    desc.sky_group = SKY;
    return sbl_set_scene(context, &desc) == SBL_SUCCESS;
}

/* >>hashes */

typedef uint64_t hash;

static hash add_channels(hash h, int width, int height) {
    int channel;
    for (channel = 0; channel < SBL_CHANNEL_COUNT; channel++) {
        const size_t floats = (size_t)(width * height * sbl_channel_components((sbl_channel)channel));
        CHECK(floats <= sizeof buffer / sizeof *buffer &&
                  sbl_read_channel(context, (sbl_channel)channel, buffer, floats) == SBL_SUCCESS,
              "channel %d cannot be read", channel);
        h = pins_add(h, buffer, sizeof(float) * floats);
    }
    return h;
}

/* Adds the counts and errors of the statistics, without seconds and numbers of transfers. */
static hash add_stats(hash h) {
    const sbl_stats t = sbl_query_stats(context);
    h = pins_add(h, &t.scene.triangles, sizeof t.scene.triangles);
    h = pins_add(h, &t.scene.lamps, sizeof t.scene.lamps);
    h = pins_add(h, &t.store, sizeof t.store);
    h = pins_add(h, &t.sensors.sites, sizeof t.sensors.sites);
    h = pins_add(h, &t.sensors.invalid, sizeof t.sensors.invalid);
    h = pins_add(h, &t.sensors.rays, sizeof t.sensors.rays);
    h = pins_add(h, &t.picture.visible_pixels, sizeof t.picture.visible_pixels);
    h = pins_add(h, &t.picture.expected_error, sizeof(float) * 3);
    h = pins_add(h, &t.picture.price, sizeof(float) * 11);  /* up to mean_final */
    h = pins_add(h, &t.picture.levels, sizeof t.picture.levels);
    return pins_add(h, &t.lightmap, sizeof t.lightmap);
}

static sbl_picture_desc view_of(sbl_mode mode) {
    sbl_picture_desc view = scene_view(SIZE, HEIGHT, 60, 0.3f, 1, 2.6f, 0, 0.8f, 0);
    view.options.mode = mode;
    view.target_error = 0.05f;
    view.samples = 2;
    view.tone = SBL_TONE_NEUTRAL;
    view.auto_exposure = 1;
    return view;
}

static hash picture(sbl_picture_desc view) {
    const sbl_result result = sbl_render_picture(context, &view);
    CHECK(result == SBL_SUCCESS, "%s", watch_last(&seen));
    if (result != SBL_SUCCESS) return 0;
    return add_stats(add_channels(PINS_EMPTY, view.window[2] ? view.window[2] : SIZE,
                                  view.window[2] ? view.window[3] : HEIGHT));
}

/* >>cases */

static hash matte_picture(void) { return set_room(0, 3000) ? picture(view_of(SBL_MODE_GI)) : 0; }
static hash glossy_picture(void) { return set_room(1, 3000) ? picture(view_of(SBL_MODE_GI)) : 0; }

static hash glossy_window(void) {
    sbl_picture_desc view = view_of(SBL_MODE_GI);
    const int window[4] = { 5, 8, 24, 16 };
    int k;
    memcpy(view.window, window, sizeof window);
    for (k = 0; k < 3; k++) view.mean_radiance[k] = 0.5f;
    view.price = 2e-3f;
    view.tone = SBL_TONE_AGX;
    return picture(view);
}

static hash glossy_inspection(void) {
    static const int pixels[3][2] = { { 10, 24 }, { 25, 20 }, { 3, 5 } };
    hash h = picture(view_of(SBL_MODE_DIRECT));
    int i, k;
    for (i = 0; i < 3; i++) {
        sbl_sensor sensor;
        CHECK(sbl_inspect_sensor(context, pixels[i][0], pixels[i][1], &sensor, NULL, NULL, 0) == SBL_SUCCESS, "%s",
              watch_last(&seen));
        h = pins_add(pins_add(h, sensor.position, sizeof sensor.position), sensor.normal, sizeof sensor.normal);
        h = pins_add(pins_add(h, sensor.radiance, sizeof sensor.radiance), &sensor.noise, sizeof sensor.noise);
        h = pins_add(h, sensor.from_surroundings, sizeof(float) * 6);
        h = pins_add(h, &sensor.back_share, sizeof(float) * 3);
        for (k = 0; k < sensor.ray_count; k++) h = pins_add(h, &sensor.rays[k], sizeof sensor.rays[k]);
        for (k = 0; k < sensor.lamp_count; k++) h = pins_add(h, &sensor.lamps[k], sizeof sensor.lamps[k]);
    }
    return h;
}

static hash glossy_rasterised(void) {
    sbl_picture_desc view = view_of(SBL_MODE_AMBIENT);
    view.options.backend = SBL_BACKEND_RASTER;
    view.options.sensor_size = 8;
    view.options.preset = SBL_PRESET_DRAFT;
    return picture(view);
}

/* Fixed rays, refinement by a threshold, an orthographic camera and no filter. */
static hash plain_picture(void) {
    sbl_picture_desc view = view_of(SBL_MODE_GI);
    memset(view.view_to_clip, 0, sizeof view.view_to_clip);
    view.view_to_clip[0] = 0.7f;
    view.view_to_clip[5] = 0.9f;
    view.view_to_clip[10] = -0.1f;
    view.view_to_clip[15] = 1;
    view.options.rays = 24;
    view.options.seed = 7;
    view.tile = 8;
    view.threshold = 0.2f;
    view.filter_radius = -1;
    view.facet_limit = 3;
    view.auto_exposure = 0;
    view.exposure = 1.5f;
    return picture(view);
}

static size_t hash_bytes(const void *data, size_t size, void *user) {
    *(hash *)user = pins_add(*(hash *)user, data, size);
    return size;
}

static hash store(void) {
    hash h = PINS_EMPTY;
    return sbl_save_store(context, hash_bytes, &h) == SBL_SUCCESS ? h : 0;
}

/* Dims the lamp, which reuses the rays of the store, and moves the cloth, which does not. */
static hash changed_picture(void) {
    static const float moved[16] = { 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, -0.3f, 0.1f, -0.2f, 1 };
    static test_scene s;
    hash h = 0;
    room(&s);
    s.materials[2].emission[0] *= 0.3f;
    if (set_room(0, 3000) && picture(view_of(SBL_MODE_GI)) &&
        sbl_set_materials(context, s.materials, s.material_count) == SBL_SUCCESS) h = picture(view_of(SBL_MODE_GI));
    if (sbl_set_mesh_transform(context, s.mesh_count - 1, moved) == SBL_SUCCESS)
        h ^= picture(view_of(SBL_MODE_DIRECT));
    scene_free(&s);
    return h;
}

static sbl_lightmap_desc room_map(sbl_mode mode) {
    sbl_lightmap_desc desc = map_of(SIZE, SIZE, mode);
    desc.gutter = 3;
    desc.target_error = 0.05f;
    return desc;
}

static hash lightmap(const sbl_lightmap_desc *desc) {
    if (sbl_bake_lightmap(context, desc) != SBL_SUCCESS) return 0;
    return add_stats(add_channels(PINS_EMPTY, SIZE, SIZE));
}

static hash directional_lightmap(void) {
    sbl_lightmap_desc desc = room_map(SBL_MODE_GI);
    desc.directional = 1;
    return set_room(0, 1024) ? lightmap(&desc) : 0;
}

static hash grouped_lightmap(void) {
    sbl_lightmap_desc desc = room_map(SBL_MODE_GI);
    desc.grouped = 1;
    desc.supersample = 2;
    desc.facet_limit = 1;
    return lightmap(&desc);
}

/* Bakes two windows of a map and joins them. */
static hash joined_lightmap(void) {
    static float ids[TEXELS], light[3 * TEXELS];
    sbl_lightmap_desc desc = room_map(SBL_MODE_DIRECT);
    sbl_windows_desc joining;
    int i, row;
    for (i = 0; i < 2; i++) {
        const int window[4] = { 0, 17 * i, SIZE, i ? SIZE - 17 : 17 };
        float *values = buffer;
        memcpy(desc.window, window, sizeof window);
        if (sbl_bake_lightmap(context, &desc) != SBL_SUCCESS) return 0;
        if (sbl_read_channel(context, SBL_CHANNEL_RADIANCE, values, 3 * TEXELS) != SBL_SUCCESS) return 0;
        for (row = 0; row < window[3]; row++)
            memcpy(light + 3 * SIZE * (window[1] + row), values + 3 * SIZE * row, sizeof(float) * 3 * SIZE);
        if (sbl_read_channel(context, SBL_CHANNEL_ID, values, TEXELS) != SBL_SUCCESS) return 0;
        for (row = 0; row < window[3]; row++)
            memcpy(ids + SIZE * (window[1] + row), values + SIZE * row, sizeof(float) * SIZE);
    }
    memset(&joining, 0, sizeof joining);
    joining.lightmap = desc;
    joining.ids = ids;
    joining.light[0] = light;
    joining.texel_count = TEXELS;
    if (sbl_join_windows(context, &joining) != SBL_SUCCESS) return 0;
    return pins_add(PINS_EMPTY, light, sizeof light);
}

static hash vertices(int average, int groups, sbl_mode mode) {
    static float parts[GROUPS * 3 * 400];
    sbl_vertices_desc desc;
    memset(&desc, 0, sizeof desc);
    memset(buffer, 0, sizeof buffer);
    desc.radiance = buffer;
    desc.float_count = 3 * 400;
    desc.groups = groups ? parts : NULL;
    desc.group_float_count = groups ? sizeof parts / sizeof *parts : 0;
    desc.average = average;
    desc.options.mode = mode;
    desc.options.preset = SBL_PRESET_DRAFT;
    if (sbl_bake_vertices(context, &desc) != SBL_SUCCESS) return 0;
    return pins_add(pins_add(PINS_EMPTY, buffer, sizeof(float) * 3 * 400), parts, groups ? sizeof parts : 0);
}

static hash fitted_vertices(void) { return vertices(0, 1, SBL_MODE_GI); }
static hash averaged_vertices(void) { return vertices(1, 0, SBL_MODE_DIRECT); }

/* Reads the light at points above the floor, with the options of `desc`. */
static hash readings(sbl_readings_desc desc) {
    sbl_site sites[12];
    sbl_reading out[12];
    int i;
    hash h = PINS_EMPTY;
    memset(sites, 0, sizeof sites);
    for (i = 0; i < 12; i++) {
        sites[i].position[0] = -0.9f + 0.6f * (float)(i % 4);
        sites[i].position[1] = i < 6 ? 0 : 0.7f;
        sites[i].position[2] = -0.7f + 0.6f * (float)(i / 4);
        sites[i].normal[0] = i % 3 ? 0 : 0.5f;
        sites[i].normal[1] = 1;
        sites[i].offset = i % 2 ? 0 : 0.01f;
    }
    desc.sites = sites;
    desc.site_count = 12;
    desc.readings = out;
    if (sbl_gather_readings(context, &desc) != SBL_SUCCESS) return 0;
    for (i = 0; i < 12; i++) h = pins_add(pins_add(h, &out[i], sizeof(float) * 8), &out[i].valid, sizeof out[i].valid);
    return h;
}

static hash traced_readings(void) {
    sbl_readings_desc desc;
    memset(&desc, 0, sizeof desc);
    return readings(desc);
}

static hash short_readings(void) {
    sbl_readings_desc desc;
    memset(&desc, 0, sizeof desc);
    desc.options.mode = SBL_MODE_DIRECT;
    desc.options.ray_length = 0.6f;
    desc.options.rays = 64;
    return readings(desc);
}

static hash rasterised_readings(void) {
    sbl_readings_desc desc;
    memset(&desc, 0, sizeof desc);
    desc.options.mode = SBL_MODE_AMBIENT;
    desc.options.backend = SBL_BACKEND_RASTER;
    desc.options.sensor_size = 12;
    desc.sensor_kind = SBL_SENSOR_SINGLE;
    return readings(desc);
}

static hash probes(void) {
    sbl_probe out[8], parts[8 * GROUPS];
    sbl_probes_desc desc;
    hash h = PINS_EMPTY;
    int i;
    memset(&desc, 0, sizeof desc);
    desc.grid[0] = desc.grid[1] = desc.grid[2] = 2;
    desc.probes = out;
    desc.groups = parts;
    desc.move = 0.4f;
    desc.options.rays = 256;
    if (sbl_bake_probes(context, &desc) != SBL_SUCCESS) return 0;
    for (i = 0; i < 8; i++) h = pins_add(h, &out[i], sizeof out[i]);
    for (i = 0; i < 8 * GROUPS; i++) h = pins_add(h, &parts[i], sizeof parts[i]);
    return h;
}

/* White surfaces have no sensors and show the stored light. */
static hash stored_picture(void) {
    static test_scene s;
    hash h = 0;
    room(&s);
    s.materials[0].flags = SBL_MATERIAL_NO_SENSORS;
    if (sbl_set_materials(context, s.materials, s.material_count) == SBL_SUCCESS) h = picture(view_of(SBL_MODE_GI));
    scene_free(&s);
    return h;
}

static hash glow_picture(void) {
    hash h;
    if (!set_glow_room(0)) return 0;
    h = picture(view_of(SBL_MODE_GI));
    CHECK(inside_glow_count(context) > 0, "no place is bright enough to be a lamp");
    return h;
}

/* The ground has no sensors and shows the stored light of each group. */
static hash stored_lightmap(void) {
    sbl_lightmap_desc desc = room_map(SBL_MODE_GI);
    desc.grouped = 1;
    return set_glow_room(SBL_MATERIAL_NO_SENSORS) ? lightmap(&desc) : 0;
}

/* Cases run in this order; a case without set_room uses the scene of the case before it. */
static const struct { const char *name; hash (*make)(void); } cases[] = {
    { "glossy_picture", glossy_picture },
    { "glossy_window", glossy_window },
    { "glossy_inspection", glossy_inspection },
    { "glossy_store", store },
    { "glossy_rasterised", glossy_rasterised },
    { "matte_picture", matte_picture },
    { "plain_picture", plain_picture },
    { "changed_picture", changed_picture },
    { "directional_lightmap", directional_lightmap },
    { "grouped_lightmap", grouped_lightmap },
    { "joined_lightmap", joined_lightmap },
    { "fitted_vertices", fitted_vertices },
    { "averaged_vertices", averaged_vertices },
    { "traced_readings", traced_readings },
    { "short_readings", short_readings },
    { "rasterised_readings", rasterised_readings },
    { "probes", probes },
    { "store", store },
    { "stored_picture", stored_picture },
    { "glow_picture", glow_picture },
    { "stored_lightmap", stored_lightmap } };

enum { CASES = sizeof cases / sizeof *cases };

static const hash llvmpipe_15[CASES] = {
    0x9213a4cd68901558u,  /* glossy_picture */
    0x01a3019ea3ca647bu,  /* glossy_window */
    0x2501d69c241a6c0bu,  /* glossy_inspection */
    0x18ebfd2df6ed0223u,  /* glossy_store */
    0x465c69667713f88bu,  /* glossy_rasterised */
    0x0682641aa93072fau,  /* matte_picture */
    0x0cb082160fbe86b1u,  /* plain_picture */
    0x0b1cab42a10172d9u,  /* changed_picture */
    0x78322fc0cda8d0dfu,  /* directional_lightmap */
    0x76b1b146d5fc7d8fu,  /* grouped_lightmap */
    0xe2f40a569a1a355bu,  /* joined_lightmap */
    0x80d9b9fab3d0f23eu,  /* fitted_vertices */
    0x51c33c84e090fc41u,  /* averaged_vertices */
    0x42cc13fc53476a20u,  /* traced_readings */
    0x0b97c4d4c1c07936u,  /* short_readings */
    0x2e4e69bf80082469u,  /* rasterised_readings */
    0x951aec1e421300beu,  /* probes */
    0x5dbdebac21f45cefu,  /* store */
    0x3ac5d888280f51acu,  /* stored_picture */
    0xb98df66e54de4ea2u,  /* glow_picture */
    0x0e3fca6628132b74u  /* stored_lightmap */
};
static const pin_set sets[] = { { "llvmpipe (LLVM 15.0.6, 256 bits)", "Mesa 22.3.6", llvmpipe_15 } };

/* The hashes of all results equal those stored for this renderer. */
TEST(bakes_match_their_stored_hashes) {
    static test_scene nothing;
    const hash *known;
    int i;
    REQUIRE(use_scene(&nothing), "no context: %s", watch_last(&seen));
    known = pins_of(context, sets, (int)(sizeof sets / sizeof *sets));
    for (i = 0; i < CASES; i++) {
        const hash found = cases[i].make();
        CHECK(found != 0, "%s failed: %s", cases[i].name, watch_last(&seen));
        pins_compare(known, i, cases[i].name, found);
    }
    if (!known) SKIP("nothing is stored for this renderer");
}

int main(void) {
    RUN(bakes_match_their_stored_hashes);
    sbl_destroy(context);
    return test_report();
}
