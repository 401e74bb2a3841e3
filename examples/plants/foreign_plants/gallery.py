"""The plants, and what an operator knows of each: its range, its sample time, gains that hold it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec

from foreign_plants.chemistry import Neutralisation, StirredReactor, VanDeVusse
from foreign_plants.drawn import WIDE, Drawn, Traits
from foreign_plants.fluids import BoilerDrum, LevelTank, QuadrupleTank
from foreign_plants.heat import CoupledHeaters, Furnace, HeatExchanger
from foreign_plants.motion import Crane, FlexibleJoint, Levitation, MotorPosition
from foreign_plants.parts import Plant
from foreign_plants.simulators import Arm, Cart, CooledReactor, MotorSpeed


@dataclass(frozen=True)
class Exhibit:
    """A plant and its loop.

    Attributes
    ----------
    plant : callable
        Makes the plant, from the seed of its sensor.
    sample_time : float
        Of the controller [s].
    gains : tuple of float
        kp, ki, kd that it runs with.
    move, load : float
        Step of the setpoint and of the load that gains are judged by.
    horizon : float
        How long after each of them [s].
    unsafe : tuple of float
        The measurement must never leave this range.
    """

    plant: Callable[[int], Plant]
    sample_time: float
    gains: tuple[float, float, float]
    move: float
    load: float
    horizon: float
    unsafe: tuple[float, float]


class _Gallery(dict[str, Exhibit]):
    """The plants by name; ``drawn_0`` is the first of those that nobody chose."""

    def __missing__(self, name: str) -> Exhibit:
        if not name.startswith(DRAWN):
            raise KeyError(name)
        traits = Traits.drawn(int(name.removeprefix(DRAWN)))
        horizon = 12.0 * (traits.slowness + 3.0 * traits.lateness)
        ticks, middle = round(horizon / traits.sample_time), 2.0 * WIDE * traits.gain
        far, move = 10.0 * WIDE * traits.gain, traits.gain * (5.0 if traits.kind == "integrator" else 10.0)
        return Exhibit(
            partial(Drawn, traits), traits.sample_time, traits.gains(), move, 10.0, ticks * traits.sample_time,
            (middle - far, middle + far),
        )  # fmt: skip


DRAWN = "drawn_"
GALLERY = _Gallery(
    {
        "quadruple_tank": Exhibit(QuadrupleTank, 2.0, (0.4, 0.004, 0.0), 1.0, 0.3, 1500.0, (8.0, 18.0)),
        "level_tank": Exhibit(LevelTank, 2.0, (20.0, 0.4, 0.0), 0.1, 5.0, 600.0, (0.7, 1.3)),
        "boiler_drum": Exhibit(BoilerDrum, 1.0, (1.0, 0.01, 0.0), 2.0, 4.0, 600.0, (-10.0, 10.0)),
        "coupled_heaters": Exhibit(CoupledHeaters, 1.0, (3.0, 0.02, 0.0), 3.0, 5.0, 1200.0, (35.0, 75.0)),
        "furnace": Exhibit(Furnace, 2.0, (0.5, 0.002, 0.0), 10.0, 5.0, 1500.0, (500.0, 700.0)),
        "heat_exchanger": Exhibit(HeatExchanger, 1.0, (0.3, 0.012, 0.0), 2.0, 4.0, 400.0, (45.0, 75.0)),
        "stirred_reactor": Exhibit(StirredReactor, 0.1, (2.0, 1.0, 0.0), 2.0, 2.0, 20.0, (310.0, 336.0)),
        "neutralisation": Exhibit(Neutralisation, 2.0, (0.5, 0.004, 0.0), 0.3, 1.0, 1200.0, (5.0, 9.5)),
        "van_de_vusse": Exhibit(VanDeVusse, 0.1, (5.0, 5.0, 0.0), 0.02, 2.0, 40.0, (0.9, 1.25)),
        "motor_position": Exhibit(MotorPosition, 0.002, (1.0, 0.5, 0.01), 0.5, 0.3, 2.0, (-6.0, 6.0)),
        "flexible_joint": Exhibit(FlexibleJoint, 0.005, (0.05, 0.25, 0.0), 1.0, 0.1, 5.0, (-4.0, 8.0)),
        "crane": Exhibit(Crane, 0.02, (20.0, 2.0, 0.0), 0.1, 4.0, 20.0, (-1.0, 1.0)),
        "levitation": Exhibit(Levitation, 0.002, (-0.6, -2.0, -0.02), 1.0, 0.1, 2.0, (30.0, 70.0)),
        "mujoco_arm": Exhibit(Arm, 0.005, (2.0, 2.0, 0.2), 0.2, 0.2, 5.0, (-1.0, 2.0)),
        "mujoco_cart": Exhibit(Cart, 0.01, (15.0, 2.0, 0.0), 0.1, 2.0, 15.0, (-1.0, 1.0)),
        "motor_speed": Exhibit(MotorSpeed, 0.0005, (0.02, 2.0, 0.0), 10.0, 2.0, 0.4, (20.0, 250.0)),
        "cooled_reactor": Exhibit(CooledReactor, 10.0, (100.0, 0.5, 0.0), 1.0, 200.0, 3000.0, (100.0, 130.0)),
    }
)

SIMULATORS = {
    "mujoco_arm": "mujoco", "mujoco_cart": "mujoco", "motor_speed": "gym_electric_motor", "cooled_reactor": "do_mpc",
}  # fmt: skip
"""What solves the equations of the plants that do not bring their own; ``make simulators`` adds these modules."""


def known_plants() -> list[str]:
    """Those that can run with what is installed."""
    return [name for name in GALLERY if name not in SIMULATORS or find_spec(SIMULATORS[name])]
