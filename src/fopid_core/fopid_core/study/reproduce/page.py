"""The page that shows the paper and ours side by side."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from importlib import resources

from fopid_core.model.process import TEST_BENCH
from fopid_core.study.reports.page import page
from fopid_core.study.reports.parts import equation, facts, plot
from fopid_core.study.reproduce.drawing import PaperFigure, interactive
from fopid_core.study.reproduce.errata import ERRATA, WORDING, Erratum
from fopid_core.study.reproduce.table import Table, minus_signs
from fopid_core.study.reproduce.time_table import TimeRow, outside

TITLE = "The paper, computed again"

_SOURCE = (
    "S. Das, S. Saha, S. Das, A. Gupta, On the selection of tuning methodology of FOPID controllers for the control of "
    "higher order processes, ISA Transactions 50(3), 2011."
)


@dataclass(frozen=True)
class Reproduction:
    """All that was computed.

    Attributes
    ----------
    claims, conclusions : Table
    tables : tuple of Table
        Tables 1 to 7, each with ours.
    time_rows : tuple of TimeRow
    figures : tuple of PaperFigure
    errata : tuple of Erratum
    """

    claims: Table
    conclusions: Table
    tables: tuple[Table, ...]
    time_rows: tuple[TimeRow, ...]
    figures: tuple[PaperFigure, ...]
    errata: tuple[Erratum, ...] = ERRATA

    @property
    def all_tables(self) -> tuple[Table, ...]:
        """With those of the conclusions."""
        return (self.claims, self.conclusions, *self.tables)


def render(found: Reproduction) -> str:
    """The page as text."""
    drawn = {f"{f.name}-{i}": interactive(panel) for f in found.figures for i, panel in enumerate(f.panels)}
    content = "\n".join(
        (
            _head(found),
            _section("Conclusions", [_table(table) for table in (found.claims, found.conclusions)]),
            _section("Tables", [_table(table) for table in found.tables]),
            _section("Figures", [_figure(figure) for figure in found.figures]),
            _section("Errata", [*(_erratum(i, erratum) for i, erratum in enumerate(found.errata, 1)), _wording()]),
        )
    )
    style = resources.files("fopid_core.study.reproduce").joinpath("page.css").read_text(encoding="utf-8")
    return page(TITLE, content, drawn, style)


def _head(found: Reproduction) -> str:
    rows = found.time_rows
    counts = {
        "rows of Tables 4 to 7": str(len(rows)),
        "whose index GL gives within 2.5 %": str(sum(row.index_reproduced for row in rows)),
        "overshoot to the digit": str(sum(row.overshoot_reproduced for row in rows)),
        "rise time to the digit": str(sum(row.rise_reproduced for row in rows)),
        "beaten by our tuning within their own Ms and control": str(sum(row.beaten for row in rows)),
        "errata": str(len(found.errata)),
    }
    links = " · ".join(
        f'<a href="#{_key(title)}">{title}</a>' for title in ("Conclusions", "Tables", "Figures", "Errata")
    )
    return f"""<header><h1>{TITLE}</h1>
<p class="quiet">{escape(_SOURCE)}</p>
{facts(counts)}
<p>{escape(outside(rows))} The tables and the errata say by how much, and why where we know.</p>
<p>“Exact”: with the fractional powers of s as they are, without approximating process or controller. “GL”: the paper's
way, first-order Grünwald-Letnikov differences in steps of 0.01 s.</p>
{_bench()}
<p class="contents">{links}</p></header>"""


def _bench() -> str:
    return "".join(equation(f"{name[0]}<sub>{name[1]}</sub>", text) for name, text in TEST_BENCH.items())


def _section(title: str, parts: Sequence[str]) -> str:
    return f'<section id="{_key(title)}"><h2>{title}</h2>\n{"".join(parts)}</section>'


def _key(title: str) -> str:
    """Of a section; the page's scripts have names of their own."""
    return f"paper-{title.lower()}"


def _table(table: Table) -> str:
    return f'<h3>{escape(table.title)}</h3><p class="quiet">{escape(table.note)}</p>\n{table.html()}\n'


def _figure(figure: PaperFigure) -> str:
    places = "".join(plot(f"{figure.name}-{i}", panel.title) for i, panel in enumerate(figure.panels))
    return f"""<h3>Figure {figure.number}</h3><p>{escape(figure.caption)}.</p>
<p class="quiet">{escape(minus_signs(figure.remark))}</p>
<div class="plots">{places}</div>
"""


def _erratum(number: int, erratum: Erratum) -> str:
    return f"""<h3>{number}. {escape(erratum.place)}</h3>
<dl><dt>printed</dt><dd>{escape(erratum.printed)}</dd><dt>right</dt><dd>{escape(erratum.right)}</dd>
<dt>check</dt><dd>{escape(minus_signs(erratum.finding.says))}</dd></dl>
"""


def _wording() -> str:
    return "<h3>Slips of wording</h3>" + "".join(f"<p>{escape(text)}</p>" for text in WORDING)
