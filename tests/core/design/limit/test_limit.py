"""The limit of all linear controllers: closed forms, a controller that was found by other means, finer grids."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest

from fopid_core.design.limit.limit import limit, ramp_response, right_zeros
from fopid_core.errors import InputError
from fopid_core.model.process import Process

from ...cli.runner import invoke

LAG = Process.parse("1/(s+1)*exp(-0.5s)")
FEW = {"cells": 32, "mt_max": 1.6}


def test_a_setpoint_step_shows_the_delay_and_what_a_zero_to_the_right_adds() -> None:
    """Of P = exp(-L s): L. Of P = (1 - s/z)/(1 + s/z): no input makes an error below 1/z, nor its square below 2/z."""
    for text, iae, ise in (
        ("3/(s+1)^2*exp(-0.7s)", 0.7, 0.7),
        ("(1-2s)/(s+1)^2", 2.0, 4.0),
        ("(1-2s)/(s+1)^2*exp(-0.3s)", 2.3, 4.3),
    ):
        process = Process.parse(text)
        assert limit(process, input="setpoint").bound == pytest.approx(iae, rel=1e-9)
        assert limit(process, "ise", "setpoint").bound == pytest.approx(ise, rel=1e-9)


def test_without_bounds_a_load_shows_for_one_more_delay() -> None:
    """From L, when it is seen, to 2 L, when the first control that knows of it arrives: 1 - exp(-t) of a lag."""
    none = {"ms_max": math.inf, "noise_max": math.inf}
    assert limit(LAG, **none).bound == pytest.approx(0.5 - (1.0 - math.exp(-0.5)), rel=1e-5)
    squared = 0.5 - 2.0 * (1.0 - math.exp(-0.5)) + (1.0 - math.exp(-1.0)) / 2.0
    assert limit(LAG, "ise", **none).bound == pytest.approx(squared, rel=1e-5)


def test_the_answer_without_control_is_right_with_fractional_powers() -> None:
    """The integral of the step response of 1/s^1.5 is t^2.5 / gamma(3.5)."""
    ramp = ramp_response(Process.parse("1/s^1.5*exp(-s)"), 4.0)
    t = np.array([0.1, 1.0, 4.0])
    assert ramp(t) == pytest.approx(t**2.5 / math.gamma(3.5), rel=1e-4)


def test_zeros_to_the_right_are_one_of_each_pair() -> None:
    assert right_zeros(Process.parse("(s-2)(s+1)/(s+1)^3")).tolist() == pytest.approx([2.0])
    assert right_zeros(Process.parse("(1-s^0.5)/(s+1)^3")).size == 0


@pytest.mark.slow
def test_the_bound_falls_when_any_bound_on_the_loop_is_loosened() -> None:
    tight = limit(LAG, **FEW)
    assert 0.2 < tight.bound < 0.588  # the best fractional controller found so far has 0.588
    for looser in ({"ms_max": 2.5}, {"noise_max": 80.0}):
        assert limit(LAG, **(FEW | looser)).bound <= tight.bound + 1e-6


@pytest.mark.slow
def test_a_bound_scales_with_the_process() -> None:
    """Gain and time of the process scale the index; the bounds on the loop do not."""
    slow = limit(Process.parse("100/(7s+1)*exp(-3.5s)"), sample_time=0.07, **FEW)
    assert slow.bound == pytest.approx(700.0 * limit(LAG, **FEW).bound, rel=5e-3)


@pytest.mark.slow
def test_the_setpoint_limit_of_one_degree_of_freedom_is_above_the_delay() -> None:
    """With max |S| at most 1.6 the error cannot be only that of the delay."""
    found = limit(LAG, input="setpoint", one_degree=True, cells=120)
    assert found.bound > 0.52


@pytest.mark.parametrize(
    ("process", "asked", "told"),
    [
        ("1/(s-1)", {}, "stable or integrating"),
        ("1/(s+1)", {"index": "itae"}, "allowed: iae, ise"),
        ("1/(s+1)", {"cells": 3}, "8 to 1000"),
        ("1/(s+1)*exp(-s)", {"horizon": 0.5}, "longer than the delay"),
        ("1/(s+1)", {"ms_max": 0.9}, "ms_max = 0.9"),
    ],
)
def test_what_cannot_be_asked_is_told_in_one_line(process: str, asked: dict, told: str) -> None:
    with pytest.raises(InputError, match=told):
        limit(Process.parse(process), **asked)


def test_the_verb_tells_bound_error_and_time() -> None:
    done = invoke(["limit", "1/(s+1)*exp(-0.5s)", "--cells", "12", "--json"])
    found = json.loads(done.stdout)
    assert found["bound"] > 0.0
    assert {"resolution_error", "elapsed_s"} <= set(found)


@pytest.mark.slow
@pytest.mark.parametrize(
    "text", ["1/(s+1)*exp(-0.5s)", "1/(s+1)^3", "1/(s(0.7s+1))*exp(-0.3s)", "1/(s^0.5+1)*exp(-0.2s)"]
)
def test_finer_grids_raise_the_bound_by_less_than_was_told(text: str) -> None:
    process = Process.parse(text)
    coarse, fine = (limit(process, mt_max=1.6, cells=cells) for cells in (60, 120))
    assert coarse.bound - 1e-6 <= fine.bound + coarse.resolution_error
    assert fine.bound <= coarse.bound + coarse.resolution_error


@pytest.mark.slow
@pytest.mark.parametrize("text", ["1/(s+1)*exp(-0.5s)", "1/(s+1)^3"])
def test_a_controller_of_high_order_comes_near_and_does_not_pass(text: str) -> None:
    """The other side of the duality, with no code shared: the best Q of 24 all-pass terms on dense grids."""
    process = Process.parse(text)
    reached = _reached(process, 1.6, 1.6, 20.0)
    found = limit(process, mt_max=1.6, noise_max=20.0, cells=120)
    assert found.bound < reached < 2.0 * found.bound


def _reached(process: Process, ms: float, mt: float, noise: float, terms: int = 24, fast: float = 6.0) -> float:
    """Load IAE of C = Q / (1 - P Q), Q a sum of all-pass terms behind a filter, by the primal convex program."""
    import cvxpy

    def basis(s: np.ndarray) -> np.ndarray:
        return np.stack([((fast - s) / (fast + s)) ** i / (1.0 + s / (8.0 * fast)) ** 2 for i in range(terms)])

    s = 1j * np.geomspace(1e-2, 400.0, 250)
    horizon, count = 12.0, 1 << 14
    period, damping = 4.0 * horizon, 20.0 / (4.0 * horizon)
    line = damping + 2j * np.pi / period * np.arange(count // 2 + 1)
    t = np.arange(count) * period / count
    kept = np.arange(0, count // 4, 12)

    def in_time(transform: np.ndarray) -> np.ndarray:
        return (np.fft.irfft(transform) * count / period * np.exp(damping * t))[..., kept]

    q = cvxpy.Variable(terms)
    error = in_time(process(line) / line) - in_time(basis(line) * process(line) ** 2 / line).T @ q

    def size(values: np.ndarray, less: float = 0.0) -> object:
        return cvxpy.norm(cvxpy.vstack([less - values.real.T @ q, values.imag.T @ q]), 2, axis=0)

    loop = basis(s) * process(s)
    rest = basis(np.array([1e-9 + 0j]))[:, 0].real * process(1e-9).real
    bounds = [size(loop, 1.0) <= ms, size(loop) <= mt, size(basis(s)) <= noise, rest @ q == 1.0]
    problem = cvxpy.Problem(cvxpy.Minimize(t[kept[1]] * cvxpy.sum(cvxpy.abs(error))), bounds)
    return float(problem.solve(solver=cvxpy.CLARABEL))
