"""An experiment on the running loop: wait until it rests, find how far to move it, move it."""

from __future__ import annotations

import math
import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from fopid_core.errors import InputError
from fopid_core.model.fopid import Fopid
from fopid_core.runtime.excitation import Excitation, ExcitationSettings, Kind
from fopid_core.runtime.performance_monitor import LoopPerformance, PerformanceMeter
from fopid_ros.tuner.learning.gain_update import TICKS_MIN, RunningController
from fopid_ros.tuner.learning.loop_tap import LoopTap, Tick
from fopid_ros.tuner.learning.loop_wait import LoopWait, Stage

PRBS_ORDER = 5
EXCITATIONS = {"prbs": (1 << PRBS_ORDER) - 1, "relay": 8, "step": 2}
"""Kinds of experiment, and into how many holds each divides its duration."""
INTEGRAL_TIMES = 20.0
"""Length of the experiment when nobody says it, in integral times of the present controller."""
FIRST_SHARE = 0.1
"""Share of the allowed deviation that the first, careful move is meant to make."""
WANTED_SHARE, MOST_LARGER, PROBES = 0.35, 10.0, 4
"""Share that a step is meant to make, and how that is approached."""
MOST_SHARE = 0.6
"""Share that an experiment aims at that is made because the one before said too little."""
STEADY_STATE_SHARE, SETTLED_SHARE = 0.1, 0.05
"""Share of the allowed deviation, and of the largest one made, that counts as rest."""


@dataclass(frozen=True)
class ExperimentSettings:
    """What is asked of it; zeros are chosen from the running loop.

    Attributes
    ----------
    excitation : str
        ``prbs``, ``relay`` or ``step``.
    amplitude : float
        How far the control is moved.
    deviation_max : float
        Distance of the measurement from the setpoint that ends it.
    duration : float
        [s]
    """

    excitation: Kind = "prbs"
    amplitude: float = 0.0
    deviation_max: float = 0.0
    duration: float = 0.0


@dataclass
class LoopBaseline:
    """The loop before anything is done to it.

    Attributes
    ----------
    controller : RunningController
    setpoint : float
    noise : float
        Standard deviation of the measurement's noise.
    deviation_max : float
        Largest distance from the setpoint that is allowed.
    offset : float
        Of the measurement from the setpoint, on the average.
    drift : float
        By how much that changes from the first half of the time looked at to the second.
    figures : LoopPerformance
    """

    controller: RunningController
    setpoint: float = 0.0
    noise: float = 0.0
    deviation_max: float = 0.0
    figures: LoopPerformance = field(default_factory=lambda: PerformanceMeter(1.0).figures)
    offset: float = 0.0
    drift: float = 0.0

    @property
    def at_steady_state(self) -> bool:
        """Whether the measurement stays near the setpoint, and does not only pass it."""
        return max(abs(self.offset), abs(self.drift)) <= STEADY_STATE_SHARE * self.deviation_max


def integral_time(gains: Fopid) -> float:
    """(kp/ki)^(1/lam), the time scale that whoever chose these gains had in mind [s]; NaN where there is none."""
    if not (gains.kp and gains.ki and gains.lam):
        return math.nan
    return float(abs(gains.kp / gains.ki) ** (1.0 / gains.lam))


class ClosedLoopExperiment:
    """Moves the loop within bounds, through what is added to its control.

    Parameters
    ----------
    tap : LoopTap
    wait : LoopWait
    loop : LoopBaseline
        What the controller says of itself; the rest is filled in by ``measure``.
    wanted : ExperimentSettings

    Attributes
    ----------
    duration : float
        How long one experiment takes [s].
    """

    def __init__(self, tap: LoopTap, wait: LoopWait, loop: LoopBaseline, wanted: ExperimentSettings) -> None:
        self.loop = loop
        self._tap, self._wait, self._wanted = tap, wait, wanted
        self._amplitude = self._peak = 0.0
        self.duration = self._chosen_duration()

    def _chosen_duration(self) -> float:
        """Of the experiment [s]."""
        duration = self._wanted.duration or INTEGRAL_TIMES * integral_time(self.loop.controller.gains)
        if not math.isfinite(duration):
            raise InputError("duration = 0; allowed: above 0 s, since the present gains show no time scale")
        return max(duration, 10 * TICKS_MIN * self.loop.controller.sample_time)

    def measure(self) -> None:
        """The loop as it is, once it rests: where, and how noisy it is."""
        loop, duration = self.loop, self.duration
        window = max(TICKS_MIN * loop.controller.sample_time, 0.05 * duration)
        ticks: deque[Tick] = deque()
        begun: list[float] = []

        def hook(tick: Tick) -> None:
            begun.append(tick.time) if not begun else None
            ticks.append(tick)
            while tick.time - ticks[0].time > window:
                ticks.popleft()

        def measured() -> bool:
            now = list(ticks)
            if not now or now[-1].time - begun[0] < window:
                return False
            self._measure_baseline(now)
            return loop.at_steady_state or now[-1].time - begun[0] > duration

        self._tap.set_tick_hook(hook)
        self._wait.until(
            measured, lambda: Stage("measuring", 0.0, deviation=loop.offset, message="waiting until it rests")
        )
        if not loop.at_steady_state:
            off = (
                f"measurement {loop.offset:+.4g} off the setpoint, drifting by {loop.drift:+.4g}, for {duration:.3g} s"
            )
            raise InputError(f"{off}; allowed: a loop at rest, {STEADY_STATE_SHARE * loop.deviation_max:.4g} at most")

    def _measure_baseline(self, ticks: list[Tick]) -> None:
        """What the last ticks show of the loop."""
        loop = self.loop
        measured = np.array([tick.measurement for tick in ticks])
        meter = PerformanceMeter(loop.controller.sample_time)
        for tick in ticks:
            meter.step(tick.setpoint, tick.measurement, loop.controller.saturated(tick.control))
        loop.figures = meter.figures
        loop.setpoint = ticks[-1].setpoint
        loop.offset = float(measured.mean()) - loop.setpoint
        first, second = np.array_split(measured, 2)
        loop.drift = float(second.mean() - first.mean())
        loop.noise = float(np.std(np.diff(measured)) / math.sqrt(2.0))
        loop.deviation_max = self._wanted.deviation_max or max(0.1 * abs(loop.setpoint), 20.0 * loop.noise)
        if not loop.deviation_max > 0.0:
            raise InputError("deviation_max = 0; allowed: above 0, since setpoint and noise are 0 and give no scale")

    def excite(self) -> str:
        """Make the experiment, with larger moves than the last one if that moved too little.

        Returns
        -------
        str
            Why it was stopped; empty when it came to its end.
        """
        if self._wanted.amplitude:
            self._amplitude = self._wanted.amplitude
        elif not self._amplitude:
            ended = self._probe()
            if ended:
                return ended
        else:
            self._amplitude *= min(max(MOST_SHARE * self.loop.deviation_max / self._response_amplitude(), 1.0), 3.0)
        excitation = Excitation(self._settings(self._wanted.excitation, self._amplitude, self.duration))
        self._run_excitation(excitation, lambda: 0.1 + 0.5 * excitation.progress)
        return "" if excitation.completed else excitation.reason

    def _response_amplitude(self) -> float:
        """How far the last move took the measurement, noise apart."""
        return max(self._peak - 3.0 * self.loop.noise, 1e-300)

    def _settings(self, kind: str, amplitude: float, duration: float) -> ExcitationSettings:
        loop = self.loop
        hold = max(duration / EXCITATIONS[kind], 3.0 * loop.controller.sample_time)
        return ExcitationSettings(
            kind=kind, amplitude=math.copysign(amplitude, loop.controller.gains.kp or 1.0), acts_on="control",
            low=loop.setpoint - loop.deviation_max, high=loop.setpoint + loop.deviation_max,
            hold=hold, order=PRBS_ORDER, hysteresis=3.0 * loop.noise,
        )  # fmt: skip

    def _probe(self) -> str:
        """Find the amplitude that moves the measurement by a good part of what is allowed, from below."""
        loop, gains = self.loop, self.loop.controller.gains
        if not (gains.kp or math.isfinite(loop.controller.control_max - loop.controller.control_min)):
            raise InputError("amplitude = 0; allowed: above 0, since kp = 0 and no limits of the control give a scale")
        sizes = [FIRST_SHARE * loop.deviation_max * abs(gains.kp)] if gains.kp else []
        amplitude = min([*sizes, 0.05 * (loop.controller.control_max - loop.controller.control_min)])
        for _ in range(PROBES):
            excitation = Excitation(self._settings("step", amplitude, self.duration / 6.0))
            self._run_excitation(excitation, lambda: 0.05)
            if not excitation.completed:
                return excitation.reason
            larger = WANTED_SHARE * loop.deviation_max / self._response_amplitude()
            if larger <= MOST_LARGER:
                self._amplitude = amplitude * larger
                return ""
            amplitude *= MOST_LARGER
        moved = f"the measurement moved by no more than {self._peak:.3g} (noise {loop.noise:.3g})"
        return f"{moved} when the control was moved by {amplitude / MOST_LARGER:.3g}: is the loop closed?"

    def _run_excitation(self, excitation: Excitation, progress: Callable[[], float]) -> None:
        """Run an experiment tick by tick, at the pace of the controller."""
        loop, ended, last = self.loop, threading.Event(), [0.0]
        self._peak = 0.0

        def hook(tick: Tick) -> None:
            if ended.is_set():
                return
            added = excitation.step(loop.setpoint, tick.measurement, tick.control, tick.time)
            self._peak = max(self._peak, abs(tick.measurement - loop.setpoint - loop.offset))
            if tick.setpoint != loop.setpoint:
                excitation.cancel()
                excitation.reason = f"the setpoint was changed from {loop.setpoint:g} to {tick.setpoint:g}"
                added = 0.0
            if added != last[0] or excitation.finished:
                self._tap.inject(added)
                last[0] = added
            if excitation.finished:
                ended.set()

        self._tap.set_tick_hook(hook)
        whole = excitation.settings.duration
        self._wait.until(ended.is_set, lambda: Stage(
            "exciting", progress(), (1.0 - excitation.progress) * whole,
            self._tap.history.newest("measurement") - loop.setpoint,
            message=f"{excitation.settings.kind} of {excitation.settings.amplitude:.3g} for {whole:.3g} s",
        ))  # fmt: skip

    def residual_transient(self) -> float:
        """What may still be left of the experiment when the new gains come."""
        return max(3.0 * self.loop.noise, SETTLED_SHARE * self._peak)
