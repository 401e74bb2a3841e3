"""Gains from a model whose structure is wrong are held against the frequency response that the record itself shows."""

from __future__ import annotations

import numpy as np
import pytest

from fopid_core.design.identification.frequency_response import FrequencyResponse, frequency_response
from fopid_core.design.identification.record import Record
from fopid_core.design.recorded_tuning import tune_recorded
from fopid_core.design.response_verification import contradicts, held_without_a_model
from fopid_core.design.robust_verification import RobustLimits
from fopid_core.design.specification import TuningRequest
from fopid_core.design.tuner import tune
from fopid_core.model.loop import Loop
from fopid_core.model.margins import margins
from fopid_core.model.process import Process
from fopid_core.runtime.plant import Plant, PlantSettings

TRUE, H = Process.parse("1/(s+1)^3"), 0.2


@pytest.fixture(scope="module")
def record() -> Record:
    """An open-loop record with random steps."""
    plant = Plant(PlantSettings(TRUE, sample_time=H, noise_std=0.02, seed=1))
    control = np.repeat(np.random.default_rng(5).choice([-1.0, 1.0], 120), 12)
    measured = []
    for value in control:
        measured.append(plant.measurement)
        plant.step(float(value))
    return Record(H * np.arange(control.size), control, np.array(measured))


def test_a_model_of_the_right_structure_is_not_contradicted_and_another_is(record: Record) -> None:
    seen = frequency_response(record)
    assert contradicts(seen, TRUE) == ""
    assert "at 1" in contradicts(seen, Process.parse("1/(2.2s+1)*exp(-0.9s)"))  # of more than nine frequencies


def test_gains_for_a_wrong_structure_hold_the_process_or_are_refused(record: Record) -> None:
    found = tune_recorded(record, "frequency", limits=RobustLimits(samples=5), template="foptd")
    assert "the model leaves what the record shows without one" in found.message
    assert found.tuned is not None
    assert found.tuned.tuning is not None
    controller = found.tuned.tuning.controller
    assert not found.success or margins(Loop(TRUE, controller, found.tuned.tuning.filter)).ms < 2.2


def test_the_bound_is_over_the_whole_disc() -> None:
    """Against the worst of many points on each circle."""
    w = np.geomspace(0.1, 5.0, 15)
    response, radius = np.asarray(TRUE(1j * w)), 0.1 * np.abs(TRUE(1j * w))
    tuning = tune(TuningRequest(TRUE, "rule", rule="simc-pi"))
    loop = tuning.controller(1j * w)
    circle = np.exp(2j * np.pi * np.arange(720) / 720)
    worst = float((1.0 / np.abs(1.0 + loop[:, None] * (response[:, None] + radius[:, None] * circle))).max())
    seen = FrequencyResponse(w, response, radius, H, 10)
    assert held_without_a_model(seen, 1.001 * worst)(tuning) == ""
    assert held_without_a_model(seen, 0.999 * worst)(tuning)
