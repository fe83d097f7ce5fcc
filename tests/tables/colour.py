#!/usr/bin/env python3
"""Compares conversions of colours with OpenColorIO, and view transforms with Blender.

  colour.py LIGHTHARMONY [BLENDER_CONFIG]

Needs the PyPI packages `opencolorio`, `OpenEXR` and `numpy`. BLENDER_CONFIG is `config.ocio` of Blender 4 (in the PyPI package `bpy`:
`bpy/4.5/datafiles/colormanagement/config.ocio`). Everything passes through graphs and files, as for a user. Prints the table of
docs/evidence/colour.md: the largest and the median difference over 4,096 colours.
"""
import pathlib
import subprocess
import sys
import tempfile

import numpy as np
import OpenEXR
import PyOpenColorIO as ocio

SIDE = 64
PROGRAM = sys.argv[1]
CAMERAS = {
    "AcesCg": "ACEScg_to_ACES2065-1",
    "AcesCct": "ACEScct_to_ACES2065-1",
    "LogC3": "ARRI_ALEXA-LOGC-EI800-AWG_to_ACES2065-1",
    "LogC4": "ARRI_LOGC4_to_ACES2065-1",
    "SLog3": "SONY_SLOG3-SGAMUT3_to_ACES2065-1",
    "SLog3Cine": "SONY_SLOG3-SGAMUT3.CINE_to_ACES2065-1",
    "VLog": "PANASONIC_VLOG-VGAMUT_to_ACES2065-1",
}


def run(graph, place):
    (place / "graph.ron").write_text(f'Graph(version: 1, scene: (up: "+z"), nodes: ({graph}))')
    command = [PROGRAM, "run", "graph.ron", "--cache", "cache", "--out", "."]
    done = subprocess.run(command, cwd=place, capture_output=True, text=True)
    if done.returncode:
        sys.exit(done.stderr)


def write(path, colours):
    OpenEXR.File({}, {"RGB": colours.reshape(SIDE, SIDE, 3).astype(np.float32)}).write(str(path))


def read(path):
    return OpenEXR.File(str(path)).channels()["RGB"].pixels.reshape(-1, 3).astype(np.float64)


def applied(processor, colours):
    out = np.ascontiguousarray(colours.astype(np.float32))
    processor.getOptimizedCPUProcessor(ocio.OPTIMIZATION_LOSSLESS).applyRGB(out)
    return out.astype(np.float64)


def row(name, own, other, size):
    off = np.abs(own - other) / size
    print(f"| {name} | {off.max():.1e} | {np.median(off):.1e} |")


def main():
    rng = np.random.default_rng(7)
    config = ocio.Config.CreateRaw()
    print("| conversion | largest difference | median |\n|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        place = pathlib.Path(folder)
        for space, name in CAMERAS.items():
            colours = rng.uniform(0.05, 0.9, (SIDE * SIDE, 3)).astype(np.float32)
            for what in ["colours", "greys"]:
                if what == "greys":
                    colours = np.repeat(colours[:, :1], 3, axis=1)
                write(place / "in.exr", colours)
                run(f'a: LoadImage(path: "in.exr", encoding: {space}), '
                    'b: WriteExr(image: "a", path: "out.exr", encoding: Aces2065)', place)
                other = applied(config.getProcessor(ocio.BuiltinTransform(name)), colours)
                size = np.abs(other).max(axis=1, keepdims=True)
                row(f"{space} to ACES2065-1, {what}, relative", read(place / "out.exr"), other, size)
        light = np.exp(rng.uniform(-6, 3, (SIDE * SIDE, 3))).astype(np.float32)
        write(place / "in.exr", light)
        for encoding in ["LinearP3", "LinearRec2020", "AcesCg", "Aces2065"]:
            run(f'a: LoadImage(path: "in.exr"), b: WriteExr(image: "a", path: "there.exr", encoding: {encoding})', place)
            run('a: LoadImage(path: "there.exr"), b: WriteExr(image: "a", path: "back.exr")', place)
            size = light.max(axis=1, keepdims=True)
            row(f"{encoding} and back, relative", read(place / "back.exr"), light.astype(np.float64), size)
        if len(sys.argv) > 2:
            blender = ocio.Config.CreateFromFile(sys.argv[2])
            for view, space in [("AgX", "AgX Base sRGB"), ("PbrNeutral", "Khronos PBR Neutral sRGB")]:
                run(f'a: LoadImage(path: "in.exr"), b: WriteImage(image: "a", path: "shown.png", bits: 16, view: {view})', place)
                run('a: LoadImage(path: "shown.png", encoding: Data), b: WriteExr(image: "a", path: "shown.exr")', place)
                other = applied(blender.getProcessor("Linear Rec.709", space), light)
                row(f"{view} and Blender, of the display's range", read(place / "shown.exr"), other.clip(0, 1), 1.0)


main()
