"""The server of the page without ROS: files for who is let in, answers for who shows the token."""

from __future__ import annotations

import asyncio
import json
import signal
import socket
from collections.abc import Mapping
from concurrent.futures import Executor, ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import dataclass, field
from importlib import resources
from multiprocessing import active_children, get_context
from pathlib import Path
from typing import Any

from tornado.web import Application, RequestHandler

from fopid_core.errors import ExpressionError, InputError
from fopid_core.study.explore.desk import AT_THE_HAND, LONG_WORK, SEARCHES, Work
from fopid_core.study.page.access import Access
from fopid_core.study.page.files import FileHandler, shared_files
from fopid_core.study.page.guarded import Guarded, json_object
from fopid_core.study.page.listening import http_server

LARGEST_UPLOAD = 20_000_000
"""Bytes of a record, as the page sends it."""

MOST_WAITING = 8
"""Requests that are worked on or wait; more are turned away."""


@dataclass
class Desk:
    """What answers, and where it is worked on.

    Attributes
    ----------
    start : mapping
        What the page begins with.
    hand, search, long : Executor
        For answers that a hand waits for, for searches on the process, and for what takes seconds: that has a process
        of its own.
    waiting : int
        Requests that are worked on or wait.
    """

    start: Mapping[str, Any]
    hand: Executor = field(default_factory=lambda: ThreadPoolExecutor(2))
    search: Executor = field(default_factory=lambda: ThreadPoolExecutor(1))
    long: Executor = field(default_factory=lambda: ProcessPoolExecutor(1, get_context("spawn"), _deaf))
    waiting: int = 0

    def work(self, name: str) -> tuple[Work, Executor] | None:
        """The function that answers, and where it runs; None for a name that is not known."""
        at_once: dict[str, Work] = {"start": lambda _: dict(self.start), "token": lambda _: {}, **AT_THE_HAND}
        for group, executor in ((at_once, self.hand), (SEARCHES, self.search), (LONG_WORK, self.long)):
            if name in group:
                return group[name], executor
        return None


def _deaf() -> None:
    """In the process for long work: Ctrl-C is for the server, which ends it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _text(work: Work, fields: Mapping[str, Any]) -> str:
    """The answer as JSON, written where it was worked out: the server goes on meanwhile."""
    return json.dumps(work(fields), separators=(",", ":"), allow_nan=False)


class AskHandler(Guarded):
    """Answers one request: 200, 400 for bad input, 401 without the token, 503 when too many wait."""

    async def post(self, name: str) -> None:
        desk: Desk = self.settings["desk"]
        found = desk.work(name)
        if not self.access.allows_change(self.request.headers.get("Authorization", "")):
            self._refuse(401, "the token is missing or wrong: open the address that was printed at the start")
        elif found is None:
            self._refuse(404, f"{name!r} is nothing that can be asked for")
        elif desk.waiting >= MOST_WAITING:
            self._refuse(503, "too much is asked for at a time; allowed: wait for the answers")
        else:
            await self._answer(desk, *found)

    async def _answer(self, desk: Desk, work: Work, executor: Executor) -> None:
        desk.waiting += 1
        try:
            fields = json_object(self.request.body)
            self.write(await asyncio.get_running_loop().run_in_executor(executor, _text, work, fields))
            self.set_header("Content-Type", "application/json; charset=UTF-8")
        except ExpressionError as error:
            self._refuse(400, str(error), text=error.text, position=error.position, reason=error.reason)
        except InputError as error:
            self._refuse(400, str(error))
        finally:
            desk.waiting -= 1

    def _refuse(self, status: int, message: str, **more: Any) -> None:
        self.set_status(status)
        self.write({"message": message, **more})


def application(desk: Desk, access: Access) -> Application:
    """The web application."""

    def no_log(_: RequestHandler) -> None:
        pass

    static = Path(str(resources.files("fopid_core.study.explore"))) / "static"
    return Application(
        [
            (r"/api/(\w+)", AskHandler),
            *shared_files(),
            (r"/(.*)", FileHandler, {"path": static, "default_filename": "index.html"}),
        ],
        access=access,
        desk=desk,
        log_function=no_log,
    )


async def serve(desk: Desk, access: Access, sockets: list[socket.socket]) -> None:
    """Serve until told to stop by SIGINT or SIGTERM."""
    stop = asyncio.Event()
    for each in (signal.SIGINT, signal.SIGTERM):
        asyncio.get_running_loop().add_signal_handler(each, stop.set)
    server = http_server(application(desk, access), LARGEST_UPLOAD)
    server.add_sockets(sockets)
    await stop.wait()
    server.stop()
    for child in active_children():
        child.terminate()
    desk.long.shutdown(cancel_futures=True)  # waits: Python's own end of a pool that breaks meanwhile may fail
    for executor in (desk.hand, desk.search):
        executor.shutdown(wait=False, cancel_futures=True)
