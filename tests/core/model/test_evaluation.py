"""A loop is judged in one answer, which says what exists and what does not."""

from __future__ import annotations

import math

import pytest

from fopid_core.errors import InputError
from fopid_core.model.evaluation import default_horizon, evaluate
from fopid_core.model.fopid import Fopid
from fopid_core.model.loop import Loop
from fopid_core.model.process import Process, read_process
from fopid_core.model.response import step_response


def test_a_loop_that_is_not_stable_has_no_indices() -> None:
    judged = evaluate(Loop(read_process("P1"), Fopid(9.0)))
    assert judged.step is None
    assert math.isnan(judged.steady_state_error)
    assert judged.stability.unstable_poles == 2


@pytest.mark.parametrize(
    ("text", "gains", "error"),
    [("P1", (3.0,), 0.25), ("P1", (3.0, 1.0), 0.0), ("1/(s(s+1))", (1.0,), 0.0), ("2/(s+1)", (0.0,), 1.0)],
)
def test_the_steady_state_error_is_what_is_left(text: str, gains: tuple[float, ...], error: float) -> None:
    assert evaluate(Loop(read_process(text), Fopid(*gains))).steady_state_error == pytest.approx(error)


def test_both_methods_agree_up_to_the_step() -> None:
    loop = Loop(read_process("P1"), Fopid(2.0, 0.5, 1.0, 0.9, 0.8))
    exact, sampled = evaluate(loop, 30.0), evaluate(loop, 30.0, "gl1", 0.002)
    assert exact.step is not None
    assert sampled.step is not None
    assert sampled.step.indices.iae == pytest.approx(exact.step.indices.iae, rel=0.01)
    assert exact.step.control_peak == math.inf
    assert sampled.step.control_peak == pytest.approx(2.0 + 0.5 * 0.002**0.9 + 0.002**-0.8, rel=0.02)


@pytest.mark.parametrize(
    ("text", "gains"),
    [
        ("P1", (1.0, 0.4, 0.5)),
        ("P4", (3.0, 3.0, 0.5)),
        ("3.13/(433.33s+1)*exp(-50s)", (1.0, 0.003)),
        ("1/(s+1)", (0.5,)),
        ("0.5/s*exp(-0.5s)", (1.0, 0.05)),
    ],
)
def test_on_the_default_horizon_the_loop_settles(text: str, gains: tuple[float, ...]) -> None:
    loop = Loop(read_process(text), Fopid(*gains))
    horizon = default_horizon(loop)
    response = step_response(loop, 2.0 * horizon, points=3)
    assert response.output[1] == pytest.approx(response.output[2], abs=0.02)


def test_an_unknown_method_is_refused() -> None:
    with pytest.raises(InputError, match="method = 'rk4'; allowed: exact, gl1"):
        evaluate(Loop(read_process("P1"), Fopid(1.0)), method="rk4")  # type: ignore[arg-type]


def test_a_horizon_that_nobody_asked_for_is_shorter_where_the_response_takes_too_much() -> None:
    judged = evaluate(Loop(Process.parse("1/(s+1)*exp(-100s)"), Fopid(0.2, 0.005, lam=0.9)))
    assert judged.step is not None, judged.step_reason
    assert judged.horizon == 4000.0
