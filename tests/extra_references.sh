#!/bin/sh
# Compares pictures with path-traced pictures in ../shared/references. It skips all tests if these do not exist.
# scripts/test runs it after scripts/build.
set -u
cd "$(dirname "$0")/.." || exit 1
references=../shared/references
scenes=../shared/scenes
. tests/support/check.sh

[ -f "$references/compare.py" ] && [ -f "$scenes/cornell_box/cornell_box.obj" ] || {
    skip references "no ../shared/references and ../shared/scenes beside the repository"
    report
}
command -v python3 > /dev/null || { skip references "no python3"; report; }

# camera NAME FORMAT: prints a camera of cameras.json
camera() { python3 - "$references/cameras.json" "$1" "$2" <<'END'
import json, sys
c = json.load(open(sys.argv[1]))[sys.argv[2]]
join = lambda values: ','.join(str(v) for v in values)
print(sys.argv[3].format(eye=join(c['eye']), look_at=join(c['look_at']), up=join(c['up']), fov=c['fov'],
                         size='%dx%d' % tuple(c['size']), sky=join(c.get('sky', (0, 0, 0)))))
END
}

exec 3>&1  # lines on descriptor 3 are shown even if the test passes

# file_of SCENE: prints the path of the scene
file_of() {
    for file in "$scenes/$1/$1.glb" "$scenes/$1/$1.obj"; do
        [ ! -f "$file" ] || { echo "$file"; return; }
    done
    return 1
}

# compare SCENE MODE BLOCK MOST_ERROR MOST_BIAS OPTIONS...: renders R with the options, and compares the means of blocks
# of pixels
compare() {
    scene=$1 mode=$2 block=$3 most_error=$4 most_bias=$5
    shift 5
    # the words of the camera become arguments
    build/sbl_render "$(file_of "$scene")" \
        $(camera "$scene" '--eye {eye} --look-at {look_at} --up {up} --fov {fov} --size {size} --sky {sky}') \
        --mode "$mode" --quiet --channel radiance -o "$folder/r.pfm" "$@" || return
    python3 "$references/compare.py" "$references/$scene.$mode.pfm" "$folder/r.pfm" --block "$block" > "$folder/line" \
        2>&1
    sed "s/^/  $name: /" "$folder/line" >&3
    echo "$(cat "$folder/line"); expected: relRMSE at most $most_error and a bias within $most_bias"
    awk -v e="$most_error" -v b="$most_bias" \
        '$1 == "relRMSE" { ok = $2 <= e && $4 <= b && -$4 <= b && $NF == 0 } END { exit !ok }' "$folder/line"
}
# against NAME SCENE ...: runs `compare` as a test
against() {
    file_of "$2" > /dev/null || { skip "$1" "no $2"; return; }
    compared=$1
    shift
    check "$compared" compare "$@"
}

against direct_light_at_every_pixel cornell_box direct 1 0.007 0.0005 --tile 1 --rays 256 --filter-radius 0
against direct_light_default_settings cornell_box direct 1 0.0155 0.001
against direct_light_half_a_percent cornell_box direct 1 0.0085 0.001 --error 0.5%
against direct_light_rasterised cornell_box direct 1 0.014 0.0015 --backend raster --sensor-size 64
against ambient_light_default_settings cornell_box ambient 1 0.018 0.001
against many_lamps staircase2 direct 4 0.012 0.0015
against windows living-room direct 4 0.07 0.004 --error 8%

# rays SCENE: tests traced sensors in a room (see extra_trace.c)
rays() {
    # the words of the camera become arguments
    build/extra_trace "$(file_of "$1")" $(camera "$1" '{eye} {look_at} {up} {fov}') > "$folder/rays"
    status=$?
    grep '^  ' "$folder/rays" >&3
    cat "$folder/rays"
    return $status
}
for scene in cornell_box veach-ajar staircase2 living-room; do
    if file_of "$scene" > /dev/null; then check "rays_in_$scene" rays "$scene"
    else skip "rays_in_$scene" "no $scene"; fi
done
report
