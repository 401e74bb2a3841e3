"""The signals of a run, and of several runs over each other."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import cycle, pairwise

import numpy as np

from fopid_core.study.display import decimate, spike_free_range
from fopid_core.study.plotly_parts import BLUE, GREEN, GREY, RED, VIOLET, Figure, line, segment
from fopid_core.study.run import Run, Signal
from fopid_core.study.segment_table import number
from fopid_core.study.segments import Retuning, retunings

_COLOURS = {"setpoint": GREY, "measurement": BLUE, "control": GREEN, "disturbance": VIOLET}
_SHADE = "rgba(128,140,155,0.10)"
_FAR = 3.0  # times the largest control
_GAP = 0.06  # between panels, as a share of the figure's height


def signals_figure(run: Run) -> Figure:
    """Setpoint and measurement, control, and the disturbance where there is one, over the whole run."""
    panels = [["setpoint", "measurement"], ["control"]]
    if "disturbance" in run.signals and np.any(run.signals["disturbance"].value):
        panels.append(["disturbance"])
    panels = [[name for name in names if name in run.signals] for names in panels]
    changes = retunings(run)[1:]
    layout = _stacked([names[-1] for names in panels])
    spikes = _leave_out_spikes(run.signals["control"], layout["yaxis2"]) if "control" in run.signals else []
    layout["shapes"] = [*_phase_shades(run), *_limit_lines(run), *map(_retuning_line, changes)]
    gap = layout["yaxis"]["domain"][0] - 0.5 * _GAP
    layout["annotations"] = [*_phase_labels(run), *(_retuning_label(change, gap) for change in changes), *spikes]
    data = [
        _curve(run.signals[name], name, _COLOURS[name], _axis(i), run.end, held=name != "measurement")
        for i, names in enumerate(panels)
        for name in names
    ]
    return {"data": data, "layout": layout}


def comparison_figure(runs: Sequence[Run], names: Sequence[str]) -> Figure:
    """Measurement and control of several runs."""
    data = []
    for run, name, colour in zip(runs, names, cycle((BLUE, RED, GREEN, VIOLET, GREY)), strict=False):
        for panel, signal in enumerate(("measurement", "control")):
            curve = _curve(run.signals[signal], name, colour, _axis(panel), run.end, held=signal == "control")
            data.append({**curve, "legendgroup": name, "showlegend": panel == 0})
    layout = _stacked(["measurement", "control"])
    controls = [run.signals["control"].value for run in runs]
    shown = [spike_free_range(control) or (control.min(), control.max()) for control in controls]
    if any(map(spike_free_range, controls)):
        layout["yaxis2"]["range"] = [float(min(low for low, _ in shown)), float(max(high for _, high in shown))]
    return {"data": data, "layout": layout}


def _axis(panel: int) -> str:
    return "y" if panel == 0 else f"y{panel + 1}"


def _curve(signal: Signal, name: str, colour: str, axis: str, end: float, *, held: bool) -> Figure:
    time, value = decimate(signal.time, signal.value)
    if time[-1] < end:
        time, value = np.append(time, end), np.append(value, value[-1])
    shape = "hv" if held else "linear"
    return line(time, value, name, colour, yaxis=axis, shape=shape)


def _stacked(titles: Sequence[str]) -> Figure:
    """Panels over one time axis, the first twice as high as the others."""
    unit = (1.0 - _GAP * (len(titles) - 1)) / (len(titles) + 1)
    layout: Figure = {"hovermode": "x unified", "hoversubplots": "axis", "showlegend": True}
    top = 1.0
    for i, title in enumerate(titles):
        bottom = max(0.0, top - unit * (2 if i == 0 else 1))
        layout[_axis(i).replace("y", "yaxis")] = {"title": {"text": title}, "domain": [bottom, top]}
        top = bottom - _GAP
    layout["xaxis"] = {"title": {"text": "time [s]"}, "anchor": _axis(len(titles) - 1)}
    layout["legend"] = {"orientation": "h", "x": 0, "y": -0.12}
    return layout


def _leave_out_spikes(control: Signal, axis: Figure) -> list[Figure]:
    """Set the axis to the range without spikes; notes that say how far the highest and the lowest go."""
    shown = spike_free_range(control.value)
    if shown is None:
        return []
    axis["range"] = list(shown)
    low, high = int(np.argmin(control.value)), int(np.argmax(control.value))
    notes = []
    for at, arrow, edge, outside in (
        (high, "↑", 1, control.value[high] > shown[1]),
        (low, "↓", 0, control.value[low] < shown[0]),
    ):
        if outside:
            text = f"{arrow} {number(float(control.value[at]))}"
            place = {"yref": "y2 domain", "yanchor": ("bottom", "top")[edge], "xanchor": "left", "xshift": 2}
            notes.append({**place, "x": float(control.time[at]), "y": edge, "text": text, "showarrow": False})
    return notes


def _phases(run: Run) -> list[tuple[float, float]]:
    """Start and end of each phase."""
    return list(pairwise([*(phase.time for phase in run.phases), run.end]))


def _phase_shades(run: Run) -> list[Figure]:
    band = {
        "type": "rect",
        "y0": 0,
        "y1": 1,
        "yref": "paper",
        "layer": "below",
        "fillcolor": _SHADE,
        "line": {"width": 0},
    }
    return [{**band, "x0": start, "x1": end} for start, end in _phases(run)[1::2]]


def _phase_labels(run: Run) -> list[Figure]:
    """``1 starting gains`` above the first phase, and so on; a narrow page shows the number alone."""
    above = {"name": "phase", "y": 1.0, "yref": "paper", "yanchor": "bottom", "showarrow": False}
    return [
        {**above, "text": f"{i} {phase.name}", "x": 0.5 * (start + end)}
        for i, (phase, (start, end)) in enumerate(zip(run.phases, _phases(run), strict=True), 1)
    ]


def _limit_lines(run: Run) -> list[Figure]:
    """The limits of the control, unless they are so far away that the control would look flat."""
    limits = [run.parameter(name) for name in ("control_min", "control_max")]
    far = _FAR * np.max(np.abs(run.signals["control"].value))
    dotted = {"color": GREEN, "width": 1, "dash": "dot"}
    return [
        segment((0, 1), (limit, limit), GREEN, xref="paper", yref="y2", line=dotted)
        for limit in limits
        if isinstance(limit, (int, float)) and abs(limit) <= far
    ]


def _retuning_line(change: Retuning) -> Figure:
    return segment((change.time, change.time), (0, 1), RED, yref="paper")


def _retuning_label(change: Retuning, height: float) -> Figure:
    """The method beside the line, in the gap below the first panel."""
    beside = {"yref": "paper", "yanchor": "middle", "xanchor": "left", "xshift": 2, "showarrow": False}
    return {**beside, "name": "retuning", "text": change.method, "x": change.time, "y": height, "font": {"color": RED}}
