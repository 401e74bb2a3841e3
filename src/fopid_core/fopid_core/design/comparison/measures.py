"""What one design does, by the exact engine: the columns of the comparison."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from fopid_core.design.comparison.candidates import Candidate
from fopid_core.design.sampled_loop import running
from fopid_core.design.specification import Bounds
from fopid_core.design.time.search_response import ResponseGrid
from fopid_core.design.verification import checks
from fopid_core.errors import InputError
from fopid_core.model.indices import overshoot_pct, rise_time, settling_time, total_variation
from fopid_core.model.loop import Loop
from fopid_core.model.loop_peaks import LoopPeaks
from fopid_core.model.margins import margins
from fopid_core.model.response import Response, step_response
from fopid_core.model.response_indices import response_indices
from fopid_core.model.stability import stability, stable_mask
from fopid_core.runtime.controller import FopidController
from fopid_core.runtime.settings import as_designed

GAINS = np.array([0.5, 0.71, 1.0, 1.41, 2.0])
"""Factors on the loop gain for the spread of the overshoot."""
SPREAD_POINTS = 1024
KICK_TICKS = 32
"""So long the running derivative of a step takes to settle."""


@dataclass(frozen=True)
class Row:
    """A design and what it does; NaN where it is not known or does not exist.

    Attributes
    ----------
    candidate : Candidate
    stable : bool
        By the argument principle.
    iae_setpoint, iae_load : float
        Of unit steps, a load adds to the control.
    ms, mt, noise_gain : float
    overshoot_pct, rise_time, settling_time : float
        Of the setpoint step [%], [s], [s].
    control_peak, total_variation : float
        Of the control after a setpoint step, as the controller runs.
    overshoot_spread_pct : float
        Largest less smallest overshoot for loop gains from half to double [%]; infinite when one of them is unstable.
    delay_margin : float
        [s]
    running_stable : bool or None
    running_ms : float
        Of the sampled, held loop.
    unmet : tuple of str
        Bounds that it breaks.
    """

    candidate: Candidate
    stable: bool = False
    iae_setpoint: float = math.nan
    iae_load: float = math.nan
    ms: float = math.nan
    mt: float = math.nan
    noise_gain: float = math.nan
    overshoot_pct: float = math.nan
    rise_time: float = math.nan
    settling_time: float = math.nan
    control_peak: float = math.nan
    total_variation: float = math.nan
    overshoot_spread_pct: float = math.nan
    delay_margin: float = math.nan
    running_stable: bool | None = None
    running_ms: float = math.nan
    unmet: tuple[str, ...] = ()

    @property
    def is_within(self) -> bool:
        """Whether it is stable, as designed and as it runs, and keeps every bound."""
        return self.stable and self.running_stable is True and not self.unmet


def measured(candidate: Candidate, bounds: Bounds, speed: float) -> Row:
    """The measures of a design.

    Parameters
    ----------
    candidate : Candidate
    bounds : Bounds
        What all designs shall keep; the horizon is that of the steps.
    speed : float
        About the loop's crossover [rad/s].
    """
    loop = candidate.loop
    if loop is None or not stability(loop).stable:
        return Row(candidate, unmet=() if loop is None else ("stability",))
    peaks = LoopPeaks(loop)
    found = margins(loop, peaks, jitter=False)
    nyquist = math.pi / bounds.sample_time
    as_it_runs = running(loop.process, loop.controller, bounds.sample_time, loop.filter, with_margins=False)
    broken = tuple(str(check) for check in checks(loop, bounds, peaks) if not check.holds)
    row = Row(
        candidate, True, ms=found.ms, mt=found.mt, delay_margin=found.delay_margin, running_stable=as_it_runs.stable,
        running_ms=as_it_runs.ms, noise_gain=peaks.noise_gain((0.0, nyquist)).value, unmet=broken,
        overshoot_spread_pct=_overshoot_spread(loop, bounds.horizon, speed),
    )  # fmt: skip
    return _with_steps(row, loop, bounds)


def _with_steps(row: Row, loop: Loop, bounds: Bounds) -> Row:
    try:
        setpoint, load = (step_response(loop, bounds.horizon, source) for source in ("setpoint", "load"))
    except InputError as unknown:
        return Row(**{**vars(row), "unmet": (*row.unmet, f"response: {unknown}")})
    peak, variation = _control(loop, setpoint, bounds.sample_time)
    steps = {
        "iae_setpoint": _iae(setpoint), "iae_load": _iae(load), "overshoot_pct": overshoot_pct(setpoint.output),
        "rise_time": rise_time(setpoint.time, setpoint.output), "control_peak": peak, "total_variation": variation,
        "settling_time": settling_time(setpoint.time, setpoint.output),
    }  # fmt: skip
    return Row(**{**vars(row), **steps})


def _iae(response: Response) -> float:
    return response_indices(response.time, response.error, response.uncertainty)[0].iae


def _control(loop: Loop, response: Response, sample_time: float) -> tuple[float, float]:
    """Peak and total variation after a setpoint step: the first ticks as they run, then the ideal control.

    In the first ticks the derivative of the step is nearly all of it, and the measurement hardly moves; at the very
    first nothing has moved it.
    """
    controller = FopidController(as_designed(loop.controller, sample_time, loop.filter, loop.weights))
    seen = np.interp(sample_time * np.arange(KICK_TICKS), response.time, response.output)
    seen[0] = 0.0
    first = [controller.step(1.0, measurement) for measurement in seen.tolist()]
    later = response.control[response.time >= KICK_TICKS * sample_time]
    control = np.concatenate([[0.0], first, later])
    return float(np.abs(control).max()), total_variation(control)


def _overshoot_spread(loop: Loop, horizon: float, speed: float) -> float:
    weights = loop.weights
    row = np.array([*loop.controller.gains, loop.filter.time, weights.proportional, weights.derivative])
    rows = np.repeat(row[None], len(GAINS), axis=0)
    rows[:, :3] *= GAINS[:, None]
    if not stable_mask(loop.process, rows[:, :5], rows[:, 5], loop.filter.order).all():
        return math.inf
    grid = ResponseGrid(loop.process, horizon, SPREAD_POINTS, speed, loop.filter.order)
    overshoots = np.maximum(-100.0 * grid.errors(rows).min(axis=1), 0.0)
    return float(np.ptp(overshoots))
