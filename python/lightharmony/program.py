"""The program: where it is, which version it is, and its processes."""

from __future__ import annotations

import atexit
import json
import os
import queue
import shutil
import signal
import subprocess
import sys
import sysconfig
import threading
import typing
import weakref

from .errors import Error, GraphError, Mistake, ProgramError, ProgramNotFound, VersionMismatch

VARIABLE = "LIGHTHARMONY_PROGRAM"
"""Environment variable that names the program."""

GRACE = 10.0
"""Time in seconds that a cancelled process has before it is killed."""

_NAME = "lightharmony.exe" if os.name == "nt" else "lightharmony"
_HOW = f"install it, add its folder to PATH, or name it with the environment variable {VARIABLE}"

_versions: dict[tuple, str] = {}
_running: weakref.WeakSet = weakref.WeakSet()


def find(program: str | os.PathLike | None = None) -> str:
    """Path of the program.

    `program` is used if given, otherwise the file that the environment variable `LIGHTHARMONY_PROGRAM` names. Without
    both, the program that the wheel installed is used, or else the first one on PATH.

    Raises `ProgramNotFound`. If a program is named, no other one is tried.
    """
    for named, by in ((program, "the argument `program`"), (os.environ.get(VARIABLE), VARIABLE)):
        if named:
            path = shutil.which(os.fspath(named))
            if path is None:
                raise ProgramNotFound(f"`{os.fspath(named)}`, named by {by}, is not a program")
            return os.path.abspath(path)
    for folder in _script_folders():
        path = os.path.join(folder, _NAME)
        if os.path.isfile(path) and os.access(path, os.X_OK):
            return path
    path = shutil.which("lightharmony")
    if path is None:
        raise ProgramNotFound(f"the program `lightharmony` was not found; {_HOW}")
    return os.path.abspath(path)


def _script_folders() -> typing.Iterator[str]:
    """Folders into which installers put the program of a wheel, next to this module."""
    here = os.path.dirname(os.path.abspath(__file__))
    yield here
    site = os.path.dirname(here)
    # `pip install --target`
    yield os.path.join(site, "bin")
    for scheme in (None, "nt_user" if os.name == "nt" else "posix_user"):
        paths = sysconfig.get_paths() if scheme is None else sysconfig.get_paths(scheme)
        # A program of another environment may have another version.
        if os.path.normcase(site) in (os.path.normcase(paths["purelib"]), os.path.normcase(paths["platlib"])):
            yield paths["scripts"]


def version(program: str) -> str:
    """Version of the program at this path, such as `0.1.0`."""
    try:
        status = os.stat(program)
        stamp = (program, status.st_size, status.st_mtime_ns, status.st_ino)
        if stamp not in _versions:
            done = subprocess.run(
                [program, "--version"], stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=30
            )
            name, _, number = done.stdout.strip().partition(" ")
            if done.returncode or name != "lightharmony" or not number:
                raise ProgramNotFound(f"`{program}` is not lightharmony")
            _versions[stamp] = number
        return _versions[stamp]
    except (OSError, UnicodeDecodeError, subprocess.TimeoutExpired) as error:
        raise ProgramNotFound(f"`{program}` cannot be started: {error}") from error


def checked(program: str | os.PathLike | None = None) -> str:
    """Path of the program, which has the version of this module.

    Raises `ProgramNotFound` or `VersionMismatch`.
    """
    from . import __version__

    path = find(program)
    found = version(path)
    if found != __version__:
        raise VersionMismatch(path, found, __version__)
    return path


class Process:
    """A process of the program, which prints JSON lines. It has a process group of its own.

    With `stops`, the command has the option `--stop-at-eof`: it also ends if this process is killed. `text` is its
    standard input otherwise.
    """

    def __init__(
        self, arguments: typing.Sequence[str], program: str | os.PathLike | None = None, cwd=None, stops=False, text=""
    ):
        command = [checked(program), *arguments, *(["--stop-at-eof"] if stops else [])]
        group = {"creationflags": subprocess.CREATE_NEW_PROCESS_GROUP} if os.name == "nt" else {"start_new_session": True}
        try:
            self._process = subprocess.Popen(
                command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, cwd=cwd, **group
            )
        except OSError as error:
            raise ProgramNotFound(f"`{command[0]}` cannot be started: {error}") from error
        self._events: queue.Queue = queue.Queue()
        self._errors: list[bytes] = []
        self._readers = [threading.Thread(target=work, daemon=True) for work in (self._read, self._read_errors)]
        for reader in self._readers:
            reader.start()
        self.cancelled = False
        self._ended = False
        _running.add(self)
        if not stops:
            try:
                with self._process.stdin as pipe:
                    pipe.write(text.encode())
            except BrokenPipeError:
                # The process has ended; its exit code states why.
                pass

    def _read(self) -> None:
        for line in self._process.stdout:
            try:
                event = json.loads(line)
            except ValueError:
                event = None
            if isinstance(event, dict) and "event" in event:
                self._events.put(event)
            else:
                self._errors.append(b"unexpected output: " + line)
        self._events.put(None)

    def _read_errors(self) -> None:
        for line in self._process.stderr:
            self._errors.append(line)

    @property
    def errors(self) -> str:
        """Lines that the process printed to standard error so far."""
        return b"".join(self._errors).decode("utf-8", "replace")

    def get(self, timeout: float | None = None) -> dict | None:
        """The next event. `None` if the process has ended, or if there was no event within `timeout` seconds."""
        if self._ended:
            return None
        while True:
            try:
                # On Windows, Ctrl-C does not interrupt a wait without a limit.
                event = self._events.get(timeout=0.5) if timeout is None else self._events.get(timeout > 0, timeout)
                break
            except queue.Empty:
                if timeout is not None:
                    return None
        self._ended = event is None
        return event

    @property
    def ended(self) -> bool:
        """True if all events were returned and the process prints no more."""
        return self._ended

    def wait(self) -> int:
        """Waits for the end of the process. Returns its exit code, which is negative if a signal ended it."""
        code = self._process.wait()
        self._close()
        return code

    def _close(self) -> None:
        # A process that outlived the group, such as one that became a daemon, may hold the pipes open.
        for reader in self._readers:
            reader.join(2.0)
        self._process.stdin.close()
        for reader, pipe in zip(self._readers, (self._process.stdout, self._process.stderr)):
            if not reader.is_alive():
                pipe.close()
        _running.discard(self)

    def cancel(self, grace: float = GRACE) -> None:
        """Ends the process and all processes that it started.

        The program gets Ctrl-C first, so that it keeps finished results and leaves no partial file. After `grace`
        seconds the whole group is killed.
        """
        self.cancelled = True
        if self._process.poll() is not None and self not in _running:
            return
        if self._process.poll() is None:
            self._signal(getattr(signal, "CTRL_BREAK_EVENT", signal.SIGINT))
            try:
                self._process.wait(grace)
            except subprocess.TimeoutExpired:
                pass
        self._kill()
        self._process.wait()
        self._close()

    def _signal(self, number: int) -> None:
        try:
            if os.name == "nt":
                self._process.send_signal(number)
            else:
                os.killpg(self._process.pid, number)
        except (ProcessLookupError, PermissionError, OSError):
            # The group has ended.
            pass

    def _kill(self) -> None:
        if os.name == "nt":
            self._process.kill()
        else:
            self._signal(signal.SIGKILL)


@atexit.register
def _cancel_all() -> None:
    for process in list(_running):
        process.cancel(1.0)


def failure(events: typing.Sequence[dict], code: int, errors: str) -> Error:
    """The error for a process that ended with an exit code other than that of success."""
    mistakes = [Mistake.of(one) for event in events if event["event"] == "mistakes" for one in event["list"]]
    if mistakes:
        return GraphError(mistakes)
    messages = [event["message"] for event in events if event["event"] == "error"]
    text = "\n".join(messages) or errors.strip()
    return ProgramError(text or f"lightharmony ended with exit code {code}", code)


def call(arguments: typing.Sequence[str], program=None, cwd=None, accept=(0,)) -> list[dict]:
    """Runs a command that takes little time. Returns its events; raises an error for other exit codes."""
    process = Process(arguments, program, cwd)
    events = []
    try:
        while (event := process.get()) is not None:
            events.append(event)
        code = process.wait()
    except BaseException:
        process.cancel(1.0)
        raise
    if code not in accept:
        raise failure(events, code, process.errors)
    return events


def main() -> int:
    """Runs the program with the arguments of this process: `python -m lightharmony run graph.ron`."""
    try:
        path = checked()
    except Error as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    if os.name != "nt":
        os.execv(path, [path, *sys.argv[1:]])
    return subprocess.call([path, *sys.argv[1:]])
