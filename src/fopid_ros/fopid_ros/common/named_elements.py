"""Elements of arrays by name: ``position[elbow]`` of a JointState, wherever the joint stands in its ``name``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Named:
    """A step of a path to a number: the element of an array that has this name.

    Attributes
    ----------
    name : str
    """

    name: str


class NamedElement:
    """Finds the elements of an array that have certain names; the order may change from message to message.

    Parameters
    ----------
    wanted : sequence of str
    place : str
        Of the names in their message, for what is told.

    Attributes
    ----------
    lacking : str
        What the names that were looked at last lacked; empty for nothing.

    Examples
    --------
    >>> joints = NamedElement(["elbow", "wrist"], "name")
    >>> joints.find(["wrist", "shoulder", "elbow"]), joints.lacking
    ([2, 0], '')
    >>> joints.find(["elbow", "shoulder"]), joints.lacking
    ([0, None], "no 'wrist' in name; allowed: elbow, shoulder")
    """

    def __init__(self, wanted: Sequence[str], place: str) -> None:
        self._wanted, self._place = tuple(wanted), place
        self._names: list[str] | None = None
        self._found: list[int | None] = []
        self.lacking = ""

    def find(self, names: list[str]) -> list[int | None]:
        """Where the wanted names stand; None for one that is not there, or there more than once."""
        if names == self._names:
            return self._found
        self._names, self.lacking = list(names), ""
        self._found = [self._only(name, names) for name in self._wanted]
        return self._found

    def _only(self, wanted: str, names: list[str]) -> int | None:
        count = names.count(wanted)
        if count == 1:
            return names.index(wanted)
        if not self.lacking:
            there = ", ".join(names) or "none are there"
            self.lacking = f"no {wanted!r} in {self._place}; allowed: {there}"
            if count:
                self.lacking = f"{wanted!r} stands {count} times in {self._place}; allowed: once"
        return None


def names_field(fields: dict[str, str]) -> str | None:
    """Of the fields of a message, the one that names the elements of its arrays: a list of texts called name(s).

    Examples
    --------
    >>> names_field({"header": "std_msgs/Header", "name": "sequence<string>", "position": "sequence<double>"})
    'name'
    """
    lists = [
        name for name, kind in fields.items() if kind.startswith("sequence<string") and name.endswith(("name", "names"))
    ]
    return lists[0] if len(lists) == 1 else None
