#!/usr/bin/env python3
"""A lamp of the kind `lamp` compared with Cycles: a matte ball on a matte floor, lit by a disc, a sphere and a panel.

    tests/tables/lamp.py --program lightharmony --python PYTHON [--work DIR]

PYTHON needs `bpy`, `OpenEXR` and `numpy`. Prints one line per lamp and part of the picture: the mean of ours over Cycles', and
the relative MSE, mean((a - b)^2 / (b^2 + 0.01)). Cycles gets the lamp as its own light, in watts: pi * area * radiance.
"""

import argparse, math, os, subprocess, sys, tempfile

from cycles_scene import add, ball, look, new_scene, planes, render, square, write_glb, write_ply

WIDTH, HEIGHT, SAMPLES = 160, 120, 1024
EYE, TARGET, FOV = (1.6, -2.2, 1.5), (0.0, 0.0, 0.3), 40.0
AT, RADIUS, PANEL, RADIANCE = (0.5, -0.4, 1.3), 0.15, (0.3, 0.5), 40.0
BALL, ALBEDO, FLOOR = 0.3, 0.6, 0.4
SHAPES = ["Disc", "Sphere", "Panel"]


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

    for shape in SHAPES:
        scene = new_scene((WIDTH, HEIGHT), SAMPLES)
        scene.world.node_tree.nodes["Background"].inputs[0].default_value = (0.1, 0.1, 0.1, 1)
        add(scene, "floor", *square(20), (FLOOR,) * 3)
        add(scene, "ball", *ball(BALL, 0, 0, 48), (ALBEDO,) * 3)
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
        look(scene, EYE, TARGET, FOV)
        render(scene, os.path.join(work, f"cycles-{shape}.exr"))


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
    write_ply(os.path.join(work, "floor.ply"), *square(20), FLOOR)
    write_glb(os.path.join(work, "ball.glb"), *ball(BALL, 0, 0, 48), (ALBEDO,) * 3)
    make = "import numpy, OpenEXR; a = numpy.full((16, 32, 3), 0.1, 'float32'); OpenEXR.File({}, {'RGB': a}).write('env.exr')"
    subprocess.run([args.python, "-c", make], cwd=work, check=True)
    for shape in SHAPES:
        with open(os.path.join(work, f"{shape}.ron"), "w") as file:
            file.write(graph(shape))
        subprocess.run([args.program, "run", f"{shape}.ron", "--out", "out", "--cache", "cache"], cwd=work, check=True)
    for step in ("cycles", "compare"):
        subprocess.run([args.python, os.path.abspath(__file__), "--work", work, "--step", step], check=True)


main()
