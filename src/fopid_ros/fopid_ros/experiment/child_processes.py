"""Child processes that never outlive their parent."""

from __future__ import annotations

import ctypes
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from types import TracebackType

_PR_SET_PDEATHSIG = 1
_LIBC = ctypes.CDLL(None)

STOP_TIME = 8.0
"""How long a child may take to end in good order [s]."""
INTERRUPTS = (signal.SIGINT, signal.SIGTERM)


def die_with_parent() -> None:
    """In the child: be told to stop when the parent is gone, even if it was killed outright."""
    _LIBC.prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)


@contextmanager
def interrupts_held() -> Iterator[None]:
    """Hear interrupts only at the end: what one raises in the midst of a fork, or of a lock's release, may be lost."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, INTERRUPTS)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _begin_child(parent: int) -> None:
    """In the child, whose parent holds interrupts meanwhile, and may be gone already."""
    for number in INTERRUPTS:
        signal.signal(number, signal.SIG_DFL)  # a handler of Python's would be lost with the program that follows
    signal.pthread_sigmask(signal.SIG_UNBLOCK, INTERRUPTS)
    die_with_parent()
    if os.getppid() != parent:
        os._exit(1)


def command(executable: str) -> str:
    """The path of one of this package's executables: the one installed beside the running Python."""
    for folder in (Path(sys.argv[0]).resolve().parent, Path(sys.executable).parent):
        if (folder / executable).exists():
            return str(folder / executable)
    return executable


def ros_arguments(parameters: Mapping[str, object], namespace: str = "", remaps: Sequence[str] = ()) -> list[str]:
    """``--ros-args`` for a node started with these parameters."""
    arguments = ["--ros-args"]
    for name, value in parameters.items():
        arguments += ["-p", f"{name}:={_yaml_scalar(value)}"]
    if namespace:
        arguments += ["-r", f"__ns:=/{namespace.strip('/')}"]
    for remap in remaps:
        arguments += ["-r", remap]
    return arguments


def _yaml_scalar(value: object) -> str:
    if isinstance(value, str):
        return "'" + value.replace("'", "''") + "'"
    return str(value).lower() if isinstance(value, bool) else repr(value)


class Children:
    """Processes of their own sessions, stopped together in reverse order of their start.

    A terminal's Ctrl-C reaches only the parent, which stops them one after the other.
    """

    def __init__(self) -> None:
        self._running: list[tuple[str, subprocess.Popen[bytes]]] = []

    def start(
        self,
        name: str,
        arguments: Sequence[str],
        environment: Mapping[str, str] | None = None,
        stdout: int | None = None,
    ) -> None:
        """Start a process; its stdout is this one's, or a file descriptor."""
        with interrupts_held():
            process = subprocess.Popen(
                list(arguments),
                stdin=subprocess.DEVNULL,
                stdout=stdout,
                env={**os.environ, **(environment or {})},
                start_new_session=True,
                preexec_fn=partial(_begin_child, os.getpid()),  # the parent has one thread when it starts children
            )
            self._running.append((name, process))

    def process_ids(self) -> dict[str, int]:
        """Process id of each, by name."""
        return {name: process.pid for name, process in self._running}

    def ended(self) -> tuple[str, int] | None:
        """Name and exit code of the first process that has ended, None while all run."""
        for name, process in self._running:
            if process.poll() is not None:
                return name, process.returncode
        return None

    def wait(self, name: str, timeout: float) -> int | None:
        """Exit code of a process, None if it has not ended in time."""
        process = next(p for n, p in self._running if n == name)
        try:
            return process.wait(timeout)
        except subprocess.TimeoutExpired:
            return None

    def stop(self) -> None:
        """Tell all to end, last started first, and kill what does not.

        SIGTERM, since a child that is still importing dies of it without a traceback.
        """
        deadline = time.monotonic() + STOP_TIME
        for _, process in reversed(self._running):
            if process.poll() is None:
                process.terminate()
        for _, process in reversed(self._running):
            try:
                process.wait(max(0.1, deadline - time.monotonic()))
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
        self._running.clear()

    def __enter__(self) -> Children:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()
