"""The objects that are inserted, made by script and written as GLB (glTF 2.0, y up, metres). NumPy only. Licence: CC0-1.0.

    python objects.py FOLDER

Each object stands on y = 0, is about 0.5 m high, and has its origin in the middle of its base.
"""
import json
import pathlib
import struct
import sys

import numpy as np

from shapes import ball, lathe

HEIGHT = 0.5


def smooth_lathe(profile, segments=64):
    """Positions, normals and triangles of a surface of revolution; corners of the profile above 40 degrees stay sharp."""
    profile = np.asarray(profile, float)
    pieces, start = [], 0
    for k in range(1, len(profile) - 1):
        a, b = profile[k] - profile[k - 1], profile[k + 1] - profile[k]
        cosine = a @ b / max(1e-12, np.linalg.norm(a) * np.linalg.norm(b))
        if cosine < np.cos(np.radians(40)):
            pieces.append(profile[start:k + 1])
            start = k
    pieces.append(profile[start:])
    return join([shaded(*lathe(piece, segments)) for piece in pieces])


def shaded(vertices, faces):
    """Normals as the mean of the faces around a vertex, weighted by area."""
    corners = vertices[faces]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = np.zeros_like(vertices)
    for k in range(3):
        np.add.at(normals, faces[:, k], across)
    return vertices, normals / np.maximum(1e-20, np.linalg.norm(normals, axis=1, keepdims=True)), faces


def join(meshes):
    positions, normals, faces, first = [], [], [], 0
    for p, n, f in meshes:
        positions.append(p)
        normals.append(n)
        faces.append(np.asarray(f) + first)
        first += len(p)
    return np.concatenate(positions), np.concatenate(normals), np.concatenate(faces)


def moved(mesh, offset):
    p, n, f = mesh
    return p + np.array(offset, float), n, f


def torus(radius, tube, around=96, across=32):
    """A torus in the plane x z, that stands on z = 0."""
    a, b = np.meshgrid(2 * np.pi * np.arange(around) / around, 2 * np.pi * np.arange(across) / across, indexing="ij")
    normals = np.stack([np.cos(a) * np.cos(b), np.sin(b), np.sin(a) * np.cos(b)], -1)
    centres = np.stack([radius * np.cos(a), 0 * a, radius * np.sin(a) + radius + tube], -1)
    index = np.arange(around * across).reshape(around, across)
    i, j = np.roll(index, -1, 0), np.roll(index, -1, 1)
    ij = np.roll(i, -1, 1)
    faces = np.concatenate([np.stack([index, ij, i], -1).reshape(-1, 3), np.stack([index, j, ij], -1).reshape(-1, 3)])
    return (centres + tube * normals).reshape(-1, 3), normals.reshape(-1, 3), faces


def blades(rng, roots, directions, length, width, bend, steps=4):
    """Thin curved leaves. Each begins at a root, leaves in its direction and bends down."""
    meshes = []
    for root, direction in zip(roots, directions):
        side = np.cross(direction, (0, 0, 1.0))
        if np.linalg.norm(side) < 1e-3:
            side = np.array([1.0, 0, 0])
        side = side / np.linalg.norm(side)
        size = length * rng.uniform(0.7, 1.15)
        t = np.linspace(0, 1, steps + 1)[:, None]
        spine = root + direction * size * t + np.array([0, 0, -bend * size]) * t ** 2
        half = side * width * (1 - t ** 2) / 2
        half[-1] = side * width * 0.02
        points = np.stack([spine - half, spine + half], 1).reshape(-1, 3)
        a = 2 * np.arange(steps)
        faces = np.concatenate([np.stack([a, a + 1, a + 3], 1), np.stack([a, a + 3, a + 2], 1)])
        meshes.append(shaded(points, faces))
    return join(meshes)


def spread(count):
    """Directions spread evenly over the sphere (Fibonacci)."""
    k = np.arange(count) + 0.5
    z = 1 - 2 * k / count
    t = np.pi * (1 + 5 ** 0.5) * k
    r = np.sqrt(1 - z * z)
    return np.stack([r * np.cos(t), r * np.sin(t), z], 1)


def look(colour, roughness=1.0, metallic=0.0, **more):
    """A glTF material. `more`: `transmission`, `ior`, `clearcoat`, `emission`, `double`."""
    made = {"pbrMetallicRoughness": {"baseColorFactor": [*colour, 1.0], "roughnessFactor": roughness,
                                     "metallicFactor": metallic}, "extensions": {}}
    if "transmission" in more:
        made["extensions"]["KHR_materials_transmission"] = {"transmissionFactor": more["transmission"]}
        made["extensions"]["KHR_materials_ior"] = {"ior": more.get("ior", 1.5)}
        # With a thickness the surface encloses a volume, so light is refracted.
        made["extensions"]["KHR_materials_volume"] = {"thicknessFactor": 0.1}
    if "clearcoat" in more:
        made["extensions"]["KHR_materials_clearcoat"] = {"clearcoatFactor": more["clearcoat"],
                                                         "clearcoatRoughnessFactor": 0.03}
    if "emission" in more:
        made["emissiveFactor"] = list(more["emission"][:3])
        made["extensions"]["KHR_materials_emissive_strength"] = {"emissiveStrength": more["emission"][3]}
    if more.get("double"):
        made["doubleSided"] = True
    if not made["extensions"]:
        del made["extensions"]
    return made


def vase():
    """Matte: a vase of clay, closed at the top."""
    profile = [(0, 0), (0.10, 0), (0.10, 0.02), (0.145, 0.10), (0.17, 0.19), (0.165, 0.27), (0.13, 0.35), (0.085, 0.41),
               (0.075, 0.45), (0.095, 0.49), (0.10, 0.50), (0.085, 0.50), (0.066, 0.46), (0.0, 0.44)]
    return [(smooth_lathe(curve(profile)), look((0.55, 0.24, 0.13)))]


def trophy():
    """Metal: a ball of steel on a foot of brass."""
    foot = [(0, 0), (0.15, 0), (0.15, 0.03), (0.10, 0.05), (0.045, 0.09), (0.035, 0.15), (0.06, 0.19), (0.0, 0.20)]
    return [(smooth_lathe(foot), look((0.89, 0.66, 0.31), 0.3, 1.0)),
            (smooth_lathe(ball(0.16, 0.34, 32)), look((0.72, 0.72, 0.74), 0.12, 1.0))]


def glass():
    """Glass: a thick tumbler."""
    # The bottom is 4 mm above the rim on which it stands: coplanar surfaces of glass and ground would be ambiguous.
    profile = [(0, 0.004), (0.112, 0.004), (0.12, 0), (0.15, 0.5), (0.13, 0.5), (0.108, 0.09), (0.0, 0.08)]
    return [(smooth_lathe(profile), look((0.93, 0.98, 0.96), 0.0, 0.0, transmission=1.0, ior=1.5))]


def ring():
    """Glossy: a blue ring with a clear coat, on a white foot."""
    foot = [(0, 0), (0.13, 0), (0.13, 0.05), (0.11, 0.07), (0, 0.07)]
    return [(smooth_lathe(foot), look((0.78, 0.77, 0.74), 0.5)),
            (moved(torus(0.16, 0.06), (0, 0, 0.06)), look((0.05, 0.14, 0.55), 0.25, 0.0, clearcoat=1.0))]


def lantern():
    """Emissive: a glowing ball between two dark plates with four posts."""
    dark = look((0.05, 0.045, 0.04), 0.5)
    plates = [smooth_lathe([(0, z), (0.15, z), (0.15, z + 0.03), (0, z + 0.03)]) for z in (0.0, 0.47)]
    post = smooth_lathe([(0.01, 0.03), (0.01, 0.47)], 16)
    posts = [moved(post, (0.12 * np.cos(t), 0.12 * np.sin(t), 0)) for t in np.pi / 4 + np.pi / 2 * np.arange(4)]
    return [(join(plates + posts), dark),
            (smooth_lathe(ball(0.09, 0.25, 24)), look((0.8, 0.8, 0.8), 1.0, emission=(1.0, 0.62, 0.28, 4.0)))]


def plant():
    """Thin: long leaves in a white pot."""
    rng = np.random.default_rng(7)
    pot = [(0, 0), (0.085, 0), (0.11, 0.16), (0.10, 0.16), (0.095, 0.14), (0, 0.14)]
    count = 70
    t, lean = rng.uniform(0, 2 * np.pi, count), rng.uniform(0.05, 0.9, count)
    directions = np.stack([np.sin(lean) * np.cos(t), np.sin(lean) * np.sin(t), np.cos(lean)], 1)
    roots = np.stack([0.06 * np.cos(t), 0.06 * np.sin(t), np.full(count, 0.13)], 1) * np.array([1, 1, 1.0])
    leaves = blades(rng, roots, directions, 0.36, 0.022, 0.35)
    return [(smooth_lathe(pot), look((0.7, 0.69, 0.66), 0.4)), (leaves, look((0.10, 0.28, 0.07), 0.6, double=True))]


def fur():
    """Furry: a ball with 5000 hairs."""
    rng = np.random.default_rng(11)
    out = spread(5000)
    directions = out + rng.normal(0, 0.25, out.shape)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    centre = np.array([0, 0, 0.25])
    hairs = blades(rng, centre + 0.185 * out, directions, 0.07, 0.0045, 0.25, steps=2)
    keep = hairs[0].copy()
    keep[:, 2] = np.maximum(keep[:, 2], 0.0)
    return [(smooth_lathe(ball(0.19, 0.25, 32)), look((0.30, 0.19, 0.10))),
            ((keep, hairs[1], hairs[2]), look((0.62, 0.42, 0.24), 0.7, double=True))]


def curve(points, steps=5):
    """A smooth curve through points (Catmull-Rom). Points closer than 25 mm to the previous one start a sharp corner."""
    p = np.array(points, float)
    out = [p[0]]
    for k in range(len(p) - 1):
        a, b = p[k], p[k + 1]
        if np.linalg.norm(b - a) < 0.025 or k == 0:
            out.append(b)
            continue
        before, after = p[k - 1], p[min(k + 2, len(p) - 1)]
        for t in np.linspace(0, 1, steps + 1)[1:]:
            out.append(0.5 * (2 * a + (b - before) * t + (2 * before - 5 * a + 4 * b - after) * t ** 2
                              + (3 * a - before - 3 * b + after) * t ** 3))
    out = np.array(out)
    out[:, 0] = np.maximum(out[:, 0], 0)
    return out


OBJECTS = {"matte": vase, "metal": trophy, "glass": glass, "glossy": ring, "emissive": lantern, "thin": plant, "furry": fur}


def glb(parts):
    """The bytes of a GLB file. `parts`: pairs of a mesh with z up and a material."""
    blob, views, accessors, primitives, materials = bytearray(), [], [], [], []

    def store(array, target, kind, component, bounds=False):
        while len(blob) % 4:
            blob.append(0)
        views.append({"buffer": 0, "byteOffset": len(blob), "byteLength": array.nbytes, "target": target})
        blob.extend(array.tobytes())
        made = {"bufferView": len(views) - 1, "componentType": component, "count": len(array) if kind == "VEC3" else array.size,
                "type": kind}
        if bounds:
            made["min"], made["max"] = array.min(0).tolist(), array.max(0).tolist()
        accessors.append(made)
        return len(accessors) - 1

    for (positions, normals, faces), material in parts:
        up = lambda a: np.ascontiguousarray(np.stack([a[:, 0], a[:, 2], -a[:, 1]], 1), np.float32)
        small = len(positions) < 65536
        index = np.ascontiguousarray(faces.ravel(), np.uint16 if small else np.uint32)
        materials.append(material)
        primitives.append({"attributes": {"POSITION": store(up(positions), 34962, "VEC3", 5126, True),
                                          "NORMAL": store(up(normals), 34962, "VEC3", 5126)},
                           "indices": store(index, 34963, "SCALAR", 5123 if small else 5125), "material": len(materials) - 1})
    while len(blob) % 4:
        blob.append(0)
    used = sorted({name for m in materials for name in m.get("extensions", {})})
    root = {"asset": {"version": "2.0", "generator": "lightharmony python/bench/objects.py", "copyright": "CC0-1.0"},
            "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}], "meshes": [{"primitives": primitives}],
            "materials": materials, "accessors": accessors, "bufferViews": views, "buffers": [{"byteLength": len(blob)}]}
    if used:
        root["extensionsUsed"] = used
    text = json.dumps(root, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    return (struct.pack("<4sII", b"glTF", 2, 28 + len(text) + len(blob)) + struct.pack("<I4s", len(text), b"JSON") + text
            + struct.pack("<I4s", len(blob), b"BIN\0") + bytes(blob))


def write(name, path):
    pathlib.Path(path).write_bytes(glb(OBJECTS[name]()))


if __name__ == "__main__":
    folder = pathlib.Path(sys.argv[1])
    folder.mkdir(parents=True, exist_ok=True)
    for each in OBJECTS:
        write(each, folder / f"{each}.glb")
        print(f"{each:10} {(folder / f'{each}.glb').stat().st_size:8} bytes")
