"""Levels: two tanks above each other, a tank with a sticking valve, a boiler drum that first answers the wrong way."""

from __future__ import annotations

import math

from foreign_plants.parts import Actuator, Plant, Sensor, State

GRAVITY = 981.0
"""[cm/s^2]"""


class QuadrupleTank(Plant):
    """Level of tank 2 [cm] by the voltage of pump 1 [V], which fills it through tank 4 above.

    K. H. Johansson, The quadruple-tank process, IEEE Trans. Control Systems Technology 8 (2000), 456-465, at its
    operating point P+; pump 2 stands still at 3.15 V.
    """

    areas, outlets = (28.0, 32.0, 28.0, 32.0), (0.071, 0.057, 0.071, 0.057)
    split, pumps, voltage = (0.43, 0.34), (3.14, 3.29), 3.15
    control_at_rest = 3.15
    substep = 1.0

    def __init__(self, seed: int = 0) -> None:
        k1, k2 = self.pumps
        v, (g1, g2) = self.voltage, self.split
        into = (g1 * k1 * v + (1 - g2) * k2 * v, g2 * k2 * v + (1 - g1) * k1 * v, (1 - g2) * k2 * v, (1 - g1) * k1 * v)
        self.rest = tuple((q / a) ** 2 / (2.0 * GRAVITY) for q, a in zip(into, self.outlets, strict=True))
        super().__init__(seed)

    def make_actuator(self) -> Actuator:
        return Actuator(0.0, 10.0, rate=2.0)

    def make_sensor(self) -> Sensor:
        return Sensor(noise=0.02, step=0.01)

    def slopes(self, x: State, u: float) -> State:
        q1, q2, q3, q4 = (a * math.sqrt(2.0 * GRAVITY * max(h, 0.0)) for a, h in zip(self.outlets, x, strict=True))
        p1, p2 = self.pumps[0] * max(u, 0.0), self.pumps[1] * self.voltage
        (g1, g2), (a1, a2, a3, a4) = self.split, self.areas
        return (
            (q3 - q1 + g1 * p1) / a1,
            (q4 - q2 + g2 * p2) / a2,
            ((1 - g2) * p2 - q3) / a3,
            ((1 - g1) * p1 - q4) / a4,
        )

    def output(self, x: State) -> float:
        return x[1]


class LevelTank(Plant):
    """Level [m] of a tank with outflow by gravity, by a valve [%] that sticks and is slow.

    D. E. Seborg, T. F. Edgar, D. A. Mellichamp, Process Dynamics and Control, ch. 2 and 4: A h' = q - c sqrt(h).
    """

    control_at_rest = 50.0
    rest = (1.0, 0.05)
    substep = 1.0

    def make_actuator(self) -> Actuator:
        return Actuator(0.0, 100.0, rate=5.0, stiction=0.3)

    def make_sensor(self) -> Sensor:
        return Sensor(noise=0.002, step=0.001, drift=0.001)

    def slopes(self, x: State, u: float) -> State:
        level, flow = x
        return ((flow - 0.05 * math.sqrt(max(level, 0.0))) / 2.0, (0.001 * max(u, 0.0) - flow) / 5.0)


class BoilerDrum(Plant):
    """Level [cm] in a drum by feed water [kg/s]: cold water makes the bubbles collapse before it fills the drum.

    K. J. Astrom, R. D. Bell, Drum-boiler dynamics, Automatica 36 (2000), 363-378: a mass balance that integrates and
    steam below the surface that shrinks and swells, here linear with one time constant.
    """

    control_at_rest = 50.0
    rest = (0.0, 0.0, 50.0)
    substep = 0.5

    def make_actuator(self) -> Actuator:
        return Actuator(0.0, 100.0, rate=5.0, backlash=0.2)

    def make_sensor(self) -> Sensor:
        return Sensor(noise=0.03, step=0.01)

    def slopes(self, x: State, u: float) -> State:
        _, steam, flow = x
        return (0.012 * (flow - 50.0), (-0.12 * (flow - 50.0) - steam) / 8.0, (u - flow) / 3.0)

    def output(self, x: State) -> float:
        return x[0] + x[1]
