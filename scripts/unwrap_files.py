"""unwrap_files.py SCENE: checks the files that a scene names, before Blender reads them. A .gltf or .glb may name
buffers and pictures; an .obj may name material libraries, which may name textures. Each must be a regular file in the
folder of the scene or below it, after symbolic links are followed, so that an untrusted scene can neither copy private
files into the result nor wait for a pipe. A name without a file is accepted. Exit status: 1 if a name is refused.
"""
import json
import os
import struct
import sys
from urllib.parse import unquote

TEXTURE_KEYS = ("map_", "bump", "disp", "decal", "refl", "norm")  # lines of an .mtl that name textures begin so


class Refused(Exception):
    pass


def regular(path, name):
    if os.path.exists(path) and not os.path.isfile(path):
        raise Refused("%s: no regular file" % name)
    return os.path.isfile(path)


def check(scene, name):
    """Returns the path of a file that the scene names. Raises Refused if it is not allowed."""
    folder = os.path.realpath(os.path.dirname(scene) or ".")
    path = os.path.realpath(os.path.join(folder, name.replace("\\", "/")))
    if os.path.commonpath((folder, path)) != folder:
        raise Refused("%s: outside the scene's folder; copy the file into the folder" % name)
    regular(path, name)
    return path


def uris(value):
    """Returns all strings named "uri" in a JSON value, also within extensions."""
    if isinstance(value, list):
        return [uri for one in value for uri in uris(one)]
    if not isinstance(value, dict):
        return []
    own = [v for k, v in value.items() if k == "uri" and isinstance(v, str)]
    return own + [uri for one in value.values() for uri in uris(one)]


def document_of(path):
    with open(path, "rb") as file:
        data = file.read()
    if data[:4] == b"glTF":
        data = data[20:20 + struct.unpack("<I", data[12:16])[0]]
    return json.loads(data.decode())


def lines_of(path):
    """Returns the lines of an .obj or .mtl as lists of words. A backslash at the end of a line continues it."""
    with open(path, "r", encoding="utf-8", errors="replace") as file:
        return [line.split() for line in file.read().replace("\\\n", " ").split("\n") if line.strip()]


def check_materials(scene, path):
    for words in lines_of(path):
        if not words[0].lower().startswith(TEXTURE_KEYS):
            continue
        for first in range(1, len(words)):  # options may precede the name, and names may contain spaces
            check(scene, " ".join(words[first:]).strip('"'))


def check_scene(scene):
    if not regular(scene, scene):
        raise Refused("%s: no such file" % scene)
    if not scene.lower().endswith(".obj"):
        for uri in uris(document_of(scene)):
            if not uri.startswith("data:"):
                check(scene, uri)
                check(scene, unquote(uri))
        return
    names = [os.path.splitext(os.path.basename(scene))[0] + ".mtl"]  # Blender reads it without being told
    for words in lines_of(scene):
        if words[0] == "mtllib":
            names += words[1:] + [" ".join(words[1:])]
    for name in names:
        path = check(scene, name.strip('"'))
        if os.path.isfile(path):
            check_materials(scene, path)


def main():
    try:
        check_scene(sys.argv[1])
    except (Refused, OSError, ValueError, struct.error) as error:
        sys.exit("unwrap: %s: %s" % (sys.argv[1], error))


if __name__ == "__main__":
    main()
