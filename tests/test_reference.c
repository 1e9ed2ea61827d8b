/* Tests that compare the pipeline with the ray caster of reference.h, pixel by pixel: visible surfaces, the light that
   arrives there, and the texels of single sensors. They cover every vertex format, texture format and kind of
   camera. */
#include "../sbl.h"
#include "support/test.h"
#include "support/scenes.h"
#include "support/reference.h"

static sbl_context *context;

/* >>the scene */

/* Adds a texture of random texels. An alpha channel cuts out about half of the area. */
static int random_texture(test_scene *s, sbl_pixel_format format, int width, int height, int channels, uint64_t *seed) {
    static unsigned char pixels[32 * 32 * 4 * 4];
    int i, count = width * height * channels;
    for (i = 0; i < count; i++) {
        float f = (float)(0.125 + 0.875 * ref_random(seed));
        if (format == SBL_PIXELS_FLOAT) memcpy(pixels + 4 * i, &f, 4);
        else pixels[i] = (unsigned char)(f * 255.0f);
        if (channels % 2 == 0 && i % channels == channels - 1) {
            f = ref_random(seed) < 0.4 ? 0 : 1;
            if (format == SBL_PIXELS_FLOAT) memcpy(pixels + 4 * i, &f, 4);
            else pixels[i] = (unsigned char)(f * 255.0f);
        }
    }
    return scene_texture(s, pixels, (size_t)count * (format == SBL_PIXELS_FLOAT ? 4 : 1), format, width, height,
                         channels);
}

/* Makes a room that is open to the sky: a textured floor and textured walls, a smooth ball, a box with coloured
   corners, and a screen with cut-outs between the lamp and the floor. */
static void textured_scene(test_scene *s) {
    static const float floor[12] = { -3, 0, -3, -3, 0, 3, 3, 0, 3, 3, 0, -3 },
        back[12] = { -3, 0, -3, 3, 0, -3, 3, 3, -3, -3, 3, -3 };
    static const float left[12] = { -3, 0, 3, -3, 0, -3, -3, 3, -3, -3, 3, 3 },
        screen[12] = { -2, 1.9f, -1.2f, 2, 1.6f, -1.2f, 2, 2, 1, -2, 2.3f, 1 };
    static const float lamp[12] = { -1, 3.5f, -1, 1, 3.5f, -1, 1, 3.5f, 1, -1, 3.5f, 1 },
        fence[12] = { 0.4f, 0, 1.5f, 2.6f, 0, 1.1f, 2.6f, 1, 1.1f, 0.4f, 1, 1.5f };
    uint64_t seed = 7;
    float *colors;
    int m, i, first;
    m = scene_material(s, 0.9f, 0.8f, 0.7f);
    s->materials[m].albedo_texture = random_texture(s, SBL_PIXELS_SRGB8, 8, 8, 3, &seed);
    scene_quad_uv(s, m, floor, 2, 2);
    m = scene_material(s, 1, 1, 1);
    s->materials[m].albedo_texture = random_texture(s, SBL_PIXELS_LINEAR8, 7, 5, 1, &seed);
    s->textures[s->materials[m].albedo_texture - 1].wrap = SBL_WRAP_CLAMP;
    scene_quad_uv(s, m, back, 1.25f, 1.25f);
    m = scene_material(s, 0.5f, 1, 0.5f);
    s->materials[m].albedo_texture = random_texture(s, SBL_PIXELS_FLOAT, 4, 9, 3, &seed);
    scene_quad_uv(s, m, left, 1, 1);
    m = scene_material(s, 1, 1, 1);
    s->materials[m].albedo_texture = random_texture(s, SBL_PIXELS_SRGB8, 8, 8, 4, &seed);
    s->materials[m].alpha_cutoff = 0.5f;
    scene_quad_uv(s, m, screen, 1, 1);
    scene_quad_uv(s, m, fence, 0.5f, 0.25f)->id = 77;
    m = scene_lamp(s, 6, 5, 4);
    s->materials[m].emission_texture = random_texture(s, SBL_PIXELS_FLOAT, 3, 3, 3, &seed);
    scene_quad_uv(s, m, lamp, 1, 1);
    scene_sphere(s, scene_material(s, 0.3f, 0.6f, 0.9f), -1.2f, 0.7f, 0.6f, 0.7f, 40, 24, 1);
    first = s->mesh_count;
    scene_box(s, scene_material(s, 1, 0.9f, 0.8f), 0.3f, 0, -1.4f, 1.3f, 1.1f, -0.4f);
    colors = (float *)scene_alloc(s, sizeof *colors * 16);
    for (i = 0; i < 16; i++) colors[i] = i % 4 == 3 ? 1 : (float)ref_random(&seed);
    for (i = first; i < s->mesh_count; i++) s->meshes[i].colors.data = colors;
    scene_sky(s, 0.3f, 0.4f, 0.5f);
}

static sbl_picture_desc textured_view(int width, int height) {
    return scene_view(width, height, 50, 1.5f, 2.2f, 5.5f, -0.1f, 0.9f, 0);
}

/* >>surfaces that the camera sees */

/* Compares the visible surfaces at every pixel except at edges. Positions must be in the plane of the surface within
   the rounding of floats, because otherwise a sensor would see its own surface. They must also be on the ray of the
   pixel within 1/256 pixel, the precision of rasterised corners. Directly at a seam GL may choose the adjacent
   triangle. Albedo is decoded from 8 bits, or read as 16-bit floats, and then filtered. */
static void check_camera(const test_scene *s, const sbl_picture_desc *view, const char *name, int least_seen) {
    sbl_scene_desc desc = scene_desc(s);
    ref_scene *reference = ref_create(&desc);
    float *position = scene_channel(context, view, SBL_CHANNEL_POSITION),
        *normal = scene_channel(context, view, SBL_CHANNEL_NORMAL);
    float *albedo = scene_channel(context, view, SBL_CHANNEL_ALBEDO),
        *id = scene_channel(context, view, SBL_CHANNEL_ID);
    float *depth = scene_channel(context, view, SBL_CHANNEL_DEPTH);
    double off_plane = 0, off_ray = 0, off_depth = 0, off_normal = 0, off_albedo = 0, extent = 0;
    int x, y, k, edges = 0, seen = 0, wrong_id = 0, pixels = view->width * view->height;
    for (k = 0; k < reference->triangle_count; k++)
        for (x = 0; x < 3; x++) extent = fmax(extent, v3_length(reference->triangles[k].p[x]));
    for (y = 0; y < view->height; y++)
        for (x = 0; x < view->width; x++) {
            int i = y * view->width + x;
            ref_point p = ref_pixel(reference, view, x, y);
            v3 origin, direction, next_origin, next_direction, off;
            double size, along, pixel;
            if (ref_is_edge(reference, view, x, y)) { edges++; continue; }
            wrong_id += id[i] != (float)p.id;
            if (!p.hit || id[i] != (float)p.id) continue;
            seen++;
            ref_camera_ray(view, x + 0.5, y + 0.5, &origin, &direction);
            ref_camera_ray(view, x + 1.5, y + 0.5, &next_origin, &next_direction);
            size = extent + v3_length(origin);
            along = v3_dot(v3_sub(p.position, origin), direction);
            pixel = v3_length(v3_sub(v3_mad(origin, direction, along), v3_mad(next_origin, next_direction, along)));
            off = v3_sub(v3_from(position + 3 * i), p.position);
            off_plane = test_max(off_plane, fabs(v3_dot(off, p.face)) / size);
            off_ray = test_max(off_ray, v3_length(v3_mad(off, direction, -v3_dot(off, direction))) / pixel);
            off_depth = test_max(off_depth, fabs((double)depth[i] - ref_depth(view, v3_from(position + 3 * i))) / size);
            if (-v3_dot(direction, p.normal) > 0.02)
                off_normal = test_max(off_normal, v3_length(v3_sub(v3_from(normal + 3 * i), p.normal)));
            for (k = 0; k < 3; k++) off_albedo = test_max(off_albedo, fabs((double)albedo[3 * i + k] - p.albedo[k]));
            if (!(position[3 * i] == position[3 * i] && depth[i] == depth[i] && normal[3 * i] == normal[3 * i] &&
                  albedo[3 * i] == albedo[3 * i])) off_plane = 1e30;
        }
    CHECK(seen >= least_seen, "%s: only %d pixels can be compared", name, seen);
    CHECK(edges <= pixels / 10, "%s: %d of %d pixels are edges", name, edges, pixels);
    CHECK(wrong_id == 0, "%s: %d pixels show another surface", name, wrong_id);
    CHECK(off_plane < 2e-7, "%s: positions differ from their plane by %.3g of the scene's size", name, off_plane);
    CHECK(off_ray < 1 / 256.0, "%s: positions differ from their ray by %.5f pixels", name, off_ray);
    CHECK(off_depth < 5e-7, "%s: depth and position differ by %.3g of the scene's size", name, off_depth);
    CHECK(off_normal < 1e-3, "%s: normals are off by %.3g", name, off_normal);
    CHECK(off_albedo < 2e-3, "%s: albedo is off by %.3g", name, off_albedo);
    free(position); free(normal); free(albedo); free(id); free(depth);
    ref_destroy(reference);
}

/* All channels of a textured scene agree with the ray caster. */
TEST(camera_sees_textured_scene) {
    test_scene s = { 0 };
    sbl_picture_desc view = scene_plain(textured_view(120, 90), SBL_MODE_DIRECT, 4);
    view.tile = 64;
    view.threshold = 1e6f;
    textured_scene(&s);
    if (scene_render(context, &s, &view)) check_camera(&s, &view, "textured scene", 7000);
    scene_free(&s);
}

/* Shifted, stretched, orthographic and rolled cameras agree with the ray caster. */
TEST(cameras) {
    static const char *const names[] = { "off-centre", "oblong pixels", "parallel", "parallel, off-centre",
        "turned upside down" };
    int kind;
    for (kind = 0; kind < 5; kind++) {
        test_scene s = { 0 };
        sbl_picture_desc view = scene_plain(textured_view(43, 33), SBL_MODE_DIRECT, 4);
        float *c = view.view_to_clip;
        view.tile = 64;
        view.threshold = 1e6f;
        textured_scene(&s);
        if (kind == 0) { c[8] = 0.3f; c[9] = -0.2f; }
        if (kind == 1) c[0] *= 1.7f;
        if (kind == 2 || kind == 3) {
            memset(c, 0, sizeof view.view_to_clip);
            c[0] = 0.3f; c[5] = 0.4f; c[10] = -0.1f; c[15] = 1;
            if (kind == 3) { c[12] = 0.25f; c[13] = -0.125f; }
        }
        if (kind == 4) sbl_look_at(view.world_to_view, 1.5f, 2.2f, 5.5f, -0.1f, 0.9f, 0, 0.3f, -1, 0.2f);
        if (scene_render(context, &s, &view)) check_camera(&s, &view, names[kind], 700);
        scene_free(&s);
    }
}

/* >>light on these surfaces */

/* Compares R at every pixel except at edges. The reference has a standard error, which is estimated from independent
   rounds. The texels of the sensor, whose size is 128, have errors at the edges of the lamp, of cut-outs and of
   shadows. Neither error is biased; therefore the means must agree closely, and single pixels roughly. */
static void check_light(sbl_mode mode, double epsilon) {
    test_scene s = { 0 };
    sbl_scene_desc desc;
    ref_scene *reference;
    sbl_picture_desc view = scene_plain(textured_view(28, 20), mode, 96);
    double sum[3] = { 0, 0, 0 }, expected_sum[3] = { 0, 0, 0 }, squares = 0, errors = 0, worst = 0, mean;
    int x, y, k, count = 0;
    uint64_t seed = 11;
    textured_scene(&s);
    desc = scene_desc(&s);
    reference = ref_create(&desc);
    view.options.epsilon = (float)epsilon;
    if (scene_render(context, &s, &view)) {
        float *radiance = scene_channel(context, &view, SBL_CHANNEL_RADIANCE);
        for (y = 0; y < view.height; y++)
            for (x = 0; x < view.width; x++) {
                ref_point p = ref_pixel(reference, &view, x, y);
                double expected[3], error[3];
                v3 origin, direction;
                if (!p.hit || ref_is_edge(reference, &view, x, y)) continue;
                ref_camera_ray(&view, x + 0.5, y + 0.5, &origin, &direction);
                if (v3_dot(direction, p.normal) > -0.02) continue;  /* sbl.h bends such shading normals */
                ref_gather(reference, p.position, p.normal, epsilon, 16, 10, 4, &seed, expected, error);
                count++;
                for (k = 0; k < 3; k++) {
                    double off = (double)radiance[3 * (y * view.width + x) + k] - expected[k];
                    sum[k] += (double)radiance[3 * (y * view.width + x) + k];
                    expected_sum[k] += expected[k];
                    squares += off * off;
                    errors += error[k] * error[k];
                    if (!(fabs(off) - 4 * error[k] <= worst)) worst = fabs(off) - 4 * error[k];
                }
            }
        free(radiance);
    }
    mean = (expected_sum[0] + expected_sum[1] + expected_sum[2]) / (3 * count);
    squares = sqrt(squares / (3 * count)) / mean;
    errors = sqrt(errors / (3 * count)) / mean;
    printf("  %d pixels: rms %.2f %% of the mean, that of the reference %.2f %%; worst %.1f %%; bias %+.3f %%\n",
           count, 100 * squares, 100 * errors, 100 * worst / mean,
           100 * (sum[0] / expected_sum[0] - 1));
    CHECK(count > 280, "only %d pixels can be compared", count);
    CHECK(errors < 0.012, "the reference's own error is %.2f %%", 100 * errors);
    for (k = 0; k < 3; k++)
        CHECK(fabs(sum[k] / expected_sum[k] - 1) < 0.003, "mean R, colour %d, is off by %+.3f %%", k,
              100 * (sum[k] / expected_sum[k] - 1));
    CHECK(squares < 0.015, "R is off by %.2f %% rms", 100 * squares);
    CHECK(worst < 0.05 * mean, "R of a pixel is off by %.4f more than the reference's error; the mean is %.4f", worst,
          mean);
    ref_destroy(reference);
    scene_free(&s);
}

/* R in SBL_MODE_DIRECT and SBL_MODE_AMBIENT agrees with the estimate of the ray caster. */
TEST(direct_light) { check_light(SBL_MODE_DIRECT, 0); }
TEST(ambient_light) { check_light(SBL_MODE_AMBIENT, 0.5); }

/* Compares each texel of a sensor with a ray through its centre. Texels at an edge, where rays a tenth of a texel apart
   meet different surfaces, may differ. Texels show emitters only in SBL_MODE_PAPER. In other modes texels show emitters
   as black, and rays towards the lamps measure their light. */
static void check_texels(sbl_mode mode) {
    static const int pixels[][2] = { { 12, 9 }, { 30, 25 }, { 33, 16 }, { 5, 12 }, { 20, 28 }, { 10, 17 } };
    test_scene s = { 0 };
    sbl_scene_desc desc;
    ref_scene *reference;
    sbl_picture_desc view = scene_plain(textured_view(40, 30), mode, 48);
    int n, v, i, j, k, q, texels = 0, edges = 0, wrong_light = 0, wrong_distance = 0, holes = 0, glowing = 0;
    textured_scene(&s);
    desc = scene_desc(&s);
    reference = ref_create(&desc);
    view.options.epsilon = 0.5f;
    if (!scene_render(context, &s, &view)) goto done;
    for (n = 0; n < (int)(sizeof pixels / sizeof *pixels); n++) {
        ref_point p = ref_pixel(reference, &view, pixels[n][0], pixels[n][1]);
        sbl_sensor sensor;
        float *radiance, *weights;
        double hits = 0, distances = 0, backs = 0, nearest = HUGE_VAL;
        size_t count;
        memset(&sensor, 0, sizeof sensor);
        CHECK(p.hit, "pixel %d %d is empty", pixels[n][0], pixels[n][1]);
        if (sbl_inspect_sensor(context, pixels[n][0], pixels[n][1], &sensor, NULL, NULL, 0) != SBL_SUCCESS) {
            CHECK(0, "the sensor cannot be inspected");
            continue;
        }
        count = (size_t)sensor.sheet_width * (size_t)sensor.sheet_height;
        radiance = (float *)calloc(4 * count + 1, sizeof *radiance);
        weights = (float *)calloc(count + 1, sizeof *weights);
        if (!radiance || !weights) abort();
        CHECK(sbl_inspect_sensor(context, pixels[n][0], pixels[n][1], &sensor, radiance, weights, count) == SBL_SUCCESS,
              "the sensor cannot be inspected");
        CHECK(v3_length(v3_sub(v3_from(sensor.position), p.position)) < 0.01, "the sensor is %.4f from its point",
              v3_length(v3_sub(v3_from(sensor.position), p.position)));
        CHECK(v3_dot(v3_from(sensor.normal), p.normal) > 0.9999, "the sensor's normal is wrong");
        CHECK(sensor.valid == 1 && sensor.sensed == 1, "valid %d, sensed %d", sensor.valid, sensor.sensed);
        for (v = 0; v < sensor.view_count; v++) {
            const sbl_sensor_view *w = &sensor.views[v];
            for (j = 0; j < w->rect[3]; j++)
                for (i = 0; i < w->rect[2]; i++) {
                    size_t at = (size_t)(w->rect[1] + j) * (size_t)sensor.sheet_width + (size_t)(w->rect[0] + i);
                    const float *texel = radiance + 4 * at;
                    ref_point seen[5];
                    double light[3], off = 0, distance = 0;
                    int edge = 0;
                    for (q = 0; q < 5; q++) {
                        static const double aside[5][2] = { { 0.5, 0.5 }, { 0.4, 0.4 }, { 0.6, 0.4 }, { 0.4, 0.6 },
                            { 0.6, 0.6 } };
                        double x = (double)w->x0 + (double)(w->x1 - w->x0) * (i + aside[q][0]) / w->rect[2];
                        double y = (double)w->y0 + (double)(w->y1 - w->y0) * (j + aside[q][1]) / w->rect[3];
                        v3 d = v3_unit(v3_mad(v3_mad(v3_from(w->forward), v3_from(w->right), x), v3_from(w->up), y));
                        ref_hit hit = ref_trace(reference, v3_from(sensor.position), d, 0, HUGE_VAL,
                                                SBL_MATERIAL_HIDDEN_FROM_SENSORS);
                        seen[q] = ref_surface(reference, hit, d);
                        if (q == 0) distance = seen[0].hit ? hit.t * (seen[0].back ? -1 : 1) : 0;
                        edge |= seen[q].id != seen[0].id || seen[q].back != seen[0].back;
                    }
                    texels++;
                    edges += edge;
                    hits += distance != 0 ? (double)weights[at] : 0;
                    backs += distance < 0 ? (double)weights[at] : 0;
                    distances += (double)weights[at] * fabs(distance);
                    if (distance != 0) nearest = fmin(nearest, fabs(distance));
                    if (edge) continue;
                    ref_light(reference, &seen[0], 0.5, light);
                    if (seen[0].hit && ref_glows(reference, &seen[0])) {
                        glowing++;
                        for (k = 0; k < 3; k++) light[k] *= mode == SBL_MODE_PAPER;
                    }
                    for (k = 0; k < 3; k++) off = test_max(off, fabs((double)texel[k] - light[k]) - 0.01 * light[k]);
                    holes += seen[0].mesh == 3 || seen[0].mesh == 4;
                    /* light has 16 bits, textures have 8 or 16 */
                    if (!(off < 3e-3)) wrong_light++;
                    if (!(fabs((double)texel[3] - distance) <= 2e-3 * fabs(distance))) wrong_distance++;
                }
        }
        CHECK(fabs((double)sensor.hit_mean / (distances / hits) - 1) < 0.02, "the mean distance is %.4f, expected %.4f",
              (double)sensor.hit_mean, distances / hits);
        CHECK(fabs((double)sensor.hit_min / nearest - 1) < 0.1, "the nearest surface is at %.4f, expected %.4f",
              (double)sensor.hit_min, nearest);
        CHECK(fabs((double)sensor.back_share - backs) < 0.01, "back_share is %.4f, expected %.4f",
              (double)sensor.back_share, backs);
        free(radiance);
        free(weights);
    }
    printf("  %d texels, %d at edges, %d on surfaces with cut-outs\n", texels, edges, holes);
    CHECK(texels >= 6 * 48 * 48 && holes > 300 && glowing > 20,
          "%d texels, %d on surfaces with cut-outs, %d on emitters",
          texels, holes, glowing);
    CHECK(edges < texels / 5, "%d of %d texels are at edges", edges, texels);
    /* a few texels may differ in sensors that are very close to edges of cut-outs */
    CHECK(wrong_light * 1000 < texels, "the light of %d of %d texels differs", wrong_light, texels);
    CHECK(wrong_distance * 1000 < texels, "the distance of %d of %d texels differs", wrong_distance, texels);
done:
    ref_destroy(reference);
    scene_free(&s);
}

/* The texels of sensors agree with single rays in two modes. */
TEST(sensors_see_what_rays_see) { check_texels(SBL_MODE_AMBIENT); }
TEST(sensors_of_the_paper_see_what_rays_see) { check_texels(SBL_MODE_PAPER); }

/* >>vertex formats */

static uint16_t to_half(double value) {  /* for values below some thousands that are not subnormal */
    int exponent;
    double fraction = frexp(fabs(value), &exponent);
    unsigned sign = value < 0 ? 0x8000u : 0;
    if (value == 0 || exponent < -13) return (uint16_t)sign;
    return (uint16_t)(sign | ((unsigned)(exponent + 14) << 10 | 0) | ((unsigned)(fraction * 2048) & 1023));
}

static size_t encode(unsigned char *at, double value, sbl_type type) {
    float f = (float)value;
    uint16_t u;
    uint32_t w;
    switch (type) {
    case SBL_FLOAT32: memcpy(at, &f, 4); return 4;
    case SBL_FLOAT16: u = to_half(value); memcpy(at, &u, 2); return 2;
    case SBL_UINT8_NORM: *at = (unsigned char)(value * 255 + 0.5); return 1;
    case SBL_UINT16_NORM: u = (uint16_t)(value * 65535 + 0.5); memcpy(at, &u, 2); return 2;
    case SBL_INT8_NORM: *at = (unsigned char)((int)floor(value * 127 + 0.5) & 255); return 1;
    case SBL_INT16_NORM: u = (uint16_t)((int)floor(value * 32767 + 0.5) & 65535); memcpy(at, &u, 2); return 2;
    case SBL_UINT8: *at = (unsigned char)value; return 1;
    case SBL_UINT16: u = (uint16_t)value; memcpy(at, &u, 2); return 2;
    default: w = (uint32_t)value; memcpy(at, &w, 4); return 4;
    }
}

/* Encodes values with `gap` bytes of garbage before and between elements. */
static sbl_stream make_stream(test_scene *s, const double *values, int count, int components, sbl_type type, int gap) {
    sbl_stream stream;
    size_t element = ref_type_bytes(type) * (size_t)components + (size_t)gap, at;
    unsigned char *bytes = (unsigned char *)scene_alloc(s, element * (size_t)count + (size_t)gap);
    int i, k;
    memset(&stream, 0, sizeof stream);
    memset(bytes, 0xFF, element * (size_t)count + (size_t)gap);
    for (i = 0; i < count; i++)
        for (k = 0, at = (size_t)gap + element * (size_t)i; k < components; k++)
            at += encode(bytes + at, values[components * i + k], type);
    stream.data = bytes;
    stream.offset = (size_t)gap;
    stream.stride = gap ? element : 0;
    stream.type = type;
    return stream;
}

/* The two lowest integers of a signed normalised type both mean -1. */
TEST(the_lowest_integers_are_minus_one) {
    static const int8_t bytes[9] = { -128, -127, 0, 127, -128, 0, 0, 127, -127 };
    static const int16_t words[9] = { -32768, -32767, 0, 32767, -32768, 0, 0, 32767, -32767 };
    int way, k;
    for (way = 0; way < 2; way++) {
        test_scene s = { 0 };
        sbl_scene_desc desc;
        sbl_bounds bounds;
        sbl_mesh *m = &s.meshes[s.mesh_count++];
        memset(m, 0, sizeof *m);
        m->material = scene_material(&s, 0.5f, 0.5f, 0.5f);
        m->positions.data = way ? (const void *)words : (const void *)bytes;
        m->positions.type = way ? SBL_INT16_NORM : SBL_INT8_NORM;
        m->vertex_count = 3;
        desc = scene_desc(&s);
        REQUIRE(sbl_set_scene(context, &desc) == SBL_SUCCESS, "no scene");
        bounds = sbl_query_bounds(context);
        for (k = 0; k < 3; k++)
            CHECK(fabs((double)bounds.lowest[k] + 1) < 1e-9, "%d bytes: the lowest coordinate is %.9g", way + 1,
                  (double)bounds.lowest[k]);
        scene_free(&s);
    }
}

/* Every vertex format, with and without gaps, indices and optional streams, gives the surface that the ray caster
   sees. */
TEST(vertex_formats) {
    enum { N = 6, VERTICES = N * N, CORNERS = 6 * (N - 1) * (N - 1) };
    /* SBL_TYPE_COUNT: the stream is missing */
    static const struct { sbl_type position, normal, texcoord, color, index; int gap; } kinds[] = {
        { SBL_FLOAT32, SBL_FLOAT32, SBL_FLOAT32, SBL_FLOAT32, SBL_UINT32, 0 },
        { SBL_FLOAT32, SBL_INT8_NORM, SBL_UINT8_NORM, SBL_UINT8_NORM, SBL_UINT8, 4 },
        { SBL_FLOAT16, SBL_FLOAT16, SBL_FLOAT16, SBL_FLOAT16, SBL_UINT16, 2 },
        { SBL_INT16_NORM, SBL_INT16_NORM, SBL_UINT16_NORM, SBL_UINT16_NORM, SBL_UINT16, 0 },
        { SBL_UINT16_NORM, SBL_INT8_NORM, SBL_INT16_NORM, SBL_UINT8_NORM, SBL_TYPE_COUNT, 6 },
        { SBL_FLOAT32, SBL_TYPE_COUNT, SBL_UINT16_NORM, SBL_TYPE_COUNT, SBL_UINT32, 12 },
        { SBL_FLOAT16, SBL_TYPE_COUNT, SBL_FLOAT32, SBL_UINT16_NORM, SBL_TYPE_COUNT, 3 },
        { SBL_INT16_NORM, SBL_INT8_NORM, SBL_FLOAT16, SBL_FLOAT32, SBL_UINT8, 5 } };
    int kind;
    for (kind = 0; kind < (int)(sizeof kinds / sizeof *kinds); kind++) {
        test_scene s = { 0 };
        sbl_picture_desc view = scene_plain(scene_view(64, 48, 40, 0.6f, 1.4f, 1.3f, 0.5f, 0.3f, 0.45f),
                                            SBL_MODE_DIRECT, 4);
        double grid[VERTICES][12], flat[12 * CORNERS], index[CORNERS];
        int indexed = kinds[kind].index != SBL_TYPE_COUNT, corners = 0, i, j, k, count, at = 0;
        char name[64];
        uint64_t seed = 3;
        sbl_mesh *m = &s.meshes[s.mesh_count++];
        /* position, normal, texture coordinates, colour; all except the normal are between 0 and 1 */
        for (i = 0; i < VERTICES; i++) {
            double x = (i % N) / (N - 1.0), z = (double)(i / N) / (N - 1);
            v3 n = v3_unit(v3_of(0.3 * cos(4 * x), 1, -0.4 * sin(3 * z)));
            grid[i][0] = x; grid[i][1] = 0.3 + 0.1 * sin(4 * x) - 0.1 * cos(3 * z); grid[i][2] = z;
            grid[i][3] = n.x; grid[i][4] = n.y; grid[i][5] = n.z;
            grid[i][6] = 0.1 + 0.8 * x; grid[i][7] = 1 - 0.9 * z;
            for (k = 8; k < 12; k++) grid[i][k] = k == 11 ? 1 : ref_random(&seed);
        }
        for (i = 0; i < N - 1; i++)
            for (j = 0; j < N - 1; j++)
                for (k = 0; k < 6; k++)
                    index[corners++] = (i + (k == 1 || k == 2 || k == 4)) * N + j + (k == 2 || k == 4 || k == 5);
        count = indexed ? VERTICES : corners;
        memset(m, 0, sizeof *m);
        for (k = 0; k < 4; k++) {
            static const int components[4] = { 3, 3, 2, 4 };
            sbl_type type = k == 0 ? kinds[kind].position : k == 1 ? kinds[kind].normal : k == 2 ? kinds[kind].texcoord
                : kinds[kind].color;
            sbl_stream *stream = k == 0 ? &m->positions : k == 1 ? &m->normals : k == 2 ? &m->texcoords : &m->colors;
            for (i = 0; i < count; i++)
                for (j = 0; j < components[k]; j++)
                    flat[components[k] * i + j] = grid[indexed ? i : (int)index[i]][at + j];
            at += components[k];
            if (type != SBL_TYPE_COUNT) *stream = make_stream(&s, flat, count, components[k], type, kinds[kind].gap);
        }
        m->vertex_count = count;
        if (indexed) {
            m->indices = make_stream(&s, index, corners, 1, kinds[kind].index, kinds[kind].gap);
            m->index_count = corners;
        }
        m->material = scene_material(&s, 0.9f, 0.95f, 1);
        s.materials[0].albedo_texture = random_texture(&s, SBL_PIXELS_LINEAR8, 4, 4, 3, &seed);
        view.tile = 64;
        view.threshold = 1e6f;
        sprintf(name, "vertex formats %d", kind);
        if (scene_render(context, &s, &view)) check_camera(&s, &view, name, 1000);
        scene_free(&s);
    }
}

/* Normals are transformed by the inverse transpose of a matrix that rotates and scales. The second matrix also
   mirrors. */
TEST(transformed_smooth_mesh) {
    int mirrored, i;
    for (mirrored = 0; mirrored < 2; mirrored++) {
        test_scene s = { 0 };
        sbl_picture_desc view = scene_plain(scene_view(80, 60, 40, 1, 2, 6, 0.5f, 0.3f, 0), SBL_MODE_DIRECT, 4);
        static const float m[16] = { 0.3f, 1.2f, 0.2f, 0, -2, 0.5f, 0.4f, 0, 0.3f, 0.1f, 0.6f, 0, 0.5f, 0.25f, -0.125f,
            1 };
        sbl_mesh *mesh = scene_sphere(&s, scene_material(&s, 0.5f, 0.6f, 0.7f), 0.1f, 0, 0, 0.8f, 30, 20, 1);
        for (i = 0; i < 16; i++) mesh->transform[i] = mirrored && i < 3 ? -m[i] : m[i];
        view.tile = 64;
        view.threshold = 1e6f;
        if (scene_render(context, &s, &view))
            check_camera(&s, &view, mirrored ? "mirrored ball" : "stretched ball", 500);
        scene_free(&s);
    }
}

/* Facets that are smaller on the screen than facet_limit have their geometric normals. Facets of twice this size have
   their shading normals. */
TEST(facets) {
    static const float limits[3] = { -1, 1, 1e6f };  /* facets of the ball are about 20 pixels high */
    float *flat = NULL;
    int way, i, k;
    for (way = 3; way >= 0; way--) {  /* 3: the ball has no normals */
        test_scene s = { 0 };
        sbl_picture_desc view = scene_plain(scene_view(64, 64, 40, 0, 0, 3, 0, 0, 0), SBL_MODE_DIRECT, 4);
        float *normals;
        double apart = 0;
        scene_sphere(&s, scene_material(&s, 0.5f, 0.5f, 0.5f), 0, 0, 0, 0.9f, 12, 8, way < 3);
        view.tile = 64;
        view.facet_limit = way < 3 ? limits[way] : -1;
        REQUIRE(scene_render(context, &s, &view), "no picture");
        normals = scene_channel(context, &view, SBL_CHANNEL_NORMAL);
        for (i = 0; flat && i < 64 * 64; i++)
            for (k = 0; k < 3; k++) apart += fabs((double)normals[3 * i + k] - (double)flat[3 * i + k]) / (64 * 64);
        if (way == 2) CHECK(apart < 1e-5, "normals of facets below the limit are off by %g", apart);
        if (way < 2) CHECK(apart > 0.02, "with a limit of %g all pixels have the facets' normals", (double)limits[way]);
        if (flat) free(normals);
        else flat = normals;
        scene_free(&s);
    }
    free(flat);
}

/* >>texture formats */

/* Makes a wall of quads, one for every format, number of channels and wrap mode, with texture coordinates outside of 0
   to 1. */
TEST(texture_formats) {
    test_scene s = { 0 };
    sbl_picture_desc view = scene_plain(scene_view(150, 100, 40, 3, 2, 6, 3, 2, 0), SBL_MODE_DIRECT, 4);
    uint64_t seed = 5;
    int i;
    for (i = 0; i < 24; i++) {
        int format = i % 3, channels = 1 + i / 3 % 4, wrap = i / 12, m = scene_material(&s, 1, 0.75f, 0.5f), k;
        float x = (float)(i % 6), y = (float)(i / 6), corners[12];
        float *uv = (float *)scene_alloc(&s, 8 * sizeof *uv);
        for (k = 0; k < 4; k++) {
            corners[3 * k] = x + (k == 1 || k == 2 ? 0.9f : 0);
            corners[3 * k + 1] = y + (k >= 2 ? 0.9f : 0);
            corners[3 * k + 2] = 0;
            uv[2 * k] = k == 1 || k == 2 ? 1.6f : -0.7f;
            uv[2 * k + 1] = k >= 2 ? -1.3f : 1.4f;
        }
        s.materials[m].albedo_texture = random_texture(&s, (sbl_pixel_format)format, 3 + i % 4, 2 + i % 3, channels,
                                                       &seed);
        s.textures[i].wrap = wrap ? SBL_WRAP_CLAMP : SBL_WRAP_REPEAT;
        if (channels == 4 && i % 2) s.textures[i].channels = 0;  /* 0 is the default of 4 */
        if (channels % 2 == 0) s.materials[m].alpha_cutoff = 0.5f;
        scene_quad_uv(&s, m, corners, 1, 1)->texcoords.data = uv;
    }
    /* this texture has a stride that is greater than its rows */
    {
        static const unsigned char rows[2][8] = { { 255, 0, 0, 0, 255, 0, 99, 99 },
            { 0, 0, 255, 255, 255, 255, 99, 99 } };
        int m = scene_material(&s, 1, 1, 1);
        s.materials[m].albedo_texture = scene_texture(&s, rows, sizeof rows, SBL_PIXELS_SRGB8, 2, 2, 3);
        s.textures[s.texture_count - 1].stride = 8;
        scene_quad(&s, m, 0, -1, 0, 6, -1, 0, 6, -0.1f, 0, 0, -0.1f, 0);
    }
    view.tile = 64;
    view.threshold = 1e6f;
    if (scene_render(context, &s, &view)) check_camera(&s, &view, "texture formats", 5000);
    scene_free(&s);
}

int main(void) {
    if (sbl_create(NULL, &context) != SBL_SUCCESS) { printf("no context\n0 passed, 1 failed, 0 skipped\n"); return 1; }
    RUN(camera_sees_textured_scene);
    RUN(cameras);
    RUN(the_lowest_integers_are_minus_one);
    RUN(vertex_formats);
    RUN(transformed_smooth_mesh);
    RUN(facets);
    RUN(texture_formats);
    RUN(sensors_see_what_rays_see);
    RUN(sensors_of_the_paper_see_what_rays_see);
    RUN(direct_light);
    RUN(ambient_light);
    sbl_destroy(context);
    return test_report();
}
