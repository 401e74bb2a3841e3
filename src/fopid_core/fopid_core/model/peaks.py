"""The largest value of a quotient of quasi-polynomials on the imaginary axis, exact.

With z = ln w, the logarithm of the quotient's absolute value and its slope are known at any point, so between two
points it is a cubic, to an accuracy that is seen when the interval is cut at the cubic's highest point. Intervals that
cannot reach the highest value seen are left out, the others are cut again (branch and bound). Where a delay turns by
more than the interval resolves, the bound is that of all delayed terms pulling together; or, where the quotient tends
to a limit other than 0, that of its square's distance from the limit's, in which all that numerator and denominator
have in common falls out: it shrinks with the square of the frequency. Everything is computed with logarithms: no power
of s overflows.
"""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass
from itertools import product

import numpy as np

from fopid_core.model.arrays import Booleans, Floats
from fopid_core.model.asymptotics import leading_term
from fopid_core.model.quasipolynomial import QuasiPolynomial, Term

_EXACT = 1e-9  # of the logarithm of the peak
_ROUNDING = 1e-12  # by which a value is not above a limit
_NEGLIGIBLE = 1e-10  # where all terms but the first are so small, the limit is reached
_TAIL_POINTS = 48
_RESOLVED = 0.5  # of a delay's phase in one interval [rad]
_AT_ONCE = 4096
_MOST_POINTS = 100_000
_KNOWN = 1e-8  # to which the logarithm is known where so many points leave no more open
_FALLS_OUT = 1e-13  # what is left of terms that fall out of each other, as a share of them
_LARGEST_LOG = 700.0  # exp of it is a number
_NARROWEST = 1e-14  # of an interval, relative

Band = tuple[float, float]


@dataclass(frozen=True)
class Peak:
    """The largest value of a function of the frequency.

    Attributes
    ----------
    value : float
        Exact to 1e-8; infinite without a bound, NaN where it is not known.
    frequency : float
        Where it is [rad/s]; an end of the band when it is approached there.
    """

    value: float
    frequency: float


def highest(numerator: QuasiPolynomial, denominator: QuasiPolynomial, z: Floats, band: Band = (0.0, math.inf)) -> Peak:
    """The least upper bound of abs(numerator / denominator) at s = jw on a band, its ends and limits included.

    Parameters
    ----------
    numerator, denominator : QuasiPolynomial
    z : ndarray, shape (n,)
        Ascending ln w, close together where a zero of either is near the axis (``winding``).
    band : tuple of float
        Lowest and highest frequency [rad/s].

    Examples
    --------
    >>> one, resonance = QuasiPolynomial.constant(1.0), QuasiPolynomial.polynomial([1.0, 2e-6, 1.0])
    >>> from fopid_core.model.winding import right_half_plane_zeros
    >>> round(highest(one, resonance, right_half_plane_zeros(resonance).log_frequency).value, 3)
    500000.0
    """
    if numerator.is_zero:
        return Peak(0.0, band[0])
    ends = zip(limits(numerator, denominator), (0.0, math.inf), strict=True)
    limit = max((Peak(value, end) for value, end in ends if end in band), key=lambda p: p.value, default=Peak(0.0, 0.0))
    if limit.value == math.inf:
        return limit
    least = math.log(limit.value) if limit.value else -math.inf
    best, where = _branch_and_bound(_Curve(numerator, denominator), _whole(numerator, denominator, z, band), least)
    if best == least:
        return limit
    return Peak(math.exp(best) if best < _LARGEST_LOG else best * math.inf, math.exp(where))


def limits(numerator: QuasiPolynomial, denominator: QuasiPolynomial) -> tuple[float, float]:
    """Abs(numerator / denominator) at s = 0 and at s = infinity, there the largest that the delays let it be."""
    low_n, low_d = numerator.lowest_order, denominator.lowest_order
    bottom = denominator.sum_of_order(low_d)
    zero = abs(numerator.sum_of_order(low_n) / bottom) * _power_at_zero(low_n - low_d) if bottom else math.inf
    lead = leading_term(denominator)
    level = [abs(t.coefficient) for t in denominator.terms if t.order == lead.order and t != lead]
    room = abs(lead.coefficient) - sum(level)
    top = sum(abs(t.coefficient) for t in numerator.terms if t.order == numerator.degree)
    return zero, top / room * _power_at_zero(lead.order - numerator.degree) if room > 0.0 else math.inf


def _power_at_zero(order: float) -> float:
    return 0.0 if order > 0.0 else 1.0 if order == 0.0 else math.inf


def _whole(numerator: QuasiPolynomial, denominator: QuasiPolynomial, z: Floats, band: Band) -> Floats:
    """The grid, out to where the limits are reached, and only within the band."""
    spans = [_span(part) for part in (numerator, denominator)]
    low, high = min(z[0], *(span[0] for span in spans)), max(z[-1], *(span[1] for span in spans))
    tails = np.linspace(low, z[0], _TAIL_POINTS), np.linspace(z[-1], high, _TAIL_POINTS)
    first, last = (math.log(edge) if 0.0 < edge < math.inf else None for edge in band)
    whole = np.union1d(z, np.concatenate(tails))
    first, last = low if first is None else first, high if last is None else last
    inside = whole[(whole > first) & (whole < last)]
    return np.concatenate([[first], inside, [max(last, first)]])


def _span(function: QuasiPolynomial) -> tuple[float, float]:
    """Where, in ln w, the terms of lowest order are all there is (below), and those of highest order (above)."""
    orders = np.array([t.order for t in function.terms])
    size = np.log([abs(t.coefficient) for t in function.terms])
    lowest, highest = orders == orders.min(), orders == orders.max()
    share = math.log(_NEGLIGIBLE / len(orders))
    with np.errstate(divide="ignore", invalid="ignore"):
        below = (share + size[lowest].max() - size) / (orders - orders.min())
        above = (size - size[highest].max() - share) / (orders.max() - orders)
    longest = max(t.delay for t in function.terms) - function.lowest_delay
    low = min(below[~lowest].min(initial=0.0), share - math.log(longest) if longest else 0.0)
    return float(low), float(above[~highest].max(initial=0.0))


class _Curve:
    """The logarithm of abs(numerator / denominator) over ln w, with its slope and a bound for any turn of delays."""

    def __init__(self, numerator: QuasiPolynomial, denominator: QuasiPolynomial) -> None:
        self._over, self._under = _Sum(numerator), _Sum(denominator)
        self.delay = max(self._over.delay, self._under.delay)
        leads = [[t for t in part.terms if t.order == part.degree] for part in (numerator, denominator)]
        tends = numerator.degree == denominator.degree and [len(lead) for lead in leads] == [1, 1]
        self._distance = _Distance(numerator, denominator, leads[0][0], leads[1][0]) if tends and self.delay else None

    def __call__(self, z: Floats) -> Floats:
        """Value, slope and bound at the points z, shape (3, m)."""
        over, over_slope, most, over_least = self._over(z)
        under, under_slope, _, least = self._under(z)
        bound = most - least
        if self._distance is not None:
            bound = np.minimum(bound, self._distance.bound(z, over_least))
        return np.stack([over - under, over_slope - under_slope, bound])


class _Distance:
    """How far abs(numerator / denominator) may be above its limit g, whatever the delays make of it.

    Its square is g^2 / (1 + Q / abs(numerator)^2) with Q = g^2 abs(denominator)^2 - abs(numerator)^2. Of Q's terms, one
    for each pair of terms of either, those with the same difference of delays turn together.
    """

    def __init__(self, numerator: QuasiPolynomial, denominator: QuasiPolynomial, over: Term, under: Term) -> None:
        limit = abs(over.coefficient / under.coefficient)
        self._log_limit = math.log(limit)
        parts = ((limit**2, denominator), (-1.0, numerator))
        longest = max(t.delay for _, part in parts for t in part.terms) or 1.0
        sums: dict[float, dict[float, list[complex]]] = {}
        for weight, part in parts:
            for one, other in product(part.terms, part.terms):
                turns = round((one.delay - other.delay) / longest, 12)
                if turns >= 0.0:  # of each two that turn against each other, one
                    phase = cmath.exp(0.5j * math.pi * (one.order - other.order))
                    size = weight * one.coefficient * other.coefficient * (2.0 if turns else 1.0) * phase
                    sums.setdefault(turns, {}).setdefault(round(one.order + other.order, 12), []).append(size)
        self._groups = [
            (np.array(list(of_orders)), np.array([_sum_of(sizes) for sizes in of_orders.values()]))
            for _, of_orders in sorted(sums.items())
        ]  # that which does not turn comes first

    def bound(self, z: Floats, least: Floats) -> Floats:
        """Of the logarithm of the quotient at z = ln w, where that of the numerator is at least so large."""
        steady, *turning = (
            np.exp(orders * z[:, None] - 2.0 * least[:, None]) @ sizes for orders, sizes in self._groups
        )
        lowest = steady.real - sum(np.abs(each) for each in turning)
        found = self._log_limit - 0.5 * np.log1p(lowest)
        return np.asarray(np.where(lowest > -1.0, found, np.inf))


def _sum_of(sizes: list[complex]) -> complex:
    total = sum(sizes)
    return total if abs(total) > _FALLS_OUT * sum(map(abs, sizes)) else 0.0


class _Sum:
    """A quasi-polynomial on the axis: ln of its size, and of the most and the least its delays could make of it."""

    def __init__(self, function: QuasiPolynomial) -> None:
        terms = sorted(function.terms, key=lambda t: t.delay)
        self._size = np.log([abs(t.coefficient) for t in terms])
        self._order = np.array([t.order for t in terms])
        delays = np.array([t.delay for t in terms])
        self._delay = delays - delays[0]
        self.delay = float(self._delay[-1])
        self._groups = np.flatnonzero(np.diff(delays, prepend=-1.0))
        self._phasor = np.sign([t.coefficient for t in terms]) * np.exp(0.5j * np.pi * self._order)

    def __call__(self, z: Floats) -> tuple[Floats, Floats, Floats, Floats]:
        exponents = self._size + self._order * z[:, None]
        largest = exponents.max(axis=1)
        terms = np.exp(exponents - largest[:, None]) * self._phasor
        rates = self._order + 0j
        if not self.delay:
            value = terms.sum(axis=1)
            size = largest + np.log(np.abs(value))
            return size, np.real(terms @ rates / value), size, size
        groups = np.abs(np.add.reduceat(terms, self._groups, axis=1))
        together = groups.sum(axis=1)
        turning = 1j * np.exp(np.minimum(z, _LARGEST_LOG))[:, None] * self._delay
        terms = terms * np.exp(-turning)
        value = terms.sum(axis=1)
        slope = np.real(np.sum(terms * (rates - turning), axis=1) / value)
        apart = np.maximum(2.0 * groups.max(axis=1) - together, 0.0)
        return largest + np.log(np.abs(value)), slope, largest + np.log(together), largest + np.log(apart)


def _branch_and_bound(curve: _Curve, z: Floats, least: float) -> tuple[float, float]:
    """The highest value over the grid if it is above ``least``, and where; NaN when so many points do not find it."""
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        points = curve(z)
        best, where = _higher(points, z, (least + _ROUNDING, math.nan))
        ends, values = np.stack([z[:-1], z[1:]]), np.stack([points[:, :-1], points[:, 1:]])
        reach = np.full(z.size - 1, np.inf)
        used = z.size
        while reach.size:
            if used > _MOST_POINTS:
                if not reach.max() <= best + _KNOWN:
                    return math.nan, math.nan
                break
            chosen = slice(None) if reach.size <= _AT_ONCE else np.argpartition(-reach, _AT_ONCE)[:_AT_ONCE]
            waiting = np.ones(reach.size, dtype=bool)
            waiting[chosen] = False
            cut, predicted = _cut(ends[:, chosen], values[:, :, chosen])
            middle = curve(cut)
            used += cut.size
            best, where = _higher(middle, cut, (best, where))
            off = np.tile(np.abs(middle[[0, 2]] - predicted), 2)
            halves, sides = _halves(ends[:, chosen], values[:, :, chosen], cut, middle)
            ends = np.concatenate([ends[:, waiting], halves], axis=1)
            values = np.concatenate([values[:, :, waiting], sides], axis=2)
            reach = np.concatenate([reach[waiting], _reach(curve, halves, sides, off)])
            open_ = ~(reach <= best + _EXACT) & _is_wide(ends)
            ends, values, reach = ends[:, open_], values[:, :, open_], reach[open_]
    return (least, math.nan) if math.isnan(where) else (best, where)


def _higher(points: Floats, z: Floats, best: tuple[float, float]) -> tuple[float, float]:
    """The highest value and where, among some points and the best so far."""
    top = int(np.argmax(np.where(np.isnan(points[0]), -np.inf, points[0])))
    here = float(points[0, top]), float(z[top])
    return here if here[0] > best[0] else best


def _halves(ends: Floats, values: Floats, cut: Floats, middle: Floats) -> tuple[Floats, Floats]:
    """The intervals to the left and to the right of the cuts."""
    halves = np.stack([np.concatenate([ends[0], cut]), np.concatenate([cut, ends[1]])])
    left, right = np.concatenate([values[0], middle], axis=1), np.concatenate([middle, values[1]], axis=1)
    return halves, np.stack([left, right])


def _is_wide(ends: Floats) -> Booleans:
    wide: Booleans = ends[1] - ends[0] > _NARROWEST * (1.0 + np.abs(ends[0]))
    return wide


def _cut(ends: Floats, values: Floats) -> tuple[Floats, Floats]:
    """Where to cut: at the highest point of the cubic unless near an end; the cubic there, and the bound's chord."""
    share = _summit(ends, values)
    share = np.where(np.abs(share - 0.5) < 0.4, share, 0.5)
    chord = (1.0 - share) * values[0, 2] + share * values[1, 2]
    return ends[0] + share * (ends[1] - ends[0]), np.stack([_cubic(ends, values, share), chord])


def _reach(curve: _Curve, ends: Floats, values: Floats, off: Floats) -> Floats:
    """How high the function may come in each interval."""
    share = np.clip(_summit(ends, values), 0.0, 1.0)
    cubic = np.maximum(np.maximum(values[0, 0], values[1, 0]), _cubic(ends, values, share)) + off[0]
    if not curve.delay:
        return np.asarray(cubic)
    lag = curve.delay * (np.exp(np.minimum(ends[1], _LARGEST_LOG)) - np.exp(np.minimum(ends[0], _LARGEST_LOG)))
    bound = np.maximum(values[0, 2], values[1, 2]) + off[1]
    return np.asarray(np.where((lag < _RESOLVED) & (ends[1] < _LARGEST_LOG), cubic, bound))


def _summit(ends: Floats, values: Floats) -> Floats:
    """The share of each interval at which its cubic has a highest point; 0.5 where it has none."""
    width = ends[1] - ends[0]
    rise, first, last = values[1, 0] - values[0, 0], width * values[0, 1], width * values[1, 1]
    a, b = 3.0 * (first + last - 2.0 * rise), 2.0 * (3.0 * rise - 2.0 * first - last)  # slope a x^2 + b x + first
    root = np.sqrt(np.maximum(b * b - 4.0 * a * first, 0.0))
    share = 2.0 * first / (root - b)  # the root at which the slope falls through zero
    return np.asarray(np.where(np.isfinite(share) & (share > 0.0) & (share < 1.0), share, 0.5))


def _cubic(ends: Floats, values: Floats, share: Floats) -> Floats:
    width, rest = ends[1] - ends[0], 1.0 - share
    slopes = width * share * rest * (rest * values[0, 1] - share * values[1, 1])
    straight = rest * values[0, 0] + share * values[1, 0]
    return np.asarray(straight + share * rest * (rest - share) * (values[0, 0] - values[1, 0]) + slopes)
