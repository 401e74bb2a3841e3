"""The foreign plants are what their sources say."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from foreign_plants.chemistry import Neutralisation, StirredReactor, VanDeVusse
from foreign_plants.fluids import QuadrupleTank
from foreign_plants.gallery import GALLERY, SIMULATORS
from foreign_plants.heat import HeatExchanger
from foreign_plants.parts import Actuator, Plant, Sensor
from scipy.integrate import solve_ivp
from virtual_loop import VirtualLoop

OWN_EQUATIONS = [name for name in GALLERY if name not in SIMULATORS]


@pytest.fixture(params=GALLERY)
def name(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.mark.parametrize("name", OWN_EQUATIONS)
def test_has_no_slope_at_rest(name: str) -> None:
    plant = GALLERY[name].plant(0)
    assert np.allclose(plant.slopes(plant.state, plant.control_at_rest), 0.0, atol=2e-6)


def test_stays_where_it_rests(name: str) -> None:
    plant = GALLERY[name].plant(0)
    before = plant.state
    for _ in range(20):
        plant.step(plant.control_at_rest, GALLERY[name].sample_time)
    assert np.allclose(plant.state, before, rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("name", OWN_EQUATIONS)
def test_solves_its_equation(name: str) -> None:
    plant = GALLERY[name].plant(0)
    if isinstance(plant, HeatExchanger):
        pytest.skip("its equation has a memory beside its state")
    control, span = plant.control_at_rest + 0.1 * GALLERY[name].load, 40 * plant.substep
    exact = solve_ivp(lambda _, x: plant.slopes(tuple(x), control), (0.0, span), plant.state, rtol=1e-10, atol=1e-12)
    for _ in range(40):
        plant.state = plant._runge_kutta(plant.state, control, plant.substep)
    assert np.allclose(plant.state, exact.y[:, -1], rtol=2e-5, atol=1e-7)


def test_is_held_by_its_gains(name: str) -> None:
    exhibit = GALLERY[name]
    loop = VirtualLoop(exhibit, seed=3)
    loop.run(0.2 * exhibit.horizon)
    loop.setpoint += exhibit.move
    loop.run(exhibit.horizon)
    low, high = exhibit.unsafe
    assert low < min(loop.trace.true) < max(loop.trace.true) < high
    assert np.mean(loop.trace.true[-20:]) == pytest.approx(loop.setpoint, abs=0.25 * exhibit.move)


def test_the_tanks_have_the_time_constants_of_the_paper() -> None:
    tank = QuadrupleTank()
    found = [a / c * math.sqrt(2.0 * h / 981.0) for a, c, h in zip(tank.areas, tank.outlets, tank.rest, strict=True)]
    assert found == pytest.approx([63.0, 91.0, 39.0, 56.0], abs=1.5)


def test_the_published_points_of_rest() -> None:
    assert StirredReactor().rest == pytest.approx((324.5, 0.877), rel=1e-3)
    assert VanDeVusse().rest == pytest.approx((3.0, 1.117), rel=2e-3)
    wa, wb, ph = Neutralisation().rest
    assert (wa, wb, ph) == pytest.approx((-4.32e-4, 5.28e-4, 7.0), rel=1e-2)


@pytest.mark.parametrize("name", ["mujoco_arm"])
def test_the_arm_sticks_falls_and_hangs(name: str) -> None:
    arm = GALLERY[name].plant(0)
    stuck = [arm.step(arm.control_at_rest + 0.015, 0.005) for _ in range(200)]
    assert np.ptp(stuck) < 0.01  # dry friction of 0.02 N m
    for _ in range(1000):
        arm.step(0.0, 0.005)
    assert abs(arm.state[0]) < 0.1


@pytest.mark.parametrize("name", ["motor_speed"])
def test_voltage_and_torque_of_the_motor_balance(name: str) -> None:
    motor = GALLERY[name].plant(0)
    for _ in range(400):
        motor.step(24.0, 0.0005)
    turns, current = motor.state
    assert 0.016 * current + 0.165 * turns == pytest.approx(24.0, rel=1e-3)
    assert 0.165 * current == pytest.approx(0.05 + 5e-5 * turns**2, rel=1e-2)


def test_the_reactor_ignites() -> None:
    reactor = StirredReactor()
    reactor.load = 10.0
    assert max(reactor.step(300.0, 0.1) for _ in range(300)) > 350.0


def test_the_exchanger_answers_after_its_delay() -> None:
    plant = HeatExchanger()
    read = [plant.step(60.0, 0.5) for _ in range(200)]
    first = next(k for k, value in enumerate(read) if value > 60.3)
    assert 0.5 * first == pytest.approx(plant.delay, abs=2.0)


def test_an_actuator_sticks_and_has_play() -> None:
    sticky, loose = Actuator(0.0, 10.0, stiction=0.5), Actuator(0.0, 10.0, backlash=1.0)
    assert [sticky.step(u, 1.0) for u in (0.4, 0.6, 0.9, 20.0)] == [0.0, 0.6, 0.6, 10.0]
    assert [loose.step(u, 1.0) for u in (2.0, 1.5, 0.5)] == [1.5, 1.5, 1.0]
    assert Actuator(rate=2.0).step(5.0, 0.5) == 1.0


def test_a_sensor_rounds_and_its_noise_has_its_size() -> None:
    read = [Sensor(step=0.25).read(value, 1.0) for value in (0.1, 0.2, 1.9)]
    assert read == [0.0, 0.25, 2.0]
    sensor = Sensor(noise=0.5)
    assert np.std([sensor.read(1.0, 1.0) for _ in range(4000)]) == pytest.approx(0.5, rel=0.05)
    walking = Sensor(drift=1.0)
    steps = [b - a for a, b in pairwise(walking.read(0.0, 1.0) for _ in range(4000))]
    assert np.std(steps) * 60.0 == pytest.approx(1.0, rel=0.05)


def test_the_seed_makes_the_run(name: str) -> None:
    def run(seed: int) -> list[float]:
        plant: Plant = GALLERY[name].plant(seed)
        return [plant.step(plant.control_at_rest, GALLERY[name].sample_time) for _ in range(30)]

    assert run(4) == run(4)
