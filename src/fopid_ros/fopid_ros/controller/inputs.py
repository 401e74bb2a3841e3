"""What the controller hears: six inputs that are checked, refused when they cannot be right, and grow old."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

from rclpy.subscription import Subscription

from fopid_core.errors import InputError
from fopid_ros.common.diagnostics import TickCounts
from fopid_ros.common.inputs import Input
from fopid_ros.common.managed_node import ManagedNode, loop_qos, take_pending_messages
from fopid_ros.common.pending_values import PendingValues
from fopid_ros.common.signals import SignalType
from fopid_ros.controller.kept_setpoint import KeptSetpoint
from fopid_ros.controller.stamps import Order, Stamps

AUTOMATIC = -1.0
"""A timeout that the sample time chooses."""
TICKS_MISSED = 5
SHORTEST_TIMEOUT = 0.1  # [s] what an ordinary operating system may hold a process up for
TICKS_WITHOUT_AUTHOR = 10_000  # in lockstep
SHORTEST_FEEDFORWARD_TIMEOUT = 0.5  # [s] and as much again to fade: gone within a second of its author's end


def timeouts(values: Mapping[str, Any]) -> dict[str, float]:
    """How old each input may grow [s], by its name; infinite for any age.

    Examples
    --------
    >>> automatic = ("measurement", "feedforward", "scheduling_variable")
    >>> chosen = {"sample_time": 0.05, "trigger": "realtime", "tracking_timeout": 0.3, "setpoint_timeout": 0.0,
    ...           "manual_control_timeout": 0.0, **{f"{name}_timeout": -1.0 for name in automatic}}
    >>> timeouts(chosen)["measurement"], timeouts(chosen)["tracking"], timeouts(chosen)["setpoint"]
    (0.25, 0.3, inf)
    """
    ticks = TICKS_MISSED * values["sample_time"]
    signal = max(SHORTEST_TIMEOUT, ticks)
    # In lockstep the loop's time has no fixed ratio to that of the author, who says it 10 times a second: it gets more
    # ticks of silence than messages can make in that time.
    lockstep = values["trigger"] == "lockstep"
    added = TICKS_WITHOUT_AUTHOR * values["sample_time"] if lockstep else max(SHORTEST_FEEDFORWARD_TIMEOUT, ticks)
    automatic = {"measurement": signal, "tracking": signal, "scheduling_variable": signal, "feedforward": added}

    def chosen(name: str) -> float:
        given = values[f"{name}_timeout"]
        return automatic[name] if given == AUTOMATIC else given or math.inf

    names = (*automatic, "setpoint", "manual_control")
    return {name: chosen(name) for name in names if f"{name}_timeout" in values}


class LoopInputs:
    """Setpoint, measurement, feedforward, manual control, tracking and scheduling variable of a controller node.

    Parameters
    ----------
    node : ManagedNode
    values : mapping
        Its parameters.
    types : mapping
        How each signal travels, by name.
    counts : TickCounts
        Where refusals are counted.
    now : callable
        The time by which inputs age [ns].
    setpoint : float
        Until one comes; NaN for none.

    Attributes
    ----------
    setpoint, measurement, feedforward, manual, tracking, scheduling : Input
    sampled_ns : int
        When the measurement was taken [ns]: its stamp, or where it has none when it came.
    """

    def __init__(
        self, node: ManagedNode, values: Mapping[str, Any], types: Mapping[str, SignalType], counts: TickCounts,
        now: Callable[[], int], setpoint: float,
    ) -> None:  # fmt: skip
        self._node, self._types, self._counts, self._now = node, types, counts, now
        self._lockstep = values["trigger"] == "lockstep"
        self.setpoint, self.measurement = Input("setpoint", setpoint), Input("measurement")
        self.feedforward, self.manual = Input("feedforward", 0.0), Input("manual_control")
        self.tracking = Input("tracking")
        self.scheduling = Input("scheduling_variable")
        self.scheduling.without = "the gains stay as they are"
        self.all = (self.setpoint, self.measurement, self.feedforward, self.manual, self.tracking, self.scheduling)
        self.setpoint.received_ns = now()
        self.sampled_ns = 0
        follows, self._scheduled = bool(values["tracking.required"]), False
        self._required = (self.setpoint, self.measurement, *([self.tracking] if follows else []))
        self._followed = (*([] if follows else [self.tracking]), self.scheduling)
        self.stamps = Stamps(node, counts)
        self._pending: list[tuple[Input, PendingValues]] = []
        self._subscriptions: list[Subscription] = []
        self._kept: KeptSetpoint | None = None
        self.take_settings(values)

    def take_settings(self, values: Mapping[str, Any]) -> None:
        """Put timeouts and tolerance in force."""
        for name, seconds in timeouts(values).items():
            self.named(name).timeout_ns = seconds * 1e9
        self.stamps.take_settings(values)

    def named(self, name: str) -> Input:
        """The input of this name."""
        return next(one for one in self.all if one.name == name)

    def listen(self, *, tracking: bool, scheduling: bool) -> None:
        """Subscribe to all but the measurement; in lockstep what has come before a measurement counts for its tick."""
        self._scheduled = scheduling
        added = [*([self.tracking] if tracking else []), *([self.scheduling] if scheduling else [])]
        for one in (self.setpoint, self.feedforward, self.manual, *added):
            ahead = PendingValues()
            self._pending.append((one, ahead))
            self._subscriptions.append(self._listen(one, ahead))
        if not self._lockstep:
            kind = self._types["setpoint"]
            self._kept = KeptSetpoint(self._node, self._node.endpoints, kind, self._take_kept_setpoint)

    def _listen(self, one: Input, ahead: PendingValues) -> Subscription:
        kind, lockstep = self._types[one.name], self._lockstep

        def arrived(message: Any) -> None:
            value, stamp = kind.read(message), kind.stamp_ns(message)
            try:
                if lockstep and ahead.defer(stamp, value):
                    return
            except InputError as error:
                self.refuse_message(one.name, f"{one.name}: {error}")
                return
            if lockstep or not self._comes_from_the_future(one, stamp):
                self.take(one, value, self._now())
                if one is self.setpoint and self._kept is not None:
                    self._kept.stop()

        return self._node.endpoints.subscription(
            kind.message_type, one.name, arrived, loop_qos(lockstep=lockstep), raw=kind.raw
        )

    def _take_kept_setpoint(self, message: Any) -> None:
        kind = self._types["setpoint"]
        if not self._comes_from_the_future(self.setpoint, kind.stamp_ns(message)):
            self.take(self.setpoint, kind.read(message), self._now())
            self._node.get_logger().info(f"setpoint = {self.setpoint.value:g}, as its publisher has kept it")

    def begin(self) -> None:
        """Forget the order of the samples before."""
        self.stamps.begin()

    def begin_anew(self, now_ns: int) -> None:
        """Time has jumped: what is there counts as new."""
        for one in self.all:
            one.received_ns = now_ns

    def take_due(self, stamp_ns: int) -> None:
        """In lockstep: everything that counts from this sample on."""
        for _, ahead in self._pending:
            ahead.begin_anew(stamp_ns)
        for subscription in self._subscriptions:
            take_pending_messages(subscription)
        for one, ahead in self._pending:
            for value in ahead.due(stamp_ns):
                self.take(one, value, stamp_ns)

    def take(self, one: Input, value: float, now_ns: int) -> bool:
        """Keep an input's newest value; one that is not finite is counted and refused."""
        if one.take(value, now_ns):
            return True
        kind = self._types[one.name]
        told = f"{one.name} = {value}" + (f" at {kind.field!r}" if math.isnan(value) else "")
        if kind.lacking:
            told = f"{one.name}.field = {kind.field!r}: {kind.lacking}"
        allowed = "" if kind.lacking else "; allowed: finite numbers"
        self._refuse(f"{told}{allowed}; refused ({one.refused} so far)")
        return False

    def take_measurement(self, message: Any, info: Mapping[str, int] | None = None) -> None:
        """In real time: a stamp, where there is one, tells old samples from new ones.

        ``info`` is what the transport knows of a message that has waited for this tick: it is as old as it waited.
        """
        kind, one = self._types["measurement"], self.measurement
        stamp, waited = kind.stamp_ns(message), self.stamps.waited(info)
        now = self._now() - waited
        if self._comes_from_the_future(one, stamp, waited):
            return
        order = self.stamps.order(stamp)
        if order is Order.OLDER:
            return
        sampled = stamp or now
        if order is Order.SAME:  # it is as old as it was
            now = one.received_ns
        if self.take(one, kind.read(message), now):
            self.sampled_ns = sampled

    def refuse_message(self, name: str, told: str) -> None:
        """Count a message of an input that cannot be used, and tell it."""
        one = self.named(name)
        one.refused += 1
        self._refuse(f"{told}; refused ({one.refused} so far)")

    def _comes_from_the_future(self, one: Input, stamp_ns: int | None, waited_ns: int = 0) -> bool:
        """Whether a stamp is further ahead than a tick and the clocks' skew: it is refused and counted."""
        told = self.stamps.too_far_ahead(one.name, stamp_ns, waited_ns)
        if told:
            self.refuse_message(one.name, told)
        return bool(told)

    def _refuse(self, told: str) -> None:
        self._counts.refused_values += 1
        self._node.get_logger().warning(told, throttle_duration_sec=1.0)

    def unusable(self, now_ns: int, mode: str) -> list[Input]:
        """The inputs without which the control cannot be worked out, and that are too old or have never come."""
        found = [one for one in self._required if not one.usable(now_ns)]
        if self._scheduled and self.scheduling.missing:
            found.append(self.scheduling)
        if mode == "manual" and not self.manual.missing and not self.manual.usable(now_ns):
            found.append(self.manual)
        return found

    def dropped(self, now_ns: int) -> list[Input]:
        """The inputs that the loop does without since they are too old."""
        added = [self.feedforward] if self.feedforward.value and self.feedforward.stale(now_ns) else []
        return added + [one for one in self._followed if one.stale(now_ns)]

    def facts(self, now_ns: int) -> dict[str, object]:
        """What the diagnostics tell of them."""
        ages = {f"age of the {one.name} [s]": one.age(now_ns) for one in self.all}
        return {**ages, **{f"refused of the {one.name}": one.refused for one in self.all if one.refused}}
