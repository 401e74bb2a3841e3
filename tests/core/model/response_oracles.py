"""Step responses and their indices by other means, in many digits, from the numbers as they are written.

Without delay: partial fractions in w = s^base, and Mittag-Leffler functions of their poles (exponentials at base 1).
With delay: the expansion in powers of 1/w and of exp(-s d), which is the method of steps. An integrator behind a delay:
residues at the poles that Lambert's function gives.
"""

from __future__ import annotations

import itertools
import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache
from typing import Literal

import mpmath as mp
import numpy as np

from .random_loops import Polynomial, RandomLoop

Signal = Literal["error", "control"]
Source = Literal["setpoint", "load"]
InTime = Callable[[float], mp.mpf]

_DIGITS = 60
_SERIES_REACH = 50  # |p|^(1/base) t up to which the power series is used
_STEPS_REACH = 100
_MOST_SAMPLES = 400_000
_FEW_ZEROS = 64


def signal_in_time(case: RandomLoop, source: Source = "setpoint", signal: Signal = "error") -> InTime | None:
    """A signal after a unit step as a function of time; None where no oracle is at hand."""
    if not case.delay:
        return without_delay(partial_fractions(case, source, signal))
    if case.kind == "delayed resonant":
        return delayed_integrator(case, signal) if source == "setpoint" else None
    return by_steps(case, source, signal)


def times(*factors: Polynomial) -> Polynomial:
    total: Polynomial = {Fraction(0): Fraction(1)}
    for factor in factors:
        new: Polynomial = {}
        for q, c in total.items():
            for r, d in factor.items():
                new[q + r] = new.get(q + r, Fraction(0)) + c * d
        total = {q: c for q, c in new.items() if c}
    return total


def plus(a: Polynomial, b: Polynomial) -> Polynomial:
    return {q: c for q in {*a, *b} if (c := a.get(q, Fraction(0)) + b.get(q, Fraction(0)))}


@dataclass(frozen=True)
class Parts:
    """signal = start / (opened + forward q) / s with q = exp(-d s), start itself behind ``late`` delays."""

    start: Polynomial
    late: int
    opened: Polynomial
    forward: Polynomial

    @staticmethod
    def of(case: RandomLoop, source: Source, signal: Signal) -> Parts:
        kp, ki, kd, lam, mu = case.gains
        lam = lam if ki else Fraction(0)
        controller = plus(plus({lam: kp}, {Fraction(0): ki}), {lam + mu: kd})
        opened = times(*case.denominator, {lam: Fraction(1)})
        forward = times(*case.numerator, controller)
        if source == "setpoint":
            start = opened if signal == "error" else times(*case.denominator, controller)
            return Parts(start, 0, opened, forward)
        start = (
            times(*case.numerator, {lam: Fraction(-1)})
            if signal == "error"
            else times(forward, {Fraction(0): Fraction(-1)})
        )
        return Parts(start, 1, opened, forward)

    @property
    def base(self) -> Fraction:
        """What all orders are whole multiples of."""
        base = Fraction(1)
        for q in (*self.start, *self.opened, *self.forward):
            base = Fraction(
                math.gcd(base.numerator * q.denominator, q.numerator * base.denominator),
                base.denominator * q.denominator,
            )
        return base


def number(value: Fraction) -> mp.mpf:
    return mp.mpf(value.numerator) / value.denominator


def in_w(polynomial: Polynomial, base: Fraction) -> list[mp.mpf]:
    """Coefficients in w, highest power first."""
    top = int(max(polynomial) / base)
    out = [mp.mpf(0)] * (top + 1)
    for q, c in polynomial.items():
        out[top - int(q / base)] = number(c)
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


@dataclass(frozen=True)
class Fractions:
    """Poles and residues in w, and the coefficients of the powers w^n, n of either sign."""

    poles: list[mp.mpc]
    residues: list[mp.mpc]
    powers: dict[int, mp.mpf]
    base: Fraction


def partial_fractions(case: RandomLoop, source: Source = "setpoint", signal: Signal = "error") -> Fractions:
    with mp.workdps(_DIGITS):
        parts = Parts.of(case, source, signal)
        base = parts.base
        under = {q + 1: c for q, c in plus(parts.opened, parts.forward).items()}
        shift = min(*under, *parts.start)
        n, d = (in_w({q - shift: c for q, c in part.items()}, base) for part in (parts.start, under))
        powers: dict[int, mp.mpf] = {}
        while len(n) >= len(d):
            factor, place = n[0] / d[0], len(n) - len(d)
            powers[place] = factor
            n = [c - factor * (d[i] if i < len(d) else 0) for i, c in enumerate(n)][1:]
        order = 0
        while d[-1] == 0:
            d, order = d[:-1], order + 1
        poles = roots(d)
        slope = [c * (len(d) - 1 - i) for i, c in enumerate(d[:-1])]
        residues = [polyval(n, p) / (polyval(slope, p) * p**order) for p in poles]
        rising: list[mp.mpf] = []
        low_n, low_d = n[::-1], d[::-1]
        for k in range(order):
            value = low_n[k] if k < len(low_n) else mp.mpf(0)
            value -= sum(rising[j] * low_d[k - j] for j in range(k) if k - j < len(low_d))
            rising.append(value / low_d[0])
            powers[k - order] = rising[-1]
        return Fractions(poles, residues, powers, base)


def without_delay(parts: Fractions) -> InTime:
    def in_time(time: float) -> mp.mpf:
        with mp.workdps(_DIGITS):
            t, a = mp.mpf(time), number(parts.base)
            total = mp.mpf(0)
            for n, c in parts.powers.items():
                total += c * t ** (-n * a - 1) * mp.rgamma(-n * a)
            for p, r in zip(parts.poles, parts.residues, strict=True):
                total += mp.re(r * (mp.exp(p * t) if parts.base == 1 else relaxation(parts.base, p, t)))
            return total

    return in_time


def relaxation(base: Fraction, p: mp.mpc, t: mp.mpf) -> mp.mpc:
    """The signal of 1 / (s^a - p): t^(a-1) E_{a,a}(p t^a)."""
    a = number(base)
    z = p * t**a
    reach = abs(z) ** (1 / a)
    if reach < _SERIES_REACH:
        gammas = reciprocal_gammas(base, int(6 * _SERIES_REACH / a))
        return t ** (a - 1) * polyval(gammas[: int((3.5 * reach + 80) / a)][::-1], z)
    total = mp.mpc(0)
    if abs(mp.arg(p)) < a * mp.pi:
        total += z ** (1 / a - 1) * mp.exp(z ** (1 / a)) / a
    power, smallest = 1 / z, mp.mpf(10) ** -32
    for k in range(1, int(reach / a)):
        total -= power * mp.rgamma(a - a * k)
        power /= z
        if abs(power) * mp.gamma(a * k + 2) < smallest:
            break
    return t ** (a - 1) * total


@lru_cache(maxsize=8)
def reciprocal_gammas(base: Fraction, count: int) -> list[mp.mpf]:
    with mp.workdps(_DIGITS):
        return [mp.rgamma(number(base) * (k + 1)) for k in range(count)]


def by_steps(case: RandomLoop, source: Source, signal: Signal) -> InTime | None:
    """start / opened / s times powers of -forward q / opened, each a series in 1/w."""
    parts = Parts.of(case, source, signal)
    base, count = parts.base, int(case.horizon / float(case.delay)) + 1
    with mp.workdps(_DIGITS + 40):
        start, a, f = (in_w(part, base) for part in (parts.start, parts.opened, parts.forward))
        size = max((abs(c / a[0]) ** (1.0 / (i * float(base))) for i, c in enumerate(a) if i and c), default=mp.mpf(1))
        if float(size) * case.horizon > _STEPS_REACH:
            return None
        length = int((4.0 * float(size) * case.horizon * 2.72 + 60.0) / float(base)) + 40
        ahead = max(len(start) - len(a), 0)  # the first row begins with w^ahead
        row = divided([mp.mpf(0)] * (ahead + len(a) - len(start)) + start, a, length)
        rows = [row]
        for _ in range(count):
            rows.append(divided(shifted_product(rows[-1], f, len(a) - len(f), length), a, length))
        orders = [number(base) * (n - ahead) for n in range(length)]
        gammas = [mp.rgamma(order + 1) for order in orders]

    def in_time(time: float) -> mp.mpf:
        with mp.workdps(_DIGITS + 40):
            total = mp.mpf(0)
            for k, row in enumerate(rows):
                since = mp.mpf(time) - (k + parts.late) * number(case.delay)
                if since <= 0:
                    break
                value = polyval(
                    [c * g for c, g in zip(reversed(row), reversed(gammas), strict=True)], since ** number(base)
                )
                total += (-1) ** k * value * since ** orders[0]
            return total

    return in_time


def divided(over: list[mp.mpf], under: list[mp.mpf], length: int) -> list[mp.mpf]:
    """The first coefficients of a quotient of series in 1/w that begin with w^0."""
    out: list[mp.mpf] = []
    for n in range(length):
        value = over[n] if n < len(over) else mp.mpf(0)
        value -= sum(under[j] * out[n - j] for j in range(1, min(n, len(under) - 1) + 1))
        out.append(value / under[0])
    return out


def shifted_product(row: list[mp.mpf], f: list[mp.mpf], shift: int, length: int) -> list[mp.mpf]:
    out = [mp.mpf(0)] * length
    for i, c in enumerate(f):
        if c:
            for n in range(length - i - shift):
                out[n + i + shift] += c * row[n]
    return out


def delayed_integrator(case: RandomLoop, signal: Signal) -> InTime:
    """s + k exp(-s d) = 0 at s = W_n(-k d) / d; the error is the sum of exp(p t) / (1 + d p), at first a polynomial."""
    kp, delay = case.gains[0], case.delay

    def error(time: float) -> mp.mpf:
        with mp.workdps(40):
            k, d, t = number(kp), number(delay), mp.mpf(time)
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

    return error if signal == "error" else lambda time: number(kp) * error(time)


def rational_indices(case: RandomLoop) -> dict[str, float] | None:
    """The indices of a loop of whole orders without delay: squares in closed form, absolute values between zeros."""
    parts = partial_fractions(case)
    if parts.base != 1 or any(n < -1 or n >= 0 for n in parts.powers):
        return None
    with mp.workdps(_DIGITS):
        p, r = list(parts.poles), list(parts.residues)
        if parts.powers:
            p, r = [*p, mp.mpf(0)], [*r, parts.powers[-1]]
        horizon = mp.mpf(case.horizon)
        found = {}
        for name, power in (("ise", 0), ("itse", 1), ("istse", 2), ("istes", 4)):
            total = mp.mpf(0)
            for i in range(len(p)):
                for j in range(i, len(p)):
                    total += (1 if i == j else 2) * mp.re(r[i] * r[j] * moment(p[i] + p[j], power, horizon))
            found[name] = float(total)
    return found | absolute_indices(p, r, case.horizon)


def moment(q: mp.mpc, power: int, horizon: mp.mpf) -> mp.mpc:
    """The integral of t^power exp(q t) from 0 to the horizon."""
    if abs(q) * horizon < mp.mpf(10) ** -4:
        return sum(q**n * horizon ** (power + n + 1) / (mp.factorial(n) * (power + n + 1)) for n in range(20))
    value = (mp.exp(q * horizon) - 1) / q
    for k in range(1, power + 1):
        value = (horizon**k * mp.exp(q * horizon) - k * value) / q
    return value


def absolute_indices(poles: list[mp.mpc], residues: list[mp.mpc], horizon: float) -> dict[str, float]:
    """Between zeros the integrals are known; the zeros are found on a fine grid and by bisection.

    A signal that hardly crosses zero may be what is left of large parts that cancel: it is integrated in many digits.
    """
    p, r = np.array([complex(x) for x in poles]), np.array([complex(x) for x in residues])
    fast, ringing = float(np.abs(p).max()), float(np.abs(p.imag).max())
    if ringing * horizon * 10.0 > _MOST_SAMPLES:
        return {}
    t = np.unique(np.concatenate((
        [0.0], np.geomspace(min(1e-6 / fast, horizon * 1e-6), horizon, 4000),
        np.linspace(0.0, horizon, int(ringing * horizon * 10.0) + 2000),
    )))  # fmt: skip

    def error(t: np.ndarray) -> np.ndarray:
        return sum((a * np.exp(b * t)).real for a, b in zip(r, p, strict=True))

    e = error(t)
    change = np.flatnonzero(e[1:] * e[:-1] < 0.0)
    low, high, sign = t[change], t[change + 1], np.sign(e[change])
    for _ in range(60):
        middle = 0.5 * (low + high)
        before = error(middle) * sign > 0.0
        low, high = np.where(before, middle, low), np.where(before, high, middle)
    ends = np.concatenate(([0.0], low, [horizon]))
    if ends.size <= _FEW_ZEROS:
        return {
            name: float(sum(abs(b - a) for a, b in itertools.pairwise(integrals_to(ends, poles, residues, power))))
            for name, power in (("iae", 0), ("itae", 1))
        }
    start, length = ends[:-1, None], np.diff(ends)[:, None]
    wave, x = r * np.exp(p * start), p * length
    plain, timed = (wave * length * phi(x, 1)).real, (wave * (start * length * phi(x, 1) + length**2 * phi(x, 2))).real
    return {"iae": float(np.abs(plain.sum(axis=1)).sum()), "itae": float(np.abs(timed.sum(axis=1)).sum())}


def integrals_to(ends: np.ndarray, poles: list[mp.mpc], residues: list[mp.mpc], power: int) -> list[mp.mpf]:
    """Integrals of t^power times the signal from 0 to each of these instants."""
    with mp.workdps(_DIGITS):
        return [
            mp.re(sum(r * moment(p, power, mp.mpf(float(end))) for p, r in zip(poles, residues, strict=True)))
            for end in ends
        ]


def phi(x: np.ndarray, order: int) -> np.ndarray:
    """Integral of exp(x u), or of u exp(x u), over u from 0 to 1."""
    small = np.abs(x) < 0.5
    series = sum(x**n / math.factorial(n) / (n + order) for n in range(16))
    x = np.where(small, 1.0, x)
    return np.where(small, series, np.expm1(x) / x if order == 1 else (np.exp(x) * (x - 1.0) + 1.0) / x**2)
