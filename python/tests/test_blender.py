#!/usr/bin/env python3
"""Tests of the Blender extension without a window: `PYTHON python/tests/test_blender.py [FOLDER]`.

PYTHON is one with `bpy` and `numpy` from PyPI (`pip install bpy==4.5.* --extra-index-url https://download.blender.org/pypi/`), and
LIGHTHARMONY_PROGRAM names the program. With FOLDER, the pictures and the exported scene are kept there.
"""
import math
import os
import pathlib
import runpy
import sys
import tempfile
import time
import unittest
import warnings

HERE = pathlib.Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent))

# Extensions are installed into a folder of this test, not into that of the user.
RESOURCES = tempfile.TemporaryDirectory()
os.environ["BLENDER_USER_RESOURCES"] = RESOURCES.name

import bpy
import numpy
from bpy_extras.object_utils import world_to_camera_view
from mathutils import Matrix, Vector

import blender as addon
import lightharmony
from lightharmony import files

FOLDER = None


def splats(path):
    """A floor of splats in the format of INRIA: grey, with a red stripe at positive x."""
    places = [(0.06 * x, 0.06 * y, 0.0) for x in range(-50, 51) for y in range(-50, 51)]
    names = ["x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1", "scale_2"]
    names += ["rot_0", "rot_1", "rot_2", "rot_3"]
    head = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(places)}\n"
    head += "".join(f"property float {name}\n" for name in names) + "end_header\n"
    rows = []
    for x, y, z in places:
        red = 1.2 if x > 1.8 else 0.4
        rows.append([x, y, z, 0, 0, 0, red, 0.4, 0.4, 6, math.log(0.022), math.log(0.022), math.log(0.002), 1, 0, 0, 0])
    path.write_bytes(head.encode() + numpy.array(rows, "<f4").tobytes())


def letter_f(material):
    """The letter F, 0.9 high and 0.15 thick, which no rotation or reflection maps to itself."""
    corners = [(0, 0), (0.15, 0), (0.15, 0.4), (0.4, 0.4), (0.4, 0.55), (0.15, 0.55), (0.15, 0.75), (0.55, 0.75), (0.55, 0.9), (0, 0.9)]
    count = len(corners)
    points = [(x, y, z) for y in (0, 0.15) for x, z in corners]
    faces = [[0, 1, 2, 5, 6, 9], [2, 3, 4, 5], [6, 7, 8, 9]]
    faces += [[count + i for i in reversed(face)] for face in faces]
    faces += [[i, i + count, (i + 1) % count + count, (i + 1) % count] for i in range(count)]
    mesh = bpy.data.meshes.new("F")
    mesh.from_pydata(points, [], faces)
    mesh.validate()
    mesh.materials.append(material)
    mesh.update()
    return bpy.data.objects.new("F", mesh)


def place(folder):
    """A scene with a floor, a letter and a shifted camera."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    addon.register()
    scene = bpy.context.scene
    link = scene.collection.objects.link
    blue = bpy.data.materials.new("blue")
    blue.use_nodes = True
    blue.node_tree.nodes["Principled BSDF"].inputs["Base Color"].default_value = (0.05, 0.2, 0.8, 1)
    letter = letter_f(blue)
    link(letter)
    letter.matrix_world = Matrix.Translation((0.3, -0.2, 0.05)) @ Matrix.Rotation(math.radians(35), 4, "Z") @ Matrix.Diagonal((1.3, 1.0, 0.8, 1))
    floor = bpy.data.meshes.new("floor")
    floor.from_pydata([(-3, -3, 0), (3, -3, 0), (3, 3, 0), (-3, 3, 0)], [], [[0, 1, 2, 3]])
    ground = bpy.data.objects.new("floor", floor)
    link(ground)
    lens = bpy.data.cameras.new("eye")
    lens.lens, lens.shift_x, lens.shift_y, lens.sensor_fit = 40.0, 0.1, -0.05, "VERTICAL"
    camera = bpy.data.objects.new("eye", lens)
    link(camera)
    camera.matrix_world = Matrix.Translation((2.2, -3.4, 1.9)) @ Vector((-1.9, 3.2, -1.6)).to_track_quat("-Z", "Y").to_matrix().to_4x4()
    sun = bpy.data.objects.new("sun", bpy.data.lights.new("sun", "SUN"))
    link(sun)
    sun.data.energy = 2.0
    sun.rotation_euler = (0.6, 0.2, 0)
    scene.camera = camera
    scene.render.resolution_x, scene.render.resolution_y = 320, 200
    scene.render.engine, scene.cycles.samples, scene.cycles.device = "CYCLES", 64, "CPU"
    scene.view_settings.view_transform = "Standard"
    bpy.context.view_layer.objects.active = letter
    letter.select_set(True)
    bpy.context.view_layer.update()
    splats(folder / "floor.ply")
    settings = scene.lightharmony
    settings.splats, settings.place, settings.folder = str(folder / "floor.ply"), ground, str(folder / "job")
    settings.samples, settings.colmap, settings.points = 16, str(folder / "colmap"), 4000
    return scene, letter, ground, camera


def package_repository():
    """Index of the repository into which packages are installed from files."""
    return next(index for index, one in enumerate(bpy.context.preferences.extensions.repos) if one.module == "user_default")


def dilated(mask):
    """A mask with all pixels next to it."""
    out = mask.copy()
    for dy in (-1, 0, 1):
        for dx in (-1, 0, 1):
            out |= numpy.roll(mask, (dy, dx), (0, 1))
    return out


class Extension(unittest.TestCase):
    def setUp(self):
        if FOLDER:
            self.folder = FOLDER / self._testMethodName
            self.folder.mkdir(parents=True, exist_ok=True)
        else:
            temporary = tempfile.TemporaryDirectory()
            self.addCleanup(temporary.cleanup)
            self.folder = pathlib.Path(temporary.name)
        os.environ["LIGHTHARMONY_CACHE"] = str(self.folder / "cache")
        self.scene, self.letter, self.ground, self.camera = place(self.folder)
        self.addCleanup(addon.unregister)
        self.addCleanup(addon.stop)

    def wait(self, state, seconds=120):
        """Calls the timer until the state is reached, as Blender does."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            addon.tick()
            if addon.session is None:
                raise AssertionError(addon.status.text)
            if addon.session.state == state:
                return
            time.sleep(0.05)
        raise AssertionError(f"{addon.session.state}, not {state}")

    def wait_for_change(self, seconds=20):
        """Calls the timer until the picture is no longer up to date."""
        end = time.monotonic() + seconds
        while addon.session.state == "up to date" and time.monotonic() < end:
            addon.tick()
            time.sleep(0.01)

    def outline(self):
        """The pixels that Cycles covers by the letter, at least half."""
        self.ground.hide_render = True
        self.scene.render.film_transparent = True
        path = str(self.folder / "cycles.png")
        settings = self.scene.render.image_settings
        settings.file_format, settings.color_mode = "PNG", "RGBA"
        self.scene.render.filepath = path
        bpy.ops.render.render(write_still=True)
        image = bpy.data.images.load(path)
        pixels = numpy.array(image.pixels[:]).reshape(image.size[1], image.size[0], 4)[::-1]
        self.ground.hide_render, self.scene.render.film_transparent = False, False
        return pixels[..., 3]

    def compare(self):
        """The letter of the written layers has the outline that Cycles renders."""
        want = self.outline()
        self.assertEqual(bpy.ops.lightharmony.layers(), {"FINISHED"})
        have = files.read_picture(self.folder / "job/out/layers.exr", "O")[..., 3]
        self.assertGreater((want > 0.5).sum(), 1500)
        for a, b in ((want, have), (have, want)):
            self.assertEqual(((a > 0.5) & ~dilated(b > 0.5)).sum(), 0, "outside by more than a pixel")
        rows, columns = numpy.indices(want.shape)
        for grid in (rows, columns):
            off = (grid * want).sum() / want.sum() - (grid * have).sum() / have.sum()
            self.assertLess(abs(off), 0.1, "centroid in pixels")
        return float(abs(want - have).max()), float(abs(want - have).mean())

    def test_the_object_is_where_blender_shows_it(self):
        self.assertEqual(bpy.ops.lightharmony.render(), {"FINISHED"})
        self.wait("up to date")
        print("coverage differs by at most and on average:", *self.compare())
        # Moved, turned about every axis and scaled; a parent and a modifier.
        parent = bpy.data.objects.new("parent", None)
        self.scene.collection.objects.link(parent)
        parent.matrix_world = Matrix.Rotation(0.4, 4, "X")
        self.letter.parent = parent
        self.letter.matrix_world = Matrix.Translation((-0.2, 0.2, 0.1)) @ Matrix.Rotation(0.5, 4, (1, 2, 3)) @ Matrix.Diagonal((1.1, 0.9, 1.2, 1))
        self.letter.modifiers.new("wide", "SOLIDIFY").thickness = 0.1
        self.camera.location.x += 0.2
        bpy.context.view_layer.update()
        self.assertEqual(bpy.ops.lightharmony.update(), {"FINISHED"})
        self.wait_for_change()
        self.wait("up to date")
        print("after the move:", *self.compare())
        image = bpy.data.images[addon.IMAGE]
        self.assertEqual(tuple(image.size), (320, 200))
        background = self.camera.data.background_images[0]
        self.assertTrue(background.image == image and self.camera.data.show_background_images)
        # One background, whatever was rendered.
        self.assertEqual(len(self.camera.data.background_images), 1)

    def test_the_capture_is_placed_by_an_object(self):
        empty = bpy.data.objects.new("capture", None)
        self.scene.collection.objects.link(empty)
        empty.matrix_world = Matrix.Translation((0, 0, 0.5)) @ Matrix.Rotation(math.pi / 2, 4, "Z") @ Matrix.Scale(2, 4)
        bpy.context.view_layer.update()
        self.scene.lightharmony.capture = empty
        job = addon.Job(bpy.context)
        job.export(bpy.context)
        job.write()
        depth = lightharmony.values(job.graph, ["view.depth"])["view.depth"][..., 0]
        view = addon.camera_of(self.scene)
        # The floor of splats is at a height of 0.5.
        y, x = 150, 100
        world = Matrix(view["c2w_opengl"])
        point = world @ (addon.ray_of(view, x, y) * depth[y, x])
        self.assertAlmostEqual(point.z, 0.5, delta=0.04)

    def test_units_are_those_of_the_scene(self):
        self.scene.unit_settings.scale_length = 0.1
        self.assertEqual(bpy.ops.lightharmony.render(), {"FINISHED"})
        self.wait("up to date")
        self.compare()

    def test_without_a_mesh_one_is_extracted_once(self):
        settings = self.scene.lightharmony
        settings.place, settings.samples = None, 1
        self.assertEqual(bpy.ops.lightharmony.render(), {"FINISHED"})
        self.wait("up to date")
        job = addon.session.job
        values = lightharmony.values(job.graph, ["proxy"])
        # The floor of splats, 6 units wide.
        self.assertLess(abs(values["proxy"]["positions"][:, 2]).mean(), 0.1)
        key = lightharmony.keys(job.graph, ["proxy"])
        self.letter.location.x += 0.3
        bpy.context.view_layer.update()
        self.wait_for_change()
        self.wait("up to date")
        self.assertEqual(lightharmony.keys(job.graph, ["proxy"]), key)
        # Around the new position.
        bpy.ops.lightharmony.update()
        job.write()
        self.assertNotEqual(lightharmony.keys(job.graph, ["proxy"]), key)

    def test_paths_may_begin_with_the_folder_of_the_file(self):
        bpy.ops.wm.save_as_mainfile(filepath=str(self.folder / "scene.blend"))
        with warnings.catch_warnings():
            # Blender 4.5 and later warn of a property that does not state this.
            warnings.simplefilter("error")
            settings = bpy.context.scene.lightharmony
            settings.splats, settings.folder, settings.colmap = "//floor.ply", "//relative", "//relative"
        job = addon.Job(bpy.context)
        job.export(bpy.context)
        job.write()
        self.assertEqual(job.graph, str(self.folder / "relative/graph.ron"))
        self.assertEqual(lightharmony.check(job.graph), [])

    def test_what_cannot_be_rendered_is_refused(self):
        settings = self.scene.lightharmony
        def refused(text):
            with self.assertRaisesRegex(RuntimeError, text):
                bpy.ops.lightharmony.render()
            self.assertIsNone(addon.session)
        settings.splats = "/none.ply"
        refused("does not exist")
        settings.splats = str(self.folder / "floor.ply")
        self.camera.data.type = "ORTHO"
        refused("not a perspective camera")
        self.camera.data.type = "PERSP"
        bpy.context.view_layer.objects.active = self.camera
        refused("select the object")
        bpy.context.view_layer.objects.active = self.ground
        refused("is the place")
        bpy.context.view_layer.objects.active = self.letter
        settings.folder = "//job"
        refused("save the .blend file")
        settings.folder = str(self.folder / "job")
        before = os.environ["LIGHTHARMONY_PROGRAM"]
        self.addCleanup(os.environ.__setitem__, "LIGHTHARMONY_PROGRAM", before)
        os.environ["LIGHTHARMONY_PROGRAM"] = "/none"
        refused("is not a program")
        other = self.folder / "other"
        other.write_text("#!/bin/sh\necho lightharmony 9.9.9\n")
        other.chmod(0o755)
        os.environ["LIGHTHARMONY_PROGRAM"] = str(other)
        refused("is version 9.9.9")

    def test_the_package_can_be_installed(self):
        release = runpy.run_path(str(HERE.parent.parent / ".ci/release"))
        path = self.folder / "extension.zip"
        release["blender"](path)
        # The package has classes of its own.
        addon.unregister()
        self.addCleanup(addon.register)
        bpy.ops.extensions.package_install_files(filepath=str(path), repo="user_default", enable_on_install=True)
        name = "bl_ext.user_default.lightharmony"
        try:
            package = sys.modules[name]
            self.assertIsNot(package, addon)
            # It brings its copy of the module, and finds the program by its preferences.
            self.assertEqual(pathlib.Path(package.lightharmony.__file__).parent.parent, pathlib.Path(package.__file__).parent)
            settings = self.scene.lightharmony
            settings.splats, settings.folder = str(self.folder / "floor.ply"), str(self.folder / "job")
            preferences = bpy.context.preferences.addons[name].preferences
            preferences.program = "/none"
            with self.assertRaisesRegex(RuntimeError, "`/none`, named by the argument"):
                bpy.ops.lightharmony.render()
            preferences.program = os.environ["LIGHTHARMONY_PROGRAM"]
            self.assertEqual(bpy.ops.lightharmony.render(), {"FINISHED"})
            package.stop()
        finally:
            bpy.ops.preferences.addon_disable(module=name)
            bpy.ops.extensions.package_uninstall(repo_index=package_repository(), pkg_id="lightharmony")

    def test_mistakes_are_shown_with_their_places(self):
        (self.folder / "floor.ply").write_bytes(b"ply\nnothing")
        bpy.ops.lightharmony.render()
        self.wait("the graph cannot run")
        mistake = addon.session.mistakes[0]
        self.assertEqual(pathlib.Path(mistake.file).name, "graph.ron")
        self.assertEqual(mistake.line, 6)
        self.assertIn("floor.ply", mistake.message)
        splats(self.folder / "floor.ply")
        self.wait("up to date")

    def test_stopping_ends_the_program(self):
        bpy.ops.lightharmony.render()
        process = addon.session.watch._process._process
        self.assertIsNone(process.poll())
        bpy.ops.lightharmony.stop()
        self.assertIsNotNone(process.poll())
        self.assertIsNone(addon.tick())

    def test_a_deleted_object_ends_the_program(self):
        bpy.ops.lightharmony.render()
        process = addon.session.watch._process._process
        bpy.data.objects.remove(self.letter)
        self.assertIsNone(addon.tick())
        self.assertEqual(addon.status.text, "the object was deleted")
        self.assertIsNotNone(process.poll())

    def test_a_scene_is_exported_to_colmap(self):
        scene = self.scene
        scene.frame_start, scene.frame_end = 1, 3
        scene.cycles.samples = 4
        scene.render.resolution_x, scene.render.resolution_y = 120, 80
        for frame, x in ((1, 2.2), (3, 1.4)):
            self.camera.location.x = x
            self.camera.keyframe_insert("location", frame=frame)
        before = scene.frame_current
        self.assertEqual(bpy.ops.lightharmony.colmap(), {"FINISHED"})
        self.assertEqual((scene.frame_current, self.letter.hide_render), (before, False))
        out = self.folder / "colmap"
        # Cameras: corners of the letter project to the pixels at which Blender shows them.
        lens = (out / "sparse/0/cameras.txt").read_text().splitlines()[1].split()
        w, h, fx, fy, cx, cy = map(float, lens[2:])
        poses = [line.split() for line in (out / "sparse/0/images.txt").read_text().splitlines() if not line.startswith("#") and line]
        self.assertEqual([pose[-1] for pose in poses], ["0001.png", "0002.png", "0003.png"])
        worst = 0.0
        for frame, pose in enumerate(poses, 1):
            scene.frame_set(frame)
            from mathutils import Quaternion
            turn, shift = Quaternion(map(float, pose[1:5])), Vector(map(float, pose[5:8]))
            for vertex in self.letter.data.vertices:
                world = self.letter.matrix_world @ vertex.co
                seen = world_to_camera_view(scene, self.camera, world)
                local = turn @ world + shift
                worst = max(worst, abs(fx * local.x / local.z + cx - seen.x * w), abs(fy * local.y / local.z + cy - (1 - seen.y) * h))
        print("cameras differ by at most", worst, "pixels")
        self.assertLess(worst, 0.01)
        # Depth and points: the floor is at z = 0, and the letter is not there.
        points = numpy.loadtxt(out / "sparse/0/points3D.txt")
        self.assertLess(abs(points[:, 3]).max(), 1e-4)
        self.assertGreater(len(points), 2000)
        depth = files.read_exr(out / "depth/0001.exr")["Z"]
        self.assertTrue(numpy.isinf(depth).any() and numpy.isfinite(depth).any())
        # Truth pairs: equal except around the letter and its shadow.
        both = [addon.pixels_of(str(out / kind / "0002.png")) for kind in ("images", "with")]
        differs = abs(both[0] - both[1]).max(-1) > 0.15
        self.assertTrue(0.02 < differs.mean() < 0.5, differs.mean())
        # The program reads the model, and the first camera is that of the graph.
        graph = self.folder / "read.ron"
        graph.write_text('Graph(version: 1, scene: (up: "+z"), nodes: (splats: LoadSplats(path: "floor.ply"), cameras: LoadCameras(path: "colmap"), photos: LoadPhotos(rig: "cameras", path: "colmap/images", points: "colmap/sparse/0/points3D.txt"), view: SplatRender(splats: "splats", rig: "cameras")))')
        seen = lightharmony.values(graph, ["view.depth"])["view.depth"]["0001"][..., 0]
        both = numpy.isfinite(seen) & numpy.isfinite(depth)
        self.assertGreater(both.mean(), 0.3)
        self.assertLess(numpy.median(abs(seen[both] - depth[both]) / depth[both]), 0.01)
        done = lightharmony.run(graph, only="photos", out=self.folder / "out")
        self.assertEqual(done.code, 0)


if __name__ == "__main__":
    if len(sys.argv) > 1 and not sys.argv[1].startswith("-") and sys.argv[1] != "Extension" and "." not in sys.argv[1].split("/")[-1]:
        FOLDER = pathlib.Path(sys.argv.pop(1)).resolve()
    unittest.main()
