"""What a record says of noise, limits and sample time bounds the design, and holds when the loop runs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fopid_core.design.identification.record import Record
from fopid_core.design.recorded_tuning import NOISE_SHARE, RECORDED_SHARE, RecordedTuning, tune_recorded
from fopid_core.design.robust_verification import RobustLimits
from fopid_core.design.specification import TuningResult
from fopid_core.model.fopid import Fopid
from fopid_core.model.loop import Loop
from fopid_core.model.process import read_process
from fopid_core.model.response import step_response
from fopid_core.model.stability import stability
from fopid_core.model.two_degrees import NO_FILTER, SetpointWeights
from fopid_core.runtime.controller import FopidController
from fopid_core.runtime.plant import Plant, PlantSettings
from fopid_core.runtime.settings import as_designed
from fopid_core.runtime.simulation import Trace, simulate

from .identification.recorded import closed_loop, open_loop, step_record

PROCESS, H, NOISE = "2/(10s+1)*exp(-3s)", 1.0, 0.02
FEW = RobustLimits(samples=5)
RECORD = step_record(PROCESS, 150.0, H, NOISE)
WITHIN = replace(RECORD, control_min=-1.0, control_max=4.0)


def running(found: RecordedTuning, ticks: int, setpoint: float, noise: float, process: str = PROCESS) -> Trace:
    """The loop of the design with the plant that was recorded, from rest."""
    assert found.tuned is not None
    assert found.tuned.tuning is not None
    tuning = found.tuned.tuning
    assert tuning.controller is not None
    settings = as_designed(tuning.controller, H, tuning.filter, tuning.weights)
    plant = Plant(PlantSettings(read_process(process), H, "exact", noise_std=noise, seed=3))
    return simulate(FopidController(settings), plant, ticks, lambda _: setpoint)


def test_sample_time_noise_and_limits_are_those_of_the_record() -> None:
    found = tune_recorded(WITHIN, "time", {"structure": "pi", "index": "iae"}, FEW, template="foptd")
    assert found.success, found.message
    assert found.bounds is not None
    assert found.bounds.noise == pytest.approx(NOISE, rel=0.1)
    assert found.taken["sample_time"] == H
    assert found.taken["noise_rms_max"] == pytest.approx(NOISE_SHARE * 5.0)
    # the control was mostly 1, 2 below its lower limit; without a setpoint half of the way counts as a step
    assert found.taken["u_max"] == pytest.approx(2.0 / 1.0, rel=0.1)
    for said in ("sample time 1 s", "noise 0.0", "at rest", "1 % of the range 5"):
        assert said in found.message


@pytest.mark.parametrize("method", ["frequency", pytest.param("time", marks=pytest.mark.slow)])
def test_noise_moves_the_control_of_the_running_loop_as_little_as_was_said(method: str) -> None:
    found = tune_recorded(WITHIN, method, limits=FEW, template="foptd")
    assert found.success, found.message
    moved = float(np.std(running(found, 6000, 0.0, NOISE).control[500:]))
    assert moved < 1.1 * NOISE_SHARE * 5.0
    told = float(found.message.rpartition("noise moves the control by ")[2])
    assert told == pytest.approx(moved, rel=0.15)  # the noise that was found, and 5500 samples of it


def test_the_loop_overshoots_hardly_more_at_the_records_sample_time_than_as_designed() -> None:
    found = tune_recorded(RECORD, "frequency", limits=FEW, template="foptd")
    assert found.tuned is not None
    assert found.tuned.tuning is not None
    assert found.tuned.tuning.controller is not None
    designed = step_response(Loop(read_process(PROCESS), found.tuned.tuning.controller), 100.0, "setpoint")
    assert running(found, 100, 1.0, 0.0).measurement.max() < designed.output.max() + 0.03


@pytest.mark.slow
def test_a_noisier_record_gives_a_slower_design() -> None:
    noisy = replace(
        WITHIN, measurement=WITHIN.measurement + np.random.default_rng(5).normal(0.0, 0.1, RECORD.time.size)
    )
    crossovers = []
    for record in (WITHIN, noisy):
        found = tune_recorded(record, "frequency", limits=FEW, template="foptd")
        assert found.tuned is not None
        assert found.tuned.tuning is not None
        assert found.tuned.tuning.achieved is not None
        crossovers.append(found.tuned.tuning.achieved.crossover)
    assert crossovers[1] < 0.7 * crossovers[0]


@pytest.mark.parametrize(("rule", "handed_out"), [(None, False), ("simc-pi", True)])
def test_a_rule_that_nobody_named_keeps_the_share_of_noise_as_well(rule: str | None, handed_out: bool) -> None:
    """It moved a control by 9 % of its range where it said that 1 % is allowed."""
    noisy = replace(step_record(PROCESS, 150.0, H, 0.05), control_min=0.0, control_max=2.0)
    found = tune_recorded(noisy, "rule", {"rule": rule}, FEW, template="foptd")
    assert "noise moves the control by" in found.message
    assert found.success == handed_out
    assert ("tune time chooses a filter as well" in found.message) != handed_out


def test_what_is_asked_for_wins() -> None:
    asked = {"sample_time": 0.5, "crossover": 0.05, "u_max": 3.0}
    found = tune_recorded(WITHIN, "frequency", asked, FEW, template="foptd")
    assert found.request is not None
    assert {name: getattr(found.request, name) for name in asked} == asked
    assert not asked.keys() & found.taken.keys()


def test_a_record_that_tells_nothing_is_refused_with_its_reason() -> None:
    still = open_loop(PROCESS, np.zeros(100), H, NOISE)
    found = tune_recorded(still, "frequency")
    assert not found.success
    assert "the control stays at 0" in found.message
    assert found.tuned is None


@pytest.mark.parametrize("process", ["2/(10s+1)", "2/(4s+1)", "1/((8s+1)(0.5s+1))"])
def test_gains_that_are_handed_out_are_calm_at_the_records_sample_time(process: str) -> None:
    found = tune_recorded(step_record(process, 150.0, H, 0.001), "frequency", limits=FEW, template="foptd,soptd")
    assert found.success, found.message
    control = running(found, 150, 1.0, 0.0, process).control
    assert np.abs(np.diff(control[100:])).max() < 0.02


@pytest.mark.parametrize("crossover", [0.02, 0.05])
def test_a_design_that_rings_at_the_records_sample_time_is_refused(crossover: float) -> None:
    record = step_record("2/(10s+1)", 150.0, H, NOISE)
    found = tune_recorded(record, "frequency", {"crossover": crossover}, FEW, "foptd,soptd")
    assert found.tuned is not None
    assert found.tuned.tuning is not None
    assert found.tuned.tuning.running is not None
    assert found.success == (found.tuned.tuning.running.ms <= FEW.ms_max), found.message


@pytest.mark.slow
def test_a_design_that_is_refused_by_who_asks_gives_way_to_a_more_cautious_one() -> None:
    first = tune_recorded(WITHIN, "frequency", limits=FEW, template="foptd")
    assert first.tuned is not None
    assert first.tuned.tuning is not None
    assert first.tuned.tuning.achieved is not None
    quick = first.tuned.tuning.achieved.crossover

    def refuse(tuning: TuningResult) -> str:
        assert tuning.achieved is not None
        return "too quick" if tuning.achieved.crossover > 0.9 * quick else ""

    found = tune_recorded(WITHIN, "frequency", limits=FEW, identified=first.identified, refuse=refuse)
    assert found.success, found.message
    assert found.identified is first.identified
    assert found.tuned is not None
    assert found.tuned.tuning is not None
    assert refuse(found.tuned.tuning) == ""
    none = tune_recorded(WITHIN, "frequency", limits=FEW, identified=first.identified, refuse=lambda _: "too quick")
    assert not none.success
    assert "too quick" in none.message


def test_a_step_at_the_very_first_sample_says_by_how_much_noise_may_move_the_control() -> None:
    late = RECORD.time >= RECORD.time[np.flatnonzero(RECORD.control)[0]]
    at_once = replace(
        RECORD, time=RECORD.time[late], control=RECORD.control[late], measurement=RECORD.measurement[late],
        control_before=0.0,
    )  # fmt: skip
    found = tune_recorded(at_once, "time", {"structure": "pi", "index": "iae"}, FEW, template="foptd")
    assert found.success, found.message
    assert found.bounds is not None
    assert found.bounds.control_from_noise == pytest.approx(RECORDED_SHARE * np.ptp(RECORD.control))


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_heater_that_cools_slower_than_it_heats_gets_no_gains_of_the_wrong_sign(seed: int) -> None:
    """A relay holds it in a swing; no linear process explains that, and what fitted best had the other sign."""
    rng, step = np.random.default_rng(seed), 0.05
    wall = sensor = 24.0
    waiting, rows, sign = [30.0] * 40, [], 1.0
    for k in range(800):
        measured = 20.0 + sensor + 0.05 * rng.standard_normal()
        sign = -1.0 if measured > 44.15 else 1.0 if measured < 43.85 else sign
        control = 30.0 if k < 80 else 30.0 + 9.0 * sign
        rows.append((control, measured))
        for _ in range(20):
            waiting.append(control)
            towards = 0.8 * waiting.pop(0) - wall
            wall, sensor = (
                wall + step * towards / (20.0 if towards > 0.0 else 80.0),
                sensor + step * (wall - sensor) / 6.0,
            )
    control, measured = np.array(rows).T
    found = tune_recorded(Record(np.arange(800.0), control, measured), "time", {"structure": "pid"})
    gains = found.tuned.tuning.controller if found.success and found.tuned and found.tuned.tuning else None
    assert gains is None or gains.kp > 0.0


@pytest.mark.slow
def test_an_integrator_that_is_learnt_from_a_record_gets_an_integral() -> None:
    """Of a setpoint alone none is asked for, and a load would have stayed for ever."""
    record = open_loop("0.05/s*exp(-4s)", np.repeat([0.0, 1.0, 0.0, -1.0, 0.0], 100), 1.0, 0.02)
    found = tune_recorded(record, "time", {"index": "iae", "structure": "pid"})
    assert found.success
    assert (found.taken["input"], found.request.input) == ("both", "both")
    gains = found.tuned.tuning.controller
    assert gains.ki * 150.0 > gains.kp
    asked = tune_recorded(record, "time", {"index": "iae", "structure": "pid", "input": "setpoint"})
    assert asked.request.input == "setpoint"


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1, 2, 3])
def test_a_relay_about_a_process_that_runs_away_gives_gains_that_hold_it_or_none(seed: int) -> None:
    """It was taken for an integrator; a gain below 1 lets it go, which no frequency of the record shows."""
    rng, step, held, sign = np.random.default_rng(seed), 0.05, 0.0, 1.0
    waiting, rows = [0.0] * 4, []
    for k in range(800):
        measured = held + 0.01 * rng.standard_normal()
        sign = -1.0 if measured > 0.03 else 1.0 if measured < -0.03 else sign
        control = 0.0 if k < 80 else 0.2 * sign
        rows.append((control, measured))
        waiting.append(control)
        force = waiting.pop(0)
        held = (held + force) * np.exp(0.5 * step) - force
    control, measured = np.array(rows).T
    found = tune_recorded(
        Record(step * np.arange(800), control, measured), "time", {"structure": "pid", "index": "iae"}
    )
    design = found.tuned.tuning if found.success and found.tuned else None
    if design is not None:
        true = Loop(read_process("1/(2s-1)*exp(-0.2s)"), design.controller, filter=design.filter)
        assert stability(true).stable


@pytest.mark.slow
def test_a_lag_that_is_sampled_often_gets_gains_as_fast_as_noise_and_record_allow() -> None:
    """The loop that was looked for had the crossover that half a tick of delay allows, and a horizon of 4 s."""
    every, ran, steps = 0.1, Fopid(5.0, 0.5), lambda t: 0.2 * (10.0 <= t < 70.0) + 0.06 * (t >= 70.0)
    record = closed_loop("0.06/(25s+1)", steps, 1260, every, ran, 0.004)
    found = tune_recorded(replace(record, control_min=-50.0, control_max=50.0), "time", {"input": "both"}, FEW)
    assert found.success, found.message
    assert found.tuned is not None
    tuning = found.tuned.tuning
    assert tuning is not None
    assert tuning.controller is not None
    left = []
    for settings in (
        as_designed(tuning.controller, every, tuning.filter, tuning.weights),
        as_designed(ran, every, NO_FILTER, SetpointWeights()),
    ):
        loaded = Plant(PlantSettings(read_process("0.06/(25s+1)"), every, "exact"))
        trace = simulate(FopidController(settings), loaded, 1500, lambda _: 0.0, lambda _: 5.0)
        left.append(float(np.abs(trace.measurement).sum()))
    assert left[0] < 0.2 * left[1]
