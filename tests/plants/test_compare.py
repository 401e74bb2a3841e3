"""The comparison is fair to the rules, and says who won."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from compare import Row, verdict
from foreign_plants.gallery import GALLERY
from judging import Judgement, judge
from step_test import Lags, StepTest, _read, amigo, simc, step_test

SEEN = Judgement(1.0, 1.0, 5.0, 1.0, 10.0, 0.001, True)


def test_a_step_reads_lags_and_delay() -> None:
    time = np.arange(0.0, 60.0, 0.1)
    t = np.maximum(time - 2.0, 0.0)
    one = _read(time, 1.5 * (1.0 - np.exp(-t / 5.0)), 0.5, 0.1, 1)
    two = _read(time, 1.5 * (1.0 - (5.0 * np.exp(-t / 5.0) - np.exp(-t)) / 4.0), 0.5, 0.1, 2)
    assert one is not None
    assert (one.gain, one.delay, one.lags[0]) == pytest.approx((3.0, 2.0, 5.0), rel=0.01)
    assert two is not None
    assert (two.gain, two.delay, *two.lags) == pytest.approx((3.0, 2.0, 5.0, 1.0), rel=0.02)


def test_a_plant_that_runs_away_has_no_step_test() -> None:
    assert step_test(GALLERY["levitation"]).one is None


def test_the_rules_are_as_published() -> None:
    model = Lags(2.0, 1.0, (8.0, 0.0), 99.0)
    test = StepTest(model, Lags(2.0, 1.0, (8.0, 2.0), 99.0), 1.0, True)
    pi, pid = simc(test, 0.0, 1.0).values()
    assert (pi.kp, pi.ki) == pytest.approx((2.0, 2.0 / 8.0))
    assert (pid.kp, pid.ki, pid.kd) == pytest.approx((2.0 * 1.25, 2.0 / 8.0, 4.0))  # the series form, multiplied out
    slow_pi, quick_pid = amigo(test, 0.0).values()
    assert slow_pi.kp == pytest.approx(0.15 / 2.0 + (0.35 - 8.0 / 81.0) * 8.0 / 2.0)
    assert (quick_pid.kp, quick_pid.kp / quick_pid.ki) == pytest.approx((0.5 * (0.2 + 3.6), 6.8 / 1.8))


def test_the_verdict_tells_a_loss_and_a_win() -> None:
    start, rule = Row("start", SEEN), Row("SIMC PI", replace(SEEN, load=0.5))
    won = Row("autotune", replace(SEEN, load=0.4))
    lost = Row("autotune", replace(SEEN, load=0.6))
    loud = Row("autotune", replace(SEEN, load=0.4, variation=20.0))
    worse = Row("autotune", replace(SEEN, load=1.2))
    assert [verdict([start, rule, ours])[1] for ours in (won, lost, loud, worse)] == [True, False, False, False]
    assert verdict([start, rule, lost])[0].startswith("SIMC PI")
    assert "worse than the start" in verdict([start, rule, worse])[0]


def test_a_judgement_is_of_the_true_output() -> None:
    seen = judge("flexible_joint", {})
    assert seen.calm
    assert seen.setpoint == pytest.approx(0.72, abs=0.05)
    assert math.isfinite(seen.settling)
