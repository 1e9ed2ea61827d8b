/* Tests without GL of private functions in many sections of sbl.h, such as topology, solver, seams, interpolation,
   bounces and refinement. Most expected values are closed forms. */
#include "support/private.h"
#include "support/test.h"

static sbl__base base;

static void *take(size_t bytes, void *user) { (void)user; return malloc(bytes); }
static void give(void *pointer, void *user) { (void)user; free(pointer); }

static void draws_nothing(const sbl_draw_view *v, void *user) { (void)v; (void)user; }

static sbl__slice slice_of(double seconds) {
    sbl_context_desc desc;
    memset(&desc, 0, sizeof desc);
    return sbl__slice_of(&desc, seconds);
}

static int same_tens(const void *user, uint32_t one, uint32_t other) { (void)user; return one / 10 == other / 10; }

/* No buffer has a size for which Mesa's software renderer compiles programs anew, and none is much larger than asked
   for. */
TEST(buffers_of_all_sizes_share_programs) {
    static const size_t largest[3] = { 65536, 1u << 24, 1u << 30 };
    size_t bytes;
    int i;
    for (bytes = 0; bytes < 140000; bytes++) {
        const size_t capacity = sbl__buffer_capacity(bytes);
        CHECK(capacity >= bytes && capacity <= bytes + 272 && (capacity & (capacity - 1)) && (capacity >> 8) % 256,
              "%.0f of %.0f bytes", (double)capacity, (double)bytes);
    }
    for (i = 0; i < 3; i++) {
        const size_t capacity = sbl__buffer_capacity(largest[i]);
        CHECK(capacity > largest[i] && capacity <= largest[i] + 272 && (capacity >> 8) % 256, "%.0f of %.0f bytes",
              (double)capacity, (double)largest[i]);
    }
}

/* All keys of this test have the same hash; therefore they are in one chain. Equal keys are found, and the chain keeps
   its order. */
TEST(numbers_are_found_in_order) {
    sbl__hash_table t = { NULL, 0 };
    uint32_t i, slot = 7, wrong = 0;
    REQUIRE(sbl__hash_table_make(&base, &t, 100) == SBL_SUCCESS, "no memory");
    CHECK(t.mask >= 199, "%u slots for 100 numbers", t.mask + 1);
    for (i = 0; i < 100; i++) wrong += sbl__hash_table_first(&t, 7, i, same_tens, NULL) != i / 10 * 10;
    CHECK(!wrong, "%u numbers are not found", wrong);
    for (i = 0; i < 10; i++) wrong += sbl__bucket_next(&t, &slot) != 10 * i;
    CHECK(!wrong && sbl__bucket_next(&t, &slot) == SBL__NONE, "ten numbers are not in order");
    sbl__hash_table_free(&base, &t);
}

/* The working grid of a window contains all pixels that anti-aliasing (two pixels away) and the filter (filter_radius
   away from these) read, and their errors count; it begins at a first-level tile, and ends one pixel after one or with
   the picture. */
TEST(windows_contain_what_they_read) {
    enum { SIZE = 97 };
    sbl_picture_desc d;
    int from, length, tile, radius, k;
    memset(&d, 0, sizeof d);
    d.width = d.height = SIZE;
    for (radius = -1; radius < 5; radius += 3)
        for (tile = 4; tile <= 32; tile *= 2)
            for (from = 0; from < SIZE; from += 3)
                for (length = 1; from + length <= SIZE; length += 11) {
                    const int window[4] = { from, SIZE - from - length, length, length };
                    const int reach = 2 + (radius > 0 ? radius : 0);
                    sbl__window w;
                    d.tile = tile;
                    d.filter_radius = radius;
                    memcpy(d.window, window, sizeof d.window);
                    w = sbl__window_of(&d);
                    for (k = 0; k < 2; k++) {
                        const int end = w.first[k] + w.size[k], first = SBL__MAX(window[k] - reach, 0);
                        const int last = SBL__MIN(window[k] + length + reach, SIZE);
                        const int at[2] = { k ? w.inset[0] : first - w.first[0], k ? first - w.first[1] : w.inset[1] };
                        CHECK(w.first[k] <= first && end >= last && w.first[k] % tile == 0 &&
                              (end == SIZE || end % tile == 1) && w.shown[k] == length &&
                              w.first[k] + w.inset[k] == window[k], "%d pixels from %d in tiles of %d: %d to %d",
                              length, window[k], tile, w.first[k], end);
                        CHECK(sbl__window_counts(&w, at[0], at[1]), "the error of pixel %d does not count", first);
                    }
                }
}

/* 0 and -0 have the same hash and are equal. */
TEST(zeroes_are_the_same) {
    const float a[3] = { 0, -0.0f, 1 }, b[3] = { -0.0f, 0, 1 }, c[3] = { 0, 0, 2 };
    CHECK(sbl__hash_floats(5, a, 3) == sbl__hash_floats(5, b, 3) && sbl__same_floats(a, b, 3), "0 and -0 differ");
    CHECK(sbl__hash_floats(5, a, 3) != sbl__hash_floats(5, c, 3) && !sbl__same_floats(a, c, 3), "1 is 2");
    CHECK(sbl__same_floats(a, c, 2), "the third float is compared");
}

/* Positions of one mesh are compared by value. Equal positions of two meshes are different. */
TEST(positions_of_two_meshes_differ) {
    sbl__vertex v[3];
    sbl__geometry g;
    memset(v, 0, sizeof v);
    memset(&g, 0, sizeof g);
    g.vertices = v;
    v[0].position[1] = v[1].position[1] = v[2].position[1] = 3;
    v[1].object = 1;
    CHECK(sbl__same_position(&g, 0, 2) && sbl__position_hash(&g, 0) == sbl__position_hash(&g, 2),
          "equal positions of one mesh differ");
    CHECK(!sbl__same_position(&g, 0, 1), "equal positions of two meshes are the same place");
    v[2].position[2] = 1;
    CHECK(!sbl__same_position(&g, 0, 2), "different positions are the same place");
}

/* The test has four triangles: two that share an edge with the same order of corners; a third that touches them only at
   a corner; and a fourth that shares an edge with the second in the reverse order. */
TEST(sides_are_shared) {
    static const uint32_t corners[12] = { 0, 1, 2, 1, 2, 3, 3, 4, 5, 3, 2, 6 };
    static const uint32_t first[12] = { 0, 1, 2, 1, 4, 5, 6, 7, 8, 4, 10, 11 };
    sbl__hash_table t = { NULL, 0 };
    uint32_t i;
    REQUIRE(sbl__hash_table_make(&base, &t, 12) == SBL_SUCCESS, "no memory");
    for (i = 0; i < 12; i++) {
        const uint32_t found = sbl__first_side(&t, corners, i);
        CHECK(found == first[i], "side %u is side %u's, expected %u", i, found, first[i]);
    }
    CHECK(sbl__side_end(corners, 4, 0) == 2 && sbl__side_end(corners, 4, 1) == 3 && sbl__side_end(corners, 4, 2) == 1,
          "the ends of side 4 are wrong");
    sbl__hash_table_free(&base, &t);
}

/* The root of a group is its smallest index, whatever the order is in which its members are joined. */
TEST(groups_have_their_least_number) {
    enum { COUNT = 1000 };
    static uint32_t parents[COUNT];
    uint32_t i, wrong = 0;
    for (i = 0; i < COUNT; i++) parents[i] = i;
    for (i = COUNT - 1; i >= 7; i--) sbl__join(parents, i, i - 7);
    for (i = 0; i < COUNT; i++) wrong += sbl__root(parents, i) != i % 7;
    CHECK(!wrong, "%u numbers have a wrong root", wrong);
    sbl__join(parents, 996, 5);
    CHECK(sbl__root(parents, 996) == sbl__root(parents, 5), "two joined groups have different roots");
}

enum { GRID_WIDTH = 12, GRID_HEIGHT = 9 };
static double values[GRID_WIDTH * GRID_HEIGHT];
static sbl__rings rings;

static void mean_of_neighbours(void *user, int element) {
    double sum = 0, count = 0;
    size_t step = 0;
    int other;
    (void)user;
    while ((other = sbl__ring_grid(&rings, element, &step)) >= 0) {
        if (!sbl__ring_reached(&rings, other)) continue;
        sum += values[other];
        count += 1;
    }
    values[element] = sum / count;
}

/* Spreads values from the left column over `last` columns, and checks the result. In the left column each value is its
   row; each further value is the mean of the three adjacent values on its left. */
static void spread(int last) {
    sbl__slice slice = slice_of(0);
    int i, x, y;
    memset(&rings, 0, sizeof rings);
    rings.mean = mean_of_neighbours;
    rings.width = GRID_WIDTH;
    rings.last = last;
    REQUIRE(sbl__rings_make(&base, &rings, GRID_WIDTH * GRID_HEIGHT, GRID_WIDTH * GRID_HEIGHT) == SBL_SUCCESS,
            "no memory");
    for (i = 0; i < GRID_WIDTH * GRID_HEIGHT; i++) values[i] = -1;
    for (y = 0; y < GRID_HEIGHT; y++) {
        values[y * GRID_WIDTH] = y;
        rings.ring[y * GRID_WIDTH] = 0;
    }
    while (sbl__rings_step(&rings, &slice) == SBL_UNFINISHED) {}
    for (y = 0; y < GRID_HEIGHT; y++)
        for (x = 1; x < GRID_WIDTH; x++) {
            const double *before = values + y * GRID_WIDTH + x - 1;
            const int above = y > 0, below = y + 1 < GRID_HEIGHT;
            const double sum = (above ? before[-GRID_WIDTH] : 0) + before[0] + (below ? before[GRID_WIDTH] : 0);
            const double expected = x > last ? -1 : sum / (1 + above + below);
            CHECK(fabs(values[y * GRID_WIDTH + x] - expected) < 1e-12, "%d rings: %d %d is %g, expected %g", last, x, y,
                  values[y * GRID_WIDTH + x], expected);
            CHECK(rings.ring[y * GRID_WIDTH + x] == (x > last ? SBL__RING_WAITS : x), "%d %d is in ring %d", x, y,
                  rings.ring[y * GRID_WIDTH + x]);
        }
    sbl__rings_free(&base, &rings);
}

/* Values spread to the last column, or to fewer columns, in rings of equal distance. */
TEST(values_spread_ring_by_ring) {
    spread(GRID_WIDTH);
    spread(3);
    spread(0);
}

/* Makes a least squares problem of random rows and a small multiple of the identity, whose solution is compared with
   elimination. */
enum { UNKNOWNS = 12, ROWS = 20 };
static double rows[ROWS][UNKNOWNS];

static void row_term(void *user, int row, const double *direction, double *product) {
    int i, k;
    (void)user;
    for (k = 0; k < 3; k++) {
        double dot = 0;
        for (i = 0; i < UNKNOWNS; i++) dot += rows[row][i] * direction[3 * i + k];
        for (i = 0; i < UNKNOWNS; i++) product[3 * i + k] += rows[row][i] * dot;
    }
}

/* Solves the dense system without the unknowns whose diagonal is 0. */
static void eliminate(int channel, const double *diagonal, const double *right, double identity, double *out) {
    double m[UNKNOWNS][UNKNOWNS + 1];
    int i, j, k;
    memset(m, 0, sizeof m);
    for (i = 0; i < UNKNOWNS; i++) {
        for (j = 0; j < UNKNOWNS; j++) {
            for (k = 0; k < ROWS; k++) m[i][j] += rows[k][i] * rows[k][j];
            if (i == j) m[i][j] += identity;
            if (!(diagonal[3 * i + channel] > 0) || !(diagonal[3 * j + channel] > 0)) m[i][j] = i == j;
        }
        m[i][UNKNOWNS] = diagonal[3 * i + channel] > 0 ? right[3 * i + channel] : 0;
    }
    for (k = 0; k < UNKNOWNS; k++)
        for (i = 0; i < UNKNOWNS; i++) {
            const double share = m[i][k] / m[k][k];
            for (j = k; j <= UNKNOWNS && i != k; j++) m[i][j] -= share * m[k][j];
        }
    for (i = 0; i < UNKNOWNS; i++) out[i] = m[i][UNKNOWNS] / m[i][i];
}

static void solve(int together, int preconditioned, double identity, int bound) {
    double right[3 * UNKNOWNS], diagonal[3 * UNKNOWNS], expected[UNKNOWNS];
    sbl__slice slice = slice_of(0);
    sbl__solver s;
    uint32_t seed = 1;
    int i, k, run;
    memset(&s, 0, sizeof s);
    for (i = 0; i < ROWS * UNKNOWNS; i++) rows[i / UNKNOWNS][i % UNKNOWNS] = sbl__hash(seed++) / 4294967296.0 - 0.3;
    REQUIRE(sbl__solver_make(&base, &s, UNKNOWNS) == SBL_SUCCESS, "no memory");
    CHECK(base.memory.host_bytes == 5 * 3 * UNKNOWNS * sizeof(double), "the arrays have %d bytes",
          (int)base.memory.host_bytes);
    s.term = row_term;
    s.term_count = ROWS;
    s.together = together;
    s.identity = identity;
    s.precision2 = 1e-24;
    for (i = 0; i < 3 * UNKNOWNS; i++) {
        diagonal[i] = preconditioned ? identity : 1;
        for (k = 0; k < ROWS && preconditioned; k++) diagonal[i] += rows[k][i / 3] * rows[k][i / 3];
        if (bound && i % 5 == 0) diagonal[i] = 0;
        s.diagonal[i] = diagonal[i];
    }
    for (run = 0; run < 2; run++) {  /* the solution of the second right-hand side must not depend on the first */
        for (i = 0; i < 3 * UNKNOWNS; i++) {
            s.solution[i] = 0;
            s.residual[i] = right[i] = i % 3 == 2 && run ? 0 : sbl__hash(seed++) / 4294967296.0;
        }
        while (sbl__solver_step(&s, &slice) == SBL_UNFINISHED) {}
        for (k = 0; k < 3; k++) {
            eliminate(k, diagonal, right, identity, expected);
            for (i = 0; i < UNKNOWNS; i++)
                CHECK(fabs(s.solution[3 * i + k] - expected[i]) < 1e-7,
                      "run %d, unknown %d of channel %d: %g, expected %g", run, i, k, s.solution[3 * i + k],
                      expected[i]);
        }
    }
    sbl__solver_free(&base, &s);
}

/* The solver agrees with elimination, with and without preconditioning, fixed unknowns and channels that are solved
   together. */
TEST(least_squares_are_solved) {
    solve(0, 1, 0, 0);
    solve(0, 1, 0.1, 1);
    solve(1, 0, 0.1, 0);
    solve(1, 0, 0.1, 1);
}

/* Multiplies unknown i by 2^i, and counts the calls. */
static void power_term(void *calls, int unused, const double *direction, double *product) {
    int i;
    (void)unused;
    for (i = 0; i < 9; i++) product[i] += direction[i] * (1 << i / 3);
    ++*(int *)calls;
}

/* In the right-hand side of channel k, only unknown k is not 0. Therefore one iteration solves each channel by itself.
   Solved together, the channels have three eigenvalues, which need three iterations. */
TEST(channels_are_solved_apart) {
    int together, i;
    for (together = 0; together < 2; together++) {
        sbl__slice slice = slice_of(0);
        sbl__solver s;
        int calls = 0;
        memset(&s, 0, sizeof s);
        REQUIRE(sbl__solver_make(&base, &s, 3) == SBL_SUCCESS, "no memory");
        s.user = &calls;
        s.term = power_term;
        s.term_count = 1;
        s.together = together;
        s.precision2 = 1e-20;
        for (i = 0; i < 9; i++) {
            s.diagonal[i] = 1;
            s.residual[i] = i % 4 == 0;
        }
        while (sbl__solver_step(&s, &slice) == SBL_UNFINISHED) {}
        CHECK(calls == (together ? 3 : 1), "together %d: %d iterations", together, calls);
        for (i = 0; i < 9; i++)
            CHECK(fabs(s.solution[i] - (i % 4 ? 0 : 1.0 / (1 << i / 3))) < 1e-9, "together %d: number %d is %g",
                  together, i, s.solution[i]);
        sbl__solver_free(&base, &s);
    }
}

static void counted_term(void *calls, int row, const double *direction, double *product) {
    *(int *)calls += row == 0;
    row_term(NULL, row, direction, product);
}

/* A solution that is continued from a small residual need not become more accurate than the first one. */
TEST(continued_solutions_stop_early) {
    sbl__slice slice = slice_of(1e-9);
    const double rights[4] = { 1, 1e-2, 1, 1e-5 };
    sbl__solver s;
    int calls[4] = { 0, 0, 0, 0 }, i, run;
    memset(&s, 0, sizeof s);
    REQUIRE(sbl__solver_make(&base, &s, UNKNOWNS) == SBL_SUCCESS, "no memory");
    s.term = counted_term;
    s.term_count = ROWS;
    s.precision2 = 1e-8;
    s.identity = 0.1;
    for (run = 0; run < 4; run++) {
        s.user = &calls[run];
        for (i = 0; i < 3 * UNKNOWNS; i++) {
            s.diagonal[i] = 1;
            s.residual[i] = rights[run] * (sbl__hash((uint32_t)i) / 4294967296.0 - 0.4);
        }
        while (sbl__solver_step(&s, &slice) == SBL_UNFINISHED) {}
    }
    CHECK(calls[0] > 3 && calls[1] > 0 && calls[1] < calls[0] && calls[2] == calls[0] && calls[3] == 0,
          "%d iterations, then %d, %d and %d", calls[0], calls[1], calls[2], calls[3]);
    sbl__solver_free(&base, &s);
}

/* A right-hand side of 0 gives the solution 0 in one step. */
TEST(zero_is_solved_at_once) {
    sbl__slice slice = slice_of(0);
    sbl__solver s;
    int i;
    memset(&s, 0, sizeof s);
    REQUIRE(sbl__solver_make(&base, &s, UNKNOWNS) == SBL_SUCCESS, "no memory");
    s.term = row_term;
    s.term_count = ROWS;
    for (i = 0; i < 3 * UNKNOWNS; i++) s.diagonal[i] = 1;
    CHECK(sbl__solver_step(&s, &slice) == SBL_SUCCESS, "a right side of 0 takes more than one step");
    for (i = 0; i < 3 * UNKNOWNS; i++) CHECK(!(fabs(s.solution[i]) > 0), "unknown %d is %g", i, s.solution[i]);
    sbl__solver_free(&base, &s);
}

/* At a point of a seam, one side is the mean of texels 0 and 1, and the other side is texel 2. The change by least
   squares would make R of texel 0 negative. R of this texel becomes 0 instead, and the other texels take over the rest
   of the change. A harmonic may become negative. */
TEST(seams_keep_light_positive) {
    static const double expected[2][3] = { { 0, 0.84, 0.42 }, { -2 / 15.0, 13 / 15.0, 11 / 30.0 } };
    sbl__seam_point point = { { 0, 1, 2, 2, 2, 2, 2, 2 }, { 0.5f, 0.5f, -1, 0, 0, 0, 0, 0 } };
    int texels[3] = { 2, 0, 1 }, layer, i;
    float light[12];
    sbl__slice slice = slice_of(0);
    sbl__gutters gutters;
    sbl__atlas atlas;
    sbl__seams seams;
    memset(&gutters, 0, sizeof gutters);
    memset(&atlas, 0, sizeof atlas);
    memset(&seams, 0, sizeof seams);
    gutters.light = light;
    atlas.base = &base;
    seams.points = &point;
    seams.point_count = 1;
    seams.texels = texels;
    seams.unknown_count = 3;
    for (layer = 0; layer < 2; layer++) {
        for (i = 0; i < 12; i++) light[i] = 0;
        for (i = 0; i < 3; i++) {
            light[4 * texels[1] + i] = 1;
            light[4 * texels[2] + i] = 0.1f;
        }
        seams.layer = layer - 1;  /* the search for edges comes first, then the next layer begins */
        while (sbl__seams_step(&seams, &gutters, &atlas, layer, &slice) == SBL_UNFINISHED) {}
        for (i = 0; i < 9; i++)
            CHECK(fabs((double)light[4 * texels[i / 3] + i % 3] - expected[layer][i / 3]) < 0.001,
                  "layer %d: channel %d of texel %d is %g, expected %g", layer, i % 3, i / 3,
                  (double)light[4 * texels[i / 3] + i % 3], expected[layer][i / 3]);
        if (layer == 0)
            CHECK(fabs((double)seams.before - 0.4) < 1e-6 && seams.after < 0.001f, "the seam had %g, has %g",
                  (double)seams.before, (double)seams.after);
    }
    sbl__solver_free(&base, &seams.solver);
}

/* A point of a seam has the light that a bilinear sample of the map has there. Within half a texel of the border of the
   map, this is the light at the border. */
TEST(seams_are_sampled_as_maps) {
    static const struct { double at[2]; int texels[2]; double weights[2]; } cases[4] = {
        { { 0.2, 0.2 }, { 0, 15 }, { 1, 0 } }, { { 3.9, 3.8 }, { 0, 15 }, { 0, 1 } },
        { { 2, 1.5 }, { 5, 6 }, { 0.5, 0.5 } }, { { 0.3, 2.75 }, { 8, 12 }, { 0.75, 0.25 } } };
    static float light[4 * 16];
    sbl__gutters g;
    int i, k, side, at;
    memset(&g, 0, sizeof g);
    g.size[0] = g.size[1] = 4;
    g.light = light;
    for (i = 0; i < 8; i++) {
        double sums[16] = { 0 };
        sbl__seam_point p;
        side = i / 4;
        CHECK(sbl__seam_mix(&g, cases[i % 4].at, side, &p), "no light");
        for (k = 4 * side; k < 4 * side + 4; k++) sums[p.unknowns[k]] += (double)p.weights[k];
        for (k = 0; k < 16; k++) {
            double expected = 0;
            for (at = 0; at < 2; at++) if (cases[i % 4].texels[at] == k) expected += cases[i % 4].weights[at];
            CHECK(fabs(sums[k] - (side ? -expected : expected)) < 1e-6, "case %d, side %d, texel %d: %g, expected %g",
                  i % 4, side, k, sums[k], side ? -expected : expected);
        }
    }
}

/* Makes a refinement of side x side pixels, for parts that need no more than pixels and sensors. */
static void small_refine(sbl__refine *r, sbl__pixel *pixels, sbl__sensor **block, int side) {
    int i;
    memset(r, 0, sizeof *r);
    r->shown2 = 1;
    r->pixels = pixels;
    r->sensors = block;
    r->width = r->height = side;
    for (i = 0; i < SBL__DOUBLINGS; i++) r->variance_ratios[i] = 1;
}

/* Every fourth of 9 x 9 pixels has a sensor. The light is linear, but the last corner of the last tile shows another
   surface. Light is extrapolated to this corner from the adjacent corners and from the sensors beyond these corners; it
   stays linear in the complete tile. The light of an adjacent corner is copied if no sensor is beyond it. */
TEST(light_is_linear_beside_silhouettes) {
    enum { SIDE = 9 };
    static sbl__pixel pixels[SIDE * SIDE];
    static sbl__sensor sensors[SIDE * SIDE];  /* one sensor per pixel */
    sbl__sensor *block = sensors;
    sbl__refine r;
    sbl__tile tile;
    sbl__mix mix;
    int i, k, missing;
    small_refine(&r, pixels, &block, SIDE);
    r.geometry_aware = 1;
    memset(&tile, 0, sizeof tile);
    for (k = 0; k < 2; k++) {
        tile.area.x[k] = 4 + 4 * k;
        tile.area.y[k] = 4 + 4 * k;
    }
    for (missing = 0; missing < 3; missing++) {  /* sensors beyond exist on both axes; vertically; horizontally */
        memset(pixels, 0, sizeof pixels);
        for (i = 0; i < SIDE * SIDE; i++) {
            sbl__pixel *p = &pixels[i];
            sbl__sensor *s = &sensors[i];
            const int x = i % SIDE, y = i / SIDE;
            p->id = x == 8 && y == 8 ? 2 : 1;
            p->normal[2] = 1;
            p->position[0] = (float)x;
            p->position[1] = (float)y;
            p->sensor = (uint32_t)i;
            s->sensed = x % 4 == 0 && y % 4 == 0 && !(missing == 1 && x == 0) && !(missing == 2 && y == 0);
            s->looks = 1;
            for (k = 0; k < 3; k++) s->radiance[k] = (float)(5 + x + (k + 1) * y);
        }
        for (i = 0; i < 24; i++) {
            const int x = 4 + i % 5, y = 4 + i / 5;
            sbl__mix m;
            sbl__interpolate(&r, &tile, x, y, 0, &m);
            for (k = 0; k < 3; k++) {
                const double slope = missing == 0 ? 0 : missing == 1 ? 1 : k + 1;  /* along the other axis */
                const double expected = 5 + x + (k + 1) * y - 0.5 * 4 * slope * (x - 4) * (y - 4) / 16.0;
                CHECK(fabs((double)m.light[k] - expected) < 1e-4, "way %d, pixel %d %d, channel %d: %g, expected %g",
                      missing, x, y, k, (double)m.light[k], expected);
            }
        }
        for (i = 0; i < 3; i++) {  /* the tile has extrapolated light; with a threshold; in the paper's mode */
            const sbl__range row = { { 4, 7 }, { 7, 7 } };
            r.threshold = i == 1 ? 1.0f : 0.0f;
            r.geometry_aware = i != 2;
            tile.pixels = 0;
            tile.uncovered = 0;
            tile.must_split = 0;
            sbl__tile_count(&r, &tile, &row, 7);
            CHECK(tile.pixels == 4 && tile.must_split == (i > 0) &&
                      (i == 2 || fabs((double)tile.uncovered - 1.125) < 1e-5), "way %d, count %d: %d pixels, "
                  "split %d, uncovered %g", missing, i, tile.pixels, tile.must_split, (double)tile.uncovered);
        }
        for (i = 0; i < SIDE * SIDE; i++) sensors[i].variance = 1;
        sbl__interpolate(&r, &tile, 6, 6, 0, &mix);  /* in the paper's mode: the mean of three sensors */
        CHECK(fabs((double)mix.covered - 0.75) < 1e-6 && fabs(mix.variance - 1 / 3.0) < 1e-6,
              "weight %g, variance %g", (double)mix.covered, mix.variance);
        r.geometry_aware = 1;
        r.threshold = 0;
    }
}

/* The light of a tile is f = (1 + k y) x^2 + (2 + x) y^2, with x and y from 0 to 4 and channel k. Between two corners
   it lies below the straight line by half the second difference of the edge * t (1 - t). Second differences change
   linearly from each edge to the opposite edge, so the light of all pixels is exact. */
TEST(light_between_sensors_is_curved) {
    enum { SIDE = 5 };
    static sbl__pixel pixels[SIDE * SIDE];
    static sbl__sensor sensors[SIDE * SIDE];
    static float rgba[SIDE * SIDE][4];
    sbl__sensor *block = sensors;
    sbl__spec spec;
    sbl__refine r;
    sbl__tile tile;
    sbl__fill fill;
    float parabolas[4][3];
    int i, k;
    small_refine(&r, pixels, &block, SIDE);
    memset(&spec, 0, sizeof spec);
    memset(&tile, 0, sizeof tile);
    memset(&fill, 0, sizeof fill);
    r.spec = &spec;
    r.geometry_aware = 1;
    r.luminance = 2;
    tile.area.x[1] = tile.area.y[1] = 4;
    tile.bias2 = 0.03f;
    tile.noise2 = 0.01f;
    fill.refine = &r;
    fill.rgba = rgba[0];
    for (i = 0; i < SIDE * SIDE; i++) {
        const float x = (float)(i % SIDE), y = (float)(i / SIDE);
        pixels[i].id = 1;
        pixels[i].normal[2] = 1;
        pixels[i].position[0] = x;
        pixels[i].position[1] = y;
        pixels[i].sensor = (uint32_t)i;
        sensors[i].sensed = i % SIDE % 4 == 0 && i / SIDE % 4 == 0;
        sensors[i].looks = 1;
        sensors[i].variance = 9;
        for (k = 0; k < 3; k++) sensors[i].radiance[k] = (1 + (float)k * y) * x * x + (2 + x) * y * y;
    }
    for (k = 0; k < 3; k++) {  /* second differences * 4^2: above, below, left, right */
        parabolas[0][k] = 32;
        parabolas[1][k] = 32 * (1 + 4 * (float)k);
        parabolas[2][k] = 32 * 2;
        parabolas[3][k] = 32 * 6;
    }
    for (i = 0; i < SIDE * SIDE; i++) {
        const double x = i % SIDE / 4.0, y = i / SIDE / 4.0;
        const double across = x * x + (1 - x) * (1 - x), down = y * y + (1 - y) * (1 - y);
        sbl__fill_pixel(&fill, i % SIDE, i / SIDE, &tile, parabolas);
        for (k = 0; k < 3; k++)
            CHECK(fabs((double)rgba[i][k] - (double)sensors[i].radiance[k]) < 1e-3, "pixel %d, channel %d: %g, "
                  "expected %g", i, k, (double)rgba[i][k], (double)sensors[i].radiance[k]);
        CHECK(fabs((double)rgba[i][3] - 3 * sqrt(across * down)) < 1e-4, "pixel %d: noise %g", i, (double)rgba[i][3]);
        CHECK(fabs((double)pixels[i].error - (sensors[i].sensed ? 0.2 : 0.4)) < 1e-5, "pixel %d: error %g", i,
              (double)pixels[i].error);
    }
    tile.variance = 4;   /* a sensor is not less noisy than the tile's sensors on average */
    tile.weight2 = 4;    /* errors of FINAL, divided by an albedo of 2, are those of R */
    r.albedos = parabolas[0];
    pixels[24].id = 2;   /* a corner on another surface: a quarter of the light at the middle is not curved */
    for (i = 0; i < 12; i++) parabolas[i / 3][i % 3] = 1;
    for (i = 0; i < SIDE * SIDE; i++) for (k = 0; k < 3; k++) sensors[i].radiance[k] = 1;
    for (i = 0; i <= 12; i += 12) {
        sbl__fill_pixel(&fill, i % SIDE, i / SIDE, &tile, parabolas);
        CHECK(fabs((double)pixels[i].error - (i ? 0.2 : 0.1)) < 1e-5, "pixel %d: error %g", i,
              (double)pixels[i].error);
        CHECK(fabs((double)rgba[i][1] - (i ? 1 - 0.25 * 0.75 * 0.75 : 1)) < 1e-5, "pixel %d: light %g", i,
              (double)rgba[i][1]);
    }
    CHECK(fabs((double)rgba[0][3] - 4) < 1e-5, "the noise of a sensor is %g", (double)rgba[0][3]);
}

/* A tile has been split, but the new sensors have not been read. All pixels get the light that the tile interpolates
   between its own corners, as before the split. */
TEST(split_tiles_keep_their_light) {
    enum { SIDE = 5 };
    static sbl__pixel pixels[SIDE * SIDE];
    static sbl__sensor sensors[SIDE * SIDE];
    static float rgba[SIDE * SIDE][4];
    static sbl__core core;
    sbl__slice slice = { DBL_MAX, 1, 0 };
    sbl__sensor *block = sensors;
    sbl__spec spec;
    sbl__refine r;
    sbl__tile tiles[5];
    sbl__fill fill;
    int i, k;
    small_refine(&r, pixels, &block, SIDE);
    memset(&spec, 0, sizeof spec);
    memset(tiles, 0, sizeof tiles);
    memset(&fill, 0, sizeof fill);
    r.spec = &spec;
    r.core = &core;
    core.base = base;
    r.geometry_aware = 1;
    r.luminance = 2;
    r.tiles = tiles;
    r.tile_count = 5;
    for (i = 0; i < 5; i++)
        for (k = 0; k < 2; k++) {
            tiles[i].area.x[k] = i ? 2 * ((i - 1) % 2 + k) : 4 * k;
            tiles[i].area.y[k] = i ? 2 * ((i - 1) / 2 + k) : 4 * k;
            tiles[i].parent = i ? 0 : -1;
        }
    tiles[0].split = 1;
    fill.refine = &r;
    fill.rgba = rgba[0];
    for (i = 0; i < SIDE * SIDE; i++) {
        const int x = i % SIDE, y = i / SIDE;
        pixels[i].id = 1;
        pixels[i].normal[2] = 1;
        pixels[i].position[0] = (float)x;
        pixels[i].position[1] = (float)y;
        pixels[i].sensor = (uint32_t)i;
        sensors[i].sensed = x % 4 == 0 && y % 4 == 0;
        sensors[i].looks = 1;
        for (k = 0; k < 3; k++) sensors[i].radiance[k] = sensors[i].sensed ? (float)(1 + x + k * y) : 0.0f;
    }
    CHECK(sbl__fill_step(&fill, &slice) == SBL_SUCCESS && !fill.orphans, "%d orphans", fill.orphans);
    for (i = 0; i < 3 * SIDE * SIDE; i++) {
        const double expected = 1 + i / 3 % SIDE + i % 3 * (i / 3 / SIDE);
        CHECK(fabs((double)rgba[i / 3][i % 3] - expected) < 1e-5, "pixel %d, channel %d: %g, expected %g", i / 3, i % 3,
              (double)rgba[i / 3][i % 3], expected);
    }
    sbl__rings_free(&core.base, &fill.rings);
}

/* Interpolation between the four corners of a wide tile keeps 4/9 of their variance, the mean square of bilinear
   weights; a filter over n pixels keeps 1/n where each pixel has a sensor. */
TEST(noise_that_is_left) {
    static const double expected[3][3] = { { 1, 4 / 9.0, 4 / 9.0 }, { 1 / 9.0, 4 / 17.0, 4 / 9.0 },
                                           { 1 / 81.0, 4 / 89.0, 4 / 9.0 } };
    static const int spans[3] = { 1, 2, 16384 };
    sbl__refine r;
    int i, k;
    memset(&r, 0, sizeof r);
    for (i = 0, r.smoothing = 1; i < 3; i++, r.smoothing *= 9)
        for (k = 0; k < 3; k++)
            CHECK(fabs((double)sbl__noise_left(&r, spans[k]) - expected[i][k]) < 1e-6, "%g pixels, span %d: %g",
                  (double)r.smoothing, spans[k], (double)sbl__noise_left(&r, spans[k]));
    CHECK(fabs(sbl__weigh_pixels(&r) - 1) < 1e-9, "errors without pixels are divided by %g", sbl__weigh_pixels(&r));
    r.pixels_summed = 3;
    r.matte_pixels = 4;
    CHECK(fabs(sbl__weigh_pixels(&r) - 7) < 1e-9, "errors of 7 pixels are divided by %g", sbl__weigh_pixels(&r));
}

/* Rays may find light if the sky has any colour, if surfaces glow, if a sky has a picture, or in GI. Otherwise a job
   traces only the rays that measure distances. Sensors that trace rays stand off by the reach of their triangle; those
   that draw views, whose depth is imprecise, by the extent of the scene. */
TEST(any_colour_of_the_sky_is_light) {
    static sbl__scene scene;
    static sbl__measurement m;
    sbl_context_desc desc;
    sbl__spec spec;
    float picture[4] = { 0, 0, 0, 0 };
    int i;
    memset(&desc, 0, sizeof desc);
    m.options.backend = SBL_BACKEND_TRACE;
    m.options.rays = 1000;
    for (i = 0; i < 8; i++) {  /* nothing, 3 colours, glowing surfaces, a picture, GI, all rays */
        memset(scene.environment.sky, 0, sizeof scene.environment.sky);
        if (i >= 1 && i <= 3) scene.environment.sky[i - 1] = 1e-6f;
        m.options.epsilon = i == 4 ? 1e-6f : 0;
        scene.environment.pixels = i == 5 ? picture : NULL;
        m.options.mode = i == 6 ? SBL_MODE_GI : SBL_MODE_DIRECT;
        m.every_ray = i == 7;
        sbl__spec_make(&spec, &m, &scene, &desc);
        CHECK(spec.no_light == (i == 0) && spec.rays == (i ? 1000 : SBL__POOL_RAYS), "scene %d: no_light is %d, %d "
              "rays", i, spec.no_light, spec.rays);
    }
    scene.geometry.extent = 100;
    for (i = 0; i < 3; i++) {
        const double offset = (double)SBL__OFFSET * (i == 1 ? 7 : 100);
        spec.traced = i > 0;
        CHECK(fabs((double)sbl__spec_offset(&spec, &scene, i == 2 ? 0.0f : 7.0f) / offset - 1) < 1e-6, "sensor %d "
              "stands off by %g", i, (double)sbl__spec_offset(&spec, &scene, i == 2 ? 0.0f : 7.0f));
    }
}

/* The first tiles cover the picture. Their corners lie on a grid, and on the last column and row. */
TEST(first_tiles_end_with_the_picture) {
    static const int sizes[4][4] = { { 9, 6, 2, 2 }, { 10, 5, 3, 1 }, { 1, 9, 1, 2 }, { 4, 4, 1, 1 } };
    static sbl__core core;
    sbl__slice slice = slice_of(0);
    int i;
    core.base.allocator = base.allocator;
    for (i = 0; i < 4; i++) {
        const int wide = sizes[i][2], high = sizes[i][3];
        sbl__refine r;
        const sbl__range *last;
        memset(&r, 0, sizeof r);
        r.core = &core;
        r.width = sizes[i][0];
        r.height = sizes[i][1];
        r.tile_size = 4;
        CHECK(sbl__tiles_first_level(&r, &slice) == SBL_SUCCESS && r.tile_count == wide * high, "%d x %d: %d tiles",
              r.width, r.height, r.tile_count);
        last = &r.tiles[r.tile_count - 1].area;
        CHECK(last->x[0] == 4 * (wide - 1) && last->x[1] == r.width - 1 && last->y[0] == 4 * (high - 1) &&
                  last->y[1] == r.height - 1, "%d x %d: the last tile is %d to %d, %d to %d", r.width, r.height,
              last->x[0], last->x[1], last->y[0], last->y[1]);
        sbl__free(&core.base, r.tiles);
    }
}

/* A pixel takes the nearest of the four guides around it, as measured on both axes. */
TEST(the_nearest_guide_is_taken) {
    enum { SIDE = 9 };
    static const int expected[4][3] = { { 2, 3, 1 }, { 5, 2, 2 }, { 2, 5, 3 }, { 6, 5, 4 } };  /* x, y, guide */
    static sbl__pixel pixels[SIDE * SIDE];
    sbl__spec spec;
    sbl__refine r;
    int i;
    memset(&spec, 0, sizeof spec);
    memset(&r, 0, sizeof r);
    spec.guided = 1;
    r.spec = &spec;
    r.pixels = pixels;
    r.width = r.height = SIDE;
    r.guides.step = SIDE - 1;
    r.guides.columns = r.guides.rows = 2;
    for (i = 0; i < SIDE * SIDE; i++) {
        pixels[i].id = 1;
        pixels[i].normal[2] = 1;
        pixels[i].position[0] = (float)(i % SIDE);
        pixels[i].position[1] = (float)(i / SIDE);
    }
    for (i = 0; i < 4; i++)
        CHECK(sbl__guide_for(&r, expected[i][1] * SIDE + expected[i][0]) == expected[i][2], "pixel %d %d has guide %d",
              expected[i][0], expected[i][1], sbl__guide_for(&r, expected[i][1] * SIDE + expected[i][0]));
}

/* The edge of a spot is soft, even if its inner cone equals its cone. */
TEST(edges_of_spots_are_soft) {
    static const float centre[3] = { 0, 0, 0 };
    const double outer = 1 - cos(0.5), inner = 1 - cos(0.25);
    sbl__light_record record;
    double position[3];
    sbl_light light;
    memset(&light, 0, sizeof light);
    light.kind = SBL_LIGHT_SPOT;
    light.direction[1] = -1;
    light.cone = (float)(180 / TEST_PI);
    light.inner_cone = light.cone / 2;
    sbl__light_write(&light, centre, &record, position);
    CHECK(fabs((double)record.spot_scale * (outer - inner) - 1) < 1e-5, "the scale is %g", (double)record.spot_scale);
    light.inner_cone = light.cone;
    sbl__light_write(&light, centre, &record, position);
    CHECK(fabs((double)record.spot_scale * 0.001 * outer - 1) < 1e-5 &&
              fabs((double)record.spot_offset - 1000) < 0.01, "the scale is %g", (double)record.spot_scale);
}

/* With a threshold, a tile is split if the light of a sensor on its edge differs from the interpolated light. A sensor
   of a surface that no corner shows does not count. */
TEST(sensors_of_other_surfaces_split_no_tile) {
    enum { SIDE = 5 };
    static sbl__pixel pixels[SIDE * SIDE];
    static sbl__sensor sensors[SIDE * SIDE];
    sbl__sensor *block = sensors;
    sbl__refine r;
    sbl__tile tile;
    int i;
    small_refine(&r, pixels, &block, SIDE);
    r.threshold = 1;
    memset(&tile, 0, sizeof tile);
    tile.area.x[1] = tile.area.y[1] = SIDE - 1;
    for (i = 0; i < SIDE * SIDE; i++) {
        pixels[i].id = 1;
        pixels[i].sensor = (uint32_t)i;
        sensors[i].sensed = i % SIDE % 4 == 0 && i / SIDE % 4 == 0;
        sensors[i].looks = 1;
    }
    CHECK(!sbl__tile_differs(&r, &tile), "equal corners differ");
    sensors[2].sensed = 1;
    sensors[2].radiance[1] = 9;
    CHECK(sbl__tile_differs(&r, &tile), "a sensor on the edge does not differ");
    pixels[2].id = 2;
    CHECK(!sbl__tile_differs(&r, &tile), "a sensor of another surface differs");
}

/* A sensor on the edge of a tile differs from the light between the corners by 2 in one channel. Its noise explains a
   part of the squared difference, or all of it. */
TEST(noise_of_sensors_is_no_bias) {
    enum { SIDE = 5 };
    static const double variances[3] = { 0, 1, 4 }, expected[3] = { 4, 2.5, 0 };
    static sbl__pixel pixels[SIDE * SIDE];
    static sbl__sensor sensors[SIDE * SIDE];
    sbl__sensor *block = sensors;
    sbl__refine r;
    sbl__tile tile;
    int i, k;
    small_refine(&r, pixels, &block, SIDE);
    r.luminance = 1;
    memset(&tile, 0, sizeof tile);
    tile.area.x[1] = tile.area.y[1] = SIDE - 1;
    for (k = 0; k < 3; k++) r.weights[k] = 1;
    for (i = 0; i < SIDE * SIDE; i++) {
        pixels[i].id = 1;
        pixels[i].sensor = (uint32_t)i;
        sensors[i].sensed = i == 2 || (i % SIDE % 4 == 0 && i / SIDE % 4 == 0);
        sensors[i].looks = 1;
        for (k = 0; k < 3; k++) sensors[i].radiance[k] = i == 2 && k == 1 ? 3 : 1;
    }
    for (i = 0; i < 3; i++) {
        sensors[2].variance = variances[i];
        CHECK(fabs((double)sbl__tile_sensor_bias2(&r, &tile) - expected[i]) < 1e-5,
              "variance %g: the squared bias is %g", variances[i], (double)sbl__tile_sensor_bias2(&r, &tile));
    }
}

/* The cost of a node contains the costs of its descendants; the hierarchy has the highest cost per area. */
TEST(costs_of_nodes_add_up) {
    static const double expected[3] = { 3, 3, 4 };
    static sbl__bvh_building b;
    static sbl__hierarchy h;
    sbl__bvh_node_cost costs[4] = { { 0, 0, 0 }, { 5, 4, 0 }, { 5, 4, 1 }, { 6, 2, 1 } };  /* 0: the grid */
    int i;
    b.hierarchy = &h;
    b.costs = costs;
    h.node_count = 4;
    for (i = 0; i < sbl__bvh_inner_nodes(&b); i++) {
        sbl__bvh_cost(&b, i);
        CHECK(fabs(h.cost - expected[i]) < 1e-9, "%d nodes: %g, expected %g", i + 1, h.cost, expected[i]);
    }
}

/* The filter averages over a square of pixels; its weights are those of a Gaussian with half its radius. */
TEST(filters_average_a_square) {
    int radius, x, y;
    for (radius = 0; radius < 5; radius++) {
        double sum = 0, squares = 0;
        for (y = -radius; y <= radius; y++)
            for (x = -radius; x <= radius; x++) {
                const double weight = exp(-(x * x + y * y) / (2 * 0.25 * fmax(radius * radius, 0.04)));
                sum += weight;
                squares += weight * weight;
            }
        CHECK(fabs((double)sbl__filter_pixels(radius) / (sum * sum / squares) - 1) < 1e-5,
              "radius %d: %g, expected %g", radius, (double)sbl__filter_pixels(radius), sum * sum / squares);
    }
}

/* Two points share light less if one of the two lies off the other's plane, or if their normals differ. Here the
   first point's plane contains the second point, 1 away, but not the reverse: the distance is the sine. */
TEST(points_share_light_both_ways) {
    static const double sines[4] = { 0, 0.15, 0.2, 0.3 };
    sbl__pixel a, b;
    int i;
    memset(&a, 0, sizeof a);
    memset(&b, 0, sizeof b);
    a.id = b.id = 1;
    a.normal[1] = 1;
    b.position[0] = 1;
    for (i = 0; i < 4; i++) {
        const double cosine = sqrt(1 - sines[i] * sines[i]), plane = 2 - (double)SBL__BELONGS_PLANE * sines[i];
        const double parallel = fmin((cosine - (double)SBL__BELONGS_COSINE) / (double)SBL__BELONGS_RANGE, 1);
        const double expected = parallel * parallel * fmax(0, fmin(plane, 1));
        b.normal[0] = (float)sines[i];
        b.normal[1] = (float)cosine;
        CHECK(fabs((double)sbl__belongs(&a, &b, 1) - expected) < 1e-5 &&
                  fabs((double)sbl__belongs(&b, &a, 1) - expected) < 1e-5, "sine %g: %g and %g, expected %g", sines[i],
              (double)sbl__belongs(&a, &b, 1), (double)sbl__belongs(&b, &a, 1), expected);
    }
}

/* If earlier and new looks of a sensor are as noisy as expected, their differences have this mean square. */
TEST(differences_of_looks_have_the_noise_of_both) {
    static sbl__refine r;
    sbl__sensor s;
    memset(&s, 0, sizeof s);
    s.variance = 2;
    sbl__looks_compare(&r, &s, 2, 8, 3);
    CHECK(r.compared[1] == 1 && r.measured2[1] > 2.999 && r.measured2[1] < 3.001 &&
              fabs(r.expected2[1] - 1.1 * 2 * (0.4 + 0.4 * 0.4 * 0.4)) < 1e-6, "%d: %g, expected %g", r.compared[1],
          r.measured2[1], r.expected2[1]);
}

/* Light that is constant up to the last sensor of a surface may still change before the border of the surface: little,
   more where another surface is close, and most across narrow charts of lightmaps. */
TEST(light_may_change_beside_borders) {
    enum { SIDE = 5 };
    static const struct { int id, next, atlas; float away, error; } cases[6] = {
        { 2, 1, 0, 6, SBL__SILHOUETTE_ERROR }, { 2, 1, 0, 4, SBL__CONTACT_ERROR },
        { 0, 1, 0, 4, SBL__SILHOUETTE_ERROR }, { 2, 0, 0, 6, SBL__CONTACT_ERROR },
        { 2, 1, 1, 4, SBL__CONTACT_ERROR }, { 0, 0, 1, 6, SBL__NARROW_ERROR } };
    static const sbl__atlas atlas;
    static sbl__pixel pixels[SIDE * SIDE];
    static sbl__sensor sensors[SIDE * SIDE];
    sbl__sensor *block = sensors;
    sbl__refine r;
    sbl__edge e;
    int i, k;
    small_refine(&r, pixels, &block, SIDE);
    r.geometry_aware = 1;
    for (k = 0; k < 3; k++) r.weights[k] = 1;
    for (k = 0; k < 2; k++) {
        e.line.x[k] = 2 + 2 * k;
        e.line.y[k] = 0;
        e.ends[k] = &pixels[2 + 2 * k];
    }
    for (i = 0; i < 5; i += 2) {
        pixels[i].id = 1;
        pixels[i].normal[1] = 1;
        pixels[i].sensor = (uint32_t)i + 1;
        pixels[i].position[0] = (float)i;
        for (k = 0; k < 3; k++) sensors[i + 1].radiance[k] = 0.5f;
    }
    sensors[3].sensed = 1;
    for (i = 0; i < 6; i++) {
        const double expected = 3 * pow(0.5 * (double)cases[i].error, 2);
        float unseen2 = 0, bias2;
        pixels[4].id = (uint32_t)cases[i].id;
        pixels[4].position[0] = 2 + cases[i].away;
        sensors[1].sensed = (unsigned char)cases[i].next;
        r.atlas = cases[i].atlas ? &atlas : NULL;
        bias2 = sbl__extrapolation_bias2(&r, &e, 0, &unseen2);
        CHECK(fabs((double)bias2 - expected) < 1e-6 && fabs((double)unseen2 - expected) < 1e-6,
              "case %d: %g and %g, expected %g", i, (double)bias2, (double)unseen2, expected);
    }
}

/* Each division of a cell halves the fraction of the cell that the leaves on both of its sides cover; a cut along an
   object does not. A leaf without points has the fraction 1. */
TEST(divisions_halve_fractions) {
    static const float places[4][2] = { { 0.2f, 0.2f }, { 0.7f, 0.2f }, { 0.7f, 0.6f }, { 0.7f, 0.9f } };
    static const float distances[3] = { 0.5f, 0.5f, 0.8f }, expected[4] = { 0.5f, 0.25f, 0.25f, 0.25f };
    static sbl__bounce b;
    static sbl__cell_bucket cells[128];
    uint32_t patches[1] = { 0 };
    sbl__bounce_leaf states[4];
    sbl__bounce_point points[4];
    sbl__cut cuts[3];
    sbl__store store;
    int i;
    memset(states, 0, sizeof states);
    memset(points, 0, sizeof points);
    memset(cuts, 0, sizeof cuts);
    memset(&store, 0, sizeof store);
    store.patches = patches;
    store.cells = cells;
    store.cell_capacity = 128;
    store.cuts = cuts;
    store.length = 1;
    b.store = &store;
    b.states = states;
    b.points = points;
    for (i = 0; i < 3; i++) {  /* x = 0.5, then y = 0.5, and y = 0.8, where an object stands */
        cuts[i].normal[i ? 1 : 0] = 1;
        cuts[i].distance = distances[i];
        cuts[i].divides = i < 2;
        cuts[i].sides[0] = (uint32_t)i + 1;
        cuts[i].sides[1] = i < 2 ? SBL__CELL_CUT | (uint32_t)(i + 1) : 4;
    }
    for (i = 0; i < 4; i++) {
        points[i].at.distance = 9;
        memcpy(points[i].at.position, places[i], sizeof places[i]);
        states[i].first = i;
        states[i].points = 1;
    }
    *sbl__store_bucket(&store, 0, points[0].at.position) = SBL__CELL_CUT;
    for (i = 0; i < 4; i++)
        CHECK(*sbl__hit_find(&b, &points[i].at, NULL) == (uint32_t)i + 1 &&
                  fabs((double)sbl__solution_fraction(&b, i) - (double)expected[i]) < 1e-6,
              "leaf %d has the fraction %g", i, (double)sbl__solution_fraction(&b, i));
    states[1].points = 0;
    CHECK(fabs((double)sbl__solution_fraction(&b, 1) - 1) < 1e-6, "a leaf without points has the fraction %g",
          (double)sbl__solution_fraction(&b, 1));
}

/* If a cut has split a leaf, its hits are looked up again; each belongs to the leaf on its side. Hits in other leaves
   keep their leaf, if it is current. */
TEST(hits_follow_cuts) {
    static const float places[3] = { 0.2f, 0.7f, 5.5f };
    static const uint32_t expected[3] = { 0, 1, 2 };
    static sbl__bounce b;
    static sbl__cell_bucket cells[128];
    static sbl__hit hits[SBL__BOUNCE_RAYS];
    uint32_t patches[1] = { 0 };
    sbl__bounce_leaf states[3];
    sbl__cut cut;
    sbl__store store;
    int i;
    memset(states, 0, sizeof states);
    memset(&cut, 0, sizeof cut);
    memset(&store, 0, sizeof store);
    store.patches = patches;
    store.cells = cells;
    store.cell_capacity = 128;
    store.cuts = &cut;
    store.length = 1;
    b.store = &store;
    b.states = states;
    b.hits.list = hits;
    cut.normal[0] = 1;
    cut.distance = 0.5f;
    cut.sides[0] = 1;
    cut.sides[1] = 2;
    states[0].cut = 1;
    for (i = 0; i < SBL__BOUNCE_RAYS; i++) {
        hits[i].side = i < 3 ? 0 : SBL__NOWHERE;
        if (i >= 3) continue;
        hits[i].position[0] = places[i];
        hits[i].distance = 9;
        hits[i].leaf = i < 2 ? 0 : 2;  /* before the cut, the first two hits were in one leaf */
        hits[i].current = 1;
    }
    *sbl__store_bucket(&store, 0, hits[0].position) = SBL__CELL_CUT;
    CHECK(sbl__solution_link(&b, 0) == SBL_SUCCESS, "no hits");
    for (i = 0; i < SBL__BOUNCE_RAYS; i++)
        CHECK(hits[i].leaf == (i < 3 ? expected[i] : SBL__NOWHERE) && hits[i].current == (i < 3), "hit %d: leaf %u", i,
              hits[i].leaf);
}

/* Gives a bounce object a store of two leaves. The second leaf has a light of 8. */
static void set_leaves(sbl__bounce *b, sbl__store *store, sbl__leaf leaves[2], sbl__bounce_leaf states[2]) {
    int k;
    memset(leaves, 0, 2 * sizeof *leaves);
    memset(store, 0, sizeof *store);
    for (k = 0; k < 3; k++) leaves[1].light[k] = 8;
    store->leaves = leaves;
    store->leaf_count = 2;
    b->store = store;
    b->states = states;
}

/* The uncertainty of a leaf without points is SBL__UNCERTAINTY_STRATA times the noise that other leaves send, relative
   to its light, up to a limit. They send it on SBL__UNCERTAINTY_ITERATIONS times. */
TEST(uncertainty_has_a_limit) {
    static const double noises[3] = { 0.03, 0.06, 5 }, most = SBL__UNCERTAINTY_MOST;
    static sbl__bounce b;
    float solved[6] = { 2, 2, 2, 0, 0, 0 }, own[6] = { 0.5f, 0.5f, 0.5f, 0, 0, 0 };
    sbl__bounce_leaf states[2];
    sbl__leaf leaves[2];
    sbl__store store;
    int i, k, rounds = 1;
    memset(states, 0, sizeof states);
    set_leaves(&b, &store, leaves, states);
    b.solved = solved;
    b.direct = own;
    for (i = 0; i < 3; i++) {
        const double expected = SBL__UNCERTAINTY_STRATA * SBL__MIN(noises[i], most);
        for (k = 0; k < 3; k++) leaves[0].light[k] = (float)(0.5 + 2 * noises[i]);
        sbl__uncertainty_leaf(&b, 0);
        CHECK(fabs((double)sbl__leaf_uncertainty(leaves[0].light) / expected - 1) < 0.05 &&
                  fabs((double)leaves[0].light[0] - 2) < 1e-6, "noise %g: R %g, uncertainty %g, expected %g", noises[i],
              (double)leaves[0].light[0], (double)sbl__leaf_uncertainty(leaves[0].light), expected);
    }
    while (rounds < 100 && sbl__uncertainty_after_propagate(&b) == SBL__BOUNCE_PROPAGATE) rounds++;
    CHECK(rounds == SBL__UNCERTAINTY_ITERATIONS, "noise is sent on %d times", rounds);
}

/* Stored light does not fit a scene in which the host draws in other bounds, or that is far from where it was. The
   lights, relative to the surfaces, stay the same. */
TEST(bounds_of_draws_are_hashed) {
    static sbl__scene scene;
    uint64_t hashes[4][SBL__SAVED_HASHES];
    int i, k;
    for (i = 0; i < 4; i++) {
        scene.draw = i ? draws_nothing : NULL;
        scene.draw_bounds[1][2] = (float)(i < 3 ? i : 2);
        scene.geometry.centre[1] = i < 3 ? 0 : 1e6f;
        sbl__saved_scene(&scene, hashes[i]);
    }
    for (i = 0; i < SBL__SAVED_HASHES; i++)
        for (k = 0; k < 3; k++)
            CHECK((hashes[k][i] == hashes[k + 1][i]) == (i != SBL__SAVED_MESHES), "scenes %d and %d: hash %d", k, k + 1,
                  i);
}

/* Only the second of three points has a ray that sees a back face, its last. A missed ray of the third point has an odd
   side, which means nothing. In the job that measures glows, no point is tested again. */
TEST(points_that_see_back_faces_are_suspect) {
    static sbl__bounce b;
    static sbl__hit hits[3 * SBL__BOUNCE_RAYS];
    static sbl__site sites[3];
    sbl__vertex vertices[3];
    sbl__geometry g;
    sbl__bounce_point points[3];
    uint32_t indices[3] = { 0, 1, 2 };
    int i;
    memset(vertices, 0, sizeof vertices);
    memset(&g, 0, sizeof g);
    memset(points, 0, sizeof points);
    g.vertices = vertices;
    g.indices = indices;
    vertices[1].position[0] = vertices[2].position[1] = 1;
    b.geometry = &g;
    b.points = points;
    b.hits.list = hits;
    b.sites = sites;
    hits[2 * SBL__BOUNCE_RAYS - 1].side = hits[2 * SBL__BOUNCE_RAYS].side = 7;
    hits[2 * SBL__BOUNCE_RAYS].distance = 2 * SBL__FAR;
    for (i = 0; i < 3; i++) sbl__solution_site(&b, i);
    REQUIRE(b.site_count == 3, "%d sites", b.site_count);
    for (i = 0; i < 3; i++) CHECK(sites[i].suspect == (i == 1), "point %d: suspect is %d", i, sites[i].suspect);
    b.glows = SBL__GLOWS_EVERYWHERE;
    b.site_count = 0;
    sbl__solution_site(&b, 1);
    CHECK(!sites[0].suspect, "a point is tested twice");
}

/* A leaf has three points; the second is stuck. A quarter of the rays of the first point and half of the rays of the
   last point hit another leaf, which reflects half of 8. Therefore these points receive 1 and 2. The leaf receives the
   mean of the valid points. Its noise is the standard error of this mean. With one valid point the noise is half of the
   light. */
TEST(stuck_points_do_not_count) {
    static sbl__bounce b;
    static sbl__hit hits[3 * SBL__BOUNCE_RAYS];
    static sbl__bounce_read reads[3 * SBL__BOUNCE_RAYS];
    static const float half[3] = { 0.5f, 0.5f, 0.5f };
    sbl__bounce_leaf states[2] = { { 3, 4, 0, 2, 0, 1, 0, 0 }, { 0, 4, 0, 0, 0, 1, 0, 0 } };
    sbl__bounce_point points[3];
    sbl__leaf leaves[2];
    sbl__store store;
    float direct[3], solved[3];
    int i, k;
    memset(points, 0, sizeof points);
    set_leaves(&b, &store, leaves, states);
    b.points = points;
    b.hits.list = hits;
    b.reads = reads;
    b.direct = direct;
    b.solved = solved;
    for (i = 0; i < 3 * SBL__BOUNCE_RAYS; i++) {
        const int most = SBL__BOUNCE_RAYS * (i / SBL__BOUNCE_RAYS == 0 ? 1 : 2) / 4;
        hits[i].leaf = i % SBL__BOUNCE_RAYS < most ? 1 : SBL__NOWHERE;
        sbl__albedo_pack(half, hits[i].albedo);
    }
    points[0].valid = points[2].valid = 1;
    for (k = 0; k < 3; k++) {
        points[0].light[k] = 1;
        points[1].light[k] = 50;
        points[2].light[k] = 2;
        direct[k] = 1.5f;
    }
    sbl__solution_reads(&b, 0);
    CHECK(states[0].read_end == 3 * SBL__BOUNCE_RAYS / 4, "%d reads", states[0].read_end);
    sbl__solution_gather(&b, 0);
    for (k = 0; k < 3; k++)
        CHECK(fabs((double)leaves[0].light[k] - 3) < 1e-3, "channel %d: %g, expected 3", k, (double)leaves[0].light[k]);
    sbl__uncertainty_noise(&b, 0);
    for (k = 0; k < 3; k++)
        CHECK(fabs(fabs((double)direct[k]) - 1) < 1e-3, "channel %d: a noise of %g, expected 1", k, (double)direct[k]);
    points[2].valid = 0;
    states[0].valid = 1;
    sbl__uncertainty_noise(&b, 0);
    for (k = 0; k < 3; k++)
        CHECK(fabs(fabs((double)direct[k]) - 1) < 1e-3, "channel %d, one point: a noise of %g, expected 1", k,
              (double)direct[k]);
}

/* When all hits are queued again, a hit is skipped if its leaf has all its points and was not cut after the hit was
   found. This test has no scene, so placing a hit again would fail. Distant hits need more points. Once all hits have
   been found again, earlier cuts do not count. */
TEST(settled_hits_are_skipped) {
    static sbl__bounce b;
    static sbl__hit hits[3 * SBL__BOUNCE_RAYS];
    sbl__bounce_leaf states[3] = {
        { 4, 8, 0, 4, 0, 1, 0, 0 }, { 4, 4, 4, 4, 0, 1, 2, 0 }, { 3, 4, 8, 3, 0, 1, 0, 0 }
    };
    sbl__leaf leaves[3];
    sbl__store store;
    int i;
    set_leaves(&b, &store, leaves, states);
    store.leaf_count = b.cut_leaves = b.point_count = 3;
    store.length = 1;
    b.hits.list = hits;
    for (i = 0; i < 3 * SBL__BOUNCE_RAYS; i++) {
        hits[i].leaf = (uint32_t)(i < 3 ? i : 0);
        hits[i].current = 1;  /* otherwise the prefetch of later hits would need the cells of a scene */
    }
    CHECK(sbl__cells_queue_again(&b) == SBL__BOUNCE_ASSIGN && b.queue.count == 3 * SBL__BOUNCE_RAYS,
          "%d hits are queued", b.queue.count);
    CHECK(sbl__cells_assign(&b, 0) == SBL_SUCCESS && b.point_count == 3, "%d points", b.point_count);
    CHECK(sbl__hit_is_settled(&b, &hits[0], 0), "the hit in a full leaf is not settled");
    CHECK(!sbl__hit_is_settled(&b, &hits[1], 2 * SBL__BOUNCE_RAYS - 1), "a hit before a cut is settled");
    CHECK(sbl__hit_is_settled(&b, &hits[1], 2 * SBL__BOUNCE_RAYS), "a hit after a cut is not settled");
    b.cut_leaves = 1;
    CHECK(!sbl__hit_is_settled(&b, &hits[1], 2 * SBL__BOUNCE_RAYS), "a hit in a leaf that may yet be cut is settled");
    b.cut_leaves = 3;
    CHECK(!sbl__hit_is_settled(&b, &hits[2], 0), "the hit in a leaf that lacks points is settled");
    hits[0].distance = (float)SBL__BOUNCE_LONG + 1;
    CHECK(!sbl__hit_is_settled(&b, &hits[0], 0), "a far hit in a leaf that lacks points is settled");
    hits[0].distance = 0;
    hits[0].current = 0;
    CHECK(!sbl__hit_is_settled(&b, &hits[0], 0), "a hit that is not current is settled");
    store.max_leaves = 100;
    CHECK(sbl__cells_after_assign(&b) == SBL__BOUNCE_CAST_POINTS, "no points are cast");
    CHECK(sbl__hit_is_settled(&b, &hits[1], 0), "a cut counts twice");
    states[0].cut = states[2].cut = 5;
    CHECK(sbl__solution_after_link(&b) == SBL__BOUNCE_SITES && !states[0].cut && !states[2].cut,
          "linked hits wait for a cut");
}

/* All rays of the points of a leaf hit another leaf, which reflects half of 8. A leaf with 16 points has the same
   weight as one with four points, both when leaves are divided and when bright leaves are chosen. */
TEST(further_points_do_not_count_more) {
    enum { MOST = 16 };
    static sbl__bounce b;
    static sbl__hit hits[MOST * SBL__BOUNCE_RAYS];
    static sbl__bounce_point points[MOST];
    static const float half[3] = { 0.5f, 0.5f, 0.5f };
    sbl__bounce_leaf states[2] = { { 4, 32, 0, 4, 0, 1, 0, 0 }, { 0, 4, 0, 0, 0, 1, 0, 0 } };
    sbl__division division;
    sbl__leaf_moments moments[2];
    sbl__leaf leaves[2];
    sbl__store store;
    sbl__leaf_found leaf_found[2];
    int i;
    memset(&division, 0, sizeof division);
    division.moments = moments;
    set_leaves(&b, &store, leaves, states);
    b.points = points;
    b.hits.list = hits;
    b.leaf_found = leaf_found;
    b.division = &division;
    for (i = 0; i < MOST; i++) points[i].valid = 1;
    for (i = 0; i < MOST * SBL__BOUNCE_RAYS; i++) {
        hits[i].leaf = 1;
        sbl__albedo_pack(half, hits[i].albedo);
    }
    for (states[0].points = 4; states[0].points <= MOST; states[0].points *= 4) {
        const double rays = 4 * SBL__BOUNCE_RAYS;
        memset(moments, 0, sizeof moments);
        for (i = 0; i < states[0].points; i++) {
            sbl__division_moments(&b, i);
            sbl__bright_sum_found(&b, i);
        }
        CHECK(fabs(moments[1].hits - rays) < 1e-6 && fabs(moments[1].weight - rays / 4) < 1e-3,
              "%d points: %g hits, weight %g", states[0].points, moments[1].hits, moments[1].weight);
        CHECK(fabs(b.found.rays - rays) < 1e-6 && fabs(b.found.light - 4 * rays) < 0.1,
              "%d points: %g rays find %g", states[0].points, b.found.rays, b.found.light);
        CHECK(fabs((double)leaf_found[1].rays - rays) < 1e-3 && fabs((double)leaf_found[1].light - 4 * rays) < 0.1,
              "%d points: %g rays find %g at the leaf", states[0].points, (double)leaf_found[1].rays,
              (double)leaf_found[1].light);
    }
    for (i = 0; i < SBL__BOUNCE_RAYS; i++) hits[i].by_metal = 1;
    sbl__bright_sum_found(&b, 0);  /* light by way of metal is found, but not at the leaf */
    CHECK(b.found.light > 0 && !(leaf_found[1].rays > 0), "%g rays by way of metal", (double)leaf_found[1].rays);
}

/* Some rays find two leaves that are much brighter than all others. Leaf 1 is seen by single rays of many points. Leaf
   2 fills the view of one point, so that rays find it easily. Only leaf 1 becomes bright. For short rays, leaf 3 is in
   the place of leaf 1, and leaf 4 in that of leaf 2. What short rays find does not count, although it is bright. */
TEST(places_that_fill_the_view_stay_ordinary) {
    enum { POINTS = 40, SEEING = 20, LEAVES = 6, DARK = 5 };
    static const float places[LEAVES] = { 1.5f, 11.5f, 12.5f, 11.5f, 12.5f, 31.5f }, half[3] = { 0.5f, 0.5f, 0.5f };
    static const int expected[LEAVES] = { 0, SBL__BRIGHT, 0, SBL__BRIGHT_LONG, 0, 0 };
    static sbl__bounce b;
    static sbl__core core;
    static sbl__hit hits[(POINTS + LEAVES) * SBL__BOUNCE_RAYS];
    static sbl__bounce_point points[POINTS + LEAVES];
    static sbl__cell_bucket cells[128];
    static sbl__leaf_found leaf_found[LEAVES];
    sbl__bounce_leaf states[LEAVES];
    sbl__leaf leaves[LEAVES];
    sbl__store store;
    uint32_t patches[1] = { 0 };
    int i, k;
    core.base = base;
    core.device.base = &core.base;
    memset(states, 0, sizeof states);
    memset(leaves, 0, sizeof leaves);
    memset(&store, 0, sizeof store);
    store.patches = patches;
    store.cells = cells;
    store.cell_capacity = 128;
    store.leaves = leaves;
    store.leaf_count = LEAVES;
    store.length = 1;
    b.core = &core;
    b.store = &store;
    b.states = states;
    b.points = points;
    b.hits.list = hits;
    b.leaf_found = leaf_found;
    b.point_count = POINTS + LEAVES - 1;
    for (i = 0; i < LEAVES; i++) {
        sbl__bounce_point *first = &points[i ? POINTS + i - 1 : 0];
        first->at.position[0] = places[i];
        first->at.distance = i == 3 || i == 4 ? 0.1f : 9;
        first->leaf = i;
        states[i].first = (int)(first - points);
        states[i].points = i ? 1 : POINTS;
        states[i].fraction = 1;
        *sbl__store_bucket(&store, sbl__hit_patch(&store, &first->at), first->at.position) = (uint32_t)i + 1;
        for (k = 0; k < 3; k++) leaves[i].light[k] = i == 1 || i == 2 || i == 4 ? 1000.0f : 0.1f;
    }
    for (i = 0; i < POINTS; i++) points[i].valid = 1;
    for (i = 0; i < POINTS * SBL__BOUNCE_RAYS; i++) {
        const int point = i / SBL__BOUNCE_RAYS, ray = i % SBL__BOUNCE_RAYS;
        hits[i].leaf = (uint32_t)(point == POINTS - 1 ? 2 : ray == 5 ? 4 : point < SEEING && ray == 3 ? 1 : DARK);
        hits[i].distance = point < POINTS - 1 && ray == 5 ? 0.1f : 9;
        sbl__albedo_pack(half, hits[i].albedo);
    }
    for (i = 0; i < POINTS; i++) sbl__bright_sum_found(&b, i);
    REQUIRE(sbl__bright_make_list(&b, NULL) == SBL_SUCCESS && store.bright_count == 1, "%d bright cells",
            store.bright_count);
    CHECK(!store.bright[0].patch && store.bright[0].at[0] == 11, "cell %u is bright", store.bright[0].at[0]);
    for (i = 0; i < LEAVES; i++)
        CHECK(states[i].bright == expected[i] && sbl__leaf_is_bright(leaves[i].light) == (i == 1),
              "leaf %d: %d, R %g", i, states[i].bright, (double)leaves[i].light[0]);
    /* Once the light of bright leaves is corrected, they are marked again, and no glow keeps the light from before. */
    leaves[1].light[0] = 900;
    core.scene.bright.glow_count = 1;
    CHECK(sbl__bright_after_correct(&b) == SBL__BOUNCE_GLOW && !core.scene.bright.glow_count, "%d glows are kept",
          core.scene.bright.glow_count);
    for (i = 0; i < LEAVES; i++) CHECK(sbl__leaf_is_bright(leaves[i].light) == (i == 1), "leaf %d is not marked", i);
    sbl__free(&core.base, store.bright);
}

/* In the mean over a bright leaf, a site counts by the albedo of the surfaces that its rays hit. Black surfaces and the
   sky reflect nothing. Short rays and sites without a valid reading do not count. */
TEST(sites_count_by_what_reflects_their_light) {
    enum { SITES = 4, GROUPS = 2 };
    static const float R[SITES] = { 10, 2, 5, 1000 }, albedos[SITES] = { 0, 0.8f, 0.8f, 0.8f };
    static sbl__bounce b;
    static sbl__store store;
    static sbl__core core;
    sbl_reading readings[SITES];
    sbl__hit hits[SITES * SBL__BRIGHT_RAYS];
    float found_layers[SITES * GROUPS * 3], mean[3], layers[GROUPS * 3];
    int i, k;
    memset(readings, 0, sizeof readings);
    memset(hits, 0, sizeof hits);
    core.scene.light_groups = GROUPS;
    b.core = &core;
    b.readings = readings;
    b.receivers.list = hits;
    b.found_layers = found_layers;
    b.store = &store;
    store.length = 2;
    for (i = 0; i < SITES; i++) {
        const float albedo[3] = { albedos[i], 0.5f * albedos[i], 0.5f };
        readings[i].valid = i != 3;
        for (k = 0; k < 3; k++) {
            readings[i].radiance[k] = R[i];
            found_layers[6 * i + k] = i == 1 ? R[i] : 0;
            found_layers[6 * i + 3 + k] = i == 1 ? 0 : R[i];
        }
        for (k = 0; k < SBL__BRIGHT_RAYS; k++) {
            hits[i * SBL__BRIGHT_RAYS + k].side = i == 1 && k >= SBL__BRIGHT_RAYS / 2 ? SBL__NOWHERE : 0;
            hits[i * SBL__BRIGHT_RAYS + k].distance = i == 2 && k < SBL__BRIGHT_RAYS / 2 ? 0.99f : 1.01f;  /* short */
            sbl__albedo_pack(albedo, hits[i * SBL__BRIGHT_RAYS + k].albedo);
        }
    }
    CHECK(sbl__bright_mean(&b, 0, SITES, mean, layers), "no site is valid");
    printf("  mean %g %g %g\n", (double)mean[0], (double)mean[1], (double)mean[2]);
    for (k = 0; k < 2; k++) CHECK(fabs((double)mean[k] - 3.5) < 1e-3, "mean %d is %g", k, (double)mean[k]);
    CHECK(fabs((double)mean[2] - (4 * 10 + 2 * 2 + 2 * 5) / 8.0) < 1e-3, "mean 2 is %g", (double)mean[2]);
    CHECK(fabs((double)layers[0] - 1) < 1e-3 && fabs((double)layers[3] - 2.5) < 1e-3, "groups %g and %g",
          (double)layers[0], (double)layers[3]);
    for (k = 0; k < 3; k++)
        CHECK(fabs((double)(layers[k] + layers[3 + k]) / (double)mean[k] - 1) < 1e-5, "groups add up to %g",
              (double)(layers[k] + layers[3 + k]));
    CHECK(!sbl__bright_mean(&b, 3, SITES, mean, layers), "an invalid site counts");
}

/* The rays of a site of a bright leaf leave it into all four quadrants, those of 16 consecutive sites into 64 different
   parts of the hemisphere, and those of other sites into other directions. */
TEST(rays_of_sites_cover_the_hemisphere) {
    enum { CELLS = 8, SET = 16 };
    static sbl__bounce b;
    static sbl__site sites[SBL__BRIGHT_SITES];
    int i, k, repeated = 0;
    uint32_t firsts[SBL__BRIGHT_SITES];
    b.sites = sites;
    b.sequence = sbl__sequence_make(&base, SBL__BOUNCE_SEQUENCES, SBL__BOUNCE_RAYS, 1);
    REQUIRE(b.sequence, "no memory");
    for (i = 0; i < SBL__BRIGHT_SITES; i++) {
        sites[i].number = (uint32_t)(7 * SBL__BRIGHT_SITES + i);
        sites[i].position[0] = (float)i;
        sites[i].normal[1] = 1;
        sites[i].offset = 0.5f;
    }
    for (i = 0; i < SBL__BRIGHT_SITES; i += SET) {
        int hit[CELLS * CELLS] = { 0 };
        for (k = 0; k < SET * SBL__BRIGHT_RAYS; k++) {
            const int site = i + k / SBL__BRIGHT_RAYS, quadrant = k % SBL__BRIGHT_RAYS;
            static int quadrants;
            sbl__cast ray;
            int x, y;
            sbl__bright_ray(&b, SBL__BRIGHT_RAYS * i + k, &ray);
            x = (int)((ray.fractions & 0xffffu) * CELLS >> 16);
            y = (int)((ray.fractions >> 16) * CELLS >> 16);
            hit[CELLS * y + x]++;
            quadrants = (quadrant ? quadrants : 0) | 1 << (2 * (2 * y / CELLS) + 2 * x / CELLS);
            if (!quadrant) firsts[site] = ray.fractions;
            CHECK(quadrant < 3 || quadrants == 15, "site %d: quadrants %d", site, quadrants);
            CHECK(fabs((double)ray.origin[0] - site) < 1e-6 && fabs((double)ray.origin[1] - 0.5) < 1e-6 &&
                  ray.direction[1] > 0 && ray.limit < 0, "ray %d of site %d starts elsewhere", quadrant, site);
        }
        for (k = 0; k < CELLS * CELLS; k++) CHECK(hit[k] == 1, "%d rays in cell %d", hit[k], k);
    }
    for (i = 0; i < SBL__BRIGHT_SITES; i++)
        for (k = 0; k < i; k++) repeated += firsts[i] == firsts[k];
    CHECK(!repeated, "%d directions repeat", repeated);
    sbl__free(&base, b.sequence);
}

/* The tests have freed all memory. */
TEST(no_memory_is_left) {
    CHECK(base.memory.host_bytes == 0, "%.0f bytes are not freed", (double)base.memory.host_bytes);
}

/* The light groups of a texel add up to R, and none is negative. R of a texel without light in any group is added to
   the first group. */
TEST(groups_of_a_texel_add_up) {
    static const float R[3] = { 1, 2, 3 };
    float first[3] = { -0.5f, 1, 0 }, second[3] = { 0.8f, -1, -1 }, third[3] = { 0.4f, 3, 0 };
    float *const parts[3] = { first, second, third };
    int k;
    sbl__groups_scale(R, parts, 3, 0);
    for (k = 0; k < 3; k++) {
        CHECK(first[k] >= 0 && second[k] >= 0 && third[k] >= 0, "colour %d: a group is negative", k);
        CHECK(fabs((double)first[k] + (double)second[k] + (double)third[k] - (double)R[k]) < 1e-6, "colour %d", k);
    }
    CHECK(fabs((double)second[0] - 2 * (double)third[0]) < 1e-6 && fabs((double)third[1] - 3 * (double)first[1]) < 1e-6,
          "groups have other shares");
    CHECK(first[2] == R[2], "R without groups belongs to no group");
}

/* The light of a hidden texel is the mean of what the middle quarter of its places find, and its noise is that of this
   mean: of the places, or of the differences between them if these are larger. */
TEST(places_that_differ_are_noisy) {
    static const float found[2][8] = { { 5, 1, 8, 4, 2, 6, 3, 7 }, { 2, 2, 2, 2, 2, 2, 2, 2 } };
    sbl__site sites[9];
    sbl_reading readings[9];
    sbl__refine r;
    int round, i, k;
    for (round = 0; round < 2; round++) {
        double noise;
        memset(&r, 0, sizeof r);
        r.shown2 = 1;
        memset(sites, 0, sizeof sites);
        memset(readings, 0, sizeof readings);
        r.sites = sites;
        r.readings = readings;
        r.site_count = 9;
        for (i = 0; i < 8; i++) {
            sites[i].pixel = 3;
            for (k = 0; k < 3; k++) readings[i].radiance[k] = found[round][i];
            readings[i].noise = 0.4f;
        }
        sites[8].pixel = 4;
        CHECK(sbl__places_mean(&r, 3) == 0 && sbl__places_mean(&r, 7) == 8, "only the last place gives the mean");
        noise = (double)readings[7].noise;
        CHECK(fabs((double)readings[7].radiance[1] - (round ? 2 : 4.5)) < 1e-6, "the mean is %g",
              (double)readings[7].radiance[1]);
        /* the middle quarter of the first eight values is 4 and 5, which differ from their mean by 0.5 */
        CHECK(fabs(noise - (round ? 0.4 : 0.5) / sqrt(8)) < 1e-5, "round %d: the noise is %g", round, noise);
    }
}

/* The mean of n looks has the noise of one look over the root of n. A sensor keeps the variance of one look. */
TEST(sensors_keep_the_variance_of_a_look) {
    static sbl__core core;
    sbl__sensor sensors[2], *block = sensors;
    sbl__pixel pixel;
    sbl__site site;
    sbl_reading reading;
    sbl__refine r;
    memset(&r, 0, sizeof r);
    r.shown2 = 1;
    memset(sensors, 0, sizeof sensors);
    memset(&pixel, 0, sizeof pixel);
    memset(&site, 0, sizeof site);
    memset(&reading, 0, sizeof reading);
    r.core = &core;
    r.pixels = &pixel;
    r.sensors = &block;
    r.sites = &site;
    r.readings = &reading;
    r.site_count = 1;
    r.rounds = 1;
    pixel.sensor = 1;
    sensors[1].sensed = 1;
    site.looks = 4;
    reading.radiance[0] = reading.radiance[1] = reading.radiance[2] = 7;
    reading.noise = 0.5f;
    CHECK(sbl__refine_take(&r, 0) == SBL_SUCCESS && sensors[1].looks == 4, "%d looks", sensors[1].looks);
    CHECK(fabs(sensors[1].variance - 1) < 1e-6 && fabs((double)sensors[1].radiance[2] - 7) < 1e-6,
          "four looks of noise 0.5: the variance of one is %g", sensors[1].variance);
}

/* If the number of glows is too large, the darkest are dropped, and their leaves become ordinary leaves again. All
   glows of such a leaf are dropped: otherwise its light would count twice, because rays would find it, too. Two glows
   share a leaf here. */
TEST(dropped_glows_are_ordinary) {
    enum { COUNT = SBL__GLOWS_MOST + 500 };
    static sbl__glow glows[COUNT];
    static sbl__leaf leaves[COUNT];
    static sbl__scene scene;
    static sbl__device device;
    sbl__glowing w;
    int i, bright = 0, kept = 0;
    memset(&w, 0, sizeof w);
    w.device = &device;
    w.scene = &scene;
    scene.geometry.wide = 1;
    scene.store.leaves = leaves;
    scene.bright.glows = glows;
    scene.bright.glow_count = COUNT;
    for (i = 0; i < COUNT; i++) {
        leaves[i].light[0] = i < COUNT / 2 ? -1.0f : 1.0f;  /* a negative red marks a bright leaf */
        leaves[i].light[1] = leaves[i].light[2] = 1;
        glows[i].leaf = (uint32_t)(i / 2);
        glows[i].radiance[1] = 1 + (float)((7 * i) % COUNT) / COUNT;
    }
    REQUIRE(sbl__glow_limit(&w, NULL) == SBL_SUCCESS, "no limit");
    for (i = 0; i < COUNT; i++) bright += sbl__leaf_is_bright(leaves[i].light);
    for (i = 0; i < scene.bright.glow_count; i++) kept += sbl__leaf_is_bright(leaves[glows[i].leaf].light);
    CHECK(scene.bright.glow_count <= SBL__GLOWS_MOST && scene.bright.glow_count > SBL__GLOWS_MOST / 2, "%d glows left",
          scene.bright.glow_count);
    CHECK(2 * bright == scene.bright.glow_count && kept == 2 * bright, "%d glows, %d bright leaves, %d of glows",
          scene.bright.glow_count, bright, kept);
}

/* A grazing vertex normal is bent until its cosine with the triangle's normal is 0.01, on the side that it points to.
   A steeper normal stays as it is. */
TEST(grazing_normals_are_bent) {
    static const struct { double height, expected; } cases[] = {
        { 0.004, 0.01 }, { -0.004, 0.01 }, { 0.009, 0.01 }, { 0.3, 0.3 }, { -1, 1 } };
    static const double weights[3] = { 0.2, 0.3, 0.5 };
    const uint32_t indices[3] = { 0, 1, 2 };
    sbl__vertex vertices[3];
    sbl__attributes attributes[3];
    sbl__geometry g;
    int i, k;
    memset(vertices, 0, sizeof vertices);
    memset(attributes, 0, sizeof attributes);
    memset(&g, 0, sizeof g);
    g.vertices = vertices;
    g.attributes = attributes;
    g.indices = (uint32_t *)(uintptr_t)indices;
    vertices[1].position[0] = vertices[2].position[1] = 1;
    for (i = 0; i < (int)(sizeof cases / sizeof *cases); i++) {
        const double height = cases[i].height;
        sbl_site site;
        double cosine = 0;
        for (k = 0; k < 3; k++) {
            attributes[k].normal[0] = (float)sqrt(1 - height * height);
            attributes[k].normal[2] = (float)height;
        }
        sbl__surface_site(&g, 0, weights, &site);
        for (k = 0; k < 3; k++) cosine += (double)site.normal[k] * (double)site.geometric_normal[k];
        CHECK(fabs(cosine - cases[i].expected) < 1e-6, "height %g: the cosine is %g, expected %g", height, cosine,
              cases[i].expected);
        CHECK(site.geometric_normal[2] * (float)height > 0 && fabs((double)site.position[1] - 0.5) < 1e-6,
              "height %g: the side is %g, y %g", height, (double)site.geometric_normal[2], (double)site.position[1]);
    }
}

/* Returns the area of a glow, negative if its corners run clockwise in x and y. All corners have z = 0.5. */
static double glow_area(const sbl__glow *g) {
    const float *a = g->corner_0, *b = g->corner_1, *c = g->corner_2;
    CHECK(fabs((double)(a[2] + b[2] + c[2]) - 1.5) < 1e-6, "a glow has left its triangle");
    return 0.5 * ((double)(b[0] - a[0]) * (double)(c[1] - a[1]) - (double)(c[0] - a[0]) * (double)(b[1] - a[1]));
}

/* The glows of a triangle cover its part in a bright cell, except for smaller cells in it, and for leaves of the cell
   that are not bright. The cell is four cubes wide. The triangle has the corners (0, 0), (6, 0) and (0, 6), so that the
   cell contains all of its square from 0 to 4 but the corner beyond x + y = 6, which has the area 2. */
TEST(glows_cover_their_cell) {
    static const double corners[3][3] = { { 0, 0, 0.5 }, { 6, 0, 0.5 }, { 0, 6, 0.5 } };
    static const float in_small_cell[3] = { 1.5f, 2.5f, 0.5f }, in_cell[3] = { 0.5f, 0.5f, 0.5f };
    static const struct { int back, cut; double area; } cases[] = {
        { 0, 0, 13 }, { 1, 0, -13 }, { 0, 1, 5.5 }, { 0, 0, 13 }
    };
    static sbl__scene scene;
    static sbl__device device;
    static sbl__cell_bucket cells[128];
    sbl__vertex vertices[3];
    sbl__object object;
    sbl__leaf leaves[2];
    sbl__cut cut;
    sbl__polygon p;
    uint32_t indices[3] = { 0, 1, 2 }, patches[1] = { 0 }, order[1] = { 0 };
    int i, k;
    memset(&scene, 0, sizeof scene);
    memset(vertices, 0, sizeof vertices);
    memset(&object, 0, sizeof object);
    memset(leaves, 0, sizeof leaves);
    memset(&cut, 0, sizeof cut);
    device.base = &base;
    scene.geometry.vertices = vertices;
    scene.geometry.indices = indices;
    scene.geometry.objects = &object;
    scene.hierarchy.order = order;
    scene.store.patches = patches;
    scene.store.cells = cells;
    scene.store.cell_capacity = 128;
    scene.store.leaves = leaves;
    scene.store.cuts = &cut;
    scene.store.length = 1;
    object.albedo[0] = object.albedo[1] = object.albedo[2] = 0.5f;
    object.reflectance = -1;
    leaves[0].light[0] = -6;  /* bright */
    leaves[0].light[1] = leaves[0].light[2] = 4;
    leaves[1].light[0] = 1;
    cut.normal[0] = 1;
    cut.distance = 1.5f;
    cut.sides[0] = 1;
    cut.sides[1] = 2;
    for (i = 0; i < 3; i++) for (k = 0; k < 3; k++) vertices[i].position[k] = (float)corners[i][k];
    for (i = 0; i < 4; i++) {
        const uint32_t side = cases[i].back ? SBL__PATCH_BACK : 0;
        const sbl__bright_cell cell = { side | SBL__PATCH_LEVEL, { 0, 0, 0 } };
        sbl__glowing w;
        double area = 0;
        memset(&w, 0, sizeof w);
        leaves[1].light[0] = i == 3 ? -1.0f : 1.0f;  /* the small cell is bright, too: its glows are its own */
        memset(&scene.bright, 0, sizeof scene.bright);
        memset(cells, 0, sizeof cells);
        w.device = &device;
        w.scene = &scene;
        w.patch = side;
        *sbl__store_bucket(&scene.store, cell.patch, in_cell) = cases[i].cut ? SBL__CELL_CUT : 1;
        *sbl__store_bucket(&scene.store, side, in_small_cell) = 2;
        CHECK(sbl__glow_cell(&w, &cell) == SBL_SUCCESS, "no glows");
        for (k = 0; k < scene.bright.glow_count; k++) {
            const sbl__glow *g = &scene.bright.glows[k];
            const double own = glow_area(g);
            CHECK(own * cases[i].area > 0, "case %d: glow %d has the area %g", i, k, own);
            CHECK(fabs((double)g->radiance[0] - 3) < 1e-6 && g->leaf == 0 && g->triangle == 0,
                  "case %d: glow %d: radiance %g, leaf %u", i, k, (double)g->radiance[0], g->leaf);
            area += own;
        }
        CHECK(fabs(area - cases[i].area) < 1e-5, "case %d: the glows have the area %g, expected %g", i, area,
              cases[i].area);
        CHECK(fabs((double)scene.bright.unit - 3) < 1e-6, "the brightest glow is %g", (double)scene.bright.unit);
        /* a polygon of three corners, and corners of an earlier polygon behind them */
        scene.bright.glow_count = 0;
        leaves[1].light[0] = 1;
        memset(&p, 0, sizeof p);
        memcpy(p.corners, corners, sizeof corners);
        p.corners[3][1] = -9;
        p.count = 3;
        for (w.area = 17.9; w.area < 18.15; w.area += 0.2)
            CHECK(sbl__glow_add(&w, &p, 1) == SBL_SUCCESS && sbl__glow_add(&w, &p, 0) == SBL_SUCCESS &&
                      scene.bright.glow_count == 1, "%d glows, one has the area 18", scene.bright.glow_count);
        sbl__free(&base, scene.bright.glows);
    }
}

/* The directions to viewers and the colours of lobes, packed like gbuffer_fragment.glsl packs them: an octahedron is
   unfolded to a square, and two numbers share a float. */
TEST(lobes_are_unpacked) {
    static const double steps = 4095;
    int i, k;
    for (i = 0; i < 200; i++) {
        const double z = 1 - (2 * i + 1) / 200.0, turn = 2.4 * i, r = sqrt(1 - z * z);
        const double view[3] = { r * cos(turn), r * sin(turn), z };
        const double sum = fabs(view[0]) + fabs(view[1]) + fabs(view[2]), x = view[0] / sum, y = view[1] / sum;
        const int packed[4] = { i * 20, 4095 - i, i, 3000 + i };  /* red, green, blue, roughness */
        const float lobe[4] = { (float)(packed[0] + 4096 * packed[1]), (float)(packed[2] + 4096 * packed[3]),
                                (float)(z < 0 ? (x < 0 ? -1 : 1) * (1 - fabs(y)) : x),
                                (float)(z < 0 ? (y < 0 ? -1 : 1) * (1 - fabs(x)) : y) };
        sbl__pixel_lobe out;
        sbl__reflections_unpack(lobe, &out);
        for (k = 0; k < 3; k++)
            CHECK(fabs((double)out.view[k] - view[k]) < 1e-5 &&
                      fabs((double)out.reflectance[k] - packed[k] / steps) < 1e-6, "direction %d: view[%d] is %g, "
                  "not %g", i, k, (double)out.view[k], view[k]);
        CHECK(fabs((double)out.roughness - packed[3] / steps) < 1e-6, "roughness %g", (double)out.roughness);
    }
}

/* 40 parallel mirrors of different sizes are below one lamp. The 32 largest are kept, and each knows the image of the
   lamp below it. A mirror through the lamp and one without size show nothing. */
TEST(largest_mirrors_of_lamps_are_kept) {
    static sbl__lamp_trees l;
    static sbl__lamps lamps;
    sbl__geometry g;
    sbl__lamp_node node;
    int i, seen[40];
    memset(&g, 0, sizeof g);
    memset(&node, 0, sizeof node);
    memset(seen, 0, sizeof seen);
    g.extent = 10;
    node.beyond = 1;
    node.middle[1] = 3;
    node.power = 2;
    l.geometry = &g;
    l.lamps = &lamps;
    l.nodes = &node;
    l.node_count = 1;
    l.plane_count = 42;
    for (i = 0; i < 42; i++) {
        l.planes[i].normal[1] = 1;
        l.planes[i].offset = i == 40 ? 3 : -1;
        l.planes[i].own = i == 41 ? 0 : 1 + i * 17 % 40;
        l.planes[i].alpha = (float)i;
    }
    sbl__lamp_trees_mirror(&l);
    CHECK(lamps.mirrored_count == SBL__MIRRORED_MOST, "%d lamps in mirrors", lamps.mirrored_count);
    for (i = 0; i < lamps.mirrored_count; i++) {
        const sbl__mirrored *m = &lamps.mirrored[i];
        const int number = (int)m->alpha;
        CHECK(number < 40 && !seen[number]++ && number * 17 % 40 >= 40 - SBL__MIRRORED_MOST, "mirror %d is kept",
              number);
        CHECK(fabs((double)m->middle[1] + 5) < 1e-6 && fabs((double)m->offset + 1) < 1e-6 && m->normal[1] > 0 &&
                  fabs((double)m->power - 2) < 1e-6, "mirror %d: the image is at %g", number, (double)m->middle[1]);
    }
    l.plane_count = 1;
    sbl__lamp_trees_mirror(&l);
    CHECK(lamps.mirrored_count == 1, "%d images in one mirror", lamps.mirrored_count);
}

/* A line runs from x = 0 to x = 1 through a cell that is cut at x = 0.5. Both parts have cuts, which the line does not
   cross there. It cuts only the two parts that it crosses. */
TEST(contact_lines_cut_what_they_cross) {
    static const float across[3] = { 1, 0, 0 }, apart[3] = { 0.5f, 0.25f, 0.75f };
    static sbl__bounce b;
    static sbl__core core;
    sbl__store store;
    sbl__contact line;
    uint32_t root = 0, *reference = &root;
    const double whole[2] = { 0, 1 };
    int i;
    memset(&store, 0, sizeof store);
    memset(&line, 0, sizeof line);
    core.base = base;
    store.length = 1;
    b.core = &core;
    b.store = &store;
    line.normal[1] = 1;
    line.distance = 0.5f;
    line.from[1] = 0.5;
    line.along[0] = 1;
    for (i = 0; i < 3; i++) {  /* x = 0.25 lies on side 1 of x = 0.5, and x = 0.75 on side 0 */
        CHECK(sbl__store_cut(&core.base, &store, reference, across, apart[i], 0) == SBL_SUCCESS, "no memory");
        reference = &store.cuts[0].sides[i == 0];
    }
    CHECK(sbl__contact_cut_below(&b, &line, &root, whole, 0) == SBL_SUCCESS && store.cut_count == 5, "%d cuts",
          store.cut_count);
    for (i = 0; i < 2; i++) {  /* x = 0.25 and 0.75: the line is beyond the first, and before the second */
        const uint32_t *sides = store.cuts[1 + i].sides;
        CHECK(!sides[i] && sides[!i] >= SBL__CELL_CUT, "cut %d leads to %u and %u", 1 + i, sides[0], sides[1]);
        CHECK(store.cuts[3 + i].normal[1] > 0.9f && fabs((double)store.cuts[3 + i].distance - 0.5) < 1e-6, "cut %d",
              3 + i);
    }
    CHECK(sbl__contact_cut_below(&b, &line, &root, whole, 0) == SBL_SUCCESS && store.cut_count == 5,
          "a line cuts twice");
    sbl__free(&core.base, store.cuts);
}

/* A surface without albedo is black only if it is matte: gloss and metal reflect light. */
TEST(black_surfaces_are_matte) {
    static const struct { float albedo, reflectance; int black; } cases[4] = {
        { 0, -1, 1 }, { 0.01f, -1, 0 }, { 0, 0, 0 }, { 0, 0.04f, 0 } };
    uint32_t indices[3] = { 0, 1, 2 };
    sbl__vertex vertices[3];
    sbl__object object;
    sbl__geometry g;
    int i;
    memset(vertices, 0, sizeof vertices);
    memset(&object, 0, sizeof object);
    memset(&g, 0, sizeof g);
    g.vertices = vertices;
    g.indices = indices;
    g.objects = &object;
    for (i = 0; i < 4; i++) {
        object.albedo[2] = cases[i].albedo;
        object.reflectance = cases[i].reflectance;
        CHECK(sbl__triangle_is_black(&g, 0) == cases[i].black, "albedo %g, reflectance %g", (double)cases[i].albedo,
              (double)cases[i].reflectance);
    }
}

/* A plane cuts a leaf only if the leaf continues behind it; two contact rays that hit the same plane cut once. The part
   with the leaf's points keeps the leaf. If the contact rays of a leaf were cast earlier than a line cuts it, all hits
   must be placed again. */
TEST(planes_cut_leaves_once) {
    static const float corners[6][3] = { { 0, 0, 0 }, { 0, 0, 1 }, { 1, 0, 0 },
                                         { 0.6f, 0, 0 }, { 0.6f, 0, 1 }, { 0.6f, 1, 0 } };
    static sbl__bounce b;
    static sbl__core core;
    static sbl__cell_bucket cells[128];
    uint32_t indices[6] = { 0, 1, 2, 3, 4, 5 }, patches[2] = { 0, 1u << SBL__PATCH_SHIFT }, root;
    const double whole[2] = { 0, 1 };
    sbl__vertex vertices[6];
    sbl__bounce_point point;
    sbl__bounce_leaf state;
    sbl__geometry g;
    sbl__store store;
    sbl__contact line;
    sbl__hit hit;
    int i;
    memset(vertices, 0, sizeof vertices);
    memset(&point, 0, sizeof point);
    memset(&state, 0, sizeof state);
    memset(&g, 0, sizeof g);
    memset(&store, 0, sizeof store);
    memset(&line, 0, sizeof line);
    memset(&hit, 0, sizeof hit);
    for (i = 0; i < 6; i++) memcpy(vertices[i].position, corners[i], sizeof *corners);
    g.vertices = vertices;
    g.indices = indices;
    core.base = base;
    store.patches = patches;
    store.cells = cells;
    store.cell_capacity = 128;
    store.length = 1;
    store.leaf_count = store.max_leaves = 1;
    b.core = &core;
    b.geometry = &g;
    b.store = &store;
    b.points = &point;
    b.states = &state;
    point.at.distance = 9;
    point.at.position[0] = point.at.position[2] = 0.2f;
    hit.side = 1 << 1;
    hit.position[0] = 0.6f;
    hit.position[1] = hit.position[2] = 0.2f;
    *sbl__store_bucket(&store, 0, point.at.position) = 1;
    for (i = 0; i < 2; i++)
        CHECK(sbl__contacts_cut(&b, 0, &hit) == SBL_SUCCESS && store.cut_count == 1, "%d cuts", store.cut_count);
    line.normal[0] = 1;
    line.distance = 0.6f;
    for (i = 0; i < 2; i++) {
        const sbl__cut *cut;
        root = 1;
        b.cut_leaves = i;
        CHECK(sbl__contact_cut_below(&b, &line, &root, whole, 0) == SBL_SUCCESS && store.cut_count == 2 + i, "no cut");
        cut = &store.cuts[1 + i];
        CHECK(cut->sides[0] == 1 && !cut->sides[1] && b.recheck == i, "the cut leads to %u and %u, and %s",
              cut->sides[0], cut->sides[1], b.recheck ? "hits are placed again" : "hits stay");
    }
    sbl__free(&core.base, store.cuts);
}

/* The light of glows is added to that of lamps, in R and in all groups. Points that are invalid keep their light. */
TEST(light_of_glows_is_added) {
    static sbl__bounce b;
    static sbl__core core;
    static sbl__bounce_point points[2];
    static sbl__site sites[2];
    static sbl_reading readings[2];
    float layers[24], found[12];
    int i, k;
    core.scene.light_groups = 2;
    b.core = &core;
    b.points = points;
    b.sites = sites;
    b.readings = readings;
    b.layers = layers;
    b.found_layers = found;
    b.site_count = 2;
    memset(layers, 0, sizeof layers);
    sites[1].number = 1;
    for (b.glows = SBL__GLOWS_NOWHERE; b.glows <= SBL__GLOWS_EVERYWHERE; b.glows += SBL__GLOWS_EVERYWHERE) {
        for (i = 0; i < 2; i++) {
            readings[i].valid = !b.glows || i == 0;
            for (k = 0; k < 3; k++) readings[i].radiance[k] = (float)((b.glows ? 10 : 1) * (k + 1 + 3 * i));
        }
        for (i = 0; i < 12; i++) found[i] = (float)((b.glows ? 10 : 1) * (i + 1));
        CHECK(sbl__solution_after_light(&b) == SBL__BOUNCE_DIRECT, "another stage follows");
    }
    for (i = 0; i < 2; i++) {
        CHECK(points[i].measured && points[i].valid, "point %d is not measured", i);
        for (k = 0; k < 3; k++)
            CHECK(fabs((double)points[i].light[k] - (i ? 1 : 11) * (k + 1 + 3 * i)) < 1e-5, "point %d: R[%d] is %g", i,
                  k, (double)points[i].light[k]);
        for (k = 0; k < 6; k++)
            CHECK(fabs((double)layers[12 * i + k] - (i ? 1 : 11) * (6 * i + k + 1)) < 1e-5 &&
                      !(layers[12 * i + 6 + k] > 0), "point %d: layer %d is %g", i, k, (double)layers[12 * i + k]);
    }
}

static int warnings;
static void count_warnings(sbl_log_level level, sbl_log_item item, const char *message, void *user) {
    (void)message; (void)user;
    warnings += level == SBL_LOG_WARNING && item == SBL_LOG_ITEM_ALBEDO;
}

/* White walls cause one warning, if most light is bounced light. */
TEST(white_walls_are_told_once) {
    static sbl__bounce b;
    static sbl__core core;
    sbl__store store;
    sbl__object objects[2];
    sbl__geometry g;
    memset(&store, 0, sizeof store);
    memset(objects, 0, sizeof objects);
    memset(&g, 0, sizeof g);
    core.base = base;
    core.base.logger.log = count_warnings;
    b.core = &core;
    b.store = &store;
    b.geometry = &g;
    g.objects = objects;
    g.mesh_count = 2;
    warnings = 0;
    objects[1].albedo[0] = objects[1].albedo[1] = 1;
    sbl__solution_warn(&b, 1, 100);
    CHECK(warnings == 0, "yellow walls cause a warning");
    objects[1].albedo[2] = 1;
    sbl__solution_warn(&b, 1, 2.9);
    CHECK(warnings == 0, "little bounced light causes a warning");
    sbl__solution_warn(&b, 1, 3.1);
    sbl__solution_warn(&b, 1, 100);
    CHECK(warnings == 1, "%d warnings", warnings);
}

/* If only lights change, the points of the store are kept and measured again, first without glows. If a cut has split
   leaves, hits are placed first. If surfaces change, or light reflects off metal, the store is filled anew. */
TEST(changed_lights_keep_points) {
    static sbl__core core;
    int i;
    core.base = base;
    core.device.base = &core.base;
    for (i = 0; i < 6; i++) {  /* nothing changes; lights, late; with a split; lights, early; surfaces; metal */
        sbl__bounce *b, *kept = (sbl__bounce *)sbl__alloc(&core.base, 1, sizeof *kept);
        REQUIRE(kept, "no memory");
        kept->points = (sbl__bounce_point *)sbl__alloc(&core.base, 2, sizeof *kept->points);
        REQUIRE(kept->points, "no memory");
        core.scene.version = i > 0;
        core.scene.surfaces = i == 4;
        core.scene.features = i == 5 ? SBL__SPECULAR : 0;
        kept->point_count = 2;
        kept->points[0].measured = kept->points[1].measured = 1;
        kept->glows = SBL__GLOWS_EVERYWHERE;
        kept->changed = i == 2;
        kept->stages.stage = i == 3 ? SBL__BOUNCE_CAST_POINTS : SBL__BOUNCE_SUM_FOUND;
        kept->stages.at = 7;
        core.bounce = kept;
        b = sbl__bounce_resume(&core);
        REQUIRE(b && b == core.bounce, "no filling");
        CHECK(b->scene == core.scene.version && b->surfaces == core.scene.surfaces, "case %d: an old version", i);
        if (i < 4) {
            const int again = i == 1 || i == 2;
            CHECK(b->points && b->points[0].measured == !i && b->points[1].measured == !i, "case %d: points measured",
                  i);
            CHECK(b->glows == (again ? SBL__GLOWS_NOWHERE : SBL__GLOWS_EVERYWHERE), "case %d: glows %d", i, b->glows);
            CHECK(b->stages.at == (again ? 0 : 7), "case %d: item %d", i, b->stages.at);
            CHECK(b->stages.stage == (i == 1 ? SBL__BOUNCE_SITES : i == 2 ? SBL__BOUNCE_RELOCATE
                                    : i == 3 ? SBL__BOUNCE_CAST_POINTS : SBL__BOUNCE_SUM_FOUND),
                  "case %d: stage %d", i, b->stages.stage);
        } else CHECK(!b->points && b->point_count == 0 && b->stages.stage == 0, "case %d: points are kept", i);
        sbl__free(&core.base, b->points);
        sbl__free(&core.base, b);
    }
    CHECK(core.base.memory.host_bytes == 0, "memory is left");
}

/* A change of lights makes lamps, store and glows out of date; a change of surfaces also the hierarchy. */
TEST(changes_reach_what_depends_on_them) {
    static sbl__scene scene;
    static sbl__device device;
    sbl__base own = base;
    int surfaces;
    device.base = &own;
    for (surfaces = 0; surfaces < 2; surfaces++) {
        memset(&scene, 0, sizeof scene);
        scene.hierarchy.ready = scene.lamps.ready = scene.store.ready = scene.bright.ready = 1;
        scene.bright.glow_count = 1;
        scene.bright.glows = (sbl__glow *)sbl__alloc(&own, 1, sizeof(sbl__glow));
        scene.glowing = (sbl__glowing *)sbl__alloc(&own, 1, sizeof(sbl__glowing));
        if (surfaces) sbl__scene_changed(&device, &scene);
        else sbl__scene_lamps_changed(&device, &scene);
        CHECK(!scene.lamps.ready && !scene.store.ready && scene.hierarchy.ready == !surfaces, "lamps %d, store %d, "
              "hierarchy %d", scene.lamps.ready, scene.store.ready, scene.hierarchy.ready);
        CHECK(!scene.bright.ready && !scene.bright.glow_count && !scene.glowing && own.memory.host_bytes == 0,
              "glows are kept");
        CHECK(scene.version == 1 && scene.surfaces == (uint32_t)surfaces, "version %u, of surfaces %u", scene.version,
              scene.surfaces);
    }
}

/* A lamp of an inspected sensor is a triangle of a mesh (also the triangle on which a glow lies), a texel or a light.
   It is listed once. */
TEST(lamps_of_sensors_are_named) {
    static sbl__core core;
    static sbl__inspection found;
    static sbl__inspect_request request;
    sbl__mesh meshes[2];
    sbl__vertex vertices[3];
    sbl__glow glows[2];
    sbl_sensor_lamp lamps[4];
    uint32_t codes[5], indices[15], order[5] = { 4, 3, 2, 1, 0 };
    static sbl_sensor_ray rays[2];
    static const sbl_lamp_kind kinds[4] = { SBL_LAMP_TRIANGLE, SBL_LAMP_TRIANGLE, SBL_LAMP_SKY_TEXEL, SBL_LAMP_LIGHT };
    static const int expected[4][2] = { { 0, 1 }, { 1, 2 }, { -1, 300 }, { -1, 7 } };  /* mesh, number */
    int i;
    memset(meshes, 0, sizeof meshes);
    memset(vertices, 0, sizeof vertices);
    memset(glows, 0, sizeof glows);
    meshes[1].first_triangle = 2;
    vertices[1].object = 1;
    for (i = 0; i < 15; i++) indices[i] = i >= 6;  /* triangles 2 to 4 belong to mesh 1 */
    core.scene.geometry.meshes = meshes;
    core.scene.geometry.vertices = vertices;
    core.scene.geometry.indices = indices;
    core.scene.hierarchy.order = order;
    core.scene.bright.codes = codes;
    core.scene.bright.glows = glows;
    core.scene.bright.ready = 1;
    core.scene.bright.glow_count = 2;
    codes[0] = SBL__LAMP_TRIANGLE << SBL__LAMP_KIND_SHIFT | 3;
    codes[1] = codes[4] = SBL__LAMP_GLOW << SBL__LAMP_KIND_SHIFT | 1;
    codes[2] = SBL__LAMP_SKY_TEXEL << SBL__LAMP_KIND_SHIFT | 300;
    codes[3] = SBL__LAMP_DISTANT_LIGHT << SBL__LAMP_KIND_SHIFT | 7;
    found.job.task.spec.glows = 1;
    found.lamps = lamps;
    request.core = &core;
    request.found = &found;
    for (i = 0; i < 5; i++) {
        const int at = sbl__inspect_lamp(&request, i), wanted = i < 4 ? i : 1;
        CHECK(at == wanted && lamps[at].kind == kinds[at] && lamps[at].mesh == expected[at][0] &&
                  lamps[at].number == expected[at][1], "lamp %d is lamp %d: mesh %d, number %d", i, at, lamps[at].mesh,
              lamps[at].number);
    }
    found.rays = rays;
    for (i = 0; i < 5; i++) {  /* a lamp, a visible and a hidden point light; an open and a blocked ray */
        const float light[4] = { 1, 2, 3, i < 3 ? (float)i + 1 : (float)i - 2 }, direction[4] = { 0, 1, 0, 3 };
        sbl__inspect_take(&request, light, direction, i >= 3);
        CHECK(lamps[3].rays == i && lamps[3].open == (i == 0 ? 0 : i < 3 ? 1 : 2) && lamps[3].unhindered[2] == 3 &&
                  request.out.ray_count == (i < 3 ? 0 : i - 2), "step %d: %d rays, %d open", i, lamps[3].rays,
              lamps[3].open);
    }
}

/* Components of all types become real numbers. The least integer of a signed type stands for -1, as its neighbour. */
TEST(components_of_all_types_are_read) {
    static const unsigned char bytes[4] = { 0xff, 0x7f, 0x01, 0x80 };  /* little-endian */
    static const double expected[SBL_TYPE_COUNT][2] = {  /* from the first byte, and from the third */
        { 0, 0 }, { 0, 0 }, { 1, 1 / 255.0 }, { 32767 / 65535.0, 32769 / 65535.0 }, { -1 / 127.0, 1 / 127.0 },
        { 1, -1 }, { 255, 1 }, { 32767, 32769 }, { 2147581951.0, 0 }
    };
    static const unsigned char least[4] = { 0x00, 0x80, 0x01, 0x80 };
    int type, i;
    for (type = SBL_UINT8_NORM; type < SBL_TYPE_COUNT; type++)
        for (i = 0; i < (type == SBL_UINT32 ? 1 : 2); i++)
            CHECK(fabs(sbl__component(bytes + 2 * i, (sbl_type)type) - expected[type][i]) < 1e-12, "type %d: %g, not "
                  "%g", type, sbl__component(bytes + 2 * i, (sbl_type)type), expected[type][i]);
    CHECK(fabs(sbl__component(least, SBL_INT16_NORM) + 1) < 1e-12 &&
              fabs(sbl__component(least + 1, SBL_INT8_NORM) + 1) < 1e-12, "-32768 is %g, -128 is %g",
          sbl__component(least, SBL_INT16_NORM), sbl__component(least + 1, SBL_INT8_NORM));
}

/* Light that scouts find in one bin counts for its neighbours. Sectors are a circle, bands are not: the light of an
   outer band is not seen beyond the opposite edge, but counts twice at its own. */
TEST(guides_are_smoothed) {
    static const double expected[5][3] = { { 0, 0, 0.48 }, { 0, 1, 0.16 }, { 0, SBL__GUIDE_SECTORS - 1, 0.16 },
                                           { 1, 0, 0.12 }, { SBL__GUIDE_BANDS - 1, 0, 0 } };
    static float found[SBL__GUIDE_BINS];
    uint32_t words[SBL__GUIDE_SECTORS / 2];
    int i;
    found[0] = 1;
    for (i = 0; i < 5; i++)
        CHECK(fabs((double)sbl__guide_smooth(found, (int)expected[i][0], (int)expected[i][1]) - expected[i][2]) < 1e-6,
              "bin %g %g has %g", expected[i][0], expected[i][1],
              (double)sbl__guide_smooth(found, (int)expected[i][0], (int)expected[i][1]));
    CHECK(sbl__guide_bin(1, 1) == SBL__GUIDE_BINS - 1 && sbl__guide_bin(0, 1) == SBL__GUIDE_SECTORS - 1, "bins %d, %d",
          sbl__guide_bin(1, 1), sbl__guide_bin(0, 1));
    sbl__guide_intervals(found + SBL__GUIDE_SECTORS, SBL__GUIDE_SECTORS, SBL__GUIDE_UNIFORM, words);
    for (i = 0; i < SBL__GUIDE_SECTORS; i++)  /* in a dark band, all sectors have the same probability */
        CHECK((words[i / 2] >> 16 * (i & 1) & 0xffff) == (uint32_t)(SBL__GUIDE_STEPS * i / SBL__GUIDE_SECTORS),
              "sector %d begins at %u", i, words[i / 2] >> 16 * (i & 1) & 0xffff);
}

/* The number of rays of looks grows only after the first round, if the host has not chosen it, and if looks are
   noisy. */
TEST(looks_grow_after_the_first_round) {
    sbl__refine r;
    sbl__measurement m;
    int i;
    memset(&r, 0, sizeof r);
    memset(&m, 0, sizeof m);
    m.look_rays = 16;
    m.options.backend = SBL_BACKEND_TRACE;
    r.measurement = &m;
    r.target_error = 0.1f;
    for (i = 0; i < 5; i++) {  /* the second round; chosen rays; chosen looks; little noise; otherwise */
        r.rounds = i == 0 ? 2 : 1;
        m.options.rays = i == 1 ? 16 : 0;
        r.look_rays = i == 2 ? 16 : 0;
        r.look_variance = SBL__LOOK_VARIANCE * 0.01 * (i == 3 ? 1.9 : 4.1);
        CHECK(sbl__refine_growth(&r) == (i == 4 ? 4 : 1), "case %d: looks grow %d times", i, sbl__refine_growth(&r));
    }
}

/* A place is open if its ray hits no near surface and does not come from within a solid. A solid is known by the backs
   of its faces, unless most of the lightmap shows backs. */
TEST(places_are_open) {
    static const struct { int valid; double back, share, mean, backs; int open; } cases[] = {
        { 1, 0, 0, 0, 0, 1 }, { 0, 0, 0, 0, 0, 0 }, { 1, 0, 1, 0.9, 0, 0 }, { 1, 0, 1, 1, 0, 1 }, { 1, 1, 1, 9, 0, 0 },
        { 1, 1, 1, 9, 0.5, 0 }, { 1, 1, 1, 9, 0.6, 1 }, { 1, 0.5, 1, 9, 0, 1 }
    };
    sbl__refine r;
    int i;
    memset(&r, 0, sizeof r);
    r.distance_limit = 1;
    r.lit = 100;
    for (i = 0; i < (int)(sizeof cases / sizeof *cases); i++) {
        sbl_reading reading;
        memset(&reading, 0, sizeof reading);
        reading.valid = cases[i].valid;
        reading.back_share = (float)cases[i].back;
        reading.hit_share = (float)cases[i].share;
        reading.hit_mean = (float)cases[i].mean;
        r.lit_backs = 100 * cases[i].backs;
        CHECK(sbl__place_is_open(&r, &reading) == cases[i].open, "case %d is wrong", i);
    }
}

/* The second weight of a texel is the length of the ray through its centre, for a depth of 1. */
TEST(depths_become_distances) {
    sbl__layout l;
    float *weights;
    int face, i, j;
    sbl__layout_make(&l, 1, 8, 0);
    weights = (float *)calloc(2 * (size_t)(sbl__layout_pitch(&l, 0) * sbl__layout_pitch(&l, 1)), sizeof *weights);
    REQUIRE(weights, "no memory");
    for (face = 0; face < 5; face++)
        for (j = 0; j < l.rects[face][3]; j++) {
            sbl__weights_row(&l, 0, face, j, weights);
            for (i = 0; i < 8; i++) {
                const double x = (i + 0.5) / 4 - 1, y = face ? (j + 0.5) / 4 : (j + 0.5) / 4 - 1;
                const int at = (l.rects[face][1] + j) * sbl__layout_pitch(&l, 0) + l.rects[face][0] + i;
                CHECK(fabs((double)weights[2 * at + 1] - sqrt(1 + x * x + y * y)) < 1e-6, "view %d, texel %d %d: %g",
                      face, i, j, (double)weights[2 * at + 1]);
            }
        }
    free(weights);
}

/* The time of a stage counts for the part of the work that the statistics name. */
TEST(seconds_belong_to_stages) {
    static sbl__core core;
    static sbl__map m;
    sbl_stats *stats = &core.stats;
    int stage;
    m.work.core = &core;
    for (stage = 0; stage <= SBL__MAP_END; stage++) {
        const int develops = stage == SBL__MAP_PREVIEW || stage == SBL__MAP_DEVELOP;
        m.work.stages.stage = stage;
        m.developing.stage = 0;
        CHECK(sbl__map_seconds(&m) == (stage <= SBL__MAP_READ ? &stats->seconds.surface
                                     : stage == SBL__MAP_END  ? &stats->seconds.resolve : &stats->seconds.refine),
              "the seconds of stage %d", stage);
        m.developing.stage = SBL__DEVELOP_FILTER;
        CHECK(!develops || sbl__map_seconds(&m) == &stats->seconds.filter, "the filter of stage %d", stage);
        m.developing.stage = SBL__DEVELOP_DONE;
        CHECK(!develops || sbl__map_seconds(&m) == &stats->seconds.resolve, "the end of stage %d", stage);
    }
}

/* The progress of a lightmap counts its finished layers. */
TEST(layers_are_progress) {
    static sbl__core core;
    static sbl__lightmap l;
    int layer;
    core.base = base;
    core.device.base = &core.base;
    l.map.work.core = &core;
    l.map.spec.directional = 1;
    for (layer = 0; layer + 1 < SBL__LAYERS; layer++) {
        CHECK(sbl__lightmap_after_send(&l) == SBL__MAP_DEVELOP && l.map.layer == layer + 1, "layer %d follows",
              l.map.layer);
        CHECK(fabs((double)l.map.finished - (layer + 1.0) / SBL__LAYERS) < 1e-6, "after layer %d, %g are finished",
              layer, (double)l.map.finished);
    }
}

/* The mean of R of a joined lightmap, to which its seams are compared, is that of texels with surfaces. These are ring
   0 of the gutters. */
TEST(joined_texels_have_a_mean) {
    static float light[12] = { 1, 2, 3, 9, 9, 9, 3, 2, 1, 9, 9, 9 }, ids[4] = { 1, 0, 2, 0 };
    static sbl__core core;
    static sbl__joining j;
    sbl__slice slice = slice_of(0);
    int i;
    core.base = base;
    j.work.core = &core;
    j.desc.lightmap.width = j.desc.lightmap.height = 2;
    j.desc.light[0] = light;
    j.desc.ids = ids;
    CHECK(sbl__joining_take(&j, &slice) == SBL_SUCCESS && j.texels == 2, "%g texels", (double)j.texels);
    CHECK(fabs(j.luminance - 4 * 0.2126 - 4 * 0.7152 - 4 * 0.0722) < 1e-5, "the sum of R is %g", j.luminance);
    for (i = 0; i < 16; i++)
        CHECK(fabs((double)j.gutters.light[i] - (i % 4 < 3 ? (double)light[i / 4 * 3 + i % 4] : i / 4 % 2 ? -1 : 0)) <
                  1e-6, "component %d is %g", i, (double)j.gutters.light[i]);
    sbl__gutters_free(&core.base, &j.gutters);
}

/* The right-hand side of a light group at vertices is the sum of what its points find. Points that see mostly back
   faces count if the mesh is inside out. */
TEST(groups_of_meshes_inside_out) {
    static sbl__vertices s;
    static float layer_sums[36], sums[SBL__VERTICES_SUMS];
    static double residual[9];
    sbl__baked_mesh mesh;
    uint32_t corners[3] = { 0, 1, 2 };
    int neighbours[3], i;
    memset(&mesh, 0, sizeof mesh);
    for (i = 0; i < 36; i++) layer_sums[i] = (float)(i + 1);
    s.meshes = &mesh;
    s.mesh_count = 1;
    s.corners = corners;
    s.sums = sums;
    s.layer_sums = layer_sums;
    s.neighbours = neighbours;
    s.solver.residual = residual;
    s.groups = s.layer = 2;
    sums[6] = 1;
    mesh.points = 10;
    for (mesh.back_points = 4; mesh.back_points < 7; mesh.back_points += 2) {
        memset(residual, 0, sizeof residual);
        CHECK(sbl__vertices_next(&s, 0) == SBL_SUCCESS, "no sums");
        for (i = 0; i < 9; i++)
            CHECK(fabs(residual[i] - (10 + i) - (mesh.back_points > 5 ? 28 + i : 0)) < 1e-9 &&
                      neighbours[i / 3] == SBL__VERTICES_LIT, "%g back points: sum %d is %g", mesh.back_points, i,
                  residual[i]);
    }
}

/* A window shows a rectangle of the working grid. A tile fills in all its pixels but the last column and row, which the
   next tile fills in, unless the picture ends there. */
TEST(windows_and_tiles_have_ends) {
    static const int ends[4][4] = { { 4, 4, 3, 3 }, { 8, 4, 8, 3 }, { 4, 8, 3, 8 }, { 8, 8, 8, 8 } };
    sbl__window w;
    sbl__refine r;
    sbl__tile tile;
    int out[4], i;
    memset(&w, 0, sizeof w);
    memset(&r, 0, sizeof r);
    memset(&tile, 0, sizeof tile);
    w.inset[0] = 3;
    w.inset[1] = 4;
    w.shown[0] = 10;
    w.shown[1] = 20;
    CHECK(sbl__window_scissor(&w, 2, out) == out && out[0] == 1 && out[1] == 2 && out[2] == 14 && out[3] == 24,
          "the scissor is at %d %d, its size is %d %d", out[0], out[1], out[2], out[3]);
    CHECK(!sbl__window_scissor(NULL, 2, out), "no window has a scissor");
    r.width = r.height = 9;
    for (i = 0; i < 4; i++) {
        sbl__range pixels;
        tile.area.x[1] = ends[i][0];
        tile.area.y[1] = ends[i][1];
        pixels = sbl__tile_pixels(&r, &tile);
        CHECK(!pixels.x[0] && !pixels.y[0] && pixels.x[1] == ends[i][2] && pixels.y[1] == ends[i][3],
              "tile %d fills in pixels to %d %d", i, pixels.x[1], pixels.y[1]);
    }
}

/* A dark sensor that sees mostly back faces is inside a solid, unless most lit sensors see backs. Without bounced light
   it must see nothing but back faces. */
TEST(dark_sensors_are_inside) {
    static const struct { double light, share, back, backs; int bounced, inside; } cases[] = {
        { 0, 1, 1, 0, 0, 1 }, { 0, 1, 1, 60, 0, 0 }, { 0, 0.9, 1, 0, 0, 0 }, { 0, 1, 0.9, 0, 0, 0 },
        { 1, 1, 1, 0, 0, 0 }, { 0, 0.9, 0.6, 0, 1, 1 }, { 0, 1, 0.5, 0, 1, 0 }, { 1, 1, 1, 0, 1, 0 },
        { 0, 1, 1, 60, 1, 0 }
    };
    sbl__refine r;
    sbl__spec spec;
    int i, k;
    memset(&r, 0, sizeof r);
    memset(&spec, 0, sizeof spec);
    r.spec = &spec;
    r.lit = 100;
    r.lit_light = 100;
    for (i = 0; i < (int)(sizeof cases / sizeof *cases); i++) {
        sbl_reading reading;
        memset(&reading, 0, sizeof reading);
        for (k = 0; k < 3; k++) reading.radiance[k] = (float)cases[i].light;
        reading.hit_share = (float)cases[i].share;
        reading.back_share = (float)cases[i].back;
        r.lit_backs = cases[i].backs;
        spec.bounced = cases[i].bounced;
        CHECK(sbl__places_is_inside(&r, &reading) == cases[i].inside, "case %d is wrong", i);
    }
}

/* References of a stored store lead to leaves and cuts that exist, and from a cut only to later cuts. */
TEST(cuts_lead_on) {
    sbl__store store;
    memset(&store, 0, sizeof store);
    store.leaf_count = 3;
    store.cut_count = 3;
    CHECK(sbl__saved_leads(&store, 0, -1) && sbl__saved_leads(&store, 3, 2) && !sbl__saved_leads(&store, 4, -1),
          "leaf 3 of 3 is the last");
    CHECK(sbl__saved_leads(&store, SBL__CELL_CUT, -1) && sbl__saved_leads(&store, SBL__CELL_CUT | 2, -1) &&
              !sbl__saved_leads(&store, SBL__CELL_CUT | 3, -1), "cut 2 of 3 is the last");
    CHECK(sbl__saved_leads(&store, SBL__CELL_CUT | 2, 1) && !sbl__saved_leads(&store, SBL__CELL_CUT | 1, 1) &&
              !sbl__saved_leads(&store, SBL__CELL_CUT, 1), "a cut leads to itself or to an earlier cut");
}

/* The bright cells of a saved store must be in ascending order. */
TEST(bright_cells_are_in_order) {
    static const int orders[4][3] = { { 0, 1, 2 }, { 1, 0, 2 }, { 0, 2, 1 }, { 0, 1, 1 } };
    static const sbl__bright_cell cells[3] = {
        { 0, { 1, 9, 9 } }, { 0, { 2, 0, 0 } }, { SBL__PATCH_BACK, { 0, 0, 0 } } };
    sbl__bright_cell bright[3];
    sbl__store store;
    int i, k;
    memset(&store, 0, sizeof store);
    store.length = 1;
    store.bright = bright;
    store.bright_count = 3;
    for (i = 0; i < 4; i++) {
        for (k = 0; k < 3; k++) bright[k] = cells[orders[i][k]];
        CHECK(sbl__saved_valid(&store, 0) == (i == 0), "order %d", i);
    }
}

/* A lamp belongs to the light group of its material, of the sky, or of its light; a glow to none. */
TEST(lamps_have_the_group_of_their_source) {
    static const uint32_t kinds[5] = { SBL__LAMP_TRIANGLE, SBL__LAMP_LOCAL_LIGHT, SBL__LAMP_DISTANT_LIGHT,
                                       SBL__LAMP_SKY_TEXEL, SBL__LAMP_GLOW };
    static const uint32_t expected[5] = { 7, 3, 3, 5, 0 };
    static sbl__lamp_trees l;
    static sbl__lamps lamps;
    sbl_light lights[2];
    sbl__geometry g;
    sbl__hierarchy h;
    sbl__environment e;
    sbl__object objects[2];
    sbl__vertex vertices[3];
    uint32_t indices[6] = { 0, 0, 0, 1, 1, 1 }, order[2] = { 0, 1 };
    int i;
    memset(&g, 0, sizeof g);
    memset(&h, 0, sizeof h);
    memset(&e, 0, sizeof e);
    memset(lights, 0, sizeof lights);
    memset(objects, 0, sizeof objects);
    memset(vertices, 0, sizeof vertices);
    g.indices = indices;
    g.vertices = vertices;
    g.objects = objects;
    h.order = order;
    vertices[1].object = 1;
    objects[1].layer = 7;
    lights[1].light_group = 3;
    e.layer = 5;
    lamps.lights = lights;
    l.geometry = &g;
    l.hierarchy = &h;
    l.environment = &e;
    l.lamps = &lamps;
    for (i = 0; i < 5; i++)
        CHECK(sbl__lamp_layer(&l, kinds[i] << SBL__LAMP_KIND_SHIFT | 1) == expected[i], "lamp %d is in group %u", i,
              sbl__lamp_layer(&l, kinds[i] << SBL__LAMP_KIND_SHIFT | 1));
}

static void SBL__GLAPI no_wait(void) {}
static unsigned SBL__GLAPI no_gl_error(void) { return SBL__GL_NO_ERROR; }

/* The estimated cost of work rises at once. It falls by a tenth of the difference, or by half of it if it was far too
   high. */
TEST(costs_fall_slowly) {
    static const double costs[4][2] = { { 0, 1 }, { 0.5, 1 }, { 2, 1.9 }, { 10, 5.5 } };  /* before, after */
    static sbl__device d;
    int i;
    d.base = &base;
    d.gl.base = &base;
    d.gl.Finish = no_wait;
    d.gl.GetError = no_gl_error;
    for (i = 0; i < 4; i++) {
        sbl__pace p;
        p.cost = costs[i][0];
        p.start = sbl__now() - 1000;
        CHECK(sbl__pace_end(&d, &p, 1000) == SBL_SUCCESS && fabs(p.cost - costs[i][1]) < 0.02, "from %g to %g, not %g",
              costs[i][0], p.cost, costs[i][1]);
    }
}

/* The extent of a scene is its diagonal plus the largest distance from 0 along an axis, in coordinates of the library
   and of the host. Geometry that the host draws counts. A scene without size has the extent 1. */
TEST(extents_are_measured) {
    static const float drawn[2][3] = { { -20, 0, 0 }, { 1, 1, 1 } };
    sbl__geometry g;
    sbl__vertex vertices[3];
    uint32_t indices[3] = { 0, 1, 2 };
    memset(&g, 0, sizeof g);
    memset(vertices, 0, sizeof vertices);
    sbl__geometry_measure(&g, NULL);
    CHECK(fabs((double)g.extent - 1) < 1e-6 && fabs((double)g.hosts_extent - 1) < 1e-6, "nothing has the extent %g",
          (double)g.extent);
    g.vertices = vertices;
    g.indices = indices;
    g.triangle_count = 1;
    g.centre[1] = 50;
    vertices[0].position[0] = -10;
    vertices[1].position[0] = 2;
    vertices[2].position[1] = 5;
    sbl__geometry_measure(&g, NULL);
    CHECK(fabs(g.diagonal - 13) < 1e-6 && fabs(g.farthest - 10) < 1e-6 && fabs((double)g.extent - 23) < 1e-5 &&
              fabs((double)g.hosts_extent - 68) < 1e-5, "diagonal %g, farthest %g, of the host %g", g.diagonal,
          g.farthest, (double)g.hosts_extent);
    sbl__geometry_measure(&g, drawn);
    CHECK(fabs(g.farthest - 20) < 1e-6 && fabs(g.diagonal - sqrt(22 * 22 + 26)) < 1e-6, "drawn: diagonal %g, farthest "
          "%g", g.diagonal, g.farthest);
}

/* Three of the four corners of a tile have light of 3, 6 and 9 with variances of 8, 12 and 16. The tile has their
   means, relative to a mean of 2, and 4/9 of the noise. Its ten pixels that count add them to the sums of the
   picture. */
TEST(tiles_have_the_mean_of_their_corners) {
    enum { SIDE = 5 };
    static sbl__pixel pixels[SIDE * SIDE];
    static sbl__sensor sensors[SIDE * SIDE];
    static const int corners[4] = { 0, 4, 20, 24 };
    sbl__sensor *block = sensors;
    sbl__refine r;
    sbl__tile tile;
    int i, k;
    small_refine(&r, pixels, &block, SIDE);
    memset(&tile, 0, sizeof tile);
    r.luminance = 2;
    r.smoothing = 1;
    r.shown2 = 0.25f;
    tile.parent = -1;
    tile.area.x[1] = tile.area.y[1] = 4;
    tile.counted = 10;
    tile.weight2 = 0.5f;
    for (i = 0; i < 4; i++) {
        sbl__sensor *s = &sensors[corners[i]];
        pixels[corners[i]].sensor = (uint32_t)corners[i];
        s->sensed = 1;
        s->looks = 1;
        s->invalid = i == 3;
        s->variance = (float)(8 + 4 * i);
        for (k = 0; k < 3; k++) s->radiance[k] = (float)(3 + 3 * i);
    }
    sbl__tile_noise(&r, &tile);
    CHECK(fabs((double)tile.variance - 3) < 1e-5 && fabs((double)tile.noise2 - 4 / 3.0) < 1e-5 &&
              fabs((double)tile.light - 6) < 1e-5, "variance %g, noise %g, light %g", (double)tile.variance,
          (double)tile.noise2, (double)tile.light);
    CHECK(fabs(r.sum[0] - 60) < 1e-4 && fabs(r.sum[2] - 60) < 1e-4 && fabs(r.pixels_summed - 10) < 1e-6 &&
              fabs(r.look_variance - 60) < 1e-4 && fabs(r.shown_sum - 60 * sqrt(0.5)) < 1e-4,
          "the sums are %g, %g and %g", r.sum[0], r.look_variance, r.shown_sum);
}

/* A flat box at a distance gets a thickness: at least 1e-4 of its longest side and 1e-6 of its distance, which floats
   can resolve. */
TEST(flat_boxes_are_thick_enough) {
    static const double expected[3] = { 1e-3, 1e-5, 1e-3 };
    static sbl__bvh_building building;
    static sbl__hierarchy h;
    uint32_t children[2][4];
    sbl__grid_node grid;
    sbl__box box = { { 0, 10, 5 }, { 0.001f, 10, 5.001f } };
    int k;
    building.children = children;
    h.building = &building;
    grid = sbl__bvh_add_grid(&h, &box, 3);
    CHECK(grid.root == 1 && grid.outer == 3 && h.node_count == 1, "root %u, outer %u", grid.root, grid.outer);
    for (k = 0; k < 3; k++) {
        const double size = 65533 / (double)grid.per_length[k];
        CHECK(fabs(size / expected[k] - 1) < 1e-3, "axis %d: the box has the size %g", k, size);
    }
}

/* A glimpse has large tiles, an error of its own, and no threshold. The picture's descriptor stays. */
TEST(glimpses_are_coarse) {
    static sbl__core core;
    static sbl__map m;
    m.work.core = &core;
    m.desc.tile = 2;
    m.desc.threshold = 0.5f;
    m.desc.target_error = 0.01f;
    sbl__map_begin_glimpse(&m);
    CHECK(m.refine.tile_size == SBL__GLIMPSE_TILE && !(m.refine.threshold > 0) &&
              fabs((double)m.refine.target_error - (double)SBL__GLIMPSE_ERROR) < 1e-9, "tile %d, threshold %g, error "
          "%g", m.refine.tile_size, (double)m.refine.threshold, (double)m.refine.target_error);
    CHECK(m.desc.tile == 2 && m.desc.threshold > 0 && m.glimpse == SBL__GLIMPSE_UNDER_WAY, "the picture changes");
}

/* Reflections are traced with all their rays, without a limit of length and without a threshold. They have a price of
   their own. */
TEST(reflections_have_their_own_options) {
    static sbl__core core;
    static sbl__map m;
    static sbl__reflections f;
    core.base = base;
    core.device.base = &core.base;
    m.work.core = &core;
    m.desc.width = m.desc.height = 1;
    m.desc.target_error = 0.05f;
    m.desc.threshold = 0.5f;
    m.desc.look_rays = 8;
    m.desc.price = 1;
    m.desc.specular_price = 2;
    m.desc.options.mode = m.work.measurement.options.mode = SBL_MODE_DIRECT;
    m.desc.measure_work = 1;
    m.work.measurement.looks = 3;  /* a restart has reduced the number of looks from 12 */
    m.work.measurement.look_rays = 4 * sbl__look_rays(m.desc.target_error);
    m.work.measurement.options.backend = SBL_BACKEND_RASTER;
    m.work.measurement.options.ray_length = 3;
    REQUIRE(sbl__reflections_begin(&f, &m) == SBL_SUCCESS, "no memory");
    CHECK(f.measurement.looks == 12, "%d looks of lobes", f.measurement.looks);
    CHECK(f.spec.traced && f.spec.lobe && !f.spec.no_light && f.spec.rays == SBL__REFLECTIONS_RAYS &&
              !(f.spec.ray_length > 0), "%d rays of the length %g", f.spec.rays, (double)f.spec.ray_length);
    CHECK(fabs((double)f.refine.price - 2) < 1e-6 && !(f.refine.threshold > 0) && !f.refine.look_rays,
          "price %g, threshold %g", (double)f.refine.price, (double)f.refine.threshold);
    m.refine.luminance = f.refine.luminance = 2;  /* with shown2, errors were relative to 4 */
    m.refine.shown2 = 4;
    m.refine.predicted = 0.1;
    core.stats.picture.price = 3;
    memset(f.refine.pixels, 0, sizeof *f.refine.pixels);  /* the pixel has sensor 0 */
    f.refine.sensors[0][0].work = 8 * (float)sbl__look_rays(m.desc.target_error);
    sbl__reflections_end(&f, &m);
    CHECK(fabs((double)core.stats.picture.radiance_error - 0.2) < 1e-6 &&
              fabs((double)core.stats.picture.price - 12) < 1e-6, "error of R %g, price %g",
          (double)core.stats.picture.radiance_error, (double)core.stats.picture.price);
    CHECK(fabs((double)m.lobe_work[0] - 2 * SBL__REFLECTIONS_RAYS) < 1e-4, "the work of a lobe is %g",
          (double)m.lobe_work[0]);
    sbl__free(&core.base, m.errors);
    sbl__free(&core.base, m.lobe_work);
    CHECK(core.base.memory.host_bytes == 0, "memory is left");
}

/* The fewer cells a lobe sees, the less certain its light is. A lobe sees 8 alpha^2 times as many cells as R depends
   on, but at least a tenth. R stands for the light in rough lobes only. */
TEST(sharp_lobes_see_few_cells) {
    static const double roughness[4] = { 0.2, 0.4, 0.5, 1 };
    static sbl__reflections f;
    static sbl__map m;
    sbl__sensor sensor, *block = &sensor;
    sbl__pixel pixels[2];
    sbl__pixel_lobe lobe;
    sbl__spec spec;
    float lobe_of[4] = { 0 }, none[4] = { 0 }, layers[1] = { 0 };
    sbl__leaf leaf;
    float specular[4] = { 1, 1, 1, 0 }, radiance[4] = { 3, 3, 3, 1 };
    const float *const from[SBL__READS] = { lobe_of, specular, none, radiance };
    int i;
    memset(&sensor, 0, sizeof sensor);
    memset(pixels, 0, sizeof pixels);
    memset(&spec, 0, sizeof spec);
    spec.bounced = 1;
    leaf.light[0] = leaf.light[1] = leaf.light[2] = 2;
    sbl__leaf_set_uncertainty(&leaf, 0.125);
    pixels[0].id = 1;
    m.refine.pixels = pixels;
    m.refine.spec = &spec;
    f.refine.pixels = pixels + 1;
    f.refine.spec = &f.spec;
    f.refine.lobes = &lobe;
    f.refine.layers = layers;
    m.refine.sensors = f.refine.sensors = &block;
    m.refine.width = f.refine.width = 1;
    m.refine.stored_light = leaf.light;
    for (i = 0; i < 4; i++) {
        const double cells = fmax(8 * pow(roughness[i], 4), 0.1);
        lobe_of[1] = (float)((SBL__LOBE_STEPS + 1) * floor(SBL__LOBE_STEPS * roughness[i] + 0.5));
        REQUIRE(sbl__reflections_put(&f, &m, 0, from) == SBL_SUCCESS, "no memory");
        CHECK(fabs((double)lobe.fixed_error / 0.25 * sqrt(fmin(cells, 1)) - 1) < 0.01,
              "roughness %g: the error is %g", roughness[i], (double)lobe.fixed_error);
        CHECK(fabs((double)lobe.light - (i ? 3 : 0)) < 1e-5, "roughness %g: light of %g", roughness[i],
              (double)lobe.light);
    }
}

/* The end of a refinement frees the job of traced rays, and keeps that of views, whose weights take long to compute. */
TEST(jobs_of_views_are_kept) {
    static sbl__core core;
    sbl__refine r;
    sbl__spec spec;
    memset(&r, 0, sizeof r);
    memset(&spec, 0, sizeof spec);
    core.base = base;
    core.device.base = &core.base;
    r.core = &core;
    r.spec = &spec;
    core.job.looks = (sbl__look *)sbl__alloc(&core.base, 1, sizeof(sbl__look));
    CHECK(sbl__refine_end(&r) == SBL_SUCCESS && core.job.looks, "the job of views is freed");
    spec.traced = 1;
    CHECK(sbl__refine_end(&r) == SBL_SUCCESS && !core.job.looks && core.base.memory.host_bytes == 0,
          "the job of rays is kept");
}

/* One channel is grey, two are grey and alpha, three have no alpha. Rows may be apart. */
TEST(pixels_of_all_kinds_are_read) {
    enum { SIDE = 2, PIXEL = 4, ROW = 10 };
    static const int from[4][4] = {  /* -1: unchanged */
        { 0, 0, 0, -1 }, { 0, 0, 0, 1 }, { 0, 1, 2, -1 }, { 0, 1, 2, 3 }
    };
    unsigned char bytes[SIDE * ROW];
    float floats[SIDE * ROW];
    sbl_texture t;
    int i, channels, k, wide;
    for (i = 0; i < SIDE * ROW; i++) {
        bytes[i] = (unsigned char)(10 * i);
        floats[i] = (float)(2 * i);
    }
    memset(&t, 0, sizeof t);
    t.width = t.height = SIDE;
    for (i = 0; i < 16; i++) {  /* bytes, floats; rows without and with a gap; 1 to 4 channels */
        channels = i / 4 + 1;
        wide = i >> 1 & 1;
        t.channels = channels;
        t.pixels = i & 1 ? (const void *)floats : (const void *)bytes;
        t.format = i & 1 ? SBL_PIXELS_FLOAT : SBL_PIXELS_SRGB8;
        t.stride = (size_t)(wide ? ROW : 0) * (i & 1 ? 4 : 1);
        for (k = 0; k < PIXEL; k++) {
            float c[4] = { -9, -9, -9, -9 };
            const int first = (wide ? ROW : SIDE * channels) + channels, source = from[channels - 1][k];
            const double expected = source < 0 ? -9 : (i & 1 ? 2.0 : 10 / 255.0) * (first + source);
            sbl__read_pixel(&t, 1, 1, c);
            CHECK(fabs((double)c[k] - expected) < 1e-5, "case %d, component %d is %g", i, k, (double)c[k]);
        }
    }
}

/* The axes of a sky form a right-handed frame whose second axis points up. The middle of the sky picture lies in the
   direction of the first axis, and the middle of its right half in the direction of the third axis. Without a rotation,
   the frame is turned by the smallest angle that makes the second axis point up. */
TEST(skies_are_turned) {
    static const float ups[5][3] = { { 0, 0, 0 }, { 0, 1, 0 }, { 2, 1, -2 }, { -0.3f, -3, 0.4f }, { 0, -1, 0 } };
    int i, k;
    for (i = 0; i < 10; i++) {
        sbl_environment desc;
        sbl__environment e;
        double up[3], cross[3], axes[3][3], way[3], off = 0;
        memset(&desc, 0, sizeof desc);
        memset(&e, 0, sizeof e);
        memcpy(desc.up, ups[i % 5], sizeof desc.up);
        desc.rotation = i < 5 ? 0 : 90.0f;
        sbl__environment_axes(&e, &desc);
        for (k = 0; k < 9; k++) axes[k / 3][k % 3] = (double)e.axes[k / 3][k % 3];
        for (k = 0; k < 3; k++) up[k] = i % 5 ? (double)desc.up[k] : k == 1;
        sbl__normalize(up);
        sbl__cross(axes[0], axes[1], cross);
        for (k = 0; k < 3; k++) off += fabs(axes[1][k] - up[k]) + fabs(cross[k] - axes[2][k]);
        CHECK(off < 1e-5, "sky %d: the axes are off by %g", i, off);
        /* the trace of the rotation to `up`, followed by that about `up`: (1 + up.y) (1 + cos(rotation)) - 1 */
        off = fabs(axes[0][0] + axes[1][1] + axes[2][2] - (i < 5 ? 1 + 2 * up[1] : up[1]));
        CHECK(off < 1e-5, "sky %d: the trace is off by %g", i, off);
        e.width = 4;
        e.height = 3;
        sbl__environment_direction(&e, 2, 1, way);  /* an eighth behind the middle, on the horizon */
        off = 0;
        for (k = 0; k < 3; k++) off += fabs(way[k] - sqrt(0.5) * (axes[0][k] + axes[2][k]));
        CHECK(off < 1e-5, "sky %d: the direction is off by %g", i, off);
    }
}

/* The bins of worth follow each other without gaps. */
TEST(bins_of_worth_are_in_order) {
    int bin;
    for (bin = 1; bin + 1 < SBL__GAIN_BINS; bin++) {
        const float low = sbl__bin_worth(bin), high = sbl__bin_worth(bin + 1);
        if (!(low > 1e-37f) || !(high < 1e37f)) continue;
        CHECK(high > low && high < 1.3f * low && sbl__worth_bin(low) == bin && sbl__worth_bin(0.999f * high) == bin &&
                  sbl__worth_bin(high) == bin + 1, "bin %d: %g to %g", bin, (double)low, (double)high);
    }
}

/* A leaf takes more points only from far hits. Black surfaces get all leaves, none, or a quarter. */
TEST(leaves_have_limits) {
    static sbl__bounce b;
    sbl__bounce_leaf state;
    sbl__store store;
    sbl__hit at;
    memset(&state, 0, sizeof state);
    memset(&store, 0, sizeof store);
    memset(&at, 0, sizeof at);
    b.states = &state;
    b.store = &store;
    state.most = 4 * SBL__BOUNCE_POINTS;
    store.length = 0.5f;
    store.max_leaves = 1000;
    at.distance = 0.49f * (float)SBL__BOUNCE_LONG;
    CHECK(sbl__points_most(&b, &at, 0) == SBL__BOUNCE_POINTS, "the hit of a short ray becomes a further point");
    at.distance = 0.51f * (float)SBL__BOUNCE_LONG;
    CHECK(sbl__points_most(&b, &at, 0) == 4 * SBL__BOUNCE_POINTS, "a far hit becomes no further point");
    b.black = SBL__BLACK_EQUAL;
    CHECK(sbl__cells_black_most(&b) == 1000, "%d leaves may be black", sbl__cells_black_most(&b));
    b.black = SBL__BLACK_LEFT_OUT;
    CHECK(sbl__cells_black_most(&b) == 0, "%d leaves may be black", sbl__cells_black_most(&b));
    b.black = SBL__BLACK_JOINED;
    CHECK(sbl__cells_black_most(&b) == 250, "%d leaves may be black", sbl__cells_black_most(&b));
}

/* The number of cells that a picture asks for counts if the driver's textures have room for them. Without it, the
   number for which the present light was made counts, or else that for which light will be made. */
TEST(pictures_choose_the_number_of_cells) {
    sbl__store store;
    int cells = 0;
    memset(&store, 0, sizeof store);
    store.scene_leaves = 4000;
    store.max_leaves = 6000;
    store.made_for = 3000;
    store.leaves_fit = 7000;
    CHECK(sbl__bounce_leaves(&store, cells) == 4000, "%d leaves", sbl__bounce_leaves(&store, cells));
    store.ready = 1;
    CHECK(sbl__bounce_leaves(&store, cells) == 3000, "%d leaves", sbl__bounce_leaves(&store, cells));
    cells = -1;
    CHECK(sbl__bounce_leaves(&store, cells) == 3000, "%d leaves", sbl__bounce_leaves(&store, cells));
    cells = 5000;
    CHECK(sbl__bounce_leaves(&store, cells) == 5000, "%d leaves", sbl__bounce_leaves(&store, cells));
    cells = 9000;
    CHECK(sbl__bounce_leaves(&store, cells) == 7000, "%d leaves", sbl__bounce_leaves(&store, cells));
    store.made_for = 9000;  /* a loaded store may have more leaves than a new one */
    CHECK(sbl__bounce_leaves(&store, cells) == 9000, "%d leaves", sbl__bounce_leaves(&store, cells));
}

/* The triangles of a flat mirror are one plane, whose bounds contain both. A matte, a rougher, and a parallel triangle
   do not belong to it. */
TEST(triangles_of_a_mirror_are_one_plane) {
    static const float at[12] = { 0, 0, 0, 4, 0, 0, 4, 3, 0, 0, 5, 0 };
    static sbl__lamp_trees l;
    uint32_t indices[18] = { 0, 1, 2, 0, 2, 3, 4, 5, 6, 8, 9, 10, 12, 13, 14, 16, 17, 18 };
    sbl__vertex vertices[20];
    sbl__object objects[5];
    sbl__geometry g;
    int i, k;
    memset(vertices, 0, sizeof vertices);
    memset(objects, 0, sizeof objects);
    memset(&g, 0, sizeof g);
    g.vertices = vertices;
    g.indices = indices;
    g.objects = objects;
    g.triangle_count = 6;
    g.extent = 5;
    l.geometry = &g;
    for (i = 0; i < 20; i++) {
        memcpy(vertices[i].position, at + 3 * (i % 4), 12);
        vertices[i].object = (uint32_t)i / 4;
        if (i >= 12) vertices[i].position[2] = 1;
    }
    for (i = 0; i < 5; i++) {
        objects[i].reflectance = i == 1 ? -1 : 0.5f;
        objects[i].roughness = i == 4 ? 0.55f : i == 2 ? 0.45f : 0.2f;
        for (k = 0; k < 3; k++) objects[i].albedo[k] = 0.5f;
    }
    for (i = 0; i < 6; i++) CHECK(sbl__planes_add(&l, i) == SBL_SUCCESS, "triangle %d", i);
    REQUIRE(l.plane_count == 3, "%d planes", l.plane_count);
    CHECK(fabs(l.planes[0].own - 8) < 1e-5 && fabs(l.planes[0].weight - 8) < 1e-5, "the mirror reflects %g",
          l.planes[0].own);
    for (k = 0; k < 2; k++)
        CHECK(fabs((double)l.planes[0].bounds.low[k]) < 1e-6 &&
                  fabs((double)l.planes[0].bounds.high[k] - (k ? 5 : 4)) < 1e-6, "axis %d: from %g to %g", k,
              (double)l.planes[0].bounds.low[k], (double)l.planes[0].bounds.high[k]);
    CHECK(fabs(l.planes[2].offset - 1) < 1e-6 && fabs(l.planes[1].own - 3) < 1e-5, "other planes: %g, %g",
          l.planes[2].offset, l.planes[1].own);
    for (l.plane_count = 0; l.plane_count < SBL__PLANES; l.plane_count++) {
        l.planes[l.plane_count].reflectance[0] = 1;
        l.planes[l.plane_count].weight = l.plane_count == 5 ? 7 : 8;
    }
    CHECK(sbl__planes_add(&l, 0) == SBL_SUCCESS && l.plane_count == SBL__PLANES, "%d planes", l.plane_count);
    CHECK(fabs(l.planes[5].own - 3) < 1e-5 && fabs(l.planes[5].weight - 10) < 1e-5, "a new mirror reflects %g, its "
          "weight is %g", l.planes[5].own, l.planes[5].weight);
}

/* The cluster of lamps with the largest product of power and radius is divided, until there are four. */
TEST(large_clusters_of_lamps_are_divided) {
    enum { NODES = 9 };
    static const struct { float radius, power; uint32_t beyond; } tree[NODES] = { { 10, 5, 9 }, { 4, 3.5f, 6 },
        { 3, 1.9f, 5 }, { 0.1f, 1, 4 }, { 0.1f, 0.9f, 5 }, { 0.1f, 0.1f, 6 }, { 5, 3, 9 }, { 0.1f, 2, 8 },
        { 0.1f, 1, 9 } };
    static const int expected[4] = { 2, 7, 8, 5 };
    static sbl__lamp_trees l;
    sbl__lamp_node nodes[NODES];
    int found[SBL__MIRRORED_CLUSTERS], count, i;
    memset(nodes, 0, sizeof nodes);
    for (i = 0; i < NODES; i++) {
        nodes[i].radius = tree[i].radius;
        nodes[i].power = tree[i].power;
        nodes[i].beyond = tree[i].beyond;
    }
    l.nodes = nodes;
    l.node_count = NODES;
    count = sbl__mirrored_clusters(&l, found);
    REQUIRE(count == 4, "%d clusters", count);
    for (i = 0; i < 4; i++) CHECK(found[i] == expected[i], "cluster %d is node %d, not %d", i, found[i], expected[i]);
}

/* The light groups of a leaf add up to its light, even if it is bright; none is negative. Light that no group has
   caused goes to the first group. */
TEST(groups_of_a_leaf_add_up) {
    static sbl__bounce b;
    static sbl__core core;
    static const float expected[6] = { 2, 4, 0, 6, 0, 0 };
    float layers[6] = { 1, 0, 0, 3, 0, -5 };
    sbl__leaf leaf = { { -8, 4, 0 }, 0 };
    sbl__store store;
    int k;
    memset(&store, 0, sizeof store);
    core.scene.light_groups = 2;
    b.core = &core;
    b.store = &store;
    store.leaves = &leaf;
    store.layers = layers;
    sbl__solution_layers_scale(&b, 0);
    for (k = 0; k < 6; k++)
        CHECK(fabs((double)layers[k] - (double)expected[k]) < 1e-5, "group %d, channel %d: %g", k / 3, k % 3,
              (double)layers[k]);
}

/* Progress counts finished batches of probes, in the current batch both kinds of sites, and the finished layers of a
   map that is joined. */
TEST(batches_are_progress) {
    static sbl__probes p;
    static sbl__joining j;
    int kind, stage;
    p.work.front_end = &sbl__probes_front_end;
    p.desc.probe_count = 100;
    p.desc.options.rays = 60;
    p.first = 40;
    p.taken = p.count = 20;
    p.latitudes = 2;
    p.around = 6;
    for (kind = SBL__PROBE_HEMISPHERES; kind <= SBL__PROBE_RAYS; kind++) {
        p.kind = kind;
        p.from = (kind == SBL__PROBE_RAYS ? 60 : 2 * 6 + 6) * 20 / 2;
        CHECK(fabs((double)sbl__probes_progress(&p) - (kind == SBL__PROBE_RAYS ? 0.55 : 0.45)) < 1e-6,
              "sites of kind %d: %g", kind, (double)sbl__probes_progress(&p));
    }
    p.round = 1;
    CHECK(fabs((double)sbl__probes_progress(&p) - 0.6) < 1e-6, "moved probes: %g", (double)sbl__probes_progress(&p));
    j.work.front_end = &sbl__windows_front_end;
    j.desc.lightmap.directional = 1;
    for (stage = 0; stage < SBL__JOINING_DONE; stage++) {
        j.work.stages.stage = stage;
        j.layer = stage % SBL__LAYERS;
        CHECK(fabs((double)sbl__joining_progress(&j) * SBL__LAYERS - j.layer - (double)stage / SBL__JOINING_DONE) <
                  1e-5, "stage %d of layer %d: %g", stage, j.layer, (double)sbl__joining_progress(&j));
    }
}

/* The first 4^n points of a triangle lie in 4^n equal triangles that divide it, one point in each. */
TEST(points_fill_triangles_evenly) {
    static unsigned char found[64][64];
    int n, k, twice = 0, outside = 0;
    for (n = 1; n <= 4; n++) {
        const int across = 1 << n;
        memset(found, 0, sizeof found);
        for (k = 0; k < 1 << 2 * n; k++) {
            double weights[3];
            int x, y, z;
            sbl__vertices_point(k, weights);
            outside += !(weights[0] > 0 && weights[1] > 0 && weights[2] > 0);
            x = (int)(weights[0] * across);
            y = (int)(weights[1] * across);
            z = (int)(weights[2] * across);
            outside += x < 0 || y < 0 || x + y + z != across - 1 - (x + y + z == across - 2);
            if (x >= 0 && y >= 0 && x < 32 && y < 64) twice += found[2 * x + (x + y + z == across - 2)][y]++;
        }
    }
    CHECK(!outside && !twice, "%d points are outside, %d share a triangle", outside, twice);
}

/* In the air, each direction has the mean light of its valid sites. */
TEST(air_has_the_mean_of_valid_sites) {
    static sbl__bounce b;
    static sbl_reading readings[SBL__AIR_SITES];
    sbl__store store;
    int i;
    memset(&store, 0, sizeof store);
    b.store = &store;
    b.readings = readings;
    for (i = 0; i < SBL__AIR_SITES; i++) {
        readings[i].valid = i % 6 != 4 && (i % 6 != 1 || i < 12);  /* two valid sites face -x; none faces +z */
        readings[i].radiance[1] = (float)(i / 6 + i % 6);
    }
    CHECK(sbl__bounce_after_air(&b) == SBL__BOUNCE_DONE, "the work goes on");
    for (i = 0; i < 6; i++) {
        const double expected = i == 4 ? 0 : i + (i == 1 ? 0.5 : 0.5 * (SBL__AIR_SITES / 6 - 1));
        CHECK(fabs((double)store.air[i][1] - expected) < 1e-5, "side %d has %g, expected %g", i,
              (double)store.air[i][1], expected);
    }
}

/* The light groups of the two sides of a triangle are those of two leaves. */
TEST(sides_have_their_own_groups) {
    static const float layers[4] = { 1, 2, 5, 0 }, inside[3] = { 0.5f, 0.5f, 0.5f }, outside[3] = { 9.5f, 0.5f, 0.5f };
    static sbl__cell_bucket cells[128];
    uint32_t patches[1] = { 0 };
    sbl__store store;
    int back;
    memset(&store, 0, sizeof store);
    store.patches = patches;
    store.cells = cells;
    store.cell_capacity = 128;
    store.layers = (float *)(uintptr_t)layers;
    store.leaf_count = 2;
    store.length = 1;
    *sbl__store_bucket(&store, 0, inside) = 1;
    *sbl__store_bucket(&store, SBL__PATCH_BACK, inside) = 2;
    for (back = 0; back < 2; back++) {
        float sum[2] = { 10, 20 };
        CHECK(sbl__stored_layers_add(&store, 0, back, outside, 2, sum) == 0 && fabs((double)sum[0] - 10) < 1e-6,
              "light where there is no leaf");
        CHECK(sbl__stored_layers_add(&store, 0, back, inside, 2, sum) == 1 &&
                  fabs((double)sum[0] - (back ? 15 : 11)) + fabs((double)sum[1] - (back ? 20 : 22)) < 1e-5,
              "side %d adds %g and %g", back, (double)sum[0] - 10, (double)sum[1] - 20);
    }
}

static double random_unit(uint32_t *seed) { return test_hash(++*seed) / 4294967296.0; }

/* Random pairs of numbers are joined. The test labels each number with the least number of its group; each join gives
   both groups the smaller label. The root of each number must be its label. */
TEST(random_groups_have_their_least_number) {
    enum { COUNT = 60 };
    uint32_t parents[COUNT], labels[COUNT], seed = 0, i, k, wrong = 0;
    for (i = 0; i < COUNT; i++) parents[i] = labels[i] = i;
    for (k = 0; k < COUNT; k++) {
        const uint32_t one = test_hash(++seed) % COUNT, other = test_hash(++seed) % COUNT;
        const uint32_t low = SBL__MIN(labels[one], labels[other]), high = SBL__MAX(labels[one], labels[other]);
        sbl__join(parents, one, other);
        for (i = 0; i < COUNT; i++) if (labels[i] == high) labels[i] = low;
        for (i = 0; i < COUNT && k % 8 == 7; i++) wrong += sbl__root(parents, i) != labels[i];
    }
    CHECK(!wrong, "%u numbers have a wrong root", wrong);
}

/* The parts of a texel form a square of working pixels. The squares of texels fill the window except its margin. */
TEST(parts_of_texels_are_squares) {
    enum { ACROSS = 3, WIDE = 4, HIGH = 2, LEFT = 5, TOP = 2, WIDTH = LEFT + ACROSS * WIDE + 1 };
    static sbl__map m;
    int texel, i;
    m.across = ACROSS;
    m.size[0] = WIDE;
    m.size[1] = HIGH;
    m.window.inset[0] = LEFT;
    m.window.inset[1] = TOP;
    m.desc.width = WIDTH;
    for (texel = 0; texel < WIDE * HIGH; texel++)
        for (i = 0; i < ACROSS * ACROSS; i++) {
            const int x = LEFT + texel % WIDE * ACROSS + i % ACROSS, y = TOP + texel / WIDE * ACROSS + i / ACROSS;
            CHECK(sbl__lightmap_subtexel(&m, texel, i) == (size_t)(y * WIDTH + x), "part %d of texel %d is pixel %d",
                  i, texel, (int)sbl__lightmap_subtexel(&m, texel, i));
        }
}

/* The remaining time of a picture is that of the rest of the store plus that of the looks. Before the first look, the
   looks are expected to take the typical time. Afterwards, the estimate is the mean of the rest of the typical time and
   the time of the expected looks. */
TEST(the_rest_of_the_time_is_estimated) {
    static sbl__core core;
    static sbl__bounce bounce;
    static sbl__map m;
    sbl__refine *r = &m.refine;
    double filled;
    m.work.core = &core;
    m.desc.width = 40;
    m.desc.height = 10;
    m.work.stages.stage = SBL__MAP_REFINE - 1;
    core.bounce = &bounce;
    bounce.divisions = 1;
    filled = (double)sbl__bounce_progress(&core);
    REQUIRE(filled > (double)SBL__BOUNCE_CAST && filled < 1, "%g of the store are filled", filled);
    CHECK(fabs(sbl__map_seconds_left(&m) - 1e9) < 1, "without rays: %g", sbl__map_seconds_left(&m));
    core.stats.seconds.bounce = 2;
    core.stats.store.rays = 1000;
    /* the square root of 400 pixels is 20; rays take this fraction of the time of the store */
    CHECK(fabs(sbl__map_seconds_left(&m) / (2 * (1 / filled - 1) + SBL__MAP_TYPICAL * 20 *
                                            (2 * (double)SBL__BOUNCE_CAST / filled / 1000)) - 1) < 1e-9,
          "before refinement: %g", sbl__map_seconds_left(&m));
    core.scene.store.ready = 1;
    CHECK(fabs(sbl__map_seconds_left(&m) / (SBL__MAP_TYPICAL * 20 * (double)SBL__BOUNCE_CAST * 2 / 1000) - 1) < 1e-9,
          "with a full store: %g", sbl__map_seconds_left(&m));
    m.work.stages.stage = SBL__MAP_REFINE;
    core.stats.seconds.gather = 7;
    core.stats.seconds.refine = 3;
    m.paced_from[0] = 6;
    m.paced_from[1] = 10;
    r->looks_taken = 30;
    r->expected_looks = 80;
    r->expected_weight = 0.25;
    CHECK(fabs(sbl__map_seconds_left(&m) -
               (0.75 * (SBL__MAP_TYPICAL * 20 * (double)SBL__BOUNCE_CAST * 2 / 1000 - 4 * SBL__MAP_SPENT) +
                0.25 * 50 * 4 / 20)) < 1e-6, "after 20 looks in 4 s: %g", sbl__map_seconds_left(&m));
    core.stats.seconds.bounce = 0;
    CHECK(fabs(sbl__map_seconds_left(&m) - (0.75 * (SBL__MAP_LOOKS * 400 * 4 / 20 - 4 * SBL__MAP_SPENT) +
                                            0.25 * 50 * 4 / 20)) < 1e-6, "without a store: %g",
          sbl__map_seconds_left(&m));
    core.stats.seconds.bounce = 2;
    core.stats.seconds.gather = 1003;
    CHECK(fabs(sbl__map_seconds_left(&m) -
               (0.75 * SBL__MAP_LEAST * SBL__MAP_TYPICAL * 20 * (double)SBL__BOUNCE_CAST * 2 / 1000 +
                0.25 * 50 * 1000 / 20)) < 1e-6, "after 20 looks in 1000 s: %g", sbl__map_seconds_left(&m));
    r->expected_weight = 1;
    r->look_count = 70;
    CHECK(fabs(sbl__refine_looks_expected(r) - 100) < 1e-9, "%g looks are expected", sbl__refine_looks_expected(r));
    r->look_count = 10;
    CHECK(fabs(sbl__refine_looks_expected(r) - 80) < 1e-9, "%g looks are expected", sbl__refine_looks_expected(r));
}

/* Errors of R are relative to the mean of the picture. This is the mean that is known; otherwise that of the last
   weighing; otherwise an estimate. It is never 0. */
TEST(errors_are_relative_to_the_mean) {
    static unsigned char albedos[4];
    sbl__refine r;
    memset(&r, 0, sizeof r);
    r.shown_pixels = 10;
    r.diffuse = 4;
    r.specular = 2;
    CHECK(fabs((double)sbl__weigh_shown2(&r) - 1) < 1e-6, "R alone: %g", (double)sbl__weigh_shown2(&r));
    memcpy(&r.albedos, &(void *){ albedos }, sizeof r.albedos);
    CHECK(fabs((double)sbl__weigh_shown2(&r) - 0.36) < 1e-6, "before weighing: %g", (double)sbl__weigh_shown2(&r));
    r.sum[0] = r.sum[1] = r.sum[2] = 5;
    r.shown_sum = 3.5;
    CHECK(fabs((double)sbl__weigh_shown2(&r) - 0.36) < 1e-6, "not weighed: %g", (double)sbl__weigh_shown2(&r));
    r.weighed = 1;
    CHECK(fabs((double)sbl__weigh_shown2(&r) - 0.81) < 1e-5, "weighed: %g", (double)sbl__weigh_shown2(&r));
    r.sum[0] = 0;
    CHECK(fabs(sqrt((double)sbl__weigh_shown2(&r)) - (3.5 / (5 * (1 - 0.2126)) + 0.2)) < 1e-5, "without red: %g",
          (double)sbl__weigh_shown2(&r));
    r.luminance = 4;
    r.mean_final = 2;
    CHECK(fabs((double)sbl__weigh_shown2(&r) - 0.25) < 1e-6, "a known mean: %g", (double)sbl__weigh_shown2(&r));
    r.mean_final = 1e-9f;
    CHECK(fabs((double)sbl__weigh_shown2(&r) * 1e12 - 1) < 1e-5, "a black picture: %g", (double)sbl__weigh_shown2(&r));
}

/* Returns half the surface area of the box around the bins `from` to `to` of an axis, times the number of the triangles
   in these bins. */
static double cost_of_bins(const sbl__bvh_split *s, int axis, int from, int to) {
    double low[3] = { 1e30, 1e30, 1e30 }, size[3];
    int i, k, count = 0;
    for (k = 0; k < 3; k++) {
        double high = -1e30;
        for (i = from; i < to; i++) {
            if (!s->counts[axis][i]) continue;
            low[k] = SBL__MIN(low[k], (double)s->bins[axis][i].low[k]);
            high = SBL__MAX(high, (double)s->bins[axis][i].high[k]);
        }
        size[k] = high - low[k];
    }
    for (i = from; i < to; i++) count += s->counts[axis][i];
    return count ? count * (size[0] * size[1] + size[1] * size[2] + size[2] * size[0]) : 0;
}

/* The cheapest of all splits between bins is chosen. Splits without triangles on one side, and axes without extent, are
   not considered. */
TEST(the_cheapest_split_is_chosen) {
    static sbl__bvh_building b;
    sbl__bvh_split *s = &b.split;
    uint32_t seed = 0;
    int run, axis, bin, k;
    for (run = 0; run < 200; run++) {
        double best = 1e30;
        const double chosen = run % 4 ? 0.5 : 0.1;  /* fraction of the bins that have triangles */
        int splits = 0, counted[3] = { 0, 0, 0 };
        for (axis = 0; axis < 3; axis++) {
            s->scale[axis] = run % 5 == axis ? 0 : 1;
            for (bin = 0; bin < SBL__BVH_BINS; bin++) {
                s->bins[axis][bin] = sbl__box_empty;
                s->counts[axis][bin] = 0;
                if (bin != SBL__BVH_BINS / 2 && random_unit(&seed) > chosen) continue;
                s->counts[axis][bin] = 1 + (int)(3 * random_unit(&seed));
                counted[axis] += s->counts[axis][bin];
                for (k = 0; k < 3; k++) {
                    s->bins[axis][bin].low[k] = (float)(k == axis ? bin : random_unit(&seed));
                    s->bins[axis][bin].high[k] = s->bins[axis][bin].low[k] + (float)(4 * random_unit(&seed));
                }
            }
        }
        /* The next lines give all axes the same number of triangles. */
        b.task.count = SBL__MAX(counted[0], SBL__MAX(counted[1], counted[2]));
        for (axis = 0; axis < 3; axis++) s->counts[axis][SBL__BVH_BINS / 2] += b.task.count - counted[axis];
        for (axis = 0; axis < 3; axis++)
            for (bin = 1; bin < SBL__BVH_BINS && s->scale[axis] > 0; bin++) {
                double costs[2];
                for (k = 0; k < 2; k++)
                    costs[k] = cost_of_bins(s, axis, k ? bin : 0, k ? SBL__BVH_BINS : bin);
                if (!(costs[0] > 0) || !(costs[1] > 0)) continue;
                splits++;
                best = SBL__MIN(best, costs[0] + costs[1]);
            }
        s->axis = -1;
        CHECK(sbl__bvh_choose(&b) == (splits ? SBL__BVH_MOVE : SBL__BVH_NODE), "run %d: %d splits", run, splits);
        CHECK(splits ? s->axis >= 0 && s->axis < 3 && s->bin >= 0 && s->bin < SBL__BVH_BINS - 1 : s->axis < 0,
              "run %d: axis %d, bin %d", run, s->axis, s->bin);
        if (!splits || s->axis < 0) continue;
        CHECK(s->scale[s->axis] > 0 && (cost_of_bins(s, s->axis, 0, s->bin + 1) +
              cost_of_bins(s, s->axis, s->bin + 1, SBL__BVH_BINS)) / best < 1 + 1e-5, "run %d: the split costs %g, "
              "the cheapest %g", run, cost_of_bins(s, s->axis, 0, s->bin + 1) +
              cost_of_bins(s, s->axis, s->bin + 1, SBL__BVH_BINS), best);
    }
}

/* The bits of the three coordinates of a lamp alternate in its position along the curve. Distant lamps have those of
   their direction. The highest bits separate the kinds. */
TEST(lamps_lie_along_a_curve) {
    enum { POINT, SPOT, GLOW, DISTANT };
    const double most = (1 << SBL__CURVE_BITS) - 1;
    sbl__lamp_trees l;
    uint32_t seed = 0;
    int run, k, bit;
    memset(&l, 0, sizeof l);
    for (run = 0; run < 80; run++) {
        sbl__lamp lamp;
        uint64_t curve, expected = 0;
        const int kind = run % 4;
        memset(&lamp, 0, sizeof lamp);
        l.side = run < 40 ? 8 : 0;
        lamp.cone = kind == SPOT ? 1 : SBL__CONE_MOST;
        lamp.distant = kind == DISTANT;
        lamp.normal[run / 8 % 3] = run & 4 ? -1.0f : 1.0f;
        if (kind == GLOW) lamp.code = (uint32_t)SBL__LAMP_GLOW << SBL__LAMP_KIND_SHIFT;
        for (k = 0; k < 3; k++) {
            const double at = kind == DISTANT ? 2 * random_unit(&seed) - 1 : 9 * random_unit(&seed);
            double fraction;
            uint64_t step;
            l.low[k] = k;
            lamp.bounds.low[k] = (float)(at - 0.25);
            lamp.bounds.high[k] = (float)(at + 0.25);
            fraction = ((double)lamp.bounds.low[k] + (double)lamp.bounds.high[k]) / 2;
            fraction = kind == DISTANT ? (fraction + 2) / 4 : l.side > 0 ? (fraction - k) / 8 : 0;
            step = (uint64_t)(most * (fraction < 0 ? 0 : fraction > 1 ? 1 : fraction));
            for (bit = 0; bit < SBL__CURVE_BITS; bit++) expected += (step >> bit) % 2 << (3 * bit + k);
        }
        if (kind == SPOT) expected = expected / 4 + ((uint64_t)1 << 61) +
            ((uint64_t)(2 * (run / 8 % 3) + (run >> 2 & 1)) << 58);
        if (kind == GLOW) expected += (uint64_t)1 << 62;
        if (kind == DISTANT) expected += (uint64_t)1 << 63;
        curve = sbl__lamp_curve(&l, &lamp);
        CHECK(curve == expected, "run %d: %.0f, expected %.0f", run, (double)curve, (double)expected);
    }
}

/* The uniform part of a guide depends on the fraction of bins that are lit, and not on how much light they have. */
TEST(even_guides_are_uniform) {
    float densities[SBL__GUIDE_BINS];
    int lit, i;
    for (lit = 0; lit <= SBL__GUIDE_BINS; lit++) {
        const double fraction = lit ? (double)lit / SBL__GUIDE_BINS : 1;
        const double even = (fraction - SBL__GUIDE_DARK) / (SBL__GUIDE_LIT - SBL__GUIDE_DARK);
        const double expected = SBL__GUIDE_UNIFORM + (1 - SBL__GUIDE_UNIFORM) * (even < 0 ? 0 : even > 1 ? 1 : even);
        for (i = 0; i < SBL__GUIDE_BINS; i++) densities[i] = i < lit ? (lit % 2 ? 1e-3f : 50.0f) : 0;
        CHECK(fabs(sbl__guide_uniform(densities) - expected) < 1e-5, "%d lit bins: %g, expected %g", lit,
              sbl__guide_uniform(densities), expected);
    }
}

/* The mean of a fraction of the pixels is compared with that of a sorted list, in which each pixel has the length 1. */
TEST(meters_leave_pixels_out) {
    static const double ranges[4][2] = { { 0, 1 }, { 0.05, 0.95 }, { 0.95, 1 }, { 0, 0.3 } };
    static int bins[SBL__METER_BINS];
    uint32_t seed = 0;
    int i, k, n, run;
    CHECK(sbl__meter_mean(bins, 0, 1) == -DBL_MAX, "no pixels have the mean %g", sbl__meter_mean(bins, 0, 1));
    for (run = 0; run < 4; run++) {
        const double *range = ranges[run];
        double sum = 0, weight = 0;
        int all = 0, at = 0;
        for (i = 0; i < SBL__METER_BINS; i += 1 + (int)(300 * random_unit(&seed)))
            all += bins[i] = 1 + (int)(5 * random_unit(&seed));
        for (i = n = 0; i < SBL__METER_BINS; i++) n += bins[i];
        for (all = n, i = 0; i < SBL__METER_BINS; i++)
            for (k = 0; k < bins[i]; k++, at++) {
                const double from = test_max(at, range[0] * all), to = test_min(at + 1, range[1] * all);
                if (to > from) weight += to - from;
                if (to > from) sum += (to - from) * (-64 + SBL__METER_STEP * i + SBL__METER_STEP / 2);
            }
        CHECK(fabs(sbl__meter_mean(bins, range[0], range[1]) - sum / weight) < 1e-9, "run %d: %g, expected %g", run,
              sbl__meter_mean(bins, range[0], range[1]), sum / weight);
    }
}

/* A camera knows its position, and the distances of the scene along its view, with a thousandth of the scene's extent
   added on each side. */
TEST(cameras_enclose_the_scene) {
    static const double eye[3] = { 12, -3, 5 }, centre[3] = { 2, 4, -1 }, to[3] = { 1, 2, 2.5 };
    sbl_picture_desc desc;
    sbl__geometry g;
    sbl__window window;
    sbl__camera c;
    double forward[3], from = 1e30, until = -1e30, off = 0;
    int i, k;
    memset(&desc, 0, sizeof desc);
    memset(&g, 0, sizeof g);
    memset(&window, 0, sizeof window);
    desc.width = window.size[0] = window.whole[0] = 8;
    desc.height = window.size[1] = window.whole[1] = 6;
    desc.facet_limit = -1;
    sbl_perspective(desc.view_to_clip, 60, 8 / 6.0f);
    REQUIRE(sbl_look_at(desc.world_to_view, (float)eye[0], (float)eye[1], (float)eye[2], (float)to[0], (float)to[1],
                        (float)to[2], 0, 1, 0), "no view");
    g.extent = 20;
    for (k = 0; k < 3; k++) {
        g.centre[k] = (float)centre[k];
        g.bounds[0][k] = (float)(-3 - k);
        g.bounds[1][k] = (float)(2 + 2 * k);
        forward[k] = to[k] - eye[k];
    }
    sbl__normalize(forward);
    for (i = 0; i < 8; i++) {
        double along = 0;
        for (k = 0; k < 3; k++) along += forward[k] * ((double)g.bounds[i >> k & 1][k] + centre[k] - eye[k]);
        from = test_min(from, along);
        until = test_max(until, along);
    }
    sbl__camera_make(&c, &desc, &window, &g);
    for (k = 0; k < 3; k++) off += fabs(c.eye[k] + centre[k] - eye[k]);
    CHECK(off < 1e-4, "the eye is off by %g", off);
    CHECK(fabs((double)c.nearest - from + 0.02) < 2e-4 && fabs((double)c.farthest - until - 0.02) < 2e-4,
          "the scene lies from %g to %g, expected %g to %g", (double)c.nearest, (double)c.farthest, from, until);
    CHECK(!c.orthographic && c.facet_limit >= 0, "orthographic %d, limit %g", c.orthographic, (double)c.facet_limit);
}

/* The upper limit of the number of lamps counts lights, triangles of meshes that emit on their front, and bright pixels
   of the sky. */
TEST(lamps_are_limited) {
    enum { MESHES = 3 };
    static float pixels[4 * 6];
    sbl__object objects[MESHES];
    sbl__mesh meshes[MESHES];
    sbl__environment e;
    sbl__geometry g;
    int i;
    memset(objects, 0, sizeof objects);
    memset(meshes, 0, sizeof meshes);
    memset(&e, 0, sizeof e);
    memset(&g, 0, sizeof g);
    g.objects = objects;
    g.meshes = meshes;
    g.mesh_count = MESHES;
    for (i = 0; i < MESHES; i++) meshes[i].triangle_count = 1 + 10 * i;
    objects[1].emission[2] = 0.5f;
    objects[2].emission[0] = 0.5f;
    objects[2].flags = SBL_MATERIAL_ONE_SIDED_EMISSION;
    CHECK(fabs(sbl__lamps_most(&g, &e, 5) - (5 + 11 + 21)) < 1e-9, "%g lamps", sbl__lamps_most(&g, &e, 5));
    e.pixels = pixels;
    e.width = 3;
    e.height = 2;
    e.limit = 7;
    pixels[4 * 5 + 1] = 8;
    pixels[2] = 9;
    pixels[4 + 3] = 10;  /* the fourth float is no light */
    pixels[8] = 7;
    CHECK(fabs(sbl__lamps_most(&g, &e, 5) - (5 + 11 + 21 + 2)) < 1e-9, "%g lamps with a sky",
          sbl__lamps_most(&g, &e, 5));
}

/* Invalid presets get the values of the default, until the checks refuse them. */
TEST(invalid_presets_are_the_default) {
    int preset;
    for (preset = -2; preset < SBL_PRESET_COUNT + 2; preset++) {
        sbl_options options;
        memset(&options, 0, sizeof options);
        options.preset = (sbl_preset)preset;
        CHECK(sbl__preset_of(&options) == (preset < 0 || preset >= SBL_PRESET_COUNT ? SBL_PRESET_DEFAULT : preset),
              "preset %d is %d", preset, sbl__preset_of(&options));
    }
}

/* Positions in a texel fill the part of its square that triangles cover. Only a position close to an edge of its
   triangle moves, and at most by SBL__ATLAS_INSET. */
TEST(positions_fill_texels) {
    static const double corners[2][3][2] = { { { 0, 0 }, { 4, 0 }, { 0, 4 } }, { { 6, 5 }, { 4.5, 0 }, { 6, 0 } } };
    sbl__atlas_square s;
    int i, k, n, none = 0, moved = 0;
    memset(&s, 0, sizeof s);
    s.count = 2;
    for (n = 0; n < 2; n++) {
        const double (*c)[2] = corners[n];
        memcpy(s.triangles[n].corners, c, sizeof corners[n]);
        s.triangles[n].number = 7 + (uint32_t)n;
        s.triangles[n].twice_area = (c[1][0] - c[0][0]) * (c[2][1] - c[0][1]) -
                                    (c[2][0] - c[0][0]) * (c[1][1] - c[0][1]);
    }
    s.low[0] = 1;
    s.low[1] = 0.5;
    s.high[0] = 5.75;
    s.high[1] = 3;
    for (i = 0; i < 3000; i++) {
        double u[2], at[2], weights[3], edge[3], least[2] = { 1e30, 1e30 }, off = 0;
        const uint32_t found = sbl__atlas_locate(&s, i, weights);
        sbl__r2(i, u);
        for (k = 0; k < 2; k++) at[k] = s.low[k] + u[k] * (s.high[k] - s.low[k]);
        for (n = 0; n < 2; n++)
            for (k = 0; k < 3; k++) {
                const double *p = corners[n][k], *q = corners[n][(k + 1) % 3];
                edge[k] = (q[0] - p[0]) * (at[1] - p[1]) - (q[1] - p[1]) * (at[0] - p[0]);
                least[n] = test_min(least[n], s.triangles[n].twice_area < 0 ? -edge[k] : edge[k]);
            }
        n = least[0] >= 0 ? 0 : least[1] >= 0 ? 1 : -1;
        CHECK(found == (n < 0 ? SBL__NONE : 7 + (uint32_t)n), "position %d is in triangle %u", i, found);
        none += n < 0;
        if (n < 0 || found == SBL__NONE) continue;
        for (k = 0; k < 2; k++) {
            const double is = weights[0] * corners[n][0][k] + weights[1] * corners[n][1][k] +
                              weights[2] * corners[n][2][k];
            off += (is - at[k]) * (is - at[k]);
        }
        CHECK(sqrt(off) <= SBL__ATLAS_INSET * 1.000001, "position %d is off by %g", i, sqrt(off));
        moved += off > 1e-20;
        CHECK(!(off > 1e-20) || least[n] < 0.05 * fabs(s.triangles[n].twice_area), "position %d moves", i);
    }
    CHECK(none > 1000 && none < 2000 && moved > 3 && moved < 100, "%d outside, %d moved", none, moved);
}

/* What is freed is zero, so that it can be made again or freed again. */
TEST(what_is_freed_is_zero) {
    static sbl__device d;
#define FREED(type, field, owner, free)                                                                            \
    {                                                                                                              \
        static type x;                                                                                             \
        const unsigned char *bytes = (const unsigned char *)&x;                                                    \
        size_t i, wrong = 0;                                                                                       \
        x.field = 1;                                                                                               \
        free(owner, &x);                                                                                           \
        for (i = 0; i < sizeof x; i++) wrong += bytes[i] != 0;                                                     \
        CHECK(!wrong, #free " leaves %d bytes", (int)wrong);                                                       \
    }
    d.base = &base;
    FREED(sbl__rings, width, &base, sbl__rings_free)
    FREED(sbl__solver, count, &base, sbl__solver_free)
    FREED(sbl__atlas, width, &base, sbl__atlas_free)
    FREED(sbl__fill, row, &base, sbl__fill_free)
    FREED(sbl__gutters, size[0], &base, sbl__gutters_free)
    FREED(sbl__seams, seams, &base, sbl__seams_free)
    FREED(sbl__geometry, mesh_count, &d, sbl__geometry_free)
    FREED(sbl__environment, width, &d, sbl__environment_free)
    FREED(sbl__hierarchy, triangle_count, &d, sbl__hierarchy_free)
    FREED(sbl__lamps, light_count, &d, sbl__lamps_free)
    FREED(sbl__store, max_leaves, &d, sbl__store_free)
    FREED(sbl__guides, columns, &d, sbl__guides_free)
    FREED(sbl__job, look_end, &d, sbl__job_free)
    FREED(sbl__refine, width, &d, sbl__refine_free)
#undef FREED
    CHECK(base.memory.host_bytes == 0 && base.memory.gpu_bytes == 0, "memory is counted");
}

/* A host that sets the number of rays gets every ray, even if it sets 1. */
TEST(given_rays_are_all_traced) {
    static sbl__core core;
    sbl_readings_desc d;
    sbl__measurement m;
    int rays;
    memset(&d, 0, sizeof d);
    for (rays = 0; rays < 3; rays++) {
        d.options.rays = rays;
        sbl__gathering_check(&core, &d, &m);
        CHECK(m.every_ray == (rays > 0), "%d rays: every_ray is %d", rays, m.every_ray);
    }
    sbl__gathering_check(&core, NULL, &m);
    CHECK(!m.every_ray, "every ray is traced by default");
}

/* Each job of a gathering writes to the readings and groups of its own sites. */
TEST(jobs_have_their_own_readings) {
    static sbl__core core;
    static sbl__gathering g;
    sbl_reading readings[5];
    float groups[5 * 3 * 2];
    core.scene.light_groups = 2;
    g.work.core = &core;
    g.desc.readings = readings;
    g.desc.groups = groups;
    g.desc.site_count = 5;
    g.first = 3;
    CHECK(sbl__gathering_next_job(&g) == SBL__GATHER_SITES && g.work.task.readings == readings + 3 &&
              g.work.task.layers == groups + 3 * 3 * 2 && g.work.task.site_count == 2, "%d sites",
          g.work.task.site_count);
    g.first = 5;
    CHECK(sbl__gathering_next_job(&g) == SBL__GATHER_DONE, "there is no end");
}

/* The host draws a view of the second look of a batch, the 12th of the job, into the slot of this look. In the space of
   the view, the sensor is at 0 0 0, and what is in front of it has a negative z. */
TEST(drawn_views_belong_to_a_look) {
    static sbl__scene scene;
    static sbl__raster r;
    static sbl__spec spec;
    sbl__look looks[2];
    sbl__sheets sheets;
    sbl__batch b;
    sbl_draw_view v;
    double right[3], up[3], forward[3], origin[3], ahead[3];
    int i, k;
    memset(&sheets, 0, sizeof sheets);
    memset(&b, 0, sizeof b);
    memset(looks, 0, sizeof looks);
    sbl__layout_make(&sheets.layout, 1, 16, 0);
    sheets.slots.columns = 4;
    scene.geometry.extent = 3;
    b.scene = &scene;
    b.spec = &spec;
    b.looks = looks;
    b.first = 10;
    b.slot = 6;
    b.count = 2;
    looks[1].normal[1] = 1;
    for (k = 0; k < 3; k++) looks[1].position[k] = (float)k + 1;
    sbl__raster_view(&r, &sheets, &b, 5 + 2, &v);
    CHECK(v.sensor == 11 && v.face == 2, "look %d, view %d", v.sensor, v.face);
    CHECK(v.viewport[0] == 3 * sbl__layout_pitch(&sheets.layout, 0) + sheets.layout.rects[2][0] &&
              v.viewport[1] == sbl__layout_pitch(&sheets.layout, 1) + sheets.layout.rects[2][1] &&
              v.viewport[2] == 16 && v.viewport[3] == 8, "the view is at %d %d", v.viewport[0], v.viewport[1]);
    sbl__view_axes(&looks[1], 2, right, up, forward);
    for (i = 0; i < 3; i++) {
        origin[i] = ahead[i] = (double)v.world_to_view[12 + i];
        for (k = 0; k < 3; k++) {
            origin[i] += (double)(v.world_to_view[4 * k + i] * looks[1].position[k]);
            ahead[i] += (double)v.world_to_view[4 * k + i] * ((double)looks[1].position[k] + forward[k]);
        }
        CHECK(fabs(origin[i]) < 1e-5 && fabs(ahead[i] + (i == 2)) < 1e-5, "axis %d: %g, ahead %g", i, origin[i],
              ahead[i]);
    }
}

/* No site is measured before the stage that measures sites, and all are after it. When this stage starts, the job of
   earlier sites does not count. */
TEST(sites_are_measured_in_their_stage) {
    static sbl__core core;
    sbl__work w;
    int stage;
    memset(&w, 0, sizeof w);
    w.core = &core;
    w.task.site_count = 40;
    core.job.stages.stage = SBL__JOB_DRAW;
    core.job.look_end = 8;
    core.job.drawn = 2;
    core.job.look_kind = SBL__LOOK_STUCK - 1;
    for (stage = 0; stage < 6; stage++) {
        w.stages.stage = stage / 2 + 2;
        w.stages.at = stage % 2;
        CHECK(fabs(sbl__work_measured(&w, 3) - (stage < 2 ? 0 : stage > 3 ? 40 : stage == 3 ? 10 : 0)) < 1e-6,
              "stage %d at %d: %g sites", w.stages.stage, w.stages.at, sbl__work_measured(&w, 3));
    }
}

/* A hinge has the weight of the smaller of its two triangles. */
TEST(hinges_weigh_as_the_smaller_triangle) {
    static const float areas[2][2] = { { 0.5f, 2 }, { 8, 2 } };
    static sbl__vertices s;
    static float sums[2 * SBL__VERTICES_SUMS];
    uint32_t corners[6] = { 0, 1, 2, 3, 2, 1 };
    double diagonal[12];
    int run, i, k;
    s.sums = sums;
    s.corners = corners;
    s.solver.diagonal = diagonal;
    s.desc.smoothing = 9;
    for (run = 0; run < 2; run++) {
        sbl__hinge h = { { 1, 4 }, { 1, 2, -3, -1 } };
        const double scale2 = 9 * (run ? 2 : 0.5);
        size_t at[4];
        s.hinges = &h;
        for (i = 0; i < 12; i++) diagonal[i] = 100;
        for (i = 0; i < 2; i++) sums[SBL__VERTICES_SUMS * i + 6] = areas[run][i];
        sbl__hinge_unknowns(&s, &h, at);
        CHECK(sbl__vertices_bend(&s, 0) == SBL_SUCCESS, "the hinge is refused");
        for (i = 0; i < 4; i++) {
            const double weight = i == 0 ? 1 : i == 1 ? 2 : i == 2 ? -3 : -1;
            CHECK(fabs((double)h.weights[i] - weight * sqrt(scale2)) < 1e-5, "run %d: weight %d is %g", run, i,
                  (double)h.weights[i]);
            for (k = 0; k < 3; k++)
                CHECK(fabs(diagonal[3 * at[i] + (size_t)k] - 100 - weight * weight * scale2) < 1e-4,
                      "run %d: unknown %d has the weight %g", run, (int)at[i], diagonal[3 * at[i] + (size_t)k]);
        }
    }
}

/* A developed picture is complete. Its light is deleted, unless further layers need it. */
TEST(developed_light_is_deleted) {
    static sbl__core core;
    static sbl__map m;
    int layers;
    core.base = base;
    core.device.base = &core.base;
    m.work.core = &core;
    for (layers = 0; layers < 2; layers++) {
        m.developed = 0;
        m.spec.directional = layers;
        m.layers[0].light.bytes = core.base.memory.gpu_bytes = 64;
        CHECK(sbl__map_after_develop(&m) == SBL__MAP_END && m.developed, "the picture is not developed");
        CHECK(core.base.memory.gpu_bytes == (layers ? 64 : 0), "%d bytes of light", (int)core.base.memory.gpu_bytes);
    }
}

/* Up to SBL__SEAM_CHAIN edges with the same ends are kept, so that many equal edges take no longer than a few. */
TEST(chains_of_edges_end) {
    enum { TRIANGLES = SBL__SEAM_CHAIN + 4 };
    static unsigned char baked[1] = { 1 };
    static float map[6];
    sbl__vertex vertices[3];
    uint32_t indices[3 * TRIANGLES], kept[3] = { 0, 0, 0 }, slot;
    sbl__geometry g;
    sbl__atlas atlas;
    sbl__seams s;
    int i;
    memset(vertices, 0, sizeof vertices);
    memset(&g, 0, sizeof g);
    memset(&atlas, 0, sizeof atlas);
    memset(&s, 0, sizeof s);
    for (i = 0; i < 3; i++) vertices[i].position[i] = 1;
    for (i = 0; i < 3 * TRIANGLES; i++) indices[i] = (uint32_t)i % 3;
    g.vertices = vertices;
    g.indices = indices;
    g.lightmap_texcoords = map;
    g.triangle_count = TRIANGLES;
    atlas.geometry = &g;
    atlas.baked = baked;
    s.atlas = &atlas;
    REQUIRE(sbl__hash_table_make(&base, &s.edges, 3 * TRIANGLES) == SBL_SUCCESS, "no memory");
    for (i = 0; i < 3 * TRIANGLES; i++) CHECK(sbl__seams_edge(&s, i) == SBL_SUCCESS, "edge %d", i);
    for (slot = 0; slot <= s.edges.mask; slot++) if (s.edges.buckets[slot]) kept[(s.edges.buckets[slot] - 1) % 3]++;
    for (i = 0; i < 3; i++) CHECK(kept[i] == SBL__SEAM_CHAIN, "%u edges are kept", kept[i]);
    sbl__hash_table_free(&base, &s.edges);
}

/* Every array of a map that is joined must be finite: ids, R and all groups or harmonics. */
TEST(joined_arrays_must_be_finite) {
    enum { WIDTH = 3, ROW = 1, LAYERS = SBL__LAYERS - 1 };
    static float ids[2 * WIDTH], light[LAYERS + 1][6 * WIDTH];
    static sbl__joining j;
    static sbl__core core;
    int grouped, layer;
    j.work.core = &core;
    core.scene.light_groups = LAYERS;
    j.desc.lightmap.width = WIDTH;
    j.desc.lightmap.height = 2;
    j.desc.ids = ids;
    for (grouped = 0; grouped < 2; grouped++) {
        j.desc.lightmap.grouped = grouped;
        j.desc.lightmap.directional = !grouped;
        for (layer = 0; layer <= LAYERS; layer++) j.desc.light[layer] = grouped && layer ? NULL : light[layer];
        for (layer = 0; layer < LAYERS; layer++) j.desc.groups[layer] = light[layer + 1];
        CHECK(sbl__joining_check_texels(&j, ROW) == SBL_SUCCESS, "finite arrays are refused");
        for (layer = -1; layer <= LAYERS; layer++) {
            float *bad = layer < 0 ? &ids[2 * WIDTH - 1] : &light[layer][6 * WIDTH - 1];
            *bad = (float)HUGE_VAL;
            CHECK(sbl__joining_check_texels(&j, ROW) == SBL_ERROR_INVALID_ARGUMENT, "layer %d is not checked", layer);
            CHECK(sbl__joining_check_texels(&j, 0) == SBL_SUCCESS, "layer %d: another row is checked", layer);
            *bad = 0;
        }
    }
}

/* Abandoned work leaves no job. */
TEST(abandoned_jobs_are_freed) {
    static sbl_context c;
    c.core.base = base;
    c.core.device.base = &c.core.base;
    c.core.job.looks = (sbl__look *)sbl__alloc(&c.core.base, 1, sizeof(sbl__look));
    sbl__abandon(&c);
    CHECK(!c.core.job.looks && c.core.base.memory.host_bytes == 0, "%d bytes are left",
          (int)c.core.base.memory.host_bytes);
}

/* Six small triangles with normals along both directions of each axis, whose fronts and backs are 12 sides. All sides
   are pooled in one patch, but each has a patch word of its own. */
TEST(sides_have_their_own_patch_words) {
    uint32_t indices[18], parents[6], words[12], i, k;
    sbl__vertex vertices[18];
    sbl__patch patches[6];
    sbl__patching p;
    sbl__geometry g;
    sbl__object object;
    memset(vertices, 0, sizeof vertices);
    memset(patches, 0, sizeof patches);
    memset(&object, 0, sizeof object);
    memset(&g, 0, sizeof g);
    memset(&p, 0, sizeof p);
    for (i = 0; i < 18; i++) indices[i] = i;
    for (i = 0; i < 6; i++) {
        const uint32_t axis = i / 2, mirrored = i % 2;
        vertices[3 * i + 1 + mirrored].position[(axis + 1) % 3] = 1;
        vertices[3 * i + 2 - mirrored].position[(axis + 2) % 3] = 1;
        parents[i] = i;
        patches[i].area = 0.5;
    }
    g.vertices = vertices;
    g.indices = indices;
    g.objects = &object;
    g.triangle_count = 6;
    p.geometry = &g;
    p.parents = parents;
    p.patches = patches;
    p.least = 1;
    for (i = 0; i < 12; i++) words[i] = sbl__patch_word(&p, i / 2) ^ (i % 2 ? SBL__PATCH_BACK : 0);
    for (i = 0; i < 12; i++) {
        CHECK(words[i] >> SBL__PATCH_SHIFT == 6, "side %u is in patch %u", i, words[i] >> SBL__PATCH_SHIFT);
        CHECK((words[i] >> SBL__PATCH_AXIS_SHIFT & 3u) == i / 4, "side %u: word %x", i, words[i]);
        for (k = 0; k < i; k++) CHECK(words[i] != words[k], "sides %u and %u have the word %x", i, k, words[i]);
    }
}

/* A triangle joins the patch of one beside it, unless the edge between them is sharp. Triangles that only touch at a
   corner stay apart. */
TEST(smooth_triangles_are_one_patch) {
    static const float at[8][3] = { { 0, 0, 0 }, { 1, 0, 0 }, { 0, 1, 0 }, { 1, 1, 0 }, { 0, 0, 1 }, { -1, 0, 0 },
                                    { 0, -1, 0 }, { 2, 1, 0.1f } };
    static const uint32_t expected[5] = { 0, 0, 2, 3, 0 };
    uint32_t indices[15] = { 0, 1, 2, 1, 3, 2, 0, 4, 2, 0, 5, 6, 1, 7, 3 };
    uint32_t welded[8], corners[15], parents[5], i;
    sbl__vertex vertices[8];
    sbl__patching p;
    sbl__geometry g;
    memset(vertices, 0, sizeof vertices);
    memset(&g, 0, sizeof g);
    memset(&p, 0, sizeof p);
    for (i = 0; i < 8; i++) memcpy(vertices[i].position, at[i], sizeof at[i]);
    for (i = 0; i < 8; i++) welded[i] = i;
    for (i = 0; i < 5; i++) parents[i] = i;
    g.vertices = vertices;
    g.indices = indices;
    p.geometry = &g;
    p.welded = welded;
    p.corners = corners;
    p.parents = parents;
    REQUIRE(sbl__hash_table_make(&base, &p.ends, 15) == SBL_SUCCESS, "no memory");
    for (i = 0; i < 5; i++) CHECK(sbl__patch_join(&p, (int)i) == SBL_SUCCESS, "triangle %u", i);
    for (i = 0; i < 5; i++)
        CHECK(sbl__root(parents, i) == expected[i], "triangle %u is in patch %u", i, sbl__root(parents, i));
    sbl__hash_table_free(&base, &p.ends);
}

static char logged[512];

static void keep_message(sbl_log_level level, sbl_log_item item, const char *message, void *user) {
    (void)level; (void)item; (void)user;
    snprintf(logged, sizeof logged, "%s", message);
}

/* The message about the budget tells in MB what is needed and what is left, and the size of a picture that fits. */
TEST(what_fits_is_told_in_megabytes) {
    sbl__base budgeted = base;
    sbl__need need = { { 1e6, 2e6 }, { 10, 100 }, 3e6 };
    budgeted.logger.log = keep_message;
    budgeted.memory.host_bytes = 1000000;
    budgeted.memory.gpu_bytes = 2000000;
    budgeted.budget = 305000000;
    logged[0] = 0;
    CHECK(sbl__need_afford(&budgeted, "f", &need) == SBL_SUCCESS && !logged[0], "302 MB do not fit: %s", logged);
    budgeted.budget--;
    CHECK(sbl__need_afford(&budgeted, "f", &need) == SBL_ERROR_OUT_OF_MEMORY, "302 MB fit");
    CHECK(strstr(logged, "about 302 MB are needed") && strstr(logged, "leaves 302 MB") &&
              strstr(logged, "1732 x 1732 pixels"), "%s", logged);
    budgeted.budget = 2000000;
    CHECK(sbl__need_afford(&budgeted, "f", &need) == SBL_ERROR_OUT_OF_MEMORY &&
              strstr(logged, "leaves 0 MB, enough for 0 x 0"), "%s", logged);
    budgeted.budget = 0;
    CHECK(sbl__need_afford(&budgeted, "f", &need) == SBL_SUCCESS, "there is a limit without a budget");
}

/* The state of a tile's corners contains the smallest number of looks among usable sensors, the number of new sensors,
   and the number of sensors that have not been read. */
TEST(corners_of_a_tile_are_summed_up) {
    static const int looks[4] = { 5, 3, 1, 4 };
    sbl__pixel pixels[4];
    sbl__sensor sensors[5], *block = sensors;
    sbl__corners all;
    sbl__tile tile;
    sbl__refine r;
    int i;
    memset(pixels, 0, sizeof pixels);
    memset(sensors, 0, sizeof sensors);
    memset(&tile, 0, sizeof tile);
    small_refine(&r, pixels, &block, 2);
    r.rounds = 7;
    tile.area.x[1] = tile.area.y[1] = 1;
    all = sbl__tile_corners(&r, &tile);
    CHECK(!all.looks && !all.is_new && !all.unread, "%d looks without sensors", all.looks);
    for (i = 0; i < 4; i++) {
        sbl__sensor *s = &sensors[i + 1];
        pixels[i].sensor = (uint32_t)i + 1;
        pixels[i].id = 1;
        s->sensed = 1;
        s->invalid = i == 2;
        s->looks = (unsigned short)looks[i];
        s->round = 5;
    }
    all = sbl__tile_corners(&r, &tile);
    CHECK(all.looks == 3 && !all.is_new && !all.unread, "%d looks, new %d, unread %d", all.looks, all.is_new,
          all.unread);
    for (i = 1; i <= 4; i++) {
        sensors[i].round = 6;
        sensors[i].sensed = 0;
        all = sbl__tile_corners(&r, &tile);
        CHECK(all.is_new && all.unread, "corner %d: new %d, unread %d", i - 1, all.is_new, all.unread);
        sensors[i].round = 5;
        sensors[i].sensed = 1;
    }
}

/* If no glow is left, no leaf is bright, and the red of each leaf is positive again. If bright leaves had been measured
   before, all light is computed again, once. */
TEST(leaves_are_positive_after_glows) {
    static sbl__bounce b;
    static sbl__core core;
    sbl__bounce_leaf states[2];
    sbl__leaf leaves[2];
    sbl__store store;
    sbl__bounce_point points[1];
    int i, measured;
    memset(points, 0, sizeof points);
    b.core = &core;
    b.points = points;
    for (measured = 0; measured < 2; measured++) {
        memset(states, 0, sizeof states);
        set_leaves(&b, &store, leaves, states);
        b.glows = measured ? SBL__GLOWS_SPREAD : SBL__GLOWS_NOWHERE;
        b.rounds = 3;
        for (i = 0; i < 2; i++) {
            states[i].bright = SBL__BRIGHT;
            leaves[i].light[0] = (float)(-3 - i);
        }
        CHECK(sbl__bright_after_glow(&b) == (measured ? SBL__BOUNCE_DIRECT : SBL__BOUNCE_NOISE), "a wrong stage");
        CHECK(b.glows == (measured ? SBL__GLOWS_EVERYWHERE : SBL__GLOWS_NOWHERE), "glows %d", b.glows);
        CHECK(b.rounds == (measured ? 0 : 3), "round %d", b.rounds);
        for (i = 0; i < 2; i++)
            CHECK(!states[i].bright && fabs((double)leaves[i].light[0] - 3 - i) < 1e-6, "leaf %d: red %g, bright %d", i,
                  (double)leaves[i].light[0], states[i].bright);
    }
}

/* A touched texel is refused beside a hidden texel of the same surface, in any of eight directions, whichever is read
   first. Texels farther away, and those of other surfaces, do not matter. */
TEST(touched_texels_beside_hidden_ones_are_refused) {
    enum { SIDE = 5, MIDDLE = 12 };
    static sbl__core core;
    static sbl__atlas atlas;
    sbl__pixel pixels[SIDE * SIDE];
    sbl__sensor sensors[SIDE * SIDE + 1], *block = sensors;
    int other, order, i;
    core.base = base;
    for (other = 0; other < SIDE * SIDE; other++)
        for (order = 0; order < 4; order++) {  /* bit 0: the hidden texel is read last; bit 1: another surface */
            const int beside = abs(other % SIDE - 2) <= 1 && abs(other / SIDE - 2) <= 1 && other != MIDDLE;
            const int touched = order & 1 ? other : MIDDLE, hidden = order & 1 ? MIDDLE : other;
            sbl_reading reading;
            sbl__spec spec;
            sbl__refine r;
            if (other == MIDDLE) continue;
            memset(pixels, 0, sizeof pixels);
            memset(sensors, 0, sizeof sensors);
            memset(&reading, 0, sizeof reading);
            memset(&spec, 0, sizeof spec);
            small_refine(&r, pixels, &block, SIDE);
            r.core = &core;
            r.atlas = &atlas;
            r.spec = &spec;
            spec.traced = 1;
            r.distance_limit = 1;
            for (i = 0; i < SIDE * SIDE; i++) {
                pixels[i].id = order & 2 && i == other ? 2 : 1;
                pixels[i].sensor = (uint32_t)i + 1;
            }
            sensors[other + 1].occlusion = order & 1 ? SBL__TOUCHED : SBL__HIDDEN;
            reading.valid = 1;
            reading.hit_min = 0.5f * SBL__HIDDEN_TOUCH;
            reading.hit_mean = 0.5f * SBL__HIDDEN_CLOSE;
            reading.hit_share = order & 1 ? 1 : 0.01f;
            CHECK(sbl__places_validate(&r, MIDDLE, &reading) == SBL_SUCCESS &&
                      sensors[MIDDLE + 1].occlusion == (order & 1 ? SBL__HIDDEN : SBL__TOUCHED), "occlusion %d",
                  sensors[MIDDLE + 1].occlusion);
            CHECK(sensors[touched + 1].invalid == (beside && !(order & 2)), "touched texel %d, hidden texel %d: "
                  "invalid %d", touched, hidden, sensors[touched + 1].invalid);
            sbl__free(&core.base, r.searched);
        }
}

/* A new grid of cells begins without hits, points, cuts and black leaves. Small cells keep a pool above 1. */
TEST(grids_begin_empty) {
    static sbl__bounce b;
    b.patching.growth = 2;
    b.patching.pool = 1.5;
    b.samples_due = b.samples.count = b.waiting.count = b.point_count = b.cut_leaves = b.points_cast = 5;
    b.recheck = b.rechecking = b.samples_assigned = b.black_leaves = 5;
    b.needed_growth = 3;
    CHECK(sbl__cells_restart(&b, 0.5) == SBL__BOUNCE_GRID && fabs(b.patching.growth - 1) < 1e-9 &&
              fabs(b.patching.pool - 1.5) < 1e-9, "growth %g, pool %g", b.patching.growth, b.patching.pool);
    CHECK(!b.samples_due && !(b.needed_growth > 0) && !b.samples.count && !b.waiting.count && !b.point_count &&
              !b.cut_leaves && !b.points_cast && !b.recheck && !b.rechecking && !b.samples_assigned && !b.black_leaves,
          "the new grid is not empty");
    sbl__cells_restart(&b, 3);
    CHECK(fabs(b.patching.growth - 3) < 1e-9 && fabs(b.patching.pool - 4.5) < 1e-9, "growth %g, pool %g",
          b.patching.growth, b.patching.pool);
}

/* Jobs have room for all sites, but for no more than SBL__WORK_SITES. */
TEST(jobs_have_room_for_their_sites) {
    static sbl__core core;
    sbl__work w;
    int i;
    core.base = base;
    core.device.base = &core.base;
    for (i = 0; i < 4; i++) {
        const double count = i < 2 ? 3 : 1e12, sites = i < 2 ? 3 : SBL__WORK_SITES;
        memset(&w, 0, sizeof w);
        w.core = &core;
        REQUIRE(sbl__work_make_task(&w, count, i & 1) == SBL_SUCCESS, "no memory");
        CHECK(fabs((double)core.base.memory.host_bytes - sites * (double)(sizeof *w.sites + (i & 1 ? sizeof *w.readings
              : 0))) < 0.5, "%.0f sites have %.0f bytes", sites, (double)core.base.memory.host_bytes);
        sbl__work_free_task(&w);
        CHECK(core.base.memory.host_bytes == 0 && !w.sites && !w.readings, "sites are left");
    }
}

/* The score of a leaf is the weight of its rays times the variance of the light in its region, relative to the mean
   square of all light. Few hits, or even light, give no score. */
TEST(uneven_light_has_a_score) {
    static sbl__bounce b;
    sbl__region region = { 4, 12, 44 };  /* mean 3, mean square 11, variance 2 */
    sbl__leaf_moments moments[1];
    sbl__bounce_leaf states[2];
    sbl__bounce_point points[1];
    static sbl__division d;
    sbl__leaf leaves[2];
    sbl__store store;
    uint32_t patches[1] = { 0 };
    int i, k, counted = 0;
    memset(states, 0, sizeof states);
    memset(points, 0, sizeof points);
    set_leaves(&b, &store, leaves, states);
    store.patches = patches;
    store.cell_capacity = 1;
    store.length = 1;
    b.points = points;
    b.division = &d;
    d.moments = moments;
    d.regions = &region;
    d.all.points = 100;
    d.all.squares = 50;
    for (k = 0; k < 3; k++) leaves[0].light[k] = 7;
    for (i = 0; i < 4; i++) {  /* a score; few hits; even light; no valid point */
        d.light = d.variance = 0;
        memset(moments, 0, sizeof moments);
        moments[0].hits = i == 1 ? 0.5 * SBL__DIVIDE_HITS : 2.0 * SBL__DIVIDE_HITS;
        moments[0].weight = 5;
        states[0].valid = i == 3 ? 0 : 3;
        if (i == 2) region.squares = 36;
        CHECK(sbl__division_score(&b, 0) == SBL_SUCCESS && fabs(moments[0].score - (i ? 0 : 5 * 2 * 100 / 50.0)) <
                  1e-9, "case %d has the score %g", i, moments[0].score);
        CHECK(fabs(d.variance - (i < 2 ? moments[0].hits * 5 * 2 / 3 : 0)) < 1e-9 &&
                  fabs(d.light - (i < 3 ? 7 * sqrt(5 * moments[0].hits) : 0)) < 1e-4, "case %d: variance %g, light %g",
              i, d.variance, d.light);
    }
    for (i = 0; i < SBL__SCORES; i++) counted += d.classes[i];
    CHECK(counted == 1 && d.classes[sbl__score_class(20)] == 1, "%d leaves are in classes", counted);
}

/* Narrow triangles are marked at a sharp edge and, in later rounds, beside marked ones. */
TEST(narrow_triangles_are_marked) {
    static const float at[6][3] = { { 0, 0, 0 }, { 0, 1, 0 }, { 1, 0, 0 }, { 1, 1, 0 }, { 1, 0, 1 }, { 1, 1, 1 } };
    static const uint32_t edges[4][3] = {  /* per side: the triangle beside it */
        { SBL__NONE, 1, SBL__NONE }, { SBL__NONE, 2, 0 }, { SBL__NONE, 3, 1 }, { SBL__NONE, SBL__NONE, 2 }
    };
    uint32_t indices[12] = { 0, 2, 1, 1, 2, 3, 3, 2, 4, 3, 4, 5 }, beside[12];
    unsigned char marks[4];
    sbl__vertex vertices[6];
    sbl__geometry g;
    sbl__atlas a;
    int i, narrow;
    memset(vertices, 0, sizeof vertices);
    memset(&g, 0, sizeof g);
    memset(&a, 0, sizeof a);
    for (i = 0; i < 6; i++) memcpy(vertices[i].position, at[i], sizeof at[i]);
    for (i = 0; i < 12; i++) beside[i] = SBL__NONE;
    for (i = 0; i < 4; i++) memcpy(beside + 3 * i, edges[i], sizeof edges[i]);
    g.vertices = vertices;
    g.indices = indices;
    g.triangle_count = 4;
    a.geometry = &g;
    a.marks = marks;
    a.beside = beside;
    a.world_area = 18;
    a.area = 2;
    a.across = 2;  /* a texel is 6 wide */
    for (narrow = 0; narrow < 2; narrow++) {
        memset(marks, 0, sizeof marks);
        /* triangles of heights up to 1.08 or 0.6 are narrow; the heights above their shared sides are 0.7 and 1 */
        a.facet_limit = narrow ? 0.09f : 0.05f;
        for (i = 0; i < 4; i++) CHECK(sbl__atlas_mark_sharp(&a, i) == SBL_SUCCESS, "triangle %d", i);
        for (i = 0; i < 4; i++)
            CHECK(marks[i] == (narrow && (i == 1 || i == 2)), "narrow %d: triangle %d has the mark %d", narrow, i,
                  marks[i]);
        for (i = 0; i < 4; i++) CHECK(sbl__atlas_mark_neighbours(&a, i) == SBL_SUCCESS, "triangle %d", i);
        for (i = 0; i < 4; i++)
            CHECK(marks[i] == (!narrow ? 0 : i == 1 || i == 2 ? 1 : 2), "narrow %d: triangle %d has the mark %d",
                  narrow, i, marks[i]);
    }
}

/* Two fans of three triangles have two hinges each. The first lies along the diagonal of a square. */
TEST(meshes_have_their_own_hinges) {
    static const float at[5][3] = { { 0, 0, 0 }, { 1, 0, 0 }, { 1, 1, 0 }, { 0, 1, 0 }, { -1, 1, 0 } };
    static const double expected[4] = { 0.5, 0.5, -0.5, -0.5 };
    static sbl__core core;
    static sbl__vertices s;
    sbl__baked_mesh meshes[2];
    sbl__vertex vertices[10];
    uint32_t corners[18] = { 0, 1, 2, 0, 2, 3, 0, 3, 4, 5, 6, 7, 5, 7, 8, 5, 8, 9 }, unknowns[10];
    float areas[6] = { 1, 1, 1, 1, 1, 1 };
    int i, k;
    core.base = base;
    core.scene.geometry.vertices = vertices;
    memset(meshes, 0, sizeof meshes);
    memset(vertices, 0, sizeof vertices);
    for (i = 0; i < 10; i++) memcpy(vertices[i].position, at[i % 5], sizeof at[0]);
    for (i = 0; i < 10; i++) unknowns[i] = (uint32_t)i;
    for (i = 0; i < 2; i++) {
        meshes[i].first_vertex = 5 * i;
        meshes[i].first_triangle = 3 * i;
        meshes[i].triangle_count = 3;
        meshes[i].vertex_count = 5;
        meshes[i].area = 3;
        meshes[i].first_hinge = 99;
    }
    s.work.core = &core;
    s.meshes = meshes;
    s.mesh_count = 2;
    s.corners = corners;
    s.unknowns = unknowns;
    s.areas = areas;
    s.desc.samples = 16;
    s.desc.smoothing = 1;
    REQUIRE(sbl__hash_table_make(&core.base, &s.ends, 18) == SBL_SUCCESS, "no memory");
    for (i = 0; i < 6; i++) CHECK(sbl__vertices_sides(&s, i) == SBL_SUCCESS, "triangle %d", i);
    CHECK(s.hinge_count == 4 && s.points == 6 * 16, "%d hinges, %d points", s.hinge_count, (int)s.points);
    for (i = 0; i < 2; i++) {
        CHECK(meshes[i].first_hinge == 2 * i && meshes[i].hinge_count == 2, "mesh %d: %d hinges from %d on", i,
              meshes[i].hinge_count, meshes[i].first_hinge);
        for (k = 0; k < 4 && 2 * i < s.hinge_count; k++)
            CHECK(fabs((double)s.hinges[2 * i].weights[k] - expected[k]) < 1e-6, "mesh %d: weight %d is %g", i, k,
                  (double)s.hinges[2 * i].weights[k]);
    }
    sbl__free(&core.base, s.hinges);
    sbl__hash_table_free(&core.base, &s.ends);
}

/* Stored light belongs to the place of its scene: scenes that are equal, but far from each other, differ in their
   meshes. */
TEST(stored_light_belongs_to_a_place) {
    static sbl__scene scene;
    uint64_t here[SBL__SAVED_HASHES], there[SBL__SAVED_HASHES];
    int i;
    memset(&scene, 0, sizeof scene);
    sbl__saved_scene(&scene, here);
    scene.geometry.centre[2] = 4096;
    sbl__saved_scene(&scene, there);
    for (i = 0; i < SBL__SAVED_HASHES; i++)
        CHECK((here[i] != there[i]) == (i == SBL__SAVED_MESHES), "hash %d: %llx and %llx", i,
              (unsigned long long)here[i], (unsigned long long)there[i]);
}

int main(void) {
    base.allocator.alloc = take;
    base.allocator.free = give;
    RUN(buffers_of_all_sizes_share_programs);
    RUN(numbers_are_found_in_order);
    RUN(windows_contain_what_they_read);
    RUN(zeroes_are_the_same);
    RUN(positions_of_two_meshes_differ);
    RUN(sides_are_shared);
    RUN(groups_have_their_least_number);
    RUN(values_spread_ring_by_ring);
    RUN(least_squares_are_solved);
    RUN(channels_are_solved_apart);
    RUN(continued_solutions_stop_early);
    RUN(zero_is_solved_at_once);
    RUN(seams_keep_light_positive);
    RUN(seams_are_sampled_as_maps);
    RUN(light_is_linear_beside_silhouettes);
    RUN(light_between_sensors_is_curved);
    RUN(noise_that_is_left);
    RUN(any_colour_of_the_sky_is_light);
    RUN(sensors_of_other_surfaces_split_no_tile);
    RUN(first_tiles_end_with_the_picture);
    RUN(the_nearest_guide_is_taken);
    RUN(edges_of_spots_are_soft);
    RUN(noise_of_sensors_is_no_bias);
    RUN(costs_of_nodes_add_up);
    RUN(filters_average_a_square);
    RUN(points_share_light_both_ways);
    RUN(differences_of_looks_have_the_noise_of_both);
    RUN(light_may_change_beside_borders);
    RUN(divisions_halve_fractions);
    RUN(hits_follow_cuts);
    RUN(uncertainty_has_a_limit);
    RUN(bounds_of_draws_are_hashed);
    RUN(points_that_see_back_faces_are_suspect);
    RUN(stuck_points_do_not_count);
    RUN(settled_hits_are_skipped);
    RUN(further_points_do_not_count_more);
    RUN(places_that_fill_the_view_stay_ordinary);
    RUN(sites_count_by_what_reflects_their_light);
    RUN(rays_of_sites_cover_the_hemisphere);
    RUN(no_memory_is_left);
    RUN(groups_of_a_texel_add_up);
    RUN(places_that_differ_are_noisy);
    RUN(sensors_keep_the_variance_of_a_look);
    RUN(dropped_glows_are_ordinary);
    RUN(glows_cover_their_cell);
    RUN(lobes_are_unpacked);
    RUN(largest_mirrors_of_lamps_are_kept);
    RUN(contact_lines_cut_what_they_cross);
    RUN(black_surfaces_are_matte);
    RUN(planes_cut_leaves_once);
    RUN(light_of_glows_is_added);
    RUN(white_walls_are_told_once);
    RUN(changed_lights_keep_points);
    RUN(changes_reach_what_depends_on_them);
    RUN(lamps_of_sensors_are_named);
    RUN(components_of_all_types_are_read);
    RUN(guides_are_smoothed);
    RUN(looks_grow_after_the_first_round);
    RUN(places_are_open);
    RUN(depths_become_distances);
    RUN(seconds_belong_to_stages);
    RUN(layers_are_progress);
    RUN(joined_texels_have_a_mean);
    RUN(groups_of_meshes_inside_out);
    RUN(windows_and_tiles_have_ends);
    RUN(dark_sensors_are_inside);
    RUN(cuts_lead_on);
    RUN(bright_cells_are_in_order);
    RUN(lamps_have_the_group_of_their_source);
    RUN(costs_fall_slowly);
    RUN(extents_are_measured);
    RUN(tiles_have_the_mean_of_their_corners);
    RUN(flat_boxes_are_thick_enough);
    RUN(glimpses_are_coarse);
    RUN(reflections_have_their_own_options);
    RUN(sharp_lobes_see_few_cells);
    RUN(jobs_of_views_are_kept);
    RUN(pixels_of_all_kinds_are_read);
    RUN(skies_are_turned);
    RUN(bins_of_worth_are_in_order);
    RUN(leaves_have_limits);
    RUN(pictures_choose_the_number_of_cells);
    RUN(triangles_of_a_mirror_are_one_plane);
    RUN(large_clusters_of_lamps_are_divided);
    RUN(groups_of_a_leaf_add_up);
    RUN(batches_are_progress);
    RUN(points_fill_triangles_evenly);
    RUN(air_has_the_mean_of_valid_sites);
    RUN(sides_have_their_own_groups);
    RUN(grazing_normals_are_bent);
    RUN(random_groups_have_their_least_number);
    RUN(parts_of_texels_are_squares);
    RUN(the_rest_of_the_time_is_estimated);
    RUN(errors_are_relative_to_the_mean);
    RUN(the_cheapest_split_is_chosen);
    RUN(lamps_lie_along_a_curve);
    RUN(even_guides_are_uniform);
    RUN(meters_leave_pixels_out);
    RUN(cameras_enclose_the_scene);
    RUN(lamps_are_limited);
    RUN(invalid_presets_are_the_default);
    RUN(positions_fill_texels);
    RUN(what_is_freed_is_zero);
    RUN(given_rays_are_all_traced);
    RUN(jobs_have_their_own_readings);
    RUN(drawn_views_belong_to_a_look);
    RUN(sites_are_measured_in_their_stage);
    RUN(hinges_weigh_as_the_smaller_triangle);
    RUN(developed_light_is_deleted);
    RUN(chains_of_edges_end);
    RUN(joined_arrays_must_be_finite);
    RUN(abandoned_jobs_are_freed);
    RUN(sides_have_their_own_patch_words);
    RUN(smooth_triangles_are_one_patch);
    RUN(what_fits_is_told_in_megabytes);
    RUN(corners_of_a_tile_are_summed_up);
    RUN(leaves_are_positive_after_glows);
    RUN(touched_texels_beside_hidden_ones_are_refused);
    RUN(grids_begin_empty);
    RUN(jobs_have_room_for_their_sites);
    RUN(uneven_light_has_a_score);
    RUN(narrow_triangles_are_marked);
    RUN(meshes_have_their_own_hinges);
    RUN(stored_light_belongs_to_a_place);
    RUN(split_tiles_keep_their_light);
    return test_report();
}
