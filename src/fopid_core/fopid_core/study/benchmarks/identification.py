"""How fast a process is learnt, beside the program that a user of scipy would write."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import curve_fit
from scipy.signal import lsim

from fopid_core.design.identification.identify import identify
from fopid_core.design.identification.record import Record

Real = NDArray[np.float64]

SAMPLES, SAMPLE_TIME, NOISE = 5000, 0.005, 0.02
PROCESS = ([1.0], [1.0, 3.0, 3.0, 1.0])
"""P1."""
START = (1.0, 1.0, 1.0, 1.9, 1.0, 0.1)


def step_record() -> Record:
    """A step of P1 after a fifth of the record, with noise, by scipy."""
    t: Real = SAMPLE_TIME * np.arange(SAMPLES, dtype=np.float64)
    u = (t >= t[SAMPLES // 5]).astype(float)
    # scipy takes the input as linear between samples, we as held: the step is half a sample late
    y: Real = lsim(PROCESS, u, t)[1] + NOISE * np.random.default_rng(0).standard_normal(SAMPLES)
    return Record(t, u, y)


def differences(order: float, count: int) -> Real:
    """(-1)^j binomial(order, j)."""
    return np.concatenate([[1.0], np.cumprod(1.0 - (order + 1.0) / np.arange(1, count))])


def simulate(t: Real, u: Real, K: float, a1: float, a0: float, alpha: float, beta: float, L: float) -> Real:
    """K e^(-L s) / (s^alpha + a1 s^beta + a0), sample by sample (Gruenwald and Letnikov)."""
    h, y = t[1] - t[0], np.zeros(t.size)
    first, second = differences(alpha, t.size) / h**alpha, a1 * differences(beta, t.size) / h**beta
    delayed = np.interp(t - L, t, u, left=0.0)
    for k in range(1, t.size):
        past = y[k - 1 :: -1]
        y[k] = (K * delayed[k] - first[1 : k + 1] @ past - second[1 : k + 1] @ past) / (first[0] + second[0] + a0)
    return y


def curve_fit_nioptd2(record: Record) -> tuple[Real, int]:
    """The six numbers, and how many simulations they took."""
    calls = 0

    def model(t: Real, *numbers: float) -> Real:
        nonlocal calls
        calls += 1
        return simulate(t, record.control, *numbers)

    bounds = ([0.0, 0.0, 0.0, 1.0, 0.1, 0.0], [100.0, 100.0, 100.0, 3.0, 2.0, 10.0])
    found, _ = curve_fit(model, record.time, record.measurement, p0=START, bounds=bounds)
    return found, calls


@dataclass(frozen=True)
class Comparison:
    """Seconds for NIOPTD-II, for all templates, and of the baseline for NIOPTD-II; errors of both; simulations."""

    ours: float
    every: float
    baseline: float
    error: float
    baseline_error: float
    simulations: int


def compare() -> Comparison:
    """Learn P1 from a noisy step, both ways."""
    record = step_record()
    ours = min(_took(lambda: identify(record, "nioptd2")) for _ in range(5))
    every = min(_took(lambda: identify(record)) for _ in range(3))
    begun = time.perf_counter()
    numbers, simulations = curve_fit_nioptd2(record)
    baseline = time.perf_counter() - begun
    residual = record.measurement - simulate(record.time, record.control, *numbers.tolist())
    best = identify(record, "nioptd2").best
    assert best is not None
    return Comparison(ours, every, baseline, best.noise, float(np.sqrt(np.mean(residual**2))), simulations)


def _took(work: Callable[[], object]) -> float:
    begun = time.perf_counter()
    work()
    return time.perf_counter() - begun
