"""The demonstration: a loop, tuned twice while it runs, recorded, with a report at the end.

``ros2 launch fopid_ros demo.launch.py process:="9/((s+1)(s^2+2s+9))"``
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction, Shutdown
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from fopid_core.study.experiments.demonstration import demo_experiment
from fopid_ros.experiment.command import run_folder
from fopid_ros.experiment.with_nodes import node_parameters


def start(context):
    """Write the experiment file and start the four nodes."""
    experiment = demo_experiment(LaunchConfiguration("process").perform(context))
    folder = run_folder("demo")
    folder.mkdir(parents=True)
    file = folder / "experiment.yaml"
    file.write_text(experiment.to_yaml(), encoding="utf-8")
    nodes = [
        Node(package="fopid_ros", executable=name, name=name, parameters=[parameters], output="screen")
        for name, parameters in node_parameters(experiment).items()
    ]
    conductor = Node(
        package="fopid_ros",
        executable="experiment",
        arguments=[str(file), "--out", str(folder)],
        output="screen",
        on_exit=Shutdown(),
    )
    return [*nodes, conductor]


def generate_launch_description():
    """Start the demonstration."""
    return LaunchDescription([DeclareLaunchArgument("process", default_value="P1"), OpaqueFunction(function=start)])
