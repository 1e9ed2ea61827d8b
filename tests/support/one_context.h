/* A context that all tests of a program share, and its allocator. Include after sbl.h, test.h, scenes.h and
   gl_watch.h. */
#ifndef ONE_CONTEXT_H
#define ONE_CONTEXT_H

static watch seen;
static sbl_context *context;

/* Replaces the context by a new one with this scene. Returns 0 on failure. */
static inline int use_scene(const test_scene *s) {
    const sbl_context_desc desc = watch_desc(&seen);
    sbl_destroy(context);
    context = watch_context(&seen, &desc, s);
    watch_forget(&seen);
    return context != NULL;
}

/* Calls call(desc) repeatedly, and makes a later allocation fail each time. The call must report the failure and leak
   nothing. After every fourth failure, the next call must write the same to `out` as an undisturbed one. scene: if not
   NULL, each call starts with a new context. Returns the number of allocations that were made to fail. */
static inline int each_allocation_fails(sbl_result (*call)(const void *desc), const void *desc, const test_scene *scene,
                                        void *out, size_t bytes) {
    enum { MOST = 600 };
    void *whole = malloc(bytes);
    int place, blocks;
    size_t used;
    if (!whole || (scene && !use_scene(scene)) || call(desc) != SBL_SUCCESS) {
        CHECK(0, "no memory or light: %s", watch_last(&seen));
        free(whole);
        return 0;
    }
    memcpy(whole, out, bytes);
    sbl_end(context);
    for (place = 1; place < MOST; place++) {
        sbl_result result;
        if (scene && !use_scene(scene)) break;
        blocks = seen.blocks;
        used = sbl_query_memory(context).host_bytes;
        watch_refuse(&seen, place);
        result = call(desc);
        if (!watch_refused(&seen, place, result)) break;
        CHECK(seen.errors > 0 && sbl_step(context, 0) == SBL_ERROR_STATE,
              "allocation %d: the call continues, or there is no message", place);
        sbl_end(context);
        if (!scene) {
            CHECK(seen.blocks == blocks, "allocation %d: %d blocks are not freed", place, seen.blocks - blocks);
            CHECK(sbl_query_memory(context).host_bytes == used, "allocation %d: sbl_query_memory reports unfreed bytes",
                  place);
        }
        if (place % 4 != 1) continue;
        memset(out, 0, bytes);
        CHECK(call(desc) == SBL_SUCCESS && memcmp(out, whole, bytes) == 0, "allocation %d: the next light differs",
              place);
        sbl_end(context);
    }
    CHECK(place < MOST, "the allocations do not end");
    free(whole);
    return place - 1;
}

#endif
