/* Watches a context under test. Its logger stores the messages. Its allocator counts allocations, fills new blocks with
   garbage, checks freed blocks, and can fail on demand.
       watch w = { 0 };
       sbl_context_desc desc = watch_desc(&w);
       watch_refuse(&w, 3);               // the third allocation from now on fails, once
   Include after sbl.h, test.h and scenes.h. */
#ifndef GL_WATCH_H
#define GL_WATCH_H

#include <stdint.h>
#include <stdlib.h>

enum { WATCH_MESSAGES = 64, WATCH_TEXT = 512 };

typedef struct watch {
    /* counted since watch_forget; the first WATCH_MESSAGES - 1 messages and the last one are stored */
    int count, errors, warnings;
    struct { sbl_log_level level; sbl_log_item item; char text[WATCH_TEXT]; } messages[WATCH_MESSAGES];
    int allocations, refuse_at, refused;
    int blocks;                   /* number of blocks that are allocated and not yet freed */
    size_t bytes;
    /* number of frees of blocks that were already freed, never allocated, or overrun */
    int strangers;
    void (*reached)(void);        /* if not NULL, called at each allocation */
} watch;

#define WATCH_MAGIC 0x5b10c0deu

typedef struct watch__block { size_t bytes; uint32_t magic, rubbish; } watch__block;

static inline void *watch_alloc(size_t bytes, void *user) {
    watch *w = (watch *)user;
    watch__block *block;
    uint32_t magic = WATCH_MAGIC;
    if (w->reached) w->reached();
    if (++w->allocations == w->refuse_at) { w->refused++; return NULL; }
    block = bytes < SIZE_MAX - 64 ? (watch__block *)malloc(sizeof *block + bytes + sizeof magic) : NULL;
    if (!block) return NULL;
    block->bytes = bytes;
    block->magic = magic;
    memset(block + 1, 0xcd, bytes);
    memcpy((char *)(block + 1) + bytes, &magic, sizeof magic);
    w->blocks++;
    w->bytes += bytes;
    return block + 1;
}

static inline void watch_free(void *pointer, void *user) {
    watch *w = (watch *)user;
    watch__block *block = (watch__block *)pointer - 1;
    uint32_t magic = 0;
    if (!pointer) { w->strangers++; return; }  /* sbl_allocator promises never to free NULL */
    if (block->magic == WATCH_MAGIC) memcpy(&magic, (char *)pointer + block->bytes, sizeof magic);
    if (magic != WATCH_MAGIC) { w->strangers++; return; }
    block->magic = 0;
    w->blocks--;
    w->bytes -= block->bytes;
    free(block);
}

/* Makes the allocation number `place`, from now on, fail. */
static inline void watch_refuse(watch *w, int place) {
    w->count = w->errors = w->warnings = w->refused = 0;
    w->refuse_at = w->allocations + place;
}

/* Call this after the tested call. Returns 1 if the allocation failed. Checks that the result was then
   SBL_ERROR_OUT_OF_MEMORY, and otherwise SBL_SUCCESS. */
static inline int watch_refused(watch *w, int place, sbl_result result) {
    w->refuse_at = 0;
    CHECK(result == (w->refused ? SBL_ERROR_OUT_OF_MEMORY : SBL_SUCCESS), "allocation %d: %s", place,
          sbl_result_string(result));
    return w->refused;
}

static inline void watch_log(sbl_log_level level, sbl_log_item item, const char *message, void *user) {
    watch *w = (watch *)user;
    int at;
    if (level == SBL_LOG_ERROR) w->errors++;
    if (level == SBL_LOG_WARNING) w->warnings++;
    at = w->count < WATCH_MESSAGES ? w->count : WATCH_MESSAGES - 1;
    w->messages[at].level = level;
    w->messages[at].item = item;
    snprintf(w->messages[at].text, WATCH_TEXT, "%s", message);
    w->count++;
}

static inline void watch_forget(watch *w) { w->count = w->errors = w->warnings = 0; }

/* Returns 1 if there is a message of this level and item that contains the texts a, b and c; NULL texts are ignored. */
static inline int watch_said(const watch *w, sbl_log_level level, sbl_log_item item, const char *a, const char *b,
                             const char *c) {
    int i;
    for (i = 0; i < w->count && i < WATCH_MESSAGES; i++) {
        const char *text = w->messages[i].text;
        if (w->messages[i].level == level && w->messages[i].item == item && (!a || strstr(text, a)) &&
            (!b || strstr(text, b)) &&
            (!c || strstr(text, c))) return 1;
    }
    return 0;
}

static inline const char *watch_last(const watch *w) {
    return w->count ? w->messages[(w->count < WATCH_MESSAGES ? w->count : WATCH_MESSAGES) - 1].text : "(no message)";
}

static inline sbl_context_desc watch_desc(watch *w) {
    sbl_context_desc desc;
    memset(&desc, 0, sizeof desc);
    desc.allocator.alloc = watch_alloc;
    desc.allocator.free = watch_free;
    desc.allocator.user = w;
    desc.logger.log = watch_log;
    desc.logger.user = w;
    return desc;
}

/* Creates a context and sets the scene. Returns NULL on failure. */
static inline sbl_context *watch_context(watch *w, const sbl_context_desc *desc, const test_scene *s) {
    sbl_scene_desc scene = scene_desc(s);
    sbl_context *context = NULL;
    watch_forget(w);
    if (sbl_create(desc, &context) == SBL_SUCCESS && sbl_set_scene(context, &scene) == SBL_SUCCESS) return context;
    CHECK(0, "no context or scene: %s", watch_last(w));
    sbl_destroy(context);
    return NULL;
}

#endif
