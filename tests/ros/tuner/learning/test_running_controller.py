"""What the running controller says of itself."""

from __future__ import annotations

import re
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from fopid_core.errors import InputError
from fopid_core.model.fopid import Fopid
from fopid_core.model.two_degrees import MeasurementFilter, SetpointWeights
from fopid_core.runtime.settings import Pace
from fopid_ros.tuner.controller_client import DEADBAND, FILTER, GAINS, PACE, WEIGHTS, RunningDesign
from fopid_ros.tuner.learning.loop_baseline import LoopBaseline
from fopid_ros.tuner.learning.loop_tap import Tick
from fopid_ros.tuner.learning.running_controller import RunningController, read_running_controller

NOW = RunningDesign(Fopid(0.5, 1.0), MeasurementFilter(2, 0.003), SetpointWeights(0.5, 0.0))
LIMITS = ("control_min", "control_max")


def test_a_controller_in_manual_mode_is_not_tuned() -> None:
    numbers = dict.fromkeys((*GAINS, "sample_time", *LIMITS, *FILTER, *WEIGHTS, *PACE, DEADBAND), 1.0)
    answers: dict[str, Any] = {**numbers, "mode": "manual", "antiwindup": "none"}
    client: Any = SimpleNamespace(get=lambda *names: [answers[name] for name in names])
    with pytest.raises(InputError, match="mode = 'manual'"):
        read_running_controller(client)
    answers["mode"] = "auto"
    assert read_running_controller(client) == RunningController(
        Fopid(1.0, 1.0, 1.0, 1.0, 1.0),
        1.0,
        1.0,
        1.0,
        MeasurementFilter(1, 1.0),
        SetpointWeights(),
        Pace(1.0, 1.0),
        "none",
        1.0,
    )


@pytest.mark.parametrize(("control", "saturated"), [(-1.0, True), (-0.99, False), (0.99, False), (1.0, True)])
def test_a_control_at_a_limit_is_saturated(control: float, saturated: bool) -> None:
    assert RunningController(NOW.gains, 0.01, -1.0, 1.0).saturated(control) == saturated


def test_what_runs_is_gains_filter_weights_pace_and_deadband() -> None:
    pace = Pace(3.0, 2.0)
    controller = RunningController(NOW.gains, 0.01, -1.0, 1.0, NOW.filter, NOW.weights, pace, deadband=0.1)
    assert controller.running == replace(NOW, pace=pace, deadband=0.1)


def test_the_range_of_the_control_is_between_its_limits() -> None:
    assert RunningController(NOW.gains, 0.01, 1.0, 4.0).control_range == 3.0


@pytest.mark.parametrize(("amplitude", "fits"), [(2.0, True), (2.9, True), (3.1, False), (1e9, False)])
def test_an_amplitude_beyond_the_limits_is_refused_with_what_they_leave(amplitude: float, fits: bool) -> None:
    controller = RunningController(Fopid(1.0, 1.0), 0.05, control_min=0.0, control_max=10.0)
    loop = LoopBaseline(controller, control=3.0)
    if fits:
        loop.check_amplitude(amplitude)
    else:
        with pytest.raises(InputError, match=re.escape(f"amplitude = {amplitude:.4g}; allowed: up to 3, as far as")):
            loop.check_amplitude(amplitude)


@pytest.mark.parametrize(("dropped", "told"), [(3, True), (0, False), (100, False)])
def test_a_sensor_that_drops_out_is_named_beside_its_noise(dropped: int, told: bool) -> None:
    """One reading of 0 in some seconds looked like a noise of 8.6, about which nothing else was said."""
    measured = 50.0 + 0.1 * np.random.default_rng(0).standard_normal(300)
    measured[:dropped] = 0.0
    loop = LoopBaseline(RunningController(Fopid(1.0, 1.0), 0.05, 0.0, 100.0))
    loop.measure([Tick(0.05 * k, 50.0, float(value), 3.0) for k, value in enumerate(measured)], 1.0, 0.0)
    assert ("3 of its samples at rest are far off the others: does the sensor drop out?" in loop.by_itself) == told
    assert ("far off" in loop.by_itself) == told
