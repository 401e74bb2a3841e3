"""The bridge to python-control: exact where the model is rational, close on the band where it is not, and back."""

from __future__ import annotations

import control
import numpy as np
import pytest

from fopid_core.errors import InputError
from fopid_core.model.fopid import Fopid
from fopid_core.model.loop import Loop
from fopid_core.model.process import Process, read_process
from fopid_core.model.rational import (
    Approximation,
    from_control,
    oustaloup,
    to_state_space,
    to_transfer_function,
)
from fopid_core.model.response import step_response

INNER = 1j * np.logspace(-1.0, 1.0, 21)  # two decades inside the band
FINE = Approximation(order=8, band=(1e-4, 1e4), pade_order=6)


@pytest.mark.parametrize("power", [-1.7, -0.3, 0.2, 0.5, 1.6])
def test_a_fractional_power_is_close_inside_its_band(power: float) -> None:
    assert oustaloup(power)(INNER) == pytest.approx(INNER**power, rel=0.01)
    assert oustaloup(power, FINE)(INNER) == pytest.approx(INNER**power, rel=1e-3)


def test_oustaloups_filter_has_the_poles_of_its_source() -> None:
    # w_k = w_b (w_h / w_b)^((k + N + (1 + a) / 2) / (2 N + 1)), k = -N .. N
    n, low, high, a = 3, 1e-2, 1e2, 0.4
    k = np.arange(-n, n + 1)
    poles = low * (high / low) ** ((k + n + 0.5 * (1 + a)) / (2 * n + 1))
    system = oustaloup(a, Approximation(order=n, band=(low, high)))
    assert np.sort(-system.poles().real) == pytest.approx(poles, rel=1e-6)


def test_whole_powers_are_exact_and_integrators_stay() -> None:
    assert oustaloup(2.0)(2j) == pytest.approx((2j) ** 2)
    assert np.min(np.abs(oustaloup(-0.3).poles())) == 0.0


@pytest.mark.parametrize("text", ["P2", "(s+2)/(s+1)", "(1-s)/(s(s+3)^2)", "-2/(s-1)"])
def test_a_rational_process_goes_over_exactly_and_comes_back(text: str) -> None:
    process = read_process(text)
    for system in (to_transfer_function(process), to_state_space(process)):
        assert system(INNER) == pytest.approx(process(INNER), rel=1e-9)
        assert from_control(system)(INNER) == pytest.approx(process(INNER), rel=1e-6)
        assert from_control(system).relative_degree == process.relative_degree


@pytest.mark.parametrize(
    "text", ["1/(0.8s^2.2+0.5s^0.9+1)", "(s^0.3+2)/(s^1.7+0.5s^1.1+s^0.4+1)", "1/s^1.4*exp(-0.1s)"]
)
def test_a_fractional_process_is_close_inside_the_band(text: str) -> None:
    process = Process.parse(text)
    assert to_transfer_function(process)(INNER) == pytest.approx(process(INNER), rel=0.02)
    assert to_state_space(process, FINE)(INNER) == pytest.approx(process(INNER), rel=2e-3)


@pytest.mark.parametrize("gains", [(0.3, 0.3, 0.3, 1.1, 0.6), (1.0, 0.0, 0.0, 1.0, 1.0), (-1.0, 2.0, 0.5, 0.4, 0.9)])
def test_a_controller_is_close_inside_the_band(gains: tuple[float, ...]) -> None:
    controller = Fopid(*gains)
    assert to_transfer_function(controller)(INNER) == pytest.approx(controller(INNER), rel=0.02)
    assert to_state_space(controller, FINE)(INNER) == pytest.approx(controller(INNER), rel=2e-3)


@pytest.mark.parametrize("delay", [0.0, 0.3])
def test_a_loop_closed_in_state_space_answers_like_the_exact_one(delay: float) -> None:
    process, controller = Process.parse("1/(0.8s^2.2+0.5s^0.9+1)").delayed(delay), Fopid(0.3, 0.3, 0.3, 1.1, 0.6)
    closed = control.feedback(to_state_space(controller, FINE) * to_state_space(process, FINE), 1)
    exact = step_response(Loop(process, controller), 20.0, points=401)
    approximate = control.forced_response(closed, exact.time, np.ones(401)).outputs
    assert approximate == pytest.approx(exact.output, abs=5e-3)


def test_a_plain_pid_has_the_same_loop_in_python_control() -> None:
    process, controller = read_process("P2"), Fopid(1.0, 0.8, 0.5)
    closed = control.feedback(to_transfer_function(controller) * to_transfer_function(process), 1)
    assert closed(INNER) == pytest.approx(Loop(process, controller).complementary_sensitivity(INNER), rel=1e-9)
    exact = step_response(Loop(process, controller), 20.0, points=401)
    assert control.forced_response(closed, exact.time, np.ones(401)).outputs == pytest.approx(exact.output, abs=1e-7)


def test_a_delay_can_be_put_behind_a_system_from_python_control() -> None:
    process = from_control(control.tf([2.0], [3.0, 1.0]), delay=0.5)
    assert process == Process.parse("2/(3s+1)*exp(-0.5s)")


@pytest.mark.parametrize(
    ("system", "reason"),
    [
        (control.tf([1.0], [1.0, 0.5], 0.1), "sample time 0.1"),
        (control.ss(-np.eye(2), np.eye(2), np.eye(2), np.zeros((2, 2))), "2 inputs and 2 outputs"),
        (3.0, "type float"),
    ],
)
def test_systems_that_are_no_process_are_refused(system: object, reason: str) -> None:
    with pytest.raises(InputError, match=reason):
        from_control(system)


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        ({"order": 0}, "order = 0; allowed: 1 to 20"),
        ({"pade_order": 21}, "pade_order = 21"),
        ({"band": (1.0, 0.1)}, "band = "),
        ({"band": (0.0, 1.0)}, "band = "),
    ],
)
def test_approximations_out_of_range_are_refused(arguments: dict[str, object], reason: str) -> None:
    with pytest.raises(InputError, match=reason):
        Approximation(**arguments)  # type: ignore[arg-type]


def test_what_has_no_state_space_is_refused() -> None:
    with pytest.raises(InputError, match="mu = 1"):
        to_state_space(Fopid(1.0, 0.0, 1.0))
    with pytest.raises(InputError, match="several delays"):
        to_state_space(Process.parse("1/(s+exp(-s))"))
