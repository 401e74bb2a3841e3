"""A table with named columns: as HTML for the page, as CSV, as records for JSON."""

from __future__ import annotations

import csv
import io
import math
import re
from dataclasses import dataclass
from html import escape

from fopid_core.study.reports.segment_table import number

Cell = str | float


@dataclass(frozen=True)
class Column:
    """A quantity.

    Attributes
    ----------
    heading, unit : str
    form : str
        How its numbers are written on the page, such as ``.2f``; without one it holds words.
    under : bool
        Whether its words stand in a line of their own below the row.
    """

    heading: str
    unit: str = ""
    form: str = ""
    under: bool = False

    @property
    def name(self) -> str:
        """Heading and unit in one.

        Examples
        --------
        >>> Column("rise time", "s").name
        'rise time [s]'
        """
        return f"{self.heading} [{self.unit}]" if self.unit else self.heading


@dataclass(frozen=True)
class Table:
    """Rows of cells, one for each column.

    Attributes
    ----------
    key : str
        Name of its file.
    title, note : str
        Above it.
    columns : tuple of Column
    rows : tuple of tuple of str or float
    """

    key: str
    title: str
    note: str
    columns: tuple[Column, ...]
    rows: tuple[tuple[Cell, ...], ...]

    def records(self) -> list[dict[str, Cell]]:
        """Each row by the names of its columns."""
        names = [column.name for column in self.columns]
        return [dict(zip(names, row, strict=True)) for row in self.rows]

    def csv(self) -> str:
        r"""Comma-separated, the names of the columns first.

        Examples
        --------
        >>> Table("t", "", "", (Column("a", "s", ".1f"), Column("b")), ((1.5, "x, y"),)).csv()
        'a [s],b\n1.5,"x, y"\n'
        """
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow([column.name for column in self.columns])
        writer.writerows([[f"{cell:.10g}" if isinstance(cell, float) else cell for cell in row] for row in self.rows])
        return text.getvalue()

    def html(self) -> str:
        """The table alone, without title and note."""
        heads = "".join(_head(column) for column in self.columns if not column.under)
        body = "\n".join(self._row(row) for row in self.rows)
        return f'<div class="scroll"><table><thead><tr>{heads}</tr></thead>\n<tbody>{body}</tbody></table></div>'

    def _row(self, row: tuple[Cell, ...]) -> str:
        cells = list(zip(self.columns, row, strict=True))
        beside = "".join(_cell(cell, column) for column, cell in cells if not column.under)
        under = [(column, str(cell)) for column, cell in cells if column.under]
        if not under:
            return f"<tr>{beside}</tr>"
        span = len(self.columns) - len(under)
        below = [_line("" if len(under) == 1 else column.heading, text) for column, text in under]
        return (
            f'<tr class="over">{beside}</tr>\n'
            f'<tr><td class="words under" colspan="{span}"><div>{"".join(below)}</div></td></tr>'
        )


def minus_signs(text: str) -> str:
    """Numbers with a real minus sign.

    Examples
    --------
    >>> minus_signs("from -3 to 5e-2 (-1.5)")
    'from −3 to 5e-2 (−1.5)'
    """
    return re.sub(r"(?<![\w.)])-(?=\d)", "−", text)


def percent(share: float, form: str) -> str:
    """A share in per cent.

    Examples
    --------
    >>> percent(0.0123, "+.1f")
    '+1.2 %'
    """
    return f"{100.0 * share:{form}} %"


def _head(column: Column) -> str:
    small = f"<small>{escape(column.unit)}</small>" if column.unit else ""
    return f"<th{'' if column.form else ' class=words'}>{escape(column.heading)}{small}</th>"


def _cell(cell: Cell, column: Column) -> str:
    if isinstance(cell, str):
        return f"<td class=words>{escape(minus_signs(cell))}</td>"
    shown = format(cell, column.form) if math.isfinite(cell) else number(cell)
    return f"<td>{minus_signs(shown)}</td>"


def _line(heading: str, text: str) -> str:
    name = f"<span>{escape(heading)}</span> " if heading else ""
    return f"<p>{name}{escape(minus_signs(text))}</p>"
