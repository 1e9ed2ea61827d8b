/* Tests that pictures do not change unintentionally. A hash of every channel of small pictures in all modes and back
   ends is stored for each renderer. On an unknown renderer the test is skipped, and prints the lines to add to `sets`.
   A commit that changes pictures intentionally updates the hashes, and its message says how much the pictures changed;
   scripts/compare_commits measures this. */
#include "../sbl.h"
#include "support/test.h"
#include "support/scenes.h"
#include "support/pins.h"

static sbl_context *context;

/* Makes a scene with textures of albedo and emission, a cut-out, vertex colours, one-sided emission, hidden surfaces, a
   mirrored mesh and smooth normals; optionally with all kinds of lights and a sky picture. */
static void scene_everything(test_scene *s, int lights, int sky) {
    static const unsigned char checks[] = { 255, 255, 255, 255, 200, 30, 20, 255, 20, 60, 190, 0, 240, 240, 80, 255 };
    static const float glow[] = { 3, 2, 1, 1, 0.5f, 1, 2, 1 };
    static const float colors[] = { 1, 0.2f, 0.2f, 1, 0.2f, 1, 0.2f, 1, 0.2f, 0.2f, 1, 1, 1, 1, 1, 1 };
    static const float mirror[16] = { -1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0.1f, 0, -0.2f, 1 };
    static float picture[16 * 8 * 3];
    int white = scene_material(s, 0.7f, 0.7f, 0.7f), cut = scene_material(s, 0.9f, 0.8f, 0.7f),
        lamp = scene_lamp(s, 6, 5, 4);
    int screen = scene_lamp(s, 1, 1, 1), hidden = scene_material(s, 0.1f, 0.9f, 0.1f),
        ghost = scene_material(s, 0.9f, 0.1f, 0.9f), i;
    s->materials[cut].albedo_texture = scene_texture(s, checks, sizeof checks, SBL_PIXELS_SRGB8, 2, 2, 4);
    s->materials[cut].alpha_cutoff = 0.5f;
    s->materials[lamp].flags = SBL_MATERIAL_ONE_SIDED_EMISSION;
    s->materials[screen].emission_texture = scene_texture(s, glow, sizeof glow, SBL_PIXELS_FLOAT, 2, 1, 4);
    s->materials[hidden].flags = SBL_MATERIAL_HIDDEN_FROM_CAMERA;
    s->materials[ghost].flags = SBL_MATERIAL_HIDDEN_FROM_SENSORS;
    scene_floor(s, white, 0, 3)->colors.data = scene_copy(s, colors, 16);
    scene_quad(s, white, -3, 0, -2, 3, 0, -2, 3, 3, -2, -3, 3, -2);
    scene_quad(s, cut, -1.4f, 0, -0.5f, -0.2f, 0, -0.9f, -0.2f, 1.2f, -0.9f, -1.4f, 1.2f, -0.5f);
    scene_quad(s, lamp, -0.6f, 2.2f, 0, 0.6f, 2.2f, 0, 0.6f, 2.2f, 0.7f, -0.6f, 2.2f, 0.7f);
    scene_quad(s, screen, 1.5f, 0.4f, -1.8f, 2.4f, 0.4f, -1.5f, 2.4f, 1.2f, -1.5f, 1.5f, 1.2f, -1.8f);
    scene_sphere(s, white, 0.9f, 0.5f, 0.3f, 0.5f, 14, 9, 1);
    memcpy(scene_sphere(s, white, 0.9f, 0.35f, 0.9f, 0.35f, 9, 6, 0)->transform, mirror, sizeof mirror);
    scene_box(s, hidden, -2, 0, 1, -1.5f, 0.8f, 1.4f);
    scene_box(s, ghost, 1.6f, 0, 1.2f, 2, 0.5f, 1.6f);
    if (lights) {
        sbl_light *light = scene_light(s, SBL_LIGHT_POINT, 0.6f, 0.3f, 0.1f);
        light->position[0] = -2; light->position[1] = 1.5f; light->radius = 0.2f;
        light = scene_light(s, SBL_LIGHT_POINT, 0.1f, 0.2f, 0.5f);
        light->position[0] = 2; light->position[1] = 1; light->position[2] = 2;
        light = scene_light(s, SBL_LIGHT_SPOT, 1, 1, 0.4f);
        light->position[1] = 2.5f; light->position[2] = 2; light->direction[1] = -2; light->direction[2] =
            -1; light->cone = 50; light->inner_cone = 30;
        light = scene_light(s, SBL_LIGHT_DIRECTIONAL, 0.5f, 0.45f, 0.4f);
        light->direction[0] = 0.5f; light->direction[1] = -1; light->direction[2] = -0.3f; light->angle = 2;
    }
    for (i = 0; i < 16 * 8; i++) {
        picture[3 * i] = 0.2f + 0.1f * (float)(i % 5);
        picture[3 * i + 1] = 0.3f;
        picture[3 * i + 2] = i == 37 ? 90.0f : 0.5f;
    }
    if (sky) {
        s->environment.picture.pixels = picture;
        s->environment.picture.width = 16;
        s->environment.picture.height = 8;
        s->environment.picture.channels = 3;
        s->environment.picture.format = SBL_PIXELS_FLOAT;
        s->environment.rotation = 25;
        s->environment.up[0] = 0.2f; s->environment.up[1] = 1;
    }
    scene_sky(s, 0.02f, 0.03f, 0.04f);
}

/* Makes a scene with so many lamps that they are sampled in clusters. */
static void scene_many_lamps(test_scene *s) {
    int white = scene_material(s, 0.8f, 0.8f, 0.8f), lamp = scene_lamp(s, 4, 3, 2);
    scene_floor(s, white, 0, 3);
    scene_sphere(s, lamp, -0.5f, 1.5f, 0, 0.4f, 24, 12, 0);
    scene_quad(s, white, 0.5f, 0, -1, 0.5f, 0, 1, 0.5f, 1, 1, 0.5f, 1, -1);
}

typedef struct pin_case {
    const char *name;
    int scene;  /* 0: Cornell box; 1: scene_everything; 2: with lights; 3: with lights and sky; 4: many lamps */
    sbl_picture_desc view;
} pin_case;

static sbl_picture_desc view_of(int scene, sbl_mode mode, sbl_backend backend, sbl_preset preset) {
    sbl_picture_desc view = scene ? scene_view(56, 40, 50, 0.5f, 1.6f, 5, 0, 0.9f, 0) : scene_cornell_view(48, 48);
    view.options.mode = mode;
    view.options.backend = backend;
    view.options.preset = preset;
    if (backend == SBL_BACKEND_RASTER) view.options.sensor_size = 16;
    view.samples = 3;
    view.facet_limit = scene == 1 ? 2 : -1;
    view.options.seed = (uint32_t)(scene + 1);
    return view;
}

enum { PINS = 17 };

static void pin_cases(pin_case cases[PINS]) {
    static const struct { const char *name; int scene; sbl_mode mode; sbl_backend backend; sbl_preset preset;
        } list[PINS] = {
        { "cornell_ambient_traced", 0, SBL_MODE_AMBIENT, SBL_BACKEND_TRACE, SBL_PRESET_DEFAULT },
        { "cornell_direct_traced", 0, SBL_MODE_DIRECT, SBL_BACKEND_TRACE, SBL_PRESET_DEFAULT },
        { "cornell_direct_high", 0, SBL_MODE_DIRECT, SBL_BACKEND_TRACE, SBL_PRESET_HIGH },
        { "cornell_ambient_rasterised", 0, SBL_MODE_AMBIENT, SBL_BACKEND_RASTER, SBL_PRESET_DEFAULT },
        { "cornell_paper", 0, SBL_MODE_PAPER, SBL_BACKEND_RASTER, SBL_PRESET_DEFAULT },
        { "everything_ambient_traced", 1, SBL_MODE_AMBIENT, SBL_BACKEND_TRACE, SBL_PRESET_DRAFT },
        { "everything_ambient_rasterised", 1, SBL_MODE_AMBIENT, SBL_BACKEND_RASTER, SBL_PRESET_DRAFT },
        { "everything_paper", 1, SBL_MODE_PAPER, SBL_BACKEND_RASTER, SBL_PRESET_DRAFT },
        { "lights_direct_traced", 2, SBL_MODE_DIRECT, SBL_BACKEND_TRACE, SBL_PRESET_DRAFT },
        { "lights_direct_rasterised", 2, SBL_MODE_DIRECT, SBL_BACKEND_RASTER, SBL_PRESET_DRAFT },
        { "sky_ambient_traced", 3, SBL_MODE_AMBIENT, SBL_BACKEND_TRACE, SBL_PRESET_DRAFT },
        { "sky_ambient_rasterised", 3, SBL_MODE_AMBIENT, SBL_BACKEND_RASTER, SBL_PRESET_DRAFT },
        { "many_lamps_direct_traced", 4, SBL_MODE_DIRECT, SBL_BACKEND_TRACE, SBL_PRESET_DRAFT },
        { "many_lamps_direct_rasterised", 4, SBL_MODE_DIRECT, SBL_BACKEND_RASTER, SBL_PRESET_DRAFT },
        { "cornell_gi_traced", 0, SBL_MODE_GI, SBL_BACKEND_TRACE, SBL_PRESET_DRAFT },
        { "cornell_gi_rasterised", 0, SBL_MODE_GI, SBL_BACKEND_RASTER, SBL_PRESET_DRAFT },
        { "sky_gi_traced", 3, SBL_MODE_GI, SBL_BACKEND_TRACE, SBL_PRESET_DRAFT } };
    int i;
    for (i = 0; i < PINS; i++) {
        cases[i].name = list[i].name;
        cases[i].scene = list[i].scene;
        cases[i].view = view_of(list[i].scene, list[i].mode, list[i].backend, list[i].preset);
    }
    cases[8].view.view_to_clip[0] = 0.4f;  /* this case has an orthographic camera */
    cases[8].view.view_to_clip[5] = 0.5f;
    cases[8].view.view_to_clip[11] = 0;
    cases[8].view.view_to_clip[15] = 1;
}

/* Returns the hash of all channels of the finished picture. */
static uint64_t hash_of(const sbl_picture_desc *view) {
    uint64_t hash = PINS_EMPTY;
    int channel;
    for (channel = 0; channel < SBL_CHANNEL_OVERLAP; channel++) {
        float *values = scene_channel(context, view, (sbl_channel)channel);
        hash = pins_add(hash, values, (size_t)(view->width * view->height *
                                               sbl_channel_components((sbl_channel)channel)) * sizeof(float));
        free(values);
    }
    return hash;
}

/* The comment beside a hash is the name of its case. */
static const uint64_t llvmpipe_15[PINS] = {
    0xee66185dff2bc145u,  /* cornell_ambient_traced */
    0x8b03caca16d192cdu,  /* cornell_direct_traced */
    0x7b13eb650875cf26u,  /* cornell_direct_high */
    0x805f2579068afb51u,  /* cornell_ambient_rasterised */
    0xbee979497c67e34fu,  /* cornell_paper */
    0x9d4eb135104473bau,  /* everything_ambient_traced */
    0x2cf45bc0583dc182u,  /* everything_ambient_rasterised */
    0x634c2a608b962aa3u,  /* everything_paper */
    0x098b39f3969a53f4u,  /* lights_direct_traced */
    0xd1e741d2e5c90df4u,  /* lights_direct_rasterised */
    0xd055ef3d3d0fa4bfu,  /* sky_ambient_traced */
    0xdd0bd9135de5c199u,  /* sky_ambient_rasterised */
    0x78915d4324cfd8a2u,  /* many_lamps_direct_traced */
    0x7692356e654ded7bu,  /* many_lamps_direct_rasterised */
    0x06adf6f5655b5bfbu,  /* cornell_gi_traced */
    0xa257be3a72559cc7u,  /* cornell_gi_rasterised */
    0x36aaca90fbdda8bcu  /* sky_gi_traced */
};
static const pin_set sets[] = { { "llvmpipe (LLVM 15.0.6, 256 bits)", "Mesa 22.3.6", llvmpipe_15 } };

/* The hashes of all pictures equal those stored for this renderer. */
TEST(pictures_match_their_stored_hashes) {
    const uint64_t *known = pins_of(context, sets, (int)(sizeof sets / sizeof *sets));
    const int is_gl3 = sbl_query_capabilities(context).gl_major == 3;
    pin_case cases[PINS];
    int i;
    pin_cases(cases);
    for (i = 0; i < PINS; i++) {
        test_scene s = { 0 };
        uint64_t hash;
        /* traced sensors use nothing beyond GL 3.3, so one traced picture is enough there */
        if (is_gl3 && known && cases[i].view.options.backend == SBL_BACKEND_TRACE &&
            strcmp(cases[i].name, "cornell_gi_traced") != 0) continue;
        if (cases[i].scene == 0) scene_cornell_box(&s);
        else if (cases[i].scene == 4) scene_many_lamps(&s);
        else scene_everything(&s, cases[i].scene > 1, cases[i].scene > 2);
        hash = scene_render(context, &s, &cases[i].view) ? hash_of(&cases[i].view) : 0;
        scene_free(&s);
        /* refinement depends on rounding: GL 3.3 without clip control has another hash for this picture */
        if (is_gl3 && strcmp(cases[i].name, "cornell_gi_rasterised") == 0 && hash == 0x66e2c7912d349c6du) continue;
        pins_compare(known, i, cases[i].name, hash);
    }
    if (!known) SKIP("nothing is stored for this renderer");
}

int main(void) {
    if (sbl_create(NULL, &context) != SBL_SUCCESS) return 1;
    RUN(pictures_match_their_stored_hashes);
    sbl_destroy(context);
    return test_report();
}
