"""The response of a structure to a recorded control is exact: fractional powers, delay, irregular samples."""

from __future__ import annotations

import math

import mpmath
import numpy as np
import pytest
from scipy.signal import lsim

from fopid_core.design.identification.record import Record
from fopid_core.design.identification.response import InitialCondition, RecordResponse
from fopid_core.design.identification.structure import structure_of

REGULAR = np.arange(0.0, 20.0, 0.05)
NO_CONTROL = np.zeros_like(REGULAR)


def mittag_leffler_step(alpha: float, time: float) -> float:
    """The step response of 1 / (s^alpha + 1): 1 - E_alpha(-t^alpha), by its power series."""
    with mpmath.workdps(60):
        z = -(mpmath.mpf(time) ** alpha)
        return float(1 - mpmath.nsum(lambda k: z**k / mpmath.gamma(alpha * k + 1), [0, mpmath.inf]))


def response(record: Record, name: str, x: list[float], start: InitialCondition | None = None) -> np.ndarray:
    """To the control alone, with gain 1."""
    return RecordResponse(record, structure_of(name), start or InitialCondition()).columns(np.array(x))[:, 0]


@pytest.mark.parametrize("alpha", [0.6, 1.4])
def test_a_fractional_lag_answers_a_step_as_the_mittag_leffler_function_says(alpha: float) -> None:
    delay = 1.23
    record = Record(REGULAR, np.ones_like(REGULAR), NO_CONTROL)
    found = response(record, "nioptd1", [0.0, alpha, delay])
    at = [20, 25, 30, 100, 200]
    expected = [mittag_leffler_step(alpha, t - delay) if t > delay else 0.0 for t in REGULAR[at]]
    # what is left after the leading singularity falls like s^-(1 + 2 alpha): its tail beyond twice the sample rate
    tolerance = 2e-3 if alpha < 1.0 else 1e-5
    assert found[at] == pytest.approx(expected, abs=tolerance)


def test_two_fractional_orders_agree_with_the_inverse_laplace_transform() -> None:
    tau, c, alpha, beta = 1.3, 1.7, 1.8, 0.7
    record = Record(REGULAR, np.ones_like(REGULAR), NO_CONTROL)
    found = response(record, "nioptd2", [math.log(tau), math.log(c), alpha, beta, 0.5])
    at = [15, 40, 200]
    expected = [
        float(mpmath.invertlaplace(lambda s: 1 / (s * ((tau * s) ** alpha + c * (tau * s) ** beta + 1)), t - 0.5))
        for t in REGULAR[at].tolist()
    ]
    assert found[at] == pytest.approx(expected, abs=1e-5)


def test_a_control_held_between_irregular_instants_acts_as_scipy_says() -> None:
    rng = np.random.default_rng(0)
    time = np.sort(rng.uniform(0.0, 20.0, 400))
    control = np.repeat(rng.standard_normal(40), 10)
    record = Record(time, control, np.zeros(400), control_before=0.0)
    found = response(record, "soptd", [0.0, math.log(1.2), 0.0])
    fine = np.linspace(time[0], time[-1], 200_001)
    held = control[np.searchsorted(time, fine, side="right") - 1]
    expected = lsim(([1.0], [1.0, 1.2, 1.0]), held, fine)[1]
    # a move within a cell of width span / 800 acts as if spread over it
    assert found == pytest.approx(np.interp(time, fine, expected), abs=2e-3)


def test_free_response_of_two_lags_is_in_the_span_of_what_the_beginning_adds() -> None:
    record = Record(REGULAR, NO_CONTROL, NO_CONTROL)
    start = InitialCondition(step=True, free=True)
    columns = RecordResponse(record, structure_of("soptd"), start).columns(np.array([0.0, math.log(0.5), 0.0]))
    root = complex(-0.25, math.sqrt(1.0 - 0.25**2))
    running_out = np.real((0.3 - 0.8j) * np.exp(root * REGULAR)) + 0.7
    left = running_out - columns @ np.linalg.lstsq(columns, running_out, rcond=None)[0]
    assert np.abs(left[5:]).max() < 2e-3  # the impulse response's kink at 0 is rounded off


@pytest.mark.parametrize(
    ("name", "x", "gains"),
    [
        ("foptd", [0.3, 0.7], [2.0]),
        ("nioptd2", [0.2, 0.4, 1.9, 0.8, 0.7], [2.0]),
        ("rational:3/1", [0.1, 0.5, -0.5, 0.7], [1.0, -0.4]),
    ],
)
def test_slopes_are_what_finite_differences_say(name: str, x: list[float], gains: list[float]) -> None:
    control = np.sign(np.sin(0.9 * REGULAR)) + np.sin(2.0 * REGULAR)
    record = Record(REGULAR, control, NO_CONTROL)
    start = InitialCondition(0.3, step=True, free=True, loads=(2.0,))
    model = RecordResponse(record, structure_of(name), start)
    at = np.array(x)
    columns = model.columns(at)
    coefficients = np.concatenate([gains, np.linspace(0.1, 0.2, columns.shape[1] - len(gains))])
    found = model.slopes(at, coefficients)
    step = 1e-5
    for i, direction in enumerate(step * np.eye(at.size)):
        forward, backward = model.columns(at + direction), model.columns(at - direction)
        expected = (forward - backward) @ coefficients / (2.0 * step)
        size = np.sqrt(np.mean(expected**2))
        assert np.sqrt(np.mean((found[:, i] - expected) ** 2)) < 0.065 * size, model.structure.free[i]


@pytest.mark.parametrize(
    ("name", "x", "gains"), [("soptd", [0.1, 0.5, 0.7], [2.0]), ("rational:3/1", [0.1, 0.5, -0.5, 0.7], [1.0, -0.4])]
)
def test_a_load_acts_as_the_control_does(name: str, x: list[float], gains: list[float]) -> None:
    numbers, load = np.array(x), 3.0
    late = RecordResponse(
        Record(REGULAR, np.where(load <= REGULAR, 1.0, 0.0), NO_CONTROL), structure_of(name), InitialCondition()
    )
    still = RecordResponse(Record(REGULAR, NO_CONTROL, NO_CONTROL), structure_of(name), InitialCondition(loads=(load,)))
    expected = late.columns(numbers)[:, : len(gains)] @ gains
    count = len(gains)
    assert still.columns(numbers)[:, count : 2 * count] @ gains == pytest.approx(expected, abs=1e-9)
    assert still.load_shapes(numbers, np.array(gains), np.array([load]))[0] == pytest.approx(expected, abs=2e-2)


def test_averages_over_blocks_stand_for_many_samples() -> None:
    time = np.arange(0.0, 20.0, 0.01)
    control = (time > 2.0).astype(float)
    measurement = np.where(time > 2.0, 1.0 - np.exp(-(time - 2.0)), 0.0)
    model = RecordResponse(Record(time, control, measurement), structure_of("foptd"), InitialCondition(), most=500)
    assert model.time.size == 500
    # a lag bends by at most 1 per second squared: over a block of 0.04 s that is 1e-4; a cell moves the step by 0.01 s
    assert model.columns(np.zeros(2))[:, 0] == pytest.approx(model.measurement, abs=1e-2)
