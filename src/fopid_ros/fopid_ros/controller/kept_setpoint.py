"""The setpoint that its publishers keep for late-comers: a controller that is started again goes on with it."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy
from rclpy.subscription import Subscription

from fopid_ros.common.array_signals import ArraySignal
from fopid_ros.common.endpoints import Endpoints
from fopid_ros.common.managed_node import latched_qos
from fopid_ros.common.signals import SignalType

LOOK_PERIOD = 0.1
"""How often publishers that keep their newest value are looked for [s]."""
LOOK_TIME = 10.0
"""How long: then whoever publishes the setpoint has been found [s]."""


class KeptSetpoint:
    """Reads what is kept, beside the ordinary subscription and only until something comes there.

    A reader of kept values does not match a publisher that keeps none, as ``ros2 topic pub`` and ROS 2's default, and
    such a publisher would warn of it. So the ordinary subscription is for all publishers and for what is sent from now
    on, and this one is opened while there is a publisher that offers more.

    Parameters
    ----------
    node : Node
    endpoints : Endpoints
        Close it.
    kind : SignalType or ArraySignal
        How the setpoint travels.
    take : callable
        Takes a message that was kept; of several publishers' the newest.
    """

    def __init__(
        self, node: Node, endpoints: Endpoints, kind: SignalType | ArraySignal, take: Callable[[Any], None]
    ) -> None:
        self._node, self._endpoints, self._kind, self._take = node, endpoints, kind, take
        self._topic = node.resolve_topic_name("setpoint")
        self._newest = 0
        self._until = time.monotonic() + LOOK_TIME
        self._subscription: Subscription | None = None
        self._timer = endpoints.timer(LOOK_PERIOD, self._look, Clock(clock_type=ClockType.STEADY_TIME))

    def stop(self) -> None:
        """A setpoint has come the ordinary way: nothing that was kept counts any more."""
        self._until = 0.0

    def _look(self) -> None:
        if time.monotonic() > self._until:
            self._timer.cancel()
            self._close()
        elif self._subscription is None and self._is_kept():
            self._subscription = self._endpoints.fixed_subscription(
                self._kind.message_type, "setpoint", self._on_message, latched_qos(), raw=self._kind.raw
            )

    def _is_kept(self) -> bool:
        infos = self._node.get_publishers_info_by_topic(self._topic)
        return any(info.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL for info in infos)

    def _on_message(self, message: Any, info: dict[str, int]) -> None:
        sent = info["source_timestamp"]
        if self._until and sent > self._newest:
            self._newest = sent
            self._take(message)

    def _close(self) -> None:
        if self._subscription is not None:
            self._endpoints.destroy(self._subscription)
            self._subscription = None
