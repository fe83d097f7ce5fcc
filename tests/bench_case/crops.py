"""Crops the three views of the bench case to the object and its shadow, a sixth of their pixels, and
writes an overlay that has `oracle.ron` and `ablations.ron` render these in place of the whole views:

    python3 tests/bench_case/crops.py ../shared/data/bench-case FOLDER
    lightharmony run tests/bench_case/ablations.ron --overlay FOLDER/crops.ron --out FOLDER

Needs numpy, OpenEXR and Pillow."""

import json
import sys
from pathlib import Path

import numpy as np
import OpenEXR
from PIL import Image

LEFT, TOP, WIDTH, HEIGHT = 192, 98, 160, 224
ROWS, COLUMNS = slice(TOP, TOP + HEIGHT), slice(LEFT, LEFT + WIDTH)
PICTURES = {"without": "without.exr", "with": "with.exr", "region": "shadow_region.png", "covered": "object_alpha.png"}


def cut(source: Path, target: Path) -> None:
    if source.suffix == ".png":
        Image.fromarray(np.asarray(Image.open(source))[ROWS, COLUMNS].copy()).save(target)
        return
    with OpenEXR.File(str(source), separate_channels=True) as file:
        planes = {name: plane.pixels[ROWS, COLUMNS].copy() for name, plane in file.channels().items()}
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, planes).write(str(target))


def main() -> None:
    case, folder = (Path(word).resolve() for word in sys.argv[1:3])
    folder.mkdir(parents=True, exist_ok=True)
    views = json.loads((case / "case.json").read_text())["views"]
    for view in views:
        view |= {"w": WIDTH, "h": HEIGHT, "cx": view["cx"] - LEFT, "cy": view["cy"] - TOP}
    (folder / "case.json").write_text(json.dumps({"views": views}))
    fields = [f'rig: (path: "{folder}/case.json")']
    for node, name in PICTURES.items():
        paths = [folder / f"{view['name']}_{name}" for view in views]
        for path in paths:
            cut(case / "gt" / path.name, path)
        first, *more = (f'"{path}"' for path in paths)
        fields.append(f"{node}: (path: {first}, more: [{', '.join(more)}])")
    (folder / "crops.ron").write_text("Overlay(nodes: (\n" + ",\n".join(fields) + ",\n))\n")


main()
