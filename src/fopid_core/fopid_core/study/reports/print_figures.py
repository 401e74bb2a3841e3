"""The report's figures as files for papers: png, svg or pdf, at the width of a column or a page."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Canvas
from matplotlib.patches import Circle
from matplotlib.ticker import MultipleLocator

from fopid_core.study.legend import legend_outside
from fopid_core.study.reports.plotly_parts import Figure

COLUMN, PAGE = (3.5, 2.8), (7.16, 4.4)
"""Width and height [inch] of a figure in one column and across the page of a journal in two columns."""

FORMATS = ("png", "svg", "pdf")
DOTS_PER_INCH = 300

_LOOK: Any = {
    "font.size": 8, "axes.linewidth": 0.6, "axes.grid": True, "grid.color": "0.9", "grid.linewidth": 0.5,
    "axes.spines.top": False, "axes.spines.right": False, "xtick.major.width": 0.6, "ytick.major.width": 0.6,
    "axes.labelsize": 8, "legend.frameon": False, "legend.fontsize": 7, "pdf.fonttype": 42, "svg.hashsalt": "fopid",
}  # fmt: skip
_LINE = 0.6  # of the width on the page
_DASHES = {"solid": "-", "dash": "--", "dot": ":"}
_VERTICAL = {"top": "top", "middle": "center", "bottom": "bottom"}
_NOTE = 6.5  # size of a text within the axes [pt]
_POINTS_PER_PIXEL = 0.75


def save(figure: Figure, out: Path, size: tuple[float, float] = PAGE) -> None:
    """Draw a figure of the page into a file, in the format that its suffix names.

    Parameters
    ----------
    figure : dict
        As plotly.js takes it.
    out : Path
        ``.png``, ``.svg`` or ``.pdf``.
    size : tuple
        Width and height [inch].
    """
    with mpl.rc_context(_LOOK):
        _write(_drawn(figure, size), out)


def save_all(figures: Mapping[str, Figure], folder: Path) -> list[Path]:
    """Each figure in each of ``FORMATS``, signals across the page and loops in a column.

    Returns
    -------
    list of Path
    """
    folder.mkdir(parents=True, exist_ok=True)
    written = []
    with mpl.rc_context(_LOOK):
        for name, figure in figures.items():
            canvas = _drawn(figure, PAGE if is_wide(figure) else COLUMN)
            for ending in FORMATS:
                written.append(folder / f"{name}.{ending}")
                _write(canvas, written[-1])
    return written


def is_wide(figure: Figure) -> bool:
    """Whether a figure shows signals over time in panels."""
    return "hoversubplots" in figure["layout"]


def _write(canvas: Canvas, out: Path) -> None:
    canvas.savefig(out, dpi=DOTS_PER_INCH, metadata=_undated(out))


def _undated(out: Path) -> dict[str, Any]:
    """What keeps the date out of the file: the same figure is the same file."""
    return {".svg": {"Date": None}, ".pdf": {"CreationDate": None}}.get(out.suffix, {})


def _drawn(figure: Figure, size: tuple[float, float]) -> Canvas:
    canvas, layout = Canvas(figsize=size, layout="constrained"), figure["layout"]
    panels = sorted(key for key in layout if key.startswith("yaxis"))
    heights = [high - low for low, high in (layout[key].get("domain", (0.0, 1.0)) for key in panels)]
    rows = canvas.subplots(len(panels), 1, sharex=True, squeeze=False, height_ratios=heights)[:, 0]
    axes = {key.replace("yaxis", "y"): one for key, one in zip(panels, rows, strict=True)}
    for trace in figure["data"]:
        _curve(axes[trace.get("yaxis", "y")], trace)
    for key, one in axes.items():
        _dress(one, layout["xaxis"], layout[key.replace("y", "yaxis")])
    for one in rows[:-1]:
        one.tick_params(axis="x", which="both", bottom=False)
    rows[-1].set_xlabel(layout["xaxis"]["title"]["text"])
    for shape in layout.get("shapes", ()):
        _shape(axes, shape)
    for text in layout.get("annotations", ()):
        _note(axes, text, log=layout["xaxis"].get("type") == "log")
    canvas.align_ylabels()
    if layout.get("showlegend"):
        _legend(canvas, list(axes.values()))
    return canvas


def _curve(axes: Axes, trace: Figure) -> None:
    style = trace["line"]
    x, y = ([float("nan") if value is None else value for value in trace[name]] for name in ("x", "y"))
    axes.plot(
        x, y, color=style["color"], linewidth=_LINE * style["width"],
        linestyle="none" if trace["mode"] == "markers" else _DASHES[style.get("dash", "solid")],
        drawstyle="steps-post" if style.get("shape") == "hv" else "default",
        marker="o" if trace["mode"] == "markers" else None, markersize=3,
        label=trace["name"] if trace.get("showlegend", True) else None,
    )  # fmt: skip


def _dress(axes: Axes, x: Figure, y: Figure) -> None:
    axes.set_axisbelow(True)
    axes.margins(x=0.0)
    axes.set_ylabel(y["title"]["text"])
    if x.get("type") == "log":
        axes.set_xscale("log")
    if "range" in y:
        axes.set_ylim(y["range"])
    if "range" in x:
        axes.set_xlim(x["range"])
    if "dtick" in y:
        axes.yaxis.set_major_locator(MultipleLocator(y["dtick"]))
    if "scaleanchor" in y:
        axes.set_aspect("equal")


def _shape(axes: Mapping[str, Axes], shape: Figure) -> None:
    style = {"color": shape["line"].get("color"), "linewidth": _LINE * shape["line"]["width"]}
    style["linestyle"] = _DASHES[shape["line"].get("dash", "solid")]
    on_all = shape.get("yref") == "paper"
    for one in axes.values() if on_all else [axes[shape.get("yref", "y")]]:
        if shape["type"] == "rect":
            one.axvspan(shape["x0"], shape["x1"], color="0.95", linewidth=0.0, zorder=0.0)
        elif shape["type"] == "circle":
            centre, radius = 0.5 * (shape["x0"] + shape["x1"]), 0.5 * (shape["x1"] - shape["x0"])
            one.add_patch(Circle((centre, 0.0), radius, fill=False, **style))
        elif on_all:
            one.axvline(shape["x0"], **style)
        elif "xref" in shape:
            one.axhline(shape["y0"], **style)
        else:
            one.plot((shape["x0"], shape["x1"]), (shape["y0"], shape["y1"]), **style)


def _note(axes: Mapping[str, Axes], text: Figure, *, log: bool) -> None:
    place = text.get("yref", "y")
    within = "data" if place in axes else "axes fraction"
    one = axes["y"] if place == "paper" else axes[place.split(" ")[0]]
    x, y, vertical = 10.0 ** text["x"] if log else text["x"], text["y"], text.get("yanchor", "middle")
    if text.get("name") == "retuning":  # in the gap below the first panel, as on the page
        y, vertical = -0.01, "top"
    one.annotate(
        text["text"], (x, y), xycoords=("data", within), annotation_clip=False,
        xytext=(_POINTS_PER_PIXEL * text.get("xshift", 0), _POINTS_PER_PIXEL * text.get("yshift", 0)),
        textcoords="offset points", ha=text.get("xanchor", "center"), va=_VERTICAL[vertical], fontsize=_NOTE,
        color=text.get("font", {}).get("color", "black"),
    )  # fmt: skip


def _legend(canvas: Canvas, axes: list[Axes]) -> None:
    found = {text: line for one in axes for line, text in zip(*one.get_legend_handles_labels(), strict=True)}
    legend_outside(canvas, found.values(), found.keys(), ncols=min(5, len(found)))
