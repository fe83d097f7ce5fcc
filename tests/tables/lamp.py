#!/usr/bin/env python3
"""A lamp of the kind `lamp` compared with Cycles: a matte ball on a matte floor, lit by a disc, a sphere and a panel.

    tests/tables/lamp.py --program lightharmony --python PYTHON [--work DIR]

PYTHON needs `bpy`, `OpenEXR` and `numpy`. Prints one line per lamp and part of the picture: the mean of ours over Cycles', and
the relative MSE, mean((a - b)^2 / (b^2 + 0.01)). Cycles gets the lamp as its own light, in watts: pi * area * radiance.
"""

import argparse, json, math, os, struct, subprocess, sys, tempfile

WIDTH, HEIGHT, SAMPLES = 160, 120, 1024
EYE, TARGET, FOV = (1.6, -2.2, 1.5), (0.0, 0.0, 0.3), 40.0
AT, RADIUS, PANEL, RADIANCE = (0.5, -0.4, 1.3), 0.15, (0.3, 0.5), 40.0
BALL, ALBEDO, FLOOR = 0.3, 0.6, 0.4
SHAPES = ["Disc", "Sphere", "Panel"]


def ball(rings=48):
    points, faces, columns = [], [], 2 * rings
    for ring in range(rings + 1):
        t = math.pi * ring / rings
        for column in range(columns):
            p = 2 * math.pi * column / columns
            points.append((BALL * math.sin(t) * math.cos(p), BALL * math.sin(t) * math.sin(p), BALL * math.cos(t) + BALL))
    for ring in range(rings):
        for column in range(columns):
            a, b = ring * columns + column, ring * columns + (column + 1) % columns
            c, d = a + columns, b + columns
            if ring > 0:
                faces.append((a, d, b))
            if ring + 1 < rings:
                faces.append((a, c, d))
    return points, faces


def write_ply(path, points, faces, grey):
    code = round(255 * grey)
    with open(path, "w") as file:
        file.write("ply\nformat ascii 1.0\n")
        file.write(f"element vertex {len(points)}\nproperty float x\nproperty float y\nproperty float z\n")
        file.write("property uchar red\nproperty uchar green\nproperty uchar blue\n")
        file.write(f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n")
        for x, y, z in points:
            file.write(f"{x} {y} {z} {code} {code} {code}\n")
        for face in faces:
            file.write("3 " + " ".join(map(str, face)) + "\n")


def write_glb(path, points, faces):
    # glTF: y up.
    data = b"".join(struct.pack("<3f", x, z, -y) for x, y, z in points)
    index = b"".join(struct.pack("<3I", *face) for face in faces)
    low = [min(p) for p in zip(*[(x, z, -y) for x, y, z in points])]
    high = [max(p) for p in zip(*[(x, z, -y) for x, y, z in points])]
    doc = {
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1, "material": 0}]}],
        "materials": [{"pbrMetallicRoughness": {"baseColorFactor": [ALBEDO] * 3 + [1], "metallicFactor": 0},
                       "extensions": {"KHR_materials_ior": {"ior": 1.0}}}],
        "extensionsUsed": ["KHR_materials_ior"],
        "buffers": [{"byteLength": len(data) + len(index)}],
        "bufferViews": [{"buffer": 0, "byteOffset": 0, "byteLength": len(data)},
                        {"buffer": 0, "byteOffset": len(data), "byteLength": len(index)}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": len(points), "type": "VEC3", "min": low, "max": high},
                      {"bufferView": 1, "componentType": 5125, "count": 3 * len(faces), "type": "SCALAR"}],
    }
    text = json.dumps(doc).encode()
    text += b" " * (-len(text) % 4)
    body = data + index
    with open(path, "wb") as file:
        file.write(struct.pack("<4sII", b"glTF", 2, 28 + len(text) + len(body)))
        file.write(struct.pack("<I4s", len(text), b"JSON") + text)
        file.write(struct.pack("<I4s", len(body), b"BIN\0") + body)


def graph(shape):
    return f"""Graph(version: 1, scene: (up: "+z", seed: 3), nodes: (
        floor: LoadMesh(path: "floor.ply", colours: Linear), ball: LoadObject(path: "ball.glb"), env: LoadEnvironment(path: "env.exr"),
        home: Pose(), placed: Place(object: "ball", pose: "home"),
        at: Pose(translation: {AT}), lamp: Lamp(pose: "at", shape: {shape}, radius_metres: {RADIUS}, panel_metres: {PANEL}, radiance: {RADIANCE}),
        camera: Camera(eye: {EYE}, target: {TARGET}, width_px: {WIDTH}, height_px: {HEIGHT}, fov_y_deg: {FOV}),
        trace: PathTrace(receiver: "floor", objects: ["placed", "lamp"], rig: "camera", env: "env", samples: {SAMPLES},
                         surroundings: Open(), contact_metres: Some(0.0), crop: 0.0, max_bounces: 8),
        save: WriteExr(layers: ["trace.without", "trace.with", "trace.object"], names: ["without", "with", "object"], path: "{shape}.exr"),
    ))"""


def cycles(work):
    import bpy
    from mathutils import Vector

    for shape in SHAPES:
        bpy.ops.wm.read_factory_settings(use_empty=True)
        scene = bpy.context.scene
        scene.render.engine = "CYCLES"
        scene.cycles.samples, scene.cycles.use_denoising, scene.cycles.use_adaptive_sampling = SAMPLES, False, False
        scene.cycles.max_bounces = scene.cycles.diffuse_bounces = 9
        scene.cycles.pixel_filter_type = "BOX"
        scene.render.resolution_x, scene.render.resolution_y = WIDTH, HEIGHT
        scene.render.image_settings.file_format, scene.render.image_settings.color_depth = "OPEN_EXR", "32"
        scene.view_settings.view_transform = "Raw"
        world = bpy.data.worlds.new("w")
        scene.world = world
        world.use_nodes = True
        world.node_tree.nodes["Background"].inputs[0].default_value = (0.1, 0.1, 0.1, 1)

        def add(name, points, faces, grey):
            mesh = bpy.data.meshes.new(name)
            mesh.from_pydata(points, [], faces)
            material = bpy.data.materials.new(name)
            material.use_nodes = True
            tree = material.node_tree
            tree.nodes.clear()
            shader, output = tree.nodes.new("ShaderNodeBsdfDiffuse"), tree.nodes.new("ShaderNodeOutputMaterial")
            shader.inputs["Color"].default_value = (grey, grey, grey, 1)
            tree.links.new(shader.outputs[0], output.inputs[0])
            mesh.materials.append(material)
            thing = bpy.data.objects.new(name, mesh)
            scene.collection.objects.link(thing)

        add("floor", [(-20, -20, 0), (20, -20, 0), (20, 20, 0), (-20, 20, 0)], [(0, 1, 2), (0, 2, 3)], FLOOR)
        points, faces = ball()
        add("ball", points, faces, ALBEDO)
        if shape == "Sphere":
            light = bpy.data.lights.new("lamp", "POINT")
            light.shadow_soft_size = RADIUS
            light.use_soft_falloff = False
            light.energy = math.pi * 4 * math.pi * RADIUS**2 * RADIANCE
        else:
            light = bpy.data.lights.new("lamp", "AREA")
            if shape == "Disc":
                light.shape, light.size, area = "DISK", 2 * RADIUS, math.pi * RADIUS**2
            else:
                light.shape, light.size, light.size_y, area = "RECTANGLE", PANEL[0], PANEL[1], PANEL[0] * PANEL[1]
            light.energy = math.pi * area * RADIANCE
        lamp = bpy.data.objects.new("lamp", light)
        lamp.location = AT
        lamp.visible_camera = False
        scene.collection.objects.link(lamp)
        camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
        camera.location = EYE
        camera.rotation_euler = (Vector(TARGET) - Vector(EYE)).to_track_quat("-Z", "Y").to_euler()
        camera.data.sensor_fit, camera.data.angle = "VERTICAL", math.radians(FOV)
        scene.collection.objects.link(camera)
        scene.camera = camera
        scene.render.filepath = os.path.join(work, f"cycles-{shape}.exr")
        bpy.ops.render.render(write_still=True)


def planes(path, names):
    import numpy, OpenEXR
    with OpenEXR.File(path, separate_channels=True) as file:
        channels = file.channels()
        return numpy.stack([channels[name].pixels.astype(numpy.float64) for name in names], -1)


def compare(work):
    import numpy
    for shape in SHAPES:
        own = os.path.join(work, "out", f"{shape}.exr")
        layer = lambda name: planes(own, [f"{name}.{c}" for c in "RGB"])
        alpha = planes(own, ["object.A"])
        # Pixels of the lamp itself, which Cycles hides, have a black housing or its light.
        picture, other = layer("with") * (1 - alpha) + layer("object"), planes(os.path.join(work, f"cycles-{shape}.exr"), "RGB")
        y, x = numpy.mgrid[0:HEIGHT, 0:WIDTH]
        lamp = numpy.zeros((HEIGHT, WIDTH), bool)
        forward = numpy.array(TARGET) - numpy.array(EYE)
        forward /= numpy.linalg.norm(forward)
        right = numpy.cross(forward, (0, 0, 1.0))
        right /= numpy.linalg.norm(right)
        focal = 0.5 * HEIGHT / math.tan(math.radians(FOV) / 2)
        way = numpy.array(AT) - numpy.array(EYE)
        down = numpy.cross(forward, right)
        u, v = (focal * way @ axis / (way @ forward) for axis in (right, down))
        lamp = numpy.hypot(x + 0.5 - WIDTH / 2 - u, y + 0.5 - HEIGHT / 2 - v) < 1.3 * focal * 0.35 / (way @ forward)
        for name, mask in (("object", (alpha[..., 0] > 0.999) & ~lamp), ("place", (alpha[..., 0] == 0) & ~lamp)):
            a, b = picture[mask], other[mask]
            error = numpy.mean((a - b) ** 2 / (b**2 + 0.01))
            lit = (layer("with")[mask] / layer("without")[mask]).mean() if name == "place" else float("nan")
            print(f"| {shape} | {name} | {a.mean() / b.mean():.4f} | {error:.2e} | {lit:.2f} |")


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--program", default="lightharmony")
    parser.add_argument("--python", default=sys.executable)
    parser.add_argument("--work", default=None)
    parser.add_argument("--step", choices=["cycles", "compare"])
    args = parser.parse_args()
    work = args.work or tempfile.mkdtemp()
    os.makedirs(work, exist_ok=True)
    if args.step:
        return {"cycles": cycles, "compare": compare}[args.step](work)
    write_ply(os.path.join(work, "floor.ply"), [(-20, -20, 0), (20, -20, 0), (20, 20, 0), (-20, 20, 0)], [(0, 1, 2), (0, 2, 3)], FLOOR)
    points, faces = ball()
    write_glb(os.path.join(work, "ball.glb"), points, faces)
    make = "import numpy, OpenEXR; a = numpy.full((16, 32, 3), 0.1, 'float32'); OpenEXR.File({}, {'RGB': a}).write('env.exr')"
    subprocess.run([args.python, "-c", make], cwd=work, check=True)
    for shape in SHAPES:
        with open(os.path.join(work, f"{shape}.ron"), "w") as file:
            file.write(graph(shape))
        subprocess.run([args.program, "run", f"{shape}.ron", "--out", "out", "--cache", "cache"], cwd=work, check=True)
    for step in ("cycles", "compare"):
        subprocess.run([args.python, os.path.abspath(__file__), "--work", work, "--step", step], check=True)


main()
