"""Skies as panoramas: linear radiance, equirectangular, row 0 up, centre column along +Y, u clockwise. NumPy only."""
from dataclasses import dataclass

import numpy as np


@dataclass
class Sky:
    """A sky and the ground below the horizon.

    `kind` is `clear`, `overcast` or `dusk`. `sun_deg` is (azimuth, elevation): azimuth clockwise from +Y. `sun` is the
    irradiance of the sun's disc on a surface that faces it, in units where the zenith of a clear sky has radiance 1.
    `sun_size_deg` is the diameter of the disc.
    """
    kind: str
    sun_deg: tuple = None
    sun: float = 0.0
    sun_size_deg: float = 3.0
    ground: tuple = (0.25, 0.23, 0.2)


def directions(width):
    """Unit directions (width / 2, width, 3) of the pixel centres."""
    p = 2 * np.pi * ((np.arange(width) + 0.5) / width - 0.5)
    t = np.pi * (0.5 - (np.arange(width // 2) + 0.5) / (width // 2))
    p, t = np.meshgrid(p, t)
    return np.stack([np.sin(p) * np.cos(t), np.cos(p) * np.cos(t), np.sin(t)], -1)


def direction(azimuth_deg, elevation_deg):
    """Unit direction of an azimuth (clockwise from +Y) and an elevation."""
    p, t = np.radians(azimuth_deg), np.radians(elevation_deg)
    return np.array([np.sin(p) * np.cos(t), np.cos(p) * np.cos(t), np.sin(t)])


def solid_angles(width):
    """Solid angle of each row's pixels (width / 2), in steradians."""
    edges = np.pi * (0.5 - np.arange(width // 2 + 1) / (width // 2))
    return (np.sin(edges[:-1]) - np.sin(edges[1:])) * 2 * np.pi / width


def panorama(sky, width=1024):
    """The radiance (width / 2, width, 3) of a sky, float32."""
    d = directions(width)
    z = np.clip(d[..., 2], 0, 1)[..., None]
    if sky.kind == "overcast":
        # The standard overcast sky of the CIE.
        light = (1 + 2 * z) / 3 * np.array([0.95, 1.0, 1.08])
    elif sky.kind == "dusk":
        sun = direction(sky.sun_deg[0], 0)
        near = np.clip(d @ sun, 0, 1)[..., None] ** 3
        glow = np.exp(-z / 0.12) * (0.25 + 0.75 * near)
        light = glow * np.array([1.3, 0.55, 0.22]) + (0.25 + 0.2 * z) * np.array([0.25, 0.4, 0.85])
    else:
        pale = np.exp(-z / 0.25)
        light = pale * np.array([1.1, 1.15, 1.2]) + (1 - pale) * np.array([0.35, 0.6, 1.1])
    if sky.sun > 0:
        light = light + disc(sky, d, width)
    weight = (solid_angles(width)[:, None] * np.clip(d[..., 2], 0, None))[..., None]
    irradiance = (light * (d[..., 2:] > 0) * weight).sum((0, 1))
    below = np.array(sky.ground) * irradiance / np.pi
    return np.where(d[..., 2:] > 0, light, below).astype(np.float32)


def disc(sky, d, width):
    """The disc of the sun, with its edge smoothed over a pixel, so that its irradiance is `sky.sun` exactly."""
    distance = np.degrees(np.arccos(np.clip(d @ direction(*sky.sun_deg), -1, 1)))
    cover = np.clip((sky.sun_size_deg / 2 - distance) / (360 / width) + 0.5, 0, 1)
    total = (cover * solid_angles(width)[:, None]).sum()
    warm = np.array([1.0, 0.93, 0.82]) if sky.sun_deg[1] > 25 else np.array([1.0, 0.8, 0.55])
    return cover[..., None] * warm * sky.sun / total
