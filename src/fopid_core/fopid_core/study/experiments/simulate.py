"""An experiment without ROS: in lockstep, number for number what the nodes do."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from fopid_core.design.acceptance import rejection_reason
from fopid_core.design.specification import Achieved, TuningResult
from fopid_core.design.tuner import tune
from fopid_core.errors import InputError
from fopid_core.model.arrays import Floats
from fopid_core.model.fopid import Fopid
from fopid_core.model.process import read_process
from fopid_core.runtime.controller import ControllerSettings, FopidController
from fopid_core.runtime.convolved_plant import AnyPlant, plant_of
from fopid_core.runtime.simulation import Trace, simulate
from fopid_core.study.experiments.experiment import SOURCES, Experiment, Phase
from fopid_core.study.experiments.loop_parameters import GAINS, controller_settings, plant_settings
from fopid_core.study.experiments.profiles import Steps
from fopid_core.study.experiments.tune_call import TuneCall
from fopid_core.study.reports import run
from fopid_core.study.reports.run import Run, Signal

Report = Callable[[str], object]
"""Called with what is being done."""


@dataclass(frozen=True)
class Simulated:
    """An experiment and what came of it.

    Attributes
    ----------
    experiment : Experiment
    trace : Trace
    disturbance : ndarray, shape (n,)
    gains : ndarray, shape (n, 5)
        kp, ki, kd, lam, mu in force at each sample.
    tunings : tuple of run.Tuning
    not_applied : tuple of str
        Why tunings changed nothing, a line each.
    plant_accuracy : float
        Largest error of the plant's response to a step, relative to its size.
    """

    experiment: Experiment
    trace: Trace
    disturbance: Floats
    gains: Floats
    tunings: tuple[run.Tuning, ...]
    not_applied: tuple[str, ...]
    plant_accuracy: float

    def as_run(self, path: Path) -> Run:
        """As if it had been recorded, for tables and reports."""
        trace = self.trace
        signals = {"setpoint": trace.setpoint, "measurement": trace.measurement, "control": trace.control}
        signals["disturbance"] = self.disturbance
        return run_of(self.experiment, path, trace.time, signals, self.gains, self.tunings)


def run_of(
    experiment: Experiment,
    path: Path,
    time: Floats,
    signals: Mapping[str, Floats],
    gains: Floats,
    tunings: tuple[run.Tuning, ...],
) -> Run:
    """A run of an experiment from its signals and gains at each sample, shapes (n,) and (n, 5)."""
    columns = {name: signals[name] for name in ("setpoint", "measurement", "control")}
    starts = zip(experiment.boundaries, experiment.phases, strict=False)
    return Run(
        path=path,
        signals={name: Signal(time, value) for name, value in signals.items()},
        state={"time": time, **columns, **dict(zip(GAINS, gains.T, strict=True))},
        tunings=tunings,
        phases=tuple(run.Phase(first * experiment.sample_time, p.name, "") for first, p in starts),
        metadata={"experiment": experiment.to_yaml(), "process": experiment.process},
    )


def simulate_experiment(experiment: Experiment, report: Report | None = None) -> Simulated:
    """Run an experiment.

    Parameters
    ----------
    experiment : Experiment
        Its trigger does not matter: time passes as in lockstep.
    report : callable, optional

    Returns
    -------
    Simulated

    Examples
    --------
    >>> from fopid_core.study.experiments.experiment import Experiment, Phase
    >>> step = Phase("step", 9.0, setpoint=1.0)
    >>> found = simulate_experiment(Experiment("1/(s+1)", (step,), gains={"kp": 1.0, "ki": 1.0}))
    >>> round(float(found.trace.measurement[-1]), 3)
    1.0
    """
    loop, tell = _Loop(experiment), report or (lambda _: None)
    *starts, samples = experiment.boundaries
    setpoint, disturbance = (experiment.signal(name) for name in SOURCES)
    actions = {
        first: partial(loop.begin, phase, first, tell) for first, phase in zip(starts, experiment.phases, strict=True)
    }
    plant = plant_of(loop.plant)
    trace = simulate(
        loop.controller, plant, samples, setpoint.tolist().__getitem__, disturbance.tolist().__getitem__, actions
    )
    return Simulated(
        experiment, trace, disturbance, loop.gains_at(samples), tuple(loop.tunings), tuple(loop.not_applied),
        plant.accuracy,
    )  # fmt: skip


class _Unattended(FopidController):
    """In manual mode nobody sends it a control: that stays as it is."""

    def step(
        self,
        setpoint: float,
        measurement: float,
        feedforward: float = 0.0,
        manual: float = math.nan,
        tracking: float | None = None,
    ) -> float:
        del manual
        return super().step(setpoint, measurement, feedforward, self.state.control, tracking)


class _Loop:
    """The parameters of the loop's nodes as they change."""

    def __init__(self, experiment: Experiment) -> None:
        self._process, self._sample_time = read_process(experiment.process), experiment.sample_time
        self._parameters: dict[str, Any] = {**experiment.gains, **experiment.controller}
        self.plant = plant_settings(self._process, experiment.plant, experiment.sample_time)
        self.controller = _Unattended(self._settings())
        self.controller.set_mode(self._parameters.get("mode", "auto"))
        self.tunings: list[run.Tuning] = []
        self.not_applied: list[str] = []
        self._gains: list[tuple[int, Fopid]] = [(0, self._settings().gains)]

    def _settings(self) -> ControllerSettings:
        return controller_settings(self._parameters, self._sample_time)

    def begin(self, phase: Phase, first: int, report: Report, controller: FopidController, plant: AnyPlant) -> None:
        """Make a phase's changes, in the order in which the experiment's node makes them."""
        if phase.tune is not None:
            report(f"tuning ({phase.tune.method})")
            self._tune(phase.tune, first, controller)
        report(phase.name)
        if phase.changes:
            self._change(phase.changes, first, controller)
        if phase.gain_factor is not None:
            plant.gain_factor = phase.gain_factor

    def _tune(self, call: TuneCall, first: int, controller: FopidController) -> None:
        """As the tuner's node: what it cannot tune leaves the loop as it is."""
        try:
            result = tune(call.request(self._process, self._sample_time))
        except InputError as error:
            self.not_applied.append(f"tuning by {call.method}: {error}")
            return
        tuning = _tuning(
            first * self._sample_time, str(self._process), result, rejection_reason(result, self._sample_time)
        )
        self.tunings.append(tuning)
        if tuning.applied and result.controller is not None:
            self._change(_parameters_of(result.controller, result), first, controller)
        else:
            self.not_applied.append(f"tuning by {call.method}: {'; '.join([tuning.message, *tuning.unmet])}")

    def _change(self, changes: dict[str, Any], first: int, controller: FopidController) -> None:
        mode = self._parameters.get("mode", "auto")
        self._parameters |= changes
        controller.reconfigure(self._settings())
        if self._parameters.get("mode", "auto") != mode:
            controller.set_mode(self._parameters["mode"])
        self._gains.append((first, controller.settings.gains))

    def gains_at(self, samples: int) -> Floats:
        """The five numbers at every sample, shape (samples, 5)."""
        rows = np.empty((samples, 5))
        for first, gains in self._gains:
            rows[first:] = gains.gains
        return rows


def _parameters_of(gains: Fopid, result: TuningResult) -> dict[str, Any]:
    """The parameters that the tuner's node hands over: gains and filter, and the weights where they were chosen."""
    slow, weights = result.filter, result.weights
    found: dict[str, Any] = dict(zip(GAINS, gains.gains, strict=True))
    found |= {"measurement_filter_order": slow.order, "measurement_filter_time": slow.time}
    if result.method == "time":
        found |= {"setpoint_weight": weights.proportional, "derivative_setpoint_weight": weights.derivative}
    return found


def _tuning(time: float, process: str, result: TuningResult, refused: str) -> run.Tuning:
    return run.Tuning(
        time=time,
        method=result.method,
        process=process,
        success=result.success,
        applied=not refused,
        message="; ".join(text for text in (result.message, refused or "applied") if text),
        gains=result.controller,
        filter=result.filter,
        weights=result.weights,
        achieved=result.achieved or Achieved(**dict.fromkeys((f.name for f in fields(Achieved)), math.nan)),
        stable=result.stable,
        unmet=result.unmet,
        elapsed=result.elapsed,
    )


def replayed(experiment: Experiment, recorded: Run) -> Experiment:
    """The same with setpoint and disturbance as recorded; one that was not recorded stays as the experiment has it.

    Examples
    --------
    >>> from fopid_core.study.experiments.experiment import Experiment, Phase
    >>> recorded = Run(Path("run"), {"setpoint": Signal(np.array([0.0, 1.0]), np.array([2.0, 3.0]))})
    >>> replayed(Experiment("P1", (Phase("a", 2.0),), sample_time=0.5), recorded).signal("setpoint")
    array([2., 2., 3., 3.])
    """
    phases = list(experiment.phases)
    boundaries, h = experiment.boundaries, experiment.sample_time
    for name in (name for name in SOURCES if name in recorded.signals):
        signal = recorded.signals[name]
        samples = np.rint(signal.time / h)
        for i, (first, end) in enumerate(pairwise(boundaries)):
            inside = (samples >= first) & (samples < end)
            times = np.maximum(signal.time[inside] - first * h, 0.0)
            points = tuple(zip(times.tolist(), signal.value[inside].tolist(), strict=True))
            changed: dict[str, Any] = {name: Steps(points) if points else None}
            phases[i] = replace(phases[i], **changed)
    return replace(experiment, phases=tuple(phases))
