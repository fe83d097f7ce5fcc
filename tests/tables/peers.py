#!/usr/bin/env python3
"""Light transport compared with Mitsuba and Cycles: the same scene, alternating, on one machine.

usage: peers.py --peers FOLDER --python PYTHON [--data DIR] [--rounds N] [--threads N] [--work DIR]

FOLDER has mitsuba_render.py and cycles_render.py; PYTHON is one with mitsuba, bpy, OpenEXR, numpy and trimesh (DRJIT_LIBLLVM_PATH
must name libLLVM for Mitsuba). DIR is ../shared/data by default. A round runs Mitsuba, ours, Cycles and ours again, each as a fresh
process; five rounds or more. Theirs run on two threads (Mitsuba 3.9 never ends with one). Seconds are CPU seconds: ours of one thread as the bench `trace` prints them, theirs of
their own clocks. Ratios are of the runs of one round, so of one state of the machine; printed are medians, least and most.
"""
import argparse, glob, json, os, statistics, subprocess, sys

HERE = os.path.dirname(os.path.abspath(__file__))
ROOT = os.path.abspath(os.path.join(HERE, "../.."))
# Samples of ours; of Mitsuba; of Cycles' catcher.
OURS, MITSUBA, CYCLES = [2, 4, 7, 8], 64, [4, 16]
# The error of the receiver alone that is to be reached.
ERROR = 1.9e-4

def run(command, env=None):
    done = subprocess.run(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, env=env)
    if done.returncode:
        sys.exit(f"{' '.join(command)} ended with {done.returncode}")
    return done.stdout

def lines(text):
    return [json.loads(line) for line in text.split("\n") if line.startswith("{")]

def bench():
    """The program of the bench, compiled."""
    build = ["cargo", "bench", "-p", "lightharmony-testkit", "--bench", "trace", "--no-run", "--message-format", "json"]
    told = subprocess.run(build, cwd=ROOT, stdout=subprocess.PIPE, text=True, check=True).stdout
    made = [line for line in map(json.loads, told.split("\n")[:-1]) if line.get("executable") and line["target"]["name"] == "trace"]
    return made[-1]["executable"]

def spread(values, digits=3):
    return f"{statistics.median(values):.{digits}f}, {min(values):.{digits}f} to {max(values):.{digits}f}"

def main():
    parse = argparse.ArgumentParser(usage=__doc__)
    parse.add_argument("--peers", required=True)
    parse.add_argument("--python", required=True)
    parse.add_argument("--data", default=os.path.join(ROOT, "../shared/data"))
    parse.add_argument("--rounds", type=int, default=5)
    parse.add_argument("--threads", type=int, default=2)
    parse.add_argument("--work", required=True)
    parse.add_argument("--bench")
    asked = parse.parse_args()
    if os.path.realpath(sys.executable) != os.path.realpath(asked.python) or "numpy" not in sys.modules:
        # Pictures are read by the Python of the peers, too.
        try:
            import numpy, OpenEXR
        except ImportError:
            os.execv(asked.python, [asked.python] + sys.argv)
    import numpy as np, OpenEXR
    program, scene = asked.bench or bench(), os.path.join(asked.data, "render-refs/sunny_plane")
    work = lambda name: os.path.join(asked.work, name)

    def exr(path, names="RGB"):
        with OpenEXR.File(path, separate_channels=True) as file:
            planes = {name: np.array(plane.pixels) for name, plane in file.channels().items()}
        return np.stack([planes[name] for name in names], -1).astype(np.float64)

    truth = {name: exr(os.path.join(scene, "ref-cycles", name + ".exr")) for name in ("R0", "R1")}
    cover = exr(os.path.join(scene, "ref-cycles/O.exr"), "A")[..., 0]
    mitsuba = exr(os.path.join(scene, "ref-mitsuba/R0.exr"))
    shape = truth["R0"].shape
    raw = lambda name: np.fromfile(work(name), dtype="<f4").astype(np.float64).reshape(shape)
    relative = lambda a: float((((a - mitsuba) ** 2) / (mitsuba ** 2 + 0.01)).mean())
    s_of = lambda without, with_: np.minimum(np.where(without > 0, with_ / np.where(without > 0, without, 1), 1), 1)
    s_truth, lit = s_of(truth["R0"], truth["R1"]), truth["R0"] > 0.02

    def s_errors(s):
        """Of S where the object covers nothing, and where it covers a part."""
        off = (np.minimum(s, 1) - s_truth) ** 2
        of = lambda where: float(np.sqrt(off[lit & where[..., None]].mean()))
        return of(cover == 0), of((cover > 0) & (cover < 1))

    def ours(numbers):
        told = lines(run([program, "--bench", asked.data, "peers", asked.work, *map(str, numbers)]))
        return {line["samples"]: line for line in told}

    def by_mitsuba():
        out = run([asked.python, os.path.join(asked.peers, "mitsuba_render.py"), os.path.join(scene, "scene.json"), "--out", asked.work,
                   "--spp", str(MITSUBA), "--sampler", "multijitter", "--passes", "R0", "--repeat", "2", "--threads", str(asked.threads)])
        return json.loads(out.split("RESULT ")[1])["cpu_seconds"]["R0"]

    def by_cycles():
        out = run([asked.python, os.path.join(HERE, "cycles_catcher.py"), os.path.join(asked.peers, "cycles_render.py"),
                   os.path.join(scene, "scene.json"), asked.work, *map(str, CYCLES)], dict(os.environ, THREADS=str(asked.threads)))
        return {line["samples"]: line for line in lines(out)}

    os.makedirs(asked.work, exist_ok=True)
    rounds = []
    for _ in range(max(asked.rounds, 5)):
        first = by_mitsuba()
        mine = ours(OURS)
        theirs = by_cycles()
        rounds.append((first, mine, theirs, ours(OURS)))
        print(f"round {len(rounds)}: load {os.getloadavg()[0]:.1f}", file=sys.stderr)

    both = lambda n, what: [what(mine[n]) for _, a, _, b in rounds for mine in (a, b)]
    error = {n: relative(raw(f"without-{n}")) for n in OURS}
    reaches = min((n for n in OURS if error[n] <= ERROR), default=None)
    print(f"Receiver alone, {asked.threads} thread{'s' if asked.threads > 1 else ''} of Mitsuba.\n")
    print("| program, samples | error | CPU-s: median, least to most | Mitsuba's over it |\n|---|---|---|---|")
    print(f"| Mitsuba, multijitter, {MITSUBA} | {relative(exr(work('R0.exr'))):.1e} | {spread([r[0] for r in rounds])} | 1 |")
    for n in sorted({reaches, *OURS[1:]} - {None}):
        ratio = [r[0] / ((r[1][n]["without"] + r[3][n]["without"]) / 2) for r in rounds]
        print(f"| ours, {n} | {error[n]:.1e} | {spread(both(n, lambda m: m['without']))} | {spread(ratio, 2)} |")
    print(f"\nS after a new yaw, {asked.threads} thread{'s' if asked.threads > 1 else ''} of Cycles.\n")
    print("| program, samples | S, its rim | CPU-s, whole | beyond start-up | the same over ours at 2 |\n|---|---|---|---|---|")
    turn = lambda m: m["objects"] + m["filter"]
    for n in CYCLES:
        s = s_errors(np.load(work(f"S-{n}.npy")).astype(np.float64))
        render = [r[2][n]["render"] for r in rounds]
        ratio = [r[2][n]["render"] / ((turn(r[1][2]) + turn(r[3][2])) / 2) for r in rounds]
        print(f"| Cycles' catcher, denoised, {n} | {s[0]:.4f}, {s[1]:.4f} | {spread([r[2][n]['whole'] for r in rounds], 2)} | {spread(render)} | {spread(ratio, 2)} |")
    two = lambda m: sum(m[k] for k in ("setup", "without", "objects", "filter"))
    for n in OURS:
        s = s_errors(s_of(raw(f"clean-without-{n}"), raw(f"clean-with-{n}")))
        plain = s_errors(s_of(raw(f"without-{n}"), raw(f"with-{n}")))
        print(f"| ours, denoised, {n} (raw {plain[0]:.4f}, {plain[1]:.4f}) | {s[0]:.4f}, {s[1]:.4f} | {spread(both(n, two))} | {spread(both(n, turn))}, "
              f"of which S alone {statistics.median(both(n, lambda m: m['shadow'])):.3f} and the filter {statistics.median(both(n, lambda m: m['filter'])):.3f} | |")

if __name__ == "__main__":
    main()
