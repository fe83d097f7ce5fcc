"""Animated vertices of glTF files against an evaluation in NumPy (float64).

    python tests/tables/animation.py PROGRAM [WORK]

Makes files with node tracks, a skin and morph targets, each with the interpolations STEP, LINEAR and CUBICSPLINE and a
second clip, plays them at ten times between and at the keys, and prints the largest distance of a vertex, in units of the
size of the object. Needs NumPy.
"""

import json
import os
import struct
import subprocess
import sys

import numpy as np

TIMES = [0.0, 0.1, 0.25, 0.4, 0.5, 0.625, 0.8, 1.0, 1.2, 1.5]
KEYS = np.array([0.0, 0.5, 0.8, 1.5])
WIDTH = {"translation": 3, "scale": 3, "rotation": 4}


class File:
    """A GLB file under construction."""

    def __init__(self):
        self.json = {"asset": {"version": "2.0"}, "scene": 0, "accessors": [], "bufferViews": [], "animations": []}
        self.blob = b""

    def accessor(self, values, shape, kind=5126):
        values = np.ascontiguousarray(values, {5126: "<f4", 5121: "u1", 5125: "<u4"}[kind])
        data = values.tobytes()
        self.json["bufferViews"].append({"buffer": 0, "byteOffset": len(self.blob), "byteLength": len(data)})
        self.blob += data + b"\0" * (-len(data) % 4)
        width = {"SCALAR": 1, "VEC3": 3, "VEC4": 4, "MAT4": 16}[shape]
        entry = {"bufferView": len(self.json["bufferViews"]) - 1, "componentType": kind, "type": shape}
        entry["count"] = values.size // width
        if shape == "VEC3" or shape == "SCALAR" and kind == 5126:
            rows = values.reshape(-1, width)
            entry |= {"min": rows.min(0).tolist(), "max": rows.max(0).tolist()}
        self.json["accessors"].append(entry)
        return len(self.json["accessors"]) - 1

    def clip(self, name, tracks):
        """A clip of tracks (node, property, interpolation, values). Values are rows per key; a spline has three."""
        channels, samplers = [], []
        for node, path, interpolation, values in tracks:
            shape = {"rotation": "VEC4", "weights": "SCALAR"}.get(path, "VEC3")
            time, out = self.accessor(KEYS, "SCALAR"), self.accessor(values, shape)
            samplers.append({"input": time, "output": out, "interpolation": interpolation})
            channels.append({"sampler": len(samplers) - 1, "target": {"node": node, "path": path}})
        self.json["animations"].append({"name": name, "channels": channels, "samplers": samplers})

    def write(self, path):
        self.json["buffers"] = [{"byteLength": len(self.blob)}]
        text = json.dumps(self.json).encode()
        text += b" " * (-len(text) % 4)
        whole = 12 + 8 + len(text) + 8 + len(self.blob)
        with open(path, "wb") as out:
            out.write(b"glTF" + struct.pack("<II", 2, whole) + struct.pack("<I", len(text)) + b"JSON" + text)
            out.write(struct.pack("<I", len(self.blob)) + b"BIN\0" + self.blob)


def tracks(rng, path, interpolation, width):
    """Random values of the keys, as a file stores them."""
    per_key = 3 if interpolation == "CUBICSPLINE" else 1
    values = rng.normal(size=(len(KEYS), per_key, width)) * (0.4 if path != "rotation" else 1.0)
    if path == "scale":
        values = 1.0 + 0.5 * values
    if path == "rotation":
        at = 1 if per_key == 3 else 0
        values[:, at] /= np.linalg.norm(values[:, at], axis=-1, keepdims=True)
    return values.astype("<f4")


def sample(path, interpolation, values, time):
    """The value of a track, after appendix C of glTF 2.0."""
    keys, values = KEYS.astype("<f4").astype(float), values.astype(float)
    middle = 1 if interpolation == "CUBICSPLINE" else 0
    if time >= keys[-1]:
        found = values[-1, middle]
    elif time <= keys[0]:
        found = values[0, middle]
    else:
        k = int(np.searchsorted(keys, time, "right")) - 1
        step = keys[k + 1] - keys[k]
        u = (time - keys[k]) / step
        a, b = values[k, middle], values[k + 1, middle]
        if interpolation == "STEP":
            found = a
        elif interpolation == "CUBICSPLINE":
            out, into = step * values[k, 2], step * values[k + 1, 0]
            found = (2 * u**3 - 3 * u**2 + 1) * a + (u**3 - 2 * u**2 + u) * out
            found = found + (3 * u**2 - 2 * u**3) * b + (u**3 - u**2) * into
        elif path == "rotation":
            a, b = a / np.linalg.norm(a), b / np.linalg.norm(b)
            b = b if a @ b >= 0 else -b
            angle = np.arccos(min(a @ b, 1.0))
            found = (np.sin((1 - u) * angle) * a + np.sin(u * angle) * b) / np.sin(angle) if angle > 1e-9 else a
        else:
            found = (1 - u) * a + u * b
    return found / np.linalg.norm(found) if path == "rotation" else found


def matrix(node):
    """The matrix of a node's translation, rotation and scale."""
    x, y, z, w = np.array(node.get("rotation", [0, 0, 0, 1]), float)
    turn = np.array([[1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
                     [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
                     [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)]])
    out = np.eye(4)
    out[:3, :3] = turn * np.array(node.get("scale", [1, 1, 1]), float)
    out[:3, 3] = node.get("translation", [0, 0, 0])
    return out


def points(rng):
    corners = rng.normal(size=(24, 3)).astype("<f4")
    return corners, np.arange(24, dtype="<u4")


def nodes_case(rng, interpolation):
    """A parent that turns and moves, and a child that turns and is scaled."""
    file = File()
    corners, index = points(rng)
    primitive = {"attributes": {"POSITION": file.accessor(corners, "VEC3")}, "indices": file.accessor(index, "SCALAR", 5125)}
    file.json |= {"nodes": [{"children": [1]}, {"mesh": 0}], "scenes": [{"nodes": [0]}], "meshes": [{"primitives": [primitive]}]}
    clips = {}
    for clip in ("first", "second"):
        kinds = [(0, "translation"), (0, "rotation"), (1, "rotation"), (1, "scale")]
        clips[clip] = [(n, path, interpolation, tracks(rng, path, interpolation, WIDTH[path])) for n, path in kinds]
        file.clip(clip, clips[clip])

    def vertices(clip, time):
        nodes = [{}, {}]
        for node, path, how, values in clips[clip]:
            nodes[node][path] = sample(path, how, values, time)
        m = matrix(nodes[0]) @ matrix(nodes[1])
        return corners.astype(float) @ m[:3, :3].T + m[:3, 3]

    return file, vertices, len(corners)


def skin_case(rng, interpolation):
    """Two joints, one below the other, with inverse bind matrices and mixed weights."""
    file = File()
    corners, index = points(rng)
    share = rng.uniform(size=len(corners)).astype("<f4")
    weights = np.stack([share, 1 - share, 0 * share, 0 * share], 1).astype("<f4")
    bind = [np.linalg.inv(matrix({"translation": [0.1, 0.2, 0.3]})), np.linalg.inv(matrix({"translation": [0.1, 1.2, 0.3]}))]
    attributes = {
        "POSITION": file.accessor(corners, "VEC3"),
        "JOINTS_0": file.accessor(np.tile([0, 1, 0, 0], (len(corners), 1)), "VEC4", 5121),
        "WEIGHTS_0": file.accessor(weights, "VEC4"),
    }
    inverse = file.accessor(np.stack([m.T for m in bind]), "MAT4")
    primitive = {"attributes": attributes, "indices": file.accessor(index, "SCALAR", 5125)}
    rest = [{"translation": [0.1, 0.2, 0.3]}, {"translation": [0.0, 1.0, 0.0]}]
    file.json |= {
        "nodes": [{"mesh": 0, "skin": 0}, rest[0] | {"children": [2]}, rest[1]],
        "scenes": [{"nodes": [0, 1]}], "meshes": [{"primitives": [primitive]}],
        "skins": [{"joints": [1, 2], "inverseBindMatrices": inverse}],
    }
    clips = {}
    for clip in ("first", "second"):
        kinds = [(1, "rotation"), (2, "rotation"), (2, "translation")]
        clips[clip] = [(n, path, interpolation, tracks(rng, path, interpolation, WIDTH[path])) for n, path in kinds]
        file.clip(clip, clips[clip])
    bind = [m.astype("<f4").astype(float) for m in bind]

    def vertices(clip, time):
        nodes = [dict(rest[0]), dict(rest[1])]
        for node, path, how, values in clips[clip]:
            nodes[node - 1][path] = sample(path, how, values, time)
        upper = matrix(nodes[0])
        joints = [upper @ bind[0], upper @ matrix(nodes[1]) @ bind[1]]
        w = weights.astype(float)
        w = w / w.sum(1, keepdims=True)
        p = np.c_[corners.astype(float), np.ones(len(corners))]
        return sum(w[:, j : j + 1] * (p @ joints[j].T)[:, :3] for j in (0, 1))

    return file, vertices, len(corners)


def morph_case(rng, interpolation):
    """Two morph targets."""
    file = File()
    corners, index = points(rng)
    targets = [rng.normal(size=corners.shape).astype("<f4") for _ in range(2)]
    primitive = {
        "attributes": {"POSITION": file.accessor(corners, "VEC3")},
        "indices": file.accessor(index, "SCALAR", 5125),
        "targets": [{"POSITION": file.accessor(target, "VEC3")} for target in targets],
    }
    file.json |= {"nodes": [{"mesh": 0}], "scenes": [{"nodes": [0]}], "meshes": [{"primitives": [primitive], "weights": [0, 0]}]}
    clips = {}
    for clip in ("first", "second"):
        values = tracks(rng, "weights", interpolation, 2)
        clips[clip] = (interpolation, values)
        file.clip(clip, [(0, "weights", interpolation, values)])

    def vertices(clip, time):
        how, values = clips[clip]
        weights = sample("weights", how, values, time)
        return corners.astype(float) + sum(w * t.astype(float) for w, t in zip(weights, targets))

    return file, vertices, len(corners)


def ours(program, work, path, clip, time, count):
    """The vertices that the program computes: from the value that the node `placed` reads."""
    graph = f'''Graph(version: 1, scene: (up: "+y"), nodes: (
        object: LoadObject(path: "{os.path.basename(path)}", clip: Some("{clip}"), time_s: {time}),
        pose: Pose(translation: (0.0, 0.0, 0.0)), placed: Place(object: "object", pose: "pose"),
    ))'''
    with open(f"{work}/graph.ron", "w") as out:
        out.write(graph)
    folder = f"{work}/action"
    subprocess.run(["rm", "-rf", folder], check=True)
    subprocess.run([program, "action", "write", "graph.ron", "placed", "action", "--cache", "cache"],
                   cwd=work, check=True, capture_output=True)
    mark = struct.pack("<Q", 3 * count)
    for name, _, files in os.walk(folder):
        for file in files:
            data = open(os.path.join(name, file), "rb").read()
            at = data.find(mark)
            if at >= 0 and len(data) >= at + 8 + 12 * count:
                return np.frombuffer(data, "<f4", 3 * count, at + 8).reshape(-1, 3).astype(float)
    raise SystemExit(f"no value with {count} vertices in {folder}")


def main():
    program = os.path.abspath(sys.argv[1])
    work = os.path.abspath(sys.argv[2] if len(sys.argv) > 2 else "animation")
    os.makedirs(work, exist_ok=True)
    rng = np.random.default_rng(7)
    print("| case | interpolation | largest distance |\n|---|---|---|")
    for name, case in (("nodes", nodes_case), ("skin", skin_case), ("morph", morph_case)):
        for how in ("STEP", "LINEAR", "CUBICSPLINE"):
            file, vertices, count = case(rng, how)
            path = f"{work}/{name}-{how.lower()}.glb"
            file.write(path)
            worst = 0.0
            for n, time in enumerate(TIMES):
                clip = ("first", "second")[n % 2]
                want, got = vertices(clip, time), ours(program, work, path, clip, time, count)
                size = np.linalg.norm(want.max(0) - want.min(0))
                worst = max(worst, np.linalg.norm(want - got, axis=1).max() / size)
            print(f"| {name} | {how} | {worst:.1e} |", flush=True)


main()
