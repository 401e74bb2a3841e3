"""What a design does on the process itself, whatever it was made on, and which of the bounds it breaks.

The one place where bounds are checked, for all methods of tuning: by the exact peaks of the loop (``loop_peaks``), not
by the grids on which the design was sought.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from fopid_core.design.control_peak import first_control, open_control
from fopid_core.design.specification import Achieved, Bound, Bounds
from fopid_core.errors import InputError
from fopid_core.model.arrays import Floats
from fopid_core.model.loop import Loop
from fopid_core.model.loop_peaks import LoopPeaks
from fopid_core.model.margins import margins
from fopid_core.model.noise_power import noise_rms
from fopid_core.model.response import Response, step_response

EXACT = 1e-6
"""Relative error of a checked value, and so how far above its bound it may be."""
EXACT_DB = 20.0 * EXACT / math.log(10.0)
"""The same in dB."""
SMOOTH_TICKS = 4
"""Ticks after which the running controller's control is that of the ideal one; before that its first one is larger."""
_ROUNDING = 1e-9  # of instants, over the delay


def achieved(
    loop: Loop, t_max: Bound | None = None, s_max: Bound | None = None, sample_time: float = 0.0, density: float = 0.0
) -> Achieved:
    """Margins and sensitivities of a loop, and what it does on the bands of the bounds.

    With the sample time [s] of its controller also what noise of the measurement does to the control, with its power
    spectral density [unit^2/Hz] in figures.

    Examples
    --------
    >>> from fopid_core.model.fopid import Fopid
    >>> from fopid_core.model.process import Process
    >>> round(achieved(Loop(Process.parse("1/(s+1)^3"), Fopid(kp=2.0))).gain_margin_db, 3)
    12.041
    """
    found = margins(loop)
    nyquist = math.pi / sample_time if sample_time else math.inf
    return Achieved(
        phase_margin=found.phase_margin,
        crossover=found.crossover,
        phase_slope=found.phase_slope,
        gain_margin_db=20.0 * math.log10(found.gain_margin) if found.gain_margin > 0.0 else -math.inf,
        delay_margin=found.delay_margin,
        ms=found.ms,
        mt=found.mt,
        t_db=math.nan if t_max is None else largest_t_db(loop, t_max),
        s_db=math.nan if s_max is None else largest_s_db(loop, s_max),
        noise_gain=LoopPeaks(loop).noise_gain((0.0, nyquist)).value if sample_time else math.nan,
        noise_rms=noise_rms(loop, density, nyquist) if density and sample_time else math.nan,
    )


def largest_t_db(loop: Loop, bound: Bound) -> float:
    """The largest |T| on the band of a bound, from its frequency on [dB]."""
    return _db(LoopPeaks(loop).complementary((bound.frequency, math.inf)).value)


def largest_s_db(loop: Loop, bound: Bound) -> float:
    """The largest |S| on the band of a bound, up to its frequency [dB]."""
    return _db(LoopPeaks(loop).sensitivity((0.0, bound.frequency)).value)


@dataclass(frozen=True)
class Check:
    """A bound and the exact value of what it is on.

    Attributes
    ----------
    name : str
        What is bounded.
    asked : str
        The bound in words.
    bound, value : float
        The value is NaN where it is not known.
    tolerance : float
        How far the value may be above the bound: its error.
    unit : str
        Of the value.
    reason : str
        Why it is not known.
    """

    name: str
    asked: str
    bound: float
    value: float
    tolerance: float
    unit: str = ""
    reason: str = "the loop is too close to the border of stability"

    @property
    def holds(self) -> bool:
        """Whether the bound is kept for certain."""
        return self.value <= self.bound + self.tolerance

    def __str__(self) -> str:
        if math.isnan(self.value):
            return f"{self.asked}: not known, {self.reason}"
        digits = next((n for n in range(4, 10) if f"{self.value:.{n}g}" != f"{self.bound:.{n}g}"), 10)
        return f"{self.asked}: {self.value:.{digits}g}{self.unit} on the process itself"


def checks(loop: Loop, bounds: Bounds, peaks: LoopPeaks | None = None) -> tuple[Check, ...]:
    """Every bound that was asked for, against the exact value; quicker from the loop's peaks where somebody has them.

    Examples
    --------
    >>> from fopid_core.model.fopid import Fopid
    >>> from fopid_core.model.process import Process
    >>> (check,) = checks(Loop(Process.parse("1/(s+1)^3"), Fopid(kp=2.0)), Bounds(ms_max=1.5))
    >>> check.holds, str(check)
    (False, 'max |S| <= 1.5: 1.667 on the process itself')
    """
    return tuple(_checks(loop, bounds, peaks or LoopPeaks(loop)))


def _checks(loop: Loop, bounds: Bounds, peaks: LoopPeaks) -> Iterator[Check]:
    if bounds.t_max is not None:
        yield _in_db("|T|", bounds.t_max, largest_t_db(loop, bounds.t_max))
    if bounds.s_max is not None:
        yield _in_db("|S|", bounds.s_max, largest_s_db(loop, bounds.s_max))
    if math.isfinite(bounds.ms_max):
        yield _peak("max |S|", bounds.ms_max, peaks.sensitivity().value)
    if math.isfinite(bounds.mt_max):
        yield _peak("max |T|", bounds.mt_max, peaks.complementary().value)
    if math.isfinite(bounds.noise_max):
        nyquist = math.pi / bounds.sample_time
        yield _peak("noise gain", bounds.noise_max, peaks.noise_gain((0.0, nyquist)).value)
    if bounds.noise_density and math.isfinite(bounds.noise_rms_max):
        rms = noise_rms(loop, bounds.noise_density, math.pi / bounds.sample_time)
        yield _peak("control from noise", bounds.noise_rms_max, rms)
    if math.isfinite(bounds.u_max):
        yield _control(loop, bounds)
    if math.isfinite(bounds.rate_max):
        yield _rate(loop, bounds)


def _peak(name: str, bound: float, value: float) -> Check:
    return Check(name, f"{name} <= {bound:g}", bound, value, EXACT * bound)


def _in_db(name: str, bound: Bound, db: float) -> Check:
    return Check(name, f"{name} <= {bound}", bound.db, db, EXACT_DB, " dB")


def _control(loop: Loop, bounds: Bounds) -> Check:
    """The first control of the running controller is exact; the rest is that of the ideal one, as exact as that is."""
    asked = f"control peak <= {bounds.u_max:g}"
    value = _first_control(loop, bounds)
    error, reason = EXACT * bounds.u_max, ""
    if bounds.horizon > SMOOTH_TICKS * bounds.sample_time and value <= bounds.u_max:
        try:
            response = step_response(loop, bounds.horizon)
        except InputError as refusal:
            return Check("control peak", asked, bounds.u_max, math.nan, error, reason=str(refusal))
        later = _running_size(response, loop, bounds.sample_time)
        value = max(value, float(later.max(initial=0.0)), _at_the_end_of_the_delay(loop, bounds))
        error = max(error, response.control_accuracy * bounds.u_max)
    return Check("control peak", asked, bounds.u_max, value, error, reason=reason)


def _running_size(response: Response, loop: Loop, sample_time: float) -> Floats:
    """How large the running controller's control is at most, after its first ticks.

    That of the ideal one, except just after each delay: there the first kick comes back, and the ideal control may be
    infinite. The running one adds to what it was before no more than its kick for so much change of the measurement.
    """
    size, delay, smooth = np.abs(response.control), loop.process.delay, SMOOTH_TICKS * sample_time
    if delay > 2.0 * smooth and loop.controller.kd:
        turn = np.floor_divide(response.time + _ROUNDING * delay, delay)
        for first in np.flatnonzero(np.diff(turn) > 0.0) + 1:
            last = int(np.searchsorted(response.time, turn[first] * delay + smooth))
            moved = np.abs(response.output[first : last + 1] - response.output[first - 1]).max()
            kick = abs(float(first_control(np.array([loop.controller.gains]), sample_time)[0]))
            size[first:last] = np.minimum(size[first:last], size[first - 1] + kick * moved)
    later: Floats = size[response.time >= smooth]
    return later


def _rate(loop: Loop, bounds: Bounds) -> Check:
    """The first move of the running controller is exact; later ones are slopes of the ideal one's control."""
    asked = f"control rate <= {bounds.rate_max:g} per second"
    error = EXACT * bounds.rate_max
    try:
        value = control_rate(loop, bounds.sample_time, bounds.horizon, bounds.rate_max)
    except InputError as refusal:
        return Check("control rate", asked, bounds.rate_max, math.nan, error, reason=str(refusal))
    return Check("control rate", asked, bounds.rate_max, value, error)


def control_rate(loop: Loop, sample_time: float, horizon: float, enough: float = math.inf) -> float:
    """How fast the running controller moves its control at most after a unit setpoint step [1/s].

    Parameters
    ----------
    loop : Loop
    sample_time : float
        Its tick [s]; its first move is made within one.
    horizon : float
        How long its later moves count [s].
    enough : float
        A first move beyond it is the answer.

    Raises
    ------
    InputError
        If the response is not known.

    Examples
    --------
    >>> from fopid_core.model.fopid import Fopid
    >>> from fopid_core.model.process import Process
    >>> round(control_rate(Loop(Process.parse("1/(s+1)"), Fopid(0.0, 0.5)), 0.01, 20.0), 2)
    0.5
    """
    first = abs(float(first_control(_row(loop), sample_time)[0])) / sample_time
    if first > enough or horizon <= SMOOTH_TICKS * sample_time:
        return first
    response = step_response(loop, horizon)
    late = response.time >= SMOOTH_TICKS * sample_time
    time, control = response.time[late], response.control[late]
    ahead = np.minimum(time + sample_time, time[-1])
    moves = np.abs(np.interp(ahead, time, control) - control)[ahead > time] / (ahead - time)[ahead > time]
    return max(first, float(moves.max(initial=0.0)))


def _first_control(loop: Loop, bounds: Bounds) -> float:
    return abs(float(first_control(_row(loop), bounds.sample_time)[0]))


def _at_the_end_of_the_delay(loop: Loop, bounds: Bounds) -> float:
    """How large the control is when the first answer comes: a kink, most likely between two instants of a response."""
    delay = loop.process.delay
    if not SMOOTH_TICKS * bounds.sample_time < delay <= bounds.horizon:
        return 0.0
    return abs(float(open_control(_row(loop), np.array([delay]))[0, 0]))


def _row(loop: Loop) -> Floats:
    row = [*loop.controller.gains, loop.filter.time, loop.weights.proportional, loop.weights.derivative]
    return np.array([row])


def _db(gain: float) -> float:
    return 20.0 * math.log10(gain) if gain > 0.0 else -math.inf if gain == 0.0 else math.nan
