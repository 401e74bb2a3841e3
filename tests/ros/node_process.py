"""The package's executables as processes that start from a server which has imported them: a second less each time.

What runs is the executable's own ``main`` in a process of its own; only the imports have been done before.
"""

from __future__ import annotations

import importlib
import multiprocessing
import os
import signal
import subprocess
import sys
from collections.abc import Mapping, Sequence
from contextlib import suppress
from importlib.metadata import entry_points
from pathlib import Path

MODULES = {
    entry.name: entry.module for entry in entry_points(group="console_scripts") if entry.module.startswith("fopid_ros.")
}
NODES = ("plant_simulator", "fopid_controller", "fopid_tuner")

_server = multiprocessing.get_context("forkserver")
_server.set_forkserver_preload([MODULES[name] for name in NODES])


def _run(module: str, arguments: Sequence[str], environment: Mapping[str, str], log: Path) -> None:
    """In the new process: become the executable."""
    sink = os.open(log, os.O_WRONLY | os.O_APPEND)
    for stream in (1, 2):
        os.dup2(sink, stream)
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    if "LD_PRELOAD" in environment:  # counts from a process's first instruction on
        os.execve(Path(sys.executable).with_name(arguments[0]), arguments, environment)
    os.environ.clear()
    os.environ.update(environment)
    sys.argv = list(arguments)
    sys.exit(importlib.import_module(module).main())


class NodeProcess:
    """One running executable, with the part of ``subprocess.Popen``'s interface that the tests use."""

    def __init__(self, executable: str, arguments: Sequence[str], environment: Mapping[str, str], log: Path) -> None:
        self.log = log
        log.touch()
        call = (MODULES[executable], [executable, *arguments], dict(environment), log)
        self._process = _server.Process(target=_run, args=call, name=executable)
        self._process.start()

    @property
    def pid(self) -> int:
        """Its process id."""
        return self._process.pid

    @property
    def returncode(self) -> int | None:
        """Exit code; negative after a signal, None while it runs."""
        return self._process.exitcode

    def poll(self) -> int | None:
        """The exit code, as ``returncode``."""
        return self._process.exitcode

    def wait(self, timeout: float | None = None) -> int:
        """Wait for the end; raises ``subprocess.TimeoutExpired``."""
        self._process.join(timeout)
        if self._process.exitcode is None:
            raise subprocess.TimeoutExpired(self._process.name, timeout)
        return self._process.exitcode

    def send_signal(self, number: int) -> None:
        """Send a signal, unless it has ended."""
        if self._process.exitcode is None:
            with suppress(ProcessLookupError):  # it has ended since, and its exit code is still on the way
                os.kill(self.pid, number)

    def terminate(self) -> None:
        """Send SIGTERM."""
        self.send_signal(signal.SIGTERM)

    def kill(self) -> None:
        """Send SIGKILL."""
        self.send_signal(signal.SIGKILL)
