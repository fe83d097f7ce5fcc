#!/usr/bin/env python3
"""What a unit of each count costs: CPU-seconds of single nodes over settings, fitted by their counts.

usage: weights.py LIGHTHARMONY WORK [small]    prints the table of docs/evidence/trade.md; WORK is a folder to fill; `small` only
tries it: few splats, small pictures, one round over two settings

Each node runs in a process of its own on one thread, in a cache that holds what is above it; the CPU time of the same
call once the node is known is taken off. What is left is its code and storing what it made. Least squares of relative
errors, weights of at least 0, over all kinds that share counts. The least of two rounds counts.
"""
import json, os, resource, shutil, subprocess, sys

GRAPH = """Graph(
    version: 1, scene: (up: "+z", seed: 7),
    nodes: (
        demo:   DemoScene(place: Room, splats: 120000, width_px: 400, height_px: 300),
        pose:   Pose(translation: (-0.02, -0.06, 0.44), yaw_deg: -24.0, scale: 1.2),
        placed: Place(object: "demo.object", pose: "pose"),
        probe:  CubeRig(at: "pose", height_metres: 0.3, size_px: 256),
        faces:  SplatRender(splats: "demo.splats", rig: "probe"),
        pano:   Stitch(views: "faces", width_px: 512),
        around: SplatPanorama(splats: "demo.splats", at: "pose", height_metres: 0.3, width_px: 512),
        dark:   PredictExposure(pano: "pano", evs: [-6.0, -3.0], method: Learned),
        env:    FuseHdr(base: "pano", brackets: "dark"),
        view:   SplatRender(splats: "demo.splats", rig: "demo.rig"),
        trace:  PathTrace(receiver: "demo.proxy", objects: ["placed"], rig: "demo.rig", env: "env", samples: 4,
                          surroundings: Within(metres: 1.1)),
        clean:  Denoise(without: "trace.without", with: "trace.with", object: "trace.object",
                        depth: "trace.depth", normal: "trace.normal", variance: "trace.variance"),
        shadow: ShadowRatio(without: "clean.without", with: "clean.with"),
        final:  Composite(background: "view", object: "clean.object", shadow: "shadow"),
    ),
)
"""
ORDER = ["faces", "around", "pano", "dark", "env", "view", "trace", "clean", "shadow", "final"]
# Every row is measured from the first node that it changes on.
ROWS = [
    {},
    {"probe.size_px": 512, "pano.width_px": 1024, "view.alpha_cut": 0.0005, "trace.samples": 8, "clean.radius_px": 5,
     "around.width_px": 1024},
    {"probe.size_px": 1024, "pano.width_px": 2048, "view.alpha_cut": 0.03, "trace.max_bounces": 2, "clean.radius_px": 3,
     "around.supersample": 4},
    {"faces.precision": "F64", "view.precision": "F64", "trace.samples": 16, "clean.radius_px": 9,
     "around.precision": "F64"},
    {"faces.alpha_cut": 0.02, "view.stop": 0.01, "trace.max_bounces": 0, "clean.radius_px": 11,
     "around.alpha_cut": 0.02},
]
# Counts that are fitted together, and the kinds that have them.
GROUPS = [
    (["rays"], ["path-trace"]),
    (["splats_visited", "splat_tile_pairs", "splat_evaluations", "splat_evaluations_f64"],
     ["splat-render", "splat-panorama"]),
    (["directions"], ["stitch"]),
    (["pixels"], ["predict-exposure", "fuse-hdr"]),
    (["taps"], ["denoise"]),
]

def cpu(command):
    """CPU-seconds of a process, and its output."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run(command, capture_output=True, text=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    if done.returncode:
        sys.exit(f"{' '.join(command)}: {done.stderr}")
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime, done.stdout

def fit(rows):
    """Weights of at least 0 for rows of (values, target), least squares of relative errors."""
    scale = [max(values[k] / target for values, target in rows) or 1.0 for k in range(len(rows[0][0]))]
    rows = [[v / s / target for v, s in zip(values, scale)] for values, target in rows]
    weights = [0.0] * len(scale)
    for _ in range(20000):
        for k in range(len(scale)):
            square = sum(row[k] ** 2 for row in rows)
            rest = sum(row[k] * (1.0 - sum(w * v for w, v in zip(weights, row))) for row in rows)
            weights[k] = max(0.0, weights[k] + rest / square) if square else 0.0
    return [w / s for w, s in zip(weights, scale)]

def measure(program, work, small):
    """(kind, CPU-seconds, counts) of every node at every row, the least of two rounds."""
    graph = os.path.join(work, "weights.ron")
    with open(graph, "w") as file:
        file.write(GRAPH.replace("splats: 120000, width_px: 400, height_px: 300", "splats: 4000, width_px: 80, height_px: 60, truth_width_px: 32") if small else GRAPH)
    base = os.path.join(work, "base")
    call = [program, "run", graph, "--jobs", "1", "--json"]
    cpu(call + ["--cache", base, "--only", "demo"])
    found = {}
    for _ in range(1 if small else 2):
        for number, row in enumerate(ROWS[::3] if small else ROWS):
            folder = os.path.join(work, f"row{number}")
            shutil.rmtree(folder, ignore_errors=True)
            shutil.copytree(base, folder)
            sets = [word for field, value in row.items() for word in ("--set", f"{field}={value}")]
            for node in ORDER:
                seconds, told = cpu(call + ["--cache", folder, "--only", node] + sets)
                events = [json.loads(line) for line in told.splitlines()]
                event = next(e for e in events if e["event"] == "node" and e["id"] == node)
                if event["state"] == "ran":
                    seconds -= cpu(call + ["--cache", folder, "--only", node] + sets)[0]
                    old = found.get((number, node), (None, seconds, None))[1]
                    found[number, node] = event["kind"], min(seconds, old), event["counts"]
    return list(found.values())

def main(program, work, small=None):
    os.makedirs(work, exist_ok=True)
    found = measure(program, work, small)
    print("| count | ns of CPU per unit | in rays | fitted on | predicted over measured |\n|---|---|---|---|---|")
    ray = None
    for names, kinds in GROUPS:
        rows = [(kind, [float(counts.get(name, 0)) for name in names], seconds)
                for kind, seconds, counts in found if kind in kinds]
        weights = fit([row[1:] for row in rows])
        ray = ray or weights[0]
        spread = []
        for kind in kinds:
            off = [sum(w * v for w, v in zip(weights, values)) / seconds for of, values, seconds in rows if of == kind]
            spread.append(f"{kind} {min(off):.2f} to {max(off):.2f}")
        for name, weight in zip(names, weights):
            print(f"| `{name}` | {weight * 1e9:.3g} | {weight / ray:.2g} | {len(rows)} runs | {', '.join(spread)} |")
    bare = [f"{kind} {seconds:.3f} s" for kind, seconds, counts in found if not counts]
    print(f"\nWithout counts, at 400x300: {', '.join(sorted(bare)[::5])}.")

if __name__ == "__main__":
    main(*sys.argv[1:])
