"""Random loops of the kinds that are hardest to answer: weighed to the extremes of ``random_loops``."""

from __future__ import annotations

import math
from fractions import Fraction

from .random_loops import Generator, Polynomial, RandomLoop, polynomial, short


class ExtremeGenerator(Generator):
    """Resonances of damping down to 1e-5, alone and in pairs, ten decades, borders, echoes, delays beside fast lags."""

    def __init__(self, seed: int) -> None:
        super().__init__(seed)
        self._kinds = (
            self.long_ringing, self.twin_resonant, self.stiff, self.near_marginal, self.fractional,
            self.fractional_resonant, self.unstable, self.long_neutral, self.stiff_delayed, self.delayed_fractional,
            self.delayed_resonant, self.delayed_twin, self.unstable_delayed, self.fractional_neutral,
        )  # fmt: skip

    def long_ringing(self) -> RandomLoop:
        """Damping 1e-5 to 1e-3 for 1e3 to 1e5 periods."""
        damping, frequency = self.log(1e-5, 1e-3), self.log(1e-2, 1e2)
        size = damping * self.log(0.01, 1.0)
        gain = frequency**2
        gains = (short(gain * size), short(gain * size * frequency), 0, 1, 1)
        horizon = self.log(1e3, 1e5) * 2.0 * math.pi / frequency
        return self._loop("long ringing", [], [self.pair(damping, frequency)], gains, horizon)

    def twin_resonant(self) -> RandomLoop:
        """Two lightly damped pairs, 1e-9 to 0.1 apart, or the same twice."""
        damping, frequency = self.log(1e-5, 1e-2), self.log(1e-2, 1e2)
        under = [self.pair(damping, frequency), self._near(damping, frequency)]
        gain, size = frequency**4, damping**2 * self.log(0.01, 1.0)
        gains = (short(gain * size), self._maybe(short(gain * size * frequency * 0.1)), 0, 1, 1)
        return self._loop("twin resonant", [], under, gains, self.log(1.0, 1e4) * 2.0 * math.pi / frequency)

    def near_marginal(self) -> RandomLoop:
        """As ``marginal``, always within 1e-5."""
        lag = self.number(0.1, 10)
        near = Fraction(8) * (1 + short(self._random.choice([-1.0, 1.0]) * self.log(1e-7, 1e-5)))
        horizon = float(lag) * self.log(1.0, 1e5) * 2.0 * math.pi
        return self._loop("near marginal", [], [polynomial(lag, 1)] * 3, (near, 0, 0, 1, 1), horizon)

    def long_neutral(self) -> RandomLoop:
        """A first-order lag under a derivative: kd / lag from 0.5 to 0.999, for 3 to 300 delays."""
        delay, lag = self.number(0.3, 3), self.number(0.3, 3)
        echo = short(1.0 - self.log(1e-3, 0.5))
        gains = (self.number(0.01, 0.5), self.number(0.01, 0.3), lag * echo, 1, 1)
        return self._loop("long neutral", [], [polynomial(lag, 1)], gains, float(delay) * self.log(3.0, 300.0), delay)

    def stiff_delayed(self) -> RandomLoop:
        """A delay of about 1 s and lags from 1e-7 s to 1e3 s."""
        delay = self.number(0.3, 3)
        under = [self.lag(1e-7, 1e3) for _ in range(self.integer(1, 3))]
        kd = self._maybe(self.number(0.01, 0.1)) * min(f[Fraction(1)] for f in under) if len(under) > 1 else 0
        gains = (self.number(0.01, 1), self.number(0.001, 0.3), kd, 1, 1)
        return self._loop("stiff delayed", [], under, gains, float(delay) * self.log(1.2, 30.0), delay)

    def delayed_twin(self) -> RandomLoop:
        """A resonance, or two close together, and a delay of some of its periods."""
        damping, frequency = self.log(1e-5, 1e-1), self.log(0.1, 10.0)
        delay = short(self.log(0.1, 10.0) / frequency)
        under = [self.pair(damping, frequency)]
        if self._random.random() < 0.5:
            under.append(self._near(damping, frequency))
        gain = frequency ** (2 * len(under))
        size = gain * damping ** len(under) * self.log(0.01, 1.0)
        gains = (short(size), self._maybe(short(size * frequency * 0.1)), 0, 1, 1)
        return self._loop("delayed twin", [], under, gains, float(delay) * self.log(1.2, 1e3), delay)

    def unstable_delayed(self) -> RandomLoop:
        """An unstable lag behind a short delay."""
        pole, delay = self.number(0.1, 10), self.log(0.01, 0.5)
        gains = (self.number(1.1, 3) * pole, self.number(0.01, 0.1) * pole**2, 0, 1, 1)
        horizon = min(self.log(1.0, 30.0), 30.0 * delay) / float(pole)
        return self._loop("unstable delayed", [], [polynomial(1, -pole)], gains, horizon, short(delay / float(pole)))

    def fractional_neutral(self) -> RandomLoop:
        """A half-order lag under a half-order derivative, and a delay."""
        delay, lag, half = self.number(0.3, 3), self.number(0.3, 3), Fraction("0.5")
        echo = short(1.0 - self.log(1e-3, 0.9))
        gains = (self.number(0.01, 0.5), self.number(0.01, 0.3), lag * echo, half, half)
        horizon = float(delay) * self.log(1.2, 30.0)
        return self._loop("fractional neutral", [], [{half: lag, Fraction(0): Fraction(1)}], gains, horizon, delay)

    def delayed_any_order(self) -> RandomLoop:
        """Orders of tenths, and a delay."""
        delay, order = self.number(0.3, 3), Fraction(self.integer(5, 19), 10)
        under = [{order: self.number(0.3, 3), Fraction(0): Fraction(1)}]
        lam, mu = Fraction(self.integer(3, 15), 10), Fraction(self.integer(1, int(order * 10) - 1), 10)
        gains = (self.number(0.05, 0.5), self.number(0.05, 0.3), self._maybe(self.number(0.01, 0.3)), lam, mu)
        return self._loop("delayed any order", [], under, gains, float(delay) * self.log(1.2, 15.0), delay)

    def _near(self, damping: float, frequency: float) -> Polynomial:
        """The same pair again, 1e-9 to 0.1 away or not at all."""
        apart = 0.0 if self._random.random() < 0.3 else self.log(1e-9, 0.1)
        w = short(float(short(frequency)) * (1.0 + apart), 12)
        return {Fraction(2): Fraction(1), Fraction(1): short(2.0 * damping * float(w)), Fraction(0): w * w}
