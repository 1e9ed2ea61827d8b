"""An add-on for Blender 3.4 and later. It bakes light with sbl_bake into a lightmap of the selected objects, and
renders with sbl_render into the image editor. Install it with Edit > Preferences > Add-ons > Install; its panel is in
the render properties. examples/README.md describes it."""
import json
import math
import os
import re
import shutil
import struct
import subprocess
import tempfile

import bpy
import numpy

bl_info = {
    "name": "sbl.h: bake and render",
    "author": "sbl.h",
    "version": (0, 2, 0),
    "blender": (3, 4, 0),
    "location": "Properties > Render > sbl.h",
    "description": "Bakes lightmaps with sbl_bake, and renders with sbl_render",
    "category": "Render",
}

if "bool" not in vars(numpy):  # the glTF add-on of Blender 3.4 uses it, but numpy 1.24 removed it
    numpy.bool = bool

LAYER = "Lightmap"              # name of the second UV map
ORIGINAL = "sbl_original"       # custom property of materials with baked light: the material that they replace
MODULE = __package__ or __name__


class Failure(Exception):
    """An error with a message for the user."""


# ---- running the tools ----

def find_tool(name):
    entry = bpy.context.preferences.addons.get(MODULE)
    folder = bpy.path.abspath(entry.preferences.folder) if entry else ""
    path = shutil.which(name, path=folder or None)
    if not path:
        raise Failure("%s is not found%s: build it with scripts/build %s, and set the folder in the add-on's "
                      "preferences" % (name, " in " + folder if folder else " on PATH", name))
    return path


class Job:
    """A tool that runs as a process. Its error stream is a terminal, so that it draws its progress bar."""

    def __init__(self, command, folder):
        self.folder, self.said, self.done = folder, "", 0.0
        self.terminal, theirs = -1, subprocess.PIPE
        try:
            import pty
            self.terminal, theirs = pty.openpty()
            os.set_blocking(self.terminal, False)
        except (ImportError, OSError):  # on Windows there is no progress
            pass
        self.process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=theirs,
                                        start_new_session=True)
        if self.terminal >= 0:
            os.close(theirs)

    def read(self):
        while self.terminal >= 0:
            try:
                text = os.read(self.terminal, 4096)
            except BlockingIOError:
                break
            except OSError:  # the process has ended
                text = b""
            if not text:
                os.close(self.terminal)
                self.terminal = -1
            self.said = (self.said + text.decode(errors="replace"))[-20000:]
        for share in re.findall(r"\] +(\d+) %", self.said):
            self.done = max(self.done, int(share) / 100)

    def lines(self):
        """Returns the messages of the tool, without the progress bar."""
        return [line for line in re.split(r"[\r\n]+", self.said) if re.match(r"sbl_\w+: ", line)]

    def poll(self):
        """Returns whether the tool has ended. Raises an error if it has failed."""
        self.read()
        if self.process.poll() is None:
            return False
        self.read()
        if self.terminal < 0 and self.process.stderr:
            self.said += self.process.stderr.read().decode(errors="replace")
        if self.process.returncode:
            raise Failure((self.lines() or ["the tool ended with status %d" % self.process.returncode])[-1])
        return True

    def end(self):
        """Ends the process if it still runs, and removes its files."""
        if self.process.poll() is None:
            self.process.terminate()
            try:
                self.process.wait(0.5)
            except subprocess.TimeoutExpired:  # a second signal ends the tool at once
                self.process.kill()
                self.process.wait()
        if self.terminal >= 0:
            os.close(self.terminal)
            self.terminal = -1
        shutil.rmtree(self.folder, ignore_errors=True)


# ---- exporting the scene ----

def sky_options(scene):
    """Returns the background of the world, which glTF does not store, as options of the tools."""
    world, color = scene.world, (0.0, 0.0, 0.0)
    if world and world.use_nodes:
        for node in world.node_tree.nodes:
            if node.type == "BACKGROUND" and node.outputs[0].is_linked:
                strength = node.inputs["Strength"].default_value
                color = [strength * x for x in node.inputs["Color"].default_value[:3]]
    elif world:
        color = world.color
    return ["--sky", ",".join("%.9g" % x for x in color)]


class Originals:
    """A context manager. Inside it, objects have the materials that baked light has replaced."""

    def __enter__(self):
        self.slots = []
        for thing in bpy.context.scene.objects:
            for slot in thing.material_slots:
                if slot.material and slot.material.get(ORIGINAL):
                    self.slots.append((slot, slot.material))
                    slot.material = slot.material[ORIGINAL]

    def __exit__(self, *_):
        for slot, material in self.slots:
            slot.material = material


class Unwrapped:
    """A context manager. Inside it, objects have copies of their meshes, with lightmap coordinates in the UV map
    LAYER."""

    def __init__(self, objects, size, keep):
        self.objects, self.size, self.keep = objects, size, keep
        self.charts, self.index, self.meshes = {}, {}, []
        self.active, self.selected = bpy.context.view_layer.objects.active, list(bpy.context.selected_objects)

    def __enter__(self):
        try:
            return self.unwrap()
        except BaseException:
            self.__exit__()
            raise

    def unwrap(self):
        layer, context = bpy.context.view_layer, bpy.context
        if context.mode != "OBJECT":
            bpy.ops.object.mode_set(mode="OBJECT")
        self.meshes = [thing.data for thing in self.objects]
        for thing in self.objects:
            thing.data = thing.data.copy()
        bpy.ops.object.select_all(action="DESELECT")
        for thing in self.objects:
            thing.select_set(True)
            self.add_layer(thing)
        layer.objects.active = self.objects[0]
        if not self.keep:
            bpy.ops.object.mode_set(mode="EDIT")
            bpy.ops.mesh.reveal()
            bpy.ops.mesh.select_all(action="SELECT")
            options = {"angle_limit": math.radians(66), "island_margin": 2 / self.size}
            if "margin_method" in bpy.ops.uv.smart_project.get_rna_type().properties:
                options["margin_method"] = "FRACTION"
            bpy.ops.uv.smart_project(**options)
            bpy.ops.object.mode_set(mode="OBJECT")
        for thing in self.objects:
            layers = thing.data.uv_layers
            self.index[thing.name] = layers.find(LAYER)
            self.charts[thing.name] = numpy.empty(2 * len(thing.data.loops), numpy.float32)
            layers[LAYER].data.foreach_get("uv", self.charts[thing.name])
        return self

    def add_layer(self, thing):
        layers = thing.data.uv_layers
        if self.keep:
            if LAYER not in layers:
                raise Failure("%s has no UV map %s: turn off Keep UV Map" % (thing.name, LAYER))
        else:
            if not layers:
                layers.new(name="UVMap")
            if LAYER not in layers and not layers.new(name=LAYER):
                raise Failure("%s has too many UV maps: remove one" % thing.name)
        layers.active = layers[LAYER]

    def __exit__(self, *_):
        if bpy.context.mode != "OBJECT":
            bpy.ops.object.mode_set(mode="OBJECT")
        for thing, mesh in zip(self.objects, self.meshes):
            copy, thing.data = thing.data, mesh
            bpy.data.meshes.remove(copy)
        for thing in self.objects:
            thing.select_set(False)
        for thing in self.selected:
            thing.select_set(True)
        bpy.context.view_layer.objects.active = self.active


def export(path, only_selected):
    bpy.ops.export_scene.gltf(filepath=path, export_format="GLB", use_selection=only_selected,
                              use_visible=not only_selected, export_apply=True, export_cameras=True,
                              export_lights=True, export_yup=True, export_animations=False)


def choose_charts(path, index):
    """Makes the UV map with the lightmap coordinates the second set of the nodes in index, and removes this set from
    other nodes."""
    with open(path, "rb") as file:
        data = file.read()
    end = 20 + struct.unpack("<I", data[12:16])[0]
    document = json.loads(data[20:end].decode())
    layer_of = {node["mesh"]: index[node["name"]] for node in document.get("nodes", ())
                if "mesh" in node and node.get("name") in index}
    for number, mesh in enumerate(document.get("meshes", ())):
        for primitive in mesh["primitives"]:
            attributes = primitive["attributes"]
            charts = attributes.get("TEXCOORD_%d" % layer_of[number]) if number in layer_of else None
            for name in [name for name in attributes if re.match(r"TEXCOORD_[1-9]", name)]:
                del attributes[name]
            if charts is not None:
                attributes["TEXCOORD_1"] = charts
    text = json.dumps(document, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    rest = data[end:]
    with open(path, "wb") as file:
        file.write(struct.pack("<4sIIII", b"glTF", 2, 20 + len(text) + len(rest), len(text), 0x4E4F534A) + text + rest)


# ---- showing the light in materials ----

def source(tree, shader, names, default):
    """Returns the socket that is connected to an input of a shader, or the value of the input."""
    for name in names:
        found = shader.inputs.get(name) if shader else None
        if found:
            return found.links[0].from_socket if found.is_linked else tuple(found.default_value)
    return default


def mix(tree, operation, a, b):
    node = tree.nodes.new("ShaderNodeMixRGB")
    node.blend_type = operation
    node.inputs[0].default_value = 1
    for socket, value in zip(node.inputs[1:3], (a, b)):
        if isinstance(value, tuple):
            socket.default_value = value
        else:
            tree.links.new(value, socket)
    return node.outputs[0]


def lit(material, image):
    """Returns a copy of a material that shows emission + base colour * R, where R is the lightmap."""
    copy = material.copy() if material else bpy.data.materials.new("Material")
    copy.name = (material.name if material else "Material") + " (baked)"
    copy[ORIGINAL] = material
    copy.use_nodes = True
    tree = copy.node_tree
    output = tree.get_output_node("CYCLES") or tree.nodes.new("ShaderNodeOutputMaterial")
    surface = output.inputs["Surface"]
    shader = surface.links[0].from_node if surface.is_linked else None
    base = source(tree, shader, ("Base Color",) if shader and shader.type == "BSDF_PRINCIPLED" else
                  ("Color",) if shader and shader.type != "EMISSION" else (), (0.8, 0.8, 0.8, 1.0))
    glow = (0.0, 0.0, 0.0, 1.0)
    if shader and shader.type == "EMISSION":
        base, glow = glow, source(tree, shader, ("Color",), glow)
    elif shader and shader.type == "BSDF_PRINCIPLED":
        glow = source(tree, shader, ("Emission Color", "Emission"), glow)
    strength = shader.inputs.get("Emission Strength") or shader.inputs.get("Strength") if shader else None
    factor = strength.default_value if strength else 1.0
    place = tree.nodes.new("ShaderNodeUVMap")
    place.uv_map = LAYER
    light = tree.nodes.new("ShaderNodeTexImage")
    light.image = image
    light.label = LAYER
    tree.links.new(place.outputs["UV"], light.inputs["Vector"])
    glow = mix(tree, "MULTIPLY", glow, (factor, factor, factor, 1.0))
    emission = tree.nodes.new("ShaderNodeEmission")
    tree.links.new(mix(tree, "ADD", glow, mix(tree, "MULTIPLY", light.outputs["Color"], base)),
                   emission.inputs["Color"])
    tree.links.new(emission.outputs[0], surface)
    return copy


def show_light(objects, charts, image):
    """Gives objects the lightmap: its coordinates in a UV map, and materials that show it."""
    copies = {}
    for thing in objects:
        if thing.data.users > 1:  # instances have different light, so each needs a mesh of its own
            thing.data = thing.data.copy()
        layers = thing.data.uv_layers
        if not layers:
            layers.new(name="UVMap")
        layer = layers.get(LAYER) or layers.new(name=LAYER)
        layer.data.foreach_set("uv", charts[thing.name])
        if not thing.data.materials:
            thing.data.materials.append(None)
        for slot in thing.material_slots:
            old = slot.material
            old = old[ORIGINAL] if old and old.get(ORIGINAL) else old
            if old not in copies:
                copies[old] = lit(old, image)
            slot.material = copies[old]


def hide_light(objects):
    """Restores the materials that baked light has replaced."""
    found = 0
    for thing in objects:
        for slot in thing.material_slots:
            if slot.material and slot.material.get(ORIGINAL):
                slot.material = slot.material[ORIGINAL]
                found += 1
    return found


def load_picture(path, name):
    """Loads a picture of linear values and packs it into the .blend file."""
    old = bpy.data.images.get(name)
    image = bpy.data.images.load(path)
    known = {item.identifier for item in
             bpy.types.ColorManagedInputColorspaceSettings.bl_rna.properties["name"].enum_items}
    image.colorspace_settings.name = next(s for s in ("Linear Rec.709", "Linear", "Non-Color") if s in known)
    image.pack()
    if old:
        old.user_remap(image)
        bpy.data.images.remove(old)
    image.name = name
    return image


# ---- operators ----

class Bake:
    """Bakes the selected objects."""

    def __init__(self, context):
        settings = context.scene.sbl
        tool = find_tool("sbl_bake")
        self.objects = [thing for thing in context.selected_objects
                        if thing.type == "MESH" and thing.data.polygons]
        if not self.objects:
            raise Failure("select the objects that get a lightmap: no mesh is selected")
        folder = tempfile.mkdtemp(prefix="sbl_blender_")
        path, self.out = os.path.join(folder, "scene.glb"), os.path.join(folder, "out")
        try:
            with Originals(), Unwrapped(self.objects, settings.size, settings.keep) as unwrapped:
                export(path, settings.only_selected)
                choose_charts(path, unwrapped.index)
            self.charts = unwrapped.charts
            self.job = Job([tool, path, "--lightmap", str(settings.size), "-o", self.out,
                            "--preset", settings.preset, "--mode", settings.mode] + sky_options(context.scene), folder)
        except BaseException:
            shutil.rmtree(folder, ignore_errors=True)
            raise

    def finish(self, context):
        for name in ("atlas.exr", "atlas.hdr", "lightmap.exr", "lightmap.hdr"):
            path = os.path.join(self.out, name)
            if os.path.exists(path):
                show_light(self.objects, self.charts, load_picture(path, LAYER))
                return "%d objects have baked light" % len(self.objects)
        raise Failure("sbl_bake has written no .exr and no .hdr: was it built without OpenEXR?")


class Render:
    """Renders a picture through the active camera."""

    def __init__(self, context):
        scene, settings = context.scene, context.scene.sbl
        tool = find_tool("sbl_render")
        if not scene.camera or scene.camera.type != "CAMERA" or scene.camera.data.type != "PERSP":
            raise Failure("the scene needs an active camera with perspective")
        size = [max(1, x * scene.render.resolution_percentage // 100)
                for x in (scene.render.resolution_x, scene.render.resolution_y)]
        lens = scene.camera.calc_matrix_camera(context.evaluated_depsgraph_get(), x=size[0], y=size[1])
        place = scene.camera.evaluated_get(context.evaluated_depsgraph_get()).matrix_world
        eye, at, up = place.to_translation(), place @ _vector(0, 0, -1), place.to_quaternion() @ _vector(0, 1, 0)
        folder = tempfile.mkdtemp(prefix="sbl_blender_")
        path, self.out = os.path.join(folder, "scene.glb"), os.path.join(folder, "picture.exr")
        try:
            with Originals():
                export(path, settings.only_selected)
            self.job = Job([tool, path, "-o", self.out, "--size", "%dx%d" % tuple(size), "--eye", _gltf(eye),
                            "--look-at", _gltf(at), "--up", _gltf(up),
                            "--fov", "%.9g" % math.degrees(2 * math.atan(1 / lens[1][1])),
                            "--preset", settings.preset, "--mode", settings.mode] + sky_options(scene), folder)
        except BaseException:
            shutil.rmtree(folder, ignore_errors=True)
            raise

    def finish(self, context):
        image = load_picture(self.out, "sbl.h render")
        for area in context.screen.areas if context.screen else ():
            if area.type == "IMAGE_EDITOR":
                area.spaces.active.image = image
        return "the picture is in the image editor: %s" % image.name


def _vector(x, y, z):
    from mathutils import Vector
    return Vector((x, y, z))


def _gltf(v):
    return "%.9g,%.9g,%.9g" % (v.x, v.z, -v.y)


class ToolOperator(bpy.types.Operator):
    """The common part of both operators: they wait for a tool, show its progress, and can be cancelled."""
    bl_options = {"REGISTER", "UNDO"}

    def begin(self, context):
        try:
            self.work = self.make(context)
            return True
        except Failure as failure:
            self.report({"ERROR"}, str(failure))
            return False

    def execute(self, context):
        """Runs without a window, and waits for the tool."""
        if not self.begin(context):
            return {"CANCELLED"}
        while True:
            try:
                self.work.job.process.wait(0.1)
            except subprocess.TimeoutExpired:
                pass
            result = self.look(context)
            if result:
                return result

    def invoke(self, context, event):
        if not self.begin(context):
            return {"CANCELLED"}
        manager = context.window_manager
        self.timer = manager.event_timer_add(0.2, window=context.window)
        manager.progress_begin(0, 100)
        manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def look(self, context):
        """Returns a result if the tool has ended, otherwise None."""
        result = {"CANCELLED"}
        try:
            if not self.work.job.poll():
                return None
            self.report({"INFO"}, self.work.finish(context))
            for line in self.work.job.lines():
                self.report({"WARNING"} if "warning: " in line else {"INFO"}, line)
            result = {"FINISHED"}
        except Failure as failure:
            self.report({"ERROR"}, str(failure))
        self.work.job.end()
        return result

    def leave(self, context):
        context.window_manager.event_timer_remove(self.timer)
        context.window_manager.progress_end()
        context.workspace.status_text_set(None)

    def modal(self, context, event):
        if event.type == "ESC":
            self.cancel(context)
            self.report({"INFO"}, "cancelled")
            return {"CANCELLED"}
        if event.type == "TIMER":
            result = self.look(context)
            if result:
                self.leave(context)
                return result
            done = 100 * self.work.job.done
            context.window_manager.progress_update(done)
            context.workspace.status_text_set("%s: %d %%   Esc: cancel" % (self.bl_label, done))
        if event.type in {"MIDDLEMOUSE", "WHEELUPMOUSE", "WHEELDOWNMOUSE", "TIMER"}:
            return {"PASS_THROUGH"}
        return {"RUNNING_MODAL"}

    def cancel(self, context):
        self.work.job.end()
        self.leave(context)


class SBL_OT_bake(ToolOperator):
    """Bakes the light of the scene into a lightmap of the selected objects, and shows it in their materials"""
    bl_idname = "sbl.bake"
    bl_label = "Bake with sbl.h"
    make = Bake


class SBL_OT_render(ToolOperator):
    """Renders the scene by the active camera into the image editor"""
    bl_idname = "sbl.render"
    bl_label = "Render with sbl.h"
    make = Render


class SBL_OT_remove(bpy.types.Operator):
    """Gives the selected objects back their own materials; the UV map stays"""
    bl_idname = "sbl.remove"
    bl_label = "Remove Baked Light"
    bl_options = {"REGISTER", "UNDO"}

    def execute(self, context):
        if hide_light(context.selected_objects):
            return {"FINISHED"}
        self.report({"WARNING"}, "no selected object has baked light")
        return {"CANCELLED"}


# ---- settings and panel ----

class SBL_settings(bpy.types.PropertyGroup):
    size: bpy.props.IntProperty(name="Size", default=1024, min=16, max=16384, description="Texels across the lightmap")
    preset: bpy.props.EnumProperty(name="Quality", default="default", items=[
        ("draft", "Draft", "Fast"), ("default", "Default", ""), ("high", "High", "Slow, little noise")])
    mode: bpy.props.EnumProperty(name="Light", default="gi", items=[
        ("gi", "All light", "With the light that surfaces reflect"),
        ("direct", "Direct light", "Lights, emitting surfaces and sky only")])
    keep: bpy.props.BoolProperty(name="Keep UV Map", description="Uses the UV map named Lightmap as it is")
    only_selected: bpy.props.BoolProperty(name="Selected Only", description="Other objects neither block light nor "
                                          "reflect it, and other lights are off")


class SBL_preferences(bpy.types.AddonPreferences):
    bl_idname = MODULE
    folder: bpy.props.StringProperty(name="Folder of the tools", subtype="DIR_PATH",
                                     description="Where sbl_bake and sbl_render are. Default: PATH")

    def draw(self, context):
        self.layout.prop(self, "folder")


class SBL_PT_panel(bpy.types.Panel):
    bl_label = "sbl.h"
    bl_space_type = "PROPERTIES"
    bl_region_type = "WINDOW"
    bl_context = "render"

    def draw(self, context):
        settings, column = context.scene.sbl, self.layout.column()
        column.use_property_split = True
        for name in "mode", "preset", "only_selected", "size", "keep":
            column.prop(settings, name)
        column.operator("sbl.bake", icon="RENDER_STILL")
        column.operator("sbl.remove")
        column.operator("sbl.render", icon="IMAGE_DATA")


CLASSES = SBL_settings, SBL_preferences, SBL_OT_bake, SBL_OT_render, SBL_OT_remove, SBL_PT_panel


def register():
    for kind in CLASSES:
        bpy.utils.register_class(kind)
    bpy.types.Scene.sbl = bpy.props.PointerProperty(type=SBL_settings)


def unregister():
    del bpy.types.Scene.sbl
    for kind in reversed(CLASSES):
        bpy.utils.unregister_class(kind)


if __name__ == "__main__":
    register()
