"""The demonstration: a loop, tuned twice while it runs, recorded, with a report at the end.

``ros2 launch fopid_ros demo.launch.py process:="9/((s+1)(s^2+2s+9))"``
"""

from launch.actions import Shutdown
from launch_ros.actions import Node

from fopid_core.study.experiments.demonstration import demo_experiment
from fopid_ros.experiment.command import run_folder
from fopid_ros.experiment.with_nodes import node_parameters
from fopid_ros.launching.actions import (
    PROCESS,
    alone,
    argument,
    given,
    launch_description,
    place_arguments,
)


def start(context):
    """Write the experiment file and start the four nodes, when no other loop is on their topics."""
    experiment = demo_experiment(given(context, "process"))
    alone(context)
    folder = run_folder("demo")
    folder.mkdir(parents=True)
    file = folder / "experiment.yaml"
    file.write_text(experiment.to_yaml(), encoding="utf-8")
    where = {
        "package": "fopid_ros", "namespace": given(context, "namespace"), "output": "screen",
        "remappings": [("/clock", "clock")] if given(context, "namespace") else [],
        "ros_arguments": ["--log-level", given(context, "log_level")],
    }  # fmt: skip
    nodes = [
        Node(executable=name, name=name, parameters=[parameters], **where)
        for name, parameters in node_parameters(experiment).items()
    ]
    over = Shutdown(reason="the demonstration is over")
    return [*nodes, Node(executable="experiment", arguments=[str(file), "--out", str(folder)], on_exit=over, **where)]


def generate_launch_description():
    """Start the demonstration."""
    return launch_description(start, argument("process", "P1", PROCESS), *place_arguments())
