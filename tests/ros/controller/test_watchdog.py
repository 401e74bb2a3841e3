"""What the controller does when nobody speaks any more, when two speak at once, and when a clock is wrong."""

from __future__ import annotations

import math
import os
import signal
import time
from itertools import pairwise
from pathlib import Path

import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.duration import Duration
from rclpy.node import Node

from fopid_core.errors import InputError
from fopid_msgs.msg import FopidState, ScalarStamped
from fopid_ros.controller.inputs import timeouts
from fopid_ros.controller.parameters import SPECS, check_timeouts

from ..conftest import Graph
from .fed import PERIOD, FedController, LockstepByHand, stamped

OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR
CONFIG = Path(__file__).parents[3] / "config"
DEFAULTS = {spec.name: spec.default for spec in SPECS}
HOUR = 3600 * 10**9


@pytest.mark.parametrize(
    ("sample_time", "expected"), [(0.001, 0.1), (0.01, 0.1), (0.02, 0.1), (0.1, 0.5), (1.0, 5.0), (60.0, 300.0)]
)
def test_by_default_a_measurement_is_stale_after_five_sample_times_and_no_sooner_than_a_tenth_of_a_second(
    sample_time: float, expected: float
) -> None:
    chosen = timeouts({**DEFAULTS, "sample_time": sample_time})
    assert chosen["measurement"] == chosen["tracking"] == expected
    assert chosen["feedforward"] == max(0.5, expected)
    assert chosen["setpoint"] == chosen["manual_control"] == float("inf")  # what a person has said once holds


def test_a_timeout_is_off_when_zero_and_refused_between_automatic_and_off() -> None:
    inputs = ("measurement", "setpoint", "feedforward", "manual_control", "tracking", "scheduling_variable")
    off = timeouts(DEFAULTS | {f"{name}_timeout": 0.0 for name in inputs})
    assert set(off.values()) == {float("inf")}
    for name in ("measurement", "feedforward", "tracking"):
        with pytest.raises(InputError, match=f"{name}_timeout = -0.5; allowed: -1 for automatic"):
            check_timeouts(DEFAULTS | {f"{name}_timeout": -0.5})


def test_of_the_measurements_between_two_ticks_the_newest_good_one_counts_and_all_are_judged(graph: Graph) -> None:
    fed = FedController(graph, {"kp": 1.0, "sample_time": 1.0, "setpoint.initial": 0.0})
    fed.sensor = 0.1
    fed.wait(lambda state: state.measurement == 0.1)
    fed.sensor = None
    for value in (0.2, math.nan, 0.3, math.nan):
        if value == 0.3:
            sent = time.time_ns()
        fed.publishers["measurement"].publish(ScalarStamped(value=value))
        graph.spin(0.02)
    state = fed.wait(lambda state: state.measurement != 0.1)
    assert state.measurement == 0.3
    since = (state.header.stamp.sec * 10**9 + state.header.stamp.nanosec - sent) * 1e-9
    assert since > 0.5  # it was sent soon after a tick
    assert since - 0.25 < state.measurement_age <= since  # what it took on the way, on a busy machine
    graph.until(lambda: fed.facts.get("refused of the measurement") == "2", "a count of what was refused")


def test_in_lockstep_a_feedforward_dies_by_the_loops_own_time(graph: Graph) -> None:
    assert timeouts({**DEFAULTS, "trigger": "lockstep"})["feedforward"] == 10_000 * DEFAULTS["sample_time"]
    fed = LockstepByHand(graph, {"kp": 1.0, "setpoint.initial": 0.0, "feedforward_timeout": 10 * PERIOD})
    author = graph.node.create_publisher(ScalarStamped, "feedforward", 1)
    fed.find(author)
    fed.tick(0, 0.0)
    author.publish(ScalarStamped(value=2.0))
    assert author.wait_for_all_acked(Duration(seconds=5))
    controls = [fed.tick(sample, 0.0) for sample in range(1, 31)]
    assert controls[:10] == [2.0] * 10  # ten ticks old and no older, whatever the clock on the wall says
    assert controls[10:20] == pytest.approx([2.0 - 0.2 * k for k in range(1, 11)], abs=1e-12)
    assert controls[20:] == [0.0] * 10


def largest_move(states: list[FopidState]) -> float:
    return max(abs(after.control - before.control) for before, after in pairwise(states))


@pytest.mark.slow
@pytest.mark.parametrize("process", ["P1", "P4"])
def test_when_the_plant_is_killed_the_control_stays_put_and_goes_on_when_it_is_back(graph: Graph, process: str) -> None:
    file = ["--params-file", str(CONFIG / f"{process}.yaml")]
    plant = graph.start("plant_simulator", {}, *file)
    states, _, diagnosed = watched(graph, file)
    graph.until(lambda: states and states[-1].measurement > 0.1, "a loop that moves")
    os.kill(plant.pid, signal.SIGKILL)
    graph.until(lambda: states[-1].stale, "a stale measurement")
    held, since = states[-1].control, len(states)
    graph.until(lambda: any(is_stale(*status) for status in diagnosed()), "an error in the diagnostics")
    graph.spin(1.5)
    assert {state.control for state in states[since:]} == {held}
    assert len({state.integral for state in states[since + 1 :]}) == 1
    graph.start("plant_simulator", {}, *file)
    graph.until(lambda: not states[-1].stale, "a fresh measurement")
    assert abs(next(state for state in states[since:] if not state.stale).control - held) < 0.05
    graph.until(lambda: diagnosed() and diagnosed()[0][0] != ERROR, "an end of the error")


def is_stale(level: bytes, text: str) -> bool:
    return level == ERROR and "measurement stale" in text  # on a busy machine there are late ticks besides


def watched(graph: Graph, more: list[str]) -> tuple:
    """States, the process, and what the newest diagnosis says, of a controller started with these arguments."""
    from diagnostic_msgs.msg import DiagnosticArray

    states = graph.listen(FopidState, "fopid_controller/state")
    reports = graph.listen(DiagnosticArray, "/diagnostics")
    process = graph.start("fopid_controller", {}, *more)

    def diagnosed() -> list[tuple[bytes, str]]:
        return [(status.level, status.message) for status in reports[-1].status
                if status.name == "/fopid_controller"] if reports else []  # fmt: skip

    return states, process, diagnosed


def test_an_addend_dies_with_its_author_within_a_second_and_without_a_bump(graph: Graph) -> None:
    fed = FedController(graph, {"kp": 1.0})
    fed.run(setpoint=1.0, sensor=1.0)
    publisher = graph.node.create_publisher(ScalarStamped, "feedforward", 1)
    graph.until(publisher.get_subscription_count, "the controller")

    def added(state: FopidState) -> bool:
        publisher.publish(ScalarStamped(value=2.0))
        return state.feedforward == 2.0

    fed.wait(added)
    last, begun = time.time(), len(fed.states)  # from here on its author is silent
    gone = fed.wait(lambda state: state.feedforward == 0.0)
    pause = max(state.sample_interval for state in fed.states[begun:])
    # Of a busy machine: by a pause the last word is heard later, and by a pause the end is told later.
    assert gone.header.stamp.sec + gone.header.stamp.nanosec * 1e-9 - last < 1.05 + 2 * pause
    lasting = [state for state in fed.states[begun:] if state.feedforward == 2.0]
    assert len(lasting) * PERIOD > 0.4 - 2 * pause  # a message lost does not end it
    assert largest_move(fed.states[begun:]) <= 2.0 / 0.5 * (pause + PERIOD)
    fed.diagnosed(WARN, "feedforward stale: the loop goes on without it")
    fed.wait(added)
    fed.diagnosed(WARN, "feedforward stale")  # once more silent


def test_in_lockstep_a_measurement_that_is_refused_again_and_again_is_stale_by_the_loops_time(graph: Graph) -> None:
    loop = LockstepByHand(graph, {"kp": 1.0, "ki": 5.0})
    loop.send("setpoint", 1.0)
    controls = [loop.tick(sample, 0.5 if sample < 2 else float("nan")) for sample in range(30)]
    assert [state.stale for state in loop.states] == [sample > 11 for sample in range(30)]  # 0.1 s after sample 1
    assert len(set(controls[11:])) == 1
    assert controls[11] > controls[10]


def test_what_is_stamped_ahead_of_the_clock_is_refused_and_counted_and_cannot_capture_the_loop(graph: Graph) -> None:
    fed = FedController(graph, {"kp": 1.0})
    fed.run(setpoint=1.0, sensor=0.5)
    for sample in range(20):
        ahead = HOUR if sample % 2 else 10**9
        fed.publishers["measurement"].publish(stamped(9.0, time.time_ns() + ahead))
        fed.publishers["setpoint"].publish(stamped(9.0, time.time_ns() + ahead))
        graph.spin(0.02)
    assert {(state.setpoint, state.measurement) for state in fed.states if not state.stale} == {(1.0, 0.5)}
    graph.until(lambda: int(fed.facts.get("stamps ahead of this clock refused", "0")) >= 10, "a count")
    assert int(fed.facts["refused of the measurement"]) + int(fed.facts["refused of the setpoint"]) == int(
        fed.facts["stamps ahead of this clock refused"]
    )
    assert fed.states[-1].refused >= 10
    assert "s ahead of this node's clock; allowed: 0.01 s, a tick and clock_skew_max" in graph.logs()
    assert graph.set("fopid_controller", clock_skew_max=7200.0).successful
    fed.sensor = None

    def taken(state: FopidState) -> bool:
        fed.publishers["measurement"].publish(stamped(0.75, time.time_ns() + HOUR))
        return state.measurement == 0.75

    fed.wait(taken)


@pytest.mark.slow
def test_a_rival_whose_clock_is_an_hour_ahead_is_an_error_and_by_choice_the_safe_control(graph: Graph) -> None:
    fed = FedController(graph, {"kp": 1.0, "ki": 0.5, "safe_control": -0.25})
    fed.run(setpoint=1.0, sensor=0.5)
    fed.recovered()
    rival = Node("rival", context=graph.context)
    publisher = rival.create_publisher(ScalarStamped, "measurement", 1)
    fed.diagnosed(ERROR, "measurement is published by /rival and /tester")
    before = len(fed.states)
    for _ in range(50):
        publisher.publish(stamped(1e9, time.time_ns() + HOUR))
        graph.spin(0.01)
    assert all(state.measurement == 0.5 for state in fed.states[before:])
    assert graph.set("fopid_controller", on_several_publishers="safe").successful
    fed.wait(lambda state: state.control == -0.25)
    rival.destroy_publisher(publisher)
    back = fed.wait(lambda state: state.control != -0.25)
    assert back.control == pytest.approx(-0.25, abs=0.01)  # it goes on from there
    fed.recovered()
    rival.destroy_node()


@pytest.mark.slow
@pytest.mark.parametrize(("policy", "expected"), [("hold", 0.6), ("safe", 0.1)])
def test_in_manual_mode_a_person_who_falls_silent_is_stale_when_a_timeout_says_so(
    graph: Graph, policy: str, expected: float
) -> None:
    parameters = {"kp": 1.0, "mode": "manual", "on_stale": policy, "safe_control": 0.1, "manual_control_timeout": 0.3}
    fed = FedController(graph, parameters)
    fed.sensor, fed.setpoint = 0.5, 1.0

    def driven(state: FopidState) -> bool:
        fed.publishers["manual_control"].publish(ScalarStamped(value=0.6))
        return state.control == 0.6 and not state.stale

    fed.wait(driven)
    fed.wait(lambda state: state.stale and state.control == expected)
    fed.diagnosed(ERROR, "manual_control stale")
    fed.wait(driven)
