/* Divides a picture into windows: for parts on several machines, and for pictures that are too large to be rendered at
   once. Include after tool_scene.h, tool_part.h, picture_file.h and picture_parts.h.

   A plan lists the windows, and the facts that they share (see picture_parts.h). It is a text file with one fact or
   window per line. Parts that were made with the same plan fit together, even if their GL drivers differ. */
#ifndef TOOL_PLAN_H
#define TOOL_PLAN_H

#include <dirent.h>
#include <float.h>
#include <sys/file.h>

/* ---- estimating the cost ---- */

/* Sums of cost over a small version of the picture: sums[y * (width + 1) + x] is the cost of all pixels above y and
   left of x. */
typedef struct plan_cost { int width, height; double *sums; } plan_cost;

/* Cost of a pixel in addition to the work of the small version's sensors there, relative to the mean work. It stands
   for the sensors of the first level, which are everywhere, and for the work on pixels that needs no rays. Lightmaps
   count looks instead of the steps of rays. */
#define PLAN_BASE_PICTURE 0.02
#define PLAN_BASE_LIGHTMAP 0.4

/* Computes the sums. Returns 0 if memory runs out. work: SBL_CHANNEL_WORK of the small version; fraction:
   PLAN_BASE_... */
static int plan_cost_make(plan_cost *c, const image *work, double fraction) {
    const size_t across = (size_t)work->width + 1;
    double base = 0;
    int x, y;
    c->width = work->width;
    c->height = work->height;
    c->sums = (double *)calloc(across * ((size_t)work->height + 1), sizeof *c->sums);
    if (!c->sums) return 0;
    for (x = 0; x < work->width * work->height; x++) base += (double)work->values[x];
    base = fraction * base / work->width / work->height + 1e-9;
    for (y = 0; y < work->height; y++)
        for (x = 0; x < work->width; x++) {
            double *sum = &c->sums[(size_t)y * across + (size_t)x];
            sum[across + 1] = sum[across] + sum[1] - sum[0] + base + (double)work->values[y * work->width + x];
        }
    return 1;
}

/* Returns the cost of the area above and left of a point. x, y: fractions of the width and height of the picture */
static double plan__cost_before(const plan_cost *c, double x, double y) {
    const double px = fmin(fmax(x, 0), 1) * c->width, py = fmin(fmax(y, 0), 1) * c->height;
    const int ix = (int)fmin(px, c->width - 1), iy = (int)fmin(py, c->height - 1);
    const double fx = px - ix, fy = py - iy, *s = &c->sums[(size_t)iy * ((size_t)c->width + 1) + (size_t)ix];
    const double *below = s + c->width + 1;
    return (1 - fy) * ((1 - fx) * s[0] + fx * s[1]) + fy * ((1 - fx) * below[0] + fx * below[1]);
}

#define PLAN_MARGIN 6  /* pixels; a window costs about as much as one that is wider by this at each side */

/* Returns the cost of a window of a picture with this size. c: NULL: the cost is the area of the window in pixels */
static double plan__cost(const plan_cost *c, const int size[2], const int w[4]) {
    const double x0 = (double)(w[0] - PLAN_MARGIN) / size[0], x1 = (double)(w[0] + w[2] + PLAN_MARGIN) / size[0];
    const double y0 = (double)(w[1] - PLAN_MARGIN) / size[1], y1 = (double)(w[1] + w[3] + PLAN_MARGIN) / size[1];
    if (!c) return (double)w[2] * w[3];
    return plan__cost_before(c, x1, y1) - plan__cost_before(c, x0, y1) - plan__cost_before(c, x1, y0) +
           plan__cost_before(c, x0, y0);
}

/* ---- dividing into windows ---- */

typedef struct plan {
    picture_fact facts[PICTURE_FACTS];
    int count;                  /* number of windows */
    int (*windows)[4];          /* x, y, width, height */
} plan;

enum { PLAN_TILE = 16 };  /* windows end at multiples of this number of pixels */

static void plan_free(plan *p) {
    free(p->windows);
    p->windows = NULL;
    p->count = 0;
}

/* Finds where to cut a window in two along an axis (0 or 1), so that the first part has nearly its share of the cost
   and both parts have enough pixels for their windows. Returns the size of the first part along the axis, or 0 if no
   cut is possible. counts: number of windows in each part */
static int plan__cut(const plan_cost *c, const int size[2], const int w[4], int axis, const int counts[2]) {
    const double fraction = (double)counts[0] / (counts[0] + counts[1]);
    const int step = w[2 + axis] >= 2 * PLAN_TILE ? PLAN_TILE : 1, other = w[3 - axis];
    double least = 2;
    int at, best = 0;
    for (at = step - w[axis] % step; at < w[2 + axis]; at += step) {
        int parts[2][4];
        double costs[2], off;
        if ((double)at * other < counts[0] || (double)(w[2 + axis] - at) * other < counts[1]) continue;
        memcpy(parts[0], w, sizeof parts[0]);
        memcpy(parts[1], w, sizeof parts[1]);
        parts[0][2 + axis] = at;
        parts[1][axis] += at;
        parts[1][2 + axis] -= at;
        costs[0] = plan__cost(c, size, parts[0]);
        costs[1] = plan__cost(c, size, parts[1]);
        off = fabs(costs[0] / (costs[0] + costs[1]) - fraction);
        if (off < least) { least = off; best = at; }
    }
    return best;
}

static double plan_divide(plan *p, const plan_cost *c, const int size[2], const int window[4], int count);

/* Cuts a window in two along an axis and divides both parts. counts: number of windows in each. Returns the same as
   plan_divide. */
static double plan__divide_along(plan *p, const plan_cost *c, const int size[2], const int window[4], int axis,
                                 const int counts[2]) {
    const int at = plan__cut(c, size, window, axis, counts);
    int parts[2][4];
    double costs[2];
    if (!at) return -1;
    memcpy(parts[0], window, sizeof parts[0]);
    memcpy(parts[1], window, sizeof parts[1]);
    parts[0][2 + axis] = at;
    parts[1][axis] += at;
    parts[1][2 + axis] -= at;
    costs[0] = plan_divide(p, c, size, parts[0], counts[0]);
    costs[1] = costs[0] < 0 ? -1 : plan_divide(p, c, size, parts[1], counts[1]);
    return costs[1] < 0 ? -1 : fmax(costs[0], costs[1]);
}

enum { PLAN_SEARCHED = 16 };  /* up to this number of windows, plan_divide tries several ways to divide */

/* Divides a window into `count` windows of nearly equal cost, and adds them to p->windows. Returns the cost of the most
   expensive one, or a negative number if the window has too few pixels. Tries cuts along both axes, with half of the
   windows in each part, one more, or one fewer; many windows are first divided in halves along the longer axis. c:
   NULL: the cost is the area, and the longer axis is always preferred */
static double plan_divide(plan *p, const plan_cost *c, const int size[2], const int window[4], int count) {
    const int searches = c && count <= PLAN_SEARCHED, longer = window[3] > window[2], from = p->count;
    int best[PLAN_SEARCHED][4], way;
    double least = -1;
    if (count == 1) {
        memcpy(p->windows[p->count++], window, sizeof p->windows[0]);
        return plan__cost(c, size, window);
    }
    for (way = 0; way < 6 && (searches || (least < 0 && way < 2)); way++) {
        const int first = count / 2 + (way / 2 == 1) - (way / 2 == 2), counts[2] = { first, count - first };
        double most;
        if (counts[0] < 1 || counts[1] < 1) continue;
        p->count = from;
        most = plan__divide_along(p, c, size, window, way % 2 ? !longer : longer, counts);
        if (most < 0 || (least >= 0 && most >= least)) continue;
        least = most;
        if (searches) memcpy(best, p->windows + from, (size_t)count * sizeof *best);
    }
    if (searches && least >= 0) memcpy(p->windows + from, best, (size_t)count * sizeof *best);
    p->count = least >= 0 ? from + count : from;
    return least;
}

/* Returns 1 if all windows are inside a region and together have at least as many pixels as the region. */
static int plan_fills(const plan *p, const int region[4]) {
    double pixels = 0;
    int i, k, inside = 1;
    for (i = 0; i < p->count; i++) {
        const int *w = p->windows[i];
        pixels += (double)w[2] * w[3];
        for (k = 0; k < 2; k++) inside &= w[k] >= region[k] && w[k] + w[2 + k] <= region[k] + region[2 + k];
    }
    return inside && pixels >= (double)region[2] * region[3];
}

/* Makes a plan of `count` windows. Returns the exit status. */
static int plan_make(plan *p, const plan_cost *c, const int size[2], const int window[4], int count) {
    plan_free(p);
    p->windows = (int (*)[4])calloc((size_t)count, sizeof *p->windows);
    if (!p->windows) return fail("out of memory");
    if (plan_divide(p, c, size, window, count) >= 0) return DONE;
    return misuse("%d parts are too many for a picture of %d x %d pixels", count, window[2], window[3]);
}

/* ---- facts ---- */

static void plan_fact(plan *p, int fact, const char *format, ...) {
    va_list arguments;
    p->facts[fact].name = fact_names[fact];
    va_start(arguments, format);
    vsnprintf(p->facts[fact].text, sizeof p->facts[fact].text, format, arguments);
    va_end(arguments);
}

/* Sets the fact with the options; see plan_options. Control characters, which file names may contain, become question
   marks, because a fact of a plan is one line. A hash replaces a text that is too long for a fact. */
static void plan_options_fact(plan *p, const tool_option *table, int count, const int *given, const int *without) {
    char text[16 * PICTURE_FACT_SIZE], *c;
    plan_options(text, sizeof text, table, count, given, without);
    for (c = text; *c; c++) if ((unsigned char)*c < 32) *c = '?';
    if (c - text < PICTURE_FACT_SIZE) plan_fact(p, FACT_OPTIONS, "%s", text);
    else plan_fact(p, FACT_OPTIONS, "%016llx", plan_hash(PLAN_HASH_START, text, (size_t)(c - text)));
}

/* ---- the small version of a picture ---- */

/* Returns the reduction factor of the small picture or lightmap from which windows get their mean and price (see ON
   PARTS in sbl.h). across: width or height of the full picture in pixels, whichever is larger */
static double plan_small(double across) {
    enum { SHRINK = 4, LEAST = 192, MOST = 512 };  /* usual factor; range of the small width or height */
    return fmax(1, across / fmin(fmax(across / SHRINK, LEAST), MOST));
}

#define PRICE_GROWTH 0.4  /* the price grows with this power of the number of pixels; see ON PARTS in sbl.h */

/* Sets the facts that windows copy into their descriptors, except the exposure: the means, the prices with the rays per
   look, and the cells of the store. stats: of the small version. shrink: its reduction factor */
static void plan_set(plan *p, const sbl_stats *stats, double shrink) {
    const float *mean = stats->picture.mean_radiance, *final = stats->picture.mean_final;
    const double growth = pow(shrink, 2 * PRICE_GROWTH);
    plan_fact(p, FACT_MEAN, "%.9g %.9g %.9g %.9g %.9g %.9g", (double)mean[0], (double)mean[1], (double)mean[2],
              (double)final[0], (double)final[1], (double)final[2]);
    plan_fact(p, FACT_PRICE, "%.9g %.9g %d", (double)stats->picture.price * growth,
              (double)stats->picture.specular_price * growth, stats->picture.look_rays);
    plan_fact(p, FACT_CELLS, "%d", stats->store.max_cells);
}

/* Returns 1 if the function `look` finds this fact with a small version of the result (see tool_windows.h). Runs know
   the other facts before. */
static int plan__comes_from_look(int fact) {
    return fact == FACT_MEAN || fact == FACT_PRICE || fact == FACT_CELLS || fact == FACT_EXPOSURE;
}

/* Checks the text of a fact that was read from a plan. The fact is one of those for which plan__comes_from_look returns
   1. Returns 1 if the text has as many numbers as the fact needs, and if all of them are in their ranges. */
static int plan__is_valid(int fact, const char *text) {
    const int count = fact == FACT_MEAN ? 6 : fact == FACT_PRICE ? 2 : 1;
    double numbers[6] = { 0, 0, 0, 0, 0, 0 };
    int k, rays, cells = 0, end = 0, ok;
    if (fact == FACT_PRICE) ok = sscanf(text, "%lf %lf %d%n", &numbers[0], &numbers[1], &rays, &end) == 3;
    else if (fact == FACT_CELLS) ok = sscanf(text, "%d%n", &cells, &end) == 1 && cells <= 1 << 20;
    else if (fact == FACT_EXPOSURE) ok = sscanf(text, "%lf%n", &numbers[0], &end) == 1;
    else ok = sscanf(text, "%lf %lf %lf %lf %lf %lf%n", &numbers[0], &numbers[1], &numbers[2], &numbers[3], &numbers[4],
                     &numbers[5], &end) == 6;
    for (k = 0; k < count && ok; k++)
        ok = fabs(numbers[k]) <= FLT_MAX && (fact == FACT_EXPOSURE || numbers[k] >= 0);
    return ok && !text[end] && (!cells || cells >= 1024);
}

/* Gets means, prices, rays per look and cells from the facts. Sets only these fields of the descriptor. */
static void plan_use(const plan *p, sbl_picture_desc *d) {
    double numbers[8] = { 0, 0, 0, 0, 0, 0, 0, 0 };
    int k;
    sscanf(p->facts[FACT_MEAN].text, "%lf %lf %lf %lf %lf %lf", &numbers[0], &numbers[1], &numbers[2], &numbers[3],
           &numbers[4], &numbers[5]);
    sscanf(p->facts[FACT_PRICE].text, "%lf %lf %d", &numbers[6], &numbers[7], &d->look_rays);
    sscanf(p->facts[FACT_CELLS].text, "%d", &d->max_bounce_cells);
    for (k = 0; k < 3; k++) d->mean_radiance[k] = (float)numbers[k];
    for (k = 0; k < 3; k++) d->mean_final[k] = (float)numbers[3 + k];
    d->price = (float)numbers[6];
    d->specular_price = (float)numbers[7];
}

/* ---- the file of a plan ---- */

#define PLAN__HEADER "sbl plan 2\n"  /* the first line of a plan, with the version of the format */

static int plan_write(FILE *out, const void *what) {
    const plan *p = (const plan *)what;
    int i;
    fprintf(out, PLAN__HEADER);
    for (i = 0; i < FACT_PART; i++)
        fprintf(out, "%s %s\n", p->facts[i].name, i == FACT_RENDERER ? "" : p->facts[i].text);
    for (i = 0; i < p->count; i++)
        fprintf(out, "window %d %d %d %d\n", p->windows[i][0], p->windows[i][1], p->windows[i][2], p->windows[i][3]);
    fprintf(out, "end %d\n", p->count);
    return 1;
}

/* Reads the windows and the end of a plan. Returns 1 if they are valid. */
static int plan__read_windows(plan *p, FILE *in, const int size[2]) {
    char line[128];
    int room = 0, end = -1;
    plan_free(p);
    while (fgets(line, sizeof line, in) && sscanf(line, "end %d", &end) != 1) {
        int w[4];
        if (p->count == room) {
            int (*more)[4] = (int (*)[4])realloc(p->windows, ((size_t)room + 1024) * sizeof *more);
            if (!more) return 0;
            p->windows = more;
            room += 1024;
        }
        if (p->count == PARTS_MAX || sscanf(line, "window %d %d %d %d", &w[0], &w[1], &w[2], &w[3]) != 4) return 0;
        if (w[0] < 0 || w[1] < 0 || w[2] < 1 || w[3] < 1 || w[0] > size[0] - w[2] || w[1] > size[1] - w[3]) return 0;
        memcpy(p->windows[p->count++], w, sizeof w);
    }
    return p->count > 0 && end == p->count;
}

/* Reports the first fact in which a plan differs from this run. The hashes of scene and camera tell a user nothing, so
   that they are only reported if nothing else differs. Returns the exit status. made: the facts of the plan */
static int plan__refuse(const plan *p, const char *name, char (*made)[PICTURE_FACT_SIZE]) {
    static const int order[] = { FACT_VERSION, FACT_OPTIONS, FACT_CHANNEL, FACT_SIZE };
    size_t k = 0;
    while (k < sizeof order / sizeof *order && strcmp(made[order[k]], p->facts[order[k]].text) == 0) k++;
    if (k < sizeof order / sizeof *order)
        return fail("%s: this plan was made %s: it has %s, this run has %s; remove it, or give another name", name,
                    fact_words[order[k]], fact_shown(made[order[k]]), fact_shown(p->facts[order[k]].text));
    return fail("%s: this plan was made %s; remove it, or give another name", name,
                fact_words[strcmp(made[FACT_SCENE], p->facts[FACT_SCENE].text) == 0 ? FACT_CAMERA : FACT_SCENE]);
}

/* Reads a plan from a file. p must already have the facts of this run, except for those that come from `look`, which
   are read. Returns DONE; or FAILED with a message if the file is not a plan, or a plan of another picture; or -1 if
   the file does not exist. */
static int plan_read(plan *p, const char *name, const int size[2]) {
    static char line[PICTURE_FACT_SIZE + 64], made[FACT_COUNT][PICTURE_FACT_SIZE];
    FILE *in = input_open(name);
    int i, status = DONE, valid = 1, differs = 0;
    if (!in && errno == ENOENT) return -1;
    if (!in) return fail("%s: it cannot be read: %s", name, scene__why());
    if (!fgets(line, sizeof line, in) || strncmp(line, PLAN__HEADER, 9))
        status = fail("%s: it is not a plan of parts", name);
    else if (strcmp(line, PLAN__HEADER))
        status = fail("%s: another version of this program made this plan; remove it, or give another name", name);
    for (i = 0; i < FACT_PART && valid && status == DONE; i++) {
        const size_t length = strlen(fact_names[i]);
        const char *value = line + length + 1;
        char *end = fgets(line, sizeof line, in) ? strchr(line, '\n') : NULL;
        valid = end && strncmp(line, fact_names[i], length) == 0 && line[length] == ' ';
        if (!valid) break;
        *end = 0;
        snprintf(made[i], sizeof made[i], "%.*s", (int)sizeof made[i] - 1, value);
        if (plan__comes_from_look(i)) {
            plan_fact(p, i, "%s", value);
            valid = plan__is_valid(i, value);
        } else if (i != FACT_RENDERER) differs |= strcmp(value, p->facts[i].text) != 0;
    }
    if (status == DONE && valid && differs) status = plan__refuse(p, name, made);
    if (status == DONE && !(valid && plan__read_windows(p, in, size)))
        status = fail("%s: it is damaged; remove it", name);
    fclose(in);
    return status;
}

/* ---- the folder of finished windows ---- */

/* The folder for the windows of a picture: OUTPUT.parts/plan, /lock, /light, /1.exr, /2.exr, ... */
typedef struct plan_folder { char path[PATH_MAX]; int lock; } plan_folder;

/* Returns the path of a file in the folder. It is valid until the next call. */
static const char *plan_file(const plan_folder *f, const char *name) {
    static char path[PATH_MAX + 300];
    snprintf(path, sizeof path, "%s/%s", f->path, name);
    return path;
}

static const char *plan_window_file(const plan_folder *f, int number) {
    char name[32];
    snprintf(name, sizeof name, "%d.exr", number + 1);
    return plan_file(f, name);
}

/* Creates the folder if it does not exist, and locks it against other programs. Returns the exit status. */
static int plan_folder_open(plan_folder *f, const char *output) {
    if (snprintf(f->path, sizeof f->path, "%s.parts", output) >= (int)sizeof f->path - 16)
        return fail("%s: the name is too long", output);
    if (mkdir(f->path, 0777) != 0 && errno != EEXIST)
        return fail("%s: this folder for finished windows cannot be made: %s", f->path, strerror(errno));
    f->lock = open(plan_file(f, "lock"), O_RDWR | O_CREAT | O_CLOEXEC, 0666);
    if (f->lock < 0) return fail("%s: cannot be written: %s", plan_file(f, "lock"), strerror(errno));
    if (flock(f->lock, LOCK_EX | LOCK_NB) == 0 || errno != EWOULDBLOCK) return DONE;
    return fail("%s: another program is making this picture", f->path);
}

/* Removes the folder with the files of `count` windows, and temporary files of killed runs. */
static void plan_folder_remove(const plan_folder *f, int count) {
    const struct dirent *entry;
    DIR *in = opendir(f->path);
    int i;
    while (in && (entry = readdir(in)) != NULL) {
        const size_t length = strlen(entry->d_name);
        if (length > 5 && strcmp(entry->d_name + length - 5, ".part") == 0) unlink(plan_file(f, entry->d_name));
    }
    if (in) closedir(in);
    for (i = 0; i < count; i++) unlink(plan_window_file(f, i));
    unlink(plan_file(f, "light"));
    unlink(plan_file(f, "plan"));
    unlink(plan_file(f, "lock"));
    close(f->lock);
    rmdir(f->path);
}

#endif
