"""A cascade of two controller nodes, wired and set as cascade.launch.py does it; motor and axis are the test's own."""

from __future__ import annotations

import math
import os
import signal
from pathlib import Path

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.clock import Clock, ClockType
from rclpy.qos import QoSProfile
from std_srvs.srv import SetBool

from fopid_core.errors import InputError
from fopid_msgs.msg import FopidState, ScalarStamped
from fopid_ros.controller.cascade import check_cascade
from fopid_ros.launching.cascade import Wired, cascade_nodes

from ..conftest import Graph
from ..node_process import NodeProcess

CONFIG = Path(__file__).parents[3] / "config/cascade.yaml"
PERIOD = 0.01
LATE = QoSProfile(depth=1)


class Axis:
    """v' = (10 torque - v) / 0.2, x' = v, by its exact solution; publishes speed and position."""

    def __init__(self, graph: Graph, namespace: str) -> None:
        self.torque = self.speed = self.position = 0.0
        self.furthest = 0.0
        self.moves = True
        node = graph.node
        self._speed = node.create_publisher(ScalarStamped, f"/{namespace}/speed/measurement", LATE)
        self._position = node.create_publisher(ScalarStamped, f"/{namespace}/position/measurement", LATE)
        node.create_subscription(ScalarStamped, f"/{namespace}/speed/control", self._drive, LATE)
        node.create_timer(PERIOD, self._advance, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def _drive(self, message: ScalarStamped) -> None:
        self.torque = message.value

    def _advance(self) -> None:
        decay, settled = math.exp(-PERIOD / 0.2), 10.0 * self.torque
        self.position += settled * PERIOD + 0.2 * (1.0 - decay) * (self.speed - settled)
        self.speed = settled + (self.speed - settled) * decay
        self.furthest = max(self.furthest, self.position)
        self._speed.publish(ScalarStamped(value=self.speed))
        self._position.publish(ScalarStamped(value=self.position))


class Cascade:
    """Two controllers and their axis."""

    def __init__(self, graph: Graph, namespace: str, file: Path = CONFIG) -> None:
        self.graph, self.namespace, self._file = graph, namespace, file
        self.axis = Axis(graph, namespace)
        _, _, inner, outer = cascade_nodes(namespace)
        self.inner_states = graph.listen(FopidState, f"{inner.namespace}/fopid_controller/state")
        self.outer_states = graph.listen(FopidState, f"{outer.namespace}/fopid_controller/state")
        self._diagnostics = graph.listen(DiagnosticArray, "/diagnostics")
        self.inner, self.outer = self.start(inner), self.start(outer)
        self._setpoint = graph.node.create_publisher(ScalarStamped, f"{outer.namespace}/setpoint", 1)
        graph.until(self._setpoint.get_subscription_count, "the position controller")
        graph.until(lambda: self.outer_states and self.inner_states, "both controllers")

    def start(self, node: Wired) -> NodeProcess:
        remaps = [part for names in node.remappings for part in ("-r", ":=".join(names))]
        return self.graph.start(
            node.executable, {}, "--params-file", str(self._file), "-r", f"__ns:={node.namespace}", *remaps
        )

    def ask(self, setpoint: float) -> None:
        self._setpoint.publish(ScalarStamped(value=setpoint))
        self.graph.until(lambda: self.outer_states[-1].setpoint == setpoint, "the setpoint")

    def set_auto(self, which: str, on: bool) -> None:
        answer = self.graph.call(
            SetBool, f"/{self.namespace}/{which}/fopid_controller/set_auto", SetBool.Request(data=on)
        )
        assert answer.success, answer.message

    def arrives_at(self, position: float) -> None:
        def there() -> bool:
            return abs(self.axis.position - position) < 0.02 and abs(self.axis.speed) < 0.02

        self.graph.until(there, f"the axis at {position}")

    def told(self, which: str, level: bytes, text: str) -> None:
        name = f"/{self.namespace}/{which}/fopid_controller"

        def heard() -> bool:
            newest = [one for message in self._diagnostics[-6:] for one in message.status if one.name == name]
            return bool(newest) and newest[-1].level == level and text in newest[-1].message

        self.graph.until(heard, f"{name} with {text!r}")


def test_a_cascade_that_does_not_listen_is_refused() -> None:
    with pytest.raises(InputError, match=r"tracking.required = True, tracking.enabled = False; allowed: both"):
        check_cascade({"tracking.required": True, "tracking.enabled": False})


@pytest.mark.long
def test_the_position_integral_does_not_wind_up_while_the_torque_is_limited_and_without_tracking_it_does(
    graph: Graph, tmp_path: Path
) -> None:
    deaf = tmp_path / "deaf.yaml"
    lines = CONFIG.read_text().splitlines()
    deaf.write_text("\n".join(line for line in lines if not line.strip().startswith("tracking.")))
    wired, blind = Cascade(graph, "wired"), Cascade(graph, "blind", deaf)
    for cascade in (wired, blind):
        cascade.arrives_at(1.0)
        cascade.ask(13.0)
    for cascade in (wired, blind):
        cascade.arrives_at(13.0)
        assert any(state.saturated for state in cascade.inner_states)
    # The speed cannot exceed 2: no more than that, and a little for a busy machine, may the integral stand for.
    assert max(state.integral for state in wired.outer_states) < 2.6
    assert max(state.integral for state in blind.outer_states) > 5.0
    assert wired.axis.furthest - 13.0 < 0.5 * (blind.axis.furthest - 13.0)


@pytest.mark.long
def test_modes_change_without_a_bump_and_whichever_controller_dies_the_other_fails_safe(graph: Graph) -> None:
    cascade = Cascade(graph, "axis")
    cascade.arrives_at(1.0)

    # The speed controller in manual mode: the position controller follows what the speed is, whatever its error.
    cascade.set_auto("speed", False)
    cascade.ask(1.5)
    graph.spin(3.0)
    outer, inner = cascade.outer_states[-1], cascade.inner_states[-1]
    assert abs(outer.integral - cascade.axis.speed) < 0.15  # alone it would have gained 0.25 a second
    begun, before = len(cascade.inner_states), inner.control
    cascade.set_auto("speed", True)
    graph.until(lambda: any(state.mode == FopidState.AUTO for state in cascade.inner_states[begun:]), "auto")
    first = next(state for state in cascade.inner_states[begun:] if state.mode == FopidState.AUTO)
    assert abs(first.control - before) < 0.03  # of 0.4 between the limits: one tick's move, no jump
    cascade.arrives_at(1.5)

    # The position controller in manual mode and back: its control goes on from where it is.
    cascade.set_auto("position", False)
    graph.spin(0.3)
    begun, before = len(cascade.outer_states), cascade.outer_states[-1].control
    cascade.set_auto("position", True)
    graph.until(lambda: any(state.mode == FopidState.AUTO for state in cascade.outer_states[begun:]), "auto")
    first = next(state for state in cascade.outer_states[begun:] if state.mode == FopidState.AUTO)
    assert abs(first.control - before) < 0.05
    cascade.arrives_at(1.5)

    # The speed controller dies: the position controller stands still, and says so.
    os.kill(cascade.inner.pid, signal.SIGKILL)
    cascade.axis.torque = 0.0  # the drive's own watchdog
    graph.until(lambda: cascade.outer_states[-1].stale, "a position controller that misses the other")
    since = len(cascade.outer_states)
    cascade.told("position", DiagnosticStatus.ERROR, "tracking stale")
    cascade._setpoint.publish(ScalarStamped(value=4.0))
    graph.spin(1.5)
    held = cascade.outer_states[since:]
    assert len({state.control for state in held}) == 1
    assert len({state.integral for state in held[1:]}) == 1
    cascade.inner = cascade.start(cascade_nodes("axis")[2])
    graph.until(lambda: not cascade.outer_states[-1].stale, "a position controller that goes on")
    cascade.arrives_at(4.0)

    # The position controller dies: the motor is left alone.
    os.kill(cascade.outer.pid, signal.SIGKILL)
    graph.until(lambda: cascade.inner_states[-1].stale, "a speed controller that misses the other")
    graph.until(lambda: cascade.axis.torque == 0.0, "the safe torque")
    cascade.told("speed", DiagnosticStatus.ERROR, "setpoint stale")
