/* Makes furnished rooms from a seed: size, windows, lamps, furniture and camera are random. A seed of FURNISHED_STOREY
   or more makes a storey of many rooms, one of which the camera sees. Include after sbl.h and reference.h.
       furnished f = { 0 };
       furnished_make(&f, seed, 128, 96);
       ... f.scene, f.view, f.windows ... furnished_free(&f);
   Lengths are in metres. x and z are horizontal, y points up. All surfaces are flat triangles without normals. */
#ifndef BENCH_FURNISHED_H
#define BENCH_FURNISHED_H

enum { FURNISHED_MESHES = 1024, FURNISHED_WINDOWS = 8, FURNISHED_PLACES = 40, FURNISHED_STOREY = 1000 };

typedef struct furnished_window { v3 corner, across, up; } furnished_window;

typedef struct furnished {
    sbl_scene_desc scene;
    sbl_picture_desc view;
    furnished_window windows[FURNISHED_WINDOWS];  /* openings through which all light of the sky enters */
    int window_count;
    const char *labels[3];                        /* up to two kinds of light, then "two rooms"; or "storey" */
    /* fields that are used while the room is made */
    uint64_t random;
    sbl_mesh meshes[FURNISHED_MESHES];
    sbl_material materials[FURNISHED_MESHES];
    float *positions;
    size_t vertex_count, vertex_room, first[FURNISHED_MESHES];
    double piece;                                 /* greatest length of an edge; 0: no limit; set it before */
    double origin[2];                             /* x and z of the corner of the room in the world */
    double size[3], split;                        /* size of the room; x of a wall across it, or 0 */
    double turn, at[3];                           /* rotation and position of the object under construction */
    struct { double x, z, radius; } taken[FURNISHED_PLACES];
    int taken_count;
} furnished;

static double furnished_between(furnished *f, double low, double high) {
    return low + (high - low) * ref_random(&f->random);
}
static int furnished_below(furnished *f, int count) { return (int)(ref_random(&f->random) * count); }

/* >>shapes */

/* Begins an object of one material at a position, rotated about the vertical axis. */
static void furnished_begin(furnished *f, const double rgb[3], double x, double z, double turn) {
    const int number = f->scene.mesh_count++;
    int k;
    if (number >= FURNISHED_MESHES) abort();
    f->first[number] = f->vertex_count;
    f->meshes[number].material = number;
    for (k = 0; k < 3; k++) f->materials[number].albedo[k] = (float)rgb[k];
    f->at[0] = x; f->at[1] = 0; f->at[2] = z;
    f->turn = turn;
}

/* Begins an object with a grey or coloured material, whose largest albedo is from low to high. */
static void furnished_object(furnished *f, double low, double high, double x, double z, double turn) {
    const double albedo = furnished_between(f, low, high), colour = furnished_between(f, -0.6, 0.6);
    double rgb[3];
    int k;
    for (k = 0; k < 3; k++) rgb[k] = colour > 0 ? albedo * furnished_between(f, 1 - colour, 1) : albedo;
    furnished_begin(f, rgb, x, z, turn);
}

/* Makes the object under construction emit light. power: radiance times area of one side */
static void furnished_glow(furnished *f, double power, double area) {
    const int number = f->scene.mesh_count - 1;
    static const double tint[3] = { 1, 0.85, 0.65 };
    int k;
    for (k = 0; k < 3; k++) {
        f->materials[number].albedo[k] = 0;
        f->materials[number].emission[k] = (float)(power * tint[k] / area);
    }
}

static void furnished_vertex(furnished *f, const double p[3]) {
    const double c = cos(f->turn), s = sin(f->turn);
    float *to;
    if (f->vertex_count == f->vertex_room) {
        f->vertex_room = 2 * f->vertex_room + 1024;
        f->positions = (float *)realloc(f->positions, 3 * f->vertex_room * sizeof(float));
        if (!f->positions) abort();
    }
    to = f->positions + 3 * f->vertex_count++;
    to[0] = (float)(f->origin[0] + f->at[0] + c * p[0] + s * p[2]);
    to[1] = (float)(f->at[1] + p[1]);
    to[2] = (float)(f->origin[1] + f->at[2] - s * p[0] + c * p[2]);
}

/* Adds a quad, or a triangle if two neighbouring corners are equal. If `piece` is set, the quad is divided. */
static void furnished_quad(furnished *f, double corners[4][3]) {
    static const int order[6] = { 0, 1, 2, 0, 2, 3 };
    int count[2] = { 1, 1 }, i, j, k, n;
    for (i = 0; i < 4 && f->piece > 0; i++) {
        const double *a = corners[i], *b = corners[(i + 1) % 4];
        const double parts = ceil(sqrt((a[0] - b[0]) * (a[0] - b[0]) + (a[1] - b[1]) * (a[1] - b[1]) +
                                       (a[2] - b[2]) * (a[2] - b[2])) / f->piece);
        if (parts > count[i & 1]) count[i & 1] = (int)parts;
    }
    for (n = 0; n < count[0] * count[1]; n++) {
        double at[4][3];
        for (j = 0; j < 4; j++) {
            const double u = (n % count[0] + (j == 1 || j == 2)) / (double)count[0];
            const double v = (n / count[0] + (j > 1)) / (double)count[1];
            for (k = 0; k < 3; k++)
                at[j][k] = (1 - v) * ((1 - u) * corners[0][k] + u * corners[1][k]) +
                           v * ((1 - u) * corners[3][k] + u * corners[2][k]);
        }
        for (i = 0; i < 6; i += 3) {
            const double *p = at[order[i]], *q = at[order[i + 1]], *r = at[order[i + 2]];
            if (!memcmp(p, q, sizeof *at) || !memcmp(q, r, sizeof *at) || !memcmp(r, p, sizeof *at)) continue;
            furnished_vertex(f, p);
            furnished_vertex(f, q);
            furnished_vertex(f, r);
        }
    }
}

/* Adds a rectangle in the plane where coordinate `axis` is `at`. low, high: the other two coordinates in cyclic
   order */
static void furnished_rectangle(furnished *f, int axis, double at, const double low[2], const double high[2]) {
    double corners[4][3];
    int i;
    for (i = 0; i < 4; i++) {
        corners[i][axis] = at;
        corners[i][(axis + 1) % 3] = i == 1 || i == 2 ? high[0] : low[0];
        corners[i][(axis + 2) % 3] = i > 1 ? high[1] : low[1];
    }
    furnished_quad(f, corners);
}

static void furnished_box(furnished *f, double x0, double y0, double z0, double x1, double y1, double z1) {
    const double low[5] = { x0, y0, z0, x0, y0 }, high[5] = { x1, y1, z1, x1, y1 };
    int axis;
    for (axis = 0; axis < 3; axis++) {
        furnished_rectangle(f, axis, low[axis], low + axis + 1, high + axis + 1);
        furnished_rectangle(f, axis, high[axis], low + axis + 1, high + axis + 1);
    }
}

/* Adds a surface of revolution. profile: radius and height of each ring */
static void furnished_lathe(furnished *f, double profile[][2], int rings, int slices) {
    int i, k, j;
    for (i = 0; i + 1 < rings; i++)
        for (k = 0; k < slices; k++) {
            double corners[4][3];
            for (j = 0; j < 4; j++) {
                const double *ring = profile[i + (j > 1)];
                const double angle = 2 * REF_PI * ((k + (j == 1 || j == 2)) % slices) / slices;
                corners[j][0] = ring[0] * cos(angle);
                corners[j][1] = ring[1];
                corners[j][2] = ring[0] * sin(angle);
            }
            furnished_quad(f, corners);
        }
}

static void furnished_ball(furnished *f, double y, double radius, int rings, int slices) {
    double profile[33][2];
    int i;
    for (i = 0; i <= rings; i++) {
        profile[i][0] = i == 0 || i == rings ? 0 : radius * sin(REF_PI * i / rings);
        profile[i][1] = y - radius * cos(REF_PI * i / rings);
    }
    furnished_lathe(f, profile, rings + 1, slices);
}

/* >>walls */

typedef struct furnished_hole { double low, high, sill, top; } furnished_hole;  /* along the wall; heights */

/* Adds a wall from the origin of the object along x, with its inner face at z = 0. holes: sorted by x, not overlapping.
   Their reveals (jambs, head and sill) extend to z = -depth; if `both` is 1, the wall has a second face there. */
static void furnished_wall(furnished *f, double length, const furnished_hole *holes, int count, double depth,
                           int both) {
    const double height = f->size[1];
    int face, i, side;
    for (face = 0; face <= both; face++) {
        double x = 0, corner[2][2];
        for (i = 0; i <= count; i++) {
            corner[0][0] = x; corner[0][1] = 0;
            corner[1][0] = i < count ? holes[i].low : length; corner[1][1] = height;
            furnished_rectangle(f, 2, face ? -depth : 0, corner[0], corner[1]);
            if (i == count) break;
            corner[0][0] = holes[i].low; corner[1][0] = x = holes[i].high;
            corner[1][1] = holes[i].sill;
            if (holes[i].sill > 0) furnished_rectangle(f, 2, face ? -depth : 0, corner[0], corner[1]);
            corner[0][1] = holes[i].top; corner[1][1] = height;
            furnished_rectangle(f, 2, face ? -depth : 0, corner[0], corner[1]);
        }
    }
    for (i = 0; i < count; i++)
        for (side = 0; side < 2; side++) {
            double low[2], high[2];
            low[0] = holes[i].sill; high[0] = holes[i].top; low[1] = -depth; high[1] = 0;
            furnished_rectangle(f, 0, side ? holes[i].high : holes[i].low, low, high);
            low[0] = -depth; high[0] = 0; low[1] = holes[i].low; high[1] = holes[i].high;
            furnished_rectangle(f, 1, side ? holes[i].top : holes[i].sill, low, high);
        }
}

static v3 furnished_world(const furnished *f, double x, double y, double z) {
    const double c = cos(f->turn), s = sin(f->turn);
    return v3_of(f->at[0] + c * x + s * z, y, f->at[2] - s * x + c * z);
}

/* Adds a window to a wall at x, z with the rotation `turn`: its frame, its bars, and its opening in
   furnished.windows. */
static void furnished_glaze(furnished *f, const furnished_hole *h, double x, double z, double turn) {
    const double depth = 0.16, back = -0.1, front = -0.06, thick = furnished_between(f, 0.02, 0.06);
    const int bars = 1 + furnished_below(f, 3);
    furnished_window *w = &f->windows[f->window_count++];
    int i;
    furnished_object(f, 0.3, 0.85, x, z, turn);
    for (i = 0; i <= bars; i++) {
        const double middle = h->low + (h->high - h->low) * i / bars;
        const double from = i == 0 ? h->low : i == bars ? h->high - thick : middle - thick / 2;
        furnished_box(f, from, h->sill, back, from + thick, h->top, front);
    }
    furnished_box(f, h->low, h->sill, back + 0.001, h->high, h->sill + thick, front - 0.001);
    furnished_box(f, h->low, h->top - thick, back + 0.001, h->high, h->top, front - 0.001);
    w->corner = furnished_world(f, h->low, h->sill, -depth);
    w->across = v3_sub(furnished_world(f, h->high, h->sill, -depth), w->corner);
    w->up = v3_of(0, h->top - h->sill, 0);
}

/* Adds floor, ceiling and four walls. windows: number of walls with windows */
static void furnished_shell(furnished *f, int windows) {
    const double w = f->size[0], h = f->size[1], d = f->size[2];
    const double corner[4][2] = { { 0, 0 }, { 0, d }, { w, d }, { w, 0 } };  /* a wall begins in each corner */
    double low[2] = { 0, 0 }, high[2];
    const int first = furnished_below(f, 4);
    int side, i;
    furnished_object(f, 0.15, 0.6, 0, 0, 0);
    high[0] = d; high[1] = w;
    furnished_rectangle(f, 1, 0, low, high);
    furnished_object(f, 0.6, 0.85, 0, 0, 0);
    furnished_rectangle(f, 1, h, low, high);
    for (side = 0; side < 4; side++) {
        /* seen from inside, a wall runs along its own x axis; its z axis points into the room */
        const double turn = REF_PI / 2 * (side + 1), length = side & 1 ? w : d;
        const int has = (side + first) % 4 < windows;
        furnished_hole holes[2];
        const int count = has ? 1 + (length > 4) : 0;
        for (i = 0; i < count; i++) {
            const double middle = length * (2 * i + 1) / (2 * count), half = furnished_between(f, 0.3, 0.8);
            holes[i].low = middle - half; holes[i].high = middle + half;
            holes[i].sill = furnished_between(f, 0.3, 1.1);
            holes[i].top = holes[i].sill + furnished_between(f, 0.8, h - 0.2 - holes[i].sill);
        }
        furnished_object(f, 0.35, 0.85, corner[(side + 1) % 4][0], corner[(side + 1) % 4][1], turn);
        furnished_wall(f, length, holes, count, 0.16, 0);
        for (i = 0; i < count; i++)
            furnished_glaze(f, &holes[i], corner[(side + 1) % 4][0], corner[(side + 1) % 4][1], turn);
    }
}

/* Adds a wall across the room at x, with a door that is ajar. */
static void furnished_partition(furnished *f, double x) {
    const double d = f->size[2], at = furnished_between(f, 0.3, d - 1.4);
    furnished_hole door;
    door.low = at; door.high = at + 0.9; door.sill = 0; door.top = 2.05;
    furnished_object(f, 0.4, 0.85, x, d, REF_PI / 2);  /* runs towards smaller z */
    furnished_wall(f, d, &door, 1, 0.12, 1);
    furnished_object(f, 0.2, 0.8, x + 0.005, d - door.low - 0.01, REF_PI / 2 - furnished_between(f, 0.15, 1.3));
    furnished_box(f, 0, 0.01, -0.04, 0.88, 2.03, 0);
}

/* >>furniture; the origin of a piece is the middle of its footprint */

static void furnished_table(furnished *f, double w, double d) {
    const double h = furnished_between(f, 0.4, 0.78), leg = furnished_between(f, 0.012, 0.04);
    int i;
    furnished_box(f, -w / 2, h - 0.03, -d / 2, w / 2, h, d / 2);
    for (i = 0; i < 4; i++) {
        const double x = (i & 1 ? 1 : -1) * (w / 2 - 0.04) - leg, z = (i & 2 ? 1 : -1) * (d / 2 - 0.04) - leg;
        furnished_box(f, x, 0, z, x + 2 * leg, h - 0.03, z + 2 * leg);
    }
}

/* Adds a cabinet whose drawers are 2 mm apart and 2 mm in front of its body. */
static void furnished_cabinet(furnished *f, double w, double d, double h) {
    const int rows = 2 + furnished_below(f, 4), columns = 1 + furnished_below(f, 2);
    int row, column;
    furnished_box(f, -w / 2, 0, -d / 2, w / 2, h, d / 2 - 0.02);
    furnished_object(f, 0.15, 0.85, f->at[0], f->at[2], f->turn);
    for (row = 0; row < rows; row++)
        for (column = 0; column < columns; column++)
            furnished_box(f, -w / 2 + w * column / columns + 0.001, h * row / rows + 0.001, d / 2 - 0.018,
                          -w / 2 + w * (column + 1) / columns - 0.001, h * (row + 1) / rows - 0.001, d / 2);
}

static void furnished_shelf(furnished *f, double w, double d, double h) {
    const int rows = 2 + furnished_below(f, 4);
    int i, k;
    for (i = 0; i < 2; i++) furnished_box(f, i ? w / 2 - 0.02 : -w / 2, 0, -d / 2, i ? w / 2 : -w / 2 + 0.02, h, d / 2);
    for (i = 0; i <= rows; i++) {
        const double y = (h - 0.02) * i / rows;
        furnished_box(f, -w / 2 + 0.02, y, -d / 2, w / 2 - 0.02, y + 0.02, d / 2 - 0.005);
    }
    furnished_object(f, 0.1, 0.8, f->at[0], f->at[2], f->turn);
    for (i = 0; i < rows; i++) {  /* books */
        double x = -w / 2 + 0.03;
        for (k = 0; k < 12 && x < w / 2 - 0.1; k++) {
            const double thick = furnished_between(f, 0.02, 0.06), y = (h - 0.02) * i / rows + 0.02;
            furnished_box(f, x, y, -d / 2 + 0.02, x + thick, y + furnished_between(f, 0.15, 0.9) * (h / rows - 0.04),
                          furnished_between(f, 0, d / 2 - 0.03));
            x += thick + (furnished_below(f, 4) ? 0.001 : furnished_between(f, 0.02, 0.2));
        }
    }
}

static void furnished_sofa(furnished *f, double w, double d) {
    furnished_box(f, -w / 2, 0.1, -d / 2, w / 2, 0.42, d / 2);
    furnished_box(f, -w / 2, 0.425, -d / 2, w / 2, 0.85, -d / 2 + 0.2);
    furnished_box(f, -w / 2, 0.425, -d / 2 + 0.205, -w / 2 + 0.15, 0.6, d / 2);
    furnished_box(f, w / 2 - 0.15, 0.425, -d / 2 + 0.205, w / 2, 0.6, d / 2);
}

static void furnished_vase(furnished *f, double h) {
    double profile[25][2];
    const double wave = furnished_between(f, 2, 7), wide = h * furnished_between(f, 0.15, 0.4);
    int i;
    for (i = 0; i < 25; i++) {
        profile[i][0] = i ? wide * (0.7 + 0.3 * sin(wave * i / 24)) : 0;
        profile[i][1] = i ? h * (i - 1) / 23 : 0;
    }
    furnished_lathe(f, profile, 25, 48);
}

/* Finds a free place for an object on the floor. Returns 0 if there is none. wall: 1 if the object stands at a wall */
static int furnished_place(furnished *f, double w, double d, int wall, double out[3]) {
    const double radius = 0.5 * sqrt(w * w + d * d) * (wall ? 0.85 : 1);
    int attempt, i;
    for (attempt = 0; attempt < 30 && f->taken_count < FURNISHED_PLACES; attempt++) {
        const int side = furnished_below(f, 4);
        out[0] = furnished_between(f, radius, f->size[0] - radius);
        out[1] = furnished_between(f, radius, f->size[2] - radius);
        out[2] = furnished_below(f, 2) ? 0 : furnished_between(f, 0, 6.28);
        if (wall) {
            const double gap = furnished_below(f, 2) ? 0.001 : furnished_between(f, 0.01, 0.06);
            out[2] = REF_PI / 2 * side;  /* the back, at z < 0, is at the wall */
            if (side & 1) out[0] = side == 1 ? d / 2 + gap : f->size[0] - d / 2 - gap;
            else out[1] = side == 0 ? d / 2 + gap : f->size[2] - d / 2 - gap;
        }
        for (i = 0; i < f->taken_count; i++)
            if (hypot(out[0] - f->taken[i].x, out[1] - f->taken[i].z) < radius + f->taken[i].radius) break;
        if (i < f->taken_count || (f->split > 0 && fabs(out[0] - f->split) < radius + 0.15)) continue;
        f->taken[i].x = out[0]; f->taken[i].z = out[1]; f->taken[i].radius = radius;
        f->taken_count++;
        return 1;
    }
    return 0;
}

static void furnished_furniture(furnished *f) {
    const int kind = furnished_below(f, 7), wall = kind == 1 || kind == 2 || (kind == 3 && furnished_below(f, 2));
    const double w = furnished_between(f, 0.4, kind == 3 ? 2.0 : 1.4), d = furnished_between(f, 0.3, kind == 0 ||
        kind == 3 ? 0.9 : 0.5), h = furnished_between(f, 0.4, f->size[1] - 0.3);
    double at[3];
    if (!furnished_place(f, w, d, wall, at)) return;
    furnished_object(f, 0.1, 0.85, at[0], at[1], at[2]);
    switch (kind) {
    case 0: furnished_table(f, w, d); break;
    case 1: furnished_cabinet(f, w, d, h); break;
    case 2: furnished_shelf(f, w, d, h); break;
    case 3: furnished_sofa(f, w, d); break;
    case 4: furnished_vase(f, 0.6 * h); break;
    case 5: furnished_ball(f, d / 2, d / 2, 24, 48); break;
    default: furnished_box(f, -w / 2, 0, -d / 2, w / 2, 0.5 * h, d / 2); break;
    }
}

/* >>lamps */

static void furnished_lamp(furnished *f, int kind) {
    static const double dark[3] = { 0.3, 0.3, 0.3 }, white[3] = { 0.8, 0.8, 0.75 };
    const double x = furnished_between(f, 0.8, f->size[0] - 0.8), z = furnished_between(f, 0.8, f->size[2] - 0.8);
    const double top = f->size[1], turn = furnished_between(f, 0, 6.28);
    double rings[4][2], at[3], r = furnished_between(f, 0.12, 0.22), y;
    if (kind == 0) {  /* panel under the ceiling */
        const double w = furnished_between(f, 0.15, 0.6), d = furnished_between(f, 0.15, 0.6);
        y = top - furnished_between(f, 0.05, 0.3);
        if (furnished_below(f, 2)) {
            furnished_begin(f, dark, x, z, turn);
            furnished_box(f, -w - 0.01, y + 0.005, -d - 0.01, w + 0.01, top - 0.001, d + 0.01);
        }
        furnished_begin(f, dark, x, z, turn);
        rings[0][0] = -d; rings[0][1] = -w; rings[1][0] = d; rings[1][1] = w;
        furnished_rectangle(f, 1, y, rings[0], rings[1]);
        furnished_glow(f, 8, 4 * w * d);
    } else if (kind == 1 || kind == 4) {  /* floor lamp with a shade that is open at both ends, or uplight in a bowl */
        y = kind == 1 ? furnished_between(f, 1.2, 1.6) : furnished_between(f, 1.5, top - 0.3);
        if (!furnished_place(f, 2 * r, 2 * r, 0, at)) { at[0] = x; at[1] = z; }
        furnished_begin(f, dark, at[0], at[1], 0);
        furnished_box(f, -0.012, 0, -0.012, 0.012, y - 0.1, 0.012);
        furnished_box(f, -0.12, 0, -0.12, 0.12, 0.02, 0.12);
        furnished_begin(f, white, at[0], at[1], 0);
        rings[0][0] = kind == 1 ? r : 0; rings[0][1] = y - (kind == 1 ? 0.13 : 0.1);
        rings[1][0] = kind == 1 ? 0.7 * r : r; rings[1][1] = y + 0.13;
        furnished_lathe(f, rings, 2, 32);
        furnished_begin(f, dark, at[0], at[1], 0);
        furnished_ball(f, y, 0.035, 8, 12);
        furnished_glow(f, 8, 4 * REF_PI * 0.035 * 0.035);
    } else if (kind == 2) {  /* spot: a bulb in a tube that points at a wall */
        const double w = furnished_between(f, 0.25, 0.6);
        furnished_begin(f, white, w, z, 0);
        y = furnished_between(f, 1, top - 0.5);
        furnished_box(f, 0.1, y - 0.06, -0.06, 0.11, y + 0.06, 0.06);
        furnished_box(f, -0.03, y - 0.06, -0.06, 0.1, y - 0.055, 0.06);
        furnished_box(f, -0.03, y + 0.055, -0.06, 0.1, y + 0.06, 0.06);
        furnished_box(f, -0.03, y - 0.055, -0.06, 0.1, y + 0.055, -0.055);
        furnished_box(f, -0.03, y - 0.055, 0.055, 0.1, y + 0.055, 0.06);
        furnished_begin(f, dark, w, z, 0);
        furnished_ball(f, y, 0.025, 8, 12);
        furnished_glow(f, 10, 4 * REF_PI * 0.025 * 0.025);
    } else {  /* small bright lamp that hangs from the ceiling */
        y = top - furnished_between(f, 0.1, 0.8);
        furnished_begin(f, dark, x, z, 0);
        furnished_box(f, -0.004, y + 0.04, -0.004, 0.004, top, 0.004);
        furnished_begin(f, dark, x, z, 0);
        furnished_ball(f, y, 0.03, 8, 12);
        furnished_glow(f, 6, 4 * REF_PI * 0.03 * 0.03);
    }
}

/* >>rooms */

/* Sets the pointers of the scene when all objects have been made. */
static void furnished_finish(furnished *f) {
    int i;
    for (i = 0; i < f->scene.mesh_count; i++) {
        const size_t end = i + 1 < f->scene.mesh_count ? f->first[i + 1] : f->vertex_count;
        f->meshes[i].positions.data = f->positions + 3 * f->first[i];
        f->meshes[i].vertex_count = (int)(end - f->first[i]);
    }
    f->scene.meshes = f->meshes;
    f->scene.materials = f->materials;
    f->scene.material_count = f->scene.mesh_count;
}

/* Places the camera in a corner, looking at a point near the centre of the room. */
static void furnished_camera(furnished *f, int width, int height) {
    const int corner = furnished_below(f, 4);
    const double w = f->split > 0 ? f->split : f->size[0], d = f->size[2];
    const double x = corner & 1 ? w - 0.45 : 0.45, z = corner & 2 ? d - 0.45 : 0.45;
    const double ax = w / 2 + furnished_between(f, -0.2, 0.2) * w, az = d / 2 + furnished_between(f, -0.2, 0.2) * d;
    f->taken[0].x = x; f->taken[0].z = z; f->taken[0].radius = 0.7;
    f->taken_count = 1;
    f->view.width = width;
    f->view.height = height;
    sbl_look_at(f->view.world_to_view, (float)(x + f->origin[0]), (float)furnished_between(f, 1.1, 1.7),
                (float)(z + f->origin[1]), (float)(ax + f->origin[0]), (float)furnished_between(f, 0.7, 1.4),
                (float)(az + f->origin[1]), 0, 1, 0);
    sbl_perspective(f->view.view_to_clip, (float)furnished_between(f, 50, 75), (float)width / (float)height);
}

/* Makes one storey of a building: 4 x 3 equal rooms with doorways between neighbours. The camera is in a room of the
   middle row. A room beside it is a bright stairwell; some of the others have lamps. */
static void furnished_storey(furnished *f, int width, int height) {
    enum { ACROSS = 4, DEEP = 3 };
    const int hall = ACROSS + 1 + furnished_below(f, 2), beside[4] = { hall - 1, hall + 1, hall - ACROSS,
                                                                       hall + ACROSS };
    const int bright = beside[furnished_below(f, 4)];
    const double w = furnished_between(f, 3.5, 5.5), d = furnished_between(f, 3.5, 5.5);
    double low[2] = { 0, 0 }, high[2];
    int room, i, k;
    f->size[0] = w; f->size[1] = furnished_between(f, 2.4, 3); f->size[2] = d;
    high[0] = DEEP * d; high[1] = ACROSS * w;
    furnished_object(f, 0.15, 0.6, 0, 0, 0);
    furnished_rectangle(f, 1, 0, low, high);
    furnished_object(f, 0.6, 0.85, 0, 0, 0);
    furnished_rectangle(f, 1, f->size[1], low, high);
    for (i = 0; i <= 1; i++)  /* walls along x, then along z */
        for (k = 0; k < (i ? ACROSS + 1 : DEEP + 1) * (i ? DEEP : ACROSS); k++) {
            const int line = k / (i ? DEEP : ACROSS), part = k % (i ? DEEP : ACROSS);
            const int outer = line == 0 || line == (i ? ACROSS : DEEP);
            const double length = i ? d : w, x = (i ? line : part) * w, z = (i ? part + 1 : line) * d;
            furnished_hole door;
            door.low = furnished_between(f, 0.4, length - 2.4);
            door.high = door.low + furnished_between(f, 0.9, 2); door.sill = 0; door.top = 2.1;
            furnished_object(f, 0.35, 0.85, x + 0.06 * i, z + 0.06 * (1 - i), i ? REF_PI / 2 : 0);
            furnished_wall(f, length, &door, !outer, 0.12, 1);
        }
    f->size[0] = w - 0.12; f->size[2] = d - 0.12;
    for (room = 0; room < ACROSS * DEEP; room++) {
        f->origin[0] = room % ACROSS * w + 0.06; f->origin[1] = room / ACROSS * d + 0.06;
        f->taken_count = 0;
        if (room == hall) furnished_camera(f, width, height);
        for (i = room == bright ? 6 : furnished_below(f, 3) == 0; i > 0; i--) furnished_lamp(f, 0);
        for (i = 4 + furnished_below(f, 6); i > 0; i--) furnished_furniture(f);
    }
    f->labels[0] = "storey";
    furnished_finish(f);
}

static void furnished_make(furnished *f, unsigned seed, int width, int height) {
    static const char *const names[6] = { "panel", "floor lamp", "spot", "small lamp", "uplight", "windows" };
    int kinds[2], i, k, pieces;
    f->random = 0x5b1u + 7919u * (uint64_t)seed;
    if (seed >= FURNISHED_STOREY) { furnished_storey(f, width, height); return; }
    f->size[0] = furnished_between(f, 2.8, 6.5);
    f->size[1] = furnished_between(f, 2.3, 3.2);
    f->size[2] = furnished_between(f, 2.8, 6.5);
    kinds[0] = (int)(seed / 2 % 6);  /* even and odd seeds get the same kinds of light */
    kinds[1] = furnished_below(f, 5) < 2 ? furnished_below(f, 6) : kinds[0];
    if (furnished_below(f, 4) == 0) {
        f->size[0] += 2.5;
        f->split = f->size[0] * furnished_between(f, 0.45, 0.65);
    }
    furnished_camera(f, width, height);
    for (i = 0; i < 2; i++) f->labels[i] = i == 0 || kinds[1] != kinds[0] ? names[kinds[i]] : NULL;
    f->labels[2] = f->split > 0 ? "two rooms" : NULL;
    furnished_shell(f, kinds[0] == 5 || kinds[1] == 5 ? 1 + furnished_below(f, 2) : 0);
    if (f->split > 0) furnished_partition(f, f->split);
    for (k = 0; k < 3; k++) f->scene.sky[k] = (float)(f->window_count ? 3 + k : 0);
    for (i = 0; i < 2; i++) if (f->labels[i] && kinds[i] != 5) furnished_lamp(f, kinds[i]);
    pieces = 4 + furnished_below(f, 9);
    for (i = 0; i < pieces; i++) furnished_furniture(f);
    furnished_finish(f);
}

static void furnished_free(furnished *f) {
    free(f->positions);
    memset(f, 0, sizeof *f);
}

#endif
