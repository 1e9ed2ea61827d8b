/* The Cornell box as arrays: 16 quads, each of two triangles, with the measurements in millimetres and the camera that
   the Cornell University Program of Computer Graphics published. The colours and the lamp are approximated in RGB.
   Include after sbl.h. */
#ifndef CORNELL_BOX_H
#define CORNELL_BOX_H

#include <math.h>
#include <string.h>

enum { CORNELL_QUADS = 16, CORNELL_TRIANGLES = 32 };
enum { CORNELL_WHITE, CORNELL_RED, CORNELL_GREEN, CORNELL_LAMP, CORNELL_MATERIALS };

/* The corners of each quad, counter-clockwise as seen from inside the room. */
static const float cornell_corners[CORNELL_QUADS][12] = {
    { 552.8f, 0, 0,  0, 0, 0,  0, 0, 559.2f,  549.6f, 0, 559.2f },                                          /* floor */
    /* lamp, 0.1 mm below the ceiling */
    { 343, 548.7f, 227,  343, 548.7f, 332,  213, 548.7f, 332,  213, 548.7f, 227 },
    /* ceiling */
    { 556, 548.8f, 0,  556, 548.8f, 559.2f,  0, 548.8f, 559.2f,  0, 548.8f, 0 },
    /* back wall */
    { 549.6f, 0, 559.2f,  0, 0, 559.2f,  0, 548.8f, 559.2f,  556, 548.8f, 559.2f },
    /* right wall */
    { 0, 0, 559.2f,  0, 0, 0,  0, 548.8f, 0,  0, 548.8f, 559.2f },
    /* left wall */
    { 552.8f, 0, 0,  549.6f, 0, 559.2f,  556, 548.8f, 559.2f,  556, 548.8f, 0 },
    /* short block: top, then four sides */
    { 130, 165, 65,  82, 165, 225,  240, 165, 272,  290, 165, 114 },
    { 290, 0, 114,  290, 165, 114,  240, 165, 272,  240, 0, 272 },
    { 130, 0, 65,  130, 165, 65,  290, 165, 114,  290, 0, 114 },
    { 82, 0, 225,  82, 165, 225,  130, 165, 65,  130, 0, 65 },
    { 240, 0, 272,  240, 165, 272,  82, 165, 225,  82, 0, 225 },
    /* tall block: top, then four sides */
    { 423, 330, 247,  265, 330, 296,  314, 330, 456,  472, 330, 406 },
    { 423, 0, 247,  423, 330, 247,  472, 330, 406,  472, 0, 406 },
    { 472, 0, 406,  472, 330, 406,  314, 330, 456,  314, 0, 456 },
    { 314, 0, 456,  314, 330, 456,  265, 330, 296,  265, 0, 296 },
    { 265, 0, 296,  265, 330, 296,  423, 330, 247,  423, 0, 247 }
};

static const float cornell_albedo[CORNELL_MATERIALS][3] = { { 0.75f, 0.75f, 0.75f }, { 0.6f, 0.1f, 0.1f },
    { 0.1f, 0.6f, 0.1f }, { 0.75f, 0.75f, 0.75f } };
static const float cornell_lamp[3] = { 17, 12, 4 };

static inline int cornell_material(int quad) {
    return quad == 1 ? CORNELL_LAMP : quad == 4 ? CORNELL_GREEN : quad == 5 ? CORNELL_RED : CORNELL_WHITE;
}

/* The scene for sbl_set_scene, which copies it. Each quad is a mesh of its own, because SBL_MODE_PAPER filters each
   polygon separately. */
typedef struct cornell_box {
    sbl_mesh meshes[CORNELL_QUADS];
    sbl_material materials[CORNELL_MATERIALS];
    sbl_scene_desc scene;
} cornell_box;

static inline const sbl_scene_desc *cornell_box_make(cornell_box *box) {
    static const unsigned short corners[6] = { 0, 1, 2, 0, 2, 3 };
    int i;
    memset(box, 0, sizeof *box);
    for (i = 0; i < CORNELL_QUADS; i++) {
        sbl_mesh *mesh = &box->meshes[i];
        mesh->positions.data = cornell_corners[i];
        mesh->vertex_count = 4;
        mesh->indices.data = corners;
        mesh->indices.type = SBL_UINT16;
        mesh->index_count = 6;
        mesh->material = cornell_material(i);
    }
    for (i = 0; i < CORNELL_MATERIALS; i++)
        memcpy(box->materials[i].albedo, cornell_albedo[i], sizeof cornell_albedo[i]);
    memcpy(box->materials[CORNELL_LAMP].emission, cornell_lamp, sizeof cornell_lamp);
    box->scene.meshes = box->meshes;
    box->scene.mesh_count = CORNELL_QUADS;
    box->scene.materials = box->materials;
    box->scene.material_count = CORNELL_MATERIALS;
    return &box->scene;
}

/* Sets the published camera, with a focal length of 35 mm and a film of 25 mm. The longer side of the picture gets its
   angle of view, so that the box fills the picture. */
static inline void cornell_box_view(sbl_picture_desc *view, int width, int height) {
    double aspect = (double)width / height, degrees = 45 / atan(1.0);
    view->width = width;
    view->height = height;
    sbl_look_at(view->world_to_view, 278, 273, -800, 278, 273, 0, 0, 1, 0);
    sbl_perspective(view->view_to_clip, (float)(2 * degrees * atan(12.5 / 35 / (aspect > 1 ? aspect : 1))),
                    (float)aspect);
}

#endif
