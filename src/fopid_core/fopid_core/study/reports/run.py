"""A run of the loop, as it was recorded."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from fopid_core import safe_yaml
from fopid_core.design.specification import Achieved
from fopid_core.errors import InputError
from fopid_core.model.arrays import Floats
from fopid_core.model.fopid import Fopid
from fopid_core.model.loop import Loop
from fopid_core.model.process import Process, read_process
from fopid_core.model.two_degrees import NO_FILTER, WHOLE_SETPOINT, MeasurementFilter, SetpointWeights


@dataclass(frozen=True)
class Signal:
    """A signal; both arrays have shape (n,), ``time`` [s] does not decrease.

    Examples
    --------
    >>> Signal(np.array([0.0, 1.0]), np.array([5.0, 7.0])).held_at(np.array([-1.0, 0.5, 1.0]))
    array([5., 5., 7.])
    """

    time: Floats
    value: Floats

    def held_at(self, time: Floats) -> Floats:
        """The latest value at each instant; before the first message, the first."""
        latest = np.searchsorted(self.time, time, side="right") - 1
        return self.value[np.maximum(latest, 0)]


@dataclass(frozen=True)
class Phase:
    """What the experiment does from ``time`` [s] on."""

    time: float
    name: str
    description: str = ""


@dataclass(frozen=True)
class Tuning:
    """One result of the tuner, at ``time`` [s]; see ``fopid_msgs/TuningResult``.

    ``gains`` is None where it found none.
    """

    time: float
    method: str
    process: str
    success: bool
    applied: bool
    message: str
    gains: Fopid | None
    achieved: Achieved
    stable: bool
    unmet: tuple[str, ...]
    elapsed: float
    filter: MeasurementFilter = NO_FILTER
    weights: SetpointWeights = WHOLE_SETPOINT

    def loop(self, process: Process) -> Loop | None:
        """The loop as it was designed; None where there are no gains."""
        return None if self.gains is None else Loop(process, self.gains, self.filter, self.weights)


@dataclass(frozen=True)
class ParameterChange:
    """A parameter that a node reported as new or changed, at ``time`` [s]."""

    time: float
    node: str
    name: str
    value: Any


@dataclass(frozen=True)
class Run:
    """One loop of a bag.

    Attributes
    ----------
    path : Path
    signals : mapping
        ``setpoint``, ``disturbance``, ``control``, ``measurement`` -> Signal; those that were recorded.
    namespace : str
        Of the loop's topics: ``""`` or ``"/loop1"``.
    start : int
        The instant that counts as 0 s [ns]: 0 for a simulated clock, the first message for a wall clock.
    state : mapping
        Field of ``fopid_msgs/FopidState`` -> array of shape (n,), and ``time`` [s]; empty when it was not recorded.
    tunings, phases, parameters : tuple
        In the order of time.
    metadata : mapping
        The bag's custom data: texts by name.
    whole : bool
        Whether the recording came to an orderly end.
    """

    path: Path
    signals: Mapping[str, Signal]
    namespace: str = ""
    start: int = 0
    state: Mapping[str, Floats] = field(default_factory=dict)
    tunings: tuple[Tuning, ...] = ()
    phases: tuple[Phase, ...] = ()
    parameters: tuple[ParameterChange, ...] = ()
    metadata: Mapping[str, str] = field(default_factory=dict)
    whole: bool = True

    @property
    def end(self) -> float:
        """The last instant of the measurement [s]."""
        return float(self.signals["measurement"].time[-1])

    @cached_property
    def experiment(self) -> Mapping[str, Any]:
        """The experiment's file as plain data; empty when the bag has none that can be read."""
        try:
            content = safe_yaml.load(self.metadata.get("experiment", ""))
        except InputError:
            return {}
        return content if isinstance(content, dict) else {}

    @cached_property
    def process(self) -> Process | None:
        """The process that was controlled, where the bag says which."""
        named = (self.metadata.get("process"), self.experiment.get("process"), *(t.process for t in self.tunings))
        for source in named:
            if isinstance(source, str) and source:
                try:
                    return read_process(source)
                except InputError:
                    continue
        return None

    @cached_property
    def sample_time(self) -> float:
        """The usual distance of two measurements [s]; NaN with fewer than two."""
        time = self.signals["measurement"].time
        return float(np.median(np.diff(time))) if time.size > 1 else float("nan")
