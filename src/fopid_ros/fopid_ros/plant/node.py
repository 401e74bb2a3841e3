"""The plant simulator: takes the control signal, publishes the measurement.

In lockstep it owns ``/clock`` and its samples follow the controller's answers; otherwise a timer drives it.
"""

from __future__ import annotations

import math
import sys
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.clock import Clock, ClockType
from rclpy.context import Context
from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn
from rclpy.timer import Timer
from rosgraph_msgs.msg import Clock as ClockMessage
from std_srvs.srv import Trigger

from fopid_core.errors import InputError
from fopid_core.model.process import read_process
from fopid_core.runtime.convolved_plant import AnyPlant, ConvolvedPlant, plant_of
from fopid_core.runtime.plant import TOLD_FROM, PlantSettings
from fopid_msgs.srv import Advance
from fopid_ros.common.background import Later
from fopid_ros.common.managed_node import TIMING, ManagedNode, loop_qos, run, take_pending_messages
from fopid_ros.common.message_types import MessageTypes
from fopid_ros.common.parameters import Spec
from fopid_ros.common.pending_values import PendingValues
from fopid_ros.common.signals import signal_specs, signal_type
from fopid_ros.plant.advances import Advances
from fopid_ros.plant.model_plant import ModelPlant

SPECS = (
    Spec("process", "P1", "P1 ... P4, a transfer function in s as text, or a YAML file", read_only=True),
    Spec("model", "", "a Python model in place of the process: package.module:Class with step(u, dt)", read_only=True),
    Spec("sample_time", 0.01, "time between samples [s]", 1e-6, 1e6, read_only=True),
    Spec("delay_model", "pade", "how the delay is simulated", choices=("pade", "exact"), read_only=True),
    Spec("pade_order", 3, "order of Pade's approximation of the delay", 1, 10, read_only=True),
    Spec("noise_std", 0.0, "standard deviation of the white measurement noise", 0.0, 1e300, read_only=True),
    Spec("seed", 0, "seed of the noise", 0, 2**53, read_only=True),
    Spec(
        "gain_factor", 1.0, "factor on the process's input; may change while the plant runs", -1e300, 1e300, slides=True
    ),
    Spec("initial_output", 0.0, "output at the start, at rest", -1e300, 1e300, read_only=True),
    Spec("advance_until", math.inf, "lockstep stops at this time of the plant's own clock [s]", 0.0),
    Spec("publish_clock", True, "in lockstep, publish /clock", read_only=True),
    TIMING,
    *signal_specs("control"),
    *signal_specs("disturbance"),
    *signal_specs("measurement"),
)

STANDING_TIME = 5.0  # wall time [s] without a sample after which who waits for one is told so

RESEND_AFTER = 0.2  # wall time [s] without an answer in lockstep after which the measurement is sent again

FAILURE_PERIOD = 10.0  # one line about a plant that fails, or is too slow, in so much time [s]
CLOCK_PERIOD = 0.01  # wall time [s] between two /clock messages while lockstep runs; at every stop there is one


def _plant_settings(values: dict[str, Any]) -> PlantSettings:
    names = ("sample_time", "delay_model", "pade_order", "noise_std", "seed", "gain_factor", "initial_output")
    return PlantSettings(read_process(values["process"]), **{name: values[name] for name in names})


def _plant(values: dict[str, Any]) -> AnyPlant | ModelPlant:
    settings = _plant_settings(values)
    return ModelPlant(values["model"], settings) if values["model"] else plant_of(settings)


class PlantSimulator(ManagedNode):
    """Subscribes control and disturbance, publishes measurement and, in lockstep, /clock."""

    NAME = "plant_simulator"
    SPECS = SPECS

    def __init__(self, context: Context | None = None) -> None:
        super().__init__(context=context)
        values = self.values()
        self._plant = _plant(values)
        self._lockstep = values["trigger"] == "lockstep"
        self._until: float = values["advance_until"]
        self._period_ns: int = round(values["sample_time"] * 1e9)
        self._half_period = 0.5e-9 * self._period_ns
        self._control = self._disturbance = 0.0
        self._pending = PendingValues()
        self._advances = Advances(self.background)
        self._sample = self._sample_before = self._standing = 0
        self._refused = self._failed = 0
        self._failure = ""
        self.timer: Timer | None = None
        self._create_endpoints(values)

    def _create_endpoints(self, values: dict[str, Any]) -> None:
        types = {name: signal_type(values, name)
                 for name in ("control", "disturbance", "measurement")}  # fmt: skip
        self._control_type, self._disturbance_type = types["control"], types["disturbance"]
        self._message_types = MessageTypes(
            self, {name: types[name].message_type for name in ("control", "disturbance")}
        )
        self._write = types["measurement"].writer()
        qos = loop_qos(lockstep=self._lockstep)
        self._publisher = self.create_publisher(types["measurement"].message_type, "measurement", qos)
        # The disturbance is created first: in lockstep it is taken before the control that arrives with it.
        self._disturbances = self.create_subscription(
            types["disturbance"].message_type, "disturbance", self._on_disturbance, qos, raw=types["disturbance"].raw
        )
        control = types["control"]
        self.create_subscription(control.message_type, "control", self._on_control, qos, raw=control.raw)
        self.create_service(Trigger, "~/reset", self._on_reset)
        self.background.may_answer_later(self.create_service(Advance, "~/advance", self._on_advance))
        self._clock_message = ClockMessage()
        self._clock_published = 0.0
        owns_clock = self._lockstep and values["publish_clock"]
        self._clock_publisher = self.create_publisher(ClockMessage, "/clock", 1) if owns_clock else None

    def check(self, values: dict[str, Any]) -> None:
        _plant_settings(values)
        for name in ("control", "disturbance", "measurement"):
            signal_type(values, name)

    def open(self, values: dict[str, Any]) -> None:
        self.open_diagnostics()

    def health(self) -> tuple[str, list[tuple[bytes, str]], dict[str, object]]:
        problems = [(DiagnosticStatus.WARN, text) for text in self._message_types.check()]
        problems += [(DiagnosticStatus.ERROR, self._failure)] * bool(self._failure)
        facts: dict[str, object] = {"refused values": self._refused, "failures of the plant": self._failed}
        return "simulating" if self.timer is not None else "inactive", problems, facts

    def apply(self, values: dict[str, Any]) -> None:
        self._plant.gain_factor = values["gain_factor"]
        if values["advance_until"] != self._until:
            self._advance_until(values["advance_until"])

    @property
    def time(self) -> float:
        """Time since the start of the simulation [s]."""
        return self._sample * self._period_ns / 1e9

    @property
    def _gate_open(self) -> bool:
        return bool(self._until - self.time > self._half_period)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        if self._lockstep:
            self.timer = self.create_timer(RESEND_AFTER, self._resend, clock=steady)
            self._sent_since = False
            self._send()
        else:
            use_sim_time = self.get_parameter("use_sim_time").value
            clock = self.get_clock() if use_sim_time else steady
            self.timer = self.create_timer(self._period_ns * 1e-9, self._tick, clock=clock)
        process = self.get_parameter("model").value or self.get_parameter("process").value
        self.get_logger().info(f"simulating {process} every {self._period_ns * 1e-9:g} s, {self.values()['trigger']}")
        if isinstance(self._plant, ConvolvedPlant) and math.isfinite(self._plant.ends_by):
            until = f"it stands still before {self._plant.ends_by:g} s"
            self.get_logger().warning(f"it is unstable, and its response grows beyond all numbers: {until}")
        off = 0.0 if isinstance(self._plant, ModelPlant) else self._plant.accuracy
        if off > TOLD_FROM:
            told = f"its delay is Pade's: the response to a step is off by up to {100.0 * off:.2g} % of it"
            self.get_logger().info(f"{told}; delay_model:=exact is exact")
        return super().on_activate(state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        self._stand_still()
        return super().on_deactivate(state)

    def _release(self) -> None:
        self._stand_still()
        super()._release()

    def _stand_still(self) -> None:
        """Simulate no more, and tell who waits for it."""
        if self.timer is not None:
            self.destroy_timer(self.timer)
            self.timer = None
        self._advances.answer(self.time, -math.inf, "the plant was deactivated")

    def _advance(self) -> bool:
        """Whether the plant has come a sample further; a model that fails does not, and that is told."""
        try:
            self._plant.step(self._control, self._disturbance)
        except InputError as error:
            self._failed, self._failure = self._failed + 1, str(error)
            if self.guard.is_due(("plant",), FAILURE_PERIOD):
                self.get_logger().error(f"{error} (no measurement, {self._failed} times so far)")
            return False
        self._failure = ""
        return True

    # Lockstep: y_k is answered by u_k, stamped alike; the answer makes y_(k+1).

    def _send(self) -> None:
        if self._gate_open and self.timer is not None:
            self._publisher.publish(self._write(self._plant.measurement, self._sample * self._period_ns))
            self._sent_since = True

    def _resend(self) -> None:
        """A measurement nobody answers may have been sent before the controller was there."""
        if not self._sent_since:
            self._send()
        self._sent_since = False
        self._publish_clock()  # for who comes late, while the loop stands
        self._standing = self._standing + 1 if self._sample == self._sample_before else 0
        self._sample_before = self._sample
        if self._standing * RESEND_AFTER > STANDING_TIME:
            why = self._failure or "is there a controller?"
            self._advances.answer(self.time, -math.inf, f"the loop stands at {self.time:g} s: {why}")

    def _step_lockstep(self, stamp_ns: int | None) -> None:
        current = self._sample * self._period_ns
        if self.timer is None or not self._gate_open or (stamp_ns is not None and stamp_ns != current):
            return
        take_pending_messages(self._disturbances)
        for value in self._pending.due(current):
            self._disturbance = value
        if not self._advance():
            return
        self._sample += 1
        self._send()
        self._publish_clock()
        if self.time + self._half_period >= self._advances.next_time:
            self._advances.answer(self.time, self.time + self._half_period)

    def _publish_clock(self) -> None:
        """Often enough for people and timers, not at every sample: each reader pays for each message."""
        now = time.monotonic()
        if self._clock_publisher is None or (self._gate_open and now - self._clock_published < CLOCK_PERIOD):
            return
        self._clock_published = now
        stamp = self._clock_message.clock
        stamp.sec, stamp.nanosec = divmod(self._sample * self._period_ns, 1_000_000_000)
        self._clock_publisher.publish(self._clock_message)

    def _advance_until(self, until: float) -> None:
        was_open, self._until = self._gate_open, until
        if self._advances.next_time < math.inf:
            self._advances.limit(self.time, until)
        if self._lockstep and not was_open:
            self._send()

    def _on_advance(self, request: Advance.Request, response: Advance.Response) -> Advance.Response | Later:
        """Answered when that time is reached, or when the loop stands."""
        if not self._lockstep:
            response.message = "trigger = 'realtime'; advancing is for trigger = 'lockstep'"
        elif math.isnan(request.until) or request.until < self.time - self._half_period:
            response.message = f"until = {request.until}; allowed: the present time {self.time:g} s or later"
        else:
            self._advance_until(request.until)
            if self._gate_open and self.timer is not None:
                self._standing = 0
                return self._advances.add(request.until, response)
            response.success = not self._gate_open
            response.message = "reached" if response.success else "the plant is not active"
        response.time = self.time
        return response

    # Realtime: the timer makes the samples, the newest control is held in between.

    def _tick(self) -> None:
        began = time.monotonic()
        if not self._advance():
            return
        took, period = time.monotonic() - began, 1e-9 * self._period_ns
        if took > period and self.guard.is_due(("slow step",), FAILURE_PERIOD):
            told = f"one step of the plant took {took:.3g} s: it runs behind"
            self.get_logger().warning(f"{told}; allowed: less than sample_time = {period:g} s")
        self._sample += 1
        self._publisher.publish(self._write(self._plant.measurement, self.get_clock().now().nanoseconds))

    def _on_control(self, message: Any) -> None:
        value = self._control_type.read(message)
        if not math.isfinite(value):
            self.refuse_message("control", f"control = {value}; allowed: finite numbers")
            return
        self._control = value
        if self._lockstep:
            self._step_lockstep(self._control_type.stamp_ns(message))

    def _on_disturbance(self, message: Any) -> None:
        value = self._disturbance_type.read(message)
        if not math.isfinite(value):
            self.refuse_message("disturbance", f"disturbance = {value}; allowed: finite numbers")
        elif not (self._lockstep and self._is_for_later(self._disturbance_type.stamp_ns(message), value)):
            self._disturbance = value

    def _is_for_later(self, stamp_ns: int | None, value: float) -> bool:
        """Whether a disturbance waits for its time, or is refused since too many do."""
        try:
            return self._pending.defer(stamp_ns, value)
        except InputError as error:
            self.refuse_message("disturbance", f"disturbance: {error}")
            return True

    def refuse_message(self, topic: str, told: str) -> None:
        self._refused += 1
        self.get_logger().warning(f"{told}; refused ({self._refused} so far)", throttle_duration_sec=1.0)

    def _on_reset(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._advances.answer(self.time, -math.inf, "the plant was reset")
        try:
            self._plant.reset()
        except InputError as error:
            response.message = str(error)
            return response
        self._pending = PendingValues()
        self._sample = 0
        self._control = self._disturbance = 0.0
        response.success, response.message = True, "at rest, time 0"
        if self._lockstep:
            self._send()
        return response


def main(args: list[str] | None = None) -> int:
    """Entry point of the executable ``plant_simulator``."""
    return run(PlantSimulator, args)


if __name__ == "__main__":
    sys.exit(main())
