"""Loop signals: a number in any message type, found by type name and field path.

``sensor_msgs/msg/Temperature`` with field ``temperature``, ``std_msgs/msg/Float64`` with field ``data``,
``std_msgs/msg/Float64MultiArray`` with field ``data[2]`` and so on.
"""

from __future__ import annotations

import importlib
import re
from collections.abc import Callable
from typing import Any

from builtin_interfaces.msg import Time
from std_msgs.msg import Header

from fopid_core.errors import InputError
from fopid_ros.parameters import Spec

DEFAULT_TYPE = "fopid_msgs/msg/ScalarStamped"
DEFAULT_FIELD = "value"
_STEP = re.compile(r"(?P<name>[A-Za-z_]\w*)|\[(?P<index>\d+)\]")
_NUMERIC = re.compile(r"(double|float|float32|float64|u?int(8|16|32|64)|octet|byte|long double)")


def signal_specs(name: str) -> tuple[Spec, Spec]:
    """The two parameters that say how a loop signal travels."""
    return (
        Spec(f"{name}.type", DEFAULT_TYPE, f"message type of the topic {name}", read_only=True),
        Spec(f"{name}.field", DEFAULT_FIELD, "the number's place in that message, as in data or data[2]",
             read_only=True),
    )  # fmt: skip


class SignalType:
    """How to read a number from a message and how to write it into one.

    Parameters
    ----------
    type_name : str
        ``package/msg/Name``.
    field : str
        Path of a number: names separated by dots, elements of arrays in brackets.

    Raises
    ------
    InputError
        If there is no such type, or no number in that place.
    """

    def __init__(self, type_name: str = DEFAULT_TYPE, field: str = DEFAULT_FIELD) -> None:
        self.message_type: Any = _load(type_name)
        self._path = _parse_path(field)
        self._simple = self._path[0] if len(self._path) == 1 and isinstance(self._path[0], str) else None
        self.has_header = self.message_type.get_fields_and_field_types().get("header") == "std_msgs/Header"
        _check_path(self.message_type, type_name, field, self._path)

    def read(self, message: Any) -> float:
        """The number in a message; NaN where the array is too short for it."""
        if self._simple:
            return float(getattr(message, self._simple))
        for step in self._path:
            if isinstance(step, int):
                if step >= len(message):
                    return float("nan")
                message = message[step]
            else:
                message = getattr(message, step)
        return float(message)

    def writer(self) -> Callable[[float, int], Any]:
        """A function (value, stamp in nanoseconds) -> message; it fills the same message each time."""
        message = self.message_type()
        owner, last = self._owner_for_writing(message)
        stamp: Time | None = message.header.stamp if self.has_header else None

        def write(value: float, stamp_ns: int) -> Any:
            if isinstance(last, int):
                owner[last] = value
            else:
                setattr(owner, last, value)
            if stamp is not None:
                stamp.sec, stamp.nanosec = divmod(stamp_ns, 1_000_000_000)
            return message

        return write

    def _owner_for_writing(self, message: Any) -> tuple[Any, str | int]:
        owner = message
        for step, following in zip(self._path, self._path[1:], strict=False):
            child = owner[step] if isinstance(step, int) else getattr(owner, step)
            if isinstance(following, int) and isinstance(step, str) and len(child) <= following:
                child.extend([0.0] * (following + 1 - len(child)))
                child = getattr(owner, step)
            owner = child
        return owner, self._path[-1]

    def stamp_ns(self, message: Any) -> int | None:
        """The header's stamp in nanoseconds, None without a header."""
        if not self.has_header:
            return None
        stamp = message.header.stamp
        return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


def _load(type_name: str) -> Any:
    parts = type_name.split("/")
    if len(parts) != 3 or parts[1] != "msg":
        raise InputError(f"message type {type_name!r}; allowed: package/msg/Name")
    try:
        return getattr(importlib.import_module(f"{parts[0]}.msg"), parts[2])
    except (ImportError, AttributeError, ValueError):
        raise InputError(f"message type {type_name!r} is not installed; allowed: package/msg/Name") from None


def _parse_path(field: str) -> tuple[str | int, ...]:
    steps: list[str | int] = []
    for part in field.split("."):
        position = 0
        while position < len(part) or not part:
            match = _STEP.match(part, position)
            if not match or (match["name"] is not None) != (position == 0):
                raise InputError(f"field {field!r}; allowed: names with dots and [n], as in pose.position.x or data[2]")
            steps.append(match["name"] if match["name"] is not None else int(match["index"]))
            position = match.end()
    return tuple(steps)


def _check_path(message_type: Any, type_name: str, field: str, path: tuple[str | int, ...]) -> None:
    kind, current = type_name, message_type
    for step in path:
        if isinstance(step, int):
            element = re.sub(r"^sequence<(.*?)(, \d+)?>$|\[\d+\]$", r"\1", kind)
            kind = element if element != kind and kind.startswith("sequence") else kind.split("[")[0]
            current = _load_nested(kind)
            continue
        fields = current.get_fields_and_field_types() if current is not None else {}
        if step not in fields:
            allowed = ", ".join(fields) or "nothing below a number"
            raise InputError(f"field {field!r}: {type_name} has no {step!r}; allowed: {allowed}")
        kind = fields[step]
        current = _load_nested(kind)
    if not _NUMERIC.fullmatch(kind):
        raise InputError(f"field {field!r} of {type_name} is of type {kind}; allowed: a number")


def _load_nested(kind: str) -> Any:
    parts = kind.split("/")
    return _load(f"{parts[0]}/msg/{parts[1]}") if len(parts) == 2 and "<" not in kind else None


def header_stamp(header: Header, stamp_ns: int) -> None:
    """Set a header's stamp from nanoseconds."""
    header.stamp.sec, header.stamp.nanosec = divmod(stamp_ns, 1_000_000_000)
