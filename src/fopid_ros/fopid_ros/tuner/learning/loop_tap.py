"""The running loop as the tuner hears it: signals kept for learning, and one addend to the control.

The setpoint is the one that the controller says it follows. A second reader of the topic setpoint would take the place
of the controller's where ``ros2 topic pub --once`` waits for somebody who listens.
"""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from rclpy.clock import Clock, ClockType
from rclpy.duration import Duration
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription

from fopid_core.errors import InputError
from fopid_core.runtime.angles import nearest_turn
from fopid_msgs.msg import FopidState
from fopid_ros.common.cdr import Layout
from fopid_ros.common.diagnostics import PublisherConflicts, Rivalry
from fopid_ros.common.managed_node import ManagedNode, loop_qos, take_pending_messages
from fopid_ros.common.parameters import Spec
from fopid_ros.common.signals import DEFAULT_TYPE, SignalType, signal_specs, signal_type
from fopid_ros.tuner.learning.history import EXCITATION, SIGNALS, History
from fopid_ros.tuner.learning.undelayed_arrival import UndelayedArrival

INJECTION = "feedforward"
STATE = Layout(FopidState)
HEARD = ("measurement", "control")

SPECS = (
    Spec("history", 600.0, "signals kept for ~/identify and ~/autotune [s]; 0 to listen to none", 0.0, 1e6,
         at_configure=True),
    *(spec for name in (*HEARD, INJECTION) for spec in signal_specs(name)),
    Spec(
        "angle_wraparound",
        False,
        "the measurement is an angle [rad] that wraps around, as the controller's",
        read_only=True,
    ),
)  # fmt: skip
LISTENING = QoSProfile(depth=1000, reliability=ReliabilityPolicy.BEST_EFFORT)
"""Best effort hears reliable publishers, too; a tick lost is a gap that the identification allows for."""

REPEAT_PERIOD = 0.1
"""The addend is told again so often [s]: a controller that hears nothing more of it lets it fade out. As often an idle
tuner looks at what it has heard."""
MEETING_TIME = 3.0
"""How long it may take until a controller and the publisher of the addend know each other [s]."""
TAKEN_TIME = 0.3
"""How long a controller may take to confirm the last addend [s]; it fades without that, too."""


@dataclass(frozen=True)
class Tick:
    """What the loop did at one tick of the controller, and how old that was when it was heard [s]."""

    time: float
    setpoint: float
    measurement: float
    control: float
    age: float = 0.0


def _signal_types(values: dict[str, Any]) -> dict[str, SignalType]:
    """How the signals travel; the addend to a joint is named after it, unless told otherwise."""
    types = {name: signal_type(values, name) for name in (*HEARD, INJECTION)}
    if values["dof"] and values[f"{INJECTION}.type"] == DEFAULT_TYPE:
        types[INJECTION] = SignalType("sensor_msgs/msg/JointState", f"effort[{values['dof']}]", INJECTION)
    return types


class LoopTap:
    """Hears measurement, control and the state of the controller; adds to the control through the topic feedforward.

    That topic is published only from ``begin_injection`` to ``end_injection``, again and again: the addend dies with
    its author.
    All that touches it runs on the executor's thread.

    Parameters
    ----------
    node : ManagedNode
        Whose topics they are.
    values : mapping
        Its parameters.

    Raises
    ------
    InputError
        If a message type or field cannot be used.
    """

    def __init__(self, node: ManagedNode, values: dict[str, Any]) -> None:
        self._node = node
        self._types = types = _signal_types(values)
        self.history = History(values["history"])
        self._hook: Callable[[Tick], None] | None = None
        self._failed: Exception | None = None
        self._ticked = threading.Condition()
        self._open_since, self._open_because = math.inf, ""
        self._law: tuple[float, ...] = ()
        self._unusable: dict[str, str] = {}
        self._write = types[INJECTION].writer()
        self._injection: Publisher | None = None
        self._added = 0.0
        # Two signals are laid over each other: both by their stamps, or both by when they came.
        self._by_stamps = bool(values["dof"]) or all(types[name].has_header for name in HEARD)
        self._wraps = values["angle_wraparound"]
        self._conflicts = PublisherConflicts(node, ())
        self._state_arrival = UndelayedArrival()
        self._measured: deque[tuple[int, float]] = deque(maxlen=LISTENING.depth)  # since the newest control
        self._measurement = math.nan
        self._waiting: list[Subscription] = []
        self._control: Subscription | None = None  # where it may wait, too
        self._prompt = True
        if not values["history"]:
            return
        if values["dof"]:
            state = f"{values['controller']}/{values['dof']}/state"
            node.endpoints.subscription(FopidState, state, self._on_joint_state, LISTENING, raw=True)
        else:
            state = f"{values['controller']}/state"
            measurement, control = (self._subscribe(name, types[name]) for name in HEARD)
            said = node.endpoints.subscription(FopidState, state, self._on_state, LISTENING, raw=True)
            if not (self._wraps or node.get_parameter("use_sim_time").value):  # else each is to be read as it comes
                self._waiting, self._control = [measurement, said], control
                node.taken_by_hand.update((measurement, said, control))
        self._prompt = self._control is None
        self._conflicts = PublisherConflicts(node, (state,) if values["dof"] else HEARD)
        node.endpoints.timer(REPEAT_PERIOD, self._repeat, Clock(clock_type=ClockType.STEADY_TIME))

    def _subscribe(self, name: str, kind: SignalType) -> Subscription:
        arrival = UndelayedArrival()

        def heard(message: Any, info: dict[str, int]) -> None:
            if name == "control":
                self._take_what_waits()
            stamp, came = kind.stamp_ns(message) if self._by_stamps else None, arrival.time_ns(info)
            age = (time.time_ns() - came) * 1e-9
            self._heard(name, (stamp or self._arrival_ns(came)) * 1e-9, kind.read(message), age, came)

        return self._node.endpoints.subscription(kind.message_type, name, heard, LISTENING, raw=kind.raw)

    def close(self) -> None:
        """Before its subscriptions are: a control that has come already finds none of them to look at."""
        self._waiting, self._control = [], None

    def _take_what_waits(self) -> None:
        """All but the control; a tick's messages wake the process once, since waking costs more than they do."""
        for subscription in self._waiting:
            take_pending_messages(subscription, informed=True)

    def _look_at_control(self) -> None:
        """With a hook the control wakes the process; without one nobody is in a hurry, and it is looked at here."""
        if self._control is None:
            return
        if not self._prompt:
            take_pending_messages(self._control, informed=True)
        prompt = self._hook is not None
        if prompt != self._prompt:
            self._prompt = prompt
            by_hand = self._node.taken_by_hand
            (by_hand.discard if prompt else by_hand.add)(self._control)
            if self._node.executor is not None:
                self._node.executor.wake()

    def _arrival_ns(self, came: int) -> int:
        """By the clock that the loop runs by, what came at this time of the system's."""
        simulated = self._node.get_parameter("use_sim_time").value
        return int(self._node.get_clock().now().nanoseconds if simulated else came)

    def _heard(self, name: str, at: float, value: float, age: float = 0.0, came: int = 0) -> None:
        if not -1e300 < value < 1e300:
            self._unusable[name] = f", and {value} comes now"
            return
        self._unusable[name] = ""
        if self._wraps and name == "measurement":
            setpoint = self.history.newest("setpoint")
            value = value if math.isnan(setpoint) else nearest_turn(value, setpoint)
        self.history.add(name, at, value)
        if name == "measurement":
            self._measured.append((came, value))
        if name != "control":
            return
        tick = Tick(at, self.history.newest("setpoint"), self._measured_by(came), value, age)
        if math.isnan(tick.setpoint + tick.measurement):
            return
        if self._hook is not None and self._prompt:
            self._call_hook(tick)
        with self._ticked:
            self._ticked.notify_all()

    def _measured_by(self, came: int) -> float:
        """The newest measurement that was there then [ns]; what is read at once after a halt may hold younger ones."""
        while self._measured and self._measured[0][0] <= came:
            self._measurement = self._measured.popleft()[1]
        return self._measurement

    def _call_hook(self, tick: Tick) -> None:
        if self._hook is None:
            return
        try:
            self._hook(tick)
        except Exception as error:  # noqa: BLE001  (raised again where the loop is waited for)
            self._hook, self._failed = None, error

    def _on_state(self, message: bytes, info: dict[str, int]) -> None:
        self._take_setpoint(STATE.unpack(message), info)

    def _note_open_loop(self, state: Any) -> None:
        """Since when the controller does not close the loop, and why."""
        if not state.stale and state.mode != FopidState.MANUAL:
            self._open_since = math.inf
            return
        self._open_since = min(self._open_since, time.monotonic())
        age = state.measurement_age
        if state.mode == FopidState.MANUAL:
            self._open_because = "is in manual mode"
        elif age < time.monotonic() - self._open_since:
            self._open_because = "waits for a fresh setpoint"
        else:
            what_comes = self._unusable.get("measurement", "")
            self._open_because = f"waits for a fresh measurement: the newest is {age:.3g} s old{what_comes}"

    def open_loop(self, since: float) -> tuple[float, str]:
        """For how long the controller has not closed the loop [s], not longer than from ``since`` on, and why.

        Parameters
        ----------
        since : float
            By the monotonic clock [s].
        """
        return time.monotonic() - max(since, self._open_since), self._open_because

    @property
    def unheard(self) -> str:
        """The signals of which nothing has come yet, or, as far as these go, the control, which makes the ticks."""
        return " and ".join(name for name in SIGNALS if math.isnan(self.history.newest(name))) or "control"

    def _take_setpoint(self, state: Any, info: dict[str, int]) -> None:
        """The setpoint, where the controller has one, and when it has changed; or the controller itself has."""
        came = self._state_arrival.time_ns(info)
        self._note_open_loop(state)
        law = (state.kp, state.ki, state.kd, state.lam, state.mu, self._open_since)
        moved = not (math.isnan(state.setpoint) or state.setpoint == self.history.newest("setpoint"))
        if not moved and law == self._law:
            return
        stamp_ns = state.stamp_ns if self._by_stamps else self._arrival_ns(came)
        if law != self._law:
            if self._law[:-1] not in ((), law[:-1]):
                self.history.regained = stamp_ns * 1e-9
            self._law, self.history.changed = law, stamp_ns * 1e-9
        if not moved:
            return
        self._heard("setpoint", stamp_ns * 1e-9, state.setpoint)

    def _on_joint_state(self, message: bytes, info: dict[str, int]) -> None:
        """All signals of a joint, at each tick of the controller."""
        state = STATE.unpack(message)
        self._take_setpoint(state, info)
        time = state.stamp_ns * 1e-9
        if not state.stale:
            self._heard("measurement", time, state.measurement)
        self._heard("control", time, state.control)

    def set_tick_hook(self, hook: Callable[[Tick], None] | None) -> None:
        """Call ``hook`` at every tick of the controller soon, on the executor's thread; None for nobody from now on."""
        self._hook = hook

    def wait_for_tick(self, timeout: float) -> bool:
        """Wait for the next tick with all signals; whether it came within ``timeout`` [s of the wall clock].

        Raises what a hook did.
        """
        failed, self._failed = self._failed, None
        if failed is not None:
            raise failed
        with self._ticked:
            return self._ticked.wait(timeout)

    def rivalries(self) -> list[Rivalry]:
        """The signals that several nodes publish just now; on the executor's thread, once a second."""
        return self._conflicts.check()

    def check_that_it_is_one_loop(self) -> None:
        """From a thread of its own.

        Raises
        ------
        InputError
            If several nodes publish a signal: what one of them does is not the answer to what the other is told.
        """
        contested = self._node.background.value(self.rivalries, MEETING_TIME) or []
        sure = [one.text for one in contested if one.sure]
        if sure:
            raise InputError(f"{'; '.join(sure)}; allowed: one publisher each, to learn from a loop")

    # The addend.

    def begin_injection(self) -> None:
        """Begin to publish the addend, 0 at first; from a thread of its own.

        Raises
        ------
        InputError
            If nobody hears it, somebody else publishes it, or several nodes publish a signal of the loop.
        """
        background = self._node.background
        self.check_that_it_is_one_loop()
        others = background.value(self._other_authors, MEETING_TIME) or []
        if others:
            raise InputError(f"{INJECTION} is published by {', '.join(others)}; allowed: nobody, during an autotuning")
        background.on_executor(self._open_injection)
        deadline = time.monotonic() + MEETING_TIME
        while not background.value(lambda: self._injection and self._injection.get_subscription_count(), MEETING_TIME):
            if time.monotonic() > deadline:
                self.end_injection()
                raise InputError(f"nobody hears {INJECTION}; allowed: a controller that adds it to the control")
            time.sleep(0.02)

    def _other_authors(self) -> list[str]:
        topic = self._node.resolve_topic_name(INJECTION)
        return [
            f"{info.node_namespace.rstrip('/')}/{info.node_name}"
            for info in self._node.get_publishers_info_by_topic(topic)
            if info.node_name != self._node.get_name() or info.node_namespace != self._node.get_namespace()
        ]

    def _open_injection(self) -> None:
        if self._injection is None:
            qos = loop_qos(lockstep=False)
            self._injection = self._node.endpoints.publisher(self._types[INJECTION].message_type, INJECTION, qos)

    def inject(self, value: float) -> None:
        """Have ``value`` added to the control until told otherwise; from a hook."""
        if self._injection is not None:
            if value != self._added:
                self.history.add(EXCITATION, self.history.newest_time("control"), value)
            self._added = value
            self._injection.publish(self._write(value, self._node.get_clock().now().nanoseconds))

    def _repeat(self) -> None:
        self._take_what_waits()
        self._look_at_control()
        if self._injection is not None:
            self.inject(self._added)

    def end_injection(self) -> None:
        """Leave the loop alone: no hook, no addend; from a thread of its own."""
        self._node.background.value(self.end_injection_now, MEETING_TIME)

    def end_injection_now(self) -> None:
        """The same, from the executor's thread: no hook can run any more when this has."""
        self._hook = None
        if self._injection is None:
            return
        self.inject(0.0)
        self._injection.wait_for_all_acked(Duration(seconds=TAKEN_TIME))
        self._node.endpoints.destroy(self._injection)
        self._injection = None
