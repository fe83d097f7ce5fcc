"""Places in Blender, rendered by Cycles on the CPU. Needs bpy.

Blender's world is the world of the set: z up, metres.
"""
import contextlib
import math
import os
import sys
import tempfile

import bpy
import numpy as np
from mathutils import Matrix

import pictures

BOUNCES = 10
# Upper limit of one sample's indirect light, in units of white. It bounds caustics and rare paths.
CLAMP_INDIRECT = 40.0


def material(name, look, light):
    """A material; `light` is the factor of all lights of the place."""
    made = bpy.data.materials.new(name)
    made.use_nodes = True
    tree = made.node_tree
    tree.nodes.clear()
    out = tree.nodes.new("ShaderNodeOutputMaterial")
    if look.emission > 0:
        node = tree.nodes.new("ShaderNodeEmission")
        node.inputs["Strength"].default_value = look.emission * light
    elif look.roughness >= 1 and look.metallic == 0:
        node = tree.nodes.new("ShaderNodeBsdfDiffuse")
    else:
        node = tree.nodes.new("ShaderNodeBsdfPrincipled")
        node.inputs["Roughness"].default_value = look.roughness
        node.inputs["Metallic"].default_value = look.metallic
    colour = node.inputs["Base Color" if "Base Color" in node.inputs else "Color"]
    colour.default_value = (*look.colour, 1)
    if look.pattern != "plain":
        tree.links.new(pattern(tree, look), colour)
    tree.links.new(node.outputs[0], out.inputs["Surface"])
    return made


def pattern(tree, look):
    """Colours that follow the position in the world. On walls, the texture's second axis is up."""
    new, link = tree.nodes.new, tree.links.new
    place = new("ShaderNodeNewGeometry")
    a, b = (*look.colour, 1), (*look.second, 1)
    if look.pattern == "noise":
        noise = new("ShaderNodeTexNoise")
        noise.inputs["Scale"].default_value, noise.inputs["Detail"].default_value = 1 / look.size, 4
        mix = new("ShaderNodeMix")
        mix.data_type = "RGBA"
        mix.inputs["A"].default_value, mix.inputs["B"].default_value = a, b
        link(place.outputs["Position"], noise.inputs["Vector"])
        link(noise.outputs["Fac"], mix.inputs["Factor"])
        return mix.outputs["Result"]
    # Floors use (x, y); walls along x use (x, z); walls along y use (y, z).
    normal, position, combine = new("ShaderNodeSeparateXYZ"), new("ShaderNodeSeparateXYZ"), new("ShaderNodeCombineXYZ")
    link(place.outputs["True Normal"], normal.inputs[0])
    link(place.outputs["Position"], position.inputs[0])

    def steep(component):
        size, test = new("ShaderNodeMath"), new("ShaderNodeMath")
        size.operation, test.operation = "ABSOLUTE", "GREATER_THAN"
        test.inputs[1].default_value = 0.7
        link(normal.outputs[component], size.inputs[0])
        link(size.outputs[0], test.inputs[0])
        return test.outputs[0]

    def choose(by, no, yes):
        mix = new("ShaderNodeMix")
        mix.data_type = "FLOAT"
        link(by, mix.inputs["Factor"])
        link(no, mix.inputs["A"])
        link(yes, mix.inputs["B"])
        return mix.outputs["Result"]

    x, y, z = position.outputs
    link(choose(steep("X"), x, y), combine.inputs["X"])
    link(choose(steep("Z"), z, y), combine.inputs["Y"])
    if look.pattern == "checker":
        node = new("ShaderNodeTexChecker")
        node.inputs["Scale"].default_value = 1 / look.size
        # Half a tile away from the planes of the shapes, where rounding decides.
        move = new("ShaderNodeVectorMath")
        move.operation = "ADD"
        move.inputs[1].default_value = (look.size * 0.31, look.size * 0.47, look.size * 0.5)
        link(combine.outputs[0], move.inputs[0])
        link(move.outputs[0], node.inputs["Vector"])
    else:
        node = new("ShaderNodeTexBrick")
        node.inputs["Scale"].default_value = 1.0
        node.inputs["Mortar"].default_value = tuple(0.6 * c for c in look.colour) + (1,)
        node.inputs["Mortar Size"].default_value = 0.02 * look.size
        planks = look.pattern == "planks"
        node.inputs["Brick Width"].default_value = look.size * (8 if planks else 1)
        node.inputs["Row Height"].default_value = look.size * (1 if planks else 0.4)
        link(combine.outputs[0], node.inputs["Vector"])
    node.inputs["Color1"].default_value, node.inputs["Color2"].default_value = a, b
    return node.outputs["Color"]


@contextlib.contextmanager
def quiet():
    """Discards what Blender prints on standard output: a line for each sample."""
    sys.stdout.flush()
    kept, nothing = os.dup(1), os.open(os.devnull, os.O_WRONLY)
    os.dup2(nothing, 1)
    try:
        yield
    finally:
        os.dup2(kept, 1)
        os.close(kept)
        os.close(nothing)


class Stage:
    """A place in Blender: one at a time in a process."""

    def __init__(self, place, sky_file, light, threads):
        """`sky_file`: panorama (EXR), or none for a black sky; `light`: factor of all lights."""
        bpy.ops.wm.read_factory_settings(use_empty=True)
        self.scene, self.place, self.added = bpy.context.scene, place, []
        looks = {name: material(name, look, light) for name, look in place.looks.items()}
        self.receivers = []
        for k, part in enumerate(place.parts):
            vertices, faces = part.mesh()
            mesh = bpy.data.meshes.new(f"part{k}")
            mesh.from_pydata(vertices.tolist(), [], faces.tolist())
            mesh.materials.append(looks[part.material])
            if part.smooth:
                mesh.polygons.foreach_set("use_smooth", [True] * len(mesh.polygons))
            made = bpy.data.objects.new(f"part{k}", mesh)
            self.scene.collection.objects.link(made)
            self.receivers.append(made)
        for corner, u, v in place.openings:
            self._portal(np.array(corner), np.array(u), np.array(v))
        self._world(sky_file, light)
        self._settings(threads)

    def _portal(self, corner, u, v):
        """Guides the sampling of the sky through an opening, and emits nothing itself."""
        data = bpy.data.lights.new("portal", "AREA")
        data.shape, data.size, data.size_y = "RECTANGLE", float(np.linalg.norm(u)), float(np.linalg.norm(v))
        data.cycles.is_portal = True
        made = bpy.data.objects.new("portal", data)
        x, y = u / np.linalg.norm(u), v / np.linalg.norm(v)
        # An area light shines along -z: into the room, along u x v.
        x, z = -x, -np.cross(x, y)
        turn = np.eye(4)
        turn[:3, 0], turn[:3, 1], turn[:3, 2], turn[:3, 3] = x, y, z, corner + u / 2 + v / 2
        made.matrix_world = Matrix(turn.tolist())
        self.scene.collection.objects.link(made)

    def _world(self, sky_file, light):
        world = bpy.data.worlds.new("sky")
        self.scene.world, world.use_nodes = world, True
        tree = world.node_tree
        background = tree.nodes["Background"]
        if sky_file is None:
            background.inputs["Color"].default_value = (0, 0, 0, 1)
            return
        background.inputs["Strength"].default_value = light
        image = bpy.data.images.load(str(sky_file))
        image.colorspace_settings.name = "Linear Rec.709"
        texture, where, turn = (tree.nodes.new(f"ShaderNode{n}") for n in ("TexEnvironment", "TexCoord", "Mapping"))
        texture.image = image
        # Blender's centre column looks along +X, that of the set along +Y.
        turn.inputs["Rotation"].default_value = (0, 0, -math.pi / 2)
        tree.links.new(where.outputs["Generated"], turn.inputs["Vector"])
        tree.links.new(turn.outputs[0], texture.inputs["Vector"])
        tree.links.new(texture.outputs[0], background.inputs["Color"])
        world.cycles.sampling_method, world.cycles.sample_map_resolution = "MANUAL", 2048

    def _settings(self, threads):
        render, cycles = self.scene.render, self.scene.cycles
        render.engine, cycles.device = "CYCLES", "CPU"
        render.threads_mode, render.threads = "FIXED", threads
        render.resolution_percentage, render.use_persistent_data = 100, True
        cycles.use_adaptive_sampling = cycles.use_denoising = False
        cycles.max_bounces = cycles.diffuse_bounces = cycles.glossy_bounces = cycles.transmission_bounces = BOUNCES
        cycles.transparent_max_bounces, cycles.min_light_bounces = 16, 0
        cycles.sample_clamp_direct, cycles.sample_clamp_indirect, cycles.blur_glossy = 0, CLAMP_INDIRECT, 0
        cycles.light_sampling_threshold = 0
        cycles.caustics_reflective = cycles.caustics_refractive = True
        cycles.pixel_filter_type = "BOX"
        self.scene.view_settings.view_transform = "Standard"
        render.image_settings.file_format, render.image_settings.color_depth = "OPEN_EXR_MULTILAYER", "32"
        render.image_settings.exr_codec = "NONE"
        data = bpy.data.cameras.new("camera")
        self.camera = bpy.data.objects.new("camera", data)
        data.clip_start, data.clip_end = 1e-3, 1e4
        self.scene.collection.objects.link(self.camera)
        self.scene.camera = self.camera

    def insert(self, file, translation, yaw_deg, scale):
        """Imports a GLB and places it, in place of an earlier object."""
        for old in self.added:
            bpy.data.objects.remove(old)
        before = set(bpy.data.objects)
        with quiet():
            bpy.ops.import_scene.gltf(filepath=str(file))
        self.added = [o for o in bpy.data.objects if o not in before]
        pose = Matrix.Translation(translation) @ Matrix.Rotation(math.radians(yaw_deg), 4, "Z") @ Matrix.Scale(scale, 4)
        for each in self.added:
            if each.parent is None:
                each.matrix_world = pose @ each.matrix_world
        return [o for o in self.added if o.type == "MESH"]

    def look(self, matrix, lens):
        """A pinhole camera: `matrix` camera to world (OpenGL), `lens` with w, h, fl_x, cx, cy."""
        data, w, h = self.camera.data, lens["w"], lens["h"]
        data.type, data.sensor_fit, data.sensor_width = "PERSP", "HORIZONTAL", 36
        data.lens = lens["fl_x"] / w * 36
        data.shift_x, data.shift_y = -(lens["cx"] - w / 2) / w, (lens["cy"] - h / 2) / w
        self.camera.matrix_world = Matrix(np.array(matrix).tolist())
        self.scene.render.resolution_x, self.scene.render.resolution_y = w, h

    def look_around(self, point, width):
        """An equirectangular camera whose centre column looks along +Y."""
        data = self.camera.data
        data.type, data.panorama_type = "PANO", "EQUIRECTANGULAR"
        self.camera.matrix_world = Matrix.Translation(point) @ Matrix.Rotation(math.radians(90), 4, "X")
        self.scene.render.resolution_x, self.scene.render.resolution_y = width, width // 2

    def show(self, objects):
        """`objects`: False (absent), True, or `unreflected` (hidden from glossy rays)."""
        self.scene.render.film_transparent = False
        for each in self.receivers:
            each.is_holdout = False
        for each in self.added:
            each.hide_render, each.visible_glossy = not objects, objects != "unreflected"
        self._quality()

    def _quality(self, filter_px=1.0, bounces=BOUNCES):
        cycles = self.scene.cycles
        cycles.filter_width, cycles.max_bounces = filter_px, bounces

    def render(self, samples, seed, depth=False, denoise=False, extra=None):
        """Linear light (h, w, 4), premultiplied, and with `depth` also the planar depth (h, w), +inf where there is nothing.

        `extra` names another layer whose colours (h, w, 3) are given in place of the light."""
        cycles = self.scene.cycles
        cycles.samples, cycles.seed, cycles.use_denoising = samples, seed % 2 ** 31, denoise
        if denoise:
            cycles.denoiser, cycles.denoising_input_passes, cycles.denoising_use_gpu = "OPENIMAGEDENOISE", "RGB_ALBEDO_NORMAL", False
        bpy.context.view_layer.use_pass_z = depth
        with tempfile.TemporaryDirectory() as folder:
            self.scene.render.filepath = os.path.join(folder, "picture.exr")
            with quiet():
                bpy.ops.render.render(write_still=True)
            layers = pictures.read_layers(self.scene.render.filepath,
                                         {extra: "RGB"} if extra else {"Combined": "RGBA", **({"Depth": "Z"} if depth else {})})
        if extra:
            return layers[extra]
        if not depth:
            return layers["Combined"]
        z = layers["Depth"][..., 0]
        return layers["Combined"], np.where(z > 1e6, np.inf, z)

    def depth(self):
        """Planar depth at the pixel centres, +inf where there is nothing."""
        self._quality(filter_px=0.01, bounces=0)
        _, z = self.render(1, 0, depth=True)
        self._quality()
        return z

    def alpha(self, samples):
        """Share of each pixel that the object covers, with the place as a holdout. Glass counts as cover."""
        self.show(True)
        self._quality(bounces=0)
        self.scene.render.film_transparent = True
        self.scene.cycles.film_transparent_glass = False
        for each in self.receivers:
            each.is_holdout = True
        covered = self.render(samples, 1)[..., 3]
        self.show(True)
        return np.clip(covered, 0, 1)
