/* Classifies a scene, so that tools can choose a camera and light for it: an object to view from outside, a room to
   view from inside, or a room with one open side. Include after tool.h.

   The survey uses readings of sbl.h (sbl_readings_desc). At the points of a grid over the bounds, and from outside,
   they tell which fractions of the directions see the sky and back faces. Light is used only to decide whether the
   outside is dark, and to reduce the rating of views of dark parts of a room. A survey traces about 37,000 rays, and
   for a room 14,000 to 28,000 more. The picture reuses the hierarchy that is built for them. */
#ifndef TOOL_SURVEY_H
#define TOOL_SURVEY_H

#include <math.h>

typedef enum survey_kind {
    SURVEY_OBJECT,     /* to be viewed from outside */
    SURVEY_OPEN_ROOM,  /* to be viewed through its open side */
    SURVEY_ROOM        /* to be viewed from inside */
} survey_kind;

typedef struct survey {
    survey_kind kind;
    sbl_bounds bounds;
    double from[3];      /* SURVEY_OBJECT: unit vector from the scene to the camera */
    int side;            /* SURVEY_OPEN_ROOM: the open side; 0 to 5 are +x -x +y -y +z -z */
    double eye[3], forward[3];  /* SURVEY_ROOM: camera position; horizontal unit vector, the longest view */
    double middle[3];    /* rooms: a point in the air, rather high up, in the middle of the visible part */
    double free;         /* rooms: about the distance from `middle` to the nearest surface */
    double far;          /* rooms: about the mean distance of the visible surfaces */
} survey;

enum {
    SURVEY__X = 6, SURVEY__Y = 5, SURVEY__Z = 6, SURVEY__POINTS = SURVEY__X * SURVEY__Y * SURVEY__Z,  /* the grid */
    SURVEY__AXES = 6,      /* directions of readings at each grid point, in the order of survey.side */
    SURVEY__WAYS = 12,     /* horizontal directions in which views are tried from each point of a room */
    SURVEY__AROUND = 8,    /* compass directions from which the scene is viewed from outside, each at two elevations */
    SURVEY__OUTSIDE = 2 * SURVEY__AROUND,
    SURVEY__REPEATS = 4,   /* readings per outside direction; several, because many rays miss the scene */
    SURVEY__SITES = SURVEY__POINTS * SURVEY__WAYS,
    SURVEY__RAYS = 32      /* rays of each reading */
};

/* Thresholds that separate the cases. Real scenes differ from them by a wide margin on both sides. */
#define SURVEY__SOLID 0.25     /* a point that sees more back faces is inside a solid, as for sbl_probe.valid */
#define SURVEY__ENCLOSED 0.35  /* a point that sees less sky is in a room; in the open, half is sky */
#define SURVEY__OPEN 0.6       /* a side is open if at least this fraction of the directions through it sees the sky */
#define SURVEY__SHUT 0.4       /* a side is closed if at most this fraction sees the sky, as for walls with windows */
#define SURVEY__OUTWARD 0.25   /* from outside, an object shows at most this fraction of back faces */
#define SURVEY__INWARD 0.6     /* from outside, a room of single faces shows at least this fraction of back faces */
#define SURVEY__DARK 0.02      /* the outside is dark if it receives at most this fraction of the light in the rooms */

typedef struct survey__point {
    double position[3], sky, back;  /* sky, back: fractions of all directions that see the sky and back faces */
    double light, near;             /* mean R; distance to the nearest surface */
} survey__point;

typedef struct survey__work {
    sbl_context *context;
    survey *result;
    sbl_site sites[SURVEY__SITES];
    sbl_reading readings[SURVEY__SITES];
    int count;                                 /* number of sites */
    survey__point points[SURVEY__POINTS];
    double openness[SURVEY__AXES];             /* fraction of sky seen through each side */
    double outside[SURVEY__OUTSIDE];           /* fraction of back faces seen from each outside direction */
    double inside_light, outside_light;        /* mean R in the air of rooms; mean R at the outside of the bounds */
} survey__work;

static double survey__size(const survey *s, int k) {
    return (double)s->bounds.highest[k] - (double)s->bounds.lowest[k];
}

static double survey__center(const survey *s, int k) {
    return 0.5 * ((double)s->bounds.highest[k] + (double)s->bounds.lowest[k]);
}

/* Returns the radius of the sphere around the bounds. */
static double survey__radius(const survey *s) {
    return 0.5 * sqrt(pow(survey__size(s, 0), 2) + pow(survey__size(s, 1), 2) + pow(survey__size(s, 2), 2));
}

/* Computes the direction with the index i from which the scene is viewed from outside. The first is from the front,
   slightly from the right and from above; the others go around the scene; then the same follows at a higher elevation.
   Flat scenes are viewed from higher up. */
static void survey__direction(const survey *s, int i, double out[3]) {
    static const double front = 0.375;  /* radians to the right of +z */
    const double turn = front + (i % SURVEY__AROUND) * (2 * 3.14159265358979 / SURVEY__AROUND);
    const double wide = sqrt(pow(survey__size(s, 0), 2) + pow(survey__size(s, 2), 2));
    const double flat = wide > 0 ? 1 - 4 * survey__size(s, 1) / wide : 0;
    const double up = i >= SURVEY__AROUND ? 0.75 : flat > 0 ? 0.3 + 0.25 * flat : 0.3;
    out[0] = sqrt(1 - up * up) * sin(turn);
    out[1] = up;
    out[2] = sqrt(1 - up * up) * cos(turn);
}

/* Initialises a survey without readings: the scene counts as an object, seen from the front. */
static void survey_begin(survey *s, sbl_context *context) {
    memset(s, 0, sizeof *s);
    s->bounds = sbl_query_bounds(context);
    survey__direction(s, 0, s->from);
}

/* ---- taking readings ---- */

static void survey__add(survey__work *w, const double position[3], const double normal[3]) {
    sbl_site *site = &w->sites[w->count++];
    int k;
    memset(site, 0, sizeof *site);
    for (k = 0; k < 3; k++) {
        site->position[k] = (float)position[k];
        site->normal[k] = (float)normal[k];
    }
}

static sbl_result survey__read(survey__work *w) {
    sbl_readings_desc desc;
    sbl_result result;
    memset(&desc, 0, sizeof desc);
    desc.sites = w->sites;
    desc.readings = w->readings;
    desc.site_count = w->count;
    desc.options.mode = SBL_MODE_DIRECT;
    desc.options.rays = SURVEY__RAYS;
    result = sbl_begin_readings(w->context, &desc);
    if (result == SBL_SUCCESS) result = work(w->context);
    if (result == SBL_UNFINISHED) sbl_end(w->context);
    return result;
}

static void survey__axis(int side, double out[3]) {
    out[0] = out[1] = out[2] = 0;
    out[side / 2] = side % 2 ? -1 : 1;
}

/* Returns the index of a grid point along axis k. across: receives the number of grid points along this axis */
static int survey__index(int point, int k, int *across) {
    *across = k == 0 ? SURVEY__X : k == 1 ? SURVEY__Y : SURVEY__Z;
    return k == 0 ? point % SURVEY__X : k == 1 ? point / SURVEY__X % SURVEY__Y : point / (SURVEY__X * SURVEY__Y);
}

/* Lists all sites: those of the grid, those that view the scene from outside, and those on the outer sides of the
   bounds. */
static void survey__sites(survey__work *w) {
    const survey *s = w->result;
    double at[3], axis[3], from[3];
    int i, k, side, across;
    for (i = 0; i < SURVEY__POINTS; i++) {
        for (k = 0; k < 3; k++) {
            const double cell = survey__index(i, k, &across) + 0.5;
            at[k] = w->points[i].position[k] = (double)s->bounds.lowest[k] + survey__size(s, k) * cell / across;
        }
        for (side = 0; side < SURVEY__AXES; side++) {
            survey__axis(side, axis);
            survey__add(w, at, axis);
        }
    }
    for (i = 0; i < SURVEY__OUTSIDE * SURVEY__REPEATS; i++) {
        survey__direction(s, i / SURVEY__REPEATS, from);
        for (k = 0; k < 3; k++) {
            at[k] = survey__center(s, k) + 1.2 * survey__radius(s) * from[k];
            from[k] = -from[k];
        }
        survey__add(w, at, from);
    }
    for (side = 0; side < SURVEY__AXES; side++) {
        survey__axis(side, axis);
        for (k = 0; k < 3; k++) at[k] = survey__center(s, k) + 0.51 * survey__size(s, k) * axis[k];
        survey__add(w, at, axis);
    }
}

static double survey__sky(const sbl_reading *r) { return 1 - (double)r->hit_share; }
static double survey__back(const sbl_reading *r) { return (double)r->hit_share * (double)r->back_share; }
static double survey__light(const sbl_reading *r) {
    return ((double)r->radiance[0] + (double)r->radiance[1] + (double)r->radiance[2]) / 3;
}

/* Computes sums over the readings of survey__sites. */
static void survey__sum(survey__work *w) {
    const sbl_reading *r = w->readings;
    int i, k, side, across;
    for (i = 0; i < SURVEY__POINTS; i++) {
        survey__point *p = &w->points[i];
        for (side = 0; side < SURVEY__AXES; side++, r++) {
            const int cell = survey__index(i, side / 2, &across);
            const double near = r->hit_share > 0 ? (double)r->hit_min : 2 * survey__radius(w->result);
            p->sky += survey__sky(r) / SURVEY__AXES;
            p->back += survey__back(r) / SURVEY__AXES;
            p->light += survey__light(r) / SURVEY__AXES;
            p->near = side == 0 || near < p->near ? near : p->near;
            if (cell == (side % 2 ? 0 : across - 1))
                w->openness[side] += survey__sky(r) * across / SURVEY__POINTS;
        }
    }
    for (i = 0; i < SURVEY__OUTSIDE; i++) {
        double seen = 0;
        for (k = 0; k < SURVEY__REPEATS; k++, r++) {
            seen += (double)r->hit_share;
            w->outside[i] += survey__back(r);
        }
        w->outside[i] = seen > 0 ? w->outside[i] / seen : 0;
    }
    for (side = 0; side < SURVEY__AXES; side++, r++) w->outside_light += survey__light(r) / SURVEY__AXES;
}

/* ---- classifying the scene ---- */

/* Returns the mean fraction of back faces seen from outside. */
static double survey__inwardness(const survey__work *w) {
    double sum = 0;
    int i;
    for (i = 0; i < SURVEY__OUTSIDE; i++) sum += w->outside[i];
    return sum / SURVEY__OUTSIDE;
}

/* Returns 1 if a point is in the air of a room. If the outside shows about as many back faces as front faces, the
   winding of the file does not tell what is solid, so back faces are ignored. */
static int survey__in_room(const survey__work *w, const survey__point *p) {
    const double inwardness = survey__inwardness(w);
    const int telling = inwardness <= SURVEY__OUTWARD || inwardness >= SURVEY__INWARD;
    return p->sky < SURVEY__ENCLOSED && (p->back < SURVEY__SOLID || !telling);
}

/* Returns the number of points in rooms, and computes the mean light there. Returns 0 if most points that see little
   sky are inside solids, as in a closed object with random winding. */
static int survey__rooms(survey__work *w) {
    int i, count = 0, enclosed = 0;
    for (i = 0; i < SURVEY__POINTS; i++) {
        enclosed += w->points[i].sky < SURVEY__ENCLOSED;
        if (!survey__in_room(w, &w->points[i])) continue;
        w->inside_light += w->points[i].light;
        count++;
    }
    if (count) w->inside_light /= count;
    return 2 * count >= enclosed ? count : 0;
}

/* Returns the side that is open while all others are closed; -1 if all are closed; -2 if the case is unclear. */
static int survey__open_side(const survey__work *w) {
    int side, open = -1;
    for (side = 0; side < SURVEY__AXES; side++) {
        if (w->openness[side] <= SURVEY__SHUT) continue;
        if (w->openness[side] < SURVEY__OPEN || open >= 0) return -2;
        open = side;
    }
    return open;
}

/* Returns the fraction of back faces that are seen from outside direction i, smoothed: the two directions beside it at
   the same elevation have a quarter of the weight each. */
static double survey__backs(const survey__work *w, int i) {
    const int ring = i / SURVEY__AROUND * SURVEY__AROUND, left = (i + 1) % SURVEY__AROUND;
    const int right = (i + SURVEY__AROUND - 1) % SURVEY__AROUND;
    return 0.5 * w->outside[i] + 0.25 * (w->outside[ring + left] + w->outside[ring + right]);
}

/* Chooses the direction that shows the front of an object: the first direction, unless it shows mostly back faces, like
   a corner of two walls, and another shows less than half as many. Among several such directions, a later one replaces
   an earlier one only if its fraction of back faces is lower by more than 0.1. The order is: from behind, from both
   sides alternately, and then the same at the higher elevation. */
static void survey__choose_front(survey__work *w) {
    int i, best = 0;
    for (i = 1; i < SURVEY__OUTSIDE && w->outside[0] > 0.5; i++) {
        const int half = SURVEY__AROUND / 2, ring = i / SURVEY__AROUND, at = i % SURVEY__AROUND;
        const int next = ring * SURVEY__AROUND + at % 2 * half + at / 2;
        if (survey__backs(w, next) < 0.5 * survey__backs(w, 0) && survey__backs(w, next) < survey__backs(w, best) - 0.1)
            best = next;
    }
    survey__direction(w->result, best, w->result->from);
}

static survey_kind survey__decide(survey__work *w) {
    const double inwardness = survey__inwardness(w);
    const int open = survey__open_side(w), rooms = survey__rooms(w);
    const int dark = w->outside_light <= SURVEY__DARK * w->inside_light && w->inside_light > 0;
    if (inwardness > SURVEY__OUTWARD && open >= 0 && open / 2 != 1) {
        w->result->side = open;
        return SURVEY_OPEN_ROOM;
    }
    survey__choose_front(w);
    if (rooms < SURVEY__POINTS / 36) return SURVEY_OBJECT;
    if (inwardness >= SURVEY__INWARD && open != 2) return SURVEY_ROOM;
    return dark && (open == -1 || open == 3) ? SURVEY_ROOM : SURVEY_OBJECT;
}

/* ---- choosing the position in a room ---- */

/* Returns 1 if a point is in a room, at half the height that the room has there. */
static int survey__at_eye_height(const survey__work *w, int point) {
    int low = point, high = point, across;
    const int y = survey__index(point, 1, &across), lowest = point - y * SURVEY__X;
    if (!survey__in_room(w, &w->points[point])) return 0;
    while (low > lowest && survey__in_room(w, &w->points[low - SURVEY__X])) low -= SURVEY__X;
    while (high < lowest + (across - 1) * SURVEY__X && survey__in_room(w, &w->points[high + SURVEY__X]))
        high += SURVEY__X;
    return abs(2 * point - low - high) <= SURVEY__X;
}

/* Returns the index of the site at the same point as site i, rotated by `turn` directions. */
static int survey__turned(int i, int turn) {
    return i - i % SURVEY__WAYS + (i + SURVEY__WAYS + turn) % SURVEY__WAYS;
}

/* Rates the view of the site with the index i: the mean distance ahead, minus half of the mean distance behind, which
   favours the ends of a room. Views that receive hardly any direct light from ahead count half. Views that are not
   parallel to an axis count a tenth more, because they show a corner instead of a wall. The means are over hemispheres,
   so that a view along a nearby wall does not count as long. */
static double survey__rate(const survey__work *w, int i) {
    const sbl_reading *r = &w->readings[i], *behind = &w->readings[survey__turned(i, SURVEY__WAYS / 2)];
    const double open = (double)r->hit_share * (1 - (double)r->back_share);
    const double usual = 0.1 * w->inside_light, lit = survey__light(r) < usual ? survey__light(r) / usual : 1;
    double near = (double)r->hit_min, far = (double)r->hit_mean, clear;
    int side;
    for (side = -2; side <= 2; side++) near = fmin(near, (double)w->readings[survey__turned(i, side)].hit_min);
    clear = near > 0 ? near / (near + 0.02 * far) : 0;  /* a surface in front or beside is close */
    return open * (far - 0.5 * (double)behind->hit_mean) * clear * (0.5 + 0.5 * lit) * (i % 3 ? 1.1 : 1);
}

/* Tries views from the points of rooms, chooses the best, and steps back as far as there is space. If no view is good,
   the scene becomes an object. */
static sbl_result survey__stand(survey__work *w) {
    survey *s = w->result;
    double best = 0;
    int i, k, way;
    sbl_result result;
    w->count = 0;
    for (i = 0; i < SURVEY__POINTS; i++)
        for (way = 0; way < SURVEY__WAYS && survey__at_eye_height(w, i); way++) {
            const double turn = 2 * 3.14159265358979 * way / SURVEY__WAYS;
            const double forward[3] = { sin(turn), 0, cos(turn) };
            survey__add(w, w->points[i].position, forward);
        }
    result = survey__read(w);
    for (i = 0; i < w->count && result == SBL_SUCCESS; i++) {
        const sbl_site *site = &w->sites[i];
        const sbl_reading *behind = &w->readings[survey__turned(i, SURVEY__WAYS / 2)];
        const double rate = survey__rate(w, i), step = 0.7 * (double)behind->hit_min;
        if (rate <= best) continue;
        best = rate;
        s->far = (double)w->readings[i].hit_mean;
        for (k = 0; k < 3; k++) {
            s->forward[k] = (double)site->normal[k];
            s->eye[k] = (double)site->position[k] - step * s->forward[k];
        }
    }
    if (result == SBL_SUCCESS && !(best > 0)) s->kind = SURVEY_OBJECT;
    return result;
}

/* Chooses survey.middle: a point of a room, high up if possible, near the middle of the view, with space around it. */
static void survey__choose_middle(survey__work *w) {
    survey *s = w->result;
    double best = 0, aim[3], axis[3];
    int i, k, across;
    survey__axis(s->side, axis);
    if (s->kind == SURVEY_OPEN_ROOM) s->far = 0.5 * survey__size(s, s->side / 2);
    for (k = 0; k < 3; k++)
        aim[k] = s->kind == SURVEY_ROOM ? s->eye[k] + 0.5 * s->far * s->forward[k] : survey__center(s, k);
    for (i = 0; i < SURVEY__POINTS; i++) {
        const survey__point *p = &w->points[i];
        const double away = sqrt(pow(p->position[0] - aim[0], 2) + pow(p->position[2] - aim[2], 2));
        const double height = (survey__index(i, 1, &across) + 0.5) / SURVEY__Y;
        const double score = (1 - fabs(height - 0.7)) * p->near / (p->near + away + 1e-6 * survey__radius(s));
        if (!survey__in_room(w, p) || score <= best) continue;
        best = score;
        s->free = p->near;
        for (k = 0; k < 3; k++) s->middle[k] = p->position[k];
    }
}

/* Surveys the scene of the context. Returns SBL_UNFINISHED after a signal. */
static sbl_result survey_take(survey *s, sbl_context *context) {
    survey__work *w = (survey__work *)calloc(1, sizeof *w);
    sbl_result result = SBL_ERROR_OUT_OF_MEMORY;
    survey_begin(s, context);
    if (w && survey__radius(s) > 0) {
        w->context = context;
        w->result = s;
        survey__sites(w);
        result = survey__read(w);
        if (result == SBL_SUCCESS) {
            survey__sum(w);
            s->kind = survey__decide(w);
            if (s->kind == SURVEY_ROOM) result = survey__stand(w);
            if (s->kind != SURVEY_OBJECT) survey__choose_middle(w);
        }
    } else if (w) result = SBL_SUCCESS;  /* a point or an empty scene counts as an object */
    free(w);
    return result;
}

/* Measures whether a point is enclosed. distance: receives the mean distance of the surfaces around it, or 0 if it is
   in the open */
static inline sbl_result survey_enclosed(sbl_context *context, const double at[3], double *distance) {
    survey__work *w = (survey__work *)calloc(1, sizeof *w);
    double axis[3], sky = 0, sum = 0;
    sbl_result result = SBL_ERROR_OUT_OF_MEMORY;
    int side;
    *distance = 0;
    if (!w) return result;
    w->context = context;
    for (side = 0; side < SURVEY__AXES; side++) {
        survey__axis(side, axis);
        survey__add(w, at, axis);
    }
    result = survey__read(w);
    for (side = 0; side < SURVEY__AXES && result == SBL_SUCCESS; side++) {
        sky += survey__sky(&w->readings[side]) / SURVEY__AXES;
        sum += (double)w->readings[side].hit_mean / SURVEY__AXES;
    }
    if (sky < SURVEY__ENCLOSED) *distance = sum;
    free(w);
    return result;
}

#endif
