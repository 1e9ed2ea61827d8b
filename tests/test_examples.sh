#!/bin/sh
# Runs every example and checks its output. picture.c defines the checks of pictures.
set -u
export LC_ALL=C
cd "$(dirname "$0")/.." || exit 1
. tests/support/check.sh
: "${BUILD_DIR:=build}"
gcc -std=c99 -O2 -Wall -Wextra tests/tools/picture.c -lm -o "$folder/picture" || exit 1

# run NAME FOLDER ARGUMENTS...: runs an example, which must succeed without output on stderr. Its stdout is written to
# FOLDER/said.
run() {
    example=$1 out=$folder/$2
    shift 2
    mkdir -p "$out"
    "$BUILD_DIR/$example" "$out" "$@" > "$out/said" 2> "$out/errors"
    status=$?
    cat "$out/said" "$out/errors"
    [ "$status" = 0 ] && [ ! -s "$out/errors" ]
}
# look COMMAND FILES...: applies a check of picture.c to files in $folder
look() { (cd "$folder" && ./picture "$@"); }

# plain_check NAME [COMMAND...]: a check that does not run with sanitizers, because the library takes most of its time.
# COMMAND is NAME by default.
plain_check() {
    checked=$1
    [ $# = 1 ] || shift
    if [ "$BUILD_DIR" = build ]; then check "$checked" "$@"
    else skip "$checked" "other tests run this code with sanitizers"
    fi
}

for source in examples/*.c; do
    example=$(basename "$source" .c)
    says_what_it_demonstrates() { head -n 1 "$source" | grep -q '^/\* Demonstrates '; }
    check "${example}_says_what_it_demonstrates" says_what_it_demonstrates
done

# >>minimal

minimal_is_short() {
    lines=$(wc -l < examples/minimal.c)
    echo "$lines lines"
    [ "$lines" -gt 0 ] && [ "$lines" -le 60 ]
}
minimal_picture() {
    run minimal minimal && look varied minimal/minimal.png 480 360 && look pyramid minimal/minimal.png
}
check minimal_is_short minimal_is_short
check minimal_picture minimal_picture

# >>host_context

# The number of frames depends on the machine and is not checked. test_steps.c counts pieces, and test_gl_state.c checks
# the GL state of the host.
host_context_run() {
    run host_context host_context draft && grep -Eq 'done after [1-9][0-9]* frames' "$folder/host_context/said"
}
host_context_picture() {
    look varied host_context/host_context.png 480 320 && look cornell host_context/host_context.png
}
plain_check host_context_run
plain_check host_context_picture

# >>host_draw

host_draw_picture() { run host_draw with --draft && look varied with/host_draw.png 200 160; }
host_draw_slabs() { run host_draw bare --draft --bare && look slabs with/host_draw.png bare/host_draw.png; }
# if the driver has no clip control, the shaders of the host write their own depth
host_draw_writes_depth() {
    (
        export MESA_GL_VERSION_OVERRIDE=3.3 MESA_GLSL_VERSION_OVERRIDE=330 MESA_EXTENSION_OVERRIDE=-GL_ARB_clip_control
        # The leak checker of gcc 12 crashes when it reads thread storage of a driver under these settings. The runs
        # above test for leaks.
        export ASAN_OPTIONS="${ASAN_OPTIONS-}:detect_leaks=0"
        run host_draw old --draft
    ) && look alike with/host_draw.png old/host_draw.png
}
check host_draw_picture host_draw_picture
plain_check host_draw_slabs
plain_check host_draw_writes_depth

# >>lights, small and with the preset draft, since only the program is tested

lights_kinds='quad textured thousand_lamps sphere point spot sun sky'
lights_run() { run lights lights draft; }
# each kind of light gives a different picture
lights_differ() {
    last=
    for kind in $lights_kinds; do
        look varied "lights/$kind.png" 40 30 || return
        [ -z "$last" ] || ! look alike "lights/$last.png" "lights/$kind.png" || return
        last=$kind
    done
}
# the penumbrae change little with the preset; the discs below them show the rays of the preset
lights_penumbra() {
    look varied lights/penumbra_default.png 40 40 &&
        look alike lights/penumbra_default.png lights/penumbra_high.png 30
}
plain_check lights_run
plain_check lights_differ
plain_check lights_penumbra

# >>reflections, with the preset draft, since only the program is tested

reflections_run() {
    run reflections reflections draft && look varied reflections/reflections.png 120 80 &&
        awk '/predicted error/ { ok = $4 > 0.5 && $4 < 6 && $7 > 0.1 && $7 < 20 } END { exit !ok }' \
            "$folder/reflections/said"
}
plain_check reflections_run

# >>vertex_light: a draft of light that pictures show, baked to the vertices of a mesh

vertex_light_run() {
    run vertex_light vertex_light draft &&
        grep -Eq '[0-9]{5} vertices, [0-9]{2,} of them inside' "$folder/vertex_light/said"
}
vertex_light_mesh() {
    awk '/^element vertex/ { vertices = $3 } /^element face/ { faces = $3 }
        body && NF == 6 { v++; lit += $4 + $5 + $6 > 60 } body && NF == 4 { f++ }
        body && NF == 4 && ($2 >= vertices || $3 >= vertices || $4 >= vertices) { bad++ } /^end_header/ { body = 1 }
        END { print v, f, lit, bad; exit !(v == vertices && f == faces && v > 10000 && lit > v / 2 && !bad) }' \
        "$folder/vertex_light/vertex_light.ply"
}
# the picture was checked by eye; this check is that of the Cornell box: left side red, right side green, lamp at the
# top
vertex_light_picture() {
    look varied vertex_light/vertex_light.png 512 512 && look cornell vertex_light/vertex_light.png
}
plain_check vertex_light_run
plain_check vertex_light_mesh
plain_check vertex_light_picture

# >>bake_lightmap

bake_lightmap_is_short() {
    lines=$(wc -l < examples/bake_lightmap.c)
    echo "$lines lines"
    [ "$lines" -gt 0 ] && [ "$lines" -le 60 ]
}
bake_lightmap_map() {
    run bake_lightmap bake_lightmap draft &&
        grep -Eq '^bake_lightmap: 50176 texels, .* off by [0-9.]+ %' "$folder/bake_lightmap/said" &&
    look varied bake_lightmap/bake_lightmap.png 256 256 && look charts bake_lightmap/bake_lightmap.png
}
check bake_lightmap_is_short bake_lightmap_is_short
plain_check bake_lightmap_map

# >>bake_vertices: a draft; least squares have a smaller error than averages

bake_vertices_run() {
    run bake_vertices bake_vertices draft &&
    sed -n 's/.* vertices, off by \([0-9.]*\) % (by averages \([0-9.]*\) %).*/\1 \2/p' "$folder/bake_vertices/said" |
        awk '{ ok = $1 > 0.1 && $1 < 9 && $2 > 1.3 * $1 } END { exit !ok }'
}
bake_vertices_mesh() {
    awk '/^element vertex/ { vertices = $3 } /^element face/ { faces = $3 }
        body && NF == 6 { v++; lit += $4 + $5 + $6 > 60 } body && NF == 4 { f++ }
        /^end_header/ { body = 1 }
        END { print v, f, lit; exit !(v == vertices && f == faces && v > 700 && lit > v / 2) }' \
        "$folder/bake_vertices/bake_vertices.ply"
}
plain_check bake_vertices_run
plain_check bake_vertices_mesh

# >>paper_metrics

# rows FILE COLUMNS ROWS: checks that the file has a header and ROWS rows of COLUMNS positive numbers
rows() {
    awk -F, -v columns="$2" -v rows="$3" '
        NF != columns { print "line " NR " has " NF " columns"; bad = 1 }
        NR > 1 { for (i = 1; i <= NF; i++) if ($i !~ /^[0-9.]+$/ || $i + 0 <= 0) { print "line " NR ": " $0; bad = 1 } }
        END { if (NR != rows + 1) print NR - 1 " rows"; exit bad || NR != rows + 1 }' "$folder/metrics/$1"
}
# rising FILE COLUMN: checks that the column increases from row to row
rising() {
    awk -F, -v c="$2" '
        NR > 2 && $c + 0 <= last { print FILENAME ": " $0; bad = 1 } { last = $c + 0 } END { exit bad }' \
        "$folder/metrics/$1"
}
metrics_run() { run paper_metrics metrics --quick; }
metrics_table_1() { rows table_1.csv 5 4 && rising table_1.csv 4; }
metrics_figure_10() { rows figure_10.csv 4 12; }
metrics_figure_11() { rows figure_11.csv 4 12; }
metrics_plots() {
    scripts/plot_metrics "$folder/metrics" && look plot metrics/table_1.png 1 &&
    look plot metrics/figure_10.png 3 && look plot metrics/figure_11.png 3
}
# plots_without COMMAND...: the command must fail with one line that says what is missing or how to install it
plots_without() { ! "$@" > "$folder/errors" 2>&1 && cat "$folder/errors" && [ "$(wc -l < "$folder/errors")" = 1 ]; }
metrics_plots_without_gnuplot() {
    plots_without env PATH=/nowhere /bin/sh scripts/plot_metrics "$folder/metrics" &&
        grep -q 'gnuplot-nox' "$folder/errors"
}
metrics_plots_without_figures() {
    mkdir -p "$folder/no metrics" && plots_without scripts/plot_metrics "$folder/no metrics" &&
        grep -q 'csv is missing' "$folder/errors"
}
metrics_figure_12() {
    rows figure_12.csv 3 2 && look halves metrics/figure_12.png &&
    awk -F, 'NR == 2 { small = $3 } NR == 3 { large = $3 } END { print small, large; exit !(small > 1.1 * large) }' \
        "$folder/metrics/figure_12.csv"
}
plain_check paper_metrics_run metrics_run
plain_check paper_metrics_table_1 metrics_table_1
plain_check paper_metrics_figure_10 metrics_figure_10
plain_check paper_metrics_figure_11 metrics_figure_11
plain_check paper_metrics_figure_12 metrics_figure_12
if command -v gnuplot > /dev/null; then
    plain_check paper_metrics_plots metrics_plots
    plain_check paper_metrics_plots_without_figures metrics_plots_without_figures
else
    skip paper_metrics_plots "gnuplot is missing"
fi
plain_check paper_metrics_plots_without_gnuplot metrics_plots_without_gnuplot

# >>first pictures: sbl_render with no option except the size, and with few cells for bounced light to save time

# first_picture FILE BLACK: checks that at most 5 % of the pixels are white, and at most BLACK % are black
first_picture() {
    "$BUILD_DIR/sbl_render" "$1" --size 96x72 --max-bounce-cells 1024 -o "$folder/first.png" &&
        look exposed first.png 5 "$2"
}
plain_check first_picture_cornell_box first_picture examples/scenes/cornell_box.obj 5
plain_check first_picture_two_rooms first_picture examples/scenes/two_rooms.obj 5
plain_check first_picture_window first_picture examples/scenes/window.obj 5
plain_check first_picture_lights first_picture examples/scenes/lights.gltf 5
plain_check first_picture_chair first_picture examples/scenes/first/chair.obj 5
plain_check first_picture_evening first_picture examples/scenes/first/evening.obj 5
plain_check first_picture_blender_sun first_picture examples/scenes/first/blender_sun.gltf 5
plain_check first_picture_lamps first_picture examples/scenes/first/lamps.gltf 5

# >>bench: only its operation is tested, not its speed

bench_rows() {
    "$BUILD_DIR/bench" raster --quick --json > "$folder/bench.json" || return
    cat "$folder/bench.json"
    python3 - "$folder/bench.json" << 'END'
import json, sys
rows = json.load(open(sys.argv[1]))["rows"]
assert [(r["kind"], r["size"]) for r in rows] == [("hemicube", 16), ("single", 16), ("hemicube", 32), ("single", 32)], \
    "kinds and sizes of the rows"
for r in rows:
    for key in ("sensors", "sbl_us", "sbl_total_us", "plain_us", "speedup", "fill_us", "over_fill", "draw_us",
                "reduce_us"):
        assert r[key] > 0, key
    assert 0.5 < r["depth_complexity"] < 3, "depth complexity"
    assert r["sbl_total_us"] >= r["sbl_us"], "the total is less than a part"
END
}
plain_check bench_rows

bench_rooms() {
    "$BUILD_DIR/bench" trace --quick --json > "$folder/bench.json" || return
    cat "$folder/bench.json"
    python3 - "$folder/bench.json" << 'END'
import json, sys
scenes = json.load(open(sys.argv[1]))["trace"]["scenes"]
assert [round(s["triangles"], -2) for s in scenes] == [0, 1000], "triangles of the rooms"
for s in scenes:
    rays, views = [w for w in s["ways"] if "rays" in w], [w for w in s["ways"] if "texels" in w]
    assert s["sensors"] > 1000 and s["bvh_bytes"] > 0 and s["growth"] > 0, "the scene"
    assert all(abs(w["mrays"] * w["us"] / w["rays"] - 1) < 0.01 for w in rays), "rays per sensor"
    for ways, most in ((rays, 0.07), (views, 0.12)):
        errors = [w["error"] for w in ways]
        assert errors == sorted(errors, reverse=True) and 0.0005 < errors[-1] and errors[0] < most, "errors"
    assert all(0.2 < p["errors"] < 5 for p in s["nearest_error"]), "errors of the compared sizes"
END
}
plain_check bench_rooms

# >>failures: the exit status is not 0, and stderr has one line

# fails_in_words PROGRAM ARGUMENTS...: the program must fail with one line on stderr
fails_in_words() {
    status=0
    "$BUILD_DIR/$@" > "$folder/said" 2> "$folder/errors" || status=$?
    cat "$folder/errors"
    [ "$status" -gt 0 ] && [ "$status" -lt 126 ] && [ "$(wc -l < "$folder/errors")" = 1 ]
}
without_gl() { (export __EGL_VENDOR_LIBRARY_FILENAMES=/dev/null; fails_in_words "$1" "$folder"); }
for example in minimal host_context host_draw lights reflections vertex_light bake_lightmap bake_vertices \
    paper_metrics; do
    without_folder() { fails_in_words "$example" "$folder/no such folder" draft; }
    case $example in
        # these fail after the work, with the same lines as host_context
        minimal | bake_lightmap | reflections | host_draw | lights) ;;
        *) plain_check "${example}_without_folder" without_folder ;;
    esac
    check "${example}_without_gl" without_gl "$example"
done

report
