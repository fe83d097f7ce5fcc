"""Features of a photographed panorama, and what its clipping hides.

The 23 overview numbers and the 14 maps are those of `render/src/light/hidden/network`, for panoramas of 256 x 128
pixels. Logarithms have base 2. A cell is one of the 128 x 64 cells of the maps and contains 2 x 2 pixels.
"""
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from panoramas import DIRECTION, DOMINANT_COSINE, HEIGHT, LUMINANCE, SINE, SOLID_ANGLE, WIDTH

OVERVIEW, MAPS = 23, 14
ROWS, COLUMNS = HEIGHT // 2, WIDTH // 2
# Maps that describe what is open; they are 0 where nothing is.
VISIBLE_MAPS = [0, 1, 2, 3, 4, 9]
CLIPPED_MAP, VISIBLE_SHARE_MAP = 5, 9

# A sample above this value in linear light counts as clipped.
CLIPPED = 0.95
# Number of stops by which the predicted ratio of total to visible flux is lowered, as in the program.
CAUTION = 0.1
# Columns that are repeated on both sides for distances that wrap around; above the largest distance that is used.
_MARGIN = 40


class Parts:
    """The clipped and the open (seen and not clipped) pixels of a photograph, as arrays [128, 256].

    `luminance` is that of all pixels. `open_rgb` [128, 256, 3] and `open_luminance` are 0 where pixels are not open.
    `seen_size`, `open_size` and `clipped_size` are solid angles in steradians, and 0 elsewhere.
    """

    def __init__(self, photograph):
        self.rgb, self.seen = photograph.rgb, photograph.seen
        self.luminance = self.rgb @ LUMINANCE
        self.clipped = self.seen & (self.rgb.max(-1) > CLIPPED)
        self.white = self.clipped & (self.rgb.min(-1) > CLIPPED)
        self.open = self.seen & ~self.clipped
        self.seen_size, self.open_size = self.seen * SOLID_ANGLE, self.open * SOLID_ANGLE
        self.clipped_size = self.clipped * SOLID_ANGLE
        self.open_rgb = np.where(self.open[..., None], self.rgb, 0)
        self.open_luminance = self.open_rgb @ LUMINANCE


def _log2(value, least):
    """Logarithm of a value that is at least `least`."""
    return np.log2(np.maximum(value, least))


def _mean(values, weights):
    """Weighted mean; 0 if all weights are 0."""
    return (weights * values).sum() / max(weights.sum(), 1e-9)


def region_sizes(parts):
    """Solid angles [regions] of the connected clipped regions (four neighbours, rows wrap around), in steradians."""
    labels, count = ndimage.label(parts.clipped)
    parent = np.arange(count + 1)

    def root(label):
        while parent[label] != label:
            label = parent[label]
        return label

    for left, right in zip(labels[:, 0], labels[:, -1]):
        if left and right and root(left) != root(right):
            parent[max(root(left), root(right))] = min(root(left), root(right))
    roots = np.array([root(label) for label in range(count + 1)])
    sizes = np.bincount(roots[labels].ravel(), parts.clipped_size.ravel(), count + 1)
    return sizes[1:][roots[1:] == np.arange(1, count + 1)]


def _ring(parts):
    """Pixels whose distance from the nearest clipped pixel, in steps to neighbours, is 3 to 6."""
    wide = np.concatenate([parts.clipped[:, -_MARGIN:], parts.clipped, parts.clipped[:, :_MARGIN]], 1)
    if not wide.any():
        return np.zeros_like(parts.clipped)
    distance = ndimage.distance_transform_cdt(~wide, "taxicab")[:, _MARGIN:-_MARGIN]
    return (distance > 2) & (distance <= 6)


def _quantiles(values, weights, at):
    """Weighted quantiles of values; zeros if all weights are 0."""
    indices = np.flatnonzero(weights > 0)
    if not len(indices):
        return [0.0] * len(at)
    ordered = indices[np.argsort(values.ravel()[indices], kind="stable")]
    sums = np.cumsum(weights.ravel()[ordered])
    found = np.minimum(np.searchsorted(sums, np.array(at) * sums[-1]), len(ordered) - 1)
    return list(values.ravel()[ordered[found]])


def _walls(parts):
    """Brightness of walls relative to the visible light that falls on them from the opposite side, in stops.

    The mean over all azimuths at which more than 6 % of a strip of 17 columns near the horizon is open; 0 if there are
    none.
    """
    reach, near_horizon = 8, np.abs(SINE) < 0.4
    strips = np.stack([(parts.open_luminance * parts.open_size * near_horizon).sum(0),
                       (parts.open_size * near_horizon).sum(0), (SOLID_ANGLE * near_horizon).sum(0)])
    wide = np.concatenate([strips[:, -reach:], strips, strips[:, :reach]], 1)
    sums = np.concatenate([np.zeros((3, 1)), np.cumsum(wide, 1)], 1)
    light, open_size, size = sums[:, 2 * reach + 1:] - sums[:, :-2 * reach - 1]
    cosine = parts.seen_size * np.sqrt(np.maximum(1 - SINE ** 2, 0))
    column = np.arange(WIDTH)
    opposite = np.maximum(-np.cos(2 * np.pi * ((column[None] - column[:, None]) % WIDTH) / WIDTH), 0)
    received, weight = np.stack([(parts.luminance * cosine).sum(0), cosine.sum(0)]) @ opposite
    valid = open_size > 0.06 * size
    wall = _log2(light[valid] / open_size[valid], 1e-4)
    return (wall - _log2(received[valid] / np.maximum(weight[valid], 1e-9), 1e-4)).sum() / max(valid.sum(), 1)


def overview(photograph):
    """Overview numbers [23] of a photograph: visible surfaces compared with the light on them, and what is clipped."""
    parts = Parts(photograph)
    least, sphere = 1e-4, 4 * np.pi
    sky, ground, near = ((mask * parts.open_size) for mask in (SINE > 0.05, SINE < -0.05, SINE < -0.3))
    above, below = parts.seen_size * np.maximum(SINE, 0), parts.seen_size * np.maximum(-SINE, 0)
    from_above = _log2(_mean(parts.luminance, above), least)
    clipped_luminance = np.where(parts.clipped, parts.luminance, 0)
    sizes = region_sizes(parts)
    open_light = parts.open_luminance * parts.open_size
    open_flux = open_light.sum()
    harmonic = (DIRECTION * open_light[..., None]).sum((0, 1)) / max(open_flux, 1e-6)

    def share(part, whole):
        """Logarithm of the ratio of the sums of two maps."""
        return _log2(part.sum() / max(whole.sum(), 1e-9), 1e-3)

    def hue(weights):
        """Logarithm of the ratio of blue to red light."""
        blue, red = ((weights * parts.open_rgb[..., channel]).sum() + 1e-5 for channel in (2, 0))
        return np.log2(blue) - np.log2(red)

    return np.array([
        from_above,
        _log2(_mean(parts.luminance, below), least),
        *_quantiles(_log2(parts.open_luminance, 2e-3) - from_above, near, (0.05, 0.25, 0.5, 0.75, 0.95)),
        share(clipped_luminance * parts.clipped * above, parts.luminance * above),
        share(clipped_luminance * parts.clipped_size, parts.luminance * parts.seen_size),
        _walls(parts),
        _log2(_mean(parts.open_luminance, sky), least) if sky.sum() > 0 else 0.0,
        _log2(parts.clipped_size[SINE > 0].sum(), least),
        _log2(parts.clipped_size[SINE <= 0].sum(), least),
        _log2(sizes.max(initial=0.0), least),
        np.log2(1 + len(sizes)),
        hue(sky), hue(ground), hue(parts.open_size * _ring(parts)),
        harmonic[2], np.hypot(harmonic[0], harmonic[1]),
        _log2(open_flux / sphere, least),
        ((parts.open_luminance < 0.02) * parts.open_size).sum() / sphere,
        (parts.white * SOLID_ANGLE).sum() / max(parts.clipped_size.sum(), 1e-9),
    ])


def _sums(values):
    """Sums [64, 128] over the pixels of each cell, of values [128, 256]."""
    return values.reshape(ROWS, 2, COLUMNS, 2).sum((1, 3))


def by_cell(values):
    """Integrals [64, 128] over the solid angle of each cell, of values [128, 256]."""
    return _sums(values * SOLID_ANGLE)


def _by_block(values):
    """Integrals [512] over blocks of 8 x 8 pixels, row by row."""
    return (values * SOLID_ANGLE).reshape(16, 8, 32, 8).sum((1, 3)).ravel()


def _blocks():
    """Matrix [512, 512] from the flux of blocks to the irradiance of surfaces, one per block, that face the viewer."""
    directions = (DIRECTION * SOLID_ANGLE[..., None]).reshape(16, 8, 32, 8, 3).sum((1, 3)).reshape(-1, 3)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return np.maximum(-(directions @ directions.T), 0)


_BLOCK_SIZE, _FACING = _by_block(np.ones((HEIGHT, WIDTH))), _blocks()


def _enlarged(values):
    """Bilinear interpolation of [16, 32] to [64, 128] between centres; columns wrap around, rows end at the poles."""
    y = np.clip((np.arange(ROWS) + 0.5) / 4 - 0.5, 0, 15)
    top = np.floor(y).astype(int)
    values = values[top] * (1 - (y - top))[:, None] + values[np.minimum(top + 1, 15)] * (y - top)[:, None]
    x = (np.arange(COLUMNS) + 0.5) / 4 - 0.5
    left = np.floor(x).astype(int)
    return values[:, left % 32] * (1 - (x - left)) + values[:, (left + 1) % 32] * (x - left)


def maps(photograph):
    """Maps [64, 128, 14] of a photograph, float32.

    Luminance; the same relative to the irradiance of a surface that faces the viewer, and of one that faces up; red and
    blue relative to green; shares that are clipped, clipped in all channels, in red, in blue; open share; sine of the
    elevation and its absolute value; both irradiances.
    """
    parts = Parts(photograph)
    size, open_size = by_cell(np.ones((HEIGHT, WIDTH))), by_cell(parts.open)
    any_open = open_size > 0
    rgb = np.stack([by_cell(parts.open_rgb[..., channel]) for channel in range(3)], -1)
    rgb /= np.maximum(open_size, 1e-12)[..., None]
    luminance = np.log2(rgb @ LUMINANCE + 1e-3)
    flux, seen = _by_block(parts.luminance * parts.seen), _by_block(parts.seen)
    flux = np.where(seen > 0.01 * _BLOCK_SIZE, flux / np.maximum(seen, 1e-6), 0) * _BLOCK_SIZE
    toward = _enlarged(np.log2(_FACING @ flux / np.pi + 1e-4).reshape(16, 32))
    upward = np.log2((parts.luminance * parts.seen_size * np.maximum(SINE, 0)).sum() / np.pi + 1e-4)
    sine = SINE.reshape(ROWS, 2, COLUMNS, 2).mean((1, 3))

    def hue(channel):
        """Logarithm of the ratio of a channel to green in open pixels."""
        return any_open * np.clip(np.log2((rgb[..., channel] + 1e-3) / (rgb[..., 1] + 1e-3)), -3, 3)

    def clipped_share(channel):
        """Share of each cell that is clipped in a channel."""
        return by_cell(parts.clipped & (parts.rgb[..., channel] > CLIPPED)) / size

    return np.stack([
        any_open * (luminance / 3 + 1), any_open * (luminance - toward) / 2, any_open * (luminance - upward) / 2,
        hue(0), hue(2),
        by_cell(parts.clipped) / size, by_cell(parts.white) / size, clipped_share(0), clipped_share(2),
        open_size / size, sine, np.abs(sine), toward / 2, np.full((ROWS, COLUMNS), upward / 2),
    ], -1).astype(np.float32)


def cosines(light):
    """Cosines [2, 128, 256] at the plane on which contrast is measured, near the dominant light and elsewhere.

    The plane faces up, or towards `light` [3], the direction of the dominant light, if that is not above the horizon.
    The first map is 0 more than 15 degrees from the light, the second within 15 degrees.
    """
    normal = np.array([0.0, 0.0, 1.0]) if light[2] > 0.1 else light
    cosine, dominant = np.maximum(DIRECTION @ normal, 0), DIRECTION @ light > DOMINANT_COSINE
    return np.stack([cosine * dominant, cosine * ~dominant])


@dataclass
class Truth:
    """Visible and hidden light of a photograph, in units of white times steradians.

    `visible` and `truth` [3] are the flux of the photograph and of the true light: all of it, and what the plane of
    `cosines` receives from near the dominant light and from elsewhere. `open` is the flux of open pixels, `hidden`
    [128, 256] the flux that clipping hides, `clipped` [128, 256] the visible flux of clipped pixels, `near` and `far`
    [128, 256] the cosines.
    """
    visible: np.ndarray
    truth: np.ndarray
    open: float
    hidden: np.ndarray
    clipped: np.ndarray
    near: np.ndarray
    far: np.ndarray


def truth(panorama, shot, photograph, light):
    """Compares a photograph with the panorama that it shows; `light` [3] is the panorama's dominant direction."""
    parts, (near, far) = Parts(photograph), cosines(light)
    real = (panorama * 2.0 ** shot.ev * shot.balance) @ LUMINANCE * SOLID_ANGLE
    seen = parts.luminance * SOLID_ANGLE
    visible, true = (np.array([flux.sum(), (flux * near).sum(), (flux * far).sum()]) for flux in (seen, real))
    return Truth(visible, true, (parts.open_luminance * parts.open_size).sum(),
                 np.where(parts.clipped, np.maximum(real - seen, 0), 0), np.where(parts.clipped, seen, 0), near, far)


def truth_of_cells(truth):
    """Maps [64, 128] of a `Truth`: `clipped` and `hidden` flux, and mean cosines `near` and `far` of clipped pixels."""
    clipped = truth.clipped > 0
    size = np.maximum(by_cell(clipped), 1e-12)
    maps = {name: _sums(getattr(truth, name)) for name in ("clipped", "hidden")}
    maps |= {name: by_cell(getattr(truth, name) * clipped) / size for name in ("near", "far")}
    return {name: values.astype(np.float32) for name, values in maps.items()}


def shares(truth, scores):
    """Shares [128, 256] of the hidden light, proportional to the visible flux of clipped pixels times exp(`scores`)."""
    weights = truth.clipped * np.exp(scores - scores.max())
    return weights / max(weights.sum(), 1e-30)


def hidden_flux(truth, amount):
    """Hidden flux of an amount (log2 of hidden flux over that of open pixels), as the program uses it.

    The ratio of total to visible flux is lowered by `CAUTION` stops.
    """
    hidden, visible = truth.open * 2.0 ** np.clip(amount, -8, 8), truth.visible[0]
    return max(visible * ((1 + hidden / visible) * 2.0 ** -CAUTION - 1), 0.0)


def errors(truth, hidden):
    """Errors [2] of mean irradiance and contrast, in stops, with the flux `hidden` [128, 256] added to the picture."""
    total, near, far = truth.visible + [hidden.sum(), (hidden * truth.near).sum(), (hidden * truth.far).sum()]

    def contrast(near, far):
        """Logarithm of the ratio of the dominant light to the rest."""
        return np.log2(max(near / max(far, 1e-9), 1e-4))

    return np.array([np.log2(total / truth.truth[0]), contrast(near, far) - contrast(*truth.truth[1:])])
