/* Linked into programs with the address sanitizer. The GL driver and its compiler get memory from the allocator of
   libc, and all other code gets memory from the sanitizer. The driver requests far more memory than the code under
   test, and the sanitizer's allocator takes several times as long, so that it would take half of the time of most
   tests. The checks stay the same: the driver is not instrumented, and its functions still find the mistakes in memory
   that the code under test passes to them.

   Two words precede a block of the driver: the distance from the start of the memory that libc returned, and a mark.
   This file defines nothing if libc has no _dl_find_object, which is new in glibc 2.35. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <link.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#ifdef DLFO_STRUCT_HAS_EH_DBASE

void *__libc_malloc(size_t), *__libc_calloc(size_t, size_t), *__libc_realloc(void *, size_t);
void __libc_free(void *);
void *__interceptor_malloc(size_t), *__interceptor_calloc(size_t, size_t), *__interceptor_realloc(void *, size_t);
void *__interceptor_memalign(size_t, size_t), *__interceptor_aligned_alloc(size_t, size_t);
void __interceptor_free(void *);
void *__interceptor_reallocarray(void *, size_t, size_t);
int __interceptor_posix_memalign(void **, size_t, size_t);
size_t __interceptor_malloc_usable_size(void *);

static const uint64_t mark = 0x9d8a3c51e7b2f604u;
enum { HEAD = 16 };

/* Returns 1 if a module belongs to the driver. The C++ library is one of them, because it requests memory for the
   compiler of the driver. */
static int is_driver(const char *path) {
    static const char *const names[] = { "_dri.so", "libgallium", "libLLVM", "_mesa.so", "libglapi", "libstdc++",
                                         "libzstd", "libexpat", "libdrm", "nvidia" };
    size_t i;
    for (i = 0; i < sizeof names / sizeof *names; i++) if (strstr(path, names[i])) return 1;
    return 0;
}

/* Returns 1 if the code at an address belongs to the driver. */
static int in_driver(const void *code) {
    static __thread struct { uintptr_t start, end; int driver; } known[16];
    const uintptr_t at = (uintptr_t)code;
    const size_t i = at >> 20 & 15;
    struct dl_find_object found;
    if (at >= known[i].start && at < known[i].end) return known[i].driver;
    if (_dl_find_object((void *)code, &found) != 0) return 0;
    known[i].start = (uintptr_t)found.dlfo_map_start;
    known[i].end = (uintptr_t)found.dlfo_map_end;
    known[i].driver = is_driver(found.dlfo_link_map->l_name);
    return known[i].driver;
}
#define CALLED_BY_DRIVER() in_driver(__builtin_return_address(0))

static int is_marked(const void *block) { return block && ((const uint64_t *)block)[-1] == mark; }
static void *start_of(void *block) { return (char *)block - ((uint64_t *)block)[-2]; }
static void *marked(void *start, size_t distance) {
    uint64_t *const block = (uint64_t *)((char *)start + distance);
    if (!start) return NULL;
    block[-1] = mark;
    block[-2] = distance;
    return block;
}

static void *driver_alloc(size_t size) {
    return size > SIZE_MAX - HEAD ? NULL : marked(__libc_malloc(size + HEAD), HEAD);
}
static void *driver_align(size_t alignment, size_t size) {
    char *start;
    if (size > SIZE_MAX - alignment - HEAD || !(start = (char *)__libc_malloc(size + alignment + HEAD))) return NULL;
    return marked(start, HEAD + (size_t)(-(uintptr_t)(start + HEAD) & (alignment - 1)));
}
static void driver_free(void *block) {
    void *const start = start_of(block);
    ((uint64_t *)block)[-1] = 0;
    __libc_free(start);
}

void *malloc(size_t size) { return CALLED_BY_DRIVER() ? driver_alloc(size) : __interceptor_malloc(size); }

void *calloc(size_t count, size_t size) {
    size_t all;
    if (!CALLED_BY_DRIVER()) return __interceptor_calloc(count, size);
    if (__builtin_mul_overflow(count, size, &all) || all > SIZE_MAX - HEAD) return NULL;
    return marked(__libc_calloc(1, all + HEAD), HEAD);
}

static void *change_size(void *block, size_t size) {
    const size_t distance = ((uint64_t *)block)[-2];
    return size > SIZE_MAX - distance ? NULL : marked(__libc_realloc(start_of(block), size + distance), distance);
}
void *realloc(void *block, size_t size) {
    if (is_marked(block)) return change_size(block, size);
    return !block && CALLED_BY_DRIVER() ? driver_alloc(size) : __interceptor_realloc(block, size);
}
void *reallocarray(void *block, size_t count, size_t size) {
    if (!is_marked(block)) return __interceptor_reallocarray(block, count, size);
    return __builtin_mul_overflow(count, size, &size) ? NULL : change_size(block, size);
}

void *memalign(size_t alignment, size_t size) {
    return CALLED_BY_DRIVER() ? driver_align(alignment, size) : __interceptor_memalign(alignment, size);
}
void *aligned_alloc(size_t alignment, size_t size) {
    return CALLED_BY_DRIVER() ? driver_align(alignment, size) : __interceptor_aligned_alloc(alignment, size);
}
int posix_memalign(void **block, size_t alignment, size_t size) {
    if (!CALLED_BY_DRIVER()) return __interceptor_posix_memalign(block, alignment, size);
    *block = driver_align(alignment, size);
    return *block ? 0 : ENOMEM;
}

char *strdup(const char *text) {
    const size_t size = strlen(text) + 1;
    char *copy = CALLED_BY_DRIVER() ? driver_alloc(size) : __interceptor_malloc(size);
    return copy ? memcpy(copy, text, size) : NULL;
}

void free(void *block) {
    if (is_marked(block)) driver_free(block);
    else __interceptor_free(block);
}

/* The word before a block of libc is the size of the block and of two further words, with flags in its low bits. */
size_t malloc_usable_size(void *block) {
    if (!is_marked(block)) return __interceptor_malloc_usable_size(block);
    return (((size_t *)start_of(block))[-1] & ~(size_t)7) - 16 - ((uint64_t *)block)[-2];
}

/* ---- operators of C++ ---- */

static void *next(const char *name) { return dlsym(RTLD_NEXT, name); }
static void *not_null(void *block) {
    if (!block) abort();
    return block;
}

/* Blocks of C++ from this size on come from the allocator of libc, whoever requests them. The reader of .obj files
   requests such a block for each file and fills it with zeros, and the sanitizer would get new pages for it each time,
   which take a tenth of the page faults of a short run. The code under test is C and uses no operators. */
enum { LARGE = 16 << 20 };

#define NEW(symbol, parameters, arguments, block)                                  \
    void *symbol parameters;                                                       \
    void *symbol parameters {                                                      \
        static void *(*sanitizer) parameters;                                      \
        if (size >= LARGE || CALLED_BY_DRIVER()) return block;                     \
        if (!sanitizer) sanitizer = (void *(*) parameters)next(#symbol);           \
        return sanitizer arguments;                                                \
    }
NEW(_Znwm, (size_t size), (size), not_null(driver_alloc(size)))
NEW(_Znam, (size_t size), (size), not_null(driver_alloc(size)))
NEW(_ZnwmRKSt9nothrow_t, (size_t size, const void *tag), (size, tag), driver_alloc(size))
NEW(_ZnamRKSt9nothrow_t, (size_t size, const void *tag), (size, tag), driver_alloc(size))
NEW(_ZnwmSt11align_val_t, (size_t size, size_t alignment), (size, alignment), not_null(driver_align(alignment, size)))
NEW(_ZnamSt11align_val_t, (size_t size, size_t alignment), (size, alignment), not_null(driver_align(alignment, size)))

#define DELETE(symbol, parameters, arguments)                                      \
    void symbol parameters;                                                        \
    void symbol parameters {                                                       \
        static void (*sanitizer) parameters;                                       \
        if (is_marked(block)) {                                                    \
            driver_free(block);                                                    \
            return;                                                                \
        }                                                                          \
        if (!sanitizer) sanitizer = (void (*) parameters)next(#symbol);            \
        sanitizer arguments;                                                       \
    }
DELETE(_ZdlPv, (void *block), (block))
DELETE(_ZdaPv, (void *block), (block))
DELETE(_ZdlPvm, (void *block, size_t size), (block, size))
DELETE(_ZdaPvm, (void *block, size_t size), (block, size))
DELETE(_ZdlPvRKSt9nothrow_t, (void *block, const void *tag), (block, tag))
DELETE(_ZdaPvRKSt9nothrow_t, (void *block, const void *tag), (block, tag))
DELETE(_ZdlPvSt11align_val_t, (void *block, size_t alignment), (block, alignment))
DELETE(_ZdaPvSt11align_val_t, (void *block, size_t alignment), (block, alignment))
DELETE(_ZdlPvmSt11align_val_t, (void *block, size_t size, size_t alignment), (block, size, alignment))
DELETE(_ZdaPvmSt11align_val_t, (void *block, size_t size, size_t alignment), (block, size, alignment))

#endif
