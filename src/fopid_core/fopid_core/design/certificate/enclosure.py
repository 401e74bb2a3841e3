"""What a loop does on a piece of frequency and a cell of parameters, enclosed by ball arithmetic (Johansson 2017).

With L = F / O, f = O + F and a bound X on abs(A / f), two real functions must stay positive: Re(f conj(u)) and
X Re(f conj(u)) - Re(A conj(v)), with u and v the directions of f and A in the middle; the second by more than
Im(A conj(v))^2 / (2 Re(A conj(v))), by which abs(A) may be longer than Re(A conj(v)). Both are linear in the terms,
those that f and A share taken together. The mean value theorem bounds them from below: the value in the middle, less
the enclosed slope along each axis times half the width. Before that all is divided by w^nu, with nu the local slope of
abs(f) on logarithmic axes, so that mere growth does not count.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

from flint import acb, arb

from fopid_core.design.certificate.cell_terms import CellTerm, ball, ball_term, over_cell, range_over
from fopid_core.design.certificate.family import Family, FamilyTerm, Linear, decimal
from fopid_core.model.fopid import Fopid

Cell = tuple[tuple[Fraction, Fraction], ...]
SENSITIVITY, COMPLEMENTARY, NOISE = range(3)
_SPARE = 1.01  # what is proved here shall be proved by the checker as well, whose balls may be a little larger


@dataclass(frozen=True)
class Bounds:
    """What shall be proved beside stability; None for nothing.

    Attributes
    ----------
    ms_max, mt_max : float or None
        Bounds on max |S| and max |T|.
    noise_max : float or None
        Bound on |C S|, from measurement noise to control.
    noise_band : float or None
        Up to which frequency that holds [rad/s]; None for all frequencies.
    """

    ms_max: float | None = None
    mt_max: float | None = None
    noise_max: float | None = None
    noise_band: float | None = None

    def wanted(self, low: float) -> list[tuple[int, arb]]:
        """Which function is bounded by what, from a frequency on."""
        all_bounds = [(SENSITIVITY, self.ms_max), (COMPLEMENTARY, self.mt_max)]
        if self.noise_band is None or low < self.noise_band:
            all_bounds.append((NOISE, self.noise_max))
        return [(which, ball(decimal(bound))) for which, bound in all_bounds if bound is not None]


@dataclass(frozen=True)
class Attempt:
    """What came of one piece.

    Attributes
    ----------
    direction : complex
        Of f in the middle; 0 where unknown.
    closed : bool
        f keeps to the half-plane of that direction and all bounds hold, on the whole piece and cell.
    broken : int or None
        The function that breaks its bound in the middle of both, for certain.
    drifts : tuple of float
        By how much the frequency and each parameter spoil the worst function, over its value in the middle.
    """

    direction: complex
    closed: bool
    broken: int | None = None
    drifts: tuple[float, ...] = ()


@dataclass(frozen=True)
class _Test:
    """A function that must be positive, more than by something to spare.

    Its value in the middle, its value and slopes all over a piece.
    """

    which: int | None
    middle: arb
    everywhere: arb
    slopes: list[arb]
    spare: arb


class LoopEnclosure:
    """A family of processes under one controller."""

    def __init__(self, family: Family, controller: Fopid, bounds: Bounds) -> None:
        self.family, self.controller, self.bounds = family, controller, bounds
        kp, ki, kd, lam, mu = (decimal(value) for value in controller.gains)
        lam = lam if ki else Fraction(0)
        gains = [(kp, lam), (ki, Fraction(0)), (kd, lam + mu)]
        opened = [_multiplied(term, Fraction(1), lam) for term in family.denominator]
        forward = [_multiplied(term, c, order) for c, order in gains if c for term in family.numerator]
        weighted = [_multiplied(term, c, order) for c, order in gains if c for term in family.denominator]
        self.functions = (opened, forward, weighted)
        self.balls = [[ball_term(term) for term in terms] for terms in self.functions]
        self.characteristic = _collected([*opened, *forward])
        self.quarter = arb.pi() / 2

    def over(self, cell: Cell) -> CellEnclosure:
        """The loop over a cell."""
        return CellEnclosure(self, cell)

    @property
    def undelayed(self) -> list[FamilyTerm]:
        """The terms of f without delay."""
        return [term for term in self.characteristic if not any(term.delay)]


class CellEnclosure:
    """The loop over a cell of the parameters."""

    def __init__(self, loop: LoopEnclosure, cell: Cell) -> None:
        self.loop, self.cell = loop, cell
        self.middle = tuple((low + high) / 2 for low, high in cell)
        self.sides = [ball(low).union(ball(high)) for low, high in cell]
        self.halves = [ball((high - low) / 2) for low, high in cell]
        points = [ball(value) for value in self.middle]
        self._wide = [[over_cell(term, self.sides) for term in terms] for terms in loop.balls]
        self._thin = [[over_cell(term, points) for term in terms] for terms in loop.balls] if cell else self._wide
        self._highest = max(part.order.mid() for part in self._wide[SENSITIVITY])

    def attempt(self, low: float, high: float) -> Attempt:
        """One piece between two frequencies."""
        first, last = ball(decimal(low)), ball(decimal(high))
        centre = (first * last).sqrt().mid()
        log_centre = centre.log()
        step = (first / centre).log().union((last / centre).log())
        wanted = self.loop.bounds.wanted(low)
        used = {SENSITIVITY, COMPLEMENTARY, *(which for which, _ in wanted)}
        thin = {i: self._sum(self._thin[i], log_centre, arb(0), arb(0)) for i in used}
        f = [a + b for a, b in zip(thin[0], thin[1], strict=True)]
        if not abs(f[0]) > 0:
            return Attempt(0j, False)
        growth = min(max((f[1] / f[0]).real.mid(), arb(0)), self._highest)
        direction = f[0].mid()
        wide = {i: self._sum(self._wide[i], log_centre, step, growth) for i in used}
        g = [a + b for a, b in zip(wide[0], wide[1], strict=True)]
        turned = [(direction.conjugate() * value).real for value in g]
        tests = [_Test(None, (direction.conjugate() * f[0]).real, turned[0], turned[1:], arb(0))]
        ahead = direction.conjugate() / abs(direction)
        for which, bound in wanted:
            own, turn = wide[which], _turn(thin[which][0])
            weights = {SENSITIVITY: bound * ahead, COMPLEMENTARY: bound * ahead}
            weights[which] = weights.get(which, acb(0)) - turn
            middle, *slopes = (
                sum((weight * (thin if k == 0 else wide)[i][k] for i, weight in weights.items()), start=acb(0)).real
                for k in range(len(g))
            )
            everywhere = bound * g[0].abs_lower() - own[0].abs_upper()
            tests.append(_Test(which, middle, everywhere, slopes, _sagitta(turn * own[0])))
        return _judged(_unit(direction), tests, [step.abs_upper(), *self.halves])

    def _sum(self, parts: list[CellTerm], log_centre: arb, step: arb, growth: arb) -> list[acb]:
        """A function over w^growth, and its slopes along ln w and the parameters; at the centre where the step is 0."""
        w = (log_centre + step).exp()
        quarter = self.loop.quarter
        log_s = acb(log_centre + step, quarter)
        total = [acb(0)] * (2 + len(self.cell))
        for part in parts:
            slope = part.order - growth
            power = acb(part.order * log_centre + slope * step, part.order * quarter - part.delay * w).exp()
            value = power * part.size
            total[0] += value
            total[1] += value * acb(slope, -part.delay * w)
            for i, (change, order, delay) in enumerate(part.rates):
                total[i + 2] += power * change + value * (log_s * order - acb(0, w * delay))
        return total

    def broken_all_over(self, frequency: float, which: int) -> bool:
        """Whether a function breaks its bound at a frequency for every process of the cell."""
        log_w = ball(decimal(frequency)).log()
        bound = dict(self.loop.bounds.wanted(frequency))[which]
        wide = {i: self._sum(self._wide[i], log_w, arb(0), arb(0)) for i in {SENSITIVITY, COMPLEMENTARY, which}}
        return bool(_squared(wide[which][0]) > bound**2 * _squared(wide[0][0] + wide[1][0]))

    def origin(self, high: float) -> Attempt:
        """All of 0 < w <= high."""
        end = ball(decimal(high))
        up_to_end = arb(0.5, 0.5)
        sums = []
        for terms, parts in zip(self.loop.functions, self._wide, strict=True):
            total = acb(0)
            for term, part in zip(terms, parts, strict=True):
                size = part.size
                if any(term.order):
                    if not part.order > 0:
                        return Attempt(0j, False)
                    size = size * (part.order * end.log()).exp().abs_upper() * up_to_end
                total += size * acb(0, part.order * self.loop.quarter - part.delay * end * up_to_end).exp()
            sums.append(total)
        f = sums[0] + sums[1]
        held = all(bound * f.abs_lower() > sums[which].abs_upper() for which, bound in self.loop.bounds.wanted(0.0))
        direction = 1.0 if f.real > 0 else -1.0 if f.real < 0 else 0.0
        return Attempt(complex(direction), held and direction != 0.0)

    def leading(self) -> FamilyTerm | None:
        """The undelayed term of f of the highest order in the middle of the cell."""
        candidates = self.loop.undelayed
        return max(candidates, key=lambda term: _at(term.order, self.middle)) if candidates else None

    def top_order(self) -> float:
        """Its order in the middle of the cell."""
        lead = self.leading()
        return float(_at(lead.order, self.middle)) if lead else math.nan

    def tail(self, low: float) -> Attempt:
        """All of w >= low, and of the right half-plane beyond."""
        lead = self.leading()
        if lead is None or low < 1.0:
            return Attempt(0j, False)
        size = over_cell(ball_term(lead), self.sides).size
        others = self._share([term for term in self.loop.characteristic if term is not lead], lead, size, low)
        if others is None or not others < 1 or not abs(size) > 0:
            return Attempt(0j, False)
        for which, bound in self.loop.bounds.wanted(low):
            own = self._share(self.loop.functions[which], lead, size, low)
            if own is None or not own < bound * (1 - others):
                return Attempt(0j, False)
        sign = 1.0 if size > 0 else -1.0
        angle = 0.5 * math.pi * self.top_order()
        return Attempt(sign * complex(math.cos(angle), math.sin(angle)), True)

    def _share(self, terms: Sequence[FamilyTerm], lead: FamilyTerm, size: arb, low: float) -> arb | None:
        """A bound on the sum of terms over the leading one, from a frequency on; None when there is none."""
        log_w = ball(decimal(low)).log()
        total = arb(terms.count(lead))
        for term in terms:
            if term == lead:
                continue
            gap = range_over([ball(a - b) for a, b in zip(lead.order, term.order, strict=True)], self.sides)
            if not gap >= 0:
                return None
            part = over_cell(ball_term(term), self.sides).size
            total += part.abs_upper() / size.abs_lower() * (-gap * log_w).exp()
        return total


def _judged(direction: complex, tests: list[_Test], reach: list[arb]) -> Attempt:
    worst, drifts = 0.0, (0.0,) * len(reach)
    for test in tests:
        spoilt = [slope.abs_upper() * r for slope, r in zip(test.slopes, reach, strict=True)]
        drift = sum(spoilt, start=arb(0))
        if test.middle > _SPARE * (drift + test.spare) or test.everywhere > 0:
            continue
        scale = (1 + test.spare / drift) / test.middle if drift > 0 else arb("inf")
        shares = tuple(float((part * scale).abs_upper()) for part in spoilt)
        if test.middle < 0 and test.which is not None:
            return Attempt(direction, False, test.which, shares)
        if not sum(shares) <= worst:
            worst, drifts = sum(shares), shares
    return Attempt(direction, worst == 0.0, None, drifts)


def _unit(value: acb) -> complex:
    return complex(value / value.abs_upper())


def _at(form: Linear, values: Sequence[Fraction]) -> Fraction:
    return form[0] + sum((a * v for a, v in zip(form[1:], values, strict=True)), start=Fraction(0))


def _multiplied(term: FamilyTerm, factor: Fraction, order: Fraction) -> FamilyTerm:
    coefficient = {powers: factor * number for powers, number in term.coefficient.items()}
    return FamilyTerm(coefficient, (term.order[0] + order, *term.order[1:]), term.delay)


def _collected(terms: Sequence[FamilyTerm]) -> list[FamilyTerm]:
    """Like terms together, those that cancel left out."""
    sums: dict[tuple[Linear, Linear], dict[tuple[int, ...], Fraction]] = {}
    for term in terms:
        own = sums.setdefault((term.order, term.delay), {})
        for powers, number in term.coefficient.items():
            own[powers] = own.get(powers, Fraction(0)) + number
    return [FamilyTerm(own, *key) for key, own in sums.items() if any(own.values())]


def _turn(value: acb) -> acb:
    """What turns a number to the positive axis; 1 for one that may be 0."""
    return value.conjugate() / abs(value) if abs(value) > 0 else acb(1)


def _sagitta(value: acb) -> arb:
    """By how much a number is longer than its real part, at most."""
    if value.real > 0:
        return value.imag.abs_upper() ** 2 / (2 * value.real.lower())
    return value.abs_upper() - value.real.lower()


def _squared(value: acb) -> arb:
    return value.real**2 + value.imag**2
