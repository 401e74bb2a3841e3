"""Bounds on the control and on |S| where a delay makes peaks that no grid shows: at its end, and at infinity."""

from __future__ import annotations

import math

import numpy as np
import pytest

from fopid_core.design.control_peak import open_control, open_move
from fopid_core.design.specification import Bounds
from fopid_core.design.time.bands import least_in_bands, smooth_places
from fopid_core.design.time.objectives import Objective
from fopid_core.design.time.problem import TimeProblem
from fopid_core.design.time.specification import TimeSpecification
from fopid_core.design.tuner import TuningRequest, tune
from fopid_core.design.verification import checks
from fopid_core.model.fopid import Fopid
from fopid_core.model.loop import Loop
from fopid_core.model.process import Process
from fopid_core.model.response import step_response

FOPI = np.array([19.2, 0.79, 0.0, 0.72, 1.0])
"""For a lag of 60 s with a delay of 1.3 s: the control grows until the delay ends, and falls from there."""


def test_the_control_before_anything_comes_back_is_that_of_the_exact_response() -> None:
    gains = Fopid(0.8, 0.5, 0.4, 0.7, 0.6)
    response = step_response(Loop(Process.parse("1/(s+1)*exp(-3s)"), gains), 10.0)
    inside = (response.time > 0.3) & (response.time < 2.9)
    known = open_control(np.array([gains.gains]), response.time[inside])[0]
    assert known == pytest.approx(response.control[inside], abs=1e-6)
    moves = np.diff(known) / np.diff(response.time[inside])
    middle = 0.5 * (response.time[inside][1:] + response.time[inside][:-1])
    assert open_move(np.array([gains.gains]), middle)[0] == pytest.approx(moves, rel=1e-2)


def test_the_end_of_a_delay_is_looked_at_between_two_instants_of_the_grid() -> None:
    process = Process.parse("1/(60s+1)*exp(-1.3s)")
    at_the_end = 19.2 + 0.79 * 1.3**0.72 / math.gamma(1.72)
    assert np.abs(step_response(Loop(process, Fopid(*FOPI)), 60.0).control).max() == pytest.approx(at_the_end, rel=2e-4)
    bounds = TimeSpecification(Objective.of("iae", {}), horizon=60.0, u_max=20.0)
    problem = TimeProblem(process, bounds, points=512, watch_control=True)
    assert problem.largest_control(FOPI[None])[0] == pytest.approx(at_the_end, rel=1e-12)
    assert problem.slack(FOPI[None]).min() <= 1.0 - at_the_end / 20.0 < 0.0
    (check,) = checks(Loop(process, Fopid(*FOPI)), Bounds(u_max=20.0, horizon=60.0))
    assert check.value == pytest.approx(at_the_end, rel=1e-12)


def test_an_uneven_grid_promises_no_deeper_bottom_than_an_even_one() -> None:
    """Points of a turning delay, far apart beside close together: the parabola went down to -2e7."""
    values = np.array([[1.0, 0.2, 0.3]])
    assert least_in_bands(values, np.array([0.0, 1e-9, 2.3]), 1)[0, 0] >= 0.2 - 0.8 / 8.0
    assert least_in_bands(values, np.array([0.0, 1.0, 2.0]), 1)[0, 0] == pytest.approx(0.2 - 0.49 / 7.2)


def test_there_is_no_parabola_where_the_delay_turns_from_point_to_point() -> None:
    log_w = np.log(np.array([1.0, 1.5, 4.0, 40.0, 41.0]))
    places = smooth_places(log_w, delay=2.0)
    assert np.isnan(places).tolist() == [False, False, True, True, True]
    values = np.array([[3.0, 2.0, 3.0, 1.0, 1.1]])
    assert least_in_bands(values, places, 1)[0, 0] == 1.0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("text", "asked"),
    [
        ("1/(0.3s+1)*exp(-s)", {"ms_max": 1.6}),
        ("2/(0.25s+1)*exp(-0.9s)", {"ms_max": 1.5, "structure": "pid"}),
        ("1/(s^0.5+1)*exp(-s)", {"ms_max": 1.5}),
        ("1/(100s+1)*exp(-s)", {"ms_max": 1.4}),
        ("-1/(40s+1)*exp(-1.7s)", {"ms_max": 1.6, "u_max": 8.0}),
        ("1/(5s+1)*exp(-1.3s)", {"ms_max": 1.5, "rate_max": 30.0}),
    ],
)
def test_a_bound_that_binds_at_infinity_or_at_the_end_of_a_delay_is_kept(text: str, asked: dict[str, float]) -> None:
    """The first and the fourth are of the test batch, and were not met: Ms 1.602 and a control of 20.06."""
    result = tune(TuningRequest(Process.parse(text), method="time", index="iae", **asked))  # type: ignore[arg-type]
    assert result.success, result.unmet
