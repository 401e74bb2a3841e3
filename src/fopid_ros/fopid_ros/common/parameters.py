"""Parameters of a node as a table: names, defaults, ranges, descriptions, in one place and checked alike."""

from __future__ import annotations

import difflib
import math
import re
from array import array
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor, ParameterType, ParameterValue
from rcl_interfaces.msg import Parameter as ParameterMessage
from rclpy.exceptions import InvalidParameterTypeException, InvalidParameterValueException
from rclpy.node import Node
from rclpy.parameter import Parameter, get_parameter_value, parameter_value_to_python

from fopid_core.errors import InputError

Value = bool | int | float | str | list[str]

QOS_PREFIX = "qos_overrides."
"""Parameters of this prefix are rclpy's own, declared with the topics."""

WIDEST = 1e3
"""A bound beyond this is too far for a slider: tools are told that there is none, and the check keeps it."""
LARGEST_INTEGER = 2**31 - 1
"""Of a slider for whole numbers."""
LONGEST_SHOWN = 80
"""Characters of a value in a message."""
LISTS = tuple(name for name in ParameterValue.get_fields_and_field_types() if name.endswith("_array_value"))
LONGEST_LIST = 1_000
LONGEST_REASON = 800
"""Characters of a reason: it is answered, logged, and told in each of the diagnostics from then on."""

_NUMBER_AS_TEXT = re.compile(r"[-+]?(\.?inf|(\d+\.?\d*|\.\d+)e[-+]?\d+)", re.IGNORECASE)
"""Numbers that ``ros2 param set`` and ``ros2 param load`` send as texts, since YAML 1.1 reads them so."""


def shown(value: Any) -> str:
    """A value in a message, cut to a length that can be read.

    Examples
    --------
    >>> shown("kp"), shown("x" * 100_000)[-24:], shown([1.0] * 1_000_000)[-24:]
    ("'kp'", 'x... (100000 characters)', '0,... (1000000 elements)')
    """
    has_size = isinstance(value, (str, list, array))
    told = repr(value[: LONGEST_SHOWN + 1] if has_size else value)  # of a million elements it would take a while
    if len(told) <= LONGEST_SHOWN:
        return told
    unit = "elements" if has_size and not isinstance(value, str) else "characters"
    return f"{told[:LONGEST_SHOWN]}... ({len(value if has_size else told)} {unit})"


def brief(reason: str) -> str:
    """A reason without its middle where it is too long: that is a value; what is allowed stands at the end.

    Examples
    --------
    >>> brief("field = 'x'"), len(brief("x" * 100_000))
    ("field = 'x'", 805)
    """
    half = LONGEST_REASON // 2
    return reason if len(reason) <= LONGEST_REASON else f"{reason[:half]} ... {reason[-half:]}"


@dataclass(frozen=True)
class Spec:
    """One parameter.

    Attributes
    ----------
    name : str
    default : bool, int, float, str or list of str
        Its type is the parameter's type.
    description : str
        One line, with the unit.
    low, high : float
        Allowed range of a number; infinite bounds stand for none.
    choices : tuple of str
        Allowed texts; empty for any.
    read_only : bool
        Whether it can only be given at the start.
    at_configure : bool
        Whether it is read at configure, so that it stays as it is until cleanup.
    slides : bool
        Whether tools are told a range of ten times the value, which grows with it, in place of ``low`` and ``high``.
    """

    name: str
    default: Value
    description: str
    low: float = -math.inf
    high: float = math.inf
    choices: tuple[str, ...] = ()
    read_only: bool = False
    at_configure: bool = False
    slides: bool = False

    def descriptor(self, value: Value | None = None) -> ParameterDescriptor:
        """What ROS tools are told of the parameter, while it has this value."""
        described = ParameterDescriptor(
            name=self.name,
            description=self.description,
            read_only=self.read_only,
            additional_constraints=self._constraints(),
        )
        low, high = self.told_range(self.default if value is None else value)
        if isinstance(self.default, float) and (low, high) != (-math.inf, math.inf):
            described.floating_point_range = [FloatingPointRange(from_value=low, to_value=high)]
        elif type(self.default) is int and max(-low, high) <= LARGEST_INTEGER:
            described.integer_range = [IntegerRange(from_value=int(low), to_value=int(high), step=1)]
        return described

    def told_range(self, value: Any) -> tuple[float, float]:
        """The range that a slider shows; infinite where there is no bound, or one that is far away.

        Examples
        --------
        >>> Spec("kp", 0.0, "", -1e100, 1e100, slides=True).told_range(0.25)
        (-10.0, 10.0)
        >>> Spec("age", 0.0, "", 0.0, 1e9).told_range(1.0)
        (0.0, inf)
        """
        low, high = self.low, self.high
        if self.slides:
            reach = 10.0 ** (1 + math.ceil(math.log10(abs(value or 1.0))))
            return max(low, -reach), min(high, reach)
        if isinstance(self.default, float):
            return low if abs(low) <= WIDEST else -math.inf, high if abs(high) <= WIDEST else math.inf
        return low, high

    def _constraints(self) -> str:
        """What the ranges of a descriptor cannot say."""
        low, high = self.told_range(self.default)
        said = []
        if self.choices:
            said.append(f"one of: {', '.join(self.choices)}")
        elif self.slides:
            said.append(f"{self._allowed()}; the range is a slider's and grows with the value")
        elif self._bounded and math.inf in (-low, high):
            said.append(self._allowed())
        if self.at_configure:
            said.append("changes only while the node is unconfigured")
        return "; ".join(said)

    def check(self, value: Any) -> None:
        """Raise InputError for a value that is not allowed."""
        if type(value) is not type(self.default):
            raise InputError(f"{self.name} = {shown(value)}; allowed: {self._kind()}")
        if isinstance(value, float) and math.isnan(value):
            raise InputError(f"{self.name} = nan; allowed: {self._allowed()}")
        if isinstance(value, (int, float)) and not self.low <= value <= self.high:
            raise InputError(f"{self.name} = {value}; allowed: {self._allowed()}")
        if self.choices and value not in self.choices:
            raise InputError(f"{self.name} = {shown(value)}; allowed: {self._allowed()}")

    def _allowed(self) -> str:
        if self.choices:
            return ", ".join(self.choices)
        if self._bounded:
            return f"{self.low:g} to {self.high:g}"
        return self._kind()

    @property
    def _bounded(self) -> bool:
        return math.isfinite(self.low) or math.isfinite(self.high)

    def _kind(self) -> str:
        return {
            bool: "true or false",
            int: "a whole number",
            float: "a number",
            str: "a text",
            list: "a list of texts",
        }[type(self.default)]

    def converted(self, value: Any) -> Any:
        """``value`` as it was meant: a whole number serves as a number, a number as text.

        Texts such as ``inf`` and ``1e-05`` are numbers, and ``off`` is no truth value, though YAML reads them so.

        Examples
        --------
        >>> Spec("control_max", 0.0, "").converted("inf")
        inf
        >>> Spec("adapt", "off", "", choices=("off", "apply")).converted(False)
        'off'
        """
        if isinstance(self.default, float) and type(value) is int:
            return float(value)
        if isinstance(self.default, float) and isinstance(value, str) and _NUMBER_AS_TEXT.fullmatch(value):
            return float(value.lower().replace(".inf", "inf"))
        if isinstance(value, bool):
            return next((choice for choice in self.choices if _as_yaml(choice) is value), value)
        if isinstance(self.default, str) and type(value) in (int, float):
            return str(value)
        return value


def declare(node: Node, specs: Mapping[str, Spec]) -> None:
    """Declare all parameters of a node.

    Raises
    ------
    InputError
        For a value of the wrong type or out of range, and for a name that the node does not have.
    """
    overrides: dict[str, Parameter] = node._parameter_overrides  # noqa: SLF001  (no public way to see them)
    _refuse_unknown(node, specs, (name for name in overrides if not name.startswith(QOS_PREFIX)))
    for spec in specs.values():
        given = overrides.get(spec.name)
        if given is not None:
            value = spec.converted(given.value)
            spec.check(value)
            overrides[spec.name] = Parameter(spec.name, value=value)
        try:
            present = overrides[spec.name].value if given is not None else spec.default
            node.declare_parameter(spec.name, spec.default, spec.descriptor(present))
        except (InvalidParameterTypeException, InvalidParameterValueException) as error:
            raise InputError(" ".join(str(error).split())) from None


def _as_yaml(text: str) -> Any:
    """What the command ``ros2 param`` makes of a text."""
    return parameter_value_to_python(get_parameter_value(text))


def _refuse_unknown(node: Node, specs: Mapping[str, Spec], names: Iterable[str]) -> None:
    for name in names:
        if name not in specs and not node.has_parameter(name):
            raise InputError(f"{node.get_name()} has no parameter {shown(name)}{nearest(name, specs)}")


def nearest(given: str, allowed: Iterable[str]) -> str:
    """The end of a message about a name that is not allowed: the nearest that is, or all of them."""
    known = list(allowed)
    near = difflib.get_close_matches(given, known, n=1)
    return f"; did you mean {near[0]!r}?" if near else f"; allowed: {', '.join(known)}"


def current_values(node: Node, specs: Mapping[str, Spec], changes: Iterable[Parameter] = ()) -> dict[str, Any]:
    """All parameters by name as they would be with ``changes`` made."""
    current = {name: node.get_parameter(name).value for name in specs}
    current.update({change.name: change.value for change in changes if change.name in current})
    return current


def changes_of(messages: Iterable[ParameterMessage]) -> list[Parameter]:
    """What a request asks to change.

    Raises
    ------
    InputError
        For a type that parameters do not have: a message can hold any number there. For a list whose conversion would
        hold the loop up: a million numbers take half a second.
    """
    messages = list(messages)
    for message in messages:
        longest = max(len(getattr(message.value, name)) for name in LISTS)
        if longest > LONGEST_LIST:
            raise InputError(f"{shown(message.name)}: a list of {longest} elements; allowed: up to {LONGEST_LIST}")
        if message.value.type > ParameterType.PARAMETER_STRING_ARRAY:
            known = f"allowed: 0 to {ParameterType.PARAMETER_STRING_ARRAY}"
            raise InputError(f"{shown(message.name)}: type = {message.value.type}; {known}")
    return [Parameter.from_parameter_msg(message) for message in messages]


def converted(specs: Mapping[str, Spec], changes: Iterable[Parameter]) -> list[Parameter]:
    """The changes with values converted as at the start."""
    return [
        Parameter(change.name, value=specs[change.name].converted(change.value)) if change.name in specs else change
        for change in changes
    ]


def without_idle(node: Node, changes: Iterable[Parameter]) -> list[Parameter]:
    """The changes without those that give a read-only parameter the value that it has: a dump holds them, too."""
    return [
        change for change in changes
        if not (node.has_parameter(change.name) and node.describe_parameter(change.name).read_only
                and node.get_parameter(change.name).value == change.value)
    ]  # fmt: skip


def widen_sliders(node: Node, specs: Mapping[str, Spec], changes: Iterable[Parameter]) -> None:
    """Let the ranges that tools are told of grow, so that the new values lie within."""
    for change in changes:
        spec = specs.get(change.name)
        if spec is None or not spec.slides:
            continue
        (told,) = node.describe_parameter(change.name).floating_point_range
        low, high = spec.told_range(change.value)
        told.from_value, told.to_value = min(told.from_value, low), max(told.to_value, high)


def check_changes(node: Node, specs: Mapping[str, Spec], changes: Iterable[Parameter], *, configured: bool) -> None:
    """Check each change by itself.

    Raises
    ------
    InputError
        For the first that is not allowed.
    """
    changes = list(changes)
    _refuse_unknown(node, specs, (change.name for change in changes))
    for change in changes:
        spec = specs.get(change.name)
        if spec is None:
            continue
        spec.check(change.value)
        present = node.get_parameter(change.name).value
        if configured and spec.at_configure and change.value != present:
            raise InputError(
                f"{change.name} = {shown(change.value)}; allowed: {shown(present)} until the node is cleaned up"
            )
