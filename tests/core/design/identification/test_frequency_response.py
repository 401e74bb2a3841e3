"""The frequency response without a model: its regions hold the truth, and where a record tells nothing they say so."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from fopid_core.design.identification.frequency_response import frequency_response
from fopid_core.design.identification.record import Record
from fopid_core.errors import InputError
from fopid_core.model.process import read_process

from .frequency_response_campaign import KINDS, Sample, judged, open_loop, prbs, record
from .recorded import BALL_GAIN, BALL_RUNAWAY, levitated_ball

H = 0.1
PROCESS = Sample([2.0], [1.0, 2.0, 1.0], 0.53, 3.0)
ERRORS = 0.02 * np.random.default_rng(0).standard_normal(600)
RECORD = open_loop(PROCESS, prbs(600, 60, 1), H, ERRORS)


@pytest.mark.parametrize("kind", KINDS[:-1])
def test_regions_hold_the_true_response_in_a_sample_of_the_campaign(kind: str) -> None:
    counts = np.zeros(3)
    for seed in range(8):
        signals, process = record(kind, "white", seed)
        counts += judged(frequency_response(signals), process)
    assert counts[1] > 0.3 * counts[0]
    assert counts[2] > 0.85 * counts[1]  # errors of near frequencies go together: a sample of 8 records scatters


def test_one_step_of_the_setpoint_among_few_samples_shows_no_controller_for_a_process() -> None:
    """Where feedback hides the process the response comes out near -1/C; regions by its slope alone were sure of it."""
    counts = np.zeros(3)
    for seed in range(60):
        signals, process = record("brief", "white", seed)
        counts += judged(frequency_response(signals), process)
    assert counts[1] > 0.1 * counts[0]
    assert counts[2] > 0.9 * counts[1]


def test_without_noise_the_response_is_the_textbooks() -> None:
    found = frequency_response(open_loop(PROCESS, prbs(600, 60, 1), H, 0.0 * ERRORS))
    assert found.known.all()
    assert found.response == pytest.approx(PROCESS.held(H, found.frequency), rel=1e-6)


def test_two_records_tell_more_than_one() -> None:
    other = open_loop(PROCESS, prbs(600, 60, 2), H, ERRORS[::-1])
    one, both = frequency_response(RECORD), frequency_response([RECORD, other])
    near = one.known & both.known
    assert np.median(both.radius[near] / one.radius[near]) < 0.85


def test_a_gap_ends_a_piece_and_the_operating_point_of_each_is_its_own() -> None:
    there = np.r_[0:250, 300:600]
    lifted = RECORD.measurement + 5.0 * (np.arange(600) >= 300)
    found = frequency_response(Record(RECORD.time[there], RECORD.control[there], lifted[there]))
    assert found.sample_time == pytest.approx(H)
    frequencies, known, inside = judged(found, PROCESS)
    assert known > 0.4 * frequencies
    assert inside >= known - 2


def test_a_long_record_of_a_control_full_of_its_own_noise_is_not_thinned_out() -> None:
    """A mean over several controls has answered measurements that a thinned record does not show: 30 % off."""
    found = frequency_response(levitated_ball(7000))
    w = found.frequency
    there = found.known & (w > 10.0) & (w < 100.0)
    true = BALL_GAIN / ((1j * w) ** 2 - BALL_RUNAWAY**2) * np.exp(-0.001j * w)  # behind the hold
    assert there.sum() >= 6
    assert np.median(np.abs(found.response / true - 1.0)[there]) < 0.1


@pytest.mark.parametrize(("kind", "seed"), [("setpoint", 5004), ("setpoint", 5005), ("autotune", 5000)])
def test_a_record_of_many_samples_is_as_right_as_one_of_few(kind: str, seed: int) -> None:
    """Of 20,000 samples, thinned out to half and looked at 300 back, the first showed -1/C: an error of 1.6."""
    signals, process = record(kind, "white", seed, 20)
    assert signals.time.size > 20_000
    found = frequency_response(signals)
    true = process.held(found.sample_time, found.frequency)
    assert found.known.sum() >= 5
    assert np.median(np.abs(found.response / true - 1.0)[found.known]) < 0.05
    assert judged(found, process)[2] >= found.known.sum() - 1


def test_a_control_that_never_moves_tells_nothing() -> None:
    found = frequency_response(replace(RECORD, control=np.zeros(600)))
    assert not found.known.any()
    assert "moves too little" in found.reason


def test_a_single_frequency_tells_nothing_of_the_others() -> None:
    found = frequency_response(open_loop(PROCESS, np.sin(H * np.arange(600)), H, ERRORS))
    assert not found.known.any()
    assert "follow from each other" in found.reason


def test_a_control_that_only_answers_the_measurement_tells_nothing() -> None:
    answer = -0.3 * RECORD.measurement - 0.05 * np.cumsum(RECORD.measurement)
    found = frequency_response(replace(RECORD, control=answer))
    assert not found.known.any()
    assert found.reason == "the control only answers the measurement"


def test_a_long_record_in_many_pieces_is_no_more_work_than_a_short_one() -> None:
    """One sample in a hundred is lost: an offset and a ramp for each piece as columns would take 3 GB."""
    rng = np.random.default_rng(0)
    control = prbs(100_000, 2000, 1)
    measured = lfilter([0.0, 0.02], [1.0, -0.98], control) + 0.05 * rng.standard_normal(control.size)
    kept = rng.uniform(size=control.size) > 0.01
    found = frequency_response(Record(np.flatnonzero(kept).astype(float), control[kept], measured[kept]))
    true = 0.02 / (np.exp(1j * found.frequency) - 0.98)
    assert found.sample_time == 1.0
    assert found.known.sum() > 8
    assert (np.abs(true - found.response) <= found.radius)[found.known].mean() > 0.85


def test_uneven_samples_tell_nothing() -> None:
    time = np.sort(np.random.default_rng(0).uniform(0.0, 60.0, 600))
    assert not frequency_response(replace(RECORD, time=time)).known.any()


def test_records_of_different_sample_times_are_refused() -> None:
    with pytest.raises(InputError, match=r"sample times 0\.1 to 0\.2 s"):
        frequency_response([RECORD, replace(RECORD, time=2.0 * RECORD.time)])


def test_the_true_process_stays_inside_and_another_does_not() -> None:
    found = frequency_response(RECORD)
    assert found.outside(read_process(PROCESS.text)).sum() <= 0.2 * found.known.sum()
    assert found.outside(read_process("2/(3s+1)"), 0.05).sum() > 0.5 * found.known.sum()
    assert not found.outside(read_process("2/(3s+1)"))[~found.known].any()
