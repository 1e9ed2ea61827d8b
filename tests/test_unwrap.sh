#!/bin/sh
# Tests of scripts/sbl_unwrap. Charts do not overlap; all other data of the scene is kept; sbl_bake reads the scale and
# offset of each instance; and broken scenes are refused. tests/support/unwrap.js makes the scenes and checks the
# results.
set -u
export LC_ALL=C
cd "$(dirname "$0")/.." || exit 1
. tests/support/check.sh

if ! command -v node > /dev/null; then skip unwrap "node is missing (scripts/setup --unwrap)"; report; fi

said="$folder/said" out="$folder/out.glb"
unwrap() { scripts/sbl_unwrap "$@" > "$said" 2>&1 || { cat "$said"; return 1; }; }
holds() { node tests/support/unwrap.js "$@"; }
says() { grep -q -- "$1" "$said" || { cat "$said"; return 1; }; }
size_of() { sed -n 's/.* \([0-9]*\) x [0-9]* texels.*/\1/p' "$said"; }

usage() {
    scripts/sbl_unwrap --help | grep -q '^usage: sbl_unwrap' &&
    scripts/sbl_unwrap --version | grep -q '^sbl_unwrap 0' &&
    for words in '' a 'a b.obj' 'a b.glb --size 0' 'a b.glb --size' 'a b.glb 3.5' 'a b.glb --gap=x' 'a b.glb --gap 65' \
        'a b.glb --no' '--light' '--light d a' '--light d a b.glb --size 9' '--light d a b.glb --again' \
        'a b.glb --map 1' '--light d a b.glb --map -1' '--light d a b.glb 64'; do
        scripts/sbl_unwrap $words > "$said" 2>&1
        [ $? = 2 ] && [ "$(wc -l < "$said")" = 1 ] || { echo "$words"; cat "$said"; return 1; }
    done
}
check usage usage
lacks_xatlas() {
    mkdir -p "$folder/alone/bin" && cp scripts/sbl_unwrap "$folder/alone/bin" &&
    ! "$folder/alone/bin/sbl_unwrap" examples/scenes/lights.gltf "$out" > "$said" 2>&1 && says 'setup --unwrap' &&
    [ "$(wc -l < "$said")" = 1 ] && [ ! -e "$out" ]
}
check says_that_xatlas_is_missing lacks_xatlas
if [ ! -f build/node_modules/watlas/dist/watlas.wasm ]; then
    skip unwrap "npm's watlas is missing (scripts/setup --unwrap)"
    report
fi
node tests/support/unwrap.js make "$folder" || exit 1
rich="$folder/rich.gltf"
small="$folder/small.glb"  # the same scene with a small map, which takes less than half the time

# >>the charts

fills() { unwrap "$rich" "$out" --size 256 && holds apart "$out" 256 2 58 && ! ls "$folder" | grep part; }
in_a_small_map() { unwrap "$rich" "$small" --size 64 && holds apart "$small" 64 2 40; }
wide_gap() { unwrap "$rich" "$folder/wide.glb" 256 --gap 6 && holds apart "$folder/wide.glb" 256 6 40; }
is_dense() {
    unwrap "$rich" "$folder/dense.glb" --texel-density 20 && holds dense "$folder/dense.glb" "$(size_of)" 20 &&
    holds apart "$folder/dense.glb" "$(size_of)" 2 45
}
makes_maps() {
    unwrap "$rich" "$folder/maps.glb" --texel-density 12 --size 112 && holds maps "$folder/maps.glb" 2 &&
    holds apart "$folder/maps.glb" 112 2 20 && holds dense "$folder/maps.glb" 112 12 &&
    holds same "$rich" "$folder/maps.glb"
}
is_wide() {
    unwrap "$folder/strip.gltf" "$folder/strip.glb" 64 && holds wide "$folder/strip.glb" 64 2 &&
    holds apart "$folder/strip.glb" 64 2 80
}
strips_are_wide() {
    unwrap "$folder/flat.gltf" "$folder/flat.glb" 64 && says ' 2 charts' &&
    holds wide "$folder/flat.glb" 64 2 && holds parted "$folder/flat.glb" 64 0
}
strips_are_parted() {
    unwrap "$folder/moulding.gltf" "$folder/strips.glb" 64 && says ' 2 charts' &&
    holds wide "$folder/strips.glb" 64 1 && holds parted "$folder/strips.glb" 64 2 &&
    holds same "$folder/moulding.gltf" "$folder/strips.glb"
}
is_not_stretched() {
    unwrap "$folder/round.gltf" "$folder/round.glb" --texel-density 100 && says ' 2 charts' &&
    holds dense "$folder/round.glb" "$(size_of)" 100
}
too_small() { ! unwrap "$rich" "$folder/no.glb" "$@" && says larger && [ ! -e "$folder/no.glb" ]; }
check charts_are_apart fills
check charts_are_apart_in_a_small_map in_a_small_map
check gap_is_kept wide_gap
check density_is_right is_dense
check several_maps makes_maps
check long_charts_are_wide is_wide
check strips_of_long_charts_are_wide strips_are_wide
check strips_at_an_angle_share_no_texel strips_are_parted
check round_charts_keep_their_density is_not_stretched
check a_map_is_too_small too_small 4
check a_mesh_is_too_large too_small --texel-density 100 --size 64

# >>other data of the scene

same_gltf() {
    unwrap "$rich" "$folder/beside.gltf" 64 && holds same "$rich" "$folder/beside.gltf" && [ -s "$folder/beside.bin" ]
}
odd_ones() {
    unwrap "$folder/odd.gltf" "$folder/odd.glb" 64 && holds surface "$folder/odd.gltf" "$folder/odd.glb" &&
    holds apart "$folder/odd.glb" 64 2 30
}
is_kept() { unwrap "$1" "$folder/kept.gltf" 64 && says 'kept' && holds kept "$1" "$folder/kept.gltf"; }
is_placed() {
    unwrap "$folder/usable_twice.gltf" "$folder/kept.gltf" 64 && says '1 meshes kept' &&
    holds places "$folder/kept.gltf" square other && holds apart "$folder/kept.gltf" 64 2 40
}
is_replaced() {
    unwrap "$folder/$1.gltf" "$folder/new.gltf" 64 && says "square: .* not kept: .*$2" &&
    holds apart "$folder/new.gltf" 64 2 50
}
again() {
    unwrap "$small" "$folder/again.glb" 64 && cmp "$small" "$folder/again.glb" &&
    unwrap "$small" "$folder/new.glb" 64 --again && holds apart "$folder/new.glb" 64 2 40 &&
        holds same "$rich" "$folder/new.glb"
}
# edited FROM TO CODE: writes a scene that JavaScript code has changed; see the variables below
edited() {
    node -e 'const fs = require("fs"), [, folder, from, to, code] = process.argv;
        const json = JSON.parse(fs.readFileSync(`${folder}/${from}.gltf`));
        new Function("json", "fs", "folder", code)(json, fs, folder);
        fs.writeFileSync(`${folder}/${to}.gltf`, JSON.stringify(json));' "$folder" "$@"
}
# a rotation that is not of length 1 counts like the one of length 1 with the same axis and angle
long_rotations() {
    for k in 1 2; do
        edited rich "turned$k" "for (const n of json.nodes)
            if (n.mesh !== undefined && !n.matrix) n.rotation = [0.36, 0.48, 0, 0.8].map((v) => v * $k);" &&
        unwrap "$folder/turned$k.gltf" "$folder/long$k.gltf" --texel-density 12 || return 1
    done
    grep -q '"rotation":\[0.72' "$folder/long2.gltf" && cmp "$folder/long1.bin" "$folder/long2.bin"
}
# a byte order mark, and a buffer in a data URI without base64, change nothing
other_encodings() {
    { printf '\357\273\277' && cat "$rich"; } > "$folder/mark.gltf" &&
    unwrap "$folder/mark.gltf" "$folder/mark.glb" --size 64 && cmp "$small" "$folder/mark.glb" &&
    edited rich data 'for (const b of json.buffers) if (b.uri && !b.uri.startsWith("data:"))
        b.uri = "data:application/octet-stream," + [...fs.readFileSync(`${folder}/${b.uri}`)]
            .map((v) => "%" + v.toString(16).padStart(2, "0")).join("");' &&
    unwrap "$folder/data.gltf" "$folder/data.glb" --size 64 && holds same "$rich" "$folder/data.glb"
}
keeps_extras() {
    edited rich extras 'json.asset.extras = { mine: 1 };' && unwrap "$folder/extras.gltf" "$folder/extra.gltf" 64 &&
    grep '"mine":1' "$folder/extra.gltf" | grep -q '"lightmapSize":64'
}
# a .glb holds the pictures; a .gltf must stay beside them
takes_pictures() {
    printf 'RIFF0000WEBP' > "$folder/own.webp" && mkdir -p "$folder/away" &&
    edited rich webp 'json.images = [...(json.images || []), { uri: "own.webp" }];' &&
    unwrap "$folder/webp.gltf" "$folder/webp.glb" 64 && grep -aq '"mimeType":"image/webp"' "$folder/webp.glb" &&
    grep -aq RIFF0000WEBP "$folder/webp.glb" && ! unwrap "$folder/webp.gltf" "$folder/away/webp.gltf" 64 &&
    says 'names pictures' && [ ! -e "$folder/away/webp.gltf" ]
}
one_map_instead() {
    grep -aq '"lightmapIndex"' "$folder/maps.glb" && unwrap "$folder/maps.glb" "$folder/one.glb" --size 64 --again &&
    ! grep -aq '"lightmapIndex"' "$folder/one.glb"
}
# coordinates that a texture uses are not replaced
is_shared() {
    edited overlaps shared 'json.textures = [{}];
        json.materials = [{ pbrMetallicRoughness: { baseColorTexture: { index: 0, texCoord: 1 } } }];
        for (const m of json.meshes) for (const p of m.primitives) p.material = 0;' &&
    ! unwrap "$folder/shared.gltf" "$folder/no.glb" 64 && says 'uses the second texture coordinates' &&
    [ ! -e "$folder/no.glb" ]
}
# an accessor to which an unknown extension refers keeps its content
foreign_accessors() {
    edited rich foreign 'json.extensions.EXT_unknown.accessor = json.meshes[1].primitives[0].indices;' &&
    unwrap "$folder/foreign.gltf" "$folder/foreign.glb" 64 &&
    holds foreign "$folder/foreign.gltf" "$folder/foreign.glb"
}
# coordinates that fill a small part of the map are laid out again
fills_the_map() {
    edited usable corner 'json.nodes[0].extras = { lightmapScaleOffset: [0.3, 0.3, 0, 0] };' &&
    unwrap "$folder/corner.gltf" "$folder/new.gltf" 64 && holds apart "$folder/new.gltf" 64 2 50
}
# a map for a density is the smallest multiple of 16 texels that holds the charts
is_smallest() { unwrap "$folder/usable.gltf" "$folder/new.glb" --texel-density 14 && says ' 16 x 16 texels'; }
check maps_of_a_density_are_small is_smallest
check all_else_is_the_same holds same "$rich" "$out"
check rotations_do_not_scale long_rotations
check encodings_change_nothing other_encodings
check extras_are_kept keeps_extras
check pictures_are_taken takes_pictures
check one_map_replaces_several one_map_instead
check used_coordinates_are_not_replaced is_shared
check all_else_is_the_same_in_gltf same_gltf
check strips_fans_and_sparse_ones odd_ones
check foreign_accessors_stay foreign_accessors
check nearly_empty_maps_are_filled fills_the_map
check usable_coordinates_are_kept is_kept "$folder/usable.gltf"
check usable_coordinates_are_placed is_placed
check overlapping_ones_are_replaced is_replaced overlaps overlap
check ones_outside_are_replaced is_replaced beyond 'not inside'
check coarse_ones_are_replaced is_replaced coarse 'too few texels'
check a_result_is_kept again
# a first set that was made for a mesh without one is made again, too
again_without_first() {
    unwrap "$folder/overlaps.gltf" "$folder/new.gltf" 64 && holds one_set "$folder/new.gltf" &&
        unwrap "$folder/new.gltf" "$folder/new.glb" 64 --again && holds one_set "$folder/new.glb" &&
        holds apart "$folder/new.glb" 64 2 50 && holds surface "$folder/overlaps.gltf" "$folder/new.glb"
}
check a_result_without_a_first_set again_without_first

# >>instances in sbl_bake

check instances_have_places holds places "$out" one two
bakes() {
    build/sbl_bake "$1" --lightmap "$2" --mode direct --preset draft --formats pfm -o "$folder/baked" "$3" &&
        [ ! -e "$folder/baked/overlap.png" ] && shift 3 && holds light "$@"
}
# A sun of 10 lux gives R = 10 / pi. The scene that sbl_bake writes has the scales and offsets applied to its
# coordinates.
lit() {
    bakes "$out" 256 --quiet "$out" "$folder/baked" 256 one 3.183 two 0 roof 3.183 &&
    holds apart "$folder/baked/scene.gltf" 256 2 58
}
# the maps of one run equal those of separate runs
all_maps() {
    set -- --lightmap 112 --mode direct --preset draft --quiet --formats pfm
    build/sbl_bake "$folder/maps.glb" "$@" --lightmap auto --lit 64 -o "$folder/all" || return 1
    for map in 0 1; do
        build/sbl_bake "$folder/maps.glb" "$@" --map $map --lit 0 -o "$folder/map$map" &&
            [ ! -e "$folder/map$map/overlap.png" ] && [ ! -e "$folder/all/overlap_$map.png" ] &&
            cmp "$folder/map$map/lightmap.pfm" "$folder/all/lightmap_$map.pfm" || return 1
    done
    ! cmp -s "$folder/map0/lightmap.pfm" "$folder/map1/lightmap.pfm" && holds table "$folder/all" "$folder/maps.glb" 112
}
without_first() { build/sbl_bake "$folder/usable.gltf" --lightmap 16 --mode direct --quiet -o "$folder/first"; }
if [ -x build/sbl_bake ]; then
    check light_is_right_on_all_instances lit
    check all_maps_are_baked_in_one_run all_maps
    check a_second_set_needs_no_first without_first
fi

# >>adding the maps of sbl_bake to the scene that was baked

# adds_light BEFORE AFTER FOLDER MAP MESHES MATERIALS [OPTION...]: adds the map of FOLDER; MESHES and MATERIALS are the
# numbers of new ones
adds_light() {
    baked=$3 dark=$1 bright=$2 counts="$4 $5 $6"
    shift 6
    unwrap --light "$baked" "$dark" "$bright" "$@" && says 'the .*maps\? lights\?' &&
        holds lit "$dark" "$bright" "$baked" $counts
}
adds_maps() {
    for map in 0 1; do
        build/sbl_bake "$folder/mixed.gltf" --lightmap 64 --map $map --mode direct --preset draft --quiet --lit 0 \
            -o "$folder/mixed$map" || return 1
    done
    # New are the meshes of both tiles, because other nodes use these meshes, two materials for each of them, and one
    # material where there was none.
    adds_light "$folder/mixed.gltf" "$folder/lit.gltf" "$folder/mixed0" 0 2 5 --map 0 &&
        [ -s "$folder/lit.lightmap.png" ] &&
        adds_light "$folder/lit.gltf" "$folder/both.gltf" "$folder/mixed1" 1 1 2 --map 1
}
# the maps of a run replace those of an earlier run
adds_all_maps() {
    for sky in 0,0,0 1,1,1; do
        build/sbl_bake "$folder/mixed.gltf" --lightmap 64 --mode direct --preset draft --quiet --lit 0 --sky $sky \
            -o "$folder/mixed_$sky" || return 1
    done
    for ending in glb gltf; do
        adds_light "$folder/mixed.gltf" "$folder/all.$ending" "$folder/mixed_0,0,0" 0,1 3 7 || return 1
        unwrap --light "$folder/mixed_1,1,1" "$folder/all.$ending" "$folder/anew.$ending" &&
            holds relit "$folder/all.$ending" "$folder/anew.$ending" "$folder/mixed_1,1,1" || return 1
    done
    # their textures do not keep another sampler
    edited all bare 'for (const t of json.textures) delete t.sampler;' &&
    unwrap --light "$folder/mixed_1,1,1" "$folder/bare.gltf" "$folder/bare.glb" &&
    [ "$(grep -ao '"source":.,"sampler":0' "$folder/bare.glb" | wc -l)" = 2 ] &&
    grep -aq '{"magFilter":9729,"minFilter":9729,"wrapS":33071,"wrapT":33071}' "$folder/bare.glb" &&
    [ -s "$folder/anew.lightmap_1.png" ] &&
    unwrap --light "$folder/mixed_1,1,1" "$folder/all.glb" "$folder/anew.gltf" &&
        holds relit "$folder/all.glb" "$folder/anew.gltf" "$folder/mixed_1,1,1"
}
refuses_light() {
    echo old > "$folder/old.glb"
    ! scripts/sbl_unwrap --light "$1" "$2" "$folder/old.glb" > "$said" 2>&1 && cat "$said" &&
        [ "$(wc -l < "$said")" = 1 ] && says "^sbl_unwrap: $2: [ -~]*$3" && [ "$(cat "$folder/old.glb")" = old ]
}
if [ -x build/sbl_bake ] && [ -f "$folder/baked/scene.gltf" ]; then
    build/sbl_bake "$folder/beside.gltf" --lightmap 64 --mode direct --preset draft --quiet --lit 0 -o "$folder/beside"
    check light_is_added adds_light "$out" "$folder/lit.glb" "$folder/baked" 0 1 2
    check light_is_added_to_a_gltf adds_light "$folder/beside.gltf" "$folder/lit.gltf" "$folder/beside" 0 1 2
    check light_of_maps adds_maps
    check light_of_all_maps adds_all_maps
    if [ -d build/engines/node_modules/gltf-validator ]; then
        check files_of_maps_are_valid node tests/engines/validate.cjs build/engines/node_modules \
            "$folder/all/scene.gltf" "$folder/all/scene_lit.glb" "$folder/mixed_0,0,0/scene.gltf" "$folder/all.glb" \
            "$folder/anew.glb"
    else skip files_of_maps_are_valid "build/engines/node_modules is missing (scripts/setup --test)"; fi
    check one_map_is_chosen refuses_light "$folder/mixed0" "$folder/mixed.gltf" 'choose it with --map'
    node tests/support/unwrap.js bakes "$folder/bad" "$folder/baked" "$folder/mixed.gltf"
    check refuses_light_nowhere refuses_light "$folder/bad/nowhere" "$out" 'no such file'
    while read -r name words; do echo "$folder/bad/$name $out $words"; done << 'END' > "$folder/refused"
none no material has MOZ_lightmap
zero intensity .* not valid
minus intensity .* not valid
text no glTF
picture no PNG
index do not exist
END
    while read -r name words; do echo "$folder/mixed0 $folder/bad/$name $words"; done << 'END' >> "$folder/refused"
place.gltf its place .* not valid
four.gltf its place .* not valid
map.gltf its place .* not valid
material.gltf do not exist
variant.gltf do not exist
mesh.gltf do not exist
extension.gltf no object
textures.gltf no list
used.gltf no list
loop.gltf two parents
END
    check refuses_bad_light eval 'holds refuses "$folder" < "$folder/refused"'
    check refuses_light_of_another_scene refuses_light "$folder/mixed0" "$out" 'of another scene'
    # a third of the surfaces is where the map expects it
    edited mixed moved 'for (const i of [1, 2]) json.nodes[i].extras.lightmapScaleOffset = [0.3, 0.3, 0.13, 0.17];
        delete json.nodes[3].extras.lightmapIndex; json.nodes[3].mesh = undefined;'
    check refuses_light_of_moved_charts refuses_light "$folder/mixed0" "$folder/moved.gltf" 'of another'
    check refuses_light_of_a_scene_without_coordinates refuses_light "$folder/baked" "$rich" 'no second texture'
    check refuses_light_of_an_obj refuses_light "$folder/baked" examples/scenes/two_rooms.obj 'no .gltf or .glb'
fi

# >>files that are refused

refuses() {
    echo old > "$folder/kept.glb"
    ! scripts/sbl_unwrap "$1" "$folder/kept.glb" --time 60 > "$said" 2>&1 && cat "$said" &&
        [ "$(wc -l < "$said")" = 1 ] && says "^sbl_unwrap: $1: [ -~]*$2" && [ "$(cat "$folder/kept.glb")" = old ] &&
        ! ls "$folder" | grep -q part
}
check refuses_a_pipe eval 'mkfifo "$folder/pipe.gltf"; refuses "$folder/pipe.gltf" regular'
check refuses_numbers_that_are_none refuses "$folder/broken/nan.gltf" 'not a number'
check refuses_a_missing_file refuses "$folder/broken/missing.gltf" 'no such file'
while read -r name words; do echo "- $folder/broken/$name $words"; done << 'END' > "$folder/refused"
index.gltf index .* out of range
accessor.gltf do not exist
count.gltf no valid count
long.gltf not inside
view.gltf not inside
stride.gltf not inside
sparse.gltf do not exist
loop.gltf two parents
draco.gltf compressed
meshopt.gltf compressed
flat.gltf no surface
type.gltf type
nodes.gltf no list
primitives.gltf no surface
attributes.gltf not valid
child.gltf do not exist
huge.gltf too large
pair.gltf no triangles
short.gltf truncated
outside.gltf outside
absolute.gltf outside
linked.gltf outside
folder.gltf
remote.gltf only files
cut.gltf JSON is broken
cut.glb truncated
empty.gltf JSON is broken
null.gltf no glTF
END
check refuses_broken_scenes eval 'holds refuses "$folder" < "$folder/refused"'
late() { ! scripts/sbl_unwrap "$rich" "$folder/late.glb" --time 1e-3 > "$said" 2>&1; says 'give a number'; }
check time_has_a_least late
unwritable() {
    ! unwrap "$rich" "$folder/none/out.glb" 64 && says 'cannot be written' && [ "$(wc -l < "$said")" = 1 ]
}
check says_what_cannot_be_written unwritable

# >>other formats

reads_obj() {
    unwrap examples/scenes/two_rooms.obj "$folder/rooms.glb" 128 && holds apart "$folder/rooms.glb" 128 2 40
}
# The box has five walls of nearly equal size. If all had the same number of texels in height and in width, a third of
# the map would stay empty.
fills_box() {
    unwrap examples/scenes/cornell_box.obj "$folder/box.glb" 256 && holds apart "$folder/box.glb" 256 2 80
}
if [ -x build/scene_to_gltf ]; then
    check reads_obj reads_obj
    check equal_walls_fill_the_map fills_box
    check refuses_a_bad_obj refuses "$folder/broken/bad.obj" ''
    check obj_becomes_a_glb eval '! unwrap examples/scenes/two_rooms.obj "$folder/rooms.gltf" 64 && says glb'
fi

report
