"""Margins are what python-control finds at integer orders, and what they promise at all others."""

from __future__ import annotations

import math

import control
import numpy as np
import pytest

from fopid_core.model.fopid import Fopid
from fopid_core.model.loop import Loop
from fopid_core.model.margins import margins
from fopid_core.model.process import Process, read_process
from fopid_core.model.stability import stability

INTEGER_LOOPS = [
    ("P1", (2.0, 0.5, 1.0)),
    ("P2", (1.0, 1.0, 1.0)),
    ("P3", (1.5, 0.47, 1.46)),
    ("P4", (3.0, 3.0, 0.5)),
    ("1/(s(s+1)(0.1s+1))", (2.0, 0.1, 1.0)),
    ("(1-0.5s)/((s+1)(2s+1))", (0.8, 0.3, 0.2)),
    ("2/((s-1)(0.1s+1))", (3.0, 1.0, 0.1)),
    ("1/(s^2+0.02s+1)", (0.5, 0.2, 1.0)),
    ("4/((s+1)(s^2+0.01s+4))", (0.008, 0.002, 0.0)),
]
FRACTIONAL_LOOPS = [
    ("P1", (2.9692, 0.8028, 1.3394, 1.0138, 0.6074)),
    ("P4", (28.9897, 32.6211, 22.3986, 0.333, 1.6265)),
    ("1/(s+1)*exp(-1s)", (0.6, 0.5, 0.2, 0.9, 0.5)),
    ("1/(0.8s^2.2+0.5s^0.9+1)*exp(-0.3s)", (0.3, 0.3, 0.3, 1.1, 0.6)),
    ("0.5/s*exp(-0.5s)", (1.0, 0.1, 0.1, 1.1, 0.3)),
    ("2/(s-1)*exp(-0.1s)", (2.0, 1.0, 0.1, 0.9, 0.5)),
]


def loop_of(process: str, gains: tuple[float, ...]) -> Loop:
    return Loop(read_process(process), Fopid(*gains))


@pytest.mark.parametrize(("process", "gains"), INTEGER_LOOPS)
def test_at_integer_orders_they_are_python_controls(process: str, gains: tuple[float, ...]) -> None:
    loop = loop_of(process, gains)
    kp, ki, kd = gains
    numerator, denominator, _ = loop.process.polynomials()
    system = control.tf([kd, kp, ki], [1.0, 0.0]) * control.tf(numerator, denominator)
    found = margins(loop)
    gain_margins, phase_margins, _, phase_crossovers, crossovers, _ = control.stability_margins(system, returnall=True)
    real = [(g, w) for g, w in zip(gain_margins, phase_crossovers, strict=True) if w > 0.0]
    assert sorted(found.crossovers) == pytest.approx(sorted(crossovers), rel=1e-6)
    assert sorted(found.phase_crossovers) == pytest.approx(sorted(w for _, w in real), rel=1e-6)
    assert abs(math.degrees(found.phase_margin)) == pytest.approx(min(abs(phase_margins)), rel=1e-6)
    nearest = min((g for g, _ in real), key=lambda g: abs(math.log(g)), default=math.inf)
    assert found.gain_margin == pytest.approx(nearest, rel=1e-6)


@pytest.mark.parametrize(("process", "gains"), INTEGER_LOOPS + FRACTIONAL_LOOPS)
def test_peaks_are_the_largest_values_on_a_fine_grid(process: str, gains: tuple[float, ...]) -> None:
    loop = loop_of(process, gains)
    w = np.logspace(-5, 5, 400_001)
    value = loop.controller(1j * w) * loop.process(1j * w)
    found = margins(loop)
    for peak, brute in ((found.ms, abs(1 / (1 + value))), (found.mt, abs(value / (1 + value)))):
        assert brute.max() * (1 - 1e-12) <= peak
        assert peak == pytest.approx(brute.max(), rel=1e-3)  # the grid's step over the sharpest resonance, squared
    assert found.jitter_margin <= 1.0 / np.max(w * abs(value / (1 + value))) * (1 + 1e-9)


@pytest.mark.parametrize(("process", "gains"), INTEGER_LOOPS + FRACTIONAL_LOOPS)
def test_crossovers_are_where_the_gain_is_one(process: str, gains: tuple[float, ...]) -> None:
    loop = loop_of(process, gains)
    w = np.logspace(-5, 5, 400_001)
    gain = np.abs(loop.controller(1j * w) * loop.process(1j * w))
    changes = w[:-1][np.diff(np.sign(gain - 1.0)) != 0.0]
    found = margins(loop)
    assert found.crossovers == pytest.approx(changes, rel=1e-4)
    for crossover in found.crossovers:
        assert abs(complex(loop(1j * crossover))) == pytest.approx(1.0, rel=1e-11)


@pytest.mark.parametrize(("process", "gains"), INTEGER_LOOPS + FRACTIONAL_LOOPS)
def test_the_phase_slope_is_the_slope_of_the_phase(process: str, gains: tuple[float, ...]) -> None:
    loop, found = loop_of(process, gains), margins(loop_of(process, gains))
    h = 1e-6 * found.crossover
    around = loop(1j * (found.crossover + np.array([-h, h])))
    assert found.phase_slope == pytest.approx(np.angle(around[1] / around[0]) / (2 * h), rel=1e-4, abs=1e-7)


@pytest.mark.parametrize(("process", "gains"), INTEGER_LOOPS + FRACTIONAL_LOOPS)
def test_the_loop_tolerates_its_delay_margin_and_no_more(process: str, gains: tuple[float, ...]) -> None:
    loop = loop_of(process, gains)
    delay = margins(loop).delay_margin
    for factor, stable in ((0.999, True), (1.001, False)):
        assert stability(Loop(loop.process.delayed(delay * factor), loop.controller)).stable == stable


@pytest.mark.parametrize(("process", "gains"), INTEGER_LOOPS + FRACTIONAL_LOOPS)
def test_the_loop_tolerates_its_gain_margin_and_no_more(process: str, gains: tuple[float, ...]) -> None:
    loop = loop_of(process, gains)
    margin = margins(loop).gain_margin
    if math.isinf(margin):
        assert stability(Loop(loop.process.scaled(1e3), loop.controller)).stable
        return
    for exponent, stable in ((0.999, True), (1.001, False)):
        assert stability(Loop(loop.process.scaled(margin**exponent), loop.controller)).stable == stable


def test_the_jitter_margin_of_a_lag_is_that_of_its_bandwidth() -> None:
    # T = 2 / (s + 3): w |T| rises towards 2, so delays that vary within 0.5 s do no harm
    assert margins(loop_of("1/(s+1)", (2.0,))).jitter_margin == pytest.approx(0.5)


def test_the_phase_margin_of_an_integrator_is_a_right_angle() -> None:
    found = margins(loop_of("1/s", (2.0,)))
    assert (found.phase_margin, found.crossover) == pytest.approx((math.pi / 2, 2.0))
    assert found.delay_margin == pytest.approx(math.pi / 4)
    assert (found.gain_margin, found.phase_crossovers) == (math.inf, ())


def test_a_fractional_integrator_has_a_flat_phase() -> None:
    found = margins(loop_of("1/s^1.4", (3.0,)))
    assert found.phase_margin == pytest.approx(0.6 * math.pi / 2)
    assert found.phase_slope == pytest.approx(0.0, abs=1e-12)


def test_a_small_delay_gives_a_gain_margin_at_high_frequency() -> None:
    found = margins(loop_of("1/(s+1)*exp(-0.001s)", (1.0,)))
    w = found.phase_crossover
    assert 0.001 * w + math.atan(w) == pytest.approx(math.pi)
    assert found.gain_margin == pytest.approx(math.hypot(1.0, w))


def test_margins_that_do_not_exist_are_infinite_or_nan() -> None:
    found = margins(loop_of("1/(s+1)", (0.5,)))
    assert (found.phase_margin, found.gain_margin, found.delay_margin) == (math.inf, math.inf, math.inf)
    assert math.isnan(found.crossover)
    assert math.isnan(found.phase_slope)
    assert (found.ms, found.ms_frequency) == (1.0, math.inf)
    assert (found.mt, found.mt_frequency) == (pytest.approx(1.0 / 3.0), 0.0)


def test_a_loop_without_feedback_has_the_margins_of_none() -> None:
    found = margins(loop_of("P1", (0.0,)))
    assert (found.ms, found.mt, found.phase_margin, found.crossovers) == (1.0, 0.0, math.inf, ())


@pytest.mark.parametrize(("process", "gains"), [("P1", (9.0,)), ("1/(s-1)", (0.5,)), ("1/s", (0.0,))])
def test_a_loop_that_is_not_stable_tolerates_no_delay(process: str, gains: tuple[float, ...]) -> None:
    found = margins(loop_of(process, gains))
    assert (found.delay_margin, found.jitter_margin) == (0.0, 0.0)


def test_a_loop_gain_above_one_at_infinity_tolerates_no_delay() -> None:
    assert margins(loop_of("(2s+1)/(s+1)", (3.0,))).delay_margin == 0.0
    assert margins(loop_of("(2s+1)/(s+1)", (0.3,))).delay_margin == math.inf


def test_a_pole_at_the_origin_that_no_term_shows_makes_the_peaks_infinite() -> None:
    found = margins(loop_of("1/(1-exp(-s)+s^2)", (0.0, 0.0, 0.1)))  # the denominator vanishes at s = 0 by cancellation
    assert found.ms == math.inf


def test_a_neutral_loop_has_the_sensitivity_peak_of_its_gain_at_infinity() -> None:
    found = margins(Loop(Process.parse("1/(s+1)*exp(-1s)"), Fopid(0.3, 0.5, 0.5, 0.9, 1.0)))
    assert found.ms == pytest.approx(1.0 / (1.0 - 0.5))


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("tiny", [1e-300, 1e-308])
def test_a_loop_that_is_next_to_nothing_has_all_the_margin_there_is(tiny: float) -> None:
    found = margins(Loop(read_process("1/(s+1)^3"), Fopid(tiny)))
    assert (found.ms, found.phase_margin) == (1.0, math.inf)
    assert found.gain_margin == pytest.approx(8.0 / tiny, rel=1e-6)  # infinite where that is beyond all numbers


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("gain", [0.1, 0.5])
def test_a_double_pole_on_the_axis_is_no_surprise(gain: float) -> None:
    # S = (1 - w^2)^2 / ((1 - w^2)^2 + gain) is at most its limit; s^2 = -1 +- j sqrt(gain) has roots on the right.
    loop = Loop(read_process("1/(s^2+1)^2"), Fopid(gain))
    assert margins(loop).ms == pytest.approx(1.0, abs=1e-9)
    assert not stability(loop).stable


def test_the_gain_margin_of_a_loop_that_rises_to_its_limit_is_that_at_infinity() -> None:
    """abs(L) is 0.12 at its first phase crossover and 0.1423 = kd / T where the delay turns without end."""
    found = margins(Loop(Process.parse("1/(1.376s^0.5+1)*exp(-1.919s)"), Fopid(0.02094, 0.135, 0.1958048, 0.5, 0.5)))
    assert found.gain_margin == pytest.approx(1.376 / 0.1958048, rel=1e-9)
    assert found.phase_crossover == math.inf
