"""A second round with the new gains, where the record did not show the slow end; the first is never lost by it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from foreign_plants.gallery import GALLERY
from judging import SEEDS, judge
from virtual_loop import VirtualLoop

from fopid_core.design.identification.record import Record
from fopid_core.design.robust_verification import RobustLimits, RobustTuning
from fopid_core.design.specification import TuningRequest
from fopid_core.design.sufficiency import Sufficiency
from fopid_core.design.tuner import tune
from fopid_core.model.fopid import Fopid
from fopid_core.model.process import Process, read_process
from fopid_ros.tuner.learning import autotune, closed_loop_experiment
from fopid_ros.tuner.learning.autotune import Autotuner
from fopid_ros.tuner.learning.autotune_request import AutotuneRequest
from fopid_ros.tuner.learning.closed_loop_experiment import ClosedLoopExperiment, ExperimentSettings
from fopid_ros.tuner.learning.gain_update import AcceptanceCriteria, GainUpdate, Outcome
from fopid_ros.tuner.learning.loop_baseline import LoopBaseline
from fopid_ros.tuner.learning.loop_wait import CancelledError
from fopid_ros.tuner.learning.reach import NOT_MOVED, Reach
from fopid_ros.tuner.learning.rest import RestlessError
from fopid_ros.tuner.learning.running_controller import read_running_controller

NAME, SEED = "heat_exchanger", 1
CRITERIA = AcceptanceCriteria(
    TuningRequest(read_process("P1")), RobustLimits(2.5, math.radians(30.0)), 2.0, compare=True
)
Design = Callable[[int], Outcome]


def found(share: float, held_back: bool = True, **learnt: Any) -> Outcome:
    """Start gains, larger by a factor, as the outcome of a design."""
    process = Process.parse("1/(20s+1)*exp(-5s)")
    tuning = tune(TuningRequest(process, "rule", rule="simc-pi"))
    gains = Fopid(*(share * gain for gain in GALLERY[NAME].gains))
    tuned = RobustTuning(True, "found", replace(tuning, controller=gains), None, 1, 0.0)
    return Outcome(True, f"{share:g} times", tuned=tuned, held_back=held_back, **learnt)


@pytest.fixture
def designed(monkeypatch: pytest.MonkeyPatch) -> Callable[[Design], list[Any]]:
    """Let designs be what is said, by the number of the round; their records are listed."""

    def be(design: Design) -> list[Any]:
        records: list[Any] = []

        def learn(self: Autotuner, began: float) -> Outcome:
            records.append(self._tap.history.record(began))
            return design(len(records))

        monkeypatch.setattr(Sufficiency, "look", lambda *_: True)
        monkeypatch.setattr(Autotuner, "_learn", learn)
        return records

    return be


def tuned(**asked: Any) -> tuple[VirtualLoop, Outcome]:
    loop = VirtualLoop(GALLERY[NAME], SEED)
    loop.run(100.0)
    experiment = ExperimentSettings(**asked.pop("experiment", {}))
    request = AutotuneRequest(experiment, "all", CRITERIA, asked.pop("propose_only", False), **asked)
    return loop, Autotuner(loop, loop, request, loop).run()  # type: ignore[arg-type]


def share_of(loop: VirtualLoop) -> float:
    return loop.gains().kp / GALLERY[NAME].gains[0]


def test_the_second_round_learns_from_both_and_is_applied(designed: Callable[[Design], list[Any]]) -> None:
    records = designed(lambda number: found(1.0 + 0.2 * number))
    loop, outcome = tuned()
    assert outcome.applied
    assert outcome.message.startswith("in a second round: 1.4 times")
    assert share_of(loop) == pytest.approx(1.4)
    assert outcome.previous is not None
    assert outcome.previous.gains.kp == pytest.approx(GALLERY[NAME].gains[0]), "what ran before the first"
    assert loop.statuses == ["trial", "trial", "verified"]
    assert len(records) == 2
    assert records[0].time[0] == records[1].time[0]
    assert records[1].span > records[0].span


@pytest.mark.parametrize(
    ("doubted", "borne_out", "alone"), [(True, True, True), (True, False, False), (False, True, False)]
)
def test_a_second_round_is_learnt_from_alone_where_only_that_bears_its_process_out(
    doubted: bool, borne_out: bool, alone: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Small moves of a motor had hidden its dry friction, and both rounds together forbade the gains it would bear."""
    loop = VirtualLoop(GALLERY[NAME], SEED)
    loop.run(300.0)
    tuner = Autotuner(loop, loop, AutotuneRequest(ExperimentSettings(), "all", CRITERIA, False), loop)  # type: ignore[arg-type]
    learnt = SimpleNamespace(success=True, best=SimpleNamespace(process=Process.parse("1/(20s+1)")))
    learnt.behind_actuator = lambda record: record
    designed: list[Record] = []
    monkeypatch.setattr(tuner, "_identified", lambda since: (learnt, loop.history.record(since)))
    monkeypatch.setattr(tuner, "_designed", lambda _, __, record: designed.append(record) or Outcome())
    monkeypatch.setattr(autotune, "contradicts_rest", lambda *_: "")
    monkeypatch.setattr(autotune, "doubt_of", lambda *_: "another" if doubted else "")
    monkeypatch.setattr(autotune, "bears_out", lambda *_: borne_out)
    tuner._second_began = 200.0
    tuner._learn(100.0)
    tuner._learn(250.0)
    assert [record.span for record in designed] == pytest.approx([100.0 if alone else 200.0, 50.0], abs=2.0)


def test_it_is_one_round_where_the_slow_end_was_seen(designed: Callable[[Design], list[Any]]) -> None:
    records = designed(lambda _: found(1.2, held_back=False))
    loop, outcome = tuned()
    assert outcome.applied
    assert (len(records), share_of(loop)) == (1, pytest.approx(1.2))


@pytest.mark.parametrize(("livelier", "aims"), [(1.19, [math.inf, 24.0]), (1.21, [math.inf])])
def test_much_livelier_gains_are_followed_by_a_round_that_learns_from_theirs_alone(
    livelier: float, aims: list[float], designed: Callable[[Design], list[Any]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A level was learnt with its valve's lag taken for delay, while the loop was a sixth as fast."""
    monkeypatch.setattr(autotune, "LIVELIER", livelier)
    learnt = found(
        1.2,
        held_back=False,
        model=SimpleNamespace(crossover=0.05, process=read_process("1/(20s+1)*exp(-5s)")),
        noise_gain_aim=8.0,
    )
    records = designed(lambda number: learnt if number == 1 else Outcome(message="nothing better"))
    make, rounds = Autotuner._make_round, []

    def made(self: Autotuner, began: float, *another: bool) -> Outcome:
        rounds.append((began, self._gain_update._noise_gain_aim))
        return make(self, began, *another)

    monkeypatch.setattr(Autotuner, "_make_round", made)
    _, outcome = tuned()
    assert outcome.applied
    assert [aim for _, aim in rounds] == aims
    assert all(began > rounds[0][0] + records[0].span for began, _ in rounds[1:])


@pytest.mark.parametrize(("integral", "rounds"), [(1.2, 1), (2.4, 2)])
def test_whether_it_is_begun_depends_on_how_long_it_takes_with_the_new_gains(
    integral: float, rounds: int, designed: Callable[[Design], list[Any]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """For lack of a time that only the loop before would have taken, a plant was left with its first gains."""
    monkeypatch.setattr(closed_loop_experiment, "LONGEST", 1.7)
    kp, ki, _ = GALLERY[NAME].gains
    first = found(1.2)
    assert first.tuned is not None
    assert first.tuned.tuning is not None
    gains = Fopid(1.2 * kp, integral * ki)
    first = replace(first, tuned=replace(first.tuned, tuning=replace(first.tuned.tuning, controller=gains)))
    records = designed(lambda number: first if number == 1 else Outcome(message="nothing better"))
    loop, outcome = tuned()
    assert outcome.applied
    assert share_of(loop) == pytest.approx(1.2)
    assert len(records) >= rounds
    assert (autotune.NO_TIME in outcome.message) == (len(records) == 1) == (rounds == 1)


def test_the_time_that_gains_take_to_work_out_is_none_of_the_experiments(
    designed: Callable[[Design], list[Any]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """On a busy machine one failed design used up what was left for a longer record."""
    records = designed(lambda number: found(1.2, held_back=False) if number == 2 else Outcome(message="too little"))
    learn = Autotuner._learn

    def slowly(self: Autotuner, began: float) -> Outcome:
        self._tap.run(closed_loop_experiment.LONGEST * self._experiment.duration)  # type: ignore[attr-defined]
        return learn(self, began)

    monkeypatch.setattr(Autotuner, "_learn", slowly)
    assert tuned()[1].applied
    assert len(records) == 2


@pytest.mark.parametrize(
    "asked", [{"second_round": False}, {"experiment": {"duration": 300.0}}, {"propose_only": True}]
)
def test_it_is_one_round_where_somebody_has_said_so(
    asked: dict[str, Any], designed: Callable[[Design], list[Any]]
) -> None:
    records = designed(lambda _: found(1.2))
    assert tuned(**asked)[1].success
    assert len(records) == 1


@pytest.mark.parametrize(("times", "told"), [(4.9, False), (5.1, True)])
def test_gains_that_are_far_livelier_are_told_with_what_they_were_learnt_within(
    times: float, told: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """35 times as large, learnt within 0.25 of pH 8.8, they swung for ever at 7.6, and nothing had been said."""
    monkeypatch.setattr(GainUpdate, "design", lambda *_, **__: found(times, model=SimpleNamespace(crossover=0.05)))
    loop = VirtualLoop(GALLERY[NAME], SEED)
    loop.run(100.0)
    tuner = Autotuner(loop, loop, AutotuneRequest(ExperimentSettings(), "all", CRITERIA, False), loop)  # type: ignore[arg-type]
    tuner._experiment.measure()
    time, noise = np.arange(100.0), np.random.default_rng(0).standard_normal(100)
    outcome = tuner._designed(tuner._gain_update, None, Record(time, noise, noise))  # type: ignore[arg-type]
    assert ("far livelier than what ran, and learnt while the measurement was within" in outcome.message) == told


def test_what_the_first_came_to_stays_where_the_second_finds_nothing(designed: Callable[[Design], list[Any]]) -> None:
    designed(lambda number: found(1.2) if number == 1 else Outcome(message="nothing better"))
    loop, outcome = tuned()
    assert outcome.success
    assert outcome.applied
    assert outcome.message.endswith("; a second round changed nothing: nothing better")
    assert share_of(loop) == pytest.approx(1.2)


def test_gains_of_the_second_that_make_the_loop_worse_give_way_to_those_of_the_first(
    designed: Callable[[Design], list[Any]],
) -> None:
    designed(lambda number: found(1.2 if number == 1 else 30.0))
    loop, outcome = tuned()
    assert outcome.success
    assert outcome.applied
    assert "since the loop got worse" in outcome.message
    assert share_of(loop) == pytest.approx(1.2)


@pytest.mark.parametrize("held_back", [True, False])
def test_a_loop_that_does_not_rest_again_has_its_gains_back(
    held_back: bool, designed: Callable[[Design], list[Any]], monkeypatch: pytest.MonkeyPatch
) -> None:
    designed(lambda _: found(1.2, held_back))
    measure, asked = ClosedLoopExperiment.measure, []

    def restless(self: ClosedLoopExperiment, *borne: float, **told: bool) -> None:
        asked.append(self)
        if len(asked) > 1:
            raise RestlessError("measurement swings")
        measure(self, *borne, **told)

    monkeypatch.setattr(ClosedLoopExperiment, "measure", restless)
    loop, outcome = tuned()
    assert outcome.rolled_back
    assert not outcome.applied
    assert outcome.message == "the previous gains are back, since with the new ones measurement swings"
    assert share_of(loop) == pytest.approx(1.0)


def test_cancelled_in_the_second_the_gains_from_before_the_first_are_back(
    designed: Callable[[Design], list[Any]], monkeypatch: pytest.MonkeyPatch
) -> None:
    designed(lambda number: found(1.2 if number == 1 else 1.4))
    try_out, tried = GainUpdate.try_out, []

    def cancelled(self: GainUpdate, *given: Any) -> Outcome:
        tried.append(self)
        outcome = try_out(self, *given)
        if len(tried) > 1:
            raise CancelledError
        return outcome

    monkeypatch.setattr(GainUpdate, "try_out", cancelled)
    loop = VirtualLoop(GALLERY[NAME], SEED)
    loop.run(100.0)
    with pytest.raises(CancelledError):
        Autotuner(loop, loop, AutotuneRequest(ExperimentSettings(), "all", CRITERIA, False), loop).run()  # type: ignore[arg-type]
    assert len(tried) == 2
    assert share_of(loop) == pytest.approx(1.0)
    assert loop.added == 0.0


def test_an_experiment_that_follows_another_moves_the_measurement_as_far() -> None:
    """Livelier gains allow less by their proportional band: friction looks like damping in smaller moves."""
    loop, moved = VirtualLoop(GALLERY["motor_position"], SEED), []

    def experiment(before: Reach) -> ClosedLoopExperiment:
        baseline = LoopBaseline(read_running_controller(loop))  # type: ignore[arg-type]
        made = ClosedLoopExperiment(loop, loop, baseline, ExperimentSettings(), before)  # type: ignore[arg-type]
        made.measure()
        began = len(loop.trace.true)
        assert not made.excite(lambda: True)
        moved.append(float(np.abs(np.array(loop.trace.true[began:]) - loop.setpoint).max()))
        return made

    loop.run(1.0)
    first = experiment(NOT_MOVED)
    loop.set(gains=Fopid(12.0, 270.0, 0.02))
    loop.run(1.0)
    experiment(NOT_MOVED)
    second = experiment(first.reach)
    assert moved[1] < 0.7 * moved[0]
    assert moved[2] > 0.8 * moved[0]
    assert second.loop.deviation_max >= first.loop.deviation_max


@pytest.mark.long
@pytest.mark.timeout(900)
def test_a_furnace_whose_first_record_shows_too_slow_a_process_is_tuned_better_in_two() -> None:
    loads = []
    for second in (False, True):
        loop = VirtualLoop(GALLERY["furnace"], 1)
        loop.run(750.0)
        asked = AutotuneRequest(ExperimentSettings(), "all", CRITERIA, False, second_round=second)
        outcome = Autotuner(loop, loop, asked, loop).run()  # type: ignore[arg-type]
        assert outcome.applied
        assert outcome.message.startswith("in a second round: ") == second
        loads.append(judge("furnace", loop.tuned_settings(), SEEDS[:8]).load)
    assert loads[1] < 0.9 * loads[0]


@pytest.mark.long
@pytest.mark.timeout(900)
def test_a_motor_whose_friction_shows_in_the_second_is_better_after_either() -> None:
    loop = VirtualLoop(GALLERY["motor_position"], 1)
    loop.run(1.0)
    outcome = Autotuner(loop, loop, AutotuneRequest(ExperimentSettings(), "all", CRITERIA, False), loop).run()  # type: ignore[arg-type]
    assert "second round" in outcome.message
    start, now = (judge("motor_position", settings, SEEDS[:1]) for settings in ({}, loop.tuned_settings()))
    assert now.mean("setpoint") < start.mean("setpoint")
    assert now.load < start.load
