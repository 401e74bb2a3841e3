"""The verb ``fopid compare``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from fopid_core.cli.options import ARGUMENTS, CANNOT_BE_MET, NewFile, as_json, design_options
from fopid_core.cli.output import emit, jsonable, text, write_file
from fopid_core.cli.progress import progress
from fopid_core.errors import InputError

if TYPE_CHECKING:
    from fopid_core.model.process import Process

COLUMNS = {
    "iae_setpoint": "IAE set", "iae_load": "IAE load", "ms": "Ms", "mt": "Mt", "noise_gain": "noise",
    "overshoot_pct": "over %", "settling_time": "settles", "control_peak": "peak", "total_variation": "moves",
    "overshoot_spread_pct": "spread", "delay_margin": "delay m.", "running_ms": "Ms runs",
}  # fmt: skip
"""Columns of the table for people, by the keys of the rows."""


@click.command("compare", context_settings=ARGUMENTS)
@click.argument("process", required=False)
@click.option("--csv", "record", type=click.Path(path_type=Path), metavar="RECORD", help="Learn the process from it.")
@click.option("--prefer", default="balanced", show_default=True, help="balanced, load, setpoint, robust or quiet.")
@click.option(
    "--worth", type=float, metavar="X", help="What a structure with more numbers must gain; 0.05 if not given."
)
@design_options("ms_max", "mt_max", "noise_max", "u_max", "horizon", "sample_time")
@click.option("--filter-order", type=int, default=2, show_default=True, help="Of the measurement's filter: 0, 1 or 2.")
@click.option("--page", type=NewFile(), metavar="FILE", help="A page with the pictures.")
@as_json
def compare_verb(
    process: str | None, record: Path | None, prefer: str, worth: float | None, page: Path | None, as_json: bool,
    **bounds: Any,
) -> None:  # fmt: skip
    """Every tuning method and structure on one process, under the same bounds, and which to take.

    The noise gain is bounded by 20 over the process's gain when not told otherwise.
    """
    from fopid_core.design.comparison.compare import WORTH, comparison_request
    from fopid_core.design.comparison.compare import compare as compare_all
    from fopid_core.study.comparison_rows import comparison_rows

    request = comparison_request(_process(process, record), **bounds)
    with progress("compare") as told:
        found = compare_all(request, prefer, WORTH if worth is None else worth, told)
    if page is not None:
        from fopid_core.study.reports.comparison_page import comparison_page

        write_file("page", page, comparison_page(request.process, found))
    data = comparison_rows(request.process, found) | {"page": str(page) if page else None}
    if as_json:
        emit(data, [], as_json)
    else:
        _print(data)
    if found.recommended < 0:
        click.get_current_context().exit(CANNOT_BE_MET)


def _process(text: str | None, record: Path | None) -> Process:
    from fopid_core.model.process import read_process

    if (text is None) == (record is None):
        raise InputError("process and --csv; allowed: one of them")
    if text is not None:
        return read_process(text)
    from fopid_core.design.response_verification import to_design_for
    from fopid_core.study.records import read_record

    assert record is not None
    found = to_design_for(read_record(record), str(record))
    assert found.best is not None
    return found.best.process


def _print(data: dict[str, Any]) -> None:
    """The table for people: a star before the one to take, a cross before what breaks a bound."""
    click.echo(f"{data['process']}\n{_bounds(data['bounds'])}\n")
    click.echo(f"  {'method':<31} {'structure':<9} " + " ".join(f"{name:>8}" for name in COLUMNS.values()))
    for i, row in enumerate(jsonable(data["rows"])):
        taken = data["recommended"] is not None and i == data["recommended"]["row"]
        mark = "*" if taken else " " if row["within"] else "x"
        cells = " ".join(f"{_cell(row[name]):>8}" for name in COLUMNS)
        click.echo(
            f"{mark} {row['method']:<31} {row['structure'] or '-':<9} {cells if row['gains'] else row['reason']}"
        )
    taken = data["recommended"]
    click.echo(f"\n* recommended, x breaks a bound.\n{data['reason']}")
    if taken is not None:
        row = data["rows"][taken["row"]]
        for name in ("gains", "filter", "setpoint_weights"):
            click.echo(f"  {name}: " + ", ".join(f"{key} {text(value)}" for key, value in row[name].items()))


def _cell(value: float | None) -> str:
    return "-" if value is None else f"{value:.4g}"


def _bounds(bounds: dict[str, Any]) -> str:
    names = {"ms_max": "Ms", "mt_max": "Mt", "noise_max": "noise gain", "u_max": "control peak"}
    parts = [f"{name} <= {bounds[key]:.4g}" for key, name in names.items() if bounds[key] < float("inf")]
    return f"under {', '.join(parts)}; ticks of {bounds['sample_time']:g} s, steps over {bounds['horizon']:.4g} s"
