"""Which loop is best: errors first, what the rules leave and move as the mark, quiet where it costs no load."""

from __future__ import annotations

import copy
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import trapezoid

from fopid_core.design.flaw_trial import FlawTrial
from fopid_core.design.identification.flaws import Flaws
from fopid_core.design.loop_judge import (
    AHEAD,
    AHEAD_IN_NOISE,
    ALIKE,
    BEHIND,
    HARDLY_MOVES,
    NEARLY,
    PLAIN,
    LoopJudge,
    RunningGains,
)
from fopid_core.design.loop_worth import LoopWorth, loop_worth
from fopid_core.design.sampled_loop import running
from fopid_core.model.fopid import Fopid
from fopid_core.model.indices import indices
from fopid_core.model.loop import Loop
from fopid_core.model.margins import margins
from fopid_core.model.process import Process
from fopid_core.model.response import step_response
from fopid_core.model.stability import stability
from fopid_core.model.two_degrees import NO_FILTER, SetpointWeights
from fopid_core.runtime.controller import FopidController
from fopid_core.runtime.plant import Plant, PlantSettings
from fopid_core.runtime.settings import as_designed
from fopid_core.runtime.simulation import simulate

RULE = LoopWorth(1.0, 0.5, 1.6, 2.0)


@pytest.fixture(scope="module")
def alone() -> LoopJudge:
    runs = RunningGains(Fopid(0.2, 0.05), noise=0.01, control_movement=0.1)
    return LoopJudge(Process.parse("1/(s+1)*exp(-0.2s)"), 0.05, runs, 2.2)


@pytest.fixture
def judge(alone: LoopJudge) -> LoopJudge:
    judge = copy.copy(alone)
    judge.note_textbook(RULE)
    return judge


@pytest.mark.parametrize(("times", "earlier", "expected"), [
    (0.9 * NEARLY, np.inf, 4.0), (1.1 * NEARLY, np.inf, 50.0), (3.0 * NEARLY, 1e3, 4.0),
])  # fmt: skip
def test_a_rule_that_noise_forbids_is_no_measure_of_movement_where_an_allowed_one_is_nearly_as_good(
    alone: LoopJudge, times: float, earlier: float, expected: float
) -> None:
    """In a further round in any case; what is aimed at of the load is the best rule's all the same."""
    judge = copy.copy(alone)
    judge.running = replace(judge.running, noise_gain_aim=earlier)
    judge.note_textbook(replace(RULE, load=0.1, noise_gain=50.0))
    judge.note_textbook(replace(RULE, load=0.1 * times, noise_gain=4.0))
    assert judge.noise_gain_aim == pytest.approx(min(AHEAD_IN_NOISE * expected, judge.noise_gain_max))
    assert judge.load_aim == pytest.approx(AHEAD * 0.1)


def test_a_second_round_aims_at_no_more_movement_than_the_first(judge: LoopJudge) -> None:
    aim = judge.noise_gain_aim
    for earlier, expected in ((2.0 * aim, aim), (0.9 * aim, 0.9 * aim), (1e-6, judge.worth(judge.runs).noise_gain)):
        judge.running = replace(judge.running, noise_gain_aim=earlier)
        assert judge.noise_gain_aim == pytest.approx(expected), "what runs moves it as much"


def test_a_second_round_aims_at_no_more_than_now_where_no_rule_does_better(alone: LoopJudge) -> None:
    """A crane's second round, whose first left less than all rules, moved the control eightfold for that."""
    judge, now = copy.copy(alone), alone.worth(alone.runs).noise_gain
    assert judge.noise_gain_aim == judge.noise_gain_max
    judge.running = replace(judge.running, noise_gain_aim=0.9 * judge.noise_gain_max)
    assert judge.noise_gain_aim == pytest.approx(max(now, HARDLY_MOVES * judge.noise_gain_max))


@pytest.mark.parametrize(("gains", "weights"), [
    (Fopid(2.0, 0.5), SetpointWeights(1.0, 0.0)), (Fopid(0.5, 0.3), SetpointWeights(0.0, 0.0)),
])  # fmt: skip
def test_a_control_that_would_move_faster_than_its_actuator_is_refused(gains: Fopid, weights: SetpointWeights) -> None:
    """How fast it moves is what the running loop shows."""
    process, h = Process.parse("1/(s+1)"), 0.05
    plant = Plant(PlantSettings(process, h))
    trace = simulate(FopidController(as_designed(gains, h, NO_FILTER, weights)), plant, 400, lambda _: 1.0)
    rate = float(np.abs(np.diff(np.append(0.0, trace.control))).max()) / h
    loop = Loop(process, gains, weights=weights)
    for share, refused in ((1.1, False), (0.9, True)):
        runs = RunningGains(Fopid(0.1, 0.01), control_rate=share * rate, weights=SetpointWeights(0.0, 0.0))
        assert bool(LoopJudge(process, h, runs, 2.2).too_fast(loop)) == refused
    assert not LoopJudge(process, h, RunningGains(Fopid(0.1, 0.01)), 2.2).too_fast(loop)
    lively = RunningGains(Fopid(6.0, 1.0), control_rate=0.5 * rate)
    assert not LoopJudge(process, h, lively, 2.2).too_fast(loop), "what runs moves it as fast"


def test_what_runs_is_judged_behind_the_hold_where_only_that_tames_its_derivative() -> None:
    """A motor learnt as a lag of order 0.993: with a derivative alone it would be unstable, far beyond the ticks."""
    process, h = Process.parse("6.89/(s^0.993+0.0035)*exp(-0.00585s)"), 0.002
    gains = Fopid(1.0, 0.5, 0.01)
    assert not stability(Loop(process, gains)).stable
    judge = LoopJudge(process, h, RunningGains(gains, noise=0.001), 2.2)
    response = step_response(Loop(process, Fopid(1.0, 0.5)), 20.0)  # whose derivative hardly does anything
    seen = judge.worth(Loop(judge.process, gains))
    assert seen.setpoint == pytest.approx(indices(response.time, response.error).iae, rel=0.02)


@pytest.mark.parametrize(("text", "h", "gains"), [
    ("1.5/(0.8s+1)*exp(-0.1s)", 0.1, Fopid(2.0, 5.0)), ("1.5/(0.8s+1)*exp(-0.3s)", 0.1, Fopid(1.0, 1.5)),
    ("1/((5s+1)(80s+1))*exp(-s)", 2.0, Fopid(10.0, 0.3)),
])  # fmt: skip
def test_a_loop_is_judged_as_it_runs_with_its_control_held(text: str, h: float, gains: Fopid) -> None:
    """Run tick by tick. Without the hold the first loop, a reactor's, seemed to have max |S| 1.5, for 1.97."""
    process = Process.parse(text)
    worth, alone = loop_worth(Loop(process, gains), h, 200.0 * h), margins(Loop(process, gains)).ms
    assert worth.setpoint == pytest.approx(run_error(process, h, gains, setpoint=1.0), rel=0.01)
    assert worth.load == pytest.approx(run_error(process, h, gains, load=1.0), rel=0.01)
    ms = running(process, gains, h).ms
    assert abs(worth.ms / ms - 1.0) < 0.01 < 0.1 < abs(alone / ms - 1.0)


def run_error(process: Process, h: float, gains: Fopid, setpoint: float = 0.0, load: float = 0.0) -> float:
    """Integral of the absolute error of a controller that ticks beside a plant in steps of a twentieth of that."""
    plant, errors, control = Plant(PlantSettings(process, h / 20.0)), [], 0.0
    controller = FopidController(as_designed(gains, h, NO_FILTER, SetpointWeights()))
    for k in range(200 * 20):
        if k % 20 == 0:
            control = controller.step(setpoint, plant.measurement)
        errors.append(abs(setpoint - plant.measurement))
        plant.step(control + load)
    return float(trapezoid(errors, dx=h / 20.0))


@pytest.mark.parametrize(("gains", "terms"), [
    (Fopid(1.0, 1.0), 0), (Fopid(1.0, 1.0, 0.0, 1.0, 0.5), 0), (Fopid(1.0, 1.0, 0.1), 1),
    (Fopid(1.0, 1.0, 0.0, 0.9), 1), (Fopid(1.0, 1.0, 0.1, 1.0, 1.2), 2),
])  # fmt: skip
def test_a_derivative_and_orders_that_are_not_whole_must_pay(judge: LoopJudge, gains: Fopid, terms: int) -> None:
    assert judge.score(RULE, gains) == pytest.approx(PLAIN**terms * judge.score(RULE))


def test_the_rule_that_leaves_least_after_a_load_is_the_mark(judge: LoopJudge) -> None:
    assert judge.textbook == RULE
    judge.note_textbook(replace(RULE, load=0.6))
    judge.note_textbook(replace(RULE, load=0.1, ms=2.3))
    assert judge.textbook == RULE, "neither more error nor a rule beyond the limit on max |S|"
    assert judge.noise_gain_aim == pytest.approx(AHEAD_IN_NOISE * RULE.noise_gain)


def test_of_rules_that_leave_about_as_much_the_quietest_says_how_much_movement_that_takes(judge: LoopJudge) -> None:
    least = replace(RULE, load=0.45, noise_gain=4.0)
    judge.note_textbook(least)
    assert judge.textbook == least
    assert judge.noise_gain_aim == pytest.approx(AHEAD_IN_NOISE * RULE.noise_gain)
    judge.note_textbook(replace(RULE, load=RULE.load / ALIKE - 1e-3, noise_gain=3.0))
    assert judge.noise_gain_aim == pytest.approx(AHEAD_IN_NOISE * 3.0), "one that leaves over a fifth more is no match"


def test_a_rule_that_hardly_moves_the_control_does_not_hold_designs_back(alone: LoopJudge) -> None:
    for share, aim in ((0.05, 0.05), (0.5, 0.3)):  # of what is allowed
        judge = copy.copy(alone)
        judge.note_textbook(replace(RULE, noise_gain=share * alone.noise_gain_max))
        assert judge.noise_gain_aim == pytest.approx(aim * alone.noise_gain_max)


def test_quiet_never_costs_more_load_than_the_rule_leaves(judge: LoopJudge) -> None:
    lively = replace(RULE, load=AHEAD * RULE.load, noise_gain=judge.noise_gain_aim)
    for share in (0.5, 0.1, 0.01):
        assert judge.score(replace(lively, load=1.01 * lively.load, noise_gain=share * lively.noise_gain)) > (
            judge.score(lively)
        )


def test_where_both_leave_less_than_the_rule_half_the_movement_is_worth_some_error(judge: LoopJudge) -> None:
    lively = replace(RULE, load=0.5 * RULE.load, noise_gain=judge.noise_gain_aim)
    quieter = replace(lively, noise_gain=0.5 * lively.noise_gain)
    assert judge.score(quieter) < judge.score(lively)
    assert judge.score(replace(quieter, load=1.2 * quieter.load)) < judge.score(lively)
    assert judge.score(replace(quieter, load=1.4 * quieter.load)) > judge.score(lively)


def test_what_no_design_reaches_is_no_aim(judge: LoopJudge) -> None:
    """The rule's own error then; and where none reaches that either, a ninth more than the best leaves."""
    lively = replace(RULE, noise_gain=judge.noise_gain_aim)
    for least, aim in (
        (0.3, AHEAD * RULE.load),
        (0.9 * RULE.load, RULE.load),
        (1.2 * RULE.load, 1.2 * RULE.load / BEHIND),
    ):
        judge.note_reach([replace(lively, load=load) for load in (2.0 * least, least)])
        assert judge.load_aim == pytest.approx(aim)
        within, beyond = (replace(lively, load=share * aim) for share in (0.99, 1.01))
        assert judge.score(replace(within, noise_gain=0.5 * lively.noise_gain)) < judge.score(within)
        assert judge.score(replace(beyond, noise_gain=0.5 * lively.noise_gain)) == judge.score(beyond)
    judge.note_reach([replace(lively, load=0.6), replace(lively, load=0.1, ms=2.3)])
    assert judge.load_aim == pytest.approx(0.6 / BEHIND), "a design beyond the limit on max |S| reaches nothing"


def test_more_movement_than_the_rules_counts_as_much_as_more_error_than_theirs(judge: LoopJudge) -> None:
    good = replace(RULE, load=AHEAD * RULE.load, noise_gain=judge.noise_gain_aim)
    moves = replace(good, noise_gain=1.3 * good.noise_gain)
    leaves = replace(good, load=1.3 * good.load)
    assert judge.score(good) < judge.score(moves)
    assert judge.score(moves) / judge.score(good) == pytest.approx(1.3**2)
    short, errors = judge.score(leaves) / judge.score(good), judge.errors(leaves) / judge.errors(good)
    assert short / errors == pytest.approx(1.3**2)


def test_a_little_less_error_is_not_worth_eleven_times_the_movement(alone: LoopJudge) -> None:
    """What half the movement is worth among designs, an eighth of the error, it is worth beside what runs, too."""
    now = alone.worth(Loop(alone.process, alone.running.gains))
    assert now.noise_gain < 0.05 * alone.noise_gain_max, "what nobody feels is no movement"
    felt = 0.05 * alone.noise_gain_max
    for movement, least in ((0.5 * felt, 0.95), (felt, 0.95), (2.0 * felt, 0.95 / 2.0**0.2), (11.0 * felt, 0.588)):
        for share, refused in ((0.99 * least, False), (1.01 * least, True)):
            new = replace(now, setpoint=share * now.setpoint, load=share * now.load, noise_gain=movement)
            assert bool(alone.not_better(new)) == refused


def test_the_noise_share_stays_where_the_rules_ask_for_more(judge: LoopJudge) -> None:
    judge.note_textbook(replace(RULE, load=0.3, noise_gain=50.0))
    assert judge.noise_gain_aim == judge.noise_gain_max == pytest.approx(10.0)
    assert judge.too_noisy(replace(RULE, noise_gain=10.1))


def left_behind_a_sticking_valve(gains: Fopid, load: float, sticks: float, ticks: int) -> float:
    """Sum of the absolute error after a load before 0.2/(s(0.5s+1)), by explicit steps of a hundredth of a tick."""
    controller = FopidController(as_designed(gains, 0.05, NO_FILTER, SetpointWeights(1.0, 1.0)))
    valve = speed = at = total = 0.0
    for _ in range(ticks):
        control = controller.step(0.0, at)
        valve = control if abs(control - valve) > sticks else valve
        for _ in range(100):
            at += 0.0005 * 0.2 * speed
            speed += 0.0005 * (valve + load - speed) / 0.5
        total += abs(at)
    return total


@pytest.mark.slow
def test_behind_a_valve_that_sticks_loads_are_judged_with_it() -> None:
    """A lively PI hunts behind one before an integrator, which no linear process shows."""
    process, flaws, sticks = Process.parse("0.2/(s(0.5s+1))"), Flaws(dead_band=0.8), 0.8
    runs, new = Fopid(3.0, 0.5), Fopid(6.0, 4.0)
    judge = LoopJudge(process, 0.05, RunningGains(runs), 2.5)
    linear = judge.worth(Loop(process, new)).load / judge.worth(judge.runs).load
    judge = LoopJudge(process, 0.05, RunningGains(runs), 2.5)
    judge.see_flaws(FlawTrial(process, flaws, 0.05, 0.0, judge.runs))
    seen = judge.worth(Loop(process, new)).load / judge.worth(judge.runs).load
    left = [left_behind_a_sticking_valve(gains, 20.0 * sticks, sticks, 1000) for gains in (new, runs)]
    assert seen == pytest.approx(left[0] / left[1], rel=0.05)
    assert seen > 1.5 * linear


@pytest.mark.slow
def test_an_actuator_that_is_slow_alone_changes_no_load_that_is_small(alone: LoopJudge) -> None:
    judge = LoopJudge(Process.parse("1/(s+1)*exp(-0.2s)"), 0.05, alone.running, 2.2)  # a copy would share what it knows
    judge.see_flaws(FlawTrial(judge.process, Flaws(rate=5.0), 0.05, 0.0, judge.runs, (-50.0, 50.0)))
    new = Loop(judge.process, Fopid(0.5, 0.4))
    assert judge.worth(new) == alone.worth(new)
