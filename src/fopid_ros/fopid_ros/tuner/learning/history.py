"""The newest stretch of the loop's signals, kept for learning the process from it."""

from __future__ import annotations

import math
import threading
from array import array

import numpy as np

from fopid_core.design.identification.record import Record
from fopid_core.errors import InputError

SIGNALS = ("setpoint", "measurement", "control")
EXCITATION = "excitation"
"""What an experiment adds to the control."""
MOST = 1_000_000
"""Samples of a signal that are kept at most, 16 MB: an hour at 277 Hz."""
LATE = 10.0
"""So many intervals may a sample come late, of a signal that is heard as it comes."""


class Samples:
    """Times and values of one signal, as bare numbers: 16 bytes each.

    Attributes
    ----------
    times, values : array
        Of doubles; what stands before ``begin`` is forgotten.
    """

    def __init__(self) -> None:
        self.clear()

    def clear(self) -> None:
        """Forget all."""
        self.times, self.values = array("d"), array("d")
        self.begin = 0

    @property
    def interval(self) -> float:
        """Between two samples, on the average [s]; 0 where there are no two."""
        return (self.times[-1] - self.times[self.begin]) / max(len(self) - 1, 1)

    def __len__(self) -> int:
        return len(self.times) - self.begin

    def add(self, time: float, value: float) -> None:
        """Take the newest."""
        self.times.append(time)
        self.values.append(value)

    def forget(self, before: float) -> None:
        """Forget what is older, but for the last sample that still holds then; and all but ``MOST``."""
        times = self.times
        while len(self) > MOST or (len(self) > 1 and times[self.begin + 1] < before):
            self.begin += 1
        if 2 * self.begin > len(times):  # rarely, so that it costs nothing by the sample
            del times[: self.begin], self.values[: self.begin]
            self.begin = 0

    def table(self) -> np.ndarray:
        """Times and values, shape (n, 2)."""
        return np.column_stack((np.array(self.times), np.array(self.values)))[self.begin :]


class History:
    """Times and values of setpoint, measurement and control; old ones are forgotten.

    Safe to fill in one thread and to read in another.

    Parameters
    ----------
    kept : float
        How much is kept [s].

    Attributes
    ----------
    whole_since : float
        What is not older than this is kept in any case [s]: the experiment under way.
    changed : float
        When the loop became what it is [s]: a controller that was opened, closed or given other gains.
    regained : float
        When its gains became what they are [s].
    """

    def __init__(self, kept: float) -> None:
        self.kept = kept
        self.whole_since, self.changed, self.regained = math.inf, -math.inf, -math.inf
        self._lock = threading.Lock()
        self._samples = {name: Samples() for name in (*SIGNALS, EXCITATION)}

    def add(self, signal: str, time: float, value: float) -> None:
        """Take a sample; one that comes a little late is left out, a time that runs backwards begins anew."""
        with self._lock:
            samples = self._samples[signal]
            if len(samples) and time < samples.times[-1]:
                if samples.times[-1] - time < LATE * samples.interval:
                    return
                for each in self._samples.values():
                    each.clear()
                self.changed = -math.inf
            samples.add(time, value)
            samples.forget(min(time - self.kept, self.whole_since))

    def count_as_excitation(self, since: float, until: float) -> None:
        """What the control did meanwhile [s] moved the loop from outside: other gains than its own did it."""
        with self._lock:
            control, added = (self._samples[name].table() for name in ("control", EXCITATION))
            within = (control[:, 0] >= since) & (control[:, 0] < until)
            if not within.any():
                return
            moved = control[within] - [0.0, control[within][0, 1]]
            after = added[added[:, 0] >= until]
            parts = (added[added[:, 0] < since], moved, [[until, 0.0]], after)
            samples = self._samples[EXCITATION]
            samples.clear()
            for column, values in zip((samples.times, samples.values), np.concatenate(parts).T, strict=True):
                column.frombytes(values.tobytes())

    def newest(self, signal: str) -> float:
        """The newest value, NaN before the first."""
        with self._lock:
            samples = self._samples[signal]
            return samples.values[-1] if len(samples) else math.nan

    def newest_time(self, signal: str) -> float:
        """When its newest value came [s], -inf before the first."""
        with self._lock:
            samples = self._samples[signal]
            return samples.times[-1] if len(samples) else -math.inf

    def newest_values(self, signal: str, count: int) -> np.ndarray:
        """Its last values, shape (count,) at most."""
        with self._lock:
            return self._samples[signal].table()[-count:, 1]

    @property
    def unmoved_since(self) -> float:
        """Since when neither setpoint nor experiment has moved the loop [s], -inf where they have not."""
        with self._lock:
            kept = [self._samples[name].table() for name in ("setpoint", EXCITATION)]
        moves = [samples[1:, 0][np.diff(samples[:, 1]) != 0.0] for samples in kept]
        return max((float(times[-1]) for times in moves if len(times)), default=-math.inf)

    def unmoved(self, count: int) -> np.ndarray:
        """The last measurements since then, at the ticks; shape (count,) at most."""
        since = self.unmoved_since
        with self._lock:
            measured, control = (self._samples[name].table()[-2 * count :] for name in ("measurement", "control"))
        if not len(measured):
            return np.empty(0)
        ticks = control[:, 0]
        return _held(measured, ticks[ticks >= max(since, measured[0, 0])])[-count:]

    def travel(self, signal: str) -> float:
        """The distance of its largest and smallest value, as long as it is remembered."""
        with self._lock:
            values = self._samples[signal].table()[:, 1]
        return float(np.ptp(values)) if len(values) else 0.0

    def ticks_since(self, since: float) -> int:
        """How many ticks of the controller have been heard from then on [s]."""
        with self._lock:
            times = self._samples["control"].table()[:, 0]
        return int(np.unique(times[times >= since]).size)

    def record(self, since: float = -math.inf) -> Record:
        """What the controller saw and did at each of its ticks from ``since`` [s] on.

        Raises
        ------
        InputError
            If there is too little, a signal has not been heard at all, or what is asked for was more than is kept.
        """
        with self._lock:
            kept = {name: samples.table() for name, samples in self._samples.items()}
            full = any(len(samples) >= MOST and samples.times[samples.begin] > since for samples in
                       self._samples.values()) and self.whole_since <= since  # fmt: skip
        if full:
            raise InputError(
                f"experiment of more than {MOST:,} samples; allowed: a shorter one, or a longer sample_time"
            )
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
            excitation=_added(kept[EXCITATION], ticks[:, 0]),
        )


def _added(samples: np.ndarray, times: np.ndarray) -> np.ndarray | None:
    """The addend at each of the times, 0 before the first; None where nothing was added."""
    if not len(samples):
        return None
    added = np.where(times < samples[0, 0], 0.0, _held(samples, times))
    return added if added.any() else None


def _held(samples: np.ndarray, times: np.ndarray) -> np.ndarray:
    """The newest value at each of the times."""
    values: np.ndarray = samples[np.searchsorted(samples[:, 0], times, side="right") - 1, 1]
    return values
