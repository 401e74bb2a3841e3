"""A learnt process: its numbers, how well they are known, and where a controller would work."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from fopid_core.design.defaults import PHASE_MARGIN, gain_sign, natural_crossover
from fopid_core.design.identification.fit import Fit
from fopid_core.design.identification.flaws import Flaws
from fopid_core.design.identification.quality import (
    Whiteness,
    covariance,
    parameter_covariance,
    relative_deviation,
    whiteness,
)
from fopid_core.design.identification.response import InitialCondition
from fopid_core.design.identification.sampling import sampled_processes
from fopid_core.design.identification.structure import Structure
from fopid_core.model.arrays import Floats
from fopid_core.model.process import Process

MOST_DEVIATION = 0.25
"""Largest standard deviation of the model at its natural crossover, as a share of its size."""
SHORTEST = 3.0
"""A record must last at least this over the natural crossover [rad]."""
FASTEST = 0.5
"""A controller is not taken to work faster than this over the sample time [rad]."""
SLOWER = 0.7
"""Where the process is not known well enough, a controller that is so many times as fast is looked at."""


@dataclass(frozen=True)
class IdentifiedModel:
    """A learnt process.

    Attributes
    ----------
    template : str
    process : Process
    parameters, deviations : mapping
        By name, and their standard deviations.
    parameter_covariance : ndarray, shape (k, k)
        Of them, in their order.
    fit_pct : float
        On held-back samples, with the model fitted to the others: 100 (1 - |y - model| / |y - mean y|) [%]; beside
        loads that wander of what the setpoint, or an experiment, has moved.
    whiteness : Whiteness
        Of the residual.
    noise : float
        Standard deviation of the residual, in units of the measurement; beside loads that wander of the surprises.
    crossover, deviation : float
        About where a controller would work [rad/s], and the standard deviation of the process there, as a share of
        its size.
    flaws : Flaws
        Of the actuator before the process: a dead band that the record speaks for.
    offset : float
        How long after the record the stretch began that it was learnt from [s].
    wanders : bool
        Whether loads moved the measurement without end beside it.
    """

    template: str
    process: Process
    parameters: Mapping[str, float]
    deviations: Mapping[str, float]
    parameter_covariance: Floats = field(repr=False, compare=False)
    fit_pct: float
    whiteness: Whiteness
    noise: float
    crossover: float
    deviation: float
    _fit: Fit = field(repr=False, compare=False)
    _white: Fit = field(repr=False, compare=False)
    _covariance: Floats = field(repr=False, compare=False)
    _drawn: dict[tuple[int, int], tuple[Process, ...]] = field(
        default_factory=dict, init=False, repr=False, compare=False
    )
    flaws: Flaws = field(default_factory=Flaws, kw_only=True)
    offset: float = field(default=0.0, kw_only=True)
    wanders: bool = field(default=False, kw_only=True)

    @property
    def structure(self) -> Structure:
        """What was fitted."""
        return self._fit.structure

    @property
    def start(self) -> InitialCondition:
        """What was taken for unknown about the beginning."""
        return self._fit.response.start

    @property
    def ramp(self) -> float:
        """How fast the operating point moved in the record [1/s]; 0 where nothing spoke for that."""
        return self._fit.ramp

    @property
    def loads(self) -> tuple[float, ...]:
        """When steps of a load came [s after the record's first instant], where something spoke for that."""
        return tuple(self.offset + instant for instant in self._fit.response.start.loads)

    @property
    def in_coloured_noise(self) -> bool:
        """Whether the noise has memory, and was made white for the fit."""
        return self._white is not self._fit

    @property
    def fitted(self) -> Fit:
        """The fit itself."""
        return self._fit

    @property
    def white(self) -> Fit:
        """The same numbers where the residual was made white: the fit itself in white noise."""
        return self._white

    @property
    def numbers(self) -> Floats:
        """The structure's free numbers."""
        return self._fit.x

    @property
    def gains(self) -> Floats:
        """The structure's linear numbers."""
        return self._fit.gains

    @property
    def first_deviation(self) -> float:
        """Standard deviation of the first free number: of one that runs away, that of its time, as a share of it."""
        return math.sqrt(float(self._covariance[0, 0]))

    @property
    def simulated(self) -> tuple[Floats, Floats, Floats]:
        """Instants [s], the measurement there, and what the model makes of the control; of long records averages."""
        measured = self._fit.response.measurement  # of one that runs away the prediction, a sample ahead
        return self.offset + self._fit.response.time, measured, measured - self._fit.residual

    @property
    def slopes(self) -> Floats:
        """Derivatives of what the model makes of the control with respect to its numbers, at ``simulated``, (n, k)."""
        return self._fit.sensitivity

    def moved(self, moves: Floats) -> Process:
        """The process with its numbers moved by these, in the order of ``slopes``, as far as their ranges allow."""
        found, count = self._fit, self._fit.x.size
        low, high = found.structure.bounds(found.response.sample_time, float(found.response.time[-1]))
        gains = found.gains + moves[count : count + found.gains.size]
        return found.structure.process(np.clip(found.x + moves[:count], low, high), gains)

    def sample(self, count: int, seed: int = 0) -> tuple[Process, ...]:
        """Processes that the record cannot tell from this one: drawn from the covariance, and held to the record."""
        if (count, seed) not in self._drawn:  # every design that is verified asks for the same
            self._drawn[count, seed] = sampled_processes(self._white, self._covariance, count, seed)
        return self._drawn[count, seed]


def judged(found: Fit, white: Fit, explained: float, span: float, caution: float = 1.0) -> IdentifiedModel:
    """What a fit says.

    Parameters
    ----------
    found : Fit
    white : Fit
        The same numbers where the residual is white, which gives the covariance: the fit itself in white noise.
    explained : float
        On held-back samples [%].
    span : float
        Of the record [s].
    caution : float
        By which standard deviations are multiplied.
    """
    spread = caution**2 * covariance(white)
    crossover, deviation = _crossover(found, spread, span)
    parameters, named = found.structure.parameters(found.x, found.gains), parameter_covariance(found, spread)
    return IdentifiedModel(
        template=found.structure.name,
        process=found.process,
        parameters=parameters,
        deviations=dict(zip(parameters, np.sqrt(np.maximum(np.diag(named), 0.0)).tolist(), strict=True)),
        parameter_covariance=named,
        fit_pct=explained,
        whiteness=whiteness(white.residual[white.rows]),
        noise=found.error / found.response.level(found.x),
        crossover=crossover,
        deviation=deviation,
        _fit=found,
        _white=white,
        _covariance=spread,
    )


def _crossover(found: Fit, spread: Floats, span: float) -> tuple[float, float]:
    """Where a controller would work [rad/s], and the relative deviation there.

    The natural crossover, or what is slower and known well enough, if the record is long enough to show it.
    """
    limit = FASTEST / found.response.sample_time
    fastest = min(natural_crossover(found.process, PHASE_MARGIN), limit)
    if fastest * span < SHORTEST and _hardly_lags(found.process, fastest, limit):
        fastest = limit  # an integrator in all but name: its own corner is nowhere in the record
    steps = max(math.log(fastest * span / SHORTEST) / -math.log(SLOWER), 11.0)
    tried = fastest * SLOWER ** np.arange(int(steps) + 1)
    tried = tried[(tried * span >= SHORTEST) | (tried == fastest)]
    deviation = [relative_deviation(found, spread, w) for w in tried.tolist()]
    known = [i for i, value in enumerate(deviation) if value <= MOST_DEVIATION]
    chosen = known[0] if known else 0
    return float(tried[chosen]), deviation[chosen]


def _hardly_lags(process: Process, low: float, high: float) -> bool:
    """Whether its phase leaves the usual margin at every frequency between these [rad/s]: it sets no speed."""
    angle = np.angle(gain_sign(process) * process(1j * np.geomspace(low, max(high, low), 200)))
    return bool(np.all((angle > PHASE_MARGIN - math.pi) & (angle < 0.0)))
