"""One controller for many joints, and a tuner for one of them.

``ros2 launch fopid_ros joints.launch.py params_file:=arm.yaml measurement:=/joint_states dof:=elbow``
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
from fopid_ros.launching.loop import existing_file, installed_config

TOPICS = {
    "measurement": "topic of the joint states",
    "control": "topic of the actuators",
    "setpoint": "topic of the setpoints",
}


def start(context):
    """The two nodes; ``dof`` overrides the joint of the parameter file."""
    file = existing_file(given(context, "params_file") or installed_config("arm"))
    topics, dof = remapped(context, TOPICS), given(context, "dof")
    return [
        managed_node(context, "fopid_controller", [file], topics),
        managed_node(context, "fopid_tuner", [file, *([{"dof": dof}] if dof else [])], topics),
    ]


def generate_launch_description():
    """Start controller and tuner."""
    return launch_description(
        start,
        argument("params_file", "", "parameter file of both nodes; empty: config/arm.yaml, three joints"),
        argument("dof", "", "the joint that the tuner is for; empty: as in the parameter file"),
        *topic_arguments(TOPICS),
        *common_arguments(),
    )
