"""Figures for papers: in print size, in three formats, with what the page shows."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from fopid_core.model.fopid import Fopid
from fopid_core.model.loop import Loop
from fopid_core.model.process import Process
from fopid_core.study.reports.loop_figures import loop_figures
from fopid_core.study.reports.print_figures import save, save_all
from fopid_core.study.reports.run import Phase, Run, Signal
from fopid_core.study.reports.signal_figures import signals_figure


@pytest.fixture(scope="module")
def figures():
    time = 0.01 * np.arange(1000)
    signals = {name: Signal(time, np.sin(time)) for name in ("setpoint", "measurement", "control")}
    run = Run(Path("run"), signals, phases=(Phase(0.0, "one"), Phase(6.0, "two")),
              metadata={"experiment": "controller: {control_max: 1.5}"})  # fmt: skip
    return {"signals": signals_figure(run), **loop_figures(Loop(Process.parse("1/(s+1)^3"), Fopid(1.5, 0.6)))}


@pytest.mark.slow
def test_each_figure_is_written_in_each_format_at_print_size(figures, tmp_path: Path) -> None:
    chosen = {name: figures[name] for name in ("signals", "nyquist")}
    written = save_all(chosen, tmp_path / "new")
    assert {path.name for path in written} == {f"{name}.{end}" for name in chosen for end in ("png", "svg", "pdf")}
    for name in chosen:
        with Image.open(tmp_path / "new" / f"{name}.png") as picture:
            assert picture.size == ((2148, 1320) if name == "signals" else (1050, 840))
        box = re.search(rb"/MediaBox \[ ?0 0 ([\d.]+) ([\d.]+)", (tmp_path / "new" / f"{name}.pdf").read_bytes())
        inches = (7.16, 4.4) if name == "signals" else (3.5, 2.8)
        assert [float(points) / 72.0 for points in box.groups()] == pytest.approx(inches, abs=0.01)


@pytest.mark.slow
def test_the_same_figure_is_the_same_file(figures, tmp_path: Path) -> None:
    for ending in ("svg", "pdf"):
        for name in ("a", "b"):
            save(figures["isodamping"], tmp_path / f"{name}.{ending}")
        assert (tmp_path / f"a.{ending}").read_bytes() == (tmp_path / f"b.{ending}").read_bytes()


@pytest.mark.slow
def test_every_curve_text_and_title_of_the_page_is_there(figures, tmp_path: Path) -> None:
    import matplotlib as mpl

    with mpl.rc_context({"svg.fonttype": "none"}):  # texts stay texts
        for name, figure in figures.items():
            save(figure, tmp_path / "figure.svg")
            drawn = (tmp_path / "figure.svg").read_text()
            layout = figure["layout"]
            titles = [axis["title"]["text"] for key, axis in layout.items() if key.startswith(("xaxis", "yaxis"))]
            notes = [note["text"] for note in layout.get("annotations", ())]
            legend = [trace["name"] for trace in figure["data"]] if layout.get("showlegend") else []
            for text in (*titles, *notes, *legend):
                assert f">{text}</text>" in drawn, (name, text)
            for trace in figure["data"]:
                assert trace["line"]["color"] in drawn, (name, trace["name"])
