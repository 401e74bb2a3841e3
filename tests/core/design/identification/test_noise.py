"""Noise and quantisation of a sensor are read off a record where the measurement rests, and only there."""

from __future__ import annotations

import math

import numpy as np
import pytest

from fopid_core.design.identification.noise import reported_step, resolution, sensor_noise
from fopid_core.design.identification.record import Record

from .recorded import closed_loop, square_wave, step_record


@pytest.mark.parametrize("level", [0.001, 0.02, 0.1])
def test_the_noise_of_a_step_test_is_found_within_a_tenth(level: float) -> None:
    found = [sensor_noise(step_record("2/(s+1)^2", 30.0, 0.05, level, seed)).level for seed in range(8)]
    assert found == pytest.approx([level] * 8, rel=0.2)
    assert np.mean(found) == pytest.approx(level, rel=0.05)


def test_in_closed_loop_it_is_found_between_the_steps() -> None:
    record = closed_loop("1/(s+1)^2", square_wave(400), 1600, 0.05, noise=0.01)
    assert sensor_noise(record).level == pytest.approx(0.01, rel=0.1)


def test_a_measurement_that_nowhere_rests_tells_no_noise() -> None:
    time = np.arange(0.0, 40.0, 0.1)
    found = sensor_noise(Record(time, np.sin(time), np.sin(time - 0.5)))
    assert not found.at_rest


def test_a_quantised_measurement_that_stands_still_has_the_noise_of_its_step() -> None:
    record = step_record("2/(s+1)^2", 30.0, 0.05)
    quantised = Record(record.time, record.control, 0.1 * np.round(record.measurement / 0.1))
    found = sensor_noise(quantised)
    assert found.step == pytest.approx(0.1)
    assert found.level == pytest.approx(0.1 / np.sqrt(12.0))


@pytest.mark.parametrize(
    ("values", "step"),
    [
        ([0, 0, 1, 1, 1, 2, 2, 3], 1.0),  # a slow rise
        ([0, 0, 1, 2, 3, 4, 5, 6], 0.0),  # a line
        ([0.5, 0.5, 0.5, 0.5], 0.0),
        ([0, 0.02, 0.06, 0.04, 0.0], 0.02),
    ],
    ids=("staircase", "line", "still", "noise"),
)
def test_a_staircase_is_told_from_a_line(values: list[float], step: float) -> None:
    assert resolution(np.array(values)) == pytest.approx(step)


def told_by_exception(values: np.ndarray, least: float) -> np.ndarray:
    """Each where it is that far from what was told last."""
    told = [float(values[0])]
    for value in values[1:].tolist():
        told.append(value if abs(value - told[-1]) >= least else told[-1])
    return np.array(told)


def test_a_measurement_told_by_exception_has_the_noise_of_what_is_not_told() -> None:
    """It stands still for most of the time: with no noise at all a design took no filter, and kicked at each report."""
    time = np.arange(0.0, 900.0)
    noise = 0.05 * np.random.default_rng(1).standard_normal(900)
    moved = np.sin(np.maximum(time - 450.0, 0.0) / 200.0)
    slow = told_by_exception(10.0 * moved + noise, 0.4)
    assert reported_step(slow) == pytest.approx(0.4, rel=0.05)
    record = Record(time, moved, slow)
    assert sensor_noise(record).level == pytest.approx(0.4 / math.sqrt(12.0), rel=0.05)


def test_a_sensor_that_reads_seldom_or_a_ramp_after_a_rest_is_not_told_by_exception() -> None:
    rng = np.random.default_rng(2)
    assert reported_step(np.repeat(rng.standard_normal(100), 5)) == 0.0
    ramp = np.concatenate([np.zeros(500), 0.013 * np.arange(400.0)])
    assert reported_step(ramp) == 0.0
    assert reported_step(np.concatenate([np.zeros(500), 1.0 - np.exp(-0.1 * np.arange(100.0))])) == 0.0
