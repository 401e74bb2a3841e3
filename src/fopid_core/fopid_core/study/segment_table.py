"""The table of segments: the same columns on the terminal and in the report."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from rich import box
from rich.console import Console, Group
from rich.table import Table

from fopid_core.study.segments import Segment

NOTHING = "–"
"""What stands where a measure has no meaning."""


@dataclass(frozen=True)
class Column:
    """A quantity of a segment: heading, unit and text."""

    heading: str
    unit: str
    text: Callable[[Segment], str]
    is_number: bool = True


def number(value: float, digits: int = 3) -> str:
    """A number for people: so many significant digits, a dash for NaN.

    Examples
    --------
    >>> number(0.123456), number(1234.5), number(float("nan")), number(float("inf")), number(3.0)
    ('0.123', '1234', '–', '∞', '3')
    """
    if math.isnan(value):
        return NOTHING
    if math.isinf(value):
        return "∞" if value > 0 else "−∞"
    return f"{value:.0f}" if 10.0**digits <= abs(value) < 1e6 else f"{value:.{digits}g}"


def _gain(name: str) -> Callable[[Segment], str]:
    return lambda segment: number(getattr(segment.gains, name)) if segment.gains else NOTHING


def _measure(name: str) -> Callable[[Segment], str]:
    return lambda segment: number(getattr(segment, name))


COLUMNS = (
    Column("phase", "", lambda segment: segment.name, is_number=False),
    Column("method", "", lambda segment: segment.method or NOTHING, is_number=False),
    Column("kp", "", _gain("kp")),
    Column("ki", "", _gain("ki")),
    Column("kd", "", _gain("kd")),
    Column("λ", "", _gain("lam")),
    Column("μ", "", _gain("mu")),
    Column("overshoot", "%", lambda segment: _percent(segment.overshoot_pct)),
    Column("rise", "s", _measure("rise_time")),
    Column("settling", "s", _measure("settling_time")),
    Column("IAE", "", _measure("iae")),
    Column("ITAE", "", _measure("itae")),
    Column("max|e|", "", _measure("error_peak")),
    Column("max|u|", "", _measure("control_peak")),
    Column("Ms", "", _measure("ms")),
    Column("phase margin", "°", lambda segment: number(math.degrees(segment.phase_margin))),
)
"""Rise from 10 to 90 %, settling to 2 % of the step of the setpoint."""

_LABELS, _CELLS = 18, 12  # characters for the names of the quantities, and for each segment


def _percent(value: float) -> str:
    return NOTHING if math.isnan(value) else f"{value:.1f}"


def segment_table(found: Sequence[Segment], width: int = 120) -> Group:
    """For a terminal: a column per segment, in as many tables below each other as ``width`` asks for.

    Examples
    --------
    >>> len(segment_table([], width=80).renderables)
    0
    """
    fitting = max(1, (width - _LABELS) // _CELLS)
    return Group(*(_table(found[i : i + fitting]) for i in range(0, len(found), fitting)))


def print_segments(found: Sequence[Segment]) -> None:
    """Write the table to stdout, as wide as the terminal."""
    console = Console()
    console.print(segment_table(found, console.width))


def _table(found: Sequence[Segment]) -> Table:
    name, *quantities = COLUMNS
    table = Table(box=box.SIMPLE_HEAD, padding=(0, 0, 0, 1), pad_edge=False)
    table.add_column(name.heading, no_wrap=True)
    for segment in found:
        table.add_column(name.text(segment), justify="right", min_width=_CELLS - 2)
    for column in quantities:
        heading = f"{column.heading} \\[{column.unit}]" if column.unit else column.heading
        table.add_row(heading, *(column.text(segment) for segment in found))
    return table
