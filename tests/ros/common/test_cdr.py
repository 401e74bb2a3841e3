"""Messages of plain numbers as bytes, held against rclpy's own reader and writer."""

from __future__ import annotations

import math
import struct
from typing import Any

import pytest
from builtin_interfaces.msg import Time
from hypothesis import given, settings
from hypothesis import strategies as st
from rclpy.serialization import deserialize_message, serialize_message
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import FluidPressure, Range, Temperature
from std_msgs.msg import Bool, Float32, Float64, Int8, String, UInt64
from std_msgs.msg import Header as HeaderMessage

from fopid_core.errors import InputError
from fopid_msgs.msg import FopidState, ScalarStamped
from fopid_ros.common.cdr import FORMATS, Layout, fault_finder, layout_of
from fopid_ros.common.signals import SignalType

FLAT = (ScalarStamped, FopidState, Temperature, FluidPressure, Float64, Bool, Int8, UInt64, Time)

NUMBERS = {
    "boolean": st.booleans(),
    "double": st.floats(),
    **{f"uint{bits}": st.integers(0, 2**bits - 1) for bits in (8, 16, 32, 64)},
    **{f"int{bits}": st.integers(-(2 ** (bits - 1)), 2 ** (bits - 1) - 1) for bits in (8, 16, 32, 64)},
}


def fields(message_type: Any) -> dict[str, str]:
    return {name: kind for name, kind in message_type.get_fields_and_field_types().items() if name != "header"}


def header(seconds: int, nanoseconds: int, frame_id: str) -> HeaderMessage:
    return HeaderMessage(stamp=Time(sec=seconds, nanosec=nanoseconds), frame_id=frame_id)


def same(first: Any, second: Any) -> bool:
    return first == second or (math.isnan(first) and math.isnan(second))


def ordered(message_type: Any, values: dict[str, Any]) -> list[Any]:
    return [values[name] for name in fields(message_type)]


MESSAGES = st.sampled_from(FLAT).flatmap(
    lambda kind: st.tuples(
        st.just(kind), st.fixed_dictionaries({name: NUMBERS[one] for name, one in fields(kind).items()})
    )
)
STAMPS = (st.integers(-(2**31), 2**31 - 1), st.integers(0, 999_999_999))


@settings(derandomize=True, deadline=None, max_examples=60)
@given(MESSAGES, *STAMPS, st.text(st.characters(exclude_characters="\0", exclude_categories=("Cs",)), max_size=20))
def test_what_rclpy_wrote_is_read(
    message: tuple[Any, dict[str, Any]], seconds: int, nanoseconds: int, frame_id: str
) -> None:
    kind, values = message
    stamped = "header" in kind.get_fields_and_field_types()
    more = {"header": header(seconds, nanoseconds, frame_id)} if stamped else {}
    data = serialize_message(kind(**values, **more))
    read = Layout(kind).unpack(data)
    assert all(same(getattr(read, name), value) for name, value in values.items())
    assert read.stamp_ns == (seconds * 10**9 + nanoseconds if stamped else 0)
    assert all(map(same, Layout(kind).numbers(data), ordered(kind, values)))


@settings(derandomize=True, deadline=None, max_examples=60)
@given(MESSAGES, *STAMPS)
def test_what_is_written_is_what_rclpy_reads(
    message: tuple[Any, dict[str, Any]], seconds: int, nanoseconds: int
) -> None:
    kind, values = message
    read = deserialize_message(Layout(kind).pack(seconds * 10**9 + nanoseconds, ordered(kind, values)), kind)
    assert all(same(getattr(read, name), value) for name, value in values.items())
    if hasattr(read, "header"):
        assert read.header == header(seconds, nanoseconds, "")


def test_a_record_has_the_fields_of_a_new_message_and_is_sent_as_it_stands() -> None:
    layout = Layout(FopidState)
    record = layout.record()
    assert deserialize_message(layout.pack_record(record), FopidState) == FopidState()
    record.stamp_ns, record.kp, record.refused, record.stale = 2_000_000_003, 1.5, 7, True
    expected = FopidState(header=header(2, 3, ""), kp=1.5, refused=7, stale=True)
    assert deserialize_message(layout.pack_record(record), FopidState) == expected


def test_a_big_endian_sender_is_understood() -> None:
    data = b"\0\0\0\0" + struct.pack(">iII", 3, 4, 5) + b"base\0" + bytes(7) + struct.pack(">d", -2.5)
    assert deserialize_message(data, ScalarStamped).value == -2.5
    layout = Layout(ScalarStamped)
    assert layout.unpack(data) == (3_000_000_004, -2.5)
    assert (layout.stamp_ns(data), layout.numbers(data)) == (3_000_000_004, (-2.5,))


@pytest.mark.parametrize("kind", [Float32, String, Range, HeaderMessage], ids=lambda kind: kind.__name__)
def test_other_types_are_left_to_rclpy(kind: Any) -> None:
    assert layout_of(kind) is None


@pytest.mark.parametrize("length", [0, 3, 4, 15, 16, 24])
def test_a_message_cut_short_is_an_error_and_no_number(length: int) -> None:
    data = serialize_message(ScalarStamped(value=1.0))[:length]
    with pytest.raises((struct.error, RuntimeError), match=r"buffer|deserialize"):
        Layout(ScalarStamped).numbers(data)


SEEDS = (
    serialize_message(ScalarStamped(header=header(3, 4, "base_link"), value=1.0)),
    serialize_message(FopidState(kp=1.0, stale=True)),
    b"\0\0\0\0" + struct.pack(">iII", 3, 4, 5) + b"base\0" + bytes(7) + struct.pack(">d", -2.5),
)
CUT = st.builds(lambda data, *ends: data[slice(*ends)], st.sampled_from(SEEDS), st.integers(0, 20), st.integers(0, 250))
CHANGED = st.builds(
    lambda data, at, new: data[:at] + new + data[at + len(new) :],
    st.sampled_from(SEEDS), st.integers(0, 40), st.binary(min_size=1, max_size=8),
)  # fmt: skip
HOSTILE = st.builds(
    lambda length, more: SEEDS[0][:12] + struct.pack("<I", length) + more,
    st.integers(0, 2**32 - 1), st.binary(max_size=40),
)  # fmt: skip
READ = (ScalarStamped, FopidState, Float64, Clock, String)


@settings(derandomize=True, deadline=None, max_examples=150)
@given(st.sampled_from(READ), st.binary(max_size=60) | CUT | CHANGED | HOSTILE)
def test_bytes_of_any_kind_are_a_message_or_have_a_fault_and_nothing_that_rclpy_reads_is_refused(
    kind: Any, data: bytes
) -> None:
    fault = fault_finder(kind)(data)
    assert fault in ("", f"{len(data)} bytes that are no {kind.__name__}")
    try:
        deserialize_message(data, kind)
    except RuntimeError:
        pass
    else:
        assert not fault
    if not fault and layout_of(kind):
        assert len(Layout(kind).unpack(data)) == 1 + len(fields(kind))


def test_every_kind_of_number_has_the_size_that_cdr_gives_it() -> None:
    sizes = {kind: 8 if kind == "double" else 1 if kind == "boolean" else int(kind.strip("uint")) // 8
             for kind in FORMATS}  # fmt: skip
    assert {kind: struct.calcsize(f"<{one}") for kind, one in FORMATS.items()} == sizes


def test_a_signal_reads_a_message_and_its_bytes_alike() -> None:
    signal = SignalType("sensor_msgs/msg/Temperature", "variance", scale=2.0, offset=1.0)
    message = Temperature(header=header(5, 6, "tank"), temperature=20.0, variance=0.25)
    data = serialize_message(message)
    assert signal.raw
    assert signal.read(message) == signal.read(data) == 1.5
    assert signal.stamp_ns(message) == signal.stamp_ns(data) == 5_000_000_006


def test_a_number_of_the_header_is_no_field_of_its_own() -> None:
    signal = SignalType("sensor_msgs/msg/Temperature", "header.stamp.sec")
    assert not signal.raw
    assert signal.read(Temperature(header=header(5, 6, ""))) == 5.0


def test_no_signal_can_be_read_from_bytes_of_another_place() -> None:
    with pytest.raises(InputError, match="has no 'values'"):
        SignalType("sensor_msgs/msg/Temperature", "values")
