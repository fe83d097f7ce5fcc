#!/usr/bin/env python3
"""A glossy floor compared with Cycles: a red ball and a white box on a floor, under a sky with a window of light.

    tests/tables/glossy.py --program lightharmony --python PYTHON [--work DIR] [--samples N]

PYTHON needs `bpy`, `OpenEXR` and `numpy`. Both programs render the floor alone (R0) and with the objects, which the camera does not
see (R1). In Cycles the floor is a Principled BSDF of the same roughness, index and metalness. Printed for each gloss are the mean of
our R0 over Cycles' R0, and the PSNR, in display colours, of Cycles' R0 times our ratio S against Cycles' R1: with the glossy floor,
and with a matte floor of the same colour. The regions are the shadow (a matte floor loses at least 2 % of its light) and the
reflection (a mirror in place of the floor shows an object), both without pixels of the objects. `s_max` of `shadow-ratio` is 8.
"""

import argparse, json, math, os, struct, subprocess, sys, tempfile

WIDTH, HEIGHT = 240, 180
EYE, TARGET, FOV = (0.4, -3.2, 1.3), (0.0, 0.0, 0.1), 40.0
ALBEDO, SIDE = 0.3, 6.0
# Roughness, index of refraction, metalness.
GLOSSES = {
    "polished": (0.1, 1.5, 0.0),
    "satin": (0.3, 1.5, 0.0),
    "wet": (0.02, 1.33, 0.0),
    "metal": (0.05, 1.5, 1.0),
}
BALL, BOX = (0.6, 0.08, 0.06), (0.7, 0.7, 0.65)


def ball(radius, x, y, rings=40):
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


def box(low, high):
    points = [tuple(high[k] if i >> k & 1 else low[k] for k in range(3)) for i in range(8)]
    quads = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]
    return points, [face for a, b, c, d in quads for face in ((a, b, c), (a, c, d))]


FLOOR = ([(-SIDE, -SIDE, 0), (SIDE, -SIDE, 0), (SIDE, SIDE, 0), (-SIDE, SIDE, 0)], [(0, 1, 2), (0, 2, 3)])
OBJECTS = {"ball": (*ball(0.35, -0.35, 0.1), BALL), "box": (*box((0.25, 0.1, 0), (0.65, 0.5, 0.9)), BOX)}


def write_ply(path, points, faces, grey):
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


def graph(samples):
    glosses = {**GLOSSES, "mirror": (0.0, 1.5, 1.0)}
    nodes = []
    for name in [*glosses, "matte"]:
        mesh = "floor"
        if name in glosses:
            roughness, ior, metallic = glosses[name]
            nodes.append(f'{name}: SetGloss(mesh: "floor", roughness: {roughness}, ior: {ior}, metallic: {metallic}),')
            mesh = name
        nodes.append(f"""{name}_trace: PathTrace(receiver: "{mesh}", objects: ["a", "b"], rig: "camera", env: "env", samples: {samples},
            surroundings: Open(), contact_metres: Some(0.0), crop: 0.0, max_bounces: 8),
        {name}_ratio: ShadowRatio(without: "{name}_trace.without", with: "{name}_trace.with", s_max: 8.0),
        {name}_save: WriteExr(layers: ["{name}_trace.without", "{name}_trace.with", "{name}_trace.object", "{name}_ratio.shadow"],
            names: ["without", "with", "object", "shadow"], path: "{name}.exr"),""")
    return f"""Graph(version: 1, scene: (up: "+z", seed: 3), nodes: (
        floor: LoadMesh(path: "floor.ply", colours: Linear), env: LoadEnvironment(path: "env.exr"), home: Pose(),
        ball: LoadObject(path: "ball.glb"), box: LoadObject(path: "box.glb"),
        a: Place(object: "ball", pose: "home"), b: Place(object: "box", pose: "home"),
        camera: Camera(eye: {EYE}, target: {TARGET}, width_px: {WIDTH}, height_px: {HEIGHT}, fov_y_deg: {FOV}),
        {chr(10).join(nodes)}
    ))"""


def sky(work):
    import numpy, OpenEXR
    height, width = 128, 256
    y, x = numpy.mgrid[0:height, 0:width]
    up = numpy.cos(math.pi * (y + 0.5) / height)[..., None]
    picture = numpy.array([0.45, 0.5, 0.6]) * (0.6 + 0.4 * up) + numpy.array([0.35, 0.3, 0.2]) * (x[..., None] < width // 2)
    picture[22:34, 100:124] = (22.0, 20.0, 16.0)  # a soft light, behind and above
    picture[50:62, 132:150] = (3.0, 3.2, 4.0)  # a window near the horizon, which the floor reflects
    picture[height // 2 :] *= 0.3
    OpenEXR.File({}, {"RGB": picture.astype("float32")}).write(os.path.join(work, "env.exr"))


def cycles(work, samples):
    import bpy
    from mathutils import Vector

    for gloss in [*GLOSSES, "matte"]:
        bpy.ops.wm.read_factory_settings(use_empty=True)
        scene = bpy.context.scene
        scene.render.engine, scene.cycles.samples = "CYCLES", 4 * samples
        scene.cycles.use_denoising = scene.cycles.use_adaptive_sampling = False
        scene.cycles.max_bounces = scene.cycles.diffuse_bounces = scene.cycles.glossy_bounces = 9
        scene.cycles.blur_glossy = scene.cycles.sample_clamp_indirect = 0
        scene.cycles.pixel_filter_type = "BOX"
        scene.render.resolution_x, scene.render.resolution_y = WIDTH, HEIGHT
        scene.render.image_settings.file_format, scene.render.image_settings.color_depth = "OPEN_EXR", "32"
        scene.render.threads_mode, scene.render.threads = "FIXED", 2
        scene.view_settings.view_transform = "Raw"
        world = bpy.data.worlds.new("w")
        scene.world = world
        world.use_nodes = True
        tree = world.node_tree
        image = bpy.data.images.load(os.path.join(work, "env.exr"))
        image.colorspace_settings.name = "Linear Rec.709"
        texture, place, turn = (tree.nodes.new(f"ShaderNode{name}") for name in ("TexEnvironment", "TexCoord", "Mapping"))
        texture.image = image
        turn.inputs["Rotation"].default_value = (0, 0, -math.pi / 2)
        tree.links.new(place.outputs["Generated"], turn.inputs["Vector"])
        tree.links.new(turn.outputs[0], texture.inputs["Vector"])
        tree.links.new(texture.outputs[0], tree.nodes["Background"].inputs["Color"])

        def add(name, points, faces, colour, glossy=None):
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

        add("floor", *FLOOR, (ALBEDO,) * 3, GLOSSES.get(gloss))
        things = [add(name, *shape) for name, shape in OBJECTS.items()]
        camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
        camera.location = EYE
        camera.rotation_euler = (Vector(TARGET) - Vector(EYE)).to_track_quat("-Z", "Y").to_euler()
        camera.data.sensor_fit, camera.data.angle = "VERTICAL", math.radians(FOV)
        scene.collection.objects.link(camera)
        scene.camera = camera
        for name, hidden in (("without", True), ("with", False)):
            for thing in things:
                thing.hide_render, thing.visible_camera = hidden, False
            scene.render.filepath = os.path.join(work, f"cycles-{gloss}-{name}.exr")
            bpy.ops.render.render(write_still=True)


def planes(path, names):
    import numpy, OpenEXR
    with OpenEXR.File(path, separate_channels=True) as file:
        channels = file.channels()
        return numpy.stack([channels[name].pixels.astype(numpy.float64) for name in names], -1)


def compare(work):
    import numpy

    own = lambda gloss, layer: planes(os.path.join(work, "out", f"{gloss}.exr"), [f"{layer}.{c}" for c in "RGB"])
    theirs = lambda gloss, layer: planes(os.path.join(work, f"cycles-{gloss}-{layer}.exr"), "RGB")
    shown = lambda light: numpy.where(light <= 0.0031308, 12.92 * light, 1.055 * numpy.clip(light, 1e-9, None) ** (1 / 2.4) - 0.055).clip(0, 1)
    floor = planes(os.path.join(work, "out", "matte.exr"), ["object.A"])[..., 0] == 0
    # Pixels of the sky, whose light no object changes, are not part of the floor.
    y, x = numpy.mgrid[0:HEIGHT, 0:WIDTH]
    focal = 0.5 * HEIGHT / math.tan(math.radians(FOV) / 2)
    forward = numpy.subtract(TARGET, EYE) / numpy.linalg.norm(numpy.subtract(TARGET, EYE))
    right = numpy.cross(forward, (0, 0, 1.0)) / numpy.linalg.norm(numpy.cross(forward, (0, 0, 1.0)))
    ray = forward + ((x[..., None] + 0.5 - WIDTH / 2) * right + (y[..., None] + 0.5 - HEIGHT / 2) * numpy.cross(forward, right)) / focal
    floor &= ray[..., 2] < -0.1
    change = abs(own("mirror", "with") - own("mirror", "without")).max(-1)
    shadow = theirs("matte", "with").sum(-1) < 0.98 * theirs("matte", "without").sum(-1)
    for name, region in (("shadow", shadow & floor), ("reflection", (change > 1e-3) & floor)):
        print(f"{name}: {region.sum()} of {floor.sum()} pixels of the floor")
        for gloss in [*GLOSSES, "matte"]:
            without, truth = theirs(gloss, "without"), theirs(gloss, "with")
            psnr = {}
            for model in (gloss, "matte"):
                error = shown(without * own(model, "shadow")) - shown(truth)
                psnr[model] = -10 * math.log10((error[region] ** 2).mean())
            level = own(gloss, "without")[region].mean() / without[region].mean()
            light = own(gloss, "with")[region].mean() / truth[region].mean()
            ours, matte = psnr[gloss], psnr["matte"]
            print(f"| {gloss} | {name} | {level:.4f} | {light:.4f} | {matte:.1f} | {ours:.1f} | {ours - matte:+.1f} |")


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--program", default="lightharmony")
    parser.add_argument("--python", default=sys.executable)
    parser.add_argument("--work", default=None)
    parser.add_argument("--samples", type=int, default=256, help="of ours; Cycles takes four times as many")
    parser.add_argument("--step", choices=["sky", "cycles", "compare"])
    args = parser.parse_args()
    work = args.work or tempfile.mkdtemp()
    os.makedirs(work, exist_ok=True)
    if args.step:
        return {"sky": lambda: sky(work), "cycles": lambda: cycles(work, args.samples), "compare": lambda: compare(work)}[args.step]()
    step = lambda name: subprocess.run(
        [args.python, os.path.abspath(__file__), "--work", work, "--samples", str(args.samples), "--step", name], check=True)
    write_ply(os.path.join(work, "floor.ply"), *FLOOR, ALBEDO)
    for name, shape in OBJECTS.items():
        write_glb(os.path.join(work, f"{name}.glb"), *shape)
    step("sky")
    with open(os.path.join(work, "glossy.ron"), "w") as file:
        file.write(graph(args.samples))
    subprocess.run([args.program, "run", "glossy.ron", "--out", "out", "--cache", "cache"], cwd=work, check=True)
    step("cycles")
    step("compare")


main()
