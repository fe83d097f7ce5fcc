"""Rooms with two lights, and what captures of them would give: a mesh with the captured colours, the clipped panorama, and
the true panorama. Light is computed here by radiosity, so nothing of it comes from the program.

    pip install numpy pillow
    python3 tests/bench_case/two_lights.py /tmp/two_lights
    python3 tests/bench_case/two_lights_score.py /tmp/two_lights target/release/lightharmony

A case is a room of 5 x 4 x 2.7 m with a lamp and a window. Its mesh has cells of 0.1 m, jittered by 4 mm, whose colours
have 4 % of noise per cell in addition to the textures; the panorama has 512 x 256 pixels, at 1.1 m above the floor.
"""
import os
import sys
import zlib

import numpy as np
from PIL import Image

OUT = sys.argv[1]
ONLY = sys.argv[2:]
X, Y, Z = 2.5, 2.0, 2.7
EYE = np.array([0.2, -0.3, 1.1])
WARM, COOL = np.array([1.0, 0.62, 0.30]), np.array([0.62, 0.82, 1.0])
WHITE, RED, BLUE, WOOD, GREY = (0.72, 0.70, 0.67), (0.55, 0.14, 0.10), (0.15, 0.25, 0.50), (0.38, 0.24, 0.13), (0.4, 0.4, 0.4)


BOXES = []


class Rectangle:
    def __init__(self, corner, u, v, albedo, glow=None, kind="wall", texture=0.0):
        self.corner, self.u, self.v = (np.array(a, float) for a in (corner, u, v))
        n = np.cross(self.u, self.v)
        self.area, self.normal = np.linalg.norm(n), n / np.linalg.norm(n)
        self.albedo, self.glow, self.kind, self.texture = np.array(albedo), glow, kind, texture


def box(low, high, albedo, glow=None, kind="box"):
    (a, b, c), (d, e, f) = low, high
    x, y, z = d - a, e - b, f - c
    BOXES.append((kind, np.array(low), np.array(high)))
    sides = [((a, b, f), (x, 0, 0), (0, y, 0)), ((a, b, c), (0, y, 0), (x, 0, 0)), ((a, b, c), (x, 0, 0), (0, 0, z)),
             ((d, e, c), (-x, 0, 0), (0, 0, z)), ((d, b, c), (0, y, 0), (0, 0, z)), ((a, e, c), (0, -y, 0), (0, 0, z))]
    return [Rectangle(*side, albedo, glow, kind) for side in sides]


def room(lamp, window, walls=(WHITE,) * 4, floor=WOOD, furniture=True, lamp_kind="body", ceiling=WHITE, tiny=0.0):
    BOXES.clear()
    left, right, front, back = walls
    parts = [Rectangle((-X, -Y, 0), (2 * X, 0, 0), (0, 2 * Y, 0), floor, texture=0.25),
             Rectangle((X, -Y, 0), (0, 0, Z), (0, 2 * Y, 0), right),
             Rectangle((-X, -Y, 0), (0, 0, Z), (2 * X, 0, 0), front),
             Rectangle((-X, Y, 0), (2 * X, 0, 0), (0, 0, Z), back)]
    if ceiling is not None:
        parts.append(Rectangle((-X, -Y, Z), (0, 2 * Y, 0), (2 * X, 0, 0), ceiling))
    y0, y1, z0, z1 = -0.9, 0.6, 0.9, 2.1
    for (a, b, c, d) in ((-Y, Y, 0, z0), (-Y, Y, z1, Z), (-Y, y0, z0, z1), (y1, Y, z0, z1)):
        parts.append(Rectangle((-X, a, c), (0, b - a, 0), (0, 0, d - c), left))
    parts.append(Rectangle((-X, y0, z0), (0, y1 - y0, 0), (0, 0, z1 - z0), (0.1,) * 3, window, "window"))
    if lamp is not None:
        if lamp_kind == "body":
            parts += box((1.45, 0.75, 1.25), (1.7, 1.0, 1.5), (0.5,) * 3, lamp, "lamp")
        else:
            parts.append(Rectangle((0.9, 0.4, Z - 0.01), (0, 0.5, 0), (0.6, 0, 0), (0.5,) * 3, lamp, "lamp"))
    if tiny:
        parts.append(Rectangle((X - 0.01, -1.5, 1.6), (0, 0, 0.06), (0, 0.06, 0), (0.5,) * 3, np.full(3, tiny), "tiny"))
    if furniture:
        parts += box((-1.3, 0.7, 0.0), (-0.5, 1.4, 0.75), WHITE)
        parts += box((0.7, -1.5, 0.0), (1.3, -0.9, 1.0), BLUE)
        parts += box((0.6, 0.9, 0.0), (1.1, 1.6, 0.5), GREY)
    return parts


def meet(parts, origin, direction):
    """Index of the nearest rectangle and the distance to it, for each ray."""
    best, which = np.full(len(direction), np.inf), np.full(len(direction), -1)
    for k, r in enumerate(parts):
        with np.errstate(divide="ignore", invalid="ignore"):
            t = ((r.corner - origin) @ r.normal) / (direction @ r.normal)
        p = origin + direction * t[:, None] - r.corner
        a, b = p @ r.u / (r.u @ r.u), p @ r.v / (r.v @ r.v)
        hit = (t > 1e-4) & (t < best) & (a >= 0) & (a <= 1) & (b >= 0) & (b <= 1) & ((direction @ r.normal < 0) | (r.kind != "lamp"))
        best[hit], which[hit] = t[hit], k
    return which, best


def open_between(boxes, a, b):
    """True where no box blocks the segments from points `a` to the point `b`. Boxes are 1 mm smaller on each side."""
    d, free = b - a, np.ones(len(a), bool)
    d = np.where(np.abs(d) < 1e-9, 1e-9, d)
    for low, high in boxes:
        s, t = (low + 1e-3 - a) / d, (high - 1e-3 - a) / d
        near, far = np.minimum(s, t).max(1), np.maximum(s, t).min(1)
        free &= ~((near < far) & (far > 0) & (near < 1))
    return free


def samples(r, step):
    n, m = (max(1, round(np.linalg.norm(side) / step)) for side in (r.u, r.v))
    s, t = np.meshgrid((np.arange(n) + 0.5) / n, (np.arange(m) + 0.5) / m)
    return r.corner + s.reshape(-1, 1) * r.u + t.reshape(-1, 1) * r.v, r.area / (n * m)


def received(blockers, points, normals, sources):
    """Irradiance of points by small sources: lists of position, normal, radiance times area."""
    sum = np.zeros((len(points), 3))
    from_ = points + normals * 2e-3
    for at, facing, power in zip(*sources):
        way = at - from_
        square = np.maximum((way * way).sum(1), 1e-3)
        cosines = np.maximum((way * normals).sum(1), 0) * np.maximum(-(way @ facing), 0) / square ** 2
        lit = cosines > 1e-7
        lit[lit] &= open_between(blockers, from_[lit], at)
        sum[lit] += cosines[lit, None] * power
    return sum


def solve(parts, sky):
    """Adds the irradiance of each cell to the rectangles."""
    blockers = [box[1:] for box in BOXES if box[0] == "box"]
    glowing = [r for r in parts if r.glow is not None]
    lights = [np.concatenate(lists) for lists in zip(*[
        (p + 0 * p, np.tile(r.normal, (len(p), 1)), np.tile(r.glow * area, (len(p), 1)))
        for r in glowing for p, area in [samples(r, 0.13 if r.kind == "lamp" else 0.3)]])]
    for r in parts:
        r.cells, r.cell_area = samples(r, 0.1)
        normals = np.tile(r.normal, (len(r.cells), 1))
        r.light = received(blockers, r.cells, normals, lights)
        if sky is not None:
            k = 96
            i = np.arange(k) + 0.5
            z, turn = 1 - i / k, np.pi * (1 + 5 ** 0.5) * i
            for d in np.stack([np.sqrt(1 - z * z) * np.cos(turn), np.sqrt(1 - z * z) * np.sin(turn), z], 1):
                cosine = max(float(r.normal @ d), 0.0)
                if cosine > 0:
                    which, _ = meet(parts, r.cells + r.normal * 2e-3, np.tile(d, (len(r.cells), 1)))
                    r.light += ((which < 0) * cosine * 2 * np.pi / k)[:, None] * sky
    # Bounces between coarse cells, which are interpolated by nearest cells of the fine grid.
    coarse = [samples(r, 0.5) for r in parts]
    at = np.concatenate([c[0] for c in coarse])
    of = np.concatenate([np.full(len(c[0]), k) for k, c in enumerate(coarse)])
    area = np.concatenate([np.full(len(c[0]), c[1]) for c in coarse])
    normal = np.array([parts[k].normal for k in of])
    albedo = np.array([parts[k].albedo for k in of])
    nearest = [((p[:, None] - parts[k].cells) ** 2).sum(2).argmin(1) for k, (p, _) in enumerate(coarse)]
    first = np.concatenate([parts[k].light[nearest[k]] for k in range(len(parts))])
    radiosity = albedo * first
    for bounce in range(4):
        sources = (at, normal, radiosity / np.pi * area[:, None])
        light = received(blockers, at, normal, sources)
        radiosity = albedo * (first + light)
    sources = (at, normal, radiosity / np.pi * area[:, None])
    for r in parts:
        sides = [max(1, round(np.linalg.norm(side) / 0.1)) for side in (r.u, r.v)]
        # Every third cell in each direction; linear in between.
        p = r.cells.reshape(sides[1], sides[0], 3)
        rows, columns = (np.unique(np.append(np.arange(0, n, 3), n - 1)) for n in (sides[1], sides[0]))
        some = p[np.ix_(rows, columns)].reshape(-1, 3)
        light = received(blockers, some, np.tile(r.normal, (len(some), 1)), sources).reshape(len(rows), len(columns), 3)
        light = np.stack([np.stack([np.interp(np.arange(sides[0]), columns, row[:, c]) for row in light]) for c in range(3)], 2)
        light = np.stack([np.stack([np.interp(np.arange(sides[1]), rows, col) for col in light[:, :, c].T], 1) for c in range(3)], 2)
        r.light += light.reshape(-1, 3)


def look(r, k, noise):
    """Albedo of the cells of a rectangle, with its texture."""
    n, m = (max(1, round(np.linalg.norm(side) / 0.1)) for side in (r.u, r.v))
    i, j = np.meshgrid(np.arange(n), np.arange(m))
    check = ((i // 5 + j // 5) % 2).reshape(-1, 1)
    rng = np.random.default_rng(zlib.crc32(b"%d" % k))
    albedo = r.albedo * (1 - r.texture * check) * np.exp(noise * rng.normal(size=(n * m, 1)))
    if r.kind == "wall" and r.area > 5 and k in (3, 4):
        picture = ((i > 12) & (i < 20) & (j > 12) & (j < 18)).reshape(-1)
        albedo[picture] = albedo[picture] * np.array([0.3, 0.5, 0.7])
    return albedo, (n, m)


def srgb(c):
    c = np.clip(c, 0, 1)
    return np.round(255 * np.where(c <= 0.0031308, 12.92 * c, 1.055 * np.power(np.maximum(c, 1e-9), 1 / 2.4) - 0.055)).astype(np.uint8)


def write_hdr(path, rgb):
    """Radiance picture without run lengths."""
    most = np.maximum(rgb.max(2), 1e-30)
    exponent = np.ceil(np.log2(most)).astype(int)
    exponent += most >= 2.0 ** exponent
    mantissa = np.clip(np.floor(rgb * (256.0 / 2.0 ** exponent)[..., None]), 0, 255).astype(np.uint8)
    rgbe = np.concatenate([mantissa, np.clip(exponent + 128, 0, 255).astype(np.uint8)[..., None]], 2)
    with open(path, "wb") as file:
        file.write(b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y %d +X %d\n" % rgb.shape[:2])
        file.write(rgbe.tobytes())


def make(name, parts, sky=None, noise=0.04, flat=False, holes=0.0, scale=1.0, opening=False):
    solve(parts, sky)
    width, height = 512, 256
    u, v = np.meshgrid((np.arange(width) + 0.5) / width, (np.arange(height) + 0.5) / height)
    phi, th = 2 * np.pi * (u - 0.5), np.pi * (0.5 - v)
    d = np.stack([np.sin(phi) * np.cos(th), np.cos(phi) * np.cos(th), np.sin(th)], 2).reshape(-1, 3)
    which, t = meet(parts, EYE, d)
    pano = np.tile(np.zeros(3) if sky is None else sky, (len(d), 1)).astype(float)
    for k, r in enumerate(parts):
        r.look, (n, m) = look(r, k, noise)
        r.radiance = r.look * r.light / np.pi + (0 if r.glow is None else r.glow)
        hit = which == k
        p = EYE + d[hit] * t[hit, None] - r.corner
        i = np.clip((p @ r.u / (r.u @ r.u) * n).astype(int), 0, n - 1)
        j = np.clip((p @ r.v / (r.v @ r.v) * m).astype(int), 0, m - 1)
        pano[hit] = r.radiance[j * n + i]
    below = which < 0
    pano[below & (d[:, 2] < 0)] = 0.0
    exposure = 0.19 / np.median(pano.mean(1))
    folder = f"{OUT}/{name}"
    os.makedirs(folder, exist_ok=True)
    pano = (pano * exposure).reshape(height, width, 3)
    Image.fromarray(srgb(pano)).save(f"{folder}/pano.png")
    write_hdr(f"{folder}/truth.hdr", pano)
    rng = np.random.default_rng(7)
    points, colours, faces = [], [], []
    for k, r in enumerate(parts):
        if opening and r.kind == "window":
            continue
        n, m = (max(1, round(np.linalg.norm(side) / 0.1)) for side in (r.u, r.v))
        seen = srgb(r.look if flat else r.radiance * exposure)
        for j in range(m):
            for i in range(n):
                if rng.random() < holes and r.glow is None:
                    continue
                first = len(points)
                for a, b in ((0, 0), (1, 0), (1, 1), (0, 1)):
                    p = r.corner + r.u * ((i + a) / n) + r.v * ((j + b) / m)
                    points.append((p + rng.normal(0, 0.004, 3)) * scale)
                    colours.append(seen[j * n + i])
                faces += [(first, first + 1, first + 2), (first, first + 2, first + 3)]
    head = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(points)}\n"
    head += "".join(f"property float {a}\n" for a in "xyz") + "".join(f"property uchar {c}\n" for c in ("red", "green", "blue"))
    head += f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    vertex = np.zeros(len(points), [("p", "<f4", 3), ("c", "u1", 3)])
    vertex["p"], vertex["c"] = points, colours
    face = np.zeros(len(faces), [("n", "u1"), ("v", "<i4", 3)])
    face["n"], face["v"] = 3, faces
    with open(f"{folder}/mesh.ply", "wb") as file:
        file.write(head.encode() + vertex.tobytes() + face.tobytes())
    print(name, "exposure %.4f" % exposure, "clipped %.3f" % (pano.max(2) > 1).mean(), flush=True)


CASES = {
    "both": lambda n: make(n, room(40 * WARM, 9 * COOL)),
    "lamp-strong": lambda n: make(n, room(160 * WARM, 6 * COOL)),
    "window-strong": lambda n: make(n, room(20 * WARM, 25 * COOL)),
    "ceiling-panel": lambda n: make(n, room(25 * WARM, 9 * COOL, lamp_kind="panel")),
    "opening": lambda n: make(n, room(40 * WARM, 9 * COOL), opening=True),
    "coloured-walls": lambda n: make(n, room(40 * np.ones(3), 9 * np.ones(3), walls=(BLUE, RED, WHITE, (0.65, 0.45, 0.25)))),
    "coloured-both": lambda n: make(n, room(40 * WARM, 9 * COOL, walls=(WHITE, RED, BLUE, WHITE))),
    "no-furniture": lambda n: make(n, room(40 * WARM, 9 * COOL, furniture=False)),
    "lamp-only": lambda n: make(n, room(40 * WARM, None)),
    "window-only": lambda n: make(n, room(None, 9 * COOL)),
    "black": lambda n: make(n, room(40 * WARM, 9 * COOL, walls=((0.03,) * 3,) * 4, floor=(0.03,) * 3, ceiling=(0.03,) * 3)),
    "unlit-colours": lambda n: make(n, room(40 * WARM, 9 * COOL), flat=True),
    "holes": lambda n: make(n, room(40 * WARM, 9 * COOL), holes=0.3),
    "wrong-scale": lambda n: make(n, room(40 * WARM, 9 * COOL), scale=1.5),
    "textured": lambda n: make(n, room(40 * WARM, 9 * COOL), noise=0.2),
    "no-effect": lambda n: make(n, room(40 * WARM, 9 * COOL, tiny=30.0)),
    "dusk": lambda n: make(n, room(60 * WARM, None, ceiling=None), sky=np.array([0.35, 0.5, 0.9])),
}
for name, case in CASES.items():
    if not ONLY or name in ONLY:
        case(name)
