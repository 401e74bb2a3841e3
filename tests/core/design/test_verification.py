"""What a design achieves is measured on the loop, at every frequency of the bounds' bands."""

from __future__ import annotations

import math

import numpy as np
import pytest

from fopid_core.design.specification import Bound, Bounds
from fopid_core.design.verification import achieved, checks
from fopid_core.model.fopid import Fopid
from fopid_core.model.loop import Loop
from fopid_core.model.process import Process
from fopid_core.runtime.controller import ControllerSettings, FopidController


def test_margins_of_a_known_loop() -> None:
    """2/(s+1)^3: the gain margin is 4, at sqrt(3) rad/s."""
    found = achieved(Loop(Process.parse("1/(s+1)^3"), Fopid(kp=2.0)))
    assert found.gain_margin_db == pytest.approx(20.0 * math.log10(4.0))
    crossover = math.sqrt(2.0 ** (2.0 / 3.0) - 1.0)
    assert found.crossover == pytest.approx(crossover)
    assert found.phase_margin == pytest.approx(math.pi - 3.0 * math.atan(crossover))
    assert math.isnan(found.t_db)
    assert math.isnan(found.s_db)


def test_the_largest_value_of_a_band_counts_not_that_at_its_edge() -> None:
    """|T| of 1/(s^2+0.1s) peaks at 1 rad/s, a factor of two beyond the edge."""
    found = achieved(Loop(Process.parse("1/(s^2+0.1s)"), Fopid(kp=1.0)), t_max=Bound(0.0, 0.5), s_max=Bound(0.0, 0.5))
    assert found.t_db == pytest.approx(20.0, abs=0.1)
    assert found.s_db < 0.0


def test_a_loop_without_gain_margin_says_so() -> None:
    assert achieved(Loop(Process.parse("1/(s+1)"), Fopid(kp=2.0))).gain_margin_db == math.inf


def check_of(loop: Loop, **bounds: object) -> tuple[bool, str]:
    (check,) = checks(loop, Bounds(**bounds))  # type: ignore[arg-type]
    return check.holds, str(check)


def test_a_bound_holds_to_one_part_in_a_million() -> None:
    """Max |S| of 2 / (s (s + 2)): |S|^2 = (w^4 + 4 w^2) / (w^4 + 4), largest at w^2 = 1 + sqrt(5)."""
    loop = Loop(Process.parse("1/(s(s+2))"), Fopid(kp=2.0))
    x = 1.0 + math.sqrt(5.0)
    ms = math.sqrt((x * x + 4.0 * x) / (x * x + 4.0))
    assert check_of(loop, ms_max=ms * (1.0 + 1e-7))[0]
    assert check_of(loop, ms_max=ms * (1.0 - 5e-7))[0]
    assert not check_of(loop, ms_max=ms * (1.0 - 2e-6))[0]


def test_a_bound_that_is_barely_broken_shows_the_digit_that_breaks_it() -> None:
    loop = Loop(Process.parse("1/(s+1)^3"), Fopid(kp=2.0))
    ms = achieved(loop).ms
    holds, text = check_of(loop, ms_max=float(f"{ms - 2e-5:.5g}"))
    bound, value = text.removeprefix("max |S| <= ").removesuffix(" on the process itself").split(": ")
    assert not holds
    assert float(bound) < float(value)


def test_what_is_not_known_is_no_bound_kept() -> None:
    holds, text = check_of(Loop(Process.parse("1/(s+1)^3"), Fopid(kp=8.0)), ms_max=1e9)
    assert not holds
    assert "not known" in text


def test_the_noise_gain_is_bounded_up_to_the_nyquist_frequency_of_the_controller() -> None:
    """|C S| of kp + kd s on 1 / (s + 1)^3 rises with frequency: to 1 + 0.1 pi / h."""
    loop = Loop(Process.parse("1/(s+1)^3"), Fopid(1.0, 0.0, 0.1))
    nyquist = abs(1.0 + 0.1j * math.pi / 0.01)
    assert check_of(loop, noise_max=1.001 * nyquist)[0]
    assert not check_of(loop, noise_max=0.999 * nyquist)[0]
    assert check_of(loop, noise_max=0.999 * nyquist, sample_time=0.011)[0]


def test_the_whole_control_counts_where_a_horizon_is_given() -> None:
    """An integral alone: the control begins at 0 and goes past what holds the setpoint."""
    loop = Loop(Process.parse("1/(s+1)^3"), Fopid(0.0, 0.4))
    assert check_of(loop, u_max=1.05)[0]
    assert not check_of(loop, u_max=1.05, horizon=30.0)[0]


@pytest.mark.parametrize("mu", [0.3, 0.6, 0.88, 1.0])
def test_the_kick_that_comes_back_through_a_delay_is_that_of_the_running_controller(mu: float) -> None:
    """The ideal control is infinite there for mu above one half. Beside it the loop tick by tick, its process exact."""
    gains, h, ticks = Fopid(1.268, 0.58, 0.2547, 0.9993, mu), 0.01, 4000
    controller = FopidController(ControllerSettings(gains, h))
    decay, waiting, output, controls = math.exp(-h / 2.0), [0.0] * 100, 0.0, []
    for _ in range(ticks):
        controls.append(controller.step(1.0, output))
        waiting.append(controls[-1])
        output = decay * output + (1.0 - decay) * waiting.pop(0)
    (check,) = checks(Loop(Process.parse("1/(2s+1)*exp(-s)"), gains), Bounds(u_max=50.0, horizon=40.0, sample_time=h))
    assert check.holds
    assert max(np.abs(controls)) <= check.value * 1.001
    assert check.value == pytest.approx(controls[0])
