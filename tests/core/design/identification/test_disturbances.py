"""A load that comes during a record, a drift and noise with memory are modelled beside the process, not by it."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.signal import lfilter

from fopid_core.design.defaults import natural_crossover
from fopid_core.design.identification.identified_model import IdentifiedModel
from fopid_core.design.identification.identify import identify
from fopid_core.design.identification.record import Record
from fopid_core.model.fopid import Fopid
from fopid_core.model.process import read_process
from tests.cases import slow

from .recorded import closed_loop, open_loop

SAMPLES, BIT, LOAD = 1200, 20, 0.5
LAG = "2/(10s+1)*exp(-3s)"
PROCESSES = ("P1", "P4", LAG)


def crossover(process: str) -> float:
    return natural_crossover(read_process(process), math.radians(60.0))


def load(sample: int) -> float:
    """Of half the control's moves, in the middle."""
    return LOAD if sample >= SAMPLES // 2 else 0.0


def bits(seed: int) -> np.ndarray:
    return np.repeat(np.random.default_rng(seed).integers(0, 2, SAMPLES // BIT), BIT).astype(float)


def recorded(process: str, *, closed: bool, loaded: bool, seed: int = 0) -> Record:
    """Moves of the control or of the setpoint, ten samples a radian at the crossover; noise of 3 %."""
    dt, moves = 0.1 / crossover(process), bits(seed)
    if closed:
        gain = 0.3 / abs(complex(read_process(process)(1j * crossover(process))))
        gains = Fopid(gain, 0.5 * gain * crossover(process))
        disturbance = load if loaded else lambda _: 0.0
        record = closed_loop(process, lambda k: float(moves[min(k, SAMPLES - 1)]), SAMPLES, dt, gains,
                             disturbance=disturbance)  # fmt: skip
    else:
        felt = moves + np.array([load(k) for k in range(SAMPLES)]) * loaded
        record = Record(dt * np.arange(SAMPLES), moves, open_loop(process, felt, dt).measurement)
    return beside(record, 0.03 * np.random.default_rng(seed).standard_normal(SAMPLES))


def beside(record: Record, noise: np.ndarray) -> Record:
    """With noise, in spreads of the measurement."""
    measurement = record.measurement + np.std(record.measurement) * noise
    return Record(record.time, record.control, measurement, record.setpoint)


def with_memory(size: float, seed: int) -> np.ndarray:
    """An autoregression of the first order whose memory is 20 samples."""
    pole = 0.95
    white = np.random.default_rng(seed).standard_normal(SAMPLES)
    return size * math.sqrt(1.0 - pole**2) * lfilter([1.0], [1.0, -pole], white)


def error(model: IdentifiedModel, process: str) -> float:
    s = 1j * crossover(process)
    return abs(complex(model.process(s)) / complex(read_process(process)(s)) - 1.0)


@pytest.mark.parametrize(
    ("process", "closed"),
    [("P1", False), *slow(("P1", True), ("P4", False), ("P4", True), (LAG, False), (LAG, True))],
)
def test_a_load_that_comes_in_the_middle_is_found_and_leaves_the_model_as_it_is(process: str, closed: bool) -> None:
    record = recorded(process, closed=closed, loaded=True)
    found = identify(record)
    assert found.success, found.message
    assert found.best is not None
    assert found.best.loads == pytest.approx([0.5 * record.span], rel=0.02)
    assert "a load that came after" in found.message
    assert error(found.best, process) < 0.02


def test_a_load_and_a_drift_are_told_apart() -> None:
    record = recorded("P1", closed=False, loaded=True)
    drift = 2.0 * np.arange(SAMPLES) / SAMPLES
    found = identify(beside(record, drift))
    assert found.success, found.message
    assert found.best is not None
    assert found.best.ramp == pytest.approx(2.0 * np.std(record.measurement) / record.span, rel=0.05)
    assert found.best.loads == pytest.approx([0.5 * record.span], rel=0.02)
    assert error(found.best, "P1") < 0.02


@pytest.mark.parametrize("closed", [False, True])
def test_nothing_is_found_where_nothing_came(closed: bool) -> None:
    found = identify(recorded("P1", closed=closed, loaded=False))
    assert found.best is not None
    assert found.best.loads == ()
    assert found.best.ramp == 0.0
    assert not found.best.in_coloured_noise


@pytest.mark.long
@pytest.mark.parametrize("process", PROCESSES)
def test_noise_with_memory_is_no_reason_to_refuse_and_the_deviation_says_what_it_costs(process: str) -> None:
    errors, deviations = [], []
    for seed in range(4):
        found = identify(beside(recorded(process, closed=False, loaded=False, seed=seed), with_memory(0.4, seed)))
        assert found.success, found.message
        assert found.best is not None
        assert found.best.in_coloured_noise
        assert "the noise has memory" in found.message
        errors.append(error(found.best, process))
        deviations.append(found.best.deviation)
    # eight numbers, real and imaginary, of that deviation: their mean square is within 2.5 times but once in 10,000
    assert math.sqrt(np.mean(np.square(errors))) < 2.0 * math.sqrt(np.mean(np.square(deviations)))
    assert max(errors) < 0.25
