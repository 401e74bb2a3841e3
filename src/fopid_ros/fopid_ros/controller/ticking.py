"""What every controller node does around its ticks: their clock, their beginning and end, and time that jumps."""

from __future__ import annotations

import time
from abc import abstractmethod
from collections.abc import Callable, Mapping
from typing import Any

from rclpy.clock import Clock, ClockType
from rclpy.duration import Duration
from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn
from rclpy.parameter import Parameter
from rclpy.publisher import Publisher
from rclpy.subscription import Subscription
from rclpy.timer import Timer
from std_srvs.srv import SetBool, Trigger

from fopid_ros.common.array_signals import ArraySignal
from fopid_ros.common.diagnostics import TickStatistics
from fopid_ros.common.guard import do_nothing
from fopid_ros.common.managed_node import loop_qos, take_pending_messages
from fopid_ros.common.signals import SignalType
from fopid_ros.controller.remembering import RememberingNode
from fopid_ros.controller.stamps import time_of_stamps

NS = 1_000_000_000
END_OF_TIME = NS << 31
"""What no stamp can say [ns]."""
MOST_WAITING = 10
"""Measurements that wait for a tick; of more the newest. One that is refused does not hide the good one before it."""
READ_TIME = 0.3
"""How long the end waits for those who read the control [s]."""


class TickingNode(RememberingNode):
    """A node that controls at each tick: of its timer, or in lockstep of each measurement.

    ``open`` calls ``open_ticks`` before anything that needs the time, and sets ``_inputs`` and ``_types``.
    """

    _types: Mapping[str, SignalType | ArraySignal]
    _inputs: Any
    _control_publisher: Publisher
    _active = False
    _timer: Timer | None = None
    _last_tick: int | None = None
    _state_sent_ns = 0
    _waiting: Subscription | None = None
    """Whose messages wait for the next tick."""

    @abstractmethod
    def send_control(self, stamp_ns: int) -> None:
        """Send the control that was worked out last, with this stamp [ns]."""

    @abstractmethod
    def make_safe(self) -> None:
        """Make the safe control the one that is sent next."""

    @abstractmethod
    def forget(self) -> None:
        """Reset the controller; gains and mode stay."""

    @abstractmethod
    def take_measurement(self, message: Any, stamp_ns: int) -> None:
        """Take the measurement of a tick in lockstep."""

    @abstractmethod
    def tick(self, stamp_ns: int, now_ns: int) -> None:
        """Control once and tell it with this stamp [ns]; inputs age by the other time [ns]."""

    def open_ticks(self, values: dict[str, Any]) -> None:
        """Choose the clock of the ticks, and the time by which inputs age."""
        self._lockstep = values["trigger"] == "lockstep"
        self._period_ns = round(values["sample_time"] * NS)
        self._statistics = TickStatistics(values["sample_time"], time.monotonic_ns())
        self._steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._tick_clock, self._now = self._time_of_ticks()
        self._stamp = time_of_stamps(self)
        self._interval, self._state_sent_ns = 0.0, 0

    def open_measurement(self) -> None:
        """Hear the measurement: in lockstep it is the tick; in real time it waits for one, unless time is simulated.

        To be woken for each measurement would cost more than all that a tick works out.
        """
        lockstep, kind = self._lockstep, self._types["measurement"]
        subscription = self.endpoints.subscription(
            kind.message_type, "measurement", self._lockstep_tick if lockstep else self._inputs.take_measurement,
            loop_qos(lockstep=lockstep, reliable=False, depth=MOST_WAITING), raw=kind.raw,
            otherwise=self._fail_safe if lockstep else do_nothing,
        )  # fmt: skip
        waits = self._tick_clock is self._steady and not lockstep
        self._waiting = subscription if waits else None
        if waits:
            self.taken_by_hand.add(subscription)

    def take_waiting(self) -> None:
        """Take the measurements that have come since the last time."""
        if self._waiting is not None:
            take_pending_messages(self._waiting, informed=True, most=MOST_WAITING)
            self._inputs.stamps.looked()

    def open_mode_services(self) -> None:
        """Offer ~/reset and ~/set_auto."""
        self.endpoints.service(Trigger, "~/reset", self._on_reset)
        self.endpoints.service(SetBool, "~/set_auto", self._on_set_auto)

    def _time_of_ticks(self) -> tuple[Clock, Callable[[], int]]:
        """The clock of the ticks, and the time by which inputs age [ns]; in lockstep the loop's own."""
        if self._lockstep:
            return self._steady, lambda: self._last_tick or 0
        if self.get_parameter("use_sim_time").value:
            clock = self.get_clock()
            return clock, lambda: int(clock.now().nanoseconds)
        return self._steady, time.monotonic_ns

    def refuse_message(self, topic: str, told: str) -> None:
        self._inputs.refuse_message(topic, told)

    # Transitions.

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        self._last_tick = None
        self._inputs.begin()
        self._interval = 0.0
        if not self._lockstep:
            self._timer = self.create_timer(
                self._period_ns * 1e-9, self._tick_on_timer, clock=self._tick_clock, otherwise=self._fail_safe
            )
        self._active = True
        return super().on_activate(state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        self._stop_control()
        return super().on_deactivate(state)

    def _release(self) -> None:
        self._stop_control()
        super()._release()

    def _stop_control(self) -> None:
        """Publish the safe control and tick no more."""
        if not self._active:
            return
        self._active = False
        self.make_safe()
        self.send_control(self.get_clock().now().nanoseconds)
        # A process that ends takes with it what nobody has read yet.
        self._control_publisher.wait_for_all_acked(Duration(seconds=READ_TIME))
        if self._timer is not None:
            self.destroy_timer(self._timer)
            self._timer = None
        self.forget()

    # Ticks.

    def _lockstep_tick(self, message: Any) -> None:
        """In lockstep: each measurement is answered by one control with the same stamp."""
        stamp = self._types["measurement"].stamp_ns(message)
        if stamp is None:
            stamp = self.get_clock().now().nanoseconds
        if not self._active:
            return
        if stamp >= END_OF_TIME:  # its nanoseconds are more than a second, and the answer cannot say the same
            self.refuse_message("measurement", f"measurement is stamped {stamp} ns; allowed: below {END_OF_TIME} ns")
            return
        if stamp == self._last_tick:  # the plant asks again: the answer is the same
            self.send_control(stamp)
            return
        self._inputs.take_due(stamp)
        self._begin_tick(stamp)
        self.take_measurement(message, stamp)
        self.tick(stamp, stamp)

    def _tick_on_timer(self) -> None:
        if not self._active:  # it was due before the timer ended: the safe control stays the last thing sent
            return
        self.take_waiting()
        now = self._now()
        self._begin_tick(now)
        self.tick(self._stamp(), now)

    def _fail_safe(self) -> None:
        """A tick raised an error: send the safe control, and reset the controller for the next tick."""
        self.make_safe()
        stamp = self._last_tick if self._lockstep else None
        self.send_control(stamp or self.get_clock().now().nanoseconds)
        self.forget()

    def _begin_tick(self, now_ns: int) -> None:
        """Measure the time since the last tick; time that runs backwards starts the control anew."""
        before, self._last_tick = self._last_tick, now_ns
        if before is not None and now_ns >= before:
            interval = now_ns - before
            self._interval = interval * 1e-9
            if 2 * interval > 3 * self._period_ns:
                self._statistics.counts.late_ticks += round(interval / self._period_ns) - 1
            return
        self._interval = 0.0
        if before is not None:
            self._inputs.stamps.warn_backwards("time", "the controller starts anew")
            self.forget()
        if before is not None or self._lockstep:
            self._inputs.begin_anew(now_ns)

    def state_interval_is_over(self, now_ns: int) -> bool:
        """Whether ``state_rate`` allows another state; then this is its time."""
        least = NS / self._values["state_rate"] - self._period_ns // 2  # the nearest tick, however it jitters
        if 0 <= now_ns - self._state_sent_ns < least:
            return False
        self._state_sent_ns = now_ns
        return True

    # Services.

    def _on_reset(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self.forget()
        self._last_tick = None
        response.success, response.message = True, "the past is forgotten; gains and mode stay"
        return response

    def _on_set_auto(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        mode = "auto" if request.data else "manual"
        result = self.set_parameters_atomically([Parameter("mode", value=mode)])
        response.success, response.message = result.successful, result.reason or mode
        return response
