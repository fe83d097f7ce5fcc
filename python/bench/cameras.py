"""Cameras: the views that are scored, the path of the photographer, and the files of both. NumPy only.

Matrices are camera to world, x right, y up, z backward (OpenGL, nerfstudio); pixel centres are at +0.5.
"""
import json

import numpy as np

FOV_Y_DEG = 45.0
FOV_PHOTO_DEG = 60.0


def look_at(eye, target):
    """Camera to world (4, 4) with z up in the picture."""
    eye, target = np.array(eye, float), np.array(target, float)
    back = (eye - target) / np.linalg.norm(eye - target)
    right = np.cross((0, 0, 1.0), back)
    right /= np.linalg.norm(right)
    made = np.eye(4)
    made[:3, 0], made[:3, 1], made[:3, 2], made[:3, 3] = right, np.cross(back, right), back, eye
    return made


def lens(width, height, fov_y_deg):
    focal = float(height / 2 / np.tan(np.radians(fov_y_deg) / 2))
    return {"w": int(width), "h": int(height), "fl_x": focal, "fl_y": focal, "cx": width / 2, "cy": height / 2}


def blocked(eye, target, boxes, margin=0.02):
    """Whether a box (low, high) lies between two points; the last 5 % before the target are free."""
    eye, ray = np.array(eye, float), np.array(target, float) - np.array(eye, float)
    for low, high in boxes:
        with np.errstate(divide="ignore", invalid="ignore"):
            a, b = (low - margin - eye) / ray, (high + margin - eye) / ray
        near, far = np.nanmax(np.minimum(a, b)), np.nanmin(np.maximum(a, b))
        if near <= far and far > 0 and near < 0.95:
            return True
    return False


def within(point, inside):
    return bool(np.all(np.array(point) >= inside[0]) and np.all(np.array(point) <= inside[1]))


def views(place, rng, count):
    """`count` cameras around the place of the object that see its foot, middle and top."""
    at, boxes = np.array(place.at), place.obstacles()
    low, high = place.around
    found = []
    for k in range(count):
        slot = (low + (high - low) * k / count, low + (high - low) * (k + 1) / count)
        for attempt in range(600):
            # After 200 attempts in its part of the circle, a view may stand anywhere.
            azimuth = np.radians(rng.uniform(*(slot if attempt < 200 else (low, high))))
            reach, rise = rng.uniform(*place.reach) * (1 if attempt < 400 else 0.8), rng.uniform(*place.rise)
            eye = at + (reach * np.cos(azimuth), reach * np.sin(azimuth), rise)
            points = [at + (0, 0, 0.5 * place.scale * t) for t in (0.05, 0.5, 1.0)]
            if within(eye, place.inside) and not any(blocked(eye, p, boxes) for p in points):
                break
        else:
            raise RuntimeError(f"{place.name}: no free camera for view {k}; change the seed or the furniture")
        aim = at + (*rng.uniform(-0.08, 0.08, 2) * reach, 0.25 * place.scale)
        found.append(look_at(eye, aim))
    return found


def path(place, rng, count):
    """The photographer's path: two thirds of the pictures look at the place from around it, one third looks outwards."""
    at, boxes = np.array(place.at), place.obstacles()
    found = []
    for k in range(count):
        outwards = k % 3 == 2
        for _ in range(600):
            azimuth = 2.4 * k + rng.uniform(-0.3, 0.3)
            if outwards:
                eye = at + (*rng.uniform(-0.35, 0.35, 2) * place.reach[0], rng.uniform(0.6, 1.2) * place.rise[1])
                aim = eye + (np.cos(azimuth), np.sin(azimuth), rng.uniform(-0.35, 0.45))
            else:
                reach, rise = rng.uniform(0.7, 1.3) * np.mean(place.reach), rng.uniform(0.5, 1.3) * np.mean(place.rise)
                eye = at + (reach * np.cos(azimuth), reach * np.sin(azimuth), rise)
                aim = at + rng.uniform(-0.2, 0.2, 3) * place.reach[0]
            if within(eye, place.inside) and not any(np.all(eye > l - 0.08) and np.all(eye < h + 0.08) for l, h in boxes):
                found.append(look_at(eye, aim))
                break
    if len(found) < 0.8 * count:
        raise RuntimeError(f"{place.name}: only {len(found)} of {count} photographs have a place to stand")
    return found


def transforms(matrices, files, size, fov_y_deg):
    """The `transforms.json` of nerfstudio."""
    return {**lens(*size, fov_y_deg), "camera_model": "PINHOLE",
            "frames": [{"file_path": f, "transform_matrix": m.tolist()} for m, f in zip(matrices, files)]}


def write_json(path_, value):
    with open(path_, "w") as file:
        json.dump(value, file, indent=1)
        file.write("\n")


def quaternion(m):
    """(w, x, y, z) of a rotation matrix, w not negative."""
    k = np.array([[m[0, 0] - m[1, 1] - m[2, 2], 0, 0, 0], [m[0, 1] + m[1, 0], m[1, 1] - m[0, 0] - m[2, 2], 0, 0],
                  [m[0, 2] + m[2, 0], m[1, 2] + m[2, 1], m[2, 2] - m[0, 0] - m[1, 1], 0],
                  [m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1], m[0, 0] + m[1, 1] + m[2, 2]]]) / 3
    values, vectors = np.linalg.eigh(k)
    x, y, z, w = vectors[:, np.argmax(values)]
    return np.array([w, x, y, z]) * (-1 if w < 0 else 1)


def colmap(folder, matrices, files, size, fov_y_deg, points, colours):
    """A COLMAP model as text: one pinhole camera, the pictures, and points without tracks (colours 0 to 255)."""
    folder.mkdir(parents=True, exist_ok=True)
    l = lens(*size, fov_y_deg)
    (folder / "cameras.txt").write_text(
        f"# Camera list with one line of data per camera:\n1 PINHOLE {l['w']} {l['h']} {l['fl_x']!r} {l['fl_y']!r} {l['cx']} {l['cy']}\n")
    lines = ["# Image list with two lines of data per image:"]
    for k, (m, f) in enumerate(zip(matrices, files), 1):
        r = (m[:3, :3] @ np.diag([1, -1, -1])).T
        q, t = quaternion(r), -r @ m[:3, 3]
        lines += [" ".join([str(k), *(f"{x:.12g}" for x in (*q, *t)), "1", f.split("/")[-1]]), ""]
    (folder / "images.txt").write_text("\n".join(lines) + "\n")
    lines = ["# 3D point list with one line of data per point:"]
    lines += [f"{k} {p[0]:.6f} {p[1]:.6f} {p[2]:.6f} {c[0]} {c[1]} {c[2]} 0" for k, (p, c) in enumerate(zip(points, colours), 1)]
    (folder / "points3D.txt").write_text("\n".join(lines) + "\n")
