"""A cascade: speed within position, with two plants that stand for a motor and its axis.

``ros2 launch fopid_ros cascade.launch.py``
"""

from fopid_ros.launching.actions import (
    TRUTHS,
    argument,
    common_arguments,
    given,
    launch_description,
    managed_node,
)
from fopid_ros.launching.cascade import cascade_nodes
from fopid_ros.launching.loop import existing_file, installed_config


def start(context):
    """Plants, unless the plant is real, and controllers."""
    file = existing_file(given(context, "params_file") or installed_config("cascade"))
    nodes = cascade_nodes(given(context, "namespace"))
    if given(context, "plant") == "false":
        nodes = [node for node in nodes if node.executable != "plant_simulator"]
    return [managed_node(context, node.executable, [file], node.remappings, node.namespace) for node in nodes]


def generate_launch_description():
    """Start the cascade."""
    return launch_description(
        start,
        argument("params_file", "", "parameter file of all nodes; empty: cascade.yaml"),
        argument("plant", "true", "simulate motor and axis; false: they are there", TRUTHS),
        *common_arguments(),
    )
