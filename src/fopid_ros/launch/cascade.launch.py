"""A cascade: speed within position, with two plants that stand for a motor and its axis.

``ros2 launch fopid_ros cascade.launch.py``
"""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription

from fopid_ros.launching.actions import (
    TRUTHS,
    argument,
    checked,
    common_arguments,
    fail_with_any_node,
    given,
    managed_node,
)
from fopid_ros.launching.cascade import cascade_nodes
from fopid_ros.launching.loop import existing_file


def default_file():
    """The example's parameters."""
    return str(Path(get_package_share_directory("fopid_ros"), "config", "cascade.yaml"))


def start(context):
    """Plants, unless the plant is real, and controllers."""
    file = existing_file(given(context, "params_file") or default_file())
    nodes = cascade_nodes(given(context, "namespace"))
    if given(context, "plant") == "false":
        nodes = [node for node in nodes if node.executable != "plant_simulator"]
    return [managed_node(context, node.executable, [file], node.remappings, node.namespace) for node in nodes]


def generate_launch_description():
    """Start the cascade."""
    return LaunchDescription(
        [
            argument("params_file", "", "parameter file of all nodes; empty: cascade.yaml"),
            argument("plant", "true", "simulate motor and axis; false: they are there", TRUTHS),
            *common_arguments(),
            fail_with_any_node(),
            checked(start),
        ]
    )
