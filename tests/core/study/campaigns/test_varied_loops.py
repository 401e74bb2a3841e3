"""Many variations at once, beside the exact answer for each loop by itself."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fopid_core.model.evaluation import evaluate
from fopid_core.model.fopid import Fopid
from fopid_core.model.loop import Loop
from fopid_core.model.process import Process, read_process
from fopid_core.model.stability import stability
from fopid_core.study.campaigns.columns import MEASURES
from fopid_core.study.campaigns.varied_loops import measure, stable_variations, varied

ITAE = Fopid(2.9692, 0.8028, 1.3394, 1.0138, 0.6074)  # of the paper's Table 4
TABLE_3 = Fopid(0.9116, 0.2526, 0.2023, 1.1577, 0.9973)


def drawn(count: int, most_delay: float, seed: int = 0) -> np.ndarray:
    random = np.random.default_rng(seed)
    factors = np.exp(random.uniform(-0.7, 0.7, (count, 2)))
    rows = np.column_stack([factors, random.uniform(0.0, most_delay, count)])
    rows[::4, 2] = 0.0
    return np.vstack([[1.0, 1.0, 0.0], rows])


@settings(derandomize=True, deadline=None, max_examples=60)
@given(st.floats(-5, 5).filter(lambda g: abs(g) > 0.01), st.floats(0.1, 10), st.floats(0, 3), st.floats(0.01, 5))
def test_a_variation_is_the_process_with_other_gain_times_and_delay(g: float, t: float, d: float, w: float) -> None:
    process = Process.parse("(0.3s^1.2+1)/(s^2+0.5s^0.7+1) * exp(-0.4s)")
    s = 0.1 + 1j * w
    expected = g * complex(process(t * s)) * np.exp(-d * s)
    assert complex(varied(process, g, t, d)(s)) == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize(
    ("process", "controller", "most_delay"),
    [
        ("P1", ITAE, 1.5),
        ("P2", Fopid(1.1725, 1.0461, 1.0276, 1.0008, 0.8027), 0.3),
        ("1/(s+1)^2 * exp(-0.5s)", Fopid(0.8, 0.5, 0.4, 0.9, 0.7), 1.0),
        ("1/(0.8s^2.2+0.5s^0.9+1)", Fopid(0.5, 0.4, 0.8, 1.1, 0.8), 1.0),
        ("1/(s(s+1))", Fopid(1.0, 0.1, 0.5), 1.0),
        ("1/(s-0.5)", Fopid(2.0, 0.3), 0.8),
        ("(1+0.3exp(-s))/(s+1)^2", Fopid(2.0, 0.5, 0.3), 1.0),  # two delays: each by itself
    ],
)
def test_verdicts_are_those_of_each_loop_by_itself(process: str, controller: Fopid, most_delay: float) -> None:
    rows = drawn(60, most_delay)
    nominal = read_process(process)
    expected = [stability(Loop(varied(nominal, *row), controller)).stable for row in rows.tolist()]
    assert stable_variations(nominal, controller, rows).tolist() == expected


def test_the_stability_cases_are_of_both_kinds() -> None:
    assert 0.2 < stable_variations(read_process("P1"), ITAE, drawn(60, 1.5)).mean() < 0.9


@pytest.mark.parametrize(
    ("process", "controller", "horizon"),
    [("P1", TABLE_3, 50.0), ("P1", ITAE, 50.0), ("1/(s+1)^2 * exp(-0.5s)", Fopid(0.8, 0.5, 0.4, 0.9, 0.7), 40.0),
     ("-2/(s+1)^3", Fopid(-0.5, -0.2, -0.1), 40.0), ("1/(s(s+1))", Fopid(1.0, 0.1, 0.5), 60.0)],
)  # fmt: skip
def test_measures_are_those_of_the_exact_evaluation(process: str, controller: Fopid, horizon: float) -> None:
    """Frequencies 0.0115 apart in ln w, with parabolas and chords in between: 0.2 % at peaks, less elsewhere.

    Responses have 12 steps per radian at least: 0.2 % of an index, of 100 % for the overshoot, of a second for a time.
    """
    rows = drawn(7, 0.3, seed=2)
    nominal = read_process(process)
    stable, found = measure(nominal, controller, rows, horizon, 0.01)
    assert stable.sum() >= 5
    for i in np.flatnonzero(stable):
        exact = evaluate(Loop(varied(nominal, *rows[i].tolist()), controller), horizon)
        margins, step = exact.margins, exact.step
        assert step is not None
        assert found["ms"][i] == pytest.approx(margins.ms, rel=2e-3)
        assert found["mt"][i] == pytest.approx(margins.mt, rel=2e-3)
        assert found["phase_margin_deg"][i] == pytest.approx(math.degrees(margins.phase_margin), abs=0.02)
        assert found["crossover"][i] == pytest.approx(margins.crossover, rel=1e-3)
        assert found["gain_margin_db"][i] == pytest.approx(20.0 * math.log10(margins.gain_margin), abs=0.02)
        for name in ("iae", "ise", "itae", "itse"):
            assert found[name][i] == pytest.approx(getattr(step.indices, name), rel=2e-3)
        assert found["overshoot_pct"][i] == pytest.approx(step.overshoot_pct, abs=0.2)
        for name in ("rise_time", "settling_time"):
            assert found[name][i] == pytest.approx(getattr(step, name), rel=2e-3, abs=0.02, nan_ok=True)


def test_the_control_peak_is_that_of_the_running_controller() -> None:
    from fopid_core.runtime.controller import ControllerSettings, FopidController
    from fopid_core.runtime.plant import Plant, PlantSettings
    from fopid_core.runtime.simulation import simulate

    rows = np.array([[1.0, 1.0, 0.0], [0.5, 1.3, 0.2]])
    for controller in (ITAE, Fopid(0.5, 0.6)):
        _, found = measure(read_process("P1"), controller, rows, 50.0, 0.01)
        for i, row in enumerate(rows.tolist()):
            plant = Plant(PlantSettings(varied(read_process("P1"), *row), delay_model="exact"))
            trace = simulate(FopidController(ControllerSettings(controller)), plant, 5000, lambda _: 1.0)
            assert found["control_peak"][i] == pytest.approx(np.abs(trace.control).max(), rel=5e-3)


def test_without_integral_or_crossover_there_is_no_such_measure() -> None:
    stable, found = measure(read_process("P1"), Fopid(0.5), np.array([[1.0, 1.0, 0.0]]), 50.0, 0.01)
    assert stable.all()
    assert math.isinf(found["phase_margin_deg"][0])
    assert math.isnan(found["crossover"][0])
    assert math.isnan(found["settling_time"][0])
    assert found["gain_margin_db"][0] == pytest.approx(20.0 * math.log10(16.0), abs=1e-3)


def test_what_is_not_stable_has_no_measures() -> None:
    stable, found = measure(read_process("P1"), Fopid(9.0), np.array([[1.0, 1.0, 0.0], [2.0, 1.0, 0.0]]), 50.0, 0.01)
    assert not stable.any()
    assert all(np.isnan(found[name]).all() for name in MEASURES)
