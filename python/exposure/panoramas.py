"""HDR panoramas at EV 0, combinations of two panoramas, and simulated photographs of them.

All panoramas are equirectangular: arrays [128, 256, 3] of linear RGB with the zenith in row 0. Radiances are in units
of white, so values above 1 are clipped in a photograph at EV 0. Directions are unit vectors with +Z up.
"""
import re
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path

import numpy as np

HEIGHT, WIDTH = 128, 256
LUMINANCE = np.array([0.21267, 0.71516, 0.07217])

_POLAR = (np.arange(HEIGHT) + 0.5) / HEIGHT * np.pi
_AZIMUTH = (np.arange(WIDTH) + 0.5) / WIDTH * 2 * np.pi - np.pi


def solid_angles(height, width):
    """Solid angles [height, width] of the pixels of an equirectangular image, in steradians."""
    edges = np.cos(np.arange(height + 1) / height * np.pi)
    return np.repeat(((edges[:-1] - edges[1:]) * 2 * np.pi / width)[:, None], width, 1)


SOLID_ANGLE = solid_angles(HEIGHT, WIDTH)
DIRECTION = np.stack([np.sin(_POLAR)[:, None] * np.cos(_AZIMUTH), np.sin(_POLAR)[:, None] * np.sin(_AZIMUTH),
                      np.repeat(np.cos(_POLAR)[:, None], WIDTH, 1)], -1)
# Sine of the elevation of each pixel.
SINE = DIRECTION[..., 2]
# Cosine of the half angle of the disc that counts as the dominant light.
DOMINANT_COSINE = np.cos(np.radians(15))
# Number of panoramas with the most similar features from which a second panorama is drawn.
PARTNERS = 40


def read_all(folders):
    """Reads all panoramas (.exr) of some folders and scales them to EV 0.

    Returns names, indices of the places that they show, and panoramas [count, 128, 256, 3], in order of the names.
    """
    files = sorted((file for folder in folders for file in Path(folder).glob("*.exr")), key=lambda file: file.stem)
    names = [file.stem for file in files]
    if not names or len(set(names)) < len(names):
        raise ValueError("the folders must contain at least one .exr file, and no two of the same name")
    ordered = sorted({place(name) for name in names})
    places = np.array([ordered.index(place(name)) for name in names])
    return names, places, np.stack([to_ev0(read(file)) for file in files])


def read(file):
    """Reads linear RGB from an OpenEXR file and reduces it to [128, 256, 3]; negative values become 0."""
    import OpenEXR

    image = np.maximum(OpenEXR.File(str(file)).channels()["RGB"].pixels.astype(np.float64), 0)
    height, width = image.shape[:2]
    if width != 2 * height or height % HEIGHT:
        raise ValueError(f"{file}: {width} x {height} pixels, which is not a multiple of {WIDTH} x {HEIGHT}")
    sizes = solid_angles(height, width)[..., None]
    blocks = (image * sizes).reshape(HEIGHT, height // HEIGHT, WIDTH, width // WIDTH, 3).sum((1, 3))
    return blocks / SOLID_ANGLE[..., None]


def place(name):
    """Name of the place that a panorama shows: its name without `_puresky` and without a number at the end."""
    return re.sub(r"_*\d+$", "", re.sub(r"_puresky$", "", name))


def to_ev0(panorama):
    """Scales a panorama such that the median of its positive samples to the power 1 / 2.4 is 0.5.

    The scale is smaller if more than 15 % of the sphere would be above white.
    """
    median = np.median(panorama[panorama > 0] ** (1 / 2.4))
    brightest = panorama.max(-1).ravel()
    order = np.argsort(brightest)
    weights = np.cumsum(np.repeat(np.sin(_POLAR), WIDTH)[order])
    limit = brightest[order][np.searchsorted(weights, 0.85 * weights[-1])]
    return panorama * min((0.5 / median) ** 2.4, 1.0 / limit)


@lru_cache(maxsize=1)
def _lobes():
    """Directions [16200, 3] on a grid of 2 degrees, and their lobes of 10 degrees over cells of 2 x 2 pixels."""
    polar, azimuth = (np.arange(90) + 0.5) / 90 * np.pi, (np.arange(180) + 0.5) / 180 * 2 * np.pi - np.pi
    directions = np.stack([np.sin(polar)[:, None] * np.cos(azimuth), np.sin(polar)[:, None] * np.sin(azimuth),
                           np.repeat(np.cos(polar)[:, None], 180, 1)], -1).reshape(-1, 3)
    cells = DIRECTION.reshape(HEIGHT // 2, 2, WIDTH // 2, 2, 3).mean((1, 3)).reshape(-1, 3)
    cells /= np.linalg.norm(cells, axis=1, keepdims=True)
    lobes = [np.exp((part @ cells.T - 1) / np.radians(10) ** 2).astype(np.float32)
             for part in np.array_split(directions, 90)]
    return directions, np.concatenate(lobes)


def dominant_direction(panorama):
    """Unit direction [3] of the dominant light.

    The direction with the most luminance under a lobe of 10 degrees is chosen, then the centroid of the light within 15
    degrees.
    """
    directions, lobes = _lobes()
    flux = (panorama @ LUMINANCE) * SOLID_ANGLE
    cells = flux.reshape(HEIGHT // 2, 2, WIDTH // 2, 2).sum((1, 3)).ravel().astype(np.float32)
    strongest = directions[np.argmax(lobes @ cells)].astype(np.float32).astype(np.float64)
    near = (DIRECTION @ strongest > DOMINANT_COSINE) * flux
    centroid = (DIRECTION * near[..., None]).sum((0, 1))
    return centroid / np.linalg.norm(centroid)


def partners(overviews, places):
    """Indices [count, up to 40] of the panoramas with the most similar features that show another place.

    `overviews` [count, 23] holds the features of the plain photographs, `places` [count] the indices of the places.
    """
    scaled = (overviews - overviews.mean(0)) / (overviews.std(0) + 1e-4)
    distance = ((scaled[:, None] - scaled[None]) ** 2).sum(-1)
    distance[places[:, None] == places[None]] = 1e9
    others = len(places) - np.bincount(places).max()
    return np.argsort(distance, 1)[:, :min(PARTNERS, others)]


def _turned(panorama, random):
    """The panorama rotated by a random number of columns, and mirrored in half of the cases."""
    panorama = np.roll(panorama, random.integers(WIDTH), 1)
    return panorama[:, ::-1] if random.random() < 0.5 else panorama


def _irradiance_up(panorama):
    """Irradiance [3] of a surface that faces up."""
    return np.maximum((panorama * (np.maximum(SINE, 0) * SOLID_ANGLE)[..., None]).sum((0, 1)), 1e-9)


def mixed(first, second, random):
    """Sum of two panoramas, each times a random factor of 0.5 to 2."""
    return to_ev0(first * 2.0 ** random.uniform(-1, 1) + _turned(second, random) * 2.0 ** random.uniform(-1, 1))


def exchanged_ground(first, second, random):
    """Sky of the first panorama above the ground of the second, which is scaled by the ratio of the irradiances."""
    second = _turned(second, random)
    ratio = np.clip(_irradiance_up(first) / _irradiance_up(second), 2.0 ** -8, 2.0 ** 8)
    sky = np.clip(SINE / 0.06 * 0.5 + 0.5, 0, 1)[..., None]
    return to_ev0(first * sky + second * ratio * (1 - sky))


def dimmed(panorama, random):
    """The panorama with the light above white above the horizon scaled by 1/8 to 4.

    The ground is scaled by the ratio of the irradiances, and the sky by a random power of this ratio.
    """
    scale, power = 2.0 ** random.uniform(-3, 2), random.random()
    up, clipped = SINE > 0, panorama.max(-1) > 0.95
    hidden = np.where((clipped & up)[..., None], np.maximum(panorama - np.minimum(panorama, 1), 0), 0)
    rest = panorama - hidden
    ratio = (_irradiance_up(rest) + scale * _irradiance_up(hidden)) / _irradiance_up(panorama)
    shaded = rest * np.where(up[..., None], ratio ** power, ratio)
    return to_ev0(np.where(clipped[..., None], rest, shaded) + scale * hidden)


@dataclass
class Shot:
    """Parameters of a photograph.

    `ev` is the exposure in stops above EV 0, `balance` [3] the gain of each channel, `soft` whether the picture is
    softened after clipping, `grain` the largest random error of a sample in 8-bit codes, and `hole` the sine of the
    elevation below which all pixels are missing.
    """
    ev: float = 0.0
    balance: np.ndarray = field(default_factory=lambda: np.ones(3))
    soft: bool = False
    grain: float = 0.0
    hole: float = -1.0

    @classmethod
    def random(cls, random):
        """Draws parameters: -1.2 to 1.2 stops, white balance, softness, grain as of compression, a hole below."""
        ev = random.uniform(-1.2, 1.2)
        balance = 2 ** (0.24 * (random.random((3, 3)).sum(1) - 1.5))
        soft = bool(random.random() < 0.4)
        grain = 3 * random.random() if random.random() < 0.5 else 0.0
        hole = -1 + 0.5 * random.random() if random.random() < 0.2 else -1.0
        return cls(ev, balance, soft, grain, hole)


@dataclass
class Photograph:
    """A photograph: `rgb` [128, 256, 3] is linear and at most 1, `seen` [128, 256] is false in holes."""
    rgb: np.ndarray
    seen: np.ndarray


def _softened(codes):
    """Display values [128, 256, 3] smoothed with weights 1, 2, 1 in both directions; rows wrap around."""
    wide = np.concatenate([codes[:, -1:], codes, codes[:, :1]], 1)
    codes = 0.25 * wide[:, :-2] + 0.5 * wide[:, 1:-1] + 0.25 * wide[:, 2:]
    high = np.concatenate([codes[:1], codes, codes[-1:]], 0)
    return 0.25 * high[:-2] + 0.5 * high[1:-1] + 0.25 * high[2:]


def to_display(linear):
    """Display values of linear values in sRGB, from 0 to 1."""
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 1e-9) ** (1 / 2.4) - 0.055)


def to_linear(display):
    """Linear values of display values in sRGB, from 0 to 1."""
    return np.where(display <= 0.04045, display / 12.92, ((display + 0.055) / 1.055) ** 2.4)


def photograph(panorama, shot, random):
    """Takes a photograph with 8 bits per sample. `random` supplies the grain."""
    codes = to_display(np.minimum(panorama * 2.0 ** shot.ev * shot.balance, 1))
    if shot.soft:
        codes = _softened(codes)
    if shot.grain:
        codes = codes + (random.random(codes.shape) * 2 - 1) * shot.grain / 255
    codes = np.clip(np.round(codes * 255), 0, 255) / 255
    return Photograph(np.minimum(to_linear(codes), 1), SINE >= shot.hole)
