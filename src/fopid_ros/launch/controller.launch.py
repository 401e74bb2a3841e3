"""Controller and tuner for a plant of your own.

``ros2 launch fopid_ros controller.launch.py params_file:=oven.yaml measurement:=/oven/temperature control:=/oven/heat``
"""

from fopid_ros.launching.actions import (
    argument,
    common_arguments,
    given,
    launch_description,
    managed_node,
    remapped,
    topic_arguments,
)
from fopid_ros.launching.loop import existing_file

EXECUTABLES = ("fopid_controller", "fopid_tuner")
TOPICS = {"measurement": "topic of the sensor", "control": "topic of the actuator", "setpoint": "topic of the setpoint"}


def start(context):
    """The two nodes; message types and fields of the topics are parameters."""
    file = existing_file(given(context, "params_file"))
    return [managed_node(context, name, [file], remapped(context, TOPICS)) for name in EXECUTABLES]


def generate_launch_description():
    """Start controller and tuner."""
    return launch_description(
        start,
        argument("params_file", None, "parameter file of both nodes, with the gains to start with"),
        *topic_arguments(TOPICS),
        *common_arguments(),
    )
