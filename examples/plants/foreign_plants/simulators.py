"""Plants that other people's simulators solve: MuJoCo, gym-electric-motor and do-mpc; ``make simulators`` adds these.

Actuators and sensors are those of ``parts``, since a simulator's own have no faults.
"""

from __future__ import annotations

import math
import warnings
from typing import Any, ClassVar

from foreign_plants.parts import Actuator, Plant, Sensor, State

ARM = """
<mujoco>
  <option timestep="0.001" integrator="implicitfast"/>
  <worldbody><body>
    <joint name="shoulder" axis="0 -1 0" damping="0.05" frictionloss="0.02" armature="0.01"/>
    <geom type="capsule" fromto="0 0 0 0 0 -0.4" size="0.02" mass="0.4"/>
  </body></worldbody>
  <actuator><motor joint="shoulder"/></actuator>
</mujoco>
"""
CART = """
<mujoco>
  <option timestep="0.002" integrator="implicitfast"/>
  <worldbody><body>
    <joint name="rail" type="slide" axis="1 0 0" damping="6" frictionloss="0.5"/>
    <geom type="box" size="0.1 0.05 0.05" mass="1.5"/>
    <body>
      <joint axis="0 1 0" damping="0.005"/>
      <geom type="capsule" fromto="0 0 0 0 0 -0.5" size="0.02" mass="0.4"/>
    </body>
  </body></worldbody>
  <actuator><motor joint="rail"/></actuator>
</mujoco>
"""


class MujocoPlant(Plant):
    """A mechanism with one motor; measured is its first joint. The state is MuJoCo's: places, then speeds."""

    mechanism = ""

    def __init__(self, seed: int = 0) -> None:
        import mujoco

        self._mujoco = mujoco
        self._model = mujoco.MjModel.from_xml_string(self.mechanism)
        self._data = mujoco.MjData(self._model)
        self._data.qpos[:] = self.rest[: self._model.nq]
        super().__init__(seed)

    def advance(self, u: float, h: float) -> None:
        self._data.ctrl[0] = u
        self._mujoco.mj_step(self._model, self._data, round(h / self._model.opt.timestep))
        self.state = (*self._data.qpos.tolist(), *self._data.qvel.tolist())


class Arm(MujocoPlant):
    """Angle [rad] of an arm against gravity and dry friction by the torque of its joint [N m], in MuJoCo."""

    mechanism = ARM
    rest = (0.6, 0.0)
    control_at_rest = 0.4 * 9.81 * 0.2 * math.sin(0.6)
    substep = 0.001

    def make_actuator(self) -> Actuator:
        return Actuator(-2.0, 2.0, rate=400.0)

    def make_sensor(self) -> Sensor:
        return Sensor(noise=0.0005, step=2.0 * math.pi / 8192.0)


class Cart(MujocoPlant):
    """Place [m] of a cart with a pole that swings below it by the force of its motor [N], in MuJoCo."""

    mechanism = CART
    rest = (0.0, 0.0, 0.0, 0.0)
    substep = 0.002

    def make_actuator(self) -> Actuator:
        return Actuator(-20.0, 20.0, rate=2000.0)

    def make_sensor(self) -> Sensor:
        return Sensor(noise=0.0003, step=0.0005)


class MotorSpeed(Plant):
    """Speed [rad/s] of a motor with permanent magnets that turns a fan by its voltage [V], in gym-electric-motor.

    Its standard direct-current motor, by a converter of four quadrants.
    """

    control_at_rest, supply = 18.0, 60.0
    fan: ClassVar = {"a": 0.05, "b": 0.0, "c": 5e-5, "j_load": 1e-3}
    substep = 0.00025

    def __init__(self, seed: int = 0) -> None:
        from gym_electric_motor import physical_systems as systems

        load, motor = systems.PolynomialStaticLoad(self.fan), systems.DcPermanentlyExcitedMotor()
        resistance, flux = (motor.motor_parameter[name] for name in ("r_a", "psi_e"))
        current = 0.0
        for _ in range(50):
            speed = (self.control_at_rest - resistance * current) / flux
            current = -load.j_total * float(load.mechanical_ode(0.0, [speed], 0.0)[0]) / flux
        self.rest = (speed, current)
        self._system: Any = systems.DcMotorSystem(
            systems.ContFourQuadrantConverter(tau=self.substep),
            systems.DcPermanentlyExcitedMotor(motor_initializer={"states": {"i": current}}),
            systems.PolynomialStaticLoad(self.fan, load_initializer={"states": {"omega": speed}}),
            systems.IdealVoltageSupply(self.supply), systems.ScipyOdeSolver(), tau=self.substep,
        )  # fmt: skip
        self._system.reset()
        super().__init__(seed)

    def make_actuator(self) -> Actuator:
        return Actuator(-self.supply, self.supply)

    def make_sensor(self) -> Sensor:
        return Sensor(noise=0.3, step=0.1)

    def advance(self, u: float, h: float) -> None:
        del h  # the system's own
        seen = self._system.simulate([min(max(u / self.supply, -1.0), 1.0)]) * self._system.limits
        named = dict(zip(self._system.state_names, seen, strict=True))
        self.state = (float(named["omega"]), float(named["i"]))


class CooledReactor(Plant):
    """Temperature [deg C] of a stirred tank with the van de Vusse reactions by the heat its jacket takes [kJ/h].

    K.-U. Klatt, S. Engell, Gain-scheduling trajectory control of a continuous stirred tank reactor, Computers and
    Chemical Engineering 22 (1998), 491-502, at its operating point; integrated by do-mpc.
    """

    control_at_rest = -1113.5
    rest = (2.140210530, 1.090304361, 114.191084421, 112.906592911)
    substep = 10.0

    def __init__(self, seed: int = 0) -> None:
        self._simulator = self._made()
        super().__init__(seed)

    def make_actuator(self) -> Actuator:
        return Actuator(-8500.0, 0.0, rate=200.0)

    def make_sensor(self) -> Sensor:
        return Sensor(noise=0.03, step=0.02)

    def output(self, x: State) -> float:
        return x[2]

    def advance(self, u: float, h: float) -> None:
        import numpy as np

        del h  # the simulator's own
        self.state = tuple(self._simulator.make_step(np.array([[u]])).ravel().tolist())

    def _made(self) -> Any:
        """The simulator at rest; its time is in hours."""
        import numpy as np
        from casadi import exp

        with warnings.catch_warnings(action="ignore"):  # of features of its that are not installed
            import do_mpc

        model = do_mpc.model.Model("continuous")
        a, b, t, jacket = (model.set_variable("_x", name) for name in ("C_A", "C_B", "T_R", "T_K"))
        heat = model.set_variable("_u", "Q")
        feed, feed_a, feed_t, volume, density, capacity, exchanged = (
            14.19,
            5.1,
            104.9,
            10.0,
            0.9342,
            3.01,
            4032.0 * 0.215,
        )
        first = 1.287e12 * exp(-9758.3 / (t + 273.15)) * a
        second = 1.287e12 * exp(-9758.3 / (t + 273.15)) * b
        third = 9.043e9 * exp(-8560.0 / (t + 273.15)) * a * a
        made = -(4.2 * first - 11.0 * second - 41.85 * third) / (density * capacity)
        model.set_rhs("C_A", feed * (feed_a - a) - first - third)
        model.set_rhs("C_B", -feed * b + first - second)
        model.set_rhs("T_R", made + feed * (feed_t - t) + exchanged * (jacket - t) / (density * capacity * volume))
        model.set_rhs("T_K", (heat + exchanged * (t - jacket)) / (5.0 * 2.0))
        model.setup()
        simulator = do_mpc.simulator.Simulator(model)
        simulator.set_param(t_step=self.substep / 3600.0)
        simulator.setup()
        simulator.x0 = np.array([self.rest]).T
        return simulator
