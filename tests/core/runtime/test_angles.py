"""Angles that wrap around: the shortest way, and no jump where the sensor has one."""

from __future__ import annotations

import cmath
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fopid_core.errors import InputError
from fopid_core.model.fopid import Fopid
from fopid_core.runtime.angles import nearest_turn
from fopid_core.runtime.c_export import c_header
from fopid_core.runtime.controller import ControllerSettings, FopidController

GAINS = Fopid(3.0, 1.5, 0.2, 0.9, 0.8)
WRAPPING = FopidController(ControllerSettings(GAINS, angle_wraparound=True))


def shortest(setpoint: float, measurement: float) -> float:
    """From the measurement to the setpoint, by the angle between two complex numbers."""
    return cmath.phase(cmath.rect(1.0, setpoint) / cmath.rect(1.0, measurement))


@settings(derandomize=True, max_examples=200, deadline=None)
@given(st.floats(-100.0, 100.0), st.floats(-100.0, 100.0))
def test_the_error_is_the_shortest_way(setpoint: float, measurement: float) -> None:
    WRAPPING.reset()
    WRAPPING.step(setpoint, measurement)
    error, expected = WRAPPING.state.error, shortest(setpoint, measurement)
    if abs(expected) < math.pi - 1e-9:
        assert error == pytest.approx(expected, abs=1e-12)
    else:  # half a turn: both ways are as long
        assert abs(error) == pytest.approx(math.pi, abs=1e-9)


def test_the_control_is_that_of_angles_that_never_wrap() -> None:
    """A joint that turns without end, once counted on and once by a sensor that shows -pi to pi."""
    wrapped = FopidController(ControllerSettings(GAINS, angle_wraparound=True))
    counted = FopidController(ControllerSettings(GAINS))
    for k in range(3000):
        angle = 0.01 * k + 0.3 * math.sin(0.02 * k)
        setpoint = angle + 1.2 * math.cos(0.013 * k)
        shown, asked = (nearest_turn(a, 0.0) for a in (angle, setpoint))
        assert -math.pi - 1e-9 <= shown <= math.pi + 1e-9
        assert wrapped.step(asked, shown) == pytest.approx(counted.step(setpoint, angle), abs=2e-9)


def test_a_sensor_that_counts_turns_gives_the_same() -> None:
    one, other = (FopidController(ControllerSettings(GAINS, angle_wraparound=True)) for _ in range(2))
    random = np.random.default_rng(2)
    for k in range(300):
        angle = math.sin(0.05 * k)
        turns = 2.0 * math.pi * random.integers(-3, 4, 2)
        # Whole turns in the setpoint and in the sensor, but for its first sample, from which angles count.
        shifted = other.step(0.4 + turns[0], angle + (turns[1] if k else 0.0))
        assert shifted == pytest.approx(one.step(0.4, angle), abs=1e-9)


def test_without_it_angles_are_numbers() -> None:
    controller = FopidController(ControllerSettings(Fopid(1.0)))
    assert controller.step(3.0, -3.0) == 6.0


def test_the_export_to_c_refuses_it() -> None:
    with pytest.raises(InputError, match=r"angle_wraparound = True; allowed in C: False"):
        c_header(ControllerSettings(GAINS, angle_wraparound=True))
