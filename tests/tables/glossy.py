#!/usr/bin/env python3
"""A glossy floor compared with Cycles: a red ball and a white box on a floor, under a sky with a window of light.

    tests/tables/glossy.py --program lightharmony --python PYTHON [--work DIR] [--samples N]

PYTHON needs `bpy`, `OpenEXR` and `numpy`. Both programs render the floor alone (R0) and with the objects, which the camera does not
see (R1). In Cycles the floor is a Principled BSDF of the same roughness, index and metalness. Printed for each gloss are the mean of
our R0 over Cycles' R0, and the PSNR, in display colours, of Cycles' R0 times our ratio S against Cycles' R1: with the glossy floor,
and with a matte floor of the same colour. The regions are the shadow (a matte floor loses at least 2 % of its light) and the
reflection (a mirror in place of the floor shows an object), both without pixels of the objects. `s_max` of `shadow-ratio` is 8.
"""

import argparse, math, os, subprocess, sys, tempfile

from cycles_scene import add, ball, look, new_scene, planes, render, square, write_glb, write_ply

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


def box(low, high):
    points = [tuple(high[k] if i >> k & 1 else low[k] for k in range(3)) for i in range(8)]
    quads = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]
    return points, [face for a, b, c, d in quads for face in ((a, b, c), (a, c, d))]


FLOOR = square(SIDE)
OBJECTS = {"ball": (*ball(0.35, -0.35, 0.1, 40), BALL), "box": (*box((0.25, 0.1, 0), (0.65, 0.5, 0.9)), BOX)}


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

    for gloss in [*GLOSSES, "matte"]:
        scene = new_scene((WIDTH, HEIGHT), 4 * samples, threads=2)
        tree = scene.world.node_tree
        image = bpy.data.images.load(os.path.join(work, "env.exr"))
        image.colorspace_settings.name = "Linear Rec.709"
        texture, place, turn = (tree.nodes.new(f"ShaderNode{name}") for name in ("TexEnvironment", "TexCoord", "Mapping"))
        texture.image = image
        turn.inputs["Rotation"].default_value = (0, 0, -math.pi / 2)
        tree.links.new(place.outputs["Generated"], turn.inputs["Vector"])
        tree.links.new(turn.outputs[0], texture.inputs["Vector"])
        tree.links.new(texture.outputs[0], tree.nodes["Background"].inputs["Color"])
        add(scene, "floor", *FLOOR, (ALBEDO,) * 3, GLOSSES.get(gloss))
        things = [add(scene, name, *shape) for name, shape in OBJECTS.items()]
        look(scene, EYE, TARGET, FOV)
        for name, hidden in (("without", True), ("with", False)):
            for thing in things:
                thing.hide_render, thing.visible_camera = hidden, False
            render(scene, os.path.join(work, f"cycles-{gloss}-{name}.exr"))


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
