"""Readers of the files that the sinks of lightharmony write, as NumPy arrays."""

from __future__ import annotations

import json
import os
import struct
import typing
import zlib

from .errors import Error

try:
    import numpy
except ImportError as error:
    raise ImportError("values are NumPy arrays; install NumPy: pip install numpy") from error


class FormatError(Error):
    """A file is damaged, or not a file that lightharmony writes."""


def read_exr(path: typing.Union[str, os.PathLike]) -> typing.Dict[str, numpy.ndarray]:
    """The channels of an OpenEXR file by name, such as `R` or `depth`: arrays of 32-bit floats (height, width).

    Reads one flat part of scan lines without compression or with ZIP, which `write-exr` writes.
    """
    with open(path, "rb") as file:
        data = file.read()
    try:
        return _exr(data)
    except (struct.error, ValueError, KeyError, IndexError, zlib.error) as error:
        raise FormatError(f"`{os.fspath(path)}` is not an OpenEXR file that lightharmony writes: {error}") from error


def _exr(data: bytes) -> typing.Dict[str, numpy.ndarray]:
    magic, version = struct.unpack_from("<II", data)
    if magic != 20000630 or version & 0x1A00:
        raise ValueError("several parts, tiles or deep data" if magic == 20000630 else "another signature")
    at, header = 8, {}

    def text(at: int) -> typing.Tuple[str, int]:
        end = data.index(b"\0", at)
        return data[at:end].decode("utf-8"), end + 1

    while data[at]:
        name, at = text(at)
        _, at = text(at)
        (size,) = struct.unpack_from("<I", data, at)
        header[name], at = data[at + 4 : at + 4 + size], at + 4 + size
    at += 1
    channels, place = [], 0
    while header["channels"][place]:
        end = header["channels"].index(b"\0", place)
        kind, _, x, y = struct.unpack_from("<iB3xii", header["channels"], end + 1)
        if (x, y) != (1, 1):
            raise ValueError("a subsampled channel")
        # Stored as little-endian numbers.
        channels.append((header["channels"][place:end].decode("utf-8"), numpy.dtype(("<u4", "<f2", "<f4")[kind])))
        place = end + 17
    left, top, right, bottom = struct.unpack("<iiii", header["dataWindow"])
    width, height = right - left + 1, bottom - top + 1
    compression = header["compression"][0]
    rows_per_block = {0: 1, 2: 1, 3: 16}.get(compression)
    if rows_per_block is None:
        raise ValueError(f"compression {compression}")
    stride = sum(kind.itemsize for _, kind in channels) * width
    blocks = -(-height // rows_per_block)
    if width < 1 or height < 1 or len(data) < at + 8 * blocks:
        raise ValueError("the file is cut off")
    found = {name: numpy.empty((height, width), numpy.float32) for name, _ in channels}
    for offset in struct.unpack_from(f"<{blocks}Q", data, at):
        first, size = struct.unpack_from("<iI", data, offset)
        first -= top
        rows = min(rows_per_block, height - first)
        if not 0 <= first < height or len(data) < offset + 8 + size:
            raise ValueError("the file is cut off")
        block = data[offset + 8 : offset + 8 + size]
        # A block that does not get shorter is stored without compression.
        if compression and size < rows * stride:
            block = _unzipped(block, rows * stride)
        if len(block) != rows * stride:
            raise ValueError("a block has another size")
        place = 0
        for row in range(first, first + rows):
            for name, kind in channels:
                found[name][row] = numpy.frombuffer(block, kind, width, place)
                place += width * kind.itemsize
    return found


def _unzipped(block: bytes, size: int) -> bytes:
    """Undoes ZIP compression of OpenEXR: deflate, differences, and separation of even and odd bytes."""
    data = numpy.frombuffer(zlib.decompressobj().decompress(block, size), numpy.uint8)
    if len(data) != size:
        raise ValueError("a block has another size")
    steps = data.astype(numpy.int64)
    steps[1:] -= 128
    data = (numpy.cumsum(steps) & 255).astype(numpy.uint8)
    joined = numpy.empty(size, numpy.uint8)
    half = (size + 1) // 2
    joined[0::2], joined[1::2] = data[:half], data[half:]
    return joined.tobytes()


# Order in which the channels of a picture are returned; others follow by name.
_ORDER = {name: index for index, name in enumerate("RGBXYZA")}


def read_picture(path: typing.Union[str, os.PathLike], layer: str = "") -> numpy.ndarray:
    """One layer of an OpenEXR file as an array (height, width, channels), with the channels in the order R, G, B, A or
    X, Y, Z. A layer without a name has the channels without a dot."""
    channels = read_exr(path)
    if layer:
        kept = {name[len(layer) + 1 :]: plane for name, plane in channels.items() if name.startswith(layer + ".")}
        kept = kept or {name: plane for name, plane in channels.items() if name == layer}
    else:
        kept = {name: plane for name, plane in channels.items() if "." not in name} or channels
    if not kept:
        raise KeyError(f"`{os.fspath(path)}` has no layer `{layer}`; its channels are {', '.join(channels)}")
    names = sorted(kept, key=lambda name: (_ORDER.get(name.rpartition(".")[2], len(_ORDER)), name))
    return numpy.stack([kept[name] for name in names], axis=-1)


_PLY_TYPES = {
    "char": "i1", "uchar": "u1", "short": "<i2", "ushort": "<u2", "int": "<i4", "uint": "<u4", "float": "<f4",
    "double": "<f8",
}


def read_mesh(path: typing.Union[str, os.PathLike]) -> typing.Dict[str, numpy.ndarray]:
    """A triangle mesh in binary PLY: `positions` (n, 3), `faces` (m, 3) and, if there are any, `colours` (n, 3) from 0
    to 255."""
    with open(path, "rb") as file:
        data = file.read()
    try:
        return _ply(data)
    except (ValueError, KeyError, IndexError, UnicodeDecodeError) as error:
        raise FormatError(f"`{os.fspath(path)}` is not a PLY file that lightharmony writes: {error}") from error


def _ply(data: bytes) -> typing.Dict[str, numpy.ndarray]:
    end = data.index(b"end_header\n") + len(b"end_header\n")
    lines = [line.split() for line in data[:end].decode("ascii").splitlines()]
    if lines[0] != ["ply"] or ["format", "binary_little_endian", "1.0"] not in lines:
        raise ValueError("the format is not binary_little_endian 1.0")
    counts, fields = {}, {}
    for line in lines:
        if line[0] == "element":
            element = line[1]
            counts[element], fields[element] = int(line[2]), []
        elif line[0] == "property" and line[1] == "list":
            fields[element] += [("count", _PLY_TYPES[line[2]]), (line[4], _PLY_TYPES[line[3]], (3,))]
        elif line[0] == "property":
            fields[element].append((line[2], _PLY_TYPES[line[1]]))
    vertices = numpy.frombuffer(data, fields["vertex"], counts["vertex"], end)
    faces = numpy.frombuffer(data, fields["face"], counts["face"], end + vertices.nbytes)
    if (faces["count"] != 3).any():
        raise ValueError("a face is not a triangle")
    mesh = {
        "positions": numpy.stack([vertices[axis] for axis in "xyz"], axis=-1),
        "faces": faces["vertex_indices"].astype(numpy.int64),
    }
    if "red" in vertices.dtype.names:
        mesh["colours"] = numpy.stack([vertices[name] for name in ("red", "green", "blue")], axis=-1)
    return mesh


def read_report(path: typing.Union[str, os.PathLike]) -> dict:
    """A report as JSON."""
    with open(path, encoding="utf-8") as file:
        return json.load(file)
