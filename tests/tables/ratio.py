#!/usr/bin/env python3
"""Which of two commands takes longer, on a machine that others use: the ratio of B to A and how far A is from itself.

usage: ratio.py [-n ROUNDS] 'COMMAND A' 'COMMAND B'       ROUNDS of A A B B A, 7 or more

Every run is a fresh process. `{round}` in a command is a number of its own for each run, for a cold cache: --cache /tmp/c{round}.
A round gives the ratio of the two Bs to the first two As (B to A) and that of the last A to the mean of these (A to A), of
CPU time and of wall time. Printed are the medians with least and most, and the load. B is slower or faster only where its
range excludes 1 by more than A's own range is wide.
"""
import argparse, os, resource, statistics, subprocess, time

def run(command, number):
    """CPU and wall seconds of a command in a shell."""
    start, before = time.perf_counter(), resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(command.replace("{round}", str(number)), shell=True, check=True, stdout=subprocess.DEVNULL,
                   stderr=subprocess.DEVNULL)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return cpu, time.perf_counter() - start

def main():
    parse = argparse.ArgumentParser(usage=__doc__)
    parse.add_argument("-n", type=int, default=7)
    parse.add_argument("a")
    parse.add_argument("b")
    asked = parse.parse_args()
    ratios = {(of, unit): [] for of in ["B to A", "A to A"] for unit in ["CPU", "wall"]}
    for number in range(max(asked.n, 7)):
        taken = [run(command, 5 * number + at) for at, command in enumerate([asked.a, asked.a, asked.b, asked.b, asked.a])]
        for at, unit in enumerate(["CPU", "wall"]):
            first, second, b, d, last = (one[at] for one in taken)
            ratios["B to A", unit].append((b + d) / (first + second))
            ratios["A to A", unit].append(2 * last / (first + second))
    print("| of | time | median | least | most |\n|---|---|---|---|---|")
    for (of, unit), found in ratios.items():
        print(f"| {of} | {unit} | {statistics.median(found):.3f} | {min(found):.3f} | {max(found):.3f} |")
    for unit in ["CPU", "wall"]:
        own, found = ratios["A to A", unit], ratios["B to A", unit]
        beyond = max(min(found) - 1, 1 - max(found))
        word = "another" if beyond > max(own) - min(own) else "not distinguishable"
        print(f"{unit}: {word}, at a load of {os.getloadavg()[0]:.1f}")

if __name__ == "__main__":
    main()
