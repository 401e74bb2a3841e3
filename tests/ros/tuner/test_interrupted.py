"""A tuner that is killed, stopped or led through its states while it works leaves the loop as it was."""

from __future__ import annotations

import math
import os
import signal
import time
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from lifecycle_msgs.msg import State
from lifecycle_msgs.srv import ChangeState, GetState

from fopid_msgs.msg import FopidState, ScalarStamped
from fopid_msgs.srv import Identify, Reduce, Tune

from ...patience import FACTOR
from ..conftest import Graph, only_line
from .test_autotune import PI, ForeignLoop

TUNER = "fopid_tuner"
GONE = 1.0
"""Within this time of its author's end an addend must be gone [s]."""
FADE = 0.5  # [s] of that time, the second half
CLOCKS = 0.02  # [s] between the reading of a state's stamp and that of its age


@pytest.fixture
def loop(graph: Graph) -> ForeignLoop:
    return ForeignLoop(graph, "saturating", PI, steps=False)


def excited(loop: ForeignLoop, **goal: Any) -> tuple[Any, list[FopidState]]:
    """An autotuning that moves the control, and what the controller tells."""
    states = loop.graph.listen(FopidState, "fopid_controller/state")
    handle = loop.autotune(**{"deviation_max": 0.3, "duration": 30.0, **goal})
    loop.graph.until(lambda: states and states[-1].feedforward, "the excitation")
    return handle, states


def stamp_s(told: FopidState) -> float:
    return told.header.stamp.sec + told.header.stamp.nanosec * 1e-9


def change(graph: Graph, label: str, node: str = TUNER) -> bool:
    request = ChangeState.Request()
    request.transition.label = label
    return bool(graph.call(ChangeState, f"{node}/change_state", request).success)


def state(graph: Graph) -> int:
    return int(graph.call(GetState, f"{TUNER}/get_state").current_state.id)


@pytest.mark.slow
@pytest.mark.parametrize("end", [signal.SIGKILL, signal.SIGSTOP])
def test_the_addend_dies_with_its_author_and_without_a_bump(loop: ForeignLoop, end: int) -> None:
    _, states = excited(loop)
    os.kill(loop.tuner.pid, end)
    died, begun = time.monotonic(), len(states)
    try:
        loop.graph.until(lambda: states[-1].feedforward == 0.0, "the addend is gone")
        took = time.monotonic() - died
        assert took < GONE + 0.5, took  # half a second for what a busy machine is late
        loop.graph.spin(1.0)
    finally:
        if end == signal.SIGSTOP:
            os.kill(loop.tuner.pid, signal.SIGKILL)
    assert states[-1].feedforward == 0.0
    size = max(abs(told.feedforward) for told in states[begun:])
    for before, after in pairwise(states[begun:]):  # a straight line from a constant to nothing, however late a tick is
        passed = stamp_s(after) - stamp_s(before) + CLOCKS
        assert abs(after.feedforward - before.feedforward) < size * passed / FADE


def test_a_tuner_that_stood_still_ends_its_experiment_since_what_it_hears_then_is_old(loop: ForeignLoop) -> None:
    before = loop.gains()
    handle, states = excited(loop)
    os.kill(loop.tuner.pid, signal.SIGSTOP)
    try:
        loop.graph.spin(2 * GONE)
    finally:
        os.kill(loop.tuner.pid, signal.SIGCONT)
    result = loop.outcome(handle).result
    assert not result.success
    assert "s old when it was heard" in result.message
    assert states[-1].feedforward == 0.0
    assert loop.gains() == before


@pytest.mark.slow
def test_after_a_restart_there_is_no_addend_and_no_author(loop: ForeignLoop) -> None:
    _, states = excited(loop)
    os.kill(loop.tuner.pid, signal.SIGKILL)
    loop.graph.spin(2 * GONE)
    told = loop.graph.listen(DiagnosticArray, "/diagnostics")
    loop.graph.start(TUNER, {"process": "P1"})
    loop.graph.until(lambda: any(m.status[0].name == f"/{TUNER}" for m in told), "the tuner is back")
    begun = len(states)
    loop.graph.spin(1.0)
    assert not any(told.feedforward for told in states[begun:])


@pytest.mark.parametrize("label", ["deactivate", pytest.param("shutdown", marks=pytest.mark.slow)])
def test_leaving_the_active_state_ends_an_autotuning_first(loop: ForeignLoop, label: str) -> None:
    before = loop.gains()
    handle, states = excited(loop)
    assert change(loop.graph, label)
    result = loop.outcome(handle).result
    assert not result.success
    assert f"autotune was cancelled: the node is told to {label}" in result.message
    loop.graph.until(lambda: states[-1].feedforward == 0.0, "the addend is gone", GONE + 0.5)
    assert loop.added[-1].value == 0.0
    assert loop.gains() == before
    expected = State.PRIMARY_STATE_INACTIVE if label == "deactivate" else State.PRIMARY_STATE_FINALIZED
    assert state(loop.graph) == expected
    if label == "deactivate":
        answer = loop.graph.call(Tune, f"{TUNER}/tune", Tune.Request(process="P1", phase_margin=1.2, crossover=0.5))
        assert "the node is not active" in answer.message
        assert change(loop.graph, "cleanup")
        assert change(loop.graph, "configure")
        assert change(loop.graph, "activate")
        assert loop.graph.call(Reduce, f"{TUNER}/reduce", Reduce.Request(process="P1")).success
    assert "internal error" not in loop.graph.logs()


@pytest.mark.long
def test_leaving_while_new_gains_are_watched_puts_the_old_ones_back(loop: ForeignLoop) -> None:
    before = loop.gains()
    handle = loop.autotune(deviation_max=0.3, duration=8.0)
    loop.graph.until(lambda: loop.feedback and loop.feedback[-1].phase == "watching", "the trial", 200.0 * FACTOR)
    assert loop.gains() != before
    assert change(loop.graph, "deactivate")
    assert "cancelled" in loop.outcome(handle).result.message
    assert loop.gains() == before


def dead_sensor(loop: ForeignLoop) -> None:
    loop.plant.kill()


def manual_mode(loop: ForeignLoop) -> None:
    loop.graph.set("fopid_controller", mode="manual")


def inactive_controller(loop: ForeignLoop) -> None:
    change(loop.graph, "deactivate", "fopid_controller")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("opened", "named"),
    [
        (dead_sensor, "the controller waits for a fresh measurement: the newest is "),
        (manual_mode, "the controller is in manual mode"),
        (inactive_controller, "no control heard for 3 s"),
    ],
)
def test_an_experiment_ends_where_the_loop_is_open(loop: ForeignLoop, opened: Any, named: str) -> None:
    """Each of them was excited to the end, and then again with larger moves."""
    before = loop.gains()
    handle, _ = excited(loop)
    opened(loop)
    began = time.monotonic()
    result = loop.outcome(handle).result
    assert named in result.message
    assert not result.success
    assert time.monotonic() - began < 5.0
    assert loop.added[-1].value == 0.0
    assert loop.gains() == before


@pytest.mark.slow
def test_an_experiment_ends_where_somebody_gives_other_gains_which_stay(loop: ForeignLoop) -> None:
    """It went on, and what it showed was no single loop's."""
    handle, _ = excited(loop)
    assert loop.graph.set("fopid_controller", kp=1.1 * PI["kp"]).successful
    result = loop.outcome(handle).result
    assert not result.success
    assert "the controller was given other gains meanwhile" in result.message
    assert loop.gains()[0] == 1.1 * PI["kp"]


@pytest.mark.slow
def test_a_controller_that_waits_for_a_setpoint_is_not_waited_for(graph: Graph) -> None:
    """It was waited for without end."""
    loop = ForeignLoop(graph, "saturating", PI, steps=False, setpoint=None)
    assert "no setpoint heard for 3 s" in loop.outcome(loop.autotune()).result.message


@pytest.mark.slow
def test_what_is_not_allowed_while_it_works_is_refused_and_the_work_goes_on(loop: ForeignLoop) -> None:
    handle, states = excited(loop)
    for label in ("cleanup", "configure", "activate"):
        assert not change(loop.graph, label)
    loop.graph.spin(0.5)
    assert states[-1].feedforward != 0.0
    loop.graph.result(handle.cancel_goal_async())
    assert "cancelled" in loop.outcome(handle).result.message


ODD_REQUESTS = [
    {"process": "s/(s+1)"}, {"process": "s/(s+1)", "method": "time"}, {"method": "time", "horizon": 1e308},
    {"method": "time", "horizon": 5e-324}, {"crossover": 1e308}, {"crossover": 5e-324}, {"timeout": 1e308},
    {"process": "1/(s+1)*exp(-1e300s)"}, {"process": "1e308/(1e308s+1)"}, {"process": "(" * 900 + "s" + ")" * 900},
    {"phase_margin": float("inf")}, {"method": "\x00"}, {"method": "rule", "rule": "\ud7ff"}, {"t_max_db": 1e308},
    {"ms_max": float("-inf"), "method": "time"}, {"process": "/dev/zero.yaml"}, {"process": "../x.yml"},
]  # fmt: skip


@pytest.mark.slow
def test_no_request_ends_the_tuner(graph: Graph) -> None:
    tuner = graph.start(TUNER, {"process": "P1", "timeout": 10.0})
    for fields in ODD_REQUESTS:
        request = Tune.Request(**{"phase_margin": 1.0, "crossover": 0.3, **fields})
        answer = graph.call(Tune, f"{TUNER}/tune", request)
        gains = [getattr(answer.gains, name) for name in ("kp", "ki", "kd", "lam", "mu")]
        assert all(map(math.isfinite, gains)) if answer.success else answer.message, fields
        assert tuner.returncode is None, fields
    assert not graph.call(Reduce, f"{TUNER}/reduce", Reduce.Request(process="s/(s+1)", template_name="x")).success
    assert not graph.call(Identify, f"{TUNER}/identify", Identify.Request(duration=-1e308)).success
    assert graph.call(Tune, f"{TUNER}/tune", Tune.Request(phase_margin=1.2, crossover=0.5)).success


def test_a_process_over_ros_is_never_a_file(graph: Graph, tmp_path: Path) -> None:
    tuner = graph.start(TUNER, {"process": "P1"})
    pipe = tmp_path / "pipe.yaml"
    os.mkfifo(pipe)
    for kind, name in ((Tune, "tune"), (Reduce, "reduce")):
        answer = graph.call(kind, f"{TUNER}/{name}", kind.Request(process=str(pipe)))
        assert not answer.success
        assert "files are not read" in answer.message
    assert not graph.set(TUNER, process=str(pipe)).successful
    tuner.terminate()
    assert tuner.wait(10) == 0


def test_a_pipe_in_place_of_a_process_file_is_refused_and_hangs_nobody(graph: Graph, tmp_path: Path) -> None:
    pipe = tmp_path / "pipe.yaml"
    os.mkfifo(pipe)
    plant = graph.start("plant_simulator", {"process": str(pipe)})
    assert plant.wait(15) == 2
    assert str(pipe) in only_line(plant.log.read_text())


def test_a_state_that_nobody_hears_is_not_sent_and_its_rate_can_be_limited(graph: Graph) -> None:
    graph.start("fopid_controller", {"kp": 1.0, "setpoint.initial": 1.0, "state_rate": 20.0})
    sensor = graph.node.create_publisher(ScalarStamped, "measurement", 1)
    graph.node.create_timer(0.01, lambda: sensor.publish(ScalarStamped(value=0.5)))
    states = graph.listen(FopidState, "fopid_controller/state")
    graph.until(lambda: states, "a state")
    begun = len(states)
    graph.spin(2.0)
    assert 25 < len(states) - begun < 45
