"""The dashboard's server and those who mean it ill: each gets one answer, and the others are served as before."""

from __future__ import annotations

import socket
import time
from collections.abc import Iterator

import pytest

from fopid_msgs.msg import FopidState
from fopid_ros.dashboard.live import MOST_BROWSERS

from ..conftest import Graph, own_graph
from .live_page import Dashboard, Reader

SOON = 5.0
"""[s] An answer takes some milliseconds; a machine that is shared may take longer."""


@pytest.fixture(scope="module")
def alone(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Graph, Dashboard]]:
    with own_graph(tmp_path_factory.mktemp("graph")) as graph:
        yield graph, Dashboard(graph)


def test_what_cannot_be_read_is_answered_with_400(alone: tuple[Graph, Dashboard]) -> None:
    graph, dashboard = alone
    for what, body, told in (
        ("parameters", "[" * 19_000, "a JSON object"),
        ("parameters", '{"kp":' * 2_500 + "1" + "}" * 2_500, "a JSON object"),
        ("parameters", '{"kp": %s}' % ("9" * 400), "kp = 999"),
        ("parameters", '{"kp": %s}' % ("9" * 5_000), "a JSON object"),
        ("parameters", '{"kp": 1e999}', "kp = inf"),
        ("parameters", '{"mode": "\\ud800"}', "mode = "),
        ("parameters", '{"mode": [[[[]]]]}', "mode = "),
        ("signal", {"signal": "setpoint", "value": 1e101}, "setpoint = 1e+101; allowed: a number, -1e+100 to 1e+100"),
        ("signal", {"signal": "setpoint", "value": -1.7e308}, "setpoint = -1.7e+308"),
        ("signal", {"signal": "manual_control", "value": 10**400}, "manual_control = 1000"),
        ("signal", {"signal": "x" * 10_000}, "(10000 characters)"),
        ("tune", {"process": "1/(s+1)\x00"}, "process = "),
        ("tune", '{"process": "\\ud800"}', "process = "),
        ("tune", {"crossover": 10**309}, "crossover = 1000"),
    ):
        status, message = dashboard.ask(what, body)
        assert (status, told in message) == (400, True), (body[:40] if isinstance(body, str) else body, status, message)
        assert len(message) < 300
    for path in ("/%00", "/main.js%00", "/%0a", "/page/uplot/%00"):
        assert dashboard.request("GET", path)[0] == 400, path
    for origin in ("http://[", "http://[::1", "http://[v1.x"):
        assert dashboard.request("GET", "/", headers={"Origin": origin})[0] == 400
        assert dashboard.ask("parameters", {"kp": 1.0}, Origin=origin)[0] == 400
    assert "Traceback" not in graph.logs()


def silent_browser(dashboard: Dashboard) -> socket.socket:
    """One that opens the WebSocket and then says and hears nothing."""
    asleep = socket.create_connection(("127.0.0.1", dashboard.port))
    asleep.settimeout(SOON)
    asleep.sendall(
        f"GET /live HTTP/1.1\r\nHost: {dashboard.host}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
        "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n\r\n".encode()
    )
    return asleep


def test_two_hundred_silent_browsers_hold_up_nobody(alone: tuple[Graph, Dashboard]) -> None:
    graph, dashboard = alone
    publisher = graph.node.create_publisher(FopidState, "fopid_controller/state", 10)
    graph.until(publisher.get_subscription_count, "the dashboard")
    for _ in range(50):
        state = FopidState()
        state.header.stamp = graph.node.get_clock().now().to_msg()
        publisher.publish(state)
        graph.spin(0.01)
    before = Reader(dashboard)
    asleep = [silent_browser(dashboard) for _ in range(200)]
    began = time.monotonic()
    assert dashboard.request("GET", "/")[0] == 200
    assert dashboard.ask("token")[0] == 200
    during = Reader(dashboard)
    assert during.rows
    assert time.monotonic() - began < SOON
    before.read() if before.messages == 0 else None
    assert before.closed is None  # who answers is not put out
    for one in asleep:
        one.close()
    for reader in (before, during):
        reader.close()
    graph.node.destroy_publisher(publisher)


def test_more_browsers_than_can_be_served_are_told_so(alone: tuple[Graph, Dashboard]) -> None:
    _, dashboard = alone
    readers: list[Reader] = []
    while not readers or readers[-1].closed is None:
        assert len(readers) <= MOST_BROWSERS
        readers.append(Reader(dashboard))
    assert readers[-1].closed == 1013
    assert len(readers) == MOST_BROWSERS + 1
    readers[0].close()
    time.sleep(0.5)  # until the server has heard of it
    another = Reader(dashboard)
    assert another.closed is None
    for reader in (*readers[1:], another):
        reader.close()
