"""The table of segments: the same columns on the terminal and in the report."""

from __future__ import annotations

import math
import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from fopid_core.study.reports.segments import Segment

NOTHING = "–"
"""What stands where a measure has no meaning."""


@dataclass(frozen=True)
class Column:
    """A quantity of a segment: heading, unit and text, and the number behind the text where it is one.

    ``is_share``: differences of it are told in its own unit, not as a share of it.
    """

    heading: str
    unit: str
    text: Callable[[Segment], str]
    value: Callable[[Segment], float] | None = None
    is_share: bool = False

    @property
    def is_number(self) -> bool:
        """Whether there is a number behind the text."""
        return self.value is not None


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


def _quantity(heading: str, unit: str, value: Callable[[Segment], float]) -> Column:
    return Column(heading, unit, lambda segment: number(value(segment)), value)


def _gain(heading: str, name: str) -> Column:
    return _quantity(heading, "", lambda segment: getattr(segment.gains, name) if segment.gains else math.nan)


def _phase_margin(segment: Segment) -> float:
    return math.degrees(segment.phase_margin)


COLUMNS = (
    Column("phase", "", lambda segment: segment.name),
    Column("method", "", lambda segment: segment.method or NOTHING),
    _gain("kp", "kp"),
    _gain("ki", "ki"),
    _gain("kd", "kd"),
    _gain("λ", "lam"),
    _gain("μ", "mu"),
    Column("overshoot", "%", lambda s: _percent(s.overshoot_pct), lambda s: s.overshoot_pct, is_share=True),
    _quantity("rise", "s", lambda segment: segment.rise_time),
    _quantity("settling", "s", lambda segment: segment.settling_time),
    _quantity("IAE", "", lambda segment: segment.iae),
    _quantity("ITAE", "", lambda segment: segment.itae),
    _quantity("max|e|", "", lambda segment: segment.error_peak),
    _quantity("max|u|", "", lambda segment: segment.control_peak),
    _quantity("Ms", "", lambda segment: segment.ms),
    Column("phase margin", "°", lambda s: number(_phase_margin(s)), _phase_margin, is_share=True),
)
"""Rise from 10 to 90 %, settling to 2 % of the step of the setpoint."""

_LABELS, _GAP = 17, 2  # characters for the names of the quantities, and before each segment


def _percent(value: float) -> str:
    return NOTHING if math.isnan(value) else f"{value:.1f}"


def segment_table(found: Sequence[Segment], width: int = 120) -> str:
    """For a terminal: a column per segment, in as many tables below each other as ``width`` asks for.

    Examples
    --------
    >>> segment_table([], width=80)
    ''
    """
    cell = max((len(column.text(segment)) for column in COLUMNS for segment in found), default=0) + _GAP
    fitting = max(1, (width - _LABELS) // cell)
    return "\n".join(_table(found[i : i + fitting], cell) for i in range(0, len(found), fitting))


def print_segments(found: Sequence[Segment]) -> None:
    """Write the table to stdout, as wide as the terminal."""
    print(segment_table(found, shutil.get_terminal_size().columns))


def _table(found: Sequence[Segment], cell: int) -> str:
    rows = [[f"{column.heading} [{column.unit}]" if column.unit else column.heading,
             *(column.text(segment) for segment in found)] for column in COLUMNS]  # fmt: skip
    lines = [row[0].ljust(_LABELS) + "".join(text.rjust(cell) for text in row[1:]) for row in rows]
    lines.insert(1, "─" * len(lines[0]))
    return "\n".join(lines) + "\n"
