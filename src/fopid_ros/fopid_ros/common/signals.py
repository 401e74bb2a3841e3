"""Loop signals: a number in any message type, found by type name and field path.

``sensor_msgs/msg/Temperature`` with field ``temperature``, ``std_msgs/msg/Float64`` with field ``data``,
``std_msgs/msg/Float64MultiArray`` with field ``data[2]``, ``sensor_msgs/msg/JointState`` with ``position[0]``.
"""

from __future__ import annotations

import importlib
import math
import pkgutil
import re
from collections.abc import Callable
from typing import Any

from builtin_interfaces.msg import Time
from std_msgs.msg import Header

from fopid_core.errors import InputError
from fopid_ros.common.parameters import Spec, nearest

DEFAULT_TYPE = "fopid_msgs/msg/ScalarStamped"
DEFAULT_FIELD = "value"

LONGEST = 10_000
"""Of an array whose type sets no bound: one that is written is sent whole at every tick."""

Path = tuple[str | int, ...]

_STEP = re.compile(r"(?P<name>[A-Za-z_]\w*)|\[(?P<index>\d+)\]")
_ARRAY = re.compile(r"sequence<(?P<element>[^,]+)(, (?P<bound>\d+))?>|(?P<item>[^\[]+)\[(?P<length>\d+)\]")
_LARGEST_FLOAT32 = (2.0 - 2.0**-23) * 2.0**127


def _below(power: int) -> float:
    """The largest whole number below 2^power that a float holds."""
    return 2.0**power - max(1.0, 2.0 ** (power - 53))


_RANGES = {
    "double": (-math.inf, math.inf),
    "float": (-_LARGEST_FLOAT32, _LARGEST_FLOAT32),
    **{f"uint{bits}": (0.0, _below(bits)) for bits in (8, 16, 32, 64)},
    **{f"int{bits}": (-(2.0 ** (bits - 1)), _below(bits - 1)) for bits in (8, 16, 32, 64)},
}
"""What each kind of number can hold."""


def signal_specs(name: str, *, at_configure: bool = False) -> tuple[Spec, Spec]:
    """The two parameters that say how a loop signal travels, read at the start or at configure."""
    fixed, place = not at_configure, "the number's place in that message, as in data or data[2]"
    return (
        Spec(f"{name}.type", DEFAULT_TYPE, f"message type of the topic {name}", read_only=fixed,
             at_configure=at_configure),
        Spec(f"{name}.field", DEFAULT_FIELD, place, read_only=fixed, at_configure=at_configure),
    )  # fmt: skip


class SignalType:
    """How to read a number from a message and how to write it into one.

    Parameters
    ----------
    type_name : str
        ``package/msg/Name``.
    field : str
        Path of a number: names separated by dots, elements of arrays in brackets.
    signal : str, optional
        Whose type and field they are; errors begin with it.

    Attributes
    ----------
    message_type : type
    has_header : bool
    low, high : float
        What the field can hold. Whole numbers are rounded to when written.

    Raises
    ------
    InputError
        If there is no such type, or no number in that place.

    Examples
    --------
    >>> from std_msgs.msg import Float64
    >>> SignalType("std_msgs/msg/Float64", "data").read(Float64(data=0.5))
    0.5
    """

    def __init__(self, type_name: str = DEFAULT_TYPE, field: str = DEFAULT_FIELD, signal: str = "") -> None:
        owner = f"{signal}." if signal else ""
        self.message_type: Any = _load(type_name, f"{owner}type")
        self.has_header = self.message_type.get_fields_and_field_types().get("header") == "std_msgs/Header"
        self.field = field
        subject = f"{owner}field = {field!r}"
        self._path = _parse_path(field, subject)
        self._kinds = _kinds(type_name, self._path, subject)
        self._simple = field if len(self._path) == 1 else None
        self.low, self.high = _RANGES[self._kinds[-1]]

    def read(self, message: Any) -> float:
        """The number in a message; NaN where the array is too short for it."""
        if self._simple is not None:
            return float(getattr(message, self._simple))
        for step in self._path:
            if isinstance(step, str):
                message = getattr(message, step)
            elif step < len(message):
                message = message[step]
            else:
                return math.nan
        return float(message)

    def writer(self) -> Callable[[float, int], Any]:
        """A function (value, stamp in nanoseconds) -> message; it fills the same message each time."""
        message = self.message_type()
        owner, last = self._owner_for_writing(message)
        stamp: Time | None = message.header.stamp if self.has_header else None
        is_float = self._kinds[-1] in ("double", "float")

        def write(value: float, stamp_ns: int) -> Any:
            number = value if is_float else round(value)
            if isinstance(last, int):
                owner[last] = number
            else:
                setattr(owner, last, number)
            if stamp is not None:
                stamp.sec, stamp.nanosec = divmod(stamp_ns, 1_000_000_000)
            return message

        return write

    def _owner_for_writing(self, message: Any) -> tuple[Any, str | int]:
        """Message or array that holds the number; arrays on the way grow as long as the path needs."""
        owner = message
        steps = zip(self._path, self._path[1:], self._kinds[1:], strict=False)
        for step, following, kind in steps:
            owner = owner[step] if isinstance(step, int) else getattr(owner, step)
            if isinstance(following, int) and len(owner) <= following:
                nested = _nested(kind)
                owner.extend(nested() if nested else 0 for _ in range(following + 1 - len(owner)))
        return owner, self._path[-1]

    def stamp_ns(self, message: Any) -> int | None:
        """The header's stamp in nanoseconds, None without a header."""
        if not self.has_header:
            return None
        stamp = message.header.stamp
        return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


def _load(type_name: str, subject: str) -> Any:
    parts = type_name.split("/")
    if len(parts) != 3 or parts[1] != "msg" or not all(part.isidentifier() for part in parts):
        raise InputError(f"{subject} = {type_name!r}; allowed: package/msg/Name")
    package, _, name = parts
    try:
        module = importlib.import_module(f"{package}.msg")
    except ImportError:
        known = nearest(package, _packages())
        raise InputError(f"{subject} = {type_name!r}: no package {package!r} of messages is installed{known}") from None
    names = [known for known, kind in vars(module).items() if hasattr(kind, "get_fields_and_field_types")]
    if name not in names:
        raise InputError(f"{subject} = {type_name!r}: {package} has no message {name!r}{nearest(name, names)}")
    return getattr(module, name)


def _packages() -> list[str]:
    """Installed packages whose names say that they hold messages."""
    names = {module.name for module in pkgutil.iter_modules()}
    return sorted(name for name in names if name.endswith(("_msgs", "_interfaces")))


def _parse_path(field: str, subject: str) -> Path:
    steps: list[str | int] = []
    for part in field.split("."):
        position = 0
        while position < len(part) or not part:
            match = _STEP.match(part, position)
            if not match or (match["name"] is not None) != (position == 0):
                raise InputError(f"{subject}; allowed: names with dots and [n], as in pose.position.x or data[2]")
            steps.append(match["name"] if match["name"] is not None else int(match["index"]))
            position = match.end()
    return tuple(steps)


def _kinds(type_name: str, path: Path, subject: str) -> list[str]:
    """What stands in a message after each step of a path; a number at its end."""
    package, _, name = type_name.split("/")
    kind, kinds = f"{package}/{name}", []
    for step in path:
        kind = _element(kind, step, subject) if isinstance(step, int) else _member(kind, step, subject)
        kinds.append(kind)
    if kind not in _RANGES:
        nested, array = _nested(kind), _ARRAY.fullmatch(kind)
        allowed = "an element of it, as in [0]" if array else "a number"
        if nested:
            allowed = f"one of its fields {', '.join(nested.get_fields_and_field_types())}"
        raise InputError(f"{subject}: that is {kind}; allowed: {allowed}")
    return kinds


def _member(kind: str, name: str, subject: str) -> str:
    nested = _nested(kind)
    fields = nested.get_fields_and_field_types() if nested else {}
    if name not in fields:
        known = nearest(name, fields) if fields else "; allowed: nothing below it"
        raise InputError(f"{subject}: {kind} has no {name!r}{known}")
    return str(fields[name])


def _element(kind: str, index: int, subject: str) -> str:
    array = _ARRAY.fullmatch(kind)
    if array is None:
        raise InputError(f"{subject}: {kind} is no array; allowed: no [{index}]")
    length = int(array["bound"] or array["length"] or LONGEST)
    if index >= length:
        raise InputError(f"{subject}: index {index} of {kind}; allowed: 0 to {length - 1}")
    return array["element"] or array["item"]


def _nested(kind: str) -> Any:
    """The class of a message within a message, None for anything else."""
    parts = kind.split("/")
    if len(parts) != 2 or _ARRAY.fullmatch(kind):
        return None
    return getattr(importlib.import_module(f"{parts[0]}.msg"), parts[1])


def header_stamp(header: Header, stamp_ns: int) -> None:
    """Set a header's stamp from nanoseconds."""
    header.stamp.sec, header.stamp.nanosec = divmod(stamp_ns, 1_000_000_000)
