#!/usr/bin/env python3
"""Makes a set of the benchmark: places, photographs, meshes, and pairs of pictures with and without an object.

    python make.py SET [--small] [--seed N] [--only PLACE ..] [--all-objects] [--threads N]
    python make.py SET --plan        CPU hours of the set, estimated from a small render of each place

A file that exists is not made again, and a picture that was interrupted continues after its last pass. The state is in
SET.work, which can be deleted when the set is complete.
"""
import argparse
import dataclasses
import hashlib
import json
import pathlib
import shutil
import time
import zlib

import numpy as np

import accumulate
import cameras
import capture
import objects
import pictures
import places
import regions
import sky

VERSION = "1.0"


@dataclasses.dataclass
class Quality:
    """What is rendered. Sizes in pixels, `bound` as RMSE of display values between two seeds."""
    size: tuple = (480, 320)
    views: int = 6
    photos: int = 90
    photo_samples: int = 128
    samples: int = 256
    bound: float = 0.003
    limit: int = 400
    denoise: bool = False
    panorama: int = 1024
    panorama_samples: int = 128
    panorama_bound: float = 0.004
    alpha_samples: int = 256


FULL = Quality()
SMALL = Quality(size=(120, 80), views=2, photos=12, photo_samples=32, samples=64, bound=0.007, limit=8, denoise=True,
                panorama=256, panorama_samples=32, panorama_bound=0.014, alpha_samples=128)


def say(text):
    print(time.strftime("%H:%M:%S"), text, flush=True)


def number(text):
    """A seed from a name."""
    return zlib.crc32(text.encode()) % 2 ** 30


def whole(values):
    return [round(float(v), 9) for v in values]


class Maker:
    """Makes all files of one place."""

    def __init__(self, out, work, place, objects_, seed, quality, threads):
        self.out, self.place, self.objects, self.seed = out, place, objects_, seed
        self.q, self.threads, self.work = quality, threads, work / place.name
        self.shared, self.stage_, self.inserted = out / "scenes" / place.name, None, None
        for folder in (self.work, self.shared / "photos"):
            folder.mkdir(parents=True, exist_ok=True)
        self.lens = cameras.lens(*quality.size, cameras.FOV_Y_DEG)
        self.photo_lens = cameras.lens(*quality.size, cameras.FOV_PHOTO_DEG)
        self.views = cameras.views(place, self.random("views"), quality.views)
        self.names = [f"view_{k}" for k in range(quality.views)]
        self.path = cameras.path(place, self.random("path"), quality.photos)
        self.probe = whole(np.array(place.at) + (0, 0, 0.25 * place.scale))

    def random(self, purpose):
        return places.generator(self.seed, f"{self.place.name}/{purpose}")

    def base_seed(self, purpose):
        return number(f"{self.seed}/{self.place.name}/{purpose}")

    def stage(self, light=None):
        """The place in Blender, built when the first picture needs it."""
        if self.stage_ is None:
            import stage

            file = None
            if self.place.sky is not None:
                file = self.work / "sky.exr"
                if not file.exists():
                    pictures.write_exr(file, sky.panorama(self.place.sky, 1024))
            self.stage_ = stage.Stage(self.place, file, light or self.light(), self.threads)
        return self.stage_

    def insert(self, name):
        stage = self.stage()
        if self.inserted != name:
            stage.insert(self.out / "objects" / f"{name}.glb", self.place.at, self.place.yaw_deg, self.place.scale)
            self.inserted = name
        return stage

    def light(self):
        """Factor of all lights, a power of two in steps of a quarter, so that the pictures are exposed at EV 0.

        The 90th percentile of the brightest channel becomes 0.7 (0.4 at dusk), measured in small pictures."""
        file = self.work / "factor.json"
        if not file.exists():
            stage = self.stage(light=1.0)
            small = cameras.lens(self.q.size[0] // 4, self.q.size[1] // 4, cameras.FOV_PHOTO_DEG)
            shown = []
            for matrix in self.path[:4]:
                stage.look(matrix, small)
                stage.show(False)
                shown.append(stage.render(16, 1)[..., :3].max(-1).ravel())
            aim = 0.4 if "dusk" in self.place.tags else 0.7
            factor = 2.0 ** (round(4 * np.log2(aim / np.percentile(np.concatenate(shown), 90))) / 4)
            cameras.write_json(file, factor)
            self.stage_ = self.inserted = None
        return json.loads(file.read_text())

    def photographs(self):
        files = [f"photos/{k:04}.png" for k in range(1, len(self.path) + 1)]
        for k, (matrix, file) in enumerate(zip(self.path, files)):
            depth = self.work / f"depth-{k + 1:04}.npy"
            if (self.shared / file).exists() and depth.exists():
                continue
            stage = self.stage()
            stage.look(matrix, self.photo_lens)
            stage.show(False)
            picture, z = stage.render(self.q.photo_samples, self.base_seed(file), depth=True, denoise=True)
            np.save(depth, z.astype(np.float32))
            pictures.write_png(self.shared / file, pictures.codes(picture[..., :3]))
            if k % 10 == 0:
                say(f"{self.place.name}: photograph {k + 1} of {len(files)}")
        cameras.write_json(self.shared / "capture.json", cameras.transforms(self.path, files, self.q.size, cameras.FOV_PHOTO_DEG))
        if (self.shared / "mesh.ply").exists() and (self.shared / "sparse/0/points3D.txt").exists():
            return
        vertices, faces = capture.captured_mesh(self.place, self.random("mesh"), 0.003 * self.place.scale)
        shots = [(pictures.linear(pictures.read_png(self.shared / f) / 255.0), np.load(self.work / f"depth-{k + 1:04}.npy"), m,
                  self.photo_lens) for k, (m, f) in enumerate(zip(self.path, files))]
        colours, seen = capture.seen_colours(vertices, faces, shots, 0.02)
        share = seen.mean()
        points = np.flatnonzero(seen)
        points = points[self.random("points").permutation(len(points))[:20000]]
        cameras.colmap(self.shared / "sparse/0", self.path, files, self.q.size, cameras.FOV_PHOTO_DEG, vertices[points],
                       pictures.codes(colours[points]))
        colours, seen = capture.fill(colours, seen, faces)
        vertices, faces, colours = capture.compact(vertices, capture.kept(faces, seen), colours)
        capture.write_ply(self.shared / "mesh.ply", vertices, faces, colours)
        say(f"{self.place.name}: mesh of {len(faces)} triangles; photographs see {100 * share:.0f} % of the vertices")

    def converge(self, name, render, bound, mask=None):
        """A picture by name, from SET.work where it is complete, and what was reached."""
        file, log = self.work / f"{name}.exr", self.work / f"{name}.json"
        if file.exists() and log.exists():
            return pictures.read_exr(file), json.loads(log.read_text())
        start = time.process_time()
        report = lambda n, d: say(f"{self.place.name}: {name}: pass {n}, difference {d:.4f}, bound {bound}") if n % 10 == 0 else None
        # The same seeds with and without the object, so that most of the noise is the same in both.
        base = self.base_seed(name.split("-")[0])
        made, difference, passes = accumulate.converge(render, self.work / f"{name}.npz", bound, self.q.limit, mask, base, report)
        pictures.write_exr(file, made)
        reached = {"passes": passes, "difference": round(difference, 6), "reached": difference <= bound,
                   "cpu_seconds": round(time.process_time() - start, 1)}
        cameras.write_json(log, reached)
        say(f"{self.place.name}: {name}: {passes} passes, difference {difference:.4f}, {reached['cpu_seconds']:.0f} CPU-s")
        (self.work / f"{name}.npz").unlink()
        return made, reached

    def picture(self, name, view, objects_, mask=None):
        def render(seed):
            stage = self.stage() if not objects_ else self.insert(name.split("-")[1])
            stage.look(self.views[view], self.lens)
            stage.show(objects_)
            return stage.render(self.q.samples, seed, denoise=self.q.denoise)[..., :3]
        # The region of reflections is a threshold of 0.02, which needs no less noise than this.
        bound = max(self.q.bound, 0.007) if objects_ == "unreflected" else self.q.bound
        return self.converge(name, render, bound, mask)

    def panorama(self):
        def render(seed):
            stage = self.stage()
            stage.look_around(self.probe, self.q.panorama)
            stage.show(False)
            return stage.render(self.q.panorama_samples, seed, denoise=self.q.denoise)[..., :3]
        return self.converge("light", render, self.q.panorama_bound)

    def alpha(self, name, view):
        file = self.work / f"view_{view}-{name}-alpha.exr"
        if not file.exists():
            stage = self.insert(name)
            stage.look(self.views[view], self.lens)
            pictures.write_exr(file, stage.alpha(self.q.alpha_samples), "Y")
        return pictures.read_exr(file, "Y")[..., 0]

    def depth(self, view):
        file = self.work / f"view_{view}-depth.exr"
        if not file.exists():
            stage = self.stage()
            stage.look(self.views[view], self.lens)
            stage.show(False)
            pictures.write_exr(file, stage.depth(), "Z")
        return file

    def make(self):
        self.photographs()
        _, light_log = self.panorama()
        for name in self.objects:
            self.case(name, light_log)

    def case(self, name, light_log):
        folder = self.out / f"{self.place.name}-{name}"
        log = {"light": light_log}
        for k, view in enumerate(self.names):
            truth = folder / "truth" / view
            truth.mkdir(parents=True, exist_ok=True)
            alpha = self.alpha(name, k)
            near = around(np.any([self.alpha(o, k) > 0 for o in self.objects], 0))
            without, log[f"{view}/without"] = self.picture(view, k, False, near)
            with_, log[f"{view}/with"] = self.picture(f"{view}-{name}", k, True, near)
            hidden = None
            if self.place.shiny():
                hidden, log[f"{view}/unreflected"] = self.picture(f"{view}-{name}-unreflected", k, "unreflected", near)
            for file, picture, channels in (("without", without, "RGB"), ("with", with_, "RGB"), ("alpha", alpha, "Y")):
                pictures.write_exr(truth / f"{file}.exr", picture, channels)
            shutil.copyfile(self.depth(k), truth / "depth.exr")
            for region, mask in zip(("shadow", "reflection"), regions.regions(without, with_, alpha, hidden)):
                pictures.write_png(truth / f"{region}.png", (255 * mask).astype(np.uint8))
        shutil.copyfile(self.work / "light.exr", folder / "truth" / "light.exr")
        cameras.write_json(folder / "views.json",
                           cameras.transforms(self.views, [f"{v}.png" for v in self.names], self.q.size, cameras.FOV_Y_DEG))
        cameras.write_json(folder / "render.json", {
            "blender": "4.5.15", "seed": self.seed, "light_factor": self.light(), "exposure_ev": 0.0, "quality": dataclasses.asdict(self.q),
            "pictures": log})
        cameras.write_json(folder / "case.json", {
            "version": 1, "name": folder.name, "scene": self.place.name, "tags": [*self.place.tags, name],
            "object": f"../objects/{name}.glb",
            "pose": {"translation": whole(self.place.at), "yaw_deg": round(self.place.yaw_deg, 9), "scale": self.place.scale},
            "probe": self.probe, "views": self.names, "mesh": f"../scenes/{self.place.name}/mesh.ply",
            "capture": f"../scenes/{self.place.name}/capture.json"})
        say(f"{folder.name}: complete")

    def plan(self):
        """CPU hours of the place, from two halves of 8 samples of one view at a quarter of the size and the noise in them."""
        stage = self.stage()
        size = [s // 2 for s in self.q.size]
        stage.look(self.views[0], cameras.lens(*size, cameras.FOV_Y_DEG))
        stage.show(False)
        stage.render(1, 1)
        samples, start = 8, time.process_time()
        a, b = (stage.render(samples, s)[..., :3] for s in (1, 2))
        cost = (time.process_time() - start) / (2 * samples * size[0] * size[1])
        limited = lambda n: min(max(n, 2 * self.q.samples), self.q.limit * self.q.samples)
        need, hidden = (limited(samples * (accumulate.rmse(a, b) / bound) ** 2) for bound in (self.q.bound, max(self.q.bound, 0.007)))
        if self.q.denoise:
            # The denoiser reaches the bound with the first two to four passes.
            need = hidden = 4 * self.q.samples
        pixels, shiny = self.q.size[0] * self.q.size[1], self.place.shiny()
        pairs = self.q.views * (need + len(self.objects) * (need + hidden * shiny)) * pixels
        photos = self.q.photos * self.q.photo_samples * pixels
        light = 4 * self.q.panorama_samples * self.q.panorama ** 2 / 2
        hours = cost * (pairs + photos + light) / 3600
        print(f"{self.place.name:20} {1e6 * cost:7.2f} CPU-us a sample {need:9.0f} samples a pixel {hours:8.2f} CPU-hours", flush=True)
        return hours


def around(mask):
    """The bounding box of a mask, with half of its size added on each side."""
    if not mask.any():
        return mask
    out = np.zeros_like(mask)
    j, i = np.where(mask.any(1))[0], np.where(mask.any(0))[0]
    h, w = (j[-1] - j[0]) // 2 + 1, (i[-1] - i[0]) // 2 + 1
    out[max(0, j[0] - h):j[-1] + h, max(0, i[0] - w):i[-1] + w] = True
    return out


def sums(out):
    """Writes SHA256SUMS."""
    files = sorted(str(p.relative_to(out)) for p in out.rglob("*") if p.is_file() and p.name != "SHA256SUMS")
    lines = [f"{hashlib.sha256((out / f).read_bytes()).hexdigest()}  {f}\n" for f in files]
    (out / "SHA256SUMS").write_text("".join(lines))


def selection(arguments):
    """Pairs of a place and the objects inserted in it."""
    chosen = places.all_places(arguments.seed)
    if arguments.small:
        pairs = [(p, [o for q, o in places.SMALL if q == p.name]) for p in chosen]
    else:
        pairs = [(p, list(objects.OBJECTS) if arguments.all_objects else list(p.objects)) for p in chosen]
    pairs = [(p, o) for p, o in pairs if o and (not arguments.only or p.name in arguments.only)]
    unknown = set(arguments.only or []) - {p.name for p, _ in pairs}
    if unknown:
        raise SystemExit(f"no such place: {', '.join(sorted(unknown))}; there are {', '.join(p.name for p in chosen)}")
    return pairs


def main(argv=None):
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("set", type=pathlib.Path)
    parser.add_argument("--small", action="store_true")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", nargs="+", metavar="PLACE")
    parser.add_argument("--all-objects", action="store_true", help="all seven objects in each place, in place of two")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--plan", action="store_true")
    parser.add_argument("--bound", type=float, help="RMSE of display values between two seeds; the default is that of the set")
    parser.add_argument("--denoise", action="store_true", help="Open Image Denoise on each pass: about an eighth (an estimate) of the time, with its bias")
    parser.add_argument("--size", type=int, nargs=2, metavar=("W", "H"))
    arguments = parser.parse_args(argv)
    quality = SMALL if arguments.small else FULL
    if arguments.bound:
        quality = dataclasses.replace(quality, bound=arguments.bound)
    if arguments.denoise:
        quality = dataclasses.replace(quality, denoise=True)
    if arguments.size:
        quality = dataclasses.replace(quality, size=tuple(arguments.size))
    pairs, out = selection(arguments), arguments.set
    work = out.with_name(out.name + ".work")
    settings = {"seed": arguments.seed, "quality": dataclasses.asdict(quality)}
    work.mkdir(parents=True, exist_ok=True)
    stored = work / "settings.json"
    if stored.exists() and json.loads(stored.read_text()) != json.loads(json.dumps(settings)):
        raise SystemExit(f"{work} was made with other settings ({stored}); delete it and {out}, or choose another folder")
    cameras.write_json(stored, settings)
    (out / "objects").mkdir(parents=True, exist_ok=True)
    for name in sorted({o for _, names in pairs for o in names}):
        if not (out / "objects" / f"{name}.glb").exists():
            objects.write(name, out / "objects" / f"{name}.glb")
    makers = [Maker(out, work, p, o, arguments.seed, quality, arguments.threads) for p, o in pairs]
    if arguments.plan:
        hours = sum(m.plan() for m in makers)
        print(f"{len(makers)} places, {sum(len(m.objects) for m in makers)} cases: about {hours:.1f} CPU-hours")
        return
    start, done = time.time(), 0
    for maker in makers:
        maker.make()
        done += 1
        say(f"{done} of {len(makers)} places, {(time.time() - start) / 60:.1f} minutes, about "
            f"{(time.time() - start) / 60 * (len(makers) - done) / done:.0f} minutes left")
        maker.stage_ = None
    cases = [f"{m.place.name}-{o}" for m in makers for o in m.objects]
    cameras.write_json(out / "set.json", {
        "lightharmony_bench": 1, "name": "small" if arguments.small else "full", "version": VERSION, "seed": arguments.seed,
        "licence": "CC0-1.0", "up": "+z", "metres_per_unit": 1.0, "cases": cases,
        "about": "Made by python/bench/make.py with Blender 4.5.15 (Cycles, CPU)."})
    sums(out)
    say(f"{len(cases)} cases in {out}")


if __name__ == "__main__":
    main()
