/* Stored hashes of results, which tell whether a change of the code changes a bit of them. Results have the same bits
   only on the same GL renderer, so each renderer has hashes of its own. Include after sbl.h and test.h.
       static const uint64_t hashes[] = { ... };
       static const pin_set sets[] = { { "llvmpipe", "Mesa 22.3.6", hashes } };
       const uint64_t *known = pins_of(context, sets, 1);
       pins_compare(known, 0, "name", pins_add(PINS_EMPTY, values, sizeof values)); */
#ifndef PINS_H
#define PINS_H

/* renderer: part of GL_RENDERER; version: part of GL_VERSION; hashes: one hash for each case, in the order of cases */
typedef struct pin_set { const char *renderer, *version; const uint64_t *hashes; } pin_set;

#define PINS_EMPTY 14695981039346656037u  /* the hash of no bytes */

/* Adds bytes to a 64-bit FNV-1a hash. */
static uint64_t pins_add(uint64_t hash, const void *bytes, size_t count) {
    const unsigned char *b = (const unsigned char *)bytes;
    size_t i;
    for (i = 0; i < count; i++) hash = (hash ^ b[i]) * 1099511628211u;
    return hash;
}

/* Returns the hashes that are stored for the renderer of the context. If there are none, prints the renderer and
   returns NULL. */
static const uint64_t *pins_of(const sbl_context *context, const pin_set *sets, int count) {
    const sbl_capabilities c = sbl_query_capabilities(context);
    int i;
    for (i = 0; i < count; i++)
        if (strstr(c.renderer, sets[i].renderer) && strstr(c.version, sets[i].version)) return sets[i].hashes;
    printf("    nothing is stored for { \"%s\", \"%s\" }\n", c.renderer, c.version);
    return NULL;
}

/* Checks the hash of case i. known: result of pins_of; NULL: prints the line to store instead */
static void pins_compare(const uint64_t *known, int i, const char *name, uint64_t hash) {
    if (known) CHECK(hash == known[i], "%s has changed: its hash is 0x%016llx", name, (unsigned long long)hash);
    else printf("    0x%016llxu,  /* %s */\n", (unsigned long long)hash, name);
}

#endif
