"""What the figures show, and that page and files show the same."""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from fopid_core.study.reports.plotly_parts import BLUE, RED
from fopid_core.study.reproduce.drawing import DOTTED_IS_GL, Curve, Mark, Panel, PaperFigure, interactive, write_files
from fopid_core.study.reproduce.facts import printed_design, printed_tuning
from fopid_core.study.reproduce.frequency_figures import figure_1, figure_8
from fopid_core.study.reproduce.load_figures import LOAD_AT, figure_10, setpoint_then_load
from fopid_core.study.reproduce.time_figures import figure_2, index_figure, step_curves

X = np.array([0.1, 1.0, 10.0])
PANEL = Panel(
    "P1", "ω [rad/s]", "gain [dB]",
    (Curve(X, X**2, "first", BLUE), Curve(X, -X, "hidden", RED, "dot", in_legend=False), DOTTED_IS_GL),
    log_x=True, y_range=(-1.0, 5.0), marks=(Mark(1.0, "here"),),
)  # fmt: skip


def test_the_page_gets_axes_with_units_and_a_legend_without_doubles() -> None:
    figure = interactive(PANEL)
    assert figure["layout"]["xaxis"]["title"]["text"] == "ω [rad/s]"
    assert figure["layout"]["xaxis"]["type"] == "log"
    assert figure["layout"]["yaxis"] == {"title": {"text": "gain [dB]"}, "range": [-1.0, 5.0]}
    assert [t["name"] for t in figure["data"] if t["showlegend"]] == ["first", "dotted: GL"]
    assert figure["data"][1]["line"]["dash"] == "dot"
    assert figure["layout"]["annotations"][0]["x"] == 0.0  # the power of ten


@pytest.mark.slow
def test_the_files_show_the_same_and_are_the_same_every_time(tmp_path: Path) -> None:
    figure = PaperFigure(3, "caption", "remark", (PANEL, PANEL))
    (tmp_path / "again").mkdir()
    png, svg = write_files(figure, tmp_path)
    _, other = write_files(figure, tmp_path / "again")
    assert svg.read_bytes() == other.read_bytes()
    assert (png.name, svg.name) == ("figure03.png", "figure03.svg")
    with Image.open(png) as picture:
        assert picture.size == (1380, 450)
        assert {(47, 127, 193), (209, 88, 42)} <= {
            colour for _, colour in picture.convert("RGB").getcolors(maxcolors=picture.width * picture.height)
        }


def test_figure_1_has_its_flat_phase_at_the_crossover() -> None:
    for design, panel in zip(map(printed_design, ("P1", "P2", "P3", "P4")), figure_1().panels[1::2], strict=True):
        model = next(curve for curve in panel.curves if curve.name == "model")
        slope = np.gradient(model.y, np.log(model.x))
        assert abs(np.interp(design.crossover, model.x, slope)) < 1.0  # degrees; the grid's steps are 4 %
        assert np.interp(design.crossover, model.x, model.y) == pytest.approx(
            math.degrees(
                np.angle(complex(design.controller(1j * design.crossover) * design.model(1j * design.crossover)))
            ),
            abs=0.01,
        )


def test_figure_8_shows_s_and_t_of_both_designs() -> None:
    names = [curve.name for curve in figure_8().panels[0].curves]
    assert names == ["|S| frequency", "|T| frequency", "|S| time", "|T| time"]


def test_gl_is_drawn_where_one_can_see_the_difference_only() -> None:
    near = step_curves(printed_design("P3").loop, 150.0, "x", BLUE)
    far = step_curves(printed_tuning("P4", "ISE").loop, 0.5, "x", BLUE)
    assert (len(near), len(far)) == (1, 2)
    exact, gl = far
    assert exact.y.max() > 1.7  # 74 % overshoot
    assert gl.y.max() < 1.1
    assert "GL differs" in index_figure(6, "P4").remark


def test_figure_2_shows_what_iso_damping_is() -> None:
    panel = figure_2().panels[2]  # P3
    overshoots = [c.y.max() for c in panel.curves if c.dash == "solid"]
    assert len(overshoots) == 3
    assert np.ptp(overshoots) < 0.01


def test_after_the_load_output_and_control_settle_where_they_must() -> None:
    loop = printed_tuning("P2").loop
    for sampled in (False, True):
        run = setpoint_then_load(loop, LOAD_AT["P2"], sampled)
        before = np.searchsorted(run.time, LOAD_AT["P2"]) - 1
        assert run.output[[before, -1]] == pytest.approx([1.0, 1.0], abs=0.01)
        assert run.control[[before, -1]] == pytest.approx([1.0, 0.0], abs=0.02)  # the load does the controller's work
        assert run.output[before:].max() > 1.3


def test_figure_10_says_how_large_the_first_controls_are() -> None:
    found = figure_10()
    assert re.search(r"P1 21 and 2240", found.remark)
    assert all(panel.y_range[1] < 10.0 for panel in found.panels)


def test_figure_10_shows_gl_where_its_control_differs_visibly() -> None:
    hidden = [[curve.name for curve in panel.curves if not curve.in_legend] for panel in figure_10().panels]
    assert hidden == [["time, GL"], ["frequency, GL", "time, GL"], [], ["frequency, GL", "time, GL"]]
