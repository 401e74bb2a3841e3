"""All of it: compute, write the page, the tables as CSV, the figures as PNG and SVG, and the errata."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from fopid_core.errors import InputError
from fopid_core.study.reproduce.claims import Claim, claims, claims_table
from fopid_core.study.reproduce.conclusions import figures_table, our_pairs, printed_pairs
from fopid_core.study.reproduce.drawing import PaperFigure, write_files
from fopid_core.study.reproduce.errata import ERRATA, errata_markdown
from fopid_core.study.reproduce.facts import PROCESSES, printed_designs, printed_models, printed_tunings
from fopid_core.study.reproduce.frequency_figures import figure_1, figure_8
from fopid_core.study.reproduce.frequency_table import OurDesign, our_designs, our_table, printed_table
from fopid_core.study.reproduce.load_figures import figure_9, figure_10
from fopid_core.study.reproduce.model_table import model_row, model_table
from fopid_core.study.reproduce.page import Reproduction, render
from fopid_core.study.reproduce.table import Table
from fopid_core.study.reproduce.time_figures import figure_2, figure_7, index_figure
from fopid_core.study.reproduce.time_table import TimeRow, compared_table, time_row, tuned_table

Progress = Callable[[float, str], None]
"""Called with the share of the work done, 0 to 1, and what is being done."""

FIRST_TABLE = 4
"""Of the time-domain tables: one for each process."""
FIGURES: tuple[Callable[[], PaperFigure], ...] = (
    figure_1,
    figure_2,
    *(lambda n=n, p=p: index_figure(n, p) for n, p in enumerate(PROCESSES, 3)),
    figure_7,
    figure_8,
    figure_9,
    figure_10,
)


@dataclass(frozen=True)
class Written:
    """What was computed and the files that hold it, each with what it is."""

    found: Reproduction
    claims: tuple[Claim, ...]
    files: dict[Path, str]


class _Steps:
    """Counts the steps that are done."""

    def __init__(self, report: Progress | None, total: int) -> None:
        self._report, self._total, self._done = report, total, 0

    def begin(self, what: str) -> None:
        """Say what is being done; what was begun before is done."""
        if self._report:
            self._report(self._done / self._total, what)
        self._done += 1


def reproduce(out: Path, report: Progress | None = None) -> Written:
    """Compute the whole paper and write everything to a folder.

    Parameters
    ----------
    out : Path
        Made when it does not exist: the page ``index.html``, ``tables/*.csv``, ``figures/*.png`` and ``.svg``,
        ``errata.md``.
    report : callable, optional

    Raises
    ------
    InputError
        If a file cannot be written.
    """
    rows = len(printed_models()) + len(printed_designs()) + len(printed_tunings())
    steps = _Steps(report, rows + 3 + 2 * len(FIGURES) + len(ERRATA))
    try:
        (out / "tables").mkdir(parents=True, exist_ok=True)
        (out / "figures").mkdir(exist_ok=True)
        found, decided = _compute(steps)
        return Written(found, decided, _write(found, out, steps))
    except OSError as error:
        raise InputError(f"out = {str(out)!r} cannot be written: {error.strerror}; allowed: a folder") from None


def _compute(steps: _Steps) -> tuple[Reproduction, tuple[Claim, ...]]:
    tables = [*_model_tables(steps), *_frequency_tables(steps)]
    time_rows = _time_rows(steps)
    for number, process in enumerate(PROCESSES, FIRST_TABLE):
        rows = tuple(row for row in time_rows if row.printed.process == process)
        tables += [compared_table(number, rows), tuned_table(number, rows)]
    steps.begin("conclusions: the paper's designs")
    printed = printed_pairs()
    steps.begin("conclusions: our designs")
    ours = our_pairs()
    steps.begin("conclusions: which hold")
    decided = claims(printed, ours)
    drawn = tuple(_figure(number, draw, steps) for number, draw in enumerate(FIGURES, 1))
    for erratum in ERRATA:
        steps.begin(f"erratum {erratum.key}")
        erratum.finding  # noqa: B018  (kept by the erratum)
    found = Reproduction(claims_table(decided), figures_table(printed, ours), tuple(tables), time_rows, drawn)
    return found, decided


def _model_tables(steps: _Steps) -> list[Table]:
    rows = []
    for printed in printed_models():
        steps.begin(f"Table 1: {printed.process}, {printed.title}")
        rows.append(model_row(printed))
    return [model_table(tuple(rows))]


def _frequency_tables(steps: _Steps) -> list[Table]:
    designs: list[OurDesign] = []
    for printed in printed_designs():
        steps.begin(f"Table 3: {printed.process}")
        designs += our_designs(printed)
    return [printed_table(), our_table(tuple(designs))]


def _time_rows(steps: _Steps) -> tuple[TimeRow, ...]:
    rows = []
    for printed in printed_tunings():
        steps.begin(f"Tables 4 to 7: {printed.process}, {printed.index}")
        rows.append(time_row(printed))
    return tuple(rows)


def _figure(number: int, draw: Callable[[], PaperFigure], steps: _Steps) -> PaperFigure:
    steps.begin(f"Figure {number}")
    return draw()


def _write(found: Reproduction, out: Path, steps: _Steps) -> dict[Path, str]:
    files = {out / "index.html": "the page", out / "errata.md": "errata"}
    (out / "index.html").write_text(render(found), encoding="utf-8")
    (out / "errata.md").write_text(errata_markdown(found.errata), encoding="utf-8")
    for table in found.all_tables:
        path = out / "tables" / f"{table.key}.csv"
        path.write_text(table.csv(), encoding="utf-8")
        files[path] = table.title
    for figure in found.figures:
        steps.begin(f"files of figure {figure.number}")
        files |= dict.fromkeys(write_files(figure, out / "figures"), f"Figure {figure.number}")
    return files
