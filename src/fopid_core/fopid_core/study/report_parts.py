"""Pieces of the report's page, as HTML."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from html import escape

from fopid_core.design.specification import Achieved
from fopid_core.model.fopid import Fopid
from fopid_core.study.segment_table import COLUMNS, number
from fopid_core.study.segments import Segment


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


def table(rows: Sequence[Segment], runs: Sequence[str] = ()) -> str:
    """The segments, with the name of the run before each when ``runs`` gives one per row."""
    heads = [_head(column.heading, column.unit, is_number=column.is_number) for column in COLUMNS]
    lines = [[_cell(column.text(row), is_number=column.is_number) for column in COLUMNS] for row in rows]
    if runs:
        heads.insert(0, _head("run", "", is_number=False))
        lines = [[_cell(run, is_number=False), *line] for run, line in zip(runs, lines, strict=True)]
    body = "\n".join(f"<tr>{''.join(line)}</tr>" for line in lines)
    return f'<div class="scroll"><table><thead><tr>{"".join(heads)}</tr></thead>\n<tbody>{body}</tbody></table></div>'


def _head(heading: str, unit: str, *, is_number: bool) -> str:
    small = f"<small>{escape(unit)}</small>" if unit else ""
    return f"<th{'' if is_number else ' class=words'}>{escape(heading)}{small}</th>"


def _cell(text: str, *, is_number: bool) -> str:
    return f"<td{'' if is_number else ' class=words'}>{escape(text)}</td>"


def definitions(values: Mapping[str, str]) -> str:
    """Names and texts below each other."""
    items = "".join(f"<dt>{escape(name)}</dt><dd>{escape(value)}</dd>" for name, value in values.items())
    return f"<dl>{items}</dl>"


def folded(title: str, text: str) -> str:
    """A long text that opens on demand."""
    return f"<details><summary>{escape(title)}</summary><pre>{escape(text)}</pre></details>"
