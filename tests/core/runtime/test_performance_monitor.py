"""A loop that was made worse is called worse, one that was made better is not."""

from __future__ import annotations

import math

import numpy as np
import pytest

from fopid_core.errors import InputError
from fopid_core.model.fopid import Fopid
from fopid_core.model.process import read_process
from fopid_core.runtime.controller import ControllerSettings, FopidController, with_gains
from fopid_core.runtime.performance_monitor import (
    LoopPerformance,
    MonitorSettings,
    PerformanceMeter,
    PerformanceMonitor,
)
from fopid_core.runtime.plant import Plant, PlantSettings

STEP = 0.02
USUAL = Fopid(kp=0.8, ki=0.35)
BETTER = Fopid(kp=1.5, ki=0.6)
WINDOW = 60.0


class Running:
    """A loop on P1 with a square wave as setpoint and noise, and a meter."""

    def __init__(self, seed: int = 0, limit: float = math.inf) -> None:
        settings = ControllerSettings(USUAL, sample_time=STEP, control_min=-limit, control_max=limit)
        self.controller = FopidController(settings)
        self.plant = Plant(PlantSettings(read_process("P1"), STEP, noise_std=0.01, seed=seed))
        self.time = 0.0

    def tick(self, watcher: PerformanceMeter | PerformanceMonitor, steps: bool = True) -> None:
        setpoint = float(self.time // 20.0 % 2) if steps else 0.0
        measurement = self.plant.measurement
        self.plant.step(self.controller.step(setpoint, measurement))
        watcher.step(setpoint, measurement, self.controller.state.saturated)
        self.time += STEP


def before(running: Running, steps: bool = True) -> LoopPerformance:
    meter = PerformanceMeter(STEP)
    for _ in range(round(WINDOW / STEP)):
        running.tick(meter, steps)
    return meter.figures


def watched(
    gains: Fopid, seed: int = 0, steps: bool = True, limit: float = math.inf
) -> tuple[PerformanceMonitor, Running]:
    running = Running(seed, limit)
    watch = PerformanceMonitor(before(running, steps), MonitorSettings(WINDOW, response_time=3.0, noise=0.01), STEP)
    running.controller.reconfigure(with_gains(running.controller.settings, gains))
    while not watch.finished:
        running.tick(watch, steps)
    return watch, running


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("steps", [True, False])
def test_gains_that_leave_the_loop_unstable_are_called_worse_before_much_happens(seed: int, steps: bool) -> None:
    watch, running = watched(Fopid(kp=9.0, ki=2.0), seed, steps)
    assert watch.verdict == "worse"
    assert watch.figures.duration < 0.7 * WINDOW
    assert abs(running.plant.output) < 10.0


@pytest.mark.parametrize("seed", range(4))
def test_gains_that_leave_the_loop_ringing_are_called_worse(seed: int) -> None:
    watch, _ = watched(Fopid(kp=5.5, ki=1.8), seed)
    assert watch.verdict == "worse"


@pytest.mark.parametrize("seed", range(4))
def test_gains_that_make_the_loop_sluggish_are_not_called_better(seed: int) -> None:
    watch, _ = watched(Fopid(kp=0.05, ki=0.02), seed)
    assert watch.verdict != "better"


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("steps", [True, False])
def test_better_gains_and_the_same_gains_are_not_called_worse(seed: int, steps: bool) -> None:
    assert watched(BETTER, seed, steps)[0].verdict != "worse"
    assert watched(USUAL, seed, steps)[0].verdict != "worse"


def test_better_gains_are_called_better() -> None:
    assert watched(BETTER)[0].verdict == "better"


def test_a_control_that_is_at_its_limits_from_now_on_is_worse() -> None:
    figures = LoopPerformance(WINDOW, mean_square=1.0, travel=0.0, oscillation=0.0, saturated=0.05)
    watch = PerformanceMonitor(figures, MonitorSettings(WINDOW, response_time=3.0), STEP)
    while not watch.finished:
        watch.step(0.0, 0.5, saturated=True)
    assert watch.verdict == "worse"
    assert "at a limit 100% of the time, 5% before" in watch.reason


def test_a_sine_is_an_oscillation_and_noise_is_not() -> None:
    noise = np.random.default_rng(0).standard_normal(5000)
    sine, random = PerformanceMeter(STEP), PerformanceMeter(STEP)
    for k in range(5000):
        sine.step(0.0, math.sin(0.05 * k) + 0.01 * noise[k], saturated=False)
        random.step(0.0, noise[k], saturated=False)
    assert sine.figures.oscillation > 0.9
    assert random.figures.oscillation < 0.5


def test_figures_are_what_numpy_says() -> None:
    rng = np.random.default_rng(1)
    setpoint, measurement, saturated = *rng.standard_normal((2, 300)), rng.random(300) < 0.3
    meter = PerformanceMeter(STEP)
    for values in zip(setpoint, measurement, saturated, strict=True):
        meter.step(values[0], values[1], bool(values[2]))
    figures = meter.figures
    assert figures.duration == pytest.approx(300 * STEP)
    assert figures.mean_square == pytest.approx(np.mean(np.subtract(setpoint, measurement) ** 2))
    assert figures.travel == pytest.approx(np.sum(np.diff(setpoint) ** 2))
    assert figures.saturated == pytest.approx(np.mean(saturated))


def test_settings_and_signals_that_make_no_sense_are_named() -> None:
    with pytest.raises(InputError, match="window"):
        MonitorSettings(0.0, response_time=1.0)
    with pytest.raises(InputError, match="error_factor"):
        MonitorSettings(1.0, response_time=1.0, error_factor=0.5)
    with pytest.raises(InputError, match="sample_time"):
        PerformanceMeter(0.0)
    with pytest.raises(InputError, match="measurement = nan"):
        PerformanceMeter(STEP).step(0.0, math.nan, saturated=False)
