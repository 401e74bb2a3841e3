"""The steps of a run over each other, each as a unit step from rest: before and after a tuning in one figure."""

from __future__ import annotations

from itertools import cycle

import numpy as np

from fopid_core.model.arrays import Floats
from fopid_core.study.reports.plotly_parts import BLUE, GREEN, GREY, RED, VIOLET, Figure
from fopid_core.study.reports.run import Run, Signal
from fopid_core.study.reports.segments import Segment, segments
from fopid_core.study.reports.signal_figures import curve, stacked

COLOURS = (GREY, BLUE, RED, GREEN, VIOLET)
MOST = len(COLOURS)
"""Steps in one figure; the latest of each kind of gains."""
_LEAST = 1e-9  # of a step, in its own size


def step_figures(run: Run) -> dict[str, Figure]:
    """``setpoint-steps`` and ``load-steps``: measurement above control, where the run has such steps with two gains.

    Examples
    --------
    >>> from pathlib import Path
    >>> time = np.arange(0.0, 10.0, 0.01)
    >>> one = Signal(time, np.ones_like(time))
    >>> step_figures(Run(Path("run"), {"setpoint": one, "measurement": one, "control": one}))
    {}
    """
    found = {}
    for name, signal in (("setpoint-steps", "setpoint"), ("load-steps", "disturbance")):
        steps = _steps(run, signal)
        if len({segment.gains for segment, _ in steps}) > 1:
            found[name] = _figure(run, signal, steps[-MOST:])
    return found


def _steps(run: Run, name: str) -> list[tuple[Segment, float]]:
    """Segments that begin with a step of this signal and of no other, and its size; the last one of each gains."""
    if not {"setpoint", "control", name} <= run.signals.keys():
        return []
    other = "disturbance" if name == "setpoint" else "setpoint"
    latest = {}
    for segment in segments(run):
        size = _jump(run, name, segment.start)
        if abs(size) > _LEAST and abs(_jump(run, other, segment.start)) <= _LEAST:
            latest[segment.gains] = (segment, size)
    return list(latest.values())


def _jump(run: Run, name: str, at: float) -> float:
    if name not in run.signals:
        return 0.0
    signal, half = run.signals[name], 0.5 * run.sample_time
    before, after = signal.held_at(np.array([at - half, at + half]))
    first = signal.time[0] > at - half  # what was there before nobody knows: at rest it was nothing
    return float(after - (0.0 if first else before))


def _figure(run: Run, name: str, steps: list[tuple[Segment, float]]) -> Figure:
    data = []
    for (segment, size), colour in zip(steps, cycle(COLOURS), strict=False):
        label = segment.method or segment.name
        for panel, signal in enumerate(("measurement", "control")):
            time, value = _piece(run.signals[signal], segment)
            origin = float(_rest(run, signal, segment))
            one = Signal(time - segment.start, (value - origin) / size)
            drawn = curve(one, label, colour, "y" if panel == 0 else "y2", segment.end - segment.start,
                          held=signal == "control")  # fmt: skip
            data.append({**drawn, "legendgroup": label, "showlegend": panel == 0})
    layout = stacked([f"measurement / {name} step", "control / step"])
    return {"data": data, "layout": layout}


def _piece(signal: Signal, segment: Segment) -> tuple[Floats, Floats]:
    inside = (signal.time >= segment.start) & (signal.time < segment.end)
    return signal.time[inside], signal.value[inside]


def _rest(run: Run, name: str, segment: Segment) -> float:
    """The signal just before the step; before anything was recorded, nothing."""
    signal, before = run.signals[name], segment.start - 0.5 * run.sample_time
    return float(signal.held_at(np.array([before]))[0]) if signal.time[0] <= before else 0.0
