#!/bin/sh
# Tests of sbl.h as a file: supported languages and compilers, exported symbols and names, and the agreement of its
# manual with the code.
set -u
export LC_ALL=C
cd "$(dirname "$0")/.." || exit 1
. tests/support/check.sh
warnings='-Wall -Wextra -Wpedantic -Wconversion -Wshadow -Werror'

# >>compilers

# language STANDARD: prints the name of the language for the option -x
language() { case $1 in c++*) echo c++ ;; *) echo c ;; esac; }

# compiles COMPILER STANDARD DEFINES...: compiles a file that includes sbl.h twice, first for the declarations only
compiles() {
    compiler=$1 standard=$2
    shift 2
    {
        echo '#include "sbl.h"'
        for define in "$@"; do echo "#define $define"; done
        echo '#include "sbl.h"'
        echo '#include "sbl.h"'
        echo 'int sbl_test_unit(void);'
        echo 'int sbl_test_unit(void) { return SBL_SUCCESS; }'
    } > "$folder/unit.c"
    # SBL_STATIC must be defined before the first inclusion
    case " $* " in *" SBL_STATIC "*) sed -i 1d "$folder/unit.c" ;; esac
    # gcc finds unused functions only when it generates code, whereas clang always finds them. Therefore gcc generates
    # code for this purpose only if clang is not installed ($code). Later standards differ only in the code that they
    # accept, and C11 differs from C17 only in corrections of its text. The objects with EGL are always generated: tests
    # below link programs with them and list their symbols.
    # -fno-pie: constants that contain addresses are then not listed as data
    case $compiler,$standard,$* in
        gcc,c99,*_EGL | gcc,c++11,*_EGL) output="-fno-pie -c -o $folder/unit_$standard.o" ;;
        gcc,c99,* | gcc,c++11,*) output="$code" ;;
        *) output=-fsyntax-only ;;
    esac
    # the words of $warnings and $output become arguments
    $compiler -x "$(language "$standard")" -std="$standard" $warnings -I . $output "$folder/unit.c"
}

command -v clang > /dev/null && code=-fsyntax-only || code="-c -o $folder/unit.o"
for compiler in gcc clang; do
    command -v $compiler > /dev/null || { skip "compiles_with_$compiler" "no $compiler"; continue; }
    for standard in c99 c17 c++11 c++17; do
        check "declarations_${compiler}_$standard" compiles $compiler $standard
        check "implementation_egl_${compiler}_$standard" compiles $compiler $standard SBL_IMPLEMENTATION SBL_EGL
        case $standard in c99 | c++11) ;; *) continue ;; esac  # the tests above contain the other standards
        check "implementation_${compiler}_$standard" compiles $compiler $standard SBL_IMPLEMENTATION
        check "implementation_static_${compiler}_$standard" compiles $compiler $standard SBL_IMPLEMENTATION SBL_EGL \
            SBL_STATIC
        check "implementation_no_stdio_${compiler}_$standard" compiles $compiler $standard SBL_IMPLEMENTATION \
            SBL_NO_STDIO
    done
done

# A file defines the macros None, Bool, Status, Always, Success, I, major and minor, as other headers do.
# test_windows.sh tests windows.h. clang needs less time than gcc.
beside_xlib() {
    headers='#include <X11/Xlib.h>\n#include <X11/Xutil.h>\n#include <complex.h>\n#include <sys/sysmacros.h>\n'
    case $1 in first) printf "$headers" > "$folder/xlib.c" ;; *) : > "$folder/xlib.c" ;; esac
    printf '#define SBL_IMPLEMENTATION\n#define SBL_EGL\n#include "sbl.h"\n' >> "$folder/xlib.c"
    case $1 in last) printf "$headers" >> "$folder/xlib.c" ;; esac
    "$(command -v clang || echo gcc)" -std=c99 $warnings -I . -fsyntax-only "$folder/xlib.c"
}
if echo '#include <X11/Xlib.h>' | gcc -E -x c - > /dev/null 2>&1; then
    check compiles_after_xlib beside_xlib first
    check compiles_before_xlib beside_xlib last
else
    skip compiles_beside_xlib "no X11/Xlib.h (libx11-dev)"
fi

# program NAME STANDARD: builds a program; STANDARD is that of the implementation
program() {
    gcc -std=c99 $warnings -c tests/header/caller.c -o "$folder/caller.o" &&
    g++ -std=c++11 $warnings -c tests/header/main.cpp -o "$folder/main.o" &&
    g++ -no-pie "$folder/main.o" "$folder/caller.o" "$folder/unit_$2.o" -lEGL -lm -o "$folder/$1" &&
    "$folder/$1" > "$folder/$1.out" || { cat "$folder/$1.out"; return 1; }
}
check c_implementation_c_and_cpp_callers program mixed c99
check cpp_implementation_c_and_cpp_callers program mixed_cpp c++11

# >>the other byte order

big_endian() {
    s390x-linux-gnu-gcc -std=c99 $warnings -static -I . tests/header/big_endian.c -lm -o "$folder/big_endian" &&
        qemu-s390x "$folder/big_endian"
}
if command -v s390x-linux-gnu-gcc > /dev/null && command -v qemu-s390x > /dev/null; then check big_endian big_endian
else
    skip big_endian "no s390x-linux-gnu-gcc (gcc-s390x-linux-gnu, libc6-dev-s390x-cross) or no qemu-s390x (qemu-user)"
fi

# >>exported symbols and names

# object FILE FLAGS...: compiles a file, and lists its symbols in $folder/symbols
object() {
    file=$1
    shift
    gcc -I . -fno-pie -w "$@" -c -o "$folder/object.o" "$file" && nm "$folder/object.o" > "$folder/symbols"
}

# symbols STANDARD: lists the symbols of an object that the tests above left
symbols() { nm "$folder/unit_$1.o" | grep -v sbl_test_unit > "$folder/symbols"; }

# exports_only COMMAND...: the command lists symbols
exports_only() {
    "$@" || return
    # in C++, functions of <math.h> are weak symbols of the namespace std
    awk '$2 ~ /^[A-Z]$/ && $2 != "U" && $3 !~ /^sbl_[a-z]/ && $2 $3 !~ /^W_ZSt/' "$folder/symbols" > "$folder/strangers"
    awk '$2 == "T" { print $3 }' "$folder/symbols" | sort > "$folder/exports"
    [ -s "$folder/exports" ] && nothing "$folder/strangers"
}
# A given SBL_API does not change the names of functions in C++. The declarations decide about the names: this file
# takes the address of each declared function, so that its name is an undefined symbol of the object.
given_api() {
    sed -n '/^#ifndef SBL_INCLUDED$/,/^#endif \/\* SBL_INCLUDED \*\/$/p' sbl.h |
        sed -n 's/^SBL_API [^(]*\(sbl_[a-z0-9_]*\)(.*/\1/p' | sort > "$folder/declared"
    {
        echo '#include "sbl.h"'
        echo 'typedef void (*function)(); extern const function functions[]; const function functions[] = {'
        sed 's/.*/(function)&,/' "$folder/declared"
        echo '};'
    } > "$folder/api.cpp"
    object "$folder/api.cpp" '-DSBL_API=__attribute__((visibility("default")))' &&
        awk '$1 == "U" { print $2 }' "$folder/symbols" | sort > "$folder/used" && same "$folder/declared" "$folder/used"
}
# The private functions remain in this object, because no_stdio lists what they call.
exports_nothing() {
    object tests/header/implementation.c -fkeep-static-functions -DSBL_STATIC -DSBL_NO_STDIO &&
        grep -q ' t sbl_render_picture$' "$folder/symbols" &&
        awk '$2 ~ /^[A-Z]$/ && $2 != "U"' "$folder/symbols" > "$folder/strangers" && nothing "$folder/strangers"
}
no_globals() {
    awk '$2 ~ /^[bBdDC]$/' "$folder/symbols" > "$folder/strangers" && nothing "$folder/strangers"
}
no_stdio() {
    [ -s "$folder/symbols" ] &&
        awk '$1 == "U" && $2 ~ /^(std(err|out|in)|f?printf|v?fprintf|f?puts|fputc|fwrite|putchar)$/' "$folder/symbols" \
        > "$folder/strangers" && nothing "$folder/strangers"
}
check exports_nothing_but_sbl_functions_from_cpp exports_only symbols c++11
check a_given_api_keeps_c_names given_api
check static_exports_nothing exports_nothing
check no_stdio_writes_nowhere no_stdio  # uses the list that the test before it writes
check exports_nothing_but_sbl_functions exports_only symbols c99  # the tests below use the lists that this test writes
check no_mutable_globals no_globals

# includes FILE: lists the headers that sbl.h includes, in order. Headers in the examples of the manual are not listed.
includes() { sed '1,/^\*\/$/d' "$@" | sed -n 's/^ *# *include *\(<[^>]*>\).*/\1/p'; }
only_system_includes() {
    grep -n '^ *# *include *"' sbl.h |
        grep -v '^[0-9]*:       #include "sbl.h"' > "$folder/strangers"  # lines of the manual
    standard='assert|float|limits|math|stdarg|stddef|stdint|stdio|stdlib|string|time'
    includes sbl.h | grep -vxE "<($standard|sys/time|EGL/egl|EGL/eglext)\.h>" >> "$folder/strangers"
    nothing "$folder/strangers"
}
# direct FLAGS...: lists the headers that sbl.h itself includes
direct() {
    gcc -x c -std=c99 -H -E "$@" sbl.h 2>&1 > "$folder/preprocessed" | sed -n 's/^\. \(.*\)/\1/p' |
        sed 's/.*include\///' | sort -u
}
declarations_include_little() {
    direct > "$folder/direct"
    printf 'stddef.h\nstdint.h\n' > "$folder/expected"
    same "$folder/expected" "$folder/direct"
}
egl_only_when_asked() {
    direct -DSBL_IMPLEMENTATION > "$folder/direct"
    direct -DSBL_IMPLEMENTATION -DSBL_EGL > "$folder/direct_egl"
    ! grep EGL "$folder/direct" && [ -s "$folder/direct" ] && grep -q EGL/egl.h "$folder/direct_egl"
}
check only_system_includes only_system_includes
check declarations_include_stddef_and_stdint declarations_include_little
check egl_only_when_asked egl_only_when_asked

# These functions list the names that a file declares, as macros or otherwise, without the names of its system headers.
macros() { gcc -x c -std=c99 -I . -dM -E "$@" "$folder/names.c" | awk '{ sub(/\(.*/, "", $2); print $2 }' | sort -u; }
declarations() {
    clang -x c -std=c99 -I . -w -fsyntax-only -fno-color-diagnostics -Xclang -ast-dump "$@" "$folder/names.c" | awk '
        /^[|`]-(Typedef|Function|Var|Record|Enum)Decl / || /^[| ] [|`]-EnumConstantDecl / {
            sub(/\047.*/, "")             # keeps the type
            sub(/ definition *$/, "")
            if ($NF !~ /[:>]|^(struct|union)$/) print $NF  # a declaration may have no name
        }' | sort -u
}
leaks() {
    list=$1
    shift
    includes sbl.h | sort -u > "$folder/system"
    case " $* " in *SBL_EGL*) ;; *) sed -i '/EGL/d' "$folder/system" ;; esac
    case " $* " in *SBL_IMPLEMENTATION*) ;; *) sed -i '/std\(def\|int\)\.h/!d' "$folder/system" ;; esac
    sed 's/^/#include /' "$folder/system" > "$folder/names.c"
    $list > "$folder/without"
    echo '#include "sbl.h"' >> "$folder/names.c"
    $list "$@" > "$folder/with"
    comm -13 "$folder/without" "$folder/with" > "$folder/new"
    grep -qxE 'SBL_MAX_LEVELS|sbl_render_picture' "$folder/new" ||
        { echo "none of the expected names was found: is $list broken?"; return 1; }
    grep -vE '^(SBL_|sbl_|__builtin_)' "$folder/new" > "$folder/strangers"
    nothing "$folder/strangers"
}
check macros_have_the_prefix leaks macros
check macros_of_the_implementation_have_the_prefix leaks macros -DSBL_IMPLEMENTATION -DSBL_EGL
if command -v clang > /dev/null; then
    check names_have_the_prefix leaks declarations
    check names_of_the_implementation_have_the_prefix leaks declarations -DSBL_IMPLEMENTATION -DSBL_EGL
else
    skip names_have_the_prefix "no clang"
fi

# >>the manual

# the manual is the comment at the top of sbl.h
sed '/^\*\/$/q' sbl.h > "$folder/manual"

index_is_complete() {
    sed -n '/^   FUNCTIONS$/,/^   ON UNITS$/p' "$folder/manual" | awk '$1 ~ /^sbl_/ { print $1 }' |
        sort > "$folder/index"
    same "$folder/index" "$folder/exports"
}
declared_is_exported() {
    sed -n '/^#ifndef SBL_INCLUDED$/,/^#endif \/\* SBL_INCLUDED \*\/$/p' sbl.h |
        sed -n 's/^SBL_API [^(]*\(sbl_[a-z0-9_]*\)(.*/\1/p' | sort > "$folder/declared"
    same "$folder/declared" "$folder/exports"
}
check function_index_is_complete index_is_complete
check all_declared_functions_exist declared_is_exported

version_agrees() {
    {
        sed -n '1s/^.* - v\([0-9.]*\) - .*/\1/p' sbl.h
        sed -n 's/^ *sbl_version  *"\(.*\)"$/\1/p' "$folder/manual"
    } > "$folder/said"
    cat "$folder/mixed.out" "$folder/mixed.out" > "$folder/is"
    same "$folder/said" "$folder/is"
}
check version_agrees_everywhere version_agrees

defaults_agree() {
    gcc -std=c99 $warnings -no-pie tests/header/defaults.c "$folder/unit_c99.o" -lEGL -lm \
        -o "$folder/defaults" &&
    "$folder/defaults" > "$folder/printed" &&
    python3 tests/tools/defaults.py "$folder/printed"
}
check comments_name_the_defaults defaults_agree

# linked PROGRAM FILE: compiles a file as a user would, and links it with the object of the implementation
linked() {
    gcc -std=c99 $warnings -I . -fsyntax-only "$2" &&
    gcc -std=c99 $warnings -I . -no-pie -DSBL_IMPLEMENTATION_INCLUDED "$2" "$folder/unit_c99.o" -lEGL -lm -o "$1"
}

# is_cpp FILE: a program in C compiles as C++, too. The tests above compile the implementation as C++.
is_cpp() {
    g++ -x c++ -std=c++11 $warnings -Wno-missing-field-initializers -I . -DSBL_IMPLEMENTATION_INCLUDED \
        -fsyntax-only "$1"
}

# Runs the quick start of the manual. Its last line is replaced by one that checks the picture.
quick_start_runs() {
    sed -n '/^   QUICK START$/,/^   FUNCTIONS$/s/^       //p' "$folder/manual" > "$folder/quick.c"
    grep -q '^int main' "$folder/quick.c" || return
    sed 's|^    return 0;$|    for (i = 0; i < 64 * 64 * 3; i++) if (picture[i] > 0) return 0;\n    return 2;|' \
        "$folder/quick.c" > "$folder/quick_look.c"
    cmp -s "$folder/quick.c" "$folder/quick_look.c" && { echo "the quick start has no line 'return 0;'"; return 1; }
    is_cpp "$folder/quick.c" && linked "$folder/quick" "$folder/quick_look.c" && "$folder/quick"
}
check quick_start_compiles_and_draws quick_start_runs

# The other snippets of the manual are compiled as statements. They may use these variables: a context, a scene, its
# lights and materials, an array of floats and a number of vertices. Text without semicolons is a formula and is
# skipped. test_windows.sh compiles the programs of the chapters on embedding.
manual_snippets() {
    awk -v folder="$folder" '
        function end() { if (text ~ /;\n/) printf "%s", text > sprintf("%s/manual_%02d.txt", folder, ++n); text = "" }
        /^   ON UNITS$/ { on = 1 }
        /^   ON MEMORY$/ { exit }
        on && /^       / { text = text substr($0, 8) "\n"; next }
        on { end() }' "$folder/manual"
    {
        echo '#include "sbl.h"'
        for code in "$folder"/manual_*.txt; do
            snippet=$(basename "$code" .txt)
            echo "int $snippet(sbl_context *context, float *light, size_t vertex_count);"
            echo "int $snippet(sbl_context *context, float *light, size_t vertex_count) {"
            echo 'static sbl_scene_desc scene; static sbl_light lights[4]; static sbl_material materials[4];'
            echo '(void)context; (void)light; (void)vertex_count; (void)scene; (void)lights; (void)materials;'
            cat "$code"
            echo 'return 1; }'
        done
    } > "$folder/manual.c"
    [ "$(ls "$folder"/manual_*.txt | wc -l)" -ge 3 ] &&
        gcc -std=c99 $warnings -Wno-unused -I . -fsyntax-only "$folder/manual.c"
}
check manual_snippets_compile manual_snippets

# The blocks of README.md that are marked c are compiled. A block with a main function is run as a program; a block with
# an #include is compiled as a file; any other block is compiled as statements, with a context, a scene and a picture as
# variables.
snippet_compiles() {
    code=$1
    if ! grep -q '^ *# *include' "$code"; then
        {
            printf '#include "sbl.h"\n#include <stdio.h>\n'
            echo 'void snippet(sbl_context *context, sbl_scene_desc scene, sbl_picture_desc picture);'
            echo 'void snippet(sbl_context *context, sbl_scene_desc scene, sbl_picture_desc picture) {'
            echo '(void)context; (void)scene; (void)picture;'
            cat "$code"
            echo '}'
        } > "$code.wrapped.c"
        code=$code.wrapped.c
    fi
    if grep -q '^int main' "$code"; then
        linked "$code.program" "$code" && (cd "$folder" && "$code.program") && is_cpp "$code"
    else
        gcc -std=c99 $warnings -Wno-unused -I . -fsyntax-only "$code"
    fi || { cat "$code"; return 1; }
}
if [ -f README.md ]; then
    awk -v folder="$folder" '
        /^```/ {
            if (file) { close(file); file = "" } else if (/^```c$/) file = sprintf("%s/readme_%02d.c", folder, ++count)
            next
        }
        file { print > file }' README.md
    for code in "$folder"/readme_*.c; do
        [ -f "$code" ] || { skip readme "no C in README.md"; break; }
        check "$(basename "$code" .c)_compiles" snippet_compiles "$code"
    done
else
    skip readme "no README.md"
fi

# >>the repository

check shaders_in_the_header_are_the_files scripts/embed_shaders --check
nothing_left_to_do() {
    grep -rnE '\b(TODO|FIXME|XXX|HACK)\b' sbl.h shaders_embedded examples > "$folder/strangers"
    nothing "$folder/strangers"
}
check nothing_left_to_do nothing_left_to_do
top_level() {
    # without git, all files count except those that were built
    { git ls-files 2> /dev/null | grep . || ls -A; } | sed 's|/.*||' | sort -u |
        grep -vxE 'sbl\.h|examples|shaders_embedded|tests|scripts|LICENSE|README\.md|build|\..*' > "$folder/strangers"
    nothing "$folder/strangers"
}
check top_level_is_tidy top_level

# >>rules of the code

check rooms_keep_their_rules python3 tests/tools/rooms.py
check words_keep_their_meaning python3 tests/tools/words.py

# one_material FOLDER: only material.glsl and the section >>material may compute how a surface changes light. Other
# shaders in the folder must not read fields of a material, and must not multiply by an albedo or by epsilon.
one_material() {
    awk '
        function end(    n, parts, k) {
            n = split(text, parts, /[;{}]/)
            for (k = 1; k <= n; k++)
                if (parts[k] ~ /sbl_object_(albedo|emission|alpha)|SBL_ONE_SIDED_EMISSION/ ||
                        parts[k] ~ /(albedo|epsilon).*\*|\*.*(albedo|epsilon)/)
                    print file ": " parts[k]
            text = ""
        }
        FNR == 1 { end(); file = FILENAME; sub(/.*\//, "", file) }
        file != "material.glsl" { sub(/\/\/.*/, ""); text = text $0 " " }
        END { end() }' "$1"/*.glsl > "$folder/strangers"
    awk '/^#ifdef SBL_IMPLEMENTATION/ { on = 1 } /^\/\* =+ >>[a-z]+$/ { room = $3 }
        on && room !~ />>(check|material)$/ &&
            /(object|objects\[[^]]*\])(->|\.)(albedo|emission)|SBL_MATERIAL_ONE_SIDED/ &&
            !/^#define/ { print room ": " $0 }' \
        sbl.h >> "$folder/strangers"
    nothing "$folder/strangers"
}
check one_place_for_materials one_material shaders_embedded
# one_material must find each of these lines
material_is_guarded() {
    rm -rf "$folder/shaders" && cp -r shaders_embedded "$folder/shaders" || return
    count=0
    for line in 'light = s.material.albedo * light;' 'light *= m.albedo;' \
        'light = texelFetch(sample_albedo, at, 0).rgb * light;' \
        'vec3 e = sbl_object_emission(object);' 'radiance = epsilon * color;'; do
        echo "void f() { $line }" >> "$folder/shaders/trace.glsl"
        count=$((count + 1))
    done
    ! one_material "$folder/shaders" && [ "$(grep -c '^trace.glsl: ' "$folder/strangers")" = $count ]
}
check one_place_for_materials_is_guarded material_is_guarded
# shaders must not contain numbers that C passes to them
one_number() {
    ! grep -nE '3\.14|6\.28|0\.2126|0\.282|0\.488|1e30|16777216|65535\.0|0x9e3779b1' shaders_embedded/*.glsl
}
check shared_numbers_stand_once one_number
rooms_are_listed() {
    awk '/^#ifdef SBL_IMPLEMENTATION/ { on = 1 } on && /^   SYMPTOMS$/ { exit }
        on { while (match($0, />>[a-z]+  /)) \
            { print substr($0, RSTART + 2, RLENGTH - 4); $0 = substr($0, RSTART + RLENGTH) } \
            }' sbl.h > "$folder/expected"
    sed -n 's/^\/\* =* >>\([a-z]*\)$/\1/p' sbl.h > "$folder/is"
    same "$folder/expected" "$folder/is"
}
check rooms_are_listed_in_their_order rooms_are_listed

report
