#!/usr/bin/env python3
"""Makes the tables of the docs anew.

usage: make.py [--data DIR] [--work DIR] [NAME..]      default: ../shared/data, a new folder, all for which all is there
       make.py --list                                  what there is, what it takes and needs

The program is that of target/release, or of LIGHTHARMONY.

Every command prints markdown tables; each takes the place of the table in the page that has the same first row, of
several those in their order, and gets a line that says by which command and at which commit. Text around them is not
touched: read it again. Deterministic counts are not made here but guarded by tests (tests/tables/counts.tsv,
which UPDATE_GOLDEN=1 cargo test --release renews).
"""
import argparse, json, math, os, re, resource, shutil, subprocess, sys, tempfile

ROOT = os.path.abspath(os.path.join(os.path.dirname(__file__), "../.."))
HERE = "tests/tables"
PROGRAM = os.environ.get("LIGHTHARMONY", os.path.join(ROOT, "target/release/lightharmony"))
PRESETS = ["draft", "preview", "final", "reference"]
# What is made bad in bad.ron, and the node that is to be named.
BAD = [
    ("probe of 8 px", "0.3, size_px: 64", "0.3, size_px: 8", "probe"),
    ("harmonics left out", '"demo.rig", alpha_cut: 0.002, sh_degree: 4', '"demo.rig", alpha_cut: 0.002, sh_degree: 0', "view"),
    ("1 sample", 'env: "env", samples: 16', 'env: "env", samples: 1', "trace"),
    ("clipped light not predicted", "-3.0], method: Region", "-3.0], method: Skip", "dark"),
    ("receiver cut in half", "Some((1.5, 1.5, 9.0))),\n        trace", "Some((-0.2, 9.0, 9.0))),\n        trace", "floor"),
]

def call(*command, **more):
    """What a command prints; ends all where it fails."""
    done = subprocess.run(command, cwd=ROOT, stdout=subprocess.PIPE, text=True, **more)
    if done.returncode:
        sys.exit(f"{' '.join(command)} ended with {done.returncode}")
    return done.stdout

def short(value):
    return f"{value:.2g}" if value < 0.1 else f"{value:.3g}"

def report(graph, cache, page, *more):
    command = [PROGRAM, "report", graph, "--cache", cache, "--out", page, "--json", *more]
    return json.loads(call(*command, stderr=subprocess.DEVNULL))

def presets(work):
    """Work, CPU time of a cold run and error by region of each preset, and the plots."""
    text = ""
    for name in ["demo", "plaza"]:
        graph, page = f"{HERE}/{name}.ron", os.path.join(work, f"{name}.html")
        # The reverse would take a run at the reference for each node.
        told = report(graph, os.path.join(work, "cache"), page, "--no-reverse")
        with open(page) as file:
            svg = re.search(r"<svg.*?</svg>", file.read(), re.S).group(0)
        style = ("<style>text{font-family:sans-serif}.frame{fill:#fff;stroke:#999}.grid{stroke:#eee}.tick{font-size:11px;"
                 "fill:#555}.axis{font-size:12px}.front{fill:none;stroke:#1668b8;stroke-width:1.5}.dot{fill:#bbb}"
                 ".dot.on{fill:#1668b8}.name{font-size:11px}</style>")
        head = re.match(r"<svg[^>]*>", svg).group(0)
        svg = svg.replace(head, head[:-1] + ' xmlns="http://www.w3.org/2000/svg">' + style, 1)
        with open(os.path.join(ROOT, f"docs/trade-{name}.svg"), "w") as file:
            file.write(svg + "\n")
        text += f"| {name} | CPU-s | work | FLIP, whole | FLIP, touched | RMSE, whole | RMSE, touched |\n|---|---|---|---|---|---|---|\n"
        for preset in PRESETS:
            point = next(p for p in told["points"] if p["setting"] == preset)
            folder = os.path.join(work, "cold")
            shutil.rmtree(folder, ignore_errors=True)
            before = resource.getrusage(resource.RUSAGE_CHILDREN)
            call(PROGRAM, "run", graph, "--preset", preset, "--cache", folder, "--out", folder, stderr=subprocess.DEVNULL)
            after = resource.getrusage(resource.RUSAGE_CHILDREN)
            cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
            def worst(region, column):
                # Equal pictures have no finite PSNR, which JSON tells as the text `inf`.
                values = [float(row["values"][column]) for row in point["off"]
                          if row["picture"] == "image" and row["region"] == region]
                return short(max(10 ** (-v / 20) if "psnr" in column else v for v in values))
            cells = [worst(region, column) for column in ["flip mean", "psnr (dB)"] for region in ["whole", "touched"]]
            text += f"| `{preset}` | {cpu:.1f} | {point['work'] / 1e6:.2f} M | {' | '.join(cells)} |\n"
        text += "\n"
    return text

def bad(work):
    """Which node is named, and what `tune` finds."""
    with open(os.path.join(ROOT, HERE, "bad.ron")) as file:
        good = file.read()
    text = ("| made bad | error | named | its own error | the next one's | left with it repaired | `tune` to 0.02: cost | "
            "of the cheapest preset |\n|---|---|---|---|---|---|---|---|\n")
    for what, before, after, node in [("nothing", "", "", None)] + BAD:
        graph = os.path.join(work, "bad.ron")
        with open(graph, "w") as file:
            file.write(good.replace(before, after) if before else good)
        cache = os.path.join(work, "cache")
        told = report(graph, cache, os.path.join(work, "bad.html"))
        now = next(p for p in told["points"] if p["as_it_is"])
        worst, second = told["attribution"][:2]
        tuned = json.loads(call(PROGRAM, "tune", graph, "--max-error", "flip=0.02", "--cache", cache, "--json", "-o",
                                os.path.join(work, "tuned.ron"), stderr=subprocess.DEVNULL))
        best = next(p for p in tuned["measured"] if p["best"])
        naive = min((p for p in tuned["measured"] if p["setting"] in PRESETS and p["error"] <= 0.02), key=lambda p: p["work"])
        own = "error_with_all_else_at_the_reference"
        text += (f"| {what} | {now['error']:.4f} | `{worst['node']}` | {worst[own]:.4f} | `{second['node']}` {second[own]:.4f} | "
                 f"{worst['error_with_it_alone_at_the_reference']:.4f} | {best['work'] / 1e3:.0f} k | "
                 f"{best['work'] / naive['work']:.2f} of `{naive['setting']}` |\n")
        if node not in (None, worst["node"]):
            print(f"{what}: `{worst['node']}` is named and not `{node}`", file=sys.stderr)
    return text

# Graphs and the errors asked of them, which lie between those of their presets.
TUNED = [("demo", ["flip=0.02", "flip=0.012", "flip=0.008", "touched.flip=0.05"]),
         ("plaza", ["flip=0.012", "flip=0.008", "flip=0.0055", "touched.flip=0.05"]),
         ("real", ["flip=0.02", "flip=0.012", "flip=0.008", "touched.flip=0.05"]),
         ("bad", ["flip=0.03", "flip=0.02", "flip=0.012", "flip=0.008"])]

def tune(work):
    """What `tune` finds for an error, beside the cheapest preset that reaches it."""
    text = ("| graph | error asked for | cheapest preset: work, error | tuned: work, error | of the preset's work | settings measured |\n"
            "|---|---|---|---|---|---|\n")
    for name, bounds in TUNED:
        graph, cache, overlay = f"{HERE}/{name}.ron", os.path.join(work, f"tune-{name}"), os.path.join(work, "tuned.ron")
        for bound in bounds:
            told = json.loads(call(PROGRAM, "tune", graph, "--max-error", bound, "--cache", cache, "--json", "-o", overlay,
                                   stderr=subprocess.DEVNULL))
            if not told["finished"]:
                print(f"{name} {bound}: {told['ended']}", file=sys.stderr)
            best = next(p for p in told["measured"] if p["best"])
            most = float(bound.split("=")[1])
            naive = min((p for p in told["measured"] if p["setting"] in PRESETS and p["error"] <= most), key=lambda p: p["work"])
            # The overlay gives these pictures in a cache that knows nothing, too.
            pictures = []
            for known in [cache, os.path.join(work, "fresh")]:
                out = os.path.join(work, "pictures")
                shutil.rmtree(out, ignore_errors=True)
                call(PROGRAM, "run", graph, "--overlay", overlay, "--cache", known, "--out", out, stderr=subprocess.DEVNULL)
                pictures.append([open(os.path.join(out, file), "rb").read() for file in sorted(os.listdir(out))])
            shutil.rmtree(os.path.join(work, "fresh"))
            if pictures[0] != pictures[1]:
                sys.exit(f"{name} {bound}: the overlay gives other pictures when it is run afresh")
            ratio, half, why = best["work"] / naive["work"], told["below_half"], ""
            if ratio >= 0.5 and half:
                why = (f"; none of {'all ' if half['complete'] else 'the first '}{half['settings']} below half reaches it, least error {half['least_error']:.4f}" if half["settings"]
                       else f"; none is below half, the least is {half['least_cost'] / naive['work']:.2f}")
            text += (f"| {name} | {bound} | `{naive['setting']}`: {naive['work'] / 1e6:.2f} M, {naive['error']:.4f} | "
                     f"{best['work'] / 1e6:.2f} M, {best['error']:.4f} | {ratio:.2f}{why} | {len(told['measured'])} |\n")
    return text

# CPU-seconds and errors of other programs on the sunny plane, measured on a machine of the same sort: the object by
# `cycles_render.py --passes O` at 1, 4, 16, 64 and 256 samples beside its own 1024.
CYCLES = {"without": [(1.81, .0939), (1.37, .0199), (1.74, .00135), (3.33, .000232), (9.59, .000054)],
          "S": [(3.9, .0557), (4.0, .0223), (7.1, .0103)],
          "object": [(1.51, .0270), (1.55, .00667), (1.80, .00105), (2.42, .000224), (5.53, .000052)]}
CYCLES_DENOISED = {"without": [(1.69, .00108), (1.77, .000347), (2.06, .000136), (4.34, .000076)],
                   "S": [(4.1, .0117), (4.3, .0075), (7.5, .0053)],
                   "object": [(1.83, .00187), (1.90, .000964), (2.00, .00037), (2.62, .000162), (4.98, .0000712)]}
MITSUBA = {"without": [(.009, .0869), (.019, .0159), (.057, .0016), (.195, .000186), (.766, .00004)]}

def curves(text):
    """Error over CPU seconds of `without`, S and O as a drawing, from the tables of the bench."""
    def rows(head):
        table = next(lines for lines in ("\n".join(text.split("\n")[a:b]) for a, b in blocks(text.split("\n")))
                     if lines.startswith(head)).split("\n")[2:]
        return [[[float(v) for v in re.findall(r"[0-9.]+(?:e-?[0-9]+)?", cell)] for cell in row.strip("|").split("|")]
                for row in table]
    plane, ratio = rows("| samples | `without`: "), rows("| samples | `without`, ")
    panels = [
        ("without", "relative mean square", [("ours", [(r[1][0], r[1][1]) for r in plane]), ("Cycles", CYCLES["without"]),
                                            ("Cycles, denoised", CYCLES_DENOISED["without"]), ("Mitsuba", MITSUBA["without"])]),
        ("S", "root mean square", [("ours", [(r[1][0] + r[2][0], r[4][0]) for r in ratio]),
                                   ("ours, denoised", [(r[1][0] + r[2][0] + r[3][0], r[5][0]) for r in ratio]),
                                   ("ours, denoised, a turn", [(r[2][0] + r[3][0], r[5][0]) for r in ratio]),
                                   ("Cycles", CYCLES["S"]), ("Cycles, denoised", CYCLES_DENOISED["S"])]),
        ("object", "relative mean square", [("ours", [(r[2][0], r[6][0]) for r in ratio]),
                                            ("ours, denoised", [(r[2][0] + r[3][0], r[7][0]) for r in ratio]),
                                            ("Cycles", CYCLES["object"]), ("Cycles, denoised", CYCLES_DENOISED["object"])]),
    ]
    colours = {"ours": "#1668b8", "ours, denoised": "#0a8a5a", "ours, denoised, a turn": "#7a3fb0", "Cycles": "#c8641e",
               "Cycles, denoised": "#a33030", "Mitsuba": "#777"}
    svg = ['<svg viewBox="0 0 960 390" width="960" height="390" role="img" xmlns="http://www.w3.org/2000/svg">',
           '<style>text{font-family:sans-serif;font-size:11px}.t{fill:#555}</style>']
    for number, (name, unit, lines) in enumerate(panels):
        points = [point for _, line in lines for point in line]
        low, high = ([math.floor(math.log10(min(p[k] for p in points)) * 2) / 2 for k in (0, 1)],
                     [math.ceil(math.log10(max(p[k] for p in points)) * 2) / 2 for k in (0, 1)])
        left, top, wide, tall = 50 + 315 * number, 30, 255, 260
        at = lambda p: (left + wide * (math.log10(p[0]) - low[0]) / (high[0] - low[0]),
                        top + tall * (high[1] - math.log10(p[1])) / (high[1] - low[1]))
        svg.append(f'<rect x="{left}" y="{top}" width="{wide}" height="{tall}" fill="#fff" stroke="#999"/>')
        svg.append(f'<text x="{left}" y="18"><tspan font-weight="bold">{name}</tspan>, {unit} error over CPU-s</text>')
        for axis in (0, 1):
            for power in range(math.ceil(low[axis]), math.floor(high[axis]) + 1):
                x, y = at((10 ** power, 10 ** high[1]) if axis == 0 else (10 ** low[0], 10 ** power))
                path = f"M{x:.1f} {top}V{top + tall}" if axis == 0 else f"M{left} {y:.1f}H{left + wide}"
                place = f'x="{x:.1f}" y="{top + tall + 14}" text-anchor="middle"' if axis == 0 else f'x="{left - 4}" y="{y + 4:.1f}" text-anchor="end"'
                svg.append(f'<path d="{path}" stroke="#ddd"/><text {place} class="t">{10.0 ** power:g}</text>')
        for index, (who, line) in enumerate(lines):
            places = " ".join(f"{x:.1f},{y:.1f}" for x, y in map(at, line))
            dots = "".join(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="2.5" fill="{colours[who]}"/>' for x, y in map(at, line))
            svg.append(f'<polyline points="{places}" fill="none" stroke="{colours[who]}" stroke-width="1.5"/>{dots}'
                       f'<text x="{left + 4}" y="{top + tall + 32 + 14 * index}" fill="{colours[who]}">{who}</text>')
    with open(os.path.join(ROOT, "docs/trace.svg"), "w") as file:
        file.write("\n".join(svg + ["</svg>", ""]))
    return text

# Name: page, seeds or None, CPU-minutes, what it needs beside the program (below the data, or a command), and what makes
# its tables.
def tables(data, work):
    bench = ["cargo", "bench", "-q", "-p", "lightharmony-nodes", "--bench"]
    script = lambda name, *words: call("python3", f"{HERE}/{name}.py", PROGRAM, *words, os.path.join(work, name))
    return {
        "presets": ("docs/trade.md", "7 and 1", 12, "bench-case", lambda: presets(work)),
        "bad": ("docs/trade.md", 3, 1, None, lambda: bad(work)),
        "tune": ("docs/trade.md", "7, 1, 7 and 3", 25, "splats/garden_sog", lambda: tune(work)),
        "coverage": ("docs/trade.md", "0 to 19", 10, "bench-case", lambda: call(*bench, "coverage")),
        "weights": ("docs/trade.md", 7, 3, None, lambda: script("weights")),
        "errors": ("docs/trade.md", 7, 4, "render-refs", lambda: script("errors", data)),
        "skips": ("docs/trade.md", 3, 1, None, lambda: script("skips")),
        "extremes": (None, None, 2, None, lambda: call("tests/extremes/page")),
        "splats": ("docs/splats.md", None, 5, "splats/garden_sog", lambda: call(*bench, "splat", "--", data)),
        "trace": ("docs/trace.md", "7 and 1 to 3", 2, "render-refs", lambda: curves(call(*bench, "trace", "--", data, "plane", "ratio"))),
        "noop": ("docs/bench.md", None, 4, "ninja", lambda: call("python3", "tests/noop/ninja.py", PROGRAM, "ninja", os.path.join(work, "noop"))),
    }

def missing(data, needs):
    """What a table needs and is not there; None where all is."""
    there = needs is None or (shutil.which(needs) if needs == "ninja" else os.path.exists(os.path.join(data, needs)))
    return None if there else needs

def blocks(lines):
    """(first, last + 1) of every table."""
    found, at = [], 0
    while at < len(lines):
        end = at
        while end < len(lines) and lines[end].startswith("|"):
            end += 1
        if end > at:
            found.append((at, end))
        at = max(end, at + 1)
    return found

def renew(page, text, note):
    """Puts the tables of `text` in the places of those of a page that have the same first row."""
    path = os.path.join(ROOT, page)
    with open(path) as file:
        lines = file.read().split("\n")
    fresh = {}
    made = text.split("\n")
    for first, end in blocks(made):
        fresh.setdefault(made[first].replace(" ", ""), []).append(made[first:end])
    for first, end in reversed(blocks(lines)):
        waiting = fresh.get(lines[first].replace(" ", ""))
        if waiting:
            after = end + 2 if lines[end + 1:end + 2] and lines[end + 1].startswith("*Made by") else end
            lines[first:after] = waiting.pop() + ["", note]
    with open(path, "w") as file:
        file.write("\n".join(lines))
    left = [head for head, waiting in fresh.items() if waiting]
    if left:
        print(f"{page} has no table (or too few) of: {left}", file=sys.stderr)

def main():
    parse = argparse.ArgumentParser(usage=__doc__)
    parse.add_argument("--data", default=os.path.join(ROOT, "../shared/data"))
    parse.add_argument("--work")
    parse.add_argument("--list", action="store_true")
    parse.add_argument("names", nargs="*")
    asked = parse.parse_args()
    data, work = os.path.abspath(asked.data), asked.work or tempfile.mkdtemp()
    os.makedirs(work, exist_ok=True)
    known = tables(data, work)
    unknown = [name for name in asked.names if name not in known]
    if unknown:
        sys.exit(f"there are no tables {unknown}; there are {', '.join(known)}")
    if asked.list:
        for name, (page, seed, minutes, needs, _) in known.items():
            lacks = f", which is not here: {needs}" if missing(data, needs) else f", needs {needs}" if needs else ""
            print(f"{name:9} {page or 'docs/extremes.md':16} about {minutes:2} CPU-min{lacks}")
        return
    commit = call("git", "rev-parse", "--short", "HEAD").strip() + ("+" if call("git", "status", "--short", "-uno") else "")
    for name in asked.names or known:
        page, seed, _, needs, make = known[name]
        lacks = missing(data, needs)
        if lacks:
            print(f"{name} is left out: there is no {lacks}", file=sys.stderr)
            continue
        text = make()
        if page:
            seeded = f", seed{'s' * isinstance(seed, str)} {seed}" if seed is not None else ""
            renew(page, text, f"*Made by `{HERE}/make.py {name}`, commit {commit}{seeded}.*")

if __name__ == "__main__":
    main()
