"""Gains that a loop did not bear are tried again, slower, before those from before are left to it."""

from __future__ import annotations

import math

import numpy as np
import pytest
from foreign_plants.gallery import GALLERY
from virtual_loop import VirtualLoop

from fopid_core.design.identification.identify import identify
from fopid_core.design.robust_verification import RobustLimits, RobustTuning
from fopid_core.design.slower import slower_design, slower_gains
from fopid_core.design.specification import TuningRequest
from fopid_core.design.sufficiency import Sufficiency
from fopid_core.design.tuner import verify
from fopid_core.model.fopid import Fopid
from fopid_core.model.process import Process, read_process
from fopid_core.model.two_degrees import MeasurementFilter
from fopid_ros.tuner.learning.autotune import Autotuner
from fopid_ros.tuner.learning.autotune_request import AutotuneRequest
from fopid_ros.tuner.learning.closed_loop_experiment import ExperimentSettings
from fopid_ros.tuner.learning.gain_update import AcceptanceCriteria, Outcome

NAME = "heat_exchanger"
CRITERIA = AcceptanceCriteria(
    TuningRequest(read_process("P1")), RobustLimits(2.5, math.radians(30.0)), 2.0, compare=True
)


@pytest.mark.parametrize("orders", [(1.0, 1.0), (0.8, 0.6), (1.3, 0.0)])
def test_a_loop_about_an_integrator_is_as_robust_and_slower(orders: tuple[float, float]) -> None:
    controller, share, w = Fopid(0.5, 0.1, 0.2, *orders), 0.6, np.geomspace(0.01, 100.0, 9)
    fast = controller(1j * w) / (1j * w)
    slow = slower_gains(controller, share)(1j * share * w) / (1j * share * w)
    assert np.allclose(slow, fast, rtol=1e-12)


def test_a_slower_design_is_verified_with_its_filter_and_nothing_is_left_to_be_chosen() -> None:
    request = TuningRequest(Process.parse("2/((10s+1)(2s+1))*exp(-s)"))
    first = verify(request, Fopid(2.0, 0.2, 1.0), MeasurementFilter(2, 0.1))
    wanted, slower = slower_design(request, first, 0.5)
    assert slower.controller == Fopid(1.0, 0.05, 1.0)
    assert slower.filter == MeasurementFilter(2, 0.2)
    assert slower.stable
    assert first.achieved is not None
    assert slower.achieved is not None
    assert slower.achieved.crossover < 0.7 * first.achieved.crossover
    assert set(wanted.fixed) == {"kp", "ki", "kd", "lam", "mu"}


def tuned(monkeypatch: pytest.MonkeyPatch, *times: float) -> tuple[VirtualLoop, Outcome]:
    """An autotuning that finds the start gains so many times, whatever records say: the first, and later ones."""
    found = iter(times)

    def learn(self: Autotuner, began: float) -> Outcome:
        record, share = self._tap.history.record(began), next(found)
        design = verify(
            TuningRequest(Process.parse("1/(20s+1)*exp(-s)")), Fopid(*(share * gain for gain in GALLERY[NAME].gains))
        )
        learnt = identify(record, "foptd")
        if self._learnt is None:
            self._learnt = learnt, record
        robust = RobustTuning(True, "found", design, None, 1, 0.0)
        return Outcome(True, f"{share:g} times", model=learnt.best, tuned=robust)

    monkeypatch.setattr(Sufficiency, "look", lambda *_: True)
    monkeypatch.setattr(Autotuner, "_learn", learn)
    monkeypatch.setattr(Autotuner, "_in_large_moves", lambda *_: (None, ""))  # a lag with a delay is no drum
    loop = VirtualLoop(GALLERY[NAME], 2)
    loop.run(100.0)
    asked = AutotuneRequest(ExperimentSettings(), "all", CRITERIA, False, second_round=False)
    return loop, Autotuner(loop, loop, asked, loop).run()  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("times", "share"),
    [pytest.param(6.0, 0.5, marks=pytest.mark.slow), pytest.param(9.0, 0.35, marks=pytest.mark.slow)],
)
def test_gains_that_swing_are_taken_back_and_slower_ones_are_proved(
    times: float, share: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    loop, outcome = tuned(monkeypatch, times, 1.1 * times)
    assert outcome.success
    assert outcome.applied
    assert not outcome.rolled_back
    kp, ki, _ = GALLERY[NAME].gains
    assert loop.gains().gains[:2] == pytest.approx((times * share * kp, times * share**2 * ki))
    assert f"; {share:g} times as fast as those that came first: the previous gains are back" in outcome.message
    assert outcome.previous is not None
    assert outcome.previous.gains == Fopid(kp, ki)
    assert loop.statuses[-2:] == ["trial", "verified"]


def test_what_was_not_borne_is_learnt_from(monkeypatch: pytest.MonkeyPatch) -> None:
    """With the second record others come out, and these are proved, before any are made slower."""
    loop, outcome = tuned(monkeypatch, 9.0, 2.5)
    assert outcome.success
    assert outcome.applied
    kp, ki, _ = GALLERY[NAME].gains
    assert loop.gains().gains[:2] == pytest.approx((2.5 * kp, 2.5 * ki))
    assert "; learnt from that as well, others than those that came first: the previous gains are back" in (
        outcome.message
    )
    assert loop.statuses.count("trial") == 2


@pytest.mark.slow
def test_where_slower_ones_do_not_do_either_those_from_before_stay(monkeypatch: pytest.MonkeyPatch) -> None:
    loop, outcome = tuned(monkeypatch, 20.0, 20.0)
    assert (outcome.success, outcome.applied, outcome.rolled_back) == (False, False, True)
    assert loop.gains() == Fopid(*GALLERY[NAME].gains)
    assert "; others did not do either: nothing was changed: " in outcome.message


@pytest.mark.slow
def test_a_loop_that_runs_away_before_it_is_moved_is_taken_back_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    loop, outcome = tuned(monkeypatch, 12.0, 12.0)
    assert "off the setpoint (" in outcome.message
    furthest = max(abs(true - loop.setpoint) for true in loop.trace.true)
    assert furthest < 10.0, "29 as long as it was waited for rest"
