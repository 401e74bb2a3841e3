"""How fast a campaign is: many variations at once, and on two processes."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

from fopid_core.model.evaluation import evaluate
from fopid_core.model.fopid import Fopid
from fopid_core.model.loop import Loop
from fopid_core.model.process import read_process
from fopid_core.study.benchmarks.figure import Figure, best_time
from fopid_core.study.campaigns.campaign import Campaign, Design, Range, Variations
from fopid_core.study.campaigns.run import run_campaign
from fopid_core.study.campaigns.varied_loops import measure, varied

GAINS = {"kp": 2.9692, "ki": 0.8028, "kd": 1.3394, "lam": 1.0138, "mu": 0.6074}
"""Of the paper's Table 4, ITAE on P1."""
HORIZON = 50.0
VARIATIONS = Variations(gain=Range(0.5, 2.0, "loguniform"), delay=Range(0.0, 0.2), samples=500)
LONG = 20_000
"""Runs that two processes share: enough for their start not to count."""


def campaign_figures() -> list[Figure]:
    """A run among many beside one by itself, and two processes beside one."""
    process, controller, table = read_process("P1"), Fopid(**GAINS), VARIATIONS.table()
    together = best_time(lambda: measure(process, controller, table, HORIZON, 0.01), 3) / len(table)
    alone = best_time(lambda: evaluate(Loop(varied(process, *table[1].tolist()), controller), HORIZON), 10)
    campaign = Campaign(
        "benchmark", ("P1",), (Design("known", gains=GAINS),), replace(VARIATIONS, samples=LONG), horizon=HORIZON
    )
    with TemporaryDirectory() as folder:
        one, two = (_seconds(campaign, Path(folder, f"{workers}.parquet"), workers) for workers in (1, 2))
    runs = f"campaign of {LONG:,} runs, two processes"
    return [
        Figure("a campaign's run, each of 501 at once", 1e3 * together, "ms", 1e3 * alone, "one at a time, exactly"),
        Figure(runs, two, "s", one, "one process"),
    ]


def _seconds(campaign: Campaign, out: Path, workers: int) -> float:
    begun = time.perf_counter()
    run_campaign(campaign, out, workers)
    return time.perf_counter() - begun
