"""How slow an actuator may be for all that a record shows, and what one as slow makes of a loop in large moves.

The moves of an experiment are small, and an actuator that is slow shows that in large ones: there it lags behind by up
to a right angle, whatever margins the loop has, and a loop that is fast for it swings from limit to limit for ever.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from scipy.signal import fftconvolve

from fopid_core.design.flaw_trial import ticks_until_rest
from fopid_core.design.identification.quality import correlation_time
from fopid_core.design.identification.record import Record
from fopid_core.model.arrays import Floats
from fopid_core.model.loop import Loop
from fopid_core.model.margins import margins
from fopid_core.model.process import Process
from fopid_core.model.stability import process_stability
from fopid_core.runtime.controller import FopidController
from fopid_core.runtime.convolved_plant import plant_of
from fopid_core.runtime.plant import PlantSettings
from fopid_core.runtime.settings import as_designed

RATES = 24
"""So many are tried, from what takes half a tick for all that the control moved to what takes half the record."""
SHIFTS = 7
"""A delay learnt in small moves holds what a slow actuator takes for those: so many shorter ones are tried as well."""
SPEAKS, EXCLUDED = 8.0, 15.0
"""A record speaks for a slow actuator, and a rate is excluded, where twice the logarithm of the likelihood is less by
so much than for the best."""
MOVE_SHARE = 0.1
"""The moves that are tried take this share of the control's range,"""
KICK_SHARE = 0.3
"""and that of the setpoint is not answered with more than this share of it, at the crossover of what runs."""
WORSE = 1.25
"""By how much more error than what runs new gains may leave after such a move."""


def slewed(control: Floats, most: float) -> Floats:
    """Where an actuator is that moves by so much in a tick at most.

    Examples
    --------
    >>> slewed(np.array([0.0, 3.0, 3.0, 1.0]), 2.0)
    array([0., 2., 3., 1.])
    """
    at, felt = float(control[0]), np.empty_like(control)
    for tick, wanted in enumerate(control.tolist()):
        at += min(max(wanted - at, -most), most)
        felt[tick] = at
    return felt


def slowest_rate(record: Record, process: Process) -> float:
    """The smallest rate of an actuator that a record does not exclude [1/s], where it speaks for a slow one.

    Parameters
    ----------
    record : Record
        From rest on, with moves as large as may be.
    process : Process
        As it was learnt, perhaps from smaller ones.

    Returns
    -------
    float
        Infinite where one that jumps explains the record as well; and where nothing is known: where one that takes half
        the record for its moves explains it as well, since the model lacks something else then, and where the process
        runs away by itself.
    """
    if process_stability(process).unstable_poles:
        return math.inf
    every = record.sample_time
    count = round(record.span / every) + 1
    ticks = np.searchsorted(record.time, (np.arange(count) + 0.25) * every, side="right") - 1
    control, measurement = record.control[ticks], record.measurement[ticks]
    answer = _step_answer(process, every, count)
    moved = float(np.ptp(control))
    delay = round(process.delay / every)
    shifts = sorted({round(share * delay) for share in np.linspace(0.0, 1.0, SHIFTS)})
    rates = moved / np.geomspace(0.5 * every, 0.5 * record.span, RATES)
    left: dict[float, Floats] = {}
    for rate in rates.tolist():
        left[rate] = _left(slewed(control, rate * every), measurement, answer, shifts)
    best = min(left.values(), key=lambda residual: float(residual @ residual))
    independent = best.size / correlation_time(best)
    least = float(best @ best)

    def lost(residual: Floats) -> float:
        """Twice the logarithm of the likelihood, less than for the best."""
        return independent * math.log(max(float(residual @ residual), 1e-300) / max(least, 1e-300))

    if lost(left[max(left)]) <= SPEAKS or lost(left[min(left)]) <= EXCLUDED:
        return math.inf
    return min(rate for rate, residual in left.items() if lost(residual) <= EXCLUDED)


def _step_answer(process: Process, every: float, count: int) -> Floats:
    """The response to a unit step, at the tick of the step and at those that follow."""
    plant = plant_of(PlantSettings(process, every, delay_model="exact"))
    answer = np.empty(count)
    for tick in range(count):
        answer[tick] = plant.measurement
        plant.step(1.0)
    return answer


def _left(felt: Floats, measurement: Floats, answer: Floats, shifts: list[int]) -> Floats:
    """What the process leaves of a measurement beside a drift, with the delay that fits best.

    It may be a little wrong: in its gain, and by its answer's slope and integral, in its quick and its slow end. What a
    linear process explains is no sign of a slow actuator.
    """
    count = measurement.size
    moves = np.diff(felt, prepend=felt[:1])
    beside = [np.ones(count), np.linspace(-1.0, 1.0, count)]
    lefts = []
    for shift in shifts:
        earlier = np.append(answer[shift:], np.full(shift, answer[-1]))
        moved = fftconvolve(moves, earlier)[:count]
        columns = np.column_stack([moved, np.gradient(moved), np.cumsum(moved), *beside])
        columns /= np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
        lefts.append(measurement - columns @ np.linalg.lstsq(columns, measurement, rcond=None)[0])
    return min(lefts, key=lambda residual: float(residual @ residual))


class LargeMoves:
    """A loop about an actuator of limited rate, after a step of the setpoint and one of the load that are large for it.

    Parameters
    ----------
    process : Process
    sample_time : float
        Of the controller [s].
    low, high : float
        Limits of the control, from where it rests.
    rate : float
        Of the actuator [1/s].
    running : Loop
        What runs.

    Examples
    --------
    >>> from fopid_core.model.fopid import Fopid
    >>> process = Process.parse("1/((7s+1)(0.3s+1))")
    >>> moves = LargeMoves(process, 0.1, -50.0, 50.0, 7.0, Loop(process, Fopid(kp=4.0, ki=0.6)))
    >>> moves.refusal(Loop(process, Fopid(kp=4.0, ki=0.5)))
    ''
    >>> moves.refusal(Loop(process, Fopid(kp=17.0, ki=15.0, kd=1.5)))
    'with an actuator that takes 1.4 s for a tenth of the range a setpoint step of 7.2 leaves 13 times the error'
    """

    def __init__(
        self, process: Process, sample_time: float, low: float, high: float, rate: float, running: Loop
    ) -> None:
        self._process, self._sample_time, self._low, self._high, self._rate = process, sample_time, low, high, rate
        self._load = MOVE_SHARE * (high - low)
        self._ticks = ticks_until_rest(running, sample_time)
        held = self._load * abs(complex(process(2.0j * math.pi / (self._ticks * sample_time))))
        crossover = margins(running).crossover
        answer = abs(complex(running.controller(1j * crossover))) if math.isfinite(crossover) else 0.0
        self._setpoint = min(held, KICK_SHARE * (high - low) / answer) if answer else held
        self._before = [self._error(running, *move) for move in self._moves]

    @property
    def _moves(self) -> list[tuple[float, float]]:
        """Setpoint and load of each."""
        return [(self._setpoint, 0.0), (0.0, self._load)]

    def refusal(self, loop: Loop) -> str:
        """Why gains may not be used; empty where they leave hardly more error than what runs."""
        for move, before in zip(self._moves, self._before, strict=True):
            error = self._error(loop, *move)
            if error > WORSE * before:
                step = f"a setpoint step of {move[0]:.2g}" if move[0] else f"a load of {move[1]:.2g}"
                slow = f"with an actuator that takes {self._load / self._rate:.2g} s for a tenth of the range"
                return f"{slow} {step} leaves {error / before:.2g} times the error"
        return ""

    def _error(self, loop: Loop, setpoint: float, load: float) -> float:
        """Sum of the absolute error."""
        settings = as_designed(loop.controller, self._sample_time, loop.filter, loop.weights)
        controller = FopidController(replace(settings, control_min=self._low, control_max=self._high))
        plant = plant_of(PlantSettings(self._process, self._sample_time, delay_model="exact"))
        most, at, total = self._rate * self._sample_time, 0.0, 0.0
        for _ in range(self._ticks):
            control = controller.step(setpoint, plant.measurement)
            at += min(max(control - at, -most), most)
            plant.step(at, load)
            total += abs(setpoint - plant.measurement)
            if not total < 1e90:
                return math.inf
        return total
