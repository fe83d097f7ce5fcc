"""The places: rooms, courtyards, streets and table tops, each a function of a seed. NumPy only.

World: z up, metres. Every place has a point where objects stand, cameras around it, and a sky or none.
"""
import zlib
from dataclasses import dataclass, field

import numpy as np

from shapes import box, cylinder, rectangle, sphere
from sky import Sky


@dataclass
class Look:
    """A material. `pattern`: plain, checker, brick, planks or noise, of `colour` and `second`, with tiles of `size` metres.
    `roughness` below 1 makes it glossy, `metallic` a mirror of its colour; `emission` is radiance in place of reflection."""
    colour: tuple
    pattern: str = "plain"
    second: tuple = None
    size: float = 0.3
    roughness: float = 1.0
    metallic: float = 0.0
    emission: float = 0.0


@dataclass
class Place:
    name: str
    tags: list
    parts: list = field(default_factory=list)
    looks: dict = field(default_factory=dict)
    sky: Sky = None
    at: tuple = (0.0, 0.0, 0.0)
    yaw_deg: float = 0.0
    # Factor of the objects, which are 0.5 m high.
    scale: float = 1.0
    # Azimuths (degrees, counter-clockwise from +X), distances and heights above `at` of the scored cameras.
    around: tuple = (0.0, 360.0)
    reach: tuple = (1.3, 1.8)
    rise: tuple = (0.7, 1.3)
    # Where cameras may be: lowest and highest corner.
    inside: tuple = None
    # Openings to the sky: rectangles (corner, u, v), through which light is sampled.
    openings: list = field(default_factory=list)
    # Length of the edges of the captured mesh near the object, metres.
    step: float = 0.06
    objects: tuple = ("matte", "metal")

    def add(self, *parts):
        for part in parts:
            self.parts += part if isinstance(part, list) else [part]

    def obstacles(self):
        """Bounding boxes of what stands in the place: everything but the parts that are as large as the place."""
        boxes = [p.bounds() for p in self.parts]
        largest = max((high - low).max() for low, high in boxes)
        return [(low, high) for low, high in boxes if (high - low).max() < 0.45 * largest]

    def shiny(self):
        """Whether any material shows reflections, so that the region of reflections is rendered."""
        return any(l.roughness < 0.4 or l.metallic > 0 for l in self.looks.values())


WHITE, CREAM, RED, BLUE, GREEN = (0.75, 0.74, 0.72), (0.7, 0.62, 0.48), (0.55, 0.12, 0.09), (0.12, 0.22, 0.5), (0.16, 0.38, 0.15)
WOOD, DARK, GREY = (0.36, 0.22, 0.12), (0.06, 0.055, 0.05), (0.35, 0.35, 0.34)
WARM, NEUTRAL = (1.0, 0.78, 0.5), (1.0, 0.93, 0.82)


def generator(seed, name):
    """The random numbers of one place: another place does not change them."""
    return np.random.default_rng([seed, zlib.crc32(name.encode())])


def wall(look, corner, u, v, opening=None):
    """A wall, with a rectangular opening (from, to along u, from, to along v; fractions): its parts and the opening."""
    if opening is None:
        return [rectangle(look, corner, u, v)], None
    corner, u, v = (np.array(x, float) for x in (corner, u, v))
    a, b, c, d = opening
    part = lambda i, j, k, l: rectangle(look, corner + u * i + v * k, u * (j - i), v * (l - k))
    return [part(0, a, 0, 1), part(b, 1, 0, 1), part(a, b, 0, c), part(a, b, d, 1)], (corner + u * a + v * c, u * (b - a), v * (d - c))


def shell(place, rng, floor, walls, ceiling="white", window=None, size=None):
    """A closed room around the origin; `window` is the side with an opening: +x, -x, +y or -y."""
    x, y, z = size or (rng.uniform(2.4, 3.0), rng.uniform(2.0, 2.5), rng.uniform(2.5, 2.8))
    place.add(rectangle(floor, (-x, -y, 0), (2 * x, 0, 0), (0, 2 * y, 0)))
    place.add(rectangle(ceiling, (-x, -y, z), (0, 2 * y, 0), (2 * x, 0, 0)))
    sides = {"-x": ((-x, -y, 0), (0, 2 * y, 0)), "+x": ((x, y, 0), (0, -2 * y, 0)),
             "-y": ((x, -y, 0), (-2 * x, 0, 0)), "+y": ((-x, y, 0), (2 * x, 0, 0))}
    for (side, (corner, u)), look in zip(sides.items(), walls):
        hole = (rng.uniform(0.25, 0.33), rng.uniform(0.67, 0.75), 0.3, 0.82) if side == window else None
        parts, opening = wall(look, corner, u, (0, 0, z), hole)
        place.add(parts)
        if opening is not None:
            place.openings.append(opening)
            frame(place, opening)
    place.inside = ((-x + 0.25, -y + 0.25, 0.3), (x - 0.25, y - 0.25, z - 0.25))
    return x, y, z


def frame(place, opening):
    """Two bars across a window, 4 cm wide."""
    corner, u, v = opening
    place.looks.setdefault("bars", Look(WHITE))
    inward = np.cross(u, v) / np.linalg.norm(np.cross(u, v))
    for along, across in ((u, v), (v, u)):
        width = across / np.linalg.norm(across) * 0.04
        middle = corner + across / 2 - width / 2 + inward * 0.01
        # Seen from both sides: outside it is dark.
        if np.dot(np.cross(along, width), inward) < 0:
            place.add(rectangle("bars", middle + width, along, -width))
        else:
            place.add(rectangle("bars", middle, along, width))


def lamp(place, name, corner, u, v, colour, radiance):
    """A panel of light that faces `u x v`."""
    place.looks[name] = Look(colour, emission=radiance)
    place.add(rectangle(name, corner, u, v))


def clutter(place, rng, low, high, keep, count, sizes, looks):
    """Boxes, cylinders and balls on the level z = low[2], outside the circle `keep` (x, y, radius) and apart."""
    taken = [keep]
    for _ in range(200):
        if len(taken) > count:
            return
        r = rng.uniform(*sizes)
        p = rng.uniform(low[:2], high[:2])
        if any(np.hypot(p[0] - x, p[1] - y) < r * 1.5 + s for x, y, s in taken):
            continue
        taken.append((*p, r * 1.5))
        look, kind = looks[rng.integers(len(looks))], rng.integers(3)
        z = low[2]
        if kind == 0:
            h = r * rng.uniform(0.5, 2.2)
            place.add(box(look, (p[0] - r, p[1] - r * 0.7, z), (p[0] + r, p[1] + r * 0.7, z + h), rng.uniform(0, 90)))
        elif kind == 1:
            place.add(cylinder(look, (*p, z), r * 0.7, r * rng.uniform(1.0, 2.5)))
        else:
            place.add(sphere(look, (*p, z + r * 0.8), r * 0.8))


def common(place):
    place.looks.update({
        "white": Look(WHITE), "cream": Look(CREAM, "noise", (0.62, 0.54, 0.4), 0.5), "red": Look(RED), "blue": Look(BLUE),
        "green": Look(GREEN), "grey": Look(GREY, "noise", (0.27, 0.27, 0.26), 0.2), "dark": Look(DARK),
        "wood": Look(WOOD, "planks", (0.28, 0.16, 0.08), 0.16), "tiles": Look((0.6, 0.58, 0.55), "checker", (0.32, 0.3, 0.29), 0.4),
        "brick": Look((0.42, 0.17, 0.11), "brick", (0.5, 0.24, 0.16), 0.25), "paving": Look((0.46, 0.44, 0.4), "brick", (0.38, 0.36, 0.33), 0.5),
        "gloss": Look((0.33, 0.2, 0.12), "planks", (0.26, 0.15, 0.08), 0.2, roughness=0.12),
        "asphalt": Look((0.09, 0.09, 0.095), "noise", (0.13, 0.13, 0.13), 0.1), "paper": Look((0.7, 0.66, 0.55), "checker", (0.5, 0.25, 0.18), 0.22)})
    return place


def furniture(place, rng, x, y):
    """A cupboard, a table and a shelf along the walls, away from the middle."""
    place.add(box("wood", (-x + 0.05, -y + 0.05, 0), (-x + 0.5, -y + 1.0, rng.uniform(0.9, 1.5))))
    place.add(box("white", (x - 1.2, -y + 0.05, 0), (x - 0.2, -y + 0.5, rng.uniform(0.6, 0.8))))
    place.add(box("blue", (-x + 0.05, y - 0.6, 0), (-x + 0.6, y - 0.05, rng.uniform(0.5, 0.9))))


def room(name, tags, seed, floor="wood", walls=("white",) * 4, window=None, sky=None, lamps=0, cluttered=0, mirror=False, **more):
    rng = generator(seed, name)
    place = common(Place(name, ["room", *tags], sky=sky, **more))
    x, y, z = shell(place, rng, floor, walls, window=window)
    furniture(place, rng, x, y)
    place.at = (float(rng.uniform(-0.2, 0.3)), float(rng.uniform(-0.3, 0.2)), 0.0)
    place.yaw_deg = float(rng.uniform(0, 90))
    if lamps >= 1:
        a, b = rng.uniform(-1.0, -0.6), rng.uniform(0.1, 0.5)
        lamp(place, "lamp", (a, b, z - 0.02), (0, 0.5, 0), (0.5, 0, 0), NEUTRAL, 30.0)
    if lamps >= 2:
        lamp(place, "glow", (x - 0.02, y - 0.5, 1.0), (0, -0.45, 0), (0, 0, 0.6), WARM, 14.0)
    if mirror:
        place.looks["mirror"] = Look((0.9, 0.9, 0.9), roughness=0.0, metallic=1.0)
        place.add(rectangle("mirror", (-x * 0.5, y - 0.015, 0.15), (x * 1.1, 0, 0), (0, 0, 1.9)))
        place.around = (200.0, 340.0)
    if cluttered:
        clutter(place, rng, (-x + 0.5, -y + 0.5, 0), (x - 0.5, y - 0.5, 0), (*place.at[:2], 0.75), cluttered, (0.09, 0.2),
                ["red", "blue", "green", "cream", "grey"])
    return place


def table(name, tags, seed, window=None, sky=None, desk_lamp=False, ceiling_lamp=False, top="wood", walls=("cream", "white", "green", "cream"), cluttered=6, **more):
    rng = generator(seed, name)
    place = common(Place(name, ["table", *tags], sky=sky, scale=0.4, reach=(0.6, 0.85), rise=(0.25, 0.5), step=0.025, **more))
    x, y, z = shell(place, rng, "tiles", walls, window=window, size=(1.7, 1.6, 2.5))
    h, a, b = 0.74, rng.uniform(0.65, 0.8), rng.uniform(0.45, 0.55)
    place.add(box(top, (-a, -b, h - 0.04), (a, b, h), bottom=True))
    for i in (-1, 1):
        for j in (-1, 1):
            place.add(box("dark", (i * (a - 0.06) - 0.03, j * (b - 0.06) - 0.03, 0), (i * (a - 0.06) + 0.03, j * (b - 0.06) + 0.03, h - 0.04)))
    place.at = (float(rng.uniform(-0.05, 0.1)), float(rng.uniform(-0.12, 0.0)), h)
    place.yaw_deg = float(rng.uniform(0, 90))
    if desk_lamp:
        p = (-a + 0.15, b - 0.15, h)
        place.add(cylinder("dark", p, 0.09, 0.02), cylinder("dark", p, 0.012, 0.48))
        place.looks["bulb"] = Look(WARM, emission=90.0)
        place.add(sphere("bulb", (p[0] + 0.09, p[1] - 0.07, h + 0.44), 0.045))
        place.add(box("red", (p[0] - 0.03, p[1] - 0.19, h + 0.51), (p[0] + 0.21, p[1] + 0.05, h + 0.52), bottom=True))
    if ceiling_lamp:
        lamp(place, "lamp", (-0.3, -0.2, z - 0.02), (0, 0.4, 0), (0.6, 0, 0), NEUTRAL, 16.0)
    clutter(place, rng, (-a + 0.1, -b + 0.1, h), (a - 0.1, b - 0.1, h), (*place.at[:2], 0.22), cluttered, (0.03, 0.065),
            ["red", "blue", "green", "paper", "white"])
    return place


def courtyard(name, tags, seed, sky, ground="paving", **more):
    rng = generator(seed, name)
    place = common(Place(name, ["courtyard", *tags], sky=sky, scale=1.4, reach=(2.0, 2.8), rise=(1.0, 1.6), step=0.12, **more))
    x, y = rng.uniform(4.5, 5.5), rng.uniform(3.8, 4.6)
    high = rng.uniform(3.2, 4.2)
    place.add(rectangle(ground, (-x, -y, 0), (2 * x, 0, 0), (0, 2 * y, 0)))
    place.add(rectangle("brick", (-x, y, 0), (2 * x, 0, 0), (0, 0, high)))
    place.add(rectangle("cream", (-x, -y, 0), (0, 2 * y, 0), (0, 0, high)))
    place.add(rectangle("white", (x, y, 0), (0, -2 * y, 0), (0, 0, high * 0.55)))
    for k in range(3):
        place.add(cylinder("cream", (-x + 1.0, -y + 1.2 + k * 2.2, 0), 0.2, 2.6))
    place.add(box("cream", (-x + 0.75, -y + 0.9, 2.6), (-x + 1.25, y - 0.9, 2.95), bottom=True))
    place.add(box("wood", (1.0, y - 0.9, 0), (2.8, y - 0.45, 0.45)))
    place.add(box("grey", (x - 1.0, -1.0, 0), (x - 0.4, 1.2, 0.5)), sphere("green", (x - 0.7, 0.1, 0.8), 0.45))
    place.add(box("blue", (-1.9, y - 1.0, 0), (-0.9, y - 0.3, 1.6), rng.uniform(0, 25)))
    place.at, place.yaw_deg = (float(rng.uniform(-0.3, 0.4)), float(rng.uniform(-0.5, 0.3)), 0.0), float(rng.uniform(0, 90))
    place.inside = ((-x + 1.5, -y + 0.2, 0.4), (x - 1.2, y - 1.2, 2.6))
    return place


def street(name, tags, seed, sky, lamps=False, **more):
    rng = generator(seed, name)
    place = common(Place(name, ["street", *tags], sky=sky, scale=1.6, reach=(2.4, 3.2), rise=(1.0, 1.6), step=0.15, **more))
    long, half = 12.0, rng.uniform(4.5, 5.5)
    place.add(rectangle("asphalt", (-long, -half, 0), (2 * long, 0, 0), (0, half - 1.4, 0)))
    place.add(box("paving", (-long, -1.4, 0), (long, half, 0.12)))
    place.looks["pane"] = Look((0.03, 0.035, 0.04), roughness=0.05)
    at = -long
    facades = ["brick", "cream", "white", "red", "grey"]
    k = int(rng.integers(5))
    while at < long - 0.5:
        width = min(rng.uniform(3.5, 5.5), long - at)
        height, look = rng.uniform(4.5, 7.5), facades[k % 5]
        k += 1
        place.add(box(look, (at, half, 0), (at + width, half + 3, height)))
        place.add(box(facades[(k + 2) % 5], (at, -half - 3, 0), (at + width, -half, height * 0.8)))
        for i in range(int(width // 1.6)):
            for z in np.arange(1.2, height - 1.2, 1.9):
                left = at + 0.5 + i * 1.6
                place.add(rectangle("pane", (left, half - 0.01, z), (0.9, 0, 0), (0, 0, 1.2)))
        at += width
    for i in range(-2, 3):
        place.add(cylinder("dark", (i * 2.4 + 0.8, -1.15, 0.12), 0.07, 0.8))
    place.add(box("blue", (3.6, -half + 0.6, 0.25), (7.2, -half + 2.2, 1.0)), box("blue", (4.3, -half + 0.7, 1.0), (6.4, -half + 2.1, 1.5)))
    place.add(box("green", (-4.4, half - 0.7, 0.12), (-3.4, half - 0.2, 0.9)))
    if lamps:
        place.looks["bulb"] = Look(WARM, emission=200.0)
        for i in (-1, 1):
            p = (i * 3.2 + 0.3, 2.6, 0.12)
            place.add(cylinder("dark", p, 0.06, 3.0), sphere("bulb", (p[0], p[1], 3.3), 0.16))
    place.at, place.yaw_deg = (float(rng.uniform(-0.4, 0.4)), float(rng.uniform(0.5, 1.2)), 0.12), float(rng.uniform(0, 90))
    place.inside = ((-8, -half + 0.5, 0.5), (8, half - 0.6, 2.6))
    return place


def all_places(seed):
    """The places of the full set, in order, with the objects that are inserted."""
    clear = Sky("clear")
    sun = lambda azimuth, height: Sky("clear", (azimuth, height), 9.0)
    places = [
        room("room-lamp", ["lamp", "coloured-walls"], seed, walls=("red", "blue", "white", "white"), lamps=2, objects=("matte", "thin")),
        room("room-window", ["window", "overcast"], seed, window="+x", sky=Sky("overcast"), objects=("glossy", "furry")),
        room("room-both", ["lamp", "window", "clutter"], seed, window="+y", sky=clear, lamps=2, cluttered=9, objects=("metal", "matte")),
        room("room-gloss", ["lamp", "glossy-floor"], seed, floor="gloss", walls=("cream", "white", "green", "white"), lamps=2, objects=("glossy", "emissive")),
        room("room-mirror", ["lamp", "mirror"], seed, floor="tiles", walls=("white", "cream", "white", "white"), lamps=2, mirror=True, objects=("matte", "glossy")),
        room("room-sun", ["window", "sun"], seed, window="+x", sky=sun(75, 32), objects=("thin", "matte")),
        courtyard("courtyard-sun", ["sun"], seed, sun(140, 48), objects=("metal", "furry")),
        courtyard("courtyard-overcast", ["overcast"], seed, Sky("overcast"), ground="tiles", objects=("glass", "metal")),
        street("street-sun", ["sun"], seed, sun(230, 30), objects=("matte", "thin")),
        street("street-dusk", ["dusk", "lamp"], seed, Sky("dusk", (270, 0)), lamps=True, objects=("emissive", "glossy")),
        table("table-lamp", ["lamp", "clutter"], seed, desk_lamp=True, objects=("glass", "furry")),
        table("table-window", ["window", "overcast", "glossy-top"], seed, window="+y", sky=Sky("overcast"), top="gloss", objects=("metal", "emissive")),
        table("table-both", ["lamp", "window", "clutter"], seed, window="-x", sky=clear, ceiling_lamp=True, cluttered=10, objects=("glass", "glossy")),
    ]
    for place in places:
        used = {p.material for p in place.parts}
        place.looks = {k: v for k, v in place.looks.items() if k in used}
    return places


# The small set: pairs of a place and an object.
SMALL = [("room-lamp", "matte"), ("room-gloss", "glossy"), ("courtyard-sun", "metal"), ("table-window", "emissive")]
