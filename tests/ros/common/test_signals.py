"""A signal is a number in any message type, found by type name and field path."""

from __future__ import annotations

import math
import struct

import pytest
from geometry_msgs.msg import PoseWithCovariance, TransformStamped, Vector3
from hypothesis import given, settings
from hypothesis import strategies as st
from sensor_msgs.msg import JointState, Temperature
from std_msgs.msg import Float32, Float64, Float64MultiArray, Int8, Int64, UInt16, UInt64
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from fopid_core.errors import InputError
from fopid_ros.common.signals import SignalType


@pytest.mark.parametrize(
    ("type_name", "field", "message"),
    [
        ("sensor_msgs/msg/Temperature", "temperature", Temperature(temperature=2.5)),
        ("std_msgs/msg/Float64", "data", Float64(data=2.5)),
        ("std_msgs/msg/Float32", "data", Float32(data=2.5)),
        ("std_msgs/msg/Float64MultiArray", "data[2]", Float64MultiArray(data=[0.0, 1.0, 2.5])),
        ("sensor_msgs/msg/JointState", "position[0]", JointState(position=[2.5, 7.0])),
        ("geometry_msgs/msg/PoseWithCovariance", "covariance[35]", PoseWithCovariance(covariance=[0.0] * 35 + [2.5])),
        ("geometry_msgs/msg/PoseWithCovariance", "pose.position.x", None),
        ("trajectory_msgs/msg/JointTrajectory", "points[1].positions[0]",
         JointTrajectory(points=[JointTrajectoryPoint(), JointTrajectoryPoint(positions=[2.5])])),
    ],
)  # fmt: skip
def test_a_number_is_read_from_where_it_stands(type_name: str, field: str, message: object) -> None:
    if message is None:
        message = PoseWithCovariance()
        message.pose.position.x = 2.5
    assert SignalType(type_name, field).read(message) == 2.5


@pytest.mark.parametrize(
    ("type_name", "field"),
    [
        ("fopid_msgs/msg/ScalarStamped", "value"),
        ("std_msgs/msg/Float64MultiArray", "data[2]"),
        ("std_msgs/msg/Float64MultiArray", "layout.dim[1].size"),
        ("sensor_msgs/msg/JointState", "effort[3]"),
        ("geometry_msgs/msg/TransformStamped", "transform.rotation.z"),
        ("geometry_msgs/msg/PoseWithCovariance", "covariance[7]"),
        ("trajectory_msgs/msg/JointTrajectory", "points[2].velocities[1]"),
        ("std_msgs/msg/Int8", "data"),
    ],
)
def test_what_is_written_is_read_again(type_name: str, field: str) -> None:
    signal = SignalType(type_name, field)
    write = signal.writer()
    for value in (3.0, 0.0, 17.0):
        assert signal.read(write(value, 0)) == value


@settings(derandomize=True, deadline=None, max_examples=60)
@given(st.floats(-1e300, 1e300), st.integers(0, 2**31 - 1), st.integers(0, 999_999_999))
def test_values_and_stamps_pass_unchanged(value: float, seconds: int, nanoseconds: int) -> None:
    signal = SignalType()
    message = signal.writer()(value, seconds * 10**9 + nanoseconds)
    assert signal.read(message) == value
    assert (message.header.stamp.sec, message.header.stamp.nanosec) == (seconds, nanoseconds)
    assert signal.stamp_ns(message) == seconds * 10**9 + nanoseconds


def test_a_type_without_a_header_has_no_stamp() -> None:
    assert SignalType("std_msgs/msg/Float64", "data").stamp_ns(Float64()) is None
    assert SignalType("geometry_msgs/msg/TransformStamped", "transform.rotation.w").stamp_ns(TransformStamped()) == 0
    assert SignalType("geometry_msgs/msg/Vector3", "x").stamp_ns(Vector3()) is None


def test_an_array_that_is_too_short_reads_as_no_number() -> None:
    signal = SignalType("sensor_msgs/msg/JointState", "position[2]")
    assert math.isnan(signal.read(JointState(position=[1.0, 2.0])))
    nested = SignalType("trajectory_msgs/msg/JointTrajectory", "points[0].positions[0]")
    assert math.isnan(nested.read(JointTrajectory()))


@pytest.mark.parametrize(
    ("type_name", "message", "low", "high"),
    [("std_msgs/msg/Int8", Int8, -128, 127), ("std_msgs/msg/UInt16", UInt16, 0, 65535),
     ("std_msgs/msg/Int64", Int64, -(2**63), 2**63 - 1024), ("std_msgs/msg/UInt64", UInt64, 0, 2**64 - 2048)],
)  # fmt: skip
def test_a_whole_number_is_rounded_to_and_says_what_it_holds(
    type_name: str, message: type, low: int, high: int
) -> None:
    signal = SignalType(type_name, "data")
    assert (signal.low, signal.high) == (low, high)
    assert type(signal.low) is type(signal.high) is float
    assert signal.writer()(41.6, 0) == message(data=42)
    for end in (low, high):
        assert signal.writer()(float(end), 0) == message(data=end)


def test_a_short_float_says_what_it_holds() -> None:
    signal = SignalType("std_msgs/msg/Float32", "data")
    assert struct.unpack("<f", struct.pack("<f", signal.high)) == (signal.high,)
    assert signal.read(signal.writer()(-signal.high, 0)) == signal.low
    with pytest.raises(OverflowError):
        struct.pack("<f", signal.high * (1 + 2**-24))


@pytest.mark.parametrize(
    ("type_name", "field", "told"),
    [
        ("std_msgs/Float64", "data", "x.type = 'std_msgs/Float64'; allowed: package/msg/Name"),
        ("../msg/Float64", "data", "x.type = '../msg/Float64'; allowed: package/msg/Name"),
        ("/msg/Float64", "data", "x.type = '/msg/Float64'; allowed: package/msg/Name"),
        ("std_msgs/msg/Float64MultiArray", "data[99999999999]", "index 99999999999 .*; allowed: 0 to 9999"),
        ("senser_msgs/msg/Temperature", "temperature", "no package 'senser_msgs' .* did you mean 'sensor_msgs'"),
        ("sensor_msgs/msg/Temprature", "temperature", "no message 'Temprature'; did you mean 'Temperature'"),
        ("sensor_msgs/msg/Temperature", "temprature", "no 'temprature'; did you mean 'temperature'"),
        ("sensor_msgs/msg/Temperature", "q", "no 'q'; allowed: header, temperature, variance"),
        (
            "sensor_msgs/msg/Temperature",
            "header",
            "that is std_msgs/Header; allowed: one of its fields stamp, frame_id",
        ),
        ("sensor_msgs/msg/Temperature", "header.frame_id", "that is string; allowed: a number"),
        ("sensor_msgs/msg/Temperature", "temperature.x", "double has no 'x'; allowed: nothing below it"),
        ("std_msgs/msg/Float64", "data[2]", "double is no array"),
        ("sensor_msgs/msg/JointState", "position", "that is sequence<double>; allowed: an element of it"),
        ("sensor_msgs/msg/JointState", "name[0]", "that is string"),
        ("geometry_msgs/msg/PoseWithCovariance", "covariance[36]", r"index 36 .*; allowed: 0 to 35"),
        ("std_msgs/msg/Bool", "data", "that is boolean; allowed: a number"),
        ("std_msgs/msg/Float64", "", "names with dots and"),
        ("std_msgs/msg/Float64", "data[x]", "names with dots and"),
        ("std_msgs/msg/Float64", "data[-1]", "names with dots and"),
        ("std_msgs/msg/Float64", "[0]", "names with dots and"),
        ("std_msgs/msg/_float64", "data", "no message '_float64'"),
    ],
)
def test_a_wrong_type_or_field_is_named_with_what_is_allowed(type_name: str, field: str, told: str) -> None:
    with pytest.raises(InputError, match=told) as raised:
        SignalType(type_name, field, "x")
    assert str(raised.value).startswith("x.")
    assert "\n" not in str(raised.value)
