"""A controller node whose gains follow a measured variable, and what it does when that falls silent."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.clock import Clock, ClockType

from fopid_core.errors import InputError
from fopid_core.model.fopid import Fopid
from fopid_core.runtime.controller import FopidController
from fopid_core.runtime.schedule import read_schedule
from fopid_core.runtime.scheduler import GainScheduler
from fopid_core.runtime.settings import ControllerSettings
from fopid_msgs.msg import FopidState, ScalarStamped
from fopid_ros.controller.scheduling import check_scheduled_gains

from ..conftest import Graph
from .fed import NAME, PERIOD, FedController, LockstepByHand

TABLE = """
variable: level [m]
points:
  - {at: 0.0, kp: 1.0, ki: 0.5, lam: 0.9}
  - {at: 1.0, kp: 3.0, ki: 1.5, lam: 1.1}
"""


@pytest.fixture
def file(tmp_path: Path) -> Path:
    file = tmp_path / "table.yaml"
    file.write_text(TABLE)
    return file


def gains(state: FopidState) -> tuple[float, ...]:
    return (state.kp, state.ki, state.kd, state.lam, state.mu)


@pytest.mark.slow
def test_the_gains_follow_the_topic_stay_when_it_falls_silent_and_nan_is_refused(graph: Graph, file: Path) -> None:
    fed = FedController(graph, {"schedule_file": str(file)})
    publisher = graph.node.create_publisher(ScalarStamped, "scheduling_variable", 1)
    graph.until(publisher.get_subscription_count, "the controller")
    fed.setpoint = fed.sensor = 1.0
    fed.diagnosed(DiagnosticStatus.WARN, "waiting for scheduling_variable")

    level: list[float | None] = [None]

    def send() -> None:
        if level[0] is not None:
            publisher.publish(ScalarStamped(value=level[0]))

    graph.node.create_timer(PERIOD, send, clock=Clock(clock_type=ClockType.STEADY_TIME))
    level[0] = 0.5
    there = fed.wait(lambda state: state.kp == 2.0)
    assert gains(there) == pytest.approx((2.0, 1.0, 0.0, 1.0, 1.0))
    level[0] = 7.0  # beyond the table
    fed.wait(lambda state: state.kp == 3.0)
    level[0] = None
    fed.diagnosed(DiagnosticStatus.WARN, "scheduling_variable stale: the gains stay as they are")
    assert fed.states[-1].kp == 3.0
    assert not fed.states[-1].stale  # the loop goes on
    assert fed.facts["schedule at, of level [m]"] == "1"
    level[0] = math.nan
    fed.diagnosed(DiagnosticStatus.WARN, "values refused")
    assert fed.states[-1].kp == 3.0
    level[0] = 0.0
    fed.wait(lambda state: state.kp == 1.0)
    answer = graph.set(NAME, kp=5.0)
    assert not answer.successful
    assert "kp = 5.0; allowed: as it is, since the gains are those of schedule_file" in answer.reason
    assert graph.set(NAME, control_max=50.0).successful
    assert fed.states[-1].kp == 1.0


@pytest.mark.slow
def test_in_lockstep_it_is_the_core_bit_for_bit(graph: Graph, file: Path) -> None:
    loop = LockstepByHand(graph, {"schedule_file": str(file), "schedule_by": "measurement"})
    loop.send("setpoint", 1.0)
    schedule, _ = read_schedule(file)
    controller = FopidController(ControllerSettings(Fopid(0.0), PERIOD, band=None))
    scheduler = GainScheduler(schedule, controller)
    for sample in range(60):
        measured = 0.5 + 0.7 * math.sin(0.2 * sample)
        scheduler.follow(measured)
        assert loop.tick(sample, measured) == controller.step(1.0, measured)
    assert gains(loop.states[-1]) == scheduler.gains.gains


@pytest.mark.parametrize("table", ["points: 3", "points: [{at: 0, kp: 1}, {at: 0, kp: 2}]", None])
def test_a_table_that_cannot_be_used_ends_the_start_with_one_line(graph: Graph, file: Path, table: str | None) -> None:
    if table is None:
        file.unlink()
    else:
        file.write_text(table)
    process = graph.start(NAME, {"schedule_file": str(file)})
    assert process.wait(30) == 2
    (line,) = [line for line in process.log.read_text().splitlines() if line.startswith("error:")]
    assert str(file) in line


def test_gains_that_are_set_beside_a_table_are_refused_and_others_are_not() -> None:
    before = {"kp": 1.0, "ki": 0.0, "kd": 0.0, "lam": 1.0, "mu": 1.0, "schedule_file": "table.yaml"}
    check_scheduled_gains(before, before)
    check_scheduled_gains(before | {"schedule_file": ""}, before | {"kp": 2.0, "schedule_file": ""})
    with pytest.raises(InputError, match=r"lam = 0.5; allowed: as it is"):
        check_scheduled_gains(before, before | {"lam": 0.5})
