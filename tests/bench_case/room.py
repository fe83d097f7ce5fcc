"""A furnished room with two lamps, rendered by Blender Cycles with and without the object of the bench case, and what a
capture of it would give: the light at the object as a panorama, and a mesh jittered by 5 mm. Nothing of it comes from us.

    pip install bpy==4.5.15 numpy        (Python 3.11)
    python3 tests/bench_case/room.py ../shared/data/bench-case/object.glb tests/bench_case/room
    lightharmony run tests/bench_case/room.ron
"""
import json
import math
import os
import sys

import bpy
import numpy as np
from mathutils import Matrix, Vector

OBJECT, OUT = sys.argv[1], sys.argv[2]
AT, PROBE, YAW = Vector((0.5, -0.3, 0.0)), 0.45, 20.0
SIZE, SAMPLES = (320, 240), 96
os.makedirs(OUT, exist_ok=True)
bpy.ops.wm.read_factory_settings(use_empty=True)
scene = bpy.context.scene


def material(name, colour, shine=0.0):
    made = bpy.data.materials.new(name)
    made.use_nodes = True
    tree = made.node_tree
    tree.nodes.clear()
    out = tree.nodes.new("ShaderNodeOutputMaterial")
    kind = "ShaderNodeEmission" if shine else "ShaderNodeBsdfDiffuse"
    node = tree.nodes.new(kind)
    node.inputs["Color"].default_value = (*colour, 1)
    if shine:
        node.inputs["Strength"].default_value = shine
    tree.links.new(node.outputs[0], out.inputs[0])
    return made


proxy = {"points": [], "faces": [], "colours": []}


def grid(corner, u, v, look, colour, step=0.1):
    """A rectangle seen from the side of u x v, and as fine triangles in the mesh of the capture."""
    corner, u, v = Vector(corner), Vector(u), Vector(v)
    mesh = bpy.data.meshes.new("wall")
    mesh.from_pydata([corner, corner + u, corner + u + v, corner + v], [], [(0, 1, 2, 3)])
    mesh.materials.append(look)
    scene.collection.objects.link(bpy.data.objects.new("wall", mesh))
    n, m = max(1, round(u.length / step)), max(1, round(v.length / step))
    first = len(proxy["points"])
    for j in range(m + 1):
        for i in range(n + 1):
            proxy["points"].append(corner + u * (i / n) + v * (j / m))
            proxy["colours"].append(colour)
    for j in range(m):
        for i in range(n):
            a = first + j * (n + 1) + i
            proxy["faces"] += [(a, a + 1, a + n + 2), (a, a + n + 2, a + n + 1)]


def box(low, high, look, colour):
    (a, b, c), (d, e, f) = low, high
    x, y, z = d - a, e - b, f - c
    for corner, u, v in [((a, b, f), (x, 0, 0), (0, y, 0)), ((a, b, c), (0, y, 0), (x, 0, 0)),
                         ((a, b, c), (x, 0, 0), (0, 0, z)), ((d, e, c), (-x, 0, 0), (0, 0, z)),
                         ((d, b, c), (0, y, 0), (0, 0, z)), ((a, e, c), (0, -y, 0), (0, 0, z))]:
        grid(corner, u, v, look, colour)


def clipped(colour, shine=0.0):
    return tuple(min(1.0, c * (shine or 1.0)) for c in colour)


X, Y, Z = 2.6, 2.1, 2.7
white, red, blue, wood = (0.75, 0.73, 0.7), (0.6, 0.13, 0.1), (0.15, 0.25, 0.55), (0.35, 0.22, 0.12)
lamp, glow = (1.0, 0.92, 0.8), (1.0, 0.75, 0.45)
looks = {c: material(str(c), c) for c in (white, red, blue, wood)}
grid((-X, -Y, 0), (2 * X, 0, 0), (0, 2 * Y, 0), looks[wood], wood)
grid((-X, -Y, Z), (0, 2 * Y, 0), (2 * X, 0, 0), looks[white], white)
grid((-X, -Y, 0), (0, 2 * Y, 0), (0, 0, Z), looks[red], red)
grid((X, Y, 0), (0, -2 * Y, 0), (0, 0, Z), looks[blue], blue)
grid((X, -Y, 0), (-2 * X, 0, 0), (0, 0, Z), looks[white], white)
grid((-X, Y, 0), (2 * X, 0, 0), (0, 0, Z), looks[white], white)
grid((-0.9, 0.2, Z - 0.01), (0, 0.5, 0), (0.5, 0, 0), material("lamp", lamp, 30.0), clipped(lamp, 30.0))
grid((X - 0.01, 0.9, 0.9), (0, -0.35, 0), (0, 0, 0.6), material("glow", glow, 12.0), clipped(glow, 12.0))
box((-1.9, 0.9, 0.0), (-0.9, 1.7, 0.75), looks[white], white)
box((-2.2, -1.6, 0.0), (-1.6, -0.9, 1.3), looks[blue], blue)

rng = np.random.default_rng(5)
points = np.array(proxy["points"]) + rng.normal(0.0, 0.005, (len(proxy["points"]), 3))
srgb = lambda c: np.where(c <= 0.0031308, 12.92 * c, 1.055 * np.power(np.maximum(c, 1e-9), 1 / 2.4) - 0.055)
codes = np.round(255 * srgb(np.array(proxy["colours"]))).astype(int)
with open(f"{OUT}/mesh.ply", "w") as ply:
    ply.write(f"ply\nformat ascii 1.0\nelement vertex {len(points)}\n")
    ply.write("".join(f"property float {a}\n" for a in "xyz") + "".join(f"property uchar {c}\n" for c in ("red", "green", "blue")))
    ply.write(f"element face {len(proxy['faces'])}\nproperty list uchar int vertex_indices\nend_header\n")
    for p, c in zip(points, codes):
        ply.write("%.6f %.6f %.6f %d %d %d\n" % (*p, *c))
    for face in proxy["faces"]:
        ply.write("3 %d %d %d\n" % face)

before = set(bpy.data.objects)
bpy.ops.import_scene.gltf(filepath=OBJECT)
added = [o for o in bpy.data.objects if o not in before]
place = Matrix.Translation(AT) @ Matrix.Rotation(math.radians(YAW), 4, "Z")
for o in added:
    if o.parent is None:
        o.matrix_world = place @ o.matrix_world

scene.render.engine = "CYCLES"
scene.cycles.use_adaptive_sampling, scene.cycles.use_denoising = False, True
scene.cycles.sample_clamp_indirect, scene.cycles.max_bounces, scene.cycles.diffuse_bounces = 0, 12, 8
scene.render.film_transparent = False
scene.view_settings.view_transform = "Standard"
scene.render.image_settings.file_format = "OPEN_EXR"
scene.render.image_settings.color_depth = "32"
scene.render.threads_mode, scene.render.threads = "FIXED", 2
world = bpy.data.worlds.new("black")
scene.world = world
world.use_nodes = True
world.node_tree.nodes["Background"].inputs[0].default_value = (0, 0, 0, 1)


def camera(eye, target, fov):
    data = bpy.data.cameras.new("camera")
    made = bpy.data.objects.new("camera", data)
    scene.collection.objects.link(made)
    made.location = eye
    made.rotation_euler = (Vector(target) - Vector(eye)).to_track_quat("-Z", "Y").to_euler()
    data.sensor_fit, data.angle = "VERTICAL", math.radians(fov)
    scene.camera = made
    return data


def render(name, size, samples, objects):
    for o in added:
        o.hide_render = not objects
    scene.render.resolution_x, scene.render.resolution_y = size
    scene.cycles.samples = samples
    scene.render.filepath = f"{OUT}/{name}.exr"
    bpy.ops.render.render(write_still=True)


views = []
VIEWS = [((-1.6, -1.7, 1.5), (0.5, -0.2, 0.35)), ((0.2, 1.9, 1.7), (0.5, -0.4, 0.3))]
for k, (eye, target) in enumerate(VIEWS):
    data = camera(eye, target, 45.0)
    bpy.context.view_layer.update()
    focal = SIZE[1] / 2 / math.tan(data.angle / 2)
    views.append({"name": f"view_{k}", "w": SIZE[0], "h": SIZE[1], "fx": focal, "fy": focal, "cx": SIZE[0] / 2,
                  "cy": SIZE[1] / 2, "c2w_opengl": [list(row) for row in scene.camera.matrix_world]})
    render(f"view_{k}_without", SIZE, SAMPLES, False)
    render(f"view_{k}_with", SIZE, SAMPLES, True)
with open(f"{OUT}/cameras.json", "w") as cameras:
    json.dump({"views": views}, cameras)
data = camera(AT + Vector((0, 0, PROBE)), AT + Vector((0, 1, PROBE)), 90.0)
data.type, data.panorama_type = "PANO", "EQUIRECTANGULAR"
render("panorama", (640, 320), 48, False)
