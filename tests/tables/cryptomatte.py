#!/usr/bin/env python3
"""Checks the mattes of `object-mattes` in a file of `write-exr` with the reader of OpenEXR and the hashes of mmh3.

    tests/tables/cryptomatte.py LIGHTHARMONY

Needs the PyPI packages `OpenEXR`, `mmh3` and `numpy`. Three vases stand in the room of `demo-scene`, one
behind another, with splats in front of all. Prints what the specification of Cryptomatte 1.2.0 requires, and the largest differences:
of the sum of the coverages from the alpha that is visible, and of the coverage of a vase that nothing hides from the alpha of a render
of this vase alone.
"""
import json
import pathlib
import struct
import subprocess
import sys
import tempfile

import mmh3
import numpy as np
import OpenEXR

GRAPH = """Graph(version: 1, scene: (up: "+z", seed: 3), nodes: (
    demo: DemoScene(splats: 20000, width_px: 320, height_px: 180),
    {poses}
    trace: PathTrace(receiver: "demo.proxy", objects: ["a", "b", "c"], rig: "demo.rig", env: "demo.truth_env", samples: 8),
    alone: PathTrace(receiver: "demo.proxy", objects: ["c"], rig: "demo.rig", env: "demo.truth_env", samples: 8),
    view: SplatRender(splats: "demo.splats", rig: "demo.rig"),
    front: SplatRender(splats: "demo.splats", rig: "demo.rig", limit: "trace.nearest"),
    final: Composite(background: "view", object: "trace.object", front: "front.colour"{composite}),
    mattes: ObjectMattes(object: "final.object", objects: ["a", "b", "c"], rig: "demo.rig", receiver: "demo.proxy",
        front: "front.colour", names: ["vase", "bowl", "Stühle \\"c\\""], samples: 8),
    save: WriteExr(image: "final.image", layers: ["final.object", "front.colour", "alone.object"], names: ["object", "front", "alone"],
        mattes: ["mattes"], encoding: Linear, half: {half}, path: "out.exr"),
))"""
PLACES = {"a": "(0.0, 0.0, 0.0)", "b": "(0.15, 0.4, 0.0)", "c": "(0.55, -0.1, 0.0)"}
# Name of the vase that nothing hides.
FREE = 'Stühle "c"'


def identifier(name):
    bits = mmh3.hash(name.encode()) & 0xFFFFFFFF
    return bits ^ (1 << 23) if bits >> 23 & 255 in (0, 255) else bits


def made(program, place, composite, half):
    poses = " ".join(f'p{n}: Pose(translation: {at}), {n}: Place(object: "demo.object", pose: "p{n}"),' for n, at in PLACES.items())
    graph = GRAPH.format(poses=poses, composite=composite, half=half)
    (place / "graph.ron").write_text(graph, encoding="utf-8")
    command = [program, "run", "graph.ron", "--cache", "cache", "--out", "."]
    done = subprocess.run(command, cwd=place, capture_output=True, text=True)
    if done.returncode:
        sys.exit(done.stderr)
    with OpenEXR.File(str(place / "out.exr"), separate_channels=True) as file:
        return {name: channel.pixels for name, channel in file.channels().items()}, dict(file.header())


def check(channels, header):
    key = f"cryptomatte/{mmh3.hash(b'CryptoObject') & 0xFFFFFFFF:08x}"[:19]
    about = {name.rsplit("/", 1)[1]: text for name, text in header.items() if name.startswith(key + "/")}
    assert {name: about[name] for name in ("name", "hash", "conversion")} == {
        "name": "CryptoObject", "hash": "MurmurHash3_32", "conversion": "uint32_to_float32"}
    manifest = json.loads(about["manifest"])
    assert manifest == {name: f"{identifier(name):08x}" for name in ("vase", "bowl", FREE)}, manifest
    layers = sorted({name.split(".")[0] for name in channels if name.startswith("CryptoObject")})
    pairs = [(channels[f"{layer}.{id}"], channels[f"{layer}.{cover}"]) for layer in layers for id, cover in ("RG", "BA")]
    assert all(plane.dtype == np.float32 for pair in pairs for plane in pair)
    ids = np.stack([id.view(np.uint32) for id, _ in pairs])
    coverage = np.stack([cover for _, cover in pairs]).astype(np.float64)
    known = {int(value, 16) for value in manifest.values()} | {0}
    assert set(np.unique(ids)) <= known
    assert (np.diff(coverage, axis=0) <= 0).all() and ((ids == 0) == (coverage == 0)).all()
    visible = channels["object.A"].astype(np.float64) * (1 - channels["front.A"].astype(np.float64))
    matte = {name: (coverage * (ids == int(value, 16))).sum(axis=0) for name, value in manifest.items()}
    print(f"layers: {' '.join(layers)}; names: {', '.join(manifest)}")
    print(f"pixels of one object {((coverage > 0).sum(axis=0) == 1).sum()}, of several {((coverage > 0).sum(axis=0) > 1).sum()}, "
          f"partly behind splats {((channels['front.A'] > 0.01) & (channels['object.A'] > 0)).sum()}")
    print(f"sum of coverages and visible alpha: {np.abs(coverage.sum(axis=0) - visible).max():.1e}")
    return matte


def main():
    with tempfile.TemporaryDirectory() as folder:
        place = pathlib.Path(folder)
        channels, header = made(sys.argv[1], place, "", "false")
        matte = check(channels, header)
        alone = channels["alone.A"].astype(np.float64) * (1 - channels["front.A"].astype(np.float64))
        print(f"matte of the vase that nothing hides, and its own alpha: {np.abs(matte[FREE] - alone).max():.1e}")
        first = (place / "out.exr").read_bytes()
        made(sys.argv[1], place, "", "false")
        assert (place / "out.exr").read_bytes() == first
        print("with blurred objects:")
        check(*made(sys.argv[1], place, ", sharpness: Blur, blur_px: 2.0", "false"))


main()
