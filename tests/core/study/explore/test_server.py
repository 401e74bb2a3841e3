"""The server of the page without ROS, by a client that is not our page."""

from __future__ import annotations

import asyncio
import http.client
import json
import re
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from fopid_core.study.explore.server import MOST_WAITING, Desk, application
from fopid_core.study.page.access import Access
from fopid_core.study.page.listening import MOST_CONNECTIONS, http_server, listening_sockets

TOKEN = "a-token-of-the-tests"


class Server:
    """The server in a thread."""

    def __init__(self) -> None:
        self.desk = Desk({"process": "P1"})
        (listener,) = listening_sockets("127.0.0.1", 0)
        self.port = listener.getsockname()[1]
        self.loop = asyncio.new_event_loop()

        async def serve() -> None:
            self.server = http_server(application(self.desk, Access(TOKEN)), 100_000)
            self.server.add_sockets([listener])

        self.loop.run_until_complete(serve())
        self.thread = threading.Thread(target=self.loop.run_forever)
        self.thread.start()

    def close(self) -> None:
        self.loop.call_soon_threadsafe(self.loop.stop)
        self.thread.join()
        self.server.stop()
        self.loop.close()

    def request(self, method: str, path: str, body: object = None, **headers: str) -> tuple[int, Any]:
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=30)
        text = body if isinstance(body, str | bytes) or body is None else json.dumps(body)
        try:
            shown = {"Host": f"127.0.0.1:{self.port}", **headers}
            connection.request(method, path, text, shown)
            answer = connection.getresponse()
            content = answer.read().decode()
            self.headers = answer.headers
            is_json = answer.headers.get("Content-Type", "").startswith("application/json")
            return answer.status, json.loads(content) if is_json else content
        finally:
            connection.close()

    def ask(self, what: str, fields: object = None, **headers: str) -> tuple[int, Any]:
        return self.request("POST", f"/api/{what}", fields, **{"Authorization": f"Bearer {TOKEN}", **headers})


@pytest.fixture(scope="module")
def server() -> Iterator[Server]:
    server = Server()
    yield server
    server.close()


def test_every_file_of_the_page_is_there_and_needs_nothing_from_elsewhere(server: Server) -> None:
    status, page = server.request("GET", "/")
    assert status == 200
    named = [part.split('"')[0] for part in page.replace('src="', 'href="').split('href="')[1:]]
    for path in named:
        if path.startswith("data:"):
            continue
        assert server.request("GET", f"/{path}")[0] == 200, path
        assert "default-src 'none'" in server.headers["Content-Security-Policy"]
    assert server.request("GET", "/../server.py")[0] in (403, 404)
    assert server.request("GET", "/page/../prediction.py")[0] in (403, 404)


def test_with_the_token_there_is_an_answer(server: Server) -> None:
    assert server.ask("start") == (200, {"process": "P1"})
    status, seen = server.ask("predict", {"process": "P1", "sets": [{"kp": 2}]})
    assert (status, seen["sets"][0]["verdict"]["badge"]) == (200, "stable")


@pytest.mark.parametrize("what", ["start", "predict", "process", "compare", "learn", "take", "report"])
def test_without_it_there_is_none(server: Server, what: str) -> None:
    for shown in ("", "Bearer ", "Bearer wrong"):
        assert server.ask(what, {}, Authorization=shown)[0] == 401
    assert server.request("POST", f"/api/{what}?token={TOKEN}", {})[0] == 401


@pytest.mark.parametrize("headers", [{"Host": "evil.example"}, {"Origin": "http://evil.example"}, {"Origin": "null"}])
def test_pages_and_names_from_elsewhere_get_nothing(server: Server, headers: dict[str, str]) -> None:
    assert server.ask("start", {}, **headers)[0] == 403
    assert server.request("GET", "/", **headers)[0] == 403


@pytest.mark.parametrize(
    "body", ["[1]", "{", "null", '"x"', "[" * 20_000, b"\xff\xfe", '{"process": "P1", "sets": [{"kp": NaN}]}', "{}"]
)
def test_a_body_that_is_no_request_is_refused(server: Server, body: str | bytes) -> None:
    status, told = server.ask("predict", body)
    assert status == 400
    assert "Traceback" not in told["message"]


def test_an_error_in_the_process_has_its_place(server: Server) -> None:
    status, told = server.ask("process", {"process": "1/(s+1"})
    assert (status, told["text"], told["position"]) == (400, "1/(s+1", 6)


def test_what_is_too_large_is_not_read(server: Server) -> None:
    try:
        status = server.ask("learn", "x" * 200_000)[0]
    except (BrokenPipeError, ConnectionResetError):
        return
    assert status in (400, 413)


def test_what_is_not_known_is_said(server: Server) -> None:
    assert server.ask("nothing")[0] == 404
    assert server.request("GET", "/nothing.js")[0] == 404


def test_no_more_wait_than_there_is_room_for(server: Server) -> None:
    server.desk.waiting += MOST_WAITING
    try:
        assert server.ask("start")[0] == 503
    finally:
        server.desk.waiting -= MOST_WAITING
    assert server.ask("start")[0] == 200


def test_there_is_room_however_many_begin_a_request_and_fall_silent(server: Server) -> None:
    silent = []
    for _ in range(3 * MOST_CONNECTIONS):
        silent.append(socket.create_connection(("127.0.0.1", server.port)))
        silent[-1].sendall(b"GET / HTTP/1.1\r\nX-")
        silent[-1].setblocking(False)
    assert server.request("GET", "/")[0] == 200  # it is the newest: the server has seen all others
    kept = sum(not is_closed(one) for one in silent)
    for one in silent:
        one.close()
    assert MOST_CONNECTIONS - 10 <= kept <= MOST_CONNECTIONS


def is_closed(connection: socket.socket) -> bool:
    """Whether the other end has closed one that has nothing to read."""
    try:
        return connection.recv(1) == b""
    except BlockingIOError:
        return False


@pytest.mark.slow
@pytest.mark.parametrize("waits", [True, False])
def test_told_to_stop_while_it_works_or_after_it_ends_at_once_and_says_nothing(waits: bool) -> None:
    command = [Path(sys.executable).with_name("fopid"), "explore", "--port", "0", "--no-browser"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as server:
        assert server.stdout is not None
        assert server.stderr is not None
        port, token = re.search(r":(\d+)/\S*token=(\S+)", server.stdout.readline()).groups()
        connection = http.client.HTTPConnection("127.0.0.1", int(port), timeout=60)
        shown = {"Host": f"127.0.0.1:{port}", "Authorization": f"Bearer {token}"}
        connection.request("POST", "/api/compare", json.dumps({"process": "P1"}), shown)
        if waits:
            assert connection.getresponse().status == 200
        else:
            time.sleep(1.0)  # within it, or on the way there
        server.terminate()
        assert server.wait(20) == 0
        assert server.stderr.read() == ""
        connection.close()
