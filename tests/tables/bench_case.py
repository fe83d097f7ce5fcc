#!/usr/bin/env python3
"""The insertions of tests/bench_case beside the truth: PSNR inside the shadow and CPU seconds.

usage: bench_case.py LIGHTHARMONY DATA WORK [small]    prints the table of README.md; WORK is a folder to fill; `small`
only tries it: one sample

A graph is run at 16 samples in an empty cache and then at 64, which goes on from there: its CPU time is that of its own run and of the
trace that it found.
"""
import json, os, shutil, subprocess, sys

from job import ROOT, cpu

PROGRAM, DATA, WORK = (os.path.abspath(word) for word in sys.argv[1:4])
SAMPLES = [1] if sys.argv[4:] == ["small"] else [16, 64]
# A graph, its report, and what its rows are called.
GRAPHS = [("oracle", "true background and light"), ("end_to_end", "splats and recovered light")]

def run(graph, samples):
    """The rows of the report, CPU-seconds of the process, and those of the trace."""
    before, out = cpu(), os.path.join(WORK, "out")
    done = subprocess.run([PROGRAM, "run", graph, "--set", f"trace.samples={samples}", "--cache", os.path.join(WORK, "cache"),
                           "--out", out, "--json"], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    if done.returncode not in (0, 3):
        sys.exit(f"{graph}: {done.stderr}")
    events = [json.loads(line) for line in done.stdout.splitlines()]
    trace = next(e for e in events if e["event"] == "node" and e["id"] == "trace")["cpu_seconds"]
    name = os.path.basename(graph).removesuffix(".ron")
    with open(os.path.join(out, f"{name}.md")) as file:
        lines = [[cell.strip() for cell in line.strip("|\n").split("|")] for line in file if line.startswith("| ")]
    head = next(line for line in lines if line[:3] == ["view", "picture", "region"])
    rows = [dict(zip(head, line)) for line in lines if len(line) == len(head)]
    return rows, cpu() - before, trace

def main():
    os.makedirs(WORK, exist_ok=True)
    print("| shadow region, dB, views 0 / 1 / 2 | CPU-s, whole graph | nothing inserted | no shadow | ours |\n|---|---|---|---|---|")
    for name, called in GRAPHS:
        with open(os.path.join(ROOT, f"tests/bench_case/{name}.ron")) as file:
            text = file.read().replace("../../../shared/data", DATA)
        graph = os.path.join(WORK, f"{name}.ron")
        with open(graph, "w") as file:
            file.write(text)
        shutil.rmtree(os.path.join(WORK, "cache"), ignore_errors=True)
        known = 0.0
        for samples in SAMPLES:
            rows, spent, trace = run(graph, samples)
            def shadow(picture):
                found = [row["psnr (dB)"] for row in rows if row["picture"] == picture and row["region"] == "shadow"]
                return " / ".join(f"{float(value):.1f}" for value in found)
            cells = [shadow(picture) for picture in ["nothing inserted", "no shadow", "image"]]
            said = f"{called}, {samples} samples" if samples == SAMPLES[0] else f"the same, {samples} samples"
            print(f"| {said} | {spent + known:.0f} | {' | '.join(cells)} |", flush=True)
            known += trace
        if name == "end_to_end":
            ceiling = os.path.join(WORK, "out/ceiling.md")
            with open(ceiling) as file:
                lines = [[cell.strip() for cell in line.strip("|\n").split("|")] for line in file if line.startswith("| ")]
            at = lines[0].index("psnr (dB)")
            found = [line[at] for line in lines[1:] if len(line) > at and line[1:3] == ["image", "shadow"]]
            print(f"| (a perfect ratio on the same splats) | | | | {' / '.join(f'{float(value):.1f}' for value in found)} |")

if __name__ == "__main__":
    main()
