"""The nodes of a cascade and how they are wired: position over speed."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Wired:
    """A node of a cascade.

    Attributes
    ----------
    executable : str
    namespace : str
    remappings : tuple of (str, str)
        Topic -> what it is called on the graph.
    """

    executable: str
    namespace: str
    remappings: tuple[tuple[str, str], ...] = ()


def cascade_nodes(namespace: str = "") -> tuple[Wired, ...]:
    """Two plants, one after the other, and their controllers, one above the other.

    Examples
    --------
    >>> for node in cascade_nodes("axis")[2:]:
    ...     print(node.namespace, node.remappings)
    /axis/speed ()
    /axis/position (('control', '/axis/speed/setpoint'), ('tracking', '/axis/speed/back_calculation'))
    """
    above = f"/{namespace.strip('/')}" if namespace.strip("/") else ""
    speed, position = f"{above}/speed", f"{above}/position"
    return (
        Wired("plant_simulator", speed),
        Wired("plant_simulator", position, (("control", f"{speed}/measurement"),)),
        Wired("fopid_controller", speed),
        Wired("fopid_controller", position,
              (("control", f"{speed}/setpoint"), ("tracking", f"{speed}/back_calculation"))),
    )  # fmt: skip
