"""First-order Gruenwald-Letnikov samples are those of the difference equation, and make the paper's tables."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from fopid_core.data import paper_tables
from fopid_core.errors import InputError
from fopid_core.model.fopid import Fopid
from fopid_core.model.gruenwald import gl1_response
from fopid_core.model.indices import indices, overshoot_pct, rise_time_to_100
from fopid_core.model.loop import Loop
from fopid_core.model.process import Process, read_process
from fopid_core.model.response import step_response


def weights(order: float, step: float, count: int) -> np.ndarray:
    """Coefficients of ((1 - z) / h)^order."""
    found = np.empty(count)
    found[0] = step**-order
    for k in range(1, count):
        found[k] = found[k - 1] * (1.0 - (order + 1.0) / k)
    return found


@settings(derandomize=True, deadline=None, max_examples=20)
@given(
    st.floats(0.5, 3.0), st.floats(0.1, 1.0), st.floats(0.0, 1.0), st.floats(0.2, 1.6), st.floats(0.2, 1.6),
    st.floats(1.0, 2.0), st.integers(0, 5),
)  # fmt: skip
def test_samples_are_those_of_the_loop_run_step_by_step(
    kp: float, ki: float, kd: float, lam: float, mu: float, alpha: float, lag: int
) -> None:
    step, count = 0.1, 60
    loop = Loop(Process.parse(f"1/(s^{alpha!r}+0.5)").delayed(lag * step), Fopid(kp, ki, kd, lam, mu))
    controller = weights(0.0, step, count) * kp
    controller += ki * weights(-lam, step, count) + kd * weights(mu, step, count)
    process = weights(alpha, step, count) + 0.5 * weights(0.0, step, count)
    output, control, error = np.zeros(count), np.zeros(count), np.zeros(count)
    for n in range(count):
        # without lag output and control depend on each other within one sample: one linear equation
        past = controller[1 : n + 1] @ error[n - 1 :: -1] if n else 0.0
        memory = process[1 : n + 1] @ output[n - 1 :: -1] if n else 0.0
        if lag:
            output[n] = ((control[n - lag] if n >= lag else 0.0) - memory) / process[0]
        else:
            output[n] = (controller[0] + past - memory) / (process[0] + controller[0])
        error[n] = 1.0 - output[n]
        control[n] = controller[0] * error[n] + past
    assume(np.max(np.abs(output)) < 3.0)
    response = gl1_response(loop, count * step, step)
    assert response.output[0] == 0.0
    assert response.output[1:] == pytest.approx(output, abs=1e-6 * max(1.0, float(np.max(np.abs(output)))))
    assert response.control[:-1] == pytest.approx(control, abs=1e-6 * float(np.max(np.abs(control))))


@pytest.mark.parametrize("row", paper_tables()["table4_to_7"], ids=lambda r: f"{r['process']} {r['index']}")
def test_the_papers_tables_4_to_7_are_these_samples(row: dict[str, object]) -> None:
    loop = Loop(read_process(row["process"]), Fopid(*(row[name] for name in ("kp", "ki", "kd", "lam", "mu"))))
    response, printed = gl1_response(loop, 50.0, 0.01), row["paper"]
    found, name = indices(response.time, response.error), row["index"].lower()
    value = found.weighted_sum() if name == "sum" else getattr(found, name)
    if (row["process"], name) != ("P4", "sum"):  # printed 14 % above the sum of its own parts' method
        assert value == pytest.approx(printed["J"], rel=0.025, abs=5e-5)
    if (row["process"], name) != ("P3", "itae"):  # a misprint: 9.0 for 0.9
        assert overshoot_pct(response.output) == pytest.approx(printed["overshoot_pct"], abs=0.15)
    assert rise_time_to_100(response.time, response.output) == pytest.approx(printed["rise_time"], abs=0.06)


def test_the_samples_near_the_exact_response_with_the_first_power_of_the_step() -> None:
    loop = Loop(read_process("P1"), Fopid(2.9692, 0.8028, 1.3394, 1.0138, 0.6074))
    exact = step_response(loop, 10.0, points=101).output
    errors = []
    for step in (0.02, 0.01, 0.005):
        samples = gl1_response(loop, 10.0, step).output
        errors.append(np.max(np.abs(samples[:: round(0.1 / step)] - exact)))
    assert errors[0] / errors[1] == pytest.approx(2.0, rel=0.1)
    assert errors[1] / errors[2] == pytest.approx(2.0, rel=0.1)


def test_the_first_control_sample_is_the_kick_of_the_sampled_controller() -> None:
    response = gl1_response(Loop(Process.parse("1/(s+1)*exp(-1s)"), Fopid(1.0, 2.0, 0.5, 0.9, 0.8)), 5.0, 0.01)
    assert response.control[0] == pytest.approx(1.0 + 2.0 * 0.01**0.9 + 0.5 * 0.01**-0.8, rel=1e-6)
    assert response.control_peak == pytest.approx(response.control[0])


def test_a_load_comes_out_as_the_process_says() -> None:
    response = gl1_response(Loop(Process.parse("1/(s+1)"), Fopid(0.0)), 1.0, 0.5, "load")
    assert response.output == pytest.approx([0.0, 1.0 / 3.0, 5.0 / 9.0], abs=1e-8)  # y_n (1 + h) = y_(n-1) + h


def test_a_loop_that_is_unstable_as_sampled_is_refused() -> None:
    loop = Loop(Process.parse("1/(s+1)*exp(-1s)"), Fopid(0.5))
    assert gl1_response(loop, 40.0, 0.01).output[-1] == pytest.approx(1.0 / 3.0, abs=1e-6)
    with pytest.raises(InputError, match=r"step = 0.01; the loop sampled at it is unstable"):
        gl1_response(Loop(loop.process, Fopid(5.0)), 40.0, 0.01)


@pytest.mark.parametrize(
    ("horizon", "step", "reason"),
    [
        (-1.0, 0.1, "horizon = -1.0"),
        (1.0, 0.0, "step = 0.0"),
        (1.0, 0.6, "at most half the horizon"),
        (1.0, math.nan, "step = nan"),
        (1e6, 1e-6, "step = 1e-06; allowed: at least"),
    ],
)
def test_steps_that_make_no_samples_are_refused(horizon: float, step: float, reason: str) -> None:
    with pytest.raises(InputError, match=reason):
        gl1_response(Loop(read_process("P1"), Fopid(1.0)), horizon, step)
