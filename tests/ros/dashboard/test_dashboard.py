"""The dashboard's server against the real nodes: who may do what, what is told, how it lives and ends."""

from __future__ import annotations

import itertools
import os
import signal
import socket
import subprocess
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

import pytest
from tornado.httpclient import HTTPClientError

from fopid_msgs.msg import FopidState, ScalarStamped

from ..conftest import BIN, Graph, LockstepLoop, own_graph
from .live_page import Dashboard, Reader

PI = {"kp": 0.68, "ki": 0.29}
GAINS = ("kp", "ki", "kd", "lam", "mu")
START = [0.68, 0.29, 0.0, 1.0, 1.0]


@pytest.fixture(scope="module")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Graph, Dashboard]]:
    """A running loop with its dashboard, for tests that leave the gains as they are."""
    with own_graph(tmp_path_factory.mktemp("graph")) as graph:
        graph.start("plant_simulator", {"process": "P1"})
        graph.start("fopid_controller", PI)
        graph.start("fopid_tuner", {"process": "P1"})
        dashboard = Dashboard(graph)
        wait_for(dashboard, "controller", "tuner")
        yield graph, dashboard


@pytest.fixture(scope="module")
def alone(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Graph, Dashboard]]:
    """A dashboard without a loop, and with a token of one's own."""
    with own_graph(tmp_path_factory.mktemp("graph")) as graph:
        graph.environment["FOPID_DASHBOARD_TOKEN"] = "a token of one's own"
        dashboard = Dashboard(graph)
        dashboard.token = "a token of one's own"
        yield graph, dashboard


def wait_for(dashboard: Dashboard, *names: str) -> None:
    reader = Reader(dashboard)
    reader.until(lambda: all(reader.status[name]["present"] for name in names), f"{names}")
    reader.close()


def test_the_page_needs_nothing_from_elsewhere_and_says_so(shared: tuple[Graph, Dashboard]) -> None:
    _, dashboard = shared
    for path in ("/", "/main.js", "/page/page.css", "/page/report_page.css", "/page/uplot/uPlot.iife.min.js"):
        status, text, headers = dashboard.request("GET", path)
        assert status == 200, path
        assert "default-src 'none'" in headers["Content-Security-Policy"]
        assert headers["X-Content-Type-Options"] == "nosniff"
        assert dashboard.token not in text
    assert dashboard.request("GET", "/../node.py")[0] in (403, 404)
    assert dashboard.request("GET", "/nothing.js")[0] == 404


@pytest.mark.parametrize("host", ["evil.example", "127.0.0.1.evil.example", ""])
def test_a_name_that_was_made_to_point_here_gets_nothing(shared: tuple[Graph, Dashboard], host: str) -> None:
    graph, dashboard = shared
    assert dashboard.request("GET", "/", headers={"Host": host})[0] in (400, 403)
    assert dashboard.ask("parameters", {"kp": 5.0}, Host=host)[0] in (400, 403)
    with pytest.raises(HTTPClientError, match=r"40[03]"):
        Reader(dashboard, Host=host)
    assert graph.get("fopid_controller", *GAINS) == START


@pytest.mark.parametrize("origin", ["http://evil.example", "null", "http://127.0.0.1:1"])
def test_pages_from_elsewhere_are_refused_even_with_the_token(shared: tuple[Graph, Dashboard], origin: str) -> None:
    graph, dashboard = shared
    assert dashboard.ask("parameters", {"kp": 5.0}, Origin=origin)[0] == 403
    with pytest.raises(HTTPClientError, match="403"):
        Reader(dashboard, Origin=origin)
    assert graph.get("fopid_controller", *GAINS) == START


@pytest.mark.parametrize("shown", ["", "Bearer wrong", "Bearer "])
@pytest.mark.parametrize("what", ["parameters", "rollback", "tune", "signal", "token"])
def test_nothing_changes_without_the_token(shared: tuple[Graph, Dashboard], what: str, shown: str) -> None:
    graph, dashboard = shared
    fields = {"kp": 5.0} if what == "parameters" else {"signal": "setpoint", "value": 7.0}
    setpoints = graph.listen(ScalarStamped, "setpoint")
    assert dashboard.ask(what, fields, Authorization=shown) == (401, "the token is missing or wrong")
    assert graph.get("fopid_controller", *GAINS) == START
    assert setpoints == []


def test_a_token_in_the_address_counts_for_nothing(shared: tuple[Graph, Dashboard]) -> None:
    _, dashboard = shared
    assert dashboard.request("POST", f"/api/token?token={dashboard.token}", {})[0] == 401


@pytest.mark.parametrize(
    ("what", "body", "named"),
    [
        ("parameters", {"kp": "5"}, "kp = '5'"),
        ("parameters", '{"kp": NaN}', "kp = nan"),
        ("parameters", {"kp": True}, "kp = True"),
        ("parameters", {"control_max": 1.0}, "'control_max'"),
        ("parameters", {}, "allowed: kp"),
        ("parameters", "[1, 2]", "a JSON object"),
        ("parameters", "{", "a JSON object"),
        ("signal", {"signal": "control", "value": 1.0}, "signal = 'control'"),
        ("signal", {"signal": "setpoint"}, "setpoint = None"),
        ("tune", {"metod": "time"}, "field = 'metod'"),
    ],
)
def test_bad_requests_name_what_is_wrong(shared: tuple[Graph, Dashboard], what: str, body: object, named: str) -> None:
    graph, dashboard = shared
    status, message = dashboard.ask(what, body)
    assert status == 400
    assert named in message
    assert graph.get("fopid_controller", *GAINS) == START


@pytest.mark.parametrize(
    ("fields", "named"), [({"kp": 3.0, "lam": 2.5}, "lam = 2.5"), ({"kp": 3.0, "mode": "automatic"}, "'automatic'")]
)
def test_what_the_controller_rejects_changes_nothing_and_has_a_reason(
    shared: tuple[Graph, Dashboard], fields: dict, named: str
) -> None:
    graph, dashboard = shared
    status, message = dashboard.ask("parameters", fields)
    assert status == 409
    assert named in message
    assert graph.get("fopid_controller", *GAINS) == START


def test_a_tuning_that_cannot_begin_has_a_reason(shared: tuple[Graph, Dashboard]) -> None:
    graph, dashboard = shared
    status, message = dashboard.ask("tune", {"method": "frequency", "crossover": -1.0, "apply": True})
    assert status == 409
    assert "crossover = -1.0" in message
    assert graph.get("fopid_controller", *GAINS) == START


def test_unknown_requests_are_told_the_known_ones(shared: tuple[Graph, Dashboard]) -> None:
    _, dashboard = shared
    status, message = dashboard.ask("reset")
    assert status == 404
    assert "rollback" in message


def test_new_gains_arrive_at_once_and_go_back_step_by_step(graph: Graph) -> None:
    graph.start("fopid_controller", PI)
    dashboard = Dashboard(graph)
    wait_for(dashboard, "controller")
    assert dashboard.ask("rollback") == (409, "no earlier gains are known")
    changes = graph.changes("fopid_controller")
    second = dict(zip(GAINS, (1.0, 0.4, 0.2, 1.1, 0.9), strict=True))
    assert dashboard.ask("parameters", second)[0] == 200
    graph.until(lambda: changes, "the parameter event")
    assert changes == [{**second, "gains.origin": "dashboard: by hand"}]
    assert graph.get("fopid_controller", "gains.origin") == ["dashboard: by hand"]
    assert graph.get("fopid_controller", *GAINS) == list(second.values())

    graph.set("fopid_controller", kp=2.0)  # by somebody else
    reader = Reader(dashboard)
    reader.until(lambda: reader.status["controller"]["values"].get("kp") == 2.0, "the new gain")
    assert reader.status["controller"]["previous"] == second
    assert reader.status["controller"]["ranges"]["lam"] == [0.0, 2.0]
    for expected in (list(second.values()), START):
        assert dashboard.ask("rollback")[0] == 200
        assert graph.get("fopid_controller", *GAINS) == expected
        reader.until(lambda e=expected: [reader.status["controller"]["values"][g] for g in GAINS] == e, "the old gains")
    assert dashboard.ask("rollback")[0] == 409
    reader.close()


def test_without_controller_and_tuner_that_is_said(alone: tuple[Graph, Dashboard]) -> None:
    _, dashboard = alone
    assert dashboard.ask("parameters", {"kp": 1.0}) == (409, "/fopid_controller is not there")
    assert dashboard.ask("tune", {"method": "time"}) == (409, "/fopid_tuner is not there")


@pytest.mark.slow
def test_while_the_tuner_works_that_is_told_and_another_tuning_is_refused(graph: Graph) -> None:
    graph.start("fopid_tuner", {"process": "1/(s+1)^8 * exp(-2s)"})
    dashboard = Dashboard(graph)
    wait_for(dashboard, "tuner")
    reader = Reader(dashboard)
    assert reader.status["tuner"]["busy"] is None
    with ThreadPoolExecutor() as pool:
        working = pool.submit(dashboard.ask, "tune", {"method": "time", "index": "istes"})
        reader.until(lambda: reader.status["tuner"]["busy"] is not None, "a tuner at work")
        assert dashboard.ask("tune", {"method": "time"}) == (409, "busy with another tuning")
        reader.until(lambda: reader.status["tuner"]["busy"] is None, "the end of it")
        assert working.result()[0] == 200
    reader.until(lambda: reader.status["result"], "the result")
    assert reader.status["result"]["method"] == "time"
    reader.close()


@pytest.mark.slow
def test_the_controller_may_come_go_and_come_again(graph: Graph) -> None:
    dashboard = Dashboard(graph)
    reader = Reader(dashboard)
    for kp, way_to_end in ((1.0, signal.SIGTERM), (2.0, signal.SIGTERM)):
        process = graph.start("fopid_controller", {"kp": kp})
        reader.until(
            lambda kp=kp: (told := reader.status["controller"])["present"] and told["values"].get("kp") == kp,
            "the controller",
        )
        process.send_signal(way_to_end)
        process.wait(10)
        reader.until(lambda: not reader.status["controller"]["present"], "its end")
    reader.close()


@pytest.mark.slow
def test_a_controller_that_hangs_does_not_count_as_there(graph: Graph) -> None:
    dashboard = Dashboard(graph)
    controller = graph.start("fopid_controller", {"kp": 1.0})
    wait_for(dashboard, "controller")
    reader = Reader(dashboard)
    controller.send_signal(signal.SIGSTOP)
    reader.until(lambda: not reader.status["controller"]["present"], "its silence")
    controller.send_signal(signal.SIGCONT)
    reader.until(lambda: reader.status["controller"]["present"], "its answer")
    reader.close()


@pytest.mark.slow
def test_a_controller_that_was_killed_and_started_again_is_read_anew(graph: Graph) -> None:
    dashboard = Dashboard(graph)
    reader = Reader(dashboard)
    killed = graph.start("fopid_controller", {"kp": 1.0})
    reader.until(lambda: reader.status["controller"]["values"].get("kp") == 1.0, "the first controller")
    killed.kill()
    killed.wait()
    graph.start("fopid_controller", {"kp": 2.0})
    reader.until(lambda: reader.status["controller"]["values"].get("kp") == 2.0, "the second controller")
    reader.close()


@pytest.mark.slow
def test_signals_are_told_as_they_are_in_simulated_time_and_any_namespace(graph: Graph) -> None:
    dashboard = Dashboard(graph, "--ros-args", "-r", "__ns:=/hall", "-p", "use_sim_time:=true")
    loop = LockstepLoop(graph, "P1", PI, namespace="hall")
    reader = Reader(dashboard)
    loop.publish("setpoint", 1.0)
    loop.advance(20.0)
    reader.until(lambda: reader.rows and reader.rows[-1][0] > 19.9, "twenty seconds")

    def sent() -> dict[float, FopidState]:
        return {round(s.header.stamp.sec + s.header.stamp.nanosec * 1e-9, 4): s for s in loop.states}

    # Before the first state, and when the loop stood still for a second, measurement and control are all there is.
    rows = [row for row in reader.rows if row[4] is not None]
    graph.until(lambda: all(time in sent() for time, *_ in rows), "the same states")
    assert len(rows) > 5
    for time, *told in rows:
        state = sent()[time]
        was = [state.setpoint, state.measurement, state.control, state.proportional, state.integral, state.derivative]
        assert told == pytest.approx(was, rel=1e-5, abs=1e-12)
    assert reader.status["controller"]["name"] == "/hall/fopid_controller"
    later = itertools.count(20.1, 0.1)  # the facts are of a running loop
    reader.until(lambda: loop.advance(next(later)) or reader.facts["saturated"] is False, "the state in the facts")
    reader.close()


@pytest.mark.slow
def test_other_node_names_and_topics(graph: Graph) -> None:
    graph.start("fopid_controller", {"kp": 3.0}, "-r", "__node:=oven_controller")
    dashboard = Dashboard(graph, "--ros-args", "-p", "controller:=oven_controller", "-r", "measurement:=oven/reading",
                          "-r", "__node:=oven_page")  # fmt: skip
    reader = Reader(dashboard)
    reader.until(lambda: reader.status["controller"]["values"].get("kp") == 3.0, "the controller")
    reading = graph.node.create_publisher(ScalarStamped, "oven/reading", 1)
    graph.until(reading.get_subscription_count, "the dashboard")
    assert graph.get("oven_page", "controller") == ["oven_controller"]

    def told() -> bool:  # no ~/state comes, since the controller has no setpoint: the topic itself is shown
        reading.publish(ScalarStamped(value=0.75))
        graph.spin(0.02)
        reader.read()
        return bool(reader.rows) and reader.rows[-1][2] == 0.75

    graph.until(told, "the measurement")
    reader.close()


def test_a_record_that_begins_anew_has_no_marks_of_the_one_before(alone: tuple[Graph, Dashboard]) -> None:
    graph, dashboard = alone
    publisher = graph.node.create_publisher(FopidState, "fopid_controller/state", 10)

    def tell(second: int, kp: float) -> None:
        state = FopidState(kp=kp)
        state.header.stamp.sec = second
        publisher.publish(state)

    def heard() -> bool:  # a reader on best effort misses what comes before it knows the publisher
        tell(100, 1.0)
        reader = Reader(dashboard)
        reader.close()
        return bool(reader.rows)

    graph.until(heard, "the dashboard listens")
    reader = Reader(dashboard)
    tell(103, 2.0)
    reader.until(lambda: reader.status["marks"] == [3.0], "the mark of new gains")
    tell(10, 2.0)
    reader.until(lambda: reader.status["marks"] == [], "no marks")
    reader.close()
    graph.node.destroy_publisher(publisher)


def test_a_setpoint_given_by_hand_is_published(alone: tuple[Graph, Dashboard]) -> None:
    graph, dashboard = alone
    graph.get("dashboard", "controller")
    assert graph.node.count_publishers("setpoint") == 0  # who only looks is no source of setpoints
    setpoints = graph.listen(ScalarStamped, "setpoint")

    def heard() -> bool:  # the dashboard may know of the listener a little later
        assert dashboard.ask("signal", {"signal": "setpoint", "value": 2.5}) == (200, "setpoint = 2.5")
        graph.spin(0.1)
        return bool(setpoints)

    graph.until(heard, "the setpoint")
    assert setpoints[0].value == 2.5


def test_a_token_that_was_given_is_not_printed(alone: tuple[Graph, Dashboard]) -> None:
    graph, dashboard = alone
    assert "#" not in dashboard.address
    assert "one's own" not in graph.logs()
    assert dashboard.ask("token")[0] == 200


@pytest.mark.slow
def test_one_who_never_reads_holds_up_nobody(shared: tuple[Graph, Dashboard]) -> None:
    _, dashboard = shared
    assert dashboard.ask("signal", {"signal": "setpoint", "value": 0.0})[0] == 200
    asleep = socket.create_connection(("127.0.0.1", dashboard.port))
    asleep.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1)
    asleep.sendall(
        f"GET /live HTTP/1.1\r\nHost: {dashboard.host}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
        "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n\r\n".encode()
    )
    first, second = Reader(dashboard), Reader(dashboard)
    for reader in (first, second):
        reader.until(lambda r=reader: r.rows and r.rows[-1][0] > r.rows[0][0] + 3.0, "three seconds of signals")
        reader.close()
    common = {row[0] for row in first.rows} & {row[0] for row in second.rows}
    assert len(common) > 20
    asleep.close()


@pytest.mark.parametrize("number", [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.slow)])
def test_it_ends_in_good_order_while_browsers_look(graph: Graph, number: int) -> None:
    dashboard = Dashboard(graph)
    reader = Reader(dashboard)
    os.kill(dashboard.process.pid, number)
    assert dashboard.process.wait(10) == 0
    while reader.closed is None:
        reader.read()
    assert reader.closed == 1001
    assert "Traceback" not in graph.logs()


def test_a_misspelt_parameter_is_one_line(graph: Graph) -> None:
    refused(graph, ["--port", "0", "--ros-args", "-p", "controler:=x"], ["no parameter 'controler'", "'controller'"])


def test_a_port_in_use_is_named(graph: Graph) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        refused(graph, ["--port", str(taken.getsockname()[1])], ["port = ", "in use", "0 to choose one"])


def refused(graph: Graph, options: list, named: list) -> None:
    ended = subprocess.run([BIN / "dashboard", *options], env=graph.environment, timeout=30, capture_output=True,
                           text=True, check=False)  # fmt: skip
    assert ended.returncode == 2, ended.stderr
    (line,) = [line for line in ended.stderr.splitlines() if line.startswith("error: ")]
    assert all(word in line for word in named), line
    assert "Traceback" not in ended.stderr


def test_help_tells_what_can_be_set(graph: Graph) -> None:
    told = subprocess.run([BIN / "dashboard", "--help"], env=graph.environment, timeout=30, capture_output=True,
                          text=True, check=True)  # fmt: skip
    assert "usage" in told.stdout
    assert "FOPID_DASHBOARD_TOKEN" in told.stdout
    assert "measurement.type" in told.stdout
