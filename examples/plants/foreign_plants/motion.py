"""Things that move: a motor's position, a joint that bends, a crane, a ball in a magnet's field."""

from __future__ import annotations

import math

from foreign_plants.parts import Actuator, Plant, Sensor, State


def friction(speed: float, size: float, soft: float) -> float:
    """Coulomb's, smooth where the speed is below ``soft``."""
    return size * math.tanh(speed / soft)


class MotorPosition(Plant):
    """Angle [rad] of a direct-current motor by its voltage [V], read by an encoder of 4096 lines.

    Control Tutorials for MATLAB and Simulink (University of Michigan), DC motor position, with dry friction.
    """

    inertia, damping, constant, resistance = 3.2284e-6, 3.5077e-6, 0.0274, 4.0
    rest = (0.0, 0.0)
    substep = 0.001

    def make_actuator(self) -> Actuator:
        return Actuator(-12.0, 12.0)

    def make_sensor(self) -> Sensor:
        return Sensor(step=2.0 * math.pi / 4096.0)

    def slopes(self, x: State, u: float) -> State:
        _, speed = x
        current = (u - self.constant * speed) / self.resistance
        torque = self.constant * current - self.damping * speed - friction(speed, 4e-4, 0.5)
        return (speed, torque / self.inertia)


class FlexibleJoint(Plant):
    """Speed [rad/s] of a load by the torque [N m] of the motor that turns it through a spring.

    M. W. Spong, Modeling and control of elastic joint robots, J. Dyn. Sys. Meas. Control 109 (1987), 310-319; its
    linear spring, with damping in the bearings.
    """

    motor, load_inertia, stiffness, damping, bearing = 0.02, 0.06, 12.0, 0.05, 0.12
    rest = (0.0, 0.0, 0.0)
    substep = 0.0025

    def make_actuator(self) -> Actuator:
        return Actuator(-2.0, 2.0, rate=50.0)

    def make_sensor(self) -> Sensor:
        return Sensor(noise=0.02, step=0.01)

    def slopes(self, x: State, u: float) -> State:
        turns, driven, twist = x
        spring = self.stiffness * twist + self.damping * (driven - turns)
        return (
            (spring - self.bearing * turns) / self.load_inertia,
            (u - spring - 0.02 * driven) / self.motor,
            driven - turns,
        )


class Crane(Plant):
    """Place [m] of a trolley with a swinging load by the force [N] that drives it.

    Y. Fang, W. E. Dixon, D. M. Dawson, E. Zergeroglu, Nonlinear coupling control laws for an underactuated overhead
    crane system, IEEE/ASME Trans. Mechatronics 8 (2003), 418-423, with viscous and dry friction of the trolley.
    """

    trolley, hung, rope = 6.5, 1.0, 0.75
    rest = (0.0, 0.0, 0.0, 0.0)
    substep = 0.01

    def make_actuator(self) -> Actuator:
        return Actuator(-60.0, 60.0, rate=400.0)

    def make_sensor(self) -> Sensor:
        return Sensor(noise=0.0005, step=0.0002)

    def slopes(self, x: State, u: float) -> State:
        _, speed, angle, turn = x
        s, c = math.sin(angle), math.cos(angle)
        push = u - 18.0 * speed - friction(speed, 1.0, 0.01)
        total = push + self.hung * s * (self.rope * turn * turn + 9.81 * c)
        faster = total / (self.trolley + self.hung * s * s)
        return (speed, faster, turn, -(c * faster + 9.81 * s) / self.rope - 0.3 * turn)


class Levitation(Plant):
    """Gap [mm] below a magnet of a steel ball by the coil's current [A]; it falls or sticks without a controller.

    H. K. Khalil, Nonlinear Systems, exercise 1.18: m x'' = m g - k x' - L a i^2 / (2 (a + x)^2), current driven.
    """

    mass, inductance, length, drag = 0.1, 0.01, 0.05, 0.01
    rest = (0.05, 0.0)
    substep = 0.0005

    def __init__(self, seed: int = 0) -> None:
        force = self.mass * 9.81
        self.control_at_rest = math.sqrt(
            2.0 * force * (self.length + self.rest[0]) ** 2 / (self.inductance * self.length)
        )
        super().__init__(seed)

    def make_actuator(self) -> Actuator:
        return Actuator(0.0, 15.0, rate=2000.0)

    def make_sensor(self) -> Sensor:
        return Sensor(noise=0.02, step=0.01)

    def slopes(self, x: State, u: float) -> State:
        gap, speed = x
        current, reach = max(u, 0.0), self.length + max(gap, 0.0)
        pull = 0.5 * self.inductance * self.length * current * current / (reach * reach)
        return (speed, 9.81 - (self.drag * speed + pull) / self.mass)

    def output(self, x: State) -> float:
        return 1000.0 * x[0]
