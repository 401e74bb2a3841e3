"""``fopid reproduce``: the paper computed again."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

import click

from fopid_core.cli.options import ARGUMENTS, as_json
from fopid_core.cli.output import emit
from fopid_core.cli.progress import progress


@click.command("reproduce", context_settings=ARGUMENTS)
@click.option(
    "--out", type=click.Path(path_type=Path), default=Path("reproduction"), show_default=True, metavar="DIR",
    help="Folder for the page, the tables (CSV), the figures (PNG, SVG) and the errata.",
)  # fmt: skip
@as_json
def reproduce_verb(out: Path, as_json: bool) -> None:
    """Compute every table and figure of the paper, beside what it prints, and say where it errs."""
    from fopid_core.study.reproduce.reproduction import reproduce

    with progress("reproduce") as told:
        written = reproduce(out, told)
    data = {
        "out": str(out),
        "files": {str(path): what for path, what in written.files.items()},
        "claims": [asdict(claim) | {"verdict": claim.verdict} for claim in written.claims],
        "tables": {table.key: table.records() for table in written.found.all_tables},
        "errata": [
            {"key": e.key, "place": e.place, "printed": e.printed, "right": e.right, **asdict(e.finding)}
            for e in written.found.errata
        ],
    }
    rows = {str(path.relative_to(out)): what for path, what in written.files.items() if path.suffix != ".svg"}
    emit(data, [(f"Written to {out} (each figure as .svg, too)", rows)], as_json)
