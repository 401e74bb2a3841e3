"""What a node opens at configure and closes at cleanup; the QoS of its topics can be overridden by parameters."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rclpy.callback_groups import CallbackGroup
from rclpy.clock import Clock
from rclpy.exceptions import InvalidParameterTypeException
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSPolicyKind, QoSProfile
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.service import Service
from rclpy.subscription import Subscription
from rclpy.timer import Timer

from fopid_core.errors import InputError
from fopid_ros.common.parameters import QOS_PREFIX, nearest

POLICIES = (QoSPolicyKind.DEPTH, QoSPolicyKind.DURABILITY, QoSPolicyKind.HISTORY, QoSPolicyKind.RELIABILITY)
"""Each is a parameter ``qos_overrides.<topic>.<publisher or subscription>.<policy>``."""

_WORDS = {
    "durability": "volatile, transient_local, system_default",
    "history": "keep_last, keep_all, system_default",
    "reliability": "reliable, best_effort, system_default",
    "depth": "a whole number above 0",
}


class Endpoints:
    """Publishers, subscriptions, services and timers that open and close together.

    Parameters
    ----------
    node : Node
        Theirs.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._opened: list[tuple[Any, Callable[[Any], Any]]] = []

    def publisher(self, kind: Any, topic: str, qos: QoSProfile) -> Publisher:
        """Open a publisher.

        Raises
        ------
        InputError
            If an override of its QoS cannot be used.
        """
        opened: Publisher = self._overridable(
            "publisher", topic, lambda options: self._node.create_publisher(kind, topic, qos, **options)
        )
        self._opened.append((opened, self._node.destroy_publisher))
        return opened

    def subscription(
        self, kind: Any, topic: str, callback: Callable[..., None], qos: QoSProfile, **more: Any
    ) -> Subscription:
        """Open a subscription, with what else the node's ``create_subscription`` takes; raises as ``publisher`` does.

        Its callback gets bytes when it is ``raw``.
        """
        opened: Subscription = self._overridable(
            "subscription", topic,
            lambda options: self._node.create_subscription(kind, topic, callback, qos, **more, **options),
        )  # fmt: skip
        self._opened.append((opened, self._node.destroy_subscription))
        return opened

    def fixed_subscription(
        self, kind: Any, topic: str, callback: Callable[..., None], qos: QoSProfile, *, raw: bool = False
    ) -> Subscription:
        """Open a subscription whose QoS is what it is for, and is not overridden."""
        opened = self._node.create_subscription(kind, topic, callback, qos, raw=raw)
        self._opened.append((opened, self._node.destroy_subscription))
        return opened

    def service(self, kind: Any, name: str, callback: Callable[[Any, Any], Any]) -> Service:
        """Open a service."""
        opened = self._node.create_service(kind, name, callback)
        self._opened.append((opened, self._node.destroy_service))
        return opened

    def timer(
        self, period: float, callback: Callable[[], None], clock: Clock, group: CallbackGroup | None = None
    ) -> Timer:
        """Start a timer [s], in the node's own callback group unless told otherwise."""
        opened = self._node.create_timer(period, callback, group, clock)
        self._opened.append((opened, self._node.destroy_timer))
        return opened

    def close(self) -> None:
        """Close all, the last opened first."""
        while self._opened:
            opened, destroy = self._opened.pop()
            destroy(opened)

    def destroy(self, opened: Any) -> None:
        """Close one of them before the others."""
        for k, (each, destroy) in enumerate(self._opened):
            if each is opened:
                del self._opened[k]
                destroy(opened)
                return

    def refuse_unknown_overrides(self) -> None:
        """Raise InputError for a QoS override of a topic or policy that the node does not have."""
        overrides = self._node._parameter_overrides  # noqa: SLF001  (no public way to see them)
        declared = [name for name in self._node.get_parameters_by_prefix("") if name.startswith(QOS_PREFIX)]
        for name in overrides:
            if name.startswith(QOS_PREFIX) and name not in declared:
                raise InputError(f"{self._node.get_name()} has no parameter {name!r}{nearest(name, declared)}")

    def _overridable(self, entity: str, topic: str, create: Callable[[dict[str, Any]], Any]) -> Any:
        prefix = f"{QOS_PREFIX}{self._node.resolve_topic_name(topic)}.{entity}."
        self._check_overrides(prefix)
        try:
            return create({"qos_overriding_options": QoSOverridingOptions(POLICIES)})
        except (RuntimeError, InvalidParameterTypeException) as error:
            raise InputError(f"{prefix}*: {' '.join(str(error).split())}") from None

    def _check_overrides(self, prefix: str) -> None:
        """What rclpy would refuse without naming it, or not at all."""
        overrides = self._node._parameter_overrides  # noqa: SLF001
        for policy, allowed in _WORDS.items():
            given = overrides.get(prefix + policy)
            if given is None:
                continue
            fits = given.value in allowed.split(", ")
            if policy == "depth":
                fits = type(given.value) is int and given.value > 0
            if not fits:
                raise InputError(f"{prefix}{policy} = {given.value!r}; allowed: {allowed}")
