"""A number for each joint in one message: by the message's names, or in the order of the joints."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sensor_msgs.msg import JointState
from std_msgs.msg import Float32MultiArray, Float64MultiArray, Int16MultiArray

from fopid_core.errors import InputError
from fopid_ros.common.array_signals import ArraySignal

ARM = ("shoulder", "elbow", "wrist")
JOINT_STATE = "sensor_msgs/msg/JointState"


@settings(derandomize=True, deadline=None, max_examples=60)
@given(st.permutations([*ARM, "gripper"]), st.lists(st.floats(-1e9, 1e9), min_size=4, max_size=4))
def test_each_joint_gets_its_number_whatever_the_order(names: list[str], values: list[float]) -> None:
    there = dict(zip(names, values, strict=True))
    signal = ArraySignal(JOINT_STATE, "velocity", ARM, "x")
    assert signal.read(JointState(name=names, velocity=values)) == [there[name] for name in ARM]
    written = signal.writer()([there[name] for name in ARM], 1_500_000_000)
    assert list(written.name) == list(ARM)
    assert (written.header.stamp.sec, written.header.stamp.nanosec) == (1, 500_000_000)
    assert signal.read(written) == [there[name] for name in ARM]


@pytest.mark.parametrize(
    ("message", "read", "lacking"),
    [
        (JointState(name=["wrist", "shoulder"], position=[1.0, 2.0]), [2.0, None, 1.0],
         "no 'elbow' in name; allowed: wrist, shoulder"),
        (JointState(), [None] * 3, "no 'shoulder' in name; allowed: none are there"),
        (JointState(name=list(ARM), velocity=[1.0] * 3), [None] * 3, "0 numbers for 3 names; allowed: as many"),
        (JointState(name=["elbow", "elbow", "wrist"], position=[1.0, 2.0, 3.0]), [None, None, 3.0],
         "no 'shoulder' in name; allowed: elbow, elbow, wrist"),
    ],
)  # fmt: skip
def test_what_a_message_lacks_is_told(message: JointState, read: list, lacking: str) -> None:
    signal = ArraySignal(JOINT_STATE, "position", ARM, "x")
    assert (signal.read(message), signal.lacking) == (read, lacking)


@pytest.mark.parametrize("message_type", [Float64MultiArray, Float32MultiArray, Int16MultiArray])
def test_an_array_without_names_holds_a_number_for_each(message_type: type) -> None:
    signal = ArraySignal(f"std_msgs/msg/{message_type.__name__}", "data", ARM, "x", scale=0.5, offset=1.0)
    assert signal.read(signal.writer()([1.5, -2.0, 0.0], 0)) == [1.5, -2.0, 0.0]
    assert signal.read(message_type(data=[signal.writer()([1.0] * 3, 0).data[0]] * 2)) == [None] * 3
    assert signal.lacking == "2 numbers; allowed: 3, one for each of shoulder, elbow, wrist"


@pytest.mark.parametrize(
    ("type_name", "field", "told"),
    [
        (JOINT_STATE, "position[0]", r"x.field = 'position\[0\]'; allowed: the name of an array"),
        (JOINT_STATE, "positions", "no 'positions'; did you mean 'position'"),
        (JOINT_STATE, "name", "that is string"),
        ("std_msgs/msg/Float64", "data", "double is no array"),
    ],
)
def test_a_place_without_numbers_is_refused(type_name: str, field: str, told: str) -> None:
    with pytest.raises(InputError, match=told):
        ArraySignal(type_name, field, ARM, "x")
