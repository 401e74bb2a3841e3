"""Is the loop stable: real orders and delays as they are, nothing approximated."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from fopid_core.errors import InputError
from fopid_core.model.arrays import Booleans, Floats
from fopid_core.model.loop import Loop
from fopid_core.model.process import Process
from fopid_core.model.quasipolynomial import QuasiPolynomial, Term
from fopid_core.model.two_degrees import filter_coefficients
from fopid_core.model.winding import BORDER, Zeros, count_zeros, right_half_plane_zeros

_CANDIDATES_AT_ONCE = 256  # keeps the work arrays within a processor's cache
_MOST_INTERVALS_EACH = 300  # a candidate that needs more has dozens of poles near the axis


@dataclass(frozen=True)
class Stability:
    """The verdict on a loop or a process.

    Attributes
    ----------
    stable : bool
        Whether every pole lies to the left of the imaginary axis, for certain.
    unstable_poles : int
        Poles with positive real part; -1 when there are infinitely many or when it is not ``decided``.
    decided : bool
        False when the loop is too close to the border to call; ``stable`` is then False.
    margin : float
        Distance to the border: the smallest relative change of the characteristic quasi-polynomial's
        coefficients that brings a pole to the imaginary axis (at the frequencies looked at).
    reason : str
        The verdict in words.
    """

    stable: bool
    unstable_poles: int
    decided: bool
    margin: float
    reason: str


def stability(loop: Loop) -> Stability:
    """Whether the loop is stable, by the argument principle on its characteristic quasi-polynomial.

    Counts what is unstable inside as well: a pole that the controller cancels still counts.
    A neutral loop (delay, and a loop gain that does not vanish at high frequency) counts as stable only when
    it stays so under small changes of its delays.

    Examples
    --------
    >>> from fopid_core.model.fopid import Fopid
    >>> verdict = stability(Loop(Process.parse("1/(s-1)"), Fopid(kp=2.0)))
    >>> verdict.stable, verdict.unstable_poles
    (True, 0)
    >>> stability(Loop(Process.parse("1/(s+1)^3"), Fopid(kp=9.0))).unstable_poles
    2
    """
    return _ZERO_AT_ORIGIN if loop.process.cancels_at_origin else _verdict(loop.characteristic)


def process_stability(process: Process) -> Stability:
    """Whether the process itself is stable; an integrating one is not.

    Examples
    --------
    >>> process_stability(Process.parse("1/(s+1)^3")).stable, process_stability(Process.parse("1/s")).stable
    (True, False)
    """
    return _ZERO_AT_ORIGIN if process.cancels_at_origin else _verdict(process.denominator)


_ZERO_AT_ORIGIN = Stability(
    False, -1, False, 0.0, "not decided: numerator and denominator of the process both vanish at s = 0"
)


def _verdict(characteristic: QuasiPolynomial) -> Stability:
    if characteristic.is_zero:
        return Stability(False, -1, True, 0.0, "1 + L(s) is zero everywhere")
    zeros = right_half_plane_zeros(characteristic)
    count, margin, decided = int(zeros.count[0]), float(zeros.margin[0]), bool(zeros.decided[0])
    if zeros.neutral_gain[0] > 1.0 + BORDER:
        return Stability(False, -1, True, 0.0, "infinitely many unstable poles: the delayed loop gain stays above 1")
    if characteristic.sum_of_order(0.0) == 0.0:
        return Stability(False, count, True, 0.0, "a pole at the origin")
    if not decided:
        return Stability(False, -1, False, margin, _why_undecided(zeros))
    if count:
        return Stability(False, count, True, margin, f"{count} unstable pole{'s' if count > 1 else ''}")
    return Stability(True, 0, True, margin, "stable")


def _why_undecided(zeros: Zeros) -> str:
    if abs(zeros.neutral_gain[0] - 1.0) <= BORDER:
        return "the delayed loop gain at high frequency is 1: too close to the border to call"
    if not zeros.within_reach[0]:
        return "not decided: orders so close together act at frequencies beyond what can be looked at"
    if zeros.margin[0] > BORDER:
        return "not decided: too many poles near the imaginary axis to count"
    return "too close to the border to call"


def stable_mask(process: Process, gains: ArrayLike, filter_times: ArrayLike = 0.0, filter_order: int = 0) -> Booleans:
    """Which of many controllers keep the loop stable.

    Parameters
    ----------
    process : Process
    gains : array_like, shape (n, 5)
        One controller (kp, ki, kd, lam, mu) a row.
    filter_times : array_like, shape (n,)
        Of the filters of the measurement that go with them [s].
    filter_order : int
        Of these filters, 0 for none.

    Returns
    -------
    ndarray of bool, shape (n,)
        True where the loop is stable for certain.

    Examples
    --------
    >>> stable_mask(Process.parse("1/(s+1)^3"), [[7.9, 0, 0, 1, 1], [8.1, 0, 0, 1, 1]]).tolist()
    [True, False]
    """
    rows = np.atleast_2d(np.asarray(gains, dtype=np.float64))
    if rows.ndim != 2 or rows.shape[1] != 5 or not np.all(np.isfinite(rows)):
        raise InputError(f"gains of shape {rows.shape}; allowed: finite numbers, one row KP,KI,KD,LAM,MU a controller")
    times = np.broadcast_to(np.asarray(filter_times, dtype=np.float64), len(rows))
    stable = np.zeros(len(rows), dtype=bool)
    for first in range(0, len(rows), _CANDIDATES_AT_ONCE):
        chunk = slice(first, first + _CANDIDATES_AT_ONCE)
        terms = _characteristic_terms(process, rows[chunk], filter_coefficients(filter_order, times[chunk]))
        stable[chunk] = count_zeros(*terms, _MOST_INTERVALS_EACH).all_left
    return stable


def _characteristic_terms(
    process: Process, rows: Floats, slow: tuple[Floats | float, ...]
) -> tuple[Floats, Floats, Floats]:
    """Coefficients (n, k), orders (n, k) and delays (k,) of the characteristic quasi-polynomial.

    s^lam D(s) / F(s) + (kp s^lam + ki + kd s^(lam+mu)) N(s), with the coefficients ``slow`` of 1 / F(s).
    """
    kp, ki, kd, lam, mu = rows.T
    lam = np.where(ki != 0.0, lam, 0.0)
    none = np.zeros_like(kp)
    factors: list[tuple[tuple[Term, ...], Floats, Floats]] = [
        *((process.denominator.terms, none + part, lam + power) for power, part in enumerate(slow)),
        (process.numerator.terms, kp, lam),
        (process.numerator.terms, ki, none),
        (process.numerator.terms, kd, lam + mu),
    ]
    coefficients = [gain * term.coefficient for terms, gain, _ in factors for term in terms]
    orders = [order + term.order for terms, _, order in factors for term in terms]
    delays = [term.delay for terms, _, _ in factors for term in terms]
    return np.stack(coefficients, axis=1), np.stack(orders, axis=1), np.array(delays)
