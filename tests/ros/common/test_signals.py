"""A signal is a number in any message type, found by type name and field path."""

from __future__ import annotations

import math
import struct

import pytest
from geometry_msgs.msg import PoseWithCovariance, Transform, TransformStamped, Vector3
from hypothesis import given, settings
from hypothesis import strategies as st
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import ChannelFloat32, JointState, MultiDOFJointState, PointCloud, Temperature
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
    data = signal.writer()(value, seconds * 10**9 + nanoseconds)
    message = deserialize_message(data, signal.message_type)
    assert signal.read(data) == signal.read(message) == value
    assert (message.header.stamp.sec, message.header.stamp.nanosec) == (seconds, nanoseconds)
    assert signal.stamp_ns(data) == signal.stamp_ns(message) == seconds * 10**9 + nanoseconds


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
    for value, written in ((41.6, 42), (float(low), low), (float(high), high)):
        assert deserialize_message(signal.writer()(value, 0), message) == message(data=written)


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
        ("std_msgs/msg/Float64", "data[x]", r"double is no array; allowed: no \[x\]"),
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


# Elements by name.

ARM = ("shoulder", "elbow", "wrist")
ANGLES = dict(zip(ARM, (0.1, 0.2, 0.3), strict=True))


@settings(derandomize=True, deadline=None, max_examples=60)
@given(st.permutations(ARM), st.sampled_from(ARM), st.permutations(ARM))
def test_a_joint_is_found_wherever_it_stands(first: list[str], wanted: str, second: list[str]) -> None:
    signal = SignalType("sensor_msgs/msg/JointState", f"position[{wanted}]")
    for names in (first, second, second):  # the order changes from message to message
        message = JointState(name=names, position=[ANGLES[name] for name in names])
        assert (signal.read(message), signal.lacking) == (ANGLES[wanted], "")


@pytest.mark.parametrize(
    ("type_name", "field", "message"),
    [
        ("sensor_msgs/msg/MultiDOFJointState", "transforms[base].translation.x",
         MultiDOFJointState(joint_names=["arm", "base"],
                            transforms=[Transform(), Transform(translation=Vector3(x=2.5))])),
        ("trajectory_msgs/msg/JointTrajectory", "points[1].positions[elbow]",
         JointTrajectory(joint_names=["wrist", "elbow"],
                         points=[JointTrajectoryPoint(), JointTrajectoryPoint(positions=[7.0, 2.5])])),
        ("sensor_msgs/msg/PointCloud", "channels[heat].values[1]",
         PointCloud(channels=[ChannelFloat32(name="light"), ChannelFloat32(name="heat", values=[0.0, 2.5])])),
        ("sensor_msgs/msg/JointState", "effort[left/arm-2.b]", JointState(name=["left/arm-2.b"], effort=[2.5])),
    ],
)  # fmt: skip
def test_names_stand_in_the_message_around_it_or_in_the_elements(type_name: str, field: str, message: object) -> None:
    signal = SignalType(type_name, field)
    assert signal.read(message) == 2.5
    assert signal.read(signal.writer()(4.5, 0)) == 4.5


def test_a_message_for_one_joint_holds_its_name() -> None:
    written = SignalType("sensor_msgs/msg/JointState", "effort[elbow]").writer()(4.5, 0)
    assert (list(written.name), list(written.effort), list(written.position)) == (["elbow"], [4.5], [])


@pytest.mark.parametrize(
    ("message", "lacking"),
    [
        (JointState(name=["shoulder", "wrist"], position=[1.0, 2.0]), "no 'elbow' in name; allowed: shoulder, wrist"),
        (JointState(), "no 'elbow' in name; allowed: none are there"),
        (JointState(name=["elbow", "wrist", "elbow"], position=[1.0, 2.0, 3.0]),
         "'elbow' stands 2 times in name; allowed: once"),
        (JointState(name=["wrist", "elbow"], velocity=[1.0, 2.0]),
         "0 elements in 'position[elbow]', where 'elbow' is number 1; allowed: 2 and more"),
    ],
)  # fmt: skip
def test_a_joint_that_is_not_there_reads_as_no_number_and_is_told(message: JointState, lacking: str) -> None:
    signal = SignalType("sensor_msgs/msg/JointState", "position[elbow]")
    good = JointState(name=["elbow"], position=[5.0])
    assert signal.read(good) == 5.0
    assert math.isnan(signal.read(message))
    assert signal.lacking == lacking
    assert (signal.read(good), signal.lacking) == (5.0, "")


@pytest.mark.parametrize(
    ("type_name", "field", "told"),
    [
        (
            "std_msgs/msg/Float64MultiArray",
            "data[elbow]",
            r"does not name its elements; allowed: a number, as in \[0\]",
        ),
        ("sensor_msgs/msg/JointState", "position[]", "names with dots and"),
        ("sensor_msgs/msg/JointState", "position[elbow].x", "double has no 'x'; allowed: nothing below it"),
        ("std_msgs/msg/Float64", "data[elbow]", r"double is no array; allowed: no \[elbow\]"),
    ],
)
def test_a_name_where_there_is_none_is_refused(type_name: str, field: str, told: str) -> None:
    with pytest.raises(InputError, match=told):
        SignalType(type_name, field, "x")


def test_scale_and_offset_turn_the_number_into_the_signal_and_back() -> None:
    celsius = SignalType("std_msgs/msg/Float32", "data", "x", scale=5.0 / 9.0, offset=-160.0 / 9.0)
    assert celsius.read(Float32(data=212.0)) == pytest.approx(100.0)
    assert celsius.writer()(100.0, 0).data == pytest.approx(212.0)
    upside_down = SignalType("std_msgs/msg/Int8", "data", scale=-0.5, offset=1.0)
    assert (upside_down.low, upside_down.high) == (-62.5, 65.0)
    for end in (-62.5, 65.0):
        assert upside_down.read(upside_down.writer()(end, 0)) == end
    for scale in (0.0, 1e-300):
        with pytest.raises(InputError, match=f"x.scale = {scale}; allowed: 1e-09 and more in size"):
            SignalType(signal="x", scale=scale)
