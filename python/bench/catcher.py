#!/usr/bin/env python3
"""The baseline that an artist makes by hand: a shadow catcher in Blender under the panorama of the place.

    python catcher.py SET OUT [--samples N] [--threads N] [--clipped]     OUT/CASE/VIEW.png (8 bits, sRGB)

Nothing but the true light, the object, its pose and the cameras is used: a plane of 12 times the object's size at its foot catches the
shadow, the panorama is infinitely far away, and the layer is composited over the true picture without the object.
With `--clipped` the panorama is clipped at white, as from one photograph. Needs bpy.
"""
import argparse
import json
import pathlib
import tempfile

import numpy as np

import pictures


def prepare(case_folder, case, threads, clipped, work):
    import stage as stages
    from places import Look, Place
    from shapes import rectangle

    pose = case["pose"]
    half = 6 * 0.5 * pose["scale"]
    at = pose["translation"]
    plane = Place("catcher", [], [rectangle("ground", (at[0] - half, at[1] - half, at[2]), (2 * half, 0, 0), (0, 2 * half, 0))],
                  {"ground": Look((0.3, 0.3, 0.3))})
    light = pictures.read_exr(case_folder / "truth/light.exr")
    file = work / "light.exr"
    pictures.write_exr(file, np.clip(light, 0, 1) if clipped else light)
    stage = stages.Stage(plane, file, 1.0, threads)
    stage.insert((case_folder / case["object"]).resolve(), at, pose["yaw_deg"], pose["scale"])
    stage.scene.render.film_transparent = True
    return stage


def layers(stage, samples):
    """The object's layer (h, w, 4), premultiplied, and the ratio of the plane with and without its shadow (h, w, 3)."""
    import bpy

    plane = stage.receivers[0]
    plane.is_shadow_catcher, plane.visible_camera = False, False
    stage.scene.cycles.caustics_reflective = stage.scene.cycles.caustics_refractive = True
    bpy.context.view_layer.cycles.use_pass_shadow_catcher = False
    layer = stage.render(samples, 1, denoise=True)
    plane.is_shadow_catcher, plane.visible_camera = True, True
    # Caustics make single bright pixels in this pass, which Blender does not denoise.
    cycles = stage.scene.cycles
    cycles.caustics_reflective = cycles.caustics_refractive = False
    bpy.context.view_layer.cycles.use_pass_shadow_catcher = True
    return layer, stage.render(samples, 1, denoise=True, extra="Shadow Catcher")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("set", type=pathlib.Path)
    parser.add_argument("out", type=pathlib.Path)
    parser.add_argument("--samples", type=int, default=256)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--clipped", action="store_true")
    arguments = parser.parse_args()
    for name in json.loads((arguments.set / "set.json").read_text())["cases"]:
        folder, out = arguments.set / name, arguments.out / name
        case = json.loads((folder / "case.json").read_text())
        if all((out / f"{view}.png").exists() for view in case["views"]):
            continue
        out.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory() as work:
            stage = prepare(folder, case, arguments.threads, arguments.clipped, pathlib.Path(work))
            rig = json.loads((folder / "views.json").read_text())
            for frame in rig["frames"]:
                view = pathlib.Path(frame["file_path"]).stem
                if view not in case["views"]:
                    continue
                lens = {key: frame.get(key, rig.get(key)) for key in ("w", "h", "fl_x", "fl_y", "cx", "cy")}
                stage.look(frame["transform_matrix"], lens)
                layer, ratio = layers(stage, arguments.samples)
                background = pictures.read_exr(folder / "truth" / view / "without.exr")
                picture = background * ratio * (1 - layer[..., 3:]) + layer[..., :3]
                pictures.write_png(out / f"{view}.png", pictures.codes(picture))
        print(name, flush=True)


if __name__ == "__main__":
    main()
