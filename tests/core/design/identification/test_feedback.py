"""A loop that nothing moves from outside shows its controller: it is refused, however its record was told."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from fopid_core.design.identification.feedback import moved_from_outside
from fopid_core.design.identification.identify import identify
from fopid_core.design.identification.initial_estimates import rough_fit
from fopid_core.design.identification.record import Record
from fopid_core.design.identification.response import InitialCondition
from fopid_core.model.fopid import Fopid
from fopid_core.study.replay import replay
from tests.cases import slow

from ....share import share_of
from .feedback_campaign import AT_REST, FAULTS, MOVED, error, made
from .recorded import closed_loop, open_loop

ANYHOW = InitialCondition(step=True)
ANSWERS = "the control only answers the measurement"


@pytest.fixture(scope="module")
def stepped() -> Record:
    """A step of the setpoint after 1 s, and what runs out after it."""
    return closed_loop("P1", lambda k: float(k >= 20), 901, 0.05, Fopid(0.5, 0.3))


def without(record: Record, first: int, last: int, lost: tuple[int, ...] = ()) -> Record:
    """A part of a record, by its samples, some of which were lost."""
    kept = np.setdiff1d(np.arange(first, last), [first + k for k in lost])
    return Record(record.time[kept], record.control[kept], record.measurement[kept])


@pytest.mark.parametrize("lost", [(), (17,), (9, 40), (30, 31, 32)])
@pytest.mark.parametrize("last", [861, 830, 600, 300])
def test_what_runs_out_is_refused_with_and_without_gaps(stepped: Record, last: int, lost: tuple[int, ...]) -> None:
    found = identify(without(stepped, last - 61, last, lost))
    assert not found.success
    assert ANSWERS in found.message


def test_a_control_before_the_first_sample_makes_no_step_of_what_runs_out(stepped: Record) -> None:
    tail = replace(without(stepped, 800, 861), control_before=float(stepped.control[799]))
    assert ANSWERS in identify(tail).message


@pytest.mark.slow
def test_the_step_itself_is_learnt_from_with_and_without_gaps(stepped: Record) -> None:
    for lost in ((), (5, 40, 41, 200, 300)):
        found = identify(without(stepped, 0, 861, lost))
        assert found.success, found.message
        assert found.best is not None
        w = 1j * np.geomspace(0.1, 1.0, 20)
        assert np.abs(found.best.process(w) * (w + 1.0) ** 3 - 1.0).max() < 0.05


# Those that were learnt from, and wrongly.
FALSE = [
    ("tail", "jitter", 3), ("tail", "quantised", 5), ("noisy_tail", "none", 8), ("noisy_tail", "every_third", 3),
    ("rest", "jitter", 2), ("load_step", "lost", 5), ("load_walk", "rounded", 4), ("load_sinusoid", "stale", 6),
    ("output_walk", "every_third", 7), ("output_step", "jitter", 9), ("load_walk", "limited", 6), ("rest", "early", 4),
]  # fmt: skip


@pytest.mark.parametrize(("kind", "fault", "seed"), FALSE)
def test_a_loop_that_nothing_moves_is_refused_however_it_was_recorded(kind: str, fault: str, seed: int) -> None:
    assert ANSWERS in identify(made(kind, fault, seed)[0]).message


TRUE = [
    ("setpoint", "jitter", 1), ("setpoint", "limited", 2), ("noisy_setpoint", "lost", 4), ("bump", "stale", 6),
    ("staircase", "quantised", 7), ("bump_at_once", "none", 10),
    *slow(("from_step", "none", 3), ("prbs", "every_third", 5), ("ramps", "rounded", 1), ("by_hand", "lost", 9)),
]  # fmt: skip


@pytest.mark.parametrize(("kind", "fault", "seed"), TRUE)
def test_what_was_moved_is_learnt_from_however_it_was_recorded(kind: str, fault: str, seed: int) -> None:
    record, process = made(kind, fault, seed)
    found = identify(record)
    assert found.success, found.message
    assert found.best is not None
    assert error(process, found.best) < 0.3


@pytest.mark.long
def test_most_of_all_records_are_told_apart() -> None:
    """Without those of a control told too early, which no law of the past explains; each fault on each kind.

    Of 240 records 7 were not, 3 %: the bound is two deviations beyond that.
    """
    seeds = range(20, 20 + share_of(2))
    wrong = {
        kinds: [
            (kind, fault, seed) for kind in kinds for fault in FAULTS for seed in seeds
            if fault != "early" and _moved(made(kind, fault, seed)[0]) == (kinds == AT_REST)
        ] for kinds in (AT_REST, MOVED)
    }  # fmt: skip
    for kinds, told_wrong in wrong.items():
        usual = 0.03 * len(kinds) * (len(FAULTS) - 1) * len(seeds)
        assert len(told_wrong) < usual + 2.0 * math.sqrt(usual), told_wrong


def _moved(record: Record) -> bool:
    return moved_from_outside(record, rough_fit(record, 256).response.start)


@pytest.mark.parametrize("control", [
    lambda t: 1.0 - np.exp(-t / 4.0), lambda t: np.sin(0.7 * t), lambda t: 0.1 * t, np.ones_like,
])  # fmt: skip
def test_a_control_that_moves_smoothly_by_hand_answers_nothing(control) -> None:  # type: ignore[no-untyped-def]
    record = open_loop("2/((3s+1)(s+1))", control(0.1 * np.arange(300)), 0.1)
    assert moved_from_outside(record, ANYHOW)
    noisy = replace(record, measurement=record.measurement + 0.01 * np.random.default_rng(0).standard_normal(300))
    assert moved_from_outside(noisy, ANYHOW)


def test_a_setpoint_that_is_known_to_move_moves_the_loop_though_it_moves_smoothly() -> None:
    record = closed_loop("2/(3s+1)", lambda k: float(np.sin(0.05 * k)), 400, 0.1)
    assert moved_from_outside(record, ANYHOW)
    assert not moved_from_outside(replace(record, setpoint=np.zeros(400)), ANYHOW)


def test_messages_of_one_signal_that_are_lost_move_nothing() -> None:
    """Of the measurement, or of the control, the last value stands in the record."""
    rng = np.random.default_rng(0)
    record = closed_loop("2/(3s+1)", lambda _: 0.0, 600, 0.1, noise=0.01)
    assert not moved_from_outside(record, ANYHOW)
    lost = np.flatnonzero(rng.uniform(size=600) < 0.03)[1:]
    for signal in ("control", "measurement"):
        told = getattr(record, signal).copy()
        for k in lost:
            told[k] = told[k - 1]
        assert not moved_from_outside(replace(record, **{signal: told}), ANYHOW)


@pytest.mark.slow
def test_a_day_without_a_move_is_not_replayed_where_samples_are_missing(stepped: Record) -> None:
    """The lines that are drawn over gaps answer nothing: the record as it came is asked."""
    day = made("noisy_tail", "lost", 38)[0]
    for record in (without(stepped, 300, 361), without(stepped, 300, 361, (9, 40)), day):
        found = replay(replace(record, setpoint=np.zeros(record.time.size)))
        assert not found.success
        assert not found.identified.success
        assert ANSWERS in found.message


@pytest.mark.parametrize("samples", [30, pytest.param(60, marks=pytest.mark.slow)])
@pytest.mark.parametrize("noise", [0.0, 0.05])
def test_steps_by_hand_are_moves_from_outside_in_short_records_too(samples: int, noise: float) -> None:
    """What comes a sample after such a step tells the step: that is no control which was told too early."""
    for seed in range(10):
        rng = np.random.default_rng(seed)
        time = np.arange(float(samples))
        control = np.sum([time >= at for at in rng.integers(2, samples - 5, 4)], axis=0).astype(float)
        pole = math.exp(-12.0 / samples)
        measurement = lfilter([0.0, 2.0 * (1.0 - pole)], [1.0, -pole], control) + noise * rng.standard_normal(samples)
        told = identify(Record(time, control, measurement), "foptd").message
        assert ANSWERS not in told, (seed, told)


@pytest.mark.parametrize(("over", "digits"), [(30, 17), (60, 8), (77, 5)])
def test_a_valve_that_is_driven_by_hand_in_ramps_is_moved_from_outside(over: int, digits: int) -> None:
    """Up and back between two values, which are then the smallest and the largest: that is no limit of a controller."""
    at, rng = np.arange(500.0), np.random.default_rng(over)
    control = 20.0 + 5.0 * (np.clip((at - 60.0) / over, 0.0, 1.0) - np.clip((at - 280.0) / over, 0.0, 1.0))
    moved = lfilter([0.0, 0.1], [1.0, -0.95], control - 20.0)
    record = Record(at, np.round(control, digits), 50.0 + moved + 0.01 * rng.standard_normal(at.size))
    assert moved_from_outside(record, ANYHOW)
    found = identify(record, "foptd")
    assert found.success, found.message
    assert found.best is not None
    assert found.best.parameters["K"] == pytest.approx(2.0, rel=0.01)
