"""The running filter of the measurement against scipy's discretisation, and the controller that runs behind it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import cont2discrete, dlsim

from fopid_core.design.sampled_loop import running, sampled_controller
from fopid_core.model.fopid import Fopid
from fopid_core.model.loop import Loop
from fopid_core.model.process import Process
from fopid_core.model.response import step_response
from fopid_core.model.two_degrees import MeasurementFilter, SetpointWeights
from fopid_core.runtime.controller import FopidController
from fopid_core.runtime.measurement_filter import RunningFilter
from fopid_core.runtime.plant import Plant, PlantSettings
from fopid_core.runtime.settings import as_designed

TICK = 0.05


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("time", [0.3, 1e-4, 1e4])
def test_it_is_the_filter_for_signals_linear_between_samples(order: int, time: float) -> None:
    signal = np.append(0.0, np.random.default_rng(0).standard_normal(200))
    slow = RunningFilter(MeasurementFilter(order, time), TICK)
    found = [slow.push(float(value)) for value in signal]
    denominator = [time, 1.0] if order == 1 else [0.5 * time**2, time, 1.0]
    system = cont2discrete(([1.0], denominator), TICK, method="foh")
    # scipy's matrix exponential of a fast filter has entries near 1e7: digits are lost there, not here.
    assert found == pytest.approx(dlsim((*system[:2], TICK), signal)[1][:, 0], abs=1e-9 if time > 1e-3 else 1e-6)


@pytest.mark.parametrize("order", [1, 2])
def test_the_sampled_controller_is_the_one_that_runs(order: int) -> None:
    """The answer to a sinusoidal measurement, once it has settled, at a few frequencies."""
    controller = FopidController(
        as_designed(Fopid(1.0, 0.0, 0.4, 1.0, 0.8), TICK, MeasurementFilter(order, 0.3), SetpointWeights())
    )
    for theta in (0.05, 0.5, 2.0):
        controller.reset()
        ticks = np.arange(4000)
        control = np.array([controller.step(0.0, float(np.sin(theta * k))) for k in ticks])
        tail = ticks[2000:]
        basis = np.stack([np.sin(theta * tail), np.cos(theta * tail)], axis=1)
        in_phase, ahead = np.linalg.lstsq(basis, control[2000:], rcond=None)[0]
        assert -complex(in_phase, ahead) == pytest.approx(
            complex(sampled_controller(controller, np.array([theta]))[0]), abs=2e-4
        )


@pytest.mark.parametrize("order", [1, 2])
def test_the_loop_that_runs_is_the_one_that_was_designed(order: int) -> None:
    process, gains = Process.parse("1/(s+1)^3"), Fopid(1.2, 0.6, 0.8, 1.0, 0.9)
    slow, weights = MeasurementFilter(order, 0.2), SetpointWeights(0.5, 0.0)
    tick, ticks = 0.01, 1500
    controller = FopidController(as_designed(gains, tick, slow, weights))
    plant = Plant(PlantSettings(process, sample_time=tick))
    output, control = [], 0.0
    for _ in range(ticks + 1):
        measured = plant.measurement
        control = controller.step(1.0, measured)
        output.append(measured)
        plant.step(control)
    exact = step_response(Loop(process, gains, slow, weights), tick * ticks, points=ticks + 1)
    assert np.abs(np.array(output) - exact.output).max() < 0.01  # sampling and hold
    assert running(process, gains, tick, slow).stable


def test_a_filter_that_changes_makes_no_jump_and_a_hold_begins_anew() -> None:
    settings = as_designed(Fopid(2.0, 0.5), TICK, MeasurementFilter(2, 0.5), SetpointWeights())
    controller = FopidController(settings)
    controls = [controller.step(1.0, 0.01 * k) for k in range(100)]
    slope = abs(controls[-1] - controls[-2])
    controller.reconfigure(replace(settings, measurement_filter_time=1.0))
    assert abs(controller.step(1.0, 1.0) - controls[-1]) <= 2.0 * slope
    held = controller.hold()
    assert controller.step(1.0, 5.0) == pytest.approx(held, abs=0.5 * TICK * 5.0)
