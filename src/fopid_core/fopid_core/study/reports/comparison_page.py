"""The page of a comparison: its table, its sentence, and the steps of the designs worth a look."""

from __future__ import annotations

from html import escape

from fopid_core.design.comparison.compare import Comparison
from fopid_core.design.comparison.measures import Row
from fopid_core.model.process import Process
from fopid_core.model.response import Response, Source, step_response
from fopid_core.study.reports.page import page
from fopid_core.study.reports.parts import equation, plot
from fopid_core.study.reports.plotly_parts import BLUE, GREEN, GREY, RED, VIOLET, Figure, legend_above, line
from fopid_core.study.reports.segment_table import number

COLUMNS = {
    "iae_setpoint": "IAE setpoint", "iae_load": "IAE load", "ms": "Ms", "mt": "Mt", "noise_gain": "noise gain",
    "overshoot_pct": "overshoot %", "settling_time": "settles s", "control_peak": "control peak",
    "total_variation": "control moves", "overshoot_spread_pct": "overshoot spread %", "delay_margin": "delay margin s",
    "running_ms": "Ms as it runs",
}  # fmt: skip
_COLOURS = (RED, BLUE, GREEN, VIOLET, GREY)
_SHOWN = ("pi", "pid", "fopi", "fopid")
_POINTS = 601


def comparison_page(process: Process, found: Comparison) -> str:
    """The page as text."""
    content = "\n".join(
        (
            "<h1>Which method, which structure</h1>", equation("P", str(process)),
            f"<p><b>{escape(found.reason)}</b></p>", "<h2>Steps</h2>",
            plot("setpoint", "A setpoint step: measurement above, control below"),
            plot("load", "A load step: measurement above, control below"),
            plot("trade-off", "Load IAE over Ms; towards the lower left is better"),
            "<h2>All designs</h2>", _table(found),
        )
    )  # fmt: skip
    shown = _shown(found)
    figures = {
        "setpoint": _steps(shown, found, "setpoint"),
        "load": _steps(shown, found, "load"),
        "trade-off": _trade_off(found),
    }
    return page("Comparison of tuning methods", content, figures)


def _shown(found: Comparison) -> list[Row]:
    """The recommended design first, then the best within the bounds of each structure."""
    good = [row for row in found.rows if row.is_within]
    shown = [found.rows[found.recommended]] if found.recommended >= 0 else []
    for name in _SHOWN:
        of_name = [row for row in good if row.candidate.structure == name]
        best = min(of_name, key=lambda row: row.iae_load, default=None)
        if best is not None and best not in shown:
            shown.append(best)
    return shown[: len(_COLOURS)]


def _steps(rows: list[Row], found: Comparison, source: Source) -> Figure:
    data: list[Figure] = []
    for row, colour in zip(rows, _COLOURS, strict=False):
        if row.candidate.loop is None:
            continue
        response: Response = step_response(row.candidate.loop, found.bounds.horizon, source, points=_POINTS)
        name = f"{row.candidate.structure}, {row.candidate.method}"
        after = response.time >= 4.0 * found.bounds.sample_time
        data.append(line(response.time, response.output, name, colour, legendgroup=name))
        control = line(
            response.time[after], response.control[after], name, colour, yaxis="y2", legendgroup=name, showlegend=False
        )
        data.append(control)
    layout = {
        "xaxis": {"title": {"text": "time [s]"}, "anchor": "y2"},
        "yaxis": {"title": {"text": "measurement"}, "domain": [0.42, 1.0]},
        "yaxis2": {"title": {"text": "control"}, "domain": [0.0, 0.34]},
        "legend": legend_above(),
    }
    return {"data": data, "layout": layout}


def _trade_off(found: Comparison) -> Figure:
    data = []
    for good, name, colour in ((True, "within the bounds", BLUE), (False, "breaks a bound", GREY)):
        rows = [row for row in found.rows if row.stable and row.is_within == good]
        words = [f"{row.candidate.structure}, {row.candidate.method}" for row in rows]
        marks = line([row.ms for row in rows], [row.iae_load for row in rows], name, colour)
        data.append({**marks, "mode": "markers", "text": words, "hovertemplate": "%{text}: Ms %{x:.3f}, IAE %{y:.4g}"})
    layout = {
        "xaxis": {"title": {"text": "Ms"}}, "yaxis": {"title": {"text": "IAE of the load"}, "type": "log"},
        "legend": legend_above(),
    }  # fmt: skip
    return {"data": data, "layout": layout}


def _table(found: Comparison) -> str:
    heads = "".join(f"<th>{escape(name)}</th>" for name in COLUMNS.values())
    lines = "\n".join(_line(row, i == found.recommended) for i, row in enumerate(found.rows))
    head = f"<thead><tr><th class=words>method</th><th class=words>structure</th>{heads}</tr></thead>"
    return f'<div class="scroll"><table>{head}\n<tbody>{lines}</tbody></table></div>'


def _line(row: Row, taken: bool) -> str:
    candidate = row.candidate
    words = f"<td class=words>{'★ ' if taken else ''}{escape(candidate.method)}</td>"
    words += f"<td class=words>{escape(candidate.structure)}</td>"
    if candidate.loop is None:
        return f"<tr>{words}<td class=words colspan={len(COLUMNS)}>{escape(candidate.reason)}</td></tr>"
    cells = "".join(f"<td>{number(getattr(row, name), 4)}</td>" for name in COLUMNS)
    hint = escape("; ".join(row.unmet), quote=True)
    return f'<tr title="{hint}"{"" if row.is_within else " style=opacity:.55"}>{words}{cells}</tr>'
