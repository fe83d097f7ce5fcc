"""Scores `fit-lights` on the rooms of two_lights.py: strength and colour of each emitter before and after.

    python3 tests/bench_case/two_lights_score.py ROOMS PROGRAM [--insert OBJECT.glb] [CASE ..]

With --insert, an object is inserted in the true, the predicted and the fitted light, and the last two are compared with the
first, in dB over the object and over its shadow.
"""
import json
import math
import os
import subprocess
import sys

rooms, program, *cases = sys.argv[1:]
insert = None
if cases and cases[0] == "--insert":
    insert, cases = os.path.abspath(cases[1]), cases[2:]
cases = cases or sorted(name for name in os.listdir(rooms) if os.path.exists(f"{rooms}/{name}/truth.hdr"))
EYE = "(0.2, -0.3, 1.1)"
LIGHT = """
        proxy: LoadMesh(path: "mesh.ply"),
        pano:  LoadPanorama(path: "pano.png", origin: EYE),
        truth: LoadEnvironment(path: "truth.hdr", origin: EYE),
        dark:  PredictExposure(pano: "pano"),
        fused: FuseHdr(base: "pano", brackets: "dark"),
        env:   FitLights(env: "fused", receiver: "proxy"),
        before: ScoreEnv(env: "fused", truth: "truth"),
        after:  ScoreEnv(env: "env", truth: "truth"),
        w1: WriteReport(report: "before", path: "before.json"),
        w2: WriteReport(report: "after", path: "after.json"),
        w3: WriteReport(report: "env.report", path: "fit.json"),
"""
SCENE = """
        object: LoadObject(path: "OBJECT"),
        pose:   Pose(translation: (0.2, 0.2, 0.0), yaw_deg: 20.0, scale: 0.7),
        placed: Place(object: "object", pose: "pose"),
        camera: Camera(eye: (-1.3, -1.6, 1.5), target: (0.2, 0.2, 0.3), width_px: 160, height_px: 120, fov_y_deg: 45.0),
        region: RegionMasks(object: "trace_truth.object", without: "clean_truth.without", with: "clean_truth.with"),
"""
LIT = """
        trace_L: PathTrace(receiver: "proxy", objects: ["placed"], rig: "camera", env: "ENV", samples: 64),
        clean_L: Denoise(without: "trace_L.without", with: "trace_L.with", object: "trace_L.object", depth: "trace_L.depth",
                         normal: "trace_L.normal", variance: "trace_L.variance"),
        shadow_L: ShadowRatio(without: "clean_L.without", with: "clean_L.with"),
        image_L: Composite(background: "clean_truth.without", object: "clean_L.object", shadow: "shadow_L"),
"""
COMPARE = """
        score_L: Compare(image: "image_L", reference: "image_truth", regions: ["region.object", "region.shadow"],
                         names: ["object", "shadow"], background: "clean_truth.without"),
        table_L: WriteReport(report: "score_L", path: "image_L.json"),
"""


def load(path):
    with open(path) as file:
        return json.load(file)


def tables(path):
    return {table["name"]: table for table in load(path)["tables"]}


def rows(table):
    return [dict(zip(table["columns"], row)) for row in table["rows"]]


def column(row, start):
    return next(value for name, value in row.items() if name.startswith(start))


print("| case | emitter | share, true | strength before | after | colour before | after | error bar | verdict |")
print("|---|---|---|---|---|---|---|---|---|")
images, totals = [], []
for case in cases:
    text = LIGHT
    if insert:
        text += SCENE.replace("OBJECT", insert) + "".join(
            LIT.replace("_L", "_" + name).replace("ENV", env) for name, env in (("truth", "truth"), ("before", "fused"), ("after", "env")))
        text += "".join(COMPARE.replace("_L", "_" + name) for name in ("before", "after"))
    graph = f"{rooms}/{case}/score.ron"
    with open(graph, "w") as file:
        file.write('Graph(version: 1, scene: (up: "+z", seed: 1), nodes: (' + text.replace("EYE", EYE) + "))")
    out = f"{rooms}/{case}/out"
    done = subprocess.run([program, "run", graph, "--out", out, "--cache", f"{rooms}/cache"], capture_output=True, text=True)
    if done.returncode not in (0, 3):
        sys.exit(f"{case}: {done.stdout}\n{done.stderr}")
    before, after, fit = (tables(f"{out}/{name}.json") for name in ("before", "after", "fit"))
    fitted = rows(fit["emitters"])
    for old, new in zip(rows(before["emitters"]), rows(after["emitters"])):
        azimuth, elevation = column(old, "azimuth"), column(old, "elevation")
        near = [row for row in fitted if math.hypot((column(row, "azimuth") - azimuth + 180) % 360 - 180, column(row, "elevation") - elevation) < 8]
        bar = column(near[0], "standard error of the hidden") if near else None
        verdict = near[0]["verdict"].split(":")[0].split(";")[0] if near else "not found"
        number = lambda value, form: "" if value is None else form % value
        print(f"| {case} | {azimuth:.0f}, {elevation:.0f} | {column(old, 'share of all light in'):.2f} "
              f"| {column(old, 'strength'):+.2f} | {column(new, 'strength'):+.2f} | {column(old, 'colour'):.1f} | {column(new, 'colour'):.1f} "
              f"| {number(bar, '%.2f')} | {verdict} |", flush=True)
    first = lambda of: of["light"]["rows"][0][1]
    totals.append((case, first(before), first(after)))
    if insert:
        images.append((case, *(load(f"{out}/image_{name}.json") for name in ("before", "after"))))
print("\n| case | mean irradiance before (stops) | after |\n|---|---|---|")
for case, old, new in totals:
    print(f"| {case} | {old:+.2f} | {new:+.2f} |")
for case, old, new in images:
    for name, report in (("before", old), ("after", new)):
        for table in report["tables"]:
            print(case, name, json.dumps(table["columns"]), json.dumps(table["rows"]))
