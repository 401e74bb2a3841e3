"""A joint has every parameter that its controller's numbers depend on, with the single controller's defaults."""

from __future__ import annotations

from dataclasses import fields

import pytest

from fopid_core.errors import InputError
from fopid_core.model.fopid import Fopid
from fopid_core.runtime.controller import FopidController
from fopid_core.runtime.settings import ControllerSettings
from fopid_ros.common.signals import SignalType
from fopid_ros.controller.joints.joint import Joint
from fopid_ros.controller.joints.parameters import OF_A_JOINT, OF_ALL, joint_settings, joint_specs, signal_types
from fopid_ros.controller.parameters import SPECS, controller_settings

SINGLE = {spec.name: spec.default for spec in SPECS}


def values(**given: object) -> dict[str, object]:
    return {spec.name: spec.default for spec in joint_specs(["elbow", "wrist"])} | given


def test_every_setting_of_the_core_is_a_joints_own_or_common() -> None:
    known = {*OF_A_JOINT, *(name.split(".")[0] for name in OF_ALL), "gains", "on_trial"}  # its gains.status
    none = {"variable_step"}  # all joints tick together
    assert {field.name for field in fields(ControllerSettings)} - known == none


def test_a_joint_is_set_up_as_a_single_controller_with_the_same_parameters() -> None:
    own = {"kp": 2.0, "ki": 1.5, "lam": 0.8, "control_max": 3.0, "deadband": 0.1, "angle_wraparound": True}
    own["gains.status"] = "trial"
    called = {f"gains.wrist.{name.removeprefix('gains.')}": value for name, value in own.items()}
    given = values(**called, sample_time=0.02, horizon=9.0)
    elbow, wrist = joint_settings(given, signal_types(given)["control"])
    assert (elbow.on_trial, wrist.on_trial) == (False, True)
    assert wrist == controller_settings({**SINGLE, **own, "sample_time": 0.02, "horizon": 9.0}, SignalType())
    assert elbow.gains == Fopid(0.0)


def test_names_of_the_messages_may_differ_from_those_of_the_joints() -> None:
    types = signal_types(values(reference_and_state_dof_names=["arm/2", "arm/3"]))
    message = types["setpoint"].message_type(name=["arm/3", "arm/2"], position=[3.0, 2.0])
    assert types["setpoint"].read(message) == [2.0, 3.0]
    for given in (["a", "a"], ["a"]):
        with pytest.raises(InputError, match="reference_and_state_dof_names"):
            signal_types(values(reference_and_state_dof_names=given))


def test_a_control_that_comes_back_some_ticks_late_is_no_limit_of_a_joint() -> None:
    """It moved at a third of its rate with an effort that was read three ticks late; a single controller did not."""
    joint = Joint("elbow", FopidController(ControllerSettings(Fopid(2.0), control_rate_max=1.0)))
    for one, value in ((joint.setpoint, 1.0), (joint.measurement, 0.0)):
        one.take(value, 0)
    controls: list[float] = []
    for tick in range(8):
        if tick > 3:
            joint.tracking.take(controls[tick - 3], 0)
        signals = joint.signals(0, contested=False)
        assert signals is not None
        assert signals[-1] is None
        controls.append(joint.controller.step(*signals[:3], manual=signals[3], tracking=signals[4]))
    joint.tracking.take(0.5, 0)
    assert joint.signals(0, contested=False)[-1] == 0.5
