"""OpenEXR and PNG files, and display values. NumPy, OpenEXR and Pillow.

Pictures are float32 arrays (height, width, channels), linear Rec. 709, 1 is white at EV 0; row 0 is the top.
"""
import os

import numpy as np
import OpenEXR
from PIL import Image


def write_exr(path, picture, channels="RGB"):
    """Writes 32-bit floats, one channel per letter, first to a temporary name, so that a file is complete or absent."""
    picture = np.asarray(picture, np.float32)
    planes = {c: np.ascontiguousarray(picture[..., k] if picture.ndim == 3 else picture) for k, c in enumerate(channels)}
    draft = f"{path}.part"
    OpenEXR.File({"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}, planes).write(draft)
    os.replace(draft, path)


def read_exr(path, channels="RGB"):
    """Channels by their name, or by the end of the name after a dot."""
    with OpenEXR.File(str(path), separate_channels=True) as file:
        planes = {name: np.array(plane.pixels, np.float32) for name, plane in file.channels().items()}
    of = lambda end: planes[end] if end in planes else next(p for name, p in planes.items() if name.endswith("." + end))
    return np.stack([of(c) for c in channels], -1)


def read_layers(path, layers):
    """Layers of a multilayer file of Blender, by the end of their name: `{"Combined": "RGBA", ..}`."""
    with OpenEXR.File(str(path), separate_channels=True) as file:
        planes = {name: np.array(plane.pixels, np.float32) for name, plane in file.channels().items()}
    return {layer: np.stack([next(p for n, p in planes.items() if n.endswith(f"{layer}.{c}")) for c in channels], -1)
            for layer, channels in layers.items()}


def display(linear):
    """Display values 0 to 1: clipped, with the sRGB curve."""
    c = np.clip(linear, 0, 1)
    return np.where(c <= 0.0031308, 12.92 * c, 1.055 * np.power(np.maximum(c, 1e-9), 1 / 2.4) - 0.055)


def linear(shown):
    """Inverse of the sRGB curve."""
    return np.where(shown <= 0.04045, shown / 12.92, ((shown + 0.055) / 1.055) ** 2.4)


def codes(linear_):
    return np.round(255 * display(linear_)).astype(np.uint8)


def write_png(path, values):
    """8-bit codes (height, width[, 3])."""
    draft = f"{path}.part"
    Image.fromarray(values).save(draft, format="PNG", optimize=False)
    os.replace(draft, path)


def read_png(path):
    return np.asarray(Image.open(path))
