"""The terms of a family over a cell of its parameters, as balls."""

from __future__ import annotations

import math
from collections.abc import Sequence
from fractions import Fraction
from typing import NamedTuple

from flint import arb, fmpq

from fopid_core.design.certificate.family import FamilyTerm


class BallTerm(NamedTuple):
    """A term, its numbers as balls: made once, used for every cell."""

    coefficient: list[tuple[tuple[int, ...], arb]]
    order: list[arb]
    delay: list[arb]


class CellTerm(NamedTuple):
    """A term over a cell, and how fast its size, its order and its delay change along each parameter."""

    size: arb
    order: arb
    delay: arb
    rates: list[tuple[arb, arb, arb]]


def ball(value: Fraction) -> arb:
    """The smallest ball around a rational number."""
    return arb(fmpq(value.numerator, value.denominator))


def range_over(form: Sequence[arb], sides: Sequence[arb]) -> arb:
    """What a linear form takes on: a constant, and a factor for each side."""
    return sum((factor * side for factor, side in zip(form[1:], sides, strict=True)), start=form[0])


def ball_term(term: FamilyTerm) -> BallTerm:
    """A term in balls of the precision that is in force."""
    coefficient = [(powers, ball(number)) for powers, number in term.coefficient.items()]
    return BallTerm(coefficient, [ball(x) for x in term.order], [ball(x) for x in term.delay])


def over_cell(term: BallTerm, sides: Sequence[arb]) -> CellTerm:
    """A term over a cell, or at a point."""
    size, slopes = arb(0), [arb(0) for _ in sides]
    for powers, number in term.coefficient:
        factors = [_power(side, power) for side, power in zip(sides, powers, strict=True)]
        size += math.prod(factors, start=number)
        for i, power in enumerate(powers):
            if power:
                others = [factor for j, factor in enumerate(factors) if j != i]
                slopes[i] += math.prod(others, start=number * power) * _power(sides[i], power - 1)
    rates = list(zip(slopes, term.order[1:], term.delay[1:], strict=True))
    return CellTerm(size, range_over(term.order, sides), range_over(term.delay, sides), rates)


def _power(side: arb, power: int) -> arb:
    """By products: arb's own power is not a number where a side reaches from below zero to above."""
    return math.prod([side] * power, start=arb(1))
