"""The gains in other forms are the same controller, or there is no such form."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fopid_core.errors import InputError
from fopid_core.model.fopid import Fopid
from fopid_core.model.pid_forms import series_form, standard_form

S = np.array([0.01j, 1j, 30j, 1 + 2j])
gains = st.floats(0.01, 100.0)
orders = st.floats(0.2, 1.9)


@given(gains, gains, gains, orders, orders, st.sampled_from([1.0, -1.0]))
def test_the_standard_form_multiplied_out_is_the_controller(
    kp: float, ki: float, kd: float, lam: float, mu: float, sign: float
) -> None:
    controller = Fopid(sign * kp, sign * ki, sign * kd, lam, mu)
    form = standard_form(controller)
    value = form.gain * (1.0 + (form.integral_time * S) ** -lam + (form.derivative_time * S) ** mu)
    assert value == pytest.approx(controller(S), rel=1e-9)


@given(gains, st.floats(0.1, 100.0), st.floats(0.0, 1.0))
def test_the_series_form_multiplied_out_is_the_controller(gain: float, ti: float, share: float) -> None:
    td = share * ti / 4.0
    controller = Fopid(gain, gain / ti, gain * td)
    form = series_form(controller)
    value = form.gain * (1.0 + 1.0 / (form.integral_time * S)) * (1.0 + form.derivative_time * S)
    assert value == pytest.approx(controller(S), rel=1e-9)


def test_without_an_action_its_time_is_infinite_or_zero() -> None:
    assert standard_form(Fopid(2.0)).integral_time == math.inf
    assert series_form(Fopid(2.0, 0.5)).derivative_time == 0.0
    assert series_form(Fopid(2.0, 0.0, 1.0)) == standard_form(Fopid(2.0, 0.0, 1.0))


@pytest.mark.parametrize(
    ("controller", "said"),
    [
        (Fopid(1.0, 1.0, 1.0), "Ti of at least 4 Td"),
        (Fopid(1.0, 1.0, 0.1, 0.9), "orders of 1"),
    ],
)
def test_a_series_form_that_does_not_exist_is_refused(controller: Fopid, said: str) -> None:
    with pytest.raises(InputError, match=said):
        series_form(controller)


@pytest.mark.parametrize("controller", [Fopid(0.0, 1.0), Fopid(1.0, -1.0), Fopid(1.0, 1.0, lam=0.0)])
def test_a_standard_form_that_does_not_exist_is_refused(controller: Fopid) -> None:
    with pytest.raises(InputError):
        standard_form(controller)
