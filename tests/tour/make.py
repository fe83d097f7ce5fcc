#!/usr/bin/env python3
"""Runs the commands of `docs/tour.md`, in a new folder and with a new cache, and prints the page.

usage: make.py LIGHTHARMONY WORK > docs/tour.md     takes about two minutes of CPU time

Long outputs are cut, with a mark; nothing else is changed, so times and digests are those of the machine.
"""
import os, shutil, signal, struct, subprocess, sys, time, zlib

PROGRAM, WORK = os.path.abspath(sys.argv[1]), os.path.abspath(sys.argv[2])
ENV = {**os.environ, "LIGHTHARMONY_CACHE": f"{WORK}/cache", "NO_COLOR": "1", "PATH": f"{WORK}/bin:{os.environ['PATH']}"}

def say(text):
    print(text, flush=True)

def shown(text, most):
    lines = [line.replace(WORK, "~") for line in text.rstrip("\n").split("\n")]
    if len(lines) > most:
        cut = len(lines) - most
        lines = lines[: most - 1] + [f"    [{cut} lines more]"] + lines[-1:]
    return "\n".join(line[:150] + (" .." if len(line) > 150 else "") for line in lines)

def run(command, folder="", most=14):
    """One shell command, with both its outputs and its exit code unless that is 0."""
    done = subprocess.run(command, shell=True, cwd=f"{WORK}/{folder}", env=ENV, text=True,
                          stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
    say(f"$ {command}")
    if done.stdout:
        say(shown(done.stdout, most))
    if done.returncode:
        say(f"[exit code {done.returncode}]")

def section(title, text=""):
    say(f"\n## {title}\n{text}" if text else f"\n## {title}")

def transcript(*commands, folder="", most=14):
    say("```text")
    for command in commands:
        run(command, folder, most)
    say("```")

def replaced(path, old, new):
    with open(path) as f:
        text = f.read()
    assert old in text, (path, old)
    with open(path, "w") as f:
        f.write(text.replace(old, new, 1))

def watch():
    """A watch during which the graph is edited: its output after each edit."""
    graph, log = f"{WORK}/first/graph.ron", f"{WORK}/watch.txt"
    with open(log, "w") as to:
        process = subprocess.Popen([PROGRAM, "watch", "graph.ron"], cwd=f"{WORK}/first", env=ENV, stdout=to, stderr=to)
    read = 0
    def until(word):
        nonlocal read
        for _ in range(1200):
            time.sleep(0.1)
            with open(log) as f:
                text = f.read()
            if word in text[read:] and text.endswith("\n"):
                time.sleep(0.3)
                with open(log) as f:
                    text = f.read()
                new, read = text[read:], len(text)
                return new
        sys.exit(f"timed out waiting for {word}")
    say("```text\n$ lightharmony watch graph.ron")
    say(shown(until("watching"), 14))
    replaced(graph, "yaw_deg: -24.0", "yaw_deg: 45.0")
    say("[the editor saves another yaw]\n" + shown(until("watching"), 16))
    replaced(graph, "yaw_deg: 45.0", "yaw_dge: 45.0")
    say("[a slip of the finger]\n" + shown(until("watching"), 16))
    replaced(graph, "yaw_dge: 45.0", "yaw_deg: -24.0")
    say("[the first yaw again]\n" + shown(until("watching"), 16))
    process.send_signal(signal.SIGINT)
    process.wait()
    say("[Ctrl-C]\n```")

shutil.rmtree(WORK, ignore_errors=True)
os.makedirs(f"{WORK}/bin")
os.symlink(PROGRAM, f"{WORK}/bin/lightharmony")
say("""# A tour

Every command below was run, in this order, in a new folder and with a new cache, by

```sh
python3 tests/tour/make.py target/release/lightharmony /tmp/tour > docs/tour.md
```

`~` is that folder. Long outputs are cut, with a mark. Times are wall times of the machine that made the page,
here two cores shared with other work.""")
section("A first picture")
transcript("lightharmony init first", most=6)
transcript("lightharmony run graph.ron", "lightharmony run graph.ron", folder="first", most=20)
section("Watching", "The graph is edited while `watch` runs. Only the nodes that the yaw affects run; a slow graph would show a rough picture first.")
watch()
section("What would run, and why")
transcript("lightharmony plan graph.ron --set pose.yaw_deg=35.0", "lightharmony explain graph.ron trace --set pose.yaw_deg=35.0",
           "lightharmony run graph.ron --set pose.yaw_deg=35.0 --trace threads.json", "head -c 300 threads.json; echo",
           "sed 's/-24.0/35.0/' graph.ron > other.ron", "lightharmony diff graph.ron other.ron",
           "lightharmony run graph.ron --only env 2>&1 | tail -1",
           "lightharmony graph graph.ron --format dot | head -4", folder="first", most=20)
section("Subgraphs", "A subgraph used twice, and a mistake in its file: a misspelt name.")
graphs = f"{os.path.dirname(os.path.abspath(__file__))}/../../graphs"
os.makedirs(f"{WORK}/several")
shutil.copy(f"{graphs}/pair.ron", f"{WORK}/several")
shutil.copytree(f"{graphs}/parts", f"{WORK}/several/parts")
transcript("lightharmony check pair.ron", "lightharmony plan pair.ron | tail -1", "sed 's/height_metres/hight_metres/' -i parts/*.ron; lightharmony check pair.ron", folder="several", most=20)
section("Many pictures", "A node that depends on an axis runs once for each value of it; every other node runs once.")
os.makedirs(f"{WORK}/many")
shutil.copy(f"{graphs}/turntable.ron", f"{WORK}/many")
transcript("lightharmony run turntable.ron --preset draft > log.txt 2>&1; tail -1 log.txt",
           "grep -o 'ran [a-z]*' log.txt | sort | uniq -c", "ls -R out", folder="many", most=30)
section("The same bytes elsewhere")
transcript("lightharmony run graph.ron 2>&1 | tail -1", "lightharmony lock graph.ron", "lightharmony run graph.ron --locked 2>&1 | tail -1", "lightharmony pack graph.ron first.lhb --results all", "ls -s --block-size=k first.lhb", folder="first", most=8)
say("\nIn another folder, with another cache:")
os.makedirs(f"{WORK}/second")
shutil.copy(f"{WORK}/first/first.lhb", f"{WORK}/second")
ENV["LIGHTHARMONY_CACHE"] = f"{WORK}/cache2"
transcript("lightharmony verify first.lhb --sample 3 --seed 1", "lightharmony unpack first.lhb again", "ls again",
           "lightharmony run again/graph.ron", "cmp out/picture.png ../first/out/picture.png && echo equal",
           "cp ../first/out/picture.png . && lightharmony run picture.png --out from-picture",
           "cmp from-picture/*.png picture.png && echo equal", folder="second", most=8)
say("\nA graph from a bundle can read nothing outside of it:")
transcript("sed 's|DemoScene(.*|LoadSplats(path: \"../first.lhb\"),|' again/graph.ron > again/curious.ron; lightharmony run again/curious.ron 2>&1 | head -7", folder="second", most=12)
ENV["LIGHTHARMONY_CACHE"] = f"{WORK}/cache"
section("The cache")
transcript("lightharmony cache stat", "lightharmony cache verify", "lightharmony cache gc --max-size 1M --dry-run",
           "lightharmony cache pin first/graph.ron", "lightharmony cache gc --max-size 0", "lightharmony run first/graph.ron --out first/out", most=8)
section("Faults")
transcript("truncate -s 100 cache/v1/blobs/*/*", "lightharmony cache verify", "rm -r first/out; lightharmony run first/graph.ron --out first/out",
           "lightharmony run first/graph.rom", "lightharmony run first/graph.ron --set pose.yaw=3", "lightharmony run first/graph.ron --set demo.width_px=4000000000",
           "lightharmony run first/graph.ron --out /proc/out --set pose.yaw_deg=1.0 2>&1 | tail -6",
           "timeout --foreground --preserve-status -s INT 3 lightharmony run first/graph.ron --set trace.samples=4000 2>&1 | tail -3", most=12)
section("A graph of several files", "One file arranges pictures in a sheet, and is used twice as a subgraph; another file, included, loads the photograph.")
os.makedirs(f"{WORK}/pieces")
def photograph(path, width=64, height=48):
    """A PNG of two gradients."""
    rows = b"".join(b"\0" + bytes(v for x in range(width) for v in (4 * x, 5 * y, 99)) for y in range(height))
    chunk = lambda name, data: struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))
    with open(path, "wb") as f:
        f.write(b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0))
                + chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b""))
def written(name, text):
    with open(f"{WORK}/pieces/{name}", "w") as f:
        f.write(text)
photograph(f"{WORK}/pieces/photo.png")
written("photo.ron", 'Graph(version: 1, nodes: (photo: LoadImage(path: "photo.png")))\n')
written("sheet.ron", """Graph(
    version: 1,
    parameters: (pictures: Required, columns: 1),
    nodes: (sheet: ContactSheet(images: Param("pictures"), columns: Param("columns"))),
)
""")
written("graph.ron", """Graph(
    version: 1,
    include: ["photo.ron"],
    scene: (up: "+z"),
    nodes: (
        tall: Subgraph(graph: "sheet.ron", pictures: ["photo", "photo"]),
        wide: Subgraph(graph: "sheet.ron", pictures: ["photo", "photo"], columns: 2),
        a:    WriteImage(image: "tall.sheet", path: "tall.png"),
        b:    WriteImage(image: "wide.sheet", path: "wide.png"),
    ),
)
""")
transcript("cat sheet.ron graph.ron", "lightharmony check graph.ron", "lightharmony run graph.ron --only wide",
           "lightharmony run graph.ron", "lightharmony graph graph.ron --format mermaid", folder="pieces", most=30)
section("Exactly this, or not at all", "After the lock the photograph is replaced by another.")
transcript("lightharmony lock graph.ron", "lightharmony run graph.ron --locked", folder="pieces", most=12)
photograph(f"{WORK}/pieces/photo.png", height=40)
transcript("lightharmony run graph.ron --locked", folder="pieces", most=12)
photograph(f"{WORK}/pieces/photo.png")
section("Caches from one place to another")
transcript("lightharmony cache copy --to elsewhere graph.ron", "lightharmony run graph.ron --cache elsewhere --out out2 2>&1 | tail -1",
           "truncate -s 10 elsewhere/v1/blobs/*/*", "lightharmony cache repair --cache elsewhere", folder="pieces", most=8)
section("Refused", "Files that an untrusted graph may not read, and a node that does not fit into memory.")
os.makedirs(f"{WORK}/untrusted")
transcript("lightharmony pack graph.ron graph.lhb", "cd ../untrusted && lightharmony unpack ../pieces/graph.lhb theirs",
           "cd ../untrusted && sed -i 's|\"photo.png\"|\"../../pieces/photo.png\"|' theirs/*.ron; lightharmony run theirs/graph.ron",
           "lightharmony run graph.ron --cache fresh --memory 20K", folder="pieces", most=14)
section("The shell")
transcript("lightharmony completions bash | wc -l", "lightharmony manual --to man && ls man | head -3", "lightharmony nodes cube-rig")
