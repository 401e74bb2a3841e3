"""What the rules make of a learnt process, also where its steady state is not to be seen."""

from __future__ import annotations

import math

import numpy as np
import pytest

from fopid_core.design.rules import Foptd, simc_pi
from fopid_core.design.textbook import (
    INTEGRATES,
    RULE_FILTER,
    SLOWER,
    TwoLags,
    read_lag,
    read_two_lags,
    simc_pid,
    textbook_loops,
)
from fopid_core.model.loop import Loop
from fopid_core.model.margins import margins
from fopid_core.model.process import Process
from fopid_core.model.stability import stability


@pytest.mark.parametrize("text", ["3/s*exp(-2s)", "3e4/(1e4s+1)*exp(-2s)", "3e8/(1e8s+1)*exp(-2s)"])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_an_integrator_in_all_but_name_is_read_as_one(text: str, sign: float) -> None:
    read = read_lag(Process.parse(f"{sign:g}*{text}"), 0.2)
    assert read.gain / read.lag == pytest.approx(3.0 * sign, rel=1e-3)
    assert read.delay == pytest.approx(2.0, rel=2e-3)


@pytest.mark.parametrize("w", [0.05, 0.1, 0.3])
def test_what_is_read_has_the_gain_and_phase_of_the_process_there(w: float) -> None:
    process = Process.parse("5e4/((1e5s+1)(3s+1)^2)*exp(-s)")
    read = read_lag(process, w)
    integrates = read.gain / read.lag * np.exp(-1j * w * read.delay) / (1j * w)
    assert abs(integrates / process(1j * w) - 1.0) < 1e-9


def test_a_process_whose_steady_state_is_seen_is_read_with_it() -> None:
    read = read_lag(Process.parse("2/(3s+1)*exp(-0.5s)"), 1.0)
    assert (read.gain, read.lag, read.delay) == pytest.approx((2.0, 3.0, 0.5), rel=1e-3)


def test_rules_hold_an_integrator_with_the_margins_of_the_textbooks() -> None:
    """Skogestad (2003), table 4: an integrating process has Ms 1.70; slower is calmer."""
    loops = list(textbook_loops(Process.parse("1e5/(1e5s+1)*exp(-2s)"), 0.2))
    found = [Loop(Process.parse("1/s*exp(-2s)"), controller, slow) for controller, slow in loops]
    assert len(found) == 2 + 2 * len(SLOWER)
    assert all(stability(loop).stable for loop in found)
    ms = [margins(loop).ms for loop in found]
    pi, pid = ms[2::2], ms[3::2]
    assert pi[0] == pytest.approx(1.70, abs=0.02)
    assert pid[0] == pytest.approx(1.70, abs=0.05), "without a second lag the PID is the PI"
    assert all(each == sorted(each, reverse=True) for each in (pi, pid))
    assert ms[1] == pytest.approx(1.4, abs=0.1), "AMIGO was made for 1.4"


def test_what_rules_cannot_read_has_no_textbook() -> None:
    assert list(textbook_loops(Process.parse("1/(s-1)"), 1.0)) == []
    assert list(textbook_loops(Process.parse("s/(s+1)"), 1e3)) == []


def test_slower_is_simc_with_another_closed_loop_time_constant() -> None:
    """K = 2, T = 3, L = 0.5, by hand: tau = 2 s, so that kp = 3 / (2 2.5), ti = 3."""
    assert simc_pi(Foptd(2.0, 3.0, 0.5), 4.0).gains[:2] == pytest.approx((0.6, 0.2))
    assert simc_pi(Foptd(2.0, 3.0, 0.5)).gains[:2] == pytest.approx((1.5, 0.5))


def test_the_limit_of_the_rules_for_an_integrator_is_reached() -> None:
    near, far = (simc_pi(Foptd(lag, lag, 1.0)) for lag in (INTEGRATES, 1e9))
    assert near.gains[:2] == pytest.approx(far.gains[:2], rel=0.01)
    assert math.isclose(far.kp, 0.5)


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize(
    ("slow", "fast", "delay"), [(20.0, 4.0, 1.0), (1e4, 3.0, 2.0), (5.0, 5.0, 0.5), (6.0, 0.5, 4.0)]
)
def test_two_lags_are_read_about_the_crossover(sign: float, slow: float, fast: float, delay: float) -> None:
    process = Process.parse(f"{sign:g}*2/(({slow:g}s+1)({fast:g}s+1))*exp(-{delay:g}s)")
    read = read_two_lags(process, 0.2)
    assert read.gain / read.slow == pytest.approx(sign * 2.0 / slow, rel=1e-3)
    assert (read.fast, read.delay) == pytest.approx((fast, delay), rel=1e-2)


def test_lags_beyond_the_second_are_read_as_half_of_them_and_delay() -> None:
    """By hand: Skogestad (2003), example E1, lags 1 and 0.22 and a delay of 0.028."""
    read = read_two_lags(Process.parse("1/((s+1)(0.2s+1)(0.04s+1)(0.008s+1))"), 5.0)
    assert read.slow == pytest.approx(1.0, rel=0.02)
    assert 0.2 <= read.fast <= 0.24
    assert 0.02 <= read.delay <= 0.048


def test_without_a_delay_half_the_second_lag_bounds_the_gain_of_a_pid() -> None:
    gains, slow = simc_pid(TwoLags(2.0, 10.0, 4.0, 0.0))
    assert gains == simc_pid(TwoLags(2.0, 10.0, 4.0, 2.0))[0]
    assert (slow.order, slow.time) == (1, pytest.approx(RULE_FILTER * 4.0))
