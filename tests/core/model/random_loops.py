"""Loops of all kinds at random, with what an oracle needs to know of them.

Every number is a short decimal, so that the text and a calculation in 50 digits mean the same loop.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from fractions import Fraction

import numpy as np

from fopid_core.model.fopid import Fopid
from fopid_core.model.loop import Loop
from fopid_core.model.process import Process

Polynomial = dict[Fraction, Fraction]  # coefficients by power of s


@dataclass(frozen=True)
class RandomLoop:
    """A process in factors, its delay, five gains and a horizon."""

    kind: str
    numerator: tuple[Polynomial, ...]
    denominator: tuple[Polynomial, ...]
    delay: Fraction
    gains: tuple[Fraction, ...]
    horizon: float
    direct: Fraction = field(default=Fraction(0))

    @property
    def text(self) -> str:
        over, under = (
            "*".join(f"({factor_text(f)})" for f in part) or "1" for part in (self.numerator, self.denominator)
        )
        return f"{over}/({under})" + (f"*exp(-{decimal(self.delay)}s)" if self.delay else "")

    @property
    def loop(self) -> Loop:
        return Loop(Process.parse(self.text), Fopid(*(float(g) for g in self.gains)))

    def __str__(self) -> str:
        return f"{self.kind}: {self.text} --gains {','.join(decimal(g) for g in self.gains)} --horizon {self.horizon!r}"


def decimal(value: Fraction) -> str:
    return repr(float(value)) if value.denominator != 1 else str(value.numerator)


def factor_text(factor: Polynomial) -> str:
    return "+".join(f"({decimal(c)})*s^{decimal(q)}" if q else f"({decimal(c)})" for q, c in factor.items())


def short(value: float, digits: int = 4) -> Fraction:
    return Fraction(f"{value:.{digits - 1}e}")


def polynomial(*coefficients: float | Fraction) -> Polynomial:
    """Highest power first."""
    top = len(coefficients) - 1
    return {Fraction(top - i): Fraction(c) for i, c in enumerate(coefficients) if c}


class Generator:
    """Random loops, one kind after the other."""

    def __init__(self, seed: int) -> None:
        self._random = np.random.default_rng(seed)
        self._kinds = (
            self.ordinary, self.resonant, self.stiff, self.marginal, self.unstable, self.fractional,
            self.fractional_resonant, self.delayed, self.neutral, self.delayed_fractional, self.delayed_resonant,
        )  # fmt: skip

    def loops(self, count: int) -> list[RandomLoop]:
        return [self._kinds[i % len(self._kinds)]() for i in range(count)]

    def log(self, low: float, high: float) -> float:
        return float(np.exp(self._random.uniform(math.log(low), math.log(high))))

    def number(self, low: float, high: float) -> Fraction:
        return short(self.log(low, high))

    def integer(self, low: int, high: int) -> int:
        return int(self._random.integers(low, high + 1))

    def lag(self, low: float = 0.1, high: float = 10.0) -> Polynomial:
        return polynomial(self.number(low, high), 1)

    def pair(self, damping: float, frequency: float) -> Polynomial:
        w = short(frequency)
        return {Fraction(2): Fraction(1), Fraction(1): short(2.0 * damping * float(w)), Fraction(0): w * w}

    def ordinary(self) -> RandomLoop:
        """Up to six lags, zeros on either side, PID."""
        order = self.integer(1, 6)
        under = [self.lag() for _ in range(order)]
        over = [
            polynomial(short(self._random.uniform(-1.0, 1.0)), 1) for _ in range(self.integer(0, min(2, order - 1)))
        ]
        if self._random.random() < 0.2:
            under[0] = polynomial(1, 0)
        gains = (self.number(0.01, 1), self.number(0.001, 0.3), self._maybe(self.number(0.01, 0.5)), 1, 1)
        return self._loop("ordinary", over, under, gains, self.log(1.0, 1000.0))

    def resonant(self) -> RandomLoop:
        """Damping down to 1e-5, up to 1e5 periods, small gains."""
        damping, frequency = self.log(1e-5, 0.3), self.log(1e-2, 1e2)
        under = [self.pair(damping, frequency)]
        if self._random.random() < 0.5:
            under.append(self.lag(0.1 / frequency, 10.0 / frequency))
        if self._random.random() < 0.2:
            under.append(self.pair(self.log(1e-5, 0.3), frequency * self.log(0.3, 3.0)))
        size = damping * self.log(0.01, 1.0)
        gain = float(np.prod([float(f[min(f)]) for f in under]))
        gains = (
            short(gain * self._random.choice([size, self.log(0.01, 1.0)])),
            short(gain * size * frequency),
            0,
            1,
            1,
        )
        return self._loop("resonant", [], under, gains, self.log(1.0, 1e5) * 2.0 * math.pi / frequency)

    def stiff(self) -> RandomLoop:
        """Time constants over ten decades."""
        under = [self.lag(1e-5, 1e5) for _ in range(self.integer(2, 5))]
        over = [self.lag(1e-5, 1e5) for _ in range(self.integer(0, len(under) - 1))]
        gains = (self.number(0.01, 10), self.number(1e-6, 1), self._maybe(self.number(1e-4, 1)), 1, 1)
        return self._loop("stiff", over, under, gains, self.log(1e-2, 1e7))

    def marginal(self) -> RandomLoop:
        """(T s + 1)^-3 and its border kp = 8, approached to 1e-7 from either side."""
        lag = self.number(0.1, 10)
        near = Fraction(8) * (1 + short(self._random.choice([-1.0, 1.0]) * self.log(1e-7, 1e-2)))
        horizon = float(lag) * self.log(1.0, 1e5) * 2.0 * math.pi
        return self._loop("marginal", [], [polynomial(lag, 1)] * 3, (near, 0, 0, 1, 1), horizon)

    def unstable(self) -> RandomLoop:
        """A loop that grows, or an unstable process."""
        pole = self.number(0.1, 10)
        under = [polynomial(1, -pole), *(self.lag() for _ in range(self.integer(0, 2)))]
        gains = (self.number(0.1, 10) * pole, self.number(0.01, 1), self._maybe(self.number(0.01, 0.1)), 1, 1)
        return self._loop("unstable", [], under, gains, self.log(0.1, 30.0) / float(pole))

    def fractional(self) -> RandomLoop:
        """Commensurate orders, no delay."""
        base = Fraction(self._random.choice(["0.5", "0.25", "0.2"]))
        top = base * self.integer(1, int(2 / base) - 1)
        middle = base * self.integer(0, int(top / base) - 1)
        factor = {top: self.number(0.1, 10), Fraction(0): Fraction(1)}
        if middle:
            factor[middle] = self.number(0.1, 10)
        return self._loop("fractional", [], [factor], self._orders(base, self.number(0.05, 5)), self.log(0.1, 1e5))

    def fractional_resonant(self) -> RandomLoop:
        """One pole pair at an angle of (1 - near) pi / 2, no delay."""
        base = Fraction(self._random.choice(["0.5", "0.25", "0.2"]))
        w, order = self.number(0.01, 100), base * self.integer(int(1 / base) + 1, int(2 / base) - 1)
        near = self.log(1e-5, 0.3)
        # s^2 + 2 z w s + w^2 beside a fractional controller of small gain
        under = [self.pair(near, float(w))]
        size = near * float(w) ** 2 * self.log(0.01, 1.0)
        gains = (short(size), short(size * float(w) ** float(order / 2)), 0, base * self.integer(1, int(1 / base)), 1)
        return self._loop("fractional resonant", [], under, gains, self.log(1.0, 1e5) / float(w))

    def delayed(self) -> RandomLoop:
        """Up to three lags and a delay, PID: retarded."""
        delay = self.number(0.1, 5)
        under = [self.lag(0.2, 5) for _ in range(self.integer(1, 3))]
        kd = self._maybe(self.number(0.01, 0.3)) if len(under) > 1 else 0
        gains = (self.number(0.01, 1), self.number(0.001, 0.3), kd, 1, 1)
        return self._loop("delayed", [], under, gains, float(delay) * self.log(1.2, 12.0), delay)

    def neutral(self) -> RandomLoop:
        """A delay and a loop gain that does not vanish at high frequency."""
        delay, lag = self.number(0.3, 3), self.number(0.3, 3)
        gains = (self.number(0.01, 0.5), self.number(0.01, 0.3), lag * self.number(0.01, 0.9), 1, 1)
        return self._loop("neutral", [], [polynomial(lag, 1)], gains, float(delay) * self.log(1.2, 10.0), delay)

    def delayed_fractional(self) -> RandomLoop:
        """Fractional orders and a delay."""
        base, delay = Fraction("0.5"), self.number(0.3, 3)
        under = [self.lag(0.3, 3) for _ in range(self.integer(1, 2))]
        gains = (self.number(0.05, 0.5), self.number(0.05, 0.3), self._maybe(self.number(0.01, 0.3)), base, base)
        return self._loop("delayed fractional", [], under, gains, float(delay) * self.log(1.2, 8.0), delay)

    def delayed_resonant(self) -> RandomLoop:
        """An integrator behind a delay, near its border kp d = pi / 2, for up to 1e5 periods."""
        delay = self.number(0.1, 5)
        near = self._random.choice([-1.0, 1.0]) * self.log(1e-7, 0.3)
        kp = short(math.pi / 2.0 / float(delay) * (1.0 + near), 12)
        horizon = float(delay) * 4.0 * self.log(10.0, 1e5)
        growth = max(near, 0.0) * horizon / float(delay)
        horizon *= min(1.0, 100.0 / max(growth, 1e-300))
        return self._loop("delayed resonant", [], [polynomial(1, 0)], (kp, 0, 0, 1, 1), horizon, delay)

    def _maybe(self, value: Fraction) -> Fraction:
        return value if self._random.random() < 0.5 else Fraction(0)

    def _orders(self, base: Fraction, size: Fraction) -> tuple[Fraction, ...]:
        lam, mu = (base * self.integer(1, int(Fraction(3, 2) / base)) for _ in range(2))
        return size, size * self.number(0.05, 2), self._maybe(size * self.number(0.01, 0.5)), lam, mu

    def _loop(
        self,
        kind: str,
        over: list[Polynomial],
        under: list[Polynomial],
        gains: tuple[Fraction | int, ...],
        horizon: float,
        delay: Fraction = Fraction(0),
    ) -> RandomLoop:
        rounded = tuple(short(float(g), 13) for g in gains)
        return RandomLoop(kind, tuple(over), tuple(under), delay, rounded, float(short(horizon)))
