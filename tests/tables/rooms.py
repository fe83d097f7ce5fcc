#!/usr/bin/env python3
"""Rooms that a window lights, by Mitsuba and by ours: CPU seconds to a given error of the receiver alone (R0).

usage: rooms.py --peers FOLDER --python PYTHON --program LIGHTHARMONY [LIGHTHARMONY ..] --work DIR [--data DIR] [--rooms NAME ..]
                [--rounds N] [--samples N ..] [--truth N]

FOLDER has mitsuba_render.py; PYTHON is one with mitsuba, OpenEXR, numpy and trimesh (DRJIT_LIBLLVM_PATH must name libLLVM for
Mitsuba). DIR is filled with the rooms, in the format of render-refs; rooms that are there are kept. A round runs Mitsuba and each
program in turn, at each number of samples. Seconds are CPU seconds: of Mitsuba for the second picture of a process (compiled, two
threads), of ours for a whole process on one thread, less that of the same process for a picture of one pixel. Errors are mean square
errors relative to the reference squared plus 0.01. The reference is the mean of both programs at many samples, whose difference is
printed. Seconds to the error are interpolated between numbers of samples, in logarithms.
"""
import argparse, json, os, resource, shutil, statistics, subprocess, sys

HERE = os.path.dirname(os.path.abspath(__file__))
ROOT = os.path.abspath(os.path.join(HERE, "../.."))
ERROR = 1.5e-3
# Environment, columns by which it is turned, factor, and whether the room has a shaft in the ceiling, above which a lamp hangs.
ROOMS = {
    "window_lamp": ("rooitou_park_1k.hdr", -0.04, 8.0, True),
    "window": ("kiara_1_dawn_1k.hdr", 0.1, 60.0, False),
}
SIZE = (192, 144)

def surface(origin, u, v, step, colour, holes=()):
    """A rectangle of squares, without those whose middle is in a hole (in units of length along u and v)."""
    import numpy as np
    u, v, origin = (np.array(a, float) for a in (u, v, origin))
    counts = [max(1, round(np.linalg.norm(a) / step)) for a in (u, v)]
    at = lambda i, j: origin + u * (i / counts[0]) + v * (j / counts[1])
    points = np.array([at(i, j) for j in range(counts[1] + 1) for i in range(counts[0] + 1)])
    faces = []
    for j in range(counts[1]):
        for i in range(counts[0]):
            a, b = (i + 0.5) / counts[0] * np.linalg.norm(u), (j + 0.5) / counts[1] * np.linalg.norm(v)
            if any(l <= a <= h and m <= b <= k for l, h, m, k in holes):
                continue
            k = j * (counts[0] + 1) + i
            faces += [[k, k + 1, k + counts[0] + 2], [k, k + counts[0] + 2, k + counts[0] + 1]]
    odd = (np.arange(len(points)) % 7 == 3)[:, None] * 0.08
    return points, np.array(faces), np.clip(np.array(colour) - odd, 0, 1).repeat(1, 0) * np.ones((len(points), 1))

def block(low, high, step, colour):
    """The six sides of a box, seen from outside."""
    (a, b, c), (x, y, z) = low, high
    dx, dy, dz = (x - a, 0, 0), (0, y - b, 0), (0, 0, z - c)
    sides = [((a, b, c), dz, dx), ((a, y, c), dx, dz), ((a, b, c), dx, dy), ((a, b, z), dy, dx), ((a, b, c), dy, dz), ((x, b, c), dz, dy)]
    return [surface(*side, step, colour) for side in sides]

def room(folder, data, name):
    """Writes the mesh, the environment and scene.json of a room of 4 by 3 by 6 m; the window is in the wall at z = -3."""
    import mitsuba, numpy as np, OpenEXR, trimesh
    mitsuba.set_variant("scalar_rgb")
    file, turn, factor, shaft = ROOMS[name]
    parts = [
        surface((-2, 0, -3), (0, 0, 6), (4, 0, 0), 0.2, (0.66, 0.55, 0.45)),
        surface((-2, 3, -3), (4, 0, 0), (0, 0, 6), 0.1, (0.9, 0.9, 0.88), [(1.8, 2.2, 3.8, 4.2)] if shaft else []),
        surface((-2, 0, -3), (4, 0, 0), (0, 3, 0), 0.1, (0.85, 0.83, 0.8), [(1.0, 2.8, 0.9, 2.4)]),
        surface((2, 0, 3), (-4, 0, 0), (0, 3, 0), 0.2, (0.85, 0.83, 0.8)),
        surface((-2, 0, 3), (0, 0, -6), (0, 3, 0), 0.2, (0.85, 0.6, 0.55)),
        surface((2, 0, -3), (0, 0, 6), (0, 3, 0), 0.2, (0.6, 0.75, 0.85)),
    ]
    parts += block((-0.6, 0.7, -0.6), (0.8, 0.75, 0.5), 0.1, (0.6, 0.42, 0.3))
    for x, z in [(-0.55, -0.55), (0.69, -0.55), (-0.55, 0.39), (0.69, 0.39)]:
        parts += block((x, 0, z), (x + 0.06, 0.7, z + 0.06), 0.1, (0.6, 0.42, 0.3))
    parts += block((1.4, 0, 0.6), (1.98, 2.0, 2.2), 0.2, (0.75, 0.7, 0.62))
    parts += block((-1.9, 0, -2.2), (-1.2, 0.5, -0.4), 0.1, (0.45, 0.5, 0.65))
    for (x, y, z), r, colour in [((0.1, 0.95, 0), 0.2, (0.85, 0.3, 0.2)), ((-0.9, 0.35, 1.0), 0.35, (0.4, 0.7, 0.4)), ((1.0, 0.3, -1.6), 0.3, (0.8, 0.8, 0.8))]:
        ball = trimesh.creation.icosphere(subdivisions=4, radius=r)
        parts.append((ball.vertices + [x, y, z], ball.faces, np.array(colour) * np.ones((len(ball.vertices), 1))))
    first = np.cumsum([0] + [len(p) for p, _, _ in parts])
    points = np.concatenate([p for p, _, _ in parts])
    faces = np.concatenate([f + k for (_, f, _), k in zip(parts, first)])
    colours = np.round(255 * np.concatenate([c for _, _, c in parts])).astype(np.uint8)
    os.makedirs(folder, exist_ok=True)
    trimesh.Trimesh(points, faces, vertex_colors=np.hstack([colours, np.full((len(colours), 1), 255, np.uint8)]), process=False).export(
        os.path.join(folder, "receiver.ply"))
    sky = np.array(mitsuba.Bitmap(os.path.join(data, "hdri", file)), np.float32)[..., :3]
    sky = np.roll(sky, round(turn * sky.shape[1]), 1) * np.float32(factor)
    if shaft:
        # A lamp of 10 degrees, straight above.
        sky[: sky.shape[0] // 36] = np.float32([400, 330, 250])
    with_names = {"RGB"[k]: np.ascontiguousarray(sky[..., k]) for k in range(3)}
    OpenEXR.File({"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}, with_names).write(os.path.join(folder, "env.exr"))
    eye, at = np.array([-1.5, 1.7, 2.6]), np.array([0.4, 0.7, -1.0])
    forward = (at - eye) / np.linalg.norm(at - eye)
    right = np.cross(forward, [0, 1, 0]); right /= np.linalg.norm(right)
    pose = np.eye(4); pose[:3, :4] = np.stack([right, np.cross(forward, right), forward, eye], 1)
    width, height = SIZE
    camera = {"width": width, "height": height, "fx": 130.0, "fy": 130.0, "cx": width / 2, "cy": height / 2, "c2w": pose.tolist()}
    with open(os.path.join(folder, "scene.json"), "w") as out:
        json.dump({"name": name, "receiver": "receiver.ply", "receiver_color_space": "srgb", "env": "env.exr", "env_scale": 1.0,
                   "max_bounces": 8, "camera": camera}, out, indent=1)

def graph(folder):
    """The graph of a room, with the rig of its camera and that of one pixel."""
    with open(os.path.join(folder, "scene.json")) as file:
        scene = json.load(file)
    c = scene["camera"]
    view = {"name": "view", "w": c["width"], "h": c["height"], "c2w_opencv": c["c2w"], **{k: c[k] for k in ["fx", "fy", "cx", "cy"]}}
    dot = {**view, "w": 1, "h": 1, "cx": 0.5, "cy": 0.5}
    for name, one in [("rig", view), ("dot", dot)]:
        with open(os.path.join(folder, name + ".json"), "w") as file:
            json.dump({"views": [one]}, file)
    with open(os.path.join(folder, "room.ron"), "w") as file:
        file.write("""Graph(version: 1, scene: (up: "+y", seed: 7), nodes: (
    rig: LoadCameras(path: "rig.json"), room: LoadMesh(path: "receiver.ply", colours: Srgb), env: LoadEnvironment(path: "env.exr"),
    trace: PathTrace(receiver: "room", rig: "rig", env: "env", samples: 16, surroundings: Open, objects: []),
    save: WriteExr(layers: ["trace.without"], path: "out.exr"), report: WriteReport(report: "trace.report", path: "out.json"),
))
""")

def main():
    parse = argparse.ArgumentParser(usage=__doc__)
    for name in ["--peers", "--python", "--work"]:
        parse.add_argument(name, required=True)
    parse.add_argument("--program", nargs="+", required=True)
    parse.add_argument("--data", default=os.path.join(ROOT, "../shared/data"))
    parse.add_argument("--rooms", nargs="+", default=list(ROOMS))
    parse.add_argument("--rounds", type=int, default=5)
    parse.add_argument("--samples", type=int, nargs="+", default=[16, 64])
    parse.add_argument("--mitsuba-samples", type=int, nargs="+", default=[64, 128])
    parse.add_argument("--truth", type=int, default=2048)
    asked = parse.parse_args()
    try:
        import numpy as np, OpenEXR
    except ImportError:
        os.execv(asked.python, [asked.python] + sys.argv)

    def exr(path, names="RGB"):
        with OpenEXR.File(path, separate_channels=True) as file:
            planes = {name.split(".")[-1]: np.array(plane.pixels) for name, plane in file.channels().items()}
        return np.stack([planes[name] for name in names], -1).astype(np.float64)

    def mitsuba(folder, samples, seed=0, tag="", repeat=2):
        out = subprocess.run([asked.python, os.path.join(asked.peers, "mitsuba_render.py"), os.path.join(folder, "scene.json"), "--out",
                              folder, "--spp", str(samples), "--seed", str(seed), "--sampler", "multijitter", "--passes", "R0", f"--tag={tag}",
                              "--repeat", str(repeat), "--threads", "2"], stdout=subprocess.PIPE, text=True, check=True).stdout
        return json.loads(out.split("RESULT ")[1])["cpu_seconds"]["R0"], exr(os.path.join(folder, f"R0{tag}.exr"))

    def ours(program, folder, samples, seed=7, rig="rig.json"):
        out = os.path.join(folder, "run")
        shutil.rmtree(out, ignore_errors=True)
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        done = subprocess.run([program, "run", os.path.join(folder, "room.ron"), "--jobs", "1", "--cache", os.path.join(out, "cache"), "--out",
                               out, f"--set=trace.samples={samples}", f"--set=scene.seed={seed}", f'--set=rig.path="{rig}"'],
                              stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
        if done.returncode not in (0, 3):
            sys.exit(done.stderr)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        seconds = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
        return seconds, exr(os.path.join(out, "out.exr"))

    spread = lambda values, digits=2: f"{statistics.median(values):.{digits}f}, {min(values):.{digits}f} to {max(values):.{digits}f}"
    for name in asked.rooms:
        folder = os.path.join(os.path.abspath(asked.work), name)
        if not os.path.exists(os.path.join(folder, "scene.json")):
            room(folder, asked.data, name)
        graph(folder)
        kept = os.path.join(folder, f"truth-{asked.truth}.npz")
        if not os.path.exists(kept):
            theirs = mitsuba(folder, asked.truth, 99, "truth", 1)[1]
            mine = ours(asked.program[0], folder, asked.truth // 2, 99)[1]
            np.savez(kept, theirs=theirs, mine=mine)
        pair = np.load(kept)
        theirs, mine = pair["theirs"], pair["mine"]
        truth = 0.5 * (theirs + mine)
        relative = lambda a: float((((a - truth) ** 2) / (truth ** 2 + 0.01)).mean())
        print(f"{name}: mean {truth.mean():.3f}, median {np.median(truth):.3f}; ours over theirs {mine.mean() / theirs.mean():.4f}; "
              f"relMSE of the two references {float(((mine - theirs) ** 2 / (truth ** 2 + 0.01)).mean()):.1e}", flush=True)
        rows, ratios = {}, []
        for k in range(asked.rounds):
            seconds = {}
            for n in asked.mitsuba_samples:
                cpu, picture = mitsuba(folder, n, k)
                rows.setdefault(("Mitsuba", n), []).append((cpu, relative(picture)))
            for program in asked.program:
                start = ours(program, folder, 1, 7 + k, "dot.json")[0]
                for n in asked.samples:
                    cpu, picture = ours(program, folder, n, 7 + k)
                    rows.setdefault((program, n), []).append((cpu - start, relative(picture)))
        def to_error(who, k):
            points = sorted((n, *runs[k]) for (w, n), runs in rows.items() if w == who)
            (_, c0, e0), (_, c1, e1) = points[0], points[-1]
            slope = np.log(e1 / e0) / np.log(c1 / c0)
            return float(np.exp(np.log(c0) + np.log(ERROR / e0) / slope))
        print("| program, samples | CPU-s: median, least to most | error |\n|---|---|---|")
        for (who, n), runs in rows.items():
            print(f"| {os.path.basename(who)}, {n} | {spread([c for c, _ in runs])} | {statistics.median([e for _, e in runs]):.2e} |")
        for who in ["Mitsuba", *asked.program]:
            times = [to_error(who, k) for k in range(asked.rounds)]
            over = [t / to_error("Mitsuba", k) for k, t in enumerate(times)]
            print(f"{os.path.basename(who)} to {ERROR}: {spread(times)} CPU-s; over Mitsuba {spread(over)}", flush=True)

if __name__ == "__main__":
    main()
