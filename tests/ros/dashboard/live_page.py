"""A dashboard in a process of its own, and what a program can ask of it."""

from __future__ import annotations

import asyncio
import http.client
import json
import re
import subprocess
import time
from collections.abc import Callable, Mapping
from typing import Any
from urllib.parse import urlsplit

from tornado.httpclient import HTTPRequest
from tornado.websocket import WebSocketClientConnection, websocket_connect

from ..conftest import PATIENCE, Graph

JSON = "application/json"


def _no_json(constant: str) -> None:
    """A browser does not know Infinity or NaN, which Python reads."""
    raise ValueError(f"{constant} in a message to a browser")


class Dashboard:
    """A running dashboard.

    Parameters
    ----------
    graph : Graph
    *options : str
        More arguments; ROS arguments come behind ``--ros-args``.
    """

    def __init__(self, graph: Graph, *options: str, port: int = 0) -> None:
        self.process: subprocess.Popen[str] = graph.start("dashboard", {}, "--", "--port", str(port), *options)
        log = self.process.log
        graph.until(lambda: "http://" in log.read_text() or self.process.poll() is not None, "the dashboard's address")
        assert self.process.poll() is None, log.read_text()
        self.address = re.search(r"http://\S+", log.read_text())[0]
        parts = urlsplit(self.address)
        self.host, self.port = parts.netloc, parts.port
        self.token = parts.fragment.removeprefix("token=")

    @property
    def read_only_address(self) -> str:
        return self.address.partition("#")[0]

    def request(
        self, method: str, path: str, body: object = None, headers: Mapping[str, str] | None = None
    ) -> tuple[int, Any, Mapping[str, str]]:
        """Status, body and headers of an answer."""
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=PATIENCE)
        text = body if isinstance(body, str) or body is None else json.dumps(body)
        try:
            connection.request(method, path, text, {"Host": self.host, **(headers or {})})
            answer = connection.getresponse()
            content = answer.read().decode()
            is_json = answer.headers.get("Content-Type", "").startswith(JSON)
            return answer.status, json.loads(content) if is_json else content, answer.headers
        finally:
            connection.close()

    def ask(self, what: str, fields: object = None, **headers: str) -> tuple[int, str]:
        """Status and message of a request for a change, with the token."""
        shown = {"Authorization": f"Bearer {self.token}", **headers}
        status, answer, _ = self.request("POST", f"/api/{what}", fields, shown)
        return status, answer["message"]


class Reader:
    """One that reads what the dashboard tells all browsers."""

    def __init__(self, dashboard: Dashboard, **headers: str) -> None:
        self._loop = asyncio.new_event_loop()
        url = f"ws://127.0.0.1:{dashboard.port}/live"
        request = HTTPRequest(url, headers={"Host": dashboard.host, **headers})
        self._socket: WebSocketClientConnection = self._wait(lambda: websocket_connect(request))
        self.rows: list[list[float | None]] = []
        self.status: dict[str, Any] = {}
        self.facts: dict[str, Any] = {}
        self.records = self.messages = 0
        self.closed: int | None = None
        self.read()

    def _wait(self, begin: Callable[[], Any], patience: float = PATIENCE) -> Any:
        async def wait() -> Any:
            return await asyncio.wait_for(begin(), patience)

        return self._loop.run_until_complete(wait())

    def read(self) -> None:
        """Take the next message."""
        text = self._wait(self._socket.read_message)
        if text is None:
            self.closed = self._socket.close_code
            return
        message = json.loads(text, parse_constant=_no_json)
        self.messages += 1
        if message["fresh"]:
            self.records += 1
            self.rows.clear()
        self.rows += message["rows"]
        self.status = message.get("status", self.status)
        self.facts = message.get("facts", self.facts)

    def until(self, ready: Callable[[], object], what: str) -> None:
        deadline = time.monotonic() + PATIENCE
        while not ready():
            assert time.monotonic() < deadline, f"{what} within {PATIENCE} s; status: {self.status}"
            assert self.closed is None, f"closed with {self.closed} before {what}"
            self.read()

    def close(self) -> None:
        """Say goodbye and hear the server's, within the loop: outside of one tornado would look for another's."""

        async def goodbye() -> None:
            self._socket.close()
            while await self._socket.read_message() is not None:
                pass

        if self.closed is None:
            self._wait(goodbye)
        self._loop.close()
