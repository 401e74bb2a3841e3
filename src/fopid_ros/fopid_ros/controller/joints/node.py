"""The controller node for many joints: ``dof_names`` names them, each message holds a number for each."""

from __future__ import annotations

import time
from collections.abc import Sequence
from functools import partial
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.context import Context
from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn
from rclpy.node import Node
from rclpy.qos import QoSProfile

from fopid_core.runtime.controller_bank import ControllerBank
from fopid_msgs.msg import FopidState
from fopid_ros.common.array_signals import ArraySignal
from fopid_ros.common.diagnostics import PublisherConflicts, health_problems
from fopid_ros.common.inputs import is_number
from fopid_ros.common.managed_node import LOCKSTEP_DEPTH, loop_qos
from fopid_ros.common.message_types import MessageTypes
from fopid_ros.controller.gain_memory import GainMemory
from fopid_ros.controller.joints.inputs import JointInputs
from fopid_ros.controller.joints.joint import Joint
from fopid_ros.controller.joints.parameters import (
    check_dof_names,
    joint_parameter,
    joint_settings,
    joint_specs,
    refuse_idle_joints,
    signal_types,
)
from fopid_ros.controller.parameters import SIGNALS, check_file_name, check_timeouts
from fopid_ros.controller.state_message import STATE
from fopid_ros.controller.ticking import TickingNode

LISTENERS_PERIOD = 0.2
"""How often it is looked who hears the states of the joints [s]: to ask at each tick costs more than the control."""


def given_dof_names(name: str, context: Context | None = None) -> list[str] | None:
    """The parameter ``dof_names`` as this process was given it; None where it was not."""
    node = Node(name, context=context, enable_rosout=False, start_parameter_services=False)
    try:
        given = node._parameter_overrides.get("dof_names")  # noqa: SLF001  (no public way to see them)
    finally:
        node.destroy_node()
    if given is None:
        return None
    return list(map(str, given.value)) if isinstance(given.value, list) else [str(given.value)]


class JointsNode(TickingNode):
    """Subscribes setpoint, measurement, feedforward, manual_control, tracking; publishes control and ~/NAME/state.

    Parameters
    ----------
    dof_names : sequence of str
    """

    NAME = "fopid_controller"
    _types: dict[str, ArraySignal]

    def __init__(self, dof_names: Sequence[str], context: Context | None = None) -> None:
        check_dof_names(dof_names)
        self.SPECS = joint_specs(dof_names)
        super().__init__(context=context)

    def check(self, values: dict[str, Any]) -> None:
        joint_settings(values, signal_types(values)["control"])
        check_timeouts(values)
        check_file_name(values)

    def make_memories(self) -> tuple[GainMemory, ...]:
        return tuple(GainMemory(self, dof, partial(joint_parameter, dof)) for dof in self.values()["dof_names"])

    # What lives from configure to cleanup.

    def open(self, values: dict[str, Any]) -> None:
        self._values = values
        self._types = types = signal_types(values)
        self._bank = ControllerBank(joint_settings(values, types["control"]))
        refuse_idle_joints(values)
        self._joints = [Joint(*each) for each in zip(values["dof_names"], self._bank.controllers, strict=True)]
        self.open_ticks(values)
        self._inputs = JointInputs(self, self._joints, types, self._statistics.counts, self._now)
        self._conflicts = PublisherConflicts(self, SIGNALS)
        heard = [name for name in SIGNALS if name != "control" and (name != "tracking" or values["tracking.enabled"])]
        self._message_types = MessageTypes(self, {name: types[name].message_type for name in heard})
        self._contested, self._ticks_looked_at = False, 0
        self._troubled: tuple[str, ...] = ()
        self._take_settings()
        self._set_modes()
        self._open_endpoints()
        self._controls = self._safe_controls()

    def _open_endpoints(self) -> None:
        lockstep, endpoints, types = self._lockstep, self.endpoints, self._types
        self._inputs.listen(lockstep=lockstep, tracking=self._values["tracking.enabled"])
        self.open_measurement()
        self._write = types["control"].writer()
        self._control_publisher = endpoints.publisher(
            types["control"].message_type, "control", loop_qos(lockstep=lockstep)
        )
        qos = QoSProfile(depth=LOCKSTEP_DEPTH if lockstep else 10)
        self._state_publishers = [
            endpoints.publisher(FopidState, f"~/{joint.name}/state", qos) for joint in self._joints
        ]
        self._heard = [False] * len(self._joints)
        endpoints.timer(LISTENERS_PERIOD, self._look_for_listeners, self._steady)
        self.open_mode_services()
        self.open_memories()
        self.open_diagnostics()
        endpoints.refuse_unknown_overrides()

    def _look_for_listeners(self) -> None:
        self._heard = [publisher.get_subscription_count() > 0 for publisher in self._state_publishers]

    # Parameters.

    def apply(self, values: dict[str, Any]) -> None:
        if not self.configured:
            return
        self.take_gains(values)
        before, self._values = [one.settings.gains for one in self._bank.controllers], values
        self._bank.reconfigure(joint_settings(values, self._types["control"]))
        for joint, old in zip(self._joints, before, strict=True):
            new = joint.controller.settings.gains
            if new != old:
                origin = values[f"gains.{joint.name}.origin"] or "a client that does not say who it is"
                self.get_logger().info(f"gains of {joint.name} from {old} to {new}, set by: {origin}")
        self._take_settings()
        self._set_modes()

    def _take_settings(self) -> None:
        self._inputs.take_settings(self._values)
        for joint in self._joints:
            joint.take_settings(self._values)

    def _set_modes(self) -> None:
        for controller in self._bank.controllers:
            if controller.state.mode != self._values["mode"]:
                controller.set_mode(self._values["mode"])

    # Transitions.

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        for joint in self._joints:
            self.get_logger().info(f"controlling {joint.name} with {joint.controller.settings.gains}")
        return super().on_activate(state)

    # Ticks.

    def take_measurement(self, message: Any, stamp_ns: int) -> None:
        self._inputs.take("measurement", message, stamp_ns)

    def make_safe(self) -> None:
        self._controls = self._safe_controls()

    def send_control(self, stamp_ns: int) -> None:
        self._publish(self._controls, stamp_ns)

    def _safe_controls(self) -> list[float]:
        return [one.settings.safe_control for one in self._bank.controllers]

    def forget(self) -> None:
        for joint in self._joints:
            joint.forget()

    def tick(self, stamp_ns: int, now_ns: int) -> None:
        contested = self._contested
        self._controls = self._bank.step([joint.signals(now_ns, contested=contested) for joint in self._joints])
        saturated = stale = False
        for k, joint in enumerate(self._joints):
            if not is_number(self._controls[k]):
                self._recover(k)
            saturated = saturated or joint.controller.state.saturated
            stale = stale or bool(joint.unusable)
        self._statistics.tick(self._interval, saturated=saturated, stale=stale)
        self._publish(self._controls, stamp_ns)
        self._publish_states(stamp_ns, now_ns)
        if stale or self._troubled:
            self._log_trouble()

    def _recover(self, k: int) -> None:
        """Gains times signals beyond what a number can hold: the safe control, and a controller as new."""
        joint = self._joints[k]
        self._statistics.counts.controls_not_finite += 1
        told = f"control of {joint.name} = {self._controls[k]}: its controller starts anew"
        self.get_logger().error(told, throttle_duration_sec=1.0)
        joint.forget()
        self._controls[k] = joint.controller.state.control

    def _publish(self, controls: Sequence[float], stamp_ns: int) -> None:
        self._control_publisher.publish(self._write(controls, stamp_ns))

    def _publish_states(self, stamp_ns: int, now_ns: int) -> None:
        """Of the joints that somebody hears, as often as ``state_rate`` allows."""
        if not any(self._heard) or not self.state_interval_is_over(now_ns):
            return
        for joint, publisher, heard in zip(self._joints, self._state_publishers, self._heard, strict=True):
            if heard:
                state = joint.told(stamp_ns, now_ns)
                state.sample_interval, state.overruns = self._interval, self._statistics.counts.late_ticks
                publisher.publish(STATE.pack_record(state))

    # What people are told.

    def _log_trouble(self) -> None:
        """Log what has changed."""
        now = tuple(one.name for joint in self._joints for one in joint.unusable)
        if now == self._troubled:
            return
        self._troubled = now
        names = " and ".join(now)
        if not now:
            self.get_logger().info("setpoint and measurement of all joints are there")
        elif all(joint.awaits_first_input for joint in self._joints if joint.unusable):
            self.get_logger().info(f"waiting for {names}")
        else:
            self.get_logger().error(f"{names} stale; on_stale = {self._values['on_stale']}")

    def health(self) -> tuple[str, list[tuple[bytes, str]], dict[str, object]]:
        self.take_waiting()
        since, rates = self._statistics.window(time.monotonic_ns())
        now, counts = self._now(), self._statistics.counts
        found = self.memory_problems() + (self._lacks(now) if self._active else [])
        found += health_problems(since, ticking=self._active and not self._lockstep)
        rivalries = self._conflicts.check()
        found += [(one.level, one.text) for one in rivalries]
        found += [(DiagnosticStatus.WARN, text) for text in self._message_types.check()]
        mode = self._values["mode"]
        wanted = [one for one in rivalries if one.sure and one.topic != "control"
                  and (one.topic == "manual_control") == (mode == "manual")]  # fmt: skip
        self._contested = bool(wanted) and self._values["on_several_publishers"] == "safe"
        facts: dict[str, object] = {
            **rates, "mode": mode, "ticks": counts.ticks, "overruns": counts.late_ticks,
            "stale ticks": counts.stale_ticks, "other values refused": counts.refused_values - counts.stamps_ahead,
            "stamps ahead of this clock refused": counts.stamps_ahead,
            "time ran backwards": counts.backward_time_jumps,
            "share of saturated ticks": counts.saturated_ticks / max(1, counts.ticks),
            "last rejected parameter set": self.last_rejected or "none", **self.memory_facts(self._values),
        }  # fmt: skip
        for joint in self._joints:
            facts[f"age of the {joint.measurement.name} [s]"] = joint.measurement.age(now)
            facts |= {f"refused of the {one.name}": one.refused for one in joint.inputs.values() if one.refused}
        return mode if self._active else "inactive", found, facts

    def _lacks(self, now_ns: int) -> list[tuple[bytes, str]]:
        """What the controls lack, in words with their levels."""
        found = []
        ticks = self._statistics.counts.ticks
        stands, self._ticks_looked_at = ticks == self._ticks_looked_at, ticks
        for joint in self._joints:
            names = " and ".join(one.name for one in joint.unusable)
            if names and joint.awaits_first_input:
                found.append((DiagnosticStatus.WARN, f"waiting for {names}"))
            elif names:
                found.append((DiagnosticStatus.ERROR, f"{names} stale"))
            elif not stands and (told := joint.repeats()):
                found.append((DiagnosticStatus.WARN, told))
            found += [
                (DiagnosticStatus.WARN, f"{one.name} stale: the loop goes on without it")
                for one in joint.dropped(now_ns)
            ]
        return found
