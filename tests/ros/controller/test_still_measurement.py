"""A sensor whose gateway repeats the last value: everything is fresh, and nothing is true."""

from __future__ import annotations

import math

import pytest
from diagnostic_msgs.msg import DiagnosticStatus

from fopid_ros.controller.still_measurement import STILL, StillMeasurement

from ..conftest import Graph
from .fed import FedController


def told(values: list[float], controls: list[float], control_range: float = 100.0) -> list[str]:
    still = StillMeasurement()
    return [still.look(*each, control_range) for each in zip(values, controls, strict=True)]


LIVELY = [20.0 + 0.1 * (k * k % 7) for k in range(100)]
RAMP = [50.0 + 0.5 * k for k in range(200)]


def test_a_measurement_that_stands_still_while_the_control_moves_is_told_until_it_moves() -> None:
    found = told([*LIVELY, *[20.0] * 30, *LIVELY[:70]], RAMP)
    first = next(k for k, text in enumerate(found) if text)
    assert 100 + STILL <= first <= 102 + STILL
    assert all(found[first:130])
    assert not any(found[131:])


def test_one_that_was_dead_for_long_is_told_as_soon_when_it_dies_again() -> None:
    dead = [20.0] * 30
    found = told([*LIVELY, *dead, *LIVELY[:20], *dead], RAMP[:180])
    assert [bool(text) for text in found[102 + STILL : 130]] == [bool(text) for text in found[152 + STILL :]]


@pytest.mark.parametrize(
    ("values", "controls", "control_range"),
    [
        ([*LIVELY, *[20.0] * 100], [50.0] * 200, 100.0),
        ([20.0 + k // 15 for k in range(200)], RAMP, 100.0),
        ([*LIVELY[:30], *[20.0] * 29], RAMP[:59], 100.0),
        ([*LIVELY, *[20.0] * 100], RAMP, math.inf),
    ],
    ids=["at rest, exactly", "coarse steps", "not looked at for long", "no limits"],
)
def test_one_that_may_stand_still_is_not(values: list[float], controls: list[float], control_range: float) -> None:
    assert not any(told(values, controls, control_range))


@pytest.mark.long
@pytest.mark.timeout(200)
def test_the_diagnostics_tell_of_it(graph: Graph) -> None:
    fed = FedController(graph, {"kp": 1.0, "ki": 0.1, "control_min": 0.0, "control_max": 10.0})
    fed.run(setpoint=1.0, sensor=0.9)
    for k in range(75):
        fed.sensor = 0.9 + 0.01 * (k * k % 7)
        graph.spin(1.0)
    fed.diagnosed(DiagnosticStatus.WARN, "is the sensor dead?")
