"""Parameters of a node as a table: names, defaults, ranges, descriptions, in one place and checked alike."""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.exceptions import InvalidParameterTypeException, InvalidParameterValueException
from rclpy.node import Node
from rclpy.parameter import Parameter

from fopid_core.errors import InputError

Value = bool | int | float | str

QOS_PREFIX = "qos_overrides."
"""Parameters of this prefix are rclpy's own, declared with the topics."""


@dataclass(frozen=True)
class Spec:
    """One parameter.

    Attributes
    ----------
    name : str
    default : bool, int, float or str
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
    """

    name: str
    default: Value
    description: str
    low: float = -math.inf
    high: float = math.inf
    choices: tuple[str, ...] = ()
    read_only: bool = False
    at_configure: bool = False

    def descriptor(self) -> ParameterDescriptor:
        """What ROS tools are told of the parameter."""
        described = ParameterDescriptor(
            name=self.name,
            description=self.description,
            read_only=self.read_only,
            additional_constraints=self._constraints(),
        )
        bounded = math.isfinite(self.low) and math.isfinite(self.high)
        if bounded and isinstance(self.default, float):
            described.floating_point_range = [FloatingPointRange(from_value=self.low, to_value=self.high)]
        elif bounded and type(self.default) is int:
            described.integer_range = [IntegerRange(from_value=int(self.low), to_value=int(self.high), step=1)]
        return described

    def _constraints(self) -> str:
        """What the ranges of a descriptor cannot say."""
        said = []
        if self.choices:
            said.append(f"one of: {', '.join(self.choices)}")
        elif math.isfinite(self.low) != math.isfinite(self.high):
            said.append(self._allowed())
        if self.at_configure:
            said.append("changes only while the node is unconfigured")
        return "; ".join(said)

    def check(self, value: Any) -> None:
        """Raise InputError for a value that is not allowed."""
        if type(value) is not type(self.default):
            raise InputError(f"{self.name} = {value!r}; allowed: {self._kind()}")
        if isinstance(value, float) and math.isnan(value):
            raise InputError(f"{self.name} = nan; allowed: {self._allowed()}")
        if isinstance(value, (int, float)) and not self.low <= value <= self.high:
            raise InputError(f"{self.name} = {value}; allowed: {self._allowed()}")
        if self.choices and value not in self.choices:
            raise InputError(f"{self.name} = {value!r}; allowed: {self._allowed()}")

    def _allowed(self) -> str:
        if self.choices:
            return ", ".join(self.choices)
        if math.isfinite(self.low) or math.isfinite(self.high):
            return f"{self.low:g} to {self.high:g}"
        return self._kind()

    def _kind(self) -> str:
        return {bool: "true or false", int: "a whole number", float: "a number", str: "a text"}[type(self.default)]

    def converted(self, value: Any) -> Any:
        """``value`` as typed at a start: a whole number serves as a number, a number as text."""
        if isinstance(self.default, float) and type(value) is int:
            return float(value)
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
            node.declare_parameter(spec.name, spec.default, spec.descriptor())
        except (InvalidParameterTypeException, InvalidParameterValueException) as error:
            raise InputError(" ".join(str(error).split())) from None


def _refuse_unknown(node: Node, specs: Mapping[str, Spec], names: Iterable[str]) -> None:
    for name in names:
        if name not in specs and not node.has_parameter(name):
            raise InputError(f"{node.get_name()} has no parameter {name!r}{nearest(name, specs)}")


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


def converted(specs: Mapping[str, Spec], changes: Iterable[Parameter]) -> list[Parameter]:
    """The changes with values converted as at the start."""
    return [
        Parameter(change.name, value=specs[change.name].converted(change.value)) if change.name in specs else change
        for change in changes
    ]


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
            raise InputError(f"{change.name} = {change.value!r}; allowed: {present!r} until the node is cleaned up")
