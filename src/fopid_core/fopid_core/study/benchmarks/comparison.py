"""How long the comparison of all methods and a whole trade-off take, beside one design by python-control and scipy."""

from __future__ import annotations

import time

import control
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from fopid_core.design.comparison.compare import compare, comparison_request
from fopid_core.design.front.front import front
from fopid_core.model.process import TEST_BENCH, read_process
from fopid_core.study.benchmarks.figure import Figure

MS_MAX, NOISE_MAX, HORIZON = 1.6, 20.0, 47.0
EVALUATIONS = 300


def comparison_figures(with_baseline: bool = True) -> list[Figure]:
    """Processor time, which a busy machine does not stretch."""
    took = {}
    for name in TEST_BENCH if with_baseline else ("P1",):
        begun = time.process_time()
        found = compare(comparison_request(read_process(name)))
        took[name] = time.process_time() - begun
    slowest = max(took, key=lambda name: took[name])
    note = f"{len(found.rows)} designs; slowest {slowest}"
    names = "comparison of all methods", "trade-off of 200 designs, PID on P1", "each of those designs"
    begun = time.process_time()
    trade_off = front(read_process("P1"), "pid")
    whole = time.process_time() - begun
    each = whole / len(trade_off)
    if not with_baseline:
        return [Figure(names[0], took[slowest], "s", note=note), Figure(names[1], whole, "s")]
    baseline, index = _baseline()
    of = "one PID by python-control"
    note += f"; the baseline is one PID with filter for the load of P1, IAE {index:.3f}"
    near = trade_off.best(ms_max=MS_MAX * 1.001, noise_max=NOISE_MAX * 1.001)
    ours = f"the nearest to the baseline's bounds has IAE {trade_off.iae_load[near]:.3f}"
    return [
        Figure(names[0], took[slowest], "s", baseline, of, note),
        Figure(names[1], whole, "s"),
        Figure(names[2], 1e3 * each, "ms", 1e3 * baseline, of, ours),
    ]


def _baseline() -> tuple[float, float]:
    """Nelder and Mead on python-control: the least load IAE of a filtered PID under Ms and noise gain, and its time."""
    begun = time.process_time()
    w = np.geomspace(1e-3, 314.0, 400)
    s, instants, lag = control.tf("s"), np.linspace(0.0, HORIZON, 1001), control.tf([1.0], [1.0, 3.0, 3.0, 1.0])

    def cost(x: NDArray[np.float64]) -> float:
        kp, ki, kd, slow = np.exp(x)
        controller = (kp + ki / s + kd * s) / (1 + slow * s + 0.5 * slow**2 * s * s)
        opened, alone = (lag * controller)(1j * w), controller(1j * w)
        ms, noise = np.abs(1 / (1 + opened)).max(), np.abs(alone / (1 + opened)).max()
        broken = float(max(ms / MS_MAX, noise / NOISE_MAX, 1.0))
        closed = control.minreal(control.feedback(lag, controller), 1e-6, verbose=False)
        if closed.poles().real.max() >= 0.0:
            return 1e3
        output = control.step_response(closed, instants).outputs
        return float(np.abs(output).sum() * instants[1]) * (1.0 + 30.0 * (broken - 1.0))

    found = minimize(cost, np.log([1.0, 0.4, 0.5, 0.1]), method="Nelder-Mead", options={"maxfev": EVALUATIONS})
    return time.process_time() - begun, float(found.fun)
