"""How many zeros of a quasi-polynomial lie in the right half-plane: the argument principle, with a certificate.

Along s = jw, with z = ln w, a quasi-polynomial is a sum of terms ``c (jw)**q exp(-jw d)``. Between two points of
the grid the curve leaves the straight line that joins its ends by at most h^2/8 times a bound on its second derivative
in z, term by term. Where that line stays further from zero than this, the phase in between is known
for certain to move by the angle between the two ends; where it does not, the interval is halved. Outside the grid one
term outweighs all others, so the rest of the phase is known too. See Vyhlidal and Zitek (2009) for the
argument principle on quasi-polynomials and Hale and Verduyn Lunel (2002) for strong stability of neutral ones.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from fopid_core.model.arrays import Booleans, Complexes, Floats, Indexes
from fopid_core.model.quasipolynomial import QuasiPolynomial

BORDER = 1e-9  # a zero that so small a relative change of the coefficients puts on the axis is too close to call
_SAME_ORDER = 1e-11
LARGEST_COUNT = 2.0**40
"""More zeros than this are no count: the phase has lost its digits."""
_LARGEST_LOG_FREQUENCY = 1e6
_LARGEST_EXPONENT = 600.0  # exp of it is a number; a delay turns so fast there that its phase is never asked for
LARGEST_LOG = 300.0  # of a value that can still be squared
_FIRST_STEP = 0.35
_FEWEST_STEPS, _MOST_STEPS = 24, 160
_MOST_HALVINGS = 60
MOST_INTERVALS = 30_000  # open at once, for one quasi-polynomial
_LARGEST_LAG = 1e100  # beyond this only overflow matters


@dataclass(frozen=True)
class Zeros:
    """What the argument principle says, for each of n quasi-polynomials.

    Attributes
    ----------
    count : ndarray of int, shape (n,)
        Zeros with positive real part, where ``decided``; -1 elsewhere.
    margin : ndarray of float, shape (n,)
        The smallest relative change of the coefficients that puts a zero on the imaginary axis: the
        minimum, over the grid, of abs(f(jw)) over the sum of the terms' absolute values.
    decided : ndarray of bool, shape (n,)
        Whether the count is certain.
    neutral_gain : ndarray of float, shape (n,)
        Sum of the delayed leading coefficients over the undelayed one; from 1 on there are infinitely many zeros to the
        right, or would be after an arbitrarily small change of the delays. Infinite for advanced type.
    origin_order : ndarray of float, shape (n,)
        The power of s that was taken out; above 0 there is a zero at the origin, which ``count`` leaves out.
    within_reach : ndarray of bool, shape (n,)
        Whether all that happens lies at frequencies that can be looked at.
    log_frequency : ndarray of float, shape (m,)
        All points of all grids, ascending, as far as no power of s overflows: dense where a zero is near the axis.
    """

    count: NDArray[np.int64]
    margin: Floats
    decided: Booleans
    neutral_gain: Floats
    origin_order: Floats
    within_reach: Booleans
    log_frequency: Floats

    @property
    def all_left(self) -> Booleans:
        """Whether every zero lies to the left of the imaginary axis, for certain; shape (n,)."""
        certain: Booleans = self.decided & (self.count == 0) & (self.origin_order == 0.0)
        return certain


@lru_cache(64)
def right_half_plane_zeros(function: QuasiPolynomial) -> Zeros:
    """The zeros of one quasi-polynomial to the right of the imaginary axis; a power of s is left out.

    Examples
    --------
    >>> int(right_half_plane_zeros(QuasiPolynomial.polynomial([1.0, -1.0, 2.0, 3.0])).count[0])
    2
    """
    terms = function.terms
    return count_zeros(
        np.array([[t.coefficient for t in terms]]),
        np.array([[t.order for t in terms]]),
        np.array([t.delay for t in terms]),
    )


def count_zeros(coefficients: Floats, orders: Floats, delays: Floats, most_intervals: int = MOST_INTERVALS) -> Zeros:
    """Count the zeros of n quasi-polynomials of k terms each.

    Parameters
    ----------
    coefficients, orders : ndarray, shape (n, k)
        A zero coefficient leaves its term out.
    delays : ndarray, shape (k,)
        Delays [s], common to all of them.
    most_intervals : int
        Give up on a quasi-polynomial (``decided`` False) when more intervals than this are open at once.
    """
    family = _Family.of(coefficients, orders, delays)
    phase, margin, certain, grid = _follow(family, most_intervals)
    margin = np.where(family.well_posed, margin, 0.0)
    raw = np.nan_to_num(family.top_order / 2.0 - phase / np.pi, nan=-1.0, posinf=-1.0, neginf=-1.0)
    count = np.rint(raw)
    decided = certain & family.well_posed & (np.abs(raw - count) < 0.01) & (count >= 0) & (count < LARGEST_COUNT)
    grid = grid[np.abs(grid) < LARGEST_LOG / (2.0 + family.orders.max())]
    count = np.where(decided, count, -1).astype(np.int64)
    return Zeros(count, margin, decided, family.neutral_gain, family.origin_order, family.within_reach, grid)


@dataclass(frozen=True)
class _Family:
    """n quasi-polynomials, and where a single term of each outweighs the rest."""

    log_size: Floats  # (n, k): ln |c|
    orders: Floats  # (n, k), lowest active order 0
    delays: Floats  # (k,), shortest delay 0
    phasors: Complexes  # (n, k): sign(c) j^q
    lowest: Floats  # (n,): the value at s = 0
    top_order: Floats  # (n,)
    top_sign: Floats  # (n,)
    neutral_gain: Floats  # (n,)
    origin_order: Floats  # (n,): the lowest order before it was taken out
    start: Floats  # (n,): ln w below which the lowest term outweighs the rest
    end: Floats  # (n,): ln w above which the highest one does
    within_reach: Booleans  # (n,): whether these frequencies can be looked at
    well_posed: Booleans  # (n,)

    @staticmethod
    def of(coefficients: Floats, orders: Floats, delays: Floats) -> _Family:
        active = coefficients != 0.0
        origin_order = np.min(np.where(active, orders, np.inf), axis=1)
        orders = orders - origin_order[:, None]
        delays = delays - np.min(delays[np.any(active, axis=0)])
        size = np.abs(coefficients)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            log_size = np.log(size)
            low, start = _low_end(coefficients, orders, delays, log_size, active)
            top_order, top, gain, end = _high_end(coefficients, orders, delays, log_size, active)
        constants = np.where(active & (orders <= _SAME_ORDER), size, 0.0).sum(axis=1)
        well_posed = (np.abs(low) > BORDER * constants) & (gain < 1.0 - BORDER) & (top != 0.0)
        within_reach = (start > -_LARGEST_LOG_FREQUENCY) & (end < _LARGEST_LOG_FREQUENCY)
        phasors = np.sign(coefficients) * np.exp(0.5j * np.pi * np.where(active, orders, 0.0))
        orders = np.where(active, orders, 0.0)
        end = np.maximum(end, start + 1.0)
        return _Family(
            log_size, orders, delays, phasors, low, top_order, np.sign(top), gain, origin_order, start, end,
            within_reach, well_posed & within_reach,
        )  # fmt: skip

    def values(self, owner: Indexes, z: Floats) -> tuple[Floats, Floats, Complexes]:
        """Shares of the terms (m, k), ln of their sum (m,) and the value over that sum (m,)."""
        log_terms = self.log_size[owner] + self.orders[owner] * z[:, None]
        largest = log_terms.max(axis=1)
        shares = np.exp(log_terms - largest[:, None])
        total = shares.sum(axis=1)
        shares /= total[:, None]
        phasors = self.phasors[owner]
        if self.delays.any():
            phasors = phasors * np.exp(-1j * np.exp(np.minimum(z, _LARGEST_EXPONENT))[:, None] * self.delays)
        return shares, largest + np.log(total), np.einsum("mk,mk->m", shares, phasors)


def _low_end(
    coefficients: Floats, orders: Floats, delays: Floats, log_size: Floats, active: Booleans
) -> tuple[Floats, Floats]:
    """The value at s = 0, and ln w below which it outweighs the change of the function."""
    constant = active & (orders <= _SAME_ORDER)
    value = np.where(constant, coefficients, 0.0).sum(axis=1)
    log_share = np.log(np.abs(value) / (2.0 * orders.shape[1]))
    reach = np.where(active & ~constant, (log_share[:, None] - log_size) / orders, np.inf).min(axis=1)
    drift = np.where(constant, np.abs(coefficients) * delays, 0.0).sum(axis=1)
    return value, np.minimum(np.minimum(reach, np.log(np.abs(value) / (4.0 * drift))), 0.0)


def _high_end(
    coefficients: Floats, orders: Floats, delays: Floats, log_size: Floats, active: Booleans
) -> tuple[Floats, Floats, Floats, Floats]:
    """Order and coefficient of the leading term, its neutral gain, and ln w above which it outweighs the rest."""
    undelayed = active & (delays == 0.0)
    order = np.where(undelayed, orders, -np.inf).max(axis=1)
    gap = order[:, None] - orders
    level = active & (np.abs(gap) <= _SAME_ORDER)
    leading = np.where(level & undelayed, coefficients, 0.0).sum(axis=1)
    gain = np.where(level & ~undelayed, np.abs(coefficients), 0.0).sum(axis=1) / np.abs(leading)
    gain = np.where((active & (gap < -_SAME_ORDER)).any(axis=1), np.inf, gain)
    log_room = np.log(np.abs(leading) * (1.0 - gain) / (2.0 * orders.shape[1]))
    reach = np.where(active & ~level, (log_size - log_room[:, None]) / gap, -np.inf).max(axis=1)
    return order, leading, gain, np.maximum(reach, 0.0)


@dataclass(frozen=True)
class _Points:
    """Values at m points of the grids."""

    z: Floats
    shares: Floats
    log_total: Floats
    value: Complexes

    @staticmethod
    def of(family: _Family, owner: Indexes, z: Floats) -> _Points:
        return _Points(z, *family.values(owner, z))

    def at(self, index: Indexes | Booleans) -> _Points:
        return _Points(self.z[index], self.shares[index], self.log_total[index], self.value[index])

    def joined(self, other: _Points) -> _Points:
        return _Points(
            np.concatenate((self.z, other.z)),
            np.concatenate((self.shares, other.shares)),
            np.concatenate((self.log_total, other.log_total)),
            np.concatenate((self.value, other.value)),
        )


def _follow(family: _Family, most_intervals: int) -> tuple[Floats, Floats, Booleans, Floats]:
    """Phase from w = 0 to infinity, margin, certainty (all shape (n,)) and the points of the grids."""
    n = family.start.size
    owner, z = _first_grid(family)
    points = _Points.of(family, owner, z)
    inner = np.flatnonzero(owner[1:] == owner[:-1])
    phase = _end_phases(family, points, owner)
    margin, hopeless = np.full(n, np.inf), ~family.well_posed
    np.minimum.at(margin, owner, np.abs(points.value))
    left, right, owner = points.at(inner), points.at(inner + 1), owner[inner]
    grids = [z]
    for _ in range(_MOST_HALVINGS):
        certain, turn = _certificate(family, owner, left, right)
        phase += np.bincount(owner[certain], turn[certain], minlength=n)
        hopeless |= np.bincount(owner[~certain], minlength=n) > most_intervals
        hopeless |= margin <= BORDER
        open_ = np.flatnonzero(~certain & ~hopeless[owner])
        if open_.size == 0:
            break
        left, right, owner = left.at(open_), right.at(open_), owner[open_]
        middle = _Points.of(family, owner, 0.5 * (left.z + right.z))
        np.minimum.at(margin, owner, np.abs(middle.value))
        grids.append(middle.z)
        left, right, owner = left.joined(middle), middle.joined(right), np.concatenate((owner, owner))
    hopeless[owner[open_]] = True
    return phase, margin, ~hopeless, np.unique(np.concatenate(grids))


def _first_grid(family: _Family) -> tuple[Indexes, Floats]:
    start = np.where(family.well_posed, family.start, 0.0)
    end = np.where(family.well_posed, family.end, 1.0)
    steps = np.clip(np.ceil((end - start) / _FIRST_STEP), _FEWEST_STEPS, _MOST_STEPS).astype(np.intp)
    owner = np.repeat(np.arange(start.size), steps + 1)
    position = np.arange(owner.size) - np.repeat(np.cumsum(steps + 1) - (steps + 1), steps + 1)
    return owner, start[owner] + (end - start)[owner] * position / steps[owner]


def _end_phases(family: _Family, points: _Points, owner: Indexes) -> Floats:
    """The phase below the first and above the last point of each grid."""
    first = np.searchsorted(owner, np.arange(family.start.size))
    last = np.append(first[1:], owner.size) - 1
    below = np.angle(points.value[first] * np.sign(family.lowest))
    top = family.top_sign * np.exp(0.5j * np.pi * family.top_order)
    phases: Floats = below - np.angle(points.value[last] / np.where(top == 0.0, 1.0, top))
    return phases


def _certificate(family: _Family, owner: Indexes, left: _Points, right: _Points) -> tuple[Booleans, Floats]:
    """Whether the curve provably keeps away from zero in each interval, and the angle it then turns by."""
    step = right.z - left.z
    local_order = (right.log_total - left.log_total) / np.maximum(step, np.finfo(float).tiny)
    frequency = np.exp(np.minimum(right.z, _LARGEST_EXPONENT))
    reference = _dominant_delay(family, left)
    lag = np.minimum(np.abs(family.delays - reference[:, None]) * frequency[:, None], _LARGEST_LAG)
    rate = np.abs(family.orders[owner] - local_order[:, None]) + lag
    bend = np.minimum((step**2 / 8.0)[:, None] * (rate**2 + lag), 2.0)
    deviation = np.einsum("mk,mk->m", np.maximum(left.shares, right.shares), bend)
    sweep = reference * (frequency - np.exp(np.minimum(left.z, _LARGEST_EXPONENT)))
    end = right.value * np.exp(1j * sweep)
    clearance = np.abs(left.value) + np.abs(end) - np.abs(end - left.value)
    certain, turn = clearance > 2.0 * deviation, np.angle(end * np.conj(left.value)) - sweep
    other = np.flatnonzero(~certain)
    if other.size and family.delays.any():
        part = _Interval(family, owner[other], left.at(other), right.at(other), reference[other], bend[other])
        certain[other], outweighed = part.outweighed()
        turn[other] = np.where(certain[other], outweighed, turn[other])
    return certain, turn


@dataclass(frozen=True)
class _Interval:
    """Intervals in which the terms of one delay may outweigh all others, however these turn."""

    family: _Family
    owner: Indexes
    left: _Points
    right: _Points
    reference: Floats
    bend: Floats

    def outweighed(self) -> tuple[Booleans, Floats]:
        """Whether they do, and the angle by which the curve then turns."""
        own = self.family.delays == self.reference[:, None]
        phasors = np.where(own, self.family.phasors[self.owner], 0.0)
        first, last = (np.einsum("mk,mk->m", points.shares, phasors) for points in (self.left, self.right))
        shares = np.maximum(self.left.shares, self.right.shares)
        deviation = np.einsum("mk,mk->m", shares, np.where(own, self.bend, 0.0))
        others = np.einsum("mk,mk->m", shares, np.where(own, 0.0, 1.0))
        clearance = 0.5 * (np.abs(first) + np.abs(last) - np.abs(last - first))
        certain: Booleans = clearance > deviation + others
        with np.errstate(divide="ignore", invalid="ignore"):
            turn = np.angle(last * np.conj(first))
            turn += np.angle(self.right.value / (last * self._lag(self.right)))
            turn -= np.angle(self.left.value / (first * self._lag(self.left)))
        frequencies = (np.exp(np.minimum(points.z, _LARGEST_EXPONENT)) for points in (self.right, self.left))
        return certain, turn - self.reference * np.subtract(*frequencies)

    def _lag(self, points: _Points) -> Complexes:
        lag: Complexes = np.exp(-1j * self.reference * np.exp(np.minimum(points.z, _LARGEST_EXPONENT)))
        return lag


def _dominant_delay(family: _Family, points: _Points) -> Floats:
    """The delay of the terms that weigh most at each point: a frame in which the curve turns slowly."""
    distinct, group = np.unique(family.delays, return_inverse=True)
    if distinct.size == 1:
        return np.zeros(points.z.size)
    weights = np.stack([points.shares[:, group == g].sum(axis=1) for g in range(distinct.size)])
    chosen: Floats = distinct[np.argmax(weights, axis=0)]
    return chosen
