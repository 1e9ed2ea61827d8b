/* Reads a command line according to a table of options, and prints the table for --help. Include after tool.h. */
#ifndef TOOL_OPTIONS_H
#define TOOL_OPTIONS_H

#include <ctype.h>
#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

typedef enum option_kind {
    FLAG,             /* without a value */
    FLAG_OR_WORD,     /* a word may follow; value is an int that becomes 1 + its index in words */
    TEXT,             /* value is a const char * */
    CHOICE,           /* value is an int, the index in words */
    INTEGERS, SIZES,  /* count ints, separated by commas; SIZES: separated by x */
    NUMBERS, FRACTIONS,  /* count doubles, separated by commas; FRACTIONS: 2% means 0.02 */
    NUMBERS_OR_FILE,  /* count doubles, or a file name, which is stored in file; the last use of the option counts */
    LIST,             /* up to count const char *, one for each use of the option */
    BYTES             /* value is a size_t, such as 512M */
} option_kind;

enum { TOOL_NUMBERS = 4 };

typedef struct tool_option {
    const char *name, *argument;
    option_kind kind;
    void *value;
    int count;                  /* how many numbers, up to TOOL_NUMBERS; or how often a text may be given */
    double low, high;           /* range of each number */
    const char *help;           /* text for --help all, see tool_print_text */
    const char *const *words;   /* for CHOICE and FLAG_OR_WORD: the words, followed by NULL. For numbers: NULL, or one
                                   word and NULL; the word may replace the number, whose value is then NAN, or 0 for
                                   integers */
    const char **file;          /* NULL: no file name is allowed; otherwise receives it, or NULL for numbers */
    const char *synonym;        /* an older name that is also accepted, or NULL */
    const char *file_words;     /* if file is not NULL: words for the file in messages */
} tool_option;

/* The help text is a list of such lines: a heading starts a group, and the options of the group follow. */
typedef struct tool_line {
    int option;                 /* index of the option in the table, or TOOL_HEADING */
    const char *text;           /* the heading; or the text of --help for the option, with at most 54 characters; NULL:
                                   only --help all shows the option */
} tool_line;

enum { TOOL_HEADING = -1, TOOL_COLUMNS = 80, TOOL_COLUMN = 26 };  /* width of help texts; where explanations begin */

typedef struct tool_command {
    int argc;
    char **argv;
    const tool_option *table;   /* must contain --help and --output; -h and -o are short for these */
    int option_count;
    int *given;                 /* one per option; receives 1 if the option is given */
    const char **files;         /* receives the arguments that are not options */
    int file_count;             /* maximum number of arguments in files */
} tool_command;

/* Returns in which column a wrapped line of a text continues: in a list, where the explanation of the item begins,
   after three or more spaces; otherwise where the line begins. */
static int tool__indent(const char *line) {
    const int begin = (int)strspn(line, " ");
    const char *gap = strstr(line + begin, "   ");
    return gap && gap < line + strcspn(line, "\n") ? (int)(gap - line) + (int)strspn(gap, " ") : begin;
}

/* Prints a text whose lines begin at `column` and have at most TOOL_COLUMNS columns. The line breaks of the text are
   kept, and longer lines are wrapped at spaces. at: the column that the output has reached */
static void tool__print_text(const char *text, int column, int at) {
    while (*text) {
        const int indent = column + tool__indent(text);
        if (*text != '\n') at += printf("%*s", column - at, "");
        while (*text && *text != '\n') {
            int gap = (int)strspn(text, " ");
            const int word = (int)strcspn(text + gap, " \n");
            if (at + gap + word > TOOL_COLUMNS && at > indent) {
                at = printf("\n%*s", indent, "") - 1;
                text += gap;
                gap = 0;
            }
            at += printf("%.*s", gap + word, text);
            text += gap + word;
        }
        text += *text == '\n';
        printf("\n");
        at = 0;
    }
}

/* Prints a text of one or more lines in lines of at most TOOL_COLUMNS columns, see tool__indent. */
static void tool_print_text(const char *text) { tool__print_text(text, 0, 0); }

/* Prints an option and its help text. */
static void tool__print_option(const tool_option *o, const char *help, int synonym) {
    const char *gap = o->argument ? " " : "", *argument = o->argument ? o->argument : "";
    int width = printf("  %s%s%s", o->name, gap, argument);
    if (synonym && o->synonym) width += printf(", %s%s%s", o->synonym, gap, argument);
    if (width > TOOL_COLUMN - 2) {
        printf("\n");
        width = 0;
    }
    tool__print_text(help, TOOL_COLUMN, width);
}

/* Texts of the tools that draw or bake. */
#define TOOL_SIGNALS_WORDS \
    "A second Ctrl-C ends the program at once. If the graphics driver does not return within 6 seconds after the " \
    "first one, the program ends, too. SIGTERM and SIGHUP act like Ctrl-C.\n"
#define TOOL_STATUS_WORDS \
    "Exit status: 0 success; 1 failure, with one line on stderr; 2 wrong usage; after a signal: 130 (Ctrl-C), 143 " \
    "(SIGTERM), 129 (SIGHUP).\n"

/* Prints the options in groups. all: 1: every option with its complete text; 0: the short lines */
static void tool_print_help(const tool_option *table, int option_count, const tool_line *lines, int line_count,
                            int all) {
    int i, k, others = 0;
    for (i = 0; i < line_count; i++) {
        const tool_option *o = &table[lines[i].option < 0 ? 0 : lines[i].option];
        if (lines[i].option == TOOL_HEADING) printf("%s%s\n", all ? "\n" : "", lines[i].text);
        else if (all) tool__print_option(o, o->help, 1);
        else if (lines[i].text) tool__print_option(o, lines[i].text, 0);
    }
    if (!all) printf("\n" TOOL_NAME " --help all explains all options, files and the exit status.\n");
    for (k = 0; k < option_count && all; k++) {  /* options that no line names */
        for (i = 0; i < line_count && lines[i].option != k; i++) continue;
        if (i < line_count) continue;
        if (!others++) printf("\nOther:\n");
        tool__print_option(&table[k], table[k].help, 1);
    }
}

static int tool__is_whole(const tool_option *o) { return o->kind == INTEGERS || o->kind == SIZES; }

/* Reads count separated numbers into o->value. Returns 0 if the text has another form or a number is out of range. */
static int tool__numbers(const tool_option *o, const char *text) {
    double numbers[TOOL_NUMBERS];
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
            if (o->kind == FRACTIONS && *text == '%') { numbers[i] /= 100; text++; }
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

/* Reads a number of bytes, which may end in K, M, G or T, into o->value. Returns 0 if the text has another form or the
   number is out of range. */
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

/* Returns 1 if the text is a file name: it has an extension that begins with a letter, and no comma after the point. A
   number with an exponent, such as 1.e5, is not a file name. */
static int tool__names_a_file(const char *text) {
    const char *point = strrchr(text, '.');
    return point && isalpha((unsigned char)point[1]) && !strchr(point, ',') &&
        !(strchr("eE", point[1]) && !isalpha((unsigned char)point[2]));
}

/* The words of options that several tools share. */
static const char *const exposure_words[] = { "auto", NULL };
static const char *const tone_words[] = { "none", "neutral", "agx", NULL };

/* Returns the index of a text in the words of an option, or -1. */
static int tool__word(const tool_option *o, const char *text) {
    int k;
    for (k = 0; o->words[k] && strcmp(o->words[k], text) != 0; k++) continue;
    return o->words[k] ? k : -1;
}

/* Writes a number as people do: 1048576 and 1e30, not 1.04858e+06 and 1e+30. Returns text. */
static const char *tool__written(char text[32], double number) {
    char *plus;
    snprintf(text, 32, "%.15g", number);
    plus = strchr(text, '+');
    if (plus) memmove(plus, plus + 1, strlen(plus));
    return text;
}

/* Writes the value of an option that was given, always in the same form: 0.02 also for 2%. */
static inline void tool_value(const tool_option *o, char *out, size_t size) {
    char number[32];
    int i;
    out[0] = 0;
    if (o->file && *o->file) { snprintf(out, size, "%s", *o->file); return; }
    switch (o->kind) {
        case FLAG: case LIST: break;
        case TEXT: snprintf(out, size, "%s", *(const char **)o->value); break;
        case CHOICE: snprintf(out, size, "%s", o->words[*(int *)o->value]); break;
        case FLAG_OR_WORD: snprintf(out, size, "%d", *(int *)o->value); break;
        case BYTES: snprintf(out, size, "%zu", *(size_t *)o->value); break;
        default:
            for (i = 0; i < o->count; i++)
                snprintf(out + strlen(out), size - strlen(out), "%s%s", i ? "," : "",
                         tool__written(number, tool__is_whole(o) ? ((int *)o->value)[i] : ((double *)o->value)[i]));
    }
}

/* Describes the numbers of an option, such as "three numbers X,Y,Z from -1 to 1". */
static void tool__describe_numbers(const tool_option *o, char *out, size_t size) {
    static const char *const counts[TOOL_NUMBERS] = { "a", "two", "three", "four" };
    const char *sign = o->kind == FRACTIONS ? "%" : "", *whole = tool__is_whole(o) ? "whole " : "";
    const double unit = o->kind == FRACTIONS ? 100 : 1;
    const int shape = (int)strcspn(o->argument, "|");
    char low[32], high[32], what[96];
    if (o->kind == SIZES) snprintf(what, sizeof what, "%.*s with whole numbers", shape, o->argument);
    else if (o->kind == FRACTIONS) snprintf(what, sizeof what, "a fraction, such as 2%% or 0.02,");
    else if (o->count == 1) snprintf(what, sizeof what, "a %snumber", whole);
    else snprintf(what, sizeof what, "%s %snumbers %.*s", counts[o->count - 1], whole, shape, o->argument);
    snprintf(out, size, "%s%s%s from %s%s to %s%s%s%s", o->words ? o->words[0] : "", o->words ? " or " : "", what,
             tool__written(low, unit * o->low), sign, tool__written(high, unit * o->high), sign, o->file ? ", or " : "",
             o->file ? o->file_words : "");
}

/* Describes the allowed values of an option. */
static void tool__describe(const tool_option *o, char *out, size_t size) {
    int k;
    out[0] = 0;
    switch (o->kind) {
        case FLAG: break;
        case TEXT:
        case LIST: snprintf(out, size, "%s", o->argument); break;
        case BYTES: snprintf(out, size, "a size from 16M to 1024T, such as 512M or 4G"); break;
        case CHOICE:
        case FLAG_OR_WORD:
            for (k = 0; o->words[k]; k++)
                snprintf(out + strlen(out), size - strlen(out), "%s%s",
                         k == 0 ? "" : o->words[k + 1] ? ", " : " or ", o->words[k]);
            break;
        default: tool__describe_numbers(o, out, size);
    }
}

static int tool__refuse(const tool_option *o, const char *name, const char *value) {
    char what[256];
    tool__describe(o, what, sizeof what);
    return misuse("%s %s: the value must be %s", name, value, what);
}

/* Stores the value of an option. Returns the exit status. name: as the user typed it */
static int tool__take(const tool_option *o, const char *name, const char *value) {
    int k;
    switch (o->kind) {
        case TEXT: *(const char **)o->value = value; return DONE;
        case LIST:
            for (k = 0; k < o->count && ((const char **)o->value)[k]; k++) continue;
            if (k == o->count) return misuse("%s %s: this option can be given at most %d times", name, value, k);
            ((const char **)o->value)[k] = value;
            return DONE;
        case BYTES: return tool__bytes(o, value) ? DONE : tool__refuse(o, name, value);
        case CHOICE:
        case FLAG_OR_WORD:
            k = tool__word(o, value);
            *(int *)o->value = k + (o->kind == FLAG_OR_WORD);
            return k >= 0 ? DONE : tool__refuse(o, name, value);
        default:
            if (o->words && strcmp(value, o->words[0]) == 0) {
                if (tool__is_whole(o)) *(int *)o->value = 0;
                else *(double *)o->value = NAN;
                return DONE;
            }
            if (o->file) *o->file = tool__names_a_file(value) ? value : NULL;
            return (o->file && *o->file) || tool__numbers(o, value) ? DONE : tool__refuse(o, name, value);
    }
}

/* Returns the name or synonym of the option if the argument begins with it and either ends there or continues with "=".
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

enum { TOOL__TYPED = 40 };  /* longest name that is searched for typing errors */

/* Returns how many letters must be inserted, removed, replaced or swapped with the next to turn one word into the
   other. b: at most TOOL__TYPED letters */
static int tool__typing_errors(const char *a, const char *b) {
    int rows[3][TOOL__TYPED + 1] = { { 0 } }, *before = rows[0], *above = rows[1], *row = rows[2], *freed, i, k;
    const int wide = (int)strlen(b);
    for (k = 0; k <= wide; k++) row[k] = k;
    for (i = 1; a[i - 1]; i++) {
        freed = before;
        before = above;
        above = row;
        row = freed;
        row[0] = i;
        for (k = 1; k <= wide; k++) {
            row[k] = above[k - 1] + (a[i - 1] != b[k - 1]);
            if (row[k] > above[k] + 1) row[k] = above[k] + 1;
            if (row[k] > row[k - 1] + 1) row[k] = row[k - 1] + 1;
            if (i > 1 && k > 1 && a[i - 1] == b[k - 2] && a[i - 2] == b[k - 1] && row[k] > before[k - 2] + 1)
                row[k] = before[k - 2] + 1;
        }
    }
    return row[wide];
}

/* Reports an option that does not exist, and suggests one: the most similar name if it differs by at most a third of
   its letters, or the only name with this beginning. Returns the exit status. */
static int tool__unknown(const tool_command *c, const char *argument) {
    const char *word = argument + strspn(argument, "-"), *meant = NULL, *begins = NULL;
    char typed[TOOL__TYPED + 1];
    const int length = (int)strcspn(word, "="), shown = (int)(word - argument) + length;
    int i, k, least = length / 3 + 1, beginnings = 0;
    snprintf(typed, sizeof typed, "%.*s", length, word);
    for (i = 0; i < 2 * c->option_count && length <= TOOL__TYPED; i++) {
        const char *name = i % 2 ? c->table[i / 2].synonym : c->table[i / 2].name;
        if (!name) continue;
        k = tool__typing_errors(name + 2, typed);
        if (k < least) { least = k; meant = name; }
        if (length >= 3 && strncmp(name + 2, typed, (size_t)length) == 0) { beginnings++; begins = name; }
    }
    if (!meant && beginnings == 1) meant = begins;
    if (meant) return misuse("there is no option %.*s; did you mean %s?", shown, argument, meant);
    return misuse("there is no option %.*s; see --help", shown, argument);
}

/* Reads the complete command line. Returns the exit status. */
static int tool_parse(const tool_command *c) {
    int i, k, status = DONE, only_files = 0, files = 0;
    char what[256];
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
        if (!name) return tool__unknown(c, argument);
        value = argument[strlen(name)] ? argument + strlen(name) + 1 : NULL;
        c->given[o - c->table] = 1;
        if (o->kind == FLAG) {
            if (value) return misuse("%s takes no value", name);
            continue;
        }
        if (o->kind == FLAG_OR_WORD && !value && (i + 1 == c->argc || tool__word(o, c->argv[i + 1]) < 0)) continue;
        if (!value && i + 1 < c->argc) value = c->argv[++i];
        if (!value) {
            tool__describe(o, what, sizeof what);
            return misuse("%s needs a value: %s", name, what);
        }
        status = tool__take(o, name, value);
    }
    return status;
}

#endif
