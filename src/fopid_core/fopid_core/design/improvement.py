"""New gains for a running loop: the best of several methods on the learnt process, or none where none beats the old."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from fopid_core.design.identification.identify import IdentificationResult
from fopid_core.design.robust_verification import RobustLimits, RobustTuning, as_held, tune_robustly
from fopid_core.design.sampled_loop import sampled_controller, sampled_process
from fopid_core.design.specification import Clock, TuningRequest
from fopid_core.design.time.proposal import settling_horizon
from fopid_core.errors import InputError
from fopid_core.model.evaluation import default_horizon
from fopid_core.model.fopid import Fopid
from fopid_core.model.indices import indices
from fopid_core.model.loop import Loop
from fopid_core.model.margins import margins
from fopid_core.model.process import Process
from fopid_core.model.response import step_response
from fopid_core.model.stability import stability
from fopid_core.runtime.controller import FopidController
from fopid_core.runtime.settings import ControllerSettings

WORSE, BETTER = 1.05, 0.95
"""By which factor an index may grow, and to which both together must fall, so that new gains beat the old ones."""
LOAD_WEIGHT = 2.0 / 3.0
"""Of the load in what is best; the rest is the setpoint's."""
MS_MAX = 1.8
"""Of the designs in time that are tried."""
CLEAR = 0.99
"""Share of a bound on the noise gain that is aimed at where a design broke it."""
SLOWER = (0.5, 0.25)
"""Shares of a crossover that are tried where noise moves the control too much."""
RULES = ("amigo-pid", "amigo-pi", "simc-pi")
_POINTS, _DECADES, _LEAST = 600, (-7.0, 7.0), 1e-9


@dataclass(frozen=True)
class LoopWorth:
    """What gains are worth on a process.

    Attributes
    ----------
    setpoint, load : float
        Integral of the absolute error after a unit step of each, over the same horizon; infinite for an unstable loop.
    ms : float
        max |S|.
    noise_gain : float
        Standard deviation of the control over that of white noise of the measurement, at the ticks.
    """

    setpoint: float
    load: float
    ms: float
    noise_gain: float

    def __str__(self) -> str:
        return (
            f"IAE {self.setpoint:.4g} to a setpoint step and {self.load:.4g} to a load step, Ms {self.ms:.3g}, "
            f"noise gain {self.noise_gain:.3g}"
        )


def loop_worth(process: Process, gains: Fopid, sample_time: float, horizon: float) -> LoopWorth:
    """Judge gains on a process.

    Examples
    --------
    >>> judged = loop_worth(Process.parse("1/(s+1)"), Fopid(kp=1.0, ki=1.0), 0.01, 50.0)
    >>> round(judged.setpoint, 3), round(judged.load, 3)  # 1/(s+1) and s/(s+1)^2
    (1.0, 1.0)
    """
    loop = Loop(process, gains)
    if not stability(loop).stable:
        return LoopWorth(math.inf, math.inf, math.inf, math.inf)
    errors = []
    for source in ("setpoint", "load"):
        try:
            response = step_response(loop, horizon, source)
            errors.append(indices(response.time, response.error).iae)
        except InputError:  # near the border of stability the response is not known
            errors.append(math.inf)
    return LoopWorth(errors[0], errors[1], margins(loop).ms, noise_gain(process, gains, sample_time))


def noise_gain(process: Process, gains: Fopid, sample_time: float) -> float:
    """Root mean square of |C S| of the sampled loop over all frequencies up to the Nyquist frequency.

    Examples
    --------
    >>> round(noise_gain(Process.parse("0.001/(s+1)"), Fopid(kp=2.0), 0.01), 3)
    2.0
    """
    theta = np.union1d(np.geomspace(1e-6, math.pi, _POINTS), np.linspace(0.0, math.pi, _POINTS + 1)[1:])
    controller = sampled_controller(FopidController(ControllerSettings(gains, sample_time)), theta)
    gain = np.abs(controller / (1.0 + controller * sampled_process(process, sample_time, theta))) ** 2
    area = float(np.sum(0.5 * (gain[1:] + gain[:-1]) * np.diff(theta)))
    return math.sqrt(area / math.pi)


@dataclass(frozen=True)
class RunningGains:
    """What runs, and what the loop's control may do.

    Attributes
    ----------
    gains : Fopid
    noise : float
        Standard deviation of the measurement's noise; 0 where it is not known.
    control_movement : float
        Standard deviation of the control, from that noise, that new gains may cause; what the running ones cause is
        allowed in any case.
    """

    gains: Fopid
    noise: float = 0.0
    control_movement: float = math.inf


@dataclass(frozen=True)
class Improvement:
    """The outcome of a search for better gains.

    Attributes
    ----------
    success : bool
        Gains were found that beat the running ones on the learnt process.
    message : str
    tuned : RobustTuning
        The best, or what came nearest.
    """

    success: bool
    message: str
    tuned: RobustTuning


def improve(
    identified: IdentificationResult,
    request: TuningRequest,
    limits: RobustLimits,
    running: RunningGains,
    compare: bool = True,
    refuse: Callable[[RobustTuning], str] = lambda _: "",
    clock: Clock = time.perf_counter,
) -> Improvement:
    """The best design on a learnt process, if it beats the gains that run.

    Parameters
    ----------
    identified : IdentificationResult
    request : TuningRequest
        The method asked for, and the sample time.
    limits : RobustLimits
        On every process that the record leaves possible. Running gains beyond its Ms are beaten by any design within.
    running : RunningGains
    compare : bool
        Whether other methods are tried as well.
    refuse : callable
        Why a design may not be used, or nothing.
    clock : callable
        Gives the time [s].
    """
    if not identified.success or identified.best is None:
        return Improvement(False, identified.message, tune_robustly(identified, request, limits, clock))
    judge = _Judge(identified.best.process, request.sample_time, running, limits.ms_max)
    best: tuple[float, RobustTuning, str] | None = None
    refused: list[tuple[RobustTuning, str]] = []
    for wanted in _requests(request, judge, compare):
        tuned = _tuned(identified, wanted, limits, clock)
        reason = "" if tuned is None or tuned.success else tuned.message
        if tuned is None:
            continue
        reason = reason or refuse(tuned) or judge.reason(tuned)
        if reason:
            refused.append((tuned, reason))
            continue
        score = judge.score(tuned)
        if best is None or score < best[0]:
            best = (score, tuned, wanted.rule or wanted.method)
    if best is None:
        tuned, reason = refused[0]
        return Improvement(False, f"{reason}; none of {len(refused)} designs is better than what runs", tuned)
    _, tuned, name = best
    return Improvement(True, f"{tuned.message}; {judge.told(tuned, name)}", tuned)


def _tuned(
    identified: IdentificationResult, request: TuningRequest, limits: RobustLimits, clock: Clock
) -> RobustTuning | None:
    """A design, or None where the method is not for this process."""
    try:
        return tune_robustly(identified, request, limits, clock)
    except InputError:
        if request.rule is None:
            raise
        return None


def _requests(request: TuningRequest, judge: _Judge, compare: bool) -> Iterator[TuningRequest]:
    """What is tried in turn; more where noise moves the control too much."""
    yield request
    if request.method == "frequency" and judge.crossover and judge.noise_excess > 1.0:
        for share in SLOWER:
            yield replace(request, crossover=share * judge.crossover)
    if not compare:
        return
    for fixed in ({}, {"lam": 1.0, "mu": 1.0}, {"lam": 1.0, "kd": 0.0, "mu": 1.0}):
        in_time = replace(
            _with_noise_bound(request, judge), method="time", index="iae", ms_max=request.ms_max or MS_MAX,
            fixed=fixed, phase_margin=None, crossover=None, t_max=None, s_max=None, rule=None,
        )  # fmt: skip
        judge.noise_excess = 0.0
        yield in_time
        if in_time.noise_rms_max and judge.noise_excess > 1.0:  # by as much less as sampling and filters add to it
            yield replace(in_time, noise_rms_max=CLEAR * in_time.noise_rms_max / judge.noise_excess)
    for rule in RULES:
        yield replace(request, method="rule", rule=rule)


def _with_noise_bound(request: TuningRequest, judge: _Judge) -> TuningRequest:
    """The request with the judge's bound on the noise gain: for white noise whose variance at the ticks is 1."""
    most = judge.noise_gain_max
    if math.isinf(most):
        return request
    horizon = request.horizon or _horizon(as_held(judge.process, request.sample_time), most)
    return replace(request, noise_density=request.sample_time, noise_rms_max=most, horizon=horizon)


def _horizon(process: Process, noise_gain_max: float) -> float:
    """The time [s] in which a loop settles whose controller has no more gain than a bound on the noise gain lets it.

    Its crossover is that of the bound itself, and where that does not reach 1, the process's own corner.
    """
    w = np.logspace(*_DECADES, _POINTS)
    gain = np.abs(process(1j * w))
    falls = (noise_gain_max * gain < 1.0) & (gain < abs(process.steady_state_gain) / math.sqrt(2.0))
    return settling_horizon(process, float(w[np.argmax(falls)]) if falls.any() else math.inf)


class _Judge:
    """Judges designs beside the gains that run."""

    def __init__(self, process: Process, sample_time: float, running: RunningGains, ms_max: float) -> None:
        self.process, self._sample_time, self._running, self._ms_max = process, sample_time, running, ms_max
        self._judged: dict[Fopid, LoopWorth] = {}
        self.crossover, self.noise_excess = 0.0, 0.0
        loop = Loop(process, running.gains)
        self._horizon = default_horizon(loop) if stability(loop).stable else None
        old = noise_gain(process, running.gains, sample_time) if self._horizon else 0.0
        allowed = running.control_movement / running.noise if running.noise > 0.0 else math.inf
        self.noise_gain_max = max(allowed, old, _LEAST)

    def worth(self, gains: Fopid) -> LoopWorth:
        if gains not in self._judged:
            horizon = self._horizon or default_horizon(Loop(self.process, gains))
            self._judged[gains] = loop_worth(self.process, gains, self._sample_time, horizon)
        return self._judged[gains]

    def reason(self, tuned: RobustTuning) -> str:
        """Why a design is not better than what runs; empty when it is."""
        new, old = self._pair(tuned)
        self.crossover = tuned.tuning.achieved.crossover if tuned.tuning and tuned.tuning.achieved else 0.0
        self.noise_excess = new.noise_gain / self.noise_gain_max
        if self.noise_excess > 1.0:
            moves = new.noise_gain * self._running.noise
            most = self.noise_gain_max * self._running.noise
            return f"the measurement's noise would move the control by {moves:.3g} ({most:.3g} is allowed)"
        if math.isinf(old.setpoint):
            return "" if math.isfinite(new.setpoint) else "its responses are not known"
        if old.ms > self._ms_max:  # what runs is not to be kept, however fast it is
            return ""
        if new.setpoint > WORSE * old.setpoint or new.load > WORSE * old.load or self.score(tuned) > BETTER:
            return f"not better than what runs on the learnt process: {new}; now {old}"
        return ""

    def score(self, tuned: RobustTuning) -> float:
        """Both indices beside those of the running gains; below 1 is better."""
        new, old = self._pair(tuned)
        if math.isinf(old.setpoint):
            return new.load
        return float((new.load / old.load) ** LOAD_WEIGHT * (new.setpoint / old.setpoint) ** (1.0 - LOAD_WEIGHT))

    def told(self, tuned: RobustTuning, name: str) -> str:
        new, old = self._pair(tuned)
        return f"{name} was best: {new}; before {old}"

    def _pair(self, tuned: RobustTuning) -> tuple[LoopWorth, LoopWorth]:
        if tuned.tuning is None or tuned.tuning.controller is None:
            raise InputError("a tuning without gains; allowed: one that succeeded")
        return self.worth(tuned.tuning.controller), self.worth(self._running.gains)
