"""What the tuner remembers of the running loop."""

from __future__ import annotations

import math

import numpy as np
import pytest

from fopid_core.errors import InputError
from fopid_ros.tuner.learning.history import History


def filled(kept: float = 100.0, samples: int = 50) -> History:
    history = History(kept)
    history.add("setpoint", 0.0, 1.0)
    for k in range(samples):
        history.add("measurement", 0.1 * k - 0.03, 10.0 + k)
        history.add("control", 0.1 * k, 20.0 + k)
    return history


def test_a_record_holds_what_the_controller_saw_at_each_tick() -> None:
    record = filled().record()
    assert np.allclose(record.time, 0.1 * np.arange(50))
    assert np.array_equal(record.measurement, 10.0 + np.arange(50))
    assert np.array_equal(record.control, 20.0 + np.arange(50))
    assert np.array_equal(record.setpoint, np.ones(50))


def test_a_measurement_with_the_stamp_of_the_control_belongs_to_it() -> None:
    history = History(100.0)
    for k in range(40):
        history.add("measurement", 0.1 * k, float(k))
        history.add("control", 0.1 * k, -float(k))
    record = history.record()
    assert np.array_equal(record.measurement, -record.control)


def test_only_the_newest_stretch_is_kept_and_asked_for() -> None:
    assert filled(kept=3.95).record().span == pytest.approx(4.0)  # and the one before, which still holds
    assert filled().record(since=0.95).span == pytest.approx(3.9)


def test_an_experiment_is_kept_whole_however_short_the_history_is() -> None:
    history = History(5.0)
    history.whole_since = 2.0
    for k in range(500):
        history.add("measurement", 0.1 * k, float(k))
        history.add("control", 0.1 * k, 0.0)
    assert history.record(2.0).span == pytest.approx(47.9)
    history.whole_since = math.inf
    history.add("measurement", 50.0, 0.0)
    history.add("control", 50.0, 0.0)
    assert history.record().span == pytest.approx(5.0, abs=0.15)


def test_a_record_that_was_too_long_to_keep_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fopid_ros.tuner.learning.history.MOST", 40)
    history = History(1e6)
    history.whole_since = 0.0
    for k in range(60):
        history.add("measurement", 0.1 * k, float(k))
        history.add("control", 0.1 * k, 0.0)
    with pytest.raises(InputError, match="experiment of more than 40 samples"):
        history.record(0.0)


def test_a_setpoint_that_does_not_change_is_never_forgotten() -> None:
    assert filled(kept=4.0, samples=500).record().setpoint is not None


def test_time_running_backwards_starts_the_history_anew() -> None:
    history = filled()
    for k in range(40):
        history.add("measurement", 1.0 + 0.1 * k, 0.0)
        history.add("control", 1.0 + 0.1 * k, 0.0)
    assert not history.record().measurement.any()


def test_two_controls_at_one_instant_count_as_the_newer() -> None:
    history = filled()
    history.add("control", 4.9, 99.0)
    assert history.record().control[-1] == 99.0
    assert history.record().time.size == 50


@pytest.mark.parametrize("silent", ["measurement", "control"])
def test_a_silent_signal_is_named(silent: str) -> None:
    history = History(10.0)
    other = {"measurement": "control", "control": "measurement"}[silent]
    for k in range(50):
        history.add(other, 0.1 * k, 0.0)
    with pytest.raises(InputError, match=f"{silent} has not been heard"):
        history.record()


def test_a_short_history_is_refused() -> None:
    with pytest.raises(InputError, match="record of 5 samples"):
        filled(samples=5).record()
    assert math.isnan(History(1.0).newest("control"))


def test_a_sample_that_comes_a_little_late_is_left_out_and_the_record_stays() -> None:
    """One late sample made an experiment's whole record go: the topic is best effort, and nothing orders it."""
    history = History(1000.0)
    for k in range(1000):
        history.add("measurement", 0.01 * k, float(k))
        history.add("control", 0.01 * k, 0.0)
    history.add("measurement", 9.985, -99.0)
    assert history.record().time.size == 1000
    assert history.newest("measurement") == 999.0


def test_a_loop_is_unmoved_since_the_last_move_also_where_its_gains_change_all_the_time() -> None:
    history = History(1000.0)
    for k in range(100):
        history.add("setpoint", float(k), 1.0 if k < 20 else 2.0)
        history.add("measurement", float(k), float(k))
        history.add("control", float(k), 0.0)
    assert history.unmoved_since == 20.0
    assert history.unmoved(1000).tolist() == list(range(20, 100))
    history.add("excitation", 30.0, 0.5)
    assert history.unmoved_since == 20.0, "nothing was added before the first"
    history.add("excitation", 40.0, 0.0)
    assert history.unmoved_since == 40.0
    history.changed = 99.0  # a schedule's do
    assert history.unmoved(5).tolist() == [95.0, 96.0, 97.0, 98.0, 99.0]
    assert history.unmoved(1000).tolist() == list(range(40, 100))


def test_what_other_gains_have_done_to_the_control_counts_as_moved_from_outside() -> None:
    history = filled()
    history.add("excitation", 1.0, 0.5)
    history.add("excitation", 2.0, 0.0)
    history.add("excitation", 4.1, 9.0)  # within the trial, and part of its control
    history.count_as_excitation(3.95, 4.85)
    added = history.record().excitation
    assert added is not None
    assert np.array_equal(added[:40], np.where((0.1 * np.arange(40) > 0.95) & (0.1 * np.arange(40) < 1.95), 0.5, 0.0))
    assert np.array_equal(added[40:], [*range(9), 0.0]), "from where it was, until others came"
    history.add("excitation", 4.9, 3.0)
    history.count_as_excitation(math.inf, math.inf)
    assert np.array_equal(history.record().excitation[48:], [8.0, 3.0]), "what comes later stays, and no trial is none"


def test_a_trial_of_which_nothing_was_heard_is_no_excitation() -> None:
    history = History(100.0)
    history.count_as_excitation(0.0, 1.0)
    history.add("measurement", 0.5, 1.0)
    history.count_as_excitation(0.0, 1.0)
    assert math.isnan(history.newest("excitation"))
