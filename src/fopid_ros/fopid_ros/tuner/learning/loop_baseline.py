"""The running loop before anything is done to it: where it rests, how noisy it is, how far it may be moved."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike

from fopid_core.design.identification.noise import (
    FAR_OFF,
    FEW,
    MAD,
    SensorNoise,
    noise_at_rest,
    outlying_power,
    reported_step,
    white_level,
)
from fopid_core.errors import InputError
from fopid_core.model.arrays import Booleans, Floats
from fopid_core.runtime.performance_monitor import LoopPerformance, PerformanceMeter
from fopid_ros.tuner.learning.loop_tap import Tick
from fopid_ros.tuner.learning.running_controller import RunningController

STEADY_STATE_SHARE, RESTLESS_SHARE = 0.1, 0.2
"""Share of the allowed deviation up to which an offset or a drift, and swings to either side, count as rest."""
NOISES, REACH_SHARE, TRAVEL_SHARE = 40.0, 0.005, 0.1
"""The allowed deviation when nobody says it: so many times the noise, that share of the proportional band (the error
that moves the control through its whole range), that share of the setpoint's moves."""
BUMP_SHARE, MOST_WIDER = 0.05, 10.0
"""What people bump a loop by, as a share of the proportional band, and how much more than the allowed deviation that
may be: allowed once an experiment has said too little."""
UNREST, MOST_UNREST = 1.5, 4.0
"""What a measurement does at rest is more than white noise where it spreads by so many times that, or has a spectrum
of its own; it counts as so many times the white noise at most."""
LEAST_MOVE_SHARE = 0.005
"""Of the allowed deviation, that counts as noise where there is less: simulated sensors have none."""
MOST_HEARD = 200
"""So many ticks at rest tell the noise, or as many as are looked at for rest: in more are drifts and loads as well."""
FAR_LONGER = 2
"""So many times as many samples tell more of a sensor than the fewer."""
STILL_SHARE = 0.1
"""Of the ticks at rest in a row, that a measurement which moves may stand still for."""
SMALL_STEP = 0.25
"""Of the setpoint, as a share of the allowed deviation, that is not to take the control to a limit or past its rate."""


@dataclass
class LoopBaseline:
    """What the ticks of a loop at rest show.

    Attributes
    ----------
    controller : RunningController
    setpoint, control : float
    noise : float
        Standard deviation of the measurement's noise, quantisation included.
    unrest : float
        Standard deviation of all that the measurement does at rest, once that is known; no less than the noise.
    deviation_max : float
        Largest distance from the setpoint that is allowed.
    offset : float
        Of the measurement from the setpoint, on the average.
    drift : float
        By how much that changes from the first half of the time looked at to the second.
    swing, swing_about_drift : float
        How far the measurement, noise averaged out, goes to either side; and about its drift.
    spread : float
        Standard deviation of the measurement about its drift.
    control_spread : float
        And that of the control.
    coloured : SensorNoise or None
        That noise with its spectrum, where it is not white.
    figures : LoopPerformance
    deviation_least, deviation_most : float
        What is allowed at least, and at most, where nobody says it.
    spikes : int
        So many samples at rest were far off all others, where these were few.
    samples : int
        From so many the noise is known.
    outlying : float
        Root mean square, over a far longer time, of what is far off before and after it.
    longest_still : int
        For so many ticks in a row the measurement stood still; 0 where it hardly moved at all.
    moves : float
        At what share of the ticks it moved.
    """

    controller: RunningController
    setpoint: float = 0.0
    control: float = 0.0
    noise: float = 0.0
    unrest: float = 0.0
    deviation_max: float = 0.0
    offset: float = 0.0
    drift: float = 0.0
    swing: float = 0.0
    swing_about_drift: float = 0.0
    coloured: SensorNoise | None = None
    spread: float = 0.0
    control_spread: float = 0.0
    figures: LoopPerformance = field(default_factory=lambda: PerformanceMeter(1.0).figures)
    deviation_least: float = 0.0
    deviation_most: float = math.inf
    spikes: int = 0
    samples: int = 0
    outlying: float = 0.0
    longest_still: int = 0
    moves: float = 0.0

    def measure(self, ticks: Sequence[Tick], deviation_max: float, travel: float) -> None:
        """Take what a stretch of ticks shows.

        Parameters
        ----------
        ticks : sequence of Tick
        deviation_max : float
            As it was asked for; 0 chooses it.
        travel : float
            How far the setpoint has moved as long as it is remembered.
        """
        measured = np.array([tick.measurement for tick in ticks])
        near = usual(measured)
        meter = PerformanceMeter(self.controller.sample_time)
        for tick in ticks:
            meter.step(tick.setpoint, tick.measurement, self.controller.saturated(tick.control))
        self.figures, self.setpoint = meter.figures, ticks[-1].setpoint
        moved = np.array([tick.control for tick in ticks])
        self.control, self.control_spread = float(moved.mean()), spread_about_drift(moved)
        self.offset = float(near.mean()) - self.setpoint
        first, second = np.array_split(near, 2)
        self.drift = float(second.mean() - first.mean())
        self.swing = half_range(measured)
        self.swing_about_drift = half_range(about_drift(measured))
        self.spread = spread_about_drift(measured)
        self._take_noise(measured)
        self.deviation_max = deviation_max or self._chosen_deviation(travel)

    def _take_noise(self, measured: Floats) -> None:
        near = usual(measured)
        self.samples, self.spikes = measured.size, int(_far_off(measured).sum())
        self.noise = max(float(white_level(near)), reported_step(near) / math.sqrt(12.0))
        self.unrest = self.noise
        self.coloured = noise_at_rest(near, self.controller.sample_time)
        self.longest_still, self.moves = _longest_still(near), float(np.mean(np.diff(near) != 0.0))

    def listen(self, unmoved: Floats, deviation_max: float, travel: float) -> None:
        """Once it rests: take its noise from all of the rest, and tell more than noise from an answer, too.

        A hum, waves, samples that are far off now and then, a small limit cycle or a sensor that reads seldom show in
        more ticks than are needed to see a loop at rest.

        Parameters
        ----------
        unmoved : ndarray, shape (n,)
            The measurement up to now, while nothing was moved; its end is what ``measure`` has seen.
        deviation_max, travel : float
            As of ``measure``.
        """
        before = unmoved[-max(MOST_HEARD, self.samples) :]
        length, since = self.samples, max(before.size - self.samples, 0)
        while since > 0:
            begin = max(since - length, 0)
            if not self._rests(before[begin : begin + length]):
                break
            since = begin
        if before.size >= length:  # else the setpoint was moved meanwhile
            self._take_noise(before[since:])
        self.outlying = math.sqrt(max(outlying_power(unmoved) - outlying_power(usual(before[since:])), 0.0))
        if self.coloured is not None or self.spread > UNREST * self.noise:
            self.unrest = min(max(self.noise, self.spread), MOST_UNREST * self.noise)
        self.deviation_max = deviation_max or self._chosen_deviation(travel)

    @property
    def on_its_way(self) -> bool:
        """Whether it is further from its setpoint than counts as rest where nobody says what is allowed."""
        return abs(self.offset) > STEADY_STATE_SHARE * NOISES * self.least_move

    def _rests(self, measured: Floats) -> bool:
        """Whether it stays about where it is now."""
        off = abs(float(usual(measured).mean()) - self.setpoint - self.offset)
        near = off <= STEADY_STATE_SHARE * self.deviation_max
        return near and half_range(measured) <= RESTLESS_SHARE * self.deviation_max

    @property
    def room(self) -> float:
        """How far the control is from the nearer of its limits, where it rests."""
        low, high = self.controller.room(self.control)
        return max(min(-low, high), 0.0)

    def check_amplitude(self, amplitude: float) -> None:
        """An experiment must leave the control within its limits.

        Raises
        ------
        InputError
        """
        if amplitude > self.room:
            limits = f"limits {self.controller.control_min:.4g} to {self.controller.control_max:.4g}"
            near = f"as far as the control, {self.control:.4g} at rest, is from its {limits}"
            raise InputError(f"amplitude = {amplitude:.4g}; allowed: up to {self.room:.4g}, {near}")

    @property
    def _reach(self) -> float:
        """The proportional band; 0 where there is none."""
        controller = self.controller
        reach = controller.control_range / abs(controller.gains.kp) if controller.gains.kp else math.inf
        return reach if math.isfinite(reach) else 0.0

    @property
    def bump(self) -> float:
        """The deviation that people bump a loop by, but not far more than what is allowed."""
        return min(BUMP_SHARE * self._reach, MOST_WIDER * self.deviation_max)

    def allow_a_bump(self) -> None:
        """Allow that deviation, where it is more."""
        self.deviation_max = max(self.bump, self.deviation_max)

    def _chosen_deviation(self, travel: float) -> float:
        """From what the signals do, never from how far they are from 0."""
        scales = [NOISES * self.unrest, REACH_SHARE * self._reach]
        chosen = max(*scales, self.deviation_least) or TRAVEL_SHARE * travel
        if not chosen > 0.0:
            scale = "neither noise nor limits of the control nor a move of the setpoint give a scale"
            raise InputError(f"deviation_max = 0; allowed: above 0, since {scale}")
        return min(chosen, self.deviation_most)

    @property
    def sensor(self) -> SensorNoise:
        """What a design is to expect of the measurement's noise."""
        heard = self.coloured or SensorNoise(self.noise, 0.0)
        return replace(heard, level=math.hypot(heard.level, self.outlying)) if self.outlying else heard

    @property
    def by_itself(self) -> str:
        """What the measurement does by itself, in words."""
        told = f"noise {self.noise:.3g}, by itself it swings by {self.swing:.3g}"
        few = f"{self.spikes} of its samples at rest are far off the others"
        return f"{told}, and {few}: does the sensor drop out?" if self.spikes else told

    @property
    def least_move(self) -> float:
        """The smallest move of the measurement that can be told from what it does by itself."""
        return max(self.unrest, LEAST_MOVE_SHARE * self.deviation_max)

    @property
    def control_peak(self) -> float:
        """How far a unit step of the setpoint may take the control, so that small steps keep within its limits."""
        controller = self.controller
        room = min(controller.control_max - self.control, self.control - controller.control_min)
        return max(room, 0.0) / (SMALL_STEP * self.deviation_max) if room > 0.0 else math.inf

    @property
    def control_rate(self) -> float:
        """How fast such a step may move the control for each unit of it, by the controller's limit on that [1/s]."""
        return self.controller.pace.control / (SMALL_STEP * self.deviation_max)

    @property
    def at_steady_state(self) -> bool:
        """Whether the measurement stays near the setpoint, and neither passes it nor swings about it."""
        steady = max(abs(self.offset), abs(self.drift)) <= STEADY_STATE_SHARE * self.deviation_max
        return steady and self.swing <= RESTLESS_SHARE * self.deviation_max

    def why_not_at_rest(self, waited: float) -> str:
        """Why it is not at rest after that time [s], and what would be."""
        most, share = STEADY_STATE_SHARE * self.deviation_max, "tenth"
        told, until = f"measurement {self.offset:+.4g} off the setpoint, drifting by {self.drift:+.4g}", "wait, or "
        if (
            self.swing_about_drift > RESTLESS_SHARE * self.deviation_max
            or max(abs(self.offset), abs(self.drift)) <= most
        ):
            most, share = RESTLESS_SHARE * self.deviation_max, "fifth"
            told, until = f"measurement swings by {self.swing:.4g} to either side: a limit cycle or a disturbance", ""
        enough = max(self.swing / RESTLESS_SHARE, max(abs(self.offset), abs(self.drift)) / STEADY_STATE_SHARE)
        advice = f"; {until}a deviation_max of {1.1 * enough:.2g}, if the plant bears that, lets it begin"
        rest = f"a loop at rest, {most:.4g} at most (a {share} of the {self.deviation_max:.4g} of deviation_max)"
        return f"{told}, for {waited:.3g} s; allowed: {rest}{advice}"


def quieter(one: LoopBaseline, other: LoopBaseline) -> LoopBaseline:
    """Of a loop looked at twice, that which tells of its sensor: the quieter one, unless it was heard far more briefly.

    A livelier loop answers the noise, which looks like more of it; what is far off now and then is missed in little.
    """
    quiet, loud = sorted((one, other), key=lambda loop: loop.sensor.level)
    return loud if loud.samples >= FAR_LONGER * quiet.samples else quiet


def _far_off(measured: Floats) -> Booleans:
    """Which values are far off the others; none where these are no few, or the others do not move."""
    off = np.abs(measured - np.median(measured))
    far = np.asarray(off > FAR_OFF * MAD * np.median(off)) & bool(np.median(off))
    return far & bool(far.sum() <= FEW * measured.size)


def _longest_still(measured: Floats) -> int:
    """For how many ticks in a row a measurement stood still; 0 where it hardly moved at all."""
    moved = np.flatnonzero(np.diff(measured))
    longest = int(np.diff(moved, prepend=-1, append=measured.size - 1).max())
    return longest if longest <= STILL_SHARE * measured.size else 0


def usual(measured: ArrayLike) -> Floats:
    """A measurement with the few of its values that are far off the others replaced by those about them."""
    values = np.asarray(measured, dtype=float)
    near = np.flatnonzero(~_far_off(values))
    return np.asarray(np.interp(np.arange(values.size), near, values[near]))


def half_range(measured: ArrayLike) -> float:
    """How far a measurement usually goes to either side, noise averaged out over a tenth of it."""
    return 0.5 * float(np.ptp([part.mean() for part in np.array_split(usual(measured), 10)]))


def about_drift(measured: ArrayLike) -> Floats:
    """What a measurement usually does about a straight line."""
    values = usual(measured)
    instants = np.arange(values.size)
    return np.asarray(values - np.polynomial.Polynomial.fit(instants, values, 1)(instants))


def spread_about_drift(measured: ArrayLike) -> float:
    """Its standard deviation."""
    return float(np.std(about_drift(measured)))
