"""An experiment: a process, a controller, and phases in which something changes; read from YAML."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from fopid_core.errors import InputError
from fopid_core.model.arrays import Floats
from fopid_core.model.process import Process, read_process
from fopid_core.study.experiments import profiles
from fopid_core.study.experiments.loop_parameters import (
    GAIN_KEYS,
    PLANT_KEYS,
    SETTING_KEYS,
    controller_settings,
    plant_settings,
)
from fopid_core.study.experiments.profiles import Written
from fopid_core.study.experiments.tune_call import TuneCall
from fopid_core.study.experiments.yaml_schema import Keys, Place, SchemaError, bind, check_name, read_yaml, yaml_text

TRIGGERS = ("lockstep", "realtime")
MODES = ("auto", "manual")
SOURCES = ("setpoint", "disturbance")
RECORDED = (*SOURCES, "measurement", "control", "state", "tunings", "phases", "parameters", "diagnostics")
"""What can be recorded."""

MAX_SAMPLES = 10_000_000


@dataclass(frozen=True)
class Phase:
    """One stretch of the experiment; what it does not mention stays as it is.

    Attributes
    ----------
    name : str
    duration : float
        [s]
    setpoint, disturbance : float or profile, optional
        A number is held. ``{steps: [[t, value], ...]}``, ``{ramp: {to, over}}``, ``{sine: {amplitude, period}}``,
        ``{file: PATH}`` (csv with the columns time and value) and ``{bag: PATH}`` count from the phase's start [s].
    gain_factor : float, optional
        The plant's new gain factor.
    gains : mapping
        Any of kp, ki, kd, lam, mu, new from here on.
    controller : mapping
        Other parameters of the controller that its numbers depend on, new from here on.
    tune : TuneCall, optional
        A tuning, done and applied before the phase starts.
    """

    name: str
    duration: float
    setpoint: Written | None = None
    disturbance: Written | None = None
    gain_factor: float | None = None
    gains: Annotated[Mapping[str, float], Keys(GAIN_KEYS)] = field(default_factory=dict)
    controller: Annotated[Mapping[str, Any], Keys(SETTING_KEYS)] = field(default_factory=dict)
    tune: TuneCall | None = None

    def __post_init__(self) -> None:
        if not 0 < self.duration < math.inf:
            raise InputError(f"duration = {self.duration} of phase {self.name!r}; allowed: above 0 s")
        for name in (*SOURCES, "gain_factor"):
            profiles.check(name, getattr(self, name))

    @property
    def changes(self) -> dict[str, Any]:
        """The controller's parameters that change, gains among them."""
        return {**self.gains, **self.controller}


@dataclass(frozen=True)
class Experiment:
    """What is run.

    Attributes
    ----------
    process : str
        As on the command line.
    phases : tuple of Phase
    name : str
    sample_time : float
        [s]
    trigger : str
        ``lockstep`` or ``realtime``.
    gains : mapping
        kp, ki, kd, lam, mu at the start.
    plant, controller : mapping
        Further parameters of the two nodes: noise and its seed, delay model; limits, anti-windup, weights.
    record : tuple of str
        Of ``RECORDED``; nothing given records all.
    """

    process: str
    phases: tuple[Phase, ...]
    name: str = "experiment"
    sample_time: float = 0.01
    trigger: str = "lockstep"
    gains: Annotated[Mapping[str, float], Keys(GAIN_KEYS)] = field(default_factory=dict)
    plant: Annotated[Mapping[str, Any], Keys(PLANT_KEYS)] = field(default_factory=dict)
    controller: Annotated[Mapping[str, Any], Keys(SETTING_KEYS)] = field(default_factory=dict)
    record: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        check_name(self.name)
        process = read_process(self.process)
        plant_settings(process, self.plant, self.sample_time)
        _check_controller({**self.gains, **self.controller}, self.sample_time)
        if self.trigger not in TRIGGERS:
            raise InputError(f"trigger = {self.trigger!r}; allowed: {', '.join(TRIGGERS)}")
        for topic in self.record:
            if topic not in RECORDED:
                raise InputError(f"record = {topic!r}; allowed: {', '.join(RECORDED)}")
        if not self.phases:
            raise InputError("phases = []; allowed: at least one phase")
        if self.duration / self.sample_time > MAX_SAMPLES:
            raise InputError(f"phases of {self.duration:g} s together; allowed: {MAX_SAMPLES:,} samples at most")
        self._check_phases(process)

    def _check_phases(self, process: Process) -> None:
        parameters = {**self.gains, **self.controller}
        for number, (phase, (first, end)) in enumerate(zip(self.phases, pairwise(self.boundaries), strict=True)):
            place: Place = ("phases", number)
            if first == end:
                reason = f"duration = {phase.duration}; allowed: one sample_time or more, {self.sample_time} s"
                raise SchemaError((*place, "duration"), reason)
            parameters |= phase.changes
            try:
                _check_controller(parameters, self.sample_time)
            except InputError as error:
                raise SchemaError(place, str(error)) from None
            try:
                if phase.tune is not None:
                    phase.tune.request(process, self.sample_time)
            except InputError as error:
                raise SchemaError((*place, "tune"), str(error)) from None

    @property
    def recorded(self) -> tuple[str, ...]:
        """What is recorded."""
        return self.record or RECORDED

    @property
    def duration(self) -> float:
        """Of all phases together [s]."""
        return sum(phase.duration for phase in self.phases)

    @property
    def boundaries(self) -> list[int]:
        """The sample each phase starts with, and last the number of samples."""
        ends = np.cumsum([0.0, *(phase.duration for phase in self.phases)])
        return [round(float(end) / self.sample_time) for end in ends]

    def signal(self, name: str) -> Floats:
        """The setpoint or the disturbance at every sample, 0 until a phase gives it a value.

        Parameters
        ----------
        name : str
            ``setpoint`` or ``disturbance``.

        Returns
        -------
        ndarray, shape (samples,)
        """
        parts, before = [], 0.0
        for phase, (first, end) in zip(self.phases, pairwise(self.boundaries), strict=True):
            profile = profiles.loaded(name, getattr(phase, name), Path())
            parts.append(profiles.values(profile, before, end - first, self.sample_time))
            before = float(parts[-1][-1])
        return np.concatenate(parts)

    def loaded(self, folder: Path) -> Experiment:
        """The same with its files and bags read, their paths relative to ``folder``: it stands for itself."""
        phases = []
        for number, phase in enumerate(self.phases):
            read: dict[str, Any] = {}
            for name in SOURCES:
                try:
                    read[name] = profiles.loaded(name, getattr(phase, name), folder)
                except InputError as error:
                    raise SchemaError(("phases", number, name), str(error)) from None
            phases.append(replace(phase, **read))
        of_a_file = self.process.strip().endswith((".yaml", ".yml"))
        process = str(read_process(self.process)) if of_a_file else self.process
        return replace(self, process=process, phases=tuple(phases))

    def to_yaml(self) -> str:
        """The text ``read_experiment`` reads back."""
        return yaml_text(self)


def _check_controller(parameters: Mapping[str, Any], sample_time: float) -> None:
    controller_settings(parameters, sample_time)
    mode = parameters.get("mode", "auto")
    if mode not in MODES:
        raise InputError(f"mode = {mode!r}; allowed: {', '.join(MODES)}")


def read_experiment(path: Path) -> Experiment:
    """Read an experiment file.

    Raises
    ------
    InputError
        Naming the file, the line and the key that cannot be used.
    """
    return read_yaml(path, Experiment, "experiment", lambda experiment: experiment.loaded(path.parent))


def parse_experiment(content: Any) -> Experiment:
    """An experiment from the plain data of its file."""
    experiment: Experiment = bind(Experiment, content)
    return experiment


def run_folder(name: str) -> Path:
    """A new folder's name for a run that starts now."""
    return Path("runs") / f"{name}-{time.strftime('%Y%m%d-%H%M%S')}"
