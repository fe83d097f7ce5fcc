#!/usr/bin/env python3
"""Tests of the benchmark's generator that need no Blender: `python3 python/tests/test_bench.py`.

They need what python/bench/requirements.txt lists, but not `bpy`.
"""
import json
import pathlib
import struct
import sys
import tempfile
import unittest

import numpy as np

HERE = pathlib.Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent / "bench"))

import accumulate
import cameras
import capture
import check
import distortions
import make
import objects
import pictures
import places
import regions
import shapes
import sky


def glb_parts(data):
    """Positions and triangles of each primitive of a GLB file."""
    assert data[:4] == b"glTF" and struct.unpack("<I", data[8:12])[0] == len(data)
    size = struct.unpack("<I", data[12:16])[0]
    root, blob = json.loads(data[20:20 + size]), data[28 + size:]

    def values(index):
        accessor = root["accessors"][index]
        view = root["bufferViews"][accessor["bufferView"]]
        kind = {5126: "<f4", 5123: "<u2", 5125: "<u4"}[accessor["componentType"]]
        count = accessor["count"] * (3 if accessor["type"] == "VEC3" else 1)
        return np.frombuffer(blob, kind, count, view["byteOffset"])

    return root, [(values(p["attributes"]["POSITION"]).reshape(-1, 3), values(p["attributes"]["NORMAL"]).reshape(-1, 3),
                   values(p["indices"]).reshape(-1, 3)) for p in root["meshes"][0]["primitives"]]


class Objects(unittest.TestCase):
    def test_files(self):
        total = 0
        for name, made in objects.OBJECTS.items():
            data = objects.glb(made())
            total += len(data)
            self.assertEqual(data, objects.glb(made()), f"{name} is made the same twice")
            root, parts = glb_parts(data)
            self.assertIn("CC0", root["asset"]["copyright"])
            points = np.concatenate([p for p, _, _ in parts])
            self.assertGreater(points[:, 1].max(), 0.35, name)
            self.assertLess(points[:, 1].max(), 0.55, name)
            self.assertAlmostEqual(points[:, 1].min(), 0.0, places=4, msg=name)
            for positions, normals, faces in parts:
                self.assertLess(faces.max(), len(positions))
                self.assertLess(np.abs(np.linalg.norm(normals, axis=1) - 1).max(), 1e-3, name)
        self.assertLess(total, 5e6)
        self.assertGreaterEqual(len(objects.OBJECTS), 6)

    def test_faces_look_outwards(self):
        for name in ("matte", "metal", "glass", "glossy", "emissive"):
            for positions, faces in ((p, f) for p, _, f in glb_parts(objects.glb(objects.OBJECTS[name]()))[1]):
                a, b, c = (positions[faces[:, k]].astype(float) for k in range(3))
                self.assertGreater((a * np.cross(b, c)).sum() / 6, 0, name)


class Places(unittest.TestCase):
    def test_enough_and_deterministic(self):
        made, again, other = places.all_places(1), places.all_places(1), places.all_places(2)
        self.assertGreaterEqual(len(made), 12)
        self.assertEqual([repr(p) for p in made], [repr(p) for p in again])
        self.assertTrue(all(repr(p) != repr(q) for p, q in zip(made, other)))
        for tag in ("room", "courtyard", "street", "table", "lamp", "window", "sun", "overcast", "dusk", "coloured-walls", "mirror",
                    "glossy-floor", "clutter"):
            self.assertTrue(any(tag in p.tags for p in made), tag)
        self.assertEqual({o for p in made for o in p.objects}, set(objects.OBJECTS))

    def test_cameras_see_the_object_and_keep_off_the_furniture(self):
        for seed in (1, 2):
            for place in places.all_places(seed):
                boxes = place.obstacles()
                for matrix in cameras.views(place, places.generator(seed, place.name), 6):
                    eye = matrix[:3, 3]
                    self.assertTrue(cameras.within(eye, place.inside))
                    self.assertFalse(cameras.blocked(eye, np.array(place.at) + (0, 0, 0.25 * place.scale), boxes), place.name)

    def test_objects_have_room(self):
        for place in places.all_places(1):
            reach = 0.25 * place.scale
            low, high = np.array(place.at) + (-reach, -reach, 0.01), np.array(place.at) + (reach, reach, 0.5 * place.scale)
            for a, b in place.obstacles():
                self.assertFalse(np.all(a < high) and np.all(b > low), f"{place.name}: {a} {b}")

    def test_rooms_are_lit(self):
        for place in places.all_places(1):
            emits = any(place.looks[p.material].emission > 0 for p in place.parts)
            self.assertTrue(emits or place.sky is not None, place.name)


class Light(unittest.TestCase):
    def test_the_sun_has_its_irradiance_and_direction(self):
        spec = sky.Sky("clear", (140, 48), 9.0)
        with_sun, without = sky.panorama(spec, 512), sky.panorama(sky.Sky("clear"), 512)
        above = sky.directions(512)[..., 2] > 0
        extra = np.where(above[..., None], with_sun - without, 0)[..., 0] * sky.solid_angles(512)[:, None]
        self.assertAlmostEqual(extra.sum(), 9.0, delta=0.05)
        mean = (extra[..., None] * sky.directions(512)).sum((0, 1))
        self.assertGreater(mean / np.linalg.norm(mean) @ sky.direction(140, 48), 0.9999)

    def test_the_centre_column_looks_along_y(self):
        d = sky.directions(256)
        self.assertGreater(d[64, 128, 1], 0.99)
        self.assertGreater(d[64, 192, 0], 0.99)
        self.assertGreater(d[0, 0, 2], 0.99)


class Cameras(unittest.TestCase):
    def test_the_target_is_in_the_middle(self):
        matrix, lens = cameras.look_at((2, -3, 1.5), (0.2, 0.1, 0.4)), cameras.lens(120, 80, 45)
        x, y, z = check.project(np.array([[0.2, 0.1, 0.4]]), {"transform_matrix": matrix.tolist()}, lens)
        self.assertEqual((x[0], y[0]), (60, 40))
        self.assertAlmostEqual(z[0], np.linalg.norm(np.array([1.8, -3.1, 1.1])))
        x, y, _ = check.project(np.array([[0.2, 0.1, 0.6]]), {"transform_matrix": matrix.tolist()}, lens)
        self.assertLess(y[0], 40, "up is up in the picture")

    def test_colmap_gives_the_same_projection(self):
        matrix = cameras.look_at((2, -3, 1.5), (0.2, 0.1, 0.4))
        with tempfile.TemporaryDirectory() as folder:
            folder = pathlib.Path(folder) / "sparse/0"
            cameras.colmap(folder, [matrix], ["photos/0001.png"], (120, 80), 45, np.zeros((1, 3)), np.array([[1, 2, 3]], np.uint8))
            words = (folder / "images.txt").read_text().splitlines()[1].split()
            camera = (folder / "cameras.txt").read_text().splitlines()[1].split()
        self.assertEqual(words[-1], "0001.png")
        self.assertEqual(camera[1:4], ["PINHOLE", "120", "80"])
        w, x, y, z = (float(v) for v in words[1:5])
        turn = np.array([[1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
                         [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
                         [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)]])
        local = turn @ np.array([0.7, -0.2, 0.9]) + [float(v) for v in words[5:8]]
        u, v = (float(camera[4]) * local[0] / local[2] + 60, float(camera[5]) * local[1] / local[2] + 40)
        i, j, depth = check.project(np.array([[0.7, -0.2, 0.9]]), {"transform_matrix": matrix.tolist()}, cameras.lens(120, 80, 45))
        self.assertEqual((int(u), int(v)), (i[0], j[0]))
        self.assertAlmostEqual(local[2], depth[0])


    def test_a_box_blocks_what_is_behind_it(self):
        box = [(np.array([-0.5, -0.5, 0.0]), np.array([0.5, 0.5, 1.0]))]
        self.assertTrue(cameras.blocked((3, 0, 0.5), (-3, 0, 0.5), box))
        self.assertFalse(cameras.blocked((3, 0, 1.5), (-3, 0, 1.5), box), "above")
        self.assertFalse(cameras.blocked((3, 0, 0.5), (1, 0, 0.5), box), "before")
        self.assertFalse(cameras.blocked((3, 2, 0.5), (-3, 2, 0.5), box), "aside, parallel to an axis")
        self.assertFalse(cameras.blocked((3, 0, 0.5), (6, 0, 0.5), box), "behind the eye")


class Passes(unittest.TestCase):
    def test_the_difference_is_that_of_two_seeds(self):
        with tempfile.TemporaryDirectory() as folder:
            render = lambda seed: 0.5 + 0.01 * np.random.default_rng(seed).standard_normal((64, 64, 3))
            mean, difference, passes = accumulate.converge(render, f"{folder}/a.npz", 0.0, 8)
            self.assertEqual(passes, 8)
            self.assertAlmostEqual(difference / (2 ** 0.5 * accumulate.rmse(mean, np.full_like(mean, 0.5))), 1, delta=0.05)
            other, _, _ = accumulate.converge(render, f"{folder}/b.npz", 0.0, 8, seed=100)
            self.assertAlmostEqual(difference / accumulate.rmse(mean, other), 1, delta=0.05)

    def test_it_stops_at_the_bound_and_continues_with_the_same_result(self):
        with tempfile.TemporaryDirectory() as folder:
            seeds = []

            def render(seed):
                seeds.append(seed)
                if len(seeds) == 4:
                    raise KeyboardInterrupt
                return 0.5 + 0.01 * np.random.default_rng(seed).standard_normal((16, 16, 3))

            with self.assertRaises(KeyboardInterrupt):
                accumulate.converge(render, f"{folder}/a.npz", 0.004, 50, seed=7)
            mean, difference, passes = accumulate.converge(render, f"{folder}/a.npz", 0.004, 50, seed=7)
            whole, _, count = accumulate.converge(render, f"{folder}/b.npz", 0.004, 50, seed=7)
            self.assertLess(difference, 0.004)
            self.assertEqual(passes, count)
            self.assertEqual(passes % 2, 0)
            np.testing.assert_array_equal(mean, whole)
            self.assertEqual(seeds[:5], [7, 8, 9, 10, 10])

    def test_the_region_counts_as_well_as_the_picture(self):
        with tempfile.TemporaryDirectory() as folder:
            halves = accumulate.Halves(f"{folder}/a.npz")
            a, b = np.full((10, 10, 3), 0.5), np.full((10, 10, 3), 0.5)
            b[0, 0] = 0.6
            halves.add(a)
            halves.add(b)
            mask = np.zeros((10, 10), bool)
            mask[0, 0] = True
            self.assertAlmostEqual(halves.difference(mask), 10 * halves.difference(), places=6)


class Regions(unittest.TestCase):
    def test_rule(self):
        without = np.full((8, 8, 3), 0.5)
        with_, alpha, hidden = without.copy(), np.zeros((8, 8)), without.copy()
        with_[4:, :] *= 0.8
        with_[0, 0] *= 0.5
        alpha[4:6, :4] = 0.3
        hidden[:] = with_
        hidden[6:, 4:] *= 1.2
        shadow, reflection = regions.regions(without, with_, alpha, hidden)
        self.assertFalse(shadow[0, 0], "a single pixel is noise")
        self.assertFalse(shadow[4, 1], "the object's soft edge belongs to no region")
        self.assertTrue(shadow[7, 1] and not reflection[7, 1])
        self.assertTrue(reflection[7, 6] and not shadow[7, 6])
        self.assertFalse(shadow[2].any())


class Capture(unittest.TestCase):
    def test_colours_come_from_the_photographs_that_see_a_vertex(self):
        vertices, faces = shapes.grid((-1, -1, 0), (2, 0, 0), (0, 2, 0), 0.1)
        below, more = shapes.grid((-1, -1, -0.5), (2, 0, 0), (0, 2, 0), 0.5)
        every, all_faces = np.concatenate([vertices, below]), np.concatenate([faces, more + len(vertices)])
        lens, matrix = cameras.lens(64, 64, 60), cameras.look_at((0.01, 0, 3), (0, 0, 0))
        picture = np.zeros((64, 64, 3))
        picture[:, :32, 0], picture[:, 32:, 1], picture[:32, :, 2] = 0.5, 0.25, 0.75
        colours, seen = capture.seen_colours(every, all_faces, [(picture, np.full((64, 64), 3.0), matrix, lens)], 0.02)
        self.assertTrue(seen[:len(vertices)].all())
        self.assertFalse(seen[len(vertices):].any(), "hidden by the surface above")
        side = (vertices - matrix[:3, 3]) @ matrix[:3, 0]
        up = (vertices - matrix[:3, 3]) @ matrix[:3, 1]
        left, right = np.flatnonzero((side < -0.2) & (up > 0.2)), np.flatnonzero((side > 0.2) & (up < -0.2))
        np.testing.assert_allclose(colours[left], np.broadcast_to([0.5, 0, 0.75], (len(left), 3)))
        np.testing.assert_allclose(colours[right], np.broadcast_to([0, 0.25, 0], (len(right), 3)))
        filled, known = capture.fill(colours, seen, all_faces)
        self.assertEqual(len(capture.kept(all_faces, known)), len(faces))

    def test_ply(self):
        with tempfile.TemporaryDirectory() as folder:
            file = pathlib.Path(folder) / "mesh.ply"
            vertices, faces = shapes.grid((0, 0, 0), (1, 0, 0), (0, 1, 0), 0.5)
            capture.write_ply(file, vertices, faces, np.full((len(vertices), 3), 0.2140411))
            points, colours = check.read_ply(file)
        np.testing.assert_allclose(points, vertices)
        self.assertTrue((colours == 127).all() or (colours == 128).all())


def synthetic_case(folder, name="synthetic"):
    """A case by formula: a lit ball over a plane with a soft shadow to its right."""
    truth = folder / name / "truth" / "view_0"
    truth.mkdir(parents=True)
    h, w = 80, 120
    j, i = np.mgrid[:h, :w].astype(float)
    without = 0.35 + 0.1 * np.sin(i / 5)[..., None] * np.sin(j / 7)[..., None] * np.ones(3) + 0.002 * j[..., None]
    ratio = 1 - 0.6 * np.exp(-((i - 75) / 14) ** 2 - ((j - 56) / 4) ** 2)[..., None] * np.array([1, 0.95, 0.9])
    distance = np.hypot(i - 60, j - 44)
    alpha = np.clip(14.5 - distance, 0, 1)[..., None]
    shade = (0.25 + 0.5 * np.clip(((60 - i) * 0.7 + (44 - j) * 0.5) / 14 + 0.2, 0, 1))[..., None] * np.array([0.9, 0.5, 0.3])
    pictures.write_exr(truth / "without.exr", without)
    pictures.write_exr(truth / "with.exr", without * ratio * (1 - alpha) + shade * alpha)
    pictures.write_exr(truth / "alpha.exr", alpha, "Y")
    pictures.write_exr(truth / "depth.exr", np.full((h, w), 2.0), "Z")
    mask = np.zeros((h, w), np.uint8)
    mask[59:66, 50:70] = 255
    pictures.write_png(truth / "reflection.png", mask)
    cameras.write_json(folder / name / "views.json", cameras.transforms([cameras.look_at((0, -2, 0.8), (0, 0, 0.2))], ["view_0.png"], (w, h), 45))
    cameras.write_json(folder / name / "case.json", {"name": name, "views": ["view_0"], "pose": {"translation": [0, 0, 0], "scale": 1.0}})
    return folder / name


class FakeStage:
    """In place of Blender: a grey place with noise, true depth of its dense points, and a dark disc as the object."""
    renders = 0

    def __init__(self, place):
        self.points = np.concatenate([p.mesh(0.05)[0] for p in place.parts])
        self.shown = False

    def insert(self, *_):
        pass

    def look(self, matrix, lens):
        self.frame, self.rig = {"transform_matrix": np.array(matrix).tolist()}, lens

    def look_around(self, _, width):
        self.rig = {"w": width, "h": width // 2}

    def show(self, objects):
        self.shown = objects

    def disc(self):
        j, i = np.mgrid[:self.rig["h"], :self.rig["w"]]
        return np.hypot(i - self.rig["w"] / 2, j - self.rig["h"] / 2)

    def render(self, samples, seed, depth=False, denoise=False):
        FakeStage.renders += 1
        picture = 0.5 + 0.02 / samples ** 0.5 * np.random.default_rng(seed).standard_normal((self.rig["h"], self.rig["w"], 4))
        if self.shown:
            picture[self.disc() < 8] *= 0.5
        return (picture, self.depth()) if depth else picture

    def depth(self):
        x, y, z = check.project(self.points, self.frame, self.rig)
        nearest = np.full((self.rig["h"], self.rig["w"]), np.inf)
        np.minimum.at(nearest, (y, x), z)
        return nearest

    def alpha(self, _):
        return (self.disc() < 5).astype(float)


class Making(unittest.TestCase):
    def test_a_set_is_complete_is_continued_and_is_the_same_again(self):
        quality = make.Quality(size=(60, 40), views=1, photos=6, photo_samples=4, samples=4, bound=0.0028, limit=20, panorama=32,
                               panorama_samples=4, panorama_bound=0.01)
        place = next(p for p in places.all_places(1) if p.name == "room-gloss")

        class Faked(make.Maker):
            def stage(self, light=None):
                self.stage_ = self.stage_ or FakeStage(self.place)
                return self.stage_

        def once(out, fail_at=None):
            FakeStage.renders = 0
            (out / "objects").mkdir(parents=True, exist_ok=True)
            objects.write("glossy", out / "objects/glossy.glb")
            maker = Faked(out, out.with_name(out.name + ".work"), place, ["glossy"], 1, quality, 1)
            if fail_at:
                real = FakeStage.render

                def failing(self, *a, **k):
                    if FakeStage.renders == fail_at:
                        raise KeyboardInterrupt
                    return real(self, *a, **k)
                FakeStage.render = failing
                try:
                    with self.assertRaises(KeyboardInterrupt):
                        maker.make()
                finally:
                    FakeStage.render = real
                return
            maker.make()
            cameras.write_json(out / "set.json", {"cases": ["room-gloss-glossy"]})
            make.sums(out)

        with tempfile.TemporaryDirectory() as folder:
            first, second = pathlib.Path(folder) / "a", pathlib.Path(folder) / "b"
            say, make.say = make.say, lambda text: None
            try:
                once(first)
                whole = FakeStage.renders
                once(first)
                self.assertEqual(FakeStage.renders, 0, "nothing is made again")
                for stop in (3, 10, 12):
                    once(second, fail_at=stop)
                once(second)
                self.assertLess(FakeStage.renders, whole)
            finally:
                make.say = say
            made = {p.relative_to(first): p for p in first.rglob("*") if p.is_file()}
            self.assertEqual(set(made), {p.relative_to(second) for p in second.rglob("*") if p.is_file()})
            for name, file in made.items():
                if name.suffix != ".json" and name.name != "SHA256SUMS":
                    self.assertEqual(file.read_bytes(), (second / name).read_bytes(), name)
            case = json.loads((first / "room-gloss-glossy/case.json").read_text())
            self.assertEqual(set(case), {"version", "name", "scene", "tags", "object", "pose", "probe", "views", "mesh", "capture"})
            reached = json.loads((first / "room-gloss-glossy/render.json").read_text())
            self.assertIsInstance(reached["light_factor"], float)
            self.assertTrue(all(p["reached"] and p["difference"] <= 0.01 for p in reached["pictures"].values()))
            faults, _ = check.check(first)
            self.assertEqual(faults, [])
            # A mesh 20 cm too low, with its digest.
            file = first / "scenes/room-gloss/mesh.ply"
            head, body = file.read_bytes().split(b"end_header\n", 1)
            rows = np.frombuffer(body, [("p", "<f4", 3), ("c", "u1", 3)], len(check.read_ply(file)[0])).copy()
            rows["p"][:, 2] -= 0.2
            file.write_bytes(head + b"end_header\n" + rows.tobytes() + body[rows.nbytes:])
            make.sums(first)
            self.assertIn("the mesh does not fit", " ".join(check.check(first)[0]))


class Distortions(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.temporary = tempfile.TemporaryDirectory()
        cls.truth = distortions.Truth(synthetic_case(pathlib.Path(cls.temporary.name)), "view_0")

    @classmethod
    def tearDownClass(cls):
        cls.temporary.cleanup()

    def test_without_a_fault_the_picture_is_the_truth(self):
        self.assertLess(accumulate.rmse(distortions.distorted(self.truth, ""), self.truth.with_), 1e-3)

    def test_each_fault_grows_with_its_strength(self):
        exact = distortions.distorted(self.truth, "")
        self.assertGreaterEqual(len(distortions.FAULTS), 20)
        for name in distortions.FAULTS:
            errors = [np.abs(distortions.distorted(self.truth, f"{name}:{s}") - exact).mean() for s in distortions.STRENGTHS]
            self.assertGreater(errors[0], 0, name)
            self.assertEqual(errors, sorted(errors), name)

    def test_faults_stay_in_their_layer(self):
        exact = distortions.distorted(self.truth, "")
        outside, inside = self.truth.alpha[..., 0] <= 0, self.truth.alpha[..., 0] >= 1
        for name in distortions.FAULTS:
            made = distortions.distorted(self.truth, f"{name}:3")
            if name.startswith("shadow"):
                np.testing.assert_allclose(made[inside], exact[inside], atol=1e-6, err_msg=name)
            if name in ("object_bright", "object_dark", "object_hue", "object_grey", "object_flip", "object_flat", "object_noise"):
                np.testing.assert_allclose(made[outside], exact[outside], atol=1e-6, err_msg=name)

    def test_a_picture_is_the_same_twice(self):
        for recipe in ("object_noise:2", "background_noise:3 shadow_none"):
            np.testing.assert_array_equal(distortions.distorted(self.truth, recipe), distortions.distorted(self.truth, recipe))

    def test_nothing_is_the_background(self):
        np.testing.assert_allclose(distortions.distorted(self.truth, "nothing"), self.truth.without, atol=1e-6)

    def test_the_table_of_pairs(self):
        rows = distortions.pairs()
        self.assertGreaterEqual(len(rows), 20)
        self.assertEqual([int(r["pair"]) for r in rows], list(range(1, len(rows) + 1)))
        for row in rows:
            for word in f"{row['better']} {row['worse']}".split():
                name, _, strength = word.partition(":")
                self.assertIn(name, distortions.ALL)
                self.assertTrue(name in {f.__name__ for f in distortions.ONCE} or int(strength) in distortions.STRENGTHS, word)
            if row["kind"] == "more":
                self.assertTrue(row["worse"].startswith(row["better"] + " "), row)
            if row["kind"] == "stronger":
                (a, b), (c, d) = row["better"].split(":"), row["worse"].split(":")
                self.assertTrue(a == c and int(b) < int(d), row)


class Sets(unittest.TestCase):
    def test_digests(self):
        with tempfile.TemporaryDirectory() as folder:
            folder = pathlib.Path(folder)
            (folder / "a").mkdir()
            (folder / "a/b.txt").write_text("b")
            make.sums(folder)
            self.assertEqual(check.digests(folder), [])
            (folder / "a/b.txt").write_text("c")
            (folder / "new.txt").write_text("")
            self.assertEqual(check.digests(folder), ["a/b.txt: differs from SHA256SUMS", "new.txt: not in SHA256SUMS"])

    def test_the_small_set_exists(self):
        made = {p.name for p in places.all_places(1)}
        self.assertGreaterEqual(len({p for p, _ in places.SMALL}), 4)
        self.assertTrue(all(p in made and o in objects.OBJECTS for p, o in places.SMALL))


if __name__ == "__main__":
    unittest.main()
