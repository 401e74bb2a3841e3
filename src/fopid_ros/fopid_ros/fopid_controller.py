"""The FOPID controller node: setpoint and measurement in, control out; gains change while it runs."""

from __future__ import annotations

import math
import sys
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.clock import Clock, ClockType
from rclpy.context import Context
from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile
from rclpy.timer import Timer
from std_srvs.srv import SetBool, Trigger

from fopid_core.model.fopid import ORDER_RANGE, Fopid
from fopid_core.runtime.controller import ControllerSettings, FopidController
from fopid_core.runtime.filter_bank import Band
from fopid_msgs.msg import FopidState
from fopid_ros.node import LOCKSTEP_DEPTH, TIMING, ManagedNode, loop_qos, run, take_waiting
from fopid_ros.parameters import Spec
from fopid_ros.signals import SignalType, header_stamp, signal_specs

_ORDERS = {"low": ORDER_RANGE[0], "high": ORDER_RANGE[1]}
_SIGNALS = ("setpoint", "measurement", "feedforward", "manual_control", "control")

SPECS = (
    Spec("kp", 0.0, "proportional gain", -1e300, 1e300),
    Spec("ki", 0.0, "integral gain [1/s^lam]", -1e300, 1e300),
    Spec("kd", 0.0, "derivative gain [s^mu]", -1e300, 1e300),
    Spec("lam", 1.0, "order of the integral", **_ORDERS),
    Spec("mu", 1.0, "order of the derivative", **_ORDERS),
    Spec("sample_time", 0.01, "time between ticks [s]", 1e-6, 1e6, read_only=True),
    Spec("band.low", 0.0, "lower edge of the band of the fractional powers [rad/s]; 0 chooses", 0.0, 1e9),
    Spec("band.high", 0.0, "upper edge of that band [rad/s]; 0 chooses the Nyquist frequency", 0.0, 1e9),
    Spec("band.poles", 0, "number of lags on that band; 0 chooses", 0, 60),
    Spec("setpoint_weight", 1.0, "share of the setpoint in the proportional part", 0.0, 1.0),
    Spec("derivative_setpoint_weight", 1.0, "the same for the derivative; 0: of the measurement alone", 0.0, 1.0),
    Spec("derivative_filter_time", 0.0, "time constant of the lag before the derivative [s]", 0.0, 1e9),
    Spec("control_min", -math.inf, "lower limit of the control; -inf for none"),
    Spec("control_max", math.inf, "upper limit of the control; inf for none"),
    Spec("control_rate_max", math.inf, "largest change of the control per second; inf for none", 0.0),
    Spec("antiwindup", "back_calculation", "what keeps the integral from winding up",
         choices=("none", "back_calculation", "conditional_integration")),
    Spec("tracking_time", 0.0, "how fast back-calculation takes the integral back [s]; 0 chooses", 0.0, 1e9),
    Spec("bumpless", True, "on new gains the integral takes up the step between old and new reading"),
    Spec("measurement_timeout", 0.0, "age of the measurement that counts as stale [s]; 0 for off", 0.0, 1e9),
    Spec("setpoint_timeout", 0.0, "age of the setpoint that counts as stale [s]; 0 for off", 0.0, 1e9),
    Spec("on_stale", "hold", "the control while an input is stale", choices=("hold", "safe", "manual")),
    Spec("safe_control", 0.0, "the control before the first tick and after the last", -1e300, 1e300),
    Spec("mode", "auto", "auto, or manual: the control follows the topic manual_control", choices=("auto", "manual")),
    TIMING,
    *(spec for name in _SIGNALS for spec in signal_specs(name)),
)  # fmt: skip


def _band(values: dict[str, Any]) -> Band | None:
    low, high, poles = values["band.low"], values["band.high"], values["band.poles"]
    if not (low or high or poles):
        return None
    chosen = Band.for_sample_time(values["sample_time"])
    return Band(low or chosen.low, high or chosen.high, poles or chosen.poles)


def controller_settings(values: dict[str, Any]) -> ControllerSettings:
    """The core's settings from the node's parameters."""
    names = (
        "sample_time", "setpoint_weight", "derivative_setpoint_weight", "derivative_filter_time", "control_min",
        "control_max", "control_rate_max", "antiwindup", "tracking_time", "bumpless", "safe_control",
    )  # fmt: skip
    gains = Fopid(*(values[name] for name in ("kp", "ki", "kd", "lam", "mu")))
    return ControllerSettings(gains=gains, band=_band(values), **{name: values[name] for name in names})


class ControllerNode(ManagedNode):
    """Subscribes setpoint, measurement, feedforward and manual_control; publishes control and ~/state."""

    NAME = "fopid_controller"
    SPECS = SPECS

    def __init__(self, context: Context | None = None) -> None:
        super().__init__(context=context)
        values = self.values()
        self._controller = FopidController(controller_settings(values))
        self._controller.set_mode(values["mode"])
        self._values = values
        self._lockstep = values["trigger"] == "lockstep"
        self._period_ns = round(values["sample_time"] * 1e9)
        self._inputs: dict[str, float] = {"setpoint": math.nan, "measurement": math.nan,
                                          "feedforward": 0.0, "manual_control": 0.0}  # fmt: skip
        self._arrived: dict[str, int] = {}
        self._steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._ticks = self._overruns = self._refused = self._saturated_ticks = self._stale_ticks = 0
        self._last_tick_ns: int | None = None
        self._last_stamp: int | None = None
        self._interval = 0.0
        self._timer: Timer | None = None
        self._create_endpoints()

    def _create_endpoints(self) -> None:
        values, lockstep = self._values, self._lockstep
        types = {name: SignalType(values[f"{name}.type"], values[f"{name}.field"]) for name in _SIGNALS}
        self._types = types
        reliable = loop_qos(lockstep=lockstep)
        measurement_qos = loop_qos(lockstep=lockstep, reliable=False)

        def listen(name: str, qos: QoSProfile, then: Any = None) -> Any:
            read = types[name].read

            def arrived(message: Any) -> None:
                if self._take(name, read(message)) and then is not None:
                    then(message)

            return self.create_subscription(types[name].message_type, name, arrived, qos)

        # In lockstep everything that has arrived before a measurement counts for its tick.
        self._slow = [listen(name, reliable) for name in ("setpoint", "feedforward", "manual_control")]
        listen("measurement", measurement_qos, self._answer if lockstep else None)
        self._write = types["control"].writer()
        self._control_publisher = self.create_publisher(types["control"].message_type, "control", reliable)
        self._state = FopidState()
        self._state_publisher = self.create_publisher(
            FopidState, "~/state", QoSProfile(depth=LOCKSTEP_DEPTH if lockstep else 10)
        )
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self.create_service(Trigger, "~/reset", self._on_reset)
        self.create_service(SetBool, "~/set_auto", self._on_set_auto)
        self.create_timer(1.0, self._publish_diagnostics, clock=self._steady)

    def check(self, values: dict[str, Any]) -> None:
        controller_settings(values)
        for name in _SIGNALS:
            SignalType(values[f"{name}.type"], values[f"{name}.field"])

    def apply(self, values: dict[str, Any]) -> None:
        self._controller.reconfigure(controller_settings(values))
        if values["mode"] != self._values["mode"]:
            self._controller.set_mode(values["mode"])
        self._values = values
        self._fill_gains()

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        if not self._lockstep:
            use_sim_time = self.get_parameter("use_sim_time").value
            clock = self.get_clock() if use_sim_time else self._steady
            self._timer = self.create_timer(self._period_ns * 1e-9, self._tick_on_timer, clock=clock)
        self._active = True
        self._last_tick_ns = None
        self._fill_gains()
        gains = self._controller.settings.gains
        self.get_logger().info(f"controlling with {gains} every {self._period_ns * 1e-9:g} s")
        return super().on_activate(state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        self._leave_active()
        return super().on_deactivate(state)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        self._leave_active()
        return super().on_shutdown(state)

    _active = False

    def _leave_active(self) -> None:
        """Publish the safe control and tick no more."""
        if not self._active:
            return
        self._active = False
        if self._timer is not None:
            self.destroy_timer(self._timer)
            self._timer = None
        self._controller.reset()
        self.publish_control(self._controller.settings.safe_control, self.get_clock().now().nanoseconds)

    def _take(self, name: str, value: float) -> bool:
        """Keep an input's newest value; a value that is not finite is counted and refused."""
        if not math.isfinite(value):
            self._refused += 1
            self.get_logger().warning(
                f"{name} = {value} refused ({self._refused} so far); allowed: finite numbers",
                throttle_duration_sec=1.0,
            )
            return False
        self._inputs[name] = value
        self._arrived[name] = time.monotonic_ns()
        return True

    # Lockstep: each measurement is answered by one control with the same stamp.

    def _answer(self, message: Any) -> None:
        if not self._active:
            return
        stamp = self._types["measurement"].stamp_ns(message)
        if stamp is None:
            stamp = self.get_clock().now().nanoseconds
        if stamp == self._last_stamp:  # the plant asks again: the answer is the same
            self.publish_control(self._controller.state.control, stamp)
            return
        for subscription in self._slow:
            take_waiting(subscription)
        if self._last_stamp is not None and stamp < self._last_stamp:
            self.get_logger().warning("the measurement's time ran backwards: the controller starts anew")
            self._controller.reset()
            self._last_stamp = None
        self._interval = (stamp - self._last_stamp) * 1e-9 if self._last_stamp is not None else 0.0
        self._last_stamp = stamp
        self._tick(stamp, stale=False)

    # Realtime: the timer ticks.

    def _tick_on_timer(self) -> None:
        now = time.monotonic_ns()
        if self._last_tick_ns is not None:
            elapsed = now - self._last_tick_ns
            self._interval = elapsed * 1e-9
            self._overruns += max(0, round(elapsed / self._period_ns) - 1)
        self._last_tick_ns = now
        self._tick(self.get_clock().now().nanoseconds, stale=self._is_stale(now))

    def _is_stale(self, now_ns: int) -> bool:
        for name in ("measurement", "setpoint"):
            timeout = self._values[f"{name}_timeout"]
            if timeout and now_ns - self._arrived.get(name, now_ns) > timeout * 1e9:
                return True
        return False

    def _tick(self, stamp: int, *, stale: bool) -> None:
        inputs, controller = self._inputs, self._controller
        if math.isnan(inputs["setpoint"]) or math.isnan(inputs["measurement"]):
            self.publish_control(controller.settings.safe_control, stamp)
            return
        self._ticks += 1
        if stale:
            self._stale_ticks += 1
            control = self._stale_control()
        else:
            control = controller.step(
                inputs["setpoint"], inputs["measurement"], inputs["feedforward"], inputs["manual_control"]
            )
        self._saturated_ticks += controller.state.saturated
        self.publish_control(control, stamp)
        self._publish_state(stamp)

    def _stale_control(self) -> float:
        policy = self._values["on_stale"]
        if policy == "safe":
            return self._controller.settings.safe_control
        return self._inputs["manual_control"] if policy == "manual" else self._controller.state.control

    def publish_control(self, control: float, stamp_ns: int) -> None:
        """Send the control with the stamp of the measurement it answers, or of the tick [ns]."""
        self._control_publisher.publish(self._write(control, stamp_ns))

    def _fill_gains(self) -> None:
        message = self._state
        message.kp, message.ki, message.kd, message.lam, message.mu = self._controller.settings.gains.gains

    def _publish_state(self, stamp_ns: int) -> None:
        message, state = self._state, self._controller.state
        header_stamp(message.header, stamp_ns)
        message.setpoint, message.measurement, message.error = state.setpoint, state.measurement, state.error
        message.proportional, message.integral = state.proportional, state.integral
        message.derivative, message.feedforward = state.derivative, state.feedforward
        message.control_unlimited, message.control = state.control_unlimited, state.control
        message.saturated = state.saturated
        message.mode = FopidState.AUTO if state.mode == "auto" else FopidState.MANUAL
        message.sample_interval, message.overruns = self._interval, self._overruns
        self._state_publisher.publish(message)

    def _publish_diagnostics(self) -> None:
        facts = {
            "ticks": self._ticks, "overruns": self._overruns, "non-finite inputs refused": self._refused,
            "stale ticks": self._stale_ticks, "last rejected parameter set": self.last_rejected or "none",
            "share of saturated ticks": round(self._saturated_ticks / max(1, self._ticks), 4),
            "last sample interval [s]": self._interval,
        }  # fmt: skip
        waiting = [name for name in ("setpoint", "measurement") if math.isnan(self._inputs[name])]
        status = DiagnosticStatus(name=self.get_fully_qualified_name(), hardware_id="fopid", level=DiagnosticStatus.OK)
        status.message = f"waiting for {' and '.join(waiting)}" if waiting else self._controller.state.mode
        status.level = DiagnosticStatus.WARN if waiting else DiagnosticStatus.OK
        status.values = [KeyValue(key=key, value=str(value)) for key, value in facts.items()]
        message = DiagnosticArray(status=[status])
        header_stamp(message.header, self.get_clock().now().nanoseconds)
        self._diagnostics.publish(message)

    def _on_reset(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._controller.reset()
        self._last_stamp = None
        response.success, response.message = True, "the past is forgotten; gains and mode stay"
        return response

    def _on_set_auto(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        mode = "auto" if request.data else "manual"
        result = self.set_parameters_atomically([Parameter("mode", value=mode)])
        response.success, response.message = result.successful, result.reason or mode
        return response


def main(args: list[str] | None = None) -> int:
    """Entry point of the executable ``fopid_controller``."""
    return run(ControllerNode, args)


if __name__ == "__main__":
    sys.exit(main())
