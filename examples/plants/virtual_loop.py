"""A plant, the controller and the tuner's learning in virtual time: what runs in the nodes, without the messages.

Stands for what the tuner's code holds on to in a node: the tap, the client of the controller, and the wait.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from foreign_plants.gallery import Exhibit

from fopid_core.model.fopid import Fopid
from fopid_core.model.two_degrees import MeasurementFilter, SetpointWeights
from fopid_core.runtime.controller import ControllerSettings, FopidController
from fopid_core.runtime.settings import Pace
from fopid_ros.tuner.controller_client import RunningDesign
from fopid_ros.tuner.learning.history import EXCITATION, SIGNALS, History
from fopid_ros.tuner.learning.loop_tap import Tick
from fopid_ros.tuner.learning.loop_wait import Stage

TUNED = (
    "gains", "measurement_filter_order", "measurement_filter_time", "setpoint_weight", "derivative_setpoint_weight",
    "control_rate_max", "setpoint_rate_max", "deadband",
)  # fmt: skip


class TooLongError(Exception):
    """The tuner waits for more than it may."""


@dataclass
class Trace:
    """Signals of each tick, lists of equal length; ``true`` is the output without the sensor's faults."""

    time: list[float] = field(default_factory=list)
    setpoint: list[float] = field(default_factory=list)
    true: list[float] = field(default_factory=list)
    control: list[float] = field(default_factory=list)

    def part(self, first: int, last: int | None = None) -> tuple[np.ndarray, ...]:
        """Arrays of the ticks from ``first`` to ``last``."""
        return tuple(np.array(values[first:last]) for values in (self.time, self.setpoint, self.true, self.control))


class VirtualLoop:
    """The closed loop of an exhibit, which begins at rest.

    Parameters
    ----------
    exhibit : Exhibit
    seed : int
        Of the sensor.
    history : float
        What the tuner keeps [s].
    longest : float
        Virtual time after which it is given up [s].
    """

    def __init__(self, exhibit: Exhibit, seed: int = 0, history: float = 600.0, longest: float = math.inf) -> None:
        self.exhibit, self.sample_time, self.longest = exhibit, exhibit.sample_time, longest
        self.plant = exhibit.plant(seed)
        actuator, rest = self.plant.actuator, self.plant.control_at_rest
        self.controller = FopidController(ControllerSettings(
            Fopid(*exhibit.gains, 1.0, 1.0), exhibit.sample_time, safe_control=rest,
            control_min=actuator.low, control_max=actuator.high,
        ))  # fmt: skip
        self.setpoint = self.plant.output(self.plant.state)
        self.controller.set_mode("manual")
        self.controller.step(self.setpoint, self.plant.measurement, manual=rest)
        self.controller.set_mode("auto")
        self.history, self.trace = History(history), Trace()
        self.stages: list[Stage] = []
        self.added = self._taken = 0.0
        self._ticks = 0
        self._hook: Callable[[Tick], None] | None = None
        self.statuses: list[str] = []

    @property
    def time(self) -> float:
        """Since the beginning [s]."""
        return self._ticks * self.sample_time

    def tick(self) -> None:
        """One tick; what the tuner adds is felt at the next."""
        measured, time = self.plant.measurement, self.time
        control = self.controller.step(self.setpoint, measured, feedforward=self.added)
        values = (self.setpoint, measured, control)
        for name, value in zip(SIGNALS, values, strict=True):
            self.history.add(name, time, value)
        trace = self.trace
        for kept, value in zip(
            (trace.time, trace.setpoint, trace.true, trace.control),
            (time, self.setpoint, self.plant.output(self.plant.state), control),
            strict=True,
        ):
            kept.append(value)
        if self._hook is not None:
            self._hook(Tick(time, *values))
        self.plant.step(control, self.sample_time)
        self._ticks += 1

    def run(self, seconds: float) -> int:
        """Let time pass; the number of the first tick."""
        first = self._ticks
        for _ in range(round(seconds / self.sample_time)):
            self.tick()
        return first

    def set(self, **settings: Any) -> None:
        """Change settings of the controller."""
        self.controller.reconfigure(replace(self.controller.settings, **settings))
        self.history.changed = self.history.regained = self.time

    def tuned_settings(self) -> dict[str, Any]:
        """What a tuning may have changed of the controller's settings."""
        settings = self.controller.settings
        return {name: getattr(settings, name) for name in TUNED}

    # The tap.

    def set_tick_hook(self, hook: Callable[[Tick], None] | None) -> None:
        self._hook = hook

    def inject(self, value: float) -> None:
        if value != self.added:
            self.history.add(EXCITATION, self.time, value)
        self.added = value

    def begin_injection(self) -> None:
        self.added = 0.0

    def end_injection(self) -> None:
        self._hook = None
        self.inject(0.0)

    # The controller's client.

    def get(self, *names: str) -> list[Any]:
        settings = self.controller.settings
        known = dict(zip(("kp", "ki", "kd", "lam", "mu"), settings.gains.gains, strict=True), mode="auto")
        return [known[name] if name in known else getattr(settings, name) for name in names]

    def gains(self) -> Fopid:
        return self.controller.settings.gains

    def design(self) -> RunningDesign:
        gains, order, time, proportional, derivative, *pace, deadband = self.tuned_settings().values()
        weights = SetpointWeights(proportional, derivative)
        on_trial = self.controller.settings.on_trial
        return RunningDesign(gains, MeasurementFilter(order, time), weights, Pace(*pace), deadband, on_trial)

    def apply(self, design: RunningDesign, status: str = "", certificate: str = "") -> RunningDesign:
        del certificate  # nobody here shows it
        before = self.design()
        status = status or ("trial" if design.on_trial else "")
        weights, pace = design.weights or before.weights, design.pace or before.pace
        deadband = before.deadband if design.deadband is None else design.deadband
        values = (
            design.gains, design.filter.order, design.filter.time, weights.proportional, weights.derivative,
            pace.control, pace.setpoint, deadband,
        )  # fmt: skip
        self.set(on_trial=status == "trial", **dict(zip(TUNED, values, strict=True)))
        self.statuses.append(status)
        return before

    def hold(self, pace: Pace) -> None:
        self.set(control_rate_max=pace.control, setpoint_rate_max=pace.setpoint)

    def end_trial(self) -> None:
        pass

    def confirm(self, design: RunningDesign) -> None:
        ours = design.is_same_loop(self.design())
        if ours:
            self.controller.reconfigure(replace(self.controller.settings, on_trial=False))
        self.statuses.append("verified" if ours else "not in force")

    # The wait.

    def begin_round(self, name: str, share: tuple[float, float]) -> None:
        pass

    def report(self, stage: Stage) -> None:
        self.stages.append(stage)

    def until(self, done: Callable[[], bool], stage: Callable[[], Stage]) -> None:
        self.stages.append(stage())
        while not done():
            if self.time > self.longest:
                raise TooLongError(f"{stage().phase} after {self.time:g} s")
            self.tick()
            if self._ticks % 50 == 0:
                self.stages.append(stage())
