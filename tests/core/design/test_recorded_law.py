"""A process that the controller which ran would not have held is not the one of its record."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lti

from fopid_core.api.learning import identify as learn
from fopid_core.design.identification.identify import identify
from fopid_core.design.identification.record import Record
from fopid_core.design.recorded_law import beside_what_ran, contradicts_law, lateness, made_prompt
from fopid_core.design.recorded_tuning import tune_recorded
from fopid_core.design.specification import TuningRequest
from fopid_core.design.tuner import verify
from fopid_core.model.fopid import Fopid
from fopid_core.model.process import Process

H, DELAY, KP, KI = 0.5, 4, -1e5, -1e4


def day(seed: int, load: float, samples: int = 500, limits: float = np.inf) -> Record:
    """A closed loop of -4e-6/((12s+1)(3s+1))*exp(-2s) and a PI: three setpoints and a load, in plain numpy."""
    plant = lti([-4e-6], np.polymul([12, 1], [3, 1])).to_ss().to_discrete(H)
    noise = 5e-4 * np.random.default_rng(seed).standard_normal(samples)
    x, waiting, integral, rows = np.zeros((2, 1)), [0.0] * DELAY, 0.0, []
    for k in range(samples):
        setpoint = -0.1 * (1.0 * (k >= 50) - 1.5 * (k >= 175) + 1.0 * (k >= 400))
        measured = float((plant.C @ x).item()) + noise[k]
        integral += KI * H * (setpoint - measured)
        control = float(np.clip(KP * (setpoint - measured) + integral, -limits, limits))
        rows.append((control, measured, setpoint))
        waiting.append(control + load * (k >= 275))
        x = plant.A @ x + plant.B * waiting.pop(0)
    control, measured, setpoint = np.array(rows).T
    return Record(H * np.arange(samples), 5e5 + control, 0.003 + measured, 0.003 + setpoint)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1])
def test_gains_of_the_wrong_sign_are_not_handed_out(seed: int) -> None:
    """A load as large as a step of the setpoint made a model of the other sign, whose gains drove the plant away."""
    found = tune_recorded(day(seed, 25_000.0), "time", {"structure": "pid"})
    gains = found.tuned.tuning.controller if found.success and found.tuned and found.tuned.tuning else None
    assert gains is None or gains.kp < 0.0


@pytest.mark.slow
def test_identification_is_no_success_with_a_process_that_would_not_have_been_held() -> None:
    """The tuner's ~/identify adopted one of the wrong sign, for which ~/tune then handed out gains as verified."""
    record = day(1, -25_000.0)
    alone, told = identify(record), learn(record)
    assert alone.success
    assert alone.best is not None
    assert alone.best.process(1e-3j).imag > 0.0
    assert not told.success
    assert "would not hold this process" in told.message


@pytest.mark.slow
def test_nor_with_one_that_misses_what_the_setpoint_has_moved() -> None:
    """One of the wrong sign as well."""
    found = identify(day(0, 25_000.0))
    assert not found.success
    assert "what the setpoint has moved" in found.message
    assert found.best is not None
    assert found.best.process(0j).real > 0.0


def test_a_process_that_the_controller_of_the_record_would_drive_away_contradicts_it() -> None:
    record = day(0, 0.0)
    assert contradicts_law(record, Process.parse("-4e-6/((12s+1)(3s+1))*exp(-2s)")) == ""
    assert contradicts_law(record, Process.parse("-2e-6/((20s+1)(3s+1))*exp(-3s)")) == ""
    for wrong in ("4e-6/((12s+1)(3s+1))*exp(-2s)", "-8e-5/((12s+1)(3s+1))*exp(-2s)"):
        assert "would not hold this process" in contradicts_law(record, Process.parse(wrong))


def test_a_control_that_no_short_law_explains_says_nothing() -> None:
    wrong = Process.parse("4e-6/((12s+1)(3s+1))*exp(-2s)")
    record = day(0, 0.0, limits=12_000.0)
    assert contradicts_law(record, wrong) == ""
    by_hand = Record(record.time, np.round(record.control, -4), record.measurement, record.setpoint)
    assert contradicts_law(by_hand, wrong) == ""


@pytest.mark.parametrize("limits", [np.inf, 9e3])
@pytest.mark.parametrize("late", [0, 1, 3, 24])
def test_how_late_a_control_was_told_is_known_to_the_sample_or_not_at_all(late: int, limits: float) -> None:
    record = day(0, 0.0, limits=limits)
    assert np.ptp(record.control) <= 2.0 * limits
    told = np.append(np.full(late, record.control[0]), record.control[: record.control.size - late])
    known = lateness(replace(record, control=told))
    assert known == late * H or (known == 0.0 and np.isfinite(limits))


@pytest.mark.slow
@pytest.mark.parametrize("late", [1, 3, 24])
def test_a_control_that_was_told_late_counts_from_when_it_was_given(late: int) -> None:
    """With 12 s of lateness for 10 s of delay gains came that swung for ever."""
    record = day(0, 0.0)
    told = replace(record, control=np.append(np.full(late, record.control[0]), record.control[:-late]))
    assert lateness(record) == 0.0
    assert made_prompt(record) is record
    prompt = made_prompt(told)
    assert prompt.late == late * H
    assert np.array_equal(prompt.control, record.control[:-late])
    assert np.array_equal(prompt.measurement, record.measurement[:-late])
    found = tune_recorded(told, "frequency", template="soptd")
    assert found.success, found.message
    assert f"{late * H:g} s late by the law that explains it" in found.message
    assert found.identified.best is not None
    assert found.identified.best.process.delay == pytest.approx(DELAY * H, abs=0.6 * H)


@pytest.mark.parametrize(("share", "expected"), [(1.0, 1.0), (0.5, 2.0), (2.0, 0.5)])
def test_a_load_leaves_what_the_integral_says_beside_the_controller_that_ran(share: float, expected: float) -> None:
    """A load's error that does not swing adds up to 1/ki."""
    process = Process.parse("-4e-6/((12s+1)(3s+1))*exp(-2s)")
    others = verify(TuningRequest(process, sample_time=H), Fopid(kp=max(share, 1.0) * KP, ki=share * KI))
    assert beside_what_ran(day(0, 0.0), process, others) == pytest.approx(expected, rel=0.03)


@pytest.mark.parametrize("steps", [3e4, 3e3, 1e3, 300, 100, 30])
def test_signals_with_few_digits_are_compared_as_those_with_all_or_not_at_all(steps: float) -> None:
    """A law that is off by 0.6 % had a gain of 0.67 at rest, and what ran looked 13 times as bad as it was."""
    process = Process.parse("-4e-6/((12s+1)(3s+1))*exp(-2s)")
    record, others = day(0, 0.0), verify(TuningRequest(process, sample_time=H), Fopid(kp=KP, ki=0.5 * KI))
    for name in ("measurement", "control"):
        signal = getattr(record, name)
        step = np.ptp(signal) / steps
        found = beside_what_ran(replace(record, **{name: step * np.round(signal / step)}), process, others)
        assert found == pytest.approx(2.0, rel=0.05) or (np.isnan(found) and steps < 1e4)


def test_where_no_law_explains_the_control_nothing_is_said_of_it() -> None:
    process = Process.parse("-4e-6/((12s+1)(3s+1))*exp(-2s)")
    record = day(0, 0.0)
    by_hand = Record(record.time, np.round(record.control, -4), record.measurement, record.setpoint)
    others = verify(TuningRequest(process, sample_time=H), Fopid(kp=KP, ki=KI))
    assert np.isnan(beside_what_ran(by_hand, process, others))
