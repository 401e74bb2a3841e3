"""What the report's figures show, against numbers worked out in other ways."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import control
import numpy as np
import pytest

from fopid_core.model.fopid import Fopid
from fopid_core.model.loop import Loop
from fopid_core.model.margins import margins
from fopid_core.model.process import Process
from fopid_core.study.reports.limit_figures import limit_history, limit_lines, limits_text, saturation_curve
from fopid_core.study.reports.loop_figures import ISO_GAINS, loop_figures, nyquist_figure
from fopid_core.study.reports.run import ParameterChange, Phase, Run, Signal
from fopid_core.study.reports.signal_figures import comparison_figure, signals_figure
from fopid_core.study.reports.step_figures import step_figures

CONTROLLER = Fopid(kp=1.5, ki=0.6)
LOOP = Loop(Process.parse("1/(s+1)^3"), CONTROLLER)
S = control.tf("s")
SAME_LOOP = (1.5 + 0.6 / S) / (S + 1) ** 3


def curve(figure, name: str) -> tuple[np.ndarray, np.ndarray]:
    (trace,) = [trace for trace in figure["data"] if trace["name"] == name]
    return np.array(trace["x"], dtype=float), np.array(trace["y"], dtype=float)


@pytest.fixture(scope="module")
def figures():
    return loop_figures(LOOP)


def test_bode_is_the_frequency_response(figures) -> None:
    w, magnitude = curve(figures["bode"], "|L|")
    _, phase = curve(figures["bode"], "arg L")
    exact = SAME_LOOP(1j * w)
    # frequencies are kept to six digits, and |L| falls by 60 dB a decade: 60 log10(1 + 5e-6) = 1.3e-4 dB
    assert np.allclose(magnitude, 20.0 * np.log10(np.abs(exact)), rtol=2e-5, atol=2e-4)
    assert np.allclose(phase, np.degrees(np.unwrap(np.angle(exact))), rtol=2e-5, atol=2e-4)


def test_a_loop_whose_largest_sensitivity_is_not_known_is_drawn_without_it() -> None:
    w = np.geomspace(0.01, 100.0, 50)
    found = nyquist_figure(LOOP, replace(margins(LOOP), ms=math.nan), w)
    assert len(found["layout"]["shapes"]) == 1
    assert found["layout"]["annotations"] == []


def test_the_margins_are_marked_where_they_are(figures) -> None:
    gain_margin, phase_margin, phase_crossover, crossover = control.margin(SAME_LOOP)
    marks = {(mark.get("yref", "y"), round(mark["x0"], 6)): mark for mark in figures["bode"]["layout"]["shapes"]}
    phase_mark = marks["y2", round(crossover, 6)]
    assert sorted((phase_mark["y0"], phase_mark["y1"])) == pytest.approx([-180.0, phase_margin - 180.0], abs=1e-2)
    gain_mark = marks["y", round(phase_crossover, 6)]
    assert sorted((gain_mark["y0"], gain_mark["y1"])) == pytest.approx([-20.0 * math.log10(gain_margin), 0.0], abs=1e-5)
    texts = [note["text"] for note in figures["bode"]["layout"]["annotations"]]
    assert texts == [f"PM {phase_margin:.1f}°", f"GM {20.0 * math.log10(gain_margin):.1f} dB"]


def test_sensitivities_are_one_over_one_plus_l_and_its_complement(figures) -> None:
    w, sensitivity = curve(figures["sensitivity"], "|S|")
    _, complementary = curve(figures["sensitivity"], "|T|")
    exact = SAME_LOOP(1j * w)
    assert np.allclose(sensitivity, 20.0 * np.log10(np.abs(1.0 / (1.0 + exact))), rtol=2e-5, atol=2e-4)
    assert np.allclose(complementary, 20.0 * np.log10(np.abs(exact / (1.0 + exact))), rtol=2e-5, atol=2e-4)


def test_the_peaks_are_named_where_they_are_beside_each_other(figures) -> None:
    w = np.logspace(-2, 2, 400_001)
    response = SAME_LOOP(1j * w)
    peaks = {"Ms": np.abs(1.0 / (1.0 + response)), "Mt": np.abs(response / (1.0 + response))}
    left, right = figures["sensitivity"]["layout"]["annotations"]
    assert (left["xanchor"], right["xanchor"]) == ("right", "left")
    assert left["x"] < right["x"]
    for mark in (left, right):
        name, value = mark["text"].split(" = ")
        assert float(value) == pytest.approx(peaks[name].max(), abs=0.005)
        assert mark["y"] == pytest.approx(20.0 * math.log10(peaks[name].max()), abs=1e-4)
        # the peak is flat: between two points of the oracle's grid, and where rounding hides the difference
        assert 10.0 ** mark["x"] == pytest.approx(w[np.argmax(peaks[name])], rel=1e-3)


def test_the_nyquist_curve_touches_the_circle_around_minus_one(figures) -> None:
    x, y = curve(figures["nyquist"], "L(jω)")
    circle = figures["nyquist"]["layout"]["shapes"][0]
    radius = (circle["x1"] - circle["x0"]) / 2.0
    assert (circle["x0"] + circle["x1"]) / 2.0 == pytest.approx(-1.0)
    w = np.logspace(-3, 2, 200_000)
    assert radius == pytest.approx(np.min(np.abs(1.0 + SAME_LOOP(1j * w))), rel=1e-6)
    assert np.min(np.abs(x + 1j * y + 1.0)) == pytest.approx(radius, rel=1e-3)  # between two points of the curve


def test_iso_damping_shows_the_step_response_at_each_gain(figures) -> None:
    for gain in ISO_GAINS:
        time, output = curve(figures["isodamping"], f"×{gain:g}")
        exact_time = np.linspace(0.0, time[-1], 4001)
        exact = control.step_response(control.feedback(gain * SAME_LOOP, 1), exact_time)[1]
        assert np.max(np.abs(output - np.interp(time, exact_time, exact))) < 1e-3  # a display


def test_a_gain_that_makes_the_loop_unstable_is_named() -> None:
    figure = loop_figures(Loop(Process.parse("1/(s+1)^3"), Fopid(kp=5.0)))["isodamping"]
    assert [trace["name"] for trace in figure["data"]] == ["×0.5", "×0.7", "×1", "×1.4", "×2 unstable"]


@pytest.mark.parametrize(
    ("process", "controller"),
    [
        ("1/(s+1)*exp(-0.5s)", Fopid(0.5, 0.5)),
        ("1/(0.8s^2.2+0.5s^0.9+1)", Fopid(0.2, 0.3, 0.1, 0.9, 0.7)),
        ("1/(s-1)", Fopid(3.0)),
        ("1/s", Fopid(1.0, 0.1)),
        ("1/(s+1)", Fopid(0.5)),  # no crossover
        ("-2/(s+1)^2", Fopid(-0.5, -0.3)),
        ("(1-s)/(s+1)^2", Fopid(0.3, 0.3)),
        ("1/(s+1)^3", Fopid(1.15, 0.273, 1.57, 1.14, 1.5)),
    ],
)
def test_every_kind_of_loop_can_be_drawn(process: str, controller: Fopid) -> None:
    figures = loop_figures(Loop(Process.parse(process), controller))
    for name, figure in figures.items():
        text = json.dumps(figure, allow_nan=False)
        assert len(text) > 1000, name
        axes = [axis for key, axis in figure["layout"].items() if key.startswith(("xaxis", "yaxis"))]
        assert all(axis["title"]["text"] for axis in axes), name
        assert all(math.isfinite(v) for axis in axes for v in axis.get("range", [])), name


def run_with(value: np.ndarray, **more) -> Run:
    time = 0.01 * np.arange(value.size)
    signals = {name: Signal(time, value) for name in ("setpoint", "measurement", "control")}
    return Run(Path("run"), signals, **more)


def test_signals_phases_and_retunings_are_drawn_on_one_time_axis() -> None:
    time = 0.01 * np.arange(1000)
    gains = {name: np.zeros(1000) for name in ("ki", "kd", "lam", "mu")}
    state = {"time": time, "kp": np.where(time >= 4.0, 2.0, 1.0), **gains}
    figure = signals_figure(run_with(np.sin(time), state=state, phases=(Phase(0.0, "one"), Phase(6.0, "two"))))
    assert [trace["name"] for trace in figure["data"]] == ["setpoint", "measurement", "control"]
    assert {trace.get("xaxis", "x") for trace in figure["data"]} == {"x"}
    assert [trace["yaxis"] for trace in figure["data"]] == ["y", "y", "y2"]
    notes = figure["layout"]["annotations"]
    assert [(note["text"], note["x"]) for note in notes if note.get("name") == "phase"] == [
        ("1 one", pytest.approx(3.0)), ("2 two", pytest.approx((6.0 + 9.99) / 2)),
    ]  # fmt: skip
    assert [(note["text"], note["x"]) for note in notes if note.get("name") == "retuning"] == [("by hand", 4.0)]
    assert [shape["x0"] for shape in figure["layout"]["shapes"] if shape["type"] == "line"] == [4.0]


def test_of_retunings_in_quick_succession_the_last_one_is_named_and_all_are_marked() -> None:
    time = 0.01 * np.arange(1000)
    gains = {name: np.zeros(1000) for name in ("ki", "kd", "lam", "mu")}
    state = {"time": time, "kp": 1.0 + np.clip(np.floor((time - 3.9) / 0.1), 0.0, 3.0), **gains}
    layout = signals_figure(run_with(np.sin(time), state=state))["layout"]
    marked = [shape["x0"] for shape in layout["shapes"] if shape["type"] == "line"]
    assert marked == pytest.approx([4.0, 4.1, 4.2], abs=0.011)
    assert [note["x"] for note in layout["annotations"] if note.get("name") == "retuning"] == marked[-1:]


def test_limits_are_drawn_where_the_control_comes_near_them() -> None:
    value = np.sin(np.arange(1000) / 50.0)
    limits = "controller: {control_min: -1.5, control_max: 400.0}"
    shapes = signals_figure(run_with(value, metadata={"experiment": limits}))["layout"]["shapes"]
    assert [shape["y0"] for shape in shapes] == [-1.5]


def test_a_kick_of_the_control_is_told_not_drawn() -> None:
    value = np.sin(np.arange(2000) / 50.0)
    value[500], value[501] = 1089.4, -455.2
    figure = signals_figure(run_with(value))
    assert figure["layout"]["yaxis2"]["range"][1] < 3.0
    assert [(note["text"], note["x"]) for note in figure["layout"]["annotations"]] == [
        ("↑ 1089", 5.0),
        ("↓ -455", 5.01),
    ]


def test_a_comparison_has_both_signals_of_every_run_and_each_setpoint_once() -> None:
    runs = [run_with(np.sin(np.arange(100) * k)) for k in (1.0, 2.0, 2.0)]
    figure = comparison_figure(runs, ["a", "b", "c"])
    assert [(t["name"], t["yaxis"], t["showlegend"]) for t in figure["data"]] == [
        ("setpoint", "y", True), ("setpoint", "y", False),
        *((name, axis, axis == "y") for name in "abc" for axis in ("y", "y2")),
    ]  # fmt: skip


def test_runs_are_compared_from_where_the_first_thing_happens() -> None:
    early, late = (
        replace(run_with(np.sin(np.arange(1000) / 50.0)), phases=(Phase(start, "one"), Phase(start + 3.0, "two")))
        for start in (0.5, 2.5)
    )
    for trace, begun in zip(
        comparison_figure([early, late], ["a", "b"])["data"][-4:], (0.5, 0.5, 2.5, 2.5), strict=True
    ):
        assert (trace["x"][0], trace["x"][-1]) == (pytest.approx(-begun), pytest.approx(9.99 - begun))


def limited(history: Sequence[tuple[float, float]], value: np.ndarray, **more) -> Run:
    changes = tuple(ParameterChange(time, "/fopid_controller", "control_max", limit) for time, limit in history)
    return run_with(value, parameters=changes, metadata={"experiment": "controller: {control_max: 2}"}, **more)


def test_each_limit_is_drawn_as_long_as_it_was_in_force() -> None:
    run = limited([(3.0, 1.5), (5.0, math.inf), (7.0, 1.2)], np.sin(np.arange(1000) / 50.0))
    assert limit_history(run, "control_max") == [(0.0, 2.0), (3.0, 1.5), (5.0, math.inf), (7.0, 1.2)]
    assert [(line["x0"], line["x1"], line["y0"], line["y1"]) for line in limit_lines(run)] == [
        (0.0, 3.0, 2.0, 2.0), (3.0, 5.0, 1.5, 1.5), (7.0, 9.99, 1.2, 1.2),
    ]  # fmt: skip
    assert limits_text(run) == "at most 1.2"


def test_the_control_is_marked_where_it_was_held_back() -> None:
    time = 0.01 * np.arange(1000)
    value = np.minimum(np.sin(time), 0.5)
    state = {"time": time, "control": value, "saturated": (value == 0.5).astype(float)}
    state |= {name: np.zeros(1000) for name in ("kp", "ki", "kd", "lam", "mu")}
    (curve,) = saturation_curve(run_with(value, state=state))
    marked = np.zeros(1000, dtype=bool)
    for (start, level), (end, _) in pairwise(zip(curve["x"], curve["y"], strict=True)):
        if level is not None:
            assert level == 0.5
            marked |= (time >= start - 1e-9) & (time < end - 1e-9)
    # the mark ends with the last sample at the limit, or as a step one sample later
    assert np.count_nonzero(marked != (value == 0.5)) <= 2
    assert saturation_curve(run_with(value)) == []


def test_values_that_are_no_numbers_leave_a_gap_in_every_figure() -> None:
    value = np.sin(np.arange(1000) / 50.0)
    value[300:400] = np.nan
    value[700] = np.nan
    for figure in (signals_figure(run_with(value)), comparison_figure([run_with(value)] * 2, ["a", "b"])):
        json.dumps(figure, allow_nan=False)
        assert all(trace["y"].count(None) >= 2 for trace in figure["data"])


def test_a_comparison_shows_all_controls_but_the_kicks() -> None:
    kicked = np.sin(np.arange(2000) / 50.0)
    kicked[500] = 900.0
    figure = comparison_figure([run_with(kicked), run_with(np.full(100, 4.0))], ["a", "b"])
    low, high = figure["layout"]["yaxis2"]["range"]
    assert low < -1.0
    assert 4.0 <= high < 10.0


def test_steps_before_and_after_lie_over_each_other_as_unit_steps() -> None:
    time = np.arange(0.0, 40.0, 0.01)
    one, two = 1.0 - np.exp(-time), 1.0 - np.exp(-3.0 * time)
    half = time.size // 2
    measured = np.concatenate([2.0 * one[:half], 2.0 + 4.0 * two[:half]])
    setpoint = np.where(np.arange(time.size) < half, 2.0, 6.0)
    kp = np.where(np.arange(time.size) < half, 1.0, 3.0)
    state = {"time": time, "kp": kp, "ki": kp, "kd": 0 * kp, "lam": 1 + 0 * kp, "mu": 1 + 0 * kp}
    signals = {"setpoint": setpoint, "measurement": measured, "control": 2.0 * measured}
    run = Run(Path("run"), {name: Signal(time, value) for name, value in signals.items()}, state=state)
    drawn = step_figures(run)
    assert list(drawn) == ["setpoint-steps"]
    for trace, expected in zip(drawn["setpoint-steps"]["data"][::2], (one, two), strict=True):
        x, y = np.array(trace["x"][:-1]), np.array(trace["y"][:-1])
        assert y == pytest.approx(np.interp(x, time, expected), abs=1e-3)


def test_a_run_with_the_same_gains_all_along_has_nothing_to_lay_over_itself() -> None:
    time = np.arange(0.0, 4.0, 0.01)
    signals = {name: Signal(time, np.where(time < 2.0, 1.0, 2.0)) for name in ("setpoint", "measurement", "control")}
    assert step_figures(Run(Path("run"), signals)) == {}
