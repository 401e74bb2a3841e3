"""A million ticks: no growth, no drift, no numbers that slow a processor down. (How fast: `fopid benchmark`.)"""

from __future__ import annotations

import math
import tracemalloc

import numpy as np
import pytest

from fopid_core.model.fopid import Fopid
from fopid_core.runtime.controller import ControllerSettings, FopidController

MILLION = 1_000_000
CONTROLLER = ControllerSettings(Fopid(1.2369, 0.68133, 0.90206, 0.99685, 0.63349), control_min=-2.0, control_max=2.0)


def sizes(controller: FopidController) -> int:
    arrays = (part for part in vars(controller._operators).values() if isinstance(part, np.ndarray))
    return sum(array.nbytes for array in arrays) + len(vars(controller)) + len(vars(controller._operators))


@pytest.mark.slow
def test_a_million_ticks_need_no_more_memory_than_a_thousand() -> None:
    controller = FopidController(CONTROLLER)
    for k in range(1000):
        controller.step(1.0, math.sin(0.01 * k))
    before = sizes(controller)
    tracemalloc.start()
    begun, _ = tracemalloc.get_traced_memory()
    for k in range(50_000):
        controller.step(1.0, math.sin(0.01 * k))
    ended, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    for k in range(MILLION - 50_000):
        controller.step(1.0, math.sin(0.01 * k))
    assert sizes(controller) == before
    assert ended - begun < 2_000
    assert peak - begun < 20_000


@pytest.mark.slow
def test_after_a_million_ticks_it_is_as_exact_as_at_the_start() -> None:
    # A cosine for three hours: its response then is that at the start, the operators' own times the amplitude.
    h, w = 0.01, 1.0
    gains = Fopid(0.5, 0.4, 0.3, 0.8, 0.6)
    controller = FopidController(ControllerSettings(gains, h))
    expected = gains(1j * w)
    size, integral = abs(complex(expected)), gains.ki * abs((1j * w) ** -gains.lam)
    late = np.empty(1000)
    for k in range(MILLION):
        control = controller.step(math.cos(w * h * k), 0.0)
        if k >= MILLION - 1000:
            late[k - MILLION + 1000] = control
    t = h * np.arange(MILLION - 1000, MILLION)
    ideal = size * np.cos(w * t + np.angle(complex(expected)))
    # What an integral keeps of how the cosine began fades as t^-lam; linear interpolation is off by (w h)^2/12.
    assert np.abs(late - ideal).max() < 0.005 * (size + integral)


@pytest.mark.slow
def test_a_million_ticks_at_rest_leave_only_zeros_and_ordinary_numbers() -> None:
    controller = FopidController(CONTROLLER)
    controller.step(1.0, 0.0)
    controller.step(1.0, 1.0)
    for _ in range(MILLION):
        control = controller.step(1.0, 1.0)
    kept = np.abs(controller._operators._now)
    assert not ((kept > 0.0) & (kept < np.finfo(float).tiny)).any()
    assert math.isfinite(control)


@pytest.mark.slow
def test_a_million_ticks_at_the_limit_neither_wind_up_nor_drift() -> None:
    controller = FopidController(CONTROLLER)
    for k in range(MILLION):
        controller.step(1.0, 0.0)
        if k == 20_000:
            early = controller.state.control_unlimited
    assert controller.state.control == 2.0
    assert controller.state.control_unlimited == pytest.approx(early, abs=0.05)
    assert controller.step(-1.0, 0.0) < 0.0
