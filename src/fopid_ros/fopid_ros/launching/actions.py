"""Actions of the package ``launch`` that the launch files share; it comes with ROS 2, not with pip."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction, RegisterEventHandler
from launch.event_handlers import OnProcessExit
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import LifecycleNode

from fopid_core.errors import InputError
from fopid_ros.common.rivals import refuse_running_loop

LEVELS = ("debug", "info", "warn", "error", "fatal")
TRUTHS = ("true", "false")
PROCESS = "P1 ... P4, or a transfer function in s as text, such as '2/(s+1)^3 * exp(-0.2s)'"


class LaunchFailedError(Exception):
    """Ends the launch with one line and exit code 1."""


def argument(name: str, default: str | None, description: str, choices: tuple[str, ...] | None = None) -> Any:
    """A described argument of a launch file; without a default it must be given."""
    return DeclareLaunchArgument(name, default_value=default, description=description, choices=choices)


def place_arguments() -> list[Any]:
    """Where the nodes are, and how much they say."""
    return [
        argument("namespace", "", "namespace of all nodes and topics, so that several loops run side by side"),
        argument("log_level", "info", "of the nodes", LEVELS),
    ]


def common_arguments() -> list[Any]:
    """What every loop of managed nodes can be started with."""
    return [
        *place_arguments(),
        argument("use_sim_time", "false", "follow /clock of somebody else", TRUTHS),
        argument("autostart", "true", "configure and activate; false: wait for a lifecycle manager", TRUTHS),
    ]


def topic_arguments(topics: Mapping[str, str]) -> list[Any]:
    """An argument for each topic, by its name in the nodes, with what it is of; ``remapped`` reads them."""
    return [argument(name, name, description) for name, description in topics.items()]


def given(context: Any, name: str) -> str:
    """What an argument was given as."""
    return str(LaunchConfiguration(name).perform(context))


def remapped(context: Any, topics: Iterable[str]) -> list[tuple[str, str]]:
    """What each topic was given as."""
    return [(name, given(context, name)) for name in topics]


def managed_node(
    context: Any, executable: str, parameters: list[object], remappings: Iterable[tuple[str, str]] = (),
    namespace: str | None = None,
) -> Any:  # fmt: skip
    """One of this package's managed nodes, with the common arguments; in their namespace unless it has its own."""
    last = {name: given(context, name) == "true" for name in ("use_sim_time", "autostart")}
    return LifecycleNode(
        package="fopid_ros", executable=executable, name=executable,
        namespace=given(context, "namespace") if namespace is None else namespace,
        parameters=[*parameters, last], remappings=list(remappings), output="screen",
        ros_arguments=["--log-level", given(context, "log_level")],
    )  # fmt: skip


def alone(context: Any) -> None:
    """Raise InputError if a loop runs on the same topics already."""
    namespace = given(context, "namespace").strip("/")
    refuse_running_loop(["-r", f"__ns:=/{namespace}"] if namespace else [])


def launch_description(start: Callable[[Any], list[Any]], *arguments: Any) -> Any:
    """Start what ``start`` makes of the arguments; a node that fails ends all."""
    return LaunchDescription([*arguments, fail_with_any_node(), checked(start)])


def checked(start: Callable[[Any], list[Any]]) -> Any:
    """Start what ``start`` returns; its InputError ends the launch with one line and exit code 1."""

    def begin(context: Any) -> list[Any]:
        try:
            return start(context)
        except InputError as error:
            raise LaunchFailedError(str(error)) from None

    return OpaqueFunction(function=begin)


def fail_with_any_node() -> Any:
    """A process that ends with an error ends the launch, which then ends with exit code 1."""

    def ended(event: Any, context: Any) -> None:
        if event.returncode and not context.is_shutdown:
            code = event.returncode
            how = f"exit code {code}: its message stands above" if code > 0 else f"signal {-code}"
            raise LaunchFailedError(f"{event.process_name} ended with {how}")

    return RegisterEventHandler(OnProcessExit(on_exit=ended))
