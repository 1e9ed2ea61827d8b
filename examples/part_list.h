/* Manages the list of parts of a picture or bake. It checks that their common facts agree, and that each part K/N is
   given exactly once. picture_parts.h and bake_parts.h read the files. Include after picture_file.h. */
#ifndef PART_LIST_H
#define PART_LIST_H

#include <dirent.h>
#include <stdarg.h>

enum { PARTS_MAX = 10000 };  /* maximum number of parts */
enum { FACTS_WORDS = 2 * PICTURE_FACT_SIZE + 512 };  /* size of a text about two facts that differ */

/* The facts (picture_fact) that a kind of part has. */
typedef struct part_kind {
    const char *const *names;
    const char *const *words;  /* for each fact: words about a difference, after "it was made" */
    const int *order;          /* the facts that must be the same in all parts, followed by -1. The first that differs
                                  is reported. Facts that depend on others come after them */
    unsigned hashes;           /* bits of facts that are hashes, whose text tells a user nothing */
    int renderer;              /* index of the fact GL_RENDERER */
} part_kind;

/* A file. K and N of --part K/N are in number and count; they are 0 for a part that the user chose with --window. */
typedef struct part_file { char *name; int number, count; } part_file;

typedef struct part_list {
    part_file *files;
    int count, room;
    picture_fact facts[PICTURE_FACTS];   /* the facts of the first part */
    int drivers;                         /* 1: different GL drivers made the parts */
    char error[FACTS_WORDS + 512]; /* message of the function that has failed */
} part_list;

/* Returns the text of a fact for a message. */
static inline const char *fact_shown(const char *text) { return text[0] ? text : "none"; }

/* Compares the first `count` facts in the order of their kind. Returns 0 if they are the same; otherwise writes how
   they differ. others: words for the owner of the facts `b` */
static inline int facts_differ(const part_kind *kind, int count, const picture_fact *a, const picture_fact *b,
                               const char *others, char out[FACTS_WORDS]) {
    int i, k = 0;
    while (k < count && kind->order[k] >= 0 && strcmp(a[kind->order[k]].text, b[kind->order[k]].text) == 0) k++;
    if (k == count || kind->order[k] < 0) return 0;
    i = kind->order[k];
    k = snprintf(out, 256, "it was made %s", kind->words[i]);
    if (!(kind->hashes >> i & 1))
        snprintf(out + k, FACTS_WORDS - 256, ": it has %s, %s has %s", fact_shown(a[i].text), others,
                 fact_shown(b[i].text));
    return 1;
}

static int parts__fail(part_list *l, const char *format, ...) {
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(l->error, sizeof l->error, format, arguments);
    va_end(arguments);
    return 0;
}

/* Adds a file name to the list. Returns 0 if memory runs out. */
static int parts__list(part_list *l, const char *name) {
    if (l->count == l->room) {
        const int room = l->room * 2 + 64;
        part_file *more = (part_file *)realloc(l->files, (size_t)room * sizeof *more);
        if (!more) return parts__fail(l, "out of memory");
        l->files = more;
        l->room = room;
    }
    memset(&l->files[l->count], 0, sizeof *l->files);
    l->files[l->count].name = (char *)malloc(strlen(name) + 1);
    if (!l->files[l->count].name) return parts__fail(l, "out of memory");
    strcpy(l->files[l->count++].name, name);
    return 1;
}

static inline void parts__list_free(part_list *l) {
    int i;
    for (i = 0; i < l->count; i++) free(l->files[i].name);
    free(l->files);
    memset(l, 0, sizeof *l);
}

/* Sets number and count of the file that was added last from "K/N", or to 0 if the text has another form. Returns 0 if
   K or N is out of range. */
static inline int parts__number(part_list *l, const char *text) {
    part_file *file = &l->files[l->count - 1];
    if (sscanf(text, "%d/%d", &file->number, &file->count) != 2) file->number = file->count = 0;
    if (file->count >= 0 && file->count <= PARTS_MAX && file->number <= file->count) return 1;
    return parts__fail(l, "%s: it claims to be part %d of %d", file->name, file->number, file->count);
}

/* Compares the facts and the part count of the file that was added last with those of the first file. Returns 0 if they
   do not fit. The facts of the first file become l->facts. */
static inline int parts__fit(part_list *l, const part_kind *kind, const picture_fact *facts) {
    const part_file *first = &l->files[0], *file = &l->files[l->count - 1];
    char why[FACTS_WORDS];
    if (l->count == 1) memcpy(l->facts, facts, sizeof l->facts);
    if (facts_differ(kind, PICTURE_FACTS, facts, l->facts, "the other", why))
        return parts__fail(l, "%s does not fit %s: %s", file->name, first->name, why);
    l->drivers |= strcmp(facts[kind->renderer].text, l->facts[kind->renderer].text) != 0;
    if (file->count == first->count) return 1;
    return parts__fail(l, "%s does not fit %s: it is a part of %d, not of %d", file->name, first->name, file->count,
                       first->count);
}

/* Returns 1 if each part K/N is given once, or if the first file has no number. Otherwise l->error names the first part
   that is missing or given twice. */
static inline int parts__check_numbers(part_list *l) {
    const int count = l->files[0].count;
    int i, k, missing = 0, first = 0, ok = 1;
    const char **names = count ? (const char **)calloc((size_t)count + 1, sizeof *names) : NULL;
    if (!count) return 1;
    if (!names) return parts__fail(l, "out of memory");
    for (i = 0; i < l->count && ok; i++) {
        k = l->files[i].number;
        if (k < 1 || k > count) ok = parts__fail(l, "%s: it claims to be part %d of %d", l->files[i].name, k, count);
        else if (names[k])
            ok = parts__fail(l, "%s and %s are both part %d of %d", names[k], l->files[i].name, k, count);
        else names[k] = l->files[i].name;
    }
    for (k = count; k >= 1 && ok; k--)
        if (!names[k]) { missing++; first = k; }
    if (missing > 1) ok = parts__fail(l, "%d of %d parts are missing; the first is part %d", missing, count, first);
    else if (missing) ok = parts__fail(l, "part %d of %d is missing", first, count);
    free(names);
    return ok;
}

static int parts__compare_names(const void *a, const void *b) {
    return strcmp(*(char *const *)a, *(char *const *)b);
}

static inline void parts_folder_free(char **names, int count) {
    while (names && --count >= 0) free(names[count]);
    free(names);
}

/* Returns the paths of the files in a folder whose names have this ending. They are sorted by name, so that messages
   are the same on all systems. count: receives their number, at least 1. Returns NULL and sets l->error on failure. */
static inline char **parts_folder(part_list *l, const char *folder, const char *ending, int *count) {
    char **names = (char **)malloc(sizeof *names), **more;
    int room = 1, ok = names != NULL;
    const struct dirent *entry;
    DIR *in = opendir(folder);
    *count = 0;
    if (!in) {
        parts__fail(l, "%s: this folder cannot be read: %s", folder, strerror(errno));
        free(names);
        return NULL;
    }
    while (ok && (entry = readdir(in)) != NULL) {
        const size_t length = strlen(entry->d_name), tail = strlen(ending);
        if (entry->d_name[0] == '.' || length <= tail || strcmp(entry->d_name + length - tail, ending) != 0) continue;
        if (*count == room) {
            more = (char **)realloc(names, (size_t)(room = 2 * room + 64) * sizeof *names);
            if (!more) { ok = 0; break; }
            names = more;
        }
        names[*count] = (char *)malloc(strlen(folder) + length + 2);
        ok = names[*count] != NULL;
        if (ok) sprintf(names[(*count)++], "%s/%s", folder, entry->d_name);
    }
    closedir(in);
    if (ok && *count) {
        qsort(names, (size_t)*count, sizeof *names, parts__compare_names);
        return names;
    }
    if (ok) parts__fail(l, "%s: this folder has no files whose names end in %s", folder, ending);
    else parts__fail(l, "out of memory");
    parts_folder_free(names, *count);
    *count = 0;
    return NULL;
}

#endif
