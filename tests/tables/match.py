#!/usr/bin/env python3
"""Sharpness and grain of an inserted object before and after `Composite(sharpness: Match, grain: Match)`.

    tests/tables/match.py --program lightharmony [--work DIR]

Needs `numpy` and `OpenEXR`. Three backgrounds of one view of the courtyard and of the room of `demo-scene`: the splats, a plate
that is the splats with grain, and the same blurred. Prints, in the band around the object and on the object: the blur of the
sharpest edges in pixels, and the grain in percent of white (display values of green). The object's blur is that of its outline.
"""

import argparse, math, os, subprocess, tempfile

import numpy as np
import OpenEXR

WIDTH, HEIGHT = 640, 360


def graph(place, background, composite):
    plate = 'plate: LoadImage(path: "plate.exr"),' if background != "view" else ""
    return f"""Graph(version: 1, scene: (up: "+z", seed: 3), nodes: (
        demo: DemoScene(place: {place}, splats: 60000, width_px: {WIDTH}, height_px: {HEIGHT}), {plate}
        home: Pose(), placed: Place(object: "demo.object", pose: "home"),
        view: SplatRender(splats: "demo.splats", rig: "demo.rig"),
        trace: PathTrace(receiver: "demo.proxy", objects: ["placed"], rig: "demo.rig", env: "demo.truth_env", samples: 64),
        clean: Denoise(without: "trace.without", with: "trace.with", object: "trace.object", depth: "trace.depth",
                       normal: "trace.normal", variance: "trace.variance"),
        shadow: ShadowRatio(without: "clean.without", with: "clean.with"),
        final: Composite(background: "{background}", object: "clean.object", shadow: "shadow", {composite}),
        layers: WriteExr(image: "final", layers: ["{background.replace('view', 'view.colour')}", "final.object", "final.shadow"],
                         names: ["background", "object", "shadow"], encoding: Linear, path: "layers.exr"),
        shown: WriteImage(image: "final", path: "final.png"),
    ))"""


def run(args, place, background, composite, out):
    with open(os.path.join(args.work, "graph.ron"), "w") as file:
        file.write(graph(place, background, composite))
    command = [args.program, "run", "graph.ron", "--out", out, "--cache", "cache"]
    done = subprocess.run(command, cwd=args.work, capture_output=True, text=True)
    if done.returncode not in (0, 3):
        raise SystemExit(done.stderr + done.stdout)
    with OpenEXR.File(os.path.join(args.work, out, "layers.exr"), separate_channels=True) as file:
        channels = file.channels()
        layer = lambda name, letters: np.stack([channels[f"{name}{c}"].pixels.astype(float) for c in letters], -1)
        return layer("", "RGB"), layer("background.", "RGB"), channels["object.A"].pixels.astype(float)


def display(light):
    light = light.clip(0, 1)
    return np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)


def edges(values, free, contrast=0.12):
    """Blur of steps along rows and columns, as contrast over the largest slope."""
    found = []
    for v, ok in ((values, free), (values.T, free.T)):
        windows = np.lib.stride_tricks.sliding_window_view(v, 9, axis=1)
        use = np.lib.stride_tricks.sliding_window_view(ok, 9, axis=1).all(axis=-1)
        slope = 0.5 * (windows[..., 2:] - windows[..., :-2])
        sign = np.sign(slope[..., 3])
        step = (windows[..., 8] - windows[..., 0]) * sign
        steady = ((windows[..., 1:] - windows[..., :-1]) * sign[..., None] > -0.1 * step[..., None]).all(axis=-1)
        steepest = (slope * sign[..., None] <= np.abs(slope[..., 3:4]) + 1e-12).all(axis=-1)
        good = use & steady & steepest & (step > contrast)
        wide = step[good] / (np.abs(slope[..., 3][good]) * math.sqrt(2 * math.pi))
        found.append(np.sqrt((wide**2 - 1 / 3).clip(0)))
    return np.concatenate(found)


def grain(values, free, side=12):
    residual = np.zeros_like(values)
    kernel = [[1, -2, 1], [-2, 4, -2], [1, -2, 1]]
    for dy in range(3):
        for dx in range(3):
            residual[1:-1, 1:-1] += kernel[dy][dx] * values[dy:HEIGHT - 2 + dy, dx:WIDTH - 2 + dx]
    found = []
    for y in range(1, HEIGHT - side, side):
        for x in range(1, WIDTH - side, side):
            if free[y - 1:y + side + 1, x - 1:x + side + 1].all():
                found.append(np.sqrt(np.mean(residual[y:y + side, x:x + side] ** 2)) / 6)
    return np.quantile(found, 0.2) if len(found) >= 4 else float("nan")


def measure(name, what, picture, background, alpha):
    rows, columns = np.nonzero(alpha > 0)
    high, wide = np.ptp(rows), np.ptp(columns)
    band = np.zeros_like(alpha, bool)
    band[max(rows.min() - high, 0):rows.max() + high, max(columns.min() - wide, 0):columns.max() + wide] = True
    outside, inside = band & (alpha == 0), alpha == 1
    green = display(picture)[..., 1]
    around = np.quantile(edges(display(background)[..., 1], outside), 0.1)
    # The outline: the alpha itself is a step of 1.
    outline = np.median(edges(alpha, band, 0.9))
    print(f"| {name} | {what} | {around:.2f} | {outline:.2f} | {100 * grain(display(background)[..., 1], outside):.2f} | {100 * grain(green, inside):.2f} |")


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--program", default="lightharmony")
    parser.add_argument("--work", default=None)
    args = parser.parse_args()
    args.work = args.work or tempfile.mkdtemp()
    os.makedirs(args.work, exist_ok=True)
    print("| background | composite | blur around (px) | blur of the object (px) | grain around (%) | grain of the object (%) |")
    print("|---|---|---|---|---|---|")
    rng = np.random.default_rng(1)
    for place in ("Courtyard", "Room"):
        _, view, _ = run(args, place, "view", "sharpness: Keep", f"{place}-view")
        backgrounds = {"splats": None}
        codes = display(view)
        rows = np.exp(-0.5 * (np.arange(-6, 7) / 1.5) ** 2)
        soft = view.copy()
        for axis in (0, 1):
            soft = np.apply_along_axis(lambda line: np.convolve(np.pad(line, 6, "edge"), rows / rows.sum(), "valid"), axis, soft)
        for name, light in (("plate with grain", view), ("soft plate with grain", soft)):
            codes = (display(light) + rng.normal(0, 0.02, light.shape)).clip(0, 1)
            backgrounds[name] = np.where(codes <= 0.04045, codes / 12.92, ((codes + 0.055) / 1.055) ** 2.4)
        for name, plate in backgrounds.items():
            if plate is not None:
                OpenEXR.File({}, {"RGB": np.ascontiguousarray(plate, np.float32)}).write(os.path.join(args.work, "plate.exr"))
            for what, composite in (("as rendered", "sharpness: Keep"), ("matched", "sharpness: Match, grain: Match")):
                out = f"{place}-{name}-{what}".replace(" ", "-")
                layers = run(args, place, "view" if plate is None else "plate", composite, out)
                measure(f"{place.lower()}, {name}", what, *layers)


main()
