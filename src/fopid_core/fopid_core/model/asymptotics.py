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
from fopid_core.model.quasipolynomial import QuasiPolynomial, Term

_MOST_TERMS = 400
_LOG_NEGLIGIBLE = math.log(1e-12)
_ROUNDING = 1e-12
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
class SingularPart:
    """A sum of ``c (s + b)**-v exp(-d s)`` and the signal it stands for.

    Attributes
    ----------
    rate : float
        b [1/s].
    coefficients, powers, delays : ndarray, shape (m,)
        c, v and d [s]; powers ascending.
    """

    rate: float
    coefficients: Floats
    powers: Floats
    delays: Floats

    @staticmethod
    def of(expansion: QuasiPolynomial, rate: float, highest_power: float) -> SingularPart:
        """The same powers of s written in ``s + rate``, up to ``(s + rate)**-highest_power``."""
        merged: dict[tuple[float, float], float] = {}
        for term in expansion.terms:
            power, coefficient = -term.order, term.coefficient
            for j in range(int(highest_power - power) + 1):
                key = (round(power + j, _DIGITS), term.delay)
                merged[key] = merged.get(key, 0.0) + coefficient
                coefficient *= (power + j) * rate / (j + 1)
        rows = sorted((p, d, c) for (p, d), c in merged.items() if c)
        powers, delays, coefficients = np.array(rows).reshape(-1, 3).T
        return SingularPart(rate, coefficients, powers, delays)

    def transform(self, s: Complexes) -> Complexes:
        """Its value at every element of ``s``."""
        log_sigma = np.log(s + self.rate)
        total = np.zeros_like(s)
        for c, power, delay in zip(self.coefficients, self.powers, self.delays, strict=True):
            total += c * np.exp(-power * log_sigma - delay * s)
        return total

    def signal(self, time: Floats) -> Floats:
        """Its value for t > 0; at 0 and at the delays, to rounding, the limit from the right."""
        total = np.zeros_like(time)
        for delay in np.unique(self.delays):
            own = self.delays == delay
            elapsed = time - delay
            after, at = elapsed > _ROUNDING * delay, np.abs(elapsed) <= _ROUNDING * delay
            for c, power in zip(self.coefficients[own], self.powers[own], strict=True):
                total[after] += c * _power_law(elapsed[after], power) * np.exp(-self.rate * elapsed[after])
            total[at] += _right_limit(self.coefficients[own], self.powers[own])
        return total


def _power_law(elapsed: Floats, power: float) -> Floats:
    from scipy.special import rgamma

    values: Floats = elapsed ** (power - 1.0) * rgamma(power)
    return values


def _right_limit(coefficients: Floats, powers: Floats) -> float:
    """The limit at t -> 0+ of terms in ascending powers: the strongest singularity decides."""
    from scipy.special import rgamma

    for c, power in zip(coefficients, powers, strict=True):
        if power < 1.0 and rgamma(power) != 0.0:
            return math.copysign(math.inf, c * rgamma(power))
    return float(coefficients[powers == 1.0].sum())
