"""Gains tried with an actuator that sticks or has play, or against dry friction: what a linear process cannot show."""

from __future__ import annotations

import math

import numpy as np

from fopid_core.design.identification.flaws import Flaws
from fopid_core.design.identification.friction import Body
from fopid_core.model.evaluation import default_horizon
from fopid_core.model.loop import Loop
from fopid_core.model.process import Process
from fopid_core.model.stability import stability
from fopid_core.runtime.controller import FopidController
from fopid_core.runtime.convolved_plant import plant_of
from fopid_core.runtime.plant import PlantSettings
from fopid_core.runtime.settings import as_designed

LOADS = (2.0, 20.0)
"""Steps of the load that are tried, in dead bands or frictions: one that is nearly swallowed, one that hardly is."""
WORSE = 1.05
"""By how much more error than what runs new gains may leave."""
MOST_TICKS = 20_000
_SEED = 1


def ticks_until_rest(loop: Loop, sample_time: float) -> int:
    """How many ticks of this length [s] a step of a loop takes to die out, as many as are simulated at most."""
    horizon = default_horizon(loop) if stability(loop).stable else math.inf
    return int(min(math.ceil(horizon / sample_time), MOST_TICKS)) if math.isfinite(horizon) else MOST_TICKS


class FlawTrial:
    """The loop with its flaws after steps of a load, with the gains that run and with others.

    Parameters
    ----------
    process : Process
        Behind the actuator; where there is friction, the body that it holds stands for it.
    flaws : Flaws
        A dead band, or dry friction.
    sample_time : float
        Of the controller [s].
    noise : float
        Standard deviation of the measurement's noise.
    running : Loop
        What runs.

    Examples
    --------
    >>> from fopid_core.model.fopid import Fopid
    >>> process, play = Process.parse("1/(s+1)"), Flaws(dead_band=0.1, slip=0.0)
    >>> trial = FlawTrial(process, play, 0.1, 0.0, Loop(process, Fopid(kp=1.0, ki=1.0)))
    >>> trial.refusal(Loop(process, Fopid(kp=2.0, ki=2.0)))
    ''
    >>> trial.refusal(Loop(process, Fopid(kp=0.5, ki=0.5)))
    'the actuator has play within 0.1: after a load of 2 times that 2 times the error of what runs is left'
    """

    def __init__(self, process: Process, flaws: Flaws, sample_time: float, noise: float, running: Loop) -> None:
        self._process, self._flaws, self._sample_time = process, flaws, sample_time
        self._ticks = ticks_until_rest(running, sample_time)
        self._noise = noise * np.random.default_rng(_SEED).standard_normal(self._ticks)
        self._before = [self._error(running, size) for size in LOADS]

    def refusal(self, loop: Loop) -> str:
        """Why gains may not be used; empty where they leave no more error than what runs."""
        for size, before in zip(LOADS, self._before, strict=True):
            error = self._error(loop, size)
            if error > WORSE * before:
                after = f"after a load of {size:g} times that {error / before:.2g} times the error of what runs is left"
                return f"{self._flaws}: {after}"
        return ""

    def _error(self, loop: Loop, times: float) -> float:
        """Sum of the absolute error after a load of so many times the flaw; infinite where it grows beyond numbers."""
        controller = FopidController(as_designed(loop.controller, self._sample_time, loop.filter, loop.weights))
        friction, stem, total = self._flaws.friction, np.zeros(1), 0.0
        plant = (
            Body(friction, self._sample_time) if friction
            else plant_of(PlantSettings(self._process, self._sample_time, delay_model="exact"))
        )  # fmt: skip
        load = times * (friction.size if friction else float(self._flaws.dead_band))
        for noise in self._noise.tolist():
            control = controller.step(0.0, plant.measurement + noise)
            stem = self._flaws.stem(np.array([control]), stem)
            plant.step(float(stem[0]), load)
            total += abs(plant.measurement)
            if not total < 1e90:
                return math.inf
        return total
