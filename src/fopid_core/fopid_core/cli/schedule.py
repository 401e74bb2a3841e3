"""The verb ``fopid schedule``: whether a table of gains is sound at its points and on the way between them."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from fopid_core.cli.options import ARGUMENTS, CANNOT_BE_MET, as_json
from fopid_core.cli.output import emit

if TYPE_CHECKING:
    from fopid_core.design.schedule import ScheduleCheck


@click.command("schedule", context_settings=ARGUMENTS)
@click.argument("file", type=click.Path(path_type=Path))
@as_json
def schedule_verb(file: Path, as_json: bool) -> None:
    """Check the table of gains in FILE on the process that stands in it.

    Each operating point is checked exactly; the way between two is cut until no loop on it can be unstable or break the
    bounds, or one does. All of this is for a scheduling variable that moves slowly beside the loop.
    """
    from fopid_core.design.schedule import check_schedule
    from fopid_core.errors import InputError
    from fopid_core.runtime.schedule import read_schedule

    began = time.perf_counter()
    schedule, content = read_schedule(file)
    try:
        found = check_schedule(schedule, content)
    except InputError as error:
        raise InputError(f"schedule {str(file)!r}: {error}") from None
    data = {
        "success": not found.unmet,
        "variable": schedule.variable,
        "points": _points(found),
        "ways": [
            {"first": way.first, "last": way.last, "stable": way.stable, "ms": way.ms, "mt": way.mt,
             "checked": way.checked}
            for way in found.ways
        ],
        "unmet": list(found.unmet),
        "elapsed_s": time.perf_counter() - began,
    }  # fmt: skip
    emit(data, _tables(data), as_json)
    if found.unmet:
        click.get_current_context().exit(CANNOT_BE_MET)


def _points(found: ScheduleCheck) -> list[dict[str, Any]]:
    rows = []
    for k, point in enumerate(found.points):
        gains = dict(zip(("kp", "ki", "kd", "lam", "mu"), point.loop.controller.gains, strict=True))
        row = {"at": point.at, "process": str(point.loop.process), "gains": gains, "stable": point.stable,
               "ms": point.ms, "mt": point.mt}  # fmt: skip
        if found.running:
            row["running"] = {"stable": found.running[k].stable, "ms": found.running[k].ms}
        rows.append(row)
    return rows


def _tables(data: dict[str, Any]) -> list[tuple[str, dict[str, Any]]]:
    """What people see."""
    known = {True: "stable", False: "unstable", None: "not known"}
    points = {
        f"{row['at']:g}": f"{known[row['stable']]}, max |S| {row['ms']:.4g}, max |T| {row['mt']:.4g}"
        + (
            f"; sampled: {known[row['running']['stable']]}, max |S| {row['running']['ms']:.4g}"
            if "running" in row
            else ""
        )
        for row in data["points"]
    }
    ways = {
        f"{row['first']:g} to {row['last']:g}": f"{known[row['stable']]}, max |S| below {row['ms']:.4g}, "
        f"max |T| below {row['mt']:.4g} ({row['checked']} loops)"
        for row in data["ways"]
    }
    end = {"success": data["success"], "unmet": "; ".join(data["unmet"]) or None}
    return [(f"Points of {data['variable'] or 'the variable'}", points), ("On the way", ways), ("Result", end)]
