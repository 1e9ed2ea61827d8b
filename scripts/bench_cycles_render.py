"""bench_cycles_blender.py runs this script inside Blender 3.x. It prepares a scene for Cycles once, and then renders it
for each line "SAMPLES SEED FILE" on stdin. If the job has a "lightmap", it instead bakes a lightmap of that width in
texels, with the second texture coordinates of the meshes.

Every surface is a two-sided Lambertian surface with the base colour of the file; if the job is "glossy", surfaces also
have the metal, gloss and panes of the file. Every emitter emits on both sides. The job sets the number of bounces.
Nothing is clamped, denoised or adaptive, and pixels are sampled at their centres. Geometry and hierarchy stay in memory
between pictures. After each picture, the script prints a line "BENCH SECONDS" with the time of Blender's render call,
which does not include writing the file. The file is OpenEXR, or for a lightmap raw floats (red, green, blue; bottom row
first).
"""
import json, math, sys, time
import bpy
from mathutils import Matrix, Vector

job = json.loads(sys.argv[sys.argv.index('--') + 1])
bpy.ops.wm.read_factory_settings(use_empty=True)
to_blender = Matrix()
if job['file'].endswith('.obj'):
    bpy.ops.wm.obj_import(filepath=job['file'], forward_axis='Y', up_axis='Z')  # keeps the coordinates
else:
    import numpy
    if not hasattr(numpy, 'bool'):
        numpy.bool = bool  # needed by the importer of Blender 3.4, removed in numpy 1.24
    bpy.ops.import_scene.gltf(filepath=job['file'])
    to_blender = Matrix.Rotation(math.pi / 2, 4, 'X')  # the glTF importer has turned y-up into z-up


class Shader:
    """Replaces the shader that the importer made for a material. Each method adds a node and returns its output."""

    def __init__(self, material):
        self.tree, self.name = material.node_tree, material.name
        self.made = next(n for n in self.tree.nodes if n.type == 'BSDF_PRINCIPLED')

    def node(self, kind, *inputs, **settings):
        """inputs: in the order of the node; each is an output, a value, or None to keep the default of the node"""
        made = self.tree.nodes.new('ShaderNode' + kind)
        for key, value in settings.items():
            setattr(made, key, value)
        for target, value in zip(made.inputs, inputs):
            if isinstance(value, bpy.types.NodeSocket):
                self.tree.links.new(value, target)
            elif value is not None:
                target.default_value = value
        return made.outputs[0]

    def read(self, name):
        """Returns the output that is connected to an input of the importer's shader, or the value of the input."""
        source = self.made.inputs[name]
        return source.links[0].from_socket if source.is_linked else source.default_value

    def math(self, operation, *inputs):
        return self.node('Math', *inputs, operation=operation)

    def emission(self):
        color = self.read('Emission')
        dark = not isinstance(color, bpy.types.NodeSocket) and max(color[:3]) == 0
        return self.node('Emission', color, 0 if dark else self.read('Emission Strength'))

    def lambertian(self):
        if self.made.inputs['Alpha'].is_linked:
            sys.exit('%s: cut-outs are not supported' % self.name)
        return self.node('BsdfDiffuse', self.read('Base Color'))

    def glossy(self):
        """Builds the lobes of glTF 2.0. The Fresnel term uses the angle of the viewer, and the index of refraction of
        the front side, because panes are thin."""
        base, roughness, metallic = (self.read(name) for name in ('Base Color', 'Roughness', 'Metallic'))
        back = self.tree.nodes.new('ShaderNodeNewGeometry').outputs['Backfacing']
        fresnel = self.node('Fresnel', self.math('MULTIPLY_ADD', back, 1 / 1.5 - 1.5, 1.5))
        facing = self.tree.nodes.new('ShaderNodeLayerWeight').outputs['Facing']
        tint = self.node('MixRGB', self.math('POWER', facing, 5), base, (1, 1, 1, 1))
        body = self.node('MixShader', self.read('Transmission'), self.node('BsdfDiffuse', base),
                         self.node('BsdfTransparent', base))
        coated = self.node('MixShader', fresnel, body, self.node('BsdfGlossy', (1, 1, 1, 1), roughness,
                                                                 distribution='GGX'))
        metal = self.node('BsdfGlossy', tint, roughness, distribution='GGX')
        whole = self.node('MixShader', metallic, coated, metal)
        return self.node('MixShader', self.read('Alpha'), self.node('BsdfTransparent', (1, 1, 1, 1)), whole)

    def replace(self, surface):
        output = next(n for n in self.tree.nodes if n.type == 'OUTPUT_MATERIAL')
        self.tree.links.new(self.node('AddShader', surface, self.emission()), output.inputs['Surface'])


for material in bpy.data.materials:
    if material.use_nodes:
        shader = Shader(material)
        shader.replace(shader.glossy() if job.get('glossy') else shader.lambertian())
for mesh in bpy.data.meshes if job.get('glossy') else ():
    mesh.use_auto_smooth = False  # otherwise surfaces would be black where the normals of the file point to the back
for thing in list(bpy.data.objects):
    if thing.type in ('CAMERA', 'LIGHT'):
        bpy.data.objects.remove(thing)

scene = bpy.context.scene
scene.world = bpy.data.worlds.new('sky')
scene.world.use_nodes = True
scene.world.node_tree.nodes['Background'].inputs['Color'].default_value = (*job.get('sky', (0, 0, 0)), 1)
render, cycles = scene.render, scene.cycles
render.engine, cycles.device = 'CYCLES', 'CPU'
render.threads_mode, render.threads = 'FIXED', job['threads']
render.use_persistent_data = True
cycles.use_adaptive_sampling = cycles.use_denoising = False
cycles.max_bounces = cycles.diffuse_bounces = job['bounces']
cycles.glossy_bounces = cycles.transparent_max_bounces = job['bounces']
cycles.blur_glossy = 0
cycles.sample_clamp_direct = cycles.sample_clamp_indirect = 0
cycles.caustics_reflective = cycles.caustics_refractive = bool(job.get('glossy'))


def camera():
    """Returns two functions: one renders the picture through the camera of the job, one writes it."""
    eye, look_at, up = (Vector(job[key]) for key in ('eye', 'look_at', 'up'))
    backward = (eye - look_at).normalized()
    right = up.cross(backward).normalized()
    lens = bpy.data.cameras.new('lens')
    lens.sensor_fit, lens.angle = 'VERTICAL', math.radians(job['fov'])
    lens.clip_start, lens.clip_end = 1e-3, 1e6
    scene.camera = bpy.data.objects.new('camera', lens)
    scene.collection.objects.link(scene.camera)
    scene.camera.matrix_world = to_blender @ Matrix.Translation(eye) @ Matrix((right, backward.cross(right),
                                                                      backward)).transposed().to_4x4()
    render.resolution_x, render.resolution_y = job['size']
    render.resolution_percentage = 100
    cycles.pixel_filter_type, cycles.filter_width = 'GAUSSIAN', 0.01  # narrowest, for pixel centres
    # the sum of these passes, without the colour of the surface, is R
    scene.view_layers[0].use_pass_diffuse_direct = scene.view_layers[0].use_pass_diffuse_indirect = True
    image = render.image_settings
    image.file_format, image.color_depth, image.exr_codec = 'OPEN_EXR_MULTILAYER', '32', 'NONE'
    scene.view_settings.view_transform = 'Raw'
    return bpy.ops.render.render, lambda path: bpy.data.images['Render Result'].save_render(path, scene=scene)


def lightmap():
    """Returns two functions that bake a lightmap of R and write it."""
    import numpy
    size = job['lightmap']
    image = bpy.data.images.new('light', size, size, float_buffer=True)
    for material in bpy.data.materials:
        if material.use_nodes:  # Blender bakes into the active image node
            material.node_tree.nodes.active = material.node_tree.nodes.new('ShaderNodeTexImage')
            material.node_tree.nodes.active.image = image
    meshes = [thing for thing in scene.objects if thing.type == 'MESH']
    for mesh in meshes:
        mesh.select_set(True)
        mesh.data.uv_layers.active_index = 1
    bpy.context.view_layer.objects.active = meshes[0]

    def write(path):
        texels = numpy.empty(4 * size * size, numpy.float32)
        image.pixels.foreach_get(texels)
        texels.reshape(-1, 4)[:, :3].tofile(path)

    return lambda: bpy.ops.object.bake(type='DIFFUSE', pass_filter={'DIRECT', 'INDIRECT'}, margin=0,
                                       use_clear=True), write


make, write = (lightmap if 'lightmap' in job else camera)()
print('BENCH ready', flush=True)
for line in sys.stdin:
    samples, cycles.seed, path = (f(x) for f, x in zip((int, int, str), line.split(' ', 2)))
    cycles.samples = samples
    scene.update_tag()  # otherwise Cycles keeps the settings of its first picture
    start = time.perf_counter()
    make()
    seconds = time.perf_counter() - start
    write(path.rstrip('\n'))
    print('BENCH %.6f' % seconds, flush=True)
