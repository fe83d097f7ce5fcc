#!/usr/bin/env python3
"""How long after a save `watch` shows the first picture, and the last one.

usage: latency.py LIGHTHARMONY GRAPH WORK EDIT.. [-- ARGUMENTS]     prints rows of the table of docs/architecture.md

The arguments go to `watch`.

An EDIT is `NAME|OLD|NEW[|NEW..]`, texts in the graph file; each NEW is saved in turn, so that what the first one leaves behind
(parts of a preview) is there for the next, and the last one counts. The graph is copied next to itself for it. The script prints wall
time, and CPU time of the process, user and system, since the save: with no other load and all of it in parallel, the wall time of
two cores is half of that.
"""
import json, os, signal, subprocess, sys, time

def cpu(pid):
    fields = open(f"/proc/{pid}/stat").read().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")

class Watch:
    def __init__(self, program, graph, work, more):
        command = [program, "watch", graph, "--json", "--out", f"{work}/out", "--cache", f"{work}/cache", *more]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)

    def events(self):
        """All until the watch is idle, each with wall and CPU time."""
        for line in self.process.stdout:
            event = json.loads(line)
            yield event, time.monotonic(), cpu(self.process.pid)
            if event["event"] == "idle":
                return

def save(path, text):
    with open(path + ".new", "w") as f:
        f.write(text)
    os.replace(path + ".new", path)

def main():
    program, graph, work = os.path.abspath(sys.argv[1]), os.path.abspath(sys.argv[2]), os.path.abspath(sys.argv[3])
    edits = sys.argv[4:]
    more = edits[edits.index("--") + 1:] if "--" in edits else []
    verbose = os.environ.get("VERBOSE")
    # So that the copy goes and the watch ends however this does.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))
    text = open(graph).read()
    copy = f"{os.path.dirname(graph)}/.latency-{os.getpid()}.ron"
    save(copy, text)
    watch = Watch(program, copy, work, more)
    try:
        list(watch.events())
        print("| edit | first picture, s | of CPU | last picture, s | of CPU |\n|---|---|---|---|---|", flush=True)
        for edit in edits[:len(edits) - len(more) - bool(more)]:
            name, old, *news = edit.split("|")
            assert text.count(old) == 1, f"{old!r} is there {text.count(old)} times"
            for new in news:
                time.sleep(0.3)
                start, before = time.monotonic(), cpu(watch.process.pid)
                save(copy, text.replace(old, new))
                shown = []
                for event, wall, spent in watch.events():
                    if verbose:
                        print(f"{wall - start:.3f} {spent - before:.2f}", {k: event[k] for k in event if k not in ("notes", "key")}, file=sys.stderr)
                    if event["event"] == "file" and event["written"]:
                        shown.append((wall - start, spent - before))
            first, last = (shown[0], shown[-1]) if shown else ((0, 0), (0, 0))
            print(f"| {name} | {first[0]:.2f} | {first[1]:.2f} | {last[0]:.2f} | {last[1]:.2f} |", flush=True)
            time.sleep(0.3)
            save(copy, text)
            list(watch.events())
    finally:
        watch.process.terminate()
        watch.process.wait()
        os.remove(copy)

main()
