"""Accidents of other autotuners that were published, and what happens here instead."""

from __future__ import annotations

import math
import os
import signal
from dataclasses import replace
from functools import partial
from typing import Any

import pytest
from std_msgs.msg import Float64

from fopid_core.design.acceptance import rejection_reason
from fopid_core.design.tuner import TuningRequest, tune
from fopid_core.errors import InputError
from fopid_core.model.fopid import Fopid
from fopid_core.model.process import read_process

from ...patience import FACTOR
from ..conftest import Graph
from .test_autotune import GAINS, PI, ForeignLoop

TRIAL_TIMEOUT = 3.0
"""The parameter's default [s]."""


@pytest.fixture
def loops(graph: Graph) -> Any:
    return partial(ForeignLoop, graph, gains=PI)


def watched(loop: ForeignLoop, round_: str = "") -> tuple[Any, list[float]]:
    """An autotuning whose candidate gains run on trial, and the gains before."""
    before = loop.gains()
    handle = loop.autotune(deviation_max=0.3, duration=8.0)

    def on_trial() -> bool:
        told = loop.feedback[-1] if loop.feedback else None
        return told is not None and (told.message.startswith(round_) if round_ else told.phase == "watching")

    loop.graph.until(on_trial, "the trial", 200.0 * FACTOR)
    assert loop.gains() != before
    return handle, before


@pytest.mark.slow
@pytest.mark.parametrize(("end", "round_"), [("cancel", ""), ("kill", ""), ("cancel", "proof"), ("kill", "proof")])
def test_an_aborted_test_keeps_no_candidate_gains(loops: Any, end: str, round_: str) -> None:
    """In PX4 the multicopter's candidate gains stayed when the test in the air was aborted.

    https://github.com/PX4/PX4-Autopilot/issues/28699, defect 2. Here also when the tuner is killed outright.
    """
    loop = loops("saturating")
    handle, before = watched(loop, round_)
    if end == "cancel":
        loop.graph.result(handle.cancel_goal_async())
        assert loop.outcome(handle).result.applied is False
        assert loop.gains() == before
    else:
        os.kill(loop.tuner.pid, signal.SIGKILL)
        loop.graph.until(lambda: loop.gains() == before, "the gains from before", TRIAL_TIMEOUT + 2.0)
        assert loop.graph.get("fopid_controller", "gains.status") == ["set"]
        assert "gains on trial, and nothing heard of '/fopid_tuner'" in loop.graph.logs()
    loop.until_at_rest()


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_gains_that_are_not_finite_do_not_pass(graph: Graph, bad: float) -> None:
    """In PX4 NaN in one component passed the check of the ranges, since minimum and maximum skip it.

    https://github.com/PX4/PX4-Autopilot/issues/28699, defect 3.
    """
    good = tune(TuningRequest(read_process("P1"), method="rule", rule="simc-pi"))
    assert good.controller is not None
    for name in GAINS:
        with pytest.raises(InputError, match=name):
            replace(good.controller, **{name: bad})
    assert good.achieved is not None
    assert good.running is not None
    assert not rejection_reason(good, 0.01)
    for unknown in (
        {"achieved": replace(good.achieved, ms=math.nan)}, {"achieved": replace(good.achieved, delay_margin=math.nan)},
        {"running": replace(good.running, ms=math.nan)},
    ):  # fmt: skip
        assert rejection_reason(replace(good, **unknown), 0.01)
    graph.start("fopid_controller", {"kp": 1.0, "ki": 0.5})
    before = graph.get("fopid_controller", *GAINS)
    others = {"kp": 2.0, "ki": 0.7, "kd": 0.1, "lam": 1.0, "mu": 1.0}
    for name in GAINS:
        answer = graph.set("fopid_controller", **{**others, name: bad})
        assert not answer.successful
        assert name in answer.reason
        assert graph.get("fopid_controller", *GAINS) == before


@pytest.mark.slow
def test_gains_under_which_the_loop_turns_unstable_are_taken_back_and_it_is_said(loops: Any) -> None:
    """In PX4 the autotuning of a fixed wing failed silently into an unstable controller, with no way to restore.

    https://github.com/PX4/PX4-Autopilot/issues/18905. Here the process's gain grows eightfold during the trial.
    """
    loop = loops("drifting")
    handle, before = watched(loop)
    drift = loop.graph.node.create_publisher(Float64, "drift", 1)
    loop.graph.until(drift.get_subscription_count, "the plant")
    drift.publish(Float64(data=7.0))
    result = loop.outcome(handle).result
    assert not result.success
    assert result.rolled_back
    assert "the previous gains are back, since the loop got worse" in result.message
    assert loop.gains() == before


@pytest.mark.slow
@pytest.mark.parametrize("end", ["cancel", "setpoint", "kill"])
def test_after_an_experiment_that_ends_early_the_loop_has_the_gains_from_before(loops: Any, end: str) -> None:
    """In ArduPilot an interrupted autotuning left the copter with the weakened gains of its test; two crashed.

    https://github.com/ArduPilot/ardupilot/pull/13423. Here the experiment adds to the control and touches no gain.
    """
    loop = loops("saturating")
    changes = loop.graph.changes("fopid_controller")
    before = loop.gains()
    handle = loop.autotune(deviation_max=0.3, duration=30.0)
    loop.graph.until(lambda: any(m.value for m in loop.added), "the excitation")
    if end == "cancel":
        loop.graph.result(handle.cancel_goal_async())
    if end == "setpoint":
        loop.move_setpoint(1.2)
    if end == "kill":
        os.kill(loop.tuner.pid, signal.SIGKILL)
    else:
        assert not loop.outcome(handle).result.success
    loop.move_setpoint(1.0)
    assert loop.gains() == before
    assert not any(set(GAINS) & set(change) for change in changes)
    if end != "kill":  # in lockstep a killed author's addend lasts 10,000 ticks; docs/fail_safe.md
        assert loop.added[-1].value == 0.0
        loop.until_at_rest()


def test_a_person_who_sets_gains_during_a_trial_has_the_last_word(graph: Graph) -> None:
    """A trial that is given up takes back its own gains only."""
    name = "fopid_controller"
    graph.start(name, {"kp": 1.0, "ki": 0.5, "trial_timeout": 0.5})
    assert graph.set(name, kp=2.0, gains__status="trial", gains__origin="a test").successful
    graph.until(lambda: graph.get(name, "kp", "gains.status") == [1.0, "set"], "the gains before the trial", 5.0)
    assert graph.set(name, kp=2.0, gains__status="trial", gains__origin="a test").successful
    assert graph.set(name, kp=3.0).successful
    graph.spin(1.5)
    assert graph.get(name, "kp", "ki", "gains.status", "gains.origin") == [3.0, 0.5, "set", ""]
    assert Fopid(*graph.get(name, *GAINS)) == Fopid(3.0, 0.5)
