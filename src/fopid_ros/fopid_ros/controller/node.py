"""The FOPID controller node: setpoint and measurement in, control out; gains change while it runs."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.clock import Clock, ClockType
from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile
from rclpy.subscription import Subscription
from rclpy.timer import Timer
from std_srvs.srv import SetBool, Trigger

from fopid_core.runtime.controller import FopidController
from fopid_msgs.msg import FopidState
from fopid_ros.common.ahead import Ahead
from fopid_ros.common.diagnostics import Monitor, Rivals, diagnostic_array, diagnostic_status, worries
from fopid_ros.common.inputs import Input, is_number
from fopid_ros.common.managed_node import LOCKSTEP_DEPTH, ManagedNode, loop_qos, run, take_waiting
from fopid_ros.common.parameter_file import write_parameter_file
from fopid_ros.common.signals import SignalType, header_stamp
from fopid_ros.controller.parameters import SIGNALS, SPECS, controller_settings, initial_setpoint, signal_types

NS = 1_000_000_000


class ControllerNode(ManagedNode):
    """Subscribes setpoint, measurement, feedforward, manual_control and tracking; publishes control and ~/state."""

    NAME = "fopid_controller"
    SPECS = SPECS

    _active = False
    _timer: Timer | None = None
    _last_tick: int | None = None
    _newest_stamp: int | None = None

    def check(self, values: dict[str, Any]) -> None:
        controller_settings(values, signal_types(values)["control"])
        initial_setpoint(values)

    # What lives from configure to cleanup.

    def open(self, values: dict[str, Any]) -> None:
        self._types = types = signal_types(values)
        self._values = values
        self._controller = FopidController(controller_settings(values, types["control"]))
        self._controller.set_mode(values["mode"])
        self._lockstep = values["trigger"] == "lockstep"
        self._period_ns = round(values["sample_time"] * NS)
        self._setpoint = Input("setpoint", initial_setpoint(values))
        self._measurement, self._tracking = Input("measurement"), Input("tracking")
        self._feedforward, self._manual = Input("feedforward", 0.0), Input("manual_control")
        self._inputs = (self._setpoint, self._measurement, self._feedforward, self._manual, self._tracking)
        self._lacking: list[Input] = []
        self._monitor = Monitor(values["sample_time"], time.monotonic_ns())
        self._steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._tick_clock, self._now = self._time_of_ticks()
        self._setpoint.arrived_ns = self._now()
        self._interval = 0.0
        self._control = values["safe_control"]
        self._rivals = Rivals(self, SIGNALS)
        self._state = FopidState()
        self._take_settings()
        self._open_topics(types)
        self._open_services()

    def _time_of_ticks(self) -> tuple[Clock, Callable[[], int]]:
        """The clock of the ticks, and the time by which inputs age [ns]; in lockstep the loop's own."""
        if self._lockstep:
            return self._steady, lambda: self._last_tick or 0
        if self.get_parameter("use_sim_time").value:
            clock = self.get_clock()
            return clock, lambda: int(clock.now().nanoseconds)
        return self._steady, time.monotonic_ns

    def _open_topics(self, types: dict[str, SignalType]) -> None:
        lockstep, endpoints = self._lockstep, self.endpoints
        # In lockstep everything that has arrived before a measurement counts for its tick, unless stamped later.
        others = (self._setpoint, self._feedforward, self._manual)
        if self._values["tracking.enabled"]:
            others = (*others, self._tracking)
        self._ahead = [(one, Ahead()) for one in others]
        self._slow = [self._listen(one, ahead) for one, ahead in self._ahead]
        endpoints.subscription(
            types["measurement"].message_type, "measurement", self._answer if lockstep else self._on_measurement,
            loop_qos(lockstep=lockstep, reliable=False),
        )  # fmt: skip
        self._write = types["control"].writer()
        self._control_publisher = endpoints.publisher(
            types["control"].message_type, "control", loop_qos(lockstep=lockstep)
        )
        state_qos = QoSProfile(depth=LOCKSTEP_DEPTH if lockstep else 10)
        self._state_publisher = endpoints.publisher(FopidState, "~/state", state_qos)
        self._diagnostics = endpoints.publisher(DiagnosticArray, "/diagnostics", QoSProfile(depth=10))
        endpoints.refuse_unknown_overrides()

    def _listen(self, one: Input, ahead: Ahead) -> Subscription:
        kind, lockstep = self._types[one.name], self._lockstep

        def arrived(message: Any) -> None:
            value = kind.read(message)
            if not (lockstep and ahead.waits(kind.stamp_ns(message), value)):
                self._take(one, value, self._now())

        return self.endpoints.subscription(kind.message_type, one.name, arrived, loop_qos(lockstep=lockstep))

    def _open_services(self) -> None:
        self.endpoints.service(Trigger, "~/reset", self._on_reset)
        self.endpoints.service(SetBool, "~/set_auto", self._on_set_auto)
        self.endpoints.service(Trigger, "~/save_gains", self._on_save_gains)
        self.endpoints.timer(1.0, self._publish_diagnostics, self._steady)

    # Parameters.

    def apply(self, values: dict[str, Any]) -> None:
        if not self.configured:
            return
        mode_before, self._values = self._values["mode"], values
        self._controller.reconfigure(controller_settings(values, self._types["control"]))
        if values["mode"] != mode_before:
            self._controller.set_mode(values["mode"])
        self._take_settings()

    def _take_settings(self) -> None:
        for one in (self._setpoint, self._measurement):
            one.timeout_ns = self._values[f"{one.name}_timeout"] * NS or math.inf
        self._tracking.timeout_ns = self._measurement.timeout_ns
        message, gains = self._state, self._controller.settings.gains
        message.kp, message.ki, message.kd, message.lam, message.mu = gains.gains

    # Transitions.

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        self._last_tick = self._newest_stamp = None
        self._interval = 0.0
        if not self._lockstep:
            self._timer = self.create_timer(self._period_ns * 1e-9, self._tick_on_timer, clock=self._tick_clock)
        self._active = True
        gains = self._controller.settings.gains
        self.get_logger().info(f"controlling with {gains} every {self._period_ns * 1e-9:g} s")
        return super().on_activate(state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        self._leave_active()
        return super().on_deactivate(state)

    def _release(self) -> None:
        self._leave_active()
        super()._release()

    def _leave_active(self) -> None:
        """Publish the safe control and tick no more."""
        if not self._active:
            return
        self._active = False
        self.publish_control(self._values["safe_control"], self.get_clock().now().nanoseconds)
        if self._timer is not None:
            self.destroy_timer(self._timer)
            self._timer = None
        self._controller.reset()

    # Inputs.

    def _take(self, one: Input, value: float, now_ns: int) -> None:
        """Keep an input's newest value; one that is not finite is counted and refused."""
        if one.take(value, now_ns):
            return
        self._monitor.counts.refused_values += 1
        where = f" at {self._types[one.name].field!r}" if math.isnan(value) else ""
        self.get_logger().warning(
            f"{one.name} = {value}{where} refused ({one.refused} so far); allowed: finite numbers",
            throttle_duration_sec=1.0,
        )

    def _on_measurement(self, message: Any) -> None:
        """In real time: a stamp, where there is one, tells old samples from new ones."""
        kind, now = self._types["measurement"], self._now()
        stamp = kind.stamp_ns(message)
        if stamp:
            before, self._newest_stamp = self._newest_stamp, stamp
            if before is not None and stamp < before:
                # A straggler, or its clock was set back: the next one after this stamp counts again.
                self._warn_backwards("the measurement's stamp", "the sample is refused")
                return
            if stamp == before:  # the same sample again is as old as it was
                now = self._measurement.arrived_ns
        self._take(self._measurement, kind.read(message), now)

    def _answer(self, message: Any) -> None:
        """In lockstep: each measurement is answered by one control with the same stamp."""
        kind = self._types["measurement"]
        stamp = kind.stamp_ns(message)
        if stamp is None:
            stamp = self.get_clock().now().nanoseconds
        if not self._active:
            return
        if stamp == self._last_tick:  # the plant asks again: the answer is the same
            self.publish_control(self._control, stamp)
            return
        for subscription in self._slow:
            take_waiting(subscription)
        for one, ahead in self._ahead:
            for value in ahead.due(stamp):
                self._take(one, value, stamp)
        self._begin_tick(stamp)
        self._take(self._measurement, kind.read(message), stamp)
        self._tick(stamp, stamp)

    def _tick_on_timer(self) -> None:
        now = self._now()
        self._begin_tick(now)
        self._tick(self.get_clock().now().nanoseconds, now)

    # A tick.

    def _begin_tick(self, now_ns: int) -> None:
        """Measure the time since the last tick; time that runs backwards starts the controller anew."""
        before, self._last_tick = self._last_tick, now_ns
        if before is not None and now_ns >= before:
            self._interval = (now_ns - before) * 1e-9
            self._monitor.counts.late_ticks += max(0, round((now_ns - before) / self._period_ns) - 1)
            return
        self._interval = 0.0
        if before is not None:
            self._warn_backwards("time", "the controller starts anew")
            self._controller.reset()
        if before is not None or self._lockstep:
            for one in self._inputs:
                one.arrived_ns = now_ns

    def _tick(self, stamp_ns: int, now_ns: int) -> None:
        lacking = [one for one in (self._setpoint, self._measurement) if not one.usable(now_ns)]
        if lacking != self._lacking:
            self._tell(lacking)
        control = self._substitute() if lacking else self._step(now_ns)
        self._control = control = control if is_number(control) else self._start_over(control)
        state = self._controller.state
        self._monitor.tick(self._interval, saturated=state.saturated, stale=bool(lacking))
        self.publish_control(control, stamp_ns)
        waiting = bool(lacking) and self._waiting
        if not waiting or state.mode == "manual":
            self._publish_state(stamp_ns, now_ns, waiting=waiting)

    def _step(self, now_ns: int) -> float:
        controller, manual = self._controller, self._manual
        if controller.state.mode == "auto":
            manual.value = math.nan  # on a change to manual the control stays until the next message
        return controller.step(
            self._setpoint.value, self._measurement.value, self._feedforward.value,
            controller.state.control if manual.missing else manual.value,
            self._tracking.value if self._tracking.usable(now_ns) else None,
        )  # fmt: skip

    def _substitute(self) -> float:
        """The control while an input is stale or has never come."""
        controller = self._controller
        policy, manual = self._values["on_stale"], None if self._manual.missing else self._manual.value
        if controller.state.mode == "manual":
            return controller.hold(manual)
        if self._waiting:
            return controller.state.control
        return controller.hold({"hold": None, "safe": self._values["safe_control"], "manual": manual}[policy])

    @property
    def _waiting(self) -> bool:
        """Whether setpoint or measurement has never come."""
        return any(one.missing for one in self._lacking)

    def _start_over(self, control: float) -> float:
        """Gains times signals beyond what a number can hold: the safe control, and a controller as new."""
        self._monitor.counts.controls_not_finite += 1
        self.get_logger().error(f"control = {control}: the controller starts anew", throttle_duration_sec=1.0)
        self._controller.reset()
        return self._controller.state.control

    def publish_control(self, control: float, stamp_ns: int) -> None:
        """Send the control with the stamp of the measurement it answers, or of the tick [ns]."""
        self._control_publisher.publish(self._write(control, stamp_ns))

    def _publish_state(self, stamp_ns: int, now_ns: int, *, waiting: bool) -> None:
        message, state = self._state, self._controller.state
        header_stamp(message.header, stamp_ns)
        message.setpoint, message.measurement, message.error = state.setpoint, state.measurement, state.error
        if waiting:
            message.setpoint, message.measurement, message.error = math.nan, math.nan, math.nan
        message.proportional, message.integral = state.proportional, state.integral
        message.derivative, message.feedforward = state.derivative, state.feedforward
        message.control_unlimited, message.control = state.control_unlimited, state.control
        message.saturated = state.saturated
        message.mode = FopidState.AUTO if state.mode == "auto" else FopidState.MANUAL
        message.sample_interval, message.overruns = self._interval, self._monitor.counts.late_ticks
        message.stale, message.measurement_age = bool(self._lacking), self._measurement.age(now_ns)
        message.tracking, message.refused = self._tracking.value, self._monitor.counts.refused_values
        self._state_publisher.publish(message)

    # What people are told.

    def _tell(self, lacking: list[Input]) -> None:
        self._lacking = lacking
        names = " and ".join(one.name for one in lacking)
        if not lacking:
            self.get_logger().info("setpoint and measurement are there")
        elif self._waiting:
            self.get_logger().info(f"waiting for {names}")
        else:
            self.get_logger().warning(f"{names} stale; on_stale = {self._values['on_stale']}")

    def _warn_backwards(self, what: str, consequence: str) -> None:
        self._monitor.counts.times_backwards += 1
        self.get_logger().warning(f"{what} ran backwards: {consequence}", throttle_duration_sec=1.0)

    def _publish_diagnostics(self) -> None:
        since, rates = self._monitor.window(time.monotonic_ns())
        found = worries(since, ticking=self._active and not self._lockstep)
        found += [(DiagnosticStatus.WARN, text) for text in self._rivals.found()]
        if self._active and self._lacking:
            level = DiagnosticStatus.WARN if self._waiting else DiagnosticStatus.ERROR
            names = " and ".join(one.name for one in self._lacking)
            found.insert(0, (level, f"waiting for {names}" if self._waiting else f"{names} stale"))
        state = self._controller.state.mode if self._active else "inactive"
        status = diagnostic_status(self.get_fully_qualified_name(), state, found, {**rates, **self._facts()})
        self._diagnostics.publish(diagnostic_array(status, self))

    def _facts(self) -> dict[str, object]:
        counts, now = self._monitor.counts, self._now()
        return {
            "mode": self._controller.state.mode,
            "ticks": counts.ticks, "overruns": counts.late_ticks, "stale ticks": counts.stale_ticks,
            "age of the measurement [s]": self._measurement.age(now),
            "age of the setpoint [s]": self._setpoint.age(now),
            "non-finite inputs refused": counts.refused_values, "time ran backwards": counts.times_backwards,
            "share of saturated ticks": counts.saturated_ticks / max(1, counts.ticks),
            "last rejected parameter set": self.last_rejected or "none",
        }  # fmt: skip

    # Services.

    def _on_reset(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._controller.reset()
        self._last_tick = None
        response.success, response.message = True, "the past is forgotten; gains and mode stay"
        return response

    def _on_set_auto(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        mode = "auto" if request.data else "manual"
        result = self.set_parameters_atomically([Parameter("mode", value=mode)])
        response.success, response.message = result.successful, result.reason or mode
        return response

    def _on_save_gains(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        path = self._values["gains_file"]
        if not path:
            response.message = "gains_file = ''; allowed: the path of a file"
            return response
        values = {name: parameter.value for name, parameter in self.get_parameters_by_prefix("").items()}
        try:
            write_parameter_file(Path(path), self.get_fully_qualified_name(), values)
        except OSError as error:
            response.message = f"gains_file = {path!r}: {error.strerror}; nothing was changed"
            return response
        response.success, response.message = True, path
        return response


def main(args: list[str] | None = None) -> int:
    """Entry point of the executable ``fopid_controller``."""
    return run(ControllerNode, args)


if __name__ == "__main__":
    sys.exit(main())
