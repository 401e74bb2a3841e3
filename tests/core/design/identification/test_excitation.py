"""A model is judged by what the experiment has moved: a record of disturbances shows -1/C, however well that fits."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from fopid_core.design.identification.identify import IdentificationResult, identify
from fopid_core.design.identification.record import Record
from fopid_core.model.fopid import Fopid
from fopid_core.model.process import read_process
from fopid_core.runtime.controller import ControllerSettings, FopidController
from fopid_core.runtime.plant import Plant, PlantSettings

PROCESS, SAMPLE_TIME, HOLD = "1/((0.1s+1)(0.03s+1))", 0.01, 10


def disturbed_experiment(disturbance: float, gains: Fopid, seed: int = 0) -> Record:
    """A PRBS of +-1 added to the control of a loop whose process feels a slow disturbance as well."""
    rng = np.random.default_rng(seed)
    controller = FopidController(ControllerSettings(gains, sample_time=SAMPLE_TIME))
    plant = Plant(PlantSettings(read_process(PROCESS), SAMPLE_TIME, "exact"))
    n = 600
    added = np.repeat(rng.integers(0, 2, n // HOLD) * 2.0 - 1.0, HOLD) * (np.arange(n) >= 3 * HOLD)
    control, measurement, disturbed = np.empty(n), np.empty(n), 0.0
    for k in range(n):
        disturbed += 0.1 * (disturbance * rng.standard_normal() * math.sqrt(20.0) - disturbed)
        measurement[k] = plant.measurement
        control[k] = controller.step(0.0, measurement[k]) + added[k]
        plant.step(control[k] + disturbed)
    return Record(SAMPLE_TIME * np.arange(n), control, measurement, excitation=added)


def gain_error(result: IdentificationResult) -> float:
    """Of the best model at 10 rad/s, as a share."""
    assert result.best is not None
    s = 10.0j
    return abs(complex(result.best.process(s)) / complex(read_process(PROCESS)(s)) - 1.0)


@pytest.mark.parametrize("gains", [Fopid(0.8, 6.0), Fopid(0.05, 9.0, 0.1, 0.93, 0.8)])
def test_a_record_of_disturbances_shows_the_controller_and_is_refused(gains: Fopid) -> None:
    record = disturbed_experiment(30.0, gains)
    judged = identify(record, "rational:3/1")
    assert not judged.success
    assert "disturbances have moved the measurement more than the experiment has" in judged.message
    unjudged = identify(replace(record, excitation=None), "rational:3/1")
    assert unjudged.best is not None
    assert unjudged.best.fit_pct > 80.0, "it fits well"
    assert gain_error(unjudged) > 1.0, "and is wrong"


@pytest.mark.parametrize("seed", range(3))
def test_an_experiment_among_small_disturbances_is_learnt_from(seed: int) -> None:
    result = identify(disturbed_experiment(0.1, Fopid(0.8, 6.0), seed), "soptd")
    assert result.success, result.message
    assert gain_error(result) < 0.15


def test_a_part_of_a_record_keeps_what_was_added() -> None:
    record = disturbed_experiment(0.0, Fopid(0.8, 6.0))
    part = record.part(1.0, 2.0)
    assert part.excitation is not None
    assert record.excitation is not None
    assert np.array_equal(part.excitation, record.excitation[100:201])
