"""Signals of many joints in one message: a number for each, by the message's names or in the order of the joints."""

from __future__ import annotations

import re
from array import array
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from fopid_core.errors import InputError
from fopid_ros.common.named_elements import NamedElement, names_field
from fopid_ros.common.signals import SignalType


class ArraySignal:
    """How to read a number for each joint from a message, and how to write them into one.

    A message that names its elements, as JointState does, is read by name and need not hold all joints; one that does
    not, as Float64MultiArray, holds a number for each, in their order.

    Parameters
    ----------
    type_name : str
        ``package/msg/Name``.
    field : str
        Of the message: an array of numbers.
    names : sequence of str
        The joints.
    signal : str
        Whose type and field they are; errors begin with it.
    scale, offset : float
        As in ``SignalType``.

    Attributes
    ----------
    low, high : float
        What an element can hold.
    by_name : bool
    raw : bool
        False: its messages are not read as bytes.
    lacking : str
        What the message that was read last lacked; empty for nothing.

    Examples
    --------
    >>> from sensor_msgs.msg import JointState
    >>> arm = ArraySignal("sensor_msgs/msg/JointState", "position", ["elbow", "wrist"], "measurement")
    >>> arm.read(JointState(name=["wrist", "elbow"], position=[1.0, 2.0]))
    [2.0, 1.0]
    >>> arm.read(JointState(name=["wrist"], position=[1.0])), arm.lacking
    ([None, 1.0], "no 'elbow' in name; allowed: wrist")
    """

    def __init__(
        self, type_name: str, field: str, names: Sequence[str], signal: str, scale: float = 1.0, offset: float = 0.0
    ) -> None:
        if not re.fullmatch(r"[A-Za-z]\w*", field):
            raise InputError(f"{signal}.field = {field!r}; allowed: the name of an array, as in position or data")
        self._element = SignalType(type_name, f"{field}[{len(names) - 1}]", signal, scale, offset)
        self.raw = False
        self.message_type, self.field = self._element.message_type, field
        self.low, self.high = self._element.low, self._element.high
        self._scale, self._offset, self._plain = scale, offset, (scale, offset) == (1.0, 0.0)
        self._joints = list(names)
        self._names_field = names_field(self.message_type.get_fields_and_field_types())
        self._names = NamedElement(names, self._names_field or "")
        self.by_name = self._names_field is not None
        self.stamp_ns = self._element.stamp_ns
        self.lacking = ""

    def read(self, message: Any) -> list[float | None]:
        """The signal of each joint; None for one that the message lacks."""
        numbers: list[float | None] = self._numbers(message)
        if self._plain:
            return numbers
        return [None if number is None else self._scale * number + self._offset for number in numbers]

    def _numbers(self, message: Any) -> list[float | None]:
        numbers, count = getattr(message, self.field), len(self._joints)
        if self._names_field is None:
            self.lacking = ""
            if len(numbers) == count:
                return [float(number) for number in numbers]
            self.lacking = f"{len(numbers)} numbers; allowed: {count}, one for each of {', '.join(self._joints)}"
            return [None] * count
        names = getattr(message, self._names_field)
        found = self._names.find(names)
        self.lacking = self._names.lacking
        if len(numbers) < len(names):
            self.lacking = f"{len(numbers)} numbers for {len(names)} names; allowed: as many"
            return [None] * count
        return [None if index is None else float(numbers[index]) for index in found]

    def writer(self) -> Callable[[Sequence[float], int], Any]:
        """A function (values, stamp in nanoseconds) -> message; it fills the same message each time."""
        message = self._element.writer()(self._offset, 0)  # the array is as long as it has to be
        if self._names_field is not None:
            setattr(message, self._names_field, list(self._joints))
        numbers = getattr(message, self.field)
        kind, whole = getattr(numbers, "typecode", "d"), not isinstance(numbers[0], float)
        stamp = message.header.stamp if self._element.has_header else None
        low, high = self._element.raw_range

        def write(values: Sequence[float], stamp_ns: int) -> Any:
            given = values
            if not self._plain:
                given = [min(max((value - self._offset) / self._scale, low), high) for value in values]
            numbers[:] = array(kind, map(round, given) if whole else given)
            if stamp is not None:
                stamp.sec, stamp.nanosec = divmod(stamp_ns, 1_000_000_000)
            return message

        return write


def array_signal(values: Mapping[str, Any], signal: str, names: Sequence[str]) -> ArraySignal:
    """How the signals of joints travel by their parameters; raises InputError as ``ArraySignal`` does."""
    kind, field, scale, offset = (values[f"{signal}.{part}"] for part in ("type", "field", "scale", "offset"))
    return ArraySignal(kind, field, names, signal, scale, offset)
