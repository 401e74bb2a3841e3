"""Many single loops in one process: ``fopid_loops NAMESPACE ...``, a controller in each namespace."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from functools import partial

from fopid_core.errors import InputError
from fopid_ros.common.arguments import other_than_ros
from fopid_ros.common.managed_node import ManagedNode, run_all
from fopid_ros.controller.node import ControllerNode

USAGE = """usage: fopid_loops NAMESPACE ... [--ros-args --params-file FILE -p NAME:=VALUE ...]

Run a fopid_controller in each namespace, all in one process and on one executor: 20 loops need one interpreter and one
participant of the network in place of 20. In a parameter file /NAMESPACE/fopid_controller is one of them and
/**/fopid_controller all; each is a node by itself, as `fopid_controller --help` tells."""


def main(args: Sequence[str] | None = None) -> int:
    """Entry point of the executable ``fopid_loops``."""
    given = list(sys.argv[1:] if args is None else args)
    try:
        namespaces = other_than_ros(given)
    except InputError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    if {"-h", "--help"} & set(namespaces):
        print(USAGE)
        return 0
    unknown = [name for name in namespaces if name.startswith("-")]
    if unknown:
        allowed = "--help, namespaces, and parameters as in --ros-args -p kp:=VALUE"
        print(f"error: argument {unknown[0]!r}; allowed: {allowed}", file=sys.stderr)
        return 2
    doubled = [name for k, name in enumerate(namespaces) if name.strip("/") in _plain(namespaces[:k])]
    if not namespaces or doubled or not all(_plain(namespaces)):
        told = f"namespace {doubled[0]!r} is given twice" if doubled else f"namespaces = {namespaces}"
        print(f"error: {told}; allowed: one and more, each once, as in fopid_loops left right", file=sys.stderr)
        return 2
    makers: list[Callable[[], ManagedNode]] = [partial(ControllerNode, namespace=name) for name in namespaces]
    return run_all(makers, given, namespaces)


def _plain(namespaces: Sequence[str]) -> list[str]:
    return [name.strip("/") for name in namespaces]


if __name__ == "__main__":
    sys.exit(main())
