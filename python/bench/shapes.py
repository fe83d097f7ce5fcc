"""Triangle meshes of simple shapes: rectangles and surfaces of revolution. NumPy only."""
from dataclasses import dataclass, field

import numpy as np


@dataclass
class Part:
    """A surface of a place with one material.

    A rectangle has `corner`, `u` and `v` (metres) and is seen from the side of `u x v`. A surface of revolution has
    `base` (metres) and `profile`, pairs (radius, height) in metres from the lowest to the highest point.
    """
    material: str
    corner: tuple = None
    u: tuple = None
    v: tuple = None
    base: tuple = None
    profile: list = field(default_factory=list)
    smooth: bool = False

    def mesh(self, step=None):
        """Vertices (n, 3) in metres and triangles (m, 3); edges are about `step` metres long, or as few as possible."""
        if self.corner is not None:
            return grid(self.corner, self.u, self.v, step)
        segments = 32 if step is None else max(12, round(2 * np.pi * max(r for r, _ in self.profile) / step))
        profile = np.array(self.profile, float)
        if step is not None:
            profile = divided(profile, step)
        vertices, faces = lathe(profile, segments)
        return vertices + np.array(self.base, float), faces

    def bounds(self):
        """Lowest and highest corner (metres)."""
        vertices, _ = self.mesh()
        return vertices.min(0), vertices.max(0)


def grid(corner, u, v, step=None):
    """A rectangle as triangles, with the normal `u x v`."""
    corner, u, v = (np.array(x, float) for x in (corner, u, v))
    n = 1 if step is None else max(1, round(np.linalg.norm(u) / step))
    m = 1 if step is None else max(1, round(np.linalg.norm(v) / step))
    i, j = np.meshgrid(np.arange(n + 1), np.arange(m + 1))
    vertices = corner + u * (i.ravel() / n)[:, None] + v * (j.ravel() / m)[:, None]
    a = (np.arange(m)[:, None] * (n + 1) + np.arange(n)).ravel()
    faces = np.concatenate([np.stack([a, a + 1, a + n + 2], 1), np.stack([a, a + n + 2, a + n + 1], 1)])
    return vertices, faces


def divided(profile, step):
    """The profile with segments of at most `step` metres."""
    out = [profile[0]]
    for a, b in zip(profile[:-1], profile[1:]):
        n = max(1, int(np.ceil(np.linalg.norm(b - a) / step)))
        out += [a + (b - a) * k / n for k in range(1, n + 1)]
    return np.array(out)


def lathe(profile, segments):
    """A surface of revolution about z with outward normals. A radius of 0 is one vertex."""
    profile = np.asarray(profile, float)
    angle = 2 * np.pi * np.arange(segments) / segments
    vertices, rings = [], []
    for r, z in profile:
        first = len(vertices)
        if r <= 1e-9:
            vertices.append((0.0, 0.0, z))
            rings.append([first] * segments)
        else:
            vertices += [(r * np.cos(t), r * np.sin(t), z) for t in angle]
            rings.append([first + k for k in range(segments)])
    faces = []
    for low, high in zip(rings[:-1], rings[1:]):
        for k in range(segments):
            n = (k + 1) % segments
            if low[k] != low[n]:
                faces.append((low[k], low[n], high[n]))
            if high[k] != high[n]:
                faces.append((low[k], high[n], high[k]))
    return np.array(vertices), np.array(faces, np.int64)


def ball(radius, centre_z, rings=16):
    """Profile of a sphere, from its lowest to its highest point."""
    angle = np.linspace(-np.pi / 2, np.pi / 2, rings + 1)
    profile = [(radius * np.cos(t), centre_z + radius * np.sin(t)) for t in angle]
    profile[0], profile[-1] = (0.0, centre_z - radius), (0.0, centre_z + radius)
    return profile


def rectangle(material, corner, u, v):
    return Part(material, corner=tuple(corner), u=tuple(u), v=tuple(v))


def box(material, low, high, yaw_deg=0.0, bottom=False):
    """Five or six rectangles that face outwards; turned about the vertical axis through the middle."""
    (a, b, c), (d, e, f) = low, high
    x, y, z = d - a, e - b, f - c
    sides = [((a, b, f), (x, 0, 0), (0, y, 0)), ((a, b, c), (x, 0, 0), (0, 0, z)), ((d, e, c), (-x, 0, 0), (0, 0, z)),
             ((d, b, c), (0, y, 0), (0, 0, z)), ((a, e, c), (0, -y, 0), (0, 0, z))]
    if bottom:
        sides.append(((a, b, c), (0, y, 0), (x, 0, 0)))
    t = np.radians(yaw_deg)
    turn = np.array([[np.cos(t), -np.sin(t), 0], [np.sin(t), np.cos(t), 0], [0, 0, 1]])
    middle = np.array([(a + d) / 2, (b + e) / 2, 0])
    return [rectangle(material, turn @ (np.array(p) - middle) + middle, turn @ np.array(u), turn @ np.array(v))
            for p, u, v in sides]


def cylinder(material, base, radius, height):
    """A closed cylinder without a bottom."""
    return Part(material, base=tuple(base), profile=[(radius, 0.0), (radius, height), (0.0, height)])


def sphere(material, centre, radius):
    return Part(material, base=tuple(centre), profile=ball(radius, 0.0), smooth=True)
