#!/usr/bin/env python3
"""The first hour with the live page: from a capture and an object to a finished picture, only by the page, in a browser.

    tests/page/first_hour.py CAPTURE OBJECT SHOTS [PROGRAM]

Prints each step with its clicks and the time since the start of the program, and writes a screenshot of each step into the
folder SHOTS. Needs chromium and chromedriver, see browser.py.
"""
import pathlib, shutil, sys, tempfile, time

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent))
import browser
from browser import Browser, Place, click, solid, until


class Hour(Place):
    """A watch that was started from a capture, in a folder with an object."""

    def __init__(self, program, capture, thing):
        self.begin, self.clicks, self.rows = time.monotonic(), 0, []
        self.folder = tempfile.TemporaryDirectory()
        self.path = pathlib.Path(self.folder.name)
        self.program, self.graph, self.watched = program, self.path / "graph.ron", str(capture)
        shutil.copy(thing, self.path)
        self.start()

    def step(self, b, shots, words):
        seconds = time.monotonic() - self.begin
        self.rows.append((words, self.clicks, seconds))
        print(f"| {words} | {self.clicks} | {seconds:.0f} s |", flush=True)
        b.shot(shots / f"{len(self.rows)}.png")

    def click(self, b, *at):
        self.clicks += 1
        b.click(*at) if len(at) == 1 else click(b, *at)


def main():
    capture, thing, shots = (pathlib.Path(one).resolve() for one in sys.argv[1:4])
    program = str(pathlib.Path(sys.argv[4] if len(sys.argv) > 4 else browser.ROOT / "target/release/lightharmony").resolve())
    shots.mkdir(parents=True, exist_ok=True)
    p = Hour(program, capture, thing)
    b = Browser()
    print("| step | clicks until then | time since the start |\n|---|---|---|")
    try:
        b.open(p.url)
        until(lambda: b.js("return !document.getElementById('start').hidden"), "the panel is there", 200)
        until(lambda: "splats" in b.text("#splat-count"), "the splats are there", 200)
        until(lambda: solid(b, 0.5, 0.6)[3] > 100, "the capture is drawn", 200)
        time.sleep(1)
        p.step(b, shots, "the place is shown, with the proposed up axis, floor and scale")
        x, y, w, h = b.box("#space")
        p.clicks += 1
        b.drag((x + w * 0.6, y + h * 0.3), (x + w * 0.6 + 60, y + h * 0.3 - 10))
        time.sleep(2)
        p.step(b, shots, "the view is turned a little")
        p.click(b, "#start-click")
        for share in (0.62, 0.7, 0.5, 0.56, 0.78, 0.45, 0.42):
            before = p.text()
            p.click(b, x + w * 0.5, y + h * share)
            try:
                until(lambda: p.text() != before or b.text("#space-note").startswith(("Measuring", "That", "The surface", "there is")), "the click is answered", 20)
            except AssertionError:
                pass
            note = b.text("#space-note")
            if p.text() != before or note.startswith("Measuring"):
                break
            print(f"  the click is refused: {note}")
        until(lambda: "PathTrace" in p.text(), f"the graph is written: {b.text('#space-note')} {b.text('#notice')}", 300)
        p.step(b, shots, "the floor is clicked, and the graph is written")
        until(lambda: any(e["event"] == "file" for e in p.events), "a first preview", 1200)
        b.click("#tab-picture")
        p.clicks += 1
        until(lambda: b.pixel(0.5, 0.5)[3] == 255, "the picture is drawn", 1200)
        p.step(b, shots, "the first preview of the picture is shown")
        until(lambda: any(e["event"] == "file" and not e.get("preview") and "picture" in e["path"] for e in p.events) and p.events[-1]["event"] == "idle", "the picture is finished", 1800)
        time.sleep(1)
        p.step(b, shots, "the picture is finished (8 samples)")
        shutil.copy(p.path / "out/picture.png", shots / "picture.png")
        (shots / "graph.ron").write_text(p.text())
        print(f"memory of the watch: {p.memory():.0f} MiB; errors on the console: {b.console()}")
    finally:
        b.close()
        p.stop()


if __name__ == "__main__":
    main()
