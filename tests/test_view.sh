#!/bin/sh
# Tests of sbl_view on a virtual X server: the contents of the window, keys and mouse, saved pictures, and messages
# without a display. tests/support/screen.py compares pictures.
set -u
export LC_ALL=C LIBGL_ALWAYS_SOFTWARE=1
cd "$(dirname "$0")/.." || exit 1
. tests/support/check.sh

box=examples/scenes/cornell_box.obj lamps=examples/scenes/lights.gltf
width=128 height=96 root=$PWD

screen() { python3 tests/support/screen.py "$@"; }
shot() { screen shot "$folder/screen/Xvfb_screen0" $width $height "$folder/$1.ppm"; }
xdo() { timeout 20 xdotool "$@"; }
# said FILE TEXT COUNT: waits until the viewer has printed TEXT to FILE COUNT times, for at most 100 s
said() {
    tries=0
    until [ "$(grep -c -- "$2" "$1")" -ge "$3" ]; do
        tries=$((tries + 1))
        [ $tries -lt 1000 ] && kill -0 "$viewer" 2> /dev/null || { cat "$1"; return 1; }
        sleep 0.1
    done
}
# finished COUNT: waits until COUNT pictures are finished, and until the window shows the last one
finished() { said "$folder/err" 'picture is finished' "$1" && sleep 0.3; }
# opens SCENE OPTIONS...: starts the viewer in the folder of the test
opens() {
    scene=$1
    shift
    (cd "$folder" && exec "$root/build/sbl_view" "$root/$scene" "$@" --size ${width}x$height --preset draft --verbose \
        > "$folder/out" 2> "$folder/err") &
    viewer=$!
    window= tries=0
    until [ -n "$window" ]; do
        tries=$((tries + 1))
        [ $tries -lt 300 ] && kill -0 "$viewer" 2> /dev/null || { cat "$folder/err"; return 1; }
        sleep 0.1
        window=$(xdo search --name "$(basename "$scene")")
    done
    xdo windowfocus "$window"
}
ends() { xdo key Escape && wait "$viewer"; }

gets_better() {
    opens $box -o "$folder/saved.png" && said "$folder/err" 'light: ' 1 && sleep 0.3 && shot early && finished 1 &&
        shot first && screen differ "$folder/early.ppm" "$folder/first.ppm" 1
}
saves_the_window() { xdo key s && said "$folder/out" saved 1 && screen same "$folder/first.ppm" "$folder/saved.png"; }
agrees_with_the_tool() {
    build/sbl_render $box --size ${width}x$height --preset draft -o "$folder/tool.png" &&
        screen same "$folder/tool.png" "$folder/saved.png"
}
title_tells_the_error() {
    xdo getwindowname "$window" | tee "$folder/title" | grep -q '100 %, error [0-9.]* % (target 5 %)'
}
click_draws_rays() {
    xdo mousemove 64 80 click 1 && said "$folder/out" '^from lamps .* rays towards them' 1 && sleep 0.3 && shot rays &&
        screen differ "$folder/first.ppm" "$folder/rays.ppm" 2 && screen count "$folder/rays.ppm" 229,64,51 2 4 &&
        xdo key BackSpace && sleep 0.3 && shot clean && screen same "$folder/first.ppm" "$folder/clean.ppm"
}
exposure_changes_by_key() {
    xdo key minus && sleep 0.3 && shot darker && screen brighter "$folder/darker.ppm" "$folder/first.ppm" &&
        xdo key plus && sleep 0.3 && shot again && screen same "$folder/first.ppm" "$folder/again.ppm" 30 &&
        ! screen differ "$folder/first.ppm" "$folder/again.ppm" 0.3
}
channel_changes_by_key() {
    xdo key 4 && sleep 0.3 && shot normals && screen count "$folder/normals.ppm" 128,255,128 1 100 && xdo key 1 x &&
        sleep 0.3 && shot back && screen same "$folder/first.ppm" "$folder/back.ppm"
}
orbit_changes_it() {
    xdo mousemove 64 48 mousedown 1 mousemove_relative 20 4 mousemove_relative 10 0 mouseup 1 && finished 2 &&
        shot orbit && screen differ "$folder/first.ppm" "$folder/orbit.ppm" 8 && xdo key c &&
        said "$folder/out" '^--eye .* --size' 1
}
resizes() {
    width=96 height=64
    xdo windowsize "$window" 96 64 && finished 3 && xdo key s && said "$folder/out" saved 2 && shot resized &&
        screen same "$folder/resized.ppm" "$folder/saved.png"
}
# titled TEXT: waits until the title of the window contains TEXT, for at most 20 s
titled() {
    tries=0
    until xdo getwindowname "$window" | grep -qF -- "$1"; do
        tries=$((tries + 1))
        [ $tries -lt 200 ] && kill -0 "$viewer" 2> /dev/null || { xdo getwindowname "$window"; return 1; }
        sleep 0.1
    done
}
# camera NAME: saves the camera, as the viewer prints it
camera() {
    cameras=$(grep -c '^--eye' "$folder/out")
    xdo key c && said "$folder/out" '^--eye' $((cameras + 1)) && grep '^--eye' "$folder/out" | tail -n 1 \
        > "$folder/$1.camera"
}
# holds KEY NAME: holds a key until the camera has moved, and saves the camera. It has moved from that of `before`
holds() {
    camera before && xdo keydown "$1" && tries=0
    until camera "$2" && ! diff -q "$folder/before.camera" "$folder/$2.camera" > /dev/null; do
        tries=$((tries + 1))
        [ $tries -lt 100 ] || break
    done
    xdo keyup "$1"
}
# drags BUTTON NAME: drags by 40 pixels to the right from the middle of the window, and saves the camera
drags() {
    xdo mousemove 48 32 mousedown "$1" mousemove_relative 20 0 mousemove_relative 20 0 mouseup "$1" && camera "$2"
}
# What the mouse and the keys do to the camera has closed forms. The window has 96 x 64 pixels.
keys_and_mouse_move_the_camera() {
    xdo mousemove 48 32 && camera start && xdo click 4 && camera wheel && xdo key Home && camera home &&
        grep -qF -- "$(cut -d ' ' -f 1-8 "$folder/home.camera")" "$folder/err" && drags 3 look && drags 1 orbit &&
        drags 2 shift && holds Up ahead && cp "$folder/before.camera" "$folder/1.camera" && holds Right right &&
        cp "$folder/before.camera" "$folder/2.camera" && holds Prior up && cp "$folder/before.camera" \
        "$folder/3.camera" && python3 tests/support/cameras.py "$folder" 96 64
}
# A click in a preview, which has fewer pixels than the window, inspects the pixel of the picture below the mouse.
click_in_a_preview() {
    xdo mousemove 80 48 key r sleep 0.1 click 1 && said "$folder/out" '^pixel 80,48: ' 1
}
keys_change_the_title() {
    xdo key x && titled ' (auto), neutral, final' && xdo key t && titled ', agx, final' && xdo key t &&
        titled ', none, final' && xdo key t && titled ', neutral, final' && xdo key bracketleft &&
        titled ', neutral, specular_albedo' && xdo key bracketright && titled ', neutral, final' && xdo key 0 &&
        titled ', neutral, error' && xdo key 6 && titled ', neutral, depth' && xdo key 1 &&
        titled ', neutral, final' && stops=$(exposure) && xdo key plus && titled "$(stops_more 0.25)," &&
        xdo key minus minus && titled "$(stops_more -0.25)," && xdo key x && titled ' (auto), '
}
direct_light_by_key() {
    titled ' - 100 %' && sleep 0.3 && shot all && xdo key m && becomes differ all 5
}
exposure() { xdo getwindowname "$window" | sed 's/.*exposure \([-+0-9.]*\).*/\1/'; }
stops_more() { awk -v stops="$stops" -v more="$1" 'BEGIN { printf "exposure %+.2f\n", stops + more }'; }
light_moves() {
    width=128 height=96
    opens $lamps && finished 1 && shot lamps && xdo key l && sleep 0.3 && xdo key Right key Right key Right &&
        finished 2 && xdo key l key l key l && sleep 0.3 && shot moved &&
        screen differ "$folder/lamps.ppm" "$folder/moved.ppm" 1
}
# becomes RELATION NAME NUMBERS...: waits until the window is "same" as or "differ"s from the picture NAME
becomes() {
    relation=$1 picture=$2 tries=0
    shift 2
    until shot now && screen "$relation" "$folder/$picture.ppm" "$folder/now.ppm" "$@"; do
        tries=$((tries + 1))
        [ $tries -lt 200 ] && kill -0 "$viewer" 2> /dev/null || return 1
        sleep 0.1
    done
}
# Three keys halve the light three times, and three further keys double it three times. The picture is then the same as
# before, to the bit.
light_is_dimmed() {
    xdo key l key comma key comma key comma key l key l key l && becomes differ moved 1 &&
        xdo key l key period key period key period key l key l key l && becomes same moved
}
saves_under_new_names() {
    xdo key s && said "$folder/out" '^saved sbl_view_1.png' 1 && xdo key s &&
        said "$folder/out" '^saved sbl_view_2.png' 1 && screen same "$folder/moved.ppm" "$folder/sbl_view_1.png" &&
        screen same "$folder/moved.ppm" "$folder/sbl_view_2.png"
}
light_is_dragged() {
    xdo key c && said "$folder/out" '^--eye' 1 && xdo key l && sleep 0.3 && shot marked &&
        at=$(marked_at "$folder/moved.ppm" "$folder/marked.ppm") && [ -n "$at" ] &&
        count=$(grep -c 'picture is finished' "$folder/err") &&
        xdo mousemove $at mousedown 1 mousemove_relative 20 0 mousemove_relative 20 0 mouseup 1 &&
        finished $((count + 1)) && xdo key l key l key l && sleep 0.3 && shot dragged &&
        screen differ "$folder/moved.ppm" "$folder/dragged.ppm" 1 && xdo key c && said "$folder/out" '^--eye' 2 &&
        [ "$(grep '^--eye' "$folder/out" | sort -u | wc -l)" = 1 ] && ends  # all printed cameras are the same
}
# marked_at BEFORE AFTER: prints the centre of the pixels that have become yellow
marked_at() {
    python3 - "$1" "$2" << 'END'
import sys
def read(path):
    data = open(path, "rb").read().split(b"\n", 3)
    return int(data[1].split()[0]), data[3]
(width, a), (_, b) = read(sys.argv[1]), read(sys.argv[2])
new = [i // 3 for i in range(0, len(b), 3) if a[i:i + 3] != b[i:i + 3] and b[i] > 230 and b[i + 2] < 80]
if new:
    print(sum(i % width for i in new) // len(new), sum(i // width for i in new) // len(new))
END
}
histogram_is_complete() {
    build/sbl_view $box --size 32x32 --preset draft --mode direct --once -o "$folder/tiny.png" \
        --step-histogram "$folder/steps.json" && python3 - "$folder/steps.json" << 'END'
import json, sys
steps = json.load(open(sys.argv[1]))
for name in "wall", "wall_undisturbed", "processor_thread", "processor_process":
    part = steps[name]
    if sum(bin["steps"] for bin in part["histogram"]) != part["steps"]:
        sys.exit("%s: the histogram has %s" % (name, part))
    if part["steps"] and not part["median_ms"] <= part["p99_ms"] <= part["longest_ms"]:
        sys.exit("%s: %s" % (name, part))
walls = [step["wall_ms"] for step in steps["slowest"]]
if walls != sorted(walls, reverse=True) or walls[0] != steps["wall"]["longest_ms"]:
    sys.exit("the slowest steps are %s" % walls)
undisturbed = sum(step["interruptions"] == 0 for step in steps["slowest"])
rest = steps["wall"]["steps"] - steps["wall_undisturbed"]["steps"]
if undisturbed > steps["wall_undisturbed"]["steps"] or len(walls) - undisturbed > rest:
    sys.exit("%d steps are undisturbed; the slowest are %s" % (steps["wall_undisturbed"]["steps"], steps["slowest"]))
if not 1 <= steps["wall"]["steps"] == steps["processor_thread"]["steps"] or not steps["slowest"]:
    sys.exit("%d steps" % steps["wall"]["steps"])
END
}
# refuses STATUS TEXT COMMAND...: the command must end with this status and one line that contains TEXT
refuses() {
    wanted=$1 text=$2 status=0
    shift 2
    "$@" > "$folder/said" 2>&1 || status=$?
    cat "$folder/said"
    [ $status = "$wanted" ] && grep -q -- "$text" "$folder/said" && [ "$(wc -l < "$folder/said")" = 1 ]
}

if ! pkg-config --exists glfw3; then skip view "no GLFW (libglfw3-dev)"
elif ! command -v Xvfb > /dev/null || ! command -v xdotool > /dev/null; then
    skip view "no Xvfb and xdotool (xvfb, xdotool)"
else
    mkdir "$folder/screen"
    : > "$folder/number"
    # the server chooses a free display number and writes it to descriptor 3
    Xvfb -displayfd 3 -screen 0 640x480x24 -fbdir "$folder/screen" 3> "$folder/number" > /dev/null 2>&1 &
    server=$! viewer=$!
    trap 'kill "$viewer" "$server" 2> /dev/null; rm -rf "$folder"' EXIT
    said "$folder/number" '[0-9]' 1
    check no_display refuses 1 'no window can be opened' env -u DISPLAY build/sbl_view $box
    DISPLAY=:$(cat "$folder/number")
    export DISPLAY
    check old_gl refuses 1 'OpenGL 3.3' env MESA_GL_VERSION_OVERRIDE=2.1 build/sbl_view $box
    check no_scene refuses 2 usage build/sbl_view
    check no_overwriting refuses 2 'the name must end in' build/sbl_view $box -o $box
    check histogram_is_complete histogram_is_complete
    check gets_better gets_better
    check saves_the_window saves_the_window
    check agrees_with_the_tool agrees_with_the_tool
    check title_tells_the_error title_tells_the_error
    check click_draws_rays click_draws_rays
    check exposure_changes_by_key exposure_changes_by_key
    check channel_changes_by_key channel_changes_by_key
    check orbit_changes_it orbit_changes_it
    check resizes resizes
    check keys_and_mouse_move_the_camera keys_and_mouse_move_the_camera
    check click_in_a_preview click_in_a_preview
    check keys_change_the_title keys_change_the_title
    check direct_light_by_key direct_light_by_key
    check escape_ends ends
    check light_moves light_moves
    check light_is_dimmed light_is_dimmed
    check saves_under_new_names saves_under_new_names
    check light_is_dragged light_is_dragged
fi
report
