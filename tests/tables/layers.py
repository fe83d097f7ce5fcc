#!/usr/bin/env python3
"""Checks the layers that graphs/files.ron writes with the reader of OpenEXR: names, the picture from its parts, the camera.

    tests/tables/layers.py layers.exr EYE_X EYE_Y EYE_Z

Needs `OpenEXR` and `numpy`. EYE is the position of the camera in the graph. Prints the channels, the largest difference between the
default layer and the formula, and the largest errors of the camera: of the position of its eye, and of the depth of the world points
that the pixels show, found by the inverse of `worldToNDC` and transformed by `worldToCamera`.
"""
import sys

import numpy as np
import OpenEXR

path, *eye = sys.argv[1:]
with OpenEXR.File(path, separate_channels=True) as file:
    channels = {name: channel.pixels.astype(np.float64) for name, channel in file.channels().items()}
    header = file.header()
print("channels:", " ".join(sorted(channels)))
layer = lambda name, letters: np.stack([channels[f"{name}{letter}"] for letter in letters], -1)
background, shadow, thing = layer("background.", "RGB"), layer("shadow.", "RGB"), layer("object.", "RGB")
alpha = layer("object.", "A")
front = layer("front.", "RGB") if "front.R" in channels else np.zeros_like(background)
hidden = layer("front.", "A") if "front.A" in channels else np.zeros_like(alpha)
kept = np.minimum(front, background)
picture = ((background - kept) * shadow + kept) * (1 - alpha) + front * alpha + thing * (1 - hidden)
print(f"picture and formula: {np.abs(picture - layer('', 'RGB')).max():.1e}")
world_to_camera, world_to_ndc = (np.array(header[name], float).reshape(4, 4) for name in ("worldToCamera", "worldToNDC"))
origin = np.array([0, 0, 0, 1.0]) @ np.linalg.inv(world_to_camera)
print(f"eye: {np.abs(origin[:3] - np.array(eye, float)).max():.1e}")
depth = channels["depth.Z"]
rows, columns = np.nonzero(np.isfinite(depth))
w = depth[rows, columns]
u, v = (columns + 0.5) / depth.shape[1], (rows + 0.5) / depth.shape[0]
# z is 1 - 1 / depth before the division by w.
points = np.stack([u * w, v * w, w - 1, w], -1) @ np.linalg.inv(world_to_ndc)
points /= points[:, 3:]
seen = points @ world_to_camera
print(f"depth: {np.abs(seen[:, 2] / w - 1).max():.1e} of itself, over {len(w)} pixels")
top, left = seen[rows < depth.shape[0] / 4], seen[columns < depth.shape[1] / 4]
print("y points up:", bool((top[:, 1] > 0).all()), " x points right:", bool((left[:, 0] < 0).all()))
