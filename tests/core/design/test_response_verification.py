"""Gains from a model whose structure is wrong are held against the frequency response that the record itself shows."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from fopid_core.design.identification.frequency_response import FrequencyResponse, contradicts, frequency_response
from fopid_core.design.identification.record import Record
from fopid_core.design.recorded_tuning import tune_recorded
from fopid_core.design.response_verification import (
    bears_out,
    held_to_record,
    held_without_a_model,
    surely_without_a_model,
)
from fopid_core.design.robust_verification import RobustLimits
from fopid_core.design.sampled_loop import sampled_process
from fopid_core.design.specification import TuningRequest
from fopid_core.design.tuner import tune
from fopid_core.model.fopid import Fopid
from fopid_core.model.loop import Loop
from fopid_core.model.margins import margins
from fopid_core.model.process import Process
from fopid_core.model.stability import stability
from fopid_core.model.two_degrees import NO_FILTER
from fopid_core.runtime.controller import ControllerSettings, FopidController
from fopid_core.runtime.plant import Plant, PlantSettings

from .identification.frequency_response_campaign import record as campaign_record
from .identification.recorded import open_loop
from .response_verification_campaign import judged

TRUE, H = Process.parse("1/(s+1)^3"), 0.2


@pytest.fixture(scope="module")
def record() -> Record:
    """An open-loop record with random steps."""
    plant = Plant(PlantSettings(TRUE, sample_time=H, noise_std=0.02, seed=1))
    control = np.repeat(np.random.default_rng(5).choice([-1.0, 1.0], 120), 12)
    measured = []
    for value in control:
        measured.append(plant.measurement)
        plant.step(float(value))
    return Record(H * np.arange(control.size), control, np.array(measured))


def test_a_model_of_the_right_structure_is_not_contradicted_and_another_is(record: Record) -> None:
    seen = frequency_response(record)
    assert contradicts(seen, TRUE) == ""
    assert "at 1" in contradicts(seen, Process.parse("1/(2.2s+1)*exp(-0.9s)"))  # of more than nine frequencies


def test_a_record_bears_out_a_model_that_it_shows_and_none_where_it_shows_little(record: Record) -> None:
    right, wrong = (SimpleNamespace(process=process, loads=()) for process in (TRUE, Process.parse("2/(s+1)")))
    little = record.part(0.0, 10.0)
    assert [bears_out(record, right), bears_out(record, wrong)] == [True, False]  # type: ignore[arg-type]
    assert contradicts(frequency_response(little), TRUE) == ""
    assert not bears_out(little, right)  # type: ignore[arg-type]


def test_gains_for_a_wrong_structure_hold_the_process(record: Record) -> None:
    found = tune_recorded(record, "frequency", limits=RobustLimits(samples=5), template="foptd")
    assert "the model leaves what the record shows without one" in found.message
    assert found.tuned is not None
    assert found.tuned.tuning is not None
    assert found.success, found.message
    assert margins(Loop(TRUE, found.tuned.tuning.controller, found.tuned.tuning.filter)).ms < 2.2


def test_the_bound_is_over_the_whole_disc() -> None:
    """Against the worst of many points on each circle."""
    w = np.geomspace(0.1, 5.0, 15)
    response, radius = np.asarray(TRUE(1j * w)), 0.1 * np.abs(TRUE(1j * w))
    tuning = tune(TuningRequest(TRUE, "rule", rule="simc-pi"))
    loop = tuning.controller(1j * w)
    circle = np.exp(2j * np.pi * np.arange(720) / 720)
    worst = float((1.0 / np.abs(1.0 + loop[:, None] * (response[:, None] + radius[:, None] * circle))).max())
    seen = FrequencyResponse(w, response, radius, H, 10)
    assert held_without_a_model(seen, TRUE, 1.001 * worst)(tuning.controller, tuning.filter) == ""
    assert held_without_a_model(seen, TRUE, 0.999 * worst)(tuning.controller, tuning.filter)


def test_what_is_sure_is_sure_over_a_wider_disc() -> None:
    w = np.geomspace(0.1, 5.0, 15)
    response, radius = np.asarray(TRUE(1j * w)), 0.1 * np.abs(TRUE(1j * w))
    loop = Fopid(3.0, 1.0)(1j * w)
    circle = 1.5 * np.exp(2j * np.pi * np.arange(720) / 720)
    points = np.abs(1.0 + loop[:, None] * (response[:, None] + radius[:, None] * circle))
    least = float((1.0 / points.max(axis=1)).max())
    seen = FrequencyResponse(w, response, radius, 1e-3, 10)
    assert surely_without_a_model(seen, 1.01 * least)(Fopid(3.0, 1.0), NO_FILTER) == ""
    assert surely_without_a_model(seen, 0.99 * least)(Fopid(3.0, 1.0), NO_FILTER)


@pytest.mark.parametrize(("kp", "refused"), [(0.5, ""), (1.0, "max |S| above 2.2 at 2.0"), (2.0, "unstable")])
def test_a_resonance_between_the_frequencies_at_which_the_model_is_held_is_seen(kp: float, refused: str) -> None:
    """With a model of one lag the loops have max |S| of 1.5, 2.6 and 15, told as 1.2."""
    true, model = "(0.183s^2+0.039s+1)/((0.238s^2+0.039s+1)(2s+1))", Process.parse("1/(2s+1)*exp(-0.2s)")
    signals = open_loop(true, np.repeat(np.random.default_rng(5).choice([-1.0, 1.0], 400), 6), 0.1, noise=0.005)
    gains = Fopid(kp, 0.3 * kp)
    learnt: Any = SimpleNamespace(fit_pct=95.0, process=model, loads=())
    against = held_to_record(signals, learnt, 2.2)[1](gains, NO_FILTER)
    assert against.startswith(refused)
    assert bool(against) == (margins(Loop(Process.parse(true), gains)).ms > 2.2)


@pytest.mark.parametrize("kp", [4.0, 12.0, 30.0, 100.0])
def test_a_loop_that_goes_around_the_origin_otherwise_than_the_learnt_one_is_unstable(kp: float) -> None:
    """1/(s+1)^3 with kp >= 8 is; its max |S| on a grid is small again far beyond that."""
    w = np.geomspace(0.03, 10.0, 24)
    seen = FrequencyResponse(w, np.asarray(TRUE(1j * w)), np.full(24, 1e-3), 1e-3, 10)
    judge = held_without_a_model(seen, Process.parse("0.01/(s+1)^3"), 1e3)
    gains = Fopid(kp, 0.1 * kp)
    assert bool(judge(gains, NO_FILTER)) == (not stability(Loop(TRUE, gains)).stable)


def test_a_response_of_longer_samples_than_the_controllers_is_not_taken_for_one_of_a_longer_hold() -> None:
    """At 1 rad/s a hold of 1 s turns the loop by half a radian, which the controller's ticks of 0.01 s do not."""
    w = np.geomspace(0.1, 2.0, 15)
    seen = FrequencyResponse(w, sampled_process(TRUE, 1.0, w), np.full(15, 1e-3), 1.0, 10)
    gains = Fopid(3.0, 0.6)
    worst = margins(Loop(TRUE, gains)).ms
    assert held_without_a_model(seen, TRUE, 1.1 * worst, 0.01)(gains, NO_FILTER) == ""
    assert held_without_a_model(seen, TRUE, 1.1 * worst)(gains, NO_FILTER)


def test_a_load_that_came_does_not_hide_what_the_record_shows_where_the_model_knows_of_it(record: Record) -> None:
    """It is no part of what a predictor tells from the past."""
    running = Plant(PlantSettings(TRUE, sample_time=H, noise_std=0.01, seed=2))
    controller = FopidController(ControllerSettings(Fopid(1.0, 0.4), sample_time=H))
    control, measured = np.empty(1440), np.empty(1440)
    for k, bit in enumerate(record.control):
        measured[k] = running.measurement
        control[k] = controller.step(0.0, measured[k]) + 0.3 * bit
        running.step(control[k] + (16.0 if k >= 720 else 0.0))
    signals = Record(H * np.arange(1440), control, measured)

    def doubt(process: Process, *loads: float) -> str:
        learnt: Any = SimpleNamespace(fit_pct=95.0, process=process, loads=loads)
        return held_to_record(signals, learnt, 2.2)[0]

    wrong = Process.parse("1/(2.2s+1)*exp(-0.9s)")
    assert doubt(wrong, 720 * H)
    assert not doubt(TRUE, 720 * H)
    assert not doubt(wrong)


def test_sound_gains_of_what_was_learnt_are_not_refused_and_bad_ones_are_stopped() -> None:
    """A small part of the campaign."""
    counts = judged(*campaign_record("prbs", "white", 5000), 5000, identified=False)
    assert counts["gain", "sound"] > 0
    assert counts["gain", "sound stopped"] == 0
    assert counts["gain", "bad stopped"] == counts["gain", "bad"] > 0
