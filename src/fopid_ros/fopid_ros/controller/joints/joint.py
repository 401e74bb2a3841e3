"""One joint of many: its inputs, its controller in the bank, and what it does while an input is missing."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from fopid_core.runtime.cascade import TrackingInput
from fopid_core.runtime.controller import FopidController
from fopid_core.runtime.controller_bank import Signals
from fopid_ros.common.inputs import Input
from fopid_ros.controller.inputs import timeouts
from fopid_ros.controller.state_message import STATE, fill_signals
from fopid_ros.controller.still_measurement import StillMeasurement


class Joint:
    """What a joint hears and does; it is told as the single controller's node tells its loop.

    Parameters
    ----------
    name : str
    controller : FopidController
        Its one in the bank.

    Attributes
    ----------
    setpoint, measurement, feedforward, manual, tracking : Input
    unusable : tuple of Input
        Without which the control of the last tick was not worked out.
    """

    def __init__(self, name: str, controller: FopidController) -> None:
        self.name, self.controller = name, controller
        self.setpoint, self.measurement = Input(f"setpoint of {name}"), Input(f"measurement of {name}")
        self.feedforward, self.manual = Input(f"feedforward of {name}", 0.0), Input(f"manual_control of {name}")
        self.tracking, self._limited = Input(f"tracking of {name}"), TrackingInput()
        self.inputs = {
            "setpoint": self.setpoint, "measurement": self.measurement, "feedforward": self.feedforward,
            "manual_control": self.manual, "tracking": self.tracking,
        }  # fmt: skip
        self.unusable: tuple[Input, ...] = ()
        self._still = StillMeasurement(self.measurement.name)
        self.message = STATE.record()
        self._on_stale, self._safe = "hold", 0.0
        self._parts_known = False

    def take_settings(self, values: Mapping[str, Any]) -> None:
        """Put timeouts and what is done without inputs in force."""
        for name, seconds in timeouts(values).items():
            self.inputs[name].timeout_ns = seconds * 1e9
        self._on_stale, self._safe = values["on_stale"], self.controller.settings.safe_control
        message, gains = self.message, self.controller.settings.gains
        message.kp, message.ki, message.kd, message.lam, message.mu = gains.gains

    def forget(self) -> None:
        """As new, but for gains, mode and inputs."""
        self.controller.reset()
        self._parts_known = False

    @property
    def awaits_first_input(self) -> bool:
        """Whether setpoint or measurement has never come."""
        return any(one.missing for one in self.unusable)

    def signals(self, now_ns: int, *, contested: bool) -> Signals | None:
        """What its controller takes at this tick; None once it holds a control instead."""
        controller, manual = self.controller, self.manual
        state = controller.state
        self._limited.sent(state.control)
        if not (self.setpoint.usable(now_ns) and self.measurement.usable(now_ns)) or contested or state.mode != "auto":
            self._look(now_ns)
            if self.unusable or contested:
                self._hold(now_ns, contested=contested)
                return None
        else:
            self.unusable = ()
        self._parts_known = True
        if state.mode == "auto":
            manual.value = math.nan  # on a change to manual the control stays until the next message
        return (
            self.setpoint.value, self.measurement.value, self.feedforward.faded(now_ns),
            state.control if manual.missing else manual.value,
            self._limited.limit(self.tracking.value) if self.tracking.usable(now_ns) else None,
        )  # fmt: skip

    def _look(self, now_ns: int) -> None:
        found = [one for one in (self.setpoint, self.measurement) if not one.usable(now_ns)]
        manual = self.manual
        if self.controller.state.mode == "manual" and not manual.missing and not manual.usable(now_ns):
            found.append(manual)
        self.unusable = tuple(found)

    def _hold(self, now_ns: int, *, contested: bool) -> None:
        """The control while an input is stale, contested, or has never come."""
        controller = self.controller
        manual = self.manual.value if self.manual.usable(now_ns) else None
        if contested:
            controller.hold(self._safe)
        elif controller.state.mode == "manual" and self.manual not in self.unusable:
            controller.hold(manual)
        elif controller.state.mode == "manual" or not self.awaits_first_input:
            controller.hold({"hold": None, "safe": self._safe, "manual": manual}[self._on_stale])

    def dropped(self, now_ns: int) -> list[Input]:
        """The inputs that it does without since they are too old."""
        added = [self.feedforward] if self.feedforward.value and self.feedforward.stale(now_ns) else []
        return added + ([self.tracking] if self.tracking.stale(now_ns) else [])

    def repeats(self) -> str:
        """Whether its sensor repeats its last value, looked at once a second; empty where it does not."""
        settings = self.controller.settings
        control_range = settings.control_max - settings.control_min
        return self._still.look(self.measurement.value, self.controller.state.control, control_range)

    def told(self, stamp_ns: int, now_ns: int) -> Any:
        """Its state, with the fields of FopidState."""
        message = self.message
        message.stamp_ns = stamp_ns
        fill_signals(message, self.controller.state, self, now_ns, known=self._parts_known)
        message.stale, message.refused = bool(self.unusable), sum(one.refused for one in self.inputs.values())
        return message
