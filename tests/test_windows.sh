#!/bin/sh
# Tests for Windows and macOS that run on Linux. mingw-w64 compiles and links with windows.h; wine runs the programs,
# which must draw the same as on Linux; and Mesa simulates GL 4.1.
set -u
export LC_ALL=C
cd "$(dirname "$0")/.." || exit 1
. tests/support/check.sh
warnings='-Wall -Wextra -Wpedantic -Wconversion -Wshadow -Werror'

# the programs in the chapter ON WINDOWS AND MACOS of the manual, each from its first #include
awk -v folder="$folder" '
    /^   ON DETERMINISM$/ { exit }
    /^   ON WINDOWS AND MACOS$/ { on = 1 }
    /^       #include <windows\.h>$/ && on { file = folder "/wgl.c" }
    /^       #include <GLFW\/glfw3\.h>$/ && on { file = folder "/glfw.c" }
    /^   [^ ]/ { file = "" }
    file { sub(/^       /, ""); print > file }' sbl.h

# programs for Windows are built in a copy of the repository, so that build/ holds only programs for Linux
copy="$folder/copy"
mkdir "$copy"
cp -r sbl.h examples scripts tests "$copy"

# >>compilers

# beside ORDER COMPILER...: compiles and links a file that includes windows.h first, last or not at all. If the command
# contains -fsyntax-only, there is neither an object, $folder/beside.o, nor a program.
beside() {
    order=$1
    shift
    {
        [ "$order" != first ] || echo '#include <windows.h>'
        echo '#define SBL_IMPLEMENTATION'
        echo '#include "sbl.h"'
        [ "$order" != last ] || echo '#include <windows.h>'
        echo 'int main(void) { sbl_context *context; return sbl_create(NULL, &context) == SBL_SUCCESS; }'
    } > "$folder/beside.c"
    "$@" $warnings -I . -c "$folder/beside.c" -o "$folder/beside.o" || return
    case " $* " in *" -fsyntax-only "*) return ;; esac
    "$1" "$folder/beside.o" -o "$folder/beside"
}

# macros FLAGS...: lists the macros that are defined at the end of a file of includes, which is read from stdin
macros() {
    "$target-w64-mingw32-gcc" -std=c99 -I . -x c -dM -E "$@" - | awk '{ sub(/\(.*/, "", $2); print $2 }' | sort -u
}
own_includes() { sed '1,/^\*\/$/d' sbl.h | sed -n 's/^ *# *include \(<[^>]*>\)$/#include \1/p' | grep -v EGL; }

# no identifier of sbl.h may be a macro of the headers of Windows; comments and strings do not count
no_macro_is_a_name() {
    gcc -fpreprocessed -dD -E -P sbl.h | sed 's/"\([^"\\]\|\\.\)*"//g' |
        grep -oE '[A-Za-z_][A-Za-z0-9_]*' | sort -u > "$folder/words"
    own_includes | macros > "$folder/own"
    printf '#include <%s>\n' windows.h winsock2.h objbase.h shellapi.h commctrl.h GL/gl.h | macros > "$folder/macros"
    [ "$(grep -cxE 'near|far|hyper|interface|min|max' "$folder/macros")" = 6 ] || return
    grep -qx sbl__now "$folder/words" || return
    printf '%s\n' small pascal cdecl >> "$folder/macros"  # macros of Microsoft's own headers
    sort -o "$folder/macros" "$folder/macros"
    # MemoryBarrier is a macro: sbl.h calls it in parentheses, so that it is not expanded
    ! grep 'gl->MemoryBarrier(' sbl.h || return
    comm -23 "$folder/macros" "$folder/own" | comm -12 - "$folder/words" | grep -vx MemoryBarrier > "$folder/strangers"
    nothing "$folder/strangers"
}
leaves_no_macros() {
    own_includes | macros > "$folder/own"
    { own_includes; echo '#include "sbl.h"'; } | macros -DSBL_IMPLEMENTATION > "$folder/macros"
    grep -qx SBL_MAX_LEVELS "$folder/macros" || return
    comm -13 "$folder/own" "$folder/macros" | grep -v '^SBL_' > "$folder/strangers"
    nothing "$folder/strangers"
}
# reads the object that the test ${target}_c_alone leaves, which also contains main
exports_only() {
    "$target-w64-mingw32-nm" "$folder/beside.o" |
        awk '$2 ~ /^[TDBRC]$/ { sub(/^_/, "", $3); print $3 }' > "$folder/exports"
    grep -qx sbl_render_picture "$folder/exports" || return
    grep -v '^sbl_[a-z]' "$folder/exports" | grep -vx main > "$folder/strangers"
    nothing "$folder/strangers"
}
# links SOURCE PROGRAM [FLAGS...]: compiles a file with $target's compiler, and links it for 64 bits. 32-bit programs
# never run, and minimal.exe below is linked for 32 bits. FLAGS: only for 64 bits
links() {
    source=$1 linked=$2
    shift 2
    case $target in
        i686) set -- -fsyntax-only -DSBL_IMPLEMENTATION_INCLUDED "$source" ;;
        *) set -- "$source" "$@" -lopengl32 -lgdi32 -o "$linked" ;;
    esac
    "$target-w64-mingw32-gcc" -std=c99 $warnings -I . "$@"
}
gl_types() { "$@" -std=c99 $warnings -Wno-unused -DWIN32_LEAN_AND_MEAN -fsyntax-only tests/header/gl_types.c; }
snippet() {
    {
        cat "$folder/wgl.c"
        echo '#include "examples/wgl.h"'
        echo 'int main(void) { sbl_context *c = wgl_open("wgl") ? start() : NULL; sbl_destroy(c); return c == NULL; }'
    } > "$folder/wgl_main.c"
    # ${target}_examples_compile leaves the object of the implementation
    links "$folder/wgl_main.c" "$folder/wgl.exe" -DSBL_IMPLEMENTATION_INCLUDED "$copy/build/sbl.o"
}
# -O1 and -fno-inline: see tests/support/private.h
windows_program() { links tests/header/windows.c "$folder/windows.exe" -O1 -fno-inline "$copy/build/sbl.o"; }
# The examples are built as README.md says; those that need POSIX are omitted. For 32 bits it is enough to compile one,
# because i686_c_alone compiles and links sbl.h itself.
examples() {
    case $target in i686)
        i686-w64-mingw32-gcc -std=c99 $warnings -idirafter /usr/include -DSBL_IMPLEMENTATION_INCLUDED -fsyntax-only \
            examples/minimal.c
        return ;;
    esac
    CC=$target-w64-mingw32-gcc CFLAGS=-O0 "$copy/scripts/build" || return
    for source in examples/*.c; do
        example=$(basename "$source" .c).exe
        grep -qE '#include "(scene|picture)_file.h"' "$source" || [ -f "$copy/build/$example" ] ||
            { echo "no $example"; return 1; }
    done
}

check gl_functions_have_their_types gl_types gcc
wine_target=
for target in i686 x86_64; do
    if ! command -v "$target-w64-mingw32-gcc" > /dev/null || ! command -v "$target-w64-mingw32-g++" > /dev/null; then
        skip "$target" "no $target-w64-mingw32-gcc and g++ (mingw-w64)"
        continue
    fi
    # The orders matter because of the macros of windows.h, which no_macro_is_a_name compares for both targets. For 32
    # bits, one order in C and one in C++ are enough to find other sizes of types and other calling conventions. For 64
    # bits, each order is tested in C and in C++, once with all of windows.h and once with its lean form. SBL_STATIC
    # changes neither the included headers nor their order.
    cpp="$target-w64-mingw32-g++ -std=c++11 -x c++"
    if [ "$target" = i686 ]; then
        check i686_cpp_windows_h_first beside first $cpp -fsyntax-only
    else
        check x86_64_c_windows_h_first beside first x86_64-w64-mingw32-gcc -std=c99 -fsyntax-only
        check x86_64_c_static_lean_windows_h_last beside last x86_64-w64-mingw32-gcc -std=c99 -DSBL_STATIC \
            -DWIN32_LEAN_AND_MEAN -fsyntax-only
        check x86_64_cpp_alone beside none $cpp
        check x86_64_cpp_static_lean_windows_h_first beside first $cpp -DSBL_STATIC -DWIN32_LEAN_AND_MEAN -fsyntax-only
        check x86_64_cpp_windows_h_last beside last $cpp -fsyntax-only
    fi
    # the last of these, since exports_only reads its object
    check "${target}_c_alone" beside none "$target-w64-mingw32-gcc" -std=c99
    if command -v clang > /dev/null; then
        clang="clang -target $target-w64-windows-gnu -fsyntax-only"
        check "${target}_clang" beside first $clang -std=c99
        check "${target}_clang_cpp" beside last $clang -std=c++11 -x c++
    else
        skip "${target}_clang" "no clang"
    fi
    check "${target}_no_macro_is_a_name" no_macro_is_a_name
    check "${target}_leaves_no_macros" leaves_no_macros
    check "${target}_exports_nothing_but_sbl_functions" exports_only
    check "${target}_gl_functions_have_their_types" gl_types "$target-w64-mingw32-gcc"
    check "${target}_examples_compile" examples
    check "${target}_manual_compiles" snippet
    [ "$target" = i686 ] || check x86_64_windows_compiles windows_program
    wine_target=$target  # wine runs the programs of this target
done

# >>pictures, all made with Mesa's software renderer

export LIBGL_ALWAYS_SOFTWARE=1
look() { (cd "$folder" && ./picture "$@"); }
here() { mkdir -p "$folder/here" && scripts/build minimal && build/minimal "$folder/here"; }
gcc -std=c99 -O2 -Wall -Wextra tests/tools/picture.c -lm -o "$folder/picture" || exit 1
here > "$folder/log" 2>&1 || { cat "$folder/log"; exit 1; }

# like macOS: without compute shaders and clip control
gl_41() {
    mkdir -p "$folder/gl_41" &&
    MESA_GL_VERSION_OVERRIDE=4.1FC MESA_GLSL_VERSION_OVERRIDE=410 \
        MESA_EXTENSION_OVERRIDE='-GL_ARB_clip_control -GL_ARB_compute_shader -GL_ARB_shader_image_load_store' \
        build/minimal "$folder/gl_41" && look alike here/minimal.png gl_41/minimal.png
}
check gl_41_picture gl_41

with_display() { timeout 7200 xvfb-run -a -s '-screen 0 640x480x24' "$@"; }
display=1
command -v xvfb-run > /dev/null && command -v xauth > /dev/null || display=

# >>GLFW

glfw_compiles() {
    gcc -std=c99 $warnings -DSBL_IMPLEMENTATION_INCLUDED -I . "$folder/glfw.c" build/sbl.o \
        $(pkg-config --cflags --libs glfw3) -lEGL -lm -o "$folder/glfw"
}
if pkg-config --exists glfw3 2> /dev/null; then
    check manual_compiles_with_glfw glfw_compiles
    if [ "$display" ]; then check manual_runs_with_glfw with_display "$folder/glfw"
    else skip manual_runs_with_glfw "no xvfb-run and xauth (xvfb, xauth)"; fi
else
    skip manual_compiles_with_glfw "no GLFW (libglfw3-dev)"
fi

# >>wine

# wine uses 700 MB temporarily, and leaves nothing in the home folder
export TMPDIR="$folder" WINEPREFIX="$folder/wine" WINEDEBUG=-all WINEDLLOVERRIDES='mscoree,mshtml,winemenubuilder.exe='
run() { mkdir -p "$folder/there" && (cd "$folder" && with_display wine "$@"); }
minimal_there() { run "$copy/build/minimal.exe" there && look alike here/minimal.png there/minimal.png; }
host_context_there() {
    run "$copy/build/host_context.exe" there && look cornell there/host_context.png
}
if [ "$wine_target" != x86_64 ]; then skip wine "nothing to run: no x86_64-w64-mingw32-gcc and g++ (mingw-w64)"
elif [ ! "$display" ]; then skip wine "no xvfb-run and xauth (xvfb, xauth)"
elif ! command -v wine > /dev/null; then skip wine "no wine (wine64)"
else
    check wine_tests run windows.exe
    check wine_manual run wgl.exe
    check wine_minimal_picture minimal_there
    check wine_host_context host_context_there
    wineserver -k > /dev/null 2>&1
    wineserver -w > /dev/null 2>&1
fi

report
