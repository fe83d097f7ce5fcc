#!/usr/bin/env python3
"""Checks a set: digests, that each case is complete, and that its files agree with each other.

    python check.py SET

Exit status 1 if a check fails. It compares the depth with the mesh, and prints for each view: the sizes of the regions, the RMSE between the pictures
with and without the object outside the regions, the median display value, and the share of clipped pixels.
"""
import hashlib
import json
import pathlib
import sys

import numpy as np

import pictures

NEEDED = ("without.exr", "with.exr", "alpha.exr", "depth.exr")


def digests(folder):
    """Files that are missing or differ from SHA256SUMS, and files that are not in it."""
    faults, listed = [], set()
    for line in (folder / "SHA256SUMS").read_text().splitlines():
        digest, name = line.split("  ", 1)
        listed.add(name)
        file = folder / name
        if not file.exists():
            faults.append(f"{name}: missing")
        elif hashlib.sha256(file.read_bytes()).hexdigest() != digest:
            faults.append(f"{name}: differs from SHA256SUMS")
    present = {str(p.relative_to(folder)) for p in folder.rglob("*") if p.is_file()} - {"SHA256SUMS"}
    return faults + [f"{name}: not in SHA256SUMS" for name in sorted(present - listed)]


def read_ply(path):
    """Vertices of a mesh that `capture.write_ply` wrote."""
    data = path.read_bytes()
    head, body = data.split(b"end_header\n", 1)
    count = int(next(l for l in head.decode().splitlines() if l.startswith("element vertex")).split()[-1])
    rows = np.frombuffer(body, [("p", "<f4", 3), ("c", "u1", 3)], count)
    return rows["p"].astype(float), rows["c"]


def project(points, frame, rig):
    """Pixel (column, row) and planar depth of the points before the camera and inside the picture."""
    value = lambda key: frame.get(key, rig.get(key))
    matrix = np.array(frame["transform_matrix"])
    local = (points - matrix[:3, 3]) @ matrix[:3, :3]
    z = -local[:, 2]
    local, z = local[z > 0.01], z[z > 0.01]
    x, y = value("cx") + value("fl_x") * local[:, 0] / z, value("cy") - value("fl_y") * local[:, 1] / z
    inside = (x >= 0) & (y >= 0) & (x < value("w")) & (y < value("h"))
    return x[inside].astype(int), y[inside].astype(int), z[inside]


def agreement(points, frame, rig, depth):
    """Agreement of the nearest point in each pixel with the true depth, within 3 %: the share of the pixels whose point lies there
    of those whose point lies there or before it, and of all pixels with a point. A pixel may hold points of a hidden
    surface only, so the second share is smaller where the points are sparse."""
    x, y, z = project(points, frame, rig)
    nearest = np.full(depth.shape, np.inf)
    np.minimum.at(nearest, (y, x), z)
    both = np.isfinite(nearest) & np.isfinite(depth)
    ratio = nearest[both] / depth[both]
    fits = np.abs(ratio - 1) < 0.03
    return fits.sum() / max(1, (ratio < 1.03).sum()), fits.mean() if len(fits) else 0.0


def check(folder):
    faults, notes = digests(folder), []
    about = json.loads((folder / "set.json").read_text())
    for name in about["cases"]:
        case = json.loads((folder / name / "case.json").read_text())
        rig = json.loads((folder / name / "views.json").read_text())
        frames = {pathlib.Path(f["file_path"]).stem: f for f in rig["frames"]}
        points, _ = read_ply((folder / name / case["mesh"]).resolve())
        light = pictures.read_exr(folder / name / "truth/light.exr")
        if light.shape[1] != 2 * light.shape[0] or not np.isfinite(light).all() or light.max() <= 0:
            faults.append(f"{name}: light.exr is not a panorama of finite, positive light")
        for view in case["views"]:
            truth = folder / name / "truth" / view
            missing = [f for f in NEEDED if not (truth / f).exists()]
            if missing:
                faults.append(f"{name}/{view}: without {', '.join(missing)}")
                continue
            without, with_ = (pictures.read_exr(truth / f"{w}.exr") for w in ("without", "with"))
            alpha, depth = pictures.read_exr(truth / "alpha.exr", "Y")[..., 0], pictures.read_exr(truth / "depth.exr", "Z")[..., 0]
            masks = [pictures.read_png(truth / f"{m}.png") > 127 for m in ("shadow", "reflection")]
            outside = (alpha <= 0) & ~masks[0] & ~masks[1]
            fit, share = agreement(points, frames[view], rig, depth)
            rest = pictures.display(with_)[outside] - pictures.display(without)[outside]
            if not all(np.isfinite(p).all() for p in (without, with_, alpha)):
                faults.append(f"{name}/{view}: values that are not finite")
            if fit < 0.9 or share < 0.25:
                faults.append(f"{name}/{view}: the mesh does not fit the depth ({100 * fit:.0f} % of its visible points, {100 * share:.0f} % of all)")
            if not 0.002 < (alpha > 0.5).mean() < 0.5:
                faults.append(f"{name}/{view}: the object covers {100 * (alpha > 0.5).mean():.2f} % of the picture")
            if masks[0].sum() + masks[1].sum() < 4:
                faults.append(f"{name}/{view}: neither shadow nor reflection")
            notes.append(f"{name}/{view}: object {100 * (alpha > 0.5).mean():.1f} %, shadow {100 * masks[0].mean():.1f} %, reflection "
                         f"{100 * masks[1].mean():.1f} %, rest differs by {np.sqrt((rest ** 2).mean()):.4f}, median light "
                         f"{np.median(pictures.display(without)):.2f}, white {100 * (without.max(-1) > 1).mean():.1f} %, mesh fits {100 * fit:.1f} %, {100 * share:.1f} %")
    return faults, notes


def main():
    faults, notes = check(pathlib.Path(sys.argv[1]))
    print("\n".join(notes))
    for fault in faults:
        print(f"fault: {fault}", file=sys.stderr)
    sys.exit(1 if faults else 0)


if __name__ == "__main__":
    main()
