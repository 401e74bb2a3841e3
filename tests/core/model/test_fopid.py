"""The controller's transfer function is eq. (16) of the paper, and plain PID at orders 1."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fopid_core.errors import InputError
from fopid_core.model.fopid import Fopid, read_gains

gains = st.floats(-50.0, 50.0)
orders = st.floats(0.0, 2.0)
w = np.logspace(-3, 3, 13)


@settings(derandomize=True, deadline=None, max_examples=60)
@given(gains, gains, gains, orders, orders)
def test_gain_and_phase_are_those_of_the_papers_real_formulas(
    kp: float, ki: float, kd: float, lam: float, mu: float
) -> None:
    real = kp + ki * w**-lam * np.cos(lam * np.pi / 2) + kd * w**mu * np.cos(mu * np.pi / 2)
    imaginary = kd * w**mu * np.sin(mu * np.pi / 2) - ki * w**-lam * np.sin(lam * np.pi / 2)
    assert Fopid(kp, ki, kd, lam, mu)(1j * w) == pytest.approx(real + 1j * imaginary, rel=1e-9, abs=1e-9)


@settings(derandomize=True, deadline=None, max_examples=30)
@given(gains, gains, gains)
def test_orders_of_one_are_the_classical_pid(kp: float, ki: float, kd: float) -> None:
    assert Fopid(kp, ki, kd)(1j * w) == pytest.approx(kp + ki / (1j * w) + kd * 1j * w, rel=1e-13, abs=1e-13)


@settings(derandomize=True, deadline=None, max_examples=30)
@given(gains, gains, gains, orders, orders)
def test_the_numerator_is_the_controller_without_its_integrator(
    kp: float, ki: float, kd: float, lam: float, mu: float
) -> None:
    controller, s = Fopid(kp, ki, kd, lam, mu), 0.3 + w * 1j
    assert controller.numerator(s) / s**controller.integral_order == pytest.approx(controller(s), abs=1e-6, rel=1e-9)


@settings(derandomize=True, deadline=None, max_examples=30)
@given(gains, gains, gains, orders, orders)
def test_the_derivative_is_the_limit_of_difference_quotients(
    kp: float, ki: float, kd: float, lam: float, mu: float
) -> None:
    controller, s = Fopid(kp, ki, kd, lam, mu), 1.0 + 1j * w
    quotient = (controller(s + 1e-6) - controller(s - 1e-6)) / 2e-6
    assert controller.derivative(s) == pytest.approx(quotient, abs=1e-4, rel=1e-5)


@pytest.mark.parametrize("name", ["kp", "ki", "kd", "lam", "mu"])
@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_numbers_must_be_finite(name: str, value: float) -> None:
    with pytest.raises(InputError, match=f"{name} = .*; allowed: a finite number"):
        Fopid(**({"kp": 1.0} | {name: value}))


@pytest.mark.parametrize(("name", "value"), [("lam", -0.1), ("lam", 2.1), ("mu", -1e-9), ("mu", 3.0)])
def test_orders_outside_their_range_are_refused(name: str, value: float) -> None:
    with pytest.raises(InputError, match=f"{name} = {value}; allowed: 0 to 2"):
        Fopid(1.0, **{name: value})


def test_gains_are_read_from_text_negative_ones_too() -> None:
    assert read_gains(" -1, 0,2e-1,0.9,1").gains == (-1.0, 0.0, 0.2, 0.9, 1.0)


@pytest.mark.parametrize("text", ["", "1,2,3,1", "1,2,3,1,1,1", "a,1,1,1,1", "1;2;3;1;1"])
def test_anything_but_five_numbers_is_refused(text: str) -> None:
    with pytest.raises(InputError, match="five numbers"):
        read_gains(text)
