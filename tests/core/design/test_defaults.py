"""What is left open is chosen from the process."""

from __future__ import annotations

import math

import numpy as np
import pytest

from fopid_core.design.defaults import gain_sign, natural_crossover, process_gain
from fopid_core.model.process import Process


@pytest.mark.parametrize(
    ("text", "sign"),
    [("-2/(s+1)", -1.0), ("1/(s-1)", 1.0), ("(1-s)/(s+1)^2", 1.0), ("-1/s*exp(-s)", -1.0), ("1/(s^2-s+1)", 1.0),
     ("(s-2)/(s+1)^2", -1.0)],
)  # fmt: skip
def test_the_gains_sign_is_that_which_can_stabilise(text: str, sign: float) -> None:
    assert gain_sign(Process.parse(text)) == sign


@pytest.mark.parametrize(("margin", "turn"), [(60.0, 40.0), (45.0, 45.0), (80.0, 100.0 / 3.0)])
def test_the_natural_crossover_leaves_the_margin_to_proportional_control(margin: float, turn: float) -> None:
    """1/(s+1)^3 turns by three times atan(w)."""
    found = natural_crossover(Process.parse("1/(s+1)^3"), math.radians(margin))
    assert found == pytest.approx(math.tan(math.radians(turn)), rel=0.02)


def test_a_lag_that_passes_the_margin_a_little_and_comes_back_does_not_set_the_crossover() -> None:
    """It is 126 degrees at 0.03 rad/s and 95 at 1 rad/s, and 90 more than the delay's from there on."""
    found = natural_crossover(Process.parse("(10s+1)/(100s+1)^2*exp(-0.01s)"), math.radians(60.0))
    assert found == pytest.approx(math.radians(30.0) / 0.01, rel=0.03)


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
@pytest.mark.parametrize("text", ["1/({0}s+1)^3", "1/({0}s+1)*exp(-{0}s)", "1/({0}s*({0}s+1))"])
def test_the_natural_crossover_goes_with_the_processs_own_time(text: str, scale: float) -> None:
    one = natural_crossover(Process.parse(text.format("1")), 1.0)
    assert natural_crossover(Process.parse(text.format(repr(scale))), 1.0) == pytest.approx(one / scale, rel=0.04)


@pytest.mark.parametrize("text", ["1/s", "2/s", "1/s^2", "1/(s+1)", "3", "1/(s-1)", "1/(s^0.5+1)"])
def test_every_process_has_one(text: str) -> None:
    found = natural_crossover(Process.parse(text), 1.0)
    assert np.isfinite(found)
    assert found > 0.0


def test_a_process_that_only_leads_is_taken_where_it_leads_most() -> None:
    assert natural_crossover(Process.parse("(s+1)/(s+2)"), 1.0) == pytest.approx(math.sqrt(2.0), rel=0.02)


def test_an_integrator_is_measured_where_its_gain_is_one() -> None:
    assert natural_crossover(Process.parse("2/s"), 1.0) == pytest.approx(2.0, rel=0.02)
    assert process_gain(Process.parse("-2/s")) == pytest.approx(-1.0, rel=0.02)


def test_a_process_that_settles_is_measured_by_its_steady_state_gain() -> None:
    assert process_gain(Process.parse("-2/(s+1)^4")) == -2.0


@pytest.mark.parametrize(
    "text",
    ["1/s^2*exp(-{0}s)", "1/(s^2({0}s+1))", "1/({0}^2*s^2-1)*exp(-{0}s)", "1/({0}^2*s^2-0.5*{0}*s+1)",
     "1/(({0}s-1)({0}s-2))", "1/({0}s*({0}s-1))", "1/({0}s-1)*exp(-0.5*{0}s)"],
)  # fmt: skip
@pytest.mark.parametrize("scale", [1e-2, 1.0, 1e2])
def test_a_process_that_takes_a_derivative_has_its_own_time_too(text: str, scale: float) -> None:
    found = natural_crossover(Process.parse(text.format(repr(scale))), math.radians(60.0))
    assert 0.3 < found * scale < 10.0


def test_a_pole_on_a_frequency_of_the_grid_is_passed_by() -> None:
    """1 rad/s is one of them; the lag is half a turn from there on, as beside an oscillator that is not on one."""
    beside = natural_crossover(Process.parse("1/(s^2+1.0001)"), math.radians(60.0))
    assert natural_crossover(Process.parse("1/(s^2+1)"), math.radians(60.0)) == pytest.approx(beside, rel=0.03)


def test_an_unstable_process_with_a_zero_on_the_right_has_gains_of_the_sign_that_stabilises() -> None:
    """1/(s-1) with a zero at 2: the closed loop with a gain k has the coefficients 1, 2 + k, -3 - 2k."""
    assert gain_sign(Process.parse("(s-2)/((s-1)(s+3))")) == -1.0
    assert np.all(np.roots([1.0, 2.0 - 1.75, -3.0 + 3.5]).real < 0.0)
