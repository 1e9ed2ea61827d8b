/* Rooms with mirrors, metal, gloss and panes, made from a seed: a bathroom, a living room or a kitchen, in turn for
   each pair of seeds. Include after bench_furnished.h.
       gloss_room r = { 0 };
       gloss_room_make(&r, seed, 128, 96);
       ... r.made.scene, r.made.view ... gloss_room_free(&r);
   Mirrors and panes are rectangles, each a mesh of its own. */
#ifndef BENCH_GLOSS_ROOMS_H
#define BENCH_GLOSS_ROOMS_H

typedef struct gloss_room {
    furnished made;
    unsigned char smooth[FURNISHED_MESHES];  /* 1: interpolated normals; 2 or more: 2 + 100 times the coverage alpha */
    float *normals, *colors;
    sbl_light lights[4];
} gloss_room;

/* >>materials. Each function begins an object. */

static sbl_material *gloss_begin(gloss_room *r, double red, double green, double blue, double x, double z) {
    double rgb[3];
    rgb[0] = red; rgb[1] = green; rgb[2] = blue;
    furnished_begin(&r->made, rgb, x, z, 0);
    return &r->made.materials[r->made.scene.mesh_count - 1];
}
static void gloss_matte(gloss_room *r, double red, double green, double blue) {
    gloss_begin(r, red, green, blue, 0, 0);
}

/* Begins an object of plastic, paint or tiles. roughness: below 0.05: a mirror reflection is added to the colour */
static void gloss_coat(gloss_room *r, double red, double green, double blue, double roughness) {
    sbl_material *m = gloss_begin(r, red, green, blue, 0, 0);
    m->ior = 1.5f;
    m->roughness = (float)roughness;
}
static void gloss_metal(gloss_room *r, double red, double green, double blue, double roughness) {
    sbl_material *m = gloss_begin(r, red, green, blue, 0, 0);
    m->metallic = 1;
    m->roughness = (float)roughness;
}
static void gloss_chrome(gloss_room *r, double roughness) { gloss_metal(r, 0.55, 0.56, 0.56, roughness); }
static void gloss_glass(gloss_room *r, double transmission) {
    sbl_material *m = gloss_begin(r, 0.95, 0.98, 0.96, 0, 0);
    m->ior = 1.5f;
    m->transmission = (float)transmission;
}

/* Begins a blended pane; alpha: its coverage */
static void gloss_blended(gloss_room *r, double red, double green, double blue, double alpha) {
    sbl_material *m = gloss_begin(r, red, green, blue, 0, 0);
    m->ior = 1.5f;
    m->flags = SBL_MATERIAL_BLEND;
    r->smooth[r->made.scene.mesh_count - 1] = (unsigned char)(2 + 100 * alpha);
}
static void gloss_glow(gloss_room *r, double radiance) {
    sbl_material *m = gloss_begin(r, 0, 0, 0, 0, 0);
    m->emission[0] = (float)radiance;
    m->emission[1] = (float)(0.88 * radiance);
    m->emission[2] = (float)(0.7 * radiance);
}

/* >>shapes */

static void gloss_smooth(gloss_room *r) { r->smooth[r->made.scene.mesh_count - 1] = 1; }
static void gloss_move(gloss_room *r, double x, double z) { r->made.at[0] = x; r->made.at[2] = z; }

/* Adds a rectangle that is perpendicular to an axis and crosses it at `at`. a0, b0, a1, b1: its bounds on the next two
   axes in cyclic order, lower ones first */
static void gloss_plate(gloss_room *r, int axis, double at, double a0, double b0, double a1, double b1) {
    const sbl_material *m = &r->made.materials[r->made.scene.mesh_count - 1];
    const double piece = r->made.piece;
    double low[2], high[2];
    low[0] = a0; low[1] = b0; high[0] = a1; high[1] = b1;
    if (m->roughness < 0.05f && (m->ior > 0 || m->metallic > 0)) r->made.piece = 0;  /* a mirror remains whole */
    furnished_rectangle(&r->made, axis, at, low, high);
    r->made.piece = piece;
}

/* Adds a tube along an arc about a centre, from angle `from` to `to`, in the plane that is perpendicular to an axis.
   radii: of the arc and of the tube */
static void gloss_tube(gloss_room *r, const double centre[3], const double radii[2], double from, double to, int axis) {
    enum { SLICES = 16, STEPS = 20 };
    const int across = axis == 0 ? 2 : 0;  /* the arc lies in the plane of y and this axis */
    int i, j, c;
    for (i = 0; i < STEPS; i++)
        for (j = 0; j < SLICES; j++) {
            double corners[4][3];
            for (c = 0; c < 4; c++) {
                const double turn = from + (to - from) * (i + (c > 1)) / STEPS;
                const double around = 2 * REF_PI * ((j + (c == 1 || c == 2)) % SLICES) / SLICES;
                const double away = radii[0] + radii[1] * cos(around);
                corners[c][across] = centre[across] + away * cos(turn);
                corners[c][1] = centre[1] + away * sin(turn);
                corners[c][axis] = centre[axis] + radii[1] * sin(around);
            }
            furnished_quad(&r->made, corners);
        }
    gloss_smooth(r);
}

/* Adds a straight tube, which begins at x, y, z and extends by `length` along axis 0 or 2. */
static void gloss_rod(gloss_room *r, double x, double y, double z, double length, double radius, int axis) {
    enum { SLICES = 16 };
    int j, c;
    for (j = 0; j < SLICES; j++) {
        double corners[4][3];
        for (c = 0; c < 4; c++) {
            const double around = 2 * REF_PI * ((j + (c == 1 || c == 2)) % SLICES) / SLICES;
            corners[c][0] = x; corners[c][1] = y + radius * sin(around); corners[c][2] = z;
            corners[c][axis] += c > 1 ? length : 0;
            corners[c][2 - axis] += radius * cos(around);
        }
        furnished_quad(&r->made, corners);
    }
    gloss_smooth(r);
}

static void gloss_post(gloss_room *r, double x, double z, double y0, double y1, double radius) {
    double profile[2][2];
    profile[0][0] = profile[1][0] = radius;
    profile[0][1] = y0; profile[1][1] = y1;
    gloss_move(r, x, z);
    furnished_lathe(&r->made, profile, 2, 16);
    gloss_move(r, 0, 0);
    gloss_smooth(r);
}

static void gloss_ball(gloss_room *r, double x, double y, double z, double radius) {
    gloss_move(r, x, z);
    furnished_ball(&r->made, y, radius, 24, 40);
    gloss_move(r, 0, 0);
    gloss_smooth(r);
}

static void gloss_box(gloss_room *r, double x0, double y0, double z0, double x1, double y1, double z1) {
    furnished_box(&r->made, x0, y0, z0, x1, y1, z1);
}

/* Adds a bowl; y: height of its rim */
static void gloss_bowl(gloss_room *r, double x, double y, double z, double radius, double depth) {
    double profile[14][2];
    int i;
    for (i = 0; i < 12; i++) {
        profile[i][0] = i ? radius * sin(REF_PI / 2 * i / 11) : 0;
        profile[i][1] = y - depth * cos(REF_PI / 2 * i / 11);
    }
    profile[12][0] = 1.08 * radius; profile[12][1] = y + 0.004;
    profile[13][0] = 0.6 * radius; profile[13][1] = y - depth - 0.03;
    gloss_move(r, x, z);
    furnished_lathe(&r->made, profile, 14, 40);
    gloss_move(r, 0, 0);
    gloss_smooth(r);
}

static double gloss_between(gloss_room *r, double low, double high) { return furnished_between(&r->made, low, high); }

static void gloss_camera(gloss_room *r, double x, double y, double z, double ax, double ay, double az, double fov) {
    sbl_picture_desc *v = &r->made.view;
    sbl_look_at(v->world_to_view, (float)x, (float)y, (float)z, (float)ax, (float)ay, (float)az, 0, 1, 0);
    sbl_perspective(v->view_to_clip, (float)fov, (float)v->width / (float)v->height);
}

/* >>rooms */

/* Adds a tap: a post, a bent spout towards +z, and two handles. */
static void gloss_tap(gloss_room *r, double x, double y, double z, double roughness) {
    double centre[3], radii[2] = { 0.08, 0.015 };
    gloss_chrome(r, roughness);
    gloss_post(r, x, z, y, y + 0.24, 0.015);
    centre[0] = x; centre[1] = y + 0.24; centre[2] = z + 0.08;
    gloss_tube(r, centre, radii, 0, REF_PI, 0);
    gloss_post(r, x - 0.09, z, y, y + 0.12, 0.015);
    gloss_post(r, x + 0.09, z, y, y + 0.12, 0.015);
    gloss_ball(r, x - 0.09, y + 0.14, z, 0.028);
    gloss_ball(r, x + 0.09, y + 0.14, z, 0.028);
}

/* Adds a mirror with a lamp above or beside it, and below it a wash-basin and a tap on a cabinet. */
static void gloss_vanity(gloss_room *r, double x, double chrome) {
    gloss_metal(r, 0.9, 0.92, 0.91, 0);  /* the mirror */
    gloss_plate(r, 2, 0.015, x - 0.5, 1.05, x + 0.5, 1.85);
    gloss_matte(r, 0.3, 0.3, 0.3);
    gloss_box(r, x - 0.51, 1.04, 0.001, x + 0.51, 1.86, 0.013);
    gloss_glow(r, gloss_between(r, 12, 20));  /* a tube lamp above it, or a bulb beside it */
    if (furnished_below(&r->made, 2)) gloss_box(r, x - 0.3, 1.93, 0.12, x + 0.3, 2.01, 0.2);
    else {
        gloss_ball(r, x + 0.68, 1.5, 0.2, 0.09);
        gloss_chrome(r, chrome);
        gloss_rod(r, x + 0.68, 1.4, 0, 0.2, 0.012, 2);
    }
    gloss_coat(r, 0.85, 0.85, 0.83, 0.12);  /* wash-basin on a cabinet */
    gloss_bowl(r, x, 0.86, 0.29, 0.19, 0.1);
    gloss_coat(r, 0.45, 0.3, 0.18, 0.35);
    gloss_box(r, x - 0.5, 0.3, 0.02, x + 0.5, 0.7, 0.5);
    gloss_coat(r, 0.08, 0.08, 0.09, 0.1);
    gloss_box(r, x - 0.52, 0.702, 0.01, x + 0.52, 0.73, 0.52);
    gloss_tap(r, x, 0.73, 0.045, chrome);
}

/* Adds a shower: a pane, a tray, and a head on a bent pipe. w: x of the wall behind it */
static void gloss_shower(gloss_room *r, double w, double chrome) {
    const double radii[2] = { 0.15, 0.012 };
    double centre[3] = { 0, 1.9, 0.2 };
    gloss_glass(r, 0.95);
    gloss_plate(r, 0, w - 0.85, 0.1, 0.05, 2, 1.1);
    gloss_coat(r, 0.85, 0.85, 0.85, 0.15);
    gloss_box(r, w - 0.83, 0.001, 0.01, w - 0.01, 0.1, 1.1);
    centre[0] = w - 0.4;
    gloss_chrome(r, chrome);
    gloss_tube(r, centre, radii, REF_PI / 2, REF_PI, 0);
    gloss_rod(r, w - 0.4, 1.9, 0.05, 0.001, 0.012, 2);
    gloss_post(r, w - 0.4, 0.05, 1.0, 1.9, 0.012);
    gloss_post(r, w - 0.4, 0.2, 2.02, 2.06, 0.09);
}

static void gloss_bathroom(gloss_room *r) {
    const double w = gloss_between(r, 2.1, 2.8), h = 2.4, d = gloss_between(r, 2.2, 3);
    const double x = w * gloss_between(r, 0.35, 0.45), chrome = gloss_between(r, 0.05, 0.12);
    const double tile = gloss_between(r, 0.1, 0.2), tint = gloss_between(r, 0.5, 0.75);
    gloss_coat(r, 0.25, 0.25, 0.28, gloss_between(r, 0.12, 0.25));  /* floor */
    gloss_plate(r, 1, 0, 0, 0, d, w);
    gloss_matte(r, 0.8, 0.8, 0.78);  /* ceiling */
    gloss_plate(r, 1, h, 0, 0, d, w);
    gloss_coat(r, tint, 0.75, 0.72, tile);  /* tiles at the back and at the right */
    gloss_plate(r, 2, 0, 0, 0, w, h);
    gloss_coat(r, tint, 0.75, 0.72, tile);
    gloss_plate(r, 0, w, 0, 0, h, d);
    gloss_matte(r, 0.75, 0.72, 0.66);  /* plaster */
    gloss_plate(r, 0, 0, 0, 0, h, d);
    gloss_plate(r, 2, d, 0, 0, w, h);
    gloss_vanity(r, x, chrome);
    gloss_matte(r, 0.15, 0.3, 0.6);  /* a dressing gown at the wall that the mirror shows, a cupboard */
    gloss_box(r, x - 0.3, 0.6, d - 0.06, x + 0.05, 1.75, d - 0.01);
    gloss_coat(r, 0.7, 0.45, 0.15, 0.3);
    gloss_box(r, x + 0.45, 0.01, d - 0.3, x + 0.95, 1.5, d - 0.005);
    gloss_chrome(r, chrome);  /* towel rail with a towel, at the left wall */
    gloss_rod(r, 0.08, 1.1, 0.6, 0.7, 0.012, 2);
    gloss_matte(r, 0.6, 0.12, 0.1);
    gloss_box(r, 0.06, 0.6, 0.75, 0.1, 1.115, 1.15);
    gloss_shower(r, w, chrome);
    gloss_camera(r, x + gloss_between(r, 0.1, 0.4), gloss_between(r, 1.35, 1.6), d - 0.5, x + 0.15, 1.1, 0.2,
                 gloss_between(r, 58, 70));
    r->made.labels[0] = "bathroom";
}

/* Adds a floor lamp: a bulb within a shade that is a truncated cone. */
static void gloss_floor_lamp(gloss_room *r, double x, double z) {
    double shade[2][2] = { { 0.2, 1.42 }, { 0.14, 1.7 } };
    gloss_chrome(r, 0.25);
    gloss_post(r, x, z, 0.02, 1.5, 0.012);
    gloss_post(r, x, z, 0, 0.02, 0.13);
    gloss_matte(r, 0.8, 0.75, 0.65);
    gloss_move(r, x, z);
    furnished_lathe(&r->made, shade, 2, 40);
    gloss_smooth(r);
    gloss_glow(r, 50);
    gloss_ball(r, x, 1.55, z, 0.07);
}

/* Adds the wall x = 0 with a window and its pane. d: depth of the room */
static void gloss_window_wall(gloss_room *r, double d) {
    furnished_hole hole;
    furnished_window *o = &r->made.windows[r->made.window_count++];
    int i;
    hole.low = d / 2 - 0.9; hole.high = d / 2 + 0.9; hole.sill = 0.5; hole.top = 2.1;
    gloss_matte(r, 0.7, 0.68, 0.6);
    r->made.at[2] = d;
    r->made.turn = REF_PI / 2;
    furnished_wall(&r->made, d, &hole, 1, 0.16, 0);
    r->made.at[2] = 0;
    r->made.turn = 0;
    gloss_glass(r, 0.9);
    gloss_plate(r, 0, -0.08, hole.sill, d - hole.high, hole.top, d - hole.low);
    o->corner = v3_of(-0.16, hole.sill, d - hole.high);
    o->across = v3_of(0, 0, 1.8);
    o->up = v3_of(0, hole.top - hole.sill, 0);
    for (i = 0; i < 3; i++) r->made.scene.sky[i] = (float)(4 + 0.7 * i);
}

/* Adds a glass table with legs and a frame of steel, and on it a chrome ball and a vase. steel: roughness */
static void gloss_glass_table(gloss_room *r, double x, double z, double steel) {
    double vase[12][2];
    int i;
    gloss_glass(r, 0.9);
    gloss_plate(r, 1, 0.45, z - 0.35, x - 0.6, z + 0.35, x + 0.6);
    for (i = 0; i < 4; i++) {
        gloss_chrome(r, steel);
        gloss_post(r, x + (i & 1 ? 0.56 : -0.56), z + (i & 2 ? 0.31 : -0.31), 0, 0.445, 0.02);
    }
    gloss_chrome(r, steel);
    gloss_rod(r, x - 0.56, 0.42, z - 0.31, 1.12, 0.012, 0);
    gloss_rod(r, x - 0.56, 0.42, z + 0.31, 1.12, 0.012, 0);
    gloss_chrome(r, 0.1);
    gloss_ball(r, x + 0.25, 0.551, z, 0.1);
    gloss_coat(r, 0.1, 0.25, 0.45, 0.1);
    for (i = 0; i < 12; i++) {
        vase[i][0] = i ? 0.05 + 0.035 * sin(0.55 * i) : 0;
        vase[i][1] = 0.451 + (i ? 0.027 * (i - 1) : 0);
    }
    gloss_move(r, x - 0.25, z + 0.05);
    furnished_lathe(&r->made, vase, 12, 32);
    gloss_smooth(r);
}

/* Makes a floor of the current material, and a white ceiling, which is the current material afterwards. */
static void gloss_floor_and_ceiling(gloss_room *r, double w, double h, double d) {
    gloss_plate(r, 1, 0, 0, 0, d, w);
    gloss_matte(r, 0.82, 0.82, 0.8);
    gloss_plate(r, 1, h, 0, 0, d, w);
}

static void gloss_living_room(gloss_room *r) {
    const double w = gloss_between(r, 4.2, 5.2), h = 2.6, d = gloss_between(r, 3.8, 4.8);
    const double x = w * gloss_between(r, 0.42, 0.55), z = d * gloss_between(r, 0.38, 0.48);
    const double steel = gloss_between(r, 0.2, 0.3);
    gloss_coat(r, 0.32, 0.19, 0.1, gloss_between(r, 0.15, 0.3));  /* a polished floor */
    gloss_floor_and_ceiling(r, w, h, d);
    gloss_matte(r, 0.7, 0.68, 0.6);
    gloss_plate(r, 2, 0, 0, 0, w, h);
    gloss_plate(r, 0, w, 0, 0, h, d);
    gloss_matte(r, 0.35, 0.45, 0.5);
    gloss_plate(r, 2, d, 0, 0, w, h);
    gloss_window_wall(r, d);
    gloss_glass_table(r, x, z, steel);
    gloss_matte(r, 0.25, 0.3, 0.22);  /* a sofa at the back */
    gloss_move(r, x, 0.5);
    furnished_sofa(&r->made, 1.9, 0.85);
    gloss_coat(r, 0.02, 0.02, 0.02, 0.06);  /* a black screen and a picture behind glass at the right wall */
    gloss_box(r, w - 0.06, 0.9, d * 0.45, w - 0.02, 1.5, d * 0.45 + 1.05);
    gloss_coat(r, 0.6, 0.4, 0.2, 0.03);
    gloss_plate(r, 2, 0.02, x - 0.5, 1.2, x + 0.5, 1.8);
    gloss_chrome(r, 0.3);
    gloss_box(r, x - 0.52, 1.18, 0.001, x + 0.52, 1.82, 0.018);
    gloss_floor_lamp(r, w - 0.5, 0.5);
    gloss_metal(r, 0.95, 0.64, 0.54, gloss_between(r, 0.2, 0.35));
    gloss_ball(r, x + 1.1, 0.2, z + 0.5, 0.2);
    gloss_camera(r, w * gloss_between(r, 0.5, 0.7), gloss_between(r, 1.3, 1.6), d - 0.25, x, 0.55, 0.6,
                 gloss_between(r, 55, 70));
    r->made.labels[0] = "living room";
}

static void gloss_lamp_at(gloss_room *r, sbl_light_kind kind, double power, double x, double y, double z) {
    sbl_light *l = &r->lights[r->made.scene.light_count++];
    l->kind = kind;
    l->intensity[0] = (float)power; l->intensity[1] = (float)(0.9 * power); l->intensity[2] = (float)(0.75 * power);
    l->position[0] = (float)x; l->position[1] = (float)y; l->position[2] = (float)z;
    l->direction[1] = -1;
    l->cone = 70;
    l->inner_cone = 40;
}

/* Adds cabinets with fronts of brushed metal and handles, a worktop, a hood, a kettle and a pot. w: width of the room;
   brushed: roughness */
static void gloss_cabinets(gloss_room *r, double w, double brushed) {
    int i;
    for (i = 0; i < 5; i++) {
        const double x0 = w * i / 5 + 0.003, x1 = w * (i + 1) / 5 - 0.003;
        gloss_metal(r, 0.6, 0.6, 0.62, brushed);
        gloss_box(r, x0, 0.1, 0.02, x1, 0.86, 0.6);
        gloss_metal(r, 0.6, 0.6, 0.62, brushed);
        if (i != 2) gloss_box(r, x0, 1.5, 0.02, x1, 2.2, 0.36);
        gloss_chrome(r, 0.12);
        gloss_rod(r, x0 + 0.1, 0.78, 0.63, x1 - x0 - 0.2, 0.008, 0);
    }
    gloss_coat(r, 0.1, 0.1, 0.1, 0.3);
    gloss_box(r, 0.002, 0.862, 0.01, w - 0.002, 0.9, 0.63);
    gloss_metal(r, 0.6, 0.6, 0.62, 0.25);
    gloss_box(r, 0.41 * w, 1.6, 0.02, 0.59 * w, 1.72, 0.5);
    gloss_chrome(r, 0.1);
    gloss_ball(r, 0.25 * w, 1.0, 0.3, 0.1);
    gloss_metal(r, 0.95, 0.64, 0.54, 0.3);
    gloss_post(r, 0.5 * w, 0.3, 0.901, 1.03, 0.12);
}

static void gloss_kitchen(gloss_room *r) {
    const double w = gloss_between(r, 3, 4), h = 2.5, d = gloss_between(r, 2.8, 3.6);
    const double brushed = gloss_between(r, 0.35, 0.5), at = w * gloss_between(r, 0.4, 0.6);
    int i;
    gloss_coat(r, 0.5, 0.48, 0.45, gloss_between(r, 0.3, 0.5));
    gloss_floor_and_ceiling(r, w, h, d);
    gloss_matte(r, 0.75, 0.7, 0.5);
    gloss_plate(r, 0, 0, 0, 0, h, d);
    gloss_plate(r, 0, w, 0, 0, h, d);
    gloss_plate(r, 2, d, 0, 0, w, h);
    gloss_coat(r, 0.7, 0.74, 0.76, 0.2);
    gloss_plate(r, 2, 0, 0, 0, w, h);
    gloss_cabinets(r, w, brushed);
    gloss_coat(r, 0.6, 0.05, 0.04, 0.4);  /* plastic: a bowl and a chair */
    gloss_bowl(r, 0.78 * w, 1.03, 0.3, 0.13, 0.1);
    gloss_coat(r, 0.1, 0.35, 0.12, 0.35);
    gloss_box(r, at - 0.2, 0.44, 1.5, at + 0.2, 0.48, 1.9);
    gloss_box(r, at - 0.2, 0.48, 1.86, at + 0.2, 0.9, 1.9);
    for (i = 0; i < 4; i++) {
        gloss_chrome(r, 0.3);
        gloss_post(r, at + (i & 1 ? 0.17 : -0.17), i & 2 ? 1.87 : 1.53, 0, 0.44, 0.012);
    }
    gloss_metal(r, 0.56, 0.57, 0.58, 0.5);  /* a fridge */
    gloss_box(r, w - 0.65, 0.01, 0.7, w - 0.02, 1.8, 1.35);
    gloss_blended(r, 0.3, 0.5, 0.7, 0.4);  /* a screen of coloured glass in front of a part of the wall */
    gloss_plate(r, 0, 0.35, 0.05, 0.8, 1.7, 1.9);
    gloss_lamp_at(r, SBL_LIGHT_SPOT, 3, at, h - 0.05, 0.9);
    gloss_lamp_at(r, SBL_LIGHT_POINT, 0.8, 0.3 * w, h - 0.3, 0.6 * d);
    gloss_glow(r, 7);
    gloss_box(r, 0.6 * w, h - 0.04, 0.55 * d, 0.6 * w + 0.6, h - 0.01, 0.55 * d + 0.3);
    gloss_camera(r, w * gloss_between(r, 0.4, 0.6), gloss_between(r, 1.4, 1.65), d - 0.2, w * 0.48, 0.95, 0.3,
                 gloss_between(r, 58, 70));
    r->made.labels[0] = "kitchen";
}

/* >>making */

/* Sets the normals of a mesh. A triangle's normal at a corner is a mean, weighted by area, over all triangles of the
   mesh that meet there and are tilted against this triangle by at most 40 degrees. */
static void gloss_normals(gloss_room *r, int mesh) {
    sbl_mesh *m = &r->made.meshes[mesh];
    const float *p = (const float *)m->positions.data;
    float *out = r->normals + 3 * r->made.first[mesh];
    int i, j, k;
    v3 *across = (v3 *)malloc((size_t)m->vertex_count * sizeof *across);
    if (!across) abort();
    for (i = 0; i < m->vertex_count; i++) {
        const float *a = p + 9 * (i / 3);
        across[i] = v3_cross(v3_sub(v3_from(a + 3), v3_from(a)), v3_sub(v3_from(a + 6), v3_from(a)));
    }
    for (i = 0; i < m->vertex_count; i++) {
        v3 sum = v3_of(0, 0, 0);
        for (j = 0; j < m->vertex_count; j++) {
            for (k = 0; k < 3 && fabsf(p[3 * i + k] - p[3 * j + k]) < 1e-5f; k++) {}
            if (k == 3 && v3_dot(v3_unit(across[i]), v3_unit(across[j])) > 0.766) sum = v3_add(sum, across[j]);
        }
        sum = v3_unit(sum);
        out[3 * i] = (float)sum.x; out[3 * i + 1] = (float)sum.y; out[3 * i + 2] = (float)sum.z;
    }
    free(across);
    m->normals.data = out;
}

static void gloss_room_make(gloss_room *r, unsigned seed, int width, int height) {
    static void (*const rooms[3])(gloss_room *) = { gloss_bathroom, gloss_living_room, gloss_kitchen };
    size_t i;
    int k;
    r->made.random = 0x9105u + 7919u * (uint64_t)seed;
    r->made.piece = 0.25;  /* the path tracer's guide needs triangles that are not large */
    r->made.view.width = width;
    r->made.view.height = height;
    rooms[seed / 2 % 3](r);
    furnished_finish(&r->made);
    r->made.scene.lights = r->lights;
    r->normals = (float *)malloc(3 * r->made.vertex_count * sizeof(float));
    r->colors = (float *)malloc(4 * r->made.vertex_count * sizeof(float));
    if (!r->normals || !r->colors) abort();
    for (i = 0; i < 4 * r->made.vertex_count; i++) r->colors[i] = 1;
    for (k = 0; k < r->made.scene.mesh_count; k++) {
        const size_t first = r->made.first[k];
        if (r->smooth[k] == 1) gloss_normals(r, k);
        if (r->smooth[k] < 2) continue;
        r->made.meshes[k].colors.data = r->colors + 4 * first;
        for (i = 0; i < (size_t)r->made.meshes[k].vertex_count; i++)
            r->colors[4 * (first + i) + 3] = (float)(r->smooth[k] - 2) / 100;
    }
}

static void gloss_room_free(gloss_room *r) {
    free(r->normals);
    free(r->colors);
    furnished_free(&r->made);
    memset(r, 0, sizeof *r);
}

#endif
