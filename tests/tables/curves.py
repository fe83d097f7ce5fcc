"""The picture of docs/evidence/trace.md: error over CPU seconds, compared with other programs."""
import math, re

from page import blocks

# CPU-seconds and errors of other programs on the sunny plane, measured on a machine of the same sort: the object by
# `cycles_render.py --passes O` at 1, 4, 16, 64 and 256 samples compared with its own 1024.
CYCLES = {"without": [(1.81, .0939), (1.37, .0199), (1.74, .00135), (3.33, .000232), (9.59, .000054)],
          "S": [(3.9, .0557), (4.0, .0223), (7.1, .0103)],
          "object": [(1.51, .0270), (1.55, .00667), (1.80, .00105), (2.42, .000224), (5.53, .000052)]}
CYCLES_DENOISED = {"without": [(1.69, .00108), (1.77, .000347), (2.06, .000136), (4.34, .000076)],
                   "S": [(4.1, .0117), (4.3, .0075), (7.5, .0053)],
                   "object": [(1.83, .00187), (1.90, .000964), (2.00, .00037), (2.62, .000162), (4.98, .0000712)]}
# S, its rim by Cycles with OpenImageDenoise on R0 and R1, by samples: of the notes.
CYCLES_FILTERED = {4: "0.0117, 0.0185", 16: "0.0075, 0.0098", 64: "0.0053, 0.0062"}
MITSUBA = {"without": [(.009, .0869), (.019, .0159), (.057, .0016), (.195, .000186), (.766, .00004)]}

def curves(text, picture):
    """The tables of the bench with one more for docs/evidence/light-transport.md; error over CPU seconds of `without`, S and O as a
    drawing."""
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
    with open(picture, "w") as file:
        file.write("\n".join(svg + ["</svg>", ""]))
    noise = [f"| {r[0][0]:.0f} | {r[4][0]:.4f}, {r[4][1]:.4f} | {r[5][0]:.4f}, {r[5][1]:.4f} | {CYCLES_FILTERED.get(r[0][0], '')} |" for r in ratio]
    head = ["| samples | raw | denoised | Cycles with OpenImageDenoise on R0 and R1 (notes) |", "|---|---|---|---|"]
    return "\n".join([text, "", *head, *noise, ""])
