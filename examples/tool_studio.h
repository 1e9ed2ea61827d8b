/* Lights scenes that have no light with a studio, and defines a backdrop for scenes that have light but no sky. Include
   after tool_scene.h, tool_survey.h and tool_camera.h.

   An object stands on a large grey ground. The sky is bright at the zenith and fades towards the horizon, and a wide
   sun shines from the upper left behind the camera. From the horizon down, the sky has the radiance of the ground, so
   that the edge of the ground is invisible. A white surface that faces the sun is about four times as bright as the
   background. A scene that is seen from inside gets no sun and no ground, but a wide lamp in mid-air, which the camera
   does not see, and the light of the sky.

   The ground is added after the meshes and materials of the file, with a greater index and id, so that the file's own
   keep theirs. The camera and the bounds that it needs are computed before. */
#ifndef TOOL_STUDIO_H
#define TOOL_STUDIO_H

#include <math.h>

/* The values are R, radiance or albedo in red, green and blue. */
static const double studio__sun[3] = { 0.68, 0.66, 0.63 };     /* R of a surface that faces the sun */
static const double studio__zenith[3] = { 0.60, 0.63, 0.68 };  /* radiance at the zenith */
static const double studio__ground[3] = { 0.205, 0.2, 0.19 };  /* albedo */
static const double studio__lamp[3] = { 0.80, 0.77, 0.72 };    /* R of a surface that faces the lamp, at half the
                                                                  distance of the surfaces in view */
#define STUDIO__SUN_HEIGHT 0.75  /* sine of the elevation of the sun */
#define STUDIO__SUN_LEFT 0.9     /* radians from the direction behind the camera to the sun, seen from above */
#define STUDIO__SUN_ANGLE 8.0f   /* angular diameter in degrees, which makes soft shadows */

typedef struct studio {
    double horizon[3];           /* radiance of the sky from the horizon down, and of the ground far away */
    sbl_light light;             /* the sun or the lamp */
    sbl_mesh *meshes;            /* the meshes of the file and the ground; NULL without a ground */
    sbl_material *materials;
    float corners[12];           /* corners of the ground */
} studio;

/* The radiance behind a scene that has lights but no sky, at the lower edge of a .png. It lights nothing; see
   sbl_picture_desc. */
static const float studio_backdrop[3] = { 0.1f, 0.1f, 0.1f };

/* Returns the weight of the zenith in the radiance of the sky: 0 at the horizon, 1 at the zenith. The slope at the
   horizon is 0, so that no line is visible there. h: sine of the elevation */
static double studio__fade(double h) { return h > 0 ? h * h * (3 - 2 * h) : 0; }

static void studio__sky(const float direction[3], float radiance[3], void *user) {
    const studio *s = (const studio *)user;
    const double fade = studio__fade((double)direction[1]);
    int k;
    for (k = 0; k < 3; k++) radiance[k] = (float)(s->horizon[k] + (studio__zenith[k] - s->horizon[k]) * fade);
}

/* Computes the radiance h of the ground far away from the object, where it receives light from the sun and the complete
   sky. The sky has the same radiance h at the horizon:

       h = albedo (sun * height + 2 integral of (h + (zenith - h) fade(x)) x dx), x from 0 to 1,
       where 2 integral of fade(x) x dx is 0.7 */
static void studio__match(studio *s) {
    int k;
    for (k = 0; k < 3; k++)
        s->horizon[k] = studio__ground[k] * (studio__sun[k] * STUDIO__SUN_HEIGHT + 0.7 * studio__zenith[k]) /
                        (1 - 0.3 * studio__ground[k]);
}

/* Sets the sun. view: the camera as chosen without the options. Since options do not move the sun, pictures of a scene
   from several sides have the same light, and share their stored bounced light. */
static void studio__set_sun(studio *s, const camera_view *view) {
    const double pi = 4 * atan(1.0), level = sqrt(1 - STUDIO__SUN_HEIGHT * STUDIO__SUN_HEIGHT);
    const double *way = fabs(view->forward[1]) < 0.99 * sqrt(view->forward[0] * view->forward[0] + view->forward[1] *
        view->forward[1] + view->forward[2] * view->forward[2]) ? view->forward : view->up;
    const double turn = atan2(way[0], way[2]) - STUDIO__SUN_LEFT;  /* light travels forward and right */
    int k;
    s->light.kind = SBL_LIGHT_DIRECTIONAL;
    s->light.angle = STUDIO__SUN_ANGLE;
    s->light.direction[0] = (float)(level * sin(turn));
    s->light.direction[1] = (float)-STUDIO__SUN_HEIGHT;
    s->light.direction[2] = (float)(level * cos(turn));
    for (k = 0; k < 3; k++) s->light.intensity[k] = (float)(pi * studio__sun[k]);
}

/* Sets the lamp of a room. space: distance to the nearest surface, which the lamp does not reach; view: distance of the
   surfaces in view */
static void studio__set_lamp(studio *s, const double position[3], double space, double view) {
    const double pi = 4 * atan(1.0), distance = 0.5 * view;
    int k;
    s->light.kind = SBL_LIGHT_POINT;
    s->light.radius = (float)(0.3 * space);
    for (k = 0; k < 3; k++) {
        s->light.position[k] = (float)position[k];
        s->light.intensity[k] = (float)(pi * studio__lamp[k] * distance * distance);
    }
}

/* ---- the ground of a studio ---- */

static void studio__corner(const sbl_mesh *mesh, int number, double out[3]) {
    const float *p = (const float *)mesh->positions.data + 3 * (size_t)((const uint32_t *)mesh->indices.data)[number];
    const float *t = mesh->transform;
    int i, placed = 0;
    for (i = 0; i < 16; i++) placed = placed || t[i] < 0 || t[i] > 0;
    for (i = 0; i < 3; i++)
        out[i] = !placed ? (double)p[i] : (double)t[i] * (double)p[0] + (double)t[4 + i] * (double)p[1] +
                                          (double)t[8 + i] * (double)p[2] + (double)t[12 + i];
}

/* Returns 1 if the scene has its own ground: triangles at its lowest height that face up cover at least half of its
   extent, seen from above. */
static int studio__has_ground(const sbl_scene_desc *scene, const survey *v) {
    const double top = (double)v->bounds.lowest[1] + 0.01 * survey__size(v, 1);
    const double extent = survey__size(v, 0) * survey__size(v, 2);
    double area = 0, p[3][3];
    int i, k, corner;
    for (i = 0; i < scene->mesh_count; i++)
        for (k = 0; k + 2 < scene->meshes[i].index_count; k += 3) {
            for (corner = 0; corner < 3; corner++) studio__corner(&scene->meshes[i], k + corner, p[corner]);
            if (p[0][1] > top || p[1][1] > top || p[2][1] > top) continue;
            area += fmax(0, 0.5 * ((p[1][2] - p[0][2]) * (p[2][0] - p[0][0]) -
                                   (p[1][0] - p[0][0]) * (p[2][2] - p[0][2])));
        }
    return area > 0.5 * extent;
}

/* Adds the ground to the scene: a square, larger than the object and its shadow. It is slightly below the lowest point,
   so that it does not coincide with an underside. Returns 0 if memory runs out. */
static int studio__add_ground(studio *s, sbl_scene_desc *scene, const survey *v) {
    static const unsigned char square[] = { 0, 1, 2, 0, 2, 3 };
    const size_t meshes = (size_t)scene->mesh_count, materials = (size_t)scene->material_count;
    const double half = 0.5 * sqrt(pow(survey__size(v, 0), 2) + pow(survey__size(v, 2), 2));
    const double size = 1.5 * half + 3.5 * survey__size(v, 1);
    const double height = (double)v->bounds.lowest[1] - 0.001 * survey__radius(v);
    int i, k;
    s->meshes = (sbl_mesh *)calloc(meshes + 1, sizeof *s->meshes);
    s->materials = (sbl_material *)calloc(materials + 1, sizeof *s->materials);
    if (!s->meshes || !s->materials) return 0;
    memcpy(s->meshes, scene->meshes, meshes * sizeof *s->meshes);
    memcpy(s->materials, scene->materials, materials * sizeof *s->materials);
    for (i = 0; i < 4; i++) {  /* counter-clockwise, as seen from above */
        s->corners[3 * i] = (float)(survey__center(v, 0) + (i < 2 ? -size : size));
        s->corners[3 * i + 1] = (float)height;
        s->corners[3 * i + 2] = (float)(survey__center(v, 2) + (i == 1 || i == 2 ? size : -size));
    }
    s->meshes[meshes].positions.data = s->corners;
    s->meshes[meshes].vertex_count = 4;
    s->meshes[meshes].indices.data = square;
    s->meshes[meshes].indices.type = SBL_UINT8;
    s->meshes[meshes].index_count = 6;
    s->meshes[meshes].material = scene->material_count;
    s->meshes[meshes].id = 1;
    for (i = 0; i < scene->mesh_count; i++) {
        const uint32_t id = scene->meshes[i].id ? scene->meshes[i].id : (uint32_t)i + 1;
        if (id >= s->meshes[meshes].id) s->meshes[meshes].id = id + 1;
    }
    for (k = 0; k < 3; k++) s->materials[materials].albedo[k] = (float)studio__ground[k];
    scene->meshes = s->meshes;
    scene->mesh_count++;
    scene->materials = s->materials;
    scene->material_count++;
    return 1;
}

/* ---- the studio ---- */

static void studio_free(studio *s) {
    free(s->meshes);
    free(s->materials);
}

/* Replaces the lights and the sky of the scene by a studio; emitting surfaces stay. Returns a description of the new
   light, or NULL if memory runs out. The studio must exist as long as the scene is used. v: the survey of the scene.
   view: the camera as chosen without the options. eye: the final position of the camera. enclosed: 0 if the camera is
   in the open, otherwise the mean distance of the surfaces around it */
static const char *studio_light(studio *s, sbl_scene_desc *scene, const survey *v, const camera_view *view,
                                const double eye[3], double enclosed) {
    const int inside = v->kind != SURVEY_OBJECT || enclosed > 0;
    int k;
    memset(s, 0, sizeof *s);
    studio__match(s);
    for (k = 0; k < 3; k++) scene->sky[k] = 0;
    memset(&scene->environment, 0, sizeof scene->environment);
    scene->environment.radiance = studio__sky;
    scene->environment.user = s;
    scene->environment.picture.width = 16;
    scene->environment.picture.height = 256;
    scene->lights = &s->light;
    scene->light_count = 1;
    if (v->kind != SURVEY_OBJECT) studio__set_lamp(s, v->middle, v->free, v->far);
    else if (inside) studio__set_lamp(s, eye, 0.1 * enclosed, enclosed);
    else studio__set_sun(s, view);
    if (inside) return "a studio sky and a lamp inside";
    if (!(survey__radius(v) > 0) || studio__has_ground(scene, v) || eye[1] <= (double)v->bounds.lowest[1])
        return "a studio sky and a sun";
    return studio__add_ground(s, scene, v) ? "a studio sky, a sun and a ground" : NULL;
}

static studio studio_of_tool;  /* the scene refers to it until the program ends */

/* Sets the scene again with the light of a studio. Returns the exit status. chosen: the camera without the options.
   eye: the final position of the camera. by_option: 1 if an option asked for the studio, so that no note mentions it */
static int studio_set(tool_task *task, sbl_scene_desc *scene, const survey *s, const camera_view *chosen,
                      const double eye[3], int by_option) {
    const char *words = NULL;
    double enclosed = 0;
    sbl_result result = SBL_SUCCESS;
    if (s->kind == SURVEY_OBJECT) result = survey_enclosed(task->context, eye, &enclosed);
    if (result == SBL_SUCCESS) {
        words = studio_light(&studio_of_tool, scene, s, chosen, eye, enclosed);
        task->said->warnings_kept = 0;  /* the warnings are repeated when the scene is set again */
        result = words ? sbl_set_scene(task->context, scene) : SBL_ERROR_OUT_OF_MEMORY;
    }
    if (words) detail("light: %s", words);
    if (!by_option) task->light = words;
    return result == SBL_SUCCESS ? DONE
         : result == SBL_UNFINISHED ? stop("no " TOOL_MAKES " was started")
                                    : fail_with(task->said, common.scene, result);
}

#endif
