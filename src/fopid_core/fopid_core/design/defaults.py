"""What is taken when a specification leaves it open: read off the process's own frequency response."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from fopid_core.errors import InputError
from fopid_core.model.process import Process
from fopid_core.model.stability import process_stability

PHASE_MARGIN = math.radians(60.0)
"""The middle of the 45 to 75 degrees that textbooks recommend [rad]."""

MS_MAX = 1.6
"""Between the 1.4 (robust) and 2.0 (fast) of Astrom and Hagglund; without a bound every index says more gain."""

U_MAX = 20.0
"""For a process of gain 1: twenty times the control that holds the setpoint."""

_W = np.logspace(-7.0, 7.0, 1401)
_LONG_DELAY = 1e4  # [s]: with a longer one lower frequencies matter
_FLAT = math.radians(5.0)
_TWELFTH = math.radians(30.0)

PRACTICAL_ORDERS = {"lam": (0.7, 1.3), "mu": (0.5, 1.5)}
"""Orders that leave no long tails and no noise without end."""
LEAST_PROPORTIONAL = 0.1
"""Of kp, in units of the process's gain or of the controller's at the crossover: less, and the integral and the
derivative alone do the work."""


def gain_sign(process: Process) -> float:
    """The sign the controller's gains must have.

    With an integral the characteristic function of the closed loop begins with ki N(0) and ends with the highest term
    of the denominator; it has no positive zero only when both have one sign.

    Examples
    --------
    >>> [gain_sign(Process.parse(text)) for text in ("-2/(s+1)", "1/(s-1)", "(1-s)/(s+1)^2", "(s-2)/((s-1)(s+3))")]
    [-1.0, 1.0, 1.0, -1.0]
    """
    first, last = process.numerator.lowest_order, process.denominator.degree
    begins = sum(term.coefficient for term in process.numerator.terms if term.order == first)
    ends = sum(term.coefficient for term in process.denominator.terms if term.order == last)
    return math.copysign(1.0, begins) * math.copysign(1.0, ends)


def natural_crossover(process: Process, phase_margin: float) -> float:
    """The frequency at which the process alone has the phase that the margin asks of the loop [rad/s].

    A process that never lags so far (a first-order lag) is taken where it has nine tenths of its own largest lag, and
    one that begins with more lag (an unstable one) where it has less, by a factor of three if there is room. One that
    lags more everywhere needs a derivative: it is taken where it lags least, or, where that is at an end of the axis
    (two integrators and a delay, an unstable oscillator), within a twelfth of a turn of that. One with the same phase
    everywhere is taken where its gain is 1 (an integrator) or has begun to fall (K / (s^2 - a)), one that only leads
    where it leads most; one without dynamics has no time of its own, and 1 rad/s stands for it.

    Examples
    --------
    >>> round(natural_crossover(Process.parse("1/(s+1)^3"), math.radians(60.0)), 1)
    0.8
    """
    w, lag, gain = _lag_and_gain(process)
    wished = math.pi - phase_margin
    if np.ptp(lag) < _FLAT:
        return _by_gain(w, gain)
    least = lag.min()
    if least > wished:
        return float(w[_where_a_derivative_works(lag)])
    wished = max(wished, least + 0.1 * (lag[0] - least))
    if lag[0] > wished + 1e-6:
        less = w[lag < wished]
        return float(min(3.0 * less[0], math.sqrt(less[0] * less[-1])))
    if lag.max() - lag[0] < _FLAT:
        return float(w[np.argmin(lag)])
    reached = lag[0] + 0.9 * (lag.max() - lag[0])
    return float(w[np.argmax(lag >= reached) if reached < wished else _where_it_stays_beyond(lag, wished)])


def _where_it_stays_beyond(lag: NDArray[np.float64], wished: float) -> int:
    """The last place where the lag passes what is wished before it is a twelfth of a turn too far; it may come back."""
    too_far = np.flatnonzero(lag >= wished + _TWELFTH)
    beyond = lag[: too_far[0] + 1 if too_far.size else None] >= wished
    return int(np.flatnonzero(beyond & ~np.concatenate([[False], beyond[:-1]]))[-1])


def _where_a_derivative_works(lag: NDArray[np.float64]) -> np.intp:
    """Which of the frequencies is taken for a process that always lags too far."""
    enough = lag.min() + _TWELFTH
    if lag[0] < lag.min() + _FLAT:
        return np.argmax(lag >= min(enough, lag.max()))
    return np.argmax(lag <= enough) if lag[-1] < lag.min() + _FLAT else np.argmin(lag)


def _by_gain(w: NDArray[np.float64], gain: NDArray[np.float64]) -> float:
    """The frequency that the gain alone shows [rad/s]."""
    if np.ptp(np.log(gain)) <= _FLAT:
        return 1.0
    settles = gain[0] / gain[1] < 1.0 + 1e-6
    below = gain < gain[0] / math.sqrt(2.0)
    return float(w[np.argmax(below)] if settles and below.any() else w[np.argmin(np.abs(np.log(gain)))])


def process_gain(process: Process) -> float:
    """What gains of the controller are measured against, with the sign they must have.

    The steady-state gain of a process that settles, else its gain at the natural crossover.
    """
    at_rest = process.steady_state_gain
    stands = process.integrating_order == 0 and at_rest != 0.0 and not process_stability(process).unstable_poles
    size = abs(at_rest) if stands else abs(complex(process(1j * natural_crossover(process, PHASE_MARGIN))))
    return gain_sign(process) * size


def _lag_and_gain(process: Process) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Frequencies of practice, the phase lag [rad] of the process taken with positive gain, and its gain."""
    prompt = process.without_delay()
    w = _W if process.delay <= _LONG_DELAY else np.union1d(_W, _W * (_LONG_DELAY / process.delay))
    with np.errstate(all="ignore"):
        value = gain_sign(process) * prompt(1j * w)
    finite = np.isfinite(value)
    on_a_pole = np.flatnonzero(~finite[1:-1] & finite[:-2] & finite[2:]) + 1  # of an undamped oscillator
    w, value = np.delete(w, on_a_pole), np.delete(value, on_a_pole)
    if not np.all(np.isfinite(value)):
        raise InputError(f"process {process} is infinite at some frequency; allowed: give the crossover")
    seen = np.abs(value) > np.finfo(float).tiny
    value = value if seen.all() else value[: max(int(np.argmin(seen)), 1)]
    w = w[: len(value)]
    lag = -np.unwrap(np.angle(value))
    # Known up to full turns only: a lag between 0 and a turn, or the last of an unstable process that of its order.
    if process_stability(process).unstable_poles:
        order = process.denominator.degree - process.numerator.degree
        turns = round((order * math.pi / 2.0 - lag[-1]) / (2.0 * math.pi))
    else:
        turns = math.ceil(-(lag[0] + 0.1) / (2.0 * math.pi))
    return w, lag + 2.0 * math.pi * turns + process.delay * w, np.abs(value)
