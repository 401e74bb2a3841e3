"""Columns of numbers hold what the rosbags library finds, message by message."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from fopid_core.errors import InputError
from fopid_core.study.bags.cdr import columns

from ..recording import message_types

TYPES = message_types()
TYPES.register(get_types_from_msg("bool yes\nstring name\nint16[3] three\nfloat32 small\nfloat64 big", "a/msg/Mixed"))


def number(message: Any, path: str) -> float:
    """What a path such as ``status[0].level`` leads to; NaN where it leads nowhere."""
    for step in path.replace("[", ".[").split("."):
        if not step.startswith("["):
            message = getattr(message, step)
        elif int(step[1:-1]) < len(message):
            message = message[int(step[1:-1])]
        else:
            return math.nan
    return float(message)


def check(type_name: str, messages: list[Any], *, little_endian: bool = True) -> set[str]:
    raw = [bytes(TYPES.serialize_cdr(message, type_name, little_endian=little_endian)) for message in messages]
    found = columns(raw, type_name, TYPES.fielddefs)
    read = [TYPES.deserialize_cdr(data, type_name) for data in raw]
    for path, column in found.items():
        assert np.array_equal(column, [number(message, path) for message in read], equal_nan=True), path
    return set(found)


def header(second: int, frame: str) -> Any:
    stamp = TYPES.types["builtin_interfaces/msg/Time"](second, 7)
    return TYPES.types["std_msgs/msg/Header"](stamp, frame)


TEXTS = st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=9)
NUMBERS = st.floats(width=64)


@settings(derandomize=True, deadline=None, max_examples=60)
@given(
    rows=st.lists(st.tuples(st.integers(0, 2**31 - 1), TEXTS, NUMBERS), min_size=1, max_size=8), little=st.booleans()
)
def test_a_stamped_scalar_is_read_whatever_its_frame_is_called(rows, little: bool) -> None:
    kind = TYPES.types["fopid_msgs/msg/ScalarStamped"]
    messages = [kind(header(second, frame), value) for second, frame, value in rows]
    paths = check("fopid_msgs/msg/ScalarStamped", messages, little_endian=little)
    assert paths == {"header.stamp.sec", "header.stamp.nanosec", "value"}


@settings(derandomize=True, deadline=None, max_examples=60)
@given(rows=st.lists(st.tuples(st.lists(TEXTS, max_size=3), st.lists(NUMBERS, max_size=4)), min_size=1, max_size=6))
def test_texts_and_sequences_may_have_any_length(rows) -> None:
    kind = TYPES.types["sensor_msgs/msg/JointState"]
    nothing = np.zeros(0)
    messages = [kind(header(1, "x"), names, np.array(values), nothing, nothing) for names, values in rows]
    paths = check("sensor_msgs/msg/JointState", messages)
    longest = max(len(values) for _, values in rows)
    assert {path for path in paths if "position" in path} == {f"position[{i}]" for i in range(longest)}


@pytest.mark.parametrize("little_endian", [True, False])
def test_small_and_large_fields_are_aligned(little_endian: bool) -> None:
    kind = TYPES.types["a/msg/Mixed"]
    messages = [kind(True, name, np.array([1, -2, 3], np.int16), 0.5, -math.pi) for name in ("", "a", "ab", "abc")]
    paths = check("a/msg/Mixed", messages, little_endian=little_endian)
    assert paths == {"yes", "three[0]", "three[1]", "three[2]", "small", "big"}


def test_messages_within_sequences_of_messages_are_read() -> None:
    status, pair = (TYPES.types[f"diagnostic_msgs/msg/{name}"] for name in ("DiagnosticStatus", "KeyValue"))
    array = TYPES.types["diagnostic_msgs/msg/DiagnosticArray"]

    def message(n: int) -> Any:
        return array(header(n, ""), [status(i, "name" * i, "m", "", [pair("k" * n, "v")] * i) for i in range(n)])

    messages = [message(n) for n in range(4)]
    paths = check("diagnostic_msgs/msg/DiagnosticArray", messages)
    assert {"status[0].level", "status[2].level"} <= paths


def test_every_field_of_the_controllers_state_is_read() -> None:
    names = [name for name, _ in TYPES.fielddefs["fopid_msgs/msg/FopidState"][1] if name != "header"]
    kind = TYPES.types["fopid_msgs/msg/FopidState"]
    messages = [kind(header(k, ""), **{name: i % 2 for i, name in enumerate(names)}) for k in range(3)]
    assert set(names) <= check("fopid_msgs/msg/FopidState", messages)
    assert get_typestore(Stores.EMPTY).fielddefs.get("fopid_msgs/msg/FopidState") is None


def test_wide_text_is_refused_by_name() -> None:
    fields = get_types_from_msg("wstring name\nfloat64 value", "a/msg/Wide")
    with pytest.raises(InputError, match=r"wstring.*wide text"):
        columns([bytes(24)], "a/msg/Wide", fields)


@pytest.mark.parametrize("cut", [0, 3, 10, 30])
def test_a_message_that_is_cut_off_is_refused(cut: int) -> None:
    message = TYPES.types["fopid_msgs/msg/ScalarStamped"](header(1, "a frame"), 2.0)
    raw = bytes(TYPES.serialize_cdr(message, "fopid_msgs/msg/ScalarStamped"))
    with pytest.raises(InputError, match="fopid_msgs/msg/ScalarStamped is damaged: it is shorter than it says"):
        columns([raw, raw[:cut]], "fopid_msgs/msg/ScalarStamped", TYPES.fielddefs)


@pytest.mark.parametrize("text", ["string text", "float64[] numbers"])
@pytest.mark.parametrize("length", [2, 0xFFFFFFFF])
def test_a_length_beyond_the_message_is_refused_at_once(text: str, length: int) -> None:
    raw = bytes.fromhex("00010000") + length.to_bytes(4, "little") + b"a"
    with pytest.raises(InputError, match="is damaged"):
        columns([raw], "a/msg/Long", get_types_from_msg(text, "a/msg/Long"))


@pytest.mark.parametrize("padding", range(4))
def test_a_middleware_may_append_padding(padding: int) -> None:
    raw = bytes.fromhex("00010000000000000000f03f") + bytes(padding)
    assert columns([raw], "std_msgs/msg/Float64", TYPES.fielddefs)["data"].tolist() == [1.0]


def test_bytes_that_no_definition_accounts_for_are_refused() -> None:
    raw = bytes.fromhex("00010000000000000000f03f")
    with pytest.raises(InputError, match="is longer than its definition says"):
        columns([raw + bytes(4)], "std_msgs/msg/Float64", TYPES.fielddefs)


@pytest.mark.parametrize("head", ["0002", "0003", "0006", "0007", "000a", "000b", "0100", "0101"])
def test_an_encapsulation_other_than_plain_cdr_is_refused(head: str) -> None:
    raw = bytes.fromhex(head + "0000000000000000f03f")
    with pytest.raises(InputError, match=rf"encapsulation = 0x{head} of .*; allowed: 0x0000, 0x0001"):
        columns([raw], "std_msgs/msg/Float64", TYPES.fielddefs)
