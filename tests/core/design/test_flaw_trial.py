"""Large moves before an actuator that is slow, and what spares the loop the limit cycle they would leave it in."""

from __future__ import annotations

import math
import re
from dataclasses import replace

import numpy as np
import pytest

from fopid_core.design.flaw_trial import FlawTrial
from fopid_core.design.identification.flaws import Flaws
from fopid_core.model.fopid import Fopid
from fopid_core.model.loop import Loop
from fopid_core.model.process import Process
from fopid_core.model.two_degrees import NO_FILTER, WHOLE_SETPOINT, MeasurementFilter, SetpointWeights
from fopid_core.runtime.controller import FopidController
from fopid_core.runtime.settings import UNPACED, Pace, as_designed

TICK, RATE, ROOM = 0.1, 7.0, (-50.0, 50.0)
PROCESS = Process.parse("1/((7s+1)(1.5s+1))")
START = Loop(PROCESS, Fopid(kp=4.0, ki=0.6))
LIVELY = Loop(PROCESS, Fopid(kp=6.5, ki=1.95, kd=5.7))
BY_A_HAIR = Loop(PROCESS, Fopid(kp=9.0, ki=3.0, kd=7.5))


@pytest.fixture(scope="module")
def trial() -> FlawTrial:
    return FlawTrial(PROCESS, Flaws(rate=RATE), TICK, 0.0, START, ROOM)


def swing(
    rate: float, pace: Pace, setpoint: float, load: float, gain: float = 1.0, gains: Fopid = LIVELY.controller
) -> float:
    """How far the measurement still goes in the last quarter of 200 s, by explicit small steps."""
    settings = as_designed(gains, TICK, NO_FILTER, WHOLE_SETPOINT, pace)
    controller = FopidController(replace(settings, control_min=ROOM[0], control_max=ROOM[1]))
    valve = first = second = 0.0
    seen = []
    for _ in range(2000):
        control = controller.step(setpoint, second)
        for _ in range(20):
            valve += min(max(control - valve, -rate * TICK / 20), rate * TICK / 20)
            first += TICK / 20 * (gain * (valve + load) - first) / 7.0
            second += TICK / 20 * (first - second) / 1.5
        seen.append(second)
    return float(np.ptp(seen[1500:]))


def test_gains_that_swing_for_ever_before_a_slow_actuator_are_refused_and_held_to_its_pace_are_not(
    trial: FlawTrial,
) -> None:
    assert "the actuator may be as slow as 7 a second" in trial.refusal(LIVELY)
    assert trial.refusal(LIVELY, trial.pace(LIVELY)) == ""


@pytest.mark.parametrize("rate", [5.0, 7.0, 9.0])
def test_so_it_is_with_a_valve_and_a_plant_that_share_no_code(trial: FlawTrial, rate: float) -> None:
    """Also where the actuator is slower, or faster, than it was learnt to be, and in larger moves than were tried."""
    assert swing(7.0, UNPACED, 10.0, 0.0) > 10.0
    pace = trial.pace(LIVELY)
    for setpoint, load in ((10.0, 0.0), (0.0, 10.0), (30.0, 0.0)):
        assert swing(rate, pace, setpoint, load) < 1e-3


@pytest.mark.slow
def test_gains_that_a_pace_holds_by_a_hair_are_refused(trial: FlawTrial) -> None:
    """Where the process answers large moves twice as strongly they swing from limit to limit at that pace."""
    pace = trial.pace(BY_A_HAIR)
    assert "with 2 times the gain" in trial.refusal(BY_A_HAIR, pace)
    assert swing(RATE, pace, 0.0, 10.0, gains=BY_A_HAIR.controller) < 1e-3
    assert swing(RATE, pace, 0.0, 10.0, gain=2.0, gains=BY_A_HAIR.controller) > 10.0
    for load, setpoint in ((0.0, 10.0), (10.0, 0.0)):
        assert swing(RATE, trial.pace(LIVELY), setpoint, load, gain=2.0) < 1e-3


@pytest.mark.slow
def test_a_pace_that_noise_alone_runs_into_is_none() -> None:
    """It holds the derivative back at rest; how fast noise moves the control is counted over 4000 explicit ticks."""
    level, random = 0.02, np.random.default_rng(5)
    controller = FopidController(as_designed(LIVELY.controller, TICK, NO_FILTER, WHOLE_SETPOINT))
    noisy = FlawTrial(PROCESS, Flaws(rate=RATE), TICK, level, START, ROOM)
    said = re.search(r"noise alone moves by (\S+) a second", noisy.refusal(LIVELY, noisy.pace(LIVELY)))
    assert said is not None
    first = second = 0.0
    seen = []
    for noise in (level * random.standard_normal(4000)).tolist():
        seen.append(controller.step(0.0, second + noise))
        for _ in range(20):
            first += TICK / 20 * (seen[-1] - first) / 7.0
            second += TICK / 20 * (first - second) / 1.5
    assert float(said[1]) == pytest.approx(np.std(np.diff(seen)) / TICK, rel=0.05)
    quiet = FlawTrial(PROCESS, Flaws(rate=RATE), TICK, 0.03 * level, START, ROOM)
    assert quiet.refusal(LIVELY, quiet.pace(LIVELY)) == ""


CAREFUL, BRISK = Loop(PROCESS, Fopid(kp=1.0, ki=0.1)), Loop(PROCESS, Fopid(kp=5.5, ki=1.5, kd=5.0))


@pytest.mark.slow
def test_where_noise_forbids_a_pace_the_setpoint_alone_is_held_back() -> None:
    """The controller moves its control as it likes, and comes to rest from loads of up to 0.3 of the range as well."""
    noisy = FlawTrial(PROCESS, Flaws(rate=RATE), TICK, 0.02, CAREFUL, ROOM)
    assert "after a setpoint step" in noisy.refusal(BRISK)
    pace = noisy.pace(BRISK)
    assert math.isinf(pace.control)
    assert 0.1 * RATE < pace.setpoint < RATE
    assert noisy.refusal(BRISK, pace) == ""
    assert swing(0.7 * RATE, UNPACED, 10.0, 0.0, gains=BRISK.controller) > 10.0
    for setpoint, load in ((10.0, 0.0), (30.0, 0.0), (0.0, 10.0), (0.0, 20.0), (0.0, 30.0)):
        for rate in (0.7 * RATE, RATE):
            assert swing(rate, pace, setpoint, load, gains=BRISK.controller) < 1e-3


def test_not_where_a_large_load_would_set_the_loop_swinging_all_the_same(trial: FlawTrial) -> None:
    ramp = trial.ramp(BY_A_HAIR)
    assert math.isfinite(ramp.setpoint)
    assert "after a load of" in trial.refusal(BY_A_HAIR, ramp)
    assert swing(RATE, ramp, 10.0, 0.0, gains=BY_A_HAIR.controller) < 1e-3
    assert swing(RATE, ramp, 0.0, 30.0, gains=BY_A_HAIR.controller) > 10.0


def test_a_ramp_that_gains_little_is_none(trial: FlawTrial) -> None:
    assert trial.ramp(CAREFUL) == UNPACED


def test_what_needs_no_pace_is_not_asked_for_more_gain() -> None:
    trial = FlawTrial(PROCESS, Flaws(rate=1e4), TICK, 0.0, START, ROOM)
    fragile = Loop(PROCESS, Fopid(kp=40.0, ki=30.0, kd=15.0))  # at twice the gain it runs away in small moves
    assert trial.refusal(fragile) == ""


def test_steps_as_small_as_a_dead_band_can_be_left_out() -> None:
    play, weaker = Flaws(rate=1e4, dead_band=0.1, slip=0.0), Loop(PROCESS, Fopid(kp=3.9, ki=0.5))
    assert "the actuator has play" in FlawTrial(PROCESS, play, TICK, 0.0, START, ROOM).refusal(weaker)
    assert "a load of 2 times that" not in FlawTrial(PROCESS, play, TICK, 0.0, START, ROOM, large_only=True).refusal(
        weaker
    )


def test_the_control_is_held_to_the_actuator_and_the_setpoint_to_what_it_can_follow(trial: FlawTrial) -> None:
    pace = trial.pace(LIVELY)
    assert pace.control == RATE
    assert 0.1 * RATE < pace.setpoint < RATE


def test_nobody_is_held_to_a_pace_where_no_actuator_is_slow_or_no_limits_say_what_is_large() -> None:
    for flaws, room in ((Flaws(dead_band=0.1), ROOM), (Flaws(rate=RATE), (-math.inf, math.inf))):
        assert FlawTrial(PROCESS, flaws, TICK, 0.0, START, room).pace(LIVELY) == UNPACED


def test_what_runs_is_tried_at_its_own_pace() -> None:
    hurried, held = (
        FlawTrial(PROCESS, Flaws(rate=RATE), TICK, 0.0, BY_A_HAIR, ROOM, pace) for pace in (UNPACED, Pace(RATE, 2.0))
    )
    assert hurried.refusal(BY_A_HAIR) == ""
    assert held.refusal(BY_A_HAIR) == ""  # others are held to no more than what runs
    slow_ramp = Pace(RATE, 0.15)
    assert hurried.refusal(BY_A_HAIR, Pace(setpoint=0.15)) == ""  # beside what swings
    assert "after a setpoint step" in held.refusal(BY_A_HAIR, slow_ramp)


def test_a_ramp_may_be_as_fast_as_the_actuator_where_a_slower_one_costs_error() -> None:
    """After a step of the setpoint the slower one would leave 1.2 times the error of what runs."""
    trial = FlawTrial(PROCESS, Flaws(rate=10.0), TICK, 0.0, START, ROOM)
    quick = Loop(PROCESS, Fopid(kp=5.0, ki=1.0, kd=4.0))
    pace = trial.pace(quick)
    assert trial.refusal(quick, pace) == ""
    slower = replace(pace, setpoint=0.6 * pace.setpoint)
    assert "after a setpoint step of 9.8 1.2 times the error of what runs" in trial.refusal(quick, slower)


def test_a_ramp_excuses_no_further_error() -> None:
    """A fifth more was allowed after a step of the setpoint for a ramp: a reactor was worse than before its tuning."""
    process = Process.parse("1/(7s+1)")
    runs, other = (Loop(process, Fopid(kp=4.0, ki=4.0), weights=SetpointWeights(share, 1.0)) for share in (0.5, 0.9))
    trial = FlawTrial(process, Flaws(rate=50.0), TICK, 0.0, runs, ROOM)
    assert "1.1 times the error of what runs is left" in trial.refusal(other, Pace(setpoint=1e5))


@pytest.mark.slow
def test_a_ship_is_asked_to_turn_as_slowly_as_its_rudder_needs() -> None:
    """It gathers what the rudder did, so no share of what a lag could follow is slow enough; explicit small steps."""
    ship, tick, rate, room = Process.parse("0.08/(s(40s+1))"), 0.5, 2.1, (-35.0, 35.0)
    begins, slow = Loop(ship, Fopid(kp=0.5, ki=0.003, kd=5.0)), MeasurementFilter(2, 1.8)
    lively = Loop(ship, Fopid(kp=4.9, ki=0.0764, kd=54.5), slow, SetpointWeights(1.0, 0.0))
    trial = FlawTrial(ship, Flaws(rate=rate), tick, 0.02, begins, room)
    pace = trial.pace(lively)
    assert trial.refusal(lively, pace) == ""
    assert "after a setpoint step" in trial.refusal(lively)

    def turned(pace: Pace) -> float:
        settings = as_designed(lively.controller, tick, slow, lively.weights, pace)
        controller = FopidController(replace(settings, control_min=room[0], control_max=room[1]))
        rudder = speed = heading = 0.0
        seen = []
        for _ in range(1600):
            control = controller.step(70.0, heading)
            for _ in range(20):
                rudder += min(max(control - rudder, -rate * tick / 20), rate * tick / 20)
                speed += tick / 20 * (0.08 * rudder - speed) / 40.0
                heading += tick / 20 * speed
            seen.append(heading)
        return float(np.ptp(seen[1200:]))

    assert turned(pace) < 0.5
    assert turned(UNPACED) > 50.0
