#!/usr/bin/env python3
"""`extract-mesh` on the courtyard of the bench case: insertions on the given mesh and on one from the splats, and what meshes cost.

usage: mesh.py LIGHTHARMONY DATA WORK [SAMPLES | small]    prints tables of docs/evidence/extract-mesh.md; WORK is a folder to fill; SAMPLES
are those of the traces, 256 by default; `small` only tries it: one sample

How far the meshes are off in millimetres is printed by a test:
cargo test --release -p lightharmony-testkit --features real-data --test real_data mesh -- --nocapture
"""
import json, os, shutil, subprocess, sys

from job import ROOT
from reports import decibels, rows

PROGRAM, DATA, WORK = (os.path.abspath(word) for word in sys.argv[1:4])
SMALL = sys.argv[4:] == ["small"]
SAMPLES = 1 if SMALL else int((sys.argv[4:] or ["256"])[0])
GIVEN = f'proxy:   LoadMesh(path: "{DATA}/bench-case/mesh_proxy.ply"),'
OWN = f'''scene: LoadSplats(path: "{DATA}/bench-case/point_cloud.ply"),
        proxy: ExtractMesh(splats: "scene", cameras: "rig", around: "pose"),'''

def run(name, text, *sets, only=None):
    """What a graph says of its nodes."""
    graph = os.path.join(WORK, f"{name}.ron")
    with open(graph, "w") as file:
        file.write(text)
    command = [PROGRAM, "run", graph, *sets, "--cache", os.path.join(WORK, "cache"), "--out", os.path.join(WORK, name), "--json"]
    done = subprocess.run(command + (["--only", only] if only else []), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    if done.returncode not in (0, 3):
        sys.exit(f"{graph}: {done.stderr}")
    events = [json.loads(line) for line in done.stdout.splitlines()]
    return {event["id"]: event for event in events if event["event"] == "node"}

def insertions():
    with open(os.path.join(ROOT, "tests/bench_case/oracle.ron")) as file:
        text = file.read().replace("../../../shared/data", DATA)
    if GIVEN not in text:
        sys.exit("oracle.ron has another mesh")
    print("| contact | mesh | shadow, dB | object, dB |\n|---|---|---|---|")
    for contact in ["None", "0.0"]:
        for mesh, text_of in [("given", text), ("extracted", text.replace(GIVEN, OWN))]:
            name = f"{mesh}_{contact.replace('.', '_')}"
            run(name, text_of, "--set", f"trace.samples={SAMPLES}", "--set", f"trace.contact_metres={contact}", only="table")
            scores = rows(os.path.join(WORK, name, "oracle.md"))
            print(f"| {contact} | {mesh} | {decibels(scores, 'image', 'shadow')} | {decibels(scores, 'image', 'object')} |", flush=True)

def graph_of(splats, at, *mesh):
    """A graph that makes a mesh of splats."""
    return f'''Graph(version: 1, scene: (up: "+z", seed: 7), nodes: (
        {splats},
        pose: Pose(translation: {at}),
        mesh: ExtractMesh(splats: "scene", around: "pose"{''.join(f", {word}" for word in mesh)}),
        save: WriteReport(report: "mesh.report", path: "report.json"),
    ))'''

def costs():
    garden = ", ".join(f'"{DATA}/splats/garden_sog/2_{i}/meta.json"' for i in range(2))
    first, second = garden.split(", ")
    garden = f"scene: LoadSplats(path: {first}, more: [{second}])"
    courtyard = f'scene: LoadSplats(path: "{DATA}/bench-case/point_cloud.ply")'
    print("| scene | voxel, mm | places | size, px | CPU-s | vertices | triangles |\n|---|---|---|---|---|---|---|")
    settings = [(15, 28, 192), (30, 28, 192), (10, 28, 192), (15, 14, 192), (15, 56, 192), (15, 28, 128), (15, 28, 256)]
    for scene, splats, at in [("courtyard", courtyard, "(0.4, 0.3, 0.0)"), ("garden", garden, "(4.02, -28.3, -0.85)")]:
        for voxel, places, size in settings[:1] if SMALL else settings:
            text = graph_of(splats, at, f"voxel_metres: {voxel / 1000}", f"places: {places}", f"size_px: {size}")
            name = f"cost_{scene}_{voxel}_{places}_{size}"
            nodes = run(name, text)
            with open(os.path.join(WORK, name, "report.json")) as file:
                counts = dict(json.load(file)["tables"][0]["rows"])
            seconds = nodes["mesh"]["cpu_seconds"]
            print(f"| {scene} | {voxel} | {places} | {size} | {seconds:.1f} | {counts['vertices']} | {counts['triangles']} |", flush=True)

def main():
    os.makedirs(WORK, exist_ok=True)
    shutil.rmtree(os.path.join(WORK, "cache"), ignore_errors=True)
    insertions()
    print()
    costs()

if __name__ == "__main__":
    main()
