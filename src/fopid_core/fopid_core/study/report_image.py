"""The signals of a run as a picture for papers."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import cycle
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from fopid_core.study.display import decimate, spike_free_range
from fopid_core.study.plotly_parts import BLUE, GREEN, GREY, RED, VIOLET
from fopid_core.study.run import Run, Signal
from fopid_core.study.segments import retunings

_DOTS_PER_INCH = 200


def write_image(runs: Sequence[Run], names: Sequence[str], out: Path) -> None:
    """Setpoint and measurement above, control below; of several runs one over the other.

    Parameters
    ----------
    runs : sequence of Run
    names : sequence of str
        One for each run.
    out : Path
        A PNG file, 8 by 5 inches.
    """
    figure = Figure(figsize=(8.0, 5.0), layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(2, 1))
    if len(runs) == 1:
        _draw_one(runs[0], above, below)
    else:
        _draw_all(runs, names, above, below)
    above.set_ylabel("setpoint and measurement" if len(runs) == 1 else "measurement")
    below.set(ylabel="control", xlabel="time [s]")
    for axes in (above, below):
        axes.grid(visible=True, color="0.9")
        axes.spines[["top", "right"]].set_visible(False)
        axes.margins(x=0.0)
    above.legend(frameon=False, loc="best")
    figure.savefig(out, format="png", dpi=_DOTS_PER_INCH)


def _draw_one(run: Run, above: Axes, below: Axes) -> None:
    colours = {"setpoint": GREY, "measurement": BLUE, "control": GREEN}
    for name, axes in (("setpoint", above), ("measurement", above), ("control", below)):
        if name in run.signals:
            _draw(axes, run.signals[name], run.end, name, colours[name], held=name != "measurement")
    below.set_ylim(spike_free_range(run.signals["control"].value))
    for limit in (run.parameter("control_min"), run.parameter("control_max")):
        if isinstance(limit, (int, float)) and math.isfinite(limit):
            below.axhline(limit, color=GREEN, linewidth=0.8, linestyle=":")
    for change in retunings(run)[1:]:
        for axes in (above, below):
            axes.axvline(change.time, color=RED, linewidth=0.9)
        above.annotate(
            change.method, (change.time, 1.0), xycoords=("data", "axes fraction"), xytext=(2, -2),
            textcoords="offset points", va="top", color=RED, fontsize=8,
        )  # fmt: skip


def _draw_all(runs: Sequence[Run], names: Sequence[str], above: Axes, below: Axes) -> None:
    for run, name, colour in zip(runs, names, cycle((BLUE, RED, GREEN, VIOLET, GREY)), strict=False):
        _draw(above, run.signals["measurement"], run.end, name, colour, held=False)
        _draw(below, run.signals["control"], run.end, name, colour, held=True)


def _draw(axes: Axes, signal: Signal, end: float, name: str, colour: str, *, held: bool) -> None:
    time, value = decimate(signal.time, signal.value)
    style = "steps-post" if held else "default"
    axes.plot([*time, end], [*value, value[-1]], color=colour, label=name, linewidth=1.1, drawstyle=style)
