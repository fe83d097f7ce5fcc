#!/usr/bin/env python3
"""Tests of the module with the real program: `LIGHTHARMONY_PROGRAM=target/release/lightharmony python3 python/tests/test_module.py`.

They need NumPy, and nothing else outside the standard library.
"""
import os
import pathlib
import re
import signal
import stat
import subprocess
import sys
import tempfile
import threading
import time
import unittest

HERE = pathlib.Path(__file__).resolve().parent
if "--installed" in sys.argv:
    # The module of the environment, which brings its own program.
    sys.argv.remove("--installed")
else:
    sys.path.insert(0, str(HERE.parent))

import lightharmony
from lightharmony import files, program

GRAPH = """Graph(
    version: 1,
    scene: (up: "+z", seed: 3),
    nodes: (
        demo:   DemoScene(place: Courtyard, splats: 3000, width_px: 48, height_px: 27, truth_width_px: 32),
        pose:   Pose(translation: (0.0, 0.0, 0.0), yaw_deg: 30.0),
        camera: Camera(eye: (2.0, -2.5, 1.2), target: (0.0, 0.0, 0.2), width_px: 49, height_px: 27, fov_y_deg: 40.0),
        view:   SplatRender(splats: "demo.splats", rig: "camera"),
        probe:  CubeRig(at: "pose", height_metres: 0.3, size_px: 24),
        faces:  SplatRender(splats: "demo.splats", rig: "probe"),
        pano:   Stitch(views: "faces", width_px: 64),
        save:   WriteImage(image: "view", path: "view.png"),
    ),
)
"""


def quiet(path):
    """Processes whose command line contains `path`."""
    found = subprocess.run(["ps", "-eo", "pid,args"], capture_output=True, text=True).stdout.splitlines()
    return [line for line in found if str(path) in line and "ps -eo" not in line]


class Case(unittest.TestCase):
    def setUp(self):
        temporary = tempfile.TemporaryDirectory()
        self.addCleanup(temporary.cleanup)
        self.folder = pathlib.Path(temporary.name).resolve()
        self.graph = self.folder / "graph.ron"
        self.graph.write_text(GRAPH)
        self.addCleanup(os.environ.__setitem__, "LIGHTHARMONY_CACHE", os.environ.get("LIGHTHARMONY_CACHE", ""))
        # One cache for all tests, so that the demo scene is made once.
        os.environ["LIGHTHARMONY_CACHE"] = str(CACHE)
        self.out = self.folder / "out"

    def script(self, name, text):
        """A program that is a shell script."""
        path = self.folder / name
        path.write_text("#!/bin/sh\n" + text)
        path.chmod(path.stat().st_mode | stat.S_IXUSR)
        return path


class Runs(Case):
    def test_a_run_returns_files_nodes_and_notes(self):
        events = []
        done = lightharmony.run(self.graph, out=self.out, on_event=events.append)
        self.assertEqual((done.code, done.degraded), (0, False))
        self.assertEqual(done.files, [self.out / "view.png"])
        self.assertEqual(done.files_of("save"), done.files)
        self.assertTrue(done.files[0].read_bytes().startswith(b"\x89PNG"))
        self.assertEqual(set(done.nodes), {"demo", "camera", "view", "save"})
        self.assertEqual(len(done.nodes["view"].key), 64)
        self.assertEqual({note.node for note in done.notes} - set(done.nodes), set())
        self.assertEqual(events[-1]["event"], "done")
        again = lightharmony.run(self.graph, out=self.out)
        self.assertEqual({node.state for node in again.nodes.values()}, {"cached"})
        self.assertEqual(again.files, done.files)

    def test_settings_are_values_of_python(self):
        numpy = files.numpy
        settings = {
            "pose.yaw_deg": numpy.float64(40.5), "camera.eye": (2.0, -2.5, numpy.float32(1.5).item()),
            "camera.width_px": 33, "view.sort": "Depth", "save.path": "other.png", "view.count_blends": True,
        }
        done = lightharmony.run(self.graph, set=settings, out=self.out)
        self.assertEqual([path.name for path in done.files], ["other.png"])
        with self.assertRaises(TypeError):
            lightharmony.run(self.graph, set={"pose.yaw_deg": object()})

    def test_a_plan_has_keys(self):
        done = lightharmony.run(self.graph, out=self.out)
        plan = lightharmony.plan(self.graph)
        self.assertTrue(plan.known)
        self.assertEqual({one.id: one.key for one in plan.nodes}, {id: node.key for id, node in done.nodes.items()})
        plan = lightharmony.plan(self.graph, set={"camera.fov_y_deg": 17.0 + time.time() % 1})
        self.assertEqual({one.id: one.fate for one in plan.nodes}["view"], "runs")
        self.assertIsNone({one.id: one.key for one in plan.nodes}["save"])
        self.assertFalse(plan.known)

    def test_kinds_are_described(self):
        kinds = lightharmony.nodes()
        self.assertGreater(len(kinds), 40)
        stitch = lightharmony.nodes("Stitch")["stitch"]
        self.assertEqual(stitch, kinds["stitch"])
        width = next(one for one in stitch["parameters"] if one["name"] == "width_px")
        self.assertEqual((width["default"], width["range"], width["unit"]), ("2048", [2.0, 16384.0], "px"))
        self.assertEqual(stitch["outputs"][0]["type"], "pano")
        with self.assertRaisesRegex(lightharmony.ProgramError, "did you mean `stitch`"):
            lightharmony.nodes("stich")

    def test_events_have_the_fields_that_the_page_states(self):
        page = (HERE.parent.parent / "docs/python.md").read_text()
        rows = [line.split("|")[1:3] for line in page.split("\n## Events\n")[1].splitlines() if line.startswith("| `")]
        stated = {name: set(re.findall("`(.*?)`", fields)) for names, fields in rows for name in re.findall("`(.*?)`", names)}
        for name, fields in re.findall(r"prints an event `(\w+)` for each \w+: (.*?)\.\n", page, re.S):
            stated[name] = set(re.findall("`(.*?)`", fields))
        (self.folder / "lost.png").write_text("not a picture")
        self.graph.write_text(GRAPH.replace("nodes: (", 'nodes: (\n        lost: LoadImage(path: "lost.png"),\n        keep: WriteImage(image: "lost", path: "l.png"),'))
        events = []
        with self.assertRaises(lightharmony.NodeFailed):
            # A new cache, so that nodes run.
            lightharmony.run(self.graph, out=self.out, cache=self.folder / "cache", on_event=events.append)
        # Known and unknown nodes, changed and not.
        self.graph.write_text(GRAPH)
        lightharmony.run(self.graph, out=self.out)
        for yaw in (30.0, 31.0):
            events += program.call(["plan", "--json", "--set", f"pose.yaw_deg={yaw}", str(self.graph)], accept=(0, 1, 2, 3))
        events += program.call(["nodes", "--json"])
        seen = {}
        for event in events:
            seen.setdefault(event["event"], set()).update(set(event) - {"event"})
        self.assertLessEqual({"start", "node", "file", "done", "mistakes", "planned", "kind"}, set(seen))
        for name, fields in seen.items():
            self.assertIn(name, stated)
            self.assertLessEqual(fields, stated[name], name)
            # Values that the row of `node` names, and fields that only some events have.
            others = {"node": {"ran", "cached", "failed", "skipped"}, "file": {"preview"}, "start": {"forecast"}}
            self.assertLessEqual(stated[name] - fields, others.get(name, set()), name)

    def test_the_version_is_that_of_the_program(self):
        self.assertEqual(program.version(program.find()), lightharmony.__version__)


class Values(Case):
    def test_pictures_are_arrays(self):
        values = lightharmony.values(self.graph, ["view", "view.depth", "pano", "faces.colour"])
        self.assertEqual((values["view"].shape, values["view"].dtype.name), ((27, 49, 4), "float32"))
        self.assertEqual(values["view.depth"].shape, (27, 49, 1))
        self.assertEqual(values["pano"].shape, (32, 64, 3))
        self.assertEqual(len(values["faces.colour"]), 6)
        # The PNG shows the same picture, over black.
        lightharmony.run(self.graph, out=self.out, only="save")
        seen = png(self.out / "view.png")
        numpy = files.numpy
        want = numpy.clip(numpy.rint(255 * values["view"][..., :3].astype(float)), 0, 255)
        self.assertLessEqual(abs(seen[..., :3].astype(int) - want).max(), 1)

    def test_meshes_and_reports(self):
        values = lightharmony.values(self.graph, ["demo.proxy", "pano.report"])
        mesh = values["demo.proxy"]
        self.assertEqual((mesh["positions"].shape[1], mesh["faces"].shape[1]), (3, 3))
        self.assertLess(mesh["faces"].max(), len(mesh["positions"]))
        self.assertIsInstance(values["pano.report"], dict)

    def test_values_come_from_the_cache_of_the_graph(self):
        # Also those that depend on files, whose names are part of keys.
        lightharmony.run(self.graph, out=self.folder)
        self.graph.write_text(GRAPH.replace("nodes: (", 'nodes: (\n        photo: LoadImage(path: "view.png"),\n        bare: WriteImage(image: "photo", path: "b.png"),'))
        lightharmony.run(self.graph, out=self.out)
        ran = []
        lightharmony.values(self.graph, ["photo", "view"], on_event=lambda event: ran.append(event.get("id")) if event.get("state") == "ran" else None)
        self.assertEqual([id for id in ran if not id.startswith("value_of_python")], [])
        self.assertEqual(lightharmony.keys(self.graph, ["view"])["view"], lightharmony.run(self.graph, out=self.out).nodes["view"].key)

    def test_other_outputs_are_refused(self):
        for output, text in (("demo.splats", "no sink"), ("view.colr", "has views, colour"), ("nope", "no node"), ("a b", "write")):
            with self.assertRaisesRegex(ValueError, text, msg=output):
                lightharmony.values(self.graph, [output])

    def test_damaged_files_are_errors(self):
        with tempfile.NamedTemporaryFile(suffix=".exr") as file:
            file.write(b"\x76\x2f\x31\x01\x02\x00\x00\x00channels\0chlist\0\xff\xff\xff\xff")
            file.flush()
            with self.assertRaises(files.FormatError):
                files.read_exr(file.name)


def png(path):
    """A PNG file without interlacing, of 8 bits per channel."""
    import struct, zlib

    numpy, data, at, joined = files.numpy, path.read_bytes(), 8, b""
    while at < len(data):
        size, name = struct.unpack_from(">I4s", data, at)
        if name == b"IHDR":
            width, height, depth, colour = struct.unpack_from(">IIBB", data, at + 8)
        elif name == b"IDAT":
            joined += data[at + 8 : at + 8 + size]
        at += 12 + size
    channels = {0: 1, 2: 3, 6: 4}[colour]
    assert depth == 8
    rows, stride = zlib.decompress(joined), width * channels
    found = numpy.zeros((height, stride), numpy.int64)
    for y in range(height):
        kind, row = rows[y * (stride + 1)], numpy.frombuffer(rows, numpy.uint8, stride, y * (stride + 1) + 1)
        for x in range(stride):
            a = found[y, x - channels] if x >= channels else 0
            b = found[y - 1, x] if y else 0
            c = found[y - 1, x - channels] if y and x >= channels else 0
            p = a + b - c
            paeth = min((a, b, c), key=lambda v: abs(p - v))
            found[y, x] = (int(row[x]) + (0, a, b, (a + b) // 2, paeth)[kind]) & 255
    return found.reshape(height, width, channels)


class Watching(Case):
    def test_events_follow_an_edit(self):
        with lightharmony.watch(self.graph, out=self.out) as watch:
            until(watch, "idle")
            self.graph.write_text(GRAPH.replace("fov_y_deg: 40.0", "fov_y_deg: 41.0"))
            events = until(watch, "idle")
            self.assertIn("view.png", [pathlib.Path(one["path"]).name for one in events if one["event"] == "file"])
            self.graph.write_text(GRAPH.replace("fov_y_deg", "fov_deg"))
            mistakes = watch.mistakes_of(until(watch, "mistakes")[-1])
            self.assertEqual((pathlib.Path(mistakes[0].file).name, mistakes[0].line), ("graph.ron", 7))
            self.assertIn("`fov_deg`", mistakes[0].message)
            self.graph.write_text(GRAPH)
            until(watch, "idle")
            self.assertEqual(watch.poll(), [])
        self.assertEqual(quiet(self.graph), [])

    def test_a_watch_that_cannot_start_is_an_error(self):
        with self.assertRaises(lightharmony.ProgramError):
            list(lightharmony.watch(self.graph, memory="x"))


def until(watch, name, seconds=60):
    """Events up to the first one with this name."""
    found, end = [], time.monotonic() + seconds
    while time.monotonic() < end:
        event = watch.get(0.2)
        if event is not None:
            found.append(event)
            if event["event"] == name:
                return found
    raise AssertionError(f"no event `{name}` within {seconds} s: {found}")


class BadInput(Case):
    def test_mistakes_have_places(self):
        self.graph.write_text(GRAPH.replace("yaw_deg", "yaw").replace('"demo.splats", rig: "camera"', '"demo.splat", rig: "camera"'))
        with self.assertRaises(lightharmony.GraphError) as caught:
            lightharmony.run(self.graph)
        places = [(pathlib.Path(one.file).name, one.line, one.column) for one in caught.exception.mistakes]
        self.assertEqual(places, [("graph.ron", 6, 52), ("graph.ron", 8, 37)])
        self.assertIn("did you mean `yaw_deg`?", str(caught.exception))
        self.assertEqual(lightharmony.check(self.graph), caught.exception.mistakes)
        with self.assertRaises(lightharmony.GraphError):
            lightharmony.plan(self.graph)

    def test_failed_nodes_have_places_and_the_rest_is_returned(self):
        (self.folder / "lost.png").write_text("not a picture")
        self.graph.write_text(GRAPH.replace("nodes: (", 'nodes: (\n        lost: LoadImage(path: "lost.png"),\n        keep: WriteImage(image: "lost", path: "l.png"),'))
        with self.assertRaises(lightharmony.NodeFailed) as caught:
            lightharmony.run(self.graph, out=self.out)
        self.assertEqual(caught.exception.mistakes[0].line, 5)
        self.assertEqual(caught.exception.run.nodes["lost"].state, "failed")
        self.assertEqual(caught.exception.run.files, [self.out / "view.png"])

    def test_other_errors(self):
        with self.assertRaisesRegex(lightharmony.ProgramError, "No such file"):
            lightharmony.run(self.folder / "none.ron")
        with self.assertRaisesRegex(lightharmony.ProgramError, "no node `x`"):
            lightharmony.run(self.graph, only="x")
        with self.assertRaisesRegex(lightharmony.ProgramError, "not a size"):
            lightharmony.run(self.graph, memory="much")

    def test_the_program_may_be_missing(self):
        with self.assertRaisesRegex(lightharmony.ProgramNotFound, "named by the argument"):
            lightharmony.run(self.graph, program=self.folder / "none")
        before = dict(os.environ)
        self.addCleanup(os.environ.update, before)
        os.environ.update({"PATH": str(self.folder), "LIGHTHARMONY_PROGRAM": str(self.folder / "none")})
        with self.assertRaisesRegex(lightharmony.ProgramNotFound, "named by LIGHTHARMONY_PROGRAM"):
            lightharmony.nodes()
        del os.environ["LIGHTHARMONY_PROGRAM"]
        folders, program._script_folders = program._script_folders, lambda: iter(())
        self.addCleanup(setattr, program, "_script_folders", folders)
        with self.assertRaisesRegex(lightharmony.ProgramNotFound, "add its folder to PATH"):
            lightharmony.nodes()
        self.script("lightharmony", "exit 3\n")
        with self.assertRaisesRegex(lightharmony.ProgramNotFound, "is not lightharmony"):
            lightharmony.nodes()

    def test_another_version_is_refused(self):
        other = self.script("other", "echo lightharmony 9.8.7\n")
        with self.assertRaises(lightharmony.VersionMismatch) as caught:
            lightharmony.run(self.graph, program=other)
        self.assertEqual((caught.exception.found, caught.exception.wanted), ("9.8.7", lightharmony.__version__))

    def test_the_module_as_a_command_states_what_is_wrong(self):
        def called(program, *arguments):
            environment = {**os.environ, "LIGHTHARMONY_PROGRAM": str(program), "PYTHONPATH": os.pathsep.join(sys.path)}
            command = [sys.executable, "-m", "lightharmony", *arguments]
            return subprocess.run(command, env=environment, capture_output=True, text=True)

        done = called(self.folder / "none", "--version")
        self.assertEqual((done.returncode, done.stdout), (2, ""))
        self.assertRegex(done.stderr, r"^error: `.*none`, named by LIGHTHARMONY_PROGRAM, is not a program\n$")
        done = called(self.script("older", "echo lightharmony 0.0.1\n"), "--version")
        self.assertEqual(done.returncode, 2)
        self.assertRegex(done.stderr, "is version 0.0.1, but this module needs version")
        done = called(program.find(), "--version")
        self.assertEqual((done.returncode, done.stdout), (0, f"lightharmony {lightharmony.__version__}\n"))
        # The exit code is that of the program.
        self.graph.write_text(GRAPH.replace("yaw_deg", "yaw"))
        done = called(program.find(), "check", str(self.graph))
        self.assertEqual(done.returncode, 2)
        self.assertIn("graph.ron:6:52", done.stderr)

    def test_a_program_that_prints_something_else_is_an_error(self):
        odd = self.script("odd", f'if [ "$1" = --version ]; then echo lightharmony {lightharmony.__version__}; else echo hello; exit 7; fi\n')
        with self.assertRaisesRegex(lightharmony.ProgramError, "unexpected output: hello") as caught:
            lightharmony.run(self.graph, program=odd)
        self.assertEqual(caught.exception.code, 7)


# A program that ignores Ctrl-C and starts another process, which does too.
STUBBORN = """if [ "$1" = --version ]; then echo lightharmony VERSION; exit; fi
trap '' INT
sleep 61 &
echo '{"event":"start","id":"a","kind":"b"}'
sleep 62
"""


class Cancelling(Case):
    def test_a_cancelled_run_ends(self):
        self.graph.write_text(GRAPH.replace("splats: 3000", "splats: 900000"))
        cancel = threading.Event()
        begin = time.monotonic()
        with self.assertRaises(lightharmony.Cancelled):
            lightharmony.run(self.graph, cancel=cancel, out=self.out, on_event=lambda _: cancel.set())
        self.assertLess(time.monotonic() - begin, 30)
        self.assertEqual(quiet(self.graph), [])
        self.assertFalse(self.out.exists() and list(self.out.iterdir()), "no partial file")

    def test_the_whole_process_group_ends(self):
        stubborn = self.script("stubborn", STUBBORN.replace("VERSION", lightharmony.__version__))
        process = program.Process(["run"], stubborn)
        self.assertEqual(process.get()["event"], "start")
        group = process._process.pid
        process.cancel(grace=0.3)
        self.assertEqual(process.wait(), -signal.SIGKILL)
        time.sleep(0.1)
        left = subprocess.run(["ps", "-eo", "pgid,stat,args"], capture_output=True, text=True).stdout.splitlines()
        left = [line for line in left if line.split()[0] == str(group) and not line.split()[1].startswith("Z")]
        self.assertEqual(left, [])

    def test_an_exception_of_the_caller_ends_the_run(self):
        def stop(_):
            raise KeyboardInterrupt

        with self.assertRaises(KeyboardInterrupt):
            lightharmony.run(self.graph, set={"demo.splats": 900001}, on_event=stop, out=self.out)
        self.assertEqual(quiet(self.graph), [])

    def test_the_end_of_python_ends_the_program(self):
        for end, code in (("", 0), ("os.kill(os.getpid(), 9)", -9), ("os.kill(os.getpid(), 15)", -15)):
            text = (
                f"import os, sys; sys.path[:0] = {sys.path!r}; import lightharmony\n"
                f"watch = lightharmony.watch({str(self.graph)!r}, out={str(self.out)!r})\nwatch.get()\n{end}\n"
            )
            done = subprocess.run([sys.executable, "-c", text], capture_output=True, text=True, timeout=60)
            self.assertEqual((done.returncode, done.stderr), (code, ""))
            # If Python was killed, the program notices it by itself.
            limit = time.monotonic() + (20 if end else 0)
            while quiet(self.graph) and time.monotonic() < limit:
                time.sleep(0.05)
            self.assertEqual(quiet(self.graph), [], end)


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        CACHE = pathlib.Path(folder) / "cache"
        unittest.main()
