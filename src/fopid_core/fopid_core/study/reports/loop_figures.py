"""A tuned loop in frequency and in time: Bode, sensitivities, Nyquist, iso-damping."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from fopid_core.design.time.search_response import ResponseGrid
from fopid_core.model.arrays import Complexes, Floats
from fopid_core.model.loop import Loop
from fopid_core.model.margins import Margins, margins
from fopid_core.model.stability import stable_mask
from fopid_core.study.reports.display import decimate
from fopid_core.study.reports.plotly_parts import BLUE, GREY, RED, VIOLET, Figure, legend_above, line, note, segment

ISO_GAINS = (0.5, 0.7, 1.0, 1.4, 2.0)
"""Factors on the process's gain in the iso-damping figure."""

_ISO_COLOURS = ("#9cc4e6", "#62a0d3", BLUE, VIOLET, RED)
_POINTS_A_DECADE = 120
_RESPONSE_POINTS = 4096
_SHOWN = 200  # stretches of a response, each with up to four points
_PEAKED = 1.005  # a peak that can be seen


def loop_figures(loop: Loop) -> dict[str, Figure]:
    """All figures of a stable loop, by name."""
    found = margins(loop)
    w = _frequencies(found)
    figures = {
        "bode": bode_figure(loop, found, w),
        "sensitivity": sensitivity_figure(loop, found, w),
        "nyquist": nyquist_figure(loop, found, w),
    }
    speed = _characteristic_frequency(found)
    return {**figures, "isodamping": isodamping_figure(loop, 12.0 / speed + 4.0 * loop.process.delay, speed)}


def _characteristic_frequency(found: Margins) -> float:
    """Where the loop works [rad/s]."""
    if math.isfinite(found.crossover):
        return found.crossover
    return found.ms_frequency if 0.0 < found.ms_frequency < math.inf else 1.0


def _frequencies(found: Margins) -> Floats:
    """A logarithmic grid around all that is marked in the figures."""
    marks = [_characteristic_frequency(found), found.phase_crossover, found.ms_frequency]
    inside = [mark for mark in marks if math.isfinite(mark) and mark > 0.0]
    low, high = math.floor(math.log10(min(inside)) - 1.5), math.ceil(math.log10(max(inside)) + 1.0)
    return np.logspace(low, high, (high - low) * _POINTS_A_DECADE + 1)


def bode_figure(loop: Loop, found: Margins, w: Floats) -> Figure:
    """Magnitude and phase of L(jw) with crossover, phase margin and gain margin."""
    response = loop(1j * w)
    magnitude, phase = decibels(response), np.degrees(np.unwrap(np.angle(response)))
    data = [line(w, magnitude, "|L|", BLUE), line(w, phase, "arg L", BLUE, yaxis="y2")]
    marks, notes = _margin_marks(found, w, phase)
    layout = {
        "xaxis": frequency_axis(anchor="y2"),
        "yaxis": {"title": {"text": "|L| [dB]"}, "domain": [0.54, 1.0], "range": _range(magnitude, -60.0, 60.0)},
        "yaxis2": {
            "title": {"text": "arg L [°]"},
            "domain": [0.0, 0.46],
            "range": _range(np.append(phase, -180.0), -360.0, 180.0),
            "dtick": 90,
        },
        "shapes": marks,
        "annotations": notes,
    }
    return {"data": data, "layout": layout}


def _margin_marks(found: Margins, w: Floats, phase: Floats) -> tuple[list[Figure], list[Figure]]:
    """Lines and texts that show the margins."""
    marks, notes = [segment((0, 1), (0, 0), GREY, xref="x domain", line={"color": GREY, "width": 1, "dash": "dot"})], []
    if math.isfinite(found.crossover):
        x, top = found.crossover, float(np.interp(math.log(found.crossover), np.log(w), phase))
        degrees = math.degrees(found.phase_margin)
        marks.append(segment((x, x), (top - degrees, top), RED, yref="y2"))
        notes.append(_beside(x, top - 0.5 * degrees, f"PM {degrees:.1f}°", yref="y2", xanchor="right", xshift=-4))
    if math.isfinite(found.gain_margin) and math.isfinite(found.phase_crossover):
        x, db = found.phase_crossover, 20.0 * math.log10(found.gain_margin)
        marks.append(segment((x, x), (-db, 0.0), RED))
        notes.append(_beside(x, -0.5 * db, f"GM {db:.1f} dB"))
    return marks, notes


def _beside(frequency: float, y: float, text: str, **more: Any) -> Figure:
    return note(math.log10(frequency), y, text, **{"yanchor": "middle", **more})


def sensitivity_figure(loop: Loop, found: Margins, w: Floats) -> Figure:
    """Magnitude of S and T with their peaks."""
    sensitivity, complementary = decibels(loop.sensitivity(1j * w)), decibels(loop.complementary_sensitivity(1j * w))
    layout = {
        "xaxis": frequency_axis(),
        "yaxis": {
            "title": {"text": "magnitude [dB]"},
            "range": _range(np.append(sensitivity, complementary), -60.0, 20.0),
        },
        "annotations": _peak_notes(found, w),
        "showlegend": True,
        "legend": legend_above(),
    }
    return {"data": [line(w, sensitivity, "|S|", RED), line(w, complementary, "|T|", BLUE)], "layout": layout}


def _peak_notes(found: Margins, w: Floats) -> list[Figure]:
    """Ms and Mt at their peaks: of two, the one at the lower frequency to the left, the other to the right."""
    named = sorted([(found.ms_frequency, found.ms, "Ms"), (found.mt_frequency, found.mt, "Mt")])
    peaks = [peak for peak in named if w[0] < peak[0] < w[-1] and peak[1] > _PEAKED]
    sides = ("center",) if len(peaks) == 1 else ("right", "left")
    return [
        note(math.log10(frequency), 20.0 * math.log10(value), f"{name} = {value:.2f}", xanchor=side, xshift=0)
        for (frequency, value, name), side in zip(peaks, sides, strict=False)
    ]


def nyquist_figure(loop: Loop, found: Margins, w: Floats) -> Figure:
    """L(jw) near -1, and the circle around -1 that it touches, where that is known."""
    response = loop(1j * w)
    near, radius = response[np.abs(response) < 10.0], 1.0 / found.ms
    touched = math.isfinite(radius)  # else max |S| is not known
    critical = line([-1.0], [0.0], "−1", RED, mode="markers", marker={"size": 7, "color": RED}, hoverinfo="skip")
    layout = {
        "xaxis": {"title": {"text": "Re L"}, "range": [-2.3, 1.3]},
        "yaxis": {"title": {"text": "Im L"}, "range": [-2.3, 1.3], "scaleanchor": "x"},
        "shapes": [_circle(-1.0, radius, RED, "solid")] * touched + [_circle(0.0, 1.0, GREY, "dot")],
        "annotations": [note(-1.0, 0.0, f"1/Ms = {radius:.2f}", xanchor="center", xshift=0, yshift=6)] * touched,
        "hovermode": "closest",
    }
    curve = line(near.real, near.imag, "L(jω)", BLUE, hovertemplate="%{x:.4g} %{y:+.4g} j")
    return {"data": [curve, critical], "layout": layout}


def isodamping_figure(loop: Loop, horizon: float, crossover: float) -> Figure:
    """Step responses when the process's gain is not the one it was tuned for."""
    kp, ki, kd, lam, mu = loop.controller.gains
    # The output depends on the product of the two gains only.
    rows = np.array([(gain * kp, gain * ki, gain * kd, lam, mu) for gain in ISO_GAINS])
    grid = ResponseGrid(loop.process, horizon, _RESPONSE_POINTS, crossover)
    data = []
    for gain, colour, stable, error in zip(
        ISO_GAINS, _ISO_COLOURS, stable_mask(loop.process, rows), grid.errors(rows), strict=True
    ):
        if stable:
            data.append(line(*decimate(grid.time, 1.0 - error, _SHOWN), f"×{gain:g}", colour))
        else:
            data.append(line([0.0], [math.nan], f"×{gain:g} unstable", colour))
    layout = {
        "xaxis": {"title": {"text": "time [s]"}},
        "yaxis": {"title": {"text": "response to a unit step"}},
        "hovermode": "x unified",
        "showlegend": True,
        "legend": legend_above(),
    }
    return {"data": data, "layout": layout}


def frequency_axis(anchor: str = "y") -> Figure:
    """Logarithmic, beneath the panel that is named."""
    return {"title": {"text": "ω [rad/s]"}, "type": "log", "anchor": anchor, "dtick": 1, "exponentformat": "power"}


def decibels(response: Complexes | Floats | float) -> Floats:
    """The size of a response."""
    return np.asarray(20.0 * np.log10(np.abs(response)), dtype=float)


def _range(values: Floats, low: float, high: float) -> list[float]:
    """What the values span, and a little more, within limits."""
    room = 0.08 * (min(high, values.max()) - max(low, values.min()))
    return [float(max(low, values.min() - room)), float(min(high, values.max() + room))]


def _circle(centre: float, radius: float, colour: str, dash: str) -> Figure:
    box = {"x0": centre - radius, "x1": centre + radius, "y0": -radius, "y1": radius}
    return {"type": "circle", **box, "line": {"color": colour, "width": 1.2, "dash": dash}}
