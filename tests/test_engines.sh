#!/bin/sh
# Tests that other programs can load the files of sbl_bake. three.js in a headless Chromium draws three scenes:
# scene.gltf with the plug-in examples/engines/MOZLightmap.js and maps in all formats that it loads; the scene that was
# baked, with the map that sbl_unwrap --light adds; and scene_lit.glb without a plug-in. The pictures must equal those
# of host_lightmap. The glTF validator of Khronos checks the files.
set -u
cd "$(dirname "$0")/.."
modules=build/engines/node_modules
chromium=$(command -v chromium-headless-shell || command -v chromium || true)
missing=
command -v node > /dev/null || missing="$missing node"
[ -n "$chromium" ] || missing="$missing chromium-headless-shell"
[ -d "$modules/three" ] && [ -d "$modules/gltf-validator" ] || missing="$missing $modules"
if [ -n "$missing" ]; then
    echo "skipped: these are missing:$missing (node with npm from nodejs.org; then scripts/setup --test)"
    echo "0 passed, 0 failed, 1 skipped"
    exit
fi
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
passed=0 failed=0
check() {
    if "$@" > "$folder/said" 2>&1; then passed=$((passed + 1)); else
        failed=$((failed + 1))
        echo "FAILED: $*"
        cat "$folder/said"
    fi
}

node tests/engines/room.mjs "$folder" &&
    build/sbl_bake "$folder/room.gltf" --lightmap 256 --mode direct --preset draft --sky .2,.2,.2 \
        --formats exr,hdr,ktx2 --lit 256 -o "$folder/baked" --quiet &&
    build/host_lightmap "$folder/room.gltf" "$folder/baked" --eye 0.13,1.43,4.9 --look-at 0.04,1.27,0 --fov 45 \
        --size 240x180 -o "$folder/drawn.pfm" &&
    scripts/sbl_unwrap --light "$folder/baked" "$folder/room.gltf" "$folder/baked/user.glb" --quiet &&
    scripts/sbl_unwrap --light "$folder/baked" "$folder/room.gltf" "$folder/user.gltf" --quiet &&
    cp "$folder"/user.* "$folder/tiles.png" "$folder/fence.png" "$folder/baked" ||
    { echo "0 passed, 1 failed, 0 skipped"; exit 1; }
check node tests/engines/validate.cjs "$modules" "$folder/baked/scene_lit.glb" "$folder/baked/scene.gltf" \
    "$folder/baked/user.glb" "$folder/baked/user.gltf"
check node tests/engines/show.mjs "$folder/baked" "$modules/three" "$folder/shot.png" "$chromium"
check node tests/engines/compare.mjs "$folder/shot.png" "$folder/drawn.pfm" "$folder/baked/scene_lit.glb"
cat "$folder/said"
echo "$passed passed, $failed failed, 0 skipped"
[ $failed = 0 ]
