"""What a controller of many joints hears: a message holds a number for each joint, or for those that it names."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from rclpy.subscription import Subscription

from fopid_ros.common.array_signals import ArraySignal
from fopid_ros.common.diagnostics import TickCounts
from fopid_ros.common.managed_node import ManagedNode, loop_qos, take_pending_messages
from fopid_ros.controller.joints.joint import Joint
from fopid_ros.controller.kept_setpoint import KeptSetpoint
from fopid_ros.controller.stamps import Order, Stamps


class JointInputs:
    """Takes messages apart: each joint gets its number, and what cannot be right is refused and counted.

    Parameters
    ----------
    node : ManagedNode
    joints : sequence of Joint
    types : mapping
        How each signal travels, by name.
    counts : TickCounts
        Where refusals are counted.
    now : callable
        The time by which inputs age [ns].
    """

    def __init__(
        self, node: ManagedNode, joints: Sequence[Joint], types: Mapping[str, ArraySignal], counts: TickCounts,
        now: Callable[[], int],
    ) -> None:  # fmt: skip
        self._node, self._joints, self._types, self._counts, self._now = node, joints, types, counts, now
        self._inputs = {name: [joint.inputs[name] for joint in joints] for name in types if name != "control"}
        self.stamps = Stamps(node, counts)
        self._subscriptions: list[Subscription] = []
        self._kept: KeptSetpoint | None = None

    def take_settings(self, values: Mapping[str, Any]) -> None:
        """Put the tolerance of the stamps in force."""
        self.stamps.take_settings(values)

    def listen(self, *, lockstep: bool, tracking: bool) -> None:
        """Subscribe to all but the measurement."""
        for name in ("setpoint", "feedforward", "manual_control", *(["tracking"] if tracking else [])):
            self._subscriptions.append(self._listen(name, lockstep=lockstep))
        if not lockstep:
            kind = self._types["setpoint"]
            self._kept = KeptSetpoint(self._node, self._node.endpoints, kind, self._take_kept_setpoint)

    def _listen(self, name: str, *, lockstep: bool) -> Subscription:
        kind = self._types[name]

        def arrived(message: Any) -> None:
            if lockstep or not self._comes_from_the_future(name, kind.stamp_ns(message)):
                self.take(name, message, self._now())
                if name == "setpoint" and self._kept is not None:
                    self._kept.stop()

        return self._node.endpoints.subscription(
            kind.message_type, name, arrived, loop_qos(lockstep=lockstep), raw=kind.raw
        )

    def _take_kept_setpoint(self, message: Any) -> None:
        if not self._comes_from_the_future("setpoint", self._types["setpoint"].stamp_ns(message)):
            self.take("setpoint", message, self._now())

    def begin(self) -> None:
        """Forget the order of the samples before."""
        self.stamps.begin()

    def begin_anew(self, now_ns: int) -> None:
        """Time has jumped: what is there counts as new."""
        for inputs in self._inputs.values():
            for one in inputs:
                one.received_ns = now_ns

    def take_due(self, now_ns: int) -> None:
        """In lockstep: everything that has come before this sample."""
        for subscription in self._subscriptions:
            take_pending_messages(subscription)

    def take_measurement(self, message: Any, info: Mapping[str, int] | None = None) -> None:
        """In real time: a stamp, where there is one, tells old samples from new ones.

        ``info`` is what the transport knows of a message that has waited for this tick: it is as old as it waited.
        """
        stamp, waited = self._types["measurement"].stamp_ns(message), self.stamps.waited(info)
        now = self._now() - waited
        if self._comes_from_the_future("measurement", stamp, waited):
            return
        order = self.stamps.order(stamp)
        if order is Order.OLDER:
            return
        if order is Order.SAME:  # it is as old as it was
            now = max(one.received_ns for one in self._inputs["measurement"])
        self.take("measurement", message, now)

    def take(self, name: str, message: Any, now_ns: int) -> None:
        """Give each joint its number; only a measurement must have one for each."""
        kind = self._types[name]
        numbers = kind.read(message)
        if kind.lacking and (name == "measurement" or not kind.by_name or not any(n is not None for n in numbers)):
            lacking = [one for one, number in zip(self._inputs[name], numbers, strict=True) if number is None]
            for one in lacking:
                one.refused += 1
            self._refuse(f"{name}.field = {kind.field!r}: {kind.lacking}", max(1, len(lacking)))
        for one, number in zip(self._inputs[name], numbers, strict=True):
            if number is not None and not one.take(number, now_ns):
                self._refuse(f"{one.name} = {number}; allowed: finite numbers")

    def refuse_message(self, name: str, told: str) -> None:
        """Count a message that cannot be used, for each joint, and tell it."""
        for one in self._inputs[name]:
            one.refused += 1
        self._refuse(told, len(self._inputs[name]))

    def _comes_from_the_future(self, name: str, stamp_ns: int | None, waited_ns: int = 0) -> bool:
        """Whether a stamp is further ahead than a tick and the clocks' skew: it is refused and counted."""
        told = self.stamps.too_far_ahead(name, stamp_ns, waited_ns)
        for one in self._inputs[name] if told else ():
            one.refused += 1
        if told:
            self._refuse(told)
        return bool(told)

    def _refuse(self, told: str, values: int = 1) -> None:
        self._counts.refused_values += values
        self._node.get_logger().warning(
            f"{told}; refused ({self._counts.refused_values} so far)", throttle_duration_sec=1.0
        )
