"""What one tick of the controller takes, beside a classical PID and beside a controller that forgets nothing."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray

from fopid_core.errors import InputError
from fopid_core.model.fopid import Fopid
from fopid_core.runtime.controller import ControllerSettings, FopidController

CALLS, ROUNDS = 500, 200
SAMPLES = 5000
"""What the controller with full memory remembers."""


class FullMemory(FopidController):
    """The same controller on Gruenwald-Letnikov differences over all samples so far, as many as are benchmarked.

    Written as fast as numpy allows: the past lies in memory newest first, so that a tick is two dot products.

    Examples
    --------
    >>> full = FullMemory(ControllerSettings(Fopid(2.0, ki=1.0), sample_time=0.1), samples=4)
    >>> round(full.step(1.0, 0.0), 12)
    2.1
    """

    def __init__(self, settings: ControllerSettings, samples: int = SAMPLES) -> None:
        super().__init__(settings)
        self._samples, h = samples, settings.sample_time
        self._integral_weights = h**settings.gains.lam * _differences(-settings.gains.lam, samples)
        self._derivative_weights = h**-settings.gains.mu * _differences(settings.gains.mu, samples)
        self._past = np.zeros(2 * samples)
        self._newest = samples

    def step(
        self, setpoint: float, measurement: float, feedforward: float = 0.0, manual: float = 0.0,
        tracking: float | None = None,
    ) -> float:  # fmt: skip
        """One tick, as in ``FopidController``."""
        self.begin(setpoint, measurement, feedforward, manual, tracking)
        if self._newest == 0:
            self._past[self._samples :] = self._past[: self._samples]
            self._newest = self._samples
        self._newest -= 1
        self._past[self._newest] = self.state.error
        past = self._past[self._newest : self._newest + self._samples]
        return self.finish(float(self._integral_weights.dot(past)), float(self._derivative_weights.dot(past)))


def _differences(order: float, count: int) -> NDArray[np.float64]:
    """(-1)^j binomial(order, j)."""
    j = np.arange(1, count)
    return np.concatenate(([1.0], np.cumprod(1.0 - (order + 1.0) / j)))


def tick_times(gains: Fopid, sample_time: float) -> dict[str, float]:
    """Seconds per tick: ours within and at its limits, simple-pid's, and of the controller with full memory.

    All in turn, round by round, and of each the shortest round, so that other work on the machine meets all alike.
    """
    try:
        from simple_pid import PID
    except ImportError:
        raise InputError(
            "simple-pid is not installed; the benchmark measures against it: pip install simple-pid"
        ) from None
    within, at_limit = (
        FopidController(ControllerSettings(gains, sample_time, control_min=-limit, control_max=limit))
        for limit in (1e9, 0.1)
    )
    pid = PID(gains.kp, gains.ki, gains.kd, setpoint=1.0, sample_time=None, output_limits=(-1e9, 1e9))
    full = FullMemory(ControllerSettings(gains, sample_time))
    work: Mapping[str, Callable[[], object]] = {
        "within": lambda: within.step(1.0, 0.5),
        "at limit": lambda: at_limit.step(1.0, 0.5),
        "simple-pid": lambda: pid(0.5),
        "full memory": lambda: full.step(1.0, 0.5),
    }
    best = dict.fromkeys(work, np.inf)
    for _ in range(ROUNDS):
        for name, tick in work.items():
            begun = time.perf_counter()
            for _ in range(CALLS):
                tick()
            best[name] = min(best[name], (time.perf_counter() - begun) / CALLS)
    return best
