/* For tools that work in parts: reads --part, numbers the file names of parts, and describes the options in one line.
   Include after tool_scene.h and part_list.h. */
#ifndef TOOL_PART_H
#define TOOL_PART_H

#define PLAN_HASH_START 0xcbf29ce484222325ULL

/* Continues a hash (FNV-1a; Fowler, Noll, Vo) over bytes. The first call passes PLAN_HASH_START. */
static unsigned long long plan_hash(unsigned long long hash, const void *data, size_t bytes) {
    const unsigned char *c = (const unsigned char *)data;
    while (bytes--) hash = (hash ^ *c++) * 0x100000001b3ULL;
    return hash;
}

/* Writes the given options in one line, except for those in `without`, a list that ends with -1. */
static void plan_options(char *out, size_t size, const tool_option *table, int count, const int *given,
                         const int *without) {
    size_t used = 0;
    int i, k;
    out[0] = 0;
    for (i = 0; i < count; i++) {
        for (k = 0; without[k] >= 0 && without[k] != i; k++) continue;
        if (!given[i] || without[k] == i) continue;
        used += (size_t)snprintf(out + used, size - used, "%s%s=", used ? " " : "", table[i].name);
        if (used >= size) return;
        tool_value(&table[i], out + used, size - used);
        if (!out[used]) out[--used] = 0;  /* without a value, there is no = */
        used += strlen(out + used);
    }
}

/* The help text of --part about auto/N and about %d in --output. */
#define PLAN_AUTO_WORDS \
    "--part auto/N: K comes from SLURM_ARRAY_TASK_ID, SGE_TASK_ID or PBS_ARRAY_INDEX (1 to N), or from " \
    "JOB_COMPLETION_INDEX or AWS_BATCH_JOB_ARRAY_INDEX (0 to N - 1). In the name of --output, %d becomes K, and " \
    "%04d becomes K with 4 digits"

/* Environment variables in which job schedulers pass the number of a part, and the number of the first part there. */
static const struct { const char *name; int first; } plan_variables[] = {
    { "SLURM_ARRAY_TASK_ID", 1 }, { "SGE_TASK_ID", 1 }, { "PBS_ARRAY_INDEX", 1 },
    { "JOB_COMPLETION_INDEX", 0 }, { "AWS_BATCH_JOB_ARRAY_INDEX", 0 }
};

/* The values of --part K/N and --plan. */
typedef struct part_choice { const char *text, *plan; int number, count; } part_choice;  /* number, count: K and N */

/* Reads K and N from a text "K/N" or "auto/N". Returns the exit status. */
static int plan_part(part_choice *part) {
    const char *text = part->text, *value = NULL, *rest = text;
    char *end;
    size_t i;
    long k = 0, n;
    if (strncmp(text, "auto/", 5) == 0) {
        for (i = 0; i < sizeof plan_variables / sizeof *plan_variables && !value; i++) {
            value = getenv(plan_variables[i].name);
            if (!value || !*value || strcmp(value, "undefined") == 0) { value = NULL; continue; }
            k = strtol(value, &end, 10);
            if (*end || k < plan_variables[i].first || k > INT_MAX)
                return misuse("--part %s: %s is %s, which is not the number of a part", text, plan_variables[i].name,
                              value);
            k += 1 - plan_variables[i].first;
        }
        if (!value)
            return misuse("--part %s: none of SLURM_ARRAY_TASK_ID, SGE_TASK_ID, PBS_ARRAY_INDEX, JOB_COMPLETION_INDEX "
                          "and AWS_BATCH_JOB_ARRAY_INDEX is set", text);
        rest = text + 4;
    } else if (isdigit((unsigned char)*text)) {
        k = strtol(text, &end, 10);
        rest = end;
    }
    n = *rest == '/' && isdigit((unsigned char)rest[1]) ? strtol(rest + 1, &end, 10) : 0;
    if (*rest != '/' || n < 1 || *end || n > PARTS_MAX || k < 1)
        return misuse("--part %s: the value must be K/N, the K-th of N parts, with N from 1 to %d", text, PARTS_MAX);
    if (k > n) return misuse("--part %s: there are %ld parts, so part %ld does not exist", text, n, k);
    part->number = (int)k;
    part->count = (int)n;
    return DONE;
}

/* Writes the file name of a part or frame: %d in the pattern, or %04d with any number of digits, becomes the number.
   Returns 0 if the pattern has another form, or the name is too long. */
static int numbered_name(char *out, size_t size, const char *pattern, int number) {
    const char *sign = strchr(pattern, '%');
    int digits = 0, length = 0;
    if (!sign) return snprintf(out, size, "%s", pattern) < (int)size;
    if (sscanf(sign, "%%%2dd%n", &digits, &length) != 1 || !length) digits = 0, length = sign[1] == 'd' ? 2 : 0;
    if (!length || digits < 0 || strchr(sign + length, '%')) return 0;
    return snprintf(out, size, "%.*s%0*d%s", (int)(sign - pattern), pattern, digits, number, sign + length) < (int)size;
}

/* Reads the value of --part, and replaces %d in the output name by the number of the part. Returns the exit status. */
static int plan_part_and_output(part_choice *part) {
    static char name[PATH_MAX];
    const int status = plan_part(part);
    if (status == DONE && !numbered_name(name, sizeof name, common.output, part->number))
        return misuse("--output %s: %%d or %%04d stands for the number of the part; no other %% is allowed",
                      common.output);
    common.output = name;
    return status;
}

/* Checks that the file of --plan can be written if it does not exist. Returns the exit status. */
static int plan_check(const part_choice *part) {
    output_file file;
    int status = DONE;
    if (!part->plan || access(part->plan, F_OK) == 0) return DONE;
    if (!output_find(&file, part->plan) || !output_check(&file))
        status = fail("--plan %s: cannot be written: %s; give another file name", part->plan, strerror(errno));
    output_free(&file);
    return status;
}

#endif
