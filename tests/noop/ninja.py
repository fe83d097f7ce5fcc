#!/usr/bin/env python3
"""The cost of a run with nothing to do: lightharmony compared with ninja, on graphs of the same shape.

usage: ninja.py LIGHTHARMONY NINJA WORK [SIZES]     prints the table of docs/evidence/bench.md

Each is a new process that finds everything as it was. ninja's nodes run `cksum` on the files of the nodes they
read; ours are `composite` of pictures of 2 by 2 pixels, read by `load-image` and written by `write-exr`. CPU time
of the process and its threads, user and system, from the kernel; runs alternate, so that a busy machine slows both.
The figure is the median; the spread is the median of |one run - the next| of the same program, in percent.
"""
import os, resource, shutil, statistics, struct, subprocess, sys, zlib

ROUNDS = 21

def wires(shape, n):
    """For each node the nodes it reads."""
    side = max(2, round(n ** 0.5))
    for i in range(n):
        if shape == "chain":
            yield [i - 1] if i else []
        elif shape == "fan":
            yield [] if i < n - 1 else list(range(n - 1))
        else:
            yield [j for j, there in ((i - 1, i % side > 0), (i - side, i >= side)) if there]

def png():
    def chunk(kind, data):
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
    rows = b"".join(b"\0" + bytes([40 * y, 90, 200, 128, 10, 20, 30, 255]) for y in range(2))
    head = struct.pack(">IIBBBBB", 2, 2, 8, 6, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b"")

def graph(shape, n):
    lines = ['Graph(version: 1, scene: (up: "+z"), nodes: (', '    in: LoadImage(path: "in.png"),']
    for i, reads in enumerate(wires(shape, n)):
        if shape == "fan" and i == n - 1:
            layers = ", ".join(f'"n{j}"' for j in reads)
            names = ", ".join(f'"l{j}"' for j in reads)
            lines.append(f'    n{i}: WriteExr(layers: [{layers}], names: [{names}], path: "out.exr"),')
            continue
        names = [f"n{j}" for j in reads] + ["in", "in"]
        lines.append(f'    n{i}: Composite(background: "{names[0]}", object: "{names[1]}", backdrop: ({i}.0, 0.5, 0.25)),'
                     if not reads else
                     f'    n{i}: Composite(background: "{names[0]}", object: "in", shadow: "{names[1]}", backdrop: ({i}e-4, 0.5, 0.25)),'
                     if len(reads) > 1 else
                     f'    n{i}: Composite(background: "{names[0]}", object: "in", backdrop: ({i}e-4, 0.5, 0.25)),')
    if shape != "fan":
        lines.append(f'    save: WriteExr(image: "n{n - 1}", path: "out.exr"),')
    return "\n".join(lines) + "\n))\n"

def make(folder, shape, n):
    os.makedirs(f"{folder}/o", exist_ok=True)
    with open(f"{folder}/in.png", "wb") as f:
        f.write(png())
    with open(f"{folder}/graph.ron", "w") as f:
        f.write(graph(shape, n))
    with open(f"{folder}/build.ninja", "w") as f:
        f.write("rule k\n  command = cksum $in > $out\n")
        for i, reads in enumerate(wires(shape, n)):
            f.write(f"build o/{i}: k {' '.join([f'o/{j}' for j in reads] or ['in.png'])}\n")
        f.write(f"default o/{n - 1}\n")

def cpu_ms(command, folder):
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run(command, cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    if done.returncode:
        sys.exit(f"{command} in {folder}: {done.stderr[-2000:]}")
    return 1e3 * (after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime), done.stderr

def spread(times):
    return 100 * statistics.median(abs(a - b) for a, b in zip(times, times[1:])) / statistics.median(times)

def main():
    # A name is one on the path, as `ninja` is.
    ours, ninja, work = (os.path.abspath(shutil.which(word) or word) for word in sys.argv[1:4])
    sizes = [int(n) for n in sys.argv[4].split(",")] if len(sys.argv) > 4 else [100, 1000, 10000]
    print("| shape | nodes | ninja, ms of CPU | lightharmony | ratio | spread |\n|---|---|---|---|---|---|")
    for shape in ("chain", "fan", "grid"):
        for n in sizes:
            folder = f"{work}/{shape}-{n}"
            make(folder, shape, n)
            commands = {"ninja": [ninja], "ours": [ours, "run", "graph.ron", "--cache", "cache"]}
            # Cold, and once more: files must be old enough that their digests are trusted.
            for command in commands.values():
                cpu_ms(command, folder)
            subprocess.run(["sleep", "2.5"], check=True)
            for command in commands.values():
                cpu_ms(command, folder)
            times = {name: [] for name in commands}
            for _ in range(ROUNDS):
                for name, command in commands.items():
                    spent, told = cpu_ms(command, folder)
                    if name == "ours" and "0 ran" not in told:
                        sys.exit(f"something ran: {told}")
                    times[name].append(spent)
            a, b = statistics.median(times["ninja"]), statistics.median(times["ours"])
            print(f"| {shape} | {n:,} | {a:.1f} | {b:.1f} | {b / a:.2f} | {spread(times['ninja']):.0f} %, {spread(times['ours']):.0f} % |", flush=True)

if __name__ == "__main__":
    main()
