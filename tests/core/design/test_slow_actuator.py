"""How slow an actuator may be, from records made by small explicit steps that share no code with what is tested."""

from __future__ import annotations

import math

import numpy as np
import pytest

from fopid_core.design.identification.record import Record
from fopid_core.design.slow_actuator import LargeMoves, slewed, slowest_rate
from fopid_core.model.fopid import Fopid
from fopid_core.model.loop import Loop
from fopid_core.model.process import Process

PROCESS = "1/((7s+1)(0.3s+1))"
EVERY, FINE = 0.1, 0.001


def record(rate: float, noise: float, moved: float = 10.0) -> Record:
    """A step of the control there and back, felt through an actuator of limited rate."""
    time = np.arange(0.0, 20.0, EVERY)
    control = np.where((time >= 2.0) & (time < 10.0), moved, 0.0)
    at = first = second = 0.0
    measurement = []
    for wanted in control:
        measurement.append(second)
        for _ in range(round(EVERY / FINE)):
            at += float(np.clip(wanted - at, -rate * FINE, rate * FINE))
            first += FINE * (at - first) / 7.0
            second += FINE * (first - second) / 0.3
    noises = noise * np.random.default_rng(1).standard_normal(time.size)
    return Record(time, control, np.array(measurement) + noises)


@pytest.mark.parametrize("noise", [0.005, 0.05])
@pytest.mark.parametrize("rate", [3.0, 7.0, 20.0])
def test_the_rate_that_an_actuator_has_is_not_excluded_and_much_slower_ones_are(rate: float, noise: float) -> None:
    found = slowest_rate(record(rate, noise), Process.parse(PROCESS))
    assert 0.3 * rate < found < 1.2 * rate


@pytest.mark.parametrize(("rate", "moved", "noise"), [(1e9, 10.0, 0.005), (1e9, 10.0, 0.5), (7.0, 0.3, 0.05)])
def test_nothing_speaks_for_one_that_jumps_nor_do_small_moves_in_noise(rate: float, moved: float, noise: float) -> None:
    assert slowest_rate(record(rate, noise, moved), Process.parse(PROCESS)) == math.inf


def test_where_even_the_slowest_would_do_the_model_lacks_something_else() -> None:
    """A furnace was taken for one whose actuator takes ten minutes, and was left with gains that hardly act."""
    assert slowest_rate(record(0.9, 0.005), Process.parse(PROCESS)) == math.inf


@pytest.mark.parametrize("process", ["1/(s-1)", "1/(0.02s-1)"])
def test_of_a_process_that_runs_away_nothing_is_known(process: str) -> None:
    """Its response over the record, without the loop, has left all numbers."""
    assert slowest_rate(record(7.0, 0.005), Process.parse(process)) == math.inf


def test_a_delay_learnt_too_long_leaves_what_the_actuator_does() -> None:
    """In the small moves of an experiment a slow actuator looks like a delay."""
    assert 2.0 < slowest_rate(record(7.0, 0.005), Process.parse(f"{PROCESS}*exp(-0.4s)")) < 8.4


def test_an_actuator_gets_there_in_its_time() -> None:
    assert slewed(np.array([1.0, 4.0, 4.0, -9.0]), 2.0).tolist() == [1.0, 3.0, 4.0, 2.0]


@pytest.mark.parametrize(("rate", "swings"), [(7.0, True), (1e4, False)])
def test_gains_are_refused_where_the_actuator_would_make_them_swing_and_not_where_it_is_fast(
    rate: float, swings: bool
) -> None:
    """Found by autotuning with small moves: swung from limit to limit at 7 and at 20 per second."""
    process = Process.parse(PROCESS)
    moves = LargeMoves(process, EVERY, -50.0, 50.0, rate, Loop(process, Fopid(kp=4.0, ki=0.6)))
    refusal = moves.refusal(Loop(process, Fopid(kp=17.2, ki=14.8, kd=1.6)))
    assert bool(refusal) == swings
    assert ("takes 1.4 s for a tenth of the range a setpoint step" in refusal) == swings


def test_gains_under_which_the_loop_runs_away_are_refused() -> None:
    process = Process.parse("1/(s-1)")
    moves = LargeMoves(process, 0.01, -1e9, 1e9, 1e12, Loop(process, Fopid(kp=4.0, ki=1.0)))
    assert "times the error" in moves.refusal(Loop(process, Fopid(kp=0.5, ki=0.1)))
