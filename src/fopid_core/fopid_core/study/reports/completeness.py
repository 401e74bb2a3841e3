"""Whether a recording holds every sample, by the instants its messages are stamped with."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from fopid_core.model.arrays import Floats
from fopid_core.study.reports.run import Run

EVERY_SAMPLE = ("measurement", "control", "state")
"""What a loop publishes at every sample."""

_GAP = 1.5  # sample times between two messages of which none is missing; on a wall clock they jitter


@dataclass(frozen=True)
class Samples:
    """What a topic holds of the loop's samples.

    Attributes
    ----------
    expected, missing : int
        Samples between the first and the last, and how many of them no message was found for.
    first_gap : float
        Where the first missing one should be [s]; NaN when none is missing.
    late : int
        Of the samples without a message, those that the controller says came late or not at all; they are not missing.
    """

    expected: int
    missing: int
    first_gap: float
    late: int = 0

    def __str__(self) -> str:
        late = f", {self.late:,} late" if self.late else ""
        return f"{self.missing:,} of {self.expected:,} missing{late}"


def samples(run: Run) -> Mapping[str, Samples]:
    """Count the samples of each topic that is published at every one.

    In lockstep every sample has its stamp, so what is missing was lost; all topics of a run that came to an orderly end
    should reach its last sample. On a wall clock a sample may come late, too: the controller counts its late ticks, and
    of other publishers nothing tells the late from the lost.

    Examples
    --------
    >>> from pathlib import Path
    >>> from fopid_core.study.reports.run import Signal
    >>> time = np.delete(np.arange(0.0, 10.0, 0.1), [40, 41])
    >>> run = Run(Path("run"), {"measurement": Signal(time, time), "control": Signal(time, time)})
    >>> print(samples(run)["control"])
    2 of 100 missing
    """
    times = {name: run.signals[name].time for name in ("measurement", "control") if name in run.signals}
    if run.state:
        times["state"] = run.state["time"]
    if not run.sample_time > 0.0:
        return {}
    together = run.start == 0 and run.whole
    last = max(float(time[-1]) for time in times.values())
    late = {} if run.start == 0 else dict.fromkeys(("control", "state"), _late(run))
    return {
        name: _count(time, run.sample_time, last if together else float(time[-1]), late.get(name, 0))
        for name, time in times.items()
    }


def _late(run: Run) -> int:
    """Late ticks that the controller counted."""
    overruns = run.state.get("overruns")
    return 0 if overruns is None else int(overruns[-1] - overruns[0])


def _count(time: Floats, sample_time: float, last: float, late: int) -> Samples:
    gaps = np.diff(np.append(np.unique(time), last + sample_time)) / sample_time
    lost = np.where(gaps > _GAP, np.round(gaps) - 1.0, 0.0)
    absent = int(lost.sum())
    late = min(late, absent)
    first = float(np.unique(time)[np.argmax(lost > 0.0)]) + sample_time if absent > late else float("nan")
    return Samples(np.unique(time).size + absent, absent - late, first, late)
