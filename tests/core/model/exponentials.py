"""Step responses of loops of whole orders with delay as sums of polynomials times exponentials, in ball arithmetic.

Between the echoes of a step the signals are those of ``start forward^k / (s opened^(k+1))``. Its poles are those of the
process's factors, which are known as they are written; each residue is a coefficient of a Taylor series at the pole.
However stiff the lags, however many the delays: only the number of digits grows.
"""

from __future__ import annotations

import math
from fractions import Fraction

from flint import acb, acb_series, arb, ctx, fmpq

from .random_loops import Polynomial, RandomLoop
from .response_oracles import InTime, Parts, Signal, Source, times

_MOST_DELAYS = 100
_MOST_ORDER = 400  # of all poles together; where they are complex, a quarter of that
_BITS = 500
_BITS_PER_DELAY = 60
_WORST = 1e-13


def by_exponentials(case: RandomLoop, source: Source, signal: Signal) -> InTime | None:
    """A signal after a unit step as a function of time; None where it takes too long."""
    count = math.floor(case.horizon / float(case.delay)) + 1
    parts = Parts.of(case, source, signal)
    if count > _MOST_DELAYS or parts.base != 1:
        return None
    bits = _BITS + _BITS_PER_DELAY * count
    with ctx.workprec(bits):
        poles = _poles(case)
        pairs = 4 if any(pole.imag != 0 for pole, _ in poles) else 1
        if pairs * count * sum(multiplicity for _, multiplicity in poles) > _MOST_ORDER:
            return None
        rows = [_row(parts, poles, k) for k in range(count)]

    def in_time(time: float) -> float:
        with ctx.workprec(bits):
            total = arb(0)
            for k, row in enumerate(rows):
                since = _ball(Fraction(time) - (k + parts.late) * case.delay)
                if not since > 0:
                    break
                for pole, coefficients in row:
                    value = acb(0)
                    for c in reversed(coefficients):
                        value = value * since + c
                    total += (value * (pole * since).exp()).real * (-1) ** k
            assert float(total.rad()) < _WORST * max(1.0, abs(float(total.mid()))), "the oracle wants more digits"
            return float(total.mid())

    return in_time


def _poles(case: RandomLoop) -> list[tuple[acb, int]]:
    """Those of ``opened``, with their multiplicities; the integrator's at 0 first."""
    integrators = int(min(times(*case.denominator, {Fraction(int(bool(case.gains[1]))): Fraction(1)})))
    found: dict[tuple[tuple[Fraction, Fraction], ...], int] = {}
    for factor in case.denominator:
        key = tuple(sorted(factor.items()))
        found[key] = found.get(key, 0) + 1
    poles: list[tuple[acb, int]] = [(acb(0), integrators)]
    for key, multiplicity in found.items():
        factor = dict(key)
        if max(factor) == 1:
            if factor.get(Fraction(0)):
                poles.append((acb(_ball(-factor[Fraction(0)] / factor[Fraction(1)])), multiplicity))
            continue
        half = _ball(-factor.get(Fraction(1), Fraction(0)) / 2 / factor[Fraction(2)])
        square = half * half - _ball(factor[Fraction(0)] / factor[Fraction(2)])
        root = acb(square).sqrt()
        poles += [(half + root, multiplicity), (half - root, multiplicity)]
    return poles


def _row(parts: Parts, poles: list[tuple[acb, int]], k: int) -> list[tuple[acb, list[acb]]]:
    """``start forward^k / (s opened^(k+1))``: at each pole the polynomial in time that stands before exp(p t)."""
    lead = _ball(parts.opened[max(parts.opened)])
    row = []
    for i, (pole, multiplicity) in enumerate(poles):
        order = multiplicity * (k + 1) + (1 if i == 0 else 0)
        if not order:
            continue
        ctx.cap = order
        over = _taylor(parts.start, pole, order) * _power(_taylor(parts.forward, pole, order), k, order)
        under = acb_series([lead], order)
        for j, (other, its) in enumerate(poles):
            if j != i:
                under = under * _power(acb_series([pole - other, 1], order), its, order)
        under = _power(under, k + 1, order)
        if i:  # at 0, s is the pole's own
            under = under * acb_series([pole, 1], order)
        series = (over / under).coeffs()
        series = series + [acb(0)] * (order - len(series))
        row.append((pole, [series[order - 1 - n] / math.factorial(n) for n in range(order)]))
    return row


def _taylor(polynomial: Polynomial, at: acb, order: int) -> acb_series:
    total = acb_series([0], order)
    for q, c in polynomial.items():
        total = total + _power(acb_series([at, 1], order), int(q), order) * _ball(c)
    return total


def _power(series: acb_series, exponent: int, order: int) -> acb_series:
    result = acb_series([1], order)
    while exponent:
        if exponent & 1:
            result = result * series
        series = series * series
        exponent >>= 1
    return result


def _ball(value: Fraction) -> arb:
    return arb(fmpq(value.numerator, value.denominator))
