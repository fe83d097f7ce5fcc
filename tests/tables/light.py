"""The cross-validation of docs/light.md, and its picture.

    lightharmony train-exposure HDRI --recovered RECOVERED
    python tests/tables/light.py HDRI PEERS learned=RECOVERED [NAME=FOLDER ..] [--picture light.jpg NAME,NAME,..]

HDRI holds the panoramas, PEERS the script of measures that was fixed before (`eval_pano.py`, whose EV 0 rule and spheres
are used), each FOLDER one EXR of recovered light for each panorama, by name. Prints the mean of each measure, strong
lights and others apart, and differences with intervals of 95 % (paired, 10,000 resamples of panoramas).
"""

import os
import sys

import numpy as np

arguments = sys.argv[1:]
picture = None
if "--picture" in arguments:
    at = arguments.index("--picture")
    picture, shown = os.path.abspath(arguments[at + 1]), arguments[at + 2].split(",")
    del arguments[at : at + 3]
hdri, peers = (os.path.abspath(folder) for folder in arguments[:2])
folders = {name: os.path.abspath(folder) for name, folder in (text.split("=") for text in arguments[2:])}
sys.path.insert(0, peers)
import eval_pano as ev  # noqa: E402
import panolib as pl  # noqa: E402

MEASURES = ["clipRMSE", "dirErr", "irrRel", "irrLog2", "contrastLog2", "si_diffuse", "si_glossy", "si_mirror"]
# A light is strong where six stops of true exposures miss contrast by more than this.
STRONG = 0.5

truth = {name: image * pl.expose_scale(image) for name, image in pl.load_dir(hdri).items()}
light = {"as photographed": {}, "true exposures, paper's bracket": {}, "true exposures to -15": {}}
light |= {name: pl.load_dir(folder) for name, folder in folders.items()}
for name, image in truth.items():
    photograph = pl.ldr(image)
    light["as photographed"][name] = photograph**pl.G
    for title, stops, mode in [("true exposures, paper's bracket", "paper", "paper"), ("true exposures to -15", "ext", "maxc")]:
        evs = ev.BR[stops]
        light[title][name] = pl.fuse([pl.ldr(image, e) for e in evs[:-1]] + [photograph], evs, mode)

if picture:
    import cv2

    n = 64
    y, x = np.mgrid[0:n, 0:n]
    x, y = (x + 0.5) / n * 2 - 1, 1 - (y + 0.5) / n * 2
    disc = x * x + y * y < 0.98  # as in `sphere_dirs` there

    def code(image):
        return (np.clip(pl.ldr(image), 0, 1)[..., ::-1] * 255).round().astype(np.uint8)

    rows = []
    for name in shown:
        panorama = cv2.resize(code(truth[name]), (2 * n, n), interpolation=cv2.INTER_AREA)
        cells = [panorama]
        for images in [truth, light["as photographed"], *(light[folder] for folder in folders)]:
            cells.append(np.full((n, 8, 3), 128, np.uint8))
            for ball in ("diffuse", "glossy", "mirror"):
                cell = np.full((n, n, 3), 128, np.uint8)
                cell[disc] = code(ev.spheres(images[name])[ball][None])[0]
                cells += [cell, np.full((n, 2, 3), 128, np.uint8)]
        rows.append(np.concatenate(cells, 1))
    sheet = np.concatenate(rows, 0)
    cv2.imwrite(picture, cv2.resize(sheet, None, fx=1.5, fy=1.5, interpolation=cv2.INTER_CUBIC))

scores = {}
for title, images in light.items():
    rows = []
    for name in truth:
        found = ev.score(images[name], truth[name], pl.ldr(truth[name]).max(-1) >= 0.999)
        rows.append([found[measure] for measure in MEASURES])
    scores[title] = np.array(rows)
    print(f"| {title} | " + " | ".join(f"{v:.2f}" for v in scores[title].mean(0)) + " |", flush=True)

strong = scores["true exposures, paper's bracket"][:, MEASURES.index("contrastLog2")] > STRONG
two = [MEASURES.index("irrLog2"), MEASURES.index("contrastLog2")]
print(f"\nstrong lights ({strong.sum()}), others ({(~strong).sum()}): irradiance / contrast")
for title, rows in scores.items():
    parts = [" / ".join(f"{v:.2f}" for v in rows[chosen].mean(0)[two]) for chosen in (strong, ~strong)]
    print(f"| {title} | {parts[0]} | {parts[1]} |")

sampled = np.random.default_rng(7).integers(0, len(truth), (10_000, len(truth)))
for better in folders:
    for other in scores:
        if other != better:
            off = scores[better] - scores[other]
            low, high = np.percentile(off[sampled].mean(1), [2.5, 97.5], axis=0)
            cells = [f"{m:+.2f} ({a:+.2f} to {b:+.2f})" for m, a, b in zip(off.mean(0), low, high)]
            print(f"| {better} minus {other} | " + " | ".join(cells) + " |")
