# tests/test_blender.sh runs this script inside Blender. It tests scripts/blender_addon.py against Blender's Cycles.
# Arguments: the folder of the tools, and a folder for pictures.
import glob
import math
import os
import sys
import tempfile
import time

import bpy
import numpy

TOOLS, OUT = sys.argv[sys.argv.index("--") + 1:]
SIZE, BLOCK = 96, 4
counts = {"passed": 0, "failed": 0}


def check(name, condition, words):
    print("%s %s  %s" % ("ok  " if condition else "FAIL", name, words), flush=True)
    counts["passed" if condition else "failed"] += 1


def quad(name, corners, color, emission=0.0):
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(corners, [], [range(4 * i, 4 * i + 4) for i in range(len(corners) // 4)])
    thing = bpy.data.objects.new(name, mesh)
    material = bpy.data.materials.new(name)
    material.use_nodes = True
    shader = material.node_tree.nodes["Principled BSDF"]
    shader.inputs["Base Color"].default_value = (*color, 1)
    shader.inputs["Specular"].default_value = 0
    shader.inputs["Roughness"].default_value = 1
    shader.inputs["Emission"].default_value = (emission, emission, emission, 1)
    mesh.materials.append(material)
    bpy.context.scene.collection.objects.link(thing)
    return thing


def box(low, high):
    (x, y, z), (X, Y, Z) = low, high
    return [(x, y, z), (x, Y, z), (X, Y, z), (X, y, z), (x, y, Z), (X, y, Z), (X, Y, Z), (x, Y, Z),
            (x, y, z), (X, y, z), (X, y, Z), (x, y, Z), (x, Y, z), (x, Y, Z), (X, Y, Z), (X, Y, z),
            (x, y, z), (x, y, Z), (x, Y, Z), (x, Y, z), (X, y, z), (X, Y, z), (X, Y, Z), (X, y, Z)]


def make_scene():
    """Makes a Cornell box, open towards -y, with a lamp of 10 W in addition to the emitting surface."""
    for thing in list(bpy.data.objects):
        bpy.data.objects.remove(thing)
    bpy.context.scene.world.node_tree.nodes["Background"].inputs["Strength"].default_value = 0
    white = quad("white", [(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0), (-1, -1, 2), (-1, 1, 2), (1, 1, 2),
                           (1, -1, 2), (-1, 1, 0), (1, 1, 0), (1, 1, 2), (-1, 1, 2)], (0.75, 0.75, 0.75))
    red = quad("red", [(-1, -1, 0), (-1, 1, 0), (-1, 1, 2), (-1, -1, 2)], (0.6, 0.05, 0.05))
    green = quad("green", [(1, 1, 0), (1, -1, 0), (1, -1, 2), (1, 1, 2)], (0.1, 0.5, 0.1))
    block = quad("block", box((-0.5, -0.2, 0), (0.1, 0.4, 0.9)), (0.7, 0.7, 0.7))
    quad("lamp", [(-0.3, -0.3, 1.98), (-0.3, 0.3, 1.98), (0.3, 0.3, 1.98), (0.3, -0.3, 1.98)], (0, 0, 0), 8)
    light = bpy.data.lights.new("point", "POINT")
    light.energy, light.shadow_soft_size = 10, 0
    point = bpy.data.objects.new("point", light)
    point.location = 0.6, -0.5, 1.2
    lens = bpy.data.cameras.new("lens")
    camera = bpy.data.objects.new("camera", lens)
    camera.location, camera.rotation_euler = (0, -3.8, 1), (math.pi / 2, 0, 0)
    for thing in point, camera:
        bpy.context.scene.collection.objects.link(thing)
    bpy.context.scene.camera = camera
    return [white, red, green, block]


def select(objects):
    bpy.ops.object.select_all(action="DESELECT")
    for thing in objects:
        thing.select_set(True)
    bpy.context.view_layer.objects.active = objects[0]


def pixels(image):
    values = numpy.empty(4 * image.size[0] * image.size[1], numpy.float32)
    image.pixels.foreach_get(values)
    return values.reshape(image.size[1], image.size[0], 4).astype(float)


def blocks(values, mask):
    """Returns means over blocks of texels; blocks that are not completely filled are omitted."""
    h, w = values.shape[0] // BLOCK, values.shape[1] // BLOCK
    whole = mask[:h * BLOCK, :w * BLOCK].reshape(h, BLOCK, w, BLOCK).all((1, 3))
    cut = values[:h * BLOCK, :w * BLOCK].reshape(h, BLOCK, w, BLOCK, -1).mean((1, 3))
    return cut[whole]


def compare(name, ours, theirs, mask, most):
    a, b = blocks(ours[..., :3], mask), blocks(theirs[..., :3], mask)
    ratio = a.mean() / b.mean()
    error = math.sqrt(((a - b) ** 2).mean()) / b.mean()
    check(name, len(a) > 50 and abs(ratio - 1) < 0.02 and error < most,
          "%d blocks, mean ratio %.4f, error %.2f %%" % (len(a), ratio, 100 * error))


def state():
    """Returns the state that a cancelled operator must not change."""
    return ([(t.name, t.data.name if t.data else "", [s.material and s.material.name for s in t.material_slots])
             for t in bpy.data.objects], [(m.name, [l.name for l in m.uv_layers]) for m in bpy.data.meshes],
            sorted(i.name for i in bpy.data.images), sorted(m.name for m in bpy.data.materials),
            sorted(glob.glob(os.path.join(tempfile.gettempdir(), "sbl_blender_*"))),
            sorted(t.name for t in bpy.context.selected_objects))


def cycles(samples):
    scene = bpy.context.scene
    scene.render.engine, scene.cycles.device, scene.cycles.samples = "CYCLES", "CPU", samples
    scene.cycles.use_adaptive_sampling = scene.cycles.use_denoising = False
    scene.cycles.max_bounces = scene.cycles.diffuse_bounces = 32
    scene.cycles.sample_clamp_indirect = 0
    scene.render.use_persistent_data = True


def bake_by_cycles(objects):
    image = bpy.data.images.new("truth", SIZE, SIZE, alpha=True, float_buffer=True)
    image.pixels.foreach_set(numpy.zeros(4 * SIZE * SIZE, numpy.float32))
    for thing in objects:
        thing.data.uv_layers.active = thing.data.uv_layers["Lightmap"]
        tree = thing.material_slots[0].material.node_tree
        tree.nodes.active = tree.nodes.new("ShaderNodeTexImage")
        tree.nodes.active.image = image
    cycles(32)
    bpy.ops.object.bake(type="DIFFUSE", pass_filter={"DIRECT", "INDIRECT"}, margin=0, use_clear=False)
    return pixels(image)


def inner(mask):
    """Returns the texels whose neighbours are filled, too."""
    out = mask.copy()
    for axis in 0, 1:
        for step in -1, 1:
            out &= numpy.roll(mask, step, axis)
    return out


def make_lambertian():
    """Replaces Blender's shader, whose diffuse part differs from that of glTF, by the material of the exported file."""
    for material in bpy.data.materials:
        tree = material.node_tree
        shader = tree.nodes.get("Principled BSDF") if tree else None
        if not shader or "baked" in material.name:
            continue
        both, diffuse, glow = (tree.nodes.new("Shader" + kind) for kind in
                               ("NodeAddShader", "NodeBsdfDiffuse", "NodeEmission"))
        diffuse.inputs["Color"].default_value = shader.inputs["Base Color"].default_value
        glow.inputs["Color"].default_value = shader.inputs["Emission"].default_value
        tree.links.new(diffuse.outputs[0], both.inputs[0])
        tree.links.new(glow.outputs[0], both.inputs[1])
        tree.links.new(both.outputs[0], tree.nodes["Material Output"].inputs["Surface"])


def render_by_cycles(path, samples):
    cycles(samples)
    bpy.context.scene.render.image_settings.file_format = "OPEN_EXR"
    bpy.context.scene.render.filepath = path
    bpy.ops.render.render(write_still=True)
    return pixels(bpy.data.images.load(path))


def run(operator):
    """Returns the error message of the operator, or an empty text."""
    try:
        result = operator()
        return "" if result == {"FINISHED"} else str(result)
    except RuntimeError as error:  # reports of errors
        return str(error).strip()


def test_tools_are_missing(objects):
    import blender_addon
    preferences = bpy.context.preferences.addons["blender_addon"].preferences
    select(objects)
    before = state()
    preferences.folder = OUT
    said = run(bpy.ops.sbl.bake)
    check("missing_tool", "sbl_bake is not found" in said and "preferences" in said and state() == before, said)
    preferences.folder = TOOLS
    bpy.ops.object.select_all(action="DESELECT")
    said = run(bpy.ops.sbl.bake)
    check("nothing_selected", "no mesh is selected" in said, said)
    select(objects)
    bpy.context.scene.sbl.keep = True
    said = run(bpy.ops.sbl.bake)
    bpy.context.scene.sbl.keep = False
    check("no_map_to_keep", "has no UV map Lightmap" in said and state() == before, said)
    work = blender_addon.Bake(bpy.context)
    during = state()
    while work.job.done <= 0 and not work.job.poll():
        time.sleep(0.05)
    done = work.job.done
    work.job.end()
    check("cancel_leaves_nothing", state() == before and during[:4] == before[:4] and 0 < done <= 1 and
          work.job.process.poll() is not None, "at %d %%" % (100 * done))


def test_bake(objects):
    select(objects)
    said = run(bpy.ops.sbl.bake)
    names = [s.material.name for t in objects for s in t.material_slots]
    check("bakes", not said and names[0] == "white (baked)", said or ", ".join(names))
    ours = pixels(bpy.data.images["Lightmap"])
    shown = render_by_cycles(os.path.join(OUT, "baked.exr"), 4)
    check("removes", run(bpy.ops.sbl.remove) == "" and objects[0].material_slots[0].material.name == "white", "")
    said = run(bpy.ops.sbl.render)
    check("renders", not said, said)
    make_lambertian()
    truth = bake_by_cycles(objects)
    brightness = truth[..., :3].max(2)  # sbl_bake fills hidden texels; Cycles gathers a lamp's own light beside it
    seen = inner((truth[..., 3] > 0) & (brightness > 0.02)) & (brightness < 1.5) & (ours[..., :3].max(2) < 1.5)
    compare("agrees_with_cycles", ours, truth, seen, 0.05)
    picture = pixels(bpy.data.images["sbl.h render"])
    path_traced = render_by_cycles(os.path.join(OUT, "traced.exr"), 64)
    dim = (path_traced[..., :3].max(2) < 1.5) & (picture[..., :3].max(2) < 1.5)  # excludes the lamp
    compare("picture_agrees_with_cycles", picture, path_traced, dim, 0.08)
    compare("baked_materials_agree", shown, picture, dim, 0.08)
    for name, values in ("render", picture), ("baked", shown), ("traced", path_traced), ("map", ours), ("truth", truth):
        image = bpy.data.images.new(name, values.shape[1], values.shape[0])
        image.pixels.foreach_set(numpy.clip(values, 0, 1).astype(numpy.float32).ravel())
        image.filepath_raw, image.file_format = os.path.join(OUT, name + ".png"), "PNG"
        image.save()


sys.path.insert(0, "scripts")
sys.dont_write_bytecode = True
bpy.context.preferences.filepaths.use_scripts_auto_execute = False
import addon_utils
addon_utils.enable("blender_addon", default_set=True)
things = make_scene()
render = bpy.context.scene.render
render.resolution_x, render.resolution_y, render.resolution_percentage = 64, 48, 100
bpy.context.scene.sbl.size, bpy.context.scene.sbl.preset = SIZE, "draft"
test_tools_are_missing(things)
test_bake(things)
print("%(passed)d passed, %(failed)d failed" % counts)
