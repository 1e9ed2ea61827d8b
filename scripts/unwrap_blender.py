# scripts/unwrap runs this script inside Blender, with the arguments SCENE OUT.glb SIZE DEGREES GAP.
import json
import math
import os
import struct
import sys

import bpy
import numpy

if not hasattr(numpy, "bool"):  # the glTF reader of Blender 3.4 needs it, but numpy 1.24 removed it
    numpy.bool = bool

scene, out, size, degrees, GAP = sys.argv[sys.argv.index("--") + 1:]
size, degrees, GAP = int(size), float(degrees), int(GAP)  # GAP: texels between charts


def read():
    for thing in list(bpy.data.objects):  # the cube, lamp and camera of the default file
        bpy.data.objects.remove(thing)
    if os.path.splitext(scene)[1].lower() == ".obj":
        bpy.ops.wm.obj_import(filepath=scene)
    else:
        bpy.ops.import_scene.gltf(filepath=scene)
    return [o for o in bpy.context.scene.objects if o.type == "MESH" and len(o.data.polygons)]


def unwrap(meshes):
    bpy.ops.object.select_all(action="DESELECT")
    for o in meshes:
        o.hide_set(False)
        o.select_set(True)
    bpy.context.view_layer.objects.active = meshes[0]
    bpy.ops.object.make_single_user(object=True, obdata=True)
    bpy.ops.object.parent_clear(type="CLEAR_KEEP_TRANSFORM")
    bpy.ops.object.transform_apply(location=False, rotation=False, scale=True)  # for charts in proportion
    for o in meshes:  # TEXCOORD_0 is reserved for materials, with or without textures
        layers = o.data.uv_layers
        if not layers:
            layers.new(name="UVMap")
        while len(layers) > 1:
            layers.remove(layers[-1])
        layers.active = layers.new(name="Lightmap")
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.reveal()
    bpy.ops.mesh.select_all(action="SELECT")
    bpy.ops.uv.smart_project(angle_limit=math.radians(degrees))
    bpy.ops.object.mode_set(mode="OBJECT")


class Chart:
    """The corners of the faces of an object that share edges in the map: their indices and coordinates."""

    def __init__(self, coordinates, corners):
        self.coordinates, self.corners = coordinates, numpy.array(corners)
        at = coordinates[self.corners]
        if numpy.ptp(at[:, 1]) > numpy.ptp(at[:, 0]):  # horizontal charts pack better
            at = numpy.stack((at[:, 1], -at[:, 0]), 1)
        self.low = at.min(0)
        self.at, self.extent = at - self.low, numpy.ptp(at, 0)

    def texels(self, scale):
        return [max(1, math.ceil(x * scale)) for x in self.extent]

    def place(self, column, row, scale):
        self.coordinates[self.corners] = (self.at * scale + (column, row)) / size


def charts_of(coordinates, mesh):
    parents = list(range(len(mesh.polygons)))

    def root(face):
        while parents[face] != face:
            parents[face] = parents[parents[face]]
            face = parents[face]
        return face

    seen = {}
    for face in mesh.polygons:
        corners = list(face.loop_indices)
        for a, b in zip(corners, corners[1:] + corners[:1]):
            ends = [(mesh.loops[c].vertex_index, tuple(coordinates[c])) for c in (a, b)]
            other = seen.setdefault(frozenset(ends), face.index)
            parents[root(face.index)] = root(other)
    charts = {}
    for face in mesh.polygons:
        charts.setdefault(root(face.index), []).extend(face.loop_indices)
    return [Chart(coordinates, corners) for corners in charts.values()]


def rows_of(charts, scale):
    """Returns the positions of the charts, in rows from the highest chart to the lowest, or None if they do not fit."""
    places, column, row, high = [], GAP // 2, GAP // 2, 0
    for chart in charts:
        width, height = chart.texels(scale)
        if column + width + GAP // 2 > size:
            column, row, high = GAP // 2, row + high + GAP, 0
        if column + width + GAP // 2 > size or row + height + GAP // 2 > size:
            return None
        places.append((column, row))
        column, high = column + width + GAP, max(high, height)
    return places


def pack(meshes):
    """Packs charts at integer distances in texels, because the packer of Blender 3.4 lets some overlap."""
    layers = [o.data.uv_layers["Lightmap"].data for o in meshes]
    coordinates = []
    for layer in layers:
        flat = numpy.empty(2 * len(layer), numpy.float32)
        layer.foreach_get("uv", flat)
        coordinates.append(flat.reshape(-1, 2).astype(numpy.float64))
    charts = [c for o, uv in zip(meshes, coordinates) for c in charts_of(uv, o.data)]
    charts.sort(key=lambda c: (-c.extent[1], -c.extent[0]))
    low, high = 0.0, 8.0 * size
    for _ in range(40):
        scale = (low + high) / 2
        low, high = (scale, high) if rows_of(charts, scale) else (low, scale)
    places = rows_of(charts, low)
    if not places:
        sys.exit("unwrap: %d charts are too many for %d x %d texels; give a larger size, or more degrees" %
                 (len(charts), size, size))
    for chart, place in zip(charts, places):
        chart.place(place[0], place[1], low)
    for layer, uv in zip(layers, coordinates):
        layer.foreach_set("uv", uv.astype(numpy.float32).ravel())
    return len(charts)


def chunk(path):
    """Returns the JSON of a .gltf or .glb, and the part of the file after it."""
    with open(path, "rb") as file:
        data = file.read()
    end = 20 + struct.unpack("<I", data[12:16])[0] if data[:4] == b"glTF" else len(data)
    return json.loads(data[20 if data[:4] == b"glTF" else 0:end].decode()), data[end:]


def keep_generator():
    """Keeps the name of the program that wrote the lights, because it determines their unit (see
    examples/scene_units.h)."""
    document, rest = chunk(out)
    is_gltf = os.path.splitext(scene)[1].lower() != ".obj"
    document["asset"]["generator"] = (chunk(scene)[0]["asset"] if is_gltf else {}).get("generator", "sbl.h unwrap")
    text = json.dumps(document, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    with open(out, "wb") as file:
        file.write(struct.pack("<4sIIII", b"glTF", 2, 20 + len(text) + len(rest), len(text), 0x4E4F534A) + text + rest)


meshes = read()
if not meshes:
    sys.exit("unwrap: the scene has no surface")
unwrap(meshes)
count = pack(meshes)
for o in meshes:
    o.data.uv_layers.active_index = 0
bpy.ops.export_scene.gltf(filepath=out, export_format="GLB", export_cameras=True, export_lights=True, export_yup=True)
keep_generator()
print("unwrap: %s: %d meshes, %d faces, %d charts" %
      (out, len(meshes), sum(len(o.data.polygons) for o in meshes), count))
