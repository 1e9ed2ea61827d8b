#!/bin/sh
# Tests of scripts/install. The installed files must work with pkg-config, CMake and man, and --uninstall must remove
# all of them.
set -u
export LC_ALL=C
cd "$(dirname "$0")/.." || exit 1
. tests/support/check.sh
umask 077  # strict, as root's may be; others must be able to read the installed files anyway

prefix="$folder/a prefix" stage="$folder/a stage"  # spaces must not end a path
list() { (cd "$1" && find . -type f | sort); }
cat > "$folder/expected" << 'END'
./bin/sbl_bake
./bin/sbl_merge
./bin/sbl_render
./bin/sbl_unwrap
./include/sbl.h
./lib/sbl/node_modules/watlas/LICENSE
./lib/sbl/node_modules/watlas/dist/watlas.js
./lib/sbl/node_modules/watlas/dist/watlas.wasm
./lib/sbl/node_modules/watlas/package.json
./lib/sbl/scene_to_gltf
./share/cmake/sbl/sblConfig.cmake
./share/cmake/sbl/sblConfigVersion.cmake
./share/man/man1/sbl_bake.1
./share/man/man1/sbl_merge.1
./share/man/man1/sbl_render.1
./share/man/man1/sbl_unwrap.1
./share/pkgconfig/sbl.pc
END
# files that are not installed without watlas of npm in build/, or without node
[ -f build/node_modules/watlas/dist/watlas.wasm ] || sed -i /watlas/d "$folder/expected"
command -v node > /dev/null || sed -i /sbl_unwrap.1/d "$folder/expected"
view=
if pkg-config --exists glfw3; then  # without GLFW sbl_view is not built
    view=sbl_view
    printf './bin/sbl_view\n./share/man/man1/sbl_view.1\n' >> "$folder/expected"
    sort -o "$folder/expected" "$folder/expected"
fi

installs() {
    PREFIX=$prefix scripts/install && list "$prefix" > "$folder/list" && same "$folder/expected" "$folder/list"
}
stages() {
    PREFIX=/opt/sbl DESTDIR=$stage scripts/install && list "$stage/opt/sbl" > "$folder/list" &&
    same "$folder/expected" "$folder/list" && grep -qx 'prefix=/opt/sbl' "$stage/opt/sbl/share/pkgconfig/sbl.pc"
}
stages_relatively() {
    root=$PWD
    (cd "$folder" && PREFIX=/usr DESTDIR=here "$root/scripts/install") && [ -f "$folder/here/usr/include/sbl.h" ]
}
is_readable() {
    [ "$(find "$prefix" -type d ! -perm 755 | grep -vcx "$prefix")" = 0 ] &&
    [ "$(find "$prefix" -type f ! -perm -444 | wc -l)" = 0 ] &&
    [ "$(find "$prefix" -type f -perm 755 | sort | sed 's:.*/::' | tr '\n' ' ')" = \
        "sbl_bake sbl_merge sbl_render sbl_unwrap ${view:+$view }scene_to_gltf " ] &&
        same sbl.h "$prefix/include/sbl.h"
}
refuses() { ! "$@" > "$folder/said" 2>&1 && cat "$folder/said" && [ "$(wc -l < "$folder/said")" = 1 ]; }
check installs installs
check is_readable is_readable
check stages stages
check stages_relatively stages_relatively
check refuses_a_relative_prefix refuses env PREFIX=opt DESTDIR="$folder/no" scripts/install
check refuses_an_unknown_option refuses env PREFIX="$folder/no" scripts/install --remove

# >>the tools

tool_runs() { (cd / && "$prefix/bin/$1" --version) | grep -qx "$1 $version"; }
version=$(sed -n 's/^ *sbl_version *"\([0-9.]*\)"$/\1/p' sbl.h | head -n 1)
for tool in sbl_render sbl_bake sbl_merge $view; do check ${tool}_runs tool_runs $tool; done
unwraps() {
    (cd / && "$prefix/bin/sbl_unwrap" "$OLDPWD/examples/scenes/two_rooms.obj" "$folder/rooms.glb" 64) &&
    [ "$(head -c 4 "$folder/rooms.glb")" = glTF ]
}
tools="sbl_render sbl_bake sbl_merge $view"
if command -v node > /dev/null; then
    tools="$tools sbl_unwrap"
    check sbl_unwrap_runs tool_runs sbl_unwrap
fi
if grep -q wasm "$folder/expected" && command -v node > /dev/null; then check sbl_unwrap_finds_its_package unwraps
else skip sbl_unwrap_finds_its_package "npm's watlas is missing (scripts/setup --unwrap)"; fi

# >>a program that uses the installed header, and checks this

cat > "$folder/program.c" << 'END'
#define SBL_IMPLEMENTATION
#define SBL_EGL
#include <sbl.h>
int main(void) {
    sbl_context *context = NULL;
    sbl_result result = sbl_create(NULL, &context);
    sbl_destroy(context);
    printf("%s %s\n", sbl_version(), sbl_result_string(result));
    return result != SBL_SUCCESS;
}
END
program_says() { "$1" > "$folder/said" && cat "$folder/said" && grep -qx "$version success" "$folder/said"; }
with_pkg_config() {
    export PKG_CONFIG_PATH="$prefix/share/pkgconfig"
    [ "$(pkg-config --modversion sbl)" = "$version" ] &&
    [ "$(pkg-config --variable=includedir sbl)" = "$prefix/include" ] &&
    eval "gcc \"$folder/program.c\" $(pkg-config --cflags --libs sbl) -o \"$folder/by_pkg_config\"" &&
    program_says "$folder/by_pkg_config"
}
check with_pkg_config with_pkg_config

# cmake_project VERSION PREFIX: configures a project that requires this version
cmake_project() {
    rm -rf "$folder/project"
    mkdir -p "$folder/project"
    cp "$folder/program.c" "$folder/project"
    cat > "$folder/project/CMakeLists.txt" << END
cmake_minimum_required(VERSION 3.5...3.25)
project(program C)
find_package(sbl $1 REQUIRED)
find_package(sbl $1 REQUIRED)  # another package may depend on it
add_executable(program program.c)
target_link_libraries(program PRIVATE sbl::sbl)
END
    cmake -S "$folder/project" -B "$folder/project/build" -DCMAKE_PREFIX_PATH="$2"
}
with_cmake() {
    cmake_project "$version" "$1" && cmake --build "$folder/project/build" &&
    program_says "$folder/project/build/program"
}
# cmake_refuses VERSION PREFIX INSTALLED-VERSION: CMake must refuse the required version and name the installed one
cmake_refuses() {
    ! cmake_project "$1" "$2" > "$folder/said" 2>&1 && grep -q "sblConfig.cmake, version: $3" "$folder/said"
}
# the test changes the installed version to 2.1.0
cmake_refuses_a_former_major() {
    sed -i "s/ $version)/ 2.1.0)/; s/EQUAL ${version%%.*})/EQUAL 2)/" \
        "$stage/opt/sbl/share/cmake/sbl/sblConfigVersion.cmake" &&
    cmake_project 2.0 "$stage/opt/sbl" && cmake_refuses 1.9 "$stage/opt/sbl" 2.1.0
}
if command -v cmake > /dev/null; then
    check with_cmake with_cmake "$prefix"
    check with_cmake_moved with_cmake "$stage/opt/sbl"
    check with_cmake_any_version cmake_project "" "$prefix"
    check cmake_refuses_a_later_one cmake_refuses 99 "$prefix" "$version"
    check cmake_refuses_a_former_major cmake_refuses_a_former_major
else
    skip with_cmake "cmake is missing"
fi

# >>the manual pages

page_of() { page=$prefix/share/man/man1/$1.1; }
page_has_all() {
    page_of "$1"
    "$prefix/bin/$1" --help all | grep -o '^  --[a-z-]*' | while read -r option; do
        grep -q "^$(echo "$option" | sed 's/-/\\\\-/g')" "$page" || { echo "$option is missing"; return 1; }
    done && [ "$(grep -c '^[.]SS' "$page")" -ge 5 ] &&
    for section in NAME SYNOPSIS DESCRIPTION OPTIONS NOTES 'EXIT STATUS'; do
        [ "$(grep -cx ".SH $section" "$page")" = 1 ] || { echo "section $section"; return 1; }
    done && ! sed '1,/^.SH EXIT/d' "$page" | grep '^[.]'
}
# the manual page must contain all words of --help all, in order
words() { tr -s ' \n' '\n\n' | grep -v '^$'; }
page_says_what_help_says() {
    page_of "$1"
    "$prefix/bin/$1" --help all | sed 's/^usage: //; s/^Exit status: //' | words > "$folder/help"
    sed -e '1,/^.SH SYNOPSIS/d' -e '/^\.[ST][HP]/d' -e '/^\.PP/d' -e '/^\.br/d' \
        -e 's/^\.SS //; s/^\\&//; s/\\-/-/g; s/\\e/\\/g' "$page" |
    words > "$folder/page"
    same "$folder/help" "$folder/page"
}
page_for_groff() { page_of "$1" && groff -man -ww -z "$page" > "$folder/said" 2>&1; nothing "$folder/said"; }
page_is_clean() { page_of "$1" && mandoc -T lint -W warning "$page"; }
for tool in $tools; do
    [ $tool = sbl_merge ] || check "page_has_all ($tool)" page_has_all $tool  # sbl_merge has only one group of options
    check "page_says_what_help_says ($tool)" page_says_what_help_says $tool
    if command -v mandoc > /dev/null; then check "page_is_clean ($tool)" page_is_clean $tool
    else skip page_is_clean "mandoc is missing"; fi
    if command -v groff > /dev/null; then check "page_for_groff ($tool)" page_for_groff $tool
    else skip page_for_groff "groff is missing"; fi
done

# >>uninstalling

uninstalls() {
    mkdir -p "$prefix/share/cmake/other" && echo mine > "$prefix/share/man/man1/other.1"
    PREFIX=$prefix scripts/install --uninstall && [ "$(list "$prefix")" = ./share/man/man1/other.1 ] &&
    [ ! -d "$prefix/share/cmake/sbl" ]
}
uninstalls_staged() { PREFIX=/opt/sbl DESTDIR=$stage scripts/install --uninstall && [ -z "$(list "$stage")" ]; }
uninstalls_nothing() { PREFIX=$prefix scripts/install --uninstall; }
check uninstalls uninstalls
check uninstalls_staged uninstalls_staged
check uninstalls_what_is_not_there uninstalls_nothing

report
