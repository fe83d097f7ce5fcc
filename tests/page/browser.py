#!/usr/bin/env python3
"""Tests of the live page in a real browser: Chromium, without a window, driven by chromedriver over plain WebDriver.

    tests/page/browser.py [--shots DIR] [--only NAME].. [--ci] [--firefox] [PROGRAM]

PROGRAM is a `lightharmony` with the feature `serve` [default: target/release/lightharmony]. On Debian:
`apt-get install --no-install-recommends chromium chromium-driver`. Needs nothing beyond the standard library. `--shots`
writes a screenshot after each scenario. `--ci` runs the part of the scenarios that `.ci/run` has time for. `--firefox` runs a part of the scenarios in Firefox; on Debian: `apt-get install
--no-install-recommends firefox-esr xvfb libgl1-mesa-dri libegl1`. Exit code 0 if all scenarios pass, 77 if there is no
browser. LIGHTHARMONY_PATIENCE is a factor of all times that the scenarios wait [default: 1].
"""
import argparse, base64, contextlib, http.server, json, math, os, pathlib, random, re, shutil, signal, socket, struct, subprocess, sys, tempfile
import resource, threading, time, urllib.error, urllib.request

ROOT = pathlib.Path(__file__).resolve().parents[2]
# A yaw that is unique in the text, so that a scenario can find it.
GRAPH = """// A vase on a table; this comment and its layout must survive every edit.
Graph(
    version: 1,
    scene: (up: "+z", metres_per_unit: 1.0, seed: 7),
    nodes: (
        demo:   DemoScene(place: Room, splats: 5000, width_px: 160, height_px: 120, truth_width_px: 32),
        pose:   Pose(translation: (-0.02, -0.06, 0.44), yaw_deg: -24.0, scale: 1.2),   // the object
        placed: Place(object: "demo.object", pose: "pose"),
        probe:  CubeRig(at: "pose", height_metres: 0.3, size_px: 64),
        faces:  SplatRender(splats: "demo.splats", rig: "probe"),
        pano:   Stitch(views: "faces", width_px: 256),
        dark:   PredictExposure(pano: "pano", evs: [-6.0, -3.0], method: Region),
        env:    FuseHdr(base: "pano", brackets: "dark"),
        view:   SplatRender(splats: "demo.splats", rig: "demo.rig"),
        trace:  PathTrace(receiver: "demo.proxy", objects: ["placed"], rig: "demo.rig", env: "env", samples: 8),
        shadow: ShadowRatio(without: "trace.without", with: "trace.with", gamma: 0.8),
        final:  Composite(background: "view", object: "trace.object", shadow: "shadow"),
        save:   WriteImage(image: "final", path: "picture.png"),
    ),
)
"""


# The same with a camera that the page can set, and few samples.
CAMERA = {"eye": (1.6, -2.4, 1.4), "target": (0.0, 0.0, 0.6), "fov": 50.0}
PLACE = GRAPH.replace("        view:   ", """        camera: Camera(eye: (1.6, -2.4, 1.4), target: (0.0, 0.0, 0.6), width_px: 160, height_px: 120, fov_y_deg: 50.0), // mine
        view:   """).replace('rig: "demo.rig"', 'rig: "camera"').replace("samples: 8", "samples: 1")
# Where the object stands in both.
FOOT = (-0.02, -0.06, 0.44)
# Only the place, with the size of its picture.
ONLY = """Graph(version: 1, scene: (up: "+z", seed: 7), nodes: (
    demo: DemoScene(splats: 5000, width_px: WIDTH, height_px: HEIGHT, truth_width_px: 32),
    view: SplatRender(splats: "demo.splats", rig: "demo.rig"%s), save: WriteImage(image: "view.colour", path: "v.png")))
"""


def free_port():
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        return s.getsockname()[1]


class Browser:
    """A session of chromedriver."""

    def __init__(self, size=(1440, 900), dark=False, webgl=True):
        self.port = free_port()
        self.driver = subprocess.Popen(["chromedriver", f"--port={self.port}"], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        # WebGL 2 in software.
        flags = ["--headless=new", "--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--disable-gpu-watchdog",
                 f"--window-size={size[0]},{size[1]}", "--disable-gpu-sandbox", "--hide-scrollbars",
                 "--host-resolver-rules=MAP rebound.test 127.0.0.1"]
        if not webgl:
            flags = [flag for flag in flags if not re.search("gl|shader", flag)] + ["--disable-gpu", "--disable-3d-apis"]
        if dark:
            flags.append("--force-dark-mode")
        options = {"args": flags, "binary": shutil.which("chromium")}
        capabilities = {"alwaysMatch": {"goog:chromeOptions": options, "goog:loggingPrefs": {"browser": "ALL"}, "timeouts": {"script": round(30000 * PATIENCE)}}}
        until(lambda: self.call("GET", "/status")["ready"], "chromedriver starts")
        self.session = self.call("POST", "/session", {"capabilities": capabilities})["sessionId"]
        # The size of the page itself, whatever the window adds.
        self.call("POST", f"/session/{self.session}/goog/cdp/execute", {"cmd": "Emulation.setDeviceMetricsOverride", "params": {
            "width": size[0], "height": size[1], "deviceScaleFactor": 1, "mobile": False}})

    def call(self, method, path, body=None):
        data = None if body is None else json.dumps(body).encode()
        request = urllib.request.Request(f"http://127.0.0.1:{self.port}{path}", data, {"Content-Type": "application/json"}, method=method)
        try:
            with urllib.request.urlopen(request, timeout=60 * PATIENCE) as response:
                return json.load(response)["value"]
        except urllib.error.HTTPError as error:
            raise RuntimeError(json.load(error)["value"]["message"]) from None

    def at(self, method, path, body=None):
        return self.call(method, f"/session/{self.session}{path}", body)

    def open(self, url):
        # A new fragment alone would not load the page.
        self.at("POST", "/url", {"url": "about:blank"})
        self.at("POST", "/url", {"url": url})

    def js(self, script, *args):
        return self.at("POST", "/execute/sync", {"script": script, "args": list(args)})

    def text(self, css):
        return self.js("return document.querySelector(arguments[0])?.textContent ?? ''", css)

    def count(self, css):
        return self.js("return document.querySelectorAll(arguments[0]).length", css)

    def click(self, css):
        self.element(css, "click", {})

    def element(self, css, action, body):
        found = self.at("POST", "/element", {"using": "css selector", "value": css})
        return self.at("POST", f"/element/{next(iter(found.values()))}/{action}", body)

    def type(self, css, text):
        """Replaces the text of a field, and presses Enter."""
        self.js("const i = document.querySelector(arguments[0]); i.focus(); i.select()", css)
        self.element(css, "value", {"text": text + "\ue007"})

    def keys(self, *keys):
        down = [{"type": "keyDown", "value": key} for key in keys]
        up = [{"type": "keyUp", "value": key} for key in reversed(keys)]
        self.at("POST", "/actions", {"actions": [{"type": "key", "id": "k", "actions": down + up}]})

    def drag(self, start, end, steps=8, hold=None):
        """Drags the pointer between two points of the page; calls `hold` before it is released."""
        move = lambda x, y, ms: {"type": "pointerMove", "duration": ms, "x": round(x), "y": round(y), "origin": "viewport"}
        path = [(start[0] + (end[0] - start[0]) * i / steps, start[1] + (end[1] - start[1]) * i / steps) for i in range(1, steps + 1)]
        act = lambda actions: self.at("POST", "/actions", {"actions": [{"type": "pointer", "id": "p", "actions": actions}]})
        act([move(*start, 0), {"type": "pointerDown", "button": 0}] + [move(x, y, 30) for x, y in path])
        if hold:
            hold()
        act([{"type": "pointerUp", "button": 0}])

    def box(self, css):
        return self.js("const b = document.querySelector(arguments[0]).getBoundingClientRect(); return [b.left, b.top, b.width, b.height]", css)

    def pixel(self, x, y):
        """The colour of the canvas at a fraction of the picture pane."""
        return self.js("""const c = document.getElementById("canvas"), gl = c.getContext("webgl2"), p = new Uint8Array(4);
            gl.readPixels(Math.floor(arguments[0] * c.width), Math.floor((1 - arguments[1]) * c.height), 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, p);
            return Array.from(p)""", x, y)

    def shot(self, path):
        # A screenshot waits for a frame at most 10 s, and a frame in software takes long while the machine does much else.
        for left in range(4, -1, -1):
            try:
                path.write_bytes(base64.b64decode(self.at("GET", "/screenshot")))
                return
            except RuntimeError:
                if not left:
                    raise

    def console(self):
        """Errors of the console since the last call."""
        return [entry["message"] for entry in self.at("POST", "/se/log", {"type": "browser"}) if entry["level"] == "SEVERE"]

    def close(self):
        with contextlib.suppress(Exception):
            self.at("DELETE", "")
        self.driver.kill()
        self.driver.wait()


class Firefox(Browser):
    """The same in Firefox, without geckodriver: commands go over Marionette, the protocol that geckodriver speaks to it."""

    # Marionette's name of each command of WebDriver that is used here.
    COMMANDS = {"/url": "Navigate", "/execute/sync": "ExecuteScript", "/execute/async": "ExecuteAsyncScript", "/element": "FindElement",
                "/actions": "PerformActions", "/screenshot": "TakeScreenshot"}

    def __init__(self, size=(1440, 900)):
        self.port, self.number, self.profile = free_port(), 0, tempfile.TemporaryDirectory()
        # WebGL in software needs a display.
        read, write = os.pipe()
        self.screen = subprocess.Popen(["Xvfb", "-displayfd", str(write), "-screen", "0", "1600x1000x24"], pass_fds=[write], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        os.close(write)
        with os.fdopen(read) as display:
            environment = {**os.environ, "DISPLAY": f":{display.readline().strip()}"}
        prefs = {"marionette.port": self.port, "webgl.force-enabled": True, "webgl.disabled": False, "browser.shell.checkDefaultBrowser": False,
                 "datareporting.policy.dataSubmissionEnabled": False, "app.update.enabled": False, "network.captive-portal-service.enabled": False}
        lines = "".join(f"user_pref({json.dumps(name)}, {json.dumps(value)});\n" for name, value in prefs.items())
        (pathlib.Path(self.profile.name) / "user.js").write_text(lines)
        command = ["firefox-esr", "--headless", "--marionette", "--no-remote", "--profile", self.profile.name, "--window-size", f"{size[0]},{size[1]}"]
        self.driver = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, env=environment)
        self.socket = None
        until(self.connect, "Firefox starts", 60)
        self.command("WebDriver:NewSession", {})
        for _ in range(2):
            inner = self.js("return [innerWidth, innerHeight, outerWidth, outerHeight]")
            self.command("WebDriver:SetWindowRect", {"width": size[0] + inner[2] - inner[0], "height": size[1] + inner[3] - inner[1]})

    def connect(self):
        self.socket = socket.create_connection(("127.0.0.1", self.port), 60)
        self.receive()
        return True

    def receive(self):
        """A message: the length of its text, a colon, the text."""
        length = b""
        while not length.endswith(b":"):
            length += self.socket.recv(1) or b":"
        text, left = b"", int(length[:-1])
        while len(text) < left:
            text += self.socket.recv(left - len(text))
        return json.loads(text)

    def command(self, name, body):
        self.number += 1
        text = json.dumps([0, self.number, name, body]).encode()
        self.socket.sendall(str(len(text)).encode() + b":" + text)
        _, _, error, result = self.receive()
        if error:
            raise RuntimeError(error["message"])
        return result["value"] if isinstance(result, dict) and set(result) == {"value"} else result

    def at(self, method, path, body=None):
        element = re.fullmatch(r"/element/([^/]+)/(click|value)", path)
        if element:
            name = {"click": "WebDriver:ElementClick", "value": "WebDriver:ElementSendKeys"}[element[2]]
            return self.command(name, {"id": element[1], **body})
        if path == "/se/log":
            return []
        if path == "/screenshot":
            body = {"full": False}
        return self.command(f"WebDriver:{self.COMMANDS[path]}", body)

    def close(self):
        with contextlib.suppress(Exception):
            self.socket.close()
        for process in (self.driver, self.screen):
            process.kill()
            process.wait()
        self.profile.cleanup()


class Place:
    """A folder with a graph, and a watch of it that serves the page."""

    def __init__(self, program, graph=GRAPH, files=None):
        self.folder = tempfile.TemporaryDirectory()
        self.path = pathlib.Path(self.folder.name)
        self.program, self.graph = program, self.path / "graph.ron"
        for name, content in (files or {}).items():
            (self.path / name).write_bytes(content)
        self.watched = "graph.ron" if graph else next(iter(files))
        if graph:
            self.write(graph)
        self.start()

    def start(self):
        command = [self.program, "watch", self.watched, "--serve", "--json", "--cache", "cache"]
        # Python ignores the signal of a file that is too long; so does the watch, which then gets an error of writing.
        self.watch = subprocess.Popen(command, cwd=self.path, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, restore_signals=False)
        self.url = json.loads(self.watch.stdout.readline())["url"]
        self.events = []
        threading.Thread(target=self.follow, args=(self.watch, self.events), daemon=True).start()

    @staticmethod
    def follow(watch, events):
        for line in watch.stdout:
            events.append(json.loads(line))

    def idle(self):
        until(lambda: self.events and self.events[-1]["event"] in ("idle", "same"), "the watch is idle", 120)

    def write(self, text):
        (self.path / "new").write_bytes(text.encode())
        (self.path / "new").replace(self.graph)

    def text(self):
        return self.graph.read_bytes().decode()

    def memory(self):
        status = pathlib.Path(f"/proc/{self.watch.pid}/status").read_text()
        return int(re.search(r"VmRSS:\s+(\d+)", status)[1]) / 1024

    def stop(self, how=signal.SIGKILL):
        self.watch.send_signal(how)
        self.watch.wait()


# Factor of the times that the scenarios wait, for a machine that does much else.
PATIENCE = float(os.environ.get("LIGHTHARMONY_PATIENCE", "1"))


def until(good, what, seconds=20):
    """Waits until `good()` is true; returns the seconds that it took. `what` is a text, or gives one at the end."""
    begin, seconds = time.monotonic(), seconds * PATIENCE
    while True:
        try:
            if good():
                return time.monotonic() - begin
        except (OSError, KeyError, RuntimeError):
            pass
        if time.monotonic() - begin > seconds:
            raise AssertionError(f"not within {seconds} s: {what() if callable(what) else what}")
        time.sleep(0.01)


# Limits of the times that users notice most, in seconds, on a machine that does nothing else: until the page is usable, from a
# move of a slider to the first preview, and from a save in an editor to the new text on the page.
USABLE, PREVIEW, FOLLOWS = 1.0, 0.7, 0.5


def middle(times):
    return sorted(times)[len(times) // 2]


def show(times):
    return ", ".join(f"{one:.2f}" for one in times)


def allowance():
    """By how much the limits of times are multiplied: 1 on an idle machine; on a loaded one, twice the ratio of wall time to CPU
    time of a busy loop."""
    wall, cpu = time.monotonic(), time.process_time()
    while time.process_time() - cpu < 0.2:
        pass
    ratio = (time.monotonic() - wall) / 0.2
    return 1.0 if ratio < 1.1 else 2 * ratio


def check(good, what):
    if not good:
        raise AssertionError(what)


def ready(b):
    """Waits until the page shows the end of a run."""
    until(lambda: "up to date" in b.text("#status"), "the page is up to date", 120)


def choose(b, node):
    b.js("for (const g of document.querySelectorAll('g.node')) if (g.querySelector('text').textContent === arguments[0]) g.dispatchEvent(new MouseEvent('click'))", node)
    until(lambda: b.text("#node h2").startswith(f"{node}:"), f"{node} is chosen")


# ---- scenarios; each gets a browser with the page open, and the place


def opens(b, p):
    """The page shows the graph, the states and the picture, and forgets the token."""
    check("#" not in b.js("return location.href"), "the token is not in the address any more")
    ready(b)
    check(b.count("g.node") == 13, f"13 nodes are drawn, not {b.count('g.node')}")
    check(b.count("g.node.failed") == 0, "nothing failed")
    until(lambda: b.pixel(0.5, 0.5)[3] == 255, "the picture is drawn")
    colours = {tuple(b.pixel(x / 8, y / 8)) for x in range(2, 7) for y in range(2, 7)}
    check(len(colours) > 8, "the picture has content")
    check(b.text("#written").endswith("picture.png"), f"its file is named: {b.text('#written')}")


def edits(b, p):
    """A value typed on the page changes exactly its bytes, and the picture follows."""
    ready(b)
    before = p.text()
    choose(b, "pose")
    b.type('[aria-label="yaw_deg as text"]', "35.5")
    until(lambda: p.text() == before.replace("-24.0", "35.5"), "the bytes of the value and nothing else")
    ready(b)
    b.keys("\ue009", "z")
    until(lambda: p.text() == before, "Ctrl+Z restores the bytes")
    b.keys("\ue009", "\ue008", "z")
    until(lambda: "35.5" in p.text(), "Ctrl+Shift+Z makes the edit again")
    until(lambda: not b.js("return document.getElementById('undo').disabled"), "undo is offered")
    b.click("#undo")
    until(lambda: p.text() == before, "the button restores the bytes")


def drags(b, p):
    """A slider is tried while it is dragged and written once at its end."""
    ready(b)
    p.idle()
    before = p.text()
    choose(b, "pose")
    slider = '[data-field="yaw_deg"] input[type="range"]'
    x, y, w, h = b.box(slider)
    first = len(p.events)
    begin = time.monotonic()
    took = {}

    def hold():
        check(p.text() == before, "nothing is written during the drag")
        until(lambda: "trying a value" in b.text("#status"), "the value is tried")
        until(lambda: any(e["event"] == "file" for e in p.events[first:]), "a preview during the drag")
        took["preview"] = time.monotonic() - begin

    b.drag((x + w * 0.43, y + h / 2), (x + w * 0.7, y + h / 2), hold=hold)
    until(lambda: p.text() != before, "the value is written at the end")
    value = re.search(r"yaw_deg: ([-\d.]+)", p.text())[1]
    check(p.text() == before.replace("-24.0", value), "only the bytes of the value differ")
    check(20 < float(value) < 120, f"the value follows the pointer: {value}")
    ready(b)
    check("trying" not in b.text("#status"), "nothing is tried any more")
    print(f"    first preview {took['preview']:.2f} s after the start of a drag of 0.25 s")


def follows(b, p):
    """The page follows a save in an editor in under half a second."""
    ready(b)
    b.click("#tab-text")
    took = []
    for gamma in ("0.55", "0.6", "0.65"):
        begin = time.monotonic()
        p.write(GRAPH.replace("gamma: 0.8", f"gamma: {gamma}"))
        until(lambda: f"gamma: {gamma}" in b.text("#text"), "the text follows")
        took.append(time.monotonic() - begin)
        ready(b)
    print(f"    {show(took)} s after a save")
    check(max(took) < FOLLOWS, f"{show(took)} s after a save, limit {FOLLOWS} s")
    b.click("#tab-graph")


def conflicts(b, p):
    """Two editors at once: the stale edit is refused, and neither loses anything."""
    ready(b)
    choose(b, "pose")
    # The page does not hear of the save before its edit arrives.
    b.js("window.stop = new Promise((go) => { window.go = go; }); const f = fetch; window.fetch = async (...a) => { if (a[0] === '/set') await window.stop; return f(...a); }")
    b.js("""const i = document.querySelector('[aria-label="scale as text"]'); i.value = '2.5'; i.dispatchEvent(new Event('change'))""")
    theirs = p.text().replace("seed: 7", "seed: 8")
    p.write(theirs)
    time.sleep(0.1)
    b.js("window.go()")
    until(lambda: "another program" in b.text("#notice").lower(), "the conflict is named")
    check(p.text() == theirs, "the other program's text is untouched")
    ready(b)
    b.type('[aria-label="scale as text"]', "2.5")
    until(lambda: p.text() == theirs.replace("scale: 1.2", "scale: 2.5"), "the edit can be made again")
    # Undo reaches back over the other program's change.
    for expected in (theirs, theirs.replace("seed: 8", "seed: 7")):
        until(lambda: not b.js("return document.getElementById('undo').disabled"), "undo is offered")
        until(lambda: b.js("return document.getElementById('status').textContent") != "", "it answers")
        b.click("#undo")
        until(lambda: p.text() == expected, "undo")


def mistakes(b, p):
    """A mistake is shown at its place in the text, and the last good picture stays."""
    ready(b)
    until(lambda: b.pixel(0.5, 0.5)[3] == 255, "the first picture is drawn")
    good = p.text()
    p.write(good.replace("yaw_deg", "yaw_dge"))
    until(lambda: "did you mean `yaw_deg`?" in b.text("#mistakes"), "the mistake is listed")
    b.js("document.querySelector('#mistakes button').click()")
    until(lambda: b.text("#text mark") == "yaw_dge", "it is underlined in the text")
    check(b.pixel(0.5, 0.5)[3] == 255, "the last picture stays")
    p.graph.unlink()
    until(lambda: "cannot read the graph" in b.text("#mistakes"), "a deleted graph is named")
    p.write(good)
    until(lambda: b.text("#mistakes") == "", "the mistake is gone")
    ready(b)
    b.click("#tab-graph")


def pictures(b, p):
    """Exposure, tone curve, read-out, layers, and zoom change what is drawn."""
    ready(b)
    b.js("const s = document.getElementById('output'); s.value = 'env.env'; s.dispatchEvent(new Event('change'))")
    until(lambda: b.js("return document.getElementById('output').value") == "env.env", "the environment is chosen")
    until(lambda: b.pixel(0.5, 0.5)[3] == 255, "it is drawn")
    time.sleep(0.3)
    at = lambda: b.pixel(0.5, 0.45)[:3]
    plain = at()
    until(lambda: b.count("#marks circle:not(.edge)") >= 1, "the lights are marked")
    check("irradiance on a plane that faces it" in b.text("#marks circle title"), "with their strength")
    b.click("#lights")
    b.click("#sphere")
    x, y, w, h = b.box("#view")
    # Not in the middle, which is between two pixels.
    start = x + w / 2 + 9, y + h / 2 + 7
    b.at("POST", "/actions", {"actions": [{"type": "pointer", "id": "p", "actions": [{"type": "pointerMove", "x": round(start[0]), "y": round(start[1]), "origin": "viewport"}]}]})
    until(lambda: b.text("#pixel").startswith("("), "there is a read-out")
    time.sleep(0.3)
    grabbed = b.text("#pixel")
    b.drag(start, (start[0] + 150, start[1] + 80))
    until(lambda: at() != plain, "the panorama is looked at from inside")
    # What is under the pointer follows it.
    until(lambda: b.text("#pixel") == grabbed, lambda: f"read-out: {b.text('#pixel')}, not {grabbed}")
    b.click("#sphere")
    until(lambda: at() == plain, "and flat again")
    exposure = lambda v: b.js("const e = document.getElementById('exposure'); e.value = arguments[0]; e.dispatchEvent(new Event('input'))", v)
    exposure(-3)
    until(lambda: sum(at()) < sum(plain), "a lower exposure is darker")
    exposure(0)
    b.js("const c = document.getElementById('curve'); c.value = '2'; c.dispatchEvent(new Event('input'))")
    until(lambda: at() != plain, "false colour")
    b.js("const c = document.getElementById('curve'); c.value = '0'; c.dispatchEvent(new Event('input'))")
    x, y, w, h = b.box("#view")
    b.at("POST", "/actions", {"actions": [{"type": "pointer", "id": "p", "actions": [{"type": "pointerMove", "x": round(x + w / 2), "y": round(y + h / 2), "origin": "viewport"}]}]})
    until(lambda: re.match(r"\(\d+, \d+\)   A [\d.]+  [\d.]+  [\d.]+$", b.text("#pixel")), f"read-out: {b.text('#pixel')}")
    b.js("const s = document.getElementById('output'); s.value = 'view.views'; s.dispatchEvent(new Event('change'))")
    until(lambda: b.count("#layer option") == 2, "a view has colour and depth")
    b.js("const s = document.getElementById('layer'); s.value = '1'; s.dispatchEvent(new Event('change'))")
    until(lambda: len(set(b.pixel(0.5, 0.5)[:3])) == 1, "depth is grey")
    b.click("#whole")
    b.click("#fit")


def compares(b, p):
    """A and B: the slider, the flip key, the difference, against the history."""
    ready(b)
    choose(b, "shadow")
    b.type('[aria-label="gamma as text"]', "0.2")
    until(lambda: "gamma: 0.2" in p.text(), "the edit")
    ready(b)
    b.js("const s = document.getElementById('output'); s.value = 'final.image'; s.dispatchEvent(new Event('change'))")
    until(lambda: b.count("#other optgroup[label=History] option") >= 2, "the history is offered")
    b.js("const s = document.getElementById('other'); s.value = [...s.querySelectorAll('optgroup[label=History] option')].at(-1).value; s.dispatchEvent(new Event('change'))")
    until(lambda: b.js("return !document.getElementById('split').hidden"), "the slider is there")
    grid = [(x / 12, y / 12) for x in range(1, 12) for y in range(1, 12)]
    colours = lambda: [tuple(b.pixel(*at)) for at in grid]
    b.js("document.getElementById('view').focus()")
    b.keys("f")
    until(lambda: b.js("return document.getElementById('mode').value") == "2", "the key shows B")
    second = colours()
    b.keys("f")
    until(lambda: b.js("return document.getElementById('mode').value") == "0", "the key shows A")
    check(colours() != second, "A and B differ")
    b.keys("d")
    until(lambda: b.js("return document.getElementById('mode').value") == "3", "difference")
    check(any(sum(c[:3]) > 0 for c in colours()), "the difference is not black")
    until(lambda: b.text("#measures").startswith("A against B: FLIP 0."), f"the measures: {b.text('#measures')}")
    b.keys("l")
    until(lambda: b.js("return document.getElementById('mode').value") == "4", "FLIP")
    check(any(sum(c[:3]) > 0 for c in colours()), "FLIP is not black")
    # The page's own picture as a file: it differs from the result only by its encoding in 8 bits.
    png = b.at("POST", "/execute/async", {"script": """const done = arguments[0]; (async () => {
        const state = await new Promise((go) => { const e = new EventSource('/events'); e.onmessage = (m) => { const d = JSON.parse(m.data); if (d.event === 'state') { e.close(); go(d); } }; });
        const digest = state.nodes.final.outputs.find((one) => one.port === 'image').digest;
        const bytes = new Uint8Array(await (await fetch(`/value/${digest}/0.png`)).arrayBuffer());
        done(btoa(Array.from(bytes, (byte) => String.fromCharCode(byte)).join(''))); })()""", "args": []})
    (p.path / "truth.png").write_bytes(base64.b64decode(png))
    b.js("document.getElementById('other').dispatchEvent(new PointerEvent('pointerenter'))")
    until(lambda: "truth.png" in b.text("#other optgroup[label=Files]"), "the file is offered")
    b.js("const s = document.getElementById('other'); s.value = [...s.querySelectorAll('optgroup[label=Files] option')].find((o) => o.textContent === 'truth.png').value; s.dispatchEvent(new Event('change'))")
    until(lambda: b.text("#label-b") == "B: truth.png" and b.text("#measures").startswith("A against B: FLIP 0 "), f"equal to the file: {b.text('#measures')}")
    b.js("const s = document.getElementById('other'); s.value = [...s.querySelectorAll('optgroup[label=History] option')].at(-1).value; s.dispatchEvent(new Event('change'))")
    b.keys("s")
    until(lambda: b.js("return !document.getElementById('split').hidden"), "the slider is back")
    x, y, w, h = b.box("#split")
    b.drag((x + w / 2, y + h / 2), (x - 150, y + h / 2))
    check(b.box("#split")[0] < x - 100, "the slider moves")


def restarts(b, p):
    """The server is killed and started again: the page reconnects by itself, and undo still works."""
    ready(b)
    before = p.text()
    choose(b, "pose")
    b.type('[aria-label="scale as text"]', "1.75")
    until(lambda: "1.75" in p.text(), "the edit")
    ready(b)
    url = p.url
    p.stop()
    until(lambda: "not connected" in b.text("#status"), "the loss is named")
    b.console()
    p.start()
    check(p.url == url, "the address is the same")
    until(lambda: "not connected" not in b.text("#status"), "the page reconnects", 30)
    check("did not answer" not in b.text("#notice"), f"no notice is left: {b.text('#notice')}")
    b.console()
    ready(b)
    b.click("#undo")
    until(lambda: p.text() == before, "the edit of before the restart is undone")


def refuses(b, p):
    """A page of another origin, and a host name rebound to this machine, get nothing."""
    ready(b)
    before = p.text()
    port = int(re.search(r":(\d+)/", p.url)[1])
    attack = b"<!doctype html><title>attack</title>"

    class Site(http.server.BaseHTTPRequestHandler):
        def do_GET(self):
            self.send_response(200)
            self.send_header("Content-Type", "text/html")
            self.end_headers()
            self.wfile.write(attack)

        def log_message(self, *_):
            pass

    site = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Site)
    threading.Thread(target=site.serve_forever, daemon=True).start()
    script = """const done = arguments[1]; (async () => { const out = {}; const base = arguments[0];
        for (const [name, url, init] of [
            ['read', '/graph', {credentials: 'include'}],
            ['simple', '/set', {method: 'POST', credentials: 'include', body: '{}'}],
            ['blind', '/set', {method: 'POST', mode: 'no-cors', credentials: 'include', body: '{}'}],
            ['header', '/set', {method: 'POST', credentials: 'include', headers: {'X-Lightharmony': '1', 'Content-Type': 'application/json'}, body: '{}'}],
        ]) { try { const r = await fetch(base + url, init); out[name] = [r.type, r.status]; } catch { out[name] = 'refused'; } }
        out.image = await new Promise((go) => { const i = new Image(); i.onload = () => go('loaded'); i.onerror = () => go('refused'); i.src = base + '/value/' + '0'.repeat(64) + '/0.png'; });
        out.frame = await new Promise((go) => { const f = document.createElement('iframe'); f.onload = () => { try { go(f.contentDocument?.body?.textContent ? 'read' : 'refused'); } catch { go('refused'); } }; f.src = base + '/'; document.body.append(f); });
        done(out); })()"""
    attempt = lambda base: b.at("POST", "/execute/async", {"script": script, "args": [base]})
    for origin in (f"http://localhost:{site.server_port}", f"http://127.0.0.1:{site.server_port}"):
        b.at("POST", "/url", {"url": origin})
        found = attempt(f"http://127.0.0.1:{port}")
        check(found["read"] == found["simple"] == found["header"] == found["image"] == found["frame"] == "refused", f"{origin}: {found}")
    # DNS rebinding: the name of the attacker now leads to this machine.
    b.at("POST", "/url", {"url": f"http://rebound.test:{port}/"})
    check("this server answers only requests to its own local address" in b.text("body"), "a rebound host is refused")
    site.shutdown()
    check(p.text() == before, "nothing was written")
    b.console()
    b.open(p.url)
    ready(b)


# ---- the place view


class Lens:
    """The view of the page through `camera` of PLACE: where points of the world are on the screen."""

    def __init__(self, b):
        sub = lambda a, b: [x - y for x, y in zip(a, b)]
        unit = lambda a: [x / math.sqrt(sum(y * y for y in a)) for x in a]
        cross = lambda a, b: [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
        forward = unit(sub(CAMERA["target"], CAMERA["eye"]))
        right = unit(cross(forward, (0, 0, 1)))
        self.axes = right, cross(forward, right), forward
        x, y, w, h = b.box("#space")
        self.focal = min(w / 160, h / 120) * 60 / math.tan(math.radians(CAMERA["fov"] / 2))
        self.middle = x + w / 2, y + h / 2

    def depth(self, p):
        return sum((a - e) * f for a, e, f in zip(p, CAMERA["eye"], self.axes[2]))

    def at(self, p):
        d = [a - e for a, e in zip(p, CAMERA["eye"])]
        x, y, z = (sum(a * b for a, b in zip(d, axis)) for axis in self.axes)
        return self.middle[0] + self.focal * x / z, self.middle[1] + self.focal * y / z


def place(b, p, graph=PLACE):
    """Opens the place view of a graph, and waits until it is drawn."""
    p.write(graph)
    until(lambda: "camera" in b.text("#graph") or graph != PLACE, "the graph is there")
    time.sleep(0.2)
    p.idle()
    ready(b)
    b.click("#tab-place")
    until(lambda: "splats" in b.text("#splat-count"), "the splats are there")
    until(lambda: solid(b, 0.5, 0.5)[3] > 200, "the place is drawn")
    until(lambda: b.js("return document.getElementById('place-view').value") != "", "the view is that of a camera")


def solid(b, x, y):
    """The colour of the place view at a fraction of its pane."""
    # `readPixels` gives 0 after a screenshot.
    return b.js("""const c = document.getElementById("solid"), copy = Object.assign(document.createElement("canvas"), { width: 1, height: 1 });
        const pen = copy.getContext("2d", { willReadFrequently: true });
        pen.drawImage(c, Math.floor(arguments[0] * c.width), Math.floor(arguments[1] * c.height), 1, 1, 0, 0, 1, 1);
        return Array.from(pen.getImageData(0, 0, 1, 1).data)""", x, y)


def pose(p):
    """Translation, yaw and scale in the text."""
    found = re.search(r"pose: +Pose\(translation: \(([^)]*)\), yaw_deg: ([-\d.]+), scale: ([-\d.]+)\)", p.text())
    return tuple(float(v) for v in found[1].split(",")), float(found[2]), float(found[3])


def only_pose_differs(before, after):
    check(re.sub(r"Pose\([^\n]*?scale: [-\d.]+\)", "", before) == re.sub(r"Pose\([^\n]*?scale: [-\d.]+\)", "", after), "only the pose differs")


def take_back(b, p, text):
    """Undoes the last edit."""
    until(lambda: not b.js("return document.getElementById('undo').disabled"), "undo is offered")
    b.click("#undo")
    until(lambda: p.text() == text, "undo restores the bytes")
    ready(b)
    p.idle()
    # The view has the old pose again.
    until(lambda: "(-0.02, -0.06, 0.44)" in b.text("#place-position"), "the object is back")


def moves(b, p):
    """The object is dragged over the ground: previews run, and one edit is written at the end."""
    place(b, p)
    before, lens, first = p.text(), Lens(b), len(p.events)
    took = {}

    def hold():
        check(p.text() == before, "nothing is written during the drag")
        until(lambda: "trying a value" in b.text("#status"), "the pose is tried")
        until(lambda: any(e["event"] == "file" for e in p.events[first:]), "a preview during the drag")
        took["preview"] = time.monotonic() - begin

    grip, goal = lens.at((-0.12, -0.06, 0.62)), lens.at((-0.35, -0.1, 0.62))
    begin = time.monotonic()
    b.drag(grip, goal, hold=hold)
    until(lambda: p.text() != before, "the pose is written at the end")
    (x, y, z), yaw, scale = pose(p)
    check((yaw, scale) == (-24.0, 1.2), "only the translation changes")
    check(-0.4 < x < -0.12 and abs(z - 0.44) < 0.02, f"it stands on the table: {x, y, z}")
    only_pose_differs(before, p.text())
    ready(b)
    until(lambda: f"placed at ({x:g}, {y:g}, {z:g})" in b.text("#place-position"), "the view has the new pose")
    print(f"    first preview {took['preview']:.2f} s after the start of a drag of 0.25 s")
    take_back(b, p, before)
    # Escape leaves the text as it is.
    b.drag(grip, goal, hold=lambda: b.keys("\ue00c"))
    until(lambda: "trying" not in b.text("#status"), "nothing is tried any more")
    check(p.text() == before, "Escape writes nothing")


def turns(b, p):
    """The gizmo and the keys: turn, scale, lift and step, each one edit of one field."""
    place(b, p)
    before, lens = p.text(), Lens(b)
    (cx, cy), reach = lens.at(FOOT), 60 * lens.depth(FOOT) / lens.focal
    b.drag(lens.at((FOOT[0] - reach, FOOT[1], FOOT[2])), lens.at((FOOT[0], FOOT[1] - reach, FOOT[2])))
    until(lambda: p.text() != before, "the yaw is written")
    check(abs(pose(p)[1] - 66) < 2 and p.text() == before.replace("-24.0", re.search(r"yaw_deg: ([-\d.]+)", p.text())[1]), f"a quarter turn: {pose(p)}")
    take_back(b, p, before)
    b.drag((cx + 73.5, cy - 73.5), (cx + 147, cy - 147))
    until(lambda: p.text() != before, "the scale is written")
    check(abs(pose(p)[2] - 2.4) < 0.1, f"twice as large: {pose(p)}")
    only_pose_differs(before, p.text())
    take_back(b, p, before)
    b.drag((cx, cy - 60), (cx, cy - 110))
    until(lambda: p.text() != before, "the height is written")
    (x, y, z), yaw, scale = pose(p)
    check((x, y, yaw, scale) == (-0.02, -0.06, -24.0, 1.2) and 0.55 < z < 0.8, f"lifted: {pose(p)}")
    ready(b)
    p.idle()
    lifted = p.text()
    b.click("#place-drop")
    until(lambda: p.text() != lifted, "it is put on the ground")
    check(abs(pose(p)[0][2] - 0.44) < 0.01, f"on the table: {pose(p)}")
    ready(b)
    p.idle()
    dropped = p.text()
    b.js("document.getElementById('space').focus()")
    for key in ("\ue014", "\ue014", "."):
        b.keys(key)
    # Keys that follow each other within a moment are one edit; on a busy machine they are several.
    stepped = lambda: (round(pose(p)[0][0], 4), pose(p)[1]) == (0.0, -29.0)
    until(stepped, lambda: f"two steps and a turn: {pose(p)}")
    only_pose_differs(before, p.text())


def stands(b, p):
    """A click puts the object on the ground, and not on a wall."""
    place(b, p)
    before, lens = p.text(), Lens(b)
    b.click("#place-click")
    click(b, *lens.at((0.4, 2.2, 1.2)))
    until(lambda: "too steep to stand on" in b.text("#space-note"), f"a wall is refused: {b.text('#space-note')}")
    check(p.text() == before, "nothing is written")
    click(b, *lens.at((0.95, -0.55, 0.0)))
    until(lambda: p.text() != before, "the pose is written")
    (x, y, z), yaw, scale = pose(p)
    check(abs(x - 0.95) < 0.2 and abs(y + 0.55) < 0.2 and abs(z) < 0.05, f"on the floor: {x, y, z}")
    only_pose_differs(before, p.text())
    ready(b)


def click(b, x, y):
    b.at("POST", "/actions", {"actions": [{"type": "pointer", "id": "p", "actions": [
        {"type": "pointerMove", "duration": 0, "x": round(x), "y": round(y), "origin": "viewport"}, {"type": "pointerDown", "button": 0}, {"type": "pointerUp", "button": 0}]}]})


def measures(b, p):
    """Two clicks measure a distance, and its true length sets the scale of the place."""
    place(b, p)
    before, lens = p.text(), Lens(b)
    b.click("#place-measure")
    ends = (0.95, -0.55, 0.0), (0.95, -1.05, 0.0)
    for end in ends:
        note = b.text("#space-note")
        click(b, *lens.at(end))
        until(lambda: b.text("#space-note") != note, "the click is answered")
    until(lambda: b.js("return !document.getElementById('ruler').hidden"), "the distance is shown")
    length = float(b.js("return document.getElementById('ruler-length').value"))
    check(abs(length - math.dist(*ends)) < 0.1, f"the distance: {length}")
    b.type("#ruler-length", str(2 * length))
    until(lambda: p.text() != before, "the scale is written")
    scale = re.search(r"metres_per_unit: ([\d.]+)", p.text())[1]
    check(abs(float(scale) - 2) < 0.002 and p.text() == before.replace("metres_per_unit: 1.0", f"metres_per_unit: {scale}"), f"only the scale: {scale}")
    until(lambda: b.js("return document.getElementById('ruler').hidden"), "the panel is gone")
    ready(b)


def looks_through(b, p):
    """The view is moved, the camera of the graph follows by one edit, and the picture lies over its view."""
    place(b, p)
    before = p.text()
    x, y, w, h = b.box("#space")
    check(b.js("return document.getElementById('place-set').disabled"), "there is nothing to set")
    b.drag((x + 60, y + 60), (x + 130, y + 40))
    until(lambda: not b.js("return document.getElementById('place-set').disabled"), "the camera can be set")
    b.click("#place-set")
    until(lambda: p.text() != before, "the camera is written")
    found = re.search(r"camera: Camera\(eye: \(([^)]*)\), target: \(([^)]*)\), (.*)", p.text())
    eye = [float(v) for v in found[1].split(",")]
    distance = lambda e: math.dist(e, FOOT)
    check(0.8 < distance(eye) / distance(CAMERA["eye"]) < 1.25 and math.dist(eye, CAMERA["eye"]) > 0.3, f"it went around the object: {eye}")
    check(found[3] == "width_px: 160, height_px: 120, fov_y_deg: 50.0), // mine", "the rest of the line stays")
    ready(b)
    until(lambda: b.js("return document.getElementById('place-set').disabled"), "the view is that of the camera")
    b.js("document.getElementById('space').focus()")
    b.keys("o")
    until(lambda: b.js("return !document.getElementById('onion').hidden && document.getElementById('onion').naturalWidth") == 160, "the picture lies over the view")
    b.keys("o")
    until(lambda: b.js("return document.getElementById('onion').hidden"), "and is gone")
    take = b.box("#space")
    check(take[2:] == [w, h], f"the pane keeps its size: {take}")
    until(lambda: not b.js("return document.getElementById('undo').disabled"), "undo is offered")
    b.click("#undo")
    until(lambda: p.text() == before, "one undo takes all back")
    b.js("document.getElementById('place-all').click()")
    until(lambda: b.js("return document.getElementById('place-view').value") == "", "from above")


def scrubs(b, p):
    """A graph with an axis: a slider chooses the instance, in the picture and in the place."""
    graph = GRAPH.replace("    nodes: (", "    axes: (turn: List([0.0, 40.0, 80.0])),\n    nodes: (", 1).replace("yaw_deg: -24.0", 'yaw_deg: Axis("turn")')
    place(b, p, graph.replace("picture.png", "p-{turn}.png").replace("samples: 8", "samples: 1"))
    check("placed/turn=0.0 at" in b.text("#place-position"), f"the first instance: {b.text('#place-position')}")
    b.click("#tab-picture")
    b.js("const a = document.getElementById('axis'); a.value = 2; a.dispatchEvent(new Event('input'))")
    until(lambda: b.js("return document.getElementById('output').value") == "final/turn=80.0.image", "the picture at 80 degrees")
    b.click("#tab-place")
    until(lambda: "placed/turn=80.0 at" in b.text("#place-position"), "the object at 80 degrees")


TWO = PLACE.replace("        probe:  ", """        second: Pose(translation: (0.3, -0.3, 0.44), yaw_deg: 10.0, scale: 0.6),
        other:  Place(object: "demo.object", pose: "second"),
        probe:  """).replace('["placed"]', '["placed", "other"]')


def chooses(b, p):
    """Of two objects, the one that is clicked, or chosen by a key, is moved."""
    place(b, p, TWO)
    until(lambda: b.js("return !document.getElementById('place-object-label').hidden"), "the objects are offered")
    name = lambda: b.js("const s = document.getElementById('place-object'); return s.options[s.selectedIndex].textContent")
    lens, before = Lens(b), p.text()
    first = name()
    other = {"placed": "other", "other": "placed"}[first]
    click(b, *lens.at((0.3, -0.3, 0.44) if other == "other" else FOOT))
    until(lambda: name() == other, f"the other object is chosen: {name()}")
    until(lambda: b.text("#place-position").startswith(f"{other} at"), "its place is shown")
    line = {"placed": "pose: ", "other": "second: "}
    for chosen, key in ((other, None), (first, "n")):
        if key:
            b.keys(key)
            until(lambda: name() == chosen, "the key chooses the next object")
        text = p.text()
        b.js("document.getElementById('space').focus()")
        b.keys("\ue014")
        until(lambda: p.text() != text, "the step is written")
        changed = [new for old, new in zip(text.split("\n"), p.text().split("\n")) if old != new]
        check(len(changed) == 1 and line[chosen] in changed[0], f"only {chosen} moves: {changed}")
        ready(b)
        p.idle()
    check(p.text() != before, "both have moved")


def keys(b, p):
    """Keys of `Track` on a timeline: a number that is edited between keys becomes a key, and can be removed."""
    graph = GRAPH.replace("    nodes: (", "    axes: (frame: Range(0, 4)),\n    nodes: (", 1).replace("yaw_deg: -24.0", 'yaw_deg: Track("frame", [(0, -24.0), (3, 66.0)])')
    graph = graph.replace("picture.png", "p-{frame}.png").replace("samples: 8", "samples: 1")
    place(b, p, graph)
    b.click("#tab-picture")
    choose(b, "pose/frame=0")
    check(b.count('[data-field="yaw_deg"] .key') == 2, "two keys are drawn")
    b.js("const a = document.getElementById('axis'); a.value = 1; a.dispatchEvent(new Event('input'))")
    until(lambda: b.text("#node h2") == "pose/frame=1: Pose", "the pane follows the slider")
    check("between keys" in b.text('[data-field="yaw_deg"]'), "there is no key here")
    b.type('[aria-label="yaw_deg as text"]', "50.5")
    until(lambda: p.text() == graph.replace("(0, -24.0), (3, 66.0)", "(0, -24.0), (1, 50.5), (3, 66.0)"), f"a key is written: {p.text()}")
    until(lambda: b.count('[data-field="yaw_deg"] .key') == 3, "three keys are drawn")
    ready(b)
    p.idle()
    b.js("document.querySelector('[data-field=yaw_deg] .key.here').dispatchEvent(new KeyboardEvent('keydown', { key: 'ArrowRight', bubbles: true }))")
    until(lambda: "(0, -24.0), (2, 50.5), (3, 66.0)" in p.text(), "an arrow moves the key")
    ready(b)
    p.idle()
    b.js("document.querySelectorAll('[data-field=yaw_deg] .key')[1].dispatchEvent(new KeyboardEvent('keydown', { key: 'Delete', bubbles: true }))")
    until(lambda: p.text() == graph, "the key is removed, and the bytes are those of before")
    ready(b)
    p.idle()
    # The object is turned in the place view: a key at the place that is shown.
    b.click("#tab-place")
    until(lambda: "placed/frame=1 at" in b.text("#place-position"), "the object at frame 1")
    b.js("document.getElementById('space').focus()")
    b.keys(".")
    until(lambda: p.text() == graph.replace("(0, -24.0), (3, 66.0)", "(0, -24.0), (1, 1.0), (3, 66.0)"), f"turned by a key: {p.text()}")
    b.js("document.activeElement.blur()")


def trades(b, p):
    """The trade pane: the error of the previews, presets that are tried and written, and what was left out."""
    p.write(GRAPH.replace("width_px: 160, height_px: 120", "width_px: 240, height_px: 180").replace("samples: 8", "samples: 32"))
    time.sleep(0.2)
    p.idle()
    ready(b)
    before = p.text()
    b.click("#tab-trade")
    until(lambda: b.count("#trade-chart .point") >= 1, "the previews are compared with the result", 60)
    check("samples" in b.text("#trade-chart details"), "the numbers are there")
    until(lambda: "trace.samples" in b.text("#trade-presets"), "the parameters are there")
    until(lambda: "clipped pixels" in b.text("#trade-skips") and "surroundings" in b.text("#trade-model"), "checks and decisions are there")
    press = lambda label, index: b.js("[...document.querySelectorAll('#trade-presets button')].filter((one) => one.textContent === arguments[0])[arguments[1]].click()", label, index)
    press("Try", 0)
    until(lambda: "trying a value" in b.text("#status"), "the values of draft are tried")
    check(p.text() == before, "the text is as it was")
    until(lambda: b.count("#trade-back") == 1, "the way back is offered", 60)
    b.click("#trade-back")
    until(lambda: "trying" not in b.text("#status"), "the text counts again")
    ready(b)
    p.idle()
    until(lambda: b.count("#trade-back") == 0, "nothing is tried")
    press("Write", 0)
    until(lambda: "samples: 4" in p.text(), "the values of draft are written")
    ready(b)
    p.idle()
    until(lambda: not b.js("return document.getElementById('undo').disabled"), "undo is offered")
    b.click("#undo")
    until(lambda: p.text() == before, "one undo takes them back")
    b.click("#tab-picture")


def agrees(b, p):
    """The splats of the place view are those of `SplatRender`, pixel by pixel."""
    b.click("#tab-place")
    _, _, w, h = (round(v) for v in b.box("#space"))
    b.click("#tab-picture")
    script = """const done = arguments[0]; (async () => {
        const c = document.getElementById('solid'), gl = c.getContext('webgl2'), [w, h] = [c.width, c.height], p = new Uint8Array(w * h * 4);
        gl.readPixels(0, 0, w, h, gl.RGBA, gl.UNSIGNED_BYTE, p);
        const state = await new Promise((go) => { const e = new EventSource('/events'); e.onmessage = (m) => { const d = JSON.parse(m.data); if (d.event === 'state') { e.close(); go(d); } }; });
        const digest = state.nodes.view.outputs.find((one) => one.port === 'views').digest;
        const picture = (await (await fetch(`/value/${digest}`)).json()).pictures[0];
        if (picture.width !== w || picture.height !== h) return done(null);
        const f = new Float32Array(await (await fetch(`/value/${digest}/0.f32`)).arrayBuffer());
        let sum = 0;
        for (let y = 0; y < h; y += 1) for (let x = 0; x < w; x += 1) for (let k = 0; k < 3; k += 1) {
            sum += (p[((h - 1 - y) * w + x) * 4 + k] / 255 - Math.min(1, Math.max(0, f[(y * w + x) * 4 + k]))) ** 2; }
        done(-10 * Math.log10(sum / (w * h * 3))); })()"""
    psnr = {}
    for name, more in (("degree 0", ", sh_degree: 0"), ("all degrees", "")):
        graph = (ONLY % more).replace("WIDTH", str(w)).replace("HEIGHT", str(h))
        place(b, p, graph)
        for box in ("place-objects", "place-guides", "place-corner"):
            b.js("const c = document.getElementById(arguments[0]); if (c.checked) c.click()", box)
        until(lambda: b.js("return document.getElementById('place-view').value") == "0", "through the camera")
        until(lambda: b.at("POST", "/execute/async", {"script": script, "args": []}) is not None, "both pictures have the same size")
        time.sleep(0.5)
        psnr[name] = b.at("POST", "/execute/async", {"script": script, "args": []})
        b.click("#tab-picture")
    print(f"    {w} by {h} pixels: {psnr['degree 0']:.1f} dB at degree 0, {psnr['all degrees']:.1f} dB with all harmonics")
    check(psnr["degree 0"] > 49 and psnr["all degrees"] > 30, f"{psnr}")


def capture():
    """A small room as splats: a floor, walls and a table, z up. One unit is a metre."""
    chance = random.Random(25)
    rows = []

    def patch(corner, a, b, colour, step=0.16):
        size = [math.hypot(*side) for side in (a, b)]
        across = [max(1, round(s / step)) for s in size]
        thin = next(k for k in range(3) if a[k] == 0 and b[k] == 0)
        for i in range(across[0]):
            for j in range(across[1]):
                u, v = (i + 0.5) / across[0], (j + 0.5) / across[1]
                at = [c + u * x + v * y for c, x, y in zip(corner, a, b)]
                scale = [math.log(0.6 * step)] * 3
                scale[thin] = math.log(0.006)
                tone = 0.85 + 0.3 * chance.random()
                dc = [(c * tone - 0.5) / 0.28209479 for c in colour]
                rows.append(struct.pack("<14f", *at, *dc, 5.0, *scale, 1, 0, 0, 0))

    patch((-2, -2, 0), (4, 0, 0), (0, 4, 0), (0.55, 0.42, 0.3))
    for corner, along in (((-2, 2, 0), (4, 0, 0)), ((-2, -2, 0), (0, 4, 0)), ((2, -2, 0), (0, 4, 0)), ((-2, -2, 0), (4, 0, 0))):
        patch(corner, along, (0, 0, 2.4), (0.6, 0.68, 0.62))
    patch((0.5, 0.6, 0.7), (1, 0, 0), (0, 0.6, 0), (0.5, 0.2, 0.12), 0.1)
    for corner, along in (((0.5, 0.6, 0), (1, 0, 0)), ((0.5, 0.6, 0), (0, 0.6, 0)), ((1.5, 0.6, 0), (0, 0.6, 0)), ((0.5, 1.2, 0), (1, 0, 0))):
        patch(corner, along, (0, 0, 0.7), (0.4, 0.16, 0.1), 0.1)
    names = "x y z f_dc_0 f_dc_1 f_dc_2 opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3".split()
    head = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(rows)}\n" + "".join(f"property float {name}\n" for name in names) + "end_header\n"
    return head.encode() + b"".join(rows)


def cone():
    """An object as GLB: a red cone, half a metre high."""
    ring = [(0.18 * math.cos(k * math.pi / 12), 0.0, 0.18 * math.sin(k * math.pi / 12)) for k in range(24)]
    points = ring + [(0, 0.5, 0), (0, 0, 0)]
    faces = [f for k in range(24) for f in ((k, 24, (k + 1) % 24), (k, (k + 1) % 24, 25))]
    data = b"".join(struct.pack("<3f", *p) for p in points) + b"".join(struct.pack("<3H", *f) for f in faces)
    split = 12 * len(points)
    text = json.dumps({
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}],
        "materials": [{"pbrMetallicRoughness": {"baseColorFactor": [0.6, 0.05, 0.03, 1], "metallicFactor": 0, "roughnessFactor": 0.5}}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1, "material": 0}]}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": len(points), "type": "VEC3", "min": [-0.18, 0, -0.18], "max": [0.18, 0.5, 0.18]},
                      {"bufferView": 1, "componentType": 5123, "count": 3 * len(faces), "type": "SCALAR"}],
        "bufferViews": [{"buffer": 0, "byteLength": split}, {"buffer": 0, "byteOffset": split, "byteLength": len(data) - split}],
        "buffers": [{"byteLength": len(data)}]}).encode()
    text += b" " * (-len(text) % 4)
    data += b"\0" * (-len(data) % 4)
    chunk = lambda kind, content: struct.pack("<I4s", len(content), kind) + content
    body = chunk(b"JSON", text) + chunk(b"BIN\0", data)
    return b"glTF" + struct.pack("<II", 2, 12 + len(body)) + body


def starts(b, p):
    """From a capture and an object alone to a picture, only by the page."""
    begin = time.monotonic()
    fresh = Place(p.program, None, {"room.ply": capture(), "cone.glb": cone()})
    try:
        b.open(fresh.url)
        until(lambda: b.js("return !document.getElementById('start').hidden"), "the panel is there", 60)
        shown = time.monotonic() - begin
        check(b.js("return [...document.querySelectorAll('#start-object option')].map((o) => o.value)") == ["cone.glb"], "the object is offered")
        check(b.text("#start dd").startswith("+z, measured"), f"up was measured: {b.text('#start dd')}")
        until(lambda: solid(b, 0.5, 0.8)[3] > 200, "the capture is drawn")
        bare = fresh.text()
        check("LoadSplats" in bare and "PathTrace" not in bare, "the first graph shows the capture")
        fresh.idle()
        # The place is turned, and back by undo.
        b.js("const s = document.getElementById('start-up'); s.value = '+x'; s.dispatchEvent(new Event('change'))")
        until(lambda: "matrix: (" in fresh.text(), f"another axis points up: {b.text('#notice')}", 60)
        fresh.idle()
        until(lambda: not b.js("return document.getElementById('undo').disabled"), "undo is offered")
        b.click("#undo")
        until(lambda: fresh.text() == bare, "the capture is as it was")
        fresh.idle()
        # A scale that is set stays when the object is put there.
        until(lambda: b.js("return document.getElementById('start-up').value") == "+z", "the panel shows the old axis")
        time.sleep(0.5)
        b.type("#start-scale", "0.98")
        until(lambda: "metres_per_unit: 0.98," in fresh.text(), f"the scale is written: {b.text('#notice')}")
        fresh.idle()
        until(lambda: "set by hand" in b.text("#start"), f"and shown: {b.text('#start')}")
        scaled = fresh.text()
        b.click("#start-click")
        check(b.text("#start-click") == "Cancel" and not b.js("return document.getElementById('start-object').checkVisibility()"), "the panel does not cover the place")
        x, y, w, h = b.box("#space")
        # The first camera looks at a level surface.
        click(b, x + w * 0.5, y + h * 0.56)
        until(lambda: fresh.text() != scaled, f"the graph is written: {b.text('#space-note')} {b.text('#notice')}", 120)
        text = fresh.text()
        check("LoadObject(path: \"cone.glb\")" in text and "where you put it" in text, "it is a whole graph")
        check("metres_per_unit: 0.98," in text and "`metres_per_unit` was set by hand" in text, "with the scale that was set")
        z = float(re.search(r"pose: +Pose\(translation: \([^,]*, [^,]*, ([-\d.]+)\)", text)[1])
        check(min(abs(z), abs(z - 0.7)) < 0.05, f"the cone stands on the floor or on the table: {z}")
        until(lambda: b.js("return document.getElementById('start').hidden"), "the panel is gone")
        until(lambda: b.text("#node h2") == "pose: Pose", lambda: f"the pose of the object is shown: {b.text('#node h2')}")
        # A small picture is enough here.
        first = len(fresh.events)
        fresh.write(text.replace("width_px: 960, height_px: 540", "width_px: 192, height_px: 108"))
        until(lambda: any(e["event"] == "file" and not e.get("preview") for e in fresh.events[first:]) and fresh.events[-1]["event"] == "idle", "the picture is there", 240)
        fresh.write(text)
        print(f"    capture shown after {shown:.1f} s, picture of 192 by 108 pixels {time.monotonic() - begin:.1f} s after the start, two clicks")
        until(lambda: not b.js("return document.getElementById('undo').disabled"), "undo is offered")
        if SHOTS:
            time.sleep(1)
            b.shot(SHOTS / "starts.png")
        for expected in (text.replace("width_px: 960, height_px: 540", "width_px: 192, height_px: 108"), text):
            until(lambda: not b.js("return document.getElementById('undo').disabled"), "undo is offered")
            b.click("#undo")
            until(lambda: fresh.text() == expected, "undo of the other program's changes")
        b.click("#undo")
        until(lambda: fresh.text() == scaled, "undo goes back to the bare capture")
        until(lambda: b.js("return !document.getElementById('start').hidden"), "the panel is back")
        # Started again, it goes on with the graph that is there; another graph is not overwritten.
        b.open(p.url)
        ready(b)
        fresh.stop()
        fresh.write("Graph(version: 1, nodes: ())\n")
        again = subprocess.run([fresh.program, "watch", "room.ply", "--serve", "--json", "--cache", "cache"], cwd=fresh.path, capture_output=True, text=True, timeout=60)
        check(again.returncode == 2 and "exists already" in again.stdout, f"another graph stays: {again.stdout}")
        check(fresh.text() == "Graph(version: 1, nodes: ())\n", "it is untouched")
    finally:
        fresh.stop()


def adds(b, p):
    """Another object is added: its nodes and its wire are one edit, and undo takes all of it back."""
    (p.path / "cone.glb").write_bytes(cone())
    place(b, p)
    before, lens = p.text(), Lens(b)
    b.click("#place-add")
    until(lambda: b.text("#add-object option") == "cone.glb", "the object is offered")
    b.click("#add-click")
    click(b, *lens.at((0.95, -0.55, 0.0)))
    until(lambda: p.text() != before, f"the object is written: {b.text('#space-note')} {b.text('#notice')}")
    text = p.text()
    check('cone: LoadObject(path: "cone.glb")' in text and 'objects: ["placed", "cone_placed"]' in text, f"nodes and wire: {text}")
    added = [line for line in text.split("\n") if "cone" not in line]
    check(added == [line for line in before.replace('"placed"]', "X").split("\n") if "X" not in line], "all other lines stay")
    until(lambda: b.text("#place-position").startswith("cone_placed at (0.9"), f"it is chosen where it was put: {b.text('#place-position')}")
    ready(b)
    p.idle()
    until(lambda: not b.js("return document.getElementById('undo').disabled"), "undo is offered")
    b.click("#undo")
    until(lambda: p.text() == before, "one undo takes all of it back")
    ready(b)
    (p.path / "cone.glb").unlink()


def against(b, p):
    """A picture of another graph in the folder, from the cache, as B."""
    ready(b)
    p.idle()
    (p.path / "other.ron").write_text(GRAPH.replace("gamma: 0.8", "gamma: 0.2").replace("picture.png", "other.png"))
    run = subprocess.run([p.program, "run", "other.ron", "--cache", "cache"], cwd=p.path, capture_output=True, text=True, timeout=200)
    check(run.returncode == 0, f"the other graph runs: {run.stderr}")
    b.js("const s = document.getElementById('output'); s.value = 'final.image'; s.dispatchEvent(new Event('change'))")
    b.js("document.getElementById('other').dispatchEvent(new PointerEvent('pointerenter'))")
    until(lambda: "other.ron: final.image" in b.text("#other optgroup[label=Graphs]"), "the graph is offered")
    b.js("const s = document.getElementById('other'); s.value = s.querySelector('optgroup[label=Graphs] option').value; s.dispatchEvent(new Event('change'))")
    until(lambda: b.text("#label-b") == "B: other.ron: final.image" and b.text("#measures").startswith("A against B: FLIP 0."), f"its picture differs: {b.text('#measures')}")
    (p.path / "other.ron").unlink()


def foresees(b, p):
    """What an edit would run is shown before it is made: for sliders, the default, the gizmo and the camera."""
    # Not a pose of another scenario: a value that is known would run nothing.
    foot = (-0.03, -0.05, 0.44)
    place(b, p, PLACE.replace("(-0.02, -0.06, 0.44)", str(foot)))
    b.click("#tab-picture")
    before = p.text()
    choose(b, "pose")
    would = lambda: b.js("return [...document.querySelectorAll('g.node.would')].map((g) => g.querySelector('text').textContent)")
    for what in ('[aria-label="yaw_deg"]', '[data-field="yaw_deg"] .head button'):
        b.js("document.querySelector(arguments[0]).focus()", what)
        until(lambda: "pose" in would() and "save" in would() and b.text("#plan").startswith("would run pose"), lambda: f"{what}: {would()} {b.text('#plan')}")
        b.js("document.activeElement.blur()")
        until(lambda: not would() and not b.text("#plan"), "and not after it")
    b.click("#tab-place")
    lens = Lens(b)
    hover = lambda x, y: b.at("POST", "/actions", {"actions": [{"type": "pointer", "id": "p", "actions": [{"type": "pointerMove", "duration": 0, "x": round(x), "y": round(y), "origin": "viewport"}]}]})
    x, y = lens.at(foot)
    hover(x, y - 60)
    until(lambda: b.text("#place-plan").startswith("would run pose"), f"the gizmo: {b.text('#place-plan')}")
    x, y, w, h = b.box("#space")
    hover(x + 30, y + 40)
    until(lambda: not b.text("#place-plan"), "and not after it")
    b.drag((x + 60, y + 60), (x + 130, y + 40))
    until(lambda: not b.js("return document.getElementById('place-set').disabled"), "the camera can be set")
    b.js("document.getElementById('place-set').focus()")
    until(lambda: b.text("#place-plan").startswith("would run camera"), f"the camera: {b.text('#place-plan')}")
    check(p.text() == before, "nothing is written")
    b.click("#tab-picture")


def by_keys(b, p):
    """Keys only: the panes, the object, the ground, the view, the camera, the picture and the slider between A and B."""
    p.write(PLACE)
    until(lambda: "camera" in b.text("#graph"), "the graph is there")
    time.sleep(0.2)
    p.idle()
    ready(b)
    left, right, up, down, enter, escape = "\ue012", "\ue014", "\ue013", "\ue015", "\ue007", "\ue00c"
    focus = lambda: b.js("return document.activeElement?.id ?? ''")
    b.js("document.activeElement?.blur()")
    b.keys("p")
    until(lambda: focus() == "space" and solid(b, 0.5, 0.5)[3] > 200, f"the place has the focus: {focus()}")
    until(lambda: "placed at" in b.text("#place-position"), "the object is there")
    before = p.text()
    b.keys(">")
    until(lambda: p.text() != before, "a key scales the object")
    check(abs(pose(p)[2] - 1.26) < 1e-6, f"5 % larger: {pose(p)}")
    ready(b); p.idle()
    b.keys("<")
    until(lambda: abs(pose(p)[2] - 1.2) < 1e-3, f"and back: {pose(p)}")
    ready(b); p.idle()
    before = p.text()
    b.keys("x")
    until(lambda: "arrow keys" in b.text("#space-note"), "the ground can be clicked")
    for key in [down] * 6 + [right] * 4:
        b.keys(key)
    b.keys(enter)
    until(lambda: p.text() != before, f"Enter clicks the ground: {b.text('#space-note')}")
    only_pose_differs(before, p.text())
    ready(b); p.idle()
    before = p.text()
    for key in ("j", "j", "j", "k", enter):
        b.keys(key)
    until(lambda: p.text() != before, "the view is turned, and the camera set")
    check(re.sub(r"eye: \([^)]*\), target: \([^)]*\)", "", before) == re.sub(r"eye: \([^)]*\), target: \([^)]*\)", "", p.text()), "only the camera differs")
    ready(b); p.idle()
    b.keys("p")
    until(lambda: b.js("return !document.getElementById('picture').hidden"), "the picture is back")
    # By Tab to the menu of B, which opens by keys.
    b.js("document.getElementById('output').focus()")
    for _ in range(6):
        if focus() != "other":
            b.keys("\ue004")
    check(focus() == "other", f"Tab reaches B: {focus()}")
    until(lambda: b.count("#other option") > 2, "there is something to compare with")
    b.keys(down)
    until(lambda: b.js("return !document.getElementById('split').hidden"), "the slider between A and B is there")
    for _ in range(14):
        if focus() != "split":
            b.keys("\ue004")
    check(focus() == "split", f"Tab reaches the slider: {focus()}")
    start = b.box("#split")[0]
    b.keys(left); b.keys(left)
    until(lambda: b.box("#split")[0] < start - 10, "an arrow moves it")
    b.js("document.getElementById('view').focus()")
    at = lambda: b.pixel(0.02, 0.5)[3]
    b.keys("0")
    colour = [tuple(b.pixel(x / 10, 0.5)) for x in range(1, 10)]
    b.keys(right)
    until(lambda: [tuple(b.pixel(x / 10, 0.5)) for x in range(1, 10)] != colour, "an arrow pans the picture")
    b.keys("0")
    b.keys("r")
    until(lambda: b.js("return !document.getElementById('trade').hidden"), "the trade pane")
    b.keys("r")
    b.keys("t")
    until(lambda: b.js("return !document.getElementById('text').hidden"), "the text")
    b.keys("t")
    b.keys("?")
    until(lambda: b.js("return document.getElementById('keys').open"), "the list of keys")
    b.keys(escape)
    until(lambda: not b.js("return document.getElementById('keys').open"), "and away")


def times(b, p):
    """The page is usable in under a second, and a slider move gives its first preview in under 0.7 s."""
    ready(b)
    p.idle()
    usable, preview = [], []
    for _ in range(3):
        begin = time.monotonic()
        b.open(p.url)
        until(lambda: b.count("g.node") == 13, "the graph is drawn")
        usable.append(time.monotonic() - begin)
        ready(b)
    script = """const done = arguments[1], slider = document.querySelector('[aria-label="yaw_deg"]'), e = new EventSource('/events'); let begin = null;
        e.onmessage = (m) => { const d = JSON.parse(m.data);
            if (d.event === 'state' && begin === null) { begin = performance.now(); slider.value = arguments[0]; slider.dispatchEvent(new Event('input')); }
            else if (begin !== null && d.event === 'file') { e.close(); done((performance.now() - begin) / 1000); } };"""
    choose(b, "pose")
    for value in (300, 340, 380, 420, 460):
        preview.append(b.at("POST", "/execute/async", {"script": script, "args": [value]}))
        time.sleep(0.3)
    b.js("""document.querySelector('[aria-label="yaw_deg"]').dispatchEvent(new KeyboardEvent('keydown', { key: 'Escape', bubbles: true }))""")
    until(lambda: "trying" not in b.text("#status"), "nothing is tried any more")
    ready(b)
    more = allowance()
    print(f"    usable after {show(usable)} s; first preview after {show(preview)} s; limits times {more:.1f}; the watch has {p.memory():.0f} MiB")
    check(middle(usable) < USABLE * more, f"usable after {show(usable)} s, limit {USABLE} s times {more:.1f}")
    check(middle(preview) < PREVIEW * more, f"first preview after {show(preview)} s, limit {PREVIEW} s times {more:.1f}")


def fills(b, p):
    """A full disk: the edit is refused with the reason, the text stays, and the same edit can be made when there is room."""
    ready(b)
    p.idle()
    before = p.text()
    choose(b, "pose")
    whole = resource.prlimit(p.watch.pid, resource.RLIMIT_FSIZE)
    # Longer than this, no file can be written; unlike permissions, this holds for root as well.
    resource.prlimit(p.watch.pid, resource.RLIMIT_FSIZE, (512, whole[1]))
    try:
        b.type('[aria-label="yaw_deg as text"]', "35.5")
        until(lambda: "the disk is full" in b.text("#notice"), f"it is named: {b.text('#notice')}")
        check(p.text() == before, "the text is as it was")
        check(not list(p.path.glob(".*temp*")), "no temporary file is left")
    finally:
        resource.prlimit(p.watch.pid, resource.RLIMIT_FSIZE, whole)
    field = '[aria-label="yaw_deg as text"]'
    until(lambda: b.js("return document.querySelector(arguments[0]).value", field) == "-24.0", "the field shows the text again")
    b.type('[aria-label="yaw_deg as text"]', "35.5")
    until(lambda: p.text() == before.replace("-24.0", "35.5"), "the edit is made")
    ready(b)


def damaged(b, p):
    """A truncated object: named at the start from a capture and in a graph, and nothing is written."""
    fresh = Place(p.program, None, {"room.ply": capture(), "cut.glb": cone()[:700]})
    try:
        b.open(fresh.url)
        until(lambda: b.js("return !document.getElementById('start').hidden"), "the panel is there", 60)
        until(lambda: solid(b, 0.5, 0.8)[3] > 200, "the capture is drawn")
        fresh.idle()
        bare = fresh.text()
        b.click("#start-click")
        x, y, w, h = b.box("#space")
        click(b, x + w * 0.5, y + h * 0.56)
        until(lambda: "cut.glb" in b.text("#notice"), f"the file is named: {b.text('#notice')} {b.text('#space-note')}", 60)
        check(fresh.text() == bare, "nothing is written")
        check(b.js("return !document.getElementById('start').hidden"), "another object can be chosen")
    finally:
        fresh.stop()
        b.console()
    (p.path / "cut.glb").write_bytes(cone()[:700])
    p.write(GRAPH.replace("        probe:  ", """        broken: LoadObject(path: "cut.glb"),
        second: Place(object: "broken", pose: "pose"),
        probe:  """).replace('["placed"]', '["placed", "second"]'))
    b.open(p.url)
    until(lambda: b.count("g.node.failed") == 1, "its node fails", 60)
    choose(b, "broken")
    until(lambda: "cut.glb" in b.text("#facts .error"), f"with the reason: {b.text('#facts')}")
    b.click("#tab-place")
    until(lambda: "splats" in b.text("#splat-count"), f"the splats are there: {b.text('#space-note')}")
    until(lambda: solid(b, 0.5, 0.5)[3] > 200, f"the place is still drawn: {b.text('#space-note')}")
    b.click("#tab-picture")
    (p.path / "cut.glb").unlink()
    p.write(GRAPH)
    ready(b)


def plain(b, p):
    """A browser without WebGL: this is named, pictures are shown, and values can be edited."""
    ready(b)
    p.idle()
    before = p.text()
    other = Browser(webgl=False)
    try:
        other.open(p.url)
        until(lambda: other.count("g.node") == 13, "the graph is drawn")
        check(other.js("return !document.createElement('canvas').getContext('webgl2')"), "there is no WebGL 2")
        until(lambda: "has no WebGL 2" in other.text("#notice"), f"it is named: {other.text('#notice')}")
        until(lambda: other.js("const i = document.getElementById('fallback'); return !i.hidden && i.naturalWidth") == 160, "the picture is shown")
        choose(other, "pose")
        other.type('[aria-label="yaw_deg as text"]', "35.5")
        until(lambda: p.text() == before.replace("-24.0", "35.5"), "a value can be edited")
        other.click("#tab-place")
        until(lambda: "WebGL 2" in other.text("#space-note"), f"the place view says so: {other.text('#space-note')}")
        if SHOTS:
            other.shot(SHOTS / "plain-place.png")
        other.click("#tab-picture")
        check(not [e for e in other.console() if "WebGL" not in e], "no other errors")
    finally:
        other.close()
    ready(b)


# Folder of screenshots, if they are wanted.
SHOTS = None

SCENARIOS = [opens, edits, drags, follows, conflicts, mistakes, pictures, compares, moves, turns, stands, looks_through, chooses, measures, scrubs, keys, trades, agrees, starts, restarts, refuses,
             adds, against, foresees, by_keys, times, fills, damaged, plain]

# The scenarios that `.ci/run` runs: short ones that together use each part of the page.
IN_CI = [opens, edits, follows, conflicts, mistakes, by_keys, fills, plain, restarts, refuses]

# The scenarios that run in Firefox, too.
IN_FIREFOX = [opens, edits, drags, pictures, compares, moves, looks_through, chooses, measures, keys]


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("program", nargs="?", default=str(ROOT / "target/release/lightharmony"))
    parser.add_argument("--shots", type=pathlib.Path)
    parser.add_argument("--only", action="append")
    parser.add_argument("--ci", action="store_true")
    parser.add_argument("--firefox", action="store_true")
    args = parser.parse_args()
    needed = ["firefox-esr", "Xvfb"] if args.firefox else ["chromium", "chromedriver"]
    if not all(map(shutil.which, needed)):
        print(f"there is no {' or '.join(needed)} here; nothing was tested")
        return 77
    args.only = args.only or ([scenario.__name__ for scenario in IN_CI] if args.ci else None) or ([scenario.__name__ for scenario in IN_FIREFOX] if args.firefox else None)
    if args.shots:
        global SHOTS
        SHOTS = args.shots
        args.shots.mkdir(parents=True, exist_ok=True)
    program, failed, begin = str(pathlib.Path(args.program).resolve()), 0, time.monotonic()
    place = Place(program)
    place.idle()
    browser = Firefox() if args.firefox else Browser()
    try:
        for scenario in SCENARIOS:
            if args.only and scenario.__name__ not in args.only:
                continue
            start = time.monotonic()
            try:
                place.write(GRAPH)
                time.sleep(0.15)
                place.idle()
                browser.open(place.url)
                until(lambda: browser.count("g.node") > 0, "the page is usable")
                browser.console()
                scenario(browser, place)
                errors = browser.console()
                # A refusal of an edit is an answer, which the console also lists.
                errors = [e for e in errors if not re.search(r"/(set|plan|try|undo|redo|start|up|add) - Failed to load resource", e)]
                check(not errors, f"errors on the console: {errors}")
                print(f"ok   {scenario.__name__}: {scenario.__doc__} ({time.monotonic() - start:.1f} s)", flush=True)
            except Exception as error:
                failed += 1
                print(f"FAIL {scenario.__name__}: {scenario.__doc__}\n     {error}\n     status: {browser.text('#status')}; notice: {browser.text('#notice')}", flush=True)
            if args.shots and scenario is not starts:
                browser.shot(args.shots / f"{scenario.__name__}.png")
        print(f"memory of the watch with its page: {place.memory():.0f} MiB")
    finally:
        browser.close()
        place.stop()
    if args.shots and not args.only:
        looks(program, args.shots)
    count = len(args.only or SCENARIOS)
    print(f"{count - failed} of {count} scenarios in {time.monotonic() - begin:.0f} s")
    return 1 if failed else 0


def looks(program, folder):
    """Screenshots on a laptop and on a 4K screen, light and dark."""
    place = Place(program)
    try:
        place.idle()
        for name, size, theme in (("laptop-light", (1366, 768), "light"), ("laptop-dark", (1366, 768), "dark"), ("uhd-light", (3840, 2160), "light"), ("uhd-dark", (3840, 2160), "dark")):
            with contextlib.closing(Browser(size)) as browser:
                browser.open(place.url)
                browser.js("document.documentElement.dataset.theme = arguments[0]", theme)
                ready(browser)
                until(lambda: browser.pixel(0.5, 0.5)[3] == 255, "the picture is drawn")
                time.sleep(0.5)
                browser.shot(folder / f"{name}.png")
                browser.click("#tab-place")
                until(lambda: "splats" in browser.text("#splat-count") and solid(browser, 0.5, 0.5)[3] > 200, "the place is drawn", 60)
                time.sleep(0.5)
                browser.shot(folder / f"{name}-place.png")
    finally:
        place.stop()


if __name__ == "__main__":
    sys.exit(main())
