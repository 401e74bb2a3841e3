"""What every plant is made of: an actuator and a sensor with their faults, and a differential equation between them."""

from __future__ import annotations

import math
import random
from dataclasses import dataclass

State = tuple[float, ...]


@dataclass
class Actuator:
    """What a control becomes before the plant feels it.

    Attributes
    ----------
    low, high : float
        Limits.
    rate : float
        Largest change per second.
    stiction : float
        It moves only to a place further away than this, and then jumps there (one-parameter model of Stenman, 2003).
    backlash : float
        Width of the play behind it.
    position : float
        Where it is.
    """

    low: float = -math.inf
    high: float = math.inf
    rate: float = math.inf
    stiction: float = 0.0
    backlash: float = 0.0
    position: float = 0.0
    _felt: float = 0.0

    def place(self, position: float) -> None:
        """Put it somewhere, in the middle of its play."""
        self.position = self._felt = position

    def step(self, control: float, dt: float) -> float:
        """What the plant feels after ``dt`` [s]."""
        wanted = min(max(control, self.low), self.high)
        if abs(wanted - self.position) > self.stiction:
            most = self.rate * dt
            self.position += min(max(wanted - self.position, -most), most)
        half = 0.5 * self.backlash
        self._felt = min(max(self._felt, self.position - half), self.position + half)
        return self._felt


@dataclass
class Sensor:
    """What a value becomes before anybody reads it.

    Attributes
    ----------
    noise : float
        Standard deviation, white.
    step : float
        Of the quantisation; 0 for none.
    drift : float
        Standard deviation of the random walk that its zero makes within an hour.
    """

    noise: float = 0.0
    step: float = 0.0
    drift: float = 0.0

    def __post_init__(self) -> None:
        self.begin(0)

    def begin(self, seed: int) -> None:
        """Begin anew, with the noise of a seed."""
        self._random = random.Random(seed)
        self._zero = 0.0

    def read(self, value: float, dt: float) -> float:
        """The reading ``dt`` [s] after the last one."""
        if self.drift:
            self._zero += self.drift * math.sqrt(dt / 3600.0) * self._random.gauss(0.0, 1.0)
        read = value + self._zero + (self.noise * self._random.gauss(0.0, 1.0) if self.noise else 0.0)
        return round(read / self.step) * self.step if self.step else read


class Plant:
    """``measurement = plant.step(control, dt)``, beginning at rest.

    Parameters
    ----------
    seed : int
        Of the sensor's noise.

    Attributes
    ----------
    rest : tuple
        State at rest with the control ``control_at_rest``.
    substep : float
        Longest step of the Runge-Kutta method of order four [s].
    load : float
        What acts beside the actuator, in its units.
    measurement : float
        The last reading.
    """

    rest: State = ()
    control_at_rest = 0.0
    substep = 0.01

    def __init__(self, seed: int = 0) -> None:
        self.actuator, self.sensor = self.make_actuator(), self.make_sensor()
        self.actuator.place(self.control_at_rest)
        self.sensor.begin(seed)
        self.state, self.load = self.rest, 0.0
        self.measurement = self.sensor.read(self.output(self.state), 0.0)

    def make_actuator(self) -> Actuator:
        """Its actuator, new."""
        return Actuator()

    def make_sensor(self) -> Sensor:
        """Its sensor, new."""
        return Sensor()

    def slopes(self, x: State, u: float) -> State:
        """The time derivative of the state under the input ``u``."""
        raise NotImplementedError

    def output(self, x: State) -> float:
        """The true value of what is measured."""
        return x[0]

    def input(self, felt: float, dt: float) -> float:
        """What drives the equation when the actuator gives ``felt``; here transport delays live."""
        del dt
        return felt + self.load

    def advance(self, u: float, h: float) -> None:
        """Let ``h`` [s] pass with the input ``u``."""
        self.state = self._runge_kutta(self.state, u, h)

    def step(self, control: float, dt: float) -> float:
        """Hold ``control`` for ``dt`` [s]; the reading after it."""
        count = max(math.ceil(dt / self.substep - 1e-9), 1)
        h = dt / count
        for _ in range(count):
            self.advance(self.input(self.actuator.step(control, h), h), h)
        self.measurement = self.sensor.read(self.output(self.state), dt)
        return self.measurement

    def settle(self, steps: int, h: float) -> None:
        """Take for ``rest`` where the equation ends under the control at rest."""
        for _ in range(steps):
            self.rest = self._runge_kutta(self.rest, self.control_at_rest, h)

    def _runge_kutta(self, x: State, u: float, h: float) -> State:
        a = self.slopes(x, u)
        b = self.slopes(tuple(p + 0.5 * h * q for p, q in zip(x, a, strict=True)), u)
        c = self.slopes(tuple(p + 0.5 * h * q for p, q in zip(x, b, strict=True)), u)
        d = self.slopes(tuple(p + h * q for p, q in zip(x, c, strict=True)), u)
        return tuple(p + h / 6.0 * (i + 2.0 * (j + k) + m) for p, i, j, k, m in zip(x, a, b, c, d, strict=True))
