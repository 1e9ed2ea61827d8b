#!/bin/sh
# Tests of scenes from untrusted sources. They may refer only to files in their own folder, and must not use more memory
# than allowed. These tests run the tool as a user would; tests/test_reader.c tests the process that reads scenes.
set -u
export LC_ALL=C
cd "$(dirname "$0")/.." || exit 1
. tests/support/check.sh
tool="$PWD/${BUILD_DIR:-build}/sbl_render"
[ "${BUILD_DIR:-build}" = build/sanitize ] && sanitized=1 || sanitized=
folder=$(cd "$folder" && pwd -P)  # messages contain the resolved path

# >>files: scenes in $folder/scene; files in $folder/secret and $folder/scene_too, which sbl_render must not read
# through a scene without --allow-path

mkdir "$folder/scene" "$folder/scene/inside" "$folder/secret" "$folder/scene_too"
python3 - "$folder" << 'END'
import base64, json, os, struct, sys, zlib
folder = sys.argv[1]
def write(name, data):
    with open(os.path.join(folder, name), "wb") as out: out.write(data if isinstance(data, bytes) else data.encode())
def chunk(kind, data): return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
def png(width, height, depth):
    row = bytes(1 + (width * depth + 7) // 8)
    packer = zlib.compressobj(1)
    data = b"".join(packer.compress(row) for _ in range(height)) + packer.flush()
    return (b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, depth, 0, 0, 0, 0)) +
            chunk(b"IDAT", data) + chunk(b"IEND", b""))
def gltf(uri, positions=bytes(), indices=bytes(), uses=1):
    count, size = len(positions) // 12 or 3, len(positions) + len(indices) or 36
    mesh = {"attributes": {"POSITION": 0}}
    if indices: mesh["indices"] = 1
    return json.dumps({"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": list(range(uses))}],
        "nodes": [{"mesh": 0, "translation": [i, 0, 0]} for i in range(uses)], "meshes": [{"primitives": [mesh]}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": count, "type": "VEC3", "min": [0, 0, 0],
                       "max": [1, 1, 0]}] + ([{"bufferView": 1, "componentType": 5125, "count": len(indices) // 4,
                       "type": "SCALAR"}] if indices else []),
        "bufferViews": [{"buffer": 0, "byteLength": len(positions) or 36}] + ([{"buffer": 0,
                         "byteOffset": len(positions), "byteLength": len(indices)}] if indices else []),
        "buffers": [{"byteLength": size, "uri": uri}]})
def obj(library):
    return "mtllib %s\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nusemtl m\nf 1/1 2/2 3/3\n" % library
triangle, picture, material = struct.pack("<9f", 0, 0, 0, 1, 0, 0, 0, 1, 0), png(4, 4, 8), "newmtl m\nKd 1 0 0\n"
for place in ("scene/inside", "secret", "scene_too"):
    write(place + "/triangle.bin", triangle)
    write(place + "/picture.png", picture)
    write(place + "/library.mtl", material)
os.symlink("../../secret/triangle.bin", folder + "/scene/inside/link.bin")
os.symlink("../../secret/picture.png", folder + "/scene/inside/link.png")
os.symlink("../secret", folder + "/scene/door")
os.symlink("inside/triangle.bin", folder + "/scene/home.bin")
os.symlink("scene", folder + "/again")
outside = {"absolute": folder + "/secret/", "above": "../secret/", "roundabout": "inside/../../secret/",
           "door": "door/", "beside": "../scene_too/"}
for name, at in outside.items():
    write("scene/buffer_%s.gltf" % name, gltf(at + "triangle.bin"))
    write("scene/library_%s.obj" % name, obj(at + "library.mtl"))
    write("scene/of_%s.mtl" % name, "newmtl m\nmap_Kd %spicture.png\n" % at)
    write("scene/texture_%s.obj" % name, obj("of_%s.mtl" % name))
write("scene/buffer_link.gltf", gltf("inside/link.bin"))
write("scene/of_link.mtl", "newmtl m\nmap_Kd inside/link.png\n")
write("scene/texture_link.obj", obj("of_link.mtl"))
write("scene/buffer_inside.gltf", gltf("inside/../inside/triangle.bin"))
write("scene/buffer_home.gltf", gltf("home.bin"))
write("scene/texture_inside.obj", obj("of_inside.mtl"))
write("scene/of_inside.mtl", "newmtl m\nmap_Kd inside/picture.png\n")
write("scene/texture_moved.obj", obj("of_moved.mtl"))
write("scene/of_moved.mtl", "newmtl m\nmap_Kd %s/secret/moved.png\n" % folder)  # and in the scene's folder
write("secret/moved.png", picture)
write("scene/moved.png", picture)

# the files of these scenes are small, but their contents need much memory
write("scene/broad.png", png(16384, 16384, 1))
write("scene/of_broad.mtl", "newmtl m\nmap_Kd broad.png\n")
write("scene/broad.obj", obj("of_broad.mtl"))
n = 60
positions = b"".join(struct.pack("<3f", x / n, y / n, 0) for y in range(n + 1) for x in range(n + 1))
indices = b"".join(struct.pack("<6I", a, a + 1, a + n + 2, a, a + n + 2, a + n + 1)
                   for a in (y * (n + 1) + x for y in range(n) for x in range(n)))
data = "data:application/octet-stream;base64," + base64.b64encode(positions + indices).decode()
write("scene/many.gltf", gltf(data, positions, indices, 400))
write("scene/few.gltf", gltf(data, positions, indices, 4))
END

# render SCENE [OPTIONS...]: runs sbl_render. It sets $status to the exit status, and writes the messages to
# $folder/errors.
render() {
    rendered=$1
    shift
    rm -f "$folder/out.pfm"
    "$tool" "$rendered" --size 16x16 --tile 16 --samples 1 --bounce-samples 1024 --sky 1,1,1 \
        -o "$folder/out.pfm" "$@" \
        > "$folder/said" 2> "$folder/errors"
    status=$?
    echo "$rendered $*: exit status $status"
    cat "$folder/errors"
}
renders() { render "$@"; [ "$status" = 0 ] && [ ! -s "$folder/errors" ] && [ -s "$folder/out.pfm" ]; }
# fails WORDS SCENE [OPTIONS...]: sbl_render must fail with one line that contains all the words, and write no picture
fails() {
    words=$1
    shift
    render "$@"
    [ "$status" = 1 ] && [ "$(wc -l < "$folder/errors")" = 1 ] && [ ! -e "$folder/out.pfm" ] || return
    for word in $words; do grep -qF -e "$word" "$folder/errors" || { echo "$word is not named"; return 1; }; done
}

# some NAME COMMAND...: runs a test, but with sanitizers, which take several times as long, only every fourth of these
# tests. The plain run has all.
some() {
    number=$((number + 1))
    [ "$sanitized" ] && [ $((number % 4)) != 1 ] || check "$@"
}
number=0
here() { (cd "$folder/scene" && "$@"); }
# assimp takes an absolute path as relative to the folder of the scene, unless this is the current folder
for kind in buffer_absolute.gltf:triangle.bin library_absolute.obj:library.mtl texture_absolute.obj:picture.png; do
    some "${kind%%.*}_is_refused" here fails "$folder/secret/${kind#*:} --allow-path" "${kind%:*}"
    some "${kind%%.*}_is_allowed" here renders "${kind%:*}" --allow-path "$folder/secret"
done
some texture_absolute_is_refused_from_afar fails "$folder/secret/picture.png --allow-path" \
    "$folder/scene/texture_absolute.obj"
for way in above roundabout door; do
    some "buffer_${way}_is_refused" fails "$folder/secret/triangle.bin --allow-path" "$folder/scene/buffer_$way.gltf"
    some "library_${way}_is_refused" fails "$folder/secret/library.mtl --allow-path" "$folder/scene/library_$way.obj"
    some "texture_${way}_is_refused" fails "$folder/secret/picture.png --allow-path" "$folder/scene/texture_$way.obj"
done
some buffer_link_is_refused fails "$folder/secret/triangle.bin --allow-path" "$folder/scene/buffer_link.gltf"
some texture_link_is_refused fails "$folder/secret/picture.png --allow-path" "$folder/scene/texture_link.obj"
# the name of this folder begins with the name of the scene's folder
some a_like_name_is_refused fails "$folder/scene_too/triangle.bin --allow-path" "$folder/scene/buffer_beside.gltf"
for option in "--allow-path=$folder/secret" "--allow-path=$folder/secret/.." "--allow-path=$folder/scene/door"; do
    some "allowed_${option##*/}_buffer" renders "$folder/scene/buffer_above.gltf" "$option"
    some "allowed_${option##*/}_library" renders "$folder/scene/library_above.obj" "$option"
    some "allowed_${option##*/}_texture" renders "$folder/scene/texture_door.obj" "$option"
done
some several_are_allowed renders "$folder/scene/buffer_beside.gltf" --allow-path "$folder/secret" \
    --allow-path "$folder/scene_too"
some another_is_not_enough fails "--allow-path" "$folder/scene/buffer_beside.gltf" --allow-path "$folder/secret"
some no_such_folder fails "--allow-path nowhere" "$folder/scene/few.gltf" --allow-path nowhere
some a_file_is_no_folder fails "--allow-path" "$folder/scene/few.gltf" --allow-path "$folder/secret/picture.png"
too_often() {
    set --
    for i in 1 2 3 4 5 6 7 8 9 10 11 12 13 14 15 16 17; do set -- "$@" --allow-path "$folder"; done
    render "$folder/scene/few.gltf" "$@"
    [ "$status" = 2 ]
}
some seventeen_folders_are_bad_usage too_often

for scene in buffer_inside.gltf buffer_home.gltf texture_inside.obj texture_moved.obj; do
    some "${scene%.*}_is_read" renders "$folder/scene/$scene"
    some "${scene%.*}_is_read_through_a_link" renders "$folder/again/$scene"
    some "${scene%.*}_is_read_from_here" here renders "$scene"
done
# Without stdin, the first file that the tool opens gets the descriptor 0. The tool must not mistake it for stdin.
bare_handles() { (renders "$folder/scene/texture_inside.obj" <&-); }
some without_stdin bare_handles
# files on the command line may be in any folder
check the_sky_lies_anywhere renders "$folder/scene/few.gltf" --sky "$folder/secret/picture.png" --quiet
ln -s "$folder/scene/few.gltf" "$folder/secret/linked.gltf"
check a_scene_may_be_a_link renders "$folder/secret/linked.gltf"

# >>messages about the confinement of the process that reads scenes

is_told() {
    render "$folder/scene/few.gltf" --verbose --quiet
    [ ! "$sanitized" ] || { [ "$status" = 0 ] && grep -q "few.gltf: .*not confined" "$folder/errors"; return; }
    [ "$status" = 0 ] && grep -q "few.gltf: .*Landlock .*seccomp " "$folder/errors" &&
        [ "$(grep -c Landlock "$folder/errors")" = 1 ]
}
check verbose_tells_what_confines is_told

# >>memory limits

# within MEGABYTES COMMAND...: tests the peak memory of the command, including its child processes
within() {
    python3 - "$@" << 'END'
import os, subprocess, sys
process = subprocess.Popen(sys.argv[2:])
status, used = os.wait4(process.pid, 0)[1:]
print("peak: %d MB" % (used.ru_maxrss >> 10))
sys.exit(used.ru_maxrss >> 10 > int(sys.argv[1]))
END
}
check a_broad_picture_is_refused fails "broad.png 16384 GB --memory" "$folder/scene/broad.obj" --memory 512M
check many_uses_are_refused fails "many.gltf 400 2880000 GB --memory" "$folder/scene/many.gltf" --memory 256M
check few_uses_are_not renders "$folder/scene/few.gltf" --memory 64M
check a_sky_is_counted fails "broad.png 16384 GB --memory" "$folder/scene/few.gltf" --sky "$folder/scene/broad.png" \
    --memory 512M
bad_sizes() {
    for size in 0 1 15M x 1X 4GG -1G 1e99 ""; do
        render "$folder/scene/few.gltf" --memory "$size"
        [ "$status" = 2 ] || return
    done
}
check bad_sizes bad_sizes
if [ "$sanitized" ]; then
    skip peaks "sanitizers use memory of their own"
    skip ulimit "sanitizers need much address space"
else
    check a_broad_picture_takes_nothing within 300 "$tool" "$folder/scene/broad.obj" --memory 512M -o "$folder/out.pfm"
    check many_uses_take_nothing within 300 "$tool" "$folder/scene/many.gltf" --memory 256M -o "$folder/out.pfm"
    # Whatever the limit is, the tool succeeds or fails with a message. The allocator is that of users, because the
    # settings of scripts/test make it request more address space.
    small() {
        for megabytes in 30 50 100 200 300 400 500 600 700 900 1200; do
            (unset GLIBC_TUNABLES
                ulimit -v $((1000 * megabytes)) && render "$folder/scene/few.gltf" "$@"; exit "$status")
            status=$?
            echo "$megabytes MB: $status"
            [ $status = 0 ] || { [ $status = 1 ] && [ "$(wc -l < "$folder/errors")" = 1 ]; } || return 1
        done
    }
    check ulimit_is_honoured small
    check ulimit_is_honoured_with_large_wishes small --memory 100G
fi

# >>the studio: a scene without light gets a sky, with a message, unless an option sets the sky

printf 'v -1 0 -1\nv -1 0 1\nv 1 0 1\nv 1 0 -1\nf 1 2 3 4\n' > "$folder/dark.obj"
mean_of() { python3 -c 'import array, sys
data = open(sys.argv[1], "rb").read().split(b"\n", 3)[3]
values = array.array("f", data); print("%.3f" % max(values))' "$1"; }
lit_by_a_sky() {
    "$tool" "$folder/dark.obj" --size 16x12 --channel radiance -o "$folder/dark.pfm" "$@" 2> "$folder/errors" ||
        { cat "$folder/errors"; return 1; }
    mean_of "$folder/dark.pfm"
    cat "$folder/errors"
}
dark_scene() {
    lit_by_a_sky | tee "$folder/said" && grep -qE '^(0\.9|1\.0)' "$folder/said" &&
        grep -q 'dark.obj: the file has no light: it is lit by a studio sky' "$folder/said"
}
asked_for_dark() {
    lit_by_a_sky --sky 0,0,0 --mode direct | tee "$folder/said" && grep -qx '0.000' "$folder/said" &&
        ! grep -qE 'constant sky|studio' "$folder/said"
}
check dark_scene_is_lit dark_scene
check dark_scene_stays_dark_when_asked asked_for_dark

report
