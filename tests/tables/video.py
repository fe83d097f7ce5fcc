"""Films of `write-video`, decoded by dav1d, and beside other encoders at equal quality: the table of docs/motion.md.

    python tests/tables/video.py PROGRAM WORK [SHOT ..]

Renders a turning object and a moving camera, 48 frames of 640x360 each, and writes them at several qualities with 8 and 10
bits, with one thread and with two. Needs NumPy, OpenCV and PyAV (`pip install av`, which brings FFmpeg with dav1d, SVT-AV1
and x264). Prints the error of luma and chroma against the frames, whether the encoder's own PSNR is that of the decoded
film, and the size and CPU time of SVT-AV1 and x264 at the PSNR of quality 75.
"""

import os
import re
import resource
import subprocess
import sys

import av
import cv2
import numpy as np

program, work, chosen = sys.argv[1], os.path.abspath(sys.argv[2]), sys.argv[3:]
QUALITIES = [40, 60, 75, 85, 95]
FRAMES = 48
SIZE = (640, 360)

GRAPH = """Graph(
    version: 1,
    scene: (up: "+z", seed: 3),
    axes: (frame: Range(0, %d)),
    nodes: (
        demo:   DemoScene(place: Courtyard, splats: 60000, width_px: 640, height_px: 360),
        pose:   Pose(translation: (0.0, 0.0, 0.0), yaw_deg: %s),
        placed: Place(object: "demo.object", pose: "pose"),
        camera: Camera(eye: (%s, -2.9, 1.5), target: (0.0, 0.0, 0.4), fov_y_deg: 40.0, width_px: 640, height_px: 360),
        probe:  CubeRig(at: "pose", height_metres: 0.3, size_px: 256),
        faces:  SplatRender(splats: "demo.splats", rig: "probe"),
        pano:   Stitch(views: "faces", width_px: 512),
        dark:   PredictExposure(pano: "pano", evs: [-6.0, -3.0], method: Learned),
        env:    FuseHdr(base: "pano", brackets: "dark"),
        view:   SplatRender(splats: "demo.splats", rig: "camera"),
        trace:  PathTrace(receiver: "demo.proxy", objects: ["placed"], rig: "camera", env: "env", samples: 8),
        clean:  Denoise(without: "trace.without", with: "trace.with", object: "trace.object",
                        depth: "trace.depth", normal: "trace.normal", variance: "trace.variance"),
        shadow: ShadowRatio(without: "clean.without", with: "clean.with"),
        final:  Composite(background: "view", object: "clean.object", shadow: "shadow"),
        frames: Gather(input: "final", over: "frame"),
        each:   WriteImage(image: "final", bits: 16, path: "f{frame}.png"),
%s
    ),
)"""
FILM = '        film{0}{1}: WriteVideo(frames: "frames", rate: Quality({0}.0), bits: {1}, path: "q{0}-{1}.mp4"),'
SHOTS = {
    "object": ('Track("frame", [(0, 0.0), (47, 352.5)])', "1.6"),
    "camera": ("20.0", 'Track("frame", [(0, -1.2), (47, 1.6)])'),
}


def run(folder, *arguments):
    """Runs the graph; the output of the program and its CPU time."""
    command = [program, "run", "graph.ron", *arguments]
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    if done.returncode:
        sys.exit(done.stderr[-3000:])
    return done.stderr, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def planes(rgb, bits):
    """Luma and halved chroma of RGB from 0 to 1, in codes, unrounded (BT.709, limited range, left siting)."""
    scale = 2 ** (bits - 8)
    r, g, b = np.moveaxis(rgb, -1, 0)
    y = 0.2126 * r + 0.7152 * g + 0.0722 * b
    u, v = (b - y) / 1.8556, (r - y) / 1.5748

    def halved(plane):
        padded = np.pad(plane, ((0, 0), (1, 1)), mode="edge")
        across = 0.25 * (padded[:, :-2] + 2 * padded[:, 1:-1] + padded[:, 2:])[:, ::2]
        return 0.5 * (across[::2] + across[1::2])

    return scale * (16 + 219 * y), scale * (128 + 224 * halved(u)), scale * (128 + 224 * halved(v))


def decoded(path):
    """The planes of each frame of a film, in codes, and the number of bits."""
    with av.open(path) as film:
        stream = film.streams.video[0]
        stream.codec_context.thread_count = 1
        for frame in film.decode(stream):
            bits = 10 if "10" in frame.format.name else 8
            kind = np.uint16 if bits == 10 else np.uint8
            out = []
            for plane in frame.planes:
                rows = np.frombuffer(plane, np.uint8).reshape(plane.height, plane.line_size)
                out.append(rows.copy().view(kind)[:, : plane.width].astype(np.float64))
            yield out, bits, frame


def psnr(film, truth):
    squares, count, tags = np.zeros(3), 0, None
    for (codes, bits, frame), rgb in zip(film, truth, strict=True):
        wanted = planes(rgb, bits)
        peak = 2**bits - 1
        squares += [np.mean(((a - b) / peak) ** 2) for a, b in zip(codes, wanted)]
        count += 1
        tags = (frame.width, frame.height, frame.color_range, frame.colorspace, frame.color_trc, frame.color_primaries)
    return -10 * np.log10(squares / count), tags


def other(name, options, truth, path):
    """Encodes the frames by an encoder of FFmpeg; its size and CPU time."""
    before = resource.getrusage(resource.RUSAGE_SELF)
    with av.open(path, "w") as out:
        stream = out.add_stream(name, rate=24, options=options)
        stream.width, stream.height, stream.pix_fmt = *SIZE, "yuv420p"
        stream.codec_context.thread_count = 1
        for rgb in truth:
            y, u, v = (np.rint(plane).astype(np.uint8) for plane in planes(rgb, 8))
            whole = np.concatenate([y.ravel(), u.ravel(), v.ravel()]).reshape(SIZE[1] * 3 // 2, SIZE[0])
            out.mux(stream.encode(av.VideoFrame.from_ndarray(whole, format="yuv420p")))
        out.mux(stream.encode(None))
    after = resource.getrusage(resource.RUSAGE_SELF)
    return os.path.getsize(path), after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


for shot, (yaw, eye) in SHOTS.items():
    if chosen and shot not in chosen:
        continue
    folder = os.path.join(work, shot)
    os.makedirs(folder, exist_ok=True)
    films = [FILM.format(quality, 8) for quality in QUALITIES] + [FILM.format(75, 10)]
    with open(os.path.join(folder, "graph.ron"), "w") as out:
        out.write(GRAPH % (FRAMES, yaw, eye, "\n".join(films)))
    text, seconds = run(folder, "--only", "each")
    print(f"## {shot}: {FRAMES} frames in {seconds:.0f} CPU-s, {seconds / FRAMES:.2f} each")
    text, seconds = run(folder, "--verbose")
    print(f"six films: {seconds / 6 / FRAMES:.3f} CPU-s per frame")
    names = [f"q{quality}-8.mp4" for quality in QUALITIES] + ["q75-10.mp4"]
    out = os.path.join(folder, "out")
    first = {name: open(os.path.join(out, name), "rb").read() for name in names}
    # From the 16-bit pictures, whose codes are those that the encoder gets, with one thread.
    one = os.path.join(folder, "one")
    os.makedirs(one, exist_ok=True)
    with open(os.path.join(one, "graph.ron"), "w") as file:
        nodes = [f'p{index}: LoadImage(path: "{out}/f{index:02}.png"),' for index in range(FRAMES)]
        names_of = ", ".join(f'"p{index}"' for index in range(FRAMES))
        nodes += [film.replace('frames: "frames"', f"frames: [{names_of}]") for film in films]
        file.write('Graph(version: 1, scene: (up: "+z"), nodes: (%s))' % "\n".join(nodes))
    text, seconds = run(one, "--jobs", "1", "--verbose")
    print(f"six films with one thread: {seconds / 6 / FRAMES:.3f} CPU-s per frame")
    same = all(first[name] == open(os.path.join(one, "out", name), "rb").read() for name in names)
    print("the same bytes with one thread:", same)
    truth = []
    for index in range(FRAMES):
        bgr = cv2.imread(os.path.join(out, f"f{index:02}.png"), cv2.IMREAD_UNCHANGED)
        truth.append(bgr[:, :, 2::-1] / 65535)
    said = dict(re.findall(r"(film\d+)\b.*?PSNR of luma ([0-9.]+) dB", text, re.S))
    print("| film | kB | PSNR of luma, blue and red difference, dB |\n|---|---|---|")
    points = []
    for name in names:
        values, tags = psnr(decoded(os.path.join(out, name)), truth)
        points.append((len(first[name]), values[0]))
        print(f"| {name} | {len(first[name]) / 1e3:.1f} | {values[0]:.2f}, {values[1]:.2f}, {values[2]:.2f} |")
    print("tags (size, range, matrix, transfer, primaries):", tags, "stated:", said)
    target = points[QUALITIES.index(75)]
    for name, steps in {"libsvtav1": [20, 28, 36, 44, 52], "libx264": [14, 18, 22, 26, 30]}.items():
        sizes, values, seconds = [], [], 0
        for step in steps:
            options = {"crf": str(step), "preset": "8" if name == "libsvtav1" else "medium"}
            path = os.path.join(folder, f"{name}-{step}.mp4")
            size, spent = other(name, options, truth, path)
            sizes.append(np.log(size))
            values.append(psnr(decoded(path), truth)[0][0])
            seconds += spent / len(steps)
        at = np.exp(np.interp(target[1], values[::-1], sizes[::-1]))
        print(f"{name}: {at / 1e3:.1f} kB at {target[1]:.2f} dB (ours {target[0] / 1e3:.1f} kB); {seconds / FRAMES:.3f} CPU-s a frame")
