"""Step responses by other means, in many digits, from the numbers as they are written.

Without delay: partial fractions in w = s^base, and Mittag-Leffler functions of their poles (exponentials at base 1).
With delay: the expansion in powers of 1/w and of exp(-s d), which is the method of steps. An integrator behind a delay:
residues at the poles that Lambert's function gives.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from fractions import Fraction
from functools import lru_cache

import mpmath as mp

from .random_loops import Polynomial, RandomLoop

_DIGITS = 60
_SERIES_REACH = 50  # |p|^(1/base) t up to which the power series is used
_STEPS_REACH = 100


def error_signal(case: RandomLoop) -> Callable[[float], mp.mpf] | None:
    """The error after a unit setpoint step as a function of time; None where no oracle is at hand."""
    if not case.delay:
        return without_delay(case)
    if case.kind == "delayed resonant":
        return delayed_integrator(case)
    return by_steps(case)


def product(factors: tuple[Polynomial, ...]) -> Polynomial:
    total: Polynomial = {Fraction(0): Fraction(1)}
    for factor in factors:
        new: Polynomial = {}
        for q, c in total.items():
            for r, d in factor.items():
                new[q + r] = new.get(q + r, Fraction(0)) + c * d
        total = new
    return total


def quotient(case: RandomLoop) -> tuple[Polynomial, Polynomial, Polynomial, Fraction]:
    """Error = A / (A + F exp(-d s)) / s: A, F, A + F, and the base of all orders."""
    kp, ki, kd, lam, mu = case.gains
    lam = lam if ki else Fraction(0)
    controller: Polynomial = {}
    for q, c in ((lam, kp), (Fraction(0), ki), (lam + mu, kd)):
        controller[q] = controller.get(q, Fraction(0)) + c
    opened = product((*case.denominator, {lam: Fraction(1)}))
    forward = product((*case.numerator, controller))
    closed = dict(opened)
    for q, c in forward.items():
        closed[q] = closed.get(q, Fraction(0)) + c
    opened, forward, closed = ({q: c for q, c in p.items() if c} for p in (opened, forward, closed))
    base = Fraction(1)
    for q in (*opened, *closed):
        base = Fraction(
            math.gcd(base.numerator * q.denominator, q.numerator * base.denominator), base.denominator * q.denominator
        )
    return opened, forward, closed, base


def in_w(polynomial: Polynomial, base: Fraction) -> list[mp.mpf]:
    """Coefficients in w, highest power first."""
    top = int(max(polynomial) / base)
    out = [mp.mpf(0)] * (top + 1)
    for q, c in polynomial.items():
        out[top - int(q / base)] = mp.mpf(c.numerator) / c.denominator
    return out


def polyval(coefficients: list[mp.mpf], x: mp.mpc) -> mp.mpc:
    value = mp.mpf(0)
    for c in coefficients:
        value = value * x + c
    return value


def roots(coefficients: list[mp.mpf]) -> list[mp.mpc]:
    """Highest power first, whatever order this mpmath expects."""
    if len(coefficients) < 2:
        return []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        return list(mp.polyroots(coefficients, maxsteps=2000, extraprec=600))


def without_delay(case: RandomLoop) -> Callable[[float], mp.mpf]:
    poles, residues, origin, base = partial_fractions(case)

    def error(time: float) -> mp.mpf:
        with mp.workdps(_DIGITS):
            t, a = mp.mpf(time), mp.mpf(base.numerator) / base.denominator
            total = sum((c * t ** (n * a - 1) * mp.rgamma(n * a) for n, c in enumerate(origin, 1)), mp.mpf(0))
            for p, r in zip(poles, residues, strict=True):
                total += mp.re(r * (mp.exp(p * t) if base == 1 else relaxation(base, p, t)))
            return total

    return error


def partial_fractions(case: RandomLoop) -> tuple[list[mp.mpc], list[mp.mpc], list[mp.mpf], Fraction]:
    """Of the error's transform: poles and residues in w, and the coefficients of 1/w, 1/w^2, ..."""
    with mp.workdps(_DIGITS):
        opened, _, closed, base = quotient(case)
        under = {q + 1: c for q, c in closed.items()}
        shift = min(*under, *opened)
        n, d = (in_w({q - shift: c for q, c in part.items()}, base) for part in (opened, under))
        order = 0
        while d[-1] == 0:
            d, order = d[:-1], order + 1
        poles = roots(d)
        slope = [c * (len(d) - 1 - i) for i, c in enumerate(d[:-1])]
        residues = [polyval(n, p) / (polyval(slope, p) * p**order) for p in poles]
        rising, low_n, low_d = [], n[::-1], d[::-1]
        for k in range(order):
            value = low_n[k] if k < len(low_n) else mp.mpf(0)
            value -= sum(rising[j] * low_d[k - j] for j in range(k) if k - j < len(low_d))
            rising.append(value / low_d[0])
        return poles, residues, rising[::-1], base


def relaxation(base: Fraction, p: mp.mpc, t: mp.mpf) -> mp.mpc:
    """The signal of 1 / (s^a - p): t^(a-1) E_{a,a}(p t^a)."""
    a = mp.mpf(base.numerator) / base.denominator
    z = p * t**a
    reach = abs(z) ** (1 / a)
    if reach < _SERIES_REACH:
        gammas = reciprocal_gammas(base, int(6 * _SERIES_REACH / a))
        return t ** (a - 1) * polyval(gammas[: int((3.5 * reach + 80) / a)][::-1], z)
    total = mp.mpc(0)
    if abs(mp.arg(p)) < a * mp.pi:
        total += z ** (1 / a - 1) * mp.exp(z ** (1 / a)) / a
    previous, power = mp.inf, 1 / z
    for k in range(1, 4000):
        term = -power * mp.rgamma(a - a * k)
        if term != 0:
            if abs(term) > previous and k * a > reach / 2:
                break
            previous = abs(term)
        total += term
        power /= z
        if k * a > reach:
            break
    return t ** (a - 1) * total


@lru_cache(maxsize=8)
def reciprocal_gammas(base: Fraction, count: int) -> list[mp.mpf]:
    with mp.workdps(_DIGITS):
        a = mp.mpf(base.numerator) / base.denominator
        return [mp.rgamma(a * (k + 1)) for k in range(count)]


def by_steps(case: RandomLoop) -> Callable[[float], mp.mpf] | None:
    """A / (A + F q) / s as a series in 1/w for each power of q = exp(-d s)."""
    opened, forward, _, base = quotient(case)
    count = int(case.horizon / float(case.delay)) + 1
    with mp.workdps(_DIGITS + 40):
        a, f = in_w(opened, base), in_w(forward, base)
        size = max(abs(c / a[0]) ** (1.0 / (i * float(base))) for i, c in enumerate(a) if i and c) if len(a) > 1 else 1
        if float(size) * case.horizon > _STEPS_REACH:
            return None
        length = int((4.0 * float(size) * case.horizon * 2.72 + 60.0) / float(base)) + 40
        shift = len(a) - len(f)  # F / A begins with w^-shift
        ratio = divided(f, a, length)
        rows = [[mp.mpf(1)] + [mp.mpf(0)] * (length - 1)]
        for _ in range(count):
            rows.append(recursion(rows[-1], f, a, shift, length))
        del ratio
        gammas = None
        step = int(1 / base)

        def error(time: float) -> mp.mpf:
            nonlocal gammas
            with mp.workdps(_DIGITS + 40):
                if gammas is None:
                    b = mp.mpf(base.numerator) / base.denominator
                    gammas = [mp.rgamma(b * n + 1) for n in range(length)]
                total = mp.mpf(0)
                delay = mp.mpf(case.delay.numerator) / case.delay.denominator
                for k, row in enumerate(rows):
                    since = mp.mpf(time) - k * delay
                    if since < 0:
                        break
                    x = since ** (mp.mpf(1) / step)
                    value = mp.mpf(0)
                    for c, g in zip(reversed(row), reversed(gammas), strict=True):
                        value = value * x + c * g
                    total += (-1) ** k * value
                return total

        return error


def divided(over: list[mp.mpf], under: list[mp.mpf], length: int) -> list[mp.mpf]:
    """The first coefficients of a quotient of series in 1/w that begin with w^0."""
    out: list[mp.mpf] = []
    for n in range(length):
        value = over[n] if n < len(over) else mp.mpf(0)
        value -= sum(under[j] * out[n - j] for j in range(1, min(n, len(under) - 1) + 1))
        out.append(value / under[0])
    return out


def recursion(row: list[mp.mpf], f: list[mp.mpf], a: list[mp.mpf], shift: int, length: int) -> list[mp.mpf]:
    """The row times F / A."""
    product_row = [mp.mpf(0)] * length
    for i, c in enumerate(f):
        if c:
            for n in range(length - i - shift):
                product_row[n + i + shift] += c * row[n]
    return divided(product_row, a, length)


def delayed_integrator(case: RandomLoop) -> Callable[[float], mp.mpf]:
    """s + k exp(-s d) = 0 at s = W_n(-k d) / d; the error is the sum of exp(p t) / (1 + d p), at first a polynomial."""
    kp, delay = case.gains[0], case.delay

    def error(time: float) -> mp.mpf:
        with mp.workdps(40):
            k, d, t = (mp.mpf(v.numerator) / v.denominator for v in (kp, delay, Fraction(time)))
            if t < 8 * d:
                return sum(((-k * (t - j * d)) ** j / mp.factorial(j) for j in range(int(t / d) + 1)), mp.mpf(0))
            total = mp.mpf(0)
            for n in range(400):
                p = mp.lambertw(-k * d, n) / d
                term = mp.exp(p * t) / (1 + d * p)
                total += 2 * mp.re(term)
                if abs(term) < mp.mpf(10) ** -22:
                    break
            return total

    return error
