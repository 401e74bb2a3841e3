"""The verb ``fopid front``."""

from __future__ import annotations

import csv
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from fopid_core.cli.options import ARGUMENTS, CANNOT_BE_MET, NewFile, as_json, design_options, process_argument
from fopid_core.cli.output import emit, text
from fopid_core.cli.progress import progress
from fopid_core.errors import InputError

if TYPE_CHECKING:
    from fopid_core.design.front.front import Front

SHOWN = 12
"""Rows of the table for people."""
NUMBERS = ("iae_load", "ms", "mt", "noise_gain")


@click.command("front", context_settings=ARGUMENTS)
@process_argument
@click.option("--structure", default="fopid", show_default=True, help="p, pi, pd, pid, fopi, fopd or fopid.")
@click.option("--points", type=int, default=200, show_default=True, metavar="N", help="Designs asked for.")
@click.option("--ms-min", type=float, default=1.2, show_default=True, metavar="X", help="Smallest bound on max |S|.")
@click.option("--ms-max", type=float, default=2.0, show_default=True, metavar="X", help="Largest bound on max |S|.")
@design_options("mt_max", "noise_max", "horizon", "sample_time")
@click.option("--filter-order", type=int, default=2, show_default=True, help="Of the measurement's filter: 1 or 2.")
@click.option("--plot", type=NewFile(picture=True), metavar="FILE", help="A picture of it.")
@click.option("--csv", "table", type=NewFile(), metavar="FILE", help="All designs, a line each.")
@click.option("--take", type=int, metavar="INDEX", help="Tell all about this design, as parameters of the controller.")
@as_json
def front_verb(
    process: str, plot: Path | None, table: Path | None, take: int | None, as_json: bool, **options: Any
) -> None:
    """The trade-off between load performance, robustness and control effort, as designs none of which beats another.

    Of a load step the IAE, of robustness max |S|, of effort the largest gain from measurement noise to control,
    which is at most 20 over the process's gain without --noise-max.
    """
    from fopid_core.design.front.front import front
    from fopid_core.model.process import read_process

    with progress("front") as told:
        found = front(read_process(process), progress=told, **options)
    if take is not None and not 0 <= take < len(found):
        raise InputError(f"take = {take}; allowed: 0 to {len(found) - 1}")
    taken = None if take is None else _taken(found, take)
    if plot is not None and len(found):
        from fopid_core.cli.plots import plot_front

        plot_front(found, take, plot)
    if table is not None:
        _write(found, table)
    data = {
        "success": len(found) > 0, "message": found.reason, "process": str(found.process),
        "structure": found.structure, "horizon": found.horizon, "points": [_point(found, i) for i in range(len(found))],
        "taken": taken, "elapsed_s": found.elapsed,
    }  # fmt: skip
    if as_json:
        emit(data, [], as_json)
    else:
        _print(found, taken)
    if not len(found):
        click.get_current_context().exit(CANNOT_BE_MET)


def _point(found: Front, index: int) -> dict[str, Any]:
    loop = found.loop(index)
    measures = {name: float(getattr(found, name)[index]) for name in NUMBERS}
    return {
        "gains": asdict(loop.controller), "filter": asdict(loop.filter), **measures,
        "stable": bool(found.stable[index]),
    }  # fmt: skip


def _taken(found: Front, index: int) -> dict[str, Any]:
    """A design as the parameters of the controller's node, and what it does as it runs."""
    from fopid_core.design.sampled_loop import running

    loop = found.loop(index)
    as_it_runs = running(loop.process, loop.controller, found.sample_time, loop.filter)
    filtered = {"measurement_filter_order": loop.filter.order, "measurement_filter_time": loop.filter.time}
    return {
        "index": index, "parameters": {**asdict(loop.controller), **filtered}, **_point(found, index),
        "running": {"stable": as_it_runs.stable, "ms": as_it_runs.ms, "reason": as_it_runs.reason},
    }  # fmt: skip


def _write(found: Front, path: Path) -> None:
    try:
        with path.open("w", newline="", encoding="utf-8") as file:
            lines = csv.writer(file)
            lines.writerow(["kp", "ki", "kd", "lam", "mu", "filter_time", *NUMBERS])
            measures = (getattr(found, name) for name in NUMBERS)
            lines.writerows(zip(*found.gains.T.tolist(), found.filter_time, *measures, strict=True))
    except OSError as error:
        raise InputError(f"csv file {str(path)!r}: {error.strerror}") from None


def _print(found: Front, taken: dict[str, Any] | None) -> None:
    """A few designs for people, all over the trade-off."""
    if not len(found):
        click.echo(found.reason)
        return
    click.echo(f"{found.process}\n{len(found)} designs of structure {found.structure}, load step over "
               f"{found.horizon:.4g} s, {found.elapsed:.3g} s\n")  # fmt: skip
    click.echo(f"{'index':>5} {'IAE load':>9} {'Ms':>7} {'Mt':>7} {'noise':>8}   controller, filter")
    step = max(len(found) // SHOWN, 1)
    for index in range(0, len(found), step):
        cells = " ".join(f"{getattr(found, name)[index]:>{width}.4g}" for name, width in zip(NUMBERS, (9, 7, 7, 8),
                                                                                        strict=True))  # fmt: skip
        loop = found.loop(index)
        click.echo(f"{index:>5} {cells}   {loop.controller}, {loop.filter}")
    if taken is not None:
        click.echo(f"\ntaken: {taken['index']}")
        for name, value in taken["parameters"].items():
            click.echo(f"  {name}: {text(value)}")
        stable = "stable" if taken["running"]["stable"] else f"not known to be stable: {taken['running']['reason']}"
        click.echo(f"  as it runs: {stable}, Ms {text(taken['running']['ms'])}")
