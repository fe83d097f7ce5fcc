#!/usr/bin/env python3
"""Errors of traces with `max_error`: the duck of render-refs, compared with plain traces.

usage: errors.py LIGHTHARMONY DATA WORK [small]    prints the table of docs/evidence/trade.md; WORK is a folder to fill; `small` only
tries it: a sixteenth of the pixels, few samples

The truth is a plain trace of 512 samples with another seed. CPU time is that of a process on one thread, less that of the
same process with one sample. Needs numpy and OpenEXR.
"""
import json, os, resource, subprocess, sys
import numpy as np
import OpenEXR

PROGRAM, DATA, WORK = (os.path.abspath(word) for word in sys.argv[1:4])
FOLDER = os.path.join(DATA, "render-refs/sunny_plane")
SMALL = sys.argv[4:] == ["small"]
TRUTH, TILE, ASKED, PLAIN = (16, 8, [0.3], [8]) if SMALL else (512, 8, [0.1, 0.05, 0.03, 0.02], [16, 64, 128])

def graph(scene):
    """The scene, traced."""
    part = 4 if SMALL else 1
    camera = {key: type(value)(value / part) if isinstance(value, (int, float)) else value for key, value in scene["camera"].items()}
    view = {"name": "view", "w": camera["width"], "h": camera["height"], "c2w_opencv": camera["c2w"]}
    view |= {key: camera[key] for key in ["fx", "fy", "cx", "cy"]}
    with open(os.path.join(WORK, "rig.json"), "w") as file:
        json.dump({"views": [view]}, file)
    matrix = ", ".join(str(number) for row in scene["object_transform"] for number in row)
    colour = ", ".join(str(channel) for channel in scene["object_material"]["albedo"])
    return f"""Graph(
    version: 1, scene: (up: "+y", seed: 7),
    nodes: (
        rig:    LoadCameras(path: "rig.json"),
        plane:  LoadMesh(path: "{FOLDER}/receiver.ply", colours: Srgb),
        duck:   LoadObject(path: "{FOLDER}/object.glb"),
        matte:  OverrideMaterial(object: "duck", surface: Diffuse, colour: ({colour})),
        pose:   Pose(matrix: ({matrix})),
        placed: Place(object: "matte", pose: "pose"),
        env:    LoadEnvironment(path: "{FOLDER}/env.exr"),
        trace:  PathTrace(receiver: "plane", objects: ["placed"], rig: "rig", env: "env", samples: 1024,
                          surroundings: Open, contact_metres: 0.0),
        save:   WriteExr(layers: ["trace.without", "trace.with", "trace.object"], path: "out.exr"),
        told:   WriteReport(report: "trace.report", path: "out.json"),
    ),
)
"""

def trace(name, **fields):
    """S, the object, the samples of the report, and CPU-seconds."""
    out = os.path.join(WORK, name)
    seed = fields.pop("seed", 7)
    sets = [f"--set=trace.{field}={value}" for field, value in fields.items()] + [f"--set=scene.seed={seed}"]
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    command = [PROGRAM, "run", os.path.join(WORK, "duck.ron"), "--jobs", "1", "--cache", os.path.join(out, "cache"), "--out", out]
    done = subprocess.run(command + sets, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    if done.returncode not in (0, 3):
        sys.exit(f"{name}: {done.stderr}")
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    with OpenEXR.File(os.path.join(out, "out.exr")) as file:
        planes = {layer: channel.pixels for layer, channel in file.channels().items()}
    with open(os.path.join(out, "out.json")) as file:
        tables = {table["name"]: table for table in json.load(file)["tables"]}
    told = dict(zip(tables["samples"]["columns"], tables["samples"]["rows"][0])) if "samples" in tables else {}
    spent = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return planes, told, spent

def off(planes, truth):
    """Root mean square error of S where it is seen past the object: in the worst tile, and over the touched ones."""
    luminance = np.array([0.2126, 0.7152, 0.0722])
    a, b = ((layers["with"] @ luminance) / np.maximum(layers["without"] @ luminance, 1e-9) for layers in (planes, truth))
    error = ((a - b) / np.maximum(b, 1.0) * (1.0 - truth["object"][..., 3])) ** 2
    touched = (np.abs(b - 1.0) > 1e-3) & (truth["object"][..., 3] < 1.0)
    tiles = []
    for top in range(0, error.shape[0], TILE):
        for left in range(0, error.shape[1], TILE):
            cell = (slice(top, top + TILE), slice(left, left + TILE))
            if touched[cell].any():
                tiles.append(error[cell][touched[cell]].mean())
    return np.sqrt(max(tiles)), np.sqrt(error[touched].mean())

def main():
    os.makedirs(WORK, exist_ok=True)
    with open(os.path.join(FOLDER, "scene.json")) as file:
        text = graph(json.load(file))
    with open(os.path.join(WORK, "duck.ron"), "w") as file:
        file.write(text)
    start = trace("start", samples=1)[2]
    truth = trace("truth", samples=TRUTH, seed=99)[0]
    print("| `max_error` | predicted by the first samples | reached, as reported | worst tile, true | all touched pixels, true | samples per pixel | CPU-s |")
    print("|---|---|---|---|---|---|---|")
    for asked in ASKED:
        planes, told, spent = trace(f"asked_{asked}", max_error=asked)
        worst, mean = off(planes, truth)
        print(f"| {asked} | {told['error predicted from the first samples']:.3f} | {told['error reached']:.4f} | {worst:.4f} | {mean:.4f} | "
              f"{told['samples per pixel']:.0f} | {spent - start:.1f} |", flush=True)
    for samples in PLAIN:
        planes, _, spent = trace(f"plain_{samples}", samples=samples)
        worst, mean = off(planes, truth)
        print(f"| none | | | {worst:.4f} | {mean:.4f} | {samples} | {spent - start:.1f} |", flush=True)

if __name__ == "__main__":
    main()
