"""Columns of a campaign's results: first what went in, then the controller, then what came out."""

from __future__ import annotations

import pyarrow as pa

from fopid_core.study.experiments.loop_parameters import GAINS

VARIED = ("gain", "time_scale", "delay")
"""Columns of a table of variations: g [-], t [-], d [s]."""

MEASURES = (
    "ms", "mt", "phase_margin_deg", "crossover", "gain_margin_db", "iae", "ise", "itae", "itse", "overshoot_pct",
    "rise_time", "settling_time", "control_peak",
)  # fmt: skip

SPECIFICATION = (
    "method", "phase_margin_deg", "crossover", "t_max_db", "t_max_frequency", "s_max_db", "s_max_frequency", "index",
    "ms_max", "u_max", "horizon", "via", "rule",
)  # fmt: skip
"""What the tuner is asked; a campaign's loops have five gains, no filter and no free setpoint weights."""

_WORDS = ("method", "index", "via", "rule")

SCHEMA = pa.schema(
    [
        ("run", pa.int64()), ("process", pa.string()), ("design", pa.string()), ("variation", pa.int64()),
        *((name, pa.float64()) for name in VARIED),
        *((name if name == "method" else f"asked_{name}", pa.string() if name in _WORDS else pa.float64())
          for name in SPECIFICATION),
        *((name, pa.float64()) for name in GAINS),
        ("met", pa.bool_()), ("unmet", pa.string()), ("step_horizon", pa.float64()),
        ("status", pa.string()), ("reason", pa.string()), ("stable", pa.bool_()),
        *((name, pa.float64()) for name in MEASURES),
    ]
)  # fmt: skip
"""All of them; nothing where a run has none."""
