"""Figures as values, drawn in two ways: interactive on the page, and as files for papers."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Canvas
from matplotlib.lines import Line2D

from fopid_core.model.arrays import Floats
from fopid_core.study.legend import legend_outside
from fopid_core.study.reports.plotly_parts import (
    BLUE,
    GREEN,
    GREY,
    RED,
    VIOLET,
    Figure,
    legend_above,
    line,
    note,
    segment,
)

OCHRE, PINK = "#b8901f", "#cf5f9a"
COLOURS = (BLUE, RED, GREEN, VIOLET, OCHRE, PINK, GREY)
"""For curves of one kind; each stands out on white and on black alike."""

Range = tuple[float, float] | None

_INCHES = (4.6, 3.0)  # of one panel
_DOTS_PER_INCH = 150
_STYLES = {"solid": "-", "dash": "--", "dot": ":"}


@dataclass(frozen=True)
class Curve:
    """A line; both arrays have shape (n,). ``dash`` is solid, dash or dot; GL's are dotted, and one legend says so."""

    x: Floats
    y: Floats
    name: str
    colour: str
    dash: str = "solid"
    in_legend: bool = True


DOTTED_IS_GL = Curve(np.full(1, np.nan), np.full(1, np.nan), "dotted: GL", GREY, "dot")
"""An entry of the legend without a line."""


@dataclass(frozen=True)
class Mark:
    """A vertical line with a text at its upper end."""

    x: float
    text: str


@dataclass(frozen=True)
class Panel:
    """One pair of axes.

    Attributes
    ----------
    title, x_label, y_label : str
    curves : tuple of Curve
    log_x : bool
    y_range : (low, high), optional
    marks : tuple of Mark
    """

    title: str
    x_label: str
    y_label: str
    curves: tuple[Curve, ...]
    log_x: bool = False
    y_range: Range = None
    marks: tuple[Mark, ...] = ()


@dataclass(frozen=True)
class PaperFigure:
    """A figure of the paper, drawn anew.

    Attributes
    ----------
    number : int
    caption : str
        What the paper's figure shows, in our words.
    remark : str
        What there is to see.
    panels : tuple of Panel
        In rows of two.
    """

    number: int
    caption: str
    remark: str
    panels: tuple[Panel, ...]

    @property
    def name(self) -> str:
        """Of its files and its places on the page."""
        return f"figure{self.number:02}"


def interactive(panel: Panel) -> Figure:
    """The panel as plotly.js takes it.

    Examples
    --------
    >>> import numpy as np
    >>> curve = Curve(np.array([0.0, 1.0]), np.array([0.0, 2.0]), "y", BLUE)
    >>> interactive(Panel("P1", "time [s]", "output", (curve,)))["data"][0]["name"]
    'y'
    """
    data = [_trace(curve) for curve in panel.curves]
    x_axis: Figure = {"title": {"text": panel.x_label}, "ticklabeloverflow": "allow"}
    if panel.log_x:
        x_axis |= {"type": "log", "dtick": 1, "exponentformat": "power"}
    else:
        x_axis["rangemode"] = "tozero"
    y_axis: Figure = {"title": {"text": panel.y_label}}
    if panel.y_range:
        y_axis["range"] = list(panel.y_range)
    layout = {
        "xaxis": x_axis,
        "yaxis": y_axis,
        "hovermode": "x unified",
        "showlegend": True,
        "legend": legend_above(),
        "shapes": [segment((m.x, m.x), (0, 1), GREY, yref="y domain", line=_dotted()) for m in panel.marks],
        "annotations": [
            note(math.log10(m.x) if panel.log_x else m.x, 0.0, m.text, yref="y domain") for m in panel.marks
        ],
    }
    return {"data": data, "layout": layout}


def _trace(curve: Curve) -> Figure:
    trace = line(curve.x, curve.y, curve.name, curve.colour)
    trace["line"]["dash"] = curve.dash
    trace["showlegend"] = curve.in_legend
    return trace


def _dotted() -> Figure:
    return {"color": GREY, "width": 1, "dash": "dot"}


def thinned(time: Floats, signal: Floats, points: int = 401) -> tuple[Floats, Floats]:
    """Fewer samples of a signal that begins at its first one: close together there, and ever further apart.

    Examples
    --------
    >>> thinned(np.arange(101.0), np.arange(101.0), points=5)[0].tolist()
    [0.0, 6.0, 25.0, 56.0, 100.0]
    """
    kept = np.unique(np.round((time.size - 1) * np.linspace(0.0, 1.0, points) ** 2).astype(int))
    return time[kept], signal[kept]


def write_files(figure: PaperFigure, folder: Path) -> tuple[Path, Path]:
    """Write the figure as PNG and as SVG; the folder must exist."""
    rows = math.ceil(len(figure.panels) / 2)
    canvas = Canvas(figsize=(2.0 * _INCHES[0], rows * _INCHES[1]), layout="constrained")
    entries: dict[str, Line2D] = {}
    for axes, panel in zip(canvas.subplots(rows, 2, squeeze=False).flat, figure.panels, strict=True):
        entries |= _draw(axes, panel)
    legend_outside(canvas, entries.values(), entries, ncols=8, frameon=False, fontsize=8)
    canvas.draw_without_rendering()
    canvas.set_layout_engine("none")  # what it laid out holds for both files
    files = folder / f"{figure.name}.png", folder / f"{figure.name}.svg"
    with mpl.rc_context({"svg.hashsalt": figure.name}):  # the same file every time
        canvas.savefig(files[0], dpi=_DOTS_PER_INCH)
        canvas.savefig(files[1], metadata={"Date": None})
    return files


def _draw(axes: Axes, panel: Panel) -> dict[str, Line2D]:
    """Draw a panel; the entries of its legend."""
    entries = {}
    for curve in panel.curves:
        (drawn,) = axes.plot(curve.x, curve.y, _STYLES[curve.dash], color=curve.colour, linewidth=1.1)
        if curve.in_legend:
            entries[curve.name] = drawn
    axes.set_title(panel.title, fontsize=9, loc="left")
    axes.set_xlabel(panel.x_label, fontsize=8)
    axes.set_ylabel(panel.y_label, fontsize=8)
    axes.tick_params(labelsize=8)
    if panel.log_x:
        axes.set_xscale("log")
    if panel.y_range:
        axes.set_ylim(panel.y_range)
    for mark in panel.marks:
        axes.axvline(mark.x, color=GREY, linewidth=0.8, linestyle=":")
        axes.annotate(mark.text, (mark.x, 0.0), xycoords=("data", "axes fraction"), xytext=(3, 3),
                      textcoords="offset points", fontsize=7, color=GREY)  # fmt: skip
    axes.grid(visible=True, color="0.9")
    axes.spines[["top", "right"]].set_visible(False)
    axes.margins(x=0.0)
    if not panel.log_x:
        axes.set_xlim(left=0.0)
    return entries
