"""Which gains a controller node begins with, and which of its gains are kept."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from fopid_core.errors import InputError
from fopid_ros.common.design_parameters import DESIGN, PROVENANCE
from fopid_ros.common.managed_node import ManagedNode
from fopid_ros.controller.retained import BASIS, Retained, Retainer, with_provenance

NEEDED = (*DESIGN, *BASIS, *PROVENANCE, "directory", "retain", "trial_timeout")
"""The parameters of a controller that its memory reads."""


class GainMemory:
    """The newest gains of a controller that are not on trial, in a file if its parameter ``retain`` says so.

    Parameters
    ----------
    node : ManagedNode
        With the parameters of a controller.
    joint : str, optional
        Whose gains they are, where the node has many joints.
    called : callable, optional
        What the node calls a parameter of this controller.

    Raises
    ------
    InputError
        If there is no place for the file.
    """

    def __init__(self, node: ManagedNode, joint: str = "", called: Callable[[str], str] = str) -> None:
        self._node = node
        self._names = {name: called(name) for name in NEEDED}
        self._name = "/".join(filter(None, (node.get_fully_qualified_name(), joint)))
        self._what = f"gains of {joint}" if joint else "gains"
        values = self._own(node.values())
        known = Retained.of(self._name, values)
        # Gains that begin on trial have no others to go back to.
        self._known = replace(known, status="set") if known.status == "trial" else known
        self._retainer = Retainer(Path(values["directory"]), self._name) if values["retain"] else None
        self._trial_told_at = time.monotonic()
        self.abandoned_trials = 0

    def recalled(self, check: Callable[[dict[str, Any]], None]) -> dict[str, Any]:
        """The parameters to begin with in place of those given, if any; it is logged which gains it is, and why.

        Parameters
        ----------
        check : callable
            Raises InputError for a set of parameters that the node cannot run with.
        """
        if self._retainer is None:
            return {}
        given, what = self._known, self._what
        try:
            kept = self._retainer.read()
            if kept is None:
                self._node.get_logger().info(f"{what} {given.text}: of the parameters, since none have been kept yet")
                return {}
            if kept.basis != given.basis:
                raise InputError(f"they are for {_listed(kept.basis)}; now it is {_listed(given.basis)}")
            kept = kept.no_faster_than(given)
            check({**self._node.values(), **self._called(kept.parameters)})
        except InputError as error:
            self._node.get_logger().error(
                f"{what} {given.text}: of the parameters, since the kept ones cannot be used: {error}"
            )
            return {}
        self._known = kept
        self._node.get_logger().info(
            f"{what} {kept}: the kept ones; those of the parameters, {given.text}, are not used"
        )
        return self._called(kept.parameters)

    def with_provenance(self, changes: Mapping[str, Any]) -> dict[str, Any]:
        """Changes of parameters, and where the gains in them come from."""
        whole = with_provenance(self._own(changes), self._own(self._node.values()), self._known)
        return {**changes, **self._called(whole)}

    def take(self, values: Mapping[str, Any]) -> None:
        """Keep what has changed; gains on trial are not known to hold the loop."""
        values = self._own(values)
        now = Retained.of(self._name, values)
        same = (now.parameters, now.basis) == (self._known.parameters, self._known.basis)
        if same or values["gains.status"] == "trial":
            return
        self._known = now
        if self._retainer is not None:
            self._retainer.keep(now)

    def hear_of_trial(self, changes: Mapping[str, Any]) -> None:
        """Whoever puts gains on trial, or says again that they are, is alive."""
        if self._own(changes).get("gains.status") == "trial":
            self._trial_told_at = time.monotonic()

    def before_abandoned_trial(self, values: Mapping[str, Any]) -> dict[str, Any]:
        """The parameters to go back to, where gains are on trial whose author has fallen silent; else none."""
        values = self._own(values)
        silence, longest = time.monotonic() - self._trial_told_at, values["trial_timeout"]
        if values["gains.status"] != "trial" or not longest or silence <= longest:
            return {}
        self.abandoned_trials += 1
        self._node.get_logger().error(
            f"{self._what} on trial, and nothing heard of {values['gains.origin'] or 'their author'!r} "
            f"for {silence:.3g} s; trial_timeout = {longest:g}: back to {self._known}"
        )
        return self._called(self._known.parameters)

    def lasting(self, values: Mapping[str, Any]) -> dict[str, Any]:
        """The parameters in place of those of gains on trial, for a file; else none."""
        on_trial = self._own(values)["gains.status"] == "trial"
        return self._called(self._known.parameters) if on_trial else {}

    @property
    def trouble(self) -> str:
        """Why the newest gains are not kept, or not yet; empty when they are, or need not be."""
        trouble = "" if self._retainer is None else self._retainer.trouble
        return f"{self._what} not kept: {trouble}" if trouble else ""

    def facts(self, values: Mapping[str, Any]) -> dict[str, object]:
        """What the diagnostics tell."""
        kept = "not asked for" if self._retainer is None else self._retainer.trouble or "yes"
        known = "on trial" if self._own(values)["gains.status"] == "trial" else str(self._known)
        what = self._what
        return {what: known, f"{what} kept": kept, f"abandoned trials of {what}": self.abandoned_trials}

    def _own(self, values: Mapping[str, Any]) -> dict[str, Any]:
        """These parameters of the node by the names they have in a node of one loop."""
        return {name: values[called] for name, called in self._names.items() if called in values}

    def _called(self, values: Mapping[str, Any]) -> dict[str, Any]:
        """As the node calls these parameters."""
        return {self._names[name]: value for name, value in values.items()}


def _listed(numbers: Mapping[str, float]) -> str:
    return ", ".join(f"{name} = {value:g}" for name, value in numbers.items())
