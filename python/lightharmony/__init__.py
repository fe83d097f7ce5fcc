"""lightharmony in Python: runs graphs, watches them, and reads their values as NumPy arrays.

    import lightharmony

    done = lightharmony.run("graph.ron", set={"trace.samples": 16}, out="out")
    print(done.files)
    depth = lightharmony.values("graph.ron", ["trace.depth"])["trace.depth"]

    with lightharmony.watch("graph.ron") as watch:
        for event in watch:
            print(event)

The work is done by the program `lightharmony`, which the wheel contains; see `lightharmony.program.find`. Everything
here is pure Python. NumPy is needed only to read values.
"""

from __future__ import annotations

import dataclasses
import json
import os
import pathlib
import re
import tempfile
import threading
import typing

from . import program as _program
from .errors import (
    Cancelled,
    Error,
    GraphError,
    Mistake,
    NodeFailed,
    ProgramError,
    ProgramNotFound,
    VersionMismatch,
)
from .program import Process

__version__ = "0.1.0"

__all__ = [
    "Cancelled", "Error", "GraphError", "Kind", "Mistake", "Node", "NodeFailed", "Note", "Plan", "Planned",
    "ProgramError", "ProgramNotFound", "Run", "VersionMismatch", "Watch", "check", "keys", "nodes", "plan", "run", "values",
    "watch",
]

Path = typing.Union[str, "os.PathLike[str]"]


@dataclasses.dataclass(frozen=True)
class Note:
    """A note of a node."""

    node: str
    """Name of the node."""
    level: str
    """`count`, `decision`, `warning` or `degraded`."""
    id: str
    """Stable name, such as `no-variance`."""
    text: str


@dataclasses.dataclass(frozen=True)
class Node:
    """The outcome of a node."""

    id: str
    kind: str
    state: str
    """`ran`, `cached`, `failed` or `skipped`."""
    key: typing.Optional[str]
    """Key of the result as 64 hexadecimal digits. `None` if a node that it depends on failed."""
    seconds: float
    degraded: bool
    notes: typing.List[Note]
    error: typing.Optional[str] = None


@dataclasses.dataclass
class Run:
    """The outcome of a run."""

    code: int = 0
    """Exit code: 0 done, 1 a node failed, 3 degraded."""
    files: typing.List[pathlib.Path] = dataclasses.field(default_factory=list)
    """Files of the sinks, whether they were written or were up to date."""
    nodes: typing.Dict[str, Node] = dataclasses.field(default_factory=dict)
    """Nodes by name. If nothing has changed since an earlier run, these are the nodes of that run."""
    warnings: typing.List[str] = dataclasses.field(default_factory=list)
    """Warnings that concern the graph as a whole."""
    totals: dict = dataclasses.field(default_factory=dict)
    """The event `done`: numbers of nodes by state, seconds, counts."""
    _sinks: typing.Dict[str, typing.List[pathlib.Path]] = dataclasses.field(default_factory=dict)

    @property
    def degraded(self) -> bool:
        """True if a result is worse than what the graph asks for. The notes state why."""
        return self.code == 3

    @property
    def notes(self) -> typing.List[Note]:
        """The notes of all nodes."""
        return [note for node in self.nodes.values() for note in node.notes]

    def files_of(self, sink: str) -> typing.List[pathlib.Path]:
        """Files of one sink."""
        return self._sinks.get(sink, [])

    def _add(self, event: dict, folder: pathlib.Path) -> None:
        name = event["event"]
        if name == "file":
            path = folder / event["path"]
            self.files.append(path)
            self._sinks.setdefault(event["id"].split("/")[0], []).append(path)
        elif name == "node":
            notes = [Note(event["id"], note["level"], note["id"], note["text"]) for note in event["notes"]]
            fields = ("id", "kind", "state", "key", "seconds", "degraded")
            self.nodes[event["id"]] = Node(*(event.get(key) for key in fields), notes, event.get("error"))
        elif name == "warning":
            self.warnings.append(event["text"])
        elif name == "done":
            self.totals = event


@dataclasses.dataclass(frozen=True)
class Planned:
    """The plan of a node."""

    id: str
    kind: str
    fate: str
    """`known`, `runs`, `follows` (it may run, depending on the result of another node), `lost` or `fails`."""
    why: str
    key: typing.Optional[str]
    """Key of the node. `None` if it depends on a result that is not known yet."""
    forecast: typing.Optional[float]
    """Forecast of the time in seconds. `None` if the node does not run or its kind has not run before."""


@dataclasses.dataclass(frozen=True)
class Plan:
    """What a run would do."""

    nodes: typing.List[Planned]
    seconds: float
    """Forecast of the time in seconds of all nodes with a forecast."""

    @property
    def known(self) -> bool:
        """True if every result is in the cache."""
        return all(node.fate == "known" for node in self.nodes)


class Kind(typing.Dict[str, typing.Any]):
    """The description of a kind of node: `name`, `graph_name`, `version`, `stage`, `doc`, `parameters`, `inputs` and
    `outputs`, as `lightharmony nodes --json` prints them."""


def _ron(value: typing.Any) -> str:
    """A value of Python as the text of a setting. Text is passed as on the command line: `samples=16`, `method=Learned`."""
    if hasattr(value, "tolist"):
        # A NumPy array or number.
        value = value.tolist()
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return value
    if isinstance(value, os.PathLike):
        return json.dumps(os.fspath(value), ensure_ascii=False)
    if isinstance(value, (int, float)):
        return repr(value)
    if isinstance(value, (list, tuple)):
        texts = [json.dumps(item, ensure_ascii=False) if isinstance(item, str) else _ron(item) for item in value]
        ends = "[]" if isinstance(value, list) else "()"
        return ends[0] + ", ".join(texts) + ends[1]
    if value is None:
        return "None"
    raise TypeError(f"a value of type {type(value).__name__} cannot be a setting; write it as text in RON")


def _many(value: typing.Any) -> list:
    return [value] if isinstance(value, (str, os.PathLike)) else list(value)


def _graph(graph: Path, set=None, preset=(), overlay=(), only=(), frames=None) -> typing.List[str]:
    """Arguments that select the graph and its settings."""
    arguments = [os.fspath(graph)]
    if arguments[0].startswith("-"):
        raise ValueError("the graph must be the path of a file")
    arguments += [f"--set={place}={_ron(value)}" for place, value in (set or {}).items()]
    arguments += [f"--preset={name}" for name in _many(preset)]
    arguments += [f"--overlay={os.fspath(path)}" for path in _many(overlay)]
    if names := _many(only):
        arguments.append("--only=" + ",".join(names))
    if frames is not None:
        arguments.append(f"--frames={frames}")
    return arguments


def _engine(cache=None, jobs=None, memory=None, out=None) -> typing.List[str]:
    """Arguments for the cache, threads, memory and the output folder."""
    named = {"cache": cache, "jobs": jobs, "memory": memory, "out": out}
    return [f"--{name}={value}" for name, value in named.items() if value is not None]


def run(
    graph: Path,
    *,
    set: typing.Optional[typing.Mapping[str, typing.Any]] = None,
    preset: typing.Union[str, typing.Sequence[str]] = (),
    overlay: typing.Union[Path, typing.Sequence[Path]] = (),
    only: typing.Union[str, typing.Sequence[str]] = (),
    frames: typing.Optional[str] = None,
    out: Path = "out",
    cache: typing.Optional[Path] = None,
    jobs: typing.Optional[int] = None,
    memory: typing.Optional[str] = None,
    on_event: typing.Optional[typing.Callable[[dict], None]] = None,
    cancel: typing.Optional[threading.Event] = None,
    program: typing.Optional[Path] = None,
) -> Run:
    """Runs a graph: computes what is not cached and writes the files of its sinks into the folder `out`.

    The arguments are the options of `lightharmony run` with the same names. `set` maps `node.field` to a value: a
    number, a truth value, a list, a tuple, a path, or text as on the command line. `on_event` gets each event, such as
    `{"event": "progress", "id": "trace", "fraction": 0.5}`. If `cancel` is set by another thread, the run ends.

    Raises `GraphError` for mistakes, `NodeFailed` if nodes failed, `Cancelled`, `ProgramError` for other errors, and
    `ProgramNotFound` or `VersionMismatch` before anything runs.
    """
    arguments = ["run", "--json", *_graph(graph, set, preset, overlay, only, frames)]
    arguments += _engine(cache, jobs, memory, os.fspath(out))
    return _finish(Process(arguments, program, stops=True), on_event, cancel)


def _finish(process: Process, on_event, cancel) -> Run:
    """Handles the events of a run until it ends."""
    done, folder, kept = Run(), pathlib.Path.cwd(), []
    try:
        while True:
            event = process.get(None if cancel is None else 0.1)
            if cancel is not None and cancel.is_set():
                process.cancel()
                raise Cancelled("the run was cancelled")
            if event is None:
                if process.ended:
                    break
                continue
            done._add(event, folder)
            if event["event"] in ("mistakes", "error"):
                kept.append(event)
            if on_event:
                on_event(event)
        done.code = process.wait()
    except BaseException:
        process.cancel()
        raise
    if done.code == 130:
        raise Cancelled("the run was interrupted")
    if done.code == 1 and done.totals:
        raise NodeFailed([Mistake.of(one) for event in kept for one in event.get("list", ())], done)
    if done.code not in (0, 3):
        raise _program.failure(kept, done.code, process.errors)
    return done


class Watch:
    """A graph that runs again after each change. Iterates over the events.

    Ends the program when it is closed, at the end of a `with` block, or when it is garbage. Mistakes in the graph are
    events (`mistakes`), since the next save may correct them; `mistakes_of` reads them.
    """

    def __init__(self, process: Process):
        self._process = process
        self._kept: typing.List[dict] = []

    def __iter__(self) -> typing.Iterator[dict]:
        while (event := self.get()) is not None:
            yield event

    def get(self, timeout: typing.Optional[float] = None) -> typing.Optional[dict]:
        """The next event. `None` after `timeout` seconds without an event, or when the watch has been closed.

        Raises an error if the program ends by itself.
        """
        event = self._process.get(timeout)
        if event is not None:
            if event["event"] == "error":
                self._kept.append(event)
        elif self._process.ended and not self._process.cancelled:
            code = self._process.wait()
            raise _program.failure(self._kept, code, self._process.errors)
        return event

    def poll(self) -> typing.List[dict]:
        """The events that have arrived since the last call, without waiting."""
        found = []
        while (event := self.get(0)) is not None:
            found.append(event)
        return found

    @staticmethod
    def mistakes_of(event: dict) -> typing.List[Mistake]:
        """The mistakes of an event `mistakes`, with their places."""
        return [Mistake.of(one) for one in event.get("list", ())]

    def close(self) -> None:
        """Ends the program and all processes that it started."""
        self._process.cancel()

    def __enter__(self) -> Watch:
        return self

    def __exit__(self, *_: typing.Any) -> None:
        self.close()

    def __del__(self) -> None:
        if not self._process.cancelled:
            self._process.cancel(1.0)


def watch(
    graph: Path,
    *,
    set: typing.Optional[typing.Mapping[str, typing.Any]] = None,
    preset: typing.Union[str, typing.Sequence[str]] = (),
    overlay: typing.Union[Path, typing.Sequence[Path]] = (),
    only: typing.Union[str, typing.Sequence[str]] = (),
    frames: typing.Optional[str] = None,
    out: Path = "out",
    cache: typing.Optional[Path] = None,
    jobs: typing.Optional[int] = None,
    memory: typing.Optional[str] = None,
    previews: bool = True,
    poll: bool = False,
    program: typing.Optional[Path] = None,
) -> Watch:
    """Runs a graph again whenever it or a file that it reads changes. Returns an iterator of events.

    The events are those of `run`, and those of watching: `plan`, `pass`, `same`, `stale`, `mistakes`, `idle`. After
    `idle`, nothing happens until a file changes. `previews=False` skips rough previews; `poll=True` checks the files
    every half second instead of listening to their folders.
    """
    arguments = ["watch", "--json", *_graph(graph, set, preset, overlay, only, frames)]
    arguments += _engine(cache, jobs, memory, os.fspath(out))
    arguments += [] if previews else ["--no-preview"]
    arguments += ["--poll"] if poll else []
    return Watch(Process(arguments, program, stops=True))


def plan(
    graph: Path,
    *,
    set: typing.Optional[typing.Mapping[str, typing.Any]] = None,
    preset: typing.Union[str, typing.Sequence[str]] = (),
    overlay: typing.Union[Path, typing.Sequence[Path]] = (),
    only: typing.Union[str, typing.Sequence[str]] = (),
    frames: typing.Optional[str] = None,
    cache: typing.Optional[Path] = None,
    program: typing.Optional[Path] = None,
) -> Plan:
    """What a run would compute, why, and about how long it takes.

    Raises `GraphError` for mistakes in the graph.
    """
    arguments = ["plan", "--json", *_graph(graph, set, preset, overlay, only, frames), *_engine(cache)]
    # 1: a node would fail, which its plan states.
    events = _program.call(arguments, program, accept=(0, 1))
    found = [event for event in events if event["event"] == "planned"]
    fields = ("id", "kind", "fate", "why", "key", "forecast")
    total = next((event["seconds"] for event in events if event["event"] == "plan"), 0.0)
    return Plan([Planned(*(event.get(field) for field in fields)) for event in found], total)


def check(
    graph: Path,
    *,
    set: typing.Optional[typing.Mapping[str, typing.Any]] = None,
    preset: typing.Union[str, typing.Sequence[str]] = (),
    overlay: typing.Union[Path, typing.Sequence[Path]] = (),
    program: typing.Optional[Path] = None,
) -> typing.List[Mistake]:
    """Every mistake in a graph, without running it. Empty if there are none."""
    try:
        _program.call(["check", "--json", *_graph(graph, set, preset, overlay)], program)
    except GraphError as error:
        return error.mistakes
    return []


def nodes(kind: typing.Optional[str] = None, *, program: typing.Optional[Path] = None) -> typing.Dict[str, Kind]:
    """Descriptions of all kinds of nodes by name, or only that of `kind`, such as `splat-render` or `SplatRender`."""
    events = _program.call(["nodes", "--json", *([] if kind is None else [kind])], program)
    return {event["name"]: Kind(event) for event in events if event["event"] == "kind"}


# Sinks by the type of the value that they write, with the extension of their files.
_SINKS = {
    "image": ("WriteExr", "image", "exr"),
    "pano": ("WriteExr", "image", "exr"),
    "env": ("WriteExr", "image", "exr"),
    "views": ("WriteExr", "image", "exr"),
    "mesh": ("WriteMesh", "mesh", "ply"),
    "report": ("WriteReport", "report", "json"),
}


def values(
    graph: Path,
    outputs: typing.Sequence[str],
    *,
    set: typing.Optional[typing.Mapping[str, typing.Any]] = None,
    encoding: str = "Keep",
    cache: typing.Optional[Path] = None,
    jobs: typing.Optional[int] = None,
    memory: typing.Optional[str] = None,
    on_event: typing.Optional[typing.Callable[[dict], None]] = None,
    cancel: typing.Optional[threading.Event] = None,
    program: typing.Optional[Path] = None,
) -> typing.Dict[str, typing.Any]:
    """Values of outputs, such as `["trace.depth", "final"]`. Computes what is not cached. Files stay in a temporary
    folder, which is removed.

    - A picture is an array of 32-bit floats of shape (height, width, channels), in the encoding of the output: splat
      renders are display-encoded, traced pictures linear, and depth in world units. Several views are a dictionary of
      such arrays by the name of the view. A panorama or an environment is its picture. `encoding` converts colours
      like the parameter of `write-exr`: `Linear` is linear light with the primaries of Rec.709.
    - A mesh is a dictionary with `positions` (n, 3), `faces` (m, 3) and, if it has colours, `colours` (n, 3) from 0
      to 255.
    - A report is the dictionary of its JSON file.

    `graph` is a graph file whose nodes do not run along an axis. Raises the errors of `run`, and `ValueError` for
    outputs that cannot be written to a file, such as splats or poses.
    """
    from . import files

    if isinstance(outputs, str):
        raise TypeError("`outputs` is a list of names")
    kinds = nodes(program=program)
    lines, sinks = [], {}
    for index, output in enumerate(outputs):
        planned = _node_of(graph, output, set, cache, program)
        node, port = planned.id, output[len(planned.id) + 1 :]
        ports = kinds[planned.kind]["outputs"]
        found = next((one for one in ports if one["name"] == port or not port), None)
        if found is None:
            known = ", ".join(one["name"] for one in ports) or "no outputs"
            raise ValueError(f"`{output}` is not an output; `{node}` has {known}")
        if found["type"] not in _SINKS:
            raise ValueError(f"`{output}` is a value of the type `{found['type']}`, which no sink writes to a file")
        kind, entry, extension = _SINKS[found["type"]]
        sink = f"value_of_python_{index}"
        name = f"{index}/{{view}}.{extension}" if kind == "WriteExr" else f"{index}.{extension}"
        more = f", recipe: false, encoding: {encoding}" if kind == "WriteExr" else ""
        lines.append(f"        {sink}: {kind}({entry}: {json.dumps(output)}, path: {json.dumps(name)}{more}),\n")
        sinks[sink] = (output, extension)
    # The graph is passed by standard input in the folder of `graph`, so that the names of its files are the same.
    home, name = os.path.split(os.path.abspath(graph))
    text = f"Graph(\n    version: 1,\n    include: [{json.dumps(name, ensure_ascii=False)}],\n    nodes: (\n{''.join(lines)}    ),\n)\n"
    cache = cache or os.environ.get("LIGHTHARMONY_CACHE") or None
    with tempfile.TemporaryDirectory(prefix="lightharmony-") as folder:
        arguments = ["run", "--json", "-", *_graph(name, set, only=list(sinks))[1:]]
        arguments += _engine(cache and os.path.abspath(cache), jobs, memory, folder)
        done = _finish(Process(arguments, program, home, text=text), on_event, cancel)
        result = {}
        for sink, (output, extension) in sinks.items():
            read = {"exr": files.read_picture, "ply": files.read_mesh, "json": files.read_report}[extension]
            found = {path.stem: read(path) for path in done.files_of(sink)}
            result[output] = next(iter(found.values())) if len(found) == 1 else found
        return result


def keys(
    graph: Path,
    outputs: typing.Sequence[str],
    *,
    set: typing.Optional[typing.Mapping[str, typing.Any]] = None,
    cache: typing.Optional[Path] = None,
    program: typing.Optional[Path] = None,
) -> typing.Dict[str, typing.Optional[str]]:
    """Keys of the nodes of outputs, without computing them. `None` if the result is not in the cache.

    A key covers everything that the result depends on: parameters, inputs, and the content of files. Two calls with
    equal keys have equal values.
    """
    if isinstance(outputs, str):
        raise TypeError("`outputs` is a list of names")
    found = {}
    for output in outputs:
        node = _node_of(graph, output, set, cache, program)
        found[output] = node.key if node.fate == "known" else None
    return found


def _node_of(graph: Path, output: str, set, cache, program) -> Planned:
    """The node of an output. The name of a node in a subgraph has a dot, so `left.env` may be a node or an output."""
    if not re.fullmatch(r"\w+(\.\w+)*", output):
        raise ValueError(f"`{output}` is not the name of an output; write `node.output`")
    node = output.rpartition(".")[0]
    for name in (output, node) if node else (output,):
        try:
            found = plan(graph, set=set, only=[name], cache=cache, program=program).nodes
        except ProgramError as error:
            # There is no node with this name.
            why = error
            continue
        for one in found:
            if one.id == name:
                return one
        raise ValueError(f"`{name}` runs along an axis; values of single instances cannot be read")
    raise ValueError(f"`{output}` is not an output: {why}") from why
