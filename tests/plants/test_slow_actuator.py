"""A valve that is slow shows that in large moves only, where gains found by small ones made it swing for ever."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from compare import autotuned
from foreign_plants.gallery import GALLERY, Exhibit
from foreign_plants.parts import Actuator, Plant, Sensor, State
from judging import SEEDS, judge
from virtual_loop import VirtualLoop

from fopid_core.design.identification.identify import behind_slow_actuator, identify
from fopid_core.design.identification.record import Record
from fopid_core.design.robust_verification import RobustLimits
from fopid_core.design.specification import TuningRequest
from fopid_core.design.sufficiency import Sufficiency
from fopid_core.errors import InputError
from fopid_core.model.fopid import Fopid
from fopid_core.model.process import Process
from fopid_core.runtime.settings import Pace
from fopid_ros.tuner.controller_client import RunningDesign
from fopid_ros.tuner.learning.autotune import Autotuner
from fopid_ros.tuner.learning.autotune_request import AutotuneRequest
from fopid_ros.tuner.learning.closed_loop_experiment import ClosedLoopExperiment, ExperimentSettings
from fopid_ros.tuner.learning.gain_update import AcceptanceCriteria, Outcome
from fopid_ros.tuner.learning.loop_baseline import LoopBaseline
from fopid_ros.tuner.learning.proof import PULSES, Proof
from fopid_ros.tuner.learning.reach import Reach
from fopid_ros.tuner.learning.running_controller import read_running_controller


class SlowValve(Plant):
    """Two lags behind a valve [0 to 100] that takes 14 s for its stroke; its last lag is a pocket's."""

    pocket = 1.5
    control_at_rest = 50.0
    rest = (0.0, 0.0)
    substep = 0.1

    def make_actuator(self) -> Actuator:
        return Actuator(0.0, 100.0, rate=7.0)

    def make_sensor(self) -> Sensor:
        return Sensor(noise=0.02)

    def slopes(self, x: State, u: float) -> State:
        return ((u - 50.0 - x[0]) / 7.0, (x[0] - x[1]) / self.pocket)

    def input(self, felt: float, dt: float) -> float:
        del dt
        return felt + self.load

    def output(self, x: State) -> float:
        return 50.0 + x[1]


class NoPocket(SlowValve):
    """Hardly a second lag, so that the learnt process alone would bear far more gain."""

    pocket = 0.3


NOISE = 0.0627
"""Of drawn plant 33, with the steps of its sensor."""
VALVE = Exhibit(SlowValve, 0.1, (4.0, 0.6, 0.0), 10.0, 10.0, 120.0, (0.0, 100.0))


@pytest.mark.long
@pytest.mark.timeout(900)
@pytest.mark.parametrize("plant", [SlowValve, NoPocket])
def test_what_is_left_to_a_loop_about_a_slow_valve_is_calm_and_no_worse(
    plant: type[Plant], monkeypatch: pytest.MonkeyPatch
) -> None:
    """12.4, 4.5, 10.3 and 17.2, 14.8, 1.6 were: 1104 and 510 of the setpoint's error, 75 and 54 with the start's."""
    monkeypatch.setitem(GALLERY, "valve", replace(VALVE, plant=plant))
    start, found = judge("valve", {}, SEEDS[:3]), autotuned("valve", 1)
    assert found.seen.calm
    assert found.seen.mean("setpoint") <= 1.02 * start.mean("setpoint")
    assert found.seen.load <= 1.02 * start.load


def proof_of(loop: VirtualLoop, allowed: float) -> Proof:
    """Of a loop that was moved by 0.08 to learn its gains, once it rests."""
    first = LoopBaseline(read_running_controller(loop))  # type: ignore[arg-type]
    ClosedLoopExperiment(loop, loop, first, ExperimentSettings()).measure()  # type: ignore[arg-type]
    baseline = LoopBaseline(read_running_controller(loop))  # type: ignore[arg-type]
    made = Proof(loop, loop, baseline, ExperimentSettings(), Reach(0.08, allowed, 0.4, allowed), first)  # type: ignore[arg-type]
    made.measure()
    return made


def tuner_of(loop: VirtualLoop) -> Autotuner:
    criteria = AcceptanceCriteria(TuningRequest(Process.parse("1/(s+1)")), RobustLimits(), 2.0)
    return Autotuner(loop, loop, AutotuneRequest(ExperimentSettings(), "all", criteria, False), loop)  # type: ignore[arg-type]


@pytest.mark.long
@pytest.mark.timeout(900)
def test_a_loop_that_swings_since_its_actuator_is_slow_is_learnt_behind_it() -> None:
    """A linear model misses a third of what an experiment moves there."""
    start, found = judge("drawn_33", {}, SEEDS[:4]), autotuned("drawn_33")
    assert found.label == "autotune", found.note
    assert found.seen.safe
    assert found.seen.mean("setpoint") < 0.7 * start.mean("setpoint")
    assert not found.seen.load > 1.05 * start.load


def experimented(times: int) -> tuple[VirtualLoop, Record]:
    """A loop that swings by itself since its actuator is slow, after so many whole experiments, and their record."""
    loop = VirtualLoop(GALLERY["drawn_33"], 1)
    loop.run(0.5 * loop.exhibit.horizon)
    made = ClosedLoopExperiment(loop, loop, LoopBaseline(read_running_controller(loop)), ExperimentSettings())  # type: ignore[arg-type]
    made.measure()
    began = loop.history.newest_time("control")
    for _ in range(times):
        assert not made.excite()
    return loop, loop.history.record(began)


@pytest.mark.slow
def test_what_a_slow_actuator_does_to_an_experiment_passes_for_no_wandering_load() -> None:
    """It did, and no gains were found: loads that wander explain any record, and are looked for before a limit."""
    loop, record = experimented(2)
    learnt = identify(record, noise=NOISE)
    assert learnt.best is not None
    assert learnt.best.wanders, learnt.message
    slow = behind_slow_actuator(record, learnt, noise=NOISE)
    assert slow is not None
    assert slow.success, slow.message
    assert slow.best is not None
    assert not slow.best.wanders
    assert slow.flaws.rate == pytest.approx(loop.plant.traits.rate, rel=0.1)  # type: ignore[attr-defined]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["mujoco_arm"])
def test_friction_that_was_not_known_passes_for_no_slow_actuator(name: str) -> None:
    """The arm's actuator takes 400 a second; once its new gains were moved it was taken for one of 11."""
    loop = VirtualLoop(GALLERY[name], 1)
    loop.run(0.5 * loop.exhibit.horizon)
    rest = LoopBaseline(read_running_controller(loop))  # type: ignore[arg-type]
    made = ClosedLoopExperiment(loop, loop, rest, ExperimentSettings())  # type: ignore[arg-type]
    made.measure()
    began = loop.history.newest_time("control")
    made.excite(lambda: loop.history.newest_time("control") - began > 3.6)
    learnt = identify(loop.history.record(began), noise=made.loop.unrest)
    assert learnt.success, learnt.message
    assert not learnt.flaws.friction
    loop.set(gains=Fopid(17.4, 93.9, 0.369, 1.0, 1.218), measurement_filter_order=2, measurement_filter_time=0.0161)
    loop.run(3.0)
    now = LoopBaseline(read_running_controller(loop))  # type: ignore[arg-type]
    moved = Proof(loop, loop, now, ExperimentSettings(), made.reach, rest)  # type: ignore[arg-type]
    moved.measure(announced=False)
    assert moved.prove(0.1) == ""
    slow = behind_slow_actuator(loop.history.record(began), learnt, noise=made.loop.unrest, possible=True)
    assert slow is None or slow.flaws.rate > 100.0


@pytest.mark.slow
def test_an_experiment_goes_on_where_the_only_process_it_shows_lacks_the_actuator() -> None:
    loop, record = experimented(1)
    sufficiency = Sufficiency("all", NOISE, loop.sample_time)
    assert not sufficiency.look(record.part(record.time[0], record.time[0] + 7.7), math.inf)
    assert "what it leaves is no noise" in sufficiency.missing


@pytest.mark.parametrize(("allowed", "furthest"), [(0.8, 0.3), (0.3, 0.1)])
def test_a_loop_is_moved_up_to_half_of_what_is_allowed_before_it_is_believed(allowed: float, furthest: float) -> None:
    loop = VirtualLoop(VALVE, 1)
    loop.set(gains=Fopid(6.2, 1.13, 10.3))
    loop.run(60.0)
    made = proof_of(loop, allowed)
    began = len(loop.trace.true)
    assert made.prove(2.5) == ""
    moved = max(abs(true - loop.setpoint) for true in loop.trace.true[began:])
    assert furthest < moved < 0.75 * allowed


@pytest.mark.slow
@pytest.mark.parametrize("rate", [7.0, 1e4])
def test_a_few_pulses_show_how_fast_an_actuator_is_and_take_the_measurement_nowhere(rate: float) -> None:
    class Valve(SlowValve):
        def make_actuator(self) -> Actuator:
            return Actuator(0.0, 100.0, rate=rate)

    loop = VirtualLoop(replace(VALVE, plant=Valve), 1)
    for added in (0.0, 1.0, -1.0, 1.0, 0.0, -1.0, 1.0, 0.0):
        loop.inject(added)
        loop.run(8.0)
    learnt = identify(loop.history.record())
    assert learnt.success, learnt.message
    loop.set(gains=Fopid(6.2, 1.13, 10.3))
    made = proof_of(loop, 0.8)
    assert made.prove(2.5) == ""
    began, since = len(loop.trace.true), loop.time
    assert made.pulse(Process.parse("1/((7s+1)(1.5s+1))"), 2.5) == ""
    assert max(abs(true - loop.setpoint) for true in loop.trace.true[began:]) < 0.8
    moves = np.abs(np.diff(loop.history.record(since - 1.0).excitation))  # type: ignore[arg-type]
    assert max(moves) == pytest.approx(10.0)  # a tenth of the control's range
    assert np.count_nonzero(np.isclose(moves, 10.0)) == 2 * PULSES
    slow = behind_slow_actuator(loop.history.record(), learnt, possible=True)
    found = slow.flaws.rate if slow else math.inf
    assert found == pytest.approx(rate, rel=0.15) if rate < 1e3 else found > 40.0


@pytest.mark.slow
def test_pulses_are_so_short_that_an_actuator_without_limits_is_not_taken_for_a_slow_one() -> None:
    """By pulses as long as a response 263 a second could not be excluded, and its gains were held to that."""
    loop = VirtualLoop(GALLERY["drawn_47"], 1)
    loop.run(4.0)
    for added in (0.0, 2.0, -2.0, 2.0, 0.0, -2.0, 2.0, 0.0):
        loop.inject(added)
        loop.run(0.7)
    learnt = identify(loop.history.record())
    assert learnt.best is not None, learnt.message
    loop.set(gains=Fopid(2.37, 5.72, 0.102), measurement_filter_order=2, measurement_filter_time=0.0435)
    loop.run(3.0)
    made = proof_of(loop, 5.0)
    assert made.prove(0.25) == ""
    assert made.pulse(learnt.best.process, 0.25) == ""
    slow = behind_slow_actuator(loop.history.record(), learnt, possible=True)
    assert slow is None or slow.flaws.rate > 500.0


class Deaf(VirtualLoop):
    """Its controller does not hear of a pace alone."""

    def hold(self, pace: Pace) -> None:
        del pace
        raise InputError("'fopid_controller' did not confirm")


@pytest.mark.parametrize("hears", [True, False])
def test_gains_that_need_a_pace_are_kept_with_it_or_not_at_all(hears: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    loop, pace = (VirtualLoop if hears else Deaf)(VALVE, 1), Pace(7.0, 2.0)
    before = loop.design()
    new = RunningDesign(Fopid(6.2, 1.13, 10.3))
    loop.run(60.0)
    tuner = tuner_of(loop)

    def applied(self: Autotuner) -> Outcome:
        update = self._gain_update
        update._trial, update._previous = new, loop.apply(new, "trial")
        self._experiment.measure()
        return self._prove(Outcome(True, "applied", applied=True), update)

    monkeypatch.setattr(Autotuner, "_run", applied)
    monkeypatch.setattr(Proof, "prove", lambda *_: "")
    monkeypatch.setattr(Autotuner, "_in_large_moves", lambda *_: (pace, ""))
    if hears:
        assert "(control_rate_max)" in tuner.run().message
        assert (loop.gains(), loop.design().pace) == (new.gains, pace)
    else:
        with pytest.raises(InputError, match="did not confirm"):
            tuner.run()
        assert loop.design() == before


@pytest.mark.parametrize(("pace", "proofs"), [(Pace(7.0, 2.0), 2), (Pace(math.inf, 2.0), 1)])
def test_a_pace_is_proved_on_the_plant_or_comes_back_with_the_gains(
    pace: Pace, proofs: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A ramp of the setpoint alone changes nothing at a setpoint that rests."""
    loop, begun = VirtualLoop(VALVE, 1), []
    before = loop.design()
    new = RunningDesign(Fopid(6.2, 1.13, 10.3))
    loop.run(60.0)

    def applied(self: Autotuner) -> Outcome:
        update = self._gain_update
        update._trial, update._previous = new, loop.apply(new, "trial")
        self._experiment.measure()
        return self._prove(Outcome(True, "applied", applied=True), update)

    def proved(*_: Any) -> str:
        begun.append(loop.design().pace)
        return "the loop hunts" if len(begun) > 1 else ""

    monkeypatch.setattr(Autotuner, "_run", applied)
    monkeypatch.setattr(Proof, "prove", proved)
    monkeypatch.setattr(Autotuner, "_in_large_moves", lambda *_: (pace, ""))
    outcome = tuner_of(loop).run()
    assert begun == [before.pace, pace][:proofs]
    assert "inf" not in outcome.message
    assert outcome.applied == (proofs == 1)
    assert loop.design().pace == (pace if outcome.applied else before.pace)
    assert loop.gains() == (new.gains if outcome.applied else before.gains)


@pytest.mark.parametrize(("found", "believed"), [(19.0, True), (6.8, False)])
def test_pulses_that_make_it_far_slower_speak_of_something_else(
    found: float, believed: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A crane whose pendulum and friction looked like 6.8 a second, after 26, was held to that and driven out."""
    tuner: Any = tuner_of(VirtualLoop(VALVE, 1))
    rates = iter([26.0, found])

    def looked(self: Any, *_: Any) -> tuple[Pace, str]:
        self._learnt = SimpleNamespace(flaws=SimpleNamespace(rate=next(rates))), None
        return Pace(1.0, 1.0), ""

    monkeypatch.setattr(Autotuner, "_in_large_moves", looked)
    outcome = Outcome(model=SimpleNamespace(process=None))  # type: ignore[arg-type]
    proof: Any = SimpleNamespace(pulse=lambda *_: "")
    pace, against = tuner._borne_in_large_moves(outcome, None, proof)
    assert pace == Pace(1.0, 1.0)
    assert (against == "") == believed
    assert (tuner._learnt is not None) == believed


def test_gains_that_need_a_pace_are_not_kept_where_pulses_cannot_be_made(monkeypatch: pytest.MonkeyPatch) -> None:
    """They stayed, without one: an error in the proof is taken for a loop that need not be moved once more."""

    def refused(*_: Any) -> str:
        raise InputError("the process's response is not known")

    monkeypatch.setattr(Autotuner, "_in_large_moves", lambda *_: (Pace(1.0, 1.0), ""))
    tuner: Any = tuner_of(VirtualLoop(VALVE, 1))
    outcome = Outcome(model=SimpleNamespace(process=None))  # type: ignore[arg-type]
    _, against = tuner._borne_in_large_moves(outcome, None, SimpleNamespace(pulse=refused))
    assert against == "it is not known how fast the actuator is: the process's response is not known"
