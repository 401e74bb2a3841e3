"""Publishers of another message type than a node listens for: they are never heard, and nothing else says so."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rclpy.node import Node


def type_name(message_type: Any) -> str:
    """``package/msg/Name`` of a message's class.

    Examples
    --------
    >>> from std_msgs.msg import Float64
    >>> type_name(Float64)
    'std_msgs/msg/Float64'
    """
    return f"{message_type.__module__.partition('.')[0]}/msg/{message_type.__name__}"


class MessageTypes:
    """Watches what publishers of a node's inputs send: another type than is listened for is logged, once.

    Parameters
    ----------
    node : Node
    expected : mapping
        Topic -> message class.
    """

    def __init__(self, node: Node, expected: Mapping[str, Any]) -> None:
        self._node = node
        self._expected = {topic: type_name(kind) for topic, kind in expected.items()}
        self._known: set[str] = set()

    def check(self) -> list[str]:
        """What is published just now in vain, in words."""
        told = []
        for topic, expected in self._expected.items():
            for info in self._node.get_publishers_info_by_topic(self._node.resolve_topic_name(topic)):
                if info.topic_type == expected or "_UNKNOWN_" in info.node_name:
                    continue
                publisher = f"{info.node_namespace.rstrip('/')}/{info.node_name}"
                told.append(
                    f"{topic} comes from {publisher} as {info.topic_type} and is not heard; "
                    f"allowed: {expected}, or {topic}.type = {info.topic_type}"
                )
        for text in set(told) - self._known:
            self._node.get_logger().warning(text)
        self._known = set(told)
        return told
