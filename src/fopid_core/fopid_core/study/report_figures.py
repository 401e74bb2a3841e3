"""The figures of the report, as plotly.js takes them: ``{"data": [...], "layout": {...}}``.

Colours of text, axes and grid come from the page, which has a light and a dark look.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from fopid_core.errors import InputError
from fopid_core.model.arrays import Complexes, Floats
from fopid_core.model.loop import Loop
from fopid_core.model.margins import Margins
from fopid_core.model.response import step_response
from fopid_core.model.stability import stability
from fopid_core.study.decimation import decimate
from fopid_core.study.run import Run, Signal
from fopid_core.study.segments import Retuning, retunings

Figure = dict[str, Any]

BLUE, RED, GREEN, VIOLET, GREY = "#2f7fc1", "#d1582a", "#2b9a66", "#8e6bbf", "#86909b"
"""Each stands out on white and on black alike."""

ISO_GAINS = (0.5, 0.7, 1.0, 1.4, 2.0)
"""Factors on the process's gain in the iso-damping figure."""

_GAIN_COLOURS = ("#a9cbe8", "#6ba5d6", BLUE, VIOLET, RED)
_SHADE = "rgba(128,140,155,0.10)"
_DIGITS = 6


def signals_figure(run: Run) -> Figure:
    """Setpoint and measurement, control, and the disturbance where there is one, over the whole run."""
    signals = run.signals
    panels = [["setpoint", "measurement"], ["control"]]
    if "disturbance" in signals and np.any(signals["disturbance"].value):
        panels.append(["disturbance"])
    colours = {"setpoint": GREY, "measurement": BLUE, "control": GREEN, "disturbance": VIOLET}
    data = [
        _trace(signals[name], name, colours[name], _axis(i), run.end, held=name != "measurement")
        for i, names in enumerate(panels)
        for name in names
        if name in signals
    ]
    layout = _stacked([" and ".join(n for n in names if n in signals) for names in panels])
    layout["shapes"] = [*_phase_shades(run), *_limit_lines(run), *map(_retuning_line, retunings(run)[1:])]
    layout["annotations"] = [*_phase_labels(run), *map(_retuning_label, retunings(run)[1:])]
    return {"data": data, "layout": layout}


def comparison_figure(runs: Sequence[Run], names: Sequence[str]) -> Figure:
    """Measurement and control of several runs, one over the other."""
    data = []
    for run, name, colour in zip(runs, names, _cycle(len(runs)), strict=True):
        for panel, signal in enumerate(("measurement", "control")):
            trace = _trace(run.signals[signal], name, colour, _axis(panel), run.end, held=signal == "control")
            data.append({**trace, "legendgroup": name, "showlegend": panel == 0})
    return {"data": data, "layout": _stacked(["measurement", "control"])}


def _cycle(n: int) -> list[str]:
    colours = (BLUE, RED, GREEN, VIOLET, GREY)
    return [colours[i % len(colours)] for i in range(n)]


def _axis(panel: int) -> str:
    return "y" if panel == 0 else f"y{panel + 1}"


def _trace(signal: Signal, name: str, colour: str, axis: str, end: float, *, held: bool) -> Figure:
    time, value = decimate(signal.time, signal.value)
    if time[-1] < end:
        time, value = np.append(time, end), np.append(value, value[-1])
    return {
        "type": "scatter",
        "mode": "lines",
        "name": name,
        "x": numbers(time),
        "y": numbers(value),
        "yaxis": axis,
        "line": {"color": colour, "width": 1.6, "shape": "hv" if held else "linear"},
        "hovertemplate": "%{y:.5g}",
    }


def _stacked(titles: Sequence[str]) -> Figure:
    """Panels over one time axis, the first twice as high as the others."""
    gap = 0.06
    unit = (1.0 - gap * (len(titles) - 1)) / (len(titles) + 1)
    layout: Figure = {"hovermode": "x unified", "hoversubplots": "axis", "showlegend": True}
    top = 1.0
    for i, title in enumerate(titles):
        bottom = max(0.0, top - unit * (2 if i == 0 else 1))
        layout[_axis(i).replace("y", "yaxis")] = {"title": {"text": title}, "domain": [bottom, top]}
        top = bottom - gap
    layout["xaxis"] = {"title": {"text": "time [s]"}, "anchor": _axis(len(titles) - 1)}
    layout["legend"] = {"orientation": "h", "y": -0.16, "x": 0}
    return layout


def _phases(run: Run) -> list[tuple[float, float]]:
    starts = [phase.time for phase in run.phases]
    return list(pairwise([*starts, run.end])) if starts else []


def _phase_shades(run: Run) -> list[Figure]:
    return [
        {"type": "rect", "x0": start, "x1": end, "y0": 0, "y1": 1, "yref": "paper", "layer": "below",
         "fillcolor": _SHADE, "line": {"width": 0}}
        for start, end in _phases(run)[1::2]
    ]  # fmt: skip


def _phase_labels(run: Run) -> list[Figure]:
    """``1 starting gains`` above the first phase, and so on; a narrow page shows the number alone."""
    return [
        {"name": "phase", "text": f"{i} {phase.name}", "x": (start + end) / 2, "y": 1.0, "yref": "paper",
         "yanchor": "bottom", "showarrow": False}
        for i, (phase, (start, end)) in enumerate(zip(run.phases, _phases(run), strict=True), 1)
    ]  # fmt: skip


def _limit_lines(run: Run) -> list[Figure]:
    limits = [run.parameter(name) for name in ("control_min", "control_max")]
    return [
        {"type": "line", "x0": 0, "x1": 1, "xref": "paper", "y0": limit, "y1": limit, "yref": "y2",
         "line": {"color": GREEN, "width": 1, "dash": "dot"}}
        for limit in limits
        if isinstance(limit, (int, float)) and math.isfinite(limit)
    ]  # fmt: skip


def _retuning_line(change: Retuning) -> Figure:
    return {"type": "line", "x0": change.time, "x1": change.time, "y0": 0, "y1": 1, "yref": "paper",
            "line": {"color": RED, "width": 1.2}}  # fmt: skip


def _retuning_label(change: Retuning) -> Figure:
    return {"name": "retuning", "text": change.method, "x": change.time, "y": 0.995, "yref": "paper", "yanchor": "top",
            "xanchor": "left", "xshift": 2, "showarrow": False, "font": {"color": RED}}  # fmt: skip


def bode_figure(loop: Loop, found: Margins, w: Floats) -> Figure:
    """Magnitude and phase of L(jw) with crossover, phase margin and gain margin."""
    response = loop(1j * w)
    magnitude, phase = _db(response), _phase_deg(response)
    data = [_curve(w, magnitude, "|L|", BLUE), {**_curve(w, phase, "arg L", BLUE), "yaxis": "y2"}]
    shapes, notes = [], []
    if math.isfinite(found.crossover):
        at = float(np.interp(math.log(found.crossover), np.log(w), phase))
        foot = at - math.degrees(found.phase_margin)
        shapes += [_vertical(found.crossover, foot, at, "y2"), _vertical(found.crossover, magnitude.min(), 0.0, "y")]
        notes.append(_note(found.crossover, at, "y2", f"{math.degrees(found.phase_margin):.1f}°"))
    if math.isfinite(found.gain_margin) and math.isfinite(found.phase_crossover):
        gain_db = -20.0 * math.log10(found.gain_margin)
        shapes.append(_vertical(found.phase_crossover, gain_db, 0.0, "y"))
        notes.append(_note(found.phase_crossover, gain_db, "y", f"{-gain_db:.1f} dB"))
    layout = {
        "xaxis": _frequency_axis(w, anchor="y2"),
        "yaxis": {"title": {"text": "|L| [dB]"}, "domain": [0.53, 1.0], "range": _clipped(magnitude, -60.0, 60.0)},
        "yaxis2": {"title": {"text": "arg L [°]"}, "domain": [0.0, 0.47], "range": _clipped(phase, -360.0, 90.0),
                   "dtick": 90},
        "shapes": shapes,
        "annotations": notes,
        "showlegend": False,
    }  # fmt: skip
    return {"data": data, "layout": layout}


def sensitivity_figure(loop: Loop, found: Margins, w: Floats) -> Figure:
    """Magnitude of S and T with their peaks."""
    s = 1j * w
    data = [
        _curve(w, _db(loop.sensitivity(s)), "|S|", RED),
        _curve(w, _db(loop.complementary_sensitivity(s)), "|T|", BLUE),
    ]
    notes = [
        _note(frequency, 20.0 * math.log10(value), "y", f"{name} {value:.2f}")
        for name, value, frequency in (("Ms", found.ms, found.ms_frequency), ("Mt", found.mt, found.mt_frequency))
        if w[0] < frequency < w[-1] and value > 0.0
    ]
    layout = {
        "xaxis": _frequency_axis(w),
        "yaxis": {"title": {"text": "magnitude [dB]"}, "range": _clipped(np.concatenate([t["y"] for t in data]), -60, 20)},
        "annotations": notes,
        "showlegend": True,
        "legend": {"orientation": "h", "x": 0, "y": 1.0, "yanchor": "bottom"},
    }
    return {"data": data, "layout": layout}


def nyquist_figure(loop: Loop, found: Margins, w: Floats) -> Figure:
    """L(jw) near -1, with the circle it stays out of."""
    response = loop(1j * w)
    near = response[np.abs(response) < 8.0]
    radius = 1.0 / found.ms
    data = [
        {**_points(near.real, near.imag, "L(jω)", BLUE), "hovertemplate": "%{x:.3f} %{y:+.3f}j"},
        {**_points([-1.0], [0.0], "−1", RED), "mode": "markers", "marker": {"size": 7}},
    ]
    layout = {
        "xaxis": {"title": {"text": "Re L"}, "range": [-2.4, 1.2], "constrain": "domain"},
        "yaxis": {"title": {"text": "Im L"}, "range": [-2.2, 1.2], "scaleanchor": "x", "constrain": "domain"},
        "shapes": [_circle(-1.0, radius, RED, "solid"), _circle(0.0, 1.0, GREY, "dot")],
        "annotations": [_note(-1.0, radius, "y", f"1/Ms, Ms = {found.ms:.2f}")],
        "showlegend": False,
    }
    return {"data": data, "layout": layout}


def isodamping_figure(loop: Loop, horizon: float) -> Figure:
    """Step responses when the process's gain is not what it was tuned for."""
    data = []
    for gain, colour in zip(ISO_GAINS, _GAIN_COLOURS, strict=True):
        changed = Loop(loop.process.scaled(gain), loop.controller)
        if not stability(changed).stable:
            data.append({**_points([None], [None], f"×{gain:g} unstable", colour)})
            continue
        response = step_response(changed, horizon, points=600)
        data.append(_points(response.time, response.output, f"×{gain:g}", colour))
    layout = {
        "xaxis": {"title": {"text": "time [s]"}},
        "yaxis": {"title": {"text": "response to a unit step"}},
        "hovermode": "x unified",
        "showlegend": True,
        "legend": {"orientation": "h", "x": 0, "y": 1.0, "yanchor": "bottom", "title": {"text": "process gain "}},
    }
    return {"data": data, "layout": layout}
