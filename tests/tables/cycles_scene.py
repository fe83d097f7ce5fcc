"""Files and Cycles scenes that several comparisons with Cycles share: `lamp.py` and `glossy.py`.

Functions that render need `bpy`, `planes` needs `OpenEXR` and `numpy`. They import them, so that the rest runs without.
"""

import json, math, struct


def ball(radius, x, y, rings):
    """Points and triangles of a ball that stands on the plane z = 0."""
    points, faces, columns = [], [], 2 * rings
    for ring in range(rings + 1):
        t = math.pi * ring / rings
        for column in range(columns):
            p = 2 * math.pi * column / columns
            points.append((x + radius * math.sin(t) * math.cos(p), y + radius * math.sin(t) * math.sin(p), radius * (1 + math.cos(t))))
    for ring in range(rings):
        for column in range(columns):
            a, b = ring * columns + column, ring * columns + (column + 1) % columns
            c, d = a + columns, b + columns
            if ring > 0:
                faces.append((a, d, b))
            if ring + 1 < rings:
                faces.append((a, c, d))
    return points, faces


def square(side):
    """Points and triangles of a level square around the origin."""
    points = [(-side, -side, 0), (side, -side, 0), (side, side, 0), (-side, side, 0)]
    return points, [(0, 1, 2), (0, 2, 3)]


def write_ply(path, points, faces, grey):
    """Writes a mesh of one grey, as linear light."""
    with open(path, "w") as file:
        file.write("ply\nformat ascii 1.0\n")
        file.write(f"element vertex {len(points)}\nproperty float x\nproperty float y\nproperty float z\n")
        file.write("property float red\nproperty float green\nproperty float blue\n")
        file.write(f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n")
        for x, y, z in points:
            file.write(f"{x} {y} {z} {grey} {grey} {grey}\n")
        for face in faces:
            file.write("3 " + " ".join(map(str, face)) + "\n")


def write_glb(path, points, faces, colour):
    """Writes a matte object."""
    # glTF: y up. Faces have corners of their own, so that they are flat as in Cycles.
    corners = [points[i] for face in faces for i in face]
    data = b"".join(struct.pack("<3f", x, z, -y) for x, y, z in corners)
    turned = [(x, z, -y) for x, y, z in corners]
    low, high = ([f(axis) for axis in zip(*turned)] for f in (min, max))
    doc = {
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "material": 0}]}],
        "materials": [{"pbrMetallicRoughness": {"baseColorFactor": [*colour, 1], "metallicFactor": 0},
                       "extensions": {"KHR_materials_ior": {"ior": 1.0}}}],
        "extensionsUsed": ["KHR_materials_ior"], "buffers": [{"byteLength": len(data)}],
        "bufferViews": [{"buffer": 0, "byteOffset": 0, "byteLength": len(data)}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": len(corners), "type": "VEC3", "min": low, "max": high}],
    }
    text = json.dumps(doc).encode()
    text += b" " * (-len(text) % 4)
    with open(path, "wb") as file:
        file.write(struct.pack("<4sII", b"glTF", 2, 28 + len(text) + len(data)))
        file.write(struct.pack("<I4s", len(text), b"JSON") + text)
        file.write(struct.pack("<I4s", len(data), b"BIN\0") + data)


def new_scene(size, samples, threads=None):
    """An empty Cycles scene that renders linear light with a box filter, without a denoiser."""
    import bpy

    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.render.engine, scene.cycles.samples = "CYCLES", samples
    scene.cycles.use_denoising = scene.cycles.use_adaptive_sampling = False
    scene.cycles.max_bounces = scene.cycles.diffuse_bounces = scene.cycles.glossy_bounces = 9
    scene.cycles.blur_glossy = scene.cycles.sample_clamp_indirect = 0
    scene.cycles.pixel_filter_type = "BOX"
    scene.render.resolution_x, scene.render.resolution_y = size
    scene.render.image_settings.file_format, scene.render.image_settings.color_depth = "OPEN_EXR", "32"
    if threads:
        scene.render.threads_mode, scene.render.threads = "FIXED", threads
    scene.view_settings.view_transform = "Raw"
    scene.world = bpy.data.worlds.new("w")
    scene.world.use_nodes = True
    return scene


def add(scene, name, points, faces, colour, glossy=None):
    """Adds an object: matte, or a Principled BSDF with roughness, index of refraction and metalness."""
    import bpy

    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(points, [], faces)
    material = bpy.data.materials.new(name)
    material.use_nodes = True
    nodes = material.node_tree.nodes
    nodes.clear()
    shader, output = nodes.new(f"ShaderNodeBsdf{'Principled' if glossy else 'Diffuse'}"), nodes.new("ShaderNodeOutputMaterial")
    shader.inputs["Base Color" if glossy else "Color"].default_value = (*colour, 1)
    if glossy:
        for socket, value in zip(("Roughness", "IOR", "Metallic"), glossy):
            shader.inputs[socket].default_value = value
    material.node_tree.links.new(shader.outputs[0], output.inputs[0])
    mesh.materials.append(material)
    thing = bpy.data.objects.new(name, mesh)
    scene.collection.objects.link(thing)
    return thing


def look(scene, eye, target, fov_deg):
    """Adds the camera, with a vertical field of view in degrees."""
    import bpy
    from mathutils import Vector

    camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    camera.location = eye
    camera.rotation_euler = (Vector(target) - Vector(eye)).to_track_quat("-Z", "Y").to_euler()
    camera.data.sensor_fit, camera.data.angle = "VERTICAL", math.radians(fov_deg)
    scene.collection.objects.link(camera)
    scene.camera = camera


def render(scene, path):
    import bpy

    scene.render.filepath = path
    bpy.ops.render.render(write_still=True)


def planes(path, names):
    """Channels of an OpenEXR file, as height, width and channel."""
    import numpy, OpenEXR
    with OpenEXR.File(path, separate_channels=True) as file:
        channels = file.channels()
        return numpy.stack([channels[name].pixels.astype(numpy.float64) for name in names], -1)
