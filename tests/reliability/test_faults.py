"""A disk that is full, a clock that jumps, and transitions of the lifecycle in every state."""

from __future__ import annotations

import errno
import random
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from lifecycle_msgs.msg import State
from lifecycle_msgs.srv import ChangeState, GetState
from rclpy.clock import Clock, ClockType
from rosgraph_msgs.msg import Clock as ClockMessage
from std_srvs.srv import Trigger

from fopid_msgs.msg import ScalarStamped
from fopid_ros.controller.retained import Retainer

from ..ros.conftest import Graph
from ..share import share_of
from .record import outside_limits, settled_at
from .rig import GAINS, LIMITS, SETPOINT, STATE, Rig

HOUR = 3600.0
JUMPS, STEPS = 40, 400
SILENCE = 0.5
"""The longest time without a control after a clock has jumped [s]: the watchdog's, and what a busy machine adds."""
STATES = {
    "unconfigured": {"configure": "inactive"},
    "inactive": {"activate": "active", "cleanup": "unconfigured"},
    "active": {"deactivate": "inactive"},
}
LABELS = ("configure", "activate", "deactivate", "cleanup")


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[Path]:
    """A disk of 64 kB."""
    place = tmp_path / "disk"
    place.mkdir()
    made = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=64k", "tmpfs", str(place)], capture_output=True, text=True, check=False
    )
    if made.returncode:
        pytest.skip(f"a small disk cannot be mounted here: {made.stderr.strip()}")
    yield place
    subprocess.run(["umount", "--lazy", str(place)], check=True)


def fill(disk: Path) -> Path:
    """Write until nothing more fits."""
    filler = disk / "filler"
    with filler.open("wb", buffering=0) as file:
        try:
            while True:
                file.write(b"x" * 4096)
        except OSError as error:
            if error.errno != errno.ENOSPC:
                raise
    return filler


def test_a_full_disk_takes_the_kept_gains_and_nothing_else(
    graph: Graph, disk: Path, tmp_path: Path, figures: Callable[..., None]
) -> None:
    (disk / "log").touch()
    filler = fill(disk)
    graph.environment["ROS_LOG_DIR"] = str(disk / "logs")
    retain = {"retain": True, "directory": str(disk), "gains_file": "gains.yaml", "measurement_timeout": 0.0}
    limits = {"control_min": LIMITS[0], "control_max": LIMITS[1]}
    graph._folder = disk  # what the controller says goes there, too
    graph.start("fopid_controller", {**GAINS, **limits, "setpoint.initial": SETPOINT, **retain})
    graph._folder = tmp_path
    controls = graph.listen(ScalarStamped, "control")
    told = graph.listen(DiagnosticArray, "/diagnostics")
    sensor = graph.node.create_publisher(ScalarStamped, "measurement", 1)
    graph.node.create_timer(0.01, lambda: sensor.publish(ScalarStamped(value=0.95)))
    graph.until(lambda: controls, "a control")
    changes = share_of(200)
    for k in range(changes):
        assert graph.set("fopid_controller", kp=1.0 + 0.001 * k).successful
    answer = graph.call(Trigger, "fopid_controller/save_gains")
    assert not answer.success
    assert "No space left" in answer.message
    graph.until(lambda: told and "gains not kept" in told[-1].status[0].message, "what the diagnostics tell")
    filler.unlink()
    assert graph.set("fopid_controller", kp=1.7).successful
    graph.until(lambda: Retainer(disk, "/fopid_controller").read().gains["kp"] == 1.7, "the gains on the disk")
    begun = len(controls)
    graph.spin(1.0)
    assert len(controls) - begun > 80
    assert not outside_limits(((0.0, message.value) for message in controls), *LIMITS)
    told_so = "`/diagnostics` told that they are not kept; kept again once there was space; controls within limits"
    figures(
        "fault-1-disk", fault="full disk (gains, log and output on it)",
        seen=f"{changes} changes of gains came into force, {told_so}",
    )  # fmt: skip


class SimulatedTime:
    """A first-order plant and ``/clock``, at 100 Hz; ``offset`` makes the clock jump, ``runs`` lets it stand."""

    def __init__(self, graph: Graph) -> None:
        self.offset, self.runs, self._sim, self._output, self._control = 2 * HOUR, True, 0.0, SETPOINT, SETPOINT
        self.controls: list[tuple[float, float]] = []
        self.outputs: list[tuple[float, float]] = []
        self._clock = graph.node.create_publisher(ClockMessage, "/clock", 1)
        self._sensor = graph.node.create_publisher(ScalarStamped, "measurement", 1)
        graph.node.create_subscription(ScalarStamped, "control", self._heard, 10)
        graph.node.create_timer(0.01, self._tick, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def _heard(self, message: ScalarStamped) -> None:
        self._control = message.value
        self.controls.append((time.monotonic(), message.value))

    def _tick(self) -> None:
        self._sim += 0.01 * self.runs
        self._output += 0.1 * (self._control - self._output)
        self.outputs.append((time.monotonic(), self._output))
        stamp = ClockMessage()
        stamp.clock.sec, stamp.clock.nanosec = divmod(round((self._sim + self.offset) * 1e9), 10**9)
        self._clock.publish(stamp)
        message = ScalarStamped(value=self._output)
        message.header.stamp = stamp.clock
        self._sensor.publish(message)


@pytest.mark.parametrize("simulated", [True, False], ids=["of the loop", "of the sensor"])
def test_a_clock_that_jumps_holds_the_control_and_it_comes_back(
    graph: Graph, simulated: bool, figures: Callable[..., None]
) -> None:
    limits = {"control_min": LIMITS[0], "control_max": LIMITS[1]}
    more = {"setpoint.initial": SETPOINT, "use_sim_time": simulated, "safe_control": SETPOINT}
    plant = SimulatedTime(graph)
    plant.offset += 0.0 if simulated else time.time() - 3 * HOUR
    graph.start("fopid_controller", {"kp": 0.5, "ki": 2.0, **limits, **more})
    graph.until(lambda: len(plant.controls) > 100, "the loop")
    draw, longest, jumps = random.Random(5), 0.0, share_of(JUMPS)
    for _ in range(jumps):
        jump, jumped = draw.choice((-HOUR, HOUR, -1.0, 1.0, -0.05, 0.05, 0.0)), time.monotonic()
        plant.offset += jump
        if not jump:
            plant.runs = False
            graph.spin(draw.uniform(0.1, 1.0))
            plant.runs = True
        back = time.monotonic()
        graph.spin(2.0)
        ahead = not simulated and plant.offset > time.time()
        since = [at for at, _ in plant.controls if at >= back]
        assert since, f"no control after a jump by {jump} s"
        longest = max(longest, since[0] - back)
        plant.offset = plant.offset - jump if ahead else plant.offset
        assert not outside_limits((one for one in plant.controls if one[0] >= jumped), *LIMITS)
    graph.until(lambda: settled_at(plant.outputs[-100:], SETPOINT, 0.05, 0.3) is not None, "at its setpoint", 30.0)
    assert longest < SILENCE + 0.5
    whose = "the loop's clock (`use_sim_time`)" if simulated else "the sensor's stamps"
    figures(
        f"fault-{2 if simulated else 3}-clock", fault=f"{whose} jumping by 50 ms, 1 s, 1 h, either way, or standing",
        seen=f"{jumps} jumps; no control for {longest:.2f} s at most; within limits, at the setpoint at the end",
    )  # fmt: skip


def test_transitions_in_every_state_are_answered_and_the_loop_comes_back(
    rig: Rig, figures: Callable[..., None]
) -> None:
    graph, draw, steps = rig.graph, random.Random(9), share_of(STEPS)
    names = ("plant_simulator", "fopid_controller", "fopid_tuner")
    states, began, seen = dict.fromkeys(names, "active"), time.monotonic(), set()

    def change(name: str, label: str) -> bool:
        request = ChangeState.Request()
        request.transition.label = label
        return bool(graph.call(ChangeState, f"{name}/change_state", request).success)

    for _ in range(steps):
        name, label = draw.choice(names), draw.choice(LABELS)
        allowed = STATES[states[name]].get(label)
        assert change(name, label) == (allowed is not None), (name, states[name], label)
        seen.add((name, states[name], label))
        states[name] = allowed or states[name]
        assert graph.call(GetState, f"{name}/get_state").current_state.label == states[name]
    for name in names:
        for label in ("configure", "activate"):
            if label in STATES[states[name]]:
                assert change(name, label)
                states[name] = STATES[states[name]][label]
    back = time.monotonic()
    rig.wait(lambda: settled_at(rig.samples("measurement", back), SETPOINT, 0.05, 0.3), "the loop is back", 20.0)
    assert not outside_limits(rig.samples("control", began), *LIMITS)
    assert rig.samples(STATE, back)
    for name in names:
        assert change(name, "shutdown")
        assert graph.call(GetState, f"{name}/get_state").current_state.id == State.PRIMARY_STATE_FINALIZED
    pairs = f"{steps} transitions of three nodes, {len(seen)} of 36 pairs of state and transition"
    figures(
        "fault-4-lifecycle", fault="transitions in every state",
        seen=f"{pairs}: each answered as the state allows; the loop came back",
    )  # fmt: skip
