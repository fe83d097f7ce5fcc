#!/usr/bin/env python3
"""The insertions of tests/bench_case compared with the truth: PSNR inside the shadow and on the object, and CPU seconds.

usage: bench_case.py LIGHTHARMONY DATA WORK [small]    prints the table of README.md and two of docs/evidence/bench.md; WORK is a folder to
fill; `small` only tries it: one sample

True light is traced at 16 samples in an empty cache and then at 64, which goes on from there: its CPU time is that of its own
run and of the trace that it found. What the splats limit, and far light, are traced at 16 alone.
"""
import json, os, shutil, subprocess, sys

from job import ROOT, cpu
from reports import decibels, rows

PROGRAM, DATA, WORK = (os.path.abspath(word) for word in sys.argv[1:4])
FEW, MANY = (1, 1) if sys.argv[4:] == ["small"] else (16, 64)

def run(name, samples, *sets):
    """The rows of the report, CPU-seconds of the process, and those of the trace."""
    graph, before, out = os.path.join(WORK, f"{name}.ron"), cpu(), os.path.join(WORK, "out")
    with open(os.path.join(ROOT, f"tests/bench_case/{name}.ron")) as file:
        text = file.read().replace("../../../shared/data", DATA)
    with open(graph, "w") as file:
        file.write(text)
    done = subprocess.run([PROGRAM, "run", graph, "--set", f"trace.samples={samples}", *sets, "--cache", os.path.join(WORK, "cache"),
                           "--out", out, "--json"], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    if done.returncode not in (0, 3):
        sys.exit(f"{graph}: {done.stderr}")
    events = [json.loads(line) for line in done.stdout.splitlines()]
    trace = next(e for e in events if e["event"] == "node" and e["id"] == "trace")["cpu_seconds"]
    return rows(os.path.join(out, f"{name}.md")), cpu() - before, trace

def table(head, lines):
    print(f"{head}\n{'|---' * (head.count('|') - 1)}|", *lines, "", sep="\n", flush=True)

def main():
    os.makedirs(WORK, exist_ok=True)
    shutil.rmtree(os.path.join(WORK, "cache"), ignore_errors=True)
    near, first, trace = run("oracle", FEW)
    fine, second, _ = run("oracle", MANY)
    far, without, _ = run("oracle", FEW, "--set", "trace.surroundings=Distant")
    whole, splats, _ = run("end_to_end", FEW)
    ceiling = rows(os.path.join(WORK, "out/ceiling.md"))

    def readme(what, spent, found):
        cells = [decibels(found, picture, "shadow") for picture in ["nothing inserted", "no shadow", "image"]]
        return f"| {what} | {spent:.0f} | {' | '.join(cells)} |"
    table("| shadow region, dB, views 0 / 1 / 2 | CPU-s, whole graph | nothing inserted | no shadow | ours |", [
        readme(f"true background and light, {FEW} samples", first, near),
        readme(f"the same, {MANY} samples", second + trace, fine),
        readme(f"splats and recovered light, {FEW} samples", splats, whole),
        f"| (a perfect ratio on the same splats) | | | | {decibels(ceiling, 'image', 'shadow')} |"])

    def both(what, samples, found, picture, *regions):
        cells = [decibels(found, picture, region) for region in regions or ["shadow", "object"]]
        return f"| {what} | {samples} | {' | '.join(cells)} |"
    table("| picture | samples | shadow | object |", [
        both("true background, nothing inserted", "", near, "nothing inserted"),
        both("true background, object without shadow", MANY, fine, "no shadow"),
        both("true background, true light, ours", FEW, near, "image"),
        both("true background, true light, ours", MANY, fine, "image"),
        both("splats, nothing inserted", "", whole, "nothing inserted"),
        both("splats, object without shadow", FEW, whole, "no shadow"),
        both("splats, recovered light, ours", FEW, whole, "image"),
        f"| splats, true ratio (the ceiling) | | {decibels(ceiling, 'image', 'shadow')} | |"])
    table("| light | samples | shadow | object | whole picture | CPU-s |", [
        f"{both(light, samples, found, 'image', 'shadow', 'object', 'whole')} {spent:.0f} |"
        for light, samples, found, spent in [("far", FEW, far, without), ("near", FEW, near, first), ("near", MANY, fine, second + trace)]])

if __name__ == "__main__":
    main()
