/* A bounded, repeatable run of the fuzz target (fuzz/fuzz.c). First it runs the corpus in tests/fuzz/corpus: small
   inputs that cover nearly all code reached by a long run, including a reproducer for each bug found and important call
   sequences. Then it runs random bytes. `build/test_fuzz FILE...` runs only the given files. */
#include "fuzz/fuzz.c"

static unsigned char input[4096];

static int run_file(const char *path) {
    const int before = fuzz_failures;
    FILE *file = fopen(path, "rb");
    size_t size;
    if (!file) { printf("  %s cannot be read\n", path); return 0; }
    size = fread(input, 1, sizeof input, file);
    fclose(file);
    fuzz_one(input, size);
    return fuzz_failures == before;
}

/* Runs the corpus, whose files are numbered without gaps. */
TEST(corpus) {
    char path[64];
    int number;
    for (number = 0; ; number++) {
        FILE *file;
        snprintf(path, sizeof path, "tests/fuzz/corpus/%02d", number);
        if (!(file = fopen(path, "rb"))) break;
        fclose(file);
        CHECK(run_file(path), "%s: see above", path);
    }
    CHECK(number >= 76, "%d inputs", number);
    CHECK(fuzz_counts.pictures > 0 && fuzz_counts.glossy > 2, "%d pictures, %d of them glossy", fuzz_counts.pictures,
          fuzz_counts.glossy);
    CHECK(fuzz_counts.gathers > 0 && fuzz_counts.inspections > 0 && fuzz_counts.out_of_memory > 0,
          "%d gathers, %d inspections, %d times out of memory", fuzz_counts.gathers, fuzz_counts.inspections,
          fuzz_counts.out_of_memory);
}

/* Makes calls with random parameters, some of them truncated. In between, a valid scene is set. */
TEST(random_bytes) {
    uint32_t state = 12345;
    int round, i;
    memset(&fuzz_counts, 0, sizeof fuzz_counts);
    for (round = 0; round < 48; round++) {
        const int size = 8 + round * 37 % 500, before = fuzz_failures;
        for (i = 0; i < size; i++) {
            state = state * 1664525u + 1013904223u;
            input[i] = (unsigned char)(state >> 24);
        }
        input[0] = (unsigned char)(round & 1);
        fuzz_one(input, (size_t)size);
        CHECK(fuzz_failures == before, "round %d: see above", round);
    }
    CHECK(fuzz_counts.accepted > 33 && fuzz_counts.refused > 33, "%d calls accepted, %d refused: too few of one kind",
          fuzz_counts.accepted, fuzz_counts.refused);

    CHECK(fuzz_counts.pictures > 4 && fuzz_counts.gathers > 3, "%d pictures, %d gathers finished",
          fuzz_counts.pictures, fuzz_counts.gathers);
}

/* Runs bakes of all kinds, which replace each other, with the valid scene and with random ones. */
TEST(random_bakes) {
    uint32_t state = 777;
    int round, i;
    memset(&fuzz_counts, 0, sizeof fuzz_counts);
    for (round = 0; round < 18; round++) {
        const int before = fuzz_failures;
        for (i = 0; i < 400; i++) {
            state = state * 1664525u + 1013904223u;
            input[i] = (unsigned char)(state >> 24);
            if ((state >> 8 & 3) == 0) input[i] = (unsigned char)(0x78 | (state >> 20 & 7));
        }
        input[0] = 0;
        input[1] = 1;
        fuzz_one(input, 400);
        CHECK(fuzz_failures == before, "round %d: see above", round);
    }
    CHECK(fuzz_counts.accepted > 45 && fuzz_counts.refused > 45 && fuzz_counts.bakes > 8,
          "%d calls accepted, %d refused, %d bakes finished",
          fuzz_counts.accepted, fuzz_counts.refused, fuzz_counts.bakes);
}

int main(int count, char **files) {
    int i;
    if (!fuzz_open()) { printf("no context\n"); return 1; }
    for (i = 1; i < count; i++) printf("%s %s\n", run_file(files[i]) ? "ok  " : "FAIL", files[i]);
    if (count > 1) return fuzz_failures != 0;
    RUN(corpus);
    RUN(random_bytes);
    RUN(random_bakes);
    fuzz_close();
    return test_report();
}
