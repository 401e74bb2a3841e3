"""One controller on many variations of a process at once: stability, margins and the answer to a setpoint step.

A variation is g P(t s) exp(-d s): the gain times g, every time of the process (its lags and its delay) times t, and a
further delay d [s]. ``model`` has the exact answer for one loop; here a thousand share their grids.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import trapezoid

from fopid_core.design.control_peak import first_control
from fopid_core.design.defaults import PHASE_MARGIN, natural_crossover
from fopid_core.design.time.search_response import ResponseGrid
from fopid_core.model.arrays import Booleans, Complexes, Floats
from fopid_core.model.fopid import Fopid
from fopid_core.model.indices import rise_time, settling_time
from fopid_core.model.loop import Loop
from fopid_core.model.process import Process
from fopid_core.model.quasipolynomial import QuasiPolynomial, Term
from fopid_core.model.stability import stability
from fopid_core.model.winding import count_zeros
from fopid_core.study.campaigns.columns import MEASURES

_W = np.geomspace(1e-4, 1e4, 1601)  # in units of the natural crossover
_MOST_INTERVALS = 300  # as many as ``stable_mask`` looks at before it gives up on a loop
_STEPS_PER_RADIAN = 12.0  # of the fastest crossover, in a response
_FEWEST_STEPS, _MOST_STEPS = 1 << 11, 1 << 15
_AT_ONCE = 1 << 17  # values in a work array: of 2 MiB, which a core's cache holds
_SMOOTHED = 4  # first instants at which the control of ``ResponseGrid`` is not to be believed


def varied(process: Process, gain: float, time_scale: float, delay: float) -> Process:
    """One variation of a process.

    Examples
    --------
    >>> str(varied(Process.parse("1/(s+1)*exp(-s)"), 2.0, 3.0, 0.5))
    '2/(3 s + 1) * exp(-3.5s)'
    """
    return (
        Process(_stretched(process.numerator, time_scale), _stretched(process.denominator, time_scale))
        .scaled(gain)
        .delayed(delay)
    )


def _stretched(function: QuasiPolynomial, scale: float) -> QuasiPolynomial:
    return QuasiPolynomial.of(Term(t.order, t.delay * scale, t.coefficient * scale**t.order) for t in function.terms)


def measure(
    process: Process, controller: Fopid, variations: Floats, horizon: float, sample_time: float
) -> tuple[Booleans, Mapping[str, Floats]]:
    """What a controller makes of each variation.

    Parameters
    ----------
    process : Process
    controller : Fopid
    variations : ndarray, shape (n, 3)
        A row (g, t, d) each.
    horizon : float
        Of the setpoint step [s].
    sample_time : float
        Tick of the controller as it runs [s], for the control's peak.

    Returns
    -------
    stable : ndarray of bool, shape (n,)
    measures : mapping
        Name of ``MEASURES`` -> ndarray, shape (n,); NaN where the loop is not stable.

    Examples
    --------
    >>> three = np.array([[1.0, 1.0, 0.0], [2.0, 1.0, 0.0], [9.0, 1.0, 0.0]])
    >>> stable, found = measure(Process.parse("1/(s+1)^3"), Fopid(1.0, 0.3), three, 60.0, 0.01)
    >>> stable.tolist(), found["overshoot_pct"].round(0).tolist()
    ([True, True, False], [0.0, 22.0, nan])
    """
    stable = stable_variations(process, controller, variations)
    found = {name: np.full(len(variations), math.nan) for name in MEASURES}
    if stable.any():
        rows = variations[stable]
        inner = _frequency_measures(process, controller, rows)
        inner |= _step_measures(
            process, controller, rows, horizon, sample_time, float(np.fmax.reduce(inner["crossover"]))
        )
        for name, values in inner.items():
            found[name][stable] = values
    return stable, found


def stable_variations(process: Process, controller: Fopid, variations: Floats) -> Booleans:
    """Which loops are stable for certain, shape (n,); by the argument principle on all at once.

    With s counted in units of the inverse delay all loops have the same delay, 1. Where a process has several delays,
    or a loop is close to the border, each loop is looked at by itself.
    """
    delays = {term.delay for term in process.numerator.terms}
    stable = np.zeros(len(variations), dtype=bool)
    undecided = np.ones(len(variations), dtype=bool)
    if len(delays) == 1 and not any(term.delay for term in process.denominator.terms):
        total = variations[:, 2] + variations[:, 1] * delays.pop()
        for delayed in (True, False):
            rows = np.flatnonzero((total > 0.0) == delayed)
            if rows.size:
                terms = _characteristic(process, controller, variations[rows], total[rows])
                zeros = count_zeros(*terms, _MOST_INTERVALS)
                stable[rows], undecided[rows] = zeros.all_left, ~zeros.decided
    for i in np.flatnonzero(undecided):
        stable[i] = stability(Loop(varied(process, *variations[i].tolist()), controller)).stable
    return stable


def _characteristic(
    process: Process, controller: Fopid, variations: Floats, total: Floats
) -> tuple[Floats, Floats, Floats]:
    """Terms of s^lam D(t s) + g (kp s^lam + ki + kd s^(lam + mu)) N(t s) exp(-s total), as ``count_zeros`` takes them.

    Where there is a delay, s is in units of 1 / total.
    """
    gain, scale = variations[:, 0], variations[:, 1]
    unit = np.where(total > 0.0, total, 1.0)
    lam = controller.integral_order
    forward = [(controller.kp, lam), (controller.ki, 0.0), (controller.kd, lam + controller.mu)]
    parts = [(np.ones_like(gain), lam, 0.0, process.denominator.terms)]
    parts += [(k * gain, order, 1.0, process.numerator.terms) for k, order in forward]
    coefficients, orders, delays = [], [], []
    for factor, order, delay, terms in parts:
        for term in terms:
            coefficients.append(factor * term.coefficient * scale**term.order * unit ** -(order + term.order))
            orders.append(np.full_like(gain, order + term.order))
            delays.append(delay if total[0] > 0.0 else 0.0)
    return np.stack(coefficients, axis=1), np.stack(orders, axis=1), np.array(delays)


def _process_values(process: Process, variations: Floats, s: NDArray[np.complexfloating[Any, Any]]) -> Complexes:
    """The values of g P(t s) exp(-d s) for every variation, shape (n, len(s))."""
    gain, scale, delay = variations.T[..., None]
    return np.asarray(gain * process(scale * s) * np.exp(-delay * s), dtype=np.complex128)


def _frequency_measures(process: Process, controller: Fopid, variations: Floats) -> dict[str, Floats]:
    w = natural_crossover(process, PHASE_MARGIN) * _W
    loop = _process_values(process, variations, 1j * w) * controller(1j * w)
    distance = np.abs(1.0 + loop) ** 2
    phase_margin, crossover = _phase_margin(loop, np.log(w))
    with np.errstate(divide="ignore", over="ignore"):
        return {
            "ms": 1.0 / np.sqrt(_least(distance)),
            "mt": 1.0 / np.sqrt(_least(distance / np.abs(loop) ** 2)),
            "phase_margin_deg": np.degrees(phase_margin),
            "crossover": crossover,
            "gain_margin_db": 20.0 * np.log10(_gain_margin(loop)),
        }


def _least(values: Floats) -> Floats:
    """The least of each row: of the parabola through the lowest point and its neighbours."""
    rows = np.arange(len(values))
    at = np.clip(np.argmin(values, axis=1), 1, values.shape[1] - 2)
    left, middle, right = (values[rows, at + i] for i in (-1, 0, 1))
    bend = left - 2.0 * middle + right
    slope = 0.5 * (right - left)
    with np.errstate(divide="ignore", invalid="ignore"):
        lowest = middle - np.where((bend > 0.0) & (np.abs(slope) < bend), 0.5 * slope**2 / bend, 0.0)
    return np.asarray(np.minimum(np.maximum(lowest, 0.0), values.min(axis=1)))


def _crossings(values: Floats) -> tuple[Floats, Booleans]:
    """Where each row passes zero: the share of the interval that lies before it, and in which intervals."""
    before, after = values[:, :-1], values[:, 1:]
    crosses = (before >= 0.0) != (after >= 0.0)
    return np.where(crosses, before / np.where(crosses, before - after, 1.0), 0.0), crosses


def _between(values: Floats, share: Floats) -> Floats:
    return np.asarray(values[..., :-1] + share * np.diff(values))


def _phase_margin(loop: Complexes, log_w: Floats) -> tuple[Floats, Floats]:
    """The smallest angle from -1 where |L| = 1 [rad], and that frequency [rad/s]; infinite and NaN without any."""
    share, crosses = _crossings(np.log(np.abs(loop)))
    turned = np.angle(-loop[:, :-1]) + share * np.angle(loop[:, 1:] / loop[:, :-1])
    angle = np.where(crosses, np.angle(np.exp(1j * turned)), math.inf)
    at = np.argmin(np.abs(angle), axis=1)
    rows = np.arange(len(loop))
    crossover = np.where(crosses.any(axis=1), np.exp(_between(log_w, share)[rows, at]), math.nan)
    return angle[rows, at], crossover


def _gain_margin(loop: Complexes) -> Floats:
    """The factor on the gain nearest to 1 that reaches -1; infinite when none does."""
    share, crosses = _crossings(loop.imag / np.abs(loop))
    crosses = crosses & (loop.real[:, 1:] < 0.0) & (loop.real[:, :-1] < 0.0)
    log_gain = _between(np.log(np.abs(loop)), share)
    distance = np.where(crosses, np.abs(log_gain), math.inf)
    at = np.argmin(distance, axis=1)
    rows = np.arange(len(loop))
    return np.where(crosses.any(axis=1), np.exp(-log_gain[rows, at]), math.inf)


class _VariedGrid(ResponseGrid):
    """Responses of one controller on many variations: the process has a row for each."""

    def __init__(self, process: Process, variations: Floats, horizon: float, points: int, speed: float) -> None:
        super().__init__(process, horizon, points, speed)
        self._p = _process_values(process, variations, self._s)
        self._inverse_gain: Any = self._inverse_gain / variations[:, :1]


def _step_measures(
    process: Process, controller: Fopid, variations: Floats, horizon: float, sample_time: float, fastest: float
) -> dict[str, Floats]:
    speed = fastest if math.isfinite(fastest) else natural_crossover(process, PHASE_MARGIN)
    wished = max(_STEPS_PER_RADIAN * speed * horizon, _FEWEST_STEPS)
    points = min(1 << math.ceil(math.log2(wished)), _MOST_STEPS)
    gains = np.array([controller.gains])
    at_once = max(_AT_ONCE // points, 1)
    parts = []
    for first in range(0, len(variations), at_once):
        rows = variations[first : first + at_once]
        grid = _VariedGrid(process, rows, horizon, points, min(speed, points / (4.0 * horizon)))
        control = grid.controls(gains)[:, _SMOOTHED:]
        peak = np.maximum(np.abs(control).max(axis=1), abs(first_control(gains, sample_time)[0]))
        parts.append(_error_measures(grid.time, grid.errors(gains)) | {"control_peak": peak})
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


def _error_measures(time: Floats, error: Floats) -> dict[str, Floats]:
    size, output = np.abs(error), 1.0 - error
    return {
        "iae": trapezoid(size, time),
        "ise": trapezoid(size**2, time),
        "itae": trapezoid(time * size, time),
        "itse": trapezoid(time * size**2, time),
        "overshoot_pct": 100.0 * np.maximum(output.max(axis=1) - 1.0, 0.0),
        "rise_time": np.array([rise_time(time, row) for row in output]),
        "settling_time": np.array([settling_time(time, row) for row in output]),
    }
