"""Time-domain tuning on the test batch of Astrom and Hagglund: how often it succeeds, and how long it takes."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Iterator

from fopid_core.data import test_batch
from fopid_core.design.tuner import TuningRequest, TuningResult, tune
from fopid_core.model.process import Process
from fopid_core.study.benchmarks.figure import Figure

SPECIFICATIONS = (("itae", 1.6), ("itae", 1.4), ("iae", 1.6), ("iae", 1.4))
"""Index and largest max |S|."""


def batch_figures(every: int = 1, report: Callable[[float, str], None] | None = None) -> list[Figure]:
    """Success rate, median and worst time of tuning every so many-th process for each specification."""
    names = list(test_batch())[::every]
    seconds: list[float] = []
    failed: list[str] = []
    for i, name in enumerate(names):
        if report:
            report(i / len(names), f"test batch, {name}")
        for index, ms_max, result, took in tunings(name):
            seconds.append(took)
            if not result.success:
                failed.append(f"{name} {index} {ms_max:g}")
    rate = 100.0 * (1.0 - len(failed) / len(seconds))
    title = f"tuning of the test batch, {len(names)} processes, ITAE and IAE at Ms 1.4 and 1.6"
    return [
        Figure(f"{title}: success", rate, "%", note=f"not met: {', '.join(failed)}" if failed else ""),
        Figure(f"{title}: median time", statistics.median(seconds), "s"),
        Figure(f"{title}: worst time", max(seconds), "s"),
    ]


def tunings(name: str, seed: int = 0) -> Iterator[tuple[str, float, TuningResult, float]]:
    """Index, bound, result and time [s] of the tunings of one process of the batch."""
    process = Process.parse(test_batch()[name])
    for index, ms_max in SPECIFICATIONS:
        begun = time.perf_counter()
        result = tune(TuningRequest(process, method="time", index=index, ms_max=ms_max, seed=seed))
        yield index, ms_max, result, time.perf_counter() - begun
