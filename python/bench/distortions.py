#!/usr/bin/env python3
"""Pictures with known faults, made from the truth of a case: what a metric must rank rightly.

    python distortions.py CASE OUT          OUT/FAULT-STRENGTH/VIEW.png, strengths 1 to 4, and OUT/pair-N-{better,worse}/VIEW.png
    python distortions.py --list

A picture is background * S on pixels of the background, and the object over it. S is the ratio of the pictures with and
without the object; behind the object it is that of the nearest pixel around it. Lengths in centimetres are those of an
object of 50 cm, and grow with `scale` of the pose. NumPy, SciPy, OpenEXR and Pillow; no renderer.
"""
import argparse
import json
import pathlib
import zlib

import numpy as np
from scipy import ndimage

import pictures

STRENGTHS = (1, 2, 3, 4)


class Truth:
    """The truth of a view in layers: background, ratio, object and alpha."""

    def __init__(self, case, view):
        case = pathlib.Path(case)
        self.about = json.loads((case / "case.json").read_text())
        truth = case / "truth" / view
        self.without, self.with_ = pictures.read_exr(truth / "without.exr"), pictures.read_exr(truth / "with.exr")
        self.alpha = pictures.read_exr(truth / "alpha.exr", "Y")
        outside = self.alpha[..., 0] <= 0
        ratio = (self.with_ + 1e-4) / (self.without + 1e-4)
        index = ndimage.distance_transform_edt(~outside, return_distances=False, return_indices=True)
        self.ratio = ratio[tuple(index)]
        # Premultiplied: what the picture has beyond the background that shows through the edge.
        self.object = np.where(outside[..., None], 0, np.maximum(0, self.with_ - (1 - self.alpha) * self.without * self.ratio))
        cover = self.alpha[..., 0] > 0.5
        rows, columns = np.where(cover) if cover.any() else (np.arange(2), np.arange(2))
        self.box = rows.min(), rows.max(), columns.min(), columns.max()
        # Pixels per centimetre of an object of 50 cm, at the distance of the object.
        rig = json.loads((case / "views.json").read_text())
        frames = {pathlib.Path(f["file_path"]).stem: f for f in rig["frames"]}
        eye = np.array(frames[view]["transform_matrix"])[:3, 3]
        pose = self.about["pose"]
        distance = np.linalg.norm(eye - np.array(pose["translation"]))
        self.px_per_cm = 0.01 * pose["scale"] * frames[view].get("fl_x", rig.get("fl_x")) / distance
        reflection = truth / "reflection.png"
        self.reflection = pictures.read_png(reflection) > 127 if reflection.exists() else np.zeros(cover.shape, bool)
        self.random = np.random.default_rng(zlib.crc32(f"{self.about['name']}/{view}".encode()))

    def start(self):
        return {"background": self.without.copy(), "ratio": self.ratio.copy(), "object": self.object.copy(),
                "alpha": self.alpha.copy(), "truth": self}


def compose(layers):
    """The picture (linear) from its layers."""
    return layers["background"] * layers["ratio"] * (1 - layers["alpha"]) + layers["object"]


def moved(picture, down, right, fill):
    """Shifts by a fraction of pixels, linear between pixels; what comes from outside is `fill`."""
    return np.stack([ndimage.shift(picture[..., k], (down, right), order=1, mode="constant", cval=fill)
                     for k in range(picture.shape[-1])], -1)


def colour_of(layers):
    """The object's colours, not premultiplied, extended beyond its edge by the nearest pixel."""
    alpha = layers["alpha"][..., 0]
    index = ndimage.distance_transform_edt(alpha <= 0.5, return_distances=False, return_indices=True)
    return (layers["object"] / np.maximum(layers["alpha"], 1e-3))[tuple(index)]


def paint(layers, colours):
    layers["object"] = colours * layers["alpha"]


def luminance(c):
    return (c * np.array([0.2126, 0.7152, 0.0722])).sum(-1, keepdims=True)


# The faults of the shadow: strengths are 1 to 4.

def shadow_shift(l, s):
    """The shadow moved to the side by 3, 6, 12, 24 cm."""
    l["ratio"] = moved(l["ratio"], 0, 3 * 2 ** (s - 1) * l["truth"].px_per_cm, 1)


def shadow_detached(l, s):
    """The shadow moved towards the viewer by 2, 4, 8, 16 cm."""
    l["ratio"] = moved(l["ratio"], 2 * 2 ** (s - 1) * l["truth"].px_per_cm, 0, 1)


def shadow_doubled(l, s):
    """A second shadow to the left of the first, with a quarter to the full strength."""
    second = moved(l["ratio"], 0, -20 * l["truth"].px_per_cm, 1)
    l["ratio"] = l["ratio"] * (1 + 0.25 * s * (np.minimum(second, 1) - 1))


def shadow_dark(l, s):
    """The logarithm of the shadow multiplied by 1.25, 1.5, 2, 3."""
    l["ratio"] = np.where(l["ratio"] < 1, l["ratio"] ** (1.25, 1.5, 2, 3)[s - 1], l["ratio"])


def shadow_light(l, s):
    """The logarithm of the shadow multiplied by 0.8, 0.6, 0.4, 0.2."""
    l["ratio"] = np.where(l["ratio"] < 1, l["ratio"] ** (1 - 0.2 * s), l["ratio"])


def shadow_colour(l, s):
    """A blue tint in the shadow: red multiplied by the ratio to the power of s / 4 once more, blue divided by it."""
    dark = np.minimum(luminance(l["ratio"]), 1)
    l["ratio"] = l["ratio"] * np.concatenate([dark ** (0.25 * s), dark ** 0, dark ** (-0.25 * s)], -1)


def shadow_soft(l, s):
    """The shadow blurred with a deviation of 2, 4, 8, 16 cm."""
    sigma = 2 * 2 ** (s - 1) * l["truth"].px_per_cm
    l["ratio"] = np.stack([ndimage.gaussian_filter(l["ratio"][..., k], sigma) for k in range(3)], -1)


def shadow_hard(l, s):
    """The shadow with its soft edge replaced by a hard edge, at a quarter to the full share."""
    depth = 1 - np.minimum(luminance(l["ratio"]), 1)
    strongest = np.percentile(depth, 99.5)
    hard = np.where(depth > 0.5 * strongest, 1 - strongest, 1.0)
    l["ratio"] = l["ratio"] * (1 - 0.25 * s) + hard * 0.25 * s


def shadow_mirrored(l, s):
    """The share s / 4 of the shadow on the wrong side of the object."""
    _, _, left, right = l["truth"].box
    other = moved(l["ratio"][:, ::-1], 0, left + right - (l["ratio"].shape[1] - 1), 1)
    l["ratio"] = l["ratio"] * (1 - 0.25 * s) + other * 0.25 * s


def shadow_no_contact(l, s):
    """The shadow missing near the foot of the object: within 4, 8, 16, 32 cm."""
    top, bottom, left, right = l["truth"].box
    j, i = np.mgrid[:l["ratio"].shape[0], :l["ratio"].shape[1]]
    distance = np.hypot(np.maximum(0, np.abs(i - (left + right) / 2) - (right - left) / 2), j - bottom)
    near = np.clip(1.5 - distance / (4 * 2 ** (s - 1) * l["truth"].px_per_cm), 0, 1)[..., None]
    l["ratio"] = l["ratio"] * (1 - near) + near


def shadow_noise(l, s):
    """Noise in the shadow: 5, 10, 20, 40 % of its depth at each pixel."""
    depth = np.abs(1 - l["ratio"])
    l["ratio"] = l["ratio"] + depth * 0.05 * 2 ** (s - 1) * l["truth"].random.standard_normal((*depth.shape[:2], 1)) * 2


def shadow_halo(l, s):
    """A bright rim around the object: 5, 10, 20, 40 % within 4 cm."""
    distance = ndimage.distance_transform_edt(l["alpha"][..., 0] <= 0)
    rim = np.exp(-(distance / (4 * l["truth"].px_per_cm)) ** 2)[..., None]
    l["ratio"] = l["ratio"] * (1 + 0.05 * 2 ** (s - 1) * rim)


# The faults of the object.

def object_bright(l, s):
    """The object brighter by a factor of 1.15, 1.3, 1.6, 2.2."""
    l["object"] = l["object"] * (1.15, 1.3, 1.6, 2.2)[s - 1]


def object_dark(l, s):
    """The object darker by a factor of 0.87, 0.75, 0.6, 0.4."""
    l["object"] = l["object"] * (0.87, 0.75, 0.6, 0.4)[s - 1]


def object_hue(l, s):
    """The object under reddish light: red up and blue down by 8, 16, 32, 64 %."""
    e = 0.08 * 2 ** (s - 1)
    l["object"] = l["object"] * np.array([1 + e, 1, 1 / (1 + e)])


def object_grey(l, s):
    """The object's colours s / 4 of the way to grey."""
    l["object"] = l["object"] + 0.25 * s * (luminance(l["object"]) - l["object"])


def object_flip(l, s):
    """The object lit from the other side: s / 4 of the way to its luminance mirrored left to right."""
    _, _, left, right = l["truth"].box
    colours = colour_of(l)
    sigma = max(1.0, 0.08 * (right - left))
    smooth = ndimage.gaussian_filter(luminance(colours)[..., 0], sigma)[..., None]
    middle = (left + right) / 2
    columns = np.clip(np.round(2 * middle - np.arange(colours.shape[1])).astype(int), left, right)
    flipped = smooth[:, columns]
    paint(l, colours * ((1 - 0.25 * s) + 0.25 * s * (flipped + 1e-3) / (smooth + 1e-3)))


def object_flat(l, s):
    """The object's shading s / 4 of the way to one brightness."""
    colours = colour_of(l)
    light = luminance(colours)
    mean = light[l["alpha"] > 0.5].mean() if (l["alpha"] > 0.5).any() else light.mean()
    paint(l, colours * (1 - 0.25 * s) + 0.25 * s * colours * mean / np.maximum(light, 1e-3))


def object_noise(l, s):
    """Noise in the object, 5, 10, 20, 40 % of its light."""
    shape = (*l["object"].shape[:2], 1)
    l["object"] = np.maximum(0, l["object"] * (1 + 0.05 * 2 ** (s - 1) * l["truth"].random.standard_normal(shape)))


def object_blur(l, s):
    """The object blurred with a deviation of 0.5, 1, 2, 4 cm."""
    sigma = 0.5 * 2 ** (s - 1) * l["truth"].px_per_cm
    for name in ("object", "alpha"):
        l[name] = np.stack([ndimage.gaussian_filter(l[name][..., k], sigma) for k in range(l[name].shape[-1])], -1)


def object_float(l, s):
    """The object 1, 2, 4, 8 cm above the ground; the shadow stays."""
    up = 2 ** (s - 1) * l["truth"].px_per_cm
    l["object"], l["alpha"] = moved(l["object"], -up, 0, 0), moved(l["alpha"], -up, 0, 0)


def object_aside(l, s):
    """The object moved to the side by 1, 2, 4, 8 cm; the shadow stays."""
    right = 2 ** (s - 1) * l["truth"].px_per_cm
    l["object"], l["alpha"] = moved(l["object"], 0, right, 0), moved(l["alpha"], 0, right, 0)


def object_large(l, s):
    """The object larger by 4, 8, 16, 32 %, about its foot."""
    top, bottom, left, right = l["truth"].box
    factor, foot = 1 + 0.04 * 2 ** (s - 1), np.array([bottom, (left + right) / 2])
    for name in ("object", "alpha"):
        l[name] = np.stack([ndimage.affine_transform(l[name][..., k], np.eye(2) / factor, foot - foot / factor, order=1)
                            for k in range(l[name].shape[-1])], -1)


def object_edge(l, s):
    """A dark rim: the background under the object's edge darker by a quarter to all."""
    edge = 4 * l["alpha"] * (1 - l["alpha"])
    wide = ndimage.gaussian_filter(edge[..., 0], 0.7)[..., None]
    l["object"] = l["object"] * (1 - 0.25 * s * np.minimum(1, wide))
    l["background"] = l["background"] * (1 - 0.25 * s * np.minimum(1, wide))


def reflection_missing(l, s):
    """The reflection of the object s / 4 of the way to none. Without a region of reflections, the picture stays."""
    mask = ndimage.gaussian_filter(l["truth"].reflection.astype(float), 0.5)[..., None] * 0.25 * s
    l["ratio"] = l["ratio"] * (1 - mask) + mask


# The faults of the background, which an insertion does not cause.

def background_noise(l, s):
    """Noise in the background, 1, 2, 4, 8 % of its light."""
    shape = (*l["background"].shape[:2], 1)
    l["background"] = np.maximum(0, l["background"] * (1 + 0.01 * 2 ** (s - 1) * l["truth"].random.standard_normal(shape)))


def background_blur(l, s):
    """The background blurred with a deviation of 0.3, 0.6, 1.2, 2.4 pixels."""
    l["background"] = np.stack([ndimage.gaussian_filter(l["background"][..., k], 0.3 * 2 ** (s - 1)) for k in range(3)], -1)


def background_gain(l, s):
    """The whole picture brighter by 2, 4, 8, 16 %."""
    gain = 1 + 0.02 * 2 ** (s - 1)
    l["background"], l["object"] = l["background"] * gain, l["object"] * gain


def shadow_none(l, s):
    """No shadow and no reflection."""
    l["ratio"] = np.ones_like(l["ratio"])


def nothing(l, s):
    """Nothing inserted."""
    shadow_none(l, s)
    l["object"], l["alpha"] = np.zeros_like(l["object"]), np.zeros_like(l["alpha"])


ONCE = (shadow_none, nothing)
FAULTS = {f.__name__: f for f in (
    shadow_shift, shadow_detached, shadow_doubled, shadow_dark, shadow_light, shadow_colour, shadow_soft, shadow_hard, shadow_mirrored,
    shadow_no_contact, shadow_noise, shadow_halo, object_bright, object_dark, object_hue, object_grey, object_flip, object_flat,
    object_noise, object_blur, object_float, object_aside, object_large, object_edge, reflection_missing, background_noise,
    background_blur, background_gain)}
ALL = {**FAULTS, **{f.__name__: f for f in ONCE}}


def distorted(truth, recipe):
    """The picture (linear) with faults: `recipe` such as `object_bright:2 shadow_dark:3`; `nothing` has no strength.

    Each recipe starts from the same random numbers, so that noise grows with its strength and nothing else."""
    truth.random = np.random.default_rng(zlib.crc32(truth.about["name"].encode()))
    layers = truth.start()
    for word in recipe.split():
        name, _, strength = word.partition(":")
        ALL[name](layers, int(strength or 1))
    return compose(layers)


def pairs():
    """Rows of pairs.tsv."""
    lines = (pathlib.Path(__file__).parent / "pairs.tsv").read_text().splitlines()
    head = lines[0].split("\t")
    return [dict(zip(head, line.split("\t"))) for line in lines[1:]]


def recipes():
    """Folder and recipe of all pictures."""
    made = {f"{name}-{s}": f"{name}:{s}" for name in FAULTS for s in STRENGTHS}
    for row in pairs():
        made[f"pair-{row['pair']}-better"], made[f"pair-{row['pair']}-worse"] = row["better"], row["worse"]
    return made


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("case", nargs="?", type=pathlib.Path)
    parser.add_argument("out", nargs="?", type=pathlib.Path)
    parser.add_argument("--list", action="store_true")
    arguments = parser.parse_args()
    if arguments.list or not arguments.out:
        for name, fault in ALL.items():
            print(f"{name:20} {fault.__doc__}")
        return
    for view in json.loads((arguments.case / "case.json").read_text())["views"]:
        truth = Truth(arguments.case, view)
        for folder, recipe in {"exact": "", **recipes()}.items():
            (arguments.out / folder).mkdir(parents=True, exist_ok=True)
            pictures.write_png(arguments.out / folder / f"{view}.png", pictures.codes(distorted(truth, recipe)))


if __name__ == "__main__":
    main()
