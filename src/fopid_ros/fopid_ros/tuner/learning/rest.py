"""Of a loop at rest: what was heard of it before anybody asked, and how far from its setpoint it may be."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fopid_core.errors import InputError
from fopid_ros.tuner.learning.history import History
from fopid_ros.tuner.learning.loop_tap import Tick


class RestlessError(InputError):
    """The loop does not come to rest."""


def heard_before(history: History, window: float, gap: float) -> list[Tick]:
    """The newest ticks of a loop that nothing has moved or changed since.

    Parameters
    ----------
    history : History
    window : float
        Of so many seconds at most.
    gap : float
        Whatever came before a silence of so long is left out [s].
    """
    newest, setpoint = history.newest_time("control"), history.newest("setpoint")
    try:
        heard = history.record(max(history.unmoved_since, history.changed, newest - window))
    except InputError:  # nothing yet
        return []
    times = newest - heard.span + heard.time
    silences = np.flatnonzero(np.diff(times) > gap)
    first = int(silences[-1]) + 1 if silences.size else 0
    values = zip(times[first:], heard.measurement[first:], heard.control[first:], strict=True)
    return [Tick(float(time), setpoint, float(measured), float(control)) for time, measured, control in values]


def bear(ticks: Sequence[Tick], borne: float) -> None:
    """End a wait for rest where the measurement is too far from a setpoint at rest.

    Raises
    ------
    RestlessError
    """
    first, newest = ticks[0], ticks[-1]
    off = newest.measurement - newest.setpoint
    if abs(off) > borne and newest.setpoint == first.setpoint:
        raise RestlessError(f"the measurement went {off:+.4g} off the setpoint ({borne:.4g} is borne)")
