"""A sensor that reads more seldom than the controller ticks, as a bus or a slow converter makes of any."""

from __future__ import annotations

import numpy as np
import pytest

from fopid_core.design.identification.frequency_response import BEYOND, frequency_response
from fopid_core.design.identification.identify import identify
from fopid_core.design.identification.record import Record
from fopid_core.design.identification.slow_sensor import as_read

TICK, GAIN, LAG, DELAY = 0.1, 2.0, 4.0, 1.0


def record(readings: np.ndarray, noise: float = 0.02, seed: int = 0, step: float = 0.0) -> Record:
    """One lag moved by a telegraph signal, exactly; the sensor reads at these ticks."""
    chance = np.random.default_rng(seed)
    count = 3000
    control = np.repeat(chance.choice([-1.0, 1.0], count // 50), 50)
    true = np.zeros(count)
    late, kept = round(DELAY / TICK), np.exp(-TICK / LAG)
    for k in range(1, count):
        felt = control[k - 1 - late] if k > late else 0.0
        true[k] = kept * true[k - 1] + GAIN * (1.0 - kept) * felt
    read = true + noise * chance.standard_normal(count)
    read = np.round(read / step) * step if step else read
    newest = readings[np.searchsorted(readings, np.arange(count), side="right") - 1]
    return Record(TICK * np.arange(count), control, read[newest], control_before=0.0)


def every(ticks: int, count: int = 3000) -> np.ndarray:
    return np.arange(0, count, ticks)


@pytest.mark.parametrize("ticks", [2, 3, 5, 12])
def test_the_process_is_learnt_with_the_age_of_the_readings_as_delay(ticks: int) -> None:
    found = identify(record(every(ticks)), "foptd")
    assert found.success
    assert f"the sensor has read every {ticks * TICK:.3g} s only" in found.message
    assert found.best is not None
    gain, lag, delay = (found.best.parameters[name] for name in ("K", "T", "L"))
    assert gain == pytest.approx(GAIN, rel=0.03)
    assert lag == pytest.approx(LAG, rel=0.05)
    assert delay == pytest.approx(DELAY + ticks // 2 * TICK, abs=0.05), "as old as readings are on the mean"


def test_readings_that_a_clock_of_their_own_makes_a_tick_early_or_late() -> None:
    readings = np.round(np.arange(0.0, 3000.0, 12.5)).astype(int)
    found = identify(record(readings), "foptd")
    assert found.success
    assert found.best is not None
    assert found.best.parameters["L"] == pytest.approx(DELAY + 0.6, abs=0.15)


def test_noise_of_such_a_sensor_is_none_with_memory() -> None:
    fits = [identify(record(every(ticks), noise=0.3), "foptd") for ticks in (1, 4)]
    assert [found.success for found in fits] == [True, True]
    assert not any("memory" in found.message for found in fits)


def test_the_response_without_a_model_agrees_with_what_is_learnt() -> None:
    heard = record(every(5), noise=0.1)
    found, shown = identify(heard, "foptd"), frequency_response(heard)
    assert found.best is not None
    assert shown.sample_time == pytest.approx(5 * TICK)
    assert shown.known.sum() > 10
    assert shown.outside(found.best.process, BEYOND).sum() <= 2


@pytest.mark.parametrize("step", [0.0, 0.05, 0.5])
@pytest.mark.parametrize("noise", [0.0, 0.02, 0.2])
def test_one_that_reads_at_each_tick_is_left_alone(noise: float, step: float) -> None:
    heard = record(every(1), noise, step=step)
    assert as_read(heard) is heard


def test_a_measurement_that_hardly_ever_moves_is_left_alone() -> None:
    time = TICK * np.arange(600)
    for values in (np.ones(600), (time > 30.0).astype(float)):
        heard = Record(time, np.sin(time), values)
        assert as_read(heard) is heard
