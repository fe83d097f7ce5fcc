#!/usr/bin/env python3
"""S of a scene by the shadow catcher of Blender Cycles, and its cost beyond start-up.

usage: cycles_catcher.py DRIVER SCENE.json OUT [SAMPLES..]        by a Python that has bpy, OpenEXR and trimesh

DRIVER is cycles_render.py, which builds the scene; the receiver is then made a shadow catcher, and one render gives S as a
pass of its own, with the denoiser. For each number of samples the scene is rendered twice in this process. Printed as a line of
JSON are the CPU seconds of the first time (`whole`: Cycles' own, with its scene and trees but without loading the files), of the
second, and of a picture of 8 by 6 pixels at one sample just before that, denoised too (`start`): what any picture costs here. What is
left of the second, `render`, is the sampling and the denoiser. S is written to OUT/S-SAMPLES.npy.
"""
import importlib.util, json, os, resource, sys
import numpy as np

def cpu():
    return sum(resource.getrusage(resource.RUSAGE_SELF)[:2])

def main():
    driver, path, out, *numbers = sys.argv[1:]
    spec = importlib.util.spec_from_file_location("cycles_render", driver)
    cycles = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(cycles)
    import bpy, OpenEXR
    with open(path) as file:
        scene_file = json.load(file)
    scene, receiver, objects = cycles.build(scene_file, os.path.dirname(os.path.abspath(path)), "opaque")
    receiver.is_shadow_catcher = True
    scene.render.film_transparent = True
    bpy.context.view_layer.cycles.use_pass_shadow_catcher = True
    settings, size = scene.cycles, (scene.render.resolution_x, scene.render.resolution_y)
    scene.render.threads_mode, scene.render.threads = "FIXED", int(os.environ.get("THREADS", "2"))
    settings.denoiser, settings.denoising_use_gpu = "OPENIMAGEDENOISE", False
    os.makedirs(out, exist_ok=True)
    file = os.path.join(out, "catcher.exr")

    def render(width, height, samples, denoised):
        scene.render.resolution_x, scene.render.resolution_y = width, height
        settings.samples, settings.use_denoising, scene.render.filepath = samples, denoised, file
        before = cpu()
        bpy.ops.render.render(write_still=True)
        return cpu() - before

    for samples in map(int, numbers or ["4"]):
        whole = render(*size, samples, True)
        start = render(8, 6, 1, True)
        again = render(*size, samples, True)
        with OpenEXR.File(file, separate_channels=True) as read:
            planes = {name: np.array(plane.pixels) for name, plane in read.channels().items()}
        of = lambda end: next(plane for name, plane in planes.items() if name.endswith("." + end))
        np.save(os.path.join(out, f"S-{samples}.npy"), np.stack([of("Shadow Catcher." + k) for k in "RGB"], -1).astype(np.float32))
        print(json.dumps({"samples": samples, "whole": whole, "again": again, "start": start, "render": again - start}), flush=True)
    os.remove(file)

if __name__ == "__main__":
    main()
