"""Another node as its parameters show it: whether it is there, what they are, what they may be."""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from rcl_interfaces.msg import ParameterDescriptor, ParameterEvent
from rclpy.node import Node
from rclpy.parameter import Parameter, parameter_value_to_python
from rclpy.parameter_client import AsyncParameterClient
from rclpy.task import Future

ANSWER_TIME = 3.0
"""How long another node may take to answer [s]."""

READ_PERIOD = 2.0  # [s]
LOOK_AGAIN = 0.01  # [s] between two looks at an answer that is awaited


class RefusedError(Exception):
    """The other node refused, or does not answer; the text says why."""


async def answer(future: Future, who: str, seconds: float, is_there: Callable[[], bool] = lambda: True) -> Any:
    """What a service answers; somebody else spins the node meanwhile.

    Raises
    ------
    RefusedError
        If the answer does not come in time, or ``is_there`` says that it will not come.
    """
    deadline = time.monotonic() + seconds
    while not future.done():
        if time.monotonic() > deadline or not is_there():
            future.cancel()
            raise RefusedError(f"{who} does not answer")
        await asyncio.sleep(LOOK_AGAIN)
    return future.result()


def _range(descriptor: ParameterDescriptor) -> tuple[float | None, float | None]:
    for allowed in (*descriptor.floating_point_range, *descriptor.integer_range):
        low, high = float(allowed.from_value), float(allowed.to_value)
        return low if math.isfinite(low) else None, high if math.isfinite(high) else None
    return None, None


class RemoteParameters:
    """Some of another node's parameters, kept up to date.

    Parameters
    ----------
    node : Node
        Whose clients and subscriptions are used.
    name : str
        The other node, absolute or in the namespace of ``node``.
    parameters : sequence of str
        The parameters to follow.
    on_change : callable
        Called with ``values`` after each change of any of them.

    Attributes
    ----------
    name : str
        Its full name.
    present : bool
        Whether it answers.
    values : dict
        By parameter; empty until it has answered once.
    ranges : dict
        Least and greatest value allowed, by parameter; None for no bound.
    """

    def __init__(
        self,
        node: Node,
        name: str,
        parameters: Sequence[str],
        on_change: Callable[[Mapping[str, Any]], None] = lambda values: None,
    ) -> None:
        self._node = node
        self._client = AsyncParameterClient(node, name)
        self.name = node.resolve_service_name(f"{name}/get_parameters").removesuffix("/get_parameters")
        self._parameters = list(parameters)
        self._on_change = on_change
        self._lives: set[tuple[int, ...]] = set()
        self._read_again = 0.0
        self.present = False
        self.values: dict[str, Any] = {}
        self.ranges: dict[str, tuple[float | None, float | None]] = {}
        node.create_subscription(ParameterEvent, "/parameter_events", self._on_event, 100)

    async def poll(self) -> None:
        """See whether it is there; read everything when it is there anew, and now and then, lest an event was lost."""
        lives = self._processes() if self._client.services_are_ready() else set()
        if lives and lives <= self._lives and time.monotonic() < self._read_again:
            return
        try:
            if lives:
                await self._read()
            self.present, self._lives = bool(lives), lives
        except RefusedError:
            self.present = False
        self._read_again = time.monotonic() + READ_PERIOD

    def _processes(self) -> set[tuple[int, ...]]:
        """What tells the processes of that name apart: one that was killed is still listed for some seconds.

        Each answers through a writer of its own; where the transport does not show it, all count as one process.
        """
        writers = self._node.get_publishers_info_by_topic(f"rr{self.name}/get_parametersReply", no_mangle=True)
        return {tuple(writer.endpoint_gid) for writer in writers} or {()}

    async def _read(self) -> None:
        described = await answer(self._client.describe_parameters(self._parameters), self.name, ANSWER_TIME)
        got = await answer(self._client.get_parameters(self._parameters), self.name, ANSWER_TIME)
        self.ranges = {descriptor.name: _range(descriptor) for descriptor in described.descriptors}
        self._take(zip(self._parameters, got.values, strict=False))

    def _take(self, changes: Any) -> None:
        news = {name: parameter_value_to_python(value) for name, value in changes if name in self._parameters}
        self.values = {**self.values, **{name: value for name, value in news.items() if value is not None}}
        if news:
            self._on_change(self.values)

    def _on_event(self, event: ParameterEvent) -> None:
        if event.node == self.name:
            self._take((changed.name, changed.value) for changed in event.changed_parameters)

    async def set(self, values: Mapping[str, Any]) -> None:
        """Set parameters, all of them or none.

        Raises
        ------
        RefusedError
            With the other node's reason, or because it is not there.
        """
        if not self._client.services_are_ready():
            raise RefusedError(f"{self.name} is not there")
        parameters = [Parameter(name, value=value) for name, value in values.items()]
        response = await answer(self._client.set_parameters_atomically(parameters), self.name, ANSWER_TIME)
        if not response.result.successful:
            raise RefusedError(response.result.reason)


OF_ROS = {"use_sim_time": "take the time from /clock"}
"""What ROS itself leaves without a description."""


class AllParameters:
    """All parameters of another node, read when somebody wants to see them.

    Parameters
    ----------
    node : Node
    name : str
        The other node.
    """

    def __init__(self, node: Node, name: str) -> None:
        self._client = AsyncParameterClient(node, name)
        self.name = node.resolve_service_name(f"{name}/get_parameters").removesuffix("/get_parameters")
        self._first: dict[str, Any] = {}

    async def read(self) -> list[dict[str, Any]] | None:
        """Each with its value, range and description; None when the node is not there."""
        if not self._client.services_are_ready():
            return None
        listed = await answer(self._client.list_parameters(), self.name, ANSWER_TIME)
        names = sorted(name for name in listed.result.names if not name.startswith("qos_overrides."))
        described = await answer(self._client.describe_parameters(names), self.name, ANSWER_TIME)
        got = await answer(self._client.get_parameters(names), self.name, ANSWER_TIME)
        pairs = zip(described.descriptors, got.values, strict=False)
        return [self._told(descriptor, parameter_value_to_python(value)) for descriptor, value in pairs]

    def _told(self, descriptor: ParameterDescriptor, value: Any) -> dict[str, Any]:
        low, high = _range(descriptor)
        first = self._first.setdefault(descriptor.name, value)
        return {
            "name": descriptor.name, "value": _as_json(value), "first": _as_json(first),
            "type": _type_name(descriptor.type, value),
            "description": descriptor.description or OF_ROS.get(descriptor.name, "no description"),
            "constraints": descriptor.additional_constraints, "low": low, "high": high,
            "read_only": descriptor.read_only,
        }  # fmt: skip

    async def set(self, name: str, value: Any) -> str:
        """Set one; a text of digits serves as the number it looks like, as on a command line.

        Raises
        ------
        RefusedError
            With the other node's reason, or because it is not there.
        """
        if not self._client.services_are_ready():
            raise RefusedError(f"{self.name} is not there")
        got = await answer(self._client.get_parameters([name]), self.name, ANSWER_TIME)
        present = parameter_value_to_python(got.values[0]) if got.values else None
        wanted = _as_type_of(present, value)
        parameter = [Parameter(name, value=wanted)]
        response = await answer(self._client.set_parameters_atomically(parameter), self.name, ANSWER_TIME)
        if not response.result.successful:
            raise RefusedError(response.result.reason)
        return f"{name} = {wanted}"


def _as_json(value: Any) -> Any:
    """JSON has neither infinity nor NaN: they travel as texts."""
    return str(value) if isinstance(value, float) and not math.isfinite(value) else value


def _type_name(number: int, value: Any) -> str:
    names = {1: "bool", 2: "integer", 3: "double", 4: "string"}
    return names.get(number, type(value).__name__)


def _as_type_of(present: Any, value: Any) -> Any:
    """What was typed, as a value of the parameter's type where it can be one; the node says what is wrong otherwise.

    Examples
    --------
    >>> _as_type_of(1.0, "inf"), _as_type_of(1.0, 2), _as_type_of(3, "4"), _as_type_of("a", "1"), _as_type_of(1.0, "x")
    (inf, 2.0, 4, '1', 'x')
    """
    if isinstance(value, list):
        return [str(one) for one in value]
    if isinstance(present, bool) or isinstance(value, bool) or not isinstance(value, (int, float, str)):
        return value if isinstance(value, (bool, int, float, str)) else str(value)
    if isinstance(present, (int, float)):
        try:
            return type(present)(str(value))  # a whole number from 2.5 is none
        except (ValueError, OverflowError):
            return value
    return str(value)
