/* The implementation as one object, which all programs share; see scripts/Makefile. */
#define SBL_IMPLEMENTATION
#ifndef _WIN32
  #define SBL_EGL
#endif
#include "../../sbl.h"
#include "inside.h"

float inside_cell_length(const sbl_context *context) { return context->core.scene.store.length; }

int inside_most_points(const sbl_context *context) {
    const sbl__bounce *b = context->core.bounce;
    int i, most = 0;
    for (i = 0; i < context->core.scene.store.leaf_count; i++) most = SBL__MAX(most, b->states[i].points);
    return most;
}
int inside_near_points(const sbl_context *context) {
    const sbl__bounce *b = context->core.bounce;
    int i, count = 0;
    for (i = 0; i < b->point_count; i++)
        count += b->points[i].number >= 4 && b->points[i].at.distance <= 8 * context->core.scene.store.length;
    return count;
}
void inside_limit_cells(sbl_context *context, int usual, int most) {
    context->core.scene.store.scene_leaves = usual;
    context->core.scene.store.most_leaves = most;
}
int inside_most_cells(const sbl_context *context) { return context->core.scene.store.most_leaves; }
int inside_glow_count(const sbl_context *context) { return context->core.scene.bright.glow_count; }
int inside_mirrored(const sbl_context *context) {
    const sbl__lamps *lamps = &context->core.scene.lamps, *bright = &context->core.scene.bright;
    const size_t size = sizeof *lamps->mirrored * (size_t)lamps->mirrored_count;
    return bright->glow_count && (bright->mirrored_count != lamps->mirrored_count ||
                                  memcmp(bright->mirrored, lamps->mirrored, size)) ? -1 : lamps->mirrored_count;
}

float inside_farthest_offset(const sbl_context *context) {
    const sbl__refine *r = &context->picture.map.refine;
    float most = 0;
    int i;
    for (i = 0; i < r->width * r->height; i++) if (r->pixels[i].offset > most) most = r->pixels[i].offset;
    return most;
}

void inside_sample_offset(int sample, int samples, float offset[2]) { sbl__sample_offset(sample, samples, offset); }

uint16_t inside_to_half(float value) { return sbl__to_half(value); }

float inside_from_half(uint16_t half) { return sbl__from_half(half); }

uint64_t inside_saved_sum(const void *bytes, size_t count) { return sbl__hash_bytes(SBL__SAVED_SEED, bytes, count); }

int inside_gl_is_optional(const char *function) {
#define X(type, name, parameters) || strcmp(function, "gl" #name) == 0
    return 0 SBL__GL_OPTIONAL_FUNCTIONS(X);
#undef X
}

inside_weight inside_weigh_corners(int strips, float light) {
    enum { SIDE = 17 };
    static sbl__pixel pixels[SIDE * SIDE];
    sbl__sensor sensors[2], *block = sensors;  /* sensor 1 stands for all corners, which are alike */
    inside_weight weight;
    sbl__spec spec;
    sbl__refine r;
    sbl__tile c;
    int i, k;
    memset(&spec, 0, sizeof spec);
    spec.looks = 16;
    memset(&r, 0, sizeof r);
    r.shown2 = 1;
    memset(&c, 0, sizeof c);
    memset(pixels, 0, sizeof pixels);
    memset(sensors, 0, sizeof sensors);
    sensors[1].sensed = 1;
    sensors[1].looks = 1;
    sensors[1].variance = 100 * (double)light * (double)light;
    for (k = 0; k < 3; k++) sensors[1].radiance[k] = light;
    sbl__looks_calibrate(&r);
    r.width = r.height = SIDE;
    r.pixels = pixels;
    r.sensors = &block;
    r.target_error = 0.1f;
    r.luminance = r.smoothing = 1;
    r.spec = &spec;
    for (k = 0; k < 3; k++) r.weights[k] = r.mean[k] = 1;
    c.area.x[1] = c.area.y[1] = SIDE - 1;
    c.parent = -1;
    c.looks = 1;
    c.pixels = SIDE * SIDE;
    c.uncovered = strips ? 0.25f : 0;
    c.weight2 = 1;
    for (i = 0; i < SIDE * SIDE; i++) {
        sbl__pixel *p = &pixels[i];
        const int x = i % SIDE, y = i / SIDE;
        p->id = !strips || x < 4 ? 1 : x < 8 ? 2 : 3;
        p->position[0] = (float)x;
        p->position[1] = (float)y;
        p->position[2] = p->id == 1 ? 0 : 5;
        p->normal[2] = p->geometric_normal[2] = 1;
        p->sensor = !(x % (SIDE - 1) || y % (SIDE - 1));
    }
    r.tiles = &c;
    sbl__weigh_tile(&r, 0);
    weight.noise2 = c.noise2;
    weight.bias2 = c.bias2;
    weight.light = c.light;
    weight.split_gain = c.split_worth;
    return weight;
}

int inside_is_exact(float target, double sensors, double store) {
    static sbl__refine r;
    memset(&r, 0, sizeof r);
    r.shown2 = 1;
    r.target_error = target;
    r.luminance = 1;
    r.pixels_summed = 100;
    r.noise2 = 100 * sensors * sensors;
    r.uncertainty2 = 100 * store * store;
    sbl__weigh_end(&r);
    return !(r.least_worth < FLT_MAX);
}

double inside_bought(float target, double error2, const double gains[3]) {
    static sbl__refine r;
    double sum = 0;
    int i;
    memset(&r, 0, sizeof r);
    r.shown2 = 1;
    r.target_error = target;
    r.luminance = 1;
    r.pixels_summed = 100;
    r.noise2 = error2;
    for (i = 0; i < 3; i++) r.gains[200 - 40 * i] = gains[i];
    sbl__weigh_end(&r);
    for (i = 0; i < 3; i++)
        if (sbl__bin_worth(200 - 40 * i) >= r.least_worth) sum += gains[i];
    return sum;
}

double inside_price(float first, float second) {
    static sbl__refine r;
    int i;
    memset(&r, 0, sizeof r);
    r.shown2 = 1;
    r.target_error = 0.01f;
    r.luminance = 1;
    r.pixels_summed = 100;
    for (i = 0; i < 2; i++) {
        memset(r.gains, 0, sizeof r.gains);
        r.gains[sbl__worth_bin(i ? second : first)] = 1;
        r.noise2 = 1;
        sbl__weigh_end(&r);
    }
    return (double)r.price_paid;
}

static const char *const cast_main[] = {
    "uniform samplerBuffer rays;\n"
    "uniform int ray_count, width;\n"
    "layout(location = 0) out vec4 out_hit;\n"
    "void main() {\n"
    "    int i = int(gl_FragCoord.y) * width + int(gl_FragCoord.x);\n"
    "    if (i >= ray_count) discard;\n"
    "    sbl_Hit hit = sbl_trace(texelFetch(rays, 2 * i).xyz, texelFetch(rays, 2 * i + 1).xyz, 1e30,\n"
    "                            SBL_RAY_SOLID);\n"
    "    out_hit = vec4(hit.triangle < 0 ? -1 : hit.number, hit.distance, hit.b1, hit.b2);\n"
    "}\n", NULL };

static const sbl__recipe cast_recipe = {
    "hits", { sbl__glsl_fullscreen_vertex },
    { sbl__glsl_scene, sbl__glsl_frame, sbl__glsl_material, sbl__glsl_traverse, cast_main },
    { &sbl__object_record, &sbl__attributes_record, &sbl__node_record, &sbl__grid_node_record, &sbl__triangle_record },
    SBL__TEXTURED | SBL__CUTOUTS | SBL__WIDE };

int inside_cast(sbl_context *c, const float *rays, int count, traced_hit *hits) {
    enum { WIDTH = 1024 };
    sbl__device *d = &c->core.device;
    sbl__scene *scene = &c->core.scene;
    sbl__visit visit;
    sbl__slice slice = { 1e300, 1, 0 };
    sbl__table table = { { 0, 0 }, { 0, 0, 0, 0, 0 } };
    sbl__texture texture = { 0, 0, 0, 0, 0 };
    sbl__target target;
    int rows = (count + WIDTH - 1) / WIDTH;
    float *read = (float *)malloc((size_t)rows * WIDTH * 16);
    sbl_result result;
    if (!read) abort();
    memset(&target, 0, sizeof target);
    sbl__visit_enter(c, &visit);
    d->gl.doing = "casting rays";
    do result = sbl__scene_step(d, scene, &slice); while (result == SBL_UNFINISHED);
    if (result == SBL_SUCCESS)
        result = sbl__buffer_make(d, &table.buffer, (size_t)count * 32, rays, SBL__GL_STREAM_DRAW);
    if (result == SBL_SUCCESS) result = sbl__table_attach(d, &table, SBL__GL_RGBA32F, 0);
    if (result == SBL_SUCCESS) result = sbl__texture_make(d, &texture, WIDTH, rows, SBL__GL_RGBA32F);
    if (result == SBL_SUCCESS) result = sbl__target_make(d, &target, &texture, 1, NULL);
    if (result == SBL_SUCCESS) result = sbl__use(d, &cast_recipe, scene->features);
    if (result == SBL_SUCCESS) {
        sbl__pass(d, &target, NULL, NULL, 0);
        sbl__scene_bind(d, scene);
        sbl__hierarchy_bind(d, &scene->hierarchy);
        sbl__bind_table(d, "rays", &table);
        sbl__set_int(d, "ray_count", count);
        sbl__set_int(d, "width", WIDTH);
        sbl__draw_screen(d);
        result = sbl__target_read(d, &target, 0, 0, rows, read);
    }
    if (result == SBL_SUCCESS) memcpy(hits, read, (size_t)count * sizeof *hits);
    free(read);
    sbl__target_delete(d, &target);
    sbl__texture_delete(d, &texture);
    sbl__table_delete(d, &table);
    sbl__visit_leave(c, &visit);
    return result == SBL_SUCCESS;
}

int inside_triangle_count(const sbl_context *context) { return (int)context->core.scene.geometry.triangle_count; }

const float *inside_triangle_corner(const sbl_context *context, int triangle, int corner) {
    return sbl__triangle_corner(&context->core.scene.geometry, (uint32_t)triangle, corner);
}

int inside_node_count(const sbl_context *context) { return context->core.scene.hierarchy.node_count; }

float inside_pixel_offset(const sbl_context *context, size_t pixel) {
    return context->picture.map.refine.pixels[pixel].offset;
}

int inside_pixel_looks(const sbl_context *context, size_t pixel) {
    const sbl__refine *r = &context->picture.map.refine;
    return sbl__sensor_of(r, sbl__refine_pixel(r, pixel))->looks;
}

inside_source inside_replace_source(sbl_context *context, inside_source source) {
    const inside_source before = context->core.device.gl.ShaderSource;
    context->core.device.gl.ShaderSource = source;
    return before;
}

int inside_guard_units(void) { return SBL__GUARD_UNITS; }
