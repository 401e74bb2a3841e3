"""No response and no index is wrong by more than it says, on random loops of all kinds.

``FOPID_LOOPS=10000 python -m pytest -m slow tests/core/model/test_honest_accuracy.py`` runs the whole campaign.
"""

from __future__ import annotations

import math
import os
import time
from dataclasses import astuple

import mpmath as mp
import numpy as np
import pytest

from fopid_core.errors import InputError, UnknownResponseError
from fopid_core.model.evaluation import evaluate
from fopid_core.model.fopid import Fopid, read_gains
from fopid_core.model.loop import Loop
from fopid_core.model.process import Process, read_process
from fopid_core.model.response import Response, step_response
from fopid_core.model.response_indices import response_indices

from .random_loops import Generator, RandomLoop
from .response_oracles import Signal, Source, polyval, rational_indices, roots, signal_in_time

LOOPS = int(os.environ.get("FOPID_LOOPS", "300"))
BLOCK = 30
FEW = 11
LONGEST = 10.0  # seconds of processor for one response
AT_A_JUMP = 1e-6
ROUNDING = 1e-15


def check(case: RandomLoop, random: np.random.Generator) -> None:
    source: Source = "load" if case.kind != "delayed resonant" and random.random() < 0.4 else "setpoint"
    signal: Signal = "control" if random.random() < 0.4 else "error"
    points = None if random.random() < 0.6 else int(random.integers(2, 2000))
    began = time.process_time()
    try:
        response = step_response(case.loop, case.horizon, source, points)
    except UnknownResponseError as refusal:
        assert "allowed" in str(refusal)  # noqa: PT017
        return
    finally:
        assert time.process_time() - began < LONGEST, str(case)
    check_signal(case, response, source, signal, random)
    if source == "setpoint" and points is None and not case.delay:
        check_indices(case, response)


def check_signal(
    case: RandomLoop, response: Response, source: Source, signal: Signal, random: np.random.Generator
) -> None:
    exact = signal_in_time(case, source, signal)
    if exact is None:
        return
    values, claimed = response.error, response.accuracy
    if signal == "control":
        values, claimed = response.control, response.control_accuracy
    sizes = np.abs(response.output if signal == "error" else response.control)
    early = int(np.searchsorted(response.time, case.horizon * math.exp(-random.uniform(0.0, 8.0))))
    last = response.time.size - 1
    for i in {*random.integers(1, last + 1, 2).tolist(), min(max(early, 1), last), last}:
        instant = float(response.time[i])
        if case.delay and abs(instant / float(case.delay) - round(instant / float(case.delay))) < AT_A_JUMP:
            continue
        reached = max(1.0, float(np.max(sizes[: i + 1], where=np.isfinite(sizes[: i + 1]), initial=0.0)))
        missed = abs(float(exact(instant) - mp.mpf(float(values[i]))))
        assert missed <= claimed * reached, f"{case}, {source}, {signal} at {instant!r}: off by {missed:.3g}"
        if signal == "error":
            assert missed <= max(response.uncertainty[i], ROUNDING * reached), f"{case}, {source} at {instant!r}"


def check_indices(case: RandomLoop, response: Response) -> None:
    found, accuracy = response_indices(response.time, response.error, response.uncertainty)
    for name, exact in (rational_indices(case) or {}).items():
        value, claimed = getattr(found, name), getattr(accuracy, name)
        assert math.isnan(value) or abs(value - exact) <= claimed, f"{case}: {name} {value!r}, exact {exact!r}"


def check_block(seed: int, first: int, count: int) -> None:
    for number, case in enumerate(Generator(seed).loops(first + count)):
        if number >= first:
            check(case, np.random.default_rng([seed, number]))


def test_a_few_random_loops_of_each_kind_are_as_exact_as_they_say() -> None:
    check_block(7, 0, FEW)


@pytest.mark.slow
@pytest.mark.timeout(1200)
@pytest.mark.parametrize("block", range(math.ceil(LOOPS / BLOCK)))
def test_no_random_loop_is_less_exact_than_it_says(block: int) -> None:
    check_block(1000 + block, 0, min(BLOCK, LOOPS - block * BLOCK))


@pytest.mark.parametrize(
    ("text", "gains", "horizon"),
    [
        ("9/(s^2+0.0006s+9)", "0.5,0.0001,0,1,1", 30000.0),
        ("1/(s^2+0.002s+1)", "0.5,0.001,0,1,1", 1e4),
        ("1/(s^2+0.02s+1)", "0.5,0.001,0,1,1", 1000.0),
    ],
)
def test_a_resonance_is_not_missed_however_long_the_horizon(text: str, gains: str, horizon: float) -> None:
    # residues in 50 digits
    loop = Loop(read_process(text), read_gains(gains))
    response = step_response(loop, horizon, points=1001)
    with mp.workdps(50):
        numerator = [mp.mpf(repr(c)) for c in loop.process.denominator.coefficients().tolist()]
        kp, ki = (mp.mpf(repr(gain)) for gain in loop.controller.gains[:2])
        gain = numerator[2] if text.startswith("9") else mp.mpf(1)
        closed = [numerator[0], numerator[1], numerator[2] + gain * kp, gain * ki]
        poles = roots(closed)
        for i in (1, 37, 500, 1000):
            t = mp.mpf(float(response.time[i]))
            exact = mp.re(
                sum(
                    polyval(numerator, p) / polyval([3 * closed[0], 2 * closed[1], closed[2]], p) * mp.exp(p * t)
                    for p in poles
                )
            )
            assert abs(float(exact - mp.mpf(float(response.error[i])))) <= response.accuracy <= 1e-9


def test_late_weighted_indices_do_not_drown() -> None:
    # L = (1001 s + 1) (5 s + 1) / ((1000 s + 1) (s + 1) s)
    case = RandomLoop("late", ({1: 1001, 0: 1},), ({1: 1000, 0: 1}, {1: 1, 0: 1}), 0, (5, 1, 0, 1, 1), 5000.0)  # type: ignore[arg-type,dict-item]
    judged = evaluate(Loop(Process.parse("(1001s+1)/((1000s+1)(s+1))"), Fopid(5.0, 1.0)), 5000.0)
    exact = rational_indices(case)
    assert judged.step is not None
    assert exact is not None
    for name, value in exact.items():
        claimed = getattr(judged.step.indices_accuracy, name)
        assert abs(getattr(judged.step.indices, name) - value) <= claimed <= 1e-3 * value


@pytest.mark.parametrize(
    ("text", "horizon", "reason"),
    [
        ("1/(1e-40s+1)", 1e12, r"it moves within .* allowed: up to"),
        ("1/(1e-6s+1)*exp(-1e-6s)", 1e12, r"it moves within .* allowed: up to"),
        ("1/(s^2+1e-6s+1)", 1e6, r"takes .* samples; allowed: "),
    ],
)
def test_what_would_take_too_long_is_not_known_and_says_what_is_allowed(text: str, horizon: float, reason: str) -> None:
    judged = evaluate(Loop(read_process(text), Fopid(0.5)), horizon)
    assert judged.stability.stable
    assert judged.step is None
    with pytest.raises(UnknownResponseError, match=reason):
        step_response(Loop(read_process(text), Fopid(0.5)), horizon)
    assert "allowed" in judged.step_reason


def test_a_far_horizon_is_fine_at_a_few_instants() -> None:
    response = step_response(Loop(read_process("1/(s+1)"), Fopid(0.5, 0.1)), 1e12, points=11)
    assert response.output[1:] == pytest.approx(np.ones(10), abs=response.accuracy)


@pytest.mark.parametrize("horizon", [1e100, 1e308, 1e-300])
def test_a_horizon_beyond_all_measure_is_refused(horizon: float) -> None:
    with pytest.raises(InputError, match=r"horizon = .*; allowed: 1e-12 to 1e\+12 s"):
        step_response(Loop(read_process("1/(s+1)"), Fopid(0.5)), horizon)


@pytest.mark.parametrize("points", [10**9, 5_000_001])
def test_more_points_than_fit_are_refused(points: int) -> None:
    with pytest.raises(InputError, match=f"points = {points}; allowed: at least 2, at most 5000000"):
        step_response(Loop(read_process("P1"), Fopid(1.0)), 10.0, points=points)


def test_gains_that_overflow_are_refused() -> None:
    with pytest.raises(InputError, match=r"kp = 1e\+308; allowed: up to 1e\+100 in size"):
        Fopid(1e308)


def test_an_index_that_is_not_known_is_no_number() -> None:
    t = np.linspace(0.0, 10.0, 401)
    found, accuracy = response_indices(t, np.exp(-t), np.full(401, 10.0))
    assert all(math.isnan(value) for value in (*astuple(found), *astuple(accuracy)))
