"""The tables of docs/evidence/trade.md that a report or a search makes: presets, one bad node, tuning."""
import json, os, re, shutil, sys

from job import Failed

PRESETS = ["draft", "preview", "final", "reference"]
# What is made bad in bad.ron, and the node that is to be named.
BAD = [
    ("probe of 8 px", "0.3, size_px: 64", "0.3, size_px: 8", "probe"),
    ("harmonics left out", '"demo.rig", alpha_cut: 0.002, sh_degree: 4', '"demo.rig", alpha_cut: 0.002, sh_degree: 0', "view"),
    ("1 sample", 'env: "env", samples: 16', 'env: "env", samples: 1', "trace"),
    ("clipped light not predicted", "-3.0], method: Region", "-3.0], method: Skip", "dark"),
    ("receiver cut in half", "Some((1.5, 1.5, 9.0))),\n        trace", "Some((-0.2, 9.0, 9.0))),\n        trace", "floor"),
]

def short(value):
    return f"{value:.2g}" if value < 0.1 else f"{value:.3g}"

def report(job, graph, cache, page, *more):
    command = [job.program, "report", graph, "--cache", cache, "--out", page, "--json", *more]
    return json.loads(job.call(*command, quiet=True))

def presets(job):
    """Work, CPU time and error by region of each preset, and the plots."""
    text = ""
    for name in ["demo", "plaza"]:
        page = job.path(f"{name}.html")
        # The reverse would take a run at the reference for each node.
        told = report(job, job.graph(name), job.path("cache"), page, "--no-reverse")
        with open(page) as file:
            svg = re.search(r"<svg.*?</svg>", file.read(), re.S).group(0)
        style = ("<style>text{font-family:sans-serif}.frame{fill:#fff;stroke:#999}.grid{stroke:#eee}.tick{font-size:11px;"
                 "fill:#555}.axis{font-size:12px}.front{fill:none;stroke:#1668b8;stroke-width:1.5}.dot{fill:#bbb}"
                 ".dot.on{fill:#1668b8}.name{font-size:11px}</style>")
        head = re.match(r"<svg[^>]*>", svg).group(0)
        svg = svg.replace(head, head[:-1] + ' xmlns="http://www.w3.org/2000/svg">' + style, 1)
        with open(job.picture(f"trade-{name}"), "w") as file:
            file.write(svg + "\n")
        text += f"| {name} | CPU-s | work | ns per ray of work | FLIP, whole | FLIP, touched | RMSE, whole | RMSE, touched |\n|---|---|---|---|---|---|---|---|\n"
        for preset in PRESETS:
            point = next(p for p in told["points"] if p["setting"] == preset)
            def worst(region, column):
                # Equal pictures have no finite PSNR, which JSON has as the text `inf`.
                values = [float(row["values"][column]) for row in point["off"]
                          if row["picture"] == "image" and row["region"] == region]
                return short(max(10 ** (-v / 20) if "psnr" in column else v for v in values))
            # What has no counts, such as loading and making a demo, weighs nothing.
            counted = sum(node["cpu_seconds"] for node in point["nodes"] if node["work"] > 0)
            cells = [worst(region, column) for column in ["flip mean", "psnr (dB)"] for region in ["whole", "touched"]]
            text += (f"| `{preset}` | {point['cpu_seconds']:.1f} | {point['work'] / 1e6:.2f} M | {counted / point['work'] * 1e9:.0f} | "
                     f"{' | '.join(cells)} |\n")
        text += "\n"
    return text

def bad(job):
    """The blamed node, and the result of `tune`."""
    with open(job.graph("bad")) as file:
        good = file.read()
    text = ("| made bad | error | named | its own error | the next one's | left with it repaired | `tune` to 0.02: cost | "
            "of the cheapest preset |\n|---|---|---|---|---|---|---|---|\n")
    named = []
    for what, before, after, node in ([("nothing", "", "", None)] + BAD)[:2 if job.small else None]:
        if before and good.count(before) != 1:
            raise Failed(f"bad.ron has no `{before}`, or several")
        graph = job.write("bad-now.ron", good.replace(before, after) if before else good)
        cache = job.path("cache")
        told = report(job, graph, cache, job.path("bad.html"))
        now = next(p for p in told["points"] if p["as_it_is"])
        worst, second = told["attribution"][:2]
        tuned = json.loads(job.call(job.program, "tune", graph, "--max-error", "flip=0.02", "--cache", cache, "--json", "-o",
                                    job.path("tuned.ron"), quiet=True))
        best = next(p for p in tuned["measured"] if p["best"])
        naive = min((p for p in tuned["measured"] if p["setting"] in PRESETS and p["error"] <= 0.02), key=lambda p: p["work"])
        own = "error_with_all_else_at_the_reference"
        text += (f"| {what} | {now['error']:.4f} | `{worst['node']}` | {worst[own]:.4f} | `{second['node']}` {second[own]:.4f} | "
                 f"{worst['error_with_it_alone_at_the_reference']:.4f} | {best['work'] / 1e3:.0f} k | "
                 f"{best['work'] / naive['work']:.2f} of `{naive['setting']}` |\n")
        if node not in (None, worst["node"]):
            named.append(f"{what}: `{worst['node']}` is named and not `{node}`")
    if named:
        print(*named, sep="\n", file=sys.stderr)
    return text

# Graphs and the errors asked of them, which lie between those of their presets.
TUNED = [("demo", ["flip=0.02", "flip=0.012", "flip=0.008"]), ("plaza", ["flip=0.012", "touched.flip=0.05"]),
         ("real", ["flip=0.02"]), ("bad", ["flip=0.03", "flip=0.02", "flip=0.012", "flip=0.008"])]

def tune(job):
    """The result of `tune` for an error, compared with the cheapest preset that reaches it."""
    text = ("| graph | error asked for | cheapest preset: work, error | tuned: work, error | of the preset's work | settings measured |\n"
            "|---|---|---|---|---|---|\n")
    for name, bounds in TUNED:
        # That of `presets`, which may know the references already.
        graph, cache = job.graph(name), job.path("cache")
        for bound in ["flip=0.05"] if job.small else bounds:
            text += tuned(job, name, graph, cache, bound)
    return text

def tuned(job, name, graph, cache, bound):
    """A row of it."""
    overlay = job.path("tuned.ron")
    told = json.loads(job.call(job.program, "tune", graph, "--max-error", bound, "--cache", cache, "--json", "-o", overlay,
                               *["--budget", "6"] * job.small, quiet=True))
    if not told["finished"] and not job.small:
        print(f"{name} {bound}: {told['ended']}", file=sys.stderr)
    best = next(p for p in told["measured"] if p["best"])
    most = float(bound.split("=")[1])
    naive = min((p for p in told["measured"] if p["setting"] in PRESETS and p["error"] <= most), key=lambda p: p["work"])
    # The overlay gives these pictures in a cache that knows nothing, too.
    pictures = []
    for known in [cache, job.path("fresh")]:
        out = job.path("pictures")
        shutil.rmtree(out, ignore_errors=True)
        job.call(job.program, "run", graph, "--overlay", overlay, "--cache", known, "--out", out, quiet=True)
        pictures.append([open(os.path.join(out, file), "rb").read() for file in sorted(os.listdir(out))])
    shutil.rmtree(job.path("fresh"))
    if pictures[0] != pictures[1]:
        raise Failed(f"{name} {bound}: the overlay gives other pictures when it is run afresh")
    ratio, half, why = best["work"] / naive["work"], told["below_half"], ""
    if ratio >= 0.5 and half:
        why = (f"; none of {'all ' if half['complete'] else 'the first '}{half['settings']} below half reaches it, least error {half['least_error']:.4f}" if half["settings"]
               else f"; none is below half, the least is {half['least_cost'] / naive['work']:.2f}")
    return (f"| {name} | {bound} | `{naive['setting']}`: {naive['work'] / 1e6:.2f} M, {naive['error']:.4f} | "
            f"{best['work'] / 1e6:.2f} M, {best['error']:.4f} | {ratio:.2f}{why} | {len(told['measured'])} |\n")
