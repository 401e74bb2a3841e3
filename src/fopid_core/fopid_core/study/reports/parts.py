"""Pieces of the report's page, as HTML."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from html import escape

from fopid_core.design.specification import Achieved
from fopid_core.model.fopid import Fopid
from fopid_core.study.reports.segment_table import COLUMNS, Column, number
from fopid_core.study.reports.segments import Segment


def equation(name: str, text: str) -> str:
    """``name(s) = text`` with powers raised.

    Examples
    --------
    >>> equation("P", "1/(s+1)^3")
    '<p class="math">P(s) = 1/(s+1)<sup>3</sup></p>'
    """
    raised = re.sub(r"\^(-?[\d.]+)", lambda match: f"<sup>{match[1].replace('-', '−')}</sup>", escape(text))
    return f'<p class="math">{name}(s) = {raised}</p>'


def controller_text(controller: Fopid) -> str:
    """C(s) to three digits.

    Examples
    --------
    >>> controller_text(Fopid(kp=1.0, ki=0.25, kd=-2.0, mu=0.9))
    '1 + 0.25 s^-1 − 2 s^0.9'
    """
    terms = (
        (controller.kp, ""),
        (controller.ki, f" s^-{number(controller.lam)}"),
        (controller.kd, f" s^{number(controller.mu)}"),
    )
    shown = [(gain, power) for gain, power in terms if gain] or [(0.0, "")]
    text = "".join(f" {'−' if gain < 0 else '+'} {number(abs(gain))}{power}" for gain, power in shown)
    return text.removeprefix(" + ").removeprefix(" ")


def facts(values: Mapping[str, str]) -> str:
    """Names and values in one line that wraps; what is empty is left out."""
    items = "".join(f"<li><span>{name}</span><b>{escape(value)}</b></li>" for name, value in values.items() if value)
    return f'<ul class="facts">{items}</ul>'


def measures(found: Achieved) -> str:
    """Margins and peaks of a loop."""
    return facts(
        {
            "Ms": number(found.ms),
            "Mt": number(found.mt),
            "phase margin": f"{number(math.degrees(found.phase_margin))}°",
            "crossover": f"{number(found.crossover)} rad/s",
            "gain margin": f"{number(found.gain_margin_db)} dB",
            "delay margin": f"{number(found.delay_margin)} s",
        }
    )


def plot(figure: str, caption: str, kind: str = "") -> str:
    """The place of a figure."""
    return f"""<figure><figcaption>{escape(caption)}</figcaption>
<div class="plot {kind}" data-figure="{figure}" role="img" aria-label="{escape(caption)}"></div></figure>"""


def table(rows: Sequence[Segment]) -> str:
    """The segments, one a row."""
    return _table(COLUMNS, [[_cell(column, column.text(row)) for column in COLUMNS] for row in rows])


def comparison_table(runs: Sequence[Sequence[Segment]], names: Sequence[str]) -> str:
    """The segments of several runs, those of one name below each other, with the difference to the first run."""
    phase, *rest = COLUMNS
    columns = (phase, Column("run", "", str), *rest)
    lines = []
    for group in _matched(runs):
        title = next(phase.text(segment) for segment in group if segment)
        for i, segment in enumerate(group):
            if segment:
                head = [_cell(phase, title), _cell(columns[1], names[i])]
                base = group[0] if i else None
                lines.append(head + [_cell(c, c.text(segment), _difference(c, segment, base)) for c in rest])
                title = ""
    return _table(columns, lines, "dense")


def _matched(runs: Sequence[Sequence[Segment]]) -> list[list[Segment | None]]:
    """Segments of one name, the first of it with the first; None where a run has none."""
    found: dict[tuple[str, int], list[Segment | None]] = {}
    for i, run in enumerate(runs):
        seen: Counter[str] = Counter()
        for segment in run:
            found.setdefault((segment.name, seen[segment.name]), [None] * len(runs))[i] = segment
            seen[segment.name] += 1
    return list(found.values())


def _difference(column: Column, segment: Segment, base: Segment | None) -> str:
    """How far a quantity is from that of the base: in per cent, or in its own unit; empty where that says nothing."""
    if base is None or column.value is None:
        return ""
    value, before = column.value(segment), column.value(base)
    if column.text(segment) == column.text(base) or not math.isfinite(value - before):
        return ""
    if column.is_share or before == 0.0:
        return signed(value - before, digits=2)
    return f"{signed(100.0 * (value - before) / abs(before), digits=2)} %"


def signed(value: float, digits: int = 3) -> str:
    """A number with its sign.

    Examples
    --------
    >>> signed(1.5), signed(-0.25)
    ('+1.5', '−0.25')
    """
    return f"{'−' if value < 0 else '+'}{number(abs(value), digits)}"


def _table(columns: Sequence[Column], lines: Sequence[Sequence[str]], kind: str = "") -> str:
    heads = "".join(_head(column) for column in columns)
    body = "\n".join(f"<tr>{''.join(line)}</tr>" for line in lines)
    head = f'<table class="{kind}"><thead><tr>{heads}</tr></thead>'
    return f'<div class="scroll">{head}\n<tbody>{body}</tbody></table></div>'


def _head(column: Column) -> str:
    small = f"<small>{escape(column.unit)}</small>" if column.unit else ""
    return f"<th{_kind(column)}>{escape(column.heading)}{small}</th>"


def _cell(column: Column, text: str, difference: str = "") -> str:
    small = f"<small>{escape(difference)}</small>" if difference else ""
    return f"<td{_kind(column)}>{escape(text)}{small}</td>"


def _kind(column: Column) -> str:
    return "" if column.is_number else " class=words"


def definitions(values: Mapping[str, str]) -> str:
    """Names and texts below each other."""
    items = "".join(f"<dt>{escape(name)}</dt><dd>{escape(value)}</dd>" for name, value in values.items())
    return f"<dl>{items}</dl>"


def folded(title: str, text: str) -> str:
    """A long text that opens on demand."""
    return f"<details><summary>{escape(title)}</summary><pre>{escape(text)}</pre></details>"
