"""A comparison as programs read it: from the command line, from a page."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from fopid_core.design.comparison.compare import Comparison
from fopid_core.design.comparison.measures import Row
from fopid_core.model.process import Process


def comparison_rows(process: Process, found: Comparison) -> dict[str, Any]:
    """The comparison as the contract has it."""
    rows = [_row(row) for row in found.rows]
    taken = rows[found.recommended] if found.recommended >= 0 else None
    recommended = None
    if taken is not None:
        recommended = {"row": found.recommended, "method": taken["method"], "structure": taken["structure"]}
    bounds = {name: value for name, value in asdict(found.bounds).items() if name not in ("t_max", "s_max")}
    return {
        "process": str(process), "bounds": bounds, "rows": rows, "recommended": recommended, "reason": found.reason,
        "elapsed_s": found.elapsed,
    }  # fmt: skip


def _row(row: Row) -> dict[str, Any]:
    candidate, loop = row.candidate, row.candidate.loop
    values = {name: value for name, value in vars(row).items() if name not in ("candidate", "unmet")}
    return {
        "method": candidate.method,
        "structure": candidate.structure or None,
        "gains": None if loop is None else asdict(loop.controller),
        "filter": None if loop is None else asdict(loop.filter),
        "setpoint_weights": None if loop is None else asdict(loop.weights),
        **values,
        "within": row.is_within,
        "unmet": list(row.unmet),
        "reason": candidate.reason,
    }
