"""A sensor whose gateway repeats the last value: everything is fresh, and nothing is true."""

from __future__ import annotations

import math

import pytest
from diagnostic_msgs.msg import DiagnosticStatus

from fopid_core.model.fopid import Fopid
from fopid_core.runtime.controller import ControllerSettings
from fopid_core.runtime.controller_bank import ControllerBank
from fopid_ros.controller.joints.joint import Joint
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
        ([*LIVELY, *[20.0] * 100], [*RAMP[:100], *(100.0 + 0.04 * k for k in range(100))], math.inf),
    ],
    ids=["at rest, exactly", "coarse steps", "not looked at for long", "no limits, and hardly a move"],
)
def test_one_that_may_stand_still_is_not(values: list[float], controls: list[float], control_range: float) -> None:
    assert not any(told(values, controls, control_range))


def test_without_limits_what_the_control_did_before_is_the_measure() -> None:
    assert any(told([*LIVELY, *[20.0] * 30], RAMP[:130], math.inf))


def test_each_joint_has_its_own() -> None:
    names = ("base", "elbow")
    settings = ControllerSettings(Fopid(1.0, 0.0, 0.0), 0.01, control_min=0.0, control_max=10.0)
    joints = [Joint(*each) for each in zip(names, ControllerBank([settings, settings]).controllers, strict=True)]
    for k in range(75):
        for joint in joints:
            joint.measurement.value = 20.0 if joint.name == "elbow" and k > 60 else LIVELY[k]
            joint.controller.hold(0.1 * k)
        found = [joint.repeats() for joint in joints]
    assert found[0] == ""
    assert found[1].startswith("the measurement of elbow has been 20 for")


@pytest.mark.long
@pytest.mark.timeout(200)
def test_the_diagnostics_tell_of_it(graph: Graph) -> None:
    fed = FedController(graph, {"kp": 1.0, "ki": 0.1, "control_min": 0.0, "control_max": 10.0})
    fed.run(setpoint=1.0, sensor=0.9)
    for k in range(75):
        fed.sensor = 0.9 + 0.01 * (k * k % 7)
        graph.spin(1.0)
    fed.diagnosed(DiagnosticStatus.WARN, "is the sensor dead?")
