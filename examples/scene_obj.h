/* Part of scene_file.h: edits .obj and .mtl files before assimp reads them.

   assimp does not tell whether a material states its colour; therefore a material with map_Kd and without Kd gets Kd 1
   1 1. assimp ignores the options -s and -o of textures, and takes the name of the texture for a number if such an
   option has fewer than three; therefore the reader scales and moves the texture coordinates, and the options are
   removed. assimp invents a material for a name that no .mtl file defines; therefore the names are noted, for a
   warning. */
#ifndef SCENE_OBJ_H
#define SCENE_OBJ_H

#include <math.h>
#include <stdlib.h>

/* A material that an .mtl file defines. */
typedef struct scene__defined {
    char *name;
    scene__transform moves[SCENE__PICTURES];  /* by -s and -o of its textures */
} scene__defined;

/* The materials of all .mtl files of a scene. The reader frees them with scene__free_mtl. */
typedef struct scene__mtl { scene__defined *list; size_t count, room; } scene__mtl;

static void scene__free_mtl(scene__mtl *mtl) {
    while (mtl->count) free(mtl->list[--mtl->count].name);
    free(mtl->list);
}

/* Returns the last material with this name, or NULL. Later lines of a material replace earlier ones. */
static const scene__defined *scene__find_defined(const scene__mtl *mtl, const char *name) {
    size_t i = mtl->count;
    while (i-- > 0) if (strcmp(mtl->list[i].name, name) == 0) return &mtl->list[i];
    return NULL;
}

/* Removes a byte order mark, which assimp takes for a part of the first line. */
static void scene__remove_mark(scene__bytes *bytes) {
    if (bytes->size < 3 || memcmp(bytes->data, "\xef\xbb\xbf", 3) != 0) return;
    bytes->size -= 3;
    memmove(bytes->data, bytes->data + 3, bytes->size + 1);
}

/* Inserts a zero before each leading decimal point of an OBJ file, because assimp reads "v .5 -.5 0" as a line with a
   single number. */
static void scene__mend_obj(scene_file *file, scene__bytes *bytes) {
    size_t i, inserted = 0, pass;
    char *out = NULL;
    for (pass = 0; pass < 2; pass++) {  /* the first pass counts, the second copies */
        int vertex = 0, line_start = 1;
        char last = '\n';
        if (pass == 1) {
            if (!inserted) return;
            out = (char *)malloc(bytes->size + inserted + 1);
            if (!out) { scene__fail_for_memory(file, "it"); return; }
            inserted = 0;
        }
        for (i = 0; i < bytes->size; i++) {
            char c = bytes->data[i];
            if (c == '\n' || c == '\r') line_start = 1;
            else if (line_start && c != ' ' && c != '\t') { vertex = c == 'v'; line_start = 0; }
            if (vertex && c == '.' && (last == ' ' || last == '\t' || last == '-' || last == '+')) {
                if (out) out[i + inserted] = '0';
                inserted++;
            }
            if (out) out[i + inserted] = c;
            last = c;
        }
    }
    out[bytes->size + inserted] = 0;
    free(bytes->data);
    bytes->data = out;
    bytes->size += inserted;
}

/* ---- lines of .mtl files ---- */

/* Returns the length of the word at `at`. */
static size_t scene__word(const char *at) { return strcspn(at, " \t\r\n"); }

/* Returns what follows the word at `at` on its line. */
static char *scene__after(char *at) {
    at += scene__word(at);
    return at + strspn(at, " \t");
}

static int scene__is_word(const char *at, const char *word) {
    const size_t length = strlen(word);
    return scene__word(at) == length && strncasecmp(at, word, length) == 0;
}

/* Returns 1 if a line begins a material. assimp does not accept capital letters here. */
static int scene__is_newmtl(const char *line) { return scene__word(line) == 6 && strncmp(line, "newmtl", 6) == 0; }

/* Returns 1 if the word at `at` is a number. number: receives it */
static int scene__is_number(const char *at, double *number) {
    char *end;
    *number = strtod(at, &end);
    return end > at && end == at + scene__word(at) && fabs(*number) < 1e6;
}

/* Returns the transform of texture coordinates with v = 0 at the top, from the -s and -o of an .mtl file, where v = 0
   is at the bottom. */
static scene__transform scene__move_of(const double scale[3], const double offset[3]) {
    scene__transform out = { { 1, 0, 0, 0, 1, 0 } };
    out.m[0] = (float)scale[0];
    out.m[2] = (float)offset[0];
    out.m[4] = (float)scale[1];
    out.m[5] = (float)(1 - scale[1] - offset[1]);
    return out;
}

/* Reads the options of a texture. Overwrites the options that assimp misreads with blanks. at: the text that follows
   the first word of the line; move: receives the transform. Returns 1 if -mm changes the values of the texture. */
static int scene__texture_options(char *at, scene__transform *move) {
    static const struct { const char *name; int most, is_text; } all[] = { { "-s", 3, 0 }, { "-o", 3, 0 },
        { "-t", 3, 0 }, { "-mm", 2, 0 }, { "-bm", 1, 0 }, { "-boost", 1, 0 }, { "-texres", 1, 0 }, { "-cc", 1, 1 },
        { "-blendu", 1, 1 }, { "-blendv", 1, 1 }, { "-imfchan", 1, 1 }, { "-clamp", 1, 1 }, { "-type", 1, 1 } };
    enum { SCALE, OFFSET, RANGE = 3, KEPT = 11, OPTIONS = sizeof all / sizeof *all };
    double values[OPTIONS][3] = { { 1, 1, 1 } };
    int i, k, number;
    values[RANGE][1] = 1;
    for (number = 0; *at == '-'; number++) {
        char *const start = at;
        for (i = 0; i < OPTIONS && !scene__is_word(at, all[i].name); i++) continue;
        if (i == OPTIONS) break;
        at = scene__after(at);
        for (k = 0; k < all[i].most; k++) {
            double value = 0;
            if (!all[i].is_text && !scene__is_number(at, &value)) break;
            values[i][k] = value;
            at = scene__after(at);
        }
        if (i < KEPT) memset(start, ' ', (size_t)(at - start));
    }
    *move = scene__move_of(values[SCALE], values[OFFSET]);
    return values[RANGE][0] != 0.0 || values[RANGE][1] < 1 || values[RANGE][1] > 1;
}

/* Adds a material. at: its name, up to the end of the line */
static void scene__define(scene_file *file, scene__mtl *mtl, const char *at) {
    static const scene__transform none = { { 1, 0, 0, 0, 1, 0 } };
    size_t length = strcspn(at, "\r\n");
    scene__defined *added;
    int i;
    while (length && strchr(" \t", at[length - 1])) length--;
    if (mtl->count == mtl->room) {
        const size_t room = 2 * mtl->room + 16;
        scene__defined *more = (scene__defined *)realloc(mtl->list, room * sizeof *more);
        if (!more) { scene__fail_for_memory(file, "it"); return; }
        mtl->list = more;
        mtl->room = room;
    }
    added = &mtl->list[mtl->count];
    added->name = (char *)malloc(length + 1);
    if (!added->name) { scene__fail_for_memory(file, "it"); return; }
    memcpy(added->name, at, length);
    added->name[length] = 0;
    for (i = 0; i < SCENE__PICTURES; i++) added->moves[i] = none;
    mtl->count++;
}

/* ---- complete .mtl files ---- */

/* What is known of the material whose lines are being read. */
typedef struct scene__mtl_state { int has_name, has_color, has_picture, is_ranged; } scene__mtl_state;

/* Reads a line and edits its options. */
static void scene__mtl_line(scene_file *file, scene__mtl *mtl, char *line, scene__mtl_state *state) {
    static const struct { const char *word; int picture; } maps[] = { { "map_Kd", SCENE__ALBEDO },
        { "map_Ke", SCENE__EMISSION }, { "map_emissive", SCENE__EMISSION }, { "map_d", SCENE__MASK },
        { "norm", SCENE__NORMAL }, { "map_Kn", SCENE__NORMAL } };
    scene__transform move;
    size_t i, count = sizeof maps / sizeof *maps;
    if (scene__is_newmtl(line)) {
        scene__define(file, mtl, scene__after(line));
        state->has_name = 1;
    }
    state->has_color |= scene__is_word(line, "Kd");
    if (strncasecmp(line, "map_", 4) != 0 && !scene__is_word(line, "norm") && !scene__is_word(line, "bump") &&
        !scene__is_word(line, "disp") && !scene__is_word(line, "refl")) return;
    state->has_picture |= scene__is_word(line, "map_Kd");
    state->is_ranged |= scene__texture_options(scene__after(line), &move);
    for (i = 0; i < count; i++)
        if (mtl->count && scene__is_word(line, maps[i].word)) mtl->list[mtl->count - 1].moves[maps[i].picture] = move;
}

/* Prepares the content of an .mtl file and notes its materials. */
static void scene__mend_mtl(scene_file *file, const char *path, scene__bytes *bytes, scene__mtl *mtl) {
    static const char white[] = "\nKd 1 1 1\n";
    scene__mtl_state state = { 0, 0, 0, 0 };
    size_t lines = 2, used = 0;
    char *line, *out;
    scene__remove_mark(bytes);
    for (line = bytes->data; (line = strchr(line, '\n')) != NULL; line++) lines++;
    out = (char *)malloc(bytes->size + lines * sizeof white);
    if (!out) { scene__fail_for_memory(file, "it"); return; }
    for (line = bytes->data; ; line += strcspn(line, "\n"), line += *line == '\n') {
        char *const first = line + strspn(line, " \t");
        const size_t length = strcspn(line, "\n") + 1;
        const int ends = !*line || scene__is_newmtl(first);
        if (ends && state.has_name && state.has_picture && !state.has_color) {
            memcpy(out + used, white, sizeof white - 1);
            used += sizeof white - 1;
        }
        if (ends) state.has_picture = state.has_color = 0;
        if (!*line || file->error[0]) break;
        scene__mtl_line(file, mtl, first, &state);
        if (!state.has_name) continue;  /* assimp crashes on lines before the first material */
        memcpy(out + used, line, length);
        used += length - !line[length - 1];
    }
    if (state.is_ranged)
        scene__warn(file, "%.150s: brightness and contrast of its textures are not changed: -mm is ignored", path);
    out[used] = 0;
    free(bytes->data);
    bytes->data = out;
    bytes->size = used;
}

#endif
