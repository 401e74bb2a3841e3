"""What a transform does at high frequency, and so what its signal does at its first instants and after each delay.

A quotient of quasi-polynomials expands at s -> infinity into terms ``c s**-v exp(-d s)``. Each is, in time, the
singular function c (t - d)^(v-1) / Gamma(v): a jump for v = 1, infinite slope or value for fractional v. Taken out of
the transform, they leave a smooth remainder that few samples describe. They are taken out as
``c (s + b)**-v exp(-d s)``, with b as fast as the loop, because these die out.
"""

from __future__ import annotations

import heapq
import math
from dataclasses import dataclass

import numpy as np

from fopid_core.model.arrays import Complexes, Floats
from fopid_core.model.quasipolynomial import Points, QuasiPolynomial, Term

_MOST_TERMS = 400
_LOG_NEGLIGIBLE = math.log(1e-12)
_ROUNDING = 1e-12
_DEAD = 400.0  # exp(-400): nothing is left, whatever power of t it is multiplied by
_DIGITS = 12  # as in QuasiPolynomial: to so many digits sums of orders are exact


def leading_term(function: QuasiPolynomial) -> Term:
    """The undelayed term of highest order."""
    return max((t for t in function.terms if t.delay == function.lowest_delay), key=lambda t: t.order)


def fast_rate(characteristic: QuasiPolynomial) -> float:
    """The frequency [rad/s] from which the expansion at infinity converges quickly.

    From there on the leading term is twice the sum of the undelayed terms of lower order, and not less than the sum of
    the delayed ones: their echoes are finitely many, and need only not grow.

    Examples
    --------
    >>> round(fast_rate(QuasiPolynomial.polynomial([1.0, 3.0])), 6)
    6.0
    """
    lead = leading_term(characteristic)
    sizes = [(lead.order - t.order, t.delay, abs(t.coefficient / lead.coefficient)) for t in characteristic.terms]
    level = sum(size for gap, delay, size in sizes if gap <= 0.0 and delay > lead.delay)
    undelayed = [(gap, size) for gap, delay, size in sizes if gap > 0.0 and delay == lead.delay]
    delayed = [(gap, size) for gap, delay, size in sizes if gap > 0.0 and delay > lead.delay]
    return max(_where_sum_is(undelayed, 0.5), _where_sum_is(delayed, max(1.0 - level, 0.5)))


def _where_sum_is(terms: list[tuple[float, float]], value: float) -> float:
    """The w at which the sum of ``size * w**-gap`` falls to a value; 0 without terms."""
    if not terms:
        return 0.0
    low = max(math.log(size / value) / gap for gap, size in terms)
    high = max(math.log(len(terms) * size / value) / gap for gap, size in terms)
    for _ in range(60):
        middle = 0.5 * (low + high)
        larger = sum(size * math.exp(max(-gap * middle, -700.0)) for gap, size in terms) > value
        low, high = (middle, high) if larger else (low, middle)
    return math.exp(min(high, 600.0))


def expansion_at_infinity(
    numerator: QuasiPolynomial, denominator: QuasiPolynomial, lowest_order: float, longest_delay: float, rate: float
) -> QuasiPolynomial:
    """Terms of numerator / denominator for s -> infinity, by long division.

    Parameters
    ----------
    numerator, denominator : QuasiPolynomial
        The denominator must have an undelayed term of its highest order (retarded or neutral type).
    lowest_order : float
        Powers of s below this are left out.
    longest_delay : float
        Delays [s] above this are left out.
    rate : float
        The frequency [rad/s] at which terms are compared with the largest and left out when negligible.

    Examples
    --------
    >>> one, d = QuasiPolynomial.constant(1.0), QuasiPolynomial.polynomial([1.0, 1.0])
    >>> str(expansion_at_infinity(one, d, -3.0, 0.0, 1.0))
    's^-1 - s^-2 + s^-3'
    """
    lead = leading_term(denominator)
    monic = denominator.scaled(1.0 / lead.coefficient).shifted(-lead.order, -lead.delay)
    rest = [t for t in monic.terms if (t.order, t.delay) != (0.0, 0.0)]
    division = _Division(lowest_order, longest_delay, rate)
    for t in numerator.scaled(1.0 / lead.coefficient).shifted(-lead.order, -lead.delay).terms:
        division.add(t.order, t.delay, t.coefficient)
    quotient: list[Term] = []
    while len(quotient) < _MOST_TERMS and (term := division.pop()) is not None:
        quotient.append(term)
        for t in rest:
            division.add(term.order + t.order, term.delay + t.delay, -term.coefficient * t.coefficient)
    return QuasiPolynomial.of(quotient)


class _Division:
    """The remainder of a long division: its terms, largest power first."""

    def __init__(self, lowest_order: float, longest_delay: float, rate: float) -> None:
        self._lowest, self._longest, self._log_rate = lowest_order, longest_delay, math.log(rate)
        self._largest = -math.inf
        self._heap: list[tuple[float, float]] = []
        self._coefficients: dict[tuple[float, float], float] = {}

    def add(self, order: float, delay: float, coefficient: float) -> None:
        if order < self._lowest or delay > self._longest:
            return
        key = (-round(order, _DIGITS), round(delay, _DIGITS))
        if key not in self._coefficients:
            heapq.heappush(self._heap, key)
        self._coefficients[key] = self._coefficients.get(key, 0.0) + coefficient

    def pop(self) -> Term | None:
        while self._heap:
            key = heapq.heappop(self._heap)
            term = Term(-key[0], key[1], self._coefficients.pop(key))
            if term.coefficient == 0.0:
                continue
            log_size = math.log(abs(term.coefficient)) + term.order * self._log_rate
            self._largest = max(self._largest, log_size)
            if log_size > self._largest + _LOG_NEGLIGIBLE:
                return term
        return None


@dataclass(frozen=True)
class PowerSeries:
    """Sum over j of ``coefficients[j] (s + b)**-(power + j) exp(-delay s)``: powers one apart, evaluated together."""

    delay: float
    power: float
    coefficients: Floats

    def transform(self, moved: Points) -> Complexes:
        """Its transform but for the delay, at ``moved`` = s + b."""
        inverse = moved.power(-1.0)
        value = np.zeros_like(inverse)
        for coefficient in self.coefficients[::-1]:
            value *= inverse
            value += coefficient
        whole = math.floor(self.power)
        value *= inverse**whole
        fraction = round(self.power - whole, _DIGITS)
        return value * moved.power(-fraction) if fraction else value

    def signal(self, elapsed: Floats) -> Floats:
        """Its signal but for the decay, at times above 0 since the delay."""
        from scipy.special import rgamma

        polynomial = self.coefficients * rgamma(self.power + np.arange(self.coefficients.size))
        value: Floats = elapsed ** (self.power - 1.0) * np.polyval(polynomial[::-1], elapsed)
        return value

    def singularity(self) -> tuple[float, float]:
        """Its strongest power below 1 and that one's sign in time (1 and 0 when it has none)."""
        from scipy.special import rgamma

        powers = self.power + np.arange(self.coefficients.size)
        strong = np.flatnonzero((powers < 1.0) & (self.coefficients != 0.0) & (rgamma(powers) != 0.0))
        if strong.size == 0:
            return 1.0, 0.0
        first = int(strong[0])
        return float(powers[first]), float(np.sign(self.coefficients[first] * rgamma(powers[first])))

    def jump(self) -> float:
        """The coefficient of the power 1."""
        step = 1.0 - self.power
        whole = step.is_integer() and 0 <= step < self.coefficients.size
        return float(self.coefficients[int(step)]) if whole else 0.0


@dataclass(frozen=True)
class SingularPart:
    """A sum of ``c (s + b)**-v exp(-d s)`` and the signal it stands for.

    Attributes
    ----------
    rate : float
        b [1/s].
    series : tuple of PowerSeries
        The terms, those with powers one apart together.
    """

    rate: float
    series: tuple[PowerSeries, ...]

    @staticmethod
    def of(expansion: QuasiPolynomial, rate: float, highest_power: float) -> SingularPart:
        """The same powers of s written in ``s + rate``, up to ``(s + rate)**-highest_power``."""
        rungs: dict[tuple[float, float], dict[int, float]] = {}
        for term in expansion.terms:
            power, coefficient = -term.order, term.coefficient
            fraction = round(power - math.floor(power), _DIGITS) % 1.0
            own = rungs.setdefault((term.delay, fraction), {})
            for j in range(int(highest_power - power) + 1):
                rung = round(power - fraction) + j
                own[rung] = own.get(rung, 0.0) + coefficient
                coefficient *= (power + j) * rate / (j + 1)
        series = []
        for (delay, fraction), own in rungs.items():
            lowest = min(own)
            coefficients = np.array([own.get(rung, 0.0) for rung in range(lowest, max(own) + 1)])
            series.append(PowerSeries(delay, lowest + fraction, coefficients))
        return SingularPart(rate, tuple(series))

    def transform(self, points: Points) -> Complexes:
        """Its value at points."""
        total, moved = np.zeros_like(points.s), points.shifted(self.rate)
        for delay in {one.delay for one in self.series}:
            value = sum(one.transform(moved) for one in self.series if one.delay == delay)
            total += value * points.delayed(delay) if delay else value
        return total

    def signal(self, time: Floats) -> Floats:
        """Its value for t > 0; at 0 and at the delays, to rounding, the limit from the right."""
        total = np.zeros_like(time)
        for delay in {one.delay for one in self.series}:
            own = [one for one in self.series if one.delay == delay]
            elapsed = time - delay
            after, at = elapsed > _ROUNDING * delay, np.abs(elapsed) <= _ROUNDING * delay
            after &= self.rate * elapsed < _DEAD
            since = elapsed[after]
            total[after] += np.exp(-self.rate * since) * sum(one.signal(since) for one in own)
            if at.any():
                total[at] += _right_limit(own)
        return total


def _right_limit(series: list[PowerSeries]) -> float:
    """The limit of their sum at its delay: the strongest singularity decides."""
    power, sign = min(one.singularity() for one in series)
    return sign * math.inf if power < 1.0 else sum(one.jump() for one in series)
