#!/bin/sh
# Tests of scripts/blender_addon.py in Blender, without a window. A box that the tools bake and render is compared with
# Blender's Cycles; other tests cover cancelling and messages. The tests are in tests/support/blender_addon.py.
set -u
export LC_ALL=C LIBGL_ALWAYS_SOFTWARE=1
cd "$(dirname "$0")/.." || exit 1
. tests/support/check.sh

# Blender of Debian finds NumPy only if it uses the system's python3.
in_blender() {
    PATH=/usr/bin:/bin TMPDIR="$folder" blender --background --factory-startup -noaudio -t 1 --python-exit-code 1 \
        --python tests/support/blender_addon.py -- build "$folder" > "$folder/log.txt" 2>&1 ||
        tail -n 20 "$folder/log.txt"
    grep -E '^(ok  |FAIL) ' "$folder/log.txt"
    for picture in render baked traced map truth; do
        [ -s "$folder/$picture.png" ] || { echo "FAIL there is no $picture.png"; tail -n 20 "$folder/log.txt"; }
    done
}
if ! PATH=/usr/bin:/bin command -v blender > /dev/null; then skip blender "no Blender (blender)"
elif ! /usr/bin/python3 -c 'import numpy' 2> /dev/null; then skip blender "no NumPy (python3-numpy)"
elif ! scripts/build sbl_bake sbl_render; then check builds false
else
    in_blender > "$folder/verdicts"
    cat "$folder/verdicts"
    passed=$(grep -c '^ok ' "$folder/verdicts") failed=$(grep -c '^FAIL ' "$folder/verdicts")
fi
report
