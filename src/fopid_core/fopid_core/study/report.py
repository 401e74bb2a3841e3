"""The report: one HTML page that needs nothing else, and its main figure as PNG."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from html import escape
from importlib import resources
from pathlib import Path
from string import Template

from fopid_core.errors import InputError
from fopid_core.model.fopid import Fopid
from fopid_core.model.loop import Loop
from fopid_core.model.stability import stability
from fopid_core.study.loop_figures import loop_figures
from fopid_core.study.plotly_parts import Figure
from fopid_core.study.report_image import write_image
from fopid_core.study.run import Run, Tuning
from fopid_core.study.segment_table import COLUMNS, number
from fopid_core.study.segments import Retuning, Segment, retunings, segments
from fopid_core.study.signal_figures import comparison_figure, signals_figure

MOST_TUNINGS = 12
"""Tunings shown with figures; of more, the last ones."""

_CAPTIONS = {
    "bode": "Open loop L = C P",
    "sensitivity": "Sensitivity S and complementary sensitivity T",
    "nyquist": "L(jω) and the circle of the largest sensitivity around −1",
    "isodamping": "Iso-damping: the process's gain is off by a factor",
}


def write_report(runs: Sequence[Run], out: Path) -> tuple[Path, Path]:
    """Write the report of one or more runs.

    Parameters
    ----------
    runs : sequence of Run
    out : Path
        The HTML page; the PNG gets the same name with ``.png``.

    Returns
    -------
    page, image : Path

    Raises
    ------
    InputError
        Without runs, or when a file cannot be written.
    """
    if not runs:
        raise InputError("runs = (); allowed: at least one")
    image = out.with_suffix(".png")
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        out.write_text(render(runs), encoding="utf-8")
        write_image(runs, image)
    except OSError as error:
        raise InputError(f"report {str(out)!r} cannot be written: {error.strerror}") from None
    return out, image


def render(runs: Sequence[Run]) -> str:
    """The page as text."""
    names = _names(runs)
    figures: dict[str, Figure] = {}
    content = [_comparison(runs, names, figures)] if len(runs) > 1 else []
    content += [_run(run, name, f"run{i}", figures) for i, (run, name) in enumerate(zip(runs, names, strict=True))]
    folder = resources.files("fopid_core.study")
    parts = {
        "title": escape(", ".join(names)),
        "style": folder.joinpath("report_page.css").read_text(encoding="utf-8"),
        "content": "\n".join(content),
        "figures": json.dumps(figures, allow_nan=False, separators=(",", ":")).replace("</", "<\\/"),
        "plotly": _plotly(),
        "script": folder.joinpath("report_page.js").read_text(encoding="utf-8"),
    }
    return Template(folder.joinpath("report_page.html").read_text(encoding="utf-8")).substitute(parts)


@cache
def _plotly() -> str:
    return resources.files("plotly.package_data").joinpath("plotly.min.js").read_text(encoding="utf-8")


def _names(runs: Sequence[Run]) -> list[str]:
    """The experiment's name, or the bag's; of several runs always the bag's, which differ."""
    bags = [f"{run.path.resolve().stem}{run.namespace}" for run in runs]
    return bags if len(runs) > 1 else [str(runs[0].experiment.get("name") or bags[0])]


def _comparison(runs: Sequence[Run], names: Sequence[str], figures: dict[str, Figure]) -> str:
    figures["comparison"] = comparison_figure(runs, names)
    rows = [(name, segment) for run, name in zip(runs, names, strict=True) for segment in segments(run)]
    return f"""<header><h1>{len(runs)} runs</h1></header>
<h2>Side by side</h2>
{_plot("comparison", "signals", "Measurement and control of all runs")}
{_table([segment for _, segment in rows], [name for name, _ in rows])}"""


def _run(run: Run, name: str, key: str, figures: dict[str, Figure]) -> str:
    figures[f"{key}-signals"] = signals_figure(run)
    changes = retunings(run)
    tunings = "".join(_tuning(run, change, f"{key}-tuning{i}", figures) for i, change in enumerate(changes))
    return f"""<header><h1>{escape(name)}</h1>
{_equation("P", _process_text(run)) if run.process else ""}
{_facts(run)}
{"" if run.whole else '<p class="warning">The recording was cut off; the report shows what it holds.</p>'}</header>
<h2>Signals</h2>
{_plot(f"{key}-signals", "signals", "Setpoint, measurement and control; red: new gains; dotted: limits of the control")}
<h2>Phases</h2>
{_table(segments(run))}
<p class="quiet">Rise from 10 to 90 % and settling to 2 % of the step of the setpoint; IAE and ITAE from the start of each
phase; Ms and phase margin of the loop with its nominal process.</p>
{f"<h2>Tunings</h2>{tunings}" if tunings else ""}
{_what_was_run(run)}"""


def _process_text(run: Run) -> str:
    """The process as it was typed, where the bag has that."""
    return run.metadata.get("process") or str(run.experiment.get("process") or run.process)


def _facts(run: Run) -> str:
    measurement = run.signals["measurement"].time
    facts = {
        "duration": f"{number(run.end - float(measurement[0]))} s",
        "samples": f"{measurement.size:,}",
        "sample time": f"{number(run.sample_time)} s",
        "time": str(run.experiment.get("trigger", "")),
    }
    items = "".join(f"<li><span>{name}</span><b>{escape(value)}</b></li>" for name, value in facts.items() if value)
    return f'<ul class="facts">{items}</ul>'


def _plot(figure: str, kind: str, caption: str) -> str:
    return f"""<figure><figcaption>{escape(caption)}</figcaption>
<div class="plot {kind}" data-figure="{figure}" role="img" aria-label="{escape(caption)}"></div></figure>"""


def _table(rows: Sequence[Segment], runs: Sequence[str] = ()) -> str:
    heads = "".join(
        f'<th{"" if c.is_number else " class=words"}>{escape(c.heading)}<small>{escape(c.unit)}</small></th>' for c in COLUMNS
    )
    lines = []
    for i, row in enumerate(rows):
        first = f'<td class="words">{escape(runs[i])}</td>' if runs else ""
        cells = "".join(f"<td{'' if c.is_number else ' class=words'}>{escape(c.text(row))}</td>" for c in COLUMNS)
        lines.append(f"<tr>{first}{cells}</tr>")
    first_head = '<th class="words">run</th>' if runs else ""
    return f"""<div class="scroll"><table><thead><tr>{first_head}{heads}</tr></thead>
<tbody>{"".join(lines)}</tbody></table></div>"""
