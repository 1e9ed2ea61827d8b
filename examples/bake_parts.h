/* Writes probes as .json and light at vertices as .ply, and joins the parts of such a file. A part is a valid file of
   its format, which also records facts about itself: what was baked, how, and which part this is. The joined file has
   no facts; it equals, byte for byte, the file of a bake that was not split. Joining reads one part at a time, and its
   memory use does not grow with the size of the files. Include after sbl.h, picture_file.h and part_list.h.

       bake_parts parts = { 0 }, *all = &parts;
       parts.is_ply = 1;                            // or 0: .json
       parts.cancel = &interrupted;
       for (...) ok = ok && bake_add(&parts, name);
       ok = ok && bake_check(&parts);               // parts.list.error says what is wrong
       ok = ok && output_write(&target, bake_write, &all, &interrupted);
       bake_free(&parts); */
#ifndef BAKE_PARTS_H
#define BAKE_PARTS_H

#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <sys/stat.h>

/* ---- facts that a part records ---- */

/* The facts of a part are texts. All except the last two must be the same in all parts. */
enum {
    BAKE_VERSION,   /* the version of sbl.h */
    BAKE_SCENE,     /* hash of meshes, materials, lights and sky, from sbl_scene_fingerprint */
    BAKE_WHAT,      /* "vertices", or the name of the set of probes */
    BAKE_OPTIONS,   /* the options that change the light, as the user gave them */
    BAKE_RENDERER,  /* GL_RENDERER */
    BAKE_PART,      /* which part this is, such as "3/16" */
    BAKE_TEXTS
};

static const char *const bake_names[BAKE_TEXTS] = { "version", "scene", "what", "options", "renderer", "part" };
static const char *const bake_words[BAKE_TEXTS] = { "by another version of sbl.h",
    "from another scene, or with other materials or lights", "of something else", "with other options",
    "by another driver", "as another part" };
static const int bake_order[] = { BAKE_VERSION, BAKE_WHAT, BAKE_OPTIONS, BAKE_SCENE, -1 };
static const part_kind bake_kind = { bake_names, bake_words, bake_order, 1u << BAKE_SCENE, BAKE_RENDERER };

/* The range of probes or meshes in a part: the index of the first, the number in this part, and the number in all
   parts. */
enum { BAKE_FIRST, BAKE_COUNT, BAKE_TOTAL, BAKE_RANGE };
static const char *const bake_range_names[BAKE_RANGE] = { "first", "count", "total" };

typedef struct bake_facts {
    picture_fact texts[PICTURE_FACTS];
    int range[BAKE_RANGE];
} bake_facts;

/* Sets the text of a fact. Characters that a JSON string or a line of a .ply cannot contain are written as \u0000 to
   \u00ff. Returns 0 if the text is too long. */
static inline int bake_fact(bake_facts *f, int fact, const char *text) {
    char *out = f->texts[fact].text;
    size_t used = 0;
    f->texts[fact].name = bake_names[fact];
    for (; *text && used + 7 <= PICTURE_FACT_SIZE; text++) {
        const unsigned c = (unsigned char)*text;
        if (c < 32 || c > 126 || c == '"' || c == '\\') used += (size_t)sprintf(out + used, "\\u%04x", c);
        else out[used++] = (char)c;
    }
    out[used] = 0;
    return !*text;
}

/* The names of the light groups of a bake, in the order in which the file stores their light. The array holds one more
   name than sbl.h allows groups. */
enum { BAKE_GROUP_NAME = 48 };
typedef struct bake_groups { int count; char names[SBL_MAX_LIGHT_GROUPS + 1][BAKE_GROUP_NAME]; } bake_groups;

static const char bake_letters[] = "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789_-";  /* in names */

/* ---- writing ---- */

/* The grid of probes. All counts are 0 if the positions were given as a list. layout: the origin and the spacing, as a
   line of the file */
typedef struct bake_grid { int count[3]; char layout[256]; } bake_grid;

/* Sets the layout of the grid. The probe with the index i + count[0] * (j + count[1] * k) is at origin + (i, j, k) *
   spacing, unless it was moved. lowest, highest: opposite corners of the box that the grid fills */
static inline void bake_grid_make_layout(bake_grid *g, const float lowest[3], const float highest[3]) {
    double origin[3], spacing[3];
    int k;
    for (k = 0; k < 3 && g->count[0]; k++) {
        const double fraction = 0.5 / g->count[k];  /* as in sbl.h, so that the origin is the first probe to the bit */
        origin[k] = (double)(float)((1 - fraction) * (double)lowest[k] + fraction * (double)highest[k]);
        spacing[k] = ((double)highest[k] - (double)lowest[k]) / g->count[k];
    }
    if (g->count[0])
        snprintf(g->layout, sizeof g->layout, "\"origin\": [%.9g, %.9g, %.9g], \"spacing\": [%.9g, %.9g, %.9g],\n",
                 origin[0], origin[1], origin[2], spacing[0], spacing[1], spacing[2]);
}

/* Lines of the file that explain the numbers of probes to the programmer of an engine. */
static const char *const bake_probes_about[] = {
    " \"units\": \"sh: radiance, cube: irradiance / pi; linear, primaries of BT.709; lengths as in the scene\",\n",
    " \"basis\": \"real orthonormal spherical harmonics of the degrees 0 to 2: Y_i(w) = constants[i] * functions[i], "
        "where w = (x, y, z) is the unit vector to where the light comes from; radiance(w) = sum of sh[i] * Y_i(w); "
        "irradiance(n) = sum of irradiance_weights[i] * sh[i] * Y_i(n); a matte surface with the normal n sends out "
        "albedo * irradiance(n) / pi\",\n",
    " \"functions\": [\"1\", \"y\", \"z\", \"x\", \"x*y\", \"y*z\", \"3*z*z - 1\", \"x*z\", \"x*x - y*y\"],\n",
    " \"constants\": [0.282094792, 0.488602512, 0.488602512, 0.488602512, 1.092548431, 1.092548431, 0.315391565, "
        "1.092548431, 0.546274215],\n",
    " \"irradiance_weights\": [3.141592654, 2.094395102, 2.094395102, 2.094395102, 0.785398163, 0.785398163, "
        "0.785398163, 0.785398163, 0.785398163],\n",
    " \"irradiance_over_pi_weights\": [1, 0.666666667, 0.666666667, 0.666666667, 0.25, 0.25, 0.25, 0.25, 0.25],\n",
    NULL
};

/* Writes the lines before the probes. facts: NULL if the file is not a part */
static inline void bake_put_probes_head(FILE *out, const bake_facts *facts, const bake_grid *grid,
    const bake_groups *groups) {
    int i;
    fprintf(out, "{");
    for (i = 0; i < BAKE_TEXTS && facts; i++)
        fprintf(out, "%s\"%s\": \"%s\"", i ? ", " : "\"sbl\": {", bake_names[i], facts->texts[i].text);
    for (i = 0; i < BAKE_RANGE && facts; i++) fprintf(out, ", \"%s\": %d", bake_range_names[i], facts->range[i]);
    if (facts) fprintf(out, "},\n");
    if (grid->count[0])
        fprintf(out, "%s\"grid\": [%d, %d, %d], %s", facts ? " " : "", grid->count[0], grid->count[1],
                grid->count[2], grid->layout);
    for (i = 0; bake_probes_about[i]; i++)
        fprintf(out, "%s", bake_probes_about[i] + (i == 0 && !facts && !grid->count[0]));
    for (i = 0; i < groups->count; i++) fprintf(out, "%s\"%s\"", i ? ", " : " \"groups\": [", groups->names[i]);
    if (groups->count) fprintf(out, "],\n");
    fprintf(out, " \"probes\": [");
}

static inline void bake__put_numbers(FILE *out, const char *name, const float *numbers, int count) {
    int i;
    fprintf(out, ", \"%s\": [", name);
    for (i = 0; i < count; i++) fprintf(out, "%s%.7g", i ? ", " : "", (double)numbers[i]);
    fputc(']', out);
}

/* Writes a list of colours. words: text that is written before it */
static inline void bake__put_colors(FILE *out, const char *words, const float (*colors)[3], int count) {
    int i;
    fprintf(out, "%s: [", words);
    for (i = 0; i < count; i++)
        fprintf(out, "%s[%.7g, %.7g, %.7g]", i ? ", " : "", (double)colors[i][0], (double)colors[i][1],
                (double)colors[i][2]);
    fputc(']', out);
}

/* Writes a probe as a line without the newline. bake__skip_probe accepts such lines. parts: the light of the groups at
   this probe */
static inline void bake_put_probe(FILE *out, const sbl_probe *q, const bake_groups *groups, const sbl_probe *parts) {
    int i;
    fprintf(out, "  {\"position\": [%.9g, %.9g, %.9g], \"valid\": %s", (double)q->position[0],
            (double)q->position[1], (double)q->position[2], q->valid ? "true" : "false");
    bake__put_colors(out, ", \"sh\"", q->sh, 9);
    bake__put_colors(out, ", \"cube\"", q->cube, 6);
    fprintf(out, ", \"sky\": %.7g", (double)q->sky);
    bake__put_numbers(out, "distance", q->distance, 8);
    bake__put_numbers(out, "distance_squared", q->distance_squared, 8);
    fprintf(out, ", \"back_share\": %.7g", (double)q->back_share);
    for (i = 0; i < groups->count; i++) {
        fprintf(out, "%s\"%s\": ", i ? ", " : ", \"groups\": {", groups->names[i]);
        bake__put_colors(out, "{\"sh\"", parts[i].sh, 9);
        bake__put_colors(out, ", \"cube\"", parts[i].cube, 6);
        fputc('}', out);
    }
    fprintf(out, groups->count ? "}}" : "}");
}

static const char bake_probes_end[] = "]}\n";  /* stands on a line of its own */

/* Sizes in bytes in a .ply. A vertex has nine floats, and three more for each light group. A face is the byte 3 and
   three vertex indices. */
enum { BAKE_VERTEX = 36, BAKE_GROUP = 12, BAKE_FACE = 13 };

static const char *const bake_properties[9] = { "x", "y", "z", "nx", "ny", "nz", "radiance_r", "radiance_g",
    "radiance_b" };

/* Writes the header before the vertices. facts: NULL if the file is not a part */
static inline void bake_put_vertices_head(FILE *out, const bake_facts *facts, const bake_groups *groups,
    double vertices, double faces) {
    int i;
    fprintf(out, "ply\nformat binary_little_endian 1.0\n");
    for (i = 0; i < BAKE_TEXTS && facts; i++)
        fprintf(out, "comment sbl.%s %s\n", bake_names[i], facts->texts[i].text);
    for (i = 0; i < BAKE_RANGE && facts; i++)
        fprintf(out, "comment sbl.%s %d\n", bake_range_names[i], facts->range[i]);
    fprintf(out, "comment radiance: irradiance over pi\nelement vertex %.0f\n", vertices);
    for (i = 0; i < 9; i++) fprintf(out, "property float %s\n", bake_properties[i]);
    for (i = 0; i < 3 * groups->count; i++)
        fprintf(out, "property float radiance_%s_%c\n", groups->names[i / 3], "rgb"[i % 3]);
    fprintf(out, "element face %.0f\nproperty list uchar int vertex_indices\nend_header\n", faces);
}

/* ---- the list of parts ---- */

typedef struct bake_part {
    int first, count;     /* index of the first probe or mesh, and their number */
    int vertices, faces;  /* how many, in a .ply */
    off_t body;           /* offset in the file where the probes or vertices begin */
} bake_part;

typedef struct bake_parts {
    part_list list;
    int is_ply;
    bake_part *parts;     /* one for each file in list */
    int *order;           /* the index in parts of part K is order[K - 1]; NULL before bake_check */
    int room, total;
    bake_grid grid;
    bake_groups groups;
    double vertices, faces;
    const volatile sig_atomic_t *cancel;  /* joining stops if this is not 0 */
} bake_parts;

static inline void bake_free(bake_parts *b) {
    free(b->parts);
    free(b->order);
    parts__list_free(&b->list);
    memset(b, 0, sizeof *b);
}

/* Opens a file of the list. Rejects pipes and devices instead of waiting for them. Returns NULL and sets b->list.error
   on failure. */
static inline FILE *bake__open(bake_parts *b, int index) {
    const char *name = b->list.files[index].name;
    const int handle = open(name, O_RDONLY | O_NONBLOCK | O_CLOEXEC);
    struct stat info;
    FILE *in;
    if (handle < 0) { parts__fail(&b->list, "%s: %s", name, strerror(errno)); return NULL; }
    if (fstat(handle, &info) != 0 || !S_ISREG(info.st_mode)) {
        parts__fail(&b->list, "%s: not a regular file", name);
        close(handle);
        return NULL;
    }
    in = fdopen(handle, "rb");
    if (in) return in;
    parts__fail(&b->list, "%s: %s", name, strerror(errno));
    close(handle);
    return NULL;
}

/* Returns the size of a vertex in bytes. */
static inline size_t bake__vertex_size(const bake_parts *b) {
    return BAKE_VERTEX + BAKE_GROUP * (size_t)b->groups.count;
}

static inline int bake__damaged(bake_parts *b, int index) {
    return parts__fail(&b->list, "%s: it is damaged or incomplete; make this part again", b->list.files[index].name);
}

/* ---- reading lines: only text in the form of the bake_put functions is accepted ---- */

enum { BAKE_LINE = 8192 };  /* size of the buffer for a line: characters, newline and final 0 */

/* Reads one line. Returns 1 if it is complete: it ends in a newline and fits into BAKE_LINE. */
static inline int bake__line(FILE *in, char line[BAKE_LINE]) {
    const char *end = fgets(line, BAKE_LINE, in) ? strchr(line, '\n') : NULL;
    return end && !end[1];
}

static inline int bake__skip(const char **at, const char *words) {
    const size_t length = strlen(words);
    if (strncmp(*at, words, length) != 0) return 0;
    *at += length;
    return 1;
}

/* Reads printable characters up to `end`, which is skipped. Returns 0 if the text is too long or does not end with
   `end`. */
static inline int bake__text(const char **at, char end, char out[PICTURE_FACT_SIZE]) {
    size_t length = 0;
    while ((*at)[length] >= 32 && (*at)[length] < 127 && (*at)[length] != '"') length++;
    if ((*at)[length] != end || length >= PICTURE_FACT_SIZE) return 0;
    memcpy(out, *at, length);
    out[length] = 0;
    *at += length + 1;
    return 1;
}

/* Reads an integer from 0 to INT_MAX without leading zeros. Returns 0 if the text has another form. */
static inline int bake__read_count(const char **at, int *out) {
    const size_t digits = strspn(*at, "0123456789");
    const double number = digits && digits <= 10 ? strtod(*at, NULL) : -1;
    if (number < 0 || number > INT_MAX || (**at == '0' && digits > 1)) return 0;
    *out = (int)number;
    *at += digits;
    return 1;
}

/* Skips words and the number that follows them. Returns 0 if the text has another form. */
static inline int bake__skip_number(const char **at, const char *words) {
    const size_t length = bake__skip(at, words) ? strspn(*at, "+-.0123456789e") : 0;
    char *end = NULL;
    if (length) strtod(*at, &end);
    if (!length || **at == '+' || end != *at + length) return 0;
    *at = end;
    return 1;
}

/* Skips words and the list of `count` numbers that follows them. */
static inline int bake__skip_numbers(const char **at, const char *words, int count) {
    int i, ok = bake__skip(at, words);
    for (i = 0; i < count && ok; i++) ok = bake__skip_number(at, i ? ", " : "[");
    return ok && bake__skip(at, "]");
}

static inline int bake__skip_colors(const char **at, const char *words, int count) {
    int i, ok = bake__skip(at, words);
    for (i = 0; i < count && ok; i++) ok = bake__skip_numbers(at, i ? ", " : "[", 3);
    return ok && bake__skip(at, "]");
}

/* Skips a probe in the form that bake_put_probe writes. Returns 0 if the text has another form. */
static inline int bake__skip_probe(const char **at, const bake_groups *groups) {
    int i, ok = bake__skip_numbers(at, "  {\"position\": ", 3) && bake__skip(at, ", \"valid\": ") &&
             (bake__skip(at, "true") || bake__skip(at, "false")) && bake__skip_colors(at, ", \"sh\": ", 9) &&
             bake__skip_colors(at, ", \"cube\": ", 6) && bake__skip_number(at, ", \"sky\": ") &&
             bake__skip_numbers(at, ", \"distance\": ", 8) && bake__skip_numbers(at, ", \"distance_squared\": ", 8) &&
             bake__skip_number(at, ", \"back_share\": ");
    for (i = 0; i < groups->count && ok; i++)
        ok = bake__skip(at, i ? ", \"" : ", \"groups\": {\"") && bake__skip(at, groups->names[i]) &&
             bake__skip_colors(at, "\": {\"sh\": ", 9) && bake__skip_colors(at, ", \"cube\": ", 6) &&
             bake__skip(at, "}");
    return ok && bake__skip(at, groups->count ? "}}" : "}");
}

/* ---- reading the head of a part ---- */

/* Reads the line of a grid, from its first count on. Returns 1 if the line is valid and the grid has `total` probes. */
static inline int bake__read_grid(const char *at, int total, bake_grid *grid) {
    double points = 1;
    const char *layout;
    int i, ok = 1;
    for (i = 0; i < 3 && ok; i++) {
        ok = bake__read_count(&at, &grid->count[i]) && bake__skip(&at, i < 2 ? ", " : "], ");
        points *= grid->count[i];
    }
    layout = at;
    ok = ok && points == (double)total && bake__skip_numbers(&at, "\"origin\": ", 3) &&
         bake__skip_numbers(&at, ", \"spacing\": ", 3) && strcmp(at, ",\n") == 0 &&
         strlen(layout) < sizeof grid->layout;
    if (ok) strcpy(grid->layout, layout);
    return ok;
}

/* Reads the facts of a part with probes. Returns 0 if the line is damaged. begun: receives 1 if the line begins like
   the first line of a part, otherwise 0 */
static inline int bake__read_facts(const char *line, bake_facts *facts, int *begun) {
    const char *at = line;
    char words[64];
    int i, ok;
    *begun = bake__skip(&at, "{\"sbl\": {\"version\": \"");
    for (i = 0, ok = *begun; i < BAKE_TEXTS && ok; i++) {
        snprintf(words, sizeof words, ", \"%s\": \"", bake_names[i]);
        ok = (i == 0 || bake__skip(&at, words)) && bake__text(&at, '"', facts->texts[i].text);
    }
    for (i = 0; i < BAKE_RANGE && ok; i++) {
        snprintf(words, sizeof words, ", \"%s\": ", bake_range_names[i]);
        ok = bake__skip(&at, words) && bake__read_count(&at, &facts->range[i]);
    }
    return ok && strcmp(at, "},\n") == 0;
}

/* Adds a light group whose name has `length` characters. Returns 0 if there are too many groups or the name has no
   valid length. */
static inline int bake__add_group(bake_groups *groups, const char *name, size_t length) {
    if (groups->count >= SBL_MAX_LIGHT_GROUPS || length < 1 || length >= BAKE_GROUP_NAME) return 0;
    memcpy(groups->names[groups->count++], name, length);
    return 1;
}

/* Reads the line with the light groups of probes, from the first name on. */
static inline int bake__read_groups(const char *at, bake_groups *groups) {
    do {
        const size_t length = bake__skip(&at, "\"") ? strspn(at, bake_letters) : 0;
        if (!bake__add_group(groups, at, length)) return 0;
        at += length;
    } while (bake__skip(&at, "\", "));
    return strcmp(at, "\"],\n") == 0;
}

/* Stores the light groups of the first file. Returns 1 if the groups of this file equal them. */
static inline int bake__same_groups(bake_parts *b, const bake_groups *groups) {
    if (b->list.count == 1) b->groups = *groups;
    return memcmp(&b->groups, groups, sizeof *groups) == 0;
}

/* Reads the lines before the probes. Returns 0 if they are damaged or do not fit the first part. begun: receives 1 if
   the file begins like a part, otherwise 0 */
static inline int bake__read_probes_head(bake_parts *b, FILE *in, bake_facts *facts, int *begun) {
    char line[BAKE_LINE];
    const char *at = line;
    bake_grid grid;
    bake_groups groups;
    int i, ok;
    memset(&grid, 0, sizeof grid);
    memset(&groups, 0, sizeof groups);
    *begun = 0;
    ok = bake__line(in, line) && bake__read_facts(line, facts, begun) && bake__line(in, line);
    if (ok && bake__skip(&at, " \"grid\": ["))
        ok = bake__read_grid(at, facts->range[BAKE_TOTAL], &grid) && bake__line(in, line);
    for (i = 0; bake_probes_about[i] && ok; i++) ok = strcmp(line, bake_probes_about[i]) == 0 && bake__line(in, line);
    at = line;
    if (ok && bake__skip(&at, " \"groups\": [")) ok = bake__read_groups(at, &groups) && bake__line(in, line);
    if (b->list.count == 1) b->grid = grid;
    return bake__same_groups(b, &groups) && ok && memcmp(&b->grid, &grid, sizeof grid) == 0 &&
           strcmp(line, " \"probes\": [\n") == 0;
}

/* Reads a line that consists of words and an integer. Returns 0 if it has another form. */
static inline int bake__counted(FILE *in, const char *words, int *out) {
    char line[BAKE_LINE];
    const char *at = line;
    return bake__line(in, line) && bake__skip(&at, words) && bake__read_count(&at, out) && strcmp(at, "\n") == 0;
}

/* Reads a line. Returns 1 if it consists of these words. */
static inline int bake__is_line(FILE *in, const char *words) {
    char line[BAKE_LINE];
    const char *at = line;
    return bake__line(in, line) && bake__skip(&at, words) && strcmp(at, "\n") == 0;
}

/* Reads the properties of the light groups of vertices. Stops before the first line of another kind. */
static inline int bake__read_properties(FILE *in, bake_groups *groups) {
    char line[BAKE_LINE], words[BAKE_GROUP_NAME + 32];
    for (;;) {
        const off_t begin = ftello(in);
        const char *at = line;
        size_t length;
        if (!bake__line(in, line)) return 0;
        if (!bake__skip(&at, "property float radiance_")) return fseeko(in, begin, SEEK_SET) == 0;
        length = strspn(at, bake_letters);
        if (length < 3 || strcmp(at + length - 2, "_r\n") != 0 || !bake__add_group(groups, at, length - 2)) return 0;
        snprintf(words, sizeof words, "property float radiance_%s_g", groups->names[groups->count - 1]);
        if (!bake__is_line(in, words)) return 0;
        words[strlen(words) - 1] = 'b';
        if (!bake__is_line(in, words)) return 0;
    }
}

/* Reads the header before the vertices, and checks the size of the file. Returns 0 if the file is damaged or does not
   fit the first part. begun: receives 1 if the file begins like a part, otherwise 0 */
static inline int bake__read_vertices_head(bake_parts *b, FILE *in, bake_facts *facts, bake_part *part, int *begun) {
    char line[BAKE_LINE], words[64];
    bake_groups groups;
    struct stat info;
    int i, ok = bake__is_line(in, "ply") && bake__is_line(in, "format binary_little_endian 1.0");
    *begun = 0;
    memset(&groups, 0, sizeof groups);
    for (i = 0; i < BAKE_TEXTS && ok; i++) {
        const char *at = line;
        snprintf(words, sizeof words, "comment sbl.%s ", bake_names[i]);
        ok = bake__line(in, line) && bake__skip(&at, words) && bake__text(&at, '\n', facts->texts[i].text);
        *begun |= ok;
    }
    for (i = 0; i < BAKE_RANGE && ok; i++) {
        snprintf(words, sizeof words, "comment sbl.%s ", bake_range_names[i]);
        ok = bake__counted(in, words, &facts->range[i]);
    }
    ok = ok && bake__is_line(in, "comment radiance: irradiance over pi") &&
         bake__counted(in, "element vertex ", &part->vertices);
    for (i = 0; i < 9 && ok; i++) {
        snprintf(words, sizeof words, "property float %s", bake_properties[i]);
        ok = bake__is_line(in, words);
    }
    ok = ok && bake__read_properties(in, &groups) && bake__counted(in, "element face ", &part->faces) &&
         bake__is_line(in, "property list uchar int vertex_indices") && bake__is_line(in, "end_header");
    return bake__same_groups(b, &groups) && ok && fstat(fileno(in), &info) == 0 &&
           (double)info.st_size == (double)ftello(in) + (double)bake__vertex_size(b) * part->vertices +
                                   (double)BAKE_FACE * part->faces;
}

/* Reads the head of the file that was added last, and checks that it fits the first file. Returns 0 and sets
   b->list.error if it does not. */
static inline int bake__head(bake_parts *b, FILE *in, bake_part *part) {
    static bake_facts facts;
    const int index = b->list.count - 1, *range = facts.range;
    const part_file *file = &b->list.files[index];
    int begun, ok;
    memset(&facts, 0, sizeof facts);
    ok = b->is_ply ? bake__read_vertices_head(b, in, &facts, part, &begun)
                   : bake__read_probes_head(b, in, &facts, &begun);
    if (!begun)
        return parts__fail(&b->list, "%s: not a part made by sbl_bake --%s --part", file->name,
                           b->is_ply ? "vertices" : "probes");
    if (facts.texts[BAKE_PART].text[0] && !parts__number(&b->list, facts.texts[BAKE_PART].text)) return 0;
    if (facts.texts[BAKE_PART].text[0] && !parts__fit(&b->list, &bake_kind, facts.texts)) return 0;
    if (!ok || !file->count || range[BAKE_COUNT] < 1 || range[BAKE_FIRST] > range[BAKE_TOTAL] - range[BAKE_COUNT])
        return bake__damaged(b, index);
    if (index == 0) b->total = range[BAKE_TOTAL];
    if (b->total != range[BAKE_TOTAL])
        return parts__fail(&b->list, "%s does not fit %s: it is a part of %d %s, not of %d", file->name,
                           b->list.files[0].name, range[BAKE_TOTAL], b->is_ply ? "meshes" : "probes", b->total);
    part->first = range[BAKE_FIRST];
    part->count = range[BAKE_COUNT];
    part->body = ftello(in);
    b->vertices += part->vertices;
    b->faces += part->faces;
    return 1;
}

/* Adds a file. Returns 0 and sets b->list.error if it is not a part, or does not fit the parts added before. */
static inline int bake_add(bake_parts *b, const char *name) {
    FILE *in;
    int ok;
    if (!parts__list(&b->list, name)) return 0;
    if (b->room < b->list.room) {
        bake_part *more = (bake_part *)realloc(b->parts, (size_t)b->list.room * sizeof *more);
        if (!more) return parts__fail(&b->list, "out of memory");
        b->parts = more;
        b->room = b->list.room;
    }
    memset(&b->parts[b->list.count - 1], 0, sizeof *b->parts);
    in = bake__open(b, b->list.count - 1);
    if (!in) return 0;
    ok = bake__head(b, in, &b->parts[b->list.count - 1]);
    fclose(in);
    return ok;
}

/* Sorts the parts by their numbers and checks that together they hold all probes or meshes. Returns 0 and sets
   b->list.error if they do not. */
static inline int bake_check(bake_parts *b) {
    int i, next = 0;
    if (!b->list.count) return parts__fail(&b->list, "no parts are given");
    if (!parts__check_numbers(&b->list)) return 0;
    b->order = (int *)calloc((size_t)b->list.count, sizeof *b->order);
    if (!b->order) return parts__fail(&b->list, "out of memory");
    for (i = 0; i < b->list.count; i++) b->order[b->list.files[i].number - 1] = i;
    for (i = 0; i < b->list.count; next += b->parts[b->order[i++]].count)
        if (b->parts[b->order[i]].first != next)
            return parts__fail(&b->list, "%s: it begins with number %d, not %d; make this part again",
                               b->list.files[b->order[i]].name, b->parts[b->order[i]].first, next);
    if (next != b->total)
        return parts__fail(&b->list, "%d of %d %s are in no part", b->total - next, b->total,
                           b->is_ply ? "meshes" : "probes");
    if (b->vertices > INT_MAX || b->faces > INT_MAX)
        return parts__fail(&b->list, "the parts have %.0f vertices and %.0f faces; a .ply has at most %d", b->vertices,
                           b->faces, INT_MAX);
    return 1;
}

/* ---- joining the parts ---- */

/* Copies the probes of a part. Returns 0 if the part is damaged. first: 1 if this is the first part */
static inline int bake__copy_probes(const bake_parts *b, const bake_part *part, FILE *in, FILE *out, int first) {
    char line[BAKE_LINE];
    int i;
    for (i = 0; i < part->count; i++) {
        const char *at = line;
        if (!bake__line(in, line) || !bake__skip_probe(&at, &b->groups)) return 0;
        if (strcmp(at, i + 1 < part->count ? ",\n" : "\n") != 0) return 0;
        fprintf(out, "%s\n%.*s", i || !first ? "," : "", (int)(at - line), line);
    }
    return fgets(line, BAKE_LINE, in) && strcmp(line, bake_probes_end) == 0 && fgetc(in) == EOF;
}

enum { BAKE_BLOCK = 4096 };  /* number of vertices or faces that are copied at a time */

static inline int bake__copy_vertices(const bake_parts *b, const bake_part *part, FILE *in, FILE *out) {
    static unsigned char bytes[BAKE_BLOCK * (BAKE_VERTEX + SBL_MAX_LIGHT_GROUPS * BAKE_GROUP)];
    const size_t size = bake__vertex_size(b);
    int i, count;
    for (i = 0; i < part->vertices; i += count) {
        count = part->vertices - i < BAKE_BLOCK ? part->vertices - i : BAKE_BLOCK;
        if (fread(bytes, size, (size_t)count, in) != (size_t)count) return 0;
        fwrite(bytes, size, (size_t)count, out);
    }
    return 1;
}

/* Adds `by` to a little-endian vertex index. Returns 0 if the index is not below `limit`. */
static inline int bake__shift(unsigned char *bytes, uint32_t limit, uint32_t by) {
    uint32_t number = 0;
    int k;
    for (k = 3; k >= 0; k--) number = number << 8 | bytes[k];
    if (number >= limit) return 0;
    for (k = 0; k < 4; k++) bytes[k] = (unsigned char)((number + by) >> 8 * k);
    return 1;
}

/* Copies the faces of a part, and shifts their vertex indices. before: number of vertices in the parts before this
   one */
static inline int bake__copy_faces(const bake_part *part, FILE *in, FILE *out, uint32_t before) {
    static unsigned char bytes[BAKE_BLOCK * BAKE_FACE];
    int i, count, k, corner;
    for (i = 0; i < part->faces; i += count) {
        count = part->faces - i < BAKE_BLOCK ? part->faces - i : BAKE_BLOCK;
        if (fread(bytes, BAKE_FACE, (size_t)count, in) != (size_t)count) return 0;
        for (k = 0; k < count; k++) {
            unsigned char *face = bytes + (size_t)k * BAKE_FACE;
            if (face[0] != 3) return 0;
            for (corner = 0; corner < 3; corner++)
                if (!bake__shift(face + 1 + 4 * corner, (uint32_t)part->vertices, before)) return 0;
        }
        fwrite(bytes, BAKE_FACE, (size_t)count, out);
    }
    return fgetc(in) == EOF;
}

enum { BAKE_LINES, BAKE_VERTICES, BAKE_FACES };  /* the content that one pass copies from each part */

/* Copies one kind of content of all parts, part by part. Returns 0 on failure or cancellation. */
static inline int bake__copy(bake_parts *b, int what, FILE *out) {
    uint32_t before = 0;
    int k;
    for (k = 0; k < b->list.count; k++) {
        const int index = b->order[k];
        const bake_part *part = &b->parts[index];
        const off_t skip = what == BAKE_FACES ? (off_t)bake__vertex_size(b) * part->vertices : 0;
        FILE *in = *b->cancel ? NULL : bake__open(b, index);
        int ok = in && fseeko(in, part->body + skip, SEEK_SET) == 0;
        ok = ok && (what == BAKE_LINES    ? bake__copy_probes(b, part, in, out, k == 0)
                  : what == BAKE_VERTICES ? bake__copy_vertices(b, part, in, out)
                                          : bake__copy_faces(part, in, out, before));
        if (in) fclose(in);
        if (in && !ok) bake__damaged(b, index);
        if (!ok || ferror(out)) return 0;
        before += (uint32_t)part->vertices;
    }
    return 1;
}

/* Writes the joined file, for output_write. Returns 0 on failure. what: a pointer to a pointer to a bake_parts that
   bake_check has accepted */
static inline int bake_write(FILE *out, const void *what) {
    bake_parts *b = *(bake_parts *const *)what;
    if (b->is_ply) {
        bake_put_vertices_head(out, NULL, &b->groups, b->vertices, b->faces);
        return bake__copy(b, BAKE_VERTICES, out) && bake__copy(b, BAKE_FACES, out);
    }
    bake_put_probes_head(out, NULL, &b->grid, &b->groups);
    if (!bake__copy(b, BAKE_LINES, out)) return 0;
    fprintf(out, "\n%s", bake_probes_end);
    return 1;
}

#endif
