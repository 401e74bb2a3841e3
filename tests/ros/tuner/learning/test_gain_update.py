"""New gains are applied, watched, and taken back when the loop gets worse: the logic, without nodes."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import count
from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter

from fopid_core.design.certificate.checker import check
from fopid_core.design.identification.identify import IdentificationResult, identify
from fopid_core.design.identification.record import Record
from fopid_core.design.robust_verification import RobustLimits
from fopid_core.design.specification import TuningRequest
from fopid_core.errors import InputError
from fopid_core.model.fopid import Fopid
from fopid_core.model.process import read_process
from fopid_core.model.two_degrees import MeasurementFilter, SetpointWeights
from fopid_core.runtime.performance_monitor import PerformanceMeter
from fopid_core.runtime.settings import UNPACED, Pace
from fopid_ros.tuner.controller_client import RunningDesign, UnconfirmedError
from fopid_ros.tuner.learning import gain_update as gain_update_module
from fopid_ros.tuner.learning.gain_update import AcceptanceCriteria, GainUpdate, Outcome, Trial, wear_in_noise
from fopid_ros.tuner.learning.history import History
from fopid_ros.tuner.learning.loop_tap import Tick
from fopid_ros.tuner.learning.loop_wait import CancelledError, Stage
from fopid_ros.tuner.learning.running_controller import RunningController
from fopid_ros.tuner.parameters import SPECS as TUNER
from tests.cases import slow

OLD = RunningDesign(Fopid(0.5, 1.0, 0.0, 1.0, 1.0), MeasurementFilter(2, 0.003), SetpointWeights(0.5, 0.0))
ANOTHERS = RunningDesign(Fopid(0.7, 0.1))
SAMPLE_TIME = 0.01
LIMITS = ("control_min", "control_max")
Loop = Callable[[float], float]
"""Measurement at each time, about a setpoint of 1."""


class Running:
    """Stands for the loop: its signals, its controller, and the wait that lets time pass."""

    def __init__(self, measurement: Loop, cancelled_at: float = math.inf) -> None:
        self.history = History(10.0)
        self.applied: list[RunningDesign] = []
        self.statuses: list[str] = []
        self.certificates: list[str] = []
        self.stages: list[Stage] = []
        self.time = 0.0
        self._measurement, self._cancelled_at = measurement, cancelled_at
        self._hook: Callable[[Tick], None] | None = None

    def set_tick_hook(self, hook: Callable[[Tick], None] | None) -> None:
        self._hook = hook

    def apply(self, design: RunningDesign, status: str = "", certificate: str = "") -> RunningDesign:
        self.certificates.append(certificate)
        before = self.applied[-1] if self.applied else OLD
        self.applied.append(design)
        self.statuses.append(status)
        return before

    def confirm(self, design: RunningDesign) -> None:
        assert design == self.design()
        self.statuses.append("verified")

    @property
    def watched(self) -> bool:
        return self._hook is not None

    def design(self) -> RunningDesign:
        return self.applied[-1] if self.applied else OLD

    def report(self, stage: Stage) -> None:
        self.stages.append(stage)

    def until(self, done: Callable[[], bool], stage: Callable[[], Stage]) -> None:
        for time in self._times():
            self.time = time
            if done():
                return
            if time > self._cancelled_at:
                raise CancelledError
            assert self._hook is not None
            self._hook(Tick(time, 1.0, self._measurement(time), 0.5))
            for signal, value in (("setpoint", 1.0), ("measurement", self._measurement(time)), ("control", 0.5)):
                self.history.add(signal, time, value)
            self.report(stage())

    def _times(self) -> Iterator[float]:
        return (SAMPLE_TIME * k for k in count())


def stepped(noise: np.ndarray) -> Record:
    """A lag of 0.5 s after a step at 1 s."""
    time = 0.02 * np.arange(600)
    return Record(time, np.where(time >= 1.0, 1.0, 0.0), -np.expm1(-np.maximum(time - 1.0, 0.0) / 0.5) + noise)


@pytest.fixture(scope="module")
def learnt() -> IdentificationResult:
    return identify(stepped(np.zeros(600)), "foptd")


def handover_of(
    running: Running, delay_margin_min: float = 2.0, sample_time: float = SAMPLE_TIME, certify: bool = False,
    pace: Pace = UNPACED, deadband: float = 0.0,
) -> GainUpdate:  # fmt: skip
    controller = RunningController(OLD.gains, sample_time, -math.inf, math.inf, pace=pace, deadband=deadband)
    criteria = AcceptanceCriteria(TuningRequest(read_process("P1")), RobustLimits(), delay_margin_min, certify)
    loop: Any = running
    return GainUpdate(loop, loop, loop, controller, criteria)


def test_the_wait_knows_how_long_a_tick_is() -> None:
    running = Running(lambda _: 1.0)
    handover_of(running, sample_time=0.5)
    assert running.sample_time == 0.5  # by which it tells a loop that stands still


@pytest.fixture(scope="module")
def designed(learnt: IdentificationResult) -> Outcome:
    outcome = handover_of(Running(lambda _: 1.0)).design(learnt)
    assert outcome.success, outcome.message
    return outcome


def quiet() -> Any:
    meter = PerformanceMeter(SAMPLE_TIME)
    for k in range(200):
        meter.step(1.0, 1.0 + 0.01 * math.sin(0.3 * k), saturated=False)
    return meter.figures


def test_a_design_that_leaves_too_few_ticks_is_refused(learnt: IdentificationResult) -> None:
    outcome = handover_of(Running(lambda _: 1.0), delay_margin_min=1e4).design(learnt)
    assert not outcome.success
    assert outcome.message.startswith("nothing was changed: ")
    assert "is below 100 s (verify.ticks)" in outcome.message


def test_noise_may_move_the_control_by_a_share_of_its_range(
    learnt: IdentificationResult, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: list[Any] = []

    def stopped(*asked: Any, **_: Any) -> None:
        seen.append(asked[3])
        raise CancelledError

    monkeypatch.setattr(gain_update_module, "improve", stopped)
    gain_update = handover_of(Running(lambda _: 1.0))
    gain_update._controller = replace(gain_update._controller, control_min=-1.0, control_max=3.0)
    gain_update._criteria = replace(gain_update._criteria, noise_share=0.02)
    with pytest.raises(CancelledError):
        gain_update.design(learnt)
    assert seen[0].control_movement == pytest.approx(0.08)
    assert seen[0].gains == OLD.gains


def answered(gain: float, lag: float) -> Record:
    """Of moves through the process that was learnt, times a gain and behind a further lag [s]."""
    moves = np.repeat(np.random.default_rng(0).choice([-1.0, 1.0], 60), 10)
    further = lfilter([0.0, 0.02 / lag], [1.0, 0.02 / lag - 1.0], moves) if lag else moves
    measured = gain * lfilter([0.0, 0.04], [1.0, -0.96], further)
    return Record(0.02 * np.arange(600), moves, measured + 0.002 * np.random.default_rng(1).standard_normal(600))


@pytest.mark.parametrize(("gain", "lag", "success"), [(10.0, 2.0, False), *slow((0.3, 0.0, True))])
def test_gains_are_held_to_the_record_where_it_speaks_against_the_model(
    learnt: IdentificationResult, gain: float, lag: float, success: bool
) -> None:
    record = answered(gain, lag)
    running = Running(lambda _: 1.0)
    gain_update = handover_of(running)
    gain_update._criteria = replace(gain_update._criteria, limits=RobustLimits(samples=1))
    outcome = gain_update.design(learnt, record=record)
    assert running.stages[1].message.startswith("the model leaves what the record shows")
    told = outcome.message.removeprefix("nothing was changed: ")
    assert outcome.success == success
    assert told.startswith("the model leaves what the record shows without one at")
    assert ("where the record shows nothing without a model" in told) == (not success)


@pytest.mark.parametrize("limited", [True, False])
def test_behind_a_slow_actuator_gains_are_held_to_small_moves(learnt: IdentificationResult, limited: bool) -> None:
    """A pump's lag was taken for a slow actuator's in large moves: max |S| of 11.6 where 1.88 was said."""
    gain_update = handover_of(Running(lambda _: 1.0))
    gain_update._criteria = replace(gain_update._criteria, limits=RobustLimits(samples=1))
    outcome = gain_update.design(learnt.with_limit(1e3) if limited else learnt, smaller=[answered(10.0, 2.0)])
    assert outcome.success == (not limited)
    assert ("where the record shows nothing without a model" in outcome.message) == limited


def test_with_verify_certify_the_gains_go_out_with_a_proof_of_the_learnt_loop(learnt: IdentificationResult) -> None:
    running = Running(lambda t: 1.0 + 0.005 * math.sin(7.0 * t))
    gain_update = handover_of(running, certify=True)
    outcome = gain_update.design(learnt)
    assert gain_update.apply_and_monitor(outcome, quiet(), 0.01, 2.0).success
    (document,) = running.certificates
    assert check(document) == ""
    assert json.loads(document)["claims"]["ms_max"] == pytest.approx(RobustLimits().ms_max)
    assert json.loads(document)["gains"] == list(running.applied[0].gains.gains)


@pytest.mark.slow
@pytest.mark.parametrize("region", ["ellipsoid", "box"])
def test_with_verify_region_the_proof_is_about_all_that_the_record_leaves_possible(
    monkeypatch: pytest.MonkeyPatch, region: str
) -> None:
    monkeypatch.setattr(gain_update_module, "PROOF_SECONDS", 2.0)
    noisy = identify(stepped(np.random.default_rng(0).normal(0.0, 0.01, 600)), "foptd")
    gain_update = handover_of(Running(lambda _: 1.0))
    gain_update._criteria = replace(gain_update._criteria, region=region)
    outcome = gain_update.design(noisy)
    assert outcome.success, outcome.message
    assert check(outcome.certificate) == ""
    content = json.loads(outcome.certificate)
    assert content["region"] == {"ellipsoid": "ball", "box": "box"}[region]
    assert content["claims"] == {
        "stable": True, "share": 1.0, "mt_max": None, "noise_max": None, "noise_band": None,
        "ms_max": pytest.approx(RobustLimits().ms_max),
    }  # fmt: skip
    few = RobustLimits(ms_max=1.001 * outcome.tuned.robustness.ms, samples=1)
    gain_update._criteria = replace(gain_update._criteria, limits=few, confidence=0.999999)
    assert "no certificate" in gain_update.design(noisy).message  # which one draw does not show


def test_a_proof_for_a_region_has_the_time_that_was_asked_for_and_without_one_nothing_is_applied(
    monkeypatch: pytest.MonkeyPatch, learnt: IdentificationResult
) -> None:
    asked: list[Any] = []
    monkeypatch.setattr("fopid_core.design.certificate.ellipsoid.learnt_family", lambda *region: region)
    monkeypatch.setattr("fopid_core.design.certified_tuning.certificate_or_refusal",
                        lambda *given: asked.append(given) or ("", "no certificate"))  # fmt: skip
    gain_update = handover_of(Running(lambda _: 1.0))
    wanted = replace(gain_update._criteria.tuning, timeout=7.0)
    gain_update._criteria = replace(gain_update._criteria, tuning=wanted, region="box", confidence=0.9)
    outcome = gain_update.design(learnt)
    assert (outcome.success, outcome.message) == (False, "no certificate")
    assert asked[-1][2:] == (RobustLimits().ms_max, (learnt.best, "box", 0.9), 7.0)

    def none(*_: object) -> None:
        raise InputError("the record leaves too much possible")

    monkeypatch.setattr("fopid_core.design.certificate.ellipsoid.learnt_family", none)
    outcome = gain_update.design(learnt)
    assert (outcome.success, outcome.message) == (False, "not applied: the record leaves too much possible")


def test_where_nothing_was_learnt_nothing_fits(learnt: IdentificationResult) -> None:
    running = Running(lambda _: 1.0)
    nothing = replace(learnt, success=False, message="the control stands still", best=None, models=())
    outcome = handover_of(running).design(nothing)
    assert not outcome.success
    assert "the control stands still" in outcome.message
    assert {stage.fit_pct for stage in running.stages if stage.phase == "tuning"} == {0.0}


def test_without_it_none_is_made(learnt: IdentificationResult) -> None:
    assert handover_of(Running(lambda _: 1.0)).design(learnt).certificate == ""


def test_gains_under_which_the_loop_stays_as_good_are_kept(designed: Outcome) -> None:
    running = Running(lambda t: 1.0 + 0.005 * math.sin(7.0 * t))
    gain_update, outcome = handover_of(running), designed
    tried = gain_update.apply_and_monitor(outcome, quiet(), 0.01, 2.0)
    assert tried.success
    assert tried.applied
    assert tried.previous == OLD
    assert running.applied == [RunningDesign(outcome.tuned.tuning.controller)]
    assert running.statuses == ["trial"]  # until it is over, a restart must not begin with them
    assert gain_update.kept(tried) is tried
    assert running.statuses == ["trial", "verified"]
    assert running.stages[-1].phase == "watching"
    assert not running.watched


@pytest.mark.parametrize(
    "measurement",
    [lambda t: 1.0 + 0.3 * (1.0 - math.exp(-t)), lambda t: 1.0 + 0.01 * math.exp(4.0 * t) * math.sin(20.0 * t)],
    ids=["off the setpoint", "growing oscillation"],
)
def test_the_old_gains_are_back_when_the_loop_got_worse(designed: Outcome, measurement: Loop) -> None:
    running = Running(measurement)
    gain_update, outcome = handover_of(running), designed
    tried = gain_update.apply_and_monitor(outcome, quiet(), 0.01, 2.0)
    assert not tried.success
    assert not tried.applied
    assert tried.rolled_back
    assert running.applied == [RunningDesign(outcome.tuned.tuning.controller), OLD]
    assert gain_update.kept(tried) is tried
    assert running.statuses == ["trial", ""]
    assert "the previous gains are back, since the loop got worse" in tried.message


def test_what_is_not_to_be_borne_ends_the_trial_at_once(designed: Outcome) -> None:
    running = Running(lambda t: 1.0 + (0.011 if t > 0.2 else 0.0))
    gain_update, outcome = handover_of(running), designed
    tried = gain_update.apply_and_monitor(
        outcome, quiet(), 0.01, 2.0, outside=lambda tick: "left its band" if tick.measurement > 1.01 else ""
    )
    assert tried.rolled_back
    assert "left its band" in tried.message
    assert running.applied[-1] == OLD


def test_gains_that_a_person_sets_while_the_trial_swings_have_the_last_word(designed: Outcome) -> None:
    """The loop was said to have the gains from before, and others were tried over those of the person."""
    running = Running(lambda _: 1.0)
    gain_update, outcome = handover_of(running), designed

    def stepping_in(_: Tick) -> str:
        running.applied.append(ANOTHERS)
        return "left its band"

    with pytest.raises(InputError, match="the gains were changed meanwhile; they stay"):
        gain_update.apply_and_monitor(outcome, quiet(), 0.01, 2.0, stepping_in)
    assert not gain_update.roll_back()
    assert running.applied[-1] == ANOTHERS


def test_a_trial_that_is_cancelled_can_be_taken_back(designed: Outcome) -> None:
    running = Running(lambda _: 1.0, cancelled_at=0.1)
    gain_update, outcome = handover_of(running), designed
    with pytest.raises(CancelledError):
        gain_update.apply_and_monitor(outcome, quiet(), 0.01, 2.0)
    assert not running.watched
    running.applied.append(ANOTHERS)
    assert not gain_update.roll_back()
    assert running.applied[-1] == ANOTHERS  # somebody has set others meanwhile: they stay


def test_a_trial_that_is_cancelled_is_taken_back_once(designed: Outcome) -> None:
    running = Running(lambda _: 1.0, cancelled_at=0.1)
    gain_update, outcome = handover_of(running), designed
    with pytest.raises(CancelledError):
        gain_update.apply_and_monitor(outcome, quiet(), 0.01, 2.0)
    assert gain_update.roll_back()
    assert not gain_update.roll_back()
    assert running.applied == [RunningDesign(outcome.tuned.tuning.controller), OLD]


def test_gains_that_may_have_been_taken_can_be_taken_back(designed: Outcome) -> None:
    running = Running(lambda _: 1.0)
    gain_update, outcome = handover_of(running), designed

    def unconfirmed(gains: Fopid, status: str = "", *_: str) -> Fopid:
        raise UnconfirmedError("no answer", OLD)

    taken, running.apply = running.apply, unconfirmed  # type: ignore[method-assign]
    with pytest.raises(UnconfirmedError):
        gain_update.apply_and_monitor(outcome, quiet(), 0.01, 2.0)
    running.apply = taken  # type: ignore[method-assign]
    gain_update.roll_back()
    assert running.applied == [OLD]
    gain_update.roll_back()  # once
    assert running.applied == [OLD]


def test_gains_that_cannot_be_put_back_are_named_and_may_be_later(designed: Outcome) -> None:
    running = Running(lambda _: 1.0, cancelled_at=0.1)
    gain_update, outcome = handover_of(running), designed
    with pytest.raises(CancelledError):
        gain_update.apply_and_monitor(outcome, quiet(), 0.01, 2.0)

    def gone(*_: object) -> RunningDesign:
        raise InputError("no controller answers")

    apply, running.apply = running.apply, gone  # type: ignore[method-assign]
    with pytest.raises(InputError, match=r"the previous gains, .*0\.5.*, could not be put back: no controller answers"):
        gain_update.roll_back()
    running.apply = apply  # type: ignore[method-assign]
    assert gain_update.roll_back()
    assert running.applied[-1] == OLD


def test_without_a_trial_there_is_nothing_to_take_back() -> None:
    running = Running(lambda _: 1.0)
    handover_of(running).roll_back()
    assert running.applied == []


def test_how_far_the_watch_is_told(designed: Outcome) -> None:
    running = Running(lambda t: 1.0 + 0.005 * math.sin(7.0 * t))
    gain_update, outcome = handover_of(running), designed
    gain_update.try_out(Trial(ANOTHERS, response_time=0.5), outcome, quiet(), 0.01, 2.0)
    watched = [stage for stage in running.stages if stage.phase == "watching"]
    assert watched[len(watched) // 2].progress == pytest.approx(0.875, abs=0.001)


def test_the_setpoint_weights_go_out_where_there_is_a_filter_or_they_are_others(designed: Outcome) -> None:
    whole, half, lag = SetpointWeights(), SetpointWeights(0.5, 0.0), MeasurementFilter(2, 0.003)
    idle = MeasurementFilter()
    for given, weights, sent in ((idle, whole, None), (idle, half, half), (lag, whole, whole), (lag, half, half)):
        running = Running(lambda _: 1.0)
        tuning = replace(designed.tuned.tuning, filter=given, weights=weights)
        wanted = replace(designed, tuned=replace(designed.tuned, tuning=tuning))
        handover_of(running).apply_and_monitor(wanted, quiet(), 0.01, 2.0)
        assert running.applied == [RunningDesign(tuning.controller, given, sent)]


@pytest.mark.parametrize("lacking", ["tuned", "tuning", "controller", "achieved"])
def test_a_tuning_without_gains_is_not_applied(designed: Outcome, lacking: str) -> None:
    running = Running(lambda _: 1.0)
    gain_update, outcome = handover_of(running), designed
    tuning = None if lacking == "tuning" else replace(outcome.tuned.tuning, **{lacking: None} if "c" in lacking else {})
    tuned = None if lacking == "tuned" else replace(outcome.tuned, tuning=tuning)
    with pytest.raises(InputError, match="a tuning without gains; allowed: one that succeeded"):
        gain_update.apply_and_monitor(replace(outcome, tuned=tuned), quiet(), 0.01, 2.0)
    assert running.applied == []


def test_an_outcome_says_nothing_that_has_not_happened() -> None:
    assert Outcome() == Outcome(success=False, message="", applied=False, rolled_back=False, certificate="")


def test_what_is_not_said_is_as_the_tuner_has_it() -> None:
    asked = AcceptanceCriteria(TuningRequest(read_process("P1")), RobustLimits(), 2.0)
    usual = {spec.name: spec.default for spec in TUNER}
    assert asked.certify == usual["verify.certify"]
    assert asked.noise_share == usual["verify.noise_share"]
    assert (asked.region, asked.confidence) == (usual["verify.region"], usual["verify.confidence"])
    assert (gain_update_module.SILENT.level, gain_update_module.SILENT.step) == (0.0, 0.0)


def test_new_gains_are_watched_for_ten_response_times(learnt: IdentificationResult) -> None:
    running = Running(lambda _: 1.004)
    gain_update = handover_of(running)
    outcome = gain_update.design(learnt)
    gain_update.apply_and_monitor(outcome, quiet(), 0.01, 2.0)
    assert learnt.message in [stage.message for stage in running.stages]
    phases = list(dict.fromkeys(stage.phase for stage in running.stages))  # each design looked at is told
    assert phases[:3] == ["tuning", "verifying", "applying"]
    watched = [stage for stage in running.stages if stage.phase == "watching"]
    response_time = 2.0 / outcome.tuned.tuning.achieved.crossover
    assert watched[0].remaining + SAMPLE_TIME == pytest.approx(10.0 * response_time, abs=2 * SAMPLE_TIME)
    assert len(watched) * SAMPLE_TIME == pytest.approx(10.0 * response_time, abs=2 * SAMPLE_TIME)
    assert {round(stage.deviation, 6) for stage in watched} == {0.004}
    for stage in watched:
        left = max(stage.remaining, 0.0) / (10.0 * response_time)
        assert stage.progress == pytest.approx(1.0 - 0.25 * left, abs=1e-9)
    progress = [stage.progress for stage in running.stages]
    assert progress == sorted(progress)
    assert 0.6 < progress[0] < progress[-1] <= 1.0


def test_new_gains_are_watched_for_sixty_ticks_at_least(designed: Outcome) -> None:
    running = Running(lambda _: 1.0)
    tick = 1.0 / designed.tuned.tuning.achieved.crossover  # ten response times are twenty of these
    handover_of(running, sample_time=tick).apply_and_monitor(designed, quiet(), 0.01, 2.0)
    watched = [stage for stage in running.stages if stage.phase == "watching"]
    assert watched[0].remaining == pytest.approx(59.0 * tick)


@pytest.mark.parametrize(
    ("now", "sent"), [(Pace(), Pace(5.0, 2.0)), (Pace(4.0), Pace(4.0, 2.0)), (Pace(4.0, 1.0), None)]
)
def test_a_controller_is_held_to_what_its_actuator_can_follow_and_never_hurried(
    designed: Outcome, now: Pace, sent: Pace | None
) -> None:
    running = Running(lambda _: 1.0)
    tried = handover_of(running, pace=now).apply_and_monitor(replace(designed, pace=Pace(5.0, 2.0)), quiet(), 0.01, 2.0)
    assert [design.pace for design in running.applied] == [sent]
    assert ("(control_rate_max)" in tried.message) == (sent is not None)


@pytest.mark.parametrize(("dead_band", "wears"), [(0.0, False), (0.01, True), (1.0, False)])
def test_gains_whose_noise_moves_an_actuator_out_of_its_dead_band_say_so(
    designed: Outcome, dead_band: float, wears: bool
) -> None:
    """A valve that had rested made ten strokes a second, and nothing told of it."""
    used = designed.candidates[0]
    assert used.worth is not None
    told = wear_in_noise(used, dead_band, noise=0.01 / used.worth.noise_gain)
    assert told.startswith("noise moves the control by 0.01 and so the actuator for ever") == wears
    assert bool(told) == wears


def test_a_pace_that_is_found_after_the_design_is_told_with_its_gains(designed: Outcome) -> None:
    """It printed the one from before, which makes another loop."""
    used, *others = designed.held(Pace(4.0)).candidates
    assert used.tuned.tuning.controller == designed.tuned.tuning.controller
    assert used.pace == Pace(4.0)
    assert all(one.pace == Pace() for one in others)


@pytest.mark.parametrize(("now", "sent"), [(0.0, 0.25), (0.2, 0.25), (0.25, None), (0.5, None)])
def test_what_the_steps_of_a_sensor_hide_counts_as_none_and_no_deadband_is_made_less(
    designed: Outcome, now: float, sent: float | None
) -> None:
    running = Running(lambda _: 1.0)
    tried = handover_of(running, deadband=now).apply_and_monitor(replace(designed, deadband=0.25), quiet(), 0.01, 2.0)
    assert [design.deadband for design in running.applied] == [sent]
    assert ("errors up to 0.25 count as none (deadband)" in tried.message) == (sent is not None)
