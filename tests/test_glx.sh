#!/bin/sh
# Tests of sbl.h in a program that uses GLX. The program is tests/support/glx.c, which runs on a virtual X server.
set -u
export LC_ALL=C LIBGL_ALWAYS_SOFTWARE=1
cd "$(dirname "$0")/.." || exit 1
. tests/support/check.sh

has() { printf '#include <%s>\n' "$1" | gcc -E -x c - > /dev/null 2>&1; }
# scripts/build makes build/sbl.o together with any test
compiles() {
    scripts/build test_pinned && gcc -std=c99 -O2 -Wall -Wextra -Wpedantic -Wconversion -Wshadow -Werror \
        tests/support/glx.c build/sbl.o -lGL -lX11 -lEGL -lm -o "$folder/glx"
}
run() { TEST_ONLY=$1 timeout 600 xvfb-run -a -s '-screen 0 640x480x24' "$folder/glx"; }

if ! has GL/glx.h || ! has X11/Xlib.h; then skip glx "no headers of GLX and X11 (libgl-dev, libx11-dev)"
elif ! command -v xvfb-run > /dev/null || ! command -v xauth > /dev/null; then
    skip glx "no xvfb-run and xauth (xvfb, xauth)"
else
    check compiles compiles
    check headless_beside_glx run headless_beside_glx
    check inside_glx run inside_glx
fi
report
