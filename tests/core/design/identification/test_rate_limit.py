"""How fast an actuator moves, from records made by small explicit steps that share no code with what is tested."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.signal import lfilter

from fopid_core.design.flaw_trial import FlawTrial
from fopid_core.design.identification.flaws import Flaws, slewed
from fopid_core.design.identification.identify import behind_slow_actuator, identify
from fopid_core.design.identification.rate_limit import rate_limit_of
from fopid_core.design.identification.record import Record
from fopid_core.model.fopid import Fopid
from fopid_core.model.loop import Loop
from fopid_core.model.process import Process
from tests.cases import slow

PROCESS = "1/((7s+1)(0.3s+1))"
EVERY, FINE = 0.1, 0.001
RUNNING = Fopid(kp=4.0, ki=0.6)


def record(rate: float, noise: float, moved: float = 10.0, play: float = 0.0, kp: float = 0.0) -> Record:
    """Small moves of the control, and a large one there and back, felt through an actuator of limited rate, or play.

    With ``kp`` in a closed loop, where the sensor's noise moves the actuator as well.
    """
    time = np.arange(0.0, 60.0, EVERY)
    small = 0.1 * moved * np.sign(np.sin(2.0 * np.pi * time / 9.0)) * (time >= 2.0) * (time < 30.0)
    wanted = small + moved * ((time >= 35.0) & (time < 45.0))
    return answered(time, wanted, rate, noise, play, kp)


def answered(
    time: np.ndarray, wanted: np.ndarray, rate: float, noise: float, play: float = 0.0, kp: float = 0.0,
    pocket: float = 0.3,
) -> Record:  # fmt: skip
    """What lags of 7 s and of a pocket make of a control, less ``kp`` times the measurement."""
    noises = noise * np.random.default_rng(1).standard_normal(time.size)
    at = stem = first = second = 0.0
    control, measurement = [], []
    for asked, heard in zip(wanted, noises, strict=True):
        measurement.append(second + heard)
        control.append(asked - kp * measurement[-1])
        for _ in range(round(EVERY / FINE)):
            at += min(max(control[-1] - at, -rate * FINE), rate * FINE)
            stem = min(max(stem, at - play), at + play)
            first += FINE * (stem - first) / 7.0
            second += FINE * (first - second) / pocket
    return Record(time, np.array(control), np.array(measurement))


@pytest.mark.slow
@pytest.mark.parametrize("noise", [0.005, 0.05])
@pytest.mark.parametrize("rate", [3.0, 7.0, 20.0])
def test_the_rate_of_a_slow_actuator_is_learnt_with_the_process_behind_it(rate: float, noise: float) -> None:
    made = record(rate, noise)
    slow = behind_slow_actuator(made, identify(made))
    assert slow is not None
    assert slow.best is not None
    assert slow.flaws.rate == pytest.approx(rate, rel=0.25 if noise > 0.01 and rate > 7.0 else 0.1)
    w = 0.5j
    assert abs(slow.best.process(w) / Process.parse(PROCESS)(w) - 1.0) < 0.05
    assert f"the actuator may be as slow as {slow.flaws.rate:.3g} a second" in slow.message


@pytest.mark.slow
def test_so_it_is_in_a_loop_whose_noise_alone_keeps_the_actuator_behind() -> None:
    """Of 0.2 of noise the control has four times as much; learnt as if it were quick the lag is 12 s, for 7."""
    made = record(3.0, 0.2, kp=4.0)
    slow = behind_slow_actuator(made, identify(made))
    assert slow is not None
    assert slow.best is not None
    assert 0.7 * 3.0 < slow.flaws.rate < 1.15 * 3.0  # the slowest that is as likely
    assert slow.best.parameters["T"] == pytest.approx(7.3, rel=0.15)


@pytest.mark.parametrize("rate", [*slow(13.0, 17.0), 20.0, *slow(24.0)])
def test_pulses_show_it_sharply_and_it_is_not_stepped_over(rate: float) -> None:
    """39.5 was "as slow as may be" for 20: limits a sixth off explained less than none, and no nearer was tried."""
    time = np.arange(0.0, 80.0, EVERY)
    wanted = np.sign(np.sin(2.0 * np.pi * time / 9.0)) * (time >= 2.0) * (time < 40.0)
    wanted = wanted + 10.0 * ((time > 45.0) & (time % 8.0 < 0.55))
    made = answered(time, wanted, rate, 0.005, pocket=1.5)
    calm = Record(time[:400], wanted[:400], made.measurement[:400])
    slow = behind_slow_actuator(made, identify(calm), possible=True)
    assert slow is not None
    assert slow.flaws.rate == pytest.approx(rate, rel=0.1)


@pytest.mark.parametrize(("rate", "moved", "noise"), [(1e9, 10.0, 0.005), (1e9, 10.0, 0.5), (7.0, 0.3, 0.05)])
def test_nothing_speaks_for_one_where_it_jumps_nor_do_small_moves_in_noise(
    rate: float, moved: float, noise: float
) -> None:
    made = record(rate, noise, moved)
    assert behind_slow_actuator(made, identify(made)) is None


@pytest.mark.slow
@pytest.mark.parametrize("rate", [math.inf, 60.0])
def test_short_pulses_count_beside_what_moves_a_long_record_far_more(rate: float) -> None:
    """A disturbance of 0.1 that wanders, where noise is 0.003 and pulses show by 0.06: errors alone hardly differ."""
    time = np.arange(0.0, 120.0, EVERY)
    wanted = np.sign(np.sin(2.0 * np.pi * time / 9.0)) * (time >= 2.0) * (time < 80.0)
    for start in range(85, 115, 5):
        wanted += 20.0 * ((time >= start) & (time < start + 2.0 * EVERY))
    made = answered(time, wanted, min(rate, 1e6), 0.003)
    wandering = lfilter([0.05 * math.sqrt(EVERY)], [1.0, -0.995], np.random.default_rng(2).standard_normal(time.size))
    made = Record(made.time, made.control, made.measurement + wandering)
    best = identify(made).best
    assert best is not None
    assert best.noise > 5.0 * 0.003
    slow = rate_limit_of(made, best, 0.0)
    if math.isinf(rate):
        assert slow is None or slow.rate > 100.0
    else:
        assert slow is not None
        assert slow.rate < 1.3 * rate  # never told to be quicker than it is


@pytest.mark.slow
def test_play_is_not_taken_for_a_slow_actuator() -> None:
    made = record(1e9, 0.005, play=0.3)
    learnt = identify(made)
    assert learnt.flaws.dead_band == pytest.approx(0.3, rel=0.1)
    assert behind_slow_actuator(made, learnt) is None


@pytest.mark.long
def test_where_there_are_both_both_are_learnt() -> None:
    made = record(5.0, 0.005, play=0.3)
    slow = behind_slow_actuator(made, identify(made))
    assert slow is not None
    assert slow.flaws.rate == pytest.approx(5.0, rel=0.2)
    assert slow.flaws.dead_band == pytest.approx(0.3, rel=0.2)


@pytest.mark.slow
def test_what_was_learnt_behind_a_limit_is_looked_at_without_it_when_there_is_more_to_hear() -> None:
    """The limit was applied twice, so that a second look found none."""
    made = record(7.0, 0.005)
    once = behind_slow_actuator(made, identify(made))
    assert once is not None
    twice = behind_slow_actuator(made, once)
    assert twice is not None
    assert twice.flaws.rate == pytest.approx(once.flaws.rate, rel=0.1)


@pytest.mark.slow
def test_a_control_that_never_moved_says_nothing() -> None:
    made = record(7.0, 0.005)
    best = identify(made).best
    assert best is not None
    still = Record(made.time, np.zeros(made.time.size), made.measurement)
    assert rate_limit_of(still, best) is None


def test_an_actuator_gets_there_in_its_time() -> None:
    time = np.array([0.0, 1.0, 2.0, 4.0, 5.0])
    felt = slewed(time, np.array([1.0, 4.0, 4.0, -9.0, -9.0]), np.array([2.0, math.inf]))
    # from 1 to 3, to 4 by 2.5, down to 2, down to 0
    assert felt[0].tolist() == [1.0, 2.0, 3.875, 3.0, 1.0]
    assert felt[1].tolist() == [1.0, 4.0, 4.0, -9.0, -9.0]


@pytest.mark.parametrize(("rate", "swings"), [(7.0, True), (1e4, False)])
def test_gains_are_refused_where_the_actuator_would_make_them_swing_and_not_where_it_is_fast(
    rate: float, swings: bool
) -> None:
    """Found by autotuning with small moves: swung from limit to limit at 7 and at 20 per second."""
    process = Process.parse(PROCESS)
    trial = FlawTrial(process, Flaws(rate=rate), EVERY, 0.0, Loop(process, RUNNING), (-50.0, 50.0))
    refusal = trial.refusal(Loop(process, Fopid(kp=17.2, ki=14.8, kd=1.6)))
    assert bool(refusal) == swings
    assert ("the actuator may be as slow as 7 a second: after a setpoint step of" in refusal) == swings


def test_without_limits_of_the_control_nothing_says_how_large_moves_may_be() -> None:
    process = Process.parse(PROCESS)
    trial = FlawTrial(process, Flaws(rate=7.0), EVERY, 0.0, Loop(process, RUNNING))
    assert trial.refusal(Loop(process, Fopid(kp=17.2, ki=14.8, kd=1.6))) == ""


def test_gains_under_which_the_loop_runs_away_are_refused() -> None:
    process = Process.parse("1/(s-1)")
    trial = FlawTrial(process, Flaws(rate=1e12), 0.01, 0.0, Loop(process, Fopid(kp=4.0, ki=1.0)), (-1e9, 1e9))
    assert "times the error" in trial.refusal(Loop(process, Fopid(kp=0.5, ki=0.1)))


@pytest.mark.slow
def test_they_are_also_where_what_runs_would_run_away_too() -> None:
    process = Process.parse("1/(s-1)")
    trial = FlawTrial(process, Flaws(rate=1e12), 0.01, 0.0, Loop(process, Fopid(kp=0.4, ki=0.1)), (-1e9, 1e9))
    assert "the loop runs away" in trial.refusal(Loop(process, Fopid(kp=0.5, ki=0.1)))
