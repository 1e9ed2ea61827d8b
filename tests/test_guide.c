/* Tests guides, which direct the rays of sensors when light comes through a hole: their densities, single rays compared
   with the hole, and the pictures. */
#include "support/private.h"
#include "support/test.h"
#include "support/scenes.h"
#include "support/reference.h"
#include "support/gl_watch.h"

enum { WIDTH = 96, HEIGHT = 72, PIXELS = WIDTH * HEIGHT };

static watch seen;
static test_scene dark_room;

/* A closed room under a sky of 1, with a hole in its ceiling for x and z from -0.3 to 0.3. */
static const float hole = 0.3f, lid = 1.5f;

static void dark_room_make(test_scene *s) {
    static const float lids[4][4] = { { -3, -1, 3, -0.3f }, { -3, 0.3f, 3, 3 }, { -3, -0.3f, -0.3f, 0.3f },
        { 0.3f, -0.3f, 3, 0.3f } };
    static const float walls[4][4] = { { -3, -1, 3, -1 }, { -3, 3, 3, 3 }, { -3, -1, -3, 3 }, { 3, -1, 3, 3 } };
    const int grey = scene_material(s, 0.5f, 0.5f, 0.5f);
    int i;
    scene_floor(s, grey, 0, 3);
    for (i = 0; i < 4; i++) {
        const float *l = lids[i], *w = walls[i];
        const float ceiling[12] = { l[0], lid, l[1], l[2], lid, l[1], l[2], lid, l[3], l[0], lid, l[3] };
        const float wall[12] = { w[0], 0, w[1], w[2], 0, w[3], w[2], lid, w[3], w[0], lid, w[1] };
        scene_polygon(s, grey, ceiling, 4);
        scene_polygon(s, grey, wall, 4);
    }
    scene_sky(s, 1, 1, 1);
}

static sbl_picture_desc view_of(void) {
    sbl_picture_desc view = scene_view(WIDTH, HEIGHT, 70, 0.3f, 1.1f, 2.2f, 0, 0.2f, -0.5f);
    view.options.mode = SBL_MODE_DIRECT;
    view.target_error = 0.04f;
    return view;
}

/* >>densities */

/* Returns the start of interval i of `count`, 0 to SBL__GUIDE_STEPS; for i = count, the end of the last interval. */
static double interval_begin(const uint32_t *words, int i, int count) {
    return i < count ? (double)(words[i / 2] >> (i & 1 ? 16 : 0) & 0xffffu) : SBL__GUIDE_STEPS;
}

/* Replaces u, a uniform random point in the unit square, by a point with the guide's distribution, as sbl_guide in
   guide.glsl does. Returns the weight of the ray that this point stands for. words: points to the guide's first word */
static double guide_warp(const uint32_t *words, double u[2]) {
    static const int counts[2] = { SBL__GUIDE_BANDS, SBL__GUIDE_SECTORS };
    double weight = 1;
    int axis;
    for (axis = 0; axis < 2; axis++) {
        const double x = u[axis] * SBL__GUIDE_STEPS;
        const int count = counts[axis];
        double begin, width;
        int i = 0;
        while (i + 1 < count && interval_begin(words, i + 1, count) <= x) i++;
        begin = interval_begin(words, i, count);
        width = interval_begin(words, i + 1, count) - begin;
        u[axis] = (i + (x - begin) / width) / count;
        weight *= SBL__GUIDE_STEPS / (width * count);
        words += (SBL__GUIDE_BANDS + i * SBL__GUIDE_SECTORS) / 2;
    }
    return weight;
}

/* The weights of the rays of a guide have the mean 1, none exceeds the limit, and rays go where the scouts found
   light. */
TEST(guides_are_densities) {
    static float found[SBL__GUIDE_BINS];
    static uint32_t words[SBL__GUIDE_WORDS];
    const int bright = 5 * SBL__GUIDE_SECTORS + 7;
    int kind, i, count = 0;
    for (kind = 0; kind < 3; kind++) {
        double all = 0, weights = 0, in_bright = 0;
        memset(found, 0, sizeof found);
        if (kind == 1) found[bright] = 4;
        if (kind == 2) for (i = 0; i < SBL__GUIDE_BINS; i++) found[i] = (float)(i * 7919 % 101);
        sbl__guide_make(found, words);
        for (i = 0, count = 0; i < 512 * 512; i++, count++) {
            double u[2] = { (i % 512 + 0.5) / 512, (i / 512 + 0.5) / 512 };
            const double weight = guide_warp(words, u);
            const int bin = sbl__guide_bin(u[0], u[1]);
            if (!(u[0] >= 0 && u[0] <= 1 && u[1] >= 0 && u[1] <= 1)) break;
            if (weight > 1.01 / (SBL__GUIDE_UNIFORM * SBL__GUIDE_UNIFORM)) break;
            all += weight;
            weights += weight * u[0];  /* the weighted mean of any function stays the same, here of u itself */
            in_bright += bin == bright;
        }
        REQUIRE(count == 512 * 512, "guide %d: point %d is outside of the range, or its weight too large", kind, i);
        CHECK(fabs(all / count - 1) < 0.01, "guide %d: the mean of the weights is %g", kind, all / count);
        CHECK(fabs(weights / all - 0.5) < 0.01, "guide %d: the mean of u is %g", kind, weights / all);
        if (kind == 0)
            CHECK(fabs(in_bright / count * SBL__GUIDE_BINS - 1) < 0.2, "a uniform guide sends %g of the rays to a bin",
                  in_bright / count);
        if (kind == 1)
            CHECK(in_bright / count > 0.08, "%g of the rays go to the bin that has all light", in_bright / count);
    }
}

/* The density is the root of the light that scouts found, smoothed with weights of 0.2, 0.6 and 0.2 along both axes.
   The last sector is a neighbour of the first. */
TEST(densities_follow_roots) {
    enum { SIDE = 1024, RING = 5 };
    static const int bins[5][2] = { { 0, 0 }, { -1, 0 }, { 1, 0 }, { 0, 1 }, { 0, SBL__GUIDE_SECTORS - 1 } };
    static float found[SBL__GUIDE_BINS];
    static uint32_t words[SBL__GUIDE_WORDS];
    static int counts[SBL__GUIDE_BINS];
    const double roots[2] = { sqrt(0.6), sqrt(0.2) }, all = roots[0] + 2 * roots[1];
    int i;
    found[RING * SBL__GUIDE_SECTORS] = 9;
    sbl__guide_make(found, words);
    for (i = 0; i < SIDE * SIDE; i++) {
        double u[2] = { (i % SIDE + 0.5) / SIDE, (i / SIDE + 0.5) / SIDE };
        guide_warp(words, u);
        counts[sbl__guide_bin(u[0], u[1])]++;
    }
    for (i = 0; i < 5; i++) {
        const double even = SBL__GUIDE_UNIFORM, beside = 1 - even;
        const double ring = even / SBL__GUIDE_BANDS + beside * roots[bins[i][0] != 0] / all;
        const double sector = even / SBL__GUIDE_SECTORS + beside * roots[bins[i][1] != 0] / all;
        const double share = (double)counts[(RING + bins[i][0]) * SBL__GUIDE_SECTORS + bins[i][1]] / (SIDE * SIDE);
        CHECK(fabs(share / (ring * sector) - 1) < 0.02, "ring %d, sector %d: %g of the rays, expected %g",
              RING + bins[i][0], bins[i][1], share, ring * sector);
    }
}

/* >>rays: inspected rays compared with the hole */

static double hit_height(const sbl_sensor *s, const sbl_sensor_ray *ray, double at[2]) {
    const double t = ((double)lid - s->position[1]) / ray->direction[1];
    at[0] = s->position[0] + t * ray->direction[0];
    at[1] = s->position[2] + t * ray->direction[2];
    return t;
}

/* Inspected rays report the right direction and radiance. Most of them pass through the hole, and their weighted sum is
   R of the sensor. */
TEST(rays_go_through_the_hole) {
    static float radiance[4 * 4096], weights[4096];
    sbl_context_desc desc = watch_desc(&seen);
    sbl_context *context = watch_context(&seen, &desc, &dark_room);
    sbl_picture_desc view = view_of();
    int x, y, i, sensors = 0, wrong = 0, rays = 0, through = 0;
    double even = 0, guided = 0, worst = 0;
    if (!context) return;
    REQUIRE(sbl_render_picture(context, &view) == SBL_SUCCESS, "no picture: %s", watch_last(&seen));
    REQUIRE(context->picture.map.spec.guided, "there are no guides");
    for (y = 0; y < HEIGHT; y += 4)
        for (x = 0; x < WIDTH; x += 4) {
            double sum = 0, all = 0, ways = 0;
            sbl_sensor s;
            watch_forget(&seen);
            if (sbl_inspect_sensor(context, x, y, &s, radiance, weights, 4096) != SBL_SUCCESS || s.position[1] > 1.4f)
                continue;
            for (i = 0; i < s.ray_count; i++) {
                const sbl_sensor_ray *ray = &s.rays[i];
                double at[2], off;
                const double t = hit_height(&s, ray, at);
                const int open = t > 0 && fabs(at[0]) < (double)hole && fabs(at[1]) < (double)hole;
                off = fabs(fmax(fabs(at[0]), fabs(at[1])) - (double)hole);
                wrong += off > 1e-3 && (ray->radiance[0] > 0.5f) != open;
                if (ray->radiance[0] > 0.5f) worst = fmax(worst, fabs((double)ray->radiance[0] - 1));
                ways += open;
                sum += (double)(radiance[4 * i] * weights[i]);
                all += (double)weights[i];
            }
            sensors++;
            rays += s.ray_count;
            through += (int)ways;
            even += s.radiance[0];
            guided += ways / s.ray_count;
            CHECK(fabs(sum - s.from_surroundings[0]) < 1e-4 * s.radiance[0] + 1e-6,
                  "%d %d: the sheet gives %g, the sensor %g", x, y, sum,
                  (double)s.from_surroundings[0]);
            CHECK(fabs(all - s.weight_sum) < 1e-3, "%d %d: the sum of the weights is %g, weight_sum is %g", x, y, all,
                  (double)s.weight_sum);
        }
    printf("  %d sensors: without guides %.1f %% of the rays would pass through the hole, with them %.1f %% do\n",
           sensors, 100 * even / sensors,
           100 * guided / sensors);
    CHECK(sensors > 100 && wrong == 0 && worst < 1e-3, "%d sensors, %d of %d rays have the wrong radiance; others are "
          "off by up to %g",
          sensors, wrong, rays, worst);
    CHECK(guided > 8 * even, "%g of the rays pass through the hole, without guides %g would", guided / sensors,
          even / sensors);
    sbl_destroy(context);
}

/* >>pictures */

static int render(sbl_context *context, const sbl_picture_desc *view, float *out) {
    return context && sbl_render_picture(context, view) == SBL_SUCCESS && context->picture.map.spec.guided &&
           sbl_read_channel(context, SBL_CHANNEL_RADIANCE, out, 3 * (size_t)(view->width * view->height)) ==
               SBL_SUCCESS;
}

/* Batches, slices, fragment shaders and earlier pictures do not change the picture, to the bit. The looks before the
   guides were made count neither as looks nor as work of their sensors. */
TEST(the_picture_is_the_same) {
    static const int batches[] = { 1, 7, 100000 };
    static float expected[3 * PIXELS / 4], now[3 * PIXELS / 4], looks[PIXELS / 4], work[PIXELS / 4];
    sbl_context_desc desc = watch_desc(&seen);
    sbl_picture_desc view = view_of();
    sbl_context *context = watch_context(&seen, &desc, &dark_room);
    sbl_result result;
    int i, steps = 0, scouting = 0, guiding = 0;
    view.width /= 2;
    view.height /= 2;
    view.target_error = 0.08f;
    REQUIRE(render(context, &view, expected) && render(context, &view, now), "no picture: %s", watch_last(&seen));
    CHECK(memcmp(now, expected, sizeof now) == 0, "a second picture differs");
    CHECK(sbl_read_channel(context, SBL_CHANNEL_LOOKS, looks, PIXELS / 4) == SBL_SUCCESS &&
          sbl_read_channel(context, SBL_CHANNEL_WORK, work, PIXELS / 4) == SBL_SUCCESS &&
          memcmp(looks, work, sizeof looks) == 0, "the work is not the number of looks");
    REQUIRE(sbl_begin_picture(context, &view) == SBL_SUCCESS, "cannot begin");
    while ((result = sbl_step(context, 1e-9)) == SBL_UNFINISHED && steps++ < 1000000) {
        scouting += context->picture.map.refine.stages.stage == SBL__REFINE_SENSE_SCOUTS;
        guiding += context->picture.map.refine.stages.stage == SBL__REFINE_GUIDES;
    }
    CHECK(result == SBL_SUCCESS && sbl_read_channel(context, SBL_CHANNEL_RADIANCE, now, 3 * PIXELS / 4) == SBL_SUCCESS,
          "no picture with steps");
    CHECK(memcmp(now, expected, sizeof now) == 0, "steps change the picture");
    CHECK(scouting > 20 && guiding > 1, "%d steps for scouts, %d for guides", scouting, guiding);
    sbl_destroy(context);
    for (i = 0; i < 4; i++) {
        desc.batch = i < 3 ? batches[i] : 0;
        desc.disabled = i == 3 ? (uint32_t)SBL_CAPABILITY_COMPUTE : 0;
        context = watch_context(&seen, &desc, &dark_room);
        REQUIRE(render(context, &view, now), "no picture: %s", watch_last(&seen));
        CHECK(memcmp(now, expected, sizeof now) == 0,
              i < 3 ? "batches of %d change the picture" : "fragment shaders do", desc.batch);
        sbl_destroy(context);
    }
}

/* Compute shaders on llvmpipe share the rays that continue from metal, gloss and hits of short rays; fragment
   shaders do not. R, the light in lobes, and the number of steps of all rays have the same bits. */
TEST(shared_rays_find_the_same_light) {
    enum { SIDE = 16, FLOATS = SIDE * SIDE * 3 };
    static const sbl_channel channels[3] = { SBL_CHANNEL_RADIANCE, SBL_CHANNEL_SPECULAR, SBL_CHANNEL_WORK };
    static float shared[3][FLOATS], alone[3][FLOATS];
    sbl_context_desc desc = watch_desc(&seen);
    sbl_picture_desc view = scene_view(SIDE, SIDE, 60, 0.3f, 1.1f, 2.6f, 0, 0.4f, 0);
    test_scene room = { 0 };
    int i, k, metal;
    dark_room_make(&room);
    room.materials[0].ior = 1.5f;
    room.materials[0].roughness = 0.3f;
    metal = scene_material(&room, 0.9f, 0.8f, 0.5f);
    room.materials[metal].metallic = 1;
    room.materials[metal].roughness = 0.2f;
    scene_sphere(&room, metal, -0.4f, 0.5f, 0.2f, 0.5f, 24, 12, 1);
    scene_quad(&room, scene_lamp(&room, 2, 2, 2), 0.6f, 0.9f, -0.2f, 0.6f, 0.9f, 0.2f, 0.8f, 0.7f, 0.2f, 0.8f, 0.7f,
               -0.2f);
    scene_sky(&room, 20, 20, 20);
    view.options.mode = SBL_MODE_GI;
    view.options.preset = SBL_PRESET_DRAFT;
    view.target_error = 0.06f;
    view.measure_work = view.samples = 1;
    for (i = 0; i < 2; i++) {
        sbl_context *context;
        desc.disabled = i ? (uint32_t)SBL_CAPABILITY_COMPUTE : 0;
        context = watch_context(&seen, &desc, &room);
        REQUIRE(context && sbl_render_picture(context, &view) == SBL_SUCCESS, "no picture: %s", watch_last(&seen));
        if (!strstr(sbl_query_capabilities(context).renderer, "llvmpipe")) SKIP("the driver is not llvmpipe");
        CHECK(context->picture.map.spec.guided, "rays are not guided");
        for (k = 0; k < 3; k++)
            REQUIRE(sbl_read_channel(context, channels[k], i ? alone[k] : shared[k], k < 2 ? FLOATS : FLOATS / 3) ==
                    SBL_SUCCESS, "no channel");
        sbl_destroy(context);
    }
    for (k = 0; k < 3; k++)
        CHECK(memcmp(shared[k], alone[k], sizeof alone[k]) == 0, "channel %d is different", (int)channels[k]);
    scene_free(&room);
}

/* A target error of 4 % takes few rays with guides; without them it would take five times as many. A scene with uniform
   light has no guides. */
TEST(guides_save_rays) {
    sbl_context_desc desc = watch_desc(&seen);
    sbl_picture_desc view = view_of();
    sbl_context *context = watch_context(&seen, &desc, &dark_room);
    test_scene open = { 0 };
    sbl_scene_desc scene;
    double rays;
    if (!context) return;
    REQUIRE(sbl_render_picture(context, &view) == SBL_SUCCESS, "no picture: %s", watch_last(&seen));
    rays = (double)sbl_query_stats(context).sensors.rays;
    printf("  %.2f million rays for %.2f %%\n", 1e-6 * rays,
           100 * (double)sbl_query_stats(context).picture.expected_error);
    CHECK(rays < 1.1e6 && sbl_query_stats(context).picture.expected_error <= 0.04f, "%.2f million rays", 1e-6 * rays);
    scene_floor(&open, scene_material(&open, 0.5f, 0.5f, 0.5f), 0, 3);
    scene_sky(&open, 1, 1, 1);
    scene = scene_desc(&open);
    REQUIRE(sbl_set_scene(context, &scene) == SBL_SUCCESS && sbl_render_picture(context, &view) == SBL_SUCCESS,
            "no picture: %s", watch_last(&seen));
    CHECK(!context->picture.map.spec.guided && !context->picture.map.refine.guides.words, "an open floor has guides");
    sbl_destroy(context);
    scene_free(&open);
}

/* If looks are too noisy for the target error, they get more rays, also with guides. The largest number of rays per
   sensor does not change. */
TEST(looks_grow) {
    static const float asked[2] = { 0.3f, 0.01f };
    sbl_context_desc desc = watch_desc(&seen);
    sbl_context *context = watch_context(&seen, &desc, &dark_room);
    int i;
    for (i = 0; i < 2 && context; i++) {
        sbl_picture_desc view = view_of();
        const sbl__spec *spec = &context->picture.map.spec;
        view.target_error = asked[i];
        if (i) view.tile = 32;  /* one round suffices */
        REQUIRE(sbl_begin_picture(context, &view) == SBL_SUCCESS, "cannot begin");
        while (context->picture.map.refine.stages.stage != SBL__REFINE_SPEND)  /* a round that is not started again */
            REQUIRE(sbl_step(context, 1e-9) == SBL_UNFINISHED, "the picture ended before the first round");
        printf("  target %g %%: looks of %d rays, at most %d looks\n", 100 * (double)asked[i], spec->rays,
               spec->looks);
        if (i == 0)
            CHECK(spec->rays == 16 && spec->looks == SBL__MAX_LOOKS, "looks of %d rays, at most %d looks", spec->rays,
                  spec->looks);
        if (i == 1)
            CHECK(spec->rays == 128 && spec->looks == SBL__MAX_LOOKS / 2, "looks of %d rays, at most %d looks",
                  spec->rays,
                  spec->looks);
        sbl_end(context);
    }
    sbl_destroy(context);
}

/* A guide may be shared between two sensors only if their tangent frames nearly agree, because a guide stores azimuths
   relative to the tangent. sbl__frame flips the tangent across a plane, so normals on opposite sides of it cannot share
   a guide. */
TEST(guides_are_shared_by_like_frames) {
    static const struct { float normal[3]; int serves; } others[] = {
        { { 0.999999f, 0, 0.001f }, 1 }, { { 0.999999f, 0, -0.001f }, 0 }, { { 0.99f, 0.14f, 0 }, 1 },
        { { 0, 1, 0 }, 0 } };
    sbl__pixel home, other;
    int i;
    memset(&home, 0, sizeof home);
    home.id = 1;
    home.normal[0] = 1;
    for (i = 0; i < 4; i++) {
        other = home;
        memcpy(other.normal, others[i].normal, sizeof other.normal);
        CHECK((sbl__guide_fits(&home, &other) > 0.5f) == others[i].serves, "normal %d: %g", i,
              (double)sbl__guide_fits(&home, &other));
    }
    CHECK(sbl__guide_fits(&home, &home) >= 1, "a guide does not fit its own sensor");
}

/* If scouts find light in all bins, as chance distributes them, rays are uniform and have equal weights. If they find
   it in a tenth of the bins, most rays go there. */
TEST(even_light_needs_no_guide) {
    uint64_t seed = 9;
    int run, i;
    for (run = 0; run < 2; run++) {
        float found[SBL__GUIDE_BINS];
        uint32_t words[SBL__GUIDE_WORDS];
        double worst = 0, least = HUGE_VAL;
        memset(found, 0, sizeof found);
        memset(words, 0, sizeof words);
        for (i = 0; i < 6 * SBL__GUIDE_BINS; i++) {  /* six scouts per bin on average */
            const int bin = (int)(ref_random(&seed) * SBL__GUIDE_BINS);
            if (run == 0 || bin < SBL__GUIDE_BINS / 10) found[bin] += 1;
        }
        sbl__guide_make(found, words);
        for (i = 0; i < 1000; i++) {
            double u[2], weight;
            u[0] = ref_random(&seed);
            u[1] = ref_random(&seed);
            weight = guide_warp(words, u);
            worst = fmax(worst, fabs(weight - 1));
            least = fmin(least, weight);
        }
        if (run == 0) CHECK(worst < 1e-3, "the weights of rays differ by up to %g", worst);
        else CHECK(least < 0.2, "the weight of rays towards the light is %g", least);
    }
}

/* In a scene with reflections, each guide sees the light that a scout of another pixel has found in its own direction:
   in that of the scout's hit or, if a flat mirror is hit, of the lamp's image. Light from infinity keeps its
   direction, and so does light below the mean R. */
TEST(guides_see_light_from_their_own_places) {
    /* kinds of light: at the scout's hit, in a mirror, FAR_AWAY, no hit, FAINT */
    enum { SIDE = 64, AT = 32, FAR_AWAY = 2, FAINT = 4 };
    static const float spacing = 0.02f, hit = 0.3f;
    static sbl__pixel pixels[SIDE * SIDE];
    static sbl__core core;
    static sbl__spec spec;
    const double u[2] = { 0.3, 0.1 };
    int kind, i, n;
    for (kind = 0; kind < 5; kind++) {
        sbl__mirrored *m = &core.scene.lamps.mirrored[0];
        const double distance = kind == 1 ? 3 : (double)hit;
        const sbl__pixel *from = &pixels[AT * SIDE + AT];
        sbl__refine r;
        sbl_reading found;
        float way[3];
        int others = 0, moved = 0, wrong = 0;
        memset(&core, 0, sizeof core);
        memset(&r, 0, sizeof r);
        memset(&found, 0, sizeof found);
        r.core = &core;
        r.spec = &spec;
        r.pixels = pixels;
        r.luminance = kind == FAINT ? 2.1f : 1.9f;
        r.width = r.height = r.window.whole[0] = r.window.whole[1] = SIDE;
        core.scene.features = SBL__SPECULAR;
        core.base.allocator.alloc = watch_alloc;
        core.base.allocator.free = watch_free;
        core.base.allocator.user = &seen;
        core.device.base = &core.base;
        for (i = 0; i < SIDE * SIDE; i++) {
            memset(&pixels[i], 0, sizeof pixels[i]);
            pixels[i].position[0] = spacing * (float)(i % SIDE);
            pixels[i].position[2] = spacing * (float)(i / SIDE);
            pixels[i].normal[1] = pixels[i].geometric_normal[1] = 1;
            pixels[i].id = 1;
        }
        sbl__cosine_direction(from->normal, u, way);
        m->normal[1] = -1;
        m->offset = -hit * way[1];
        m->distant = kind == FAR_AWAY;
        for (i = 0; i < 3; i++) {
            m->middle[i] = from->position[i] + 3 * way[i];
            m->low[i] = from->position[i] + hit * way[i] - 0.1f;
            m->high[i] = m->low[i] + 0.2f;
        }
        core.scene.lamps.mirrored_count = kind == 1 || kind == FAR_AWAY;
        found.valid = 1;
        found.radiance[0] = found.radiance[1] = found.radiance[2] = 2;
        found.hit_min = kind == 3 ? 0 : hit;
        REQUIRE(sbl__guides_begin(&r) == SBL_SUCCESS && r.guides.step == 1, "guides are %d pixels apart",
                r.guides.step);
        sbl__scout_splat(&r, AT, AT, u, &found);
        for (i = 0; i < SIDE * SIDE; i++) {
            const float *bins = sbl__guide_found(&r.guides, i);
            const sbl__pixel *p = &pixels[i];
            double right[3], up[3], to[3], x = 0, y = 0, size = 0, at[2] = { u[0], u[1] };
            int bin, own = sbl__guide_bin(u[0], u[1]), lit = 0;
            if (abs(i % SIDE - AT) > 4 || abs(i / SIDE - AT) > 4) {
                for (n = 0; n < SBL__GUIDE_BINS; n++) wrong += bins[n] > 0;
                continue;
            }
            sbl__frame(p->normal, 0, right, up);
            for (n = 0; n < 3; n++) {
                to[n] = (double)from->position[n] + distance * (double)way[n] - (double)p->position[n];
                size += to[n] * to[n];
                x += to[n] * right[n];
                y -= to[n] * up[n];
            }
            if (kind < FAR_AWAY) {
                at[0] = (x * x + y * y) / size;
                at[1] = atan2(y, x) / (2 * SBL__PI);
                at[1] -= floor(at[1]);
            }
            bin = i == AT * SIDE + AT ? own : sbl__guide_bin(at[0], at[1]);
            for (n = 0; n < SBL__GUIDE_BINS; n++) lit += bins[n] > 0;
            others++;
            moved += bin != own;
            wrong += lit != 1 || !(bins[bin] > 0);
        }
        CHECK(others == 81 && wrong == 0, "kind %d: %d of %d guides see the light elsewhere", kind, wrong, others);
        CHECK(kind == 0 ? moved > 50 : kind == 1 ? moved < 40 : moved == 0, "kind %d: %d guides see it in another bin",
              kind, moved);
        sbl__guides_free(&core.device, &r.guides);
    }
}

/* Scouts take the directions of their sequence, also at places where sensors send rays to mirrored lamps: each scout
   hits the wall exactly if its direction meets it. */
TEST(scouts_keep_their_directions) {
    enum { SIDE = 16 };
    sbl_context_desc desc = watch_desc(&seen);
    sbl_picture_desc view = scene_view(SIDE, SIDE, 60, 0.5f, 2.5f, 1.5f, 0.2f, 0, 0);
    test_scene s = { 0 };
    const int wall = scene_material(&s, 0.5f, 0.5f, 0.5f), floor = scene_material(&s, 0.6f, 0.6f, 0.6f);
    sbl_light *l = scene_light(&s, SBL_LIGHT_POINT, 3, 3, 3);
    const sbl__refine *r;
    sbl_context *context;
    uint32_t *sequence;
    int i, hits = 0, wrong = 0;
    s.materials[wall].ior = 1.5f;
    s.materials[wall].roughness = 0.1f;
    l->position[0] = 1; l->position[1] = 1.5f;
    scene_quad(&s, wall, -1, 0, -2, -1, 0, 2, -1, 2, 2, -1, 2, -2);
    scene_floor(&s, floor, 0, 2);
    view.options.mode = SBL_MODE_GI;
    view.look_rays = -64;
    context = watch_context(&seen, &desc, &s);
    REQUIRE(context && sbl_begin_picture(context, &view) == SBL_SUCCESS, "cannot begin: %s", watch_last(&seen));
    r = &context->picture.map.refine;
    while (r->stages.stage != SBL__REFINE_TAKE_SCOUTS && sbl_step(context, 1e-9) == SBL_UNFINISHED) continue;
    REQUIRE(r->stages.stage == SBL__REFINE_TAKE_SCOUTS && r->site_count > 1000, "%d scouts", r->site_count);
    sequence = sbl__sequence_make(&context->core.base, r->guides.scouts, 1, 1);
    for (i = 0; sequence && i < r->site_count; i++) {
        const sbl__site *site = &r->sites[i];
        const sbl__pixel *p = &r->pixels[site->pixel];
        double u[2], t;
        float way[3], away;
        if (p->position[1] > 0.01f || p->position[0] < -0.9f) continue;
        sbl__sequence_at(sequence, site->first, sbl__sensor_seed(site->number, sbl__scouts_seed(r)), u);
        sbl__cosine_direction(p->normal, u, way);
        t = (-1 - (double)p->position[0]) / (double)way[0];
        if (!(t > 0) || t * (double)way[1] > 1.99 || fabs((double)p->position[2] + t * (double)way[2]) > 1.99) t = 0;
        away = r->readings[i].hit_min;
        hits += away > 0;
        wrong += fabs((double)away - t) > 0.02 * t + 1e-3;
    }
    printf("  %d of %d scouts hit the wall, %d where they should not or not where they should\n", hits, r->site_count,
           wrong);
    CHECK(hits > 100 && wrong < hits / 50, "%d scouts hit the wall, %d are wrong", hits, wrong);
    sbl__free(&context->core.base, sequence);
    sbl_destroy(context);
    scene_free(&s);
}

/* A larger picture does not have more guides; they are further apart. */
TEST(guides_are_bounded) {
    sbl__core core;
    sbl__refine r;
    memset(&core, 0, sizeof core);
    memset(&r, 0, sizeof r);
    r.core = &core;
    r.width = r.window.whole[0] = 4096;
    r.height = r.window.whole[1] = 2160;
    core.base.allocator.alloc = watch_alloc;
    core.base.allocator.free = watch_free;
    core.base.allocator.user = &seen;
    core.device.base = &core.base;
    REQUIRE(sbl__guides_begin(&r) == SBL_SUCCESS, "no guides");
    CHECK(r.guides.columns * r.guides.rows < SBL__GUIDES_MOST && r.guides.step == 32, "%d x %d guides, %d pixels apart",
          r.guides.columns, r.guides.rows, r.guides.step);
    sbl__guides_free(&core.device, &r.guides);
}

/* Returns the distance of a pixel of the full picture from the window, in pixels; 0: the window shows it. */
static int distance_to_window(const sbl__refine *r, int x, int y) {
    const sbl__window *w = &r->window;
    int reach = 0;
    while (!sbl__window_covers(w, reach, x - w->first[0], y - w->first[1])) reach++;
    return reach;
}

/* Returns the distance from the window up to which sensors matter: those whose errors count and, in a window with a
   price, those of the tiles beside it. */
static int sensors_reach(const sbl__refine *r) {
    return r->window.margin + (r->price > 0 ? r->tile_size + 1 : 0);
}

/* Returns the guide of a pixel of the full picture, or NULL if there is none, or if it serves no sensor that matters: a
   window knows only the scouts that such guides need. */
static const uint32_t *guide_at(const sbl__refine *r, int x, int y) {
    const sbl__guides *g = &r->guides;
    const int column = x / g->step - g->first[0], row = y / g->step - g->first[1];
    if (distance_to_window(r, x, y) >= sensors_reach(r) + g->step) return NULL;
    return sbl__guide_words(g, 1 + row * g->columns + column);
}

/* The guides of a window are on the grid of the full picture, and equal those of the full picture. A picture as large
   as the window would have guides at every second pixel, not at every fourth. */
TEST(windows_have_the_guides_of_the_whole) {
    enum { ACROSS = 192, DOWN = 144, EDGE = 8 };
    static int serves[DOWN][ACROSS];  /* the number of the guide that serves a pixel, in the grid of the whole */
    static const int window[4] = { 70, 40, 57, 63 };
    static uint32_t words[(ACROSS / 4) * (DOWN / 4)][SBL__GUIDE_WORDS];
    sbl_context *context = watch_context(&seen, NULL, &dark_room);
    sbl_picture_desc view = view_of();
    const sbl__refine *r;
    int x, y, run, same = 0, other = 0, served = 0, wrong = 0;
    REQUIRE(context, "no context");
    view.width = ACROSS;
    view.height = DOWN;
    for (run = 0; run < 2; run++) {
        if (run) memcpy(view.window, window, sizeof window);
        REQUIRE(sbl_render_picture(context, &view) == SBL_SUCCESS, "%s", watch_last(&seen));
        r = &context->picture.map.refine;
        CHECK(r->spec->guided && r->guides.step == 4, "a guide at every %d pixels", r->guides.step);
        for (y = 0; y < DOWN; y += r->guides.step)
            for (x = 0; x < ACROSS; x += r->guides.step) {
                uint32_t *kept = words[y / 4 * (ACROSS / 4) + x / 4];
                const uint32_t *found = guide_at(r, x, y);
                if (!found) continue;
                if (!run) memcpy(kept, found, sizeof words[0]);
                else if (memcmp(kept, found, sizeof words[0]) == 0) same++;
                else other++;
            }
        for (y = window[1] + EDGE; y < window[1] + window[3] - EDGE; y++)
            for (x = window[0] + EDGE; x < window[0] + window[2] - EDGE; x++) {
                const int at = (y - r->window.first[1]) * r->width + x - r->window.first[0];
                const int own = sbl__guide_for(r, at) - 1, columns = r->guides.columns;
                const int number = own < 0 ? -1 : (own / columns + r->guides.first[1]) * ACROSS + own % columns +
                                   r->guides.first[0];
                if (!run) serves[y][x] = number;
                served += number >= 0;
                wrong += number != serves[y][x];
            }
        memcpy(view.mean_radiance, sbl_query_stats(context).picture.mean_radiance, sizeof view.mean_radiance);
        view.price = sbl_query_stats(context).picture.price;
    }
    CHECK(same > 100 && other == 0, "%d guides are the same, %d are not", same, other);
    CHECK(served > 1000 && wrong == 0, "%d pixels have a guide, %d have another than in the whole", served, wrong);
    sbl_destroy(context);
}

/* A window with a price, which has wide margins, sends no scouts that serve no sensor that matters. A guide that is too
   far away for all scouts is that of light from everywhere, as guide 0 is. */
TEST(windows_send_only_scouts_that_serve) {
    static const int window[4] = { 70, 40, 57, 63 };
    sbl_context *context = watch_context(&seen, NULL, &dark_room);
    const sbl__refine *r;
    sbl_picture_desc view = view_of();
    int i, k, even[2] = { 0, 0 }, all[2] = { 0, 0 };
    REQUIRE(context, "no context");
    view.width = 192;
    view.height = 144;
    view.look_rays = -16;
    view.price = 1;
    for (k = 0; k < 3; k++) view.mean_radiance[k] = 0.1f;
    memcpy(view.window, window, sizeof window);
    REQUIRE(sbl_render_picture(context, &view) == SBL_SUCCESS, "%s", watch_last(&seen));
    r = &context->picture.map.refine;
    for (i = 0; i < r->guides.columns * r->guides.rows; i++) {
        const int step = r->guides.step, column = r->guides.first[0] + i % r->guides.columns;
        const int off = distance_to_window(r, column * step, (r->guides.first[1] + i / r->guides.columns) * step);
        const int reach = sensors_reach(r) + 5 * step, beyond = off >= reach;
        if (off && off < reach) continue;
        all[beyond]++;
        even[beyond] += !memcmp(sbl__guide_words(&r->guides, 1 + i), sbl__guide_words(&r->guides, 0),
                                SBL__GUIDE_WORDS * sizeof(uint32_t));
    }
    CHECK(all[1] > 20 && even[1] == all[1], "%d of %d guides far from the window know light", all[1] - even[1], all[1]);
    CHECK(2 * even[0] < all[0], "%d of %d guides in the window know no light", even[0], all[0]);
    sbl_destroy(context);
}

/* The margin of a window adds up to the width that ON PARTS in sbl.h tells: two rings of tiles more with a price. */
TEST(margins_are_as_wide_as_documented) {
    sbl_picture_desc view = view_of();
    int priced, at;
    view.width = view.height = 512;
    view.tile = 16;
    view.filter_radius = 2;
    view.window[2] = view.window[3] = 40;
    for (priced = 0; priced < 2; priced++) {
        const int expected = (priced ? 3 : 1) * view.tile + view.filter_radius + 1;
        int before = 0, after = 0;
        view.price = (float)priced;
        for (at = 200; at < 200 + view.tile; at++) {
            sbl__window w;
            view.window[0] = view.window[1] = at;
            w = sbl__window_of(&view);
            before = SBL__MAX(before, w.inset[0]);
            after = SBL__MAX(after, w.size[1] - w.inset[1] - w.shown[1]);
        }
        CHECK(before == expected && after == expected, "price %d: the margin is up to %d and %d pixels wide, expected "
              "%d", priced, before, after, expected);
    }
}

/* Scouts serve the sensors of a window and of the tiles beside it, but where guides are far apart, no scout is further
   away than its limit. */
TEST(scouts_serve_near_windows) {
    static const struct { int rings, step, most; } cases[4] = { { 0, 4, 15 }, { 2, 4, 32 }, { 2, 8, 44 },
                                                                { 2, 32, 44 } };
    enum { WIDE = 200, BEGIN = 90, END = 110, ROW = 100 };
    sbl__refine r;
    int i, x;
    memset(&r, 0, sizeof r);
    r.width = WIDE;
    r.tile_size = 16;
    r.guides.reach = 2;
    r.window.margin = 4;
    for (i = 0; i < 2; i++) {
        r.window.inset[i] = BEGIN;
        r.window.shown[i] = END - BEGIN;
    }
    for (i = 0; i < 4; i++) {
        int least = WIDE, most = -1;
        r.window.rings = cases[i].rings;
        r.guides.step = cases[i].step;
        for (x = 0; x < WIDE; x++) {
            if (!sbl__scouts_serve(&r, ROW * WIDE + x)) continue;
            least = SBL__MIN(least, x);
            most = x;
        }
        CHECK(BEGIN - least == cases[i].most && most - END + 1 == cases[i].most, "case %d: scouts serve up to %d and "
              "%d pixels away, expected %d", i, BEGIN - least, most - END + 1, cases[i].most);
    }
}

/* Anti-aliasing composes only the pixels that a window shows, and the filter smooths R only up to two pixels beyond. */
TEST(windows_compose_what_they_show) {
    enum { ACROSS = 96, DOWN = 72 };
    static const int window[4] = { 32, 32, 16, 16 };
    static float all[3 * ACROSS * DOWN];
    sbl_context *context = watch_context(&seen, NULL, &dark_room);
    sbl_picture_desc view = view_of();
    sbl__window real;
    sbl__map *m;
    int i, k, shown = 0, lit[2] = { 0, 0 }, smooth[2] = { 0, 0 };
    REQUIRE(context, "no context");
    view.samples = 2;
    view.options.mode = SBL_MODE_AMBIENT;
    view.options.epsilon = 0.5f;
    view.price = 1;
    for (k = 0; k < 3; k++) view.mean_radiance[k] = 0.5f;
    memcpy(view.window, window, sizeof window);
    REQUIRE(sbl_render_picture(context, &view) == SBL_SUCCESS, "%s", watch_last(&seen));
    m = &context->picture.map;
    real = m->window;
    memcpy(m->size, real.size, sizeof m->size);
    memcpy(m->window.shown, real.size, sizeof real.size);
    memset(m->window.inset, 0, sizeof real.inset);  /* the host then reads the margin, too */
    REQUIRE(m->size[0] * m->size[1] <= ACROSS * DOWN && m->size[0] > 16 && sbl_read_channel(context, SBL_CHANNEL_FINAL,
            all, 3 * (size_t)(m->size[0] * m->size[1])) == SBL_SUCCESS, "%s", watch_last(&seen));
    for (i = 0; i < m->size[0] * m->size[1]; i++) {
        const int inside = sbl__window_shows(&real, i % m->size[0], i / m->size[0]);
        shown += inside;
        lit[inside] += all[3 * i] > 0 && all[3 * i] < 100;
    }
    CHECK(shown == 256 && lit[1] > 200 && lit[0] < 20, "%d of %d pixels have light, and %d of the margin", lit[1],
          shown, lit[0]);
    REQUIRE(sbl_read_channel(context, SBL_CHANNEL_RADIANCE, all, 3 * (size_t)(m->size[0] * m->size[1])) == SBL_SUCCESS,
            "%s", watch_last(&seen));
    for (i = 0; i < m->size[0] * m->size[1]; i++)
        smooth[sbl__window_covers(&real, 2, i % m->size[0], i / m->size[0])] += all[3 * i] > 0 && all[3 * i] < 100;
    CHECK(smooth[1] > 350 && smooth[0] < 20, "%d pixels are smooth, and %d farther away", smooth[1], smooth[0]);
    sbl_destroy(context);
}

/* The statistics tell how many rays each look of a picture traced. If look_rays is set to such a number, all looks
   trace as many rays from the start; a negative number guides these rays, even if looks have little noise. */
TEST(pictures_take_the_rays_they_are_given) {
    static const int given[4] = { 0, 16, -64, 128 };
    sbl_context *context = watch_context(&seen, NULL, &dark_room);
    int i;
    REQUIRE(context, "no context");
    for (i = 0; i < 4; i++) {
        sbl_picture_desc view = view_of();
        const sbl__refine *r = &context->picture.map.refine;
        sbl_stats s;
        view.look_rays = given[i];
        view.target_error = 0.08f;
        REQUIRE(sbl_render_picture(context, &view) == SBL_SUCCESS, "%s", watch_last(&seen));
        s = sbl_query_stats(context);
        if (i) CHECK(s.picture.look_rays == given[i], "%d rays, not %d", s.picture.look_rays, given[i]);
        else CHECK(s.picture.look_rays < -16, "rays are not guided: %d", s.picture.look_rays);
        CHECK(r->spec->rays == abs(s.picture.look_rays) && r->spec->guided == (s.picture.look_rays < 0),
              "%d rays, guided: %d", r->spec->rays, r->spec->guided);
        CHECK(!i || r->spec->looks == SBL__MAX_LOOKS * 16 / abs(given[i]), "at most %d looks", r->spec->looks);
    }
    sbl_destroy(context);
}

/* Each failing allocation gives an error, and the next picture is the usual one, to the bit. */
TEST(memory_runs_out) {
    static float expected[3 * PIXELS], now[3 * PIXELS];
    sbl_context_desc desc = watch_desc(&seen);
    sbl_picture_desc view = view_of();
    sbl_context *context = watch_context(&seen, &desc, &dark_room);
    int at, refused = 0;
    view.target_error = 0.08f;
    REQUIRE(render(context, &view, expected), "no picture: %s", watch_last(&seen));
    for (at = 1; at < 600; at += 1 + at / 6) {
        sbl_result result;
        watch_refuse(&seen, at);
        result = sbl_render_picture(context, &view);
        if (!watch_refused(&seen, at, result)) break;
        refused++;
    }
    CHECK(refused > 10 && at < 600, "%d allocations were refused", refused);
    CHECK(render(context, &view, now) && memcmp(now, expected, sizeof now) == 0, "the next picture differs");
    sbl_destroy(context);
    CHECK(seen.blocks == 0 && seen.strangers == 0, "%d blocks are not freed, %d were freed twice or never allocated",
          seen.blocks, seen.strangers);
}

/* Returns 1 if rays are to be guided after the round `round` of a traced picture with a target error of 1 %, whose
   looks have this relative variance. guided: 1 if they are guided already; rays: sbl_options.rays */
static int needs_guides(double variance, int round, int guided, int rays) {
    sbl__refine r;
    sbl__spec spec;
    sbl__measurement measurement;
    memset(&r, 0, sizeof r);
    memset(&spec, 0, sizeof spec);
    memset(&measurement, 0, sizeof measurement);
    spec.traced = 1;
    spec.guided = guided;
    measurement.options.rays = rays;
    r.spec = &spec;
    r.measurement = &measurement;
    r.rounds = round;
    r.target_error = 0.01f;
    r.look_variance = variance;
    return sbl__refine_needs_guides(&r);
}

/* Rays are guided once, after the first round, if the variance of a look is 12.5 times the square of the target
   error. */
TEST(noisy_looks_need_guides) {
    CHECK(needs_guides(12.6e-4, 1, 0, 0), "noisy looks are not guided");
    CHECK(!needs_guides(12.4e-4, 1, 0, 0), "looks with little noise are guided");
    CHECK(!needs_guides(1, 2, 0, 0), "rays are guided after the second round");
    CHECK(!needs_guides(1, 1, 1, 0), "rays are guided twice");
    CHECK(!needs_guides(1, 1, 0, 64), "rays are guided although the host asks for 64");
}

int main(void) {
    dark_room_make(&dark_room);
    RUN(guides_are_densities);
    RUN(densities_follow_roots);
    RUN_PLAIN(rays_go_through_the_hole);
    RUN_PLAIN(the_picture_is_the_same);
    RUN_PLAIN(guides_save_rays);
    RUN_PLAIN(looks_grow);
    RUN(noisy_looks_need_guides);
    RUN(guides_are_shared_by_like_frames);
    RUN(even_light_needs_no_guide);
    RUN(guides_see_light_from_their_own_places);
    RUN(scouts_keep_their_directions);
    RUN(guides_are_bounded);
    RUN(windows_have_the_guides_of_the_whole);
    RUN(windows_send_only_scouts_that_serve);
    RUN(margins_are_as_wide_as_documented);
    RUN(scouts_serve_near_windows);
    RUN(windows_compose_what_they_show);
    RUN(pictures_take_the_rays_they_are_given);
    RUN_PLAIN(shared_rays_find_the_same_light);
    RUN(memory_runs_out);
    scene_free(&dark_room);
    return test_report();
}
