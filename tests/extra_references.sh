#!/bin/sh
# Extra checks against path-traced pictures, which lie beside the repository in ../shared/references where they exist; skipped elsewhere.
# Run by scripts/test from anywhere, after scripts/build.
set -u
cd "$(dirname "$0")/.." || exit 1
references=../shared/references
box=../shared/scenes/cornell_box/cornell_box.obj
passed=0 failed=0 skipped=0
report() { echo "$passed passed, $failed failed, $skipped skipped"; [ "$failed" = 0 ]; exit; }
skip() { echo "  skipped: $1"; skipped=1; report; }

[ -f "$references/compare.py" ] && [ -f "$box" ] || skip "no ../shared/references and ../shared/scenes beside the repository"
command -v python3 > /dev/null || skip "no python3"
[ -x build/sbl_render ] || { echo "  build/sbl_render is missing: run scripts/build"; failed=1; report; }
folder=$(mktemp -d) || exit 1
trap 'rm -rf "$folder"' EXIT

cameras() { python3 - "$references/cameras.json" "$1" "$2" <<'END'
import json, sys
c = json.load(open(sys.argv[1]))[sys.argv[2]]
join = lambda values: ','.join(str(v) for v in values)
print(sys.argv[3] % (join(c['eye']), join(c['look_at']), join(c['up']), c['fov'], *c['size'][:sys.argv[3].count('%d')]))
END
}
camera=$(cameras cornell_box '--eye %s --look-at %s --up %s --fov %s --size %dx%d') || exit 1

# check NAME REFERENCE MOST_ERROR MOST_BIAS OPTIONS...: renders R with the options and compares
check() {
    name=$1 reference=$2 most_error=$3 most_bias=$4
    shift 4
    # $camera is several words
    if ! build/sbl_render "$box" $camera --quiet --channel radiance -o "$folder/r.pfm" "$@" > "$folder/log" 2>&1; then
        echo "  $name: sbl_render failed: $(tail -n 1 "$folder/log")"
        echo "FAIL $name"; failed=$((failed + 1)); return
    fi
    line=$(python3 "$references/compare.py" "$references/$reference.pfm" "$folder/r.pfm" 2>&1)
    echo "  $name: $line"
    if echo "$line" | awk -v e="$most_error" -v b="$most_bias" \
        '$1 == "relRMSE" { ok = $2 <= e && $4 <= b && -$4 <= b && $NF == 0 } END { exit !ok }'; then
        echo "ok   $name"; passed=$((passed + 1))
    else
        echo "  expected relRMSE at most $most_error and a bias within $most_bias"
        echo "FAIL $name"; failed=$((failed + 1))
    fi
}

check direct_light_at_every_pixel cornell_box.direct 0.03 0.003 --mode direct --tile 1 --sensor-size 128
check direct_light_default_settings cornell_box.direct 0.05 1 --mode direct
check ambient_light_default_settings cornell_box.ambient 0.05 1 --mode ambient

# rays NAME FILE: traced sensors in a room, see extra_trace.c
rays() {
    [ -f "../shared/scenes/$1/$2" ] || { echo "  skipped: no $2"; skipped=$((skipped + 1)); return; }
    # the camera is several words
    if build/extra_trace "../shared/scenes/$1/$2" $(cameras "$1" '%s %s %s %s') > "$folder/log" 2>&1; then
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
