"""A search with the bound on max |S| of the loop as it runs: of ticks that are slow beside the process."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import cont2discrete, tf2ss

from fopid_core.design.sampled_loop import running
from fopid_core.design.specification import TuningRequest
from fopid_core.design.time.sampled_bound import SampledBound
from fopid_core.design.tuner import WORSE, tune
from fopid_core.model.fopid import Fopid
from fopid_core.model.process import read_process
from fopid_core.runtime.controller import FopidController
from fopid_core.runtime.settings import as_designed


@pytest.mark.slow
@pytest.mark.parametrize(
    ("text", "numerator", "denominator", "tick"),
    [
        ("1/(s+1)", [1.0], [1.0, 1.0], 0.2),
        ("1/(s-1)", [1.0], [1.0, -1.0], 0.05),
        ("1/s", [1.0], [1.0, 0.0], 0.2),
        ("1/s^2", [1.0], [1.0, 0.0, 0.0], 0.2),
        ("1/(s^2-1)", [1.0], [1.0, 0.0, -1.0], 0.05),
        ("1/(s+1)^2", [1.0], [1.0, 2.0, 1.0], 0.5),
    ],
)
def test_slow_ticks_are_no_reason_to_refuse_a_simple_process(
    text: str, numerator: list[float], denominator: list[float], tick: float
) -> None:
    """All were refused, since a design without ticks is not stable with them; the plant here is the textbook's."""
    found = tune(TuningRequest(read_process(text), method="time", sample_time=tick))
    assert found.success, found.unmet
    assert found.running.ms <= 1.6 * WORSE
    assert found.controller is not None
    a, b, c, _, _ = cont2discrete(tf2ss(numerator, denominator), tick)
    controller = FopidController(as_designed(found.controller, tick, found.filter, found.weights))
    state, errors = np.zeros((a.shape[0], 1)), []
    for _ in range(round(60.0 / tick)):
        errors.append(1.0 - (c @ state).item())
        state = a @ state + b * controller.step(1.0, (c @ state).item())
    assert np.abs(errors[-20:]).max() < 0.05
    assert np.abs(errors).max() < 2.0


@pytest.mark.parametrize(("text", "tick"), [("1/(s+1)", 0.2), ("1/(s-1)", 0.1), ("1/(s(s+1))*exp(-0.3s)", 0.25)])
def test_bound_and_stability_are_those_of_what_runs(text: str, tick: float) -> None:
    """The controller is taken at a backward difference: exact for P and PI but for half a tick of the integral."""
    process, rng = read_process(text), np.random.default_rng(0)
    bound = SampledBound(process, tick, 0)
    kps, shares = np.exp(rng.uniform(np.log([0.1, 0.03]), np.log([12.0, 1.0]), (60, 2))).T
    rows = np.array([[kp, kp * share, 0.0, 1.0, 1.0] for kp, share in zip(kps, shares, strict=True)])
    peaks, stable = 2.0 * np.exp(-bound.slack(rows, 2.0).min(axis=1)), bound.stable(rows)
    both = 0
    for row, peak, is_stable in zip(rows, peaks, stable, strict=True):
        runs = running(process, Fopid(*row.tolist()), tick, with_margins=False)
        if runs.stable and runs.ms < 3.0:
            both += 1
            assert is_stable, row
            assert peak == pytest.approx(runs.ms, rel=0.1), row
        elif not runs.stable and peak < 3.0:
            assert not is_stable
    assert both >= 5


@pytest.mark.slow
def test_what_no_ticks_of_that_length_can_hold_is_refused_by_how_it_runs() -> None:
    found = tune(TuningRequest(read_process("50/(s^2-900)"), method="time", sample_time=0.05, filter_order=0))
    assert not found.success
    assert "stability as it runs, with ticks of 0.05 s" in found.unmet[-1]


@pytest.mark.slow
def test_a_filter_is_chosen_where_none_else_keeps_the_bounds_unless_somebody_says_none() -> None:
    process = read_process("1/(s^2-1)")
    found = tune(TuningRequest(process, method="time"))
    assert found.success, found.unmet
    assert found.filter.order == 2
    assert "behind a filter of order 2 (--filter-order), without which no design keeps the bounds" in found.message
    assert not tune(TuningRequest(process, method="time", filter_order=0)).success
