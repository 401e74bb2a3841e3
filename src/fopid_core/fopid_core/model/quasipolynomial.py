"""Quasi-polynomials: sums of ``coefficient * s**order * exp(-delay * s)``.

Numerators and denominators of fractional processes with delay are quasi-polynomials, and so is every
sum and product of them. They are therefore closed under series, parallel and feedback connection.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from fopid_core.model.arrays import Complexes, Floats

_CANCELLED = 1e-14  # of the sum of their sizes: less is left of terms that cancel each other
_ORDER_DIGITS = 12  # orders (and delays) closer than 1e-12 are the same: sums of decimals are not exact


@dataclass(frozen=True, order=True)
class Term:
    """One summand ``coefficient * s**order * exp(-delay * s)``."""

    order: float
    delay: float
    coefficient: float


@dataclass(frozen=True)
class QuasiPolynomial:
    """A sum of terms, highest order first, none of them zero, no two alike.

    Examples
    --------
    >>> s = QuasiPolynomial.monomial(1.0, order=1)
    >>> one = QuasiPolynomial.constant(1.0)
    >>> str((s + one) ** 2)
    's^2 + 2 s + 1'
    """

    terms: tuple[Term, ...]

    @staticmethod
    def of(terms: Iterable[Term]) -> QuasiPolynomial:
        """Merge like terms and put them in order."""
        merged: dict[tuple[float, float], float] = {}
        for term in terms:
            key = (round(term.order, _ORDER_DIGITS), round(term.delay, _ORDER_DIGITS))
            merged[key] = merged.get(key, 0.0) + term.coefficient
        kept = [Term(order, delay, c) for (order, delay), c in merged.items() if c != 0.0]
        return QuasiPolynomial(tuple(sorted(kept, key=lambda t: (-t.order, t.delay))))

    @staticmethod
    def constant(value: float) -> QuasiPolynomial:
        """The number ``value``."""
        return QuasiPolynomial.monomial(value)

    @staticmethod
    def monomial(coefficient: float, order: float = 0.0, delay: float = 0.0) -> QuasiPolynomial:
        """The single term ``coefficient * s**order * exp(-delay * s)``."""
        return QuasiPolynomial.of([Term(float(order), float(delay), float(coefficient))])

    @staticmethod
    def polynomial(coefficients: Iterable[float]) -> QuasiPolynomial:
        """A polynomial in s from its coefficients, highest power first."""
        values = [float(c) for c in coefficients]
        top = len(values) - 1
        return QuasiPolynomial.of(Term(float(top - i), 0.0, c) for i, c in enumerate(values))

    def __add__(self, other: QuasiPolynomial) -> QuasiPolynomial:
        return QuasiPolynomial.of(self.terms + other.terms)

    def __neg__(self) -> QuasiPolynomial:
        return self.scaled(-1.0)

    def __sub__(self, other: QuasiPolynomial) -> QuasiPolynomial:
        return self + (-other)

    def __mul__(self, other: QuasiPolynomial) -> QuasiPolynomial:
        return QuasiPolynomial.of(
            Term(a.order + b.order, a.delay + b.delay, a.coefficient * b.coefficient)
            for a in self.terms
            for b in other.terms
        )

    def __pow__(self, exponent: int) -> QuasiPolynomial:
        result = QuasiPolynomial.constant(1.0)
        for _ in range(exponent):
            result = result * self
        return result

    def scaled(self, factor: float) -> QuasiPolynomial:
        """Every coefficient times ``factor``."""
        return QuasiPolynomial.of(Term(t.order, t.delay, factor * t.coefficient) for t in self.terms)

    def shifted(self, order: float = 0.0, delay: float = 0.0) -> QuasiPolynomial:
        """The product with ``s**order * exp(-delay * s)``; either may be negative."""
        return QuasiPolynomial.of(Term(t.order + order, t.delay + delay, t.coefficient) for t in self.terms)

    def __call__(self, s: ArrayLike) -> Complexes:
        """The value at every element of ``s`` (complex, principal branch of the powers)."""
        return self.at(Points(s))

    def at(self, points: Points) -> Complexes:
        """The value at points that others are worked out at as well."""
        total = np.zeros_like(points.s)
        for delay, ladders in self._ladders.items():
            value = sum(ladder.at(points) for ladder in ladders)
            total += value * points.delayed(delay) if delay else value
        return total

    def derivative(self, s: ArrayLike) -> Complexes:
        """The derivative with respect to s, at every element of ``s`` (none of them zero)."""
        return self._derivative(s)

    @cached_property
    def _derivative(self) -> QuasiPolynomial:
        lower = [Term(t.order - 1.0, t.delay, t.order * t.coefficient) for t in self.terms]
        return QuasiPolynomial.of(lower + [Term(t.order, t.delay, -t.delay * t.coefficient) for t in self.terms])

    @cached_property
    def _ladders(self) -> dict[float, list[_Ladder]]:
        """The terms by delay, and those together whose orders are whole numbers apart."""
        bases: dict[float, float] = {}
        rungs: dict[tuple[float, float], list[Term]] = {}
        for term in self.terms:
            fraction = round(term.order % 1.0, _ORDER_DIGITS) % 1.0
            bases[fraction] = min(term.order, bases.get(fraction, math.inf))
            rungs.setdefault((term.delay, fraction), []).append(term)
        ladders: dict[float, list[_Ladder]] = {}
        for (delay, fraction), terms in rungs.items():
            ladders.setdefault(delay, []).append(_Ladder.of(terms, bases[fraction]))
        return ladders

    @property
    def is_zero(self) -> bool:
        """Whether there is no term at all."""
        return not self.terms

    @property
    def degree(self) -> float:
        """The highest order."""
        return max(t.order for t in self.terms)

    @property
    def lowest_order(self) -> float:
        """The lowest order: how often s can be taken out."""
        return min(t.order for t in self.terms)

    def sum_of_order(self, order: float) -> float:
        """The sum of the coefficients of all terms of this order, whatever their delays."""
        return sum(t.coefficient for t in self.terms if t.order == order)

    @property
    def zeros_at_origin(self) -> int:
        """How many zeros lie at s = 0, of whole orders: those that delays make, too.

        Examples
        --------
        >>> one, s = QuasiPolynomial.constant(1.0), QuasiPolynomial.monomial(1.0, order=1)
        >>> (s + one - QuasiPolynomial.monomial(1.0, delay=0.3)).zeros_at_origin  # s + 1 - exp(-0.3s) = 1.3 s - ...
        1
        """
        k = int(self.lowest_order)
        while True:
            parts = [
                t.coefficient * (-t.delay) ** (k - int(t.order)) / math.factorial(k - int(t.order))
                for t in self.terms
                if t.order <= k
            ]
            if abs(math.fsum(parts)) > _CANCELLED * sum(map(abs, parts)):
                return k
            k += 1

    @property
    def lowest_delay(self) -> float:
        """The shortest delay: how much of it can be taken out."""
        return min(t.delay for t in self.terms)

    @property
    def has_integer_orders(self) -> bool:
        """Whether every order is a whole number."""
        return all(float(t.order).is_integer() for t in self.terms)

    @property
    def has_one_delay(self) -> bool:
        """Whether all terms carry the same delay."""
        return len({t.delay for t in self.terms}) <= 1

    def coefficients(self) -> Floats:
        """Coefficients of the ordinary polynomial, highest power first (delays are left out).

        Raises
        ------
        ValueError
            If an order is not a whole number, or the terms have different delays.
        """
        if not (self.has_integer_orders and self.has_one_delay):
            raise ValueError(f"{self} is not an ordinary polynomial")
        out = np.zeros(int(self.degree) + 1 if self.terms else 1)
        for term in self.terms:
            out[len(out) - 1 - int(term.order)] = term.coefficient
        return out

    def __str__(self) -> str:
        if self.is_zero:
            return "0"
        text = _term_text(self.terms[0], first=True)
        for term in self.terms[1:]:
            text += _term_text(term, first=False)
        return text


@dataclass(frozen=True)
class _Ladder:
    """Terms whose orders are whole numbers apart: one power, the rest by Horner's scheme."""

    base: float
    steps: tuple[tuple[float, int], ...]
    """Coefficients, highest order first, and how far down the next one is; the last down to the base."""

    @staticmethod
    def of(terms: list[Term], base: float) -> _Ladder:
        """From terms with the highest order first."""
        orders = [*(term.order for term in terms), base]
        gaps = [round(high - low) for high, low in itertools.pairwise(orders)]
        return _Ladder(base, tuple(zip((term.coefficient for term in terms), gaps, strict=True)))

    def at(self, points: Points) -> Complexes:
        """Their sum, without the delay."""
        s = points.s
        value = np.zeros_like(s)
        for coefficient, gap in self.steps:
            value += coefficient
            if gap:
                value *= s if gap == 1 else s**gap
        return value * points.power(self.base) if self.base else value


class Points:
    """Points s, complex, with their powers and delays: worked out once for all that is evaluated there."""

    def __init__(self, s: ArrayLike) -> None:
        self.s: Complexes = np.asarray(s, dtype=np.complex128)
        self._powers: dict[float, Complexes] = {}
        self._delayed: dict[float, Complexes] = {}
        self._shifted: dict[float, Points] = {}

    def power(self, order: float) -> Complexes:
        """``s**order``, the principal branch."""
        if order not in self._powers:
            whole = float(order).is_integer()
            self._powers[order] = self.s ** int(order) if whole else np.exp(order * self._logarithm)
        return self._powers[order]

    @cached_property
    def _logarithm(self) -> Complexes:
        with np.errstate(divide="ignore"):
            return np.asarray(np.log(self.s))

    def delayed(self, delay: float) -> Complexes:
        """``exp(-delay s)``."""
        if delay not in self._delayed:
            self._delayed[delay] = np.exp(-delay * self.s)
        return self._delayed[delay]

    def shifted(self, rate: float) -> Points:
        """The points ``s + rate``."""
        if rate not in self._shifted:
            self._shifted[rate] = Points(self.s + rate)
        return self._shifted[rate]


def number_text(value: float) -> str:
    """The shortest decimal that reads back as the same number."""
    return repr(int(value)) if float(value).is_integer() and abs(value) < 1e15 else repr(float(value))


def _term_text(term: Term, *, first: bool) -> str:
    sign = ("-" if term.coefficient < 0 else "") if first else (" - " if term.coefficient < 0 else " + ")
    size = abs(term.coefficient)
    factors = []
    if term.order:
        factors.append("s" if term.order == 1 else f"s^{number_text(term.order)}")
    if term.delay:
        factors.append(f"exp(-{number_text(term.delay)}s)")
    if size != 1.0 or not factors:
        factors.insert(0, number_text(size))
    return sign + " ".join(factors)
