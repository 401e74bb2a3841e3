"""How long the limit of all linear controllers takes, beside the solver alone."""

from __future__ import annotations

import time

from fopid_core.design.limit.limit import limit
from fopid_core.model.process import read_process
from fopid_core.study.benchmarks.figure import Figure


def limit_figures() -> list[Figure]:
    """Of P1: both grids, with the program built by cvxpy and the bound proved anew."""
    begun = time.perf_counter()
    found = limit(read_process("P1"), mt_max=1.6)
    took = time.perf_counter() - begun
    note = f"bound {found.bound:.3f}, resolution error {found.resolution_error:.3f}"
    return [Figure("limit of all linear controllers, P1", took, "s", found.solver_time, "Clarabel alone", note)]
