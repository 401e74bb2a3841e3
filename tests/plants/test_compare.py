"""The comparison is fair to the rules, and says who won."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from compare import Row, verdict
from foreign_plants.gallery import GALLERY
from judging import SEEDS, Judgement, Judgements, judge
from step_test import Lags, StepTest, _read, amigo, simc, step_test

SEEN = Judgement(1.0, 1.0, 1.0, 5.0, 1.0, 10.0, 0.001, True)


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


def seen(load: float = 1.0, variation: float = 10.0, noise: float = 0.1, own: float = 0.0) -> Judgements:
    """Four runs, whose load error changes by the noise common to all, and by noise of its own."""
    common, alone = (-1.0, 1.0, -1.0, 1.0), (1.0, 1.0, -1.0, -1.0)
    runs = zip(common, alone, strict=True)
    return Judgements(tuple(replace(SEEN, load=load + noise * a + own * b, variation=variation) for a, b in runs))


def test_the_verdict_tells_a_loss_and_a_win() -> None:
    start, rule = Row("start", seen()), Row("SIMC PI", seen(0.5))
    won = Row("autotune", seen(0.4))
    lost = Row("autotune", seen(0.6))
    loud = Row("autotune", seen(0.4, variation=20.0))
    worse = Row("autotune", seen(1.2))
    assert [verdict([start, rule, ours]).met for ours in (won, lost, loud, worse)] == [True, False, False, False]
    assert verdict([start, rule, lost]).least == "SIMC PI"
    assert verdict([start, rule, worse]).against == ("worse than the start: load",)
    unsafe = Row("autotune", Judgements((*won.seen.runs[1:], replace(won.seen.runs[0], safe=False))))
    assert not verdict([start, rule, unsafe]).met
    assert seen(math.nan).exceeds(rule.seen, "load"), "what is not known is not met"


def test_a_difference_is_one_beyond_its_own_noise_not_beyond_that_of_all_runs() -> None:
    """0.01 more in every run counts, though runs differ by 0.1; 0.01 more with noise of 0.1 of its own does not."""
    rule = seen(0.5)
    assert seen(0.51).exceeds(rule, "load")
    assert not seen(0.51, own=0.1).exceeds(rule, "load")
    assert seen(0.71, own=0.1).exceeds(rule, "load")
    tie = verdict([Row("start", seen()), Row("SIMC PI", rule), Row("autotune", seen(0.51, own=0.1))])
    assert tie.load == "1.02 (a tie)"
    assert tie.met


def test_the_verdict_goes_by_the_error_it_is_asked_for() -> None:
    start, rule, ours = Row("start", seen()), Row("SIMC PI", seen(0.5)), Row("autotune", seen(0.6))
    assert not verdict([start, rule, ours]).met
    assert verdict([start, rule, ours], "load_effect").met
    assert verdict([start, rule, ours], "load_effect").load == "1.00 (a tie)"


def test_who_leaves_more_is_dominated_where_a_rule_that_moves_no_more_leaves_less() -> None:
    start, loud, quiet = Row("start", seen()), Row("SIMC PID", seen(0.5)), Row("SIMC PI", seen(0.7, variation=4.0))
    for load, dominated in ((0.6, False), (0.8, True)):
        found = verdict([start, loud, quiet, Row("autotune", seen(load, variation=4.0))])
        assert (found.rule, found.met, found.dominated) == ("SIMC PID", False, dominated)
        assert ("no rule that moves as little leaves less" in found.line("plant")) is not dominated
    kept = verdict([start, loud, Row("autotune (kept the start)", seen(0.6, variation=4.0))])
    assert "**no**" in kept.line("plant"), "to move little is no merit of who has changed nothing"
    assert "less error for more movement" in verdict([start, quiet, Row("autotune", seen(0.4))]).line("plant")


def test_a_run_that_does_not_settle_is_no_reason_to_leave_a_rule_out() -> None:
    restless = replace(SEEN, settling=math.inf)
    assert Judgements((SEEN, SEEN, restless)).calm
    assert not Judgements((SEEN, restless, restless)).calm
    assert not Judgements((SEEN, SEEN, replace(SEEN, safe=False))).calm


def test_a_judgement_is_of_the_true_output() -> None:
    of_start = judge("flexible_joint", {}, SEEDS[:3])
    assert of_start.calm
    assert of_start.mean("setpoint") == pytest.approx(0.72, abs=0.05)
    assert math.isfinite(of_start.settling)
    assert 0.0 < of_start.scatter("load") < 0.1 * of_start.load
    assert math.isnan(of_start.mean("load_effect")), "for which it runs twice"


def test_what_a_load_does_by_itself_is_none_of_the_noises(monkeypatch: pytest.MonkeyPatch) -> None:
    exhibit = GALLERY["level_tank"]
    means = []
    for share in (0.0, 0.5, 1.0):
        monkeypatch.setitem(GALLERY, "level_tank", replace(exhibit, load=share * exhibit.load))
        judged = judge("level_tank", {}, SEEDS[:2], load_effect=True)
        means.append([judged.mean(figure) for figure in ("load", "load_effect")])
    (noise, none), (_, half), (_, whole) = means
    assert noise > 0.0 == none
    assert whole == pytest.approx(2.0 * half, rel=0.05)
