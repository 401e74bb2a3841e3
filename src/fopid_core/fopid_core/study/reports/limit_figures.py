"""The control's limits: which were in force when, and where the control stood at one."""

from __future__ import annotations

import math
from collections.abc import Mapping
from itertools import pairwise

import numpy as np

from fopid_core.model.arrays import Floats
from fopid_core.study.reports.plotly_parts import GREEN, RED, Figure, line, segment
from fopid_core.study.reports.run import Run
from fopid_core.study.reports.segment_table import number

LIMITS = ("control_min", "control_max")

_FAR = 3.0  # times the largest control: a limit beyond that would make the control look flat


def limit_history(run: Run, name: str) -> list[tuple[float, float]]:
    """A limit's values with the instants from which they hold [s]; none while nothing is known of it.

    The first is the experiment's, the others are from the controller's parameter events.

    Examples
    --------
    >>> from pathlib import Path
    >>> from fopid_core.study.reports.run import ParameterChange, Signal
    >>> time = np.array([0.0, 9.0])
    >>> change = ParameterChange(5.0, "/fopid_controller", "control_max", 2.0)
    >>> signals, metadata = {"measurement": Signal(time, time)}, {"experiment": "controller: {control_max: 3}"}
    >>> run = Run(Path("run"), signals, parameters=(change,), metadata=metadata)
    >>> limit_history(run, "control_max")
    [(0.0, 3.0), (5.0, 2.0)]
    """
    controller = run.experiment.get("controller")
    written = controller.get(name) if isinstance(controller, Mapping) else None
    told = [(float(run.signals["measurement"].time[0]), written)]
    told += [(change.time, change.value) for change in run.parameters if change.name == name]
    return [(time, float(value)) for time, value in told if isinstance(value, int | float)]


def limits_text(run: Run) -> str:
    """Lowest and highest control allowed at the end, such as ``-10 to 10``; empty without limits."""
    last = [history[-1][1] if (history := limit_history(run, name)) else None for name in LIMITS]
    low, high = (value if value is not None and math.isfinite(value) else None for value in last)
    if low is None and high is None:
        return ""
    if low is None or high is None:
        return f"at most {number(high)}" if high is not None else f"at least {number(low or 0.0)}"
    return f"{number(low)} to {number(high)}"


def limit_lines(run: Run) -> list[Figure]:
    """A dotted line as long as each limit was in force, unless that is far from the control."""
    far = _FAR * float(np.nanmax(np.abs(run.signals["control"].value), initial=0.0))
    dotted = {"color": GREEN, "width": 1, "dash": "dot"}
    lines = []
    for name in LIMITS:
        history = [*limit_history(run, name), (run.end, math.nan)]
        for (start, value), (end, _) in pairwise(history):
            if abs(value) <= far:
                lines.append(segment((start, end), (value, value), GREEN, yref="y2", line=dotted))
    return lines


def saturation_curve(run: Run) -> list[Figure]:
    """The control where the controller says that a limit held it back; nothing where it says so nowhere."""
    saturated = run.state.get("saturated")
    if saturated is None or not np.any(saturated):
        return []
    time, value = _edges(run.state["time"], np.where(saturated > 0.0, run.state["control"], math.nan))
    return [
        line(time, value, "at a limit", RED, yaxis="y2", shape="hv", line={"color": RED, "width": 2.6, "shape": "hv"})
    ]


def _edges(time: Floats, value: Floats) -> tuple[Floats, Floats]:
    """The samples on both sides of each change."""
    changed = (value[1:] != value[:-1]) & ~(np.isnan(value[1:]) & np.isnan(value[:-1]))
    kept = np.concatenate(([True], changed)) | np.concatenate((changed, [True]))
    return time[kept], value[kept]
