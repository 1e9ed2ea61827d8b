/* Tests of the material interface: for random materials, material.glsl and the C functions in the section >>material of
   sbl.h give the same values. */
#include "support/private.h"
#include "support/test.h"
#include "support/scenes.h"
#include "support/gl_watch.h"

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

/* Evaluates the materials of the scene in a shader. The result has two rows of texels: front sides and back sides. */
static sbl_result shade_materials(const float light[3], float texels[3][2 * MATERIALS][4]) {
    sbl__device *d = &context->core.device;
    sbl__texture textures[3];
    sbl__target target;
    sbl__visit visit;
    sbl_result result = SBL_SUCCESS;
    int i;
    memset(textures, 0, sizeof textures);
    memset(&target, 0, sizeof target);
    sbl__visit_enter(context, &visit);
    for (i = 0; i < 3 && result == SBL_SUCCESS; i++)
        result = sbl__texture_make(d, &textures[i], MATERIALS, 2, SBL__GL_RGBA32F);
    if (result == SBL_SUCCESS) result = sbl__target_make(d, &target, textures, 3, NULL);
    if (result == SBL_SUCCESS) result = sbl__use(d, &material_recipe, context->core.scene.features);
    if (result == SBL_SUCCESS) {
        sbl__pass(d, &target, NULL, NULL, 0);
        sbl__scene_bind(d, &context->core.scene);
        sbl__set_vec3(d, "light", light);
        sbl__draw_screen(d);
        result = sbl__gl_check(&d->gl);
    }
    for (i = 0; i < 3 && result == SBL_SUCCESS; i++) result = sbl__target_read(d, &target, i, 0, 2, texels[i]);
    sbl__target_delete(d, &target);
    for (i = 0; i < 3; i++) sbl__texture_delete(d, &textures[i]);
    sbl__visit_leave(context, &visit);
    return result;
}

/* C and GLSL give the same emission, share of bounced light and reflection, to the bit or within rounding errors. */
TEST(materials_in_c_and_in_shaders) {
    static const float corners[9] = { 0, 0, 0, 1, 0, 0, 0, 1, 0 }, light[3] = { 0.5f, 3, 1000 };
    static float texels[3][2 * MATERIALS][4];
    const sbl_context_desc desc = watch_desc(&seen);
    sbl_material materials[MATERIALS];
    sbl_mesh meshes[MATERIALS];
    sbl_scene_desc scene;
    uint32_t state = 5;
    sbl_result result;
    int i, k, back, dark = 0, clamped = 0;
    memset(materials, 0, sizeof materials);
    memset(meshes, 0, sizeof meshes);
    memset(&scene, 0, sizeof scene);
    for (i = 0; i < MATERIALS; i++) {
        for (k = 0; k < 3; k++) materials[i].albedo[k] = any_of(&state, 1);
        for (k = 0; k < 3 && i % 3; k++) materials[i].emission[k] = any_of(&state, 100);
        materials[i].flags = i & 1 ? SBL_MATERIAL_ONE_SIDED_EMISSION : 0;
        meshes[i].positions.data = corners;
        meshes[i].vertex_count = 3;
        meshes[i].material = i;
    }
    scene.materials = materials;
    scene.meshes = meshes;
    scene.material_count = scene.mesh_count = MATERIALS;
    if (!context && sbl_create(&desc, &context) != SBL_SUCCESS) context = NULL;
    REQUIRE(context && sbl_set_scene(context, &scene) == SBL_SUCCESS, "no scene: %s", watch_last(&seen));
    result = shade_materials(light, texels);
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

int main(void) {
    RUN(materials_in_c_and_in_shaders);
    sbl_destroy(context);
    return test_report();
}
