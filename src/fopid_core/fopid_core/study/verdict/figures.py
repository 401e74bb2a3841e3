"""The figures of the verdict."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from fopid_core.model.arrays import Floats
from fopid_core.study.reports.plotly_parts import BLUE, GREEN, RED, VIOLET
from fopid_core.study.verdict.statistics import Case, is_known, median

DOTS_PER_INCH = 130


def draw_reductions(by_kind: Mapping[str, Floats], out: Path) -> None:
    """For each kind of process: every process a dot, the median and its interval."""
    named = sorted(by_kind.items(), key=lambda item: float(np.median(item[1])))
    canvas = Figure(figsize=(8.0, 0.34 * len(named) + 1.2), layout="constrained")
    axes = canvas.subplots()
    for place, (_, values) in enumerate(named):
        found = median(values)
        axes.plot(100.0 * values, np.full(values.size, place), ".", color=BLUE, alpha=0.5, markersize=5, zorder=3)
        axes.plot(100.0 * np.array([found.low, found.high]), [place, place], color=RED, linewidth=3, alpha=0.7)
        axes.plot(100.0 * found.value, place, "o", color=RED, zorder=4)
    axes.set_yticks(range(len(named)), [f"{name} ({values.size})" for name, values in named])
    axes.axvline(0.0, color="black", linewidth=0.8)
    axes.set_xlabel("load IAE of FOPID below that of PID [%]; red: median with its 95 % interval")
    axes.grid(axis="x", alpha=0.3)
    canvas.savefig(out, dpi=DOTS_PER_INCH)


def draw_orders(cases: Sequence[Case], out: Path) -> None:
    """Where the optimal orders lie."""
    rows = [case["fopid"] for case in cases if is_known(case["fopid"])]
    canvas = Figure(figsize=(8.0, 3.2), layout="constrained")
    left, right = canvas.subplots(1, 2)
    for axes, name, colour, span in ((left, "lam", VIOLET, (0.8, 1.2)), (right, "mu", GREEN, (0.0, 2.0))):
        values = np.clip([row[name] for row in rows], *span)
        axes.hist(values, bins=np.linspace(*span, 41), color=colour)
        axes.axvline(1.0, color="black", linewidth=0.8)
        axes.set_xlabel(f"{name} of the best FOPID" + (" (the ends hold what lies beyond)" if name == "lam" else ""))
    left.set_ylabel("processes")
    canvas.savefig(out, dpi=DOTS_PER_INCH)
