"""How fast the core is, each figure beside a baseline that is measured in the same run on the same machine."""

from __future__ import annotations

import math
import subprocess
import sys
import time
from collections.abc import Callable

import numpy as np

from fopid_core.design.frequency.tuning import tune_frequency
from fopid_core.design.reduction import reduce_all
from fopid_core.design.specification import Bound, FrequencySpecification
from fopid_core.design.time.objectives import Objective
from fopid_core.design.time.problem import TimeProblem
from fopid_core.design.time.search_response import ResponseGrid
from fopid_core.design.time.specification import TimeSpecification
from fopid_core.design.time.tuning import tune_time
from fopid_core.model.fopid import Fopid
from fopid_core.model.indices import indices
from fopid_core.model.loop import Loop
from fopid_core.model.process import TEST_BENCH, Process, read_process
from fopid_core.model.response import step_response
from fopid_core.model.stability import stability, stable_mask
from fopid_core.study.benchmarks.batch import batch_figures
from fopid_core.study.benchmarks.comparison import comparison_figures
from fopid_core.study.benchmarks.figure import Figure, best_time
from fopid_core.study.benchmarks.limit import limit_figures

GAINS = (2.9692, 0.8028, 1.3394, 1.0138, 0.6074)
"""Of the paper's Table 4, ITAE on P1."""
HORIZON = 50.0
POINTS = 256
"""Steps of a response that has the index right to 0.1 %."""
MS_MAX, U_MAX, SAMPLE_TIME = 1.6, 20.0, 0.01


def benchmark(report: Callable[[float, str], None] | None = None, with_baseline_tuning: bool = True) -> list[Figure]:
    """Measure everything.

    Parameters
    ----------
    report : callable, optional
        Called with the share done and what is being measured.
    with_baseline_tuning : bool
        Whether the baseline's tuning is measured too; it takes most of the time.
    """
    parts: list[Callable[[], list[Figure]]] = [
        _tick,
        _response,
        lambda: _tuning(with_baseline_tuning),
        _other_tunings,
        lambda: _identification(with_baseline_tuning),
        _stability,
        _growth_with_horizon,
        _growth_with_order,
        _growth_with_candidates,
        lambda: batch_figures(every=1 if with_baseline_tuning else 16),
        lambda: comparison_figures(with_baseline_tuning),
        limit_figures,
        _campaign,
        _import_time,
    ]
    figures: list[Figure] = []
    for i, part in enumerate(parts):
        if report:
            report(i / len(parts), f"{len(figures)} figures measured")
        figures += part()
    return figures


def _tick() -> list[Figure]:
    """What the running controller takes of a processor."""
    from fopid_core.study.benchmarks.tick import SAMPLES, tick_times

    us = {name: 1e6 * took for name, took in tick_times(Fopid(*GAINS), SAMPLE_TIME).items()}
    full = f"full memory of {SAMPLES:,} samples"
    return [
        Figure("tick of the controller", us["within"], "us", us["simple-pid"], "simple-pid", "asked for: 0.33 times"),
        Figure("tick of the controller at a limit", us["at limit"], "us", us["simple-pid"], "simple-pid"),
        Figure("tick of the controller beside brute force", us["within"], "us", us["full memory"], full),
    ]


def _response() -> list[Figure]:
    """One closed-loop response with its index, at the accuracy that a search needs."""
    import control

    from fopid_core.study.benchmarks.baseline import itae

    exact_response = step_response(Loop(read_process("P1"), Fopid(*GAINS)), HORIZON)
    exact = indices(exact_response.time, exact_response.error).itae
    grid = ResponseGrid(read_process("P1"), HORIZON, POINTS, speed=0.85)
    gains = np.array([GAINS])
    trapezoid_of_t = grid.time * grid.time[1]

    def ours() -> float:
        return float(np.abs(grid.errors(gains)[0]) @ trapezoid_of_t)

    process = control.ss(control.tf([1.0], [1.0, 3.0, 3.0, 1.0]))
    spectrum = np.fft.rfft(np.random.default_rng(0).standard_normal(2 * POINTS))
    took, bare = best_time(ours, 500), best_time(lambda: np.fft.irfft(spectrum), 500)
    off, baseline_off = ours() / exact - 1.0, itae(process, GAINS, HORIZON) / exact - 1.0
    note = f"index off by {off:+.3%}, the baseline's by {baseline_off:+.3%}"
    baseline = best_time(lambda: itae(process, GAINS, HORIZON), 10)
    return [
        Figure("response with ITAE, P1, 50 s", 1e6 * took, "us", 1e6 * baseline, "python-control, Oustaloup", note),
        Figure("the same beside a bare FFT of its length", 1e6 * took, "us", 1e6 * bare, "numpy irfft"),
    ]


def _specification() -> TimeSpecification:
    return TimeSpecification(Objective.of("itae", {}), HORIZON, MS_MAX, U_MAX, sample_time=SAMPLE_TIME)


def _exact_itae(gains: tuple[float, ...]) -> float:
    response = step_response(Loop(read_process("P1"), Fopid(*gains)), HORIZON)
    return indices(response.time, response.error).itae


def _tuning(with_baseline: bool) -> list[Figure]:
    """A whole ITAE tuning of P1 under bounds on max |S| and on the control's peak."""
    process = read_process("P1")
    found = tune_time(process, _specification())
    assert found is not None
    took = best_time(lambda: tune_time(process, _specification()), 5)
    note = f"ITAE {_exact_itae(found.controller.gains):.4f}"
    if not with_baseline:
        return [Figure("ITAE tuning of P1", took, "s", note=note)]
    import control

    from fopid_core.study.benchmarks.baseline import tune_itae

    plant = control.ss(control.tf([1.0], [1.0, 3.0, 3.0, 1.0]))
    begun = time.perf_counter()
    gains, responses = tune_itae(plant, HORIZON, MS_MAX, U_MAX, SAMPLE_TIME, start=(1.0, 0.3, 0.1, 1.0, 0.9))
    baseline = time.perf_counter() - begun
    note += f", the baseline's {_exact_itae(tuple(float(g) for g in gains)):.4f} after {responses} evaluations"
    return [Figure("ITAE tuning of P1", took, "s", baseline, "scipy Nelder-Mead on python-control", note)]


def _other_tunings() -> list[Figure]:
    """The slowest of the four processes of the test bench."""
    crossovers = {"P1": 0.3, "P2": 1.0, "P3": 0.1, "P4": 1.0}
    frequency, time_domain, reduction = [], [], []
    for name in TEST_BENCH:
        process = read_process(name)
        asked = FrequencySpecification(math.radians(80.0), crossovers[name], Bound(-40.0, 10.0), Bound(-40.0, 0.01))
        frequency.append(best_time(lambda p=process, a=asked: tune_frequency(p, a), 10))  # type: ignore[misc]
        time_domain.append(best_time(lambda p=process: tune_time(p, _specification()), 3))  # type: ignore[misc]
        models = reduce_all(process)
        reduction.append(max(model.elapsed for model in models))
    return [
        Figure("frequency-domain tuning, slowest of P1 to P4", 1e3 * max(frequency), "ms"),
        Figure("ITAE tuning, slowest of P1 to P4", max(time_domain), "s"),
        Figure("model reduction, slowest of P1 to P4 and templates", max(reduction), "s"),
    ]


def _identification(with_baseline: bool) -> list[Figure]:
    """P1 learnt from a noisy step of 5,000 samples."""
    from fopid_core.design.identification.identify import identify
    from fopid_core.study.benchmarks.identification import SAMPLES, compare, step_record

    name = f"identification from {SAMPLES:,} samples"
    if not with_baseline:
        record = step_record()
        return [Figure(name, best_time(lambda: identify(record, "nioptd2"), 5), "s", note="NIOPTD-II")]
    found = compare()
    note = f"error {found.error:.4f}, the baseline's {found.baseline_error:.4f} after {found.simulations} simulations"
    return [
        Figure(f"{name}, NIOPTD-II", found.ours, "s", found.baseline, "scipy curve_fit, time-stepped", note),
        Figure(f"{name}, all templates", found.every, "s"),
    ]


def _stability() -> list[Figure]:
    loop = Loop(read_process("P1"), Fopid(*GAINS))
    rows = np.array(GAINS) * np.random.default_rng(0).uniform(0.5, 1.5, size=(256, 5))
    rows[:, 3:] = np.clip(rows[:, 3:], 0.1, 1.9)
    one = best_time(lambda: stability(loop), 100)
    many = best_time(lambda: stable_mask(loop.process, rows), 10) / len(rows)
    return [Figure("stability verdict, each of 256 at once", 1e6 * many, "us", 1e6 * one, "one at a time")]


def _growth_with_horizon() -> list[Figure]:
    rows = []
    for horizon in (25.0, 50.0, 100.0, 200.0):
        problem = TimeProblem(read_process("P1"), TimeSpecification(Objective.of("itae", {}), horizon, MS_MAX, U_MAX))
        took = best_time(lambda p=problem: p.cost_and_slack(np.array([GAINS])), 50)  # type: ignore[misc]
        rows.append(Figure(f"cost and bounds, horizon {horizon:g} s", 1e6 * took, "us", note=f"{problem.points} steps"))
    return rows


def _growth_with_order() -> list[Figure]:
    rows = []
    for order in (2, 4, 8, 16):
        problem = TimeProblem(Process.parse(f"1/(s+1)^{order}"), _specification())
        took = best_time(lambda p=problem: p.cost_and_slack(np.array([GAINS])), 50)  # type: ignore[misc]
        rows.append(Figure(f"cost and bounds, process of order {order}", 1e6 * took, "us"))
    return rows


def _growth_with_candidates() -> list[Figure]:
    problem = TimeProblem(read_process("P1"), _specification())
    alone = best_time(lambda: problem.cost_and_slack(np.array([GAINS])), 100)
    rows = []
    for count in (8, 64, 512):
        batch = np.repeat(np.array([GAINS]), count, axis=0)
        each = best_time(lambda b=batch: problem.cost_and_slack(b), 10) / count  # type: ignore[misc]
        rows.append(Figure(f"cost and bounds, each of {count} at once", 1e6 * each, "us", 1e6 * alone, "one at a time"))
    return rows


def _campaign() -> list[Figure]:
    from fopid_core.study.benchmarks.campaign import campaign_figures  # it builds on this module

    return campaign_figures()


def _import_time() -> list[Figure]:
    def seconds(module: str) -> float:
        code = f"import time; t = time.perf_counter(); import {module}; print(time.perf_counter() - t)"
        command = [sys.executable, "-c", code]
        return min(float(subprocess.run(command, check=True, capture_output=True).stdout) for _ in range(3))

    tuner, control = seconds("fopid_core.design.tuner"), seconds("control")
    return [
        Figure("import of fopid_core", seconds("fopid_core"), "s"),
        Figure("import of the tuner", tuner, "s", control, "import of python-control"),
    ]
