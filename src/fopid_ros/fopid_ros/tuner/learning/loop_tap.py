"""The running loop as the tuner hears it: signals kept for learning, and one addend to the control."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from rclpy.qos import QoSProfile, ReliabilityPolicy

from fopid_core.errors import InputError
from fopid_msgs.msg import FopidState
from fopid_ros.common.managed_node import ManagedNode, loop_qos
from fopid_ros.common.parameters import Spec
from fopid_ros.common.signals import SignalType, signal_specs
from fopid_ros.tuner.learning.history import SIGNALS, History

INJECTION = "feedforward"

SPECS = (
    Spec("history", 600.0, "signals kept for ~/identify and ~/autotune [s]; 0 to listen to none", 0.0, 1e6),
    *(spec for name in (*SIGNALS, INJECTION) for spec in signal_specs(name)),
)
_DEEP = 1000


@dataclass(frozen=True)
class Tick:
    """What the loop did at one tick of the controller."""

    time: float
    setpoint: float
    measurement: float
    control: float


class LoopTap:
    """Hears setpoint, measurement and control; adds to the control through the topic feedforward.

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
        types = {name: SignalType(values[f"{name}.type"], values[f"{name}.field"]) for name in (*SIGNALS, INJECTION)}
        self.history = History(values["history"])
        self._hook: Callable[[Tick], None] | None = None
        self._ticked = threading.Condition()
        self._write = types[INJECTION].writer()
        self._injection_publisher = node.endpoints.publisher(
            types[INJECTION].message_type, INJECTION, loop_qos(lockstep=False)
        )
        # Two signals are laid over each other: both by their stamps, or both by when they came.
        self._by_stamps = all(types[name].has_header for name in SIGNALS)
        if values["history"]:
            for name in SIGNALS:
                self._subscribe(name, types[name])
            state = f"{values['controller']}/state"
            node.endpoints.subscription(FopidState, state, self._state, loop_qos(lockstep=False, reliable=False))

    def _subscribe(self, name: str, kind: SignalType) -> None:
        def heard(message: Any, info: dict[str, int]) -> None:
            stamp = kind.stamp_ns(message) if self._by_stamps else None
            self._heard(name, (stamp or self._arrival_ns(info)) * 1e-9, kind.read(message))

        # Best effort hears reliable publishers, too; a tick lost is a gap that the identification allows for.
        qos = QoSProfile(depth=_DEEP, reliability=ReliabilityPolicy.BEST_EFFORT)
        self._node.endpoints.subscription(kind.message_type, name, heard, qos)

    def _arrival_ns(self, info: dict[str, int]) -> int:
        """When the transport had the message; a callback may come much later while this process computes."""
        simulated = self._node.get_parameter("use_sim_time").value
        return int(self._node.get_clock().now().nanoseconds if simulated else info["received_timestamp"])

    def _heard(self, name: str, time: float, value: float) -> None:
        if not -1e300 < value < 1e300:
            return
        self.history.add(name, time, value)
        tick = Tick(time, *(self.history.newest(signal) for signal in SIGNALS))
        if name != "control" or math.isnan(tick.setpoint + tick.measurement):
            return
        if self._hook is not None:
            self._hook(tick)
        with self._ticked:
            self._ticked.notify_all()

    def _state(self, message: FopidState) -> None:
        """A setpoint that was published before this node listened is known to the controller only."""
        if math.isnan(self.history.newest("setpoint")):
            self.history.add("setpoint", self._node.get_clock().now().nanoseconds * 1e-9, message.setpoint)

    def set_tick_hook(self, hook: Callable[[Tick], None] | None) -> None:
        """Call ``hook`` at every tick of the controller from now on; None for nobody."""
        self._hook = hook

    def wait_for_tick(self, timeout: float) -> bool:
        """Wait for the next tick; whether it came within ``timeout`` [s of the wall clock]."""
        with self._ticked:
            return self._ticked.wait(timeout)

    def inject(self, value: float) -> None:
        """Have ``value`` added to the control until told otherwise."""
        self._injection_publisher.publish(self._write(value, self._node.get_clock().now().nanoseconds))

    def require_exclusive_injection(self) -> None:
        """Raise InputError if nobody hears the addend, or somebody else sets it."""
        topic = self._node.resolve_topic_name(INJECTION)
        others = [
            f"{info.node_namespace.rstrip('/')}/{info.node_name}"
            for info in self._node.get_publishers_info_by_topic(topic)
            if info.node_name != self._node.get_name() or info.node_namespace != self._node.get_namespace()
        ]
        if others:
            raise InputError(f"{INJECTION} is published by {', '.join(others)}; allowed: nobody, during an autotuning")
        if not self._injection_publisher.get_subscription_count():
            raise InputError(f"nobody hears {INJECTION}; allowed: a controller that adds it to the control")
