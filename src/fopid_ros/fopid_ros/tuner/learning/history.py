"""The newest stretch of the loop's signals, kept for learning the process from it."""

from __future__ import annotations

import math
import threading
from collections import deque

import numpy as np

from fopid_core.design.identification.record import Record
from fopid_core.errors import InputError

SIGNALS = ("setpoint", "measurement", "control")


class History:
    """Times and values of setpoint, measurement and control; old ones are forgotten.

    Safe to fill in one thread and to read in another.

    Parameters
    ----------
    kept : float
        How much is kept [s].
    """

    def __init__(self, kept: float) -> None:
        self.kept = kept
        self._lock = threading.Lock()
        self._samples: dict[str, deque[tuple[float, float]]] = {name: deque() for name in SIGNALS}

    def add(self, signal: str, time: float, value: float) -> None:
        """Take a sample; a time that runs backwards starts the history anew."""
        with self._lock:
            samples = self._samples[signal]
            if samples and time < samples[-1][0]:
                for each in self._samples.values():
                    each.clear()
            samples.append((time, value))
            # The last sample before the stretch still holds at its beginning.
            while len(samples) > 1 and samples[1][0] < time - self.kept:
                samples.popleft()

    def newest(self, signal: str) -> float:
        """The newest value, NaN before the first."""
        with self._lock:
            return self._samples[signal][-1][1] if self._samples[signal] else math.nan

    def newest_time(self, signal: str) -> float:
        """When its newest value came [s], -inf before the first."""
        with self._lock:
            return self._samples[signal][-1][0] if self._samples[signal] else -math.inf

    def record(self, since: float = -math.inf) -> Record:
        """What the controller saw and did at each of its ticks from ``since`` [s] on.

        Raises
        ------
        InputError
            If there is too little, or a signal has not been heard at all.
        """
        with self._lock:
            kept = {name: np.array(samples).reshape(-1, 2) for name, samples in self._samples.items()}
        silent = [name for name in ("measurement", "control") if not len(kept[name])]
        if silent:
            raise InputError(f"{silent[0]} has not been heard; allowed: a running loop, with history above 0 s")
        ticks = kept["control"]
        begin = max(since, kept["measurement"][0, 0])
        ticks = ticks[(ticks[:, 0] >= begin) & np.append(np.diff(ticks[:, 0]) > 0.0, True)]
        heard = len(kept["setpoint"]) and kept["setpoint"][0, 0] <= (ticks[0, 0] if len(ticks) else math.inf)
        return Record(
            time=ticks[:, 0] - (ticks[0, 0] if len(ticks) else 0.0),
            control=ticks[:, 1],
            measurement=_held(kept["measurement"], ticks[:, 0]),
            setpoint=_held(kept["setpoint"], ticks[:, 0]) if heard else None,
        )


def _held(samples: np.ndarray, times: np.ndarray) -> np.ndarray:
    """The newest value at each of the times."""
    values: np.ndarray = samples[np.searchsorted(samples[:, 0], times, side="right") - 1, 1]
    return values
