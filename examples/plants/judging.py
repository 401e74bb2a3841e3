"""What a controller does on a plant: a step of the setpoint and one of the load, judged by the true output.

Noise of the sensor moves the control, and so the plant: one run tells two good controllers apart no better than dice
do. So gains are judged by the same sixteen runs, which differ by the sensor's noise alone, run beside run.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from foreign_plants.gallery import GALLERY
from virtual_loop import VirtualLoop

SEEDS = tuple(range(11, 27))
"""Of the sensor's noise, the same for all that is compared; not that of any tuning."""
STANDARD_ERRORS = 2.0
"""So many of them is a mean difference of two controllers over the same runs at least, where it is one."""
SETTLED_SHARE, BEFORE = 0.05, 0.3
"""What of the setpoint's move counts as settled; and how long the loop runs before it, in horizons."""
CALM_SHARE = 0.05
"""Share of the control's range that a calm control moves by at the end, as a standard deviation."""


@dataclass(frozen=True)
class Judgement:
    """What was seen in one run.

    Attributes
    ----------
    setpoint, load : float
        Integral of the absolute error after each step.
    load_effect : float
        That of how far the load's step moves the output, beside a run with the same noise and without it; NaN where
        nobody asked for that second run.
    overshoot_pct, settling : float
        Of the setpoint's step; how long after it [s], infinite when not within the horizon.
    variation : float
        Total variation of the control after the first step.
    restless : float
        Standard deviation of the control in the last fifth, as a share of its range.
    safe : bool
        The plant stayed where it may be.
    """

    setpoint: float
    load: float
    load_effect: float
    overshoot_pct: float
    settling: float
    variation: float
    restless: float
    safe: bool

    @property
    def calm(self) -> bool:
        """Whether it is safe and comes to rest."""
        return self.safe and self.restless < CALM_SHARE and math.isfinite(self.settling)


@dataclass(frozen=True)
class Judgements:
    """What was seen in several runs, one of each seed; figures without further words are means over them.

    Attributes
    ----------
    runs : tuple of Judgement
    """

    runs: tuple[Judgement, ...]

    def of(self, figure: str) -> np.ndarray:
        """A figure in each run."""
        return np.array([getattr(run, figure) for run in self.runs])

    def mean(self, figure: str) -> float:
        """Over the runs."""
        return float(self.of(figure).mean())

    def scatter(self, figure: str) -> float:
        """Standard deviation of a figure from run to run."""
        return float(np.std(self.of(figure), ddof=1)) if len(self.runs) > 1 else 0.0

    @property
    def load(self) -> float:
        """Integral of the absolute error after the load's step."""
        return self.mean("load")

    @property
    def variation(self) -> float:
        """Total variation of the control."""
        return self.mean("variation")

    @property
    def safe(self) -> bool:
        """In every run."""
        return all(run.safe for run in self.runs)

    @property
    def settling(self) -> float:
        """The median, since a run may not settle [s]."""
        return float(np.median(self.of("settling")))

    @property
    def calm(self) -> bool:
        """Whether it is safe in every run, and comes to rest in most."""
        return self.safe and 2 * sum(run.calm for run in self.runs) > len(self.runs)

    def exceeds(self, other: Judgements, figure: str) -> bool:
        """Whether a figure is larger than another controller's, by more than noise explains.

        The mean difference over the same runs is beyond two of its standard errors.
        """
        more = self.of(figure) - other.of(figure)
        error = float(np.std(more, ddof=1)) / math.sqrt(more.size) if more.size > 1 else 0.0
        return not more.mean() <= STANDARD_ERRORS * error  # what is not a number is no tie


def judge(
    name: str, settings: Mapping[str, Any], seeds: Sequence[int] = SEEDS, *, load_effect: bool = False
) -> Judgements:
    """Run the plant of that name with settings of the controller other than its own, once with each noise.

    For the ``load_effect`` once more, without the load.
    """
    return Judgements(tuple(_run(name, settings, seed, load_effect) for seed in seeds))


def _stepped(name: str, settings: Mapping[str, Any], seed: int, load: float) -> tuple[VirtualLoop, int, int]:
    """The loop after both steps, and at which ticks they began."""
    exhibit = GALLERY[name]
    loop = VirtualLoop(exhibit, seed)
    loop.set(**settings)
    loop.run(BEFORE * exhibit.horizon)
    loop.setpoint += exhibit.move
    first = loop.run(exhibit.horizon)
    loop.plant.load = load
    second = loop.run(exhibit.horizon)
    return loop, first, second


def _run(name: str, settings: Mapping[str, Any], seed: int, load_effect: bool) -> Judgement:
    exhibit = GALLERY[name]
    loop, first, second = _stepped(name, settings, seed, exhibit.load)
    _, setpoint, true, control = loop.trace.part(0)
    effect = math.nan
    if load_effect:
        _, _, unloaded, _ = _stepped(name, settings, seed, 0.0)[0].trace.part(second)
        effect = float(np.abs(true[second:] - unloaded).sum()) * exhibit.sample_time
    error, dt = np.abs(setpoint - true), exhibit.sample_time
    after = true[first:second] - loop.setpoint
    smooth = np.convolve(after, np.ones(5) / 5.0, mode="valid")  # a drifting sensor and noise are no swings
    outside = np.flatnonzero(np.abs(smooth) > SETTLED_SHARE * exhibit.move)
    last = float(outside[-1]) + 1.0 if outside.size else 0.0
    low, high = exhibit.unsafe
    actuator = loop.plant.actuator
    return Judgement(
        setpoint=float(error[first:second].sum() * dt),
        load=float(error[second:].sum() * dt),
        load_effect=effect,
        overshoot_pct=100.0 * float(max(after.max(), 0.0)) / exhibit.move,
        settling=dt * last if last < 0.98 * smooth.size else math.inf,
        variation=float(np.abs(np.diff(control[first:])).sum()),
        restless=float(np.std(control[-(control.size - second) // 5 :])) / (actuator.high - actuator.low),
        safe=bool(low < true.min() and true.max() < high),
    )
