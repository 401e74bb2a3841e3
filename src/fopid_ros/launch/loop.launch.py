"""Plant simulator, controller and tuner with one parameter file: ``process:=P1`` ... ``P4``."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare


def generate_launch_description():
    """Start the three nodes of a loop."""
    name = [LaunchConfiguration("process"), ".yaml"]
    parameters = PathJoinSubstitution([FindPackageShare("fopid_ros"), "config", name])
    executables = ("plant_simulator", "fopid_controller", "fopid_tuner")
    nodes = [
        Node(package="fopid_ros", executable=name, name=name, parameters=[parameters], output="screen")
        for name in executables
    ]
    return LaunchDescription([DeclareLaunchArgument("process", default_value="P1"), *nodes])
