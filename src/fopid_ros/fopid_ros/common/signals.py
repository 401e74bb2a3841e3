"""Loop signals: a number in any message type, found by type name and field path.

``sensor_msgs/msg/Temperature`` with field ``temperature``, ``std_msgs/msg/Float64`` with field ``data``,
``std_msgs/msg/Float64MultiArray`` with field ``data[2]``, ``sensor_msgs/msg/JointState`` with ``position[0]`` or
``position[elbow]``: the latter wherever the elbow stands in ``name``, message by message.
"""

from __future__ import annotations

import importlib
import math
import pkgutil
import re
from collections.abc import Callable, Mapping
from typing import Any

from builtin_interfaces.msg import Time
from std_msgs.msg import Header

from fopid_core.errors import InputError
from fopid_ros.common.cdr import Layout, layout_of
from fopid_ros.common.named_elements import Named, NamedElement, names_field
from fopid_ros.common.parameters import Spec, nearest

DEFAULT_TYPE = "fopid_msgs/msg/ScalarStamped"
DEFAULT_FIELD = "value"

SMALLEST_SCALE = 1e-9
LONGEST = 10_000
"""Of an array whose type sets no bound: one that is written is sent whole at every tick."""

Path = tuple[str | int | Named, ...]

_STEP = re.compile(r"(^|\.)(?P<name>[A-Za-z_]\w*)|(?<=.)\[((?P<index>\d+)|(?P<element>[^\[\]\s-][^\[\]]*))\]")
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


def signal_specs(name: str, *, at_configure: bool = False) -> tuple[Spec, ...]:
    """The parameters that say how a loop signal travels, read at the start or at configure."""
    fixed, place = not at_configure, "the number's place in that message, as in data, data[2] or position[elbow]"
    return (
        Spec(f"{name}.type", DEFAULT_TYPE, f"message type of the topic {name}", read_only=fixed,
             at_configure=at_configure),
        Spec(f"{name}.field", DEFAULT_FIELD, place, read_only=fixed, at_configure=at_configure),
        Spec(f"{name}.scale", 1.0, f"{name} = scale times the number in the message, plus offset", -1e9, 1e9,
             read_only=fixed, at_configure=at_configure),
        Spec(f"{name}.offset", 0.0, "see scale", -1e9, 1e9, read_only=fixed, at_configure=at_configure),
    )  # fmt: skip


def signal_type(values: Mapping[str, Any], name: str) -> SignalType:
    """How a signal travels by its parameters; raises InputError as ``SignalType`` does."""
    kind, field, scale, offset = (values[f"{name}.{part}"] for part in ("type", "field", "scale", "offset"))
    return SignalType(kind, field, name, scale, offset)


class SignalType:
    """How to read a number from a message and how to write it into one.

    Parameters
    ----------
    type_name : str
        ``package/msg/Name``.
    field : str
        Path of a number: names separated by dots, elements of arrays in brackets, by number or by name.
    signal : str, optional
        Whose type and field they are; errors begin with it.
    scale, offset : float
        The signal is ``scale`` times the number in the message, plus ``offset``; the same when it is written.

    Attributes
    ----------
    message_type : type
    has_header : bool
    raw : bool
        Whether messages are read and written as bytes: subscriptions are to be raw ones.
    low, high : float
        What the field can hold, in the signal's unit. Whole numbers are rounded to when written.
    raw_range : tuple of float
        What the field can hold, as the message has it.
    lacking : str
        Why the last message that was read held no number in that place; empty for one that did.

    Raises
    ------
    InputError
        If there is no such type, or no number in that place.

    Examples
    --------
    >>> from std_msgs.msg import Float64
    >>> SignalType("std_msgs/msg/Float64", "data").read(Float64(data=0.5))
    0.5
    >>> from sensor_msgs.msg import JointState
    >>> elbow = SignalType("sensor_msgs/msg/JointState", "position[elbow]")
    >>> elbow.read(JointState(name=["wrist", "elbow"], position=[1.0, 2.0]))
    2.0
    """

    def __init__(
        self, type_name: str = DEFAULT_TYPE, field: str = DEFAULT_FIELD, signal: str = "", scale: float = 1.0,
        offset: float = 0.0,
    ) -> None:  # fmt: skip
        owner = f"{signal}." if signal else ""
        self.message_type: Any = _load(type_name, f"{owner}type")
        self.has_header = self.message_type.get_fields_and_field_types().get("header") == "std_msgs/Header"
        self.field = field
        subject = f"{owner}field = {field!r}"
        self._path = _parse_path(field, subject)
        self._kinds = _kinds(type_name, self._path, subject)
        self._names = _names(type_name, self._path, self._kinds, subject)
        self.lacking = ""
        if abs(scale) < SMALLEST_SCALE:
            raise InputError(f"{owner}scale = {scale}; allowed: {SMALLEST_SCALE:g} and more in size, either sign")
        self._scale, self._offset = scale, offset
        self._unscaled = (scale, offset) == (1.0, 0.0)
        layout = layout_of(self.message_type)
        self._layout = layout if layout is not None and field in layout.names else None
        self._place = self._layout.names.index(field) if self._layout is not None else 0
        self.raw = self._layout is not None
        self.raw_range = _RANGES[self._kinds[-1]]
        self.low, self.high = sorted(scale * end + offset for end in self.raw_range)

    def read(self, message: Any) -> float:
        """The signal in a message, or in its bytes; NaN where that lacks the number."""
        if self._layout is not None and isinstance(message, bytes):
            number = float(self._layout.numbers(message)[self._place])
        else:
            number = self._number(message)
        return number if self._unscaled else self._scale * number + self._offset

    def _number(self, message: Any) -> float:
        """What stands at the end of the path."""
        self.lacking, owners = "", [message]
        for step in self._path:
            owner = owners[-1]
            if isinstance(step, str):
                owners.append(getattr(owner, step))
                continue
            index = self._index(owners) if isinstance(step, Named) else step
            if index is None or index >= len(owner):
                named = f", where {step.name!r} is number {index}" if isinstance(step, Named) else ""
                short = f"{len(owner)} elements in {self.field!r}{named}; allowed: {(index or 0) + 1} and more"
                self.lacking = self.lacking or short
                return math.nan
            owners.append(owner[index])
        return float(owners[-1])

    def _index(self, owners: list[Any]) -> int | None:
        """Where a named element stands in this message."""
        source = self._names[len(owners) - 1]
        if source.depth is None:
            names = [element.name for element in owners[-1]]
        else:
            names = getattr(owners[source.depth], source.field)
        (found,) = source.elements.find(names)
        if found is None:
            self.lacking = source.elements.lacking
        return found

    def writer(self) -> Callable[[float, int], Any]:
        """A function (value, stamp in nanoseconds) -> what is to be published: bytes, or the same message each time."""
        is_float, (low, high) = self._kinds[-1] in ("double", "float"), self.raw_range
        fill = self._fill_message() if self._layout is None else self._fill_bytes(self._layout)

        def write(value: float, stamp_ns: int) -> Any:
            if not self._unscaled:
                value = min(max((value - self._offset) / self._scale, low), high)
            return fill(value if is_float else round(value), stamp_ns)

        return write

    def _fill_bytes(self, layout: Layout) -> Callable[[float, int], bytes]:
        numbers, place, pack = list(layout.defaults), self._place, layout.pack

        def fill(number: float, stamp_ns: int) -> bytes:
            numbers[place] = number
            return pack(stamp_ns, numbers)

        return fill

    def _fill_message(self) -> Callable[[float, int], Any]:
        message = self.message_type()
        owner, last = self._owner_for_writing(message)
        stamp: Time | None = message.header.stamp if self.has_header else None

        def fill(number: float, stamp_ns: int) -> Any:
            if isinstance(last, int):
                owner[last] = number
            else:
                setattr(owner, last, number)
            if stamp is not None:
                stamp.sec, stamp.nanosec = divmod(stamp_ns, 1_000_000_000)
            return message

        return fill

    def _owner_for_writing(self, message: Any) -> tuple[Any, str | int]:
        """Message or array that holds the number; arrays on the way grow as long as the path needs."""
        owners, path = [message], [0 if isinstance(step, Named) else step for step in self._path]
        for k, step in enumerate(path[:-1]):
            owner = owners[-1][step] if isinstance(step, int) else getattr(owners[-1], step)
            following = path[k + 1]
            if isinstance(following, int) and len(owner) <= following:
                nested = _nested(self._kinds[k + 1])
                owner.extend(nested() if nested else 0 for _ in range(following + 1 - len(owner)))
            owners.append(owner)
            named = self._path[k + 1]
            if isinstance(named, Named):
                source = self._names[k + 1]
                if source.depth is None:
                    owner[0].name = named.name
                else:
                    setattr(owners[source.depth], source.field, [named.name])
        return owners[-1], path[-1]

    def stamp_ns(self, message: Any) -> int | None:
        """The header's stamp in nanoseconds, None without a header."""
        if not self.has_header:
            return None
        if self._layout is not None and isinstance(message, bytes):
            return self._layout.stamp_ns(message)
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
    steps: list[str | int | Named] = []
    position = 0
    while position < len(field) or not field:
        match = _STEP.match(field, position)
        if not match:
            allowed = "names with dots and [n] or [name], as in pose.position.x, data[2] or position[elbow]"
            raise InputError(f"{subject}; allowed: {allowed}")
        number = match["index"]
        steps.append(match["name"] or (int(number) if number else Named(match["element"])))
        position = match.end()
    return tuple(steps)


class _Names:
    """Where the names of an array's elements stand: a list in a message of the path, or in the elements (None)."""

    def __init__(self, depth: int | None, field: str, wanted: str) -> None:
        self.depth, self.field = depth, field
        self.elements = NamedElement([wanted], field)


def _names(type_name: str, path: Path, kinds: list[str], subject: str) -> dict[int, _Names]:
    """For each step of a path that is a name, by its number: where the names stand, the nearest first."""
    package, _, name = type_name.split("/")
    passed, found = [f"{package}/{name}", *kinds], {}
    for k, step in enumerate(path):
        if not isinstance(step, Named):
            continue
        element = _nested(passed[k + 1])
        if element and element.get_fields_and_field_types().get("name") == "string":
            found[k] = _Names(None, "name", step.name)
            continue
        lists = ((depth, names_field(_fields(passed[depth]))) for depth in range(k - 1, -1, -1))
        nearest_list = next(((depth, field) for depth, field in lists if field), None)
        if nearest_list is None:
            raise InputError(f"{subject}: {passed[0]} does not name its elements; allowed: a number, as in [0]")
        found[k] = _Names(*nearest_list, step.name)
    return found


def _fields(kind: str) -> dict[str, str]:
    nested = _nested(kind)
    return nested.get_fields_and_field_types() if nested else {}


def _kinds(type_name: str, path: Path, subject: str) -> list[str]:
    """What stands in a message after each step of a path; a number at its end."""
    package, _, name = type_name.split("/")
    kind, kinds = f"{package}/{name}", []
    for step in path:
        kind = _member(kind, step, subject) if isinstance(step, str) else _element(kind, step, subject)
        kinds.append(kind)
    if kind not in _RANGES:
        nested, array = _nested(kind), _ARRAY.fullmatch(kind)
        allowed = "an element of it, as in [0]" if array else "a number"
        if nested:
            allowed = f"one of its fields {', '.join(nested.get_fields_and_field_types())}"
        raise InputError(f"{subject}: that is {kind}; allowed: {allowed}")
    return kinds


def _member(kind: str, name: str, subject: str) -> str:
    fields = _fields(kind)
    if name not in fields:
        known = nearest(name, fields) if fields else "; allowed: nothing below it"
        raise InputError(f"{subject}: {kind} has no {name!r}{known}")
    return str(fields[name])


def _element(kind: str, index: int | Named, subject: str) -> str:
    array = _ARRAY.fullmatch(kind)
    if array is None:
        raise InputError(f"{subject}: {kind} is no array; allowed: no [{getattr(index, 'name', index)}]")
    if isinstance(index, Named):
        return array["element"] or array["item"]
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
