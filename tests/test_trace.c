/* Tests of sensors that trace rays. They agree with rasterised sensors and with closed forms, let no light through
   closed walls, and do not depend on the division of the work. */
#include "../sbl.h"
#include "support/test.h"
#include "support/scenes.h"
#include "support/inside.h"
#include "support/reference.h"
#include "support/trace_hits.h"

#if defined(__SANITIZE_ADDRESS__)
  #define MILLION 100000
#elif defined(__has_feature)
  #if __has_feature(address_sanitizer)
    #define MILLION 100000
  #endif
#endif
#ifndef MILLION
  #define MILLION 1000000
#endif

static sbl_context *context;
static int lost_said;  /* number of messages with SBL_LOG_ITEM_LOST_RAYS */
static int lost_bounces_said;  /* number of messages with SBL_LOG_ITEM_LOST_RAYS about rays of the store */

static void count_lost(sbl_log_level level, sbl_log_item item, const char *message, void *user) {
    (void)level;
    (void)user;
    lost_said += item == SBL_LOG_ITEM_LOST_RAYS;
    lost_bounces_said += item == SBL_LOG_ITEM_LOST_RAYS && strstr(message, "bounced light");
    printf("  %s\n", message);
}

/* Cancels the work once rays between surfaces have been cast. */
static int until_cast(float done, void *user) {
    (void)done;
    (void)user;
    return sbl_query_stats(context).store.rays > 0;
}

static sbl_picture_desc traced(sbl_picture_desc view, sbl_mode mode, int rays) {
    view = scene_plain(view, mode, 0);
    view.options.sensor_size = 0;
    view.options.backend = SBL_BACKEND_TRACE;
    view.options.rays = rays;
    return view;
}

static double luminance(const float *rgb) {
    return 0.2126 * (double)rgb[0] + 0.7152 * (double)rgb[1] + 0.0722 * (double)rgb[2];
}

/* Returns the RMS difference in luminance over pixels that show a surface, relative to the mean of b. */
static double difference(const float *a, const float *b, int pixels) {
    double squares = 0, sum = 0;
    int i, count = 0;
    for (i = 0; i < pixels; i++) {
        double x = luminance(a + 3 * i), y = luminance(b + 3 * i);
        if (y == 0) continue;
        squares += (x - y) * (x - y);
        sum += y;
        count++;
    }
    return count ? sqrt(squares / count) / (sum / count) : 1;
}

/* Makes a room with boxes. Its surfaces emit several colours, which gives smooth light. */
static void glowing_room(test_scene *s) {
    int i;
    scene_cornell_box(s);
    for (i = 0; i < s->material_count; i++) memset(s->materials[i].emission, 0, sizeof s->materials[i].emission);
}

/* Where light is smooth, traced and rasterised R differ by less than 0.3 % RMS. */
TEST(agrees_with_raster_on_smooth_light) {
    test_scene s = { 0 };
    sbl_picture_desc view = scene_cornell_view(26, 26), raster = scene_plain(view, SBL_MODE_AMBIENT, 256),
        ray = traced(view, SBL_MODE_AMBIENT, 4096);
    float *a, *b;
    double error;
    glowing_room(&s);
    raster.options.epsilon = ray.options.epsilon = 1;
    REQUIRE(scene_render(context, &s, &raster), "no picture");
    CHECK(sbl_query_stats(context).backend == SBL_BACKEND_RASTER && sbl_query_stats(context).sensors.rays == 0,
          "the statistics do not report SBL_BACKEND_RASTER");
    a = scene_channel(context, &raster, SBL_CHANNEL_RADIANCE);
    REQUIRE(scene_render(context, &s, &ray), "no picture");
    CHECK(sbl_query_stats(context).backend == SBL_BACKEND_TRACE &&
              sbl_query_stats(context).sensors.rays >= 4096 * (int64_t)sbl_query_stats(context).sensors.sites,
          "the statistics do not report SBL_BACKEND_TRACE");
    b = scene_channel(context, &ray, SBL_CHANNEL_RADIANCE);
    error = difference(b, a, 26 * 26);
    CHECK(error < 0.003, "traced and rasterised differ by %.2f %% rms", 100 * error);
    printf("  %.2f %%\n", 100 * error);
    free(a);
    free(b);
    scene_free(&s);
}

/* In smooth light the error decreases with the number of rays as fast as Sobol points permit. */
TEST(error_falls_with_the_rays) {
    static const struct { int rays; double most; } steps[3] = { { 64, 0.033 }, { 256, 0.013 }, { 1024, 0.005 } };
    test_scene s = { 0 };
    sbl_picture_desc view = scene_cornell_view(48, 48);
    float *truth, *r;
    int i;
    sbl_picture_desc best = traced(view, SBL_MODE_AMBIENT, 4096);
    best.options.epsilon = 1;
    best.options.seed = 77;
    glowing_room(&s);
    REQUIRE(scene_render(context, &s, &best), "no picture");
    truth = scene_channel(context, &best, SBL_CHANNEL_RADIANCE);
    for (i = 0; i < 3; i++) {
        sbl_picture_desc ray = traced(view, SBL_MODE_AMBIENT, steps[i].rays);
        double error;
        ray.options.epsilon = 1;
        REQUIRE(scene_render(context, &s, &ray), "no picture");
        r = scene_channel(context, &ray, SBL_CHANNEL_RADIANCE);
        error = difference(r, truth, 48 * 48);
        printf("  %d rays: %.2f %%\n", steps[i].rays, 100 * error);
        CHECK(error < steps[i].most, "%d rays have an error of %.2f %%", steps[i].rays, 100 * error);
        if (i == 0) {  /* the error is noise and not bands: errors of adjacent pixels are hardly correlated */
            double product = 0, square = 0;
            int x, y;
            for (y = 0; y < 48; y++)
                for (x = 0; x < 47; x++) {
                    const float *p = r + 3 * (48 * y + x), *q = truth + 3 * (48 * y + x);
                    double here = luminance(p) - luminance(q), there = luminance(p + 3) - luminance(q + 3);
                    product += here * there;
                    square += here * here;
                }
            CHECK(product < 0.3 * square, "the correlation of neighbouring errors is %.2f", product / square);
        }
        free(r);
    }
    free(truth);
    scene_free(&s);
}

/* A closed black sphere of small triangles under a bright sky is seen from inside. A ray that passes between two
   triangles would bring in light. */
TEST(closed_walls_are_tight) {
    /* The spheres are rotated so that no edge is parallel to an axis. The last one is also dented, and has facets of
       all sizes and slopes. */
    static const float turns[3][16] = { { 0.36f, 0.48f, -0.8f, 0, -0.8f, 0.6f, 0, 0, 0.48f, 0.64f, 0.6f, 0, 0, 0, 0,
        1 },
                                        { 0.6f, -0.64f, 0.48f, 0, 0.8f, 0.48f, -0.36f, 0, 0, 0.6f, 0.8f, 0, 0, 0, 0,
                                          1 },
                                        { 0.36f, 0.48f, -0.8f, 0, -0.8f, 0.6f, 0, 0, 0.48f, 0.64f, 0.6f, 0, 0, 0, 0,
                                          1 } };
    double rays = 0;
    int way, i, k;
    for (way = 0; way < 3; way++) {
        test_scene s = { 0 };
        sbl_picture_desc view = traced(scene_view(48, 48, 100, 0.1f, 0.2f, 0.05f, 0.7f, 0.3f, -1), SBL_MODE_DIRECT,
                                       512);
        float *r, *positions;
        double escaped = 0;
        sbl_mesh *mesh;
        view.options.seed = (uint32_t)way;
        scene_sky(&s, 1e6f, 1e6f, 1e6f);
        mesh = scene_sphere(&s, scene_material(&s, 0, 0, 0), 0, 0, 0, 1, 256, 128, 0);
        memcpy(mesh->transform, turns[way], sizeof turns[way]);
        positions = (float *)malloc(12 * (size_t)mesh->vertex_count);
        REQUIRE(positions != NULL, "out of memory");
        memcpy(positions, mesh->positions.data, 12 * (size_t)mesh->vertex_count);
        for (i = 0; i < mesh->vertex_count && way == 2; i++) {
            float *p = positions + 3 * i, x = p[0], y = p[1], z = p[2];
            for (k = 0; k < 3; k++) p[k] *= 1 + 0.15f * sinf(11 * x + 1) * sinf(13 * y + 2) * sinf(9 * z + 3);
        }
        mesh->positions.data = positions;
        REQUIRE(scene_render(context, &s, &view), "no picture");
        rays += (double)sbl_query_stats(context).sensors.rays;
        r = scene_channel(context, &view, SBL_CHANNEL_RADIANCE);
        for (i = 0; i < 48 * 48 * 3; i++) escaped += (double)r[i];
        CHECK(escaped == 0, "wall %d: R = %g comes through", way, escaped);
        free(r);
        free(positions);
        scene_free(&s);
    }
    printf("  %.0f rays\n", rays);
    CHECK(rays > 3e6, "only %.0f rays", rays);
}

/* >>contraction: a compiler may compute a * b - c * d with one rounding instead of two. The shaders are rewritten to
   simulate this: doubles hold the product of two floats exactly. */

static inside_source true_source;
static int contracted;  /* number of rewritten expressions */

/* Returns the length of a simple operand such as a.x if `between` follows it, otherwise 0. */
static size_t operand(const char *at, const char *between) {
    size_t length = strspn(at, "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ_0123456789.");
    return length && strncmp(at + length, between, strlen(between)) == 0 ? length : 0;
}

static void contracted_source(unsigned shader, int count, const char *const *strings, const int *lengths) {
    static const char *const between[4] = { " * ", " - ", " * ", "" };
    static const char start[] = "#version 430 core\nfloat fused(float a, float b, float c) { return float(double(a) * "
        "double(b) + double(c)); }\n";
    static char text[1 << 20];
    const char *joined[1], *at;
    char *to = text + sizeof start - 1;
    int i, k;
    (void)lengths;
    memcpy(text, start, sizeof start);
    joined[0] = text;
    for (i = 1; i < count; i++)  /* string 0 is the version of the shader */
        for (at = strings[i]; *at; ) {
            const char *operands[4], *next = at;
            int sizes[4];
            int first = at == strings[i] || at[-1] == '(' || at[-1] == ' ';
            for (k = 0; k < 4 && first && (sizes[k] = (int)operand(next, between[k])) > 0; k++) {
                operands[k] = next;
                next += (size_t)sizes[k] + strlen(between[k]);
            }
            if (k < 4 || !first || !strchr(",);", *next)) { *to++ = *at++; continue; }
            to += sprintf(to, "fused(%.*s, %.*s, -(%.*s * %.*s))", sizes[0], operands[0], sizes[1], operands[1],
                          sizes[2], operands[2], sizes[3], operands[3]);
            at = next;
            contracted++;
        }
    *to = 0;
    true_source(shader, 1, joined, NULL);
}

/* Rays from inside a closed dented ball that are aimed at shared edges and corners of triangles do not escape. */
TEST(edges_are_tight_however_products_round) {
    enum { RAYS = 100000 };
    float *rays = (float *)malloc(32 * (size_t)RAYS);
    traced_hit *hits = (traced_hit *)malloc(RAYS * sizeof *hits);
    int way, i, k;
    REQUIRE(rays && hits, "out of memory");
    for (way = 0; way < 2; way++) {
        test_scene s = { 0 };
        sbl_scene_desc desc;
        sbl_context *own = NULL;
        sbl_mesh *mesh;
        uint64_t seed = 3;
        int escaped = 0;
        float *positions;
        REQUIRE(sbl_create(NULL, &own) == SBL_SUCCESS, "no context");
        if (way == 1 && !(sbl_query_capabilities(own).available & SBL_CAPABILITY_COMPUTE)) {
            printf("  this GL has no doubles; contraction is not tested\n");
            sbl_destroy(own);
            break;
        }
        mesh = scene_sphere(&s, scene_material(&s, 0, 0, 0), 0, 0, 0, 1, 256, 128, 0);
        positions = (float *)scene_alloc(&s, 12 * (size_t)mesh->vertex_count);
        memcpy(positions, mesh->positions.data, 12 * (size_t)mesh->vertex_count);
        for (i = 0; i < mesh->vertex_count; i++) {
            float *p = positions + 3 * i, x = p[0], y = p[1], z = p[2];
            for (k = 0; k < 3; k++) p[k] *= 1 + 0.15f * sinf(11 * x + 1) * sinf(13 * y + 2) * sinf(9 * z + 3);
        }
        mesh->positions.data = positions;
        desc = scene_desc(&s);
        REQUIRE(sbl_set_scene(own, &desc) == SBL_SUCCESS, "no scene");
        contracted = 0;
        if (way == 1) true_source = inside_replace_source(own, contracted_source);
        for (i = 0; i < RAYS; i++) {
            const int triangle = (int)(ref_random(&seed) * inside_triangle_count(own));
            const int edge = (int)(3 * ref_random(&seed));
            const float *a = inside_triangle_corner(own, triangle, edge),
                *b = inside_triangle_corner(own, triangle, (edge + 1) % 3);
            const float share = i % 8 ? (float)ref_random(&seed) : 0;
            float *ray = rays + 8 * (size_t)i;
            for (k = 0; k < 3; k++) {
                ray[k] = 0.3f * (float)ref_random(&seed);
                ray[4 + k] = a[k] + share * (b[k] - a[k]) - ray[k];
            }
            ray[3] = ray[7] = 0;
        }
        REQUIRE(inside_cast(own, rays, RAYS, hits), "nothing was traced");
        for (i = 0; i < RAYS; i++) escaped += hits[i].number < 0;
        CHECK(escaped == 0, "%s: %d of %d rays escape through edges", way ? "fused" : "plain", escaped, RAYS);
        CHECK(way == 0 || contracted > 0, "no expression was rewritten");
        sbl_destroy(own);
        scene_free(&s);
    }
    free(rays);
    free(hits);
}

/* Compares the hits of rays from visible points of the scene with those of the independent ray caster in
   support/reference.h. */
static void compare_hits(const char *what, const test_scene *s, const sbl_picture_desc *view, int points, int each) {
    sbl_scene_desc desc = scene_desc(s);
    ref_scene *truth = ref_create(&desc);
    float *rays = (float *)malloc(32 * (size_t)points * (size_t)each);
    hits_compared seen;
    if (!rays || !scene_render(context, s, view)) abort();
    seen = trace_hits_compare(context, truth, rays, trace_hits_rays(context, view, points, each, 1, rays));
    printf("  %s: %d rays, %d hits, %d ties, %d differ\n", what, seen.rays, seen.hits, seen.ties, seen.differ);
    CHECK(seen.rays == points * each, "%s: only %d rays were compared", what, seen.rays);
    CHECK(seen.differ <= seen.rays / 10000, "%s: %d of %d rays hit another triangle", what, seen.differ, seen.rays);
    CHECK(seen.unexplained == 0, "%s: %d rays hit another triangle, away from all edges", what, seen.unexplained);
    free(rays);
    ref_destroy(truth);
}

/* Rays hit the same triangles as in an independent ray caster. */
TEST(rays_hit_what_they_should) {
    static const unsigned char texels[2 * 4] = { 90, 90, 90, 0, 90, 90, 90, 255 };
    test_scene s = { 0 };
    sbl_picture_desc view = traced(scene_cornell_view(64, 64), SBL_MODE_AMBIENT, 16);
    int i, leaves;
    scene_cornell_box(&s);
    compare_hits("Cornell box", &s, &view, 500, 400);
    for (i = 0; i < 12; i++)
        scene_sphere(&s, 0, 80 + 40.0f * (float)i, 100 + 33.0f * (float)i, 80 + 37.0f * (float)((5 * i) % 12),
                     20 + 3.0f * (float)i, 40 + i, 30, 0);
    leaves = scene_material(&s, 0.5f, 0.5f, 0.5f);
    s.materials[leaves].albedo_texture = scene_texture(&s, texels, sizeof texels, SBL_PIXELS_SRGB8, 2, 1, 4);
    s.materials[leaves].alpha_cutoff = 0.5f;
    for (i = 0; i < 40; i++) {
        const float x = 60 + 11.0f * (float)i, z = 100 + 9.0f * (float)((7 * i) % 40),
            leaf[12] = { x, 200, z, x + 60, 230, z, x + 60, 290, z + 40, x, 260, z + 40 };
        scene_quad_uv(&s, leaves, leaf, 3, 2);
    }
    compare_hits("with balls and leaves", &s, &view, 500, 400);
    scene_free(&s);
}

/* Inside a closed box that emits light, R equals the emission. */
TEST(furnaces) {
    test_scene s = { 0 };
    sbl_picture_desc view = traced(scene_view(32, 32, 90, 0.1f, 0, 0, 1, 0.2f, 0.3f), SBL_MODE_DIRECT, 64);
    float *r;
    double worst = 0;
    int i;
    scene_box(&s, scene_lamp(&s, 2, 2, 2), -1, -1, -1, 1, 1, 1);
    REQUIRE(scene_render(context, &s, &view), "no picture");
    r = scene_channel(context, &view, SBL_CHANNEL_RADIANCE);
    for (i = 0; i < 32 * 32 * 3; i++) worst = test_max(worst, fabs((double)r[i] - 2));
    CHECK(worst < 1e-4, "inside an emitting box R is off by %g", worst);
    free(r);
    scene_free(&s);
}

/* Tests cut-outs and hidden materials. A black lid lies over a floor under the sky. In the texture of the lid, the half
   x < 0 is cut out. */
TEST(cutouts_and_hidden_materials) {
    static const unsigned char texels[2 * 4] = { 0, 0, 0, 0, 0, 0, 0, 255 };
    static const float lid[12] = { -4, 1, -4, 4, 1, -4, 4, 1, 4, -4, 1, 4 };
    float light[3] = { 0, 0, 0 };
    int kind;
    for (kind = 0; kind < 3; kind++) {  /* the lid is solid, cut out or hidden */
        test_scene s = { 0 };
        sbl_picture_desc view = traced(scene_view(16, 16, 10, 0, 0.5f, 0.01f, -0.2f, 0, 0), SBL_MODE_DIRECT, 1024);
        int white = scene_material(&s, 0.5f, 0.5f, 0.5f), black = scene_material(&s, 0, 0, 0);
        float *r;
        scene_sky(&s, 1, 1, 1);
        scene_floor(&s, white, 0, 50);
        scene_quad_uv(&s, black, lid, 1, 1);
        s.textures[0].wrap = SBL_WRAP_CLAMP;
        s.materials[black].albedo_texture = scene_texture(&s, texels, sizeof texels, SBL_PIXELS_SRGB8, 2, 1, 4);
        s.textures[0].wrap = SBL_WRAP_CLAMP;
        if (kind == 1) s.materials[black].alpha_cutoff = 0.5f;
        if (kind == 2) s.materials[black].flags = SBL_MATERIAL_HIDDEN_FROM_SENSORS;
        REQUIRE(scene_render(context, &s, &view), "no picture");
        r = scene_channel(context, &view, SBL_CHANNEL_RADIANCE);
        light[kind] = r[3 * (8 * 16 + 8)];
        free(r);
        scene_free(&s);
    }
    CHECK(light[0] < 0.1f, "under a solid lid R is %g", (double)light[0]);
    CHECK(light[1] > 0.4f && light[1] < 0.75f, "under half a lid R is %g", (double)light[1]);
    CHECK(fabsf(light[2] - 1) < 1e-3f, "under a hidden lid R is %g", (double)light[2]);
}

/* In pictures of a closed cube seen along an axis, the centres of many pixels fall exactly on creases. Traced R is
   exact there: 0 under a sky, and 1 if the walls radiate 1. Rasterised views may lose texels where two surfaces have
   nearly the same distance. */
TEST(creases_are_tight) {
    int kind, i;
    for (kind = 0; kind < 4; kind++) {  /* 0, 1: under a sky; 2, 3: walls reflect ambient light; 1, 3: rasterised */
        test_scene s = { 0 };
        const int furnace = kind / 2;
        const sbl_mode mode = furnace ? SBL_MODE_AMBIENT : SBL_MODE_DIRECT;
        sbl_picture_desc view = traced(scene_view(128, 128, 90, 0, 0, 0.8f, 0, 0, -1), mode, 64);
        const double most = kind & 1 ? (furnace ? 0.01 : 0.05) : furnace ? 1e-4 : 0;
        double worst = 0;
        float *r;
        int wrong = 0;
        if (kind & 1) {
            view.options.backend = SBL_BACKEND_RASTER;
            view.options.sensor_size = 32;
        }
        view.options.epsilon = (float)furnace;
        scene_box(&s, scene_material(&s, 1, 1, 1), -1, -1, -1, 1, 1, 1);
        if (!furnace) scene_sky(&s, 5, 5, 5);
        REQUIRE(scene_render(context, &s, &view), "no picture");
        r = scene_channel(context, &view, SBL_CHANNEL_RADIANCE);
        for (i = 0; i < 128 * 128; i++) {
            const double off = fabs((double)r[3 * i] - furnace);
            worst = test_max(worst, off);
            wrong += !(off <= most);
        }
        CHECK(!wrong, "kind %d: R of %d pixels is off by up to %g", kind, wrong, worst);
        free(r);
        scene_free(&s);
    }
}

/* Points keep the distance 6e-6 * reach from each side of a triangle, also from a side a thousand times as short as the
   others, where x is 0. The reach of this triangle is 2. The ray of the only pixel hits it at x = 2e-6. */
TEST(points_keep_away_from_a_short_side) {
    static const float corners[9] = { 0, 0, 0, 1, 0, 0, 0, 1e-3f, 0 };
    test_scene s = { 0 };
    const sbl_picture_desc view = traced(scene_view(1, 1, 40, 2e-6f, 3e-4f, 2e-4f, 2e-6f, 3e-4f, 0), SBL_MODE_DIRECT,
                                         64);
    float *position;
    scene_mesh(&s, scene_material(&s, 1, 1, 1), corners, NULL, NULL, 3, NULL, 0);
    scene_sky(&s, 1, 1, 1);
    REQUIRE(scene_render(context, &s, &view), "no picture");
    position = scene_channel(context, &view, SBL_CHANNEL_POSITION);
    CHECK(fabs((double)position[0] - 1.2e-5) < 1e-6 && fabs((double)position[1] - 3e-4) < 1e-6,
          "the point is at %g %g, expected 1.2e-5 3e-4", (double)position[0], (double)position[1]);
    free(position);
    scene_free(&s);
}

/* Adds `count` quads whose alpha is 0 everywhere, at heights between 1 and 2 above the origin. Rays pass through them.
   If they are slanted, all their bounding boxes overlap. */
static void add_holes(test_scene *s, int count, float slant) {
    static const unsigned char clear[4] = { 0, 0, 0, 0 };
    const int material = scene_material(s, 0, 0, 0);
    int i;
    s->materials[material].albedo_texture = scene_texture(s, clear, sizeof clear, SBL_PIXELS_SRGB8, 1, 1, 4);
    s->materials[material].alpha_cutoff = 0.5f;
    for (i = 0; i < count; i++) {
        const float y = 1 + (float)i / (float)count, a = y - 50 * slant, b = y + 50 * slant,
            quad[12] = { -50, a, -50, 50, b, -50, 50, b, 50, -50, a, 50 };
        scene_quad_uv(s, material, quad, 1, 1);
    }
}

/* Gathers light at `count` sites of the plane y = 0. Returns the largest difference between R and `truth` at valid
   sites. invalid: receives the number of invalid sites */
static double worst_of_floor(int count, int rays, sbl_mode mode, double truth, int *invalid) {
    sbl_site sites[64];
    sbl_reading readings[64];
    sbl_readings_desc desc;
    double worst = 0;
    int i;
    memset(sites, 0, sizeof sites);
    desc = scene_readings(sites, readings, count, mode);
    desc.options.epsilon = mode == SBL_MODE_AMBIENT ? 1.0f : 0.0f;
    desc.options.rays = rays;
    for (i = 0; i < count; i++) {
        sites[i].position[0] = 0.1f * (float)(i % 8) - 0.35f;
        sites[i].position[2] = 0.1f * (float)(i / 8) - 0.33f;
        sites[i].normal[1] = 1;
    }
    *invalid = count;
    if (sbl_gather_readings(context, &desc) != SBL_SUCCESS) return 1;
    for (*invalid = i = 0; i < count; i++) {
        if (readings[i].valid) worst = test_max(worst, fabs((double)readings[i].radiance[0] - truth));
        *invalid += !readings[i].valid;
    }
    return worst;
}

/* Under up to 63 layers that are cut out completely, R is that of the open sky, whatever the number of rays is. A ray
   treats the 64th layer as solid. */
TEST(rays_pass_63_holes) {
    static const struct { int layers, rays; float slant; double truth; } cases[5] = {
        { 50, 0, 0, 1 }, { 63, 1024, 0, 1 }, { 63, 1024, 0.5f, 1 }, { 60, 16, 0.5f, 1 }, { 64, 256, 0, 0 }
    };
    int i, invalid;
    for (i = 0; i < 5; i++) {
        test_scene s = { 0 };
        sbl_scene_desc scene;
        double worst;
        scene_sky(&s, 1, 1, 1);
        add_holes(&s, cases[i].layers, cases[i].slant);
        scene = scene_desc(&s);
        REQUIRE(sbl_set_scene(context, &scene) == SBL_SUCCESS, "no scene");
        worst = worst_of_floor(16, cases[i].rays, SBL_MODE_DIRECT, cases[i].truth, &invalid);
        CHECK(worst < 0.03 && !invalid, "%d holes, slant %g, %d rays: R is off by %g, and %d readings are invalid",
              cases[i].layers, (double)cases[i].slant, cases[i].rays, worst, invalid);
        scene_free(&s);
    }
}

/* A closed white box with ambient light is full of long, thin, white triangles; R is 1. The hierarchy is inefficient
   for such triangles: rays take thousands of iterations, more than some drivers allow. A reading has the right R, or it
   is invalid and a message says so. */
TEST(lost_rays_are_reported) {
    enum { SLIVERS = 60000 };
    test_scene s = { 0 };
    sbl_scene_desc scene;
    const int white = scene_material(&s, 1, 1, 1), walls = scene_material(&s, 1, 1, 1);
    float *corners = (float *)scene_alloc(&s, 9 * SLIVERS * sizeof *corners);
    unsigned random = 7;
    double worst;
    sbl_readings_desc desc;
    sbl_reading reading;
    sbl_site site;
    int i, k, invalid;
    for (i = 0; i < SLIVERS; i++) {
        float *c = corners + 9 * i;
        for (k = 0; k < 6; k++) {
            random = random * 1664525u + 1013904223u;
            c[k] = (float)(random >> 8) / 16777216.0f * 1.8f - 0.9f;
        }
        c[1] = 0.1f + 0.5f * fabsf(c[1]);
        c[4] = 0.1f + 0.5f * fabsf(c[4]);
        for (k = 0; k < 3; k++) c[6 + k] = c[3 + k] + (k == 1 ? 1e-4f : 0.0f);
    }
    scene_box(&s, walls, -1, -0.01f, -1, 1, 1, 1);
    scene_mesh(&s, white, corners, NULL, NULL, 3 * SLIVERS, NULL, 3 * SLIVERS);
    scene = scene_desc(&s);
    REQUIRE(sbl_set_scene(context, &scene) == SBL_SUCCESS, "no scene");
    lost_said = 0;
    worst = worst_of_floor(16, 64, SBL_MODE_AMBIENT, 1, &invalid);
    printf("  %d of 16 readings are invalid\n", invalid);
    CHECK(worst < 1e-4, "R is off by %g", worst);
    CHECK(lost_said == (invalid > 0), "%d readings are invalid, and the logger was told %d times", invalid, lost_said);
    memset(&site, 0, sizeof site);
    site.position[1] = 0.9f;
    site.normal[1] = 1;
    for (k = 0; k < 3 && invalid; k++) s.materials[walls].emission[k] = 0.1f;
    scene = scene_desc(&s);
    desc = scene_readings(&site, &reading, 1, SBL_MODE_GI);
    desc.options.rays = 4;
    desc.options.progress = until_cast;
    lost_said = 0;
    CHECK(!invalid || (sbl_set_scene(context, &scene) == SBL_SUCCESS &&
                       sbl_gather_readings(context, &desc) == SBL_CANCELLED && lost_bounces_said == 1),
          "no message about lost rays of the store");
    scene_free(&s);
}

/* If all meshes are hidden from sensors, the hierarchy is empty, and R is that of the open sky. */
TEST(all_hidden_from_sensors) {
    test_scene s = { 0 };
    sbl_picture_desc view = traced(scene_view(16, 16, 60, 0.1f, 0, 0, 1, 0.2f, 0.3f), SBL_MODE_DIRECT, 64);
    double worst = 0;
    float *r;
    int i, grey = scene_material(&s, 0.5f, 0.5f, 0.5f);
    s.materials[grey].flags = SBL_MATERIAL_HIDDEN_FROM_SENSORS;
    scene_box(&s, grey, -1, -1, -1, 1, 1, 1);
    scene_sky(&s, 0.5f, 0.5f, 0.5f);
    REQUIRE(scene_render(context, &s, &view), "no picture");
    r = scene_channel(context, &view, SBL_CHANNEL_RADIANCE);
    for (i = 0; i < 16 * 16 * 3; i++) worst = test_max(worst, fabs((double)r[i] - 0.5));
    CHECK(worst < 1e-5, "R is off by %g", worst);
    free(r);
    scene_free(&s);
}

/* Time slices and batch sizes do not change the picture, to the bit. */
TEST(the_picture_does_not_depend_on_the_slices) {
    test_scene s = { 0 };
    sbl_picture_desc view = scene_cornell_view(48, 40);
    float *first = NULL;
    int i;
    view.options.backend = SBL_BACKEND_TRACE;
    view.options.rays = 40;
    scene_cornell_box(&s);
    for (i = 0; i < 4; i++) {
        sbl_context_desc desc;
        sbl_context *other = NULL;
        sbl_scene_desc scene = scene_desc(&s);
        sbl_result result;
        float *r;
        memset(&desc, 0, sizeof desc);
        desc.batch = i == 1 ? 1 : i == 2 ? 77 : 0;
        REQUIRE(sbl_create(&desc, &other) == SBL_SUCCESS && sbl_set_scene(other, &scene) == SBL_SUCCESS, "no context");
        if (i < 3) result = sbl_render_picture(other, &view);
        else {
            REQUIRE(sbl_begin_picture(other, &view) == SBL_SUCCESS, "cannot begin");
            do result = sbl_step(other, 1e-4); while (result == SBL_UNFINISHED);
        }
        REQUIRE(result == SBL_SUCCESS, "%s", sbl_result_string(result));
        r = scene_channel(other, &view, SBL_CHANNEL_RADIANCE);
        if (!first) first = r;
        else {
            CHECK(memcmp(first, r, sizeof(float) * 48 * 40 * 3) == 0, "run %d: the picture differs", i);
            free(r);
        }
        sbl_destroy(other);
    }
    free(first);
    scene_free(&s);
}

/* After a mesh was moved, rays hit it at its new position. */
TEST(moved_meshes_are_found) {
    test_scene s = { 0 };
    sbl_picture_desc view = traced(scene_view(24, 24, 40, 0, 3, 5, 0, 0, 0), SBL_MODE_DIRECT, 64);
    const float up[16] = { 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0.3f, 0.4f, 0, 1 };
    float *moved, *fresh;
    int i, last;
    scene_sky(&s, 1, 1, 1);
    scene_floor(&s, scene_material(&s, 0.5f, 0.5f, 0.5f), 0, 5);
    scene_sphere(&s, scene_lamp(&s, 3, 0, 0), 0, 0.5f, 0, 0.5f, 16, 8, 0);
    last = s.mesh_count - 1;
    REQUIRE(scene_render(context, &s, &view), "no picture");
    REQUIRE(sbl_set_mesh_transform(context, last, up) == SBL_SUCCESS &&
                sbl_render_picture(context, &view) == SBL_SUCCESS,
            "not moved");
    moved = scene_channel(context, &view, SBL_CHANNEL_RADIANCE);
    memcpy(s.meshes[last].transform, up, sizeof up);
    REQUIRE(scene_render(context, &s, &view), "no picture");
    fresh = scene_channel(context, &view, SBL_CHANNEL_RADIANCE);
    for (i = 0; i < 24 * 24 * 3 && moved[i] == fresh[i];) i++;
    CHECK(i == 24 * 24 * 3, "float %d is %g, in a fresh scene %g", i, (double)moved[i % (24 * 24 * 3)],
          (double)fresh[i % (24 * 24 * 3)]);
    free(moved);
    free(fresh);
    scene_free(&s);
}

/* Rays hit the right triangles in reasonable time although many triangles have the same position, some are needles, and
   sizes in the scene vary from 10^-3 to 10^6. */
TEST(nasty_triangles) {
    static const double spots[4][4] = { { 0, 0, 0, 1e-3 }, { 2, 0.5, 1, 0.25 }, { 3000, 4000, -1000, 20 },
        { -5e5, 2e5, 3e5, 4000 } };
    int spot, i, k, way;
    for (spot = 0; spot < 4; spot += 3) {
        test_scene s = { 0 };
        const float x = (float)spots[spot][0], y = (float)spots[spot][1], z = (float)spots[spot][2],
            r = (float)spots[spot][3];
        sbl_picture_desc view = traced(scene_view(32, 32, 60, x + 3 * r, y + r, z - 2 * r, x, y, z), SBL_MODE_AMBIENT,
                                       16);
        int grey = scene_material(&s, 0.5f, 0.5f, 0.5f);
        scene_box(&s, grey, -1e6f, -1e6f, -1e6f, 1e6f, 1e6f, 1e6f);
        for (i = 0; i < 4; i++)
            scene_sphere(&s, grey, (float)spots[i][0], (float)spots[i][1], (float)spots[i][2], (float)spots[i][3], 160,
                         80, 0);
        scene_box(&s, grey, -1e4f, -2e4f, -1e4f, 1e4f, -1e4f, 1e4f);
        compare_hits(spot == 0 ? "a thousandth in a million" : "thousands", &s, &view, 120, 250);
        scene_free(&s);
    }
    for (way = 0; way < 3; way++) {  /* copies; copies of both windings; needles */
        test_scene s = { 0 };
        sbl_picture_desc view = traced(scene_view(32, 32, 60, 0, 0, 0.5f, 0, 0, -1), SBL_MODE_AMBIENT, 256);
        static uint32_t indices[3 * 3000];
        const int copies = way == 2 ? 1000 : 3000;
        double worst = 0;
        float *r, *corners = (float *)malloc(36 * (size_t)copies);
        int grey = scene_material(&s, 0.5f, 0.5f, 0.5f);
        REQUIRE(corners != NULL, "out of memory");
        for (i = 0; i < copies; i++) {
            static const float triangle[9] = { -1, -1, -0.9f, 1, -1, -0.9f, 0.1f, 1, -0.8f };
            const int turned = way == 1 && (i & 1);
            const float a = 1.9e-3f * (float)i, needle[9] = { -1, a - 0.95f, -0.9f, 1, a - 0.95f, -0.9f, 1,
                a - 0.95f + 1e-3f, -0.85f };
            for (k = 0; k < 9; k++)
                corners[9 * i + k] = (way == 2 ? needle : triangle)[turned ? 3 * (2 - k / 3) + k % 3 : k];
        }
        scene_box(&s, grey, -1, -1, -1, 1, 1, 1);
        for (i = 0; i < 3 * copies; i++) indices[i] = (uint32_t)i;
        scene_mesh(&s, grey, corners, NULL, NULL, 3 * copies, indices, 3 * copies);
        view.options.epsilon =
            1; /* all surfaces emit the same; if the driver stops a shader, light is missing */
        compare_hits(way == 0   ? "copies"
                     : way == 1 ? "copies of either winding"
                                : "needles",
                     &s, &view, 30, 200);
        CHECK(sbl_query_stats(context).scene.triangles == 12 + copies, "%d triangles",
              sbl_query_stats(context).scene.triangles);
        CHECK(way == 2 || inside_node_count(context) < 100, "the hierarchy of copies has %d nodes",
              inside_node_count(context));
        r = scene_channel(context, &view, SBL_CHANNEL_RADIANCE);
        for (i = 0; i < 32 * 32 * 3; i++) worst = test_max(worst, fabs((double)r[i] - 0.5));
        CHECK(worst < 1e-4, "%s: R is off by %g", way == 0 ? "copies" : way ==
              1 ? "copies of either winding" : "needles", worst);
        free(r);
        free(corners);
        scene_free(&s);
    }
}

/* A square of two triangles has no copies, although the triangles have the same bounds and two corners in common: a ray
   hits the square wherever it meets it. */
TEST(halves_of_a_square_are_no_copies) {
    enum { ACROSS = 8, RAYS = ACROSS * ACROSS };
    static const float corners[12] = { -1, 0, -1, 1, 0, 1, 1, 0, -1, -1, 0, 1 };
    static const uint32_t indices[6] = { 0, 1, 2, 0, 1, 3 };
    const sbl_picture_desc view = traced(scene_view(8, 8, 60, 0, 4, 1, 0, 0, 0), SBL_MODE_AMBIENT, 16);
    test_scene s = { 0 };
    float rays[8 * RAYS];
    traced_hit hits[RAYS];
    int i, hit = 0;
    scene_mesh(&s, scene_material(&s, 0.5f, 0.5f, 0.5f), corners, NULL, NULL, 4, indices, 6);
    REQUIRE(scene_render(context, &s, &view), "no picture");
    for (i = 0; i < RAYS; i++) {
        const float x = ((float)(i % ACROSS) + 0.4f) / (0.5f * ACROSS) - 1;
        const float z = ((float)(i / ACROSS) + 0.6f) / (0.5f * ACROSS) - 1;
        const float ray[8] = { x, 2, z, 0, 0, -1, 0, 0 };
        memcpy(rays + 8 * i, ray, sizeof ray);
    }
    REQUIRE(inside_cast(context, rays, RAYS, hits), "nothing was traced");
    for (i = 0; i < RAYS; i++) hit += hits[i].number >= 0 && fabs((double)hits[i].distance - 2) < 1e-5;
    CHECK(hit == RAYS, "%d of %d rays hit the square", hit, RAYS);
    scene_free(&s);
}

/* Rays that need thousands of steps are not lost, although some software renderers silently end a shader invocation
   with too many steps. All surfaces are white and emit 1; therefore R is 1 for every ray. */
TEST(every_ray_arrives) {
    const int count = MILLION / 50;
    int way, i;
    /* large triangles that intersect in the room; a fan of needles around a point */
    for (way = 0; way < 2; way++) {
        test_scene s = { 0 };
        sbl_picture_desc view = traced(scene_view(24, 16, 60, 0.1f, 0.2f, 4, 0, 0, 0), SBL_MODE_AMBIENT, 256);
        float *corners = (float *)malloc(36 * (size_t)count), *r, *id;
        int white = scene_material(&s, 1, 1, 1), seen = 0;
        uint64_t seed = 5;
        double low = 1e30, high = 0;
        REQUIRE(corners != NULL, "out of memory");
        for (i = 0; i < 9 * count; i++) {
            const float a = 6.2831853f * ((float)(i / 9) + (i % 9 > 5 ? 0.1f : 0)) / (float)count;
            corners[i] = way == 0 ? (float)(2 * ref_random(&seed) - 1) : i % 3 == 2 ? 0.5f : i % 9 < 3 ? 0 : i % 3 == 0
                ? 2 * cosf(a) : 2 * sinf(a);
        }
        scene_mesh(&s, white, corners, NULL, NULL, 3 * count, NULL, 0);
        scene_floor(&s, white, -1.5f, 50);
        scene_quad(&s, white, -3, -3, -1.5f, 3, -3, -1.5f, 3, 3, -1.5f, -3, 3, -1.5f);
        scene_sky(&s, 1, 1, 1);
        view.options.epsilon = 1;
        if (way == 0) compare_hits("large triangles", &s, &view, 100, 50);
        else REQUIRE(scene_render(context, &s, &view), "no picture");
        r = scene_channel(context, &view, SBL_CHANNEL_RADIANCE);
        id = scene_channel(context, &view, SBL_CHANNEL_ID);
        for (i = 0; i < 24 * 16; i++) {
            if (!(id[i] > 0)) continue;
            seen++;
            low = test_min(low, (double)r[3 * i]);
            high = test_max(high, (double)r[3 * i]);
        }
        CHECK(sbl_query_stats(context).scene.triangles == count + 4, "%d triangles",
              sbl_query_stats(context).scene.triangles);
        CHECK(seen > 100 && low > 1 - 1e-4 && high < 1 + 1e-4, "%s: in %d pixels R is %g to %g, expected 1",
              way == 0 ? "large triangles" : "a fan", seen, low, high);
        free(r);
        free(id);
        free(corners);
        scene_free(&s);
    }
}

/* Rays among a million triangles hit the right ones, and the hierarchy needs little memory. */
TEST(a_million_triangles) {
    test_scene s = { 0 };
    sbl_picture_desc view = traced(scene_cornell_view(48, 48), SBL_MODE_AMBIENT, 16);
    int i, grey;
    sbl_stats stats;
    scene_cornell_box(&s);
    grey = scene_material(&s, 0.5f, 0.5f, 0.5f);
    for (i = 0; i < 4; i++)
        scene_sphere(&s, grey, 120 + 100.0f * (float)i, 150 + 80.0f * (float)i, 300, 60, MILLION / 4 / 700, 350, 0);
    compare_hits("a million triangles", &s, &view, 100, 300);
    stats = sbl_query_stats(context);
    printf("  %d triangles, hierarchy of %.1f MiB in %.2f s\n", stats.scene.triangles,
           (double)stats.scene.bvh_bytes / 1048576, stats.scene.bvh_seconds);
    CHECK(stats.scene.triangles > MILLION * 0.97 && (double)stats.scene.bvh_bytes < 100.0 * stats.scene.triangles &&
              (double)stats.scene.bvh_bytes > 36.0 * stats.scene.triangles,
          "%d triangles take %.0f bytes", stats.scene.triangles, (double)stats.scene.bvh_bytes);
    scene_free(&s);
}

/* A ball of ten million triangles that emits 0.5 is seen from inside, under an extremely bright sky. The test takes 20
   s and 3 GiB, 2 GiB of them in sbl.h; therefore it runs only if SBL_TEST_HUGE is set. */
TEST(ten_million_triangles) {
    test_scene s = { 0 };
    sbl_picture_desc view = traced(scene_view(32, 32, 90, 0.1f, 0.2f, 0.05f, 0.7f, 0.3f, -1), SBL_MODE_AMBIENT, 64);
    sbl_stats stats;
    sbl_memory memory;
    double start, worst = 0;
    float *r;
    int i;
    view.options.epsilon = 1;
    scene_sky(&s, 1e6f, 1e6f, 1e6f);
    scene_sphere(&s, scene_material(&s, 0.5f, 0.5f, 0.5f), 0, 0, 0, 1, 3200, 1600, 0);
    start = test_seconds();
    REQUIRE(scene_render(context, &s, &view), "no picture");
    start = test_seconds() - start;
    stats = sbl_query_stats(context);
    memory = sbl_query_memory(context);
    r = scene_channel(context, &view, SBL_CHANNEL_RADIANCE);
    for (i = 0; i < 32 * 32 * 3; i++) worst = test_max(worst, fabs((double)r[i] - 0.5));
    printf("  %d triangles: %.1f s, of them scene %.1f and hierarchy %.1f; at peak %.0f MiB of host memory and %.0f of "
           "GL's\n",
           stats.scene.triangles, start, stats.seconds.scene, stats.scene.bvh_seconds,
           (double)memory.host_peak_bytes / 1048576, (double)memory.gpu_peak_bytes / 1048576);
    CHECK(stats.scene.triangles > 9e6 && worst < 1e-4, "with %d triangles R is off by %g", stats.scene.triangles,
          worst);
    CHECK((double)memory.host_peak_bytes + (double)memory.gpu_peak_bytes < 300.0 * stats.scene.triangles,
          "too much memory");
    free(r);
    scene_free(&s);
}

/* Invalid options of the tracing back end are refused. */
TEST(refusals) {
    test_scene s = { 0 };
    sbl_scene_desc desc;
    sbl_picture_desc view = scene_cornell_view(8, 8);
    scene_cornell_box(&s);
    desc = scene_desc(&s);
    REQUIRE(sbl_set_scene(context, &desc) == SBL_SUCCESS, "no scene");
    view.options.backend = SBL_BACKEND_TRACE;
    view.options.mode = SBL_MODE_PAPER;
    CHECK(sbl_begin_picture(context, &view) == SBL_ERROR_INVALID_ARGUMENT,
          "SBL_MODE_PAPER with traced rays is accepted");
    view.options.mode = SBL_MODE_DIRECT;
    view.options.rays = 4097;
    CHECK(sbl_begin_picture(context, &view) == SBL_ERROR_INVALID_ARGUMENT, "4097 rays are accepted");
    view.options.rays = -1;
    CHECK(sbl_begin_picture(context, &view) == SBL_ERROR_INVALID_ARGUMENT, "-1 rays are accepted");
    view.options.rays = 0;
    view.options.backend = SBL_BACKEND_COUNT;
    CHECK(sbl_begin_picture(context, &view) == SBL_ERROR_INVALID_ARGUMENT,
          "a back end that does not exist is accepted");
    scene_free(&s);
}

int main(void) {
    sbl_context_desc desc;
    memset(&desc, 0, sizeof desc);
    desc.logger.log = count_lost;
    if (sbl_create(&desc, &context) != SBL_SUCCESS) return 1;
    RUN_PLAIN(agrees_with_raster_on_smooth_light);
    RUN_UNSANITIZED(error_falls_with_the_rays);
    RUN_PLAIN(closed_walls_are_tight);
    RUN(edges_are_tight_however_products_round);
    RUN(furnaces);
    RUN(cutouts_and_hidden_materials);
    RUN_UNSANITIZED(creases_are_tight);
    RUN(points_keep_away_from_a_short_side);
    RUN_UNSANITIZED(rays_pass_63_holes);
    RUN(lost_rays_are_reported);
    RUN(all_hidden_from_sensors);
    RUN(the_picture_does_not_depend_on_the_slices);
    RUN(moved_meshes_are_found);
    RUN_UNSANITIZED(rays_hit_what_they_should);
    RUN_PLAIN(nasty_triangles);
    RUN(halves_of_a_square_are_no_copies);
    RUN(every_ray_arrives);
    RUN_UNSANITIZED(a_million_triangles);
    if (getenv("SBL_TEST_HUGE")) RUN(ten_million_triangles);
    RUN(refusals);
    sbl_destroy(context);
    return test_report();
}
