"""An actuator's dead band is learnt where there is one, and nowhere else: plants stepped through in plain Python."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from fopid_core.design.flaw_trial import FlawTrial
from fopid_core.design.identification.drift import drift
from fopid_core.design.identification.flaws import Flaws, Stem
from fopid_core.design.identification.identify import identify
from fopid_core.design.identification.record import Record
from fopid_core.design.recorded_tuning import tune_recorded
from fopid_core.model.fopid import Fopid
from fopid_core.model.indices import indices
from fopid_core.model.loop import Loop
from fopid_core.model.process import Process
from fopid_core.model.response import step_response
from tests.cases import slow

TICK, LAG, DELAY, GAIN = 1.0, 20.0, 5, 2.0
LEVEL = 0.02
"""Of the measurement's noise, a standard deviation."""

Moved = Callable[[float, float], float]


def play(half: float) -> Moved:
    """Backlash: the stem is pushed by either side of a gap."""
    return lambda control, stem: min(max(stem, control - half), control + half)


def stick(size: float) -> Moved:
    """Stiction by one parameter (Stenman 2003): it stays, or jumps to where it ought to be."""
    return lambda control, stem: control if abs(control - stem) > size else stem


def stick_with_play(size: float, half: float) -> Moved:
    """A stem that sticks, and what it moves by a joint with a gap: it stands still within that."""
    stem = 0.0

    def moved(control: float, beyond: float) -> float:
        nonlocal stem
        stem = stick(size)(control, stem)
        return play(half)(stem, beyond)

    return moved


def recorded(
    stem: Moved, seed: int, noise: str = "white", integrates: bool = False, count: int = 1500, gain: float = GAIN
) -> Record:
    """A loop under a PI, moved by steps at random: a lag (or an integrator) behind a delay, in exact steps."""
    random = np.random.default_rng(seed)
    added = np.repeat(random.choice([-0.5, 0.5], count // 15 + 1), 15)[:count]
    white = random.standard_normal(count)
    sensor = LEVEL * white
    if noise == "slow":
        for k in range(1, count):
            sensor[k] = 0.95 * sensor[k - 1] + LEVEL * math.sqrt(1.0 - 0.95**2) * white[k]
    if noise == "hum":
        sensor += 2.0 * LEVEL * np.sin(0.7 * np.arange(count))
    pole = 1.0 if integrates else math.exp(-TICK / LAG)
    growth = gain * TICK / LAG if integrates else gain * (1.0 - pole)
    load = 0.2 * (np.arange(count) > 0.6 * count) if noise == "load" else np.zeros(count)
    controls, measured, waiting, place, state, integral = [], [], [0.0] * DELAY, 0.0, 0.0, 0.0
    for k in range(count):
        read = state + sensor[k]
        if noise == "coarse":
            read = 0.1 * round(read / 0.1)
        integral -= 0.03 * read
        control = integral - 0.6 * read + added[k]
        controls.append(control)
        measured.append(read)
        place = stem(control, place)
        waiting.append(place + load[k])
        state = pole * state + growth * waiting.pop(0)
    return Record(TICK * np.arange(count), np.array(controls), np.array(measured))


@pytest.mark.parametrize("flaws", [
    Flaws(), Flaws(dead_band=0.4), Flaws(dead_band=0.4, slip=0.0), Flaws(dead_band=0.4, slip=0.7),
    Flaws(low=-0.5, high=1.0), Flaws(dead_band=0.3, play=0.2, low=-1.0), Flaws(play=0.3),
])  # fmt: skip
def test_tick_by_tick_the_same_is_felt_as_of_a_whole_record(flaws: Flaws) -> None:
    controls = np.append(0.0, np.cumsum(0.3 * np.random.default_rng(4).standard_normal(300)))
    stem = Stem(flaws)
    assert [stem.step(control) for control in controls.tolist()] == pytest.approx(flaws.felt(controls)[0].tolist())


@pytest.mark.long
@pytest.mark.parametrize("integrates", [False, True])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_play_is_learnt_and_the_process_behind_it(seed: int, integrates: bool) -> None:
    record = recorded(play(0.1), seed, integrates=integrates)
    found = identify(record, noise=LEVEL)
    assert found.success
    assert found.flaws.dead_band == pytest.approx(0.1, rel=0.05)
    assert found.flaws.slip == 0.0
    assert "the actuator has play within 0." in found.message
    w = 0.05
    true = GAIN * np.exp(-1j * w * (DELAY + 0.5) * TICK) / (1j * w * LAG + (0.0 if integrates else 1.0))
    assert found.best is not None
    off = abs(found.best.process(1j * w) / true - 1.0)
    taken_for_linear = identify(record, "foptd", noise=LEVEL).best
    assert taken_for_linear is not None
    assert off < 0.03 < 0.04 < abs(taken_for_linear.process(1j * w) / true - 1.0)


@pytest.mark.long
@pytest.mark.parametrize(("count", "expected"), [(9000, 0.1), (33000, 0.0)])
def test_long_records_show_it_as_well_unless_they_are_averaged(count: int, expected: float) -> None:
    found = identify(recorded(play(0.1), 3, count=count), noise=LEVEL)
    assert found.success
    assert found.flaws.dead_band == pytest.approx(expected, rel=0.05)


@pytest.mark.parametrize("seed", slow(0, 1, 2, 3, 4, 5))
def test_stiction_is_told_from_play(seed: int) -> None:
    found = identify(recorded(stick(0.15), seed), noise=LEVEL)
    assert found.flaws.dead_band == pytest.approx(0.15, rel=0.02)
    assert found.flaws.slip == 1.0
    assert found.flaws.play == 0.0
    assert "the actuator sticks within 0.1" in found.message


@pytest.mark.long
@pytest.mark.parametrize("integrates", [True, False])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_play_behind_what_sticks_is_learnt_beside_it(seed: int, integrates: bool) -> None:
    """As valves of control have both: the stem sticks in its packing, and what drives it has a worn joint."""
    found = identify(recorded(stick_with_play(0.15, 0.05), seed, integrates=integrates), noise=LEVEL)
    assert found.flaws.dead_band == pytest.approx(0.15, rel=0.02)
    assert found.flaws.slip == 1.0
    assert found.flaws.play == pytest.approx(0.05, rel=0.1)
    assert "the actuator sticks within 0.1" in found.message
    assert " and has play within 0.0" in found.message


def test_loops_behind_both_are_tried_with_both() -> None:
    """An integrator held by a PI at ticks of 0.1 s after a load of 20 times what sticks, stepped through here."""
    flaws, gains = Flaws(dead_band=0.1, play=0.06), Fopid(kp=1.0, ki=0.1)
    others = Fopid(kp=0.9, ki=0.4)

    def left(tried: Fopid, load: float, count: int = 500) -> float:
        state = place = integral = total = 0.0
        stem = stick_with_play(0.1, 0.06)
        for _ in range(count):
            integral -= tried.ki * 0.1 * state
            place = stem(integral - tried.kp * state, place)
            state += 0.1 * (place + load)
            total += abs(state)
        return total

    process = Process.parse("1/s")
    trial = FlawTrial(process, flaws, 0.1, 0.0, Loop(process, gains))
    expected = left(others, 2.0) / left(gains, 2.0)
    assert trial.load_share(Loop(process, others)) == pytest.approx(expected, rel=0.05)
    without = FlawTrial(process, replace(flaws, play=0.0), 0.1, 0.0, Loop(process, gains))
    assert without.load_share(Loop(process, others)) != pytest.approx(expected, rel=0.05)


@pytest.mark.parametrize("noise", ["white", *slow("coarse", "load", "slow", "hum")])
@pytest.mark.parametrize("integrates", [False, *slow(True)])
def test_where_there_is_none_none_is_found(noise: str, integrates: bool) -> None:
    for seed in range(3):
        assert identify(recorded(lambda control, _: control, 100 + seed, noise, integrates)).flaws == Flaws()


@pytest.mark.long
def test_gains_from_a_record_are_for_the_process_behind_the_play_and_that_is_said() -> None:
    signals = recorded(play(0.1), 0)
    whole = tune_recorded(signals, "frequency")  # the flattest phase asks for an integral of a higher order
    assert not whole.success
    assert "with which a loop goes on cycling behind play, stiction or friction; allowed: up to 1.05" in whole.message
    found = tune_recorded(signals, "rule", {"rule": "simc-pi"})
    assert found.success
    assert "the actuator has play within 0." in found.message
    assert "without one" not in found.message  # what is seen without a model is seen behind the play, too
    assert found.identified.best is not None
    assert found.identified.best.parameters["T"] == pytest.approx(LAG, rel=0.05)


@pytest.mark.long
def test_a_process_is_judged_anew_behind_the_same_play() -> None:
    model = identify(recorded(play(0.1), 0), noise=LEVEL).best
    assert model is not None
    assert model.flaws.dead_band == pytest.approx(0.1, rel=0.05)
    assert drift(model, recorded(play(0.1), 1)).drifted is False
    changed = drift(model, recorded(play(0.1), 2, gain=1.4 * GAIN))
    assert changed.drifted
    assert changed.proposal is not None
    assert changed.proposal.best is not None
    assert changed.proposal.best.parameters["K"] == pytest.approx(1.4 * GAIN, rel=0.05)
    assert changed.proposal.flaws == model.flaws


@pytest.mark.slow
def test_a_control_that_stays_where_it_is_shows_none() -> None:
    time = np.arange(200.0)
    record = Record(time, np.ones(200), 1.0 - np.exp(-time / 20.0) + 0.1 * np.sin(0.1 * time))
    assert identify(record).flaws == Flaws()


def test_a_template_that_was_asked_for_is_fitted_as_it_is() -> None:
    assert identify(recorded(play(0.1), 0), "foptd").flaws == Flaws()


def cycling(gains: Fopid, half: float, count: int = 2000) -> float:
    """Largest error of the last fifth of a loop at rest on an integrator behind play, stepped through here."""
    state, place, integral, seen = 1.0, 0.0, 0.0, []
    for _ in range(count):
        integral -= gains.ki * 0.1 * state
        place = play(half)(integral - gains.kp * state, place)
        state += 0.1 * place
        seen.append(abs(state))
    return max(seen[-count // 5 :])


def load_error(loop: Loop) -> float:
    response = step_response(loop, 100.0, "load")
    return indices(response.time, response.error).iae


def test_gains_that_cycle_wider_behind_play_than_those_that_run_are_refused() -> None:
    process, flaws = Process.parse("1000/(1000s+1)"), Flaws(dead_band=0.1, slip=0.0)
    runs, calm, lively = Fopid(kp=0.5, ki=0.05), Fopid(kp=1.0, ki=0.2), Fopid(kp=0.3, ki=0.3)
    assert cycling(lively, 0.1) > 1.5 * cycling(runs, 0.1) > 1.5 * cycling(calm, 0.1)
    trial = FlawTrial(process, flaws, 0.1, 0.0, Loop(process, runs))
    linear = {gains: load_error(Loop(process, gains)) for gains in (runs, calm, lively)}
    assert linear[lively] < 0.5 * linear[runs]  # as if there were no play it would be much better
    assert trial.refusal(Loop(process, calm)) == ""
    assert "the actuator has play within 0.1: after a load of" in trial.refusal(Loop(process, lively))
