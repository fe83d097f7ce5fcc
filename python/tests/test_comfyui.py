#!/usr/bin/env python3
"""Tests of the ComfyUI node without ComfyUI: `LIGHTHARMONY_PROGRAM=target/release/lightharmony python3 python/tests/test_comfyui.py`.

`Host` decides which nodes run in the way of ComfyUI: by the inputs, and by the value of `IS_CHANGED`.
"""
import os
import pathlib
import re
import subprocess
import sys
import tempfile
import types
import unittest
import unittest.mock

HERE = pathlib.Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent))

import numpy

import comfyui
import lightharmony

GRAPH = """Graph(
    version: 1,
    scene: (up: "+z", seed: 3),
    nodes: (
        demo:   DemoScene(place: Courtyard, splats: 3000, width_px: 48, height_px: 27, truth_width_px: 32),
        pose:   Pose(translation: (0.0, 0.0, 0.0), yaw_deg: 30.0),
        placed: Place(object: "demo.object", pose: "pose"),
        camera: Camera(eye: (2.0, -2.5, 1.2), target: (0.0, 0.0, 0.2), width_px: 48, height_px: 27, fov_y_deg: 40.0),
        trace:  PathTrace(receiver: "demo.proxy", objects: ["placed"], rig: "camera", env: "demo.truth_env", samples: 2),
        shadow: ShadowRatio(without: "trace.without", with: "trace.with"),
        plate:  LoadImage(path: "plate.png"),
        final:  Composite(background: "plate", object: "trace.object", shadow: "shadow"),
        unused: Camera(eye: (1.0, 1.0, 1.0), target: (0.0, 0.0, 0.0)),
        save:   WriteImage(image: "final", path: "final.png"),
    ),
)
"""


class Host:
    """Runs a node if its inputs or the value of `IS_CHANGED` differ from those of its last run, as ComfyUI does."""

    def __init__(self):
        self.signature, self.result, self.runs = None, None, 0

    def prompt(self, background_id=None, background=None, **inputs):
        valid = comfyui.Run.VALIDATE_INPUTS(inputs["graph"], inputs["settings"])
        if valid is not True:
            raise ValueError(valid)
        # Inputs that come from other nodes are not passed.
        changed = comfyui.Run.IS_CHANGED(**inputs, background=None)
        signature = (changed, background_id, tuple(sorted(inputs.items())))
        if signature != self.signature:
            self.result = comfyui.Run().run(**inputs, background=background)
            self.signature, self.runs = signature, self.runs + 1
        return self.result


class Node(unittest.TestCase):
    def setUp(self):
        temporary = tempfile.TemporaryDirectory()
        self.addCleanup(temporary.cleanup)
        self.folder = pathlib.Path(temporary.name)
        os.environ["LIGHTHARMONY_CACHE"] = str(CACHE)
        self.graph = self.folder / "graph.ron"
        self.graph.write_text(GRAPH)
        comfyui.write_png(str(self.folder / "plate.png"), numpy.full((27, 48, 3), 0.5, numpy.float32))
        self.inputs = {
            "graph": str(self.graph), "settings": "", "image": "final", "mask": "trace.object", "layers": "trace.depth, shadow",
            "background_node": "plate",
        }

    def test_image_mask_and_layers(self):
        image, mask, layers = Host().prompt(**self.inputs)
        self.assertEqual((image.shape, mask.shape), ((1, 27, 48, 3), (1, 27, 48)))
        self.assertTrue(0 <= image.min() and image.max() <= 1 and mask.max() == 1)
        # Far from the object, the background is as it was: display values of 0.5.
        self.assertAlmostEqual(float(image[0, 0, 0, 0]), 0.5, delta=2e-3)
        self.assertEqual(list(layers), ["trace.depth", "shadow"])
        depth, nothing = comfyui.Layer().pick(layers, "trace.depth", True)
        self.assertEqual(depth.shape, (1, 27, 48, 3))
        self.assertTrue(0 < depth.min() and depth.max() == 1)
        with self.assertRaisesRegex(comfyui.Failed, "the layers are trace.depth, shadow"):
            comfyui.Layer().pick(layers, "trace.dept", True)

    def test_the_node_runs_exactly_if_a_key_has_changed(self):
        host = Host()

        def ran(**changed):
            before = host.runs
            result = host.prompt(**{**self.inputs, **changed})
            return host.runs - before, result

        self.assertEqual(ran()[0], 1)
        self.assertEqual(ran()[0], 0)
        # No key changes.
        self.graph.write_text("// A comment.\n" + GRAPH)
        self.assertEqual(ran()[0], 0)
        self.graph.write_text(GRAPH.replace("eye: (1.0, 1.0, 1.0)", "eye: (1.0, 1.0, 2.0)"))
        self.assertEqual(ran()[0], 0)
        self.graph.write_text(GRAPH.replace("nodes: (", "nodes: (\n").replace("demo:   Demo", "demo: Demo"))
        self.assertEqual(ran()[0], 0)
        plate = self.folder / "plate.png"
        plate.write_bytes(plate.read_bytes())
        self.assertEqual(ran()[0], 0)
        # Keys change.
        self.graph.write_text(GRAPH.replace("yaw_deg: 30.0", "yaw_deg: 31.0"))
        self.assertEqual(ran()[0], 1)
        self.assertEqual(ran()[0], 0)
        comfyui.write_png(str(plate), numpy.full((27, 48, 3), 0.25, numpy.float32))
        count, result = ran()
        self.assertEqual(count, 1)
        self.assertAlmostEqual(float(result[0][0, 0, 0, 0]), 0.25, delta=2e-3)
        self.assertEqual(ran()[0], 0)
        # Back to an earlier graph: everything is in the cache, but the keys differ from those of the last run.
        self.graph.write_text(GRAPH)
        self.assertEqual(ran()[0], 1)
        self.assertEqual(ran()[0], 0)
        # Settings are inputs of the node.
        self.assertEqual(ran(settings="pose.yaw_deg=50\n# a comment")[0], 1)

    def test_the_background_comes_from_another_node(self):
        host = Host()
        for number, grey in ((1, 0.75), (2, 0.2)):
            batch = numpy.full((1, 27, 48, 3), grey, numpy.float32)
            for _ in range(2):
                image, *_ = host.prompt(background_id=number, background=batch, **self.inputs)
                self.assertAlmostEqual(float(image[0, 0, 0, 2]), grey, delta=2e-3)
                self.assertEqual(host.runs, number)

    def test_mistakes_are_shown_at_the_node(self):
        self.graph.write_text(GRAPH.replace("samples: 2", "sampels: 2"))
        text = comfyui.Run.VALIDATE_INPUTS(str(self.graph), "")
        self.assertRegex(text, r"graph\.ron:9:\d+: .*`sampels`")
        self.assertIn("did you mean `samples`?", text)
        self.graph.write_text(GRAPH)
        self.assertIn("line 2 of the settings", comfyui.Run.VALIDATE_INPUTS(str(self.graph), "\nyaw"))
        self.assertIn("did you mean `yaw_deg`?", comfyui.Run.VALIDATE_INPUTS(str(self.graph), "pose.yaw=3"))
        self.assertIn("No such file", comfyui.Run.VALIDATE_INPUTS(str(self.folder / "none.ron"), ""))
        with self.assertRaisesRegex(ValueError, "final.* is not an output|not an output"):
            comfyui.Run().run(**{**self.inputs, "image": "finale"})

    def test_a_missing_program_or_another_version_is_shown_at_the_node(self):
        other = self.folder / "other"
        other.write_text("#!/bin/sh\necho lightharmony 9.8.7\n")
        other.chmod(0o755)
        versions = rf"is version 9\.8\.7, but this module needs version {re.escape(lightharmony.__version__)}"
        for program, text in (("/none", "`/none`, named by LIGHTHARMONY_PROGRAM, is not a program"), (str(other), versions)):
            with unittest.mock.patch.dict(os.environ, LIGHTHARMONY_PROGRAM=program):
                self.assertRegex(comfyui.Run.VALIDATE_INPUTS(str(self.graph), ""), text)
                # Also without the check of the inputs, and for the keys.
                with self.assertRaisesRegex(lightharmony.Error, text):
                    comfyui.Run().run(**self.inputs)

    def test_a_node_of_the_graph_that_fails_is_shown_with_its_place(self):
        (self.folder / "plate.png").write_text("not a picture")
        with self.assertRaisesRegex(lightharmony.NodeFailed, r"graph\.ron:11:\d+: .*plate\.png"):
            comfyui.Run().run(**self.inputs)

    def test_the_user_can_cancel(self):
        class Interrupt(Exception):
            pass

        def throw():
            raise Interrupt

        management = types.SimpleNamespace(processing_interrupted=lambda: True, throw_exception_if_processing_interrupted=throw)
        package = types.ModuleType("comfy")
        package.model_management = management
        sys.modules.update({"comfy": package, "comfy.model_management": management})
        self.addCleanup(lambda: [sys.modules.pop(name) for name in ("comfy", "comfy.model_management")])
        with self.assertRaises(Interrupt):
            comfyui.Run().run(**{**self.inputs, "settings": "demo.splats=900002"})

    def test_the_defaults_fit_the_first_graph(self):
        command = [os.environ["LIGHTHARMONY_PROGRAM"], "init", "chair"]
        subprocess.run(command, cwd=self.folder, check=True, stdout=subprocess.DEVNULL)
        declared = comfyui.Run.INPUT_TYPES()["required"]
        inputs = {name: options["default"] for name, (_, options) in declared.items()}
        inputs["graph"] = str(self.folder / "chair" / inputs["graph"])
        inputs["settings"] = "demo.splats=3000\ndemo.width_px=48\ndemo.height_px=36\ntrace.samples=1"
        image, mask, _ = Host().prompt(**inputs)
        self.assertEqual((image.shape, mask.shape), ((1, 36, 48, 3), (1, 36, 48)))
        self.assertTrue(0 < mask.mean() < 0.5)

    def test_inputs_are_declared(self):
        declared = comfyui.Run.INPUT_TYPES()
        self.assertEqual(set(declared["required"]), set(self.inputs))
        self.assertEqual(declared["optional"], {"background": ("IMAGE",)})
        self.assertEqual(set(comfyui.NODE_CLASS_MAPPINGS), set(comfyui.NODE_DISPLAY_NAME_MAPPINGS))


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        CACHE = pathlib.Path(folder) / "cache"
        unittest.main()
