"""The cross-validation of docs/evidence/light.md, and its picture.

    lightharmony train-exposure HDRI HDRI2 --recovered RECOVERED
    python tests/tables/light_baselines.py HDRI,HDRI2 PEERS BASELINES
    python tests/tables/light.py HDRI,HDRI2 PEERS learned=RECOVERED region=BASELINES/region \
        [--picture light.jpg NAME,NAME,..]

HDRI and HDRI2 hold the panoramas, PEERS the script of measures that was fixed before (`eval_pano.py`, whose EV 0 rule and spheres
are used), each FOLDER one EXR of recovered light for each panorama, by name, from what never saw its place. Prints the
mean of each measure, of each folder also by the paper's bracket and one to -15; strong lights and others apart;
the share of panoramas whose irradiance is worse than in the plain photograph by over 0.3 stops;
differences of the first folder with intervals of 95 % (paired, 10,000 resamples of places); and, of a folder with
`regions.csv`, how often the truth lies within the reported uncertainty, and the effect of the rule for suns.
"""

import csv
import os
import sys

import numpy as np

arguments = sys.argv[1:]
picture = None
if "--picture" in arguments:
    at = arguments.index("--picture")
    picture, shown = os.path.abspath(arguments[at + 1]), arguments[at + 2].split(",")
    del arguments[at : at + 3]
sources = [os.path.abspath(folder) for folder in arguments[0].split(",")]
peers = os.path.abspath(arguments[1])
folders = {name: os.path.abspath(folder) for name, folder in (text.split("=") for text in arguments[2:])}
sys.path.insert(0, peers)
import eval_pano as ev  # noqa: E402
import panolib as pl  # noqa: E402
from light_places import PARTS, places_of  # noqa: E402

MEASURES = ["clipRMSE", "dirErr", "irrRel", "irrLog2", "contrastLog2", "colour", "si_diffuse", "si_glossy", "si_mirror"]
# A light is strong where six stops of true exposures miss contrast by more than this.
STRONG = 0.5
# A prediction does harm where its irradiance is worse than that of the plain photograph by more than this, in stops.
HARM = 0.3

panoramas = {name: image for folder in sources for name, image in pl.load_dir(folder).items()}
truth = {name: panoramas[name] * pl.expose_scale(panoramas[name]) for name in sorted(panoramas)}
light = {"as photographed": {}, "true exposures, paper's bracket": {}, "true exposures to -15": {}}
light |= {name: pl.load_dir(folder) for name, folder in folders.items()}
BRACKETS = [("paper's bracket", "paper", "paper"), ("to -15", "ext", "maxc")]
light |= {f"{name}, {title}": {} for name in folders for title, _, _ in BRACKETS}
for name, image in truth.items():
    photograph = pl.ldr(image)
    light["as photographed"][name] = photograph**pl.G
    for title, stops, mode in BRACKETS:
        evs = ev.BR[stops]
        exposures = [pl.ldr(image, e) for e in evs[:-1]] + [photograph]
        light["true exposures" + (" " if title[0] == "t" else ", ") + title][name] = pl.fuse(exposures, evs, mode)
        for folder in folders:
            light[f"{folder}, {title}"][name] = ev.bracket_hdr(photograph, light[folder][name] @ pl.W, evs, mode)

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



def dominant_colour(image, direction):
    """RGB of the light within 15 degrees of a direction, as a unit vector."""
    within = (ev.D @ direction > np.cos(np.radians(15))) * ev.SA
    rgb = within @ image.reshape(-1, 3).astype(float)
    return rgb / max(np.linalg.norm(rgb), 1e-12)


def score(image, real):
    """Measures of `eval_pano.py`, and the angle in RGB between the colours of the dominant light."""
    found = ev.score(image, real, pl.ldr(real).max(-1) >= 0.999)
    light = ev.dom_dir(real)
    cosine = dominant_colour(image, light) @ dominant_colour(real, light)
    return found | {"colour": float(np.degrees(np.arccos(np.clip(cosine, 0, 1))))}


scores = {}
for title, images in light.items():
    rows = []
    for name in truth:
        found = score(images[name], truth[name])
        rows.append([found[measure] for measure in MEASURES])
    scores[title] = np.array(rows)
    print(f"| {title} | " + " | ".join(f"{v:.2f}" for v in scores[title].mean(0)) + " |", flush=True)

strong = scores["true exposures, paper's bracket"][:, MEASURES.index("contrastLog2")] > STRONG
two = [MEASURES.index("irrLog2"), MEASURES.index("contrastLog2")]
print(f"\nstrong lights ({strong.sum()}), others ({(~strong).sum()}): irradiance / contrast")
for title, rows in scores.items():
    parts = [" / ".join(f"{v:.2f}" for v in rows[chosen].mean(0)[two]) for chosen in (strong, ~strong)]
    print(f"| {title} | {parts[0]} | {parts[1]} |")

plain = scores["as photographed"][:, two[0]]
print(f"\nirradiance worse than as photographed by over {HARM} stops; medians of irradiance, contrast, direction")
for title, rows in scores.items():
    medians = " / ".join(f"{v:.2f}" for v in np.median(rows[:, [*two, MEASURES.index("dirErr")]], axis=0))
    print(f"| {title} | {(rows[:, two[0]] > plain + HARM).mean():.1%} | {medians} |")

places = np.array(places_of(truth))
drawn = np.random.default_rng(7).integers(0, places.max() + 1, (10_000, places.max() + 1))
counts = np.stack([np.bincount(row, minlength=places.max() + 1) for row in drawn])[:, places]
counts = counts / counts.sum(1, keepdims=True)
better = next(iter(folders))
print(f"\n{places.max() + 1} places")
for other in scores:
    if other != better:
        off = scores[better] - scores[other]
        low, high = np.percentile(counts @ off, [2.5, 97.5], axis=0)
        cells = [f"{m:+.2f} ({a:+.2f} to {b:+.2f})" for m, a, b in zip(off.mean(0), low, high)]
        print(f"| {better} minus {other} | " + " | ".join(cells) + " |")


def regions(path):
    """Reported uncertainty of regions of unseen places, whose residual is from the other parts, and the rule for suns."""
    names, *numbers = zip(*list(csv.reader(open(path)))[1:])
    part, open_flux, sun, visible, hidden, told, given, apart = np.array(numbers, float)
    index = np.unique(names, return_inverse=True)[1]
    total = np.bincount(index, hidden)[index]
    matters = (hidden > 0.05 * total) & (total > 0)
    error = np.clip(np.log2(np.maximum(told, 1e-12) / np.maximum(hidden, 1e-30)), -4, 4)
    squares = np.where(matters, error**2 - apart**2, np.nan)
    residual = np.array([np.sqrt(max(0, np.nanmean(squares[part != p]))) for p in range(PARTS)])[part.astype(int)]
    ratio = given / np.maximum(visible, 1e-12)
    gain = np.log2(1 + ratio)
    uncertainty = np.log2(1 + ratio * 2 ** np.hypot(residual, apart)) - gain
    off = np.abs(gain - np.log2(1 + hidden / np.maximum(visible, 1e-12)))
    print(f"\n{len(off)} regions of unseen places; residual {residual.min():.2f} to {residual.max():.2f} stops")
    for title, chosen in [("all", off >= 0), ("with 5 % of the hidden light or more", matters)]:
        within = [(off[chosen] <= k * uncertainty[chosen]).mean() for k in (1, 2)]
        rms = np.sqrt(np.mean((off[chosen] / np.maximum(uncertainty[chosen], 1e-6)) ** 2))
        print(f"{title} ({chosen.sum()}): {within[0]:.0%} within one, {within[1]:.0%} within two, rms {rms:.2f}")

    def irradiance(flux):
        """Error of each panorama where the sun gives at least `flux` of the visible flux."""
        light = np.where((sun > 0) & (told > 0), np.maximum(told, sun * flux * open_flux), told)
        seen = np.bincount(index, visible) + open_flux[np.unique(index, return_index=True)[1]]
        return np.abs(np.log2((seen + np.bincount(index, light)) / (seen + np.bincount(index, hidden))))

    of = part[np.unique(index, return_index=True)[1]].astype(int)
    rules = {flux: irradiance(flux) for flux in (0, 0.25, 0.5, 1, 1.7)}
    print("suns:", sorted({names[i] for i in np.flatnonzero(sun > 0)}))
    print("error of irradiance by the least flux of a sun:", {k: round(v.mean(), 3) for k, v in rules.items()})
    best = [min(rules, key=lambda flux: rules[flux][of != p].mean()) for p in range(PARTS)]
    chosen = np.mean([rules[best[p]][i] for i, p in enumerate(of)])
    print(f"chosen by the other parts: {best}, error {chosen:.3f}")


for folder in folders.values():
    if os.path.exists(os.path.join(folder, "regions.csv")):
        regions(os.path.join(folder, "regions.csv"))
