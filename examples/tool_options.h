/* A table of options, and what of a command line goes into it. Include after tool.h. */
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
    CHOICE,           /* an int: which of words */
    INTEGERS, SIZES,  /* count ints, separated by commas, and by x */
    NUMBERS, SHARES,  /* count doubles; 2% is 0.02 */
    NUMBERS_OR_FILE,  /* doubles, or a file's name, which goes into file; the last one counts */
    LIST,             /* count const char *, one each time it is given */
    BYTES             /* a size_t, such as 512M */
} option_kind;

typedef struct tool_option {
    const char *name, *argument;
    option_kind kind;
    void *value;
    int count;
    double low, high;           /* of each number */
    const char *help;           /* lines */
    const char *const *words;   /* of a CHOICE, then NULL */
    const char **file;          /* of NUMBERS_OR_FILE */
    const char *synonym;        /* an older name that is accepted too, or NULL */
} tool_option;

typedef struct tool_command {
    int argc;
    char **argv;
    const tool_option *table;   /* with --help and --output, for which -h and -o stand */
    int option_count;
    int *given;                 /* receives 1 where an option is given */
    const char **files;         /* receives the arguments that are no options: so many */
    int file_count;
} tool_command;

/* Some rows of a table. */
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

/* count numbers, separated; 0 where the text is anything else. */
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

/* A number and K, M, G, T or nothing. */
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

/* It has an ending: a point and a letter, no comma after them. Numbers have not, but for 1.e5 and the like. */
static int tool__names_a_file(const char *text) {
    const char *point = strrchr(text, '.');
    return point && isalpha((unsigned char)point[1]) && !strchr(point, ',') &&
        !(strchr("eE", point[1]) && !isalpha((unsigned char)point[2]));
}

/* Takes the value of an option. name: as it was typed. Returns the exit status, as tool_parse does. */
static int tool__take(const tool_option *o, const char *name, const char *value) {
    int k;
    switch (o->kind) {
        case TEXT: *(const char **)o->value = value; return DONE;
        case LIST:
            for (k = 0; k < o->count && ((const char **)o->value)[k]; k++) continue;
            if (k == o->count) return misuse("%s %s: it may be given %d times", name, value, k);
            ((const char **)o->value)[k] = value;
            return DONE;
        case BYTES:
            return tool__bytes(o, value)
                       ? DONE
                       : misuse("%s %s: it must be a number from 16M to 1024T, such as 512M or 4G", name, value);
        case CHOICE: {
            char list[256] = "";
            for (k = 0; o->words[k] && strcmp(o->words[k], value) != 0; k++)
                sprintf(list + strlen(list), " %s", o->words[k]);
            *(int *)o->value = k;
            return o->words[k] ? DONE : misuse("%s %s: it must be one of%s", name, value, list);
        }
        default:
            if (o->file) *o->file = tool__names_a_file(value) ? value : NULL;
            if ((o->file && *o->file) || tool__numbers(o, value)) return DONE;
            return misuse("%s %s: it must be %s with %s from %g to %g", name, value, o->argument,
                          tool__is_whole(o) ? "whole numbers" : "numbers", o->low, o->high);
    }
}

/* The name of the option, if the argument is that name, or the name, "=" and a value; otherwise NULL. */
static const char *tool__named(const tool_option *o, const char *argument) {
    const char *const names[2] = { o->name, o->synonym };
    int i;
    for (i = 0; i < 2 && names[i]; i++) {
        const size_t length = strlen(names[i]);
        if (strncmp(argument, names[i], length) == 0 && (!argument[length] || argument[length] == '=')) return names[i];
    }
    return NULL;
}

static int tool_parse(const tool_command *c) {
    int i, k, status = DONE, only_files = 0, files = 0;
    for (i = 1; i < c->argc && status == DONE; i++) {
        const char *argument = c->argv[i], *value, *name = NULL;
        const tool_option *o = c->table;
        if (only_files || argument[0] != '-' || !argument[1]) {
            if (files == c->file_count)
                return misuse(files == 1 ? "two scenes, %s and %s; give one" : "%s and %s: too many names; see --help",
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
