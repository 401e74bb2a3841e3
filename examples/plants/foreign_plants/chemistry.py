"""Reactions: one that runs away, one whose gain changes by a hundred, one that first answers the wrong way."""

from __future__ import annotations

import math

from foreign_plants.parts import Actuator, Plant, Sensor, State


class StirredReactor(Plant):
    """Temperature [K] of an exothermic reaction by that of its coolant [K]; above some 340 K it ignites.

    D. E. Seborg, T. F. Edgar, D. A. Mellichamp, Process Dynamics and Control, ch. 2; its minutes are seconds here.
    """

    control_at_rest = 300.0
    rest = (324.4753, 0.87725)
    substep = 0.05

    def __init__(self, seed: int = 0) -> None:
        self.settle(2000, 0.05)
        super().__init__(seed)

    def make_actuator(self) -> Actuator:
        return Actuator(250.0, 350.0, rate=20.0)

    def make_sensor(self) -> Sensor:
        return Sensor(noise=0.05, step=0.05)

    def slopes(self, x: State, u: float) -> State:
        warm, left = x
        rate = 7.2e10 * math.exp(-8750.0 / max(warm, 1.0)) * left
        return (350.0 - warm + 5e4 / 239.0 * rate + 5e4 / 23900.0 * (u - warm), 1.0 - left - rate)


class Neutralisation(Plant):
    """pH by the flow of base [ml/s]: a buffered titration curve, steep and flat in turn.

    M. A. Henson, D. E. Seborg, Adaptive nonlinear control of a pH neutralization process, IEEE Trans. Control Systems
    Technology 2 (1994), 169-182, level kept; the electrode lags by 15 s.
    """

    acid, buffer = 16.6, 0.55
    control_at_rest = 15.6
    volume = 2900.0
    pk1, pk2 = -math.log10(4.47e-7), -math.log10(5.62e-11)
    substep = 2.0

    def __init__(self, seed: int = 0) -> None:
        flow = self.acid + self.buffer + self.control_at_rest
        wa = (3e-3 * self.acid - 0.03 * self.buffer - 3.05e-3 * self.control_at_rest) / flow
        wb = (0.03 * self.buffer + 5e-5 * self.control_at_rest) / flow
        self.rest = (wa, wb, self._ph(wa, wb))
        super().__init__(seed)

    def make_actuator(self) -> Actuator:
        return Actuator(0.0, 40.0, rate=4.0)

    def make_sensor(self) -> Sensor:
        return Sensor(noise=0.01, step=0.01, drift=0.02)

    def _ph(self, wa: float, wb: float) -> float:
        """Where the charges balance, by bisection."""
        low, high = 0.0, 14.0
        for _ in range(40):
            ph = 0.5 * (low + high)
            above = 10.0 ** (ph - self.pk2)
            share = (1.0 + 2.0 * above) / (1.0 + 10.0 ** (self.pk1 - ph) + above)
            if wa + 10.0 ** (ph - 14.0) - 10.0**-ph + wb * share > 0.0:
                high = ph
            else:
                low = ph
        return ph

    def slopes(self, x: State, u: float) -> State:
        wa, wb, sensed = x
        base = max(u, 0.0)
        to_wa = self.acid * (3e-3 - wa) + self.buffer * (-0.03 - wa) + base * (-3.05e-3 - wa)
        to_wb = self.acid * -wb + self.buffer * (0.03 - wb) + base * (5e-5 - wb)
        return (to_wa / self.volume, to_wb / self.volume, (self._ph(wa, wb) - sensed) / 15.0)

    def output(self, x: State) -> float:
        return x[2]


class VanDeVusse(Plant):
    """Concentration of the middle product [mol/l] by the flow [1/h] through a reactor: inverse response.

    F. J. Doyle, B. A. Ogunnaike, R. K. Pearson, Nonlinear model-based control using second-order Volterra models,
    Automatica 31 (1995), 697-714: A -> B -> C and 2 A -> D, isothermal; one hour there is 100 s here.
    """

    k1, k2, k3, fed = 50.0, 100.0, 10.0, 10.0
    control_at_rest = 34.3
    rest = (3.0, 1.117)
    substep = 0.02
    hour = 100.0

    def __init__(self, seed: int = 0) -> None:
        self.settle(4000, 0.1)
        super().__init__(seed)

    def make_actuator(self) -> Actuator:
        return Actuator(5.0, 60.0, rate=20.0)

    def make_sensor(self) -> Sensor:
        return Sensor(noise=0.001, step=0.0005)

    def slopes(self, x: State, u: float) -> State:
        a, b = x
        return (
            (-self.k1 * a - self.k3 * a * a + u * (self.fed - a)) / self.hour,
            (self.k1 * a - self.k2 * b - u * b) / self.hour,
        )

    def output(self, x: State) -> float:
        return x[1]
