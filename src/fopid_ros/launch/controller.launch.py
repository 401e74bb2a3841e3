"""Controller and tuner for a plant of your own.

``ros2 launch fopid_ros controller.launch.py params_file:=oven.yaml measurement:=/oven/temperature control:=/oven/heat``
"""

from launch import LaunchDescription

from fopid_ros.launching.actions import (
    argument,
    checked,
    common_arguments,
    fail_with_any_node,
    given,
    managed_node,
)
from fopid_ros.launching.loop import existing_file

EXECUTABLES = ("fopid_controller", "fopid_tuner")
TOPICS = {"measurement": "topic of the sensor", "control": "topic of the actuator", "setpoint": "topic of the setpoint"}


def start(context):
    """The two nodes; message types and fields of the topics are parameters."""
    file = existing_file(given(context, "params_file"))
    topics = [(name, given(context, name)) for name in TOPICS]
    return [managed_node(context, name, [file], topics) for name in EXECUTABLES]


def generate_launch_description():
    """Start controller and tuner."""
    return LaunchDescription(
        [
            argument("params_file", None, "parameter file of both nodes, with the gains to start with"),
            *(argument(name, name, description) for name, description in TOPICS.items()),
            *common_arguments(),
            fail_with_any_node(),
            checked(start),
        ]
    )
