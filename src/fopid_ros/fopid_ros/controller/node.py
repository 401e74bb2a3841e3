"""The FOPID controller node: setpoint and measurement in, control out; gains change while it runs."""

from __future__ import annotations

import math
import sys
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn
from rclpy.qos import QoSProfile

from fopid_core.runtime.controller import ControllerState, FopidController
from fopid_msgs.msg import FopidState
from fopid_ros.common.diagnostics import (
    PublisherConflicts,
    diagnostic_array,
    diagnostic_status,
    health_problems,
)
from fopid_ros.common.inputs import Input, is_number
from fopid_ros.common.managed_node import LOCKSTEP_DEPTH, ManagedNode, loop_qos, run
from fopid_ros.common.message_types import MessageTypes
from fopid_ros.common.signals import SignalType
from fopid_ros.controller.cascade import CascadeLink, check_cascade
from fopid_ros.controller.control_msgs_output import ControlMsgsOutput
from fopid_ros.controller.inputs import LoopInputs
from fopid_ros.controller.joints.node import JointsNode, given_dof_names
from fopid_ros.controller.parameters import (
    LOOP_SIGNALS,
    SPECS,
    check_file_name,
    check_timeouts,
    controller_settings,
    initial_setpoint,
    refuse_idle_gains,
    signal_types,
)
from fopid_ros.controller.retained import check_provenance
from fopid_ros.controller.sample_intervals import SampleIntervals, check_variable_step
from fopid_ros.controller.scheduling import Scheduling, check_scheduled_gains, listened_signals, listens
from fopid_ros.controller.state_message import STATE, fill_signals
from fopid_ros.controller.still_measurement import StillMeasurement
from fopid_ros.controller.ticking import TickingNode


class ControllerNode(TickingNode):
    """Subscribes setpoint, measurement, feedforward, manual_control and tracking; publishes control and ~/state."""

    NAME = "fopid_controller"
    SPECS = SPECS

    _parts_known = False

    def check(self, values: dict[str, Any]) -> None:
        controller_settings(values, signal_types(values)["control"])
        initial_setpoint(values)
        check_timeouts(values)
        check_cascade(values)
        check_variable_step(values)
        check_scheduled_gains(self._values if self.configured else values, values)
        check_file_name(values)
        check_provenance(values)

    # What lives from configure to cleanup.

    def open(self, values: dict[str, Any]) -> None:
        self._types = types = signal_types(values)
        self._values = values
        self._controller = FopidController(controller_settings(values, types["control"]))
        self._controller.set_mode(values["mode"])
        self.open_ticks(values)
        self._unusable: list[Input] = []
        self._dropped: list[Input] = []
        counts = self._statistics.counts
        self._inputs = LoopInputs(self, values, types, counts, self._now, initial_setpoint(values))
        self._intervals = SampleIntervals(values["sample_time"]) if values["variable_step"] else None
        self._sample_interval: float | None = None  # to the sample of this tick, with variable_step
        self._scheduling = Scheduling(values, self._controller, self._inputs)
        self._control = values["safe_control"]
        self._publisher_conflicts = PublisherConflicts(self, LOOP_SIGNALS)
        self._message_types = MessageTypes(self, {name: types[name].message_type for name in listened_signals(values)})
        self._contested_topics: list[str] = []
        self._still, self._ticks_looked_at = StillMeasurement(), 0
        self._state = STATE.record()
        self._update_cached_settings()
        self._open_topics(types)
        self._open_services()
        refuse_idle_gains(values)

    def _open_topics(self, types: dict[str, SignalType]) -> None:
        lockstep, endpoints = self._lockstep, self.endpoints
        self._inputs.listen(tracking=self._values["tracking.enabled"], scheduling=listens(self._values))
        self._cascade = CascadeLink(endpoints, self._values, self._inputs.tracking)
        self.open_measurement()
        self._write = types["control"].writer()
        self._control_publisher = endpoints.publisher(
            types["control"].message_type, "control", loop_qos(lockstep=lockstep)
        )
        state_qos = QoSProfile(depth=LOCKSTEP_DEPTH if lockstep else 10)
        self._state_publisher = endpoints.publisher(FopidState, "~/state", state_qos)
        self._control_msgs = ControlMsgsOutput(endpoints, self._values, self.get_name())
        self._diagnostics = endpoints.publisher(DiagnosticArray, "/diagnostics", QoSProfile(depth=10))
        endpoints.refuse_unknown_overrides()

    def _open_services(self) -> None:
        self.open_mode_services()
        self.open_memories()
        self.endpoints.timer(1.0, self._publish_diagnostics, self._steady)

    # Parameters.

    def apply(self, values: dict[str, Any]) -> None:
        if not self.configured:
            return
        self.take_gains(values)
        mode_before, gains_before, self._values = self._values["mode"], self._controller.settings.gains, values
        self._scheduling.reconfigure(controller_settings(values, self._types["control"]))
        gains = self._controller.settings.gains
        if gains != gains_before and not values["schedule_file"]:
            origin = values["gains.origin"] or "a client that does not say who it is"
            self.get_logger().info(f"gains from {gains_before} to {gains}, set by: {origin}")
        if values["mode"] != mode_before:
            self._controller.set_mode(values["mode"])
        self._update_cached_settings()

    def _update_cached_settings(self) -> None:
        self._inputs.take_settings(self._values)
        self._tell_gains()

    def _tell_gains(self) -> None:
        message = self._state
        message.kp, message.ki, message.kd, message.lam, message.mu = self._scheduling.gains.gains

    # Transitions.

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        gains = self._controller.settings.gains
        self.get_logger().info(f"controlling with {gains} every {self._period_ns * 1e-9:g} s")
        return super().on_activate(state)

    # Ticks.

    def take_measurement(self, message: Any, stamp_ns: int) -> None:
        if self._inputs.take(self._inputs.measurement, self._types["measurement"].read(message), stamp_ns):
            self._inputs.sampled_ns = stamp_ns

    def make_safe(self) -> None:
        self._control = self._values["safe_control"]

    def tick(self, stamp_ns: int, now_ns: int) -> None:
        inputs, mode = self._inputs, self._controller.state.mode
        unusable, dropped = inputs.unusable(now_ns, mode), inputs.dropped(now_ns)
        unusable = self._measure_interval(unusable)
        if (unusable, dropped) != (self._unusable, self._dropped):
            self._log_input_state(unusable, dropped)
        steps = not (unusable or self._contested)
        control = self._step(now_ns) if steps else self._fallback_control(now_ns)
        state = self._controller.state
        if not is_number(control):
            control = self._recover_from_nonfinite(control)
        self._control = control
        self._statistics.tick(self._interval, saturated=state.saturated, stale=bool(unusable))
        self.publish_control(control, stamp_ns)
        if self._cascade.in_use:
            self._cascade.tell(self._controller, None if steps else inputs.measurement.value, control, stamp_ns)
        if self._control_msgs.in_use:
            self._control_msgs.publish(state, stamp_ns, self._interval)
        told = state.mode == "manual" or not (unusable and self._awaiting_first_input)
        if told and self._state_is_due(now_ns):
            self._publish_state(stamp_ns, now_ns, state)

    def _measure_interval(self, unusable: list[Input]) -> list[Input]:
        """With ``variable_step`` the time since the last sample; too long a time is a measurement that was stale."""
        intervals, measurement = self._intervals, self._inputs.measurement
        if intervals is None:
            return unusable
        if not unusable:
            self._sample_interval = intervals.take(self._inputs.sampled_ns)
            if self._sample_interval > intervals.longest(measurement.timeout_ns):
                unusable = [measurement]
        if unusable or self._contested:
            intervals.begin()
        return unusable

    def _step(self, now_ns: int) -> float:
        controller, inputs = self._controller, self._inputs
        self._parts_known, manual = True, inputs.manual
        self._scheduling.follow(now_ns)
        if controller.state.mode == "auto":
            manual.value = math.nan  # on a change to manual the control stays until the next message
        by_hand = controller.state.control if manual.missing else manual.value
        if self._sample_interval == 0.0:
            return controller.wait(by_hand)
        if self._sample_interval is not None:
            controller.set_interval(self._sample_interval)
        return controller.step(
            inputs.setpoint.value, inputs.measurement.value, inputs.feedforward.faded(now_ns), by_hand,
            self._cascade.limit(now_ns, controller.state.control) if self._cascade.in_use else None,
        )  # fmt: skip

    def _fallback_control(self, now_ns: int) -> float:
        """The control while an input is stale, contested, or has never come."""
        controller, safe = self._controller, self._values["safe_control"]
        manual = self._inputs.manual.value if self._inputs.manual.usable(now_ns) else None
        if self._contested:
            return controller.hold(safe)
        if controller.state.mode == "manual":
            if self._inputs.manual not in self._unusable:
                return controller.hold(manual)
        elif self._awaiting_first_input:
            return controller.state.control
        return controller.hold({"hold": None, "safe": safe, "manual": manual}[self._values["on_stale"]])

    @property
    def _contested(self) -> bool:
        """Whether the safe control is wanted since several nodes publish an input that is in use."""
        if not self._contested_topics or self._values["on_several_publishers"] != "safe":
            return False
        manual = self._controller.state.mode == "manual"
        return any((topic == "manual_control") == manual for topic in self._contested_topics)

    @property
    def _awaiting_first_input(self) -> bool:
        """Whether setpoint or measurement has never come."""
        return any(one.missing for one in self._unusable)

    def _recover_from_nonfinite(self, control: float) -> float:
        """Gains times signals beyond what a number can hold: the safe control, and a controller as new."""
        self._statistics.counts.controls_not_finite += 1
        self.get_logger().error(f"control = {control}: the controller starts anew", throttle_duration_sec=1.0)
        before = self._controller.state
        self.forget()
        before.control, before.saturated = self._controller.state.control, True
        return before.control

    def forget(self) -> None:
        self._controller.reset()
        self._parts_known = False
        if self._intervals is not None:
            self._intervals.begin()

    def send_control(self, stamp_ns: int) -> None:
        self.publish_control(self._control, stamp_ns)

    def publish_control(self, control: float, stamp_ns: int) -> None:
        """Send the control with the stamp of the measurement it answers, or of the tick [ns]."""
        self._control_publisher.publish(self._write(control, stamp_ns))

    def _state_is_due(self, now_ns: int) -> bool:
        """Whether somebody hears ~/state, and ``state_rate`` allows another one."""
        return bool(self._state_publisher.get_subscription_count()) and self.state_interval_is_over(now_ns)

    def _publish_state(self, stamp_ns: int, now_ns: int, state: ControllerState) -> None:
        message = self._state
        message.stamp_ns = stamp_ns
        if self._values["schedule_file"]:
            self._tell_gains()
        # A state that has just been given up is told as it was.
        given_up = state is not self._controller.state
        fill_signals(message, state, self._inputs, now_ns, known=given_up or self._parts_known)
        message.sample_interval = self._interval if self._sample_interval is None else self._sample_interval
        message.overruns = self._statistics.counts.late_ticks
        message.stale, message.refused = bool(self._unusable), self._statistics.counts.refused_values
        self._state_publisher.publish(STATE.pack_record(message))

    # What people are told.

    def _log_input_state(self, unusable: list[Input], dropped: list[Input]) -> None:
        """Log what has changed."""
        for one in dropped:
            if one not in self._dropped:
                self.get_logger().warning(f"{one.name} stale: {one.without}")
        before, self._unusable, self._dropped = self._unusable, unusable, dropped
        names = " and ".join(one.name for one in unusable)
        if unusable == before:
            return
        if not unusable:
            self.get_logger().info("setpoint and measurement are there")
        elif self._awaiting_first_input:
            self.get_logger().info(f"waiting for {names}")
        else:
            self.get_logger().error(f"{names} stale; on_stale = {self._values['on_stale']}")

    def _publish_diagnostics(self) -> None:
        self.take_waiting()
        since, rates = self._statistics.window(time.monotonic_ns())
        found = self.guard.health_problems() + self._lacks()
        found += health_problems(since, ticking=self._active and not self._lockstep) + self._disputes()
        found += [(DiagnosticStatus.WARN, text) for text in self._message_types.check()]
        state = self._controller.state.mode if self._active else "inactive"
        facts = {**rates, **self._diagnostic_values(), **self.guard.facts()}
        status = diagnostic_status(self.get_fully_qualified_name(), state, found, facts)
        self._diagnostics.publish(diagnostic_array(status, self))

    def _lacks(self) -> list[tuple[bytes, str]]:
        """What the control lacks, in words with their levels."""
        found = self.memory_problems()
        if not self._active:
            return found
        found += [(DiagnosticStatus.WARN, f"{one.name} stale: {one.without}") for one in self._dropped]
        if self._unusable:
            level = DiagnosticStatus.WARN if self._awaiting_first_input else DiagnosticStatus.ERROR
            names = " and ".join(one.name for one in self._unusable)
            found.insert(0, (level, f"waiting for {names}" if self._awaiting_first_input else f"{names} stale"))
        elif told := self._repeats(self._statistics.counts.ticks):
            found.append((DiagnosticStatus.WARN, told))
        return found

    def _repeats(self, ticks: int) -> str:
        """Whether a sensor repeats its last value; nothing where the loop has stood still as well."""
        if ticks == self._ticks_looked_at:
            return ""
        self._ticks_looked_at = ticks
        settings = self._controller.settings
        return self._still.look(
            self._inputs.measurement.value, self._control, settings.control_max - settings.control_min
        )

    def _disputes(self) -> list[tuple[bytes, str]]:
        """Topics with more than one publisher."""
        rivalries = self._publisher_conflicts.check()
        self._contested_topics = [one.topic for one in rivalries if one.sure and one.topic != "control"]
        return [(one.level, one.text) for one in rivalries]

    def _diagnostic_values(self) -> dict[str, object]:
        counts, now = self._statistics.counts, self._now()
        return {
            "mode": self._controller.state.mode,
            "ticks": counts.ticks, "overruns": counts.late_ticks, "stale ticks": counts.stale_ticks,
            **self._inputs.facts(now),
            "other values refused": counts.refused_values - counts.stamps_ahead,
            "stamps ahead of this clock refused": counts.stamps_ahead,
            "time ran backwards": counts.backward_time_jumps,
            "share of saturated ticks": counts.saturated_ticks / max(1, counts.ticks),
            "last rejected parameter set": self.last_rejected or "none",
            **self.memory_facts(self._values),
            **self._scheduling.facts(),
        }  # fmt: skip


def make_controller() -> ManagedNode:
    """The controller of one loop, or with ``dof_names`` of many joints."""
    dof_names = given_dof_names(ControllerNode.NAME)
    return ControllerNode() if dof_names is None else JointsNode(dof_names)


def main(args: list[str] | None = None) -> int:
    """Entry point of the executable ``fopid_controller``."""
    return run(ControllerNode, args, make_controller)


if __name__ == "__main__":
    sys.exit(main())
