"""Columns of a survey's results: a row for each controller on each process."""

from __future__ import annotations

import pyarrow as pa

STRUCTURES = ("pi", "pid", "fopi", "fopid")
HIGH_ORDER = "high order"
CONTROLLERS = (*STRUCTURES, HIGH_ORDER)

NUMBERS = (
    "speed", "process_gain", "horizon", "sample_time", "kp", "ki", "kd", "lam", "mu", "filter_time", "iae_load", "ms",
    "mt", "noise_gain", "final_error", "iae_again", "running_ms", "running_iae", "elapsed_s",
)  # fmt: skip

SCHEMA = pa.schema(
    [
        ("case", pa.int64()), ("kind", pa.string()), ("process", pa.string()), ("controller", pa.string()),
        ("status", pa.string()), ("reason", pa.string()), ("running_stable", pa.bool_()),
        *((name, pa.float64()) for name in NUMBERS),
    ]
)  # fmt: skip
"""``speed`` is about the fastest crossover [rad/s]; ``iae_again`` the least IAE that a second search found;
``running_`` what the sampled, held loop does. ``status``: ok, a bound broken, no design, failed, left out."""
