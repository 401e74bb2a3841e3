"""Parameters of a node as a table: names, defaults, ranges, descriptions, in one place and checked alike."""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.exceptions import InvalidParameterTypeException, InvalidParameterValueException
from rclpy.node import Node
from rclpy.parameter import Parameter

from fopid_core.errors import InputError

Value = bool | int | float | str


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
    """

    name: str
    default: Value
    description: str
    low: float = -math.inf
    high: float = math.inf
    choices: tuple[str, ...] = ()
    read_only: bool = False

    def descriptor(self) -> ParameterDescriptor:
        """What ROS tools are told of the parameter."""
        described = ParameterDescriptor(
            name=self.name,
            description=self.description,
            read_only=self.read_only,
            additional_constraints=f"one of: {', '.join(self.choices)}" if self.choices else "",
        )
        bounded = math.isfinite(self.low) and math.isfinite(self.high)
        if bounded and isinstance(self.default, float):
            described.floating_point_range = [FloatingPointRange(from_value=self.low, to_value=self.high)]
        elif bounded and type(self.default) is int:
            described.integer_range = [IntegerRange(from_value=int(self.low), to_value=int(self.high), step=1)]
        return described

    def check(self, value: Value) -> None:
        """Raise InputError for a value that is not allowed."""
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
        return "a number"

    def converted(self, value: Any) -> Any:
        """``value`` as typed at a start: a whole number serves as a number, a number as text."""
        if isinstance(self.default, float) and type(value) is int:
            return float(value)
        if isinstance(self.default, str) and type(value) in (int, float):
            return str(value)
        return value


def declare(node: Node, specs: Sequence[Spec]) -> None:
    """Declare all parameters of a node.

    Raises
    ------
    InputError
        For a value of the wrong type or out of range, and for a name that the node does not have.
    """
    overrides: dict[str, Parameter] = node._parameter_overrides  # noqa: SLF001  (no public way to see them)
    _refuse_unknown(node, specs, overrides)
    for spec in specs:
        given = overrides.get(spec.name)
        if given is not None:
            value = spec.converted(given.value)
            overrides[spec.name] = Parameter(spec.name, value=value)
            _check_type(spec, value)
            spec.check(value)
        try:
            node.declare_parameter(spec.name, spec.default, spec.descriptor())
        except (InvalidParameterTypeException, InvalidParameterValueException) as error:
            raise InputError(" ".join(str(error).split())) from None


def _check_type(spec: Spec, value: Any) -> None:
    if type(value) is not type(spec.default):
        wanted = {bool: "true or false", int: "a whole number", float: "a number", str: "a text"}[type(spec.default)]
        raise InputError(f"{spec.name} = {value!r}; allowed: {wanted}")


def _refuse_unknown(node: Node, specs: Sequence[Spec], overrides: Iterable[str]) -> None:
    known = [spec.name for spec in specs]
    for name in overrides:
        if name in known or node.has_parameter(name) or name.startswith("qos_overrides."):
            continue
        near = difflib.get_close_matches(name, known, n=1)
        hint = f"; did you mean {near[0]!r}?" if near else f"; allowed: {', '.join(known)}"
        raise InputError(f"{node.get_name()} has no parameter {name!r}{hint}")


def values(node: Node, specs: Sequence[Spec], changes: Iterable[Parameter] = ()) -> dict[str, Any]:
    """All parameters by name as they would be with ``changes`` made."""
    current = {spec.name: node.get_parameter(spec.name).value for spec in specs}
    current.update({p.name: p.value for p in changes if p.name in current})
    return current


def check_changes(specs: Mapping[str, Spec], changes: Iterable[Parameter]) -> None:
    """Check each change by itself.

    Raises
    ------
    InputError
        For the first value that is not allowed.
    """
    for change in changes:
        if change.name in specs:
            specs[change.name].check(change.value)
