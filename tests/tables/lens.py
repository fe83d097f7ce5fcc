#!/usr/bin/env python3
"""Compares the outline of an object seen through a distorted lens with OpenCV.

    tests/tables/lens.py PROGRAM FOLDER

A box is traced at three places for each of three lens models. OpenCV projects the edges of its faces in 200 steps each and fills
them on a grid of 32 by 32 samples per pixel. At a pixel of the outline, the difference of alpha is about the distance of the two
outlines in pixels; it is averaged over the pixels of the outline within 5 by 5 pixels, since alpha has noise. OpenCV also fills
the samples that an outline touches, which moves its outlines outwards by half a sample, 0.016 pixels.

Needs the PyPI packages numpy, scipy, opencv-python-headless and OpenEXR.
"""

import json
import pathlib
import subprocess
import sys

import cv2
import numpy as np
import OpenEXR
from scipy.ndimage import uniform_filter

SIZE = (640, 480)
K = np.array([[500, 0, 330.0], [0, 505, 235.0], [0, 0, 1]])
GRID = 32
SAMPLES = 100
# Translation in metres, and scale.
PLACES = [((0, 0, 0), 1.0), ((-1.1, 0, 0.75), 0.7), ((1.2, 0.4, -0.8), 0.9)]
CORNERS = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
FACES = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
# The camera of nerfstudio: y up, z backwards. It looks along +y of the world, from 3 metres away.
WORLD_FROM_CAMERA = np.array([[1, 0, 0, 0], [0, 0, -1, -3], [0, 1, 0, 0], [0, 0, 0, 1.0]])
GRAPH = """Graph(version: 1, scene: (up: "+z", metres_per_unit: 1.0, seed: 7), nodes: (
    cams: LoadCameras(path: "cameras.json", distortion: Apply), box: LoadObject(path: "box.obj"),
    pose: Pose(translation: {}, yaw_deg: {:.1f}, scale: {}), placed: Place(object: "box", pose: "pose"),
    low: Pose(translation: (0.0, 0.0, -3.0)), floor: Plane(at: "low", width_metres: 1.0),
    env: LoadEnvironment(path: "white.exr"),
    trace: PathTrace(receiver: "floor", objects: ["placed"], rig: "cams", env: "env", samples: {}, contact_metres: Some(0.0)),
    save: WriteExr(image: "trace.object", path: "object.exr"),
))
"""


def of_opencv(coefficients, fisheye=False):
    """The function that projects points in the frame of the camera, and nothing else."""
    zero, d = np.zeros(3), np.array(coefficients, float)
    if fisheye:
        return lambda points: cv2.fisheye.projectPoints(points.reshape(-1, 1, 3), zero, zero, K, d)[0].reshape(-1, 2)
    return lambda points: cv2.projectPoints(points, zero, zero, K, d)[0].reshape(-1, 2)


MODELS = {
    "OPENCV": ({"k1": -0.28, "k2": 0.07, "p1": 1.2e-3, "p2": -8e-4}, of_opencv([-0.28, 0.07, 1.2e-3, -8e-4])),
    "FULL_OPENCV": (
        {"k1": 0.3, "k2": 0.1, "k3": 0.02, "k4": 0.2, "k5": 0.05, "k6": 0.004, "p1": 5e-4, "p2": -3e-4},
        of_opencv([0.3, 0.1, 5e-4, -3e-4, 0.02, 0.2, 0.05, 0.004]),
    ),
    "OPENCV_FISHEYE": (
        {"k1": 0.03, "k2": -0.01, "k3": 4e-3, "k4": -7e-4},
        of_opencv([0.03, -0.01, 4e-3, -7e-4], fisheye=True),
    ),
}


def files(folder):
    """Writes the object and a white environment."""
    lines = [f"v {x} {y} {z}" for x, y, z in CORNERS]
    lines += ["f " + " ".join(str(i + 1) for i in face) for face in FACES]
    (folder / "box.obj").write_text("\n".join(lines) + "\n")
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, {"RGB": np.ones((8, 16, 3), "float32")}).write(str(folder / "white.exr"))


def traced(program, folder, model, keys, place, yaw):
    """Alpha of the object."""
    lens = {"camera_model": model, "fl_x": K[0, 0], "fl_y": K[1, 1], "cx": K[0, 2], "cy": K[1, 2], **keys}
    frame = {"file_path": "a.png", "transform_matrix": WORLD_FROM_CAMERA.tolist()}
    cameras = {"w": SIZE[0], "h": SIZE[1], **lens, "frames": [frame]}
    (folder / "cameras.json").write_text(json.dumps(cameras))
    (folder / "graph.ron").write_text(GRAPH.format(place[0], yaw, place[1], SAMPLES))
    command = [program, "run", "graph.ron", "--out", "out", "--cache", "cache"]
    subprocess.run(command, cwd=folder, check=True, capture_output=True)
    return OpenEXR.File(str(folder / "out/object.exr")).channels()["RGBA"].pixels[..., 3].astype(float)


def filled(project, place, yaw):
    """Share of each pixel that the faces cover."""
    # Objects have y up, the world has z up.
    points = np.stack([CORNERS[:, 0], -CORNERS[:, 2], CORNERS[:, 1]], 1) * place[1]
    turn = np.radians(yaw)
    sin, cos = np.sin(turn), np.cos(turn)
    points = points @ np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]]).T + np.array(place[0])
    camera_from_world = np.linalg.inv(WORLD_FROM_CAMERA)
    points = (points @ camera_from_world[:3, :3].T + camera_from_world[:3, 3]) * np.array([1, -1, -1])
    shares = np.arange(200)[:, None] / 200
    outlines = []
    for face in FACES:
        edges = [points[a] + (points[b] - points[a]) * shares for a, b in zip(face, face[1:] + face[:1])]
        outlines.append(project(np.concatenate(edges)))
    everything = np.concatenate(outlines)
    x0, y0 = np.floor(everything.min(0) - 2).astype(int).clip(0)
    x1, y1 = np.minimum(np.ceil(everything.max(0) + 2).astype(int), SIZE)
    fine = np.zeros(((y1 - y0) * GRID, (x1 - x0) * GRID), np.uint8)
    for outline in outlines:
        at = (outline - [x0, y0]) * GRID - 0.5
        cv2.fillPoly(fine, [np.round(at * 64).astype(np.int32)], 1, shift=6)
    cover = np.zeros(SIZE[::-1])
    cover[y0:y1, x0:x1] = fine.reshape(y1 - y0, GRID, x1 - x0, GRID).mean((1, 3))
    return cover


def main():
    program, folder = str(pathlib.Path(sys.argv[1]).resolve()), pathlib.Path(sys.argv[2])
    folder.mkdir(parents=True, exist_ok=True)
    files(folder)
    print("| lens | pixels of the outline | mean distance (px) | largest (px) |")
    print("|---|---|---|---|")
    for model, (keys, project) in MODELS.items():
        pixels, means, largest = 0, [], 0.0
        for number, place in enumerate(PLACES):
            yaw = 17 + 31 * number
            alpha, cover = traced(program, folder, model, keys, place, yaw), filled(project, place, yaw)
            outline = ((cover > 0) & (cover < 1)) | ((alpha > 0) & (alpha < 1))
            difference = (alpha - cover) * outline
            near = uniform_filter(difference, 5) / np.maximum(uniform_filter(outline.astype(float), 5), 1e-9)
            pixels += outline.sum()
            means.append(difference[outline].mean())
            largest = max(largest, np.abs(near[outline]).max())
            assert np.abs((alpha - cover)[~outline]).max() < 0.02
        print(f"| {model} | {pixels} | {np.mean(means):.4f} | {largest:.3f} |", flush=True)


if __name__ == "__main__":
    main()
