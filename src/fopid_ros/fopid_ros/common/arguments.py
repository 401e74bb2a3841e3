"""What a command was given beside what ROS reads."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from collections.abc import Sequence

from rclpy._rclpy_pybind11 import UnknownROSArgsError
from rclpy.utilities import remove_ros_args

from fopid_core.errors import InputError


def other_than_ros(args: Sequence[str]) -> list[str]:
    """The arguments that are not for ROS.

    Raises
    ------
    InputError
        If one stands behind ``--ros-args`` that ROS does not know, as without ``-p``.

    Examples
    --------
    >>> other_than_ros(["left", "--ros-args", "-p", "kp:=2.0"])
    ['left']
    >>> other_than_ros(["--ros-args", "kp:=2.0"])
    Traceback (most recent call last):
    ...
    fopid_core.errors.InputError: arguments ['kp:=2.0'] behind --ros-args; allowed: -p NAME:=VALUE, -r FROM:=TO
    """
    try:
        return list(remove_ros_args(["command", *args])[1:])
    except UnknownROSArgsError as error:
        raise InputError(f"arguments {error} behind --ros-args; allowed: -p NAME:=VALUE, -r FROM:=TO") from None


def parse(parser: ArgumentParser, args: Sequence[str]) -> Namespace:
    """What is not for ROS, as a command reads it; what it does not know ends it with its usage and status 2."""
    try:
        return parser.parse_args(other_than_ros(args))
    except InputError as error:
        parser.error(str(error))


def refuse_other_arguments(args: Sequence[str], own: Sequence[str] = ()) -> None:
    """Raise InputError for an argument that ROS would leave to the node, and that the node does not have (``own``).

    Nor may one hold bytes that are no text in the process's locale.

    Examples
    --------
    >>> refuse_other_arguments(["--kp", "2"])
    Traceback (most recent call last):
    ...
    fopid_core.errors.InputError: argument '--kp'; allowed: --help, and parameters as in --ros-args -p kp:=VALUE
    """
    for given in args:
        try:
            given.encode()
        except UnicodeEncodeError:
            raise InputError(
                f"argument {given!r}; allowed: a text that the locale knows, as LC_ALL=C.UTF-8 does"
            ) from None
    for other in other_than_ros(args):
        if other in own:
            continue
        name = other.lstrip("-").partition("=")[0] if other.startswith("-") else "NAME"
        raise InputError(f"argument {other!r}; allowed: --help, and parameters as in --ros-args -p {name}:=VALUE")
