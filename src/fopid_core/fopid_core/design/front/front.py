"""The Pareto front of load performance, robustness and control effort of one structure on one process."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from fopid_core.design.defaults import PHASE_MARGIN, natural_crossover
from fopid_core.design.front.continuation import Continuation
from fopid_core.design.front.measures import Measures, measured
from fopid_core.design.specification import (
    STRUCTURES,
    Clock,
    Progress,
    TuningRequest,
    no_progress,
    one_of,
    require,
)
from fopid_core.design.time.problem import TimeProblem, enough_points
from fopid_core.design.time.proposal import time_specification
from fopid_core.design.time.specification import TimeSpecification
from fopid_core.design.time.tuning import tune_time
from fopid_core.model.arrays import Booleans, Floats, Indexes
from fopid_core.model.fopid import Fopid
from fopid_core.model.loop import Loop
from fopid_core.model.process import Process
from fopid_core.model.two_degrees import MeasurementFilter

MS_RANGE = (1.2, 2.0)
POINTS = 200
MOST_POINTS = 5000
SPARE = 1.15
"""So many more are sought: those that another one beats in everything are left out."""
BANDS, DENSITY = 40, 6
"""Of the problem's frequencies: optima of fractional orders have several peaks of the same height, close together."""
EXACT = 1e-3
"""Relative error of an IAE that is let pass."""
NEAR = 5e-3
"""How far, relative, a design may be above the largest bounds: what it does is told as it is."""


@dataclass(frozen=True)
class Front:
    """Designs none of which is beaten by another in everything, shape (n,) each, by rising noise gain.

    Attributes
    ----------
    process : Process
    structure : str
    filter_order : int
        Of the filter of the measurement.
    horizon, sample_time : float
        Of the load step and of the controller that will run it [s].
    gains : ndarray, shape (n, 5)
        kp, ki, kd, lam, mu.
    filter_time : ndarray
        [s]
    iae_load : ndarray
        IAE of a unit load step over the horizon.
    ms, mt, noise_gain : ndarray
        max |S|, max |T|, and the largest gain from measurement noise to the control, up to the Nyquist frequency.
    stable : ndarray of bool
        By the argument principle; only stable designs are on a front.
    elapsed : float
        [s]
    reason : str
        Why there is no design, where there is none.
    """

    process: Process
    structure: str
    filter_order: int
    horizon: float
    sample_time: float
    gains: Floats
    filter_time: Floats
    iae_load: Floats
    ms: Floats
    mt: Floats
    noise_gain: Floats
    stable: Booleans
    elapsed: float
    reason: str = ""

    def __len__(self) -> int:
        return len(self.iae_load)

    def __repr__(self) -> str:
        return f"<Front: {len(self)} designs of structure {self.structure}>"

    def loop(self, index: int) -> Loop:
        """The loop of a design."""
        slow = MeasurementFilter(self.filter_order, float(self.filter_time[index]))
        return Loop(self.process, Fopid(*self.gains[index].tolist()), slow)

    def best(self, ms_max: float = math.inf, noise_max: float = math.inf, mt_max: float = math.inf) -> int:
        """The design with the least IAE among those within bounds; -1 when there is none."""
        within = (self.ms <= ms_max) & (self.noise_gain <= noise_max) & (self.mt <= mt_max)
        return int(np.argmin(np.where(within, self.iae_load, math.inf))) if within.any() else -1

    @cached_property
    def objectives(self) -> Floats:
        """IAE, Ms and noise gain side by side, shape (n, 3)."""
        return np.column_stack([self.iae_load, self.ms, self.noise_gain])


def front(
    process: Process,
    structure: str = "fopid",
    points: int = POINTS,
    ms_min: float = MS_RANGE[0],
    ms_max: float = MS_RANGE[1],
    noise_max: float | None = None,
    mt_max: float | None = None,
    horizon: float | None = None,
    filter_order: int = 2,
    sample_time: float = 0.01,
    progress: Progress = no_progress,
    clock: Clock = time.perf_counter,
) -> Front:
    """The trade-off between load performance, robustness and control effort, as so many designs.

    Parameters
    ----------
    process : Process
    structure : str
        ``p pi pd pid fopi fopd fopid``.
    points : int
        Designs asked for; fewer come where the trade-off is a curve and no surface.
    ms_min, ms_max : float
        Between which bounds on max |S|.
    noise_max : float, optional
        Largest gain from noise to control; 20 over the process's gain when not given.
    mt_max : float, optional
        A bound that all designs keep.
    horizon : float, optional
        Of the load step [s].
    filter_order : int
        Of the filter of the measurement, whose time is chosen with the gains.
    sample_time : float
        [s]
    progress, clock : callable, optional

    Raises
    ------
    InputError
        If an argument is not allowed.

    Examples
    --------
    >>> found = front(Process.parse("1/(s+1)^3"), "pid", points=20)
    >>> bool(found.stable.all()), round(float(found.ms.max()), 2)
    (True, 2.0)
    """
    one_of("structure", structure, tuple(STRUCTURES))
    require(2 <= points <= MOST_POINTS, "points", points, f"2 to {MOST_POINTS}")
    require(1.0 < ms_min < ms_max, "ms_min", ms_min, f"above 1 and below ms_max = {ms_max:g}")
    require(filter_order > 0, "filter_order", filter_order, "1 or 2")
    begun = clock()
    request = TuningRequest(
        process, "time", index="iae", input="load", structure=structure, ms_max=ms_max, mt_max=mt_max,
        noise_max=noise_max, u_max=math.inf, horizon=horizon, filter_order=filter_order, two_degrees=False,
        sample_time=sample_time,
    )  # fmt: skip
    specification = time_specification(request)
    progress(0.05, "the design with the loosest bounds")
    loosest = tune_time(process, specification)
    points_in_time = enough_points(specification.horizon * natural_crossover(process, PHASE_MARGIN)) // 2
    problem = TimeProblem(process, specification, points_in_time, DENSITY, bands=BANDS)
    progress(0.3, "following the optimum as the bounds move")
    rows, reason = np.zeros((0, len(specification.variables))), ""
    if loosest is not None and loosest.met:
        places = Continuation(problem).surface(loosest.variables, ms_min, math.ceil(SPARE * points))
        rows = np.array([place.descent.gains for place in places])
    else:
        nearest = "no stable design was found" if loosest is None else f"the nearest design has {loosest.ms:.4g}"
        reason = f"no design of structure {structure} with Ms <= {ms_max:g} within the other bounds: {nearest}"
    progress(0.8, "checking every design")
    found = measured(problem, rows)
    chosen = _chosen(found, specification, points)
    progress(1.0, "done")
    if len(rows) and not len(chosen):
        reason = (
            f"none of {len(rows)} designs is for certain stable and within the bounds: is sample_time short enough?"
        )
    rows, found = rows[chosen], _of(found, chosen)
    return Front(
        process, structure, filter_order, specification.horizon, sample_time, rows[:, :5], rows[:, 5], found.iae_load,
        found.ms, found.mt, found.noise_gain, found.stable, clock() - begun, reason,
    )  # fmt: skip


def _chosen(found: Measures, asked: TimeSpecification, points: int) -> Indexes:
    """Which designs to keep: stable ones that no other beats in everything, so many of the least crowded."""
    values = np.log(np.column_stack([found.iae_load, found.ms, found.noise_gain]))
    peaks = ((found.ms, asked.ms_max), (found.mt, asked.mt_max), (found.noise_gain, asked.noise_max))
    within = np.all([peak <= (1.0 + NEAR) * bound for peak, bound in peaks], axis=0)
    good = np.flatnonzero(found.stable & within & (found.iae_error <= EXACT) & np.isfinite(values).all(axis=1))
    good = good[~beaten(values[good])]
    while len(good) > points:
        place = values[good] / np.maximum(np.ptp(values[good], axis=0), 1e-9)
        apart = np.linalg.norm(place[:, None] - place[None], axis=2)
        np.fill_diagonal(apart, math.inf)
        crowd = apart.min(axis=1)
        crowd[place.argmin(axis=0)] = math.inf  # the ends of the trade-off stay
        good = np.delete(good, crowd.argmin())
    return good[np.lexsort((found.ms[good], found.noise_gain[good]))]


def beaten(values: Floats) -> Booleans:
    """Which rows another one is no worse than in any column and better than in one, shape (n,).

    Examples
    --------
    >>> beaten(np.array([[1.0, 2.0], [2.0, 1.0], [2.0, 2.0]])).tolist()
    [False, False, True]
    """
    no_worse = (values[:, None] <= values[None]).all(axis=2)
    better = (values[:, None] < values[None]).any(axis=2)
    return np.asarray((no_worse & better).any(axis=0))


def _of(found: Measures, which: Indexes) -> Measures:
    return replace(found, **{name: getattr(found, name)[which] for name in vars(found)})
