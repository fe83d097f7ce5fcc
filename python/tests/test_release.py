#!/usr/bin/env python3
"""Tests of `.ci/release` with a program that is a shell script: `python3 python/tests/test_release.py`."""
import hashlib
import os
import pathlib
import re
import shutil
import subprocess
import sys
import tarfile
import tempfile
import unittest
import zipfile

ROOT = pathlib.Path(__file__).resolve().parent.parent.parent
TARGET = "riscv64-unknown-test"

# A program with one manual page.
PROGRAM = """#!/bin/sh
[ "$1" = manual ] || exit 3
echo page > "$3/lightharmony.1"
"""


class Release(unittest.TestCase):
    def setUp(self):
        temporary = tempfile.TemporaryDirectory()
        self.addCleanup(temporary.cleanup)
        self.folder = pathlib.Path(temporary.name)
        # What the script reads of the repository.
        self.root = self.folder / "repository"
        for name in (".ci/release", "Cargo.toml", "README.md", "CHANGELOG.md", "LICENSE-APACHE", "LICENSE-MIT"):
            (self.root / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(ROOT / name, self.root / name)
        shutil.copytree(ROOT / "python", self.root / "python", ignore=shutil.ignore_patterns("__pycache__", "bench", "tests"))
        # Only this `rustc` is on the path: no cargo, no maturin, no strip.
        self.bin = self.folder / "bin"
        self.bin.mkdir()
        self.script(self.bin / "rustc", f"#!/bin/sh\necho rustc 1.0\necho host: {TARGET}\n")
        self.program = self.script(self.folder / "lightharmony", PROGRAM)
        self.wheel = self.folder / "lightharmony-0.0.0-py3-none-any.whl"
        self.wheel.write_bytes(b"wheel")
        text = (ROOT / "Cargo.toml").read_text()
        self.version = re.search(r'^version = "(.*?)"', text, re.M)[1]
        self.metadata = dict(re.findall(r'^(pkg-url|bin-dir|pkg-fmt) = "(.*?)"', text, re.M))

    def script(self, path, text):
        path.write_text(text)
        path.chmod(0o755)
        return path

    def release(self, name, *options):
        """Runs the script. Returns the folder with the files, and the process."""
        out = self.folder / name
        command = [sys.executable, self.root / ".ci/release", out, "--program", self.program, *options]
        # The files may not depend on the zone, the mask or the time of the machine.
        environment = {"PATH": str(self.bin), "TZ": "UTC" if name == "a" else "Asia/Tokyo"}
        mask = os.umask(0o022 if name == "a" else 0o077)
        try:
            return out, subprocess.run(command, env=environment, capture_output=True, text=True)
        finally:
            os.umask(mask)

    def filled(self, template):
        """A template of `cargo binstall` with its values."""
        values = {"repo": "REPO", "name": "lightharmony", "bin": "lightharmony", "version": self.version, "target": TARGET, "binary-ext": ""}
        return re.sub(r"\{ *([a-z-]+) *\}", lambda found: values[found[1]], template)

    def test_binstall_finds_the_archive_and_the_program_in_it(self):
        out, done = self.release("a", "--wheel", self.wheel)
        self.assertEqual(done.returncode, 0, done.stderr)
        self.assertEqual(self.metadata["pkg-fmt"], "tgz")
        url = self.filled(self.metadata["pkg-url"])
        self.assertTrue(url.startswith(f"REPO/releases/download/v{self.version}/"), url)
        with tarfile.open(out / url.rsplit("/", 1)[1], "r:gz") as archive:
            entries = {entry.name: entry for entry in archive.getmembers()}
            path = self.filled(self.metadata["bin-dir"])
            self.assertEqual(archive.extractfile(path).read(), PROGRAM.encode())
        self.assertEqual(entries[path].mode, 0o755)
        folder = path.rsplit("/", 1)[0]
        names = ["CHANGELOG.md", "LICENSE-APACHE", "LICENSE-MIT", "README.md", "lightharmony", "man/lightharmony.1"]
        self.assertEqual(list(entries), [f"{folder}/{name}" for name in names])

    def test_sums_are_those_of_all_files(self):
        out, _ = self.release("a", "--wheel", self.wheel)
        listed = dict(reversed(line.split("  ")) for line in (out / "SHA256SUMS").read_text().splitlines())
        found = {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in out.iterdir() if path.name != "SHA256SUMS"}
        self.assertEqual(listed, found)
        self.assertEqual(len(found), 4)

    def test_equal_contents_give_equal_bytes(self):
        first, _ = self.release("a", "--wheel", self.wheel)
        # Another time, zone and mask, and other times of the files.
        for path in self.root.rglob("*"):
            os.utime(path, (1e9, 1e9))
        second, _ = self.release("b", "--wheel", self.wheel)
        sides = [{path.name: path.read_bytes() for path in out.iterdir()} for out in (first, second)]
        self.assertEqual(sides[0], sides[1])

    def test_packages_of_hosts_are_complete(self):
        out, _ = self.release("a", "--wheel", self.wheel)
        with zipfile.ZipFile(out / f"lightharmony-blender-{self.version}.zip") as archive:
            modules = [f"lightharmony/{path.name}" for path in (ROOT / "python/lightharmony").glob("*.py")]
            names = ["LICENSE-APACHE", "LICENSE-MIT", "__init__.py", "blender_manifest.toml", *modules]
            self.assertEqual(archive.namelist(), sorted(names))
            self.assertIn(f'version = "{self.version}"', archive.read("blender_manifest.toml").decode())
        with zipfile.ZipFile(out / f"lightharmony-comfyui-{self.version}.zip") as archive:
            names = [f"lightharmony-comfyui/{name}" for name in ("LICENSE-APACHE", "LICENSE-MIT", "__init__.py")]
            self.assertEqual(archive.namelist(), names)

    def test_a_missing_wheel_is_reported(self):
        _, done = self.release("a")
        self.assertIn("left out: the wheel", done.stderr)

    def test_versions_must_agree(self):
        manifest = self.root / "python/blender/blender_manifest.toml"
        manifest.write_text(re.sub(r'(?m)^version = ".*?"', 'version = "7.0.0"', manifest.read_text()))
        out, done = self.release("a")
        self.assertNotEqual(done.returncode, 0)
        self.assertIn("blender_manifest.toml has the version 7.0.0, but Cargo.toml has " + self.version, done.stderr)
        self.assertFalse(out.exists())


if __name__ == "__main__":
    unittest.main()
