/* Reads a command line by a table of options, and prints the table for --help. Include after tool.h. */
#ifndef TOOL_OPTIONS_H
#define TOOL_OPTIONS_H

#include <ctype.h>
#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

typedef enum option_kind {
    FLAG,             /* no value */
    TEXT,             /* a const char * */
    CHOICE,           /* an int: index into words */
    INTEGERS, SIZES,  /* count ints, separated by commas; SIZES: by x */
    NUMBERS, SHARES,  /* count doubles, separated by commas; SHARES: 2% means 0.02 */
    NUMBERS_OR_FILE,  /* count doubles, or a file name, which is stored in file; the last use of the option counts */
    LIST,             /* at most count const char *, one for each use of the option */
    BYTES             /* a size_t, such as 512M */
} option_kind;

typedef struct tool_option {
    const char *name, *argument;
    option_kind kind;
    void *value;
    int count;
    double low, high;           /* range of each number */
    const char *help;           /* lines, separated by \n */
    const char *const *words;   /* for CHOICE: the words, followed by NULL; for NUMBERS: a word that may take the place
                                   of the number, which is then NaN, or NULL */
    const char **file;          /* receives a file name, or NULL if numbers are given; NULL: only numbers are allowed */
    const char *synonym;        /* older name that is also accepted, or NULL */
} tool_option;

typedef struct tool_command {
    int argc;
    char **argv;
    const tool_option *table;   /* must contain --help and --output; -h and -o are short for these */
    int option_count;
    int *given;                 /* one per option; receives 1 if the option is given */
    const char **files;         /* receives the arguments that are not options */
    int file_count;             /* greatest number of such arguments */
} tool_command;

/* Prints the help of count options. */
static void tool_print_options(const tool_option *table, int count) {
    const char *line;
    int i;
    for (i = 0; i < count; i++) {
        const char *gap = table[i].argument ? " " : "", *argument = table[i].argument ? table[i].argument : "";
        int width = printf("  %s%s%s", table[i].name, gap, argument);
        if (table[i].synonym) width += printf(", %s%s%s", table[i].synonym, gap, argument);
        if (width > 24) width = 0 * printf("\n");
        for (line = table[i].help; line; line = strchr(line, '\n') ? strchr(line, '\n') + 1 : NULL) {
            printf("%*s%.*s\n", 26 - width, "", (int)strcspn(line, "\n"), line);
            width = 0;
        }
    }
}

static int tool__is_whole(const tool_option *o) { return o->kind == INTEGERS || o->kind == SIZES; }

/* Reads count separated numbers into o->value. Returns 0 if the text is anything else. */
static int tool__numbers(const tool_option *o, const char *text) {
    double numbers[3];
    char *end;
    int i;
    for (i = 0; i < o->count; i++) {
        if (i && *text++ != (o->kind == SIZES ? 'x' : ',')) return 0;
        if (!*text || strchr(" \t\n\v\f\r", *text)) return 0;
        if (tool__is_whole(o)) {
            size_t digits = strspn(text, "0123456789");
            if (!digits || digits > 10) return 0;
            for (numbers[i] = 0; digits > 0; digits--) numbers[i] = 10 * numbers[i] + (*text++ - '0');
        } else {
            numbers[i] = strtod(text, &end);
            if (end == text) return 0;
            text = end;
            if (o->kind == SHARES && *text == '%') { numbers[i] /= 100; text++; }
        }
        if (!(numbers[i] >= o->low && numbers[i] <= o->high)) return 0;
    }
    if (*text) return 0;
    for (i = 0; i < o->count; i++) {
        if (tool__is_whole(o)) ((int *)o->value)[i] = (int)numbers[i];
        else ((double *)o->value)[i] = numbers[i];
    }
    return 1;
}

/* Reads a number of bytes, which may end in K, M, G or T, into o->value. Returns 0 if the text is anything else. */
static int tool__bytes(const tool_option *o, const char *text) {
    static const char units[] = "KMGT";
    char *end;
    const double number = isdigit((unsigned char)*text) ? strtod(text, &end) : -1;
    const char *unit = number >= 0 && *end ? strchr(units, toupper((unsigned char)*end)) : NULL;
    const double bytes = number * (unit ? pow(1024, (double)(unit - units) + 1) : 1);
    if (number < 0 || (*end && (!unit || end[1])) || !(bytes >= o->low && bytes <= o->high)) return 0;
    *(size_t *)o->value = bytes < (double)SIZE_MAX ? (size_t)bytes : SIZE_MAX;
    return 1;
}

/* Returns whether the text is a file name: it has an extension that begins with a letter and contains no comma. Numbers
   with exponents, such as 1.e5, are not file names. */
static int tool__names_a_file(const char *text) {
    const char *point = strrchr(text, '.');
    return point && isalpha((unsigned char)point[1]) && !strchr(point, ',') &&
        !(strchr("eE", point[1]) && !isalpha((unsigned char)point[2]));
}

/* Stores the value of an option. name: as the user typed it. Returns the exit status. */
static int tool__take(const tool_option *o, const char *name, const char *value) {
    int k;
    switch (o->kind) {
        case TEXT: *(const char **)o->value = value; return DONE;
        case LIST:
            for (k = 0; k < o->count && ((const char **)o->value)[k]; k++) continue;
            if (k == o->count) return misuse("%s %s: this option can be given at most %d times", name, value, k);
            ((const char **)o->value)[k] = value;
            return DONE;
        case BYTES:
            return tool__bytes(o, value)
                       ? DONE
                       : misuse("%s %s: the value must be from 16M to 1024T, such as 512M or 4G", name, value);
        case CHOICE: {
            char list[256] = "";
            for (k = 0; o->words[k] && strcmp(o->words[k], value) != 0; k++)
                sprintf(list + strlen(list), " %s", o->words[k]);
            *(int *)o->value = k;
            return o->words[k] ? DONE : misuse("%s %s: the value must be one of%s", name, value, list);
        }
        default:
            if (o->words && strcmp(value, o->words[0]) == 0) { *(double *)o->value = NAN; return DONE; }
            if (o->file) *o->file = tool__names_a_file(value) ? value : NULL;
            if ((o->file && *o->file) || tool__numbers(o, value)) return DONE;
            return misuse("%s %s: the value must be %s, with %s from %g to %g", name, value, o->argument,
                          tool__is_whole(o) ? "whole numbers" : "numbers", o->low, o->high);
    }
}

/* Returns the name of the option as it was typed if the argument is this name, alone or followed by "=" and a value.
   Otherwise returns NULL. */
static const char *tool__named(const tool_option *o, const char *argument) {
    const char *const names[2] = { o->name, o->synonym };
    int i;
    for (i = 0; i < 2 && names[i]; i++) {
        const size_t length = strlen(names[i]);
        if (strncmp(argument, names[i], length) == 0 && (!argument[length] || argument[length] == '=')) return names[i];
    }
    return NULL;
}

/* Reads the whole command line. Returns the exit status. */
static int tool_parse(const tool_command *c) {
    int i, k, status = DONE, only_files = 0, files = 0;
    for (i = 1; i < c->argc && status == DONE; i++) {
        const char *argument = c->argv[i], *value, *name = NULL;
        const tool_option *o = c->table;
        if (only_files || argument[0] != '-' || !argument[1]) {
            if (files == c->file_count)
                return misuse(files == 1 ? "%s and %s: give only one scene" : "%s and %s: too many names; see --help",
                              c->files[files - 1], argument);
            c->files[files++] = argument;
            continue;
        }
        if (strcmp(argument, "--") == 0) { only_files = 1; continue; }
        if (strcmp(argument, "-o") == 0) argument = "--output";
        if (strcmp(argument, "-h") == 0) argument = "--help";
        for (k = 0; k < c->option_count && !name; k++) name = tool__named(o = &c->table[k], argument);
        if (!name) return misuse("there is no option %s; see --help", argument);
        value = argument[strlen(name)] ? argument + strlen(name) + 1 : NULL;
        c->given[o - c->table] = 1;
        if (o->kind == FLAG) {
            if (value) return misuse("%s takes no value", name);
            continue;
        }
        if (!value && i + 1 < c->argc) value = c->argv[++i];
        if (!value) return misuse("%s needs a value: %s", name, o->argument);
        status = tool__take(o, name, value);
    }
    return status;
}

#endif
