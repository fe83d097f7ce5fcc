#!/usr/bin/env python3
"""What each check saves that leaves something out: counts and CPU time of a node with and without.

usage: skips.py PROGRAM WORK [small]        `small` only tries it: few splats, few samples, one run of each

A node runs alone, what stands above it known. Counts are those of every machine; CPU time is the least of three runs of
each, in turns, and stands as a ratio.
"""
import json, os, resource, shutil, struct, subprocess, sys, zlib

GRAPH = """Graph(version: 1, scene: (up: "+z", seed: 3), nodes: (
    demo:   DemoScene(place: Courtyard, splats: 120000, width_px: 160, height_px: 120, truth_width_px: 64),
    pose:   Pose(translation: (0.0, 0.0, 0.0), yaw_deg: 30.0),
    placed: Place(object: "demo.object", pose: "pose"),
    probe:  CubeRig(at: "pose", height_metres: 0.3, size_px: 256),
    faces:  SplatRender(splats: "demo.splats", rig: "probe"),
    pano:   Stitch(views: "faces", width_px: 512),
    dark:   PredictExposure(pano: "pano", evs: [-6.0, -3.0], method: Region),
    env:    FuseHdr(base: "pano", brackets: "dark"),
    trace:  PathTrace(receiver: "demo.proxy", objects: ["placed"], rig: "demo.rig", env: "env", samples: 16),
    paving: CropMesh(mesh: "demo.proxy", below_height: Some(0.3)),
    low:    PathTrace(receiver: "paving", objects: ["placed"], rig: "demo.rig", env: "env", samples: 16),
    other:  Pose(translation: (0.0, 0.0, 0.0), yaw_deg: 75.0),
    turned: Place(object: "demo.object", pose: "other"),
    again:  PathTrace(receiver: "demo.proxy", objects: ["turned"], rig: "demo.rig", env: "env", samples: 16),
    grey:   LoadPanorama(path: "grey.png"),
    none:   PredictExposure(pano: "grey", evs: [-6.0, -3.0], method: Learned),
))
"""
UPPER = "demo,pose,placed,turned,env"
HIGH = ["pose.translation=(0.0, 0.0, 30.0)"]
# The skipped work; the node that runs; settings that do the work and that skip it; nodes known before; the count.
ROWS = [
    ("the prediction of clipped light", "none", ["--exhaustive"], [], "grey", "pixels"),
    ("telling the receiver from its light", "trace", ["trace.surroundings=Projected"], [], UPPER, "rays"),
    ("R1, between walls", "trace", ["trace.crop=0.0"], [], UPPER, "rays"),
    ("R1, on the paving alone", "low", ["low.crop=0.0"], [], UPPER + ",paving", "rays"),
    ("R1, 30 m above it", "low", HIGH + ["low.crop=0.0"], HIGH, UPPER + ",paving", "rays"),
    ("R0, where the object alone was turned", "again", [], [], [UPPER, UPPER + ",trace"], "rays"),
    ("harmonics, of degree 4 for 0", "faces", [], ["faces.sh_degree=0"], "demo,pose", "splats_directed"),
    ("splats that no face can see, in blocks", "faces", ["--exhaustive"], [], "demo,pose", "splats_visited"),
    ("pixels of the panorama: 128 px and 256 columns for 512 and 1024", "env",
     ["probe.size_px=512", "pano.width_px=1024"], ["probe.size_px=128", "pano.width_px=256"], "demo,pose", "directions"),
]

def grey(path):
    """A panorama of 1024 x 512 pixels in which nothing is clipped."""
    rows = b"".join(b"\0" + bytes(80 + (x * 7 + y * 3) % 120 for x in range(1024)) for y in range(512))
    chunk = lambda name, body: struct.pack(">I", len(body)) + name + body + struct.pack(">I", zlib.crc32(name + body))
    with open(path, "wb") as file:
        file.write(b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", struct.pack(">IIBBBBB", 1024, 512, 8, 0, 0, 0, 0))
                   + chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b""))

def run(program, graph, only, cache, settings):
    """The counts of all that ran, and the CPU time of the process."""
    command = [program, "run", graph, "--only", only, "--cache", cache, "--json", "--jobs", "2"]
    for setting in settings:
        command += [setting] if setting.startswith("--") else ["--set", setting]
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    if done.returncode not in (0, 3):
        sys.exit(f"{' '.join(command)} ended with {done.returncode}: {done.stderr}")
    last = json.loads(done.stdout.strip().split("\n")[-1])
    return last["counts"], after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime

def short(count):
    return f"{count / 1e6:.2f} M" if count >= 1e6 else f"{count / 1e3:.0f} k" if count >= 1e4 else str(count)

def main(program, work, small=None):
    os.makedirs(work, exist_ok=True)
    graph = os.path.join(work, "skips.ron")
    with open(graph, "w") as file:
        file.write(GRAPH.replace("splats: 120000, width_px: 160, height_px: 120", "splats: 4000, width_px: 40, height_px: 30")
                   .replace("samples: 16", "samples: 1") if small else GRAPH)
    grey(os.path.join(work, "grey.png"))
    print("| left out | counted | done all the same | left out | CPU of that |\n|---|---|---|---|---|")
    # What every row begins with.
    base = os.path.join(work, "base")
    run(program, graph, "demo", base, [])
    for what, node, forced, spared, above, count in ROWS:
        sides = list(zip([forced, spared], above if isinstance(above, list) else [above, above]))
        known = [os.path.join(work, f"known{side}") for side in (0, 1)]
        for folder, (settings, nodes) in zip(known, sides):
            shutil.rmtree(folder, ignore_errors=True)
            shutil.copytree(base, folder)
            run(program, graph, nodes, folder, settings)
        counts, seconds = [0, 0], [[], []]
        for turn in range(2 if small else 6):
            side = (turn + turn // 2) % 2
            folder = os.path.join(work, "cache")
            shutil.rmtree(folder, ignore_errors=True)
            shutil.copytree(known[side], folder)
            told, cpu = run(program, graph, node, folder, sides[side][0])
            counts[side] = told.get(count, 0)
            seconds[side].append(cpu)
        most, least = map(min, seconds)
        print(f"| {what} | `{count}` | {short(counts[0])} | {short(counts[1])} | {least / most:.2f} of {most:.2f} s |")

if __name__ == "__main__":
    main(*sys.argv[1:])
