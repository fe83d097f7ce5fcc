#!/usr/bin/env python3
"""Baked splats seen from a ring of cameras, against the shadow traced for each camera: the table of docs/splats-out.md.

usage: baked.py LIGHTHARMONY DATA WORK [small]    WORK is a folder to fill; `small` only tries it: few samples, two cameras

The courtyard and the room of `demo-scene` from their splats, and a real capture (`garden_sog`) with a duck on an
extracted mesh. The object is drawn over all pictures, so only what a viewer sees of the place is compared. PSNR is over display
values, inside the shadow and in the rest.
"""
import math, os, shutil, subprocess, sys

from reports import rows

PROGRAM, DATA, WORK = (os.path.abspath(word) for word in sys.argv[1:4])
SMALL = sys.argv[4:] == ["small"]
LIGHT = '''
        probe:  CubeRig(at: "pose", height_metres: 0.3, size_px: 256),
        faces:  SplatRender(splats: "{splats}", rig: "probe"),
        pano:   Stitch(views: "faces", width_px: 512),
        dark:   PredictExposure(pano: "pano", evs: [-6.0, -3.0]),
        env:    FuseHdr(base: "pano", brackets: "dark"{more}),'''
DEMO = '''demo: DemoScene(place: {place}, splats: 260000),
        pose:   Pose(translation: {at}, yaw_deg: -24.0, scale: {scale}),
        placed: Place(object: "demo.object", pose: "pose"),'''
GARDEN = f'''garden: LoadSplats(path: "{DATA}/splats/garden_sog/2_0/meta.json", more: ["{DATA}/splats/garden_sog/2_1/meta.json"]),
        home:   Pose(translation: (4.02, -28.3, -0.85)),
        mesh:   ExtractMesh(splats: "garden", around: "home"),
        duck:   LoadObject(path: "{DATA}/gltf/Duck.glb"),
        pose:   Snap(object: "duck", pose: "home", mesh: "mesh"),
        placed: Place(object: "duck", pose: "pose"),'''
# Scene, its nodes, splats, receiver, further parameters of the light; the middle, distance and height of the cameras.
PLACES = [
    ("courtyard", DEMO.format(place="Courtyard", at="(0.0, 0.0, 0.0)", scale=1.7), "demo.splats", "demo.proxy", "", (0, 0, 0.2), 3.2, 1.3),
    ("room", DEMO.format(place="Room", at="(-0.02, -0.06, 0.44)", scale=1.2), "demo.splats", "demo.proxy", "", (0, 0, 0.5), 1.3, 0.7),
    ("garden", GARDEN, "garden", "mesh", ", ground_albedo: 0.2", (4.02, -28.3, -0.5), 4.5, 1.6),
]


def graph_of(nodes, splats, receiver, more, middle, distance, height, cameras, samples):
    """The graph of a place: the baked splats, and for each camera what is compared."""
    trace = f'receiver: "{receiver}", objects: ["placed"], env: "env", clamp_indirect: 4.0'
    text = nodes + LIGHT.format(splats=splats, more=more)
    text += f'''
        first:  Camera(eye: {middle[0], middle[1] - distance, middle[2] + height}, target: {middle}, width_px: 480, height_px: 320),
        at:     PathTrace({trace}, rig: "first", points: "{splats}", samples: {samples[0]}, shadow_only: true),
        calm:   Denoise(without: "at.without", with: "at.with", object: "at.object", depth: "at.depth", normal: "at.normal", variance: "at.variance", points: "{splats}"),
        ratio:  ShadowRatio(without: "calm.without", with: "calm.with"),
        baked:  BakeShadow(splats: "{splats}", shadow: "ratio"),
        file:   WriteSplats(splats: "baked", path: "baked.ply"),'''
    for i in range(cameras):
        turn = 2 * math.pi * i / cameras
        eye = [round(m + r, 4) for m, r in zip(middle, (distance * math.sin(turn), -distance * math.cos(turn), height * (1 + i % 2)))]
        text += f'''
        cam{i}:  Camera(eye: {tuple(eye)}, target: {middle}, width_px: 480, height_px: 320),
        view{i}: SplatRender(splats: "{splats}", rig: "cam{i}"),
        tr{i}:   PathTrace({trace}, rig: "cam{i}", samples: {samples[1]}),
        cl{i}:   Denoise(without: "tr{i}.without", with: "tr{i}.with", object: "tr{i}.object", depth: "tr{i}.depth", normal: "tr{i}.normal", variance: "tr{i}.variance"),
        sh{i}:   ShadowRatio(without: "cl{i}.without", with: "cl{i}.with"),
        mask{i}: RegionMasks(object: "cl{i}.object", shadow: "sh{i}", edge_threshold: 0.0),
        want{i}: Composite(background: "view{i}", object: "cl{i}.object", shadow: "sh{i}"),
        bare{i}: Composite(background: "view{i}", object: "cl{i}.object"),
        seen{i}: SplatRender(splats: "baked", rig: "cam{i}"),
        got{i}:  Composite(background: "seen{i}", object: "cl{i}.object"),
        a{i}:    Compare(image: "got{i}", reference: "want{i}", regions: ["mask{i}.shadow", "mask{i}.rest"], names: ["shadow", "rest"]),
        b{i}:    Compare(image: "bare{i}", reference: "want{i}", regions: ["mask{i}.shadow", "mask{i}.rest"], names: ["shadow", "rest"]),
        sa{i}:   WriteReport(report: "a{i}", path: "baked{i}.md"),
        sb{i}:   WriteReport(report: "b{i}", path: "bare{i}.md"),
        sheet{i}: ContactSheet(images: ["bare{i}", "got{i}", "want{i}"]),
        png{i}:  WriteImage(image: "sheet{i}", path: "look{i}.png"),'''
    return f'Graph(version: 1, scene: (up: "+z", seed: 7), nodes: ({text}\n))'


def psnr(folder, name, count):
    """PSNR in the shadow and in the rest, one number for each camera that sees the region."""
    found = [row for i in range(count) for row in rows(os.path.join(folder, f"{name}{i}.md")) if row["picture"] == "image"]
    column = lambda region: [float(row["psnr (dB)"]) for row in found if row["region"] == region and row["psnr (dB)"] not in ("not computed", "inf")]
    return [column("shadow"), column("rest")]


def main():
    os.makedirs(WORK, exist_ok=True)
    cameras, samples = (2, (4, 4)) if SMALL else (4, (16, 64))
    print("| place | shadow, dB: baked, mean (lowest) | unbaked | rest, dB: baked | unbaked |\n|---|---|---|---|---|")
    for name, *place in PLACES:
        folder = os.path.join(WORK, name)
        shutil.rmtree(folder, ignore_errors=True)
        os.makedirs(folder)
        graph = os.path.join(folder, "graph.ron")
        with open(graph, "w") as file:
            file.write(graph_of(*place, cameras, samples))
        command = [PROGRAM, "run", graph, "--cache", os.path.join(WORK, "cache"), "--out", folder]
        if subprocess.run(command).returncode not in (0, 3):
            sys.exit(1)
        cells = []
        for both in zip(psnr(folder, "baked", cameras), psnr(folder, "bare", cameras)):
            cells.append([f"{sum(v) / len(v):.1f} ({min(v):.1f})" if v else "-" for v in both])
        print(f"| {name} | {cells[0][0]} | {cells[0][1]} | {cells[1][0]} | {cells[1][1]} |", flush=True)


if __name__ == "__main__":
    main()
