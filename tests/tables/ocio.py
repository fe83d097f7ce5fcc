#!/usr/bin/env python3
"""Compares `run-ocio` with OpenColorIO, through graphs and files, and shows its messages for mistakes.

    tests/tables/ocio.py LIGHTHARMONY [PYTHON]

PYTHON is the Python that the node runs, by default the one of this script; both need the PyPI package `opencolorio`, and this one `OpenEXR`
and `numpy`. Prints the table of docs/evidence/colour.md: over 65,536 colours from e^-9 to e^7 per channel, a third with a negative
component, the number of values that differ from OpenColorIO in 32-bit floats, and the difference of `load-image` and `write-exr` for the
conversions that they know as well. Then the largest difference of tables of 33, 65 and 129 entries per edge that stand for a view, and
what the node says about mistakes.
"""
import pathlib
import subprocess
import sys
import tempfile

import numpy as np
import OpenEXR
import PyOpenColorIO as ocio

SIDE = 256
PROGRAM, PYTHON = sys.argv[1], sys.argv[2] if len(sys.argv) > 2 else sys.executable
CG, STUDIO = "ocio://cg-config-v2.1.0_aces-v1.3_ocio-v2.3", "ocio://studio-config-v2.1.0_aces-v1.3_ocio-v2.3"
WORKING = "Linear Rec.709 (sRGB)"


def run(graph, place, fails=False):
    graph = graph.replace("RunOcio(", f'RunOcio(program: Some("{PYTHON}"), ')
    (place / "graph.ron").write_text(f'Graph(version: 1, scene: (up: "+z"), nodes: ({graph}))')
    command = [PROGRAM, "run", "graph.ron", "--cache", "cache", "--out", "."]
    done = subprocess.run(command, cwd=place, capture_output=True, text=True)
    if (done.returncode != 0) != fails:
        sys.exit(done.stderr)
    return done.stderr


def write(path, colours):
    OpenEXR.File({}, {"RGB": colours.reshape(SIDE, SIDE, 3).astype(np.float32)}).write(str(path))


def read(path):
    return OpenEXR.File(str(path)).channels()["RGB"].pixels.reshape(-1, 3)


def applied(config, transform, colours):
    out = np.ascontiguousarray(colours.astype(np.float32))
    processor = ocio.Config.CreateFromFile(config).getProcessor(transform)
    processor.getOptimizedCPUProcessor(ocio.OPTIMIZATION_LOSSLESS).applyRGB(out)
    return out


def text(name):
    return f'Some("{name}")'


def main():
    rng = np.random.default_rng(7)
    light = np.exp(rng.uniform(-9, 7, (SIDE * SIDE, 3))).astype(np.float32)
    light[::3, 1] *= -0.1
    codes = rng.uniform(0, 1, (SIDE * SIDE, 3)).astype(np.float32)
    space = lambda a, b: ocio.ColorSpaceTransform(src=a, dst=b)
    shown = lambda display, view: ocio.DisplayViewTransform(src=WORKING, display=display, view=view)
    cases = [
        (CG, "ACEScg", None, None, light), (CG, None, "ACES2065-1", None, light), (CG, None, "ACEScct", None, light),
        (STUDIO, "Linear REDWideGamutRGB", None, None, light), (STUDIO, "Log3G10 REDWideGamutRGB", None, None, codes),
        (STUDIO, "CanonLog3 CinemaGamut D55", "ACEScg", None, codes),
        (CG, None, None, ("sRGB - Display", "ACES 1.0 - SDR Video"), light),
        (STUDIO, None, None, ("Rec.2100-PQ - Display", "ACES 1.1 - HDR Video (1000 nits & Rec.2020 lim)"), light),
    ]
    print("| from | to | values that differ | largest difference |\n|---|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        place = pathlib.Path(folder)
        for config, source, target, view, colours in cases:
            write(place / "in.exr", colours)
            fields = f'builtin: "{config}"'
            fields += f", from: {text(source)}" if source else ""
            fields += f", to: {text(target)}" if target else ""
            fields += f", display: {text(view[0])}, view: {text(view[1])}" if view else ""
            encoding = ", encoding: Data" if source else ""
            run(f'a: LoadImage(path: "in.exr"{encoding}), b: RunOcio(image: "a", {fields}), '
                'c: WriteExr(image: "b", path: "out.exr")', place)
            transform = shown(*view) if view else space(source or WORKING, target or WORKING)
            own, other = read(place / "out.exr"), applied(config, transform, colours)
            name = ", ".join(view) if view else target or "working space"
            print(f"| {source or 'working space'} | {name} | {(own.view(np.uint32) != other.view(np.uint32)).sum()} of {own.size} | "
                  f"{np.abs(own - other).max():.1e} |")
        baked(place)
        mistakes(place)


def baked(place):
    """Tables from ACEScct codes to the codes of a view, applied linearly within tetrahedra, as `write-image(lut:)` does."""
    rng = np.random.default_rng(8)
    codes = rng.uniform(0.07, 0.9, (SIDE * SIDE, 3)).astype(np.float32)
    transform = ocio.GroupTransform([ocio.ColorSpaceTransform(src="ACEScct", dst=WORKING), ocio.DisplayViewTransform(
        src=WORKING, display="sRGB - Display", view="ACES 1.0 - SDR Video")])
    exact = applied(CG, transform, codes)
    for size in (33, 65, 129):
        steps = np.linspace(0, 1, size, dtype=np.float32)
        grid = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), -1).reshape(-1, 3)
        entries = applied(CG, transform, grid)
        rows = entries.reshape(size, size, size, 3).transpose(2, 1, 0, 3).reshape(-1, 3)
        body = "\n".join(" ".join(f"{v:.7f}" for v in row) for row in rows)
        (place / "look.cube").write_text(f"LUT_3D_SIZE {size}\n{body}\n")
        ocio.ClearAllCaches()
        lut = ocio.FileTransform(str(place / "look.cube"), interpolation=ocio.INTERP_TETRAHEDRAL)
        off = np.abs(applied(CG, lut, codes) - exact)
        print(f"table of {size} from ACEScct: largest {off.max():.1e}, median {np.median(off):.1e}, 99 % {np.quantile(off, 0.99):.1e}")


def mistakes(place):
    (place / "broken.ocio").write_text("ocio_profile_version: 2\nroles: [\n")
    (place / "luts.ocio").write_text(
        "ocio_profile_version: 2\nroles: {default: a}\nsearch_path: luts\nfile_rules: [!<Rule> {name: Default, colorspace: a}]\n"
        "displays: {d: [!<View> {name: v, colorspace: b}]}\ncolorspaces:\n"
        "  - !<ColorSpace> {name: a}\n  - !<ColorSpace> {name: b, from_scene_reference: !<FileTransform> {src: look.spi1d}}\n")
    write(place / "in.exr", np.ones((SIDE * SIDE, 3)))
    for fields in [
        'to: Some("ACESgc")', 'display: Some("sRGB")', 'display: Some("sRGB - Display"), view: Some("Film")',
        'config: Some("broken.ocio"), to: Some("a")', 'config: Some("luts.ocio"), from: Some("a"), to: Some("b")',
        'config: Some("luts.ocio"), to: Some("b")', 'builtin: "ocio://nope", to: Some("a")',
    ]:
        error = run(f'a: LoadImage(path: "in.exr"), b: RunOcio(image: "a", {fields}), c: WriteExr(image: "b", path: "out.exr")', place, True)
        print("---", fields, error, sep="\n")


main()
