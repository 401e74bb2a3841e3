"""What a controller does on a plant: a step of the setpoint and one of the load, judged by the true output."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from foreign_plants.gallery import GALLERY
from virtual_loop import VirtualLoop

SEED = 11
"""Of the sensor's noise, not that of any tuning."""
SETTLED_SHARE, BEFORE = 0.05, 0.3
"""What of the setpoint's move counts as settled; and how long the loop runs before it, in horizons."""
CALM_SHARE = 0.05
"""Share of the control's range that a calm control moves by at the end, as a standard deviation."""


@dataclass(frozen=True)
class Judgement:
    """What was seen.

    Attributes
    ----------
    setpoint, load : float
        Integral of the absolute error after each step.
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
    overshoot_pct: float
    settling: float
    variation: float
    restless: float
    safe: bool

    @property
    def calm(self) -> bool:
        """Whether it is safe and comes to rest."""
        return self.safe and self.restless < CALM_SHARE and math.isfinite(self.settling)


def judge(name: str, settings: Mapping[str, Any]) -> Judgement:
    """Run the plant of that name with settings of the controller other than its own."""
    exhibit = GALLERY[name]
    loop = VirtualLoop(exhibit, SEED)
    loop.set(**settings)
    loop.run(BEFORE * exhibit.horizon)
    loop.setpoint += exhibit.move
    first = loop.run(exhibit.horizon)
    loop.plant.load = exhibit.load
    second = loop.run(exhibit.horizon)
    _, setpoint, true, control = loop.trace.part(0)
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
        overshoot_pct=100.0 * float(max(after.max(), 0.0)) / exhibit.move,
        settling=dt * last if last < 0.98 * smooth.size else math.inf,
        variation=float(np.abs(np.diff(control[first:])).sum()),
        restless=float(np.std(control[-(control.size - second) // 5 :])) / (actuator.high - actuator.low),
        safe=bool(low < true.min() and true.max() < high),
    )
