"""The comparison of methods: every row as another calculation has it, the recommendation by its own rule."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from fopid_core.design.comparison.candidates import Candidate, structure_of
from fopid_core.design.comparison.compare import Comparison, _recommended, compare, comparison_request
from fopid_core.design.comparison.measures import Row, measured
from fopid_core.design.limit.limit import limit
from fopid_core.design.specification import Bounds
from fopid_core.errors import InputError
from fopid_core.model.evaluation import evaluate
from fopid_core.model.fopid import Fopid
from fopid_core.model.loop import Loop
from fopid_core.model.process import Process, read_process
from fopid_core.model.two_degrees import MeasurementFilter, SetpointWeights
from fopid_core.runtime.controller import FopidController
from fopid_core.runtime.plant import Plant, PlantSettings
from fopid_core.runtime.settings import as_designed
from fopid_core.study.reports.comparison_page import comparison_page

from ...cli.runner import invoke

LAG = Process.parse("1/(s+1)^3")
BOUNDS = Bounds(ms_max=1.7, noise_max=30.0, u_max=30.0, horizon=40.0)


def row_of(loop: Loop, structure: str = "pid") -> Row:
    return measured(Candidate("test", structure, loop), BOUNDS, speed=0.8)


def test_the_first_control_is_known_where_an_ideal_derivative_makes_the_output_infinite_at_once() -> None:
    integrator = Loop(Process.parse("0.05/s"), Fopid(4.0, 0.0, 6.4, 1.0, 1.15), MeasurementFilter(2, 2.8))
    settings = as_designed(integrator.controller, BOUNDS.sample_time, integrator.filter, integrator.weights)
    controller = FopidController(settings)
    assert row_of(integrator, "fopid").control_peak == pytest.approx(controller.step(1.0, 0.0))


def test_the_measures_are_those_of_the_loop_that_runs() -> None:
    gains, slow, weights = Fopid(1.5, 0.7, 1.0), MeasurementFilter(2, 0.1), SetpointWeights(0.6, 0.2)
    row = row_of(Loop(LAG, gains, slow, weights))
    found: dict[str, list[float]] = {}
    for source in ("setpoint", "load"):
        controller = FopidController(as_designed(gains, 0.01, slow, weights))
        plant = Plant(PlantSettings(LAG, sample_time=0.01))
        outputs, controls = [], []
        for _ in range(4001):
            outputs.append(plant.measurement)
            controls.append(controller.step(1.0 if source == "setpoint" else 0.0, plant.measurement))
            plant.step(controls[-1], 0.0 if source == "setpoint" else 1.0)
        errors = np.abs((1.0 if source == "setpoint" else 0.0) - np.array(outputs))
        found[source] = [0.01 * float(errors.sum()), 100.0 * (max(outputs) - 1.0), max(map(abs, controls)),
                         float(np.abs(np.diff([0.0, *controls])).sum())]  # fmt: skip
    assert row.iae_setpoint == pytest.approx(found["setpoint"][0], rel=0.01)
    assert row.iae_load == pytest.approx(found["load"][0], rel=0.01)
    assert row.overshoot_pct == pytest.approx(found["setpoint"][1], abs=0.5)
    assert row.control_peak == pytest.approx(found["setpoint"][2], rel=1e-6)
    assert row.total_variation == pytest.approx(found["setpoint"][3], rel=0.02)


def test_without_filter_and_weights_they_are_those_of_evaluate() -> None:
    loop = Loop(LAG, Fopid(1.0, 0.4, 0.5, 0.95, 0.8))
    row, judged = row_of(loop, "fopid"), evaluate(loop, 40.0)
    assert judged.step is not None
    assert row.iae_setpoint == pytest.approx(judged.step.indices.iae, rel=1e-9)
    assert (row.ms, row.mt) == (judged.margins.ms, judged.margins.mt)
    assert row.delay_margin == judged.margins.delay_margin
    spread = [evaluate(Loop(LAG.scaled(gain), loop.controller), 40.0).step for gain in (0.5, 2.0)]
    overshoots = [step.overshoot_pct for step in spread if step is not None]
    assert row.overshoot_spread_pct >= abs(overshoots[1] - overshoots[0]) - 0.2


def test_what_is_not_stable_or_breaks_a_bound_is_said() -> None:
    unstable = row_of(Loop(LAG, Fopid(9.0)), "p")
    assert (unstable.stable, unstable.is_within, unstable.unmet) == (False, False, ("stability",))
    loud = row_of(Loop(LAG, Fopid(1.5, 0.7, 1.0)))
    assert any(text.startswith("noise gain <= 30") for text in loud.unmet)
    assert row_of(Loop(LAG, Fopid(4.0, 0.4))).overshoot_spread_pct == math.inf


def test_structures_are_recognised() -> None:
    cases = {"p": (1.0,), "pi": (1.0, 1.0), "pd": (1.0, 0.0, 1.0), "fopd": (1.0, 0.0, 1.0, 1.0, 0.9),
             "fopi": (1.0, 1.0, 0.0, 0.9), "fopid": (1.0, 1.0, 1.0, 1.0, 0.9)}  # fmt: skip
    assert {name: structure_of(Fopid(*numbers)) for name, numbers in cases.items()} == {name: name for name in cases}


def fake(structure: str, **measures: object) -> Row:
    known: dict[str, object] = {
        "stable": True, "running_stable": True, "running_ms": 1.5, "ms": 1.5, "noise_gain": 5.0, "iae_setpoint": 1.0,
        "iae_load": 1.0,
    }  # fmt: skip
    return Row(Candidate("time iae", structure, None), **(known | measures))  # type: ignore[arg-type]


def test_the_recommendation_follows_its_rule() -> None:
    pid, fopid = fake("pid"), fake("fopid", iae_load=0.97, ms=1.58, running_ms=1.58)
    assert _recommended((pid, fopid), 1.0, "balanced", 0.05)[0] == 0
    assert _recommended((pid, fopid), 1.0, "balanced", 0.01)[0] == 1
    assert "fewer numbers" in _recommended((pid, fopid), 1.0, "balanced", 0.05)[1]
    assert _recommended((pid, replace(fopid, iae_load=0.5)), 1.0, "load", 0.05)[0] == 1
    assert _recommended((fopid, pid), 1.0, "robust", 0.01)[0] == 1
    assert _recommended((pid, replace(fopid, noise_gain=1.0)), 1.0, "quiet", 0.05)[0] == 1
    assert _recommended((replace(pid, unmet=("Ms",)), replace(fopid, running_stable=None)), 1.0, "load", 0.05)[0] == -1
    sharp = replace(fopid, iae_load=0.1, running_ms=3.0)
    assert _recommended((pid, sharp), 1.0, "load", 0.05)[0] == 0


@cache
def comparison(process: str) -> Comparison:
    return compare(comparison_request(read_process(process)))


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.parametrize("process", ["P1", "P2", "P3", "P4"])
def test_on_the_test_bench_every_method_has_its_row_and_the_taken_one_keeps_the_bounds(process: str) -> None:
    found = comparison(process)
    methods = {row.candidate.method for row in found.rows}
    assert {"frequency", "rule simc-pi", "rule amigo-pid"} <= methods
    assert {f"time {index}" for index in ("iae", "ise", "itae", "itse", "istes", "istse")} <= methods
    assert {row.candidate.structure for row in found.rows if row.candidate.method == "time iae"} == {
        "p", "pi", "pd", "pid", "fopi", "fopd", "fopid",
    }  # fmt: skip
    taken = found.rows[found.recommended]
    assert taken.is_within
    assert taken.ms <= 1.6 * (1.0 + 1e-6)
    best = {row.candidate.structure: row for row in found.rows if row.candidate.method == "time iae"}
    cost = {name: row.iae_setpoint + row.iae_load for name, row in best.items()}
    assert cost["fopid"] <= cost["pid"] * 1.002
    assert cost["pid"] <= cost["pi"] * 1.002
    assert "<table" in comparison_page(read_process(process), found)
    bound = limit(read_process(process), cells=80).bound  # with the same bounds on Ms and noise
    within = [row.iae_load for row in found.rows if row.stable and not row.unmet]
    assert 0.0 < bound < min(within) < 10.0 * bound


@pytest.mark.long
@pytest.mark.timeout(900)
def test_the_verb_gives_one_object_and_a_page(tmp_path: Path) -> None:
    page = tmp_path / "page.html"
    result = invoke(["compare", "1/(s+1)*exp(-0.5s)", "--prefer", "load", "--page", str(page), "--json"])
    data = json.loads(result.stdout)
    assert data["recommended"]["structure"] in ("pi", "pid", "fopi", "fopid")
    asked = {"method", "structure", "gains", "iae_setpoint", "iae_load", "ms", "mt", "noise_gain", "overshoot_pct",
             "settling_time", "control_peak", "total_variation", "delay_margin", "stable"}  # fmt: skip
    assert all(asked <= set(row) for row in data["rows"])
    assert page.read_text(encoding="utf-8").count("data-figure") == 3


def test_what_cannot_be_compared_is_refused_in_one_line() -> None:
    assert invoke(["compare"]).exit_code == 2
    assert invoke(["compare", "P1", "--prefer", "speed"]).exit_code == 2
    with pytest.raises(InputError, match="bound = 'speed'"):
        comparison_request(LAG, speed=1.0)
