"""A day lived again with other gains, against the same day simulated with them on the true process."""

from __future__ import annotations

from dataclasses import replace as with_other

import numpy as np
import pytest

from fopid_core.design.identification.record import Record
from fopid_core.errors import InputError
from fopid_core.model.fopid import Fopid
from fopid_core.model.process import Process
from fopid_core.runtime.controller import ControllerSettings, FopidController
from fopid_core.runtime.plant import Plant, PlantSettings
from fopid_core.study.replay import MOST_SAMPLES, evenly, figures, replay
from fopid_core.study.replayed_loop import grown_steps, simulated

from ..design.identification.recorded import closed_loop
from .days import PROCESS, H, day
from .replay_campaign import SAMPLES, Foreign, without

RAN = Fopid(0.4, 0.4)


def test_on_the_true_process_it_is_the_other_day_to_the_digits_of_the_machine() -> None:
    wanted = Fopid(0.9, 0.9, 0.05, 0.95, 0.9)
    ran = day(RAN, noise=0.0)
    grown = grown_steps(ran, [Process.parse(PROCESS)])
    measurement, control = simulated(ran, grown, ControllerSettings(wanted, H))
    other = day(wanted, noise=0.0)
    assert np.abs(measurement[0] - other.measurement).max() < 1e-9
    assert np.abs(control[0] - other.control).max() < 1e-9


def test_limits_of_the_control_are_those_of_the_other_day() -> None:
    wanted, limits = Fopid(1.2, 1.0), {"control_max": 0.6, "control_rate_max": 3.0}
    ran = day(RAN, noise=0.0)
    grown = grown_steps(ran, [Process.parse(PROCESS)])
    measurement, _ = simulated(ran, grown, ControllerSettings(wanted, H, **limits))
    assert np.abs(measurement[0] - day(wanted, noise=0.0, **limits).measurement).max() < 1e-9


@pytest.mark.slow
@pytest.mark.parametrize(("measured", "driven"), [(1e5, 1e5), (1.0, 1e-6), (1e3, 0.01)])
def test_units_change_nothing(measured: float, driven: float) -> None:
    record, share = day(RAN), driven / measured
    assert record.setpoint is not None
    other = with_other(
        record, measurement=measured * record.measurement, setpoint=measured * record.setpoint,
        control=driven * record.control,
    )  # fmt: skip
    found = replay(record, ControllerSettings(Fopid(0.9, 0.8)))
    scaled = replay(other, ControllerSettings(Fopid(0.9 * share, 0.8 * share)))
    assert scaled.success, scaled.message
    assert found.measurement is not None
    assert scaled.measurement is not None
    for signal in ("low", "expected", "high"):
        wanted = getattr(found.measurement, signal)
        # Where rounding falls otherwise a few of the draws are others.
        assert np.abs(getattr(scaled.measurement, signal) / measured - wanted).max() < 0.02 * np.abs(wanted).max()


@pytest.mark.slow
def test_the_bands_hold_the_other_day_and_the_same_gains_give_the_day_itself() -> None:
    wanted, record = Fopid(0.9, 0.8), day(RAN)
    found, other = replay(record, ControllerSettings(wanted)), day(wanted)
    assert found.success, found.message
    assert found.measurement is not None
    assert found.after is not None
    inside = (other.measurement >= found.measurement.low - 1e-9) & (other.measurement <= found.measurement.high + 1e-9)
    assert inside.mean() > 0.8  # the load is no part of the model, and the bands know of it by the residual alone
    truth = figures(other.time, other.setpoint, other.measurement, other.control)
    assert found.after.iae == pytest.approx(truth.iae, rel=0.05)
    assert found.after.iae < found.before.iae
    again = replay(record, ControllerSettings(RAN))
    assert again.measurement is not None
    # What the integral made of the errors before the first control is not in the record.
    assert np.abs(again.measurement.expected - record.measurement).max() < 1e-3


def read_in_steps(gains: Fopid, step: float) -> Record:
    """A day with a sensor that reads in steps, simulated in plain numbers: a lag and a delay of three ticks."""
    lag, waiting, integral, rows = 0.0, [0.0] * 3, 0.0, []
    for k in range(400):
        setpoint = float(k // 50 % 2) * (1.0 + 0.1 * (k // 100))
        seen = step * round(lag / step)
        integral += gains.ki * H * (setpoint - seen)
        control = gains.kp * (setpoint - seen) + integral
        rows.append((H * k, control, seen, setpoint))
        waiting.append(control + 0.02 * (k > 300))
        lag += -np.expm1(-H) * (2.0 * waiting.pop(0) - lag)
    return Record(*np.array(rows).T)


@pytest.mark.slow
@pytest.mark.parametrize("step", [0.05, 0.2])
def test_a_sensor_that_reads_in_steps_reads_so_with_other_gains_too(step: float) -> None:
    """Its bands were a twentieth of a step wide, and held a fifth of the instants."""
    wanted = Fopid(0.5, 0.5)
    found, other = replay(read_in_steps(RAN, step), ControllerSettings(wanted)), read_in_steps(wanted, step)
    assert found.success, found.message
    assert found.measurement is not None
    band = found.measurement
    inside = (other.measurement >= band.low - 1e-9) & (other.measurement <= band.high + 1e-9)
    assert inside.mean() > 0.9


@pytest.mark.slow
def test_a_limit_that_the_record_never_met_is_in_the_bands_unless_limits_are_given() -> None:
    wanted, record = Fopid(1.0, 0.8), day(RAN)
    highest, reach = float(record.control.max()), float(np.ptp(record.control))
    truth = _measured_with_limit(wanted, highest + 0.05 * reach)
    shares = []
    for limits in ({}, {"control_min": -100.0 * reach, "control_max": 100.0 * reach}):
        found = replay(record, ControllerSettings(wanted, **limits))
        assert found.beyond > 0.2
        assert found.measurement is not None
        shares.append(np.mean((truth >= found.measurement.low - 1e-9) & (truth <= found.measurement.high + 1e-9)))
    assert shares[0] > shares[1] + 0.3


def _measured_with_limit(gains: Fopid, most: float) -> np.ndarray:
    """The same day where the actuator gives no more than this, which the controller does not know."""
    controller, seen = FopidController(ControllerSettings(gains, H)), []
    plant = Plant(PlantSettings(Process.parse(PROCESS), H, delay_model="exact", noise_std=0.005, seed=4))
    for k in range(400):
        seen.append(plant.measurement)
        control = controller.step(float(k // 50 % 2) * (1.0 + 0.1 * (k // 100)), seen[-1])
        plant.step(min(control, most), 0.02 * (k > 300))
    return np.array(seen)


@pytest.mark.slow
def test_gains_that_the_process_may_not_bear_are_refused_and_some_that_it_bears_are_found() -> None:
    record = day(RAN)
    bold = replay(record, ControllerSettings(Fopid(5.0, 9.0)))
    assert not bold.success
    assert "unstable on" in bold.message
    assert bold.after is None
    own = replay(record)
    assert own.success, own.message
    for said in ("from the record: sample time 0.1 s", "noise may move the control by"):
        assert said in own.message
    assert own.after is not None
    assert own.gains is not None
    assert figures(*_signals(day(own.gains))).iae < figures(*_signals(record)).iae


@pytest.mark.slow
def test_where_the_model_contradicts_the_record_that_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    """It was said of gains that were refused, and of none that were not."""
    doubt = "the model leaves what the record shows without one at 4 of 12 frequencies"
    monkeypatch.setattr("fopid_core.study.replay.held_to_record", lambda *_: (doubt, lambda *_: ""))
    found = replay(day(RAN), ControllerSettings(RAN))
    assert found.success, found.message
    assert found.message.count(doubt) == 1


def test_a_record_that_does_not_show_the_process_is_refused_with_the_reason() -> None:
    still = day(RAN)
    still = with_other(still, control=np.full(400, 0.5), control_before=0.5)
    found = replay(still, ControllerSettings(RAN))
    assert not found.success
    assert "the control stays at 0.5" in found.message


@pytest.mark.slow
@pytest.mark.parametrize(("gains", "worse"), [(Fopid(0.1, 0.1), True), (Fopid(0.9, 0.8), False)])
def test_gains_that_would_have_made_the_day_worse_are_said_to(gains: Fopid, worse: bool) -> None:
    found = replay(day(RAN), ControllerSettings(gains))
    assert found.success, found.message
    assert ("on this day they leave more error than what ran" in found.message) == worse


def test_without_a_setpoint_or_with_too_many_samples_it_says_so() -> None:
    record = day(RAN)
    with pytest.raises(InputError, match="record without a setpoint"):
        replay(with_other(record, setpoint=None))
    long = np.arange(MOST_SAMPLES + 1.0)
    with pytest.raises(InputError, match="allowed: 8000 to replay"):
        evenly(with_other(record, time=long, control=long, measurement=long, setpoint=long))


def test_uneven_instants_become_even_ones_with_held_controls_and_lines_of_measurement() -> None:
    time = np.arange(40.0)
    time[7] += 0.5
    record = day(RAN).part(0.0, 3.95)
    even = evenly(with_other(record, time=time, control=time, measurement=2.0 * time))
    assert even.is_regular
    assert even.control[7] == 6.0
    assert even.measurement == pytest.approx(2.0 * np.arange(40.0))


def _signals(record) -> tuple:
    return record.time, record.setpoint, record.measurement, record.control


@pytest.mark.slow
@pytest.mark.parametrize("seed", [8, 24])
def test_samples_that_are_lost_widen_the_bands_and_leave_the_ticks_where_they_are(seed: int) -> None:
    plant = Foreign(seed)
    whole = plant.run(plant.running, SAMPLES)
    other = plant.run(plant.wanted, SAMPLES, float(whole.control[0]))
    record = without(whole, 0.03, seed)
    there = np.isin(whole.time, record.time)
    assert evenly(record).time == pytest.approx(whole.time)
    assert evenly(record).control[there] == pytest.approx(whole.control[there])
    found = replay(record, ControllerSettings(plant.wanted), seed=seed)
    assert found.measurement is not None, found.message
    inside = (found.measurement.low <= other.measurement) & (other.measurement <= found.measurement.high)
    assert np.mean(inside[there]) > 0.9
    truth = figures(*_signals(other))
    assert found.after_low.iae <= truth.iae <= found.after_high.iae


@pytest.mark.slow
@pytest.mark.timeout(120)
def test_where_a_process_that_hardly_damps_is_found_others_about_it_are_drawn() -> None:
    """None was within what was looked for, and so it went on drawing for ever."""
    plant = Foreign(8871)
    found = replay(plant.run(plant.running, SAMPLES), ControllerSettings(plant.wanted), seed=8871)
    assert found.message


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1])
def test_a_day_with_a_load_as_large_as_its_steps_is_lived_again(seed: int) -> None:
    """A process alone explains half of it: it was refused, with a word on sensors that stick."""

    def lived(gains: Fopid) -> Record:
        steps = (lambda k: 3.0 * ((k >= 60) - 1.5 * (k >= 210) + (k >= 480))), (lambda k: 1.0 * (k >= 330))
        return closed_loop("0.05/s*exp(-4s)", steps[0], 600, 1.0, gains, 0.05, seed, steps[1])

    ran, wanted = lived(Fopid(1.5, 0.02)), lived(Fopid(3.0, 0.04))
    found = replay(ran, ControllerSettings(Fopid(3.0, 0.04)))
    assert found.success, found.message
    assert found.measurement is not None
    assert np.abs(found.measurement.expected - wanted.measurement).max() < 0.1
