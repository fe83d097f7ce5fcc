#!/usr/bin/env python3
"""What samples, the filter and each choice are worth, on crops of the courtyard of tests/bench_case.

usage: ablations.py LIGHTHARMONY DATA WORK [small]    prints two tables of docs/evidence/light-transport.md and one of docs/evidence/bench.md;
WORK is a folder to fill; `small` only tries it: one number of samples, without what changes the trace

Every number of samples goes on from the one before; CPU seconds are those of the nodes' code since the first. Needs numpy,
OpenEXR and Pillow.
"""
import json, os, subprocess, sys

from job import ROOT
from reports import decibels, rows

PROGRAM, DATA, WORK = (os.path.abspath(word) for word in sys.argv[1:4])
SMALL = sys.argv[4:] == ["small"]
SAMPLES, CHOICES = ([2], 2) if SMALL else ([4, 16, 64], 16)
LIGHTS = [("far", "far", "distant", "distant_raw"), ("near", "trace", "whole", "raw")]
# The change, the report that measures it, and whether it affects the object.
ROWS = [("all of it", "whole", True), ("no mask and no epsilon (`form: Paper`)", "unmasked", False),
        ("light above 1 kept (`s_max: 2`)", "bright", False), ("one ratio of luminance", "grey", False),
        ("far light (`surroundings: Distant`)", "distant", True), ("not denoised", "raw", True),
        ("the mesh as it is (`contact_metres: 0`), not denoised", "level", True),
        ("a grey mask over the picture (`alpha-shadow`)", "overlay", False),
        ("visibility as printed (`surroundings: Paper`), not denoised", "paper", True), ("no shadow", "bare", False)]
# Those that trace again, and have no small form.
TRACED = ["level", "paper"]

def run(samples, reports):
    """CPU seconds of every node that ran."""
    sets = [word for node in ["trace", "far", "flat", "printed"] for word in ["--set", f"{node}.samples={samples}"]]
    command = [PROGRAM, "run", os.path.join(WORK, "ablations.ron"), "--overlay", os.path.join(WORK, "crops/crops.ron"), *sets,
               "--only", ",".join(f"{name}_table" for name in reports), "--cache", os.path.join(WORK, "cache"),
               "--out", os.path.join(WORK, "out"), "--json"]
    done = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    if done.returncode not in (0, 3):
        sys.exit(f"ablations.ron: {done.stderr}")
    events = [json.loads(line) for line in done.stdout.splitlines()]
    return {event["id"]: event["cpu_seconds"] for event in events if event["event"] == "node" and event["state"] == "ran"}

def cell(report, region):
    return decibels(rows(os.path.join(WORK, f"out/ablation_{report}.md")), "image", region)

def main():
    os.makedirs(WORK, exist_ok=True)
    case = os.path.join(DATA, "bench-case")
    subprocess.run([sys.executable, os.path.join(ROOT, "tests/bench_case/crops.py"), case, os.path.join(WORK, "crops")], check=True)
    with open(os.path.join(ROOT, "tests/bench_case/ablations.ron")) as file:
        text = file.read().replace("../../../shared/data", DATA)
    with open(os.path.join(WORK, "ablations.ron"), "w") as file:
        file.write(text)
    known, noise, lights, choices = {}, {}, {}, []
    for samples in SAMPLES:
        spent = run(samples, [name for _, _, clean, raw in LIGHTS for name in [clean, raw]])
        for light, node, clean, raw in LIGHTS:
            known[node] = known.get(node, 0.0) + spent.get(node, 0.0)
            cells = [cell(report, region) for region in ["shadow", "object"] for report in [raw, clean]]
            noise[light, samples] = f"| {light} | {samples} | {' | '.join(cells)} |"
            cells = [cell(clean, region) for region in ["shadow", "object", "whole"]]
            lights[light, samples] = f"| {light} | {samples} | {' | '.join(cells)} | {known[node]:.3g} |"
        if samples == CHOICES:
            kept = [row for row in ROWS if not (SMALL and row[1] in TRACED)]
            run(samples, [report for _, report, _ in kept])
            choices = [f"| {what} | {cell(report, 'shadow')} | {cell(report, 'object') if is_object else ''} |"
                       for what, report, is_object in kept]
    def table(head, lines):
        print(f"{head}\n{'|---' * (head.count('|') - 1)}|", *lines, "", sep="\n")
    order = [(light, samples) for light, *_ in LIGHTS for samples in SAMPLES]
    table("| light | samples | shadow, raw | denoised | object, raw | denoised |", [noise[key] for key in order])
    table("| light | samples | shadow | object | crop | CPU-s |", [lights[key] for key in order])
    table("| | shadow | object |", choices)

if __name__ == "__main__":
    main()
