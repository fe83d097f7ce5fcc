#!/usr/bin/env python3
"""Compares conversions of colours with OpenColorIO, and view transforms with Blender.

  colour.py LIGHTHARMONY [BLENDER_CONFIG]

Needs the PyPI packages `opencolorio`, `OpenEXR` and `numpy`. BLENDER_CONFIG is `config.ocio` of Blender 4 (in the PyPI package `bpy`:
`bpy/4.5/datafiles/colormanagement/config.ocio`). Everything passes through graphs and files, as for a user. Prints the tables of
docs/evidence/colour.md: differences over 4,096 colours.
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
        views(place, rng, ocio.Config.CreateFromFile(sys.argv[2]) if len(sys.argv) > 2 else None)


def shown(place, light, view):
    """Codes of a view transform, through a PNG of 16 bits, which rounds to 8e-6."""
    write(place / "in.exr", light)
    run(f'a: LoadImage(path: "in.exr"), b: WriteImage(image: "a", path: "shown.png", bits: 16, view: {view})', place)
    run('a: LoadImage(path: "shown.png", encoding: Data), b: WriteExr(image: "a", path: "shown.exr")', place)
    return read(place / "shown.exr")


def views(place, rng, blender):
    print("\n| transform | compared with | colours | median | 95 % | largest |\n|---|---|---|---|---|---|")

    def compare(name, other_name, what, view, light, other, mask=None):
        off = np.abs(shown(place, light, view) - other.clip(0, 1)).max(axis=1)
        off = off if mask is None else off[mask]
        print(f"| {name} | {other_name} | {len(off):,} {what} | {np.median(off):.0e} | {np.quantile(off, 0.95):.0e} | {off.max():.1e} |")

    count = SIDE * SIDE
    inside = np.exp(rng.uniform(-6, 3, (count, 3)))
    # One or two components are negative, down to -20 % of the largest.
    outside = inside.copy()
    for index, channel in enumerate(rng.integers(0, 3, count)):
        outside[index, channel] = -rng.uniform(0, 0.2) * inside[index].max()
    to_aces = ocio.BuiltinTransform("UTILITY - ACES-AP0_to_LINEAR-REC709_BFD", ocio.TRANSFORM_DIR_INVERSE)
    group = ocio.GroupTransform([to_aces, ocio.BuiltinTransform("ACES-OUTPUT - ACES2065-1_to_CIE-XYZ-D65 - SDR-100nit-REC709_2.0"),
                                 ocio.BuiltinTransform("DISPLAY - CIE-XYZ-D65_to_sRGB")])
    aces = ocio.Config.CreateRaw().getProcessor(group)
    greys = np.repeat(inside[:, :1], 3, axis=1)
    for what, light in (("greys", greys), ("in Rec.709", inside), ("outside", outside)):
        compare("ACES 2.0", f"OpenColorIO {ocio.__version__}", what, "Aces", light, applied(aces, light))
    hable = lambda x: (x * (0.15 * x + 0.05) + 0.004) / (x * (0.15 * x + 0.5) + 0.06) - 0.02 / 0.3
    display = (hable(np.minimum(2 * inside, 11.2)) / hable(11.2)).clip(0, 1)
    codes = np.where(display <= 0.0031308, 12.92 * display, 1.055 * display ** (1 / 2.4) - 0.055)
    compare("Filmic", "the published formula", "in Rec.709", "Filmic", inside, codes)
    if blender is None:
        return
    # Entries of the table of AgX, which has 57 per edge: 25 stops in E-Gamut from 2^-12.47393.
    entries = 2 ** (rng.integers(16, 40, (count, 3)) / 56 * 25 - 12.47393)
    entries = applied(blender.getProcessor("Linear FilmLight E-Gamut", "Linear Rec.709"), entries)
    is_inside = (entries > 0).all(axis=1)
    softer = np.exp(rng.uniform(-5, 2, (count, 3)))
    agx = applied(blender.getProcessor("Linear Rec.709", "AgX Base sRGB"), entries)
    compare("AgX", "Blender, at entries of its table", "in Rec.709", "AgX", entries, agx, is_inside)
    compare("AgX", "the same", "outside", "AgX", entries, agx, ~is_inside)
    for name, view, space in [("AgX", "AgX", "AgX Base sRGB"), ("PBR Neutral", "PbrNeutral", "Khronos PBR Neutral sRGB")]:
        other = applied(blender.getProcessor("Linear Rec.709", space), softer)
        compare(name, "Blender, interpolated", "in Rec.709", view, softer, other)


main()
