#!/bin/sh
# Tests of the scripts that other tests use, and of all help texts. embed_shaders finds and repairs differences;
# scripts/test counts correctly; the sanitizers work; mutants.txt fits the code.
set -u
export LC_ALL=C
cd "$(dirname "$0")/.." || exit 1
. tests/support/check.sh

# >>embed_shaders, in a copy of the repository

copy="$folder/a copy"
mkdir -p "$copy"
cp -r scripts sbl.h shaders_embedded "$copy"
printf 'void first() {}  // "quoted", back\\slash, \\n, what??= and %%d\n\n\tlast line without an end' > \
    "$copy/shaders_embedded/copy.glsl"
block='/^\/\* >>glsl copy: /,/^\/\* <<glsl \*\/$/'  # its block in sbl.h

finds_the_difference() {
    cp "$copy/sbl.h" "$folder/before"
    ! "$copy/scripts/embed_shaders" --check && cmp "$folder/before" "$copy/sbl.h"
}
mends_it() {
    "$copy/scripts/embed_shaders" && "$copy/scripts/embed_shaders" --check && cp "$copy/sbl.h" "$folder/once" &&
    ! cmp -s "$folder/before" "$folder/once" && "$copy/scripts/embed_shaders" && cmp "$folder/once" "$copy/sbl.h"
}
# the text outside the markers stays the same
keeps_the_rest() {
    for file in before once; do sed "$block d" "$folder/$file" > "$folder/$file.rest"; done
    [ -s "$folder/once.rest" ] && same "$folder/before.rest" "$folder/once.rest"
}
strings_are_the_file() {
    {
        echo '#include <stdio.h>'
        sed -n "$block p" "$copy/sbl.h"
        echo 'int main(void) {'
        echo '    const char *const *line;'
        echo '    for (line = sbl__glsl_copy; *line; line++) fputs(*line, stdout);'
        echo '    return 0; }'
    } > "$folder/print.c"
    { cat "$copy/shaders_embedded/copy.glsl"; echo; } > "$folder/expected"
    gcc -std=c99 -Wall -Wextra -Wpedantic -Werror "$folder/print.c" -o "$folder/print" &&
        "$folder/print" > "$folder/printed" &&
    same "$folder/expected" "$folder/printed"
}
# refused: embed_shaders must fail and leave sbl.h unchanged
refused() {
    cp "$copy/sbl.h" "$folder/broken"
    ! "$copy/scripts/embed_shaders" && cmp "$folder/broken" "$copy/sbl.h"
}
refuses_without_markers() {
    for marker in '>>glsl copy: ' '<<glsl '; do
        awk -v marker="$marker" 'index($0, "/* " marker) == 1 && !done { done = 1; next } { print }' "$folder/once" > \
            "$copy/sbl.h"
        refused || return
    done
    cp "$folder/once" "$copy/sbl.h"
    echo 'void stray() {}' > "$copy/shaders_embedded/stray.glsl"
    refused || return
    rm "$copy/shaders_embedded/stray.glsl" "$copy/shaders_embedded/copy.glsl"
    refused
}
check embed_shaders_finds_the_difference finds_the_difference
check embed_shaders_mends_it_once mends_it
check embed_shaders_keeps_the_rest keeps_the_rest
check embed_shaders_strings_are_the_file strings_are_the_file
check embed_shaders_refuses_without_markers refuses_without_markers

# >>help

every_script_explains_itself() {
    for script in scripts/*; do
        case $script in
            */Makefile | *.py) continue ;;
            */sbl_unwrap) command -v node > /dev/null || continue ;;
        esac
        timeout 60 "$script" --help > "$folder/help" 2>&1 < /dev/null && grep -q "${script#scripts/}" "$folder/help" ||
            { echo "$script:"; cat "$folder/help"; return 1; }
    done
}
check every_script_explains_itself every_script_explains_itself

# help_fits TOOL LINES: --help and --help all have at most 80 columns, and --help has at most LINES lines.
help_fits() {
    "$1" --help > "$folder/help" < /dev/null && "$1" --help all > "$folder/help all" < /dev/null &&
    [ "$(wc -l < "$folder/help")" -le "$2" ] &&
    awk 'length > 80 { print FILENAME ": " $0; wide = 1 } END { exit wide }' "$folder/help" "$folder/help all"
}
for tool in sbl_render sbl_bake sbl_merge sbl_view host_lightmap; do
    if [ -x build/$tool ]; then check "help_fits ($tool)" help_fits build/$tool 40
    else skip "help_fits ($tool)" "build/$tool is missing; scripts/build $tool builds it"; fi
done
if command -v node > /dev/null; then check "help_fits (sbl_unwrap)" help_fits scripts/sbl_unwrap 80  # it has one text
else skip "help_fits (sbl_unwrap)" "node is missing"; fi

# >>scripts/test, in a repository of small fake tests

fake="$folder/fake repository"
rest='/* RUN_PLAIN() */'  # makes scripts/test run a fake test twice: sanitized, and for the rest
# fake_tests NAME|END|LAST-LINE...: runs scripts/test with programs that print LAST-LINE and then execute END. Its
# output is written to $folder/verdict.
fake_tests() {
    rm -rf "$fake"
    mkdir -p "$fake/tests/support" "$fake/build"
    cp -r scripts "$fake"
    # This replaces the real setup, which needs a second to look for what is installed.
    printf '#!/bin/sh\ncase "$*" in --test | "--test --needed") ;; *) exit 1 ;; esac\n' > "$fake/scripts/setup"
    cp tests/support/keep_loaded.c tests/support/driver_memory.c tests/support/*san.supp "$fake/tests/support"
    printf '#include <pthread.h>\nint shared;\n%s;\n%s { shared++; return user; }\n' \
        'void *touch(void *user)' 'void *touch(void *user)' \
        > "$fake/tests/touch.h"
    for spec in "$@"; do
        body=${spec#*|}
        printf '#include <stdio.h>\n#include <stdlib.h>\n#include "touch.h"\n%s { puts("words"); puts("%s"); %s; }\n' \
            "$rest int main(void)" "${body#*|}" "unsigned sleep(unsigned); fflush(stdout); ${body%%|*}; return 0" > \
                "$fake/tests/test_${spec%%|*}.c"
    done
    "$fake/scripts/test" > "$folder/verdict" 2>&1
}
# fails_with COUNTS NAME...: scripts/test must fail and print these counts
fails_with() {
    counts=$1
    shift
    if fake_tests "$@"; then echo "scripts/test succeeds with:"; cat "$folder/verdict"; return 1; fi
    tail -n 1 "$folder/verdict" | grep -qx "$counts" || { cat "$folder/verdict"; return 1; }
}
# env_of NAME=VALUE COMMAND...: runs the command with an environment variable
env_of() { (export "${1?}"; shift; "$@"); }
runs_once_without_a_rest() {
    (rest=; fake_tests "one|exit(0)|3 passed, 0 failed, 1 skipped") || { cat "$folder/verdict"; return 1; }
    tail -n 1 "$folder/verdict" | grep -qx '3 passed, 0 failed, 1 skipped' || { cat "$folder/verdict"; return 1; }
}
one="1 passed, 0 failed, 0 skipped"
good="good|exit(0)|$one"
# scripts/test builds and runs only the named tests, adds up their counts, and starts the one first that took longest in
# the last run. The recorded times are replaced before the second run, because measured times differ between machines.
names_order_and_counts() {
    ! fake_tests "$good" "bad|exit(1)|2 passed, 1 failed, 0 skipped" "slow|exit(0)|3 passed, 0 failed, 1 skipped" ||
        return
    for kind in sanitized rest; do
        grep -Eqx '[0-9]+[.][0-9]+' "$fake/build/took/test_slow.$kind" || { ls "$fake/build/took"; return 1; }
        echo 9 > "$fake/build/took/test_slow.$kind"
        echo 1 > "$fake/build/took/test_good.$kind"
    done
    "$fake/scripts/test" good slow > "$folder/verdict" 2>&1 || { cat "$folder/verdict"; return 1; }
    tail -n 1 "$folder/verdict" | grep -qx '8 passed, 0 failed, 2 skipped' || { cat "$folder/verdict"; return 1; }
    head -n 2 "$fake/build/logs/list" | grep -c test_slow | grep -qx 2 || { cat "$fake/build/logs/list"; return 1; }
    "$fake/scripts/test" good bda > "$folder/verdict" 2>&1
    [ $? = 2 ] && grep -q 'bda.*bad good slow' "$folder/verdict" || { cat "$folder/verdict"; return 1; }
}
check test_takes_names_orders_and_adds_up names_order_and_counts
check test_runs_once_without_a_rest runs_once_without_a_rest
# says VERDICT NAME KIND COUNTS: the last run must have printed this for a kind of run of a test
says() { grep -q "^$1 *test_$2 ($3): $4," "$folder/verdict" || { cat "$folder/verdict"; return 1; }; }
# fails_too NAME COUNTS: both runs of a test must have failed in the last run of scripts/test, with these counts
fails_too() { says FAIL "$1" sanitized "$2" && says FAIL "$1" rest "$2"; }
# sanitized_only NAME: only the sanitized run of a test must have failed
sanitized_only() { says FAIL "$1" sanitized "$none" && says ok "$1" rest "$one"; }
# stopped_for NAME WORDS: the last run must give the reason for which it stopped both runs of a test
stopped_for() { fails_too "$1" "$none" && grep -q "$2" "$fake/build/logs/test_$1.rest"; }
none='0 passed, 1 failed, 0 skipped'
# one run of scripts/test for all tests that fail, each in its own way
check test_adds_up_failures env_of TEST_LIMIT_CPU=1 env_of TEST_LIMIT_WAIT=20 fails_with \
    '17 passed, 20 failed, 0 skipped' "$good" "bad|exit(1)|2 passed, 1 failed, 0 skipped" \
    "crash|abort()|words" "early|exit(0)|words" "late|abort()|3 passed, 0 failed, 0 skipped" \
    "status|exit(3)|3 passed, 0 failed, 0 skipped" "empty|exit(0)|0 passed, 0 failed, 0 skipped" \
    "round|for (;;) rand()|words" "wait|sleep(999)|words" \
    "overflow|volatile char *p = malloc(5); p[getenv(\"PATH\") ? 5 : 0] = 1; free((void *)p)|$one" \
    "leak|char *volatile p = malloc(5); if (p) p = NULL|$one" \
    "undefined|volatile int i = 0x7fffffff; i = i + 1|$one" \
    "threads|pthread_t t; pthread_create(&t, NULL, touch, NULL); shared++; pthread_join(t, NULL)|$one"
check test_fails_on_a_failure fails_too bad '2 passed, 1 failed, 0 skipped'
check test_fails_on_a_crash fails_too crash "$none"
check test_fails_on_an_early_exit fails_too early "$none"
check test_fails_on_a_crash_after_the_counts fails_too late "$none"
check test_fails_on_a_bad_exit_status fails_too status '3 passed, 1 failed, 0 skipped'
check test_fails_on_a_test_that_runs_nothing fails_too empty "$none"
check test_stops_what_goes_round_for_ever stopped_for round 'stopped after 1 s of processor time'
check test_stops_what_waits_for_ever stopped_for wait 'hung: stopped after 20 s'
# only sanitizers find these errors
check test_sees_a_heap_overflow sanitized_only overflow
check test_sees_a_leak sanitized_only leak
check test_sees_undefined_behaviour sanitized_only undefined
sees_a_race() { says ok threads sanitized "$one" && says ok threads rest "$one" && says FAIL threads threads "$none"; }
check test_sees_a_race sees_a_race
check test_fails_on_what_does_not_compile fails_with '0 passed, 1 failed, 0 skipped' "$good" \
    "typo|x|1 passed, 0 failed, 0 skipped"
check test_fails_without_tests fails_with '0 passed, 0 failed, 0 skipped'
# >>scripts/build

build_helps() {
    scripts/build --help > "$folder/said" && grep -q 'scripts/build sbl_render sbl_bake' "$folder/said" &&
        for file in examples/*.c tests/test_*.c; do
            grep -qw "$(basename "$file" .c)" "$folder/said" || { echo "$file is missing"; return 1; }
        done
}
build_names_what_is_unknown() {
    scripts/build sbl_rendr > "$folder/said" 2>&1
    [ $? = 2 ] && grep -q 'sbl_rendr.*--help' "$folder/said" && [ "$(wc -l < "$folder/said")" = 1 ]
}
check build_helps build_helps
check build_names_what_is_unknown build_names_what_is_unknown

# >>the sanitizers and the mutants

# builds_leak FLAGS...: builds the program that leaks
builds_leak() { gcc -std=c99 -fsanitize=address,undefined tests/header/leak.c "$@" -lEGL -lm -o "$folder/leak"; }
leak_is_seen() {
    # the objects that the sanitized tests usually leave save the time of compiling sbl.h
    made=$(find build/sanitize/sbl.o -newer sbl.h 2> /dev/null)
    { [ "$made" ] && builds_leak -DSBL_IMPLEMENTATION_INCLUDED "$made" build/sanitize/keep_loaded.o \
        build/sanitize/driver_memory.o; } || builds_leak || return
    ! ASAN_OPTIONS=detect_leaks=1 LSAN_OPTIONS=suppressions=tests/support/lsan.supp "$folder/leak" &&
        grep -q 'LeakSanitizer: detected' "$folder/log"
}
check a_lost_context_is_seen leak_is_seen
check mutants_fit_the_header tests/tools/mutants --check

# >>unwrap

unwrap_without_blender() {
    ! env PATH=/nowhere /bin/sh scripts/unwrap examples/scenes/cornell_box.obj "$folder/u.glb" > "$folder/said" 2>&1
    cat "$folder/said"
    grep -q blender "$folder/said"
}
unwrap_usage() {
    scripts/unwrap examples/scenes/cornell_box.obj > "$folder/said" 2>&1
    [ $? = 2 ] && grep -q 'SCENE OUT.glb' "$folder/said" &&
        { scripts/unwrap examples/scenes/cornell_box.obj "$folder/u.obj" 2> "$folder/said"; [ $? = 2 ]; } &&
        { scripts/unwrap examples/scenes/cornell_box.obj "$folder/u.glb" --size 512 2> "$folder/said"; [ $? = 2 ]; } &&
            grep -q numbers "$folder/said"
}
# the charts do not touch and begin at whole texels; therefore nothing overlaps or is outside the map
unwrap_box() {
    scripts/unwrap examples/scenes/cornell_box.obj "$folder/u.glb" 128 66 6 &&
    build/sbl_bake "$folder/u.glb" --lightmap 128 --mode direct --preset draft -o "$folder/baked" > "$folder/said" \
        2>&1 || { cat "$folder/said"; return 1; }
    cat "$folder/said"
    [ ! -s "$folder/said" ] && [ ! -e "$folder/baked/overlap.png" ] && [ -s "$folder/baked/lightmap.exr" ]
}
check unwrap_without_blender unwrap_without_blender
check unwrap_usage unwrap_usage
# This program named blender only prints that it was called. Therefore the checks before this call can be tested without
# Blender.
mkdir -p "$folder/stub" "$folder/inside/deep"
printf '#!/bin/sh\necho "unwrap: called"\n' > "$folder/stub/blender"
chmod +x "$folder/stub/blender"
unwrap_stub() { PATH="$folder/stub:$PATH" scripts/unwrap "$1" "$folder/u.glb" > "$folder/said" 2>&1; }
unwrap_accepts() { unwrap_stub "$1" || { cat "$folder/said"; return 1; }; }
unwrap_refuses() { ! unwrap_stub "$1" && grep -q "^unwrap: $1: " "$folder/said" && ! grep -q called "$folder/said"; }
unwrap_stops() {
    printf '#!/bin/sh\nexec sleep 60\n' > "$folder/stub/blender"
    ! UNWRAP_LIMIT=1 unwrap_stub examples/scenes/cornell_box.obj && grep -q 'blender failed' "$folder/said"
}
echo secret > "$folder/secret"
ln -s ../secret "$folder/inside/link"
mkfifo "$folder/inside/pipe"
# unwrap_files VERDICT CASE NAME [FILE]: tests scenes that refer to a buffer, a picture, a material library and a
# texture by this name, or only the scene FILE. VERDICT: accepts or refuses
unwrap_files() {
    printf '{ "buffers": [{ "byteLength": 1, "uri": "%s" }] }\n' "$3" > "$folder/inside/buffer.gltf"
    printf '{ "images": [{ "extensions": { "X": { "uri": "%s" } } }] }\n' "$3" > "$folder/inside/picture.gltf"
    printf 'mtllib %s\nv 0 0 0\n' "$3" > "$folder/inside/library.obj"
    printf 'newmtl m\nmap_Kd -o 0.5 0.5 0 %s\n' "$3" > "$folder/inside/texture.mtl"
    printf 'mtllib \\\ntexture.mtl\nv 0 0 0\n' > "$folder/inside/texture.obj"
    for kind in ${4-buffer.gltf picture.gltf library.obj texture.obj}; do
        check "unwrap_$1_${2}_${kind%.*}" "unwrap_$1" "$folder/inside/$kind"
    done
}
unwrap_files accepts inside deep/none.png
unwrap_files refuses above ../secret
unwrap_files refuses absolute "$folder/secret" picture.gltf
unwrap_files refuses link link texture.obj
unwrap_files refuses pipe pipe buffer.gltf
unwrap_files refuses roundabout deep/../../secret library.obj
check unwrap_refuses_an_encoded_name eval "printf '{ \"buffers\": [{ \"uri\": \"%%2e%%2e/secret\" }] }' > \
    '$folder/inside/encoded.gltf'; unwrap_refuses '$folder/inside/encoded.gltf'"
check unwrap_refuses_a_pipe unwrap_refuses "$folder/inside/pipe"
check unwrap_stops unwrap_stops
if command -v blender > /dev/null; then check unwrap_box unwrap_box; else skip unwrap_box "no blender"; fi

report
