"""Rules give what their authors promise over their range, and nothing outside it."""

from __future__ import annotations

import math

import numpy as np
import pytest

from fopid_core.design.rules import RULES, Foptd, foptd_of, rule_names
from fopid_core.design.specification import TuningRequest
from fopid_core.design.tuner import tune
from fopid_core.errors import InputError
from fopid_core.model.fopid import Fopid
from fopid_core.model.process import Process, read_process

W = np.geomspace(1e-4, 1e3, 20000)


def loop_of(model: Foptd, controller: Fopid) -> np.ndarray:
    s = 1j * W
    kp, ki, kd, lam, mu = controller.gains
    return model.gain * np.exp(-model.delay * s) / (model.lag * s + 1) * (kp + ki * s**-lam + kd * s**mu)


def crossover_and_margin(loop: np.ndarray) -> tuple[float, float]:
    gain = np.abs(loop)
    i = int(np.flatnonzero((gain[:-1] >= 1.0) & (gain[1:] < 1.0))[0])
    return float(W[i]), float(np.angle(-loop[i]))


def made(name: str, gain: float, lag: float, delay: float) -> Fopid:
    controller = RULES[name].controller(Foptd(gain, lag, delay))
    assert controller is not None
    return controller


@pytest.mark.parametrize("lag", [0.1, 0.5, 1.0, 2.0, 10.0, 20.0, 50.0])
@pytest.mark.parametrize("delay", [0.1, 0.5, 1.0, 1.5])
def test_valerio_gives_the_crossover_and_the_margin_it_was_fitted_for(lag: float, delay: float) -> None:
    """0.5 rad/s and 2/3 rad, to what quadratic fits of the published accuracy keep."""
    crossover, margin = crossover_and_margin(loop_of(Foptd(3.0, lag, delay), made("valerio-1", 3.0, lag, delay)))
    assert crossover == pytest.approx(0.5, abs=0.1)
    assert margin == pytest.approx(2.0 / 3.0, abs=0.25)


@pytest.mark.parametrize(
    ("name", "promised", "spread"),
    [
        ("padula-visioli-setpoint-1.4", 1.4, 0.05),
        ("padula-visioli-setpoint-2.0", 2.0, 0.17),
        ("padula-visioli-load-1.4", 1.4, 0.1),
        ("padula-visioli-load-2.0", 2.0, 0.3),
    ],
)
@pytest.mark.parametrize("relative_delay", [0.15, 0.3, 0.5, 0.7])
def test_padula_and_visioli_keep_the_largest_sensitivity_promised(
    name: str, promised: float, spread: float, relative_delay: float
) -> None:
    """For the series form of the paper, with its derivative filter N = 10 T^(mu - 1)."""
    lag = 2.0
    delay = relative_delay / (1.0 - relative_delay) * lag
    rule = RULES[name]._gains
    tau, ratio = relative_delay, delay / lag
    kp, ti, td = (
        a * x**b + c for (a, b, c), x in ((rule.proportional, tau), (rule.integral, ratio), (rule.derivative, ratio))
    )
    mu = made(name, 1.0, lag, delay).mu
    s = 1j * W / delay
    ti, td = ti * lag, td * lag**mu
    filtered = (td * s**mu + 1) / (td / (10.0 * lag ** (mu - 1.0)) * s + 1)
    loop = np.exp(-delay * s) / (lag * s + 1) * kp * (ti * s + 1) / (ti * s) * filtered
    assert 1.0 / np.abs(1.0 + loop).min() == pytest.approx(promised, abs=spread * promised)


@pytest.mark.parametrize("name", [name for name in RULES if name.startswith("padula")])
def test_the_parallel_form_is_near_the_series_form_of_the_rule(name: str) -> None:
    lag, delay = 2.0, 1.0
    rule = RULES[name]._gains
    kp, ti, td = (
        a * x**b + c for (a, b, c), x in ((rule.proportional, 1.0 / 3.0), (rule.integral, 0.5), (rule.derivative, 0.5))
    )
    controller = made(name, 1.0, lag, delay)
    w = np.geomspace(0.05, 2.0, 50) / delay
    s = 1j * w
    series = kp * (1 + 1 / (ti * lag * s)) * (1 + td * lag**controller.mu * s**controller.mu)
    assert np.abs(controller(s) / series - 1.0).max() < 0.05


@pytest.mark.parametrize("relative_delay", [0.1, 0.2, 0.35, 0.5, 0.7, 0.9])
def test_fmigo_is_stable_and_of_moderate_sensitivity_over_its_range(relative_delay: float) -> None:
    delay = relative_delay / (1.0 - relative_delay)
    controller = made("fmigo", 1.0, 1.0, delay)
    assert controller.kd == 0.0
    assert controller.lam == (1.1 if relative_delay >= 0.6 else 1.0 if relative_delay >= 0.4 else 0.9)
    assert 1.4 < 1.0 / np.abs(1.0 + loop_of(Foptd(1.0, 1.0, delay), controller)).min() < 2.0


def test_simc_and_amigo_are_the_formulas_of_their_books() -> None:
    """K = 2, T = 3, L = 0.5 worked out by hand."""
    assert made("simc-pi", 2.0, 3.0, 0.5).gains[:2] == pytest.approx((1.5, 1.5 / 3.0))
    kp = 0.15 / 2 + (0.35 - 1.5 / 12.25) * 3 / 1.0
    assert made("amigo-pi", 2.0, 3.0, 0.5).gains[:2] == pytest.approx((kp, kp / (0.175 + 58.5 / 28.75)))
    kp = (0.2 + 0.45 * 6) / 2
    expected = (kp, kp / ((0.2 + 2.4) / 0.8 * 0.5), kp * (0.75 / 3.15))
    assert made("amigo-pid", 2.0, 3.0, 0.5).gains[:3] == pytest.approx(expected)


@pytest.mark.parametrize(
    ("name", "model"),
    [
        ("valerio-1", Foptd(1.0, 60.0, 1.0)),
        ("valerio-1", Foptd(1.0, 1.0, 2.5)),
        ("fmigo", Foptd(1.0, 1.0, 0.05)),
        ("padula-visioli-load-1.4", Foptd(1.0, 1.0, 0.01)),
        ("padula-visioli-setpoint-2.0", Foptd(1.0, 1.0, 9.0)),
        ("simc-pi", Foptd(1.0, 1.0, 0.0)),
    ],
)
def test_outside_its_range_a_rule_refuses(name: str, model: Foptd) -> None:
    assert RULES[name].controller(model) is None


def test_a_refusal_names_the_model_and_the_range() -> None:
    result = tune(TuningRequest(Process.parse("1/(100s+1)*exp(-s)"), method="rule", rule="valerio-1"))
    assert (result.success, result.controller) == (False, None)
    assert "T = 100 s" in result.unmet[0]
    assert "0.1 s <= T <= 50 s" in result.unmet[0]


@pytest.mark.parametrize("name", [name for name in rule_names() if name != "dominant-poles"])
def test_every_rule_tunes_the_test_bench_to_a_stable_loop(name: str) -> None:
    for process in ("P1", "P3"):
        result = tune(TuningRequest(read_process(process), method="rule", rule=name))
        assert result.success, result
        assert result.stable


def test_the_model_of_a_first_order_process_is_itself() -> None:
    model = foptd_of(Process.parse("-2/(3s+1)*exp(-0.7s)"))
    assert (model.gain, model.lag, model.delay) == pytest.approx((-2.0, 3.0, 0.7), rel=1e-3)


def test_gains_scale_with_the_inverse_of_the_process_gain() -> None:
    for name in RULES:
        one, other = made(name, 1.0, 2.0, 0.8), made(name, -4.0, 2.0, 0.8)
        assert other.gains[:3] == pytest.approx([-g / 4.0 for g in one.gains[:3]])


def test_dominant_poles_are_where_they_were_asked_for() -> None:
    process = Process.parse("2/(3s^2+s+1)")
    result = tune(TuningRequest(process, method="rule", rule="dominant-poles", crossover=1.5))
    assert result.controller is not None
    kp, ki, kd, _, _ = result.controller.gains
    poles = np.sort_complex(np.roots([3.0, 1.0 + 2.0 * kd, 1.0 + 2.0 * kp, 2.0 * ki]))
    damping = math.sqrt(0.5)
    expected = [-5.0 * damping * 1.5, 1.5 * (-damping - 1j * damping), 1.5 * (-damping + 1j * damping)]
    assert np.allclose(poles, np.sort_complex(expected))


@pytest.mark.parametrize("text", ["P1", "1/(s^2+s+1)*exp(-s)", "(s+1)/(s^2+s+1)", "1/(s^1.5+1)"])
def test_dominant_poles_are_refused_where_they_might_not_dominate(text: str) -> None:
    result = tune(TuningRequest(read_process(text), method="rule", rule="dominant-poles"))
    assert not result.success
    assert "second order" in result.unmet[0]


def test_an_unknown_rule_is_refused_with_all_names() -> None:
    with pytest.raises(InputError, match=r"rule = 'best'; allowed: valerio-1, fmigo"):
        tune(TuningRequest(read_process("P1"), method="rule", rule="best"))


def test_by_default_a_rule_is_taken_that_holds_the_process() -> None:
    """One lag and a delay, of all processes, had no gains: a derivative of order 1.1 holds none."""
    found = tune(TuningRequest(Process.parse("2/(10s+1)*exp(-3s)"), method="rule"))
    assert found.success
    assert found.message.startswith("rule simc-pi by default")
