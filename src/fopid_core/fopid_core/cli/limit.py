"""The verb ``fopid limit``."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import click

from fopid_core.cli.options import ARGUMENTS, as_json, design_options, process_argument
from fopid_core.cli.output import emit
from fopid_core.cli.progress import progress
from fopid_core.errors import InputError

if TYPE_CHECKING:
    from fopid_core.design.limit.limit import Limit
    from fopid_core.model.process import Process


@click.command("limit", context_settings=ARGUMENTS)
@process_argument
@click.option("--index", default="iae", show_default=True, help="iae or ise.")
@click.option("--input", default="load", show_default=True, help="The unit step: load or setpoint.")
@design_options("ms_max", "mt_max", "noise_max", "sample_time", "horizon")
@click.option("--cells", type=int, default=160, show_default=True, help="Of the grid: more of them, a higher bound.")
@click.option("--one-degree", is_flag=True, help="For a setpoint: of controllers that see nothing but the error.")
@click.option(
    "--compare", "with_designs", is_flag=True, help="Also how far every design of fopid compare stays from it."
)
@as_json
def limit_verb(process: str, with_designs: bool, as_json: bool, **asked: Any) -> None:
    """The best index that any linear controller can reach: a lower bound, with what a finer grid may add to it.

    The gain from measurement noise to control is at most 20 over the process's gain without --noise-max.
    """
    from fopid_core.design.limit.limit import limit
    from fopid_core.model.process import read_process

    if with_designs and (asked["index"] != "iae" or asked["one_degree"]):
        raise InputError("--compare; allowed: with --index iae and two degrees of freedom")
    read = read_process(process)
    found = limit(read, **asked)
    data = {"process": str(read), **{name: value for name, value in asdict(found).items() if name != "elapsed"}}
    data["elapsed_s"] = found.elapsed
    sections = [("Limit of all linear controllers", dict(data))]
    if with_designs:
        data["rows"] = _rows(read, found, asked["sample_time"])
        named = {
            f"{row['structure']}, {row['method']}": f"{row['value']:.4g}, {row['times']:.3g} times"
            for row in data["rows"]
        }
        sections.append(("Designs within the bounds", named))
    emit(data, sections, as_json)


def _rows(process: Process, found: Limit, sample_time: float) -> list[dict[str, Any]]:
    """Designs that keep the same bounds, best first, and how many times the limit they are."""
    from fopid_core.design.comparison.compare import compare, comparison_request

    bounds = {name: getattr(found, name) for name in ("ms_max", "mt_max", "noise_max")}
    with progress("compare") as told:
        rows = compare(comparison_request(process, sample_time=sample_time, **bounds), progress=told).rows
    kept = [(row.candidate, getattr(row, f"iae_{found.input}")) for row in rows if row.is_within]
    return [
        {
            "method": one.method,
            "structure": one.structure,
            "value": value,
            "times": value / found.bound if found.bound else None,
        }
        for one, value in sorted(kept, key=lambda pair: pair[1])
    ]
