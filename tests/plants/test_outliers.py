"""Samples that are far off now and then: they come too seldom for a rest of some seconds, and move the control."""

from __future__ import annotations

import numpy as np
import pytest

from fopid_core.model.fopid import Fopid
from fopid_ros.tuner.learning.loop_baseline import MOST_HEARD, LoopBaseline
from fopid_ros.tuner.learning.loop_tap import Tick
from fopid_ros.tuner.learning.running_controller import RunningController

NOISE, FAR, SELDOM, COUNT = 0.1, 6.0, 150, 15_000
RESTING = RunningController(Fopid(2.0, 1.0), 0.01, 0.0, 100.0)


def heard(measured: np.ndarray) -> LoopBaseline:
    """A loop about 60 whose newest two hundred ticks were looked at, and all before it were there as well."""
    baseline = LoopBaseline(RESTING)
    baseline.measure([Tick(0.01 * k, 60.0, y, 30.0) for k, y in enumerate(measured[-MOST_HEARD:])], 0.0, 0.0)
    baseline.listen(measured, 0.0, 0.0)
    return baseline


def rest(seed: int, step: float = 0.0) -> np.ndarray:
    measured = 60.0 + np.random.default_rng(seed).normal(0.0, NOISE, COUNT)
    return np.asarray(np.round(measured / step) * step if step else measured)


@pytest.mark.parametrize("step", [0.0, 0.05, 0.25])
@pytest.mark.parametrize("seed", range(3))
def test_a_design_expects_those_that_came_before_the_rest_that_was_looked_at(seed: int, step: float) -> None:
    measured = rest(seed, step)
    spikes = np.zeros(COUNT)
    spikes[50 : -MOST_HEARD - 10 : SELDOM] = FAR
    usual, spiky = heard(measured), heard(measured + spikes)
    truth = float(np.hypot(np.std(measured), np.sqrt(np.mean(spikes**2))))
    assert spiky.sensor.level == pytest.approx(truth, rel=0.15)
    assert spiky.sensor.level > 3.0 * usual.sensor.level
    assert (spiky.noise, spiky.deviation_max) == (usual.noise, usual.deviation_max), "it is moved no further for that"


def test_those_in_the_rest_itself_count_once() -> None:
    measured = rest(0)
    measured[:: SELDOM // 3] += FAR
    spiky = heard(measured)
    assert spiky.sensor.level == pytest.approx(float(np.std(measured)), rel=0.2)


@pytest.mark.parametrize("seed", range(5))
def test_where_none_are_nothing_is_added(seed: int) -> None:
    drifting = rest(seed) + np.linspace(0.0, 3.0, COUNT)
    stepping = rest(seed, 0.25)
    heavy = 60.0 + NOISE * np.random.default_rng(seed).laplace(size=COUNT)
    for measured in (rest(seed), drifting, stepping, np.full(COUNT, 60.0)):
        assert heard(measured).outlying == 0.0
    assert heard(heavy).outlying < 0.3 * NOISE
