"""One controller for many joints, and a tuner for one of them.

``ros2 launch fopid_ros joints.launch.py params_file:=arm.yaml measurement:=/joint_states dof:=elbow``
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
from fopid_ros.launching.loop import existing_file, installed_config

TOPICS = {
    "measurement": "topic of the joint states",
    "control": "topic of the actuators",
    "setpoint": "topic of the setpoints",
}


def start(context):
    """The two nodes; ``dof`` overrides the joint of the parameter file."""
    file = existing_file(given(context, "params_file") or installed_config("arm"))
    topics = [(name, given(context, name)) for name in TOPICS]
    dof = given(context, "dof")
    return [
        managed_node(context, "fopid_controller", [file], topics),
        managed_node(context, "fopid_tuner", [file, *([{"dof": dof}] if dof else [])], topics),
    ]


def generate_launch_description():
    """Start controller and tuner."""
    return LaunchDescription(
        [
            argument("params_file", "", "parameter file of both nodes; empty: config/arm.yaml, three joints"),
            argument("dof", "", "the joint that the tuner is for; empty: as in the parameter file"),
            *(argument(name, name, description) for name, description in TOPICS.items()),
            *common_arguments(),
            fail_with_any_node(),
            checked(start),
        ]
    )
