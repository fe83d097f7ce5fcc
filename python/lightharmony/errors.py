"""Errors of the module, and the places of mistakes."""

from __future__ import annotations

import dataclasses
import typing


@dataclasses.dataclass(frozen=True)
class Mistake:
    """A mistake in a graph, or the failure of a node, with its place."""

    file: str
    """Name of the file: the graph, an included file, an overlay, or the command line."""
    line: int
    """Line, from 1."""
    column: int
    """Column in characters, from 1."""
    length: int
    """Length of the marked text in characters."""
    code: str
    """Category, such as `unknown-field`."""
    message: str
    """Description."""
    label: str = ""
    """Text for the marked place."""
    hints: tuple[str, ...] = ()
    """Advice on how to correct the mistake."""

    @classmethod
    def of(cls, data: dict) -> Mistake:
        """The mistake of one entry in the `list` of an event `mistakes`."""
        names = {field.name for field in dataclasses.fields(cls)}
        known = {name: value for name, value in data.items() if name in names}
        return cls(**{**known, "hints": tuple(known.get("hints", ()))})

    def __str__(self) -> str:
        hints = "".join(f"\n  help: {hint}" for hint in self.hints)
        return f"{self.file}:{self.line}:{self.column}: {self.message}{hints}"


class Error(Exception):
    """Base class of all errors of this module."""


class ProgramNotFound(Error):
    """The program `lightharmony` was not found, or cannot be started."""


class VersionMismatch(Error):
    """The program has a version other than that of this module."""

    def __init__(self, program: str, found: str, wanted: str):
        super().__init__(
            f"`{program}` is version {found}, but this module needs version {wanted}; install both from one release"
        )
        self.program, self.found, self.wanted = program, found, wanted


class ProgramError(Error):
    """The program ended with an error that has no place in a graph."""

    def __init__(self, message: str, code: int):
        super().__init__(message)
        self.code = code


class _WithMistakes(Error):
    def __init__(self, mistakes: typing.Sequence[Mistake]):
        super().__init__("\n".join(map(str, mistakes)))
        self.mistakes = list(mistakes)


class GraphError(_WithMistakes):
    """The graph, an overlay or a setting has mistakes. `mistakes` has their places."""


class NodeFailed(_WithMistakes):
    """Nodes failed. `mistakes` has the places of these nodes, and `run` the outcome of the other nodes."""

    def __init__(self, mistakes: typing.Sequence[Mistake], run: typing.Any):
        super().__init__(mistakes)
        self.run = run


class Cancelled(Error):
    """The run was cancelled. Its finished results are in the cache."""
