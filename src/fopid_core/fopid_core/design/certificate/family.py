"""A family of processes: quasi-polynomials whose coefficients, orders and delays depend on parameters in a box.

A process without parameters is a family of one. A number stands for its shortest decimal, here as in the certificate.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from fractions import Fraction

from fopid_core.errors import InputError
from fopid_core.model.process import Process
from fopid_core.model.quasipolynomial import QuasiPolynomial, Term

Powers = tuple[int, ...]
Linear = tuple[Fraction, ...]

BOX, BALL = "box", "ball"


def decimal(value: float) -> Fraction:
    """The shortest decimal that reads back as the same number, exactly.

    Examples
    --------
    >>> decimal(0.1)
    Fraction(1, 10)
    """
    return Fraction(repr(float(value)))


@dataclass(frozen=True)
class FamilyTerm:
    """``coefficient * s**order * exp(-delay * s)`` as functions of n parameters.

    Attributes
    ----------
    coefficient : mapping
        A polynomial: its coefficients by the powers of the parameters, tuples of length n.
    order, delay : tuple of Fraction, shape (1 + n,)
        Linear: a constant, and a factor for each parameter.
    """

    coefficient: Mapping[Powers, Fraction]
    order: Linear
    delay: Linear

    def at(self, values: Iterable[float]) -> Term:
        """The term for values of the parameters."""
        x = [Fraction(value) for value in values]
        size = sum(
            (c * math.prod((v**p for v, p in zip(x, powers, strict=True)), start=Fraction(1)))
            for powers, c in self.coefficient.items()
        )
        order, delay = (
            form[0] + sum(a * v for a, v in zip(form[1:], x, strict=True)) for form in (self.order, self.delay)
        )
        return Term(float(order), float(delay), float(size))


@dataclass(frozen=True)
class Family:
    """All processes with parameters in a box, or in the unit ball in it.

    Attributes
    ----------
    numerator, denominator : tuple of FamilyTerm
    names : tuple of str
    sides : tuple of (low, high)
        The range of each parameter.
    region : str
        ``box``; or ``ball``: only parameters with a sum of squares up to 1 belong to the family.

    Examples
    --------
    >>> family = Family.of(Process.parse("2/(s+1)*exp(-0.5s)"))
    >>> str(family.at(()))
    '2/(s + 1) * exp(-0.5s)'
    """

    numerator: tuple[FamilyTerm, ...]
    denominator: tuple[FamilyTerm, ...]
    names: tuple[str, ...] = ()
    sides: tuple[tuple[float, float], ...] = ()
    region: str = BOX

    def __post_init__(self) -> None:
        for name, (low, high) in zip(self.names, self.sides, strict=True):
            if not (math.isfinite(low) and math.isfinite(high) and low < high):
                raise InputError(f"box {name} = {low:g},{high:g}; allowed: LOW,HIGH with LOW < HIGH, both finite")

    @staticmethod
    def of(process: Process) -> Family:
        """The family that is one process."""
        return Family(_terms(process.numerator), _terms(process.denominator))

    def behind(self, lag: QuasiPolynomial) -> Family:
        """The processes over a polynomial in s, such as that of the measurement's filter."""
        terms = [
            FamilyTerm(
                {powers: decimal(factor.coefficient) * c for powers, c in term.coefficient.items()},
                (term.order[0] + decimal(factor.order), *term.order[1:]),
                term.delay,
            )
            for term in self.denominator
            for factor in lag.terms
        ]
        sums: dict[tuple[Linear, Linear], dict[Powers, Fraction]] = {}
        for term in terms:
            own = sums.setdefault((term.order, term.delay), {})
            for powers, number in term.coefficient.items():
                own[powers] = own.get(powers, Fraction(0)) + number
        return replace(self, denominator=tuple(FamilyTerm(own, *key) for key, own in sums.items()))

    def at(self, values: Iterable[float]) -> Process:
        """A member of the family."""
        x = tuple(values)
        parts = (QuasiPolynomial.of(term.at(x) for term in terms) for terms in (self.numerator, self.denominator))
        return Process(*parts)


def _terms(function: QuasiPolynomial) -> tuple[FamilyTerm, ...]:
    return tuple(
        FamilyTerm({(): decimal(t.coefficient)}, (decimal(t.order),), (decimal(t.delay),)) for t in function.terms
    )
