"""A peak is what exact algebra finds it to be, however narrow it is and wherever it stands."""

from __future__ import annotations

import math

import mpmath
import numpy as np
import pytest

from fopid_core.model.fopid import Fopid
from fopid_core.model.loop import Loop
from fopid_core.model.loop_peaks import LoopPeaks
from fopid_core.model.margins import margins
from fopid_core.model.process import Process
from fopid_core.model.stability import stability


def even_part(coefficients: list[mpmath.mpf]) -> list[mpmath.mpf]:
    """abs(p(jw))^2 as a polynomial in w^2, lowest power first; p with its lowest power first."""
    square = [mpmath.mpf(0)] * len(coefficients)
    for i, a in enumerate(coefficients):
        for j, b in enumerate(coefficients):
            if (i + j) % 2 == 0:
                square[(i + j) // 2] += a * b * (-1) ** ((i - j) // 2)
    return square


def product(a: list[mpmath.mpf], b: list[mpmath.mpf]) -> list[mpmath.mpf]:
    out = [mpmath.mpf(0)] * (len(a) + len(b) - 1)
    for i, x in enumerate(a):
        for j, y in enumerate(b):
            out[i + j] += x * y
    return out


def slope(a: list[mpmath.mpf]) -> list[mpmath.mpf]:
    return [i * x for i, x in enumerate(a)][1:] or [mpmath.mpf(0)]


def algebraic_peak(over: list[float], under: list[float]) -> float:
    """max abs(over / under) on the axis: the roots of the derivative of its square, in 40 digits."""
    with mpmath.workdps(40):
        n, d = (even_part([mpmath.mpf(x) for x in part]) for part in (over, under))
        left, right = product(slope(n), d), product(n, slope(d))
        size = max(len(left), len(right))
        left, right = (part + [mpmath.mpf(0)] * (size - len(part)) for part in (left, right))
        stationary = [a - b for a, b in zip(left, right, strict=True)]
        while stationary and stationary[-1] == 0:
            stationary.pop()
        roots = mpmath.polyroots(stationary[::-1], maxsteps=500, extraprec=400) if len(stationary) > 1 else []
        places = [r.real for r in roots if abs(r.imag) < 1e-15 * (1 + abs(r.real)) and r.real > 0]
        values = [sum(a * x**i for i, a in enumerate(n)) / sum(b * x**i for i, b in enumerate(d)) for x in places]
        values += [n[0] / d[0]] if d[0] else []
        values += [n[-1] / d[-1]] if len(n) == len(d) else []
        return float(mpmath.sqrt(max(values)))


@pytest.mark.filterwarnings("ignore:Descending:DeprecationWarning")
@pytest.mark.parametrize("seed", range(12))
def test_peaks_of_rational_loops_are_those_of_algebra(seed: int) -> None:
    """Resonances of damping down to 1e-6, over decades of frequency."""
    rng = np.random.default_rng(seed)
    damping, natural = 10.0 ** rng.uniform(-6, 0), 10.0 ** rng.uniform(-2, 2)
    lag, kp, kd = 10.0 ** rng.uniform(-2, 2), 10.0 ** rng.uniform(-3, 0), 10.0 ** rng.uniform(-3, 0)
    denominator = np.polymul([1.0 / natural**2, 2.0 * damping / natural, 1.0], [lag, 1.0])
    text = "+".join(f"{c!r}*s^{len(denominator) - 1 - i}" for i, c in enumerate(denominator.tolist()))
    loop = Loop(Process.parse(f"1/({text})"), Fopid(kp, 0.0, kd, 1.0, 1.0))
    opened, forward = denominator[::-1].tolist(), [kp, kd]
    closed = [a + (forward[i] if i < 2 else 0.0) for i, a in enumerate(opened)]
    found = LoopPeaks(loop)
    assert found.sensitivity().value == pytest.approx(algebraic_peak(opened, closed), rel=1e-6)
    assert found.complementary().value == pytest.approx(algebraic_peak(forward, closed), rel=1e-6)
    band = (0.0, 10.0)
    w = np.linspace(0.0, 10.0, 20_001)[1:]
    least = np.abs((kp + kd * 1j * w) * np.polyval(denominator, 1j * w) / np.polyval(closed[::-1], 1j * w)).max()
    assert found.noise_gain(band).value >= least * (1.0 - 1e-9)


def test_a_resonance_far_behind_many_turns_of_the_delay_is_found() -> None:
    """|L| is 0.5 at the resonance, where the delay's phase has turned by 10,000 rad: |S| there is 1 / (1 - 0.5)."""
    loop = Loop(Process.parse("1/(s^2+0.1s+1)*exp(-1e4s)"), Fopid(kp=0.05))
    w = np.linspace(0.99, 1.0, 1_000_001)
    response = 0.05 / (1.0 - w**2 + 0.1j * w) * np.exp(-1e4j * w)
    assert LoopPeaks(loop).sensitivity().value == pytest.approx((1.0 / np.abs(1.0 + response)).max(), rel=1e-6)


def test_on_a_band_the_peak_may_stand_at_its_edge() -> None:
    loop = Loop(Process.parse("1/(s+1)"), Fopid(kp=1.0))
    found = LoopPeaks(loop).complementary((3.0, math.inf))
    assert (found.value, found.frequency) == (pytest.approx(1.0 / abs(3j + 2.0)), pytest.approx(3.0))


def test_orders_so_small_that_they_act_at_the_smallest_frequencies_are_decided() -> None:
    loop = Loop(Process.parse("1/(s+1)"), Fopid(28.0, 0.018, 0.0, 0.01, 1.0))
    assert stability(loop).stable
    found = margins(loop)
    w = np.geomspace(1e-3, 1e6, 2_000_001)
    response = (28.0 + 0.018 * (1j * w) ** -0.01) / (1.0 + 1j * w)
    assert found.ms == pytest.approx(max(1.0, (1.0 / np.abs(1.0 + response)).max()), rel=1e-9)
    assert found.crossover == pytest.approx(w[np.argmin(np.abs(np.log(np.abs(response))))], rel=1e-4)


def test_what_is_not_decided_has_no_peak_and_says_why() -> None:
    loop = Loop(Process.parse("1/(s+1)^3"), Fopid(kp=8.0))
    assert math.isnan(margins(loop).ms)
    assert stability(loop).reason == "too close to the border to call"
    neutral = Loop(Process.parse("1/(s+1)*exp(-s)"), Fopid(0.0, 0.0, 1.0, 1.0, 1.0))
    assert "gain at high frequency is 1" in stability(neutral).reason


@pytest.mark.parametrize("seed", range(3))
def test_a_delay_inside_the_process_hides_no_peak_however_fast_it_turns(seed: int) -> None:
    """Beyond the last frequency of the grid |S| is within 1e-6 of its limit there, 1 or with a derivative less."""
    rng, known = np.random.default_rng(seed), 0
    for _ in range(20):
        lag, order = float(10.0 ** rng.uniform(-2.0, 1.0)), float(rng.choice([0.7, 0.9, 1.0, 1.2]))
        share, delay = float(rng.uniform(-0.9, 0.9)), float(lag * 10.0 ** rng.uniform(-2.0, 1.0))
        gains = Fopid(*10.0 ** rng.uniform(-1.0, 1.0, 2) / (1.0, lag), kd=float(rng.choice([0.0, 0.1])) * lag)
        loop = Loop(Process.parse(f"1/({lag!r}*s^{order}+1+({share!r})*exp(-{delay!r}*s))"), gains)
        if not stability(loop).stable:
            continue
        s = 1j * np.geomspace(1e-4, 1e4, 200_001) / lag
        process = 1.0 / (lag * s**order + 1.0 + share * np.exp(-delay * s))
        sensitivity = np.abs(1.0 / (1.0 + process * (gains.kp + gains.ki / s + gains.kd * s)))
        peak, limit = (
            margins(loop).ms,
            1.0 if order > 1.0 or not gains.kd else 1.0 / (1.0 + gains.kd / lag * (order == 1.0)),
        )
        assert sensitivity.max() * (1.0 - 1e-9) <= peak <= max(sensitivity.max(), limit) * (1.0 + 1e-3)
        known += 1
    assert known > 10


def test_where_s_comes_to_its_largest_at_infinity_that_is_found() -> None:
    found = LoopPeaks(Loop(Process.parse("1/(s+1+0.5*exp(-s))"), Fopid(1.0, 1.0))).sensitivity()
    assert found.value == pytest.approx(1.0, abs=1e-8)
