"""Makes tables: a program, its data, and a folder to work in."""
import os, resource, shutil, subprocess

ROOT = os.path.abspath(os.path.join(os.path.dirname(__file__), "../.."))
HERE = "tests/tables"
# Replacements in a graph if a job is only tried: few splats, small pictures, few samples.
SMALL = [("splats: 60000, width_px: 160, height_px: 120", "splats: 4000, width_px: 32, height_px: 24, truth_width_px: 32"),
         ("resolution: 0.25", "resolution: 0.06"), ("width_px: 128, height_px: 96", "width_px: 32, height_px: 24"),
         ("samples: 256, max_bounces: 16", "samples: 64, max_bounces: 4"), ("size_px: 512", "size_px: 64"),
         ("width_px: 1024", "width_px: 128")]

class Failed(Exception):
    """A command that failed, or a malformed table."""

class Job:
    def __init__(self, program, benches, data, work, small):
        self.program, self.benches, self.data, self.work, self.small = program, benches, data, work, small

    def path(self, *names):
        return os.path.join(self.work, *names)

    def call(self, *command, quiet=False):
        """Output of a command."""
        done = subprocess.run(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE if quiet else None, text=True)
        if done.returncode:
            raise Failed(f"{' '.join(command)} ended with {done.returncode}" + (f": {done.stderr[-2000:]}" if quiet else ""))
        return done.stdout

    def script(self, name, *words):
        """Output of a script of this folder, run in a new folder."""
        folder = self.path(name)
        shutil.rmtree(folder, ignore_errors=True)
        return self.call("python3", f"{HERE}/{name}.py", self.program, *words, folder, *["small"] * self.small)

    def bench(self, name, *words):
        """Output of a bench, built into a folder or by cargo."""
        if self.benches:
            return self.call(os.path.join(self.benches, name), *words)
        return self.call("cargo", "bench", "-q", "-p", "lightharmony-testkit", "--bench", name, "--", *words)

    def graph(self, name):
        """A copy of a graph of this folder, which finds the data; small where the job is only tried."""
        with open(os.path.join(ROOT, HERE, f"{name}.ron")) as file:
            text = file.read().replace("../../../shared/data", self.data)
        for before, after in SMALL if self.small else []:
            text = text.replace(before, after)
        return self.write(f"{name}.ron", text)

    def picture(self, name):
        """Where a drawing of the docs lies; where the job is only tried one of the folder."""
        return self.path(f"{name}.svg") if self.small else os.path.join(ROOT, f"docs/evidence/{name}.svg")

    def write(self, name, text):
        with open(self.path(name), "w") as file:
            file.write(text)
        return self.path(name)

def cpu():
    """CPU seconds of all processes that were started and have ended."""
    spent = resource.getrusage(resource.RUSAGE_CHILDREN)
    return spent.ru_utime + spent.ru_stime
