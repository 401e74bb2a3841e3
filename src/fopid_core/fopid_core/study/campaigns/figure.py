"""What a campaign found, at a glance: for each process and measure, the share of the variations up to a value."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import cycle
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.csv
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

from fopid_core.errors import InputError
from fopid_core.model.arrays import Floats
from fopid_core.study.legend import legend_outside
from fopid_core.study.reports.plotly_parts import BLUE, GREEN, RED, VIOLET

QUANTILES = (5, 50, 95)
LABELS = {
    "ms": "max |S|", "mt": "max |T|", "phase_margin_deg": "phase margin [°]", "crossover": "crossover [rad/s]",
    "gain_margin_db": "gain margin [dB]", "iae": "IAE [s]", "ise": "ISE [s]", "itae": "ITAE [s²]", "itse": "ITSE [s²]",
    "overshoot_pct": "overshoot [%]", "rise_time": "rise time [s]", "settling_time": "settling time [s]",
    "control_peak": "max |u|",
}  # fmt: skip

_COLOURS = (RED, VIOLET, BLUE, GREEN)
_DOTS_PER_INCH = 160
_SHOWN = 0.9  # a curve is shown up to this share of the runs of most designs
_LARGEST_RATIO = 30.0  # a logarithmic axis from here on


def write_figure(results: pa.Table, measures: Sequence[str], title: str, out: Path) -> None:
    """Draw a row for each process and a column for each measure; a curve for each design.

    A curve ends below 1 where variations of the process are not stable, or have no such value.

    Parameters
    ----------
    results : pyarrow.Table
    measures : sequence of str
    title : str
    out : Path
        A PNG file.

    Raises
    ------
    InputError
        If it cannot be written.
    """
    processes, designs = _different(results, "process"), _different(results, "design")
    size = (3.4 * len(measures) + 0.6, 2.3 * len(processes) + 1.0)
    figure = Figure(figsize=size, layout="constrained")
    axes = figure.subplots(len(processes), len(measures), squeeze=False, sharey=True)
    for row, process in enumerate(processes):
        of_process = results.filter(pc.equal(results["process"], process))
        for column, measure in enumerate(measures):
            _draw(axes[row, column], of_process, measure, designs)
            axes[row, column].set_xlabel(LABELS[measure] if row == len(processes) - 1 else "")
        axes[row, 0].set_ylabel(f"{process}\nshare of variations")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    legend_outside(
        figure,
        handles,
        labels,
        above=True,
        ncols=min(len(designs), 4),
        frameon=False,
        title=f"{title} (dots: the process as it is)",
    )
    try:
        figure.savefig(out, format="png", dpi=_DOTS_PER_INCH)
    except OSError as error:
        raise InputError(f"figure {str(out)!r} cannot be written: {error.strerror}") from None


def _different(results: pa.Table, name: str) -> list[str]:
    found: list[str] = pc.unique(results[name]).to_pylist()
    return found


def _draw(axes: Axes, results: pa.Table, measure: str, designs: Sequence[str]) -> None:
    ends = []
    for design, colour in zip(designs, cycle(_COLOURS), strict=False):
        of_design = results.filter(pc.equal(results["design"], design))
        if len(of_design) == 0:
            continue
        values = _values(of_design, measure)
        share = np.arange(1, values.size + 1) / len(of_design)
        style = "--" if designs.index(design) % 2 else "-"
        axes.plot(values, share, color=colour, label=design, linewidth=1.4, linestyle=style)
        if values.size:
            ends.append((values[int(0.02 * values.size)], values[int(_SHOWN * (values.size - 1))]))
            _mark_nominal(axes, of_design, measure, values, share, colour)
    _limit(axes, np.array(ends))
    axes.set_ylim(0.0, 1.02)
    axes.grid(visible=True, color="0.9")
    axes.spines[["top", "right"]].set_visible(False)


def _values(results: pa.Table, measure: str) -> Floats:
    """The values there are, in order."""
    numbers = results[measure].drop_null().to_numpy()
    return np.sort(numbers[np.isfinite(numbers)])


def _mark_nominal(axes: Axes, results: pa.Table, measure: str, values: Floats, share: Floats, colour: Any) -> None:
    """A dot where the process as it is stands."""
    nominal = results.filter(pc.equal(results["variation"], 0))[measure].to_pylist()
    for value in nominal[:1]:
        if value is not None and np.isfinite(value):
            axes.plot([value], [share[min(int(np.searchsorted(values, value)), share.size - 1)]], "o", color=colour,
                      markersize=4)  # fmt: skip


def _limit(axes: Axes, ends: Floats) -> None:
    """A range that the worst runs do not stretch."""
    if ends.size == 0:
        return
    low, high = float(ends[:, 0].min()), float(ends[:, 1].max())
    if low > 0.0 and high > _LARGEST_RATIO * low:
        axes.set_xscale("log")
        axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axes.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
        axes.xaxis.set_minor_formatter(NullFormatter())
        axes.set_xlim(low / 1.3, high * 1.3)
    else:
        room = 0.08 * (high - low) or 1.0
        axes.set_xlim(low - room, high + 2.0 * room)


def summary(results: pa.Table, measures: Sequence[str]) -> pa.Table:
    """For each process and design: runs, the share that is stable, and quantiles of the measures of the stable ones."""
    rows = []
    for process in _different(results, "process"):
        for design in _different(results, "design"):
            chosen = results.filter(pc.and_(pc.equal(results["process"], process), pc.equal(results["design"], design)))
            if len(chosen):
                stable = pc.sum(pc.equal(chosen["status"], "ok")).as_py() or 0
                row = {"process": process, "design": design, "runs": len(chosen), "stable": stable / len(chosen)}
                for measure in measures:
                    values = _values(chosen, measure)
                    for q in QUANTILES:
                        row[f"{measure}_{q}"] = float(np.percentile(values, q)) if values.size else None
                rows.append(row)
    return pa.Table.from_pylist(rows)


def write_summary(table: pa.Table, out: Path) -> None:
    """As csv; raises InputError if it cannot be written."""
    try:
        pa.csv.write_csv(table, out)
    except OSError as error:
        raise InputError(f"summary {str(out)!r} cannot be written: {error.strerror}") from None
