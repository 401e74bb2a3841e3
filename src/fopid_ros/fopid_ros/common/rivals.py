"""Other loops on the same topics: two plants or two controllers would drive each other's loop."""

from __future__ import annotations

import time
from collections.abc import Sequence

import rclpy
from rclpy._rclpy_pybind11 import RCLError
from rclpy.context import Context
from rclpy.exceptions import InvalidNamespaceException
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from fopid_core.errors import InputError
from fopid_ros.common.middleware import prepare_middleware

NAME_TIME = 3.0  # how long the name of a publisher's node may take to be known [s]
LOOK_TIME = 4.0  # how long nodes that run may take to be found [s]: those whose answer is lost tell again after 3 s
SLICE = 0.02  # [s] between two looks
LOOP_TOPICS = ("measurement", "control")


def publisher_names(node: Node, topic: str) -> list[str]:
    """Who publishes a topic; a publisher is found a moment before the name of its node is."""
    deadline = time.monotonic() + NAME_TIME
    while True:
        infos = node.get_publishers_info_by_topic(topic)
        names = sorted(f"{info.node_namespace.rstrip('/')}/{info.node_name}" for info in infos)
        if time.monotonic() > deadline or not any("_UNKNOWN_" in name for name in names):
            return names
        time.sleep(SLICE)


def refuse_other_loops(node: Node, allowed: int) -> None:
    """Look at who publishes the measurement and the control.

    Raises
    ------
    InputError
        If more than ``allowed`` nodes publish one of them, naming them.
    """
    for topic in LOOP_TOPICS:
        names = publisher_names(node, topic)
        if len(names) > allowed:
            raise InputError(
                f"domain {node.context.get_domain_id()} is in use: {topic!r} is published by {', '.join(names)}; "
                f"allowed: one loop. Set ROS_DOMAIN_ID, or a namespace of its own for each loop"
            )


def refuse_running_loop(ros_options: Sequence[str] = ()) -> None:
    """Before anything is started: look for a loop on the topics that it would use.

    Parameters
    ----------
    ros_options : sequence of str
        What will stand behind ``--ros-args`` of the nodes: a namespace, remappings.

    Raises
    ------
    InputError
        If there is one, naming its nodes.
    """
    prepare_middleware()
    context = Context()
    try:
        rclpy.init(args=["--ros-args", *ros_options], context=context, signal_handler_options=SignalHandlerOptions.NO)
        node = Node("looks_for_loops", context=context, enable_rosout=False, start_parameter_services=False)
        try:
            deadline = time.monotonic() + LOOK_TIME
            while time.monotonic() < deadline:
                refuse_other_loops(node, allowed=0)
                time.sleep(SLICE)
        finally:
            node.destroy_node()
    except (RCLError, InvalidNamespaceException) as error:
        raise InputError(" ".join(str(error).split())) from None
    finally:
        context.try_shutdown()
