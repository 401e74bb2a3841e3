"""What a design achieves is measured on the loop, at every frequency of the bounds' bands."""

from __future__ import annotations

import math

import pytest

from fopid_core.design.specification import Bound
from fopid_core.design.verification import achieved
from fopid_core.model.fopid import Fopid
from fopid_core.model.loop import Loop
from fopid_core.model.process import Process


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
