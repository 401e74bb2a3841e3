"""The least distance problem inside a step, and what a descent promises."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize

from fopid_core.design.time.gauss_newton import begin, descend, least_distance
from fopid_core.design.time.objectives import Objective
from fopid_core.design.time.problem import TimeProblem
from fopid_core.design.time.specification import TimeSpecification
from fopid_core.model.process import read_process


@settings(derandomize=True, deadline=None, max_examples=60)
@given(seed=st.integers(0, 10_000))
def test_the_shortest_vector_within_half_spaces_is_that_of_another_solver(seed: int) -> None:
    rng = np.random.default_rng(seed)
    matrix, inside = rng.normal(size=(6, 3)), rng.normal(size=3)
    bound = matrix @ inside - rng.uniform(0.0, 1.0, size=6)  # so that there is a vector
    found = least_distance(matrix, bound)
    assert found is not None
    assert np.all(matrix @ found >= bound - 1e-8)
    other = minimize(
        lambda z: 0.5 * z @ z, inside, jac=lambda z: z, method="SLSQP", options={"ftol": 1e-14, "maxiter": 200},
        constraints={"type": "ineq", "fun": lambda z: matrix @ z - bound, "jac": lambda _: matrix},
    )  # fmt: skip
    assert np.linalg.norm(found) <= np.linalg.norm(other.x) + 1e-6


def test_half_spaces_without_a_common_point_have_no_vector() -> None:
    assert least_distance(np.array([[1.0, 0.0], [-1.0, 0.0]]), np.array([1.0, 1.0])) is None


@pytest.fixture(scope="module")
def problem() -> TimeProblem:
    return TimeProblem(read_process("P1"), TimeSpecification(Objective.of("ise", {}), 40.0, ms_max=1.6, u_max=20.0))


def test_slopes_are_those_of_finite_differences(problem: TimeProblem) -> None:
    gains = np.array([1.2, 0.6, 0.5, 1.05, 0.7])
    point = problem.linearised(gains)
    for position in range(5):
        step = 1e-4 * problem.scale[position] * np.eye(5)[position]
        high, low = problem.linearised(gains + step), problem.linearised(gains - step)
        assert np.allclose((high.signals - low.signals) / 2e-4, point.signal_slopes[position], atol=1e-5)
        assert np.allclose((high.slack - low.slack) / 2e-4, point.slack_slopes[:, position], atol=1e-3, rtol=1e-3)


def test_slopes_are_finite_where_there_is_no_controller_at_all() -> None:
    bounds = {"ms_max": 1.6, "mt_max": 1.6, "noise_max": 20.0}
    specification = TimeSpecification(Objective.of("iae", {}), 40.0, input="load", filter_order=2, **bounds)
    point = TimeProblem(read_process("P1"), specification).linearised(
        np.array([0.0, 0.0, 0.0, 1.0, 1.0, 0.1, 1.0, 1.0])
    )
    for values in (point.signals, point.signal_slopes, point.slack, point.slack_slopes):
        assert np.isfinite(values).all()


def test_a_descent_never_ends_worse_than_it_began(problem: TimeProblem) -> None:
    start = np.array([[0.5, 0.2, 0.1, 1.0, 0.9], [1.0, 0.1, 0.1, 0.8, 0.5], [0.3, 0.4, 0.3, 1.2, 0.6]])
    for descent in begin(problem, start):
        ended = descend(problem, descent, 10)
        assert ended.merit <= descent.merit


def test_a_descent_stops_when_time_is_over(problem: TimeProblem) -> None:
    (descent,) = begin(problem, np.array([[0.5, 0.2, 0.1, 1.0, 0.9]]))
    assert descend(problem, descent, 10, expired=lambda: True) == descent
