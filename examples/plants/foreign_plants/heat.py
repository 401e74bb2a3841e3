"""Temperatures: coupled heaters, a furnace that radiates, an exchanger behind a pipe."""

from __future__ import annotations

from collections import deque

from foreign_plants.parts import Actuator, Plant, Sensor, State

STEFAN_BOLTZMANN = 5.67e-8


class CoupledHeaters(Plant):
    """Temperature of the first of two transistors [degC] by its heater [%]; they warm each other.

    The energy balances of the Temperature Control Lab: J. Park et al., Benchmark temperature microcontroller for
    process dynamics and control, Computers & Chemical Engineering 135 (2020); the second heater stands still at 20 %,
    the sensor has the ten bits of an Arduino.
    """

    ambient, mass, heat, own_area, between = 296.15, 0.004, 500.0, 1e-3, 2e-4
    alpha, transfer, emissivity, second = (0.01, 0.0075), 10.0, 0.9, 20.0
    control_at_rest = 35.0
    rest = (332.0, 315.0, 332.0)
    substep = 1.0

    def __init__(self, seed: int = 0) -> None:
        self.settle(4000, 2.0)
        super().__init__(seed)

    def make_actuator(self) -> Actuator:
        return Actuator(0.0, 100.0)

    def make_sensor(self) -> Sensor:
        return Sensor(noise=0.1, step=0.3223)

    def slopes(self, x: State, u: float) -> State:
        first, second, sensed = x
        black = self.emissivity * STEFAN_BOLTZMANN
        across = self.between * (self.transfer * (second - first) + black * (second**4 - first**4))
        gains = (self.alpha[0] * min(max(u, 0.0), 100.0) + across, self.alpha[1] * self.second - across)
        lost = (
            self.own_area * (self.transfer * (t - self.ambient) + black * (t**4 - self.ambient**4))
            for t in (first, second)
        )
        d1, d2 = ((gain - loss) / (self.mass * self.heat) for gain, loss in zip(gains, lost, strict=True))
        return (d1, d2, (first - sensed) / 10.0)

    def output(self, x: State) -> float:
        return x[2] - 273.15


class Furnace(Plant):
    """Temperature of a furnace [degC] by its heating [%], which heats only: it cools by radiation and convection.

    F. P. Incropera et al., Fundamentals of Heat and Mass Transfer, general lumped capacitance analysis (ch. 5):
    C T' = P u - e s A (T^4 - Ta^4) - h A (T - Ta); a thermocouple in a tube, its converter in steps of 0.25 K.
    """

    ambient, capacity, power, area, emissivity, convection = 293.15, 9000.0, 80.0, 0.08, 0.8, 9.0
    control_at_rest = 0.0
    substep = 2.0

    def __init__(self, seed: int = 0) -> None:
        hot = 873.15
        self.control_at_rest = self._loss(hot) / self.power
        self.rest = (hot, hot)
        super().__init__(seed)

    def _loss(self, t: float) -> float:
        radiated = self.emissivity * STEFAN_BOLTZMANN * (t**4 - self.ambient**4)
        return self.area * (radiated + self.convection * (t - self.ambient))

    def make_actuator(self) -> Actuator:
        return Actuator(0.0, 100.0)

    def make_sensor(self) -> Sensor:
        return Sensor(noise=0.15, step=0.25, drift=0.2)

    def slopes(self, x: State, u: float) -> State:
        hot, sensed = x
        return ((self.power * min(max(u, 0.0), 100.0) - self._loss(hot)) / self.capacity, (hot - sensed) / 15.0)

    def output(self, x: State) -> float:
        return x[1] - 273.15


class HeatExchanger(Plant):
    """Temperature of a stirred product [degC] by the steam valve [%], which it feels 14.7 s later.

    The stirred tank behind an exchanger of The MathWorks' example "Temperature control in a heat exchanger":
    exp(-14.7 s) / (21.3 s + 1), here with an equal-percentage valve of rangeability 20: its gain depends on its place.
    """

    control_at_rest = 50.0
    rest = (60.0,)
    delay = 14.7
    substep = 0.5

    def __init__(self, seed: int = 0) -> None:
        self._pipe, self._time, self._arriving = deque[tuple[float, float]](), 0.0, self.control_at_rest
        super().__init__(seed)

    def make_actuator(self) -> Actuator:
        return Actuator(0.0, 100.0, rate=10.0, stiction=0.2)

    def make_sensor(self) -> Sensor:
        return Sensor(noise=0.05, step=0.02)

    def input(self, felt: float, dt: float) -> float:
        self._time += dt
        self._pipe.append((self._time + self.delay, felt + self.load))
        while self._pipe and self._pipe[0][0] <= self._time:
            self._arriving = self._pipe.popleft()[1]
        return self._arriving

    def slopes(self, x: State, u: float) -> State:
        steam = 20.0 ** ((min(max(u, 0.0), 100.0) - 50.0) / 100.0)
        return ((20.0 + 40.0 * steam - x[0]) / 21.3,)
