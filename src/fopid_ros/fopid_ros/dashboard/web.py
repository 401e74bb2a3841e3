"""The dashboard's web side: files, a WebSocket that tells what happens, and requests that change something.

``GET /`` and its files and the WebSocket ``/live`` are for everybody whom the rules of access let in;
``POST /api/...`` takes a JSON object and needs the token.
"""

from __future__ import annotations

import asyncio
import json
import math
from collections.abc import Awaitable, Callable, Iterable, Mapping
from importlib import resources
from pathlib import Path
from typing import Any, ClassVar

from tornado.httputil import HTTPServerRequest
from tornado.web import Application, HTTPError, RequestHandler, StaticFileHandler
from tornado.websocket import WebSocketClosedError, WebSocketHandler

from fopid_core.errors import InputError
from fopid_ros.dashboard.access import Access
from fopid_ros.dashboard.history import Cursor, Row
from fopid_ros.dashboard.node import DashboardNode
from fopid_ros.dashboard.remote_parameters import RefusedError

PERIOD = 0.05
"""Time between two messages to a browser [s]."""

LARGEST_REQUEST = 20_000  # bytes

HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; "
    "img-src data:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "Cache-Control": "no-cache",
}

Change = Callable[[Mapping[str, Any]], Awaitable[str]]


class Guarded(RequestHandler):
    """Lets in only requests to this server by one of its own names, and from no other page than its own."""

    @property
    def access(self) -> Access:
        """The rules."""
        rules: Access = self.settings["access"]
        return rules

    def set_default_headers(self) -> None:
        for name, value in HEADERS.items():
            self.set_header(name, value)

    def prepare(self) -> None:
        host = self.request.headers.get("Host", "")
        if not self.access.knows_host(host):
            raise HTTPError(403, reason="Unknown Host")
        if not self.access.knows_origin(self.request.headers.get("Origin"), host):
            raise HTTPError(403, reason="Foreign Origin")

    def write_error(self, status_code: int, **kwargs: Any) -> None:
        self.finish({"message": self._reason})


class FileHandler(Guarded, StaticFileHandler):
    """A file of the page."""


class ChangeHandler(Guarded):
    """Asks the node for a change and answers with its one line."""

    async def post(self, name: str) -> None:
        """Answer 200 when done, 400 for bad input, 401 without the token, 409 with the reason of a refusal."""
        changes: Mapping[str, Change] = self.settings["changes"]
        if not self.access.allows_change(self.request.headers.get("Authorization", "")):
            self._answer(401, "the token is missing or wrong")
        elif name not in changes:
            self._answer(404, f"{name!r}; allowed: {', '.join(changes)}")
        else:
            await self._change(changes[name])

    async def _change(self, change: Change) -> None:
        try:
            self._answer(200, await change(_object(self.request.body)))
        except InputError as error:
            self._answer(400, str(error))
        except RefusedError as error:
            self._answer(409, str(error))

    def _answer(self, status: int, message: str) -> None:
        self.set_status(status)
        self.write({"message": message})


def _object(body: bytes) -> Mapping[str, Any]:
    try:
        value = json.loads(body or b"{}")
    except ValueError:
        value = None
    if not isinstance(value, dict):
        raise InputError("the request's body; allowed: a JSON object")
    return value


class LiveHandler(Guarded, WebSocketHandler):
    """Tells one browser what happens.

    Each message goes out after the one before has: a slow browser gets fewer and larger ones, and nobody waits for it.
    """

    open_now: ClassVar[set[LiveHandler]] = set()
    _feeding: asyncio.Task[None] | None = None

    def open(self, *args: str, **kwargs: str) -> None:
        self.set_nodelay(True)
        self.open_now.add(self)
        self._feeding = asyncio.create_task(self._feed())

    def on_close(self) -> None:
        self.open_now.discard(self)
        if self._feeding is not None:
            self._feeding.cancel()

    def on_message(self, message: str | bytes) -> None:
        """What a browser sends here is not looked at."""

    async def _feed(self) -> None:
        node: DashboardNode = self.settings["node"]
        place, told = Cursor(), None
        while True:
            rows, now = node.history.since(place)
            message: dict[str, Any] = {"rows": _plain(rows), "fresh": now.record != place.record}
            place = now
            status = node.status()
            if status != told:
                message["status"] = told = status
            if rows:
                message["facts"] = node.facts()
            if rows or "status" in message:
                try:
                    await self.write_message(json.dumps(message, separators=(",", ":")))
                except WebSocketClosedError:
                    return
            await asyncio.sleep(PERIOD)


def _plain(rows: Iterable[Row]) -> list[list[float | None]]:
    """Rows for JSON: six digits of a signal, time to 0.1 ms, nothing where there is no number."""
    return [[round(row[0], 4), *(float(f"{x:.6g}") if math.isfinite(x) else None for x in row[1:])] for row in rows]


def application(node: DashboardNode, access: Access) -> Application:
    """The web application of a node."""

    async def nothing(_: Mapping[str, Any]) -> str:
        return "the token is right"

    async def say(fields: Mapping[str, Any]) -> str:
        return await node.publish_signal(str(fields.get("signal")), fields.get("value"))

    async def roll_back(_: Mapping[str, Any]) -> str:
        return await node.roll_back()

    changes: dict[str, Change] = {
        "token": nothing,
        "parameters": node.set_parameters_of_controller,
        "rollback": roll_back,
        "tune": node.tune,
        "signal": say,
    }

    def log(handler: RequestHandler) -> None:
        request: HTTPServerRequest = handler.request
        node.get_logger().debug(f"{handler.get_status()} {request.method} {request.path} {request.remote_ip}")

    static = Path(str(resources.files("fopid_ros.dashboard"))) / "static"
    report = Path(str(resources.files("fopid_core.study.reports")))
    return Application(
        [
            (r"/live", LiveHandler),
            (r"/api/(\w+)", ChangeHandler),
            (r"/(report_page\.css)", FileHandler, {"path": report}),
            (r"/(.*)", FileHandler, {"path": static, "default_filename": "index.html"}),
        ],
        access=access,
        node=node,
        changes=changes,
        log_function=log,
        websocket_ping_interval=10,
        websocket_max_message_size=LARGEST_REQUEST,
    )


def close_browsers() -> None:
    """Tell all browsers that the server goes."""
    for handler in list(LiveHandler.open_now):
        handler.close(1001, "the dashboard ends")
