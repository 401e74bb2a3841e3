"""What a parameter is, what tools are told of it, and what the texts that tools send stand for."""

from __future__ import annotations

import math

import pytest
from rcl_interfaces.msg import Parameter, ParameterValue
from rclpy.parameter import get_parameter_value, parameter_value_to_python

from fopid_core.errors import InputError
from fopid_ros.common.parameters import Spec, changes_of
from fopid_ros.controller.parameters import SPECS as CONTROLLER
from fopid_ros.dashboard.node import SPECS as DASHBOARD
from fopid_ros.plant.node import SPECS as PLANT
from fopid_ros.tuner.parameters import SPECS as TUNER

EVERY = [*CONTROLLER, *DASHBOARD, *PLANT, *TUNER]


@pytest.mark.parametrize("specs", [CONTROLLER, DASHBOARD, PLANT, TUNER])
def test_a_dump_can_nest_the_names_since_none_is_a_group_of_others(specs: tuple[Spec, ...]) -> None:
    names = [spec.name for spec in specs]
    assert not [name for name in names if any(other.startswith(f"{name}.") for other in names)]


@pytest.mark.parametrize("value", [math.inf, -math.inf, 0.1, 1e-5, 1e100, 1e22, -2.5e-9, 0.0, 12.0])
def test_a_number_comes_back_from_the_text_that_ros2_param_load_makes_of_it(value: float) -> None:
    as_sent = parameter_value_to_python(get_parameter_value(str(value)))
    assert Spec("any", 0.0, "").converted(as_sent) == value


@pytest.mark.parametrize("spec", [spec for spec in EVERY if spec.choices], ids=lambda spec: spec.name)
def test_a_choice_comes_back_from_the_text_that_ros2_param_set_makes_of_it(spec: Spec) -> None:
    for choice in spec.choices:
        assert spec.converted(parameter_value_to_python(get_parameter_value(choice))) == choice


@pytest.mark.parametrize("text", ["3", "nan", "fast", "1e", "--inf", ""])
def test_other_texts_are_no_numbers(text: str) -> None:
    with pytest.raises(InputError, match="allowed: a number"):
        Spec("kp", 0.0, "").check(Spec("kp", 0.0, "").converted(text))


@pytest.mark.parametrize("spec", EVERY, ids=lambda spec: spec.name)
def test_a_range_that_is_told_can_be_slid_over(spec: Spec) -> None:
    """rqt divides a range with two ends into 100 steps, and bends one with an open end so that all of it fits."""
    told = spec.descriptor()
    for interval in told.floating_point_range:
        ends = (interval.from_value, interval.to_value)
        assert math.inf in map(abs, ends) or max(map(abs, ends)) <= 1000.0
    for interval in told.integer_range:
        assert interval.to_value < 2**31


@pytest.mark.parametrize("value", [0.0, 0.003, -0.9, 1.0, 25.0, -4e5, 1e100])
def test_the_range_of_a_gain_holds_its_value_with_room_and_no_more(value: float) -> None:
    (interval,) = Spec("kp", 0.0, "", -1e100, 1e100, slides=True).descriptor(value).floating_point_range
    assert abs(value) <= interval.to_value == -interval.from_value
    assert interval.to_value <= max(100.0 * abs(value), 10.0)


def test_a_type_that_parameters_do_not_have_is_named() -> None:
    with pytest.raises(InputError, match=r"^'kp': type = 99; allowed: 0 to 9$"):
        changes_of([Parameter(name="kp", value=ParameterValue(type=99))])
    good = changes_of([Parameter(name="kp"), Parameter(name="n", value=ParameterValue(type=2, integer_value=3))])
    assert [one.value for one in good] == [None, 3]


def test_a_list_that_would_hold_the_loop_up_is_not_read() -> None:
    many = ParameterValue(type=8, double_array_value=[1.0] * 1_001)
    with pytest.raises(InputError, match=r"^'kp': a list of 1001 elements; allowed: up to 1000$"):
        changes_of([Parameter(name="kp", value=many)])


@pytest.mark.parametrize("value", ["x" * 100_000, ["x" * 100_000], [1.0] * 1_000_000])
def test_a_value_that_is_refused_fills_no_log(value: object) -> None:
    for spec in (Spec("kp", 0.0, ""), Spec("mode", "auto", "", choices=("auto", "manual"))):
        with pytest.raises(InputError) as refused:
            spec.check(value)
        assert len(str(refused.value)) < 200
