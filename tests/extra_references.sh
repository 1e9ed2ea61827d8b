#!/bin/sh
# Extra checks against path-traced pictures, which lie beside the repository in ../shared/references where they exist; skipped elsewhere.
# Run by scripts/test from anywhere, after scripts/build.
set -u
cd "$(dirname "$0")/.." || exit 1
references=../shared/references
scenes=../shared/scenes
passed=0 failed=0 skipped=0
report() { echo "$passed passed, $failed failed, $skipped skipped"; [ "$failed" = 0 ]; exit; }
skip() { echo "  skipped: $1"; skipped=1; report; }

[ -f "$references/compare.py" ] && [ -f "$scenes/cornell_box/cornell_box.obj" ] || skip "no ../shared/references and ../shared/scenes beside the repository"
command -v python3 > /dev/null || skip "no python3"
[ -x build/sbl_render ] || { echo "  build/sbl_render is missing: run scripts/build"; failed=1; report; }
folder=$(mktemp -d) || exit 1
trap 'rm -rf "$folder"' EXIT

# camera NAME FORMAT: of cameras.json
camera() { python3 - "$references/cameras.json" "$1" "$2" <<'END'
import json, sys
c = json.load(open(sys.argv[1]))[sys.argv[2]]
join = lambda values: ','.join(str(v) for v in values)
print(sys.argv[3].format(eye=join(c['eye']), look_at=join(c['look_at']), up=join(c['up']), fov=c['fov'], size='%dx%d' % tuple(c['size']), sky=join(c.get('sky', (0, 0, 0)))))
END
}

# check NAME SCENE MODE BLOCK MOST_ERROR MOST_BIAS OPTIONS...: renders R with the options and compares means over blocks of pixels
check() {
    name=$1 scene=$2 mode=$3 block=$4 most_error=$5 most_bias=$6
    shift 6
    file=$scenes/$scene/$scene.glb
    [ -f "$file" ] || file=$scenes/$scene/$scene.obj
    [ -f "$file" ] || { echo "  skipped: no $scene"; skipped=$((skipped + 1)); return; }
    # the camera is several words
    if ! build/sbl_render "$file" $(camera "$scene" '--eye {eye} --look-at {look_at} --up {up} --fov {fov} --size {size} --sky {sky}') --mode "$mode" --quiet \
        --channel radiance -o "$folder/r.pfm" "$@" > "$folder/log" 2>&1; then
        echo "  $name: sbl_render failed: $(tail -n 1 "$folder/log")"
        echo "FAIL $name"; failed=$((failed + 1)); return
    fi
    line=$(python3 "$references/compare.py" "$references/$scene.$mode.pfm" "$folder/r.pfm" --block "$block" 2>&1)
    echo "  $name: $line"
    if echo "$line" | awk -v e="$most_error" -v b="$most_bias" \
        '$1 == "relRMSE" { ok = $2 <= e && $4 <= b && -$4 <= b && $NF == 0 } END { exit !ok }'; then
        echo "ok   $name"; passed=$((passed + 1))
    else
        echo "  expected relRMSE at most $most_error and a bias within $most_bias"
        echo "FAIL $name"; failed=$((failed + 1))
    fi
}

check direct_light_at_every_pixel cornell_box direct 1 0.008 0.001 --tile 1 --filter-radius 0
check direct_light_default_settings cornell_box direct 1 0.012 0.003
check direct_light_rasterised cornell_box direct 1 0.03 0.003 --backend raster --tile 1 --sensor-size 128
check ambient_light_default_settings cornell_box ambient 1 0.02 0.003
check many_lamps staircase2 direct 4 0.02 0.003
check windows living-room direct 4 0.09 0.01

# rays NAME FILE: traced sensors in a room, see extra_trace.c
rays() {
    [ -f "$scenes/$1/$2" ] || { echo "  skipped: no $2"; skipped=$((skipped + 1)); return; }
    # the camera is several words
    if build/extra_trace "$scenes/$1/$2" $(camera "$1" '{eye} {look_at} {up} {fov}') > "$folder/log" 2>&1; then
        echo "ok   rays_in_$1"; passed=$((passed + 1))
    else
        echo "FAIL rays_in_$1"; failed=$((failed + 1))
    fi
    grep '^  ' "$folder/log"
}
[ -x build/extra_trace ] || { echo "  build/extra_trace is missing: run scripts/build"; failed=1; report; }
rays cornell_box cornell_box.obj
rays veach-ajar veach-ajar.glb
rays staircase2 staircase2.glb
rays living-room living-room.glb
report
