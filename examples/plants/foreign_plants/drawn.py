"""Plants that nobody chose: drawn by chance, each by its number, with the gains of somebody who was careful.

Of six kinds, a third of a second to 50 s slow, behind actuators that may stick, have play or take up to 16 lags for
their stroke, read by sensors with noise and steps.
"""

from __future__ import annotations

import math
import random
from collections import deque
from dataclasses import dataclass

from foreign_plants.parts import Actuator, Plant, Sensor, State

KINDS = ("two lags", "three lags", "integrator", "lightly damped", "inverse response", "delay")
WIDE, REST = 100.0, 50.0
"""The control's range, and where it rests [%]."""
ZERO = 0.4
"""Of the inverse response, in lags."""


@dataclass(frozen=True)
class Traits:
    """What is drawn.

    Attributes
    ----------
    kind : str
    gain : float
        Of the measurement, per % of the control.
    lag, second, third, delay : float
        [s]
    damping : float
        Of a plant that is lightly damped.
    curve : float
        By how much the gain changes from the middle to the ends of the range.
    rate : float
        Of the actuator [%/s].
    stiction, backlash : float
        [%]
    noise, step : float
        Of the sensor.
    sample_time : float
        Of the controller [s].
    caution : float
        How lively the gains are that it begins with, a share of what would do.
    """

    kind: str
    gain: float
    lag: float
    second: float
    third: float
    delay: float
    damping: float
    curve: float
    rate: float
    stiction: float
    backlash: float
    noise: float
    step: float
    sample_time: float
    caution: float

    @classmethod
    def drawn(cls, number: int) -> Traits:
        """Those of a number."""
        chance = random.Random(number)

        def decades(low: float, high: float) -> float:
            return 10.0 ** chance.uniform(low, high)

        kind, lag, gain = chance.choice(KINDS), decades(-0.5, 1.7), decades(-1.0, 1.0)
        noise = gain * WIDE * decades(-3.7, -2.5)
        return cls(
            kind, gain, lag, lag * chance.uniform(0.05, 0.6), lag * chance.uniform(0.02, 0.2),
            lag * chance.uniform(0.1, 1.5), chance.uniform(0.15, 0.6), chance.choice((0.0, 0.0, 0.5)),
            math.inf if chance.random() < 0.35 else WIDE / (lag * decades(-0.5, 1.2)),
            chance.choice((0.0, 0.0, 0.2, 0.8)), chance.choice((0.0, 0.0, 0.0, 0.3)), noise,
            noise * chance.choice((0.0, 1.0, 3.0)), float(f"{lag * chance.choice((0.01, 0.02, 0.04)):.1g}"),
            decades(-1.0, -0.3),
        )  # fmt: skip

    @property
    def slowness(self) -> float:
        """The largest lag [s]."""
        return self.second if self.kind == "lightly damped" else self.lag

    @property
    def lateness(self) -> float:
        """About what acts as delay [s]."""
        behind = {"delay": self.delay, "three lags": self.third}.get(self.kind, 0.0)
        return behind + 0.5 * self.second + self.sample_time

    def gains(self) -> tuple[float, float, float]:
        """kp, ki, kd of a careful PI."""
        late, lag = self.lateness, self.slowness
        if self.kind == "integrator":
            kp = self.caution * self.lag / (self.gain * (2.0 * late + 0.1 * self.lag))
            return kp, kp / (12.0 * (late + 0.1 * self.lag)), 0.0
        if self.kind == "lightly damped":
            return 0.3 * self.caution / self.gain, 0.8 * self.caution / (self.gain * lag), 0.0
        kp = 0.5 * self.caution * lag / (self.gain * late)
        return kp, kp / lag, 0.0


class Drawn(Plant):
    """A plant of such traits, with about 200 % of the control at rest as its measurement."""

    control_at_rest = REST
    rest = (0.0, 0.0, 0.0)

    def __init__(self, traits: Traits, seed: int = 0) -> None:
        self.traits = traits
        self.substep = min(traits.sample_time, traits.lag / 40.0)
        self._line = deque([0.0] * max(1, round(traits.delay / self.substep)))
        super().__init__(seed)

    def make_actuator(self) -> Actuator:
        one = self.traits
        return Actuator(0.0, WIDE, rate=one.rate, stiction=one.stiction, backlash=one.backlash)

    def make_sensor(self) -> Sensor:
        return Sensor(noise=self.traits.noise, step=self.traits.step)

    def input(self, felt: float, dt: float) -> float:
        del dt
        away = felt + self.load - REST
        bent = away * (1.0 + self.traits.curve * away / WIDE)
        if self.traits.kind != "delay":
            return bent
        self._line.append(bent)
        return self._line.popleft()

    def slopes(self, x: State, u: float) -> State:
        one, (first, second, third) = self.traits, x
        if one.kind == "lightly damped":
            swing = (one.gain * u - first) / one.second**2 - 2.0 * one.damping * second / one.second
            return second, swing, 0.0
        driven = one.gain * u if one.kind == "integrator" else one.gain * u - first
        return driven / one.lag, (first - second) / one.second, (second - third) / one.third

    def output(self, x: State) -> float:
        first, second, third = x
        seen = {
            "lightly damped": first, "three lags": third, "inverse response": second - ZERO * (first - second),
        }.get(self.traits.kind, second)  # fmt: skip
        return 2.0 * WIDE * self.traits.gain + seen
