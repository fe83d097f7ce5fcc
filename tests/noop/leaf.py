#!/usr/bin/env python3
"""The cost of a run after an edit of the last node of a graph, in a new process: two programs compared.

usage: leaf.py BEFORE AFTER WORK [SIZES]     prints rows of the table of docs/evidence/bench.md

The graphs are those of ninja.py. In each round the last node gets a number that it never had, so that one node and the file of
the sink are made. The programs take turns, each with a folder and a cache of its own. CPU time of the process and its threads,
user and system, from the kernel, and wall time; the figures are medians of all rounds.
"""
import os, re, shutil, statistics, subprocess, sys, time
from ninja import cpu_ms, make, spread

ROUNDS = 21

def main():
    programs = [os.path.abspath(shutil.which(word) or word) for word in sys.argv[1:3]]
    work = os.path.abspath(sys.argv[3])
    sizes = [int(n) for n in sys.argv[4].split(",")] if len(sys.argv) > 4 else [100, 1000, 10000]
    print("| shape | nodes | before, ms of CPU | after | difference | spread | wall, before | after |\n|---|---|---|---|---|---|---|---|")
    for shape in ("chain", "grid"):
        for n in sizes:
            sides = []
            for side, program in enumerate(programs):
                folder = f"{work}/{shape}-{n}-{side}"
                make(folder, shape, n)
                with open(f"{folder}/graph.ron") as f:
                    sides.append(([program, "run", "graph.ron", "--cache", "cache"], folder, f.read(), [], []))
            for command, folder, *_ in sides:
                cpu_ms(command, folder)
            subprocess.run(["sleep", "2.5"], check=True)
            for command, folder, *_ in sides:
                cpu_ms(command, folder)
            for number in range(ROUNDS):
                for command, folder, text, cpu, wall in sides:
                    edited, count = re.subn(rf"(    n{n - 1}: .*backdrop: \(){n - 1}e-4", rf"\g<1>{n - 1}.{number + 1:03}e-4", text)
                    assert count == 1
                    with open(f"{folder}/graph.ron", "w") as f:
                        f.write(edited)
                    start = time.monotonic()
                    spent, notes = cpu_ms(command, folder)
                    wall.append(1e3 * (time.monotonic() - start))
                    cpu.append(spent)
                    # The node and the sink.
                    assert "2 ran" in notes, notes
            cpus, walls = [side[3] for side in sides], [side[4] for side in sides]
            a, b = map(statistics.median, cpus)
            c, d = map(statistics.median, walls)
            print(f"| {shape} | {n:,} | {a:.1f} | {b:.1f} | {b - a:+.1f} | {spread(cpus[0]):.0f} %, {spread(cpus[1]):.0f} % "
                  f"| {c:.1f} | {d:.1f} |", flush=True)

main()
