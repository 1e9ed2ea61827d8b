/* The same input gives the same picture to the bit, for any batch size, any slices, repeated calls, any earlier work of
   the context, and whether a mesh is moved or set at its place. Other GL paths, view texture sizes and drawing by the
   host may change only the rounding. */
#include "../sbl.h"
#include "support/test.h"
#include "support/scenes.h"
#include "support/gl_watch.h"
#include "support/gl_host.h"
#include "support/gl_fake.h"

enum { WIDTH = 40, HEIGHT = 30, PIXELS = WIDTH * HEIGHT, FLOATS = 71 * PIXELS };  /* 21 channels of 3 floats, 8 of 1 */
typedef struct picture { float values[FLOATS]; } picture;

static watch seen;
static test_scene cornell;
static picture expected;
static sbl_backend backend;
static sbl_mode mode;

static sbl_picture_desc cornell_view(void) {
    sbl_picture_desc view = scene_cornell_view(WIDTH, HEIGHT);
    view.tile = 8;
    view.options.mode = mode;
    view.options.backend = backend;
    view.options.rays = 24;  /* more rays than one shader invocation traces */
    view.options.sensor_size = 16;
    view.samples = 2;
    view.options.epsilon = 0.1f;
    view.tone = SBL_TONE_NEUTRAL;
    view.auto_exposure = 1;
    return view;
}

static float *channel_of(picture *p, sbl_channel channel) {
    int c, at = 0;
    for (c = 0; c < (int)channel; c++) at += PIXELS * sbl_channel_components((sbl_channel)c);
    return p->values + at;
}

static int read_all(sbl_context *context, picture *out) {
    int channel, i;
    /* fails if there are channels that FLOATS does not count */
    if (channel_of(out, SBL_CHANNEL_COUNT) != out->values + FLOATS) return 0;
    for (i = 0; i < FLOATS; i++) out->values[i] = (float)NAN;
    for (channel = 0; channel < SBL_CHANNEL_COUNT; channel++)
        if (sbl_read_channel(context, (sbl_channel)channel, channel_of(out, (sbl_channel)channel),
            (size_t)(PIXELS * sbl_channel_components((sbl_channel)channel))) != SBL_SUCCESS) return 0;
    return 1;
}

static int render(sbl_context *context, const sbl_picture_desc *view, picture *out) {
    return sbl_render_picture(context, view) == SBL_SUCCESS && read_all(context, out);
}

static int same(const picture *a, const picture *b) { return memcmp(a, b, sizeof *a) == 0; }

/* Differences of R between two pictures of one scene, relative to the mean of a. */
typedef struct distance { double mean, rms, most; int pixels; } distance;

static distance distance_of(picture *a, picture *b) {
    const float *p = channel_of(a, SBL_CHANNEL_RADIANCE), *q = channel_of(b, SBL_CHANNEL_RADIANCE);
    distance d = { 0, 0, 0, 0 };
    double sum = 0;
    int i, k;
    for (i = 0; i < 3 * PIXELS; i++) sum += (double)p[i] / (3 * PIXELS);
    for (i = 0; i < PIXELS; i++) {
        double worst = 0;
        for (k = 0; k < 3; k++) {
            double off = fabs((double)p[3 * i + k] - (double)q[3 * i + k]) / sum;
            d.mean += off / (3 * PIXELS);
            d.rms += off * off / (3 * PIXELS);
            if (!(off <= worst)) worst = off == off ? off : 1e30;
        }
        if (worst > d.most) d.most = worst;
        d.pixels += worst > 1e-5;
    }
    d.rms = sqrt(d.rms);
    return d;
}

static double average(picture *p) {
    const float *r = channel_of(p, SBL_CHANNEL_RADIANCE);
    double sum = 0;
    int i;
    for (i = 0; i < 3 * PIXELS; i++) sum += (double)r[i] / (3 * PIXELS);
    return sum;
}

/* >>bit for bit */

/* The reference is finite, mostly lit, and has sensors of several levels; otherwise the comparisons would prove
   nothing. */
TEST(reference_is_a_picture) {
    int i, lit = 0, levels[8] = { 0 };
    const float *final = channel_of(&expected, SBL_CHANNEL_FINAL),
        *sensors = channel_of(&expected, SBL_CHANNEL_SENSORS);
    for (i = 0; i < FLOATS; i++) if (!(expected.values[i] - expected.values[i] == 0)) break;
    CHECK(i == FLOATS, "float %d is %g", i, (double)expected.values[i % FLOATS]);
    for (i = 0; i < PIXELS; i++) {
        lit += final[3 * i] > 0.01f;
        levels[(int)sensors[i] & 7]++;
    }
    CHECK(lit > PIXELS / 2, "%d of %d pixels are lit", lit, PIXELS);
    CHECK(levels[0] > 0 && levels[1] > 0 && levels[3] > 0, "pixels without sensor, of the first and the third level: "
          "%d, %d, %d",
          levels[0], levels[1], levels[3]);
}

/* Batch sizes do not change the picture. */
TEST(batches) {
    static const int batches[] = { 1, 3, 7, 64, 1000000 };
    static picture now;
    int i;
    for (i = 0; i < (int)(sizeof batches / sizeof *batches); i++) {
        sbl_context_desc desc = watch_desc(&seen);
        sbl_picture_desc view = cornell_view();
        sbl_context *context;
        desc.batch = batches[i];
        context = watch_context(&seen, &desc, &cornell);
        if (!context) return;
        CHECK(render(context, &view, &now), "batches of %d: %s", batches[i], watch_last(&seen));
        CHECK(same(&now, &expected), "batches of %d change the picture", batches[i]);
        sbl_destroy(context);
    }
}

static int counts_calls(float done, void *user) { (void)done; ++*(int *)user; return 0; }

/* The length of slices does not change the picture. */
TEST(slices) {
    static const double budgets[] = { 1e-9, 1e-4, 2e-3, 0 };
    static picture now;
    sbl_context_desc desc = watch_desc(&seen);
    sbl_context *context = watch_context(&seen, &desc, &cornell);
    int i, steps, calls;
    if (!context) return;
    for (i = 0; i <= 4; i++) {
        sbl_picture_desc view = cornell_view();
        sbl_result result;
        calls = 0;
        view.options.progress = i & 1 ? counts_calls : NULL;
        view.options.progress_user = &calls;
        result = sbl_begin_picture(context, &view);
        for (steps = 0; steps < 100000 && (steps ? result == SBL_UNFINISHED : result == SBL_SUCCESS); steps++)
            /* the last run alternates between all budgets */
            result = sbl_step(context, i < 4 ? budgets[i] : budgets[steps % 3]);
        REQUIRE(result == SBL_SUCCESS && read_all(context, &now), "slices %d: \"%s\" after %d steps", i,
                sbl_result_string(result), steps);
        CHECK(i == 3 ? steps == 1 : i > 0 || steps > 10, "slices %d: %d steps", i, steps);
        CHECK(same(&now, &expected), "slices %d in %d steps change the picture", i, steps);
    }
    sbl_destroy(context);
}

/* Earlier pictures, scenes and abandoned work do not change the picture, nor do other allocators. */
TEST(repetitions) {
    static picture now;
    test_scene other = { 0 };
    sbl_context_desc desc = watch_desc(&seen), plain;
    sbl_scene_desc scene = scene_desc(&cornell), other_scene;
    sbl_picture_desc view = cornell_view(), small = cornell_view();
    sbl_context *context = watch_context(&seen, &desc, &cornell);
    int i;
    if (!context) return;
    for (i = 0; i < 3; i++) CHECK(render(context, &view, &now) && same(&now, &expected), "repetition %d differs", i);
    CHECK(sbl_set_scene(context, &scene) == SBL_SUCCESS && render(context, &view, &now) && same(&now, &expected),
          "after setting the scene again the picture differs");
    small.width = 7;
    small.height = 50;
    small.options.sensor_size = 33;
    small.options.backend = SBL_BACKEND_RASTER;
    small.options.mode = SBL_MODE_PAPER;
    CHECK(sbl_render_picture(context, &small) == SBL_SUCCESS, "%s", watch_last(&seen));
    CHECK(render(context, &view, &now) && same(&now, &expected), "after another picture the picture differs");
    scene_sphere(&other, scene_lamp(&other, 1, 2, 3), 0, 0, 0, 2, 12, 8, 1);
    other_scene = scene_desc(&other);
    CHECK(sbl_set_scene(context, &other_scene) == SBL_SUCCESS && sbl_render_picture(context, &small) == SBL_SUCCESS,
          "%s", watch_last(&seen));
    CHECK(sbl_set_scene(context, &scene) == SBL_SUCCESS && render(context, &view, &now) && same(&now, &expected),
          "after another scene the picture differs");
    CHECK(sbl_begin_picture(context, &view) == SBL_SUCCESS && sbl_step(context, 1e-9) == SBL_UNFINISHED, "%s",
          watch_last(&seen));
    CHECK(render(context, &view, &now) && same(&now, &expected), "after an abandoned picture the picture differs");
    sbl_destroy(context);
    /* uses malloc, whose memory is often zero; the memory of the other allocator never is */
    memset(&plain, 0, sizeof plain);
    context = watch_context(&seen, &plain, &cornell);
    CHECK(context && render(context, &view, &now) && same(&now, &expected), "another allocator changes the picture");
    sbl_destroy(context);
    scene_free(&other);
}

/* >>moving meshes */

static const float places[4][16] = {
    { 1, 0, 0, 0,  0, 1, 0, 0,  0, 0, 1, 0,  -20, 0, 35, 1 },
    { 0.8f, 0, -0.6f, 0,  0, 1.25f, 0, 0,  0.6f, 0, 0.8f, 0,  60, 10, -15, 1 },   /* rotated and scaled */
    { -1, 0, 0, 0,  0, 1, 0, 0,  0, 0, 1, 0,  556, 0, 0, 1 },                     /* mirrored */
    { 1, 0, 0, 0,  0, 1, 0, 0,  0, 0, 1, 0,  0, 0, 0, 1 } };

/* A mesh that is moved gives the same picture as a mesh that is set at that place. */
TEST(moving) {
    static picture now, fresh;
    static test_scene moved;
    sbl_context_desc desc = watch_desc(&seen);
    sbl_picture_desc view = cornell_view();
    sbl_context *context = watch_context(&seen, &desc, &cornell), *another;
    float low[2][3], high[2][3];
    int i, mesh;
    if (!context) return;
    for (i = 0; i < 3; i++) {
        moved = cornell;
        for (mesh = 6; mesh < 11; mesh++) {  /* the faces of one block */
            memcpy(moved.meshes[mesh].transform, places[i], sizeof places[i]);
            CHECK(sbl_set_mesh_transform(context, mesh, places[i]) == SBL_SUCCESS, "%s", watch_last(&seen));
        }
        another = watch_context(&seen, &desc, &moved);
        if (!another) return;
        CHECK(render(context, &view, &now) && render(another, &view, &fresh), "%s", watch_last(&seen));
        CHECK(!same(&now, &expected), "place %d: moving a block changes nothing", i);
        CHECK(same(&now, &fresh), "place %d: the moved block differs from one set at that place", i);
        CHECK(scene_bounds(context, low[0], high[0]) && scene_bounds(another, low[1], high[1]) &&
                  memcmp(low[0], low[1], sizeof low[0]) == 0 && memcmp(high[0], high[1], sizeof high[0]) == 0,
              "place %d: the bounds differ", i);
        sbl_destroy(another);
    }
    for (mesh = 10; mesh >= 6; mesh--)
        CHECK(sbl_set_mesh_transform(context, mesh, places[3]) == SBL_SUCCESS, "%s", watch_last(&seen));
    CHECK(render(context, &view, &now) && same(&now, &expected), "moved away and back, the picture differs");
    sbl_destroy(context);
}

/* A mesh is set far away, as hosts do with meshes that they do not need yet, and moved to its place. The light is that
   of a scene in which it has always been there, although the size of the scene has changed. */
TEST(moving_from_afar) {
    static const float afar[2] = { 1e8f, 1e10f };  /* for the second, sbl_set_scene warns */
    sbl_context_desc desc = watch_desc(&seen);
    sbl_site site = { { 0.01f, 0, 0 }, { 0, 1, 0 }, { 0, 0, 0 }, 0 };
    sbl_reading readings[2];
    sbl_readings_desc gather = scene_readings(&site, readings, 1, SBL_MODE_DIRECT);
    test_scene s = { 0 };
    sbl_light *light = scene_light(&s, SBL_LIGHT_POINT, 1, 1, 1);
    int i, fresh;
    scene_floor(&s, scene_material(&s, 0.5f, 0.5f, 0.5f), 0, 2);
    scene_quad(&s, 0, -0.5f, 0.1f, -0.5f, -0.3f, 0.1f, -0.5f, -0.3f, 0.3f, -0.5f, -0.5f, 0.3f, -0.5f);
    light->position[1] = 0.1f;
    light->radius = 0.01f;
    for (i = 0; i < 2; i++) {
        for (fresh = 0; fresh < 2; fresh++) {
            sbl_context *context;
            memcpy(s.meshes[1].transform, places[3], sizeof places[3]);
            s.meshes[1].transform[12] = fresh ? 0 : afar[i];
            context = watch_context(&seen, &desc, &s);
            gather.readings = &readings[fresh];
            REQUIRE(context && sbl_set_mesh_transform(context, 1, places[3]) == SBL_SUCCESS &&
                    sbl_gather_readings(context, &gather) == SBL_SUCCESS, "%s", watch_last(&seen));
            sbl_destroy(context);
        }
        CHECK(!memcmp(&readings[0], &readings[1], sizeof readings[0]), "moved from %g: R is %.9g, expected %.9g",
              (double)afar[i], (double)readings[0].radiance[0], (double)readings[1].radiance[0]);
    }
    scene_free(&s);
}

/* Meshes that are moved far away, one after the other, and back again make the same scene to the bit, with the light
   where it was. */
TEST(meshes_return) {
    sbl_context_desc desc = watch_desc(&seen);
    sbl_site site = { { 0.01f, 0, 0 }, { 0, 1, 0 }, { 0, 0, 0 }, 0 };
    sbl_reading readings[2];
    sbl_readings_desc gather = scene_readings(&site, readings, 1, SBL_MODE_DIRECT);
    uint64_t fingerprints[2];
    test_scene s = { 0 };
    sbl_context *context;
    int way, mesh;
    scene_floor(&s, scene_material(&s, 0.5f, 0.5f, 0.5f), 0, 2);
    scene_quad(&s, 0, -0.5f, 0.1f, -0.5f, -0.3f, 0.1f, -0.5f, -0.3f, 0.3f, -0.5f, -0.5f, 0.3f, -0.5f);
    scene_light(&s, SBL_LIGHT_POINT, 1, 1, 1)->position[1] = 0.1f;
    context = watch_context(&seen, &desc, &s);
    if (!context) return;
    for (way = 0; way < 2; way++) {
        gather.readings = &readings[way];
        fingerprints[way] = sbl_scene_fingerprint(context);
        CHECK(sbl_gather_readings(context, &gather) == SBL_SUCCESS, "%s", watch_last(&seen));
        for (mesh = 0; mesh < 4 && !way; mesh++) {
            const float away = mesh < 2 ? 1e6f : 0;
            const float move[16] = { 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, away, away, away, 1 };
            CHECK(sbl_set_mesh_transform(context, mesh % 2, move) == SBL_SUCCESS, "%s", watch_last(&seen));
        }
    }
    CHECK(!memcmp(&readings[0], &readings[1], sizeof readings[0]), "R is %.9g after the return, and was %.9g",
          (double)readings[1].radiance[0], (double)readings[0].radiance[0]);
    CHECK(fingerprints[0] == fingerprints[1], "the fingerprint differs after the return");
    sbl_destroy(context);
    scene_free(&s);
}

/* >>seeds */

/* The same seed gives the same picture. Another seed changes pixels, but hardly the mean of R. */
TEST(seeds) {
    static picture now, again;
    static const uint32_t values[] = { 1, 0x80000000u };
    sbl_context_desc desc = watch_desc(&seen);
    sbl_picture_desc view = cornell_view();
    sbl_context *context = watch_context(&seen, &desc, &cornell);
    int i, channel;
    if (!context) return;
    for (i = 0; i < 2; i++) {
        distance d;
        view.options.seed = values[i];
        CHECK(render(context, &view, &now) && render(context, &view, &again), "%s", watch_last(&seen));
        CHECK(same(&now, &again), "the same seed %u gives another picture", values[i]);
        d = distance_of(&expected, &now);
        CHECK(d.pixels > PIXELS / 4, "seed %u changes only %d pixels", values[i], d.pixels);
        CHECK(fabs(average(&now) / average(&expected) - 1) < 0.1, "seed %u: the mean of R is %g, with seed 0 %g",
              values[i], average(&now), average(&expected));
        for (channel = SBL_CHANNEL_ALBEDO; channel <= SBL_CHANNEL_DEPTH; channel++)
            CHECK(memcmp(channel_of(&now, (sbl_channel)channel), channel_of(&expected, (sbl_channel)channel),
                  sizeof(float) * (size_t)(PIXELS * sbl_channel_components((sbl_channel)channel))) == 0,
                  "seed %u changes channel %d", values[i], channel);
    }
    sbl_destroy(context);
}

/* >>equal up to rounding; every pixel has a sensor, so that refinement decides nothing */

/* Checks that two pictures are equal up to rounding. A texel shows what its centre sees. If an edge passes the centre
   within float rounding, the texel may show either side; this concerns one of some thousand texels, in few sensors. So
   nearly all pixels are equal to the bit, and no pixel differs by more than the weight of a few texels. Lamps are not
   measured by texels. Bounced light is read from cells, whose edges add more such centres. */
static void rounding(distance d, const char *what) {
    const int cells = mode == SBL_MODE_GI && backend == SBL_BACKEND_RASTER;
    CHECK(d.mean < (cells ? 5e-5 : 1e-5), "%s changes the mean of R by %.2g", what, d.mean);
    CHECK(d.pixels <= PIXELS / (cells ? 10 : 100), "%s changes R at %d of %d pixels", what, d.pixels, PIXELS);
    CHECK(d.most < 0.01, "%s changes R by up to %.2g", what, d.most);
}

static sbl_picture_desc plain_view(void) {
    sbl_picture_desc view = scene_plain(cornell_view(), mode, 16);
    view.options.epsilon = 0.1f;
    return view;
}

static int plain_picture(const sbl_context_desc *desc, picture *out) {
    sbl_context *context = watch_context(&seen, desc, &cornell);
    sbl_picture_desc view = plain_view();
    int done = context && render(context, &view, out);
    CHECK(done, "%s", watch_last(&seen));
    sbl_destroy(context);
    return done;
}

/* Without an optional capability of GL, the picture differs only by rounding. */
TEST(capabilities) {
    static picture all, without;
    sbl_context_desc desc = watch_desc(&seen);
    sbl_context *context;
    uint32_t bit, available;
    if (!plain_picture(&desc, &all)) return;
    context = watch_context(&seen, &desc, &cornell);
    if (!context) return;
    available = sbl_query_capabilities(context).available;
    CHECK(sbl_query_capabilities(context).used == available, "not all available capabilities are used");
    sbl_destroy(context);
    if (!available) SKIP("the driver has no optional capability");
    for (bit = 1; bit <= SBL_CAPABILITY_ALL; bit <<= 1) {
        distance d;
        if (!(available & bit)) continue;
        desc.disabled = bit;
        context = watch_context(&seen, &desc, &cornell);
        CHECK(context && sbl_query_capabilities(context).used == (available & ~bit), "capability 0x%x is still used",
              bit);
        sbl_destroy(context);
        if (!plain_picture(&desc, &without)) return;
        d = distance_of(&all, &without);
        printf("  without capability 0x%x: mean %.2g, rms %.2g, most %.2g, %d pixels\n", bit, d.mean, d.rms, d.most,
               d.pixels);
        rounding(d, "disabling a capability");
        if (bit == SBL_CAPABILITY_COMPUTE && strstr((const char *)gl.GetString(GL_RENDERER), "llvmpipe"))
            CHECK(same(&all, &without), "compute and fragment shaders give different sums");
    }
}

/* The size of the view texture changes only the rounding. */
TEST(atlas_sizes) {
    static const int sizes[] = { 256, 300, 1024, 4096 };
    static picture base, now;
    sbl_context_desc desc = watch_desc(&seen);
    int i;
    if (!plain_picture(&desc, &base)) return;
    for (i = 0; i < 4; i++) {
        distance d;
        desc.sensor_texture_size = sizes[i];
        if (!plain_picture(&desc, &now)) return;
        d = distance_of(&base, &now);
        printf("  view texture of %d: mean %.2g, rms %.2g, most %.2g, %d pixels\n", sizes[i], d.mean, d.rms, d.most,
               d.pixels);
        rounding(d, "another size of the view texture");
    }
}

/* >>scenes beyond the limit of buffer textures, which are read from 2D textures with the same bits */

/* Makes the Cornell box with a ball of many triangles, whose texture cuts holes. */
static void crowd_make(test_scene *s, int slices, int stacks) {
    static const unsigned char texels[16] = { 255, 128, 0, 255, 0, 128, 255, 255, 90, 180, 45, 255, 200, 200, 10, 0 };
    int material;
    sbl_mesh *ball;
    memset(s, 0, sizeof *s);
    scene_cornell_box(s);
    material = scene_material(s, 0.8f, 0.7f, 0.9f);
    s->materials[material].albedo_texture = scene_texture(s, texels, sizeof texels, SBL_PIXELS_SRGB8, 2, 2, 4);
    s->materials[material].alpha_cutoff = 0.5f;
    ball = scene_sphere(s, material, 278, 360, 250, 110, slices, stacks, 1);
    ball->texcoords = ball->normals;
    ball->texcoords.stride = 12;
}

/* Rounds of bounced light share the same textures. A picture creates 148 GL objects, and would create some 30 more if
   every round created its own. */
TEST(rounds_share_gl_objects) {
    static picture now;
    sbl_context_desc desc = watch_desc(&seen);
    sbl_picture_desc view = cornell_view();
    sbl_context *context;
    int made, start = fake.made;
    desc.get_gl_function = fake_proc;
    context = watch_context(&seen, &desc, &cornell);
    REQUIRE(context && render(context, &view, &now), "%s", watch_last(&seen));
    made = fake.made - start;
    CHECK(same(&now, &expected), "the picture differs");
    CHECK(made > 50 && made < 160, "the picture makes %d GL objects", made);
    sbl_destroy(context);
}

/* Scenes above the limit of buffer textures give the same pictures to the bit, also with moved meshes. */
TEST(past_buffer_textures) {
    enum { MOST_TEXELS = 32768 };  /* GL 3.3 guarantees 65536; a smaller limit makes the test faster */
    static picture pictures[2][2], now;
    static test_scene crowd;
    sbl_context_desc desc = watch_desc(&seen);
    sbl_picture_desc view = cornell_view(), usual = view;
    sbl_scene_desc plain = scene_desc(&cornell), scene;
    sbl_context *context;
    int i, mesh;
    crowd_make(&crowd, 80, 80);
    scene = scene_desc(&crowd);
    desc.get_gl_function = fake_proc;
    view.tile = 64;
    view.options.sensor_size = 8;
    view.threshold = 1e9f;  /* few sensors with one view each */
    if (backend == SBL_BACKEND_RASTER) view.sensor_kind = SBL_SENSOR_SINGLE;
    for (i = 0; i < 2; i++) {
        fake.most_texels = i ? MOST_TEXELS : 0;
        fake.texels = 0;
        context = watch_context(&seen, &desc, &crowd);
        REQUIRE(context && render(context, &view, &pictures[i][0]), "%s", watch_last(&seen));
        /* buffers may be 17 texels larger than their content; GL leaves these out */
        CHECK(i ? fake.texels <= MOST_TEXELS + 17 : fake.texels > MOST_TEXELS + 17,
              "a buffer texture of %d texels was made", fake.texels);
        for (mesh = 6; mesh < 11; mesh++)
            CHECK(sbl_set_mesh_transform(context, mesh, places[1]) == SBL_SUCCESS, "%s", watch_last(&seen));
        /* mirrored, so that its corners run in the other direction */
        CHECK(sbl_set_mesh_transform(context, crowd.mesh_count - 1, places[2]) == SBL_SUCCESS, "%s", watch_last(&seen));
        CHECK(render(context, &view, &pictures[i][1]), "%s", watch_last(&seen));
        CHECK(sbl_set_scene(context, &plain) == SBL_SUCCESS && render(context, &usual, &now) && same(&now, &expected),
              "after a scene that exceeds the limit, the picture of a smaller one differs");
        CHECK(!i || (sbl_set_scene(context, &scene) == SBL_SUCCESS && render(context, &view, &now) &&
                     same(&now, &pictures[0][0])), "after setting the scene again, the picture differs");
        sbl_destroy(context);
    }
    CHECK(!same(&pictures[0][0], &pictures[0][1]), "moving meshes changes nothing");
    CHECK(same(&pictures[0][0], &pictures[1][0]), "above the limit the picture differs");
    CHECK(same(&pictures[0][1], &pictures[1][1]), "above the limit, the picture with moved meshes differs");

    fake.texture_size = 2048;  /* narrower than the rows of the 2D textures */
    watch_forget(&seen);
    REQUIRE(sbl_create(&desc, &context) == SBL_SUCCESS, "%s", watch_last(&seen));
    CHECK(sbl_set_scene(context, &scene) == SBL_ERROR_UNSUPPORTED &&
          watch_said(&seen, SBL_LOG_ERROR, SBL_LOG_ITEM_TOO_LARGE, "triangles", "10923", NULL),
          "a scene too large for any texture: %s", watch_last(&seen));
    sbl_destroy(context);
    fake.most_texels = fake.texture_size = 0;
    scene_free(&crowd);
}

/* The table of materials counts, too: it has the most texels in a scene of many small meshes. */
TEST(meshes_past_buffer_textures) {
    enum { MOST_TEXELS = 4096, MESHES = 480 };
    static const float corners[9] = { 0, 0, 0, 1, 0, 0, 0, 1, 0 };
    static sbl_mesh meshes[MESHES];
    static sbl_material material;
    sbl_context_desc desc = watch_desc(&seen);
    sbl_scene_desc scene = { 0 };
    sbl_context *context;
    int i;
    for (i = 0; i < MESHES; i++) {
        meshes[i].positions.data = corners;
        meshes[i].vertex_count = 3;
    }
    scene.meshes = meshes;
    scene.mesh_count = MESHES;
    scene.materials = &material;
    scene.material_count = 1;
    desc.get_gl_function = fake_proc;
    fake.most_texels = MOST_TEXELS;
    REQUIRE(sbl_create(&desc, &context) == SBL_SUCCESS, "%s", watch_last(&seen));
    fake.texels = 0;
    CHECK(sbl_set_scene(context, &scene) == SBL_SUCCESS, "%s", watch_last(&seen));
    CHECK(fake.texels <= MOST_TEXELS + 17, "a buffer texture of %d texels was made", fake.texels);
    sbl_destroy(context);
    fake.most_texels = 0;
    watch_forget(&seen);
}

/* >>the draw callback; the host draws the meshes from first to last - 1 of the Cornell box as sbl_draw_view requires */

typedef struct host_geometry {
    GLuint array, buffer, programs[2][2];
    int corners, calls[2];
    float epsilon[2];
} host_geometry;
typedef struct host_corner { float position[3], normal[3], albedo[3], emission[3], id; } host_corner;

static const char host_vertex[] =
    "layout(location = 0) in vec3 corner;\n"
    "layout(location = 1) in vec3 face_normal;\n"
    "layout(location = 2) in vec3 face_albedo;\n"
    "layout(location = 3) in vec3 face_emission;\n"
    "layout(location = 4) in float face_id;\n"
    "uniform mat4 world_to_clip;\n"
    "out vec3 position;\n"
    "flat out vec3 on_plane, normal, albedo, emission;\n"
    "flat out float id;\n"
    "void main() {\n"
    "    position = on_plane = corner;\n"
    "    normal = face_normal;\n"
    "    albedo = face_albedo;\n"
    "    emission = face_emission;\n"
    "    id = face_id;\n"
    "    gl_Position = world_to_clip * vec4(corner, 1.0);\n"
    "}\n";
static const char host_sensor[] =
    "flat in vec3 albedo, emission;\n"
    "uniform float radiance_scale, epsilon, depth_scale;\n"
    "layout(location = 0) out vec4 result;\n"
    "void main() {\n"
    "    bool shines = emission.r + emission.g + emission.b > 0.0;\n"
    "    result = vec4(radiance_scale * (shines ? emission : epsilon * albedo), gl_FrontFacing ? 1.0 / gl_FragCoord.w "
        ": -1.0 / gl_FragCoord.w);\n"
    "#ifdef WRITE_DEPTH\n"
    "    gl_FragDepth = gl_FragCoord.w * depth_scale;\n"
    "#endif\n"
    "}\n";
static const char host_camera[] =
    "in vec3 position;\n"
    "flat in vec3 on_plane, normal, albedo, emission;\n"
    "flat in float id;\n"
    "uniform vec3 eye;\n"
    "uniform float depth_scale;\n"
    "layout(location = 0) out vec4 out_position;\n"
    "layout(location = 1) out vec4 out_normal;\n"
    "layout(location = 2) out vec4 out_geometric_normal;\n"
    "layout(location = 3) out vec4 out_albedo;\n"
    "layout(location = 4) out vec4 out_emission;\n"
    "layout(location = 5) out uint out_id;\n"
    "void main() {\n"
    "    vec3 ray = position - eye;\n"   /* moves the interpolated position along the ray back into its plane */
    "    vec3 p = eye + ray * (dot(on_plane - eye, normal) / dot(ray, normal));\n"
    "    vec3 n = dot(normal, ray) > 0.0 ? -normal : normal;\n"
    "    out_position = vec4(p, 0);\n"
    "    out_normal = out_geometric_normal = vec4(n, 0);\n"
    "    out_albedo = vec4(albedo, 1);\n"
    "    out_emission = vec4(emission, 0);\n"
    "    out_id = uint(id + 0.5);\n"
    "#ifdef WRITE_DEPTH\n"
    "    gl_FragDepth = gl_FragCoord.w * depth_scale;\n"
    "#endif\n"
    "}\n";

static void host_geometry_make(host_geometry *h, const test_scene *s, int first, int last) {
    static host_corner corners[16 * 6];
    int mesh, i, k;
    memset(h, 0, sizeof *h);
    for (mesh = first; mesh < last; mesh++) {
        const sbl_mesh *m = &s->meshes[mesh];
        const uint32_t *indices = (const uint32_t *)m->indices.data;
        const float *p = (const float *)m->positions.data;
        for (i = 0; i < m->index_count; i++) {
            host_corner *c = &corners[h->corners++];
            const float *a = p + 3 * indices[i / 3 * 3], *b = p + 3 * indices[i / 3 * 3 + 1],
                *d = p + 3 * indices[i / 3 * 3 + 2];
            double e[3], g[3], n[3], length = 0;
            for (k = 0; k < 3; k++) { e[k] = (double)b[k] - (double)a[k]; g[k] = (double)d[k] - (double)a[k]; }
            n[0] = e[1] * g[2] - e[2] * g[1]; n[1] = e[2] * g[0] - e[0] * g[2]; n[2] = e[0] * g[1] - e[1] * g[0];
            for (k = 0; k < 3; k++) length += n[k] * n[k];
            for (k = 0; k < 3; k++) {
                c->position[k] = p[3 * indices[i] + (uint32_t)k];
                c->normal[k] = (float)(n[k] / sqrt(length));
                c->albedo[k] = s->materials[m->material].albedo[k];
                c->emission[k] = s->materials[m->material].emission[k];
            }
            c->id = (float)(mesh + 1);
        }
    }
    for (i = 0; i < 2; i++) {
        h->programs[i][0] = host_gl_program("test", "", host_vertex, i == SBL_VIEW_SENSOR ? host_sensor : host_camera);
        h->programs[i][1] = host_gl_program("test", "#define WRITE_DEPTH\n", host_vertex, i ==
                                            SBL_VIEW_SENSOR ? host_sensor : host_camera);
    }
    gl.GenVertexArrays(1, &h->array);
    gl.GenBuffers(1, &h->buffer);
    gl.BindVertexArray(h->array);
    gl.BindBuffer(GL_ARRAY_BUFFER, h->buffer);
    gl.BufferData(GL_ARRAY_BUFFER, (GLsizeiptr)(sizeof *corners * (size_t)h->corners), corners, GL_STATIC_DRAW);
    for (i = 0; i < 5; i++) {
        gl.VertexAttribPointer((GLuint)i, i < 4 ? 3 : 1, GL_FLOAT, GL_FALSE, (GLsizei)sizeof *corners,
                               (const void *)(12 * (size_t)i));
        gl.EnableVertexAttribArray((GLuint)i);
    }
    gl.BindVertexArray(0);
}

static void host_geometry_free(host_geometry *h) {
    int i;
    for (i = 0; i < 4; i++) gl.DeleteProgram(h->programs[i / 2][i % 2]);
    gl.DeleteVertexArrays(1, &h->array);
    gl.DeleteBuffers(1, &h->buffer);
}

static void host_geometry_draw(const sbl_draw_view *view, void *user) {
    host_geometry *h = (host_geometry *)user;
    GLuint program = h->programs[view->kind][view->write_depth];
    h->calls[view->kind]++;
    h->epsilon[view->kind] = view->epsilon;
    gl.UseProgram(program);
    gl.UniformMatrix4fv(host_gl_uniform(program, "world_to_clip"), 1, GL_FALSE, view->world_to_clip);
    gl.Uniform3fv(host_gl_uniform(program, "eye"), 1, view->eye);
    gl.Uniform1f(host_gl_uniform(program, "radiance_scale"), view->radiance_scale);
    gl.Uniform1f(host_gl_uniform(program, "epsilon"), view->epsilon);
    gl.Uniform1f(host_gl_uniform(program, "depth_scale"), view->depth_scale);
    gl.BindVertexArray(h->array);
    gl.DrawArrays(GL_TRIANGLES, 0, h->corners);
}

/* Compares drawing by the host with meshes. first: index of the first mesh that the host draws; it also draws all later
   ones. disabled: see sbl_context_desc. lit: 0: the room has a sky and no lamp, so all light comes from texels and
   must be equal up to rounding; 1: rays to the lamp hit meshes exactly, but geometry of the host only in texels */
static void drawn_by_host(int first, uint32_t disabled, int lit) {
    static picture meshes, drawn;
    static test_scene room, rest;
    host_geometry h, nothing;
    sbl_context_desc desc = watch_desc(&seen);
    sbl_picture_desc view = plain_view();
    sbl_scene_desc scene;
    sbl_context *context;
    distance d;
    int i, k, ids = 0;
    const float *a, *b;
    double off = 0;
    desc.get_gl_function = gl_host_proc;
    desc.disabled = disabled;
    room = cornell;
    for (i = 0; i < 3 && !lit; i++) {
        room.sky[i] = 1;
        for (k = 0; k < room.material_count; k++) room.materials[k].emission[i] = 0;
    }
    context = watch_context(&seen, &desc, &room);
    REQUIRE(context && render(context, &view, &meshes), "%s", watch_last(&seen));
    rest = room;
    rest.mesh_count = first;
    host_geometry_make(&h, &room, first, room.mesh_count);
    scene = scene_desc(&rest);
    nothing = h;
    nothing.corners = 0;
    scene.draw = host_geometry_draw;
    scene.draw_user = &h;
    REQUIRE(scene_bounds(context, scene.draw_bounds[0], scene.draw_bounds[1]), "no bounds");
    scene.draw_max_radiance = 17;
    REQUIRE(sbl_set_scene(context, &scene) == SBL_SUCCESS && render(context, &view, &drawn), "%s", watch_last(&seen));
    CHECK(h.calls[SBL_VIEW_CAMERA] >= 1 && h.calls[SBL_VIEW_SENSOR] > 1000, "the callback was called %d and %d times",
          h.calls[0], h.calls[1]);
    CHECK(fabs((double)h.epsilon[SBL_VIEW_CAMERA] - (double)h.epsilon[SBL_VIEW_SENSOR]) < 1e-9,
          "the ambient factor is %g for the camera, %g for sensors", (double)h.epsilon[0], (double)h.epsilon[1]);
    for (i = 0, a = channel_of(&meshes, SBL_CHANNEL_ID), b = channel_of(&drawn, SBL_CHANNEL_ID); i < PIXELS; i++)
        ids += a[i] != b[i];
    for (i = 0, a = channel_of(&meshes, SBL_CHANNEL_POSITION),
         b = channel_of(&drawn, SBL_CHANNEL_POSITION); i < PIXELS; i++)
        for (k = 0; k < 3; k++)
            if (channel_of(&meshes, SBL_CHANNEL_ID)[i] == channel_of(&drawn, SBL_CHANNEL_ID)[i] &&
                fabs((double)a[3 * i + k] - (double)b[3 * i + k]) > off) off =
                    fabs((double)a[3 * i + k] - (double)b[3 * i + k]);
    d = distance_of(&meshes, &drawn);
    printf("  from mesh %d on drawn by the host: %d ids differ, positions by %.2g; R: mean %.2g, rms %.2g, most %.2g, "
           "%d pixels\n", first, ids, off,
        d.mean, d.rms, d.most, d.pixels);
    CHECK(ids <= PIXELS / 200, "%d ids differ", ids);
    /* the position of the eye alone has a rounding error of 1e-7 of the size of the scene */
    CHECK(off < 1e-5 * 1500, "positions differ by %g, in a scene of size 1500", off);
    if (!lit) rounding(d, "drawing by the host");
    else CHECK(fabs(average(&drawn) / average(&meshes) - 1) < 0.02 && d.rms < (first ? 0.06 : 0.35),
               "drawing by the host changes the mean of R from %g to %g, by %g rms", average(&meshes),
               average(&drawn), d.rms);
    sbl_end(context);
    scene.draw_user = &nothing;  /* without the geometry of the callback, the picture must differ */
    REQUIRE(sbl_set_scene(context, &scene) == SBL_SUCCESS && render(context, &view, &drawn), "%s", watch_last(&seen));
    CHECK(distance_of(&meshes, &drawn).pixels > PIXELS / 10, "the picture is the same without the host's geometry");
    sbl_destroy(context);
    host_geometry_free(&h);
}

/* Geometry that the host draws gives the same picture as meshes: up to rounding under a sky, and approximately with a
   lamp (see drawn_by_host). */
TEST(draw_callback) {
    int lit;
    for (lit = 0; lit < 2; lit++) {
        drawn_by_host(6, 0, lit);  /* the blocks */
        drawn_by_host(2, 0, lit);  /* everything except the floor and the lamp */
        drawn_by_host(0, 0, lit);  /* everything; a lamp that the host draws is measured only by texels */
    }
}

/* The same holds if the shaders of the host write depth, without clip control. */
TEST(draw_callback_writing_depth) { drawn_by_host(6, SBL_CAPABILITY_ALL, 0); }

/* After all tests the counting allocator holds no blocks. */
TEST(nothing_leaked) {
    CHECK(seen.blocks == 0 && seen.strangers == 0, "%d blocks, %.0f bytes leaked", seen.blocks, (double)seen.bytes);
}

static int reference(sbl_mode how, sbl_backend which) {
    sbl_context_desc desc = watch_desc(&seen);
    sbl_picture_desc view;
    sbl_context *context;
    int good;
    mode = how;
    backend = which;
    view = cornell_view();
    context = watch_context(&seen, &desc, &cornell);
    good = context && render(context, &view, &expected) && sbl_query_stats(context).backend == which;
    sbl_destroy(context);
    if (!good) printf("the reference picture failed: %s\n", watch_last(&seen));
    return good;
}

int main(void) {
    int i;
    scene_cornell_box(&cornell);
    if (!gl_host_open()) { printf("no GL context\n"); return 1; }
    if (!reference(SBL_MODE_AMBIENT, SBL_BACKEND_RASTER)) return 1;
    RUN(reference_is_a_picture);
    RUN(batches);
    RUN(slices);
    RUN(repetitions);
    RUN(moving);
    RUN(seeds);
    RUN(meshes_past_buffer_textures);
    RUN(draw_callback);
    RUN(draw_callback_writing_depth);
    printf("traced:\n");
    if (!reference(SBL_MODE_AMBIENT, SBL_BACKEND_TRACE)) return 1;
    RUN(reference_is_a_picture);
    RUN(batches);
    RUN(slices);
    RUN(repetitions);
    RUN(moving);
    RUN(seeds);
    for (i = 0; i < 2; i++) {  /* the programs of bounced light contain those above */
        printf("with bounced light, %s:\n", i ? "traced" : "rasterised");
        if (!reference(SBL_MODE_GI, i ? SBL_BACKEND_TRACE : SBL_BACKEND_RASTER)) return 1;
        RUN(reference_is_a_picture);
        RUN(batches);
        RUN(slices);
        RUN(capabilities);
        RUN(rounds_share_gl_objects);
        RUN(moving);
        if (i) RUN(repetitions);
        else RUN(atlas_sizes);
        if (!i) RUN(past_buffer_textures);
    }
    RUN(moving_from_afar);
    RUN(meshes_return);
    RUN(nothing_leaked);
    scene_free(&cornell);
    return test_report();
}
