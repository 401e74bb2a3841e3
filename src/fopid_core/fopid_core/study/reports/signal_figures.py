"""The signals of a run, and of several runs over each other."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import cycle, pairwise

import numpy as np

from fopid_core.study.reports.display import decimate, spike_free_range
from fopid_core.study.reports.limit_figures import limit_lines, saturation_curve
from fopid_core.study.reports.plotly_parts import BLUE, GREEN, GREY, RED, VIOLET, Figure, line, segment
from fopid_core.study.reports.run import Run, Signal
from fopid_core.study.reports.segment_table import number
from fopid_core.study.reports.segments import Retuning, beginning, retunings

_COLOURS = {"setpoint": GREY, "measurement": BLUE, "control": GREEN, "disturbance": VIOLET}
_DASHES = ("solid", "dash", "dot")  # so that two runs that go the same way are both seen
_SHADE = "rgba(128,140,155,0.10)"
_STRETCHES = 4000  # of a long signal, so that there is something to zoom into
_CHARACTERS = 130  # that fit above the panels
_GAP = 0.06  # between panels, as a share of the figure's height


def signals_figure(run: Run) -> Figure:
    """Setpoint and measurement, control, and the disturbance where there is one, over the whole run."""
    panels = [["setpoint", "measurement"], ["control"]]
    if "disturbance" in run.signals and np.any(run.signals["disturbance"].value):
        panels.append(["disturbance"])
    panels = [[name for name in names if name in run.signals] for names in panels]
    changes = retunings(run)[1:]
    layout = stacked([names[-1] for names in panels])
    spikes = _leave_out_spikes(run.signals["control"], layout["yaxis2"]) if "control" in run.signals else []
    layout["shapes"] = [*_phase_shades(run), *limit_lines(run), *map(_retuning_line, changes)]
    gap = layout["yaxis"]["domain"][0] - 0.5 * _GAP
    layout["annotations"] = [*_phase_labels(run), *_retuning_labels(changes, run, gap), *spikes]
    data = [
        curve(run.signals[name], name, _COLOURS[name], _axis(i), run.end, held=name != "measurement")
        for i, names in enumerate(panels)
        for name in names
    ]
    return {"data": [*data, *saturation_curve(run)], "layout": layout}


def comparison_figure(runs: Sequence[Run], names: Sequence[str]) -> Figure:
    """Measurement and control of several runs, and the setpoints, aligned where the first thing happens."""
    data = _setpoints(runs)
    for run, name, colour, dash in zip(runs, names, cycle((BLUE, RED, GREEN, VIOLET)), cycle(_DASHES), strict=False):
        for panel, signal in enumerate(("measurement", "control")):
            drawn = curve(_aligned(run, signal), name, colour, _axis(panel), run.end - beginning(run),
                           held=signal == "control")  # fmt: skip
            drawn["line"]["dash"] = dash
            data.append({**drawn, "legendgroup": name, "showlegend": panel == 0})
    layout = stacked(["measurement", "control"])
    controls = [run.signals["control"].value for run in runs]
    shown = [spike_free_range(control) or (np.nanmin(control), np.nanmax(control)) for control in controls]
    if any(map(spike_free_range, controls)):
        layout["yaxis2"]["range"] = [float(min(low for low, _ in shown)), float(max(high for _, high in shown))]
    return {"data": data, "layout": layout}


def _setpoints(runs: Sequence[Run]) -> list[Figure]:
    """The setpoint of each run, once where they are the same."""
    curves = [
        curve(_aligned(run, "setpoint"), "setpoint", GREY, "y", run.end - beginning(run), held=True)
        for run in runs
        if "setpoint" in run.signals
    ]
    distinct = [curve for i, curve in enumerate(curves) if all(curve["y"] != other["y"] for other in curves[:i])]
    return [{**curve, "showlegend": i == 0} for i, curve in enumerate(distinct)]


def _aligned(run: Run, name: str) -> Signal:
    return Signal(run.signals[name].time - beginning(run), run.signals[name].value)


def _axis(panel: int) -> str:
    return "y" if panel == 0 else f"y{panel + 1}"


def curve(signal: Signal, name: str, colour: str, axis: str, end: float, *, held: bool) -> Figure:
    """A signal up to ``end`` [s], thinned out; one that is held goes in stairs."""
    time, value = decimate(signal.time, signal.value, _STRETCHES)
    if time[-1] < end:
        time, value = np.append(time, end), np.append(value, value[-1])
    shape = "hv" if held else "linear"
    return line(time, value, name, colour, yaxis=axis, shape=shape)


def stacked(titles: Sequence[str]) -> Figure:
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
    low, high = int(np.nanargmin(control.value)), int(np.nanargmax(control.value))
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
    """``1 starting gains`` above the first phase, and so on; the number alone where there is no room for more."""
    above = {"name": "phase", "y": 1.0, "yref": "paper", "yanchor": "bottom", "showarrow": False}
    labels = []
    for i, (phase, (start, end)) in enumerate(zip(run.phases, _phases(run), strict=True), 1):
        room = _CHARACTERS * (end - start) / (run.end - run.phases[0].time)
        text = f"{i} {phase.name}"
        labels.append({**above, "text": text if len(text) <= room else str(i), "x": 0.5 * (start + end)})
    return labels


def _retuning_line(change: Retuning) -> Figure:
    return segment((change.time, change.time), (0, 1), RED, yref="paper")


def _retuning_labels(changes: Sequence[Retuning], run: Run, height: float) -> list[Figure]:
    """The method beside each line, in the gap below the first panel, where there is room before the next."""
    beside = {"yref": "paper", "yanchor": "middle", "xanchor": "left", "xshift": 2, "showarrow": False}
    label = {**beside, "name": "retuning", "y": height, "font": {"color": RED}}
    ends = [*(change.time for change in changes[1:]), math.inf]
    a_character = (run.end - run.signals["measurement"].time[0]) / _CHARACTERS
    return [
        {**label, "text": change.method, "x": change.time}
        for change, end in zip(changes, ends, strict=False)
        if end - change.time > (len(change.method) + 1) * a_character
    ]
