"""Lightharmony in ComfyUI: runs a graph, and gives its pictures to other nodes.

Copy this folder to `custom_nodes/lightharmony`, and install the module `lightharmony` into the Python of ComfyUI.

- `Lightharmony Run` computes outputs of a graph. It runs again exactly if a key of the graph has changed: an edit of a
  parameter, of an input file or of the background, but not of a comment or of a node that the outputs do not need.
- `Lightharmony Layer` picks one of the layers.
"""

import hashlib
import itertools
import os
import pathlib
import struct
import tempfile
import threading
import zlib

import lightharmony
import numpy


class Failed(Exception):
    """The node cannot run. The message is shown at the node."""


def settings_of(text):
    """The settings of a text with one `node.field=value` on each line. Empty lines and lines with `#` are skipped."""
    found = {}
    for number, line in enumerate(text.splitlines(), 1):
        line = line.strip()
        if line and not line.startswith("#"):
            place, equals, value = line.partition("=")
            if not equals or "." not in place:
                raise Failed(f"line {number} of the settings: `{line}` is not `node.field=value`")
            found[place.strip()] = value.strip()
    return found


def names_of(text):
    """The names in a text, separated by commas or white space."""
    return text.replace(",", " ").split()


def display(linear):
    """Linear light as values of a display: the curve of sRGB, clipped to 0 to 1."""
    value = numpy.clip(linear, 0.0, 1.0)
    return numpy.where(value <= 0.0031308, 12.92 * value, 1.055 * numpy.power(value, 1 / 2.4) - 0.055).astype(numpy.float32)


def stacked(value, name):
    """The views of a picture as an array (views, height, width, channels)."""
    views = list(value.values()) if isinstance(value, dict) else [value]
    if not all(isinstance(view, numpy.ndarray) for view in views):
        raise Failed(f"`{name}` is not a picture")
    if len({view.shape for view in views}) != 1:
        raise Failed(f"the views of `{name}` have different sizes")
    return numpy.stack(views)


def tensor(array):
    """An array as a tensor of torch, which ComfyUI uses; without torch, the array itself."""
    array = numpy.ascontiguousarray(array, numpy.float32)
    try:
        import torch
    except ImportError:
        return array
    return torch.from_numpy(array)


def image_of(array):
    """An IMAGE: display values (views, height, width, 3). One channel becomes grey, and alpha is removed."""
    colours = array[..., :3] if array.shape[-1] >= 3 else numpy.repeat(array[..., :1], 3, axis=-1)
    return tensor(display(colours))


def write_png(path, picture):
    """Writes display values (height, width, 3) from 0 to 1 as PNG of 16 bits per channel."""
    height, width, _ = picture.shape
    rows = numpy.rint(65535 * numpy.clip(picture, 0, 1)).astype(">u2")
    rows = b"".join(b"\0" + row.tobytes() for row in rows)

    def chunk(name, data):
        return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))

    header = chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 16, 2, 0, 0, 0)) + chunk(b"sRGB", b"\0")
    data = b"\x89PNG\r\n\x1a\n" + header + chunk(b"IDAT", zlib.compress(rows, 1)) + chunk(b"IEND", b"")
    temporary = f"{path}.{os.getpid()}.new"
    with open(temporary, "wb") as file:
        file.write(data)
    os.replace(temporary, path)


def background_file(images):
    """Writes the first picture of a batch to a file named by its content. Returns the path."""
    picture = numpy.asarray(images, numpy.float32)[0, ..., :3]
    digest = hashlib.sha256(repr(picture.shape).encode() + picture.tobytes()).hexdigest()[:32]
    try:
        import folder_paths

        folder = folder_paths.get_temp_directory()
    except ImportError:
        folder = os.path.join(tempfile.gettempdir(), "lightharmony-comfyui")
    os.makedirs(folder, exist_ok=True)
    path = os.path.join(folder, f"lightharmony-{digest}.png")
    if not os.path.exists(path):
        write_png(path, picture)
    return path


def interrupted():
    """True if the user has cancelled the workflow."""
    try:
        from comfy import model_management
    except ImportError:
        return False
    return model_management.processing_interrupted()


class Progress:
    """The progress bar at the node."""

    def __init__(self):
        try:
            from comfy.utils import ProgressBar

            self.bar = ProgressBar(100)
        except ImportError:
            self.bar = None

    def __call__(self, event):
        if self.bar and event["event"] == "progress":
            self.bar.update_absolute(int(100 * event["fraction"]))


def cancelled_by(stop, done):
    """Sets `stop` when the user cancels. Ends when `done` is set."""
    while not done.wait(0.1):
        if interrupted():
            stop.set()
            return


class Run:
    """Computes outputs of a graph."""

    CATEGORY = "lightharmony"
    FUNCTION = "run"
    RETURN_TYPES = ("IMAGE", "MASK", "LIGHTHARMONY_LAYERS")
    RETURN_NAMES = ("image", "mask", "layers")
    DESCRIPTION = "Runs a lightharmony graph. It runs again exactly if a key of the graph has changed."

    # For each set of inputs: the token that ComfyUI has, the keys of its result, and the background that it used.
    _runs = {}
    # The token of the next run of each set of inputs.
    _next = {}
    _tokens = itertools.count()

    @classmethod
    def INPUT_TYPES(cls):
        text = {"default": ""}
        return {
            "required": {
                "graph": ("STRING", {"default": "graph.ron", "tooltip": "Path of the graph file"}),
                "settings": ("STRING", {**text, "multiline": True, "tooltip": "One node.field=value on each line"}),
                "image": ("STRING", {"default": "final", "tooltip": "The output that becomes IMAGE"}),
                "mask": ("STRING", {"default": "trace.object", "tooltip": "The output whose alpha, or only channel, becomes MASK; empty for no mask"}),
                "layers": ("STRING", {**text, "tooltip": "Outputs that become layers, such as trace.depth, shadow"}),
                "background_node": ("STRING", {"default": "plate", "tooltip": "The LoadImage node whose file is the background"}),
            },
            "optional": {"background": ("IMAGE",)},
        }

    @classmethod
    def VALIDATE_INPUTS(cls, graph, settings):
        try:
            mistakes = lightharmony.check(graph, set=settings_of(settings))
        except (Failed, lightharmony.Error, ValueError) as error:
            return str(error)
        return "\n".join(map(str, mistakes)) or True

    @staticmethod
    def _identity(graph, settings, image, mask, layers, background_node):
        return os.path.abspath(graph), settings, image, mask, layers, background_node

    @staticmethod
    def _outputs(image, mask, layers):
        return list(dict.fromkeys(names_of(" ".join([image, mask, layers]))))

    @staticmethod
    def _settings(settings, background_node, path):
        found = settings_of(settings)
        if path:
            found[f"{background_node}.path"] = pathlib.PurePath(path)
        return found

    @classmethod
    def IS_CHANGED(cls, graph, settings, image, mask, layers, background_node, background=None):
        """A value that differs from that of the last run exactly if a key has changed. ComfyUI itself notices another
        background, which it does not pass to this function."""
        inputs = cls._identity(graph, settings, image, mask, layers, background_node)
        if inputs in cls._runs:
            token, keys, path = cls._runs[inputs]
            found = lightharmony.keys(graph, cls._outputs(image, mask, layers), set=cls._settings(settings, background_node, path))
            if found == keys:
                return token
        # It will run; the keys of the result are not known yet.
        cls._next[inputs] = f"run {next(cls._tokens)}"
        return cls._next[inputs]

    def run(self, graph, settings, image, mask, layers, background_node, background=None):
        path = background_file(background) if background is not None else None
        set = self._settings(settings, background_node, path)
        outputs = self._outputs(image, mask, layers)
        stop, done = threading.Event(), threading.Event()
        watcher = threading.Thread(target=cancelled_by, args=(stop, done), daemon=True)
        watcher.start()
        try:
            values = lightharmony.values(graph, outputs, set=set, encoding="Linear", on_event=Progress(), cancel=stop)
        except lightharmony.Cancelled:
            try:
                from comfy import model_management
            except ImportError:
                raise
            model_management.throw_exception_if_processing_interrupted()
            raise
        finally:
            done.set()
            watcher.join()
        pictures = {name: stacked(value, name) for name, value in values.items()}
        main = pictures[image.strip()]
        if mask.strip():
            alpha = pictures[mask.strip()][..., -1]
        else:
            alpha = numpy.zeros(main.shape[:3], numpy.float32)
        inputs = self._identity(graph, settings, image, mask, layers, background_node)
        keys = lightharmony.keys(graph, outputs, set=set)
        token = self._next.pop(inputs, None) or (self._runs[inputs][0] if inputs in self._runs else "run")
        self._runs[inputs] = token, keys, path
        chosen = {name: pictures[name] for name in names_of(layers)}
        return image_of(main), tensor(alpha), chosen


class Layer:
    """Picks one of the layers."""

    CATEGORY = "lightharmony"
    FUNCTION = "pick"
    RETURN_TYPES = ("IMAGE", "MASK")
    RETURN_NAMES = ("image", "mask")
    DESCRIPTION = "One layer of a lightharmony graph. Data such as depth are divided by their largest finite value."

    @classmethod
    def INPUT_TYPES(cls):
        return {
            "required": {
                "layers": ("LIGHTHARMONY_LAYERS",),
                "name": ("STRING", {"default": "trace.depth"}),
                "data": ("BOOLEAN", {"default": False, "tooltip": "True for data such as depth, which are not colours"}),
            }
        }

    def pick(self, layers, name, data):
        if name not in layers:
            raise Failed(f"there is no layer `{name}`; the layers are {', '.join(layers) or 'empty'}")
        value = layers[name]
        if data:
            finite = numpy.isfinite(value)
            top = value[finite].max() if finite.any() else 1.0
            value = numpy.where(finite, value / max(float(top), 1e-12), 1.0)
            grey = value[..., :3] if value.shape[-1] >= 3 else numpy.repeat(value[..., :1], 3, axis=-1)
            return tensor(numpy.clip(grey, 0, 1)), tensor(numpy.clip(value[..., -1], 0, 1))
        return image_of(value), tensor(numpy.clip(value[..., -1], 0, 1))


NODE_CLASS_MAPPINGS = {"LightharmonyRun": Run, "LightharmonyLayer": Layer}
NODE_DISPLAY_NAME_MAPPINGS = {"LightharmonyRun": "Lightharmony Run", "LightharmonyLayer": "Lightharmony Layer"}
