/* Tests of the material interface: for random materials, material.glsl and the C functions in the section >>material of
   sbl.h give the same values, and reflections and transmission follow their formulas. */
#include "support/private.h"
#include "support/test.h"
#include "support/scenes.h"
#include "support/gl_watch.h"
#include "support/lobe.h"

static watch seen;
static sbl_context *context;

enum { MATERIALS = 64 };

static const char *const material_shader[] = {
    "uniform vec3 light;\n"
    "layout(location = 0) out vec4 out_emission;\n"
    "layout(location = 1) out vec4 out_bounced;\n"
    "layout(location = 2) out vec4 out_reflected;\n"
    "void main() {\n"
    "    int object = int(gl_FragCoord.x);\n"
    "    bool back = gl_FragCoord.y > 1.0;\n"
    "    sbl_Material material = sbl_material(object, SBL_PLAIN);\n"
    "    out_emission = vec4(sbl_emission(object, back), sbl_emits(object, back));\n"
    "    out_bounced = vec4(sbl_bounced(material, vec3(1)), material.cut_out);\n"
    "    out_reflected = vec4(sbl_reflected(sbl_Material(sbl_bounced(material, vec3(1)), false), light), 0);\n"
    "}\n", 0 };

static const sbl__recipe material_recipe = { "material",
                                             { sbl__glsl_fullscreen_vertex },
                                             { sbl__glsl_scene, sbl__glsl_frame, sbl__glsl_material, material_shader },
                                             { &sbl__object_record },
                                             SBL__TEXTURED };

/* Returns a random number from 0 to 1. */
static double chance(uint32_t *state) {
    *state = *state * 747796405u + 2891336453u;
    return (test_hash(*state) + 0.5) / 4294967296.0;
}

/* Returns 0 in a fifth of the calls, `most` in a tenth, and a random number between them otherwise. */
static float any_of(uint32_t *state, float most) {
    const double x = chance(state);
    return x < 0.2 ? 0 : x < 0.3 ? most : most * (float)chance(state);
}

/* Surfaces that are not matte, with a vertex colour, seen at a grazing and at a steep angle */
static const char *const shiny_shader[] = {
    "layout(location = 0) out vec4 out_diffuse;\n"
    "layout(location = 1) out vec4 out_reflectance;\n"
    "layout(location = 2) out vec4 out_clear;\n"
    "layout(location = 3) out vec4 out_passing;\n"
    "layout(location = 4) out vec4 out_mirrored;\n"
    "layout(location = 5) out vec4 out_lobe;\n"
    "layout(location = 6) out vec4 out_glow;\n"
    "layout(location = 7) out vec4 out_albedo;\n"
    "void main() {\n"
    "    int object = int(gl_FragCoord.x);\n"
    "    float cosine = gl_FragCoord.y < 1.0 ? 0.25 : 0.8;\n"
    "    sbl_Attributes at = sbl_Attributes(vec2(0), vec4(1.0, 0.5, 0.75, 0.6));\n"
    "    sbl_Material m = sbl_material(object, at);\n"
    "    out_diffuse = vec4(m.diffuse, m.roughness);\n"
    "    out_reflectance = vec4(m.reflectance, m.opacity);\n"
    "    out_clear = vec4(m.clear, (sbl_is_strong(m, m.reflectance) ? 1 : 0) + (sbl_hit_as_gloss(m) ? 2 : 0));\n"
    "    out_passing = vec4(sbl_passing(object, m, -cosine), 0);\n"
    "    out_mirrored = vec4(sbl_mirror_reflectance(m, cosine), sbl_lobe_reflected(m, cosine, vec3(1)).g);\n"
    "    vec3 weight, normal = vec3(0, 0.6, 0.8), side = vec3(0, 0.8, -0.6);\n"
    "    sbl_Lobe l = sbl_lobe_of(normal, cosine * normal + sqrt(1.0 - cosine * cosine) * side, m.reflectance,\n"
    "                             max(m.roughness, 0.3));\n"
    "    vec3 way = sbl_lobe_sample(l, vec2(0.3, 0.7), weight);\n"
    "    sbl_Lobe low = sbl_lobe_of(normal, 0.995 * side - 0.1 * normal, m.reflectance, max(m.roughness, 0.3));\n"
    "    out_lobe = vec4(sbl_lobe_factor(l, way) * max(dot(way, normal), 0.0) /\n"
    "                    (SBL_PI * sbl_lobe_density(l, way)) - weight, sbl_lobe_density(low, normal) > 0.0 ? 0 : 1);\n"
    "    out_glow = vec4(sbl_glow_pattern(object, at), 0);\n"
    "    out_albedo = vec4(m.albedo, sbl_lobe_shown(m, cosine).g);\n"
    "    sbl_blur_by_normals(m, 0.9);\n"
    "    out_passing.a = m.roughness;\n"
    "}\n", 0 };

static const sbl__recipe shiny_recipe = { "shiny",
                                          { sbl__glsl_fullscreen_vertex },
                                          { sbl__glsl_scene, sbl__glsl_frame, sbl__glsl_lobe, sbl__glsl_material,
                                            shiny_shader },
                                          { &sbl__object_record },
                                          SBL__TEXTURED | SBL__CUTOUTS | SBL__SPECULAR };

/* Evaluates the materials of the scene in a shader with `count` outputs. The result has two rows of texels. */
static sbl_result shade_materials(const sbl__recipe *recipe, int count, const float light[3],
                                  float texels[][2 * MATERIALS][4]) {
    sbl__device *d = &context->core.device;
    sbl__texture textures[8];
    sbl__target target;
    sbl__visit visit;
    sbl_result result = SBL_SUCCESS;
    int i;
    memset(textures, 0, sizeof textures);
    memset(&target, 0, sizeof target);
    sbl__visit_enter(context, &visit);
    for (i = 0; i < count && result == SBL_SUCCESS; i++)
        result = sbl__texture_make(d, &textures[i], MATERIALS, 2, SBL__GL_RGBA32F);
    if (result == SBL_SUCCESS) result = sbl__target_make(d, &target, textures, count, NULL);
    if (result == SBL_SUCCESS) result = sbl__use(d, recipe, context->core.scene.features);
    if (result == SBL_SUCCESS) {
        sbl__pass(d, &target, NULL, NULL, 0);
        sbl__scene_bind(d, &context->core.scene);
        sbl__set_vec3(d, "light", light);
        sbl__draw_screen(d);
        result = sbl__gl_check(&d->gl);
    }
    for (i = 0; i < count && result == SBL_SUCCESS; i++) result = sbl__target_read(d, &target, i, 0, 2, texels[i]);
    sbl__target_delete(d, &target);
    for (i = 0; i < count; i++) sbl__texture_delete(d, &textures[i]);
    sbl__visit_leave(context, &visit);
    return result;
}

/* Makes a scene with a triangle of each material. */
static int use_materials(const sbl_material materials[MATERIALS]) {
    static const float corners[9] = { 0, 0, 0, 1, 0, 0, 0, 1, 0 };
    const sbl_context_desc desc = watch_desc(&seen);
    sbl_mesh meshes[MATERIALS];
    sbl_scene_desc scene;
    int i;
    memset(meshes, 0, sizeof meshes);
    memset(&scene, 0, sizeof scene);
    for (i = 0; i < MATERIALS; i++) {
        meshes[i].positions.data = corners;
        meshes[i].vertex_count = 3;
        meshes[i].material = i;
    }
    scene.materials = materials;
    scene.meshes = meshes;
    scene.material_count = scene.mesh_count = MATERIALS;
    if (!context && sbl_create(&desc, &context) != SBL_SUCCESS) context = NULL;
    return context && sbl_set_scene(context, &scene) == SBL_SUCCESS;
}

/* C and GLSL give the same emission, share of bounced light and reflection, to the bit or within rounding errors. */
TEST(materials_in_c_and_in_shaders) {
    static const float light[3] = { 0.5f, 3, 1000 };
    static float texels[3][2 * MATERIALS][4];
    sbl_material materials[MATERIALS];
    uint32_t state = 5;
    sbl_result result;
    int i, k, back, dark = 0, clamped = 0;
    memset(materials, 0, sizeof materials);
    for (i = 0; i < MATERIALS; i++) {
        for (k = 0; k < 3; k++) materials[i].albedo[k] = any_of(&state, 1);
        for (k = 0; k < 3 && i % 3; k++) materials[i].emission[k] = any_of(&state, 100);
        materials[i].flags = i & 1 ? SBL_MATERIAL_ONE_SIDED_EMISSION : 0;
    }
    REQUIRE(use_materials(materials), "no scene: %s", watch_last(&seen));
    result = shade_materials(&material_recipe, 3, light, texels);
    REQUIRE(result == SBL_SUCCESS, "%s: %s", sbl_result_string(result), watch_last(&seen));
    for (i = 0; i < MATERIALS; i++)
        for (back = 0; back < 2; back++) {
            const sbl__object *object = &context->core.scene.geometry.objects[i];
            const int at = back * MATERIALS + i;
            float emission[3], share[3], reflected[3] = { 0, 0, 0 };
            uint16_t packed[3];
            for (k = 0; k < 3; k++) {
                emission[k] = sbl__emits(object, back) ? object->emission[k] : 0;
                share[k] = SBL__MIN(object->albedo[k], SBL__BOUNCE_ALBEDO);
            }
            sbl__albedo_pack(share, packed);
            sbl__add_reflected(packed, light, reflected);
            CHECK(memcmp(emission, texels[0][at], sizeof emission) == 0,
                  "material %d, side %d: emission %g %g %g in C, %g %g %g in GLSL", i, back, (double)emission[0],
                  (double)emission[1], (double)emission[2], (double)texels[0][at][0], (double)texels[0][at][1],
                  (double)texels[0][at][2]);
            CHECK(sbl__emits(object, back) == (texels[0][at][3] != 0), "material %d, side %d: emits %d in C", i, back,
                  sbl__emits(object, back));
            CHECK(memcmp(share, texels[1][at], sizeof share) == 0, "material %d: share %g %g %g in C, %g %g %g in GLSL",
                  i, (double)share[0], (double)share[1], (double)share[2], (double)texels[1][at][0],
                  (double)texels[1][at][1], (double)texels[1][at][2]);
            CHECK(texels[1][at][3] == 0, "material %d is cut out", i);
            for (k = 0; k < 3; k++)
                CHECK(fabs((double)reflected[k] / (double)SBL__ALBEDO_ONE - (double)texels[2][at][k]) <=
                          (double)light[k] / 65535,
                      "material %d: component %d reflects %g in C, %g in GLSL", i, k,
                      (double)reflected[k] / (double)SBL__ALBEDO_ONE, (double)texels[2][at][k]);
            dark += back && !sbl__emits(object, 1) && sbl__emits(object, 0);
            clamped += share[0] < object->albedo[0];
        }
    CHECK(dark > 5 && clamped > 5, "%d one-sided emitters, %d clamped albedos", dark, clamped);
}

/* Returns Schlick's approximation. */
static double fresnel(double reflectance, double cosine) {
    return reflectance + (1 - reflectance) * pow(1 - cosine, 5);
}

/* Checks a colour of a material, and the number beside it. */
static void check_color(const char *name, int number, const float shown[4], const double expected[4]) {
    int k;
    for (k = 0; k < 4; k++)
        CHECK(fabs((double)shown[k] - expected[k]) < 1e-5, "material %d: %s[%d] is %g, not %g", number, name, k,
              (double)shown[k], expected[k]);
}

/* Checks the material at a texel of shiny_shader. color: albedo times vertex colour; row: 0: cosine 0.25; 1: 0.8 */
static void check_shiny(const sbl_material *m, const double color[3], int number, int row,
                        float texels[8][2 * MATERIALS][4]) {
    const double ior = m->ior > 0 ? (double)m->ior : 1.5, f0 = pow((ior - 1) / (ior + 1), 2), cosine = row ? 0.8 : 0.25;
    const int matte = !(m->ior > 0) && !(m->metallic > 0), at = row * MATERIALS + number;
    const double metallic = matte ? 0 : (double)m->metallic, opacity = m->flags & SBL_MATERIAL_BLEND ? 0.6 : 1;
    const double transmission = (double)m->transmission, rough = matte ? -1 : (double)m->roughness;
    const double variance = (1 - 0.81) / (0.9 * (3 - 0.81));
    double diffuse[4], reflectance[4], clear[4], passing[4], mirrored[4], lobe, most = 0;
    const double zero[4] = { 0, 0, 0, 0 };
    int k;
    for (k = 0; k < 3; k++) {
        const double base = matte ? 0 : f0;
        reflectance[k] = matte ? 0 : f0 + (color[k] - f0) * metallic;
        diffuse[k] = (1 - metallic) * (1 - base) * color[k] * opacity * (1 - transmission);
        clear[k] = (1 - metallic) * color[k] * opacity * transmission;
        passing[k] = 1 - opacity + (matte ? 1 : 1 - fresnel(f0, cosine)) * clear[k];
        mirrored[k] = opacity * fresnel(reflectance[k], cosine);
        most = fmax(most, reflectance[k]);
    }
    diffuse[3] = rough;
    reflectance[3] = opacity;
    clear[3] = matte ? 0 : most > 0.2 ? 1 : rough < 0.5 ? 2 : 0;
    passing[3] = matte ? -1 : fmin(pow(pow(rough, 4) + 2 * variance, 0.25), 1);
    mirrored[3] = (double)texels[4][at][3];
    lobe = opacity * lobe__albedo(cosine, fmax(rough, 0.05), reflectance[1], 96);
    CHECK(matte || (fabs(mirrored[3] - lobe) < 0.003 && fabs((double)texels[7][at][3] - lobe) < 0.003),
          "material %d: its lobe has the albedo %g, and shows %g, not %g", number, mirrored[3],
          (double)texels[7][at][3], lobe);
    check_color("diffuse", number, texels[0][at], diffuse);
    check_color("reflectance", number, texels[1][at], reflectance);
    check_color("clear", number, texels[2][at], clear);
    check_color("passing", number, texels[3][at], passing);
    check_color("mirrored", number, texels[4][at], mirrored);
    check_color("lobe", number, texels[5][at], zero);
}

/* Checks that the radiance of a glow in C, times its pattern in GLSL, is the light of R = 1 that the surface reflects:
   all of it or, for gloss, the part of the diffuse component. lost: mean fraction that the Fresnel term takes from the
   diffuse component */
static void check_glow(int number, double lost, float texels[8][2 * MATERIALS][4]) {
    static const float light[3] = { 1, 1, 1 };
    const int is_gloss = texels[2][number][3] > 1.5f;
    float radiance[3];
    int k;
    sbl__reflect(&context->core.scene.geometry.objects[number], light, radiance);
    for (k = 0; k < 3; k++) {
        const double wanted = is_gloss ? (1 - lost) * (double)texels[0][number][k] : (double)texels[7][number][k];
        const double shown = (double)radiance[k] * (double)texels[6][number][k];
        CHECK(fabs(shown - wanted) < 1e-5, "material %d: a glow has %g of the light, not %g", number, shown, wanted);
    }
}

/* Random materials that are not matte reflect, transmit and blend light by the formulas of the manual (ON REFLECTIONS).
   The weight of a direction that a lobe samples is its factor / its density, which is positive also for viewers whom an
   interpolated normal puts behind the surface. */
TEST(shiny_materials_follow_their_formulas) {
    static const float light[3] = { 0, 0, 0 };
    static const double tint[3] = { 1, 0.5, 0.75 };
    static float texels[8][2 * MATERIALS][4];
    sbl_material materials[MATERIALS];
    uint32_t state = 9;
    sbl_result result;
    double lost = 0;
    int i, k;
    memset(materials, 0, sizeof materials);
    for (i = 0; i < MATERIALS; i++) {
        for (k = 0; k < 3; k++) materials[i].albedo[k] = any_of(&state, 1);
        materials[i].metallic = any_of(&state, 1);
        materials[i].roughness = any_of(&state, 1);
        materials[i].transmission = any_of(&state, 1);
        materials[i].ior = chance(&state) < 0.7 ? 1 + any_of(&state, 2) : 0;
        materials[i].flags = chance(&state) < 0.4 ? SBL_MATERIAL_BLEND : 0;
    }
    REQUIRE(use_materials(materials), "no scene: %s", watch_last(&seen));
    result = shade_materials(&shiny_recipe, 8, light, texels);
    REQUIRE(result == SBL_SUCCESS, "%s: %s", sbl_result_string(result), watch_last(&seen));
    for (i = 0; i < 40; i++) lost += 2 * (i + 0.5) / 40 * (1 - lobe_matte((i + 0.5) / 40)) / 40;
    for (i = 0; i < MATERIALS; i++) {
        double color[3];
        check_glow(i, lost, texels);
        for (k = 0; k < 3; k++) color[k] = (double)materials[i].albedo[k] * tint[k];
        for (k = 0; k < 2; k++) check_shiny(&materials[i], color, i, k, texels);
    }
}

/* Objects differ if one of the fields differs that decide how they reflect light or let it pass, but not if only their
   emission or their normal map differs. A matte copy of a material has no lobe, and no light passes through it. */
TEST(changes_of_gloss_are_noticed) {
    static const size_t fields[] = { offsetof(sbl__object, reflectance), offsetof(sbl__object, metallic),
        offsetof(sbl__object, roughness), offsetof(sbl__object, transmission), offsetof(sbl__object, specular_texture),
        offsetof(sbl__object, transmission_texture), offsetof(sbl__object, albedo_texture),
        offsetof(sbl__object, alpha_cutoff) };
    static sbl__textures none;
    static uint32_t entry[4];
    sbl_material material, matte;
    sbl__object a, b;
    float brightest = 0;
    size_t i;
    memset(&a, 0, sizeof a);
    for (i = 0; i < sizeof fields / sizeof *fields; i++) {
        const float value = 0.25f;
        b = a;
        memcpy((char *)&b + fields[i], &value, sizeof value);
        CHECK(sbl__reflection_differs(&a, &b), "a change of field %d is no change", (int)i);
    }
    b = a;
    b.emission[1] = b.normal_scale = 1;
    b.flags = SBL_MATERIAL_ONE_SIDED_EMISSION;
    CHECK(!sbl__reflection_differs(&a, &b), "emission and normals change reflections");
    memset(&material, 0, sizeof material);
    material.ior = 1.5f;
    material.metallic = material.transmission = 0.5f;
    material.flags = SBL_MATERIAL_BLEND;
    matte = sbl__material_matte(&material);
    memset(&none, 0, sizeof none);
    none.entries = &entry;
    none.brightest = &brightest;
    CHECK(sbl__material_write(&none, &material, &a, &brightest) && sbl__is_specular(&a) && sbl__lets_pass(&a),
          "the material is matte");
    CHECK(!sbl__material_write(&none, &matte, &b, &brightest) && !sbl__is_specular(&b) && !sbl__lets_pass(&b),
          "the copy is not matte");
}

static const sbl_material black[MATERIALS];

/* What draws a picture of two pixels: a target, and a G-buffer of which all textures hold ones, except the ids. */
typedef struct two_pixels {
    sbl__visit visit;
    sbl__texture textures[5];  /* those of the target, of the ids and of ones, and up to two of the caller */
    sbl__target target;
    sbl__gbuffer g;
} two_pixels;

enum { OUT, IDS, ONES, FIRST };

/* Makes a texture of two texels. values: four numbers per texel, or two integers */
static sbl_result two_texels(sbl__texture *t, unsigned format, const void *values) {
    const sbl__device *d = &context->core.device;
    const sbl_result result = sbl__texture_make(d, t, 2, 1, format);
    return result == SBL_SUCCESS ? sbl__texture_write(d, t, 0, 1, values) : result;
}

/* Makes the textures, of which those from FIRST on hold `values`. two_pixels_end must follow, even after an error. */
static sbl_result two_pixels_begin(two_pixels *p, const float (*values)[8], int count) {
    static const float ones[8] = { 1, 1, 1, 1, 1, 1, 1, 1 };
    static const uint32_t ids[2] = { 1, 1 };
    sbl__device *d = &context->core.device;
    sbl_result result;
    int i;
    memset(p, 0, sizeof *p);
    sbl__visit_enter(context, &p->visit);
    result = sbl__texture_make(d, &p->textures[OUT], 2, 1, SBL__GL_RGBA32F);
    if (result == SBL_SUCCESS) result = sbl__target_make(d, &p->target, p->textures, 1, NULL);
    if (result == SBL_SUCCESS) result = two_texels(&p->textures[IDS], SBL__GL_R32UI, ids);
    if (result == SBL_SUCCESS) result = two_texels(&p->textures[ONES], SBL__GL_RGBA32F, ones);
    for (i = 0; i < count && result == SBL_SUCCESS; i++)
        result = two_texels(&p->textures[FIRST + i], SBL__GL_RGBA32F, values[i]);
    for (i = 0; i < SBL__GBUFFER_COUNT; i++) p->g.textures[i] = p->textures[i == SBL__GBUFFER_ID ? IDS : ONES];
    return result;
}

/* Reads the pixels if `result` is SBL_SUCCESS, and deletes everything. Returns the first error. */
static sbl_result two_pixels_end(two_pixels *p, sbl_result result, float out[2][4]) {
    sbl__device *d = &context->core.device;
    int i;
    if (result == SBL_SUCCESS) result = sbl__target_read(d, &p->target, 0, 0, 1, out[0]);
    sbl__target_delete(d, &p->target);
    for (i = 0; i < FIRST + 2; i++) sbl__texture_delete(d, &p->textures[i]);
    sbl__visit_leave(context, &p->visit);
    return result;
}

static const int two_pixels_area[4] = { 0, 0, 2, 1 }, two_pixels_rows[2] = { 0, 1 };

/* Composes two pixels with light of -1 and 3 in their lobes. offset: position of the sample beside the centres, in
   pixels. out: RADIANCE with emission and reflections */
static sbl_result compose(float offset, float out[2][4]) {
    static const float values[2][8] = { { 0.5f, 0.5f, 0.5f, 1, 0.5f, 0.5f, 0.5f, 1 },  /* albedo */
                                        { -1, -1, -1, 1, 3, 3, 3, 1 } };               /* light in the lobe */
    two_pixels p;
    sbl__camera camera;
    sbl__resolve r;
    sbl_result result = two_pixels_begin(&p, values, 2);
    memset(&camera, 0, sizeof camera);
    memset(&r, 0, sizeof r);
    camera.whole[0] = camera.whole[1] = camera.orthographic = 1;
    camera.whole_to_clip[0] = camera.whole_to_clip[5] = 1;
    p.g.textures[SBL__GBUFFER_ALBEDO] = p.textures[FIRST];
    r.centres = r.sample = &p.g;
    r.emission = r.radiance = r.previous = &p.textures[ONES];
    r.reflected = &p.textures[FIRST + 1];
    r.environment = &context->core.scene.environment;
    r.camera = &camera;
    r.count = 1;
    r.offset[0] = offset;
    r.backdrop = black[0].albedo;
    if (result == SBL_SUCCESS) result = sbl__resolve_draw(&context->core.device, &r, &p.target, two_pixels_area);
    return two_pixels_end(&p, result, out);
}

/* A pixel shows emission, albedo times R, and the light in its lobe. Noise can make the light in the lobe negative;
   negative light counts as 0. A sample between two pixels of a surface shows the mean of their light. */
TEST(lobes_take_no_light_away) {
    int i, beside;
    REQUIRE(use_materials(black), "no scene: %s", watch_last(&seen));
    for (beside = 0; beside < 2; beside++) {
        float out[2][4];
        const sbl_result result = compose(beside ? 0.5f : 0, out);
        REQUIRE(result == SBL_SUCCESS, "%s: %s", sbl_result_string(result), watch_last(&seen));
        for (i = 0; i < 6; i++)
            CHECK(fabs((double)out[i / 3][i % 3] - (i >= 3 ? 4.5 : beside ? 2.5 : 1.5)) < 1e-6,
                  "pixel %d shows %g", i / 3, (double)out[i / 3][i % 3]);
    }
}

/* Filters a layer of two pixels, which are 0 and 8, with R of 4 in both. */
static sbl_result smooth(int is_group, float out[2][4]) {
    static const float values[2][8] = { { 4, 4, 4, 1e-3f, 4, 4, 4, 1e-3f }, { 0, 0, 0, 0, 8, 8, 8, 0 } };
    two_pixels p;
    sbl__filter f;
    sbl_result result = two_pixels_begin(&p, values, 2);
    memset(&f, 0, sizeof f);
    f.radius = 2;
    f.radiance = &p.textures[FIRST];
    f.layer = &p.textures[FIRST + 1];
    f.is_group = is_group;
    if (result == SBL_SUCCESS)
        result = sbl__filter_draw(&context->core.device, &f, &p.g, &p.target, two_pixels_rows);
    return two_pixels_end(&p, result, out);
}

/* A light group is filtered with the weights of R: by the Gaussian alone where R is equal. A harmonic keeps a
   difference that is far above its noise. */
TEST(groups_are_filtered_as_the_whole) {
    const double beside = exp(-0.5), blurred = 8 * beside / (1 + beside);
    int is_group, i;
    REQUIRE(use_materials(black), "no scene: %s", watch_last(&seen));
    for (is_group = 0; is_group < 2; is_group++) {
        float out[2][4];
        const sbl_result result = smooth(is_group, out);
        REQUIRE(result == SBL_SUCCESS, "%s: %s", sbl_result_string(result), watch_last(&seen));
        for (i = 0; i < 2; i++) {
            const double expected = is_group ? (i ? 8 - blurred : blurred) : 8 * i;
            CHECK(fabs((double)out[i][0] - expected) < 1e-4, "pixel %d is %g, not %g", i, (double)out[i][0], expected);
        }
    }
}

int main(void) {
    RUN(materials_in_c_and_in_shaders);
    RUN(shiny_materials_follow_their_formulas);
    RUN(changes_of_gloss_are_noticed);
    RUN(lobes_take_no_light_away);
    RUN(groups_are_filtered_as_the_whole);
    sbl_destroy(context);
    return test_report();
}
