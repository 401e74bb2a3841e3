"""A controller node whose gains follow a measured variable, as a table in a file says."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from fopid_core.errors import InputError
from fopid_core.model.fopid import Fopid
from fopid_core.runtime.controller import FopidController
from fopid_core.runtime.schedule import read_schedule
from fopid_core.runtime.scheduler import GainScheduler
from fopid_core.runtime.settings import ControllerSettings
from fopid_ros.common.design_parameters import GAINS
from fopid_ros.common.inputs import Input
from fopid_ros.common.parameters import Spec
from fopid_ros.controller.inputs import LoopInputs

_TOPIC = "scheduling_variable"

SCHEDULE_SPECS = (
    Spec("schedule_file", "", "table of gains over a measured variable (fopid schedule checks it); empty: the gains "
         "are parameters", read_only=True),
    Spec("schedule_by", _TOPIC, "what the table goes by: the topic scheduling_variable, or a signal of the loop",
         choices=(_TOPIC, "measurement", "setpoint"), read_only=True),
)  # fmt: skip


def listens(values: Mapping[str, Any]) -> bool:
    """Whether the node has to listen to the topic ``scheduling_variable``."""
    return bool(values["schedule_file"]) and values["schedule_by"] == _TOPIC


def listened_signals(values: Mapping[str, Any]) -> tuple[str, ...]:
    """The topics that the node of one loop hears.

    Examples
    --------
    >>> listened_signals({"tracking.enabled": True, "schedule_file": "", "schedule_by": "measurement"})[3:]
    ('manual_control', 'tracking')
    """
    added = {"tracking": values["tracking.enabled"], "scheduling_variable": listens(values)}
    always = ("setpoint", "measurement", "feedforward", "manual_control")
    return (*always, *(name for name, heard in added.items() if heard))


def check_scheduled_gains(before: Mapping[str, Any], after: Mapping[str, Any]) -> None:
    """Raise InputError for gains that are set while a table says what they are."""
    for name in GAINS if after["schedule_file"] else ():
        if after[name] != before[name]:
            raise InputError(f"{name} = {after[name]}; allowed: as it is, since the gains are those of schedule_file")


class Scheduling:
    """The gains of a node's controller: those of a table, or the parameters where there is none.

    Parameters
    ----------
    values : mapping
        The node's parameters.
    controller : FopidController
    inputs : LoopInputs

    Raises
    ------
    InputError
        If the table cannot be read.
    """

    def __init__(self, values: Mapping[str, Any], controller: FopidController, inputs: LoopInputs) -> None:
        self._controller, self._scheduler = controller, None
        self._by: Input = inputs.named(values["schedule_by"])
        if values["schedule_file"]:
            schedule, _ = read_schedule(Path(values["schedule_file"]).expanduser())
            self._name = schedule.variable or values["schedule_by"]
            self._scheduler = GainScheduler(schedule, controller)

    def reconfigure(self, settings: ControllerSettings) -> None:
        """Put settings in force; with a table, all but their gains."""
        if self._scheduler is None:
            self._controller.reconfigure(settings)
        else:
            self._scheduler.configure(settings)

    def follow(self, now_ns: int) -> None:
        """Before each tick: the gains where the variable is, or as they were while it is not known."""
        if self._scheduler is not None:
            self._scheduler.follow(self._by.value if self._by.usable(now_ns) else None)

    @property
    def gains(self) -> Fopid:
        """The gains in force."""
        return self._controller.settings.gains if self._scheduler is None else self._scheduler.gains

    def facts(self) -> dict[str, object]:
        """What the diagnostics tell of it."""
        if self._scheduler is None:
            return {}
        return {f"schedule at, of {self._name}": self._scheduler.value, "scheduled gains": str(self._scheduler.gains)}
